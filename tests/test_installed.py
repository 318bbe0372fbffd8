"""Installed from a wheel, the workbench works in a folder whose own packages are named like those of the workbench."""

import os
import shutil
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import pytest

from studies import PACKAGES

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[1]
SWEEP = """
run = "identification"
seeds = [1, 2]

[parameters.model]
values = ["lti"]

[fixed]
plant = "welding-robot"
inputs = ["u"]
outputs = ["v"]
experiments = ["rbs"]
held_out = ["prbs"]
"""


def can_build():
    """Whether the build backend is here: nothing is fetched for it."""
    try:
        return int(version("setuptools").split(".")[0]) >= 77
    except PackageNotFoundError:
        return False


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """The folder that the wheel was installed into."""
    if not can_build():
        pytest.skip('the wheel needs setuptools 77 or later: python -m pip install -e ".[test]"')
    source, target = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("installed")
    for package in PACKAGES:
        shutil.copytree(ROOT / package, source / package, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    wheels = source / "wheels"
    subprocess.run([*pip, "wheel", "--no-deps", "--no-build-isolation", "--no-index", "-w", wheels, source], check=True)
    (wheel,) = wheels.glob("*.whl")
    subprocess.run([*pip, "install", "--no-deps", "--no-index", "--target", target, wheel], check=True)
    return target


@pytest.fixture
def own(tmp_path):
    """A user's folder with packages of names that the workbench has too; none of them may be imported."""
    for name in ("plants", "studies"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("raise RuntimeError('this package is the user\\'s own')\n")
    return tmp_path


def run(installed, folder, *words):
    """A command in a folder, with the installed packages alone on the path."""
    environment = {**os.environ, "PYTHONPATH": str(installed)}
    return subprocess.run([*words], cwd=folder, env=environment, capture_output=True, text=True, timeout=300, check=False)


def workbench(installed, folder, *words):
    done = run(installed, folder, installed / "bin" / "workbench", *words)
    assert done.returncode == 0, done.stderr
    return done


def test_the_wheel_holds_all_that_is_read_at_run_time(installed):
    for name in ("__init__.pyi", "intervals/__init__.pyi", "py.typed"):
        assert (installed / "workbench" / name).is_file()
    scripts = {path.name for path in (ROOT / "workbench" / "report").glob("*.js")}
    assert scripts == {path.name for path in (installed / "workbench" / "report").glob("*.js")}
    assert not (installed / "tests").exists()


def test_the_command_takes_its_own_packages_and_not_those_of_the_folder(installed, own):
    assert "simulate" in workbench(installed, own, "--help").stdout
    workbench(installed, own, "simulate", "welding-robot", "--experiment", "rbs", "prbs", "--seed", "3", "--out", "robot")
    assert {path.name for path in (own / "robot").glob("*.csv")} == {"rbs.csv", "prbs.csv"}
    words = (
        "robot/rbs.csv",
        "--output",
        "v",
        "--inputs",
        "u",
        "--model",
        "lti",
        "--holdout",
        "robot/prbs.csv",
        "--out",
        "models",
    )
    workbench(installed, own, "identify", *words)
    assert (own / "models" / "report.html").is_file()


def test_processes_of_a_sweep_take_them_too(installed, own):
    (own / "sweep.toml").write_text(SWEEP)
    assert "2 runs, 0 failed" in workbench(installed, own, "sweep", "sweep.toml", "--jobs", "2", "--out", "swept").stdout


def test_python_imports_all_packages_in_another_folder(installed, tmp_path):
    code = "import workbench as wb, controllers, plants; print(wb.__file__, wb.Plant, controllers.MPC, plants.WEB_WINDING.name)"
    done = run(installed, tmp_path, sys.executable, "-c", code)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(str(installed))


def test_in_python_a_package_of_the_folder_goes_first_and_the_error_names_it(installed, own):
    (own / "plants" / "__init__.py").write_text("")
    done = run(installed, own, sys.executable, "-c", "import workbench, controllers; workbench.identify, controllers.MPC")
    assert done.returncode == 0, done.stderr
    done = run(installed, own, sys.executable, "-c", "from plants import WEB_WINDING")
    assert done.returncode == 1
    assert str(own / "plants" / "__init__.py") in done.stderr
    # with -P the folder is not on the path
    done = run(installed, own, sys.executable, "-P", "-c", "from plants import WEB_WINDING")
    assert done.returncode == 0, done.stderr
