"""`workbench design`: design a controller on an identified model."""

from argparse import Namespace

from studies.design import design
from studies.terminal import progress, say


def run(options: Namespace) -> int:
    return design(options, say, progress)
