"""The loop of a law and an LPV model whose errors are bounded: the predictor written out sample by sample, and its course."""

from dataclasses import replace

import numpy as np
import pytest

from controllers.pid import pid
from tests.workbench.robustness.loops import DT
from workbench.basis import Powers
from workbench.data import Channel, Dataset, Experiment
from workbench.errors import InputError
from workbench.intervals.errors import ErrorRegression, one_step_errors
from workbench.lpv import LPVModel, OperatingPoint, Predictor, Term
from workbench.robustness.envelopes.course import nominal, replay
from workbench.robustness.loop import close, course, driven
from workbench.robustness.machine import machine_with_errors, machines_along

N = 80
TERMS = (Term(0), Term(1), Term(1, 2))


def lpv(seed=0) -> LPVModel:
    """Two outputs, three inputs, of which the law commands two, a term with a delay, an operating point that moves."""
    random = np.random.default_rng(seed)
    basis = Powers((0.0, 1.0))
    nt, nx, nu, ny = 3, 4, 3, 2
    size = np.array([1.0, 0.2, 0.1])[:, None, None]
    F = 0.3 * size * random.normal(size=(nt, nx, nx))
    G, K, C = (size * random.normal(size=(nt, *shape)) for shape in ((nx, nu), (nx, ny), (ny, nx)))
    K = 0.1 * K
    point = OperatingPoint(basis, random.normal(size=(2, nu)), random.normal(size=(2, ny)))
    A = F  # what a simulation would use plays no part here
    return LPVModel(
        "drawn", DT, tuple(Channel(n, "V", "input") for n in ("u1", "u2", "u3")),
        tuple(Channel(n, "m", "output") for n in ("y1", "y2")), (Channel("rho", "m", "schedule"),), [[0.0, 1.0]], basis, TERMS,
        A, G, C, np.zeros((nt, ny, nu)), point, Predictor(F, G, K, 5),
    )  # fmt: skip


def record_of(model, seed):
    random = np.random.default_rng(seed)
    values = np.column_stack([random.normal(size=(N, 5)), np.linspace(0.1, 0.9, N)])
    channels = (*model.inputs, *model.outputs, model.schedule)
    return Experiment(f"r{seed}", DT * np.arange(N), channels, values, DT)


@pytest.fixture(scope="module")
def known():
    model = lpv()
    return model, ErrorRegression(lags=2).fit(model, Dataset((record_of(model, 1),)))


def a_law(schedule=True):
    """A law of both outputs, in another order, that commands u3 and u1 and has an offset."""
    Kp, Ki = np.array([[0.1, 0.2], [0.2, -0.1]]), np.array([[0.1, 0.05], [0.05, -0.1]])
    return pid(("u3", "u1"), ("y2", "y1"), ("r2", "r1"), DT, Kp, Ki, 0.02 * Kp, Tf=0.15, b=0.6, c=0.4, u0=[0.3, -0.2])


def written_out(model, errors, law, delta, rho, references, x, memory, held):
    """y, u and z of the predictor x+ = F x + G (u - u0) + K (y - y0), y = C x + y0 + e, e = theta'z, sample by sample.

    held: past deviations (y, u) by lag. Nothing here is a matrix of a loop.
    """
    weight, phi = model.weights(rho), model.operating_point.basis(rho)
    (dy, du), out, seen = held, [], []
    for k in range(len(rho)):
        F, G, K, C = (np.tensordot(weight[k], M, 1) for M in (model.predictor.F, model.predictor.G, model.predictor.K, model.C))
        y0, u0 = phi[k] @ model.operating_point.y, phi[k] @ model.operating_point.u
        psi = np.concatenate([*(np.array([dy[lag][j] for lag in (0, 1)]) for j in range(2)),
                              *(np.array([du[lag][i] for lag in (0, 1)]) for i in range(3)), [1.0]])  # fmt: skip
        boxes = [own.modes[0].box for own in errors]
        e = np.array([(box.centre + d[k] * box.radius) @ psi for box, d in zip(boxes, delta, strict=True)])
        y = C @ x + y0 + e
        command, memory = law.step(memory, references[k], y[[1, 0]], None)
        u = np.array([command[1], u0[1], command[0]])
        x = F @ x + G @ (u - u0) + K @ (y - y0)
        dy, du = [y - y0, dy[0]], [u - u0, du[0]]
        out.append([y[1], y[0], *command])
        seen.append(psi)
    return np.array(out), np.array(seen)


