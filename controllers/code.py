"""A scheduled PID as readable source text: C99 for a microcontroller, IEC 61131-3 Structured Text for a PLC.

    v  = u0 + Kr r + Kp (b r - y) + z + Kd f,     z+ = z + dt Ki (r - y) + what keeps z from winding up

Both texts are the law of `scheduled_pid`, operation by operation: tables of its numbers, which both languages share, and one body
each. Of a basis the weights phi(rho) of the coefficients are computed, a gain is K = sum_j phi_j K_j. Nothing is allocated, and
all memory is in one struct or function block. A text depends on the law and the program's version alone: no date, no path.
"""

import re
from collections.abc import Callable, Sequence
from string import Template
from typing import NamedTuple

import numpy as np

from controllers.scheduled_pid import BackCalculation, ScheduledPID
from workbench.errors import InputError
from workbench.lpv import Gaussian, PiecewiseLinear, Powers
from workbench.provenance import program

NO_LIMIT, NO_LIMIT_FLOAT = 1e300, 1e38  # a limit that is not there, as a number
WIDTH = 130  # characters of a line; a comment beside a longer one stands above it
LARGEST_POWER = 8  # whole powers up to here are products: exact signs, and no library
NAME = re.compile(r"[A-Za-z][A-Za-z0-9]*(_[A-Za-z0-9]+)*")
#: Words of IEC 61131-3 that no function block may be called; C needs no such list, for its names all get an ending.
RESERVED = (
    "abs acos action add and any array asin at atan block bool by byte case concat configuration constant continue cos ctd "
    "ctu ctud date delete dint div do dt dword else elsif end eq exit exp expt extends external f_edge f_trig false find "
    "for from function function_block ge global gt if in initial_step insert int interface interval le left len limit lint "
    "ln log lreal lt lword max method mid min mod move mul mux namespace ne non_retain not null of on or overlap override "
    "pointer priority program property r_edge r_trig read_only read_write real ref ref_to reference repeat replace resource "
    "retain return right rol ror rs sel shl shr sin sint sqrt sr step string struct sub super tan task then this time "
    "time_of_day to tod tof ton tp transition true trunc type udint uint ulint union until using usint var var_access "
    "var_config var_external var_global var_in_out var_input var_output var_temp while with word wstring xor "
)


# ---- for both languages ------------------------------------------------------------------------------------------------------


Number = Callable[[float], str]


class Table(NamedTuple):
    """A constant of the law: its dimensions as they are called in the text, its numbers, and a comment for each of its rows."""

    name: str
    sizes: tuple[str, ...]
    values: np.ndarray
    comment: str
    rows: tuple[str, ...] = ()


def identifier(law: ScheduledPID, name: str | None = None) -> str:
    """A name for C and Structured Text: letters and digits, words joined by single underscores, no word of Structured Text.

    A name that is asked for is refused where it is none; the law's own is made one: whatever else stands there becomes an
    underscore.
    """
    made = name
    if name is None:
        made = re.sub(r"[^A-Za-z0-9]+", "_", law.name).strip("_")
        made = made if made[:1].isalpha() else f"law_{made}".strip("_")
    mend = "give a name of letters, digits and single underscores, such as web_speed_pid"
    if not made or not NAME.fullmatch(made):
        raise InputError(f"{made!r} is no name in C and Structured Text", file=law.name, mend=mend)
    used = re.sub(r"\(\*.*?\*\)", "", st_code(law, ""), flags=re.DOTALL)
    if made.lower() in RESERVED.split() + re.findall(r"\w+", used.lower()):
        raise InputError(f"{made!r} is a word of Structured Text or a variable of the block", file=law.name, mend=mend)
    return made


