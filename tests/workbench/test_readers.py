"""Readers: what is written comes back bit for bit, and every kind of bad file has its own message and mend."""

import math
import re
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.io import savemat

from workbench.data import Channel, Experiment
from workbench.errors import InputError
from workbench.readers import LAYOUTS, read_file, write_csv
from workbench.sources import read
from workbench.units import UNITS, check_units

DATA = Path(__file__).resolve().parents[2].parent / "shared" / "data"

HEADER = "t [s],V1 [V],w3 [rad/s],theta [deg],r2 [m],w3_set [rad/s]"


def rows(count: int, step: float = 0.1) -> list[str]:
    return [f"{k * step:.10g},{k % 2},{k * 0.5},{-k},{0.1 + k * 1e-3},10" for k in range(count)]


def put(folder: Path, text: str | bytes, name: str = "run.csv") -> Path:
    path = folder / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def refusal(path: Path) -> InputError:
    with pytest.raises(InputError) as caught:
        read_file(path)
    assert caught.value.file == path
    assert caught.value.mend
    return caught.value


# ---- good files ------------------------------------------------------------------------------------------------------


def test_a_file_of_the_contract_gives_names_units_roles_and_sample_time(tmp_path):
    record = read_file(put(tmp_path, "\n".join([HEADER, *rows(20)])))
    assert record.name == "run"
    assert record.names == ("V1", "w3", "theta", "r2", "w3_set")
    assert [c.unit for c in record.channels] == ["V", "rad/s", "deg", "m", "rad/s"]
    assert [c.role for c in record.channels] == ["input", "output", "output", "schedule", "reference"]
    assert record.dt == 0.1
    np.testing.assert_array_equal(record["theta"], -np.arange(20.0))


@pytest.mark.parametrize("delimiter", [",", ";", "\t", " ; "])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("start", ["", "\ufeff"])
def test_delimiters_line_ends_marks_and_blank_lines_do_not_change_the_numbers(tmp_path, delimiter, end, start):
    text = start + end + end.join([HEADER, "", *rows(9), "", ""]).replace(",", delimiter)
    blanks = put(tmp_path, text + "  " + end, "blanks.txt")  # a line that is not empty
    np.testing.assert_array_equal(read_file(blanks).values, read_file(put(tmp_path, text, "run.txt")).values)
    record = read_file(put(tmp_path, text, "run.txt"))
    np.testing.assert_array_equal(record["w3"], 0.5 * np.arange(9))
    np.testing.assert_array_equal(record["V1"], np.arange(9) % 2)
    assert record.names[0] == "V1"


def test_the_time_column_may_stand_anywhere_and_other_columns_keep_their_order(tmp_path):
    record = read_file(put(tmp_path, "y,time [s],u\n1,0,4\n2,1,5\n3,2,6\n"))
    assert record.names == ("y", "u")
    np.testing.assert_array_equal(record.values, [[1, 4], [2, 5], [3, 6]])


def test_a_name_may_hold_a_number(tmp_path):
    assert read_file(put(tmp_path, "t,y 1,2 u\n0,4,1\n1,5,2\n2,6,3\n")).names == ("y 1", "2 u")


def test_options_win_over_names(tmp_path):
    path = put(tmp_path, "\n".join([HEADER, *rows(9)]))
    record = read_file(path, inputs=["theta"], outputs=["V1"])
    assert record.names_of("input") == ("theta",)
    assert record.names_of("output") == ("V1",)
    assert record.names_of("schedule") == ("r2",)
    with pytest.raises(InputError, match="did you mean 'theta'"):
        read_file(path, inputs=["teta"])


finite = st.floats(allow_nan=False, allow_infinity=False)


@pytest.mark.slow
@given(st.lists(st.tuples(finite, finite), min_size=3, max_size=8), st.sampled_from([0.1, 1e-3, 1 / 3, 0.007]))
def test_writing_and_reading_is_exact_bit_for_bit(tmp_path_factory, pairs, dt):
    columns = np.array(pairs)
    made = Experiment.from_arrays("run", dt, inputs={"u": columns[:, 0]}, outputs={"y 1": columns[:, 1]}, units={"u": "V"})
    path = write_csv(made, tmp_path_factory.mktemp("csv") / "run.csv")
    back = read_file(path)
    np.testing.assert_array_equal(back.values, made.values)
    np.testing.assert_array_equal(np.signbit(back.values), np.signbit(made.values))
    np.testing.assert_array_equal(back.t, made.t)
    assert math.isclose(back.dt, dt, rel_tol=1e-11)
    assert [str(c) for c in back.channels] == ["u [V]", "y 1"]


