"""What a diagnosis has named, cancelled: by curves over the motion of the set-points, by what the loop awaits, by inverses.

    v + dKa m' + dKaa m'' + sum_k a_k h_k(s_k),     s_k = position m + motion m',     h: the effect's own law, against it

That is before the loop and takes nothing of margins or stability: what depends on how fast something turns or slides is known as
soon as the set-points are. How fast that is, s, is fitted to a run of the extended plant without effects. How much each command
has to do, a, and what rates are fed forward too much, dKa and dKaa, for the identified model took the effect for viscous
friction, are fitted to runs of the extended plant with them (Gauss-Newton on what is left of m - y, from none): feedforward by
basis functions.

Before the loop too is what it awaits: of an input's dead time L the feedforward acts at once and the loop compares y with m a
time L ago, so that y follows m a time L later, and on time where the path is given that much early; of a sensor that is slow, or
has play, the loop compares with what it will show while the machine itself follows m. In the loop are only the inverses of dead
zones and of gears with play.

Set-points move smoothly over the range of the records, and where they have reference models they step too: what is fitted to slow
moves alone is wrong for fast ones. Nothing is cancelled that is not worth it: machines drawn within the 95 % intervals of the
diagnosis follow the same set-points with it and without, and none may be worse along either; of an inverse under noise too.

Sources: van de Wijdeven and Bosgra, "Using basis functions in iterative learning control", Int. J. Control 83 (2010), 661-675;
Boeren, Bareja, Kok and Oomen, "Frequency-domain ILC approach for repeating and varying tasks", IEEE/ASME Trans. Mechatronics 21
(2016), 2716-2727. On friction: Armstrong-Helouvry, Dupont and Canudas de Wit, Automatica 30 (1994), section 5.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from controllers.cancelled import Compensation, Inverse
from controllers.scheduled_pid import LONGEST_LATE, ScheduledPID, parts
from workbench.curves import Curve
from workbench.data import SAME_DT
from workbench.errors import InputError, check_known
from workbench.physics.effects.effect import FOREVER, Domain, Effect, Named
from workbench.physics.effects.shaft import Shaft
from workbench.physics.plant import Plant
from workbench.records import field, record
from workbench.robustness.falsify.box import ParameterBox, fitted_box_of
from workbench.simulation import Scenario, simulate_batch
from workbench.verification.trial import from_rest_to_rest

DRAWN = 20  # machines that a compensation is tried on
WORSE, WORTH = 1.02, 0.95  # times the error without it: of no drawn machine more, in the middle less
MOVES, SLOWEST, STANDS = 8, 0.25, 0.3  # of the set-points; their slowest, of the fastest; how long they stand between, of a move
SATURATION = "saturation"  # an effect that limits of commands keep away from
INNER = 0.9  # of the range of the records, that set-points stay within
EXPLAINED = 0.98  # of a speed's variance, by the set-points, for it to be known from them
SLIGHT = 0.01  # of what moves a speed: what is less is left out
STEPS, STEP = 4, 0.01  # of the fit; of a unit, for slopes
SHARES, ENOUGH = (1.0, 0.5, 0.2), 0.99  # of a step, that are tried; ratio of squares from where on it is done
RIDGE = 1e-4  # of what changes most: numbers that change nothing stay as they are
SHORTEST, LONGEST, HELD = 20, 3000, 500  # samples of a move, and of a stand before them, in which a machine comes to rest
DIED = 10.0  # time constants of a reference model that a step is given
LATE = ("input-delay", "sensor-lag", "sensor-resonance")
AWAITED = (*LATE, "backlash")  # effects that the loop awaits
INVERTED = ("dead-zone", "gear-backlash")
DIFFERENCED = 1.5  # samples that second differences, held for one, are late
QUIET, FINE = 3.0, 256  # standard deviations of a command that change no side of an inverse; frequencies for them
NOISY = 1  # seed of runs with noise
ALONG = ("smooth moves", "steps")
NODES = (0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 5.0)  # of a curve, in widths of the law's change of sign
EVEN = 8  # nodes more, evenly up to the highest speed

Say = Callable[[str], None]


@record
class Moved:
    """Where an output was in the records of a diagnosis, and how fast it moved."""

    low: float
    high: float
    rate: float


@record
class Compensated:
    """What became of a cause: whether it is cancelled, in a sentence, and errors of the drawn machines as they would be without
    and with it, root mean square over outputs in units of their ranges: along smooth moves, and where there are reference models
    after steps. An error is m, as late as the law says, less what a sensor shows that has come to rest. late (nr): how late
    outputs follow in the end, of the effect "lateness".
    """

    effect: str
    done: bool
    sentence: str
    before: np.ndarray = field("n along", default_factory=lambda: np.empty((0, 0)))
    after: np.ndarray = field("n along", default_factory=lambda: np.empty((0, 0)))
    late: np.ndarray = field("nr", unit="s", default_factory=lambda: np.empty(0))

    @property
    def ratio(self) -> np.ndarray:
        """Errors of every machine with it by those without; infinite of one that leaves its range."""
        return _ratio(self.before, self.after)


def compensated(
    law: ScheduledPID,
    plant: Plant,
    content: Any,
    path: Any = "diagnosis",
    progress: Say = lambda _: None,
    *,
    early: bool = False,
) -> tuple[ScheduledPID, tuple[Compensated, ...]]:
    """The law with what cancels causes that a diagnosis has named, where that pays, and what became of each.

    plant: extended by the diagnosis. content: what is in its diagnosis.json; path: the file, for messages. Causes are taken in
    the order of what they cost. early: paths are given as much early as is said in the end, so that outputs may follow them late:
    as late as a dead time makes them, and as differences tell rates and accelerations late. Raises InputError for content of
    another plant, or of no diagnosis.

        >>> found = diagnose(MOTOR, data, held_out)
        >>> smooth = ScheduledPIDDesign(knots=1, paths=("n",)).on(model)
        >>> better, said = compensated(smooth, found.plant, found.to_dict())
        >>> [own.effect for own in said if own.done]
        ['feedforward', 'coulomb@shaft']
    """
    box, moved = ParameterBox(plant, fitted_box_of(plant, content, path)), _moved(content, path)
    if (diagnosed := content.get("plant")) != plant.name:
        raise InputError(f"a diagnosis of {diagnosed}", file=path, mend=f"give that of {plant.name}, or another plant")
    if foreign := [key for own in content["causes"] if (key := f"{own['effect']}@{own['at']}") not in plant.effects]:
        mend = "give the extended.json that was written beside it as --plant"
        raise InputError(f"names {foreign[0]}, which {plant.name} does not have", file=path, mend=mend)
    if abs(law.dt / plant.dt - round(law.dt / plant.dt)) > SAME_DT * law.dt / plant.dt or law.dt < plant.dt * (1.0 - SAME_DT):
        mend = f"--dt of {plant.dt:g} s, or a whole multiple of it"
        raise InputError(f"the law runs every {law.dt:g} s, the plant every {plant.dt:g} s", file=plant.name, mend=mend)
    law, told = _within_saturation(law, plant)
    keys = [key for key in plant.effects if key not in [own.effect for own in told]]
    if not (followed := np.isfinite(law.bandwidth) | law.paths).any():
        why = "set-points that may step have no speed: give them a reference model or a path"
        return law, (*told, *(Compensated(key, False, f"{key} is not cancelled: {why}") for key in keys))
    job = _Job(law, plant, moved, box)
    progress("feedforward on the extended plant")
    units, commands = job.units(law, followed)
    best = _Feedforward(law, followed, commands, units, np.zeros(len(units)), np.zeros(len(followed)))
    given = errors = job.drawn(best)
    early = early and bool(law.paths.any())

    def taken(begun: _Feedforward) -> tuple[_Feedforward, np.ndarray]:
        after = job.drawn(tuned := job.tuned(begun))
        return (tuned, after) if _pays(given, errors, after) else (best, errors)

    best, errors = taken(best)
    if early:
        best, errors = taken(_differenced(best))
    if errors is not given:
        said = f"what is fed forward of rates is fitted to {plant.name}: errors of set-points are less {_less(given, errors)}"
        told.append(Compensated("feedforward", True, said, given, errors))
    costs = {key: job.costs(key, best) for key in keys}
    for key in sorted(keys, key=lambda own: -costs[own]):
        progress(f"compensation of {key}")
        # what it costs beside what is left of the others, not beside what they cost before
        added = _unsure(key, plant, content) or job.against(key, best, job.costs(key, best), early)
        if isinstance(added, str):
            told.append(Compensated(key, False, f"{key} is not cancelled: {added}"))
            continue
        tried = job.tuned(added)
        after = job.drawn(tried)
        shown, done = (errors, after), _pays(given, errors, after)
        if done and tried.base.inverses != best.base.inverses:
            under = job.drawn(best, NOISY), job.drawn(tried, NOISY)
            done = bool(np.all(_ratio(*under) <= WORSE))
            shown = shown if done else under
        said = f"{key} is cancelled: errors of set-points are less {_less(*shown)}, on {len(after)} machines drawn within "
        said = (
            f"{said}its intervals{_otherwise(key, plant, content)}" if done else f"{key} is not cancelled: {_lost(given, *shown)}"
        )
        told.append(Compensated(key, done, said, *shown))
        best, errors = (tried, after) if done else (best, errors)
    if early and (best.due == best.dead).all():  # what is late in differences shows where little else is left
        best, errors = taken(_differenced(best))
    if best.due.any():
        each = ", ".join(f"{name} {late:.4g} s" for name, late in zip(law.measured, best.due.tolist(), strict=False) if late)
        said = f"outputs follow after their set-points: {each}; give paths that much early"
        told.append(Compensated("lateness", True, said, late=best.due))
    return best.law, tuple(told)


def _differenced(given: "_Feedforward") -> "_Feedforward":
    """The loop awaits m as late as differences from sample to sample, held for one, tell its acceleration."""
    late = np.where(given.base.paths, DIFFERENCED * given.base.dt, 0.0)
    return replace(given, base=replace(given.base, late=given.base.late + late), due=given.due + late)


def _within_saturation(law: ScheduledPID, plant: Plant) -> tuple[ScheduledPID, list[Compensated]]:
    """The law whose commands stay where an amplifier still gives what is commanded, so that no integral winds up beyond."""
    told, low, high = [], law.low.copy(), law.high.copy()
    for key, numbers in plant.effects.items():
        effect, _, place = key.partition("@")
        if effect == SATURATION and place in law.actuated and (limit := numbers.get("limit", 0.0)) > 0.0:
            i = law.actuated.index(place)
            low[i], high[i] = max(low[i], -limit), min(high[i], limit)
            ends = f"{place} stays from {low[i]:.4g} to {high[i]:.4g}"
            if not low[i] < high[i]:
                raise InputError(f"{key}: {ends}", file=law.name, channel=place, mend="give other --low, --high")
            told.append(Compensated(key, True, f"{key}: {ends}, where the integral does not wind up"))
    return (replace(law, low=low, high=high) if told else law), told


def _unsure(key: str, plant: Plant, content: Any) -> str:
    """Why a cause is not known well enough to be cancelled, in words; empty where it is."""
    cause = next((own for own in content["causes"] if f"{own['effect']}@{own['at']}" == key), None)
    if cause is None:
        return "the diagnosis does not name it, and so says nothing of its size"
    if cause.get("doubt"):
        return "the diagnosis is not sure of it"
    rivals = [own for name in cause.get("ties", ()) for own in name.split(" + ")]
    late = key.partition("@")[0] in LATE and len(plant.outputs) == 1  # the loop awaits them all alike
    alike = lambda own: own.partition("@")[2] == key.partition("@")[2] and _speed_alone(plant, own)  # noqa: E731
    other = [own for own in rivals if not alike(own) and not (late and own.partition("@")[0] in LATE)]
    return f"the records cannot tell it from {other[0]}" if other else ""


def _otherwise(key: str, plant: Plant, content: Any) -> str:
    """What a rival that the loop awaits alike would mean, in words: late commands make a machine late, a late sensor does not."""
    cause = next(own for own in content["causes"] if f"{own['effect']}@{own['at']}" == key)
    commanded = key.partition("@")[2] in plant.input_names
    other = [name for name in cause.get("ties", ()) if (name.partition("@")[2] in plant.input_names) != commanded]
    if key.partition("@")[0] not in LATE or not other:
        return ""
    return f"; if it is {other[0]} instead, which suits the records too, outputs are there {'sooner' if commanded else 'later'}"


def _pays(given: np.ndarray, before: np.ndarray, after: np.ndarray) -> bool:
    """Whether no machine is worse along anything than with the law that was given, none worse on the whole than before, and the
    one in the middle better.
    """
    whole = _together(_ratio(before, after))
    return bool(np.all(_ratio(given, after) <= WORSE) and np.all(whole <= WORSE) and np.median(whole) <= WORTH)


def _together(ratio: np.ndarray) -> np.ndarray:
    """Of every machine the geometric mean over what it follows."""
    return np.exp(np.log(np.maximum(ratio, 1e-300)).mean(axis=1))


def _ratio(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Errors of every machine by those without; infinite of one that leaves its range."""
    return np.divide(after, before, out=np.full(np.shape(after), np.inf), where=np.isfinite(after))


