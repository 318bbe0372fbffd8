"""What is claimed of a loop on the identified model: proved, or refuted by parameters that the records leave open.

Errors that the records leave open move as they like within their boxes; certificates and parameter sequences stand side by side.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from workbench.basis import CONSTANT, PiecewiseLinear, Powers
from workbench.data import Channel, Dataset
from workbench.errors import InputError
from workbench.files import as_read
from workbench.intervals.errors import ErrorRegression
from workbench.intervals.model import IntervalModel
from workbench.lpv import LPVModel, ends
from workbench.physics.controller import content_of, law_of
from workbench.physics.plant import Plant
from workbench.progress import Progress, silent
from workbench.records import field, record
from workbench.report import figures
from workbench.report.blocks import Block, Table
from workbench.robustness.envelopes.course import Course
from workbench.robustness.falsify.counterexample import same
from workbench.robustness.frequency import Closed, disk_margin
from workbench.robustness.frozen import feedback_of, worst_margins
from workbench.robustness.limits import Limit, LoopLimits, Manoeuvre, settled
from workbench.robustness.linear_law import LinearLaw, affine_of, check_law, without_linear_form
from workbench.robustness.loop import RATE_OF, driven, interpolated
from workbench.robustness.machine import machine_with_errors
from workbench.robustness.margins import Falsified, Margin, margin
from workbench.robustness.proof import clipped, falls_in_motion, grows
from workbench.robustness.proof import limits as bounded
from workbench.robustness.schedules import scheduled_margin
from workbench.robustness.sequences import Broken, Growth, Passage, Witness, sequence_of
from workbench.robustness.uncertain import UncertainLoop
from workbench.robustness.verdict import GROWS, Bound, Kept, Region, Status, Verdict, bounds_kept, refuting, stability
from workbench.simulation import simulate
from workbench.verification.part import FROZEN, Part

TITLE = "On the identified model"
COMPARED = 41  # schedule values at which a law is compared with its linear form
NODES, FEWER = 5, 3  # schedule values at which stability is proved, of several variables of each
GRID = 25  # of the schedule at which |S| is looked at
MOTION = 1.1  # ratio of bounds at which the search of a certificate in motion ends
KNOWN = 0.01  # widths of the model's span by which a schedule may leave it


@record
class Open:
    """A model, the boxes of its errors, and parameters (R p) within them, as shares, that may be the machine's."""

    model: LPVModel
    errors: tuple[IntervalModel, ...]
    possible: np.ndarray = field("R p", low=-1.0, high=1.0)


def opened(method: ErrorRegression, model: LPVModel, records: Dataset) -> Open:
    """The boxes, and constant parameters within them that no record refutes."""
    errors = method.fit(model, records)
    return Open(model, errors, method.possible(model, records, errors))


def on_model(
    left: Open, law: Any, limits: LoopLimits, plant: Plant | None = None, *, nodes: int | None = None, rate: float | None = None,
    driver: Any = None, progress: Progress = silent,
) -> Part:  # fmt: skip
    """Stability at `nodes` schedule values (NODES, of several variables FEWER of each) and, with a rate [1/s], in motion; |S|;
    disk margin; and limits along the run.

    plant: whose nominal run, under the `driver` (default: the law), says what the schedule does; without one it goes once over
    all that the model knows. Raises
    InputError for limits that ask for what the loop does not have.
    """
    model, of, several = left.model, f"model {left.model.name}", len(left.model.schedules) > 1
    if getattr(law, "inverses", ()):
        said = "the law inverts a dead zone or play, and no inverse is exact: nothing is proved of such a loop, simulate runs it"
        return Part(TITLE, tuple(Verdict(claim, of, Status.UNDECIDED, math.nan, "", said) for claim in claimed(limits)))
    if getattr(law, "cancels", False):
        return _before_the_loop(left, law, limits, plant, nodes=nodes, rate=rate, driver=driver, progress=progress)
    nodes = nodes or (FEWER if several else NODES)
    compared = [rho for n in ((nodes,) if several else (nodes, COMPARED)) for rho in model.frozen_values(n) if rho is not None]
    if said := without_linear_form(law, compared):
        return Part(TITLE, tuple(Verdict(claim, of, Status.UNDECIDED, math.nan, "", said) for claim in claimed(limits)))
    check_law(model, law)
    run = _prepared(left, law, limits, plant, driver or law) if limits.limits and limits.run is not None else None
    found = _Found([], [], {})
    if limits.stable or limits.margin is not None:
        _stability(found, left, law, limits, nodes, rate, of, progress)
    if limits.sensitivity is not None:
        found.verdicts.append(_sensitivity(model, law, limits.sensitivity, of))
    if limits.disk is not None:
        found.verdicts.append(_disk(left, law, limits.disk, nodes, of))
    if run is not None:
        _bounds(found, left, law, limits, run, of, progress)
    return Part(TITLE, tuple(found.verdicts), tuple(found.blocks), found.witnesses)


