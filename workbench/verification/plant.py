"""What is claimed of a loop on the simulated plant: the worst machine within tolerances and fitted intervals is searched for."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from workbench.errors import InputError
from workbench.files import as_read
from workbench.physics.controller import Controller, content_of
from workbench.physics.plant import Plant
from workbench.progress import Progress, silent
from workbench.report import figures
from workbench.report.blocks import Block, Table
from workbench.robustness.falsify.box import Dimension, tolerance_box
from workbench.robustness.falsify.counterexample import counterexample_of
from workbench.robustness.falsify.search import at_random, worst_plant
from workbench.robustness.falsify.trials import Search
from workbench.robustness.falsify.worst import Worst
from workbench.robustness.limits import LoopLimits, resolved, settled
from workbench.robustness.verdict import Status, Verdict
from workbench.simulation import Scenario, simulate
from workbench.verification.part import Part

TITLE = "On the simulated plant"
RUNS, STEPPED = 400, 40  # of the plant for each limit; of a law that is computed step by step
SURE = 1e-3  # probability that a statement about sampling is wrong


def on_plant(
    plant: Plant, law: Any, limits: LoopLimits, fitted: Sequence[Dimension] = (), *, runs: int | None = None, seed: int = 0,
    progress: Progress = silent,
) -> Part:  # fmt: skip
    """For each limit the worst machine within the plant's tolerances and the `fitted` intervals, which go before.

    runs: of the plant for each limit. Raises InputError without limits of signals.
    """
    check_asked(limits)
    assert limits.run is not None
    of, box = f"plant {plant.name}", {str(d): d for d in (*tolerance_box(plant), *fitted)}
    scenario = limits.run.scenario(plant, law)
    compiled = isinstance(law, Controller)
    count = runs or (RUNS if compiled else STEPPED)
    verdicts, worst, witnesses = [], [], {}
    asked = [one for limit in resolved(limits.limits, plant, law) for one in limit.apart]
    for number, limit in enumerate(asked, 1):
        name = f"{limit.signal}: {' and '.join(limit.kept)}"
        progress(f"worst machine for {name}")
        found = worst_plant(Search(plant, law, scenario, [limit], tuple(box.values()), runs=count, seed=seed, progress=progress))
        worst.append(found)
        said = f"{found.sentence}; the worst of {found.runs} machines within {len(box)} intervals"
        unit = limit.unit_of(found.bound)
        if not found.broken:
            verdicts.append(Verdict(name, of, Status.PASSED, -found.excess, unit, said))
            continue
        file, witness = f"counterexample-{number}.json", found.counterexample(plant.name, content_of(law))
        witnesses[file] = witness
        again = counterexample_of(as_read(witness.to_dict())).replay(plant, law)
        status = Status.FAILED if again.same else Status.UNDECIDED
        verdicts.append(Verdict(name, of, status, -found.excess, unit, said, file))
    blocks: list[Block] = [_machine_table(worst, box)]
    if not compiled:
        progress("machines at random")
        verdicts.append(_sampled(plant, law, scenario, limits, tuple(box.values()), count, seed, of, progress))
    return Part(TITLE, tuple(verdicts), (*blocks, *_worst_pictures(plant, law, scenario, worst)), witnesses)


def check_asked(limits: LoopLimits) -> None:
    """Refuse limits that ask nothing of a plant's signals."""
    if not limits.limits or limits.run is None:
        said = "no limits of signals are asked: nothing to try on the plant"
        raise InputError(said, file=limits.file or None, mend="give [run] and [limits.SIGNAL], or leave the plant out")


def _sampled(
    plant: Any, law: Any, scenario: Scenario, limits: LoopLimits, box: tuple, runs: int, seed: int, of: str, progress: Progress
) -> Verdict:  # fmt: skip
    """What random machines say: a statement about sampling, not about the worst case."""
    found = at_random(Search(plant, law, scenario, limits.limits, box, runs=runs, seed=seed, progress=progress))
    share = 1.0 - SURE ** (1.0 / found.runs)  # (1 - share)^runs = SURE
    if found.broken:
        said = f"{found.sentence}; among {found.runs} random machines"
        return Verdict("limits, machines drawn at random", of, Status.UNDECIDED, -found.excess, "", said)
    said = (
        f"none of {found.runs} random machines breaks a limit: with a confidence of {100 * (1 - SURE):g} % less than "
        f"{100 * share:.2g} % of machines drawn like these do; about sampling, not about the worst case"
    )
    return Verdict("limits, machines drawn at random", of, Status.PASSED, math.nan, "", said)


def _machine_table(worst: Sequence[Worst], box: dict) -> Table:
    """Where in its interval each number of the worst machines lies."""
    rows = tuple((name, d.low, d.high, *(found.point.get(name, d.low) for found in worst)) for name, d in box.items())
    header = ("number", "from", "to", *(f"worst for {found.limit.signal} {found.bound}" for found in worst))
    return Table("The worst machines", header, rows, "Found by search, within the tolerances and fitted intervals.")


def _worst_pictures(plant: Any, law: Any, scenario: Scenario, worst: Sequence[Worst]) -> list[Block]:
    """The signal of each limit on the nominal machine and on the worst one."""
    blocks: list[Block] = []
    before = simulate(plant, law, scenario, bumpless=True, cut=True).experiment
    for found in worst:
        after = simulate(
            plant, law, scenario, parameters=found.parameters, effects=found.effects, substeps=found.substeps,
            bumpless=found.bumpless, cut=True,
        ).experiment  # fmt: skip
        signal, N = found.limit.signal, min(len(before), len(after))
        t = before.t[:N]
        since = t >= found.limit.begin
        limits = {
            f"{side} limit": np.where(since, value, np.nan)
            for side in ("low", "high")
            if math.isfinite(value := getattr(found.limit, side))
        }
        if found.bound == "settling":
            reference = before[dict(zip(law.measured, law.references, strict=False))[signal]][:N]
            arrived = since & settled(t, reference, found.limit.settling)
            for side, way in (("low", -1.0), ("high", 1.0)):
                limits[f"{side} end of the band"] = np.where(arrived, reference + way * found.limit.band, np.nan)
        blocks.append(
            figures.beside_limits(
                f"{signal} on the worst machine for its {found.bound}", t, next(c for c in before.channels if c.name == signal),
                {"nominal machine": before[signal][:N], "worst machine": after[signal][:N]}, limits,
                f"{found.sentence}.",
            )
        )  # fmt: skip
    return blocks
