"""What all commands share: options, words, exit codes, signals.

Errors are sentences.
"""

import errno
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from report_cases import two_storeys

from pysindy_nrf import datasets, laws
from pysindy_nrf.cli import ExitCode, cli, run

PAGE = (Path(__file__).parents[2] / "docs" / "command_line.md").read_text("utf-8")
COMMANDS = list(cli.commands)
READ_NONE = ("app", "demo", "plan", "laws")
READ_FILES = [name for name in COMMANDS if name not in READ_NONE]
SHARED = [
    "--map",
    "--unit",
    "--fs",
    "--coordinates",
    "--mapping",
    "--law",
    "--link",
    "--known-mass",
    "--band",
]
MISTAKES = [
    ("--map", ["x1"], "'x1' is not of the form CHANNEL=COLUMN"),
    ("--map", ["x1=p", "x1=q"], "x1= is given twice"),
    ("--unit", ["x1=mm", "x1=in"], "x1= is given twice"),
    ("--law", ["storey 1"], "'storey 1' is not of the form SITE=NAME+NAME"),
    ("--law", ["storey 1=dahl+rubber"], "there is no law 'rubber'"),
    ("--order", ["storey 2"], "'storey 2' is not of the form SITE=DEGREE"),
    ("--order", ["storey 2=high"], "'high' is not a degree"),
    ("--order", ["storey 2=2", "storey 2=5"], "storey 2= is given twice"),
    ("--link", ["brace 3-1"], "'brace 3-1' is not a site"),
    ("--link", ["link 2-2"], "'link 2-2' joins DOF 2 to itself"),
    ("--known-mass", ["two=3"], "'two=3' is not a floor and its mass"),
    ("--known-mass", ["2=12.4", "2=12.5"], "2= is given twice"),
    ("--band", ["5"], "'5' is not a band"),
]


def commands_with(option):
    """Commands with an option, and how each declares it."""
    declared = {}
    for name, command in cli.commands.items():
        for parameter in command.params:
            if option in parameter.opts:
                declared[name] = parameter
    return declared


def process(*arguments, **environment):
    """The command line as a process of its own."""
    return subprocess.run(
        [sys.executable, "-m", "pysindy_nrf", *arguments],
        capture_output=True,
        text=True,
        env={**os.environ, **environment},
        timeout=60,
    )


def is_sentence(text):
    """Whether an error is told in words, and not as a fault of the program."""
    return bool(
        text.strip() and "Traceback" not in text and "fault of pysindy-nrf" not in text
    )


# -- options -------------------------------------------------------------------


@pytest.mark.parametrize("option", SHARED)
def test_an_option_is_declared_once(option):
    declarations = []
    for parameter in commands_with(option).values():
        kind = {"kind": type(parameter.type), "callback": parameter.callback}
        declarations.append(parameter.to_info_dict() | kind)
    assert declarations
    assert all(other == declarations[0] for other in declarations)


@pytest.mark.parametrize(("option", "values", "words"), MISTAKES)
def test_a_mistake_is_named_alike_in_every_command(
    option, values, words, capsys, monkeypatch
):
    monkeypatch.setenv("COLUMNS", "500")
    arguments = []
    for value in values:
        arguments += [option, value]

    errors = set()
    for name in commands_with(option):
        assert run([name, "3", *arguments]) == ExitCode.USAGE
        shown = capsys.readouterr()
        assert not shown.out
        errors.add(re.search("^Error: .*", shown.err, re.MULTILINE)[0])
    assert len(errors) == 1
    assert f"Invalid value for '{option}': {words}" in errors.pop()


def test_links_by_any_spelling_are_the_link(capsys):
    answers = set()
    for text in ("link 3-1", "link 1-3", " link  3-1 "):
        assert run(["plan", "3", "--link", text, "--json"]) == 0
        answers.add(capsys.readouterr().out)
    assert len(answers) == 1


