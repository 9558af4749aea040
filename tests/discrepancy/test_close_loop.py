"""The closed loop on chains whose missing effect only the assertion knows.

The motions come from scipy's DOP853 with formulas written here, not from the package's
own laws.
"""

from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from pysindy_nrf import (
    ChainModel,
    NRFRegressor,
    Record,
    Site,
    close_loop,
    excitation,
    laws,
    simulate,
)
from pysindy_nrf.exceptions import (
    BiasWarning,
    ChannelError,
    DataQualityWarning,
    LawError,
)
from pysindy_nrf.simulation.noise import add_noise

M = np.array([12.0, 10.0, 8.0])
K = np.array([4.0e4, 3.5e4, 3.0e4])
C = np.array([40.0, 30.0, 25.0])
DT = 1e-3


def force(n_samples, dofs, seed, rms=60.0):
    """Band-limited random forces, N."""
    rng = np.random.default_rng(seed)
    f = np.fft.rfftfreq(n_samples, DT)
    F = np.zeros((n_samples, 3))
    for j in dofs:
        y = np.fft.irfft(
            (rng.standard_normal(len(f)) + 1j * rng.standard_normal(len(f)))
            * ((f > 0.5) & (f < 25)),
            n_samples,
        )
        F[:, j - 1] = rms * y / y.std()
    return F


@cache
def record(effect=None, dofs=(3,), seed=0, n_samples=3500, noise=0.0, name="test"):
    """A three-storey chain with an effect: effect(t, x, v) -> forces on the DOFs."""
    F = force(n_samples, dofs, seed)
    t = np.arange(n_samples) * DT
    load = CubicSpline(t, F).c
    stiff = np.diag(K + np.append(K[1:], 0.0)) - np.diag(K[1:], 1) - np.diag(K[1:], -1)
    damp = np.diag(C + np.append(C[1:], 0.0)) - np.diag(C[1:], 1) - np.diag(C[1:], -1)

    def rate(time, y):
        i = min(int(time / DT), n_samples - 2)
        h = time - i * DT
        f = ((load[0, i] * h + load[1, i]) * h + load[2, i]) * h + load[3, i]
        x, v = y[:3], y[3:]
        return np.concatenate(
            [
                v,
                (f - stiff @ x - damp @ v + (effect(time, x, v) if effect else 0.0))
                / M,
            ]
        )

    y = solve_ivp(
        rate, (0, t[-1]), np.zeros(6), "DOP853", t_eval=t, rtol=1e-7, atol=1e-11
    ).y.T
    a = np.array([rate(ti, yi)[3:] for ti, yi in zip(t, y)])
    rec = Record(
        force=F,
        acceleration=a,
        velocity=y[:, 3:],
        displacement=y[:, :3],
        fs=1 / DT,
        name=name,
    )
    return add_noise(rec, noise, random_state=seed + 1) if noise else rec


def on_storey_2(R):
    return np.array([R, -R, 0.0])


def friction(t, x, v):
    return on_storey_2(9.0 * np.tanh((v[1] - v[0]) / 2e-4))


def cubic(t, x, v):
    return on_storey_2(1.2e9 * (x[1] - x[0]) ** 3)


def brace(t, x, v):
    R = 9e3 * (x[2] - x[0]) + 8.0 * (v[2] - v[0])
    return np.array([R, 0.0, -R])


FEW = [
    laws.CoulombFriction(),
    laws.CubicStiffness(),
    laws.QuadraticDamping(),
    laws.LinkSpringDashpot(),
]


def test_an_undeclared_effect_is_found_where_it_acts():
    report = close_loop(record(cubic, dofs=(3,), seed=3, noise=0.01), max_steps=2)
    step = report.steps[0]
    assert (
        step.confirmed
        and step.gain > 1.0
        and step.gain_least > 0.5 * step.gain
        and step.gain_heldout > 0
    )
    assert 0.03 < step.share < 1.0
    assert step.site == "storey 2"
    assert "stiffness" in (step.family, *step.alternatives)
    assert step.error_after < 0.5 * step.error_before
    assert report.model.masses == pytest.approx(M, rel=0.02)
    assert report.table.loc["baseline", "held-out"] == step.error_before
    assert len(step.alternatives) <= 2


@pytest.mark.slow
def test_nothing_is_added_where_nothing_is_missing_at_ten_percent_noise():
    report = close_loop(record(None, dofs=(1, 2, 3), seed=7, noise=0.1))
    assert report.steps == [] and len(report.table) == 1


