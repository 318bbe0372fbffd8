"""Free runs of a plant beside a record, each from a start that is fitted to the record's own first samples.

    x0 = argmin sum_k |W (y(k) - z(k; x0))|^2 + |P (x0 - guess)|^2     over the first samples of a record, or of a window of it

By Gauss-Newton with differences, many runs side by side; W: one over the spread of each output, P: a thousandth of the
information that a sample of a state's usual size would hold. The guess is the plant's start in the light of the first sample.
"""

from collections.abc import Sequence

import numpy as np

from workbench.data import Experiment
from workbench.diagnosis.normal import solve
from workbench.diagnosis.predictor import player
from workbench.diagnosis.starts import start_of
from workbench.errors import InputError
from workbench.physics import stepper
from workbench.physics.plant import Plant
from workbench.records import field, record
from workbench.simulation import outside

BEGINNING = 0.1  # share of a record that its start is fitted to
SHORTEST = 20  # samples of a window, and of a beginning
WINDOWS = 16  # of a record at most
QUARTER = 4  # windows of a plant that is stable: a record by this number
FOLDS = 2.0  # times that what is unstable may grow e-fold within a window
ROUNDS = 3  # Gauss-Newton steps
PRIOR = 1e-3
LEFT = 2.0  # spreads of an output by which a simulation has left the record


