"""Are these records of this plant at all? What would be diagnosed as missing physics and is a slip of the hand is refused here.

    d(y, z) = |log(std y / std z)| + 2 (1 - corr(y, z))

tells a measured channel y from a free run z of the plant under the logged inputs: 0 where they follow one course. It is taken of
the whole channels and of their fast parts, around a moving average: what a free run misses most is slow. No missing physics turns
a channel into another, upside down, or makes it 9.55 times as large while it follows the same course.

Every slip is a guess that is tried: an input that is mended gives another run, an output that is mended another record, and the
guess that brings the two closest is said. Where one input moves one output nothing tells which of them is wrong but the noise: a
reading in another unit brings its noise along.

A reversed sign and a known unit are refused. A factor of no known unit is a note: an amplifier that saturates, a dead zone or
much friction make an input look too large. So is an input without which the plant follows a record as well as with any mend.

A free run begins where the record begins: states are fitted to its first samples. And nothing is refused by a free run of the
whole record alone: what a start, a parameter or a disturbance takes away adds up over it. The record is cut into windows, short
ones where the plant is unstable, each with a start of its own, and what the inputs do within a window is compared,

    D = y - z0,   F = z - z0,   z0: a run from the same start under the window's mean inputs.

What is refused is wrong there too, and a sign or a place is refused only where no actuator that is limited, has a dead zone or
another gain explains the record nearly as well; else it is a note.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from workbench.data import Channel, Dataset, Experiment
from workbench.diagnosis.runs import Runner, first_outside
from workbench.errors import InputError
from workbench.physics.plant import Plant
from workbench.readers import UNITS, check_units
from workbench.records import field, record

PER_UNKNOWN = 10  # samples for each state and each parameter that is open
MOVES = 2.0  # a channel whose spread around a line is less than so many standard deviations of its noise stands still
STUCK = 0.5  # share of samples at one end of its range that makes a channel useless
NEAR = 0.25  # a ratio of spreads is a unit's factor f if it is within f**NEAR of it
BETTER = 0.5  # share of the distance that an input which is mended must take off, and of what an actuator leaves of it
EATEN = (0.5, 0.7, 0.8, 0.9, 0.95)  # quantiles of an input that a dead zone may be as wide as
LEFT = (0.1, 0.3)  # further quantiles that its limit may be at
GAINS = (0.5, 0.7, 1.4, 2.0)  # that an actuator may have
TOLD = 0.05  # difference of two distances below which neither is closer
TENS = (0.001, 0.01, 0.1, 10.0, 100.0, 1000.0)  # factors of a size for which no unit is known
APART = 6.0  # units closer to each other than this factor are not told by size
ALIKE = 0.9  # correlation above which two channels follow one course
UNLIKE = 0.3  # and below which one does not explain the other
PER_WEIGHT = 5  # samples for each weight of what inputs explain somehow
RELATED = 0.05  # share of an output that its inputs explain somehow, above which it is theirs
PUSHED, PAST, STRIDES = 0.05, 4, (1, 4, 16)  # the same of its errors from its own past; samples of that, blocks of samples
FOLLOWED = 0.2  # distance up to which a plant follows a record as it is
LEAVES = 0.1  # share of the record that a free run must last to be compared with
WORST = 2.0  # what one output adds to the distance of a run at most
SLOW = 40  # moving averages over a record: its length by this number
TURNS = 4 * np.pi  # rad: an angle that moves on its own and goes further is in degrees


@record
class Note:
    """One sentence on a record's channel that does not keep it from being used."""

    record: str
    channel: str
    sentence: str

    def __str__(self) -> str:
        return f"{self.record}, {self.channel}: {self.sentence}" if self.channel else f"{self.record}: {self.sentence}"


def check(plant: Plant, dataset: Dataset, *, anyway: bool = False) -> tuple[Note, ...]:
    """Refuse records that cannot be of `plant`, or from which nothing can be learned; what is merely odd is returned.

    Raises InputError for missing channels, units that are not the plant's (declared, or told by the size of a channel), records
    that are too short, outputs that stand still or at their stops, inputs that do not move, channels that have changed places,
    and records that the plant explains in no channel. anyway: the user takes the records all the same; then all but missing
    channels, declared units and the sample time are notes.
    """
    units = {c.name: c.unit for c in (*plant.inputs, *plant.outputs)}
    for e in dataset:
        _check_channels(plant, e)
        check_units(e, units)
        plant.sampled(e.dt, file=e.name)
    checks = [lambda: _check_length(plant, dataset)]
    for e in dataset:
        checks += [lambda e=e, one=one: one(plant, e) for one in (_unlogged, _still, _check_excitation, _compared)]
    notes: list[Note] = []
    for one in checks:
        try:
            notes += one()
        except InputError as reason:
            if not anyway:
                raise
            refused = reason.problem + (f" ({reason.mend})" if reason.mend else "")
            notes.append(Note(str(reason.file or plant.name), reason.channel or "", f"taken all the same: {refused}"))
    return tuple(notes)


