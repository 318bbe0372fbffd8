"""Gain-scheduling control design from measured records."""

import os
import sys

# Two BLAS threads on shared cores made small factorisations up to 600 times slower; one is the default, not a law.
for _name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
if "numpy" in sys.modules:  # too late for the environment
    from threadpoolctl import threadpool_limits

    threadpool_limits(limits=1, user_api="blas")
