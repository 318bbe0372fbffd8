"""One run of a law on the most truthful simulation at hand: frozen margins do not say that a loop holds its machine.

Every set-point steps over its range and back, without noise: on the plant where there is one, else on the identified model, whose
schedule follows the output that it is, or goes once along its span. The run is lost where it leaves the plant's range, or any,
or where it stays away from a set-point by more than half of the step.
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from workbench.hammerstein import Model, behind, curves_of
from workbench.lpv import LPVModel, ends
from workbench.physics.controller import schedules_of
from workbench.physics.plant import Plant
from workbench.records import field, record
from workbench.rehearsal import Rehearsal
from workbench.robustness.frozen import closed_loop
from workbench.robustness.linear_law import without_linear_form
from workbench.simulation import LeftRangeError, Scenario, simulate
from workbench.steady import gain, rests

POINTS = 5  # schedule values at which loops are asked how slow they are
SETTLED = 5.0  # time constants of the slowest pole that a set-point is held
SHORTEST, LONGEST = 50, 3000  # samples that it is held at least, at most
PLANNED = 300  # samples at most that a law that plans at every one is given
LATE = 5  # times that, for a slew or a reference model
SHARES = (1.0, 0.1, 0.01)  # of a step on a plant whose range nobody knows: its loop is lost if it is at all of them
SHARE = 0.5  # of the room that limits leave, for a step; of a step, from where on an error is lost
ALONG = 1000  # samples at least along a schedule that moves on its own
EDGE = 0.1  # of a schedule's span that steps stay within
OVERSHOOT = 0.2  # of a step, from where on it is said
BAND = 0.05  # of its step within which an output has settled
FAR = 1e3  # steps, beyond which a run on a linear model is lost
SAME = 0.1  # of the span within which an output of the operating point is the schedule


@record
class Trial:
    """What one run said: where it ran, and why it was lost, "" where it was not.

    beyond (nr): by set-point how far its output goes beyond it, as a share of the step. settled (nr) [s]: by set-point how long
    after a step of it some output is still further than BAND of its own step from where it is wanted.
    """

    where: str
    lost: str
    sentence: str
    beyond: np.ndarray = field("nr", default=())
    settled: np.ndarray = field("nr", unit="s", default=())

    @property
    def overshoot(self) -> float:
        """The largest of an output beyond its set-point, as a share of the step."""
        return float(self.beyond.max(initial=0.0))


def on_model(
    law: Any, model: Model, setpoint: Sequence[float] | None = None, steps: Mapping[str, float] = MappingProxyType({})
) -> Trial:
    """The law on the model it was designed for, from rest at the usual set-point; behind its curves where it has some. steps: by
    output, where not as far as unit inputs move it, or the limits of commands.
    """
    (straight, model), curves = behind(law, model), curves_of(model)
    if np.any(model.D):
        why = "its outputs see the command of their own sample, which held commands cannot do"
        mend = "identify --no-feedthrough, or give --plant"
        return Trial(f"the model {model.name}", why, f"not tried on the model {model.name}: {why} ({mend})")
    follows, (low, high) = followed(model), ends(model.spans)
    first = low + EDGE * (high - low) if follows is not None else low
    phi = model.operating_point.basis(np.array(first))
    rest = np.array(_held(straight, model, phi) if setpoint is None else setpoint, dtype=float)
    step = _steps(straight, model, rest, steps)
    if follows is not None:
        rest[follows], step[follows] = first, (1.0 - 2.0 * EDGE) * (high - low)
    names = [c.name for c in model.outputs]
    own = [names.index(name) for name in law.measured[: len(law.references)]]
    rest[own], step[own] = _inside(law, rest[own], step[own])
    settling = _settling(straight, model, step[own])
    references = _path(rest, step, settling, [name in smooth(law) for name in names])
    N = len(references)
    if model.schedules and follows is None and N < ALONG:
        references, N = np.repeat(references, -(-ALONG // N), axis=0), N * -(-ALONG // N)
    rho = model.path(N) if follows is None else np.full(N, first)
    run = Rehearsal(model, references, rho, np.zeros_like(references), np.ones(len(rest)), follows, curves)
    with np.errstate(over="ignore", invalid="ignore"):
        _, y = run.run(law)
    moving = ", ".join(c.name for c in model.schedules)
    where = f"the model {model.name}" + f", {moving} {_moves(model, follows)}" * bool(moving)
    size = np.maximum(np.abs(references - references[0]).max(axis=0), 1e-300)
    away = np.abs(y - references) / size
    if (gone := ~(np.isfinite(away) & (away < FAR))[:, own].all(axis=1)).any():
        return _lost(where, f"it runs away {model.dt * int(gone.argmax()):.4g} s after its start")
    units = [model.outputs[i].unit for i in own]
    return _judged(where, law, references[:, own], y[:, own], units, model.dt, settling)


def on_plant(law: Any, plant: Plant, model: Model, steps: Mapping[str, float] = MappingProxyType({})) -> Trial:
    """The law on a plant, from the plant's own rest; a schedule that is an output is stepped over the law's span. steps: as for
    the model.
    """
    straight, model = behind(law, model)
    names = [c.name for c in model.outputs]
    own = [names.index(name) for name in law.measured[: len(law.references)]]
    begun = simulate(plant, law, _scenario(law, np.zeros((2, len(own)))), bumpless=True, cut=True).experiment
    rest = np.array([begun[name][0] for name in law.measured[: len(law.references)]])
    step = _steps(straight, model, model.operating_point.basis(model.middle) @ model.operating_point.y, steps)[own]
    scheduled = dict(zip(schedules_of(law), np.reshape(getattr(law, "span", model.spans), (-1, 2)), strict=False))
    known = [name for name in scheduled if name in law.measured[: len(law.references)]]
    for name in known:
        j, (low, high) = law.measured.index(name), scheduled[name]
        inner = low + EDGE * (high - low), high - EDGE * (high - low)
        step[j] = max(inner, key=lambda end: abs(end - rest[j])) - rest[j]
    settling, every = _settling(straight, model, step), max(1, round(law.dt / plant.dt))
    for share in (1.0,) if known else SHARES:
        paths = [name in smooth(law) for name in law.measured[: len(law.references)]]
        path = np.repeat(_path(rest, share * step, settling, paths), every, axis=0)
        if not (trial := along(law, plant, path, settling * every)).lost:
            break
    return trial


def tried(
    law: Any, model: Model, plant: Plant | None, setpoint: Sequence[float] | None = None,
    steps: Mapping[str, float] = MappingProxyType({}),
) -> Trial:  # fmt: skip
    """On the plant where there is one, else on the model."""
    return on_model(law, model, setpoint, steps) if plant is None else on_plant(law, plant, model, steps)


def along(law: Any, plant: Plant, references: np.ndarray, settling: int, start: dict[str, float] | None = None) -> Trial:
    """The law on a plant along set-points (N, nr), a row for each sample of the plant; settling: samples that a step may take."""
    where = f"the plant {plant.name}"
    try:
        run = simulate(plant, law, _scenario(law, references, start), bumpless=True).experiment
    except LeftRangeError as reason:
        return _lost(where, f"{reason.channel or 'it'} leaves its range: {reason.problem}")
    measured = law.measured[: len(law.references)]
    units = [next(c.unit for c in plant.outputs if c.name == name) for name in measured]
    return _judged(where, law, references, np.column_stack([run[name] for name in measured]), units, plant.dt, settling)


def followed(model: LPVModel) -> int | None:
    """Which output the schedule is: by its name, or because it is that in every operating point; None where it is none."""
    if len(model.schedules) != 1 or model.schedule is None:
        return None
    names = [c.name for c in model.outputs]
    if model.schedule.name in names:
        return names.index(model.schedule.name)
    rho = np.linspace(model.span[0], model.span[1], POINTS)
    off = np.abs(model.operating_point.basis(rho) @ model.operating_point.y - rho[:, None]).max(axis=0)
    j = int(off.argmin())
    return j if off[j] <= SAME * np.ptp(model.span) else None


def _moves(model: LPVModel, follows: int | None) -> str:
    if follows is not None:
        return f"following {model.outputs[follows].name}"
    return "going once along its span" if len(model.schedules) == 1 else "going through their box"


def _scenario(law: Any, references: np.ndarray, start: dict[str, float] | None = None) -> Scenario:
    return Scenario("trial", dict(zip(law.references, references.T, strict=True)), None, start or {})


def smooth(law: Any) -> list[str]:
    """The outputs whose set-points are paths to a law: their differences are fed forward, and a step is none of them."""
    return [name for name, path in zip(law.measured, getattr(law, "paths", ()), strict=False) if path]


def from_rest_to_rest(samples: int) -> np.ndarray:
    """Shares (samples, 1) of a move that begins and ends at rest: 10 t^3 - 15 t^4 + 6 t^5."""
    t = np.linspace(0.0, 1.0, samples)[:, None]
    return t**3 * (10.0 + t * (6.0 * t - 15.0))


def _path(rest: np.ndarray, step: np.ndarray, hold: int, smooth: Sequence[bool]) -> np.ndarray:
    """Set-points (N, ny): at rest, then each output in turn a step away and back, held for so many samples each time; of a smooth
    one over as many samples as it is held.
    """
    share = from_rest_to_rest(hold)
    found = [np.tile(rest, (hold, 1))]
    for j, way in enumerate(smooth):
        away = np.where(np.arange(len(rest)) == j, rest + step, rest)
        for begin, end in ((rest, away), (away, rest)):
            found += [begin + share * (end - begin)] * bool(way)
            found.append(np.tile(end, (hold, 1)))
    return np.concatenate(found)


def _steps(law: Any, model: LPVModel, rest: np.ndarray, given: Mapping[str, float]) -> np.ndarray:
    """For each output the step that is given, else one that the limits of commands leave room for in the middle, unless the model
    integrates no larger than what unit inputs move; without limits that.
    """
    middle = model.middle if model.schedules else None
    A, B, C, D = model.freeze(middle)
    moved = gain(A, B, C, D, model.free)
    phi, point = model.operating_point.basis(model.middle), model.operating_point
    need = np.linalg.pinv(moved)
    u = phi @ point.u + rests(A, B, C, D)[1] @ (rest - phi @ point.y)
    acts, low, high = _commands(law, model)
    room = np.minimum(u[acts] - low, high - u[acts])
    reach = np.min(np.maximum(room, 0.0)[:, None] / np.maximum(np.abs(need[acts]), 1e-300), axis=0)
    free = np.linalg.norm(moved, axis=1)
    usual = np.where(np.isfinite(reach) & (reach > 0.0), SHARE * reach if model.free else np.minimum(SHARE * reach, free), free)
    return np.array([given.get(c.name, own) for c, own in zip(model.outputs, usual, strict=True)])


def _held(law: Any, model: LPVModel, phi: np.ndarray) -> np.ndarray:
    """Outputs (ny) at the model's operating point; where that asks for commands beyond their limits, at one that these hold.

    A model of a pump may count from a standstill that no record and no law comes near.
    """
    y, u = phi @ model.operating_point.y, phi @ model.operating_point.u
    acts, low, high = _commands(law, model)
    if model.free or np.all((u[acts] >= low) & (u[acts] <= high)):
        return y
    A, B, C, D = model.freeze(model.middle if model.schedules else None)
    return y + gain(A, B, C, D)[:, acts] @ (_middle(u[acts], low, high) - u[acts])


def _commands(law: Any, model: LPVModel) -> tuple[list[int], np.ndarray, np.ndarray]:
    """Which inputs of the model a law commands, and their limits."""
    acts, none = [[c.name for c in model.inputs].index(name) for name in law.actuated], np.full(len(law.actuated), np.inf)
    return acts, getattr(law, "low", -none), getattr(law, "high", none)


def _middle(values: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Between two limits the middle, where there is one alone the value that it lets through."""
    both = np.isfinite(low) & np.isfinite(high)
    return np.where(both, 0.5 * (np.where(both, low, 0.0) + np.where(both, high, 0.0)), np.clip(values, low, high))


