"""What was missing, drawn over what it depends on: torque over speed, tension over angle, reading over level.

    partial residual  r_k = g(x_k) + K_k e_k / dt

g is what the effect adds to the rate of change of a state, K_k e_k / dt by how much the filter that knows the effect still has to
correct that state so as to follow the record. Without the effect the simulation says 0, with it g; where the points leave g, the
effect has another shape. W. A. Larsen, S. J. McCleary, "The use of partial residual plots in regression analysis", 1972.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from workbench.data import Channel, Dataset
from workbench.diagnosis.calibrate import along
from workbench.diagnosis.predictor import Course, Predictor
from workbench.errors import InputError
from workbench.physics.effects.effect import Domain, Effect, Named
from workbench.physics.effects.robot import Robot
from workbench.physics.effects.shaft import Slide
from workbench.physics.effects.spring import Spring
from workbench.physics.parameters import EffectSizes, Slot
from workbench.physics.plant import Plant
from workbench.records import field, record

BINS = 24  # along what it depends on
FEWEST = 5  # samples in a bin that is drawn


@record
class Shown:
    """What is missing over `over`, in bins: mean and its standard deviation as measured, and as simulated before and after.

    over: what it depends on, a value for each bin. All (n).
    """

    over: Channel
    what: Channel
    x: np.ndarray = field("n")
    measured: np.ndarray = field("n")
    deviation: np.ndarray = field("n", low=0.0)
    before: np.ndarray = field("n")
    after: np.ndarray = field("n")


@record
class _Scene:
    """A record with the predictor that knows the effect, its course, and the effect's numbers eta (ne), and without (ne)."""

    t: np.ndarray
    effect: Effect
    place: str
    predictor: Predictor
    course: Course
    eta: np.ndarray
    without: np.ndarray


@record
class _Points:
    """Samples of a picture, before they are gathered in bins."""

    over: Channel
    what: Channel
    x: np.ndarray = field("N")
    measured: np.ndarray = field("N")
    before: np.ndarray = field("N")
    after: np.ndarray = field("N")


def shown(plant: Plant, effects: EffectSizes, key: str, dataset: Dataset) -> Shown | None:
    """The effect `key` of a plant with `effects`, in its domain, from all records whose runs last.

    None where none does, and where a time shift is the picture.

    plant: with fitted parameters, without the effects. A phase belongs to the first record, so an angle is drawn from that alone.
    """
    slots = [slot for slot in plant.slots if slot.key == key]
    if not slots:
        raise InputError(f"no effect {key!r}", file=plant.name)
    effect = slots[0].effect
    if effect.domain is Domain.SHIFT:
        return None
    records = dataset.experiments[:1] if effect.domain is Domain.ANGLE else dataset.experiments
    scenes = [scene for e in records if (scene := _scene(plant, effects, slots[0], Dataset((e,))))]
    if not scenes:
        return None
    draw = _DRAWN.get(effect.domain, _missing_rate)
    return _gathered([draw(scene) for scene in scenes], effect.domain)


def _scene(plant: Plant, effects: EffectSizes, slot: Slot, one: Dataset) -> _Scene | None:
    found = along(replace(plant, effects={**plant.effects, **effects}), one).predictor
    t, eta = one.experiments[0].t - one.experiments[0].t[0], found.point.eta[0]
    own = np.array([other.key == slot.key for other in plant.slots])
    course = found.course(0)
    return course and _Scene(t, slot.effect, slot.place, found, course, eta, np.where(own, plant.neutral, eta))


# ---- one picture for each kind of domain -------------------------------------------------------------------------------


def _missing_rate(scene: _Scene) -> _Points:
    """Torque, force or rate of change of the state in which the effect shows best."""
    missing = scene.course.missing
    added = _rates(scene, scene.eta) - _rates(scene, scene.without)
    moved = np.any(added, axis=0)  # noise may enter elsewhere than an effect does
    entries = [j for j in _entries(scene) if moved[j]] or np.flatnonzero(moved).tolist() or _entries(scene)
    clear = [np.sqrt(np.mean(added[:, j] ** 2)) / (np.std(missing[:, j]) + 1e-300) for j in entries]
    j = entries[int(np.argmax(clear))]
    what, scale = _unit(scene, added[:, j], j)
    over, x = _over(scene, added[:, j])
    return _Points(over, what, x, scale * (added[:, j] + missing[:, j]), np.zeros(len(x)), scale * added[:, j])


