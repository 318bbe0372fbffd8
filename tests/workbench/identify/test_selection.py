import numpy as np
import pytest

from workbench.data import Dataset, Experiment
from workbench.errors import InputError
from workbench.identify import METHODS
from workbench.identify.lti import LTI
from workbench.identify.selection import choose
from workbench.identify.ssm import SSM


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
        self.seen.append(max(e.t[-1] for e in dataset))
        return self.inner.fit(dataset)


def test_methods_are_judged_on_samples_they_have_not_seen():
    records = data()
    good, poor = Recorded(LTI(order=1)), Recorded(SSM(order=1, feedthrough=False))
    choice = choose({"good": good, "poor": poor}, records)
    end = records.experiments[0].t[-1]
    assert good.seen[0] == pytest.approx(2 / 3 * end, abs=0.2)
    assert {"good": good, "poor": poor}[choice.method].seen[1] == pytest.approx(end)
    assert choice.fit[choice.method] == max(choice.fit.values())
    assert set(choice.fit) == {"good", "poor"}


def test_a_method_that_cannot_be_fitted_is_passed_over():
    choice = choose({name: method() for name, method in METHODS.items() if name != "ssm"}, data())
    assert choice.method == "lti"
    assert "schedule" in choice.failed["ilm"]
    with pytest.raises(InputError, match="no method"):
        choose({"ilm": METHODS["ilm"]()}, data())
