import numpy as np
import pytest

from plants import WEB_WINDING
from studies.experiments import plan
from workbench.data import Dataset, Experiment
from workbench.errors import InputError
from workbench.identification import METHODS
from workbench.identification.lti import LTI
from workbench.identification.selection import choose
from workbench.identification.ssm import SSM
from workbench.simulation import simulate


def data(seed=0, N=900):
    random = np.random.default_rng(seed)
    u, y = random.normal(size=N), np.zeros(N)
    for k in range(1, N):
        y[k] = 0.9 * y[k - 1] + u[k - 1]
    y += 0.1 * random.normal(size=N)
    return Dataset((Experiment.from_arrays("a", 0.1, inputs={"u": u}, outputs={"y": y}),))


class Recorded:
    """A method that remembers what it was fitted to."""

    def __init__(self, inner):
        self.inner, self.seen = inner, []

    def fit(self, dataset):
        self.seen.append(sorted(float(t) for e in dataset for t in e.t))
        return self.inner.fit(dataset)


def test_methods_are_judged_on_samples_they_have_not_seen():
    records = data()
    good, poor = Recorded(LTI(order=1)), Recorded(SSM(order=1, feedthrough=False))
    choice = choose({"good": good, "poor": poor}, records)
    t = records.experiments[0].t
    fifth = len(t) // 5
    # the held-back parts lie inside the record, not at its end
    np.testing.assert_allclose(good.seen[0], np.concatenate([t[:fifth], t[2 * fifth : 3 * fifth], t[4 * fifth :]]))
    np.testing.assert_allclose({"good": good, "poor": poor}[choice.method].seen[1], t)
    assert choice.fit[choice.method] == max(choice.fit.values())
    assert set(choice.fit) == {"good", "poor"}


def test_a_method_that_cannot_be_fitted_is_passed_over():
    choice = choose({name: method() for name, method in METHODS.items() if name != "ssm"}, data())
    assert choice.method in ("lti", "oe")
    assert "schedule" in choice.failed["ilm"]
    with pytest.raises(InputError, match="no method"):
        choose({"ilm": METHODS["ilm"]()}, data())


def test_records_that_cannot_decide_are_refused():
    random = np.random.default_rng(1)
    e = Experiment.from_arrays("noise", 0.1, inputs={"u": random.normal(size=900)}, outputs={"y": random.normal(size=900)})
    with pytest.raises(InputError, match="no method simulates"):
        choose({"lti": LTI(order=8)}, Dataset((e,)))


@pytest.mark.slow
def test_a_one_way_schedule_is_judged_inside_its_range():
    """On the winding machine's growing reel the scheduled models win, as they do on records of their own."""
    todo = plan("web-winding", "prbs1")
    run = simulate(WEB_WINDING, todo.controller, todo.scenario(3)).experiment
    records = Dataset((run.with_roles(("V1", "V2"), ("w3",), ("r2",)),))
    assert choose({"lti": LTI(), "ssm": SSM(orders=(2, 3))}, records).method == "ssm"