@pytest.mark.parametrize("name", ["a,b", "a;b", "a[b", 'a"b', "a\nb", "t", "3.5", ""])
def test_a_name_that_a_header_cannot_hold_is_not_written(tmp_path, name):
    record = Experiment("run", np.arange(3.0), (Channel(name),), np.zeros((3, 1)), 1.0)
    with pytest.raises(InputError):
        write_csv(record, tmp_path / "run.csv")
    assert not list(tmp_path.iterdir())


def test_stamps_rounded_by_the_logger_do_not_bias_the_sample_time(tmp_path):
    # 30 Hz in milliseconds: every single step is 33 or 34 ms, up to 2 % off
    text = "t,y\n" + "".join(f"{k / 30:.3f},{k}\n" for k in range(3001))
    assert read_file(put(tmp_path, text)).dt == pytest.approx(1 / 30, rel=1e-5)


@pytest.mark.slow
def test_a_large_file_reads_fast(tmp_path):
    count = 100_000
    block = np.random.default_rng(1).standard_normal((count, 4))
    record = Experiment.from_arrays("big", 0.01, outputs={f"y{k}": block[:, k] for k in range(4)})
    path = write_csv(record, tmp_path / "big.csv")
    start = time.perf_counter()
    read_file(path)
    assert time.perf_counter() - start < 2.0  # 0.2 s here; a Python loop over the cells takes longer than 2 s


def test_a_german_sheet_is_read_as_it_is(tmp_path):
    text = "Zeit (s);Drehzahl (1/min);Weg [mm]\r\n0;-1,5;1e-3\r\n0,005;1000;,5\r\n0,01;2,25;-0,125\r\n"
    record = read_file(put(tmp_path, text))
    assert list(map(str, record.channels)) == ["Drehzahl [1/min]", "Weg [mm]"]
    assert record.dt == 0.005
    np.testing.assert_array_equal(record.values, [[-1.5, 1e-3], [1000.0, 0.5], [2.25, -0.125]])


# ---- bad files -------------------------------------------------------------------------------------------------------

# what the file holds, then the line, the channel and words of the problem and of the mend that must be named
BAD_LINES = {
    "nan": (5, "0.3,1,nan,0,0.1,10", "w3", "nan is not finite", "repair"),
    "inf": (5, "0.3,1,0,-inf,0.1,10", "theta", "-inf is not finite", "repair"),
    "empty cell": (5, "0.3,1,0,,0.1,10", "theta", "empty cell", "repair"),
    "text": (5, "0.3,1,0,0,off,10", "r2", "text 'off'", "plain number"),
    "underscore": (5, "0.3,1_0,0,0,1,10", "V1", "text '1_0'", "plain number"),
    "two points": (5, "0.3,1,0,0,1.2.3,10", "r2", "text '1.2.3'", "plain number"),
    "cut off": (5, "0.3,1,0", "theta", "3 cells, expected 6", "cut off"),
    "trailing delimiter": (5, "0.3,1,0,0,0.1,10,", None, "7 cells, expected 6", "off the end"),
    "too many cells": (5, "0.3,1,0,0,0.1,10,7", None, "7 cells, expected 6", "one cell for each name"),
    "decimal commas": (5, "0,3,1,0,0,0,0,0,1,10,0", None, "11 cells, expected 6", "decimal commas"),
    "repeated": (5, "0.2,1,0,0,0.1,10", "t", "0.2 s is repeated", "logged twice"),
    "backwards": (5, "0.05,1,0,0,0.1,10", "t", "goes back from 0.2 s to 0.05 s", "two runs in one file"),
    "gap": (5, "0.56,1,0,0,0.1,10", "t", "gap of 0.36 s before t = 0.56 s", "into two files: what comes before line 5,"),
}


@pytest.mark.parametrize("kind", BAD_LINES)
def test_a_bad_line_is_named_with_its_channel_and_its_mend(tmp_path, kind):
    line, text, channel, problem, mend = BAD_LINES[kind]
    lines = [HEADER, *rows(12)]
    lines[line - 1] = text
    error = refusal(put(tmp_path, "\n".join(lines)))
    assert (error.line, error.channel) == (line, channel)
    assert problem in error.problem
    assert mend in error.mend


