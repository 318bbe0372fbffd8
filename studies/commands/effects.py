"""`workbench effects`: what a plant can lack, and how it acts."""

from argparse import Namespace

from studies.catalogue import run as say_effects
from studies.terminal import say


def run(options: Namespace) -> int:
    return say_effects(options, say)
