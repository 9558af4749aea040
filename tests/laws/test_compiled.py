"""Compiled code: the right one from the disk, in every process."""

import os
import subprocess
import sys

import numpy as np
import pytest

from pysindy_nrf import ChainModel, laws, simulate
from pysindy_nrf.common.code_cache import fingerprint
from pysindy_nrf.common.compiled import inline
from pysindy_nrf.exceptions import LawError
from pysindy_nrf.laws.callbacks import cannot_compile, compiled_kernel
from pysindy_nrf.laws.shape import Motion

FIT_AND_SIMULATE = """
import numpy as np
from pysindy_nrf import NRFRegressor, datasets, laws
record = datasets.load_demo()
model = NRFRegressor(degree=1, estimation="ls").fit(*record.to_features())
simulate(model, record.force[:50], dt=record.dt)
"""
SUM_OF_STATES = """
import sys
import numpy as np
from pysindy_nrf import laws
t = np.arange(300) / 1000
motion = laws.Motion(1e-3 * np.sin(90 * t), 0.09 * np.cos(90 * t), t=t)
for name in sys.argv[1:]:
    law = laws.Dahl(sigma=1500.0) if name == "dahl" else laws.Jenkins(uy=7e-4)
    print(name, repr(float(np.abs(law.features(motion)).sum())))
"""


def run_script(script, *arguments, cache, seed="0"):
    """What a fresh process prints, whose machine code is cached in a folder."""
    variables = {"NUMBA_CACHE_DIR": str(cache), "PYTHONHASHSEED": seed}
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", script, *arguments],
        check=True,
        capture_output=True,
        text=True,
        env={**os.environ, **variables},
    )
    return done.stdout


def sums(cache, *names):
    """Sums of the states of laws by name, from a fresh process."""
    lines = run_script(SUM_OF_STATES, *names, cache=cache).splitlines()
    return dict(line.split() for line in lines)


@pytest.mark.slow
def test_a_second_process_compiles_nothing(tmp_path):
    """Whatever the seed of the hashes of a process."""
    run_script(FIT_AND_SIMULATE, cache=tmp_path, seed="1")
    written = {file: file.stat().st_mtime_ns for file in tmp_path.rglob("*.nb?")}
    assert written
    run_script(FIT_AND_SIMULATE, cache=tmp_path, seed="2")
    again = {file: file.stat().st_mtime_ns for file in tmp_path.rglob("*.nb?")}
    assert again == written


@pytest.mark.slow
def test_code_of_two_processes_is_not_mixed_up(tmp_path):
    """Both start to number their machine code at the same number."""
    dahl = sums(tmp_path, "dahl")
    jenkins = sums(tmp_path, "jenkins")
    assert dahl["dahl"] != jenkins["jenkins"]
    assert sums(tmp_path, "jenkins", "dahl") == dahl | jenkins


@pytest.mark.slow
def test_code_that_cannot_be_read_or_written_is_compiled(tmp_path):
    jenkins = sums(tmp_path, "jenkins")
    for file in tmp_path.rglob("*.nbc"):
        file.write_bytes(b"")
    assert sums(tmp_path, "jenkins") == jenkins

    (tmp_path / "file").write_text("")
    no_folder = tmp_path / "file" / "below"
    assert sums(no_folder, "jenkins") == jenkins


# -- fingerprints --------------------------------------------------------------


def make(table=(1.0,), factor=2.0, summand=3.0, function=np.sin):
    """A function that uses an array, a number and a function, which uses others."""
    array = np.array(table)

    def inner(x):
        return function(x) + summand

    def outer(x):
        return inner(x) * array[0] * factor

    return outer


@pytest.mark.parametrize(
    "change",
    [{"table": (2.0,)}, {"factor": 2.5}, {"summand": 4.0}, {"function": np.cos}],
)
def test_a_fingerprint_is_of_all_that_a_function_uses(change):
    assert fingerprint(make(**change)) != fingerprint(make())


def test_a_fingerprint_is_of_nothing_else():
    assert fingerprint(make()) == fingerprint(make())
    assert fingerprint(make(), make(factor=5.0)) != fingerprint(make())


def test_a_fingerprint_is_of_the_compilers_options():
    exact = inline(make(), fastmath=False)
    fast = inline(make(), fastmath=True)
    assert fingerprint(exact) != fingerprint(fast)


def test_a_function_that_calls_itself_has_a_fingerprint():
    def factorial(n):
        return n * factorial(n - 1) if n else 1

    assert fingerprint(factorial)


# -- laws of users -------------------------------------------------------------


def softened(s, width):
    return s / (1.0 + abs(s) / width)


class SoftSpring(laws.ForceLaw):
    """A law that calls a plain function of its module."""

    columns = (laws.Term("k", "soft(s)", "N/m"),)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = softened(s, 1e-3)


def test_a_law_may_call_functions_of_its_module():
    """A spring of 2000 N/m softens to 1000 N/m at 1 mm, where it holds 1 N."""
    model = ChainModel([1.0], {1: [SoftSpring(k=2e3), laws.LinearViscous(45.0)]})
    run = simulate(model, np.ones((1000, 1)), 1e-3)
    assert run.displacement[-1, 0] == pytest.approx(1e-3, rel=1e-6)


class Strange(laws.Dahl):
    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = {}.no_such_thing(s)

    @staticmethod
    def advance(z, s0, v0, s1, v1, dt, u, theta):
        z[0] = {}.no_such_thing(s0)


def test_a_law_that_cannot_be_compiled_is_named():
    with pytest.raises(LawError, match="Strange cannot be compiled"):
        Strange(sigma=1.0).features(Motion(np.zeros(3), np.zeros(3)))
    with pytest.raises(LawError, match="Strange cannot be compiled"):
        compiled_kernel(Strange(sigma=1.0))


@pytest.mark.parametrize(
    ("message", "reason"),
    [("first\nthe last line\n", "(the last line)"), (" ", "(ValueError)")],
)
def test_the_reason_is_the_last_line_of_the_compilers_error(message, reason):
    assert reason in str(cannot_compile(laws.Dahl(), ValueError(message)))
