"""Compiled laws: the right code from the disk, in every process."""

import os
import subprocess
import sys

import numpy as np

from pysindy_nrf import laws
from pysindy_nrf.laws import compiled, memory
from pysindy_nrf.laws.base import Motion

START = """
import numpy as np
from types import SimpleNamespace
from pysindy_nrf import Chain, Site, laws
from pysindy_nrf.simulation import simulate
from pysindy_nrf.simulation.integrators import runge_kutta
law = laws.Dahl(sigma=1e4, Fd=1.0)
simulate(SimpleNamespace(chain=Chain(1), masses=[1.0], laws={Site(1): (law,)}), np.ones((5, 1)), 1e-3)
print(sum(runge_kutta.stats.cache_hits.values()), sum(runge_kutta.stats.cache_misses.values()))
"""


def test_second_process_loads_the_integrator_from_disk():
    subprocess.run([sys.executable, "-c", START], check=True, capture_output=True)
    second = subprocess.run([sys.executable, "-c", START], check=True, capture_output=True, text=True)
    assert second.stdout.split() == ["1", "0"]


def test_fingerprint_sees_constants_and_called_functions():
    def law(factor, helper):
        def advance(z):
            z[0] = factor * helper(z[0])

        return advance

    def sine(x):
        return np.sin(x)

    def cosine(x):
        return np.cos(x)

    assert compiled.fingerprint(law(2.0, sine)) == compiled.fingerprint(law(2.0, sine))
    prints = {compiled.fingerprint(f) for f in (law(2.0, sine), law(3.0, sine), law(2.0, cosine))}
    assert len(prints) == 3


def test_without_a_place_to_write_it_still_compiles(monkeypatch):
    def nowhere(function):
        raise RuntimeError("cannot cache function: no locator available")

    monkeypatch.setattr(compiled, "_CodeCache", nowhere)

    def advance(z, s0, v0, s1, v1, dt, u, theta):
        z[0] += theta[0] * (s1 - s0)

    paths = memory._paths(advance, 1)
    s = np.array([0.0, 1.0, 3.0])
    z, none = np.zeros((2, 1, 3)), np.empty(0)
    paths(s, s, none, none, np.empty((0, 3)), np.array([[2.0], [5.0]]), np.zeros((2, 1)), z)
    assert z.tolist() == [[[0.0, 2.0, 6.0]], [[0.0, 5.0, 15.0]]]


def test_first_loading_of_dahl_is_the_exponential():
    t = np.arange(50) / 1000
    s, v, a = 1e-3 * np.sin(90 * t), 0.09 * np.cos(90 * t), -8.1 * np.sin(90 * t)
    law = laws.Dahl(sigma=5e3)
    z = law.features(Motion(s, v, a, t))[:, 0]
    loading = slice(0, 17)  # up to the first reversal the state is 1 - exp(-sigma s)
    np.testing.assert_allclose(z[loading], 1 - np.exp(-5e3 * s[loading]), rtol=1e-12)


TOGETHER = """
import sys
import numpy as np
from pysindy_nrf import laws
t = np.arange(300) / 1000
motion = laws.Motion(1e-3 * np.sin(90 * t), 0.09 * np.cos(90 * t), t=t)
held = {"dahl": laws.Dahl(sigma=1500.0), "jenkins": laws.Jenkins(uy=7e-4)}
for name in sys.argv[1:]:
    print(name, repr(float(np.abs(held[name].features(motion)).sum())))
"""


def test_laws_compiled_in_different_processes_do_not_take_each_others_code(tmp_path):
    """Both start numbering their machine code at the same number; a third process loads both from the disk."""
    env = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}

    def run(*names):
        out = subprocess.run([sys.executable, "-c", TOGETHER, *names], check=True, capture_output=True, text=True, env=env)
        return dict(line.split() for line in out.stdout.splitlines())

    alone = run("dahl") | run("jenkins")
    assert alone["dahl"] != alone["jenkins"]
    assert run("dahl", "jenkins") == run("jenkins", "dahl") == alone


def test_no_layout_of_the_arrays_is_compiled_for_anew():
    """Forces in either order, drifts that may or may not be written to: the same machine code."""
    from pysindy_nrf import ChainModel, simulate
    from pysindy_nrf.simulation.integrators import runge_kutta

    law = laws.Dahl(sigma=1e3, Fd=1.0)
    model = ChainModel([1.0, 2.0], {i: [laws.LinearElastic(1e3), law] for i in (1, 2)})
    F = np.random.default_rng(0).standard_normal((40, 2))
    runs = [simulate(model, force, 1e-3).displacement for force in (F, np.asfortranarray(F), F[::1].copy())]
    assert all(np.array_equal(runs[0], run) for run in runs[1:]) and len(runge_kutta.signatures) == 1
    s = np.cumsum(F[:, 0]) * 1e-3
    sealed = s.copy()
    sealed.flags.writeable = False
    states = [memory.state_path(law, Motion(x, F[:, 0]), np.empty((0, 40)), law.theta) for x in (s, sealed, s[::1])]
    assert np.array_equal(*states[:2]) and len(memory._paths(type(law).advance, law.n_states).signatures) == 1
