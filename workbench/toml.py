"""TOML files, read key by key: what is unknown, missing or makes no sense is refused with table, key and what was expected."""

import math
import sys
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from workbench.errors import InputError, check_known


def read_toml(path: str | Path, known: Sequence[str] | None = None) -> "Table":
    """The file's own keys, of which only those `known` are allowed. Raises InputError for a file that is no TOML."""
    path = Path(path)
    try:
        content = _as_floats(tomllib.loads(path.read_text(encoding="utf-8")))
    except tomllib.TOMLDecodeError as reason:
        raise InputError(f"not TOML: {reason}", file=path, mend="texts and times in quotes? one key a line?") from None
    except UnicodeDecodeError:
        raise InputError("not a text file", file=path, mend="expected TOML in UTF-8") from None
    except (ValueError, RecursionError) as reason:
        raise InputError(f"not TOML that makes sense: {reason}", file=path, mend="a number of thousands of digits?") from None
    except OSError as reason:
        raise InputError(f"cannot read: {reason.strerror}", file=path, mend="check the path") from None
    return Table(path, "", content, known)


def _as_floats(content: Any) -> Any:
    """The same with an infinity of its sign for every whole number that no float holds: it may have hundreds of digits."""
    if isinstance(content, dict):
        return {key: _as_floats(value) for key, value in content.items()}
    if isinstance(content, list):
        return [_as_floats(value) for value in content]
    if isinstance(content, int) and abs(content) > sys.float_info.max:
        return math.inf if content > 0 else -math.inf
    return content


class Table:
    """A table of a TOML file, read key by key."""

    def __init__(self, file: Path, name: str, content: Any, known: Sequence[str] | None):
        self.file, self.name, self.content = file, name, content
        if not isinstance(content, dict):
            raise InputError(f"{name} is {kind(content)}", file=file, mend=f"expected a table: [{name}]")
        for key in content if known is not None else ():
            check_known(f"key in [{name}]" if name else "table", key, known or (), file=file)

    def refused(self, key: str, what: str, expected: str) -> InputError:
        return InputError(f"[{self.name}] {key} = {what}" if self.name else f"{key} = {what}", file=self.file, mend=expected)

    def table(self, key: str, known: Sequence[str] | None) -> "Table":
        return Table(self.file, f"{self.name}.{key}" if self.name else key, self.content.get(key, {}), known)

    def number(self, key: str) -> float | None:
        """A finite number, None where there is none."""
        if key not in self.content:
            return None
        value = self.content[key]
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.refused(key, kind(value), "expected a number")
        if not math.isfinite(value):
            raise self.refused(key, f"{value}"[:40], "expected a finite number; leave out what has no bound")
        return float(value)

    def positive(self, key: str) -> float | None:
        value = self.number(key)
        if value is not None and value <= 0.0:
            raise self.refused(key, f"{value:g}", "expected a number above 0")
        return value

    def time(self, key: str) -> float | None:
        value = self.number(key)
        if value is not None and value < 0.0:
            raise self.refused(key, f"{value:g}", "expected seconds from the start of the run, 0 or later")
        return value

    def whole(self, key: str, default: int) -> int:
        """A whole number from 0 on."""
        value = self.content.get(key, default)
        if type(value) is not int or not 0 <= value < 2**63:
            raise self.refused(key, kind(value)[:40], "expected a whole number from 0 on")
        return value

    def text(self, key: str, default: str | None) -> str:
        """A text; without a default it must be there."""
        value = self.content.get(key, default)
        if value is None:
            raise InputError(f"{key} is missing", file=self.file, mend=f'give {key} = "..."')
        if not isinstance(value, str):
            raise self.refused(key, kind(value), "expected a text")
        return value

    def texts(self, key: str, default: Sequence[str] | None = None) -> tuple[str, ...]:
        """A list of texts; without a default it must be there."""
        value = self.content.get(key, default)
        if value is None:
            raise InputError(f"{key} is missing", file=self.file, mend=f'give {key} = ["..", ".."]')
        if isinstance(value, str) or not isinstance(value, Sequence) or not all(isinstance(text, str) for text in value):
            raise self.refused(key, kind(value), "expected a list of texts")
        return tuple(value)

    def flag(self, key: str, default: bool) -> bool:
        value = self.content.get(key, default)
        if not isinstance(value, bool):
            raise self.refused(key, kind(value), "expected true or false")
        return value


def kind(value: Any) -> str:
    """A value as it is told in a message."""
    if isinstance(value, str | int | float):
        return repr(value)
    return "a list" if isinstance(value, list) else f"a {type(value).__name__}"