def _before_the_loop(left: Open, law: Any, limits: LoopLimits, plant: Plant | None, **options: Any) -> Part:
    """The loop of a law that cancels effects before it, by curves over its set-points or a play: they are in every run."""
    said = "the law adds curves over its set-points or awaits play, nothing is proved along a run: simulate runs it"
    for own in limits.limits:
        unit_of(own, {c.name: c.unit for c in (*left.model.inputs, *left.model.outputs)})  # refuses what is no signal
    along = claimed(replace(limits, stable=False, margin=None, sensitivity=None, disk=None))
    unsaid = [Verdict(claim, f"model {left.model.name}", Status.UNDECIDED, math.nan, "", said) for claim in along]
    loop = on_model(left, law.uncompensated, replace(limits, limits=()), plant, **options)
    return replace(loop, verdicts=(*loop.verdicts, *unsaid))


class _Found(NamedTuple):
    """What a check on the model has found so far; see `Part`."""

    verdicts: list[Verdict]
    blocks: list[Block]
    witnesses: dict[str, Witness]

    def replayed(self, verdict: Verdict, witness: Witness, name: str, law: LinearLaw) -> Verdict:
        """The verdict with its witness, where what its file will hold gives the same number again."""
        stored = sequence_of(as_read(witness.to_dict()))
        if not (stored.breaks and same(stored.again(lambda content: law_of(content, law)), stored.value)):
            sentence = f"{verdict.sentence}; the stored run did not give it again"
            return replace(verdict, status=Status.UNDECIDED, sentence=sentence)
        self.witnesses[name] = witness
        return verdict.shown_by(name)


def claimed(limits: LoopLimits) -> list[str]:
    """Every claim of a file of limits, in words."""
    of_loop = {"stable": limits.stable, "margin": limits.margin, "peak |S|": limits.sensitivity, "disk margin": limits.disk}
    return [name for name, asked in of_loop.items() if asked] + [f"{x.signal}: {' and '.join(x.kept)}" for x in limits.limits]


def _stability(
    found: _Found, left: Open, law: LinearLaw, limits: LoopLimits, nodes: int, rate: float | None, of: str, progress: Progress
) -> None:
    model, errors = left.model, left.errors
    needed = max(limits.margin or 1.0, 1.0 if limits.stable else 0.0)
    margins = []
    for rho in model.frozen_values(nodes):
        where = f" at {model.named(rho)}" if rho is not None else ""
        progress(f"stability{where}")
        claim = f"stable{where}" + FROZEN * bool(where) + f" in boxes {needed:g} times as wide" * (needed != 1.0)
        whole = driven(machine_with_errors(model, errors, rho), law, rho)
        loop = whole.undriven(still=True)
        # beyond the boxes themselves nothing is known of what the records leave open: there sequences within them refute
        moving, constant = limits.moving or needed != 1.0, left.possible[:, whole.fed_back] if needed >= 1.0 else None
        try:
            own = margin(loop)
        except InputError as reason:
            verdict, lost = _without_margin(loop, constant, moving, claim, of, reason)
            verdict = verdict if lost is None else replace(verdict, shown=grows(loop, lost, needed))
        else:
            margins.append((rho, own))
            verdict = stability(own, needed, claim, of, possible=constant, moving=moving)
            lost = refuting(own, needed, constant, moving) if verdict.status is Status.FAILED else None
            loop = own.loop
        if lost is not None:
            verdict = found.replayed(verdict, Growth(claim, loop, lost, needed), f"sequence-{len(found.verdicts) + 1}.json", law)
        found.verdicts.append(verdict)
    if rate is not None:
        found.verdicts.append(_in_motion(model, errors, law, rate, nodes, needed, of, progress))
    found.blocks.extend(_margin_blocks(model, margins, needed))


