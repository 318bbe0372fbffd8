"""Is this machine fit for work? Versions, threads, compiler cache, and a self-check against known answers."""

import os
import time

import numpy as np

from workbench.provenance import versions
from workbench.records import record


@record
class Finding:
    """One thing that was looked at."""

    what: str
    found: str
    fine: bool = True
    mend: str = ""


def examine() -> tuple[Finding, ...]:
    """Everything a bug report needs, and whether simulation and solvers give right answers here."""
    return (*_versions(), _cores(), _threads(), _cache(), _simulation(), _solver())


def _versions() -> tuple[Finding, ...]:
    found = versions()
    mend = "python -m pip install -e ."
    return tuple(Finding(name, number, number != "not installed", mend) for name, number in found.items())


def _cores() -> Finding:
    from workbench.physics.stepper import cores

    return Finding("cores", str(cores()))


def _threads() -> Finding:
    from threadpoolctl import threadpool_info

    threads = [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]
    fine = all(n == 1 for n in threads)
    return Finding("BLAS threads", ", ".join(map(str, threads)), fine, "set OPENBLAS_NUM_THREADS=1: more are slower here")


def _cache() -> Finding:
    from workbench.physics.kernel import cache_folder

    folder = cache_folder()
    kernels = len(list(folder.glob("kernel_*.py")))
    return Finding("compiler cache", f"{folder} ({kernels} kernels)", os.access(folder, os.W_OK), "make the folder writable")


def _simulation() -> Finding:
    """The welding robot under a constant force must settle at the DC gain of G(s), 2.3/1.67."""
    from plants import WELDING_ROBOT
    from workbench.physics.controller import Playback
    from workbench.simulation import Scenario, simulate

    begin = time.perf_counter()
    run = simulate(WELDING_ROBOT, Playback(("u",), 0.02), Scenario("self-check", {"u": np.ones(3000)}))
    error = abs(run.experiment["v"][-1] / (2.3 / 1.67) - 1)
    seconds = time.perf_counter() - begin
    return Finding("simulation", f"error {error:.1e}, {seconds:.2f} s", error < 1e-6, "delete the compiler cache and retry")


def _solver() -> Finding:
    """min |x|_1 subject to |x - (3, 0)|_2 <= 1 has the answer 2."""
    import cvxpy as cp

    x = cp.Variable(2)
    problem = cp.Problem(cp.Minimize(cp.norm1(x)), [cp.norm(x - np.array([3.0, 0.0])) <= 1])
    problem.solve(solver=cp.CLARABEL)
    error = float(np.abs(np.asarray(x.value) - [2.0, 0.0]).max())
    return Finding("conic solver", f"error {error:.1e}", error < 1e-6, "reinstall clarabel and cvxpy")
