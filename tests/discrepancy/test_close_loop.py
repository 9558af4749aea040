"""The closed loop on chains whose missing effect only the assertion knows.

The motions come from scipy's DOP853 with formulas written here, not from the package's
own laws.
"""

from dataclasses import FrozenInstanceError
from functools import cache

import numpy as np
import pysindy as ps
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from pysindy_nrf import (
    ChainModel,
    NRFRegressor,
    Parameter,
    Record,
    Site,
    close_loop,
    excitation,
    laws,
    simulate,
)
from pysindy_nrf.exceptions import (
    ChainError,
    ChannelError,
    DataQualityWarning,
    LawError,
)
from pysindy_nrf.simulation import add_noise

M = np.array([12.0, 10.0, 8.0])
K = np.array([4.0e4, 3.5e4, 3.0e4])
C = np.array([40.0, 30.0, 25.0])
DT = 1e-3


def random_forces(n_samples, dofs, seed, rms=60.0):
    """Random forces between 0.5 and 25 Hz on some floors, N."""
    rng = np.random.default_rng(seed)
    f = np.fft.rfftfreq(n_samples, DT)
    inside = (f > 0.5) & (f < 25)
    forces = np.zeros((n_samples, 3))
    for j in dofs:
        real, imaginary = rng.standard_normal((2, len(f)))
        line = np.fft.irfft((real + 1j * imaginary) * inside, n_samples)
        forces[:, j - 1] = rms * line / line.std()
    return forces


def tridiagonal(values):
    """The matrix of a chain of springs or dashpots."""
    above = np.append(values[1:], 0.0)
    return np.diag(values + above) - np.diag(values[1:], 1) - np.diag(values[1:], -1)


@cache
def record(effect=None, dofs=(3,), seed=0, n_samples=3500, noise=0.0, name="test"):
    """A three-storey chain with an effect: effect(t, x, v) -> forces on the floors."""
    F = random_forces(n_samples, dofs, seed)
    t = np.arange(n_samples) * DT
    load = CubicSpline(t, F).c
    stiff, damp = tridiagonal(K), tridiagonal(C)

    def rate(time, y):
        i = min(int(time / DT), n_samples - 2)
        h = time - i * DT
        force = ((load[0, i] * h + load[1, i]) * h + load[2, i]) * h + load[3, i]
        x, v = y[:3], y[3:]
        force = force - stiff @ x - damp @ v
        if effect is not None:
            force = force + effect(time, x, v)
        return np.concatenate([v, force / M])

    tolerances = {"rtol": 1e-7, "atol": 1e-11}
    span, rest = (0, t[-1]), np.zeros(6)
    y = solve_ivp(rate, span, rest, "DOP853", t_eval=t, **tolerances).y.T
    run = Record(
        force=F,
        acceleration=np.array([rate(*pair)[3:] for pair in zip(t, y)]),
        velocity=y[:, 3:],
        displacement=y[:, :3],
        fs=1 / DT,
        name=name,
    )
    return add_noise(run, noise, random_state=seed + 1) if noise else run


# -- effects, as forces on the floors ------------------------------------------


def on_storey_2(R):
    return np.array([R, -R, 0.0])


def friction(t, x, v):
    return on_storey_2(9.0 * np.tanh((v[1] - v[0]) / 2e-4))


def cubic(t, x, v):
    return on_storey_2(1.2e9 * (x[1] - x[0]) ** 3)


def weak_cubic(t, x, v):
    return 0.1 * cubic(t, x, v)


def weak_cubic_and_damping(t, x, v):
    return weak_cubic(t, x, v) + np.array([-20.0 * v[0] * abs(v[0]), 0.0, 0.0])


def brace(t, x, v):
    R = 9e3 * (x[2] - x[0]) + 8.0 * (v[2] - v[0])
    return np.array([R, 0.0, -R])


def gap(t, x, v):
    s = x[1] - x[0]
    return on_storey_2(4e4 * (max(s - 2e-3, 0.0) + min(s + 2e-3, 0.0)))


def loss_of_stiffness(t, x, v):
    return on_storey_2(-9e3 * (x[1] - x[0]) * (t > 2.2))


def power_damping(t, x, v):
    rate = v[1] - v[0]
    return on_storey_2(60.0 * np.sign(rate) * abs(rate) ** 0.4)


def friction_above(t, x, v):
    return 15.0 * np.tanh((v[2] - v[1]) / 1e-4) * np.array([0.0, 1.0, -1.0])


FEWER_SENSORS = [
    laws.CoulombFriction(),
    laws.CubicStiffness(),
    laws.QuadraticDamping(),
    laws.LinkSpringDashpot(),
]


