"""A session: a folder with records, a plant, limits, and a folder for every command that has run there.

    session/
      records/            logs as they were dropped
      plant.py            the user's equation, limits.toml what the loop must keep
      session.json        which record is for what, roles of channels
      02-identify/        what a command wrote, here or on the command line
      .steps/             words, log and end of the commands that the page has started

The command line goes on in the same folder, and what it writes there appears on the page.
"""

import os
import shlex
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stderr
from functools import lru_cache
from io import StringIO
from pathlib import Path
from typing import Any

from controllers.files import load_controller
from controllers.sketch import Sketch
from studies.app.job import GONE
from studies.app.lines import python_lines
from studies.beginning import beginning
from studies.cli import parser
from workbench.data import Dataset
from workbench.errors import InputError
from workbench.files import read_json, read_text, write_json, write_text
from workbench.lpv import load_model
from workbench.robustness.frozen import Bounds
from workbench.sources import read

COMMANDS = ("look", "identify", "compare", "calibrate", "diagnose", "design", "check", "export", "simulate", "effects")
TEXTS = ("plant.py", "limits.toml")
ROOT = Path(__file__).parents[2]  # where this program's packages lie, for the process of a step
TOGETHER = 2  # commands at the same time
TAIL = 20_000  # characters of a log that the page is given
LONGEST = 1_000_000  # characters of a text that the page may write
STATE = {"files": {}, "roles": {}, "dt": None, "plant": ""}
#: What a command leaves in its folder, by which one is told that the page has not started.
MARKS = {
    "look.json": "look", "scores.json": "identify", "diagnosis.json": "diagnose", "calibration.json": "calibrate",
    "design.json": "design", "check.json": "check",
}  # fmt: skip
USES = ("model", "held-out", "none")
#: What fits an entry of session.json.
FITS: dict[str, Callable[[Any], bool]] = {
    "files": lambda v: isinstance(v, dict) and all(isinstance(k, str) and use in USES for k, use in v.items()),
    "roles": lambda v: isinstance(v, dict) and all(isinstance(x, str) for pair in v.items() for x in pair),
    "dt": lambda v: v is None or (isinstance(v, int | float) and 0.0 < v < 1e6),
    "plant": lambda v: isinstance(v, str) and len(v) < 1000,
}


