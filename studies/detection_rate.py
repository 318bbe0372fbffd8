"""How small an effect does the diagnosis find?

Dry friction of many sizes, hidden in records of the welding robot: how often it is found, named alone, and whether anything wrong
is named. The diagnosis says itself which size the records show; here is what becomes of that.
"""

import numpy as np

from studies.hidden_scores import Share
from studies.jobs.detection import Detection
from studies.jobs.recorded import Recorded
from studies.question import Answer, Question, Runs, drawn, study, told
from workbench.report import figures
from workbench.report.blocks import Table
from workbench.sweeps.design import Factor, Sweep

EFFECT = "coulomb@rail:level"
SIZES, QUICK = tuple(float(f"{x:.2g}") for x in np.geomspace(3e-4, 1e-2, 8)), (5e-4, 1.5e-3, 5e-3)  # N
SEEDS, QUICK_SEEDS = 20, 4
SURE = 0.95


def asked(quick: bool, seed: int) -> Question:
    """Found and named over the size; size 0: nothing is hidden."""
    factors = (Factor("size", (0.0, *(QUICK if quick else SIZES))),)
    sweep = drawn(Sweep("detection", factors), seed, QUICK_SEEDS if quick else SEEDS)
    job = Detection(Recorded("welding-robot", ("prbs", "rbs")), EFFECT, {}, ("size",))
    return Question("detection-rate", "Size of an effect and how often it is found", sweep, job, read)


def read(runs: Runs) -> Answer:
    """From which size on it is found."""
    size = runs["size"]
    sizes = [level for level in runs.levels("size") if level > 0.0]
    # a case that could not be diagnosed is a miss
    shares = {name: [_share(np.nan_to_num(runs[name][size == level])) for level in sizes] for name in ("found", "named")}
    unit = runs.channel("size").unit
    picture = figures.rates(
        f"{EFFECT} found", f"size [{unit}]", {name: _rates(sizes, own) for name, own in shares.items()},
        "Found: named, or one of a tie. Named: alone.",
    )  # fmt: skip
    rows = tuple(
        (level, *(str(_share(runs[name][size == level])) for name in ("found", "named", "wrong")), estimate, limit)
        for level, estimate, limit in zip(
            runs.levels("size"), runs.medians("size", "estimate"), runs.medians("size", "limit"), strict=True
        )
    )
    header = (f"size [{unit}]", "found", "named alone", "wrong cause", f"estimate [{unit}]", f"limit [{unit}]")
    caption = "Estimate and limit: medians; limit: the smallest size that the diagnosis says these records show."
    return Answer(_verdict(runs, sizes, shares), (picture, Table("By size", header, rows, caption=caption, digits=3)))


def _verdict(runs: Runs, sizes: list[float], shares: dict[str, list[Share]]) -> str:
    size, unit = runs["size"], runs.channel("size").unit
    quiet, hidden = size == 0.0, size > 0.0
    limit = float(np.nanmedian(runs["limit"][quiet])) if np.isfinite(runs["limit"][quiet]).any() else float("nan")
    sure = [x for i, x in enumerate(sizes) if all(s.rate >= SURE for s in shares["found"][i:])]
    seen = np.isfinite(limit)
    said = f"Where nothing is hidden, the diagnosis says that it sees dry friction from {told(limit, unit)} on. " if seen else ""
    if sure:
        times = f", {sure[0] / limit:.2g} times that" if seen else ""
        said += f"It finds {100 * SURE:.0f} % or more from {told(sure[0], unit)} on{times}. "
    else:
        said += f"None of these sizes is found in {100 * SURE:.0f} % of the cases or more. "
    inside = runs["inside"][hidden]
    return said + (
        f"A cause that is not there is named in {_share(runs['wrong'][quiet])} of the records without any effect, and in "
        f"{_share(runs['wrong'][hidden])} of those with one. The true size is inside its 95 % interval in {_share(inside)}."
    )


def _share(values: np.ndarray) -> Share:
    own = values[np.isfinite(values)]
    return Share(int(own.sum()), len(own))


def _rates(sizes: list[float], shares: list[Share]) -> figures.Rates:
    low, high = np.transpose([s.interval for s in shares])
    return figures.Rates(np.array(sizes), np.array([s.rate for s in shares]), low, high, np.array([s.of for s in shares]))


main = study(asked)
