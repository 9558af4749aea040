"""Detection and its correlations against statistics written out: Bartlett, Rice, Student, jackknife, small matrices."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from pysindy_nrf.discrepancy import detection
from pysindy_nrf.discrepancy.characterisation import _RIDGE, Basis, Judge, hats, jackknife, knots_of
from pysindy_nrf.discrepancy.detection import (
    Spectra,
    cross_covariance,
    peak_limit,
    probability_of_peak,
    whitened_autocorrelation,
)
from pysindy_nrf.discrepancy.residual import period_of
from pysindy_nrf.laws import Motion

pytestmark = pytest.mark.slow


def white(n, seed=0):
    return np.random.default_rng(seed).standard_normal(n)


def slow(n, seed=0):
    """Noise with next to nothing near half the sampling rate."""
    return np.convolve(white(n + 30, seed), np.hanning(31), "valid")[:n]


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


def test_mean_frequency_of_a_cross_covariance_is_that_of_the_narrow_band_of_both_signals():
    t, window = np.arange(4000), np.hanning(4000)
    for w in ((0.2,), (1.3,), (0.3, 1.1)):
        x = Spectra([(window * sum(np.cos(one * t) for one in w))[None]])
        assert cross_covariance(x, x, 5).omega[0] == pytest.approx(np.sqrt(np.mean(np.square(w))), rel=1e-3)


@pytest.mark.parametrize("height, n_lags, omega", [(2.5, 1, 1.0), (3.0, 41, 0.2), (3.5, 10, 3.0), (1.0, 3, np.pi)])
def test_probability_of_a_peak_is_one_height_and_rices_crossings_at_the_others(height, n_lags, omega):
    """P = 1 - P(one lag within) exp(-crossings); both bounds are crossed upwards omega / 2 pi exp(-h^2/2) times a lag."""
    single = 2 * stats.norm.sf(height)
    crossings = (n_lags - 1) * min(2 * omega / (2 * np.pi) * np.exp(-(height**2) / 2), single)
    assert probability_of_peak(height, n_lags, omega) == pytest.approx(1 - (1 - single) * np.exp(-crossings), rel=1e-9)
    level = probability_of_peak(height, n_lags, omega)
    assert peak_limit(level, n_lags, omega) == pytest.approx(height, rel=1e-6)


def test_whitened_autocorrelation_takes_the_frequencies_above_a_quarter_of_the_reference():
    rng = np.random.default_rng(5)
    parts = [rng.standard_normal(40), rng.standard_normal(61)]
    density = [rng.uniform(0.3, 1.0, 21), rng.uniform(0.3, 1.0, 31)]
    density[0][[3, 9]], density[0][5], density[0][0] = (0.25, 0.2501), 1.0, 50.0  # the mean does not count
    density[1][7], density[1][11] = 1.0, 0.01
    top, bottom, count = np.zeros(6), 0.0, 0
    for e, S, left_out in zip(parts, density, ({0, 3}, {0, 11})):
        chosen = [k for k in range(len(S)) if k not in left_out]
        power = np.abs(np.fft.rfft(e - e.mean())) ** 2
        for place, k in enumerate(chosen):
            top += power[k] / S[k] * np.cos(np.pi * np.arange(1, 7) * (place + 0.5) / len(chosen))
            bottom += power[k] / S[k]
        count += 2 * len(chosen)
    phi, n = whitened_autocorrelation(parts, density, 6)
    assert n == count and phi == pytest.approx(top / bottom)
    still, _ = whitened_autocorrelation([np.ones(40)], [np.ones(21)], 3)
    assert still.tolist() == [0.0, 0.0, 0.0]


# -- columns ----------------------------------------------------------------------------------------


def test_hats_interpolate_linearly_and_are_constant_beyond_the_ends():
    knots, x = np.array([-2.0, 0.0, 0.5, 3.0]), np.array([-5.0, -2.0, -0.5, 0.0, 0.1, 0.5, 2.9, 3.0, 8.0])
    wanted = np.column_stack([np.interp(x, knots, row) for row in np.eye(4)])
    assert hats(x, knots) == pytest.approx(wanted)


@pytest.mark.parametrize(
    "x, count, knots",
    [
        ([1.0, 2.0, 5.0], 3, [1, 2, 3, 5]),  # even: 1, 3, 5; quantiles: 1, 2, 5
        ([-1.0, 0.0, 3.0], 3, [-1, 0, 1, 3]),
        ([-1.0, 0.5, 3.0], 3, [-1, 0, 0.5, 1, 3]),  # 0 is a knot wherever it lies inside
        ([10.0, 11.9, 110.0], 3, [10, 60, 110]),  # nearer than a fiftieth of the range
        ([10.0, 12.1, 110.0], 3, [10, 12.1, 60, 110]),
        ([-50.0, 1.9, 50.0], 3, [-50, 0, 50]),
        ([-50.0, -2.1, 50.0], 3, [-50, -2.1, 0, 50]),
        ([4.0, 4.0], 3, [3, 5]),
        ([-9.0, -4.0, -1.0], 3, [-9, -5, -4, -1]),
    ],
)
def test_knots_lie_at_quantiles_and_even_distances(x, count, knots):
    assert knots_of(np.array(x), count) == pytest.approx(knots)


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


def test_period_of_a_sine():
    t = np.arange(6000)
    for period in (40.0, 300.0):
        x = 3.0 + 2.0 * np.sin(2 * np.pi * t / period)
        assert period_of([x, x[:3000]]) == pytest.approx(2 * np.pi / (2 * np.sin(np.pi / period)), rel=0.01)
    assert period_of([np.ones(9)]) == 16.0


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


def test_judge_of_columns_that_say_nothing_keeps_to_a_strong_ridge():
    rng = np.random.default_rng(0)
    force, columns = rng.standard_normal(60), rng.standard_normal((60, 30))
    judge = Judge([force], {"a": [columns]}, 6, 3)
    squares = []
    for ridge in _RIDGE:
        size = np.sqrt((columns**2).sum(axis=0))
        total = 0.0
        for k in range(3):
            mine = np.isin(np.repeat(np.arange(6), 10) % 3, k)
            A = columns / size
            G = A[~mine].T @ A[~mine]
            w = np.linalg.solve(G + ridge * np.diag(np.diag(G)), A[~mine].T @ force[~mine])
            total += ((force[mine] - A[mine] @ w) ** 2).sum()
        squares.append(total / (force @ force))
    assert judge.held_out(["a"]).sum() == pytest.approx(min(squares), rel=1e-6)
    assert squares.index(min(squares)) == len(squares) - 1


def test_jackknife_of_a_mean_is_its_standard_error():
    after = np.array([0.3, 0.9, 0.4, 0.1, 0.7])
    assert jackknife(np.ones(5), after) == pytest.approx(after.std(ddof=1) / np.sqrt(5))
    assert jackknife(np.ones(3), after[:3]) == pytest.approx(after[:3].std(ddof=1) / np.sqrt(3))
    assert np.isnan(jackknife(np.ones(2), after[:2]))
    assert jackknife(np.array([1.0, 0.0, 0.0]), np.array([0.5, 0.0, 0.0])) == pytest.approx(
        np.sqrt(2 * np.var([1.0, 0.5, 0.5]))
    )


# -- detection: its parts ---------------------------------------------------------------------------


def test_scatter_is_the_variance_among_draws_over_that_expected_and_at_least_one():
    drawn = np.array([[np.zeros(4)], [np.full(4, 3.0)]])
    assert detection._scatter(drawn[:1], np.ones(1)).tolist() == [1.0]
    assert detection._scatter(drawn, np.full(1, 1.5)) == pytest.approx([4.5 / 1.5])
    assert detection._scatter(drawn, np.full(1, 9.0)).tolist() == [1.0]


@pytest.mark.parametrize("dof", [1.0, 4.0, 60.0])
def test_heights_in_estimated_deviations_are_as_rare_as_in_known_ones(dof):
    assert stats.norm.sf(detection._as_normal(2.7, dof)) == pytest.approx(stats.t.sf(2.7, dof))
    assert stats.t.sf(detection._as_student(2.2, dof), dof) == pytest.approx(stats.norm.sf(2.2))
    assert detection._as_normal(2.7, np.inf) == detection._as_student(2.7, np.inf) == 2.7
    assert stats.norm.sf(detection._as_normal(1e300, 9.0)) > np.finfo(float).tiny


def test_bandwidth_is_the_share_of_frequencies_that_are_filled():
    n = 400
    t, M = np.arange(n), n // 2 + 1
    lines = [np.cos(2 * np.pi * k * t / n + k) for k in (10, 30, 31, 77)]
    assert detection._bandwidth([5.0 + sum(lines)]) == pytest.approx(2 * 4 / M)
    # two records: (4 P)^2 / M + P^2 / M over 4 P^2 + P^2
    assert detection._bandwidth([sum(lines), lines[0]]) == pytest.approx(2 * (16 + 1) / M / 5)
    assert detection._bandwidth([np.ones(9)]) == 1.0 and 0.9 < detection._bandwidth([white(4000)]) <= 1.0
