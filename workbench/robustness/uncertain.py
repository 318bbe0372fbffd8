"""The undriven loop: a linear middle and parameters within boxes, one scalar per output, in coordinates fit for a solver.

    x(k+1) = A x(k) + B w(k),   w_j(k) = sum_i delta_i(k) lam_i z_i(k),   z(k) = C x(k),   |delta_i(k)| <= 1

The sum is over the parameters i of regression j, and w_j is its equation error: with the law in place the machine is
A(delta) = A + B S diag(lam delta) C, S (q p) with a 1 where parameter i belongs to regression j. delta = 0 is the middle of the
boxes. Set-points, biases and operating points drive the loop but do not turn its poles, and are left out.
"""

from dataclasses import replace

import numpy as np

from workbench.errors import InputError
from workbench.records import field, record

FLOOR = 1e-6  # of the largest reachable variance: what a direction of the state counts that nothing reaches
LOST, ROUNDED = np.log(1e-13), 5  # of the largest number beside it: what rounding leaves of a 0; how often that is looked for


@record
class UncertainLoop:
    """See the module. channel (p): the column of B through which parameter i acts; parameters (p): what they are called."""

    A: np.ndarray = field("n n")
    B: np.ndarray = field("n q")
    C: np.ndarray = field("p n")
    lam: np.ndarray = field("p", low=0.0)
    channel: np.ndarray = field("p", low=0.0)
    parameters: tuple[str, ...] = ()
    dt: float = field("", unit="s", default=1.0)

    def __post_init__(self):
        q = self.B.shape[1]
        if not np.isin(self.channel, np.arange(q)).all():
            raise InputError(f"channel must be an integer from 0 to {q - 1}", file="UncertainLoop")
        if self.parameters and len(self.parameters) != len(self.lam):
            raise InputError(f"{len(self.parameters)} names for {len(self.lam)} parameters", file="UncertainLoop")

    @property
    def columns(self) -> np.ndarray:
        """b_j lam_i of every parameter, (n, p): A(delta) = A + columns diag(delta) C."""
        return self.B[:, self.channel.astype(int)] * self.lam

    def at(self, delta: np.ndarray) -> np.ndarray:
        """A(delta), (..., n, n), for delta (..., p)."""
        return self.A + (self.columns * np.asarray(delta)[..., None, :]) @ self.C

    @property
    def alive(self) -> np.ndarray:
        """Whether each parameter (p) changes anything: its radius is not 0, it acts on the state, and its z moves with it."""
        return np.any(self.columns, axis=0) & np.any(self.C, axis=1)

    def only(self, chosen: np.ndarray) -> "UncertainLoop":
        """The loop with the chosen (p) of its parameters uncertain and the others in the middle of their boxes."""
        names = tuple(name for name, own in zip(self.parameters, chosen, strict=False) if own)
        return replace(self, C=self.C[chosen], lam=self.lam[chosen], channel=self.channel[chosen], parameters=names)

    @property
    def radius(self) -> float:
        """Largest modulus of a pole in the middle of the boxes."""
        return float(np.abs(np.linalg.eigvals(self.A)).max(initial=0.0))

    def moved(self, into: np.ndarray) -> "UncertainLoop":
        """The same loop in coordinates into x."""
        back = np.linalg.inv(into)
        return UncertainLoop(into @ self.A @ back, into @ self.B, self.C @ back, self.lam, self.channel, self.parameters, self.dt)

    def balanced(self) -> "UncertainLoop":
        """In the coordinates of `balance`."""
        return self.moved(self.balance())

    def balance(self) -> np.ndarray:
        """T (n n): with T x for x, x'x is a Lyapunov function of the middle in which no direction is much larger than another.

        T x is the same whatever units states, inputs, outputs and parameters are counted in.
        Raises InputError where the middle is not stable.
        """
        from scipy.linalg import solve_discrete_lyapunov

        if not self.radius < 1.0:
            raise InputError(
                f"the loop is not stable in the middle of the boxes: a pole of modulus {self.radius:.6f}",
                file="UncertainLoop",
                mend="another controller, or another model",
            )
        n, alive = len(self.A), self.alive
        columns, C = self.columns[:, alive], self.C[alive]
        unit = units(np.block([[self.A, columns], [C, np.zeros((len(C), len(C)))]]))
        x, z = unit[:n], unit[n:]
        A, columns, C = self.A * x[:, None] / x, columns * x[:, None] / z, C * z[:, None] / x
        reached = solve_discrete_lyapunov(A, columns @ columns.T)
        most = np.diag(reached).max(initial=0.0)
        size = np.sqrt(np.maximum(np.diag(reached), FLOOR * most)) if most > 0.0 else np.ones(n)
        A, C = A * size / size[:, None], C * size
        weight = C.T @ C
        P = solve_discrete_lyapunov(A.T, weight / max(np.trace(weight), 1e-300) + np.eye(n) / n)
        return np.linalg.cholesky(0.5 * (P + P.T)).T / size * x


def units(M: np.ndarray) -> np.ndarray:
    """d (n) > 0 with d_i M_ij / d_j as near to 1 as can be: the least sum of (log |M_ij| + log d_i - log d_j)^2.

    Whoever counts x_i of x = M x in other units gets the same numbers d_i M_ij / d_j. What rounding left of a 0 does not count.
    """
    with np.errstate(divide="ignore"):
        size = np.log(np.abs(M))
    np.fill_diagonal(size, -np.inf)
    log_d = np.zeros(len(M))
    for _ in range(ROUNDED):
        i, j = np.nonzero(np.isfinite(size))
        rows = np.zeros((len(i), len(M)))
        rows[np.arange(len(i)), i], rows[np.arange(len(i)), j] = 1.0, -1.0
        log_d = np.linalg.lstsq(rows, -size[i, j], rcond=None)[0]
        scaled = size + log_d[:, None] - log_d
        largest = np.minimum(scaled.max(axis=1)[:, None], scaled.max(axis=0))
        left = np.isfinite(size) & (scaled < largest + LOST)
        if not left.any():
            break
        size[left] = -np.inf
    return np.exp(log_d)
