"""Fit of parameters, start states and effects to measured records by Gauss-Newton on whitened prediction errors.

    minimise  sum_k |W_k e_k(theta, x0, eta)|^2 + |theta|^2 + |(x0 - start)/scale|^2

Free shapes of effects (widths, time constants) are fitted as shape exp(z) with |z|^2 added: where they do not matter they stay.
theta are the plant's parameters in units of what the data sheet leaves open, p = nominal exp(sigma theta): a tolerance of +-t is
the prior of a uniform distribution of that half-width, sigma = t/sqrt(3). Where each record starts is a nuisance of its own.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from itertools import chain, pairwise

import numpy as np

from workbench.diagnosis.normal import inverse, solve
from workbench.diagnosis.predictor import Point, Predictor
from workbench.physics.effects.effect import GridUnit
from workbench.physics.plant import Plant
from workbench.records import field, record

FARTHEST = 30.0  # of the logarithm of a parameter from nominal: a step of a singular fit must not overflow
WIDEST = 3.0  # of the logarithm of a shape from where its fit began
NEAR = 0.1  # standard deviations of the prior
THETA_STEP, START_STEP, ANGLE_STEP, SHAPE_STEP = 1e-3, 1e-3, 1e-3, 1e-5
SIZE_STEP = 1e-4  # of an effect's size


@record
class Term:
    """An effect in a hypothesis: indices of its sizes and shapes in eta.

    free: the shapes that are fitted too. phase: the sizes are (cosine, sine) of an angle whose zero differs between records; the
    records share the amplitude, and every record after the first has a rotation of its own.
    """

    key: str
    sizes: tuple[int, ...]
    shapes: tuple[int, ...]
    free: tuple[int, ...] = ()
    phase: bool = False

    def count(self, records: int) -> int:
        """Number of fitted numbers with so many records."""
        return len(self.sizes) + len(self.free) + self.phase * (records - 1)


def term(plant: Plant, key: str, free: Sequence[int] = ()) -> Term:
    """The term of the effect `key` of a plant, e.g. "coulomb@unwind"."""
    own = [i for i, slot in enumerate(plant.slots) if slot.key == key]
    shapes = tuple(i for i in own if plant.slots[i].parameter.shape)
    sizes = tuple(i for i in own if i not in shapes)
    return Term(key, sizes, shapes, tuple(free), getattr(plant.slots[own[0]].effect, "phase", False))


@record
class Unknowns:
    """What is fitted: plant parameters (by index, with sigma), every record's start, and the terms of a hypothesis.

    A vector of unknowns is [theta, starts by record, terms]; a term's numbers are its sizes, the logarithms of its free shapes
    over those in `base`, and its rotations.
    """

    plant: Plant
    records: int
    parameters: tuple[int, ...]
    sigma: np.ndarray = field("n")
    start: np.ndarray = field("nr nx")
    scale: np.ndarray = field("nr nx")
    terms: tuple[Term, ...] = ()
    nominal: np.ndarray = field("np", default_factory=lambda: np.empty(0))  # parameters that are not fitted, and where theta is 0
    base: np.ndarray = field("ne", default_factory=lambda: np.empty(0))  # effects that are not fitted, shapes among them

    @cached_property
    def split(self) -> tuple[int, int, int]:
        """Numbers of parameters, of start states of one record, and of the terms."""
        return len(self.parameters), self.start.shape[1], sum(t.count(self.records) for t in self.terms)

    @property
    def size(self) -> int:
        n, nx, k = self.split
        return n + self.records * nx + k

    @cached_property
    def believed(self) -> np.ndarray:
        """Which unknowns have a prior, of mean 0 and standard deviation 1: all but the sizes and rotations of terms."""
        n, nx, _ = self.split
        tail = [[False] * len(t.sizes) + [True] * len(t.free) + [False] * (t.phase * (self.records - 1)) for t in self.terms]
        return np.array([True] * (n + self.records * nx) + [b for t in tail for b in t])

    def columns(self, i: int) -> np.ndarray:
        """Indices of the unknowns that record i sees."""
        n, nx, k = self.split
        return np.concatenate([np.arange(n), n + i * nx + np.arange(nx), n + self.records * nx + np.arange(k)])

    def zero(self) -> np.ndarray:
        """The unknowns at nominal parameters, assumed starts and the terms' present values in `base`."""
        n, nx, _ = self.split
        tail = [np.concatenate([self.base[list(t.sizes)], np.zeros(t.count(self.records) - len(t.sizes))]) for t in self.terms]
        return np.concatenate([np.zeros(n + self.records * nx), *tail])

    def vector(self, point: Point, terms: Sequence[np.ndarray]) -> np.ndarray:
        """The unknowns that give `point`'s parameters and starts, with each term's own numbers."""
        nominal = self.nominal[list(self.parameters)]
        theta = np.log(point.p[list(self.parameters)] / nominal) / self.sigma
        return np.concatenate([theta, ((point.start - self.start) / self.scale).ravel(), *terms])

    @cached_property
    def places(self) -> tuple[slice, ...]:
        """Where each term's numbers stand in a vector of unknowns."""
        ends = self.size - self.split[2] + np.cumsum([0, *(t.count(self.records) for t in self.terms)])
        return tuple(slice(int(first), int(last)) for first, last in pairwise(ends))

    def of_terms(self, z: np.ndarray) -> list[np.ndarray]:
        """Each term's numbers."""
        return [z[own] for own in self.places]

    def point(self, z: np.ndarray) -> Point:
        """Parameters, effects and starts of a vector of unknowns."""
        n, nx, _ = self.split
        p = self.nominal.copy()
        p[list(self.parameters)] *= np.exp(np.clip(self.sigma * z[:n], -FARTHEST, FARTHEST))
        start = self.start + self.scale * z[n : n + self.records * nx].reshape(self.records, nx)
        eta = np.repeat(self.base[None], self.records, axis=0)
        for t, own in zip(self.terms, self.of_terms(z), strict=True):
            k = len(t.sizes)
            eta[:, list(t.sizes)] = own[:k]
            eta[:, list(t.free)] = self.base[list(t.free)] * np.exp(own[k : k + len(t.free)])
            if t.phase:
                turn = np.concatenate([[0.0], own[k + len(t.free) :]])
                c, s = own[:2]
                eta[:, t.sizes[0]] = c * np.cos(turn) - s * np.sin(turn)
                eta[:, t.sizes[1]] = c * np.sin(turn) + s * np.cos(turn)
        return Point(p, self._bounded(eta), start)

    def _bounded(self, eta: np.ndarray) -> np.ndarray:
        low, high = (np.array([getattr(slot.parameter, side) for slot in self.plant.slots]) for side in ("low", "high"))
        return np.clip(eta, low, high)

    def clip(self, z: np.ndarray) -> np.ndarray:
        """The unknowns with sizes and shapes inside their bounds."""
        z = z.copy()
        for t, own in zip(self.terms, self.places, strict=True):
            at = own.start
            for j, slot in enumerate(t.sizes):
                p = self.plant.slots[slot].parameter
                z[at + j] = np.clip(z[at + j], p.low, p.high)
            shapes = slice(at + len(t.sizes), at + len(t.sizes) + len(t.free))
            z[shapes] = np.clip(z[shapes], -WIDEST, WIDEST)
        return z

    def recentred(self, z: np.ndarray) -> tuple["Unknowns", np.ndarray]:
        """Unknowns about the shapes, dates apart, that stand at the end of their range, and z there; the same where none does."""
        base, z = self.base.copy(), z.copy()
        for t, own in zip(self.terms, self.places, strict=True):
            for j, slot in enumerate(t.free, start=own.start + len(t.sizes)):
                q = self.plant.slots[slot].parameter
                if abs(z[j]) >= WIDEST and q.grid_unit is not GridUnit.RECORD:
                    base[slot], z[j] = np.clip(base[slot] * np.exp(z[j]), q.low, q.high), 0.0
        return (self, z) if np.array_equal(base, self.base) else (replace(self, base=base), z)

    def steps(self, sizes: np.ndarray) -> np.ndarray:
        """Step lengths for differences; sizes (ne): a small size of each effect."""
        n, nx, _ = self.split
        parts = [np.full(n, THETA_STEP), np.full(self.records * nx, START_STEP)]
        for t in self.terms:
            rest = [SHAPE_STEP] * len(t.free) + [ANGLE_STEP] * (t.phase * (self.records - 1))
            parts.append(np.array([*(sizes[j] for j in t.sizes), *rest]))
        return np.concatenate(parts)


