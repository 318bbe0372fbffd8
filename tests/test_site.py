"""The documentation as a site: it is built without a warning, fetches nothing, and has a place for every public name."""

import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from tests.public import MODULES, names

ROOT = Path(__file__).parents[1]
NEEDED = ("mkdocs", "material", "mkdocstrings_handlers.python")
LOADED = re.compile(r"<(?:script|link|img|iframe|source)\b[^>]*?\b(?:src|href)=[\"']?((?:https?:)?//[^\"'\s>]+)")


def missing(module):
    try:
        return find_spec(module) is None
    except ModuleNotFoundError:  # a package above it is missing
        return True


@pytest.mark.slow
def test_the_site_is_built_strictly_and_loads_nothing_from_elsewhere(tmp_path):
    if any(missing(module) for module in NEEDED):
        pytest.skip('the site needs MkDocs: python -m pip install -e ".[docs]"')
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(tmp_path / "site")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stdout + done.stderr
    pages = {path.relative_to(tmp_path / "site").as_posix(): path.read_text("utf-8") for path in tmp_path.rglob("*.html")}
    sources = {path.relative_to(ROOT / "docs").with_suffix(".html").as_posix() for path in (ROOT / "docs").rglob("*.md")}
    assert sources <= set(pages)
    assert 'id="workbench.identify"' in pages["api/models.html"]
    for name, page in pages.items():
        assert not LOADED.findall(page), name
    for sheet in tmp_path.rglob("*.css"):
        assert not re.search(r"(?:url\(|@import)\s*[\"']?(?:https?:)?//", sheet.read_text("utf-8")), sheet.name


def test_every_public_name_has_one_place_in_the_reference():
    text = "\n".join(path.read_text("utf-8") for path in sorted((ROOT / "docs" / "api").glob("*.md")))
    listed = [name.rpartition(".") for name in re.findall(r"^::: ([\w.]+)$", text, re.MULTILINE)]
    assert all(name in names(module) for module, _, name in listed)
    public = set().union(*(names(module) for module in MODULES)) - {"__version__"}
    assert sorted(name for _, _, name in listed) == sorted(public)
