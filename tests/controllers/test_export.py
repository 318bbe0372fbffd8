"""Exported controllers against the law: C by a compiler, Structured Text by a strict reader, tables as they are read."""

import csv
import json
import re
from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest
from scipy.interpolate import interpn

from controllers.cancelled import Compensation, Inverse
from controllers.code.c99 import c_code
from controllers.code.names import identifier
from controllers.code.structured_text import st_code
from controllers.code.text import WIDTH
from controllers.mpc import design_mpc
from controllers.pid import pid
from controllers.scheduled_pid import BackCalculation, Clamping, ScheduledPID
from controllers.tables import gain_csv, gain_table, mpc_matrices, with_csv
from plants import WEB_WINDING
from studies.experiments import plan
from tests.controllers.compiled import CompiledLaw
from tests.controllers.structured_text import FunctionBlock, STError
from tests.controllers.test_mpc import lpv
from workbench.basis import Gaussian, PiecewiseLinear, Powers, Products
from workbench.curves import Curve
from workbench.data import Channel
from workbench.errors import InputError
from workbench.files import write_json
from workbench.simulation import simulate

UNITS = {"V1": "V", "V2": "V", "w3": "rad/s", "theta": "deg", "r2": "m"}
FREE, AT_LOW, AT_HIGH, AT_RATE = range(4)
KNOTS = PiecewiseLinear((0.011, 0.0125, 0.0264))
VALVE = Curve("V1", [-3.0, -0.4, 0.3, 4.0], [-2.0, -0.1, 0.1, 5.0])
SQUARE = Curve("V3", [-4.0, -2.0, 2.5], [-3.0, -1.5, 2.0])
TWO = {"schedule": ("r2", "load"), "span": ((0.011, 0.0264), (-1.0, 1.7))}


def drawn(seed, nu, ny, basis=None, m=1, span=(0.011, 0.0264), **options) -> ScheduledPID:
    """A law in which no two numbers are equal: whatever is swapped, left out or transposed changes a command."""
    random = np.random.default_rng(seed)
    some = lambda *shape: random.normal(size=shape)  # noqa: E731
    scheduled = {} if basis is None else {"basis": basis, "schedule": "r2", "span": span}
    return ScheduledPID(
        ("V1", "V2", "V3")[:nu], ("w3", "theta", "T")[:ny], ("w3_set", "theta_set", "T_set")[:ny], 0.04, some(m, nu, ny),
        5.0 * some(m, nu, ny), 0.1 * some(m, nu, ny), some(m, nu, ny), some(m, nu), random.uniform(0.1, 0.9, ny),
        random.uniform(0.1, 0.9, ny),
        **({"low": random.uniform(-4.0, -3.0, nu), "high": random.uniform(3.0, 4.0, nu), "rate": random.uniform(8.0, 20.0, nu),
            "Tf": 0.07, "units": UNITS} | scheduled | options),
    )  # fmt: skip


