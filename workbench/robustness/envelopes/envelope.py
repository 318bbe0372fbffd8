"""The envelope of a course: its guaranteed bounds, tightened by the dual at chosen instants, and what the adversary reached."""

from collections.abc import Sequence

import numpy as np

from workbench.errors import InputError
from workbench.records import field, record
from workbench.robustness.envelopes.adversary import Reached, worst
from workbench.robustness.envelopes.certificate import Certificate
from workbench.robustness.envelopes.course import Course
from workbench.robustness.envelopes.dual import dual
from workbench.robustness.envelopes.kernel import kernel

NOTHING = 1e-9  # deviation relative to the signal up to which bounds are rounding, and their ratio says nothing


@record
class Envelope:
    """Of every watched signal (N s): where it is without deltas, the guaranteed bounds low, high, and what was reached.

    questions: the (signal, instant, side) at which adversary and dual were asked, in the order of `reached`, `certificates` (None
    where no proof was found: the kernel's bound stays) and `ratio` (S), the guaranteed deviation from the nominal run over the
    reached one: 1 leaves nothing open. Elsewhere the bounds are the kernel's, of gain `gain`.
    """

    signals: tuple[str, ...]
    nominal: np.ndarray = field("N s")
    low: np.ndarray = field("N s", low=-np.inf)
    high: np.ndarray = field("N s")
    reached_low: np.ndarray = field("N s")
    reached_high: np.ndarray = field("N s")
    questions: tuple[tuple[str, int, int], ...]
    ratio: np.ndarray = field("S")
    reached: Reached
    certificates: tuple[Certificate | None, ...]
    gain: float


def envelope(
    course: Course,
    instants: Sequence[int] | None = None,
    limits: np.ndarray | None = None,
    seed: int = 0,
) -> Envelope:
    """Guaranteed and reached bounds of every watched signal.

    The kernel bounds every sample. At the instants, by default for each signal and side the one where the kernel comes nearest to
    its limit in limits (s 2; infinite or none: where it is widest), the dual tightens it and the adversary says what is real.
    """
    outer, s = kernel(course), len(course.signals)
    run = outer.nominal
    low, high = outer.low, outer.high
    if instants is None:
        bounds = np.tile([-np.inf, np.inf], (s, 1)) if limits is None else np.asarray(limits, dtype=float)
        if bounds.shape != (s, 2) or not np.all(bounds[:, 0] < bounds[:, 1]):
            raise InputError(f"limits of shape {bounds.shape}", mend=f"({s}, 2): low < high of {', '.join(course.signals)}")
        questions = []
        for i, name in enumerate(course.signals):
            for side, beyond, limit in ((1, high[:, i], bounds[i, 1]), (-1, -low[:, i], -bounds[i, 0])):
                questions.append((name, int((beyond if np.isfinite(limit) else outer.half[:, i]).argmax()), side))
    else:
        questions = [(name, int(k), side) for name in course.signals for k in instants for side in (1, -1)]
    found = worst(course, questions, seed=seed)
    certificates, ratio = [], np.ones(len(questions))
    for number, (name, k, side) in enumerate(questions):
        i = course.number(name)
        proof = dual(course, found, number, outer)
        certificates.append(proof)
        if proof is not None and side == 1:
            high[k, i] = min(high[k, i], proof.bound)
        elif proof is not None:
            low[k, i] = max(low[k, i], -proof.bound)
        guaranteed = high[k, i] - run.v[k, i] if side == 1 else run.v[k, i] - low[k, i]
        deviation = side * (float(found.value[number]) - run.v[k, i])
        if guaranteed > NOTHING * np.abs(run.v[:, i]).max():
            ratio[number] = guaranteed / deviation if deviation > 0.0 else np.inf
    reached_low, reached_high = (reduce(run.v, reduce.reduce(found.v, axis=0)) for reduce in (np.fmin, np.fmax))
    return Envelope(
        course.signals, run.v, low, high, reached_low, reached_high, tuple(questions), ratio, found, tuple(certificates),
        outer.gain,
    )  # fmt: skip
