"""The public lists: the modules whose names users import, read without importing them."""

import ast
import inspect
from pathlib import Path

ROOT = Path(__file__).parents[1]
MODULES = {
    "workbench": "workbench/__init__.pyi",
    "workbench.hammerstein": "workbench/hammerstein.py",
    "workbench.intervals": "workbench/intervals/__init__.pyi",
    "workbench.physics.effects": "workbench/physics/effects/__init__.py",
    "workbench.sweeps": "workbench/sweeps/__init__.py",
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


def docstring(module: str, name: str) -> str:
    """What stands at a public name: in a class or a function, or below a constant; "" where nothing does."""
    return _docstring(ROOT / MODULES[module], name)


def _docstring(path: Path, name: str) -> str:
    body = ast.parse(path.read_text("utf-8")).body
    for node, after in zip(body, [*body[1:], None], strict=True):
        if isinstance(node, ast.ImportFrom) and name in {a.asname or a.name for a in node.names}:
            return _docstring(_path(path, node), name)
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and node.name == name:
            return ast.get_docstring(node) or ""
        targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
        if any(isinstance(target, ast.Name) and target.id == name for target in targets):
            told = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
            return inspect.cleandoc(str(after.value.value)) if told else ""
    return ""


def _path(path: Path, node: ast.ImportFrom) -> Path:
    parts = (node.module or "").split(".")
    found = (path.parent if node.level else ROOT).joinpath(*parts)
    return found.with_suffix(".py") if found.with_suffix(".py").exists() else found / "__init__.py"