def _less(before: np.ndarray, after: np.ndarray) -> str:
    each = zip(_ratio(before, after).T, ALONG, strict=False)
    less = lambda own: f"by {1.0 / np.median(own):.3g} in the middle and {1.0 / own.max():.3g} at least"  # noqa: E731
    return " and ".join(f"{less(own)} along {at}" for own, at in each)


def _lost(given: np.ndarray, before: np.ndarray, after: np.ndarray) -> str:
    """Why it does not pay, in words."""
    ratio, whole = _ratio(given, after), _together(_ratio(before, after))
    if np.all(ratio <= WORSE) and np.all(whole <= WORSE):
        return f"it would take {1.0 - np.median(whole):.1%} off the errors of set-points"
    worst = f"would have errors {whole.max():.3g} times as large"
    if np.any(ratio > WORSE):
        worst = f"would have errors {ratio.max():.3g} times as large along {ALONG[int(ratio.max(axis=0).argmax())]}"
    worst = worst if np.isfinite(ratio.max()) else "would leave its range"
    return f"the worst of {len(ratio)} drawn machines {worst}"


def moved_by(content: Any, at: Mapping[str, float], path: Any = "diagnosis") -> dict[str, float]:
    """Steps of set-points by output: half of the range of the records of a diagnosis, from where they are `at` to its middle.

    Raises InputError as `compensated`.
    """
    found = {}
    for name, own in _moved(content, path).items():
        if own.high > own.low:
            found[name] = float(np.copysign(0.5 * INNER * (own.high - own.low), own.high + own.low - 2.0 * at.get(name, own.low)))
    return found


