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
from typing import NamedTuple

import numpy as np

from workbench.diagnosis.fit import Fit
from workbench.diagnosis.normal import inverse
from workbench.diagnosis.policy import TIE
from workbench.diagnosis.refit import Model
from workbench.diagnosis.remainder import answers, coefficients, trajectory, variables
from workbench.records import record

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
    plant = model.predictor.plant
    trajectories = [trajectory(model, i) for i in range(model.fit.unknowns.records)]
    made = variables(trajectories)
    argument = plant.argument(key.partition("@")[2])
    over = [name for name in (*plant.state_names, *plant.input_names) if name in made and name != argument]
    forms = []
    for state in plant.laws:
        changing = coefficients(model, ("rate", state), trajectories, {name: made[name] for name in over})
        changing = {name: basis for name, (_, basis) in changing.items() if argument not in name.split(" times ")}
        forms += [_Form(state, name, basis) for name in over for basis in _plain(made, trajectories, name)]
        forms += [_Form(state, name, basis, TIE) for name, basis in changing.items()]
    return _best(_without(model, [key]), forms)


def one_instead(model: Model, keys: Sequence[str]) -> Law | None:
    """The one law over the variable that effects at one place are laws of, that stands best for all of them together.

    Dry friction and drag by the square of the speed make up for a drag by its cube: each shows for sure, and neither is there.
    """
    plant = model.predictor.plant
    trajectories = [trajectory(model, i) for i in range(model.fit.unknowns.records)]
    made = variables(trajectories)
    (argument,) = {plant.argument(key.partition("@")[2]) for key in keys}
    if argument not in made:
        return None
    forms = [_Form(state, argument, basis) for state in plant.laws for basis in _plain(made, trajectories, argument)]
    return _best(_without(model, keys), forms)


def _best(bare: "_Bare", forms: Sequence["_Form"]) -> Law | None:
    """The best of those forms that count, fitted where they come close after a linear step."""
    near: list[tuple[float, _Form]] = []
    for form in forms:
        linear = _pushed(bare, form).linear
        if np.isfinite(linear):  # a push that the filter does not hold tells nothing
            near.append((linear, form))
    found = []
    for _, form in sorted(near, key=lambda law: law[0])[:FITTED]:
        gap = _fitted(_pushed(bare, form))
        if gap < -form.least:
            found.append(Law(form.state, form.variable, gap))
    return min(found, key=lambda law: law.gap, default=None)


class _Form(NamedTuple):
    """Bases (N, c) by record, over `variable`, of what the rate of `state` may lack.

    least: BIC by which it must be better to count.
    """

    state: str
    variable: str
    basis: Sequence[np.ndarray]
    least: float = -np.inf


class _Bare(NamedTuple):
    """A fitted model without some of its effects and with all other unknowns as they are.

    fit: there, with the Jacobian of the whole model. left: which unknowns are left; slope, information: over them. with_effect:
    the cost with the effects, which have so many numbers.
    """

    model: Model
    fit: Fit
    left: np.ndarray
    slope: np.ndarray
    information: np.ndarray
    with_effect: float
    numbers: int


class _Push(NamedTuple):
    """A form beside a bare model: responses (N ny, c) by record, information of all unknowns that are left and of its numbers.

    linear: the gap after one linear step. more: what its further numbers cost.
    """

    bare: _Bare
    form: _Form
    responses: Sequence[np.ndarray]
    information: np.ndarray
    linear: float
    more: float


def _plain(made, trajectories, name: str) -> list[Sequence[np.ndarray]]:
    """Bases of laws over a variable: bumps, its square, its cube."""
    return [made[name][1], *_powers([t[name] for t in trajectories])]


def _powers(values: Sequence[np.ndarray]) -> list[list[np.ndarray]]:
    """Bases of one number: the square and the cube of a variable (N,), in sizes of its largest value; each by record."""
    size = max(float(np.abs(v).max()) for v in values)
    return [[(v[:, None] / size) ** power for v in values] for power in (2, 3)]


def _without(model: Model, keys: Sequence[str]) -> _Bare:
    fit, unknowns = model.fit, model.fit.unknowns
    named = [(t, p) for t, p in zip(unknowns.terms, unknowns.places, strict=True) if t.key in keys]
    z, all_of = fit.z.copy(), np.arange(unknowns.size)
    for t, place in named:
        z[place] = 0.0
        z[place.start : place.start + len(t.sizes)] = unknowns.base[list(t.sizes)]  # the plant's own, 0 where it has none
    left = np.delete(all_of, np.concatenate([all_of[place] for _, place in named]))
    bare = replace(fit, z=z, errors=tuple(model.predictor.at(unknowns.point(z))))
    information = fit.information[np.ix_(left, left)]
    return _Bare(model, bare, left, _slope(bare, left), information, fit.cost, sum(t.count(unknowns.records) for t, _ in named))


def _slope(fit: Fit, left: np.ndarray) -> np.ndarray:
    """Of half the cost over the unknowns that are left, with the Jacobian that the fit has."""
    return (fit.seen([e.ravel() for e in fit.errors]) + fit.prior)[left]


def _over_law(responses: Sequence[np.ndarray], fit: Fit) -> np.ndarray:
    """The slope of half the cost over the numbers of a law."""
    return sum((r.T @ e.ravel() for r, e in zip(responses, fit.errors, strict=True)), start=np.zeros(responses[0].shape[1]))


def _pushed(bare: _Bare, form: _Form) -> _Push:
    R = answers(bare.model, ("rate", form.state), form.basis)
    JR = bare.fit.seen(R)[bare.left]
    A = np.block([[bare.information, JR], [JR.T, sum(r.T @ r for r in R)]])
    more = (JR.shape[1] - bare.numbers) * float(np.log(sum(map(len, bare.model.predictor.records))))
    linear = np.inf
    if np.isfinite(A).all():
        b = np.concatenate([bare.slope, _over_law(R, bare.fit)])
        linear = bare.fit.cost - float(b @ inverse(A) @ b) - bare.with_effect + more
    return _Push(bare, form, R, A, linear, more)


def _fitted(push: _Push) -> float:
    """The gap of a law after a few steps of its fit; each counts only as far as the errors themselves fall."""
    fit, left = push.bare.fit, push.bare.left
    c, covariance = np.zeros(push.responses[0].shape[1]), inverse(push.information)
    for _ in range(STEPS):
        step = covariance @ np.concatenate([_slope(fit, left), _over_law(push.responses, fit)])
        for share in (1.0, 0.5, 0.2, 0.05, 0.01):
            numbers = c - share * step[len(left) :]
            moved = _moved(push, fit, share * step[: len(left)], numbers)
            if moved.cost < fit.cost:
                break
        else:
            break
        gained, fit, c = fit.cost - moved.cost, moved, numbers
        if gained < ENOUGH:
            break
    return fit.cost - push.bare.with_effect + push.more


def _moved(push: _Push, fit: Fit, step: np.ndarray, c: np.ndarray) -> Fit:
    """The fit with the unknowns that are left less `step`, and the law with the numbers c."""
    model, left, z = push.bare.model, push.bare.left, fit.z.copy()
    z[left] -= step
    z[left] = fit.unknowns.clip(z)[left]
    on = np.array([name == push.form.state for name in model.predictor.plant.state_names], dtype=float)
    pushes = [(basis @ c)[:, None, None] * on[:, None] for basis in push.form.basis]
    return replace(fit, z=z, errors=tuple(model.predictor.at(fit.unknowns.point(z), pushes)))
