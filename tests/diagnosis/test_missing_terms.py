"""A missing law is warned of, in every kind of record; noise alone raises no alarm."""

import warnings

import numpy as np
import pytest
from three_floors import chain, features, noisy, run

from pysindy_nrf import NRFRegressor, laws
from pysindy_nrf.equations.errors import nrmse
from pysindy_nrf.exceptions import BiasWarning
from pysindy_nrf.simulation.noise import add_noise

MISSING = {
    "friction": laws.CoulombFriction(25.0),
    "hysteresis": laws.Dahl(sigma=2e3, Fd=40.0),
    "gap": laws.TwoSidedGap(gap=2e-3, k=5e4),
    "quadratic damping": laws.QuadraticDamping(400.0),
}


@pytest.mark.parametrize("name", MISSING)
@pytest.mark.parametrize("dofs", [[1, 2, 3], [3]])
def test_missing_law_is_warned_of(name, dofs):
    X, F = features(run(chain((1, MISSING[name])), dofs))
    with pytest.warns(BiasWarning, match="Balance of DOF 1"):
        NRFRegressor(degree=1).fit(X, F)


@pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.BiasWarning")
@pytest.mark.parametrize("noise", [0.0, 0.02, 0.1])
@pytest.mark.parametrize("dofs", [[1, 2, 3], [3]])
@pytest.mark.parametrize("kind", ["linear", "cubic", "friction"])
def test_no_false_alarm_with_noise(noise, dofs, kind):
    law = {
        "linear": (),
        "cubic": ((2, laws.CubicStiffness(2e9)),),
        "friction": ((1, laws.CoulombFriction(25.0)),),
    }[kind]
    known = (
        {"storey 1": [laws.PowerSeries(1), laws.CoulombFriction()]}
        if kind == "friction"
        else None
    )
    truth = chain(*law)
    result = run(truth, dofs, seed=int(100 * noise) + 1)
    X, F = noisy(result, noise, np.random.default_rng(0)) if noise else features(result)
    model = NRFRegressor(degree=3, laws=known).fit(X, F)
    if kind == "linear" or not noise:
        assert not model.missing_terms_["biased"].any(), model.missing_terms_
    elif model.missing_terms_["biased"].any():
        # noise that goes through a cube or a sign does bias; then the alarm is true
        exact, _ = features(result)
        forces = [
            nrmse(*pair)
            for pair in zip(
                truth.restoring_force(exact).T, model.restoring_force(exact).T
            )
        ]
        friction = (
            model.model_.laws["storey 1"][-1].coefficients[-1]
            if kind == "friction"
            else 25.0
        )
        assert max(forces) > 2.0 or abs(friction / 25.0 - 1) > 0.1


def test_noise_in_unfused_channels_is_warned_of_too():
    noisy_record = add_noise(run(chain(), [3]).record, 0.05, random_state=0)
    X, F = noisy_record.to_features(smooth=False)
    with pytest.warns(BiasWarning, match="KinematicSmoother"):
        model = NRFRegressor(degree=1).fit(X, F)
    assert model.masses_.min() < 9.5  # and rightly: least squares is biased low


def test_missing_terms_in_a_band_and_on_memory_laws():
    X, F = features(run(chain((2, laws.Dahl(sigma=2e4, Fd=25.0))), [3]))
    with pytest.warns(BiasWarning):
        banded = NRFRegressor(degree=3, band=(1, 60)).fit(X, F)
    assert banded.missing_terms_["biased"].any()
    held = {"storey 2": [laws.PowerSeries(1), laws.Dahl(sigma=2e4)]}
    for band in (None, (1, 60)):
        assert (
            not NRFRegressor(degree=1, laws=held, band=band)
            .fit(X, F)
            .missing_terms_["biased"]
            .any()
        )


def test_a_missing_force_is_said_in_a_long_record_too():
    """Of 60,000 samples some thousand are judged. Of a friction in random motion a
    damper takes the share 2/pi.
    """
    rng = np.random.default_rng(0)
    v, s, a = (size * rng.standard_normal((60_000, 2)) for size in (0.1, 1e-3, 10.0))
    for friction in (0.0, 15.0):
        R = 80 * v + 1e5 * s + np.sign(v) * [friction, 0.0]  # at storey 1
        F = [10.0, 8.0] * a + R - np.column_stack([R[:, 1], np.zeros(len(R))])
        F += 0.005 * F.std(axis=0) * rng.standard_normal(F.shape)
        with warnings.catch_warnings(action="ignore"):
            found = NRFRegressor(degree=1).fit(np.hstack([a, v, s]), F).missing_terms_
        assert found["biased"].to_dict() == {
            "balance of DOF 2": False,
            "balance of DOF 1": friction > 0,
        }
        left = friction * np.sqrt(1 - 2 / np.pi) / F[:, 0].std()
        assert found.loc["balance of DOF 1", "missing"] == pytest.approx(
            100 * left, rel=0.05, abs=0.05
        )
