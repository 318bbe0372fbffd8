import numpy as np
import pytest

from plants import WEB_WINDING
from studies.experiments import plan
from workbench.data import Dataset, Experiment
from workbench.errors import InputError
from workbench.identification import METHODS
from workbench.identification.lti import LTI
from workbench.identification.selection import Judged, _best, choose
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


def judged(*FIT, scheduled=False):
    return Judged(FIT, scheduled)


def test_a_scheduled_model_must_be_better_on_every_part_or_beyond_chance():
    still = judged(80.0, 60.0, 70.0, 70.0)
    cases = {
        (90.0, 62.0, 71.0, 72.0): "moving",  # on every part
        (90.0, 59.0, 71.0, 70.0): "moving",  # a loss of a fortieth
        (90.0, 80.0, 68.0, 72.0): "still",  # on average, by two parts
        (90.0, 80.0, 69.0, 84.0): "moving",  # worse on one, by far better on the rest
        (79.0, 59.0, 69.0, 69.0): "still",
    }
    for FIT, best in cases.items():
        assert _best({"still": still, "moving": judged(*FIT, scheduled=True)}) == best, FIT
        assert _best({"moving": judged(*FIT, scheduled=True), "still": still}) == best, FIT
        assert _best({"moving": judged(*FIT, scheduled=True)}) == "moving"
    # of two scheduled ones the first that is sure; between models that do not move, the mean decides
    unsure = judged(95.0, 85.0, 60.0, 75.0, scheduled=True)
    sure = judged(81.0, 61.0, 71.0, 71.0, scheduled=True)
    assert _best({"a": unsure, "b": sure, "still": still}) == "b"
    assert _best({"still": still, "other": judged(90.0, 80.0, 68.0, 72.0)}) == "other"


@pytest.mark.parametrize("moves", [True, False])
def test_a_machine_that_moves_over_the_schedule_is_told_from_one_that_does_not(moves):
    """y+ = a(rho) y + u, rho drifts one way through the record as a reel's radius does, u comes slow and fast, noise on y."""
    right = 0
    for seed in range(12):
        random = np.random.default_rng(seed)
        N = 1500
        rho, y = np.linspace(-1.0, 1.0, N), np.zeros(N)
        u = np.repeat(random.normal(size=N // 5), 5) + random.normal(size=N)
        a = 0.85 + (0.1 * rho if moves else 0.0 * rho)
        for k in range(1, N):
            y[k] = a[k - 1] * y[k - 1] + u[k - 1]
        y += 0.3 * y.std() * random.normal(size=N)
        e = Experiment.from_arrays("a", 0.1, inputs={"u": u}, outputs={"y": y}, schedule={"rho": rho})
        choice = choose({"lti": LTI(), "ssm": SSM(orders=(1, 2))}, Dataset((e,)))
        right += (choice.method == "ssm") is moves
    assert right >= 10  # the half of the range where it hardly matters has noise of its own


def test_a_choice_beside_an_earlier_one_judges_all_of_them():
    first = choose({"poor": SSM(order=1, feedthrough=False)}, data())
    both = choose({"good": LTI(order=1)}, data(), beside=first)
    assert set(both.judged) == {"poor", "good"}
    assert both.judged["poor"] == first.judged["poor"]
    again = choose({"ilm": METHODS["ilm"]()}, data(), beside=both)
    assert (again.method, again.model) == (both.method, both.model)
    assert "schedule" in again.failed["ilm"]


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
