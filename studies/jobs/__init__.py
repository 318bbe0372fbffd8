"""What a sweep can run, by the name that its file gives.

closed-loop     a plant under a controller through a run
pid-design      records of a machine, a model, a scheduled PID, and a run of the machine under it
identification  records of a machine, a model, and its scores on other records
detection       records of a machine in which an effect is hidden, and their diagnosis
"""

from argparse import Namespace
from collections.abc import Callable
from pathlib import Path

from studies.jobs import closed_loop, detection, identification, pid_design
from workbench.sweeps.design import Sweep
from workbench.sweeps.job import Job

JOBS: dict[str, Callable[[Sweep, Path, Namespace], Job]] = {
    "closed-loop": closed_loop.from_file,
    "pid-design": pid_design.from_file,
    "identification": identification.from_file,
    "detection": detection.from_file,
}
