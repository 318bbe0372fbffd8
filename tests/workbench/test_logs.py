"""Logs as laboratories write them: what is read is what was logged, to the digit, or it is refused."""

from random import Random

import numpy as np
import pytest

from workbench.errors import InputError
from workbench.readers import read_file

CHANNELS = (("u", "V"), ("Drehzahl", "1/min"), ("Kraft", "N"), ("theta", "deg"), ("p_1", "bar"), ("Öltemperatur", "°C"))
FACTORS = {"s": 1.0, "ms": 1e3, "us": 1e6, "min": 1.0 / 60.0}
FAULTS = (
    "delimiter", "decimal comma", "encoding", "sep", "title", "units row", "line ends", "twice", "empty column", "remark",
    "unit of time", "clock", "name of time", "trailing delimiter", "comment",
)  # fmt: skip


def clean(random):
    """A record: names with units, stamps [s] and values, as text of a logger with fixed digits."""
    channels = random.sample(CHANNELS, random.randint(2, 5))
    N, dt = random.randint(20, 60), random.choice([0.001, 0.004, 0.01, 0.05, 0.1, 2.0])
    values = [[round(random.uniform(-10.0, 10.0), 4) for _ in channels] for _ in range(N)]
    return channels, np.round(dt * np.arange(N), 6), values


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
    return ends.join([*text, ""]).encode(encoding)


def outcome(path, channels, t, values):
    """ "right", "wrong", or the refusal of a file, beside what was logged."""
    try:
        e = read_file(path)
    except InputError as reason:
        return str(reason) if reason.mend else "wrong"
    same = [(c.name, c.unit) for c in e.channels] == list(channels) and len(e) == len(t)
    return "right" if same and np.allclose(e.t - e.t[0], t, rtol=0, atol=2e-6) and np.array_equal(e.values, values) else "wrong"


@pytest.mark.parametrize("fault", FAULTS)
def test_every_fault_alone_is_read_as_what_was_logged(tmp_path, fault):
    for seed in range(12):
        random = Random(seed)
        channels, t, values = clean(random)
        (path := tmp_path / f"{seed}.csv").write_bytes(logged(random, channels, t, values, {fault}))
        said = outcome(path, channels, t, values)
        asked = fault == "name of time" and "is it in s, or in ms?" in said
        assert said == "right" or asked, (said, path.read_bytes()[:300])


def test_of_300_logs_with_three_faults_none_is_read_wrongly_and_few_are_refused(tmp_path):
    refused = []
    for seed in range(300):
        random = Random(1000 + seed)
        channels, t, values = clean(random)
        faults = set(random.sample(FAULTS, random.choice([1, 3, 3])))
        (path := tmp_path / f"{seed}.csv").write_bytes(logged(random, channels, t, values, faults))
        said = outcome(path, channels, t, values)
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
    with pytest.raises(InputError, match="channel Zeit: text 's'"):
        read_text(tmp_path, groups)


def test_a_slower_channel_is_left_out_and_said(tmp_path):
    rows = "".join(f"{0.1 * k:.1f},{k},{k if k % 5 == 0 else ''}\n" for k in range(20))
    e = read_text(tmp_path, "t,y,slow\n" + rows)
    assert e.names == ("y",)
    assert e.notes == ("slow has numbers in 4 of 20 rows and is left out",)
