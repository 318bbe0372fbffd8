"""The compiled step: plant equation, effects and sampled controller, in blocks of lanes.

Between samples the inputs are held, or those of a record go on as its plant says (`Plant.between`):

    u(t) = u_k + (u_k+1 - u_k) s + c(s),   v(t) = v_k + (v_k+1 - v_k) s + g c(s),   s = t / dt - k

with what an actuator makes of them, v, by its gain g there: c is a cubic, 0 at both ends and everywhere on a straight line.

A hold that a dead time shifts changes inside the sample: the integrator's grid gets one more point for each input, placed where
its hold changes, so that every delay is exact and a delay of 0 adds a step of length 0. Effects are numbers in the work array:
switching one on compiles nothing.
"""

import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import lru_cache
from types import ModuleType
from typing import Any

import casadi as ca
import numpy as np
from scipy.interpolate import CubicSpline

from workbench.errors import InputError
from workbench.physics.controller import Controller, Playback, Stepped, rho_of, schedules_of
from workbench.physics.effects.effect import FOREVER
from workbench.physics.kernel import SCALAR, SIMD, Code, Rows, Switched, kernel_source, load_kernel, print_function
from workbench.physics.plant import Plant, shares
from workbench.physics.symbolic import column, entries, symbolic_numpy
from workbench.records import field, record

CUBIC, TINY = 4, 1e-300  # samples of a spline; of an input that does not move
FEW = 2  # runs that take less time in the scalar kernel than in a block of the other


@record
class Lanes:
    """R runs side by side. Shapes: (R, ...) for what differs between runs; time is samples first.

    start: states at the first sample; hold: inputs before it; reference, disturbance (on the inputs), noise (on the
    outputs): by sample.
    """

    parameters: np.ndarray = field("R np")
    effects: np.ndarray = field("R ne")
    gains: np.ndarray = field("R ng")
    memory: np.ndarray = field("R nc")  # of the controller
    start: np.ndarray = field("R nx")
    hold: np.ndarray = field("R nu")
    reference: np.ndarray = field("R N nr")
    disturbance: np.ndarray = field("R N nu")
    noise: np.ndarray = field("R N ny")


@record
class Steering:
    """What besides its equation may move a run, by sample, for the full state of n = nx states, angles, effects' own states and
    sensor memories.

    observed (N, ny), gain (N, m, ny) and corrected (m): after every sample these entries of the full state, all by default, are
    corrected by gain (observed - predicted), for all runs alike; NaN in `observed` corrects nothing. restart (N, n, R): every
    sample starts from the state given here instead of the one arrived at; where it is NaN the run goes on. push (N, nx, R): is
    added to the states' rates of change, constant over each sample. decay (nx + nu + ny): what the filter estimates beside the
    full state, added to rates of change, to inputs and to readings, constant over a sample and faded by this factor from one to
    the next; they count as further entries of it, at its end. None is none of it.
    full: return the full states too.
    """

    observed: np.ndarray | None = None
    gain: np.ndarray | None = None
    corrected: np.ndarray | None = None
    restart: np.ndarray | None = None
    push: np.ndarray | None = None
    decay: np.ndarray | None = None
    full: bool = False


@record
class Trajectories:
    """states (R, N, nx), measured outputs (R, N, ny) and commands (R, N, nu) at the sampling instants.

    Where they were asked for, full (R, N, n): the states, angles and sensor memories as they arrived at each sample, before they
    were corrected or replaced.
    """

    states: np.ndarray
    measured: np.ndarray
    commands: np.ndarray
    full: np.ndarray | None = None


