"""One run in every kind of file: the numbers are those of the CSV file, whoever wrote it; damaged files are refused."""

import datetime

import numpy as np
import pytest

import workbench as wb
from workbench import formats
from workbench.errors import InputError

N, DT = 300, 0.02
T = DT * np.arange(N)
U = np.repeat(np.random.default_rng(0).uniform(-1.0, 1.0, N // 15), 15)
Y = np.cumsum(U) * DT + 0.5


def excel(path, stamps=None):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    sheet = book.active
    for row in [["Prüfstand 3"], ["Time", "u", "y"], ["ms", "V", "rad"]]:
        sheet.append(row)
    for t, u, y in zip(T, U, Y, strict=True):
        sheet.append([1000.0 * t if stamps is None else stamps + datetime.timedelta(seconds=t), u, y])
    book.create_sheet("Notes").append(["calibrated on Monday"])
    book.save(path)


def parquet(path):
    pandas = pytest.importorskip("pandas")
    pandas.DataFrame({"t [s]": T, "u [V]": U, "y [rad]": Y, "remark": ["x"] * N}).to_parquet(path)


def feather(path):
    pandas = pytest.importorskip("pandas")
    stamps = np.datetime64("2024-05-01T12:00:00") + (T * 1e9).round().astype("timedelta64[ns]")
    pandas.DataFrame({"when": stamps, "u [V]": U, "y [rad]": Y}).to_feather(path)


def tdms(path):
    nptdms = pytest.importorskip("nptdms")
    with nptdms.TdmsWriter(path) as writer:
        wave = {"wf_increment": DT, "wf_start_offset": 0.0}
        writer.write_segment(
            [
                nptdms.ChannelObject("rig", name, values, properties=wave | {"unit_string": unit})
                for name, values, unit in (("u", U, "V"), ("y", Y, "rad"))
            ]
        )


def mdf(path):
    asammdf = pytest.importorskip("asammdf")
    with asammdf.MDF() as file:
        file.append([asammdf.Signal(samples=x, timestamps=T, name=n, unit=u) for n, x, u in (("u", U, "V"), ("y", Y, "rad"))])
        file.save(path, overwrite=True)


def matlab(path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in (("t", T), ("u", U), ("y", Y)):
            file.create_dataset(name, data=values[None]).attrs["MATLAB_class"] = np.bytes_("double")
        file.create_dataset("note", data=np.zeros((1, 3), np.uint16)).attrs["MATLAB_class"] = np.bytes_("char")
    with open(path, "r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512))


WRITERS = {".xlsx": excel, ".parquet": parquet, ".feather": feather, ".tdms": tdms, ".mf4": mdf, ".mat": matlab}


@pytest.mark.parametrize("suffix", WRITERS)
def test_the_numbers_are_those_that_were_written(tmp_path, suffix):
    path = tmp_path / f"run{suffix}"
    WRITERS[suffix](path)
    (e,) = wb.read(path, inputs="u", outputs="y")
    assert e.names == ("u", "y")
    assert e.dt == pytest.approx(DT, rel=1e-9)
    np.testing.assert_allclose(e.t - e.t[0], T, atol=1e-9)
    np.testing.assert_allclose(e["u"], U, rtol=1e-14)
    np.testing.assert_allclose(e["y"], Y, rtol=1e-14)
    if suffix != ".mat":
        assert [c.unit for c in e.channels] == ["V", "rad"]


def test_dates_of_a_sheet_are_its_time(tmp_path):
    excel(tmp_path / "run.xlsx", datetime.datetime(2024, 5, 1, 23, 59, 58))
    (e,) = wb.read(tmp_path / "run.xlsx")
    np.testing.assert_allclose(e.t, T, atol=2e-6)


@pytest.mark.parametrize("suffix", WRITERS)
def test_a_damaged_file_is_refused_with_its_name(tmp_path, suffix):
    path = tmp_path / f"run{suffix}"
    WRITERS[suffix](path)
    whole = path.read_bytes()
    for cut in (10, len(whole) // 3, len(whole) - 40):
        path.write_bytes(whole[:cut])
        try:
            (e,) = wb.read(path)
        except InputError as reason:
            said = str(reason)
        else:  # a format that is read as far as it goes
            np.testing.assert_allclose(e["u"], U[: len(e)])
            continue
        assert f"run{suffix}" in said
    path.write_bytes(np.random.default_rng(1).bytes(5000))
    with pytest.raises(InputError, match=f"run{suffix}"):
        wb.read(path)


def test_what_is_not_installed_is_named_with_its_mend(tmp_path, monkeypatch):
    without = tmp_path / "without.py"
    text = formats.LOADER.read_text(encoding="utf-8").replace("import openpyxl", "import openpyxl_that_is_not_there as openpyxl")
    without.write_text(text, encoding="utf-8")
    monkeypatch.setattr(formats, "LOADER", without)
    (tmp_path / "a.xlsx").write_bytes(b"PK")
    with pytest.raises(InputError, match=r"(?s)which is not installed.*pip install 'gain-scheduling-workbench\[excel\]'"):
        wb.read(tmp_path / "a.xlsx")


def test_several_rates_come_on_the_stamps_of_the_fastest(tmp_path):
    nptdms = pytest.importorskip("nptdms")
    slow = 0.5 + 0.25 * np.arange(16)  # T1 is logged every 0.25 s, from 0.5 s on
    with nptdms.TdmsWriter(tmp_path / "run.tdms") as writer:
        writer.write_segment(
            [
                nptdms.ChannelObject("fast", "u", U, properties={"wf_increment": DT}),
                nptdms.ChannelObject("slow", "T1", 20.0 + slow, properties={"wf_increment": 0.25, "wf_start_offset": 0.5}),
            ]
        )
    (e,) = wb.read(tmp_path / "run.tdms")
    assert (e.t[0], e.t[-1]) == (pytest.approx(0.5), pytest.approx(slow[-1] - slow[-1] % DT))
    np.testing.assert_allclose(e["T1"], 20.0 + e.t, rtol=1e-12)
    np.testing.assert_allclose(e["u"], U[np.rint(e.t / DT).astype(int)])
    assert "T1 (every 0.25 s)" in e.notes[0]
    assert "taken from 0.5 to" in e.notes[1]


def test_nothing_is_drawn_over_a_gap_of_a_slower_channel(tmp_path):
    asammdf = pytest.importorskip("asammdf")
    slow = np.delete(0.2 * np.arange(30), range(10, 20))
    with asammdf.MDF() as file:
        file.append([asammdf.Signal(samples=U, timestamps=T, name="u")])
        file.append([asammdf.Signal(samples=slow, timestamps=slow, name="T1")])
        file.save(tmp_path / "run.mf4", overwrite=True)
    with pytest.raises(InputError, match=r"channel T1: gap stamp at 4 s"):
        wb.read(tmp_path / "run.mf4")


def test_two_sheets_with_numbers_are_asked_about(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    for sheet in (book.active, book.create_sheet("second")):
        for row in [["t", "u"], [0.0, 1.0], [1.0, 2.0], [2.0, 3.0]]:
            sheet.append(row)
    book.save(tmp_path / "two.xlsx")
    with pytest.raises(InputError, match="sheets with numbers: Sheet, second; save the one that is meant"):
        wb.read(tmp_path / "two.xlsx")


def test_the_reader_of_other_files_imports_nothing_of_ours():
    """It runs isolated, where the workbench may not be installed."""
    assert "workbench" not in formats.LOADER.read_text(encoding="utf-8")
