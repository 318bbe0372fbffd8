"""An MPC while no limit acts: its affine form against its own steps, and what is proved of it against loops of the law itself."""

from dataclasses import replace

import numpy as np
import pytest

from controllers.mpc import MPC, Extrapolated, Held, design_mpc
from controllers.pid import pid
from controllers.receding import Weights
from controllers.scheduled_pid import Clamping
from tests.controllers import test_tube as tubes
from tests.controllers.test_mpc import Plant, law, lpv
from tests.workbench.robustness import test_resimulation as plain
from workbench.basis import CONSTANT
from workbench.data import Channel
from workbench.errors import InputError
from workbench.intervals.domains.shapes import Box
from workbench.intervals.model import IntervalModel, Mode, Unrefuted
from workbench.intervals.regressors import FIR
from workbench.intervals.semantics import ParameterBox
from workbench.lpv import OperatingPoint, Predictor, Term, constant_model
from workbench.robustness.envelopes.constant import constant_kernel
from workbench.robustness.envelopes.kernel import kernel
from workbench.robustness.frozen import worst_margins
from workbench.robustness.limits import limits_of
from workbench.robustness.linear_law import affine_of, without_linear_form
from workbench.robustness.loop import course_of
from workbench.robustness.verdict import Bound, Region, Status, bounds_kept
from workbench.verification.model import Open, on_model

FAR = {"low": np.full(2, -1e6), "high": np.full(2, 1e6), "rate": np.full(2, 1e9)}


def late() -> MPC:
    """Terms that see the schedule two samples late."""
    return law(replace(lpv(), terms=(Term(0), Term(1, 2))), horizon=6, **FAR)


def tube() -> MPC:
    model, far = tubes.turning(), np.full(2, 1e4)
    return design_mpc(
        model, replace(tubes.fallback(), low=-far, high=far, rate=1e4 * far), errors=tubes.errors(model), horizon=8,
        weights=tubes.WEIGHTS, y_low=-far, y_high=far,
    )  # fmt: skip


LAWS = {
    "extrapolated": lambda: law(horizon=8, prediction=Extrapolated(5.0), **FAR),
    "held": lambda: law(horizon=8, prediction=Held(), **FAR),
    "late": late,
    "tube": tube,
}


@pytest.mark.parametrize("kind", LAWS)
def test_the_affine_form_is_the_law_while_the_schedule_moves(kind):
    """Samples of all kinds, from the memory that the first one leaves: no limit is near."""
    controller, random = LAWS[kind](), np.random.default_rng(3)
    rho = 1.5 + 0.3 * np.sin(0.3 * np.arange(40)) + 0.05 * random.normal(size=40)
    slopes = controller.slopes(rho)
    assert slopes.any() == (kind != "held")
    state, x = controller.init(), None
    for at, slope in zip(rho, slopes, strict=True):
        r, y, own = random.normal(size=2), np.array([5.0, 1.0]) + random.normal(size=2), controller.affine(at, slope)
        u, state = controller.step(state, r, y, at)
        if x is not None:
            seen = np.concatenate([r, y])
            np.testing.assert_allclose(own.C @ x + own.D @ seen + own.o, u, atol=1e-6 * (1.0 + np.abs(u).max()))
            x = own.A @ x + own.B @ seen + own.a
        else:
            x = controller.memory(state)
    np.testing.assert_allclose(x, controller.memory(state), atol=1e-5 * (1.0 + np.abs(x).max()))


@pytest.mark.parametrize("kind", LAWS)
def test_law_and_linear_form_are_compared_before_anything_is_proved(kind, monkeypatch):
    controller = LAWS[kind]()
    assert without_linear_form(controller) == ""
    true = type(controller).affine
    for wrong in ("A", "B", "C", "D", "a", "o"):
        monkeypatch.setattr(
            type(controller), "affine",
            lambda self, rho=None, slope=0.0, wrong=wrong: replace(
                own := true(self, rho, slope), **{wrong: getattr(own, wrong) + 1e-3 * np.abs(getattr(own, wrong)).max()}
            ),
        )  # fmt: skip
        assert "is not its law" in without_linear_form(controller), wrong


