"""Errors that name the place, what was expected, and the mend."""

from collections.abc import Iterable
from difflib import get_close_matches


class InputError(ValueError):
    """Bad input from a person: a file, an option, a channel. The command line ends with exit code 2.

    >>> print(InputError("gap of 1 s", file="a.csv", line=7, mend="cut the file there"))
    a.csv, line 7: gap of 1 s
      mend: cut the file there
    """

    def __init__(
        self,
        problem: str,
        *,
        file: object = None,
        line: int | None = None,
        channel: str | None = None,
        mend: str = "",
    ):
        self.problem, self.file, self.line, self.channel, self.mend = problem, file, line, channel, mend
        place = ", ".join(
            ([str(file)] if file is not None else [])
            + ([f"line {line}"] if line is not None else [])
            + ([f"channel {channel}"] if channel else [])
        )
        message = f"{place}: {problem}" if place else problem
        super().__init__(f"{message}\n  mend: {mend}" if mend else message)


def check_known(kind: str, name: str, known: Iterable[str], *, file: object = None) -> str:
    """Return `name` if it is one of `known`; otherwise refuse it with the nearest match.

    Of channels as short as `w3` every other one is near: there only another case or a letter too many counts as a slip.
    """
    known = list(known)
    if isinstance(name, str) and name in known:
        return name
    if not isinstance(name, str):  # what a file holds may be anything
        raise InputError(f"{kind} {name!r} is no name", file=file, mend=f"known: {', '.join(known)}")
    near = [other for other in known if other.lower() == name.lower()]
    near += [other for other in known if other and name.startswith(other)]
    if not near and (len(name) > 3 or kind != "channel"):
        near = get_close_matches(name, known, n=1, cutoff=0.6)
    listed = f"known: {', '.join(known)}"
    raise InputError(f"unknown {kind} {name!r}", file=file, mend=f"did you mean {near[0]!r}? {listed}" if near else listed)


class NotHandedOutError(InputError):
    """An answer that the referee does not hand out: it loses against what it replaces, or loses the loop that it is for."""
