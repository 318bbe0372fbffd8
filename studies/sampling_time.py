"""How fast must a PID be sampled?

The web winding machine recorded, identified, and run under a scheduled PID, everything at one sample time, for several: what
bandwidth and margin a design reaches, and how well speed and tension keep their set-points. Errors are taken at the samples.
"""

import numpy as np

from studies.jobs.pid_design import DesignedLoop
from studies.pid_bandwidth import LIMITS, MARGIN, OTHER, QUALITY, RECORDED, RUN
from studies.question import NOWHERE, Answer, Question, Runs, drawn, study, told, whole
from workbench.report import figures
from workbench.sweeps.design import Factor, Sweep

TIMES, QUICK = (0.01, 0.02, 0.03, 0.04, 0.06, 0.08, 0.12), (0.02, 0.04, 0.08)  # s
SEEDS, QUICK_SEEDS = 4, 1
FREE = 1.1  # times the smallest error


def asked(quick: bool, seed: int) -> Question:
    """Bandwidth, margins and errors over the sample time."""
    sweep = drawn(Sweep("pid-design", (Factor("dt", QUICK if quick else TIMES),)), seed, QUICK_SEEDS if quick else SEEDS)
    job = DesignedLoop(RECORDED, RUN, LIMITS, {"order": 6.0, "knots": 2.0 if quick else 3.0}, ("dt",))
    return Question("sampling-time", "Sample time of a PID, its bandwidth, and the tension", sweep, job, read)


def read(runs: Runs) -> Answer:
    """The slowest sampling that costs little."""
    shown = ("bandwidth", MARGIN, "integral action", QUALITY, OTHER, "V1 travel")
    panels = {str(runs.channel(name)): {"runs": runs.groups("dt", "dt", name)} for name in shown}
    picture = figures.courses(
        "Over the sample time", runs.channel("dt"), panels,
        "Worst bandwidth, delay margin and integral action over the radius; errors and travel in a run of the machine.",
    )  # fmt: skip
    table = runs.table("By sample time", "dt", shown[:5], "Medians.")
    return Answer(_verdict(runs), (picture, table))


def _verdict(runs: Runs) -> str:
    times, error, band = whole(runs.levels("dt"), runs.medians("dt", QUALITY), runs.medians("dt", "bandwidth"))
    if not len(times):
        return NOWHERE
    best = int(np.argmin(error))
    worse = np.flatnonzero(error[best:] > FREE * error[best])
    slowest = best + int(worse[0]) - 1 if len(worse) else len(times) - 1
    unit, name = runs.channel(QUALITY).unit, QUALITY.split()[0]
    said = (
        f"The RMS error of {name} is least, {told(error[best], unit)}, at a sample time of {told(1e3 * times[best], 'ms')} "
        f"(bandwidth {told(band[best], 'rad/s')})"
    )
    if slowest > best:
        near = told(error[slowest], unit)
        said += f", and within {100 * (FREE - 1):.0f} % of that up to {told(1e3 * times[slowest], 'ms')} ({near})"
    if slowest < len(times) - 1:
        said += f"; at {told(1e3 * times[-1], 'ms')} it is {told(error[-1], unit)}, the bandwidth {told(band[-1], 'rad/s')}"
    else:
        said += "; no slower sampling came to an end or was tried"
    return f"{said}."


main = study(asked)
