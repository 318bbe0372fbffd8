"""What does a linear model get wrong on measured records of a winding process, and does it hold on a record that it never saw?

    x+ = A x + B (u - u0) + K e,     y = C x + D (u - u0) + y0 + e,     and effects on the ports of u and y

The records are those of the DaISy collection: a plastic web between three reels, two runs in one file. A linear model is
identified on one run, diagnosed there as a black box, and judged on the other; then the other way round. A cause that only one
run names is no finding about the process.

B. De Moor (ed.), DaISy: Database for the Identification of Systems, KU Leuven; data by T. Bastogne, H. Noura, A. Richard,
J.-M. Hittinger, Universite Henri Poincare, Nancy.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from workbench.answers.answer import PLANT_FILE
from workbench.answers.answer import Records as Split
from workbench.answers.diagnose import DIAGNOSIS_FILE, DiagnosisResult, to_dict
from workbench.answers.verdict import sizes as described
from workbench.data import Channel, Dataset, Experiment
from workbench.diagnosis.answer import Cause, Diagnosis, Finding
from workbench.diagnosis.diagnosis import diagnose
from workbench.diagnosis.gains import HORIZONS, SETTLING, errors, on
from workbench.diagnosis.predictor import predictor
from workbench.diagnosis.recalibrate import recalibrated, unknowns
from workbench.diagnosis.refit import Model
from workbench.diagnosis.stages import stages
from workbench.errors import InputError
from workbench.files import write_json
from workbench.identification import LTI
from workbench.lpv import LPVModel
from workbench.physics.extension import extension
from workbench.physics.identified import identified
from workbench.physics.plant import Plant
from workbench.provenance import provenance
from workbench.records import record
from workbench.report.blocks import Provenance, Report, Section, Table, Text
from workbench.report.page import write_report

Say = Callable[[str], None]
Errors = Mapping[tuple[str, str], float]  # root mean square by output and horizon
Halves = Mapping[tuple[str, str], np.ndarray]  # share of spread by the half of the model and of the record, (ny)

FILE, ROWS, JOINT, DT = "winding.dat", 2500, 1500, 0.1  # s; the second run begins at row 1500
INPUTS, OUTPUTS = ("S1", "S2", "S3", "I1", "I3"), ("T1", "T3")
CHANNELS = tuple(Channel(name, "", "input" if name in INPUTS else "output") for name in (*INPUTS, *OUTPUTS))

SAID = {"one-step": "one step", "one-second": "ten steps", "full-run": "full run"}  # a second is ten samples
FEW = 0.05  # share of a record's samples below which an effect rests on few of them
SHOWN = ("What is missing", "Held-out records", "What is left", "What these records can show", "Notes")

CAVEATS = (
    "No units. Every column of either run was scaled to mean 0 and spread 1, and mixed with the others until the inputs, and the "
    "outputs, were uncorrelated. A column is mostly the channel that it is named after (S1, S2, S3: speeds of unwind, traction "
    "and rewind reel; I1, I3: current set-points; T1, T3: web tensions), with a little of others in it. All sizes here are in "
    "spreads of a column: no radius, no friction, no gain in physical units can be read from them.",
    "Two runs. They were scaled and mixed each by itself, so a model of one carries a small error to the other that is nobody's "
    "physics. They are read as two records; nothing runs across the joint at row 1500. 150 s and 100 s are short: what comes "
    "once in a winding cannot be told from chance.",
    "A black box. The matrices were fitted to the same run without any effect, and have taken in what they could; what is named "
    "is what they could not. Its ports are the logged channels: what sits inside the machine (dry friction, a web that stiffens, "
    "a radius that changes) has no port, and shows only as something left over. S1, S2 and S3 are inputs of the model and yet "
    'measured: where a sentence says "amplifier" of them, it means what lies between the reading and the web.',
    "Not testable: what turns with a reel. An angle is the integral of a speed, and the mean of the speeds was taken away.",
)


@record
class Side:
    """One way round: a model of the run `own`, its diagnosis there, and errors on both runs by name, before and after.

    again: the errors of a model that was identified anew behind the named effects; None where they cannot be put before a model.
    acts: samples of `own` in which an effect on an input changes it, by key.
    """

    own: Experiment
    other: Experiment
    model: LPVModel
    plant: Plant
    found: Diagnosis
    before: Mapping[str, Errors]
    after: Mapping[str, Errors]
    again: Mapping[str, Errors] | None
    acts: Mapping[str, int]

    def changes(self, new: Mapping[str, Errors]) -> dict[tuple[str, str], float]:
        """By how much the errors on the held-out run change, relative."""
        return {key: new[self.other.name][key] / e - 1.0 for key, e in self.before[self.other.name].items()}


def main(
    quick: bool = False,
    *,
    folder: Path,
    data: str | None = None,
    seed: int = 1,
    json: str | None = None,
    say: Say = print,
    progress: Say = lambda _: None,
) -> Path:
    """Identify and diagnose on either run in the folder `data`, judge on the other, write the report into `folder`.

    With `quick` on the first run only, and without identifying again.
    """
    del seed  # measured records
    first, second = read_runs(data)
    ways = [(first, second)] if quick else [(first, second), (second, first)]
    sides = [judged(own, other, quick, progress) for own, other in ways]
    source = provenance({"study": "winding-records", "quick": quick, "data": data}, [_path(data)])
    for side in sides:
        stem = side.own.name.replace(" ", "_")
        side.model.save(folder / f"{stem}.json")
        named = extension(side.plant, str(folder / f"{stem}.json"), {}, side.found.effects, source)
        named.save(folder / (PLANT_FILE if side is sides[0] else f"{stem}_{PLANT_FILE}"))
    parts = {} if quick else halves((first, second), progress)
    said = " ".join([verdict(sides), *_worst_half(parts)])
    content = to_dict(sides[0].found) | {"extended": str(folder / PLANT_FILE), "said": said}
    content |= {"sides": [_side_json(side, folder) for side in sides], "provenance": source}
    for path in (folder / DIAGNOSIS_FILE, json):
        if path:
            write_json(path, content)
    progress("report")
    path = write_report(_report(sides, parts, said, source, quick), folder)
    say(f"{said}\n\nreport: {path}")
    return path


# ---- records ----------------------------------------------------------------------------------------------------------------


def read_runs(data: str | None) -> tuple[Experiment, Experiment]:
    """Both runs in the file, apart. Raises InputError that says which file is needed, and for one that holds something else."""
    path = _path(data)
    try:
        values = np.loadtxt(path)
    except ValueError as reason:
        raise InputError(f"not a table of numbers: {reason}", file=path, mend=_wanted()) from None
    if values.shape != (ROWS, len(CHANNELS)) or not np.isfinite(values).all():
        raise InputError(f"a table of shape {values.shape}, expected ({ROWS}, {len(CHANNELS)})", file=path, mend=_wanted())
    parts = {"run 1": values[:JOINT], "run 2": values[JOINT:]}
    first, second = (Experiment(name, DT * np.arange(len(v)), CHANNELS, v, DT) for name, v in parts.items())
    return first, second


def _wanted() -> str:
    return f"put {FILE} of the DaISy winding process (homes.esat.kuleuven.be/~smc/daisy) into a folder and give --data FOLDER"


def _path(data: str | None) -> Path:
    if data is None:
        raise InputError("this study needs measured records", mend=_wanted())
    path = Path(data) / FILE
    if not path.is_file():
        raise InputError("no such file", file=path, mend=_wanted())
    return path


# ---- one way round -----------------------------------------------------------------------------------------------------------


def judged(own: Experiment, other: Experiment, quick: bool, progress: Say) -> Side:
    """Identified and diagnosed on `own`, judged on `other`."""
    progress(f"{own.name}: identifying a linear model")
    model = replace(LTI().fit(Dataset((own,))), name=f"LTI of {own.name}")
    plant = identified(model)
    found = diagnose(plant, Dataset((own,)), Dataset((other,)), progress=lambda s: progress(f"{own.name}: {s}"))
    before = _errors(plant, own, other)
    after = _errors(extension(plant, "", {}, found.effects).of(plant), own, other) if found.effects else before
    again = None
    if found.effects and not quick and all(_static(plant, key) for key in found.effects):
        progress(f"{own.name}: identifying again behind what was named")
        moved = [acting(plant, found, e) for e in (own, other)]
        again = _errors(identified(LTI().fit(Dataset((moved[0],)))), *moved)
    changed = acting(plant, found, own)
    acts = {c.key: int(np.sum(changed[c.place] != own[c.place])) for c in found.causes if _static(plant, c.key)}
    return Side(own, other, model, plant, found, before, after, again, acts)


def _static(plant: Plant, key: str) -> bool:
    """Whether an effect only maps the command of a sample."""
    effect = next(slot.effect for slot in plant.slots if slot.key == key)
    return effect.family == "actuator" and not effect.memories and effect.id != "input-delay"


def acting(plant: Plant, found: Diagnosis, e: Experiment) -> Experiment:
    """The record with the inputs as the named effects let them act, delay and play apart."""
    u = [e[name] for name in plant.input_names]
    acts = plant.drive(u, plant.effect_vector({key: s for key, s in found.effects.items() if _static(plant, key)}), e.t)
    values = e.values.copy()
    for name, column in zip(plant.input_names, acts, strict=True):
        values[:, e.names.index(name)] = column
    return replace(e, values=values)


def _errors(plant: Plant, own: Experiment, other: Experiment) -> dict[str, Errors]:
    """Errors on both runs; noise levels are those of `own`, where a run starts is found on it."""
    at = predictor(plant, Dataset((own,)))
    done = recalibrated(at, own=unknowns(at, names=()))
    model, found = Model(done.predictor, done.fit), {}
    for e in (own, other):
        made, point = on(model, Dataset((e,)))
        by_horizon = {h: errors(made, point, 0, h)[SETTLING:] for h in HORIZONS}
        rms = {h: np.sqrt(np.nanmean(by_horizon[h] ** 2, axis=0)) for h in HORIZONS}
        found[e.name] = {(name, h): float(rms[h][i]) for h in HORIZONS for i, name in enumerate(plant.output_names)}
    return found


def halves(runs: tuple[Experiment, ...], progress: Say) -> Halves:
    """Errors of full runs, in spreads of the record, of a model of each half of each run on every half."""
    parts = []
    for e in runs:
        for which, part in (("first half", slice(None, len(e) // 2)), ("second half", slice(len(e) // 2, None))):
            parts.append(replace(e, name=f"{e.name}, {which}", t=e.t[part], values=e.values[part]))
    found = {}
    for own in parts:
        progress(f"{own.name}: identifying a linear model")
        model = LTI(resamples=0).fit(Dataset((own,)))
        for e in parts:
            y = e[list(OUTPUTS)]
            missed = (y - model.simulate(e))[model.warmup :]
            found[own.name, e.name] = np.sqrt(np.mean(missed**2, axis=0)) / np.std(y, axis=0)
    return found


# ---- what came out -----------------------------------------------------------------------------------------------------------


def verdict(sides: list[Side]) -> str:
    """What is named from either run, what it gains on the other, and whether both say so."""
    said = [_level(sides[0]), *(_one_way(side) for side in sides)]
    if len(sides) < 2:
        return " ".join([*said, "Quick: one way round only, so nobody knows whether the other run says so too."])
    both = held(sides)
    if both:
        said.append(f"Named from both runs, and better on the one held out: {', '.join(both)}.")
    elif any(side.found.causes for side in sides):
        said += [_missed(side, other) for side, other in (sides, sides[::-1]) if side.found.causes]
        said.append("No cause is named from both runs: what is named describes one run, it is no finding about the process.")
    else:
        said.append("Neither run shows a cause that these ports could have.")
    return " ".join(said)


def held(sides: list[Side]) -> list[str]:
    """Causes that every way round names, itself or as a rival that ties, and that make nothing worse on the held-out run."""
    named = [{key for c in side.found.causes for key in (c.key, *c.ties)} for side in sides]
    better = all(change < 0.0 for side in sides for change in side.changes(side.after).values())
    return sorted(set.intersection(*named)) if better else []


def _worst_half(parts: Halves) -> list[str]:
    """Where a linear model fails even on the samples that it was fitted to."""
    own = [(float(share), own, OUTPUTS[i]) for (own, e), shares in parts.items() if own == e for i, share in enumerate(shares)]
    if not own:
        return []
    share, worst, output = max(own)
    rest = max(other for other, part, name in own if (part, name) != (worst, output))
    return [
        f"Half by half, the {output} of {worst}, is followed worst: its own model leaves {100 * share:.0f} % of the spread, no "
        f"other one more than {100 * rest:.0f} % on its own half."
    ]


def _level(side: Side) -> str:
    spread = [100.0 * side.before[side.other.name][name, "full-run"] / float(np.std(side.other[name])) for name in OUTPUTS]
    errors_of = " and ".join(f"{s:.0f} % ({name})" for s, name in zip(spread, OUTPUTS, strict=True))
    return (
        f"A linear model of order {side.model.order}, identified on {side.own.name}, leaves {errors_of} of the spread of the "
        f"tensions in a full run over {side.other.name}."
    )


def _one_way(side: Side) -> str:
    """What the diagnosis of one run says, and what that gains on the other."""
    found, own, other = side.found, side.own.name, side.other.name
    if not found.causes:
        rest = "something is left that no effect on a port explains" if found.finding is Finding.UNKNOWN else "nothing is missing"
        return f"From {own} no cause is named: {rest}."
    said = [f"From {own}: {'; '.join(_cause(side, c) for c in found.causes)}."]
    if any(n < FEW * len(side.own) for n in side.acts.values()):
        said.append("What acts in so few samples cannot be told from single wrong readings that the tensions do not follow.")
    said.append(f"The errors on {other} change by {_changes(side, side.after)}.")
    if side.again:
        said.append(f"With matrices identified again behind it they change by {_changes(side, side.again)}.")
    if found.finding is Finding.INCOMPLETE:
        said.append("Something is left beside it.")
    if found.finding is Finding.UNKNOWN:
        said.append("But what is left is so large that no cause explains the run.")
    return " ".join(said)


def _changes(side: Side, new: Mapping[str, Errors]) -> str:
    change = side.changes(new)
    each = (f"{', '.join(f'{100 * change[name, h]:+.1f} % ({SAID[h]})' for h in HORIZONS)} in {name}" for name in OUTPUTS)
    return " and ".join(each)


def _cause(side: Side, c: Cause) -> str:
    said = f"{c.key} ({described(c)})"
    if c.ties:
        said += f", not told apart from {', '.join(c.ties)}"
    if c.key in side.acts:
        said += f", which acts in {side.acts[c.key]} of {len(side.own)} samples"
    return said


def _missed(side: Side, other: Side) -> str:
    """Whether the other run could have shown what this one names."""
    limit = {(d.effect, d.place): d.value for d in other.found.limits}
    able = [c.key for c in side.found.causes if _shows(c, limit.get((c.effect, c.place)))]
    if able:
        return f"{other.own.name[:1].upper()}{other.own.name[1:]} would have shown {' and '.join(able)} of that size."
    return f"{other.own.name[:1].upper()}{other.own.name[1:]} could not have shown it."


def _shows(c: Cause, limit: float | None) -> bool:
    """Whether records of this detection limit show the cause: a stop shows where it is lower, all else where it is larger."""
    size = next(iter(c.parameters.values())).value
    return limit is not None and (size <= limit if c.effect == "saturation" else abs(size) >= limit)


def _side_json(side: Side, folder: Path) -> dict[str, Any]:
    return {
        "identified_on": side.own.name,
        "held_out": side.other.name,
        "model": str(folder / f"{side.own.name.replace(' ', '_')}.json"),
        "order": side.model.order,
        "verdict": side.found.finding.value,
        "effects": {key: dict(numbers) for key, numbers in side.found.effects.items()},
        "acts": dict(side.acts),
        "errors": [
            {"record": name, "output": output, "horizon": h, "before": e, "after": side.after[name][output, h]}
            | ({"identified_again": side.again[name][output, h]} if side.again else {})
            for name, own in side.before.items()
            for (output, h), e in own.items()
        ],
    }


# ---- the page ---------------------------------------------------------------------------------------------------------------


def _report(sides: list[Side], parts: Halves, said: str, source: dict[str, Any], quick: bool) -> Report:
    sections = [
        Section("What these records can tell", (Text("\n\n".join(CAVEATS)),)),
        Section("Errors", (*(_error_table(side) for side in sides), *_half_tables(parts))),
    ]
    for side in sides:
        records = Split(Dataset((side.own,)), Dataset((side.other,)))
        at = stages(side.plant, side.found, records.own, records.shown)
        own = DiagnosisResult(side.plant, side.found, records, at).report(source)
        sections += [Section(f"{side.own.name}: {s.title}", s.blocks) for s in own.sections if s.title in SHOWN]
    title = "DaISy winding process: what a linear model gets wrong"
    return Report(title, ("Quick. " if quick else "") + said, (*sections, Section("Provenance", (Provenance(source),))))


def _error_table(side: Side) -> Table:
    header = ("run", "output", "horizon", "before", "after", *(("identified again",) if side.again else ()))
    rows = tuple(
        (
            f"{name}, {'held out' if name == side.other.name else 'identified on'}",
            output,
            SAID[h],
            e,
            side.after[name][output, h],
            *((side.again[name][output, h],) if side.again else ()),
        )
        for name, own in side.before.items()
        for (output, h), e in own.items()
    )
    return Table(
        f"Model of {side.own.name}: errors, root mean square",
        header,
        rows,
        caption="In spreads of the channel. After: the same matrices with the named effects"
        + (" (none here). " if not side.found.effects else ". ")
        + ("Identified again: matrices of their own behind the named effects. " if side.again else "")
        + f"Noise levels are those of {side.own.name}; the first {SETTLING} samples are not counted.",
    )


def _half_tables(parts: Halves) -> list[Table]:
    names = list(dict.fromkeys(own for own, _ in parts))
    return [
        Table(
            f"Half by half: {output}",
            ("model of", *(f"on {name} [%]" for name in names)),
            tuple((own, *(100.0 * float(parts[own, e][i]) for e in names)) for own in names),
            caption="Errors of full runs, root mean square, as a share of the spread of the record. A row that is worse beside "
            "its own half than on it is a process that changed, a run that was scaled otherwise, or a model of too few samples.",
            digits=2,
        )
        for i, output in enumerate(OUTPUTS)
        if parts
    ]