def tables(law: ScheduledPID) -> list[Table]:
    """Every number of the law with its meaning and unit; a scheduled gain has a row of coefficients for each pair of channels."""
    outputs, inputs, decay = channels(law, law.measured), channels(law, law.actuated), law.Tf / (law.Tf + law.dt)
    span = f"{channel(law, law.schedule)}; outside, the gains hold their edge value" if law.schedule else ""
    return [
        Table("PERIOD", (), np.array(law.dt), "sample time, s"),
        *([Table("SPAN", ("2",), law.span, span), *_basis_tables(law)] if law.schedule else []),
        _gains(law, "Kp", "proportional gains", ""),
        _gains(law, "Ki", "integral gains", "/s"),
        _gains(law, "Kd", "derivative gains", " s"),
        _gains(law, "Kr", "feedforward of the set-points", ""),
        _u0(law),
        Table("B", ("NY",), law.b, f"set-point weights of the proportional part: {outputs}"),
        Table("C", ("NY",), law.c, f"set-point weights of the derivative part: {outputs}"),
        Table("DECAY", (), np.array(decay), f"Tf / (Tf + PERIOD), Tf = {law.Tf:g} s filters the derivative"),
        Table("FRESH", (), np.array((1.0 - decay) / law.dt), "(1 - DECAY) / PERIOD, 1/s"),
        Table("LOW", ("NU",), law.low, f"lowest commands: {inputs}"),
        Table("HIGH", ("NU",), law.high, f"highest commands: {inputs}"),
        Table("RATE", ("NU",), law.rate, f"largest rates, per second: {inputs}"),
        *(
            [Table("TRACKING", ("NU",), law.tracking, "time constants with which z follows a limited command, s")]
            if isinstance(law.anti_windup, BackCalculation)
            else []
        ),
    ]


def _gains(law: ScheduledPID, key: str, comment: str, time: str) -> Table:
    K, own = getattr(law, key), lambda a, m: f"{m} {law.gain_unit(a, m, time)}".rstrip()
    if law.schedule is None:
        rows = tuple(f"{a} from {', '.join(own(a, m) for m in law.measured)}" for a in law.actuated)
        return Table(key.upper(), ("NU", "NY"), K[0], comment, rows)
    rows = tuple(f"{a} from {own(a, m)}" for a in law.actuated for m in law.measured)
    return Table(key.upper(), ("NU", "NY", "TERMS"), np.moveaxis(K, 0, -1), comment, rows)


def _u0(law: ScheduledPID) -> Table:
    comment, rows = "commands where there is no error and no set-point", tuple(channel(law, a) for a in law.actuated)
    if law.schedule is None:
        return Table("U0", ("NU",), law.u0[0], f"{comment}: {', '.join(rows)}")
    return Table("U0", ("NU", "TERMS"), law.u0.T, comment, rows)


def _basis_tables(law: ScheduledPID) -> list[Table]:
    at = channel(law, law.schedule or "")
    match law.basis:
        case PiecewiseLinear(knots=knots) if len(knots) > 1:
            return [Table("KNOTS", ("TERMS",), knots, f"{at}; the gains are linear between")]
        case Gaussian(centres=centres, beta=beta) if len(centres):
            return [Table("CENTRES", ("BELLS",), centres, at), Table("BETA", ("BELLS",), beta, f"1 / square of {at}")]
        case Powers(scale=scale):
            return [Table("SCALE", (), np.array(scale), f"{at} whose powers are 1")]
    return []


def _basis_said(law: ScheduledPID) -> str:
    match law.basis:
        case PiecewiseLinear():
            return "1 at their own knot, 0 at every other, linear between, constant outside"
        case Gaussian(normalised=normalised, with_constant=constant):
            shares, one = ", divided by their sum" * normalised, ", and 1" * constant
            return f"exp(-BETA (rho - CENTRES)^2){shares}{one}"
        case Powers(exponents=exponents):
            return f"(rho / SCALE) to the power of {', '.join(f'{e:g}' for e in exponents)}"


def _sizes(law: ScheduledPID) -> dict[str, int]:
    """Sizes by the names that they have in the texts."""
    m, nu, ny = law.Kp.shape
    bells = {"BELLS": len(law.basis.centres)} if isinstance(law.basis, Gaussian) else {}
    return {"NU": nu, "NY": ny} | ({"TERMS": m} | bells if law.schedule else {})


def channel(law: ScheduledPID, name: str) -> str:
    """Name with unit, where the law knows it."""
    unit = law.unit(name)
    return f"{name} [{unit}]" if unit else name


