"""Controllers and their design: the names of `from controllers import ...`, listed in `__init__.pyi`.

law = ScheduledPIDDesign(sensitivity=1.6).on(model)
law.export("c", "firmware")
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
