"""Score tests: what every effect of the catalogue would change in the prediction errors, beyond what parameters can mimic.

    G_i = de/deta_i,   G_i* = G_i projected off de/d(theta, x0),   statistic_i = max over shapes of |P_{G_i*} e|^2

Regular effects are differentiated at 0; for the others G is the change that a finite size of a grid makes, as one column. An
effect whose phase differs between records has columns of its own in each. The null distribution of the statistic comes from
the residual itself: signs of whole blocks are flipped (wild bootstrap), the smallest p-value of the catalogue is compared with
the smallest of each draw (Westfall and Young).
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.linalg import block_diag
from scipy.stats import gamma, gumbel_r

from workbench.diagnosis.fit import Fit
from workbench.diagnosis.normal import inverse
from workbench.diagnosis.predictor import Point, Predictor
from workbench.diagnosis.scan import Scan, pushes, scan_frequencies, scan_orders
from workbench.physics.effects.effect import PER_TURN, EffectParameter, GridUnit
from workbench.physics.effects.tank import Tank
from workbench.physics.parameters import Slot
from workbench.physics.plant import Plant
from workbench.records import field, record

WANTED = 1.0  # change of the whitened errors that a step of a difference shall make
LEAST, FARTHER, TRIALS = 1e-5, 1e4, 6  # the first step, in units of the size; factor to the next where nothing changes; how many
ROUNDED = 1e-7  # change of the whitened errors that is none
DRAWS = 300
COARSE, FINE = 3, 6  # values of a shape's grid that are screened; of a date or a period more
RAN_AWAY = 1e6  # standard deviations
FEW = 12  # blocks, below which flipping signs gives no distribution
SIGNIFICANT = 0.01  # family-wise
SHOWN = 5.0  # standard deviations at which an effect counts as shown


def is_level(key: str) -> bool:
    """Whether the size of an effect is a level that is met or not: the limit of an actuator."""
    return key.startswith("saturation@")


@record
class Variant:
    """One way to try an effect: its shapes as (slot, value), and for an irregular one its finite size (else NaN)."""

    key: str
    sizes: tuple[int, ...]
    shapes: tuple[tuple[int, float], ...]
    finite: float
    phase: bool
    tries: int = 1  # independent orders or frequencies of which this is the best


@record
class Signature:
    """What a variant changes, projected: b = G*'e and S = G*'G*, and where asked for the columns G* (rows of all records, c).

    scale (c): size that each column is per unit of. blocks (nb, c): G*'e by block of samples. weights (n, c): how the fitted
    unknowns mimic each column. checked: the limit as an effect of its size has it, infinite where it has none; NaN where nobody
    looked. See `detection`.
    """

    variant: Variant
    b: np.ndarray = field("c")
    S: np.ndarray = field("c c")
    scale: np.ndarray = field("c")
    blocks: np.ndarray = field("nb c")
    weights: np.ndarray = field("n c")
    low: np.ndarray = field("c")
    columns: np.ndarray | None = None
    checked: float = np.nan

    @property
    def is_level(self) -> bool:
        """Whether the size is a level that is met or not: it is tried as it is."""
        return is_level(self.variant.key)

    @property
    def responds(self) -> bool:
        """Whether the errors change at all beyond what the unknowns mimic."""
        return bool(np.trace(self.S) > 1e-12)

    @property
    def statistic(self) -> float:
        """Reduction of the squared error by the best admissible size."""
        return float(_reduction(self.b[None], self.S, self.low, self.variant)[0])

    @property
    def size(self) -> np.ndarray:
        """One-step estimate of the sizes (c), in their own units."""
        return -inverse(self.S) @ self.b * self.scale

    @property
    def limit(self) -> float:
        """The size that these records show with five standard deviations; of a phase, the amplitude.

        Of a limit of an actuator, this level itself where its clipping shows, else infinite.
        """
        if not np.isnan(self.checked):
            return self.checked
        if self.is_level:
            return self.variant.finite if self.S[0, 0] > SHOWN**2 else np.inf
        if self.variant.phase:  # the records share the amplitude, half of it in each of two columns
            return float(SHOWN * self.scale[0] / np.sqrt(max(np.trace(self.S) / 2.0, 1e-300)))
        return float(SHOWN * np.min(self.scale / np.sqrt(np.maximum(np.diag(self.S), 1e-300))))


@record
class Score:
    """An effect's best variant, its statistic, and p-values: of its own, and family-wise over the catalogue."""

    key: str
    best: Signature
    all: tuple[Signature, ...]
    statistic: float
    p_value: float
    p_family: float


