"""Names that a law may have in C and Structured Text."""

import re

from controllers.code.structured_text import st_code
from controllers.scheduled_pid import ScheduledPID
from workbench.errors import InputError

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
