"""Traced equations printed as straight-line numba code: the only compiled code path of a simulation.

A kernel advances `LANES` runs side by side: lane l of row i of the one work array W is W[i * LANES + l], every traced
function is a loop over lanes without branches or calls, and LLVM makes SIMD code of it. What depends on parameters alone is
computed once per run. Kernels are files named by the hash of their content in the user's cache folder, where numba keeps
the machine code beside them: same content, no compilation; other content, another file.
"""

import hashlib
import importlib.util
import re
import sys
import tempfile
import threading
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from textwrap import indent
from types import ModuleType

import casadi as ca

from workbench.files import user_cache, write_text
from workbench.records import record

SCALAR, SIMD = 1, 16  # lanes: one run for the shortest answer, sixteen for the highest rate

_BINARY = {
    ca.OP_ADD: "{a} + {b}", ca.OP_SUB: "{a} - {b}", ca.OP_MUL: "{a} * {b}", ca.OP_DIV: "{a} / {b}",
    # NaN on either side is kept, as numpy keeps it
    ca.OP_FMIN: "({a} if not {a} >= {b} else {b}) + 0.0 * {b}", ca.OP_FMAX: "({a} if not {a} <= {b} else {b}) + 0.0 * {b}",
    ca.OP_LT: "1.0 if {a} < {b} else 0.0", ca.OP_LE: "1.0 if {a} <= {b} else 0.0",
    ca.OP_EQ: "1.0 if {a} == {b} else 0.0", ca.OP_NE: "1.0 if {a} != {b} else 0.0",
    ca.OP_AND: "1.0 if {a} * {b} != 0.0 else 0.0", ca.OP_OR: "1.0 if abs({a}) + abs({b}) != 0.0 else 0.0",
    ca.OP_IF_ELSE_ZERO: "{b} if {a} != 0.0 else 0.0", ca.OP_POW: "{a} ** {b}", ca.OP_CONSTPOW: "{a} ** {b}",
    ca.OP_COPYSIGN: "math.copysign({a}, {b})", ca.OP_ATAN2: "math.atan2({a}, {b})", ca.OP_FMOD: "math.fmod({a}, {b})",
    ca.OP_HYPOT: "math.hypot({a}, {b})",
}  # fmt: skip
_UNARY = {
    ca.OP_ASSIGN: "{a}", ca.OP_NEG: "-{a}", ca.OP_INV: "1.0 / {a}", ca.OP_SQ: "{a} * {a}", ca.OP_TWICE: "2.0 * {a}",
    ca.OP_SQRT: "math.sqrt({a})", ca.OP_FABS: "abs({a})", ca.OP_FLOOR: "math.floor({a})", ca.OP_CEIL: "math.ceil({a})",
    ca.OP_SIGN: "(1.0 if {a} > 0.0 else 0.0) - (1.0 if {a} < 0.0 else 0.0)", ca.OP_NOT: "1.0 if {a} == 0.0 else 0.0",
    ca.OP_EXP: "elementary.exp({a})", ca.OP_TANH: "elementary.tanh({a})", ca.OP_SIN: "elementary.sin({a})",
    ca.OP_COS: "elementary.cos({a})", ca.OP_LOG: "math.log({a})", ca.OP_TAN: "math.tan({a})",
    ca.OP_ASIN: "math.asin({a})", ca.OP_ACOS: "math.acos({a})", ca.OP_ATAN: "math.atan({a})",
    ca.OP_SINH: "math.sinh({a})", ca.OP_COSH: "math.cosh({a})", ca.OP_EXPM1: "math.expm1({a})",
    ca.OP_LOG1P: "math.log1p({a})", ca.OP_ERF: "math.erf({a})",
}  # fmt: skip


class Rows:
    """Names for stretches of the work array: `rows.take("x", 7)` reserves seven rows, `rows["x"]` is the first of them."""

    def __init__(self):
        self.first: dict[str, int] = {}
        self.size: dict[str, int] = {}
        self.total = 0

    def take(self, name: str, size: int) -> int:
        self.first[name], self.size[name] = self.total, size
        self.total += size
        return self.first[name]

    def shared(self, name: str, size: int) -> int:
        """Rows for passing use: the same ones for everybody who asks for this name, as many as the largest needs."""
        if self.size.get(name, 0) < size:
            self.take(name, size)
        return self.first[name]

    def __getitem__(self, name: str) -> int:
        return self.first[name]

    def span(self, name: str) -> slice:
        return slice(self.first[name], self.first[name] + self.size[name])


