"""Noisy data of three storeys, and the model of all of them at once."""

import warnings

import chains
import numpy as np
import pytest

from pysindy_nrf import NRFRegressor


@pytest.fixture(scope="session")
def data():
    case = chains.duffing(3, [1, 2, 3], seed=4, n_samples=6000)
    rng = np.random.default_rng(0)
    return tuple(
        x + 0.01 * x.std(axis=0) * rng.standard_normal(x.shape)
        for x in (case.X, case.F)
    )


@pytest.fixture(scope="session")
def in_memory(data):
    with warnings.catch_warnings(action="ignore"):
        return NRFRegressor().fit(*data)
