"""Interval models: y(k) = d'psi(k) + theta(k)'z(k) with theta(k) anywhere in the box of the mode that holds at k.

    one step   [y](k) = d'psi + centre'z -+ radius'|z|           regressors psi, z = T psi as measured
    free run   outputs fed back, parameters arbitrary in time: an outer and a reached bound (`envelopes`)

What a model promises is its semantics. Equation-error boxes (`semantics`) speak about every sample in one step; simulation boxes
(`output_error`) hold every record in a free run. Neither promise implies the other, and one model makes one of them.

[2] Linear time-varying models with interval parameters.
"""

from collections.abc import Sequence
from dataclasses import replace
from math import comb
from typing import Any, NoReturn

import numpy as np

from workbench.data import SAME_DT, Channel, Experiment
from workbench.errors import InputError, check_known
from workbench.files import read_json, write_json
from workbench.intervals.arithmetic import dot, matmul
from workbench.intervals.domains.choice import nearest
from workbench.intervals.domains.shapes import Domain, domain_from_dict
from workbench.intervals.envelopes import FreeRun, free_run
from workbench.intervals.propagation import Recursion, nominal
from workbench.intervals.regressors import ARX, FIR, Form, Samples, Structure, samples
from workbench.intervals.semantics import SEMANTICS, ParameterBox, Semantics
from workbench.records import field, record

SCHEMA, VERSION = "interval-model", 1
STRUCTURES: dict[str, type] = {"arx": ARX, "fir": FIR}


@record
class Simulation:
    """The free-run envelope holds the measured output of every estimation record; nothing is promised about one step."""

    name = "simulation"
    promise = "the free run from the inputs holds every measured value of the estimation records; nothing is said about one step"


@record
class Unrefuted:
    """Every constant parameter that explains the records within the bound is in the box (`errors`)."""

    name = "unrefuted"
    promise = "every constant parameter that explains all estimation records within the bound is in the box"


ALL_SEMANTICS: dict[str, type] = SEMANTICS | {Simulation.name: Simulation, Unrefuted.name: Unrefuted}


@record
class Span:
    """Samples first .. last (inclusive, from 0) of a record."""

    record: str
    first: int
    last: int

    def __str__(self) -> str:
        return f"{self.record} {self.first}-{self.last}"


@record
class Mode:
    """An operating mode: its parameter box, where it holds, and what it was made from.

    mean_radius: of the envelope over its samples [unit of y]; precision = exp(-mean_radius / range of y). inflation: factor by
    which the verification enlarged the radii, inflated: samples that asked for it. short: a tail of few samples. band: bound on
    a term of the output that is not fed back [unit of y], of simulation boxes.
    """

    box: ParameterBox
    domain: Domain
    spans: tuple[Span, ...]
    samples: int
    mean_radius: float = field("", low=0.0)
    precision: float = field("", low=0.0, high=1.0)
    inflation: float = field("", default=1.0, low=1.0)
    inflated: int = 0
    short: bool = False
    band: float = field("", default=0.0, low=0.0)


class _Bounds:
    """Measured values y between low and high, (K) each."""

    y: np.ndarray
    low: Any
    high: Any

    @property
    def inside(self) -> np.ndarray:
        """(K,) whether the measured value lies in low .. high."""
        return (self.low <= self.y) & (self.y <= self.high)

    @property
    def coverage(self) -> float:
        """Share of measured values within the bounds, 0 to 1."""
        return float(np.mean(self.inside))

    @property
    def mean_radius(self) -> float:
        """Mean half-width [unit of y]."""
        return float(np.mean(self.high - self.low) / 2)


@record
class Envelope(_Bounds):
    """One-step envelope of a record at its samples k (K): low <= y <= high, and the mode that is nearest.

    valid: the regressor lies in the domain of a mode; elsewhere the nearest mode speaks, and nobody has seen the machine there.
    """

    k: np.ndarray = field("K")
    t: np.ndarray = field("K", unit="s")
    y: np.ndarray = field("K")
    low: np.ndarray = field("K")
    high: np.ndarray = field("K")
    mode: np.ndarray = field("K")
    gauge: np.ndarray = field("K")

    @property
    def valid(self) -> float:
        """Share of samples whose regressor lies in the domain of a mode."""
        return float(np.mean(self.gauge == 0.0))


