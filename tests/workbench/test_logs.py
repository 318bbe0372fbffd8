"""Logs as laboratories write them: what is read is what was logged, to the digit, or it is refused."""

from random import Random

import numpy as np
import pytest

from workbench.errors import InputError
from workbench.readers import read_file, read_records

CHANNELS = (("u", "V"), ("Drehzahl", "1/min"), ("Kraft", "N"), ("theta", "deg"), ("p_1", "bar"), ("Öltemperatur", "°C"))
FACTORS = {"s": 1.0, "ms": 1e3, "us": 1e6, "min": 1.0 / 60.0}
FAULTS = (
    "delimiter", "decimal comma", "encoding", "sep", "title", "units row", "line ends", "twice", "empty column", "remark",
    "unit of time", "clock", "name of time", "trailing delimiter", "comment", "gap", "row twice", "cut off",
)  # fmt: skip


def clean(random, faults=frozenset()):
    """A record: names with units, stamps [s] and values, as text of a logger with fixed digits; in two parts with a gap."""
    channels = random.sample(CHANNELS, random.randint(2, 5))
    N, dt = random.randint(20, 60) + 60 * ("gap" in faults), random.choice([0.001, 0.004, 0.01, 0.05, 0.1, 2.0])
    values = [[round(random.uniform(-10.0, 10.0), 4) for _ in channels] for _ in range(N)]
    late = random.uniform(5.0, 50.0) * dt * (np.arange(N) >= 40) * ("gap" in faults)
    return channels, np.round(dt * np.arange(N) + late, 6), values


def logged(random, channels, t, values, faults):
    """The bytes of a file with these faults."""
    has = faults.__contains__
    delimiter = random.choice([";", "\t", "|", " "]) if has("delimiter") else ","
    comma = has("decimal comma")
    if comma or has("sep"):
        delimiter = random.choice([";", "\t"]) if comma else ";"
    if delimiter == " " and faults & {"empty column", "remark", "trailing delimiter", "units row", "clock", "name of time"}:
        delimiter = "\t"
    shown = lambda x, digits=4: f"{x:.{digits}f}".replace(".", "," if comma else ".")  # noqa: E731
    unit = random.choice(["ms", "us", "min"]) if has("unit of time") and not has("clock") else "s"
    name = random.choice(["Time", "time", "TIME", "Zeit", "Timestamp", "Elapsed"]) if has("name of time") else "t"
    if has("clock"):
        style, zero = random.choice(["time", "iso", "german"]), random.choice([43200.0, 86395.0])
        t = t + zero
        days = np.floor(t / 86400.0).astype(int)
        clock = [f"{int(s % 86400 // 3600):02d}:{int(s % 3600 // 60):02d}:{s % 60:09.6f}" for s in np.round(t, 6)]
        dates = {"time": ["", ""], "iso": ["2024-02-29 ", "2024-03-01 "], "german": ["29.02.2024 ", "01.03.2024 "]}[style]
        stamps = [dates[day] + own for day, own in zip(days, clock, strict=True)]
        head = (name, "")
    else:
        stamps, head = [shown(s * FACTORS[unit], 9 if unit == "min" else 6) for s in t], (name, unit)
    table = [[stamp, *map(shown, row)] for stamp, row in zip(stamps, values, strict=True)]
    if has("row twice"):
        k = random.randint(5, 15)
        table.insert(k, table[k])
    heads = [head, *channels]
    at = random.randint(1, len(heads))
    if has("twice"):
        heads.append(heads[1])
        table = [[*row, row[1]] for row in table]
    if has("remark"):
        words = random.choice([["ok", "ok", "Halt"], ["", "", "Störung; manuell".replace(";", ",")], ["", "start", ""]])
        words = [word.replace(",", "") for word in words]
        heads.insert(at, ("Bemerkung", ""))
        table = [[*row[:at], words[k % 3], *row[at:]] for k, row in enumerate(table)]
    if has("empty column"):
        heads.insert(at, ("reserve", ""))
        table = [[*row[:at], "", *row[at:]] for row in table]
    if has("units row"):
        lines = [[n for n, _ in heads], [random.choice(["{}", "[{}]"]).format(u) if u else "" for _, u in heads]]
    else:
        lines = [[f"{n} [{u}]" if u else n for n, u in heads]]
    if has("comment"):
        lines[0][0] = "# " * (delimiter != " ") + lines[0][0]
    end = delimiter * (has("trailing delimiter") and delimiter != " ")
    text = [delimiter.join(line) + end for line in [*lines, *table]]
    titles = ["Prüfstand 3", "Operator: K. Maier", "Datum: 2024-05-01", "", "Messung Nr. 12, Rampe"]
    if has("title"):
        text = [*random.sample(titles, random.randint(1, 4)), *text]
    if has("sep"):
        text = [f"sep={delimiter}", *text]
    ends = random.choice(["\r", "\r\n"]) if has("line ends") else "\n"
    encoding = random.choice(["utf-8-sig", "utf-16", "cp1252"]) if has("encoding") else "utf-8"
    text[-1:] = [text[-1].split(delimiter)[0]] if has("cut off") else [text[-1], ""]
    return ends.join(text).encode(encoding)


