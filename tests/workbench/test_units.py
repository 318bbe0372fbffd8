"""Nothing in one unit is taken for another: models, laws, loops and proofs refuse it, and say the factor where there is one."""

import dataclasses

import numpy as np
import pytest

import workbench as wb
from controllers.pid import pid
from workbench.basis import CONSTANT
from workbench.data import Channel, Dataset, Experiment
from workbench.errors import InputError
from workbench.lpv import OperatingPoint, Predictor, constant_model
from workbench.physics.plant import Plant
from workbench.physics.rest import Start
from workbench.rehearsal import rehearsal
from workbench.robustness.frozen import margins_of
from workbench.simulation import Scenario, simulate
from workbench.units import UNITS, check_units, differ

MODEL = constant_model(
    "heater", 0.1, ((Channel("u", "V", "input"),), (Channel("T", "rad", "output"),)),
    ([[0.9]], [[0.1]], [[1.0]], [[0.0]]), OperatingPoint(CONSTANT, [[0.0]], [[0.0]]),
    predictor=Predictor([[[0.5]]], [[[0.1]]], [[[0.4]]], warmup=5), noise=np.array([[1e-4]]),
)  # fmt: skip
PLANT = Plant(
    name="heater", states=(Channel("T", "rad"),), inputs=(Channel("u", "V", "input"),), outputs=(Channel("T", "rad", "output"),),
    parameters=(), equation=lambda x, u, p, at: {"T": u.u - x.T}, measure=lambda x, p: {"T": x.T}, dt=0.1,
    start=Start(fixed={"u": 0.0, "T": 0.0}),
)  # fmt: skip


def law(**units):
    return pid(("u",), ("T",), ("T_set",), 0.1, [0.5], [0.5], units=units)


def records(u="V", T="rad"):
    random = np.random.default_rng(0)
    moves = np.repeat(random.normal(size=20), 10)
    e = Experiment.from_arrays("r", 0.1, inputs={"u": moves}, outputs={"T": np.zeros(200)})
    y = MODEL.simulate(e, warmup=0)[:, 0] + 0.01 * random.normal(size=200)
    return Dataset((Experiment.from_arrays("r", 0.1, inputs={"u": moves}, outputs={"T": y}, units={"u": u, "T": T}),))


@pytest.mark.parametrize(
    ("u", "T", "said"),
    [("mV", "rad", "multiply the column by 0.001"), ("V", "deg", "0.01745"), ("%", "rad", "no conversion from % to V is known")],
)
def test_a_model_takes_no_record_in_other_units(u, T, said):
    own = records(u, T).experiments[0]
    for use in (MODEL.simulate, MODEL.predict):
        with pytest.raises(InputError, match=said):
            use(own)
    with pytest.raises(InputError, match=said):
        wb.check(law(), {"loop": {"stable": True}}, model=MODEL, records=records(u, T))


def test_a_record_without_units_is_taken_as_it_is():
    assert np.isfinite(MODEL.simulate(records("", "").experiments[0])).all()
    assert wb.check(law(), {"loop": {"stable": True}}, model=MODEL, records=records()).status.value == "PROVED"


def test_a_law_in_other_units_closes_no_loop():
    wrong = law(T="deg", u="V")
    scenario = Scenario("s", {"T_set": np.ones(20)})
    uses = (
        lambda own: simulate(PLANT, own, scenario), lambda own: margins_of(own, MODEL, [None]),
        lambda own: rehearsal(MODEL, [0.0], [1.0], 50, 0).run(own),
        lambda own: wb.check(own, {"loop": {"stable": True}}, model=MODEL, records=records()),
    )  # fmt: skip
    for use in uses:
        with pytest.raises(InputError, match="in rad, pid was made for deg"):
            use(wrong)
        use(law(T="rad", u="V"))
        use(law())


def test_factors_are_those_of_the_quantities():
    assert differ("rpm", "1/min") == ""
    assert differ("rad", "") == differ("", "V") == ""
    assert "a voltage" in differ("V", "A")
    bar = UNITS["bar"].factor / UNITS["psi"].factor
    assert bar == pytest.approx(14.5038, rel=1e-5)
    e = dataclasses.replace(records().experiments[0], channels=(Channel("u", "m3/h", "input"), Channel("T", "K", "output")))
    with pytest.raises(InputError, match=r"multiply the column by 16.66666667 and write u \[l/min\]"):
        check_units(e, {"u": "l/min"})
    with pytest.raises(InputError, match="no conversion from K to degC is known"):
        check_units(e, {"T": "degC"})
