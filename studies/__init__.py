"""One question each, runnable; the command line. A study is a module with main(quick, ...)."""

from collections.abc import Callable
from functools import partial
from importlib import import_module
from types import ModuleType

#: The packages of this program.
PACKAGES = ("workbench", "controllers", "plants", "studies")

NAMES = (
    "web-winding", "winding-models", "welding-robot", "emps", "winding-records", "hidden-effects", "strangers", "real-records",
    "benchmarks", "controller-comparison", "robust-winding", "pid-bandwidth", "sampling-time", "noise-level", "record-count",
    "detection-rate", "compensation",
)  # fmt: skip

#: What imports a study, by its name.
STUDIES: dict[str, Callable[[], ModuleType]] = {
    name: partial(import_module, f"studies.{name.replace('-', '_')}") for name in NAMES
}
