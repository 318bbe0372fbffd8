"""How well do LTI, ILM and SSM models describe the web winding machine over the whole reel, and what does each cost?

The question of [1] section 1.4, answered on simulated records of the reference machine or on a user's own: identify on PRBS1
and RBS, simulate all five experiments, compare FIT (1.17) and RM (1.18) with the printed tables.

[1] "Experimental Modelling of a Web Winding Machine: LPV Approaches".
"""

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from plants import WEB_WINDING
from plants.web_winding import frozen_machine
from studies.arguments import record_files, split_estimation
from studies.experiments import measured
from studies.winding_envelopes import Envelopes, envelope_section, identify_envelopes
from workbench.advice import Advice, advise
from workbench.answers.comparison import residual_table, traces
from workbench.answers.envelopes import covered_verdict
from workbench.answers.scored import ScoredModel, scores_file
from workbench.data import Channel, Dataset, Experiment
from workbench.files import write_json
from workbench.identification.ilm import ILM
from workbench.identification.lti import LTI
from workbench.identification.ssm import SSM, Candidate, SSMSweep
from workbench.identification.subspace import PBSID
from workbench.lpv import LPVModel
from workbench.metrics import Score, fit, horizon_name, score
from workbench.provenance import provenance
from workbench.readers import write_csv
from workbench.records import record
from workbench.report import figures
from workbench.report.blocks import Block, Picture, Provenance, Report, Section, Table, Text
from workbench.report.page import write_report
from workbench.simulation import replay
from workbench.sources import read
from workbench.units import check_units

Say = Callable[[str], None]

EXPERIMENTS = ("prbs1", "prbs2", "rbs", "sine", "rgs")
ESTIMATION = ("prbs1", "rbs")
INPUTS, OUTPUT, SCHEDULE = ("V1", "V2"), "w3", "r2"
HORIZONS = ("free-run", "one-step", 25)
BANDS = 5  # of the radius, in which errors are told apart

# [1] Tables 1.1 and 1.2 as printed. The LTI row of Table 1.2 repeats Table 1.1, and the ILM row of Table 1.1 equals its
# LTI row: both look like slips of the print and are quoted as they stand.
PRINTED_NOTE = (
    "Beside them the tables of [1], quoted as printed; they describe another machine, and two of their entries look like slips: "
    "the RM of LTI repeats its FIT, and the FIT of ILM equals that of LTI. "
    '[1] "Experimental Modelling of a Web Winding Machine: LPV Approaches".'
)
PRINTED_FIT = {"SSM": (95, 93, 92, 90, 90), "ILM": (86, 85, 89, 83, 90), "LTI": (86, 85, 89, 83, 90)}
PRINTED_RM = {"SSM": (5, 5, 6, 8, 6), "ILM": (15, 15, 18, 17, 8), "LTI": (86, 85, 89, 83, 90)}


@record
class Records:
    """Estimation and held-out records; `fresh` are the same experiments drawn again, none of them used before."""

    estimation: Dataset
    held_out: Dataset
    fresh: Dataset | None
    files: tuple[Path, ...] = ()

    @property
    def all(self) -> tuple[Experiment, ...]:
        """Every record in the order of the paper's tables, others behind."""
        known = {e.name: e for e in (*self.estimation, *self.held_out)}
        return tuple(sorted(known.values(), key=lambda e: EXPERIMENTS.index(e.name) if e.name in EXPERIMENTS else 99))

    def split(self, name: str) -> str:
        return "estimation" if any(e.name == name for e in self.estimation) else "held-out"


@record
class Identified:
    """The three models, and what their choice rests on."""

    models: dict[str, LPVModel]
    seconds: dict[str, float]
    singular_values: np.ndarray
    sweep: SSMSweep
    chosen: Candidate


