"""Detection and its correlations against statistics written out: Bartlett, Rice, Student, jackknife, small matrices."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from pysindy_nrf import ChainModel, laws
from pysindy_nrf.discrepancy import dependence, detection
from pysindy_nrf.discrepancy.correlation import (
    Cross,
    Signal,
    cross_covariance,
    peak_limit,
    probability_of_peak,
    whitened_autocorrelation,
)
from pysindy_nrf.discrepancy.dependence import Basis, Judge, envelope, hats, jackknife, knots_of, period_of
from pysindy_nrf.discrepancy.detection import LINEAR, NOISE, NONLINEAR, UNMEASURED, Detection, detect
from pysindy_nrf.discrepancy.noise_floor import AT_FLOOR, BELOW_FLOOR, LOUD, NoiseFloor
from pysindy_nrf.discrepancy.residual import ROUND_OFF, residual_of
from pysindy_nrf.fair_filter import FairFilter
from pysindy_nrf.input_arrays import from_arrays
from pysindy_nrf.laws import Motion


def white(n, seed=0):
    return np.random.default_rng(seed).standard_normal(n)


def slow(n, seed=0):
    """Noise with next to nothing near half the sampling rate."""
    return np.convolve(white(n + 30, seed), np.hanning(31), "valid")[:n]


# -- correlations -----------------------------------------------------------------------------------


@pytest.mark.parametrize("lags, first", [(7, None), (9, 3)])
def test_cross_covariance_is_the_sum_of_lagged_products_of_centred_records(lags, first):
    x, y = [slow(300, 1) + 2.0, slow(450, 2) - 1.0], [slow(300, 3), slow(450, 4) + 5.0]
    cross = cross_covariance(x, Signal(y), lags, first)
    assert cross.lag.tolist() == list(range(-lags if first is None else first, lags + 1))
    centred = [(a - a.mean(), b - b.mean()) for a, b in zip(x, y)]
    for tau, found in zip(cross.lag, cross.total):
        pairs = [(t, t + tau) for t in range(450)]
        wanted = sum(a[t] * b[u] for a, b in centred for t, u in pairs if t < len(a) and 0 <= u < len(b))
        assert found == pytest.approx(wanted, abs=1e-7)
    # Bartlett: Var = N sum_k gamma_x(k) gamma_y(k), record by record
    variance = sum(np.correlate(a, a, "full") @ np.correlate(b, b, "full") / len(a) for a, b in centred)
    assert cross.spread == pytest.approx(np.sqrt(variance), rel=1e-6)
    powers = [sum(part @ part for part in parts) for parts in zip(*centred)]
    assert cross.energy == pytest.approx(np.sqrt(powers[0] * powers[1])) and cross.moves


def test_mean_frequency_of_a_cross_covariance_is_that_of_the_narrow_band_of_both_signals():
    t, window = np.arange(4000), np.hanning(4000)
    for w in (0.2, 1.3):
        x = window * np.cos(w * t)
        assert cross_covariance([x], [x], 5).omega == pytest.approx(w, rel=1e-3)
    # spectra of equal height at two frequencies: the root of the mean square of both
    x = window * (np.cos(0.3 * t) + np.cos(1.1 * t))
    assert cross_covariance([x], [x], 5).omega == pytest.approx(np.sqrt((0.3**2 + 1.1**2) / 2), rel=1e-3)
    still = cross_covariance([np.ones(50)], [slow(50)], 5)
    assert still.omega == 0.0 and not still.moves
    assert (
        not Cross(np.arange(1), np.zeros(1), 1.0, 0.0, 0.0).moves
        and not Cross(*([np.zeros(1)] * 2), 0.0, 1.0, 0.0).moves
    )


def test_signal_is_centred_and_padded_to_twice_its_length():
    signal = Signal([np.array([1.0, 2.0, 6.0])])
    assert signal.energy == pytest.approx(4 + 1 + 9) and signal.sizes[0][0] == 3 and signal.sizes[0][1] >= 6
    assert signal.power[0] == pytest.approx(np.abs(np.fft.rfft([-2.0, -1.0, 3.0], signal.sizes[0][1])) ** 2)


@pytest.mark.parametrize("height, n_lags, omega", [(2.5, 1, 1.0), (3.0, 41, 0.2), (3.5, 10, 3.0), (1.0, 3, np.pi)])
def test_probability_of_a_peak_is_one_height_and_rices_crossings_at_the_others(height, n_lags, omega):
    """P = 1 - P(one lag within) exp(-crossings); both bounds are crossed upwards omega / 2 pi exp(-h^2/2) times a lag."""
    single = 2 * stats.norm.sf(height)
    crossings = (n_lags - 1) * min(2 * omega / (2 * np.pi) * np.exp(-(height**2) / 2), single)
    assert probability_of_peak(height, n_lags, omega) == pytest.approx(1 - (1 - single) * np.exp(-crossings), rel=1e-9)
    level = probability_of_peak(height, n_lags, omega)
    assert peak_limit(level, n_lags, omega) == pytest.approx(height, rel=1e-6)


def test_no_height_is_always_exceeded_and_tiny_probabilities_are_kept():
    assert probability_of_peak(0.0, 5, 1.0) == pytest.approx(1.0) and probability_of_peak(30.0, 5, 1.0) > 0


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


def test_columns_are_the_functions_they_are_named_after():
    one, two = motion(seed=1), motion(300, seed=2)
    for m in (one, two):
        m.covariates["T"] = np.linspace(-1.0, 2.0, m.n_samples)
    basis = Basis([one, two])
    s0 = np.sqrt(np.mean(np.concatenate([one.s, two.s]) ** 2))
    v0 = np.sqrt(np.mean(np.concatenate([one.v, two.v]) ** 2))
    assert (basis.s, basis.v) == pytest.approx((s0, v0))
    x, y, sign = two.s / s0, two.v / v0, np.sign(two.v)
    both = {name: np.concatenate([getattr(one, name), getattr(two, name)]) for name in "svt"}

    def hat(name, count):
        return hats(getattr(two, name), knots_of(both[name], count))

    def times(a, b):
        return np.column_stack([p * q for p in a.T for q in b.T])

    carriers = np.column_stack([np.ones(300), x, y, sign])
    drift = np.column_stack([x**2, x**3, x**4, x**5, hat("s", 12)])
    rate = np.column_stack([sign, y * np.abs(y), y**2, y**3, y**4, y**5, hat("v", 12)])
    surface = np.column_stack([rate, drift, times(hat("s", 5), hat("v", 5)), sign * x])
    assert basis.linear(two) == pytest.approx(np.column_stack([two.s, two.v]))
    assert basis.linear(Motion(two.s, two.v, two.t)).shape == (300, 3)
    assert basis.drift(two) == pytest.approx(drift) and basis.rate(two) == pytest.approx(rate)
    assert basis.surface(two) == pytest.approx(surface)
    path = basis.path(two)
    assert path[:, : surface.shape[1]] == pytest.approx(surface)
    for share, slider in zip(dependence._YIELD, path[:, surface.shape[1] :].T, strict=True):
        z, force = 0.0, []  # an elastic-plastic slider, sample by sample
        for k, u in enumerate(two.s):
            z = 0.0 if not k else np.clip(z + (u - two.s[k - 1]) / (share * s0), -1.0, 1.0)
            force.append(z)
        assert slider == pytest.approx(force, abs=1e-9)
    assert basis.time(two) == pytest.approx(times(hat("t", 7), carriers))
    lines = [envelope(m.s) for m in (one, two)]
    amplitude = hats(lines[1], knots_of(np.concatenate(lines), 5))
    assert basis.amplitude(two) == pytest.approx(times(amplitude, np.column_stack([x, y])))
    T = hats(two.covariates["T"], knots_of(np.concatenate([one.covariates["T"], two.covariates["T"]]), 5))
    assert basis.covariate(two, "T") == pytest.approx(times(T, carriers))
    gap = 0.6
    assert basis.hinges(two, gap) == pytest.approx(
        np.column_stack([np.clip(two.s - gap * s0, 0, None), np.clip(-gap * s0 - two.s, 0, None)])
    )
    assert Basis([Motion(np.zeros(5), np.zeros(5))]).s == 1.0


def test_period_and_envelope_of_a_sine():
    t = np.arange(6000)
    for period in (40.0, 300.0):
        x = 3.0 + 2.0 * np.sin(2 * np.pi * t / period)
        assert period_of([x, x[:3000]]) == pytest.approx(2 * np.pi / (2 * np.sin(np.pi / period)), rel=0.01)
    assert period_of([np.ones(9)]) == 16.0
    assert envelope(1.0 + 2.5 * np.cos(2 * np.pi * t / 60)) == pytest.approx(np.full(6000, 2.5), rel=1e-6)


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
    for ridge in dependence._RIDGE:
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
    flat, high = np.zeros(4), np.full(4, 3.0)
    assert detection._scatter([]) == detection._scatter([(high, 0.1)]) == 1.0
    assert detection._scatter([(flat, 1.0), (high, np.sqrt(2.0))]) == pytest.approx(4.5 / 1.5)
    assert detection._scatter([(flat, 3.0), (high, 3.0)]) == 1.0


@pytest.mark.parametrize("dof", [1.0, 4.0, 60.0])
def test_heights_in_estimated_deviations_are_as_rare_as_in_known_ones(dof):
    assert stats.norm.sf(detection._as_normal(2.7, dof)) == pytest.approx(stats.t.sf(2.7, dof))
    assert stats.t.sf(detection._as_student(2.2, dof), dof) == pytest.approx(stats.norm.sf(2.2))
    assert detection._as_normal(2.7, np.inf) == detection._as_student(2.7, np.inf) == 2.7
    assert stats.norm.sf(detection._as_normal(1e300, 9.0)) > np.finfo(float).tiny


def test_linear_columns_are_a_constant_the_motion_and_shifted_inputs():
    motion, x = np.arange(20.0).reshape(10, 2), np.arange(10.0) ** 2
    wanted = np.column_stack([np.ones(6), motion[2:8], x[:6], x[2:8], x[4:]])
    assert np.array_equal(detection._linear(motion, [x], 2, 1), wanted)
    assert np.array_equal(detection._linear(motion, [x], 3, 0), np.column_stack([np.ones(10), motion, x]))


def test_orthonormal_columns_span_what_was_given_and_no_more():
    rng = np.random.default_rng(0)
    A = rng.standard_normal((50, 4)) * [1e-6, 1.0, 1e6, 3.0]
    Q = detection._orthonormal(np.column_stack([A, np.zeros(50), A[:, 1] - 2 * A[:, 3]]))
    assert Q.shape == (50, 4) and Q.T @ Q == pytest.approx(np.eye(4), abs=1e-9)
    assert Q @ (Q.T @ A) == pytest.approx(A, rel=1e-6, abs=1e-9)
    near = np.column_stack([A[:, 1], A[:, 1] + 3e-4 * A[:, 3]])  # eigenvalues 2 and 4e-7: two directions
    assert detection._orthonormal(near).shape == (50, 2)


def test_bandwidth_is_the_share_of_frequencies_that_are_filled():
    n = 400
    t, M = np.arange(n), n // 2 + 1
    lines = [np.cos(2 * np.pi * k * t / n + k) for k in (10, 30, 31, 77)]
    assert detection._bandwidth([5.0 + sum(lines)]) == pytest.approx(2 * 4 / M)
    # two records: (4 P)^2 / M + P^2 / M over 4 P^2 + P^2
    assert detection._bandwidth([sum(lines), lines[0]]) == pytest.approx(2 * (16 + 1) / M / 5)
    assert detection._bandwidth([np.ones(9)]) == 1.0 and 0.9 < detection._bandwidth([white(4000)]) <= 1.0
    assert detection._bandwidth([np.eye(1, 500, 200)[0]]) == 1.0  # an impulse fills every one


def test_reference_spectrum_is_that_of_the_filter_or_the_mean_of_the_draws():
    filter, n = FairFilter((5.0, 20.0), 100.0), 4000
    side = SimpleNamespace(whole=[np.zeros(n), np.zeros(11)], filters=[filter, None], steps=[0.01, None])
    density = detection._reference(side, [])
    impulse = filter.apply(np.eye(1, n, n // 2)[0])
    assert density[0] == pytest.approx(np.abs(np.fft.rfft(impulse)) ** 2, abs=2e-3) and density[1].tolist() == [1.0] * 6
    draws = [SimpleNamespace(whole=[white(512, 1), white(512, 2)]), SimpleNamespace(whole=[white(512, 3)])]
    side.whole = [np.zeros(512), np.zeros(1024)]
    density = detection._reference(side, draws)
    from scipy.signal import periodogram

    mean = np.mean([periodogram(white(512, k), window="hann")[1] for k in (1, 2, 3)], axis=0)
    assert density[0] == pytest.approx(mean)
    assert density[1][::2] == pytest.approx(mean) and density[1][1] == pytest.approx((mean[0] + mean[1]) / 2)
    draws = [SimpleNamespace(whole=[white(256, 1)])]
    assert detection._reference(side, draws)[0][::2] == pytest.approx(periodogram(white(256, 1), window="hann")[1])
    shorter = detection._fit([np.arange(9.0)], [np.zeros(8)])
    assert shorter[0] == pytest.approx([0, 2, 4, 6, 8])


def place(level=0.05, min_share=0.02, **more):
    """A place of tests without data."""
    one = detection._Place.__new__(detection._Place)
    one.where, one.level, one.min_share, one.rows, one.curves = "dof 1", level, min_share, [], {}
    one.steps = [0.5]
    for name, value in more.items():
        setattr(one, name, value)
    return one


FAMILIES = [(0, UNMEASURED), (1, LINEAR), (2, NONLINEAR)]


@pytest.mark.parametrize("family, kind", FAMILIES)
@pytest.mark.parametrize("p, share, outside", [(0.0099, 0.1, 1), (0.0101, 0.1, 0), (0.0, 0.099, 0), (0.005, 0.5, 1)])
def test_a_third_of_the_level_and_a_least_share_decide_on_each_family(family, kind, p, share, outside):
    ps, shares = [1.0] * 3, [0.0] * 3
    ps[family], shares[family] = p, share
    side = SimpleNamespace(raw={"F1": 0, "s": 0}, linear_share=0.3)
    asked = []

    def of_family(tests):
        asked.append(tests)
        return (ps[1], 0.0) if len(tests) == 2 else (ps[2], shares[2])

    one = place(0.03, 0.1, sides=[side], _whiteness=lambda: (ps[0], shares[0]), _family=of_family)
    one._excess = lambda: shares[1]
    found = one.judge()
    assert found["verdict"] == (kind if outside else NOISE) and found["linear share"] == 0.3
    assert [found[f"p {word}"] for word in ("white", "linear", "nonlinear")] == ps
    assert asked[0] == [("phi_xe", "xe", "F1"), ("phi_xe", "xe", "s")] and len(asked[1]) == 8
    assert ("phi_|x||e|", "|x||e|", "s") in asked[1]


def test_nonlinear_goes_before_linear_before_white_and_needs_some_of_the_residual_left():
    side = SimpleNamespace(raw={"F1": 0}, linear_share=0.95)
    one = place(sides=[side], _whiteness=lambda: (0.0, 1.0), _family=lambda tests: (0.0, 1.0), _excess=lambda: 1.0)
    assert one.judge()["verdict"] == NONLINEAR
    side.linear_share = 0.985
    assert one.judge()["verdict"] == LINEAR
    one._excess = lambda: 0.0199
    assert one.judge()["verdict"] == UNMEASURED
    one._whiteness = lambda: (0.0, 0.0199)
    assert one.judge()["verdict"] == NOISE
    p = {"p white": 0.3, "p linear": 0.2, "p nonlinear": 0.4}
    assert one.likeliest(p) == LINEAR and one.likeliest(p | {"p white": 0.1}) == UNMEASURED


def side(e, n=1, **more):
    return SimpleNamespace(whole=[e], filters=[None], steps=[0.5], **more)


def test_whiteness_is_the_portmanteau_of_the_residual():
    e, lags = white(600, 4) + 0.4 * np.roll(white(600, 4), 3), detection._WHITE_LAGS
    one = place(sides=[side(e)], draws=0)
    p, share = one._whiteness()
    phi, n = whitened_autocorrelation([e], [np.ones(301)], lags)
    assert n == 600 and p == pytest.approx(stats.chi2.sf(n * phi @ phi, lags), rel=1e-9)
    assert share == pytest.approx(phi @ phi - lags / n)
    row = one.rows[0]
    assert row["peak"] == pytest.approx(phi[2]) and row["lag"] == 3 * 0.5 and row["outside"]
    # Bonferroni over the lags, a third of the level for whiteness
    single = 1 - (1 - 0.05 / 3) ** (1 / lags)
    assert row["band"] * np.sqrt(n) == pytest.approx(stats.norm.isf(single / 2), rel=1e-3)
    tone = place(sides=[side(np.sin(0.05 * np.arange(600)))], draws=0)
    assert tone._whiteness()[1] == 1.0  # no more than all of it
    lag, curve, band = one.curves["dof 1", "phi_ee", "e"]
    assert lag.tolist() == list(range(1, lags + 1)) and curve == pytest.approx(phi) and band == row["band"]


@pytest.mark.parametrize("draws", [1, 3])
def test_whiteness_beside_draws_takes_their_mean_off_and_counts_their_scatter(draws):
    lags, e = detection._WHITE_LAGS, white(4096, 9) + 0.9 * np.roll(white(4096, 9), 1)
    fakes = [
        side(white(4096, k) + 0.15 * (k + 1) * np.roll(white(4096, k), 1)) for k in range(draws)
    ]  # of several colours
    one = place(sides=[side(e), *fakes], draws=draws)
    p, share = one._whiteness()
    density = detection._reference(one.sides[0], fakes)
    phi, n = whitened_autocorrelation([e], density, lags)
    noise = np.array([whitened_autocorrelation(f.whole, density, lags)[0] for f in fakes])
    phi = phi - noise.mean(axis=0)
    scatter = max(1.0, noise.var(axis=0, ddof=1).mean() * n) if draws > 1 else 1.0
    assert scatter > 2 or draws == 1
    more = (1 + 1 / draws) * scatter
    wanted = stats.f.sf(n * (phi @ phi) / lags / more, lags, max(1, draws - 1) * lags)
    assert p == pytest.approx(wanted, rel=1e-6)
    assert 0 < share < 1 and share == pytest.approx(phi @ phi - more * lags / n)
    assert one.rows[0]["band"] == pytest.approx(np.sqrt(more / n) * peak_limit(0.05 / 3, lags, np.pi))


def crosses(*totals, spreads=None, energy=10.0, omega=1.0):
    spreads = spreads or [1.0] * len(totals)
    return [Cross(np.arange(-1, 2), np.array(t, dtype=float), s, energy, omega) for t, s in zip(totals, spreads)]


def test_a_family_without_draws_is_judged_by_its_highest_peak_times_its_tests():
    held = {"F1": crosses([1.0, -4.5, 0.5]), "s": crosses([0.1, 0.2, -0.3]), "dead": crosses([0, 0, 0], spreads=[0.0])}
    one = place(draws=0, _crosses=lambda kind, name: held[name])
    for kind, strength in (("xe", 0.45**2), ("|x||e|", 0.45)):
        p, strong = one._family([(f"phi_{kind}", kind, name) for name in held])
        assert p == pytest.approx(3 * probability_of_peak(4.5, 3, 1.0)) and strong == pytest.approx(strength)
    first = one.rows[0]
    assert (first["peak"], first["lag"], first["outside"]) == (pytest.approx(-0.45), 0.0, True)
    assert first["p"] == pytest.approx(probability_of_peak(4.5, 3, 1.0))
    assert first["band"] == pytest.approx(peak_limit(0.05 / 3 / 3, 3, 1.0) / 10)
    assert one.rows[1]["lag"] == 0.5 and not one.rows[1]["outside"] and len(one.rows) == 4  # the dead one says nothing
    lag, phi, band = one.curves["dof 1", "phi_xe", "F1"]
    assert lag.tolist() == [-0.5, 0, 0.5] and phi == pytest.approx([0.1, -0.45, 0.05]) and band == first["band"]
    # the level is shared by the tests: a height that one test makes outside is inside beside two others
    height = peak_limit(0.05 / 3 / 1.5, 3, 1.0)
    held = {"F1": crosses([0, height, 0]), "s": crosses([0, 0, 0]), "v": crosses([0, 0, 0])}
    one.rows.clear()
    assert one._family([("phi_xe", "xe", "F1")])[1] > 0 == one._family([("phi_xe", "xe", k) for k in held])[1]


@pytest.mark.parametrize("spread", [2.0, 1.0, 0.5])
def test_a_family_beside_draws_is_judged_by_students_distribution(spread):
    """Noise's own correlation is taken off; its spread is known from d - 1 draws, that beyond it for sure."""
    totals, level = ([9.0, 1.0, 0.0], [2.0, 0.0, 1.0], [-2.0, 0.0, -1.0], [3.0, 3.0, 3.0]), 0.05 / 3 / 2
    held = {"F1": crosses(*totals, spreads=[spread, 1.0, 1.0, 1.0]), "s": crosses(*[[0.0] * 3] * 4)}
    one = place(draws=3, _crosses=lambda kind, name: held[name])
    p, strong = one._family([("phi_xe", "xe", name) for name in held])
    scatter = np.var(np.array(totals[1:]), axis=0, ddof=1).mean()
    by_noise = (scatter + 1.0) / 2 * (1 + 1 / 3)  # over the signals of the test; s does not scatter at all: 1
    beyond = max(spread**2 - 1.0, 0.0)
    sigma = np.sqrt(by_noise + beyond)
    dof = 2 * 2 * (1 + beyond / by_noise) ** 2
    height = np.abs(np.array(totals[0]) - np.mean(totals[1:], axis=0)) / sigma
    normal = stats.norm.isf(stats.t.sf(height.max(), dof))
    assert one.rows[0]["p"] == pytest.approx(probability_of_peak(normal, 3, 1.0), rel=1e-6)
    assert p == pytest.approx(2 * one.rows[0]["p"]) and (strong > 0) == (one.rows[0]["p"] < level)
    limit = stats.t.isf(stats.norm.sf(peak_limit(level, 3, 1.0)), dof)
    assert one.rows[0]["band"] == pytest.approx(limit * sigma / 10) and one.rows[0]["peak"] == pytest.approx(0.8)


