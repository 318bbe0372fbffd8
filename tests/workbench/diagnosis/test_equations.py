"""A law that the plant's own equation lacks, against a static error of a sensor: told apart where the records can, and said to be
possible where they cannot. The vessel is written a second time, and runs on Runge and Kutta's steps.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.workbench.diagnosis.cases import AXIS, axis_by_hand, axis_records, fitted, refitted, steps
from tests.workbench.diagnosis.test_pushes import ROD
from workbench import Parameter, Plant, Start
from workbench.data import Channel, Dataset, Experiment
from workbench.diagnosis import causes, equations
from workbench.diagnosis.answer import Finding
from workbench.diagnosis.diagnosis import diagnose
from workbench.diagnosis.equations import Law, instead
from workbench.diagnosis.policy import TIE
from workbench.diagnosis.predictor import Point, predictor
from workbench.diagnosis.remainder import answers, trajectory, variables

DT, AREA, DRAIN, FEED, READING = 0.5, 2.0, 0.05, 0.08, 4e-3
OPEN = {"A": 0.1, "k": 0.3, "z": 0.9}  # what a careless data sheet leaves open

VESSEL = Plant(
    name="vessel",
    states=(Channel("h", "m"),),
    inputs=(Channel("u", "%", "input"),),
    outputs=(Channel("level", "m", "output"),),
    parameters=(
        Parameter("A", AREA, "m^2", tolerance=0.05),
        Parameter("k", FEED, "m^3/s", tolerance=0.1),
        Parameter("z", DRAIN, "m^2/s", tolerance=0.2),
    ),
    equation=lambda x, u, p, at: {"h": (p.k * u.u - p.z * x.h) / p.A},
    measure=lambda x, p: {"level": x.h},
    dt=DT,
    noise={"level": READING},
)


def left_open(tolerances):
    """The vessel with other tolerances."""
    return replace(VESSEL, parameters=tuple(replace(q, tolerance=tolerances.get(q.name, q.tolerance)) for q in VESSEL.parameters))


def record(seed: int, hold: float, *, fouled=0.0, bent=0.0, samples=1500, reading=READING) -> Experiment:
    """Levels of the feed that last `hold` seconds each; fouled: the drain's share per metre; bent: curvature of the reading."""
    random = np.random.default_rng(seed)
    u = np.repeat(random.uniform(0.1, 1.0, samples), round(hold / DT))[:samples]

    def rate(h, feed):
        return (FEED * feed - DRAIN * h * (1.0 + fouled * h)) / AREA

    h, level = 0.8, []
    for feed in u:
        level.append(h + bent * h**2 + reading * random.standard_normal())
        k1 = rate(h, feed)
        k2 = rate(h + 0.5 * DT * k1, feed)
        k3 = rate(h + 0.5 * DT * k2, feed)
        h += DT / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + rate(h + DT * k3, feed)) + 1e-4 * random.standard_normal()
    channels = (Channel("u", "%", "input"), Channel("level", "m", "output"))
    return Experiment(f"vessel {seed}", DT * np.arange(samples), channels, np.column_stack([u, level]), DT)


def found(first: int, hold: float, tolerances=(), **missing):
    records = [record(first + j, hold, **missing) for j in range(5)]
    return diagnose(left_open(dict(tolerances)), Dataset(tuple(records[:3])), Dataset(tuple(records[3:])))


def test_a_rate_without_parameters_says_what_its_state_means():
    assert AXIS.laws == ("v",)
    assert ROD.laws == ("v", "w")
    assert VESSEL.laws == ("h",)
    written_out = replace(VESSEL, parameters=(), equation=lambda x, u, p, at: {"h": 0.04 * u.u - 0.025 * x.h})
    assert written_out.laws == ("h",)


@pytest.mark.slow
@pytest.mark.parametrize("first", [10, 20, 30])
def test_a_drain_that_fouls_is_never_surely_an_error_of_a_sensor(first):
    said = found(first, 150.0, fouled=0.25)
    assert not [c.key for c in said.causes if not c.doubt]
    if said.finding is Finding.NAMED:
        assert all("own equation of h" in c.doubt for c in said.causes)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("first", "fouled", "tolerances"), [(400, 0.6, OPEN), (300, 0.6, OPEN), (500, 0.4, OPEN), (1200, 0.25, {"k": 0.1})]
)
def test_what_a_law_would_explain_if_it_were_fitted_is_not_surely_anything_else(first, fouled, tolerances):
    """A noisy reading of a drain that fouls: after one step of its fit the law is still worse than a sensor's error."""
    said = found(first, 100.0, tolerances, fouled=fouled, samples=1000, reading=0.02)
    assert not [c.key for c in said.causes if not c.doubt]


