"""The kind of dependence comes out without a formula."""

import numpy as np
import pytest
from scipy import stats
from scipy.integrate import solve_ivp

from pysindy_nrf.diagnosis import Dependence, Feature, characterise, spectral_line
from pysindy_nrf.exceptions import ChannelError
from pysindy_nrf.laws import Motion
from pysindy_nrf.records import ZeroPhaseFilter

pytestmark = pytest.mark.slow

FS, DURATION = 400, 30.0
DRIVE = np.random.default_rng(0)
# of 40 lines of a motion
OMEGA = 2 * np.pi * DRIVE.uniform(1, 12, 40)
PHASE = DRIVE.uniform(0, 2 * np.pi, 40)
AMPLITUDE = 1e-3 / (1 + (OMEGA / (2 * np.pi) - 4) ** 2)


def angles(t):
    return np.multiply.outer(t, OMEGA) + PHASE


def rate_of_drift(t):
    return (AMPLITUDE * OMEGA * np.cos(angles(t))).sum(axis=-1)


T = np.arange(int(DURATION * FS)) / FS
S = (AMPLITUDE * np.sin(angles(T))).sum(axis=-1)
V = rate_of_drift(T)
A = -(AMPLITUDE * OMEGA**2 * np.sin(angles(T))).sum(axis=-1)
UNIT = S.std()
VOLTAGE = 1 + 0.8 * np.sin(2 * np.pi * 0.3 * T)
MOTION = Motion(S, V, A, T, {"U": VOLTAGE})


def bouc_wen():
    """The state of a Bouc-Wen law along the motion."""

    def rate(t, z):
        v = rate_of_drift(t) / UNIT
        return v - 2.0 * abs(v) * abs(z) * z - 2.0 * v * z**2

    span, steps = (0, T[-1]), {"rtol": 1e-6, "atol": 1e-8, "max_step": 0.01}
    return solve_ivp(rate, span, [0.0], "LSODA", T, **steps).y[0]


def two_sided_gap():
    return np.sign(S) * np.maximum(np.abs(S) - 1.2 * UNIT, 0)


def harmonic():
    return np.cos(2 * np.pi * 7.3456 * T + 1)


def left_of(force, noise=0.05):
    """What a linear baseline leaves of a force of 20 N rms, and noise of a share."""
    force = force / np.sqrt(np.mean(force**2))
    linear = np.column_stack([S / UNIT, V / V.std(), A / A.std()])
    residual = force - linear @ np.linalg.lstsq(linear, force, rcond=None)[0]
    scatter = np.random.default_rng(0).standard_normal(len(residual))
    return 20 * (residual + noise * np.sqrt(np.mean(residual**2)) * scatter)


def chosen(characterisation):
    """The row of the table of shares that was chosen."""
    (row,) = characterisation.shares.index[characterisation.shares["chosen"]]
    return row


@pytest.mark.parametrize(
    ("force", "row", "parity", "word"),
    [
        (np.sign(V), "v alone", "odd", "friction-like"),
        (V * np.abs(V), "v alone", "odd", "nonlinear damping"),
        (S**3, "s alone", "odd", "hardening"),
        (np.tanh(S / UNIT), "s alone", "odd", "softening"),
        (two_sided_gap(), "s alone", "odd", "gap"),
        (np.maximum(S - 0.8 * UNIT, 0), "s alone", "neither odd", "contact on one"),
        (S**2, "s alone", "even", "nonlinear spring"),
        (harmonic(), "line", "", "7.34"),
        (S * T, "time", "", "Changes in time"),
        (np.sign(V) * VOLTAGE, "covariate U", "", "modulated by U"),
        (1 + 0 * S, "constant", "", "offset"),
    ],
)
def test_a_force_is_said_to_depend_on_what_it_does(force, row, parity, word):
    characterisation = characterise([left_of(force)], [MOTION])
    assert chosen(characterisation) == row
    assert characterisation.shares.loc[row, "share"] > 90
    assert parity in characterisation.sentence and word in characterisation.sentence
    if row in ("s alone", "v alone"):
        assert abs(characterisation.memory) < 2


def test_a_step_of_stiffness_changes_in_time():
    characterisation = characterise([left_of(S * (T > 12))], [MOTION])
    assert chosen(characterisation) == "time"
    assert characterisation.shares.loc["time", "share"] > 85


def test_hysteresis_depends_on_the_path():
    characterisation = characterise([left_of(bouc_wen())], [MOTION])
    assert characterisation.dependence == Dependence.PATH
    assert characterisation.memory > 15
    assert "hysteresis" in characterisation.sentence


