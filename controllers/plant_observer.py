"""A plant at its samples, and the extended Kalman filter on it with disturbance states at the inputs.

    x+ = F(x, u + d) + w,   d+ = d + v,   y = h(x) + e          z = (x, d)

F integrates the plant's own equation over a sample with held inputs (classic Runge-Kutta); its Jacobians are exact. cov e is that
of the plant's sensors; w holds what it says of unlogged signals at its inputs and of its process. Besides, x and d wander a
sample by `drift` of what the noise alone would let one see of them: a plant is never the machine.

Source: Anderson and Moore, "Optimal Filtering", Prentice-Hall 1979, section 8.2.
"""

from functools import cached_property
from typing import NamedTuple

import casadi as ca
import numpy as np

from workbench.errors import InputError, check_known
from workbench.physics.effects.effect import FOREVER
from workbench.physics.plant import Plant
from workbench.records import field, record

FAST = 1.0  # step length of the integrator times the fastest mode
OUTSIDE = ("actuator", "sensor")  # families that act outside of the equation
GUESSED = 0.05  # relative standard deviation of a start value
SETTLED = 50  # samples after which an input has done most of what it does


class Belief(NamedTuple):
    """z (nx + nu) and its covariance before a sample's measurement."""

    z: np.ndarray
    P: np.ndarray


@record
class SampledPlant:
    """F, h and their Jacobians; inputs are those in `actuated`, the others stay where a run starts."""

    plant: Plant
    actuated: tuple[str, ...]

    def __post_init__(self):
        for name in self.actuated:
            check_known("input", name, self.plant.input_names, file=self.plant.name)
        if self.plant.discrete:
            raise InputError(
                "known at its samples alone, an identified model", file=self.plant.name, mend="workbench design mpc is for those"
            )
        if self.unpredicted:
            raise InputError(
                f"the equation alone does not say what {', '.join(self.unpredicted)} does", file=self.plant.name,
                mend="leave such effects out of the plant that the controller predicts with",
            )  # fmt: skip

    @property
    def unpredicted(self) -> list[str]:
        """Effects of the plant that need more than its states and commands: a memory, an angle, the time, another input."""
        plant = self.plant
        alone: dict[str, np.ndarray] = {}
        for i, (slot, value, neutral) in enumerate(zip(plant.slots, plant.effect_vector(), plant.neutral, strict=True)):
            if value != neutral:
                alone.setdefault(slot.key, plant.neutral.copy())[i] = value
        effects = {slot.key: slot.effect for slot in plant.slots}
        apart = {key for key in alone if effects[key].memories or effects[key].state or effects[key].family in OUTSIDE}
        bare = self._beyond(plant.neutral)
        return [key for key, eta in alone.items() if key in apart or not np.array_equal(self._beyond(eta), bare)]

    def _beyond(self, eta: np.ndarray) -> np.ndarray:
        """What later times, other angles, inner states and inputs that are not commanded change in the rates, effects apart."""
        x, u = self.start
        moved, other = x + 0.1 * np.maximum(np.abs(x), 0.1), u.copy()
        other[[i for i in range(len(u)) if i not in self.at]] += 1.0
        sizes = [len(names) for names in (self.plant.turning, self.plant.inner, self.plant.swinging)]

        def rates(inputs: np.ndarray, t: float, value: float) -> np.ndarray:
            angle, inner, rate = (np.full(n, value) for n in sizes)
            return np.array(self.plant.traced(moved, inputs, self.plant.nominal, eta, angle, t, inner, rate)[0])

        now = rates(u, 0.0, 0.0)
        return np.concatenate([rates(other, t, 1.0) - now for t in (FOREVER, 1.234)])  # what sets in, and what comes and goes

    @property
    def at(self) -> list[int]:
        """Where the actuated inputs stand among all."""
        return [self.plant.input_names.index(name) for name in self.actuated]

    @cached_property
    def start(self) -> tuple[np.ndarray, np.ndarray]:
        """States and all inputs where a run starts."""
        return self.plant.equilibrium()

    @cached_property
    def substeps(self) -> int:
        """Integrator steps a sample."""
        fastest = np.abs(np.linalg.eigvals(self.plant.linearize(*self.start)[0])).max()
        return max(1, int(np.ceil(self.plant.dt * fastest / FAST)))

    @cached_property
    def _symbols(self) -> tuple[ca.SX, ca.SX]:
        return ca.SX.sym("x", len(self.plant.states)), ca.SX.sym("u", len(self.actuated))

    def _traced(self, x: ca.SX, u: ca.SX) -> tuple[ca.SX, ca.SX]:
        """dx/dt and y on symbols."""
        plant = self.plant
        given = dict(zip(plant.input_names, self.start[1], strict=True)) | dict(zip(self.actuated, ca.vertsplit(u), strict=True))
        still = [np.zeros(len(names)) for names in (plant.turning, plant.inner, plant.swinging)]
        rest = plant.nominal, plant.effect_vector(), still[0], 0.0, *still[1:]
        rates, y = plant.traced(x, ca.vertcat(*given.values()), *rest)  # type: ignore[misc]
        return rates, y

    @cached_property
    def step(self) -> ca.Function:
        """(x, u) -> x at the next sample."""
        x, u = self._symbols
        h, after = self.plant.dt / self.substeps, x
        for _ in range(self.substeps):
            k1 = self._traced(after, u)[0]
            k2 = self._traced(after + 0.5 * h * k1, u)[0]
            k3 = self._traced(after + 0.5 * h * k2, u)[0]
            k4 = self._traced(after + h * k3, u)[0]
            after = after + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        return ca.Function("step", [x, u], [after], ["x", "u"], ["next"])

    @cached_property
    def linear(self) -> ca.Function:
        """(x, u) -> F and its Jacobians in x and u."""
        x, u = self._symbols
        after = self.step(x, u)
        return ca.Function("linear", [x, u], [after, *(ca.densify(ca.jacobian(after, by)) for by in (x, u))])

    @cached_property
    def seen(self) -> ca.Function:
        """x -> h (ny) and its Jacobian."""
        x, u = self._symbols
        y = self._traced(x, u)[1]
        return ca.Function("seen", [x], [y, ca.densify(ca.jacobian(y, x))])