@record
class Simulated(_Bounds):
    """A free run of a record from sample k[0] on, with its measured output: bounds (`run`) and the mode sequence (K).

    `run` bounds the true output; low, high (K) bound the measured one, which may differ from it by output_error. known (K):
    the nominal regressor (or the schedule) lies in the domain of the mode.
    """

    k: np.ndarray = field("K")
    t: np.ndarray = field("K", unit="s")
    y: np.ndarray = field("K")
    mode: np.ndarray = field("K")
    known: np.ndarray = field("K")
    run: FreeRun
    output_error: float = field("", low=0.0)

    @property
    def low(self) -> np.ndarray:
        return self.run.low - self.output_error

    @property
    def high(self) -> np.ndarray:
        return self.run.high + self.output_error

    @property
    def valid(self) -> float:
        """Share of samples at which the mode is known."""
        return float(np.mean(self.known))


@record
class _Step:
    """x+ = A_m x + last g_m(k), z = C x + f(k): the nominal recursion of every mode."""

    A: np.ndarray = field("M n n")
    last: np.ndarray = field("n")
    C: np.ndarray = field("p n")
    g: np.ndarray = field("K M")
    f: np.ndarray = field("K p")


@record
class IntervalModel:
    """y(k) = d'psi(k) + theta(k)'z(k), theta(k) anywhere in the box of the mode that holds at k.

    `one_step` and `free_run` of a record give its envelopes, low and high (N,).
    unit_range: range of y over the estimation records, to which precisions refer.
    output_error, input_error (nu): bounds on |measured - true|. With a schedule, modes are chosen by its value; without, by the
    regressor: domains are in the coordinates z without the constant.

        >>> boxes = IntervalRegression(ARX(order=1)).fit(data)
        >>> envelope = boxes.one_step(held_out.experiments[0])
        >>> envelope.low.shape, envelope.coverage
        ((599,), 1.0)
    """

    name: str
    dt: float = field("", unit="s", low=0.0)
    inputs: tuple[Channel, ...]
    output: Channel
    schedule: Channel | None
    structure: Structure
    semantics: Semantics | Simulation | Unrefuted
    output_error: float = field("", low=0.0)
    input_error: np.ndarray = field("nu", low=0.0)
    unit_range: float = field("", low=0.0)
    modes: tuple[Mode, ...]
    trained_on: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def __post_init__(self):
        if not self.modes:
            raise InputError("an interval model without modes", file=self.name)
        for mode in self.modes:
            if len(mode.box.centre) != len(self.form.names):
                raise InputError(f"{len(mode.box.centre)} parameters, expected {len(self.form.names)}", file=self.name)

    @property
    def form(self) -> Form:
        return self.structure.form(self.output.name, [c.name for c in self.inputs])

    @property
    def order(self) -> int:
        return self.structure.memory

    @property
    def precision(self) -> float:
        """The lowest precision of its modes, short tails apart."""
        whole = [mode.precision for mode in self.modes if not mode.short]
        return min(whole or [mode.precision for mode in self.modes])

    def pole_radius(self) -> float:
        """Largest |pole| of the middle of its boxes: from 1 on the nominal free run grows. 0 for a model without feedback."""
        form = self.form
        rows = [form.d + form.T.T @ mode.box.centre for mode in self.modes]
        poles = [np.roots(np.concatenate([[1.0], -row[form.source == 0]])) for row in rows]
        return max(float(np.abs(p).max(initial=0.0)) for p in poles)

    # ---- one step ----------------------------------------------------------------------------------------------------

    def samples_of(self, experiment: Experiment) -> Samples:
        """The regression rows of a record. Raises InputError for another sample time, missing channels, too few samples."""
        if abs(experiment.dt - self.dt) > SAME_DT * self.dt:
            raise InputError(
                f"sample time {experiment.dt:g} s, the model has {self.dt:g} s", file=experiment.name, mend="resample the record"
            )
        for channel in (*self.inputs, self.output, *([self.schedule] if self.schedule else [])):
            unit = experiment.channel(channel.name).unit
            if unit and channel.unit and unit != channel.unit:
                raise InputError(
                    f"in {unit}, the model has it in {channel.unit}",
                    file=experiment.name,
                    channel=channel.name,
                    mend="convert it",
                )
        names = [c.name for c in self.inputs]
        return samples(
            self.structure,
            experiment,
            self.output.name,
            names,
            output_error=self.output_error,
            input_error=list(self.input_error),
        )

    def one_step(self, experiment: Experiment) -> Envelope:
        """[y](k) from the measured past: the union over all modes whose domain holds the regressor, else the nearest mode.

        Bounds are rounded outward. Raises InputError for a simulation model, which promises nothing about one step.
        """
        if isinstance(self.semantics, Simulation):
            raise InputError(
                "a simulation model has no one-step envelope",
                file=self.name,
                mend="identify with equation-error boxes for that; the two promises are never mixed",
            )
        S = self.samples_of(experiment)
        k = S.index.astype(int)
        at = self._coordinates(S, experiment, k)
        chosen = nearest([mode.domain for mode in self.modes], at, hold=True)
        low, high = np.full(len(S), np.inf), np.full(len(S), -np.inf)
        for j, mode in enumerate(self.modes):
            asked = chosen.holds[:, j] | (chosen.index == j)
            if asked.any():
                ends = bounds(S.rows(asked), mode.box)
                low[asked], high[asked] = np.minimum(low[asked], ends[0]), np.maximum(high[asked], ends[1])
        return Envelope(k, experiment.t[k], S.y, low, high, chosen.index, chosen.gauge)

    def _coordinates(self, S: Samples, experiment: Experiment, k: np.ndarray) -> np.ndarray:
        """Where the samples lie in the space of the domains, (K d)."""
        if self.schedule is not None:
            return experiment[self.schedule.name][k][:, None]
        return domain_coordinates(S)

    # ---- free run ----------------------------------------------------------------------------------------------------

    def free_run(self, experiment: Experiment, instants: Sequence[int] | None = None) -> Simulated:
        """Outer and reached bounds of y from the measured inputs and the first n outputs alone, parameters arbitrary in time.

        Input errors enter as one more bounded term of the equation. The modes follow the schedule, or without one the nominal
        run; then the bounds hold for that sequence of modes and no other. Raises InputError for a record with gaps.
        """
        S = self.samples_of(experiment)
        if len(set(S.piece)) > 1:
            raise InputError("a free run cannot cross a gap", file=experiment.name, mend="cut the record there with trim")
        recursion, mode = self.recursion(S, experiment)
        k = S.index.astype(int)
        at = self._coordinates(S, experiment, k)
        if self.schedule is None:
            at = nominal(recursion).z[:, : len(self.form.names)][:, self.form.source >= 0]
        known = np.zeros(len(k))
        for j, m in enumerate(self.modes):
            known[mode == j] = m.domain.holds(_finite(at[mode == j]))
        run = _with_band(free_run(recursion, instants), np.array([m.band for m in self.modes])[mode])
        return Simulated(k, experiment.t[k], S.y, mode, known, run, self.output_error)

    def recursion(self, S: Samples, experiment: Experiment) -> tuple[Recursion, np.ndarray]:
        """The free run of a record as x+ = A x + q + b w (see `propagation`), and its mode sequence (K).

        The state holds the last n outputs in delta coordinates: x_j = (q - 1)^j y(k - n).
        """
        form, past = self.form, self.form.source == 0
        n, M = int(past.sum()), len(self.modes)
        to_past = np.array([[comb(n - 1 - r, j) for j in range(n)] for r in range(n)], dtype=float).reshape(n, n)
        rows = np.array([form.d + form.T.T @ mode.box.centre for mode in self.modes])  # y = row'psi + w
        c, C = rows[:, past] @ to_past, form.T[:, past] @ to_past
        last = np.eye(n)[:, -1] if n else np.zeros(0)
        highest = np.array([(-1.0) ** i * comb(n, i) for i in range(1, n + 1)])  # of (q - 1)^n y(k - n), without y(k)
        A = np.eye(n) + np.eye(n, k=1) + last[:, None] * (c + highest @ to_past)[:, None, :]
        u = np.where(past, 0.0, S.psi)
        start = np.linalg.solve(to_past, S.psi[0, past]) if n else np.zeros(0)
        spread = np.linalg.inv(to_past) * self.output_error if n and self.output_error > 0 else np.zeros((n, 0))
        g, f = u @ rows.T, u @ form.T.T  # g (K M): what the inputs contribute in each mode
        step = _Step(A.reshape(M, n, n), last, C, g, f)
        mode = self._mode_sequence(
            step, start, None if self.schedule is None else experiment[self.schedule.name][S.index.astype(int)]
        )
        lam, C, f = self._with_input_errors(rows, C, f)
        g = g[np.arange(len(S)), mode]
        return Recursion(step.A, last, c, C, lam, np.outer(g, last), g, f, mode, start, spread), mode

    def _with_input_errors(self, rows: np.ndarray, C: np.ndarray, f: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Radii, C and f with one more regressor that is always 1: what errors of the inputs can add to the equation."""
        lam = np.array([mode.box.radius for mode in self.modes])
        error = np.array([self.input_error[int(s) - 1] if s > 0 else 0.0 for s in self.form.source])
        if not error.any():
            return lam, C, f
        extra = (np.abs(rows) + lam @ np.abs(self.form.T)) @ error
        return np.column_stack([lam, extra]), np.vstack([C, np.zeros((1, C.shape[1]))]), np.column_stack([f, np.ones(len(f))])

    def _mode_sequence(self, step: "_Step", start: np.ndarray, rho: np.ndarray | None) -> np.ndarray:
        """The mode of every sample (K): by the schedule, or by the regressor of the nominal run; a valid mode is kept."""
        domains = [mode.domain for mode in self.modes]
        if len(domains) == 1:
            return np.zeros(len(step.f), dtype=int)
        if rho is not None:
            return nearest(domains, rho[:, None], hold=True).index.astype(int)
        moving = self.form.source >= 0
        mode, present, x = np.empty(len(step.f), dtype=int), -1, start
        for k in range(len(mode)):
            at = (step.C @ x + step.f[k])[moving][None]
            if present < 0 or not domains[present].holds(at)[0]:
                present = int(nearest(domains, at).index[0])
            mode[k] = present
            x = step.A[present] @ x + step.last * step.g[k, present]
        return mode

    # ---- files ------------------------------------------------------------------------------------------------------

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, readable without the package."""
        form = self.form
        return {
            "schema": SCHEMA,
            "version": VERSION,
            "name": self.name,
            "dt": self.dt,
            "inputs": [vars(c) for c in self.inputs],
            "output": vars(self.output),
            "schedule": vars(self.schedule) if self.schedule else None,
            "structure": {"kind": _kind(STRUCTURES, self.structure)} | vars(self.structure),
            "semantics": self.semantics.name,
            "output_error": self.output_error,
            "input_error": self.input_error,
            "range": self.unit_range,
            "parameters": list(form.names),
            "modes": [
                {
                    "centre": mode.box.centre,
                    "radius": mode.box.radius,
                    "mean_radius": mode.mean_radius,
                    "precision": mode.precision,
                    "samples": mode.samples,
                    "inflation": mode.inflation,
                    "inflated": mode.inflated,
                    "short": mode.short,
                    "band": mode.band,
                    "spans": [vars(span) for span in mode.spans],
                    "domain": mode.domain.to_dict(),
                }
                for mode in self.modes
            ],
            "trained_on": list(self.trained_on),
            "notes": list(self.notes),
        }

    def save(self, path) -> None:
        """Write the model as JSON (schema and version inside)."""
        write_json(path, self.to_dict())


def load_interval_model(path) -> IntervalModel:
    """Read a model file written by `IntervalModel.save`; what is missing or foreign is named.

    Raises InputError for a file that is none.

        >>> IntervalRegression(ARX(order=1)).fit(data).save("interval.json")
        >>> load_interval_model("interval.json").output
        Channel(name='n', unit='rad/s', role='output')
    """
    content = read_json(path)
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise InputError("not an interval model", file=path, mend=f"expected a JSON object with schema {SCHEMA!r}")
    if content.get("version") != VERSION:
        raise InputError(f"model version {content.get('version')}, this program reads {VERSION}", file=path)
    try:
        return interval_model_from_dict(content, path)
    except KeyError as reason:
        _malformed(f"field {reason.args[0]!r} is missing", path)
    except (TypeError, ValueError, AttributeError, OverflowError) as reason:
        if isinstance(reason, InputError) and reason.file is not None:
            raise
        _malformed(f"malformed model: {reason}", path)


def _malformed(problem: str, path) -> NoReturn:
    raise InputError(problem, file=path, mend="write the model again") from None


def interval_model_from_dict(content: dict[str, Any], path) -> IntervalModel:
    """The model that `IntervalModel.to_dict` wrote; path: the file that holds it, for messages."""
    structure = dict(content["structure"])
    kind = STRUCTURES[check_known("structure", structure.pop("kind"), STRUCTURES, file=path)]
    modes = tuple(
        Mode(
            ParameterBox(entry["centre"], entry["radius"]),
            domain_from_dict(entry["domain"], path),
            tuple(Span(**span) for span in entry["spans"]),
            int(entry["samples"]),
            entry["mean_radius"],
            entry["precision"],
            entry["inflation"],
            int(entry["inflated"]),
            bool(entry["short"]),
            entry["band"],
        )
        for entry in content["modes"]
    )
    return IntervalModel(
        name=content["name"],
        dt=content["dt"],
        inputs=tuple(Channel(**c) for c in content["inputs"]),
        output=Channel(**content["output"]),
        schedule=Channel(**content["schedule"]) if content["schedule"] else None,
        structure=kind(**structure),
        semantics=ALL_SEMANTICS[check_known("semantics", content["semantics"], ALL_SEMANTICS, file=path)](),
        output_error=content["output_error"],
        input_error=content["input_error"],
        unit_range=content["range"],
        modes=modes,
        trained_on=tuple(content["trained_on"]),
        notes=tuple(content["notes"]),
    )


def _finite(at: np.ndarray) -> np.ndarray:
    """A nominal run that ran away is far outside, but a number."""
    return np.clip(np.nan_to_num(at, nan=1e300), -1e300, 1e300)


def _with_band(run: FreeRun, band: np.ndarray) -> FreeRun:
    """The bounds widened by a term of the output that may be anything up to `band` (K) at every sample."""
    if not band.any():
        return run
    at = list(run.instants)
    reached_low, reached_high, low, high = run.reached_low - band, run.reached_high + band, run.low - band, run.high + band
    ratio = float(np.max((high - low)[at] / (reached_high - reached_low)[at]))
    return replace(run, low=low, high=high, reached_low=reached_low, reached_high=reached_high, ratio=ratio)


def bounds(S: Samples, box: ParameterBox) -> tuple[np.ndarray, np.ndarray]:
    """d'psi + centre'z -+ radius'|z| at the measured regressors, rounded outward: low (K), high (K)."""
    c = dot(S.form.T.T, box.centre) + S.form.d
    centre = (c * S.psi).sum(axis=1)
    half = (abs(matmul(S.psi, S.form.T.T)) * box.radius).sum(axis=1)
    return (centre - half).low, (centre + half).high


def domain_coordinates(S: Samples) -> np.ndarray:
    """z without the constant, (K d): the space in which a regressor's domain lies."""
    return S.z[:, S.form.source >= 0]


def _kind(kinds: dict[str, type], value: object) -> str:
    return next(kind for kind, cls in kinds.items() if isinstance(value, cls))
