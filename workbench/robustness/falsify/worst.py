"""The worst run that a search has found, and with which machine."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from workbench.physics.parameters import EffectSizes
from workbench.physics.plant import Plant
from workbench.records import field, record
from workbench.robustness.falsify.box import Dimension, polar
from workbench.robustness.falsify.counterexample import Counterexample, excess_sentence
from workbench.robustness.limits import Limit
from workbench.simulation import Scenario


@record
class Worst:
    """The worst run that a search found, and with which machine.

    excess, value: as in a counterexample; share: the excess in what the bound allows, positive where the limit is broken;
    nominal: that of the nominal machine. history (runs): the largest share up to each run. refused: machines that cannot be run.
    """

    plant: Plant
    dimensions: tuple[Dimension, ...]
    scenario: Scenario
    bumpless: bool
    substeps: int
    parameters: Mapping[str, float]
    effects: EffectSizes
    limit: Limit
    bound: str
    excess: float
    share: float
    sample: int
    value: float
    nominal: float
    history: np.ndarray = field("runs")
    refused: int = 0

    @property
    def broken(self) -> bool:
        """Whether a limit is broken."""
        return self.share > 0.0

    @property
    def runs(self) -> int:
        return len(self.history)

    @property
    def point(self) -> dict[str, float]:
        """The numbers of the worst machine by dimension."""
        return {str(d): polar(self.effects[d.effect])[d.name] if d.effect else self.parameters[d.name] for d in self.dimensions}

    @property
    def sentence(self) -> str:
        return excess_sentence(self.limit, self.bound, self.excess, self.sample * self.plant.dt, self.value)

    def counterexample(self, base: str, controller: Mapping[str, Any]) -> Counterexample:
        """base: what the plant was called; controller: the content of its file."""
        return Counterexample(
            self.plant.name, base, self.plant.dt, controller, self.scenario, self.bumpless, self.substeps, self.parameters,
            self.effects, self.limit, self.bound, self.excess, self.sample, self.value,
        )  # fmt: skip
