"""Peaks and crossings of frequency responses, of all frequencies and not of a grid.

    G(z) = C (z I - A)^-1 B + D,   z = exp(j omega dt);   dt = 0: G(s), s = j omega

A resonance is as narrow as its poles are near the circle: a grid passes it by, and what is read between its frequencies is too
small. But where a singular value of G is exactly gamma, s = (z - 1) / (z + 1) = j tan(omega dt / 2) is an eigenvalue of [1]

    [A + B R^-1 D'C, B R^-1 B'; -C'(I + D R^-1 D') C, -(A + B R^-1 D'C)'],   R = gamma^2 I - D'D,

with the matrices of G in s. So the largest gain begins at the frequencies of the poles; the level just above it cuts the
frequency axis into pieces, the gain in the middle of each is the next one, and where the level cuts nothing it is the peak [2].

[1] S. Boyd, V. Balakrishnan, P. Kabamba, "A bisection method for computing the H-infinity norm of a transfer matrix and related
problems", Mathematics of Control, Signals and Systems 2 (1989).
[2] N. Bruinsma, M. Steinbuch, "A fast algorithm to compute the H-infinity norm of a transfer function matrix", Systems & Control
Letters 14 (1990).
"""

import math
from dataclasses import replace
from functools import cached_property

import numpy as np

from workbench.records import field, record

CLOSE = 1e-6  # by which a peak is at most larger than what is told
ROUNDS = 50  # levels; each halves the pieces at least, and near a peak squares the distance
START = 1e-4  # of the slowest pole: a frequency that is as good as 0, and below which a peak is off by the square of that
STILL = 1e-9  # rad (a sample): a pole below is the integral of a law, and no slow pole
SPREAD = 24  # frequencies besides those of the poles that a search begins with
BESIDE = 0.01  # |Re s| / |s| up to which an eigenvalue is looked at: one too many costs nothing
ROUNDING = 1e-15  # of a level: what keeps it from being a singular value at the highest frequency, to the last digit
SMALL = 20  # states up to which solving at each frequency is faster than a Schur form
TOUCHES = 1e-6  # of a level: from which a loop gain that does not cross it touches it