RUB = Curve("V2", [-0.6, -0.1, 0.1, 0.5, 0.9], [-1.1, -0.7, 0.8, 1.0, 1.4])
STICK = Curve("V1", [-0.4, 0.2, 0.3], [0.9, -0.6, -0.2])
ADDED = (  # two effects, of position and motion both
    Compensation("V2", "coulomb@reel", [0.4, -0.3, 0.2], [0.11, 0.07, -0.05], RUB, "v [m/s]"),
    Compensation("V1", "stribeck@spindle */", [-0.2, 0.5, 0.35], [0.03, -0.08, 0.13], STICK),
)
STILL = (Compensation("V3", "outflow@tank", [0.4, -0.3, 0.2], [0.0, 0.0, 0.0], Curve("V3", [-0.6, 0.1, 0.5], [1.1, 0.2, 0.6])),)
FED = {
    "Ka": np.random.default_rng(41).normal(size=(3, 2, 3)),
    "Kaa": 0.1 * np.random.default_rng(42).normal(size=(3, 2, 3)),
    "slew": (0.7, np.inf, 2.0),
}
LAWS = {
    "2x3 over knots": drawn(1, 2, 3, KNOTS, 3),
    "span within the knots, clamping": drawn(2, 2, 3, KNOTS, 3, span=(0.0118, 0.02), anti_windup=Clamping()),
    "span beyond the knots": drawn(3, 3, 2, KNOTS, 3, span=(0.005, 0.03), anti_windup=BackCalculation(np.array([0.3, 0.9, 2.0]))),
    "two knots, 1x1, no filter": drawn(4, 1, 1, PiecewiseLinear((0.011, 0.0264)), 2, Tf=0.0),
    "one knot": drawn(5, 2, 2, PiecewiseLinear((0.02,)), 1),
    "powers": drawn(6, 2, 3, Powers((0.0, 1.0, -2.0, 0.5, 3.0), 0.018), 5),
    "constant": drawn(7, 1, 2, Powers((0.0,), 1.0), 1),
    "bells": drawn(8, 2, 2, Gaussian((0.012, 0.02), (2e4, 3e5)), 2),
    "shares of bells and a constant": drawn(9, 3, 2, Gaussian((0.012, 0.015, 0.026), (2e4, 3e5, 9e6), True, True), 4),
    "fixed 2x3, clamping, no filter": drawn(10, 2, 3, anti_windup=Clamping(), Tf=0.0),
    "fixed 1x1": drawn(11, 1, 1),
    "limits on one command only": drawn(12, 2, 2, low=(-np.inf, -3.0), high=(3.0, np.inf), rate=(np.inf, 10.0)),
    "grid of two": drawn(14, 2, 3, Products((KNOTS, PiecewiseLinear((-1.0, 2.0)))), 6, **TWO),
    "grid of three": drawn(
        15,
        1,
        2,
        Products((KNOTS, PiecewiseLinear((-1.0, 0.5, 2.0)), PiecewiseLinear((3.0,)))),
        9,
        Tf=0.0,
        schedule=("r2", "load", "speed"),
        span=((0.011, 0.0264), (-1.0, 1.5), (2.0, 4.0)),
    ),
    "some products, clamping": drawn(
        16,
        2,
        2,
        Products((Powers((0.0, 1.0, 2.0), 0.018), Gaussian((-0.5, 1.0), (0.7, 1.9), True, True)), [[2, 0], [0, 2], [1, 1]]),
        3,
        anti_windup=Clamping(),
        **TWO,
    ),
    "reference models over knots": drawn(
        17,
        2,
        3,
        KNOTS,
        3,
        slew=(0.7, np.inf, 2.0),
        bandwidth=(9.0, 40.0, 3.0),
        Ka=np.random.default_rng(17).normal(size=(3, 2, 3)),
    ),
    "slew alone, clamping": drawn(18, 1, 2, slew=(0.7, 1.1), anti_windup=Clamping()),
    "a reference model of a fixed law": drawn(19, 2, 2, bandwidth=(9.0, np.inf), Ka=[[[0.3, 0.0], [-0.2, 0.0]]]),
    "curves over knots": drawn(20, 3, 2, KNOTS, 3, curves=(SQUARE, VALVE)),
    "a curve, clamping, a reference model": drawn(21, 1, 2, anti_windup=Clamping(), curves=(VALVE,), bandwidth=(9.0, 4.0)),
    "accelerations over knots": drawn(22, 2, 3, KNOTS, 3, **FED, bandwidth=(9.0, 40.0, np.inf), compensations=ADDED),
    "paths of a fixed law, slewed": drawn(
        25, 2, 2, slew=(0.7, np.inf), Ka=[[[0.3, -0.1], [-0.2, 0.4]]], Kaa=[[[0.03, 0.01], [-0.02, 0.04]]]
    ),
    "compensation of what stands still, a curve": drawn(24, 3, 3, curves=(VALVE,), compensations=STILL, anti_windup=Clamping()),
    "awaited over knots": drawn(
        26,
        2,
        3,
        KNOTS,
        3,
        **FED,
        bandwidth=(9.0, 40.0, np.inf),
        compensations=ADDED,
        late=(0.1, 0.0, 0.213),
        play=(0.0, 0.3, 0.2),
    ),
    "late paths of a fixed law, inverses": drawn(
        27,
        2,
        2,
        slew=(0.7, np.inf),
        Ka=[[[0.3, -0.1], [-0.2, 0.4]]],
        late=(0.03, 0.08),
        inverses=(Inverse("V2", "dead-zone@V2", 0.4, 0.0, 0.05), Inverse("V1", "gear-backlash@V1", 0.0, 0.06, 0.1)),
    ),
    "inverse before a curve, clamping, play": drawn(
        28,
        3,
        2,
        KNOTS,
        3,
        curves=(SQUARE, VALVE),
        anti_windup=Clamping(),
        play=(0.2, 0.0),
        inverses=(Inverse("V1", "dead-zone@V1", 0.3, 0.05, 0.02),),
    ),
    "no limits": drawn(13, 2, 3, low=(-np.inf,) * 2, high=(np.inf,) * 2, rate=(np.inf,) * 2),
}


# ---- the same signals through the law and what was exported ----------------------------------------------------------------


def signals(law, seed, n=400):
    """Set-points, measurements and a schedule that drive a law to its limits and beyond its span."""
    random, ny = np.random.default_rng(seed), law.Kp.shape[2]
    slow = lambda size, width: width * np.cumsum(random.normal(size=(n, size)), axis=0) / 8.0  # noqa: E731
    r, y = slow(ny, 1.0) + 0.2 * random.normal(size=(n, ny)), slow(ny, 1.0) + 0.2 * random.normal(size=(n, ny))
    rho = 0.018 + 0.012 * np.sin(0.05 * np.arange(n)) + 0.002 * random.normal(size=n)
    if law.span.ndim == 1:
        return r, y, rho
    others = [
        np.mean(own)
        + 0.8 * np.ptp(own) * np.sin((0.05 + 0.013 * i) * np.arange(n) + i)
        + 0.1 * np.ptp(own) * random.normal(size=n)
        for i, own in enumerate(law.span[1:], 1)
    ]
    return r, y, np.column_stack([rho, *others])


