"""Experiments and datasets: pieces partition a record, decimation keeps what it has to, sets fit together."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from workbench.data import Channel, Dataset, Experiment, bad_stamps, check_held_out, segments
from workbench.errors import InputError
from workbench.records import RecordError


def make(name: str = "run", count: int = 20, dt: float = 0.1, **units: str) -> Experiment:
    k = np.arange(count, dtype=float)
    return Experiment.from_arrays(
        name,
        dt,
        inputs={"V1": k, "V2": -k},
        outputs={"w3": k**2},
        schedule={"r2": 0.1 + 0 * k},
        references={"w3_set": k},
        units=units,
    )


def test_from_arrays_gives_stamps_roles_and_units():
    record = make(V1="V")
    np.testing.assert_array_equal(record.t, np.arange(20) * 0.1)
    assert record.names == ("V1", "V2", "w3", "r2", "w3_set")
    assert record.names_of("input") == ("V1", "V2")
    assert record.names_of("reference") == ("w3_set",)
    assert (str(record.channel("V1")), str(record.channel("V2"))) == ("V1 [V]", "V2")
    np.testing.assert_array_equal(record[["w3", "V2"]], np.column_stack([np.arange(20.0) ** 2, -np.arange(20.0)]))
    assert record[[]].shape == (20, 0)


def test_arrays_that_do_not_fit_are_refused_with_the_channel():
    with pytest.raises(InputError, match=r"run, channel y: shape \(4,\), expected \(5,\) as in u"):
        Experiment.from_arrays("run", 1.0, inputs={"u": np.ones(5)}, outputs={"y": np.ones(4)})
    with pytest.raises(InputError, match="channel y: sample 2 is nan"):
        Experiment.from_arrays("run", 1.0, outputs={"y": np.array([0, math.nan])})
    with pytest.raises(InputError, match="channel y: sample 2 is inf"):
        Experiment("run", np.arange(2.0), (Channel("y"),), np.array([[0], [math.inf]]), 1.0)
    with pytest.raises(InputError, match="channel y: appears twice"):
        Experiment.from_arrays("run", 1.0, inputs={"y": np.ones(5)}, outputs={"y": np.ones(5)})
    with pytest.raises(InputError, match="did you mean 'speed'"):
        Experiment.from_arrays("run", 1.0, outputs={"speed": np.ones(5)}, units={"sped": "V"})
    with pytest.raises(InputError, match="no channels"):
        Experiment.from_arrays("run", 1.0)
    with pytest.raises(RecordError, match="dt"):
        make(dt=0.0)


def test_roles_named_are_theirs_alone_and_others_stay():
    record = make().with_roles(inputs=["V2"], schedule=["w3"])
    assert record.names_of("input") == ("V2",)
    assert record.names_of("schedule") == ("w3",)
    assert record.names_of("output") == ()
    assert record.names_of("reference") == ("w3_set",)
    assert record.names_of("other") == ("V1", "r2")
    with pytest.raises(InputError, match="did you mean 'w3'"):
        make().with_roles(outputs=["w33"])
    with pytest.raises(InputError, match="named as input and as output"):
        make().with_roles(inputs=["w3"], outputs=["w3"])


@pytest.mark.slow
@given(st.integers(3, 60), st.sampled_from([0.1, 0.007, 1 / 3, 1e-3]), st.data())
def test_neighbouring_pieces_partition_a_record(count, dt, data):
    record = make(count=count, dt=dt)
    cut = data.draw(st.integers(1, count - 1))
    # both k dt and the sum of k steps of dt name sample k, whatever the rounding
    time = data.draw(st.sampled_from([cut * dt, float(np.sum(np.full(cut, dt)))]))
    before, after = record.split(time)
    assert len(before) == cut
    np.testing.assert_array_equal(np.concatenate([before.values, after.values]), record.values)
    np.testing.assert_array_equal(np.concatenate([before.t, after.t]), record.t)
    assert before.name != after.name


def test_trim_keeps_the_stamps_and_refuses_to_leave_nothing():
    piece = make().trim(0.5, 1.0)
    np.testing.assert_allclose(piece.t, [0.5, 0.6, 0.7, 0.8, 0.9])
    np.testing.assert_array_equal(piece["V1"], [5, 6, 7, 8, 9])
    with pytest.raises(InputError, match=r"runs from 0 s to 1\.9 s"):
        make().trim(3.0)


@pytest.mark.slow
@given(st.lists(st.booleans(), min_size=2, max_size=30), st.sets(st.integers(1, 29)))
def test_segments_are_the_runs_of_the_mask_and_never_join_across_a_gap(mask, gaps):
    count = len(mask)
    step = np.array([5.0 if k in gaps else 1.0 for k in range(1, count)])
    t = np.concatenate([[0.0], np.cumsum(step)])
    record = Experiment("run", t, (Channel("k"),), np.arange(count, dtype=float)[:, None], 1.0)
    pieces = segments(record, np.array(mask), shortest=1)
    found = [int(k) for piece in pieces for k in piece["k"]]
    assert found == [k for k in range(count) if mask[k]]
    for piece in pieces:
        assert np.all(np.diff(piece.t) == 1.0)
    for left, right in pairwise(pieces):  # as few pieces as can be
        k = int(right["k"][0])
        assert left["k"][-1] != k - 1 or k in gaps


def test_segments_refuse_a_mask_of_another_length_and_drop_short_pieces():
    with pytest.raises(InputError, match=r"expected \(20,\)"):
        segments(make(), np.ones(5, bool))
    mask = np.ones(20, bool)
    mask[1] = False
    assert [len(piece) for piece in segments(make(), mask)] == [18]


# ---- resampling ------------------------------------------------------------------------------------------------------


def fine(count: int, dt: float, u: np.ndarray, y: np.ndarray) -> Experiment:
    assert len(u) == len(y) == count
    return Experiment.from_arrays("run", dt, inputs={"u": u}, outputs={"y": y})


@pytest.mark.parametrize("q", [2, 5, 10])
def test_decimation_keeps_straight_lines_and_slow_sines_and_removes_fast_ones(q):
    count, dt = 2000, 0.01
    t = np.arange(count) * dt
    nyquist = 0.5 / (q * dt)
    line, slow, fast = 7.0 - 3.0 * t, np.sin(2 * np.pi * 0.3 * nyquist * t), np.sin(2 * np.pi * 1.5 * nyquist * t)
    coarse = fine(count, dt, 0 * t, line).resample(q * dt)
    assert coarse.dt == pytest.approx(q * dt)
    np.testing.assert_allclose(coarse["y"], 7.0 - 3.0 * coarse.t, atol=1e-9)  # no droop at the ends, no delay
    inner = slice(15, -15)
    kept = fine(count, dt, 0 * t, slow).resample(q * dt)
    np.testing.assert_allclose(kept["y"][inner], slow[::q][: len(kept)][inner], atol=5e-3)
    removed = fine(count, dt, 0 * t, fast).resample(q * dt)
    assert np.abs(removed["y"][inner]).max() < 5e-3


def test_inputs_keep_their_integral_so_an_integrator_stays_an_integrator():
    # y' = u, u held: y[k+1] - y[k] = dt u[k] at any sample time, where y itself is not filtered
    rng = np.random.default_rng(3)
    count, dt, q = 400, 0.1, 4
    u = rng.standard_normal(count)
    y = np.concatenate([[0.0], np.cumsum(dt * u)[:-1]])
    coarse = fine(count, dt, u, y).resample(q * dt)
    np.testing.assert_allclose(np.diff(y[::q]), coarse.dt * coarse["u"][:-1], atol=1e-12)


def test_an_input_held_over_the_new_sample_time_passes_unchanged():
    levels = np.random.default_rng(4).choice([-1.0, 1.0], 50)
    u = np.repeat(levels, 5)
    coarse = fine(250, 0.1, u, u).resample(0.5)
    np.testing.assert_array_equal(coarse["u"], levels)


def test_resampling_that_would_invent_samples_is_refused_unless_asked_for():
    record = make()
    for dt in (0.05, 0.25):
        with pytest.raises(InputError, match="expected a whole number"):
            record.resample(dt)
    with pytest.raises(InputError, match="too few"):
        record.resample(2.0)
    assert record.resample(0.1) is record
    asked = record.resample(0.05, interpolate=True)
    np.testing.assert_allclose(asked["w3"][:5], [0, 0.5, 1, 2.5, 4], atol=1e-9)  # linear between squares
    np.testing.assert_array_equal(asked["V1"][:5], [0, 0, 1, 1, 2])  # held
    assert len(asked) == 39


def test_interpolation_makes_jittered_stamps_uniform_and_no_resampling_crosses_a_gap():
    t = np.array([0, 1.2, 1.9, 3.1, 4.0])
    jittered = Experiment("run", t, (Channel("y", "", "output"),), (2 * t)[:, None], 1.0)
    even = jittered.resample(1.0, interpolate=True)
    np.testing.assert_allclose(even["y"], [0, 2, 4, 6, 8], atol=1e-12)
    broken = Experiment("run", t + 9 * (t > 2), (Channel("y"),), t[:, None], 1.0)
    for interpolate in (False, True):
        with pytest.raises(InputError, match="gap between"):
            broken.resample(2.0, interpolate=interpolate)


def test_faults_of_the_stamps_are_told_apart_in_order():
    faults = list(bad_stamps(np.array([0, 1, 1, 2, 5, 4, 5.4]), 1.0))
    assert [(bad.fault, bad.index) for bad in faults] == [("repeated", 2), ("gap", 4), ("backwards", 5)]


# ---- sets ------------------------------------------------------------------------------------------------------------


def test_records_that_do_not_fit_are_refused_with_both_names():
    with pytest.raises(InputError, match="a and b: sample times"):
        Dataset((make("a"), make("b", dt=0.2)))
    with pytest.raises(InputError, match="a and b, channel V2: not in b"):
        Dataset((make("a"), make("b").select(["V1", "w3", "r2", "w3_set"])))
    with pytest.raises(InputError, match="a and b, channel w3: units rpm and rad/s"):
        Dataset((make("a", w3="rpm"), make("b", w3="rad/s")))
    with pytest.raises(InputError, match="a and b, channel w3: is output in one"):
        Dataset((make("a"), make("b").with_roles(inputs=["V1", "V2", "w3"])))
    Dataset((make("a", w3="rpm"), make("b", 21, dt=0.1 * (1 + 1e-6))))  # a missing unit and a rounded sample time fit


def test_a_set_has_records_names_and_a_sample_time():
    records = Dataset((make("a"), make("b", count=7)))
    assert (len(records), records.names, records.dt) == (2, ("a", "b"), 0.1)
    assert [len(record) for record in records] == [20, 7]
    assert [r.names_of("output") for r in records.with_roles(outputs=["V1"])] == [("V1",), ("V1",)]


def test_records_are_split_by_name_into_two_sets():
    records = Dataset((make("a", 20), make("b", 21), make("c", 22)))
    chosen, rest = records.split_records(["c", "a"])
    assert (chosen.names, rest.names) == (("a", "c"), ("b",))
    for names in ([], ["a", "b", "c"]):
        with pytest.raises(InputError, match="some of, but not all of"):
            records.split_records(names)
    with pytest.raises(InputError, match="unknown record 'd'"):
        records.split_records(["d"])


def test_one_measurement_under_two_names_is_found_out():
    with pytest.raises(InputError, match="same samples as 'a'"):
        Dataset((make("a"), make("copy")))
    with pytest.raises(InputError, match="same samples as estimation record 'a'"):
        check_held_out(Dataset((make("a"), make("b", 30))), Dataset((make("copy").with_roles(inputs=["V2"]),)))
    with pytest.raises(InputError, match="unit"):
        check_held_out(Dataset((make("a", w3="rad/s"),)), Dataset((make("b", 30, w3="rpm"),)))
    check_held_out(Dataset((make("a"),)), Dataset((make("b", 30),)))


def test_a_record_has_time_stamps_or_a_sample_time_and_finds_the_other():
    t, u = 3.0 + 0.02 * np.arange(50), np.ones(50)
    stamped, sampled = Experiment.from_arrays("run", t=t, inputs={"u": u}), Experiment.from_arrays("run", 0.02, inputs={"u": u})
    assert stamped.dt == pytest.approx(0.02, rel=1e-12)
    assert np.array_equal(stamped.t, t)
    assert np.allclose(sampled.t, t - 3.0)
    gap = np.delete(t, [20, 21])  # a step is the typical one
    assert Experiment("run", gap, stamped.channels, np.ones((48, 1))).dt == pytest.approx(0.02, rel=1e-12)
    for both, problem in ({"dt": 0.02, "t": t}, "both dt and t"), ({}, "neither dt nor t"), ({"t": t[1:]}, "expected"):
        with pytest.raises(InputError, match=problem):
            Experiment.from_arrays("run", **both, inputs={"u": u})
    rounded = np.round(np.arange(3000) / 60.0, 3)  # a logger that writes milliseconds
    gaps = np.delete(rounded, np.arange(100, 700))
    for stamps in (rounded, gaps):
        assert Experiment("run", stamps, stamped.channels, np.ones((len(stamps), 1))).dt == pytest.approx(1 / 60, rel=1e-4)
    with pytest.raises(InputError, match="seconds as numbers"):
        Experiment.from_arrays("run", t=np.array(["2024-01-01", "2024-01-02"], "datetime64[ns]"), inputs={"u": np.ones(2)})
    for stamps in (np.zeros(1), np.zeros(50), t[::-1], np.append(t, np.inf)):
        with pytest.raises(InputError, match="no step"):
            Experiment("run", stamps, stamped.channels, np.ones((len(stamps), 1)))
