"""What check asks of a loop, number by number: bounds at every sample, stops, and what the law keeps by itself."""

from dataclasses import replace

import numpy as np
import pytest

from controllers.cancelled import Compensation
from controllers.pid import pid
from workbench.basis import CONSTANT, Powers
from workbench.curves import Curve
from workbench.data import Channel
from workbench.errors import InputError
from workbench.intervals.domains.shapes import Box
from workbench.intervals.errors import ERROR_OF
from workbench.intervals.model import IntervalModel, Mode, Unrefuted
from workbench.intervals.regressors import FIR
from workbench.intervals.semantics import ParameterBox
from workbench.lpv import LPVModel, OperatingPoint, Predictor, Term
from workbench.robustness.envelopes.course import nominal
from workbench.robustness.limits import Limit, LoopLimits, Manoeuvre
from workbench.robustness.loop import course, course_of, driven, with_rates
from workbench.robustness.machine import machine_with_errors
from workbench.robustness.verdict import Bound, Status
from workbench.verification.model import Open, _asked, _by_the_law, _in_motion, _stops, on_model

DT, N = 0.1, 60
BOTH = (Term(0), Term(1))
LAW = pid(("u",), ("y",), ("r",), DT, [0.4], [0.5], low=[-2.0], high=[3.0], rate=[5.0])


def scheduled(exponents=(0.0, 1.0), terms=BOTH, slope=0.1) -> LPVModel:
    """x+ = (0.5 + slope rho) x + 0.3 u + 0.1 e, y = x + e, rho from 0 to 1."""
    F, G = np.array([[[0.4]], [[slope]]]), np.array([[[0.3]], [[0.0]]])
    K, C = np.array([[[0.1]], [[0.0]]]), np.array([[[1.0]], [[0.0]]])
    point = OperatingPoint(CONSTANT, np.zeros((1, 1)), np.zeros((1, 1)))
    return LPVModel(
        "scheduled", DT, (Channel("u", "V", "input"),), (Channel("y", "m", "output"),), (Channel("rho", "m", "schedule"),),
        [[0.0, 1.0]], Powers(exponents), terms, F + K @ C, G, C, np.zeros((2, 1, 1)), point, Predictor(F, G, K, 5),
    )  # fmt: skip


def errors(radius=(0.05, 0.05, 0.01)) -> tuple[IntervalModel, ...]:
    channels = (Channel("y", "m", "input"), Channel("u", "V", "input"))
    mode = Mode(ParameterBox(np.zeros(3), radius), Box((-9.0, -9.0), (9.0, 9.0)), (), 100, 0.1, 0.9)
    own = IntervalModel(
        "e", DT, channels, Channel(ERROR_OF + "y", "m", "output"), None, FIR(1), Unrefuted(), 0.0, np.zeros(2), 1.0, (mode,)
    )
    return (own,)


def test_a_limit_holds_from_its_beginning_on_and_a_band_from_when_it_has_settled():
    t = DT * np.arange(N)
    r = np.where(t >= 2.0, 1.0, 0.0)[:, None]
    low, high = _asked(Limit("y", low=-1.0, high=2.0, begin=0.5), LAW, r, "m")
    np.testing.assert_array_equal(np.isfinite(low.low), t >= 0.5 - 1e-9)
    assert not np.isfinite(low.high).any()
    assert set(high.high[t >= 0.55]) == {2.0}
    (band,) = _asked(Limit("y", band=0.1, settling=1.0), LAW, r, "m")
    asked = np.isfinite(band.low)
    first = (t >= 1.0 - 1e-9) & (t < 2.0 - 1e-9)  # until the next step
    np.testing.assert_array_equal(asked, (t >= 3.0 - 1e-9) | first)
    np.testing.assert_allclose(band.low[asked], np.where(first, -0.1, 0.9)[asked])
    np.testing.assert_allclose(band.high[asked], np.where(first, 0.1, 1.1)[asked])
    (rate,) = _asked(Limit("u", rate=4.0, begin=1.0), LAW, r, "V")
    assert (rate.signal, rate.unit) == ("rate of u", "V/s")
    np.testing.assert_array_equal(np.isfinite(rate.high), t >= 1.1 - 1e-9)  # between samples of which both are from then on
    np.testing.assert_array_equal(rate.low, -rate.high)


def test_stops_are_the_laws_own_limits():
    level, rate = _stops(LAW, scheduled(), N)
    assert (level.signal, level.low[0], level.high[-1]) == ("u", -2.0, 3.0)
    assert (rate.signal, rate.low[0], rate.high[-1]) == ("rate of u", -5.0, 5.0)
    assert not _stops(pid(("u",), ("y",), ("r",), DT, [0.4], [0.5]), scheduled(), N)


@pytest.mark.parametrize(
    ("signal", "low", "high", "kept"),
    [
        ("u", -2.0, 3.0, True), ("u", -2.0, 2.9, False), ("u", -1.9, 3.0, False), ("y", -2.0, 3.0, False),
        ("rate of u", -5.0, 5.0, True), ("rate of u", -4.9, 4.9, False),
    ],
)  # fmt: skip
def test_the_law_keeps_what_is_no_tighter_than_its_own_limit(signal, low, high, kept):
    assert _by_the_law(LAW, Bound("", signal, "", np.full(N, low), np.full(N, high))) is kept