def _without_margin(
    loop: UncertainLoop, constant: np.ndarray | None, moving: bool, claim: str, of: str, reason: InputError
) -> tuple[Verdict, Falsified | None]:
    """A loop that has no margin: lost in the middle of the boxes, with what shows it, or where the search came to nothing."""
    middle = np.zeros((1, len(loop.lam)))
    tried = middle if constant is None else np.vstack([constant, middle]) if moving else constant
    radii = np.abs(np.linalg.eigvals(loop.at(tried))).max(axis=1)
    worst = int(radii.argmax())
    if radii[worst] < GROWS:
        return Verdict(claim, of, Status.UNDECIDED, math.nan, "", f"no margin was found: {reason.problem}"), None
    lost = Falsified(1.0, tried[worst][None], 1.0)
    lost = replace(lost, growth=lost.replay(loop))
    who = "constant parameters that no record refutes let" if tried[worst].any() else "the middle of the boxes lets"
    said = f"{who} a state grow, by {lost.growth:.4g} at every sample"
    return Verdict(claim, of, Status.FAILED, 1.0 - lost.growth, "", said), lost


def _in_motion(
    model: LPVModel, errors: Sequence[IntervalModel], law: LinearLaw, rate: float, nodes: int, needed: float, of: str,
    progress: Progress,
) -> Verdict:  # fmt: skip
    """Stability while the schedule moves: of the machine that is linear between nodes, and proved where the model is that."""
    if len(model.schedules) != 1:
        said = "several schedule variables: stability in motion is proved for one" if model.schedules else "no schedule"
        raise InputError(f"--rate {rate:g}, but the model has {said}", mend="leave --rate out")
    schedule = model.schedules[0]
    claim = f"stable while {schedule.name} moves by up to {rate:g} {schedule.unit}/s"
    progress(claim)
    of_law, span = (getattr(law, "basis", None), getattr(law, "span", np.empty(0))) if law.schedule else (CONSTANT, np.empty(0))
    bases = [basis for basis in (of_law, model.basis) if isinstance(basis, PiecewiseLinear)]
    kinks = np.concatenate([span, *(basis.knots for basis in bases)])
    inside = np.unique(kinks[(kinks > model.span[0]) & (kinks < model.span[1])])
    rho = np.union1d(np.linspace(model.span[0], model.span[1], max(nodes, 3)), inside)
    rho = rho[np.append(True, np.diff(rho) > 1e-6 * np.ptp(rho))]
    at = interpolated([machine_with_errors(model, errors, float(value)) for value in rho], rho, law)
    off = 0.0
    for middle in 0.5 * (rho[1:] + rho[:-1]):
        own = driven(machine_with_errors(model, errors, float(middle)), law, float(middle)).A
        off = max(off, float(np.abs(at(float(middle)).A - own).max() / np.abs(own).max()))
    try:
        found = scheduled_margin(at, rho, rate * model.dt, inside, MOTION)
    except InputError as reason:
        return Verdict(claim, of, Status.UNDECIDED, math.nan, "", f"no margin was found: {reason.problem}")
    low, high, standing = found.certified.kappa, found.falsified.kappa, found.standing.kappa
    said = (
        f"P({schedule.name}) falls at every sample up to boxes {low:.3g} times as wide; moving parameters refute it from "
        f"{high:.3g} times on ({standing:.3g} while it stands still)"
    )
    delays = max(term.delay for term in model.terms)
    if _straight(model.basis) and _straight(of_law) and not delays:
        if low >= needed and found.certified.holds(found.loop):
            shown = falls_in_motion(found.loop, found.certified, needed)
            return Verdict(claim, of, Status.PROVED, low - needed, "boxes", said, shown=shown)
        return Verdict(claim, of, Status.UNDECIDED, low - needed, "boxes", said)
    said += f"; but of the machine that is linear between {len(rho)} values, {100 * off:.2g} % off halfway between two"
    said += f", and without the delays of the model's schedule of up to {delays} samples" * (delays > 0)
    return Verdict(claim, of, Status.UNDECIDED, low - needed, "boxes", said)


def _straight(basis: Any) -> bool:
    """Whether what follows this basis is linear between the nodes of `_in_motion`."""
    return isinstance(basis, PiecewiseLinear) or (isinstance(basis, Powers) and set(basis.exponents) <= {0, 1})