# ---- one channel by itself -------------------------------------------------------------------------------------------


def _check_channels(plant: Plant, e: Experiment) -> None:
    missing = [name for name in plant.needed if name not in e.names]
    seen = [name for name in plant.output_names if name in e.names]
    if missing or not seen:
        renamed = ", ".join(_with_unit(e, (*plant.needed, *plant.output_names)))
        asked = "is it a record of this machine? name its channels as the plant does"
        wanted = f"inputs {', '.join(plant.needed)} and some of {', '.join(plant.output_names)}"
        raise InputError(
            f"has {', '.join(e.names)}; {plant.name} needs the {wanted}",
            file=e.name,
            channel=", ".join(missing),
            mend=f"write {renamed} in the header" if renamed else asked,
        )


def _with_unit(e: Experiment, names: Iterable[str]) -> list[str]:
    """What to write instead of channels that are called as `names` are, with a unit behind: current_A for current [A]."""
    found = []
    for name in names:
        for c in e.channels:
            own, _, unit = c.name.rpartition("_")
            if name not in e.names and own.lower() == name.lower() and unit in UNITS:
                found.append(f"{name} [{unit}] for {c.name}")
    return found


def _unlogged(plant: Plant, e: Experiment) -> Iterator[Note]:
    """Outputs, and inputs that move on their own, that are not in the record: what goes with them cannot be seen."""
    unseen = [name for name in plant.output_names if name not in e.names]
    if unseen:
        yield Note(e.name, ", ".join(unseen), "not in the record: what shows there alone cannot be found")
    known = {*plant.input_names, *plant.output_names}
    for channel in plant.inputs:
        if channel.name in plant.commanded or channel.name in e.names:
            continue
        same = [c.name for c in e.channels if c.unit == channel.unit and c.name not in known and c.role != "reference"]
        mend = f"; if it is what the record calls {same[0]}, rename that" if same else ""
        yield Note(e.name, channel.name, f"is not in the record and taken as 0: no effect that goes with it can be found{mend}")


def _check_length(plant: Plant, dataset: Dataset) -> tuple[Note, ...]:
    states, open_parameters = len(plant.states), sum(q.tolerance > 0.0 for q in plant.parameters)
    samples, needed = sum(len(e) for e in dataset), PER_UNKNOWN * (states * len(dataset) + open_parameters)
    if samples < needed:
        raise InputError(
            f"{samples} samples are too short for {states} start values of each record and {open_parameters} parameters",
            file=", ".join(dataset.names),
            mend=f"give at least {needed} samples ({needed * dataset.dt:g} s)",
        )
    return ()


def _still(plant: Plant, e: Experiment) -> Iterator[Note]:
    """A note for every output that says nothing; an error where none is left."""
    faults: dict[str, str] = {}
    for name in plant.output_names:
        if name not in e.names:
            continue
        y = e[name]
        ends = np.mean(y == y.max()), np.mean(y == y.min())
        if np.ptp(y) == 0.0:
            faults[name] = f"is constant at {y[0]:g}"
        elif max(ends) >= STUCK:
            at = y.max() if ends[0] >= ends[1] else y.min()
            faults[name] = f"sits at its stop {at:g} for {100 * max(ends):.0f} % of the record"
    if len(faults) == sum(name in e.names for name in plant.output_names):
        said = "; ".join(f"{name} {fault}" for name, fault in faults.items())
        raise InputError(
            f"no output says anything: {said}", file=e.name, mend="was the logger connected, and the range wide enough?"
        )
    for name, fault in faults.items():
        yield Note(e.name, name, f"{fault}: nothing can be learned from it")


def _driving(plant: Plant, e: Experiment) -> tuple[str, ...]:
    """Inputs that drive a plant in a record: the commanded ones; of a plant that nothing commands, those that are logged."""
    return plant.commanded or tuple(name for name in plant.input_names if name in e.names)


def _check_excitation(plant: Plant, e: Experiment) -> tuple[Note, ...]:
    """Something must move beyond noise: an input, and not only along a line."""
    driving = _driving(plant, e)
    moving = [name for name in driving if np.ptp(e[name]) > 0.0]
    still = not any(_moves(e[name]) for name in (*moving, *(n for n in plant.output_names if n in e.names)))
    if moving and not still:
        return ()
    fault = "no input moves" if not moving else "inputs and outputs move no more than their noise"
    raise InputError(
        f"{fault} ({', '.join(driving or plant.input_names)})",
        file=e.name,
        channel=(driving or plant.input_names)[0],
        mend="nothing can be diagnosed at rest: excite the machine, with steps of the set-points or a binary sequence",
    )


