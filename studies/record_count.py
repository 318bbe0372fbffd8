"""How many records does a guaranteed envelope need?

An interval model holds every record that it was made from. With more records its envelopes grow wider, and hold more of the
records that it was not made from: one-step envelopes of the web winding machine's speed, a box for each of five ranges of the
radius.
"""

from studies.jobs.identification import Identification
from studies.jobs.recorded import Recorded
from studies.question import NOWHERE, Answer, Question, Runs, drawn, study, whole
from workbench.report import figures
from workbench.sweeps.design import Factor, Sweep

ESTIMATION, HELD_OUT = ("rbs", "rgs", "prbs1", "sine"), ("rbs", "rgs")
OUTPUT = "w3"
COUNTS, QUICK = (1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0), (1.0, 2.0, 4.0)
SEEDS, QUICK_SEEDS = 10, 3
ENOUGH = 99.9  # % of values inside


def asked(quick: bool, seed: int) -> Question:
    """Width and truth of the envelope over the number of records."""
    factors = (Factor("records", QUICK if quick else COUNTS),)
    sweep = drawn(Sweep("identification", factors), seed, QUICK_SEEDS if quick else SEEDS)
    logged = Recorded("web-winding", ESTIMATION, ("V1", "V2"), (OUTPUT,), "r2")
    job = Identification(logged, HELD_OUT, {}, ("interval",), ("records",))
    return Question("record-count", "Number of records and the width of an envelope", sweep, job, read)


def read(runs: Runs) -> Answer:
    """From how many records on the envelope can be relied on, and what they cost in width."""
    width, inside = f"{OUTPUT} width", f"{OUTPUT} inside"
    unit = runs.channel(width).unit
    panels = {
        f"mean half-width [{unit}]": {"runs": runs.groups("records", "records", width)},
        "held-out values inside [%]": {"runs": runs.groups("records", "records", inside)},
    }
    picture = figures.courses(
        "Envelopes over the number of records", runs.channel("records"), panels,
        f"One step ahead, {OUTPUT}, {' and '.join(HELD_OUT)} drawn anew as held-out records.",
    )  # fmt: skip
    table = runs.table("By number of records", "records", (width, inside), "Medians over the draws of the records.")
    return Answer(_verdict(runs, width, inside, unit), (picture, table))


def _verdict(runs: Runs, width: str, inside: str, unit: str) -> str:
    counts, wide, held = whole(runs.levels("records"), runs.medians("records", width), runs.medians("records", inside))
    if not len(counts):
        return NOWHERE
    first = f"{counts[0]:g} record" + ("s" if counts[0] > 1 else "")
    said = (
        f"From {first} the envelope of {OUTPUT} holds {held[0]:.2f} % of values that it was not made from, at a mean half-width "
        f"of {wide[0]:.3g} {unit}; from {counts[-1]:g} records {held[-1]:.2f} % at {wide[-1]:.3g} {unit}."
    )
    enough = [count for i, count in enumerate(counts) if (held[i:] >= ENOUGH).all()]
    if enough:
        return f"{said} From {enough[0]:g} records on {ENOUGH:g} % or more are inside."
    return f"{said} None of these reaches {ENOUGH:g} %: what an envelope promises, it promises of its own records."


main = study(asked)
