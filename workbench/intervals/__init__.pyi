# The public list of `workbench.intervals`: every name and the module that it comes from, loaded when it is first used.

from .coverage import cover as cover
from .model import IntervalModel as IntervalModel
from .model import load_interval_model as load_interval_model
from .output_error import OutputErrorRegression as OutputErrorRegression
from .regression import BySchedule as BySchedule
from .regression import IntervalRegression as IntervalRegression
from .regression import InTime as InTime
from .regressors import ARX as ARX
from .regressors import FIR as FIR