def test_margins_of_the_frozen_law_are_those_of_its_own_impulse_response():
    """|S| of the frozen loop from the law's own steps: a small pulse on a command, through a model that stands at rest."""
    controller, rho = law(horizon=10, prediction=Held(), **FAR), 1.3
    found = worst_margins(controller, [lpv()], [rho])
    N, size, answers = 800, 1e-2, []
    for j in (None, 0, 1):
        plant, state, us = Plant(lpv()), controller.init(np.array([0.3, -0.2])), []
        for k in range(N):
            y = plant.measure(rho)
            u, state = controller.step(state, np.array([5.0, 1.0]), y, rho)
            acting = u + (size * np.eye(2)[j] if j is not None and k == 40 else 0.0)
            us.append(acting)
            plant.advance(acting, rho)
        answers.append(np.array(us)[40:])
    rest, *pushed = answers
    S = np.fft.rfft(np.stack([(own - rest) / size for own in pushed], axis=2), axis=0)
    assert np.linalg.norm(S, 2, axis=(1, 2)).max() == pytest.approx(found.sensitivity[0], rel=2e-3)


def test_within_its_rows_the_law_is_affine_and_beyond_them_it_is_not():
    """Random memories: where the plan keeps its limits, command for command; where it does not, often another one."""
    controller, random = law(horizon=6, y_low=[4.0, 0.0], y_high=[6.0, 2.5]), np.random.default_rng(0)
    own, inside, differs = controller.affine(1.4), 0, 0
    state = controller.step(controller.init(np.array([0.3, -0.2])), np.array([5.0, 1.0]), np.array([5.0, 1.0]), 1.4)[1]
    x0 = controller.memory(state)
    for _ in range(400):
        x = x0 + random.uniform(0.05, 0.6) * random.normal(size=len(x0))
        seen = np.concatenate([[5.0, 1.0] + 0.3 * random.normal(size=2), [5.0, 1.0] + 0.3 * random.normal(size=2)])
        rows = own.W @ x + own.V @ seen + own.w
        nz = len(state.z)
        u, _ = controller.step(state._replace(z=x[:nz], u=x[nz:], slope=0.0), seen[:2], seen[2:], 1.4)
        expected = own.C @ x + own.D @ seen + own.o
        if np.all(rows >= own.low) and np.all(rows <= own.high):
            inside += 1
            np.testing.assert_allclose(u, expected, atol=1e-6)
        else:
            differs += np.abs(u - expected).max() > 1e-4
    assert inside > 40
    assert differs > 100


@pytest.mark.parametrize("horizon", [2, 5, 20])
@pytest.mark.parametrize("gain", [0.2, -0.2, 0.5])
def test_within_the_rows_of_a_tube_too(horizon, gain):
    """Its set-points are clipped by where errors that stay move the outputs in the end: commands were off by 2.8."""
    K = gain * tubes.C.T
    model = replace(tubes.still(), predictor=Predictor((tubes.A - K @ tubes.C)[None], tubes.B[None], K[None]))
    controller = design_mpc(
        model, tubes.fallback(), errors=tubes.errors(model, share=0.2), weights=tubes.WEIGHTS, horizon=horizon,
        low=[-30, -20], high=[30, 30], rate=[2000.0, 2000.0], y_low=[4.0, 0.0], y_high=[6.0, 2.0],
    )  # fmt: skip
    own, random, inside, differs = controller.affine(), np.random.default_rng(0), 0, 0
    state = controller.step(controller.init(tubes.U0), tubes.Y0, tubes.Y0, None)[1]
    x0, nz = controller.memory(state), len(state.z)
    for _ in range(400):
        x = x0 + 0.3 * random.uniform() * random.normal(size=len(x0))
        seen = np.concatenate([tubes.Y0 + 0.6 * random.normal(size=2), tubes.Y0 + 0.2 * random.normal(size=2)])
        rows = own.W @ x + own.V @ seen + own.w
        u, _ = controller.step(state._replace(z=x[:nz], u=x[nz:]), seen[:2], seen[2:], None)
        off = np.abs(u - own.C @ x - own.D @ seen - own.o).max()
        if np.all((own.low <= rows) & (rows <= own.high)):
            inside += 1
            assert off < 1e-6
        else:
            differs += off > 1e-3
    assert min(inside, differs) > 20


def lag():
    """y+ = 0.9 y + 0.1 u, and next to nothing that is open of it."""
    model = constant_model(
        "lag", 0.1, ((Channel("u", "V", "input"),), (Channel("y", "V", "output"),)), ([[0.9]], [[0.1]], [[1.0]], [[0.0]]),
        OperatingPoint(CONSTANT, [[0.0]], [[0.0]]),
        predictor=Predictor([[[0.7]]], [[[0.1]]], [[[0.2]]]), noise=np.array([[0.01]]),
    )  # fmt: skip
    sources = tuple(Channel(name, "V", "input") for name in "yu")
    box = Mode(ParameterBox(np.zeros(3), np.array([0.0, 1e-4, 0.0])), Box(-np.ones(2), np.ones(2)), (), 10, 0.1, 0.5)
    error = IntervalModel(
        "e", 0.1, sources, Channel("error of y", "V", "output"), None, FIR(1), Unrefuted(), 0.0, np.zeros(2), 1.0, (box,)
    )
    return Open(model, (error,), np.zeros((1, 3)))


