"""Sweeps: one question asked of many sets of values, each answer a row in a file as soon as it is there.

A sweep is a table of points: every set of parameter values, once for each seed. `Sweep.points` is the same list whenever it is
asked, and a run's number is its place in it: what a process that was killed has left undone is what has no row yet.
"""

from workbench.sweeps.design import load_sweep
from workbench.sweeps.rows import read_rows
from workbench.sweeps.run import run_sweep

__all__ = ["load_sweep", "read_rows", "run_sweep"]