def _moved(content: Any, path: Any) -> dict[str, Moved]:
    try:
        return {name: Moved(float(own["low"]), float(own["high"]), float(own["rate"])) for name, own in content["moved"].items()}
    except (KeyError, TypeError, ValueError, AttributeError):
        mend = "diagnose once more: workbench diagnose"
        raise InputError("does not say how far and fast the outputs moved", file=path, mend=mend) from None


@record
class _Feedforward:
    """A law and numbers that are added to what it feeds forward, in their units: of the rates and of the accelerations of the
    set-points that it follows (nu, nr each), and of every shape. shapes: curves whose largest value is 1, one for each command.
    due: how long after m an output is to be there; dead: the dead time of commands in it.
    """

    base: ScheduledPID
    followed: np.ndarray = field("nr")
    commands: np.ndarray = field("nu")
    units: np.ndarray = field("n")
    numbers: np.ndarray = field("n")
    due: np.ndarray = field("nr", unit="s")
    shapes: tuple[Compensation, ...] = ()
    dead: float = field("", unit="s", default=0.0)

    @property
    def law(self) -> ScheduledPID:
        """The law with these numbers."""
        nu, nr = self.base.Kp.shape[1:]
        own, added = self.followed > 0.0, np.zeros((2, nu, nr))
        count = nu * int(own.sum())
        added[:, :, own] = (self.numbers * self.units)[: 2 * count].reshape(2, nu, -1)
        sizes = zip(self.shapes, (self.numbers * self.units)[2 * count :], strict=True)
        shapes = tuple(replace(c, curve=replace(c.curve, v=size * c.curve.v)) for c, size in sizes)
        law = replace(self.base, Ka=self.base.Ka + added[0], Kaa=self.base.Kaa + added[1])
        return replace(law, compensations=(*law.compensations, *shapes))

    def with_shapes(self, shapes: Sequence[Compensation]) -> "_Feedforward":
        """With more shapes, of nothing yet."""
        at = [self.base.actuated.index(own.input) for own in shapes]
        units, numbers = np.append(self.units, self.commands[at]), np.append(self.numbers, np.zeros(len(at)))
        return replace(self, shapes=(*self.shapes, *shapes), units=units, numbers=numbers)