@record
class Judged:
    """What the answer rests on, computed once: scores, advice on the data, and errors by radius on the held-out records.

    edges (BANDS + 1) of r2 [m]; errors: RMSE by band and model; machine: FIT of the true machine by record, None where nobody
    knows it.
    """

    scores: tuple[Score, ...]
    advice: tuple[Advice, ...]
    edges: np.ndarray
    errors: dict[str, list[float]]
    machine: dict[str, float] | None

    @property
    def warnings(self) -> list[Advice]:
        """Warnings about the data, the one that every controlled loop is a closed one apart."""
        return [a for a in self.advice if a.severity == "warning" and a.kind != "feedback"]


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
    """Run the study and write records, models, scores and the report into `folder`; returns the report's path."""
    records = _read(Path(data)) if data else _simulate(seed, folder, progress)
    identified = _identify(records, quick, progress)
    progress("scoring")
    judged = _judge(identified, records, simulated=data is None)
    envelopes = identify_envelopes(records.estimation, records.held_out, identified.models, OUTPUT, progress, quick=quick)
    for name, model in (identified.models | envelopes.models).items():
        model.save(folder / f"{_file(name)}.json")
    configuration = {
        "study": "winding-models",
        "quick": quick,
        "data": data,
        "estimation": [e.name for e in records.estimation],
    }
    source = provenance(configuration, records.files, None if data else seed)
    results = [
        ScoredModel(model, f"{_file(name)}.json", tuple(s for s in judged.scores if s.model == model.name))
        for name, model in identified.models.items()
    ]
    results += [
        ScoredModel(model, f"{_file(name)}.json", tuple(c.nominal for c in envelopes.of(name)), envelopes.of(name))
        for name, model in envelopes.models.items()
    ]
    content = scores_file(results, source)
    write_json(folder / "scores.json", content)
    if json:
        write_json(json, content)
    progress("report")
    report = _report(records, identified, judged, envelopes, source, quick)
    path = write_report(report, folder)
    _say_tables(records, judged, say)
    for warning in judged.warnings:
        say(f"warning: {warning.record}, {warning.channel}: {warning.sentence}")
    say(f"\n{report.verdict}\n\nreport: {path}")
    return path


def _file(name: str) -> str:
    """A file's stem from a model's name."""
    return name.lower().replace(", ", "-").replace(" ", "-")


# ---- records --------------------------------------------------------------------------------------------------------


def _simulate(seed: int, folder: Path, progress: Say) -> Records:
    """The five experiments, and the same five with another seed; all written as CSV."""
    both = []
    for number, sub in ((seed, "records"), (seed + 1, "records_fresh")):
        drawn = []
        for name in EXPERIMENTS:
            progress(f"simulating {name}, seed {number}")
            run = measured(WEB_WINDING, name, number)
            write_csv(run, folder / sub / f"{name}.csv")
            drawn.append(run.with_roles(inputs=INPUTS, outputs=(OUTPUT,), schedule=(SCHEDULE,)))
        both.append(tuple(drawn))
    estimation, held_out = Dataset(both[0]).split_records(ESTIMATION)
    return Records(estimation, held_out, Dataset(both[1]), tuple(folder / "records" / f"{name}.csv" for name in EXPERIMENTS))


def _read(folder: Path) -> Records:
    """A user's records: PRBS1 and RBS estimate where they are there, otherwise the first half by name."""
    files = record_files(folder)
    dataset = read(*files, inputs=INPUTS, outputs=(OUTPUT,), schedule=(SCHEDULE,))
    for experiment in dataset:
        check_units(experiment, {c.name: c.unit for c in (*WEB_WINDING.inputs, *WEB_WINDING.outputs)})
    chosen, rest = split_estimation(dataset, ESTIMATION)
    return Records(chosen, rest, None, tuple(files))


# ---- identification ---------------------------------------------------------------------------------------------------


def _identify(records: Records, quick: bool, progress: Say) -> Identified:
    models, seconds = {}, {}

    def timed(name: str, work: Callable[[], Any]) -> Any:
        progress(f"{name}: identifying on {', '.join(e.name for e in records.estimation)}")
        begin = time.perf_counter()
        result = work()
        seconds[name] = time.perf_counter() - begin
        return result

    ssm = SSM(orders=(3, 5)) if quick else SSM()
    models["LTI"] = timed("LTI", lambda: LTI().fit(records.estimation))
    models["ILM"] = timed("ILM", lambda: (ILM(models=3) if quick else ILM()).fit(records.estimation))
    sweep = timed("SSM", lambda: ssm.sweep(records.estimation, records.held_out))
    best = sweep.best  # on the estimation records: the held-out ones are only shown
    factor = float((best.mu / best.smallest)[0])
    models["SSM"] = replace(ssm, order=best.order, mu_factor=factor).fit(records.estimation)
    return Identified(models, seconds, PBSID().fit(records.estimation).singular_values, sweep, best)


