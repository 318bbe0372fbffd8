"""The options of every command. Nothing heavy is imported here: help must not wait for a compiler."""

import argparse
from collections.abc import Callable
from typing import Any, NamedTuple

from studies import STUDIES

PLANT_HELP = "machine of the workbench, package.module:NAME, file.py:NAME, model (m.json) or plant file (NAME+extended.json)"
CONTROLLER_HELP = "controller written by design, or a law of your own: file.py:NAME, package.module:NAME"


def _positive(text: str) -> int:
    return _whole(text, 1)


def _seed(text: str) -> int:
    return _whole(text, 0)


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < 1e6:
        raise argparse.ArgumentTypeError(f"{text!r} is no duration in seconds: expected more than 0 and below 1e6")
    return value


def _whole(text: str, low: int) -> int:
    if not (text.isascii() and text.isdigit() and int(text) >= low):
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from {low} on")
    return int(text)


def _simulate(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("plant", metavar="PLANT", nargs="?", help=f"{PLANT_HELP}; with --replay only one of your own")
    sub.add_argument("--experiment", nargs="+", metavar="NAME", default=[], help="experiments of the machine's plan")
    sub.add_argument("--inputs-from", nargs="+", metavar="FILE", default=[], help="replay the inputs of measured records")
    sub.add_argument("--seed", type=_seed, help="seed of noise, disturbances and random set-points (default 0)")
    sub.add_argument("--noise-free", action="store_true", help="no noise and no disturbance")
    # how it was spelled until 0.1; works for one more version, with a note
    sub.add_argument("--quiet", dest="old_quiet", action="store_true", help=argparse.SUPPRESS)
    sub.add_argument("--effect", action="append", default=[], metavar="ID@PLACE:P=V", help="switch missing physics on")
    sub.add_argument("--parameter", action="append", default=[], metavar="P=V", help="change a physical parameter")
    sub.add_argument("--start", action="append", default=[], metavar="X=V", help="change a start value")
    sub.add_argument("--controller", metavar="FILE", help=f"close the loop with a {CONTROLLER_HELP}")
    sub.add_argument("--setpoint", action="append", default=[], metavar="Y=V,..", help="with --controller: hold these outputs")
    sub.add_argument("--duration", type=_seconds, metavar="S", help="with --setpoint: seconds (default 60)")
    sub.add_argument("--limits", metavar="FILE", help="with --controller: follow the set-points of [run] in a file of limits")
    sub.add_argument("--replay", metavar="FILE", help="run a stored counterexample again: plant, controller and all are in it")


def talk(sub: argparse.ArgumentParser, name: str) -> None:
    """--quiet and --verbose, of every command; `--quiet` of simulate has its old meaning for one more version."""
    group = sub.add_mutually_exclusive_group()
    if name != "simulate":
        group.add_argument("--quiet", action="store_true", help="write the answer and errors alone, no progress")
    group.add_argument("--verbose", action="store_true", help="say what each stage takes, too")


def _roles(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("--output", "--outputs", dest="outputs", metavar="A,B", help="output channels (default: by name)")
    sub.add_argument("--inputs", "--input", dest="inputs", metavar="A,B", help="input channels (default: by name)")


def _new(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("folder", metavar="FOLDER", help="the folder to make")
    sub.add_argument("records", nargs="*", metavar="RECORD", help="your logs, the last of several held out (default: an example)")
    _roles(sub)
    sub.add_argument("--schedule", metavar="A", help="scheduling channels (default: by name)")
    _file_dt(sub)


def _app(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("folder", metavar="FOLDER", nargs="?", help="the session, new or to go on with (default: under runs/)")
    sub.add_argument("--port", type=_seed, default=0, metavar="N", help="port on 127.0.0.1 (default: one that is free)")
    sub.add_argument("--no-browser", action="store_true", help="print the address, open nothing")


def _look(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "records", nargs="+", metavar="RECORD", help="records as a logger wrote them (text, Excel, MAT, Parquet, TDMS, MDF)"
    )
    _roles(sub)
    sub.add_argument("--schedule", metavar="A", help="scheduling channels (default: by name)")
    _file_dt(sub)


def _autotune(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("records", nargs="+", metavar="RECORD", help="a step, a relay or a loop in which input and output move")
    _roles(sub)
    _file_dt(sub)
    sub.add_argument("--sensitivity", type=float, default=1.6, metavar="MS", help="largest sensitivity |S| (default 1.6)")
    sub.add_argument("--effort", type=float, default=3.0, metavar="M", help="how hard it may act, see design (default 3)")
    sub.add_argument("--no-derivative", action="store_true", help="PI instead of PID")
    sub.add_argument("--cycle", type=float, metavar="S", help="cycle of the controller in s (default: some samples)")
    sub.add_argument("--present", metavar="KC,TI,TD", help="what is set now, in standard form, to be looked at beside it")
    sub.add_argument("--time-unit", default="s", metavar="U", help="of times: s (default) or min")


def _identify(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("records", nargs="+", metavar="RECORD", help="estimation records (text, Excel, MAT, Parquet, TDMS, MDF)")
    _roles(sub)
    sub.add_argument("--schedule", metavar="A", help="scheduling channel (default: by name); none: without one")
    sub.add_argument(
        "--model",
        default="all",
        metavar="M",
        help="lti, ilm, ssm, oe (one or two poles and a dead time), lpv-oe (by free runs, over the schedule), hammerstein "
        "(static curves of the inputs, lost signs of outputs), interval, several (lti,interval), all (lti,ilm,ssm,oe), or best: "
        "chosen on the estimation records",
    )
    sub.add_argument("--order", type=_positive, help="model order (default: chosen on the estimation records)")
    sub.add_argument(
        "--feedthrough",
        action=argparse.BooleanOptionalAction,
        help="lti, ssm: let inputs act within their own sample, or not (default: where the records show it)",
    )
    sub.add_argument(
        "--criterion",
        default="best",
        metavar="C",
        help="prediction: of the next sample; simulation: refined by the error of free runs; best: refined where parts of the "
        "records run better by it (default)",
    )
    _holdout(sub, "records that no model is made from, to score on", "--validate")
    _sample_time(sub, "their own, or one that suits the motion where they are sampled ten times too fast")
    sub.add_argument("--horizon", type=_positive, default=25, help="steps of the k-step prediction that is scored (default 25)")

    _accept(sub)
    _interval_options(sub)


def _compare(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("models", nargs="+", metavar="MODEL", help="model files written by identify")
    _holdout(sub, "records that no model was made from, to score on", "--records")
    sub.add_argument("--horizon", type=_positive, default=25, help="steps of the k-step prediction that is scored (default 25)")
    _accept(sub)


def _calibrate(sub: argparse.ArgumentParser) -> None:
    _plant_and_records(sub)
    sub.add_argument("--parameters", metavar="A,B", help="parameters to fit (default: all that have a tolerance)")
    sub.add_argument("--bound", action="append", default=[], metavar="P=LOW:HIGH", help="keep a parameter within a range")


def _diagnose(sub: argparse.ArgumentParser) -> None:
    _plant_and_records(sub)


def _design(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("kind", metavar="LAW", help="scheduled-pid, pid (fixed gains), mpc, or nmpc (on the plant's own equation)")
    sub.add_argument(
        "--model", required=True, metavar="MODEL", help="model file written by identify; or a plant without schedule, such as "
        "found/extended.json, for its linear model about its start",
    )  # fmt: skip
    sub.add_argument("--dt", type=float, metavar="S", help="a plant as --model: sample time of the law (default: the plant's)")
    knots = "scheduled-pid: schedule values with own gains (default 5), of several variables for all or for each (default 3)"
    sub.add_argument("--knots", metavar="N[,N..]", help=knots)
    sub.add_argument("--at", metavar="RHO", help="pid: schedule value it is made for (default: the middle)")
    sub.add_argument("--sensitivity", type=float, default=1.6, metavar="MS", help="largest sensitivity |S| (default 1.6)")
    sub.add_argument("--complementary", type=float, default=1.6, metavar="MT", help="largest |T| (default 1.6)")
    sub.add_argument(
        "--effort", type=float, default=3.0, metavar="M", help="largest control effort, in the least that is needed (default 3)"
    )
    sub.add_argument(
        "--objective",
        default="variance",
        metavar="O",
        help="within these margins: variance, the least of the outputs under the model's noise and load steps (default), or "
        "integral, the most integral action",
    )
    sub.add_argument(
        "--load",
        action="append",
        default=[],
        metavar="U=V,..",
        help="size of load steps at an input (default: what moves the outputs by four times the model's error, or 1 %% of the "
        "input's range, whichever is more)",
    )
    sub.add_argument(
        "--load-every",
        type=float,
        metavar="S",
        help="seconds from one load step to the next (default: ten times as the machine settles)",
    )
    sub.add_argument(
        "--size",
        action="append",
        default=[],
        metavar="Y=V,..",
        help="outputs that count as equally large (default: by unit inputs)",
    )
    sub.add_argument(
        "--setpoint", action="append", default=[], metavar="Y=V,..", help="usual set-point, which the law holds without an error"
    )
    for name, text in (("low", "lowest command"), ("high", "highest command"), ("rate", "largest rate of a command, per second")):
        sub.add_argument(f"--{name}", action="append", default=[], metavar="U=V,..", help=text)
    sub.add_argument("--filter", type=float, metavar="TF", help="time constant of the derivative filter in s (default 2 samples)")
    sub.add_argument("--no-derivative", action="store_true", help="PI instead of PID")
    sub.add_argument(
        "--setpoint-weight",
        type=float,
        default=1.0,
        metavar="B",
        help="share of the set-point in the proportional part, 0 to 1 (default 1)",
    )
    sub.add_argument(
        "--reference-model",
        action="append",
        default=[],
        metavar="Y=W,..",
        help="bandwidth in rad/s of what its set-point goes through, inf: nothing (default: what settles soonest, and overshoots "
        "by a fifth at most)",
    )
    sub.add_argument(
        "--step", action="append", default=[], metavar="Y=V,..", help="steps of set-points that the law is tried with (default: "
        "what unit inputs move, or limits allow; with --diagnosis half of the range of its records)",
    )  # fmt: skip
    sub.add_argument(
        "--path", action="append", default=[], metavar="Y,..", help="outputs whose set-points come as a smooth path: rate and "
        "acceleration are fed forward, there is no reference model",
    )  # fmt: skip
    sub.add_argument("--slew", action="append", default=[], metavar="Y=V,..", help="largest rate of its set-point, per second")
    sub.add_argument(
        "--fixed-gains", action="store_true", help="a scheduled law of which only the feedforward moves with the schedule"
    )
    sub.add_argument(
        "--no-feedforward", action="store_true", help="leave it to the integral to find the commands that hold a new set-point"
    )
    sub.add_argument("--plant", metavar="PLANT", help=f"try the law on it, not on the model; nmpc predicts with it: {PLANT_HELP}")
    sub.add_argument(
        "--diagnosis", metavar="FILE", help="pid, scheduled-pid: diagnosis.json of causes that the law cancels before the loop, "
        "where that pays (default of --plant: the extended.json beside it)",
    )  # fmt: skip
    sub.add_argument(
        "--early", action="store_true", help="with --diagnosis: paths are given as much early as the design says, so that a dead "
        "time need not be fought for",
    )  # fmt: skip
    sub.add_argument(
        "--solver",
        default="real-time-iteration",
        metavar="S",
        help="nmpc: real-time-iteration (default), or ipopt (slow)",
    )
    sub.add_argument("--horizon", type=int, default=20, metavar="N", help="mpc, nmpc: samples that it looks ahead (default 20)")
    sub.add_argument(
        "--move",
        type=float,
        metavar="W",
        help="mpc, nmpc: price of moving a command (default: the lowest that keeps |S| of the MPC)",
    )
    sub.add_argument("--keep", action="append", default=[], metavar="Y=A:B,..", help="mpc, nmpc: outputs to keep between A and B")
    sub.add_argument(
        "--tube", action="store_true", help="mpc: tighten limits so that no error that --records leave open breaks them"
    )
    sub.add_argument(
        "--until",
        metavar="LIMITS",
        help="limits.toml: lower the bound of |S| until check decides all of it on the model and --records",
    )
    errors = "--tube, --until"
    sub.add_argument(
        "--records", nargs="+", action="extend", default=[], metavar="RECORD", help=f"{errors}: records for the errors"
    )
    sub.add_argument("--lags", type=_positive, default=1, help=f"{errors}: samples of y and u that errors depend on (default 1)")
    sub.add_argument("--bound", metavar="E,E", help=f"{errors}: largest error of each output beyond its parameters")
    sub.add_argument("--fallback", metavar="FILE", help="mpc, nmpc: PID for when all else fails (default: designed here)")
    sub.add_argument("--robust-to", nargs="+", action="extend", default=[], metavar="MODEL", help="models that must be kept too")
    _accept(sub)


def _export(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("controller", metavar="CONTROLLER", help="controller file written by design")
    sub.add_argument(
        "--to", required=True, metavar="FORM", help="c (C99), st (IEC 61131-3), csv (gains), or json (gains, matrices of an MPC)"
    )
    sub.add_argument("--fallback", action="store_true", help="of an mpc or nmpc: the PID that it falls back on")
    sub.add_argument("--name", metavar="NAME", help="c, st: name of the functions or the block (default: from the law's name)")
    sub.add_argument("--float", action="store_true", help="c: single precision instead of double")


def _effects(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("plant", nargs="?", metavar="PLANT", help=f"{PLANT_HELP} (default: all machines)")


def _doctor(sub: argparse.ArgumentParser) -> None:
    del sub


def _check(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("--controller", required=True, metavar="FILE", help=CONTROLLER_HELP)
    sub.add_argument("--limits", required=True, metavar="FILE", help="what the loop must keep (TOML)")
    sub.add_argument("--model", metavar="MODEL", help="identified model (ssm.json, ..) on which limits are proved or refuted")
    sub.add_argument("--records", nargs="+", action="extend", default=[], metavar="RECORD", help="records that bound its errors")
    sub.add_argument("--plant", metavar="PLANT", help=f"search for the worst machine: {PLANT_HELP}")
    sub.add_argument(
        "--fitted", nargs="+", action="extend", default=[], metavar="FILE", help="diagnosis.json, calibration.json: intervals"
    )
    sub.add_argument("--lags", type=_positive, default=1, help="samples of y and u that errors may depend on (default 1)")
    sub.add_argument("--bound", metavar="E,E", help="largest error of each output beyond its parameters (default: the model's)")
    sub.add_argument(
        "--nodes", type=_positive, help="schedule values at which stability is proved (default 5, of each of several variables 3)"
    )
    sub.add_argument("--rate", type=float, metavar="R", help="prove stability while the schedule moves by up to R a second too")
    sub.add_argument("--runs", type=_positive, help="runs of the plant for each limit (default 400, 40 for an MPC)")
    sub.add_argument("--seed", type=_seed, default=0, help="seed of the searches (default 0)")
    sub.add_argument("--proof", metavar="FILE", help="write what every proof rests on (JSON), for someone else to check")


def _sweep(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("sweep", metavar="FILE", help="what varies, and what is run (TOML)")
    sub.add_argument("--jobs", type=_positive, default=1, metavar="N", help="processes side by side (default 1)")
    sub.add_argument("--scheduler", metavar="ADDRESS", help="run on the workers of a Dask scheduler: tcp://HOST:8786")
    sub.add_argument("--parquet", action="store_true", help="write sweep.parquet too (needs pyarrow)")
    sub.add_argument("--resume", action="store_true", help="finish the sweep in --out: rows that it holds are not run again")
    sub.add_argument("--plant", metavar="PLANT", help=f"instead of the file's: {PLANT_HELP}")
    sub.add_argument("--controller", metavar="FILE", help=f"instead of the file's: {CONTROLLER_HELP}")


def _report(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("folders", nargs="+", metavar="DIR", help="folder of a run that has written report.json")
    sub.add_argument("--title", metavar="TEXT", help="of a page of several runs (default: their names)")


def _study(sub: argparse.ArgumentParser) -> None:
    study: Any = sub.add_argument(
        "study",
        metavar="STUDY",
        help=", ".join(STUDIES).replace("web-winding", "web-winding (the whole chain)"),
    )
    study.completer = lambda **_: list(STUDIES)
    sub.add_argument("--data", metavar="DIR", help="use the records in this folder instead of simulated ones")
    sub.add_argument("--seed", type=_seed, default=1, help="seed of the simulated records (default 1)")
    sub.add_argument("--quick", action="store_true", help="fewer candidates; for a first look")
    sub.add_argument(
        "--cases",
        type=_positive,
        metavar="M",
        help="hidden-effects, strangers, compensation: cases (default 600, 400, 400); controller-comparison: seeds (20)",
    )
    sub.add_argument(
        "--jobs",
        type=_positive,
        metavar="N",
        help="processes side by side (default 2; 1 of real-records and those of --cases)",
    )
    sub.add_argument("--fresh", action="store_true", default=None, help="web-winding: compute every stage anew")


def _holdout(sub: argparse.ArgumentParser, text: str, old: str = "") -> None:
    """--holdout; `old` is how it was spelled until 0.1 and works for one more version."""
    sub.add_argument("--holdout", nargs="+", action="extend", default=[], metavar="RECORD", help=text)
    if old:
        sub.add_argument(
            old, dest="holdout", nargs="+", action="extend", default=argparse.SUPPRESS, metavar="RECORD", help=argparse.SUPPRESS
        )


def _sample_time(sub: argparse.ArgumentParser, default: str) -> None:
    sub.add_argument("--dt", type=_seconds, metavar="S", help=f"sample time to bring the records to (default: {default})")
    _file_dt(sub)


def _file_dt(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("--file-dt", type=_seconds, metavar="S", help="sample time of files that have no column of time")


def _accept(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "--accept", action="store_true", help="take an answer all the same that the referee does not hand out (exit code 3)"
    )


def _plant_and_records(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("records", nargs="+", metavar="RECORD", help="measured records, channels named as in the plant")
    sub.add_argument("--plant", required=True, metavar="PLANT", help=PLANT_HELP)
    _holdout(sub, "records to measure the gain on")
    sub.add_argument(
        "--anyway", action="store_true", help="take records that do not look like this plant's; what is refused is noted then"
    )
    _sample_time(sub, "the plant's, where records are sampled five times faster and more")
    _accept(sub)


def _interval_options(sub: argparse.ArgumentParser) -> None:
    group = sub.add_argument_group("options of --model interval")
    group.add_argument(
        "--semantics",
        metavar="S",
        help="what is promised: inclusion-all (default), inclusion-exact, overlap, inclusion-paper, or simulation",
    )
    group.add_argument("--form", choices=("delta", "shift"), help="form of the regressors (default delta)")
    group.add_argument("--fir", type=_positive, metavar="N", help="finite impulse response of N samples instead of order")
    group.add_argument(
        "--e-y", dest="output_error", type=float, metavar="E", help="bound on the error of the output (default: its noise)"
    )
    group.add_argument(
        "--e-u", dest="input_error", metavar="E,E", help="bounds on the errors of the inputs (default: half a quantum)"
    )
    group.add_argument(
        "--precision", type=float, metavar="P", help="modes along time, each of at least this precision, 0 < P <= 1"
    )
    group.add_argument("--shortest", type=_positive, metavar="N", help="a mode along time has at least N + 1 samples")
    group.add_argument(
        "--tolerance", type=float, metavar="T", help="raise the precision, within T, while no more modes are needed"
    )
    group.add_argument("--maximum-radius", action="store_true", help="precision from the largest radius of a mode, not the mean")
    group.add_argument("--intervals", type=_positive, metavar="N", help="a box for each of N equal intervals of the schedule")


class Command(NamedTuple):
    """A command: what it does, examples, and what adds its options to a parser."""

    summary: str
    epilog: str
    options: Callable[[argparse.ArgumentParser], None]
    into: bool = True  # whether it writes into a folder that --out names


COMMANDS = {
    "new": Command(
        "a folder to begin with that runs as it stands: records, plant, limits, and the commands that join them",
        "examples:\n  workbench new my-machine\n"
        "  workbench new my-machine log1.csv log2.csv --inputs U --outputs n --schedule way",
        _new,
        into=False,
    ),
    "app": Command(
        "the bench in the browser, on this machine alone: drop logs, and go from look to a checked controller",
        'examples:\n  workbench app\n  workbench app my-session\nit needs: pip install "gain-scheduling-workbench[app]"',
        _app,
        into=False,
    ),
    "simulate": Command(
        "run a plant through an experiment and write the record as CSV",
        "examples:\n  workbench simulate web-winding --experiment prbs1 --seed 3\n"
        "  workbench simulate web-winding --experiment prbs1 --effect coulomb@unwind:level=0.002\n"
        "  workbench simulate my_plant.py:PLANT --inputs-from record.csv\n"
        "  workbench simulate ssm.json --controller scheduled-pid.json --setpoint w3=100,theta=0\n"
        "  workbench simulate --replay counterexample.json",
        _simulate,
    ),
    "look": Command(
        "what records hold and what they cannot show: channels, ranges, resolution, gaps, excitation, feedback",
        "examples:\n  workbench look log.csv\n  workbench look a.csv b.csv --inputs U --output n --schedule way",
        _look,
    ),
    "identify": Command(
        "identify LPV models from records and score them on held-out ones",
        "example:\n  workbench identify a.csv b.csv --output w3 --inputs V1,V2 --schedule r2 --model ssm --holdout c.csv",
        _identify,
    ),
    "compare": Command(
        "score identified models on records and test their residuals",
        "example:\n  workbench compare ssm.json ilm.json --holdout c.csv d.csv",
        _compare,
    ),
    "autotune": Command(
        "a PID from one record of a step, a relay or a loop: the process that it shows, and gains in every form",
        "examples:\n  workbench autotune step.csv --inputs valve --output level\n"
        "  workbench autotune loop.csv --inputs u --output T --present 2.0,120,0 --time-unit min",
        _autotune,
    ),
    "calibrate": Command(
        "fit physical parameters of a plant to records, with the tolerances of its data sheet as prior",
        "examples:\n  workbench calibrate a.csv b.csv --plant web-winding --holdout c.csv\n"
        "  workbench calibrate a.csv --plant web-winding --parameters kE,D,B1 --bound kE=150:250",
        _calibrate,
    ),
    "diagnose": Command(
        "say what the simulation of a plant gets wrong on records, name the cause and extend the plant by it",
        "example:\n  workbench diagnose a.csv b.csv --plant web-winding --holdout c.csv --json d.json",
        _diagnose,
    ),
    "design": Command(
        "design a controller on an identified model, with bounds on robustness at every schedule value",
        "examples:\n  workbench design scheduled-pid --model ssm.json --setpoint w3=100,theta=0\n"
        "  workbench design pid --model ssm.json --at 0.018 --sensitivity 1.4\n"
        "  workbench design mpc --model ssm.json --low V1=0,V2=0 --high V1=5,V2=5 --keep theta=-20:20\n"
        "  workbench design mpc --model ssm.json --low V1=0,V2=0 --high V1=5,V2=5 --keep w3=60:140,theta=-20:20 \\\n"
        "    --tube --records a.csv b.csv\n"
        "  workbench design nmpc --model ssm.json --plant web-winding --fallback scheduled-pid.json",
        _design,
    ),
    "export": Command(
        "write a controller as source text or as tables for another program",
        "examples:\n  workbench export scheduled-pid.json --to c --name web_pid\n  workbench export scheduled-pid.json --to st\n"
        "  workbench export mpc.json --to json",
        _export,
    ),
    "effects": Command(
        "list the effects that a plant can lack: places, equations, units, and what tells them apart",
        "examples:\n  workbench effects\n  workbench effects welding-robot",
        _effects,
    ),
    "doctor": Command("check this machine: versions, threads, compiler cache, a short self-check", "", _doctor),
    "check": Command(
        "is a loop safe on every machine that the records leave open? proved, or refuted with a run that shows it",
        "examples:\n  workbench check --controller pid.json --limits limits.toml --model ssm.json --records a.csv b.csv\n"
        "  workbench check --controller pid.json --limits limits.toml --plant web-winding\n"
        "  workbench check --controller pid.json --limits limits.toml --plant found/extended.json --fitted found/diagnosis.json\n"
        "exit code 1 where anything failed; what failed runs again with workbench simulate --replay FILE",
        _check,
    ),
    "sweep": Command(
        "run a loop, a design, an identification or a diagnosis for many sets of values; rows are kept as they come",
        "examples:\n  workbench sweep sweep.toml --jobs 2\n  workbench sweep sweep.toml --out runs/mine --resume",
        _sweep,
    ),
    "report": Command(
        "draw the page of a run again from its files, or make one page of several runs",
        "examples:\n  workbench report runs/mine\n  workbench report models found checked --title 'Line 3' --out page",
        _report,
    ),
    "study": Command("run a study and write its report", "example:\n  workbench study web-winding", _study),
}
