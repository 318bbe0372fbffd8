"""`workbench export`: write a controller for another program."""

from argparse import Namespace

from studies.exports import export
from studies.terminal import say


def run(options: Namespace) -> int:
    return export(options, say)
