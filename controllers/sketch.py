"""A designed PID with other bounds, at once: its gains times one factor, for who drags a bound and wants to see what it buys.

    K_s = s K,   s the largest factor at which |S|, |T| and the effort of a few frozen loops are within the bounds

The design itself weighs the gains against each other and keeps its bounds between all frequencies and schedule values; a sketch
moves them together and looks at a grid. It shows the way, and a design must follow.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from controllers.scheduled_pid import ScheduledPID
from workbench.errors import InputError
from workbench.lpv import LPVModel
from workbench.records import field, record
from workbench.robustness.frequency import Closed, System
from workbench.robustness.frozen import Bounds, feedback_of, frequencies
from workbench.steady import gain

POINTS = 5  # schedule values
SHARES = np.geomspace(1e-3, 50.0, 30)  # factors that are tried before the best of them is refined
FINER = 2  # frequencies, in those that a design looks at
REFINED = 8  # halvings of the gap between two of them
DRAWN = 240  # samples of a step response


class _Frozen(NamedTuple):
    """The model and the law at a schedule value, with their responses P (N, ny, nu) and K (N, nu, ny) to what is measured."""

    rho: Any
    plant: System
    answer: System
    P: np.ndarray
    K: np.ndarray
    least: float  # effort that any law with integral action needs


@record
class Sketched:
    """Frozen loops of a law whose gains are multiplied by `share`: peaks at n schedule values, and what is drawn of them.

    kept: whether the bounds hold there; where no factor keeps them the law is drawn as it is. loops (n, N, nu, 2): L of each
    command, the others closed, as pairs of real and imaginary part. t (M) and steps (n, ny, M): every output after a unit step
    of its own set-point.
    """

    share: float = field("", low=0.0)
    kept: bool
    sensitivity: np.ndarray = field("n")
    complementary: np.ndarray = field("n")
    effort: np.ndarray = field("n")
    loops: np.ndarray = field("n N nu 2")
    t: np.ndarray = field("M", unit="s")
    steps: np.ndarray = field("n ny M")

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers."""
        keys = ("sensitivity", "complementary", "effort", "loops", "t", "steps")
        return {"share": self.share, "kept": self.kept} | {key: getattr(self, key).tolist() for key in keys}


