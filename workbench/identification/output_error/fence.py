"""What keeps a fit away from models that are unstable somewhere in their box, where records that do not go there say nothing.

    cost + sum over rho of weight (|lambda(rho)| - limit)^2,    |lambda(rho)| > limit the largest modulus of the poles of A(rho)

on a lattice of schedule values. Unlike a step that is refused it has a slope, along which a minimisation goes round:

    d|lambda| / dA = Re(conj(lambda) / |lambda|  w v^T / (w^T v)),    w, v the left and right vectors of the pole

R. Horn, C. Johnson, "Matrix Analysis", 2nd ed. (2013), theorem 6.3.12.
"""

import numpy as np

from workbench.identification.output_error.free_numbers import FreeNumbers
from workbench.identification.output_error.passes import IN_A
from workbench.lpv import LPVModel

POINTS = 15  # of each of two schedule variables


class Fence:
    """Rows of a least-squares problem for poles beyond `limit` over the grid of a model."""

    def __init__(self, model: LPVModel, limit: float, weight: float):
        self.phi = model.still(model.grid(POINTS))
        self.limit, self.root = limit, np.sqrt(weight)

    def cost(self, model: LPVModel) -> float:
        """What the poles beyond the limit add to a sum of squares."""
        size = np.abs(np.linalg.eigvals(np.tensordot(self.phi, model.A, 1))).max(axis=1, initial=0.0)
        return float(np.sum((self.root * np.maximum(size - self.limit, 0.0)) ** 2))

    def normal(self, own: FreeNumbers) -> tuple[float, np.ndarray, np.ndarray]:
        """The cost, J'J (P, P) and J'e (P) with J = -de/dtheta."""
        P, in_A = len(own.places), np.flatnonzero(own.places[:, 0] == IN_A)
        J, e = np.zeros((0, P)), np.zeros(0)
        value, right = np.linalg.eig(np.tensordot(self.phi, own.model.A, 1))
        largest = np.argmax(np.abs(value), axis=1)
        beyond = np.flatnonzero(np.abs(value).max(axis=1) > self.limit)
        if len(beyond):
            pole = value[beyond, largest[beyond]]
            left = np.linalg.pinv(right[beyond])[np.arange(len(beyond)), largest[beyond]]  # scaled: w^T v = 1
            v = right[beyond, :, largest[beyond]]
            slope = np.real((np.conj(pole) / np.abs(pole))[:, None, None] * left[:, :, None] * v[:, None, :])
            e = self.root * (np.abs(pole) - self.limit)
            J = np.zeros((len(beyond), P))
            term, row, column = own.places[in_A, 1:].T
            J[:, in_A] = -self.root * self.phi[beyond][:, term] * slope[:, row, column]
        return float(e @ e), J.T @ J, J.T @ e
