"""Which interval method the options of `--model interval` ask for."""

from argparse import Namespace

from studies.arguments import numbers
from workbench.answers.envelopes import Method
from workbench.errors import InputError, check_known
from workbench.intervals.output_error import OutputErrorRegression
from workbench.intervals.regression import BySchedule, IntervalRegression, InTime, Modes, OneMode
from workbench.intervals.regressors import ARX, FIR, Structure
from workbench.intervals.semantics import SEMANTICS, InclusionAll
from workbench.intervals.splitting import MaximumRadius, MeanRadius

SIMULATION = "simulation"
PROMISES = (*SEMANTICS, SIMULATION)
DEFAULT_ORDER = 2


def interval_method(options: Namespace) -> Method:
    """The method that --model interval and its options ask for. Raises InputError where they contradict each other."""
    order = options.order or DEFAULT_ORDER
    structure: Structure = FIR(options.fir) if options.fir else ARX(order, delta=options.form != "shift")
    if options.fir and options.order:
        raise InputError("--fir and --order exclude each other", mend="--fir N is the order of a model without feedback")
    if options.fir and options.form:
        raise InputError("--form belongs to models with feedback", mend="leave out --form, or --fir")
    along_time = {"--shortest": options.shortest, "--tolerance": options.tolerance, "--maximum-radius": options.maximum_radius}
    for option, value in along_time.items():
        if value and options.precision is None:
            raise InputError(f"{option} belongs to modes along time", mend="give --precision P as well")
    promise = check_known("semantics", options.semantics or InclusionAll.name, PROMISES)
    if promise == SIMULATION:
        if options.precision is not None or options.intervals is not None:
            raise InputError(
                "simulation boxes have one mode", mend="leave out --precision and --intervals, or --semantics simulation"
            )
        if options.input_error is not None:
            raise InputError("simulation boxes take the inputs as exact", mend="leave out --e-u")
        return OutputErrorRegression(structure, options.output_error)
    errors = numbers(options.input_error, "--e-u")
    one = errors[0] if errors is not None and len(errors) == 1 else errors
    return IntervalRegression(structure, SEMANTICS[promise](), _partition(options), options.output_error, one)


def check_interval_options(options: Namespace) -> None:
    """Refuse options of interval models where none was asked for."""
    given = {
        "--fir": options.fir, "--e-y": options.output_error, "--e-u": options.input_error, "--precision": options.precision,
        "--shortest": options.shortest, "--tolerance": options.tolerance, "--intervals": options.intervals,
        "--maximum-radius": options.maximum_radius or None, "--semantics": options.semantics, "--form": options.form,
    }  # fmt: skip
    for option, value in given.items():
        if value is not None:
            raise InputError(f"{option} belongs to interval models", mend="give --model interval as well")


def _partition(options: Namespace) -> Modes:
    if options.precision is not None and options.intervals is not None:
        raise InputError("--precision and --intervals exclude each other", mend="modes along time, or by schedule")
    if options.intervals is not None:
        return BySchedule(options.intervals)
    if options.precision is None:
        return OneMode()
    criterion = MaximumRadius() if options.maximum_radius else MeanRadius()
    return InTime(options.precision, options.shortest, criterion, options.tolerance)
