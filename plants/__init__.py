"""The simulated machines; a new one is a file here and a line in PLANTS."""

from plants.positioning_axis import POSITIONING_AXIS
from plants.web_winding import WEB_WINDING
from plants.welding_robot import WELDING_ROBOT

__all__ = ["PLANTS", "POSITIONING_AXIS", "WEB_WINDING", "WELDING_ROBOT"]

PLANTS = {plant.name: plant for plant in (WEB_WINDING, WELDING_ROBOT, POSITIONING_AXIS)}
"""The machines by the name that the command line knows them by.

    >>> sorted(PLANTS)
    ['positioning-axis', 'web-winding', 'welding-robot']
"""
