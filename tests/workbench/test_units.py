"""Nothing in one unit is taken for another: models, laws, loops and proofs refuse it, and say the factor where there is one."""

import dataclasses

import numpy as np
import pytest

import workbench as wb
from controllers.pid import pid
from plants import PLANTS
from studies.experiments import measured
from workbench.answers.answer import prepared
from workbench.basis import CONSTANT
from workbench.data import Channel, Dataset, Experiment
from workbench.errors import InputError
from workbench.lpv import OperatingPoint, Predictor, constant_model
from workbench.physics.plant import Plant
from workbench.physics.rest import Start
from workbench.rehearsal import rehearsal
from workbench.robustness.frozen import margins_of
from workbench.simulation import Scenario, simulate
from workbench.units import UNITS, check_units, differ, in_units

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
    if "%" in said:
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
    with pytest.raises(InputError, match=r"multiply the column by 1, add -273.15 and write T \[degC\]"):
        check_units(e, {"T": "degC"})
    assert differ("K", "degC") == "1 K is -272.15 degC"
    assert differ("degC", "°C") == ""
    with pytest.raises(InputError, match="no conversion from furlong to degC is known"):
        check_units(dataclasses.replace(e, channels=(e.channels[0], Channel("T", "furlong", "output"))), {"T": "degC"})


@pytest.mark.parametrize("own", [name for name in UNITS if name not in ("s", "ms", "us", "min", "h")])
def test_a_record_in_any_unit_is_the_record_in_another_one(own):
    """There and back, against the SI unit; the record that was given is as it was."""
    x = np.array([-3.0, 0.0, 7.0])
    for other in (name for name, unit in UNITS.items() if unit.quantity == UNITS[own].quantity):
        given = Experiment.from_arrays("r", 0.1, outputs={"y": x}, references={"y_set": 2.0 * x}, units={"y": own, "y_set": own})
        (there,) = in_units(Dataset((given,)), {"y": other})
        si = [UNITS[c.unit].factor * v + UNITS[c.unit].zero for c, v in zip(there.channels, there.values.T, strict=True)]
        np.testing.assert_allclose(si, [UNITS[own].factor * v + UNITS[own].zero for v in (x, 2.0 * x)], rtol=1e-12, atol=1e-12)
        (back,) = in_units(Dataset((there,)), {"y": own})
        np.testing.assert_allclose(back.values, given.values, rtol=1e-12, atol=1e-9)
        assert [len(there.notes), len(back.notes)] == ([2, 4] if differ(own, other) else [0, 0])
        np.testing.assert_array_equal(given["y"], x)


def test_a_diagnosis_of_a_log_in_other_units_is_that_of_the_plants_own():
    """The same numbers, to rounding, and a note for each channel; the size of a channel still tells a wrong header."""
    plant = PLANTS["welding-robot"]
    e = measured(plant, "prbs", 3)
    unit = {c.name: c.unit for c in e.channels}
    assert (unit["v"], unit["u"]) == ("m/s", "N")
    told = e.values * np.array([{"v": 1e3, "u": 1e3}.get(c.name, 1.0) for c in e.channels])
    channels = tuple(dataclasses.replace(c, unit={"v": "mm/s", "u": "mN"}.get(c.name, c.unit)) for c in e.channels)
    other = dataclasses.replace(e, values=told, channels=channels)
    found = [wb.calibrate(plant, Dataset((own,)), parameters=["m1"]) for own in (e, other)]
    m1 = [next(q.value for q in one.plant.parameters if q.name == "m1") for one in found]
    assert m1[1] == pytest.approx(m1[0], rel=1e-6)
    assert sum("by its header" in note for note in found[1].records.notes) == 1
    held = prepared(
        plant, Dataset((other,)), Dataset((measured(plant, "rbs", 4),)), None, False
    )  # only one of the two is converted
    assert held.held_out is not None
    assert [c.unit for c in held.own.experiments[0].channels] == [c.unit for c in held.held_out.experiments[0].channels]


@pytest.mark.parametrize(("name", "unit"), [("v", "mm/s"), ("v", "km/h"), ("v", "cm/s"), ("u", "kN")])
def test_a_header_that_lies_is_refused_and_taken_when_asked(name, unit):
    """The numbers are in the plant's own unit: it follows them better as they stand."""
    plant = PLANTS["welding-robot"]
    e = measured(plant, "prbs", 3)
    wrong = dataclasses.replace(
        e, channels=tuple(dataclasses.replace(c, unit=unit if c.name == name else c.unit) for c in e.channels)
    )
    with pytest.raises(InputError, match=rf"is {unit} by its header, but welding-robot follows it better as it stands") as caught:
        wb.calibrate(plant, Dataset((wrong,)), parameters=["m1"])
    assert caught.value.channel == name
    assert "in the header if that is its unit; --anyway" in caught.value.mend
    notes = prepared(plant, Dataset((wrong,)), None, None, True).notes
    assert any(f"{name}: {unit} by its header, taken times" in note for note in notes)
    assert any("taken all the same: is" in note for note in notes)
