"""`draw(seed, limits=...)`: one case, records of a machine in which something is hidden, or nothing, and the truth about it.

A size is drawn log-uniform from 0.5 to 20 times the detection limit that the caller gives, cut where the machine would no
longer run. The limit of a saturation is by how much [unit of the command] the clip must lie below the largest command of the same
runs without it; that of physics outside the catalogue goes by the name "effect@outside".

Everything comes from the seed. Runs in which the tape goes slack or the machine runs away are drawn again, by turns with
another loop and with a smaller size, and `notes` says so.
"""

from collections.abc import Mapping
from enum import Enum
from functools import cached_property
from types import ModuleType
from typing import Any

import numpy as np

from tests.hidden import axis, robot, winding
from tests.hidden.catalogue import SIGNED, SIZE, Hidden, shapes
from tests.hidden.drawn import Outcome, Programme
from workbench.data import Dataset, Experiment
from workbench.errors import InputError, check_known
from workbench.records import record

MACHINES: dict[str, ModuleType] = {module.NAME: module for module in (winding, robot, axis)}
MIX = {"web-winding": 0.60, "welding-robot": 0.25, "positioning-axis": 0.15}
LOW, HIGH = 0.5, 20.0  # multiples of the detection limit
MINIMAL = 0.25  # share of the cases in which what a cheap machine does not measure is missing
TRIES = 12
OUTSIDE = "outside"  # the place of physics that the catalogue does not have
SHRINK = 0.6


class Kind(Enum):
    """What a case holds."""

    NOTHING = "nothing"
    OUTSIDE = "outside"
    PAIR = "pair"
    SINGLE = "single"


SHARES = {Kind.NOTHING: 0.20, Kind.OUTSIDE: 0.15, Kind.PAIR: 0.20, Kind.SINGLE: 0.45}


@record
class Case:
    """`records` are for estimation, `held_out` further ones of another programme; `truth` is empty where nothing is hidden."""

    seed: int
    machine: str
    kind: Kind
    records: Dataset
    held_out: Dataset
    truth: tuple[Hidden, ...]
    setting: Any  # of the machine's module: the machine as it was drawn, with its loop
    notes: tuple[str, ...] = ()

    @property
    def parameters(self) -> dict[str, float]:
        """The machine's true parameters."""
        return self.setting.machine._asdict()

    @property
    def resolutions(self) -> dict[str, float]:
        """The step to which every sensor rounds, whatever is hidden."""
        return MACHINES[self.machine].resolutions(self.setting)


def draw(seed: int, *, machine: str | None = None, kind: Kind | None = None, limits: Mapping[str, float]) -> Case:
    """The case of a seed; `machine` and `kind` fix what is drawn otherwise and leave all else to the seed.

    limits: detection limit by "effect@place" in the units of SIZE; what it does not name is never hidden. Raises InputError
    for an unknown machine or effect, a limit that is not positive, and where no (for a pair: only one) effect is left.
    """
    _check_limits(limits)
    lot = lot_of(seed)
    module, kind = MACHINES[check_known("machine", machine or lot.machine, MACHINES)], kind or lot.kind
    bench = _Bench(module, seed)
    truth = _truth(bench, kind, limits, np.random.default_rng([seed, 2]))
    notes, outcomes = [], bench.run(truth)
    for attempt in range(TRIES):
        fault = next((o.fault for o in outcomes if o.fault), "")
        if not fault:
            break
        if attempt % 2 and truth:
            truth = tuple(_smaller(h) for h in truth)
            notes.append(f"{fault}: sizes times {SHRINK:g}")
        else:
            bench.other_loop(attempt)
            notes.append(f"{fault}: another loop")
        outcomes = bench.run(truth)
    else:
        found = ", ".join(f"{h.key} {h.size:.3g}" for h in truth)
        raise InputError(
            f"seed {seed}: no sound runs in {TRIES} tries ({found}: {notes[-1]})", mend="give smaller detection limits"
        )
    records = tuple(o.experiment for o, p in zip(outcomes, bench.programmes, strict=True) if not p.held_out)
    held_out = tuple(o.experiment for o, p in zip(outcomes, bench.programmes, strict=True) if p.held_out)
    return Case(seed, module.NAME, kind, Dataset(records), Dataset(held_out), truth, bench.setting, tuple(notes))