@record
class Fit:
    """Unknowns z at the end of a fit, the whitened errors there, and the Jacobian (by record, columns as in Unknowns.columns)."""

    unknowns: Unknowns
    z: np.ndarray
    errors: tuple[np.ndarray, ...]
    jacobian: tuple[np.ndarray, ...]

    @property
    def point(self) -> Point:
        return self.unknowns.point(self.z)

    @property
    def prior(self) -> np.ndarray:
        """The unknowns in standard deviations of their prior, 0 where they have none."""
        return np.where(self.unknowns.believed, self.z, 0.0)

    @cached_property
    def squares(self) -> float:
        """Sum of squares of the whitened errors; inf where a run left every range."""
        value = float(sum(np.sum(e**2) for e in self.errors))
        return value if np.isfinite(value) else np.inf

    @property
    def cost(self) -> float:
        """Sum of squares that the fit minimises."""
        return self.squares + float(self.prior @ self.prior)

    @cached_property
    def information(self) -> np.ndarray:
        """J'J of the errors and the prior, (n, n)."""
        return _normal(self.unknowns, self.jacobian, self.errors)[0]

    @cached_property
    def gradient(self) -> np.ndarray:
        """J'e and the prior's part: 0 at a minimum."""
        return _normal(self.unknowns, self.jacobian, self.errors)[1] + self.prior

    @cached_property
    def covariance(self) -> np.ndarray:
        """Covariance of the unknowns, to first order."""
        return inverse(self.information)

    def seen(self, columns: Sequence[np.ndarray]) -> np.ndarray:
        """J'R, (n, ..): what the unknowns see of columns R_i (N ny, ..), by record."""
        found = np.zeros((self.unknowns.size, *columns[0].shape[1:]))
        for i, (J, R) in enumerate(zip(self.jacobian, columns, strict=True)):
            found[self.unknowns.columns(i)] += J.T @ R
        return found

    def projected(self, i: int, weights: np.ndarray) -> np.ndarray:
        """J_i weights (N ny, c): what a move of the unknowns, weights (n, c), does to the errors of record i."""
        return self.jacobian[i] @ weights[self.unknowns.columns(i)]


