"""Discrete PID whose gains are surfaces over the schedule; one constant surface is a fixed PID.

    s  = the set-point r within `slew` from the last s
    m  : m'' = w^2 (s - m) - 2 w m',                             w = `bandwidth`: reference model, m = s where it is infinite
    l  : m `late` seconds ago, through a play of half width `play`: what the sensor shows where y follows
    v  = u0 + Kr m + Ka m' + Kaa m'' + g(m, m') + Kp (b l - y) + z + Kd f      parallel form, gains are matrices (nu, ny) of rho
    f  = a f- + (1 - a) ((c l - y) - (c l - y)-) / dt,           a = Tf / (Tf + dt): filtered derivative
    u  = v within `low`, `high` and `rate` from the last command;  of an actuator with a curve f the u with f(u) = v is
    z+ = z + dt Ki (l - y) + what keeps z from winding up

With curves all of the law is in v but u and its limits, and so is what is said of the loop: there the actuator is as good as
linear. Without slew and bandwidth m is r. The reference model is that of a set-point held since the sample before; a start
begins at rest at the first measurement. A set-point without one whose rates are fed forward is a path: m' and m'' are its
differences from sample to sample. g is what cancels effects that act by a curve over the motion, such as friction; what inverts
a dead zone or a gear's play acts on v last. Without dead time and play l is m. The integral is taken of Ki(rho) e, not Ki(rho)
times the integral of e: a schedule that moves while e = 0 moves u by what u0, Kr m and Kp (b - 1) l move, and not by the gains
(both are the same law where rho stands still). As a transfer function from e = l - y, with b = c = 1, Kr = Ka = Kaa = g = 0 and
z = exp(s dt):

    K(z) = Kp + Ki dt / (z - 1) + Kd (z - 1) / ((Tf + dt) z - Tf)

Sources: Astrom and Hagglund, "Advanced PID Control", ISA 2006, chapters 3 (weights, windup), 5 (two degrees of freedom) and 13
(the discrete law); Rugh and Shamma, "Research on gain scheduling", Automatica 36 (2000), section 5, on where the integral stands.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from controllers.cancelled import FAR, Compensation, Inverse
from workbench.basis import CONSTANT, Basis, Products, basis_from_dict, basis_to_dict, functions_at, knots_of
from workbench.curves import Curve, bent, check_single
from workbench.errors import InputError, check_known
from workbench.physics.controller import schedules_of
from workbench.records import field, record

if TYPE_CHECKING:
    import control


@record
class BackCalculation:
    """z+ += dt / tracking (u - v): the integral follows the command that a limit allowed, with this time constant.

    tracking None: |Kp| / |Ki| of each input, the integral time, but never below a sample.
    """

    tracking: np.ndarray | None = None  # (nu,) in s


@record
class Clamping:
    """The integral stands still while a limit is reached and it would push further beyond it."""


AntiWindup = BackCalculation | Clamping
ANTI_WINDUP: dict[str, type] = {"back-calculation": BackCalculation, "clamping": Clamping}
KIND = "scheduled-pid"
# of files with reference models; with curves; with accelerations, paths or compensations; with dead times, play or inverses:
# programs that know none refuse them
VERSIONS = SHAPED_VERSION, CURVED_VERSION, FED_VERSION, LATE_VERSION = 2, 3, 4, 5
LAW = "u = u0 + Kr r + Kp (b r - y) + z + Kd f, z+ = z + dt Ki (r - y), f the derivative of c r - y filtered by Tf"
SHAPED_LAW = (
    "u = u0 + Kr m + Ka m' + Kp (b m - y) + z + Kd f, z+ = z + dt Ki (m - y), f the derivative of c m - y filtered by Tf, "
    "m'' = w^2 (s - m) - 2 w m' with w the bandwidth, s the set-point within slew of the last s"
)
FED_LAW = "{law}; added to u: Kaa m''{own}; m' and m'' of a set-point without a reference model are its differences"
LATE_LAW = "{law}; the loop follows l in place of m: m late seconds ago, through a play of half width play"
CURVED_LAW = "{law}; of actuators with a curve all of this is v = f(u), and u the command with f(u) = v, within its limits"
INVERTED_LAW = (
    "{law}; where there is an inverse, u is that command + half_width s + (play s / 2 - g) / dt, s its sign, which changes "
    "beyond keep, g+ = g + (u - half_width s) dt within play / 2 of 0"
)
LONGEST_LATE = 200  # samples that a dead time may last


@record
class ScheduledPID:
    """u from r and y by a PID law with gains K(rho) = sum_j K_j phi_j(rho).

    u = u0 + Kr m + Ka m' + Kaa m'' + Kp (b m - y) + z + Kd f, z+ = z + dt Ki (m - y), f the filtered derivative of c m - y; m is
    the set-point r, or what a reference model makes of it.

    Kp (m, nu, ny), Ki [1/s], Kd [s], Kr, u0 (m, nu): coefficients of the m basis functions; Kr: feedforward of the set-points.
    `schedule` names the measured output that is rho; outside `span` the gains hold their edge value. Of several schedule
    variables `schedule` is a tuple, `span` (ns, 2), and rho (ns,). b, c (ny): set-point weights of the proportional and the
    derivative part. Tf [s]: time constant of the derivative filter. low, high, rate [1/s] (nu): limits of the command.
    slew [1/s], bandwidth [rad/s] (ny), or one number for all: largest rate of the set-points, and speed of their reference
    models; infinite: none. Ka [s], Kaa [s^2] (m, nu, ny): feedforward of the rates and accelerations of the reference models, or
    of set-points without one, which are paths then. compensations: what is added by curves over the motion of the set-points.
    late [s] (ny): dead time after which an output follows what is commanded. play (ny): half width of a sensor's. The loop awaits
    what the sensor will show. inverses: of dead zones and play of actuators. curves: v = f(u) of actuators, which rise
    everywhere: the law is that of v, and commands u.

        >>> law.gains_at(0.0).Ki.round(1), law.gains_at(10.0).Ki.round(1)
        (array([[1.5]]), array([[2.1]]))
    """

    actuated: tuple[str, ...]
    measured: tuple[str, ...]
    references: tuple[str, ...]
    dt: float = field("", unit="s", low=1e-9, high=FAR)
    Kp: np.ndarray = field("m nu ny", low=-FAR, high=FAR)
    Ki: np.ndarray = field("m nu ny", unit="1/s", low=-FAR, high=FAR)
    Kd: np.ndarray = field("m nu ny", unit="s", low=-FAR, high=FAR)
    Kr: np.ndarray = field("m nu ny", low=-FAR, high=FAR)
    u0: np.ndarray = field("m nu", low=-FAR, high=FAR)
    b: np.ndarray = field("ny")
    c: np.ndarray = field("ny")
    low: np.ndarray = field("nu")
    high: np.ndarray = field("nu")
    rate: np.ndarray = field("nu", unit="1/s", low=1e-300)
    Tf: float = field("", unit="s", low=0.0, high=FAR)
    anti_windup: AntiWindup = field(default_factory=BackCalculation)
    basis: Basis = CONSTANT
    schedule: str | tuple[str, ...] | None = None
    span: np.ndarray = field("...", default=(-np.inf, np.inf))
    slew: np.ndarray = field("...", unit="1/s", low=1e-300, default=np.inf)
    bandwidth: np.ndarray = field("...", unit="rad/s", low=1e-300, default=np.inf)
    Ka: np.ndarray = field("...", unit="s", low=-FAR, high=FAR, default=0.0)
    Kaa: np.ndarray = field("...", unit="s^2", low=-FAR, high=FAR, default=0.0)
    compensations: tuple[Compensation, ...] = ()
    late: np.ndarray = field("...", unit="s", low=0.0, high=FAR, default=0.0)
    play: np.ndarray = field("...", low=0.0, high=FAR, default=0.0)
    inverses: tuple[Inverse, ...] = ()
    curves: tuple[Curve, ...] = ()
    name: str = "scheduled-pid"
    units: dict[str, str] = field(default_factory=dict)  # of the channels by name, where they are known

    def __post_init__(self):
        m, nu, ny = self.Kp.shape
        for kind, names, size in (
            ("actuated", self.actuated, nu),
            ("measured", self.measured, ny),
            ("references", self.references, ny),
        ):
            if len(names) != size:
                raise InputError(f"{len(names)} {kind} names for gains of shape ({nu}, {ny})", file=self.name)
        if len(self.basis.names) != m:
            raise InputError(f"{m} coefficients for {len(self.basis.names)} basis functions", file=self.name)
        check_limits(self.name, self.actuated, self.low, self.high)
        surfaces = (("Ka", self.Kp.shape, 0.0), ("Kaa", self.Kp.shape, 0.0))
        each = (("slew", np.inf), ("bandwidth", np.inf), ("late", 0.0), ("play", 0.0))
        for key, shape, none in (*((key, (ny,), none) for key, none in each), *surfaces):
            given = np.asarray(getattr(self, key))
            given = np.asarray(none) if (given == none).all() else given
            if given.shape not in ((), shape):
                raise InputError(f"{key} of shape {given.shape}", file=self.name, mend=f"one number, or shape {shape}")
            object.__setattr__(self, key, np.broadcast_to(given, shape))
        for own in self.compensations:
            check_known("actuated channel", own.input, self.actuated, file=self.name)
            if own.position.shape != (ny,) or own.motion.shape != (ny,):
                raise InputError(f"compensation of {own.effect}: weights for {len(own.motion)} outputs", file=self.name)
        if (lags := self.lags[0]).max() >= LONGEST_LATE:
            problem = f"dead time of {lags.max()} samples"
            raise InputError(problem, file=self.name, mend=f"give late of less than {LONGEST_LATE} samples")
        check_single((own.input for own in self.inverses), self.name, "inverses")
        for own in self.inverses:
            check_known("actuated channel", own.input, self.actuated, file=self.name)
        check_single((own.input for own in self.curves), self.name)
        for curve in self.curves:
            check_known("actuated channel", curve.input, self.actuated, file=self.name)
            curve.check_rising()
        if self.schedule is None and m > 1:
            raise InputError("the gains move with a schedule that is not named", file=self.name, mend="give schedule=")
        several = schedules_of(self) if isinstance(self.schedule, tuple) else ()
        if len(several) == 1:
            raise InputError(f"schedule {self.schedule}", file=self.name, mend=f"one variable by its name: {several[0]!r}")
        if several and not (isinstance(self.basis, Products) and len(self.basis.factors) == len(several)):
            mend = "give basis=Products((..), ..) with functions of each"
            raise InputError(f"no functions of {', '.join(several)} together", file=self.name, mend=mend)
        low, high = self.span[..., 0], self.span[..., -1]
        if self.span.shape != ((len(several), 2) if several else (2,)):
            mend = f"({len(several)}, 2): lowest and highest of each of {', '.join(several)}" if several else "(lowest, highest)"
            raise InputError(f"span of shape {self.span.shape}", file=self.name, mend=f"give span={mend}")
        if self.schedule is not None and not (np.isfinite(self.span).all() and np.all(low < high)):
            raise InputError(
                f"schedule range from {low.tolist()} to {high.tolist()}", file=self.name, mend="give span=(lowest, highest)"
            )
        if self.tracking.shape != (nu,) or not np.all(self.tracking >= self.dt):
            raise InputError(
                f"tracking times {self.tracking.tolist()} s", file=self.name, mend=f"{nu} of them, each at least {self.dt:g} s"
            )

    @property
    def tracking(self) -> np.ndarray:
        """Time constants (nu,) in s with which the integrals follow a limited command; infinite for clamping."""
        if isinstance(self.anti_windup, Clamping):
            return np.full(len(self.actuated), np.inf)
        if self.anti_windup.tracking is not None:
            return np.atleast_1d(np.asarray(self.anti_windup.tracking, dtype=float))
        middle = self.gains_at(self.span.mean(axis=-1) if self.schedule else None)
        direct, integral = np.linalg.norm(middle.Kp, axis=1), np.linalg.norm(middle.Ki, axis=1)
        times = np.divide(direct, integral, out=np.full(len(direct), self.dt), where=integral > 0.0)
        return np.maximum(times, self.dt)

    @cached_property
    def shaped(self) -> bool:
        """Whether a set-point goes through a slew limit or a reference model, its rates are fed forward, or the loop awaits
        something else.
        """
        moved = self.Ka.any() or self.Kaa.any() or any(own.motion.any() for own in self.compensations)
        return bool(np.isfinite([self.slew, self.bandwidth]).any() or moved or self.awaits)

    @property
    def awaits(self) -> bool:
        """Whether the loop awaits something else than m."""
        return bool(self.late.any() or self.play.any())

    @cached_property
    def lags(self) -> tuple[np.ndarray, np.ndarray]:
        """Whole samples of the dead times (ny,), and the share of one more."""
        n = np.round(self.late / self.dt, 9)
        return np.floor(n).astype(int), n % 1.0

    @property
    def _kept(self) -> int:
        """Samples of m that are remembered of every output."""
        return int(self.lags[0].max()) + 1 if self.late.any() else 0

    @cached_property
    def paths(self) -> np.ndarray:
        """Whether a set-point (ny,) is a path: rates are fed forward that are its differences from sample to sample."""
        used = np.any([self.Ka.any(axis=(0, 1)), self.Kaa.any(axis=(0, 1)), *(own.motion for own in self.compensations)], axis=0)
        return used & ~np.isfinite(self.bandwidth)

    @property
    def gain_names(self) -> tuple[str, ...]:
        """Of Kp, Ki, Kd, Kr, Ka, Kaa those that the law has."""
        return ("Kp", "Ki", "Kd", "Kr", *["Ka"] * self.shaped, *["Kaa"] * bool(self.Kaa.any()))

    @property
    def unshaped(self) -> "ScheduledPID":
        """The law from l to v: what is in the loop, and the same for every slew and reference model."""
        free = {"slew": np.inf, "bandwidth": np.inf, "Ka": 0.0, "Kaa": 0.0, "compensations": (), "late": 0.0, "play": 0.0}
        return replace(self, **free, inverses=()) if self.shaped or self.cancels else self

    @property
    def cancels(self) -> bool:
        """Whether it is not linear even where no limit acts, for what it cancels is not."""
        return bool(self.compensations or self.play.any() or self.inverses)

    @property
    def uncompensated(self) -> "ScheduledPID":
        """The law without what cancels effects that are not linear: in the loop is the same but for inverses."""
        return replace(self, compensations=(), play=0.0, inverses=()) if self.cancels else self

    @property
    def inside(self) -> "ScheduledPID":
        """The law of v: what is in the loop behind the curves of its actuators, and the same for every curve.

        Its limits are what those of u let through; of a rate what is left of it where the curve is flattest.
        """
        if not self.curves:
            return self
        low, high, rate = let_through(self.curves, self.actuated, self.low, self.high, self.rate)
        return replace(self, low=low, high=high, rate=rate, curves=())

    def slewed(self, references: np.ndarray, before: np.ndarray) -> np.ndarray:
        """Set-points (N, ny) within their slew, from `before` (ny,) on: what the linear form is given."""
        found, last = np.empty_like(references), before
        for k, r in enumerate(references):
            found[k] = last = _near(last, self.slew * self.dt, r)
        return found

    def aimed(self, references: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """m, m' and l (N, ny) of set-points (N, ny), from a start at measurements y (ny,)."""
        K, state = self._before_the_loop, self._split(self.init())
        m, rates = np.array(references, dtype=float), np.zeros(np.shape(references))
        awaited = m.copy()
        for k, r in enumerate(references if self.shaped else ()):
            aim = self._aim(K, state, r, y)
            m[k], rates[k], awaited[k] = aim.m, aim.rate, aim.awaited
            state = state._replace(s=aim.s, m=aim.m, rate=aim.rate, line=aim.line, shown=aim.shown, cold=0.0)
        return m, rates, awaited

    @property
    def _before_the_loop(self) -> Any:
        """The numbers that `_aim` takes."""
        return SimpleNamespace(
            slew=self.slew * self.dt, reference_model=self.reference_model, acceleration=self.acceleration,
            share=self.lags[1], play=self.play,
        )  # fmt: skip

    def arrival(self, step: np.ndarray) -> float:
        """Seconds in which l has come to its set-points after steps (ny,) of them: 96 % of the way."""
        return float(np.max(np.abs(step) / self.slew + 5.0 / self.bandwidth + self.late))

    def unit(self, channel: str) -> str:
        """Unit of a channel, "" where it is not known; a set-point has that of its output."""
        return self.units.get(dict(zip(self.references, self.measured, strict=True)).get(channel, channel), "")

    def gain_unit(self, actuated: str, measured: str, time: str = "") -> str:
        """[V/(rad/s)] of a gain with what `time` adds to it, "/s" or " s"; "" where a unit is not known."""
        units = self.unit(actuated), self.unit(measured)
        return f"[{units[0]}/({units[1]}){time}]" if all(units) else ""

    # ---- frozen ---------------------------------------------------------------------------------------------------------

    def outside(self, rho: np.ndarray) -> float:
        """How far a schedule leaves the span, where the gains hold their edge value, in widths of the span; 0 inside."""
        if self.schedule is None:
            return 0.0
        low, high = self.span[..., 0], self.span[..., 1]
        return float(np.max(np.maximum(low - rho, rho - high) / (high - low), initial=0.0))

    def gains_at(self, rho: Any = None) -> "Gains":
        """Kp, Ki, Kd, Kr, Ka, Kaa (nu, ny) and u0 (nu,) at one schedule value, (ns,) of several variables."""
        weight = self.basis(np.clip(0.0 if rho is None else rho, self.span[..., 0], self.span[..., 1]))
        return Gains(*(np.tensordot(weight, getattr(self, key), 1) for key in Gains._fields))

    def offset(self, rho: Any = None) -> np.ndarray:
        """u0 (nu,) at one schedule value."""
        return self.gains_at(rho).u0

    def at(self, rho: Any = None) -> "control.StateSpace":
        """The unlimited law at one schedule value: python-control system from (r, y) to u - u0, states z, f, last c l - y, m, m'
        of the set-points that have a reference model or are paths, and the last m of those that are awaited later; without slew
        limits and what cancels effects that are not linear.

        Without the z of commands that nothing is integrated for: they stay at 0, and are no pole at 1.
        """
        import control  # takes a second to import, and only this needs it

        K, (nu, ny) = self.gains_at(rho), self.Kp.shape[1:]
        integrated, modelled = self.Ki.any(axis=(0, 2)), np.isfinite(self.bandwidth) | self.paths
        lines = np.where(self.late > 0.0, self.lags[0] + 1, 0)
        sizes = integrated.sum(), ny, ny, modelled.sum(), modelled.sum(), *lines, ny, ny
        # every signal is a row over (z, f, d, m, m', lines of last m, r, y)
        z, f, d, m, rate, *last, r, y = np.split(np.eye(sum(sizes)), np.cumsum(sizes)[:-1])
        before = [np.eye(ny)[:, modelled] @ own for own in (m, rate)]
        own, to = self.reference_model, self.acceleration
        m, rate = (own[:, [i]] * before[0] + own[:, [i + 1]] * before[1] + own[:, [i + 2]] * r for i in (0, 3))
        acceleration = to[:, [0]] * (r - m) + to[:, [1]] * rate + to[:, [2]] * before[1]
        newest = [np.vstack([m[[j]], own]) for j, own in enumerate(last)]
        awaited = np.array([_between(own, k, share) for own, k, share in zip(newest, *self.lags, strict=True)])
        a, slope = self.Tf / (self.Tf + self.dt), self.c[:, None] * awaited - y
        after_f = a * f + (1.0 - a) / self.dt * (slope - d)
        after_z = z + self.dt * K.Ki[integrated] @ (awaited - y)
        fed = K.Kr @ m + K.Ka @ rate + K.Kaa @ acceleration
        u = fed + K.Kp @ (self.b[:, None] * awaited - y) + np.eye(nu)[:, integrated] @ z + K.Kd @ after_f
        after = np.vstack([after_z, after_f, slope, m[modelled], rate[modelled], *(own[:-1] for own in newest)])
        (A, B), (C, D) = (np.split(own, [len(after)], axis=1) for own in (after, u))
        return control.StateSpace(
            A, B, C, D, self.dt, inputs=[*self.references, *self.measured], outputs=list(self.actuated), name=self.name
        )

    @property
    def reference_model(self) -> np.ndarray:
        """(ny, 6): m of m-, m'- and s, then m' of them; the critically damped model over a sample in which s stands still, and
        m = s with its difference from the last of a path.
        """
        w = np.where(np.isfinite(self.bandwidth), self.bandwidth, 0.0)
        x = np.minimum(w * self.dt, 700.0)  # what is faster is as fast
        w = x / self.dt
        decay = np.where(np.isfinite(self.bandwidth), np.exp(-x), 0.0)
        path = self.paths / self.dt
        return np.column_stack(
            [(1 + x) * decay, self.dt * decay, 1 - (1 + x) * decay, -w * x * decay - path, (1 - x) * decay, w * x * decay + path]
        )

    @property
    def acceleration(self) -> np.ndarray:
        """(ny, 3): m'' of s - m, m' and the last m'; of a path the difference of its rates."""
        w, path = np.where(np.isfinite(self.bandwidth), self.bandwidth, 0.0), self.paths / self.dt
        w = np.minimum(w, 700.0 / self.dt)
        return np.column_stack([w**2, path - 2.0 * w, -path])

    def response(self, omega: np.ndarray, rho: Any = None) -> np.ndarray:
        """K(exp(j omega dt)), (len(omega), nu, ny), of the unlimited law from e = m - y, all weights 1, without feedforward."""
        return np.einsum("wq,qij->wij", parts(omega, self.dt, self.Tf), np.stack(self.gains_at(rho)[:3]))

    # ---- files ----------------------------------------------------------------------------------------------------------

    @property
    def sentence(self) -> str:
        """The law in a line."""
        law = SHAPED_LAW if self.shaped else LAW
        if self._fed:
            law = FED_LAW.format(law=law, own=", and g(position m + motion m') of every compensation" * bool(self.compensations))
        law = LATE_LAW.format(law=law) if self.awaits else law
        law = CURVED_LAW.format(law=law) if self.curves else law
        return INVERTED_LAW.format(law=law) if self.inverses else law

    @property
    def _fed(self) -> bool:
        """Whether it feeds forward what programs of before do not know."""
        return bool(self.Kaa.any() or self.paths.any() or self.compensations)

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, readable without the package; a limit that is not there is null."""
        kind = next(kind for kind, cls in ANTI_WINDUP.items() if isinstance(self.anti_windup, cls))
        shaping = {"slew": finite(self.slew), "bandwidth": finite(self.bandwidth), "Ka": self.Ka, "version": SHAPED_VERSION}
        curves = {"curves": [curve.to_dict() for curve in self.curves], "version": CURVED_VERSION}
        fed = curves | {"Kaa": self.Kaa, "compensations": [own.to_dict() for own in self.compensations], "version": FED_VERSION}
        awaits = {"late": self.late, "play": self.play, "inverses": [vars(own) for own in self.inverses], "version": LATE_VERSION}
        every = shaping | fed | awaits
        return {
            "kind": KIND,
            "law": self.sentence,
            "name": self.name, "dt": self.dt, "actuated": list(self.actuated), "measured": list(self.measured),
            "references": list(self.references),
            "schedule": list(self.schedule) if isinstance(self.schedule, tuple) else self.schedule,
            "span": _finite_ends(self.span),
            "basis": basis_to_dict(self.basis), "Kp": self.Kp, "Ki": self.Ki, "Kd": self.Kd, "Kr": self.Kr, "u0": self.u0,
            "b": self.b, "c": self.c, "Tf": self.Tf, "low": finite(self.low), "high": finite(self.high),
            "rate": finite(self.rate), "anti_windup": {"kind": kind} | vars(self.anti_windup), "units": self.units,
        } | (shaping if self.shaped else {}) | (curves if self.curves else {}) | (fed if self._fed else {}) | (
            every if self.awaits or self.inverses else {}
        )  # fmt: skip

    @classmethod
    def from_dict(cls, content: dict[str, Any]) -> "ScheduledPID":
        """The law that `to_dict` wrote."""
        anti_windup = dict(content["anti_windup"])
        schedule = tuple(own) if isinstance(own := content["schedule"], list) else own
        version, fed = content.get("version"), {}
        own_curves = content["curves"] if version in (CURVED_VERSION, FED_VERSION, LATE_VERSION) else ()
        if version == LATE_VERSION:
            fed |= {key: content[key] for key in ("late", "play")}
            fed |= {"inverses": tuple(Inverse(**own) for own in content["inverses"])}
        if version in (FED_VERSION, LATE_VERSION):
            fed |= {"Kaa": content["Kaa"], "compensations": tuple(map(Compensation.from_dict, content["compensations"]))}
        return cls(
            actuated=tuple(content["actuated"]), measured=tuple(content["measured"]), references=tuple(content["references"]),
            dt=content["dt"], Kp=content["Kp"], Ki=content["Ki"], Kd=content["Kd"],
            Kr=content.get("Kr", np.zeros(np.shape(content["Kp"]))), u0=content["u0"], b=content["b"], c=content["c"],
            low=unlimited(content["low"], -np.inf), high=unlimited(content["high"], np.inf),
            rate=unlimited(content["rate"], np.inf), Tf=content["Tf"], basis=basis_from_dict(content["basis"]),
            anti_windup=ANTI_WINDUP[check_known("anti-windup", anti_windup.pop("kind"), ANTI_WINDUP)](**anti_windup),
            schedule=schedule, name=content["name"], units=dict(content.get("units", {})), span=_ends(content["span"]),
            **{key: unlimited(content[key], np.inf) for key in ("slew", "bandwidth") if key in content},
            Ka=content.get("Ka", 0.0), curves=tuple(map(Curve.from_dict, own_curves)), **fed,
        )  # fmt: skip

    def export(self, form: str, folder: str | Path, *, name: str | None = None, single: bool = False) -> list[Path]:
        """Write the law for another program, as "c", "st", "csv" or "json"; see `controllers.export`. Returns the paths."""
        from controllers.export import export  # which imports this module

        return export(self, form, name=name, single=single).save(folder)

    # ---- the law --------------------------------------------------------------------------------------------------------

    @property
    def gains(self) -> np.ndarray:
        """Every number of the law, but those of a basis that is not piecewise linear, in the order in which `law` takes them."""
        surfaces = (self.Kp, self.Ki * self.dt, self.Kd, self.Kr, self.u0)
        knots = knots_of(self.basis)  # other knots, same kernel
        numbers = (self.span, *knots, *surfaces, self.b, self.c, self.low, self.high, self.rate * self.dt)
        decay = self.Tf / (self.Tf + self.dt)
        shaping = (self.slew * self.dt, self.reference_model, self.acceleration, self.Ka, self.Kaa) if self.shaped else ()
        awaited = (self.lags[1], self.play) if self.shaped else ()
        curves = [own for c in self.curves for own in (c.bends, c.back.bends)]
        added = [own for c in self.compensations for own in (c.position, c.motion, c.curve.bends)]
        inverses = [np.append(own.numbers, 1.0 / self.dt) for own in self.inverses]
        rest = (
            self.dt / self.tracking, np.array([decay, (1 - decay) / self.dt]), *shaping, *awaited, *curves, *added, *inverses
        )  # fmt: skip
        every = np.concatenate([n.ravel() for n in (*numbers, *rest)])
        return np.clip(every, -FAR, FAR)  # compiled limits count on finite numbers

    def init(self, u: np.ndarray | None = None) -> np.ndarray:
        """Memory before the first sample: z (nu), f (ny), last c l - y (ny), last u (nu), cold, taking over; where set-points are
        shaped s, m, m' (ny each), the last m of outputs with a dead time and l of a play; side and teeth of inverses.

        Without u the first command is that of z = 0. With u it is u itself, for as long as a path's acceleration is not known: a
        start without a bump. The samples for which that is so are counted in "cold" and "taking over".
        """
        nu, ny = self.Kp.shape[1:]
        last, unknown = np.zeros(nu) if u is None else np.asarray(u, dtype=float), self._unknown
        begins = [unknown, 0.0 if u is None else unknown]
        return np.concatenate([np.zeros(nu + 2 * ny), last, begins, np.zeros(sum(self._tail))])

    @property
    def _tail(self) -> tuple[int, ...]:
        """Sizes of the memory after "taking over": s, m, m', the last m, l; side and teeth."""
        ny, ni = len(self.measured), len(self.inverses)
        return (*(ny * self.shaped,) * 3, ny * self._kept, ny * bool(self.play.any()), ni, ni)

    @cached_property
    def _unknown(self) -> float:
        """Samples after which a path's rate and acceleration are known: three, and 1 of other laws."""
        return 3.0 if self.paths.any() else 1.0

    def law(self, gains: Any, state: Any, r: Any, y: Any, rho: Any = None) -> tuple[list, list]:
        """(u, memory) on numbers, arrays or symbols."""
        K, at = self._numbers(gains, rho), self._split(state)
        cold, takes_over = (np.maximum(own - 1.0, 0.0) for own in (at.cold, at.takes_over))  # after this sample
        at = at._replace(takes_over=np.minimum(at.takes_over, 1.0))
        aim = self._aim(K, at, r, y)
        at = at._replace(cold=self._first(at.cold))
        l = aim.awaited  # noqa: E741
        direct, f, d = self._direct(K, at, aim, y)
        after, u, sides, teeth = [], [], list(at.side), list(at.teeth)
        for i, own in enumerate(direct):
            z = at.z[i] + at.takes_over * (K.arrives(i, K.through(i, at.u[i])) - own - at.z[i])
            v = own + z
            reach = K.rate[i] + FAR * at.cold * (1.0 - at.takes_over)  # a cold start has no last command to be near to
            wanted, added = K.commanded(i, v), 0.0
            if n := K.inverses.get(i):
                sides[n.k], begun, added = n.added(wanted, at.side[n.k], at.teeth[n.k], at.takes_over)
            wanted = wanted + added
            u.append(np.maximum(K.low[i], np.minimum(K.high[i], _near(at.u[i], reach, wanted))))
            push = sum((K.Ki[i][j] * (l[j] - y[j]) for j in range(1, len(y))), K.Ki[i][0] * (l[0] - y[0]))
            if isinstance(self.anti_windup, Clamping):
                push = push * (1.0 - ((wanted - u[i]) * push > 0.0))
            after.append(z + push + K.follow[i] * (K.arrives(i, u[i] - added) - v))
            if n:
                teeth[n.k] = n.after(begun, sides[n.k], u[i])
        return u, [*after, *f, *d, *u, cold, takes_over, *aim.memory, *sides, *teeth]

    def step(self, state: np.ndarray, r: np.ndarray, y: np.ndarray, rho: Any = None) -> tuple[np.ndarray, np.ndarray]:
        """One sample: (u, next memory). Where a set-point, a measurement or the schedule is no finite number, the last command
        is held and nothing is remembered: the sample is left out. A path goes on all the same.
        """
        if not np.isfinite([*r, *y, *np.atleast_1d(0.0 if self.schedule is None or rho is None else rho)]).all():
            return np.clip(self._split(state).u, self.low, self.high), self._passed(state, r)
        u, after = self.law(self.gains, state, r, y, rho)
        return np.array(u, dtype=float), np.array(after, dtype=float)

    def _passed(self, state: np.ndarray, r: np.ndarray) -> np.ndarray:
        """Memory after a sample that is left out: a path goes on, guessed where it is no number; then the next commands go on
        from the last one.
        """
        at = self._split(state)
        if not self.paths.any() or at.cold == self._unknown:
            return state
        known = np.isfinite(r)
        on = np.where(known, r, np.add(at.m, np.multiply(self.dt, at.rate)))
        aim = self._aim(self._before_the_loop, at, on, on)
        pairs = ((aim.s, at.s), (aim.m, at.m), (aim.rate, at.rate), (aim.line, at.line), (aim.shown, at.shown))
        kept = [now if path else old for new, own in pairs for now, old, path in zip(new, own, self.paths, strict=False)]
        begins = [at.cold, self._unknown if (self.paths & ~known).any() else at.takes_over]
        return np.concatenate([at.z, at.f, at.d, at.u, begins, np.hstack(kept), at.side, at.teeth])

    def follow(self, state: np.ndarray, u: np.ndarray, r: np.ndarray, y: np.ndarray, rho: Any = None) -> np.ndarray:
        """Memory after a sample in which somebody else commanded u: a person, another controller, this one with other gains.

        The next command goes on from u without a bump; use it in place of `step` while the loop is open, and once with the new
        law when gains change: where only one of the two has reference models, they begin at rest here, and so does what only
        this one awaits.
        """
        expected, ny = len(self.init()), len(self.measured)
        plain, shaped = (expected - sum(self._tail) + n * ny for n in (0, 3))
        if len(state) != expected:
            if len(state) not in (plain, shaped):
                raise InputError(f"memory of {len(state)} numbers", file=self.name, mend=f"{expected}: that of a law like it")
            begins = np.where(self.paths, r, y)
            models = state[plain:] if len(state) == shaped else np.concatenate([begins, begins, np.zeros(ny)])
            rest = (models, np.repeat(models[ny : 2 * ny], self._kept), models[ny : 2 * ny] * bool(self.play.any()))
            state = np.append(state[:plain], np.concatenate(rest)[: expected - plain] if self.shaped else [])
            state = np.pad(state, (0, expected - len(state)))
        K, at = self._numbers(self.gains, rho), self._split(state)
        aim = self._aim(K, at, r, y)
        at = at._replace(cold=self._first(at.cold))
        direct, f, d = self._direct(K, at, aim, y)
        f = [0.0 if path else own for own, path in zip(f, self.paths, strict=True)]  # of another law's m it says nothing
        arrived = [K.through(i, own) for i, own in enumerate(u)]
        z = [K.arrives(i, own) - other for i, (own, other) in enumerate(zip(arrived, direct, strict=True))]
        sides = [np.sign(arrived[i]) for i in K.inverses]
        teeth = [0.5 * n.play * side for n, side in zip(K.inverses.values(), sides, strict=True)]
        begins = [0.0, self._unknown * self.paths.any()]
        return np.array([*z, *f, *d, *u, *begins, *aim.memory, *sides, *teeth], dtype=float)

    def _first(self, cold: Any) -> Any:
        """1 at the first sample, else 0."""
        return np.maximum(cold - (self._unknown - 1.0), 0.0)

    def _aim(self, K: "_Numbers", at: "_Memory", r: Any, y: Any) -> "_Aim":
        """What the loop follows: the set-points within their slew, through their reference models."""
        if not self.shaped:
            return _Aim(list(r), [], [], [], list(r), [], [])
        s, m, rate, acceleration, awaited, lines, shown = [], [], [], [], [], [], []
        for j, ((a, b, c, d, e, f), (g, h, i)) in enumerate(zip(K.reference_model, K.acceleration, strict=True)):
            begins = r[j] if self.paths[j] else y[j]
            held, was = (own[j] + self._first(at.cold) * (begins - own[j]) for own in (at.s, at.m))
            s.append(_near(held, K.slew[j], r[j]))
            m.append(a * was + b * at.rate[j] + c * s[j])
            rate.append(d * was + e * at.rate[j] + f * s[j])
            change = g * (s[j] - m[j]) + h * rate[j] + i * at.rate[j]
            acceleration.append(change * (1.0 - np.minimum(np.maximum(at.cold - 1.0, 0.0), 1.0)) if self.paths[j] else change)
            line = [m[j], *(own + self._first(at.cold) * (begins - own) for own in (at.line[j] if self._kept else ()))]
            awaited.append(_between(line, int(self.lags[0][j]), K.share[j]) if self._kept else m[j])
            if self._kept:
                lines.append(line[:-1])
            if self.play.any():
                stood = at.shown[j] + self._first(at.cold) * (awaited[j] - at.shown[j])
                awaited[j] = _near(awaited[j], K.play[j], stood)
                shown.append(awaited[j])
        return _Aim(m, rate, acceleration, s, awaited, lines, shown)

    def _direct(self, K: "_Numbers", at: "_Memory", aim: "_Aim", y: Any) -> tuple[list, list, list]:
        """The command without the integral, f, and c l - y."""
        r, l = aim.m, aim.awaited  # noqa: E741
        d = [K.c[j] * l[j] - y[j] for j in range(len(y))]
        f = [K.decay * at.f[j] + K.fresh * (d[j] - at.d[j]) * (1.0 - at.cold) for j in range(len(y))]
        direct = []
        for i, own in enumerate(K.u0):
            for j in range(len(y)):
                own = own + K.Kr[i][j] * r[j] + K.Kp[i][j] * (K.b[j] * l[j] - y[j]) + K.Kd[i][j] * f[j]
                own = own + K.Ka[i][j] * aim.rate[j] + K.Kaa[i][j] * aim.acceleration[j] if aim.rate else own
            direct.append(own)
        for c, (position, motion, bends) in zip(self.compensations, K.compensations, strict=True):
            s = sum(p * m for p, m in zip(position, r, strict=True)) + sum(
                w * rate for w, rate in zip(motion, aim.rate or [0.0] * len(r), strict=True)
            )
            i = self.actuated.index(c.input)
            direct[i] = direct[i] + bent(s, bends)
        return direct, f, d

    def _numbers(self, gains: Any, rho: Any) -> "_Numbers":
        m, nu, ny = self.Kp.shape
        rest = iter(range(len(self.gains)))

        def take(n: int) -> list:
            return [gains[next(rest)] for _ in range(n)]

        ends, several = [take(2) for _ in self.span.reshape(-1, 2)], isinstance(self.schedule, tuple)
        values = [rho[i] for i in range(len(ends))] if several else [rho]
        inside = [
            0.0 if self.schedule is None else np.maximum(a, np.minimum(b, v)) for (a, b), v in zip(ends, values, strict=True)
        ]
        phi = functions_at(self.basis, inside if several else inside[0], [take(len(own)) for own in knots_of(self.basis)])

        def surface(n: int) -> list:
            terms = [take(n) for _ in range(m)]
            if m == 1:
                return terms[0] if self.schedule is None else [phi[0] * k for k in terms[0]]
            return [sum((w * own[i] for w, own in zip(phi[1:], terms[1:], strict=True)), phi[0] * terms[0][i]) for i in range(n)]

        def matrix() -> list[list]:
            flat = surface(nu * ny)
            return [flat[i * ny : (i + 1) * ny] for i in range(nu)]

        return _Numbers(
            Kp=matrix(), Ki=matrix(), Kd=matrix(), Kr=matrix(), u0=surface(nu), b=take(ny), c=take(ny), low=take(nu),
            high=take(nu), rate=take(nu), follow=take(nu), decay=take(1)[0], fresh=take(1)[0],
            slew=take(ny * self.shaped), reference_model=[take(6) for _ in range(ny * self.shaped)],
            acceleration=[take(3) for _ in range(ny * self.shaped)],
            Ka=matrix() if self.shaped else [], Kaa=matrix() if self.shaped else [],
            share=take(ny * self.shaped), play=take(ny * self.shaped),
            curves={self.actuated.index(c.input): (take(len(c.bends)), take(len(c.bends))) for c in self.curves},
            compensations=[(take(ny), take(ny), take(len(c.curve.bends))) for c in self.compensations],
            inverses={self.actuated.index(own.input): _Inverted(k, *take(4)) for k, own in enumerate(self.inverses)},
        )  # fmt: skip

    def _split(self, state: Any) -> "_Memory":
        nu, ny = self.Kp.shape[1:]
        sizes = (nu, ny, ny, nu, 1, 1, *self._tail)
        z, f, d, u, cold, takes_over, s, m, rate, last, shown, side, teeth = (
            [state[i] for i in range(b - n, b)] for b, n in zip(np.cumsum(sizes), sizes, strict=True)
        )
        line = [last[i : i + self._kept] for i in range(0, len(last), max(1, self._kept))]
        return _Memory(z, f, d, u, cold[0], takes_over[0], s, m, rate, line, shown, side, teeth)


