"""Free runs of the plant beside a record: over the whole of it, and within windows.

A free run begins where the record begins: states are fitted to its first samples. And nothing is refused by a free run of the
whole record alone: what a start, a parameter or a disturbance takes away adds up over it. The record is cut into windows, short
ones where the plant is unstable, each with a start of its own, and what the inputs do within a window is compared,

    D = y - z0,   F = z - z0,   z0: a run from the same start under the window's mean inputs.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from workbench.data import Channel, Experiment
from workbench.diagnosis.check.likeness import nearest
from workbench.diagnosis.check.slips import Guess, Slip, mended_record
from workbench.diagnosis.runs import Runner, first_outside
from workbench.physics.plant import Plant
from workbench.records import field, record

TOLD = 0.05  # difference of two distances below which neither is closer
LEAVES = 0.1  # share of the record that a free run must last to be compared with
WORST = 2.0  # what one output adds to the distance of a run at most


@record
class Compared:
    """The outputs seen in a record, by column of y (N, n), and a free run of the plant, z (N, n), until it leaves its range."""

    file: str
    channels: tuple[Channel, ...]
    y: np.ndarray = field("N n")
    z: np.ndarray = field("N n")

    @property
    def counted(self) -> tuple[int, ...]:
        """Outputs that tell whether the plant explains a record: a reel's radius grows whatever turns it."""
        return tuple(i for i, c in enumerate(self.channels) if c.role != "schedule")

    @property
    def follows(self) -> float:
        """The best correlation of these."""
        if not len(self.y):
            return 0.0
        return max((nearest(self.y[:, i], self.z[:, i]).correlation for i in self.counted), default=0.0)

    @property
    def away(self) -> float:
        """Mean distance over the outputs."""
        if not len(self.y):
            return WORST
        return float(np.mean([self.distance(c.name) for c in self.channels]))

    def distance(self, name: str) -> float:
        """Of one output, WORST at most."""
        i = [c.name for c in self.channels].index(name)
        return min(nearest(self.y[:, i], self.z[:, i]).distance, WORST) if len(self.y) else WORST

    def mended(self, slips: tuple[Slip, ...]) -> "Compared":
        """The same with outputs as they would be without these slips."""
        factor = {name: slip.factor for slip in slips for name in slip.channels}
        return replace(self, y=self.y * [factor.get(c.name, 1.0) for c in self.channels])


def free_runs(plant: Plant, e: Experiment, runner: Runner, inputs: Sequence[np.ndarray]) -> tuple[list[Compared], bool]:
    """Free runs under each inputs (N, nu) over the whole record, and True; of an unstable plant what they do within windows."""
    whole = whole_runs(plant, e, runner, inputs)
    return (whole, True) if len(whole[0].y) else ([forced_runs(plant, e, runner, u) for u in inputs], False)


def whole_runs(plant: Plant, e: Experiment, runner: Runner, inputs: Sequence[np.ndarray]) -> list[Compared]:
    """A free run over the whole record under each inputs (N, nu), from the plant's own start or from a fitted one.

    The first inputs tell which of the two: fitted, where they follow the record better so.
    """
    usual, fitted = ([_until_it_leaves(plant, e, run) for run in runner.whole(inputs, fitted=fitted)] for fitted in (False, True))
    return fitted if fitted[0].away + TOLD < usual[0].away else usual


def forced_runs(plant: Plant, e: Experiment, runner: Runner, u: np.ndarray) -> Compared:
    """What the inputs u (N, nu) do within windows: D of the module beside F, over no samples where no window lasts."""
    seen = [i for i, name in enumerate(plant.output_names) if name in e.names and np.ptp(e[name]) > 0.0]
    D, F = runner.forced(u)
    return Compared(e.name, tuple(plant.outputs[i] for i in seen), D[:, seen], F[:, seen])


def mended_runs(plant: Plant, e: Experiment, slips: Sequence[Slip]) -> Compared:
    """What the logged inputs do within windows of the record as it would be without these slips."""
    mended = mended_record(e, slips)
    runner = Runner.of(plant, mended)
    return forced_runs(plant, mended, runner, runner.u)


def _until_it_leaves(plant: Plant, e: Experiment, run: np.ndarray) -> Compared:
    """The run (N, ny) beside the record, over no samples where it leaves the plant's range too soon to be compared with."""
    seen = [i for i, name in enumerate(plant.output_names) if name in e.names and np.ptp(e[name]) > 0.0]
    lasts = first_outside(run)
    n = lasts if lasts > max(LEAVES * len(e), 20) else 0
    channels = tuple(plant.outputs[i] for i in seen)
    return Compared(e.name, channels, e[[c.name for c in channels]][:n], run[:n][:, seen])


def holds_in_windows(plant: Plant, e: Experiment, guess: Guess) -> bool:
    """Whether the plant follows the record better within windows, too, where these slips are mended.

    So it must follow every output that is mended: a ball that is said to hang a kilometre below its magnet stays there.
    """
    as_is, better = mended_runs(plant, e, ()), mended_runs(plant, e, guess.slips)
    outputs = [c.name for c in better.channels if any(c.name in slip.channels for slip in guess.slips)]
    closer = all(better.distance(name) < as_is.distance(name) for name in outputs)
    return closer and better.away + TOLD < as_is.away
