"""What a command writes to the terminal: results on standard output, what is being done on standard error."""

import os
import sys
from typing import TextIO


def say(text: str = "") -> None:
    """A result, on standard output."""
    _print(text, sys.stdout)


def progress(text: str) -> None:
    """What is being done, on standard error."""
    _print(f"  {text}", sys.stderr)


def _print(text: str, stream: TextIO) -> None:
    try:
        print(text, file=stream, flush=True)
    except BrokenPipeError:  # `| head` has read enough: the files are wanted all the same
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