def further(case: Case, name: str, references: Mapping[str, np.ndarray], run: int = 0) -> Experiment:
    """A further record of a case: the same machine with the same truth follows `references` (N,); its noise is that of `run`.

    references: set-points by name in the machine's own loop, or commands by name in open loop. Raises InputError for other
    names, and where the run is not sound.
    """
    module = MACHINES[case.machine]
    programme = module.follow(case.setting, name, references)
    found = module.outcome(case.setting, programme, case.truth, np.random.SeedSequence([case.seed, 6, run]))
    if found.fault:
        raise InputError(f"seed {case.seed}, {name}: {found.fault}", mend="ask for less")
    return found.experiment


def records(seed: int, machine: str, truth: tuple[Hidden, ...] = ()) -> Dataset:
    """The estimation records of a seed's bench in which just this is hidden. Raises InputError where a run is not sound."""
    outcomes = _Bench(MACHINES[machine], seed).run(truth, held_out=False)
    if fault := next((o.fault for o in outcomes if o.fault), ""):
        raise InputError(f"seed {seed}, {', '.join(h.key for h in truth)}: {fault}", mend="make it smaller")
    return Dataset(tuple(o.experiment for o in outcomes))


def setting_of(seed: int, machine: str) -> Any:
    """The machine of these records as it was drawn, with its loop."""
    return _Bench(MACHINES[machine], seed).setting


@record
class Lot:
    """What a seed draws first."""

    machine: str
    kind: Kind


def lot_of(seed: int) -> Lot:
    """Machine and kind of a seed's case, in the proportions of MIX and SHARES."""
    random = np.random.default_rng([seed, 1])
    machines, kinds = list(MIX), list(SHARES)
    machine = machines[random.choice(len(machines), p=list(MIX.values()))]
    return Lot(machine, kinds[random.choice(len(kinds), p=list(SHARES.values()))])


class _Bench:
    """One machine on the test bench: its setting, its programmes, and the seeds of its records."""

    def __init__(self, module: ModuleType, seed: int):
        random = np.random.default_rng([seed, 3])
        self.module, self.seed = module, seed
        self.setting = module.setting(random, random.random() < MINIMAL)
        self.programmes: tuple[Programme, ...] = module.programmes(self.setting, random)

    def run(self, truth: tuple[Hidden, ...], held_out: bool = True) -> list[Outcome]:
        """The records, or those for estimation only; each has its own seed, the same whatever is hidden."""
        return [
            self.module.outcome(self.setting, programme, truth, np.random.SeedSequence([self.seed, 4, k]))
            for k, programme in enumerate(self.programmes)
            if held_out or not programme.held_out
        ]

    @cached_property
    def quiet(self) -> list[Experiment]:
        """The estimation records in which nothing is hidden."""
        return [o.experiment for o in self.run((), held_out=False)]

    def other_loop(self, attempt: int) -> None:
        self.setting = self.module.with_loop(self.setting, np.random.default_rng([self.seed, 5, attempt]))


def _check_limits(limits: Mapping[str, float]) -> None:
    places = {place for module in MACHINES.values() for place in module.PLACES}
    for key, value in limits.items():
        effect, _, place = key.partition("@")
        check_known(
            "effect", effect, {name for m in MACHINES.values() for name in m.FOREIGN} if place == OUTSIDE else SIZE, file="limits"
        )
        check_known("place", place, {*places, OUTSIDE}, file="limits")
        if not (np.isfinite(value) and value > 0.0):
            raise InputError(f"detection limit {value:g}", file="limits", channel=key, mend="leave out what no record can show")