@record
class Runner:
    """A plant and the record that it runs beside: inputs u (N, nu), outputs y (N, ny), NaN where there is no such channel.

    usual (nx): the plant's own start, limited states as measured; scale (nx): usual sizes of the states; substeps: integrator
    steps a sample.
    """

    plant: Plant
    u: np.ndarray = field("N nu")
    y: np.ndarray = field(None)
    usual: np.ndarray = field("nx")
    scale: np.ndarray = field("nx")
    substeps: int

    @classmethod
    def of(cls, plant: Plant, e: Experiment) -> "Runner":
        """For a record that holds the plant's needed inputs; an input that is not in it is 0."""
        plant = plant.sampled(e.dt, file=e.name)
        u = np.column_stack([e[name] if name in e.names else np.zeros(len(e)) for name in plant.input_names])
        y = np.column_stack([e[name] if name in e.names else np.full(len(e), np.nan) for name in plant.output_names])
        limited = {name: (float(e[name][0]), *limits) for name, limits in plant.read_limits.items() if name in e.names}
        inside = {name: value for name, (value, low, high) in limited.items() if low < value < high}
        x, hold = plant.equilibria(plant.nominal[None], **inside)
        substeps = int(stepper.substeps_for(plant, plant.nominal[None], plant.effect_vector()[None], x, hold).max())
        first = cls(plant, u, y, x[0], np.where(x[0] == 0.0, 1.0, 0.3 * np.abs(x[0])), substeps)
        run = first._run(u[None], x)[0][0]
        run = run[np.isfinite(run).all(axis=1)]
        spread = np.std(run, axis=0) if len(run) > SHORTEST else np.zeros(len(x[0]))
        usual = np.where(np.isfinite(spread) & (spread > 0.0), np.maximum(spread, 0.3 * np.abs(x[0])), first.scale)
        return cls(plant, u, y, x[0], usual, substeps)

    @property
    def spread(self) -> np.ndarray:
        """Standard deviation (ny) of each output, 0 of what was not measured."""
        return np.std(np.nan_to_num(self.y), axis=0)

    def whole(self, inputs: Sequence[np.ndarray], *, fitted: bool = True, beginning: int | None = None) -> np.ndarray:
        """Outputs (R, N, ny) over the record under each inputs (N, nu); NaN once a run has left the plant's range.

        From a start that is fitted to the first `beginning` samples (default: a tenth of the record), or from the plant's own: a
        channel in another unit spoils a fitted one.
        """
        u = np.stack(inputs)
        if not fitted:
            return self._run(u, np.repeat(self.usual[None], len(u), axis=0))[1]
        M = beginning or min(max(int(BEGINNING * len(self.u)), SHORTEST), len(self.u))
        y, guess = np.repeat(self.y[None, :M], len(u), axis=0), np.repeat(self._guess(0)[None], len(u), axis=0)
        return self._run(u, self._fitted(u[:, :M], y, guess))[1]

    def forced(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """D = y - z0 and F = z - z0 (M, ny), one window after the other: what the record shows and what the inputs u (N, nu) do.

        z: a run from a start that is fitted to a window's first quarter; z0: the same under the window's mean inputs. Windows
        that a run does not last are left out.
        """
        L = self.window
        first = np.unique(np.linspace(0, len(u) - L, min(max(len(u) // L, 1), WINDOWS)).astype(int))
        own, y = (np.stack([values[k : k + L] for k in first]) for values in (u, self.y))
        M = min(max(L // QUARTER, SHORTEST // 2), L)
        x = self._fitted(own[:, :M], y[:, :M], np.stack([self._guess(int(k)) for k in first]))
        z, z0 = self._run(own, x)[1], self._run(np.broadcast_to(own.mean(axis=1, keepdims=True), own.shape), x)[1]
        lasts = np.isfinite(z).all(axis=(1, 2)) & np.isfinite(z0).all(axis=(1, 2))
        return (y - z0)[lasts].reshape(-1, y.shape[2]), (z - z0)[lasts].reshape(-1, y.shape[2])

    @property
    def window(self) -> int:
        """Samples of a window: a quarter of the record, or as many as what is unstable takes to grow by e^FOLDS."""
        N = len(self.u)
        x = np.stack([self._guess(k) for k in np.linspace(0, N - 1, 5).astype(int)])
        u = self.u[np.linspace(0, N - 1, 5).astype(int)]
        p, eta = (np.repeat(values[None], len(x), axis=0) for values in (self.plant.nominal, self.plant.effect_vector()))
        A = self.plant.jacobians_of(x, u, p, eta)[0]
        A = A[np.isfinite(A).all(axis=(1, 2))]
        grows = float(np.linalg.eigvals(A).real.max()) * self.plant.dt if len(A) else 0.0
        longest = FOLDS / grows if grows * N > FOLDS else N / QUARTER
        return int(np.clip(longest, min(SHORTEST, N), max(N // QUARTER, min(SHORTEST, N))))

    def told_until(self, t: np.ndarray) -> str:
        """When the simulation leaves the record, and which parameter within its tolerance or which start would hold it."""
        plant, (nx, N) = self.plant, (len(self.scale), len(self.u))
        M = min(max(int(BEGINNING * N), SHORTEST), N)
        x = self._fitted(self.u[None, :M], self.y[None, :M], self._guess(0)[None])[0]
        tried: list[tuple[str, np.ndarray, np.ndarray]] = [("", plant.nominal, x)]
        for i, q in enumerate(plant.parameters):
            for factor in (1.0 + q.tolerance, max(1.0 - q.tolerance, 0.1)) if q.tolerance > 0.0 else ():
                p = plant.nominal.copy()
                p[i] *= factor
                tried.append((f"{q.name} = {p[i]:.4g} {q.unit}".rstrip(), p, x))
        for i, c in enumerate(plant.states):
            for way in (1.0, -1.0):
                begun = x + way * self.scale * np.eye(nx)[i]
                tried.append((f"a start of {c.name} = {begun[i]:.4g} {c.unit}".rstrip(), plant.nominal, begun))
        u = np.broadcast_to(self.u, (len(tried), *self.u.shape))
        z = self._run(u, np.stack([x for *_, x in tried]), np.stack([p for _, p, _ in tried]))[1]
        far = ~(np.abs(self.y - z) <= LEFT * self.spread) & np.isfinite(self.y)
        gone = np.asarray(far.any(axis=2) | ~np.isfinite(z).all(axis=2))
        until = np.where(gone.any(axis=1), gone.argmax(axis=1), N)
        best = int(until.argmax())
        if until[0] == N:
            return f"the simulation stays within {LEFT:g} spreads of the record"
        said = f"the simulation leaves the record by more than {LEFT:g} of its spreads at t = {t[until[0]]:.4g} s"
        if until[best] <= 1.2 * until[0] + 1:
            return f"{said}, and no parameter within its tolerance and no other start holds it longer"
        held = "to the end" if until[best] == N else f"to t = {t[until[best]]:.4g} s"
        return f"{said}; {tried[best][0]} would hold it {held}"

    # ---- inside ------------------------------------------------------------------------------------------------------

    def _guess(self, k: int) -> np.ndarray:
        """States (nx) in the light of sample k."""
        x, _ = self.plant.equilibrium()
        try:
            found = start_of(self.plant, self.y, self.u, k)[0]
        except InputError:
            return x
        return found if np.isfinite(found).all() else x

    def _fitted(self, u: np.ndarray, y: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Starts (R, nx) that fit y (R, M, ny) under u (R, M, nu), from the guesses x (R, nx); see the module.

        A run that is lost, or whose slopes leave the numbers, stays where it is.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            return self._best_starts(u, y, x)

    def _best_starts(self, u: np.ndarray, y: np.ndarray, x: np.ndarray) -> np.ndarray:
        R, nx = x.shape
        weight = np.where(self.spread > 0.0, 1.0 / np.where(self.spread > 0.0, self.spread, 1.0), 0.0)
        prior, step, guess = PRIOR * y.shape[1] * np.eye(nx) / self.scale**2, 1e-4 * self.scale, x

        def missed(x: np.ndarray, u: np.ndarray, y: np.ndarray) -> np.ndarray:
            r = (y - self._run(u, x)[1]) * weight
            return np.where(np.isnan(y), 0.0, r).reshape(len(x), -1)

        def cost(r: np.ndarray, x: np.ndarray) -> np.ndarray:
            own = np.einsum("rk,rk->r", r, r) + np.einsum("ri,ij,rj->r", x - guess, prior, x - guess)
            return np.where(np.isfinite(own), own, np.inf)

        r = missed(x, u, y)
        best = cost(r, x)
        for _ in range(ROUNDS):
            moved = (x[:, None] + step * np.eye(nx)).reshape(R * nx, nx)
            J = (missed(moved, np.repeat(u, nx, axis=0), np.repeat(y, nx, axis=0)).reshape(R, nx, -1) - r[:, None]) / step[
                :, None
            ]
            known = np.asarray(np.isfinite(J).all(axis=(1, 2)) & np.isfinite(r).all(axis=1))
            J, own = np.where(known[:, None, None], J, 0.0), np.where(known[:, None], r, 0.0)
            g = np.einsum("rik,rk->ri", J, own) + (x - guess) @ prior
            change = -solve(J @ J.transpose(0, 2, 1) + prior, g)
            for share in (1.0, 0.3):
                trial = x + share * change
                other = missed(trial, u, y)
                better = cost(other, trial) < best
                x, r = np.where(better[:, None], trial, x), np.where(better[:, None], other, r)
                best = np.where(better, cost(other, trial), best)
        return x

    def _run(self, u: np.ndarray, x: np.ndarray, p: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """States (R, N, nx) and outputs (R, N, ny) from x (R, nx) under u (R, N, nu); NaN once a run has left its range."""
        R, nothing = len(x), np.empty((len(x), 0))
        lanes = stepper.Lanes(
            parameters=np.broadcast_to(self.plant.nominal, (R, len(self.plant.nominal))) if p is None else p,
            effects=np.repeat(self.plant.effect_vector()[None], R, axis=0),
            gains=nothing,
            memory=nothing,
            start=x,
            hold=u[:, 0],
            reference=u,
            disturbance=np.zeros((1, *u.shape[1:])).repeat(R, axis=0),
            noise=np.zeros((R, u.shape[1], self.y.shape[1])),
        )
        with np.errstate(over="ignore", invalid="ignore"):  # a volt taken for a millivolt runs away
            run = stepper.run(self.plant, player(self.plant), lanes, self.substeps)
        states, measured = run.states.copy(), run.measured.copy()
        for i, k in enumerate(outside(self.plant, states)):
            states[i, k:] = measured[i, k:] = np.nan
        measured[~np.isfinite(measured).all(axis=2)] = np.nan
        return states, measured


def first_outside(run: np.ndarray) -> int:
    """First sample at which a run (N, ny) has left its range; N where it has not."""
    out = ~np.isfinite(run).all(axis=1)
    return int(np.argmax(out)) if out.any() else len(run)
