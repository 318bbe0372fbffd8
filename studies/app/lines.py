"""The Python lines that do what a command does: what the page shows beside it, for who wants to go on in a script."""

from argparse import Namespace
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr
from functools import lru_cache
from io import StringIO
from pathlib import PurePosixPath
from typing import Any

from studies.arguments import names
from studies.cli import parser


@lru_cache(maxsize=4096)
def python_lines(words: tuple[str, ...]) -> str:
    """Lines of Python that do the same as `workbench WORDS`; empty for a command that has no verb of its own."""
    with redirect_stderr(StringIO()):
        try:
            options = parser().parse_args(list(words))
        except SystemExit:
            return ""
    made = LINES.get(options.command)
    return "\n".join(["import workbench as wb", *made(options)]) if made else ""


def _read(name: str, files: Sequence[str], options: Namespace) -> list[str]:
    """data = wb.read(..) with the roles of the options."""
    return [f"{name} = wb.read({_called(map(_text, files), _roles(options))})"] if files else []


def _roles(options: Namespace) -> dict[str, str]:
    """How records are read: roles of channels, and the sample time of files without one."""
    asked = {key: getattr(options, key, None) for key in ("inputs", "outputs", "schedule")}
    said = {key: _several(names(text)) for key, text in asked.items() if text and (key, text) != ("schedule", "none")}
    dt = getattr(options, "file_dt", None)
    return said | ({"dt": f"{dt:g}"} if dt else {})


def _look(options: Namespace) -> list[str]:
    return [f"found = wb.look({_called(map(_text, options.records), _roles(options))})", *_saved("found", options)]


def _identify(options: Namespace) -> list[str]:
    asked = options.model.split(",")
    methods = {} if asked == ["all"] else {"best": "True"} if asked == ["best"] else {"methods": repr(asked)}
    held = ["held"] if options.holdout else []
    return [
        *_read("data", options.records, options),
        *_read("held", options.holdout, options),
        f"models = wb.identify({_called(['data', *held], methods)})",
        *_saved("models", options),
    ]


def _diagnose(options: Namespace) -> list[str]:
    verb = options.command
    held = ["held"] if options.holdout else []
    return [
        *_plant(options.plant),
        *_read("data", options.records, options),
        *_read("held", options.holdout, options),
        f"found = wb.{verb}({_called(['plant', 'data', *held], {})})",
        *_saved("found", options),
    ]


def _design(options: Namespace) -> list[str]:
    limits = {key: _numbers(getattr(options, key)) for key in ("setpoint", "low", "high", "rate") if getattr(options, key)}
    first = [f"model = wb.load_model({_text(options.model)})"]
    if options.kind == "mpc":
        said = {key: getattr(options, key) for key in ("horizon", "move", "sensitivity") if getattr(options, key)} | limits
        return ["from controllers import MPCDesign", *first, f"law = MPCDesign({_called([], said)}).on(model)"]
    if options.kind not in ("pid", "scheduled-pid"):
        return []
    bounds = {key: f"{own:g}" for key in ("sensitivity", "complementary", "effort") if (own := getattr(options, key))}
    knots = options.knots or ("1" if options.kind == "pid" else "")
    own = {"knots": f"[{knots}]" if "," in knots else knots} if knots else {}
    aim = {"objective": _text(options.objective)} if options.objective != "variance" else {}
    said = _called([], bounds | own | aim | limits)
    return ["from controllers import ScheduledPIDDesign", *first, f"law = ScheduledPIDDesign({said}).on(model)"]


def _check(options: Namespace) -> list[str]:
    said: dict[str, Any] = {}
    lines = ["from controllers import load_controller", f"law = load_controller({_text(options.controller)})"]
    if options.model:
        lines += [f"model = wb.load_model({_text(options.model)})", *_read("data", options.records, options)]
        said |= {"model": "model", "records": "data"}
    if options.plant:
        lines += _plant(options.plant)
        said["plant"] = "plant"
    if options.fitted:
        said["fitted"] = repr(list(options.fitted))
    return [
        *lines,
        f"answer = wb.check({_called(['law', _text(options.limits)], said)})",
        *_saved("answer", options),
    ]


def _export(options: Namespace) -> list[str]:
    return [
        "from controllers import load_controller",
        f"law = load_controller({_text(options.controller)})",
        f"law.export({_text(options.to)}, {_text(options.out or 'exported')})",
    ]


#: What writes the lines of a command.
LINES: dict[str, Callable[[Namespace], list[str]]] = {
    "look": _look, "identify": _identify, "diagnose": _diagnose, "calibrate": _diagnose, "design": _design, "check": _check,
    "export": _export,
}  # fmt: skip


def _plant(text: str) -> list[str]:
    """plant = ... of what --plant names."""
    before, plus, extended = text.rpartition("+")
    base, file = (before, extended) if plus else ("", text) if text.endswith(".json") else (text, "")
    if ":" in base:
        source, _, name = base.rpartition(":")
        module = PurePosixPath(source).with_suffix("").name if source.endswith(".py") else source
        own, found = [f"from {module} import {name} as plant"], "plant"
    else:
        own, found = ["from plants import PLANTS"], f"PLANTS[{_text(base) if base else 'extension.base'}]"
    if not file:
        return own if found == "plant" else [*own, f"plant = {found}"]
    loaded = ["from workbench.physics.extension import load_extension", f"extension = load_extension({_text(file)})"]
    return [*own, *loaded, f"plant = extension.of({found})"]


def _saved(name: str, options: Namespace) -> list[str]:
    return [f"{name}.save({_text(options.out)})"] if options.out else []


def _called(values: Any, said: dict[str, Any]) -> str:
    return ", ".join([*values, *(f"{key}={value}" for key, value in said.items())])


def _text(value: str) -> str:
    return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'


def _several(found: Sequence[str]) -> str:
    return _text(found[0]) if len(found) == 1 else repr(list(found)).replace("'", '"')


def _numbers(texts: Sequence[str]) -> str:
    """{"w3": 100.0} of w3=100,theta=0."""
    pairs = (part.partition("=") for text in texts for part in text.split(","))
    return "{" + ", ".join(f"{_text(name.strip())}: {value.strip()}" for name, _, value in pairs) + "}"
