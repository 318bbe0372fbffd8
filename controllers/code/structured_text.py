"""A scheduled PID as IEC 61131-3 Structured Text for a PLC: a function block."""

import re
import textwrap
from string import Template
from typing import NamedTuple

from controllers.code.constants import Table, channels, curves_by_number, table_sizes, tables
from controllers.code.text import (
    BASIS_NAMES,
    NO_LIMIT,
    basis_meaning,
    double_text,
    head_lines,
    numbered,
    plain_comment,
    power_text,
    with_comment,
)
from controllers.scheduled_pid import BackCalculation, ScheduledPID
from workbench.basis import Basis, Gaussian, PiecewiseLinear, Powers, Products
from workbench.physics.controller import schedules_of

ST_BLOCK = Template("""\
(*
$head

Call it once a sample. While take_over is TRUE the command is held, within its limits: without a bump the law goes on from there
when it turns FALSE.
*)
FUNCTION_BLOCK $name
VAR_INPUT
    set_point : ARRAY[1..$nu_y] OF LREAL; (* r: $references *)
    measured : ARRAY[1..$nu_y] OF LREAL; (* y: $outputs *)
$schedule_in    take_over : BOOL; (* TRUE: the first command is that in held *)
    held : ARRAY[1..$nu_u] OF LREAL; (* $inputs *)
    restart : BOOL; (* TRUE: start anew, from z = 0 *)
END_VAR
VAR_OUTPUT
    command : ARRAY[1..$nu_u] OF LREAL; (* u: $inputs *)
    valid : BOOL; (* every number of the step was one: the last command is held where not *)
$schedule_out    limited : ARRAY[1..$nu_u] OF INT; (* what set a command: 0 the law, 1 LOW, 2 HIGH, 3 RATE *)
END_VAR
VAR
    warm : BOOL; (* there is a sample before this one *)
    takes_over : BOOL; (* the next command goes on from last *)
    z : ARRAY[1..$nu_u] OF LREAL; (* integral parts *)
    f : ARRAY[1..$nu_y] OF LREAL; (* filtered derivatives of C $l - y *)
    d : ARRAY[1..$nu_y] OF LREAL; (* last C $l - y *)
$shaping_state    last : ARRAY[1..$nu_u] OF LREAL; (* last commands *)
    difference : LREAL;
    own : LREAL; (* the command without its integral part *)
    push : LREAL; (* what the error adds to the integral part *)
    v : LREAL; (* the command without limits *)
    reached : LREAL; (* v within the rate *)
$locals    i : INT;
    j : INT;
END_VAR
VAR CONSTANT
$sizes
$tables
END_VAR

IF restart OR take_over THEN
    warm := FALSE;
    takes_over := take_over;
$counted_anew    FOR i := 1 TO NU DO
        z[i] := 0.0;
        last[i] := 0.0;
$sides_anew        IF take_over THEN
            last[i] := held[i];
        END_IF;
    END_FOR;
END_IF;
$weights
(* of what is no finite number, the difference from itself is not 0 *)
valid := $finite;
FOR j := 1 TO NY DO
    valid := valid AND (set_point[j] - set_point[j] = 0.0) AND (measured[j] - measured[j] = 0.0);
END_FOR;
IF NOT valid THEN (* the sample is left out *)
    FOR i := 1 TO NU DO
        command[i] := last[i];
        IF command[i] < LOW[i] THEN
            command[i] := LOW[i];
        ELSIF command[i] > HIGH[i] THEN
            command[i] := HIGH[i];
        END_IF;
        limited[i] := 0;
    END_FOR;
$passed    RETURN;
END_IF;

FOR j := 1 TO NY DO
$shaping    difference := C[j] * $awaited - measured[j];
    IF warm THEN
        f[j] := DECAY * f[j] + FRESH * (difference - d[j]);
    ELSE
        f[j] := 0.0;
    END_IF;
    d[j] := difference;
END_FOR;

FOR i := 1 TO NU DO
$u0
    push := 0.0;
    FOR j := 1 TO NY DO
$gains        own := own + $Kr * $aim;
$Ka        own := own + $Kp * (B[j] * $awaited - measured[j]);
        own := own + $Kd * f[j];
        push := push + PERIOD * $Ki * ($awaited - measured[j]);
    END_FOR;
$compensating    IF takes_over THEN
$held        z[i] := $arrived - own;
    END_IF;
    v := own + z[i];

$wanting    reached := $wanted;
    limited[i] := 0;
    IF warm OR takes_over THEN
        IF $wanted < last[i] - RATE[i] * PERIOD THEN
            reached := last[i] - RATE[i] * PERIOD;
            limited[i] := 3;
        ELSIF $wanted > last[i] + RATE[i] * PERIOD THEN
            reached := last[i] + RATE[i] * PERIOD;
            limited[i] := 3;
        END_IF;
    END_IF;
    command[i] := reached;
    IF reached < LOW[i] THEN
        command[i] := LOW[i];
        limited[i] := 1;
    ELSIF reached > HIGH[i] THEN
        command[i] := HIGH[i];
        limited[i] := 2;
    END_IF;

$arriving$integral
$moved_on    last[i] := command[i];
END_FOR;
warm := TRUE;
takes_over := FALSE;
${counted}END_FUNCTION_BLOCK
""")
ST_CURVE_LOCALS = """\
    wanted : LREAL; (* the command of which v arrives *)
    arrives : LREAL; (* what arrives of a command *)
"""
ST_LOCALS = """\
$rho    (* weights of the coefficients: $meaning *)
    phi : ARRAY[1..$terms] OF LREAL;
    gain_p : LREAL;
    gain_i : LREAL;
    gain_d : LREAL;
    gain_r : LREAL;
    k : INT;
"""
ST_SCHEDULE = Template("""\
$rho := $schedule;
IF $rho < $low THEN
    $rho := $low;
ELSIF $rho > $high THEN
    $rho := $high;
END_IF;
""")
ST_PRODUCTS = Template("""\
FOR k := 1 TO TERMS DO
    phi[k] := $product;
END_FOR;
""")
ST_LINEAR = """\
k := 1;
WHILE k < TERMS - 1 AND rho >= KNOTS[k + 1] DO
    k := k + 1;
END_WHILE;
share := (rho - KNOTS[k]) / (KNOTS[k + 1] - KNOTS[k]);
IF share < 0.0 THEN
    share := 0.0;
ELSIF share > 1.0 THEN
    share := 1.0;
END_IF;
FOR i := 1 TO TERMS DO
    phi[i] := 0.0;
END_FOR;
phi[k] := 1.0 - share;
phi[k + 1] := share;
"""
ST_BELLS = """\
FOR k := 1 TO BELLS DO
    phi[k] := EXP(-BETA[k] * ((rho - CENTRES[k]) * (rho - CENTRES[k])));
END_FOR;
"""
ST_SHARES = """\
top := -$no_limit;
total := 0.0;
FOR k := 1 TO BELLS DO
    phi[k] := -BETA[k] * ((rho - CENTRES[k]) * (rho - CENTRES[k]));
    IF phi[k] > top THEN
        top := phi[k]; (* taken out, for far from every centre all would be 0 *)
    END_IF;
END_FOR;
FOR k := 1 TO BELLS DO
    phi[k] := EXP(phi[k] - top);
    total := total + phi[k];
END_FOR;
FOR k := 1 TO BELLS DO
    phi[k] := phi[k] / total;
END_FOR;
"""
ST_EVEN = """\
FOR k := 1 TO TERMS DO
    phi[k] := 1.0 + 0.0 * rho;
END_FOR;
"""
ST_U0 = """\
    own := 0.0;
    FOR k := 1 TO TERMS DO
        own := own + phi[k] * U0[i, k];
    END_FOR;"""