class _Job:
    """Set-points over the range of the records, and runs of the extended plant along them."""

    def __init__(self, law: ScheduledPID, plant: Plant, moved: Mapping[str, Moved], box: ParameterBox):
        self.plant, every = plant, max(1, round(law.dt / plant.dt))
        controlled = law.measured[: len(law.references)]
        self.outputs = [plant.output_names.index(check_known("output", name, plant.output_names)) for name in controlled]
        own = [moved[check_known("output", name, moved)] for name in controlled]
        self.size = np.array([m.high - m.low for m in own])
        if not np.all(self.size > 0.0):
            name = controlled[int(np.argmin(self.size))]
            mend = "diagnose records in which it moves"
            raise InputError("it stood still in the records of the diagnosis", file=plant.name, channel=name, mend=mend)
        x, u = plant.equilibrium()
        eta = plant.effect_vector()
        memory = plant.settle(plant.output(x, None, u), eta)
        rest = np.array(plant.read(memory, np.zeros(len(plant.outputs)), eta), dtype=float)[self.outputs]  # as it is measured
        self.references, self.along = _moves(rest, own, law.dt, law.bandwidth[: len(own)])
        self.every = every
        held = np.repeat(self.references, every, axis=0)
        self.scenario = Scenario("job", dict(zip(law.references, held.T, strict=True)))
        self.dt = law.dt
        jumped = [slot.effect.domain is Domain.TIME and slot.parameter.name == "time" for slot in plant.slots]
        long_ago = lambda own: np.where(jumped, [slot.parameter.low for slot in plant.slots], own)  # noqa: E731
        self._aims: dict[tuple[float, ...], tuple[np.ndarray, np.ndarray]] = {}
        self.found = plant.nominal[None], long_ago(eta[None])
        p, drawn = box.vectors(np.random.default_rng(0).uniform(size=(DRAWN, box.n)))
        self.machines = np.vstack([self.found[0], p]), np.vstack([self.found[1], long_ago(drawn)])

    def run(self, law: ScheduledPID, p: np.ndarray, eta: np.ndarray, seed: int | None = None) -> Any:
        """Trajectories of machines (R), of one twice: compiling the program for a single run would take longer than the job."""
        p, eta = (np.repeat(own, 1 + (len(own) == 1), axis=0) for own in (p, eta))
        with np.errstate(all="ignore"):
            scenario = replace(self.scenario, seed=seed)
            return simulate_batch(self.plant, law, scenario, parameters=p, effects=eta, bumpless=True)

    def errors(self, given: "_Feedforward", p: np.ndarray, eta: np.ndarray, seed: int | None = None) -> np.ndarray:
        """(m - y) / size, (R, N, nr), of which self.along (N) says what they follow; m as late as it is due."""
        law = given.law
        run = self.run(law, p, eta, seed)
        m = np.array([self.aimed(law, own)[0] for own in run.measured[: len(p), 0, self.outputs]])
        if (n := given.due / self.dt).any():
            k = np.arange(m.shape[1])
            m = np.array([[np.interp(k - late, k, own) for late, own in zip(n, machine.T, strict=True)] for machine in m])
            m = np.moveaxis(m, 1, 2)
        return ((m - self._shown(run, p, eta)) / self.size)[:, HELD:]

    def _shown(self, run: Any, p: np.ndarray, eta: np.ndarray) -> np.ndarray:
        """What sensors (R, N, nr) would show of where the machine is, had it been there for ever: no lag, no play, no noise."""
        if self.plant.discrete:  # whose outputs may see a command that has not arrived yet
            return run.measured[: len(p), :: self.every, self.outputs]
        found = np.empty((len(p), len(self.references), len(self.outputs)))
        for own, x, numbers, sizes in zip(found, run.states, p, eta, strict=False):
            with np.errstate(all="ignore"):
                z = self.plant.output(list(x[:: self.every].T), numbers)
                read = self.plant.read(self.plant.settle(z, sizes), np.zeros(len(z)), sizes)
            own[:] = np.column_stack([np.broadcast_to(read[j], len(own)) for j in self.outputs])
        return found

    def aimed(self, law: ScheduledPID, begun: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """m and m' (N, nr) from a first measurement (nr,): the same for every law of the job, whatever it feeds forward."""
        key = tuple(begun.tolist())
        if key not in self._aims:
            self._aims[key] = law.aimed(self.references, begun)[:2]
        return self._aims[key]

    def drawn(self, given: "_Feedforward", seed: int | None = None) -> np.ndarray:
        """Root mean square errors (R, along) of the machine found and of the drawn ones; infinite where one leaves its range."""
        return np.nan_to_num(self._sizes(self.errors(given, *self.machines, seed)), nan=np.inf)

    def _sizes(self, e: np.ndarray) -> np.ndarray:
        """Root mean square (R, along) of errors (R, N, nr)."""
        return np.column_stack([np.sqrt(np.mean(e[:, self.along == k] ** 2, axis=(1, 2))) for k in np.unique(self.along)])

    def left(self, given: "_Feedforward", by: np.ndarray) -> np.ndarray:
        """Errors of the machine found in units of `by` (along): steps count for no more than smooth moves."""
        return (self.errors(given, *self.found)[0] / by[self.along][:, None]).ravel()

    def units(self, law: ScheduledPID, followed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What the numbers of a feedforward are counted in, and commands (nu,): a unit moves them by as much as the job does."""
        found = self.run(law, *self.found)
        commands = np.nanstd(found.commands[0][:, [self.plant.input_names.index(name) for name in law.actuated]], axis=0)
        commands = np.where(commands > 0.0, commands, 1.0)
        rate = self.aimed(law, found.measured[0, 0, self.outputs])[1]
        fastest = np.abs(rate).max(axis=0), np.abs(np.diff(rate, axis=0)).max(axis=0) / law.dt
        each = [np.divide.outer(commands, np.where(own > 0.0, own, 1.0)[followed]).ravel() for own in fastest]
        return np.concatenate(each), commands

    def tuned(self, given: _Feedforward) -> _Feedforward:
        """The feedforward that leaves least of m - y on the machine found."""
        by = np.maximum(self._sizes(self.errors(given, *self.found))[0], 1e-300)
        best, e = given, self.left(given, by)
        for _ in range(STEPS):
            if not np.isfinite(e).all():
                return given
            moved = [replace(best, numbers=best.numbers + STEP * one) for one in np.eye(len(best.numbers))]
            J = np.array([(self.left(own, by) - e) / STEP for own in moved]).T
            if not np.isfinite(J).all():
                return given
            size = np.linalg.norm(J, axis=0).max()
            padded = np.vstack([J, RIDGE * size * np.eye(J.shape[1])])
            way = np.linalg.lstsq(padded, -np.append(e, np.zeros(J.shape[1])), rcond=None)[0]
            for share in SHARES:
                tried = replace(best, numbers=best.numbers + share * way)
                after = self.left(tried, by)
                if after @ after < e @ e:  # not where it is NaN
                    break
            else:
                break
            best, done, e = tried, after @ after / (e @ e), after
            if done > ENOUGH:
                break
        return best

    def costs(self, key: str, given: "_Feedforward") -> float:
        """The share of the errors of the machine found that it would not have without an effect: along what that is most."""
        p, eta = self.found
        own = np.array([slot.key == key for slot in self.plant.slots])
        with_it, without = (self._sizes(self.errors(given, p, each)) for each in (eta, np.where(own, self.plant.neutral, eta)))
        return 1.0 - float(np.min(without / with_it))

    def against(self, key: str, given: _Feedforward, costs: float, early: bool) -> _Feedforward | str:
        """The feedforward with what cancels an effect, of shapes nothing yet; or why there is none, in words. costs: see
        `costs`.
        """
        effect, (kind, _, place) = next(slot.effect for slot in self.plant.slots if slot.key == key), key.partition("@")
        if kind not in (*AWAITED, *INVERTED) and not _speed_alone(self.plant, key):
            return "only what depends on a speed alone is, dead time, play, dead zones and slow sensors"
        if kind in AWAITED:  # whatever it costs: the feedforward was fitted beside it
            return self._awaiting(key, given, early)
        if not costs >= 1.0 - WORTH:
            return f"without it errors of set-points would be {max(costs, 0.0):.1%} less"
        if kind in INVERTED:
            return self._inverting(key, given)
        i = self.plant.state_names.index(self.plant.turning[place])
        if (told := self._told_by_set_points(given.law, i)) is None:
            return f"the set-points do not say how fast {place} moves"
        position, motion, rest, highest = told
        numbers = _numbers(self.plant, key, self.found[1][0])
        v = _nodes(numbers, highest)
        force = np.array([_opposing(effect, numbers, at) for at in v])
        over, force = f"speed of {place} [{self.plant.states[i].unit}]", force / np.abs(force).max()
        curves = (Curve(name, v - rest, force) for name in given.base.actuated)
        return given.with_shapes([Compensation(c.input, key, position, motion, c, over) for c in curves])

    def _awaiting(self, key: str, given: _Feedforward, early: bool) -> _Feedforward | str:
        """The loop awaits what an effect makes of m; of the longest dead time all outputs are as late."""
        sizes, law, (effect, _, place) = _numbers(self.plant, key, self.found[1][0]), given.base, key.partition("@")
        if place in self.plant.input_names:
            if law.paths.any() and not early:
                return f"outputs would follow {sizes.time:.4g} s after their paths: with --early paths are given that much early"
            later = max(sizes.time - given.dead, 0.0)
            changed, due, dead = {"late": law.late + later}, given.due + later, given.dead + later
        else:
            own, due = np.array([name == place for name in law.measured[: len(law.references)]], dtype=float), given.due
            dead = given.dead
            if not own.any():
                return f"the law does not control {place}"
            changed = {"play": law.play + own * sizes.half_width} if effect == "backlash" else {}
            changed |= {} if changed else {"late": law.late + own * sizes.time * 2.0 * getattr(sizes, "damping", 0.5)}
        if (late := changed.get("late", law.late)).max() >= LONGEST_LATE * law.dt:
            return f"{late.max():.4g} s is more than {LONGEST_LATE} samples"
        return replace(given, base=replace(law, **changed), due=due, dead=dead)

    def _inverting(self, key: str, given: _Feedforward) -> _Feedforward | str:
        """The command before an effect, whose side the noise of the law does not change."""
        sizes, law, (effect, _, place) = _numbers(self.plant, key, self.found[1][0]), given.base, key.partition("@")
        if place not in law.actuated:
            return f"the law does not command {place}"
        size = {"half_width": sizes.half_width} if effect == "dead-zone" else {"play": sizes.play}
        before = next((own for own in law.inverses if own.input == place), None)
        keep = QUIET * self._noise(law)[law.actuated.index(place)]
        own = replace(before, **size) if before else Inverse(place, key, **size, keep=keep)
        return replace(given, base=replace(law, inverses=(*(x for x in law.inverses if x is not before), own)))

    def _noise(self, law: ScheduledPID) -> np.ndarray:
        """Standard deviations (nu,) of commands by the noise of the sensors alone, in the middle of the schedule."""
        omega = np.pi / law.dt * (np.arange(FINE) + 0.5) / FINE
        K = law.gains_at(law.span.mean(axis=-1) if law.schedule else None)
        direct = parts(omega, law.dt, law.Tf)[:, 2, None, None] * K.Kd + K.Kp
        sigma = np.array([self.plant.noise.get(name, 0.0) for name in law.measured])
        return np.sqrt(np.mean(np.abs(direct * sigma) ** 2, axis=0).sum(axis=-1))

    def _told_by_set_points(self, law: ScheduledPID, state: int) -> tuple[np.ndarray, np.ndarray, float, float] | None:
        """Weights of m and of m' (nr,), and what is added, that give a state where nothing rubs; and the largest of it. None
        where they do not give it.
        """
        rubbing = [slot.effect.family == Shaft.family for slot in self.plant.slots]
        run = self.run(law.uncompensated, self.found[0], np.where(rubbing, self.plant.neutral, self.found[1]))
        if not np.isfinite(run.measured).all():
            return None
        m, rate = self.aimed(law, run.measured[0, 0, self.outputs])
        smooth = np.append(np.zeros(HELD, dtype=int), self.along) == 0  # after a step it is not where it is wanted
        v, nr = run.states[0, :: self.every, state][smooth], m.shape[1]
        every = np.column_stack([m, rate, np.ones(len(m))])[smooth]
        size = np.append(np.std(every[:, :-1], axis=0), 1.0)
        used = size > 0.0
        for _ in range(2):  # once more without what is slight
            found = np.zeros(len(size))
            found[used] = np.linalg.lstsq(every[:, used] / size[used], v, rcond=None)[0] / size[used]
            parts = np.abs(found) * size
            used &= parts > SLIGHT * parts.max()
        if np.mean((v - every @ found) ** 2) > (1.0 - EXPLAINED) * np.var(v):
            return None
        return found[:nr], found[nr:-1], float(found[-1]), float(np.abs(v).max())


def _numbers(plant: Plant, key: str, eta: np.ndarray) -> Named:
    """The numbers of an effect."""
    return Named({slot.parameter.name: eta[i] for i, slot in enumerate(plant.slots) if slot.key == key})


def _speed_alone(plant: Plant, key: str) -> bool:
    """Whether an effect acts on what turns or slides, by its speed alone."""
    effect = next((slot.effect for slot in plant.slots if slot.key == key), None)
    if effect is None or effect.family != Shaft.family:
        return False
    return bool(np.isfinite(_opposing(effect, _numbers(plant, key, plant.neutral), 0.5)))


def _opposing(effect: Effect, numbers: Named, speed: float) -> float:
    """What opposes a law of a shaft at a speed, long after its start; NaN where it depends on more than that."""
    return -float(effect.law(numbers, Named({"speed": speed, "angle": np.nan, "load": np.nan, "t": FOREVER})))


def _nodes(numbers: Named, highest: float) -> np.ndarray:
    """Speeds between which a curve is straight: close together where a law changes its sign, even up to the highest."""
    width = getattr(numbers, "width", highest) if "width" in vars(numbers) else highest
    up = np.unique([*(own * width for own in NODES if own * width < highest), *np.linspace(0.0, highest, EVEN)])
    up = up[np.append(True, np.diff(up) > 1e-3 * min(width, highest))]
    return np.concatenate([-up[:0:-1], up])


def _moves(rest: np.ndarray, moved: Sequence[Moved], dt: float, bandwidth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Set-points (N, nr): one after the other goes up and down in its range, at speeds up to the fastest of the records, and
    stands between; then those with a reference model step; from rest (nr,). And after HELD samples what each is of ALONG.
    """
    random, at, found = np.random.default_rng(0), rest.copy(), [np.repeat(rest[None], HELD, axis=0)]
    for j, own in enumerate(moved):
        for goal in _goals(own, random):
            target = at.copy()
            target[j] = goal
            rate = own.rate * random.uniform(SLOWEST, 1.0)
            n = int(np.clip(1.875 * abs(goal - at[j]) / (rate * dt), SHORTEST, LONGEST))  # of which 1.875 is the peak
            found += [at + from_rest_to_rest(n) * (target - at)]
            found += [np.repeat(target[None], int(STANDS * n) + 1, axis=0)]
            at = target
    smooth = sum(map(len, found)) - HELD
    for j, (own, width) in enumerate(zip(moved, bandwidth.tolist(), strict=True)):
        for goal in _goals(own, random) if width < np.inf else []:
            at = at.copy()
            at[j] = goal
            found.append(np.repeat(at[None], int(np.clip(DIED / (width * dt), SHORTEST, LONGEST)), axis=0))
    references = np.concatenate(found)
    return references, np.repeat([0, 1], [smooth, len(references) - HELD - smooth])


def _goals(own: Moved, random: np.random.Generator) -> Iterator[float]:
    """Set-points to and fro about the middle of a range."""
    middle, half = 0.5 * (own.low + own.high), 0.5 * INNER * (own.high - own.low)
    for k in range(MOVES):
        yield float(middle + (-1) ** k * half * random.uniform(0.4, 1.0))
