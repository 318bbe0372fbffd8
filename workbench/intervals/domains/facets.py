"""Facets and corners of the hull of points by Qhull, and on which side of them a point lies."""

from typing import Any

import numpy as np

from workbench.intervals.domains.boxes import FLAT, INSIDE
from workbench.records import record

FACET_DIMENSIONS = 6  # above, the facets of a hull are too many


@record
class Facets:
    """normals (x - middle) <= offsets: conv(points) within its affine hull, flat (x - middle) = 0 where it is not full.

    Rows are of unit length in whitened coordinates. reach, flat_reach: how far a row moves when the domain is widened by 1 s.
    """

    normals: np.ndarray
    offsets: np.ndarray
    flat: np.ndarray
    middle: np.ndarray
    reach: np.ndarray
    flat_reach: np.ndarray

    def side(self, x: np.ndarray) -> np.ndarray:
        """For x (Q, d): 1 inside to 1e-12 of the cloud's spread, -1 outside by a gauge above INSIDE, 0 too close to tell.

        Samples of a two-valued input all lie on facets: those must count without a program.
        """
        rows = len(self.normals) + len(self.flat)
        chunk = max(1, 4_000_000 // max(rows, 1))  # keeps the products small
        parts = [self._sides(x[k : k + chunk] - self.middle) for k in range(0, len(x), chunk)]
        return np.concatenate(parts) if parts else np.zeros(0, dtype=int)

    def _sides(self, part: np.ndarray) -> np.ndarray:
        found = np.ones(len(part), dtype=int)
        for rows, offsets, reach, two in (
            (self.normals, self.offsets, self.reach, False),
            (self.flat, 0.0, self.flat_reach, True),
        ):
            if not len(rows):
                continue
            beyond = part @ rows.T
            beyond = np.abs(beyond) if two else np.subtract(beyond, offsets, out=beyond)
            near = np.flatnonzero(beyond.max(axis=1) > 1e-12)
            outside = np.any(beyond[near] > 2 * INSIDE * reach + 1e-12, axis=1)
            found[near] = np.minimum(found[near], np.where(outside, -1, 0))
        return found


def facets_of(points: np.ndarray, scale: np.ndarray) -> tuple[Facets | None, np.ndarray | None]:
    """Facets of conv(points) by Qhull, and its corners where it is not flat; None in too many dimensions."""
    m, d = points.shape
    middle = points.mean(axis=0)
    # delayed values of one signal lie near a plane: whitened, they do not trouble Qhull
    triangle: Any = np.linalg.qr((points - middle) / scale, mode="r")
    _, size, axes = np.linalg.svd(triangle, full_matrices=True)
    size = np.concatenate([size, np.zeros(d - len(size))])
    rank = int(np.sum(size > FLAT * max(size[0], FLAT * np.sqrt(m))))
    if d < 2 or rank > FACET_DIMENSIONS:
        return None, None
    whiten = axes[:rank].T * (np.sqrt(m) / size[:rank]) / scale[:, None]
    equations, corners = _hull_equations((points - middle) @ whiten)
    if equations is None:
        return None, None
    normals, flat = equations[:, :-1] @ whiten.T, axes[rank:] / scale
    facets = Facets(normals, -equations[:, -1], flat, middle, np.abs(normals) @ scale, np.abs(flat) @ scale)
    return facets, corners if rank == d else None


def _hull_equations(points: np.ndarray) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Rows normal'x + offset <= 0 of conv(points) (m, r), and the corners' numbers."""
    from scipy.spatial import ConvexHull, QhullError

    r = points.shape[1]
    if r == 0:
        return np.zeros((0, 1)), None
    if r == 1:
        return np.array([[1.0, -points.max()], [-1.0, points.min()]]), None
    try:
        hull = ConvexHull(points)
    except QhullError:
        return None, None
    return np.unique(hull.equations, axis=0), np.sort(hull.vertices)
