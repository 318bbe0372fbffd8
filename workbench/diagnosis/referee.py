"""The referee: what a model is worth on records that it has not seen, against the model that it replaces.

    share = 1 - sqrt(sum e_after^2 / sum e_before^2)    by channel and horizon, pooled over the records

One step, one second and the full run ahead. Whether a share is more than noise is told by the differences of squares, summed over
blocks that are as long as these differences are correlated. Of an unstable plant runs are compared less than a second ahead, and
where neither of two runs follows the record, their errors say nothing of the models; see `growth`.
"""

from collections.abc import Sequence

import numpy as np

from workbench.data import Dataset
from workbench.diagnosis.answer import Gain
from workbench.diagnosis.free_run import simulated
from workbench.diagnosis.gains import FULL_RUN, ONE_STEP, Held, errors_left_out, errors_on, followed_by_neither, gained
from workbench.diagnosis.growth import fold, reach, unstable
from workbench.diagnosis.predictor import predictor
from workbench.diagnosis.recalibrate import recalibrated, unknowns
from workbench.diagnosis.refit import Model
from workbench.physics.plant import Plant
from workbench.records import record

SURE = 2.0  # standard errors
FEWEST, ROUGH = 6, 0.2  # blocks, below which no standard error is known, and the share that counts there
FAR = 5.0  # times that an error may be as large as another by chance, however few blocks make it so
CORRELATED = 0.3  # autocorrelation up to which a block must reach
LOSS = 0.0025  # share of the error by which a cause may raise it
BETTER = 0.02  # share of the errors a second and the full run ahead by which a fit to free runs must be better
EXCHANGED = 0.1  # of that share, by which it may err more one step ahead
NOTICEABLE = 0.02  # the same from which what is handed out is called worse


@record
class Change:
    """Pooled root mean square error of a channel at a horizon, before and after; sure: the difference is more than noise.

    NaN where the run was lost; both are where neither follows the record, and nothing is known of which is better.
    """

    channel: str
    horizon: str
    unit: str
    before: float
    after: float
    sure: bool

    @property
    def known(self) -> bool:
        """Whether it says which of the two is better."""
        return not (np.isnan(self.before) and np.isnan(self.after))

    @property
    def ahead(self) -> bool:
        """Whether it is a second ahead, or as far as runs of an unstable plant are compared."""
        return self.horizon not in (ONE_STEP, FULL_RUN)

    @property
    def share(self) -> float:
        """What was taken off the error, relative to before; -inf where the run is lost now, inf where it was lost before."""
        if np.isnan(self.before) or np.isnan(self.after):
            return 0.0 if not self.known else (np.inf if np.isnan(self.before) else -np.inf)
        return 1.0 - self.after / self.before if self.before > 0.0 else 0.0

    def __str__(self) -> str:
        return f"{self.channel} {self.horizon}: {_said(self.before)} before, {_said(self.after)} after [{self.unit}]"


def changes(before: Held, after: Held) -> tuple[Change, ...]:
    """A change for every channel and horizon."""
    found, astray = [], followed_by_neither(before, after)
    keys = dict.fromkeys((s.horizon, s.channel, s.unit) for s in before.scores)
    for horizon, channel, unit in sorted(keys, key=lambda key: (key[0] != ONE_STEP) + (key[0] == FULL_RUN)):
        own = [k for k, s in enumerate(before.scores) if (s.horizon, s.channel) == (horizon, channel)]
        far = float(np.sqrt(np.mean([before.far[k] ** 2 for k in own]))) if before.far else np.inf
        nothing = np.full(1, np.inf)
        pairs = [(before.squares[k], after.squares[k]) for k in own if k not in astray] or [(nothing, nothing)]
        told = [~np.isnan(b) & ~np.isnan(a) for b, a in pairs]
        pairs = [(b[t], a[t]) for (b, a), t in zip(pairs, told, strict=True) if t.any()]
        if not pairs:
            continue
        old, new = (float(np.sqrt(np.mean(np.concatenate(side)))) for side in zip(*pairs, strict=True))
        if min(old, new) > far:
            old = new = np.inf
        lost = not np.isfinite([old, new]).all()
        sure = lost or _sure([a - b for b, a in pairs], old, new, round(1.0 / before.dt) if horizon != ONE_STEP else 1)
        old, new = (v if np.isfinite(v) else np.nan for v in (old, new))
        found.append(Change(channel, horizon, unit, old, new, sure))
    return tuple(found)