def _entries(scene: _Scene) -> list[int]:
    """The states in which something may be missing; in a discrete plant noise has states of its own, so all."""
    plant = scene.predictor.plant
    return [j for j, name in enumerate(plant.state_names) if plant.discrete or name in scene.predictor.entries]


def _rates(scene: _Scene, eta: np.ndarray) -> np.ndarray:
    """Rates of change (N, nx) along the course with effects eta."""
    rates = scene.predictor.plant.derivative(*_along(scene, eta), **_beside(scene))
    return np.column_stack([np.broadcast_to(rate, len(scene.t)) for rate in rates])


def _along(scene: _Scene, eta: np.ndarray) -> tuple:
    """States, inputs that act, parameters and effects of the equation, along the course."""
    plant, u = scene.predictor.plant, list(scene.predictor.records[0].u.T)
    return list(scene.course.x.T), plant.drive(u, eta, scene.t), scene.predictor.point.p, eta


def _beside(scene: _Scene) -> dict:
    """Time, angles, own states of effects, and rates of inputs along the course."""
    plant, u = scene.predictor.plant, scene.predictor.records[0].u
    swing = [np.gradient(u[:, plant.input_names.index(name)], plant.dt) for name in plant.swinging]
    return {"t": scene.t, "angle": list(scene.course.angle.T), "inner": list(scene.course.inner.T), "rate": swing}


def _unit(scene: _Scene, added: np.ndarray, j: int) -> tuple[Channel, float]:
    """What is drawn and its size per rate of change of state j: for a torque or a force that itself."""
    state = scene.predictor.plant.states[j]
    push = _push(scene)
    if push is None or not np.any(added):
        return Channel(f"missing rate of {state.name}", _per_second(state.unit)), 1.0
    turns = scene.effect.family == "shaft" and not isinstance(_port(scene), Slide)
    what = Channel(f"missing {'torque' if turns else 'force'} at {scene.place}", "N m" if turns else "N")
    return what, float(np.dot(push, added) / np.dot(added, added))


def _push(scene: _Scene) -> np.ndarray | None:
    """The torque or force (N,) of an effect, if it is one that its law gives alone."""
    plant, effect, port = scene.predictor.plant, scene.effect, _port(scene)
    if effect.family not in ("shaft", "robot") or effect.domain is Domain.LOAD:
        return None
    own = Named({s.parameter.name: value for s, value in zip(plant.slots, scene.eta, strict=True) if s.key == _key(scene)})
    if isinstance(port, Robot):
        arm = scene.predictor.records[0].u[:, plant.input_names.index(port.arm)]
        force, _ = effect.law(own, Named({"arm": arm, "arm_rate": np.gradient(arm, plant.dt), "t": scene.t}))
        return np.broadcast_to(force, len(arm)) if np.any(force) else None
    course = scene.course
    speed, turned = course.x[:, plant.state_names.index(port.speed)], course.angle[:, list(plant.turning).index(scene.place)]
    return effect.law(own, Named({"speed": speed, "angle": turned, "t": scene.t, "load": 0.0}))


def _port(scene: _Scene):
    return next(q for q in scene.predictor.plant.all_ports if (q.family, q.place) == (scene.effect.family, scene.place))


def _per_second(unit: str) -> str:
    """m/s^2 for m/s, m/s for m."""
    return f"{unit}^2" if unit.endswith("/s") else f"{unit or '1'}/s"


def _key(scene: _Scene) -> str:
    return f"{scene.effect.id}@{scene.place}"


