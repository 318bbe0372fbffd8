"""What an extension gains on records it never saw: starts and phases are found on them, nothing else is."""

from dataclasses import replace

import numpy as np
import pytest

from plants import WEB_WINDING
from studies.experiments import EXPERIMENTS
from workbench.data import Dataset
from workbench.diagnosis.fit import Fit, term
from workbench.diagnosis.gains import on
from workbench.diagnosis.predictor import predictor
from workbench.diagnosis.recalibrate import unknowns
from workbench.diagnosis.refit import Model
from workbench.simulation import simulate

pytestmark = pytest.mark.slow

AMPLITUDE = 3e-5
PHASES = (2.0, 4.5)


def turned(phase: float) -> dict[str, float]:
    return {"cosine": AMPLITUDE * np.cos(phase), "sine": AMPLITUDE * np.sin(phase)}


def wound(experiment: str, seed: int, phase: float, fuller: float):
    """A record of an eccentric reel that was mounted at some phase, with more web on it than the plant believes."""
    plan = EXPERIMENTS["web-winding"][experiment]
    scenario = plan.scenario(seed)
    rest, _ = WEB_WINDING.equilibrium()
    r1 = rest[WEB_WINDING.state_names.index("r1")]
    scenario = replace(scenario, name=f"{experiment} {seed}", start={**scenario.start, "r1": fuller * r1})
    return simulate(WEB_WINDING, plan.controller, scenario, effects={"eccentricity@unwind": turned(phase)}).experiment


@pytest.fixture(scope="module")
def truth() -> Model:
    """The plant with the eccentricity as it is, on one record."""
    made = predictor(WEB_WINDING, Dataset((wound("prbs1", 1, 0.0, 1.0),)))
    own = unknowns(made, (term(WEB_WINDING, "eccentricity@unwind"),))
    z = own.zero()
    z[-2:] = AMPLITUDE, 0.0
    made = made.regained(own.point(z))
    return Model(made, Fit(own, z, tuple(made.at(made.point)), ()))


def test_an_eccentric_reel_is_found_at_its_phase_on_records_that_begin_anywhere(truth):
    held_out = Dataset(tuple(wound("rgs", 7 + k, phase, 1.05) for k, phase in enumerate(PHASES)))
    made, point = on(truth, held_out)
    places = [i for i, slot in enumerate(WEB_WINDING.slots) if slot.key == "eccentricity@unwind"]
    for i, phase in enumerate(PHASES):
        cosine, sine = point.eta[i, places]
        assert np.hypot(cosine, sine) == pytest.approx(AMPLITUDE)
        assert np.angle(np.exp(1j * (np.arctan2(sine, cosine) - phase))) == pytest.approx(0.0, abs=0.15)
        e = made.errors(i, point.p[None], point.eta[i][None], point.start[i][None])[0]
        assert np.mean(e**2) < 1.05
