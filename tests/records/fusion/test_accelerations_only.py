"""Accelerations and one force are enough: nothing but what such a test measures is
passed.
"""

import warnings

import chains
import numpy as np
import pandas as pd
import pytest

from pysindy_nrf import KinematicSmoother, NRFRegressor, Record
from pysindy_nrf.exceptions import DataQualityWarning
from pysindy_nrf.records.zero_phase_filter import lowest_frequency
from pysindy_nrf.simulation.noise import add_noise

pytestmark = pytest.mark.slow


def record_of(case, noise, seed):
    rec = Record(force=case.F, acceleration=case.a, fs=1 / case.dt)
    return add_noise(rec, noise, random_state=seed) if noise else rec


@pytest.mark.parametrize("estimation", ["ls", "iv"])
@pytest.mark.parametrize("n, forced, seed", [(2, 2, 1), (4, 3, 2)])
def test_masses_and_stiffness_within_two_percent(n, forced, seed, estimation):
    case = chains.duffing(n, [forced], seed=seed, n_samples=16000, cubic=False)
    with pytest.warns(
        DataQualityWarning,
        match="only the acceleration is measured, which tells the displacement above",
    ):
        model = NRFRegressor(degree=1, estimation=estimation).fit(
            record_of(case, 0.02, seed)
        )
    stiffness = np.array(
        [model.restoring_forces_[i].coefficients["s"] for i in range(1, n + 1)]
    )
    assert (
        np.abs(model.masses_ / case.m - 1).max() < 0.02
        and np.abs(stiffness / case.k - 1).max() < 0.02
    )


def test_the_lowest_frequency_follows_the_noise():
    """Noise of an integrated acceleration: rms sqrt(N / (3 (2 pi)^4 f^3)); eight times
    the density, twice the frequency.
    """
    rng = np.random.default_rng(0)
    t = np.arange(120_000) / 500
    clean, noise = np.sin(2 * np.pi * 20 * t), rng.standard_normal(t.size)
    found = [
        lowest_frequency((clean + level * noise)[:, None], 500.0)
        for level in (0.005, 0.005 * 8**0.5)
    ]
    assert found[1] / found[0] == pytest.approx(2.0, rel=0.15)
    density = 2 * 0.005**2 / 500
    share = np.sqrt(density / (3 * (2 * np.pi) ** 4 * found[0] ** 3)) / (
        np.sqrt(0.5) / (2 * np.pi * 20) ** 2
    )
    assert share == pytest.approx(0.02, rel=0.2)


def test_a_displacement_sensor_on_every_floor_needs_no_band():
    case = chains.duffing(2, [1], seed=1, n_samples=3000)
    rec = Record(
        force=case.F, acceleration=case.a, displacement=case.s.cumsum(axis=1), fs=1000.0
    )
    with warnings.catch_warnings(action="error"):
        X, _ = rec.to_features()
    assert (
        X.notna().all(axis=None)
        and KinematicSmoother(band="auto").fit(rec).band_ is None
    )


@pytest.mark.parametrize("first, last", [(6.0, 2.0), (2.0, 6.0)])
def test_several_records_get_the_one_band_that_each_of_them_supports(first, last):
    """The intersection of half-open bands starts at the highest edge, whichever record
    comes last.
    """
    t, rng = np.arange(6000) / 500, np.random.default_rng(0)
    records = [
        np.sin(2 * np.pi * f * t) + 0.02 * rng.standard_normal(t.size)
        for f in (first, last)
    ]
    stacked = pd.DataFrame({"a1": np.concatenate(records)})
    edges = [lowest_frequency(a[:, None], 500.0) for a in records]
    smoother = KinematicSmoother(fs=500.0, band="auto")
    with pytest.warns(
        DataQualityWarning, match="tells the displacement above"
    ) as warned:
        smoother.fit(stacked, record=np.repeat([0, 1], t.size))
    assert edges[0] != edges[1]
    assert smoother.band_ == (max(edges), None) and len(warned) == 1
    assert smoother.high_pass_[1] == pytest.approx(max(edges) / 8)
    limited = smoother.transform(stacked, record=np.repeat([0, 1], t.size))
    known = limited["x1"].notna().to_numpy().reshape(2, -1)
    assert (known[0] == known[1]).all() and known[
        0
    ].sum() == t.size - 2 * smoother.edge_