@pytest.mark.slow
@pytest.mark.parametrize("first", [10, 20, 30])
def test_a_bent_reading_is_sure_where_the_machine_moves_fast_enough_to_tell(first):
    said = found(first, 10.0, bent=0.06)
    assert [(c.key, c.doubt) for c in said.causes] == [("sensor-nonlinearity@level", "")]


def test_the_linear_gap_is_that_of_a_least_squares_fit_with_every_column_written_out():
    key = "sensor-nonlinearity@q"
    model = refitted(fitted(axis_records(2, {key: {"curvature": 0.05}}, samples=600)), key, [0.05])
    fit, predictor = model.fit, model.predictor
    law = instead(model, key)
    assert law is not None
    others = list(range(fit.unknowns.size - 1))
    bases = variables([trajectory(model, i) for i in range(2)])[law.variable][1]
    R = answers(model, ("rate", law.state), bases)
    slot = [s.key for s in AXIS.slots].index(key)
    rows, right = [np.hstack([np.eye(len(others)), np.zeros((len(others), 6))])], [fit.z[others]]
    for i, J in enumerate(fit.jacobian):
        wide = np.zeros((len(J), fit.unknowns.size))
        wide[:, fit.unknowns.columns(i)] = J
        rows.append(np.hstack([wide[:, others], R[i]]))
        eta = fit.point.eta[i].copy()
        eta[slot] = 0.0
        right.append(predictor.errors(i, fit.point.p[None], eta[None], fit.point.start[i][None])[0].ravel())
    A, b = np.vstack(rows), np.concatenate(right)
    left = b - A @ np.linalg.lstsq(A, b)[0]
    push = equations._pushed(equations._without(model, key), equations._Form(law.state, law.variable, bases))
    assert push.linear == pytest.approx(left @ left - fit.cost + 5 * np.log(1200), rel=1e-4, abs=1e-3)


def test_an_effect_that_the_plant_has_of_its_own_is_not_taken_away_with_the_cause():
    """Where the plant came with all of it there is nothing to explain: the law costs its numbers only."""
    key = "sensor-nonlinearity@q"
    model = refitted(fitted(axis_records(2, {key: {"curvature": 0.05}}, samples=600)), key, [0.05])
    slot = [s.key for s in AXIS.slots].index(key)
    base = model.fit.unknowns.base.copy()
    base[slot] = model.fit.point.eta[0, slot]
    own = replace(model, fit=replace(model.fit, unknowns=replace(model.fit.unknowns, base=base)))
    assert instead(own, key).gap < 5 * np.log(1200) + 1e-6 < instead(model, key).gap


@pytest.mark.parametrize("state", ["q", "v"])
def test_what_a_law_would_do_to_the_errors_is_what_the_plant_with_it_does(state):
    """q takes in no noise, v does: a bump over v in the rate of either, by differences of a plant that has it as a parameter.

    The filter holds the push over a sample, the plant does not.
    """

    def equation(x, u, p, at):
        rates = dict(AXIS.equation(x, u, p, at))
        rates[state] = rates[state] + p.law * np.exp(-0.5 * ((x.v - 0.1) / 0.2) ** 2)
        return rates

    with_law = replace(AXIS, equation=equation, parameters=(*AXIS.parameters, Parameter("law", 0.0, "", signed=True)))
    model = fitted(axis_records(4, samples=400))
    own = predictor(with_law, axis_records(4, samples=400))
    point = Point(np.append(model.fit.point.p, 0.0), model.fit.point.eta, model.fit.point.start)
    own = replace(own, entries=model.predictor.entries, substeps=model.predictor.substeps).regained(point, model.predictor.noise)
    small, last = 1e-4, np.arange(len(point.p)) == len(point.p) - 1
    for i in range(2):
        v = trajectory(model, i)["v"]
        bump = np.exp(-0.5 * ((v - 0.1) / 0.2) ** 2)[:, None]
        linear = answers(model, ("rate", state), [bump if j == i else np.zeros((400, 1)) for j in range(2)])[i][:, 0]
        moved = [own.errors(i, point.p[None] + c * last, point.eta[i][None], point.start[i][None])[0] for c in (small, 0.0)]
        change = ((moved[0] - moved[1]) / small).ravel()
        assert np.linalg.norm(change - linear) < 0.25 * np.linalg.norm(linear)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effects", "gap", "finding", "said"),
    [
        ({"coulomb@slide": {"level": 20.0}}, -50.0, Finding.INCOMPLETE, "explains these records better"),
        ({"coulomb@slide": {"level": 20.0}}, 0.0, Finding.NAMED, "do not tell the two apart"),
        ({"coulomb@slide": {"level": 20.0}}, 11.0, Finding.NAMED, ""),
        ({"sensor-nonlinearity@q": {"curvature": 0.05}}, 11.0, Finding.NAMED, "do not tell the two apart"),
        ({"sensor-nonlinearity@q": {"curvature": 0.05}}, 1e6, Finding.NAMED, ""),
    ],
)
def test_a_law_speaks_against_any_cause_that_it_outdoes_and_against_a_sensor_s_error_that_it_matches(
    monkeypatch, effects, gap, finding, said
):
    monkeypatch.setattr(causes, "instead", lambda model, key: Law("v", "F", gap))
    found = diagnose(AXIS, axis_records(5, effects, samples=600), axis_records(6, effects, samples=600))
    assert found.finding is finding
    assert [c.key for c in found.causes] == list(effects)
    assert found.causes[0].doubt.endswith(said)
    assert bool(found.causes[0].doubt) is bool(said)


