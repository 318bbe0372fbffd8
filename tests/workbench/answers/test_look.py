"""What `look` says of records against numbers that are known, and that nothing of a long record is lost in its page."""

import json
import shlex

import numpy as np
import pytest

import workbench as wb
from studies.cli import parser
from workbench.data import Dataset, Experiment
from workbench.errors import InputError
from workbench.readers import write_csv

DT = 0.01


def run(name: str, samples: int, seed: int, dt: float = DT) -> Experiment:
    random = np.random.default_rng(seed)
    u = np.repeat(random.uniform(-1.0, 1.0, samples // 25 + 1), 25)[:samples]
    y = np.round(3.0 + np.sin(2 * np.pi * 4.0 * dt * np.arange(samples)) + random.normal(0.0, 0.1, samples), 2)
    way = np.linspace(seed, seed + 2.0, samples)
    return Experiment.from_arrays(
        name, dt, inputs={"u": u}, outputs={"y": y}, schedule={"p": way}, units={"u": "V", "y": "rad", "p": "m"}
    )


def test_channels_are_told_over_all_records():
    records = [run("a", 1000, 1), run("b", 600, 5)]
    (found,) = wb.look(*records).sets
    for c in found.channels:
        x = np.concatenate([e[c.channel.name] for e in records])
        assert (c.low, c.high) == (x.min(), x.max())
        np.testing.assert_allclose([c.mean, c.deviation], [x.mean(), x.std()], rtol=1e-12)
    u, y, way = found.channels
    assert y.resolution == pytest.approx(0.01, rel=1e-6)
    assert (u.moves, y.moves, u.resolution) == ("changes every 25 samples on the average", "moves on", 0.0)
    assert (way.channel.role, way.low, way.high) == ("schedule", 1.0, 7.0)
    assert "2 records, 1600 samples of 3 channels every 0.01 s, 16 s in all." in str(wb.look(*records))


def test_the_spectrum_has_the_power_of_the_signal_where_it_is():
    e = run("a", 20_000, 2)
    picture = wb.look(e).plot("Spectra")
    f, density = (np.asarray(c.values, float) for c in picture.data.columns if c.name in ("frequency", "y"))
    assert f[np.argmax(density)] == pytest.approx(4.0, abs=2 * f[0])
    assert np.sum(density**2) * f[0] == pytest.approx(np.var(e["y"]), rel=0.05)


def test_records_that_do_not_fit_together_are_looked_at_each_for_itself():
    found = wb.look(run("a", 500, 1), run("b", 500, 2, dt=0.02), run("c", 400, 3))
    assert [own.records.names for own in found.sets] == [("a", "c"), ("b",)]
    assert any("not one set of records" in s and "0.02" in s for s in found.sentences)
    assert len(found.to_frame()) == 6


def test_what_cannot_be_read_is_told_among_the_others(tmp_path):
    good = write_csv(run("a", 500, 1), tmp_path / "a b.csv")
    bad = tmp_path / "bad.csv"
    bad.write_text("t,u\n0,1\n1,what\n2,3\n")
    found = wb.look(bad, good)
    assert len(found.sets) == 1
    assert "line 3" in found.refused[0]
    with pytest.raises(InputError, match="line 3"):
        wb.look(bad)


def test_how_to_go_on_is_a_command_that_is_understood(tmp_path):
    path = write_csv(run("a", 500, 1), tmp_path / "a b.csv")
    (own,) = wb.look(path, inputs="u", outputs="y", schedule="p").sets
    options = parser().parse_args(shlex.split(own.command)[1:])
    assert (options.command, options.records, options.inputs, options.outputs) == ("identify", [str(path)], "u", "y")
    assert options.schedule == "p"


def test_one_sample_of_a_long_record_is_on_the_page(tmp_path):
    long = run("long", 200_000, 4)
    values = long.values.copy()
    values[123_456, 1] = 99.0
    folder = wb.look(Experiment("long", long.t, long.channels, values)).save(tmp_path / "out")
    written = json.loads((folder / "look.json").read_text())
    assert written["sets"][0]["records"][0]["samples"] == 200_000
    data = next((folder / "data").glob("*long*.csv")).read_text()
    assert "99.0" in data or ",99," in data
    assert (folder / "report.html").stat().st_size < 5e6


def test_a_data_set_is_looked_at_as_it_is():
    data = Dataset((run("a", 500, 1),))
    assert wb.look(data).sets[0].records.names == ("a",)
    with pytest.raises(InputError, match="no records"):
        wb.look()
