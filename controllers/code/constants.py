"""The numbers of a scheduled PID as tables of constants, with their meaning and units, which both languages share."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from controllers.scheduled_pid import BackCalculation, ScheduledPID
from workbench.basis import Gaussian, PiecewiseLinear, Powers


class Table(NamedTuple):
    """A constant of the law: its dimensions as they are called in the text, its numbers, and a comment for each of its rows."""

    name: str
    sizes: tuple[str, ...]
    values: np.ndarray
    comment: str
    rows: tuple[str, ...] = ()


def tables(law: ScheduledPID) -> list[Table]:
    """Every number of the law with its meaning and unit; a scheduled gain has a row of coefficients for each pair of channels."""
    outputs, inputs, decay = channels(law, law.measured), channels(law, law.actuated), law.Tf / (law.Tf + law.dt)
    span = f"{channel(law, law.schedule)}; outside, the gains hold their edge value" if law.schedule else ""
    return [
        Table("PERIOD", (), np.array(law.dt), "sample time, s"),
        *([Table("SPAN", ("2",), law.span, span), *_basis_tables(law)] if law.schedule else []),
        _gains(law, "Kp", "proportional gains", ""),
        _gains(law, "Ki", "integral gains", "/s"),
        _gains(law, "Kd", "derivative gains", " s"),
        _gains(law, "Kr", "feedforward of the set-points", ""),
        _u0(law),
        Table("B", ("NY",), law.b, f"set-point weights of the proportional part: {outputs}"),
        Table("C", ("NY",), law.c, f"set-point weights of the derivative part: {outputs}"),
        Table("DECAY", (), np.array(decay), f"Tf / (Tf + PERIOD), Tf = {law.Tf:g} s filters the derivative"),
        Table("FRESH", (), np.array((1.0 - decay) / law.dt), "(1 - DECAY) / PERIOD, 1/s"),
        Table("LOW", ("NU",), law.low, f"lowest commands: {inputs}"),
        Table("HIGH", ("NU",), law.high, f"highest commands: {inputs}"),
        Table("RATE", ("NU",), law.rate, f"largest rates, per second: {inputs}"),
        *(
            [Table("TRACKING", ("NU",), law.tracking, "time constants with which z follows a limited command, s")]
            if isinstance(law.anti_windup, BackCalculation)
            else []
        ),
    ]


def _gains(law: ScheduledPID, key: str, comment: str, time: str) -> Table:
    K, own = getattr(law, key), lambda a, m: f"{m} {law.gain_unit(a, m, time)}".rstrip()
    if law.schedule is None:
        rows = tuple(f"{a} from {', '.join(own(a, m) for m in law.measured)}" for a in law.actuated)
        return Table(key.upper(), ("NU", "NY"), K[0], comment, rows)
    rows = tuple(f"{a} from {own(a, m)}" for a in law.actuated for m in law.measured)
    return Table(key.upper(), ("NU", "NY", "TERMS"), np.moveaxis(K, 0, -1), comment, rows)


def _u0(law: ScheduledPID) -> Table:
    comment, rows = "commands where there is no error and no set-point", tuple(channel(law, a) for a in law.actuated)
    if law.schedule is None:
        return Table("U0", ("NU",), law.u0[0], f"{comment}: {', '.join(rows)}")
    return Table("U0", ("NU", "TERMS"), law.u0.T, comment, rows)


def _basis_tables(law: ScheduledPID) -> list[Table]:
    at = channel(law, law.schedule or "")
    match law.basis:
        case PiecewiseLinear(knots=knots) if len(knots) > 1:
            return [Table("KNOTS", ("TERMS",), knots, f"{at}; the gains are linear between")]
        case Gaussian(centres=centres, beta=beta) if len(centres):
            return [Table("CENTRES", ("BELLS",), centres, at), Table("BETA", ("BELLS",), beta, f"1 / square of {at}")]
        case Powers(scale=scale):
            return [Table("SCALE", (), np.array(scale), f"{at} whose powers are 1")]
    return []


def table_sizes(law: ScheduledPID) -> dict[str, int]:
    """Sizes by the names that they have in the texts."""
    m, nu, ny = law.Kp.shape
    bells = {"BELLS": len(law.basis.centres)} if isinstance(law.basis, Gaussian) else {}
    return {"NU": nu, "NY": ny} | ({"TERMS": m} | bells if law.schedule else {})


def channel(law: ScheduledPID, name: str) -> str:
    """Name with unit, where the law knows it."""
    unit = law.unit(name)
    return f"{name} [{unit}]" if unit else name


def channels(law: ScheduledPID, names: Sequence[str]) -> str:
    return ", ".join(channel(law, name) for name in names)
