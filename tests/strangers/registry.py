"""Every stranger by name."""

from types import ModuleType

from tests.strangers import (
    ball_in_tube,
    belt,
    cart_pendulum,
    conical_tank,
    crane,
    cylinder,
    fan,
    heater,
    propeller_arm,
    quadruple_tanks,
    quarter_car,
    rewinder,
    servo,
    two_mass,
)
from tests.strangers.bench import Machine

_MODULES: tuple[ModuleType, ...] = (
    rewinder, propeller_arm, cart_pendulum, two_mass, quadruple_tanks, conical_tank, heater, cylinder, ball_in_tube, servo, belt,
    fan, quarter_car, crane,
)  # fmt: skip

MACHINES: dict[str, Machine] = {module.STRANGER.name: module.STRANGER for module in _MODULES}
#: Where the command line finds the plant of each: package.module:NAME.
PLANT_OF = {module.STRANGER.name: f"{module.__name__}:PLANT" for module in _MODULES}
