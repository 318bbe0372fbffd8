"""A heater in a duct, from which the air takes its time to the sensor, cell by cell:

C T' = P u - G (T - Ta),   tau c_k' = c_(k-1) - c_k,   c_0 = T
"""

from tests.strangers.bench import Course, Lab, Loop, Machine
from workbench import Channel, Parameter, Plant, Start


def rates(x, u, p, f):
    T, c1, c2, c3 = x
    over = T - p.Ta
    lost = p.G * over + p.glow * over**3
    tau = p.tau * (1.0 + p.sluggish * over)
    return (p.P * u[0] - lost) / p.C, (T - c1) / tau, (c1 - c2) / tau, (c2 - c3) / tau


def outputs(x, p):
    return (x[3],)


# ---- what its user has written ---------------------------------------------------------------------------------------


def equation(x, u, p, at):
    del at
    return {
        "T": (p.P * u.duty - p.G * (x.T - p.Ta)) / p.C,
        "c1": (x.T - x.c1) / p.tau,
        "c2": (x.c1 - x.c2) / p.tau,
        "c3": (x.c2 - x.c3) / p.tau,
    }


def measure(x, p):
    return {"air": x.c3}


PLANT = Plant(
    name="heater",
    states=tuple(Channel(name, "degC") for name in ("T", "c1", "c2", "c3")),
    inputs=(Channel("duty", "%", "input"),),
    outputs=(Channel("air", "degC", "output"),),
    parameters=(
        Parameter("C", 12.0, "J/K", tolerance=0.2, meaning="heat of the element"),
        Parameter("P", 1.0, "W/%", tolerance=0.05, meaning="power of the element"),
        Parameter("G", 1.5, "W/K", tolerance=0.15, meaning="heat that the air takes"),
        Parameter("Ta", 21.0, "degC", tolerance=0.05, meaning="temperature of the room"),
        Parameter("tau", 0.8, "s", tolerance=0.2, meaning="a third of the way to the sensor"),
    ),
    equation=equation,
    measure=measure,
    dt=0.1,
    start=Start({"duty": 40.0}, ("T", "c1", "c2", "c3"), ("T", "c1", "c2", "c3")),
    noise={"air": 0.05},
)

STRANGER = Machine(
    PLANT,
    rates,
    outputs,
    start=(47.0, 47.0, 47.0, 47.0),
    places={},
    foreign={"glow": 2e-4, "sluggish": 0.01},
    lab=Lab(
        dts=(0.1, 0.2),
        seconds=(90.0, 120.0),
        noise=(0.05,),
        push=(0.3,),
        base=(40.0,),
        range=((0.0, 100.0),),
        open=(Course(10.0, 80.0, (4.0, 15.0)),),
        closed=(Course(35.0, 60.0, (10.0, 25.0)),),
        tracked=(0,),
        loops=(Loop(0, 0, 1.2, 0.12),),
        settle=20.0,
    ),
    fine=0.1,
    slowest=3.0,
)
