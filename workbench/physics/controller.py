"""What a simulation needs to know of a controller: one law in plain arithmetic, with explicit memory."""

from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

import casadi as ca
import numpy as np

from workbench.errors import InputError
from workbench.physics.symbolic import symbolic_numpy
from workbench.records import field, record


class Loop(Protocol):
    """What is common to all sampled controllers with zero-order hold: what they read and what they command."""

    @property
    def name(self) -> str: ...
    @property
    def dt(self) -> float: ...
    @property
    def references(self) -> tuple[str, ...]:
        """Names of the set-points r."""
        ...

    @property
    def measured(self) -> tuple[str, ...]:
        """Names of the measured outputs y."""
        ...

    @property
    def schedule(self) -> str | tuple[str, ...] | None:
        """Name of the measured output that is rho, if the law is scheduled; of several rho has an entry each."""
        ...

    @property
    def actuated(self) -> tuple[str, ...]:
        """Names of the inputs u."""
        ...


@runtime_checkable
class Controller(Loop, Protocol):
    """A law that is an equation: (state, r, y, rho) -> (u, state) every dt seconds.

    `law` is one plain function of arithmetic and numpy ufuncs without a branch on its arguments, so that the stepper can
    compile it; `gains` holds every number in it, so that other gains need no other kernel.

        >>> u, state = law.law(law.gains, law.init(), np.array([20.0]), np.array([0.0]), 5.0)  # r, y, rho
        >>> len(u), len(state)
        (1, 9)
    """

    @property
    def gains(self) -> np.ndarray: ...
    def init(self, u: np.ndarray | None = None) -> np.ndarray:
        """The memory before the first sample; given u, that with which the first command is u, where the law can."""
        ...

    def law(self, gains: Any, state: Any, r: Any, y: Any, rho: Any) -> tuple[list, list]:
        """The law on numbers, arrays or symbols."""
        ...


class Stepped(Loop, Protocol):
    """(memory, r, y, rho) -> (u, memory) every dt seconds: a law that is computed step by step in Python, as an optimisation is.

    Its memory is whatever it needs; u (nu,), r, y (ny,), rho a number, (ns,) of several, or None without a schedule.

    >>> u, memory = mpc.step(mpc.init(), np.array([20.0]), np.array([0.0]), 5.0)  # r, y, rho
    >>> u.round(1)
    array([12.])
    """

    def init(self, u: np.ndarray | None = None) -> Any:
        """The memory before the first sample; u: the inputs it takes over from."""
        ...

    def step(self, state: Any, r: np.ndarray, y: np.ndarray, rho: Any) -> tuple[np.ndarray, Any]:
        """One sample: commands (nu,), never NaN, and the next memory."""
        ...


def schedules_of(controller: Loop) -> tuple[str, ...]:
    """Names of the schedule variables of a law, none without a schedule."""
    own = controller.schedule
    return () if own is None else (own,) if isinstance(own, str) else tuple(own)


def rho_of(controller: Loop, values: Any) -> Any:
    """rho as a law takes it, from the value of each of its schedule variables: None without one, the value itself of one."""
    return None if controller.schedule is None else values[0] if isinstance(controller.schedule, str) else values


def stepped(controller: Any, state: Any, r: np.ndarray, y: np.ndarray, rho: Any) -> tuple[np.ndarray, Any]:
    """One sample of a law of either kind: commands (nu,) and the next memory."""
    if hasattr(controller, "step"):
        return controller.step(state, r, y, rho)
    u, after = controller.law(controller.gains, state, r, y, rho)
    return np.array(u, dtype=float), np.array(after, dtype=float)


SCHEMA, VERSION = "gain-scheduling-workbench/controller", 1  # of a controller's file


def content_of(controller: Any, own: str = "") -> dict[str, Any]:
    """What a controller's file holds. own: where a law of the user's own is found, which no file holds: file.py:NAME."""
    if own or not hasattr(controller, "to_dict"):
        return {"own": own or f"{type(controller).__module__}:{type(controller).__qualname__}"}
    return {"schema": SCHEMA, "version": VERSION} | controller.to_dict()


def law_of(content: Mapping[str, Any], controller: Any) -> Any:
    """The law that such content makes, of the kind of `controller`; itself where no file can hold it."""
    return controller if "own" in content else type(controller).from_dict(dict(content))


