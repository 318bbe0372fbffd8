"""Stamps of a logger, spoilt in known ways: what is read must be what was measured, at the time when it was."""

import itertools

import numpy as np
import pytest

from workbench.advice import quantum
from workbench.data import bad_stamps
from workbench.errors import InputError
from workbench.sources import read
from workbench.stamps import MEND, MISSED

DT = 0.02


class Log:
    """An even run: sample k at k DT; the channel k says which sample a row is, the others move slowly."""

    def __init__(self, samples: int):
        self.k = np.arange(samples)
        self.t = self.k * DT
        self.digits = 0.0  # s, step of the stamps

    def spoil(self, fault: str, random: np.random.Generator) -> None:
        at = int(random.integers(len(self.k) // 4, 3 * len(self.k) // 4))
        if fault == "gap":
            self._drop(at, int(random.integers(4, 200)))
        elif fault == "missed":
            for _ in range(int(random.integers(1, 4))):
                self._drop(int(random.integers(40, len(self.k) - 40)), int(random.integers(1, MISSED + 1)))
        elif fault == "doubled":
            self.k, self.t = np.insert(self.k, at, self.k[at]), np.insert(self.t, at, self.t[at])
        elif fault == "late":
            held = int(random.integers(1, 8))
            late = self.t[at + held - 1] + 0.9 * DT * random.random()
            self.t[at : at + held] = np.maximum(self.t[at : at + held], late)
        elif fault == "anew":
            self.t[at:] -= self.t[at] + random.choice([0.0, 3.0])
        elif fault == "set back":
            self.t[at:] -= random.choice([0.5, 3600.0])
        elif fault == "jitter":
            self.t = self.t + 0.2 * DT * random.uniform(-1.0, 1.0, len(self.t))
        elif fault == "digits":
            self.digits = float(random.choice([0.05, 0.1, 1.0]))
            self.t = np.floor(self.t / self.digits + 1e-9) * self.digits

    def _drop(self, at: int, count: int) -> None:
        self.k, self.t = (np.delete(own, slice(at, at + count)) for own in (self.k, self.t))

    @property
    def columns(self) -> dict[str, np.ndarray]:
        return {"t [s]": self.t, "u [V]": np.sin(0.05 * self.k), "k": self.k.astype(float), "y": np.cos(0.031 * self.k) + 2.0}


FAULTS = ("jitter", "gap", "missed", "doubled", "late", "anew", "set back", "digits")


def check(log: Log, at_most: float) -> None:
    """Every record is even in time and holds neighbours that were neighbours; values are those that were measured."""
    stamps = {k: {float(s) for s in log.t[log.k == k]} for k in np.unique(log.k)}
    for e in read(log.columns):
        k = np.rint(e["k"]).astype(int)
        assert np.abs(e["k"] - k).max() < 1e-6
        assert (np.diff(k) == 1).all()  # none is missing, none stands there twice, the order is that of the run
        assert e.dt == pytest.approx(DT, rel=5e-3)
        assert not any(bad_stamps(e.t, e.dt))
        off = [min(abs(s - own) for s in stamps[j]) for j, own in zip(k, e.t, strict=True) if j in stamps]
        assert max(off) <= at_most
        there = np.isin(k, log.k)
        assert np.abs(e["u"] - np.sin(0.05 * k))[there].max() < 1e-12
        assert np.abs(e["u"] - np.sin(0.05 * k)).max() < 1.5 * MEND
        assert np.abs(e["y"] - np.cos(0.031 * k) - 2.0).max() < 1.5 * MEND


@pytest.mark.parametrize("fault", FAULTS)
def test_one_fault_is_mended_and_told(fault):
    for seed in range(25):
        random = np.random.default_rng([seed, FAULTS.index(fault)])
        log = Log(1500)
        log.spoil(fault, random)
        check(log, 9 * DT if fault == "late" else 1.05 * log.digits + 1e-9)
        assert bool(read(log.columns).notes) == bool(any(bad_stamps(log.t, DT)))


def test_faults_in_threes_are_read_right_or_refused():
    faults = [own for own in FAULTS if own != "digits"]
    refused = 0
    for seed, three in enumerate(itertools.combinations(faults, 3)):
        random = np.random.default_rng([seed, 99])
        log = Log(3000)
        for fault in three:
            log.spoil(fault, random)
        try:
            read(log.columns)
        except InputError:
            refused += 1
            continue
        check(log, 9 * DT)
    assert refused <= 3


def columns(t: np.ndarray, k: np.ndarray) -> dict[str, np.ndarray]:
    return {"t [s]": t, "k": k.astype(float), "u": np.sin(0.01 * k)}


@pytest.mark.parametrize("phase", [0.0, 0.37])
@pytest.mark.parametrize(
    ("dt", "step", "span"),
    [
        (0.01, 1.0, 4),
        (0.01, 1.0, 20),
        (0.1, 1.0, 60),
        (0.01, 0.0156, 20),
        (0.00097, 0.001, 3),
        (0.0098, 0.01, 30),
    ],
)
def test_stamps_of_few_digits_give_the_sample_time_without_bias(dt, step, span, phase):
    k = np.arange(round(span / dt))
    (e,) = read(columns(np.floor((k * dt + phase * step) / step + 1e-9) * step, k))
    np.testing.assert_array_equal(e["k"], k)
    assert e.dt == pytest.approx(dt, rel=1.2 * dt / (span - 2.0 * step) + 1e-9)
    off = e.t - e.t[0] - k * dt
    assert np.ptp(off) <= step + dt


@pytest.mark.parametrize(("dt", "lost"), [(0.01, 20), (0.1, 3), (0.01, 120)])
def test_samples_lost_between_stamps_of_few_digits_are_not_closed_up(dt, lost):
    k = np.delete(np.arange(round(60.0 / dt)), slice(round(30.3 / dt), round(30.3 / dt) + lost))
    try:
        records = read(columns(np.floor(k * dt + 1e-9), k))
    except InputError as reason:
        said = str(reason)
    else:
        assert all((np.diff(e["k"]) == 1).all() for e in records)
        return
    assert "samples were lost" in said
    assert "delete" not in said


@pytest.mark.parametrize("samples", [200, 1000])
@pytest.mark.parametrize("wide", [0.5, 0.6, 0.7])
def test_samples_at_uneven_steps_are_not_made_even(wide, samples):
    for seed in range(20):
        t = np.cumsum(0.1 * np.random.default_rng(seed).uniform(1.0 - wide, 1.0 + wide, samples))
        with pytest.raises(InputError, match=r"uneven|gap|changes|vary"):
            read(columns(t, np.arange(samples)))


@pytest.mark.parametrize(("before", "after"), [(0.02, 0.005), (0.010, 0.014), (0.01, 0.0125)])
def test_a_sample_time_that_changes_is_refused_where_it_does(before, after):
    t = np.concatenate([[0.0], np.cumsum(np.r_[np.full(600, before), np.full(500, after)])])
    with pytest.raises(
        InputError, match=f"(?s)sample time changes: {before:g} s on the average before sample (5|6|7).*{after:g} s"
    ):
        read(columns(t, np.arange(len(t))))
    with pytest.raises(InputError, match=r"sample time changes|gap"):
        read(columns(np.delete(t, 300), np.delete(np.arange(len(t)), 300)))


def test_jitter_of_the_clock_is_no_change_of_the_sample_time():
    for seed in range(20):
        t = np.cumsum(0.01 * np.random.default_rng(seed).uniform(0.6, 1.4, 5000))
        assert len(read(columns(t, np.arange(5000)))) == 1


def test_nothing_is_filled_in_where_something_happened():
    k = np.delete(np.arange(1000), [500, 501])
    mode = np.where(k < 500, 1.0, 3.0)
    first, second = read(columns(k * 0.01, k) | {"mode": mode})
    assert (set(first["mode"]), set(second["mode"])) == ({1.0}, {3.0})
    (whole,) = read(columns(k * 0.01, k) | {"mode": np.ones(998)})
    assert len(whole) == 1000


def test_a_counter_that_wraps_is_refused_at_once():
    k = np.arange(100_000)
    with pytest.raises(InputError, match="time goes back"):
        read(columns(0.01 * (k % 256), k))


def test_what_is_filled_in_has_the_steps_of_the_sensor():
    k = np.delete(np.arange(2000), [500, 901, 902])
    (e,) = read(columns(k * 0.01, k) | {"y": np.round(3.0 * np.sin(0.013 * k), 2)})
    assert len(e) == 2000
    assert np.abs(e["y"] * 100 - np.rint(e["y"] * 100)).max() < 1e-9
    assert quantum(e["y"]) == pytest.approx(0.01)
