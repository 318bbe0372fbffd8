"""Two decoupled PI loops around an operating point, as in the identification experiments of [1] section 1.4.2.

    u_i = bias_i + kp_i e_i + z_i,    e_i = r_i - y_i,    z_i+ = z_i + ki_i dt e_i

A negative gain is a loop whose input acts in the other direction. [1] "Experimental Modelling of a Web Winding Machine".
"""

from typing import Any

import numpy as np

from workbench.records import field, record


@record
class PILoops:
    """One PI loop for each actuated input: (actuated[i] from measured[i] and its set-point); see the module."""

    actuated: tuple[str, ...]
    measured: tuple[str, ...]
    references: tuple[str, ...]
    kp: np.ndarray = field("n")
    ki: np.ndarray = field("n", unit="1/s")
    bias: np.ndarray = field("n")
    dt: float = field("", unit="s", low=1e-9)
    name: str = "pi-loops"
    schedule: str | None = None

    @property
    def gains(self) -> np.ndarray:
        return np.concatenate([self.kp, self.ki * self.dt, self.bias])

    def init(self) -> np.ndarray:
        """The integrals z, all zero."""
        return np.zeros(len(self.kp))

    def law(self, gains: Any, state: Any, r: Any, y: Any, rho: Any = None) -> tuple[list, list]:
        """(u, z+) on numbers, arrays or symbols."""
        del rho
        n = len(self.kp)
        u, after = [], []
        for i in range(n):
            e = r[i] - y[i]
            u.append(gains[2 * n + i] + gains[i] * e + state[i])
            after.append(state[i] + gains[n + i] * e)
        return u, after

    def step(self, state: np.ndarray, r: np.ndarray, y: np.ndarray, rho: Any = None) -> tuple[np.ndarray, np.ndarray]:
        """One sample: (u, next state)."""
        u, after = self.law(self.gains, state, r, y, rho)
        return np.array(u), np.array(after)