@record
class Code:
    """Source lines of one traced function: `once` runs before the first sample, `body` at every call."""

    once: tuple[str, ...]
    body: tuple[str, ...]


def print_function(function: ca.Function, rows: Rows, arguments: list[str], results: list[str], constant: set[str]) -> Code:
    """Straight-line code of a traced function on the work array.

    arguments, results: names of the rows that stand for its inputs and outputs; constant: the arguments that do not change
    during a run, so that whatever depends on them alone moves to `once`.
    """
    register: dict[int, tuple[str, bool]] = {}  # CasADi's register -> (expression, constant during a run?)
    once: list[str] = []
    body: list[str] = []
    written: list[str] = []
    kept: dict[str, str] = {}
    prefix = function.name()

    def used(name: str, fixed: bool, by_fixed: bool) -> str:
        """How a value is written where it is used: one computed once and needed in the body goes through its own row."""
        if not fixed or by_fixed or not name.startswith("c"):
            return name
        if name not in kept:
            kept[name] = _cell(rows.take(f"{prefix}.{name}", 1))
            once.append(f"{kept[name]} = {name}")
        return kept[name]

    for k in range(function.n_instructions()):
        operation, inputs = function.instruction_id(k), function.instruction_input(k)
        out = function.instruction_output(k)
        if operation == ca.OP_CONST:
            register[out[0]] = (f"{function.instruction_constant(k)!r}".replace("inf", "math.inf"), True)
        elif operation == ca.OP_INPUT:
            argument = arguments[inputs[0]]
            cell = _cell(rows[argument] + inputs[1])
            if argument not in constant:  # read before anything is written: results may overwrite arguments
                body.append(f"v{k} = {cell}")
                cell = f"v{k}"
            register[out[0]] = (cell, argument in constant)
        elif operation == ca.OP_OUTPUT:
            written.append(f"{_cell(rows[results[out[0]]] + out[1])} = {used(*register[inputs[0]], by_fixed=False)}")
        else:
            form = _UNARY.get(operation) or _BINARY.get(operation)
            if form is None:
                raise NotImplementedError(f"{prefix}: operation {operation} of CasADi has no compiled form")
            operands = [register[i] for i in (inputs[:1] if operation in _UNARY else inputs)]
            fixed = all(f for _, f in operands)
            a, b = ([used(name, f, fixed) for name, f in operands] + [""])[:2]
            name = f"{'c' if fixed else 'v'}{k}"
            (once if fixed else body).append(f"{name} = " + form.format(a=_bracket(a), b=_bracket(b)))
            register[out[0]] = (name, fixed)
    return Code(tuple(once), (*body, *written))


def _cell(row: int) -> str:
    return f"W[{row} * LANES + l]"


def _bracket(expression: str) -> str:
    return f"({expression})" if expression.startswith("-") else expression