def test_every_law_by_name_stands_alone():
    """--law SITE=NAME makes a law without arguments; every name must allow it."""
    for name, law in laws.registry().items():
        if name != "power_series":  # it gets the degree
            assert law().name == name


# -- errors --------------------------------------------------------------------


@pytest.fixture
def unforced(here):
    """A file with a displacement, and a column that may be a force."""
    t = np.arange(300) / 100
    table = pd.DataFrame({"t": t, "x1": np.sin(5 * t), "p": np.cos(5 * t)})
    table.to_csv("a.csv", index=False)
    return here


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["identify"], ExitCode.USAGE, "FILE"),
        (["identify", "a.csv", "--degree", "2.5"], ExitCode.USAGE, "degree"),
        (["identify", "a.csv", "--kind", "mobility"], ExitCode.USAGE, "--frf only"),
        (["conquer"], ExitCode.USAGE, "conquer"),
        ([], ExitCode.USAGE, "identify"),
        (["identify", "nowhere.csv"], ExitCode.DATA, "nowhere.csv does not exist"),
        (["identify", "a.csv", "--map", "x1=q"], ExitCode.DATA, "no variable 'q'"),
        (["identify", "a.csv"], ExitCode.DATA, "nothing scales the chain"),
        (["identify", "a.csv", "--known-mass", "9=1"], ExitCode.DATA, "DOF 9"),
        (
            ["identify", "a.csv", "--map", "F1=p", "--band", "0,999"],
            ExitCode.DATA,
            "Nyquist",
        ),
        (
            ["identify", "a.csv", "--map", "F1=p", "--order", "storey 7=2"],
            ExitCode.DATA,
            "storey 7",
        ),
    ],
)
def test_errors_are_sentences_with_exit_codes(unforced, capsys, arguments, code, words):
    assert run(arguments) == code
    shown = capsys.readouterr()
    assert words in shown.err
    assert "Traceback" not in shown.err + shown.out
    assert not (unforced / "nrf_output").exists()


def test_an_error_of_the_library_names_the_option_of_its_argument(unforced, capsys):
    assert run(["identify", "a.csv"]) == ExitCode.DATA
    assert "On the command line: --known-mass" in capsys.readouterr().err


def test_errors_of_a_process_go_to_the_error_stream(here):
    done = process("identify", "nowhere.csv")
    assert done.returncode == ExitCode.DATA
    assert done.stdout == ""
    assert done.stderr.startswith("Error: nowhere.csv")


NO_SPACE = OSError(errno.ENOSPC, "No space left on device", "nrf_output/model.json")
FAULTS = [
    (MemoryError(), ExitCode.OTHER, "Not enough memory"),
    (RecursionError(), ExitCode.OTHER, "nested too deeply"),
    (NO_SPACE, ExitCode.OTHER, "model.json: No space left"),
    (RuntimeError("boom"), ExitCode.OTHER, "RuntimeError: boom"),
    (KeyboardInterrupt(), ExitCode.INTERRUPTED, "Stopped"),
]


@pytest.fixture
def failing():
    """A function that makes a command ``falls``, which ends in a fault."""

    def make(fault):
        @cli.command("falls")
        def falls():
            raise fault

    yield make
    del cli.commands["falls"]


@pytest.mark.parametrize(("fault", "code", "words"), FAULTS)
def test_every_fault_is_a_sentence_with_a_code(capsys, failing, fault, code, words):
    failing(fault)
    assert run(["falls"]) == code
    shown = capsys.readouterr()
    assert words in shown.err
    assert "Traceback" not in shown.err
    assert not shown.out


@pytest.mark.parametrize("command", READ_FILES)
@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["nowhere.csv"],
        ["bad.csv"],
        ["nowhere.csv", "bad.csv"],
        ["--nonsense"],
        ["."],
        [""],
    ],
    ids=" ".join,
)
def test_no_command_shows_a_traceback(command, arguments, here, capsys):
    (here / "bad.csv").write_bytes(np.random.default_rng(0).bytes(500))
    assert run([command, *arguments]) in (ExitCode.USAGE, ExitCode.DATA)
    shown = capsys.readouterr()
    assert is_sentence(shown.err)
    assert "Traceback" not in shown.out
    assert [path.name for path in here.iterdir()] == ["bad.csv"]