def first_step(effect, catalogue=FEWER_SENSORS, **options):
    """The first step of a loop on such a chain."""
    report = close_loop(record(effect, **options), catalogue=catalogue, max_steps=1)
    return report.steps[0]


# -- what is found -------------------------------------------------------------


def test_an_undeclared_effect_is_found_where_it_acts():
    report = close_loop(record(cubic, seed=3, noise=0.01), max_steps=2)
    step = report.steps[0]
    assert step.site == "storey 2"
    assert "stiffness" in (step.family, *step.alternatives)
    assert len(step.alternatives) <= 2
    assert report.model.masses == pytest.approx(M, rel=0.02)


def test_a_step_says_what_the_search_and_heldout_data_say():
    report = close_loop(record(cubic, seed=3, noise=0.01), max_steps=1)
    (step,) = report.steps
    assert step.confirmed and step.reduction_heldout > 0
    assert step.reduction > 1.0 and step.reduction_least > 0.5 * step.reduction
    assert 0.03 < step.share < 1.0
    assert step.error_after < 0.5 * step.error_before
    assert report.table.loc["baseline", "held-out"] == step.error_before


def test_steps_and_reports_are_facts_that_nobody_changes():
    report = close_loop(record(cubic, seed=5), catalogue=FEWER_SENSORS, max_steps=1)
    with pytest.raises(FrozenInstanceError):
        report.steps[0].sure = True
    with pytest.raises(FrozenInstanceError):
        report.stopped_because = ""


@pytest.mark.slow
def test_nothing_is_added_where_nothing_is_missing_at_ten_percent_noise():
    report = close_loop(record(None, dofs=(1, 2, 3), seed=7, noise=0.1))
    assert report.steps == [] and len(report.table) == 1


def test_the_size_of_a_spring_that_is_found():
    parameters = first_step(cubic, seed=5).parameters
    assert parameters["k3"] == pytest.approx(1.2e9, rel=1e-3)


def test_the_size_of_a_brace_that_is_found():
    parameters = first_step(brace, seed=5).parameters
    assert parameters["k"] == pytest.approx(9e3, rel=1e-3)
    assert parameters["c"] == pytest.approx(8.0, rel=1e-2)


def test_a_change_in_time_is_dated():
    """To within a held-out piece, if it falls into one."""
    tried = [laws.StiffnessStep(), laws.StiffnessDrift()]
    step = first_step(loss_of_stiffness, tried, seed=3, noise=0.01, n_samples=3000)
    assert (step.law, step.site) == ("stiffness_step", "storey 2")
    assert step.parameters["dk"] == pytest.approx(-9e3, rel=0.03)
    assert step.parameters["t0"] == pytest.approx(2.2, abs=0.15)


@pytest.mark.slow
def test_intervals_of_a_brace_hold_the_truth():
    tried = [laws.LinkSpringDashpot(), laws.CubicStiffness()]
    step = first_step(brace, tried, seed=5, noise=0.02, n_samples=3000)
    for name, truth, width in (("k", 9e3, 0.1), ("c", 8.0, 1.5)):
        low, high = step.intervals[name]
        assert low <= truth <= high
        assert high - low < width * truth


@pytest.mark.slow
def test_intervals_of_a_gap_hold_the_truth():
    tried = [laws.TwoSidedGap()]
    step = first_step(gap, tried, seed=5, noise=0.01, n_samples=3000)
    assert step.intervals["gap"][0] <= 2e-3 <= step.intervals["gap"][1] < 2.2e-3
    assert step.intervals["k"][0] <= 4e4 <= step.intervals["k"][1]


# -- how sure a name is --------------------------------------------------------


def test_an_effect_that_is_not_in_the_catalogue_gets_no_sure_name():
    others = [
        laws.CoulombFriction(),
        laws.QuadraticDamping(),
        laws.Dahl(),
        laws.StiffnessDrift(),
        laws.ConstantForce(),
    ]
    rec = record(brace, seed=3, noise=0.01)
    for step in close_loop(rec, catalogue=others, max_steps=2).steps:
        assert not step.sure
        assert "unexplained remainder" in step.sentence


def test_a_general_law_carries_what_no_name_of_the_catalogue_is():
    """Of a damping with a power of the rate a regularised friction leaves a part."""
    rec = record(power_damping, seed=3)
    report = close_loop(rec, catalogue=[laws.RegularizedFriction()])
    step = report.steps[0]
    assert (step.effect_class, step.site) == ("memoryless", "storey 2")
    assert step.confirmed and not step.carries and not step.sure
    assert step.closest == "regularized_friction" and 0.0 < step.closest_share < 1.0