def _margin_blocks(model: LPVModel, found: Sequence[tuple[Any, Margin]], needed: float) -> list[Block]:
    if not found:
        return []
    said = (
        "How many times as wide the boxes may be. Proved: parameters that move as they like at every sample. Refuted: a sequence "
        "of parameters that the loop does not survive. Standing still: constant parameters, which say nothing of moving ones. "
        "All for a schedule that stands still."
    )
    columns = {
        "proved": [m.certified.kappa for _, m in found],
        "refuted": [m.falsified.kappa for _, m in found],
        "standing still": [m.frozen.kappa for _, m in found],
    }
    if len(model.schedules) > 1:
        rows = zip([model.named(rho) for rho, _ in found], *columns.values(), strict=True)
        return [Table("Margins", ("at", *columns), tuple(rows), said, digits=3)]
    if model.schedule is None or len(found) < 2:
        return [Table("Margins", ("margin", "boxes"), tuple((name, values[0]) for name, values in columns.items()), said)]
    curves = {name: np.array(values) for name, values in columns.items()} | {"asked": np.array(needed)}
    over = figures.Trace(model.schedule, np.array([rho for rho, _ in found], dtype=float))
    return [figures.over_schedule("Margins over the schedule", over, {"boxes, times as wide": curves}, said)]


def _sensitivity(model: LPVModel, law: LinearLaw, asked: float, of: str) -> Verdict:
    grid = model.frozen_values(GRID)
    found = worst_margins(law, [model], grid)
    peaks, claim = found.sensitivity, f"peak |S| at most {asked:g}"
    if found.radius.max() >= 1.0:
        return Verdict(claim, of, Status.FAILED, math.nan, "", "the loop of the model itself is not stable: it has no |S|")
    largest, worst = float(peaks.max()), grid[int(peaks.argmax())]
    where = "" if worst is None else f", at {model.named(worst)}"
    status = Status.PASSED if largest <= asked else Status.FAILED
    said = f"the largest |S| of the model itself is {largest:.3g} at {len(grid)} schedule values{where}"
    return Verdict(claim, of, status, asked - largest, "", said)


def _disk(left: Open, law: LinearLaw, asked: float, nodes: int, of: str) -> Verdict:
    """The least disk margin at the plant input, of constant parameters that no record refutes."""
    model, least, middle = left.model, (np.inf, None), np.inf
    tried = np.vstack([np.zeros((1, left.possible.shape[1])), left.possible])
    for rho in model.frozen_values(nodes):
        machine, answer = machine_with_errors(model, left.errors, rho), feedback_of(law, rho)
        for number, delta in enumerate(tried):
            S = Closed.of(machine.at(delta, law.actuated, law.measured), answer).input_sensitivity
            own = disk_margin(S, least[0] if number else np.inf) if S.stable else 0.0
            middle = min(middle, own) if number == 0 else middle
            least = min(least, (own, rho), key=lambda pair: pair[0]) if number else least
    where = f", at {model.named(least[1])}" if least[1] is not None else ""
    status = Status.PASSED if least[0] >= asked else Status.FAILED
    tried_of = f"the worst of {len(left.possible)} constant parameters{where}"
    said = f"{least[0]:.3g} for {tried_of}, {middle:.3g} in the middle of the boxes"
    return Verdict(f"disk margin at least {asked:g}", of, status, least[0] - asked, "", said)


@record
class _Run:
    """Set-points (N nr) and the schedule of a run, (N) or (N ns), the bounds asked of it, and what it is called.

    initial (nr 2): between which the set-points lie before the run.
    """

    references: np.ndarray = field("N nr")
    initial: np.ndarray = field("nr 2")
    rho: np.ndarray = field("N ...")
    bounds: tuple[Bound, ...]
    along: str


def _prepared(left: Open, law: LinearLaw, limits: LoopLimits, plant: Plant | None, driver: Any) -> _Run:
    """What the limits ask, checked before anything is computed. Raises InputError for what the loop does not have."""
    run, model = limits.run, left.model
    assert run is not None
    if run.start and plant is None:
        raise InputError("start is of a plant", file="[run]", mend="leave it out, or give --plant: a model begins at rest")
    references = _references(run, law)
    rho = _schedule(model, driver, run, plant, len(references))
    channels, bounds = {c.name: c for c in (*model.outputs, *model.inputs)}, []
    for limit in limits.limits:
        place = f"[limits.{limit.signal}]"
        unit = unit_of(limit, {name: channels[name].unit for name in (*law.measured, *law.actuated)})
        if "settling" in limit.kept and limit.signal not in law.measured:
            raise InputError("settling needs a set-point", file=place, mend=f"only {', '.join(law.measured)} have one")
        own = _asked(limit, law, references, unit)
        if empty := [b.claim for b in own if not (np.isfinite(b.low) | np.isfinite(b.high)).any()]:
            raise InputError(f"{empty[0]}: asks nothing within the run", file=place, mend="a longer run, or an earlier begin")
        bounds += own
    gone = zip(model.schedules, np.reshape(rho, (len(rho), -1)).T, strict=False)
    ways = [f"{c.name} from {own[0]:.4g} to {own[-1]:.4g} {c.unit}" for c, own in gone]
    along = f", along {', '.join(ways)}" if ways else ""
    initial = run.rested(law, references[0])
    return _Run(references, initial, rho, tuple(bounds), along)


