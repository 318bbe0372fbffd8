"""What the texts of both languages share: the head, comments, powers and numbers.

    v  = u0 + Kr r + Kp (b r - y) + z + Kd f,     z+ = z + dt Ki (r - y) + what keeps z from winding up

Both texts are the law of `scheduled_pid`, operation by operation: tables of its numbers, and one body each. Of a basis the
weights phi(rho) of the coefficients are computed, a gain is K = sum_j phi_j K_j. Nothing is allocated, and all memory is in one
struct or function block. A text depends on the law and the program's version alone: no date, no path.
"""

import re
from collections.abc import Callable, Sequence

import numpy as np

from controllers.code.constants import channels
from controllers.scheduled_pid import BackCalculation, ScheduledPID
from workbench.basis import Basis, Gaussian, PiecewiseLinear, Powers, Products
from workbench.physics.controller import schedules_of
from workbench.provenance import program

NO_LIMIT, NO_LIMIT_FLOAT = 1e300, 1e38  # a limit that is not there, as a number
BASIS_NAMES = ("TERMS", "BELLS", "KNOTS", "CENTRES", "BETA", "SCALE")  # that each of several schedule variables has
WIDTH = 130  # characters of a line; a comment beside a longer one stands above it
LARGEST_POWER = 8  # whole powers up to here are products: exact signs, and no library


def basis_meaning(basis: Basis) -> str:
    match basis:
        case Products():
            return "products of a function of each schedule variable, which CHOSEN says"
        case PiecewiseLinear():
            return "1 at their own knot, 0 at every other, linear between, constant outside"
        case Gaussian(normalised=normalised, with_constant=constant):
            shares, one = ", divided by their sum" * normalised, ", and 1" * constant
            return f"exp(-BETA (rho - CENTRES)^2){shares}{one}"
        case Powers(exponents=exponents):
            return f"(rho / SCALE) to the power of {', '.join(f'{e:g}' for e in exponents)}"


def numbered(text: str, names: Sequence[str], i: int) -> str:
    """The text with the number of a schedule variable behind each of these names."""
    return re.sub(rf"\b({'|'.join(names)})\b", rf"\1_{i}", text)


def plain_comment(text: str) -> str:
    """Text that ends no comment, opens none, and is plain ASCII."""
    return re.sub(r"(?<=[/(])(?=\*)|(?<=\*)(?=[/)])", " ", re.sub(r"[^ -~]", "_", text))


def with_comment(line: str, comment: str) -> str:
    """The line with its comment, which stands above where both together are too long."""
    indent = line[: len(line) - len(line.lstrip())]
    return f"{line} {comment}" if len(line) + len(comment) < WIDTH else f"{indent}{comment}\n{line}"


def power_text(exponent: float, one: str, power: Callable[[float], str]) -> str:
    """x^exponent: a product where the exponent is a small whole number."""
    n = abs(exponent)
    if n != int(n) or n > LARGEST_POWER:
        return power(float(exponent))
    product = " * ".join(["x"] * int(n)) or one
    return product if exponent >= 0.0 else f"{one} / ({product})"


def head_lines(law: ScheduledPID) -> list[str]:
    """What a reader of the text has to know before the first line of it."""
    scheduled = law.schedule is not None
    back = isinstance(law.anti_windup, BackCalculation)
    m, rate = ("m", " + KA n" + " + KAA n'" * bool(law.Kaa.any())) if law.shaped else ("r", "")
    rate += " + what compensates" * bool(law.compensations)
    own = "l" if law.awaits else m
    wanted, arrives = ("the command of which v arrives,", "(what arrives of u)") if law.curves else ("v", "u")
    shaping = [
        "s  = r within SLEW PERIOD of the last s; at the start the last s is y",
        "m, n = MODEL (m-, n-, s): a critically damped reference model and its rate; it starts from rest at y",
        *(["     of a path m is s itself, and n its difference from the last; it starts at r"] if law.paths.any() else []),
        *(["n' = CHANGE (s - m, n, n-): the acceleration"] if law.Kaa.any() else []),
        *(["l  = m of LAG + LAG_SHARE samples ago, through a play of half width PLAY"] if law.awaits else []),
    ]
    inverted = [
        "     the command before an inverse, which adds HALF_WIDTH side + (GEAR_PLAY side / 2 - teeth) / PERIOD; side is its",
        "     sign, which changes beyond KEEP; teeth is (u - HALF_WIDTH side) PERIOD summed up within GEAR_PLAY / 2 of 0",
    ]
    return [
        f"PID law '{law.name}' by {program()}. Change the law there, not this text.",
        "",
        *(shaping if law.shaped else []),
        f"v  = U0 + KR {m}{rate} + KP (B {own} - y) + z + KD f{', the gains are functions of rho' * scheduled}",
        f"f  = DECAY f- + FRESH ((C {own} - y) - (C {own} - y)-), the filtered derivative; the minus marks the sample before",
        f"u  = {wanted} within LOW and HIGH, and within RATE PERIOD of the last command",
        *(inverted if law.inverses else []),
        f"z+ = z + PERIOD KI ({own} - y){f' + PERIOD / TRACKING ({arrives} - v)' * back}",
        *([] if back else ["     unless a limit is reached and that would push further beyond it: then z stands still"]),
        "",
        f"commands u:     {channels(law, law.actuated)}",
        f"set-points r:   {channels(law, law.references)}",
        f"measurements y: {channels(law, law.measured)}",
        *([f"schedule rho:   {channels(law, schedules_of(law))}"] if scheduled else []),
        f"One step every {law.dt:g} s.",
        "",
        "Where a set-point, a measurement or the schedule is not a finite number, the last command is held and the sample is",
        "left out of all memory.",
    ]


def double_text(value: float) -> str:
    return repr(float(np.clip(value, -NO_LIMIT, NO_LIMIT)))
