"""The kind of dependence comes out without a formula."""

import numpy as np
import pytest
from pysindy_nrf.discrepancy.characterisation import (
    characterise,
    conditional_mean,
    spectral_line,
)
from pysindy_nrf.discrepancy.words import Dependence, Feature
from scipy import stats
from scipy.integrate import solve_ivp

from pysindy_nrf.equations.normal_equations import Regression, share_of
from pysindy_nrf.exceptions import ChannelError
from pysindy_nrf.laws import Motion
from pysindy_nrf.records.zero_phase_filter import ZeroPhaseFilter

pytestmark = pytest.mark.slow

FS, DURATION = 400, 30.0


def drive(seed=0):
    rng = np.random.default_rng(seed)
    f, phase = rng.uniform(1, 12, 40), rng.uniform(0, 2 * np.pi, 40)
    gain = 1e-3 / (1 + (f - 4) ** 2)
    w = 2 * np.pi * f

    def s(t):
        return (gain * np.sin(np.multiply.outer(t, w) + phase)).sum(axis=-1)

    def v(t):
        return (gain * w * np.cos(np.multiply.outer(t, w) + phase)).sum(axis=-1)

    t = np.arange(int(DURATION * FS)) / FS
    a = -(gain * w**2 * np.sin(np.outer(t, w) + phase)).sum(axis=1)
    return t, s(t), v(t), a, s, v


T, S, V, A, s_of, v_of = drive()
UNIT = S.std()
VOLTAGE = 1 + 0.8 * np.sin(2 * np.pi * 0.3 * T)


def bouc_wen():
    def rate(t, z):
        v = v_of(t) / UNIT
        return v - 2.0 * abs(v) * abs(z) * z - 2.0 * v * z**2

    return solve_ivp(
        rate, (0, T[-1]), [0.0], "LSODA", T, rtol=1e-6, atol=1e-8, max_step=0.01
    ).y[0]


EFFECTS = {
    "coulomb": (lambda: np.sign(V), "v alone", "odd", "friction-like"),
    "quadratic damping": (lambda: V * np.abs(V), "v alone", "odd", "nonlinear damping"),
    "cubic": (lambda: S**3, "s alone", "odd", "hardening"),
    "softening": (lambda: np.tanh(S / UNIT), "s alone", "odd", "softening"),
    "two-sided gap": (
        lambda: np.sign(S) * np.maximum(np.abs(S) - 1.2 * UNIT, 0),
        "s alone",
        "odd",
        "gap",
    ),
    "one-sided gap": (
        lambda: np.maximum(S - 0.8 * UNIT, 0),
        "s alone",
        "neither odd nor even",
        "contact on one side",
    ),
    "quadratic stiffness": (lambda: S**2, "s alone", "even", "nonlinear spring"),
    "bouc-wen": (bouc_wen, "path", "odd", "hysteresis"),
    "harmonic": (lambda: np.cos(2 * np.pi * 7.3456 * T + 1), "line", "", "7.34"),
    "stiffness drift": (lambda: S * T, "time", "", "Changes in time"),
    "stiffness step": (lambda: S * (T > 12), "time", "", "Changes in time"),
    "modulated friction": (
        lambda: np.sign(V) * VOLTAGE,
        "covariate U",
        "",
        "modulated by U",
    ),
    "offset": (lambda: 1 + 0 * S, "constant", "", "offset"),
}


def residual(name, noise, seed=0):
    """What a linear baseline leaves of an effect, and noise of a share of the effect's
    rms.
    """
    f = EFFECTS[name][0]()
    f = f / np.sqrt(np.mean(f**2))
    linear = np.column_stack([S / UNIT, V / V.std(), A / A.std()])
    f = f - linear @ np.linalg.lstsq(linear, f, rcond=None)[0]
    size = np.sqrt(np.mean(f**2))
    return 20 * (f + noise * size * np.random.default_rng(seed).standard_normal(len(f)))


