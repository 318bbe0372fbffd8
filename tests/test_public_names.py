"""The public lists: what is in them, what left them, and the examples of their docstrings."""

import subprocess
import sys
from importlib import import_module

import pytest

import workbench
from tests.public import MODULES, names


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