def _judge(identified: Identified, records: Records, *, simulated: bool) -> Judged:
    edges = np.linspace(*_span(records.held_out), BANDS + 1)
    return Judged(
        _score(identified, records),
        advise(Dataset(records.all)),
        edges,
        {name: _band_errors(model, records.held_out, edges) for name, model in identified.models.items()},
        {e.name: _machine_fit(e) for e in records.all} if simulated else None,
    )


def _score(identified: Identified, records: Records) -> tuple[Score, ...]:
    scores: tuple[Score, ...] = ()
    for model in identified.models.values():
        scores += score(model, records.estimation, "estimation", HORIZONS)
        scores += score(model, records.held_out, "held-out", HORIZONS)
        if records.fresh:
            again = Dataset(tuple(replace(e, name=f"{e.name} again") for e in records.fresh))
            scores += score(model, again, "held-out", ("free-run",))
    return scores


# ---- the answer -----------------------------------------------------------------------------------------------------


def _value(scores: tuple[Score, ...], model: str, name: str, horizon, measure: str) -> float:
    return next(getattr(s, measure) for s in scores if (s.model, s.record, s.horizon) == (model, name, horizon))


def _score_rows(records: Records, scores: tuple[Score, ...], horizon, measure: str) -> list[tuple]:
    models = list(dict.fromkeys(s.model for s in scores))
    return [
        (e.name, records.split(e.name), *(_value(scores, model, e.name, horizon, measure) for model in models))
        for e in records.all
    ]


def _say_tables(records: Records, judged: Judged, say: Say) -> None:
    """Tables 1.1 and 1.2 of [1]; on the reference machine with the printed numbers beside ours."""
    simulated = judged.machine is not None
    for title, measure, printed in (("1.1  FIT", "FIT", PRINTED_FIT), ("1.2  RM", "RM", PRINTED_RM)):
        say(f"\nTable {title} [%], {OUTPUT}, free run" + "; in brackets as printed in [1] for another machine" * simulated)
        say(f"{'':6}" + "".join(f"{e.name:>15}" for e in records.all))
        for model in printed:
            cells = []
            for e in records.all:
                quoted = f" ({printed[model][EXPERIMENTS.index(e.name)]:3d})" if simulated else ""
                cells.append(f"{_value(judged.scores, model, e.name, 'free-run', measure):{15 - len(quoted)}.1f}{quoted}")
            say(f"{model:6}" + "".join(cells))
        say(f"{'':6}" + "".join(f"{records.split(e.name):>15}" for e in records.all))
    if simulated:
        say(f"\n{PRINTED_NOTE}")


def _verdict(identified: Identified, judged: Judged, quick: bool) -> str:
    """What a reader needs first: which model, how good on unseen records, where it is weak, and what to doubt."""
    held = [s for s in judged.scores if s.split == "held-out" and s.horizon == "free-run"]
    ranges = {}
    for model in identified.models:
        own = [s.FIT for s in held if s.model == model]
        ranges[model] = (min(own), max(own))
    count = len(held) // len(ranges)
    best = max(ranges, key=lambda model: ranges[model][0])
    said = "; ".join(f"{model} {low:.1f}" + f" to {high:.1f}" * (count > 1) + " %" for model, (low, high) in ranges.items())
    text = (
        f"On {count} record{'s' * (count > 1)} that no model has seen, {OUTPUT} simulated from the measured voltages (free run) "
        f"reaches FIT: {said}. "
    )
    if ranges[best][0] < 50:
        text += "No model describes these records: look at the warnings under Data before anything else. "
    else:
        text += f"{best} describes the machine best over the whole reel"
        chosen = identified.chosen
        text += f"; it keeps {chosen.support} coefficients at order {chosen.order}. " if best == "SSM" else ". "
        worst = float(np.nanmax(judged.errors[best]) / np.nanmin(judged.errors[best]))
        text += f"Its error is {worst:.1f} times larger in the worst part of the reel than in the best. "
    if judged.machine is not None:
        ceilings = judged.machine.values()
        text += (
            f"The true machine itself, driven by the logged voltages, reaches {min(ceilings):.1f} to {max(ceilings):.1f} %: "
            "the rest is sensor noise and disturbances that nobody logged. "
        )
    unstable = [name for name, model in identified.models.items() if not model.stability().stable]
    if unstable:
        text += f"Unstable over its own schedule range: {', '.join(unstable)}. "
    warned = sorted({a.record for a in judged.warnings})
    if warned:
        text += f"The data carry warnings ({', '.join(warned)}): see Data. "
    if quick:
        text += "This was a quick look with few candidates. "
    return text.strip()