def _moves(y: np.ndarray) -> bool:
    """Whether a channel (N,) leaves a straight line by more than its white part."""
    t = np.linspace(-1.0, 1.0, len(y))
    spread = float(np.std(y - np.polyval(np.polyfit(t, y, 1), t)))
    return spread > MOVES * _white(y) and spread > 1e-9 * float(np.abs(y).max())


def _white(y: np.ndarray) -> float:
    """Standard deviation of the white part of a channel (N,), which second differences show."""
    return float(np.median(np.abs(np.diff(y, 2)))) / (0.6745 * np.sqrt(6.0))


# ---- against a free run of the plant -------------------------------------------------------------------------------------


@record
class Slip:
    """What a slip of the hand makes channels look like, and what mends it."""

    channels: tuple[str, ...]
    looks: str
    mend: str
    factor: float = field("", default=1.0)  # what mends them is multiplied by
    exchanged: bool = False  # or what mends them is to swap the two
    sure: bool = True  # no missing physics looks like it

    def __str__(self) -> str:
        return f"{' and '.join(self.channels)} {'looks' if len(self.channels) == 1 else 'look'} {self.looks}"


@record
class Trial:
    """The logged inputs as they would be if a slip were mended."""

    slip: Slip | None
    u: np.ndarray = field("N nu")


@record
class Guess:
    """Slips that were made together, and how far record and run are apart where all of them are mended."""

    slips: tuple[Slip, ...]
    away: float = field("")


@record
class Compared:
    """The outputs seen in a record, by column of y (N, n), and a free run of the plant, z (N, n), until it leaves its range."""

    file: str
    channels: tuple[Channel, ...]
    y: np.ndarray = field("N n")
    z: np.ndarray = field("N n")

    @property
    def counted(self) -> tuple[int, ...]:
        """Outputs that tell whether the plant explains a record: a reel's radius grows whatever turns it."""
        return tuple(i for i, c in enumerate(self.channels) if c.role != "schedule")

    @property
    def follows(self) -> float:
        """The best correlation of these."""
        if not len(self.y):
            return 0.0
        return max((nearest(self.y[:, i], self.z[:, i]).correlation for i in self.counted), default=0.0)

    @property
    def away(self) -> float:
        """Mean distance over the outputs."""
        if not len(self.y):
            return WORST
        return float(np.mean([min(nearest(y, z).distance, WORST) for y, z in zip(self.y.T, self.z.T, strict=True)]))

    def mended(self, slips: tuple[Slip, ...]) -> "Compared":
        """The same with outputs as they would be without these slips."""
        factor = {name: slip.factor for slip in slips for name in slip.channels}
        return replace(self, y=self.y * [factor.get(c.name, 1.0) for c in self.channels])


@record
class Likeness:
    """Correlation of two channels and ratio of their spreads."""

    correlation: float
    ratio: float

    @property
    def distance(self) -> float:
        return abs(float(np.log(self.ratio))) + 2.0 * (1.0 - self.correlation) if self.ratio > 0.0 else np.inf


def likeness(y: np.ndarray, z: np.ndarray) -> Likeness:
    """Of two channels (N,) as they are."""
    a, b = y - y.mean(), z - z.mean()
    spread, other = float(np.sqrt(np.mean(a**2))), float(np.sqrt(np.mean(b**2)))
    if not (spread > 0.0 and other > 0.0):
        return Likeness(0.0, 0.0)
    return Likeness(float(np.mean(a * b) / (spread * other)), spread / other)


def nearest(y: np.ndarray, z: np.ndarray) -> Likeness:
    """Of two channels (N,) as a whole or of their fast parts, whichever correlate better."""
    return max(likeness(y, z), likeness(_fast(y), _fast(z)), key=lambda one: one.correlation)


