"""What all commands share: options, words, exit codes, signals; errors are
sentences.
"""

import errno
import io
import os
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pysindy_nrf import datasets, laws
from pysindy_nrf.cli import group
from pysindy_nrf.cli.group import cli, run
from pysindy_nrf.cli.options import laws_of, working
from pysindy_nrf.cli.outcome import RED

PAGE = (Path(__file__).parents[2] / "docs" / "command_line.md").read_text("utf-8")
COMMANDS = list(cli.commands)
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
    ("--law", ["storey 1=dahl+rubber"], "there is no law 'rubber'. Known are"),
    ("--order", ["storey 2"], "'storey 2' is not of the form SITE=DEGREE"),
    ("--order", ["storey 2=high"], "'high' is not a degree (3) or a box k,q (2,3)"),
    ("--order", ["storey 2=2", "storey 2=5"], "storey 2= is given twice"),
    ("--link", ["brace 3-1"], "'brace 3-1' is not a site"),
    ("--link", ["link 2-2"], "'link 2-2' joins DOF 2 to itself"),
    (
        "--known-mass",
        ["two=3"],
        "'two=3' is not a floor and its mass in kg, e.g. 2=12.4",
    ),
    ("--known-mass", ["2=12.4", "2=12.5"], "2= is given twice"),
    ("--band", ["5"], "'5' is not a band, e.g. 0.5,30 (Hz)"),
]


def having(option):
    """Commands with an option, and how each declares it."""
    found = {
        name: [p for p in one.params if option in p.opts]
        for name, one in cli.commands.items()
    }
    return {name: params[0] for name, params in found.items() if params}


@pytest.mark.parametrize("option", SHARED)
def test_an_option_is_declared_once(option):
    said = [
        p.to_info_dict() | {"kind": type(p.type), "callback": p.callback}
        for p in having(option).values()
    ]
    assert said and all(one == said[0] for one in said)


@pytest.mark.parametrize(("option", "values", "words"), MISTAKES)
def test_a_mistake_is_named_by_its_option_and_alike_in_every_command(
    option, values, words, capsys, monkeypatch
):
    monkeypatch.setenv("COLUMNS", "500")
    said = set()
    for name in having(option):
        assert (
            run([name, "3", *(part for value in values for part in (option, value))])
            == 2
        )
        shown = capsys.readouterr()
        said.add(re.search("^Error: .*", shown.err, re.MULTILINE)[0])
        assert not shown.out
    assert len(said) == 1
    assert said.pop().startswith(f"Error: Invalid value for '{option}': {words}")


def test_links_by_any_spelling_are_the_link(capsys):
    answers = []
    for text in ("link 3-1", "link 1-3", " link  3-1 "):
        assert run(["plan", "3", "--link", text, "--json"]) == 0
        answers.append(capsys.readouterr().out)
    assert len(set(answers)) == 1


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["identify"], 2, "FILE"),
        (["identify", "a.csv", "--degree", "2.5"], 2, "degree"),
        (["identify", "a.csv", "--kind", "mobility"], 2, "--frf only"),
        (["conquer"], 2, "conquer"),
        ([], 2, "identify"),
        (["identify", "nowhere.csv"], 3, "nowhere.csv does not exist"),
        (["identify", "a.csv", "--map", "x1=q"], 3, "no variable 'q'"),
        (["identify", "a.csv"], 3, "nothing scales the chain"),
        (["identify", "a.csv", "--known-mass", "9=1"], 3, "DOF 9"),
        (["identify", "a.csv", "--map", "F1=p", "--band", "0,999"], 3, "Nyquist"),
        (
            ["identify", "a.csv", "--map", "F1=p", "--order", "storey 7=2"],
            3,
            "storey 7",
        ),
    ],
)
def test_errors_are_sentences_with_exit_codes(here, capsys, arguments, code, words):
    t = np.arange(300) / 100
    pd.DataFrame({"t": t, "x1": np.sin(5 * t), "p": np.cos(5 * t)}).to_csv(
        "a.csv", index=False
    )
    assert run(arguments) == code
    shown = capsys.readouterr()
    assert words in shown.err and "Traceback" not in shown.err + shown.out
    assert not (here / "nrf_output").exists()


