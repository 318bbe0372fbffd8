"""`workbench new`: a folder to begin with that runs as it stands: records, plant, limits, a sweep, and commands that join them.

Without logs the example of `studies/template`, whose records hide a dry friction that the plant lacks. With logs a folder around
them: a plant of a first-order lag for each output, fitted roughly, for the user's own equation to take its place.
"""

import json
import re
import shutil
import tempfile
from argparse import Namespace
from collections.abc import Iterator, Mapping, Sequence
from keyword import iskeyword
from pathlib import Path

import numpy as np

from studies.arguments import choose_plant, names
from studies.cli import DONE
from studies.terminal import say
from workbench.data import Channel, Dataset
from workbench.errors import InputError
from workbench.files import write_json, write_text
from workbench.readers import write_csv
from workbench.records import record
from workbench.simulation import Playback, Scenario, simulate
from workbench.sources import read

TEMPLATE = Path(__file__).parents[1] / "template"
HIDDEN = {"coulomb@shaft": {"level": 0.04, "width": 0.5}}
TRUE = {"J": 1.2e-3, "b": 4e-4, "c": 6e-4, "kT": 0.105}  # of the example's machine, within the tolerances
RECORDS = {"a": (60, -12.0, 1), "b": (30, 2.0, 2), "c": (100, -12.0, 3), "held-out": (150, -12.0, 4)}  # hold, lowest V, seed
SAMPLES = 4000


def run(options: Namespace) -> int:
    """Write the folder, whole or not at all."""
    folder = Path(options.folder)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError("is there already, and not empty", file=folder, mend="choose the name of a new folder")
    if not options.records and any((options.inputs, options.outputs, options.schedule)):
        raise InputError(
            "roles of channels without records", mend="name the logs, too: workbench new my-machine log.csv --inputs U"
        )
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        made = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    except OSError as reason:
        raise InputError(f"cannot be made: {reason.strerror}", file=folder, mend="choose a folder that can be written") from None
    try:
        if options.records:
            _around(made, folder.name, options)
        else:
            _example(made)
        made.chmod(0o755)
        made.replace(folder)
    finally:
        shutil.rmtree(made, ignore_errors=True)
    if options.json:
        write_json(options.json, {"folder": str(folder), "files": sorted(str(p.relative_to(folder)) for p in _files(folder))})
    say(f"folder: {folder}")
    say(f"go on: cd {folder}, and run the commands of README.md from the top; each is explained there")
    return DONE


def _files(folder: Path) -> Iterator[Path]:
    return (path for path in folder.rglob("*") if path.is_file())


# ---- the example -------------------------------------------------------------------------------------------------------------


