"""Output-error models of low order with dead times: what every other method must beat.

    x(k+1) = A x(k) + B u(k - d),   y(k) = C x(k) + y0 + e(k)

One or two poles for each output, a dead time for each input, y0: found on a grid, then refined together by the error of free
runs. Few samples are enough for so few numbers; what runs worse was misled by noise, or by a record that is too short for it.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from workbench.basis import CONSTANT
from workbench.data import Dataset
from workbench.errors import InputError
from workbench.identification.output_error.first_guess import Guess, Output
from workbench.identification.output_error.refine import refined
from workbench.identification.subspace import channels_of
from workbench.lpv import LPVModel, OperatingPoint, Predictor, constant_model
from workbench.records import record

SHORTEST = 20  # samples of all records together
LEARNT = 0.7  # of each record: what an order is judged by is the rest
BETTER = 0.98  # of the error: what a second pole must do


@record
class OutputError:
    """x+ = A x + B u(k - d), y = C x + y0 with one or two poles for each output, fitted to free runs.

    order: poles of each output, 1 or 2; None takes two where they run better on the last three tenths of every record, which
    neither is fitted to. delays: look for dead times.

        >>> OutputError(order=1).fit(data).to_control().poles().round(2)
        array([0.91+0.j])
    """

    order: int | None = None
    delays: bool = True
    name: str = "OE"

    def __post_init__(self):
        if self.order not in (None, 1, 2):
            raise InputError(f"order {self.order}", mend="1 or 2; lti and ssm take more")

    def fit(self, dataset: Dataset) -> LPVModel:
        """The model of all records together. Raises InputError for records without input or output, or too short."""
        first = dataset.experiments[0]
        channels_of(first)  # refuses records without inputs or outputs
        if sum(map(len, dataset)) < SHORTEST:
            raise InputError(f"{sum(map(len, dataset))} samples", file=first.name, mend=f"give at least {SHORTEST}")
        order = self.order or self._order(dataset)
        return replace(self._fitted(dataset, order), trained_on=dataset.fingerprints)

    def _order(self, dataset: Dataset) -> int:
        """Two poles where they run better on what neither was fitted to."""
        learnt = Dataset(tuple(e.trim(stop=e.t[int(LEARNT * len(e))]) for e in dataset))
        first, second = (_missed(self._fitted(learnt, n), dataset) for n in (1, 2))
        return 2 if second < BETTER * first else 1

    def _fitted(self, dataset: Dataset, order: int) -> LPVModel:
        """The model with so many poles for each output."""
        inputs, outputs = channels_of(dataset.experiments[0])
        u = [e[[c.name for c in inputs]] for e in dataset]
        zero = np.mean(np.concatenate(u), axis=0)
        guesses = []
        for c in outputs:
            output = Output([e[c.name] for e in dataset], [a - zero for a in u], delays=self.delays)
            guess = output.guess(1)
            guesses.append(output.guess(2, guess) if order == 2 else guess)
        A, B, C = _realised(guesses)
        y0 = np.array([guess.offset for guess in guesses])
        model = constant_model(
            self.name, dataset.dt, (inputs, outputs), (A, B, C, np.zeros((len(C), B.shape[1]))),
            OperatingPoint(CONSTANT, zero[None], y0[None]),
            predictor=Predictor(A[None], B[None], np.zeros((1, len(A), len(C))), warmup=len(A)),
        )  # fmt: skip
        late = [
            f"dead time from {u.name} to {y.name}: {d * dataset.dt:.4g} s"
            for y, guess in zip(outputs, guesses, strict=True)
            for u, d in zip(inputs, guess.delays, strict=True)
            if d
        ]
        return replace(refined(model, dataset), notes=tuple(late))


def _missed(model: LPVModel, dataset: Dataset) -> float:
    """Squared errors over squared deviations of the free runs on the last part of every record, summed over outputs."""
    total = 0.0
    for e in dataset:
        last, y = int(LEARNT * len(e)), e[[c.name for c in model.outputs]]
        with np.errstate(over="ignore", invalid="ignore"):
            missed = np.mean((y - model.simulate(e))[last:] ** 2, axis=0)
        total += float(np.sum(missed / np.maximum(np.var(y, axis=0), np.finfo(float).tiny)))
    return np.sqrt(total) if np.isfinite(total) else np.inf


def _realised(guesses: Sequence[Guess]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A, B, C: a polynomial of poles for each output in observer form, and for each input a shift of its late values."""
    nu, deepest = guesses[0].gains.shape[1], np.max([guess.delays for guess in guesses], axis=0)
    forms = [_observer_form(guess) for guess in guesses]
    own = sum(len(poles) for poles, _ in forms)
    shift = own + np.concatenate([[0], np.cumsum(deepest)]).astype(int)  # where the late values of each input begin
    A, B, C = np.zeros((shift[-1], shift[-1])), np.zeros((shift[-1], nu)), np.zeros((len(guesses), shift[-1]))
    for i, d in enumerate(deepest):
        for k in range(d):
            if k:
                A[shift[i] + k, shift[i] + k - 1] = 1.0
            else:
                B[shift[i], i] = 1.0
    row = 0
    for j, (guess, (poles, gains)) in enumerate(zip(guesses, forms, strict=True)):
        n = len(poles)
        A[row : row + n, row] = poles
        A[row : row + n - 1, row + 1 : row + n] = np.eye(n - 1)
        C[j, row] = 1.0
        for i, d in enumerate(guess.delays):
            if d:
                A[row : row + n, shift[i] + d - 1] = gains[:, i]
            else:
                B[row : row + n, i] = gains[:, i]
        row += n
    return A, B, C


def _observer_form(guess: Guess) -> tuple[np.ndarray, np.ndarray]:
    """-d (n) and n (n, nu) of the transfer functions (n_1 z^(n-1) + ..) / (z^n + d_1 z^(n-1) + ..) of a guess."""
    a, g = guess.poles[0], guess.gains
    if a.imag:
        return np.array([2.0 * a.real, -(abs(a) ** 2)]), np.stack([np.real(g[0]), -np.real(g[0] * np.conj(a))])
    if len(guess.poles) == 1:
        return np.array([a.real]), np.real(g)
    other = guess.poles[-1]
    return np.array([(a + other).real, -(a * other).real]), np.stack([np.real(g[0] + g[1]), -np.real(g[0] * other + g[1] * a)])