def _fast(y: np.ndarray) -> np.ndarray:
    """A channel (N,) around its moving average."""
    half = max(len(y) // (2 * SLOW), 1)
    odd = np.concatenate([2 * y[0] - y[half:0:-1], y, 2 * y[-1] - y[-2 : -half - 2 : -1]])  # a slope goes on at the ends
    total = np.concatenate([[0.0], np.cumsum(odd - y[0])])
    return y - y[0] - (total[2 * half + 1 :] - total[: -2 * half - 1]) / (2 * half + 1)


def _compared(plant: Plant, e: Experiment) -> Iterator[Note]:
    _check_turns(plant, e)
    runner = Runner.of(plant, e)
    trials = list(_trials(plant, e))
    (own, *others), whole = _runs(plant, e, runner, [t.u for t in trials])
    if whole and len(own.y) < len(e):
        yield Note(e.name, "", f"a free run of {plant.name} leaves its range after {len(own.y) * e.dt:g} s")
    guesses = _guesses(plant, own, [Guess((t.slip,), run.away) for t, run in zip(trials[1:], others, strict=True) if t.slip])
    if any(slip.sure for guess in guesses for slip in guess.slips):
        doubts = [_doubt(plant, e, runner, own, guess) for guess in guesses]
        sure = [guess for guess, doubt in zip(guesses, doubts, strict=True) if not doubt]
        if sure:
            raise _slipped(e.name, guesses if len(sure) == len(guesses) else sure)
        yield _unsure(e.name, guesses, doubts[0])
    elif guesses:
        yield _odd(e.name, guesses)
    _check_limits(plant, e, own.channels)
    if not len(own.y):
        if not guesses:
            yield _lost(plant, e, runner)
        return
    _check_places(plant, e, own)
    slips = [t.slip for t in trials if t.slip and t.slip.sure and (t.slip.exchanged or t.slip.factor == -1.0)]
    yield from _unexplained(plant, e, own, runner, slips)


def _runs(plant: Plant, e: Experiment, runner: Runner, inputs: Sequence[np.ndarray]) -> tuple[list[Compared], bool]:
    """Free runs under each inputs (N, nu) over the whole record, and True; of an unstable plant what they do within windows."""
    whole = _whole(plant, e, runner, inputs)
    return (whole, True) if len(whole[0].y) else ([_forced(plant, e, runner, u) for u in inputs], False)


def _whole(plant: Plant, e: Experiment, runner: Runner, inputs: Sequence[np.ndarray]) -> list[Compared]:
    """A free run over the whole record under each inputs (N, nu), from the plant's own start or from a fitted one.

    The first inputs tell which of the two: fitted, where they follow the record better so.
    """
    usual, fitted = ([_until_it_leaves(plant, e, run) for run in runner.whole(inputs, fitted=fitted)] for fitted in (False, True))
    return fitted if fitted[0].away + TOLD < usual[0].away else usual


def _forced(plant: Plant, e: Experiment, runner: Runner, u: np.ndarray) -> Compared:
    """What the inputs u (N, nu) do within windows: D of the module beside F, over no samples where no window lasts."""
    seen = [i for i, name in enumerate(plant.output_names) if name in e.names and np.ptp(e[name]) > 0.0]
    D, F = runner.forced(u)
    return Compared(e.name, tuple(plant.outputs[i] for i in seen), D[:, seen], F[:, seen])


def _holds_in_windows(plant: Plant, e: Experiment, guess: Guess) -> bool:
    """Whether the plant follows the record better within windows, too, where these slips are mended."""
    mended = _mended(e, guess.slips)
    as_is, better = (_forced(plant, one, runner, runner.u) for one in (e, mended) for runner in [Runner.of(plant, one)])
    return better.away + TOLD < as_is.away


def _mended(e: Experiment, slips: Sequence[Slip]) -> Experiment:
    """The record as it would be without these slips."""
    values = e.values.copy()
    for slip in slips:
        at = [e.names.index(name) for name in slip.channels]
        values[:, at] = values[:, at[::-1]] if slip.exchanged else values[:, at] * slip.factor
    return replace(e, values=values)


def _doubt(plant: Plant, e: Experiment, runner: Runner, own: Compared, guess: Guess) -> str:
    """Why a guess that explains the record better need not be right, the end of a sentence; empty where it is certain."""
    exchanged = any(slip.exchanged for slip in guess.slips)
    if exchanged and own.away <= FOLLOWED:
        return "it follows the record as it is, too: missing physics may favour the other way round"
    if not _holds_in_windows(plant, e, guess):
        return "only over the whole record: within short windows it does not; a start or a parameter may do this, too"
    if exchanged or any(slip.factor < 0.0 for slip in guess.slips):  # the size of a unit is no actuator's
        rivals, _ = _runs(plant, e, runner, [*_actuators(plant, e)])
        if guess.away >= BETTER * min(run.away for run in rivals):
            return "an actuator that saturates, has a dead zone or another gain explains it, too"
    return ""


def _unsure(file: str, guesses: Sequence[Guess], doubt: str) -> Note:
    """What a free run of the whole record says, and why it need not be so."""
    said = _slipped(file, guesses)
    return Note(file, said.channel or "", f"{said.problem}, but {doubt}; or else {said.mend}")


def _guesses(plant: Plant, own: Compared, tried: Sequence[Guess]) -> tuple[Guess, ...]:
    """The slips that explain the record best, of inputs, of outputs, or of either where nothing tells them apart."""
    slips = tuple(_output_slips(own))
    outputs = Guess(slips, own.mended(slips).away) if slips else None
    close = [guess for guess in tried if guess.away < BETTER * min(own.away, 1.0)]
    inputs = min(close, key=lambda guess: guess.away, default=None)
    if inputs:  # what does as well without an input says nothing of its sign or unit
        inputs = next((guess for guess in close if guess.slips[0].factor == 0.0 and _equal(guess, inputs)), inputs)
    alone = len(plant.commanded) == 1 and len(own.channels) == 1
    if alone and outputs and not (inputs and _equal(inputs, outputs)):
        inputs = Guess((_counterpart(plant, slips[0]),), outputs.away)  # whatever moves the only output does it alone
    if not (inputs and outputs):
        return tuple(guess for guess in (inputs, outputs) if guess)
    if not _equal(inputs, outputs):
        return (min(inputs, outputs, key=lambda guess: guess.away),)
    match _noise_is_scaled(plant, own, slips[0]) if alone else None:
        case None:
            return (inputs, outputs)
        case True:
            return (outputs,)
        case False:
            return (inputs,)


def _equal(one: Guess, other: Guess) -> bool:
    return abs(one.away - other.away) <= TOLD


def _slipped(file: str, guesses: Sequence[Guess]) -> InputError:
    mend = ", or ".join("; ".join(slip.mend for slip in guess.slips) for guess in guesses)
    first = guesses[0].slips[0]
    if len(guesses) == len(guesses[0].slips) == len(first.channels) == 1:
        return InputError(f"looks {first.looks}", file=file, channel=first.channels[0], mend=mend)
    said = ", or ".join("; ".join(map(str, guess.slips)) for guess in guesses)
    return InputError(said, file=file, mend=f"{mend}: these records do not tell which" if len(guesses) > 1 else mend)


def _odd(file: str, guesses: Sequence[Guess]) -> Note:
    """What looks too large or too small by a factor of no known unit, as large missing physics makes it look, too."""
    said = _slipped(file, guesses)
    missing = "an amplifier that saturates or other missing physics as large"
    return Note(file, said.channel or "", f"{said.problem}: {missing}; or else {said.mend}")


def _counterpart(plant: Plant, slip: Slip) -> Slip:
    """What would be wrong with the only input, if the only output were right."""
    channel = next(c for c in plant.inputs if c.name in plant.commanded)
    return _reversed((channel,)) if slip.factor == -1.0 else _off(channel, 1.0 / slip.factor)


def _noise_is_scaled(plant: Plant, own: Compared, slip: Slip) -> bool | None:
    """Whether the noise of the only output is that of another unit, too; None where it is not known or near to neither."""
    level = plant.noise.get(own.channels[0].name, 0.0)
    white = _white(own.y[:, 0])
    if slip.factor == -1.0 or not (level > 0.0 and white > 0.0):
        return None
    size = -float(np.log(slip.factor))
    at = float(np.log(white / level)) / size  # 0: as the plant states it, 1: as much larger as the channel is
    return at > 0.5 if min(abs(at), abs(at - 1.0)) < NEAR else None


def _lost(plant: Plant, e: Experiment, runner: Runner) -> Note:
    """A plant that its own limits stop at once, from every start, is not driven like this; one without limits may be unstable."""
    if plant.limits:
        raise InputError(
            f"driven by the logged inputs, {plant.name} leaves its range at once, wherever in the record it starts;"
            f" {runner.told_until(e.t)}",
            file=e.name,
            mend=f"is it a record of this machine, and are {' and '.join(_driving(plant, e))} in their places and units?",
        )
    return Note(e.name, "", f"a free run of {plant.name} does not last: units and places of channels were not checked by it")


def _check_turns(plant: Plant, e: Experiment) -> None:
    """An angle that moves on its own need not move any output: only its size tells degrees from radians."""
    for channel in plant.inputs:
        turns = channel.unit == "rad" and channel.role == "schedule" and channel.name in e.names
        furthest = float(np.abs(e[channel.name]).max()) if turns else 0.0
        if furthest > TURNS:
            units = sorted(_other_units("rad"), key=lambda other: -other[1])
            near = [other for other in units if furthest * other[1] <= TURNS]
            slip = _in_unit((channel,), *near[0]) if near else _sized((channel,), TURNS / furthest)
            raise _slipped(e.name, [Guess((slip,), 0.0)])


def _trials(plant: Plant, e: Experiment) -> Iterator[Trial]:
    u = _inputs(plant, e)
    yield Trial(None, u)
    for a, b in combinations([plant.input_names.index(name) for name in plant.commanded], 2):
        swapped = u.copy()
        swapped[:, [a, b]] = u[:, [b, a]]
        names = plant.input_names[a], plant.input_names[b]
        looks = "exchanged: the other way round the plant follows the record"
        yield Trial(Slip(names, looks, f"swap {' and '.join(names)}", exchanged=True), swapped)
    for slip in _input_slips(plant):
        scaled = u.copy()
        scaled[:, [plant.input_names.index(name) for name in slip.channels]] *= slip.factor
        yield Trial(slip, scaled)


def _inputs(plant: Plant, e: Experiment) -> np.ndarray:
    """The logged inputs (N, nu), 0 where there is none."""
    return np.column_stack([e[name] if name in e.names else np.zeros(len(e)) for name in plant.input_names])


def _input_slips(plant: Plant) -> Iterator[Slip]:
    """Each input alone, and all of a unit together, upside down, left out, in another unit, or of another size."""
    for unit in dict.fromkeys(c.unit for c in plant.inputs):
        own = [c for c in plant.inputs if c.unit == unit and c.name in plant.commanded]
        for channels in [[c] for c in own] + ([own] if len(own) > 1 else []):
            yield _reversed(channels)
            yield _left_out(channels)
            units = list(_other_units(unit))
            yield from (_in_unit(channels, other, factor) for other, factor in units)
            yield from (_sized(channels, ten) for ten in TENS if not any(_same_size(ten, factor) for _, factor in units))


def _same_size(ratio: float, factor: float) -> bool:
    """Whether a ratio of spreads may be the factor of a unit."""
    return abs(float(np.log(ratio / factor))) < NEAR * abs(float(np.log(factor)))


def _reversed(channels: Sequence[Channel]) -> Slip:
    names = tuple(c.name for c in channels)
    return Slip(names, "reversed in sign", f"multiply {' and '.join(names)} by -1", -1.0)


def _left_out(channels: Sequence[Channel]) -> Slip:
    names = tuple(c.name for c in channels)
    return Slip(names, "cut off, the plant follows the record without", f"connect {' and '.join(names)}", 0.0, sure=False)


def _in_unit(channels: Sequence[Channel], other: str, factor: float) -> Slip:
    names, unit = tuple(c.name for c in channels), channels[0].unit
    header = " and ".join(map(str, channels))
    mend = f"multiply {' and '.join(names)} by {factor:.6g} and write {header} in the header"
    return Slip(names, f"like {other}, expected {unit}", mend, factor)


def _off(channel: Channel, factor: float) -> Slip:
    """A channel that must be multiplied by about `factor`: in another unit, if there is one of that size."""
    units = dict(_other_units(channel.unit))
    other = min(units, key=lambda name: abs(float(np.log(factor / units[name]))), default="")
    named = other and _same_size(factor, units[other])
    return _in_unit((channel,), other, units[other]) if named else _sized((channel,), factor)


def _sized(channels: Sequence[Channel], factor: float) -> Slip:
    """Channels of another size by a factor of no unit that is known."""
    names = tuple(c.name for c in channels)
    size = f"{_two_digits(1.0 / factor)} times too large" if factor < 1.0 else f"{_two_digits(factor)} times too small"
    unit = channels[0].unit or "the plant's unit"
    mend = f"bring {' and '.join(names)} to {unit} (another size of unit, times {_two_digits(factor)} or so)"
    return Slip(names, size, mend, factor, sure=False)


def _two_digits(number: float) -> str:
    return f"{float(f'{number:.2g}'):g}"


def _other_units(unit: str) -> Iterator[tuple[str, float]]:
    """Units of the same quantity that can be told by size, with the factor that brings them to `unit`."""
    own = UNITS.get(unit)
    for name, other in UNITS.items():
        if own and other.quantity == own.quantity and abs(np.log(other.factor / own.factor)) > np.log(APART):
            yield name, other.factor / own.factor


def _until_it_leaves(plant: Plant, e: Experiment, run: np.ndarray) -> Compared:
    """The run (N, ny) beside the record, over no samples where it leaves the plant's range too soon to be compared with."""
    seen = [i for i, name in enumerate(plant.output_names) if name in e.names and np.ptp(e[name]) > 0.0]
    lasts = first_outside(run)
    n = lasts if lasts > max(LEAVES * len(e), 20) else 0
    channels = tuple(plant.outputs[i] for i in seen)
    return Compared(e.name, channels, e[[c.name for c in channels]][:n], run[:n][:, seen])


def _output_slips(own: Compared) -> Iterator[Slip]:
    """Of outputs that follow the run upside down, or at another size than missing physics gives them."""
    for channel, y, z in zip(own.channels, own.y.T, own.z.T, strict=True) if len(own.y) else ():
        like = nearest(y, z)
        if like.correlation < UNLIKE and nearest(-y, z).correlation > ALIKE:
            yield _reversed((channel,))
        if like.correlation < ALIKE:
            continue
        if abs(np.log(like.ratio)) > np.log(APART):
            yield _off(channel, 1.0 / like.ratio)


def _check_limits(plant: Plant, e: Experiment, channels: tuple[Channel, ...]) -> None:
    """A measured state that is outside what the plant's equation is for at half of the samples or more."""
    for channel in channels:
        low, high = plant.read_limits.get(channel.name, (-np.inf, np.inf))
        middle = float(np.median(e[channel.name]))
        if low <= middle <= high:
            continue
        for other, factor in _other_units(channel.unit):
            if low <= middle * factor <= high:
                raise _slipped(e.name, [Guess((_in_unit((channel,), other, factor),), 0.0)])
        if low <= -middle <= high:
            raise _slipped(e.name, [Guess((_reversed((channel,)),), 0.0)])
        raise InputError(
            f"is {middle:.4g} {channel.unit} half of the time, {plant.name} stays within [{low:g}, {high:g}] {channel.unit}",
            file=e.name,
            channel=channel.name,
            mend="is it a record of this machine?",
        )


def _check_places(plant: Plant, e: Experiment, own: Compared) -> None:
    d = np.array([[likeness(y, z).distance + _level(y, z) for z in own.z.T] for y in own.y.T])
    for i, j in combinations(range(len(d)), 2):
        as_is, exchanged = d[i, i] + d[j, j], d[i, j] + d[j, i]
        if max(d[i, j], d[j, i]) < 0.5 and exchanged < 0.3 * as_is and as_is > 1.0:
            names = own.channels[i].name, own.channels[j].name
            said, mend = (
                f"{' and '.join(names)} look exchanged: each follows the other's simulation",
                f"swap {' and '.join(names)}",
            )
            if _holds_in_windows(plant, e, Guess((Slip(names, said, mend, exchanged=True),), 0.0)):
                raise InputError(said, file=own.file, mend=mend)


def _level(y: np.ndarray, z: np.ndarray) -> float:
    """Distance of the means in spreads, 1 at most."""
    return min(abs(float(np.mean(y) - np.mean(z))) / float(np.std(y) + np.std(z)), 1.0)


def _unexplained(plant: Plant, e: Experiment, own: Compared, runner: Runner, slips: Sequence[Slip]) -> Iterator[Note]:
    """Refuse what the plant explains in no channel, unless nothing gets through to the outputs, or only peaks of inputs do.

    slips: of inputs, one of which may explain within windows what no run of the whole record does.
    """
    if own.follows >= UNLIKE or not own.counted:
        return
    names, inputs = ", ".join(own.channels[i].name for i in own.counted), " and ".join(_driving(plant, e))
    if not any(_moves(own.y[:, i]) for i in own.counted):
        yield Note(own.file, names, f"moves no more than its noise: a dead zone or dry friction may take all of {inputs}")
        return
    if max(run.follows for run in _whole(plant, e, runner, [trial.u for trial in _peaks(plant, e)])) >= ALIKE:
        yield Note(own.file, names, f"follows the peaks of {inputs} only: a dead zone or dry friction may take the rest")
        return
    within = _forced(plant, e, runner, runner.u).follows
    if within >= UNLIKE:
        said = f"{names} follows {plant.name} within short windows (correlation {within:.2f}), not over the whole record"
        yield Note(own.file, names, f"{said}: {runner.told_until(e.t)}")
        return
    as_is = _forced(plant, e, runner, runner.u).away
    for slip in slips:
        mended = _mended(e, (slip,))
        better = Runner.of(plant, mended)
        if _forced(plant, mended, better, better.u).away < BETTER * min(as_is, 1.0):
            alone = len(plant.commanded) == len(own.channels) == 1  # whatever moves the only output does it alone
            either = [slip, _reversed(own.channels)] if alone else [slip]
            raise _slipped(e.name, [Guess((one,), 0.0) for one in either])
    said = (
        f"{plant.name}, driven by the logged inputs, follows none of {names} (correlation at most {max(own.follows, within):.2f},"
        f" over the whole record and within short windows); {runner.told_until(e.t)}"
    )
    u = e[[name for name in _driving(plant, e) if np.ptp(e[name]) > 0.0]]
    related = [_related(u, e[own.channels[i].name]) for i in own.counted]
    if None in related:  # what says nothing about the record says nothing against it
        yield Note(own.file, names, f"{said}; and the record is too short to tell whether it moves with {inputs} at all")
        return
    pushed = max(_pushes(u, e[own.channels[i].name]) for i in own.counted)
    if max(share for share in related if share is not None) > RELATED or pushed > PUSHED:
        yield Note(own.file, names, f"{said}; but it moves with {inputs}: another machine, or one of which the plant lacks much")
        return
    raise InputError(
        said,
        file=own.file,
        mend="is it a record of this machine, and are the channels in their places?",
    )


def _related(u: np.ndarray, y: np.ndarray) -> float | None:
    """Share of y (N,) that moving averages of inputs u (N, nu), and their products, explain of the half they are not fitted to.

    A sensor without a sign, or a thrust of u^2, is even in what drives it. None where a half holds too few samples to fit them.
    """
    total = np.vstack([np.zeros(u.shape[1]), np.cumsum((u - u.mean(axis=0)) / u.std(axis=0), axis=0)])
    k = np.arange(1, len(u) + 1)
    lengths = [2**i for i in range(12) if 2**i <= len(u) // 8]
    means = np.hstack([(total[k] - total[np.maximum(k - n, 0)]) / np.sqrt(n) for n in lengths])
    pairs = [means[:, i] * means[:, j] for i in range(means.shape[1]) for j in range(i, means.shape[1])]
    Psi = np.column_stack([np.ones(len(u)), means, *pairs])
    half, shares = len(u) // 2, []
    if half < PER_WEIGHT * Psi.shape[1]:
        return None
    for own, other in ((slice(half), slice(half, None)), (slice(half, None), slice(half))):
        spread = np.std(y[own]) or 1.0
        ridge = np.sqrt(len(Psi)) * 0.1 * np.eye(Psi.shape[1])
        aim = np.concatenate([(y[own] - y[own].mean()) / spread, np.zeros(Psi.shape[1])])
        predicted = spread * Psi[other] @ np.linalg.lstsq(np.vstack([Psi[own], ridge]), aim, rcond=None)[0]
        shares.append(np.sign(c := likeness(y[other], predicted).correlation) * c**2)
    return float(min(shares))


def _pushes(u: np.ndarray, y: np.ndarray) -> float:
    """Share of the errors of y (N,), predicted from its own past, that inputs u (N, nu) take off in the half not fitted to.

    What balances a pendulum, or fills a tank, moves its rate: averages of it say nothing of where that is.
    """
    shares = [0.0]
    for stride in STRIDES:
        n = len(y) // stride
        own, by = y[: n * stride].reshape(n, stride).mean(axis=1), u[: n * stride].reshape(n, stride, -1).mean(axis=1)
        past = np.column_stack([own[PAST - j : n - j] for j in range(1, PAST + 1)] + [np.ones(n - PAST)])
        both = np.hstack([past, *(by[PAST - j : n - j] for j in range(PAST + 1))])
        half = (n - PAST) // 2
        if half < PER_WEIGHT * both.shape[1]:
            break
        for fitted, other in ((slice(half), slice(half, None)), (slice(half, None), slice(half))):
            aim = own[PAST:]
            left = [
                float(np.sum((aim[other] - Psi[other] @ np.linalg.lstsq(Psi[fitted], aim[fitted], rcond=None)[0]) ** 2))
                for Psi in (past, both)
            ]
            shares.append(1.0 - left[1] / left[0] if left[0] > 0.0 else 0.0)
    return max(shares)


def _peaks(plant: Plant, e: Experiment) -> Iterator[Trial]:
    """What dead zones of several widths leave of the inputs."""
    u = _inputs(plant, e)
    own = [plant.input_names.index(name) for name in _driving(plant, e)]
    for share in EATEN:
        width = np.quantile(np.abs(u[:, own]), share, axis=0)
        left = u.copy()
        left[:, own] -= np.clip(u[:, own], -width, width)
        yield Trial(None, left)


def _actuators(plant: Plant, e: Experiment) -> Iterator[np.ndarray]:
    """The inputs (N, nu) as they are, and what limits and dead zones of several widths, and other gains, leave of each."""
    u = _inputs(plant, e)
    yield u
    for i in (plant.input_names.index(name) for name in _driving(plant, e)):
        widths = np.quantile(np.abs(u[:, i]), (*LEFT, *EATEN))
        limited = [np.clip(u[:, i], -width, width) for width in widths]
        for own in (*limited, *(u[:, i] - part for part in limited), *(gain * u[:, i] for gain in GAINS)):
            acting = u.copy()
            acting[:, i] = own
            yield acting