def test_a_name_is_sure_that_another_record_has_judged():
    """Another amplitude of the same test says that the effect is there, no more."""
    tried = [laws.RegularizedFriction()]
    searched = record(friction_above, seed=5)
    by_itself = close_loop(searched, catalogue=tried).steps[0]
    assert by_itself.site == "storey 3" and by_itself.confirmed
    assert by_itself.judged_by == "another amplitude" and not by_itself.sure

    other = record(friction_above, seed=6, name="other")
    (step,) = close_loop(searched, catalogue=tried, heldout=other).steps
    assert (step.law, step.judged_by) == ("regularized_friction", "another record")
    assert step.confirmed and step.sure


def quadratic_damping(t, x, v):
    rate = v[1] - v[0]
    return on_storey_2(300.0 * rate * abs(rate))


def first_name(effect, catalogue, noise):
    """The first step of a search that another record judges."""
    searched = record(effect, seed=3, noise=noise)
    other = record(effect, seed=4, noise=noise, name="other")
    report = close_loop(searched, catalogue=catalogue, heldout=other, max_steps=1)
    return report.steps[0]


@pytest.mark.slow
def test_a_name_is_not_sure_beside_another_that_is_nearly_as_good():
    """Noise in the rate rounds friction: a low power of the rate is rounded, too."""
    alike = [laws.RegularizedFriction(), laws.PowerLawDamping()]
    step = first_name(friction_above, alike, noise=0.1)
    assert step.law == "regularized_friction"
    assert step.confirmed and step.carries and not step.sure
    assert [rival[:2] for rival in step.rivals] == [("power_law_damping", "storey 3")]


def test_a_name_is_sure_where_a_law_that_contains_it_gains_nothing():
    both = [laws.QuadraticDamping(), laws.PowerLawDamping()]
    step = first_name(quadratic_damping, both, noise=0.002)
    assert (step.law, step.sure, step.rivals) == ("quadratic_damping", True, [])


# -- arguments -----------------------------------------------------------------


def test_the_loop_leaves_the_record_and_the_baseline_as_they_were():
    rec, baseline = record(cubic, seed=1), NRFRegressor(degree=1)
    before = {name: channel.copy() for name, channel in rec.channels().items()}
    close_loop(rec, baseline, FEWER_SENSORS)
    for name, channel in rec.channels().items():
        assert np.array_equal(before[name], channel)
    assert not hasattr(baseline, "model_")


def test_records_that_are_none_are_named():
    with pytest.raises(ChannelError, match="not a Record"):
        close_loop(np.zeros((100, 3)))


def test_laws_that_are_none_are_named():
    with pytest.raises(LawError, match="not a force law"):
        close_loop(record(n_samples=600), catalogue=["friction"])


def test_a_chain_that_nothing_scales_is_named():
    with pytest.raises(ValueError, match="nothing scales the chain"):
        close_loop(record(n_samples=600).replace(force=np.zeros((600, 3))))


def test_a_dead_sensor_is_named_at_the_line_of_the_user():
    force = np.random.default_rng(0).standard_normal((1000, 1))
    still = Record(force=force, velocity=np.zeros((1000, 1)), fs=100.0)
    with pytest.warns(DataQualityWarning, match="v1 is constant") as caught:
        with pytest.raises(ChannelError, match="Nothing moves"):
            close_loop(still)
    assert {warning.filename for warning in caught} == {__file__}


def without_floor_2(rec):
    """A record in which the second floor has no sensor."""
    channels = {}
    for key in ("acceleration", "velocity", "displacement"):
        channels[key] = getattr(rec, key).copy()
        channels[key][:, 1] = np.nan
    return rec.replace(**channels)


def test_an_unknown_error_of_the_channels_is_refused():
    with pytest.raises(ChannelError, match="'nonsense'"):
        close_loop(record(n_samples=600), calibration={"nonsense": 0.1})


def test_errors_of_channels_have_no_part_in_a_search_with_fewer_sensors():
    with pytest.raises(ChainError, match="calibration"):
        close_loop(without_floor_2(record(n_samples=600)), calibration={"gain": 0.1})


@pytest.mark.parametrize("every_floor_is_measured", [True, False])
def test_progress_is_called_for_every_candidate(every_floor_is_measured):
    rec, calls = record(dofs=(1, 2, 3), seed=2, n_samples=2000), []
    if not every_floor_is_measured:
        rec = without_floor_2(rec)
    tried = [laws.CoulombFriction()]
    close_loop(rec, catalogue=tried, max_steps=1, progress=lambda: calls.append(1))
    assert len(calls) >= 3


