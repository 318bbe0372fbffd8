"""The last word before an answer is handed out: 3 where the referee objects, unless the user takes it all the same (--accept)."""

from collections.abc import Callable, Sequence

from studies.cli import DONE, NOT_HANDED_OUT


def handed_out(objections: Sequence[str], accept: bool, say: Callable[[str], None]) -> int:
    """Say each objection, a sentence that names the run or the record; the exit code: DONE, or NOT_HANDED_OUT.

    A command asks before it says or writes anything else, so that the objection is the first line, and writes the answer's own
    file only where this is DONE. accept: the user's --accept, which takes an answer with objections all the same.
    """
    for objection in objections:
        say(f"{'ACCEPTED ALL THE SAME' if accept else 'NOT HANDED OUT'}: {objection}")
    if not objections or accept:
        return DONE
    say("  --accept takes it all the same")
    return NOT_HANDED_OUT
