"""The model of the chosen candidate: its realisation with intervals and notes."""

from dataclasses import replace

import numpy as np

from workbench.identification.ssm.realisation import realised
from workbench.identification.ssm.regression import Problem
from workbench.identification.ssm.sweep import Candidate
from workbench.identification.ssm.uncertainty import uncertainty
from workbench.lpv import LPVModel
from workbench.quasi_lpv import coupling_notes


def observer_form(problem: Problem, best: Candidate) -> LPVModel:
    """The model of a candidate, with intervals and notes."""
    estimates, noise = uncertainty(problem, best)
    model = replace(realised(problem, best.theta, best.order), noise=noise, estimates=estimates)
    return replace(model, notes=_notes(model, best))


def _notes(model: LPVModel, best: Candidate) -> tuple[str, ...]:
    notes = _frozen_notes(model) if model.scheduled_output is None else coupling_notes(model)
    if not np.isfinite(best.fit) or best.fit < 50:
        notes = (*notes, f"the free run on the estimation records has FIT {best.fit:.0f} %: do not simulate with it")
    return notes


def _frozen_notes(model: LPVModel) -> tuple[str, ...]:
    stability = model.stability()
    if stability.stable:
        return ()
    place = f" at {model.named(stability.at)}" if model.schedules else ""
    return (f"unstable: the frozen model has spectral radius {stability.radius:.4f}{place}",)
