"""Spoilt files never end in anything but a refusal in words, and that soon.

`python -m tests.fuzz.run SECONDS` goes on where these examples end.
"""

import json
import re
import tempfile
from pathlib import Path
from random import Random
from typing import Any

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from tests.fuzz.spoil import spoilt
from tests.fuzz.targets import targets
from workbench import formats, readers
from workbench.errors import InputError

JSON = ("model", "hammerstein", "interval", "pid", "mpc", "extension", "diagnosis", "counterexample", "sequence", "report")
NAMES = ("csv", "mat", "limits", "sweep", *JSON)


@pytest.fixture(scope="module")
def every():
    with tempfile.TemporaryDirectory() as folder:
        yield targets(Path(folder))


def test_every_target_reads_its_whole_file(every, tmp_path):
    assert tuple(every) == NAMES
    for name, target in every.items():
        path = tmp_path / f"{name}{target.ending}"
        path.write_bytes(target.seed)
        assert target.read(path) is not None


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=100, deadline=10_000, suppress_health_check=list(HealthCheck))
@given(seed=st.integers(0, 2**48))
@example(seed=930)  # an MPC whose outputs leave the numbers
def test_a_spoilt_file_is_read_or_refused(every, name, seed):
    if name == "mat" and seed % 4:
        return  # it is read by a process of its own: as many would take a minute
    target, random = every[name], Random(seed)
    for _ in range(3):
        with tempfile.TemporaryDirectory() as folder:
            target.tried(Path(folder), spoilt(target.seed, target.ending, random))


@pytest.mark.parametrize("number", ["9" * 400, "-" + "9" * 400, "inf", "nan", "1e999"])
@pytest.mark.parametrize("name", ["limits", "sweep"])
def test_a_number_beyond_all_floats_at_any_place_is_read_or_refused(every, name, number, tmp_path):
    target = every[name]
    text = target.seed.decode()
    places = [match.span() for match in re.finditer(r"(?<![\w.])-?\d+(?:\.\d+)?(?![\w.])", text)]
    assert len(places) > 3
    for start, end in places:
        target.tried(tmp_path, (text[:start] + number + text[end:]).encode())


def _places(content, at=()):
    """Where a JSON value stands: itself, and all in it, of lists the first and the last."""
    yield at
    if isinstance(content, dict):
        for key in content:
            yield from _places(content[key], (*at, key))
    elif isinstance(content, list) and content:
        for k in sorted({0, len(content) - 1}):
            yield from _places(content[k], (*at, k))


@pytest.mark.parametrize("other", [[], {}, None, "x", True, -1, 0, [[1.0]]], ids=repr)
@pytest.mark.parametrize("name", JSON)
def test_a_value_of_another_kind_at_any_place_is_read_or_refused(every, name, other, tmp_path):
    target = every[name]
    for place in _places(json.loads(target.seed)):
        content: Any = {"all": json.loads(target.seed)}
        holder, key = content, "all"
        for step in place:
            holder, key = holder[key], step
        holder[key] = other
        target.tried(tmp_path, json.dumps(content["all"]).encode())


def test_an_infinite_place_in_a_model_is_a_refusal(every, tmp_path):
    """What 15 000 spoilt files have found: a number beyond all floats where an index stands."""
    content = json.loads(every["model"].seed)
    content["terms"][0]["function"] = 10**400
    path = tmp_path / "m.json"
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match="malformed model"):
        every["model"].read(path)


@pytest.mark.parametrize("which", ["outputs", "moves", "inputs"])
@pytest.mark.parametrize("weight", [1e200, float("inf")])
def test_a_weight_whose_products_are_beyond_all_floats_is_a_refusal(every, tmp_path, which, weight):
    """Infinity times the zeros beside a diagonal is no number, and said so in a warning of numpy's."""
    content = json.loads(every["mpc"].seed)
    content["weights"][which][-1] = weight
    path = tmp_path / "mpc.json"
    path.write_text(json.dumps(content))
    with pytest.raises(InputError):
        every["mpc"].read(path)


def test_a_crash_of_the_reader_of_mat_files_is_a_refusal(tmp_path, monkeypatch):
    killer = tmp_path / "killer.py"
    killer.write_text("import os, signal\nos.kill(os.getpid(), signal.SIGSEGV)\n")
    monkeypatch.setattr(formats, "LOADER", killer)
    (tmp_path / "a.mat").write_bytes(b"MATLAB 5.0")
    with pytest.raises(InputError, match=r"(?s)cannot be read as a MAT file \(crash of its reader\).*is the file whole"):
        readers.read_file(tmp_path / "a.mat")