class Session:
    """The folder behind the page. Every method reads the files anew: the command line and a second window write there, too."""

    def __init__(self, folder: str | Path):
        self.folder = Path(folder)
        self._lock = threading.Lock()
        for path in (self.folder, self.records, self._steps):
            try:
                path.mkdir(parents=True, exist_ok=True)
            except OSError as reason:
                mend = "choose a folder that can be written"
                raise InputError(f"cannot be made: {reason.strerror}", file=path, mend=mend) from None

    @property
    def records(self) -> Path:
        return self.folder / "records"

    @property
    def _steps(self) -> Path:
        return self.folder / ".steps"

    # ---- what is there -----------------------------------------------------------------------------------------------

    def state(self) -> dict[str, Any]:
        """All that the page shows: records, roles, texts and steps."""
        chosen = self.chosen()
        logs = sorted(path for path in self.records.iterdir() if path.is_file() and not path.name.startswith("."))
        uses = self._uses([path.name for path in logs], chosen["files"])
        return {
            "folder": str(self.folder.resolve()),
            "records": [{"name": p.name, "size": p.stat().st_size, "use": uses[p.name]} for p in logs],
            "chosen": chosen,
            "channels": self._channels(),
            "texts": {name: read_text(self.folder / name) for name in TEXTS if (self.folder / name).is_file()},
            "steps": [self.step(name) for name in self.names()],
            "files": self._made(),
        }

    def chosen(self) -> dict[str, Any]:
        """What session.json says, with what it leaves out; what cannot be read, or is of the wrong kind, counts as left out."""
        try:
            found = read_json(self.folder / "session.json")
        except InputError:
            found = {}
        found = found if isinstance(found, dict) else {}
        revision = found.get("revision")
        sound = {key: found[key] for key in STATE if key in found and FITS[key](found[key])}
        return STATE | sound | {"revision": revision if isinstance(revision, int) else 0}

    def choose(self, revision: int, changes: Mapping[str, Any]) -> dict[str, Any]:
        """Change session.json from this revision on. Raises InputError where another window was faster, or for a wrong entry."""
        for key, value in changes.items():
            if key not in STATE:
                raise InputError(f"session has no {key!r}", mend=f"one of {', '.join(STATE)}")
            _check(key, value)
        with self._lock:
            before = self.chosen()
            if before["revision"] != revision:
                raise InputError("another window has changed the session", mend="look at what it says now, and change it again")
            after = before | dict(changes) | {"revision": revision + 1}
            write_json(self.folder / "session.json", after)
        return after

    def names(self) -> list[str]:
        """Steps by number: what the page has started, and what the command line has written beside it."""
        started = {path.stem for path in self._steps.glob("*.json")}
        written = {path.parent.name for path in self.folder.glob("*/report.json")}
        return sorted(started | written, key=lambda name: (_number(name), name))

    def step(self, name: str) -> dict[str, Any]:
        """A step: its command, how it stands, what it has said, and the files in its folder."""
        path, folder = self._steps / f"{name}.json", self.folder / name
        about: dict[str, Any] = {"name": name, "page": (folder / "report.html").is_file(), "standing": _standing(folder)}
        if not path.is_file():
            kind = next((own for mark, own in MARKS.items() if (folder / mark).is_file()), "")
            said = "Written by the command line." if kind else ""
            return about | {"state": "done", "code": 0, "command": said, "kind": kind, "python": "", "log": "", "seconds": None}
        made = read_json(path)
        end, log = path.with_suffix(".end"), path.with_suffix(".log")
        over = read_json(end) if end.is_file() else None
        state = "done" if over else "running" if self._lives(path) else "killed"
        return about | {
            "state": state,
            "code": over["code"] if over else None,
            "command": shlex.join(["workbench", *made["words"]]),
            "kind": made["words"][0],
            "python": python_lines(tuple(made["words"])),
            "log": _tail(log),
            "seconds": over["seconds"] if over else round(time.time() - made["began"], 1),
        }

    def _lives(self, path: Path) -> bool:
        """Whether the process of a step has given a sign of life of late; one that has just been started may not have yet."""
        alive = path.with_suffix(".alive")
        try:
            return time.time() - (alive if alive.exists() else path).stat().st_mtime < GONE
        except OSError:  # it ended between the two looks
            return path.with_suffix(".end").exists()

    def _uses(self, names: Sequence[str], said: Mapping[str, str]) -> dict[str, str]:
        """What each record is for: as said; of the others the last is held out, where none is and there are several."""
        uses = {name: said.get(name, "model") for name in names}
        open_ones = [name for name in names if name not in said]
        if open_ones and len(names) > 1 and "held-out" not in uses.values():
            uses[open_ones[-1]] = "held-out"
        return uses

    def _channels(self) -> list[dict[str, Any]]:
        """Channels of the records, of the newest look at them."""
        looks = sorted(self.folder.glob("*/look.json"), key=lambda path: path.stat().st_mtime)
        if not looks:
            return []
        try:
            return read_json(looks[-1])["sets"][0]["channels"]
        except (InputError, KeyError, IndexError, TypeError):
            return []

    def _made(self) -> list[dict[str, str]]:
        """Files that later steps may name, relative to the session, and what each is, by its schema or ending."""
        found = [path for pattern in ("*/*.json", "*/*.c", "*/*.h", "*/*.st", "*/*.csv") for path in self.folder.glob(pattern)]
        told = ("report.json", "look.json")
        made = [
            {"path": path.relative_to(self.folder).as_posix(), "kind": _kind(path)}
            for path in found
            if path.name not in told and not path.relative_to(self.folder).parts[0].startswith((".", "records"))
        ]
        return sorted(made, key=lambda own: own["path"])

    # ---- what is done ------------------------------------------------------------------------------------------------

    def begin(self, words: Sequence[str]) -> str:
        """Start a command in a process of its own; returns the step's name. Raises InputError for wrong words."""
        _check_words(words)
        with self._lock:
            running = [name for name in self.names() if self.step(name)["state"] == "running"]
            if len(running) >= TOGETHER:
                raise InputError(f"{' and '.join(running)} are under way", mend="wait for one of them, or stop it")
            name = f"{1 + max(map(_number, self.names()), default=0):02d}-{words[0]}"
            path = self._steps / f"{name}.json"
            write_json(path, {"words": [*words, "--out", name], "began": time.time()})
        searched = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH", "")]))
        with open(path.with_suffix(".log"), "wb") as log:
            process = subprocess.Popen(
                [sys.executable, "-P", "-m", "studies.app.job", str(path.relative_to(self.folder))],
                cwd=self.folder, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT, start_new_session=True,
                env={**os.environ, "PYTHONPATH": searched, "PYTHONUNBUFFERED": "1"},
            )  # fmt: skip
        threading.Thread(target=process.wait, daemon=True).start()  # so that no dead process stays behind
        return name

    def stop(self, name: str) -> None:
        """Stop a running step; what it has written is whole."""
        if name not in self.names() or self.step(name)["state"] != "running":
            raise InputError(f"{name} is not running", mend="nothing is to be stopped")
        (self._steps / f"{name}.stop").touch()

    def sketch(self, controller: str, model: str, bounds: Mapping[str, float]) -> dict[str, Any]:
        """What other bounds would make of a PID in the session, at once: see `controllers.sketch`."""
        for path in (controller, model):
            _check_inside(path)
        files = [self.folder / path for path in (controller, model)]
        changed = tuple(path.stat().st_mtime_ns if path.is_file() else 0 for path in files)
        sketch = _sketch(*files, changed)
        found = sketch.within(Bounds(bounds["sensitivity"], bounds["complementary"], bounds["effort"]))
        return {"points": sketch.points} | found.to_dict()

    def write(self, name: str, text: str) -> None:
        """plant.py or limits.toml."""
        if name not in TEXTS:
            raise InputError(f"no text {name!r}", mend=f"one of {', '.join(TEXTS)}")
        if len(text) > LONGEST:
            raise InputError(f"{len(text)} characters", file=name, mend=f"at most {LONGEST}")
        write_text(self.folder / name, text)

    def guess(self, name: str) -> None:
        """Write plant.py or limits.toml as they follow from the records: a first-order lag for each output, what was seen."""
        if name not in TEXTS:
            raise InputError(f"no text {name!r}", mend=f"one of {', '.join(TEXTS)}")
        begun = beginning(self.folder.resolve().name, self.read_records())
        write_text(self.folder / name, begun.plant if name == "plant.py" else begun.limits)

    def read_records(self) -> Dataset:
        """The records that models are made from, with the roles chosen."""
        state = self.state()
        own = [self.records / r["name"] for r in state["records"] if r["use"] == "model"]
        if not own:
            raise InputError("no records", mend="drop at least one log")
        roles = {c["name"]: c["role"] for c in state["channels"]} | state["chosen"]["roles"]
        by_role = {kind: tuple(n for n, role in roles.items() if role == kind) for kind in ("input", "output", "schedule")}
        return read(
            *own, inputs=by_role["input"], outputs=by_role["output"], schedule=by_role["schedule"], dt=state["chosen"]["dt"]
        )


