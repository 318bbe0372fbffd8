"""Gain-scheduling control design from measured records: the public list."""

# ruff: noqa: E402
import os
import sys

# Two BLAS threads on shared cores made small factorisations up to 600 times slower; one is the default, not a law.
for _name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
if "numpy" in sys.modules:  # too late for the environment
    from threadpoolctl import threadpool_limits

    threadpool_limits(limits=1, user_api="blas")

from workbench.advice import advice, feedback
from workbench.data import Channel, Dataset, Experiment, segments
from workbench.errors import InputError
from workbench.identify import METHODS
from workbench.identify.ilm import ILM
from workbench.identify.lti import LTI
from workbench.identify.ssm import SSM
from workbench.identify.subspace import N4SID, PBSID
from workbench.intervals.coverage import cover
from workbench.intervals.model import IntervalModel, load_interval_model
from workbench.intervals.output_error import OutputErrorRegression
from workbench.intervals.regression import BySchedule, IntervalRegression, InTime
from workbench.intervals.regressors import ARX, FIR
from workbench.intervals.semantics import InclusionAll, InclusionExact, InclusionPaper, Overlap
from workbench.lpv import Gaussian, LPVModel, PiecewiseLinear, Powers, load_model
from workbench.metrics import fit, noise_ceiling, rm, rmse, score
from workbench.physics.controller import Controller, Playback, Stepped
from workbench.physics.effects import EFFECTS
from workbench.physics.effects.effect import Domain, Effect, EffectParameter, GridUnit
from workbench.physics.effects.pulley import Pulley
from workbench.physics.effects.reel import Reel
from workbench.physics.effects.robot import Robot
from workbench.physics.effects.shaft import Shaft, Slide
from workbench.physics.effects.span import Span
from workbench.physics.effects.winding import Winding
from workbench.physics.plant import Parameter, Plant, Start
from workbench.readers import check_units, read_file, write_csv
from workbench.residuals import residual_test
from workbench.simulate import Run, Scenario, replay, simulate, simulate_batch
from workbench.sources import read
from workbench.sweep import load_sweep, read_rows, run_sweep
from workbench.version import __version__

__all__ = [
    "ARX", "EFFECTS", "FIR", "ILM", "LTI", "METHODS", "N4SID", "PBSID", "SSM", "BySchedule", "Channel", "Controller",
    "Dataset", "Domain", "Effect", "EffectParameter", "Experiment", "Gaussian", "GridUnit", "InTime", "InclusionAll",
    "InclusionExact", "InclusionPaper", "InputError", "IntervalModel", "IntervalRegression", "LPVModel",
    "OutputErrorRegression", "Overlap", "Parameter", "PiecewiseLinear", "Plant", "Playback", "Powers", "Pulley", "Reel",
    "Robot", "Run", "Scenario", "Shaft", "Slide", "Span", "Start", "Stepped", "Winding", "__version__", "advice", "check_units",
    "cover", "feedback", "fit", "load_interval_model", "load_model", "load_sweep", "noise_ceiling", "read", "read_file",
    "read_rows", "replay", "residual_test", "rm", "rmse", "run_sweep", "score", "segments", "simulate", "simulate_batch",
    "write_csv",
]  # fmt: skip