class Gains(NamedTuple):
    """The gains of a law at one schedule value, (nu, ny); u0 (nu,)."""

    Kp: np.ndarray
    Ki: np.ndarray
    Kd: np.ndarray
    Kr: np.ndarray
    Ka: np.ndarray
    Kaa: np.ndarray
    u0: np.ndarray


class _Numbers(NamedTuple):
    """The numbers of the law at one schedule value."""

    Kp: list[list]
    Ki: list[list]
    Kd: list[list]
    Kr: list[list]
    u0: list
    b: list
    c: list
    low: list
    high: list
    rate: list
    follow: list
    decay: Any
    fresh: Any
    slew: list
    reference_model: list[list]
    acceleration: list[list]
    Ka: list[list]
    Kaa: list[list]
    share: list
    play: list
    curves: dict[int, tuple[list, list]]
    compensations: list[tuple[list, list, list]]
    inverses: dict[int, "_Inverted"]

    def through(self, i: int, u: Any) -> Any:
        """What a dead zone leaves of a command."""
        return u - _near(0.0, self.inverses[i].half_width, u) if i in self.inverses else u

    def arrives(self, i: int, u: Any) -> Any:
        """v of a command behind a dead zone."""
        return bent(u, self.curves[i][0]) if i in self.curves else u

    def commanded(self, i: int, v: Any) -> Any:
        """The command of a v."""
        return bent(v, self.curves[i][1]) if i in self.curves else v


