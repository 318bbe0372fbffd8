"""`workbench new`: a folder to begin with that runs as it stands: records, plant, limits, a sweep, and commands that join them.

Without logs the example of `studies/template`, whose records hide a dry friction that the plant lacks. With logs a folder around
them: a plant of a first-order lag for each output, fitted roughly, for the user's own equation to take its place.
"""

import shutil
import tempfile
from argparse import Namespace
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from studies.arguments import choose_plant, names
from studies.beginning import beginning
from studies.cli import DONE
from studies.terminal import say
from workbench.data import Dataset
from workbench.errors import InputError
from workbench.files import write_json, write_text
from workbench.readers import write_csv
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


def _around(folder: Path, name: str, options: Namespace) -> None:
    """Copies of the logs, and everything else in terms of their channels."""
    data = read(*options.records, inputs=names(options.inputs), outputs=names(options.outputs), schedule=names(options.schedule),
                dt=options.file_dt)  # fmt: skip
    for note in data.notes:
        say(f"note: {note}")
    begun = beginning(name, data)
    files = [Path(path).name for path in options.records]
    if twice := [file for file in files if files.count(file) > 1]:
        raise InputError("two files of this name", file=twice[0], mend="rename one: they come into one folder")
    (folder / "records").mkdir()
    for path in options.records:
        shutil.copyfile(path, folder / "records" / Path(path).name)
    write_text(folder / "plant.py", begun.plant)
    write_text(folder / "limits.toml", begun.limits)
    write_text(folder / "README.md", _readme(data, options, *begun.roles))


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