def _sure(differences: Sequence[np.ndarray], old: float, new: float, least: int) -> bool:
    """Whether the sum of all differences is beyond SURE standard errors, by blocks, or one error FAR larger than the other.

    A run that leaves its record near the end does so in one block, whose size is its own standard error.
    """
    if max(old, new) > FAR * min(old, new):
        return True
    length = max(5, least, *(2 * _correlated(d) for d in differences))
    blocks = np.concatenate([np.add.reduceat(d, np.arange(0, max(1, len(d) - length // 2), length)) for d in differences])
    if len(blocks) < FEWEST:
        return abs(new - old) > ROUGH * min(old, new)
    return bool(abs(blocks.sum()) > SURE * np.sqrt(len(blocks)) * blocks.std(ddof=1))


def _correlated(d: np.ndarray) -> int:
    """Samples up to which a series is correlated."""
    d = d - d.mean()
    spectrum = np.abs(np.fft.rfft(d, 2 * len(d))) ** 2
    auto = np.fft.irfft(spectrum)[: len(d)]
    below = np.flatnonzero(auto < CORRELATED * auto[0])
    return int(below[0]) if len(below) else len(d)


class Judge:
    """Models on held-out records, each computed once; where none is held out, on parts of their own that the fit has left out."""

    def __init__(self, dataset: Dataset, held_out: bool):
        self.dataset, self.held_out, self._known = dataset, held_out, []
        self._seconds = 0.0  # how far ahead, the same for all models

    @property
    def where(self) -> str:
        return "on held-out records" if self.held_out else "on parts of these records, each left out of the fit in turn"

    def of(self, model: Model) -> Held:
        for other, held in self._known:
            if other is model:
                return held
        s = self._seconds = self._seconds or reach(model.predictor)
        self._known.append((model, errors_on(model, self.dataset, s) if self.held_out else errors_left_out(model, s)))
        return self._known[-1][1]

    def compared(self, model: Model) -> str:
        """How far free runs of an unstable plant are compared, a sentence; empty of a stable one."""
        if not unstable(model.predictor):
            return ""
        grows, seconds = fold(model.predictor), self._seconds or reach(model.predictor)
        return (
            f"{model.predictor.plant.name} is unstable, what is off grows e-fold in {grows:.2g} s: free runs are compared up to "
            f"{seconds:g} s ahead, and further only where one of them follows the record"
        )

    def between(self, before: Model, after: Model) -> tuple[Change, ...]:
        return changes(self.of(before), self.of(after))

    def gained(self, before: Model, after: Model) -> tuple[Gain, ...]:
        """The errors of every record."""
        return gained(self.of(before), self.of(after))

    def surprise(self, before: Model, after: Model) -> float:
        """How much less likely the records are with the second model than with the first, in -2 log likelihood."""
        return self.of(after).deviance - self.of(before).deviance

    def longer(self, before: Model, after: Model, channel: str | None = None) -> float:
        """Errors a second and the full run ahead, after over before: geometric mean over channels, or of one."""
        ahead = [c for c in self.between(before, after) if c.horizon != ONE_STEP and c.known and channel in (None, c.channel)]
        kept = [max(1.0 - c.share, 1e-9) for c in ahead]
        return float(np.exp(np.mean(np.log(kept)))) if kept else 1.0

    def better_ahead(self, given: Model, model: Model) -> Model:
        """The model fitted to free runs, where it errs less a second and the full run ahead and more nowhere; else as it is.

        One step ahead, where a filter forgives most, a channel may err more by EXCHANGED of the share that is taken off its
        errors further ahead, but not more than under the plant as it was `given`.
        """
        runs = simulated(model)
        if runs is None or self.longer(model, runs) > 1.0 - BETTER:
            return model
        objected = [{(c.channel, c.horizon) for c in worse(self.between(given, m))} for m in (model, runs)]
        for c in worse(self.between(model, runs)):
            less = 1.0 - self.longer(model, runs, c.channel)
            if c.horizon != ONE_STEP or c.share < -EXCHANGED * less or (c.channel, c.horizon) in objected[1]:
                return model
        return model if objected[1] - objected[0] else runs

    def objections(self, what: str, given: Model, model: Model) -> tuple[str, ...]:
        """A sentence for each channel and horizon where a model is worse than the one that it replaces."""
        return tuple(
            f"the {what} plant is worse than the one that it replaces, {self.where}: {c}"
            for c in worse(self.between(given, model))
        )


def as_given(plant: Plant, dataset: Dataset, *, drift: bool = True, threads: int = 1) -> Model:
    """The plant with the parameters that it came with; starts and noise levels are of the records."""
    at = predictor(plant, dataset, drift=drift, threads=threads)
    made = recalibrated(at, own=unknowns(at, names=()), rounds=1)
    return Model(made.predictor, made.fit)


def helps(found: Sequence[Change], least: float) -> bool:
    """Whether some error falls by a share of `least`: one step or one second ahead, or over the full run by more than noise."""
    return any(c.share >= least and (c.horizon != FULL_RUN or c.sure) for c in found)


def improved(found: Sequence[Change], least: float) -> tuple[Change, ...]:
    """Errors at any horizon that fall by a share of `least`, by more than noise."""
    return tuple(c for c in found if c.sure and c.share >= least)


def harms(found: Sequence[Change]) -> tuple[Change, ...]:
    """Errors one step or one second ahead that rise by more than noise; full runs of phases and integrals are noise."""
    return tuple(c for c in found if c.horizon != FULL_RUN and c.sure and c.share < -LOSS)


def worse(found: Sequence[Change]) -> tuple[Change, ...]:
    """Errors at any horizon that rise noticeably, by more than noise: the new model is worse there than the one it replaces."""
    return tuple(c for c in found if c.sure and c.share < -NOTICEABLE)


def _said(error: float) -> str:
    return f"{error:.3g}" if np.isfinite(error) else "a lost run"
