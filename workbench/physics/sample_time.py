"""The sample time of a record against that of its machine: whether its time column is in another unit."""

import numpy as np

from workbench.records import field, record
from workbench.units import UNITS

OTHER_TIME = 300.0  # a record sampled so many times more slowly or faster than its machine has its time in another unit
SIXTY = (60.0, 3600.0)  # so has one that is sampled so many times more slowly or faster
SAME_TIMES = 0.02  # to within that


@record
class OtherTime:
    """What may be wrong with a time column, and what mends it."""

    question: str
    factor: float = field("")


def other_time(ratio: float) -> OtherTime | None:
    """What is wrong with the time of a record that is sampled every `ratio` sample times of its machine, None for nothing."""
    times = {name: unit.factor for name, unit in UNITS.items() if unit.quantity == "time"}
    for name, factor in times.items():
        if factor in SIXTY and abs(ratio / factor - 1.0) <= SAME_TIMES:
            return OtherTime(f"was its time in s, and taken for {name}", 1.0 / factor)
    sixty = any(abs(ratio * factor - 1.0) <= SAME_TIMES for factor in SIXTY)
    if not sixty and max(ratio, 1.0 / ratio) <= OTHER_TIME:
        return None
    unit = min(times, key=lambda name: abs(np.log(ratio * times[name])))
    return OtherTime(f"is its time in {unit}", times[unit])
