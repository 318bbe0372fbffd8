"""How fast should a PID be? Bandwidth against margins and tension.

Scheduled PIDs for the web winding machine, designed as brisk as a bound on |S| and |T| allows, for several bounds: what bandwidth
each reaches, what margin is left, and how well speed and tension keep their set-points on the machine itself. Every run has
records, a model and noise of its own.
"""

import numpy as np

from studies.jobs.pid_design import DesignedLoop
from studies.jobs.recorded import Recorded
from studies.question import NOWHERE, Answer, Question, Runs, drawn, study, told, whole
from workbench.data import Channel
from workbench.report import figures
from workbench.robustness.limits import Manoeuvre
from workbench.sweeps.design import Factor, Sweep

PEAKS, QUICK = (1.06, 1.1, 1.15, 1.25, 1.4, 1.6, 1.8, 2.1, 2.5), (1.1, 1.4, 2.0)
SEEDS, QUICK_SEEDS = 4, 1
QUALITY, OTHER = "theta RMS", "w3 RMS"
MARGIN = "delay margin"
FREE = 1.05  # times the smallest error, which a calmer law may cost
LIMITS = {"low": {"V1": -2.0, "V2": 0.0}, "high": {"V1": 3.0, "V2": 3.0}, "rate": {"V1": 50.0, "V2": 50.0}}
SETPOINTS = {"w3": ((0.0, 100.0), (8.0, 105.0), (30.0, 100.0)), "theta": ((0.0, 0.0), (16.0, 5.0), (38.0, 0.0))}
RUN = Manoeuvre(50.0, SETPOINTS)
RECORDED = Recorded("web-winding", ("prbs1", "rbs"), ("V1", "V2"), ("w3", "theta"), "r2")


def asked(quick: bool, seed: int) -> Question:
    """Bandwidth, margins and errors over the bound on |S| and |T|."""
    sweep = Sweep("pid-design", (Factor("peak", QUICK if quick else PEAKS),))
    sweep = drawn(sweep, seed, QUICK_SEEDS if quick else SEEDS)
    job = DesignedLoop(RECORDED, RUN, LIMITS, {"order": 6.0, "knots": 2.0 if quick else 3.0, "effort": 10.0}, ("peak",))
    return Question("pid-bandwidth", "Bandwidth of a PID, its margins, and the tension", sweep, job, read)


def read(runs: Runs) -> Answer:
    """From where on more bandwidth buys nothing."""
    shown = ("sensitivity", MARGIN, QUALITY, OTHER, "V1 travel", "V2 travel")
    panels = {str(runs.channel(name)): {"runs": runs.groups("peak", "bandwidth", name)} for name in shown}
    picture = figures.courses(
        "Over the bandwidth", Channel("bandwidth", "rad/s", "other"), panels,
        "Worst bandwidth, |S| and delay margin over the radius; errors and travel of the commands in a run of the machine.",
    )  # fmt: skip
    caption = "Medians by the bound on |S| and |T| that the law was designed to."
    table = runs.table("By bound", "peak", ("bandwidth", *shown[:4], "integral action"), caption)
    return Answer(_verdict(runs), (picture, table))


def _verdict(runs: Runs) -> str:
    names = ("bandwidth", QUALITY, MARGIN)
    peaks, band, error, delay = whole(runs.levels("peak"), *(runs.medians("peak", name) for name in names))
    if not len(peaks):
        return NOWHERE
    best = int(np.argmin(error))
    enough = int(np.flatnonzero(error <= FREE * error[best])[0])
    unit = runs.channel(QUALITY).unit
    name = QUALITY.split()[0]
    said = (
        f"From a bandwidth of {told(band[0], 'rad/s')} to {told(band[-1], 'rad/s')} the RMS error of {name} goes from "
        f"{told(error[0], unit)} to {told(error[-1], unit)}, and the delay margin from {told(1e3 * delay[0], 'ms')} to "
        f"{told(1e3 * delay[-1], 'ms')}. The error is least, {told(error[best], unit)}, at {told(band[best], 'rad/s')} "
        f"(|S| and |T| at most {peaks[best]:g})"
    )
    if enough < best:
        said += (
            f"; with {told(band[enough], 'rad/s')} (at most {peaks[enough]:g}) it is no more than {100 * (FREE - 1):.0f} % "
            f"larger, and {told(1e3 * delay[enough], 'ms')} of delay are left instead of {told(1e3 * delay[best], 'ms')}: "
            "that one is to be taken."
        )
    elif best == len(peaks) - 1:
        said += ", the briskest law of all: beyond it was not looked."
    else:
        said += ": more bandwidth makes it worse" + ", and less was not tried." * (best == 0) + "." * (best > 0)
    return said


main = study(asked)