@lru_cache(maxsize=64)
def _kernel(plant: Plant, controller: Controller, lanes: int) -> tuple[ModuleType, Rows]:
    """The compiled kernel of a plant under a controller's law, and where things stand in its work array."""
    rows, functions = Rows(), _functions(plant, controller)
    nx, na, ny, nu = len(plant.states), len(plant.turning), len(plant.outputs), len(plant.inputs)
    all_states = nx + na + len(plant.inner)
    sizes = {
        "x": all_states, "stage": all_states, "sum": all_states, "slope": all_states, "mem": len(plant.memories), "drift": nx,
        "surge": nu, "coloured": ny, "before": ny, "halfway": all_states, "midway": ny, "after": ny, "y": ny, "error": ny,
        "u": nu, "v": nu, "w": nu, "r": len(controller.references),
        "c": len(controller.init()), "g": len(controller.gains), "p": len(plant.parameters), "eta": len(plant.slots), "t": 1,
        "h": 1, "gaps": len(plant.gaps), "last": len(plant.swinging), "rate": len(plant.swinging),
        **dict.fromkeys(("reach", "steep"), nu if following(plant, controller) else 0),
    }  # fmt: skip
    for name, size in sizes.items():
        rows.take(name, size)
    rows.first["stage.angle"] = rows["stage"] + nx
    rows.first["stage.inner"] = rows["stage"] + nx + na
    within = ["stage", "w", "p", "eta", "stage.angle", "t", "stage.inner", "rate"]
    names = [f"part{j}" for j in range(len(plant.parted.parts))]
    for name, part in zip(names, plant.parted.parts, strict=True):
        rows.take(name, part.symbols.numel())
    direct = ["w"] if plant.discrete else []
    deep, sensors = len(plant.memories) // ny, [f"sensor{i}" for i in range(ny)]
    for i, name in enumerate(sensors):
        rows.first[name] = rows["mem"] + i * deep
    wiring = {
        "read": (["mem", "error", "eta"], ["y"]),
        "control": (["c", "r", "y", "g", "u"], ["u", "c"]),
        "drive": (["u", "eta", "t", "gaps", "last", "reach"], ["v", "gaps", "last", "rate", "steep"]),
        "show": (["x", *direct, "p"], ["before"]),
        "midst": (["halfway", *direct, "p"], ["midway"]),
        "measure": (["x", *direct, "p"], ["after"]),
        "rates": ([*within, *names], ["slope"]),
        "nominal": (within, ["slope"]),
        **{name: ([*within, *names[:j]], [name]) for j, name in enumerate(names)},
        **{name: (["mem", "before", "midway", "after", "h", "eta"], [name]) for name in sensors},
    }
    codes: dict[str, Code] = {
        name: print_function(functions[name], rows, arguments, results, constant={"p", "eta", "g"})
        for name, (arguments, results) in wiring.items()
    }
    used = [frozenset(names[i] for i in part.after) for part in plant.parted.parts]
    parts = [Switched(name, codes.pop(name), after) for name, after in zip(names, used, strict=True)]
    memories = [Switched(name, codes.pop(name), frozenset()) for name in sensors]
    numbers = {
        "nx": all_states, "ny": ny, "nu": nu, "nr": len(controller.references), "nm": len(plant.memories), "np": nx, "deep": deep,
    }  # fmt: skip
    title = f"{plant.name} under {type(controller).__name__}"
    curved, swung = bool(following(plant, controller)), [plant.input_names.index(name) for name in plant.swinging]
    source = kernel_source(title, lanes, rows, codes, parts, memories, numbers, plant.discrete, curved, swung)
    return load_kernel(source), rows


def following(plant: Plant, controller: Controller) -> list[str]:
    """Inputs of a record that are played and go on between their samples."""
    played = isinstance(controller, Playback) and _every(plant, controller) == 1
    return [name for name in controller.actuated if name in plant.curved] if played else []


