"""Compiled code: the right one from the disk, in every process."""

import os
import subprocess
import sys

import numpy as np
import pytest

from pysindy_nrf import ChainModel, laws, simulate
from pysindy_nrf.exceptions import LawError

FIT_AND_SIMULATE = """
import numpy as np
from pysindy_nrf import NRFRegressor, datasets, simulate
record = datasets.load_demo()
model = NRFRegressor(degree=1, estimation="ls").fit(*record.to_features())
simulate(model.model_, record.force[:50], dt=record.dt)
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
# A spring whose kernel uses an array, a number and a function, which uses others.
SPRING_OF_PARTS = """
import sys
import numpy as np
from pysindy_nrf import ChainModel, laws, simulate

def make(table=1.0, factor=2.0, summand=3.0, function="sin"):
    array = np.array([table])
    wave = getattr(np, function)

    def inner(x):
        return wave(x) + summand

    class Spring(laws.ForceLaw):
        columns = (laws.Term("k", "spring(s)", "N/m"),)

        @staticmethod
        def kernel(s, v, a, t, u, z, theta, out):
            out[0] = inner(s) * array[0] * factor

    return Spring(k=1.0)

name, value = sys.argv[1:]
law = make(**{name: value if name == "function" else float(value)})
run = simulate(ChainModel([1.0], {1: law}), np.zeros((2, 1)), 1e-3, x0=[0.5])
print(float(run.acceleration[0, 0]))
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


@pytest.mark.slow
def test_a_change_of_whatever_a_law_uses_is_compiled_anew(tmp_path):
    """The force is (function(s) + summand) * table * factor, at s = 0.5 m."""
    changes = {
        ("factor", "2.0"): 2.0 * (np.sin(0.5) + 3.0),
        ("factor", "2.5"): 2.5 * (np.sin(0.5) + 3.0),
        ("table", "4.0"): 8.0 * (np.sin(0.5) + 3.0),
        ("summand", "7.0"): 2.0 * (np.sin(0.5) + 7.0),
        ("function", "cos"): 2.0 * (np.cos(0.5) + 3.0),
    }
    for change, force in changes.items():
        acceleration = float(run_script(SPRING_OF_PARTS, *change, cache=tmp_path))
        assert acceleration == pytest.approx(-force)


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
    law = Strange(sigma=1.0, Fd=1.0)
    with pytest.raises(LawError, match="Strange cannot be compiled"):
        law.features(laws.Motion(np.zeros(3), np.zeros(3)))
    with pytest.raises(LawError, match="Strange cannot be compiled"):
        simulate(ChainModel([1.0], {1: law}), np.zeros((3, 1)), 0.1)
