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


def signals(path, *groups):
    """An MDF file of groups, each a list of (name, stamps, samples, options)."""
    asammdf = pytest.importorskip("asammdf")
    with asammdf.MDF() as file:
        for group in groups:
            file.append([asammdf.Signal(samples=x, timestamps=t, name=name, **more) for name, t, x, more in group])
        file.save(path, overwrite=True)
    return path


def test_nothing_is_drawn_over_a_gap_of_a_slower_channel(tmp_path):
    slow = np.delete(0.05 * np.arange(110), range(40, 60))
    (e,) = wb.read(signals(tmp_path / "run.mf4", [("u", T, U, {})], [("T1", slow, slow, {})]))
    assert (e.names, len(e)) == (("u",), N)
    assert "T1: left out" in " ".join(e.notes)


def test_a_slower_channel_is_drawn_at_the_times_that_samples_have_after_their_mend(tmp_path):
    late = T.copy()
    late[100:105] = T[105] - 0.003 + 0.0005 * np.arange(5)
    slow = 0.1 * np.arange(N // 5)
    (e,) = wb.read(signals(tmp_path / "run.mf4", [("u", late, U, {})], [("y", slow, np.sin(slow), {})]))
    np.testing.assert_allclose(e["u"], U[: len(e)])
    np.testing.assert_allclose(e["y"], np.interp(e.t, slow, np.sin(slow)), atol=1e-9)
    np.testing.assert_allclose(np.diff(e.t), DT, rtol=1e-6)
    assert "came late" in e.notes[0]


def test_a_list_of_events_is_no_clock(tmp_path):
    events = 2.0 + 0.001 * np.arange(6)
    (e,) = wb.read(signals(tmp_path / "run.mf4", [("u", T, U, {})], [("event", events, np.arange(6.0), {})]))
    assert (len(e), e.names) == (N, ("u",))
    assert "event: 6 samples only, left out" in e.notes[0]


def test_samples_that_are_marked_as_invalid_are_refused(tmp_path):
    bits = np.zeros(N, bool)
    bits[41] = True
    path = signals(tmp_path / "run.mf4", [("u", T, np.where(bits, 1e6, U), {"invalidation_bits": bits}), ("y", T, Y, {})])
    with pytest.raises(InputError, match=r"channel u: sample 42 is nan"):
        wb.read(path)


@pytest.mark.parametrize("apart", [2.0, 0.0])
def test_waveforms_that_began_at_other_instants_are_laid_side_by_side(tmp_path, apart):
    nptdms = pytest.importorskip("nptdms")
    began = np.datetime64("2024-05-01T12:00:00.000000")
    waves = [(began, "u", np.sin(T)), (began + np.timedelta64(round(1e6 * apart), "us"), "y", np.sin(T + apart))]
    with nptdms.TdmsWriter(tmp_path / "run.tdms") as writer:
        for start, name, x in waves:
            wave = {"wf_increment": DT, "wf_start_time": start, "wf_start_offset": 0.0}
            writer.write_segment([nptdms.ChannelObject(f"of {name}", name, x, properties=wave)])
    (e,) = wb.read(tmp_path / "run.tdms")
    np.testing.assert_allclose(e["u"], e["y"], atol=1e-3)
    np.testing.assert_allclose(e["u"], np.sin(e.t), atol=1e-3)


def test_a_column_of_time_counts_more_than_an_increment(tmp_path):
    nptdms = pytest.importorskip("nptdms")
    with nptdms.TdmsWriter(tmp_path / "run.tdms") as writer:
        wave = {"wf_increment": 1.0, "wf_start_offset": 0.0}
        writer.write_segment([nptdms.ChannelObject("a", name, x, properties=wave) for name, x in (("Time", T), ("u", U))])
    (e,) = wb.read(tmp_path / "run.tdms")
    assert (e.dt, e.names) == (pytest.approx(DT), ("u",))


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ({"time": 1714560000000.0 + 20.0 * np.arange(N), "u": U}, "no time of this age"),
        ({"time": 45292.5 + T / 86400.0, "u": U}, "is it in days"),
        ({"time": 0.5 + T / 86400.0, "u": U}, "is it in days"),
        ({"time": np.repeat(T[: N // 2], 2), "signal": ["a", "b"] * (N // 2), "value": U}, "several signal below each other"),
    ],
)
def test_times_and_tables_that_mean_something_else_are_asked_about(tmp_path, columns, said):
    pandas = pytest.importorskip("pandas")
    pandas.DataFrame(columns).to_parquet(tmp_path / "a.parquet")
    with pytest.raises(InputError, match=said):
        wb.read(tmp_path / "a.parquet")


def test_a_time_in_ms_is_one_whatever_sample_time_is_given(tmp_path):
    pandas = pytest.importorskip("pandas")
    pandas.DataFrame({"t [ms]": 1000.0 * T, "u": U}).to_parquet(tmp_path / "a.parquet")
    assert wb.read(tmp_path / "a.parquet", dt=DT).dt == pytest.approx(DT)
    with pytest.raises(InputError, match=r"a sample every 0\.02 s, and 0\.001 s was given"):
        wb.read(tmp_path / "a.parquet", dt=0.001)


def test_a_row_without_a_time_is_named(tmp_path):
    pandas = pytest.importorskip("pandas")
    stamps = np.datetime64("2024-05-01T12:00:00") + (T * 1e9).round().astype("timedelta64[ns]")
    stamps[7] = np.datetime64("NaT")
    pandas.DataFrame({"when": stamps, "u": U}).to_parquet(tmp_path / "a.parquet")
    with pytest.raises(InputError, match="sample 8 of u has no time"):
        wb.read(tmp_path / "a.parquet")


def test_dates_and_times_in_columns_of_their_own_and_empty_rows(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.append(["Date", "Time", "u"])
    begin = datetime.datetime(2024, 5, 1, 23, 59, 58)
    for k in range(40):
        now = begin + datetime.timedelta(seconds=0.1 * k)
        book.active.append([datetime.datetime.combine(now.date(), datetime.time()), now.time(), U[k]])
    book.active.cell(60, 5).number_format = "0.00"
    book.save(tmp_path / "a.xlsx")
    (e,) = wb.read(tmp_path / "a.xlsx")
    np.testing.assert_allclose(e.t, 0.1 * np.arange(40), atol=1e-5)
    np.testing.assert_allclose(e["u"], U[:40])


def test_matrices_beside_a_run_are_left_out_and_told(tmp_path):
    from scipy.io import savemat

    savemat(tmp_path / "a.mat", {"dt": DT, "A": np.eye(4), "B": np.eye(4), "K": np.eye(4), "y": Y})
    (e,) = wb.read(tmp_path / "a.mat")
    assert (e.names, len(e)) == (("y",), N)
    assert "A (4 x 4)" in e.notes[0]


def test_what_does_not_go_up_by_one_is_no_counter(tmp_path):
    encoder = np.cumsum(np.random.default_rng(0).integers(0, 80, N))
    (tmp_path / "a.csv").write_text("count,u\n" + "".join(f"{c},{u}\n" for c, u in zip(encoder, U, strict=True)))
    (e,) = wb.read(tmp_path / "a.csv", dt=DT)
    assert (e.dt, e.names) == (pytest.approx(DT), ("count", "u"))


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
