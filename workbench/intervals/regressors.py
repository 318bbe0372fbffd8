"""Regressors of an interval model: y(k) = d'psi(k) + theta'z(k), z(k) = T psi(k).

psi(k) = (y(k-1) .. y(k-n), u_1(k-delay) .. u_1(k-n), u_2(k-delay) .., 1) holds the measured values; T and d are constant:

    shift form   d = 0, z = (-y(k-1), .., -y(k-n), u(k-1), .., 1)                                        # [2] (6)
    delta form   with D = q - 1:  D^n y(k-n) = -sum_i alpha_i D^(n-i) y(k-n) + sum_j beta_j D^j u(k-n) + bias

Both describe the same systems, but not with the same boxes. With poles p1, p2 near 1, 1 + a1 + a2 = (1 - p1)(1 - p2) is small:
an interval of 0.2 % on a1 alone may reach the unit circle, where 0.2 % of alpha1, alpha2 moves the poles by 0.2 % of their
distance from 1. The smallest box of a record is narrower in delta form, in one step; in a free run either may win.

[2] Linear time-varying models with interval parameters, section 4.3.
"""

import itertools
from collections.abc import Sequence
from math import comb

import numpy as np

from workbench.data import Dataset, Experiment, bad_stamps
from workbench.errors import InputError
from workbench.records import field, record


@record
class Form:
    """T (p m), d (m) and the names of the parameters (p); `blocks` are the entries of psi that share rows of T.

    lags (m): how many samples back an entry of psi lies; source (m): its channel, 0 the output, 1 .. nu the inputs, -1 the 1.
    T is block diagonal and regular.
    """

    T: np.ndarray = field("p m")
    d: np.ndarray = field("m")
    source: np.ndarray = field("m")
    lags: np.ndarray = field("m")
    names: tuple[str, ...]
    blocks: tuple[tuple[int, ...], ...]


@record
class ARX:
    """y(k) = d'psi(k) + theta'z(k) with psi(k) = (y(k-1) .. y(k-n), u(k-delay) .. u(k-n), 1): the last n outputs and inputs.

    order: n. delta: z of differences (q-1)^i of these, whose boxes are narrower in one step; False: z of the values themselves.
    bias: a constant term. delay: samples after which u acts; 0 lets u(k) act on y(k) at once.

        >>> IntervalRegression(ARX(order=2, delta=False)).fit(data).form.names
        ('-n(k-1)', '-n(k-2)', 'U(k-1)', 'U(k-2)', '1')
    """

    order: int = 2
    delta: bool = True
    bias: bool = True
    delay: int = 1

    def __post_init__(self):
        _check_orders(self.order, self.delay)

    @property
    def memory(self) -> int:
        """n: samples before the first one that has regressors."""
        return self.order

    def form(self, output: str, inputs: Sequence[str]) -> Form:
        """T, d and names for channels by name."""
        n = self.order
        if not self.delta:
            return _assemble(
                [(output, 0, list(range(1, n + 1)), -np.eye(n), [f"-{output}(k-{i})" for i in range(1, n + 1)], np.zeros(n))]
                + [_shifted(name, i, self.delay, n) for i, name in enumerate(inputs, 1)],
                self.bias,
                separate=True,
            )
        labels = [f"-{_power(n - i)}{output}(k-{n})" for i in range(1, n + 1)]
        parts = [(output, 0, list(range(1, n + 1)), -_differences(n, n), labels, -_highest(n)[1:])]
        for i, name in enumerate(inputs, 1):
            count = n + 1 - self.delay
            lags = list(range(self.delay, n + 1))
            labels = [f"{_power(j)}{name}(k-{n})" for j in reversed(range(count))]
            parts.append((name, i, lags, _differences(count, count), labels, np.zeros(count)))
        return _assemble(parts, self.bias, separate=False)


@record
class FIR:
    """y(k) = sum_i g_i u(k-i) + bias: the last n inputs alone, no feedback, so free run and one step are the same.

    order: n. bias: a constant term. delay: samples after which u acts.

        >>> len(IntervalRegression(FIR(order=10)).fit(data).form.names)
        11
    """

    order: int = 20
    bias: bool = True
    delay: int = 1

    def __post_init__(self):
        _check_orders(self.order, self.delay)

    @property
    def memory(self) -> int:
        return self.order

    def form(self, output: str, inputs: Sequence[str]) -> Form:
        """T, d and names for channels by name."""
        del output
        return _assemble(
            [_shifted(name, i, self.delay, self.order) for i, name in enumerate(inputs, 1)], self.bias, separate=True
        )


Structure = ARX | FIR


@record
class Samples:
    """The rows of a regression: psi (K m) as measured, y (K), and the record and sample each row comes from.

    error (m) and output_error: bounds on |measured - true| of psi's entries and of y.
    """

    structure: Structure
    form: Form
    psi: np.ndarray = field("K m")
    y: np.ndarray = field("K")
    error: np.ndarray = field("m", low=0.0)
    output_error: float = field("", low=0.0)
    piece: np.ndarray = field("K")  # rows of one number follow each other in time
    index: np.ndarray = field("K")  # sample within the record
    records: tuple[str, ...]  # name of the record of each piece
    origin: tuple[int, ...] = ()  # its number within the dataset: two records may have one name

    def __len__(self) -> int:
        return len(self.y)

    @property
    def z(self) -> np.ndarray:
        """Regressors (K p) at the measured values."""
        return self.psi @ self.form.T.T

    def rows(self, chosen: np.ndarray | slice) -> "Samples":
        """Some of the rows."""
        return Samples(
            self.structure, self.form, self.psi[chosen], self.y[chosen], self.error, self.output_error, self.piece[chosen],
            self.index[chosen], self.records, self.origin,
        )  # fmt: skip