def outcome(path, channels, t, values, faults=frozenset()):
    """ "right", "wrong", or the refusal of a file, beside what was logged."""
    try:
        records = read_records(path)
    except InputError as reason:
        return str(reason) if reason.mend else "wrong"
    whole = len(t) - ("cut off" in faults)
    stamps, own = np.concatenate([e.t for e in records]), np.vstack([e.values for e in records])
    same = [(c.name, c.unit) for c in records[0].channels] == list(channels) and len(records) == 1 + ("gap" in faults)
    same = same and len(stamps) == whole and np.allclose(stamps - stamps[0], t[:whole], rtol=0, atol=2e-6)
    return "right" if same and np.array_equal(own, values[:whole]) else "wrong"


@pytest.mark.parametrize("fault", FAULTS)
def test_every_fault_alone_is_read_as_what_was_logged(tmp_path, fault):
    for seed in range(12):
        random = Random(seed)
        channels, t, values = clean(random, {fault})
        (path := tmp_path / f"{seed}.csv").write_bytes(logged(random, channels, t, values, {fault}))
        said = outcome(path, channels, t, values, {fault})
        asked = fault == "name of time" and "is it in s, or in ms?" in said
        assert said == "right" or asked, (said, path.read_bytes()[:300])


def test_of_300_logs_with_three_faults_none_is_read_wrongly_and_few_are_refused(tmp_path):
    refused = []
    for seed in range(300):
        random = Random(1000 + seed)
        faults = set(random.sample(FAULTS, random.choice([1, 3, 3])))
        channels, t, values = clean(random, faults)
        (path := tmp_path / f"{seed}.csv").write_bytes(logged(random, channels, t, values, faults))
        said = outcome(path, channels, t, values, faults)
        assert said != "wrong", (faults, path.read_bytes()[:400])
        refused += [(faults, said)] * (said != "right")
    assert len(refused) <= 15, refused


def read_text(folder, text):
    (path := folder / "log.csv").write_text(text, encoding="utf-8")
    return read_file(path)


def test_a_log_is_told_as_it_was_understood(tmp_path):
    text = "Prüfstand 3\nTimestamp;u;n;Bemerkung\nms;V;1/min;\n0;1,5;980;start\n5;-1;981;\n10;2,5;979;\n15;1;980;Ende\n"
    e = read_text(tmp_path, text)
    assert [str(c) for c in e.channels] == ["u [V]", "n [1/min]"]
    assert e.dt == 0.005
    np.testing.assert_array_equal(e["u"], [1.5, -1.0, 2.5, 1.0])
    assert e.notes == (
        "1 line above the header left out",
        "units are in a row of their own",
        "Bemerkung holds text and is left out",
        "Timestamp is in ms, taken as t in s",
    )
    assert read_text(tmp_path, "t,y\n0,1\n1,2\n2,3\n").notes == ()


def test_a_fault_further_down_is_named_at_its_line_in_the_log(tmp_path):
    text = "Prüfstand 3\n\nTimestamp;u\nms;V\n0;1,5\n5;1,5\n10;nan\n15;1,5\n20;1,5\n"
    with pytest.raises(InputError, match="line 7, channel u: nan is not finite"):
        read_text(tmp_path, text)
    with pytest.raises(InputError, match=r"line 8.*gap of 0\.03 s"):
        read_text(tmp_path, text.replace("nan", "1,5").replace("15;", "40;"))


def test_what_two_logs_could_mean_is_asked(tmp_path):
    days = "Time,y\n{0}/05/2024 23:59:59.5,1\n{0}/05/2024 23:59:59.75,2\n{1}/05/2024 00:00:00.0,3\n{1}/05/2024 00:00:00.25,4\n"
    with pytest.raises(InputError, match="the date '04/05/2024' may be read two ways"):
        read_text(tmp_path, days.format("03", "04"))
    with pytest.raises(InputError, match="text '12:00'"):  # hours and minutes, or minutes and seconds?
        read_text(tmp_path, "Time,y,z\n12:00,1,2\n12:01,2,3\n12:02,3,4\n12:03,3,4\n")
    groups = "Zeit;Motor;Last\ns;n;M\n0;1;2\n1;2;3\n2;3;4\n"  # names below groups are no units
    with pytest.raises(InputError, match="no time column among s, n, M"):
        read_text(tmp_path, groups)


def test_a_slower_channel_is_left_out_and_said(tmp_path):
    rows = "".join(f"{0.1 * k:.1f},{k},{k if k % 5 == 0 else ''}\n" for k in range(20))
    e = read_text(tmp_path, "t,y,slow\n" + rows)
    assert e.names == ("y",)
    assert e.notes == ("slow has numbers in 4 of 20 rows and is left out",)