def events(law, seed):
    """(sample, start): cold, taken over, a measurement and a schedule that are no numbers, and taken over again."""
    r, y, rho = signals(law, seed)
    held = np.random.default_rng(seed).uniform(-2.0, 2.0, (3, law.Kp.shape[1]))
    starts = {0: None, 120: held[0], 121: held[0], 240: held[1], 320: held[2], 360: None}
    y[230, -1] = y[240, 0] = np.nan  # the second where it takes over: it does so at the next sample
    r[250, 0] = np.inf
    rho.reshape(len(rho), -1)[310, -1] = np.nan
    y[360, 0] = -np.inf  # and where it starts cold
    return r, y, rho, starts


def by_the_law(law, r, y, rho, starts):
    """Commands (N, nu) and which limit set each, told from the same law without limits."""
    far = np.full(len(law.actuated), np.inf)
    by_rate = replace(law, low=-far, high=far)
    free, state, u, limits = replace(by_rate, rate=far), law.init(), [], []
    for k in range(len(r)):
        if k in starts:
            state = law.init(starts[k])
        at = (state, r[k], y[k], rho[k] if law.schedule else None)
        (v, _), (reached, _), (command, state) = free.step(*at), by_rate.step(*at), law.step(*at)
        limits.append(np.select([reached < law.low, reached > law.high, reached != v], [AT_LOW, AT_HIGH, AT_RATE], FREE))
        u.append(command)
    seen = np.isfinite(np.column_stack([r, y, rho if law.schedule else np.zeros(len(rho))])).all(axis=1)
    return np.array(u), np.where(seen[:, None], limits, FREE), seen


def by_c(law, r, y, rho, starts, source, **options):
    c, found = CompiledLaw(law, source, **options), []
    for k in range(len(r)):
        if k in starts:
            c.init(starts[k])
        found.append(c.step(r[k], y[k], rho[k]))
    return _columns(found)


def by_st(law, r, y, rho, starts, text=None):
    block, found = FunctionBlock(text or st_code(law, "law_1")), []
    for k in range(len(r)):
        held = starts.get(k)
        given = {"schedule": rho[k]} if law.schedule else {}
        out = block.call(
            set_point=r[k], measured=y[k], take_over=held is not None, held=np.zeros(len(law.actuated)) if held is None else held,
            restart=k in starts, **given,
        )  # fmt: skip
        found.append((out["command"], out["limited"], out.get("outside", False), out["valid"]))
    return _columns(found)


def _columns(found):
    u, limits, outside, valid = zip(*found, strict=True)
    return np.array(u), np.array(limits), np.array(outside), np.array(valid)


def in_c(law, folder, name="law_1", change=lambda text: text, *, single=False):
    """The law's source file, `change`d."""
    header, source = c_code(law, name, single=single)
    (folder / f"{name}.h").write_text(header)
    (folder / f"{name}.c").write_text(change(source))
    return folder / f"{name}.c"


def assert_same(law, rho, expected, got, tolerance):
    (u, limits, seen), (v, reported, outside, valid) = expected, got
    assert np.isfinite(u).all()
    np.testing.assert_allclose(v, u, rtol=0.0, atol=tolerance)
    np.testing.assert_array_equal(valid, seen)
    np.testing.assert_array_equal(reported, limits)
    inside = np.reshape((rho >= law.span[..., 0]) & (rho <= law.span[..., 1]), (len(rho), -1)).all(axis=1)
    np.testing.assert_array_equal(outside, ~inside if law.schedule else np.zeros(len(rho), dtype=bool))


