"""The study strangers: its outcomes and rates against rows made by hand, its table, and how a case ends that has no answer."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from studies import answers, strangers
from studies.stranger_scores import Outcome, outcome, ratios, summary, worse
from studies.strangers import TARGETS, answer, configured, run, said, verdict, zoo
from workbench.data import Dataset, Experiment
from workbench.errors import InputError


def cause(key, *ties, sure=True, **parameters):
    return {"key": key, "ties": list(ties), "parameters": parameters, "delta_bic": 50.0, "stability": 1.0, "sure": sure}


def row(kind="single", truth=(), verdict="named", causes=(), **more):
    hidden = [{"key": k, "multiple": 3.0, "catalogued": "@outside" not in k, "parameters": {"level": 1.0}} for k in truth]
    return {
        "seed": 1, "configuration": "c", "machine": "servo", "kind": kind, "truth": hidden, "verdict": verdict,
        "causes": list(causes), "seconds": 2.0, "says_worse": False, "code": 0,
    } | more  # fmt: skip


A, B, C = "coulomb@joint", "offset@V", "sensor-lag@a"


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (row(truth=[A], causes=[cause(A)]), Outcome.RIGHT),
        (row(truth=[A], causes=[cause(B, A)]), Outcome.TIE),
        (row(truth=[A], causes=[cause(B, A, C, "x@y")]), Outcome.MISSED),  # four effects are no answer
        (row(truth=[A], causes=[cause(A), cause(B)]), Outcome.WRONG),
        (row(truth=[A], causes=[cause(B)]), Outcome.WRONG),
        (row(truth=[A], verdict="incomplete", causes=[cause(A)]), Outcome.INCOMPLETE),
        (row(truth=[A], verdict="incomplete", causes=[cause(B, sure=False)]), Outcome.INCOMPLETE),
        (row(truth=[A], verdict="incomplete", causes=[cause(B)]), Outcome.WRONG),
        (row(truth=[A], verdict="incomplete", causes=[cause(A), cause(B, sure=False)]), Outcome.INCOMPLETE),
        (row(truth=[A], verdict="unknown"), Outcome.UNKNOWN),
        (row(truth=[A], verdict="nothing"), Outcome.MISSED),
        (row("pair", [A, B], causes=[cause(A), cause(B)]), Outcome.RIGHT),
        (row("pair", [A, B], causes=[cause(A), cause(C, B)]), Outcome.TIE),
        (row("pair", [A, B], causes=[cause(A)]), Outcome.HALF),
        (row("pair", [A, B], causes=[cause(A), cause(C)]), Outcome.WRONG),
        (row("nothing", verdict="nothing"), Outcome.RIGHT),
        (row("nothing", verdict="unknown"), Outcome.UNKNOWN),
        (row("nothing", verdict="incomplete", causes=[cause(A)]), Outcome.WRONG),
        (row("nothing", verdict="incomplete", causes=[cause(A, sure=False)]), Outcome.INCOMPLETE),
        (row("outside", ["cable@outside"], verdict="unknown"), Outcome.RIGHT),
        (row("outside", ["cable@outside"], verdict="incomplete", causes=[cause(A, sure=False)]), Outcome.INCOMPLETE),
        (row("outside", ["cable@outside"], verdict="incomplete", causes=[cause(A)]), Outcome.WRONG),
        (row("outside", ["cable@outside"], causes=[cause(A)]), Outcome.WRONG),
        (row("outside", ["cable@outside"], verdict="nothing"), Outcome.MISSED),
        (row(truth=[A], crashed="Traceback"), Outcome.CRASHED),
        (row(truth=[A], refused="no"), Outcome.REFUSED),
    ],
)
def test_what_is_said_of_a_case_has_one_outcome(given, expected):
    assert outcome(given) is expected


def test_a_rounding_that_every_sensor_has_is_no_wrong_name():
    rounded = cause("quantisation@a", step=[0.01, 0.01, 0.01])
    assert outcome(row("nothing", verdict="named", causes=[rounded], resolutions={"a": 0.01})) is not Outcome.WRONG
    assert outcome(row("nothing", verdict="named", causes=[rounded], resolutions={"a": 0.02})) is Outcome.WRONG


def test_rates_count_what_they_say():
    inside, outside_of = cause(A, level=[1.1, 0.9, 1.3]), cause(A, level=[1.3, 1.2, 1.4])
    rows = [
        row(truth=[A], causes=[inside]),
        row(truth=[A], causes=[outside_of], errors={"one-second": {"r, a": [1.0, 1.2]}}),
        row(truth=[A], causes=[cause(B)], errors={"full-run": {"r, a": [1.0, 1.5]}}, says_worse=True),
        row("nothing", verdict="nothing", errors={"one-second": {"r, a": [1.0, 0.9]}}),
        row("nothing", verdict="incomplete", causes=[cause(C, sure=False)]),
        {k: v for k, v in row("pair", [A, B], crashed="Traceback").items() if k not in ("verdict", "causes")},
        row(undrawn="no"),
    ]
    s = summary(rows)
    assert (s.cases, s.crashed.hits, s.refused.hits) == (6, 1, 0)
    assert (s.wrong.hits, s.wrong.of) == (1, 5)
    assert (s.unsure.hits, s.unsure.of) == (1, 5)
    assert (s.false_alarms.hits, s.false_alarms.of) == (1, 2)  # also where it is not sure
    assert (s.right_or_tie.hits, s.right_or_tie.of) == (2, 3)
    assert (s.inside.hits, s.inside.of) == (1, 2)
    assert (s.both.hits, s.both.of) == (0, 1)
    assert (s.worse.hits, s.worse.of) == (1, 3)  # the one that says so is not among them
    assert "Falls short: crashed: 1 of 6" in verdict(s)
    assert {t.rate for t in TARGETS} <= set(vars(s))


def test_errors_are_compared_over_records_and_channels_and_runs_that_did_not_last_are_left_out():
    errors = {"one-second": {"r, a": [1.0, 2.0], "s, a": [2.0, 1.0]}, "full-run": {"r, a": [1.0, None], "s, a": [1.0, 1.1]}}
    assert ratios(row(errors=errors)) == pytest.approx({"one-second": 1.0, "full-run": 1.1})
    assert worse(row(errors=errors)) == ["full-run"]
    said = "cart is unstable, what is off grows e-fold in 0.2 s: free runs are compared up to 1 s ahead"
    assert worse(row(errors=errors, notes=[said])) == []
    errors["one-second"] = {"r, a": [1.0, 1.1]}
    assert worse(row(errors=errors, notes=[said])) == ["one-second"]


# ---- cases that end without an answer --------------------------------------------------------------------------------------


@pytest.fixture
def drawn():
    t = np.arange(100)
    records = Dataset(
        tuple(Experiment.from_arrays(f"r{k}", 0.001, inputs={"V": np.sin(t + k)}, outputs={"a": np.cos(t + k)}) for k in range(2))
    )
    return SimpleNamespace(machine="servo", records=Dataset(records.experiments[:1]), held_out=Dataset(records.experiments[1:]))


def test_a_typed_refusal_is_refused_with_its_message(drawn, tmp_path, monkeypatch):
    monkeypatch.setattr(answers, "command", lambda words, spoken: (_ for _ in ()).throw(InputError("no sound", mend="none")))
    found = answer(drawn, tmp_path)
    assert found.keys() == {"refused", "seconds"}
    assert "no sound" in found["refused"]


def test_any_other_exception_is_a_crash_with_its_traceback(drawn, tmp_path, monkeypatch):
    monkeypatch.setattr(answers, "command", lambda words, spoken: np.linalg.cholesky(-np.eye(2)))
    found = answer(drawn, tmp_path)
    assert found.keys() == {"crashed", "seconds"}
    assert "LinAlgError" in found["crashed"].splitlines()[-1]


def test_records_that_the_command_refuses_come_back_as_refused(tmp_path):
    """The real command, on a record that is too short."""
    t = np.arange(12)
    one, other = (
        Dataset((Experiment.from_arrays("r", 0.001, inputs={"V": f(t)}, outputs={"a": f(2 * t)}),)) for f in (np.sin, np.cos)
    )
    found = answer(SimpleNamespace(machine="servo", records=one, held_out=other), tmp_path)
    assert "too short" in found["refused"]


# ---- the table ---------------------------------------------------------------------------------------------------------------


def test_a_run_goes_on_where_it_stopped_and_refuses_rows_of_another_version(tmp_path, monkeypatch):
    made = []

    def one(seed, configuration):
        made.append(seed)
        return row(truth=[A], causes=[cause(A)]) | {"seed": seed, "configuration": configuration}

    monkeypatch.setattr(strangers, "run_case", one)
    run(tmp_path, [1, 2])
    assert [r["seed"] for r in run(tmp_path, [1, 2, 3])] == [1, 2, 3]
    assert made == [1, 2, 3]
    table = tmp_path / "cases.jsonl"
    table.write_text(json.dumps(row() | {"configuration": "other"}) + "\n", encoding="utf-8")
    with pytest.raises(InputError, match="another version"):
        run(tmp_path, [4])


def test_the_page_tells_every_case_and_hides_none(tmp_path, monkeypatch):
    rows = {
        10**6: row(truth=[A], causes=[cause(A)], errors={"one-second": {"r, a": [1.0, 1.2]}}),
        10**6 + 1: {
            k: v for k, v in row(truth=[B], crashed="Traceback\nKeyError: 'z'").items() if k not in ("verdict", "causes")
        },
        10**6 + 2: row("nothing", verdict="named", causes=[cause(C)]),
    }
    monkeypatch.setattr(
        strangers, "run_case", lambda seed, configuration: rows[seed] | {"seed": seed, "configuration": configured()}
    )
    heard = []
    page = strangers.main(folder=tmp_path, cases=3, say=heard.append).read_text(encoding="utf-8")
    for word in ("KeyError", "sensor-lag@a", "1000002", "Worse than what was given"):
        assert word in page
    assert "confident wrong name: 1 of 2" in heard[0]
    assert json.loads((tmp_path / "summary.json").read_text())["summary"]["all"]["outcomes"]["crashed"] == 1
    assert all(said(r | {"seed": s}) for s, r in rows.items())


def test_the_zoo_is_found_beside_the_studies():
    assert len(zoo().registry.MACHINES) >= 14
