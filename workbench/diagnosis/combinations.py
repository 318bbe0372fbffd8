"""One cause or two: does a general law explain these records as well as its special case beside another effect?

Asymmetric friction is Coulomb friction and a constant force; where an input is a force, its offset is that force. Then
"asymmetric-friction@x" and "coulomb@x + offset@u" are one and the same, and no record tells them apart.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import permutations

import numpy as np

from workbench.diagnosis.confirm import left_out, stability
from workbench.diagnosis.policy import ALPHA, TIE
from workbench.diagnosis.refit import Model, from_special, refits, settled, shortlist
from workbench.diagnosis.rivals import gap_between, is_case_of
from workbench.diagnosis.screen import Score
from workbench.diagnosis.search import Lesser, Step, pruned, screen_effects


def united(base: Model, steps: Sequence[Step], lesser: Lesser) -> list[Step]:
    """Steps of which no two are one general law: that stands in their place, and they are its rival together."""
    steps = list(steps)
    while len(steps) > 1:
        found = [step for one, other in permutations(steps, 2) for step in _as_one(steps[-1].after, one, other, lesser)]
        if not found:
            break
        best = min(found, key=lambda step: step.after.bic)
        rest = [replace(s, after=best.after) for s in steps if s.key in best.after.keys]
        steps = pruned(base, [*rest, best], lesser)
    return steps


def _as_one(model: Model, one: Step, other: Step, lesser: Lesser) -> Iterable[Step]:
    """Steps in which a law that `one` is a special case of stands for both, where it explains the records as well."""
    plant, sizes = model.predictor.plant, lesser.sizes
    general = [key for key in plant.effect_keys if is_case_of(plant, one.key, key) and key not in model.keys]
    if not general:
        return
    special = lesser.of(model, other.key)
    rest = lesser.of(special, one.key)
    for score in screen_effects(rest, general, sizes) if rest.sound else ():
        begun = [refits(rest, [score], sizes)[0][0]]
        if special.sound and special.keys[-1] == one.key:
            begun.append(from_special(special, rest, score, sizes))
        single = settled(min(begun, key=lambda m: m.bic), sizes, model)
        gap = single.bic - model.bic
        if single.sound and gap < TIE and left_out(rest, single).holds:
            yield Step(
                score.key,
                rest,
                single,
                replace(score, p_family=min(score.p_family, one.score.p_family)),
                {one.key: gap_between(rest, single, score.key, special, one.key)},
                rest.bic - single.bic,
                stability(single, score.key),
                pairs={_together(one.key, other.key): -gap},
            )


def divided(step: Step, lesser: Lesser) -> dict[str, float]:
    """BIC by which two effects are worse than the law of `step`, of which one is a special case: of those that tie with it."""
    model, sizes = step.after, lesser.sizes
    plant, found = model.predictor.plant, {}
    cases = [key for key in plant.effect_keys if is_case_of(plant, key, step.key)]
    if not cases or not (less := lesser.of(model, step.key)).sound:
        return {}
    for special in cases:
        for begun, _ in _extended(less, screen_effects(less, [special], sizes), sizes, 1):
            plain = settled(begun, sizes, model)
            if not plain.sound or plain.bic < model.bic + TIE:  # the special case ties by itself
                continue
            others = [k for k in plant.effect_keys if k not in plain.keys and not is_case_of(plant, special, k)]
            shown = [s for s in screen_effects(plain, others, sizes) if s.p_family < ALPHA]
            for trial, key in _extended(plain, shortlist(shown, most=3) if shown else [], sizes, 2):
                both = settled(trial, sizes, model)
                gap = both.bic - model.bic
                if both.sound and gap < TIE and left_out(less, both).holds:
                    found[_together(special, key)] = gap
    return found


def _extended(model: Model, found: Sequence[Score], sizes: np.ndarray, most: int) -> list[tuple[Model, str]]:
    """The model with each of the effects, the best `most` of them first."""
    return [(m, s.key) for m, s in refits(model, found, sizes)[:most]] if found else []


def _together(*keys: str) -> str:
    """How effects that act together are called."""
    return " + ".join(keys)