def test_blank_lines_do_not_shift_the_line_that_is_named(tmp_path):
    lines = ["", HEADER, *rows(4), "", "", "0.9,1,0,0,0.1,10", *rows(0)]
    assert refusal(put(tmp_path, "\n".join(lines))).line == 9
    lines[8] = "0.4,1,nan,0,0.1,10"
    assert refusal(put(tmp_path, "\n".join(lines))).line == 9


def test_a_comma_that_may_mark_thousands_is_asked_about_and_decimals_are_not(tmp_path):
    error = refusal(put(tmp_path, "t;u;v\n0;1,234;5,6\n1;999;5,5\n2;1,002;5,4\n3;998;5,5\n"))
    assert (error.line, error.channel) == (2, "u")
    assert "'1,234' beside numbers without a comma" in error.problem
    assert "1.234 if it is decimal, 1234 if not" in error.mend
    found = read_file(put(tmp_path, "t;u;v\n0;1,234;0,125\n1;2,5;1\n2;3;0,625\n3;1,5;0\n"))
    np.testing.assert_array_equal(found["u"], [1.234, 2.5, 3.0, 1.5])
    np.testing.assert_array_equal(found["v"], [0.125, 1.0, 0.625, 0.0])


def test_a_record_of_uneven_steps_is_not_to_be_cut_at_each_of_them(tmp_path):
    """The logger had no clock of its own: every third sample comes late."""
    t = np.cumsum(np.where(np.arange(60) % 3 == 0, 0.02, 0.01))
    error = refusal(put(tmp_path, "\n".join(["t,y", *(f"{at:.3f},{k}" for k, at in enumerate(t))])))
    assert "gap of 0.02 s before t = 0.06 s, expected steps of 0.01 s, and 18 more such gaps" in error.problem
    assert "uneven steps? Write it anew every 0.01 s, interpolated" in error.mend


def test_a_truncated_last_line_is_left_out_and_another_one_named(tmp_path):
    lines = [HEADER, *rows(12)]
    record = read_file(put(tmp_path, "\n".join(lines)[:-8]))
    assert (len(record), record.notes) == (11, ("line 13, the last one, is cut off and left out",))
    lines[7] = lines[7][:-8]
    error = refusal(put(tmp_path, "\n".join(lines)))
    assert error.line == 8
    assert "cut off" in error.mend


@pytest.mark.parametrize("delimiter", [";", "\t"])
def test_decimal_commas_are_read_and_what_may_be_thousands_is_asked(tmp_path, delimiter):
    found = read_file(put(tmp_path, "t\ty\n0,0\t1,5\n0,1\t1,6\n0,2\t1,723\n".replace("\t", delimiter)))
    np.testing.assert_array_equal(found["y"], [1.5, 1.6, 1.723])
    error = refusal(put(tmp_path, "t\ty\n0\t1,500\n1\t1,600\n2\t1,723\n".replace("\t", delimiter)))
    assert (error.line, error.channel) == (2, "y")
    assert "a decimal comma, or a mark of thousands?" in error.problem


def test_a_point_among_decimal_commas_is_no_number(tmp_path):
    for text in ("1.234", "1.234,5", "1_0"):
        error = refusal(put(tmp_path, f"t;y\n0;{text}\n0,1;1,6\n0,2;1,7\n"))
        assert (error.line, error.channel) == (2, "y")
    assert "a point in '1.234'" in refusal(put(tmp_path, "t;y\n0;1,5\n0,1;1.234\n0,2;1,7\n")).problem
    assert "nan is not finite" in refusal(put(tmp_path, "t;y\n0;1,5\n0,1;nan\n0,2;1,7\n")).problem
    assert "3 cells, expected 2" in refusal(put(tmp_path, "t;y\n0;1,5\n0,1;2;3\n0,2;1,7\n")).problem
    assert refusal(put(tmp_path, "t;y\n0;1,5\n0,1;\xb5\n0,2;1,7\n".encode("latin-1"))).line == 3


