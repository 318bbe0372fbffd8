"""Subspace identification: from records to x+ = A x + B u + K e, y = C x + D u + e, the order read off singular values.

PBSID estimates a long predictor first and is consistent in closed loop; N4SID projects the future on past and future
inputs and is not, because in closed loop future inputs carry past noise.

[1] A. Chiuso, "The role of vector autoregressive modeling in predictor-based subspace identification", Automatica 43
    (2007).
[2] P. Van Overschee, B. De Moor, "Subspace Identification for Linear Systems", Kluwer (1996), chapter 4.
[3] J. L. Horn, "A rationale and test for the number of factors in factor analysis", Psychometrika 30 (1965).
"""

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from workbench.data import Channel, Dataset, Experiment
from workbench.errors import InputError
from workbench.records import field, record

#: Singular values below this share of the largest are rounding, whatever the noise.
ROUNDING = 1e-8


@record
class Subspace:
    """x+ = A x + B (u - u0) + K e, y = y0 + C x + D (u - u0) + e: an innovation model, and what its order stands on.

    `noise_level` is the singular value that noise alone would reach: the order is the number of those above it.
    (u0, y0) is the equilibrium of the model nearest to the mean of the records, so that offsets do not bend the dynamics.
    """

    dt: float = field("", unit="s", low=0.0)
    inputs: tuple[Channel, ...]
    outputs: tuple[Channel, ...]
    singular_values: np.ndarray = field("ns", low=0.0)
    noise_level: float = field("", low=0.0)
    past: int
    A: np.ndarray = field("nx nx")
    B: np.ndarray = field("nx nu")
    C: np.ndarray = field("ny nx")
    D: np.ndarray = field("ny nu")
    K: np.ndarray = field("nx ny")
    covariance: np.ndarray = field("ny ny")
    u0: np.ndarray = field("nu")
    y0: np.ndarray = field("ny")

    @property
    def order(self) -> int:
        return len(self.A)

    @property
    def poles(self) -> np.ndarray:
        return np.linalg.eigvals(self.A)

    def markov(self, steps: int) -> np.ndarray:
        """h(0) = D, h(k) = C A^(k-1) B: the impulse response, (steps, ny, nu)."""
        response, reach = [self.D], self.B
        for _ in range(steps - 1):
            response.append(self.C @ reach)
            reach = self.A @ reach
        return np.array(response[:steps])


@record
class PBSID:
    """y(k) = sum_i C F^(i-1) [B K] [u; y](k-i) + e(k), F = A - K C: predictor-based subspace identification.

    A least-squares predictor over `past` samples gives the states' estimate over `future` samples, a singular value
    decomposition the order, and least squares on the states the matrices. Consistent in open and closed loop.

    past: samples after which the predictor may forget; future <= past: horizon; order: default the singular values above
    what noise alone would produce; feedthrough: estimate D, which is zero for a sampled plant whose input is held.

    Source: A. Chiuso, "The role of vector autoregressive modeling in predictor-based subspace identification",
    Automatica 43 (2007).

        >>> LTI(orders=(1, 2), method=PBSID(past=15)).fit(data).order
        1
    """

    order: int | None = None
    past: int = 20
    future: int = 10
    feedthrough: bool = False

    def __post_init__(self):
        _check_horizons(self.order, self.past, self.future)

    def fit(self, dataset: Dataset) -> Subspace:
        """The model of all records together; raises InputError for too few samples."""
        estimate = self.estimate(dataset)
        return estimate.realise(estimate.suggested if self.order is None else self.order)

    def estimate(self, dataset: Dataset) -> "PredictorEstimate":
        """Everything up to the choice of an order."""
        return predictor_estimate(self, _windows(dataset, self.past, 0))


