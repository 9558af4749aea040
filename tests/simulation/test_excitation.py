"""Excitations and noise have the level, the band and the place that were asked for."""

import numpy as np
import pytest

from pysindy_nrf import Record, datasets
from pysindy_nrf import excitation as drive
from pysindy_nrf.exceptions import ChainError, ChannelError, LawError
from pysindy_nrf.simulation.excitation import band_limited_random, impact_hammer
from pysindy_nrf.simulation.noise import add_noise

FS = 1000.0


def rms(x, axis=0):
    return np.sqrt(np.mean(np.square(x), axis=axis))


def test_hammer_blows_are_half_sines_on_the_floors_in_turn():
    F = impact_hammer(
        4,
        12.0,
        FS,
        excited=[2, 4],
        level=[1000.0, 300.0],
        n_hits=6,
        width=0.02,
        spread=0.2,
        random_state=1,
    )
    assert not F[:, [0, 2]].any()
    for j, level in ((1, 1000.0), (3, 300.0)):
        hits = np.flatnonzero(np.diff((F[:, j] != 0).astype(int)) == 1)
        assert len(hits) == 3
        for start in hits:
            pulse = F[start : start + 25, j]
            assert 0.79 * level < pulse.max() <= level
            # impulse of a half sine: 2 P w / pi
            np.testing.assert_allclose(
                pulse.sum() / FS, 2 / np.pi * pulse.max() * 0.02, rtol=0.01
            )


def test_random_force_has_its_rms_and_stays_in_its_band():
    F = band_limited_random(
        3,
        20.0,
        FS,
        excited=[1, 3],
        rms=[100.0, 400.0],
        band=(5.0, 60.0),
        random_state=2,
    )
    np.testing.assert_allclose(rms(F[:10000])[[0, 2]], 100.0)
    np.testing.assert_allclose(rms(F[10000:])[[0, 2]], 400.0)
    assert not F[:, 1].any() and abs(np.corrcoef(F[:, 0], F[:, 2])[0, 1]) < 0.1
    power = np.abs(np.fft.rfft(F[:10000, 0])) ** 2
    f = np.fft.rfftfreq(10000, 1 / FS)
    assert power[(f < 5) | (f > 60)].sum() < 1e-20 * power.sum()


def test_noise_is_a_share_of_the_rms_of_each_channel():
    t = np.arange(20000) / FS
    x = np.column_stack([np.sin(30 * t), 1e-3 * np.sin(50 * t)])
    clean = Record(
        displacement=x,
        acceleration=1e3 * x,
        force=np.column_stack([0 * t, 7 * np.cos(t)]),
        fs=FS,
    )
    before = clean.displacement.copy()
    noisy = add_noise(clean, 0.05, random_state=0)
    for key in ("displacement", "acceleration"):
        share = rms(getattr(noisy, key) - getattr(clean, key)) / rms(
            getattr(clean, key)
        )
        np.testing.assert_allclose(share, 0.05, rtol=0.03)
    assert (
        not noisy.force[:, 0].any() and (noisy.force[:, 1] != clean.force[:, 1]).all()
    )
    assert np.array_equal(clean.displacement, before) and noisy.fs == clean.fs
    only = add_noise(clean, 0.05, random_state=0, channels=["x2"])
    assert np.array_equal(only.acceleration, clean.acceleration)
    assert np.array_equal(only.displacement[:, 0], clean.displacement[:, 0])
    with pytest.raises(ChannelError, match="v1"):
        add_noise(clean, 0.05, channels=["v1"])


@pytest.mark.parametrize("seed", [0, 3, np.int64(20)])
def test_noise_of_the_same_seed_is_no_copy_of_the_excitation(seed):
    """Independent series of n numbers correlate by 1 / sqrt(n)."""
    n = 4000
    F = band_limited_random(
        1, n / FS, FS, excited=1, rms=1.0, band=(0, FS / 2), random_state=seed
    )
    noise = (
        add_noise(
            Record(force=F, displacement=0 * F, fs=FS), 0.05, random_state=seed
        ).force
        - F
    )[:, 0]
    for drawn in (F[:, 0], np.random.default_rng(seed).standard_normal(n)):
        assert abs(np.corrcoef(noise, drawn)[0, 1]) < 4 / np.sqrt(n)
    again = (
        add_noise(
            Record(force=F, displacement=0 * F, fs=FS), 0.05, random_state=seed
        ).force[:, 0]
        - F[:, 0]
    )
    assert np.array_equal(noise, again)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (
            lambda: drive.impact_hammer(2, 1.0, FS, excited=1, level=1.0, spread=1.0),
            "spread=1.0 is not between 0 and 1",
        ),
        (
            lambda: drive.impact_hammer(2, 1.0, FS, excited=1, level=1.0, n_hits=2.5),
            "n_hits=2.5 is not a whole number",
        ),
        (
            lambda: drive.impact_hammer(2, 1.0, FS, excited=1, level=[]),
            "No level is given",
        ),
        (
            lambda: drive.impact_hammer(2, 1.0, FS, excited=1, level="loud"),
            "level='loud' is not a positive number. .*N",
        ),
        (
            lambda: drive.impact_hammer(2, 1.0, FS, excited=[], level=1.0),
            "No DOF is excited",
        ),
        (
            lambda: drive.impact_hammer(2, 0.001, FS, excited=1, level=1.0),
            "0.001 s at 1000.0 Hz are 1 samples",
        ),
        (
            lambda: drive.impact_hammer(True, 1.0, FS, excited=1, level=1.0),
            "n_dof=True is not a whole number",
        ),
        (
            lambda: drive.band_limited_random(1, 1.0, FS, excited=1, rms=1.0, band=5.0),
            "band=5.0 is not a pair",
        ),
        (
            lambda: add_noise(datasets.load_demo(), "5 %"),
            "level='5 %' is not a share of the RMS",
        ),
    ],
)
def test_an_excitation_names_the_argument_and_its_cure(call, words):
    with pytest.raises((ChannelError, ChainError, LawError), match=words):
        call()


def test_the_noise_of_a_covariate_has_its_share():
    rec = datasets.load_demo()
    t = rec.time
    rec = rec.replace(covariates={"pressure": np.sin(3 * t)})
    noisy = add_noise(rec, 0.1, random_state=0, channels=["pressure"])
    gap = noisy.covariates["pressure"] - rec.covariates["pressure"]
    assert gap.std() == pytest.approx(
        0.1 * np.sqrt(np.mean(np.sin(3 * t) ** 2)), rel=0.05
    )
    np.testing.assert_array_equal(noisy.acceleration, rec.acceleration)
