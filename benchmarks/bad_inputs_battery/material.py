"""Good measurements, to be spoilt: a cubic chain of three storeys, DOF 2 forced."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pandas as pd

from pysindy_nrf import ChainModel, Record, excitation, laws, simulate
from pysindy_nrf.simulation.noise import add_noise

N_SAMPLES = 1500
STEP = 1e-3
TIME = np.arange(N_SAMPLES) * STEP
NAMES = ["a1", "a2", "a3", "v1", "v2", "v3", "s1", "s2", "s3"]
MASSES = (12.0, 9.0, 15.0)
STIFFNESS = (1.1e5, 0.9e5, 1.3e5)


def chain_model() -> ChainModel:
    """The truth."""
    storeys = {}
    for i, k in enumerate(STIFFNESS, 1):
        spring = laws.PowerSeries((0, 3), [k, 0.0, 40 * k / 1e-3**2 * 1e-3])
        storeys[f"storey {i}"] = [spring, laws.LinearViscous(60.0)]
    return ChainModel(MASSES, storeys)


@cache
def good(noise: float = 0.0, n_samples: int = N_SAMPLES) -> Record:
    """A clean record, or one with noise."""
    F = excitation.band_limited_random(
        3,
        n_samples * STEP,
        1 / STEP,
        excited=2,
        rms=300.0,
        band=(1, 60),
        random_state=1,
    )
    record = simulate(chain_model(), F[:n_samples], STEP, name="test 7")
    return add_noise(record, noise, random_state=2) if noise else record


def features() -> tuple[np.ndarray, np.ndarray]:
    """X and F as fresh arrays."""
    X, F = good().to_features(smooth=False)
    return X.to_numpy(copy=True), F.to_numpy(copy=True)


def table() -> pd.DataFrame:
    """X as a fresh table."""
    return pd.DataFrame(features()[0], columns=NAMES)


def absolute(X: np.ndarray) -> np.ndarray:
    """Velocities and displacements of the floors in place of rates and drifts."""
    a, v, s = np.hsplit(X, 3)
    return np.hstack([a, v.cumsum(axis=1), s.cumsum(axis=1)])


def changed(array: Any, rows: Any, column: int, value: Any) -> np.ndarray:
    """A copy with other values in some rows of a column."""
    copy = np.array(array, dtype=float)
    copy[rows, column] = value
    return copy


def channels(noise: float = 0.0, n_samples: int = N_SAMPLES, **changes: Any) -> dict:
    """Arguments of a record as fresh arrays, some of them replaced."""
    record = good(noise, n_samples)
    return {
        "force": record.force.copy(),
        "acceleration": record.acceleration.copy(),
        "displacement": record.displacement.copy(),
        "fs": 1 / STEP,
        "name": "test 7",
    } | changes
