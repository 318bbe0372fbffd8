"""One question each, runnable; the command line. A study is a module with main(quick, ...)."""

from collections.abc import Callable
from types import ModuleType


def _web_winding() -> ModuleType:
    from studies import web_winding

    return web_winding


def _winding_models() -> ModuleType:
    from studies import winding_models

    return winding_models


def _welding_robot() -> ModuleType:
    from studies import welding_robot

    return welding_robot


def _emps() -> ModuleType:
    from studies import emps

    return emps


def _winding_records() -> ModuleType:
    from studies import winding_records

    return winding_records


def _hidden_effects() -> ModuleType:
    from studies import hidden_effects

    return hidden_effects


def _controller_comparison() -> ModuleType:
    from studies import controller_comparison

    return controller_comparison


def _robust_winding() -> ModuleType:
    from studies import robust_winding

    return robust_winding


def _pid_bandwidth() -> ModuleType:
    from studies import pid_bandwidth

    return pid_bandwidth


def _sampling_time() -> ModuleType:
    from studies import sampling_time

    return sampling_time


def _noise_level() -> ModuleType:
    from studies import noise_level

    return noise_level


def _record_count() -> ModuleType:
    from studies import record_count

    return record_count


def _detection_rate() -> ModuleType:
    from studies import detection_rate

    return detection_rate


STUDIES: dict[str, Callable[[], ModuleType]] = {
    "web-winding": _web_winding,
    "winding-models": _winding_models,
    "welding-robot": _welding_robot,
    "emps": _emps,
    "winding-records": _winding_records,
    "hidden-effects": _hidden_effects,
    "controller-comparison": _controller_comparison,
    "robust-winding": _robust_winding,
    "pid-bandwidth": _pid_bandwidth,
    "sampling-time": _sampling_time,
    "noise-level": _noise_level,
    "record-count": _record_count,
    "detection-rate": _detection_rate,
}
