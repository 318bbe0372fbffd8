"""Margins of frozen loops: what a linear controller leaves of a model at each value of its schedule.

    S = (I + L)^-1,  T = L (I + L)^-1,  Q = K (I + P K)^-1,   |.|: largest singular value over all frequencies

A schedule that moves fast is no frozen one: `lyapunov` and a run of the loop speak of that.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from workbench.errors import InputError
from workbench.lpv import LPVModel
from workbench.records import field, record
from workbench.robustness.frequency import Closed, System, delay_margin, first_reaching, peak
from workbench.robustness.linear_law import LinearLaw, check_law
from workbench.steady import gain

PEAKS = ("sensitivity", "complementary", "effort", "loops", "radius")


@record
class Bounds:
    """What a design must keep: peaks of S and T as spectral norms, and of the control effort Q.

    effort: largest |Q| as a multiple of 1 / sigma_min(P(0)), the least that any law with integral action needs; of a plant that
    integrates about what a loop takes that crosses over at a tenth of a radian a sample. broken: where the loop is opened for S
    and T, "input" or "output" of the plant.
    """

    sensitivity: float = field("", low=1.0 + 1e-9, default=1.6)
    complementary: float = field("", low=1.0 + 1e-9, default=1.6)
    effort: float = field("", low=1.0 + 1e-9, default=3.0)
    broken: str = "input"

    def __post_init__(self):
        if self.broken not in ("input", "output"):
            raise InputError(f"a loop broken at the {self.broken!r}", mend="broken is 'input' or 'output'")


DEFAULT = Bounds()


@record
class Margins:
    """Peaks over frequency of the frozen loops at n schedule values, to a share of 1e-6.

    sensitivity, complementary: spectral norms of S and T at the loop broken as the bounds say; effort: |Q| as a multiple of
    1 / sigma_min(P(0)); loops (n, nu): |S_ii| with one loop broken at the plant input and the others closed; radius: largest
    modulus of a closed-loop pole; bandwidth [rad/s]: where |S| first reaches 1 / sqrt(2); frequencies (n, 3) [rad/s]: where |S|,
    |T| and |Q| peak, within `frequencies`; delay (n, nu) [s]: how much later one command may act before its loop is lost, the
    others closed. A loop that is lost has bandwidth and delay 0, and no peaks worth the name. rho (n), of several schedule
    variables (n, ns).
    """

    rho: np.ndarray = field("n ...")
    sensitivity: np.ndarray = field("n")
    complementary: np.ndarray = field("n")
    effort: np.ndarray = field("n")
    loops: np.ndarray = field("n nu")
    radius: np.ndarray = field("n")
    bandwidth: np.ndarray = field("n", unit="rad/s")
    delay: np.ndarray = field("n nu", unit="s", low=0.0)
    frequencies: np.ndarray = field("n 3", unit="rad/s")

    def broken(self, bounds: Bounds) -> np.ndarray:
        """Where a bound is not kept, (n,)."""
        over = (self.sensitivity > bounds.sensitivity) | (self.complementary > bounds.complementary)
        return over | (self.effort > bounds.effort) | (self.radius >= 1.0)


def margins_of(
    law: LinearLaw,
    model: LPVModel,
    rhos: Sequence[Any],
    bounds: Bounds = DEFAULT,
    scale: np.ndarray | None = None,
) -> Margins:
    """Margins of a law on a model's frozen loops, between all frequencies; bounds say where the loop is opened."""
    scale = np.ones(len(model.outputs)) if scale is None else scale
    lowest, highest = frequencies(model.dt)[[0, -1]]
    rows = []
    for rho in rhos:
        loop = closed_loop(law, model, rho, scale)
        S = loop.input_sensitivity if bounds.broken == "input" else loop.output_sensitivity
        peaks = [peak(system) for system in (S, S.less(1.0), loop.effort)]
        A, B, C, D = model.freeze(rho)
        P0 = gain(A, B, C, D, model.free) / scale[:, None]
        alone, lost = [loop.alone(i) for i in range(loop.nu)], not loop.system.stable
        rows.append({
            "rho": 0.0 if rho is None else rho,
            "sensitivity": peaks[0].gain,
            "complementary": peaks[1].gain,
            "effort": peaks[2].gain * np.linalg.svd(P0, compute_uv=False)[len(C) - 1],
            "loops": np.array([peak(own).gain for own in alone]),
            "radius": np.abs(loop.system.poles).max(),
            "bandwidth": 0.0 if lost else first_reaching(S, np.sqrt(0.5)),
            "delay": np.array([0.0 if lost else delay_margin(own) for own in alone]),
            "frequencies": np.clip([found.omega for found in peaks], lowest, highest),
        })  # fmt: skip
    return Margins(**{key: np.array([row[key] for row in rows]) for key in rows[0]})


