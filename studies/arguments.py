"""What a person types on the command line, turned into the nouns of the workbench."""

import importlib
import importlib.util
import math
import sys
from collections.abc import Callable, Iterable
from datetime import datetime
from pathlib import Path
from typing import Any

from plants import PLANTS
from studies import PACKAGES
from workbench.data import Dataset, check_held_out
from workbench.errors import InputError, check_known
from workbench.files import read_json
from workbench.hammerstein import SCHEMA as CURVED_MODEL
from workbench.hammerstein import load_either
from workbench.intervals.model import SCHEMA as INTERVAL_MODEL
from workbench.lpv import SCHEMA as MODEL
from workbench.physics.controller import check_controller
from workbench.physics.extension import SCHEMA as PLANT_SCHEMA
from workbench.physics.extension import load_extension
from workbench.physics.identified import identified
from workbench.physics.plant import Plant
from workbench.records import record


@record
class Chosen:
    """A plant as it was asked for; base: the machine's name, the user's module:NAME or a model file; files: what was read, the
    user's own Python file among them.

    model: the file, where the plant is an identified model as it is.
    """

    plant: Plant
    base: str
    files: tuple[str, ...] = ()
    model: str | None = None

    @property
    def machine(self) -> str:
        """The machine of the workbench that it is, whose experiments fit: also with other effects and numbers; else its base."""
        listed = PLANTS.get(self.plant.name)
        return self.plant.name if listed is not None and listed.equation is self.plant.equation else self.base


def find_plant(text: str) -> Plant:
    """The plant that `choose_plant` finds."""
    return choose_plant(text).plant


def trusted_plant(base: str, named: str) -> Plant:
    """The plant that a controller's file calls `base`: a machine of the workbench, or what the user has named beside the file."""
    if base not in PLANTS and base != named:
        raise InputError(f"predicts with {base}, which is no machine of the workbench", mend=f"if you trust it, run it on {base}")
    return find_plant(base)


@record
class ChosenController:
    """A controller as it was asked for, and the files that were read; own: file.py:NAME of the user's own law, else empty."""

    law: Any
    files: tuple[str, ...]
    own: str = ""


def choose_controller(text: str, plant: str = "") -> ChosenController:
    """The controller in a file that `design` has written; or one of the user's own, file.py:NAME or package.module:NAME.

    plant: what the user has named as the plant, with which a nonlinear MPC may predict. Raises InputError where the name is
    none of a controller. Only the command line names a law of the user's own: no file makes this program run code.
    """
    if not is_own(text):
        from controllers.files import load_controller

        return ChosenController(load_controller(text, lambda base: trusted_plant(base, plant)), (text,))
    found = _named(text, "controller", lambda value: hasattr(value, "actuated") and not isinstance(value, type))
    check_controller(found, text)
    return ChosenController(found, _code(text), text)


def is_own(text: str) -> bool:
    """Whether this names an object in Python code, as file.py:NAME or package.module:NAME."""
    return text.endswith(".py") or (":" in text and not Path(text).exists() and not text.endswith(".json"))


def choose_plant(text: str) -> Chosen:
    """A machine of the workbench by name, or package.module:NAME, or file.py:NAME, or an identified model's file; or a plant
    file that extends one of them.

    A plant file never makes this program run code: alone (`extended.json`) it extends machines of the workbench and models only,
    and a plant of the user's own is named before it (`my_plant.py:PLANT+extended.json`).
    """
    if not text.endswith(".json"):
        return Chosen(_base_plant(text), text, _code(text))
    if _is_model(text):
        return Chosen(_base_plant(text), text, (text,), text)
    before, plus, path = text.rpartition("+")
    if not plus or Path(text).is_file():
        before, path = "", text
    found = load_extension(path)
    if not before and found.base not in PLANTS and not _is_model(found.base):
        mend = f"if you trust that plant, name it yourself: {found.base}+{path}"
        raise InputError(f"extends {found.base}, which is no machine of the workbench", file=path, mend=mend)
    base = before or found.base
    plant = found.of(_base_plant(base), file=path)
    return Chosen(plant, base, (base, path) if _is_model(base) else (*_code(base), path))