def test_as_a_process(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "pysindy_nrf", "identify", "nowhere.csv"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    assert (
        done.returncode == 3
        and done.stdout == ""
        and done.stderr.startswith("Error: nowhere.csv")
    )


FAULTS = [
    (MemoryError(), 1, "Not enough memory"),
    (RecursionError(), 1, "nested too deeply"),
    (
        OSError(errno.ENOSPC, "No space left on device", "nrf_output/model.json"),
        1,
        "model.json: No space left on device",
    ),
    (RuntimeError("boom"), 1, "RuntimeError: boom. This is a fault of pysindy-nrf"),
    (KeyboardInterrupt(), 130, "Stopped"),
]


@pytest.mark.parametrize(("fault", "code", "words"), FAULTS)
def test_every_fault_is_a_sentence_with_a_code(capsys, fault, code, words):
    @cli.command("falls")
    def falls():
        raise fault

    try:
        assert run(["falls"]) == code
    finally:
        del cli.commands["falls"]
    shown = capsys.readouterr()
    assert words in shown.err and "Traceback" not in shown.err and not shown.out


@pytest.mark.parametrize(
    ("package", "extra", "kind"),
    [("matplotlib", "plot", "png"), ("jinja2", "report", "html")],
)
def test_without_an_extra_the_rest_is_written_and_the_extra_named(
    here, capsys, monkeypatch, demo_file, package, extra, kind
):
    monkeypatch.setitem(sys.modules, package, None)
    assert run(["identify", demo_file, "--degree", "1"]) == 0
    assert f"pip install 'pysindy-nrf[{extra}]'" in capsys.readouterr().out
    assert Path("nrf_output/masses.csv").exists() and not list(
        Path("nrf_output").glob(f"*.{kind}")
    )


def test_help_says_what_to_do_first(capsys):
    assert run(["--help"]) == 0
    said = capsys.readouterr().out
    assert "Exit codes" in said and said.index("pysindy-nrf demo") < said.index(
        "pysindy-nrf identify test.csv"
    )


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_every_command(command, capsys):
    assert run([command, "--help"]) == 0
    said = capsys.readouterr().out
    assert "--json" in said and ("pysindy-nrf " + command in said or command == "demo")
    assert f"`{command}" in PAGE


@pytest.mark.parametrize(
    "command", [c for c in COMMANDS if c not in ("demo", "plan", "laws")]
)
def test_no_command_shows_a_traceback(command, here, capsys):
    (here / "bad.csv").write_bytes(os.urandom(500))
    for arguments in (
        [],
        ["nowhere.csv"],
        ["bad.csv"],
        ["nowhere.csv", "bad.csv"],
        ["--nonsense"],
        ["."],
        [""],
    ):
        code = run([command, *arguments])
        shown = capsys.readouterr()
        assert (
            code in (2, 3)
            and "Traceback" not in shown.err + shown.out
            and shown.err.strip()
        )
        assert "fault of pysindy-nrf" not in shown.err, shown.err
    assert [p.name for p in here.iterdir()] == ["bad.csv"]


def test_exit_codes_are_those_of_the_page():
    table = re.findall(r"^\| (\d+) \| ([\w ]+)", PAGE, re.MULTILINE)
    codes = {int(code): words for code, words in table}
    assert set(codes) == {
        0,
        group.OTHER,
        group.USAGE,
        group.DATA,
        RED,
        group.INTERRUPTED,
    }
    assert (
        codes[group.USAGE] == "wrong usage"
        and codes[group.INTERRUPTED] == "stopped by Ctrl"
    )


SWALLOW = """
import ctypes, signal, time
from pysindy_nrf.cli import group

@group.cli.command()
def swallow():
    def callback():
        raise KeyboardInterrupt
    ctypes.CFUNCTYPE(None)(callback)()
    time.sleep(600)
    print("not heard")

signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background ignores it
group.main(["swallow"])
"""


def test_ctrl_c_that_a_callback_swallows_is_heard_all_the_same(here):
    """Python drops what is raised in a callback of compiled code, such as the
    compiler's; it must come again.
    """
    done = subprocess.run(
        [sys.executable, "-c", SWALLOW], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 130 and "Stopped" in done.stderr
    assert "Traceback" not in done.stderr and "not heard" not in done.stdout


def test_a_terminal_that_knows_only_ascii(here):
    """Signs it lacks are shown as codes; no command fails on its own words."""
    table = datasets.load_demo().to_frame().rename(columns={"a1": "Größe µ"})
    table.to_csv("odd.csv")
    environment = {
        **os.environ,
        "PYTHONIOENCODING": "ascii",
        "LC_ALL": "C",
        "PYTHONUTF8": "0",
    }
    command = [
        sys.executable,
        "-m",
        "pysindy_nrf",
        "inspect",
        "odd.csv",
        "--map",
        "a1=Größe µ",
    ]
    done = subprocess.run(
        command, capture_output=True, text=True, env=environment, timeout=60
    )
    assert done.returncode == 0 and "Gr" in done.stdout, done.stderr


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_shell_completion(here, shell, monkeypatch, capsys):
    """The variable and the words of the documentation are those that the program
    answers to.
    """
    assert f"_PYSINDY_NRF_COMPLETE={shell}_source" in PAGE
    monkeypatch.setenv("_PYSINDY_NRF_COMPLETE", f"{shell}_source")
    with pytest.raises(SystemExit, match="0"):
        run([])
    assert "pysindy-nrf" in capsys.readouterr().out
    monkeypatch.setenv("_PYSINDY_NRF_COMPLETE", f"{shell}_complete")
    monkeypatch.setenv("COMP_WORDS", "pysindy-nrf se")
    monkeypatch.setenv("COMP_CWORD", "1" if shell == "zsh" else "se")
    with pytest.raises(SystemExit, match="0"):
        run([])
    assert "select-order" in capsys.readouterr().out


def test_a_missing_reader_is_named(here, capsys, monkeypatch):
    Path("a.h5").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(600))
    monkeypatch.setitem(sys.modules, "h5py", None)
    assert run(["inspect", "a.h5"]) == 1
    assert "pysindy_nrf[files]" in capsys.readouterr().err


def test_a_reader_that_has_left_is_no_fault(monkeypatch):
    """`pysindy-nrf plan 8 | head -1`: the other end of the pipe is closed."""
    read, write = os.pipe()
    os.close(read)
    said = io.StringIO()
    with monkeypatch.context() as patched:
        patched.setattr(sys, "stdout", os.fdopen(write, "w", buffering=1))
        patched.setattr(sys, "stderr", said)
        try:
            code = run(["plan", "8"])
        except SystemExit as left:
            code = left.code
        assert code == 1
    assert said.closed or "Traceback" not in said.getvalue()


def test_every_law_by_name_stands_alone():
    """--law SITE=NAME makes a law without arguments; each name of the registry must
    allow it.
    """
    for name in laws.registry():
        assert laws_of([("storey 1", [name])], 2)["storey 1"][0].name == name


def test_the_first_run_says_once_that_it_compiles(
    here, capsys, monkeypatch, demo_file, tmp_path
):
    command = ["select-order", demo_file, "--degrees", "1", "--no-figures"]
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    assert run(command) == 0
    assert capsys.readouterr().err.count("compiling, once, about 10 s") == 1
    (tmp_path / "cache").mkdir(exist_ok=True)
    (tmp_path / "cache" / "gram_pass-1.nbi").touch()
    assert run(command) == 0
    assert "compiling" not in capsys.readouterr().err


def test_long_work_is_seen_on_a_terminal_and_nowhere_else(capsys, monkeypatch):
    for terminal in (True, False):
        monkeypatch.setattr(
            sys.stderr, "isatty", lambda shown=terminal: shown, raising=False
        )
        with working("finding bands") as tick:
            tick()
            time.sleep(1.3)
        said = capsys.readouterr()
        assert (
            "finding bands, 00:00" in said.err and "laws tried: 1, 00:01" in said.err
        ) == terminal
        assert said.out == ""
