"""Commands one after the other, each reading what others have written; what was computed before is taken from the cache.

    stages = (Stage("records", ("simulate", "web-winding", "--experiment", "prbs1", "rbs")),
              Stage("models", ("identify", "records/prbs1.csv", "records/rbs.csv", "--model", "ssm")))
    run_stages(stages, folder, jobs=2)

A stage is a command of the workbench, run in the run's folder with --out <its name>: what a user would type there. Its key is
the hash of its words, of every file among them, of this program's source and of the versions of what computes. A folder that
holds a whole stage of this key is kept; else it is copied from the user's cache; else the command runs. Whole stages survive
a kill.
"""

import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from pathlib import Path

from studies import PACKAGES
from workbench.errors import InputError
from workbench.files import read_json, sha256, user_cache, write_json
from workbench.provenance import versions
from workbench.records import record

Say = Callable[[str], None]

MARK = "stage.json"  # in the folder of a stage; written last
BEGUN = ".begun"  # in the folder of a stage that is not whole
CACHED = 60  # stages in the user's cache
DONE, NEGATIVE = 0, 1  # exit codes of a command that has given an answer; only a check can say no


@record
class Stage:
    """A command of the workbench; name: the folder that it writes."""

    name: str
    words: tuple[str, ...]

    @property
    def command(self) -> str:
        return " ".join(["workbench", *self.words, "--out", self.name])

    def needs(self, others: Sequence["Stage"]) -> set[str]:
        """Names of the stages whose files it reads."""
        known = {s.name for s in others}
        return {first for word in self.words if "/" in word and (first := word.split("/")[0]) in known}


@record
class Done:
    """A stage that is whole in `folder`: what its command answered and said, what it took when it ran, and whether it ran now."""

    stage: Stage
    folder: Path
    code: int
    said: tuple[str, ...]
    seconds: float
    fresh: bool


def run_stages(
    stages: Sequence[Stage], folder: Path, *, jobs: int = 1, cached: bool = True, progress: Say = lambda _: None
) -> dict[str, Done]:
    """Run what is not there yet, up to `jobs` side by side; by name. cached: whether the user's cache is read and written.

    Raises InputError with a command's own message where it refuses its input, or where `folder` holds foreign files under the
    name of a stage.
    """
    waiting, done, running = list(stages), {}, {}
    stop = threading.Event()
    with ThreadPoolExecutor(jobs) as pool:
        try:
            while waiting or running:
                ready = [s for s in waiting if s.needs(stages) <= done.keys()]
                if not ready and not running:
                    raise ValueError(f"stages that wait for each other: {', '.join(s.name for s in waiting)}")
                for s in ready:
                    waiting.remove(s)
                    running[pool.submit(_one, s, folder, cached, progress, stop)] = s
                ended: set[Future[Done]] = wait(running, return_when=FIRST_COMPLETED).done
                for future in ended:
                    done[running.pop(future).name] = future.result()
        finally:
            stop.set()
    return {s.name: done[s.name] for s in stages}


def _one(stage: Stage, folder: Path, cached: bool, progress: Say, stop: threading.Event) -> Done:
    if stop.is_set():
        raise InterruptedError(stage.name)
    key, own = _key(stage, folder), folder / stage.name
    if cached and (kept := _whole(stage, own, key)) is not None:
        return kept
    _cleared(own)
    store = user_cache("stages") if cached else None
    if store and _whole(stage, store / key, key) is not None:
        progress(f"{stage.name}: as before")
        _copied(store / key, own)
        os.utime(store / key)
        found = _whole(stage, own, key)
        assert found is not None
        return found
    progress(f"{stage.name}: {stage.command}")
    begin = time.perf_counter()
    code, said = _ran(stage, folder, progress, stop)
    seconds = time.perf_counter() - begin
    note = {"key": key, "command": stage.command, "code": code, "said": said, "seconds": seconds}
    if _key(stage, folder) != key:
        raise InputError(f"what {stage.name} reads has changed while it ran", file=folder, mend="run again")
    write_json(own / MARK, note | {"files": {str(p.relative_to(own)): sha256(p) for p in _files(own)}})
    (own / BEGUN).unlink()
    if store:
        _stored(own, store, key)
    return Done(stage, own, code, tuple(said), seconds, fresh=True)


def _key(stage: Stage, folder: Path) -> str:
    """Of words, the files among them, this program and what it computes with."""
    read = {word: sha256(folder / word) for word in stage.words if (folder / word).is_file()}
    content = [stage.name, stage.words, sorted(read.items()), _program(), sorted(versions().items())]
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()[:32]


