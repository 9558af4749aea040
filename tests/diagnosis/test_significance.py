"""Nonlinear terms are named where the data show them, whatever the degree."""

import numpy as np
import pytest

from pysindy_nrf import ChainModel, NRFRegressor, excitation, laws, simulate
from pysindy_nrf.diagnosis.significance import SeriesEstimate


def estimate_of(force, s, v, n_pieces=40):
    """Least squares of a force by powers of the drift, and its jackknife."""
    labels = ["v", "s", "s^2", "s^3", "s^4", "s^5", "s^6", "s^7"]
    columns = np.column_stack([v, *(s**power for power in range(1, 8))])
    pieces = np.array_split(np.arange(len(s)), n_pieces)
    values = np.linalg.lstsq(columns, force)[0]

    without = []
    for piece in pieces:
        rest = np.setdiff1d(np.arange(len(s)), piece)
        without.append(np.linalg.lstsq(columns[rest], force[rest])[0])
    return SeriesEstimate(labels, values, np.array(without), columns.T @ columns)


@pytest.fixture(scope="module")
def motion():
    return np.random.default_rng(4).standard_normal((2, 1500))


def test_noise_alone_rejects_zero_as_often_as_its_level_says(motion):
    s, v = motion
    rng = np.random.default_rng(11)
    n_rejected = 0
    for _ in range(60):
        noise = rng.standard_normal(len(s))
        estimate = estimate_of(2 * s + v + noise, s, v)
        n_rejected += estimate.p_value(estimate.numbers("s")) < 0.1
    # binomial of 60 and 0.1: 0 to 14 in 99.9 %
    assert n_rejected <= 14


@pytest.mark.parametrize(
    ("size", "noise", "kind"),
    [
        (0.1, 0.1, "nonlinear stiffness"),
        (0.0, 0.5, ""),
        # sure, but of no size
        (1e-3, 1e-4, ""),
    ],
)
def test_a_cubic_is_named_if_it_is_sure_and_large(motion, size, noise, kind):
    s, v = motion
    errors = noise * np.random.default_rng(3).standard_normal(len(s))
    force = 2 * s + v + size * s**3 + errors
    assert estimate_of(force, s, v).kind == kind


@pytest.fixture(scope="module")
def frames():
    """Two floors of 9 and 7 kg, linear and with a cubic first storey."""
    storey = [laws.LinearElastic(2.5e4), laws.LinearViscous(25.0)]
    F = excitation.band_limited_random(
        2, 6.0, 400.0, excited=2, rms=80.0, band=(1, 40), random_state=2
    )
    motions = {}
    for name, more in (("linear", []), ("cubic", [laws.CubicStiffness(2e8)])):
        truth = ChainModel([9.0, 7.0], {1: [*storey, *more], 2: storey})
        X, F_known = simulate(truth, F, 1 / 400.0).to_features()
        noise = np.random.default_rng(6).standard_normal(X.shape)
        X_noisy = X + 0.002 * X.to_numpy().std(axis=0) * noise
        motions[name] = (X_noisy, F_known)
    return motions


@pytest.mark.parametrize("degree", [3, 5, 7])
def test_a_cubic_storey_is_named_at_any_degree_and_a_linear_one_never(frames, degree):
    named = {}
    for name, (X, F) in frames.items():
        result = NRFRegressor(degree=degree).fit(X, F).result_
        named[name] = result.facts.holds
    assert named["linear"] == ()
    assert len(named["cubic"]) == 1
    assert "in storey 1" in named["cubic"][0]
