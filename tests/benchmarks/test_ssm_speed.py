"""SSM against the plain CVXPY statement of [1] eq. (1.8), side by side on one matrix: order 13 of the winding machine.

Run with OPENBLAS_NUM_THREADS=1 pytest -m bench -s; the peer alone takes minutes in the infinity norm.
"""

import time
from statistics import median

import numpy as np
import pytest

from plants import WEB_WINDING
from studies.experiments import EXPERIMENTS
from workbench.data import Dataset
from workbench.identification.sparse import L2, LInf
from workbench.identification.ssm import SSM, RawSignals, UnitColumns
from workbench.identification.ssm.regression import Problem
from workbench.simulation import simulate

pytestmark = pytest.mark.bench


@pytest.fixture(scope="module", autouse=True)
def one_thread():
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1):
        yield


@pytest.fixture(scope="module")
def records():
    plans = EXPERIMENTS["web-winding"]
    runs = [simulate(WEB_WINDING, plans[k].controller, plans[k].scenario(1)).experiment for k in ("prbs1", "rbs")]
    return Dataset(tuple(runs)).with_roles(outputs=["w3"])


@pytest.fixture(scope="module")
def regression(records):
    """Psi (4474, 312) with unit columns, and Y."""
    Psi, Y = Problem(SSM(order=13, operating_point=RawSignals()), records).regression(13)
    Psi = Psi[:, np.any(Psi != 0, axis=0)]  # without a feed-through the columns of u(k) are empty
    return Psi / UnitColumns().scale(Psi), Y[:, 0]


def clocked(function, repetitions):
    """Median processor time [s] and the last answer: the machine is shared, wall time is other people's too."""
    times = []
    for _ in range(repetitions):
        start = time.process_time()
        answer = function()
        times.append(time.process_time() - start)
    return median(times), answer


@pytest.mark.parametrize(
    ("bound", "order", "factor", "target", "peers"),
    [(L2(), 2, 1.1, 30, 3), (L2(), 2, 2.0, 30, 3), (LInf(), "inf", 2.0, 20, 1)],
    ids=["l2 at 1.1 mu_min", "l2 at 2 mu_min", "linf at 2 mu_min"],
)
def test_step_one_is_faster_than_its_plain_statement(regression, bound, order, factor, target, peers, record_property):
    import cvxpy as cp

    Psi, Y = regression
    mu = factor * bound.smallest(Psi, Y).mu
    bound.sparsest(Psi, Y, mu)  # imports

    def stated():
        theta = cp.Variable(Psi.shape[1])
        return cp.Problem(cp.Minimize(cp.norm1(theta)), [cp.norm(Y - Psi @ theta, order) <= mu]).solve(solver=cp.CLARABEL)

    ours, answer = clocked(lambda: bound.sparsest(Psi, Y, mu), 5)
    theirs, value = clocked(stated, peers)
    ratio = theirs / ours
    record_property("ratio", ratio)
    print(
        f"\n{type(bound).__name__} at {factor:g} mu_min {Psi.shape}: {ours:.3f} s, CVXPY + Clarabel {theirs:.2f} s, "
        f"ratio {ratio:.0f}; objective {answer.value:.9g} and {value:.9g}, support {len(answer.support)}, "
        f"gap {answer.gap:.1e}"
    )
    assert value == pytest.approx(answer.value, rel=1e-6)
    assert ratio >= target


def test_the_smallest_bound_is_certified_and_quick(regression):
    Psi, Y = regression
    for bound in (L2(), LInf()):
        seconds, answer = clocked(lambda bound=bound: bound.smallest(Psi, Y), 3)
        print(f"\n{type(bound).__name__} mu_min = {answer.mu:.9g}, gap {answer.gap:.1e}, {seconds:.2f} s")
        assert answer.gap <= 1e-6


def test_the_default_fit_of_two_records_takes_seconds(records):
    seconds, model = clocked(lambda: SSM().fit(records), 1)
    print(f"\nSSM().fit, orders 1..15, four bounds each: {seconds:.1f} s; {model.name}, {len(model.estimates)} terms")
    assert np.isfinite(model.A).all()
    assert seconds <= 15