LOOP = ("name", "dt", "references", "measured", "schedule", "actuated", "init")
SAMPLES = 20  # at which law and step are compared
EQUATION = "law(gains, state, r, y, rho) -> (list of commands, list of the next memory)"


def check_controller(controller: Any, file: object) -> None:
    """Refuse what is neither a Controller nor a Stepped: which member is missing or makes no sense, and the mend (InputError)."""
    if isinstance(controller, type):
        raise InputError("is a class, not a controller", file=file, mend=f"make one: NAME = {controller.__name__}(...)")
    missing = [name for name in LOOP if not hasattr(controller, name)]
    if not hasattr(controller, "law") and not hasattr(controller, "step"):
        missing.append("law and gains (an equation), or step (asked sample by sample)")
    elif not hasattr(controller, "step") and not hasattr(controller, "gains"):
        missing.append("gains")
    if missing:
        raise InputError(f"no controller: it has no {', no '.join(missing)}", file=file, mend="see docs/add-a-controller.md")
    if not (isinstance(controller.dt, int | float) and 0.0 < controller.dt < np.inf):
        raise InputError(f"dt = {controller.dt!r}", file=file, mend="expected seconds from one command to the next")
    for name in ("references", "measured", "actuated"):
        value = getattr(controller, name)
        if not isinstance(value, tuple | list) or not all(isinstance(own, str) for own in value):
            raise InputError(f"{name} = {value!r}", file=file, mend=f"expected a tuple of names: {name} = ('v',)")
        if len({*value}) < len(value):
            raise InputError(f"{name} = {value!r}", file=file, mend="name each channel once")
    _check_schedule(controller.schedule, file)
    if not controller.actuated or len(controller.references) > len(controller.measured):
        said = (
            f"{len(controller.references)} set-points, {len(controller.measured)} measured, {len(controller.actuated)} actuated"
        )
        raise InputError(said, file=file, mend="name an input at least; set-points belong to the first of measured, one by one")
    if isinstance(controller, Controller):
        _check_law(controller, file)
        if hasattr(controller, "step"):
            _check_same(controller, file)
    else:
        _check_memory(controller, file)


def _check_schedule(schedule: Any, file: object) -> None:
    names = schedule if isinstance(schedule, tuple | list) else [] if schedule is None else [schedule]
    if not all(isinstance(own, str) for own in names) or len({*names}) < len(names) or schedule in ((), []):
        mend = "expected None, a name: schedule = 'v', or several: schedule = ('v', 'load')"
        raise InputError(f"schedule = {schedule!r}", file=file, mend=mend)


def _check_memory(controller: Any, file: object) -> None:
    """Refuse a law that keeps something from run to run: after `init` the same samples must give the same commands."""
    nr, ny = len(controller.references), len(controller.measured)
    rho = rho_of(controller, np.ones(len(schedules_of(controller))))

    def run() -> np.ndarray:
        state, said = controller.init(), []
        for k in range(3):
            u, state = controller.step(state, np.full(nr, 0.3), np.full(ny, 0.1 * k), rho)
            said.append(np.array(u, dtype=float))
        return np.array(said)

    try:
        first, again = run(), run()
    except (TypeError, AttributeError) as reason:
        mend = "expected init() -> memory and step(memory, r, y, rho) -> (commands, next memory)"
        raise InputError(f"its step: {type(reason).__name__}: {reason}", file=file, mend=mend) from reason
    except Exception:
        return  # these numbers need not make sense to it
    if not np.array_equal(first, again, equal_nan=True):
        said = "its step keeps something in itself or changes its memory in place: a second run would begin otherwise"
        raise InputError(said, file=file, mend="give everything that it remembers back as the next memory, a new one each time")


