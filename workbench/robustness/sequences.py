"""Parameter sequences that break a claim about an identified loop, as files that stand alone and are run again.

    growth     the parameters of a frozen loop in turn, again and again: the product of its matrices has a pole outside the circle
    passage    parameters along a run of model, errors and law: a signal leaves its bound

Both hold every number that they need; what a replay finds must agree with what the file says (`falsify.counterexample.same`).
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from workbench.errors import InputError
from workbench.files import read_json, write_json
from workbench.intervals.model import IntervalModel, interval_model_from_dict
from workbench.lpv import LPVModel, model_from_dict
from workbench.records import field, record
from workbench.robustness.envelopes.course import Course, replay
from workbench.robustness.linear_law import LinearLaw
from workbench.robustness.loop import course_of
from workbench.robustness.margins import Falsified
from workbench.robustness.uncertain import UncertainLoop

SCHEMA, VERSION = "gain-scheduling-workbench/parameter-sequence", 2


@record
class Growth:
    """A loop, and parameters within kappa times its boxes that, repeated, multiply a state by `growth` each time."""

    claim: str
    loop: UncertainLoop
    found: Falsified
    needed: float = 1.0

    @property
    def breaks(self) -> bool:
        """Whether it refutes the claim: it grows, in boxes no wider than those that were asked about."""
        return self.found.growth >= 1.0 and self.found.kappa <= self.needed

    @property
    def value(self) -> float:
        return self.found.growth

    @property
    def sentence(self) -> str:
        count, kappa = len(self.found.delta), self.found.kappa
        return f"{count} sets of parameters in turn, in boxes {kappa:.4g} times as wide, multiply a state by"

    def again(self, make_law: Callable[[Mapping[str, Any]], LinearLaw]) -> float:
        """The largest modulus of a pole of the product over one period."""
        del make_law
        return self.found.replay(self.loop)

    def to_dict(self) -> dict[str, Any]:
        """What its file holds."""
        loop, found = self.loop, self.found
        return {
            "schema": SCHEMA, "version": VERSION,
            "kind": "growth", "claim": self.claim, "value": found.growth, "kappa": found.kappa, "delta": found.delta,
            "needed": self.needed,
            "A": loop.A, "B": loop.B, "C": loop.C, "lam": loop.lam, "channel": loop.channel,
            "parameters": list(loop.parameters), "dt": loop.dt,
        }  # fmt: skip

    def save(self, path: str | Path) -> Path:
        return write_json(path, self.to_dict())


@record
class Passage:
    """Set-points (N nr) and a schedule (N) through which a law leads a model, from rest under set-points between initial (nr 2).

    noise: with the errors that no parameter explains. rates: commands whose change per second is watched too, as "rate of ..".
    """

    model: LPVModel
    errors: tuple[IntervalModel, ...]
    controller: Mapping[str, Any]
    rho: np.ndarray = field("N ...")
    references: np.ndarray = field("N nr")
    initial: np.ndarray = field("nr 2")
    noise: bool
    rates: tuple[str, ...] = ()

    def course(self, law: LinearLaw) -> Course:
        """The loop along it."""
        return course_of(
            self.model, self.errors, law, self.rho, self.references, noise=self.noise, rates=self.rates, initial=self.initial
        )


@record
class Broken:
    """A passage and parameters delta (N p) under which a signal has `value` at a sample, beyond low .. high there.

    It begins at the rest with parameters before (p), at the shares (g) of those set-points before the run that have an interval.
    """

    claim: str
    passage: Passage
    signal: str
    sample: int
    value: float
    delta: np.ndarray = field("N p", low=-1.0, high=1.0)
    before: np.ndarray = field("p", low=-1.0, high=1.0)
    share: np.ndarray = field("g", low=-1.0, high=1.0)
    low: float
    high: float

    @property
    def breaks(self) -> bool:
        """Whether it refutes the claim."""
        return not self.low <= self.value <= self.high

    @property
    def sentence(self) -> str:
        return f"parameters within their boxes bring {self.signal} at sample {self.sample} to"

    def again(self, make_law: Callable[[Mapping[str, Any]], LinearLaw]) -> float:
        """The signal at the sample."""
        own = self.passage.course(make_law(self.passage.controller))
        start = own.begun(self.before[None], self.share[None])
        return float(replay(own, self.delta[None], start)[0, self.sample, own.number(self.signal)])

    def to_dict(self) -> dict[str, Any]:
        """What its file holds."""
        own = self.passage
        return {
            "schema": SCHEMA, "version": VERSION,
            "kind": "passage", "claim": self.claim, "value": self.value, "signal": self.signal, "sample": self.sample,
            "low": self.low if np.isfinite(self.low) else None, "high": self.high if np.isfinite(self.high) else None,
            "before": self.before, "share": self.share, "delta": self.delta,
            "rho": own.rho, "references": own.references, "initial": own.initial, "noise": own.noise, "rates": list(own.rates),
            "model": own.model.to_dict(), "errors": [e.to_dict() for e in own.errors], "controller": dict(own.controller),
        }  # fmt: skip

    def save(self, path: str | Path) -> Path:
        return write_json(path, self.to_dict())


Witness = Growth | Broken


def is_sequence(path: str | Path) -> bool:
    """Whether a file says that it is one of these."""
    content = read_json(path)
    return isinstance(content, dict) and content.get("schema") == SCHEMA


def load_sequence(path: str | Path) -> Witness:
    """Read a file written by `save`; what is missing or foreign is named."""
    return sequence_of(read_json(path), path)


def sequence_of(content: Any, path: str | Path = "a parameter sequence") -> Witness:
    """The sequence that the content of a file makes; path: the file that holds it, for messages."""
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise InputError("not a parameter sequence", file=path, mend=f"expected a JSON object with schema {SCHEMA!r}")
    if content.get("version") != VERSION:
        problem = f"version {content.get('version')}, this program reads {VERSION}"
        raise InputError(problem, file=path, mend="run the check again")
    try:
        return _growth(content) if content["kind"] == "growth" else _broken(content, path)
    except KeyError as reason:
        _malformed(f"field {reason.args[0]!r} is missing", path)
    except (TypeError, ValueError, AttributeError, IndexError, OverflowError) as reason:
        if isinstance(reason, InputError) and reason.file is not None:
            raise
        _malformed(f"malformed: {reason}", path)


def _malformed(problem: str, path: str | Path) -> NoReturn:
    raise InputError(problem, file=path, mend="run the check again") from None


def _growth(content: Mapping[str, Any]) -> Growth:
    loop = UncertainLoop(
        content["A"], content["B"], content["C"], content["lam"], content["channel"], tuple(content["parameters"]), content["dt"]
    )
    found = Falsified(float(content["kappa"]), content["delta"], float(content["value"]))
    return Growth(content["claim"], loop, found, float(content["needed"]))


def _broken(content: Mapping[str, Any], path: str | Path) -> Broken:
    errors: Sequence[Any] = content["errors"]
    passage = Passage(
        model_from_dict(content["model"]), tuple(interval_model_from_dict(e, path) for e in errors), content["controller"],
        content["rho"], content["references"], content["initial"], bool(content["noise"]), tuple(content["rates"]),
    )  # fmt: skip
    low, high = (end if content[side] is None else float(content[side]) for side, end in (("low", -np.inf), ("high", np.inf)))
    return Broken(
        content["claim"], passage, content["signal"], int(content["sample"]), float(content["value"]), content["delta"],
        content["before"], content["share"], low, high,
    )  # fmt: skip