_HEAD = '''"""Generated; do not edit. {title}"""

import math

import numpy as np
from numba import njit

from workbench.physics import elementary

LANES = {lanes}
HALFWAY = np.array([5.0 / 24.0, 1.0 / 6.0, 1.0 / 6.0, -1.0 / 24.0])  # dense output of the Runge-Kutta step, of order three
INSTANT = np.array([0.0, 0.5, 0.5, 1.0])  # of the stages within a step
{tables}

@njit("void(f8[::1], b1[::1])", cache=True, nogil=True, error_model="numpy")
def add_parts(W, on):
    """What the effects that are on add to the rates."""
{parts}


@njit("void(f8[::1], b1[::1])", cache=True, nogil=True, error_model="numpy")
def remember(W, on):
    """What the sensors keep after a step; one without an effect keeps the output itself."""
    for i in range({ny}):
        for j in range({deep} if not on[{first_sensor} + i] else 0):
            elementary.copy_row(W, {mem} + i * {deep} + j, W, {after} + i, LANES)
{sensors}


@njit(
    "void(f8[::1], f8[:, :, ::1], f8[:, :, ::1], f8[:, :, ::1], f8[:, ::1], i8[:, :, ::1], f8[:, :, ::1],"
    "f8[:, :, ::1], f8[:, :, ::1], f8[:, :, ::1], i8, i8, i8, i8, f8, b1[::1], b1, b1, f8[:, ::1], f8[:, :, ::1],"
    "i8[::1], f8[:, :, ::1], f8[:, :, ::1], f8[:, :, ::1], f8[::1], f8[:, :, :, ::1], f8[:, :, :, ::1], f8[:, :, ::1], b1[::1])",
    cache=True, nogil=True, error_model="numpy",
)
def run(
    W, reference, disturbance, noise, step, back, acting, states, measured, commands, begin, end, first, every, dt, on, affected,
    remembering, observed, gain, corrected, restart, push, remembered, decay, bend, bent, late, follows
):
    """Advance LANES runs through the samples from `begin` to `end`; see workbench.physics.stepper for the arrays."""
    for l in range(LANES):
{once}
'''
_SAMPLE = """    for k in range(begin, end):
        for i in range({nr}):
            elementary.copy_row(W, {r} + i, reference, k * {nr} + i, LANES)
        for l in range(LANES):
            W[{t} * LANES + l] = k * dt
        for i in range({ny}):
            elementary.copy_row(W, {error} + i, noise, k * {ny} + i, LANES)
"""
_READ = """        for l in range(LANES):
{read}
        for i in range({ny} if len(decay) > 0 else 0):
            for l in range(LANES):
                W[({y} + i) * LANES + l] += W[({coloured} + i) * LANES + l]
"""
_CONTROL = """        if k % every == 0:
            for l in range(LANES):
{control}
"""
_DRIVE = """        for l in range(LANES):
{drive}
        for i in range({nu}):
            for l in range(LANES):
                acting[first + k, i, l] = W[({v} + i) * LANES + l] + disturbance[k, i, l]
                commands[k, i, l] = W[({u} + i) * LANES + l]
"""
# inputs of a record that go on between their samples: what acts at all samples comes first, and what leads from one to the next
_SAVE = "    saved = W.copy()\n"
_REACH = """        for i in range({nu}):
            for l in range(LANES):
                W[({reach} + i) * LANES + l] = 0.5 * (abs(bend[k, i, 0, l]) + abs(bend[k, i, 1, l]) + abs(bend[k, i, 2, l]))
"""
_BEND = """        for i in range({nu}):
            for j in range(3):
                for l in range(LANES):
                    bent[first + k, i, j, l] = W[({steep} + i) * LANES + l] * bend[k, i, j, l]
    W[:] = saved
    for k in range(first + begin, first + end):
        for i in range({nu}):
            for l in range(LANES if follows[i] else 0):
                ahead = acting[k + 1, i, l] - acting[k, i, l] if k + 1 < first + end else 0.0
                bent[k, i, 0, l] = ahead - bent[k, i, 1, l] - bent[k, i, 2, l]
"""
_FOLLOW = """                for l in range(LANES):
{follow}
                for i in range({nu} if len(decay) > 0 else 0):
                    for l in range(LANES):
                        W[({w} + i) * LANES + l] += W[({surge} + i) * LANES + l]
"""
_LOG = """        for i in range({nx}):
            elementary.copy_row(states, k * {nx} + i, W, {x} + i, LANES)
        for i in range({ny}):
            elementary.copy_row(measured, k * {ny} + i, W, {y} + i, LANES)
        for i in range({nm} if len(remembered) > 0 else 0):
            elementary.copy_row(remembered, k * {nm} + i, W, {mem} + i, LANES)
"""
_CORRECT = """        # the state before the next step: given for every sample anew, or corrected by what was observed
        if len(restart) > 0:
            for i in range({nx}):
                for l in range(LANES):
                    if restart[k, i, l] == restart[k, i, l]:
                        W[({x} + i) * LANES + l] = restart[k, i, l]
            for i in range({nm}):
                for l in range(LANES):
                    if restart[k, {nx} + i, l] == restart[k, {nx} + i, l]:
                        W[({mem} + i) * LANES + l] = restart[k, {nx} + i, l]
        for j in range({ny} if len(gain) > 0 else 0):
            for l in range(LANES):
                error = observed[k, j] - W[({y} + j) * LANES + l]
                W[{error} * LANES + l] = error if error == error else 0.0  # what was not observed corrects nothing
            for i in range(len(corrected)):
                if gain[k, i, j] != 0.0:
                    elementary.add_row(W, corrected[i], gain[k, i, j], W, {error}, LANES)
        if len(restart) + len(gain) > 0:
            for l in range(LANES):
{show}
            for l in range(LANES if remembering else 0):
                W[{h} * LANES + l] = 0.0  # a step of no length: what a new output tells the sensors at once
            for i in range({ny} if remembering else 0):
                elementary.copy_row(W, {midway} + i, W, {before} + i, LANES)
                elementary.copy_row(W, {after} + i, W, {before} + i, LANES)
            if remembering:
                remember(W, on)
"""
# the rate of change at `stage`, for the integrator and, at the samples, for a discrete plant
_SLOPE = """        if affected:
            add_parts(W, on)
            for l in range(LANES):
{rates}
        else:
            for l in range(LANES):
{nominal}
        for i in range({np} if len(push) > 0 else 0):
            for l in range(LANES):
                W[({slope} + i) * LANES + l] += push[k, i, l]
        if len(decay) > 0:
            for l in range(LANES):
{drifting}
"""
_STEP = """        for s in range(len(step)):
"""
_HOLD = """            for i in range({nu}):
                for l in range(LANES):
                    W[({w} + i) * LANES + l] = acting[first + k - back[s, i, l], i, l]
            for i in range({nu} if len(decay) > 0 else 0):
                for l in range(LANES):
                    W[({w} + i) * LANES + l] += W[({surge} + i) * LANES + l]
"""
_STAGE = """            for l in range(LANES):
                W[{h} * LANES + l] = step[s, l]
            # classic Runge-Kutta of order four; `stage` is where the derivative is taken
            for i in range({nx}):
                elementary.copy_row(W, {stage} + i, W, {x} + i, LANES)
                elementary.copy_row(W, {sum} + i, W, {x} + i, LANES)
                elementary.copy_row(W, {halfway} + i, W, {x} + i, LANES)
            for q in range(4):
                ahead = 0.5 if q < 2 else 1.0
                share = 1.0 / 6.0 if q == 0 or q == 3 else 1.0 / 3.0
"""
_RISE = (
    indent(_SLOPE, 8 * " ", lambda line: line.startswith(" "))
    + """                for l in range(LANES):
                    h = W[{h} * LANES + l]
{rising}
                # the same four slopes, otherwise weighted, lead to the middle of the step
                between = HALFWAY[q]
                for i in range({nx} if remembering else 0):
                    for l in range(LANES):
                        W[({halfway} + i) * LANES + l] += between * W[{h} * LANES + l] * W[({slope} + i) * LANES + l]
                if q == 0 or q == 2:
                    for l in range(LANES):
                        W[{t} * LANES + l] += 0.5 * W[{h} * LANES + l]
            for i in range({nx}):
                elementary.copy_row(W, {x} + i, W, {sum} + i, LANES)
            for l in range(LANES if remembering else 0):
{midst}
            if remembering or s == len(step) - 1:
                for l in range(LANES):
{measure}
                remember(W, on)
                for i in range({ny}):
                    elementary.copy_row(W, {before} + i, W, {after} + i, LANES)
"""
)
_FADE = """        for i in range(len(decay)):  # of drifts, surges, coloured readings: their rows follow each other
            for l in range(LANES):
                W[({drift} + i) * LANES + l] *= decay[i]
"""
# a discrete plant: outputs see the inputs of their own sample, and one evaluation of the equation leads to the next
_ARRIVE = """        # what acts in a sample is the mean of its hold: a dead time may lie between two samples
        for i in range({nu}):
            for l in range(LANES):
                W[({w} + i) * LANES + l] = 0.0
            for s in range(len(step)):
                for l in range(LANES):
                    W[({w} + i) * LANES + l] += step[s, l] / dt * acting[first + k - back[s, i, l], i, l]
        for l in range(LANES):
{measure}
        for l in range(LANES):
            W[{h} * LANES + l] = dt
        for i in range({ny}):  # between two samples nothing is known: a straight line
            for l in range(LANES):
                W[({midway} + i) * LANES + l] = 0.5 * (W[({before} + i) * LANES + l] + W[({after} + i) * LANES + l])
        remember(W, on)
        for i in range({ny}):
            elementary.copy_row(W, {before} + i, W, {after} + i, LANES)
"""
_JUMP = (
    """        # rates are taken at the sample and hold until the next one
        for i in range({nx}):
            elementary.copy_row(W, {stage} + i, W, {x} + i, LANES)
"""
    + _SLOPE
    + """        for i in range({nx}):
            for l in range(LANES):
                W[({x} + i) * LANES + l] += dt * W[({slope} + i) * LANES + l]
"""
)
_ARRIVED = "".join([_SAMPLE, _READ, _CONTROL, _DRIVE, _LOG, _CORRECT])
_CONTINUOUS = "".join([_HEAD, _ARRIVED, _STEP, _HOLD, _STAGE, _RISE, _FADE])
_CURVED = "".join([_HEAD, _SAVE, _SAMPLE, _REACH, _CONTROL, _DRIVE, _BEND, _ARRIVED, _STEP, _STAGE, _FOLLOW, _RISE, _FADE])
_DISCRETE = "".join([_HEAD, _SAMPLE, _CONTROL, _DRIVE, _ARRIVE, _READ, _LOG, _CORRECT, _JUMP, _FADE])
_INDENT = {
    "once": 8, "read": 12, "control": 16, "drive": 12, "show": 16, "rates": 24, "nominal": 24, "drifting": 24, "rising": 20,
    "midst": 16, "measure": 20, "follow": 20,
}  # fmt: skip
_INDENT_DISCRETE = _INDENT | {"rates": 16, "nominal": 16, "drifting": 16, "measure": 12}


