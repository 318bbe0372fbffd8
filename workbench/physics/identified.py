"""An identified model as a plant, so that what simulates, extends and diagnoses machines does the same with black boxes.

    x(k+1) = A(rho) x(k) + B(rho) (u(k) - u0(rho)) + K(rho) L e(k)
    y(k)   = C(rho) x(k) + D(rho) (u(k) - u0(rho)) + y0(rho) + L e(k),        M(rho) = sum_j M_j phi_j(rho(k - d_j))

Of a Hammerstein-Wiener model u is what arrives, f(u), and y is shown without its sign where the sensor is blind to it. e is the
innovation, what the model's own one-step predictor leaves over, in units of its spread (L L' is its covariance): a state
that is pushed at every sample and forgotten at the next. In a free run it is 0, and the plant runs as the model does.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from workbench.curves import Curve, bent
from workbench.data import Channel
from workbench.errors import InputError
from workbench.hammerstein import Model, curves_of
from workbench.lpv import LPVModel, check_schedule_from_outside
from workbench.physics.effects.effect import Named, Port
from workbench.physics.plant import Plant
from workbench.physics.rest import Start
from workbench.records import record

ROUNDING = 1e-12  # of the largest variance: what a covariance needs to have a root
SPEED = "rad/s"


@record
class Turning(Port):
    """What turns with a logged speed: no effect acts there, but what is left over may go with its angle."""

    speed: str

    def verbs(self, effects, context) -> dict:
        """None."""
        del effects, context
        return {}


def identified(model: Model) -> Plant:
    """The plant of a state-space model, or of one behind curves; see the module.

    Its commanded inputs have actuators, its outputs sensors; it has no parameters, for its numbers were fitted all at once and
    none of them is a part of the machine. The schedule is an input that moves on its own and must be logged, unless it is one of
    the inputs already; what the model remembers of it are states. A channel in rad/s turns something, whose angle is followed.
    Raises InputError for a schedule that is an output too.
    """
    name, curves = model.name, {curve.input: curve for curve in curves_of(model)}
    model, unsigned = (model, ()) if isinstance(model, LPVModel) else (model.core, model.unsigned)
    check_schedule_from_outside(model, "a plant of a model")
    for schedule in model.schedules:
        if schedule.name in [c.name for c in model.outputs]:
            raise InputError(
                f"{schedule.name} is schedule and output of this model",
                file=model.name,
                mend="identify it with the schedule as an input from outside: leave it out of --output",
            )
    inputs = tuple(replace(c, role="input") for c in model.inputs)
    known = [c.name for c in inputs]
    inputs = (*inputs, *(replace(c, role="schedule") for c in model.schedules if c.name not in known))
    equation = _Equation(model, curves, unsigned)
    return Plant(
        name=name,
        states=(
            *(Channel(name, "") for name in (*equation.states, *equation.noise)),
            *(Channel(name, unit) for name, unit in equation.past.items()),
            *(Channel(name, SPEED) for name in equation.speeds.values()),
        ),
        inputs=inputs,
        outputs=tuple(replace(c, role="output") for c in model.outputs),
        parameters=(),
        equation=equation.difference,
        measure=equation.outputs,
        dt=model.dt,
        ports=tuple(Turning(place, speed) for place, speed in equation.speeds.items()),
        start=Start(fixed=_at_rest(model, equation.earlier, curves)),
        noise={} if model.noise is None else _spread(model),
        substeps=1,
        description=f"{name}, order {model.order}, identified from records",
        process={name: 1.0 / model.dt for name in equation.noise},
        discrete=True,
    )


def _at_rest(model: LPVModel, earlier: Sequence[Sequence[str]], curves: Mapping[str, Curve]) -> dict[str, float]:
    """The operating point in the middle of the schedule, where the model stands still: what was before the first sample."""
    middle = np.atleast_1d(model.middle).tolist() if model.schedules else []
    u0 = model.operating_point.basis(model.middle) @ model.operating_point.u
    u0 = np.array([curves[c.name].nearest(v) if c.name in curves else v for c, v in zip(model.inputs, u0, strict=True)])
    now = dict(zip((c.name for c in model.schedules), middle, strict=True))
    past = {name: value for names in earlier for name, value in zip(names, middle, strict=True)}
    return past | now | dict(zip((c.name for c in model.inputs), u0.tolist(), strict=True))


def _spread(model: LPVModel) -> dict[str, float]:
    """Standard deviation of the one-step error by output."""
    assert model.noise is not None
    return {c.name: float(s) for c, s in zip(model.outputs, np.sqrt(np.diag(model.noise)), strict=True)}


class _Equation:
    """The equation of a model, and the names of its states: its own, of its noise, of schedule and speeds as they just were."""

    def __init__(self, model: LPVModel, curves: Mapping[str, Curve], unsigned: Sequence[str]):
        self.model, self.curves, self.unsigned = model, curves, unsigned
        self.states = [f"state {i + 1}" for i in range(model.order)]
        self.noise = []
        self.K = self.L = None
        if model.predictor is not None and model.noise is not None:
            self.noise = [f"innovation of {c.name}" for c in model.outputs]
            largest = float(np.trace(model.noise)) or 1.0
            self.L = np.linalg.cholesky(model.noise + ROUNDING * largest * np.eye(len(self.noise)))
            self.K = model.predictor.K @ self.L
        steps = max(term.delay for term in model.terms) if model.schedules else 0
        # the schedule as it was one sample before, two, ..: a name for each variable
        self.earlier = [[f"{c.name} {k + 1} before" for c in model.schedules] for k in range(steps)]
        self.past = {name: c.unit for names in self.earlier for name, c in zip(names, model.schedules, strict=True)}
        self.speeds = {c.name: f"speed of {c.name}" for c in (*model.inputs, *model.outputs) if c.unit == SPEED}

    def difference(self, x: Named, u: Named, p: Named, at: Named) -> dict:
        """(x+ - x) / dt of every state."""
        del at
        model, weights = self.model, self._weights(x, u)
        now, moved, e = _of(x, self.states), self._deviations(u), _of(x, self.noise)
        after = _product(model.A, weights, now)
        after = _sum(after, _product(model.B, weights, moved))
        if self.K is not None:
            after = _sum(after, _product(self.K, weights, e))
        after += [0.0] * len(e)
        if self.past:
            after += [*self._now(u), *(value for names in self.earlier[:-1] for value in _of(x, names))]
        shown = vars(u) | self.outputs(x, p, u)
        after += [shown[place] for place in self.speeds]
        names = (*self.states, *self.noise, *self.past, *self.speeds.values())
        return {name: (new - old) / model.dt for name, new, old in zip(names, after, _of(x, names), strict=True)}

    def outputs(self, x: Named, p: Named, u: Named) -> dict:
        """y of every output."""
        del p
        model, weights, point = self.model, self._weights(x, u), self.model.operating_point
        y = _sum(_product(model.C, weights, _of(x, self.states)), _product(model.D, weights, self._deviations(u)))
        if self.L is not None:
            y = _sum(y, _product(self.L[None], [1.0], _of(x, self.noise)))
        y = _sum(y, _product(point.y[:, :, None], point.basis.functions(self._rho(self._now(u))), [1.0]))
        named = dict(zip((c.name for c in model.outputs), y, strict=True))
        return named | {name: np.abs(named[name]) for name in self.unsigned}

    def _now(self, u: Named) -> list:
        """The schedule variables, within what the model knows."""
        model = self.model
        ends = model.spans + model.reach * np.diff(model.spans) * [-1.0, 1.0]
        return [
            np.minimum(np.maximum(getattr(u, c.name), low), high)
            for c, (low, high) in zip(model.schedules, ends.tolist(), strict=True)
        ]

    def _rho(self, values: list):
        """The variables as a basis takes them."""
        return values if len(values) > 1 else values[0] if values else 0.0

    def _weights(self, x: Named, u: Named) -> list:
        """phi_j(rho(k - d_j)) of every term."""
        basis, line = self.model.basis, [self._now(u), *(_of(x, names) for names in self.earlier)]
        at = {d: basis.functions(self._rho(line[d])) for d in {term.delay for term in self.model.terms}}
        return [at[term.delay][term.function] for term in self.model.terms]

    def _deviations(self, u: Named) -> list:
        """u - u0(rho)."""
        point = self.model.operating_point
        zero = _product(point.u[:, :, None], point.basis.functions(self._rho(self._now(u))), [1.0])
        names = [c.name for c in self.model.inputs]
        acting = [
            bent(value, self.curves[name].bends) if name in self.curves else value
            for name, value in zip(names, _of(u, names), strict=True)
        ]
        return [a - b for a, b in zip(acting, zero, strict=True)]


def _of(named: Named, names: Sequence[str]) -> list:
    return [getattr(named, name) for name in names]


def _product(terms: np.ndarray, weights: Sequence, v: Sequence) -> list:
    """sum_j w_j M_j v for terms M (nt, rows, columns); what is 0 in all terms is not written down."""
    rows = []
    for i in range(terms.shape[1]):
        parts = []
        for k, value in enumerate(v):
            numbers = terms[:, i, k]
            if numbers.any():
                parts.append(sum(float(m) * w for m, w in zip(numbers, weights, strict=True) if m) * value)
        rows.append(sum(parts) if parts else 0.0 * v[0] if len(v) else 0.0)
    return rows


def _sum(a: Sequence, b: Sequence) -> list:
    return [p + q for p, q in zip(a, b, strict=True)]
