"""The pictures of a report: data in, `Picture` out. The only matplotlib in the library, and of it only the object interface.

Pictures are drawn in the light colours of the palette on a transparent ground. The settings of whoever calls stay out, so
the same data give the same bytes everywhere.
"""

from workbench.report.figures.canvas import BEYOND, PIXELS, WIDTH, Trace
from workbench.report.figures.identification import order_sweep, singular_values, sparsity_path
from workbench.report.figures.scheduling import Coefficient, coefficient_functions, frozen_responses
from workbench.report.figures.scores import score_dots
from workbench.report.figures.simulation import measured_and_simulated

__all__ = [
    "BEYOND",
    "PIXELS",
    "WIDTH",
    "Coefficient",
    "Trace",
    "coefficient_functions",
    "frozen_responses",
    "measured_and_simulated",
    "order_sweep",
    "score_dots",
    "singular_values",
    "sparsity_path",
]