@record
class Switched:
    """Code that runs only where it is switched on; `after`: names of the parts that must have run before it."""

    name: str
    code: Code
    after: frozenset[str]


def kernel_source(
    title: str,
    lanes: int,
    rows: Rows,
    codes: Mapping[str, Code],
    parts: Sequence[Switched],
    sensors: Sequence[Switched],
    sizes: Mapping[str, int],
    discrete: bool,
    curved: bool,
    swung: Sequence[int],
) -> str:
    """The text of a kernel module; entry j of its `on` switches the j-th of parts and sensors together.

    curved: whether inputs may go on between their samples; swung: inputs whose rate of change the equation needs.
    """
    indent, template = (_INDENT_DISCRETE, _DISCRETE) if discrete else (_INDENT, _CURVED if curved else _CONTINUOUS)
    once = [line for code in (*codes.values(), *(part.code for part in (*parts, *sensors))) for line in code.once]
    blocks = {"once": once} | {name: list(code.body) for name, code in codes.items()}
    # written out row by row: LLVM turns a loop over lanes into SIMD code where it sees that no two rows overlap
    slope, drift, total, stage, x = (rows[name] for name in ("slope", "drift", "sum", "stage", "x"))
    blocks["drifting"] = [f"{_cell(slope + i)} += {_cell(drift + i)}" for i in range(sizes["np"])]
    blocks["rising"] = [
        line
        for i in range(sizes["nx"])
        for line in (
            f"r{i} = h * {_cell(slope + i)}",
            f"{_cell(total + i)} += share * r{i}",
            f"{_cell(stage + i)} = {_cell(x + i)} + ahead * r{i}",
        )
    ]
    blocks["follow"] = [line for i in range(sizes["nu"]) for line in _following(i, rows, swung)]
    text = {name: "\n".join(" " * indent[name] + line for line in lines or ["pass"]) for name, lines in blocks.items()}
    tables: list[str] = []
    text["parts"] = _switched(parts, 0, rows, tables)
    text["sensors"] = _switched(sensors, len(parts), rows, tables)
    text["tables"] = "\n".join(tables)
    return template.format(title=title, lanes=lanes, first_sensor=len(parts), **text, **rows.first, **sizes)