@record
class N4SID:
    """O = Y_f /_{U_f} [U_p; Y_p] = Gamma X: numerical subspace identification by oblique projection.

    The robust combined algorithm: O projected off U_f is decomposed, A and C come from least squares on the states, B and
    D from the structured remainder, K from a Riccati equation on the residuals. Biased in closed loop: use PBSID there.
    Options as in PBSID.

    Source: P. Van Overschee, B. De Moor, "Subspace Identification for Linear Systems", Kluwer (1996), fig. 4.8.

        >>> LTI(order=1, method=N4SID()).fit(data).to_control().poles().round(2)
        array([0.92+0.j])
    """

    order: int | None = None
    past: int = 20
    future: int = 10
    feedthrough: bool = False

    def __post_init__(self):
        _check_horizons(self.order, self.past, self.future)

    def fit(self, dataset: Dataset) -> Subspace:
        """The model of all records together; raises InputError for too few samples."""
        estimate = self.estimate(dataset)
        return estimate.realise(estimate.suggested if self.order is None else self.order)

    def estimate(self, dataset: Dataset) -> "ObliqueProjection":
        """Everything up to the choice of an order."""
        return _oblique_projection(self, _windows(dataset, self.past, self.future - 1))


# ---- records -> windows ---------------------------------------------------------------------------------------------


@record
class Windows:
    """rows(k) = [u y](k - past) .. [u y](k + ahead): all windows of all records, compressed to a triangle.

    Least squares see a data matrix only through its triangle: `triangle`' `triangle` equals their own. Signals
    are in deviations from `mean` (per column of the window: no record needs its own offset) in units of `scale`.
    """

    dt: float
    inputs: tuple[Channel, ...]
    outputs: tuple[Channel, ...]
    past: int
    table: np.ndarray = field("count r")  # the windows themselves, in units of scale
    triangle: np.ndarray = field("r r")
    mean: np.ndarray = field("r")  # of each column, in units of scale
    centre: np.ndarray = field("nz")  # mean of [u y] over the records
    scale: np.ndarray = field("nz", low=0.0)

    @property
    def nu(self) -> int:
        return len(self.inputs)

    @property
    def nz(self) -> int:
        return len(self.scale)

    @property
    def count(self) -> int:
        return len(self.table)

    def z(self, first: int, last: int) -> np.ndarray:
        """Columns [u y](k + first) .. [u y](k + last), both included."""
        return self.triangle[:, (self.past + first) * self.nz : (self.past + last + 1) * self.nz]

    def signals(self, first: int, last: int, *, outputs: bool) -> np.ndarray:
        """Columns of the inputs or of the outputs alone."""
        z = self.z(first, last)
        own = (np.arange(z.shape[1]) % self.nz >= self.nu) == outputs
        return z[:, own]


def samples_needed(past: int, signals: int) -> int:
    """Samples below which a record cannot carry the windows' own regression by itself, with half as many to spare."""
    return past + (3 * past * signals) // 2


def channels_of(experiment: Experiment) -> tuple[tuple[Channel, ...], tuple[Channel, ...]]:
    """Inputs and outputs of a record, by role; refused where there are none. An output that is the schedule is an output here."""
    inputs, outputs = (
        tuple(dataclasses.replace(experiment.channel(n), role=role) for n in experiment.names_of(role))
        for role in ("input", "output")
    )
    for name, found in (("inputs", inputs), ("outputs", outputs)):
        if not found:
            raise InputError(f"no {name}", file=experiment.name, mend=f"name them: with_roles({name}=[...])")
    return inputs, outputs


def _windows(dataset: Dataset, past: int, ahead: int) -> Windows:
    inputs, outputs = channels_of(dataset.experiments[0])
    names = [c.name for c in (*inputs, *outputs)]
    records = [experiment[names] for experiment in dataset]
    together = np.concatenate(records)
    centre, scale = together.mean(axis=0), together.std(axis=0)
    for name, spread, size in zip(names, scale, np.abs(centre), strict=True):
        if spread <= 1e-12 * max(size, 1e-300):
            raise InputError("constant in all records", channel=name, mend="leave it out, or excite it in the next experiment")
    length = past + 1 + ahead
    long_enough = [(z - centre) / scale for z in records if len(z) >= length]
    # a window never spans two records: each record is cut into its own
    rows = [np.lib.stride_tricks.sliding_window_view(z, length, axis=0).swapaxes(1, 2) for z in long_enough]
    table = np.concatenate([r.reshape(len(r), -1) for r in rows]) if rows else np.empty((0, length * len(names)))
    if len(table) <= table.shape[1] + 1:
        raise InputError(
            f"{len(together)} samples leave {len(table)} windows of {length} for {table.shape[1]} unknowns an output",
            file=dataset.experiments[0].name,
            mend="use longer records, or smaller windows: PBSID(past=, future=) in Python",
        )
    mean = table.mean(axis=0)
    triangle = _triangle(table - mean)
    return Windows(dataset.dt, inputs, outputs, past, table, triangle, mean, centre, scale)