ST_GAINS = """\
        gain_p := 0.0;
        gain_i := 0.0;
        gain_d := 0.0;
        gain_r := 0.0;
        FOR k := 1 TO TERMS DO
            gain_p := gain_p + phi[k] * KP[i, j, k];
            gain_i := gain_i + phi[k] * KI[i, j, k];
            gain_d := gain_d + phi[k] * KD[i, j, k];
            gain_r := gain_r + phi[k] * KR[i, j, k];
        END_FOR;
"""
ST_GAIN_OF_RATES = """\
        $gain := 0.0;
        FOR k := 1 TO TERMS DO
            $gain := $gain + phi[k] * $K[i, j, k];
        END_FOR;
"""
ST_SHAPING_STATE = """\
    s : ARRAY[1..$ny] OF LREAL; (* set-points within their slew *)
    m : ARRAY[1..$ny] OF LREAL; (* reference models *)
    n : ARRAY[1..$ny] OF LREAL; (* their rates *)
    before : LREAL;
"""
ST_SHAPING = """\
    IF NOT warm THEN (* the reference models start from rest *)
        s[j] := $begins;
        m[j] := $begins;
        n[j] := 0.0;
    END_IF;
    IF set_point[j] < s[j] - SLEW[j] * PERIOD THEN
        s[j] := s[j] - SLEW[j] * PERIOD;
    ELSIF set_point[j] > s[j] + SLEW[j] * PERIOD THEN
        s[j] := s[j] + SLEW[j] * PERIOD;
    ELSE
        s[j] := set_point[j];
    END_IF;
    before := m[j];
    m[j] := MODEL[j, 1] * before + MODEL[j, 2] * n[j] + MODEL[j, 3] * s[j];
$kept    n[j] := MODEL[j, 4] * before + MODEL[j, 5] * n[j] + MODEL[j, 6] * s[j];
$accelerate"""
ST_AWAITING_STATE = """\
    line : ARRAY[1..$ny, 1..$line] OF LREAL; (* reference models of the last samples *)
    l : ARRAY[1..$ny] OF LREAL; (* what the loop awaits *)
    newer : LREAL;
    late : LREAL;
"""
ST_SIDES = """\
    side : ARRAY[1..$nu] OF LREAL; (* signs of what is commanded before inverses *)
    teeth : ARRAY[1..$nu] OF LREAL; (* where the teeth stand, as impulses *)
    linear : LREAL; (* the command before an inverse *)
    added : LREAL; (* what an inverse adds to it *)
"""
ST_SIDES_ANEW = """\
        side[i] := 0.0;
        teeth[i] := 0.0;
"""
ST_AWAIT = """\
newer := m[j];
IF LAG[j] > 1 THEN
    newer := line[j, LAG[j] - 1];
END_IF;
late := newer + LAG_SHARE[j] * (line[j, LAG[j]] - newer);
FOR i := 2 TO LAGS DO
    line[j, LAGS + 2 - i] := line[j, LAGS + 1 - i];
END_FOR;
line[j, 1] := m[j];
IF NOT warm THEN
    l[j] := late;
END_IF;
IF l[j] > late + PLAY[j] THEN
    l[j] := late + PLAY[j];
ELSIF l[j] < late - PLAY[j] THEN
    l[j] := late - PLAY[j];
END_IF;
"""
ST_BEGIN_AWAITING = """\
    FOR i := 1 TO LAGS DO
        IF NOT warm THEN
            line[j, i] := $begins;
        END_IF;
    END_FOR;
"""
ST_INVERT = """\
    linear := $linear;
    IF linear > KEEP[i] THEN
        side[i] := 1.0;
    ELSIF linear < -KEEP[i] THEN
        side[i] := -1.0;
    END_IF;
    IF takes_over THEN
        teeth[i] := GEAR_PLAY[i] / 2.0 * side[i];
    END_IF;
    added := HALF_WIDTH[i] * side[i] + (GEAR_PLAY[i] / 2.0 * side[i] - teeth[i]) / PERIOD;
    wanted := linear + added;
"""
ST_MOVED_ON = """\
    teeth[i] := teeth[i] + (command[i] - HALF_WIDTH[i] * side[i]) * PERIOD;
    IF teeth[i] > GEAR_PLAY[i] / 2.0 THEN
        teeth[i] := GEAR_PLAY[i] / 2.0;
    ELSIF teeth[i] < -GEAR_PLAY[i] / 2.0 THEN
        teeth[i] := -GEAR_PLAY[i] / 2.0;
    END_IF;
"""
ST_THROUGH = """\
        linear := 0.0; (* what a dead zone leaves of the last command *)
        IF last[i] > HALF_WIDTH[i] THEN
            linear := last[i] - HALF_WIDTH[i];
        ELSIF last[i] < -HALF_WIDTH[i] THEN
            linear := last[i] + HALF_WIDTH[i];
        END_IF;
"""
ST_NOT_YET = """\
    IF AT_SETPOINT[j] > 0.0 AND unknown > 1 THEN (* not known yet *)
        acceleration[j] := 0.0;
    END_IF;
"""
ST_COUNTERS = """\
    unknown : INT; (* samples until a path's acceleration is known *)
    holding : INT; (* samples for which the command goes on from last *)
"""
ST_COUNTED_ANEW = """\
    unknown := 3;
    holding := 0;
    IF take_over THEN
        holding := 3;
    END_IF;
"""
ST_COUNTED = """\
IF unknown > 0 THEN
    unknown := unknown - 1;
END_IF;
IF holding > 0 THEN
    holding := holding - 1;
END_IF;
takes_over := holding > 0;
"""
ST_PASSED = """\
    FOR j := 1 TO NY DO (* a path goes on all the same *)
        IF warm AND AT_SETPOINT[j] > 0.0 THEN
            before := m[j];
            IF set_point[j] - set_point[j] = 0.0 THEN
                s[j] := set_point[j];
            ELSE
                s[j] := before + PERIOD * n[j];
                holding := 3;
                takes_over := TRUE;
            END_IF;
            IF s[j] < before - SLEW[j] * PERIOD THEN
                s[j] := before - SLEW[j] * PERIOD;
            ELSIF s[j] > before + SLEW[j] * PERIOD THEN
                s[j] := before + SLEW[j] * PERIOD;
            END_IF;
            n[j] := (s[j] - before) / PERIOD;
            m[j] := s[j];
$goes_on        END_IF;
    END_FOR;
"""
ST_ACCELERATE = """\
    acceleration[j] := CHANGE[j, 1] * (s[j] - m[j]) + CHANGE[j, 2] * n[j] + CHANGE[j, 3] * n_before;
"""
ST_COMPENSATION = Template("""\
    IF i = $i THEN (* $effect *)
        moved := 0.0;
        FOR j := 1 TO NY DO
            moved := moved + POSITION_$k[j] * $aim$moved;
        END_FOR;
        node := 1;
        WHILE node < POINTS_$k - 1 AND moved >= ADDED_${k}_AT[node + 1] DO
            node := node + 1;
        END_WHILE;
        own := own + ADDED_$k[node] + (ADDED_$k[node + 1] - ADDED_$k[node])
            / (ADDED_${k}_AT[node + 1] - ADDED_${k}_AT[node]) * (moved - ADDED_${k}_AT[node]);
    END_IF;
""")
ST_CURVE = Template("""\
IF i = $i THEN (* on straight lines through the nodes, and on along the first and the last one *)
    node := 1;
    WHILE node < NODES_$i - 1 AND $at >= CURVE_${i}_$x[node + 1] DO
        node := node + 1;
    END_WHILE;
    $to := CURVE_${i}_$y[node] + (CURVE_${i}_$y[node + 1] - CURVE_${i}_$y[node])
        / (CURVE_${i}_$x[node + 1] - CURVE_${i}_$x[node]) * ($at - CURVE_${i}_$x[node]);
END_IF;
""")
ST_BACK_CALCULATION = "    z[i] := z[i] + push + PERIOD / TRACKING[i] * ($arrived - v);"
ST_CLAMPING = """\
    IF NOT (($wanted - command[i]) * push > 0.0) THEN
        z[i] := z[i] + push;
    END_IF;"""


