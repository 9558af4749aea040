"""Detection and its correlations against statistics written out: Bartlett, Rice, Student, jackknife, small matrices."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from pysindy_nrf.discrepancy import detection
from pysindy_nrf.discrepancy.characterisation import Basis, Judge, jackknife
from pysindy_nrf.discrepancy.detection import (
    Spectra,
    cross_covariance,
    peak_limit,
    probability_of_peak,
)
from pysindy_nrf.laws import Motion

pytestmark = pytest.mark.slow


def slow(n, seed=0):
    """Noise with next to nothing near half the sampling rate."""
    return np.convolve(np.random.default_rng(seed).standard_normal(n + 30), np.hanning(31), "valid")[:n]


# -- correlations -----------------------------------------------------------------------------------


def test_cross_covariance_is_the_sum_of_lagged_products_of_centred_records():
    x, y = [slow(300, 1) + 2.0, slow(450, 2) - 1.0], [slow(300, 3), slow(450, 4) + 5.0]
    other = [np.ones(300), np.ones(450)]
    cross = cross_covariance(Spectra([np.array(pair) for pair in zip(other, x)]), Spectra([b[None] for b in y]), 7)
    assert cross.lag.tolist() == list(range(-7, 8)) and not cross.total[0].any() and not cross.spread[0]
    centred = [(a - a.mean(), b - b.mean()) for a, b in zip(x, y)]
    for tau, found in zip(cross.lag, cross.total[1]):
        pairs = [(t, t + tau) for t in range(450)]
        wanted = sum(a[t] * b[u] for a, b in centred for t, u in pairs if t < len(a) and 0 <= u < len(b))
        assert found == pytest.approx(wanted, abs=1e-7)
    # Bartlett: Var = N sum_k gamma_x(k) gamma_y(k), record by record
    variance = sum(np.correlate(a, a, "full") @ np.correlate(b, b, "full") / len(a) for a, b in centred)
    assert cross.spread[1] == pytest.approx(np.sqrt(variance), rel=1e-6)
    powers = [sum(part @ part for part in parts) for parts in zip(*centred)]
    assert cross.energy[1] == pytest.approx(np.sqrt(powers[0] * powers[1]))


@pytest.mark.parametrize("height, n_lags, omega", [(2.5, 1, 1.0), (3.0, 41, 0.2), (3.5, 10, 3.0), (1.0, 3, np.pi)])
def test_probability_of_a_peak_is_one_height_and_rices_crossings_at_the_others(height, n_lags, omega):
    """P = 1 - P(one lag within) exp(-crossings); both bounds are crossed upwards omega / 2 pi exp(-h^2/2) times a lag."""
    single = 2 * stats.norm.sf(height)
    crossings = (n_lags - 1) * min(2 * omega / (2 * np.pi) * np.exp(-(height**2) / 2), single)
    assert probability_of_peak(height, n_lags, omega) == pytest.approx(1 - (1 - single) * np.exp(-crossings), rel=1e-9)
    level = probability_of_peak(height, n_lags, omega)
    assert peak_limit(level, n_lags, omega) == pytest.approx(height, rel=1e-6)


def motion(n=400, seed=0, **more):
    t = np.arange(n) / 50
    rng = np.random.default_rng(seed)
    w, p = rng.uniform(2.0, 9.0, 3), rng.uniform(0, 6, 3)
    s = sum(np.sin(w_ * t + p_) for w_, p_ in zip(w, p)) * 0.02
    v = sum(w_ * np.cos(w_ * t + p_) for w_, p_ in zip(w, p)) * 0.02
    return Motion(s, v, t=t, **more)


def test_groups_of_columns_hold_what_they_are_named_after():
    """Least squares on all samples: each group explains the force it stands for, and the simpler ones do not."""
    m = motion(4000, 1, covariates={"T": np.linspace(-1.0, 2.0, 4000)})
    slider = [0.0]
    for ds in np.diff(m.s):
        slider.append(np.clip(slider[-1] + ds / (0.3 * m.s.std()), -1.0, 1.0))
    forces = {
        "powers": m.s**3, "drift": np.maximum(np.abs(m.s) - 0.02, 0) * np.sign(m.s), "rate": np.sign(m.v),
        "surface": m.v * np.abs(m.s), "sliders": np.array(slider), "time": m.s * m.t, "covariate T": np.sign(m.v) * m.covariates["T"],
    }  # fmt: skip
    groups = Basis([m]).of(m)
    base = np.hstack([groups["constant"], groups["linear"]])

    def left(columns, f):
        return np.var(f - columns @ np.linalg.lstsq(columns, f, rcond=1e-10)[0]) / np.var(f)

    for name, f in forces.items():
        assert left(np.hstack([base, groups[name]]), f) < 0.05 < 2 * left(base, f), name


def test_judge_is_least_squares_on_the_other_folds():
    rng = np.random.default_rng(3)
    parts = [rng.standard_normal((n, 5)) * [1, 1, 1e3, 1e-2, 0] + [0, 0.5, 0, 0, 0] for n in (310, 95)]
    force = [p @ [2.0, -1.0, 1e-3, 30.0, 1.0] + rng.standard_normal(len(p)) for p in parts]
    groups = {"a": [p[:, :2] for p in parts], "b": [p[:, 2:4] for p in parts], "zero": [p[:, 4:] for p in parts]}
    judge = Judge(force, groups, 13, 4)
    counts = [round(13 * 310 / 405), round(13 * 95 / 405)]
    blocks = [
        (p, f) for x, y, c in zip(parts, force, counts) for p, f in zip(np.array_split(x, c), np.array_split(y, c))
    ]
    assert judge.folds.tolist() == [k % 4 for k in range(sum(counts))]
    whole = sum(f @ f for _, f in blocks)

    def left(columns):
        out = []
        for k, (p, f) in enumerate(blocks):
            fit = [one for j, one in enumerate(blocks) if j % 4 != k % 4]
            A, y = np.vstack([q for q, _ in fit])[:, columns], np.concatenate([g for _, g in fit])
            w = np.linalg.lstsq(A, y, rcond=None)[0]
            out.append(((f - p[:, columns] @ w) ** 2).sum())
        return np.array(out)

    assert judge.held_out(()) * whole == pytest.approx([f @ f for _, f in blocks])
    before, after = left([0, 1]), left([0, 1, 2, 3])
    assert judge.held_out(["a"]) * whole == pytest.approx(before, rel=2e-3)
    share, error = judge.share(["b", "zero"], ["a"])
    assert share == pytest.approx(1 - after.sum() / before.sum(), abs=2e-4)
    ratios = [np.delete(after, k).sum() / np.delete(before, k).sum() for k in range(len(before))]
    n = len(ratios)
    assert error == pytest.approx(np.sqrt((n - 1) * np.var(ratios)), rel=2e-2)
    A, y = np.vstack([p[:, :4] for p in parts]), np.concatenate(force)
    found = judge.coefficients(["b", "a"])
    assert [*found["a"], *found["b"]] == pytest.approx(np.linalg.lstsq(A, y, rcond=None)[0], rel=1e-5)
    assert Judge([np.zeros(50)], {"a": [np.ones((50, 1))]}).share(["a"]) == (0.0, 0.0)


def test_jackknife_of_a_mean_is_its_standard_error():
    after = np.array([0.3, 0.9, 0.4, 0.1, 0.7])
    assert jackknife(np.ones(5), after) == pytest.approx(after.std(ddof=1) / np.sqrt(5))
    assert jackknife(np.ones(3), after[:3]) == pytest.approx(after[:3].std(ddof=1) / np.sqrt(3))
    assert np.isnan(jackknife(np.ones(2), after[:2]))
    assert jackknife(np.array([1.0, 0.0, 0.0]), np.array([0.5, 0.0, 0.0])) == pytest.approx(
        np.sqrt(2 * np.var([1.0, 0.5, 0.5]))
    )


# -- detection: its parts ---------------------------------------------------------------------------


@pytest.mark.parametrize("dof", [1.0, 4.0, 60.0])
def test_heights_in_estimated_deviations_are_as_rare_as_in_known_ones(dof):
    assert stats.norm.sf(detection._as_normal(2.7, dof)) == pytest.approx(stats.t.sf(2.7, dof))
    assert stats.t.sf(detection._as_student(2.2, dof), dof) == pytest.approx(stats.norm.sf(2.2))
    assert detection._as_normal(2.7, np.inf) == detection._as_student(2.7, np.inf) == 2.7
    assert stats.norm.sf(detection._as_normal(1e300, 9.0)) > np.finfo(float).tiny
