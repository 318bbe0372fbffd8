"""The public lists: the modules whose names users import, read without importing them."""

import ast
from pathlib import Path

ROOT = Path(__file__).parents[1]
MODULES = {
    "workbench": "workbench/__init__.pyi",
    "workbench.intervals": "workbench/intervals/__init__.pyi",
    "workbench.physics.effects": "workbench/physics/effects/__init__.py",
    "workbench.sweeps": "workbench/sweeps.py",
    "controllers": "controllers/__init__.pyi",
    "plants": "plants/__init__.py",
}


def names(module: str) -> set[str]:
    """What a module lists: a stub what it imports, another file its `__all__`."""
    tree = ast.parse((ROOT / MODULES[module]).read_text("utf-8"))
    if MODULES[module].endswith(".pyi"):
        return {a.asname or a.name for node in tree.body if isinstance(node, ast.ImportFrom) for a in node.names}
    (listed,) = (
        node.value
        for node in tree.body
        if isinstance(node, ast.Assign) and any(isinstance(t, ast.Name) and t.id == "__all__" for t in node.targets)
    )
    return set(ast.literal_eval(listed))