def _code(text: str) -> tuple[str, ...]:
    """The Python files of module:NAME or file.py:NAME, which has been loaded: its own, and those beside it that it imports."""
    source, colon, _ = text.rpartition(":")
    if not colon:
        return ()
    if source.endswith(".py"):
        return (source, *_BESIDE.get(str(Path(source).resolve()), ()))
    found = getattr(sys.modules[source], "__file__", None)
    return (found,) if found else ()


def _is_model(text: str) -> bool:
    """Whether this is the file of an identified model, of whatever kind."""
    if not text.endswith(".json") or not Path(text).is_file():
        return False
    content = read_json(text)
    return isinstance(content, dict) and content.get("schema") in (MODEL, CURVED_MODEL, INTERVAL_MODEL)


def is_plant(text: str) -> bool:
    """Whether this names a plant, and not a model in a file."""
    if not text.endswith(".json") or not Path(text).is_file():
        return "+" in text or not text.endswith(".json")
    content = read_json(text)
    return isinstance(content, dict) and content.get("schema") == PLANT_SCHEMA


def _base_plant(text: str) -> Plant:
    if _is_model(text):
        if read_json(text)["schema"] == INTERVAL_MODEL:
            raise InputError(
                "an interval model bounds what may happen, it is no simulation",
                file=text,
                mend="give a state-space model: workbench identify --model lti, ilm or ssm",
            )
        return identified(load_either(text))
    if ":" not in text and not text.endswith(".py"):
        return PLANTS[check_known("plant", text, PLANTS)]
    return _named(text, "plant", lambda value: isinstance(value, Plant))


def _named(text: str, kind: str, fits: Callable[[Any], bool]) -> Any:
    """What file.py:NAME or package.module:NAME names, in code that the user trusts; fits: what else could be meant there."""
    source, colon, attribute = text.rpartition(":")
    if not colon:
        raise InputError(f"which {kind} in {text!r}?", mend=f"write {text}:NAME")
    module = _load_file(Path(source)) if source.endswith(".py") else _import(source)
    known = [name for name, value in vars(module).items() if fits(value)]
    if kind == "controller" and attribute in vars(module):
        return getattr(module, attribute)  # what it lacks says more than that it is none
    if not known:
        raise InputError(f"no {kind} in this file", file=source, mend=f"define NAME = ..., see docs/add-a-{kind}.md")
    return getattr(module, check_known(kind, attribute, known, file=source))


def _load_file(path: Path):
    spec = importlib.util.spec_from_file_location(f"user_{path.stem}", path)
    if not path.is_file() or spec is None or spec.loader is None:
        raise InputError("no such file", file=path, mend="check the path")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    beside = str(path.resolve().parent)  # as for `python file.py`, but after all that is installed
    before = set(sys.modules)
    try:
        sys.path.append(beside)
        spec.loader.exec_module(module)
    except SyntaxError as reason:
        raise InputError(f"{reason.msg}", file=path, line=reason.lineno, mend="is it Python?") from None
    except InputError:
        raise
    except Exception as reason:
        raise InputError(f"{type(reason).__name__}: {reason}", file=path, mend="run the file with python first") from reason
    finally:
        sys.path.remove(beside)
        helpers = {name: file for name in sys.modules.keys() - before if (file := _lies_in(beside, name))}
        for name in helpers:
            del sys.modules[name]  # another file may have another one of this name beside it
    _BESIDE[str(path.resolve())] = tuple(sorted(helpers.values()))
    return module


def _lies_in(folder: str, name: str) -> str | None:
    """The file of a module that lies in this folder itself, as name.py or in the package name/, and is not of this program.

    What is installed somewhere below the folder, such as in a virtual environment, does not count.
    """
    file, top = getattr(sys.modules[name], "__file__", None), name.split(".")[0]
    path = Path(file).resolve() if file else None
    if path is None or top in PACKAGES or not path.is_relative_to(folder):
        return None
    return str(path) if path.relative_to(folder).parts[0] in (top, f"{top}.py") else None


#: By Python file of the user, the files beside it that it has imported.
_BESIDE: dict[str, tuple[str, ...]] = {}


def _import(name: str):
    try:
        return importlib.import_module(name)
    except ImportError as reason:
        raise InputError(str(reason), mend="write package.module:NAME or file.py:NAME") from None


