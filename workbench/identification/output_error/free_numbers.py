"""Which numbers of a model a fit moves, and models with other values of them."""

from dataclasses import replace
from functools import cached_property

import numpy as np

from workbench.basis import unity
from workbench.identification.output_error.passes import IN_A, IN_B, IN_C, IN_D, IN_GAIN, IN_OFFSET, IN_ZERO
from workbench.lpv import LPVModel, OperatingPoint, Predictor
from workbench.records import record


@record
class FreeNumbers:
    """The entries of a model's matrices that a fit may move: `places` (P, 4) by kind, term, row and column.

    What is exactly 0 or 1 is structure: a term that was not selected, a shift of a delay.
    """

    model: LPVModel
    places: np.ndarray

    @classmethod
    def of(cls, model: LPVModel) -> "FreeNumbers":
        """Entries of A, B, C, D, and of the operating point's outputs."""
        found = []
        for kind, M in ((IN_A, model.A), (IN_B, model.B), (IN_C, model.C), (IN_D, model.D)):
            found += [(kind, *place) for place in np.argwhere((M != 0.0) & (M != 1.0))]
        found += [(IN_OFFSET, j, r, 0) for j, r in np.ndindex(model.operating_point.y.shape)]
        return cls(model, np.array(found, dtype=np.int64).reshape(-1, 4))

    @classmethod
    def all_of(cls, model: LPVModel, *, direct: bool) -> "FreeNumbers":
        """Every entry of A, B and C, with `direct` of D, and of the operating point's inputs and outputs.

        Where the schedule is an output, C and D do not move with it: y = C(y) x would be an implicit equation.
        """
        kinds = [(IN_A, model.A), (IN_B, model.B), (IN_C, model.C), *([(IN_D, model.D)] if direct else [])]
        found = [(kind, *place) for kind, M in kinds for place in np.ndindex(M.shape)]
        if model.scheduled_output is not None:
            still = np.flatnonzero(constant_weights(model)).tolist()
            found = [place for place in found if place[0] in (IN_A, IN_B) or place[1] in still]
        found += [(IN_OFFSET, j, r, 0) for j, r in np.ndindex(model.operating_point.y.shape)]
        found += [(IN_ZERO, j, 0, c) for j, c in np.ndindex(model.operating_point.u.shape)]
        return cls(model, np.array(found, dtype=np.int64))

    @classmethod
    def of_gain(cls, model: LPVModel) -> "FreeNumbers":
        """Entries of a gain K that is the same at every schedule value; what only shifts a delayed input is known without."""
        ny, unknown = len(model.outputs), np.flatnonzero(((model.A != 0.0) & (model.A != 1.0)).any(axis=(0, 2)))
        return cls(model, np.array([(IN_GAIN, 0, r, c) for r in unknown for c in range(ny)], dtype=np.int64).reshape(-1, 4))

    @classmethod
    def nothing(cls, model: LPVModel) -> "FreeNumbers":
        """None: only starts are to be found."""
        return cls(model, np.zeros((0, 4), dtype=np.int64))

    @cached_property
    def values(self) -> np.ndarray:
        """The numbers (P) as they stand in the model."""
        stored = self._stored(self.model)
        return np.array([stored[kind][t, r, c] for kind, t, r, c in self.places])

    def moved(self, values: np.ndarray) -> "FreeNumbers":
        """The same entries of the model with other values (P); its predictor keeps its gain, unless that is among them."""
        own = {kind: M.copy() for kind, M in self._stored(self.model).items()}
        for (kind, t, r, c), value in zip(self.places, values, strict=True):
            own[kind][t, r, c] = value
        A, B, C, D = (own[kind] for kind in (IN_A, IN_B, IN_C, IN_D))
        gain, weight = own[IN_GAIN][0], constant_weights(self.model)
        predictor = Predictor(A - gain @ C, B - gain @ D, weight[:, None, None] * gain, self.model.warmup)
        point = replace(self.model.operating_point, u=own[IN_ZERO][:, 0], y=own[IN_OFFSET][:, :, 0])
        return replace(self, model=replace(self.model, A=A, B=B, C=C, D=D, operating_point=point, predictor=predictor))

    @staticmethod
    def _stored(model: LPVModel) -> dict[int, np.ndarray]:
        point: OperatingPoint = model.operating_point
        return {
            IN_A: model.A, IN_B: model.B, IN_C: model.C, IN_D: model.D, IN_OFFSET: point.y[:, :, None], IN_ZERO: point.u[:, None],
            IN_GAIN: constant_gain(model)[None],
        }  # fmt: skip


def constant_weights(model: LPVModel) -> np.ndarray:
    """Weights q (nt) with sum_j q_j phi_j(rho(k - d_j)) = 1: terms without a delay; NaN where the basis has no constant."""
    by_function, now = unity(model.basis), {term.function: j for j, term in enumerate(model.terms) if term.delay == 0}
    needed = [] if by_function is None else np.flatnonzero(by_function).tolist()
    if by_function is None or not now.keys() >= set(needed):
        return np.full(len(model.terms), np.nan)
    q = np.zeros(len(model.terms))
    q[[now[function] for function in needed]] = by_function[needed]
    return q


def constant_gain(model: LPVModel) -> np.ndarray:
    """K (nx, ny) of the model's predictor in the middle of its span; 0 without one."""
    if model.predictor is None:
        return np.zeros((model.order, len(model.outputs)))
    middle = np.stack([model.middle] * (1 + max(term.delay for term in model.terms)))
    return np.tensordot(model.weights(middle)[-1], model.predictor.K, 1)
