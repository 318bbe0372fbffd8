"""Sets of boxes, of which domains are made, and what counts as inside and as flat."""

import numpy as np

from workbench.records import record

INSIDE = 1e-9  # a gauge below this is reported as 0: the accuracy of the linear programs
FLAT = 1e-9  # a range this small against the values is rounding


@record
class Boxes:
    """Boxes [low_k, high_k], (m, d). With low > high a box asks to be covered rather than to be met."""

    low: np.ndarray
    high: np.ndarray

    @staticmethod
    def one(low: np.ndarray, high: np.ndarray) -> "Boxes":
        return Boxes(low[None], high[None])

    @property
    def size(self) -> np.ndarray:
        """Largest magnitude in every coordinate: what rounding is measured by."""
        return np.maximum(np.abs(self.low), np.abs(self.high)).max(axis=0)

    def highest(self, w: np.ndarray) -> float:
        return float((self.high @ np.maximum(w, 0.0) + self.low @ np.minimum(w, 0.0)).max())
