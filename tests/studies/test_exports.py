"""`workbench export`: what is written in each form, and what is refused without a trace."""

import json
from dataclasses import replace

import numpy as np
import pytest

from controllers.code.c99 import c_code
from controllers.code.structured_text import st_code
from controllers.files import save_controller
from controllers.mpc import design_mpc
from controllers.nmpc import design_nmpc
from controllers.pid import pid
from controllers.scheduled_pid import ScheduledPID
from plants import WELDING_ROBOT
from studies.cli import main
from tests.controllers.test_mpc import lpv
from workbench.basis import Gaussian, PiecewiseLinear


@pytest.fixture
def law():
    gains = {key: np.arange(1.0, 5.0).reshape(2, 2, 1) for key in ("Kp", "Ki", "Kd", "Kr")}
    return ScheduledPID(
        ("V1", "V2"), ("w3",), ("w3_set",), 0.04, **gains, u0=np.ones((2, 2)), b=[0.5], c=[0.0], low=[0.0, 0.0],
        high=[5.0, np.inf], rate=[np.inf] * 2, Tf=0.1, basis=PiecewiseLinear((0.01, 0.03)), schedule="r2", span=(0.01, 0.03),
        units={"V1": "V", "w3": "rad/s"},
    )  # fmt: skip


def exported(tmp_path, controller, *options):
    """Exit code, and the files' contents by name."""
    file = save_controller(controller, tmp_path / "law.json")
    code = main(["export", str(file), *options, "--out", str(tmp_path / "out")])
    return code, {path.name: path.read_text() for path in (tmp_path / "out").glob("*")}


def test_each_form_writes_its_files(tmp_path, law, capsys):
    code, files = exported(tmp_path, law, "--to", "c", "--name", "web", "--float", "--json", str(tmp_path / "e.json"))
    assert code == 0
    header, source = c_code(law, "web", single=True)
    assert {name: files[name] for name in ("web.h", "web.c")} == {"web.h": header, "web.c": source}
    result = json.loads(files["export.json"])
    assert result == json.loads((tmp_path / "e.json").read_text())
    assert (result["files"], list(result["provenance"]["data"])) == (["web.h", "web.c"], ["law.json"])
    assert exported(tmp_path, law, "--to", "st")[1]["scheduled_pid.st"] == st_code(law, "scheduled_pid")
    assert exported(tmp_path, law, "--to", "csv")[1]["gains.csv"].startswith("r2 [],Kp_V1_w3 [V/(rad/s)],Kp_V2_w3,")
    gains = json.loads(exported(tmp_path, law, "--to", "json")[1]["gains.json"])
    assert gains["rows"][1] == {
        "rho": 0.03,
        "Kp": [[3.0], [4.0]],
        "Ki": [[3.0], [4.0]],
        "Kd": [[3.0], [4.0]],
        "Kr": [[3.0], [4.0]],
        "u0": [1.0, 1.0],
    }
    assert gains["high"] == [5.0, None]
    said = capsys.readouterr().out
    assert f"c -> {tmp_path / 'out' / 'web.c'}" in said
    assert "rows: 2; linear between them, which differs from the law by at most: Kp" in said


def test_what_a_table_leaves_out_is_said(tmp_path, law, capsys):
    assert exported(tmp_path, replace(law, basis=Gaussian((0.01, 0.03), (3e4, 3e4))), "--to", "csv")[0] == 0
    found = dict(part.split() for part in capsys.readouterr().out.splitlines()[0].partition("at most: ")[2].split(", "))
    assert 0.0 < float(found["Kp"]) < 0.1


def test_an_mpc_is_its_matrices_and_its_fallback_law(tmp_path, capsys):
    fallback = pid(("a", "b"), ("c", "d"), ("c_set", "d_set"), 0.1, [0.1, 0.1], [0.2, 0.2], low=-3.0, high=2.0)
    controller = design_mpc(lpv(), fallback)
    content = json.loads(exported(tmp_path, controller, "--to", "json")[1]["matrices.json"])
    assert (content["horizon"], content["disturbances"], np.shape(content["rows"][0]["P"])) == (20, "inputs", (5, 5))
    capsys.readouterr()
    files = exported(tmp_path, controller, "--to", "st", "--fallback", "--name", "reserve")[1]
    assert files["reserve.st"] == st_code(fallback, "reserve")
    assert "this is pid, the law that mpc falls back on" in capsys.readouterr().out
    for form in ("c", "st", "csv"):  # a build that asks for the MPC must not get a PID
        assert main(["export", str(tmp_path / "law.json"), "--to", form, "--out", str(tmp_path / form)]) == 2
        assert "an MPC needs a solver" in capsys.readouterr().err
        assert not (tmp_path / form).exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--to", "cpp"], "unknown form 'cpp'"),
        (["--to", "json", "--float"], "--float with --to json\n  mend: leave it out: it is for --to c"),
        (["--to", "st", "--float"], "--float with --to st"),
        (["--to", "csv", "--name", "web"], "--name with --to csv\n  mend: leave it out: it is for --to c and st"),
        (
            ["--to", "c", "--name", "web-pid"],
            "law.json: 'web-pid' is no name in C and Structured Text\n  mend: give a name of letters",
        ),
        (["--to", "c", "--name", ""], "'' is no name"),
        (["--to", "c", "--fallback"], "a PID falls back on nothing"),
        (["--to", "st", "--name", "command"], "law.json: 'command' is a word of Structured Text or a variable of the block"),
    ],
)
def test_slips_are_named(tmp_path, law, capsys, options, message):
    code, files = exported(tmp_path, law, *options)
    assert (code, files) == (2, {})
    assert message in capsys.readouterr().err


def test_a_file_that_is_no_controller_is_refused(tmp_path, capsys):
    lpv().save(tmp_path / "m.json")
    assert main(["export", str(tmp_path / "m.json"), "--to", "c"]) == 2
    assert "not a controller" in capsys.readouterr().err
    content = {"schema": "gain-scheduling-workbench/controller", "version": 1, "kind": "relay"}
    (tmp_path / "n.json").write_text(json.dumps(content))
    assert main(["export", str(tmp_path / "n.json"), "--to", "c"]) == 2
    assert "unknown kind of controller 'relay'" in capsys.readouterr().err


def test_a_nonlinear_mpc_leaves_the_law_that_it_falls_back_on(tmp_path, capsys):
    fallback = pid(("u",), ("v",), ("v_set",), 0.02, [0.5], [1.0], low=-10.0, high=10.0, name="speed")
    save_controller(design_nmpc(WELDING_ROBOT, fallback), tmp_path / "n.json")
    save_controller(fallback, tmp_path / "p.json")
    for source, own in (("n", ["--fallback"]), ("p", [])):
        assert main(["export", str(tmp_path / f"{source}.json"), "--to", "c", *own, "--out", str(tmp_path / source)]) == 0
    assert "this is speed, the law that nmpc falls back on" in capsys.readouterr().out
    assert (tmp_path / "n" / "speed.c").read_text() == (tmp_path / "p" / "speed.c").read_text()
