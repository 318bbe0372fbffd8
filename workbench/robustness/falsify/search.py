"""The worst machine within a box: the parameters and effects with which a simulated loop breaks its limits most.

    maximise  max over limits and scenarios of excess / what the bound allows,   low <= parameters, effects <= high

on the nonlinear plant itself. The excess over a bound is often monotone in most parameters, so that the box's corners come first:
the nominal machine, every number at either end by itself, for every bound the corner that these ends point to, and from the best
of them on one number at a time. What is left of the budget goes to CMA-ES, from the best point and from random ones in turn:
worst cases inside the box (a resonance that meets a disturbance) have no corner. A search proves nothing where it finds nothing.

Source: Hansen, "The CMA evolution strategy: a tutorial", arXiv:1604.00772.
"""

from collections.abc import Sequence
from itertools import cycle

import numpy as np

from workbench.physics.controller import Controller, Stepped
from workbench.physics.plant import Plant
from workbench.progress import Progress, silent
from workbench.robustness.falsify.box import Dimension
from workbench.robustness.falsify.trials import LOST, POPULATION, Trials
from workbench.robustness.falsify.worst import Worst
from workbench.robustness.limits import Limit
from workbench.simulation import Scenario

NEAR, WIDE = 0.15, 0.3  # first step of a search from the best point and from a random one, in widths of the box
ENOUGH = 1e-5  # of what a bound allows, below which a search no longer improves and the next one begins
CORNERS = 0.4  # of the budget, at most, for single numbers going from end to end


def worst_plant(
    plant: Plant,
    controller: Controller | Stepped,
    scenarios: Scenario | Sequence[Scenario],
    limits: Sequence[Limit],
    dimensions: Sequence[Dimension],
    *,
    runs: int = 1000,
    seed: int = 0,
    bumpless: bool = True,
    progress: Progress = silent,
) -> Worst:
    """The worst machine found with at most `runs` runs, the last of which confirms it; see the module.

    Every machine goes through all scenarios. The same seed gives the same answer.
    """
    trials = Trials(plant, controller, scenarios, limits, dimensions, runs, bumpless, progress)
    best = _search_corners(trials)
    _search_inside(trials, best, seed)
    return trials.confirmed()


def at_random(
    plant: Plant,
    controller: Controller | Stepped,
    scenarios: Scenario | Sequence[Scenario],
    limits: Sequence[Limit],
    dimensions: Sequence[Dimension],
    *,
    runs: int = 1000,
    seed: int = 0,
    bumpless: bool = True,
    progress: Progress = silent,
) -> Worst:
    """The same budget on machines drawn evenly from the box, the nominal one first: what a search is to be compared with."""
    trials = Trials(plant, controller, scenarios, limits, dimensions, runs, bumpless, progress)
    random = np.random.default_rng(seed)
    trials.of(trials.box.nominal[None])
    while trials.room and not trials.lost:
        trials.of(random.uniform(size=(min(trials.room, trials.together), trials.box.n)))
        if not trials.box.n:
            break
    return trials.confirmed()


def _search_corners(trials: Trials) -> np.ndarray:
    """The nominal machine, single numbers at their ends, the corners that these point to, then single numbers from there on."""
    c, n = trials.box.nominal, trials.box.n
    first = trials.of(c[None])
    ends = np.repeat(c[None], 2 * n, axis=0)
    ends[np.arange(n), np.arange(n)], ends[n + np.arange(n), np.arange(n)] = 0.0, 1.0
    found = trials.of(ends)
    machines, scores = [c, *ends], [first.score[0], *found.score]
    low, high = found.shares[:n], found.shares[n:]  # (n, K)
    towards = np.where(high >= low, 1.0, 0.0).T
    # a number that is worst where it is nominal stays there, in one more candidate of each bound
    staying = np.where(np.maximum(low, high) > first.shares, towards.T, c[:, None]).T
    there = np.isfinite(first.shares[0])
    candidates = np.vstack([towards[there], staying[there]]) if n else np.empty((0, 0))
    machines += list(candidates)
    scores += list(trials.of(candidates).score)
    best = machines[int(np.argmax(scores))]
    until = trials.budget * (1.0 - CORNERS)
    while n and trials.room > until and not trials.lost:
        others = np.repeat(best[None], 2 * n, axis=0)
        others[np.arange(n), np.arange(n)], others[n + np.arange(n), np.arange(n)] = 0.0, 1.0
        here, tried = trials.of(best[None]).score[0], trials.of(others).score
        better = np.flatnonzero(tried > here)
        if not len(better):
            break
        together = best.copy()
        for j in better[np.argsort(tried[better])]:  # of both ends of a number the better one counts
            together[j % n] = others[j, j % n]
        single = others[int(np.argmax(tried))]
        best = together if trials.of(together[None]).score[0] > np.max(tried) else single
    return best


def _search_inside(trials: Trials, best: np.ndarray, seed: int) -> None:
    """CMA-ES from the best point and from random ones, in turn, until the budget is used up."""
    n, random = trials.box.n, np.random.default_rng(seed)
    if not n:
        return
    idle = 0
    for near in cycle((True, False)):
        if trials.room < 1 or trials.lost or idle > 4:
            return
        before = trials.room
        best = trials.worst[0] if trials.worst is not None else best
        start = best if near else random.uniform(size=n)
        _evolve(trials, start, NEAR if near else WIDE, random)
        idle = idle + 1 if trials.room == before else 0


def _evolve(trials: Trials, start: np.ndarray, sigma: float, random: np.random.Generator) -> None:
    """One run of CMA-ES in the unit cube; what steps out of it is taken back to its faces, where many worst machines are.

    The step out costs its squared length times the spread of the generation: enough to come back, whatever the unit.
    """
    from cma.evolution_strategy import CMAEvolutionStrategy  # a second to import, and only a search needs it

    n = len(start)
    options = {
        "popsize": POPULATION, "tolx": 1e-4, "tolfun": ENOUGH, "tolfunhist": ENOUGH, "seed": np.nan,
        "randn": lambda *size: random.standard_normal(size),
        # it neither prints nor writes, and takes no options from a file that lies about
        "verbose": -10, "verb_disp": 0, "verb_log": 0, "signals_filename": "",
    }  # fmt: skip
    # it knows no search in one dimension: a second one is added that changes nothing
    strategy = CMAEvolutionStrategy(np.append(start, [0.5] * (n == 1)), sigma, options)
    while trials.room and not trials.lost and not strategy.stop():
        before, points = trials.room, strategy.ask()
        inside = np.clip(points, 0.0, 1.0)
        scores = trials.of(np.ascontiguousarray(inside[:, :n])).score
        if trials.room == before or not trials.room:
            return  # all known: it stands in a corner
        run = np.isfinite(scores)
        out = np.sum((np.array(points) - inside) ** 2, axis=1) * (np.ptp(scores[run]) if run.any() else 0.0)
        # a machine that cannot be run is as good as none: below all others, but finite
        strategy.tell(points, np.where(run, out - scores, LOST).tolist())