def test_the_size_of_what_is_found():
    assert close_loop(record(cubic, seed=5), catalogue=FEW, max_steps=1).steps[
        0
    ].parameters["k3"] == pytest.approx(1.2e9, rel=1e-3)
    found = (
        close_loop(record(brace, seed=5), catalogue=FEW, max_steps=1)
        .steps[0]
        .parameters
    )
    assert found["k"] == pytest.approx(9e3, rel=1e-3)
    assert found["c"] == pytest.approx(8.0, rel=1e-2)


def test_a_change_in_time_is_seen_when_it_happens():
    """Where it falls into a held-out piece its time is anywhere in it."""
    when = 2.2

    def weaker(t, x, v):
        return on_storey_2(-9e3 * (x[1] - x[0]) * (t > when))

    rec = record(weaker, seed=3, noise=0.01, n_samples=3000)
    step = close_loop(
        rec, catalogue=[laws.StiffnessStep(), laws.StiffnessDrift()], max_steps=1
    ).steps[0]
    assert (step.law, step.site) == ("stiffness_step", "storey 2")
    assert step.parameters["dk"] == pytest.approx(-9e3, rel=0.03)
    assert step.parameters["t0"] == pytest.approx(when, abs=0.15)


@pytest.mark.slow
def test_intervals_hold_the_truth():
    rec = record(brace, seed=5, noise=0.02, n_samples=3000)
    report = close_loop(
        rec, catalogue=[laws.LinkSpringDashpot(), laws.CubicStiffness()], max_steps=1
    )
    found = report.steps[0]
    for name, truth, width in (("k", 9e3, 0.1), ("c", 8.0, 1.5)):
        low, high = found.intervals[name]
        assert low <= truth <= high
        assert high - low < width * truth

    def gap(t, x, v):
        s = x[1] - x[0]
        return on_storey_2(4e4 * (max(s - 2e-3, 0.0) + min(s + 2e-3, 0.0)))

    found = close_loop(
        record(gap, seed=5, noise=0.01, n_samples=3000),
        catalogue=[laws.TwoSidedGap()],
        max_steps=1,
    ).steps[0]
    assert found.intervals["gap"][0] <= 2e-3 <= found.intervals["gap"][1] < 2.2e-3
    assert found.intervals["k"][0] <= 4e4 <= found.intervals["k"][1]


def test_an_effect_that_is_not_in_the_catalogue_gets_no_sure_name():
    other = [
        laws.CoulombFriction(),
        laws.QuadraticDamping(),
        laws.Dahl(),
        laws.StiffnessDrift(),
        laws.ConstantForce(),
    ]
    report = close_loop(record(brace, seed=3, noise=0.01), catalogue=other, max_steps=2)
    assert all(
        not step.sure and "unexplained remainder" in step.sentence
        for step in report.steps
    )


def test_a_name_beside_which_a_general_law_explains_more_is_not_sure():
    """Of a damping with a power of the rate, a regularised friction leaves 3 %, of
    which noise is nothing.
    """

    def power(t, x, v):
        return on_storey_2(60.0 * np.sign(v[1] - v[0]) * abs(v[1] - v[0]) ** 0.4)

    report = close_loop(record(power, seed=3), catalogue=[laws.RegularizedFriction()])
    step = report.steps[0]
    assert step.confirmed and step.remainder < 0.05 and not step.sure
    assert (
        "a function of drift and rate at storey 2 would gain" in report.stopped_because
    )


def test_a_name_is_no_surer_than_the_worst_balance():
    """Friction in storey 3 closes its own balances; storey 1, whose stiffness falls
    with time, lies in another one.
    """

    def top(t, x, v):
        return 15.0 * np.tanh((v[2] - v[1]) / 1e-4) * np.array([0.0, 1.0, -1.0])

    def top_and_softening(t, x, v):
        return top(t, x, v) + np.array([0.3 * K[0] * t / 3.5 * x[0], 0.0, 0.0])

    alone, beside = (
        close_loop(
            record(effect, seed=5), catalogue=[laws.RegularizedFriction()]
        ).steps[0]
        for effect in (top, top_and_softening)
    )
    assert (
        alone.site == beside.site == "storey 3" and alone.confirmed and beside.confirmed
    )
    assert alone.sure and not beside.sure and alone.remainder < 0.05 < beside.remainder


def test_the_loop_leaves_the_record_and_the_baseline_as_they_were():
    rec, baseline = record(cubic, seed=1), NRFRegressor(degree=1)
    before = {k: c.copy() for k, c in rec.channels().items()}
    close_loop(rec, baseline, FEW)
    assert all(np.array_equal(before[k], c) for k, c in rec.channels().items())
    assert not hasattr(baseline, "model_")