def _check(key: str, value: Any) -> None:
    """Refuse an entry of session.json of the wrong kind."""
    if not FITS[key](value):
        raise InputError(f"session: {key} is {value!r}", mend="see the page's own requests for what fits")


def _check_inside(path: str) -> None:
    """Refuse what leads out of the session's folder, on whatever system."""
    if os.path.isabs(path) or ".." in Path(path.replace("\\", "/")).parts or "\0" in path or ":\\" in path:
        raise InputError(f"{path!r} leads out of the session", mend="name files in its folder")


def _check_words(words: Sequence[str]) -> None:
    """Refuse what is none of the commands, and words that lead out of the session's folder."""
    if not words or words[0] not in COMMANDS:
        raise InputError(f"no command {words[0] if words else ''!r}", mend=f"one of {', '.join(COMMANDS)}")
    for word in words:
        _check_inside(word.rpartition("=")[2] if word.startswith("--") else word)
    if any(word.split("=")[0] in ("--out", "--json") for word in words):
        raise InputError("--out and --json are the page's own", mend="leave them out")
    with redirect_stderr(StringIO()) as said:
        try:
            parser().parse_args(list(words))
        except SystemExit:
            first = said.getvalue().partition("\n")[0]
            raise InputError(first or "these words ask for help", mend="correct what is asked for") from None


def _kind(path: Path) -> str:
    """What a file is: by its schema, of other programs' files by their ending."""
    if path.suffix != ".json":
        return "table" if path.suffix == ".csv" else "source"
    return _schema(path, path.stat().st_mtime_ns)


def _standing(folder: Path) -> str:
    """How the worst of the badges on a step's page stands: good, open or bad; empty without badges."""
    path = folder / "report.json"
    return _badges(path, path.stat().st_mtime_ns) if path.is_file() else ""


@lru_cache(maxsize=4096)
def _badges(path: Path, changed: int) -> str:
    del changed  # so that a new file is read again
    try:
        said = {badge["standing"] for badge in read_json(path)["brief"]["badges"]}
    except (InputError, KeyError, TypeError):
        return ""
    return next((own for own in ("bad", "open", "good") if own in said), "")


@lru_cache(maxsize=4096)
def _schema(path: Path, changed: int) -> str:
    """The last word of a JSON file's schema; empty where it has none."""
    del changed
    try:
        content = read_json(path)
    except InputError:
        return ""
    said = content.get("schema") if isinstance(content, dict) else None
    return said.rpartition("/")[2] if isinstance(said, str) else ""


@lru_cache(maxsize=8)
def _sketch(controller: Path, model: Path, changed: tuple[int, ...]) -> Sketch:
    """The sketch of a controller and its model, as they are at that time."""
    del changed
    return Sketch(load_controller(controller), load_model(model))


def _number(name: str) -> int:
    """The number in front of a step's name; 0 of a folder that the command line was given another name for."""
    first = name.partition("-")[0]
    return int(first) if first.isascii() and first.isdigit() and len(first) < 7 else 0


def _tail(path: Path) -> str:
    """The end of a log."""
    try:
        with open(path, "rb") as stream:
            stream.seek(0, os.SEEK_END)
            stream.seek(max(0, stream.tell() - TAIL))
            return stream.read().decode("utf-8", "replace")
    except OSError:
        return ""
