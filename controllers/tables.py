"""Controllers for other programs, as tables: the gains of a scheduled PID, and the matrices of an MPC over the schedule.

Between rows a program interpolates linearly, outside the table it holds the edge row. Of several schedule variables the rows are
a lattice, and it interpolates in each of them. Where that is not the law itself, the largest difference is stated. As source text
a law is written by `code`.
"""

import csv
from collections.abc import Callable, Sequence
from io import StringIO
from typing import Any

import numpy as np

from controllers.mpc import MPC, Extrapolated
from controllers.scheduled_pid import BackCalculation, ScheduledPID, finite
from workbench.basis import Basis, PiecewiseLinear, Powers, Products
from workbench.errors import InputError
from workbench.lpv import mesh, one_or_all
from workbench.physics.controller import schedules_of
from workbench.provenance import program

GAIN_TABLE, MATRICES = "gain-scheduling-workbench/gain-table", "gain-scheduling-workbench/mpc-matrices"
VERSION = 1
FINER = 32  # points between two rows at which interpolation is compared with what it stands for
POINTS = 21  # rows where no number of them makes linear interpolation exact
INTERPOLATION = "linear between rows, the edge row outside"
SEVERAL = "rows are a lattice: linear in each schedule variable between its values, the edge value outside"
PROGRAM = {
    "minimise": "1/2 (sum over i = 1..N-1 of |y_i - r_i - (yt - r_N)|_Q^2, + sum over i = 0..N-1 of |u_i - u_(i-1)|_S^2 + "
    "|u_i - ut|_R^2, + |(x_N - xt, u_(N-1) - ut)|_P^2) + violation (sqrt(q) s + 1/2 q s^2) over the outputs with limits",
    "weights": "Q, S, R: diagonal matrices of outputs, moves, inputs; q: the output's own weight in Q, 1 where that is 0",
    "limits": "low <= u_i <= high, |u_i - u_(i-1)| <= rate dt, y_low - s <= y_i <= y_high + s for i = 1..N, s >= 0; null: none",
    "model": "x_(i+1) = A_i x_i + B_i (u_i - u0_i + Bd d), y_i = C_i x_i + y0_i + Cd d; disturbances at the inputs: Bd = 1, "
    "Cd = 0, at the outputs: Bd = 0, Cd = 1; matrices at rho + i slope, P at rho + N slope",
    "slope": "slope+ = slope + (rho - rho- - slope) / memory every sample, from 0; memory null: slope = 0",
    "observer": "e = y - y_0 of the model; the program starts from (x, d) + L e; from there the model under u, and J e added, "
    "gives (x, d) of the next sample",
    "target": "steady state of the model at rho + N slope, low <= ut <= high, with the least |yt - r_N|_Q^2 + |ut - u_(-1)|_R^2; "
    "r_N kept within y_low and y_high",
}


def table_points(basis: Basis, span: np.ndarray) -> np.ndarray:
    """Schedule values from edge to edge of the span: with the knots between, where linear interpolation is exact, else a grid."""
    if isinstance(basis, PiecewiseLinear):
        return np.concatenate([span[:1], basis.knots[(basis.knots > span[0]) & (basis.knots < span[1])], span[1:]])
    straight = isinstance(basis, Powers) and np.isin(basis.exponents, (0.0, 1.0)).all()
    return np.linspace(span[0], span[1], 2 if straight else POINTS)


def gain_axes(law: ScheduledPID) -> list[np.ndarray]:
    """Values of each schedule variable whose lattice are the rows of a law's gain table; one value without schedule."""
    if law.schedule is None:
        return [np.zeros(1)]
    factors = law.basis.factors if isinstance(law.basis, Products) else (law.basis,)
    return [table_points(own, span) for own, span in zip(factors, np.reshape(law.span, (-1, 2)), strict=True)]


def gain_csv(law: ScheduledPID) -> str:
    """Kp, Ki, Kd, Kr, Ka and u0 over the schedule as CSV, a column a number; units where they are known."""
    schedules = schedules_of(law)
    header = [f"{name} [{law.unit(name)}]" for name in schedules]
    times = {"Ki": "/s", "Kd": " s", "Ka": " s", "Kaa": " s^2"}
    for name, time in ((name, times.get(name, "")) for name in law.gain_names):
        header += [f"{name}_{a}_{m} {law.gain_unit(a, m, time)}".rstrip() for a in law.actuated for m in law.measured]
    header += [f"u0_{a}" + f" [{law.unit(a)}]" * bool(law.unit(a)) for a in law.actuated]
    rows = [",".join(header)]
    for rho in mesh(gain_axes(law)):
        numbers = [np.ravel(K) for K in _gains(law, rho).values()]
        rows.append(",".join(repr(float(v)) for v in np.concatenate([np.atleast_1d(rho)[: len(schedules)], *numbers])))
    return "\n".join(rows) + "\n"