@pytest.mark.parametrize("kind", ["pid", "mpc"])
def test_a_run_that_begins_beyond_a_limit_proves_nothing(kind):
    """Before the run a set-point is asked for that takes more than the law may command: it rests elsewhere than its linear form.

    Proved was y >= 4.5 of a PID that went to 2.6, and y >= 6.2 of an MPC that went to 5.2.
    """
    left, limited = lag(), {"low": (-10.0,), "high": (10.0,), "rate": (1e3,)}
    controller = replace(pid(("u",), ("y",), ("y_set",), 0.1, [1.0], [1.0], **limited), anti_windup=Clamping())
    if kind == "mpc":
        controller = design_mpc(left.model, controller, horizon=5, weights=Weights((1.0,), (3.0,), (0.0,)))
    random, proved = np.random.default_rng(4), {False: 0, True: 0}
    for number in range(16):
        before = random.uniform(11.0, 25.0) if number % 2 else random.uniform(3.0, 9.0)
        after, then = random.uniform(-6.0, 6.0, 2)
        r = np.where(np.arange(60) < 20, after, then)
        course = course_of(left.model, left.errors, controller, np.zeros(60), r[:, None], noise=False, initial=[[before, before]])
        reach = kernel(course)
        y, state, found = 0.0, controller.init(np.array([0.0])), []
        for k in range(-600, 60):
            found.append(y)
            u, state = controller.step(state, np.array([before if k < 0 else r[k]]), np.array([y]))
            y = 0.9 * y + 0.1 * u[0]
        itself = np.array(found[600:])
        limits = limits_of({
            "run": {"duration": 6.0, "setpoints": {"y": [[0.0, after], [2.0, then]]}, "initial": {"y": before}},
            "limits": {"y": {"low": reach.low[:, 0].min() - 0.01, "high": reach.high[:, 0].max() + 0.01}},
            "loop": {"stable": False},
        })  # fmt: skip
        for verdict in on_model(left, controller, limits).verdicts:
            inside = itself.min() >= reach.low[:, 0].min() - 0.02 and itself.max() <= reach.high[:, 0].max() + 0.02
            assert verdict.status is not Status.PROVED or inside, (before, after, then, str(verdict))
            proved[before > 10.0] += verdict.status is Status.PROVED
    assert proved[False] > 0
    assert proved[True] == 0


# ---- what is proved, against the law itself in plain loops ---------------------------------------------------------------------


def loop(seed):
    """A drawn machine, an MPC for its model, set-points and course; None for one that cannot be designed for."""
    random = np.random.default_rng([seed, 7])
    machine, (known, errors, _), _ = plain.drawn_predicted(random, False)
    machine.law.Ki = np.ones_like(machine.law.Ki)  # an MPC has integral action: at rest outputs are their set-points
    size = len(known.outputs)
    known = replace(known, noise=1e-2 * np.eye(size))
    inputs, outputs = (tuple(c.name for c in own) for own in (known.inputs, known.outputs))
    free = np.full(size, np.inf)
    fallback = pid(inputs, outputs, tuple(f"{y}_set" for y in outputs), plain.DT, np.zeros(size), np.full(size, 0.1))
    r = np.where(np.arange(plain.N)[:, None] < random.integers(2, 12, size), random.normal(size=size), random.normal(size=size))
    horizon = int(random.integers(4, 10))
    try:
        controller = design_mpc(known, fallback, horizon=horizon)
        middle = kernel(course_of(known, errors, controller, machine.rho, r, noise=True)).nominal.v
        acts = middle[:, size : 2 * size]
        reach = random.uniform(0.3, 1.5) * (np.ptp(acts, axis=0) + 0.1)
        limits = {"low": acts.min(axis=0) - reach, "high": acts.max(axis=0) + reach}
        y_low = np.where(random.uniform(size=size) < 0.5, middle[:, :size].min(axis=0) - random.uniform(0.2, 2.0), -free)
        return machine, known, errors, design_mpc(known, fallback, horizon=horizon, **limits, y_low=y_low), r, random
    except InputError:
        return None