@pytest.mark.parametrize("name", EFFECTS)
def test_dependence_and_words(name):
    _, wanted, parity, word = EFFECTS[name]
    found = characterise([residual(name, 0.05)], [Motion(S, V, A, T, {"U": VOLTAGE})])
    assert found.shares.index[found.shares["chosen"]].tolist() == [wanted]
    assert parity in found.sentence and word in found.sentence
    share = found.shares.loc[wanted, "share"]
    assert share > (90 if name != "stiffness step" else 85)
    if name == "bouc-wen":
        assert found.memory > 15
    elif wanted in ("s alone", "v alone"):
        assert abs(found.memory) < 2
    if name == "harmonic":
        assert found.frequency == pytest.approx(7.3456, abs=0.002)


def test_noise_depends_on_nothing():
    e = np.random.default_rng(0).standard_normal(len(T))
    found = characterise([e], [Motion(S, V, A, T, {"U": VOLTAGE})], noise=1.0)
    assert found.dependence == Dependence.NOTHING and np.isnan(found.frequency)
    assert (found.shares["share"] < 1).all() and "noise is 100 %" in found.sentence


def test_band_is_treated_fairly():
    f = ZeroPhaseFilter((0.5, 20.0), FS)
    found = characterise([f.apply(20 * np.sign(V))], [Motion(S, V, A, T)], filters=[f])
    assert found.dependence == Dependence.RATE and Feature.JUMP in found.features
    assert found.shares.loc["v alone", "share"] > 99.5


def test_columns_of_the_baseline_are_allowed_for():
    other = np.roll(S, 777)[:, None]
    found = characterise(
        [20 * np.sign(V) + 4e4 * other[:, 0]], [Motion(S, V, A, T)], beside=[other]
    )
    assert (
        found.dependence == Dependence.RATE
        and found.shares.loc["v alone", "share"] > 99
    )


def test_several_records_and_conditional_means():
    half = len(T) // 2
    parts = [slice(0, half), slice(half, None)]
    e = residual("coulomb", 0.02)
    found = characterise(
        [e[p] for p in parts], [Motion(S[p], V[p], A[p], T[p] - T[p][0]) for p in parts]
    )
    assert found.dependence == Dependence.RATE
    curve = conditional_mean(V, 5 * np.sign(V), bins=20)
    assert curve["count"].sum() == len(V) and np.allclose(
        curve["mean"].iloc[[0, -1]], [-5, 5]
    )


def test_bad_input_is_refused():
    with pytest.raises(ChannelError, match="not finite"):
        characterise([np.where(T > 1, S, np.nan)], [Motion(S, V)])
    with pytest.raises(ChannelError, match="200 samples"):
        characterise([S[:100]], [Motion(S[:100], V[:100])])


def test_display_draws_shares_and_the_force_against_the_rate():
    from pysindy_nrf.report.figures.evidence import dependence_figures

    found = characterise([residual("coulomb", 0.0)], [Motion(S, V, A, T)])
    bars, drift, rate = dependence_figures(found)
    assert (drift.x.label, drift.x.unit, rate.x.label, rate.x.unit) == (
        "drift s",
        "m",
        "rate v",
        "m/s",
    )
    assert list(bars.marks[0].values) == list(found.shares["share"].clip(lower=0))
    assert list(rate.marks[0].y) == list(found.curves["v"]["mean"])


# -- a line, and the regression that everything is asked of --------------------


def noise(n, seed=0):
    return np.random.default_rng(seed).standard_normal(n)


def test_a_spectral_line_is_found_between_two_bins():
    t = np.arange(1000) / 100
    for f in (11.37, 30.02):
        e = 0.6 * np.cos(2 * np.pi * f * t + 1) + noise(1000, 3)
        assert spectral_line(
            [noise(300), e], [Motion(t[:300], t[:300], t=t[:300]), Motion(t, t, t=t)]
        ) == (pytest.approx(f, abs=0.012))
    clean = np.cos(2 * np.pi * 11.37 * t + 1) + 1e-6 * noise(1000)
    found = spectral_line([clean], [Motion(t, t, t=t)])
    assert found == pytest.approx(
        11.37, abs=0.5 * 2 / 80 / 10 + 1e-9
    )  # the nearest of 81 in two bins of 0.1 Hz


