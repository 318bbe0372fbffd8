"""What an LPV model may get wrong: the parameters of its one-step error that the records leave open.

    e(k) = y(k) - y(k | k - 1) = theta'z(k) + n(k),   z(k) = (y(k-1) - y0, u(k-1) - u0, ..),   |n(k)| <= bound
    box  = the smallest one around every constant theta for which that holds at all samples of all records

theta = 0 is the model as it is, so the box says how far its gains and its memory of the outputs can be off without any record
telling. At a given bound it shrinks with every further record. As an interval model of e it holds every sample: the term of
size `bound` is one more regressor, the constant 1 with the radius `bound`. An interval regression of the plant itself
(`regression`) has to cover the differences of a linear model from the machine in every sample, and its boxes are wide where the
machine is of higher order.

Set-membership identification with an unknown but bounded error: Milanese, Vicino, "Optimal estimation theory for dynamic systems
with set membership uncertainty", Automatica 27 (1991).
"""

import math
from collections.abc import Sequence

import numpy as np

from workbench.data import Channel, Dataset, Experiment, bad_stamps
from workbench.errors import InputError
from workbench.intervals.domains.shapes import Box
from workbench.intervals.model import IntervalModel, Mode, Unrefuted
from workbench.intervals.regression import spans_of
from workbench.intervals.regressors import FIR, Samples, samples
from workbench.intervals.semantics import ParameterBox
from workbench.lp import InfeasibleError, RowProgram
from workbench.lpv import LPVModel
from workbench.records import record

ERROR_OF = "error of "
FAR = 1e6  # in units in which every regressor reaches 1 and the bound is 1: beyond it nothing is known
SLACK = 1e-7  # of the bound: what a sample may miss it by while the program runs; the box is widened by it
ADDED = 20  # samples that enter the program at a time
ROUNDS = 500


@record
class ErrorRegression:
    """See the module. lags: samples of y and u that e may depend on.

    bound: largest |n| of each output, in its unit; None takes the largest one-step error of the model on the records.
    """

    lags: int = 1
    bound: Sequence[float] | None = None

    def fit(self, model: LPVModel, dataset: Dataset) -> tuple[IntervalModel, ...]:
        """An interval model of the one-step error of each output, named "error of ..".

        Raises InputError for a model without predictor, records that do not fit it, and for a bound that no theta keeps.
        """
        errors = Dataset(tuple(one_step_errors(model, e) for e in dataset))
        sources = [c.name for c in (*model.outputs, *model.inputs)]
        if self.bound is not None and len(self.bound) != len(model.outputs):
            raise InputError(f"{len(self.bound)} bounds for {len(model.outputs)} outputs", mend="one bound for each output")
        found = []
        for j, output in enumerate(model.outputs):
            S = samples(FIR(self.lags), errors, ERROR_OF + output.name, sources)
            bound = float(np.abs(S.y).max()) if self.bound is None else float(self.bound[j])
            found.append(_model(model, errors, S, open_box(S, bound), bound, output))
        return tuple(found)

    def possible(
        self, model: LPVModel, dataset: Dataset, errors: Sequence[IntervalModel], count: int = 256, seed: int = 0
    ) -> np.ndarray:
        """Parameters that no sample refutes, as shares (R, p) of the boxes: middle + share * radius, one box after the other.

        The box around all of them holds many that the records refute, its corners among them. These are the model itself, and
        combinations of the vertices of what is left of each output, drawn in from the edge by SLACK and checked sample by sample.
        """
        records = Dataset(tuple(one_step_errors(model, e) for e in dataset))
        sources, random = [c.name for c in (*model.outputs, *model.inputs)], np.random.default_rng(seed)
        shares = []
        for own in errors:
            S, box = samples(own.structure, records, own.output.name, sources), own.modes[0].box
            moving = S.form.source >= 0
            z, bound = S.z[:, moving], box.radius[~moving].max()
            theta = _vertices(z, S.y, float(bound), random)
            kept = theta[np.all(np.abs(S.y[:, None] - z @ theta.T) <= bound, axis=0)]
            share = np.zeros((len(kept), len(moving)))
            share[:, moving] = np.clip((kept - box.centre[moving]) / box.radius[moving], -1.0, 1.0)
            shares.append(share)
        if not all(map(len, shares)):
            raise InputError("no parameter of the errors is possible", file=model.name, mend="a larger bound")
        first = np.hstack([share[:1] for share in shares])
        drawn = np.hstack([share[random.integers(0, len(share), count - 1)] for share in shares])
        return np.vstack([first, drawn])


def one_step_errors(model: LPVModel, experiment: Experiment) -> Experiment:
    """Outputs and inputs as deviations from the operating point, and the error of each one-step prediction, after the warm-up."""
    if bad := next(iter(bad_stamps(experiment.t, experiment.dt)), None):
        raise InputError(f"{bad.fault} stamp at {bad.before:g} s", file=experiment.name, mend="cut the record there with trim")
    if len(experiment) <= model.warmup + 1:
        raise InputError(f"{len(experiment)} samples, the model warms up for {model.warmup}", file=experiment.name)
    u, y, *_ = model.deviations(experiment)
    e = experiment[[c.name for c in model.outputs]] - model.predict(experiment)
    channels = (
        *(Channel(c.name, c.unit, "input") for c in (*model.outputs, *model.inputs)),
        *(Channel(ERROR_OF + c.name, c.unit, "output") for c in model.outputs),
    )
    kept = slice(model.warmup, None)
    return Experiment(experiment.name, experiment.t[kept], channels, np.column_stack([y, u, e])[kept], experiment.dt)