def _check_same(controller: Any, file: object) -> None:
    """Refuse a step that is not the law: a simulation compiles the law, and firmware may be made from the step."""
    nr, ny, random = len(controller.references), len(controller.measured), np.random.default_rng(0)
    asked = controller.init()
    for _ in range(SAMPLES):
        r, y = random.normal(size=nr), random.normal(size=ny)
        rho = rho_of(controller, random.normal(size=len(schedules_of(controller))))
        try:
            with np.errstate(all="ignore"):
                u, after = (np.asarray(own, dtype=float) for own in controller.law(controller.gains, asked, r, y, rho))
                other, state = (np.asarray(own, dtype=float) for own in controller.step(asked, r, y, rho))
        except Exception as reason:
            mend = "expected step(memory, r, y, rho) -> (commands, next memory), or law alone: it is asked step by step too"
            raise InputError(f"its step: {type(reason).__name__}: {reason}", file=file, mend=mend) from reason
        if not np.isfinite([*u, *after]).all():
            return  # these numbers need not make sense to it
        if not (_close(u, other) and _close(after, state)):
            said = f"has law and step, which command {u.tolist()} and {other.tolist()} of the same samples"
            raise InputError(said, file=file, mend="leave step out: the law is asked step by step too")
        asked = after


def _close(a: np.ndarray, b: np.ndarray) -> bool:
    return a.shape == b.shape and bool(np.allclose(a, b, rtol=1e-9, atol=1e-12))


def _check_law(controller: Controller, file: object) -> None:
    """Call the law with three values of everything but the gains: it also fails where it has an `if` or calls math."""
    try:
        hash(controller)
    except TypeError:
        raise InputError("cannot be hashed", file=file, mend="write @dataclass(frozen=True, eq=False), or a class") from None
    nu, some = len(controller.actuated), np.array([-1.0, 0.25, 3.0])
    asked = f"expected {EQUATION}, each single values, in arithmetic and numpy functions without an `if`"
    try:
        cold, taken = np.asarray(controller.init(), dtype=float), np.asarray(controller.init(np.zeros(nu)), dtype=float)
        gains = np.asarray(controller.gains, dtype=float)
        state = [np.full(3, value) for value in cold.ravel()]
        r, y = ([some * (1.0 + 0.1 * i) for i in range(len(names))] for names in (controller.references, controller.measured))
        with np.errstate(all="ignore"):
            u, after = controller.law(gains, state, r, y, rho_of(controller, [some] * len(schedules_of(controller))))
        for value in (*u, *after):
            np.broadcast_to(np.asarray(value, dtype=float), 3)
        with symbolic_numpy():  # what is compiled is the law of symbols
            names = (gains, cold, controller.references, controller.measured)
            g, z, r, y, rho = ([ca.SX.sym("argument") for _ in own] for own in (*names, schedules_of(controller)))
            said = controller.law(g, z, r, y, rho_of(controller, rho))
            for value in (*said[0], *said[1]):
                ca.SX(value)
    except Exception as reason:
        raise InputError(f"its law: {type(reason).__name__}: {reason}", file=file, mend=asked) from reason
    if gains.ndim != 1 or cold.ndim != 1 or cold.shape != taken.shape:
        said = f"gains {gains.shape}, init() {cold.shape}, init(u) {taken.shape}"
        raise InputError(said, file=file, mend="expected vectors of numbers, and a memory of one length")
    if len(u) != nu or len(after) != len(cold):
        said = f"its law gives {len(u)} commands and a memory of {len(after)}"
        raise InputError(said, file=file, mend=f"expected {nu} for actuated and {len(cold)} as in init()")


@record
class Playback:
    """u = r: the inputs follow given sequences, whatever is measured. An experiment in open loop.

    >>> run = simulate(MOTOR, Playback(("U",), dt=0.01), Scenario("step", {"U": np.full(200, 5.0)}, seed=1))
    >>> f"{run.experiment['n'][-1]:.1f} rad/s"
    '36.6 rad/s'
    """

    actuated: tuple[str, ...]
    dt: float = field("", unit="s", low=1e-9)
    name: str = "playback"
    measured: tuple[str, ...] = ()
    schedule: str | None = None

    @property
    def references(self) -> tuple[str, ...]:
        return self.actuated

    @property
    def gains(self) -> np.ndarray:
        return np.empty(0)

    def init(self, u: np.ndarray | None = None) -> np.ndarray:
        """No memory."""
        del u
        return np.empty(0)

    def law(self, gains: Any, state: Any, r: Any, y: Any, rho: Any = None) -> tuple[list, list]:
        """The reference itself."""
        del gains, state, y, rho
        return list(r), []