def st_code(law: ScheduledPID, name: str) -> str:
    """A FUNCTION_BLOCK of that name, all numbers LREAL."""
    scheduled, sizes = law.schedule is not None, table_sizes(law)
    late, inverted, bent = law.awaits, bool(law.inverses), bool(law.curves)
    accelerated, paths, fed = bool(law.Kaa.any()), bool(law.paths.any()), ["Ka"] * law.shaped + ["Kaa"] * bool(law.Kaa.any())
    of_rates = (Template(ST_GAIN_OF_RATES).substitute(gain=f"gain_{key[1:]}", K=key.upper()) for key in fed)
    gains = (ST_GAINS + "".join(of_rates)) * scheduled
    named = {key: f"gain_{key[1:]}" if scheduled else f"{key.upper()}[i, j]" for key in ("Kp", "Ki", "Kd", "Kr", "Ka", "Kaa")}
    inputs = _st_schedules(law) if scheduled else []
    kind = f"ARRAY[1..{len(inputs)}] OF LREAL" if len(inputs) > 1 else "LREAL"
    weights = _st_scheduling(law) if scheduled else ""
    curves = _st_curves(law, "v", "wanted", 0)
    begins = "measured[j] + AT_SETPOINT[j] * (set_point[j] - measured[j])" if paths else "measured[j]"
    shaping = (
        Template(ST_SHAPING).substitute(
            begins=begins,
            kept="    n_before := n[j];\n" * accelerated,
            accelerate=(ST_ACCELERATE + ST_NOT_YET * paths) * accelerated,
        )
        + (Template(ST_BEGIN_AWAITING).substitute(begins=begins) + textwrap.indent(ST_AWAIT, 4 * " ")) * late
    )
    compensating = "".join(_st_compensation(law, k) for k in range(len(law.compensations)))
    counted = re.findall(
        r"\w+", weights + gains + curves + compensating + shaping * law.shaped
    )  # a constant that nobody reads is refused by some compilers
    names = {"outputs": law.measured, "references": law.references, "inputs": law.actuated}
    words = {
        "name": name, "head": "\n".join(plain_comment(line) for line in head_lines(law)),
        **{key: plain_comment(channels(law, own)) for key, own in names.items()}, "nu_y": sizes["NY"], "nu_u": sizes["NU"],
        "sizes": "\n".join(f"    {key} : INT := {n};" for key, n in sizes.items() if key in ("NU", "NY") or key in counted),
        "tables": "\n".join(_st_table(table, sizes) for table in tables(law)),
        "schedule_in": f"    schedule : {kind}; (* rho: {plain_comment(channels(law, schedules_of(law)))} *)\n" * scheduled,
        "schedule_out": "    outside : BOOL; (* the schedule is outside the span of the gains, or no number *)\n" * scheduled,
        "locals": "".join(
            [
                ST_CURVE_LOCALS * bent,
                "    wanted : LREAL; (* the command after the inverse *)\n" * (inverted and not bent),
                "    node : INT;\n" * bool(law.curves or law.compensations),
                "    moved : LREAL; (* where a compensation's curve is read *)\n" * bool(law.compensations),
                ST_COUNTERS * paths,
                f"    n_before : LREAL;\n    acceleration : ARRAY[1..{sizes['NY']}] OF LREAL;\n" * accelerated,
                _st_locals(law, sizes) if scheduled else "",
            ]
        ),
        "weights": weights,
        "finite": " AND ".join(f"({own.schedule} - {own.schedule} = 0.0)" for own in inputs) or "TRUE",
        "u0": ST_U0 if scheduled else "    own := U0[i];", "gains": gains, **named,
        "Ka": f"        own := own + {named['Ka']} * n[j];\n" * law.shaped
        + f"        own := own + {named['Kaa']} * acceleration[j];\n" * accelerated,
        "shaping": shaping * law.shaped, "compensating": compensating,
        "passed": Template(ST_PASSED).substitute(goes_on=textwrap.indent(ST_AWAIT, 12 * " ") * late) * paths,
        "counted": ST_COUNTED * paths,
        "counted_anew": ST_COUNTED_ANEW * paths,
        "shaping_state": Template(ST_SHAPING_STATE + ST_AWAITING_STATE * late).substitute(ny=sizes["NY"], line=sizes.get("LAGS"))
        * law.shaped + Template(ST_SIDES).substitute(nu=sizes["NU"]) * inverted,
        "sides_anew": ST_SIDES_ANEW * inverted, "moved_on": ST_MOVED_ON * inverted,
        "m": "m" if law.shaped else "r", "aim": "m[j]" if law.shaped else "set_point[j]",
        "l": "l" if late else "m" if law.shaped else "r",
        "awaited": "l[j]" if late else "m[j]" if law.shaped else "set_point[j]",
        "held": ST_THROUGH * inverted + _st_curves(law, "linear" if inverted else "last[i]", "arrives", 8),
        "arrived": "arrives" if bent else "linear" if inverted else "last[i]",
        "wanting": _st_curves(law, "v", "wanted", 4)
        + Template(ST_INVERT).substitute(linear="wanted" if bent else "v") * inverted,
        "wanted": "wanted" if bent or inverted else "v",
        "arriving": _st_curves(law, "command[i] - added" if inverted else "command[i]", "arrives", 4)
        * isinstance(law.anti_windup, BackCalculation),
        "integral": Template(ST_BACK_CALCULATION if isinstance(law.anti_windup, BackCalculation) else ST_CLAMPING).substitute(
            arrived="arrives" if bent else "(command[i] - added)" if inverted else "command[i]",
            wanted="wanted" if bent or inverted else "v",
        ),
    }  # fmt: skip
    return ST_BLOCK.substitute(words)