@record
class System:
    """x+ = A x + B u, y = C x + D u; dt [s] = 0: x' in place of x+."""

    A: np.ndarray = field("n n")
    B: np.ndarray = field("n nu")
    C: np.ndarray = field("ny n")
    D: np.ndarray = field("ny nu")
    dt: float = field("", unit="s", low=0.0)

    def at(self, omega: np.ndarray) -> np.ndarray:
        """G (N, ny, nu) at omega (N) [rad/s]."""
        z = np.exp(1j * omega * self.dt) if self.dt else 1j * omega
        A, B, C = self._balanced
        if len(A) <= SMALL:
            return C @ np.linalg.solve(z[:, None, None] * np.eye(len(A)) - A, B) + self.D
        T, B, C = self._triangular
        x = np.zeros((len(T), B.shape[1], len(z)), dtype=complex)
        for i in reversed(range(len(T))):  # of all frequencies at once: n^2 each, where solving from A takes n^3
            x[i] = (B[i][:, None] + np.tensordot(T[i, i + 1 :], x[i + 1 :], 1)) / (z - T[i, i])
        return np.moveaxis(np.tensordot(C, x, 1), -1, 0) + self.D

    def gain(self, omega: np.ndarray) -> np.ndarray:
        """Largest singular value of G (N)."""
        G = self.at(omega)
        return np.abs(G[:, 0, 0]) if G.shape[1:] == (1, 1) else np.linalg.norm(G, 2, axis=(1, 2))

    def only(self, outputs: slice | list[int], inputs: slice | list[int]) -> "System":
        """From some of the inputs to some of the outputs."""
        return System(self.A, self.B[:, inputs], self.C[outputs], self.D[outputs][:, inputs], self.dt)

    def less(self, share: float) -> "System":
        """G - share I."""
        return replace(self, D=self.D - share * np.eye(len(self.D)))

    @cached_property
    def poles(self) -> np.ndarray:
        return np.linalg.eigvals(self.A)

    @property
    def stable(self) -> bool:
        return bool((np.abs(self.poles) < 1.0).all() if self.dt else (np.real(self.poles) < 0.0).all())

    @cached_property
    def ends(self) -> tuple[float, float]:
        """Lowest and highest frequency [rad/s]: what stands for 0, where laws with an integral have a pole, and for the last."""
        size = np.abs(self._rates)
        size = size[size * (self.dt or 1.0) > STILL]
        slowest, fastest = (float(size.min()), float(size.max())) if len(size) else (1.0, 1.0)
        return START * min(slowest, 1.0 / self.dt if self.dt else np.inf), np.pi / self.dt if self.dt else fastest / START

    @cached_property
    def _rates(self) -> np.ndarray:
        """The poles over s [rad/s], but for what is over within a sample."""
        poles = self.poles.astype(complex)
        return np.log(poles[poles != 0.0]) / self.dt if self.dt else poles

    def around(self, widths: np.ndarray) -> np.ndarray:
        """Frequencies [rad/s] at which the poles turn, and so many widths of their peaks beside them, within the ends."""
        found = np.abs(np.imag(self._rates))[:, None] + np.abs(np.real(self._rates))[:, None] * np.append(widths, 0.0)
        return np.unique(np.clip(found, *self.ends))

    def cuts(self, level: float) -> np.ndarray:
        """Frequencies [rad/s] at which a singular value of G is `level`, in order; some at which none is may be among them."""
        A, B, C, D = self._in_s
        R = np.linalg.inv((1.0 + ROUNDING) * level**2 * np.eye(D.shape[1]) - D.T @ D)
        own = A + B @ R @ D.T @ C
        return self._on_axis(np.block([[own, B @ R @ B.T], [-C.T @ (np.eye(len(D)) + D @ R @ D.T) @ C, -own.T]]))

    def halves(self) -> np.ndarray:
        """Frequencies [rad/s] at which the real part of G (1 by 1) is 1 / 2, as `cuts` has them: where |G| = |1 - G|."""
        A, B, C, D = self._in_s
        R = 1.0 / (2.0 * D[0, 0] - 1.0 or ROUNDING)
        return self._on_axis(np.block([[A - R * B @ C, -R * B @ B.T], [R * C.T @ C, R * C.T @ B.T - A.T]]))

    def pieces(self, cuts: np.ndarray) -> np.ndarray:
        """The ends and what lies between, (.. + 2)."""
        low, high = self.ends
        return np.concatenate([[low], cuts[(cuts > low) & (cuts < high)], [high]])

    @cached_property
    def _balanced(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        from scipy.linalg import matrix_balance

        if not len(self.A):
            return self.A, self.B, self.C
        A, (size, _) = matrix_balance(self.A, permute=False, separate=True)
        return A, self.B / size[:, None], self.C * size

    @cached_property
    def _triangular(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A in complex Schur form, with B and C."""
        from scipy.linalg import schur

        A, B, C = self._balanced
        T, U = schur(A, output="complex")[:2]
        return T, U.conj().T @ B, C @ U

    @cached_property
    def _in_s(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """The matrices over s of the module: z = (1 + s) / (1 - s)."""
        A, B, C = self._balanced
        if not self.dt:
            return A, B, C, self.D
        back = np.linalg.inv(np.eye(len(A)) + A)
        return back @ (A - np.eye(len(A))), back @ B, 2.0 * C @ back, self.D - C @ back @ B

    def _on_axis(self, H: np.ndarray) -> np.ndarray:
        s = np.linalg.eigvals(H)
        s = s[(s.imag > 0.0) & (np.abs(s.real) <= BESIDE * np.abs(s))]
        return np.sort(2.0 / self.dt * np.arctan(s.imag) if self.dt else s.imag)


@record
class Peak:
    """The largest gain over all frequencies, and where [rad/s]."""

    gain: float
    omega: float = field("", unit="rad/s")


def peak(system: System, least: float = 0.0) -> Peak:
    """The largest singular value of a stable system over all frequencies, to the share CLOSE; below `least` any gain that it has.

    Of a system that is not stable the largest gain at the frequencies of its poles and some others.
    """
    low, high = system.ends
    spread = np.geomspace(low, high, SPREAD)
    omega = np.concatenate([spread, high * spread[:-1] / (high + spread[:-1]), system.around(np.ones(1))])
    gain = system.gain(omega)
    found = Peak(float(gain.max()), float(omega[gain.argmax()]))
    if not (system.stable and math.isfinite(found.gain)):
        return found
    for _ in range(ROUNDS):
        level = max(found.gain, least) * (1.0 + CLOSE)
        if not level > 0.0:
            break
        between = system.pieces(system.cuts(level))
        omega = 0.5 * (between[1:] + between[:-1])
        gain = system.gain(omega)
        if not gain.max() > level:
            break
        found = Peak(float(gain.max()), float(omega[gain.argmax()]))
    return found


def first_reaching(system: System, level: float) -> float:
    """The lowest frequency [rad/s] at which the largest singular value is above `level`: 0 if at once, the highest if nowhere.

    Of a stable system.
    """
    between = system.pieces(system.cuts(level))
    above = system.gain(0.5 * (between[1:] + between[:-1])) > level
    if not above.any():
        return float(between[-1])
    return float(between[above.argmax()]) if above.argmax() else 0.0


def delay_margin(S: System) -> float:
    """The least (pi + arg L) / omega of the crossings |L| = 1 [s], L = 1 / S - 1, of a stable sampled loop with sensitivity S.

    How much later its command may act before the loop is lost: exact for delays of whole samples, between them as in continuous
    time. Infinite where |L| stays below 1; 0 where |L| is 1 or more at the highest frequency: the delay turns such a loop as fast
    as you like.
    """
    cuts = S.halves()
    between = S.pieces(cuts)

    def opened(omega: np.ndarray) -> np.ndarray:
        return 1.0 / S.at(omega)[:, 0, 0] - 1.0

    if abs(opened(between[-1:])[0]) >= 1.0:
        return 0.0
    large = np.abs(opened(0.5 * (between[1:] + between[:-1]))) > 1.0
    cuts = between[1:-1]
    if not len(cuts):
        return math.inf
    L = opened(cuts)
    crossing = (large[1:] != large[:-1]) | (np.abs(np.abs(L) - 1.0) < TOUCHES)
    return float(np.min(((np.angle(L) + np.pi) % (2.0 * np.pi) / cuts)[crossing], initial=np.inf))


def disk_margin(S: System, most: float = np.inf) -> float:
    """1 / peak of the largest singular value of S - I / 2 = (S - T) / 2,  S = (I + L)^-1, T = I - S, of a stable loop.

    Every command may be multiplied by its own complex number from the disk through (2 - a) / (2 + a) and (2 + a) / (2 - a), a the
    margin, at once: a gain or a phase, or both. For one command it is the disk margin itself, for several no more than that of
    numbers that differ from command to command. Seiler, Packard, Gahinet, "An introduction to disk margins", IEEE Control Systems
    40 (2020). Above `most` any number that is no smaller than the margin.
    """
    return 1.0 / peak(S.less(0.5), 1.0 / most).gain


@record
class Closed:
    """A plant and a law around it: u = K (w_y - y), y = P (u + w_u); nu commands, ny outputs.

    system: from (w_u, w_y) to (u + w_u, u, w_y - y, y).
    """

    system: System
    nu: int
    ny: int

    @classmethod
    def of(cls, plant: System, law: System) -> "Closed":
        """Of P (ny nu) and K (nu ny)."""
        (ny, nu), n, m = plant.D.shape, len(plant.A), len(law.A)
        x, memory, w_u, w_y = np.split(np.eye(n + m + nu + ny), np.cumsum([n, m, nu]))
        v = np.linalg.solve(np.eye(nu) + law.D @ plant.D, law.C @ memory - law.D @ plant.C @ x + w_u + law.D @ w_y)
        y = plant.C @ x + plant.D @ v
        after = np.vstack([plant.A @ x + plant.B @ v, law.A @ memory + law.B @ (w_y - y)])
        seen = np.vstack([v, v - w_u, w_y - y, y])
        return cls(System(after[:, : n + m], after[:, n + m :], seen[:, : n + m], seen[:, n + m :], plant.dt), nu, ny)

    @property
    def input_sensitivity(self) -> System:
        """(I + K P)^-1."""
        return self.system.only(slice(self.nu), slice(self.nu))

    @property
    def output_sensitivity(self) -> System:
        """(I + P K)^-1."""
        at = 2 * self.nu
        return self.system.only(slice(at, at + self.ny), slice(self.nu, None))

    @property
    def effort(self) -> System:
        """K (I + P K)^-1."""
        return self.system.only(slice(self.nu, 2 * self.nu), slice(self.nu, None))

    def alone(self, i: int) -> System:
        """S_ii: command i is opened, the others are closed."""
        return self.system.only([i], [i])