def test_the_frequency_of_a_line_is_found():
    characterisation = characterise([left_of(harmonic())], [MOTION])
    assert characterisation.frequency == pytest.approx(7.3456, abs=0.002)


def test_noise_depends_on_nothing():
    noise = np.random.default_rng(0).standard_normal(len(T))
    characterisation = characterise([noise], [MOTION], noise=1.0)
    assert characterisation.dependence == Dependence.NOTHING
    assert np.isnan(characterisation.frequency)
    assert (characterisation.shares["share"] < 1).all()
    assert "noise is 100 %" in characterisation.sentence


def test_band_is_treated_fairly():
    band = ZeroPhaseFilter((0.5, 20.0), FS)
    force = band.apply(20 * np.sign(V))
    characterisation = characterise([force], [Motion(S, V, A, T)], filters=[band])
    assert characterisation.dependence == Dependence.RATE
    assert Feature.JUMP in characterisation.features
    assert characterisation.shares.loc["v alone", "share"] > 99.5


def test_columns_of_the_baseline_are_allowed_for():
    other = np.roll(S, 777)
    force = 20 * np.sign(V) + 4e4 * other
    characterisation = characterise(
        [force], [Motion(S, V, A, T)], beside=[other[:, None]]
    )
    assert characterisation.dependence == Dependence.RATE
    assert characterisation.shares.loc["v alone", "share"] > 99


def test_several_records_are_read_together():
    force, half = left_of(np.sign(V), 0.02), len(T) // 2
    forces, motions = [], []
    for rows in (slice(0, half), slice(half, None)):
        forces.append(force[rows])
        motions.append(Motion(S[rows], V[rows], A[rows], T[rows] - T[rows][0]))
    assert characterise(forces, motions).dependence == Dependence.RATE


def test_means_of_a_force_follow_the_rate():
    curve = characterise([5 * np.sign(V)], [MOTION]).curves["v"]
    assert curve["count"].sum() == len(V)
    assert np.allclose(curve["mean"].iloc[[0, -1]], [-5, 5])


def test_a_force_that_is_not_known_throughout_is_refused():
    with pytest.raises(ChannelError, match="not finite"):
        characterise([np.where(T > 1, S, np.nan)], [Motion(S, V)])


def test_a_short_force_is_refused():
    with pytest.raises(ChannelError, match="200 samples"):
        characterise([S[:100]], [Motion(S[:100], V[:100])])


def test_a_force_linear_in_the_motion_is_no_spectral_line():
    t = np.arange(4000) / 500
    s = np.sin(9 * t) + 0.7 * np.sin(23.1 * t)
    v = 9 * np.cos(9 * t) + 0.7 * 23.1 * np.cos(23.1 * t)
    characterisation = characterise([3.0 * s + 0.5 * v], [Motion(s, v, t=t)])
    assert characterisation.dependence == Dependence.LINEAR
    assert "wrong stiffness, damping or mass" in characterisation.sentence


# -- spectral lines ------------------------------------------------------------

T10 = np.arange(1000) / 100
WHITE = np.random.default_rng(3).standard_normal(1000)


def still(t):
    """A motion of which only the time counts."""
    return Motion(t, t, t=t)


@pytest.mark.parametrize("frequency", [11.37, 30.02])
def test_a_line_of_the_longest_record_is_found_between_two_bins(frequency):
    noisy = 0.6 * np.cos(2 * np.pi * frequency * T10 + 1) + WHITE
    parts, motions = [WHITE[:300], noisy], [still(T10[:300]), still(T10)]
    assert spectral_line(parts, motions) == pytest.approx(frequency, abs=0.012)


def test_a_clean_line_is_found_to_the_nearest_of_81_points_in_two_bins():
    clean = np.cos(2 * np.pi * 11.37 * T10 + 1) + 1e-6 * WHITE
    # bins of 0.1 Hz
    half_a_point = 0.5 * 2 / 80 / 10
    line = spectral_line([clean], [still(T10)])
    assert line == pytest.approx(11.37, abs=half_a_point + 1e-9)


@pytest.mark.parametrize("n", [500, 3000])
def test_white_noise_has_a_line_in_one_record_of_a_hundred(n):
    """Of 400 records of noise 4 are expected, and more than 11 in one of a thousand
    such tests.
    """
    rng, lines = np.random.default_rng(8), 0
    motion = still(np.arange(n) / 100)
    for _ in range(400):
        lines += np.isfinite(spectral_line([rng.standard_normal(n)], [motion]))
    assert lines <= stats.binom.ppf(0.999, 400, 0.01)
