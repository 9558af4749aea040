"""The same input gives the same answer: on any cores, in any process, from a seed."""

import json
import os
import subprocess
import sys
from pathlib import Path

import chains
import joblib
import numpy as np
import pytest

from pysindy_nrf import NRFRegressor, excitation, select_order
from pysindy_nrf.common import threads
from pysindy_nrf.exceptions import NRFError

# -- cores ---------------------------------------------------------------------


@pytest.fixture
def cores(monkeypatch):
    """Pretend that there are so many cores, and no limit."""

    def set_cores(count: int) -> None:
        for name in threads.THREAD_LIMIT_VARIABLES:
            monkeypatch.delenv(name, raising=False)
        monkeypatch.setattr(joblib, "cpu_count", lambda: count)
        threads.n_cores.cache_clear()

    yield set_cores
    threads.n_cores.cache_clear()


@pytest.mark.parametrize(
    ("omp", "numba", "expected"),
    [
        ("", "", 8),
        ("3", "", 3),
        ("", "2", 2),
        ("5", "2", 2),
        ("16", "", 8),
        ("4,2", "", 4),
        ("0", "many", 8),
        ("-1", "", 8),
    ],
)
def test_environment_variables_limit_the_threads(
    cores, monkeypatch, omp, numba, expected
):
    cores(8)
    monkeypatch.setenv("OMP_NUM_THREADS", omp)
    monkeypatch.setenv("NUMBA_NUM_THREADS", numba)
    assert threads.n_threads() == expected


def repeated_with_noise(case, times=5):
    """A case several times, with noise on its forces: more samples than one share."""
    X = np.tile(case.X, (times, 1))
    F = np.tile(case.F, (times, 1))
    noise = np.random.default_rng(0).standard_normal(F.shape)
    return X, F + 0.02 * F.std(axis=0) * noise


@pytest.mark.parametrize("forced", [[3], [1, 2, 3]], ids=["sequential", "complete"])
def test_a_fit_has_the_same_bits_on_any_number_of_cores(cores, forced):
    case = chains.duffing(3, forced, seed=4, n_samples=8000)
    X, F = repeated_with_noise(case)

    def fitted(n_cores):
        cores(n_cores)
        model = NRFRegressor(degree=3).fit(X, F)
        streamed = NRFRegressor(degree=3).fit(iter([(X, F)]))
        scores = select_order(X, F, degrees=range(1, 5)).fold_scores
        masses = np.concatenate([model.masses_, streamed.masses_])
        return masses, scores.to_numpy(), model.model_.to_dict()

    masses, scores, plain_data = fitted(1)
    np.testing.assert_allclose(masses, np.tile(case.m, 2), rtol=0.02)
    for n_cores in (2, 3):
        other_masses, other_scores, other_data = fitted(n_cores)
        np.testing.assert_array_equal(other_masses, masses)
        np.testing.assert_array_equal(other_scores, scores)
        assert other_data == plain_data


# -- processes -----------------------------------------------------------------

SCRIPT = Path(__file__).parent / "answer_of_a_process.py"
N_THREADS = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMBA_NUM_THREADS",
)


def answer(n_threads: int, *arguments: str) -> dict[str, np.ndarray]:
    """What a fresh process finds, to the last bit."""
    variables = dict.fromkeys([*N_THREADS, "PYTHONHASHSEED"], str(n_threads))
    done = subprocess.run(
        [sys.executable, str(SCRIPT), *arguments],
        capture_output=True,
        text=True,
        env={**os.environ, **variables},
        timeout=300,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    printed = json.loads(done.stdout.splitlines()[-1])
    return {
        name: np.array([float.fromhex(text) for text in texts])
        for name, texts in printed.items()
    }


@pytest.mark.slow
def test_the_same_input_gives_the_same_bits_in_another_process():
    first = answer(1, "loop")
    second = answer(1, "loop")
    assert first.keys() == second.keys()
    for name in first:
        np.testing.assert_array_equal(first[name], second[name], err_msg=name)


@pytest.mark.slow
def test_four_threads_of_blas_change_the_last_digits_alone():
    first = answer(1)
    four = answer(4)
    for name in four:
        # coefficients are ten orders apart
        scale = 0.0 if name == "coefficients" else np.abs(first[name]).max()
        np.testing.assert_allclose(
            four[name], first[name], rtol=1e-10, atol=1e-10 * scale, err_msg=name
        )


# -- seeds ---------------------------------------------------------------------


def force_of(random_state):
    return excitation.band_limited_random(
        1, 1.0, 100.0, excited=1, rms=1.0, band=(1, 20), random_state=random_state
    )


@pytest.mark.parametrize("seed", ["lucky", -1, 1.5, [1, "a"]])
def test_a_seed_that_is_none_is_refused(seed):
    with pytest.raises(NRFError, match="random_state=.* is no seed"):
        force_of(seed)


def test_seeds_and_generators():
    np.testing.assert_array_equal(force_of(3), force_of(3))
    np.testing.assert_array_equal(force_of(3), force_of(np.random.default_rng(3)))
    assert not np.allclose(force_of(3), force_of(4))
