"""Identification behind high-pass filters, and beside displacements that wander."""

import numpy as np
import pytest
from scipy.signal import butter, sosfilt

from pysindy_nrf import ChainModel, NRFRegressor, excitation, laws, simulate
from pysindy_nrf.simulation import add_noise

FS = 250.0
MASSES = [60.0, 50.0]
SPRING, DASHPOT = 8e4, 50.0
pytestmark = pytest.mark.filterwarnings("ignore")


def clean_test(law=None, band=(1.0, 25.0)):
    """Half a minute of two floors, shaken on the upper one."""
    storey = [laws.LinearElastic(SPRING), laws.LinearViscous(DASHPOT)]
    first = storey if law is None else [*storey, law]
    truth = ChainModel(MASSES, {1: first, 2: storey})
    F = excitation.band_limited_random(
        2, 30.0, FS, excited=[2], rms=80.0, band=band, random_state=8
    )
    return simulate(truth, F, 1 / FS, hold="cubic").replace(velocity=None)


def filtered(values, corner):
    return sosfilt(butter(1, corner, "high", fs=FS, output="sos"), values, axis=0)


def noisy(record):
    return add_noise(record, 0.005, random_state=3)


def kinds(model):
    return {(note.kind, note.channel) for note in model.result_.examination.quality}


def require_truth(model):
    assert model.masses_ == pytest.approx(MASSES, rel=0.005)
    for storey in (1, 2):
        values = model.restoring_forces_[storey].coefficients
        assert values["s"] == pytest.approx(SPRING, rel=0.005)
        assert values["v"] == pytest.approx(DASHPOT, rel=0.05)


def test_accelerations_behind_filters_are_set_right():
    clean = clean_test()
    record = clean.replace(acceleration=filtered(clean.acceleration, 0.7))
    model = NRFRegressor(degree=1).fit(noisy(record))

    require_truth(model)
    assert kinds(model) == {("corner", "a1"), ("corner", "a2")}
    assert model.result_.verdict.state == "amber"


def test_so_is_the_force_behind_the_same_amplifier():
    clean = clean_test()
    record = clean.replace(
        acceleration=filtered(clean.acceleration, 0.7),
        force=filtered(clean.force, 0.7),
    )
    model = NRFRegressor(degree=1).fit(noisy(record))

    require_truth(model)
    assert ("corner", "F2") in kinds(model)
    sizes = [note.size for note in model.result_.examination.quality]
    assert sizes == pytest.approx([0.7] * 3, rel=0.1)


def random_walk(n_samples, seed=0):
    steps = np.random.default_rng(seed).standard_normal((n_samples, 2))
    return np.cumsum(steps, axis=0) / np.sqrt(n_samples)


def ramp(n_samples):
    return np.linspace(0.0, 1.0, n_samples)[:, None] * [1.0, -0.6]


@pytest.mark.parametrize("course", [random_walk, ramp])
def test_the_slow_drift_of_displacements_is_left_out(course):
    clean = clean_test()
    drift = 0.3 * clean.displacement.std() * course(clean.n_samples)
    record = clean.replace(displacement=clean.displacement + drift)
    model = NRFRegressor(degree=1).fit(noisy(record))

    require_truth(model)
    assert kinds(model) == {("drift", "x1"), ("drift", "x2")}
    assert model.result_.verdict.state == "amber"
    assert model.result_.free_runs.error < 5.0


def test_a_storey_that_yields_does_not_wander():
    """Its permanent displacement is slow, too."""
    slider = laws.Jenkins(uy=1e-3, Fy=60.0)
    model = NRFRegressor(degree=1).fit(noisy(clean_test(slider)))
    assert not {kind for kind, _ in kinds(model)} & {"drift", "corner"}


@pytest.mark.parametrize("band", [(0.05, 25.0), (1.0, 25.0)])
def test_clean_channels_stay_as_they_are(band):
    model = NRFRegressor(degree=1).fit(noisy(clean_test(band=band)))
    assert not kinds(model)
    assert model.result_.verdict.state == "green"
