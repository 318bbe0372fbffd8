"""The study of robust loops with laws that are designed in no time: what it compares, and what it says."""

import csv
import json
from types import SimpleNamespace

import numpy as np
import pytest

from controllers.scheduled_pid import ScheduledPID
from studies import robust_winding
from studies.loops import WINDING_LIMITS
from studies.robust_winding import asked, main, recorded
from tests.controllers.test_nmpc import winding
from workbench.data import Dataset
from workbench.errors import InputError
from workbench.identification.ssm import SSM
from workbench.intervals.errors import ErrorRegression

pytestmark = pytest.mark.slow


def law(name: str, gain: float) -> ScheduledPID:
    """Decoupled loops: the speed by the second motor, the angle by the first."""
    Kp = gain * np.array([[[0.0, -0.002], [0.02, 0.0]]])
    Ki = gain * np.array([[[0.0, -0.02], [0.1, 0.0]]])
    zero, two = np.zeros((1, 2, 2)), np.zeros((1, 2))
    return ScheduledPID(
        ("V1", "V2"), ("w3", "theta"), ("w3_set", "theta_set"), 0.04, Kp, Ki, zero, zero, two, np.ones(2), np.zeros(2),
        WINDING_LIMITS.low, WINDING_LIMITS.high, WINDING_LIMITS.rate, 0.04, name=name,
    )  # fmt: skip


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    folder = tmp_path_factory.mktemp("robust")
    with pytest.MonkeyPatch.context() as patch:

        def design(quick, seed, progress):
            records = recorded(seed, 2, progress)
            model = SSM(order=3).fit(Dataset(records))
            return SimpleNamespace(
                laws={"fixed PID": law("fixed", 1.0), "scheduled PID": law("scheduled", 1.2)}, models={"m": model}
            )

        bench = SimpleNamespace(design=design, scheduled="scheduled PID")
        patch.setattr(robust_winding, "benches", lambda: {"web-winding": bench})
        patch.setattr(robust_winding, "design_pid", lambda *_, **__: SimpleNamespace(law=law("tight", 0.5)))
        path = main(True, folder=folder, seed=3, say=lambda _: None)
    return path, json.loads((folder / "robust-winding.json").read_text())


def test_every_law_has_a_verdict_on_the_model_and_on_the_machine(done):
    path, found = done
    assert set(found["verdicts"]) == {"fixed PID", "scheduled PID", "scheduled PID, peaks 1.3"}
    for name, verdicts in found["verdicts"].items():
        assert {v["of"].split(",")[0] for v in verdicts} == {"model SSM", "plant web-winding"}, name
        assert any(", along r2 from 0.011 to" in v["of"] for v in verdicts), name
        assert sum(v["claim"].startswith("stable at r2") for v in verdicts) == 2
        assert all(v["status"] in ("PROVED", "PASSED", "FAILED", "UNDECIDED") for v in verdicts)
        for v in verdicts:
            assert (v["status"] == "FAILED") == bool(v["witness"]), v
    page = path.read_text()
    for title in ("Searched and tried at random", "One more record", "What tightening buys and costs"):
        assert title in page


def columns(folder, part):
    """Columns of the table behind a picture, by name, without the first."""
    with next(folder.glob(f"*{part}*.csv")).open(newline="") as file:
        header, *rows = csv.reader(file)
    return dict(zip(header[1:], np.array(rows, dtype=float).T[1:], strict=True))


def test_search_beats_chance_and_records_only_take_away(done):
    data = done[0].parent / "data"
    adversary, moving, constant = columns(data, "eviation-of-the-tension").values()
    assert adversary[0] > 1.5 * max(moving[-1], constant[-1])
    assert np.all(np.diff(moving) >= 0.0)
    for name, width in columns(data, "idth-of-the-boxes").items():
        assert width[0] == 1.0
        assert np.all(np.diff(width) <= 1e-6), name


def test_the_bound_of_all_records_holds_for_each():
    records = recorded(5, 3, lambda _: None)
    model = SSM(order=3).fit(Dataset(records[:2]))
    full = ErrorRegression().fit(model, Dataset(records))
    bound = [float(own.modes[0].box.radius[-1]) for own in full]
    for count in (1, 2):
        ErrorRegression(bound=bound).fit(model, Dataset(records[:count]))  # not refused: no record breaks it


def test_it_needs_the_machine(tmp_path):
    with pytest.raises(InputError, match="needs the machine itself"):
        main(folder=tmp_path, data="records")
    assert {limit.signal for limit in asked().limits} == {"theta", "w3", "V1", "V2"}


def test_a_law_with_more_outputs_than_set_points_has_its_errors(monkeypatch):
    """The NMPC measures every output of the plant."""
    monkeypatch.setattr(robust_winding, "DURATION", 1.0)
    monkeypatch.setattr(robust_winding, "SETPOINTS", {"w3": ((0.0, 100.0),), "theta": ((0.0, 0.0), (0.5, 5.0))})
    own = winding()
    assert len(own.measured) > len(own.references)
    errors = robust_winding._rms(own, 1)
    assert set(errors) == {"w3", "theta"}
    assert 0.5 < errors["theta"] < 5.0
    assert 0.0 < errors["w3"] < 5.0