class _Inverted(NamedTuple):
    """The k-th inverse of a law, on numbers or symbols; see `controllers.cancelled`. rate: samples a second."""

    k: int
    half_width: Any
    play: Any
    keep: Any
    rate: Any

    def added(self, v: Any, side: Any, teeth: Any, takes_over: Any) -> tuple[Any, Any, Any]:
        """Side, where the teeth stand, and what is added to v: nothing for a play whose command somebody else gave."""
        side = _near(0.0, 1.0, side + 2.0 * (v > self.keep) - 2.0 * (v < -self.keep))
        teeth = teeth + takes_over * (0.5 * self.play * side - teeth)
        return side, teeth, self.half_width * side + (0.5 * self.play * side - teeth) * self.rate

    def after(self, teeth: Any, side: Any, u: Any) -> Any:
        """Where the teeth stand after a sample of u."""
        return _near(0.0, 0.5 * self.play, teeth + (u - self.half_width * side) / self.rate)


class _Memory(NamedTuple):
    """The law's memory; see `ScheduledPID.init`."""

    z: list
    f: list
    d: list
    u: list
    cold: Any
    takes_over: Any
    s: list
    m: list
    rate: list
    line: list[list]
    shown: list
    side: list
    teeth: list


class _Aim(NamedTuple):
    """What the set-points become, its rate and acceleration, and the set-points within their slew; what the loop awaits, for
    which m of the last samples are kept, and what a play shows.
    """

    m: list
    rate: list
    acceleration: list
    s: list
    awaited: list
    line: list[list]
    shown: list

    @property
    def memory(self) -> list:
        return [*self.s, *self.m, *self.rate, *(own for line in self.line for own in line), *self.shown] if self.s else []