def test_a_covariate_that_a_heldout_record_lacks_is_named_before_the_search():
    rec = record(friction, seed=3)
    with_u = rec.replace(covariates={"u": np.linspace(0, 1, 3500)})
    modulated = laws.CovariateFriction(covariate="u")
    baseline = NRFRegressor(laws={2: [laws.PowerSeries(1), modulated]}, degree=1)
    what = "Record 'later' has no covariate 'u', which covariate_friction"
    with pytest.raises(ChannelError, match=what):
        close_loop(with_u, baseline, FEWER_SENSORS, heldout=rec.replace(name="later"))


@pytest.mark.parametrize(
    "setting",
    [
        {"estimation": "ls"},
        {"strategy": "sequential"},
        {"optimizer": ps.STLSQ()},
        {"constraints": {"m1 + m2": Parameter(20.0)}},
    ],
    ids=lambda setting: next(iter(setting)),
)
def test_a_setting_of_balances_is_refused_by_name_where_a_floor_has_no_sensor(setting):
    rec = without_floor_2(record(cubic, seed=1))
    baseline = NRFRegressor(degree=1, **setting)
    with pytest.raises(ChainError, match=next(iter(setting))):
        close_loop(rec, baseline, FEWER_SENSORS, max_steps=0)


@pytest.mark.parametrize("estimation", ["ls", "iv"])
def test_the_final_estimate_is_made_as_the_baseline_says(estimation):
    baseline = NRFRegressor(degree=1, estimation=estimation)
    tried = [laws.CubicStiffness()]
    report = close_loop(record(cubic, seed=1), baseline, tried, max_steps=1)
    assert report.identified.method == estimation


# -- held-out data have the last word ------------------------------------------


def test_an_effect_that_heldout_data_do_not_show_is_not_confirmed():
    other = record(None, seed=2, name="other")
    rec = record(cubic, seed=1)
    report = close_loop(rec, catalogue=FEWER_SENSORS, heldout=other, max_steps=1)
    (step,) = report.steps
    assert (step.law, step.site) == ("cubic_stiffness", "storey 2")
    assert not step.confirmed and not step.sure
    assert step.error_after >= step.error_before
    assert "NOT CONFIRMED" in str(report) and "NOT CONFIRMED" in report.to_markdown()


def test_the_model_does_not_hold_what_is_not_confirmed():
    other = record(None, seed=2, name="other")
    rec = record(cubic, seed=1)
    report = close_loop(rec, catalogue=FEWER_SENSORS, heldout=other, max_steps=1)
    names = [law.name for law in report.model.laws[Site("storey 2")]]
    assert names == ["power_series"]
    assert report.model.info["steps"] == []
    assert len(report.models) == len(report.table) == 2


@pytest.fixture(scope="module")
def frame_with_friction():
    """Two floors with a friction of 13 N, 3 % of the force of storey 2."""
    storey = laws.PowerSeries(1, [600.0, 2e5])
    truth = ChainModel(
        [12.0, 10.0], {1: storey, 2: [storey, laws.CoulombFriction(13.0)]}
    )
    F = excitation.band_limited_random(
        2, 20.0, 200.0, excited=[1, 2], rms=100.0, band=(0.5, 40), random_state=1
    )
    return simulate(truth, F, 1 / 200)


def test_friction_of_a_few_percent_is_found_in_ten_percent_of_noise(
    frame_with_friction,
):
    tried = [
        laws.CoulombFriction(),
        laws.RegularizedFriction(),
        laws.CubicStiffness(),
    ]
    noisy = add_noise(frame_with_friction, 0.1, random_state=[1, 1])
    (step,) = close_loop(noisy, catalogue=tried).steps
    assert (step.family, step.site) == ("friction", "storey 2")
    assert step.effect_class == "memoryless" and step.confirmed
    assert step.error_after < step.error_before


def test_what_the_heldout_record_lacks_is_not_in_the_model():
    """Of two effects in storey 2 the held-out record has one."""
    every = (1, 2, 3)
    heldout = record(weak_cubic, dofs=every, seed=9, name="other")
    rec = record(weak_cubic_and_damping, dofs=every, seed=2)
    report = close_loop(rec, catalogue=FEWER_SENSORS, heldout=heldout, max_steps=2)
    confirmed = [step.law for step in report.steps if step.confirmed]
    assert confirmed == ["cubic_stiffness"]

    names = set()
    for at_site in report.model.laws.values():
        names |= {law.name for law in at_site}
    assert names == {"power_series", "cubic_stiffness"}