# ---- PBSID ----------------------------------------------------------------------------------------------------------


@record
class PredictorEstimate:
    """Gamma X = (shifted predictor coefficients) Z: the predictor over a long past, and its decomposition."""

    options: PBSID
    windows: Windows
    coefficients: np.ndarray = field("ny q")  # of [u y](k - past) .. [u y](k - 1), then u(k) with a feed-through
    singular_values: np.ndarray = field("ns")
    noise_level: float
    basis: np.ndarray = field("ns p")  # row i: state i of the balanced predictor as a combination of the past

    @property
    def suggested(self) -> int:
        """Number of singular values above the noise."""
        return max(1, int(np.sum(self.singular_values > self.noise_level)))

    @property
    def largest(self) -> int:
        return int(np.sum(self.singular_values > ROUNDING * self.singular_values[0]))

    def realise(self, order: int) -> Subspace:
        """The model of a given order: the first `order` states; the decomposition is not repeated."""
        w, T = self.windows, self.basis[: _check_order(order, self.largest)]
        nz, nu = w.nz, w.nu
        u, y = w.signals(0, 0, outputs=False), w.signals(0, 0, outputs=True)
        x, following = w.z(-w.past, -1) @ T.T, w.z(1 - w.past, 0) @ T.T
        known = np.hstack([x, u]) if self.options.feedthrough else x
        CD = _least_squares(known, y)
        C, D = CD[:, :order], CD[:, order:] if self.options.feedthrough else np.zeros((y.shape[1], nu))
        e = y - known @ CD.T
        covariance = e.T @ e / (w.count - 1 - known.shape[1])
        ABK = _least_squares(np.hstack([x, u, e]), following)
        A, B, K = ABK[:, :order], ABK[:, order : order + nu], ABK[:, order + nu :]
        if not _remembered(e) or _radius(A - K @ C) >= 1.0:
            rest = following - np.hstack([x, u]) @ ABK[:, : order + nu].T
            K = _kalman_gain(A, C, np.hstack([rest, e]) / np.sqrt(w.count))
        # the intercept of the predictor: y(k) = y_mean + C T (z - z_mean) + D (u - u_mean)
        now = slice(w.past * nz, w.past * nz + nu)
        intercept = w.mean[w.past * nz + nu :] - C @ T @ w.mean[: w.past * nz] - D @ w.mean[now]
        total = (C @ T).reshape(len(C), w.past, nz).sum(axis=1)
        total[:, :nu] += D
        return _unscaled(self, (A, B, C, D, K), covariance, _equilibrium(total, intercept))


def predictor_estimate(options: PBSID, w: Windows) -> PredictorEstimate:
    """The long predictor by least squares, its coefficients shifted into Gamma K, and the decomposition."""
    Z, y = w.z(-w.past, -1), w.signals(0, 0, outputs=True)
    known = np.hstack([Z, w.signals(0, 0, outputs=False)]) if options.feedthrough else Z
    h = _least_squares(known, y)
    e = y - known @ h.T
    weight = _whitener(e.T @ e / (w.count - 1 - known.shape[1]))
    # decompose in orthonormal coordinates of the past: Z = Q R
    R = _triangle(Z)
    U, s, _ = np.linalg.svd(_shifted(weight @ h, options.future, w.past, w.nz) @ R.T, full_matrices=False)
    keep = s > 0
    # [1]: X = S^(1/2) V', i.e. S^(-1/2) U' applied to Gamma K Z
    basis = (U[:, keep] / np.sqrt(s[keep])).T @ _shifted(weight @ h, options.future, w.past, w.nz)
    level = max(_noise_level(options, w, R), ROUNDING * s[0])
    return PredictorEstimate(options, w, h, s[keep], level, basis)