BAD_FILES = {
    "no header": ("0,1,2\n1,2,3\n2,3,4\n", 1, "no header", "t [s]"),
    "duplicate": ("t,y,y\n0,1,2\n1,2,3\n2,3,4\n", 1, "appears 2 times", "own name"),
    "no name": ("t,y,\n0,1,2\n", 1, "column 3 has no name", "delimiter at the end"),
    "an index": ("t,y(1)\n0,1\n", 1, "'y(1)' is no channel name", "in brackets"),
    "no time": ("a,y\n0,1\n1,2\n2,3\n", 1, "no time column among a, y", "t [s]"),
    "time alone": ("t\n0\n1\n2\n", 1, "the only one", "comma, semicolon or tab"),
    "two times": ("t,time\n0,0\n1,1\n2,2\n", 1, "two time columns", "keep one"),
    "days": ("t [d],y\n0,1\n10,2\n20,3\n", 1, "time is in d", "convert the column"),
    "stamps": ("Timestamp,y\n0,1\n10,2\n20,3\n", 1, "is it in s, or in ms?", "Timestamp [ms]"),
    "empty": ("", 1, "is empty", "header"),
    "blank": ("\n \n\n", 1, "is empty", "header"),
    "header only": ("t,y\n", 1, "0 samples", "whole"),
    "too short": ("t,y\n0,1\n1,2\n", 1, "2 samples", "whole"),
    "binary": (b"\x00\x01\x02\xff" * 50, None, "binary", "text"),
    "a sheet": (b"PK\x03\x04\x00\x00" * 50, None, "binary", "export the sheet as CSV"),
    "UTF-16": ("t,y\n0,1\n".encode("utf-16"), 1, "UTF-16", "UTF-8"),
    "Latin-1": ("t,y,\xb5\n0,1,2\n".encode("latin-1"), 1, "0xB5 is not UTF-8", "UTF-8"),
    "Latin-1 below": ("t,y\n0,1\n1,\xb5\n2,3\n".encode("latin-1"), 3, "0xB5 is not UTF-8", "UTF-8"),
}


@pytest.mark.parametrize("kind", BAD_FILES)
def test_a_bad_file_is_refused_with_its_own_message(tmp_path, kind):
    content, line, problem, mend = BAD_FILES[kind]
    error = refusal(put(tmp_path, content))
    assert error.line == line
    assert problem in error.problem
    assert mend in error.mend


def test_missing_file_folder_and_unknown_type_are_told_apart(tmp_path):
    put(tmp_path, "t,y\n", "prbs1.csv")
    missing = refusal(tmp_path / "prbs2.csv")
    assert "no such file" in missing.problem
    assert "prbs1.csv" in missing.mend
    assert "is a folder" in refusal(tmp_path).problem
    assert "'.xls'" in refusal(put(tmp_path, "t,y\n", "a.xls")).problem


def test_no_two_kinds_of_bad_file_share_a_message(tmp_path):
    problems = [refusal(put(tmp_path, BAD_FILES[kind][0])).problem for kind in BAD_FILES]
    told_apart = set(problems)
    # an empty and a blank file, both binary files and both Latin-1 files are the same fault, and so is too short
    assert len(told_apart) == len(BAD_FILES) - 3


# ---- MAT -------------------------------------------------------------------------------------------------------------


def test_mat_vectors_become_channels_and_a_matrix_one_channel_for_each_column(tmp_path):
    t = np.arange(5) * 0.5
    u, y = np.arange(10.0).reshape(5, 2), np.arange(5, dtype=np.int16)
    savemat(tmp_path / "a.mat", {"t": t, "u": u, "y": y, "gain": 3.0, "taps": np.ones(4), "note": "text"})
    record = read_file(tmp_path / "a.mat")
    assert record.names == ("u1", "u2", "y")
    assert record.names_of("input") == ("u1", "u2")
    np.testing.assert_array_equal(record[["u1", "u2"]], u)
    np.testing.assert_array_equal(record["y"], y)
    assert record.dt == 0.5


def test_mat_without_stamps_takes_the_sample_time(tmp_path):
    savemat(tmp_path / "a.mat", {"Ts": 0.25, "u": np.arange(6.0), "y": np.arange(6.0), "taps": np.ones(4)})
    record = read_file(tmp_path / "a.mat")
    assert record.dt == 0.25
    np.testing.assert_array_equal(record.t, 0.25 * np.arange(6))


