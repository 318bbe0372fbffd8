"""Classic PI and PID rules for one loop, from a first-order model with dead time: starting points, each with its validity.

    P(s) = K exp(-L s) / (T s + 1),    tau = L / (L + T)

    lambda  [1]   Kp = T / (K (lambda + L)),  Ti = T
    SIMC    [2]   Kp = T / (K (tc + L)),      Ti = min(T, 4 (tc + L))
    AMIGO   [3]   PI   Kp = 0.15 / K + (0.35 - L T / (L + T)^2) T / (K L),  Ti = 0.35 L + 13 L T^2 / (T^2 + 12 L T + 7 L^2)
                  PID  Kp = (0.2 + 0.45 T / L) / K,  Ti = L (0.4 L + 0.8 T) / (L + 0.1 T),  Td = 0.5 L T / (0.3 L + T)

[1] Dahlin, "Designing and tuning digital controllers", Instruments and Control Systems 41 (1968).
[2] Skogestad, "Simple analytic rules for model reduction and PID controller tuning", J. Process Control 13 (2003) 291-309.
[3] Astrom and Hagglund, "Advanced PID Control", ISA 2006, sections 7.3 to 7.5.
"""

from collections.abc import Callable

import numpy as np

from workbench.errors import InputError, check_known
from workbench.lpv import LPVModel, check_schedule_from_outside
from workbench.records import field, record

SETTLED = 1e-3  # of the final value; a step response that has not come so near by its last sample has not settled
LONGEST = 100_000  # samples


@record
class FOTD:
    """K exp(-L s) / (T s + 1); K in output units per input unit, T and L in s."""

    K: float = field("")
    T: float = field("", unit="s", low=0.0)
    L: float = field("", unit="s", low=0.0)

    @property
    def tau(self) -> float:
        """Normalised dead time L / (L + T): near 0 lag dominates, near 1 dead time does."""
        return self.L / (self.L + self.T)


@record
class Rule:
    """Gains of the standard form by a rule: Kp (1 + 1 / (Ti s) + Td s); warnings: where the rule was not made for the model."""

    name: str
    Kp: float
    Ti: float = field("", unit="s")
    Td: float = field("", unit="s", default=0.0)
    warnings: tuple[str, ...] = ()


def fotd(model: LPVModel, output: str, source: str, rho: float | None = None) -> FOTD:
    """The first-order model with dead time of one frozen channel, by the areas of its step response; [3] section 2.7.

    T + L = A0 / K, A0 the area between step response and final value; T = e A1 / K, A1 the area under it up to T + L. Half a
    sample is added to L, for the hold. Raises InputError where the channel does not settle or does not move.
    """
    check_schedule_from_outside(model, "a tuning rule")
    i = [c.name for c in model.outputs].index(check_known("output", output, [c.name for c in model.outputs], file=model.name))
    j = [c.name for c in model.inputs].index(check_known("input", source, [c.name for c in model.inputs], file=model.name))
    A, B, C, D = model.freeze(rho)
    steady = np.linalg.solve(np.eye(len(A)) - A, B[:, j])
    K = float(C[i] @ steady + D[i, j])
    y, x = [], np.zeros(len(A))
    while len(y) < LONGEST and np.linalg.norm(x - steady) > SETTLED * np.linalg.norm(steady) / 10:
        y.append(C[i] @ x + D[i, j])
        x = A @ x + B[:, j]
    if not y or len(y) == LONGEST or not abs(K) > 1e-9 * np.abs(y).max():
        raise InputError(
            f"the step from {source} does not settle" if len(y) == LONGEST else f"{source} does not move it in the steady state",
            file=model.name,
            channel=output,
            mend="a rule needs a stable channel with a steady gain; use the tuning under bounds",
        )
    t, y = model.dt * np.arange(len(y)), np.array(y)
    residence = max(model.dt * float(np.sum(1.0 - y / K)), 0.5 * model.dt)
    risen = float(np.sum(y / K * np.clip(residence - t, 0.0, model.dt)))  # of the held response, up to the residence time
    T = float(np.clip(np.e * risen, 0.0, residence))
    return FOTD(K, T, residence - T + 0.5 * model.dt)


def lambda_pi(model: FOTD, closed: float | None = None) -> Rule:
    """Lambda tuning; closed: the closed loop's time constant in s, default the larger of T and 3 L."""
    wanted = max(model.T, 3.0 * model.L) if closed is None else closed
    warnings = (f"lambda = {wanted:g} s is below the dead time {model.L:g} s: little robustness",) if wanted < model.L else ()
    if model.T < model.L:
        warnings += ("dead time dominates: Ti = T makes the integral action too strong",)
    return Rule("lambda", model.T / (model.K * (wanted + model.L)), max(model.T, 1e-9), 0.0, warnings)


def simc_pi(model: FOTD, closed: float | None = None) -> Rule:
    """SIMC; closed: tc in s, default L, the tight choice of [2]."""
    tc = model.L if closed is None else closed
    warnings = (f"tc = {tc:g} s is below the dead time {model.L:g} s: [2] advises against it",) if tc < model.L else ()
    return Rule("simc", model.T / (model.K * (tc + model.L)), min(max(model.T, 1e-9), 4.0 * (tc + model.L)), 0.0, warnings)


def amigo_pi(model: FOTD) -> Rule:
    """AMIGO for PI, made for a largest sensitivity of 1.4."""
    K, T, L = model.K, model.T, model.L
    Kp = 0.15 / K + (0.35 - L * T / (L + T) ** 2) * T / (K * L)
    return Rule("amigo-pi", Kp, 0.35 * L + 13.0 * L * T**2 / (T**2 + 12.0 * L * T + 7.0 * L**2), 0.0, _lag_dominated(model))


def amigo_pid(model: FOTD) -> Rule:
    """AMIGO for PID, made for a largest sensitivity of 1.4."""
    K, T, L = model.K, model.T, model.L
    Kp, Ti, Td = (0.2 + 0.45 * T / L) / K, L * (0.4 * L + 0.8 * T) / (L + 0.1 * T), 0.5 * L * T / (0.3 * L + T)
    return Rule("amigo-pid", Kp, Ti, Td, _lag_dominated(model))


def _lag_dominated(model: FOTD) -> tuple[str, ...]:
    return (
        (f"tau = {model.tau:.2f}: for lag-dominated loops AMIGO is far from the best ([3], section 7.5)",)
        if model.tau < 0.1
        else ()
    )


RULES: dict[str, Callable[[FOTD], Rule]] = {
    "lambda": lambda_pi, "simc": simc_pi, "amigo-pi": amigo_pi, "amigo-pid": amigo_pid
}  # fmt: skip


def relative_gains(P0: np.ndarray) -> np.ndarray:
    """Bristol's relative gain array P(0) * P(0)^-T: entries near 1 are good pairs, negative ones must not be paired."""
    P0 = np.asarray(P0, dtype=float)
    return P0 * np.linalg.pinv(P0).T