def resampled(estimate: PredictorEstimate, draws: int, *, block: int = 25) -> Iterator[Windows]:
    """Windows whose y(k) is the long predictor's, plus its residuals drawn anew in blocks; the past stays as it was.

    Blocks keep what colour and unevenness the residuals have. Signs are drawn as well, so that their mean is zero.
    """
    w, ny = estimate.windows, estimate.windows.nz - estimate.windows.nu
    random = np.random.default_rng(0)
    known = w.table[:, :-ny] - w.mean[:-ny]
    Q, R = np.linalg.qr(known)
    h = np.hstack([estimate.coefficients, np.zeros((ny, known.shape[1] - estimate.coefficients.shape[1]))])
    residual = w.table[:, -ny:] - w.mean[-ny:] - known @ h.T
    residual = residual * np.sqrt(len(known) / (len(known) - 1 - estimate.coefficients.shape[1]))
    blocks = [residual[k : k + block] for k in range(0, len(residual), block)]
    for _ in range(draws):
        picked = random.integers(len(blocks), size=len(blocks) + 1)
        e = np.concatenate([blocks[i] * random.choice([-1.0, 1.0]) for i in picked])
        e = np.resize(e, residual.shape)
        seen = Q.T @ e
        below = _triangle(e - Q @ seen)
        triangle = np.block([[R, R @ h.T + seen], [np.zeros((ny, R.shape[1])), below]])
        yield dataclasses.replace(w, triangle=triangle)


def _shifted(h: np.ndarray, future: int, past: int, nz: int) -> np.ndarray:
    """Gamma K: block row j predicts y(k + j) from [u y](k - past .. k - 1) once the samples from k on are known."""
    ny, q = len(h), past * nz
    rows = np.zeros((future, ny, q))
    for j in range(future):
        rows[j, :, j * nz :] = h[:, : q - j * nz]  # a lag of j more; what is older than the past is forgotten
    return rows.reshape(future * ny, q)


def _noise_level(options: PBSID, w: Windows, R: np.ndarray, draws: int = 9) -> float:
    """Largest singular value that coefficients of pure estimation noise would show, median over draws (as in [3]).

    The coefficients' error has covariance sigma_e x (Z'Z)^-1; whitened outputs make sigma_e the identity.
    """
    diagonal = np.abs(np.diag(R))
    if diagonal.min() < 1e-9 * diagonal.max():
        return 0.0  # an exact relation among past samples: there is no noise
    random = np.random.default_rng(0)  # draws of the criterion, not of the data: the same every time
    ny = w.nz - w.nu
    errors = [np.linalg.solve(R, random.standard_normal((len(R), ny))).T for _ in range(draws)]
    shifted = (_shifted(error, options.future, w.past, w.nz) @ R.T for error in errors)
    return float(np.median([np.linalg.norm(rows, 2) for rows in shifted]))


# ---- N4SID ----------------------------------------------------------------------------------------------------------


