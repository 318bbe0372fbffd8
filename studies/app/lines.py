"""The Python lines that do what a command does: what the page shows beside it, for who wants to go on in a script."""

from argparse import Namespace
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr
from functools import lru_cache
from io import StringIO
from pathlib import PurePosixPath
from typing import Any

from studies.arguments import is_plant, names
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
    lines = made(options) if made else []
    return "\n".join(["import workbench as wb", *lines]) if lines else ""


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
    if is_plant(options.model) or options.diagnosis or options.tube or options.until or options.kind not in DESIGNS:
        return []
    bounds = {key: f"{getattr(options, key):g}" for key in ("sensitivity", "complementary", "effort")}
    first, on = [f"model = wb.load_model({_text(options.model)})"], ["model"]
    if options.plant:
        first, on = [*first, *_plant(options.plant)], ["model", "plant"]
    on += ["accept=True"] if options.accept else []
    said = {"sensitivity": bounds["sensitivity"]}
    if options.kind == "mpc":
        if not options.fallback and (bounds != USUAL or _structure(options) or options.robust_to):
            return []  # they are the fallback's, which the design makes with the usual ones
        said |= {key: own for key in ("horizon", "move") if (own := getattr(options, key)) is not None}
        said |= {"keep": _ranges(options.keep)} if options.keep else {}
        if options.fallback:
            first = ["from controllers import load_controller", *first, f"fallback = load_controller({_text(options.fallback)})"]
            said["fallback"] = "fallback"
    else:
        said = bounds | _structure(options)
        if options.robust_to:
            said["robust_to"] = f"({', '.join(f'wb.load_model({_text(file)})' for file in options.robust_to)},)"
    said |= {key: _numbers(own) for key in ("setpoint", "low", "high", "rate") if (own := getattr(options, key))}
    kind = "MPCDesign" if options.kind == "mpc" else "ScheduledPIDDesign"
    return [f"from controllers import {kind}", *first, f"law = {kind}({_called([], said)}).on({', '.join(on)})"]


def _structure(options: Namespace) -> dict[str, str]:
    """What a PID is made of, and what it is tried with, where it is not the usual."""
    knots = options.knots or ("1" if options.kind == "pid" and options.at is None else "")
    found = {"knots": f"[{options.at or knots}]" if options.at or "," in knots else knots} if options.at or knots else {}
    found |= {"objective": _text(options.objective)} if options.objective != "variance" else {}
    off = {"no_derivative": "derivative", "no_feedforward": "feedforward", "fixed_gains": "moving"}
    found |= {key: "False" for option, key in off.items() if getattr(options, option)}
    found |= {key: f"{own:g}" for key in ("filter", "load_every") if (own := getattr(options, key)) is not None}
    found |= {"setpoint_weight": f"{options.setpoint_weight:g}"} if options.setpoint_weight != 1.0 else {}
    found |= {key: _numbers(own) for key in ("reference_model", "slew", "load", "size") if (own := getattr(options, key))}
    found |= {"steps": _numbers(options.step)} if options.step else {}
    paths = [name for text in options.path for name in names(text)]
    return found | ({"paths": f"({', '.join(map(_text, paths))},)"} if paths else {})


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


#: Laws that a design of `controllers` makes, and the bounds that it keeps where none are said.
DESIGNS, USUAL = ("pid", "scheduled-pid", "mpc"), {"sensitivity": "1.6", "complementary": "1.6", "effort": "3"}

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
    return "{" + ", ".join(f"{_text(name)}: {_number(value)}" for name, value in _pairs(texts)) + "}"


def _ranges(texts: Sequence[str]) -> str:
    """{"theta": (-20, 20)} of theta=-20:20."""
    ends = ((name, value.partition(":")) for name, value in _pairs(texts))
    return "{" + ", ".join(f"{_text(name)}: ({_number(low)}, {_number(high)})" for name, (low, _, high) in ends) + "}"


def _pairs(texts: Sequence[str]) -> list[tuple[str, str]]:
    pairs = (part.partition("=") for text in texts for part in text.split(","))
    return [(name.strip(), value.strip()) for name, _, value in pairs]


def _number(text: str) -> str:
    return text if text.lower().lstrip("+-") not in ("inf", "infinity") else f'float("{text}")'
