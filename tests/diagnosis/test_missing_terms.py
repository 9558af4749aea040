"""A missing law is warned of, in every kind of record; noise alone raises no alarm."""

import warnings

import numpy as np
import pytest
from three_floors import chain, features, noisy, run

from pysindy_nrf import NRFRegressor, laws
from pysindy_nrf.equations import nrmse
from pysindy_nrf.exceptions import BiasWarning
from pysindy_nrf.simulation import add_noise

FRICTION = 25.0
MISSING = {
    "friction": laws.CoulombFriction(FRICTION),
    "hysteresis": laws.Dahl(sigma=2e3, Fd=40.0),
    "gap": laws.TwoSidedGap(gap=2e-3, k=5e4),
    "quadratic damping": laws.QuadraticDamping(400.0),
}


@pytest.mark.parametrize("name", MISSING)
@pytest.mark.parametrize("dofs", [[1, 2, 3], [3]])
def test_a_missing_law_is_warned_of(name, dofs):
    X, F = features(run(chain((1, MISSING[name])), dofs))

    with pytest.warns(BiasWarning, match="Balance of DOF 1"):
        NRFRegressor(degree=1).fit(X, F)


TRUTHS = {
    "linear": chain(),
    "cubic": chain((2, laws.CubicStiffness(2e9))),
    "friction": chain((1, laws.CoulombFriction(FRICTION))),
}
DECLARED = {
    "linear": None,
    "cubic": None,
    "friction": {"storey 1": [laws.PowerSeries(1), laws.CoulombFriction()]},
}


def fit_with_noise(kind, dofs, noise):
    """A fit with all laws declared, and the motion and force without noise."""
    result = run(TRUTHS[kind], dofs, seed=int(100 * noise) + 1)
    X, F = features(result)
    if noise:
        X, F = noisy(result, noise, np.random.default_rng(0))
    return NRFRegressor(degree=3, laws=DECLARED[kind]).fit(X, F), features(result)[0]


CASES = [("linear", noise) for noise in (0.0, 0.02, 0.1)]
CASES += [("cubic", 0.0), ("friction", 0.0)]


@pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.BiasWarning")
@pytest.mark.parametrize(("kind", "noise"), CASES)
@pytest.mark.parametrize("dofs", [[1, 2, 3], [3]])
def test_there_is_no_alarm_where_all_laws_are_declared(kind, noise, dofs):
    model, _ = fit_with_noise(kind, dofs, noise)

    assert not model.missing_terms_["biased"].any()


@pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.BiasWarning")
@pytest.mark.parametrize("noise", [0.02, 0.1])
@pytest.mark.parametrize("dofs", [[1, 2, 3], [3]])
@pytest.mark.parametrize("kind", ["cubic", "friction"])
def test_an_alarm_by_noise_in_nonlinear_laws_is_true(kind, noise, dofs):
    """Noise that goes through a cube or a sign does bias forces."""
    model, exact = fit_with_noise(kind, dofs, noise)
    if not model.missing_terms_["biased"].any():
        return

    true_forces = TRUTHS[kind].restoring_force(exact).T
    found_forces = model.restoring_force(exact).T
    errors = [nrmse(true, fitted) for true, fitted in zip(true_forces, found_forces)]
    friction = FRICTION
    if kind == "friction":
        friction = model.model_.laws["storey 1"][-1].coefficients[-1]
    assert max(errors) > 2.0 or abs(friction / FRICTION - 1) > 0.1


def test_noise_in_unfused_channels_is_warned_of():
    record = add_noise(run(chain(), [3]).record, 0.05, random_state=0)
    X, F = record.to_features(smooth=False)

    with pytest.warns(BiasWarning, match="KinematicSmoother"):
        model = NRFRegressor(degree=1).fit(X, F)

    assert model.masses_.min() < 9.5  # least squares is biased low, of 10 kg


HYSTERESIS = chain((2, laws.Dahl(sigma=2e4, Fd=25.0)))


def test_a_missing_hysteresis_is_found_in_a_band():
    X, F = features(run(HYSTERESIS, [3]))

    with pytest.warns(BiasWarning):
        model = NRFRegressor(degree=3, band=(1, 60)).fit(X, F)

    assert model.missing_terms_["biased"].any()


@pytest.mark.parametrize("band", [None, (1, 60)])
def test_a_declared_hysteresis_is_not_missing(band):
    X, F = features(run(HYSTERESIS, [3]))
    declared = {"storey 2": [laws.PowerSeries(1), laws.Dahl(sigma=2e4)]}

    model = NRFRegressor(degree=1, laws=declared, band=band).fit(X, F)

    assert not model.missing_terms_["biased"].any()


@pytest.mark.parametrize("friction", [0.0, 15.0])
def test_a_missing_force_has_its_size_in_a_long_record(friction):
    """Of 60,000 samples some thousand are judged.

    Of a friction in random motion a damper takes the share 2/pi.
    """
    rng = np.random.default_rng(0)
    v = 0.1 * rng.standard_normal((60_000, 2))
    s = 1e-3 * rng.standard_normal((60_000, 2))
    a = 10.0 * rng.standard_normal((60_000, 2))
    R = 80 * v + 1e5 * s + np.sign(v) * [friction, 0.0]
    F = [10.0, 8.0] * a + R
    F[:, 0] -= R[:, 1]
    F += 0.005 * F.std(axis=0) * rng.standard_normal(F.shape)

    with warnings.catch_warnings(action="ignore"):
        table = NRFRegressor(degree=1).fit(np.hstack([a, v, s]), F).missing_terms_

    biased = table["biased"].to_dict()
    assert biased == {"balance of DOF 2": False, "balance of DOF 1": friction > 0}
    share = 100 * friction * np.sqrt(1 - 2 / np.pi) / F[:, 0].std()
    missing = table.loc["balance of DOF 1", "missing"]
    assert missing == pytest.approx(share, rel=0.05, abs=0.05)
