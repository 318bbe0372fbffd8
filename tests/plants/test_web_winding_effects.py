"""What each effect must do to the winding machine, from mechanics and not from the plant's own equation."""

import numpy as np
import pytest

from plants import WEB_WINDING as PLANT

P = {p.name: p.value for p in PLANT.parameters}
X = np.array([38.0, 88.0, 101.0, 0.27, 0.36, 0.021, 0.0185])  # w1 w2 w3 T1 T2 r1 r2, away from equilibrium
U = np.array([0.3, 2.4])
SIZES = {
    "eccentricity@unwind": {"cosine": 2e-4, "sine": -1e-4},
    "eccentricity@rewind": {"cosine": -1e-4, "sine": 3e-4},
    "slip@pulley": {"creep": 0.05},
}


def rates(x, angle=(0.4, 1.1, 0.0), **sizes):
    eta = PLANT.effect_vector({k.replace("_at_", "@"): v for k, v in sizes.items()} if sizes else {})
    return np.array(PLANT.derivative(x, U, eta=eta, angle=angle))


@pytest.mark.parametrize(("place", "i"), [("unwind", 0), ("rewind", 1), ("pulley", 2)])
def test_dry_friction_brakes_every_shaft_by_level_over_inertia(place, i):
    J = [P["J0"] + np.pi / 2 * P["density"] * P["width"] * (r**4 - P["r_core"] ** 4) for r in X[5:7]] + [P["J3"]]
    change = rates(X, **{f"coulomb_at_{place}": {"level": 1e-3}}) - rates(X)
    assert change[i] == pytest.approx(-1e-3 / J[i])


def strains(x, angle, sizes):
    e1, e2, creep = sizes["eccentricity@unwind"], sizes["eccentricity@rewind"], sizes["slip@pulley"]["creep"]
    R1 = x[5] + e1["cosine"] * np.cos(angle[0]) + e1["sine"] * np.sin(angle[0])
    R2 = x[6] + e2["cosine"] * np.cos(angle[1]) + e2["sine"] * np.sin(angle[1])
    v3 = P["r3"] * x[2] + creep * (x[4] - x[3])
    return np.array([v3 - R1 * x[0], R2 * x[1] - v3])


def test_tensions_follow_strain_and_its_rate_with_runout_and_slip():
    """T' = kE e + D e' (1.15), e' as the numerical derivative along the flow: no term of it may be forgotten."""
    angle = np.array([0.4, 1.1, 0.0])
    eta = PLANT.effect_vector(SIZES)
    dx, h = np.array(PLANT.derivative(X, U, eta=eta, angle=angle)), 1e-6
    step = h * np.array([X[0], X[1], X[2]])
    ahead, behind = strains(X + h * dx, angle + step, SIZES), strains(X - h * dx, angle - step, SIZES)
    expected = P["kE"] * strains(X, angle, SIZES) + P["D"] * (ahead - behind) / (2 * h)
    np.testing.assert_allclose(dx[3:5], expected, rtol=1e-6)


def test_slip_equalises_the_tensions():
    change = rates(X, slip_at_pulley={"creep": 0.05}) - rates(X)
    assert change[4] - change[3] < 0 < X[4] - X[3]
