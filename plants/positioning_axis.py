"""A positioning axis of the EMPS type: a ball-screw slide driven by a force.

    M q'' = F - Fv q'

The nominal model leaves out dry friction and offset on purpose: finding them is the work of a diagnosis.
"""

from workbench.data import Channel
from workbench.physics.effects.shaft import Slide
from workbench.physics.parameters import Parameter
from workbench.physics.plant import Plant


def equation(x, u, p, at):
    return {"q": x.v, "v": (u.F - p.Fv * x.v + at.slide.torque()) / p.M}


def measure(x, p):
    del p
    return {"q": x.q}


POSITIONING_AXIS = Plant(
    name="positioning-axis",
    description="electro-mechanical positioning axis: mass and viscous friction",
    states=(Channel("q", "m"), Channel("v", "m/s")),
    inputs=(Channel("F", "N", "input"),),
    outputs=(Channel("q", "m", "output"),),
    parameters=(
        Parameter("M", 95.0, "kg", 0.20, "moving mass"),
        Parameter("Fv", 200.0, "N s/m", 0.50, "viscous friction"),
    ),
    equation=equation,
    measure=measure,
    dt=0.001,
    ports=(Slide("slide", "v"),),
    substeps=2,
    meaning={
        "F": "force of the drive",
        "q": "position of the slide",
        "v": "speed of the slide",
        "slide": "the slide on its guide",
    },
)
"""M q'' = F - Fv q': a ball-screw slide that is driven by a force, of the EMPS type.

    >>> [f"{p.name} {p.value:g} {p.unit}" for p in POSITIONING_AXIS.parameters]
    ['M 95 kg', 'Fv 200 N s/m']
"""
