"""Diagnosis: what a simulation gets wrong about measured records, its cause, its size, and what naming it gains.

recalibrate -> screen -> refit -> confirm -> extend, again while something is found -> drop and swap -> remainder -> answer
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from workbench.data import Dataset
from workbench.diagnosis.answer import Diagnosis, Finding
from workbench.diagnosis.beginnings import LOOKED_AT, SEARCHED, beginnings, taken, tells_more
from workbench.diagnosis.causes import (
    cause_of,
    doubted,
    exchanges,
    harm_of,
    instead_of_parameters,
    laws_instead,
    limits_of,
    next_experiment,
    not_dry,
    only_together,
    remainder_said,
    rounded_cause,
    rounding_limits,
    untestable_effects,
)
from workbench.diagnosis.check.records import check
from workbench.diagnosis.combinations import divided
from workbench.diagnosis.courses import followed, told
from workbench.diagnosis.equations import Law
from workbench.diagnosis.experiments import Template
from workbench.diagnosis.findings import Found, forgiven, judged, searched, tells, with_free_runs, with_rounding
from workbench.diagnosis.fit import gauss_newton
from workbench.diagnosis.free_run import filtered
from workbench.diagnosis.policy import ALPHA, HELPFUL, LONG_RUN, MATTERS_ALONE, TIE
from workbench.diagnosis.predictor import predictor
from workbench.diagnosis.recalibrate import recalibrated
from workbench.diagnosis.referee import Judge, as_given, improved
from workbench.diagnosis.refit import Model, lasting, settled, with_coloured_noise
from workbench.diagnosis.rounding import rounded
from workbench.diagnosis.screen import similarity
from workbench.diagnosis.sizes import beyond_tolerance, effects_of, parameters_of
from workbench.physics.plant import Plant


def diagnose(
    plant: Plant,
    dataset: Dataset,
    held_out: Dataset | None = None,
    *,
    templates: Sequence[Template] = (),
    drift: bool = True,
    threads: int = 1,
    anyway: bool = False,
    progress: Callable[[str], None] = lambda _: None,
) -> Diagnosis:
    """What `plant` lacks to explain the records of `dataset`; gains are of `held_out`; where there is none, of parts of
    `dataset`, each left out of the fit in turn.

    templates: experiments that the machine could run, among which the one is sought that would tell causes apart which tie.
    drift: whether torques that nobody logged may come and go as noise. Such a noise may take in what changes at reversals only,
    friction and offset: where it leaves something that no effect explains, the search is made again without it, and counts if
    what it names helps a second ahead. Parameters and sizes are those of the likelihood or of the free run, whichever errs less
    a second and the full run ahead. Inputs that were measured while they moved are told from held ones, see `courses`. Of long
    records the beginnings are searched, and more of them where these do not tell all; see `beginnings`. Raises InputError for
    records that cannot be of this plant, unless the user takes them `anyway`; see `check`.
    """
    began = time.perf_counter()
    notes = [str(note) for note in check(plant, dataset, anyway=anyway)]
    part, more = beginnings(plant, dataset, SEARCHED), beginnings(plant, dataset, LOOKED_AT)
    unseen = beginnings(plant, held_out, SEARCHED) if held_out else None
    made, found = _diagnosed(plant, part, unseen, templates, drift, threads, progress)
    if more is not part and made.finding in (Finding.NAMED, Finding.NOTHING):
        progress("looking at what follows")
        if tells_more(found.model, found.lesser.sizes, more):
            progress("again, in more of the records")
            part = more
            made, _ = _diagnosed(plant, part, unseen, templates, drift, threads, progress)
    notes += taken("searched in", part, dataset)
    notes += [f"{said}: nothing is said of what follows" for said in taken("looked at", more, dataset)]
    notes += taken("gains are those of", unseen, held_out) if unseen and held_out else []
    return replace(made, notes=(*notes, *made.notes), seconds=time.perf_counter() - began)


def _diagnosed(
    plant: Plant,
    dataset: Dataset,
    held_out: Dataset | None,
    templates: Sequence[Template],
    drift: bool,
    threads: int,
    progress: Callable[[str], None],
) -> tuple[Diagnosis, Found]:
    """The diagnosis of records as they are, and what was found before it was fitted to free runs."""
    notes, judge = [], Judge(held_out or dataset, held_out is not None)
    progress("recalibrating")
    given = as_given(plant, dataset, drift=drift, threads=threads)
    base = _as_coloured(lasting(_no_worse(given, _recalibrated(plant, dataset, drift, threads)), plant.name))
    found, between = _sought(base, judge, drift, progress), dict[str, str]()
    if other := _with_courses(base, found, judge, drift, progress):
        between = {n: course for n, course in other.base.predictor.plant.between.items() if n not in plant.between}
        less = found.model.bic - other.model.bic
        notes.append(f"{told(between)} between samples: a hold is less likely, by {less:.0f} in BIC")
        found, plant = other, plant.with_courses(between)
    torques = len(base.predictor.noise.drift) > 0  # a plant without shafts has none that come and go
    if torques and (found.finding in (Finding.UNKNOWN, Finding.INCOMPLETE) or forgiven(judge, found)):
        progress("again, without torques that come and go")
        if again := _without_torques(plant, dataset, found, judge, threads, progress):
            found = again
            notes.append(
                "unlogged torques that come and go were not allowed as noise: they would have taken in what is named here"
            )
    found = replace(found, steps=tuple(replace(s, pairs={**divided(s, found.lesser), **s.pairs}) for s in found.steps))
    following = next_experiment(found.steps, templates)
    progress("free runs")
    together, likeliest = only_together(found.base, found.steps), found
    laws = laws_instead(found.steps, found.model)  # free runs have gains in another unit
    if len(found.base.predictor.noise.drift) < len(given.predictor.noise.drift):  # such a filter errs less, whatever the plant
        given = as_given(given.predictor.plant, dataset, drift=False, threads=threads)
    if len(found.base.predictor.noise.coloured):
        coloured = with_coloured_noise(given, np.zeros(len(plant.slots)))
        given = coloured if coloured.sound else given
    found = with_free_runs(found, given, judge)
    progress("gains on held-out records")
    made = _answered(plant, found, given, judge, laws, together and len(found.steps) > 1)
    return replace(made, next_experiment=following, notes=(*notes, *made.notes), between=between), likeliest


def _sought(base: Model, judge: Judge, drift: bool, progress: Callable[[str], None]) -> Found:
    """What is found beside a recalibrated model; without torques that come and go it must help a second ahead."""
    return judged(searched(base, np.inf if drift else 1.0 - HELPFUL, progress), judge, longer=not drift)


def _with_courses(base: Model, found: Found, judge: Judge, drift: bool, progress: Callable[[str], None]) -> Found | None:
    """What is found where inputs go on between their samples, if it is likelier in the end than what was found with held ones.

    A cause that only makes up for a hold is worth nothing beside the course: where none is likelier there, none is sought.
    """
    moving = followed(base, found.lesser.sizes)
    if moving is None or (found.model is not base and followed(found.model, found.lesser.sizes) is None):
        return None
    progress("again, with inputs that go on between their samples")
    other = _sought(moving, judge, drift, progress)
    return other if other.model.bic < found.model.bic - TIE else None


def _without_torques(
    plant: Plant, dataset: Dataset, found: Found, judge: Judge, threads: int, progress: Callable[[str], None]
) -> Found | None:
    """What is found where torques that nobody logged are no noise, if it names what helps a second ahead."""
    bare = _as_coloured(_recalibrated(plant, dataset, False, threads))
    again = _sought(bare, judge, False, progress) if bare.sound else None
    if again and again.steps and not tells(found.local, again) and judge.longer(found.model, again.model) < 1.0 - LONG_RUN:
        return replace(again, local=again.local or found.local)
    return None


def _answered(plant: Plant, found: Found, given: Model, judge: Judge, laws: Mapping[str, Law], together: bool) -> Diagnosis:
    """What was found, as an answer: causes with their doubts, sizes and limits; given: the plant as it came.

    laws, together: see `doubted`.
    """
    base, model, steps, tested = found.base, found.model, found.steps, found.tested
    objections = judge.objections("extended" if steps else "recalibrated", given, model)
    kept = () if steps else _against_bent_parameters(given, model, judge, objections)
    rounds = tuple(rounded_cause(plant, r) for r in rounded(filtered(model).predictor))
    whole = sum(float(np.sum(e**2)) for e in base.fit.errors)
    beyond = beyond_tolerance(base, model)
    harm = {s.key: harm_of(judge, s) for s in steps}
    model = model.sharpened()
    said = with_rounding(found, [c.place for c in rounds])
    finding, doubts = doubted(found, said, laws, harm, beyond, objections, together, not_dry(steps))
    causes = tuple(replace(cause_of(plant, s, model, judge.gained(s.before, s.after)), doubt=doubts[s.key]) for s in steps)
    return Diagnosis(
        plant=plant.name,
        finding=finding,
        causes=(*causes, *rounds),
        recalibrated=parameters_of(model),
        untestable=untestable_effects(base, tested),
        limits=(*limits_of(plant, tested), *rounding_limits(base)),
        remainder=tuple(remainder_said(x, whole) for x in found.left[:5] if x.p_family < ALPHA),
        next_experiment=None,
        effects={**effects_of(model), **{c.key: {name: e.value for name, e in c.parameters.items()} for c in rounds}},
        parameters={q.name: q.value if kept else float(v) for q, v in zip(plant.parameters, model.fit.point.p, strict=True)},
        tested=tuple(s.variant.key for s in tested),
        similarity=similarity(tested),
        notes=(
            *([str(found.local)] if found.local else []),
            *([str(found.unresolved)] if found.unresolved and found.finding in (Finding.UNKNOWN, Finding.INCOMPLETE) else []),
            *map(str, found.refused),
            *exchanges(steps),
            *instead_of_parameters(steps),
            *(f"the plant keeps its own parameters: {reason}" for reason in kept),
        ),
        signs=beyond,
        compared=judge.compared(base),
        objections=() if kept else objections,
    )


def _against_bent_parameters(given: Model, model: Model, judge: Judge, objections: Sequence[str]) -> Sequence[str]:
    """Why parameters stay as they came where nothing is named: others are worse somewhere, or better nowhere."""
    if not objections and not improved(judge.between(given, model), MATTERS_ALONE):
        return (f"with others it errs less by {MATTERS_ALONE:.1%} at no horizon {judge.where}, beyond noise",)
    return objections


def _recalibrated(plant: Plant, dataset: Dataset, drift: bool, threads: int) -> Model:
    made = recalibrated(predictor(plant, dataset, drift=drift, threads=threads), rounds=1)
    return settled(Model(made.predictor, made.fit), np.zeros(len(plant.slots)))


def _no_worse(given: Model, base: Model) -> Model:
    """The recalibrated model; begun again from the plant as it came where it is less likely: its noise levels sit elsewhere."""
    if base.posterior <= given.posterior:
        return base
    own, nothing = base.fit.unknowns, np.zeros(len(base.predictor.plant.slots))
    z = own.vector(given.fit.point, [])
    again = settled(Model(given.predictor, gauss_newton(given.predictor, own, z, nothing)), nothing)
    return min((base, again), key=lambda m: m.posterior)


def _as_coloured(base: Model) -> Model:
    """The model with a coloured part in the noise of its sensors, if these records have one; else as it is.

    Without it, what a sensor's noise was a sample ago looks like something that the machine lacks: under feedback above all,
    where the inputs carry it.
    """
    tried = with_coloured_noise(base, np.zeros(len(base.predictor.plant.slots))) if base.sound else base
    more = (np.sum(base.predictor.measured) + 1) * np.log(sum(map(len, base.predictor.records)))
    return tried if tried.sound and tried.deviance + more < base.deviance else base