def test_one_draw_tells_no_scatter_and_draws_without_spread_none_either():
    held = {"F1": crosses([6.0, 0, 0], [1.0, 0, 0], spreads=[2.0, 1.0])}
    one = place(draws=1, _crosses=lambda kind, name: held[name])
    one._family([("phi_xe", "xe", "F1")])
    assert one.rows[0]["p"] == pytest.approx(probability_of_peak(5 / np.sqrt(2 + 3), 3, 1.0))
    held = {"F1": crosses([6.0, 0, 0], [0.0] * 3, [0.0] * 3, spreads=[2.0, 0.0, 0.0])}
    one = place(draws=2, _crosses=lambda kind, name: held[name])
    with np.errstate(invalid="ignore", divide="ignore"):
        one._family([("phi_xe", "xe", "F1")])
    assert np.isfinite(one.rows[0]["p"]) or np.isnan(one.rows[0]["p"])


def test_excess_is_what_is_linear_beyond_noise_of_its_size():
    sides = [SimpleNamespace(linear_share=s, size=z) for s, z in ((0.7, 8.0), (0.5, 4.0), (0.3, 8.0))]
    assert place(sides=sides)._excess() == pytest.approx(0.7 - (0.5 * 4 / 8 + 0.3) / 2)
    assert place(sides=sides[:1])._excess() == pytest.approx(0.7)


