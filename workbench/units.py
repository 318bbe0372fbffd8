"""Units of channels: which quantity they are of, by what factor they differ, and that nothing in one is taken for another."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace

from workbench.data import Channel, Dataset, Experiment
from workbench.errors import InputError
from workbench.records import record


@record
class Unit:
    """x of this unit are factor x + zero of the SI unit of its quantity."""

    quantity: str
    factor: float
    zero: float = 0.0


UNITS: dict[str, Unit] = {
    "s": Unit("time", 1.0),
    "ms": Unit("time", 1e-3),
    "us": Unit("time", 1e-6),
    "min": Unit("time", 60.0),
    "h": Unit("time", 3600.0),
    "rad": Unit("angle", 1.0),
    "mrad": Unit("angle", 1e-3),
    "deg": Unit("angle", math.pi / 180),
    "°": Unit("angle", math.pi / 180),
    "turn": Unit("angle", 2 * math.pi),
    "rad/s": Unit("angular velocity", 1.0),
    "deg/s": Unit("angular velocity", math.pi / 180),
    "rpm": Unit("angular velocity", math.pi / 30),
    "1/min": Unit("angular velocity", math.pi / 30),
    "m": Unit("length", 1.0),
    "mm": Unit("length", 1e-3),
    "cm": Unit("length", 1e-2),
    "um": Unit("length", 1e-6),
    "km": Unit("length", 1e3),
    "in": Unit("length", 0.0254),
    "m/s": Unit("velocity", 1.0),
    "mm/s": Unit("velocity", 1e-3),
    "cm/s": Unit("velocity", 1e-2),
    "m/min": Unit("velocity", 1 / 60),
    "km/h": Unit("velocity", 1 / 3.6),
    "V": Unit("voltage", 1.0),
    "mV": Unit("voltage", 1e-3),
    "kV": Unit("voltage", 1e3),
    "A": Unit("current", 1.0),
    "mA": Unit("current", 1e-3),
    "N": Unit("force", 1.0),
    "mN": Unit("force", 1e-3),
    "kN": Unit("force", 1e3),
    "kgf": Unit("force", 9.80665),
    "N m": Unit("torque", 1.0),
    "Nm": Unit("torque", 1.0),
    "N*m": Unit("torque", 1.0),
    "mNm": Unit("torque", 1e-3),
    "kg": Unit("mass", 1.0),
    "g": Unit("mass", 1e-3),
    "Pa": Unit("pressure", 1.0),
    "kPa": Unit("pressure", 1e3),
    "MPa": Unit("pressure", 1e6),
    "mbar": Unit("pressure", 1e2),
    "bar": Unit("pressure", 1e5),
    "psi": Unit("pressure", 6894.757293168),
    "m^3/s": Unit("flow", 1.0),
    "m3/s": Unit("flow", 1.0),
    "m^3/h": Unit("flow", 1 / 3600),
    "m3/h": Unit("flow", 1 / 3600),
    "l/s": Unit("flow", 1e-3),
    "l/min": Unit("flow", 1e-3 / 60),
    "l/h": Unit("flow", 1e-3 / 3600),
    "K": Unit("temperature", 1.0),
    "degC": Unit("temperature", 1.0, 273.15),
    "°C": Unit("temperature", 1.0, 273.15),
    "degF": Unit("temperature", 5 / 9, 273.15 - 32 * 5 / 9),
    "°F": Unit("temperature", 5 / 9, 273.15 - 32 * 5 / 9),
}


def check_units(experiment: Experiment, expected: Mapping[str, str]) -> Experiment:
    """Refuse channels of a record whose unit is not the one expected (channel name -> unit), and say by what to multiply.

    A channel without a unit is taken to have the one expected; names that are not in the record are left alone.
    Returns the record unchanged; raises InputError with the factor, or with the two quantities where they differ.
    """
    for channel in experiment.channels:
        unit = expected.get(channel.name, "")
        if why := differ(channel.unit, unit):
            straight, head = _straight(channel.unit, unit), f"[{unit}] in the header"
            convert = f"{_said(*straight)} and write {channel.name} {head}" if straight else ""
            mend = convert or f"{why}: is this the right column? else convert it and write {head}"
            problem = f"unit is {channel.unit}, expected {unit}"
            raise InputError(problem, file=experiment.name, channel=channel.name, mend=mend)
    return experiment


def in_units(records: Dataset, expected: Mapping[str, str]) -> Dataset:
    """Records in the units expected (channel name -> unit), by what their headers say: each channel that was converted is in the
    notes of its record.

    A set-point, NAME_set, is brought to the unit of its channel. What has no unit, or one that cannot be converted, is left as it
    is: `check_units` refuses that.

        >>> log = Experiment.from_arrays("a", 1.0, outputs={"w": np.array([0.0, 30.0])}, units={"w": "rpm"})
        >>> own = in_units(Dataset((log,)), {"w": "rad/s"}).experiments[0]
        >>> own["w"].round(3).tolist(), own.notes
        ([0.0, 3.142], ('w: rpm by its header, taken times 0.1047197551 as rad/s',))
    """
    expected = {f"{name}_set": unit for name, unit in expected.items()} | dict(expected)
    return Dataset(tuple(_converted(e, expected) for e in records))


def _converted(e: Experiment, expected: Mapping[str, str]) -> Experiment:
    channels, values, notes = list(e.channels), e.values, list(e.notes)
    for i, c in enumerate(e.channels):
        unit = expected.get(c.name, "")
        straight = _straight(c.unit, unit) if differ(c.unit, unit) else None
        if straight is None:
            continue
        factor, zero = straight
        values = values.copy() if values is e.values else values
        values[:, i] = factor * values[:, i] + zero
        channels[i] = replace(c, unit=unit)
        notes.append(f"{c.name}: {c.unit} by its header, taken times {factor:.10g}{f' {zero:+.10g}' * bool(zero)} as {unit}")
    return e if values is e.values else replace(e, channels=tuple(channels), values=values, notes=tuple(notes))


def check_law_units(law: object, channels: Iterable[Channel], file: str) -> None:
    """Refuse a law that was made for other units than a loop's channels have; one that names no units is taken as it is."""
    made_for = getattr(law, "units", {})
    for c in channels:
        if differ(own := made_for.get(c.name, ""), c.unit):
            said = f"in {c.unit}, {getattr(law, 'name', 'the law')} was made for {own}"
            raise InputError(said, file=file, channel=c.name, mend="design a law in the units of this loop")


def differ(unit: str, expected: str) -> str:
    """How two units differ, in words; "" where they are one, or one is not known."""
    if not unit or not expected or unit == expected:
        return ""
    found, wanted = UNITS.get(unit), UNITS.get(expected)
    if found is None or wanted is None:
        return f"no conversion from {unit} to {expected} is known"
    if found.quantity != wanted.quantity:
        return f"{unit} is a {found.quantity}, {expected} a {wanted.quantity}"
    if math.isclose(found.factor, wanted.factor) and found.zero == wanted.zero:
        return ""
    factor, zero = _straight(unit, expected) or (1.0, 0.0)
    return f"1 {unit} is {factor + zero:.10g} {expected}"


def _straight(unit: str, expected: str) -> tuple[float, float] | None:
    """Factor and zero with which a column in `unit` is one in `expected`; None where that is not known, or makes no sense."""
    found, wanted = UNITS.get(unit), UNITS.get(expected)
    if found is None or wanted is None or found.quantity != wanted.quantity:
        return None
    return found.factor / wanted.factor, (found.zero - wanted.zero) / wanted.factor


def _said(factor: float, zero: float) -> str:
    return f"multiply the column by {factor:.10g}" + f", add {zero:.10g}" * bool(zero)