def _program() -> str:
    """Hash of the source of this program."""
    root, found = Path(__file__).resolve().parents[1], hashlib.sha256()
    for package in PACKAGES:
        for path in sorted(p for p in (root / package).rglob("*") if p.suffix in (".py", ".js")):
            found.update(str(path.relative_to(root)).encode() + b"\0" + path.read_bytes())
    return found.hexdigest()


def _whole(stage: Stage, own: Path, key: str) -> Done | None:
    """The stage in this folder, if it is there, whole, and of this key."""
    try:
        note = read_json(own / MARK)
        whole = note["key"] == key and not (own / BEGUN).exists()
        whole = whole and all((own / name).is_file() and sha256(own / name) == has for name, has in note["files"].items())
        return Done(stage, own, int(note["code"]), tuple(note["said"]), float(note["seconds"]), fresh=False) if whole else None
    except (InputError, TypeError, KeyError, AttributeError, ValueError):
        return None  # there is none, or it was cut short by a full disk


def _files(own: Path) -> tuple[Path, ...]:
    return tuple(sorted(p for p in own.rglob("*") if p.is_file() and p.name not in (MARK, BEGUN)))


def _cleared(own: Path) -> None:
    """An empty folder for a stage, marked as begun; what an earlier run has left there goes, what is not ours is refused."""
    if own.exists() and not (own / BEGUN).is_file():
        listed = _listed(own)
        foreign = [] if listed is None else [p.name for p in _files(own) if str(p.relative_to(own)) not in listed]
        if foreign:
            said = f"holds files that no stage of a study has written: {', '.join(foreign[:3])}"
            raise InputError(said, file=own, mend="move them, or choose another --out folder")
    if own.exists():
        shutil.rmtree(own)
    own.mkdir(parents=True, exist_ok=True)
    (own / BEGUN).touch()


def _listed(own: Path) -> set[str] | None:
    """The files that the mark of a stage names; None where it is damaged."""
    try:
        return set(read_json(own / MARK)["files"]) if (own / MARK).is_file() else set()
    except (InputError, TypeError, KeyError):
        return None


def _ran(stage: Stage, folder: Path, progress: Say, stop: threading.Event) -> tuple[int, list[str]]:
    """Run a stage's command; its exit code and what it said. What it tells of its progress is passed on."""
    # -P: what lies in the run's folder is data and not imported
    words = [sys.executable, "-P", "-m", "studies.cli", *stage.words, "--out", stage.name]
    root = str(Path(__file__).resolve().parents[1])
    paths = [root, *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(paths), "PYTHONIOENCODING": "utf-8"}
    told: list[str] = []
    with (
        tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as out,
        subprocess.Popen(words, cwd=folder, env=environment, stdout=out, stderr=subprocess.PIPE) as process,
    ):

        def listen() -> None:
            assert process.stderr is not None
            for raw in process.stderr:
                line = raw.decode("utf-8", "replace")
                told.append(line.rstrip())
                if line.startswith("  ") and not line.startswith("  mend:") and not stop.is_set():
                    progress(f"{stage.name}: {line.strip()}")

        listening = threading.Thread(target=listen, daemon=True)
        listening.start()
        try:
            while process.poll() is None:
                if stop.wait(0.05):
                    process.terminate()
                    process.wait()
        finally:
            process.kill()
            listening.join()
        out.seek(0)
        said = out.read().splitlines()
    if process.returncode != DONE and not (process.returncode == NEGATIVE and stage.words[0] == "check"):
        reason = "\n".join(told[-12:]) or f"it ended with exit code {process.returncode}"
        raise InputError(f"{stage.command} did not give an answer:\n{reason}", file=folder, mend="mend that, and run again")
    return process.returncode, said


def _copied(source: Path, target: Path) -> None:
    """A copy of a stage's folder, which is whole or absent: its mark comes last."""
    shutil.copytree(source, target, ignore=shutil.ignore_patterns(MARK), dirs_exist_ok=True)
    (target / BEGUN).unlink(missing_ok=True)
    shutil.copy2(source / MARK, target / MARK)


def _stored(own: Path, store: Path, key: str) -> None:
    """A stage into the cache, and the oldest ones out of it; a full disk is no reason to lose a result."""
    try:
        with tempfile.TemporaryDirectory(dir=store) as room:
            _copied(own, Path(room) / key)
            if not (store / key).exists():
                os.replace(Path(room) / key, store / key)
        kept = sorted((p for p in store.iterdir() if (p / MARK).is_file()), key=lambda p: p.stat().st_mtime)
        for old in kept[:-CACHED]:
            shutil.rmtree(old, ignore_errors=True)
    except OSError:
        return