def variants(predictor: Predictor, fit: Fit, keys: Sequence[str], sizes: np.ndarray) -> list[Variant]:
    """Every way to try the effects `keys`: their shapes' grids one at a time, and each finite size of irregular ones.

    sizes (ne): a small size of each effect; see `small_sizes`.
    Of the orders and frequencies of a periodic effect only the most likely one is tried; see `scan`.
    """
    plant, found = predictor.plant, []
    units = shape_units(predictor, fit.point)
    for key in keys:
        own = [i for i, slot in enumerate(plant.slots) if slot.key == key]
        effect = plant.slots[own[0]].effect
        levels = tuple(i for i in own if not plant.slots[i].parameter.shape)
        shapes = [i for i in own if plant.slots[i].parameter.shape]
        if effect.phase and shapes:
            (shape,) = shapes
            scan = _periodic(predictor, fit, shape, sizes)
            if scan is not None:
                found += [Variant(key, levels, ((shape, value),), np.nan, True, scan.tries) for value in scan.peaks]
            continue
        grids, middle = [], {i: _middle(plant.slots[i], units) for i in shapes}
        for i in shapes:
            q, unit = plant.slots[i].parameter, _shape_unit(plant.slots[i], units, plant.dt)
            if q.grid_unit is GridUnit.CYCLES:
                values = _periods(q, _length(predictor))
            elif q.grid and unit > 0.0:  # some values of a grid: a refit finds what lies between
                inner = np.linspace(0, len(q.grid) - 1, (FINE if q.unit == "s" else COARSE) + 2)[1:-1]
                values = [q.grid[k] for k in sorted({round(x) for x in inner})]
            else:
                values = []
            grids.append([(i, min(max(v * unit, q.low), q.high)) for v in values] or [(i, middle[i])])
        finite = [g * _unit(plant, predictor, effect.grid_unit, plant.slots[own[0]].place) for g in effect.grid] or [np.nan]
        if effect.grid:  # of an irregular effect the sizes are tried, a refit finds the shapes
            grids = [[(i, middle[i])] for i in shapes]
        for chosen in _one_at_a_time(grids, middle):
            found += [Variant(key, levels, chosen, g, effect.phase) for g in finite if g > 0.0 or np.isnan(g)]
    return found


def dated_variants(predictor: Predictor, v: Variant) -> list[Variant]:
    """A variant at every date or period of its effect's grid; none where the effect has no such shape."""
    plant = predictor.plant
    length = _length(predictor)
    for i, _ in v.shapes:
        q = plant.slots[i].parameter
        if q.grid_unit is GridUnit.RECORD or (q.unit == "s" and q.grid and not v.phase):
            unit = length if q.grid_unit is GridUnit.RECORD else 1.0
            grid = _periods(q, length) if q.grid_unit is GridUnit.CYCLES else q.grid
            return [replace(v, shapes=tuple((j, g * unit if j == i else value) for j, value in v.shapes)) for g in grid]
    return []


def _periods(q: EffectParameter, length: float) -> list[float]:
    """Periods from the longest to the shortest of a grid, half a cycle over the record apart: a refit finds what lies between."""
    return [1.0 / f for f in np.arange(1.0 / q.grid[-1], 1.0 / q.grid[0] * (1.0 + 1e-9), 0.5 / length)]


