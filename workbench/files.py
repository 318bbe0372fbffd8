"""Files that are whole or absent: everything is written to a temporary name and then renamed."""

import hashlib
import json
import os
import re
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from workbench.errors import InputError


def write_text(path: str | Path, text: str) -> Path:
    """Write `text` (UTF-8) so that `path` holds either all of it or what it held before."""
    return write_bytes(path, text.encode())


def write_bytes(path: str | Path, content: bytes) -> Path:
    """Write `content` so that `path` holds either all of it or what it held before."""
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    except OSError as reason:
        raise InputError(f"cannot write: {reason.strerror}", file=path, mend="choose another --out folder") from None
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(content)
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except OSError as reason:
        raise InputError(f"cannot write: {reason.strerror}", file=path, mend="free some space or choose --out") from None
    finally:
        Path(temporary).unlink(missing_ok=True)
    return path


def write_json(path: str | Path, content: Any) -> Path:
    """Write plain numbers, lists and dictionaries; arrays become lists, a row a line; NaN is refused."""
    text = _text(content)
    rows = re.sub(r"\[[^\[\]{}\"]*\]", lambda row: " ".join(row.group().split()), text)
    return write_text(path, rows + "\n")


def as_read(content: Any) -> Any:
    """What reading a file with this content gives."""
    return json.loads(_text(content), parse_int=_whole)


def _text(content: Any) -> str:
    return json.dumps(content, default=_plain, indent=1, allow_nan=False)


def nullable(content: Any) -> Any:
    """The same with null for every number that is none: JSON has no NaN."""
    match content:
        case dict():
            return {key: nullable(value) for key, value in content.items()}
        case list() | tuple():
            return [nullable(value) for value in content]
        case np.ndarray():
            return nullable(content.tolist())
        case float() | np.floating():
            return float(content) if np.isfinite(content) else None
        case _:
            return content


def read_text(path: str | Path) -> str:
    """The text (UTF-8) of a file that this program has written, its line ends as they are."""
    try:
        with open(path, encoding="utf-8", newline="") as stream:
            return stream.read()
    except UnicodeDecodeError:
        raise InputError("not a text file", file=path, mend="expected UTF-8") from None
    except OSError as reason:
        raise InputError(f"cannot read: {reason.strerror}", file=path, mend="check the path") from None


def read_json(path: str | Path) -> Any:
    """Read a JSON file; a broken one is refused with its line."""
    try:
        return json.loads(read_text(path), parse_int=_whole)
    except json.JSONDecodeError as reason:
        raise InputError(f"not JSON: {reason.msg}", file=path, line=reason.lineno, mend="is the file whole?") from None


def _whole(text: str) -> int | float:
    """An integer, or infinity of this sign where no float could hold it."""
    return int(text) if len(text) < 300 else float(text)


def user_cache(name: str) -> Path | None:
    """A folder of this program under $WORKBENCH_CACHE or the user's cache folder; None where it cannot be written."""
    root = os.environ.get("WORKBENCH_CACHE") or os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    folder = Path(root) / "gain-scheduling-workbench" / name
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    return folder if os.access(folder, os.W_OK) else None


def sha256(path: str | Path) -> str:
    """Hash of a file's content, as quoted in provenance."""
    with open(path, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"cannot write {type(value).__name__} as JSON")
