"""Slips of the hand: a sign, a unit, a size or a place that is wrong, how it is said and what mends it."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from workbench.data import Channel, Experiment
from workbench.errors import InputError
from workbench.records import field, record
from workbench.units import UNITS

NEAR = 0.25  # a ratio of spreads is a unit's factor f if it is within f**NEAR of it
APART = 6.0  # units closer to each other than this factor are not told by size


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
class Guess:
    """Slips that were made together, and how far record and run are apart where all of them are mended."""

    slips: tuple[Slip, ...]
    away: float = field("")


def mended_record(e: Experiment, slips: Sequence[Slip]) -> Experiment:
    """The record as it would be without these slips."""
    values = e.values.copy()
    for slip in slips:
        at = [e.names.index(name) for name in slip.channels]
        values[:, at] = values[:, at[::-1]] if slip.exchanged else values[:, at] * slip.factor
    return replace(e, values=values)


def slip_error(file: str, guesses: Sequence[Guess]) -> InputError:
    mend = ", or ".join("; ".join(slip.mend for slip in guess.slips) for guess in guesses)
    first = guesses[0].slips[0]
    if len(guesses) == len(guesses[0].slips) == len(first.channels) == 1:
        return InputError(f"looks {first.looks}", file=file, channel=first.channels[0], mend=mend)
    said = ", or ".join("; ".join(map(str, guess.slips)) for guess in guesses)
    return InputError(said, file=file, mend=f"{mend}: these records do not tell which" if len(guesses) > 1 else mend)


def reversed_sign(channels: Sequence[Channel]) -> Slip:
    names = tuple(c.name for c in channels)
    return Slip(names, "reversed in sign", f"multiply {' and '.join(names)} by -1", -1.0)


def left_out(channels: Sequence[Channel]) -> Slip:
    names = tuple(c.name for c in channels)
    return Slip(names, "cut off, the plant follows the record without", f"connect {' and '.join(names)}", 0.0, sure=False)


def in_other_unit(channels: Sequence[Channel], other: str, factor: float) -> Slip:
    names, unit = tuple(c.name for c in channels), channels[0].unit
    header = " and ".join(map(str, channels))
    mend = f"multiply {' and '.join(names)} by {factor:.6g} and write {header} in the header"
    return Slip(names, f"like {other}, expected {unit}", mend, factor)


def off_by(channel: Channel, factor: float) -> Slip:
    """A channel that must be multiplied by about `factor`: in another unit, if there is one of that size."""
    units = dict(other_units(channel.unit))
    other = min(units, key=lambda name: abs(float(np.log(factor / units[name]))), default="")
    named = other and same_size(factor, units[other])
    return in_other_unit((channel,), other, units[other]) if named else of_other_size((channel,), factor)


def of_other_size(channels: Sequence[Channel], factor: float) -> Slip:
    """Channels of another size by a factor of no unit that is known."""
    names = tuple(c.name for c in channels)
    size = f"{_two_digits(1.0 / factor)} times too large" if factor < 1.0 else f"{_two_digits(factor)} times too small"
    unit = channels[0].unit or "the plant's unit"
    mend = f"bring {' and '.join(names)} to {unit} (another size of unit, times {_two_digits(factor)} or so)"
    return Slip(names, size, mend, factor, sure=False)


def _two_digits(number: float) -> str:
    return f"{float(f'{number:.2g}'):g}"


def other_units(unit: str) -> Iterator[tuple[str, float]]:
    """Units of the same quantity that can be told by size, with the factor that brings them to `unit`."""
    own = UNITS.get(unit)
    for name, other in UNITS.items():
        if own and other.quantity == own.quantity and abs(np.log(other.factor / own.factor)) > np.log(APART):
            yield name, other.factor / own.factor


def same_size(ratio: float, factor: float) -> bool:
    """Whether a ratio of spreads may be the factor of a unit."""
    return abs(float(np.log(ratio / factor))) < NEAR * abs(float(np.log(factor)))
