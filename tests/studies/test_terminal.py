"""--quiet and --verbose of every command, and colours on a terminal alone."""

import io

import pytest

from studies import terminal
from studies.cli import main, parser
from studies.options import COMMANDS

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


class Terminal(io.StringIO):
    def isatty(self):
        return True


def own_options(name):
    """The spellings of a command that its help shows."""
    (commands,) = (a for a in parser()._actions if hasattr(a, "choices") and a.choices and "simulate" in a.choices)
    assert commands.choices
    words = dict(commands.choices)[name].format_help().replace(",", " ").replace("]", " ").replace("[", " ").split()
    return {word for word in words if word.startswith("--")}


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_says_less_and_more(name):
    assert "--verbose" in own_options(name)
    assert ("--quiet" in own_options(name)) == (name != "simulate")  # there it was another word for --noise-free


@pytest.fixture
def sweep(tmp_path):
    path = tmp_path / "sweep.toml"
    path.write_text(SWEEP)
    return lambda *words: main(["sweep", str(path), "--out", str(tmp_path / "swept"), *words])


def test_progress_is_told_with_the_time_left_and_silenced_by_quiet(sweep, capsys, tmp_path):
    assert sweep() == 0
    loud = capsys.readouterr()
    assert "1 of 2 runs, " in loud.err
    assert " left" in loud.err
    assert "2 of 2 runs" in loud.err
    (tmp_path / "swept" / "sweep.sqlite").unlink()
    assert sweep("--quiet") == 0
    quiet = capsys.readouterr()
    assert quiet.err == ""
    assert quiet.out.splitlines()[1:] == loud.out.splitlines()[1:]  # the first says how long it took


def test_quiet_does_not_silence_errors(capsys):
    assert main(["compare", "nowhere.json", "--quiet"]) == 2
    assert "mend: give --holdout" in capsys.readouterr().err


def test_verbose_says_what_stages_take(monkeypatch, capsys):
    now = [0.0]
    monkeypatch.setattr(terminal.time, "monotonic", lambda: now[0])
    now[0] = 5.0
    terminal.begin(verbose=True)
    for text, seconds in (("screening", 2.5), ("refitting", 0.01), ("drawing", 1.0)):
        terminal.progress(text)
        now[0] += seconds
    terminal.end()
    said = capsys.readouterr().err.splitlines()
    assert said == ["  screening", "    took 2.5 s", "  refitting", "  drawing", "    took 1.0 s", "  3.5 s in all"]
    terminal.progress("later")
    assert capsys.readouterr().err == "  later\n"


def test_quiet_and_verbose_exclude_each_other(capsys):
    with pytest.raises(SystemExit):
        main(["effects", "--quiet", "--verbose"])
    assert "not allowed with" in capsys.readouterr().err


def test_the_old_spelling_of_noise_free_works_and_says_so(tmp_path, capsys):
    common = ["simulate", "welding-robot", "--experiment", "steps", "--out"]
    assert main([*common, str(tmp_path / "new"), "--noise-free"]) == 0
    assert capsys.readouterr().err == ""
    assert main([*common, str(tmp_path / "old"), "--quiet"]) == 0
    assert "note: --quiet is --noise-free now" in capsys.readouterr().err
    assert (tmp_path / "old" / "steps.csv").read_bytes() == (tmp_path / "new" / "steps.csv").read_bytes()
    assert main([*common, str(tmp_path / "noisy")]) == 0
    assert (tmp_path / "noisy" / "steps.csv").read_bytes() != (tmp_path / "new" / "steps.csv").read_bytes()


def test_colours_are_for_a_terminal_alone(monkeypatch):
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setenv("TERM", "xterm")
    shown, piped = Terminal(), io.StringIO()
    for stream in (shown, piped):
        monkeypatch.setattr("sys.stdout", stream)
        terminal.say("FAILED n: high\nnothing FAILED here")
    assert shown.getvalue() == "\x1b[31mFAILED\x1b[0m n: high\nnothing FAILED here\n"
    assert piped.getvalue() == "FAILED n: high\nnothing FAILED here\n"
    monkeypatch.setenv("NO_COLOR", "1")
    plain = Terminal()
    monkeypatch.setattr("sys.stdout", plain)
    terminal.say("FAILED n: high")
    assert plain.getvalue() == "FAILED n: high\n"