def _functions(plant: Plant, controller: Controller) -> dict[str, ca.Function]:
    """The traced functions of a step: one for each part of the equation that an effect adds, and one for the rest."""
    s, nx = plant.symbols, len(plant.states)
    x, u, p, eta = (entries(s[name]) for name in ("x", "u", "p", "eta"))
    speeds = [x[plant.state_names.index(speed)] for speed in plant.turning.values()]
    rates, parts = plant.parted.rates, plant.parted.parts
    slope = ca.vertcat(rates[:nx], *speeds, rates[nx:])
    within, stood = [*s.values(), *(part.symbols for part in parts)], ca.vertcat(*(part.symbols for part in parts))
    absent = ca.vertcat(ca.SX.zeros(stood.numel(), 1), ca.SX(plant.effect_vector()))
    bare = ca.substitute(slope, ca.vertcat(stood, s["eta"]), absent)  # without effects: faster
    mem, before = ca.SX.sym("mem", len(plant.memories)), ca.SX.sym("before", len(plant.outputs))
    midway = ca.SX.sym("midway", len(plant.outputs))
    gaps, last, error = (
        ca.SX.sym("gaps", len(plant.gaps)), ca.SX.sym("last", len(plant.swinging)), ca.SX.sym("error", len(plant.outputs))
    )  # fmt: skip
    full, h, reached = ca.SX.sym("full", nx), ca.SX.sym("h"), ca.SX.sym("reached", len(plant.outputs))
    c, r = ca.SX.sym("c", len(controller.init())), ca.SX.sym("r", len(controller.references))
    reach = ca.SX.sym("reach", len(plant.inputs) if following(plant, controller) else 0)
    y, g = ca.SX.sym("y", len(plant.outputs)), ca.SX.sym("g", len(controller.gains))
    with symbolic_numpy():
        after = plant.output(entries(full), p, u)
        memory = plant.remember(entries(mem), entries(before), entries(midway), entries(reached), h, eta)
        reading = plant.read(entries(mem), entries(error), eta)
        acting = plant.drive(u, eta, s["t"], entries(gaps))
        crossed = plant.cross_gaps(u, eta, s["t"], entries(gaps))
        steep = _steepness(plant, u, eta, s["t"], entries(gaps), entries(reach)) if following(plant, controller) else []
        swung = [u[plant.input_names.index(name)] for name in plant.swinging]
        # before the first sample nobody knows how an input moved
        rate = [(new - old) / plant.dt * (s["t"] > 0.0) for new, old in zip(swung, entries(last), strict=True)]
        at = [entries(y)[plant.output_names.index(name)] for name in controller.measured]
        rho = [entries(y)[plant.output_names.index(name)] for name in schedules_of(controller)]
        command, state = controller.law(entries(g), entries(c), entries(r), at, rho_of(controller, rho))
    inputs = dict(zip(plant.input_names, u, strict=True)) | dict(zip(controller.actuated, command, strict=True))
    seen = [full, s["u"], s["p"]] if plant.discrete else [full, s["p"]]
    return {
        "control": ca.Function("control", [c, r, y, g, s["u"]], [ca.vertcat(*inputs.values()), column(state)]),
        "read": ca.Function("read", [mem, error, s["eta"]], [column(reading)]),
        "drive": ca.Function(
            "drive",
            [s["u"], s["eta"], s["t"], gaps, last, reach],
            [column(acting), column(crossed), column(swung), column(rate), column(steep)],
        ),
        "rates": ca.Function("rates", within, [slope]),
        "nominal": ca.Function("nominal", list(s.values()), [bare]),
        **{f"part{j}": ca.Function(f"part{j}", within[: len(s) + j], [part.values]) for j, part in enumerate(parts)},
        "show": ca.Function("show", seen, [column(after)]),
        **{name: ca.Function(name, seen, [column(after)]) for name in ("midst", "measure")},
        **{
            f"sensor{i}": ca.Function(f"sensor{i}", [mem, before, midway, reached, h, s["eta"]], [column(own)])
            for i, own in enumerate(shares(memory, len(plant.outputs)))
        },
    }


def _steepness(plant: Plant, u: list, eta: list, t: ca.SX, gaps: list, reach: list) -> list:
    """Gains of the actuators from u - reach to u + reach: at a stop an input stands on the kink of a dead zone, if only of one of
    width 0.
    """
    sides = ([v + way * d for v, d in zip(u, reach, strict=True)] for way in (1.0, -1.0))
    up, down = (plant.drive(side, eta, t, gaps) for side in sides)
    return [(a - b) / (2.0 * d + TINY) for a, b, d in zip(up, down, reach, strict=True)]


