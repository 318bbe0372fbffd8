"""`workbench check`: prove or refute limits of a loop."""

from argparse import Namespace

from studies.check import check
from studies.terminal import progress, say


def run(options: Namespace) -> int:
    return check(options, say, progress)