REFUSED = {
    "marks beside a converted time": ("Time [s];load\n0.1;1,234\n0.2;1,235\n0.3;1,236\n0.4;1,240\n", "line 2"),
    "marks beside clock times": (
        "Time;force;n\n12:00:00;1,234;980\n12:00:01;1,235;990\n12:00:02;1,236;998\n",
        "a decimal comma, or a mark of thousands",
    ),
    "marks in the time": ("Time [ms];u\n1,000;5\n1,100;6\n1,200;7\n1,300;8\n", "a decimal comma, or a mark of thousands"),
    "both marks": ("t;u;y\n0;1.234,5;1\n1;1.235,5;2\n2;1.236,5;3\n", "channel u"),
    "epoch without unit": ("t,u\n1714560000000,1\n1714560000100,1\n1714560000200,1\n", "no time of this age"),
    "a temperature": ("No;T;u\n1;20.0;1\n2;20.5;1\n3;21.0;1\n", "no time column"),
    "a least temperature": ("Tmin;Tmax;u\n1;20;1\n2;21;1\n3;22;1\n", "no time column"),
    "values of several tags": (
        "TagName;Timestamp;Value\nA;2024-05-01 12:00:00.0;1,5\nB;2024-05-01 12:00:00.5;7,1\nA;2024-05-01 12:00:01.0;1,6\n",
        "values of several TagName below each other",
    ),
    "two units": ("Time [s];u;y\nms;V;V\n0;1;2\n1;2;2\n2;3;1\n", "in s by the header, in ms by the row below"),
    "zones": (
        "Timestamp,u,y\n2024-10-27T02:59:58+02:00,1,2\n2024-10-27T02:59:59+02:00,1,2\n2024-10-27T02:00:00+01:00,1,2\n",
        "the time zone changes",
    ),
    "a row of data below the header": ("Time [s];u;mode;dir\n0;;A;N\n1;2;A;N\n2;3;A;N\n3;3;A;N\n", "line"),
    "a number among clock times": ("Time;u;y\n12:00:00;1;2\n12:00:01;1;2\n12:00:02;1;2\n3;1;2\n", "3 is no clock time"),
    "a day is missing": (
        "Date,Time,u,y\n2024-05-01,12:00:00,1,1\n2024-05-01,12:00:01,1,2\n2024-05-01,12:00:02,1,3\n2024-05-03,12:00:03,1,4\n",
        "gap of",
    ),
    "cut before the time": ("u;y;Time (ms)\n1;2;0\n1;2;1\n1;2;2\n4;5\n1;2;4\n", "line 5"),
    "a foot of two lines": ("No,Clock,u\n1,12:00:00,0\n2,12:00:01,1\n3,12:00:02,2\nEnd of log\n3 rows\n", "line 5"),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_what_would_be_read_wrongly_is_refused_at_its_place(tmp_path, kind):
    text, said = REFUSED[kind]
    with pytest.raises(InputError, match=said):
        read_text(tmp_path, text)


def test_stamps_since_1970_keep_their_milliseconds(tmp_path):
    e = read_text(tmp_path, "Timestamp [ms],u\n" + "".join(f"{1714560000003 + 22 * k},1\n" for k in range(40)))
    assert e.dt == pytest.approx(0.022, abs=1e-8)
    np.testing.assert_allclose(np.diff(e.t), 0.022, atol=1e-6)


def test_quotes_and_headers_in_comments_of_blanks_are_read(tmp_path):
    assert read_text(tmp_path, '"t","u"\n"0","1.5"\n"1","2"\n"2","2.5"\n')["u"].tolist() == [1.5, 2.0, 2.5]
    assert read_text(tmp_path, "# t u y\n0 1 2\n1 2 3\n2 3 4\n")["y"].tolist() == [2.0, 3.0, 4.0]
    assert read_text(tmp_path, "Time (ms);T (degC)\n0;20\n1;20,5\n2;21\n").names == ("T",)
    assert read_text(tmp_path, '"' + 140_000 * "x" + "\nTime (ms),u\n0,1\n1,2\n2,3\n").names == ("u",)


def test_a_german_date_beside_clock_times_with_decimal_commas(tmp_path):
    days = [("01.05.2024;23:59", 39 + k, k) if k <= 20 else ("02.05.2024;00:00", k - 21, k) for k in range(40)]
    rows = "".join(f"{day}:{second:02d},500;{k},25\n" for day, second, k in days)
    e = read_text(tmp_path, "Datum;Uhrzeit;y\n" + rows)
    np.testing.assert_allclose(e.t, np.arange(40))
    assert e.names == ("y",)
    assert e["y"][3] == 3.25


def test_dates_with_times_are_the_time_whatever_their_name(tmp_path):
    e = read_text(tmp_path, "Zeitpunkt;y\n" + "".join(f"2024-05-01 12:00:{k:02d};{k}\n" for k in range(40)))
    np.testing.assert_allclose(e.t, np.arange(40))
    assert "Zeitpunkt holds dates and clock times" in e.notes[0]


def test_a_letter_is_no_table(tmp_path):
    with pytest.raises(InputError, match="is no table of numbers"):
        read_text(tmp_path, "Dear colleague\nthe log is in the other mail\nYours, K.\n")
