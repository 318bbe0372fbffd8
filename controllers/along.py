"""The model of an MPC along the schedule that it will run through."""

from typing import TYPE_CHECKING

import numpy as np

from workbench.lpv import ends
from workbench.steady import rests

if TYPE_CHECKING:
    from controllers.mpc import MPC


class Along:
    """The model along the schedule of the horizon; z = (x, d) is the observer's state."""

    def __init__(self, law: "MPC", path: np.ndarray):
        self.path, self.at_inputs = path, law.observer.at_inputs
        self.nx, self.nu, self.ny = law.model.order, len(law.actuated), len(law.measured)
        # a term may see the schedule some samples late: before now it came the way it goes on
        before = path[0] - np.multiply.outer(np.arange(law._latest, 0, -1), path[1] - path[0])
        phi = law.model.basis(np.concatenate([np.clip(before, *ends(law.model.spans)), path]))
        late = np.arange(len(path))[:, None] + law._latest - law._delays
        weight = phi[late, law._functions]
        self.M = weight @ law._flat
        if law.tube is not None:
            self.K = (weight @ law._flat_K).reshape(len(path), self.nx, self.ny)
        self.u0, self.y0 = law.operating(path)

    def matrices(self, i: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A, B, C of sample i."""
        nx, nu = self.nx, self.nu
        A, B, C = np.split(self.M[i], [nx * nx, nx * (nx + nu)])
        return A.reshape(nx, nx), B.reshape(nx, nu), C.reshape(self.ny, nx)

    def disturbances(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """At the inputs (nu,) and at the outputs (ny,)."""
        d = z[self.nx :]
        return (d, np.zeros(self.ny)) if self.at_inputs else (np.zeros(self.nu), d)

    def pushed(self, u: np.ndarray) -> np.ndarray:
        """B_i u_i, (N, nx)."""
        B = self.M[: len(u), self.nx**2 : self.nx * (self.nx + self.nu)].reshape(-1, self.nx, self.nu)
        return np.ascontiguousarray((B @ u[:, :, None])[:, :, 0])

    def outputs(self, z: np.ndarray) -> np.ndarray:
        """What is measured now at z."""
        return self.matrices(0)[2] @ z[: self.nx] + self.disturbances(z)[1] + self.y0[0]

    def under(self, z: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Outputs of samples 1 .. N, (N, ny), under a constant command."""
        x, (d_in, d_out), found = z[: self.nx], self.disturbances(z), []
        for i in range(len(self.path) - 1):
            A, B, _ = self.matrices(i)
            x = A @ x + B @ (u - self.u0[i] + d_in)
            found.append(self.matrices(i + 1)[2] @ x + d_out + self.y0[i + 1])
        return np.array(found)

    def moved(self, z: np.ndarray, u: np.ndarray, push: np.ndarray) -> np.ndarray:
        """z at the next sample."""
        A, B, _ = self.matrices(0)
        x = A @ z[: self.nx] + B @ (u - self.u0[0] + self.disturbances(z)[0])
        return np.concatenate([x, z[self.nx :]]) + push

    def moved_by(self, e: np.ndarray) -> np.ndarray:
        """What an error e of this sample's prediction moves (x, d) by on its way to the next."""
        return np.concatenate([self.K[0] @ e, np.zeros(self.ny)])

    def by_errors(self, d: np.ndarray) -> np.ndarray:
        """What errors d of all samples to come move the outputs of samples 1 .. N by, (N, ny); this sample's is known."""
        from controllers.condensing import carried

        return carried(self.M, self.K, d)

    def settled_by(self, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What errors d that stay move the state (nx,) and the outputs (ny,) by in the end, at the last sample's schedule."""
        A, _, C = self.matrices(len(self.path) - 1)
        x = np.linalg.solve(np.eye(self.nx) - A, self.K[-1] @ d)
        return x, C @ x + d

    def predictor_at_rest(self, u: np.ndarray, y: np.ndarray) -> np.ndarray:
        """(x, e) of the predictor of a machine that has stood at y under u."""
        A, B, C = self.matrices(0)
        own = y - self.y0[0]
        x = np.linalg.solve(np.eye(self.nx) - A + self.K[0] @ C, B @ (u - self.u0[0]) + self.K[0] @ own)
        return np.concatenate([x, own - C @ x])

    def at_rest(self, u: np.ndarray, y: np.ndarray) -> np.ndarray:
        """z of a machine that stands at y under u."""
        A, B, C = self.matrices(0)
        own = u - self.u0[0]
        if self.at_inputs:
            X, U = rests(A, B, C, np.zeros((len(C), B.shape[1])))
            return np.concatenate([X @ (y - self.y0[0]), U @ (y - self.y0[0]) - own])
        moved = np.linalg.solve(np.eye(self.nx) - A, B)
        return np.concatenate([moved @ own, y - self.y0[0] - C @ moved @ own])
