"""A plant: states, inputs, outputs, parameters with tolerances, ports for missing physics, and one equation.

    dx/dt = equation(x, u, p, at)        y = measure(x, p)

The equation is one plain function in arithmetic and numpy ufuncs, without a branch on a state. It is never written twice:
called with numbers it runs in numpy, called with CasADi symbols it gives Jacobians and, printed as straight-line code, the
compiled stepper. `x`, `u`, `p` hold values by name; `at.<place>` offers what the effects at a port contribute.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from workbench.data import SAME_DT, Channel
from workbench.errors import InputError, check_known
from workbench.physics.effects import effects_of
from workbench.physics.effects.actuator import Actuator, Driven
from workbench.physics.effects.effect import FOREVER, Effect, Named
from workbench.physics.effects.sensor import Sensor
from workbench.physics.effects.tank import Tank, check_unit
from workbench.physics.own_effects import check_own
from workbench.physics.parameters import EffectSizes, Parameter, Slot
from workbench.physics.parts import Noted, Opened, Parted
from workbench.physics.rest import Start, equilibria, several
from workbench.physics.sample_time import other_time
from workbench.physics.symbolic import column, entries, symbolic_numpy
from workbench.records import field, record

HELD = "held"
COURSES = (HELD, "linear", "spline")  # of an input from one sample to the next


@record
class Plant:
    """dx/dt = equation(x, u, p, at), y = measure(x, p): states, inputs, outputs, parameters with tolerances, and ports.

    The equation is one plain function in arithmetic and numpy ufuncs; `x`, `u`, `p` hold values by name, and `at.<place>` offers
    what the effects at a port contribute. dt [s]: sample time. `ports` are those of the equation; every
    commanded input has an actuator port, every output a sensor port.

    An input of role "schedule" moves on its own (the angle of an arm that another program drives): nothing commands it, and where
    a record or a scenario does not give it, it stays at its start value, by default 0.

    noise: standard deviation of each measured channel, white per sample; disturbance: of an unlogged signal added to each
    input, white per sample. limits: (low, high) of states within which the equation means something. substeps: integrator
    steps per sample that keep the error of a run below 1e-4 of its range. effects: missing physics that a diagnosis has added,
    {"coulomb@unwind": {"level": 0.002}}; it acts wherever nothing else is asked for. own_effects: missing physics that the
    catalogue does not hold; it joins the catalogue at every port of its family.

    process: standard deviation of unlogged rates of change of states, white per sample, where they are known; a diagnosis else
    expects them where a port or an input moves a state.

    discrete: the plant is known at its samples alone. Its equation is a difference per sample, (x+ - x) / dt, taken at a sample
    and held to the next; its outputs see the inputs of their own sample, measure(x, p, u), and it needs all of them. A dead time
    that is no whole number of samples mixes two samples of the command.

    meaning: what channels and places are, in words, {"v1": "speed of the platform"}.

    between: what inputs that a record holds do between its samples, {"F": "spline"}: what an amplifier holds is held, as is every
    input by default; what was measured while it moved goes on, by a straight line ("linear") or a cubic spline through its
    samples. What a controller of the workbench commands is held.

        >>> MOTOR.output_names, MOTOR.equilibrium(w=40.0, way=5.0)[1].round(1)  # U [V] that holds 40 rad/s
        (('n', 'way'), array([6.]))
    """

    name: str
    states: tuple[Channel, ...]
    inputs: tuple[Channel, ...]
    outputs: tuple[Channel, ...]
    parameters: tuple[Parameter, ...]
    equation: Callable[[Any, Any, Any, Any], Mapping[str, Any]]
    measure: Callable[..., Mapping[str, Any]]
    dt: float = field("", unit="s", low=1e-9)
    ports: tuple[Any, ...] = ()
    start: Start = field(default_factory=Start)
    noise: Mapping[str, float] = field(default_factory=dict)
    disturbance: Mapping[str, float] = field(default_factory=dict)
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    substeps: int = 10
    description: str = ""
    effects: EffectSizes = field(default_factory=dict)
    process: Mapping[str, float] = field(default_factory=dict)
    discrete: bool = False
    meaning: Mapping[str, str] = field(default_factory=dict)
    own_effects: tuple[Effect, ...] = ()
    between: Mapping[str, str] = field(default_factory=dict)

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
        for name in (*self.limits, *self.process):
            check_known("state", name, self.state_names, file=self.name)
        for name in (*self.start.fixed, *self.start.guess, *self.start.solve_for):
            check_known("state or input", name, (*self.state_names, *self.input_names), file=f"{self.name}, Start")
        for name in self.start.zero:
            check_known("state", name, self.state_names, file=f"{self.name}, Start")
        if len(self.start.solve_for) != len(self.start.zero):
            unknowns, equations = several(self.start.solve_for, "unknown"), several(self.start.zero, "rate")
            mend = "solve for as many states and inputs as rates shall be 0"
            raise InputError(f"{unknowns}, but {equations} that shall be 0", file=f"{self.name}, Start", mend=mend)
        self.check_parameters(self.nominal[None])  # here, and not after a diagnosis of minutes
        for port in self.ports:
            if hasattr(port, "speed"):
                check_known("state", port.speed, self.state_names, file=self.name)
            if hasattr(port, "tension"):
                check_known("state", port.tension, self.state_names, file=self.name)
            if hasattr(port, "arm"):
                check_known("input", port.arm, self.input_names, file=self.name)
            if isinstance(port, Tank):
                check_known("state", port.level, self.state_names, file=self.name)
                check_unit(port, self.states[self.state_names.index(port.level)], self.name)
        for name, course in self.between.items():
            check_known("input", name, self.input_names, file=self.name)
            if course not in COURSES:
                mend = f"one of {', '.join(COURSES)}"
                raise InputError(f"{course!r} between samples", file=self.name, channel=name, mend=mend)
        if self.discrete and self.curved:
            mend = "it is known at its samples alone: leave `between` out"
            raise InputError("a discrete plant with inputs that go on between samples", file=self.name, mend=mend)
        check_own(self.own_effects, self.all_ports, self.name)

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
    def curved(self) -> dict[str, str]:
        """Inputs that go on between their samples, and how."""
        return {name: course for name, course in self.between.items() if course != HELD}

    def with_courses(self, between: Mapping[str, str]) -> "Plant":
        """The same plant with these inputs going on between their samples as it says here."""
        return replace(self, between={**self.between, **between}) if between else self

    @cached_property
    def needed(self) -> tuple[str, ...]:
        """Inputs without which a record says nothing: the commanded ones; of a discrete plant all, 0 is no place to stand at."""
        return self.input_names if self.discrete else self.commanded

    def sampled(self, dt: float, *, file: object = None) -> "Plant":
        """The same plant sampled every dt seconds.

        Raises InputError where dt is so far from the plant's own that time must be in another unit, or 60 or 3600 times as long
        or as short, and for every other dt than its own of a discrete plant, which knows nothing between its samples.
        """
        if abs(dt - self.dt) <= SAME_DT * self.dt:
            return self
        if self.discrete:
            raise InputError(f"sampled every {dt:g} s, {self.name} every {self.dt:g} s", file=file, mend="resample the record")
        if slip := other_time(dt / self.dt):
            raise InputError(
                f"sampled every {dt:g} s, {self.name} every {self.dt:g} s: {slip.question}?",
                file=file,
                channel="t",
                mend=f"multiply the time column by {slip.factor:.6g} and write t [s] in the header",
            )
        return replace(self, dt=dt, substeps=max(1, round(self.substeps * dt / self.dt)))

    @cached_property
    def output_names(self) -> tuple[str, ...]:
        return tuple(c.name for c in self.outputs)

    @cached_property
    def nominal(self) -> np.ndarray:
        """Nominal parameter values (np)."""
        return np.array([p.value for p in self.parameters])

    @cached_property
    def read_limits(self) -> dict[str, tuple[float, float]]:
        """Output -> limits of the state that it reads: the one of its name, where it has its unit too."""
        units = {c.name: c.unit for c in self.states}
        return {c.name: self.limits[c.name] for c in self.outputs if c.name in self.limits and units[c.name] == c.unit}

    @cached_property
    def turning(self) -> dict[str, str]:
        """Place -> speed state, for every port that turns; the stepper integrates one angle for each place."""
        return {port.place: port.speed for port in self.ports if hasattr(port, "speed")}

    def argument(self, place: str) -> str:
        """What laws at a place are over: the speed of what turns, the tension of a span, else the variable of that name."""
        tensions = {port.place: port.tension for port in self.ports if hasattr(port, "tension")}
        return (self.turning | tensions).get(place, place)

    @cached_property
    def swinging(self) -> tuple[str, ...]:
        """Inputs whose rate of change a port needs; the stepper takes it from one sample to the next."""
        return tuple(port.arm for port in self.ports if hasattr(port, "arm"))

    @cached_property
    def all_ports(self) -> tuple[Any, ...]:
        unit = {c.name: c.unit for c in (*self.inputs, *self.outputs)}
        drives = (Actuator(name, unit[name]) for name in self.commanded)
        return (*self.ports, *drives, *(Sensor(name, unit[name]) for name in self.output_names))

    @cached_property
    def offered(self) -> dict[tuple[str, str], tuple[Effect, ...]]:
        """(family, place) -> the effects that fit the port there, in the order in which they act."""
        return {
            (q.family, q.place): tuple(q.worded(effect) for effect in effects_of(q.family, self.own_effects) if q.fits(effect))
            for q in self.all_ports
        }

    @cached_property
    def slots(self) -> tuple[Slot, ...]:
        """Every number of every effect that fits a port, in the order of the effect vector eta."""
        return tuple(
            Slot(effect, port.place, port.fitted(parameter))
            for port in self.all_ports
            for effect in self.offered[port.family, port.place]
            for parameter in effect.parameters
        )

    @cached_property
    def effect_keys(self) -> tuple[str, ...]:
        """ "effect@place" of every effect that fits a port, in the order of the effect vector eta."""
        return tuple(dict.fromkeys(slot.key for slot in self.slots))

    @cached_property
    def inner(self) -> tuple[tuple[str, str], ...]:
        """(place, effect id) of every effect with a state of its own; the stepper integrates it, 0 at the start."""
        return tuple((place, effect.id) for (_, place), own in self.offered.items() for effect in own if effect.state)

    @cached_property
    def memories(self) -> tuple[tuple[str, Effect], ...]:
        """(output, effect) for every number that a sensor keeps."""
        return self._kept("sensor", self.output_names)

    @cached_property
    def gaps(self) -> tuple[tuple[str, Effect], ...]:
        """(input, effect) for every number that an actuator keeps."""
        return self._kept("actuator", self.commanded)

    def _kept(self, family: str, places: Sequence[str]) -> tuple[tuple[str, Effect], ...]:
        return tuple((name, effect) for name in places for effect in self.offered[family, name] for _ in range(effect.memories))

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
                    mend=f"{q.meaning or q.name} must be finite" if q.signed else
                    f"{q.meaning or q.name} must be greater than 0; if it may be zero or negative: Parameter(.., signed=True)",
                )  # fmt: skip

    @cached_property
    def neutral(self) -> np.ndarray:
        """Effect parameters eta (ne) of the bare equation."""
        return np.array([slot.parameter.default for slot in self.slots])

    def effect_vector(self, sizes: EffectSizes | None = None) -> np.ndarray:
        """Effect parameters eta (ne): the plant's own but for `sizes`, e.g. {"coulomb@unwind": {"level": 0.002}}."""
        values = self.neutral.copy()
        for key, numbers in (*self.effects.items(), *(sizes or {}).items()):
            check_known("effect", key, self.effect_keys, file=self.name)
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

    def derivative(
        self,
        x,
        u,
        p=None,
        eta=None,
        *,
        t: Any = 0.0,
        angle: Sequence | None = None,
        inner: Sequence | None = None,
        rate: Sequence | None = None,
    ) -> list:
        """dx/dt (nx values) at states x, acting inputs u, parameters p and effects eta; scalars, arrays or symbols.

        angle: of every place in `turning`; inner: the effects' own states; rate: of the inputs in `swinging`; default 0.
        """
        return self._rates(x, u, p, eta, t, angle, inner, rate)[: len(self.states)]

    def inner_derivative(self, x, u, p, eta, t, angle, inner, rate) -> list:
        """Rates of change of the effects' own states, in the order of `inner`; arguments as for `derivative`."""
        return self._rates(x, u, p, eta, t, angle, inner, rate)[len(self.states) :]

    def seen_by(self, key: str, x, u, p, eta, *, t, angle, inner, rate) -> Named:
        """What the law of the effect `key` is given besides its numbers, such as .stretch; arguments as for `derivative`."""
        noted = Noted({i for i, slot in enumerate(self.slots) if slot.key == key})
        self._rates(x, u, p, eta, t, angle, inner, rate, noted)
        return noted.seen

    def _rates(self, x, u, p, eta, t, angle, inner, rate, opened: Opened | Noted | None = None) -> list:
        """Rates of change of the states and of the effects' own states; the laws of `opened` stand for themselves."""
        seen = {
            "x": dict(zip(self.state_names, x, strict=True)),
            "u": dict(zip(self.input_names, u, strict=True)),
            "angle": _by_name(self.turning, angle),
            "inner": _by_name(self.inner, inner),
            "inner_rate": dict.fromkeys(self.inner, 0.0),
            "rate": _by_name(self.swinging, rate),
            "t": t,
        }
        p = self.nominal if p is None else p
        eta = self.effect_vector() if eta is None else eta
        rates = self.equation(Named(seen["x"]), Named(seen["u"]), self._parameters(p), self._places(seen, eta, opened))
        return [*self._ordered("derivative of state", rates, self.state_names), *seen["inner_rate"].values()]

    def output(self, x, p=None, u=None) -> list:
        """Physical outputs (ny values) before sensors, at states x and parameters p; of a discrete plant also at inputs u."""
        p = self.nominal if p is None else p
        u = [0.0] * len(self.inputs) if u is None else u
        direct = [Named(dict(zip(self.input_names, u, strict=True)))] if self.discrete else []
        y = self.measure(Named(dict(zip(self.state_names, x, strict=True))), self._parameters(p), *direct)
        return self._ordered("output", y, self.output_names)

    def drive(self, u, eta, t, gaps=None) -> list:
        """Acting inputs (nu values) from commands: what the actuator effects make of them, delay apart.

        gaps: what the actuators keep, before the sample; default: as it is after a long hold of u.
        """
        gaps = self.settle_gaps(u, eta) if gaps is None else gaps
        driven = self._driven(u, eta, t, gaps, self.dt)
        return [driven[name].acting if name in driven else value for name, value in zip(self.input_names, u, strict=True)]

    def cross_gaps(self, u, eta, t, gaps) -> list:
        """What the actuators keep, after a sample under the held commands u."""
        return [m for driven in self._driven(u, eta, t, gaps, self.dt).values() for m in driven.memory]

    def settle_gaps(self, u, eta) -> list:
        """What the actuators keep after the commands u have been held for ever."""
        still = self._driven(u, eta, 0.0, [0.0] * len(self.gaps), FOREVER)
        return [m for driven in still.values() for m in driven.memory]

    def _driven(self, u, eta, t, gaps, dt) -> dict[str, Driven]:
        given = dict(zip(self.input_names, u, strict=True))
        return {
            name: Actuator(name, "").drive(self._effects_at("actuator", name, eta), own, given[name], t, dt)
            for name, own in zip(self.commanded, shares(gaps, len(self.commanded)), strict=True)
        }

    def remember(self, memory, z0, zm, z1, h, eta) -> list:
        """Sensor memories (nm values) after a step of length h in which the physical outputs went from z0 over zm to z1."""
        after, own = [], shares(memory, len(self.outputs))
        for i, (sensor, effects) in enumerate(self._sensors(eta)):
            after += sensor.remember(effects, own[i], z0[i], zm[i], z1[i], h)
        return after

    def settle(self, z, eta) -> list:
        """Sensor memories (nm values) after the physical outputs have stood at z for ever."""
        return [m for value, (sensor, effects) in zip(z, self._sensors(eta), strict=True) for m in sensor.settle(effects, value)]

    def read(self, memory, noise, eta) -> list:
        """Logged outputs (ny values) from the sensor memories and the noise of each channel."""
        own = shares(memory, len(self.outputs))
        return [sensor.read(effects, own[i], noise[i]) for i, (sensor, effects) in enumerate(self._sensors(eta))]

    def _sensors(self, eta) -> list[tuple[Sensor, list[tuple[Effect, Named]]]]:
        return [(Sensor(name, ""), self._effects_at("sensor", name, eta)) for name in self.output_names]

    def _parameters(self, p) -> Named:
        return Named(dict(zip((q.name for q in self.parameters), p, strict=True)))

    @cached_property
    def _numbers_at(self) -> dict[tuple[str, str], list[tuple[Effect, dict[str, int]]]]:
        """(family, place) -> its effects, each with the indices in eta of its numbers."""
        index: dict[str, dict[str, int]] = {}
        for i, slot in enumerate(self.slots):
            index.setdefault(slot.key, {})[slot.parameter.name] = i
        return {at: [(effect, index[f"{effect.id}@{at[1]}"]) for effect in own] for at, own in self.offered.items()}

    def _effects_at(self, family: str, place: str, eta) -> list[tuple[Effect, Named]]:
        own = self._numbers_at[family, place]
        return [(effect, Named({name: eta[i] for name, i in numbers.items()})) for effect, numbers in own]

    def _places(self, seen: dict[str, Any], eta, opened: Opened | Noted | None) -> Named:
        context = Named(seen)
        verbs: dict[str, dict] = {}
        for port in self.ports:
            effects = self._effects_at(port.family, port.place, eta)
            if opened:
                numbers = self._numbers_at[port.family, port.place]
                effects = [(opened.stand_in(effect, own), e) for (effect, e), (_, own) in zip(effects, numbers, strict=True)]
            verbs.setdefault(port.place, {}).update(port.verbs(effects, context))
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
            "angle": len(self.turning), "t": 1, "inner": len(self.inner), "rate": len(self.swinging),
        }  # fmt: skip
        return {name: ca.SX.sym(name, size) for name, size in sizes.items()}

    @cached_property
    def traced(self) -> ca.Function:
        """(x, u, p, eta, angle, t, inner, rate) -> (dx, y) as a CasADi function: the same equation on symbols."""
        s = self.symbols
        dx, y = self._traced_rates(None)[: len(self.states)], self._traced_output()
        return ca.Function(self._identifier, list(s.values()), [column(dx), column(y)], list(s), ["dx", "y"])

    @cached_property
    def parted(self) -> Parted:
        """The same equation with the laws of its effects taken out, so that what is off need not be computed."""
        opened = Opened(self.symbols)
        return Parted(column(self._traced_rates(opened)), tuple(opened.parts))

    @cached_property
    def computed(self) -> frozenset[str]:
        """Outputs that the equation makes of several states, of parameters or by a curve: more than one state in some unit."""
        x, y = self.symbols["x"], column(self._traced_output())
        J = ca.jacobian(y, x)
        read = [J[j, :].nnz() == 1 and J[j, :].is_constant() and len(ca.symvar(y[j])) == 1 for j in range(len(self.outputs))]
        return frozenset(name for name, plain in zip(self.output_names, read, strict=True) if not plain)

    @cached_property
    def laws(self) -> tuple[str, ...]:
        """States whose rate of change is a law that may be off: the others' say what the state means, as a speed is an angle's
        rate, and are one other state times a number.
        """
        s, rates = self.symbols, column(self._traced_rates(None)[: len(self.states)])
        J = ca.jacobian(rates, s["x"])
        found = []
        for i, name in enumerate(self.state_names):
            other = [j for j in range(len(self.states)) if J[i, j].nnz()]
            rest = ca.vertcat(*(value for key, value in s.items() if key != "x"))
            means = len(other) == 1 and other[0] != i and J[i, :].is_constant() and not ca.depends_on(rates[i], rest)
            found += [] if means else [name]
        return tuple(found)

    def _traced_rates(self, opened: Opened | None) -> list:
        s = {name: entries(symbol) for name, symbol in self.symbols.items()}
        try:
            with symbolic_numpy():
                return self._rates(s["x"], s["u"], s["p"], s["eta"], self.symbols["t"], s["angle"], s["inner"], s["rate"], opened)
        except RuntimeError as reason:
            raise self._branching(reason) from None

    def _traced_output(self) -> list:
        try:
            with symbolic_numpy():
                return self.output(*(entries(self.symbols[name]) for name in ("x", "p", "u")))
        except RuntimeError as reason:
            raise self._branching(reason) from None

    def _branching(self, reason: RuntimeError) -> Exception:
        """What a trace that failed is to say."""
        if "truth value" not in str(reason):
            return reason
        return InputError(
            "the equation has an `if`, `and`, `or`, `min` or `max` on a state, an input or a parameter",
            file=self.name,
            mend="write np.minimum, np.maximum or a smooth function such as np.tanh",
        )

    @property
    def _identifier(self) -> str:
        return "plant_" + "".join(c if c.isalnum() else "_" for c in self.name).strip("_")

    @cached_property
    def jacobians(self) -> ca.Function:
        """(x, u, p, eta, angle, t, inner, rate) -> (A, B, C), the Jacobians d(dx)/dx, d(dx)/du and dy/dx."""
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

    def jacobians_of(self, x: np.ndarray, u: np.ndarray, p: np.ndarray, eta: np.ndarray, *, t: float = 0.0) -> list[np.ndarray]:
        """A (R, nx, nx), B (R, nx, nu), C (R, ny, nx) at R points and time t [s]; arguments (R, ...)."""
        return [J.transpose(0, 2, 1) for J in self.evaluated(self.jacobians, x, u, p, eta, t)]

    def evaluated(self, function: ca.Function, x, u, p, eta, t: float = 0.0) -> list[np.ndarray]:
        """Results of a function of the symbols at R points, each (R, columns, rows): one call for all of them."""
        R = len(x)
        angle, inner, rate = (np.zeros((len(names), R)) for names in (self.turning, self.inner, self.swinging))
        results = function.map(R)(x.T, u.T, p.T, eta.T, angle, np.full((1, R), t), inner, rate)
        return [np.array(J).T.reshape(R, -1, J.shape[0]) for J in results]

    def with_parameters(self, values: Mapping[str, float]) -> "Plant":
        """The plant with these numbers in place of its own, which starts at its own rest.

        Fitted numbers need not leave one (a tank whose inflow became negative runs dry): there it starts where it did before.
        """
        p = self.parameter_vector(values)
        after = replace(self, parameters=tuple(replace(q, value=float(v)) for q, v in zip(self.parameters, p, strict=True)))
        if not self.start.solve_for:
            return after
        try:
            after.equilibrium()
        except InputError:
            x, u = self.equilibrium()
            names = (*self.state_names, *self.input_names)
            return replace(after, start=Start(dict(zip(names, (*x.tolist(), *u.tolist()), strict=True))))
        return after

    def equilibrium(self, p=None, **fixed: float) -> tuple[np.ndarray, np.ndarray]:
        """State x0 and input u0 at which the states in `start.zero` stand still; `fixed` replaces single values."""
        x, u = self.equilibria((self.nominal if p is None else np.asarray(p, dtype=float))[None], **fixed)
        return x[0], u[0]

    def equilibria(self, p: np.ndarray, **fixed: float) -> tuple[np.ndarray, np.ndarray]:
        """Equilibria x0 (R, nx), u0 (R, nu) for R parameter vectors p (R, np), effects neutral.

        Newton's method on the traced equation, each point to its own convergence, so that none depends on its neighbours; where
        it does not converge, or ends outside of the plant's limits, the search that `Start` describes. A fixed value among those
        to be solved for replaces the solution: the plant then starts beside its equilibrium. Raises InputError, with the number
        of unknowns and equations, where nothing is found.
        """
        return equilibria(self, p, fixed)


def _by_name(names, values) -> dict:
    return dict(zip(names, [0.0] * len(names) if values is None else values, strict=True))


def shares(values: Sequence, n: int) -> list[Sequence]:
    """A sequence in n equal shares."""
    each = len(values) // n if n else 0  # a plant that nothing commands has no shares
    return [values[i * each : (i + 1) * each] for i in range(n)]
