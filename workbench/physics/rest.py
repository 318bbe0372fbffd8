"""Where a plant's runs start: fixed values, and states and inputs solved so that rates of change are zero."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from workbench.errors import InputError, check_known
from workbench.records import field, record

if TYPE_CHECKING:
    from workbench.physics.plant import Plant

SIZES = tuple(sign * size for sign in (1.0, -1.0) for size in (1.0, 0.1, 10.0, 0.01, 100.0, 1e-3, 1e3))  # see Start
SHRUNK = (0.1, 0.01, 1e-3, 1e-4, 1e-5, 1e-6)  # of a guess, at the last


@record
class Start:
    """Where a run starts: `fixed` state values (numbers or parameter names), the rest solved so that `zero` stand still.

    Unknowns `solve_for` (states or inputs) are found from derivative = 0 of as many states in `zero`; whatever is named
    nowhere starts at 0. Newton's method begins at `guess`, by default 0. Where it fails there (a tank's outflow has no slope at
    level 0, a thrust of u^2 none at u = 0), unknowns without a guess within the limits begin at 1, 0.1, 10, 0.01, 100, 0.001 and
    1000, then at their negatives, and guesses are stretched by as much, in the end shrunk to a tenth and by tens down to a
    millionth (a root that is guarded against negative levels has no slope there, where steps from too high a level end). The
    first that ends at rest within the plant's limits is taken. So of two answers +u and -u the positive one is; `guess` asks for
    the other.

        >>> state, command = MOTOR.equilibrium(w=40.0, way=5.0)
        >>> command.round(2)  # U [V] that holds 40 rad/s
        array([6.])
    """

    fixed: Mapping[str, float | str] = field(default_factory=dict)
    solve_for: tuple[str, ...] = ()
    zero: tuple[str, ...] = ()
    guess: Mapping[str, float] = field(default_factory=dict)


def equilibria(plant: "Plant", p: np.ndarray, fixed: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """Equilibria x0 (R, nx), u0 (R, nu) for p (R, np), see `Plant.equilibria`; fixed: what replaces values of the start."""
    if len(p) > 1:  # in a sweep over seeds or effects few differ
        rows, which = np.unique(p, axis=0, return_inverse=True)
        if len(rows) < len(p):
            x, u = equilibria(plant, rows, fixed)
            return x[which.ravel()], u[which.ravel()]
    names = (*plant.state_names, *plant.input_names)
    z = np.zeros((len(p), len(names)))
    for name, value in (dict(plant.start.guess) | dict(plant.start.fixed) | dict(fixed)).items():
        check_known("state or input", name, names, file=plant.name)
        own = [q.name for q in plant.parameters]
        column = p[:, own.index(check_known("parameter", value, own, file=plant.name))] if isinstance(value, str) else value
        z[:, names.index(name)] = column
    unknown = [names.index(name) for name in plant.start.solve_for]
    if unknown:
        guess = z[:, unknown]
        z = _still(plant, z, p)
        low, high = np.array([plant.limits.get(name, (-np.inf, np.inf)) for name in plant.start.solve_for]).T
        inside = ((z[:, unknown] >= low) & (z[:, unknown] <= high)).all(axis=1)  # false of what is no number
        for i in np.flatnonzero(~inside):
            z[i] = _searched(plant, z[i], guess[i], p[i], low, high)
    for name in set(fixed) & set(plant.start.solve_for):
        z[:, names.index(name)] = fixed[name]
    return z[:, : len(plant.states)], z[:, len(plant.states) :]


def _still(plant: "Plant", z: np.ndarray, p: np.ndarray) -> np.ndarray:
    """z (R, nx + nu) with the unknowns of `start` where Newton's method from there ends, NaN where it does not converge."""
    unknown = [(*plant.state_names, *plant.input_names).index(name) for name in plant.start.solve_for]
    z, moving = z.copy(), np.ones(len(z), dtype=bool)
    with np.errstate(invalid="ignore", over="ignore"):
        for _ in range(50):
            rates, J = _rates_at(plant, z, p)
            step = np.where((rates == 0.0).all(axis=1, keepdims=True), 0.0, _solved(J, rates))  # u^2 at rest has no slope
            z[:, unknown] -= np.where(moving[:, None], step, 0.0)
            moving &= ~(np.max(np.abs(step) / (1.0 + np.abs(z[:, unknown])), axis=1) < 1e-13)
            if not moving.any():
                break
    z[np.flatnonzero(moving)[:, None], unknown] = np.nan
    return z


