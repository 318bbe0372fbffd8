# PYTHON_ARGCOMPLETE_OK
"""The command line. Commands import what they need when they run: help must not wait for a compiler."""

import argparse
import os
import sys
import tempfile
import traceback
from collections.abc import Sequence
from difflib import get_close_matches
from typing import NoReturn

from studies.options import COMMANDS, talk

DONE, NEGATIVE, BAD_INPUT, NOT_HANDED_OUT, CRASHED, INTERRUPTED = 0, 1, 2, 3, 70, 130


class _Parser(argparse.ArgumentParser):
    """argparse, but an unknown word is answered with the nearest one."""

    def error(self, message: str) -> NoReturn:
        known = sorted(_words(self))
        words = message.replace("'", " ").replace("=", " ").split()
        unknown = [word for word in words if "unrecognized" in message or "invalid choice" in message]
        near = [match for word in unknown if word not in known for match in get_close_matches(word, known, 1, 0.6)]
        mend = f"\n  mend: did you mean {near[0]}?" if near else ""
        sys.stderr.write(f"{self.prog}: {message}{mend}\n  see {self.prog} --help\n")
        raise SystemExit(BAD_INPUT)


def _words(parser: argparse.ArgumentParser) -> set[str]:
    """Every option and command that a parser and its commands know."""
    words = set()
    for action in parser._actions:
        words.update(action.option_strings)
        if isinstance(action, argparse._SubParsersAction):
            for name, sub in action.choices.items():
                words.update({name}, _words(sub))
    return words


class _Version(argparse.Action):
    """Prints the version and ends; it is looked up where it is asked for."""

    def __call__(self, parser, namespace, values, option_string=None):
        from workbench.version import __version__

        sys.stdout.write(f"workbench {__version__}\n")
        parser.exit()


def parser() -> argparse.ArgumentParser:
    """Every command with its options."""
    top = _Parser(prog="workbench", description="Gain-scheduling control design from measured records.", allow_abbrev=False)
    top.add_argument("--version", action=_Version, nargs=0, help="print the version and end")
    commands = top.add_subparsers(dest="command", metavar="COMMAND", required=True, parser_class=_Parser)

    for name, command in COMMANDS.items():
        sub = commands.add_parser(
            name,
            help=command.summary,
            description=command.summary,
            epilog=command.epilog,
            allow_abbrev=False,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        if command.into:
            sub.add_argument("--out", metavar="DIR", help="folder for results (default: a new one under runs/)")
        sub.add_argument(
            "--json",
            metavar="FILE",
            help="write the numbers to this file as well (-: standard output, alone)",
        )
        talk(sub, name)
        command.options(sub)
    return top


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; 0 done, 1 the answer is negative, 2 bad input (with the place and the mend), 3 an answer that the
    referee does not hand out, 130 interrupted.
    """
    words = parser()
    if "_ARGCOMPLETE" in os.environ:  # the shell asks what could stand here; does not return
        import argcomplete

        argcomplete.autocomplete(words)
    options = words.parse_args(arguments)
    try:
        from studies import commands, terminal
        from workbench.errors import InputError
    except KeyboardInterrupt:
        return INTERRUPTED
    terminal.begin(quiet=getattr(options, "quiet", False), verbose=options.verbose)
    try:
        return commands.run(options)
    except InputError as reason:
        sys.stderr.write(f"workbench {options.command}: {reason}\n")
        return BAD_INPUT
    except KeyboardInterrupt:
        sys.stderr.write(f"workbench {options.command}: interrupted; what is written is whole, the rest is not there\n")
        return INTERRUPTED
    finally:
        terminal.end()


def console() -> int:
    """What the shell runs: an error of the program itself is no answer, and ends with 70 and one sentence.

    The traceback is for its makers: in a file, whose place is said.
    """
    try:
        return main()
    except Exception as reason:  # an uncaught one would end with 1, which is the answer no
        command = next((word for word in sys.argv[1:] if not word.startswith("-")), "")
        path = _traceback_file(traceback.format_exc())
        sys.stderr.write(
            f"workbench {command}: an error of the workbench itself, nothing is decided: {type(reason).__name__}: {reason}\n"
            f"  mend: please report it with {path}; the inputs that led to it may still be sound\n"
        )
        return CRASHED


def _traceback_file(text: str) -> str:
    """A new file that holds the words typed and this text: in the folder --out, or where temporary files lie."""
    words = sys.argv[1:]
    out = words[words.index("--out") + 1] if "--out" in words[:-1] else None
    for folder in (out, None):
        try:
            number, path = tempfile.mkstemp(".txt", "workbench-error-", folder)
        except OSError:
            continue
        with os.fdopen(number, "w", encoding="utf-8") as file:
            file.write(f"workbench {' '.join(words)}\n{text}")
        return path
    return "the words that you typed"


if __name__ == "__main__":
    raise SystemExit(console())
