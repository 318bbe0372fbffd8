"""The public lists: what is in them, what left them, and the examples of their docstrings."""

import doctest
import re
import subprocess
import sys
from importlib import import_module

import pytest

import workbench
from tests.public import MODULES, ROOT, docstring, names
from tests.test_docs import run_blocks

PUBLIC = [(module, name) for module in MODULES for name in sorted(names(module))]
EXAMPLES = {name: docstring(module, name) for module, name in PUBLIC}  # a name of two lists is one thing


@pytest.mark.parametrize("module", MODULES)
def test_every_listed_name_is_there(module):
    found = import_module(module)
    assert sorted(found.__all__) == sorted(names(module))
    assert all(hasattr(found, name) for name in names(module))


def test_the_list_at_the_top_stays_short():
    assert len(names("workbench")) <= 45


def test_names_that_left_the_top_work_there_for_one_more_version():
    for module, moved in workbench._MOVED.items():
        assert set(moved) <= names(module)
        for name in moved:
            assert name not in workbench.__all__
            assert name not in dir(workbench)
            assert getattr(workbench, name) is getattr(import_module(module), name)


def test_a_name_that_is_nowhere_is_said_to_be_missing():
    with pytest.raises(AttributeError, match="no_such_name"):
        workbench.no_such_name  # noqa: B018


def test_importing_the_workbench_loads_no_numerical_package():
    code = "import sys, workbench, workbench.intervals; assert 'numpy' not in sys.modules, sorted(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize(("module", "name"), PUBLIC)
def test_every_public_name_says_what_it_is_and_shows_it(module, name):
    found = docstring(module, name)
    first = found.split("\n\n")[0]
    assert len(first) > 20, "a sentence or an equation that says what it computes"
    assert "see the module" not in found.lower(), "a reader of the reference does not see the module"
    assert re.search(r"^ *>>> ", found, re.MULTILINE), "an example that runs: docs/api/examples.md says with which names"
    assert "+SKIP" not in found


@pytest.fixture(scope="module")
def ground(tmp_path_factory):
    """The folder and the names that docs/api/examples.md makes, and every public name."""
    made: dict = {"__name__": "examples"}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("examples"))
        run_blocks(ROOT / "docs" / "api" / "examples.md", made)
        yield {name: getattr(import_module(module), name) for module, name in PUBLIC} | made


@pytest.mark.slow
@pytest.mark.parametrize("name", EXAMPLES)
def test_its_example_gives_what_it_says(name, ground):
    example = doctest.DocTestParser().get_doctest(EXAMPLES[name], dict(ground), name, None, None)
    said: list[str] = []
    flags = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    result = doctest.DocTestRunner(optionflags=flags).run(example, out=said.append)
    assert result.attempted > 0
    assert result.failed == 0, "".join(said)
