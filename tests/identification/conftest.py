"""Noisy data of three storeys, and the model of all of them at once."""

import warnings

import chains
import numpy as np
import pytest

from pysindy_nrf import NRFRegressor
from pysindy_nrf.identification.streaming import sources


@pytest.fixture(scope="session")
def data():
    case = chains.duffing(3, [1, 2, 3], seed=4, n_samples=6000)
    rng = np.random.default_rng(0)
    X = case.X + 0.01 * case.X.std(axis=0) * rng.standard_normal(case.X.shape)
    F = case.F + 0.01 * case.F.std(axis=0) * rng.standard_normal(case.F.shape)
    return X, F


@pytest.fixture(scope="session")
def in_memory(data):
    with warnings.catch_warnings(action="ignore"):
        return NRFRegressor().fit(*data)


@pytest.fixture(scope="session")
def exact():
    """Two storeys without noise."""
    return chains.duffing(2, [1, 2], seed=6, n_samples=2000)


@pytest.fixture
def small_chunks(monkeypatch):
    """Files are read in chunks of 700 samples."""
    monkeypatch.setattr(sources, "SAMPLES_IN_CHUNK", (700, 700))
