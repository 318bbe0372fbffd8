"""What a check says of one thing, the identified model or the simulated plant."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from workbench.physics.controller import content_of
from workbench.records import field, record
from workbench.report.blocks import Block
from workbench.robustness.falsify.counterexample import Counterexample
from workbench.robustness.sequences import Broken, Witness
from workbench.robustness.verdict import Verdict

FROZEN = ", frozen"  # what a claim says of a loop whose schedule stands still


@record
class Part:
    """Verdicts, the blocks of the page that show them, and by file name what shows that a claim failed."""

    title: str
    verdicts: tuple[Verdict, ...]
    blocks: tuple[Block, ...] = ()
    witnesses: Mapping[str, Witness | Counterexample] = field(default_factory=dict)

    def save(self, folder: Path, base: str = "", own: str = "", controller: object = None) -> None:
        """Write every witness under its name.

        base: what the plant was called, own: file.py:NAME of a `controller` of the user's own; both are named in the files, so
        that they run again.
        """
        for name, witness in self.witnesses.items():
            if isinstance(witness, Counterexample):
                witness = replace(witness, base=base or witness.base)
            if own and isinstance(witness, Counterexample):
                witness = replace(witness, controller=content_of(controller, own))
            elif own and isinstance(witness, Broken):
                witness = replace(witness, passage=replace(witness.passage, controller=content_of(controller, own)))
            witness.save(folder / name)
