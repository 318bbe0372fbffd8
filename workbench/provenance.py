"""Where a number comes from: data, configuration, seed and versions, in one dictionary."""

import platform
from collections.abc import Iterable, Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from workbench.files import sha256

PACKAGES = (
    "gain-scheduling-workbench", "numpy", "scipy", "control", "casadi", "numba", "cvxpy", "clarabel", "daqp", "highspy", "cma",
    "SALib",
)  # fmt: skip


def versions() -> dict[str, str]:
    """Version of Python and of every package that computes."""
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found


def program() -> str:
    """Name and version of this program, for files that are read by others."""
    return f"{PACKAGES[0]} {versions()[PACKAGES[0]]}"


def provenance(configuration: Mapping[str, Any], files: Iterable[str | Path] = (), seed: int | None = None) -> dict[str, Any]:
    """Configuration as given, SHA-256 of every data file, seed and versions. Files of one name go by their whole path."""
    paths = [Path(path) for path in files]
    names = [path.name for path in paths]
    keys = [path.name if names.count(path.name) == 1 else str(path) for path in paths]
    return {
        "configuration": dict(configuration),
        "data": {key: sha256(path) for key, path in zip(keys, paths, strict=True)},
        "seed": seed,
        "versions": versions(),
    }
