"""The diagnosis names the true limit of an estimate."""

import functools
import warnings

import integrated
import numpy as np
import pytest
from chains import driven

from pysindy_nrf import (
    ChainModel,
    NRFRegressor,
    Record,
    excitation,
    laws,
    simulate,
)
from pysindy_nrf.simulation import add_noise

STOREY = laws.PowerSeries(1, [25.0, 1.4e5])
MASS = 12.4


def record(truth, dofs=(3,), noise=0.0):
    """A model under random forces on some floors."""
    F = excitation.band_limited_random(
        truth.n_dof,
        8.0,
        1000.0,
        excited=list(dofs),
        rms=100.0,
        band=(0.5, 60.0),
        random_state=0,
    )
    return add_noise(simulate(truth, F, 1e-3, hold="cubic"), noise, random_state=1)


def fitted(rec):
    """A linear fit to channels as they are."""
    with warnings.catch_warnings(action="ignore"):
        return NRFRegressor(degree=1, dt=1e-3).fit(*rec.to_features(smooth=False))


def limits(rec):
    """Limits of such a fit, the gravest first."""
    with warnings.catch_warnings(action="ignore"):
        return fitted(rec).diagnose().table


# -- noise ---------------------------------------------------------------------


@pytest.fixture(scope="module")
def noisy():
    equal = ChainModel([MASS] * 4, {f"storey {i}": STOREY for i in range(1, 5)})
    return record(equal, noise=0.05)


def test_noise_is_the_gravest_limit_of_a_noisy_record(noisy):
    first = limits(noisy).iloc[0]
    assert first["limit"] == "noise"
    assert "estimation='iv'" in first["message"]


def test_the_bias_that_noise_brings_is_about_right(noisy):
    table = limits(noisy)
    of_m3 = table[(table["limit"] == "noise") & (table["where"] == "m3")]
    true_bias = 1 - fitted(noisy).masses_[2] / MASS
    assert 0.3 * true_bias < of_m3["size"].item() < 1.2 * true_bias


def test_a_clean_record_has_no_limit():
    equal = ChainModel([MASS] * 4, {f"storey {i}": STOREY for i in range(1, 5)})
    assert limits(record(equal)).empty


def sines_near_half_the_rate(top, fs=200.0, n=4000):
    """Exact sines on an exact chain, forced on floor 2, up to a share of fs / 2."""
    rng = np.random.default_rng(0)
    t = np.arange(n) / fs
    w = 2 * np.pi * np.linspace(0.5, top * fs / 2, 80)
    lower = laws.PowerSeries(1, [40.0, 4e4])
    upper = laws.PowerSeries(1, [40.0, 3e4])
    M, C, K = ChainModel([10.0, 8.0], {1: lower, 2: upper}).matrices()

    iw = 1j * w[:, None, None]
    receptance = np.linalg.inv(K + iw * C + iw**2 * M)[:, :, 1]
    phase = np.exp(1j * (np.outer(t, w) + rng.uniform(0, 2 * np.pi, len(w))))
    x = (phase @ receptance).real
    v = ((phase * (1j * w)) @ receptance).real
    a = ((phase * (1j * w) ** 2) @ receptance).real
    drifts = np.diff(x, axis=1, prepend=0.0)
    rates = np.diff(v, axis=1, prepend=0.0)
    force = np.column_stack([np.zeros(n), phase.sum(axis=1).real])
    return np.hstack([a, rates, drifts]), force


@pytest.mark.parametrize("top", [0.5, 0.6])
def test_motion_near_half_the_rate_is_not_taken_for_noise(top):
    """Up to 0.3 of the sampling rate: nothing is biased, nothing is announced."""
    model = NRFRegressor(degree=1, dt=1 / 200.0).fit(*sines_near_half_the_rate(top))
    assert model.masses_ == pytest.approx([10.0, 8.0], rel=1e-8)
    assert "noise" not in model.diagnose().table["limit"].tolist()


def test_noise_of_the_force_is_not_called_noise_of_a_quick_motion():
    """A mass at 130 Hz, sampled at 1 kHz: noise in the force alone biases nothing."""
    stiffness = 2.0 * (2 * np.pi * 130) ** 2
    truth = ChainModel([2.0], {"storey 1": laws.PowerSeries(1, [20.0, stiffness])})
    rec = driven(truth, [1], 8.0, 1000.0, 50.0, (5, 180), hold="cubic")
    noise = 5.0 * np.random.default_rng(1).standard_normal(rec.force.shape)
    noisy = limits(rec.replace(force=rec.force + noise))
    assert "noise" not in noisy["limit"].tolist()


@pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.NRFWarning")
@pytest.mark.parametrize("band", [None, (1.0, 30.0)])
def test_the_bias_that_is_said_is_the_bias_that_is_there(band):
    masses = np.array([10.0, 12.0, 8.0])
    truth = ChainModel(masses, {i: laws.PowerSeries(1, [60.0, 4e4]) for i in (1, 2, 3)})
    rec = driven(truth, [1, 2, 3], 8.0, 500.0, 50.0, (1, 60), seed=3)
    X, F = rec.to_features(smooth=False)
    scatter = np.random.default_rng(0).standard_normal(X.shape)
    X = X + 0.1 * X.std().to_numpy() * scatter

    model = NRFRegressor(degree=1, dt=2e-3, band=band).fit(X, F)
    table = model.diagnose().table.query("limit == 'noise'").set_index("where")
    expected = 1 - model.masses_ / masses
    sizes = table["size"].reindex(["m1", "m2", "m3"])
    np.testing.assert_allclose(sizes, expected, atol=0.015)


# -- laws and excitation -------------------------------------------------------


@pytest.mark.parametrize(("c", "creates_energy"), [(-2.0, True), (2.0, False)])
def test_a_damper_of_the_wrong_sign_creates_energy(c, creates_energy):
    truth = ChainModel([12.0, 9.0], {i: laws.PowerSeries(1, [c, 3e4]) for i in (1, 2)})
    noisy = limits(record(truth, (1, 2), noise=0.0002))
    assert ("energy" in noisy["limit"].tolist()) == creates_energy


def test_a_missing_law_is_the_gravest_limit():
    hysteresis = [STOREY, laws.Dahl(sigma=5e4, Fd=60.0)]
    truth = ChainModel([MASS] * 2, {"storey 1": hysteresis, "storey 2": STOREY})
    first = limits(record(truth, dofs=(1, 2))).iloc[0]
    assert first["limit"] == "missing law"
    assert "DOF 1" in first["where"]


def test_a_storey_that_hardly_moves_is_named():
    stiff = laws.PowerSeries(1, [25.0, 2e7])
    storeys = {"storey 1": STOREY, "storey 2": STOREY, "storey 3": stiff}
    table = limits(record(ChainModel([MASS] * 3, storeys), dofs=(2,)))
    assert "storey 3" in table.loc[table["limit"] == "excitation", "where"].tolist()


# -- channels ------------------------------------------------------------------


@functools.cache
def two_floors():
    """Motions of two floors by an own integrator, and the force on floor 2."""
    rng = np.random.default_rng(0)
    push = integrated.multisine(rng, 250.0, 10.0, (0.5, 25.0), 100.0)

    def forces(t):
        return np.array([0.0, push(t)])

    run = integrated.run([10.0, 8.0], [60.0, 60.0], [2e4, 1e4], 250.0, 10.0, forces)
    return push, run


def with_fault(fault):
    """Two floors with displacement sensors and accelerometers, one of them at fault."""
    push, (a, _, x, t) = two_floors()
    a, x = a.copy(), x.copy()
    if fault == "late":
        x[3:, 0] = x[:-3, 0].copy()
    if fault == "gain":
        x[:, 0] *= 1.3
    if fault == "clipped":
        low, high = 0.7 * a[:, 0].min(), 0.7 * a[:, 0].max()
        a[:, 0] = np.clip(a[:, 0], low, high)
    force = np.column_stack([0 * t, push(t)])
    return Record(acceleration=a, displacement=x, force=force, fs=250.0)


def diagnosed(data):
    """The diagnosis of a fit, and what the fit warned of."""
    with warnings.catch_warnings(record=True, action="always") as caught:
        model = NRFRegressor(degree=1).fit(data)
    texts = [str(warning.message) for warning in caught]
    return model.diagnose().table, " ".join(texts)


@pytest.mark.parametrize(
    ("fault", "channel", "words"),
    [
        ("late", "x1 is", "samples) late"),
        ("gain", "x1 is", "1.3"),
        ("clipped", "a1 is", "is cut off"),
    ],
)
def test_what_fit_said_of_channels_is_the_gravest_limit(fault, channel, words):
    table, warned = diagnosed(with_fault(fault))
    of_channels = table.loc[table["limit"] == "channel", "message"]
    assert table["limit"][0] == "channel"
    assert of_channels[0].rstrip(".") in warned
    assert [text for text in of_channels if channel in text and words in text]


def test_what_fit_said_of_channels_is_known_of_several_records():
    table, _ = diagnosed([with_fault("late"), with_fault("late")])
    assert table["limit"][0] == "channel"
    assert "samples) late" in table["message"][0]


def test_channels_without_a_fault_are_not_named():
    table, _ = diagnosed(with_fault(""))
    assert "channel" not in table["limit"].tolist()