def test_loudest_is_the_largest_rms_of_a_draw_over_that_of_all():
    draws = [SimpleNamespace(whole=[np.full(5, x), np.full(3, -x)]) for x in (1.0, 2.0, 3.0)]
    assert place(sides=[None, *draws]).loudest == pytest.approx(3 / np.sqrt(14 / 3))
    assert place(sides=[None]).loudest == place(sides=[None, SimpleNamespace(whole=[np.zeros(4)])]).loudest == 1.0


# -- detection: views of data -----------------------------------------------------------------------


def residual(n=2000, period=50.0, n_dof=2, e=None, forced=True, seed=0, dt=0.01, **more):
    """A residual of given balances along sines and noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(n)
    w = 2 * np.pi / period
    s = np.column_stack([np.sin(w * t + j) + 0.01 * rng.standard_normal(n) * bool(seed) for j in range(n_dof)])
    v = np.column_stack([w / dt * np.cos(w * t + j) for j in range(n_dof)])
    F = rng.standard_normal((n, n_dof)) if forced else np.zeros((n, n_dof))
    X = np.hstack([rng.standard_normal((n, n_dof)), v, s])
    held = {i: [laws.LinearElastic(1.0)] for i in range(1, n_dof + 1)}
    found = residual_of(ChainModel([1.0] * n_dof, held), from_arrays(X, F, dt=dt, **more))
    return found if e is None else found.with_balance([e])


@pytest.mark.parametrize(
    "n, period, given, every, lags, spacing",
    [
        (2000, 50.0, None, 1, 50, 6),
        (2000, 400.0, None, 1, 200, 50),  # a tenth of the record
        (9000, 60.0, None, 2, 30, 8),  # 4096 are enough
        (40000, 34.0, None, 4, 8, 4),  # eight in a period are left
        (2000, 50.0, 33, 1, 33, 6),
        (2000, 50.0, 3, 1, 8, 6),
        (2000, 4.0, None, 1, 8, 1),
        (100, 50.0, None, 1, 10, 6),
    ],
)
def test_lags_reach_over_a_period_and_samples_are_thinned(n, period, given, every, lags, spacing):
    found = residual(n, period, 1)
    one = detection._Place("dof 1", [detection._View(found, found.data)], 0.05, given, 0.02)
    assert (one.sides[0].every, one.lags, one.spacing) == (every, lags, spacing) and one.draws == 0
    assert one.steps == pytest.approx([0.01 * every])


@pytest.mark.parametrize("worth", [10.0, 30.0, 60.0, 96.0, 150.0, 1e5])
def test_at_most_an_eighth_of_the_samples_is_spent_on_neighbouring_inputs(worth):
    found = residual(900, seed=1)
    columns, pad = detection._View(found, found.data).basis([0], 7, worth, 1)
    taps = pad // 7
    spent = [2 * (2 * k + 1) for k in range(6)]  # two forces
    assert taps == max(k for k in range(detection._TAPS + 1) if spent[k] <= max(worth / 8, 2))
    assert columns.shape == (900 - 2 * pad, 1 + 4 + spent[taps]) and columns.T @ columns == pytest.approx(
        np.eye(columns.shape[1]), abs=1e-8
    )


@pytest.mark.parametrize("n, spacing", [(64 + 8 * 7 * 3, 7), (64 + 8 * 7 * 3 - 1, 7), (70, 7), (50, 7)])
def test_shifts_of_the_inputs_leave_enough_of_a_short_record(n, spacing):
    found = residual(n, seed=1)
    _, pad = detection._View(found, found.data).basis([0], spacing, 1e6, 1)
    assert pad == spacing * max(0, (n - 64) // (8 * spacing))


def test_inputs_are_forces_that_act_the_base_and_covariates():
    n = 300
    found = residual(
        n, covariates={"T": white(n, 5), "ag": white(n, 6), "vg": white(n, 7)}, base_acceleration=white(n, 6)
    )
    found.data.segments[0].F[:, 1] = 0.0
    names = {name: parts[0] for name, parts in detection._inputs(found.data.segments)}
    assert list(names) == ["F1", "ag", "T"] and names["ag"] == pytest.approx(white(n, 6))
    seg = found.data.segments[0]
    seg.ag[:] = 0.0
    seg.F[:, 0] = np.nan
    assert [name for name, _ in detection._inputs([seg])] == ["T"]
    view = detection._View(found, found.data)
    states, inputs = view.signals("storey 2", [0])
    assert list(states) == ["s of storey 2", "v of storey 2"] and list(inputs) == ["T"]
    assert list(view.signals("dof 2", [0])[0]) == ["s of storey 2", "v of storey 2"]
    assert list(view.signals("dof 1", [0])[0])[::2] == ["s of storey 1", "s of storey 2"]
    assert states["v of storey 2"][0] == pytest.approx(seg.v[:, 1])


@pytest.mark.parametrize("n, used", [(16, []), (17, [0])])
def test_records_of_a_few_samples_are_not_tested(n, used):
    found = SimpleNamespace(at=lambda where: [np.ones(n), np.full(40, np.nan)])
    assert detection._View(found, None).target("dof 1")[0] == used


def test_what_is_linear_is_taken_off_and_its_share_freed_of_overfit():
    n, rng = 4000, np.random.default_rng(2)
    found = residual(n, 40.0, 2, seed=3)
    seg = found.data.segments[0]
    e = np.column_stack([seg.F[:, 0] * 2.0 + 0.3 * seg.s[:, 1] + 0.5 + rng.standard_normal(n)] * 2)
    found = found.with_balance([e])
    one = detection._Side(detection._View(found, found.data), "dof 1", 5, 1)
    pad, basis = one._pad, one._basis
    shifted = [seg.F[k : n - 2 * pad + k, j] for j in (0, 1) for k in range(0, 2 * pad + 1, 5)]
    A = np.column_stack([np.ones(n - 2 * pad), seg.s[pad : n - pad], seg.v[pad : n - pad], *shifted])
    assert pad == 20 and basis.shape[1] == A.shape[1] == 1 + 4 + 2 * 9
    y = e[pad : n - pad, 0]
    rest = y - A @ np.linalg.lstsq(A, y, rcond=None)[0]
    assert one.rest[0] == pytest.approx(rest, abs=1e-7) and one.size == pytest.approx(y @ y)
    overfit = A.shape[1] / (len(y) * one.bandwidth)
    explained = 1 - rest @ rest / (y @ y)
    assert one.linear_share == pytest.approx((explained - overfit) / (1 - overfit))
    # the tests: products of what is left with powers, sizes and its own products
    x = seg.s[:, 1]

    def without(z):
        return z - A @ np.linalg.lstsq(A, z, rcond=None)[0]

    for kind, signal, other in (
        ("xe", x, e[:, 0]),
        ("x2e", without((x**2)[pad : n - pad]), rest),
        ("x3e", without((x**3)[pad : n - pad]), rest),
        ("|x||e|", np.abs(x[pad : n - pad]), np.abs(rest)),
    ):
        got, want = one.cross(kind, "s of storey 2", 12), cross_covariance([signal], [other], 12)
        assert got.lag.tolist() == list(range(-12, 13))
        assert got.total / got.energy == pytest.approx(want.total / want.energy, abs=1e-6)
        assert got.spread / got.energy == pytest.approx(want.spread / want.energy, rel=1e-5)
    got, first = one.cross("e(ex)", "s of storey 2", 12), int(np.ceil(1.5 / one.bandwidth))
    want = cross_covariance([x[pad : n - pad] * rest], [rest], 12 + first, first)
    assert got.lag.tolist() == list(range(first, 13 + first)) and got.total == pytest.approx(want.total, abs=1e-6)


def test_own_colour_of_a_slow_residual_is_left_out_of_its_product_test():
    found = residual(4000, 40.0, 1, seed=3)
    found = found.with_balance([slow(4000, 8)[:, None]])
    one = detection._Side(detection._View(found, found.data), "dof 1", 5, 2)
    assert one.cross("e(ex)", "F1", 9).lag[0] == int(np.ceil(1.5 / one.bandwidth)) > 3
    assert len(one.e[0]) == 2000 and one._inside([np.arange(4000)])[0].tolist() == list(
        range(one._pad, 4000 - one._pad, 2)
    )


# -- detection: verdicts ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "ratio, tests_say, loudest, verdict",
    [
        (LOUD * 1.001, NOISE, 1.0, LINEAR),  # whatever the tests say
        (LOUD * 0.999, NOISE, 1.0, NOISE),
        (LOUD * 1.3, NOISE, 1.4, NOISE),
        (LOUD * 1.5, NOISE, 1.4, LINEAR),
        (BELOW_FLOOR * 0.999, NONLINEAR, 1.0, NOISE),
        (BELOW_FLOOR * 1.001, NONLINEAR, 1.0, NONLINEAR),
        (AT_FLOOR * 0.999, UNMEASURED, 1.0, NOISE),
        (AT_FLOOR * 1.001, UNMEASURED, 1.0, UNMEASURED),
        (AT_FLOOR * 1.001, UNMEASURED, 1.5, NOISE),
        (AT_FLOOR * 0.999, LINEAR, 1.0, LINEAR),
    ],
)
def test_the_noise_floor_overrules_the_tests(monkeypatch, ratio, tests_say, loudest, verdict):
    found = residual(300, n_dof=1)
    fake = SimpleNamespace(loudest=loudest, rows=[], curves={}, judge=lambda: {"verdict": tests_say})
    fake.likeliest = lambda verdict: LINEAR
    monkeypatch.setattr(detection, "_Place", lambda *a: fake)
    table = detect(found, NoiseFloor.given(found.sizes["rms"].iloc[0] / ratio, 1)).verdicts
    assert table["verdict"].tolist() == [verdict] * 2 and table["floor ratio"].tolist() == pytest.approx([ratio] * 2)
    silent = detect(found, NoiseFloor.given(0.0, 1)).verdicts
    assert silent["verdict"].tolist() == [tests_say] * 2 and silent["floor ratio"].isna().all()


@pytest.mark.parametrize("size, tested", [(0.9, False), (1.1, True)])
def test_rounding_is_not_tested(monkeypatch, size, tested):
    found = residual(300, n_dof=1)
    found.sizes.loc["dof 1", "rms"] = size * ROUND_OFF * found.sizes.loc["dof 1", "reference"]
    found.sizes.loc["storey 1", "rms"] = np.nan
    fake = SimpleNamespace(loudest=1.0, rows=[], curves={}, judge=lambda: {"verdict": LINEAR})
    monkeypatch.setattr(detection, "_Place", lambda *a: fake)
    table = detect(found).verdicts
    assert list(table.index) == ["dof 1"] and (table.loc["dof 1", "verdict"] == LINEAR) == tested


def test_sentence_names_the_surest_test_of_the_kind_that_was_found():
    names = ["where", "test", "signal", "peak", "lag", "band", "p", "outside"]
    tests = pd.DataFrame(
        [
            ("dof 1", "phi_x3e", "s", 0.5, 0, 0.1, 1e-5, True),
            ("dof 1", "phi_x2e", "v", 0.3, 0, 0.125, 1e-9, True),
            ("dof 1", "phi_xe", "F1", 0.9, 0, 0.1, 1e-30, True),
            ("dof 2", "phi_xe", "F1", 0.9, 0, 0.1, 1e-30, True),
            ("dof 3", "phi_xe", "F1", 0.9, 0, 0.1, 0.5, False),
        ],
        columns=names,
    )
    verdicts = pd.DataFrame(
        {"verdict": [NONLINEAR, NOISE, NOISE], "floor ratio": [3.456, np.nan, 1.0]}, index=["dof 1", "dof 2", "dof 3"]
    )
    said = Detection(verdicts, tests, 0.05)
    assert not said.is_noise and Detection(verdicts[1:], tests, 0.05).is_noise
    assert str(said).split("\n") == [
        f"dof 1: {NONLINEAR} (phi_x2e, v: 0.30, band 0.12), 3.5 times the noise floor",
        "dof 2: noise (traces of structure too small to model)",
        "dof 3: noise, 1 times the noise floor.",
    ]


@pytest.mark.parametrize("ends", [(0.0, 6.0), (-6.0, 0.0)])
def test_a_variable_that_starts_or_ends_at_zero_keeps_the_knot_there(ends):
    """A time, a voltage: without a knot at 0 nothing could change over the first interval."""
    assert knots_of(np.linspace(*ends, 601), 7) == pytest.approx(np.linspace(*ends, 7))
