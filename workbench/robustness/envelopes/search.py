"""The search for the multipliers with the lowest bound: quasi-Newton descent, taken up again where it got stuck."""

import numpy as np

from workbench.robustness.envelopes.problem import Attempt, Problem

WORK, EVALUATIONS = 500_000, 3000  # samples that the recursion may pass in search of multipliers, and how often it may
RESTARTED = 0.1  # share of the first multipliers from which the search goes on where it got stuck near the end of what is allowed
GAINED = 1e-3  # relative decrease of the bound below which it does not
MEMORY = 30  # pairs of the quasi-Newton method
SETTLED = 1e-5  # relative decrease of the bound over TAIL steps at which it ends
TAIL = 10


def searched(problem: Problem, first: Attempt) -> Attempt:
    """Descended from the first multipliers, and again from between them and the end, where R is about to break down."""
    best, left = _descended(problem, first, min(EVALUATIONS, max(1, WORK // len(problem.k))))
    while left > 0:
        inside = problem.at(problem.blended(best, first, RESTARTED))
        if inside is None:
            break
        former = best
        best, left = _descended(problem, inside, left - 1)
        if best.value >= former.value * (1.0 - GAINED):
            return min(best, former, key=lambda attempt: attempt.value)
    return best


def _descended(problem: Problem, best: Attempt, most: int) -> tuple[Attempt, int]:
    """Quasi-Newton (L-BFGS) with the curvature of each multiplier as the first metric; where R breaks down counts as infinite.

    most: evaluations, of which the second answer is what is left.
    """
    pairs: list[tuple[np.ndarray, np.ndarray, float]] = []
    values, count = [best.value], 0
    while count < most:
        curvature = best.curvature + 1e-6 * best.curvature.max()
        step, shares = best.slope.copy(), []
        if not curvature.max() > 0.0:
            break  # nothing depends on anything
        for s, y, rho in reversed(pairs):
            shares.append(rho * (s @ step))
            step -= shares[-1] * y
        step /= curvature
        for (s, y, rho), share in zip(pairs, reversed(shares), strict=True):
            step += (share - rho * (y @ step)) * s
        falls = float(step @ best.slope)
        if not falls > 0.0:
            if not pairs:
                break
            pairs = []
            continue
        step *= min(1.0, 2.0 / max(float(np.abs(step).max()), 1e-300))
        length, new = 1.0, None
        while length > 1e-6 and count < most:
            new, count = problem.at(best.x - length * step), count + 1
            if new is not None and new.value <= best.value - 1e-4 * length * float(step @ best.slope):
                break
            new, length = None, 0.4 * length
        if new is None:
            if not pairs:
                break
            pairs = []
            continue
        s, y = new.x - best.x, new.slope - best.slope
        if s @ y > 1e-12 * np.linalg.norm(s) * np.linalg.norm(y):
            pairs = [*pairs[-MEMORY + 1 :], (s, y, 1.0 / float(s @ y))]
        best = new
        values.append(best.value)
        if len(values) > TAIL and values[-TAIL - 1] - best.value < SETTLED * best.value:
            break
    return best, most - count