class Sketch:
    """Sketches of a law that was designed on a model.

    >>> Sketch(law, model).within(Bounds(sensitivity=1.3)).share < 1.0
    True
    """

    def __init__(self, law: ScheduledPID, model: LPVModel):
        """Raises InputError where the law is none of the model's."""
        if not isinstance(law, ScheduledPID):
            raise InputError(f"{law.name} is no PID", mend="sketch a PID; an MPC is designed anew for every number")
        if (law.actuated, law.measured) != (tuple(c.name for c in model.inputs), tuple(c.name for c in model.outputs)):
            raise InputError(
                f"{law.name} moves {', '.join(law.actuated)}", file=model.name, mend="choose the model it was made for"
            )
        self.law, self.model = law, model
        self.rhos = list(model.frozen_values(POINTS)) if model.schedules else [None]

    @property
    def points(self) -> list[str]:
        """The schedule values, as they are written."""
        return [self.model.named(rho) or self.model.name for rho in self.rhos]

    @cached_property
    def _omega(self) -> np.ndarray:
        return frequencies(self.model.dt, FINER)

    @cached_property
    def _points(self) -> list[_Frozen]:
        model, found = self.model, []
        gains = [gain(*model.freeze(rho), model.free) for rho in self.rhos]
        scale = np.linalg.norm(np.mean(gains, axis=0), axis=1)
        for rho, P0 in zip(self.rhos, gains, strict=True):
            A, B, C, D = model.freeze(rho)
            plant = System(A, B, C / scale[:, None], D / scale[:, None], model.dt)
            answer = feedback_of(self.law, rho)
            answer = replace(answer, B=answer.B * scale, D=answer.D * scale)
            least = 1.0 / np.linalg.svd(P0 / scale[:, None], compute_uv=False)[-1]
            found.append(_Frozen(rho, plant, answer, plant.at(self._omega), answer.at(self._omega), least))
        return found

    def within(self, bounds: Bounds) -> Sketched:
        """The law with the largest common factor of its gains at which every loop is stable and keeps the bounds on the grid."""
        kept = [self._keeps(share, bounds) for share in SHARES]
        if not any(kept):
            return self.at(1.0, kept=False)
        best = int(np.flatnonzero(kept)[-1])
        low = high = float(SHARES[best])
        if best + 1 < len(SHARES):
            high = float(SHARES[best + 1])
            for _ in range(REFINED):
                middle = np.sqrt(low * high)
                low, high = (middle, high) if self._keeps(middle, bounds) else (low, middle)
        return self.at(low)

    def at(self, share: float, *, kept: bool = True) -> Sketched:
        """The law with its gains times `share`."""
        peaks = np.array([self._peaks(own, share) for own in self._points])
        loops = np.array([self._opened(own, share) for own in self._points])
        law = replace(self.law, **{key: share * getattr(self.law, key) for key in ("Kp", "Ki", "Kd")})
        systems = [self._following(law, own.rho) for own in self._points]
        slowest = max(min(np.abs(np.linalg.eigvals(A)).max(), 1.0 - 1e-4) for A, *_ in systems)
        samples = int(np.clip(4.0 / -np.log(slowest), 20, 1e5))
        every = max(1, samples // DRAWN)
        steps = np.array([_steps(system, samples, every) for system in systems])
        t = self.model.dt * every * np.arange(steps.shape[-1])
        return Sketched(share, kept, peaks[:, 0], peaks[:, 1], peaks[:, 2], loops, t, steps)

    def _keeps(self, share: float, bounds: Bounds) -> bool:
        most = np.array([bounds.sensitivity, bounds.complementary, bounds.effort])
        return all(np.all(self._peaks(own, share) <= most) and _stable(own, share) for own in self._points)

    def _peaks(self, own: _Frozen, share: float) -> np.ndarray:
        """Largest |S|, |T| at the commands, and |Q| in the least that is needed."""
        S = self._sensitivity(own, share)
        Q = share * S @ own.K
        norms = [np.linalg.norm(G, 2, axis=(1, 2)).max() for G in (S, S - np.eye(S.shape[1]), Q)]
        return np.array([norms[0], norms[1], norms[2] / own.least])

    def _sensitivity(self, own: _Frozen, share: float) -> np.ndarray:
        L = share * own.K @ own.P
        return np.linalg.inv(np.eye(L.shape[1]) + L)

    def _opened(self, own: _Frozen, share: float) -> np.ndarray:
        L = 1.0 / np.diagonal(self._sensitivity(own, share), axis1=1, axis2=2) - 1.0
        return np.stack([L.real, L.imag], axis=-1)

    def _following(self, law: ScheduledPID, rho: Any) -> tuple[np.ndarray, ...]:
        """A, B, C, D from the set-points to the outputs of the frozen loop."""
        A, B, C, D = self.model.freeze(rho)
        own: Any = law.at(rho)
        at_r, at_y = slice(len(law.references)), slice(len(law.references), None)
        x, z, r = np.split(np.eye(len(A) + len(own.A) + len(law.references)), np.cumsum([len(A), len(own.A)]))
        u = own.C @ z + own.D[:, at_r] @ r + own.D[:, at_y] @ C @ x
        u = np.linalg.solve(np.eye(len(u)) - own.D[:, at_y] @ D, u)
        y = C @ x + D @ u
        after = np.vstack([A @ x + B @ u, own.A @ z + own.B[:, at_r] @ r + own.B[:, at_y] @ y])
        n = len(after)
        return after[:, :n], after[:, n:], y[:, :n], y[:, n:]


def _stable(own: _Frozen, share: float) -> bool:
    scaled = replace(own.answer, C=share * own.answer.C, D=share * own.answer.D)
    return Closed.of(own.plant, scaled).system.stable


def _steps(system: Sequence[np.ndarray], samples: int, every: int) -> np.ndarray:
    """y_i (ny, M), every so many samples, after a unit step of r_i, one after the other."""
    A, B, C, D = system
    many, held = np.linalg.matrix_power(A, every), np.zeros_like(A)
    for _ in range(every):
        held = held @ A + np.eye(len(A))
    x, shown = np.zeros((len(A), B.shape[1])), []
    for _ in range(samples // every + 1):
        shown.append(np.diagonal(C @ x + D))
        x = many @ x + held @ B
    return np.array(shown).T