def _searched(plant: "Plant", z: np.ndarray, guess: np.ndarray, p: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """A point z (nx + nu) at rest within the limits, sought from the guess and around it: see `Start`.

    Damped least squares passes the places where a root has no slope or a square none, Newton's method ends it.
    """
    from scipy.optimize import least_squares

    unknown = [(*plant.state_names, *plant.input_names).index(name) for name in plant.start.solve_for]
    outside, trial = z, z.copy()

    slopes: Any = lambda values: at(values)[1]  # noqa: E731  (its declared type knows words only)

    def at(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        trial[unknown] = values
        rates, J = _rates_at(plant, trial[None], p[None])
        return rates[0], J[0]

    nearest, away, moves = guess, np.inf, np.zeros((len(plant.start.zero), len(unknown)), dtype=bool)
    none = (guess == 0.0) | (guess < low) | (guess > high)
    for size, factor in (*((size, 1.0 + size) for size in (0.0, *SIZES)), *zip(SHRUNK, SHRUNK, strict=True)):
        first = np.clip(np.where(none, size, guess * factor), low, high)
        rates, J = at(first)
        moves |= J != 0.0
        if not (np.isfinite(rates).all() and np.isfinite(J).all()):
            continue
        bounds = low - 1e-9 * np.abs(low) - 1e-300, high + 1e-9 * np.abs(high) + 1e-300  # a guess may lie at a limit
        try:
            with np.errstate(all="ignore"):
                found = least_squares(lambda v: at(v)[0], first, slopes, bounds, x_scale="jac").x
        except (ValueError, np.linalg.LinAlgError):  # a slope that is no number on the way
            continue
        trial[unknown] = found
        rest = _still(plant, trial[None], p[None])[0]
        if ((rest[unknown] >= low) & (rest[unknown] <= high)).all():
            return rest
        left = float(np.max(np.abs(at(found)[0])))
        if left < away:
            nearest, away = found, left
    if np.isfinite(outside).all():
        return outside
    raise _no_start(plant, nearest, away, moves)


def _rates_at(plant: "Plant", z: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rates (R, n) of the states in `start.zero` at z (R, nx + nu), and their slopes (R, n, n) over the unknowns."""
    names = (*plant.state_names, *plant.input_names)
    unknown = [names.index(name) for name in plant.start.solve_for]
    zero = [plant.state_names.index(name) for name in plant.start.zero]
    nx, eta = len(plant.states), np.repeat(plant.neutral[None], len(p), axis=0)
    rates = plant.evaluated(plant.traced, z[:, :nx], z[:, nx:], p, eta)[0][:, 0, zero]
    A, B, _C = plant.jacobians_of(z[:, :nx], z[:, nx:], p, eta)
    return rates, np.concatenate([A, B], axis=2)[:, zero][:, :, unknown]


def _no_start(plant: "Plant", nearest: np.ndarray, away: float, moves: np.ndarray) -> InputError:
    """Where the search for a start came nearest, or what keeps it from one answer; moves: which unknown acts on what."""
    start = plant.start
    counted = f"{several(start.solve_for, 'unknown')} from {several(start.zero, 'rate')} that shall be 0"
    idle = [name for j, name in enumerate(start.solve_for) if not moves[:, j].any()]
    held = [name for i, name in enumerate(start.zero) if not moves[i].any()]
    if idle or held:
        fault = f"{', '.join(idle)} acts on none of these rates" if idle else f"none acts on the rate of {', '.join(held)}"
        mend = f"fix {', '.join(idle) or 'other values'} and solve for what moves {', '.join(held or start.zero)}"
        return InputError(f"no start: {counted}; {fault}", file=plant.name, mend=mend)
    came = ", ".join(f"{name} = {value:.4g}" for name, value in zip(start.solve_for, nearest, strict=True))
    far = (
        f"came no nearer than {came}, where a rate of {away:.3g} is left"
        if np.isfinite(away)
        else "found no place with finite rates"
    )
    return InputError(
        f"no start found: {counted}; {1 + len(SIZES) + len(SHRUNK)} tries from the guess {far}",
        file=plant.name,
        mend="are parameters and fixed values possible together? otherwise give Start(guess={...}) near where it stands",
    )


def _solved(J: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """J^-1 rates (R, n), NaN where J (R, n, n) is singular or not finite: an endless slope makes a step of 0 of any rate."""
    rates = np.where(np.asarray(np.isfinite(J).all(axis=(1, 2)))[:, None], rates, np.nan)
    try:
        return np.linalg.solve(J, rates[:, :, None])[:, :, 0]
    except np.linalg.LinAlgError:
        if len(J) == 1:
            return np.full_like(rates, np.nan)
        return np.concatenate([_solved(J[i : i + 1], rates[i : i + 1]) for i in range(len(J))])


def several(names: Sequence[str], noun: str) -> str:
    """How many there are, and their names: 2 rates (h1, h2)."""
    return f"{len(names)} {noun}{'s' * (len(names) != 1)} ({', '.join(names)})"