def samples(
    structure: Structure,
    dataset: Dataset | Experiment,
    output: str,
    inputs: Sequence[str],
    *,
    output_error: float = 0.0,
    input_error: Sequence[float] | float = 0.0,
) -> Samples:
    """Every sample that has a whole regressor behind it; none reaches across two records or across a gap.

    Raises InputError for records that are too short, for negative errors, and for no input.
    """
    if not inputs:
        raise InputError("no input", mend="name at least one input channel")
    errors = np.concatenate([[output_error], np.broadcast_to(np.asarray(input_error, float), len(inputs))])
    for name, e in zip([output, *inputs], errors, strict=True):
        if not (np.isfinite(e) and e >= 0.0):
            raise InputError(f"error bound {e:g}, expected 0 or more", channel=name, mend="give e_y, e_u as |measured - true|")
    form = structure.form(output, inputs)
    n = structure.memory
    psi, y, piece, index, records, origin = [], [], [], [], [], []
    for number, e in enumerate([dataset] if isinstance(dataset, Experiment) else dataset):
        columns = e[[output, *inputs]]
        for first, last in _whole_pieces(e):
            if last - first <= n:
                continue
            k = np.arange(first + n, last)
            psi.append(_regressors(form, columns, k))
            y.append(columns[k, 0])
            piece.append(np.full(len(k), len(records)))
            index.append(k)
            records.append(e.name)
            origin.append(number)
    if not y:
        longest = max(len(e) for e in ([dataset] if isinstance(dataset, Experiment) else dataset))
        raise InputError(
            f"{longest} samples without a gap, the regressor reaches back {n}",
            mend=f"use records longer than {n + 1} samples, or a lower order",
        )
    error = np.where(form.source >= 0, errors[form.source.astype(int)], 0.0)
    return Samples(
        structure, form, np.concatenate(psi), np.concatenate(y), error, float(output_error), np.concatenate(piece),
        np.concatenate(index), tuple(records), tuple(origin),
    )  # fmt: skip


def _regressors(form: Form, columns: np.ndarray, k: np.ndarray) -> np.ndarray:
    """psi (len(k), m) from columns (N, 1 + nu) at samples k."""
    source, lags = form.source.astype(int), form.lags.astype(int)
    psi = columns[k[:, None] - lags[None], np.maximum(source, 0)[None]]
    psi[:, source < 0] = 1.0
    return psi


def _whole_pieces(e: Experiment) -> list[tuple[int, int]]:
    """[first, last) of the stretches of a record whose stamps are uniform."""
    breaks = [bad.index for bad in bad_stamps(e.t, e.dt)]
    edges = [0, *breaks, len(e)]
    return [(a, b) for a, b in itertools.pairwise(edges) if b > a]


def _check_orders(order: int, delay: int) -> None:
    if order < 1:
        raise InputError(f"order {order}, expected 1 or more")
    if not 0 <= delay <= order:
        raise InputError(f"delay {delay}, expected 0 to the order {order}")


def _highest(n: int) -> np.ndarray:
    """(q-1)^n y(k-n) over y(k), y(k-1), .., y(k-n)."""
    return np.array([(-1.0) ** i * comb(n, i) for i in range(n + 1)])


def _differences(count: int, n: int) -> np.ndarray:
    """Rows (q-1)^j v, j = count - 1 .. 0, over the n entries v(k'), .., oldest last; every row is anchored at the oldest."""
    rows = np.zeros((count, n))
    for row, j in enumerate(reversed(range(count))):
        rows[row, n - 1 - j :] = _highest(j)
    return rows


def _power(j: int) -> str:
    return "" if j == 0 else "D " if j == 1 else f"D^{j} "


_Part = tuple[str, int, list[int], np.ndarray, list[str], np.ndarray]


def _shifted(name: str, source: int, delay: int, n: int) -> _Part:
    lags = list(range(delay, n + 1))
    return name, source, lags, np.eye(len(lags)), [f"{name}(k-{i})" if i else f"{name}(k)" for i in lags], np.zeros(len(lags))


def _assemble(parts: list[_Part], bias: bool, *, separate: bool) -> Form:
    """The block diagonal form of several channels; `separate`: every entry is a block of its own."""
    if bias:
        parts = [*parts, ("1", -1, [0], np.eye(1), ["1"], np.zeros(1))]
    m = sum(len(lags) for _, _, lags, *_ in parts)
    T, d, source, lags, names, blocks = np.zeros((m, m)), np.zeros(m), np.zeros(m), np.zeros(m), [], []
    at = 0
    for _, channel, own_lags, rows, labels, own_d in parts:
        span = slice(at, at + len(own_lags))
        T[span, span], d[span], source[span], lags[span] = rows, own_d, channel, own_lags
        names += labels
        entries = tuple(range(at, at + len(own_lags)))
        blocks += [(i,) for i in entries] if separate else [entries]
        at += len(own_lags)
    return Form(T, d, source, lags, tuple(names), tuple(blocks))