@record
class ObliqueProjection:
    """O = Gamma X in orthonormal coordinates: U (f ny, ns) spans the extended observability matrix."""

    options: N4SID
    windows: Windows
    singular_values: np.ndarray = field("ns")
    noise_level: float
    U: np.ndarray = field("fy ns")

    @property
    def suggested(self) -> int:
        """Number of singular values above the noise."""
        return max(1, int(np.sum(self.singular_values > self.noise_level)))

    @property
    def largest(self) -> int:
        ny = self.windows.nz - self.windows.nu
        found = int(np.sum(self.singular_values > ROUNDING * self.singular_values[0]))
        return min(found, (self.options.future - 1) * ny)

    def realise(self, order: int) -> Subspace:
        """The model of a given order: Gamma from the first `order` directions; the projection is not repeated."""
        w, f = self.windows, self.options.future
        n, nu, ny = _check_order(order, self.largest), w.nu, w.nz - w.nu
        Gamma = self.U[:, :n] * np.sqrt(self.singular_values[:n])
        inverse, shorter = np.linalg.pinv(Gamma), np.linalg.pinv(Gamma[:-ny])
        u_f, y = w.signals(0, f - 1, outputs=False), w.signals(0, 0, outputs=True)
        # Z_i and Z_(i+1) of [2] (4.18): all of the future projected on the past and the future inputs
        now = _projected(w.signals(0, f - 1, outputs=True), np.hstack([w.z(-w.past, -1), u_f]))
        later = _projected(w.signals(1, f - 1, outputs=True), np.hstack([w.z(-w.past, 0), u_f[:, nu:]]))
        state = now @ inverse.T
        left = np.hstack([later @ shorter.T, y])
        AC_rest = _least_squares(np.hstack([state, u_f]), left)
        AC = AC_rest[:, :n]
        A, C = AC[:n], AC[n:]
        B, D = self._inputs(A, C, Gamma, (inverse, shorter), u_f, left - state @ AC.T)
        residual = left - np.hstack([state, u_f]) @ AC_rest.T
        K = _kalman_gain(A, C, residual / np.sqrt(w.count))
        covariance = residual[:, n:].T @ residual[:, n:] / (w.count - 1 - n - u_f.shape[1])
        return _unscaled(self, (A, B, C, D, K), covariance, self._operating_point(A, B, C, D, K))

    def _inputs(self, A, C, Gamma, inverses, u_f, target):
        """B, D: the coefficients of u_f in the state equation are linear in them ([2] (4.50) and (4.53))."""
        w, f = self.windows, self.options.future
        n, nu, ny = len(A), w.nu, len(C)
        inverse, shorter = inverses
        feedthrough = self.options.feedthrough
        columns = []
        for entry in range((n + ny if feedthrough else n) * nu):
            unit = np.zeros((n + ny) * nu)
            unit[entry] = 1.0
            B, D = np.split(unit.reshape(n + ny, nu), [n])
            H = _toeplitz(Gamma, B, D, f)
            upper = -A @ inverse @ H
            upper[:, nu:] += shorter @ H[:-ny, :-nu]
            upper[:, :nu] += B
            lower = -C @ inverse @ H
            lower[:, :nu] += D
            columns.append((u_f @ np.vstack([upper, lower]).T).ravel())
        answer = _least_squares(np.array(columns).T, target.ravel()[:, None])[0]
        solution = np.concatenate([answer, np.zeros((n + ny) * nu - len(answer))])
        return np.split(solution.reshape(n + ny, nu), [n])

    def _operating_point(self, A, B, C, D, K) -> np.ndarray:
        # steady state of the predictor from (u, y) to y; its intercept from the windows' means
        w = self.windows
        F, G = A - K @ C, np.hstack([B - K @ D, K])
        taps, reach = np.zeros((len(C), w.past, w.nz)), G
        for lag in range(1, w.past + 1):
            taps[:, w.past - lag] = C @ reach
            reach = F @ reach
        now = w.mean[w.past * w.nz : (w.past + 1) * w.nz]
        intercept = now[w.nu :] - taps.reshape(len(C), -1) @ w.mean[: w.past * w.nz] - D @ now[: w.nu]
        total = taps.sum(axis=1)
        total[:, : w.nu] += D
        return _equilibrium(total, intercept)


def _oblique_projection(options: N4SID, w: Windows) -> ObliqueProjection:
    f = options.future
    u_f, past = w.signals(0, f - 1, outputs=False), w.z(-w.past, -1)
    future = w.signals(0, f - 1, outputs=True)
    coefficients = _least_squares(np.hstack([past, u_f]), future)
    oblique = past @ coefficients[:, : past.shape[1]].T
    off_inputs = oblique - _projected(oblique, u_f)  # [2] fig. 4.8, step 2
    U, s, _ = np.linalg.svd(off_inputs.T, full_matrices=False)
    # noise alone: the projection of white residuals on as many past directions
    residual = future - np.hstack([past, u_f]) @ coefficients.T
    root = _triangle(residual).T / np.sqrt(w.count - 1 - coefficients.shape[1])
    random = np.random.default_rng(0)
    draws = [np.linalg.norm(root @ random.standard_normal((len(root), past.shape[1])), 2) for _ in range(9)]
    level = max(float(np.median(draws)), ROUNDING * s[0])
    return ObliqueProjection(options, w, s, level, U)


def _toeplitz(Gamma: np.ndarray, B: np.ndarray, D: np.ndarray, f: int) -> np.ndarray:
    """H: block lower-triangular, D on the diagonal and C A^(i-1) B below it."""
    ny, nu = D.shape
    column = np.vstack([D, Gamma[:-ny] @ B])
    H = np.zeros((f * ny, f * nu))
    for j in range(f):
        H[j * ny :, j * nu : (j + 1) * nu] = column[: (f - j) * ny]
    return H


