"""Interval models and laws for the tests of robustness, and the machine that they stand for, sample by sample."""

import numpy as np
from scipy.signal import cont2discrete

from controllers.pid import pid
from controllers.scheduled_pid import ScheduledPID
from plants import WELDING_ROBOT
from workbench.data import Channel
from workbench.intervals.domains.shapes import Box
from workbench.intervals.model import IntervalModel, Mode
from workbench.intervals.regressors import ARX
from workbench.intervals.semantics import InclusionAll, ParameterBox
from workbench.robustness.envelopes.course import Course
from workbench.robustness.loop import close
from workbench.robustness.uncertain import UncertainLoop

DT = 0.1


def model(output, inputs, structure, centre, radius, schedule=None) -> IntervalModel:
    """One mode over everything, or one for each third of the schedule from 0 to 3."""
    centre, radius = np.atleast_2d(centre), np.atleast_2d(radius)
    domains = [Box((float(i),), (i + 1.0,)) for i in range(len(centre))]
    modes = tuple(
        Mode(ParameterBox(c, r), domain, (), 100, 0.1, 0.9) for c, r, domain in zip(centre, radius, domains, strict=True)
    )
    return IntervalModel(
        output, DT, tuple(Channel(name, "V", "input") for name in inputs), Channel(output, "", "output"),
        Channel(schedule, "m", "schedule") if schedule else None, structure, InclusionAll(), 0.0, np.zeros(len(inputs)), 1.0,
        modes,
    )  # fmt: skip


def two_regressions(share=0.1):
    """Two stable outputs of two inputs with coupling, in delta and in shift form, with a bias, of orders 2 and 3; and a law."""
    first, second = ARX(order=2), ARX(order=3, delta=False, delay=2)
    one = np.array([0.5, 0.08, 0.02, 0.05, 0.01, -0.03, 0.3])
    two = np.array([-0.9, 0.2, 0.02, 0.03, 0.02, 0.15, 0.04, -0.2])
    models = (
        model("y1", ("u1", "u2"), first, one, share * np.abs(one)),
        model("y2", ("u2", "u1"), second, two, share * np.abs(two)),  # inputs in another order
    )
    return models, law()


def law(**options) -> ScheduledPID:
    """A law of two outputs with all of its parts, in another order than the models."""
    Kp, Ki = np.array([[0.2, 0.4], [0.6, -0.1]]), np.array([[0.1, 0.3], [0.4, -0.2]])
    Kd = np.array([[0.02, 0.03], [0.05, 0.0]])
    return pid(("u1", "u2"), ("y2", "y1"), ("r2", "r1"), DT, Kp, Ki, Kd, Tf=0.15, b=0.5, c=0.3, **options)


def machine_run(models, law, delta, start, rho=None):
    """y (N, ny), z by model, of the equations as they are written in `intervals.model`, biases left out.

    delta: by output name (N, p); start: by output name the past outputs, newest first. Nothing here is a matrix of a loop.
    """
    by_name = {m.output.name: m for m in models}
    N = len(next(iter(delta.values())))
    y = {name: list(reversed(values)) for name, values in start.items()}  # oldest first, like a record
    before = {name: len(values) for name, values in y.items()}
    u = {name: [0.0] * 10 for name in law.actuated}
    state, seen = law.init(np.zeros(len(law.actuated))), {name: [] for name in by_name}
    state[-2:] = 0.0  # neither cold nor taking over: the memory of a law at rest
    for k in range(N):
        for name, m in by_name.items():
            form, mode = m.form, m.modes[0 if rho is None else int(rho)]
            psi = np.zeros(len(form.source))
            for i, (source, lag) in enumerate(zip(form.source.astype(int), form.lags.astype(int), strict=True)):
                if source == 0:
                    psi[i] = y[name][before[name] + k - lag]
                elif source > 0:
                    psi[i] = u[m.inputs[source - 1].name][10 + k - lag]
            z = form.T @ psi
            theta = mode.box.centre + delta[name][k] * mode.box.radius
            y[name].append(form.d @ psi + theta @ z)
            seen[name].append(z)
        command, state = law.step(state, np.zeros(len(law.references)), np.array([y[name][-1] for name in law.measured]), rho)
        for name, value in zip(law.actuated, command, strict=True):
            u[name].append(value)
    return {name: np.array(values)[before[name] :] for name, values in y.items()}, {n: np.array(v) for n, v in seen.items()}