def closed_loop(law: LinearLaw, model: LPVModel, rho: Any, scale: np.ndarray | float = 1.0) -> Closed:
    """The frozen loop of a law: its commands and measurements in its own order, measurements in units of `scale` (ny)."""
    check_law(model, law)
    A, B, C, D = model.freeze(rho)
    u = [[c.name for c in model.inputs].index(name) for name in law.actuated]
    y = [[c.name for c in model.outputs].index(name) for name in law.measured]
    size = np.broadcast_to(np.asarray(scale, dtype=float), len(C))[y]
    plant = System(A, B[:, u], C[y] / size[:, None], D[np.ix_(y, u)] / size[:, None], model.dt)
    answer = feedback_of(law, rho)
    return Closed.of(plant, replace(answer, B=answer.B * size, D=answer.D * size))


def largest_sensitivity(law: LinearLaw, model: LPVModel, rhos: Sequence[Any]) -> float:
    """The largest |S|, broken at the plant input, of the frozen loops; infinite where one is lost."""
    loops = [closed_loop(law, model, rho).input_sensitivity for rho in rhos]
    return max(peak(S).gain if S.stable else np.inf for S in loops)


def feedback_of(law: LinearLaw, rho: Any) -> System:
    """What a frozen law makes of -y."""
    own: Any = getattr(law, "unshaped", law).at(rho)  # set-points are not in the loop
    reads = slice(len(law.references), None)
    return System(own.A, -own.B[:, reads], own.C, -own.D[:, reads], law.dt)


def loops_of(law: LinearLaw, model: LPVModel, rho: Any, omega: np.ndarray) -> np.ndarray:
    """L_i(exp(j omega dt)), (N, nu): loop i opened at the plant input, the others closed; L_i = 1 / S_ii - 1."""
    loop = closed_loop(law, model, rho)
    return np.stack([1.0 / loop.alone(i).at(omega)[:, 0, 0] - 1.0 for i in range(loop.nu)], axis=1)


def worst_margins(
    law: LinearLaw,
    models: Sequence[LPVModel],
    rhos: Sequence[Any],
    bounds: Bounds = DEFAULT,
    scale: np.ndarray | None = None,
) -> Margins:
    """The worst of all models at every schedule value, and the frequencies of each peak's own model."""
    each = [margins_of(law, model, rhos, bounds, scale) for model in models]
    high = {key: np.max([getattr(m, key) for m in each], axis=0) for key in PEAKS}
    worst = np.argmax([[getattr(m, key) for key in PEAKS[:3]] for m in each], axis=0)  # (3, n): whose peak it is
    frequencies = np.take_along_axis(np.stack([m.frequencies for m in each]), worst.T[None], axis=0)[0]
    bandwidth = np.min([m.bandwidth for m in each], axis=0)
    delay = np.min([m.delay for m in each], axis=0)
    return Margins(rho=each[0].rho, bandwidth=bandwidth, delay=delay, frequencies=frequencies, **high)


def frequencies(dt: float, finer: int = 1) -> np.ndarray:
    """Frequencies in rad/s up to Nyquist's: evenly in the logarithm, then evenly where sampled loops have their peaks."""
    shares = np.concatenate([np.geomspace(1e-4, 0.05, 20 * finer, endpoint=False), np.linspace(0.05, 0.9999, 40 * finer)])
    return shares * np.pi / dt


def around(poles: np.ndarray, dt: float) -> np.ndarray:
    """Frequencies in rad/s at which poles in z turn, and some of the width of their peaks to either side."""
    s = _logarithm(poles) / dt
    found = np.abs(s.imag)[:, None] + np.abs(s.real)[:, None] * np.linspace(-2.0, 2.0, 9)
    lowest, highest = frequencies(dt)[[0, -1]]
    return np.unique(found[(found > lowest) & (found < highest)])


def resonant(poles: np.ndarray) -> np.ndarray:
    """Those poles in z that turn more than they fade: the others have no peaks of their own."""
    s = _logarithm(poles)
    return poles[np.abs(s.imag) > 2.0 * np.abs(s.real)]


def _logarithm(poles: np.ndarray) -> Any:
    return np.log(np.where(poles == 0.0, 1e-300, poles).astype(complex))