def _near(last: Any, reach: Any, value: Any) -> Any:
    """The value, no further than `reach` from the last one."""
    return np.maximum(last - reach, np.minimum(last + reach, value))


def _between(newest: Any, k: int, share: Any) -> Any:
    """Of a signal, newest first, what it was k samples and a share of one more ago."""
    return newest[k] + share * (newest[k + 1] - newest[k]) if len(newest) > k + 1 else newest[k]


def let_through(
    curves: Sequence[Curve], channels: Sequence[str], low: np.ndarray, high: np.ndarray, rate: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Limits (n,) of v behind curves, of a rate what is left of it where the curve is flattest."""
    low, high, rate = (np.array(own, dtype=float) for own in (low, high, rate))
    for curve in curves:
        i = list(channels).index(curve.input)
        low[i], high[i], rate[i] = curve(low[i]), curve(high[i]), curve.slopes.min() * rate[i]
    return low, high, rate


def check_limits(law: str, channels: Sequence[str], lows: np.ndarray, highs: np.ndarray) -> None:
    """Refuse limits that leave a channel no room."""
    for name, low, high in zip(channels, lows, highs, strict=True):
        if not low < high:
            raise InputError(
                f"lower limit {low:g} is not below the upper {high:g}", file=law, channel=name, mend="exchange them?"
            )


def finite(values: np.ndarray) -> list[float | None]:
    """Limits for a file: null where there is none."""
    return [float(v) if np.isfinite(v) else None for v in values]


def _finite_ends(span: np.ndarray) -> list:
    """A span for a file, (2,) or (ns, 2)."""
    return finite(span) if span.ndim == 1 else [finite(own) for own in span]


def _ends(span: Any) -> np.ndarray:
    """A span from a file."""
    if np.ndim(span) == 2:
        return np.array([_ends(own) for own in span])
    return np.append(unlimited(span[:1], -np.inf), unlimited(span[1:], np.inf))


def unlimited(values: list[float | None], none: float) -> np.ndarray:
    """Limits from a file; none: what null stands for."""
    return np.array([none if v is None else v for v in values], dtype=float)


def parts(omega: np.ndarray, dt: float, Tf: float) -> np.ndarray:
    """1, dt / (z - 1), (z - 1) / ((Tf + dt) z - Tf) at z = exp(j omega dt): what Kp, Ki, Kd are multiplied with; (N, 3)."""
    z = np.exp(1j * np.asarray(omega) * dt)
    return np.stack([np.ones_like(z), dt / (z - 1.0), (z - 1.0) / ((Tf + dt) * z - Tf)], axis=-1)
