"""The web winding machine of [1] section 1.4.1: tape runs from reel 1 over a guide pulley to reel 2.

    J_i w_i' = -B_i w_i + kT/Ra (V_i - kV w_i) +- r_i T_i      (1.12), + unwind, - rewind
    r_1' = -s/(2 pi) w_1,  r_2' = +s/(2 pi) w_2                (1.13)
    J_3 w_3' = r_3 (T_2 - T_1)                                 (1.14)
    T_i' = kE e_i + D e_i',  e_1 = v_3 - v_1,  e_2 = v_2 - v_3 (1.15), (1.16)

with surface speeds v = r w. [1] prints +r_i T_i and +s/(2 pi) w_i for both motors. Physically the tape pulls the unwind
reel forward and holds the rewind reel back, r_1 falls and r_2 grows, as the paper's own text says; with the printed signs
the frozen machine is unstable as soon as r2^2/J2 exceeds r1^2/J1. The parameter values are ours: the paper prints none.

[1] "Experimental Modelling of a Web Winding Machine: LPV Approaches", chapter 1.
"""

import numpy as np

from workbench.data import Channel
from workbench.physics.effects.pulley import Pulley
from workbench.physics.effects.reel import Reel
from workbench.physics.effects.shaft import Shaft
from workbench.physics.effects.span import Span
from workbench.physics.effects.winding import Winding
from workbench.physics.held import held
from workbench.physics.parameters import Parameter
from workbench.physics.plant import Plant
from workbench.physics.rest import Start


def equation(x, u, p, at):
    J1 = p.J0 + 0.5 * np.pi * p.density * p.width * (x.r1**4 - p.r_core**4)
    J2 = p.J0 + 0.5 * np.pi * p.density * p.width * (x.r2**4 - p.r_core**4)
    round1, round2 = at.unwind.runout(), at.rewind.runout()
    R1, R2 = x.r1 + round1.radius, x.r2 + round2.radius
    motor = p.kT / p.Ra
    w1 = (-p.B1 * x.w1 + motor * (u.V1 - p.kV * x.w1) + R1 * x.T1 + at.unwind.torque(load=R1 * x.T1)) / J1
    w2 = (-p.B2 * x.w2 + motor * (u.V2 - p.kV * x.w2) - R2 * x.T2 + at.rewind.torque(load=R2 * x.T2)) / J2
    w3 = (p.r3 * (x.T2 - x.T1) + at.pulley.torque(load=p.r3 * (x.T2 + x.T1))) / p.J3
    r1 = -p.s / (2 * np.pi) * x.w1
    r2 = at.rewind.thickness(p.s, R2 * x.w2) / (2 * np.pi) * x.w2
    # stretch rates e1, e2 and their derivatives on the pulley's own surface; slip then moves the web by creep (T2 - T1)
    v3 = p.r3 * x.w3 + at.pulley.creep() * (x.T2 - x.T1)
    e1, e2 = v3 - R1 * x.w1, R2 * x.w2 - v3
    T1 = p.kE * e1 + at.T1.rate(e1, p.kE, p.T_set) + p.D * (p.r3 * w3 - R1 * w1 - (r1 + round1.rate) * x.w1)
    T2 = p.kE * e2 + at.T2.rate(e2, p.kE, p.T_set) + p.D * (R2 * w2 + (r2 + round2.rate) * x.w2 - p.r3 * w3)
    # v3' holds creep (T2' - T1'): two linear equations in T1', T2', solved here
    feedback = p.D * at.pulley.creep()
    slip = feedback * (T2 - T1) / (1 + 2 * feedback)
    return {"w1": w1, "w2": w2, "w3": w3, "T1": T1 + slip, "T2": T2 - slip, "r1": r1, "r2": r2}


def measure(x, p):
    return {"w1": x.w1, "w2": x.w2, "w3": x.w3, "theta": (x.T1 - p.T_set) / p.dancer, "r2": x.r2}