def _st_compensation(law: ScheduledPID, k: int) -> str:
    """Statements that add a compensation to its command."""
    own, moved = law.compensations[k], f" + MOTION_{k + 1}[j] * n[j]" * law.shaped
    return ST_COMPENSATION.substitute(
        i=law.actuated.index(own.input) + 1, k=k + 1, effect=plain_comment(f"compensation of {own.effect}"),
        aim="m[j]" if law.shaped else "set_point[j]", moved=moved,
    )  # fmt: skip


def _st_curves(law: ScheduledPID, at: str, to: str, indent: int) -> str:
    """Statements from a command to what arrives of it, or back, indented by so many spaces; none of a law without curves."""
    if not law.curves:
        return ""
    x, y = ("V", "U") if to == "wanted" else ("U", "V")
    each = [ST_CURVE.substitute(i=i, at=at, to=to, x=x, y=y) for i, _ in curves_by_number(law)]
    return textwrap.indent("".join([f"{to} := {at};\n", *each]), " " * indent)


class _Input(NamedTuple):
    """A schedule variable: where it is read, its ends, the name of its value within them, and its functions of that."""

    schedule: str
    low: str
    high: str
    rho: str
    basis: Basis


def _st_schedules(law: ScheduledPID) -> list[_Input]:
    if not isinstance(law.basis, Products):
        return [_Input("schedule", "SPAN[1]", "SPAN[2]", "rho", law.basis)]
    return [
        _Input(f"schedule[{i}]", f"SPAN[{i}, 1]", f"SPAN[{i}, 2]", f"rho_{i}", factor)
        for i, factor in enumerate(law.basis.factors, 1)
    ]