@pytest.mark.parametrize("n", [500, 3000])
def test_white_noise_has_a_line_in_one_record_of_a_hundred(n):
    """Of 400 records of noise 4 are expected, and more than 11 in one of a thousand
    such tests.
    """
    rng, t = np.random.default_rng(8), np.arange(n) / 100
    found = [
        spectral_line([rng.standard_normal(n)], [Motion(t, t, t=t)]) for _ in range(400)
    ]
    assert np.isfinite(found).sum() <= stats.binom.ppf(0.999, 400, 0.01)


def test_the_regression_is_least_squares_on_the_other_folds():
    rng = np.random.default_rng(3)
    parts = [
        rng.standard_normal((n, 5)) * [1, 1, 1e3, 1e-2, 0] + [0, 0.5, 0, 0, 0]
        for n in (310, 95)
    ]
    force = [
        p @ [2.0, -1.0, 1e-3, 30.0, 1.0] + rng.standard_normal(len(p)) for p in parts
    ]
    groups = {
        "a": [p[:, :2] for p in parts],
        "b": [p[:, 2:4] for p in parts],
        "zero": [p[:, 4:] for p in parts],
    }
    fit = Regression.of({**groups, "f": force}, 13, 4)
    counts = [round(13 * 310 / 405), round(13 * 95 / 405)]
    blocks = [
        (p, f)
        for x, y, c in zip(parts, force, counts)
        for p, f in zip(np.array_split(x, c), np.array_split(y, c))
    ]
    assert fit.folds.tolist() == [k % 4 for k in range(sum(counts))]

    def left(columns):
        out = []
        for k, (p, f) in enumerate(blocks):
            others = [one for j, one in enumerate(blocks) if j % 4 != k % 4]
            A, y = (
                np.vstack([q for q, _ in others])[:, columns],
                np.concatenate([g for _, g in others]),
            )
            w = np.linalg.lstsq(A, y, rcond=None)[0]
            out.append(((f - p[:, columns] @ w) ** 2).sum())
        return np.array(out)

    assert fit.left("f") == pytest.approx([f @ f for _, f in blocks])
    before, after = left([0, 1]), left([0, 1, 2, 3])
    assert fit.left("f", ["a"]) == pytest.approx(before, rel=2e-3)
    share, error = fit.share("f", ["b", "zero"], ["a"])
    assert share == pytest.approx(1 - after.sum() / before.sum(), abs=2e-4)
    ratios = [
        np.delete(after, k).sum() / np.delete(before, k).sum()
        for k in range(len(before))
    ]
    n = len(ratios)
    assert error == pytest.approx(np.sqrt((n - 1) * np.var(ratios)), rel=2e-2)
    A, y = np.vstack([p[:, :4] for p in parts]), np.concatenate(force)
    found = fit.coefficients("f", ["b", "a"])
    assert [*found["a"], *found["b"]] == pytest.approx(
        np.linalg.lstsq(A, y, rcond=None)[0], rel=1e-5
    )
    assert Regression.of({"a": [np.ones((50, 1))], "f": [np.zeros(50)]}).share(
        "f", ["a"]
    ) == (0.0, 0.0)


def test_the_error_of_a_share_is_that_of_a_mean():
    after = np.array([0.3, 0.9, 0.4, 0.1, 0.7])
    assert share_of(np.ones(5), after) == (
        pytest.approx(1 - after.mean()),
        pytest.approx(after.std(ddof=1) / np.sqrt(5)),
    )
    assert np.isnan(share_of(np.ones(2), after[:2])[1])
    found = share_of(np.array([1.0, 0.0, 0.0]), np.array([0.5, 0.0, 0.0]))
    assert found[1] == pytest.approx(np.sqrt(2 * np.var([1.0, 0.5, 0.5])))