def test_exit_codes_are_those_of_the_page():
    table = re.findall(r"^\| (\d+) \| ([\w ]+)", PAGE, re.MULTILINE)
    codes = {int(code): words for code, words in table}
    assert set(codes) == set(ExitCode)
    assert codes[ExitCode.USAGE] == "wrong usage"
    assert codes[ExitCode.INTERRUPTED] == "stopped by Ctrl"


# -- extras --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("package", "extra", "kind"),
    [
        pytest.param("matplotlib", "plot", "png", marks=pytest.mark.slow),
        ("jinja2", "report", "html"),
    ],
)
def test_without_an_extra_the_rest_is_written_and_the_extra_named(
    here, capsys, monkeypatch, demo_file, package, extra, kind
):
    monkeypatch.setitem(sys.modules, package, None)
    assert run(["identify", demo_file, "--degree", "1"]) == 0
    assert f"pip install 'pysindy-nrf[{extra}]'" in capsys.readouterr().out
    written = Path("nrf_output")
    assert (written / "masses.csv").exists()
    assert not list(written.glob(f"*.{kind}"))


def test_a_missing_reader_is_named(here, capsys, monkeypatch):
    Path("a.h5").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(600))
    monkeypatch.setitem(sys.modules, "h5py", None)
    assert run(["inspect", "a.h5"]) == ExitCode.OTHER
    assert "pysindy_nrf[files]" in capsys.readouterr().err


# -- help ----------------------------------------------------------------------


def test_help_says_what_to_do_first(capsys):
    assert run(["--help"]) == 0
    text = capsys.readouterr().out
    assert "Exit codes" in text
    assert text.index("pysindy-nrf demo") < text.index("pysindy-nrf identify")


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_every_command(command, capsys):
    assert run([command, "--help"]) == 0
    text = capsys.readouterr().out
    # the page of app is for people
    assert "--json" in text or command == "app"
    assert f"pysindy-nrf {command}" in text
    assert f"`{command}" in PAGE


@pytest.mark.parametrize("command", [name for name in COMMANDS if name != "demo"])
def test_examples_of_help_stand_on_lines_of_their_own(command, capsys):
    assert run([command, "--help"]) == 0
    examples = capsys.readouterr().out.split("Examples\n")[1].split("Options:")[0]
    lines = [line.strip() for line in examples.strip().splitlines()]
    assert all(line.startswith(f"pysindy-nrf {command}") for line in lines)
    assert all(line.count("pysindy-nrf") == 1 for line in lines)


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_a_shell_completes_commands(shell, monkeypatch, capsys):
    """The variable and the words of the page are those that the program answers to."""
    assert f"_PYSINDY_NRF_COMPLETE={shell}_source" in PAGE
    monkeypatch.setenv("_PYSINDY_NRF_COMPLETE", f"{shell}_complete")
    monkeypatch.setenv("COMP_WORDS", "pysindy-nrf se")
    monkeypatch.setenv("COMP_CWORD", "1" if shell == "zsh" else "se")
    with pytest.raises(SystemExit, match="0"):
        run([])
    assert "select-order" in capsys.readouterr().out


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_a_shell_reads_how_to_complete(shell, monkeypatch, capsys):
    monkeypatch.setenv("_PYSINDY_NRF_COMPLETE", f"{shell}_source")
    with pytest.raises(SystemExit, match="0"):
        run([])
    assert "pysindy-nrf" in capsys.readouterr().out


# -- signals and streams -------------------------------------------------------