def _st_scheduling(law: ScheduledPID) -> str:
    """Statements that find out whether the schedule is outside, and fill phi."""
    own = _st_schedules(law)
    inside = " AND ".join(f"{v.schedule} >= {v.low} AND {v.schedule} <= {v.high}" for v in own)
    clipped = "".join(ST_SCHEDULE.substitute(v._asdict()) for v in own)
    if len(own) == 1:
        weights = _st_weights(own[0].basis)
    else:
        each = [numbered(_st_weights(v.basis), ("rho", "phi", *BASIS_NAMES), i) for i, v in enumerate(own, 1)]
        product = " * ".join(f"phi_{i}[CHOSEN[k, {i}]]" for i in range(1, len(own) + 1))
        weights = "".join([*each, ST_PRODUCTS.substitute(product=product)])
    return f"\noutside := NOT ({inside});\n{clipped}{weights}"


def _st_weights(basis: Basis) -> str:
    """Statements that fill phi at a rho within the span."""
    match basis:
        case PiecewiseLinear(knots=knots) if len(knots) > 1:
            return ST_LINEAR
        case Gaussian(centres=centres) if len(centres):
            text = Template(ST_SHARES if basis.normalised else ST_BELLS).substitute(no_limit=_lreal(NO_LIMIT))
            return text + "phi[BELLS + 1] := 1.0;\n" * basis.with_constant
        case Powers(exponents=exponents):
            terms = [power_text(e, "1.0", lambda e: f"EXPT(x, {_lreal(e)})") for e in exponents]
            return "".join(["x := rho / SCALE;\n", *(f"phi[{k}] := {term};\n" for k, term in enumerate(terms, 1))])
    return ST_EVEN


