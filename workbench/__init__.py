"""Gain-scheduling control design from measured records: the verbs and nouns of `import workbench as wb`.

data = wb.read("a.csv", "b.csv", outputs="w3", inputs=["V1", "V2"], schedule="r2")
model = wb.SSM(order=3).fit(data)
found = wb.diagnose(WEB_WINDING, data)

The names and where they come from are listed in `__init__.pyi`; a module is loaded when one of its names is first used.
"""

import os
import sys

import lazy_loader

# Two BLAS threads on shared cores made small factorisations up to 600 times slower; one is the default, not a law.
for _name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
if "numpy" in sys.modules:  # too late for the environment
    from threadpoolctl import threadpool_limits

    threadpool_limits(limits=1, user_api="blas")

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
