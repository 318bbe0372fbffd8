"""The experiment that would decide between two causes: T-optimality with the signatures of both.

    lambda = |(I - P) c_i|^2,   c_i = e(eta_i) - e(0) along a simulated run, P projects on c_j and on what parameters can mimic

lambda is the expected gain in twice the log-likelihood of the true cause over its rival, whose size is free. Below 10 an
experiment decides nothing.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from workbench.data import Dataset
from workbench.diagnose.answer import NextExperiment
from workbench.diagnose.fit import Fit, jacobian
from workbench.diagnose.predictor import predictor
from workbench.diagnose.recalibrate import unknowns
from workbench.diagnose.refit import Model
from workbench.errors import InputError
from workbench.physics.controller import Controller
from workbench.physics.plant import EffectSizes
from workbench.records import record
from workbench.simulate import Scenario, simulate

ENOUGH = 10.0


@record
class Template:
    """An experiment that the machine could run: a loop and the set-points or inputs it follows, by name (N,)."""

    name: str
    controller: Controller
    references: Mapping[str, np.ndarray]


def deciding(
    model: Model, rival: Model, names: tuple[str, str], templates: Sequence[Template], separates: str
) -> NextExperiment | None:
    """The template that tells the cause in `model` from that in `rival`; where none does, what else could (`separates`)."""
    expected, best = {}, None
    for template in templates:
        try:
            expected[template.name] = _expected(model, rival, template)
        except InputError:
            continue  # a run that the plant cannot make with these parameters
        if best is None or expected[template.name] > expected[best.name]:
            best = template
    if best is None:
        return None
    own, other = names
    if expected[best.name] < ENOUGH:
        return NextExperiment(
            f"no experiment of the plan tells {own} from {other}. {separates}", {}, model.predictor.plant.dt, expected
        )
    sentence = (
        f"{own} and {other} explain these records alike; one run of {best.name!r} would decide "
        f"(expected evidence {expected[best.name]:.0f}, 10 is enough)"
    )
    return NextExperiment(sentence, dict(best.references), model.predictor.plant.dt, expected)


def _expected(model: Model, rival: Model, template: Template) -> float:
    plant, point = model.predictor.plant, model.fit.point
    parameters = {q.name: float(v) for q, v in zip(plant.parameters, point.p, strict=True)}
    scenario = Scenario(template.name, template.references, seed=0)
    run = simulate(plant, template.controller, scenario, parameters=parameters, effects=_sizes(model)).experiment
    measured = [
        name for j, name in enumerate(plant.output_names) if any(np.isfinite(r.y[:, j]).any() for r in model.predictor.records)
    ]
    run = run.select([name for name in run.names if name in measured or name in plant.input_names])
    made = predictor(plant, Dataset((run,)))
    own = unknowns(made)
    z = own.zero()
    z[: own.split[0]] = model.fit.z[: own.split[0]]
    made = made.regained(own.point(z), model.predictor.noise)
    e, J = jacobian(made, own, z, np.zeros(len(plant.slots)))
    fit = Fit(own, z, e, J)
    eta = np.array([own.base, model.fit.point.eta[0], rival.fit.point.eta[0]])
    at = own.point(z)
    changes = made.errors(0, at.p[None], eta, at.start[:1])
    c = (changes[1:] - changes[:1]).reshape(2, -1).T
    JG = J[0].T @ c
    projected = c - J[0] @ (fit.covariance @ JG)
    a, b = projected.T
    left = a - b * (a @ b) / max(float(b @ b), 1e-300)
    return float(left @ left)


def _sizes(model: Model) -> EffectSizes:
    plant, eta = model.predictor.plant, model.fit.point.eta[0]
    return {
        key: {slot.parameter.name: float(eta[i]) for i, slot in enumerate(plant.slots) if slot.key == key} for key in model.keys
    }
