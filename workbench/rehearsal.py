"""Choosing what robustness leaves open before a law has seen the machine: candidates follow set-points on the identified model.

    x+ = A(rho) x + B(rho) (u - u0) + K(rho) e,     y = C(rho) x + y0 + e,     e white with the model's own covariance
    cost = mean over outputs and samples of ((r - y) / size)^2,   size: the output's largest set-point step

The model moves along a given schedule, or along its own output where that is the schedule; u is what the law commands of r and y,
its limits included.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from workbench.curves import Curve
from workbench.data import SAME_DT, Channel, Experiment
from workbench.errors import InputError, check_known
from workbench.hammerstein import Model, behind, curves_of
from workbench.lpv import LPVModel, check_no_feedthrough, check_schedule_from_outside
from workbench.physics.controller import schedules_of, stepped
from workbench.records import field, record
from workbench.steady import rests
from workbench.units import check_law_units

HOLD = (1.0, 4.0)  # s, shortest and longest stay at a set-point
NO_WORSE = 1.01  # ratio of costs up to which a calmer candidate is taken


@record
class Rehearsal:
    """Set-points (N, ny) in the model's units along a schedule, noise e (N, ny), and what counts as 1 in each output.

    rho (N,), of several schedule variables (N, ns). curves: what arrives of inputs, in place of u in the equation.
    follows: the output that the schedule is; then of `rho` only the first value counts, where the run begins.
    """

    model: LPVModel
    references: np.ndarray = field("N ny")
    rho: np.ndarray = field("N ...")
    e: np.ndarray = field("N ny")
    size: np.ndarray = field("ny")
    follows: int | None = None
    curves: tuple[Curve, ...] = ()

    def run(self, law: Any) -> tuple[np.ndarray, np.ndarray]:
        """Commands (N, nu) and measured outputs (N, ny) under the law, from rest at the first set-point; in the model's order.

        Raises InputError where the law reads or commands what the model does not have.
        """
        model, point = self.model, self.model.operating_point
        _check_fits(law, model)
        at_y, at_u = _places(law, law.measured, model.outputs), _places(law, law.actuated, model.inputs)
        check_no_feedthrough(model)
        check_schedule_from_outside(model, "a rehearsal")
        weights, phi = model.weights(self.rho), point.basis(self.rho)
        u0, y0 = phi @ point.u, phi @ point.y
        K = model.predictor.K if model.predictor else np.zeros((len(model.terms), model.order, len(self.size)))
        A, B, C = (np.tensordot(weights[0], M, 1) for M in (model.A, model.B, model.C))
        X, U = rests(A, B[:, at_u], C[at_y], np.zeros((len(at_y), len(at_u))))
        off = (self.references[0] - y0[0])[at_y]
        x, commands, y = X @ off, u0.copy(), np.empty_like(self.references)
        commands[:, at_u] += U @ off  # an input that the law does not command stays at the operating point
        curves = [([c.name for c in model.inputs].index(curve.input), curve) for curve in self.curves]
        for i, curve in curves:
            commands[:, i] = [curve.nearest(v) for v in commands[:, i]]
        state = law.init(commands[0, at_u])
        schedule, longest = self.rho.copy(), max(term.delay for term in model.terms)
        for k, r in enumerate(self.references):
            if self.follows is not None and k > 0:  # until it is known what y is, the schedule is what it was
                schedule[k] = schedule[k - 1]
                u0[k], y0[k], weights[k] = u0[k - 1], y0[k - 1], weights[k - 1]
            y[k] = np.tensordot(weights[k], model.C, 1) @ x + y0[k] + self.e[k]
            if self.follows is not None and k > 0 and np.isfinite(y[k]).all():
                schedule[k] = np.clip(y[k, self.follows], *model.span)
                now = point.basis(schedule[k])
                u0[k], y0[k] = now @ point.u, now @ point.y
                weights[k] = model.weights(schedule[max(0, k - longest) : k + 1])[-1]
            A, B, K_k = (np.tensordot(weights[k], M, 1) for M in (model.A, model.B, K))
            rho = schedule[k] if law.schedule else None
            commands[k, at_u], state = stepped(law, state, r[at_y][: len(law.references)], y[k, at_y], rho)
            acting = commands[k].copy()
            for i, curve in curves:
                acting[i] = curve(acting[i])
            x = A @ x + B @ (acting - u0[k]) + K_k @ self.e[k]
        return commands, y

    def cost(self, law: Any) -> float:
        """Mean square of the errors under the law; infinite where the loop runs away."""
        with np.errstate(over="ignore", invalid="ignore"):
            cost = float(np.mean(((self.references - self.run(law)[1]) / self.size) ** 2))
        return cost if np.isfinite(cost) else np.inf


def _check_fits(law: Any, model: LPVModel) -> None:
    """Refuse a law of another sample time or another schedule."""
    if abs(law.dt - model.dt) > SAME_DT * model.dt:
        mend = "design one on this model"
        raise InputError(f"{law.name} is sampled every {law.dt:g} s, the model every {model.dt:g} s", file=model.name, mend=mend)
    check_law_units(law, (*model.inputs, *model.outputs, *model.schedules), model.name)
    own, known = list(schedules_of(law)), [c.name for c in model.schedules]
    if own and own != known:
        said = f"{law.name} is scheduled on {', '.join(own)}, the model has {', '.join(known) or 'no schedule'}"
        raise InputError(said, file=model.name)


def _places(law: Any, names: Sequence[str], channels: Sequence[Channel]) -> list[int]:
    """Where the law's channels stand among the model's."""
    known = [c.name for c in channels]
    return [known.index(check_known(f"channel of {law.name}", name, known)) for name in names]


def check_setpoint(law: Any, setpoint: Mapping[str, float]) -> None:
    """Refuse set-points of what the law does not control, and outputs of it that have none."""
    controlled = law.measured[: len(law.references)]
    for name in setpoint:
        check_known("output of the controller", name, controlled)
    if missing := [name for name in controlled if name not in setpoint]:
        raise InputError(f"no set-point for {', '.join(missing)}", mend="give --setpoint for every output that the law controls")


def hold(model: Model, law: Any, setpoint: Mapping[str, float], samples: int, seed: int | None) -> Experiment:
    """A record of the law holding set-points on the model, once along its whole schedule; seed None: without noise."""
    check_setpoint(law, setpoint)
    (_, model), curves = behind(law, model), curves_of(model)
    r = [setpoint.get(c.name, 0.0) for c in model.outputs]  # what the law does not measure has none
    whole = rehearsal(model, r, np.zeros(len(r)), samples, seed or 0)
    whole = whole if seed is not None else replace(whole, e=np.zeros_like(whole.e))
    u, y = replace(whole, curves=curves).run(law)
    schedule = tuple(replace(c, role="schedule") for c in model.schedules)
    at = _places(law, law.measured[: len(law.references)], model.outputs)
    units = [model.outputs[i].unit for i in at]
    set_points = [Channel(name, unit, "reference") for name, unit in zip(law.references, units, strict=True)]
    channels = (*model.inputs, *model.outputs, *schedule, *set_points)
    values = np.column_stack([u, y, *([whole.rho] if schedule else ()), whole.references[:, at]])
    return Experiment("setpoint", model.dt * np.arange(samples), channels, values, model.dt)


def rehearsal(
    model: LPVModel, centre: Sequence[float] | np.ndarray, size: Sequence[float] | np.ndarray, samples: int, seed: int
) -> Rehearsal:
    """Random steps of every output up to `size` around `centre`, at times of their own, once along the whole schedule."""
    random = np.random.default_rng(seed)
    ny = len(model.outputs)
    low, high = (max(1, round(s / model.dt)) for s in HOLD)
    references = np.empty((samples, ny))
    for j in range(ny):
        stays = random.integers(low, high, endpoint=True, size=samples // low + 1)
        references[:, j] = np.repeat(centre[j] + size[j] * random.uniform(-1.0, 1.0, len(stays)), stays)[:samples]
    e = random.normal(size=(samples, ny)) @ _root(np.zeros((ny, ny)) if model.noise is None else model.noise).T
    return Rehearsal(model, references, model.path(samples), e, np.asarray(size, dtype=float))


def _root(covariance: np.ndarray) -> np.ndarray:
    """L with L L' = covariance, which may be singular."""
    values, vectors = np.linalg.eigh(covariance)
    return vectors * np.sqrt(np.maximum(values, 0.0))


def calmest(candidates: Mapping[str, Any], rehearsals: Sequence[Rehearsal]) -> tuple[str, dict[str, float]]:
    """Of candidates from calm to brisk the first that costs no more than the cheapest, and the mean cost of each."""
    costs = {name: float(np.mean([own.cost(law) for own in rehearsals])) for name, law in candidates.items()}
    if not np.isfinite(min(costs.values())):
        raise InputError("no candidate holds the model", mend="loosen the bounds of the design, or identify another model")
    return next(name for name, cost in costs.items() if cost <= NO_WORSE * min(costs.values())), costs
