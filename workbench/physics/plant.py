"""A plant: states, inputs, outputs, parameters with tolerances, ports for missing physics, and one equation.

    dx/dt = equation(x, u, p, at)        y = measure(x, p)

The equation is one plain function in arithmetic and numpy ufuncs, without a branch on a state. It is never written twice:
called with numbers it runs in numpy, called with CasADi symbols it gives Jacobians and, printed as straight-line code, the
compiled stepper. `x`, `u`, `p` hold values by name; `at.<place>` offers what the effects at a port contribute.
"""

import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import contextmanager
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from workbench.data import Channel
from workbench.errors import InputError, check_known
from workbench.physics.effects import effects_of
from workbench.physics.effects.actuator import Actuator
from workbench.physics.effects.effect import Effect, EffectParameter, Named
from workbench.physics.effects.sensor import Sensor
from workbench.records import field, record


@record
class Parameter:
    """A physical constant; tolerance is the relative half-width that a data sheet leaves open.

    signed: it may be zero or negative; what is not (a mass, a stiffness, a resistance) is refused at such values.
    """

    name: str
    value: float = field("")
    unit: str = ""
    tolerance: float = field("", low=0.0, default=0.0)
    meaning: str = ""
    signed: bool = False


@record
class Start:
    """Where a run starts: `fixed` state values (numbers or parameter names), the rest solved so that `zero` stand still.

    Unknowns `solve_for` (states or inputs) are found from derivative = 0 of as many states in `zero`; whatever is named
    nowhere starts at 0. `guess` helps where 0 is no place to start Newton's method.
    """

    fixed: Mapping[str, float | str] = field(default_factory=dict)
    solve_for: tuple[str, ...] = ()
    zero: tuple[str, ...] = ()
    guess: Mapping[str, float] = field(default_factory=dict)


@record
class Slot:
    """One number of one effect at one place: coulomb@unwind:level."""

    effect: Effect
    place: str
    parameter: EffectParameter

    @property
    def key(self) -> str:
        return f"{self.effect.id}@{self.place}"

    def __str__(self) -> str:
        return f"{self.key}:{self.parameter.name}"


EffectSizes = Mapping[str, Mapping[str, float]]  # {"coulomb@unwind": {"level": 0.002}}


