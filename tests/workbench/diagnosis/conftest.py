"""The machines of these tests are read as `tests.workbench.diagnosis.cases`: the checkout's root is on the path."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[3]))
