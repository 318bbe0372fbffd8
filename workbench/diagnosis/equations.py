"""Could one of the plant's own equations be off, where an effect is named?

    cost = min over z, c  |e(z, c)|^2 + |z|^2,      e(z, c): errors without the effect, x_i' pushed by sum_j c_j b_j(v(t))

b_j are bumps over a variable v along the named model's runs, its square or its cube, or what a coefficient does that changes with
it. One linear step,

    min over dz, c  |e_0 + J dz + R c|^2 + |z + dz|^2

says which laws come close, with J and R taken along those runs; these are fitted, by steps with the same J and R. Where a machine
is at rest most of the time, a bent reading of a flow and a duct that resists more look the same, and no effect of the catalogue
stands for the duct.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from workbench.diagnosis.fit import _inverse
from workbench.diagnosis.policy import TIE
from workbench.diagnosis.refit import Model
from workbench.diagnosis.remainder import answers, coefficients, trajectory, variables
from workbench.records import field, record

FITTED = 8  # laws that come closest after a linear step
STEPS, ENOUGH = 40, 0.5  # of a law's fit, at most; of the cost, what the last one gains


@record
class Law:
    """What the rate of `state` would lack over `variable`; gap: BIC by which the plant with it is worse than the named one."""

    state: str
    variable: str
    gap: float

    def __str__(self) -> str:
        return f"the plant's own equation of {self.state} may be off instead, over {self.variable}"


def instead(model: Model, key: str) -> Law | None:
    """The law in one of the plant's equations that stands best for the effect `key`; None for a plant without laws.

    A law over what the effect itself is a law of (a command, the speed of a shaft) is no other cause, but its form. A coefficient
    that changes with another variable counts only where it is better: there are so many that one of them ties by chance.
    """
    plant, unknowns = model.predictor.plant, model.fit.unknowns
    bare = _without(model, key)
    trajectories = [trajectory(model, i) for i in range(unknowns.records)]
    made = variables(trajectories)
    argument = plant.argument(key.partition("@")[2])
    over = [name for name in (*plant.state_names, *plant.input_names) if name in made and name != argument]
    near: list[tuple[float, str, str, Sequence[np.ndarray], float]] = []
    for state in plant.laws:
        changing = coefficients(model, ("rate", state), trajectories, {name: made[name] for name in over})
        changing = {name: basis for name, basis in changing.items() if argument not in name.split(" times ")}
        laws = {name: [made[name][1], *_powers([t[name] for t in trajectories])] for name in over}
        laws |= {name: [basis] for name, (_, basis) in changing.items()}
        for variable, basis in ((variable, basis) for variable, bases in laws.items() for basis in bases):
            push = _pushed(bare, state, variable, basis)
            if np.isfinite(push.information).all():  # a push that the filter does not hold tells nothing
                near.append((push.linear, state, variable, basis, TIE if variable in changing else -np.inf))
    found = []
    for linear, state, variable, basis, least in sorted(near, key=lambda law: law[0])[:FITTED]:
        gap = _fitted(_pushed(bare, state, variable, basis)) if np.isfinite(linear) else np.inf
        if gap < -least:
            found.append(Law(state, variable, gap))
    return min(found, key=lambda law: law.gap, default=None)


@record
class _Bare:
    """A fitted model without one effect: unknowns at which it has none, which of them are left, and its errors and cost there.

    with_effect: the cost with it; numbers: of the effect.
    """

    model: Model
    z: np.ndarray = field("n")
    left: tuple[int, ...]
    errors: tuple[np.ndarray, ...]
    cost: float
    with_effect: float
    numbers: int


@record
class _Push:
    """A law over `variable` in the rate of `state`, beside a bare model: bases (N, c) and responses (N ny, c) by record.

    information (n + c, n + c): of the unknowns that are left and of the law's numbers. linear: the gap after one linear step.
    more: what the law's further numbers cost.
    """

    bare: _Bare
    state: str
    variable: str
    basis: tuple[np.ndarray, ...]
    responses: tuple[np.ndarray, ...]
    information: np.ndarray
    linear: float
    more: float


def _powers(values: Sequence[np.ndarray]) -> list[list[np.ndarray]]:
    """Bases of one number: the square and the cube of a variable (N,), in sizes of its largest value; each by record."""
    size = max(float(np.abs(v).max()) for v in values)
    return [[(v[:, None] / size) ** power for v in values] for power in (2, 3)]


def _without(model: Model, key: str) -> _Bare:
    fit, unknowns = model.fit, model.fit.unknowns
    named, place = next((t, p) for t, p in zip(unknowns.terms, unknowns.places, strict=True) if t.key == key)
    z = fit.z.copy()
    z[place.start : place.start + len(named.sizes)] = unknowns.base[list(named.sizes)]  # the plant's own, 0 where it has none
    left = tuple(j for j in range(unknowns.size) if not place.start <= j < place.stop)
    errors = _errors(model, z)
    return _Bare(model, z, left, errors, _cost(model, z, left, errors), fit.cost, named.count(unknowns.records))


def _errors(model: Model, z: np.ndarray, pushes: Sequence[np.ndarray | None] | None = None) -> tuple[np.ndarray, ...]:
    """Whitened errors (N ny) of every record, with rates of change (N, nx, 1) that are given."""
    point, found = model.fit.unknowns.point(z), []
    for i in range(model.fit.unknowns.records):
        push = None if pushes is None else pushes[i]
        e = model.predictor.errors(i, point.p[None], point.eta[i][None], point.start[i][None], push=push)
        found.append(e[0].ravel())
    return tuple(found)


def _cost(model: Model, z: np.ndarray, left: Sequence[int], errors: Sequence[np.ndarray]) -> float:
    prior = np.where(model.fit.unknowns.believed, z, 0.0)[list(left)]
    value = sum(float(e @ e) for e in errors) + float(prior @ prior)
    return value if np.isfinite(value) else np.inf


def _slope(push: _Push, z: np.ndarray, errors: Sequence[np.ndarray]) -> np.ndarray:
    """Of half the cost over the unknowns that are left and the numbers of the law."""
    fit = push.bare.model.fit
    prior = np.where(fit.unknowns.believed, z, 0.0)
    of_law = sum(r.T @ e for r, e in zip(push.responses, errors, strict=True))
    return np.concatenate([(fit.seen(errors) + prior)[list(push.bare.left)], of_law])


def _pushed(bare: _Bare, state: str, variable: str, basis: Sequence[np.ndarray]) -> _Push:
    fit, left = bare.model.fit, list(bare.left)
    R = answers(bare.model, ("rate", state), basis)
    JR = fit.seen(R)[left]
    A = np.block([[fit.information[np.ix_(left, left)], JR], [JR.T, sum(r.T @ r for r in R)]])
    more = (JR.shape[1] - bare.numbers) * float(np.log(sum(map(len, bare.model.predictor.records))))
    push = _Push(bare, state, variable, tuple(basis), tuple(R), A, np.inf, more)
    b = _slope(push, bare.z, bare.errors)
    gained = float(b @ _inverse(A) @ b) if np.isfinite(A).all() else 0.0
    return replace(push, linear=bare.cost - gained - bare.with_effect + more)


def _fitted(push: _Push) -> float:
    """The gap of a law after a few steps of its fit; each counts only as far as the errors themselves fall."""
    bare, model = push.bare, push.bare.model
    unknowns, left, at = model.fit.unknowns, list(push.bare.left), model.predictor.plant.state_names.index(push.state)
    inverse = _inverse(push.information)
    z, c, errors, cost = bare.z, np.zeros(push.basis[0].shape[1]), bare.errors, bare.cost
    for _ in range(STEPS):
        step = inverse @ _slope(push, z, errors)
        for share in (1.0, 0.5, 0.2, 0.05, 0.01):
            new_z, new_c = z.copy(), c - share * step[len(left) :]
            new_z[left] -= share * step[: len(left)]
            new_z = np.where(np.isin(np.arange(len(z)), left), unknowns.clip(new_z), bare.z)
            pushes = []
            for basis in push.basis:
                pushes.append(np.zeros((len(basis), len(model.predictor.plant.states), 1)))
                pushes[-1][:, at, 0] = basis @ new_c
            found = _errors(model, new_z, pushes)
            new_cost = _cost(model, new_z, left, found)
            if new_cost < cost:
                break
        else:
            break
        gained, z, c, errors, cost = cost - new_cost, new_z, new_c, found, new_cost
        if gained < ENOUGH:
            break
    return cost - bare.with_effect + push.more
