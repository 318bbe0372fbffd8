"""PID laws with fixed gains: the parallel form, the standard form, and decoupled PI loops around an operating point.

    parallel:  u = u0 + Kr r + Kp e + Ki int e dt + Kd de/dt
    standard:  u = u0 + Kr r + K (e + 1/Ti int e dt + Td de/dt),  Tf = Td / N

The law itself, with weights, filter, limits and anti-windup, is that of `scheduled_pid` with one constant term.
"""

from collections.abc import Sequence

import numpy as np

from controllers.scheduled_pid import AntiWindup, BackCalculation, ScheduledPID


def pid(
    actuated: Sequence[str],
    measured: Sequence[str],
    references: Sequence[str],
    dt: float,
    Kp: np.ndarray,
    Ki: np.ndarray,
    Kd: np.ndarray | None = None,
    *,
    Kr: np.ndarray | None = None,
    Tf: float = 0.0,
    u0: np.ndarray | None = None,
    b: np.ndarray | None = None,
    c: np.ndarray | None = None,
    low: np.ndarray | None = None,
    high: np.ndarray | None = None,
    rate: np.ndarray | None = None,
    anti_windup: AntiWindup | None = None,
    name: str = "pid",
    units: dict[str, str] | None = None,
) -> ScheduledPID:
    """The parallel form with gains (nu, ny), or (n,) for n loops of one input and one output each.

    Set-point weights: b = 1 and c = 0 (no derivative of the set-point) unless given; no limits, u0 = 0 and
    no feedforward Kr unless given.
    """
    Kd, Kr = (np.zeros(np.shape(Kp)) if K is None else K for K in (Kd, Kr))
    matrices = [np.atleast_2d(np.diag(K) if np.ndim(K) == 1 else K) for K in (Kp, Ki, Kd, Kr)]
    nu, ny = matrices[0].shape

    def each(given: np.ndarray | None, n: int, default: float) -> np.ndarray:
        return np.broadcast_to(np.asarray(default if given is None else given, dtype=float), n)

    Kp, Ki, Kd, Kr = (K[None] for K in matrices)
    return ScheduledPID(
        tuple(actuated), tuple(measured), tuple(references), dt, Kp, Ki, Kd, Kr, each(u0, nu, 0.0)[None],
        each(b, ny, 1.0), each(c, ny, 0.0), each(low, nu, -np.inf), each(high, nu, np.inf), each(rate, nu, np.inf), Tf,
        anti_windup or BackCalculation(), name=name, units=units or {},
    )  # fmt: skip


def standard_form(K: np.ndarray, Ti: np.ndarray, Td: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Kp, Ki, Kd of the parallel form from the standard form's gain, integral time and derivative time, each (n,) or a number."""
    K = np.asarray(K, dtype=float)
    return K, K / np.asarray(Ti, dtype=float), K * np.asarray(Td, dtype=float)