def test_bad_input_is_named():
    with pytest.raises(ChannelError, match="not a Record"):
        close_loop(np.zeros((100, 3)))
    with pytest.raises(LawError, match="not a force law"):
        close_loop(record(n_samples=600), catalogue=["friction"])
    with pytest.raises(ValueError, match="nothing scales the chain"):
        close_loop(record(n_samples=600).replace(force=np.zeros((600, 3))))
    still = Record(
        force=np.random.default_rng(0).standard_normal((1000, 1)),
        velocity=np.zeros((1000, 1)),
        fs=100.0,
    )
    with (
        pytest.warns(DataQualityWarning, match="v1 is constant"),
        pytest.raises(ChannelError, match="Nothing moves"),
    ):
        close_loop(still)


def test_a_covariate_that_a_held_out_record_lacks_is_named_before_the_search():
    rec = record(friction, seed=3).replace(covariates={"u": np.linspace(0, 1, 3500)})
    baseline = NRFRegressor(
        laws={2: [laws.PowerSeries(1), laws.CovariateFriction(covariate="u")]}, degree=1
    )
    with pytest.raises(
        ChannelError,
        match="Record 'later' has no covariate 'u', which covariate_friction",
    ):
        close_loop(
            rec, baseline, FEW, heldout=record(friction, seed=3).replace(name="later")
        )


def test_what_the_search_does_not_use_of_the_baseline_is_said():
    with pytest.warns(
        BiasWarning, match="does not use estimation='iv' of the baseline"
    ):
        close_loop(
            record(cubic, seed=1),
            NRFRegressor(degree=1, estimation="iv"),
            FEW,
            max_steps=0,
        )


# -- held-out data have the last word ------------------------------------------


def test_an_effect_that_does_not_lower_the_held_out_error_is_not_confirmed_and_not_in_the_model():
    report = close_loop(
        record(cubic, seed=1),
        catalogue=FEW,
        heldout=record(None, seed=2, name="other"),
        max_steps=1,
    )
    (step,) = report.steps
    assert (step.law, step.site) == ("cubic_stiffness", "storey 2")
    assert (
        not step.confirmed and not step.sure and step.error_after >= step.error_before
    )
    assert "NOT CONFIRMED" in str(report) and "NOT CONFIRMED" in report.to_markdown()
    assert [law.name for law in report.model.laws[Site("storey 2")]] == ["power_series"]
    assert (
        report.model.info["steps"] == []
        and len(report.models) == len(report.table) == 2
    )


def test_an_effect_that_lowers_what_is_left_by_less_than_a_tenth_is_not_confirmed():
    """Friction of 13 N, 3 % of the storey's force: confirmed at 10 % noise; at 14 % it
    is next to nothing.
    """
    storey = laws.PowerSeries(1, [600.0, 2e5])
    truth = ChainModel(
        [12.0, 10.0], {1: storey, 2: [storey, laws.CoulombFriction(13.0)]}
    )
    F = excitation.band_limited_random(
        2, 20.0, 200.0, excited=[1, 2], rms=100.0, band=(0.5, 40), random_state=1
    )
    tried, clean = (
        [
            laws.CoulombFriction(),
            laws.RegularizedFriction(),
            laws.CubicStiffness(),
        ],
        simulate(truth, F, 1 / 200),
    )
    large, small = (
        close_loop(add_noise(clean, noise, random_state=[1, 1]), catalogue=tried)
        for noise in (0.1, 0.14)
    )
    for report in (large, small):
        (step,) = report.steps
        assert (step.family, step.site) == (
            "friction",
            "storey 2",
        ) and step.error_after < step.error_before
    assert (
        large.steps[0].confirmed
        and large.steps[0].gain > 20 * np.log10(1 / 0.9) > small.steps[0].gain
    )
    assert not small.steps[
        0
    ].confirmed and "the gain is too small: NOT CONFIRMED" in str(small)
    assert [law.name for law in small.model.laws[Site("storey 2")]] == ["power_series"]


def test_confirmed_effects_are_those_of_the_model():
    """Of two effects the held-out record has one."""

    def both(t, x, v):
        return weak(t, x, v) + np.array([-20.0 * v[0] * abs(v[0]), 0.0, 0.0])

    def weak(t, x, v):
        return 0.1 * cubic(t, x, v)

    heldout = record(weak, dofs=(1, 2, 3), seed=9, name="other")
    report = close_loop(
        record(both, dofs=(1, 2, 3), seed=2),
        catalogue=FEW,
        heldout=heldout,
        max_steps=2,
    )
    assert {(s.law, s.confirmed) for s in report.steps} == {
        ("cubic_stiffness", True),
        ("quadratic_damping", False),
    }
    held = {law.name for laws_ in report.model.laws.values() for law in laws_}
    assert held == {"power_series", "cubic_stiffness"}


