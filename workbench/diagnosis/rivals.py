"""Rivals of a cause: which other effects these records cannot tell from it."""

from collections.abc import Sequence

import numpy as np

from workbench.diagnosis.confirm import by_block, left_out
from workbench.diagnosis.policy import ASKED_FOR, FAR_APART, IDEAL, INSIDE, KNOWN, RETURNED, SCATTER, TIE, UNSEEN
from workbench.diagnosis.refit import Model
from workbench.diagnosis.screen import Score
from workbench.physics.effects.effect import Domain
from workbench.physics.plant import Plant
from workbench.records import record


@record
class Rival:
    """A model in which another effect stands in the place of a cause."""

    key: str
    model: Model


def best_first(tried: Sequence[tuple[Model, Score]]) -> list[tuple[Model, Score]]:
    """Models with the effects of scores by BIC, of each effect the best."""
    best = {s.key: (m, s) for m, s in sorted(tried, key=lambda pair: -pair[0].bic)}
    return sorted(best.values(), key=lambda pair: pair[0].bic)


def reach(plant: Plant, key: str, rival: str, gain: float) -> float:
    """BIC within which a rival ties with a cause of this gain; between two forms of one friction a share of the gain."""
    one, other = (next(slot for slot in plant.slots if slot.key == k) for k in (key, rival))
    forms = one.place == other.place and {one.effect.domain, other.effect.domain} <= {Domain.SPEED, Domain.LOAD}
    # between a law and a special case of it there is no question of form
    exact = not forms or is_case_of(plant, key, rival) or is_case_of(plant, rival, key)
    return TIE if exact else max(TIE, IDEAL * gain)


def rivals_of(before: Model, named: Model, key: str, tried: Sequence[tuple[Model, Score]]) -> list[tuple[Model, Score]]:
    """Those of the models that may be the truth as well: what left-out records speak against by a hair is among them."""
    found = []
    for m, s in tried:
        if s.key == key or _only_more(named, key, m, s.key):
            continue
        elsewhere = left_out(before, m)
        near = returns(before, m) and not elsewhere.loses
        if elsewhere.holds or (m.bic - named.bic > -TIE and (near or elsewhere.total > -2.0 * elsewhere.error)):
            found.append((m, s))
    return sorted(found, key=lambda pair: pair[0].bic)


def returns(before: Model, after: Model) -> bool:
    """Whether an effect takes the place of a parameter that had left its tolerance by far.

    Where both explain the same, an offset and a temperature of the room, no record tells them apart: the data sheet does.
    """
    return before.beyond - after.beyond > RETURNED and after.beyond < INSIDE


def close_rivals(before: Model, named: Model, key: str, tying: Sequence[tuple[Model, Score]]) -> tuple[Rival, ...]:
    """The rivals that tie, the best first."""
    plant, gain = before.predictor.plant, before.bic - named.bic
    return tuple(Rival(s.key, m) for m, s in tying if gap_between(before, named, key, m, s.key) < reach(plant, key, s.key, gain))


def gap_between(before: Model, named: Model, key: str, other: Model, other_key: str) -> float:
    """BIC by which a rival is worse; one that includes the named cause cannot be worse than by its further numbers.

    Only numbers that the records tell are counted: that nothing ran backwards is no evidence against a friction of its own there.
    Of laws of which none includes the other the gap counts in the scatter that it has from block to block, where that is larger
    than the reach of a tie: sensors whose noise has a colour overstate every gap.
    """
    plant = named.predictor.plant
    samples = sum(len(r) for r in named.predictor.records)
    more = (_seen(other, other_key) - _seen(named, key)) * float(np.log(samples))
    gap = other.deviance - named.deviance + more
    if is_case_of(plant, key, other_key):
        return min(gap, max(more, 0.0))
    within = reach(plant, key, other_key, before.bic - named.bic)
    if within < gap < FAR_APART * TIE and not is_case_of(plant, other_key, key):
        gap *= within / max(within, scatter(by_block(other, named)))
    return gap


def scatter(differences: np.ndarray) -> float:
    """The gap below which deviances of two models that differ by these in blocks (n) do not tell which is the better one.

    SCATTER sqrt(n) times their standard deviation: Q. H. Vuong, "Likelihood ratio tests for model selection and non-nested
    hypotheses", 1989. Where all is as one of the models says, a gap g has the standard deviation 2 sqrt(g), and g = TIE is told.
    """
    return SCATTER * float(np.sqrt(len(differences)) * np.std(differences, ddof=1)) if len(differences) > 1 else 0.0


def _seen(model: Model, key: str) -> int:
    """How many numbers of an effect the records tell from none, or from what was believed before."""
    sizes, deviation = _numbers(model, key)
    scale = np.where(np.arange(len(deviation)) < len(sizes), float(np.abs(sizes).max()), 1.0)
    return int(np.sum(deviation < UNSEEN * scale))


def is_case_of(plant: Plant, key: str, other_key: str) -> bool:
    """Whether an effect is a special case of another one at its place."""
    slots = {slot.key: slot for slot in plant.slots}
    own, other = slots[key], slots[other_key]
    return own.place == other.place and own.effect.id in other.effect.includes


def _only_more(named: Model, key: str, other: Model, other_key: str) -> bool:
    """Whether a rival is the named cause with numbers more that the records know and do not ask for: the same, no other cause."""
    if not is_case_of(named.predictor.plant, key, other_key):
        return False
    (size, _), (sizes, deviation) = _numbers(named, key), _numbers(other, other_key)
    known = bool(
        np.all(deviation[: len(sizes)] < KNOWN * np.abs(size).max())
    )  # friction of a direction in which nothing moved is not
    return known and named.deviance - other.deviance < ASKED_FOR * (other.numbers - named.numbers)


def _numbers(model: Model, key: str) -> tuple[np.ndarray, np.ndarray]:
    """Sizes of an effect, and standard deviations of all its numbers: of these first, then of its fitted shapes and rotations."""
    fit = model.fit
    t, own = next((t, own) for t, own in zip(fit.unknowns.terms, fit.unknowns.places, strict=True) if t.key == key)
    return fit.z[own][: len(t.sizes)], np.sqrt(np.diag(fit.covariance)[own])