def channels(law: ScheduledPID, names: Sequence[str]) -> str:
    return ", ".join(channel(law, name) for name in names)


def _plain(text: str) -> str:
    """Text that ends no comment, opens none, and is plain ASCII."""
    return re.sub(r"(?<=[/(])(?=\*)|(?<=\*)(?=[/)])", " ", re.sub(r"[^ -~]", "_", text))


def _beside(line: str, comment: str) -> str:
    """The line with its comment, which stands above where both together are too long."""
    indent = line[: len(line) - len(line.lstrip())]
    return f"{line} {comment}" if len(line) + len(comment) < WIDTH else f"{indent}{comment}\n{line}"


def _power(exponent: float, one: str, power: Callable[[float], str]) -> str:
    """x^exponent: a product where the exponent is a small whole number."""
    n = abs(exponent)
    if n != int(n) or n > LARGEST_POWER:
        return power(float(exponent))
    product = " * ".join(["x"] * int(n)) or one
    return product if exponent >= 0.0 else f"{one} / ({product})"


def _head(law: ScheduledPID) -> list[str]:
    """What a reader of the text has to know before the first line of it."""
    scheduled = law.schedule is not None
    back = isinstance(law.anti_windup, BackCalculation)
    return [
        f"PID law '{law.name}' by {program()}. Change the law there, not this text.",
        "",
        f"v  = U0 + KR r + KP (B r - y) + z + KD f{', the gains are functions of rho' * scheduled}",
        "f  = DECAY f- + FRESH ((C r - y) - (C r - y)-), the filtered derivative; the minus marks the sample before",
        "u  = v within LOW and HIGH, and within RATE PERIOD of the last command",
        f"z+ = z + PERIOD KI (r - y){' + PERIOD / TRACKING (u - v)' * back}",
        *([] if back else ["     unless a limit is reached and that would push further beyond it: then z stands still"]),
        "",
        f"commands u:     {channels(law, law.actuated)}",
        f"set-points r:   {channels(law, law.references)}",
        f"measurements y: {channels(law, law.measured)}",
        *([f"schedule rho:   {channel(law, law.schedule)}"] if law.schedule else []),
        f"One step every {law.dt:g} s.",
        "",
        "Where a set-point, a measurement or the schedule is not a finite number, the last command is held and the sample is",
        "left out of all memory.",
    ]


# ---- C99 ---------------------------------------------------------------------------------------------------------------------


C_HEADER = Template("""\
/*
$head
 *
 * C99 without allocation: all memory is in a state, and two states run two loops. Compile it without -ffast-math, for which
 * every number is one.
 */
#ifndef ${NAME}_H
#define ${NAME}_H

#include <stdbool.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef $real ${name}_real;

enum { ${NAME}_NU = $nu, ${NAME}_NY = $ny }; /* commands; measurements and set-points */

/* What set a command: the law itself, or one of its limits. */
enum { ${NAME}_FREE, ${NAME}_AT_LOW, ${NAME}_AT_HIGH, ${NAME}_AT_RATE };

typedef struct {
    /* memory */
    ${name}_real z[${NAME}_NU]; /* integral parts */
    ${name}_real f[${NAME}_NY]; /* filtered derivatives of C r - y */
    ${name}_real d[${NAME}_NY]; /* last C r - y */
    ${name}_real u[${NAME}_NU]; /* last commands */
    bool cold; /* no sample yet: no derivative */
    bool takes_over; /* the next command goes on from u */
    /* what the last step reports */
    bool valid; /* every number of the step was one: the last command is held where not */
$outside    int limit[${NAME}_NU]; /* ${NAME}_FREE, _AT_LOW, _AT_HIGH or _AT_RATE */
} ${name}_state;

/* Start: the first command is that of z = 0, whatever the rate limits. */
void ${name}_init(${name}_state *s);

/* Start where these commands stand already: the first command is u itself, within the limits. */
void ${name}_take_over(${name}_state *s, const ${name}_real u[${NAME}_NU]);

/* One sample: u from set-points r, measurements y$and_rho. */
void ${name}_step(${name}_state *s,
    const ${name}_real r[${NAME}_NY], const ${name}_real y[${NAME}_NY], $rho${name}_real u[${NAME}_NU]);

#ifdef __cplusplus
}
#endif

#endif
""")