@pytest.mark.slow
def test_the_visited_region_is_that_of_the_search():
    """The held-out record is stronger: a force there is an extrapolation, and says
    so.
    """
    small = record(cubic, seed=1)
    strong = record(None, seed=2, name="other")
    report = close_loop(
        small,
        catalogue=FEW,
        heldout=strong.replace(displacement=4 * strong.displacement),
        max_steps=1,
    )
    drift = np.diff(small.displacement, axis=1)[:, 0]
    region = report.model.visited[Site("storey 2")]
    assert region.high[1] <= 1.01 * drift.max()
    assert not region.contains(np.zeros(1), np.array([4 * drift.max()]))[0]


# -- no claim where there is none to make --------------------------------------


def test_masses_below_zero_are_no_finding():
    rec = record(cubic, seed=1)
    report = close_loop(rec.replace(force=-rec.force), catalogue=FEW)
    assert report.steps == [] and len(report.table) == 1
    assert "masses came out not positive (m1 = -" in report.stopped_because
    assert "Nothing is claimed" in report.stopped_because


def test_a_balance_of_which_nothing_is_explained_is_no_finding():
    rec = record(cubic, seed=1)
    other = force(3500, (1, 2, 3), seed=77)
    report = close_loop(rec.replace(force=other), catalogue=FEW)
    assert report.steps == [] and "Nothing is claimed" in report.stopped_because
    assert (
        "% of the balance of DOF" in report.stopped_because
        or "not positive" in report.stopped_because
    )


# -- bands ---------------------------------------------------------------------


def test_bands_are_found_where_the_chain_is_heard():
    """Driven up to 25 Hz: with noise there is nothing to hear far above, and no band
    has to be given.
    """
    storeys = {
        i: [laws.LinearElastic(k), laws.LinearViscous(c)]
        for i, (k, c) in enumerate(zip(K, C), 1)
    }
    truth = ChainModel(M, {**storeys, 2: [*storeys[2], laws.CubicStiffness(1.2e9)]})
    F = excitation.band_limited_random(
        3, 40.0, 200.0, excited=3, rms=60.0, band=(0.5, 25.0), random_state=1
    )
    rec = add_noise(simulate(truth, F, 1 / 200), 0.02, random_state=2)
    for band, lows, highs in (
        (None, (0.0, 2.0), (15.0, 60.0)),
        ((3.0, 12.0), (3.0, 4.0), (10.0, 12.01)),
    ):
        report = close_loop(rec, catalogue=FEW, max_steps=1, band=band)
        low, high = report.band
        assert lows[0] <= (low or 0.0) <= lows[1] and highs[0] < high < highs[1], (
            report.band
        )
        assert report.table["band"].iloc[0].endswith("Hz")
        assert (report.steps[0].law, report.steps[0].site) == (
            "cubic_stiffness",
            "storey 2",
        )
    assert report.settings["loop"]["band"] == "(3.0, 12.0) Hz"


def test_an_element_without_mass_and_without_a_clock():
    """A slider on a spring, moved slowly: found along its path, and no law of the rate
    is tried.
    """
    x = (
        0.01
        * np.sin(np.linspace(0.0, 150.0, 6000))
        * np.abs(np.sin(np.linspace(0.1, 9.0, 6000)))
    )
    slider = np.zeros(len(x))
    for i, step in enumerate(np.diff(x, prepend=0.0)):
        slider[i] = np.clip(slider[i - 1] + step, -0.002, 0.002)
    noise = np.random.default_rng(3).standard_normal(len(x))
    report = close_loop(
        Record(
            force=(3e4 * x + 2e5 * slider + 2.0 * noise)[:, None],
            displacement=x[:, None],
        )
    )
    (step,) = report.steps
    assert (step.law, step.site, step.confirmed) == ("jenkins", "storey 1", True)
    assert step.parameters["Fy"] == pytest.approx(400.0, rel=0.02) and step.shape[
        "uy"
    ] == pytest.approx(2e-3, rel=0.05)
    assert report.model.masses == pytest.approx([0.0])
    assert report.verdict.state != "red"  # it has no free run, which is no fault of it
    assert not {"maxwell_branch", "quadratic_damping"} & set(report.candidates["law"])