def open_box(S: Samples, bound: float) -> ParameterBox:
    """The box of the module, for the regressors but the constant, whose radius is the bound.

    Two linear programs for each parameter, in which samples enter as they are missed. Raises InputError where no theta keeps the
    bound, and where the records leave a parameter open without end.
    """
    moving = S.form.source >= 0
    z = S.z[:, moving]
    size = np.abs(z).max(axis=0)
    if not (bound > 0.0 and math.isfinite(bound)):
        raise InputError(f"bound {bound:g}", file=S.records[0], mend="a positive number in the unit of the output")
    if not size.all():
        names = [name for name, moves in zip(S.form.names, moving, strict=True) if moves]
        raise InputError(f"{names[int(size.argmin())]} never moves in the records", mend="give records in which it does")
    axes = np.eye(z.shape[1])
    lowest, highest = (_extremes(z / size, S.y / bound, bound, sign * axes) for sign in (-1.0, 1.0))
    ends = np.array([-np.diag(lowest), np.diag(highest)])
    if np.abs(ends).max() > 0.99 * FAR:
        raise InputError("the records leave a parameter of the error open without end", mend="fewer lags, or other records")
    ends = sign_out(ends)
    low, high = -ends[0] * bound / size, ends[1] * bound / size
    centre, radius = np.zeros(len(moving)), np.full(len(moving), np.nextafter(bound, np.inf))
    centre[moving], radius[moving] = 0.5 * (low + high), 0.5 * (high - low)
    return ParameterBox(centre, radius)


def _vertices(z: np.ndarray, e: np.ndarray, bound: float, random: np.random.Generator) -> np.ndarray:
    """theta (R, p): 0, and the furthest along axes and in random directions, all of these drawn in towards their mean."""
    size = np.abs(z).max(axis=0)
    p = z.shape[1]
    directions = np.vstack([np.eye(p), -np.eye(p), random.normal(size=(4 * p, p))])
    theta = _extremes(z / size, e / bound, bound, directions) * bound / size
    middle = theta.mean(axis=0)
    return np.vstack([np.zeros(p), middle + (1.0 - 10.0 * SLACK) * (theta - middle)])


def sign_out(ends: np.ndarray) -> np.ndarray:
    """-lowest and highest theta (2 p), widened by what the programs leave unsaid."""
    return ends + SLACK * (1.0 + np.abs(ends))


def _extremes(z: np.ndarray, e: np.ndarray, bound: float, directions: np.ndarray) -> np.ndarray:
    """theta (R, p) furthest in each direction (R, p), of those that keep |e - z theta| <= 1 at all samples."""
    program, inside = RowProgram(np.zeros(z.shape[1]), -FAR, FAR), np.zeros(len(e), dtype=bool)
    found = []
    for direction in directions:
        program.change_cost(-direction)
        found.append(_furthest(program, z, e, inside, bound))
    return np.array(found)


def _furthest(program: RowProgram, z: np.ndarray, e: np.ndarray, inside: np.ndarray, bound: float) -> np.ndarray:
    """theta (p) at which the program's cost is least, with all samples kept; `inside` (K): samples that are in it."""
    for _ in range(ROUNDS):
        try:
            theta, _ = program.solve()
        except InfeasibleError:
            raise InputError(
                f"no error model keeps the bound {bound:g}", mend="a larger bound, or none: then it is the model's largest error"
            ) from None
        missed = np.abs(e - z @ theta) - 1.0
        worst = np.argsort(missed)[-ADDED:]
        worst = worst[(missed[worst] > SLACK) & ~inside[worst]]
        if not len(worst):
            return theta
        inside[worst] = True
        program.add(z[worst], e[worst] - 1.0, e[worst] + 1.0)
    raise InputError("the box of the errors was not found", mend="fewer lags, or shorter records")


def _model(model: LPVModel, errors: Dataset, S: Samples, box: ParameterBox, bound: float, output: Channel) -> IntervalModel:
    first, z = errors.experiments[0], S.z
    moving = S.form.source >= 0
    half = np.abs(z) @ box.radius
    spread = max(float(np.ptp(np.concatenate([e[ERROR_OF + output.name] for e in errors]))), 1e-300)
    mode = Mode(
        box=box, domain=Box(z[:, moving].min(axis=0), z[:, moving].max(axis=0)), spans=spans_of(S), samples=len(S),
        mean_radius=float(half.mean()), precision=math.exp(-float(half.mean()) / spread),
    )  # fmt: skip
    sources = tuple(first.channel(c.name) for c in (*model.outputs, *model.inputs))
    return IntervalModel(
        name=f"error of {model.name}", dt=model.dt, inputs=sources, output=first.channel(ERROR_OF + output.name), schedule=None,
        structure=S.structure, semantics=Unrefuted(), output_error=0.0, input_error=np.zeros(len(sources)), unit_range=spread,
        modes=(mode,), trained_on=errors.fingerprints, notes=(f"errors beyond their parameters up to {bound:.3g} {output.unit}",),
    )  # fmt: skip
