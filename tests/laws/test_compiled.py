"""Compiled laws: the right code from the disk, in every process."""

import os
import subprocess
import sys

import numpy as np
import pytest

from pysindy_nrf import laws
from pysindy_nrf.common import compiled
from pysindy_nrf.common.code_cache import fingerprint
from pysindy_nrf.laws.callbacks import callbacks_of, cannot_compile
from pysindy_nrf.exceptions import LawError
from pysindy_nrf.laws.shape import Motion

START = """
import numpy as np
from pysindy_nrf import ChainModel, laws, simulate
from pysindy_nrf.equations.compiled_sums import _kernel
from pysindy_nrf.simulation.runge_kutta import runge_kutta
simulate(ChainModel([1.0], {1: [laws.Dahl(sigma=1e4, Fd=1.0)]}), np.ones((5, 1)), 1e-3)
for compiled in (runge_kutta, _kernel()):
    print(sum(compiled.stats.cache_hits.values()), sum(compiled.stats.cache_misses.values()))
"""


@pytest.mark.slow
def test_second_process_loads_integrator_and_gram_pass_from_disk():
    """Whatever the seed of the hashes of a process."""
    for seed in ("1", "2"):
        env = {**os.environ, "PYTHONHASHSEED": seed}
        done = subprocess.run(
            [sys.executable, "-c", START],
            check=True,
            capture_output=True,
            text=True,
            env=env,
        )
    assert done.stdout.split() == ["1", "0"] * 2


def test_fingerprints_are_of_the_code_and_of_all_it_uses():
    def make(table, factor=2.0, deeper=3.0, function=np.sin):
        def inner(x):
            return function(x) + deeper

        def outer(x):
            return inner(x) * table[0] * factor

        return outer

    one, two = np.array([1.0]), np.array([2.0])
    made = (
        make(one),
        make(two),
        make(one, 2.5),
        make(one, 2.0, 4.0),
        make(one, function=np.cos),
    )
    assert len({fingerprint(f) for f in made}) == 5
    assert fingerprint(make(one)) == fingerprint(make(one.copy()))
    assert fingerprint(make(one), make(two)) != fingerprint(make(one))
    fast = [
        fingerprint(compiled.inline(make(one), fastmath=f))
        for f in (False, True)
    ]
    assert fast[0] != fast[1]

    def recursive(x):
        return recursive(x - 1) if x else 0

    assert fingerprint(recursive)


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


def total(cache, *names):
    """Sums that a fresh process prints, with its cache of machine code there."""
    env = {**os.environ, "NUMBA_CACHE_DIR": str(cache)}
    out = subprocess.run(
        [sys.executable, "-c", TOGETHER, *names],
        check=True,
        capture_output=True,
        text=True,
        env=env,
    )
    return dict(line.split() for line in out.stdout.splitlines())


@pytest.mark.slow
def test_laws_take_the_right_code_from_the_disk_or_are_compiled_anew(tmp_path):
    """Two processes start numbering their machine code at the same number; code that
    cannot be read is no code.
    """
    alone = total(tmp_path, "dahl") | total(tmp_path, "jenkins")
    assert (
        alone["dahl"] != alone["jenkins"]
        and total(tmp_path, "jenkins", "dahl") == alone
    )
    for file in tmp_path.rglob("*.nbc"):
        file.write_bytes(b"")
    (tmp_path / "file").write_text("")
    for folder in (
        tmp_path,
        tmp_path / "file" / "below",
    ):  # damaged, and where none can be written
        assert total(folder, "jenkins")["jenkins"] == alone["jenkins"]


def test_what_cannot_be_compiled_is_named():
    class Strange(laws.Dahl):
        @staticmethod
        def advance(z, s0, v0, s1, v1, dt, u, theta):
            z[0] = {}.no_such_thing(s0)

    for call in (
        lambda law: law.features(Motion(np.zeros(3), np.zeros(3))),
        callbacks_of,
    ):
        with pytest.raises(
            LawError, match="Strange cannot be compiled for single samples"
        ):
            call(Strange(sigma=1.0))
    law = laws.Dahl()
    assert "(the last line)" in str(
        cannot_compile(law, ValueError("first\nthe last line\n"))
    )
    assert "(ValueError)" in str(cannot_compile(law, ValueError(" ")))