def _st_locals(law: ScheduledPID, sizes: dict[str, int]) -> str:
    """Variables that only a scheduled law has."""
    own = [name for name in ("share", "top", "total", "x") if re.search(rf"\b{name} :=", _st_scheduling(law))]
    own += ["gain_a"] * law.shaped + ["gain_aa"] * bool(law.Kaa.any())
    inputs = _st_schedules(law)
    rho = "".join(f"    {v.rho} : LREAL; (* {v.schedule} within SPAN *)\n" for v in inputs)
    if len(inputs) > 1:
        for i, v in enumerate(inputs, 1):
            meaning = numbered(basis_meaning(v.basis), ("rho", *BASIS_NAMES), i)
            rho += f"    (* functions of {v.rho}: {meaning} *)\n    phi_{i} : ARRAY[1..{sizes[f'TERMS_{i}']}] OF LREAL;\n"
    text = Template(ST_LOCALS).substitute(terms=sizes["TERMS"], meaning=basis_meaning(law.basis), rho=rho)
    return text + "".join(f"    {name} : LREAL;\n" for name in own)


def _st_table(table: Table, sizes: dict[str, int]) -> str:
    """KP : ARRAY[1..2, 1..3] OF LREAL := [...]; with its comments."""
    comment = f"(* {plain_comment(table.comment)} *)"
    if not table.sizes:
        return with_comment(f"    {table.name} : LREAL := {_lreal(float(table.values))};", comment)
    of, number = ("INT", lambda value: str(int(value) + 1)) if table.whole else ("LREAL", _lreal)
    kind = f"ARRAY[{', '.join(f'1..{sizes.get(size, size)}' for size in table.sizes)}] OF {of}"
    rows = [", ".join(map(number, row)) for row in table.values.reshape(-1, table.values.shape[-1])]
    if not table.rows:
        return with_comment(f"    {table.name} : {kind} := [{rows[0]}];", comment)
    commas = [","] * (len(rows) - 1) + [""]
    own = zip(rows, commas, table.rows, strict=True)
    lines = [with_comment(f"        {row}{comma}", f"(* {plain_comment(said)} *)") for row, comma, said in own]
    return "\n".join([f"    {table.name} : {kind} := [ {comment}", *lines, "    ];"])


def _lreal(value: float) -> str:
    mantissa, e, exponent = double_text(value).partition("e")
    return mantissa + ".0" * ("." not in mantissa) + (f"E{exponent}" if e else "")
