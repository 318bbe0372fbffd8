"""Files are whole or absent, and broken JSON is refused with its line."""

import hashlib
import os

import numpy as np
import pytest

from workbench.errors import InputError
from workbench.files import read_json, sha256, write_json, write_text


def test_text_is_written_as_it_is_in_new_folders_and_over_old_files(tmp_path):
    path = tmp_path / "new" / "deep" / "a.txt"
    write_text(path, "old")
    assert write_text(path, "ä\nb\n") == path
    assert path.read_bytes() == "ä\nb\n".encode()
    assert [p.name for p in path.parent.iterdir()] == ["a.txt"]


def test_a_write_that_fails_leaves_the_old_content_and_nothing_else(tmp_path, monkeypatch):
    path = write_text(tmp_path / "a.txt", "old")

    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(InputError, match="No space left"):
        write_text(path, "new")
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_that_cannot_be_made_is_named(tmp_path):
    blocker = write_text(tmp_path / "a", "a file")
    with pytest.raises(InputError, match="cannot write"):
        write_text(blocker / "b.txt", "text")


def test_json_keeps_numbers_bit_for_bit_and_refuses_nan(tmp_path):
    numbers = np.array([0.1, 1 / 3, 1e-300, -0.0])
    path = write_json(tmp_path / "a.json", {"x": numbers, "n": np.int64(3), "p": tmp_path})
    back = read_json(path)
    np.testing.assert_array_equal(back["x"], numbers)
    assert (back["n"], back["p"]) == (3, str(tmp_path))
    with pytest.raises(ValueError, match="JSON"):
        write_json(tmp_path / "b.json", {"x": float("nan")})
    with pytest.raises(TypeError, match="object"):
        write_json(tmp_path / "b.json", {"x": object()})
    assert not (tmp_path / "b.json").exists()


def test_broken_json_is_refused_with_its_line(tmp_path):
    with pytest.raises(InputError) as caught:
        read_json(write_text(tmp_path / "a.json", '{"x": 1,\n "y": }'))
    assert (caught.value.line, caught.value.file) == (2, tmp_path / "a.json")
    (tmp_path / "b.json").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not a text file"):
        read_json(tmp_path / "b.json")
    with pytest.raises(InputError, match="cannot read"):
        read_json(tmp_path / "none.json")


def test_the_hash_is_that_of_the_content(tmp_path):
    path = write_text(tmp_path / "a.txt", "abc")
    assert sha256(path) == hashlib.sha256(b"abc").hexdigest()