@pytest.mark.parametrize("key", ["coulomb@slide", "dead-zone@F"])
def test_a_law_over_what_the_effect_is_a_law_of_is_its_form_and_no_rival(key):
    model = refitted(fitted(axis_records(5, {"coulomb@slide": {"level": 20.0}}, samples=600)), key, [5.0])
    law = instead(model, key)
    assert law.variable != {"coulomb@slide": "v", "dead-zone@F": "F"}[key]


def test_a_coefficient_that_changes_with_another_variable_counts_only_where_it_is_better():
    """A rail that binds towards its ends is told; beside plain friction one of many coefficients never ties by chance."""
    forces = {seed: steps(600, 300.0, seed) for seed in (3, 4)}
    binding = Dataset(
        tuple(axis_by_hand(lambda k, y, F=F: F[k], seed, extra=lambda q, v: -400.0 * q**2 * v) for seed, F in forces.items())
    )
    law = instead(refitted(fitted(binding), "heating@F", [0.05]), "heating@F")
    assert (law.state, law.variable) == ("v", "v times q")
    assert law.gap < -TIE
    plain = fitted(axis_records(5, {"coulomb@slide": {"level": 20.0}}, samples=600))
    assert " times " not in instead(refitted(plain, "coulomb@slide", [20.0]), "coulomb@slide").variable


def tank_records(offset, seepage, seeds=(1, 2)):
    """A tank 0.01 h' = 1e-4 (u + offset) - 4e-4 sqrt(h) - seepage h^2, by hand; and the plant without either."""
    plant = Plant(
        name="tank",
        states=(Channel("h", "m"),),
        inputs=(Channel("u", "V", "input"),),
        outputs=(Channel("y", "m", "output"),),
        parameters=(Parameter("k", 1e-4, "m^3/s/V", tolerance=0.02), Parameter("a", 4e-4, "m^2.5/s", tolerance=0.1)),
        equation=lambda x, u, p, at: {"h": (p.k * u.u - p.a * np.sqrt(np.maximum(x.h, 1e-6))) / 0.01},
        measure=lambda x, p: {"y": x.h},
        dt=0.5,
        start=Start({"h": 0.5}, ("u",), ("h",)),
        noise={"y": 5e-4},
    )
    made = []
    for seed in seeds:
        random, h, seen = np.random.default_rng(seed), 0.5, []
        u = np.repeat(random.uniform(1.2, 4.2, 20), 30)
        for own in u:
            seen.append(h + 5e-4 * random.standard_normal())
            flow = lambda t, x, own=own: (1e-4 * (own + offset) - 4e-4 * np.sqrt(x) - seepage * x**2) / 0.01  # noqa: E731
            h = solve_ivp(flow, (0.0, 0.5), [h], rtol=1e-9).y[0, -1]
        made.append(Experiment.from_arrays(f"tank {seed}", 0.5, inputs={"u": u}, outputs={"y": np.array(seen)}))
    return plant, Dataset(tuple(made))


def test_a_law_of_one_number_is_fitted_and_told_from_an_offset():
    """Far from where it acts one linear step says little: the tank without its offset has drifted away."""
    for offset, seepage, better in ((0.0, 3e-5, True), (-0.15, 0.0, False)):
        plant, data = tank_records(offset, seepage)
        model = refitted(fitted(data, plant), "offset@u", [-0.1])
        law = instead(model, "offset@u")
        assert (law.state, law.variable) == ("h", "h")
        assert (law.gap < 0.0) is better
        assert law.gap > TIE or better


def test_a_law_costs_what_its_errors_say_and_not_what_a_linear_step_promises():
    plant, data = tank_records(-0.15, 0.0)
    model = refitted(fitted(data, plant), "offset@u", [-0.1])
    bare = equations._without(model, "offset@u")
    assert bare.fit.cost > model.fit.cost + 20.0
    push = equations._pushed(bare, equations._Form("h", "one", [np.ones((len(r), 1)) for r in model.predictor.records]))
    assert equations._fitted(push) == pytest.approx(0.0, abs=1.0)  # a constant flow is the offset itself, with as many numbers
