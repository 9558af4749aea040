"""What a missing force is like and what noise leaves: words, shares and levels against formulas written out."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import scipy.ndimage
from scipy import stats
from scipy.optimize import brentq

from pysindy_nrf import ChainModel, Record, Site, laws
from pysindy_nrf.discrepancy import characterisation, contradictions, coupling, noise_floor, noise_level
from pysindy_nrf.discrepancy.characterisation import LEAST, NEARLY, Characterisation, characterise, conditional_mean
from pysindy_nrf.discrepancy.contradictions import CONTRADICTION, MOST, Suspect
from pysindy_nrf.discrepancy.coupling import Coupling, couplings
from pysindy_nrf.discrepancy.dependence import Basis
from pysindy_nrf.discrepancy.noise_floor import NoiseFloor
from pysindy_nrf.discrepancy.residual import ROUND_OFF, from_top, residual_of, rms
from pysindy_nrf.discrepancy.splits import BlockRows
from pysindy_nrf.exceptions import ChannelError
from pysindy_nrf.input_arrays import from_arrays
from pysindy_nrf.laws import Motion
from pysindy_nrf.laws.sensor import ChannelDelay


def noise(n, seed=0):
    return np.random.default_rng(seed).standard_normal(n)


def motion(n=3000, seed=0, dt=0.02):
    """Three sines without a common period: the drift and its mirror image are visited alike."""
    t = np.arange(n) * dt
    w = np.array([2.1, 5.3, 9.7])[:, None]
    p = np.random.default_rng(seed).uniform(0, 6, (3, 1))
    return Motion(np.sin(w * t + p).sum(axis=0), (w * np.cos(w * t + p)).sum(axis=0), t=t)


# -- characterisation -------------------------------------------------------------------------------


def test_conditional_mean_is_the_mean_in_bins_of_equal_count():
    x, y = np.array([5.0, 1.0, 2.0, 4.0, 3.0, 0.0, 6.0]), np.array([1.0, 2.0, 6.0, 3.0, 5.0, 4.0, 9.0])
    found = conditional_mean(x, y, 3)
    bins = [[0, 1], [2, 3], [4, 5, 6]]  # edges at 0, 2, 4, 7
    at = {v: f for v, f in zip(x, y)}
    assert found["count"].tolist() == [2, 2, 3] and found["centre"].tolist() == [0.5, 2.5, 5.0]
    assert found["mean"].tolist() == pytest.approx([np.mean([at[v] for v in b]) for b in bins])
    assert found["error"].tolist() == pytest.approx([np.std([at[v] for v in b]) / np.sqrt(len(b)) for b in bins])
    assert len(conditional_mean(x, y)) == 7


def test_a_spectral_line_is_found_between_two_bins():
    t = np.arange(1000) / 100
    for f in (11.37, 30.02):
        e = 0.6 * np.cos(2 * np.pi * f * t + 1) + noise(1000, 3)
        assert characterisation.spectral_line(
            [noise(300), e], [Motion(t[:300], t[:300], t=t[:300]), Motion(t, t, t=t)]
        ) == (pytest.approx(f, abs=0.012))
    clean = np.cos(2 * np.pi * 11.37 * t + 1) + 1e-6 * noise(1000)
    found = characterisation.spectral_line([clean], [Motion(t, t, t=t)])
    assert found == pytest.approx(11.37, abs=0.5 * 2 / 80 / 10 + 1e-9)  # the nearest of 81 in two bins of 0.1 Hz


@pytest.mark.parametrize("n", [400, 1000])
def test_a_line_stands_out_if_chance_does_as_well_in_one_record_of_a_hundred(n):
    """Exponential powers over their mean m, from the median m ln 2 of a window: F distributed, and any of N may do it.

    The median of M independent ones has the relative variance 1 / (M ln(2)^2); a Hann window makes neighbours alike.
    """
    t, at = np.arange(n) / 100, n // 4
    line = np.cos(2 * np.pi * at * t / (n / 100))
    e = noise(
        n, next(k for k in range(50) if np.isnan(characterisation.spectral_line([noise(n, k)], [Motion(t, t, t=t)])))
    )
    N = n // 2 + 1
    half = min(50, N // 2 - 1)
    alike = np.abs(np.fft.fft(np.hanning(n) ** 2)) / (np.hanning(n) ** 2).sum()
    k = (2 * half + 1) * np.log(2) ** 2 / (alike**2).sum()
    least_ratio = stats.f.isf(0.01 / N, 2, 2 * k)

    def beyond(size):
        power = np.abs(np.fft.rfft((e + size * line) * np.hanning(n))) ** 2
        mean = np.median(power[at - half : at + half + 1]) / np.log(2)
        return power[at] / mean - least_ratio

    least = brentq(beyond, 0.0, 3.0)
    for factor, told in ((0.995, False), (1.005, True)):
        found = characterisation.spectral_line([e + factor * least * line], [Motion(t, t, t=t)])
        assert np.isfinite(found) == told


@pytest.mark.parametrize("n, told", [(63, False), (64, True)])
def test_short_records_show_no_line_and_the_surroundings_are_symmetric(monkeypatch, n, told):
    sizes, real = [], scipy.ndimage.median_filter

    def spy(power, size, mode):
        sizes.append(size)
        return real(power, size=size, mode=mode)

    monkeypatch.setattr(scipy.ndimage, "median_filter", spy)
    t = np.arange(n) / 50
    e = np.cos(2 * np.pi * 12.2 * t) + 1e-3 * noise(n)
    assert np.isfinite(characterisation.spectral_line([e], [Motion(t, t, t=t)])) == told
    assert np.isnan(characterisation.spectral_line([e], [Motion(t, t)]))
    assert all(size % 2 and len(e) // 2 - 2 < size <= len(e) // 2 + 1 for size in sizes)


def test_slow_drifts_are_no_lines_and_the_first_frequency_beyond_them_is():
    n = 800
    t = np.arange(n) / 100
    for bins, told in ((1.4, False), (6.0, True)):
        e = np.cos(2 * np.pi * bins / 8 * t) + 1e-2 * noise(n)
        found = characterisation.spectral_line([e], [Motion(t, t, t=t)])
        assert (np.isfinite(found) and abs(found - bins / 8) < 0.01) == told


def work(force, m, filters=None, beside=None, channels=None):
    return characterisation._Work.of(force, m, filters, beside, channels)


@pytest.mark.parametrize("n, refused", [(199, True), (200, False)])
def test_two_hundred_samples_are_needed(n, refused):
    m = motion(n)
    if refused:
        with pytest.raises(ChannelError, match="fewer than 200 samples"):
            work(noise(n), m)
    else:
        work(noise(n), m)
    with pytest.raises(ChannelError, match="differ in length"):
        work(noise(n + 1), m)
    with pytest.raises(ChannelError, match="differ in length"):
        work([noise(n)] * 2, m)


def test_records_with_an_unknown_force_are_left_aside_and_half_known_ones_refused():
    a, b = motion(500, 1), motion(400, 2)
    both = work([np.full(500, np.nan), noise(400)], [a, b], channels={"F1": [noise(500), noise(400, 9)]})
    assert len(both.force) == 1 and both.motions == [b] and both.rms == pytest.approx(np.sqrt(np.mean(noise(400) ** 2)))
    assert both.judge.at["delay"].size == 1
    with pytest.raises(ChannelError, match="not finite"):
        work(np.r_[np.nan, noise(499)], a)


def test_what_is_linear_is_taken_off_before_lines_are_looked_for():
    a, b = motion(900, 1), motion(600, 2)
    columns = [np.column_stack([np.ones(m.n_samples), m.s, m.v]) for m in (a, b)]
    force = [c @ [5.0, 2.0, -1.0] + noise(len(c), 7) for c in columns]
    one = work(force, [a, b])
    left = one._left({"constant": [c[:, :1] for c in columns], "linear": [c[:, 1:] * [1e4, 1e-4] for c in columns]})
    A, y = np.vstack(columns), np.concatenate(force)
    assert [len(part) for part in left] == [900, 600]
    assert np.concatenate(left) == pytest.approx(y - A @ np.linalg.lstsq(A, y, rcond=None)[0], abs=1e-9)
    still = one._left({"constant": [c[:, :1] for c in columns], "linear": [0 * c[:, 1:] for c in columns]})
    assert np.concatenate(still) == pytest.approx(y - y.mean())


def test_a_line_has_a_phase_of_its_own_in_every_record_and_a_late_channel_its_derivative():
    a, b = motion(500, 1), motion(400, 2)
    one = work([noise(500), noise(400)], [a, b])
    one.frequency = 3.0
    first, second = one._line([np.zeros((500, 1)), np.zeros((400, 1))])
    assert first.shape == (500, 4) and not first[:, 2:].any() and not second[:, :2].any()
    assert second[:, 2:] == pytest.approx(np.column_stack([np.cos(6 * np.pi * b.t), np.sin(6 * np.pi * b.t)]))
    late = one._late({"F1": [np.sin(a.t), 3 * b.t]})
    assert late[1][0] == pytest.approx(np.full(400, 3.0)) and late[0][0][1:-1] == pytest.approx(
        np.cos(a.t)[1:-1], abs=1e-3
    )
    assert one._late({}) == []


@pytest.mark.parametrize("odd, even", [(1.0, 0.0), (0.3, 1.0), (1.0, 1.5), (0.0, 1.0)])
def test_odd_share_is_that_of_the_odd_part_of_the_fitted_function(odd, even):
    m = motion(6000)
    force = odd * m.s**3 + even * m.s**2
    share, _ = work(force, m).shape_of("s alone")
    wanted = odd**2 * np.mean(m.s**6) / (odd**2 * np.mean(m.s**6) + even**2 * np.mean(m.s**4))
    assert share == pytest.approx(wanted, abs=0.02)
    assert np.isnan(work(force, m).shape_of("constant")[0]) and work(force, m).shape_of("nothing tried")[1] == []


@pytest.mark.parametrize("share, marked", [(0.27, False), (0.33, True)])
def test_a_jump_is_one_beyond_three_tenths_of_the_rms(share, marked):
    m = motion(6000)
    rest = m.v**3 / np.sqrt(np.mean(m.v**6))
    force = share * np.sign(m.v) + rest * np.sqrt(1 - share**2)
    force /= np.sqrt(np.mean(force**2))
    one = work(force, m)
    one.rms = 1.0
    jump = float(one.judge.coefficients([*one.base, "v"])["v"][0])
    assert ("jump at v = 0" in one._marks("v", {"v": np.array([-share])})) == marked
    assert "jump at v = 0" not in one._marks("path", {"path": np.array([9.0])}) and abs(jump) < 1


@pytest.mark.parametrize("sign, word", [(1, "hardening"), (-1, "softening")])
def test_a_slope_that_grows_outwards_is_hardening(sign, word):
    m = motion()
    one = work(noise(3000), m)
    x = m.s / one.basis.s
    assert one._bend(np.array([0.0, sign * 1.0, 0.0, 0.0])) == one._bend(np.array([0, 0, 0, sign * 1.0])) == word
    # x^5 - k x^3 bends as its part beside a straight line goes with x^3
    k = 0.9 * np.mean(x**8) / np.mean(x**6)
    straight = [p - (x @ p) / (x @ x) * x for p in (x**3, x**5)]
    bend = straight[0] @ (straight[1] - k * straight[0])
    assert one._bend(np.array([0, -k * sign, 0, sign])) == ("hardening" if sign * bend > 0 else "softening")
    # odd squares below a fifth of the even ones: no word
    for part, said in ((0.19, ""), (0.21, word)):
        even = np.sqrt(np.mean(x**6) / np.mean(x**4) / part)
        assert one._bend(np.array([even, sign * 1.0, 0.0, 0.0])) == said
        even = np.sqrt(np.mean(x**10) / np.mean(x**8) / part)
        assert one._bend(np.array([0.0, 0.0, even, sign * 1.0])) == said


@pytest.mark.parametrize(
    "smooth, gap, kink", [(0.5, 0.56, True), (0.5, 0.54, False), (0.9, 0.911, True), (0.9, 0.909, False)]
)
def test_straight_lines_with_a_gap_must_explain_a_tenth_more_of_what_a_curve_leaves(smooth, gap, kink):
    one = work(noise(3000), motion())
    one.judge.share = lambda names, beside: (
        smooth if names == ["smooth s"] else gap if names == ["gap 1.0"] else 0.0,
        0,
    )
    assert one._has_kink() == kink


def faked(monkeypatch, shares, error=0.02):
    """Characterise with shares as given, simplest first."""
    given = {"constant": 0.0, "linear": 0.0, "s alone": 0.0, "s and v": 0.0, "path": 0.0} | shares
    names = {k: [] if k in ("constant", "linear") else [k] for k in given}

    def share(columns):
        name = "constant" if columns == ["constant"] else columns[-1] if len(columns) > 2 else "linear"
        return given[name], error

    one = SimpleNamespace(
        judge=SimpleNamespace(share=share), names=names, base=["constant", "linear"], frequency=np.nan
    )
    one.shape_of, one.curves, one.rms = lambda d: (0.5, []), dict, 2.0
    monkeypatch.setattr(characterisation._Work, "of", lambda *a: one)
    return characterise(None, None)


def test_shares_come_with_two_standard_errors_and_what_they_gain_beyond_linear(monkeypatch):
    found = faked(monkeypatch, {"linear": 0.2, "s alone": 0.7, "s and v": 0.65, "path": 0.72})
    row = found.shares.loc["s alone"]
    assert row[["share", "low", "high", "gain"]].tolist() == pytest.approx([70, 66, 74, 50])
    assert found.memory == pytest.approx(7) and found.shares["chosen"].tolist() == [False, False, True, False, False]
    assert faked(monkeypatch, {"linear": -0.2, "s alone": 0.7}).shares.loc["s alone", "gain"] == pytest.approx(70)


@pytest.mark.parametrize("best", [0.9, 0.5, 0.3])
def test_the_simplest_that_explains_nearly_as_much_is_chosen(monkeypatch, best):
    slack = NEARLY * min(1.0, best + 0.25)  # less where less is explained
    for share, chosen in ((best - 0.99 * slack, "s alone"), (best - 1.01 * slack, "path")):
        assert faked(monkeypatch, {"s alone": share, "path": best}).dependence == chosen


def test_below_a_least_share_nothing_explains_the_force(monkeypatch):
    assert faked(monkeypatch, {"path": LEAST * 1.001}).dependence == "path"
    found = faked(monkeypatch, {"path": LEAST * 0.999})
    assert found.dependence == "nothing tried" and f"at most {100 * LEAST:.0f} % explained" in str(found)


def said(dependence, odd=0.5, features=(), noise=None, share=81.4, memory=12.3, rms=2.0):
    table = pd.DataFrame({"share": [share]}, index=[dependence])
    return characterisation._sentence(
        Characterisation(table, dependence, memory, odd, 12.3456, list(features)), noise, rms
    )


@pytest.mark.parametrize(
    "given, words",
    [
        (dict(dependence="s alone", odd=0.91), "Depends on s alone, odd, smooth: a nonlinear spring; 81 % explained"),
        (dict(dependence="s alone", odd=0.89), "Depends on s alone, neither odd nor even, smooth"),
        (dict(dependence="v alone", odd=0.09), "Depends on v alone, even, smooth: nonlinear damping;"),
        (dict(dependence="v alone", odd=0.11), "neither odd nor even"),
        (dict(dependence="s alone", odd=1.0, features=["hardening"]), "odd, smooth (hardening): a nonlinear spring"),
        (dict(dependence="s alone", odd=0.5, features=["kink"]), "with a kink: contact on one side"),
        (dict(dependence="s alone", odd=1.0, features=["kink"]), "with a kink: gap- or contact-like"),
        (dict(dependence="s and v", odd=1.0, features=["kink"]), "with a kink: bent sharply"),
        (dict(dependence="s and v", odd=1.0), "a force on the surface R(s, v)"),
        (
            dict(dependence="v alone", odd=1.0, features=["jump at v = 0"]),
            "odd, with a jump at v = 0: friction-like; 81 %",
        ),
        (
            dict(dependence="path", odd=1.0),
            "Depends on the path (memory adds 12 points to any function of s and v), odd: hyst",
        ),
        (dict(dependence="line"), "Is a spectral line at 12.35 Hz: an unmeasured harmonic force; 81 %"),
        (dict(dependence="covariate T", odd=0.95), "Is modulated by T, odd in the motion; 81 %"),
        (dict(dependence="covariate T", odd=0.9), "Is modulated by T, odd in the motion; 81 %"),
        (dict(dependence="covariate T", odd=0.89), "Is modulated by T; 81 %"),
        (dict(dependence="covariate T", odd=np.nan), "Is modulated by T; 81 %"),
        (dict(dependence="delay"), "Follows the derivative of a channel: a delay between channels; 81 %"),
        (dict(dependence="amplitude", noise=1.0), "81 % explained on data left out, noise is 25 %."),
        (dict(dependence="amplitude", noise=1.9), "noise is 90 %."),
        (dict(dependence="amplitude", noise=3.0), "noise is 100 %."),
        (dict(dependence="amplitude", noise=0.5), "noise is 6 %."),
        (
            dict(dependence="nothing tried", share=-3.0, noise=1.0),
            "at most 0 % explained, noise is 25 %): noise, or a force",
        ),
        (dict(dependence="amplitude", noise=1.0, rms=0.0), "81 % explained on data left out."),
    ],
)
def test_words(given, words):
    assert words in said(**given)


def test_the_value_of_a_function_along_the_mirrored_motion():
    m = motion(500)
    one = work(noise(500), m)
    c = {"constant": np.array([3.0]), "linear": np.array([2.0, -1.0])}
    assert one._value(["constant", "linear"], c, 1.0) == pytest.approx(3 + 2 * m.s - m.v)
    assert one._value(["constant", "linear"], c, -1.0) == pytest.approx(3 - 2 * m.s + m.v)


# -- coupling ---------------------------------------------------------------------------------------


def test_coupling_is_sure_beyond_a_share_and_two_errors_and_says_so():
    least, sigmas = coupling._OTHERS, coupling._SURELY
    assert Coupling(1, 5.0, 0.1, least, 0.0).coupled and not Coupling(1, 5.0, 0.1, 0.999 * least, 0.0).coupled
    assert Coupling(1, 5.0, 0.1, 0.5, 0.499 / sigmas).coupled and not Coupling(1, 5.0, 0.1, 0.5, 0.5 / sigmas).coupled
    text = str(Coupling(2, 5.4321, 0.126, 0.3, 0.01))
    assert (
        text.startswith("storey 2, 5.43 % of its force")
        and "explain 13 % of that" in text
        and "30 % of the rest" in text
    )
    assert "explain 0 %" in str(Coupling(2, 5.0, -0.2, 0.0, 0.0)) and "coupling" not in str(
        Coupling(2, 5.0, 0.1, 0.0, 0.0)
    )


def chain_residual(rho, n=3000, seed=0):
    """A residual whose storey forces are given functions of drifts and rates that are noise."""
    rng = np.random.default_rng(seed)
    s, v = rng.standard_normal((2, n, len(rho)))
    X = np.hstack([rng.standard_normal((n, len(rho))), v, s])
    F = 10 * rng.standard_normal((n, len(rho)))
    model = ChainModel([1.0] * len(rho), {i + 1: [laws.LinearElastic(1.0)] for i in range(len(rho))})
    storeys = np.column_stack([f(s, v) for f in rho])
    e = storeys - np.column_stack([storeys[:, 1:], np.zeros(n)])
    return residual_of(model, from_arrays(X, F, dt=0.01)).with_balance([e])


def test_a_storey_that_follows_another_is_coupled_and_one_that_follows_itself_is_not():
    found = chain_residual([lambda s, v: s[:, 0] ** 3 + 5 * np.sign(v[:, 0]), lambda s, v: 2 * s[:, 0] + noise(len(s))])
    assert rms([from_top(found.balance[0])])[1] == pytest.approx(np.sqrt(5), rel=0.05)
    one = couplings(found)
    assert [c.storey for c in one] == [2]
    # 4 of 5 parts are linear in the other storey, of what its own motion leaves: all
    assert one[0].own == pytest.approx(0.0, abs=0.02) and one[0].others == pytest.approx(0.8, abs=0.03)
    assert one[0].percent == pytest.approx(found.sizes.loc["storey 2", "percent"])
    level = found.sizes.loc["storey 2", "rms"] / coupling._LOUD
    assert not couplings(found, NoiseFloor(np.ones(2), np.full(2, 1.001 * level), ""))
    assert couplings(found, NoiseFloor(np.ones(2), np.full(2, 0.999 * level), ""))
    found.sizes.loc["storey 2", "rms"] = 0.99 * ROUND_OFF * found.sizes.loc["storey 2", "reference"]
    assert not couplings(found)


@pytest.mark.parametrize(
    "own, other, listed", [(0.55, 0.0, False), (0.45, 0.0, True), (0.93, 1, True), (0.97, 1, False)]
)
def test_a_storey_is_listed_if_half_is_unexplained_or_a_twentieth_follows_the_others(own, other, listed):
    def force(s, v):
        rest = s[:, 0] if other else noise(len(s), 9)
        return np.sqrt(own) * np.sign(v[:, 1]) + np.sqrt(1 - own) * rest

    found = couplings(chain_residual([lambda s, v: 0 * s[:, 0], force], 8000))
    assert bool(found) == listed and (not found or found[0].own == pytest.approx(own, abs=0.02))


def test_storeys_are_listed_from_the_loudest_and_a_single_one_has_no_others():
    found = chain_residual(
        [lambda s, v: 0.1 * noise(len(s), 4), lambda s, v: noise(len(s), 5), lambda s, v: 5 * noise(len(s), 6)]
    )
    assert [c.storey for c in couplings(found)] == [3, 2, 1]
    alone = couplings(chain_residual([lambda s, v: noise(len(s), 4)]))
    assert [(c.storey, c.others, c.error) for c in alone] == [(1, 0.0, 0.0)]


def test_own_columns_are_friction_damping_springs_and_sliders():
    m = motion(800)
    columns = coupling._own(m, 0.7)
    assert columns[:, :4] == pytest.approx(np.column_stack([np.sign(m.v), np.abs(m.v) * m.v, m.s**2, m.s**3]))
    for share, slider in zip(coupling._YIELD, columns[:, 4:].T, strict=True):
        assert np.abs(slider).max() <= 1 + 1e-9
        steps = np.abs(np.diff(slider)) > 1e-12
        inside = np.abs(slider[1:]) < 0.99
        ratio = np.diff(slider)[steps & inside] / np.diff(m.s)[steps & inside]  # sticking: 1 / (share * scale)
        assert np.median(ratio) == pytest.approx(1 / (share * 0.7), rel=0.02)


# -- contradictions ---------------------------------------------------------------------------------


@pytest.mark.parametrize("cut", [2 * contradictions._HALF, 2 * contradictions._HALF - 1])
def test_runs_are_halved_by_rows_where_they_are_long_enough(cut):
    half = contradictions._HALF
    runs = [slice(10, 10 + cut - half // 2), slice(9000, 9000 + half // 2)]
    halves = contradictions._halves(runs)
    if cut < 2 * half:
        assert halves == [runs]
    else:
        assert halves == [[slice(10, 10 + half)], [slice(10 + half, 10 + cut - half // 2), runs[1]]]
    many = [slice(0, 2 * half), slice(3 * half, 5 * half), slice(6 * half, 9 * half)]
    rows = [[k for part in part_of for k in range(part.start, part.stop)] for part_of in contradictions._halves(many)]
    every = [k for run in many for k in range(run.start, run.stop)]
    assert rows == [every[: len(every) // 2], every[len(every) // 2 :]]


@pytest.mark.parametrize(
    "gain, coherence, size",
    [(1.2, 0.9, 0.2), (0.8, 0.9, 0.2), (1.04, 0.9, 0.0), (1.06, 0.9, 0.06), (0.955, 0.9, 0.0), (0.94, 0.9, 0.06),
     (-1.0, 0.5, 2.0), (0.0, 0.9, 1.0)],
)  # fmt: skip
def test_a_gain_that_noise_in_one_channel_could_make_is_none(gain, coherence, size):
    """Noise in the output lowers the gain by sqrt(coherence), in the input it raises it by the same factor."""
    assert (abs(gain - 1) if not np.sqrt(coherence) <= gain <= 1 / np.sqrt(coherence) else 0) == pytest.approx(size)
    assert contradictions._beyond_noise(gain, coherence) == pytest.approx(size)


def fake_work(v=None, n=400, dt=0.01, blocks=None, searched=(0,)):
    v = np.zeros((n, 2)) if v is None else v
    seg = SimpleNamespace(v=v, valid=slice(5, n), dt=dt)
    blocks = blocks or [BlockRows(0, slice(0, 100)), BlockRows(0, slice(150, 300))]
    runs = {0: [slice(0, 100), slice(150, 300)], 1: [slice(0, 180)]}
    return SimpleNamespace(
        search=blocks, searched=list(searched), data=SimpleNamespace(segments=[seg, seg]), runs=lambda i: runs[i]
    )


def test_pace_is_the_mean_frequency_of_the_rate_of_a_dof():
    t = np.arange(400) * 0.01
    one = fake_work(np.column_stack([np.cos(20 * t), np.cos(20 * t) + 0.3]))
    assert contradictions.pace(one, 1) == pytest.approx(20, rel=0.02)
    line = [2 * np.cos(20 * t[5:])[rows] + 0.3 for rows in (slice(0, 100), slice(150, 300))]
    top = sum((np.diff(x) ** 2).sum() for x in line) / 0.01**2
    assert contradictions.pace(one, 2) == pytest.approx(np.sqrt(top / sum((x**2).sum() for x in line)))
    assert contradictions.pace(fake_work(), 1) == 1.0
    still = fake_work(np.column_stack([np.cos(20 * t), 0 * t]), dt=None)
    assert contradictions.pace(still, 1) == pytest.approx(0.2, rel=0.02)


def test_longest_run_and_the_record_with_most_rows():
    both = fake_work(searched=(0, 1))
    assert contradictions.longest(both) == (1, slice(5, 185))  # 180 rows in one piece
    assert contradictions._runs(both) == (0, [slice(5, 105), slice(155, 305)])  # 250 rows in two


def alignment(**rows):
    base = {
        "reference": "a1",
        "delay": 0.0,
        "gain": 1.0,
        "sign": 1.0,
        "coherence": 1.0,
        "aligned": False,
        "message": "m",
    }
    return pd.DataFrame.from_dict({k: base | r for k, r in rows.items()}, orient="index")


def suspects(monkeypatch, *tables):
    """What the channels say if they are compared as a whole and in both halves as given."""
    tables = iter(tables)
    monkeypatch.setattr(contradictions, "channel_alignment", lambda record, runs: next(tables))
    monkeypatch.setattr(contradictions, "_halves", lambda runs: [runs, runs])
    t = np.arange(400) * 0.01
    one = fake_work(np.column_stack([np.cos(20 * t), np.zeros(400)]))
    ready = SimpleNamespace(contradictions=None, records=[None])
    return contradictions.contradictory(ready, one), contradictions.pace(one, 1)


def test_a_delay_accuses_both_channels_with_opposite_signs(monkeypatch):
    late = alignment(x1={"delay": 0.004})
    found, pace = suspects(monkeypatch, late, late, late)
    assert [(s.law.name, str(s.site)) for _, s in found] == [("channel_delay", f"sensor {c}") for c in ("x1", "a1")]
    assert [s.law.values[0] for _, s in found] == [0.004, -0.004]
    assert [size for size, _ in found] == pytest.approx([0.004 * pace] * 2) and found[0][1].remark == "m"


@pytest.mark.parametrize("factor, seen", [(0.99, 0), (1.01, 2)])
def test_a_contradiction_must_reach_a_share_of_the_channel(monkeypatch, factor, seen):
    gain = alignment(x1={"gain": 1 + factor * CONTRADICTION})
    assert len(suspects(monkeypatch, gain, gain, gain)[0]) == seen


def test_a_gain_accuses_a_channel_or_by_its_inverse_the_reference(monkeypatch):
    wrong = alignment(x1={"gain": 1.25}, v1={"gain": 1.5, "aligned": True}, a2={"gain": np.nan})
    found, _ = suspects(monkeypatch, wrong, wrong, wrong)
    assert [(s.law.name, str(s.site), round(s.law.values[0], 12)) for _, s in found] == [
        ("gain_error", "sensor x1", 0.25), ("gain_error", "sensor a1", -0.2)
    ]  # fmt: skip
    turned = alignment(x1={"gain": 1.0, "sign": -1.0})
    assert [s.law.values[0] for _, s in suspects(monkeypatch, turned, turned, turned)[0]] == [-2.0, -2.0]


@pytest.mark.parametrize(
    "first, second, denied", [(1.2, 0.9, True), (1.2, 1.1, False), (0.8, 1.1, True), (1.2, 1.0, False)]
)
def test_what_one_half_of_the_record_denies_is_chance(monkeypatch, first, second, denied):
    tables = [alignment(x1={"gain": g}) for g in (1.1, first, second)]
    assert (not suspects(monkeypatch, *tables)[0]) == denied
    tables = [alignment(x1={"delay": g - 1.0}) for g in (1.1, first, second)]
    assert (not suspects(monkeypatch, *tables)[0]) == denied


def test_the_largest_fault_of_each_channel_goes_first_and_few_are_said(monkeypatch):
    table = alignment(x1={"gain": 1.1}, v1={"gain": 1.3}, x2={"gain": 1.05, "reference": "a2"})
    found, _ = suspects(monkeypatch, table, table, table)
    assert [(str(s.site), round(size, 3)) for size, s in found] == [
        ("sensor v1", 0.3), ("sensor a1", 0.3), ("sensor x1", 0.1), ("sensor x2", 0.05), ("sensor a2", 0.05)
    ]  # fmt: skip
    sized = [(contradictions._SAID * k, Suspect(ChannelDelay(0.1), Site("sensor x1"), r)) for k, r in
             ((3, "a"), (2, "a"), (1.0, "b"), (0.99, "c"), (1, "d"), (1, "e"))]  # fmt: skip
    monkeypatch.setattr(contradictions, "contradictory", lambda ready, work: sized)
    assert contradictions.contradictions(None, None) == ["a", "b", "d", "e"][: MOST - 1]


# -- noise levels -----------------------------------------------------------------------------------


@pytest.mark.parametrize("pieces", [1, 9])
def test_lower_tail_is_that_of_welchs_estimate(pieces):
    """Half-overlapping Hann windows share (1/6)^2 of their variance with each neighbour (P. D. Welch, 1967)."""
    window = np.hanning(513)[:-1]
    overlap = (window[256:] @ window[:256] / (window @ window)) ** 2
    dof = 2 * pieces / (1 + 2 * overlap)
    assert noise_level.lower_tail(0.1, pieces) == pytest.approx(stats.chi2.ppf(0.1, dof) / dof, rel=1e-3)


def test_flat_level_is_the_mean_of_the_values_that_scatter_like_noise():
    rng = np.random.default_rng(0)
    quiet, dof = rng.chisquare(40, 400) / 40 * 3.0, 40
    found = noise_level.flat_level(np.concatenate([rng.uniform(9, 99, 600), quiet]), dof)
    assert found == pytest.approx(quiet.mean(), rel=0.02)
    # by hand: three values begin, what lies below 1.2 times their mean goes with them, and so on
    reach = stats.chi2.ppf(noise_level._NOISE, 400) / 400
    first = np.array([1.0, 1.0, 1.0, 0.99 * reach, 1.01 * reach * np.mean([1, 1, 1, 0.99 * reach]), 5.0])
    assert noise_level.flat_level(first, 400) == pytest.approx(first[:4].mean())
    many = np.r_[np.ones(59), 5.0]
    assert noise_level.flat_level(many, 400) == pytest.approx(1.0) and noise_level.flat_level(np.array([2.0]), 9) == 2.0
    begin = np.r_[np.linspace(1, 1.5, 5), np.full(95, 2.5)]  # the lowest twentieth of a hundred begins
    assert noise_level.flat_level(begin, 400) == pytest.approx(np.linspace(1, 1.5, 5).mean())


def test_noise_is_read_where_the_signal_is_quiet_in_frequency_or_time():
    t = np.arange(20000) / 500
    force = sum(np.sin(2 * np.pi * f * t + f**2) for f in np.arange(3.0, 60.0, 0.77))
    for level in (0.1, 0.7):
        assert noise_level.quiet_level(force + level * noise(20000), 500.0) == pytest.approx(level, rel=0.05)
        assert noise_level.quiet_level(force + level * noise(20000) + 99 * np.eye(1, 20000, 7)[0], 1.0) > 0
    blows = np.where(np.arange(20000) % 2000 < 20, 50.0, 0.0)
    assert noise_level.quiet_level(blows + 0.5 * noise(20000), 500.0) == pytest.approx(0.5, rel=0.03)
    with_gaps = blows + 0.5 * noise(20000)
    with_gaps[3000:3100] = np.nan
    assert noise_level.quiet_level(with_gaps, 500.0) == pytest.approx(0.5, rel=0.03)


@pytest.mark.parametrize("n, told", [(255, False), (256, True)])
def test_short_signals_tell_no_noise(n, told):
    x = np.zeros(n)
    x[:16] = 50.0
    x = x + 0.1 * noise(n)
    assert (noise_level.quiet_level(x, 100.0) > 0) == told
    assert (noise_level.denoised(x, 0.1, 100.0) is not x) == told


@pytest.mark.parametrize("share, told", [(0.19, True), (0.215, False)])
def test_a_floor_louder_than_a_fifth_of_the_signal_is_the_signal(share, told):
    n = 64 * 1000
    x = np.zeros(n)
    x[: n // 10] = np.sqrt(10 * (1 - share**2))
    level = noise_level.quiet_level(x * np.sign(noise(n, 3)) + share * noise(n), 1.0)
    assert (level > 0) == told and (not told or level == pytest.approx(share, rel=0.03))


def test_wieners_filter_takes_twice_the_noise_off():
    n, fs, level = 2**14, 100.0, 0.2
    t = np.arange(n) / fs
    pure = 3 * np.cos(2 * np.pi * 1638 / n * fs * t)
    found = noise_level.denoised(pure + level * noise(n), level, fs)
    assert np.std(found - pure) < 0.4 * level and np.std(found) == pytest.approx(3 / np.sqrt(2), rel=0.01)
    # noise of four times the variance: the gain is 1 - 2/4 on average
    loud = 2 * level * noise(n, 1)
    half = noise_level.denoised(loud, level, fs)
    assert loud @ half / (loud @ loud) == pytest.approx(0.5, abs=0.03) and half.std() < loud.std()
    assert noise_level.denoised(loud, 0.0, fs) is loud
    holes = np.where(np.arange(n) == 5, np.nan, loud)
    assert noise_level.denoised(holes, level, fs) is holes


def test_levels_hold_forces_and_base_and_take_the_base_off_relative_motion():
    n = 6400
    rng = np.random.default_rng(0)
    blows = np.where(np.arange(n) % 800 < 20, 50.0, 0.0)
    quiet = blows + 0.1 * rng.standard_normal(n)
    base = blows + 0.3 * rng.standard_normal(n)
    zeros = np.zeros((n, 2))
    record = Record(
        fs=100.0,
        coordinates="absolute",
        force=np.column_stack([quiet, 0 * quiet]),
        acceleration=zeros,
        base_acceleration=base,
    )
    found = noise_level.levels_of(record, {"a1": 0.5, "a2": 0.3, "x1": 0.5})
    assert found["F1"] == pytest.approx(0.1, rel=0.05) and found["ag"] == pytest.approx(0.3, rel=0.05)
    assert found["x1"] == 0.5 and found["a1"] == 0.5
    relative = record.replace(coordinates="relative")
    found = noise_level.levels_of(relative, {"a1": 0.5, "a2": 0.3, "x1": 0.5})
    assert found["a1"] == pytest.approx(np.sqrt(0.25 - found["ag"] ** 2)) and found["x1"] == 0.5
    assert found["a2"] == pytest.approx(max(noise_level._LEAST * 0.3, np.sqrt(max(0.09 - found["ag"] ** 2, 0))))
    rows = np.arange(n) < 20
    assert noise_level.levels_of(relative, {}, rows)["F1"] == 0.0
    fresh = noise_level.noisy_base(record, {"ag": 2.0, "vg": 1.0}, np.random.default_rng(1))
    assert list(fresh) == ["base_acceleration"]
    assert fresh["base_acceleration"] - base == pytest.approx(2.0 * np.random.default_rng(1).standard_normal(n))
    calm = noise_level.quiet_drive(record, {"F1": 0.1, "ag": 0.3})
    assert calm.force[:, 0] == pytest.approx(noise_level.denoised(quiet, 0.1, 100.0))
    assert calm.base_acceleration == pytest.approx(noise_level.denoised(base, 0.3, 100.0))
    assert not noise_level.noisy_base(record, {"ag": 0.0}, np.random.default_rng(1))


# -- noise floor ------------------------------------------------------------------------------------


def test_floors_that_are_given_add_up_from_the_top():
    floor = NoiseFloor.given({1: 3.0, 3: 4.0}, 3)
    assert floor.at("dof 1") == 3.0 and np.isnan(floor.at("dof 2")) and floor.at("storey 3") == 4.0
    assert np.isnan(floor.storey[:2]).all() and NoiseFloor.given(2.0, 3).storey == pytest.approx(2 * np.sqrt([3, 2, 1]))
    assert NoiseFloor.given([1.0, 2.0], 2).covariance() == pytest.approx(np.diag([1.0, 4.0]))
    for wrong in ({4: 1.0}, {0: 1.0}, [1.0, 2.0], -1.0, np.inf):
        with pytest.raises(ChannelError):
            NoiseFloor.given(wrong, 3)
    assert NoiseFloor.given(0.0, 2).storey.tolist() == [0.0, 0.0]


def draw(*parts):
    return SimpleNamespace(balance=list(parts)), None


def test_covariance_of_draws_is_that_of_all_their_samples():
    rng = np.random.default_rng(0)
    one, two, half = rng.standard_normal((40, 2)), rng.standard_normal((60, 2)) * 2, rng.standard_normal((50, 2))
    half[:, 1] = np.nan
    floor = NoiseFloor.from_draws([draw(one, two), draw(half)], "x")
    both = np.vstack([one, two])
    assert floor.covariance() == pytest.approx(both.T @ both / 100)
    assert floor.balance == pytest.approx(
        [np.sqrt(np.mean(np.r_[both[:, 0], half[:, 0]] ** 2)), np.sqrt(np.mean(both[:, 1] ** 2))]
    )
    assert floor.storey[0] == pytest.approx(np.sqrt(np.mean(both.sum(axis=1) ** 2)))
    blind = NoiseFloor.from_draws([draw(half)], "x").covariance()
    assert blind[0, 0] == pytest.approx(np.mean(half[:, 0] ** 2)) and np.isnan(blind[[0, 1, 1], [1, 0, 1]]).all()
    other = np.column_stack([half[:, 1], half[:, 0]])
    mixed = NoiseFloor.from_draws([draw(half, other)], "x")
    assert mixed.covariance() == pytest.approx(np.diag(mixed.balance**2))


def repeats(forces, left, n=400):
    """Records of one storey under given forces that leave given residuals."""
    model = ChainModel([1.0], {1: [laws.LinearElastic(1.0)]})
    sets = [from_arrays(np.zeros((n, 3)), f[:, None], dt=0.01) for f in forces]
    data = noise_floor._together(sets)
    assert [(s.rows.start, s.rows.stop) for s in data.segments] == [(k * n, (k + 1) * n) for k in range(len(forces))]
    return residual_of(model, data).with_balance([e[:, None] for e in left])


def test_repeated_records_differ_by_noise_that_is_estimated_without_bias():
    force = noise(400, 1)
    left = [noise(400, k) + 10 * force for k in range(2, 5)]
    floor = NoiseFloor.from_repeats(repeats([force] * 3, left))
    assert (
        floor.balance[0] == pytest.approx(np.sqrt(np.mean(np.var(left, axis=0, ddof=1))))
        and "3 repeated" in floor.source
    )
    with pytest.raises(ChannelError, match="no repetitions"):
        NoiseFloor.from_repeats(repeats([force], left[:1]))


@pytest.mark.parametrize("share, alike", [(0.19, True), (0.21, False)])
def test_records_excited_otherwise_are_no_repetitions(share, alike):
    force = np.tile([1.0, -1.0], 200)
    other = share * np.tile([1.0, 1.0, -1.0, -1.0], 100)
    found = repeats([force + other, force - other], [noise(400), noise(400, 1)])
    if alike:
        NoiseFloor.from_repeats(found)
    else:
        with pytest.raises(ChannelError, match="not excited alike"):
            NoiseFloor.from_repeats(found)


def test_a_difference_takes_the_rows_that_both_have():
    a, b = np.arange(6.0).reshape(3, 2), np.ones((2, 2))
    assert noise_floor._difference(a, b).tolist() == [[-1, 0], [1, 2]]
    assert noise_floor._difference(b, a).tolist() == [[1, 0], [-1, -2]]


def test_basis_of_the_work_is_that_of_all_records():
    a, b = motion(500, 1), motion(400, 2)
    assert work([noise(500), noise(400)], [a, b]).basis.s == Basis([a, b]).s


@pytest.mark.parametrize("n", [500, 3000])
def test_white_noise_has_a_line_in_one_record_of_a_hundred(n):
    """Of 400 records of noise 4 are expected, and more than 11 in one of a thousand such tests."""
    rng, t = np.random.default_rng(8), np.arange(n) / 100
    found = [characterisation.spectral_line([rng.standard_normal(n)], [Motion(t, t, t=t)]) for _ in range(400)]
    assert np.isfinite(found).sum() <= stats.binom.ppf(0.999, 400, 0.01)