def curve_csv(law: ScheduledPID) -> str:
    """Nodes of the curves of actuators, v over u, as CSV."""
    rows = [f"{c.input},{float(u)!r},{float(v)!r}" for c in law.curves for u, v in zip(c.u, c.v, strict=True)]
    return "\n".join(["command,u,v", *rows]) + "\n"


def compensation_csv(law: ScheduledPID) -> str:
    """Nodes of what is added to commands over s = position m + motion m', m the set-points or their models, as CSV."""
    text = StringIO()
    rows = csv.writer(text, lineterminator="\n")
    weights = [f"{part}_{name}" for part in ("position", "motion") for name in law.measured]
    rows.writerow(["command", "effect", *weights, "s", "added"])
    for own in law.compensations:
        at = [own.input, own.effect, *own.position.tolist(), *own.motion.tolist()]
        rows.writerows([*at, float(s), float(added)] for s, added in zip(own.curve.u, own.curve.v, strict=True))
    return text.getvalue()


def awaited_csv(law: ScheduledPID) -> str:
    """What the loop awaits of every output as CSV: m a dead time ago, through a play."""
    rows = zip(law.measured, law.late.tolist(), law.play.tolist(), strict=True)
    return "\n".join(["output,late,play", *(f"{name},{late!r},{play!r}" for name, late, play in rows)]) + "\n"


def inverse_csv(law: ScheduledPID) -> str:
    """Inverses of dead zones and play of actuators as CSV."""
    rows = (f"{own.input},{own.effect},{own.half_width!r},{own.play!r},{own.keep!r}" for own in law.inverses)
    return "\n".join(["command,effect,half_width,play,keep", *rows]) + "\n"


def with_csv(law: ScheduledPID) -> dict[str, str]:
    """File name -> CSV: the gain table, and what else a law has, the nodes of curves and compensations among it."""
    found = {"gains.csv": gain_csv(law)}
    if law.curves:
        found["curves.csv"] = curve_csv(law)
    found |= {"compensations.csv": compensation_csv(law)} if law.compensations else {}
    found |= {"awaited.csv": awaited_csv(law)} if law.awaits else {}
    return found | ({"inverses.csv": inverse_csv(law)} if law.inverses else {})


def gain_table(law: ScheduledPID) -> dict[str, Any]:
    """All of a PID law but its memory, as plain numbers; gains (nu, ny) by row."""
    named = lambda names: [{"name": name, "unit": law.unit(name)} for name in names]  # noqa: E731
    axes, schedules = gain_axes(law), named(schedules_of(law))
    points = mesh(axes)
    rows = [_gains(law, rho) for rho in points]
    shaping = {"slew": finite(law.slew), "bandwidth": finite(law.bandwidth)} if law.shaped else {}
    back = isinstance(law.anti_windup, BackCalculation)
    return {
        "schema": GAIN_TABLE, "version": VERSION, "program": program(), "name": law.name,
        "law": law.sentence, "dt": law.dt,
        "actuated": named(law.actuated), "measured": named(law.measured), "references": named(law.references),
        "schedule": one_or_all(schedules),
        "b": law.b, "c": law.c, "Tf": law.Tf, "low": finite(law.low), "high": finite(law.high), "rate": finite(law.rate),
        **shaping, **({"compensations": [own.to_dict() for own in law.compensations]} if law.compensations else {}),
        **({"late": law.late, "play": law.play} if law.awaits else {}),
        **({"inverses": [vars(own) for own in law.inverses]} if law.inverses else {}),
        **({"curves": [curve.to_dict() for curve in law.curves]} if law.curves else {}),
        "anti_windup": {"kind": "back-calculation", "tracking": law.tracking} if back else {"kind": "clamping"},
        "interpolation": SEVERAL if len(schedules) > 1 else INTERPOLATION,
        "largest_difference": _differences(axes, rows, lambda rho: _gains(law, rho)),
        "rows": [({"rho": rho} if law.schedule else {}) | row for rho, row in zip(points, rows, strict=True)],
    }  # fmt: skip