C_SOURCE = Template("""\
/*
$head
 */
#include "$name.h"

#include <math.h>

typedef ${name}_real real;

enum { NU = ${NAME}_NU, NY = ${NAME}_NY$sizes };

#define NO_LIMIT $no_limit

$tables

static real clipped(real x, real low, real high)
{
    return x < low ? low : x > high ? high : x; /* what is not a number stays so */
}
$weights
void ${name}_init(${name}_state *s)
{
    *s = (${name}_state){.cold = true};
}

void ${name}_take_over(${name}_state *s, const real u[NU])
{
    real held[NU];
    for (int i = 0; i < NU; ++i)
        held[i] = u[i]; /* u may be s->u */
    ${name}_init(s);
    for (int i = 0; i < NU; ++i)
        s->u[i] = held[i];
    s->takes_over = true;
}

void ${name}_step(${name}_state *s, const real r[NY], const real y[NY], ${rho_real}real u[NU])
{
$schedule    s->valid = $finite;
    for (int j = 0; j < NY; ++j)
        s->valid = s->valid && isfinite(r[j]) && isfinite(y[j]);
    if (!s->valid) { /* the sample is left out */
        for (int i = 0; i < NU; ++i) {
            u[i] = clipped(s->u[i], LOW[i], HIGH[i]);
            s->limit[i] = ${NAME}_FREE;
        }
        return;
    }
    for (int j = 0; j < NY; ++j) {
        const real d = C[j] * r[j] - y[j];
        s->f[j] = s->cold ? 0 : DECAY * s->f[j] + FRESH * (d - s->d[j]);
        s->d[j] = d;
    }
    for (int i = 0; i < NU; ++i) {
        real own = $u0; /* the command without its integral part */
        real push = 0; /* what the error adds to the integral part */
        for (int j = 0; j < NY; ++j) {
            own += $Kr * r[j];
            own += $Kp * (B[j] * r[j] - y[j]);
            own += $Kd * s->f[j];
            push += PERIOD * $Ki * (r[j] - y[j]);
        }
        if (s->takes_over)
            s->z[i] = s->u[i] - own;
        const real v = own + s->z[i];
        const real way = s->cold && !s->takes_over ? NO_LIMIT : RATE[i] * PERIOD;
        const real reached = clipped(v, s->u[i] - way, s->u[i] + way);
        u[i] = clipped(reached, LOW[i], HIGH[i]);
        s->limit[i] = reached < LOW[i] ? ${NAME}_AT_LOW
            : reached > HIGH[i] ? ${NAME}_AT_HIGH
            : reached < v || reached > v ? ${NAME}_AT_RATE
            : ${NAME}_FREE;
        $integral
        s->u[i] = u[i];
    }
    s->cold = s->takes_over = false;
}
""")

C_WEIGHTS = Template("""
/* Weights of the coefficients: $meaning. */
static void weights(real rho, real phi[TERMS])
{
$body
}

static real at(const real K[TERMS], const real phi[TERMS])
{
    real sum = 0;
    for (int k = 0; k < TERMS; ++k)
        sum += K[k] * phi[k];
    return sum;
}
""")

C_SCHEDULE = """\
    real phi[TERMS];
    weights(clipped(rho, SPAN[0], SPAN[1]), phi);
    s->outside = !(rho >= SPAN[0] && rho <= SPAN[1]);
"""
C_LINEAR = """\
    int k = 0;
    while (k < TERMS - 2 && rho >= KNOTS[k + 1])
        ++k;
    const real share = clipped((rho - KNOTS[k]) / (KNOTS[k + 1] - KNOTS[k]), 0, 1);
    for (int n = 0; n < TERMS; ++n)
        phi[n] = 0;
    phi[k] = 1 - share;
    phi[k + 1] = share;"""
