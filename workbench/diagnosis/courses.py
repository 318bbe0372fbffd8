"""What the inputs of a record do between its samples: held, or going on by a straight line or a spline.

A command that an amplifier holds is held. A current or an angle that was measured while it moved is not: a hold is half a sample
late, which looks like a dead time that is negative, or like whatever else the plant has to offer. No number is fitted for it, so
the likelihood decides, on what was left out too.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from workbench.diagnosis.confirm import left_out
from workbench.diagnosis.fit import Unknowns, gauss_newton
from workbench.diagnosis.policy import WORTH
from workbench.diagnosis.predictor import Predictor
from workbench.diagnosis.refit import Model, settled
from workbench.physics.plant import COURSES, HELD

STANDS = 0.3  # share of the samples in which an input stands from which on it is held


def told(between: Mapping[str, str]) -> str:
    """ "F goes on as a spline, i as a straight line"."""
    words = {"linear": "a straight line", "spline": "a spline"}
    return " and ".join(f"{name} goes on as {words[course]}" for name, course in between.items())


def followed(base: Model, sizes: np.ndarray) -> Model | None:
    """The model with each input, one after the other, taken to go on between its samples as the records show most clearly; None
    where none does.

    sizes (ne): small sizes of the effects that the model has. Something else that is missing may ask for an early input too: with
    what is found beside them, held inputs must be less likely in the end. An input that the plant says something about
    (`Plant.between`), that stands in many samples, or whose course makes no difference, stays as it is.
    """
    best = base
    for name in (name for name in _moving(base) if _early(base, name, sizes)):
        tried = [settled(own, sizes) for course in COURSES if course != HELD and (own := _with(best, name, course, sizes))]
        tried = [own for own in tried if own.sound and own.deviance < best.deviance - WORTH and left_out(best, own).holds]
        best = min((best, *tried), key=lambda model: model.deviance)
    return None if best is base else best


def _moving(model: Model) -> list[str]:
    """Inputs of which it is not said what they do between samples, and which move in most of them."""
    plant, records = model.predictor.plant, model.predictor.records
    if plant.discrete:
        return []
    steps = np.concatenate([np.diff(r.u, axis=0) for r in records])
    stands = np.mean(steps == 0.0, axis=0)
    return [name for name, share in zip(plant.input_names, stands, strict=True) if share < STANDS and name not in plant.between]


def _early(model: Model, name: str, sizes: np.ndarray) -> bool:
    """Whether an input that is held at its mean over each sample, half a sample early, explains the records better.

    For most machines nothing else need be compiled.
    """
    predictor, i = model.predictor, model.predictor.plant.input_names.index(name)

    def halfway(u: np.ndarray) -> np.ndarray:
        moved = u.copy()
        moved[:-1, i] = 0.5 * (u[:-1, i] + u[1:, i])
        return moved

    records = tuple(replace(r, u=halfway(r.u)) for r in predictor.records)
    return _refitted(model, replace(predictor, records=records), model.fit.unknowns, sizes) is not None


def _with(model: Model, name: str, course: str, sizes: np.ndarray) -> Model | None:
    """The model with another course of an input; None where that is no better."""
    plant = model.predictor.plant.with_courses({name: course})
    return _refitted(model, replace(model.predictor, plant=plant), replace(model.fit.unknowns, plant=plant), sizes)


def _refitted(model: Model, predictor: Predictor, unknowns: Unknowns, sizes: np.ndarray) -> Model | None:
    """The model fitted with another predictor at its own noise levels; None where that is no better."""
    found = Model(predictor, gauss_newton(predictor, unknowns, model.fit.z, sizes, rounds=2, chords=4, enough=0.5))
    return found if found.deviance < model.deviance - WORTH else None
