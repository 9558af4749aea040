"""Good measurements, to be spoilt: a cubic chain of three storeys, DOF 2 forced."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pandas as pd

from pysindy_nrf import ChainModel, Record, excitation, laws, simulate
from pysindy_nrf.simulation.noise import add_noise

N, STEP = 1500, 1e-3
TIME = np.arange(N) * STEP
NAMES = [f"{kind}{j}" for kind in "avs" for j in (1, 2, 3)]
MASSES = (12.0, 9.0, 15.0)
STIFFNESS = (1.1e5, 0.9e5, 1.3e5)


def chain_model() -> ChainModel:
    """The truth."""
    held = {
        f"storey {i}": laws.PowerSeries((0, 3), [k, 0.0, 40 * k / 1e-3**2 * 1e-3])
        for i, k in enumerate(STIFFNESS, 1)
    }
    return ChainModel(
        MASSES, {s: [law, laws.LinearViscous(60.0)] for s, law in held.items()}
    )


@cache
def good(noise: float = 0.0, n_samples: int = N) -> Record:
    """A clean record, or one with noise."""
    options = dict(excited=2, rms=300.0, band=(1, 60), random_state=1)
    F = excitation.band_limited_random(3, n_samples * STEP, 1 / STEP, **options)[
        :n_samples
    ]
    record = simulate(chain_model(), F, STEP, name="test 7")
    return add_noise(record, noise, random_state=2) if noise else record


@cache
def _features() -> tuple[pd.DataFrame, pd.DataFrame]:
    return good().to_features(smooth=False)


def features() -> tuple[np.ndarray, np.ndarray]:
    """X and F as fresh arrays."""
    X, F = _features()
    return X.to_numpy().copy(), F.to_numpy().copy()


def table() -> pd.DataFrame:
    """X as a fresh table."""
    return pd.DataFrame(features()[0], columns=NAMES)


def changed(array: Any, rows: Any, column: int, value: Any) -> np.ndarray:
    """A copy with other values in some rows of a column."""
    out = np.array(array, dtype=float)
    out[rows, column] = value
    return out


def channels(**changes: Any) -> dict[str, Any]:
    """Arguments of a record with some of them replaced."""
    rec = good()
    return {
        "force": rec.force.copy(),
        "acceleration": rec.acceleration.copy(),
        "displacement": rec.displacement.copy(),
        "fs": 1 / STEP,
        "name": "test 7",
    } | changes
