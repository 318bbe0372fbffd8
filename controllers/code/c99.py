"""A scheduled PID as C99 for a microcontroller: a header and a source."""

import textwrap
from collections.abc import Callable
from string import Template

import numpy as np

from controllers.code.constants import Table, curves_by_number, table_sizes, tables
from controllers.code.text import (
    BASIS_NAMES,
    NO_LIMIT_FLOAT,
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
from workbench.errors import InputError

Number = Callable[[float], str]
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
$several
/* What set a command: the law itself, or one of its limits. */
enum { ${NAME}_FREE, ${NAME}_AT_LOW, ${NAME}_AT_HIGH, ${NAME}_AT_RATE };

typedef struct {
    /* memory */
    ${name}_real z[${NAME}_NU]; /* integral parts */
    ${name}_real f[${NAME}_NY]; /* filtered derivatives of C $l - y */
    ${name}_real d[${NAME}_NY]; /* last C $l - y */
${shaping_state}    ${name}_real u[${NAME}_NU]; /* last commands */
$sides    $flag cold; /* no sample yet: no derivative$counted */
    $flag takes_over; /* the next command goes on from u */
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
$curves$weights
void ${name}_init(${name}_state *s)
{
    *s = (${name}_state){.cold = $begun};
}

void ${name}_take_over(${name}_state *s, const real u[NU])
{
    real held[NU];
    for (int i = 0; i < NU; ++i)
        held[i] = u[i]; /* u may be s->u */
    ${name}_init(s);
    for (int i = 0; i < NU; ++i)
        s->u[i] = held[i];
    s->takes_over = $begun;
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
$passed        return;
    }
$accelerations    for (int j = 0; j < NY; ++j) {
$shaping        const real d = C[j] * $awaited - y[j];
        s->f[j] = $first ? 0 : DECAY * s->f[j] + FRESH * (d - s->d[j]);
        s->d[j] = d;
    }
    for (int i = 0; i < NU; ++i) {
        real own = $u0; /* the command without its integral part */
        real push = 0; /* what the error adds to the integral part */
        for (int j = 0; j < NY; ++j) {
            own += $Kr * $aim;
$Ka            own += $Kp * (B[j] * $awaited - y[j]);
            own += $Kd * s->f[j];
            push += PERIOD * $Ki * ($awaited - y[j]);
        }
$compensating        if (s->takes_over)
            s->z[i] = $held - own;
        const real v = own + s->z[i];
${wanting}        const real way = $first && !s->takes_over ? NO_LIMIT : RATE[i] * PERIOD;
        const real reached = clipped($wanted, s->u[i] - way, s->u[i] + way);
        u[i] = clipped(reached, LOW[i], HIGH[i]);
        s->limit[i] = reached < LOW[i] ? ${NAME}_AT_LOW
            : reached > HIGH[i] ? ${NAME}_AT_HIGH
            : reached < $wanted || reached > $wanted ? ${NAME}_AT_RATE
            : ${NAME}_FREE;
        $integral
$moved_on        s->u[i] = u[i];
    }
    $warm
}
""")
C_WEIGHTS = Template("""
/* Weights of the coefficients: $meaning. */
static void weights(real rho, real phi[TERMS])
{
$body
}
""")
C_AT = """
static real at(const real K[TERMS], const real phi[TERMS])
{
    real sum = 0;
    for (int k = 0; k < TERMS; ++k)
        sum += K[k] * phi[k];
    return sum;
}
"""
C_PRODUCTS = Template("""
/* Weights of the coefficients: $meaning. */
static void weights(const real rho[NS], real phi[TERMS])
{
$factors
    for (int k = 0; k < TERMS; ++k)
        phi[k] = $product;
}
$at""")
C_SCHEDULE = """\
    real phi[TERMS];
    weights(clipped(rho, SPAN[0], SPAN[1]), phi);
    s->outside = !(rho >= SPAN[0] && rho <= SPAN[1]);
"""
C_SCHEDULES = """\
    real phi[TERMS];
    weights(rho, phi);
    s->outside = false;
    for (int n = 0; n < NS; ++n)
        s->outside = s->outside || !(rho[n] >= SPAN[n][0] && rho[n] <= SPAN[n][1]);
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
C_SHAPING_STATE = Template("""\
    double s[${NAME}_NY]; /* set-points within their slew */
    double m[${NAME}_NY]; /* reference models: what they move by in a sample may be less than a float's last digit */
    double n[${NAME}_NY]; /* their rates */
$awaiting""")
C_AWAITING_STATE = Template("""\
    double line[${NAME}_NY][$line]; /* reference models of the last samples */
    double l[${NAME}_NY]; /* what the loop awaits */
""")
C_SIDES = Template("""\
    ${name}_real side[${NAME}_NU]; /* signs of what is commanded before inverses */
    ${name}_real teeth[${NAME}_NU]; /* where the teeth stand, as impulses */
""")
C_AWAIT = """\
const double newer = LAG[j] > 0 ? s->line[j][LAG[j] - 1] : s->m[j];
const double late = newer + LAG_SHARE[j] * (s->line[j][LAG[j]] - newer);
for (int k = LAGS - 1; k > 0; --k)
    s->line[j][k] = s->line[j][k - 1];
s->line[j][0] = s->m[j];
s->l[j] = fmax(late - PLAY[j], fmin(late + PLAY[j], $stood));
"""
C_BEGIN_AWAITING = Template("""\
        for (int k = 0; k < LAGS && $first; ++k)
            s->line[j][k] = ${double}$begins;
""")
C_INVERT = Template("""\
        const real linear = $linear;
        if (linear > KEEP[i])
            s->side[i] = 1;
        else if (linear < -KEEP[i])
            s->side[i] = -1;
        if (s->takes_over)
            s->teeth[i] = GEAR_PLAY[i] / 2 * s->side[i];
        const real added = HALF_WIDTH[i] * s->side[i] + (GEAR_PLAY[i] / 2 * s->side[i] - s->teeth[i]) / PERIOD;
        const real wanted = linear + added;
""")
C_MOVED_ON = """\
        s->teeth[i] = clipped(s->teeth[i] + (u[i] - HALF_WIDTH[i] * s->side[i]) * PERIOD, -GEAR_PLAY[i] / 2, GEAR_PLAY[i] / 2);
"""
C_THROUGH = "s->u[i] - clipped(s->u[i], -HALF_WIDTH[i], HALF_WIDTH[i])"
C_SHAPING = Template("""\
        const double way = SLEW[j] * ${double}PERIOD, held = $first ? ${double}$begins : s->s[j];
        const double m = $first ? ${double}$begins : s->m[j], n = $first ? 0 : s->n[j];
        s->s[j] = fmax(held - way, fmin(held + way, ${double}r[j]));
        s->m[j] = MODEL[j][0] * m + MODEL[j][1] * n + MODEL[j][2] * s->s[j];
        s->n[j] = MODEL[j][3] * m + MODEL[j][4] * n + MODEL[j][5] * s->s[j];
$accelerate""")
C_ACCELERATE = """\
        acceleration[j] = CHANGE[j][0] * (s->s[j] - s->m[j]) + CHANGE[j][1] * s->n[j] + CHANGE[j][2] * n;
"""
C_NOT_YET = """\
        if (AT_SETPOINT[j] > 0 && s->cold > 1)
            acceleration[j] = 0; /* not known yet */
"""
C_PASSED = Template("""\
        for (int j = 0; j < NY && s->cold < 3; ++j) { /* a path goes on all the same */
            if (!(AT_SETPOINT[j] > 0))
                continue;
            const double way = SLEW[j] * ${double}PERIOD;
            const double known = isfinite(r[j]) ? ${double}r[j] : s->m[j] + ${double}PERIOD * s->n[j];
            const double now = fmax(s->s[j] - way, fmin(s->s[j] + way, known));
            s->n[j] = (now - s->m[j]) / ${double}PERIOD;
            s->s[j] = s->m[j] = now;
$goes_on            if (!isfinite(r[j]))
                s->takes_over = 3;
        }
""")
C_COUNTED = """\
s->cold -= s->cold > 0;
    s->takes_over -= s->takes_over > 0;"""
C_BACK_CALCULATION = "s->z[i] = s->z[i] + push + PERIOD / TRACKING[i] * ($arrives - v);"
C_CLAMPING = """\
if (!(($wanted - u[i]) * push > 0))
            s->z[i] += push;"""
C_LINES = """
/* Straight lines through nodes (x, y), and on along the first and the last one. */
static real on_lines(real at, const real *x, const real *y, int nodes)
{
    int k = 0;
    while (k < nodes - 2 && at >= x[k + 1])
        ++k;
    return y[k] + (y[k + 1] - y[k]) / (x[k + 1] - x[k]) * (at - x[k]);
}
"""
C_COMPENSATION = Template("""\
        if (i == $i) { /* $effect */
            real at = 0;
            for (int j = 0; j < NY; ++j)
                at += POSITION_$k[j] * $aim$moved;
            own += on_lines(at, ADDED_${k}_AT, ADDED_$k, POINTS_$k);
        }
""")
C_CURVES = Template("""
/* v of a command: what arrives of it. */
static real arrives(int i, real u)
{
    switch (i) {
$arrives
    default: return u;
    }
}

/* The command of a v. */
static real commanded(int i, real v)
{
    switch (i) {
$commanded
    default: return v;
    }
}
""")


def c_code(law: ScheduledPID, name: str, *, single: bool = False) -> tuple[str, str]:
    """Header and source: <name>_init, <name>_take_over and <name>_step on a <name>_state; `real` is float where single."""
    number, f = (_float, "f") if single else (double_text, "")
    narrow, double = "(real)" * single, "(double)" * single  # of what is kept in double precision, and to it
    late, inverted = law.awaits, bool(law.inverses)
    accelerated, paths = bool(law.Kaa.any()), bool(law.paths.any())
    first = "s->cold == 3" if paths else "s->cold"
    if single:
        _check_float(law)
    scheduled, several, sizes = law.schedule is not None, law.span.ndim > 1, table_sizes(law)
    gain = (lambda K: f"at({K}, phi)") if scheduled else (lambda K: K)
    NAME, rho, isfinite = name.upper(), "real rho, ", "isfinite(rho)"
    if several:
        rho, isfinite = "const real rho[NS], ", " && ".join(f"isfinite(rho[{n}])" for n in range(sizes["NS"]))
    words = {
        "name": name, "NAME": NAME, "real": "float" if single else "double", "nu": sizes["NU"], "ny": sizes["NY"],
        "several": f"enum {{ {NAME}_NS = {sizes['NS']} }}; /* schedule variables */\n" if several else "",
        "head": "\n".join(f" * {plain_comment(line)}".rstrip() for line in head_lines(law)),
        "sizes": "".join(
            f", {key} = {f'{NAME}_NS' if key == 'NS' else n}" for key, n in sizes.items() if key not in ("NU", "NY")
        ),
        "no_limit": number(np.inf), "tables": "\n".join(_c_table(table, number) for table in tables(law)),
        "weights": _c_scheduling(law, f) if scheduled else "", "schedule": (C_SCHEDULES if several else C_SCHEDULE) * scheduled,
        "rho": rho.replace("NS", f"{NAME}_NS").replace("real", f"{name}_real") * scheduled, "rho_real": rho * scheduled,
        "and_rho": " and schedule rho" * scheduled,
        "outside": "    bool outside; /* rho is outside the span of the gains, or no number */\n" * scheduled,
        "finite": isfinite if scheduled else "true",
        "u0": gain("U0[i]"), "Kp": gain("KP[i][j]"), "Ki": gain("KI[i][j]"), "Kd": gain("KD[i][j]"),
        "Kr": gain("KR[i][j]"),
        "l": "l" if late else "m" if law.shaped else "r", "aim": f"{narrow}s->m[j]" if law.shaped else "r[j]",
        "awaited": f"{narrow}s->l[j]" if late else f"{narrow}s->m[j]" if law.shaped else "r[j]",
        "Ka": f"            own += {gain('KA[i][j]')} * {narrow}s->n[j];\n" * law.shaped
        + f"            own += {gain('KAA[i][j]')} * {narrow}acceleration[j];\n" * accelerated,
        "shaping": _c_shaping(law, first, double) * law.shaped,
        "first": first, "flag": "int" if paths else "bool", "begun": "3" if paths else "true",
        "counted": "; and samples until a path's acceleration is known" * paths,
        "warm": C_COUNTED if paths else "s->cold = s->takes_over = false;",
        "passed": C_PASSED.substitute(double=double, goes_on=_c_awaiting("s->l[j]", 12) * late) * paths,
        "accelerations": "    double acceleration[NY];\n" * accelerated,
        "compensating": "".join(_c_compensation(law, k, narrow) for k in range(len(law.compensations))),
        "shaping_state": C_SHAPING_STATE.substitute(
            NAME=NAME, awaiting=C_AWAITING_STATE.substitute(NAME=NAME, line=sizes.get("LAGS")) * late
        ) * law.shaped,
        "sides": C_SIDES.substitute(name=name, NAME=NAME) * inverted, "moved_on": C_MOVED_ON * inverted,
        "curves": C_LINES * bool(law.curves or law.compensations) + (_c_curves(law) if law.curves else ""),
        "wanted": "wanted" if law.curves or inverted else "v",
        "held": _c_arrives(law, C_THROUGH if inverted else "s->u[i]"),
        "wanting": C_INVERT.substitute(linear="commanded(i, v)" if law.curves else "v") if inverted
        else "        const real wanted = commanded(i, v);\n" * bool(law.curves),
        "integral": Template(C_BACK_CALCULATION if isinstance(law.anti_windup, BackCalculation) else C_CLAMPING).substitute(
            arrives=_c_arrives(law, "u[i] - added" if inverted else "u[i]"), wanted="wanted" if law.curves or inverted else "v"
        ),
    }  # fmt: skip
    return C_HEADER.substitute(words), C_SOURCE.substitute(words)


def _c_arrives(law: ScheduledPID, u: str) -> str:
    """What arrives of a command, in C."""
    return f"arrives(i, {u})" if law.curves else f"({u})" if " " in u else u


def _c_shaping(law: ScheduledPID, first: str, double: str) -> str:
    """Statements that make m, its rate and acceleration, and what the loop awaits."""
    accelerate = (C_ACCELERATE + C_NOT_YET * bool(law.paths.any())) * bool(law.Kaa.any())
    begins = "(y[j] + AT_SETPOINT[j] * (r[j] - y[j]))" if law.paths.any() else "y[j]"
    text = C_SHAPING.substitute(double=double, accelerate=accelerate, first=first, begins=begins)
    if not law.awaits:
        return text
    begun = C_BEGIN_AWAITING.substitute(first=first, double=double, begins=begins)
    return text + begun + _c_awaiting(f"{first} ? late : s->l[j]", 8)


def _c_awaiting(stood: str, indent: int) -> str:
    """Statements that make what the loop awaits; stood: what the play showed before."""
    return textwrap.indent(Template(C_AWAIT).substitute(stood=stood), " " * indent)


def _c_compensation(law: ScheduledPID, k: int, narrow: str) -> str:
    """Statements that add a compensation to its command."""
    own, aim, moved = law.compensations[k], f"{narrow}s->m[j]" if law.shaped else "r[j]", ""
    if law.shaped:
        moved = f" + MOTION_{k + 1}[j] * {narrow}s->n[j]"
    effect = plain_comment(f"compensation of {own.effect}")
    return C_COMPENSATION.substitute(i=law.actuated.index(own.input), k=k + 1, effect=effect, aim=aim, moved=moved)


def _c_curves(law: ScheduledPID) -> str:
    """The functions from a command to what arrives of it, and back."""
    numbers = [i for i, _ in curves_by_number(law)]
    each = [f"    case {i - 1}: return on_lines({{at}}, CURVE_{i}_{{x}}, CURVE_{i}_{{y}}, NODES_{i});" for i in numbers]
    ways = (("u", "U", "V"), ("v", "V", "U"))
    arrives, commanded = ("\n".join(own.format(at=at, x=x, y=y) for own in each) for at, x, y in ways)
    return C_CURVES.substitute(arrives=arrives, commanded=commanded)


def _c_scheduling(law: ScheduledPID, f: str) -> str:
    """The functions that make the weights and apply them."""
    basis = law.basis
    if not isinstance(basis, Products):
        return C_WEIGHTS.substitute(meaning=basis_meaning(basis), body=_c_weights(basis, f)) + C_AT
    texts, calls, own = [], [], ("weights", *BASIS_NAMES)
    for i, factor in enumerate(basis.factors, 1):
        text = C_WEIGHTS.substitute(meaning=basis_meaning(factor), body=_c_weights(factor, f))
        texts.append(numbered(text.replace("Weights of the coefficients", f"Functions of variable {i}"), own, i))
        inside = f"clipped(rho[{i - 1}], SPAN[{i - 1}][0], SPAN[{i - 1}][1])"
        calls += [f"    real phi_{i}[TERMS_{i}];", f"    weights_{i}({inside}, phi_{i});"]
    product = " * ".join(f"phi_{i}[CHOSEN[k][{i - 1}]]" for i in range(1, len(texts) + 1))
    whole = C_PRODUCTS.substitute(meaning=basis_meaning(basis), factors="\n".join(calls), product=product, at=C_AT)
    return "".join([*texts, whole])


def _c_weights(basis: Basis, f: str) -> str:
    """Statements that fill phi at a rho within the span; f: ending of the library's functions."""
    match basis:
        case PiecewiseLinear(knots=knots) if len(knots) > 1:
            return C_LINEAR
        case Gaussian(centres=centres) if len(centres):
            text = Template(C_SHARES if basis.normalised else C_BELLS).substitute(exp=f"exp{f}")
            return text + "\n    phi[BELLS] = 1;" * basis.with_constant
        case Powers(exponents=exponents):
            terms = [power_text(e, "1", lambda e: f"pow{f}(x, {e}{f.upper()})") for e in exponents]
            x = "    const real x = rho / SCALE;" + " (void)x;" * (not exponents.any())
            return "\n".join([x, *(f"    phi[{k}] = {term};" for k, term in enumerate(terms))])
    return C_EVEN


def _c_table(table: Table, number: Number) -> str:
    """static const real KP[NU][NY] = {...}; with its comments."""
    kind, number = ("double", double_text) if table.wide else ("real", number)
    kind, number = ("int", lambda value: str(int(value))) if table.whole else (kind, number)
    start = f"static const {kind} {table.name}{''.join(f'[{size}]' for size in table.sizes)} ="
    comment = f"/* {plain_comment(table.comment)} */"
    if not table.sizes:
        return with_comment(f"{start} {number(float(table.values))};", comment)
    if not table.rows:
        return with_comment(f"{start} {{{', '.join(map(number, table.values))}}};", comment)
    comments = iter(table.rows)

    def braces(values: np.ndarray, indent: str) -> list[str]:
        if values.ndim == 1:
            return [with_comment(f"{indent}{{{', '.join(map(number, values))}}},", f"/* {plain_comment(next(comments))} */")]
        return [f"{indent}{{", *(line for own in values for line in braces(own, indent + "    ")), f"{indent}}},"]

    return "\n".join([f"{start} {{ {comment}", *braces(table.values, "")[1:-1], "};"])


def _float(value: float) -> str:
    return f"{np.float32(np.clip(value, -NO_LIMIT_FLOAT, NO_LIMIT_FLOAT))}F"


def _check_float(law: ScheduledPID) -> None:
    """Refuse numbers that single precision does not hold apart, or not at all."""
    mend = "export it with double precision"
    for table in tables(law):
        limits = table.name in ("LOW", "HIGH", "RATE")
        if not limits and not table.wide and np.abs(table.values).max() > NO_LIMIT_FLOAT:
            raise InputError(f"{table.name} holds numbers beyond single precision", file=law.name, mend=mend)
        apart = table.name.startswith(("SPAN", "KNOTS", "CURVE")) or table.name.endswith("_AT")
        if apart and np.any(np.diff(np.float32(table.values)) <= 0.0):
            raise InputError(f"{table.name} holds values that are one in single precision", file=law.name, mend=mend)