def test_emps_layout_gives_force_position_and_set_point(tmp_path):
    count = 6
    content = {"t": np.arange(count) * 1e-3, "vir": np.arange(count), "gtau": 35.0, "qm": np.ones(count)}
    savemat(tmp_path / "axis.mat", {**content, "qg": np.full(count, 2.0), "kp": 160.0})
    record = read_file(tmp_path / "axis.mat")
    assert [(str(c), c.role) for c in record.channels] == [
        ("F [N]", "input"),
        ("q [m]", "output"),
        ("q_set [m]", "reference"),
    ]
    np.testing.assert_allclose(record["F"], 35.0 * np.arange(count), rtol=1e-15)
    np.testing.assert_array_equal(record["q_set"], 2.0)


def test_layouts_name_their_channels_once():
    for layout in LAYOUTS.values():
        names = [column.channel.name for column in layout.columns]
        assert len(set(names)) == len(names)


def mat(folder: Path, **content) -> Path:
    savemat(folder / "a.mat", content)
    return folder / "a.mat"


def test_a_mat_file_without_time_or_cut_off_is_refused(tmp_path):
    whole = mat(tmp_path, y=np.random.default_rng(1).standard_normal(5))
    assert "no time vector; numeric variables: y" in refusal(whole).problem
    problem = refusal(put(tmp_path, whole.read_bytes()[:200], "b.mat")).problem
    assert re.fullmatch(r"cannot be read as a MAT file \(.*\w.*\)", problem), problem  # with what its reader said


@pytest.mark.slow
def test_bad_mat_files_are_told_apart(tmp_path):
    ramp = np.arange(5.0)
    assert "no variable has the 5 samples" in refusal(mat(tmp_path, t=ramp, y=np.ones(4))).problem
    broken = refusal(mat(tmp_path, t=ramp, y=[0, 1, math.nan, 3, 4]))
    assert (broken.channel, "sample 3 is nan" in broken.problem) == ("y", True)
    gap = refusal(mat(tmp_path, t=[0, 1, 2, 5, 6, 7], y=np.ones(6)))
    assert "sample 4: gap" in gap.problem
    assert "into two files: what comes before sample 4," in gap.mend
    assert "cannot be read as a MAT file" in refusal(put(tmp_path, "t,y\n" * 99, "a.mat")).problem
    new = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512) + b"\x89HDF\r\n\x1a\n"
    error = refusal(put(tmp_path, new, "a.mat"))
    assert "cannot be read as a MAT file (OSError)" in error.problem
    assert "-v7" in error.mend
    layout = mat(tmp_path, t=ramp, vir=ramp, gtau=1.0, qm=np.ones(4), qg=ramp)
    assert "4 samples of qm, expected 5" in refusal(layout).problem


@pytest.mark.skipif(not (DATA / "emps").is_dir(), reason="measured data not here: expected ../shared/data/emps")
def test_both_emps_files_load_as_one_set():
    records = read(DATA / "emps" / "DATA_EMPS.mat", DATA / "emps" / "DATA_EMPS_PULSES.mat")
    assert [len(record) for record in records] == [24841, 24841]
    assert records.dt == pytest.approx(1e-3, rel=1e-6)
    for record in records:
        # the drive saturates at 10 V and 35.15 N/V; the axis follows its set-point to a few millimetres
        assert np.abs(record["F"]).max() < 351.6
        assert np.abs(record["q"] - record["q_set"]).max() < 0.02


@pytest.mark.skipif(not (DATA / "winding_daisy").is_dir(), reason="measured data not here: expected ../shared/data")
def test_a_real_table_without_names_is_refused(tmp_path):
    text = (DATA / "winding_daisy" / "winding.dat").read_text()
    assert "no header" in refusal(put(tmp_path, text, "winding.txt")).problem


# ---- sets ------------------------------------------------------------------------------------------------------------


