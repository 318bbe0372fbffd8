"""The pictures of a report: data in, `Picture` out. The only matplotlib in the library, and of it only the object interface.

Pictures are drawn in the light colours of the palette on a transparent ground. The settings of whoever calls stay out, so
the same data give the same bytes everywhere.
"""

from workbench.report.figures.canvas import BEYOND, PIXELS, WIDTH, Trace
from workbench.report.figures.control import Followed, closed_loop, nyquist, over_schedule
from workbench.report.figures.diagnosis import ParameterEstimate, left_over, missing, parameters, similarity
from workbench.report.figures.envelopes import Band, Width, envelope, widths
from workbench.report.figures.identification import order_sweep, singular_values, sparsity_path
from workbench.report.figures.modes import (
    ParameterInterval,
    domains,
    modes_against_precision,
    modes_along_time,
    parameters_along_time,
)
from workbench.report.figures.rates import Rates, rates, taken_for
from workbench.report.figures.records import signals, spectra, visited
from workbench.report.figures.robustness import beside_limits, guaranteed
from workbench.report.figures.scheduling import Coefficient, coefficient_functions, frozen_responses, frozen_steps
from workbench.report.figures.scores import score_dots
from workbench.report.figures.simulation import measured_and_simulated, responses
from workbench.report.figures.sweeps import Bar, courses, parallel, scatter, surface, tornado

__all__ = [
    "BEYOND",
    "PIXELS",
    "WIDTH",
    "Band",
    "Bar",
    "Coefficient",
    "Followed",
    "ParameterEstimate",
    "ParameterInterval",
    "Rates",
    "Trace",
    "Width",
    "beside_limits",
    "closed_loop",
    "coefficient_functions",
    "courses",
    "domains",
    "envelope",
    "frozen_responses",
    "frozen_steps",
    "guaranteed",
    "left_over",
    "measured_and_simulated",
    "missing",
    "modes_against_precision",
    "modes_along_time",
    "nyquist",
    "order_sweep",
    "over_schedule",
    "parallel",
    "parameters",
    "parameters_along_time",
    "rates",
    "responses",
    "scatter",
    "score_dots",
    "signals",
    "similarity",
    "singular_values",
    "sparsity_path",
    "spectra",
    "surface",
    "taken_for",
    "tornado",
    "visited",
    "widths",
]