def _envelope_verdict(envelopes: Envelopes) -> str:
    """What interval models add: guarantees on the records, their width, and what one box for each interval of the radius buys."""
    return " ".join(covered_verdict(envelopes.of(name)) for name in envelopes.models)


def _machine_fit(e: Experiment) -> float:
    """FIT of the noise-free true machine, driven by a record's logged inputs: what no model can beat by more than luck."""
    return fit(e[OUTPUT], replay(WEB_WINDING, e).experiment[OUTPUT])


def _span(dataset: Dataset) -> tuple[float, float]:
    """Smallest and largest radius of the records."""
    radius = np.concatenate([e[SCHEDULE] for e in dataset])
    return float(radius.min()), float(radius.max())


def _band_errors(model: LPVModel, dataset: Dataset, edges: np.ndarray) -> list[float]:
    """RMSE of the free run of w3 in bands of the radius, over all records of the set; NaN in a band without samples."""
    error = np.concatenate([(e[OUTPUT] - model.simulate(e)[:, 0])[model.warmup :] for e in dataset])
    radius = np.concatenate([e[SCHEDULE][model.warmup :] for e in dataset])
    bands = range(len(edges) - 1)
    band = np.clip(np.digitize(radius, edges) - 1, bands[0], bands[-1])
    return [float(np.sqrt(np.mean(error[band == b] ** 2))) if np.any(band == b) else np.nan for b in bands]


def _band_table(judged: Judged) -> Table:
    bands = zip(1e3 * judged.edges[:-1], 1e3 * judged.edges[1:], *judged.errors.values(), strict=True)
    return Table(
        f"Where the models are weak: RMSE of {OUTPUT} [rad/s] by radius",
        ("radius r2 [mm]", *judged.errors),
        tuple((f"{low:.1f} to {high:.1f}", *errors) for low, high, *errors in bands),
        caption="Free run on the held-out records; the best of each row in bold.",
        best=min,
        digits=3,
    )


def _report(
    records: Records, identified: Identified, judged: Judged, envelopes: Envelopes, source: dict[str, Any], quick: bool
) -> Report:
    simulated = judged.machine is not None
    shown = [e for e in records.all if e.name in ("prbs2", "rbs", "sine", "rgs")] or list(records.held_out)
    held = [e for e in shown if records.split(e.name) == "held-out"] or list(records.held_out)
    sections = [
        Section("Scores", (*_score_blocks(records, identified, judged), _band_table(judged))),
        Section("Measured and simulated", tuple(traces(e, identified.models, OUTPUT) for e in shown)),
        envelope_section(envelopes, held[-1], identified.seconds),
        Section("What the models rest on", tuple(_evidence(records, identified, simulated))),
        Section("Residuals", (residual_table(identified.models, records.held_out, closed_loop=True if simulated else None),)),
        Section("Data", (_data_table(records), *_advice_blocks(judged))),
        Section("Provenance", (Provenance(source),)),
    ]
    said = f"{_verdict(identified, judged, quick)} {_envelope_verdict(envelopes)}"
    return Report("Web winding machine: LTI, ILM, SSM and interval models compared", said, tuple(sections))


