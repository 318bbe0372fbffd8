"""Records from files, data frames and mappings are the same records; what is wrong with one is told by its name and channel."""

import numpy as np
import pandas as pd
import pytest

import workbench as wb
from workbench.data import Experiment
from workbench.errors import InputError

T = 0.05 * np.arange(40)
U, Y = np.sign(np.sin(T)), np.cumsum(np.sin(T))
COLUMNS = {"t [s]": T, "u [V]": U, "y [rad]": Y, "r2 [m]": 0.1 + T}


@pytest.fixture
def file(tmp_path):
    e = Experiment.from_arrays("run", 0.05, other={"u": U, "y": Y, "r2": 0.1 + T}, units={"u": "V", "y": "rad", "r2": "m"})
    return wb.write_csv(e, tmp_path / "run.csv")


@pytest.mark.parametrize(
    "source",
    [
        COLUMNS,
        {k: list(v) for k, v in COLUMNS.items()},
        pd.DataFrame(COLUMNS),
        pd.DataFrame({k: v for k, v in COLUMNS.items() if k != "t [s]"}, index=pd.to_timedelta(T, unit="s")),
        pd.DataFrame(
            {k: v for k, v in COLUMNS.items() if k != "t [s]"}, index=pd.Timestamp("2026-02-03 10:00") + pd.to_timedelta(T, "s")
        ),
    ],
    ids=["arrays", "lists", "frame", "durations", "dates"],
)
def test_a_frame_and_a_mapping_are_the_record_that_their_file_is(file, source):
    roles = {"inputs": "u", "outputs": ["y"], "schedule": "r2"}
    (one,), (other,) = wb.read(file, **roles), wb.read(source, **roles)
    assert [(c.name, c.unit, c.role) for c in one.channels] == [(c.name, c.unit, c.role) for c in other.channels]
    assert one.dt == pytest.approx(other.dt, rel=1e-9)
    np.testing.assert_allclose(other.t, one.t, atol=1e-12)
    np.testing.assert_array_equal(other.values, one.values)
    assert (one.name, other.name) == ("run", "record 1")


def test_sources_of_several_kinds_are_one_set_in_their_order(file):
    again = wb.read(file, outputs="y").experiments[0]
    longer = {name: 1.5 * np.append(values, values[-1] + 0.05) for name, values in COLUMNS.items()}
    records = wb.read(longer | {"t": longer.pop("t [s]") / 1.5}, file, again.trim(stop=1.0), inputs="u", outputs="y")
    assert [len(e) for e in records] == [41, 40, 20]
    assert all(e.names_of("input") == ("u",) for e in records)


def test_a_sample_time_stands_for_a_column_of_time():
    (e,) = wb.read({"u": U, "y": Y}, inputs="u", outputs="y", dt=0.05)
    np.testing.assert_allclose(e.t, T)
    assert e.dt == 0.05


def test_a_sample_time_stands_for_the_stamps_of_a_file_too(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("u;y\n" + "".join(f"{k};{2 * k}\n" for k in range(40)))
    (e,) = wb.read(path, dt=0.05)
    np.testing.assert_allclose(e.t, 0.05 * np.arange(40), atol=1e-12)
    assert e.names == ("u", "y")
    assert "a sample every 0.05 s, as asked" in e.notes[0]
    path.write_text("Sample;u\n" + "".join(f"{k + 7};{k}\n" for k in range(100) if k not in range(50, 60)))
    first, second = wb.read(path, dt=0.05)
    assert (len(first), len(second), first.names) == (50, 40, ("u",))
    assert second.t[0] - first.t[0] == pytest.approx(60 * 0.05)
    path.write_text("u;y\n1;2\n2;3\n3;4\n")
    with pytest.raises(InputError, match="no time column among u, y"):
        wb.read(path)


def test_a_sample_time_that_is_not_that_of_the_stamps_is_refused(file):
    assert wb.read(file, dt=0.05).dt == pytest.approx(0.05)
    with pytest.raises(InputError, match=r"has its own time, a sample every 0\.05 s, and 0\.1 s was given"):
        wb.read(file, dt=0.1)


@pytest.mark.parametrize(
    ("source", "options", "said"),
    [
        ({"u": U, "y": Y}, {}, "record 1: has neither a time column nor a sample time"),
        (COLUMNS, {"dt": 0.05}, "record 1: has its own time, and a sample time was given"),
        (COLUMNS | {"y [rad]": Y[:-3]}, {}, "record 1, channel y: 37 samples, expected 40"),
        (COLUMNS | {"y [rad]": ["low"] * 40}, {}, "record 1, channel y: holds something that is no number"),
        (COLUMNS | {"y [rad]": np.column_stack([Y, Y])}, {}, r"record 1, channel y: shape \(40, 2\)"),
        (COLUMNS | {"y [rad]": np.where(T[7] == T, np.nan, Y)}, {}, "record 1, channel y: sample 8 is nan"),
        (COLUMNS | {"Zeit": T}, {}, "two time columns"),
        ({"t [ms]": T, "u": U}, {}, "record 1, channel t: time is in ms"),
        (COLUMNS | {"y [deg]": Y}, {}, "record 1, channel y: appears twice"),
        (COLUMNS | {"a,b": Y}, {}, "'a,b' is no channel name"),
        ({"t": T}, {}, "no channels"),
        ({}, {"dt": 0.1}, "no channels"),
        (np.zeros((40, 3)), {}, "a ndarray is no source of a record"),
        ({k: v[::-1] if k == "t [s]" else v for k, v in COLUMNS.items()}, {}, "record 1, channel t: .*time goes back"),
        ({k: v[:2] for k, v in COLUMNS.items()}, {}, "2 samples are no record"),
        (COLUMNS, {"inputs": "uu"}, "uu"),
    ],
)
def test_what_is_wrong_with_a_source_is_told(source, options, said):
    with pytest.raises(InputError, match=said):
        wb.read(source, **options)


def test_a_file_has_its_own_time(file):
    with pytest.raises(InputError, match="has its own time"):
        wb.read(file, dt=0.1)