def _example(folder: Path) -> None:
    """The template with records of a machine that rubs."""
    for path in _files(TEMPLATE):
        if path.suffix in (".py", ".toml", ".md"):
            shutil.copyfile(path, folder / path.name)
    plant = choose_plant(f"{folder / 'plant.py'}:PLANT").plant
    (folder / "records").mkdir()
    for name, (hold, low, seed) in RECORDS.items():
        random = np.random.default_rng(seed)
        U = np.repeat(random.uniform(low, 12.0, SAMPLES // hold + 1).round(2), hold)[:SAMPLES]
        way = 10.0 - 10.0 * np.cos(2.0 * np.pi * plant.dt * np.arange(SAMPLES) / (8.0 + 2.0 * seed))
        scenario = Scenario(name, {"U": U, "way": way}, seed=seed)
        done = simulate(plant, Playback(("U", "way"), plant.dt), scenario, parameters=TRUE, effects=HIDDEN)
        write_csv(done.experiment, folder / "records" / f"{name}.csv")


# ---- around the user's own records ---------------------------------------------------------------------------------------------


@record
class Lag:
    """T y' = c + k u - y of one output, fitted roughly: T [s], k (nu), c."""

    time: float
    gains: tuple[float, ...]
    offset: float


def _around(folder: Path, name: str, options: Namespace) -> None:
    """Copies of the logs, and everything else in terms of their channels."""
    data = read(*options.records, inputs=names(options.inputs), outputs=names(options.outputs), schedule=names(options.schedule),
                dt=options.file_dt)  # fmt: skip
    for note in data.notes:
        say(f"note: {note}")
    first = data.experiments[0]
    of = {role: [first.channel(n) for n in first.names_of(role)] for role in ("input", "output", "schedule")}
    inputs, outputs, schedules = ([c.name for c in own] for own in of.values())
    for role in ("input", "output"):
        if not of[role]:
            known = ", ".join(first.names)
            raise InputError(f"which channel is an {role}?", file=options.records[0], mend=f"give --{role}s, of {known}")
    if odd := [channel for channel in (*inputs, *outputs, *schedules) if not channel.isidentifier() or iskeyword(channel)]:
        mend = "give it a name of letters, digits and _ in the header of the file"
        raise InputError(f"channel {odd[0]!r} cannot be a name in an equation", file=options.records[0], mend=mend)
    files = [Path(path).name for path in options.records]
    if twice := [file for file in files if files.count(file) > 1]:
        raise InputError("two files of this name", file=twice[0], mend="rename one: they come into one folder")
    (folder / "records").mkdir()
    for path in options.records:
        shutil.copyfile(path, folder / "records" / Path(path).name)
    lags = {y: _lag(data, y, inputs) for y in outputs}
    write_text(folder / "plant.py", _plant_text(name, of, lags, first.dt))
    write_text(folder / "limits.toml", _limits_text(data, of["input"], of["output"]))
    write_text(folder / "README.md", _readme(data, options, inputs, outputs, schedules))


def _lag(data: Dataset, output: str, inputs: Sequence[str]) -> Lag:
    """Least squares of y(k+q) = a y(k) + b u(k) + c at that of a few steps q whose free runs follow the records best."""
    from scipy.signal import lfilter

    found: list[tuple[float, Lag]] = []
    for q in (1, 2, 5, 10, 20, 50):
        parts = [(e[output][::q], np.column_stack([e[u][::q] for u in inputs]), q * e.dt) for e in data if len(e) > 5 * q]
        if not parts:
            continue
        X = np.vstack([np.column_stack([y[:-1], U[:-1], np.ones(len(y) - 1)]) for y, U, _ in parts])
        a, *b, c = np.linalg.lstsq(X, np.concatenate([y[1:] for y, _, _ in parts]), rcond=None)[0].tolist()
        if not 0.0 < a < 1.0:
            continue
        lag = Lag(-parts[0][2] / np.log(a), tuple(g / (1.0 - a) for g in b), c / (1.0 - a))
        runs = [np.append(y[0], lfilter([1.0], [1.0, -a], U[:-1] @ b + c, zi=[a * y[0]])[0]) for y, U, _ in parts]
        errors = [float(np.mean((run - y) ** 2)) for run, (y, _, _) in zip(runs, parts, strict=True)]
        found.append((float(np.mean(errors)), lag))
    if found:
        return min(found, key=lambda pair: pair[0])[1]
    e = data.experiments[0]  # nothing settles: a start that the user's equation replaces
    return Lag(0.1 * len(e) * e.dt, (1.0,) * len(inputs), float(np.mean(e[output])))


def _number(value: float) -> str:
    return f"{value:.4g}" if value else "1e-6"


def _plant_text(name: str, of: Mapping[str, Sequence[Channel]], lags: Mapping[str, Lag], dt: float) -> str:
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


def _readme(data: Dataset, options: Namespace, inputs: Sequence[str], outputs: Sequence[str], schedules: Sequence[str]) -> str:
    files = [f"records/{Path(path).name}" for path in options.records]
    own, held = (files[:-1], files[-1:]) if len(files) > 1 else (files, [])
    holdout = f" --holdout {held[0]}" if held else ""
    stamps = f" --file-dt {options.file_dt:g}" if options.file_dt else ""
    roles = f"--outputs {','.join(outputs)} --inputs {','.join(inputs)}"
    scheduled = f" --schedule {','.join(schedules)}" if schedules else " --schedule none"
    model, law = ("ssm", "scheduled-pid") if schedules else ("lti", "pid")
    spans = {u: np.concatenate([e[u] for e in data]) for u in inputs}
    wanted = ",".join(f"{y}={np.mean(np.concatenate([e[y] for e in data])):.3g}" for y in outputs)
    low, high = (",".join(f"{u}={end(spans[u]):.4g}" for u in inputs) for end in (np.min, np.max))
    known = " ".join(own)
    looked = f"{roles}{scheduled if schedules else ''}{stamps}"
    return f"""# {Path(options.folder).name}

| file | holds |
|---|---|
| `records/` | your logs{", the last one held out: no model sees it" if held else ""} |
| `plant.py` | a first-order lag for each output, in place of your equation |
| `limits.toml` | what the loop must keep: guesses from the records |

What do the records hold, and what can they not show?

```sh
workbench look {" ".join(files)} {looked} --out looked
```

A model of the machine from its records alone:

```sh
workbench identify {known}{holdout} {roles}{scheduled}{stamps} --model {"lti,ssm" if schedules else "lti"} --out models
```

What does the equation of `plant.py` get wrong, and what is the cause? First put your own equation there.

```sh
workbench diagnose {known}{holdout}{stamps} --plant plant.py:PLANT --out found
```

A controller with margins, and whether it keeps its limits on every machine that the records leave open:

```sh
workbench design {law} --model models/{model}.json --setpoint {wanted} --low {low} --high {high} --out pid
workbench check --controller pid/{law}.json --limits limits.toml --model models/{model}.json --records {known} --out checked
workbench export pid/{law}.json --to c --out firmware
```

Every folder that a command writes has a page, `report.html`.
"""
