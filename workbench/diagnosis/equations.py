"""Could one of the plant's own equations be off, where a static error of a sensor is named?

    cost = min over c, dz  |e_0 + J dz + R c|^2 + |z + dz|^2,      R: what bumps b_j(v) in the rate of x_i do to the errors

e_0 are the errors without the named effect; J and R are taken along the named model's runs. Where the machine is at rest most of
the time, a bent reading of a flow and a duct that resists more look the same, and no effect of the catalogue stands for the duct.
"""

import numpy as np

from workbench.diagnosis.fit import _inverse
from workbench.diagnosis.policy import TIE
from workbench.diagnosis.refit import Model
from workbench.diagnosis.remainder import answers, coefficients, trajectory, variables
from workbench.records import record


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
    fit, predictor = model.fit, model.predictor
    unknowns, plant = fit.unknowns, predictor.plant
    named, place = next((t, p) for t, p in zip(unknowns.terms, unknowns.places, strict=True) if t.key == key)
    others = np.delete(np.arange(unknowns.size), place)
    e, prior = [], fit.prior[others]
    for i, (eta, start) in enumerate(zip(fit.point.eta, fit.point.start, strict=True)):
        without = eta.copy()
        without[list(named.sizes)] = unknowns.base[list(named.sizes)]  # the plant's own, 0 where it has none
        e.append(predictor.errors(i, fit.point.p[None], without[None], start[None])[0].ravel())
    cost = sum(float(own @ own) for own in e) + float(prior @ prior)
    slope, information = fit.seen(e)[others] + prior, fit.information[np.ix_(others, others)]
    numbers = named.count(unknowns.records)
    found = []
    trajectories = [trajectory(model, i) for i in range(unknowns.records)]
    made = variables(trajectories)
    argument = plant.argument(key.partition("@")[2])
    over = [name for name in (*plant.state_names, *plant.input_names) if name in made and name != argument]
    for state in plant.laws:
        changing = coefficients(model, ("rate", state), trajectories, {name: made[name] for name in over})
        changing = {name: basis for name, basis in changing.items() if argument not in name.split(" times ")}
        for variable, (_, basis) in ({name: made[name] for name in over} | changing).items():
            R = answers(model, ("rate", state), basis)
            JR = fit.seen(R)[others]
            A = np.block([[information, JR], [JR.T, sum(r.T @ r for r in R)]])
            b = np.concatenate([slope, sum(r.T @ own for r, own in zip(R, e, strict=True))])
            if np.isfinite(A).all():  # a push that the filter does not hold tells nothing
                more = (JR.shape[1] - numbers) * float(np.log(sum(map(len, predictor.records))))
                gap = cost - float(b @ _inverse(A) @ b) - fit.cost + more
                if variable not in changing or gap < -TIE:
                    found.append(Law(state, variable, gap))
    return min(found, key=lambda law: law.gap, default=None)
