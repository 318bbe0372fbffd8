"""What a command writes to the terminal: results on standard output, what is being done on standard error.

Colours are for a terminal alone, and for none that asks for no colours (NO_COLOR).
"""

import os
import re
import sys
import time
from typing import TextIO

DIM, RED, GREEN, YELLOW = 2, 31, 32, 33
#: What a line begins with -> its colour.
COLOURS = {"PROVED": GREEN, "PASSED": GREEN, "FAILED": RED, "UNDECIDED": YELLOW, "warning:": YELLOW}
SHORT = 0.1  # s: what takes less is not told


class _Talk:
    """How much a command tells, and since when."""

    quiet = False
    verbose = False
    began = 0.0
    stage = 0.0  # 0: none under way


def begin(*, quiet: bool = False, verbose: bool = False) -> None:
    """A command begins. quiet: only its answer and errors are written; verbose: what each stage takes, too."""
    _Talk.quiet, _Talk.verbose, _Talk.began, _Talk.stage = quiet, verbose, time.monotonic(), 0.0


def end() -> None:
    """The command has ended."""
    if _Talk.verbose:
        _took()
        _print(f"  {time.monotonic() - _Talk.began:.1f} s in all", sys.stderr, DIM)
    _Talk.quiet = _Talk.verbose = False


def say(text: str = "") -> None:
    """A result, on standard output."""
    _print(text, sys.stdout)


def note(text: str) -> None:
    """What is to be known of the words typed, on standard error."""
    _print(f"note: {text}", sys.stderr, YELLOW)


def progress(text: str) -> None:
    """What is being done, on standard error; silent with --quiet."""
    if _Talk.quiet:
        return
    if _Talk.verbose:
        _took()
        _Talk.stage = time.monotonic()
    _print(f"  {text}", sys.stderr, DIM)


def _took() -> None:
    """What the stage that ends here has taken."""
    if _Talk.stage and (seconds := time.monotonic() - _Talk.stage) >= SHORT:
        _print(f"    took {seconds:.1f} s", sys.stderr, DIM)
    _Talk.stage = 0.0


def _print(text: str, stream: TextIO, colour: int | None = None) -> None:
    try:
        print(_coloured(text, colour) if _has_colours(stream) else text, file=stream, flush=True)
    except BrokenPipeError:  # `| head` has read enough: the files are wanted all the same
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _has_colours(stream: TextIO) -> bool:
    return stream.isatty() and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"


def _coloured(text: str, colour: int | None) -> str:
    if colour is not None:
        return f"\x1b[{colour}m{text}\x1b[0m"
    pattern = rf"^({'|'.join(COLOURS)})"
    return re.sub(pattern, lambda found: f"\x1b[{COLOURS[found[1]]}m{found[1]}\x1b[0m", text, flags=re.MULTILINE)