# ---- shared pieces --------------------------------------------------------------------------------------------------


def _check_horizons(order: int | None, past: int, future: int) -> None:
    if not 2 <= future <= past:
        raise InputError(f"past {past}, future {future}", mend="choose 2 <= future <= past")
    if order is not None and order < 1:
        raise InputError(f"order {order}", mend="choose at least 1, or None for the singular values to decide")


def _check_order(order: int, largest: int) -> int:
    if order > largest:
        raise InputError(f"order {order}, these records and horizons show at most {largest}", mend="choose less")
    return order


def _least_squares(X: np.ndarray, Y: np.ndarray) -> np.ndarray:
    """argmin ||Y - X M'||, (columns of Y, columns of X); directions that the data do not excite get no coefficient."""
    return np.linalg.lstsq(X, Y, rcond=1e-11)[0].T


def _triangle(X: np.ndarray) -> np.ndarray:
    """R of X = Q R: what least squares see of X."""
    return np.asarray(np.linalg.qr(X, mode="r"))


def _projected(Y: np.ndarray, X: np.ndarray) -> np.ndarray:
    return X @ _least_squares(X, Y).T


def _remembered(e: np.ndarray) -> bool:
    """Residuals above rounding: then they carry information about K."""
    return bool(np.all(np.linalg.norm(e, axis=0) > 1e-9 * np.sqrt(len(e))))


def _whitener(covariance: np.ndarray) -> np.ndarray:
    """W with W covariance W' = 1; noise-free outputs keep their own scale."""
    if np.min(np.diag(covariance)) < 1e-18:
        return np.eye(len(covariance))
    return np.linalg.inv(np.linalg.cholesky(covariance))


def _radius(A: np.ndarray) -> float:
    return float(np.abs(np.linalg.eigvals(A)).max(initial=0.0))


def _kalman_gain(A: np.ndarray, C: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """K = (A P C' + S)(C P C' + R)^-1, P from the Riccati equation of the residuals' covariance [Q S; S' R].

    A floor far below any measurable noise keeps the equation solvable on noise-free records; there the predictor trusts the
    measured outputs.
    """
    from scipy.linalg import solve_discrete_are

    n = len(A)
    joint = residual.T @ residual
    floor = 1e-12 * np.diag(np.r_[np.ones(n), 1e-4 * np.ones(len(C))]) + 1e-9 * np.diag(np.diag(joint))
    joint = joint + floor
    joint /= np.trace(joint[n:, n:])
    Q, S, R = joint[:n, :n], joint[:n, n:], joint[n:, n:]
    try:
        P = solve_discrete_are(A.T, C.T, Q, R, s=S)
        K = np.linalg.solve(C @ P @ C.T + R, (A @ P @ C.T + S).T).T
    except np.linalg.LinAlgError:
        return np.zeros((n, len(C)))
    return K if _radius(A - K @ C) < 1.0 else np.zeros_like(K)


def _equilibrium(total: np.ndarray, intercept: np.ndarray) -> np.ndarray:
    """The (u, y) nearest to zero with y = intercept + total [u; y]: the equilibrium nearest to the records' mean.

    With an integrator not every input has an equilibrium, so the input moves as well.
    """
    nu = total.shape[1] - len(total)
    return np.linalg.lstsq(np.hstack([np.zeros((len(total), nu)), np.eye(len(total))]) - total, intercept, rcond=1e-9)[0]


def _unscaled(estimate, matrices: Sequence[np.ndarray], covariance: np.ndarray, point: np.ndarray) -> Subspace:
    w: Windows = estimate.windows
    A, B, C, D, K = matrices
    su, sy = w.scale[: w.nu], w.scale[w.nu :]
    point = w.centre + w.scale * point
    return Subspace(
        dt=w.dt,
        inputs=w.inputs,
        outputs=w.outputs,
        singular_values=estimate.singular_values,
        noise_level=estimate.noise_level,
        past=w.past,
        A=A,
        B=B / su,
        C=sy[:, None] * C,
        D=sy[:, None] * D / su,
        K=K / sy,
        covariance=sy[:, None] * covariance * sy,
        u0=point[: w.nu],
        y0=point[w.nu :],
    )