def run(machine, controller, r, delta, before):
    """Outputs and commands (R N s) of the law itself, from the rest of every machine."""
    theta, start = machine.centre + delta * machine.radius, machine.centre + before * machine.radius
    states, y, u = machine.rested(start, np.repeat(r[:1], len(delta), axis=0))
    memories = [
        controller.step(controller.init(own), r[0], at, machine.rho[0])[1]._replace(slope=0.0)
        for own, at in zip(u, y, strict=True)
    ]
    found = []
    for k in range(plain.N):
        y = machine.output(states, theta[:, k], k)
        pairs = [controller.step(own, r[k], at, machine.rho[k]) for own, at in zip(memories, y, strict=True)]
        u, memories = np.array([own for own, _ in pairs]), [own for _, own in pairs]
        found.append(np.hstack([y, u]))
        states = machine.after(states, y, u, k)
    return np.stack(found, axis=1)


def attacked(seed) -> dict[str, int]:
    count = {"loops": 0, "proved": 0, "constant": 0, "ends": 0}
    made = loop(seed)
    if made is None:
        return count
    machine, known, errors, controller, r, random = made
    p, size = len(machine.centre), r.shape[1]
    own = course_of(known, errors, controller, machine.rho, r, noise=True)
    form = affine_of(controller, machine.rho[0])
    region = Region.of(form)
    still = random.choice([-1.0, 1.0], (12, p))
    delta = np.repeat(still[:, None], plain.N, axis=1)
    delta[:, :, machine.noise] = random.choice([-1.0, 1.0], (12, plain.N, int(machine.noise.sum())))
    moving = random.choice([-1.0, 1.0], (8, plain.N, p))
    v = run(machine, controller, r, np.concatenate([delta, moving]), np.concatenate([still, random.choice([-1.0, 1.0], (8, p))]))
    outer = kernel(own)
    inner = constant_kernel(own, outer)
    for i in range(2 * size):
        for side in (-1, 1):
            high = side * outer.nominal.v[:, i] + inner.half[:, i]
            if not np.isfinite(high).all():
                continue
            name = own.signals[i]
            limit = float(high.max()) + random.uniform(-0.05, 0.1)
            bound = plain.asked(name, side, limit)
            (kept,) = bounds_kept(own, [bound], region=region, of="", dt=plain.DT, possible=still, moving=False)
            attacks = v[:12] if kept.constant else v
            told = f"seed {seed}, {name}, side {side}: {kept.verdict}"
            if kept.verdict.status is Status.PROVED:
                count["proved"] += 1
                count["constant"] += kept.constant
                assert float((side * attacks[:, :, i]).max()) <= limit + 1e-5 * (1.0 + abs(limit)), told
            elif "may be at its stop" in kept.verdict.sentence:
                count["ends"] += 1
    count["loops"] = 1
    return count


def total(seeds):
    found = [attacked(seed) for seed in seeds]
    return {key: sum(one[key] for one in found) for key in found[0]}


def test_nothing_that_is_proved_is_broken_by_the_law_itself():
    found = total(range(8))
    assert found["loops"] >= 4
    assert found["proved"] > found["constant"] > 0


@pytest.mark.slow
def test_nothing_that_is_proved_of_60_laws_is_broken_by_the_laws_themselves():
    found = total(range(100, 160))
    assert found["loops"] >= 35
    assert found["constant"] > 20
    assert found["ends"] > 3


def test_limits_of_a_plan_end_the_proof_where_they_may_act():
    """The same loop with limits that its commands reach: UNDECIDED from there on, and never proved."""
    for seed in range(8):
        made = loop(seed)
        if made is None:
            continue
        machine, known, errors, controller, r, _ = made
        own = course_of(known, errors, controller, machine.rho, r, noise=True)
        u = kernel(own).nominal.v[:, r.shape[1] : 2 * r.shape[1]]
        if np.ptp(u[:, 0]) < 1e-3:
            continue
        tight = replace(controller, low=np.minimum(u.min(axis=0), u[0]) - 1e-6, high=u.max(axis=0) - 0.2 * np.ptp(u, axis=0))
        own = course_of(known, errors, tight, machine.rho, r, noise=True)
        form = affine_of(tight, machine.rho[0])
        region = Region.of(form)
        name = own.signals[0]
        bound = Bound(name, name, "", np.full(plain.N, -1e3), np.full(plain.N, 1e3))
        (kept,) = bounds_kept(own, [bound], region=region, of="", dt=plain.DT, possible=np.zeros((1, own.f.shape[1])))
        assert kept.verdict.status is Status.UNDECIDED
        assert "a command may be at its stop" in kept.verdict.sentence
        return
    raise AssertionError("no loop to try it on")