def _periodic(predictor: Predictor, fit: Fit, shape: int, sizes: np.ndarray) -> Scan | None:
    """The most likely orders or frequencies of a periodic effect, None where no record repeats one."""
    slot, moves = predictor.plant.slots[shape], pushes(predictor, fit, shape, sizes)
    if slot.parameter.unit == PER_TURN:
        return scan_orders(predictor, fit, moves, slot.place, np.array(slot.parameter.grid))
    return scan_frequencies(predictor, fit, moves)


def _one_at_a_time(grids: Sequence[list[tuple[int, float]]], middle: dict[int, float]) -> list[tuple[tuple[int, float], ...]]:
    """Each shape over its grid while the others stand in the `middle`: a refit moves them together."""
    tried = [tuple((middle | {i: value}).items()) for grid in grids for i, value in grid]
    return list(dict.fromkeys(tried)) or [()]


def _middle(slot: Slot, units: Mapping[tuple[GridUnit, str], float]) -> float:
    """Where a shape stands while others are tried: in the middle of a grid that is in units of the records, else its default."""
    q, unit = slot.parameter, units.get((slot.parameter.grid_unit, slot.place), 0.0)
    return min(max(q.grid[len(q.grid) // 2] * unit, q.low), q.high) if q.grid and unit > 0.0 else q.default


def _shape_unit(slot: Slot, units: Mapping[tuple[GridUnit, str], float], dt: float) -> float:
    """What the grid of a shape is multiplied by."""
    other = dt if slot.parameter.grid_unit is GridUnit.SAMPLE else 1.0
    return units.get((slot.parameter.grid_unit, slot.place), other)


def shape_units(predictor: Predictor, point: Point) -> dict[tuple[GridUnit, str], float]:
    """The units of grids that are in units of the records, by place: their length, the largest speed and the highest level there.

    Both are what all but a hundredth of the samples of some record keep below.
    """
    plant = predictor.plant
    found = {(GridUnit.RECORD, slot.place): _length(predictor) for slot in plant.slots}
    full = [np.nan_to_num(predictor.corrected(i, point)) for i in range(len(predictor.records))]
    for place, name in plant.turning.items():
        j = plant.state_names.index(name)
        found[GridUnit.SPEED, place] = max(float(np.quantile(np.abs(x[:, j]), 0.99)) for x in full)
    for port in (port for port in plant.ports if isinstance(port, Tank)):
        j = plant.state_names.index(port.level)
        found[GridUnit.LEVEL, port.place] = max(float(np.quantile(x[:, j], 0.99)) for x in full)
    return found


def _length(predictor: Predictor) -> float:
    """Of the longest record [s]."""
    return max(map(len, predictor.records)) * predictor.plant.dt


def _unit(plant: Plant, predictor: Predictor, unit: GridUnit, place: str) -> float:
    if unit in (GridUnit.COMMAND, GridUnit.IMPULSE):
        j = plant.input_names.index(place)
        largest = max(float(np.abs(r.u[:, j]).max()) for r in predictor.records)
        return largest * (plant.dt if unit is GridUnit.IMPULSE else 1.0)
    if unit is GridUnit.NOISE:
        return float(predictor.noise.measurement[plant.output_names.index(place)])
    return plant.dt if unit is GridUnit.SAMPLE else 1.0


def signatures(
    predictor: Predictor, fit: Fit, tried: Sequence[Variant], sizes: np.ndarray, *, columns: bool = False
) -> list[Signature]:
    """What each variant changes at the fitted point, projected off everything that is fitted already.

    sizes (ne): steps for the sizes of regular effects; see `small_sizes`. columns: keep the projected columns too.
    """
    n, k = len(predictor.records), fit.unknowns.size
    lanes = [(v, s) for v in tried for s in (v.sizes if np.isnan(v.finite) else v.sizes[:1])]
    changes = _changes(predictor, fit.point, lanes, sizes)
    phase = np.array([v.phase for v, _ in lanes])
    # J'G by record: a column with a phase is one for each record, the others are one for all
    JG = np.zeros((n, k, len(lanes)))
    for i, J in enumerate(fit.jacobian):
        JG[i][fit.unknowns.columns(i)] = J.T @ changes[i]
    whole = JG.sum(axis=0)
    by_block = []
    for i, e in enumerate(fit.errors):
        own = np.where(phase, JG[i], whole)
        projected = changes[i] - fit.jacobian[i] @ (fit.covariance @ own)[fit.unknowns.columns(i)]
        by_block.append(np.add.reduceat(projected * e.ravel()[:, None], _blocks(predictor, i), axis=0))
    made, at, pull = [], 0, fit.gradient
    for v in tried:
        c = len(v.sizes) if np.isnan(v.finite) else 1
        own = slice(at, at + c)
        at += c
        moved = [g[:, own] for g in changes]
        if max(float(np.abs(g).max()) for g in moved) > RAN_AWAY:
            continue  # held gains are no filter for so large a size: the smaller ones of its grid speak for it
        GG, Ge = [g.T @ g for g in moved], [g.T @ e.ravel() for g, e in zip(moved, fit.errors, strict=True)]
        blocks = [b[:, own] for b in by_block]
        if v.phase:
            mixed = np.concatenate([JG[i][:, own] for i in range(n)], axis=1)
            GG, Ge, blocks = np.asarray(block_diag(*GG)), np.concatenate(Ge), np.asarray(block_diag(*blocks))
        else:
            mixed = whole[:, own]
            GG, Ge, blocks = sum(GG), sum(Ge), np.concatenate(blocks)
        weights = fit.covariance @ mixed
        step = np.array([sizes[s] for s in v.sizes] if np.isnan(v.finite) else [v.finite])
        low = np.array([predictor.plant.slots[s].parameter.low for s in v.sizes[:c]])
        repeat = n if v.phase else 1
        kept = _projected_columns(fit, changes, own, weights, v.phase) if columns else None
        b, S = Ge - weights.T @ pull, GG - mixed.T @ weights
        made.append(Signature(v, b, S, np.tile(step, repeat), blocks, weights, np.tile(low, repeat), kept))
    return made


def _changes(predictor: Predictor, point: Point, lanes: Sequence[tuple[Variant, int]], sizes: np.ndarray) -> list[np.ndarray]:
    """What a step of one size of each variant, (variant, size), does to the errors: (N ny, lanes) of every record."""
    changes = []
    for i in range(len(predictor.records)):
        eta = np.repeat(point.eta[i][None], len(lanes) + 1, axis=0)
        for c, (v, s) in enumerate(lanes, start=1):
            for j, value in v.shapes:
                eta[c, j] = value
            eta[c, s] += sizes[s] if np.isnan(v.finite) else v.finite
        e = _sorted_errors(predictor, i, point, eta)
        changes.append((e[1:] - e[:1]).reshape(len(lanes), -1).T)
    return changes


def _projected_columns(fit: Fit, changes: Sequence[np.ndarray], own: slice, weights: np.ndarray, phase: bool) -> np.ndarray:
    rows = []
    n = len(changes)
    for i, g in enumerate(changes):
        G = g[:, own]
        if phase:
            wide = np.zeros((len(G), G.shape[1] * n))
            wide[:, i * G.shape[1] : (i + 1) * G.shape[1]] = G
            G = wide
        rows.append(G - fit.projected(i, weights))
    return np.concatenate(rows)


def _sorted_errors(predictor: Predictor, i: int, point, eta: np.ndarray) -> np.ndarray:
    """Errors for many effect vectors, those with the same effects switched on side by side: what is off costs nothing."""
    order = np.lexsort((eta != eta[0]).T[::-1])
    e = predictor.errors(i, point.p[None], eta[order], point.start[i][None])
    back = np.empty_like(order)
    back[order] = np.arange(len(order))
    return e[back]


def _blocks(predictor: Predictor, i: int) -> np.ndarray:
    """First rows of the bootstrap's blocks in record i: one second each, but at least eighty blocks in all records.

    Errors of a free run may last longer: there twenty blocks must do.
    """
    ny, total = len(predictor.plant.outputs), sum(len(r) for r in predictor.records)
    length = max(5, min(predictor.block, total // (20 if predictor.simulated else 80)))
    return ny * np.arange(0, max(1, len(predictor.records[i]) - length // 2), length)


def small_sizes(predictor: Predictor, fit: Fit) -> np.ndarray:
    """For every size of every effect (ne) a step that changes the whitened errors by about `WANTED`, whatever its unit.

    The change is that of all records together: an effect may show in one of them only. Where nothing changes, the step is the
    first one: of an irregular effect a small share of the least size that is tried. So it is for a level: the lower it is, the
    more it changes.
    """
    plant, at = predictor.plant, fit.point.eta.copy()
    fitted, units = {t.key for t in fit.unknowns.terms}, shape_units(predictor, fit.point)
    sizes, unknown = np.zeros(len(plant.slots)), []
    for i, slot in enumerate(plant.slots):
        q, effect = slot.parameter, slot.effect
        if not q.shape:
            tried = [g * _unit(plant, predictor, effect.grid_unit, slot.place) for g in effect.grid]
            sizes[i] = min(LEAST if effect.regular else LEAST * min(tried), 0.5 * q.high)
            unknown += [] if is_level(slot.key) else [i]
        elif slot.key not in fitted:
            at[:, i] = _middle(slot, units)
    first = sizes.copy()
    for _ in range(TRIALS):
        if not unknown:
            break
        again = []
        for s, norm in zip(unknown, _norms(predictor, fit.point, at, [(s, float(sizes[s])) for s in unknown]), strict=True):
            if not norm > ROUNDED and not plant.slots[s].effect.regular:
                continue
            ratio = WANTED / norm if norm > ROUNDED else FARTHER
            sizes[s] = min(ratio * sizes[s], 0.5 * plant.slots[s].parameter.high)
            again += [s] if not 1e-3 < ratio < 1e3 else []
        unknown = again
    norms = _norms(predictor, fit.point, at, [(s, float(sizes[s])) for s in unknown])
    never = [s for s, norm in zip(unknown, norms, strict=True) if not norm > ROUNDED]
    sizes[never] = first[never]
    return sizes


def _norms(predictor: Predictor, point: Point, at: np.ndarray, steps: Sequence[tuple[int, float]]) -> np.ndarray:
    """How far each step (slot, size) from the effects `at` moves the whitened errors of all records."""
    squares = np.zeros(len(steps))
    for i in range(len(predictor.records)):
        eta = np.repeat(at[i][None], len(steps) + 1, axis=0)
        for c, (s, size) in enumerate(steps, start=1):
            eta[c, s] += size
        e = _sorted_errors(predictor, i, point, eta)
        squares += ((e[1:] - e[:1]) ** 2).sum(axis=(1, 2))
    return np.sqrt(squares)


def _reduction(b: np.ndarray, S: np.ndarray, low: np.ndarray, variant: Variant) -> np.ndarray:
    """b'S^-1 b for rows of b (R, c); 0 where the one size would have to lie below its bound."""
    value = np.einsum("ri,ij,rj->r", b, inverse(S), b)
    if S.shape[0] == 1 and (low[0] >= 0.0 or not np.isnan(variant.finite)):
        value = np.where(b[:, 0] < 0.0, value, 0.0)  # e + G eta: the size is -b/S
    return value


def scores(made: Sequence[Signature], seed: int = 0) -> list[Score]:
    """Every effect's best variant with its p-values, those that are significant first, then by statistic.

    An effect that shows in a few blocks only (a limit that is met twice) has too few signs to flip: its statistic is compared
    with chi squared, widened by as much as the other effects' null distributions are.
    """
    if not made:
        return []
    random = np.random.default_rng(seed)
    signs = random.choice([-1.0, 1.0], (DRAWS, len(made[0].blocks)))
    keys = list(dict.fromkeys(s.variant.key for s in made))
    observed, drawn, best, few = [], [], [], []
    for key in keys:
        own = [s for s in made if s.variant.key == key and np.trace(s.S) > 1e-12]
        values = [s.statistic for s in own] or [0.0]
        null = [_reduction(signs @ s.blocks, s.S, s.low, s.variant) for s in own]
        observed.append(max(values))
        drawn.append(np.max(null, axis=0) if null else np.zeros(DRAWS))
        best.append(own[int(np.argmax(values))] if own else None)
        few.append(bool(own) and _blocks_that_count(best[-1]) < FEW)
    wide = [
        float(null.mean()) / len(s.b) for null, s, is_few in zip(drawn, best, few, strict=True) if s is not None and not is_few
    ]
    inflation = max(1.0, float(np.median(wide))) if wide else 1.0
    logs, log_draws = [], []
    for value, null, signature, is_few in zip(observed, drawn, best, few, strict=True):
        if is_few and signature is not None:
            shape, scale = 0.5 * len(signature.b), 2.0 * inflation
        else:
            shape, scale = gamma_of(null)
        tries = max((s.variant.tries for s in made if s.variant.key == keys[len(logs)]), default=1)
        logs.append(max(-gamma.logsf(value, shape, scale=scale) - np.log(tries), 0.0))
        # where few blocks count their flips hold the effect itself: draws of the null stand in
        log_draws.append(random.exponential(size=DRAWS) if is_few else -gamma.logsf(null, shape, scale=scale))
    largest = np.max(log_draws, axis=0)
    # Gumbel tail by moments, never steeper than one in natural logarithms
    spread = max(float(largest.std()) * np.sqrt(6.0) / np.pi, 1.0)
    centre = float(largest.mean()) - 0.5772 * spread
    found = [
        Score(
            key,
            signature,
            tuple(s for s in made if s.variant.key == key),
            value,
            float(np.exp(-log)),
            max(float(gumbel_r.sf(log, centre, spread)), float(np.exp(-log))),
        )
        for key, signature, value, log in zip(keys, best, observed, logs, strict=True)
        if signature is not None
    ]
    return sorted(found, key=lambda s: (s.p_family > SIGNIFICANT, -s.statistic))


def _blocks_that_count(s: Signature) -> float:
    """How many blocks carry the score, (sum b^2)^2 / sum b^4."""
    squares = (s.blocks**2).sum(axis=1)
    return float(squares.sum() ** 2 / max(float((squares**2).sum()), 1e-300))


def gamma_of(null: np.ndarray) -> tuple[float, float]:
    """Shape and scale of a gamma distribution of the mean and the variance of draws, its tail never steeper than chi squared's.

    Where a single block dominates all draws are alike, and their spread says nothing of the tail.
    """
    mean = max(float(null.mean()), 1e-12)
    scale = max(float(null.var()) / mean, 2.0)
    return mean / scale, scale


def similarity(made: Sequence[Signature]) -> np.ndarray:
    """(m, m) share of the signature in a row that the one in a column can mimic: largest canonical correlation, squared."""
    bases = []
    for s in made:
        assert s.columns is not None
        bases.append(np.linalg.qr(s.columns / np.maximum(np.linalg.norm(s.columns, axis=0), 1e-300))[0])
    if not bases:
        return np.zeros((0, 0))
    every = np.concatenate(bases, axis=1)
    products = every.T @ every
    ends = np.cumsum([0, *(basis.shape[1] for basis in bases)])
    parts = [slice(a, b) for a, b in pairwise(ends)]
    shared = np.array([[np.linalg.norm(products[a, b], 2) ** 2 for b in parts] for a in parts])
    np.fill_diagonal(shared, 1.0)
    return np.minimum(shared, 1.0)
