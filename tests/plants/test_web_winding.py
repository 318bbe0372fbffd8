"""Physical truths of the winding machine; signs as discussed in the plant's module."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import cumulative_simpson

from plants.web_winding import WEB_WINDING as PLANT
from plants.web_winding import equation
from workbench.physics.controller import Playback
from workbench.simulation import Scenario, simulate

P = {p.name: p.value for p in PLANT.parameters}


@pytest.fixture(scope="module")
def run():
    """Ten seconds in open loop, both voltages moving, logged every 2 ms so that integrals of the record are accurate."""
    fine = replace(PLANT, dt=0.002, substeps=4)
    _, u0 = fine.equilibrium()
    t = 0.002 * np.arange(5000)
    drive = np.array([u0[0] + 0.1 * np.sin(3 * t), u0[1] + 0.3 * np.sign(np.sin(1.7 * t))])
    scenario = Scenario("open loop", dict(zip(fine.input_names, drive, strict=True)))
    return simulate(fine, Playback(fine.input_names, fine.dt), scenario)


def inertia(r):
    return P["J0"] + np.pi / 2 * P["density"] * P["width"] * (r**4 - P["r_core"] ** 4)


def test_energy_is_balanced(run):
    """Motor work = rise of kinetic and elastic energy + friction, copper (kV) and web losses - what the web's mass carries.

    The paper's J w' = torque leaves out w J'; the kinetic energy J w^2/2 therefore changes by another J' w^2/2.
    """
    x, V = run.states, run.experiment[["V1", "V2"]]
    w = x[["w1", "w2"]]
    r, T = x[["r1", "r2"]], x[["T1", "T2"]]
    J = inertia(r)
    v = np.column_stack([r[:, 0] * w[:, 0], P["r3"] * x["w3"], r[:, 1] * w[:, 1]])
    strain_rate = np.diff(v, axis=1)
    stretch = (T - P["D"] * strain_rate) / P["kE"]
    kinetic = (J * w**2).sum(axis=1) / 2 + P["J3"] * x["w3"] ** 2 / 2
    elastic = P["kE"] * (stretch**2).sum(axis=1) / 2
    torque = P["kT"] / P["Ra"] * (V - P["kV"] * w) - np.array([P["B1"], P["B2"]]) * w
    dJ = 2 * np.pi * P["density"] * P["width"] * r**3 * P["s"] / (2 * np.pi) * w * np.array([-1, 1])
    power = (torque * w).sum(axis=1) - P["D"] * (strain_rate**2).sum(axis=1) + (dJ * w**2).sum(axis=1) / 2
    # the hold changes V at some samples: Simpson's rule is accurate between those, so the balance is checked per hold
    jumps = np.flatnonzero(np.abs(np.diff(V[:, 1])) > 0.1) + 1
    # V1 is held too and moves every sample; its work is exact with the held value and the integral of the speed
    work = np.zeros(len(w))
    for i in range(2):
        mean_speed = np.diff(cumulative_simpson(w[:, i], dx=0.002, initial=0))
        work[1:] += np.cumsum(P["kT"] / P["Ra"] * V[:-1, i] * mean_speed)
    rest = power - (P["kT"] / P["Ra"] * V * w).sum(axis=1)
    balance = work + cumulative_simpson(rest, dx=0.002, initial=0) - (kinetic + elastic - kinetic[0] - elastic[0])
    assert len(jumps) > 3
    # the exchanged work is some 1 J; the rest is quadrature error at the jumps
    assert np.abs(balance).max() < 2e-4 * np.abs(work).max()


def test_tape_is_conserved_between_the_reels(run):
    """Length on both reels, pi (r^2 - r_core^2)/s, changes only by the stretch of the two spans."""
    x = run.states
    on_reels = np.pi * (x["r1"] ** 2 + x["r2"] ** 2) / P["s"]
    v1, v2 = x["r1"] * x["w1"], x["r2"] * x["w2"]
    stretch = cumulative_simpson(v2 - v1, dx=0.002, initial=0)
    moved = np.pi * (x["r2"][-1] ** 2 - x["r2"][0] ** 2) / P["s"]
    assert moved > 5.0
    # the spiral is exact; what is left is the quadrature of speeds with kinks where a voltage jumps
    np.testing.assert_allclose(on_reels - on_reels[0], stretch, atol=5e-3 * np.abs(stretch).max())
    assert np.abs(stretch).max() < 1e-3 * moved
    # and the stretch is what the tensions say
    e = np.column_stack([P["r3"] * x["w3"] - v1, v2 - P["r3"] * x["w3"]])
    elastic = ((x[["T1", "T2"]] - P["D"] * e) / P["kE"]).sum(axis=1)
    np.testing.assert_allclose(stretch, elastic - elastic[0], atol=5e-3 * np.abs(stretch).max())


def frozen_modes(sign_of_rewind_tension, r2):
    """Poles of the machine with both radii held, for either sign of r2 T2 in (1.12)."""

    def signed(x, u, p, at):
        rates = dict(equation(x, u, p, at))
        J2 = p.J0 + 0.5 * np.pi * p.density * p.width * (x.r2**4 - p.r_core**4)
        change = (sign_of_rewind_tension + 1) * x.r2 * x.T2 / J2
        rates["w2"] = rates["w2"] + change
        rates["T2"] = rates["T2"] + p.D * x.r2 * change  # the span sees the reel's acceleration
        return rates | {"r1": 0 * x.r1, "r2": 0 * x.r2}

    plant = replace(PLANT, equation=signed, name="frozen")
    x0, u0 = PLANT.equilibrium(r2=r2, r1=np.sqrt(P["r_full"] ** 2 + P["r_core"] ** 2 - r2**2))
    A, *_ = plant.linearize(x0, u0)
    return np.linalg.eigvals(A[:5, :5])


@pytest.mark.parametrize("r2", np.linspace(P["r_core"], P["r_full"], 9))
def test_physical_signs_are_stable_at_every_frozen_radius(r2):
    assert frozen_modes(-1, r2).real.max() < 0


def test_printed_signs_are_unstable_once_the_rewind_reel_holds_some_tape():
    """With +r2 T2 the tape drives the rewind motor: r2^2/J2 > r1^2/J1 is enough, whatever the friction takes away."""
    worst = [frozen_modes(+1, r2).real.max() for r2 in (0.0187, 0.0225, 0.0264)]
    assert worst[0] > 1.0  # an e-fold in less than a second: no machine that runs
    assert worst[0] < worst[1] < worst[2]


def test_dancer_and_radius_read_what_the_paper_says():
    x0, _ = PLANT.equilibrium()
    x = x0.copy()
    x[PLANT.state_names.index("T1")] += 0.05
    assert PLANT.output(x)[PLANT.output_names.index("theta")] == pytest.approx(5.0)  # 0.05 N at 0.01 N/deg
    assert PLANT.output(x)[PLANT.output_names.index("r2")] == x0[PLANT.state_names.index("r2")]


def test_reel_two_is_full_after_the_protocol_of_the_paper():
    """90 s at 1 m/s wind what the full reel held: from empty to full, [1] section 1.4.2."""
    wound = np.pi * (P["r_full"] ** 2 - P["r_core"] ** 2) / P["s"]
    assert wound == pytest.approx(90.0, rel=0.05)


def test_a_given_start_value_replaces_the_equilibrium_one():
    x, u = PLANT.equilibrium()
    beside, held = PLANT.equilibrium(w1=5.0)
    assert beside[0] == 5.0
    np.testing.assert_allclose(beside[1:], x[1:], rtol=1e-12)
    np.testing.assert_allclose(held, u, rtol=1e-9)
    slower, _ = PLANT.equilibrium(w3=50.0)  # a set value moves the equilibrium itself
    assert slower[0] == pytest.approx(x[0] / 2, rel=1e-2)
