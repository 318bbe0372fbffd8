"""The numbers of a scheduled PID as tables of constants, with their meaning and units, which both languages share."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from controllers.scheduled_pid import BackCalculation, Compensation, ScheduledPID
from workbench.basis import Basis, Gaussian, PiecewiseLinear, Powers, Products
from workbench.curves import Curve
from workbench.physics.controller import schedules_of


class Table(NamedTuple):
    """A constant of the law: its dimensions as they are called in the text, its numbers, and a comment for each of its rows.

    whole: its numbers are indices, counted from 0. wide: they are kept in double precision everywhere.
    """

    name: str
    sizes: tuple[str, ...]
    values: np.ndarray
    comment: str
    rows: tuple[str, ...] = ()
    whole: bool = False
    wide: bool = False


def tables(law: ScheduledPID) -> list[Table]:
    """Every number of the law with its meaning and unit; a scheduled gain has a row of coefficients for each pair of channels."""
    outputs, inputs, decay = channels(law, law.measured), channels(law, law.actuated), law.Tf / (law.Tf + law.dt)
    return [
        Table("PERIOD", (), np.array(law.dt), "sample time, s"),
        *([_span(law), *_scheduling(law)] if law.schedule else []),
        _gains(law, "Kp", "proportional gains", ""),
        _gains(law, "Ki", "integral gains", "/s"),
        _gains(law, "Kd", "derivative gains", " s"),
        _gains(law, "Kr", "feedforward of the set-points", ""),
        *([_gains(law, "Ka", "feedforward of the set-points' rates", " s")] if law.shaped else []),
        *([_gains(law, "Kaa", "feedforward of the set-points' accelerations", " s^2")] if law.Kaa.any() else []),
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
        *(_shaping(law) if law.shaped else []),
        *(_awaited(law) if law.awaits else []),
        *(table for k, own in enumerate(law.compensations, 1) for table in _compensation(law, k, own)),
        *(_inverses(law) if law.inverses else []),
        *(table for i, own in curves_by_number(law) for table in _curve(law, i, own)),
    ]


def _awaited(law: ScheduledPID) -> list[Table]:
    """What makes l of m."""
    outputs, (lags, shares) = channels(law, law.measured), law.lags
    return [
        Table("LAG", ("NY",), lags, f"whole samples of dead times: {outputs}", whole=True),
        Table("LAG_SHARE", ("NY",), shares, "of one sample more", wide=True),
        Table("PLAY", ("NY",), law.play, f"half widths of the play of sensors: {outputs}", wide=True),
    ]


def _inverses(law: ScheduledPID) -> list[Table]:
    """What inverts dead zones and play of actuators; 0 for a command without."""
    own, inputs = np.zeros((3, len(law.actuated))), channels(law, law.actuated)
    for inverse in law.inverses:
        own[:, law.actuated.index(inverse.input)] = inverse.numbers
    said = "; ".join(f"inverse of {inverse.effect}" for inverse in law.inverses)
    return [
        Table("HALF_WIDTH", ("NU",), own[0], f"{said}: half widths of dead zones: {inputs}"),
        Table("GEAR_PLAY", ("NU",), own[1], "impulses that are lost from flank to flank"),
        Table("KEEP", ("NU",), own[2], "sizes of a command up to which its side stays"),
    ]


def curves_by_number(law: ScheduledPID) -> list[tuple[int, Curve]]:
    """The curves of a law by the number of their command, from 1 on."""
    return [(law.actuated.index(own.input) + 1, own) for own in law.curves]


def _curve(law: ScheduledPID, i: int, curve: Curve) -> list[Table]:
    own, size = channel(law, curve.input), (f"NODES_{i}",)
    return [
        Table(f"CURVE_{i}_U", size, curve.u, f"nodes of the curve of {own}"),
        Table(f"CURVE_{i}_V", size, curve.v, f"what arrives of {own} at them; linear between and on at both ends"),
    ]


def _compensation(law: ScheduledPID, k: int, own: Compensation) -> list[Table]:
    """What is added to a command by a curve over the motion of the set-points."""
    size, over, to = (f"POINTS_{k}",), own.over or "s", channel(law, own.input)
    moved = [Table(f"MOTION_{k}", ("NY",), own.motion, "and of their rates, s")] if law.shaped else []
    return [
        Table(f"POSITION_{k}", ("NY",), own.position, f"{over} of the set-points {channels(law, law.references)}"),
        *moved,
        Table(f"ADDED_{k}_AT", size, own.curve.u, f"compensation of {own.effect}: nodes over {over}"),
        Table(f"ADDED_{k}", size, own.curve.v, f"what is added to {to} at them; linear between and on at both ends"),
    ]


def _shaping(law: ScheduledPID) -> list[Table]:
    """What makes reference models, their rates and accelerations of the set-points."""
    rows = tuple(
        f"{own}: {'a path' if path else 'none' if w == np.inf else f'{w:g} rad/s'}"
        for own, w, path in zip(law.references, law.bandwidth, law.paths.tolist(), strict=True)
    )
    model = "reference models: what m and its rate n are of the last m and n and of s"
    change = "what accelerations are of s - m, of n and of the last n"
    return [
        Table(
            "SLEW", ("NY",), law.slew, f"largest rates of the set-points, per second: {channels(law, law.references)}", wide=True
        ),
        Table("MODEL", ("NY", "6"), law.reference_model, model, rows, wide=True),
        *([Table("AT_SETPOINT", ("NY",), 1.0 * law.paths, "1: starts at the set-point, 0: at y")] if law.paths.any() else []),
        *([Table("CHANGE", ("NY", "3"), law.acceleration, change, law.references, wide=True)] if law.Kaa.any() else []),
    ]


def _span(law: ScheduledPID) -> Table:
    own, held = tuple(channel(law, name) for name in schedules_of(law)), "outside, the gains hold their edge value"
    if law.span.ndim == 1:
        return Table("SPAN", ("2",), law.span, f"{own[0]}; {held}")
    return Table("SPAN", ("NS", "2"), law.span, f"of the schedule variables; {held}", own)


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


def _scheduling(law: ScheduledPID) -> list[Table]:
    """The numbers of the basis; of several variables those of each, their names numbered, and which of them are multiplied."""
    variables = [channel(law, name) for name in schedules_of(law)]
    if not isinstance(law.basis, Products):
        return _basis_tables(law.basis, variables[0])
    found = []
    for i, (factor, at) in enumerate(zip(law.basis.factors, variables, strict=True), 1):
        for own in _basis_tables(factor, at):
            sizes = tuple(f"{size}_{i}" for size in own.sizes)
            found.append(own._replace(name=f"{own.name}_{i}", sizes=sizes))
    said = "the functions of each variable that make a weight"
    return [*found, Table("CHOSEN", ("TERMS", "NS"), law.basis.chosen, said, law.basis.names, whole=True)]


def _basis_tables(basis: Basis, at: str) -> list[Table]:
    match basis:
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
    common = {"NU": nu, "NY": ny} | {f"NODES_{i}": len(own.u) for i, own in curves_by_number(law)}
    common |= {f"POINTS_{k}": len(own.curve.u) for k, own in enumerate(law.compensations, 1)}
    common |= {"LAGS": int(law.lags[0].max()) + 1} if law.awaits else {}
    if not law.schedule:
        return common
    if not isinstance(law.basis, Products):
        return common | _basis_sizes(law.basis)
    each = [{f"{key}_{i}": n for key, n in _basis_sizes(own).items()} for i, own in enumerate(law.basis.factors, 1)]
    return common | {"NS": len(each), "TERMS": m} | {key: n for own in each for key, n in own.items()}


def _basis_sizes(basis: Basis) -> dict[str, int]:
    bells = {"BELLS": len(basis.centres)} if isinstance(basis, Gaussian) else {}
    return {"TERMS": len(basis.names)} | bells


def channel(law: ScheduledPID, name: str) -> str:
    """Name with unit, where the law knows it."""
    unit = law.unit(name)
    return f"{name} [{unit}]" if unit else name


def channels(law: ScheduledPID, names: Sequence[str]) -> str:
    return ", ".join(channel(law, name) for name in names)