def _normal(unknowns: Unknowns, jacobian, errors) -> tuple[np.ndarray, np.ndarray]:
    A, b = np.diag(unknowns.believed.astype(float)), np.zeros(unknowns.size)
    for i, (J, e) in enumerate(zip(jacobian, errors, strict=True)):
        own = unknowns.columns(i)
        A[np.ix_(own, own)] += J.T @ J
        b[own] += J.T @ e.ravel()
    return A, b


def jacobian(
    predictor: Predictor,
    unknowns: Unknowns,
    z: np.ndarray,
    sizes: np.ndarray,
    known: Sequence[np.ndarray] = (),
    at: Sequence[np.ndarray] = (),
) -> tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...]]:
    """(errors (N, ny), J (N ny, columns)) of every record at z, by differences: one batch of lanes a record.

    known: a Jacobian whose columns of parameters and starts are taken over. at: the errors at z, where they are known. What a
    start does is not taken from the filter's linearization: where something has play, that is no derivative of the errors.
    """
    steps, errors, J = unknowns.steps(sizes), [], []
    n, nx, k = unknowns.split
    low = unknowns.size - k
    for i in range(unknowns.records):
        own = unknowns.columns(i)
        moved = own[n + nx :] if known else own
        stays = not at or not len(moved)  # a run at z itself
        moves, signed = [z] if stays else [], []
        for j in moved:
            step = steps[j]
            if j >= low and not np.array_equal(
                unknowns.clip(z + step * (np.arange(len(z)) == j)), z + step * (np.arange(len(z)) == j)
            ):
                step = -step
            signed.append(step)
            moves.append(z + step * (np.arange(len(z)) == j))
        e = _errors(predictor, unknowns, i, moves)
        here, there = (e[0], e[1:]) if stays else (at[i], e)
        errors.append(here)
        columns = ((there - here).reshape(len(moved), here.size) / np.array(signed)[:, None]).T
        J.append(np.concatenate([known[i][:, : n + nx], columns], axis=1) if known else columns)
    return tuple(errors), tuple(J)


def _errors(predictor: Predictor, unknowns: Unknowns, i: int, vectors: Sequence[np.ndarray]) -> np.ndarray:
    """Whitened errors (c, N, ny) of record i at c vectors of unknowns."""
    points = [unknowns.point(z) for z in vectors]
    return predictor.errors(
        i, np.array([q.p for q in points]), np.array([q.eta[i] for q in points]), np.array([q.start[i] for q in points])
    )