C_BELLS = """\
    for (int k = 0; k < BELLS; ++k)
        phi[k] = $exp(-BETA[k] * ((rho - CENTRES[k]) * (rho - CENTRES[k])));"""
C_SHARES = """\
    real top = -NO_LIMIT, total = 0;
    for (int k = 0; k < BELLS; ++k) {
        phi[k] = -BETA[k] * ((rho - CENTRES[k]) * (rho - CENTRES[k]));
        top = phi[k] > top ? phi[k] : top; /* taken out, for far from every centre all would be 0 */
    }
    for (int k = 0; k < BELLS; ++k) {
        phi[k] = $exp(phi[k] - top);
        total += phi[k];
    }
    for (int k = 0; k < BELLS; ++k)
        phi[k] /= total;"""
C_EVEN = """\
    for (int k = 0; k < TERMS; ++k)
        phi[k] = 1 + 0 * rho;"""
C_BACK_CALCULATION = "s->z[i] = s->z[i] + push + PERIOD / TRACKING[i] * (u[i] - v);"
C_CLAMPING = """\
if (!((v - u[i]) * push > 0))
            s->z[i] += push;"""


def c_code(law: ScheduledPID, name: str, *, single: bool = False) -> tuple[str, str]:
    """Header and source: <name>_init, <name>_take_over and <name>_step on a <name>_state; `real` is float where single."""
    number, f = (_float, "f") if single else (_double, "")
    if single:
        _check_float(law)
    scheduled, sizes = law.schedule is not None, _sizes(law)
    gain = (lambda K: f"at({K}, phi)") if scheduled else (lambda K: K)
    weights = C_WEIGHTS.substitute(meaning=_basis_said(law), body=_c_weights(law, f)) if scheduled else ""
    words = {
        "name": name, "NAME": name.upper(), "real": "float" if single else "double", "nu": sizes["NU"], "ny": sizes["NY"],
        "head": "\n".join(f" * {_plain(line)}".rstrip() for line in _head(law)),
        "sizes": "".join(f", {key} = {n}" for key, n in sizes.items() if key not in ("NU", "NY")),
        "no_limit": number(np.inf), "tables": "\n".join(_c_table(table, number) for table in tables(law)),
        "weights": weights, "schedule": C_SCHEDULE * scheduled,
        "rho": f"{name}_real rho, " * scheduled, "rho_real": "real rho, " * scheduled, "and_rho": " and schedule rho" * scheduled,
        "outside": "    bool outside; /* rho is outside the span of the gains, or no number */\n" * scheduled,
        "finite": "isfinite(rho)" if scheduled else "true",
        "u0": gain("U0[i]"), "Kp": gain("KP[i][j]"), "Ki": gain("KI[i][j]"), "Kd": gain("KD[i][j]"),
        "Kr": gain("KR[i][j]"),
        "integral": C_BACK_CALCULATION if isinstance(law.anti_windup, BackCalculation) else C_CLAMPING,
    }  # fmt: skip
    return C_HEADER.substitute(words), C_SOURCE.substitute(words)


def _c_weights(law: ScheduledPID, f: str) -> str:
    """Statements that fill phi at a rho within the span; f: ending of the library's functions."""
    match law.basis:
        case PiecewiseLinear(knots=knots) if len(knots) > 1:
            return C_LINEAR
        case Gaussian(centres=centres) if len(centres):
            text = Template(C_SHARES if law.basis.normalised else C_BELLS).substitute(exp=f"exp{f}")
            return text + "\n    phi[BELLS] = 1;" * law.basis.with_constant
        case Powers(exponents=exponents):
            terms = [_power(e, "1", lambda e: f"pow{f}(x, {e}{f.upper()})") for e in exponents]
            x = "    const real x = rho / SCALE;" + " (void)x;" * (not exponents.any())
            return "\n".join([x, *(f"    phi[{k}] = {term};" for k, term in enumerate(terms))])
    return C_EVEN


