"""What tests share is read as `tests.hidden` or `tests.controllers`, by benchmarks too: the checkout's root is on the path."""

import sys
from pathlib import Path

from hypothesis import HealthCheck, settings

sys.path.insert(0, str(Path(__file__).parents[1]))

# a busy machine draws slowly: that says nothing of what is tested
settings.register_profile("any-machine", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("any-machine")