def _following(i: int, rows: Rows, swung: Sequence[int]) -> list[str]:
    """Code of what input i is in a stage of the integrator, and of its rate of change where the equation needs it."""
    b1, b2, b3 = (f"bent[m, {i}, {j}, l]" for j in range(3))
    rates = [_cell(rows["rate"] + j) for j, own in enumerate(swung) if own == i]
    return [
        f"m = first + k - back[s, {i}, l]",
        f"at = late[s, {i}, l] + INSTANT[q] * step[s, l] / dt",
        f"{_cell(rows['w'] + i)} = acting[m, {i}, l] + at * ({b1} + at * ({b2} + at * {b3}))",
        *(f"{rate} = ({b1} + at * (2.0 * {b2} + at * 3.0 * {b3})) / dt if follows[{i}] else {rate}" for rate in rates),
    ]


_CELL = re.compile(r"W\[(\d+) \* LANES \+ l\]")


def _switched(parts: Sequence[Switched], first: int, rows: Rows, tables: list[str]) -> str:
    """Code of all parts. Those that differ in nothing but their rows share it: their rows are copied to fixed ones and back.

    The same friction at three shafts is compiled once; on fixed rows LLVM sees that no two of them overlap.
    """
    depth: dict[str, int] = {}
    for part in parts:
        depth[part.name] = 1 + max((depth[name] for name in part.after), default=-1)
    alike: dict[tuple[int, str], list[tuple[int, list[int]]]] = {}
    for j, part in enumerate(parts):
        cells: dict[str, int] = {}
        body = "\n".join(part.code.body)
        pattern = _CELL.sub(lambda cell, cells=cells: f"<{cells.setdefault(cell[1], len(cells))}>", body)
        alike.setdefault((depth[part.name], pattern), []).append((first + j, [int(row) for row in cells]))
    lines: list[str] = []
    for (_, pattern), members in sorted(alike.items(), key=lambda item: item[0][0]):
        width = len(members[0][1])
        base = rows.shared("fixed", width)
        table = f"ROWS{len(tables)}"
        tables.append(f"{table} = np.array({[[switch, *own] for switch, own in members]})  # switch, then rows")
        lines += [
            f"    for m in range({len(members)}):",
            f"        if on[{table}[m, 0]]:",
            f"            for i in range({width}):",
            f"                elementary.copy_row(W, {base} + i, W, {table}[m, i + 1], LANES)",
            "            for l in range(LANES):",
        ]
        body = re.sub(r"<(\d+)>", lambda cell, base=base: _cell(base + int(cell[1])), pattern).splitlines()
        lines += [f"                {line}" for line in body]
        written = sorted({int(cell[1]) for line in pattern.splitlines() if (cell := re.match(r"<(\d+)> = ", line))})
        for i in written:
            lines.append(f"            elementary.copy_row(W, {table}[m, {i + 1}], W, {base + i}, LANES)")
    return "\n".join(lines or ["    pass"])


@cache
def cache_folder() -> Path:
    """Folder of the compiled kernels: under $WORKBENCH_CACHE or the user's cache folder.

    Where neither can be written, a new private folder that only this process knows: what lies in a shared one is run.
    """
    return user_cache("kernels") or Path(tempfile.mkdtemp(prefix="gain-scheduling-workbench-"))


_LOADING = threading.Lock()


def load_kernel(source: str) -> ModuleType:
    """Import a kernel module from the cache folder, writing and compiling it where it is new."""
    shared = (Path(__file__).parent / "elementary.py").read_text(encoding="utf-8")
    name = "kernel_" + hashlib.sha256((source + shared).encode()).hexdigest()[:24]
    with _LOADING:  # a module is listed before it is complete
        return sys.modules.get(name) or _import(name, source)


def _import(name: str, source: str) -> ModuleType:
    path = cache_folder() / f"{name}.py"
    if not path.exists() or path.read_text(encoding="utf-8") != source:  # a file cut short by a full disk is mended
        write_text(path, source)
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # numba looks it up by name when it loads the machine code
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module