def test_a_moving_schedule_with_moving_parameters_is_the_predictor_written_out(known):
    """Every output and command of a run under random parameters; the course starts at rest, and so does the run."""
    model, errors = known
    law, random = a_law(), np.random.default_rng(3)
    rho = 0.5 + 0.4 * np.sin(0.2 * np.arange(N))
    rho[:3] = 0.5  # at rest before it moves
    references = np.column_stack([np.where(np.arange(N) > 20, 1.0, 0.2), np.where(np.arange(N) > 40, -0.5, 0.1)])
    own = course([driven(machine, law, None) for machine in machines_along(model, errors, rho)], references)
    delta = [random.uniform(-1, 1, (N, 11)) for _ in errors]
    run = nominal(own)
    # the start: the same rest, read off the course's own first outputs and commands
    y0, u0 = (model.operating_point.basis(rho[:1]) @ part for part in (model.operating_point.y, model.operating_point.u))
    v = run.v[0]
    y, u = np.array([v[1], v[0]]) - y0[0], np.array([v[3], u0[0][1], v[2]]) - u0[0]
    memory = law.init(v[2:])
    state = own.start[-6:]  # integrals, filtered derivatives, last weighted errors
    memory[:6], memory[-2:] = state, 0.0
    found, _ = written_out(model, errors, law, delta, rho, references, own.start[:4], memory, ([y, y], [u, u]))
    names = [f"{m.output.name}: {n}" for m in errors for n in m.form.names]
    assert len(names) == own.lam.shape[1]
    np.testing.assert_allclose(replay(own, np.hstack(delta)[None])[0], found, atol=1e-9)
    np.testing.assert_allclose(run.v[:3], np.repeat(run.v[:1], 3, axis=0), atol=1e-9)  # nothing moves yet


def test_the_frozen_loop_is_the_course_without_what_drives_it(known):
    model, errors = known
    law = a_law()
    loop = driven(machine_with_errors(model, errors, 0.3), law).undriven(still=True)
    assert not [name for name in loop.parameters if name.endswith(": 1")]  # a constant turns no pole
    machine = machine_with_errors(model, errors, 0.3)
    np.testing.assert_allclose(machine.A, next(machines_along(model, errors, np.array([0.3]))).A)
    u2 = 2  # samples of an input that nobody commands: nothing moves them
    assert loop.A.shape == (4 + 2 * 2 + 3 * 2 - u2 + 6,) * 2
    behind = replace(law, bandwidth=(3.0, 8.0), Ka=[[[0.1, 0.0], [0.2, -0.1]]])
    whole = driven(machine_with_errors(model, errors, 0.3), behind)
    assert len(whole.A) == len(loop.A) + u2 + 4
    assert len(whole.undriven().A) == len(whole.A)
    own = whole.undriven(still=True)  # reference models turn no pole either
    for key in ("A", "B", "C", "lam", "channel"):
        np.testing.assert_array_equal(getattr(own, key), getattr(loop, key))
    assert own.parameters == loop.parameters


def test_the_middle_of_the_boxes_corrects_the_model(known):
    """With every delta 0 the loop's output follows C x + centre'z: a model with these centres put to 0 is another loop."""
    model, errors = known
    assert any(np.abs(own.modes[0].box.centre).max() > 1e-3 for own in errors)
    C = machine_with_errors(model, errors, 0.5).C
    assert np.abs(C[:, model.order :]).max() > 1e-3


def test_what_does_not_belong_together_is_refused(known):
    model, errors = known
    with pytest.raises(InputError, match="errors of this model: error of y1, error of y2"):
        machine_with_errors(model, errors[:1], 0.5)
    with pytest.raises(InputError, match="the model knows rho"):
        machine_with_errors(model, errors, 1.5)
    with pytest.raises(InputError, match="no interval model of y2"):
        close(errors, a_law(), 0.5)
    assert one_step_errors(model, record_of(model, 2)).names[-1] == "error of y2"


def test_a_response_is_that_of_the_run_with_constant_parameters(known):
    """The machine at constant delta, driven by one input sample by sample, against its response at one frequency."""
    model, errors = known
    machine, random = machine_with_errors(model, errors, 0.4), np.random.default_rng(1)
    delta = 0.02 * random.uniform(-1.0, 1.0, len(machine.lam))  # so that it is stable by itself
    omega, n = 3.0, 4000
    u, s, y = np.cos(omega * DT * np.arange(n)), np.zeros(len(machine.A)), np.empty((n, 2))
    per_output = np.eye(2)[:, machine.channel.astype(int)]
    for k in range(n):
        w = per_output @ (delta * machine.lam * (machine.T @ s))
        y[k] = machine.C @ s + w
        s = machine.A @ s + machine.Bu[:, 2] * u[k] + machine.By @ y[k]
    late = slice(n // 2, None)
    turned = np.exp(1j * omega * DT * np.arange(n))[late]
    found = machine.at(delta, ["u3"], ["y2", "y1"]).at(np.array([omega]))[0, :, 0]
    np.testing.assert_allclose(np.real(np.outer(turned, found)), y[late][:, ::-1], atol=1e-6)
