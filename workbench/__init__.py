"""Gain-scheduling control design from measured records: the verbs and nouns of `import workbench as wb`.

data = wb.read("a.csv", "b.csv", outputs="w3", inputs=["V1", "V2"], schedule="r2")
model = wb.SSM(order=3).fit(data)
found = wb.diagnose(WEB_WINDING, data)

The names and where they come from are listed in `__init__.pyi`; a module is loaded when one of its names is first used. Three
modules have public names of their own: `workbench.intervals`, `workbench.physics.effects`, `workbench.sweeps`.
"""

import os
import sys
from importlib import import_module
from typing import Any

import lazy_loader

# Two BLAS threads on shared cores made small factorisations up to 600 times slower; one is the default, not a law.
for _name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
if "numpy" in sys.modules:  # too late for the environment
    from threadpoolctl import threadpool_limits

    threadpool_limits(limits=1, user_api="blas")

_listed, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

# Names that were in this list until 0.1: they work for one more version.
_MOVED = {
    "workbench.intervals": ("ARX", "FIR", "BySchedule", "InTime", "OutputErrorRegression", "cover", "load_interval_model"),
    "workbench.physics.effects": (
        "EFFECTS", "Domain", "Effect", "EffectParameter", "Pulley", "Reel", "Robot", "Shaft", "Slide", "Span", "Spring", "Tank",
        "Winding",
    ),
    "workbench.sweeps": ("load_sweep", "read_rows", "run_sweep"),
}  # fmt: skip


def __getattr__(name: str) -> Any:
    for module, names in _MOVED.items():
        if name in names:
            return getattr(import_module(module), name)
    return _listed(name)