def _gains(law: ScheduledPID, rho: Any) -> dict[str, np.ndarray]:
    """The gains at a schedule value by name, and u0."""
    return {key: getattr(law.gains_at(rho), key) for key in (*law.gain_names, "u0")}


def mpc_matrices(law: MPC) -> dict[str, Any]:
    """What a program with a solver of its own needs to compute the commands of an MPC: frozen matrices over the schedule.

    A, B, C (model), u0, y0 (operating point), L, J (observer) and P (terminal cost) by row; see PROGRAM. Refuses a tube.
    """
    if law.tube is not None:
        raise InputError(
            "its limits are tightened by a tube, which these equations do not know", file=law.name,
            mend="export --fallback, or design it without --tube",
        )  # fmt: skip
    model, named = law.model, lambda channels: [{"name": c.name, "unit": c.unit} for c in channels]
    axes, schedules = _matrix_axes(law), named(model.schedules)
    points = mesh(axes)
    rows = [_matrices(law, rho) for rho in points]
    nx, nu, ny, nd = model.order, len(model.inputs), len(model.outputs), law.observer.L.shape[1] - model.order
    shapes = {"A": (nx, nx), "B": (nx, nu), "C": (ny, nx), "u0": (nu,), "y0": (ny,), "L": (nx + nd, ny), "J": (nx + nd, ny),
              "P": (nx + nu, nx + nu)}  # fmt: skip
    return {
        "schema": MATRICES, "version": VERSION, "program": program(), "name": law.name, "equations": PROGRAM, "dt": law.dt,
        "horizon": law.horizon, "inputs": named(model.inputs), "outputs": named(model.outputs),
        "schedule": one_or_all(schedules),
        "disturbances": "inputs" if law.observer.at_inputs else "outputs", "weights": vars(law.weights),
        "low": finite(law.low), "high": finite(law.high), "rate": finite(law.rate), "y_low": finite(law.y_low),
        "y_high": finite(law.y_high), "memory": law.prediction.memory if isinstance(law.prediction, Extrapolated) else None,
        "shapes": shapes, "interpolation": SEVERAL if len(schedules) > 1 else INTERPOLATION,
        "largest_difference": _differences(axes, rows, lambda rho: _matrices(law, rho)),
        "rows": [({"rho": rho} if schedules else {}) | row for rho, row in zip(points, rows, strict=True)],
    }  # fmt: skip


def _matrix_axes(law: MPC) -> list[np.ndarray]:
    """Values of each schedule variable of an MPC's rows: those of its observer and its terminal cost, and what the model needs
    between.
    """
    model, found = law.model, []
    bases = [own.factors if isinstance(own, Products) else (own,) for own in (model.basis, model.operating_point.basis)]
    for i, span in enumerate(model.spans):
        own = [grid.reshape(len(grid), -1)[:, i] for grid in (law.observer.rho, law.terminal[0])]
        points = np.unique(np.concatenate([*own, *(table_points(factors[i], span) for factors in bases)]))
        found.append(points[np.diff(points, prepend=-np.inf) > 1e-9 * np.ptp(span)])  # two grids meet but for rounding
    return found or [np.zeros(1)]


def _matrices(law: MPC, rho: Any) -> dict[str, np.ndarray]:
    A, B, C, _ = law.model.freeze(rho)
    (u0,), (y0,) = law.operating(np.array([rho]))
    L, J = law.observer.gains(rho)
    return {"A": A, "B": B, "C": C, "u0": u0, "y0": y0, "L": L, "J": J, "P": law.terminal_cost(rho)}


def _differences(
    axes: Sequence[np.ndarray], rows: Sequence[dict[str, np.ndarray]], exact: Callable[[Any], dict[str, np.ndarray]]
) -> dict[str, float]:
    """Largest |interpolated - exact| of every quantity between the rows."""
    stacked = {key: np.array([row[key] for row in rows]) for key in rows[0]}
    found = dict.fromkeys(stacked, 0.0)
    finer = FINER if len(axes) == 1 else FINER // 8
    between = [np.interp(np.arange(finer * (len(own) - 1) + 1) / finer, np.arange(len(own)), own) for own in axes]
    hats = [PiecewiseLinear(own) for own in axes]
    basis = hats[0] if len(hats) == 1 else Products(tuple(hats))
    for rho in mesh(between) if len(rows) > 1 else ():
        weights = basis(rho)
        for key, value in exact(rho).items():
            found[key] = max(found[key], float(np.abs(np.tensordot(weights, stacked[key], 1) - value).max()))
    return found