def lagged_machine(share, gains=(10.0, 8.0, 0.5)):
    """(s + 2.3)/(s^2 + 6.6 s + 1.67)/(0.08 s + 1) in delta form, every coefficient `share` wide, under P, I, D with a filter."""
    b, a, _ = cont2discrete(([1.0, 2.3], np.polymul([1.0, 6.6, 1.67], [0.08, 1.0])), DT)
    form = ARX(order=3, bias=False).form("y", ["u"])
    past = zip(form.source.astype(int), form.lags.astype(int), strict=True)
    row = np.array([-a[lag] if source == 0 else np.ravel(b)[lag] for source, lag in past])
    theta = np.linalg.solve(form.T.T, row - form.d)
    own = model("y", ("u",), ARX(order=3, bias=False), theta, share * np.abs(theta))
    P, I, D = ([one] for one in gains)  # noqa: E741
    return own, pid(("u",), ("y",), ("r",), DT, P, I, D, Tf=0.1)


def steps(N, period=150):
    """A set-point that jumps between levels of both signs."""
    half, level = np.arange(N) // period, np.arange(N) // (2 * period) % 3
    return np.where(half % 2 == 0, 1.0, -1.0) * (0.5 + 0.25 * level)


def lagged_course(share, gains=(10.0, 8.0, 0.5), N=2250) -> Course:
    """The loop of `lagged_machine` from rest along `steps`; y and u are watched."""
    own, one = lagged_machine(share, gains)
    loop, system = close([own], one), one.at(None)
    drive = np.zeros(len(loop.A))
    drive[3], drive[6:] = np.asarray(system.D)[0, 0], np.asarray(system.B)[:, 0]
    drive[4] = drive[3]  # the change from the command before is as much larger
    into = loop.balance()
    moved, back, r = loop.moved(into), np.linalg.inv(into), steps(N)
    seen = [0, 3]  # the newest y and u after the step
    return Course(
        moved.A[None], moved.B[None], moved.C[None], (loop.A[seen] @ back)[None], loop.B[seen][None], loop.lam[None],
        loop.channel, np.zeros(N), np.outer(r, into @ drive), np.outer(r, drive[seen]), np.zeros((N, len(loop.lam))),
        np.zeros(len(loop.A)), ("y", "u"),
    )  # fmt: skip


def robot(nodes):
    """at(mass) of the welding robot under a scheduled PID law, linear between the nodes: 9 states, 6 parameters of 10 %.

    The platform's mass m is the schedule, the arm assembly stays as it is. From the two equations of the plant

        v1 / u = (m2 s + c + b2) / ((m s + b1 + c) (m2 s + c + b2) - c^2),

    seen through a filter 1 / (0.08 s + 1), sampled at 0.1 s. The centres of its delta form are those of the machine at the nodes
    and linear between, and so are the radii; the gains grow with the mass, which keeps the loop gain where the mass decides it.
    """
    value = {parameter.name: parameter.value for parameter in WELDING_ROBOT.parameters}
    form = ARX(order=3, bias=False)
    T, d = form.form("v", ["u"]).T, form.form("v", ["u"]).d

    def centre(mass):
        arm = np.array([value["m2"], value["c"] + value["b2"]])
        bottom = np.polysub(np.polymul([mass, value["b1"] + value["c"]], arm), [value["c"] ** 2])
        b, a, _ = cont2discrete((arm, np.polymul(bottom, [0.08, 1.0])), DT)
        return np.linalg.solve(T.T, np.concatenate([-a[1:], b.ravel()[1:]]) - d)

    centres = np.array([centre(mass) for mass in nodes])

    def at(mass) -> UncertainLoop:
        own = np.array([np.interp(mass, nodes, column) for column in centres.T])
        kind = pid(("u",), ("v",), ("r",), DT, [10.0 * mass], [8.0 * mass], [0.5 * mass], Tf=0.1)
        return close([model("v", ("u",), form, own, 0.1 * np.abs(own))], kind)

    return at
