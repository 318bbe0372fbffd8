"""The projection of a domain onto two coordinates, for figures."""

import numpy as np

from workbench.errors import InputError
from workbench.intervals.domains.shapes import Domain


def shadow(domain: Domain, first: int, second: int) -> np.ndarray:
    """Corners (v, 2), counter-clockwise, of the domain's projection onto two coordinates; exact, two or one if it is flat."""
    d = len(domain.low)
    if not (0 <= first < d and 0 <= second < d):
        raise InputError(f"coordinates {first} and {second} of a domain with {d}", mend=f"0 to {d - 1}")
    low, high = domain.boxes.low[:, [first, second]], domain.boxes.high[:, [first, second]]
    corners = np.vstack([np.column_stack([a[:, 0], b[:, 1]]) for a in (low, high) for b in (low, high)])
    corners = np.unique(corners, axis=0)
    if len(corners) < 3:
        return corners
    return np.array([*_chain(corners)[:-1], *_chain(corners[::-1])[:-1]])


def _chain(corners: np.ndarray) -> list[np.ndarray]:
    """The corners of sorted points that only turn left (Andrew's monotone chain)."""
    chain: list[np.ndarray] = []
    for p in corners:
        while len(chain) > 1 and np.linalg.det(np.array([chain[-1] - chain[-2], p - chain[-2]])) <= 0:
            chain.pop()
        chain.append(p)
    return chain