def cores() -> int:
    """Processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def run(
    plant: Plant, controller: Controller, lanes: Lanes, substeps: int, threads: int = 1, steering: Steering | None = None
) -> Trajectories:
    """Step every lane through all samples with classic Runge-Kutta, `substeps` equal steps a sample; a discrete plant jumps.

    One run goes through the scalar kernel, more through the SIMD kernel in blocks of 16, `threads` blocks at a time. Both
    give the same numbers to the last bit. Of steered runs, for which both are there, a few left over go one by one.
    """
    every = _every(plant, controller)
    R, N, _ = lanes.reference.shape
    over = R % SIMD if R == 1 or (steering and R % SIMD <= FEW) else 0
    blocks = [*((first, SIMD) for first in range(0, R - over, SIMD)), *((first, SCALAR) for first in range(R - over, R))]
    rows = _kernel(plant, controller, blocks[0][1])[1]
    full = rows.size["x"] + rows.size["mem"] if steering and steering.full else 0
    sizes = len(plant.states), len(plant.outputs), len(plant.inputs), full
    followed = {name: controller.references.index(name) for name in following(plant, controller)}

    def block(first: int, width: int) -> list[np.ndarray]:
        pick = np.minimum(np.arange(first, first + width), R - 1)  # the last block repeats the last run
        own = _Block(plant, *_kernel(plant, controller, width), lanes, pick, substeps, every, steering, followed)
        own.advance(0, N)
        return [np.moveaxis(source[:, :n, : R - first], 2, 0) for source, n in zip(own.results(), sizes, strict=True)]

    if len(blocks) == 1:
        states, measured, commands, whole = block(*blocks[0])
        return Trajectories(states, measured, commands, whole if full else None)
    out = [np.empty((R, N, n)) for n in sizes]

    def kept(own: tuple[int, int]) -> None:
        for target, source in zip(out, block(*own), strict=True):
            target[own[0] : sum(own)] = source

    if threads > 1:
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(kept, blocks))
    else:
        for own in blocks:
            kept(own)
    return Trajectories(out[0], out[1], out[2], out[3] if full else None)


def _every(plant: Plant, controller: Controller | Stepped) -> int:
    """Samples of the plant from one command of the controller to the next."""
    every = round(controller.dt / plant.dt)
    if every < 1 or abs(controller.dt - every * plant.dt) > 1e-9 * plant.dt:
        raise InputError(
            f"controller {controller.name!r} runs every {controller.dt:g} s, plant {plant.name!r} is sampled every "
            f"{plant.dt:g} s",
            mend="use a whole multiple of the plant's sample time",
        )
    if plant.discrete and controller.measured:
        raise InputError(
            f"it is known at its samples alone: as a plant it runs under given inputs, and not under {controller.name!r}",
            file=plant.name,
            mend="of an identified model: workbench simulate FILE --controller .. --setpoint Y=V, check --model FILE",
        )
    return every


class _Block:
    """Runs side by side in the lanes of one kernel, with all that they remember from one sample to the next."""

    def __init__(
        self,
        plant: Plant,
        kernel: ModuleType,
        rows: Rows,
        lanes: Lanes,
        pick: np.ndarray,
        substeps: int,
        every: int,
        steering: Steering | None = None,
        followed: Mapping[str, int] = {},
    ):
        L, N = len(pick), lanes.reference.shape[1]
        W = np.zeros((rows.total, L))
        nx = len(plant.states)
        W[rows["x"] : rows["x"] + nx] = lanes.start[pick].T
        for name, source in (("p", lanes.parameters), ("eta", lanes.effects), ("g", lanes.gains), ("c", lanes.memory)):
            W[rows.span(name)] = source[pick].T
        start, p, held = (source[pick].T for source in (lanes.start, lanes.parameters, lanes.hold))
        z = np.array([np.broadcast_to(y, L) for y in plant.output(start, p, held)])
        W[rows.span("before")] = z
        eta = lanes.effects[pick].T
        W[rows.span("mem")] = plant.settle(z, eta)
        W[rows.span("u")] = lanes.hold[pick].T
        W[rows.span("gaps")] = np.reshape(plant.settle_gaps(lanes.hold[pick].T, eta), (-1, L))

        step, back, late, first = _grid(plant, lanes.effects[pick], substeps, N)
        acting = np.empty((first + N, len(plant.inputs), L))
        acting[:first] = lanes.hold[pick].T
        states = np.empty((N, rows.size["x"], L))
        bend = np.zeros((N if followed else 0, len(plant.inputs), 3, L))
        for name, i in followed.items():
            given = lanes.reference[:1] if lanes.reference.strides[0] == 0 else lanes.reference[pick]
            bend[:, plant.input_names.index(name)] = _bends(given[:, :, i].T, plant.curved[name])
        bent = np.zeros((first + N if followed else 0, *bend.shape[1:]))
        measured, commands = np.empty((N, len(z), L)), np.empty((N, len(plant.inputs), L))
        reference, disturbance, noise = (_by_lane(source, pick) for source in (lanes.reference, lanes.disturbance, lanes.noise))
        felt = np.asarray(eta.any(axis=1)).tolist()
        live = [(q.effect, q.place) for q, on in zip(plant.slots, felt, strict=True) if on and not q.parameter.shape]
        dragging = {place for effect, place in live if effect.family == "sensor" and effect.memories}
        remembering = [name in dragging for name in plant.output_names]
        parts = [any(felt[i] for i in part.sizes) for part in plant.parted.parts]
        affected = any(effect.family not in ("sensor", "actuator") for effect, _ in live)
        by_lane, shared, steer = np.empty((0, 0, 0)), np.empty((0, 0)), steering or Steering()
        restart, push = (by_lane if given is None else np.take(given, pick, axis=2) for given in (steer.restart, steer.push))
        observed = shared if steer.observed is None else np.ascontiguousarray(steer.observed)
        gain = by_lane if steer.gain is None else np.ascontiguousarray(steer.gain)
        estimated = ("x", "mem", "drift", "surge", "coloured")
        places = np.concatenate([np.arange(rows[name], rows[name] + rows.size[name]) for name in estimated])
        corrected = places[: gain.shape[1]] if steer.corrected is None else places[steer.corrected]
        decay = np.empty(0) if steer.decay is None else np.ascontiguousarray(steer.decay)
        remembered = np.empty((N if steer.full else 0, len(plant.memories), L))
        self.kernel, self.full = kernel, steer.full
        self.reference, self.noise, self.eta, self.memory = reference, noise, eta, W[rows.span("mem")]
        self.states, self.measured, self.commands, self.remembered = states, measured, commands, remembered
        self._arrays = W.ravel(), reference, disturbance, noise, step, back, acting, states, measured, commands
        on = np.array([*parts, *remembering])
        self._rest = (
            first, every, plant.dt, on, affected, any(remembering), observed, gain, corrected, restart, push, remembered, decay,
            bend, bent, late, np.array([name in followed for name in plant.input_names]),
        )  # fmt: skip

    def advance(self, begin: int, end: int) -> None:
        """Run the samples from `begin` to `end`, which must follow on those already run."""
        self.kernel.run(*self._arrays, begin, end, *self._rest)

    def results(self) -> tuple[np.ndarray, ...]:
        """States, measured, commands, and full states where steered so, each (N, channels, L)."""
        full = np.concatenate([self.states, self.remembered], axis=1) if self.full else self.states
        return self.states, self.measured, self.commands, full


def _bends(u: np.ndarray, course: str) -> np.ndarray:
    """b1, b2, b3 of u(t) = u_k + b1 s + b2 s^2 + b3 s^3 over each sample, (N, 3, L), from u (N, L); 0 after the last one."""
    N, L = u.shape
    found = np.zeros((N, 3, L))
    if course == "linear" or N < CUBIC:
        found[:-1, 0] = np.diff(u, axis=0)
    else:
        found[:-1] = CubicSpline(np.arange(N), u).c[2::-1].transpose(1, 0, 2)
    return found


def _by_lane(source: np.ndarray, pick: np.ndarray) -> np.ndarray:
    """Runs `pick` of source (R, N, n) as (N, n, L); quicker where all runs share the same numbers."""
    if source.strides[0] == 0:
        return np.repeat(source[0][:, :, None], len(pick), axis=2)
    return np.ascontiguousarray(source[pick].transpose(1, 2, 0))


def run_stepwise(plant: Plant, controller: Stepped, lanes: Lanes, substeps: int, memory: Any) -> tuple[Trajectories, list]:
    """One run under a law that is asked sample by sample, from this memory on; and its memories. Otherwise as `run`."""
    every = _every(plant, controller)
    plant, played = replace(plant, between={}), Playback(controller.actuated, plant.dt)  # what is commanded is held
    N = lanes.reference.shape[1]
    driven = replace(lanes, gains=np.empty((1, 0)), memory=np.empty((1, 0)), reference=np.zeros((1, N, len(controller.actuated))))
    kernel, rows = _kernel(plant, played, SCALAR)
    block = _Block(plant, kernel, rows, driven, np.zeros(1, dtype=int), substeps, 1)
    read = _functions(plant, played)["read"]
    at = [plant.output_names.index(name) for name in controller.measured]
    scheduled = [plant.output_names.index(name) for name in schedules_of(controller)]
    memories = []
    for k in range(N):
        if k % every == 0:
            y = np.array(read(block.memory, block.noise[k], block.eta)).ravel()
            u, memory = controller.step(memory, lanes.reference[0, k], y[at], rho_of(controller, y[scheduled]))
            if np.shape(u) != (len(controller.actuated),) or not np.isfinite(u).all():
                said = f"controller {controller.name!r} commands {u!r} at {k * plant.dt:g} s"
                raise InputError(said, mend=f"expected {len(controller.actuated)} finite numbers, in an array")
            memories.append(memory)
        block.reference[k, :, 0] = u
        block.advance(k, k + 1)
    states, measured, commands, _ = (np.moveaxis(values, 2, 0) for values in block.results())
    return Trajectories(states[:, :, : len(plant.states)], measured, commands), memories


def _grid(plant: Plant, effects: np.ndarray, substeps: int, samples: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """Step lengths (S, L); for each step how many samples back the acting input was commanded, where in that sample the step
    begins, as a share of it, both (S, nu, L); and the longest way back.

    Without delays S = substeps. With them one step more for each input: the sorted union of the equal grid and the instants
    at which a shifted hold changes. A delay beyond the run's samples is that of the run: nothing arrives.
    """
    L, dt = len(effects), plant.dt
    delay = np.zeros((len(plant.inputs), L))
    for i, slot in enumerate(plant.slots):
        if slot.effect.id == "input-delay":
            delay[plant.input_names.index(slot.place)] += effects[:, i]
    delay = np.minimum(delay, samples * dt)
    whole = np.floor(delay / dt + 1e-12)
    change = np.clip(delay - whole * dt, 0.0, dt)  # instant within a sample at which the older command gives way
    points = np.repeat(np.linspace(0.0, dt, substeps + 1)[:, None], L, axis=1)
    if np.any(change > 0.0):
        points = np.sort(np.vstack([points, change]), axis=0)
    step = np.diff(points, axis=0)
    older = points[:-1, None, :] < change[None] - 1e-15 * dt
    back = whole[None] + older
    late = (points[:-1, None, :] - change[None]) / dt + older
    step, back, late = (np.ascontiguousarray(own) for own in (step, back.astype(np.int64), late))
    return step, back, late, int(back.max(initial=0))


def substeps_for(plant: Plant, parameters: np.ndarray, effects: np.ndarray, start: np.ndarray, hold: np.ndarray) -> np.ndarray:
    """Integrator steps a sample (R): the plant's own number, or more where a run's fastest mode asks for it (h |lambda| <= 1).

    Modes are those of the Jacobian at the start and at rest, where smoothed dry friction is steepest. Shapes: (R, ...).
    """
    rest = start.copy()
    rest[:, [plant.state_names.index(speed) for speed in plant.turning.values()]] = 0.0
    fastest = np.zeros(len(start))
    for x, t in ((start, 0.0), (rest, 0.0), (rest, FOREVER)):  # what sets in later counts too
        A = plant.jacobians_of(x, hold, parameters, effects, t=t)[0]
        told = np.isfinite(A).all(axis=(1, 2))  # the slope of a root at 0 is none: it says nothing of a mode
        fastest[told] = np.maximum(fastest[told], np.abs(np.linalg.eigvals(A[told])).max(axis=-1))
    needed = np.ceil(plant.dt * fastest)
    if needed.max() > 2000:
        raise InputError(
            f"a mode of {fastest.max():.3g} 1/s would need {needed.max():.4g} integrator steps a sample",
            file=plant.name,
            mend="widen the smoothing of the dry friction, or raise the inertia",
        )
    return np.maximum(plant.substeps, needed.astype(int))
