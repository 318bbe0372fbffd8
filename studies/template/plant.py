"""What is believed of the machine: its equation, with the values of the data sheet and their tolerances.

The example is a motor that an eddy-current brake holds back; `way` says how far the magnet is in. Replace it by your own machine.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from workbench import Channel, Parameter, Plant, Start
from workbench.physics.effects import Shaft


def equation(x, u, p, at):
    """The derivative of every state by name; no `if` on a state."""
    drag = (p.b + p.c * u.way) * x.w
    return {"w": (p.kT / p.Ra * (u.U - p.kT * x.w) - drag + at.shaft.torque()) / p.J}


def measure(x, p):
    """What the sensors show, in the units of the records."""
    return {"n": 30 / np.pi * x.w}


PLANT = Plant(
    name="brake_motor",
    states=(Channel("w", "rad/s"),),
    inputs=(Channel("U", "V", "input"), Channel("way", "mm", "schedule")),
    outputs=(Channel("n", "1/min", "output"),),
    parameters=(
        Parameter("J", 1e-3, "kg m^2", tolerance=0.3, meaning="inertia"),
        Parameter("b", 5e-4, "N m s/rad", tolerance=0.5, meaning="bearing"),
        Parameter("c", 5e-4, "N m s/(rad mm)", tolerance=0.4, meaning="brake"),
        Parameter("kT", 0.1, "V s/rad", tolerance=0.15, meaning="motor constant"),
        Parameter("Ra", 1.0, "ohm", tolerance=0.1, meaning="armature resistance"),
    ),
    equation=equation,
    measure=measure,
    dt=0.005,
    ports=(Shaft("shaft", "w"),),
    start=Start({"w": 0.0}, ("U",), ("w",)),
    noise={"n": 2.0},
)


# In the records the schedule is an input that moves on its own. A scheduled law must measure it: in a closed loop it is a state
# and an output, which here moves in at 2 mm/s.


def moving(x, u, p, at):
    return {**equation(x, SimpleNamespace(U=u.U, way=x.way), p, at), "way": 2.0}


def measure_moving(x, p):
    return {**measure(x, p), "way": x.way}


LOOP = replace(
    PLANT,
    states=(*PLANT.states, Channel("way", "mm")),
    inputs=PLANT.inputs[:1],
    outputs=(*PLANT.outputs, Channel("way", "mm", "schedule")),
    equation=moving,
    measure=measure_moving,
    start=Start({"w": 200 * np.pi / 30, "way": 2.0}, ("U",), ("w",)),
    noise={"n": 2.0, "way": 0.01},
)
