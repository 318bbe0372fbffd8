"""What a proof or a refutation rests on, as a file that someone else checks without this program; see docs/proofs.md.

Every entry says what is claimed, of which matrices, and what shows it: a Lyapunov function, a sequence, or a run. A bound along a
run needs nothing but the matrices and limits: whoever checks computes a bound of his own. Numbers are doubles, written so that
reading gives the same one again; null stands for no limit.
"""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from workbench.robustness.envelopes.certificate import Certificate
from workbench.robustness.envelopes.course import Course
from workbench.robustness.lyapunov import ScheduledCertificate, ScheduledLoop
from workbench.robustness.margins import Certificate as Falling
from workbench.robustness.margins import Falsified
from workbench.robustness.uncertain import UncertainLoop

FORMAT, VERSION = "gain-scheduling proof", 1

Shown = Mapping[str, Any]


def falls(loop: UncertainLoop, found: Falling, needed: float) -> Shown:
    """A quadratic function of the state falls at every sample, whatever the parameters do in boxes `needed` times as wide."""
    own = {"kappa": found.kappa, "P": found.P, "D": found.D, "steps": found.steps}
    return {"kind": "falls", "needed": needed, "loop": _loop(loop), **own}


def grows(loop: UncertainLoop, found: Falsified, needed: float) -> Shown:
    """Parameters that, repeated, let a state grow in boxes `needed` times as wide."""
    return {"kind": "grows", "needed": needed, "loop": _loop(loop), "kappa": found.kappa, "delta": found.delta}


def falls_in_motion(loop: ScheduledLoop, found: ScheduledCertificate, needed: float) -> Shown:
    """A quadratic function of the state, itself a function of the schedule, falls at every sample."""
    own = {"kappa": found.kappa, "rate": found.rate, "P": found.P, "W": found.W, "D": found.D}
    return {"kind": "falls in motion", "needed": needed, "loop": _plain(loop), **own}


def stays(course: Course, bound: Shown, linear: Shown, constant: bool, duals: Sequence[Certificate]) -> Shown:
    """Every run stays within a bound, or every one with `constant` parameters; until its end the law is linear."""
    proved = {"constant": constant, "duals": [_plain(dual) for dual in duals]}
    return {"kind": "stays", "course": course, "bound": bound, **linear, **proved}


def leaves(
    course: Course, bound: Shown, linear: Shown, constant: bool, sample: int, delta: np.ndarray, before: np.ndarray,
    share: np.ndarray,
) -> Shown:  # fmt: skip
    """One run is beyond a bound at a sample, up to which the law is linear."""
    run = {"sample": sample, "delta": delta, "before": before, "share": share}
    return {"kind": "leaves", "course": course, "bound": bound, **linear, "constant": constant, **run}


def clipped(bounds: Sequence[Shown], own: Sequence[Shown]) -> Shown:
    """The law itself commands nothing beyond its `own` limits, which are no wider than the bounds."""
    return {"kind": "clipped", "bounds": list(bounds), "own": list(own)}


def limits(signal: str, low: np.ndarray | float, high: np.ndarray | float) -> Shown:
    """low <= signal <= high."""
    return {"signal": signal, "low": low, "high": high}


def proof_file(controller: str, claims: Sequence[tuple[str, str, Shown]]) -> dict[str, Any]:
    """The content of a proof file of claims (claim, status, what shows it); a course that several rest on is in it once."""
    courses: list[Course] = []
    entries = []
    for claim, status, shown in claims:
        entry = {"claim": claim, "status": status, **shown}
        if (course := entry.get("course")) is not None:
            known = [k for k, own in enumerate(courses) if own is course]
            courses += [] if known else [course]
            entry["course"] = known[0] if known else len(courses) - 1
        entries.append(entry)
    return {
        "format": FORMAT, "version": VERSION, "controller": controller, "claims": entries,
        "courses": [_plain(course) | {"before": course.before and _plain(course.before)} for course in courses],
    }  # fmt: skip


def _loop(loop: UncertainLoop) -> Shown:
    return {name: getattr(loop, name) for name in ("A", "B", "C", "lam", "channel")}


def _plain(own: Any) -> dict[str, Any]:
    return {f.name: getattr(own, f.name) for f in fields(own)}
