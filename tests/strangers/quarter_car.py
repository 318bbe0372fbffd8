"""A quarter of a car on a shaker, from its rest, with an actuator between body and wheel:

ms zs'' = -ks (zs - zu) - cs (zs' - zu') + F,   mu zu'' = ks (zs - zu) + cs (zs' - zu') - F - kt (zu - road)
"""

from tests.strangers.bench import Course, Lab, Machine, Place
from workbench import Channel, Parameter, Plant
from workbench.physics.effects import Slide


def rates(x, u, p, f):
    zs, zu, vs, vu = x
    travel, rate = zs - zu, vs - vu
    strut = p.ks * travel + p.bump_stop * travel**3 + p.cs * rate * (1.0 + p.digressive * rate)
    return vs, vu, (u[0] - strut + f.body) / p.ms, (strut - u[0] - p.kt * (zu - u[1])) / p.mu


def outputs(x, p):
    return 1e3 * x[0], 1e3 * (x[0] - x[1])


# ---- what its user has written ---------------------------------------------------------------------------------------


def equation(x, u, p, at):
    strut = u.F - p.ks * (x.zs - x.zu) - p.cs * (x.vs - x.vu)
    return {
        "zs": x.vs,
        "zu": x.vu,
        "vs": (strut + at.body.torque()) / p.ms,
        "vu": (p.kt * (u.road - x.zu) - strut) / p.mu,
    }


def measure(x, p):
    return {"body": 1000 * x.zs, "travel": 1000 * (x.zs - x.zu)}


PLANT = Plant(
    name="quarter-car",
    states=(Channel("zs", "m"), Channel("zu", "m"), Channel("vs", "m/s"), Channel("vu", "m/s")),
    inputs=(Channel("F", "N", "input"), Channel("road", "m", "schedule")),
    outputs=(Channel("body", "mm", "output"), Channel("travel", "mm", "output")),
    parameters=(
        Parameter("ms", 250.0, "kg", tolerance=0.1, meaning="mass of the body"),
        Parameter("mu", 40.0, "kg", tolerance=0.1, meaning="mass of the wheel"),
        Parameter("ks", 16000.0, "N/m", tolerance=0.15, meaning="spring of the strut"),
        Parameter("cs", 1200.0, "N s/m", tolerance=0.3, meaning="damper of the strut"),
        Parameter("kt", 160000.0, "N/m", tolerance=0.15, meaning="stiffness of the tyre"),
    ),
    equation=equation,
    measure=measure,
    dt=0.005,
    ports=(Slide("body", "vs"),),
    noise={"body": 0.1, "travel": 0.1},
)

STRANGER = Machine(
    PLANT,
    rates,
    outputs,
    start=(0.0, 0.0, 0.0, 0.0),
    places={"body": Place(2, 150.0, 0.3, 0.01)},
    foreign={"bump_stop": 4e6, "digressive": 0.5},
    lab=Lab(
        dts=(0.005, 0.01),
        seconds=(15.0, 25.0),
        noise=(0.1, 0.1),
        push=(3.0, 0.0),
        base=(0.0, 0.0),
        range=((-1000.0, 1000.0), (-0.1, 0.1)),
        open=(Course(-400.0, 400.0, (0.2, 1.0)),),
        free={1: Course(-0.02, 0.02, (0.2, 1.0))},
        settle=1.0,
    ),
    fine=0.005,
    slowest=0.05,
)