def _score_blocks(records: Records, identified: Identified, judged: Judged) -> list[Block]:
    models, scores = list(identified.models), judged.scores
    machine: dict[Any, float] | None = judged.machine
    blocks: list[Block] = [figures.score_dots(scores, OUTPUT)]
    for title, measure, printed in (("1.1: FIT", "FIT", PRINTED_FIT), ("1.2: RM", "RM", PRINTED_RM)):
        rows = _score_rows(records, scores, "free-run", measure)
        header = ("record", "split", *models)
        caption = f"{OUTPUT} simulated from the measured inputs."
        if machine is not None:
            rows = [(*row, *(printed[m][EXPERIMENTS.index(row[0])] for m in models)) for row in rows]
            header += tuple(f"{model} in [1]" for model in models)
            if measure == "FIT":
                rows = [(*row[: 2 + len(models)], machine[row[0]], *row[2 + len(models) :]) for row in rows]
                header = (*header[: 2 + len(models)], "true machine", *header[2 + len(models) :])
                caption += " True machine: the plant itself, noise-free, driven by the logged inputs; nothing can do better."
            caption += f" {PRINTED_NOTE}"
        name = f"Table {title} [%], free run" if machine is not None else f"{measure} [%], free run"
        blocks.append(Table(name, header, tuple(rows), caption=caption, digits=3))
    blocks.append(
        Table(
            "FIT [%] by horizon",
            ("record", "split", *(f"{model} {horizon_name(h)}" for h in HORIZONS[1:] for model in models)),
            tuple(
                (e.name, records.split(e.name), *(_value(scores, m, e.name, h, "FIT") for h in HORIZONS[1:] for m in models))
                for e in records.all
            ),
            caption="One step ahead and one second (25 samples) ahead, from the measured outputs up to then.",
            digits=3,
        )
    )
    return blocks


def _evidence(records: Records, identified: Identified, simulated: bool) -> list[Block]:
    path, chosen = identified.sweep.path, identified.chosen
    orders = sorted({c.order for c in path})
    best = {n: max((c for c in path if c.order == n), key=lambda c: c.fit) for n in orders}
    own = sorted((c for c in path if c.order == chosen.order), key=lambda c: c.mu[0])
    held = [np.nan if c.held_out is None else c.held_out for c in own]
    pictures = [
        figures.order_sweep(
            orders,
            {
                "estimation": np.array([best[n].fit for n in orders]),
                "held-out": np.array([np.nan if best[n].held_out is None else best[n].held_out for n in orders], float),
            },
            chosen.order,
        ),
        figures.sparsity_path(
            np.array([c.mu[0] for c in own]),
            np.array([c.support for c in own]),
            np.array([c.fit for c in own]),
            np.array(held, float),
            float(chosen.mu[0]),
        ),
        figures.singular_values(identified.singular_values, identified.models["LTI"].order),
        _coefficients(records, identified.models["SSM"], simulated),
    ]
    owners = ("SSM", "SSM", "LTI", "SSM")
    blocks: list[Block] = [replace(p, title=f"{owner}: {p.title}") for owner, p in zip(owners, pictures, strict=True)]
    if simulated:
        blocks.append(_frozen(identified))
    blocks.append(
        Table(
            "Models",
            ("model", "order", "largest frozen pole radius", "time to identify [s]"),
            tuple(
                (name, model.order, model.stability().radius, identified.seconds[name])
                for name, model in identified.models.items()
            ),
            caption="The largest radius over the whole reel: close to 1 a model forgets slowly, and its free run drifts. "
            "The time includes the sweep over orders, bounds and numbers of local models.",
        )
    )
    estimates = identified.models["SSM"].estimates
    blocks.append(
        Table(
            "Coefficients of SSM",
            ("coefficient", "value", "standard deviation", "feasible from", "feasible to"),
            tuple((e.name, e.value, e.std, _or_nan(e.low), _or_nan(e.high)) for e in estimates),
            caption="Every coefficient that the sparse identification kept. The feasible interval holds the values that the "
            "records and the noise allow, if all other coefficients are zero and the noise is no larger than the residuals "
            "suggest. One that holds 0 is not proved to be needed. rho is the radius over the scale in the model file.",
        )
    )
    notes = "\n\n".join(f"{name}: {note}" for name, model in identified.models.items() for note in model.notes)
    return [*blocks, Text(notes)] if notes else blocks


def _or_nan(value: float | None) -> float:
    return np.nan if value is None else value


# ---- the truth of the coefficients ----------------------------------------------------------------------------------------