def _c_table(table: Table, number: Number) -> str:
    """static const real KP[NU][NY] = {...}; with its comments."""
    start = f"static const real {table.name}{''.join(f'[{size}]' for size in table.sizes)} ="
    comment = f"/* {_plain(table.comment)} */"
    if not table.sizes:
        return _beside(f"{start} {number(float(table.values))};", comment)
    if not table.rows:
        return _beside(f"{start} {{{', '.join(map(number, table.values))}}};", comment)
    comments = iter(table.rows)

    def braces(values: np.ndarray, indent: str) -> list[str]:
        if values.ndim == 1:
            return [_beside(f"{indent}{{{', '.join(map(number, values))}}},", f"/* {_plain(next(comments))} */")]
        return [f"{indent}{{", *(line for own in values for line in braces(own, indent + "    ")), f"{indent}}},"]

    return "\n".join([f"{start} {{ {comment}", *braces(table.values, "")[1:-1], "};"])


def _double(value: float) -> str:
    return repr(float(np.clip(value, -NO_LIMIT, NO_LIMIT)))


def _float(value: float) -> str:
    return f"{np.float32(np.clip(value, -NO_LIMIT_FLOAT, NO_LIMIT_FLOAT))}F"


def _check_float(law: ScheduledPID) -> None:
    """Refuse numbers that single precision does not hold apart, or not at all."""
    mend = "export it with double precision"
    for table in tables(law):
        limits = table.name in ("LOW", "HIGH", "RATE")
        if not limits and np.abs(table.values).max() > NO_LIMIT_FLOAT:
            raise InputError(f"{table.name} holds numbers beyond single precision", file=law.name, mend=mend)
        if table.name in ("SPAN", "KNOTS") and np.any(np.diff(np.float32(table.values)) <= 0.0):
            raise InputError(f"{table.name} holds values that are one in single precision", file=law.name, mend=mend)


# ---- IEC 61131-3 -------------------------------------------------------------------------------------------------------------


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
    f : ARRAY[1..$nu_y] OF LREAL; (* filtered derivatives of C r - y *)
    d : ARRAY[1..$nu_y] OF LREAL; (* last C r - y *)
    last : ARRAY[1..$nu_u] OF LREAL; (* last commands *)
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
    FOR i := 1 TO NU DO
        z[i] := 0.0;
        last[i] := 0.0;
        IF take_over THEN
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
    RETURN;
END_IF;

FOR j := 1 TO NY DO
    difference := C[j] * set_point[j] - measured[j];
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
$gains        own := own + $Kr * set_point[j];
        own := own + $Kp * (B[j] * set_point[j] - measured[j]);
        own := own + $Kd * f[j];
        push := push + PERIOD * $Ki * (set_point[j] - measured[j]);
    END_FOR;
    IF takes_over THEN
        z[i] := last[i] - own;
    END_IF;
    v := own + z[i];

    reached := v;
    limited[i] := 0;
    IF warm OR takes_over THEN
        IF v < last[i] - RATE[i] * PERIOD THEN
            reached := last[i] - RATE[i] * PERIOD;
            limited[i] := 3;
        ELSIF v > last[i] + RATE[i] * PERIOD THEN
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

$integral
    last[i] := command[i];
END_FOR;
warm := TRUE;
takes_over := FALSE;
END_FUNCTION_BLOCK
""")

ST_LOCALS = """\
    rho : LREAL; (* schedule within SPAN *)
    (* weights of the coefficients: $meaning *)
    phi : ARRAY[1..$terms] OF LREAL;
    gain_p : LREAL;
    gain_i : LREAL;
    gain_d : LREAL;
    gain_r : LREAL;
    k : INT;
"""
ST_SCHEDULE = """
outside := NOT (schedule >= SPAN[1] AND schedule <= SPAN[2]);
rho := schedule;
IF rho < SPAN[1] THEN
    rho := SPAN[1];
ELSIF rho > SPAN[2] THEN
    rho := SPAN[2];
