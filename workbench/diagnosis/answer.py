"""What a diagnosis says: the verdict, the causes with their sizes and evidence, and what could not be said."""

from collections.abc import Mapping
from enum import Enum
from typing import Any

import numpy as np

from workbench.physics.parameters import EffectSizes
from workbench.records import field, record

ROUNDED = "quantisation"  # the effect whose cause is the step of the readings: it says how good a prediction can be
NO_SIZE = "from which size on these records would show it is not known"  # why an effect is said to be untestable


class Finding(Enum):
    """The verdict in one word."""

    NAMED = "named"  # what is missing has a name, or one that a law in the plant's own equations ties with
    NOTHING = "nothing"  # nothing is missing that these data can show
    UNKNOWN = "unknown"  # something is missing and no entry of the catalogue explains it
    INCOMPLETE = "incomplete"  # causes are named, not all of them sure, or a significant remainder is left


@record
class Estimate:
    """A number with its 95 % interval."""

    value: float
    low: float
    high: float
    unit: str
    nominal: float = 0.0


@record
class Gain:
    """A channel's error on held-out records, root mean square, before and after the extension, for one horizon."""

    channel: str
    horizon: str  # one-step, one-second, full-run
    before: float
    after: float
    unit: str
    record: str


@record
class Evidence:
    """delta_bic: by how much the cause is preferred to the model without it; p_value: family-wise; posterior: in its tie."""

    delta_bic: float
    p_value: float
    posterior: float


@record
class Cause:
    """A named effect: "coulomb@unwind", one sentence, its numbers, what it gains on held-out records, evidence and rivals.

    ties: rivals that these records cannot tell from it, with their weights; "a + b" are two effects together. stability: p-value
    of one size in all records. separates: what tells it from its look-alikes. doubt: what speaks against it although the records
    prefer the plant with it; empty where it is sure.
    """

    effect: str
    place: str
    sentence: str
    parameters: Mapping[str, Estimate]
    gains: tuple[Gain, ...]
    evidence: Evidence
    ties: Mapping[str, float] = field(default_factory=dict)
    stability: float = 1.0
    separates: str = ""
    doubt: str = ""

    @property
    def key(self) -> str:
        return f"{self.effect}@{self.place}"


@record
class Untestable:
    """An effect that these records could not show at any sensible size, and why."""

    effect: str
    place: str
    why: str


@record
class Limit:
    """The smallest size of an effect that these records show (5 standard deviations)."""

    effect: str
    place: str
    value: float
    unit: str


@record
class Remainder:
    """What is left over: where it enters, over what it varies, family-wise p-value, and its share of the error's variance."""

    channel: str
    variable: str
    p_value: float
    share: float
    sentence: str
    grid: np.ndarray = field("n")
    curve: np.ndarray = field("n")


@record
class NextExperiment:
    """The test that would decide: a sentence, the set-points or inputs by name (N,), and the expected evidence by template.

    runs: how often the signals are to be played, each time as a record of its own.
    """

    sentence: str
    signals: Mapping[str, np.ndarray]
    dt: float
    expected: Mapping[str, float]
    runs: int = 1


@record
class Diagnosis:
    """See the module. effects and parameters extend the plant: what `simulate` takes.

    similarity (m, m): share of the signature of the effect in a row that the one in a column can mimic, for the keys in `tested`.
    between: inputs that go on between their samples although the plant does not say so, see `Plant`.
    signs: parameters that had to leave their tolerance. compared: how far free runs were, where the plant is unstable.
    objections: where the extended plant is worse on held-out records than the plant that it replaces, so that it is not handed
    out.
    """

    plant: str
    finding: Finding
    causes: tuple[Cause, ...]
    recalibrated: Mapping[str, Estimate]
    untestable: tuple[Untestable, ...]
    limits: tuple[Limit, ...]
    remainder: tuple[Remainder, ...]
    next_experiment: NextExperiment | None
    effects: EffectSizes
    parameters: Mapping[str, float]
    tested: tuple[str, ...]
    similarity: np.ndarray = field("m m")
    notes: tuple[str, ...] = ()
    signs: tuple[str, ...] = ()
    compared: str = ""
    objections: tuple[str, ...] = ()
    seconds: float = 0.0
    between: Mapping[str, str] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """The JSON of a diagnosis, provenance apart."""
        return {
            "verdict": self.finding.value,
            "causes": [_cause(c) for c in self.causes],
            "recalibrated": {
                name: {"nominal": e.nominal, "value": e.value, "low": e.low, "high": e.high, "unit": e.unit}
                for name, e in self.recalibrated.items()
            },
            "untestable": [{"effect": u.effect, "at": u.place, "why": u.why} for u in self.untestable],
            "detection_limits": [{"effect": d.effect, "at": d.place, "value": d.value, "unit": d.unit} for d in self.limits],
            "remainder": [
                {"channel": r.channel, "over": r.variable, "p_value": r.p_value, "share": r.share, "sentence": r.sentence}
                for r in self.remainder
            ],
            "between": dict(self.between),
            "notes": [*self.signs, *([self.compared] if self.compared else []), *self.notes],
            "objections": list(self.objections),
        }


def _cause(c: Cause) -> dict[str, Any]:
    gain: dict[str, dict[str, Any]] = {}
    for g in c.gains:
        gain.setdefault(g.horizon, {}).setdefault(g.record, {})[g.channel] = {
            "before": g.before,
            "after": g.after,
            "unit": g.unit,
        }
    whole = gain.get("one-step", {})
    channels = {ch: v for record_gains in whole.values() for ch, v in record_gains.items()}
    return {
        "effect": c.effect,
        "at": c.place,
        "sentence": c.sentence,
        "parameters": {
            name: {"value": e.value, "low": e.low, "high": e.high, "unit": e.unit} for name, e in c.parameters.items()
        },
        "gain": channels,
        "gains": gain,
        "evidence": {"delta_bic": c.evidence.delta_bic, "p_value": c.evidence.p_value, "posterior": c.evidence.posterior},
        "ties": list(c.ties),
        "stability": c.stability,
        "sure": not c.doubt,
        "doubt": c.doubt,
    }
