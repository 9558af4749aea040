"""The result of an identification: one table of estimates, residuals, one verdict."""

import pickle

import numpy as np
import pytest

from pysindy_nrf import ChainModel, NRFRegressor, excitation, laws, simulate
from pysindy_nrf.diagnosis import residual_of

FS = 500.0


@pytest.fixture(scope="module")
def result():
    """Two floors whose forces carry noise of 5 N."""
    storey = laws.PowerSeries(1, [60.0, 1e5])
    truth = ChainModel([10.0, 11.0], {1: storey, 2: storey})
    force = excitation.band_limited_random(
        2, 8.0, FS, excited=[1, 2], rms=100.0, band=(0.5, 50.0), random_state=0
    )
    X, F = simulate(truth, force, 1 / FS).to_features(smooth=False)
    F += 5.0 * np.random.default_rng(1).normal(size=F.shape)
    known = {2: 11.0}
    return NRFRegressor(degree=1, dt=1 / FS, known_masses=known).fit(X, F).result_


def test_a_summary_has_every_estimate_with_its_interval(result):
    table = result.summary().to_frame()
    names = ["m1", "m2", "storey 1: v", "storey 1: s", "storey 2: v", "storey 2: s"]
    assert list(table.index) == names
    assert list(table["unit"]) == ["kg", "kg", "N s/m", "N/m", "N s/m", "N/m"]
    assert np.isnan(table.loc["m2", "lower"]), "a known mass has no interval"
    for name, true in {"m1": 10.0, "storey 1: s": 1e5, "storey 2: s": 1e5}.items():
        assert table.loc[name, "lower"] < true < table.loc[name, "upper"]


def test_the_residual_is_the_noise_of_the_forces(result):
    (residual,) = residual_of(result.model, result.data).balance
    assert residual.shape == (4000, 2)
    assert residual.std(axis=0) == pytest.approx([5.0, 5.0], rel=0.05)


def test_a_verdict_is_made_once_and_saved(result):
    verdict = result.verdict
    assert verdict.state == "green"
    assert result.verdict is verdict
    assert pickle.loads(pickle.dumps(result)).verdict == verdict


def test_a_result_does_not_change(result):
    with pytest.raises(AttributeError):
        result.method = "iv"


def test_a_result_names_its_method(result):
    assert result.method == "ls"
    assert result.model.info["estimation"] == {"asked": "auto", "found": "ls"}