@pytest.mark.slow
def test_the_visited_region_is_that_of_the_search():
    """The held-out record is stronger: a force there is an extrapolation."""
    small, strong = record(cubic, seed=1), record(None, seed=2, name="other")
    strong = strong.replace(displacement=4 * strong.displacement)
    report = close_loop(small, catalogue=FEWER_SENSORS, heldout=strong, max_steps=1)
    drift = np.diff(small.displacement, axis=1)[:, 0]
    region = report.model.visited[Site("storey 2")]
    assert region.high[1] <= 1.01 * drift.max()
    assert not region.contains(np.zeros(1), np.array([4 * drift.max()]))[0]


# -- no claim where there is none to make --------------------------------------


def test_masses_below_zero_are_no_finding():
    rec = record(cubic, seed=1)
    report = close_loop(rec.replace(force=-rec.force), catalogue=FEWER_SENSORS)
    assert report.steps == [] and len(report.table) == 1
    assert "masses came out not positive (m1 = -" in report.stopped_because
    assert report.nothing_claimed


def test_a_balance_of_which_nothing_is_explained_is_no_finding():
    other = random_forces(3500, (1, 2, 3), seed=77)
    report = close_loop(
        record(cubic, seed=1).replace(force=other), catalogue=FEWER_SENSORS
    )
    assert report.steps == [] and report.nothing_claimed
    why = report.stopped_because
    assert "% of the balance of DOF" in why or "not positive" in why


# -- bands ---------------------------------------------------------------------


@pytest.fixture(scope="module")
def driven_to_25_hz():
    """The chain with a cubic spring, driven up to 25 Hz: nothing is heard far above."""
    storeys = {}
    for i, (k, c) in enumerate(zip(K, C), 1):
        storeys[i] = [laws.LinearElastic(k), laws.LinearViscous(c)]
    storeys[2].append(laws.CubicStiffness(1.2e9))
    F = excitation.band_limited_random(
        3, 40.0, 200.0, excited=3, rms=60.0, band=(0.5, 25.0), random_state=1
    )
    run = simulate(ChainModel(M, storeys), F, 1 / 200)
    return add_noise(run, 0.02, random_state=2)


def test_bands_are_found_where_the_chain_moves(driven_to_25_hz):
    report = close_loop(driven_to_25_hz, catalogue=FEWER_SENSORS, max_steps=1)
    low, high = report.band
    assert (low or 0.0) <= 2.0
    assert 15.0 < high < 60.0
    assert report.table["band"].iloc[0].endswith("Hz")
    assert report.steps[0].law == "cubic_stiffness"


def test_a_band_that_is_given_only_narrows_it(driven_to_25_hz):
    report = close_loop(
        driven_to_25_hz, catalogue=FEWER_SENSORS, max_steps=1, band=(3.0, 12.0)
    )
    low, high = report.band
    assert 3.0 <= low <= 4.0
    assert 10.0 < high <= 12.01
    assert report.settings["loop"]["band"] == "3 to 12 Hz"
    assert report.steps[0].site == "storey 2"


# -- an element without mass and without a clock -------------------------------


@pytest.fixture(scope="module")
def slow_slider():
    """A slider on a spring, moved slowly."""
    path = np.linspace(0.0, 150.0, 6000)
    x = 0.01 * np.sin(path) * np.abs(np.sin(np.linspace(0.1, 9.0, 6000)))
    slider = np.zeros(len(x))
    for i, step in enumerate(np.diff(x, prepend=0.0)):
        slider[i] = np.clip(slider[i - 1] + step, -0.002, 0.002)
    noise = 2.0 * np.random.default_rng(3).standard_normal(len(x))
    force = 3e4 * x + 2e5 * slider + noise
    return close_loop(Record(force=force[:, None], displacement=x[:, None]))


def test_an_element_without_a_clock_is_found_along_its_path(slow_slider):
    (step,) = slow_slider.steps
    assert (step.law, step.site) == ("jenkins", "storey 1") and step.confirmed
    assert step.parameters["Fy"] == pytest.approx(400.0, rel=0.02)
    assert step.shape["uy"] == pytest.approx(2e-3, rel=0.05)


def test_an_element_without_mass_is_no_fault(slow_slider):
    """It has no free run."""
    assert slow_slider.model.masses == pytest.approx([0.0])
    assert slow_slider.verdict.state != "red"


def test_no_law_of_the_rate_is_tried_without_a_clock(slow_slider):
    tried = set(slow_slider.candidates["law"])
    assert not {"maxwell_branch", "quadratic_damping"} & tried
