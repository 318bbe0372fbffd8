"""What to begin with on a machine of which only records are known: a plant of rough lags, and limits about what was seen."""

import json
import re
from collections.abc import Mapping, Sequence
from keyword import iskeyword

import numpy as np

from workbench.data import Channel, Dataset
from workbench.errors import InputError
from workbench.records import record


@record
class _Lag:
    """T y' = c + k u - y of one output, fitted roughly: T [s], k (nu), c."""

    time: float
    gains: tuple[float, ...]
    offset: float


@record
class Beginning:
    """The texts of plant.py and limits.toml, and the channels by role: inputs, outputs, schedules."""

    plant: str
    limits: str
    roles: tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]


def beginning(name: str, data: Dataset) -> Beginning:
    """A plant called `name` of a first-order lag for each output, and limits, both guessed from records whose roles are known.

    Raises InputError where there is no input or output, or where a channel's name is none in an equation.
    """
    first = data.experiments[0]
    of = {role: [first.channel(n) for n in first.names_of(role)] for role in ("input", "output", "schedule")}
    inputs, outputs, schedules = (tuple(c.name for c in own) for own in of.values())
    for role in ("input", "output"):
        if not of[role]:
            raise InputError(f"which channel is an {role}?", file=first.file, mend=f"give --{role}s, of {', '.join(first.names)}")
    if odd := [channel for channel in (*inputs, *outputs, *schedules) if not channel.isidentifier() or iskeyword(channel)]:
        mend = "give it a name of letters, digits and _ in the header of the file"
        raise InputError(f"channel {odd[0]!r} cannot be a name in an equation", file=first.file, mend=mend)
    lags = {y: _lag(data, y, inputs) for y in outputs}
    return Beginning(
        _plant_text(name, of, lags, first.dt), _limits_text(data, of["input"], of["output"]), (inputs, outputs, schedules)
    )


def _lag(data: Dataset, output: str, inputs: Sequence[str]) -> _Lag:
    """Least squares of y(k+q) = a y(k) + b u(k) + c at that of a few steps q whose free runs follow the records best."""
    from scipy.signal import lfilter

    found: list[tuple[float, _Lag]] = []
    for q in (1, 2, 5, 10, 20, 50):
        parts = [(e[output][::q], np.column_stack([e[u][::q] for u in inputs]), q * e.dt) for e in data if len(e) > 5 * q]
        if not parts:
            continue
        X = np.vstack([np.column_stack([y[:-1], U[:-1], np.ones(len(y) - 1)]) for y, U, _ in parts])
        a, *b, c = np.linalg.lstsq(X, np.concatenate([y[1:] for y, _, _ in parts]), rcond=None)[0].tolist()
        if not 0.0 < a < 1.0:
            continue
        lag = _Lag(-parts[0][2] / np.log(a), tuple(g / (1.0 - a) for g in b), c / (1.0 - a))
        runs = [np.append(y[0], lfilter([1.0], [1.0, -a], U[:-1] @ b + c, zi=[a * y[0]])[0]) for y, U, _ in parts]
        errors = [float(np.mean((run - y) ** 2)) for run, (y, _, _) in zip(runs, parts, strict=True)]
        found.append((float(np.mean(errors)), lag))
    if found:
        return min(found, key=lambda pair: pair[0])[1]
    e = data.experiments[0]  # nothing settles: a start that the user's equation replaces
    return _Lag(0.1 * len(e) * e.dt, (1.0,) * len(inputs), float(np.mean(e[output])))


def _number(value: float) -> str:
    return f"{value:.4g}" if value else "1e-6"


def _plant_text(name: str, of: Mapping[str, Sequence[Channel]], lags: Mapping[str, _Lag], dt: float) -> str:
    """plant.py of channels by role."""
    inputs, outputs, schedules = of["input"], of["output"], of["schedule"]
    rates, parameters = [], []

    def wide(symbol: str, value: float, unit: str, meaning: str, signed: str = ", signed=True") -> None:
        text = f'"{symbol}", {_number(value)}, {json.dumps(unit)}, tolerance=1.0, meaning="{meaning}"'
        parameters.append(f"        Parameter({text}{signed}),")

    for y in outputs:
        lag = lags[y.name]
        terms = " + ".join(f"p.k_{y.name}_{u.name} * u.{u.name}" for u in inputs)
        rates.append(f'        "{y.name}": (p.c_{y.name} + {terms} - x.{y.name}) / p.T_{y.name},')
        wide(f"T_{y.name}", lag.time, "s", f"time constant of {y.name}", "")
        for u, gain in zip(inputs, lag.gains, strict=True):
            wide(f"k_{y.name}_{u.name}", gain, f"{y.unit or '1'}/({u.unit or '1'})", f"gain from {u.name} to {y.name}")
        wide(f"c_{y.name}", lag.offset, y.unit, f"{y.name} without inputs")

    def listed(channels: Sequence[Channel], role: str) -> str:
        return "".join(f'Channel("{c.name}", {json.dumps(c.unit)}{role}), ' for c in channels)

    driven = listed(inputs, ', "input"') + listed(schedules, ', "schedule"')
    return f'''"""What is believed of the machine: its equation, with the values of the data sheet and their tolerances.

A first-order lag for each output stands here in place of your equation, fitted roughly to your records. Write your physics in its
place: states of your own, parameters with the tolerances of the data sheet, ports where friction and springs act.
"""

from workbench import Channel, Parameter, Plant


def equation(x, u, p, at):
    """The derivative of every state by name; no `if` on a state."""
    return {{
{chr(10).join(rates)}
    }}


def measure(x, p):
    """What the sensors show, in the units of the records."""
    return {{{", ".join(f'"{y.name}": x.{y.name}' for y in outputs)}}}


PLANT = Plant(
    name="{re.sub(r"[^a-z0-9-]+", "-", name.lower()).strip("-") or "machine"}",
    states=({listed(outputs, "").strip()}),
    inputs=({driven.strip()}),
    outputs=({listed(outputs, ', "output"').strip()}),
    parameters=(
{chr(10).join(parameters)}
    ),
    equation=equation,
    measure=measure,
    dt={dt:.9g},
)
'''


def _limits_text(data: Dataset, inputs: Sequence[Channel], outputs: Sequence[Channel]) -> str:
    """A step in the middle of what the outputs did, limits of outputs outside of all that was seen, of inputs at its ends."""
    seconds = max(5.0, min(60.0, 0.5 * max(len(e) * e.dt for e in data)))
    text = [
        "# limits.toml: what the loop must keep; all numbers are guesses from the records",
        "[run]",
        f"duration = {seconds:.3g}",
    ]
    text += ["", "[run.setpoints]"]
    spans = {c.name: np.concatenate([e[c.name] for e in data]) for c in (*inputs, *outputs)}
    for y in outputs:
        low, high = np.quantile(spans[y.name], [0.4, 0.6])
        text.append(f"{y.name} = [[0.0, {low:.4g}], [{0.2 * seconds:.3g}, {high:.4g}]]")
    for c, room in ((c, 0.5 if c in outputs else 0.0) for c in (*outputs, *inputs)):
        low, high = float(spans[c.name].min()), float(spans[c.name].max())
        more = room * (high - low)
        text += ["", f"[limits.{c.name}]", f"low = {low - more:.4g}", f"high = {high + more:.4g}"]
    return "\n".join([*text, "", "[loop]", "stable = true", "sensitivity = 1.7", ""])