def parse_effects(texts: Iterable[str]) -> dict[str, dict[str, float]]:
    """{"coulomb@unwind": {"level": 0.002}} from id@place:parameter=value,...; the plant checks the names."""
    sizes: dict[str, dict[str, float]] = {}
    for text in texts:
        key, _, numbers = text.partition(":")
        if "@" not in key or not numbers:
            raise InputError(f"effect {text!r}", mend="write id@place:parameter=value, e.g. coulomb@unwind:level=0.002")
        own = sizes.setdefault(key.strip(), {})
        for name, value in parse_numbers(numbers.split(",")).items():
            if name in own:
                raise InputError(f"{key}:{name} is given twice", mend="give it once")
            own[name] = value
    return sizes


def parse_numbers(texts: Iterable[str]) -> dict[str, float]:
    """{"kT": 0.021} from name=value."""
    values: dict[str, float] = {}
    for text in texts:
        name, _, value = (part.strip() for part in text.partition("="))
        if name in values:
            raise InputError(f"{name} is given twice", mend="give it once")
        try:
            values[name] = float(value)
        except ValueError:
            raise InputError(f"{text!r} is not name=number", mend=f"write e.g. {name or 'name'}=0.002") from None
        if not math.isfinite(values[name]):
            raise InputError(f"{text!r} is not finite", mend="give a number")
    return values


def numbers(text: str | None, option: str) -> list[float] | None:
    """[0.1, 2.0] from "0.1,2"; None where the option is not given."""
    if text is None:
        return None
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = [math.nan]
    if not all(map(math.isfinite, values)):
        raise InputError(f"{option} {text!r} is not a number, or several", mend=f"write e.g. {option} 0.01 or {option} 0.01,0.02")
    return values


def names(text: str | None) -> tuple[str, ...]:
    """("V1", "V2") from "V1,V2"."""
    found = tuple(name.strip() for name in text.split(",") if name.strip()) if text else ()
    for name in found:
        if found.count(name) > 1:
            raise InputError(f"{name} is named twice in {text!r}", mend="name each channel once")
    return found


def check_file(path: str | None, option: str) -> None:
    """Refuse an output file that cannot be written, before any work is done."""
    if path is not None and (Path(path).is_dir() or not Path(path).absolute().parent.is_dir()):
        raise InputError(
            "is a folder" if Path(path).is_dir() else "its folder does not exist", file=path, mend=f"give {option} FILE"
        )


def check_files(data: str | None, files: Iterable[Path], mend: str) -> list[Path]:
    """Files of measured records in the folder `data`. Raises InputError where it is not given, or one is missing."""
    if data is None:
        raise InputError("this study needs measured records", mend=mend)
    paths = [Path(data) / file for file in files]
    for path in paths:
        if not path.is_file():
            raise InputError("no such file", file=path, mend=mend)
    return paths


def record_files(folder: Path) -> list[Path]:
    """The records in a user's folder, by name: at least two, for one of them is held out."""
    if not folder.is_dir():
        raise InputError("no such folder" if not folder.exists() else "is a file", file=folder, mend="give --data FOLDER")
    files = sorted(path for path in folder.glob("*") if path.suffix.lower() in (".csv", ".txt", ".tsv", ".mat"))
    if len(files) < 2:
        raise InputError(f"{len(files)} records", file=folder, mend="the study needs at least two records, one of them held out")
    return files


def split_estimation(dataset: Dataset, known: Iterable[str]) -> tuple[Dataset, Dataset]:
    """Estimation and held-out records: those of a known name estimate, otherwise the first half; one at least is held out."""
    names = list(dataset.names)
    estimation = [name for name in names if name.lower() in known] or names[: (len(names) + 1) // 2]
    chosen, rest = dataset.split_records(estimation if len(estimation) < len(names) else names[:-1])
    check_held_out(chosen, rest)
    return chosen, rest


def run_folder(out: str | None, command: str) -> Path:
    """The folder for a run's results: the one asked for, or a new one under runs/."""
    stem = f"{command}-{datetime.now():%Y%m%d-%H%M%S}"
    tried = [Path("runs") / (stem if i == 1 else f"{stem}-{i}") for i in range(1, 1000)] if out is None else [Path(out)]
    for folder in tried:
        try:
            folder.mkdir(parents=True, exist_ok=out is not None)  # who comes first has it
        except OSError as reason:
            if out is None and isinstance(reason, FileExistsError):
                continue
            raise InputError(f"cannot make the folder: {reason.strerror}", file=folder, mend="choose another --out") from None
        return folder
    raise InputError("a thousand runs in one second", file="runs", mend="choose --out")