@record
class Plant:
    """See the module. `ports` are those of the equation; every commanded input has an actuator port, every output a sensor port.

    An input of role "schedule" moves on its own (the angle of an arm that another program drives): nothing commands it, and where
    a record or a scenario does not give it, it stays at its start value, by default 0.

    noise: standard deviation of each measured channel, white per sample; disturbance: of an unlogged signal added to each
    input, white per sample. limits: (low, high) of states within which the equation means something. substeps: integrator
    steps per sample that keep the error of a run below 1e-4 of its range.
    """

    name: str
    states: tuple[Channel, ...]
    inputs: tuple[Channel, ...]
    outputs: tuple[Channel, ...]
    parameters: tuple[Parameter, ...]
    equation: Callable[[Any, Any, Any, Any], Mapping[str, Any]]
    measure: Callable[[Any, Any], Mapping[str, Any]]
    dt: float = field("", unit="s", low=1e-9)
    ports: tuple[Any, ...] = ()
    start: Start = field(default_factory=Start)
    noise: Mapping[str, float] = field(default_factory=dict)
    disturbance: Mapping[str, float] = field(default_factory=dict)
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    substeps: int = 10
    description: str = ""

    def __post_init__(self):
        for kind, channels in (("state", self.states), ("input", self.inputs), ("output", self.outputs)):
            if not channels:
                raise InputError(f"a plant needs at least one {kind}", file=self.name)
        taken: set[tuple[str, str]] = set()
        for port in self.ports:
            if (port.family, port.place) in taken:
                raise InputError(f"two {port.family} ports at {port.place!r}", file=self.name, mend="give each its own place")
            taken.add((port.family, port.place))
            if self.turning.get(port.place) != getattr(port, "speed", self.turning.get(port.place)):
                raise InputError(f"two speeds at {port.place!r}", file=self.name, mend="a place turns with one speed")
        for name in (*self.noise, *self.disturbance):
            check_known("channel", name, [c.name for c in (*self.inputs, *self.outputs)], file=self.name)
        for name in self.limits:
            check_known("state", name, self.state_names, file=self.name)
        for port in self.ports:
            if hasattr(port, "speed"):
                check_known("state", port.speed, self.state_names, file=self.name)
            if hasattr(port, "arm"):
                check_known("input", port.arm, self.input_names, file=self.name)

    # ---- names ---------------------------------------------------------------------------------------------------

    @cached_property
    def state_names(self) -> tuple[str, ...]:
        return tuple(c.name for c in self.states)

    @cached_property
    def input_names(self) -> tuple[str, ...]:
        return tuple(c.name for c in self.inputs)

    @cached_property
    def commanded(self) -> tuple[str, ...]:
        """Names of the inputs that an actuator drives; the others move on their own."""
        return tuple(c.name for c in self.inputs if c.role != "schedule")

    @cached_property
    def output_names(self) -> tuple[str, ...]:
        return tuple(c.name for c in self.outputs)

    @cached_property
    def nominal(self) -> np.ndarray:
        """Nominal parameter values (np)."""
        return np.array([p.value for p in self.parameters])

    @cached_property
    def turning(self) -> dict[str, str]:
        """Place -> speed state, for every port that turns; the stepper integrates one angle for each place."""
        return {port.place: port.speed for port in self.ports if hasattr(port, "speed")}

    @cached_property
    def all_ports(self) -> tuple[Any, ...]:
        return (*self.ports, *(Actuator(name) for name in self.commanded), *(Sensor(c.name) for c in self.outputs))

    @cached_property
    def slots(self) -> tuple[Slot, ...]:
        """Every number of every effect that fits a port, in the order of the effect vector eta."""
        return tuple(
            Slot(effect, port.place, port.fitted(parameter) if hasattr(port, "fitted") else parameter)
            for port in self.all_ports
            for effect in effects_of(port.family)
            for parameter in effect.parameters
        )

    @cached_property
    def memories(self) -> tuple[tuple[str, Effect], ...]:
        """(output, effect) for every memory slot of the sensors."""
        return tuple((name, effect) for name in self.output_names for effect in effects_of("sensor"))

    # ---- numbers from names --------------------------------------------------------------------------------------

    def parameter_vector(self, changed: Mapping[str, float] | None = None) -> np.ndarray:
        """Nominal parameters with some of them changed, (np)."""
        values = self.nominal.copy()
        names = [p.name for p in self.parameters]
        for name, value in (changed or {}).items():
            values[names.index(check_known("parameter", name, names, file=self.name))] = value
        self.check_parameters(values[None])
        return values

    def check_parameters(self, p: np.ndarray) -> None:
        """Refuse parameter vectors p (R, np) of the wrong length, not finite, or not positive where they must be."""
        if p.shape[1] != len(self.parameters):
            raise InputError(f"{p.shape[1]} parameters, expected {len(self.parameters)}", file=self.name)
        for i, q in enumerate(self.parameters):
            bad = ~np.isfinite(p[:, i]) | ((p[:, i] <= 0.0) & (not q.signed))
            if bad.any():
                value = p[int(np.argmax(bad)), i]
                raise InputError(
                    f"parameter {q.name} = {value:g} {q.unit}",
                    file=self.name,
                    mend=f"{q.meaning or q.name} must be {'finite' if q.signed else 'greater than 0'}",
                )

    def effect_vector(self, sizes: EffectSizes | None = None) -> np.ndarray:
        """Effect parameters eta (ne): neutral but for `sizes`, e.g. {"coulomb@unwind": {"level": 0.002}}."""
        values = np.array([slot.parameter.default for slot in self.slots])
        for key, numbers in (sizes or {}).items():
            check_known("effect", key, dict.fromkeys(slot.key for slot in self.slots), file=self.name)
            own = {slot.parameter.name: i for i, slot in enumerate(self.slots) if slot.key == key}
            for name, value in numbers.items():
                values[own[check_known(f"parameter of {key}", name, own, file=self.name)]] = value
        self.check_effects(values[None])
        return values

    def check_effects(self, eta: np.ndarray) -> None:
        """Refuse effect vectors eta (R, ne) of the wrong length or with a number outside its bounds."""
        if eta.shape[1] != len(self.slots):
            raise InputError(
                f"{eta.shape[1]} effect numbers, expected {len(self.slots)}", file=self.name, mend="use effect_vector"
            )
        for i, slot in enumerate(self.slots):
            bad = ~((eta[:, i] >= slot.parameter.low) & (eta[:, i] <= slot.parameter.high))
            if bad.any():
                p, value = slot.parameter, eta[int(np.argmax(bad)), i]
                raise InputError(f"{value:g} {p.unit}", file=str(slot), mend=f"{p.name} lies in [{p.low:g}, {p.high:g}]")

    # ---- the equation, on numbers or symbols ------------------------------------------------------------------------

    def derivative(self, x, u, p=None, eta=None, *, t: Any = 0.0, angle: Sequence | None = None) -> list:
        """dx/dt (nx values) at states x, acting inputs u, parameters p and effects eta; scalars, arrays or symbols."""
        p = self.nominal if p is None else p
        eta = self.effect_vector() if eta is None else eta
        angle = [0.0] * len(self.turning) if angle is None else angle
        rates = self.equation(
            Named(state := dict(zip(self.state_names, x, strict=True))),
            Named(inputs := dict(zip(self.input_names, u, strict=True))),
            self._parameters(p),
            self._places({"x": state, "u": inputs, "angle": dict(zip(self.turning, angle, strict=True)), "t": t}, eta),
        )
        return self._ordered("derivative of state", rates, self.state_names)

    def output(self, x, p=None) -> list:
        """Physical outputs (ny values) before sensors, at states x and parameters p."""
        p = self.nominal if p is None else p
        y = self.measure(Named(dict(zip(self.state_names, x, strict=True))), self._parameters(p))
        return self._ordered("output", y, self.output_names)

    def drive(self, u, eta, t) -> list:
        """Acting inputs (nu values) from commands: what the actuator effects make of them, delay apart."""
        return [
            Actuator(name).drive(self._effects_at("actuator", name, eta), value, t) if name in self.commanded else value
            for name, value in zip(self.input_names, u, strict=True)
        ]

    def remember(self, memory, z0, z1, h, eta) -> list:
        """Sensor memories (nm values) after a step of length h in which the physical outputs went from z0 to z1."""
        each = len(effects_of("sensor"))
        after = []
        for i, name in enumerate(self.output_names):
            own = memory[i * each : (i + 1) * each]
            after += Sensor(name).remember(self._effects_at("sensor", name, eta), own, z0[i], z1[i], h)
        return after

    def _parameters(self, p) -> Named:
        return Named(dict(zip((q.name for q in self.parameters), p, strict=True)))

    def _effects_at(self, family: str, place: str, eta) -> list[tuple[Effect, Named]]:
        numbers: dict[str, dict] = {}
        for slot, value in zip(self.slots, eta, strict=True):
            if slot.effect.family == family and slot.place == place:
                numbers.setdefault(slot.effect.id, {})[slot.parameter.name] = value
        return [(effect, Named(numbers[effect.id])) for effect in effects_of(family)]

    def _places(self, seen: dict[str, Any], eta) -> Named:
        context = Named(seen)
        verbs: dict[str, dict] = {}
        for port in self.ports:
            own = port.verbs(self._effects_at(port.family, port.place, eta), context)
            verbs.setdefault(port.place, {}).update(own)
        return Named({place: Named(own) for place, own in verbs.items()})

    def _ordered(self, kind: str, values: Mapping[str, Any], names: Sequence[str]) -> list:
        if not isinstance(values, Mapping):
            raise InputError(
                f"returns {type(values).__name__} for the {kind}", file=self.name, mend="return a dictionary by name"
            )
        for name in values:
            check_known(kind, name, names, file=self.name)
        missing = [name for name in names if name not in values]
        if missing:
            raise InputError(f"the plant gives no {kind} {', '.join(missing)}", file=self.name)
        return [values[name] for name in names]

    # ---- the same equation, traced ------------------------------------------------------------------------------------

    @cached_property
    def symbols(self) -> dict[str, ca.SX]:
        """CasADi symbols of the equation's arguments."""
        sizes = {
            "x": len(self.states), "u": len(self.inputs), "p": len(self.parameters), "eta": len(self.slots),
            "angle": len(self.turning), "t": 1,
        }  # fmt: skip
        return {name: ca.SX.sym(name, size) for name, size in sizes.items()}

    @cached_property
    def traced(self) -> ca.Function:
        """(x, u, p, eta, angle, t) -> (dx, y) as a CasADi function: the same equation on symbols."""
        s = self.symbols
        split = {name: entries(symbol) for name, symbol in s.items()}
        try:
            with symbolic_numpy():
                dx = self.derivative(split["x"], split["u"], split["p"], split["eta"], t=s["t"], angle=split["angle"])
                y = self.output(split["x"], split["p"])
        except RuntimeError as reason:
            if "truth value" not in str(reason):
                raise
            raise InputError(
                "the equation has an `if`, `and`, `or`, `min` or `max` on a state, an input or a parameter",
                file=self.name,
                mend="write np.minimum, np.maximum or a smooth function such as np.tanh",
            ) from None
        return ca.Function(self._identifier, list(s.values()), [column(dx), column(y)], list(s), ["dx", "y"])

    @property
    def _identifier(self) -> str:
        return "plant_" + "".join(c if c.isalnum() else "_" for c in self.name).strip("_")

    @cached_property
    def jacobians(self) -> ca.Function:
        """(x, u, p, eta, angle, t) -> (A, B, C), the Jacobians d(dx)/dx, d(dx)/du and dy/dx."""
        s = self.symbols
        dx, y = self.traced(*s.values())
        parts = [ca.jacobian(dx, s["x"]), ca.jacobian(dx, s["u"]), ca.jacobian(y, s["x"])]
        return ca.Function("jacobians", list(s.values()), [ca.densify(J) for J in parts])

    def linearize(self, x, u, p=None, eta=None) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Continuous-time A, B, C, D of the plant frozen at x (nx), u (nu)."""
        for kind, values, names in (("states", x, self.state_names), ("inputs", u, self.input_names)):
            if np.shape(values) != (len(names),):  # one number would be taken for all of them
                raise InputError(f"{kind} of shape {np.shape(values)}, expected {', '.join(names)}", file=self.name)
        p = self.nominal if p is None else p
        eta = self.effect_vector() if eta is None else eta
        A, B, C = (J[0] for J in self.jacobians_of(*(np.asarray(v, dtype=float)[None] for v in (x, u, p, eta))))
        return A, B, C, np.zeros((C.shape[0], B.shape[1]))

    def jacobians_of(self, x: np.ndarray, u: np.ndarray, p: np.ndarray, eta: np.ndarray) -> list[np.ndarray]:
        """A (R, nx, nx), B (R, nx, nu), C (R, ny, nx) at R points; arguments (R, ...)."""
        return [J.transpose(0, 2, 1) for J in self._evaluated(self.jacobians, x, u, p, eta)]

    def _evaluated(self, function: ca.Function, x, u, p, eta) -> list[np.ndarray]:
        """Results of a function of the symbols at R points, each (R, columns, rows): one call for all of them."""
        R = len(x)
        angle, t = np.zeros((len(self.turning), R)), np.zeros((1, R))
        results = function.map(R)(x.T, u.T, p.T, eta.T, angle, t)
        return [np.array(J).T.reshape(R, -1, J.shape[0]) for J in results]

    def equilibrium(self, p=None, **fixed: float) -> tuple[np.ndarray, np.ndarray]:
        """State x0 and input u0 at which the states in `start.zero` stand still; `fixed` replaces single values."""
        x, u = self.equilibria((self.nominal if p is None else np.asarray(p, dtype=float))[None], **fixed)
        return x[0], u[0]

    def equilibria(self, p: np.ndarray, **fixed: float) -> tuple[np.ndarray, np.ndarray]:
        """Equilibria x0 (R, nx), u0 (R, nu) for R parameter vectors p (R, np), effects neutral.

        Newton's method on the traced equation. A fixed value among those to be solved for replaces the solution: the plant
        then starts beside its equilibrium. Raises InputError where the method does not converge.
        """
        names = (*self.state_names, *self.input_names)
        z = np.zeros((len(p), len(names)))
        for name, value in (dict(self.start.guess) | dict(self.start.fixed) | fixed).items():
            check_known("state or input", name, names, file=self.name)
            own = [q.name for q in self.parameters]
            column = p[:, own.index(check_known("parameter", value, own, file=self.name))] if isinstance(value, str) else value
            z[:, names.index(name)] = column
        unknown = [names.index(name) for name in self.start.solve_for]
        zero = [self.state_names.index(name) for name in self.start.zero]
        nx, eta = len(self.states), np.repeat(self.effect_vector()[None], len(p), axis=0)
        for _ in range(50 if unknown else 0):
            residual = self._evaluated(self.traced, z[:, :nx], z[:, nx:], p, eta)[0][:, 0, zero]
            A, B, _C = self.jacobians_of(z[:, :nx], z[:, nx:], p, eta)
            J = np.concatenate([A, B], axis=2)[:, zero][:, :, unknown]
            try:
                step = np.linalg.solve(J, residual[:, :, None])[:, :, 0]
            except np.linalg.LinAlgError:
                raise InputError(
                    f"{', '.join(self.start.solve_for)} do not determine an equilibrium", file=self.name, mend="see Start"
                ) from None
            z[:, unknown] -= step
            if np.max(np.abs(step) / (1.0 + np.abs(z[:, unknown]))) < 1e-13:
                break
        else:
            if unknown:
                raise InputError(
                    "no equilibrium found for these parameters and start values",
                    file=self.name,
                    mend="are they possible together? otherwise give the plant's Start a better guess",
                )
        for name in set(fixed) & set(self.start.solve_for):
            z[:, names.index(name)] = fixed[name]
        return z[:, :nx], z[:, nx:]


_TRACING = threading.RLock()


@contextmanager
def symbolic_numpy():
    """numpy ufuncs accept CasADi symbols inside, whatever the global setting of CasADi is; one thread at a time."""
    with _TRACING:
        before = ca.GlobalOptions.getNumpyMode()
        ca.GlobalOptions.setNumpyMode(1)
        try:
            yield
        finally:
            ca.GlobalOptions.setNumpyMode(before)


def entries(symbol: ca.SX) -> list[ca.SX]:
    """The scalars of a symbolic column."""
    return ca.vertsplit(symbol) if symbol.numel() else []


def column(values: Sequence) -> ca.SX:
    """A symbolic column of scalars, numbers among them."""
    return ca.vertcat(*(ca.SX(value) for value in values)) if values else ca.SX(0, 1)