def _bounds(found: _Found, left: Open, law: LinearLaw, limits: LoopLimits, run: _Run, of: str, progress: Progress) -> None:
    assert limits.run is not None
    of = f"{of}{run.along}"
    within = [bound for bound in run.bounds if _by_the_law(law, bound)]
    wanted = [bound for bound in run.bounds if not _by_the_law(law, bound)]
    if within:
        said, claim = "the law itself never commands beyond it", ", ".join(bound.claim for bound in within)
        shown = clipped([bound.limits for bound in within], [bounded(b.signal, *_ends(law, b.signal)) for b in within])
        found.verdicts.append(Verdict(claim, of, Status.PROVED, 0.0, "", said, shown=shown))
    form, model = affine_of(law, run.rho[0] if law.schedule else None), left.model
    region = Region.of(form)
    stops = _stops(law, model, len(run.references)) if not len(form.w) else []  # a law that plans has them in its plan
    rates = tuple(dict.fromkeys(b.signal.removeprefix(RATE_OF) for b in (*wanted, *stops) if b.signal.startswith(RATE_OF)))
    noise = limits.run.seed is not None
    passage = Passage(model, left.errors, content_of(law), run.rho, run.references, run.initial, noise, rates)
    progress("the loop along the run")
    try:
        own = passage.course(law)
        kept = bounds_kept(
            own, wanted, stops, region=region, of=of, dt=law.dt, possible=left.possible, moving=limits.moving, progress=progress
        )
    except InputError as reason:
        found.verdicts.extend(
            Verdict(bound.claim, of, Status.UNDECIDED, math.nan, bound.unit, reason.problem) for bound in wanted
        )
        return
    for number, k in enumerate(kept, 1):
        verdict = k.verdict
        if verdict.status is Status.FAILED:
            verdict = found.replayed(verdict, _broken(own, k, passage), f"passage-{number}.json", law)
        found.verdicts.append(verdict)
    found.blocks.extend(_envelope_pictures(own, kept, {c.name: c for c in (*model.outputs, *model.inputs)}, law.dt))


def unit_of(limit: Limit, units: Mapping[str, str]) -> str:
    """The unit of a limit's signal. Raises InputError for a signal that is not among these, and for a limit in another unit."""
    place = f"[limits.{limit.signal}]"
    if limit.signal not in units:
        raise InputError("not a signal of this loop", file=place, mend=f"it has {', '.join(units)}")
    unit = units[limit.signal]
    if limit.unit and unit and limit.unit != unit:
        raise InputError(f"in {limit.unit}, the model has it in {unit}", file=place, mend=f"give the bounds in {unit}")
    return unit


def _references(run: Manoeuvre, law: Any) -> np.ndarray:
    """Set-points (N, nr) in the law's order."""
    own = run.references(law, law.dt)
    return np.column_stack([own[name] for name in law.references])


def _schedule(model: LPVModel, law: Any, run: Manoeuvre, plant: Plant | None, N: int) -> np.ndarray:
    """What the schedule does: as on the nominal plant, and without one once over all that the model knows."""
    if plant is None or not model.schedules:
        return model.path(N)
    quiet = replace(run, seed=None).scenario(plant, law)
    every = max(1, round(law.dt / plant.dt))
    rho = model.measured_schedule(simulate(plant, law, quiet, bumpless=True).experiment)[::every][:N]
    for c, own, (low, high) in zip(model.schedules, np.reshape(rho, (len(rho), -1)).T, model.spans, strict=True):
        if max(low - own.min(), own.max() - high) > KNOWN * (high - low):
            problem = f"{c.name} goes from {own.min():.4g} to {own.max():.4g} in this run"
            known = f"the model knows {low:.4g} to {high:.4g}"
            raise InputError(problem, file="[run]", mend=f"a shorter run, or another start: {known}")
    return np.clip(rho, *ends(model.spans))


