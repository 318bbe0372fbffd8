"""The house of design: packages import only downwards, no cycles in the workbench. Reads imports, imports nothing."""

import ast
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[1]
MAY_IMPORT = {
    "workbench": {"workbench"},
    "controllers": {"workbench", "controllers"},
    "plants": {"workbench", "plants"},
    "studies": {"workbench", "controllers", "plants", "studies"},
}


def modules():
    """Dotted name -> path of every module of the four packages."""
    found = {}
    for package in MAY_IMPORT:
        for path in (ROOT / package).rglob("*.py"):
            parts = path.relative_to(ROOT).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imports(path, *, only_at_import_time=False):
    """Dotted names a module imports; names inside functions and under TYPE_CHECKING do not run at import time."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    skipped = set()
    if only_at_import_time:
        for node in ast.walk(tree):
            inner = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
            checking = isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
            if inner or checking:
                skipped.update(ast.walk(node))
    names = set()
    for node in ast.walk(tree):
        if node in skipped:
            continue
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            names.add(node.module or "")
            names.update(f"{node.module}.{alias.name}" for alias in node.names)
    return names


@pytest.mark.parametrize("name", sorted(modules()))
def test_packages_import_only_downwards(name):
    own = name.split(".")[0]
    for imported in imports(modules()[name]):
        package = imported.split(".")[0]
        if package in MAY_IMPORT:
            assert package in MAY_IMPORT[own], f"{name} imports {imported}"


def test_no_cycles_at_import_time():
    known = modules()
    graph = {
        name: {target for target in imports(path, only_at_import_time=True) if target in known and target != name}
        for name, path in known.items()
    }

    def visit(name, trail):
        assert name not in trail, " -> ".join([*trail, name])
        if name not in done:
            for target in graph[name]:
                visit(target, [*trail, name])
            done.add(name)

    done = set()
    for name in graph:
        visit(name, [])


def test_only_the_report_draws():
    for name, path in modules().items():
        if not name.startswith("workbench.report"):
            assert not any(imported.startswith("matplotlib") for imported in imports(path)), name


def test_no_pickle_no_eval_no_network():
    for name, path in modules().items():
        tree = ast.parse(path.read_text(encoding="utf-8"))
        used = {node.func.id for node in ast.walk(tree) if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)}
        assert not used & {"eval", "exec"}, name
        assert not {i.split(".")[0] for i in imports(path)} & {"pickle", "socket", "requests", "http"}, name
