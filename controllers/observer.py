"""Kalman filter of an identified LPV model with disturbance states, so that a control on it leaves no offset.

    x+ = A(rho) x + B(rho) (u - u0 + Bd d) + K(rho) e,     y = C(rho) x + y0 + Cd d + e,     cov e = R
    d+ = d + w,     cov w = drift^2 cov of d as the noise e alone would let one see it

e is the identified innovation: process and measurement noise are one, which the filter's cross term says. Disturbances act at
the inputs (Bd = 1, Cd = 0) or at the outputs (Bd = 0, Cd = 1), as many as there are outputs: then what is predicted in the
steady state is what is measured. The stationary gains of the frozen model are found at `points` schedule values, of several
schedule variables at a lattice of them, and interpolated.

Source: Pannocchia and Rawlings, "Disturbance models for offset-free model-predictive control", AIChE Journal 49 (2003) 426-437.
"""

from typing import Any

import numpy as np
from scipy.linalg import LinAlgError, solve_discrete_are

from workbench.errors import InputError
from workbench.lpv import LPVModel, check_no_feedthrough, check_schedule_from_outside, lattice
from workbench.records import field, record


@record
class Observer:
    """Gains over the schedule: e = y - C z - y0 corrects z = (x, d) by L e, and moves it by J e on its way to the next sample.

    rho (g,), of several schedule variables (g, ns): where the gains were found; L, J (g, nx + nd, ny).
    """

    model: LPVModel
    at_inputs: bool
    rho: np.ndarray = field("g ...")
    L: np.ndarray = field("g nz ny")
    J: np.ndarray = field("g nz ny")

    def __post_init__(self):
        if not isinstance(self.at_inputs, bool):
            raise InputError(f"at_inputs {self.at_inputs!r}", file=self.model.name, mend="true or false")

    def gains(self, rho: Any) -> tuple[np.ndarray, np.ndarray]:
        """L and J at a schedule value, interpolated; the edge value outside."""
        return interpolated(self.rho, self.L, rho), interpolated(self.rho, self.J, rho)


def interpolated(grid: np.ndarray, values: np.ndarray, at: Any) -> np.ndarray:
    """Values (g, ...) on a grid (g,), linearly between its points; the edge value outside.

    On a lattice (g, ns), the last variable fastest, linearly in each variable.

        >>> lattice = np.array([[0.0, 0.0], [0.0, 1.0], [2.0, 0.0], [2.0, 1.0]])
        >>> float(interpolated(lattice, np.array([0.0, 1.0, 4.0, 5.0]), (1.0, 0.5)))
        2.5
    """
    if len(grid) == 1:
        return values[0]
    if grid.ndim > 1:
        axes = [np.unique(own) for own in grid.T]
        values = values.reshape(*map(len, axes), *values.shape[1:])
        for own, value in zip(axes, at, strict=True):
            values = interpolated(own, values, value)
        return values
    i = int(np.clip(np.searchsorted(grid, at) - 1, 0, len(grid) - 2))
    t = min(max((at - grid[i]) / (grid[i + 1] - grid[i]), 0.0), 1.0)
    return values[i] + t * (values[i + 1] - values[i])


def augmented(A: np.ndarray, B: np.ndarray, C: np.ndarray, at_inputs: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A, B, C of z = (x, d): disturbances at the inputs or at the outputs that stand still."""
    nx, ny = len(A), len(C)
    nd = B.shape[1] if at_inputs else ny
    Bd, Cd = (B, np.zeros((ny, nd))) if at_inputs else (np.zeros((nx, nd)), np.eye(ny))
    Az = np.block([[A, Bd], [np.zeros((nd, nx)), np.eye(nd)]])
    return Az, np.vstack([B, np.zeros((nd, B.shape[1]))]), np.hstack([C, Cd])


def design_observer(model: LPVModel, *, at_inputs: bool | None = None, drift: float = 0.1, points: int = 11) -> Observer:
    """The stationary Kalman filter over the schedule; see the module.

    at_inputs None: at the inputs where there are as many as outputs, else at the outputs. drift: standard deviation of the
    disturbances' steps, in what the innovation's standard deviation amounts to there.
    Raises InputError where the model has no predictor, feeds inputs through, or a disturbance cannot be seen.
    """
    if model.predictor is None or model.noise is None:
        raise InputError("no predictor and no noise in this model", file=model.name, mend="identify it from records")
    check_no_feedthrough(model)
    check_schedule_from_outside(model, "an observer")
    if not drift > 0.0:
        raise InputError(f"drift {drift:g}", mend="a disturbance that never moves is never found: give a number above 0")
    ny, nu = len(model.outputs), len(model.inputs)
    where = nu == ny if at_inputs is None else at_inputs
    if where and nu != ny:
        raise InputError(f"{nu} disturbances at the inputs for {ny} outputs", file=model.name, mend="put them at the outputs")
    grid = lattice(model.spans, points)
    gains = [_gain(model, rho, where, drift) for rho in grid]
    L, J = (np.array(each) for each in zip(*gains, strict=True))
    return Observer(model, where, grid, L, J)


def _gain(model: LPVModel, rho: Any, at_inputs: bool, drift: float) -> tuple[np.ndarray, np.ndarray]:
    A, B, C, _ = model.freeze(rho if model.schedules else None)
    K = np.tensordot(model.weights(np.array([rho]))[0], model.predictor.K, 1)  # type: ignore[union-attr]
    Az, _, Cz = augmented(A, B, C, at_inputs)
    nx, R = len(A), np.asarray(model.noise)
    nd = len(Az) - nx
    place = f" at {model.named(rho)}" if model.schedules else ""
    steady = np.block([[A - np.eye(nx), Az[:nx, nx:]], [C, Cz[:, nx:]]])
    if np.linalg.matrix_rank(steady) < nx + nd:
        raise InputError(
            f"a disturbance{place} leaves no trace in the steady outputs", file=model.name, mend="put disturbances at the outputs"
        )
    seen = R
    if at_inputs:  # what an input has to do to move the outputs as the innovation does
        inverse = np.linalg.inv(C @ np.linalg.solve(np.eye(nx) - A, B))
        seen = inverse @ R @ inverse.T
    Q, S = np.zeros((nx + nd, nx + nd)), np.vstack([K @ R, np.zeros((nd, len(R)))])
    Q[:nx, :nx], Q[nx:, nx:] = K @ R @ K.T, drift**2 * seen
    try:
        P = solve_discrete_are(Az.T, Cz.T, Q, R, s=S)
    except (LinAlgError, ValueError):
        raise InputError(f"no stationary filter{place}", file=model.name, mend="identify a model of lower order") from None
    innovation = np.linalg.inv(Cz @ P @ Cz.T + R)
    return P @ Cz.T @ innovation, S @ innovation
