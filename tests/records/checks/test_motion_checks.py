"""Arrays that are no motion are named; motions, folds and shuffled rows are not."""

import re
import warnings

import chains
import numpy as np
import pytest

from pysindy_nrf import NRFRegressor
from pysindy_nrf.exceptions import DataQualityWarning
from pysindy_nrf.records import motion_notes

DT = 1e-3


def rates_and_drifts_swapped(x):
    return x[:, [0, 1, 2, 6, 7, 8, 3, 4, 5]]


def accelerations_and_rates_swapped(x):
    return x[:, [3, 4, 5, 0, 1, 2, 6, 7, 8]]


def standardised(x):
    return (x - x.mean(axis=0)) / x.std(axis=0)


def as_it_is(x):
    return x


def two_folds(x):
    return np.delete(x, slice(900, 1700), axis=0)


def shuffled(x):
    return np.random.default_rng(0).permutation(x)


WRONG = [
    (rates_and_drifts_swapped, DT, "v1 .*s1 "),
    (accelerations_and_rates_swapped, DT, "v1 "),
    (as_it_is, 10 * DT, "v1 is 0.1 times as large"),
    (standardised, None, "standard deviation of one"),
]
RIGHT = [(as_it_is, DT), (two_folds, DT), (shuffled, DT), (as_it_is, None)]


@pytest.fixture(scope="module")
def case():
    return chains.duffing(3, [1, 2, 3], seed=0, n_samples=3000)


def columns(X):
    return X[:, :3], X[:, 3:6], X[:, 6:]


@pytest.mark.parametrize(("change", "dt", "words"), WRONG)
def test_arrays_that_are_no_motion_give_notes(case, change, dt, words):
    motion = columns(change(case.noisy(0.05)))
    notes = motion_notes(*motion, None, dt)
    assert re.search(words, "; ".join(note.message for note in notes))
    # displacements of storeys are called drifts
    assert not any(note.channel.startswith("x") for note in notes)


@pytest.mark.parametrize(("change", "dt"), RIGHT)
def test_motions_folds_and_shuffled_rows_pass_in_silence(case, change, dt):
    motion = columns(change(case.noisy(0.05)))
    assert motion_notes(*motion, None, dt) == ()


@pytest.mark.parametrize(("change", "dt", "words"), WRONG)
def test_fit_and_diagnose_name_them(case, change, dt, words):
    model = NRFRegressor(degree=1, dt=dt)
    with pytest.warns(DataQualityWarning, match=f"X: .*{words}"):
        model.fit(change(case.noisy(0.05)), case.F)
    assert "channel" in set(model.diagnose().table["limit"])


def test_fit_and_diagnose_pass_over_what_is_right(case):
    model = NRFRegressor(degree=1, dt=DT)
    with warnings.catch_warnings():
        warnings.filterwarnings("error", message="X: ")
        model.fit(case.noisy(0.05), case.F)
    assert "channel" not in set(model.diagnose().table["limit"])
