"""What tests share is read as `tests.hidden` or `tests.controllers`, by benchmarks too: the checkout's root is on the path."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