WEB_WINDING = Plant(
    name="web-winding",
    description="web winding machine: tape from the unwind reel over a guide pulley to the rewind reel",
    states=(
        Channel("w1", "rad/s"),
        Channel("w2", "rad/s"),
        Channel("w3", "rad/s"),
        Channel("T1", "N"),
        Channel("T2", "N"),
        Channel("r1", "m"),
        Channel("r2", "m"),
    ),
    inputs=(Channel("V1", "V", "input"), Channel("V2", "V", "input")),
    outputs=(
        Channel("w1", "rad/s", "other"),
        Channel("w2", "rad/s", "other"),
        Channel("w3", "rad/s", "output"),
        Channel("theta", "deg", "output"),
        Channel("r2", "m", "schedule"),
    ),
    parameters=(
        Parameter("B1", 2.0e-5, "N m s/rad", 0.30, "viscous friction, unwind shaft"),
        Parameter("B2", 2.0e-5, "N m s/rad", 0.30, "viscous friction, rewind shaft"),
        Parameter("kT", 0.020, "N m/A", 0.10, "motor torque constant"),
        Parameter("kV", 0.020, "V s/rad", 0.10, "motor voltage constant"),
        Parameter("Ra", 2.0, "ohm", 0.10, "armature resistance"),
        Parameter("s", 20.0e-6, "m", 0.05, "tape thickness"),
        Parameter("r3", 0.010, "m", 0.01, "guide pulley radius (the paper says: dancer arm radius)"),
        Parameter("J3", 2.0e-6, "kg m^2", 0.20, "guide pulley inertia"),
        Parameter("kE", 200.0, "N/m", 0.20, "tape elastic constant"),
        Parameter("D", 0.5, "N s/m", 0.30, "tape damping constant"),
        Parameter("r_core", 0.011, "m", 0.01, "core radius of both reels"),
        Parameter("r_full", 0.0264, "m", 0.01, "radius of the full unwind reel at the start"),
        Parameter("J0", 2.0e-5, "kg m^2", 0.20, "motor plus core inertia"),
        Parameter("density", 1400.0, "kg/m^3", 0.05, "tape density"),
        Parameter("width", 0.0127, "m", 0.01, "tape width"),
        Parameter("dancer", 0.01, "N/deg", 0.10, "dancer spring: theta = (T1 - T_set)/dancer"),
        Parameter("T_set", 0.30, "N", 0.0, "web tension at which the dancer stands at 0 deg"),
    ),
    equation=equation,
    measure=measure,
    dt=0.040,
    ports=(
        Shaft("unwind", "w1", loaded=True),
        Reel("unwind", "w1"),
        Shaft("rewind", "w2", loaded=True),
        Reel("rewind", "w2"),
        Winding("rewind"),  # only what is wound up takes air in
        Shaft("pulley", "w3", loaded=True),
        Pulley("pulley"),
        Span("T1", "T1"),
        Span("T2", "T2"),
    ),
    start=Start(
        fixed={"w3": 100.0, "T1": "T_set", "T2": "T_set", "r1": "r_full", "r2": "r_core"},
        solve_for=("w1", "w2", "V1", "V2"),
        zero=("w1", "w2", "T1", "T2"),
        guess={"w1": 40.0, "w2": 90.0},
    ),
    noise={"w1": 0.2, "w2": 0.2, "w3": 0.3, "theta": 0.2, "r2": 5.0e-6},
    disturbance={"V1": 0.01, "V2": 0.01},
    meaning={
        "V1": "voltage of the unwind motor",
        "V2": "voltage of the rewind motor",
        "w1": "speed of the unwind reel",
        "w2": "speed of the rewind reel",
        "w3": "speed of the guide pulley",
        "theta": "angle of the dancer, which follows the tension T1",
        "T1": "tension between unwind reel and guide pulley",
        "T2": "tension between guide pulley and rewind reel",
        "r1": "radius of the unwind reel",
        "r2": "radius of the rewind reel",
        "unwind": "shaft and reel that the tape comes from",
        "rewind": "shaft and reel that the tape is wound on",
        "pulley": "guide pulley between the reels",
    },
    limits={"r1": (0.010, 0.030), "r2": (0.010, 0.030), "T1": (-5.0, 50.0), "T2": (-5.0, 50.0)},
)
"""Tape runs from one reel over a guide pulley to another one; the schedule is the radius of the reel that winds up.

    >>> [f"{channel.name} [{channel.unit}]" for channel in WEB_WINDING.outputs]
    ['w1 [rad/s]', 'w2 [rad/s]', 'w3 [rad/s]', 'theta [deg]', 'r2 [m]']
"""


def frozen_machine(r2: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A, B, C of the sampled machine (40 ms, zero-order hold) with both radii held, from V1, V2 to w3."""
    p = {q.name: q.value for q in WEB_WINDING.parameters}
    r1 = np.sqrt(p["r_full"] ** 2 + p["r_core"] ** 2 - r2**2)  # what is on one reel is missing on the other
    A, B, C, _ = WEB_WINDING.linearize(*WEB_WINDING.equilibrium(r1=r1, r2=r2))
    fast = [i for i, name in enumerate(WEB_WINDING.state_names) if name not in ("r1", "r2")]
    A, B, C = A[np.ix_(fast, fast)], B[fast], C[[WEB_WINDING.output_names.index("w3")]][:, fast]
    return *held(A, B, WEB_WINDING.dt), C
