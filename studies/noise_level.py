"""How much of its accuracy does each method lose when the sensors are noisier?

LTI, ILM and SSM models of the web winding machine, identified from two records and run free on two others, at several levels of
the sensors' noise. The true machine, driven by the same logged voltages, is what no model beats by more than luck.
"""

import numpy as np

from studies.jobs.identification import Identification
from studies.jobs.recorded import Recorded
from studies.question import Answer, Question, Runs, drawn, study
from workbench.report import figures
from workbench.report.blocks import Table
from workbench.sweeps.design import Factor, Sweep

MODELS = ("lti", "ilm", "ssm")
ESTIMATION, HELD_OUT = ("prbs1", "rbs"), ("sine", "rgs")
OUTPUT = "w3"
LEVELS, QUICK = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0), (0.5, 2.0, 8.0)
SEEDS, QUICK_SEEDS = 8, 2

Groups = list[tuple[np.ndarray, np.ndarray]]


def asked(quick: bool, seed: int) -> Question:
    """FIT over noise, by model."""
    factors = (Factor("model", MODELS), Factor("noise", QUICK if quick else LEVELS))
    sweep = drawn(Sweep("identification", factors), seed, QUICK_SEEDS if quick else SEEDS)
    logged = Recorded("web-winding", ESTIMATION, ("V1", "V2"), (OUTPUT,), "r2")
    job = Identification(logged, HELD_OUT, {}, MODELS, ("model", "noise"))
    return Question("noise-level", "Noise of the sensors and the FIT of models", sweep, job, read)


def read(runs: Runs) -> Answer:
    """Which model is best at which noise."""
    levels, model = runs.levels("noise"), runs.texts("model")
    fits = {name: runs.medians("noise", f"{OUTPUT} FIT", model == name) for name in MODELS}
    machine = runs.medians("noise", f"{OUTPUT} machine FIT")
    curves = {name.upper(): runs.groups("noise", "noise", f"{OUTPUT} FIT", model == name) for name in MODELS}
    curves["true machine"] = runs.groups("noise", "noise", f"{OUTPUT} machine FIT", model == MODELS[0])
    picture = figures.courses(
        "Free-run FIT on records that no model has seen", runs.channel("noise"),
        {f"{OUTPUT} FIT [%]": curves, "short of the true machine [points]": _short(curves)},
        f"Two held-out records each, {OUTPUT}; noise as a multiple of the machine's own.", log=True,
    )  # fmt: skip
    rows = tuple(zip(levels.tolist(), *(own.tolist() for own in fits.values()), machine.tolist(), strict=True))
    header = ("noise", *(f"{name.upper()} [%]" for name in MODELS), "true machine [%]")
    table = Table("FIT by noise", header, rows, caption="Medians of free runs on held-out records.", digits=3)
    return Answer(_verdict(levels, fits, machine), (picture, table))


def _short(curves: dict[str, Groups]) -> dict[str, Groups]:
    """By how much each model falls short of the median of the true machine."""
    reached = [float(np.nanmedian(y)) for _, y in curves["true machine"]]
    return {
        name: [(x, most - y) for most, (x, y) in zip(reached, groups, strict=True)]
        for name, groups in curves.items()
        if name != "true machine"
    }


def _verdict(levels: np.ndarray, fits: dict[str, np.ndarray], machine: np.ndarray) -> str:
    said = []
    for i in sorted({0, int(np.abs(np.log(levels)).argmin()), len(levels) - 1}):
        each = ", ".join(f"{name.upper()} {f'{own[i]:.1f} %' if np.isfinite(own[i]) else 'failed'}" for name, own in fits.items())
        said.append(f"At {levels[i]:g} times the noise of the sensors: {each} (the true machine {machine[i]:.1f} %).")
    table = np.array([fits[name] for name in MODELS])
    best = [
        MODELS[k] if np.isfinite(table[:, i]).all() else "" for i, k in enumerate(np.nan_to_num(table, nan=-np.inf).argmax(0))
    ]
    if len({*best}) == 1 and best[0]:
        gap = np.min(table[MODELS.index(best[0])] - np.delete(table, MODELS.index(best[0]), axis=0).max(axis=0))
        said.append(f"{best[0].upper()} is best at every level, by {gap:.1f} points of FIT or more.")
    else:
        changes = "; ".join(f"{x:g}: {name.upper() or 'a method failed'}" for x, name in zip(levels, best, strict=True))
        said.append(f"The best one by noise: {changes}.")
    return " ".join(said)


main = study(asked)