@record
class PlantObserver:
    """The filter; see the module. drift: relative, see there."""

    model: SampledPlant
    drift: float = field("", low=1e-9, default=0.3)

    def first(self, y: np.ndarray) -> Belief:
        """Where the machine starts: its equilibrium at what is measured, as far as the plant's start knows the channels."""
        plant = self.model.plant
        measured = dict(zip(plant.output_names, y.tolist(), strict=True))
        seen = {name: measured[name] for name in plant.start.fixed if np.isfinite(measured.get(name, np.nan))}
        try:
            x, _ = plant.equilibrium(**seen)
        except InputError:  # no equilibrium there: the measurements will say
            x = self.model.start[0]
        z = np.concatenate([x, np.zeros(len(self.model.actuated))])
        return Belief(z, np.diag((GUESSED * z) ** 2) + self._wander / self.drift**2)

    def corrected(self, belief: Belief, y: np.ndarray) -> Belief:
        """After the measurements y (ny,) of a sample; what is not a number corrects nothing."""
        seen = np.isfinite(y)
        if not seen.any():
            return belief
        nx, one = len(self.model.plant.states), np.eye(len(belief.z))
        expected, C = (np.array(a) for a in self.model.seen(belief.z[:nx]))
        H = np.hstack([C, np.zeros((len(y), len(one) - nx))])[seen]
        R = np.diag(self._noise[seen] ** 2)
        K = np.linalg.solve(H @ belief.P @ H.T + R, H @ belief.P).T
        rest = one - K @ H
        return Belief(belief.z + K @ (y - expected[:, 0])[seen], rest @ belief.P @ rest.T + K @ R @ K.T)

    def moved(self, belief: Belief, u: np.ndarray) -> Belief:
        """At the next sample, under the commands u."""
        nx, nu = len(self.model.plant.states), len(u)
        x, d = belief.z[:nx], belief.z[nx:]
        after, A, B = (np.array(a) for a in self.model.linear(x, u + d))
        Az = np.block([[A, B], [np.zeros((nu, nx)), np.eye(nu)]])
        P = Az @ belief.P @ Az.T + self._wander
        P[:nx, :nx] += B @ np.diag(self._pushes**2) @ B.T + np.diag(self._process**2)
        return Belief(np.concatenate([after[:, 0], d]), P)

    # ---- found once -------------------------------------------------------------------------------------------------------

    @cached_property
    def _noise(self) -> np.ndarray:
        """Standard deviations of the outputs; one without noise counts as measured to a millionth of the others' mean."""
        given = np.array([self.model.plant.noise.get(name, 0.0) for name in self.model.plant.output_names])
        return np.maximum(given, 1e-6 * given.mean() or 1e-6)

    @cached_property
    def _pushes(self) -> np.ndarray:
        return np.array([self.model.plant.disturbance.get(name, 0.0) for name in self.model.actuated])

    @cached_property
    def _process(self) -> np.ndarray:
        """What the plant says of its process, a sample."""
        return self.model.plant.dt * np.array([self.model.plant.process.get(name, 0.0) for name in self.model.plant.state_names])

    @cached_property
    def _wander(self) -> np.ndarray:
        """Covariance of what x and d wander a sample: `drift` of what the noise lets one see at the start."""
        x, u = self.model.start
        _, A, B = (np.array(a) for a in self.model.linear(x, u[self.model.at]))
        C, R = np.array(self.model.seen(x)[1]), np.diag(self._noise**2)
        one, moved = np.eye(len(x)), np.zeros_like(B)
        for _ in range(SETTLED):
            moved = A @ moved + B
        by_states, by_inputs = np.linalg.pinv(C), np.linalg.pinv(C @ moved)
        wander = np.zeros((len(one) + B.shape[1], len(one) + B.shape[1]))
        wander[: len(one), : len(one)] = by_states @ R @ by_states.T
        wander[len(one) :, len(one) :] = by_inputs @ R @ by_inputs.T
        return self.drift**2 * wander
