"""The commands behind the command line, a file each: it reads files, calls the workbench, writes files and says what it found."""

from argparse import Namespace
from importlib import import_module

COMMANDS = (
    "simulate", "identify", "compare", "calibrate", "diagnose", "design", "export", "effects", "doctor", "check", "sweep",
    "report", "study",
)  # fmt: skip


def run(options: Namespace) -> int:
    """Run the command that was asked for, and load only that one; returns the exit code."""
    from studies.arguments import check_file

    check_file(options.json, "--json")
    return import_module(f"studies.commands.{options.command}").run(options)