def test_several_files_are_a_set_of_records(tmp_path):
    text = "\n".join([HEADER, *rows(9)])
    (tmp_path / "b").mkdir()
    one, two = put(tmp_path, text, "one.csv"), put(tmp_path, "\n".join([HEADER, *rows(10)]), "two.csv")
    assert read(one, two).names == ("one", "two")
    twin = put(tmp_path / "b", "\n".join([HEADER, *rows(11)]), "one.csv")
    names = read(one, twin).names
    assert len(set(names)) == 2
    with pytest.raises(InputError, match="named twice"):
        read(one, tmp_path / "b" / ".." / "one.csv")
    with pytest.raises(InputError, match="no records"):
        read()
    slow = put(tmp_path, "\n".join([HEADER, *rows(9, 0.2)]), "slow.csv")
    with pytest.raises(InputError, match=r"one and slow: sample times 0\.1 s and 0\.2 s"):
        read(one, slow)


# ---- units -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("unit", "expected", "factor"),
    [
        ("rpm", "rad/s", 2 * math.pi / 60),
        ("mm", "m", 1e-3),
        ("rad", "deg", 180 / math.pi),
        ("deg", "rad", math.pi / 180),
        ("min", "s", 60.0),
        ("kN", "N", 1000.0),
        ("m/min", "m/s", 1 / 60),
    ],
)
def test_a_wrong_unit_is_refused_with_the_factor_that_mends_it(unit, expected, factor):
    record = Experiment.from_arrays("run", 1.0, outputs={"w3": np.ones(3)}, units={"w3": unit})
    with pytest.raises(InputError) as caught:
        check_units(record, {"w3": expected})
    assert (caught.value.file, caught.value.channel) == ("run", "w3")
    assert f"multiply the column by {factor:.10g} and write w3 [{expected}]" in caught.value.mend


def test_units_follow_from_those_they_are_made_of():
    """Prefixes are powers of ten, quotients and products those of their parts; the rest is what the standards say."""
    factor = {name: unit.factor for name, unit in UNITS.items()}
    base = {"s": 1, "min": 60, "h": 3600, "rad": 1, "turn": 2 * math.pi, "deg": math.pi / 180, "°": math.pi / 180, "m": 1, "V": 1}
    base |= {"in": 0.0254, "A": 1, "N": 1, "kgf": 9.80665, "g": 1e-3, "rpm": 2 * math.pi / 60, "1/min": 2 * math.pi / 60}
    base |= {"Pa": 1, "bar": 1e5, "psi": 0.45359237 * 9.80665 / 0.0254**2, "l": 1e-3, "m3": 1, "m^3": 1}  # pound-force per inch^2
    prefixes = {"m": 1e-3, "u": 1e-6, "k": 1e3, "c": 1e-2, "M": 1e6}
    alike = {"N m": "Nm", "N*m": "Nm", "mNm": "mN", "Nm": "N"}

    def expected(name):
        if name in base:
            return base[name]
        if name in alike:
            return expected(alike[name])
        if "/" in name:
            above, below = name.split("/")
            return expected(above) / expected(below)
        return prefixes[name[0]] * expected(name[1:])

    degrees = {"K": 1.0, "degC": 1.0, "°C": 1.0, "degF": 5 / 9, "°F": 5 / 9}
    assert factor == pytest.approx({name: degrees.get(name) or expected(name) for name in factor}, rel=1e-12)
    freezing = {"K": 273.15, "degC": 0.0, "°C": 0.0, "degF": 32.0, "°F": 32.0}
    assert {name for name, unit in UNITS.items() if unit.zero} | {"K"} == set(freezing)
    for name, value in freezing.items():
        assert UNITS[name].factor * value + UNITS[name].zero == pytest.approx(273.15, rel=1e-12)
    for unit in UNITS.values():
        assert any(other.quantity == unit.quantity and other.factor == 1.0 for other in UNITS.values())


def test_units_of_another_quantity_or_none_at_all(tmp_path):
    record = Experiment.from_arrays("run", 1.0, outputs={"a": np.ones(3), "b": np.ones(3)}, units={"a": "V"})
    with pytest.raises(InputError, match="V is a voltage, m a length: is this the right column"):
        check_units(record, {"a": "m"})
    assert check_units(record, {"a": "V", "b": "m", "absent": "N"}) is record
    furlongs = Experiment.from_arrays("run", 1.0, outputs={"a": np.ones(3)}, units={"a": "furlong"})
    with pytest.raises(InputError, match="no conversion from furlong to m is known"):
        check_units(furlongs, {"a": "m"})
    degrees = Experiment.from_arrays("run", 1.0, outputs={"a": np.ones(3)}, units={"a": "°"})
    assert check_units(degrees, {"a": "deg"}) is degrees
