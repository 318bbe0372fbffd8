"""What tests share is read as `tests.hidden` or `tests.controllers`, by benchmarks too: the checkout's root is on the path."""

import sys
from pathlib import Path

from hypothesis import HealthCheck, settings

sys.path.insert(0, str(Path(__file__).parents[1]))

# a busy machine draws slowly: that says nothing of what is tested
settings.register_profile("any-machine", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("any-machine")


def pytest_xdist_auto_num_workers(config):
    """None side by side where time is measured, else as many as there are cores."""
    return 0 if config.option.markexpr == "bench" else None


def pytest_terminal_summary(terminalreporter, config):
    """What this run has left out, and how to run it."""
    if "not slow" in config.option.markexpr and " or " not in config.option.markexpr:
        terminalreporter.write_line(
            "left out: whole chains, studies and long attacks (pytest -m 'slow or not slow'), speed (pytest -m bench)"
        )