def _asked(limit: Limit, law: Any, references: np.ndarray, unit: str) -> list[Bound]:
    """A limit as bounds at every sample."""
    N, unit = len(references), limit.unit or unit
    t = law.dt * np.arange(N)
    since = t >= limit.begin - 1e-6 * law.dt
    none, found = np.full(N, np.inf), []
    for kind in limit.kept:
        value = getattr(limit, "band" if kind == "settling" else kind)
        told = f"{limit.signal}: {kind if kind != 'settling' else f'within the band {limit.settling:g} s after every step'}"
        claim = f"{told} {value:g} {unit}" + "/s" * (kind == "rate")
        if kind == "low":
            found.append(Bound(claim, limit.signal, unit, np.where(since, value, -np.inf), none))
        elif kind == "high":
            found.append(Bound(claim, limit.signal, unit, -none, np.where(since, value, np.inf)))
        elif kind == "rate":
            inner = np.where(since & np.append(False, since[:-1]), value, np.inf)
            found.append(Bound(claim, f"{RATE_OF}{limit.signal}", f"{unit}/s", -inner, inner))
        else:
            r = references[:, law.measured.index(limit.signal)]
            late = since & settled(t, r, limit.settling)
            found.append(Bound(claim, limit.signal, unit, np.where(late, r - value, -np.inf), np.where(late, r + value, np.inf)))
    return found


def _by_the_law(law: LinearLaw, bound: Bound) -> bool:
    """Whether a bound on a command is no tighter than the law's own limit."""
    if bound.signal.removeprefix(RATE_OF) not in law.actuated:
        return False
    low, high = _ends(law, bound.signal)
    return bool(np.all(bound.low <= low) and np.all(high <= bound.high))


def _ends(law: LinearLaw, signal: str) -> tuple[float, float]:
    """Between which values a law keeps a command or its rate."""
    i = law.actuated.index(signal.removeprefix(RATE_OF))
    return (-law.rate[i], law.rate[i]) if signal.startswith(RATE_OF) else (law.low[i], law.high[i])


def _stops(law: LinearLaw, model: LPVModel, N: int) -> list[Bound]:
    """Where the law's own limits begin to act."""
    found, units = [], {c.name: c.unit for c in model.inputs}
    for name, low, high, rate in zip(law.actuated, law.low, law.high, law.rate, strict=True):
        unit = units[name]
        if np.isfinite(low) or np.isfinite(high):
            found.append(Bound(f"{name} between its stops", name, unit, np.full(N, low), np.full(N, high)))
        if np.isfinite(rate):
            found.append(Bound(f"{name} below its rate", f"{RATE_OF}{name}", unit, np.full(N, -rate), np.full(N, rate)))
    return found


def _broken(own: Course, kept: Kept, passage: Passage) -> Broken:
    """The run that breaks a bound."""
    k, bound, run = kept.sample, kept.bound, kept.run
    value = float(run.v[0, k, own.number(bound.signal)])
    low, high = float(bound.low[k]), float(bound.high[k])
    return Broken(bound.claim, passage, bound.signal, k, value, run.delta[0], run.before[0], run.share[0], low, high)


def _envelope_pictures(own: Course, kept: Sequence[Kept], channels: dict[str, Channel], dt: float) -> list[Block]:
    """Every signal with a bound: band, worst runs, bounds."""
    blocks = []
    for signal in dict.fromkeys(k.bound.signal for k in kept):
        i = own.number(signal)
        mine = [k for k in kept if k.bound.signal == signal]
        runs = {f"worst for {k.bound.claim.split(': ')[-1]}": k.run.v[0][:, i] for k in mine}
        limits = {
            f"{side} limit": pick([getattr(k.bound, side) for k in mine], axis=0)
            for side, pick in (("low", np.max), ("high", np.min))
        }
        tightest = max(mine, key=lambda k: k.constant)
        outer, t = tightest.outer, dt * np.arange(len(own))
        name = signal.removeprefix(RATE_OF)
        unit = channels[name].unit + "/s" * signal.startswith(RATE_OF)
        which = (
            "whatever constant parameters it has"
            if tightest.constant
            else "whatever the parameters do within them at every sample"
        )
        caption = (
            f"The band holds every run from the rest of any machine of the boxes, {which}, while no command is at its stop. "
            "Coloured: the runs that come nearest to a limit, with parameters that may refute it."
        )
        blocks.append(
            figures.guaranteed(
                f"{signal} along the run", t, Channel(signal, unit, "output"), outer.nominal.v[:, i], outer.low[:, i],
                outer.high[:, i], runs, {n: v for n, v in limits.items() if np.isfinite(v).any()}, caption,
            )
        )  # fmt: skip
    return blocks
