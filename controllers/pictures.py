"""Pictures of a PID design: gains and margins over the schedule, Nyquist curves, frozen loops and steps of the set-points."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from controllers.scheduled_pid import ScheduledPID
from workbench.lpv import LPVModel, lattice, mesh
from workbench.report import figures
from workbench.report.blocks import Block, Table
from workbench.robustness.frozen import DEFAULT, Bounds, closed_loop, frequencies, loops_of, worst_margins

POINTS, FAMILY = 25, 5  # schedule values at which margins and Nyquist curves are drawn
WIDTHS = np.array([-4.0, -2.0, -1.0, -0.5, -0.25, 0.25, 0.5, 1.0, 2.0, 4.0])  # of a peak, at which it is drawn
FROZEN, STEP = 15, 4.0  # schedule values at which one can look at a loop; s of a step response


def design_pictures(
    laws: Mapping[str, ScheduledPID], models: Sequence[LPVModel], bounds: Bounds = DEFAULT, scale: np.ndarray | None = None
) -> tuple[Block, ...]:
    """Gains over the schedule of PIDs, the worst margins of all models, and the last law's Nyquist curves on the first.

    Of several schedule variables the first goes over its span, in a line for each of a few values of the others.
    """
    model = models[0]
    lines = {
        ", ".join(filter(None, [name, where])): (law, rho) for name, law in laws.items() for where, rho in _lines(model).items()
    }
    margins = {line: worst_margins(law, models, rho, bounds, scale) for line, (law, rho) in lines.items()}
    peaks = {"largest sensitivity": "sensitivity", "largest complementary sensitivity": "complementary", "largest pole": "radius"}
    name, law = list(laws.items())[-1]
    shown = model.frozen_values(FAMILY) if len(model.schedules) < 2 else [*model.frozen_values(2), model.middle]
    titles = [model.named(at) or model.name for at in shown]
    omega = _drawn_at(law, model, shown)
    opened = [loops_of(law, model, at, omega) for at in shown]
    family = figures.nyquist(
        f"Nyquist curves, {name}",
        {
            f"loop of {c.name}": {title: L[:, i] for title, L in zip(titles, opened, strict=True)}
            for i, c in enumerate(model.inputs)
        },
        bounds.sensitivity,
    )
    if not model.schedules:
        rows = tuple((own, *(float(getattr(margins[own], key)[0]) for key in peaks.values())) for own in laws)
        return Table("Margins", ("law", *peaks), rows, digits=3), family
    over = figures.Trace(model.schedules[0], lattice(model.spans[:1], POINTS))
    asked = {"sensitivity": bounds.sensitivity, "complementary": bounds.complementary, "radius": 1.0}
    curves = {
        panel: {own: getattr(m, key) for own, m in margins.items()} | {"asked": np.array(asked[key])}
        for panel, key in peaks.items()
    }  # fmt: skip
    gains = {line: [own.gains_at(value) for value in rho] for line, (own, rho) in lines.items()}
    kinds = list(dict.fromkeys(kind for own in laws.values() for kind in own.gain_names))
    surfaces = {
        f"{kind}, {u.name} from {y.name}": {own: np.array([getattr(g, kind)[i, j] for g in each]) for own, each in gains.items()}
        for kind in kinds
        for i, u in enumerate(model.inputs)
        for j, y in enumerate(model.outputs)
    }
    return (
        figures.over_schedule(
            "Margins over the schedule",
            over,
            curves,
            "Frozen loops of the identified model, the largest of all frequencies; asked: the bound.",
        ),
        figures.over_schedule("Gains over the schedule", over, surfaces),
        family,
        *_frozen(name, law, model),
    )


def _lines(model: LPVModel) -> dict[str, list]:
    """Schedule values along which curves are drawn, by what the others of several variables are: low, in the middle, high."""
    if not model.schedules:
        return {"": [None]}
    rest = [lattice(span[None], 3) for span in model.spans[1:]]
    others = mesh(rest).reshape(-1, len(rest)) if rest else np.zeros((1, 0))
    return {_told(model, own): _line(model, own, POINTS) for own in others}


def _line(model: LPVModel, others: np.ndarray, points: int) -> list:
    """Schedule values: the first variable over its span, the others as they are given."""
    first = lattice(model.spans[:1], points)
    return [np.append(value, others) for value in first] if len(others) else first.tolist()


def _told(model: LPVModel, others: np.ndarray) -> str:
    """The other variables at these values."""
    return ", ".join(f"{c.name} = {v:.4g} {c.unit}".rstrip() for c, v in zip(model.schedules[1:], others, strict=True))


def _drawn_at(law: ScheduledPID, model: LPVModel, rhos: Sequence[Any]) -> np.ndarray:
    """Frequencies at which curves are drawn: evenly, and across every peak."""
    omega = frequencies(model.dt, 5)
    across = np.concatenate([closed_loop(law, model, rho).system.around(WIDTHS) for rho in rhos])
    return np.union1d(omega, across[(across > omega[0]) & (across < omega[-1])])


def _frozen(name: str, law: ScheduledPID, model: LPVModel) -> tuple[Block, ...]:
    """What a loop does at every schedule value: sensitivities over frequency, and steps of each set-point by one unit.

    Of several schedule variables the first goes over its span, the others stay in the middle of theirs.
    """
    channel, others = model.schedules[0], np.mean(model.spans[1:], axis=1)
    rho = _line(model, others, FROZEN)
    omega = _drawn_at(law, model, rho)
    opened = np.stack([loops_of(law, model, at, omega) for at in rho])  # (R, N, nu)
    sensitivities = {}
    for i, u in enumerate(law.actuated):
        sensitivities[f"|S| {u}"] = 20.0 * np.log10(np.abs(1.0 / (1.0 + opened[..., i])))
        sensitivities[f"|T| {u}"] = 20.0 * np.log10(np.abs(opened[..., i] / (1.0 + opened[..., i])))
    over = figures.Trace(channel, lattice(model.spans[:1], FROZEN))
    at = ", ".join(filter(None, [channel.name, _told(model, others)]))
    t = model.dt * np.arange(max(2, round(STEP / model.dt)))
    steps = {f"{y} from {y}_set": np.stack([_step(law, model, at, j, len(t)) for at in rho]) for j, y in enumerate(law.measured)}
    return (
        figures.frozen_responses(omega, over, sensitivities, f"Sensitivities at every {at}, {name}", drawn=3),
        figures.frozen_steps(t, over, steps, f"Steps of the set-points at every {at}, {name}"),
    )


def _step(law: ScheduledPID, model: LPVModel, rho: Any, j: int, N: int) -> np.ndarray:
    """(N,) change of output j of the frozen model when its set-point rises by one unit at the first sample, from rest."""
    A, B, C, _ = model.freeze(rho)  # a law is designed on models without feedthrough
    own = [[c.name for c in model.outputs].index(name) for name in law.measured]
    acts = [[c.name for c in model.inputs].index(name) for name in law.actuated]
    phi = model.operating_point.basis(np.array(rho))
    y0, u0 = phi @ model.operating_point.y, phi @ model.operating_point.u
    r, x, u = y0[own].copy(), np.zeros(len(A)), np.zeros(B.shape[1])
    state, found = law.init(u0[acts]), np.empty(N)
    for k in range(-1, N):  # one sample at rest before, so that the law stands where the model does
        y = C @ x + y0
        if k >= 0:
            found[k] = y[own[j]] - y0[own[j]]
        command, state = law.step(state, r + (k >= 0) * np.eye(len(own))[j], y[own], rho)
        u[acts] = command - u0[acts]
        x = A @ x + B @ u
    return found
