"""Accelerations and one force are enough: nothing else is measured or passed."""

import warnings

import chains
import numpy as np
import pandas as pd
import pytest

from pysindy_nrf import KinematicSmoother, NRFRegressor, Record
from pysindy_nrf.exceptions import DataQualityWarning
from pysindy_nrf.records import lowest_frequency
from pysindy_nrf.simulation import add_noise

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("estimation", ["ls", "iv"])
@pytest.mark.parametrize("n, forced, seed", [(2, 2, 1), (4, 3, 2)])
def test_masses_and_stiffness_within_two_percent(n, forced, seed, estimation):
    case = chains.duffing(n, [forced], seed=seed, n_samples=16000, cubic=False)
    record = Record(force=case.F, acceleration=case.a, fs=1 / case.dt)
    model = NRFRegressor(degree=1, estimation=estimation)
    with pytest.warns(DataQualityWarning, match="only the acceleration is measured"):
        model.fit(add_noise(record, 0.02, random_state=seed))
    forces = model.restoring_forces_
    stiffness = [forces[i].coefficients["s"] for i in range(1, n + 1)]
    assert np.abs(model.masses_ / case.m - 1).max() < 0.02
    assert np.abs(np.array(stiffness) / case.k - 1).max() < 0.02


def test_the_lowest_frequency_follows_the_noise():
    """Noise of an integrated acceleration: rms sqrt(N / (3 (2 pi)^4 f^3)); eight times
    the density, twice the frequency.
    """
    t = np.arange(120_000) / 500
    clean = np.sin(2 * np.pi * 20 * t)
    noise = np.random.default_rng(0).standard_normal(t.size)
    low, high = (
        lowest_frequency((clean + level * noise)[:, None], 500.0)
        for level in (0.005, 0.005 * 8**0.5)
    )
    assert high / low == pytest.approx(2.0, rel=0.15)

    density = 2 * 0.005**2 / 500
    noise_rms = np.sqrt(density / (3 * (2 * np.pi) ** 4 * low**3))
    motion_rms = np.sqrt(0.5) / (2 * np.pi * 20) ** 2
    assert noise_rms / motion_rms == pytest.approx(0.02, rel=0.2)


def test_a_displacement_sensor_on_every_floor_needs_no_band():
    case = chains.duffing(2, [1], seed=1, n_samples=3000)
    x = case.s.cumsum(axis=1)
    record = Record(force=case.F, acceleration=case.a, displacement=x, fs=1000.0)
    with warnings.catch_warnings(action="error"):
        X, _ = record.to_features()
    assert X.notna().all(axis=None)
    assert KinematicSmoother(band="auto").fit(record).band_ is None


@pytest.mark.parametrize("first, last", [(6.0, 2.0), (2.0, 6.0)])
def test_several_records_get_the_one_band_that_each_of_them_supports(first, last):
    """Half-open bands have in common what lies above the highest edge, whichever record
    comes last.
    """
    t = np.arange(6000) / 500
    rng = np.random.default_rng(0)
    motions = [
        np.sin(2 * np.pi * f * t) + 0.02 * rng.standard_normal(t.size)
        for f in (first, last)
    ]
    edges = [lowest_frequency(a[:, None], 500.0) for a in motions]
    stacked = pd.DataFrame({"a1": np.concatenate(motions)})
    ids = np.repeat([0, 1], t.size)

    smoother = KinematicSmoother(fs=500.0, band="auto")
    with pytest.warns(DataQualityWarning, match="only the acceleration") as warned:
        smoother.fit(stacked, record=ids)
    assert edges[0] != edges[1]
    assert smoother.band_ == (max(edges), None)
    assert len(warned) == 1
    assert smoother.high_pass_[1] == pytest.approx(max(edges) / 8)

    limited = smoother.transform(stacked, record=ids)
    known = limited["x1"].notna().to_numpy().reshape(2, -1)
    np.testing.assert_array_equal(known[0], known[1])
    assert known[0].sum() == t.size - 2 * smoother.edge_