def _truth(bench: _Bench, kind: Kind, limits: Mapping[str, float], random: np.random.Generator) -> tuple[Hidden, ...]:
    if kind is Kind.NOTHING:
        return ()
    if kind is Kind.OUTSIDE:
        return (_foreign(bench, limits, random),)
    open_keys = [key for key in sorted(limits) if _possible(bench, key, limits[key])]
    chosen: list[Hidden] = []
    for _ in range(2 if kind is Kind.PAIR else 1):
        # first the effect, then its place: five sensors must not outnumber one guide pulley
        effects = sorted({key.partition("@")[0] for key in open_keys} - {h.effect for h in chosen})
        if not effects:
            raise InputError(
                f"too few effects with a detection limit for {bench.module.NAME}, {kind.value}", file="limits", mend="give more"
            )
        effect = effects[random.integers(len(effects))]
        keys = [key for key in open_keys if key.startswith(f"{effect}@")]
        key = keys[random.integers(len(keys))]
        chosen.append(_sized(bench, key, limits[key], random))
    return tuple(chosen)


def _possible(bench: _Bench, key: str, limit: float) -> bool:
    effect, _, place = key.partition("@")
    measured = place not in bench.module.OUTPUTS or place in bench.setting.names
    return effect in bench.module.PLACES.get(place, ()) and measured and LOW * limit < _cap(bench, key)


def _cap(bench: _Bench, key: str) -> float:
    effect, _, place = key.partition("@")
    if effect == "saturation":
        return 0.4 * _largest(bench, place)
    caps = bench.module.CAPS
    return caps.get(key, caps[effect])


def _largest(bench: _Bench, place: str) -> float:
    """The largest command of the runs in which nothing is hidden."""
    return max(float(np.abs(e[place]).max()) for e in bench.quiet)


def _sized(bench: _Bench, key: str, limit: float, random: np.random.Generator) -> Hidden:
    effect, _, place = key.partition("@")
    high = min(HIGH, _cap(bench, key) / limit)
    multiple = float(LOW * (high / LOW) ** random.random())
    sign = -1.0 if random.random() < 0.5 and effect in SIGNED else 1.0
    size = sign * multiple * limit
    if effect == "stiffness-jump" and size < -0.5:
        size = -size  # a web does not go limp
    if effect == "saturation":
        size = _largest(bench, place) - size
    parameters = {SIZE[effect][0]: size} | shapes(effect, bench.module.RANGES, size, random)
    return Hidden(effect, place, parameters, multiple)


def _foreign(bench: _Bench, limits: Mapping[str, float], random: np.random.Generator) -> Hidden:
    names = [name for name in bench.module.FOREIGN if f"{name}@{OUTSIDE}" in limits]
    if not names:
        raise InputError(f"no limit of an effect @{OUTSIDE} for {bench.module.NAME}", file="limits", mend="give one")
    effect = names[random.integers(len(names))]
    multiple = float(LOW * (HIGH / LOW) ** random.random())
    return foreign(effect, multiple * limits[f"{effect}@{OUTSIDE}"], multiple)


def foreign(effect: str, size: float, multiple: float = 0.0) -> Hidden:
    """Physics outside the catalogue."""
    return Hidden(effect, OUTSIDE, {"size": size}, multiple, False)


def _smaller(h: Hidden) -> Hidden:
    """The same with all sizes SHRINK times as large; a saturation is moved away by halving what it clips."""
    name = SIZE[h.effect][0] if h.catalogued else "size"
    scaled = {name, "sine", "cosine", "backward"}
    if h.effect == "saturation":
        parameters = {name: h.size / SHRINK**0.5}
    else:
        parameters = {key: value * (SHRINK if key in scaled else 1.0) for key, value in h.parameters.items()}
    return Hidden(h.effect, h.place, parameters, h.multiple * SHRINK, h.catalogued)
