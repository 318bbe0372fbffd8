"""`workbench sweep`: run a sweep, or finish one."""

from argparse import Namespace

from studies.sweeps import run as run_sweep
from studies.terminal import progress, say


def run(options: Namespace) -> int:
    return run_sweep(options, say, progress)