SWALLOW = """
import ctypes, signal, time
from pysindy_nrf.cli import cli, main

@cli.command()
def swallow():
    def callback():
        raise KeyboardInterrupt
    ctypes.CFUNCTYPE(None)(callback)()
    time.sleep(600)
    print("not heard")

# a shell's background ignores it
signal.signal(signal.SIGINT, signal.default_int_handler)
main(["swallow"])
"""


def test_ctrl_c_that_a_callback_swallows_is_heard_all_the_same(here):
    """Python drops what is raised in a callback of compiled code: it comes again."""
    done = subprocess.run(
        [sys.executable, "-c", SWALLOW], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == ExitCode.INTERRUPTED
    assert "Stopped" in done.stderr
    assert "Traceback" not in done.stderr
    assert "not heard" not in done.stdout


def test_a_terminal_that_knows_only_ascii(here):
    """Signs it lacks are shown as codes; no command fails on its own words."""
    table = datasets.load_demo().to_frame().rename(columns={"a1": "Größe µ"})
    table.to_csv("odd.csv")
    ascii_only = {"PYTHONIOENCODING": "ascii", "LC_ALL": "C", "PYTHONUTF8": "0"}
    done = process("inspect", "odd.csv", "--map", "a1=Größe µ", **ascii_only)
    assert done.returncode == 0, done.stderr
    assert "Gr" in done.stdout


def first_line(*arguments):
    """A command whose reader leaves after one line, as ``| head -1`` does."""
    command = [sys.executable, "-m", "pysindy_nrf", *arguments]
    pipe = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, **pipe) as running:
        line = running.stdout.readline()
        running.stdout.close()
        errors = running.stderr.read()
        code = running.wait(60)
    return line, errors, code


def test_a_reader_that_leaves_is_no_error(here):
    line, errors, code = first_line("plan", "8")
    assert line.startswith("Hit floor")
    assert errors == ""
    assert code == 0


@pytest.mark.slow
def test_a_reader_that_leaves_loses_no_results(here, demo_file):
    line, errors, code = first_line("identify", demo_file, "--degree", "1")
    assert line == "What was measured\n"
    assert "Error" not in errors
    assert code == 0
    written = {path.name for path in Path("nrf_output").iterdir()}
    assert {"model.json", "masses.csv", "manifest.json"} <= written


def test_results_that_cannot_be_written_are_printed(
    here, capsys, monkeypatch, demo_file
):
    def no_space(handle):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", no_space)
    command = ["identify", demo_file, "--degree", "1", "--no-figures"]
    assert run(command) == ExitCode.OTHER
    shown = capsys.readouterr()
    assert "m1 = " in shown.out
    assert "No space left" in shown.err


# -- while one waits -----------------------------------------------------------


def test_the_first_run_says_once_that_it_compiles(
    here, capsys, monkeypatch, demo_file, tmp_path
):
    command = ["select-order", demo_file, "--degrees", "1", "--no-figures"]
    cache = tmp_path / "cache"
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(cache))
    assert run(command) == 0
    assert capsys.readouterr().err.count("compiling, once") == 1

    compiled = cache / "equations_0"
    compiled.mkdir(parents=True, exist_ok=True)
    (compiled / "sums-1.nbi").touch()
    assert run(command) == 0
    assert "compiling" not in capsys.readouterr().err


@pytest.mark.parametrize(("is_terminal", "n_samples"), [(True, 1500), (False, 600)])
def test_long_work_is_seen_on_a_terminal_and_nowhere_else(
    here, capsys, monkeypatch, is_terminal, n_samples
):
    """The line on a terminal is drawn anew every second."""
    two_storeys(n=n_samples).to_frame().to_csv("test.csv")
    monkeypatch.setattr(sys.stderr, "isatty", lambda: is_terminal, raising=False)
    monkeypatch.setitem(sys.modules, "jinja2", None)  # no page, which takes long
    assert run(["close-loop", "test.csv", "--steps", "1", "--no-figures"]) == 0

    shown = capsys.readouterr()
    assert ("finding bands, 00:00" in shown.err) == is_terminal
    assert "finding bands" not in shown.out