def sharpened(predictor: Predictor, fit: Fit) -> Fit:
    """The fit with its Jacobian by central differences, for what is said of its unknowns: their covariance.

    One-sided differences are off by a share of their steps, every column by a share of its own. A fit does not mind. But where
    the records show a combination of unknowns only, what is left of large columns that should cancel reads as information about
    each of them: intervals came out fourteen times too narrow. At the end of a range the difference stays one-sided.
    """
    unknowns, z, found = fit.unknowns, fit.z, []
    moves = unknowns.steps(small_steps(unknowns, z))[:, None] * np.eye(unknowns.size)
    low = unknowns.size - unknowns.split[2]
    for i in range(unknowns.records):
        own = unknowns.columns(i)
        sides = [[z + side * moves[j] if j < low else unknowns.clip(z + side * moves[j]) for j in own] for side in (1.0, -1.0)]
        e = _errors(predictor, unknowns, i, [*chain(*sides)])
        between = np.array([ahead[j] - behind[j] for j, ahead, behind in zip(own, *sides, strict=True)])
        change = (e[: len(own)] - e[len(own) :]).reshape(len(own), -1)
        found.append((change / between[:, None]).T)
    return replace(fit, jacobian=tuple(found)) if all(np.isfinite(J).all() for J in found) else fit


def small_steps(unknowns: Unknowns, z: np.ndarray) -> np.ndarray:
    """A small size (ne) of each fitted effect, for differences."""
    sizes = np.zeros(len(unknowns.plant.slots))
    for t, own in zip(unknowns.terms, unknowns.of_terms(z), strict=True):
        sizes[list(t.sizes)] = SIZE_STEP * max(float(np.linalg.norm(own[: len(t.sizes)])), 1e-9)
    return sizes


def gauss_newton(
    predictor: Predictor,
    unknowns: Unknowns,
    z: np.ndarray,
    sizes: np.ndarray,
    *,
    rounds: int = 3,
    enough: float = 0.05,
    chords: int = 3,
) -> Fit:
    """Minimise from z: at most `rounds` Jacobians, each for up to `chords` steps; stops where a step gains less than `enough`.

    Columns of parameters and starts are made anew where a parameter has moved by more than NEAR. A step that gives no numbers is
    no step.
    """
    z = unknowns.clip(z)
    fit, known, made_at = None, (), z
    n = unknowns.split[0]
    for _ in range(rounds):
        if np.any(np.abs(z - made_at)[:n] > NEAR) or not unknowns.terms:
            known = ()
        e, J = jacobian(predictor, unknowns, z, sizes, known, fit.errors if fit else ())
        if not known:
            known, made_at = J, z
        fit = Fit(unknowns, z, e, J)
        began = cost = fit.cost
        A, _ = _normal(unknowns, J, e)
        if not np.isfinite(A).all():
            break
        for _ in range(chords):
            _, b = _normal(unknowns, J, fit.errors)
            b += fit.prior
            better = _best_step(predictor, unknowns, z, A, b, cost, J)
            if better is None:
                break
            gained = cost - better.cost
            fit, z, cost = better, better.z, better.cost
            if gained < enough:
                break
        if began - cost < enough:
            break
    assert fit is not None
    return fit


def _best_step(predictor, unknowns, z, A, b, cost, J) -> Fit | None:
    """The full step if it helps, else the best of a fan of shorter and more damped ones, side by side."""
    scale = np.diag(np.diag(A))
    full = solve(A, b)
    fan = [share * full for share in (0.5, 0.2, 0.05, 0.01)]
    fan += [solve(A + damping * scale, b) for damping in (1e-3, 1e-2, 1e-1, 1.0, 10.0)]
    for trials in ([full], fan):
        moves = [unknowns.clip(z - step) for step in trials if np.isfinite(step).all()]
        best = min(_evaluate(predictor, unknowns, moves, J), key=lambda f: f.cost) if moves else None
        if best is not None and best.cost < cost:
            return best
    return None


def _evaluate(predictor: Predictor, unknowns: Unknowns, vectors: Sequence[np.ndarray], J) -> list[Fit]:
    points = [unknowns.point(v) for v in vectors]
    p, eta, start = (np.array([getattr(q, name) for q in points]) for name in ("p", "eta", "start"))
    by_record = [predictor.errors(i, p, eta[:, i], start[:, i]) for i in range(unknowns.records)]
    return [Fit(unknowns, v, tuple(e[c] for e in by_record), J) for c, v in enumerate(vectors)]
