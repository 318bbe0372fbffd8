"""Interval models, whose envelopes hold every sample: the names are listed in `__init__.pyi`, loaded when first used.

model = IntervalRegression(ARX(order=2), partition=BySchedule(5)).fit(data)
for line in cover(model, held_out, "held-out"):
    print(line)
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
