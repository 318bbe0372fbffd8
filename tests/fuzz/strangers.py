"""Plants, records and options that nobody would choose, and the commands that are run on them.

Every finite input ends in an answer or in a refusal in words: `faults(seed, folder)` lists what did not.
"""

import contextlib
import io
import traceback
import warnings
from pathlib import Path
from random import Random

import numpy as np

from studies.cli import main

HEAD = (
    "import numpy as np\n\nfrom workbench import Channel, Parameter, Plant, Start\n"
    "from workbench.physics.effects import Shaft, Slide\n\n\n"
)

#: Equations of a few lines: (states, inputs, outputs, parameters, rates, readings, ports, start). Numbers of the parameters are
#: drawn anew, so that each equation is compiled once.
PLANTS = {
    "lag": (
        ("x",), ("u",), ("y",), {"T": 0.5, "k": 2.0},
        {"x": "(p.k * u.u - x.x) / p.T"}, {"y": "x.x"}, "()", "Start()",
    ),
    "slide": (
        ("q", "v"), ("F",), ("q",), {"m": 2.0, "b": 1.0},
        {"q": "x.v", "v": "(u.F - p.b * x.v + at.slide.torque()) / p.m"}, {"q": "x.q"}, '(Slide("slide", "v"),)', "Start()",
    ),
    "thrust": (
        ("th", "w"), ("u",), ("angle",), {"J": 0.02, "m": 0.5, "b": 0.05, "c": 1.0},
        {"th": "x.w", "w": "(p.c * u.u**2 - p.m * np.sin(x.th) - p.b * x.w + at.arm.torque()) / p.J"}, {"angle": "57.3 * x.th"},
        '(Shaft("arm", "w"),)', 'Start({"th": 0.3}, ("u",), ("w",))',
    ),
    "tanks": (
        ("h1", "h2"), ("u",), ("h",), {"k": 0.2, "a": 0.1, "b": 0.1},
        {"h1": "p.k * u.u - p.a * np.sqrt(x.h1)", "h2": "p.a * np.sqrt(x.h1) - p.b * np.sqrt(x.h2)"}, {"h": "x.h2"}, "()",
        'Start({"u": 0.5}, ("h1", "h2"), ("h1", "h2"))',
    ),
    "unstable": (
        ("a", "w"), ("F",), ("a", "w"), {"l": 0.4, "m": 0.2},
        {"a": "x.w", "w": "(9.81 * np.sin(x.a) - u.F * np.cos(x.a) / p.m) / p.l"}, {"a": "x.a", "w": "x.w"}, "()", "Start()",
    ),
    "carried": (
        ("x",), ("angle", "speed"), ("y",), {"T": 0.3, "k": 1.0},
        {"x": "(p.k * np.sin(u.angle) + 0.1 * u.speed - x.x) / p.T"}, {"y": "x.x"}, "()", "Start()",
    ),
    "reactor": (
        ("c", "T"), ("q", "Tc"), ("c", "T"), {"k0": 3.0, "E": 4.0, "h": 1.5},
        {"c": "u.q * (1.0 - x.c) - p.k0 * np.exp(-p.E / x.T) * x.c", "T": "u.q * (1.0 - x.T) + p.h * (u.Tc - x.T)"},
        {"c": "x.c", "T": "x.T"}, "()", 'Start({"q": 0.5, "Tc": 1.0}, ("c", "T"), ("c", "T"), {"c": 0.5, "T": 1.0})',
    ),
    "blind": (
        ("x", "z"), ("u",), ("y",), {"T": 0.5, "k": 1.0},
        {"x": "(u.u - x.x) / p.T", "z": "-p.k * x.z"}, {"y": "x.z"}, "()", "Start()",
    ),
}  # fmt: skip


def plant_file(kind: str, random: Random) -> str:
    """A user's Python file with this equation and numbers of its own."""
    states, inputs, outputs, parameters, rates, readings, ports, start = PLANTS[kind]
    role = "schedule" if kind == "carried" else "input"
    dt = random.choice((0.001, 0.01, 0.1, 1.0))
    units = random.choice(("", "", "m", "rad", "V", "rad/s"))
    numbers = {name: value * 10.0 ** random.choice((*[0] * 12, -3, 3, -9, 9)) for name, value in parameters.items()}
    tolerances = {name: random.choice((0.0, 0.05, 0.2, 0.5, 2.0)) for name in parameters}
    noise = {name: 10.0 ** random.randint(-9, 3) for name in outputs} if random.random() < 0.5 else {}
    limits = {states[0]: (-1.0, 1e3)} if random.random() < 0.2 else {}
    rows = [
        "def equation(x, u, p, at):",
        "    return {" + ", ".join(f"{name!r}: {rate}" for name, rate in rates.items()) + "}",
        "",
        "",
        "def measure(x, p):",
        "    return {" + ", ".join(f"{name!r}: {what}" for name, what in readings.items()) + "}",
        "",
        "",
        "PLANT = Plant(",
        f"    name={kind!r},",
        "    states=(" + "".join(f"Channel({name!r})," for name in states) + "),",
        "    inputs=(" + "".join(f"Channel({name!r}, {units!r}, {role!r})," for name in inputs) + "),",
        "    outputs=(" + "".join(f"Channel({name!r}, '', 'output')," for name in outputs) + "),",
        "    parameters=(" + "".join(f"Parameter({n!r}, {v!r}, tolerance={tolerances[n]})," for n, v in numbers.items()) + "),",
        f"    equation=equation, measure=measure, dt={dt}, ports={ports}, start={start},",
        f"    noise={noise!r}, limits={limits!r},",
        ")",
    ]
    return HEAD + "\n".join(rows) + "\n"


