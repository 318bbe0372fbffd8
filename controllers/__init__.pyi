# The public list of `controllers`: every name and the module that it comes from, loaded when it is first used.

from .autotune import Autotuned as Autotuned
from .autotune import autotune as autotune
from .compensation import compensated as compensated
from .decided import decided as decided
from .designs import MPCDesign as MPCDesign
from .designs import ScheduledPIDDesign as ScheduledPIDDesign
from .files import load_controller as load_controller
from .files import save_controller as save_controller
from .mpc import MPC as MPC
from .nmpc import NMPC as NMPC
from .pid_design import PIDDesign as PIDDesign
from .scheduled_pid import ScheduledPID as ScheduledPID