def _over(scene: _Scene, added: np.ndarray) -> tuple[Channel, np.ndarray]:
    """What the effect depends on."""
    plant, course, domain = scene.predictor.plant, scene.course, scene.effect.domain
    if domain is Domain.TIME:
        return Channel("t", "s"), scene.t
    if domain is Domain.ANGLE:
        arms = [q.arm for q in plant.ports if q.place == scene.place and hasattr(q, "arm")]
        if scene.effect.family == "robot" and arms:
            i = plant.input_names.index(arms[0])
            return plant.inputs[i], scene.predictor.records[0].u[:, i]
        turned = course.angle[:, list(plant.turning).index(scene.place)]
        return Channel(f"angle of {scene.place}", "rad"), np.mod(turned, 2 * np.pi)
    if isinstance(port := _port(scene), Spring):
        seen = plant.seen_by(_key(scene), *_along(scene, scene.eta), **_beside(scene))
        return Channel(f"stretch of {scene.place}", port.stretch), np.broadcast_to(seen.stretch, len(scene.t))
    tensions = {q.place: q.tension for q in plant.ports if hasattr(q, "tension")}
    if domain is Domain.SPEED and scene.place in plant.turning:
        j = plant.state_names.index(plant.turning[scene.place])
    elif domain is Domain.TENSION and scene.place in tensions:
        j = plant.state_names.index(tensions[scene.place])
    elif domain is Domain.HEAD:
        j = plant.state_names.index(port.level)
    else:  # a load is no state: the one that goes with it stands for it
        j = int(np.argmax([abs(_correlation(added, course.x[:, j])) for j in range(len(plant.states))]))
    return plant.states[j], course.x[:, j]


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    spread = float(np.std(a) * np.std(b))
    return float(np.mean((a - a.mean()) * (b - b.mean()))) / spread if spread > 0.0 else 0.0


def _acting(scene: _Scene) -> _Points:
    """What acts over what was commanded, from the state that the input moves most clearly."""
    plant, course, u = scene.predictor.plant, scene.course, scene.predictor.records[0].u
    i, middle = plant.input_names.index(scene.place), len(course.x) // 2
    B = plant.linearize(course.x[middle], u[middle], scene.predictor.point.p, scene.without)[1][:, i]
    entries = [j for j in _entries(scene) if B[j]]
    j = max(entries, key=lambda j: abs(B[j]) / (np.std(course.missing[:, j]) + 1e-300))
    lost = np.broadcast_to(plant.drive(list(u.T), scene.eta, scene.t)[i], len(u)) - u[:, i]
    channel = plant.inputs[i]
    what = Channel(f"{channel.name} that acts, less {channel.name}", channel.unit)
    return _Points(channel, what, u[:, i], lost + course.missing[:, j] / B[j], np.zeros(len(u)), lost)


def _reading(scene: _Scene) -> _Points:
    """What a sensor reads less what there is, over what there is."""
    plant, r, course = scene.predictor.plant, scene.predictor.records[0], scene.course
    i = plant.output_names.index(scene.place)
    level = np.broadcast_to(plant.output(list(course.x.T), scene.predictor.point.p, list(r.u.T))[i], len(r.u))
    channel = plant.outputs[i]
    what = Channel(f"reading less {channel.name}", channel.unit)
    return _Points(channel, what, level, r.y[:, i] - level, np.zeros(len(level)), course.predicted[:, i] - level)


_DRAWN: Mapping[Domain, Callable[[_Scene], _Points]] = {Domain.COMMAND: _acting, Domain.LEVEL: _reading}


def _gathered(points: list[_Points], domain: Domain) -> Shown:
    """Means in bins of equally many samples; of an angle or a time, bins of equal width."""
    x, measured, before, after = (
        np.concatenate([getattr(q, name) for q in points]) for name in ("x", "measured", "before", "after")
    )
    edges = np.quantile(x, np.linspace(0.0, 1.0, BINS + 1))
    if domain in (Domain.ANGLE, Domain.TIME):
        edges = np.linspace(x.min(), x.max(), BINS + 1)
    at = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, BINS - 1)
    whole = np.isfinite(measured) & np.isfinite(after)
    kept = [whole & (at == b) for b in range(BINS)]
    kept = [mask for mask in kept if mask.sum() >= FEWEST]

    def mean(values: np.ndarray) -> np.ndarray:
        return np.array([np.mean(values[mask]) for mask in kept])

    deviation = np.array([np.std(measured[mask]) / np.sqrt(mask.sum()) for mask in kept])
    return Shown(points[0].over, points[0].what, mean(x), mean(measured), deviation, mean(before), mean(after))