def true_coefficients(r2: np.ndarray, order: int, u: np.ndarray, noise: float) -> np.ndarray:
    """f_i, g_i that a regression of `order` finds on the frozen machine from an endless noisy record; (len(r2), 3 order).

    Least squares on noise-free responses to u (N, 2), with the variance of the sensor's noise added where the regressors are
    measured outputs: noise in the regressors moves the coefficients, and the identified ones with them. In the order
    y(k-1), y(k-2), .., then for each lag V1, V2.
    """
    rows = []
    for radius in r2:
        A, B, C = frozen_machine(radius)
        x, y = np.zeros(len(A)), np.empty(len(u))
        for k in range(len(u)):
            y[k] = (C @ x)[0]
            x = A @ x + B @ u[k]
        past = range(1, order + 1)
        lagged = [y[order - i : len(y) - i] for i in past] + [u[order - i : len(u) - i, j] for i in past for j in (0, 1)]
        Phi = np.column_stack(lagged)
        variance = np.diag([noise**2 * len(Phi)] * order + [0.0] * (2 * order))
        rows.append(np.linalg.solve(Phi.T @ Phi + variance, Phi.T @ y[order:]))
    return np.array(rows)


def _coefficients(records: Records, model: LPVModel, simulated: bool) -> Picture:
    """f_i(rho), g_i(rho) of SSM read off its frozen observer form, beside the truth where it is known."""
    span = model.span
    radius = np.linspace(span[0], span[1], 25)
    n = model.order
    frozen = [model.freeze(r) for r in radius]
    f = np.array([A[:, 0] for A, *_ in frozen])
    g = np.array([B for _, B, *_ in frozen])
    truth = None
    if simulated:
        e = records.estimation.experiments[0]
        truth = true_coefficients(radius, n, e[INPUTS] - e[INPUTS].mean(axis=0), WEB_WINDING.noise[OUTPUT])
    curves = {}
    for i in range(n):
        curves[f"{OUTPUT}(k-{i + 1})"] = figures.Coefficient(f[:, i], truth=None if truth is None else truth[:, i])
    for i in range(n):
        for j, name in enumerate(INPUTS):
            column = None if truth is None else truth[:, n + 2 * i + j]
            curves[f"{name}(k-{i + 1})"] = figures.Coefficient(g[:, i, j], truth=column)
    picture = figures.coefficient_functions(figures.Trace(Channel(SCHEDULE, "m"), radius), curves)
    if truth is None:
        return picture
    return replace(
        picture,
        caption=f"{picture.caption} Truth: what the same regression finds on the machine with its radii frozen, from an endless "
        "record with the sensor's noise. Noise in the regressors moves the coefficients of any such regression, so these are not "
        "the coefficients of a noise-free machine; the frozen response below compares with the machine itself.",
    )


def _frozen(identified: Identified) -> Block:
    """Magnitude from V2 to w3 with the radius frozen: the machine and its models."""
    model = identified.models["SSM"]
    radius = np.linspace(model.span[0], model.span[1], 3)
    omega = np.geomspace(0.1, 0.95 * np.pi / WEB_WINDING.dt, 120)
    z = np.exp(1j * omega * WEB_WINDING.dt)

    def magnitude(A: np.ndarray, B: np.ndarray, C: np.ndarray) -> np.ndarray:
        response = [(C @ np.linalg.solve(s * np.eye(len(A)) - A, B[:, 1]))[0] for s in z]
        return 20 * np.log10(np.abs(response))

    curves = {"machine": np.array([magnitude(*frozen_machine(r)) for r in radius])}
    for name, own in identified.models.items():
        curves[name] = np.array([magnitude(*own.freeze(r)[:3]) for r in radius])
    return figures.frozen_responses(omega, figures.Trace(Channel(SCHEDULE, "m"), radius), curves, "Frozen response from V2 to w3")


# ---- the rest of the page -----------------------------------------------------------------------------------------------


def _data_table(records: Records) -> Block:
    return Table(
        "Records",
        ("record", "split", "samples", "duration [s]", f"{SCHEDULE} from [m]", f"{SCHEDULE} to [m]"),
        tuple(
            (e.name, records.split(e.name), len(e), e.dt * len(e), float(e[SCHEDULE].min()), float(e[SCHEDULE].max()))
            for e in records.all
        ),
    )


def _advice_blocks(judged: Judged) -> list[Block]:
    lines = [f"{a.severity}: {a.record}, {a.channel}: {a.sentence}" for a in judged.advice]
    return [Text("\n\n".join(lines))] if lines else []