def test_rates_are_changes_of_the_command_per_second():
    loop = with_rates(driven(machine_with_errors(scheduled(), errors(), 0.5), LAW), ["u"])
    r = np.where(np.arange(N) > 10, 1.0, 0.2)[:, None]
    v = nominal(course([loop], r)).v
    u, rate = v[:, loop.signals.index("u")], v[:, loop.signals.index("rate of u")]
    np.testing.assert_allclose(rate[1:], np.diff(u) / DT, atol=1e-12)
    assert rate[0] == pytest.approx(0.0, abs=1e-12)  # from rest
    assert np.abs(rate).max() > 1.0


def test_without_noise_only_what_moves_is_uncertain():
    args = (scheduled(), errors(), LAW, np.full(N, 0.5), np.zeros((N, 1)))
    names = course_of(*args, noise=True).lam[0], course_of(*args, noise=False).lam[0]
    np.testing.assert_array_equal(names[0], [0.05, 0.05, 0.01])
    np.testing.assert_array_equal(names[1], [0.05, 0.05, 0.0])


def test_a_reference_model_changes_nothing_of_a_loop_in_motion():
    """Its states are in the loop there: what stands still may leave them out, what moves may not."""
    plain, behind = (
        _in_motion(scheduled(), errors(), law, 0.5, 3, 1.0, "", lambda _: None) for law in (LAW, replace(LAW, bandwidth=3.0))
    )
    assert behind.status is plain.status is Status.PROVED
    assert behind.margin == pytest.approx(plain.margin, rel=0.01)


def test_what_a_law_adds_over_its_set_points_is_in_no_loop_and_in_every_run():
    """The loop is proved as before; of a run, in which the law commands otherwise than its linear form, nothing is."""
    added = Compensation("u", "coulomb@shaft", [0.0], [1.0], Curve("u", [-1.0, 0.0, 1.0], [-0.5, 0.1, 0.5]))
    known = Open(scheduled(), errors(), np.zeros((1, 3)))
    run = Manoeuvre(4.0, {"y": ((0.0, 0.0), (1.0, 1.0))})
    limits = LoopLimits((Limit("y", low=-9.0, high=9.0, unit="m"),), run, sensitivity=2.0)
    plain, fed = (on_model(known, law, limits).verdicts for law in (LAW, replace(LAW, bandwidth=3.0, compensations=(added,))))
    assert [v.claim for v in plain] == [*(v.claim for v in fed[:-1]), "y: low -9 m", "y: high 9 m"]
    assert {v.status for v in plain} == {Status.PROVED, Status.PASSED}
    assert fed[-1].claim == "y: low and high"
    assert [v.status for v in fed] == [*(v.status for v in plain[:-2]), Status.UNDECIDED]
    assert "curves over its set-points" in fed[-1].sentence
    with pytest.raises(InputError, match="not a signal of this loop"):
        on_model(known, replace(LAW, compensations=(added,)), replace(limits, limits=(Limit("z", low=0.0),)))


class Claiming:
    """The law, with a slew that it does not keep."""

    def __init__(self, slew):
        self.slew = slew

    def __getattr__(self, name):
        if name == "slewed":
            raise AttributeError(name)
        return getattr(LAW, name)


def test_a_slew_that_a_law_only_says_it_has_is_not_believed():
    r = np.where(np.arange(N) > 5, 1.0, 0.0)[:, None]
    known = scheduled(), errors()
    courses = [course_of(*known, law, np.full(N, 0.5), r, noise=True) for law in (LAW, Claiming(0.01), Claiming(None))]
    for own in courses[1:]:
        np.testing.assert_array_equal(own.q, courses[0].q)
    slow = course_of(*known, replace(LAW, slew=0.01), np.full(N, 0.5), r, noise=True)
    assert np.abs(nominal(slow).v).max() < 0.2 * np.abs(nominal(courses[0]).v).max()


@pytest.mark.slow
def test_in_motion_only_a_loop_that_is_linear_between_its_nodes_is_proved():
    def asked(model, radius=(0.05, 0.05, 0.01)):
        return _in_motion(model, errors(radius), LAW, 0.5, 3, 1.0, "", lambda _: None)

    assert asked(scheduled()).status is Status.PROVED
    assert asked(scheduled(), (0.6, 0.6, 0.01)).status is Status.UNDECIDED  # wide boxes
    curved = asked(scheduled(exponents=(0.0, 2.0)))
    assert curved.status is Status.UNDECIDED
    assert "halfway between two" in curved.sentence
    bent = replace(
        LAW, basis=Powers((0.0, 2.0)), schedule="rho", span=(0.0, 1.0),
        **{key: np.repeat(getattr(LAW, key), 2, axis=0) * np.array([1.0, 0.1]).reshape(2, *[1] * (getattr(LAW, key).ndim - 1))
           for key in ("Kp", "Ki", "Kd", "Kr", "u0")},
    )  # fmt: skip
    assert _in_motion(scheduled(), errors(), bent, 0.5, 3, 1.0, "", lambda _: None).status is Status.UNDECIDED
    late = asked(scheduled(terms=(Term(0), Term(1, 2))))
    assert late.status is Status.UNDECIDED
    assert "delays of the model's schedule of up to 2 samples" in late.sentence