END_IF;
"""
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
ST_BACK_CALCULATION = "    z[i] := z[i] + push + PERIOD / TRACKING[i] * (command[i] - v);"
ST_CLAMPING = """\
    IF NOT ((v - command[i]) * push > 0.0) THEN
        z[i] := z[i] + push;
    END_IF;"""


def st_code(law: ScheduledPID, name: str) -> str:
    """A FUNCTION_BLOCK of that name, all numbers LREAL."""
    scheduled, sizes = law.schedule is not None, _sizes(law)
    names = {"outputs": law.measured, "references": law.references, "inputs": law.actuated}
    words = {
        "name": name, "head": "\n".join(_plain(line) for line in _head(law)),
        **{key: _plain(channels(law, own)) for key, own in names.items()}, "nu_y": sizes["NY"], "nu_u": sizes["NU"],
        "sizes": "\n".join(f"    {key} : INT := {n};" for key, n in sizes.items()),
        "tables": "\n".join(_st_table(table, sizes) for table in tables(law)),
        "schedule_in": f"    schedule : LREAL; (* rho: {_plain(channel(law, law.schedule or ''))} *)\n" * scheduled,
        "schedule_out": "    outside : BOOL; (* the schedule is outside the span of the gains, or no number *)\n" * scheduled,
        "locals": _st_locals(law, sizes) if scheduled else "",
        "weights": ST_SCHEDULE + _st_weights(law) if scheduled else "",
        "finite": "schedule - schedule = 0.0" if scheduled else "TRUE",
        "u0": ST_U0 if scheduled else "    own := U0[i];", "gains": ST_GAINS * scheduled,
        **{key: f"gain_{key[1]}" if scheduled else f"{key.upper()}[i, j]" for key in ("Kp", "Ki", "Kd", "Kr")},
        "integral": ST_BACK_CALCULATION if isinstance(law.anti_windup, BackCalculation) else ST_CLAMPING,
    }  # fmt: skip
    return ST_BLOCK.substitute(words)


def _st_weights(law: ScheduledPID) -> str:
    """Statements that fill phi at a rho within the span."""
    match law.basis:
        case PiecewiseLinear(knots=knots) if len(knots) > 1:
            return ST_LINEAR
        case Gaussian(centres=centres) if len(centres):
            text = Template(ST_SHARES if law.basis.normalised else ST_BELLS).substitute(no_limit=_lreal(NO_LIMIT))
            return text + "phi[BELLS + 1] := 1.0;\n" * law.basis.with_constant
        case Powers(exponents=exponents):
            terms = [_power(e, "1.0", lambda e: f"EXPT(x, {_lreal(e)})") for e in exponents]
            return "".join(["x := rho / SCALE;\n", *(f"phi[{k}] := {term};\n" for k, term in enumerate(terms, 1))])
    return ST_EVEN


def _st_locals(law: ScheduledPID, sizes: dict[str, int]) -> str:
    """Variables that only a scheduled law has."""
    own = [name for name in ("share", "top", "total", "x") if re.search(rf"\b{name} :=", _st_weights(law))]
    text = Template(ST_LOCALS).substitute(terms=sizes["TERMS"], meaning=_basis_said(law))
    return text + "".join(f"    {name} : LREAL;\n" for name in own)


def _st_table(table: Table, sizes: dict[str, int]) -> str:
    """KP : ARRAY[1..2, 1..3] OF LREAL := [...]; with its comments."""
    comment = f"(* {_plain(table.comment)} *)"
    if not table.sizes:
        return _beside(f"    {table.name} : LREAL := {_lreal(float(table.values))};", comment)
    kind = f"ARRAY[{', '.join(f'1..{sizes.get(size, size)}' for size in table.sizes)}] OF LREAL"
    rows = [", ".join(map(_lreal, row)) for row in table.values.reshape(-1, table.values.shape[-1])]
    if not table.rows:
        return _beside(f"    {table.name} : {kind} := [{rows[0]}];", comment)
    commas = [","] * (len(rows) - 1) + [""]
    own = zip(rows, commas, table.rows, strict=True)
    lines = [_beside(f"        {row}{comma}", f"(* {_plain(said)} *)") for row, comma, said in own]
    return "\n".join([f"    {table.name} : {kind} := [ {comment}", *lines, "    ];"])


def _lreal(value: float) -> str:
    mantissa, e, exponent = _double(value).partition("e")
    return mantissa + ".0" * ("." not in mantissa) + (f"E{exponent}" if e else "")