@pytest.mark.slow
@pytest.mark.parametrize("key", LAWS)
def test_c_is_the_law(tmp_path, key):
    law = LAWS[key]
    for seed in range(3):
        given = events(law, seed)
        assert_same(law, given[2], by_the_law(law, *given), by_c(law, *given, in_c(law, tmp_path, f"law_{seed}")), 1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("key", LAWS)
def test_structured_text_is_the_law(key):
    law = LAWS[key]
    for seed in range(2):
        given = events(law, seed)
        assert_same(law, given[2], by_the_law(law, *given), by_st(law, *given), 1e-12)


def test_the_signals_try_everything():
    """Every limit sets commands of the laws above, the schedule is outside on both sides, and samples are left out."""
    given = events(LAWS["2x3 over knots"], 0)
    u, limits, seen = by_the_law(LAWS["2x3 over knots"], *given)
    assert (np.bincount(limits.ravel(), minlength=4) > 30).all()
    assert (np.nanmin(given[2]), np.nanmax(given[2])) < (0.009, 0.03)
    assert np.nanmax(given[2]) > 0.028
    assert np.flatnonzero(~seen).tolist() == [230, 240, 250, 310, 360]
    np.testing.assert_array_equal(u[[230, 250, 310]], u[[229, 249, 309]])  # held


MISTAKES = {
    "gains transposed": ("KP[i][j]", "KP[j % NU][i]"), "gains mixed up": ("KI[i][j]", "KD[i][j]"),
    "feedforward of the error": ("at(KR[i][j], phi) * r[j]", "at(KR[i][j], phi) * (r[j] - y[j])"),
    "no weight of the set-point": ("B[j] * r[j]", "r[j]"), "the other weight": ("C[j] * r[j]", "B[j] * r[j]"),
    "set-point for measurement": ("(r[j] - y[j])", "(y[j] - r[j])"), "wrong segment": ("rho >= KNOTS[k + 1]", "rho >= KNOTS[k]"),
    "no edge value": ("clipped(rho, SPAN[0], SPAN[1])", "rho"), "share turned round": ("phi[k] = 1 - share", "phi[k] = share"),
    "rate per sample": ("RATE[i] * PERIOD", "RATE[i]"), "rates at the first sample": ("s->cold && !s->takes_over ?", "false ?"),
    "derivative at the first sample": ("s->cold ? 0 : ", ""), "one tracking time for all": ("TRACKING[i]", "TRACKING[0]"),
    "one lower limit for all": ("clipped(reached, LOW[i]", "clipped(reached, LOW[1]"),
    "one upper limit for all": (", HIGH[i])", ", HIGH[0])"), "no derivative filter": ("DECAY * s->f[j] + ", ""),
    "a bump": ("s->z[i] = s->u[i] - own", "s->z[i] = 0"), "no anti-windup": (" + PERIOD / TRACKING[i] * (u[i] - v)", ""),
    "last command before its limits": ("s->u[i] = u[i];\n    }", "s->u[i] = v;\n    }"),
    "a lost sample is used": ("if (!s->valid) {", "if (false) {"),
    "a lost schedule is used": ("s->valid = isfinite(rho)", "s->valid = true"),
    "u0 left out": ("real own = at(U0[i], phi)", "real own = 0"), "integral without time": ("push += PERIOD * ", "push += "),
    "takes over for ever": ("s->cold = s->takes_over = false", "s->cold = false"),
    "never warm": ("s->cold = s->takes_over = false", "s->takes_over = false"),
}  # fmt: skip


OF_SEVERAL = {
    "variables exchanged": ("clipped(rho[0], SPAN[0][0]", "clipped(rho[1], SPAN[0][0]"),
    "the other span": ("SPAN[1][0], SPAN[1][1]), phi_2", "SPAN[0][0], SPAN[0][1]), phi_2"),
    "the other knots": ("rho - KNOTS_2[k]", "rho - KNOTS_1[k]"), "not multiplied": (" * phi_2[CHOSEN[k][1]]", ""),
    "chosen the other way": ("phi_1[CHOSEN[k][0]] * phi_2[CHOSEN[k][1]]", "phi_1[CHOSEN[k][1]] * phi_2[CHOSEN[k][0] % 2]"),
    "a lost schedule is used": ("isfinite(rho[0]) && isfinite(rho[1])", "isfinite(rho[0])"),
}  # fmt: skip


OF_A_REFERENCE_MODEL = {
    "slew per sample": ("SLEW[j] * PERIOD", "SLEW[j]"), "one slew for all": ("SLEW[j]", "SLEW[0]"),
    "the set-point itself": ("* s->s[j];", "* r[j];"), "one model for all": ("MODEL[j]", "MODEL[0]"),
    "the new m for the last": ("MODEL[j][3] * m", "MODEL[j][3] * s->m[j]"), "entries exchanged": ("MODEL[j][1]", "MODEL[j][2]"),
    "not from rest": ("s->cold ? y[j] : s->m[j]", "s->m[j]"), "slewed from nought": ("s->cold ? y[j] : s->s[j]", "s->s[j]"),
    "from the set-point": ("s->cold ? y[j] : s->m[j]", "s->cold ? r[j] : s->m[j]"),
    "no rate": ("own += at(KA[i][j], phi) * s->n[j];", ";"),
    "feedforward of r": ("at(KR[i][j], phi) * s->m[j]", "at(KR[i][j], phi) * r[j]"),
    "error from r": ("(s->m[j] - y[j])", "(r[j] - y[j])"), "weighted r": ("B[j] * s->m[j]", "B[j] * r[j]"),
    "derivative of r": ("C[j] * s->m[j]", "C[j] * r[j]"),
}  # fmt: skip
OF_FEEDFORWARD = {
    "no acceleration": ("own += at(KAA[i][j], phi) * acceleration[j];", ";"), "one change for all": ("CHANGE[j]", "CHANGE[0]"),
    "of the new rate": ("CHANGE[j][2] * n", "CHANGE[j][2] * s->n[j]"), "of the last m": ("(s->s[j] - s->m[j])", "(s->s[j] - m)"),
    "a path from y": ("AT_SETPOINT[j] * (r[j] - y[j])", "0 * (r[j] - y[j])"),
    "all from r": ("AT_SETPOINT[j] * (r[j]", "1 * (r[j]"), "at the other command": ("if (i == 1)", "if (i == 0)"),
    "no motion": ("MOTION_1[j] * s->n[j]", "0"), "no position": ("POSITION_2[j] * s->m[j]", "0"),
    "the other's motion": ("MOTION_2[j]", "MOTION_1[j]"), "the other's nodes": ("ADDED_2, POINTS_2", "ADDED_1, POINTS_2"),
    "of the set-point itself": ("POSITION_1[j] * s->m[j]", "POSITION_1[j] * r[j]"),
}  # fmt: skip
OF_LAWS = {
    "": (drawn(1, 2, 3, KNOTS, 3, span=(0.0118, 0.025)), MISTAKES),
    " of several": (LAWS["grid of two"], OF_SEVERAL),
    " of a reference model": (LAWS["reference models over knots"], OF_A_REFERENCE_MODEL),
    " of feedforward": (LAWS["accelerations over knots"], OF_FEEDFORWARD),
}


@pytest.mark.slow
@pytest.mark.parametrize(("mistake", "of"), [(key, of) for of, (_, mistakes) in OF_LAWS.items() for key in mistakes])
def test_a_mistake_would_be_seen(tmp_path, mistake, of):
    law, mistakes = OF_LAWS[of]
    right, wrong = mistakes[mistake]

    def change(text):
        assert right in text
        return text.replace(right, wrong)

    given = events(law, 0)
    expected = by_the_law(law, *given)
    assert_same(law, given[2], expected, by_c(law, *given, in_c(law, tmp_path)), 1e-12)
    v = by_c(law, *given, in_c(law, tmp_path, "wrong", change), strict=False)[0]
    assert np.nan_to_num(np.abs(v - expected[0]), nan=np.inf).max() > 1e-6


@pytest.fixture(scope="module")
def winding():
    """A scheduled law on the winding machine, and r, y, r2 of the staircase that it drove: 2250 samples with noise."""
    _, u0 = WEB_WINDING.equilibrium()
    Kr = np.array([[[2e-3, -1e-3], [4e-3, 3e-3]]] * 3) * [[[0.9]], [[1.0]], [[1.2]]]
    law = ScheduledPID(
        ("V2", "V1"), ("w3", "theta"), ("w3_set", "theta_set"), WEB_WINDING.dt,
        Kp=np.array([[[0.01, 0.001], [0.0005, -0.005]]] * 3) * [[[0.8]], [[1.0]], [[1.6]]],
        Ki=np.array([[[0.05, 0.002], [0.01, -0.02]]] * 3) * [[[1.3]], [[1.0]], [[0.9]]],
        Kd=np.array([[[1e-3, 1e-5], [2e-5, -1e-4]]] * 3),
        Kr=Kr, u0=np.outer([1.0, 1.03, 1.1], u0[::-1]) - Kr @ [100.0, 0.0], b=(0.9, 0.7), c=(0.1, 0.0),
        low=(-0.5, -0.4), high=(2.4, 1.7), rate=(1.2, 3.0), Tf=0.08, basis=PiecewiseLinear((0.0112, 0.0116, 0.0124)),
        schedule="r2", span=(0.0112, 0.0124), units=UNITS,
    )  # fmt: skip
    run = simulate(WEB_WINDING, law, plan("web-winding", "staircase").scenario(1), bumpless=True).experiment
    start = {0: u0[::-1]}
    return law, (run[["w3_set", "theta_set"]], run[["w3", "theta"]], run["r2"], start), run[["V2", "V1"]]


@pytest.mark.slow
def test_a_whole_record_of_the_winding_machine(winding, tmp_path):
    law, given, recorded = winding
    expected = by_the_law(law, *given)
    assert len(recorded) == 2250
    np.testing.assert_allclose(recorded, expected[0], atol=1e-12)  # the loop was closed by this law
    assert set(np.unique(expected[1])) == {FREE, AT_LOW, AT_HIGH, AT_RATE}
    assert law.outside(given[2]) > 0.0
    for got in (by_c(law, *given, in_c(law, tmp_path)), by_st(law, *given)):
        assert_same(law, given[2], expected, got, 1e-12)


@pytest.mark.slow
def test_single_precision_differs_by_what_the_documentation_says(winding, tmp_path):
    law, given, recorded = winding
    u, _, outside, valid = by_c(law, *given, in_c(law, tmp_path, single=True), single=True)
    assert 0.0 < np.abs(u - recorded).max() < 1e-5
    assert valid.all()
    assert outside.any()
    assert "double" not in "".join(c_code(law, "law_1", single=True))
    for key, other in LAWS.items():
        r, y, rho, starts = events(other, 0)
        starts = {k: u for k, u in starts.items() if k < 230}
        expected, *_ = by_the_law(other, r[:230], y[:230], rho[:230], starts)
        got = by_c(other, r, y, rho, starts, in_c(other, tmp_path, f"f{abs(hash(key))}", single=True), single=True)[0][:230]
        np.testing.assert_allclose(got, expected, atol=1e-4, err_msg=key)


@pytest.mark.slow
@pytest.mark.parametrize("shaping", [{"slew": 1.0}, {"bandwidth": 0.5}])
def test_in_single_precision_set_points_arrive(tmp_path, shaping):
    """In 1 ms a set-point of a hundred thousand moves by less than a float's last digit, for ever."""
    law = replace(pid(("u",), ("y",), ("r",), 1e-3, [0.0], [0.0], Kr=[[1.0]]), **shaping)
    compiled, at = CompiledLaw(law, in_c(law, tmp_path, single=True), single=True), 101325.0
    compiled.init()
    for k in range(20_000):
        u, *_ = compiled.step([at + 10.0 * (k > 0)], [at])
    assert u[0] == pytest.approx(at + 10.0, abs=0.02)


@pytest.mark.slow
def test_two_states_run_two_loops(tmp_path):
    law = LAWS["2x3 over knots"]
    source, given = in_c(law, tmp_path), [events(law, seed) for seed in (4, 5)]
    loops, commands = [CompiledLaw(law, source) for _ in given], ([], [])
    for k in range(100):
        for c, out, (r, y, rho, starts) in zip(loops, commands, given, strict=True):
            if k in starts:
                c.init(starts[k])
            out.append(c.step(r[k], y[k], rho[k])[0])
    for out, one in zip(commands, given, strict=True):
        np.testing.assert_allclose(out, by_the_law(law, *one)[0][:100], atol=1e-12)
    assert not re.search(r"^static (?!const |real clipped|real at|void weights)", source.read_text(), re.MULTILINE)


# ---- the texts -------------------------------------------------------------------------------------------------------------


def test_texts_are_reproducible_and_say_what_they_are():
    law = drawn(1, 2, 3, KNOTS, 3, units=UNITS)
    header, source = c_code(law, "web")
    assert (header, source) == c_code(replace(law), "web")
    for text in (header, source, st_code(law, "web")):
        assert "PID law 'scheduled-pid' by gain-scheduling-workbench 0." in text
        assert "V1 [V], V2 [V]" in text
    assert "/* V2 from theta [V/(deg)/s] */" in source
    assert "schedule : LREAL; (* rho: r2 [m] *)" in st_code(law, "web")
    assert max(map(len, source.splitlines())) <= WIDTH


@pytest.mark.slow
def test_no_name_or_unit_ends_a_comment(tmp_path):
    law = replace(
        drawn(1, 2, 3, KNOTS, 3), name="*/ (* evil *) °", units={"V1": "*/", "V2": "*)", "w3": "(*", "theta": "/*", "r2": "µm"}
    )
    given = events(law, 0)
    assert_same(law, given[2], by_the_law(law, *given), by_c(law, *given, in_c(law, tmp_path)), 1e-12)
    FunctionBlock(st_code(law, "law_1"))


def test_names():
    law = LAWS["fixed 1x1"]
    assert identifier(law) == "scheduled_pid"
    assert identifier(replace(law, name="2. Gang (neu)")) == "law_2_Gang_neu"
    assert identifier(replace(law, name="°")) == "law"
    assert identifier(law, "Web_PID2") == "Web_PID2"
    for bad in ("2web", "web-pid", "web__pid", "web_", "_web", "wéb", "a b", ""):
        with pytest.raises(InputError, match="no name in C and Structured Text"):
            identifier(law, bad)
    for bad in ("program", "LIMIT", "kp", "command"):
        with pytest.raises(InputError, match="a word of Structured Text or a variable of the block"):
            identifier(law, bad)


def test_single_precision_refuses_what_it_does_not_hold():
    with pytest.raises(InputError, match="KNOTS holds values that are one in single precision"):
        c_code(drawn(1, 1, 1, PiecewiseLinear((0.011, 0.0110000000001, 0.02)), 3), "x", single=True)
    with pytest.raises(InputError, match="KP holds numbers beyond single precision"):
        c_code(pid(("u",), ("y",), ("r",), 0.1, [[1e39]], [[1.0]]), "x", single=True)


RIGHT = """FUNCTION_BLOCK one VAR_INPUT x : LREAL; END_VAR VAR_OUTPUT y : LREAL; END_VAR VAR i : INT; END_VAR
VAR CONSTANT n : INT := 3; K : ARRAY[1..3] OF LREAL := [1.0, 2.0, 0.5]; END_VAR
y := 0.0; FOR i := 1 TO n DO y := y + K[i] * x; END_FOR; END_FUNCTION_BLOCK"""


def test_the_reader_of_structured_text_reads():
    assert FunctionBlock(RIGHT).call(x=2.0) == {"y": 7.0}


@pytest.mark.parametrize(
    ("right", "wrong"),
    [
        ("y := 0.0", "y := 0"), ("+ K[i] * x", "+ K[i] * i"), ("K[i]", "K[x]"), ("y := 0.0", "n := 1"), ("y := 0.0", "x := 0.0"),
        ("K[i]", "K[i, 1]"), ("K[i]", "K"), ("* x", "* z"), ("0.5]", "0.5, 1.0]"), ("2.0", "2"), ("END_FOR;", "END_FOR"),
        ("* x;", "* x; i := 1;"), ("i : INT", "i : LREAL"), ("i : INT", "i, Y : INT"), ("i : INT", "i : INT; Y : INT"),
        ("i : INT", "i : INT; spare : INT"), ("y := 0.0", "y := TRUE"), ("K[i] * x", "EXP(i)"), ("n : INT := 3", "n : INT"),
        ("n DO", "n / 2 DO"), ("y := 0.0", "y = 0.0"), ("i : INT", "dt : INT"), ("* x", "* (x > 1.0)"), ("* x", "* µ"),
    ],
)  # fmt: skip
def test_the_reader_of_structured_text_is_strict(right, wrong):
    assert right in RIGHT
    with pytest.raises(STError):
        FunctionBlock(RIGHT.replace(right, wrong, 1))


# ---- tables ----------------------------------------------------------------------------------------------------------------


def test_the_nodes_of_every_compensation_are_a_table_of_their_own(tmp_path):
    law = drawn(31, 2, 3, compensations=ADDED)
    assert {path.name for path in law.export("csv", tmp_path)} == {"gains.csv", "compensations.csv"}
    with open(tmp_path / "compensations.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    at = 0
    for own in law.compensations:
        for s, added in zip(own.curve.u, own.curve.v, strict=True):
            row, at = rows[at], at + 1
            weights = [[float(row[f"{part}_{name}"]) for name in law.measured] for part in ("position", "motion")]
            assert (row["command"], row["effect"], float(row["s"]), float(row["added"])) == (own.input, own.effect, s, added)
            np.testing.assert_array_equal(weights, [own.position, own.motion])
    assert at == len(rows)
    assert "compensations.csv" not in with_csv(law.uncompensated)


@pytest.mark.parametrize("key", [key for key, law in LAWS.items() if law.schedule])
def test_the_gain_tables_are_the_law_up_to_what_they_state(tmp_path, key):
    law = LAWS[key]
    content = json.loads(write_json(tmp_path / "gains.json", gain_table(law)).read_text())
    lines = [line.split(",") for line in gain_csv(law).splitlines()]
    ns = law.span.size // 2
    at = np.reshape([row["rho"] for row in content["rows"]], (-1, ns))
    numbers = np.array(lines[1:], dtype=float)
    first = content["schedule"][0] if ns > 1 else content["schedule"]
    assert (first, lines[0][0]) == ({"name": "r2", "unit": "m"}, "r2 [m]")
    np.testing.assert_array_equal(numbers[:, :ns], at)
    axes = [np.unique(own) for own in at.T]  # the rows are their lattice, the last variable fastest
    np.testing.assert_array_equal(at, np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, ns))
    found, span = dict.fromkeys((*law.gain_names, "u0"), 0.0), law.span.reshape(-1, 2)
    drawn_at = np.random.default_rng(1).uniform(
        span[:, 0] - 0.6 * np.ptp(span, axis=1), span[:, 1] + np.ptp(span, axis=1), (300, ns)
    )
    for rho in drawn_at:
        exact, column = law.gains_at(rho if ns > 1 else rho[0]), ns
        for name, value in ((name, getattr(exact, name)) for name in found):
            rows = np.array([row[name] for row in content["rows"]])
            lattice = rows.reshape(*map(len, axes), value.size)
            read = interpn(axes, lattice, np.clip(rho, [own[0] for own in axes], [own[-1] for own in axes]))[0]
            np.testing.assert_allclose(numbers[:, column : column + value.size], rows.reshape(len(at), -1), rtol=0, atol=0)
            found[name] = max(found[name], np.abs(read - value.ravel()).max())
            column += value.size
    for name, stated in content["largest_difference"].items():
        assert found[name] <= 1.02 * stated + 1e-12
        if isinstance(law.basis, PiecewiseLinear) or key == "constant" or key.startswith("grid"):
            assert stated < 1e-12


def test_the_gain_table_of_a_fixed_law_has_one_row():
    content = gain_table(LAWS["fixed 2x3, clamping, no filter"])
    assert (content["schedule"], len(content["rows"]), "rho" in content["rows"][0]) == (None, 1, False)
    assert content["anti_windup"] == {"kind": "clamping"}
    assert content["references"][0] == {"name": "w3_set", "unit": "rad/s"}


def far(values, none):
    return np.array([none if v is None else v for v in values], dtype=float)


class FromMatrices:
    """The MPC once more, from nothing but the exported numbers and the equations that stand beside them."""

    def __init__(self, content, z, last):
        self.c, self.z, self.last, self.rho, self.slope = content, z, last, None, 0.0

    def at(self, key, rho):
        grid, rows = [row["rho"] for row in self.c["rows"]], np.array([row[key] for row in self.c["rows"]])
        flat = [np.interp(rho, grid, column) for column in rows.reshape(len(grid), -1).T]
        assert list(rows.shape[1:]) == self.c["shapes"][key]
        return np.reshape(flat, rows.shape[1:])

    def step(self, r, y, rho):
        c, N = self.c, self.c["horizon"]
        if self.rho is not None:
            self.slope += (rho - self.rho - self.slope) / c["memory"]
        self.rho, path = rho, rho + self.slope * np.arange(N + 1)
        A, B, C, u0, y0 = ([self.at(key, p) for p in path] for key in ("A", "B", "C", "u0", "y0"))
        nx, nu, q = len(A[0]), len(u0[0]), np.array(c["weights"]["outputs"])
        Bd, Cd = (np.eye(nu), 0.0) if c["disturbances"] == "inputs" else (0.0 * np.eye(nu), 1.0)
        e = y - (C[0] @ self.z[:nx] + y0[0] + Cd * self.z[nx:])
        z = self.z + self.at("L", rho) @ e
        xt, ut = cp.Variable(nx), cp.Variable(nu)
        low, high, way = far(c["low"], -np.inf), far(c["high"], np.inf), far(c["rate"], 1e9) * c["dt"]
        soft = far(c["y_low"], -1e6), far(c["y_high"], 1e6)
        yt, wanted = C[N] @ xt + y0[N] + Cd * z[nx:], np.clip(r, *soft)
        rest = [xt == A[N] @ xt + B[N] @ (ut - u0[N] + Bd @ z[nx:]), ut >= low, ut <= high]
        inputs = np.diag(c["weights"]["inputs"])
        cost = cp.sum(cp.multiply(q, cp.square(yt - wanted))) + cp.quad_form(ut - self.last, inputs)
        cp.Problem(cp.Minimize(cost), rest).solve(solver=cp.CLARABEL)
        xt, ut, yt = xt.value, ut.value, yt.value
        x, u, s = cp.Variable((N + 1, nx)), cp.Variable((N, nu)), cp.Variable(len(y), nonneg=True)
        cost, limits, before = 0.0, [x[0] == z[:nx]], self.last
        for i in range(N):
            if i:
                cost += cp.sum(cp.multiply(q, cp.square(C[i] @ x[i] + y0[i] + Cd * z[nx:] - yt)))
            cost += cp.sum(cp.multiply(c["weights"]["moves"], cp.square(u[i] - before))) + cp.quad_form(u[i] - ut, inputs)
            after = C[i + 1] @ x[i + 1] + y0[i + 1] + Cd * z[nx:]
            limits += [x[i + 1] == A[i] @ x[i] + B[i] @ (u[i] - u0[i] + Bd @ z[nx:]), cp.abs(u[i] - before) <= way]
            limits += [u[i] >= low, u[i] <= high, after - s <= soft[1], after + s >= soft[0]]
            before = u[i]
        root = np.linalg.cholesky(self.at("P", path[-1]) + 1e-12 * np.eye(nx + nu))
        cost += cp.sum_squares(root.T @ cp.hstack([x[N] - xt, u[N - 1] - ut]))
        price = c["weights"]["violation"] * (np.sqrt(q) @ s + 0.5 * cp.sum(cp.multiply(q, cp.square(s))))
        cp.Problem(cp.Minimize(0.5 * cost + price), limits).solve(solver=cp.CLARABEL)
        self.last = u.value[0]
        moved = A[0] @ z[:nx] + B[0] @ (self.last - u0[0] + Bd @ z[nx:])
        self.z = np.concatenate([moved, z[nx:]]) + self.at("J", rho) @ e
        return self.last


def mpc(model, **options):
    fallback = pid(
        ("a", "b"), ("c", "d"), ("c_set", "d_set"), 0.1, [0.1, 0.1], [0.2, 0.2], low=-0.5, high=(0.6, np.inf), rate=8.0
    )
    return design_mpc(model, fallback, horizon=6, **options)


@pytest.mark.slow
def test_another_program_computes_the_commands_from_the_matrices(tmp_path):
    model = replace(lpv(), outputs=(Channel("c", "rad/s", "output"), Channel("d", "deg", "output")))
    law = mpc(model, y_high=np.array([6.0, np.inf]))
    content = json.loads(write_json(tmp_path / "matrices.json", mpc_matrices(law)).read_text())
    assert max(content["largest_difference"].values()) < 1e-12  # knots and grids of gains coincide here
    assert len(content["rows"]) == 11
    assert content["high"] == [0.6, None]
    assert content["outputs"] == [{"name": "c", "unit": "rad/s"}, {"name": "d", "unit": "deg"}]
    state, random, active = law.init(np.array([0.2, -0.1])), np.random.default_rng(1), 0
    y, rho = np.array([5.2, 0.8]), 1.2
    _, state = law.step(state, np.array([5.0, 1.0]), y, rho)
    other = FromMatrices(content, state.z, state.u)
    other.rho, other.slope = state.rho, state.slope
    for k in range(10):
        r, y, rho = np.array([5.0 + 6.0 * (k > 3), 1.0 - 2.0 * (k > 6)]), y + 0.3 * random.normal(size=2), rho + 0.03
        expected, state = law.step(state, r, y, rho)
        np.testing.assert_allclose(other.step(r, y, rho), expected, atol=2e-5)
        np.testing.assert_allclose(other.z, state.z, atol=2e-5)
        active += bool(np.isclose(expected, law.low).any() or np.isclose(expected, law.high).any())
    assert active


def test_the_matrices_state_what_lies_between_their_rows():
    """Where the model is a polynomial of the schedule; and one row where there is no schedule."""
    model = lpv()
    curved = replace(model, basis=Powers((-2.0, 1.0)))
    content = mpc_matrices(mpc(curved))
    grid, A = np.array([row["rho"] for row in content["rows"]]), np.array([row["A"] for row in content["rows"]])
    worst = max(
        np.abs([np.interp(rho, grid, A[:, i, j]) - curved.freeze(rho)[0][i, j] for i in range(3) for j in range(3)]).max()
        for rho in np.random.default_rng(2).uniform(1.0, 2.0, 200)
    )
    assert 0.9 * content["largest_difference"]["A"] < worst <= 1.001 * content["largest_difference"]["A"]
    assert len(grid) == 21
    first = {key: getattr(model, key)[:1] for key in ("terms", "A", "B", "C", "D")}
    predictor = replace(model.predictor, **{key: getattr(model.predictor, key)[:1] for key in "FGK"})
    still = replace(model, schedules=(), spans=np.zeros((0, 2)), basis=Powers(), predictor=predictor, **first)
    (row,) = mpc_matrices(mpc(still))["rows"]
    assert "rho" not in row
    np.testing.assert_array_equal(row["B"], model.B[0])
