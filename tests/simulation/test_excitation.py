"""Excitations and noise have the level, the band and the place that were asked for."""

from functools import partial

import numpy as np
import pytest

from pysindy_nrf import Record, datasets
from pysindy_nrf.exceptions import ChainError, ChannelError, LawError
from pysindy_nrf.simulation import add_noise
from pysindy_nrf.simulation.excitation import band_limited_random, impact_hammer

FS = 1000.0  # Hz


def rms(x, axis=0):
    return np.sqrt(np.mean(np.square(x), axis=axis))


# -- blows ---------------------------------------------------------------------


@pytest.fixture(scope="module")
def blows():
    """Six blows in turn on floors 2 and 4."""
    return impact_hammer(
        4,
        duration=12.0,
        fs=FS,
        excited=[2, 4],
        level=[1000.0, 300.0],
        n_hits=6,
        width=0.02,
        spread=0.2,
        random_state=1,
    )


@pytest.mark.parametrize(("floor", "level"), [(2, 1000.0), (4, 300.0)])
def test_blows_are_half_sines_of_their_level(blows, floor, level):
    force = blows[:, floor - 1]
    starts = np.flatnonzero(np.diff((force != 0).astype(int)) == 1)
    assert len(starts) == 3
    for start in starts:
        pulse = force[start : start + 25]
        impulse_of_half_sine = 2 / np.pi * pulse.max() * 0.02
        assert 0.79 * level < pulse.max() <= level
        np.testing.assert_allclose(pulse.sum() / FS, impulse_of_half_sine, rtol=0.01)


def test_floors_that_are_not_hit_have_no_force(blows):
    assert not blows[:, [0, 2]].any()


# -- random forces -------------------------------------------------------------


@pytest.fixture(scope="module")
def random_forces():
    """Forces on floors 1 and 3 whose level rises after ten of twenty seconds."""
    return band_limited_random(
        3,
        duration=20.0,
        fs=FS,
        excited=[1, 3],
        rms=[100.0, 400.0],
        band=(5.0, 60.0),
        random_state=2,
    )


def test_random_forces_have_their_levels(random_forces):
    np.testing.assert_allclose(rms(random_forces[:10000])[[0, 2]], 100.0)
    np.testing.assert_allclose(rms(random_forces[10000:])[[0, 2]], 400.0)
    assert not random_forces[:, 1].any()


def test_random_forces_are_independent(random_forces):
    correlation = np.corrcoef(random_forces[:, 0], random_forces[:, 2])[0, 1]
    assert abs(correlation) < 0.1


def test_random_forces_stay_in_their_band(random_forces):
    power = np.abs(np.fft.rfft(random_forces[:10000, 0])) ** 2
    frequency = np.fft.rfftfreq(10000, 1 / FS)
    outside = (frequency < 5) | (frequency > 60)
    assert power[outside].sum() < 1e-20 * power.sum()


# -- noise ---------------------------------------------------------------------


@pytest.fixture
def clean():
    """Displacements and accelerations of two floors, of which one is forced."""
    t = np.arange(20000) / FS
    x = np.column_stack([np.sin(30 * t), 1e-3 * np.sin(50 * t)])
    force = np.column_stack([0 * t, 7 * np.cos(t)])
    return Record(displacement=x, acceleration=1e3 * x, force=force, fs=FS)


@pytest.mark.parametrize("channel", ["displacement", "acceleration"])
def test_noise_is_a_share_of_the_rms_of_each_channel(clean, channel):
    before = clean.displacement.copy()
    noisy = add_noise(clean, 0.05, random_state=0)
    values = getattr(clean, channel)
    share = rms(getattr(noisy, channel) - values) / rms(values)
    np.testing.assert_allclose(share, 0.05, rtol=0.03)
    np.testing.assert_array_equal(clean.displacement, before)
    assert noisy.fs == clean.fs


def test_an_unforced_floor_stays_without_force(clean):
    noisy = add_noise(clean, 0.05, random_state=0)
    assert not noisy.force[:, 0].any()
    assert (noisy.force[:, 1] != clean.force[:, 1]).all()


def test_noise_of_chosen_channels(clean):
    noisy = add_noise(clean, 0.05, random_state=0, channels=["x2"])
    np.testing.assert_array_equal(noisy.acceleration, clean.acceleration)
    np.testing.assert_array_equal(noisy.displacement[:, 0], clean.displacement[:, 0])
    assert (noisy.displacement[:, 1] != clean.displacement[:, 1]).any()
    with pytest.raises(ChannelError, match="v1"):
        add_noise(clean, 0.05, channels=["v1"])


def test_noise_of_a_covariate():
    record = datasets.load_demo()
    pressure = np.sin(3 * record.time)
    record = record.replace(covariates={"pressure": pressure})
    noisy = add_noise(record, 0.1, random_state=0, channels="pressure")
    noise = noisy.covariates["pressure"] - pressure
    assert noise.std() == pytest.approx(0.1 * rms(pressure), rel=0.05)
    np.testing.assert_array_equal(noisy.acceleration, record.acceleration)


def noise_on_force(force, seed):
    record = Record(force=force, displacement=0 * force, fs=FS)
    return (add_noise(record, 0.05, random_state=seed).force - force)[:, 0]


@pytest.mark.parametrize("seed", [0, 3, np.int64(20)])
def test_noise_of_the_same_seed_is_no_copy_of_the_excitation(seed):
    """Independent series of n numbers correlate by 1 / sqrt(n)."""
    n = 4000
    force = band_limited_random(
        1, n / FS, FS, excited=1, rms=1.0, band=(0, FS / 2), random_state=seed
    )
    noise = noise_on_force(force, seed)
    drawn = np.random.default_rng(seed).standard_normal(n)
    assert abs(np.corrcoef(noise, force[:, 0])[0, 1]) < 4 / np.sqrt(n)
    assert abs(np.corrcoef(noise, drawn)[0, 1]) < 4 / np.sqrt(n)
    np.testing.assert_array_equal(noise_on_force(force, seed), noise)


# -- wrong arguments -----------------------------------------------------------

hammer = partial(impact_hammer, n_dof=2, duration=1.0, fs=FS, excited=1, level=1.0)
shaker = partial(
    band_limited_random, n_dof=1, duration=1.0, fs=FS, excited=1, rms=1.0, band=(1, 9)
)


@pytest.mark.parametrize(
    ("draw", "argument", "message"),
    [
        (hammer, {"spread": 1.0}, "spread=1.0 is not between"),
        (hammer, {"n_hits": 2.5}, "n_hits=2.5 is not"),
        (hammer, {"n_hits": 60}, "60 blows .* do not fit"),
        (hammer, {"width": 1e-3}, "shorter than two samples"),
        (hammer, {"level": []}, "No level is given"),
        (hammer, {"level": "loud"}, "level='loud' is not"),
        (hammer, {"excited": []}, "No DOF is excited"),
        (hammer, {"duration": 0.001}, "are 1 samples"),
        (hammer, {"n_dof": True}, "n_dof=True is not"),
        (shaker, {"band": 5.0}, "band=5.0 is not a pair"),
        (shaker, {"band": (1.1, 1.2)}, "no frequency of a record"),
    ],
)
def test_a_wrong_argument_of_an_excitation_is_named(draw, argument, message):
    with pytest.raises((ChannelError, ChainError, LawError), match=message):
        draw(**argument)


def test_a_level_of_noise_is_a_number():
    with pytest.raises(ChannelError, match="level='5 %'"):
        add_noise(datasets.load_demo(), "5 %")