def _inside(law: Any, rest: np.ndarray, step: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Set-points and steps within the limits that a law keeps its outputs in, where it has any: nothing else is asked of it."""
    low, high = getattr(law, "y_low", np.full(len(rest), -np.inf)), getattr(law, "y_high", np.full(len(rest), np.inf))
    rest = np.where((rest >= low) & (rest <= high), rest, _middle(rest, low, high))
    up, down = high - rest, rest - low
    return rest, np.where(step <= up, step, np.where(step <= down, -step, np.where(up >= down, up, -down)))


def _settling(law: Any, model: LPVModel, step: np.ndarray) -> int:
    """Samples in which the slowest frozen loop settles after steps (nr,) of its set-points, however late it lets them arrive."""
    planned = hasattr(law, "fallback")
    linear, slowest = getattr(law, "fallback", law), 0.0
    if not without_linear_form(getattr(linear, "uncompensated", linear)):
        for rho in model.frozen_values(POINTS):
            slowest = max(slowest, float(np.abs(closed_loop(linear, model, rho).system.poles).max()))
    samples = LONGEST if slowest >= 1.0 else SETTLED / -np.log(max(slowest, 1e-6))
    late = min(linear.arrival(step) / law.dt, LATE * LONGEST) if hasattr(linear, "arrival") and not planned else 0.0
    return int(np.clip(samples, SHORTEST, PLANNED if planned else LONGEST) + late)


def _judged(where: str, law: Any, r: np.ndarray, y: np.ndarray, units: Sequence[str], dt: float, settling: int) -> Trial:
    """Whether outputs (N ny) end near set-points (N ny) that have stood for as long as the loop takes to settle."""
    size = np.abs(r - y[0]).max(axis=0)
    changes = np.flatnonzero(np.any(np.diff(r, axis=0) != 0.0, axis=1)) + 1
    stays = [(int(a), int(b)) for a, b in zip((0, *changes), (*changes, len(r)), strict=True) if b - a >= settling]
    over, settled = np.zeros(len(size)), np.zeros(len(size))
    kicks = np.zeros((len(size), len(size)))  # of each output by steps of each set-point
    before = r[0]
    for begun, end in stays:
        moved, before = r[begun] - before, r[begun]
        beyond = (np.sign(moved) * (y[begun:end] - r[begun])).max(axis=0)
        over = np.where(moved != 0.0, np.maximum(over, beyond / np.maximum(np.abs(moved), 1e-300)), over)
        away = np.abs(y[begun:end] - r[begun])
        stood = np.outer(moved == 0.0, moved != 0.0)
        kicks = np.where(stood, np.maximum(kicks, away.max(axis=0)[:, None]), kicks)
        still = np.flatnonzero((away > BAND * size).any(axis=1))
        own = np.inf if len(still) and still[-1] == end - begun - 1 else dt * (still[-1] + 1 if len(still) else 0)
        settled = np.where(moved != 0.0, np.maximum(settled, own), settled)
        last = slice(end - max(1, settling // 5), end)
        off = np.sqrt(np.mean((r[last] - y[last]) ** 2, axis=0))
        for name, unit, error, step in zip(law.measured, units, off, size, strict=False):
            if step > 0.0 and error > SHARE * step:
                away = f"{name} stays {error:.3g} {unit}".rstrip() + f" away from its set-point until {dt * end:.4g} s"
                first = f"from {r[0, law.measured.index(name)]:.4g} {unit}".rstrip()
                return _lost(where, f"{away}, after a step of {step:.3g} {unit}".rstrip() + f" {first}")
    each = list(zip(law.measured, units, size, r[0], over, strict=False))
    steps = ", ".join(f"{name} {step:.3g} {unit}".rstrip() + f" from {first:.4g}" for name, unit, step, first, _ in each)
    said = f"tried on {where}: steps of {steps} for {dt * len(r):.4g} s, none lost"
    took = ", ".join(f"{own:.3g} s ({name})" for name, own in zip(law.measured, settled, strict=False) if 0.0 < own < np.inf)
    said += f"; settled to {BAND:.0%} in {took}" * bool(took)
    if never := [name for name, own in zip(law.measured, settled, strict=False) if own == np.inf]:
        said += f"; not settled to {BAND:.0%} before the next step after steps of {', '.join(never)}"
    far = [f"{name} overshoots by up to {share:.0%} of its step" for name, *_, share in each if share > OVERSHOOT]
    for (name, unit, *_), own, whole in zip(each, kicks, size, strict=True):
        if own.max(initial=0.0) > OVERSHOOT * whole > 0.0:
            by = f"a step of {law.measured[int(own.argmax())]} moves {name}"
            far.append(f"{by} by up to {own.max():.3g} {unit}".rstrip())
    return Trial(where, "", said + "".join(f"; {own}" for own in far), over, settled)


def _lost(where: str, why: str) -> Trial:
    return Trial(where, why, f"the loop is lost on {where}: {why}")