def signal(samples: int, random: Random, known: dict[str, np.ndarray]) -> np.ndarray:
    """A course of some kind (N,), at some size."""
    g = np.random.default_rng(random.randrange(2**32))
    k = np.arange(samples)
    odd = random.random() < 0.3
    size, level = 10.0 ** (odd * random.choice((-12, -6, 6, 12, 30, 150))), random.choice((0.0, 0.0, 1.0, -3.0, odd * 1e9))
    match random.choice(("still", "step", "binary", "sine", "ramp", "noise", "pulse", "copy", "late", "walk", "steps")):
        case "still":
            course = np.zeros(samples)
        case "step":
            course = (k > samples // 2) * 1.0
        case "binary":
            course = np.repeat(g.choice([-1.0, 1.0], samples), random.randint(1, 9))[:samples]
        case "sine":
            course = np.sin(k / random.choice((0.5, 3.0, 30.0)))
        case "ramp":
            course = k / samples
        case "noise":
            course = g.standard_normal(samples)
        case "pulse":
            course = (k == samples // 3) * 1.0
        case "walk":
            course = np.cumsum(g.standard_normal(samples))
        case "steps":
            course = np.round(2.0 * np.sin(k / 20.0))
        case kind if known:
            course = random.choice(list(known.values()))
            return np.roll(course, 3) if kind == "late" else course.copy()
        case _:
            course = g.standard_normal(samples)
    return size * (level + course)


def answered(inputs: list[np.ndarray], dt: float, random: Random) -> np.ndarray:
    """What a machine of the first order would make of them, with noise (N,)."""
    g, decay = np.random.default_rng(random.randrange(2**32)), np.exp(-dt / random.choice((0.02, 0.3, 5.0)))
    u, y = sum(inputs), np.zeros(len(inputs[0]))
    for k in range(1, len(y)):
        y[k] = decay * y[k - 1] + (1.0 - decay) * u[k - 1]
    return y + 0.02 * (np.std(y) or 1.0) * g.standard_normal(len(y))


def record(kind: str, dt: float, random: Random) -> str:
    """A CSV file with the channels of a plant."""
    _, inputs, outputs, *_ = PLANTS[kind]
    samples = random.choice((2, 5, 30, 120, 400, 400, 400, 400, 400, 400, 1200))
    known: dict[str, np.ndarray] = {}
    for name in inputs:
        known[name] = signal(samples, random, known)
    for name in outputs:
        sane = random.random() < 0.6
        known[name] = answered([known[n] for n in inputs], dt, random) if sane else signal(samples, random, known)
    if random.random() < 0.1:
        known.pop(random.choice(list(known)))
    if random.random() < 0.2:
        known["extra"] = signal(samples, random, known)
    t = random.choice((0.0, 0.0, 1e6)) + dt * np.arange(samples)
    rows = [",".join(["t [s]", *known]), *(",".join(map(repr, map(float, row))) for row in zip(t, *known.values(), strict=True))]
    return "\n".join(rows) + "\n"


def limits_file(kind: str, random: Random) -> str:
    """A file of limits for `check`."""
    outputs = PLANTS[kind][2]
    low, high = sorted(random.choice((-10.0, 0.0, 1e-9, 1.0, 1e6)) for _ in range(2))
    return (
        f"[run]\nduration = {random.choice((0.5, 5.0))}\n[run.setpoints]\n{outputs[0]} = {random.choice((0.0, 1.0, 1e3))}\n"
        f"[limits.{outputs[0]}]\nlow = {low}\nhigh = {high + 1.0}\n[loop]\nstable = true\nsensitivity = 2.0\n"
    )


def commands(kind: str, random: Random) -> list[list[str]]:
    """What is run, one after the other, in a folder that holds plant.py, a.csv, b.csv, limits.toml and sweep.toml."""
    _, inputs, outputs, parameters, *_ = PLANTS[kind]
    some = random.choice
    roles = ["--output", some(outputs), "--inputs", ",".join(inputs)]
    if random.random() < 0.3:
        roles += ["--schedule", some((*inputs, *outputs, "none"))]
    method = some(("lti", "ilm", "ssm", "lti,ssm", "all", "best", "interval"))
    model = f"m/{method if method in ('lti', 'ilm', 'ssm') else 'lti'}.json"
    held = ["--holdout", "b.csv"] if random.random() < 0.6 else []
    order = ["--order", str(some((1, 2, 5, 40)))] if random.random() < 0.5 else []
    name = some(tuple(parameters))
    fit = ["--parameters", name] if random.random() < 0.4 else []
    if random.random() < 0.4:
        fit += ["--bound", f"{name}={some(('0:1', '1e-9:1e9', '1:1', '2:1', '-1:3'))}"]
    out_of = ["--holdout", "b.csv"] if random.random() < 0.5 else []
    effect = some(("offset@{}:value=1", "saturation@{}:limit=1", "dead-zone@{}:half_width=0.1", "input-delay@{}:time=0.05"))
    shown = ["--effect", effect.format(inputs[0])] if random.random() < 0.3 else []
    law = some(("pid", "scheduled-pid", "mpc"))
    low = ["--low", f"{inputs[0]}=-1", "--high", f"{inputs[0]}=1"] if random.random() < 0.5 else []
    peak = ["--sensitivity", some(("1.05", "1.6", "4"))] if random.random() < 0.3 else []
    bound = ["--bound", some(("1", "0.1,0.2", "x", "-1", "1e300"))] if random.random() < 0.4 else []
    searched = ["--plant", "plant.py:PLANT", "--runs", "5"] if random.random() < 0.4 else []
    checked = ["--controller", f"l/{law}.json", "--limits", "limits.toml", "--model", model, "--records", "a.csv", "b.csv"]
    return [
        ["identify", "a.csv", *roles, "--model", method, *order, *held, "--out", "m"],
        ["compare", model, "--holdout", "b.csv", "--out", "c"],
        ["simulate", "plant.py:PLANT", "--inputs-from", "a.csv", *shown, "--out", "s"],
        ["effects", "plant.py:PLANT"],
        ["calibrate", "a.csv", "--plant", "plant.py:PLANT", *fit, *out_of, "--out", "k"],
        ["diagnose", "a.csv", "--plant", "plant.py:PLANT", *out_of, "--out", "d"],
        ["design", law, "--model", model, *low, *peak, "--out", "l"],
        ["export", f"l/{law}.json", "--to", some(("c", "st", "csv", "json")), "--out", "e"],
        ["check", *checked, *bound, *searched, "--out", "p"],
        ["sweep", "sweep.toml", "--out", "w"],
    ]


def sweep_file(kind: str) -> str:
    """A sweep of a loop on the plant over its first parameter."""
    name = next(iter(PLANTS[kind][3]))
    return (
        'run = "closed-loop"\ndesign = "grid"\noutputs = ["' + PLANTS[kind][2][0] + ' RMS"]\n'
        f"[parameters.{name}]\nvalues = [0.5, 1.0]\n"
        '[fixed]\nplant = "plant.py:PLANT"\ncontroller = "l/pid.json"\n'
        f"[fixed.run]\nduration = 1.0\n[fixed.run.setpoints]\n{PLANTS[kind][2][0]} = 0.1\n"
    )


def faults(seed: int, folder: Path, only: tuple[str, ...] = (), kind: str = "") -> list[str]:
    """What neither answered nor refused in words, of the commands that this seed draws; folder: an empty one."""
    random = Random(seed)
    kind = kind or random.choice(list(PLANTS))
    text = plant_file(kind, random)
    (folder / "plant.py").write_text(text)
    dt = float(text.split("dt=")[1].split(",")[0]) * random.choice((*[1] * 8, 0.1, 0.01, 10, 60, 1.0005))
    for name in ("a.csv", "b.csv"):
        (folder / name).write_text(record(kind, dt, random))
    (folder / "limits.toml").write_text(limits_file(kind, random))
    (folder / "sweep.toml").write_text(sweep_file(kind))
    found = []
    for words in commands(kind, random):
        if only and words[0] not in only:
            continue
        if fault := _fault(words, folder):
            found.append(f"seed {seed}, {kind}: workbench {' '.join(words)}\n{fault}")
    return found


def _fault(words: list[str], folder: Path) -> str:
    """Why this is no answer, empty where it is one."""
    said, wrong = io.StringIO(), io.StringIO()
    with warnings.catch_warnings(), contextlib.chdir(folder), contextlib.redirect_stdout(said), contextlib.redirect_stderr(wrong):
        warnings.simplefilter("ignore")
        try:
            code = main(words)
        except SystemExit as stop:
            code = stop.code
        except Exception:
            return traceback.format_exc()
    message = wrong.getvalue()
    if code not in (0, 1, 2, 3):
        return f"exit code {code}: {message}"
    if "Traceback" in message:
        return message
    if code == 2 and len(message.split()) < 6:
        return f"a refusal that names nothing: {message!r}"
    return ""
