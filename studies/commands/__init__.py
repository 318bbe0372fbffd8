"""The commands behind the command line, a file each: it reads files, calls the workbench, writes files and says what it found."""

import sys
from argparse import Namespace
from contextlib import redirect_stdout
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory

from studies.terminal import say


def run(options: Namespace) -> int:
    """Run the command that was asked for, and load only that one; returns the exit code.

    With `--json -` standard output holds the numbers alone, and what is said goes to standard error.
    """
    from studies.arguments import check_file

    command = import_module(f"studies.commands.{options.command}")
    if options.json != "-":
        check_file(options.json, "--json")
        return command.run(options)
    with TemporaryDirectory() as folder:
        options.json = str(Path(folder) / "numbers.json")
        with redirect_stdout(sys.stderr):
            code = command.run(options)
        numbers = Path(options.json)
        if numbers.exists():
            say(numbers.read_text(encoding="utf-8").removesuffix("\n"))
    return code
