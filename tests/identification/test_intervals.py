"""Intervals: as wide as theory says where theory is exact, and honest where residuals
are coloured.
"""

import pickle
import warnings

import numpy as np
import pytest
from chains import driven
from scipy import stats
from scipy.signal import lfilter
from sklearn.base import clone

from pysindy_nrf import ChainModel, NRFRegressor, excitation, laws, simulate
from pysindy_nrf.exceptions import (
    BiasWarning,
    ChainError,
    ChannelError,
    ExtrapolationWarning,
    IdentifiabilityError,
)
from pysindy_nrf.identification import dissipated_energy
from pysindy_nrf.identification.intervals import newey_west
from pysindy_nrf.simulation.noise import add_noise

TRUE = np.array([10.0, 30.0, 2000.0])


def oscillator(rng, n=1500, colour=0.0):
    """One mass with clean motion; noise in the force, white or coloured."""
    X = rng.normal(size=(n, 3)) * [5.0, 0.5, 0.01]
    if colour:
        X = lfilter([1.0], [1.0, -colour], X, axis=0)
    noise = lfilter([1.0], [1.0, -colour], rng.normal(size=n))
    return X, (X @ TRUE + 4.0 * noise)[:, None]


def inside(X, F) -> np.ndarray:
    ci = NRFRegressor(degree=1).fit(X, F).confidence_intervals(0.95)
    return ((ci["lower"] <= TRUE) & (TRUE <= ci["upper"])).to_numpy()


@pytest.mark.parametrize("colour", [0.0, 0.9], ids=["white", "coloured"])
def test_ninety_five_percent_hold_the_truth(colour):
    rng = np.random.default_rng(0)
    held = np.mean([inside(*oscillator(rng, 1500, colour)) for _ in range(40)])
    assert held == pytest.approx(0.95, abs=4 * (0.95 * 0.05 / 120) ** 0.5)


def test_white_residuals_give_the_textbook_width():
    X, F = oscillator(np.random.default_rng(1), 6000)
    ci = NRFRegressor(degree=1).fit(X, F).confidence_intervals(0.9)
    theory = 4.0 * np.sqrt(np.diag(np.linalg.inv(X.T @ X))) * stats.norm.ppf(0.95)
    np.testing.assert_allclose((ci["upper"] - ci["lower"]) / 2, theory, rtol=0.35)


def test_newey_west_sums_the_autocovariances_of_a_moving_average():
    e = np.random.default_rng(0).normal(size=200_001)
    u = (e[1:] + 0.5 * e[:-1])[:, None]  # long-run variance (1 + 0.5)^2
    assert newey_west(u, lags=30)[0, 0] / len(u) == pytest.approx(2.25, rel=0.05)
    assert newey_west(u, lags=0)[0, 0] / len(u) == pytest.approx(1.25, rel=0.05)


def _force():
    return excitation.band_limited_random(
        3, 8.0, 500.0, excited=[3], rms=100.0, band=(0.5, 50.0), random_state=0
    )


@pytest.fixture(scope="module")
def fitted():
    storey = laws.PowerSeries(1, [60.0, 1e5])
    truth = ChainModel([10.0, 11.0, 12.0], {f"storey {i}": storey for i in (1, 2, 3)})
    X, F = simulate(truth, _force(), 1 / 500.0).to_features(smooth=False)
    F = F + 5.0 * np.random.default_rng(1).normal(size=F.shape) * [0, 0, 1]
    return truth, NRFRegressor(degree=1, dt=1 / 500.0).fit(X, F)


def test_an_error_of_the_top_storey_reaches_the_lowest_mass(fitted):
    """Balances 2 and 1 hold exactly: all of m1's uncertainty comes from R_3, as the
    ratio m1/m3 shows.
    """
    _, model = fitted
    ci = model.confidence_intervals().set_index("parameter")
    share = (ci["upper"] - ci["lower"]) / ci["estimate"]
    assert share["m1"] == pytest.approx(share["m2"], rel=0.05)
    assert share["m1"] > 1e-3
    ratio = model.confidence_intervals(
        of=lambda m: {"m1/k2": m.masses[0] / m.restoring_forces[2].linear_part()["k"]}
    )
    assert (ratio["upper"] - ratio["lower"]).item() / ratio[
        "estimate"
    ].item() < 0.1 * share["m1"]


def test_intervals_of_modes_hold_the_truth(fitted):
    truth, model = fitted
    modes = model.confidence_intervals(of="modes")
    assert list(modes.columns) == ["parameter", "estimate", "lower", "upper"]
    true = truth.modes()["frequency"].to_numpy()
    assert (
        (modes["lower"][:3] <= true + 1e-9) & (true <= modes["upper"][:3] + 1e-9)
    ).all()


def test_energies_and_forces_can_be_asked_directly(fitted):
    truth, model = fitted
    X = simulate(truth, _force(), 1 / 500.0).to_features(smooth=False)[0]
    true = dissipated_energy(truth, X).iloc[-1].to_numpy()
    energies = model.confidence_intervals(of="energies")
    assert energies["parameter"].tolist() == [
        f"energy of storey {i}" for i in (1, 2, 3)
    ]
    np.testing.assert_allclose(
        energies["estimate"], dissipated_energy(model, X).iloc[-1], rtol=1e-6
    )
    wide = 2 * (
        energies["upper"] - energies["lower"]
    )  # all three follow one noisy force: twice the width
    assert (np.abs(energies["estimate"] - true) < wide).all()
    forces = model.confidence_intervals(
        of={"storey 2": (0.0, [1e-3, 2e-3]), 3: (0.1, 0.0)}
    )
    assert forces["parameter"].tolist()[2] == "storey 3 at v = 0.1 m/s, s = 0 m"
    np.testing.assert_allclose(forces["estimate"], [100.0, 200.0, 6.0], rtol=0.05)
    half = (forces["upper"] - forces["lower"]) / 2
    assert half[1] == pytest.approx(
        2 * half[0], rel=1e-6
    )  # a linear law: as the drift, so its uncertainty
    masses = model.confidence_intervals(of="masses")
    assert masses["parameter"].tolist() == ["m1", "m2", "m3"]
    with pytest.raises(ChainError, match="pair"):
        model.confidence_intervals(of={2: 0.1})


def test_a_force_outside_the_visited_region_is_marked(fitted):
    truth, model = fitted
    v_s = model.model_.visited["storey 2"]
    here = model.force_intervals("storey 2", 0.0, 0.5 * v_s.high[1])
    true = truth.restoring_forces[2](0.0, 0.5 * v_s.high[1])
    assert (
        here["visited"].all() and here["lower"].item() <= true <= here["upper"].item()
    )
    with pytest.warns(ExtrapolationWarning, match="storey 2: 1 of 2 points"):
        both = model.force_intervals(
            2, [0.0, 0.0], [0.5 * v_s.high[1], 3 * v_s.high[1]]
        )
    assert both["visited"].tolist() == [True, False]
    width = both["upper"] - both["lower"]
    assert (
        width[1]
        > 2 * (both["force"][1] - truth.restoring_forces[2](0.0, v_s.high[1]))
        > 20 * width[0]
    )


def test_known_masses_have_no_interval_and_bad_questions_no_answer(fitted):
    _, model = fitted
    X, F = oscillator(np.random.default_rng(0))
    known = NRFRegressor(degree=1, known_masses={1: 10.0}).fit(X, F)
    assert known.confidence_intervals()["parameter"].tolist() == [
        "storey 1: v",
        "storey 1: s",
    ]
    with pytest.raises(ChainError):
        model.confidence_intervals(of="weights")
    for level in ("high", 95, 0.0):
        with pytest.raises(
            ChainError, match=f"level={level!r} is not a level of confidence"
        ):
            model.confidence_intervals(level)
    with pytest.raises(
        ChannelError, match="pieces of data are too few for an interval"
    ):
        NRFRegressor(degree=1).fit(X[:7], F[:7]).confidence_intervals()


def test_intervals_that_were_asked_for_survive_saving(fitted):
    _, model = fitted
    ci = model.confidence_intervals()
    assert pickle.loads(pickle.dumps(model)).confidence_intervals().equals(ci)
    X, F = oscillator(np.random.default_rng(0))
    fresh = pickle.loads(pickle.dumps(NRFRegressor(degree=1).fit(X, F)))
    with pytest.raises(ChannelError, match="without the data"):
        fresh.confidence_intervals()


@pytest.mark.slow
def test_default_intervals_of_noisy_records_say_how_far_they_may_be_off():
    """Errors over half the interval's width are standard normal; of eight records their
    rms is below 1.7 in 99.9 %.
    """
    storey = laws.PowerSeries(1, [60.0, 5e4])
    truth = ChainModel([10.0, 10.0, 10.0], {f"storey {i}": storey for i in (1, 2, 3)})
    z = []
    for seed in range(8):
        record = add_noise(
            driven(
                truth, [3], 16.0, 500.0, 100.0, (0.5, 40.0), seed=seed, hold="cubic"
            ),
            0.02,
            random_state=seed,
        )
        ci = NRFRegressor(degree=1).fit(record).confidence_intervals()
        true = np.where(
            ci["parameter"].str.startswith("m"),
            10.0,
            np.where(ci["parameter"].str.endswith("v"), 60.0, 5e4),
        )
        z.append((ci["estimate"] - true) / ((ci["upper"] - ci["lower"]) / 3.92))
    assert np.sqrt(np.mean(np.square(z), axis=0)).max() < 1.7


def test_intervals_of_coefficients_and_of_energies_without_a_clock_or_the_data(fitted):
    _, model = fitted
    whole, part = (
        model.confidence_intervals(),
        model.confidence_intervals(of="coefficients"),
    )
    assert list(part["parameter"]) == [p for p in whole["parameter"] if ":" in p]
    with pytest.raises(ChannelError, match="Energies need the sampling step"):
        NRFRegressor(degree=1).fit(
            *oscillator(np.random.default_rng(0))
        ).confidence_intervals(of="energies")
    with pytest.raises(ChannelError, match="before saving the model"):
        pickle.loads(pickle.dumps(model)).confidence_intervals(of="energies")


def test_a_single_blow_carries_the_whole_estimate():
    """All that excites storey 2 lies in one piece: without it nothing can be solved,
    and no interval is invented.
    """
    F = np.zeros((6000, 2))
    F[3000:3010, 1] = 500 * np.sin(np.pi * np.arange(10) / 9)
    damped = ChainModel(
        [10.0, 12.0], {f"storey {i}": [laws.PowerSeries(1, [4e3, 1e5])] for i in (1, 2)}
    )
    model = NRFRegressor(degree=1).fit(simulate(damped, F, 1 / 500.0))
    with pytest.raises(
        IdentifiabilityError, match="A single part of the data determines the estimate"
    ):
        model.confidence_intervals()
    assert "No interval can be given: A single part of the data" in " ".join(
        str(model.diagnose()).split()
    )


def cubic_frame(noise, seed):
    """Three floors, floor 1 forced, storey 2 cubic, with noise on every channel; the
    estimator is told the laws.
    """
    soft = [laws.PowerSeries((0, 3), [3.5e4, 0.0, 3e9]), laws.LinearViscous(20.0)]
    stiff = [laws.LinearElastic(4e4), laws.LinearViscous(25.0)]
    truth = ChainModel([12.0, 10.0, 8.0], {1: stiff, 2: soft, 3: stiff})
    F = excitation.band_limited_random(
        3, 8.0, 500.0, excited=[1], rms=100.0, band=(0.5, 30.0), random_state=[seed, 3]
    )
    return add_noise(
        simulate(truth, F, 2e-3, hold="cubic"), noise, random_state=[seed, 4]
    ).replace(velocity=None)


TOLD = {
    "degree": 1,
    "laws": {"storey 2": [laws.PowerSeries((0, 3)), laws.LinearViscous()]},
}


@pytest.mark.parametrize(("noise", "found"), [(1e-5, "ls"), (0.05, "iv")])
def test_the_default_takes_instruments_where_noise_would_bias_least_squares_and_its_intervals_hold(
    noise, found
):
    model = NRFRegressor(**TOLD).fit(cubic_frame(noise, 0))
    assert (
        model.model_.info["estimation"]["found"] == found
        and clone(model).get_params()["estimation"] == "auto"
    )
    ci = model.confidence_intervals(0.999).set_index("parameter")
    for name, true in {
        "m1": 12.0,
        "m2": 10.0,
        "m3": 8.0,
        "storey 1: s": 4e4,
        "storey 2: s^3": 3e9,
    }.items():
        assert ci.loc[name, "lower"] < true < ci.loc[name, "upper"]


def test_noise_of_the_force_biases_nothing_where_the_free_run_loses_the_motion():
    """A hardening chain leaves its free run within seconds; a noisy force as instrument
    of itself adds 4 % to a mass.
    """
    off = []
    for seed in range(4):
        rec = cubic_frame(0.005, seed)
        loud = [20.0, 0.0, 0.0] * np.random.default_rng([seed, 9]).standard_normal(
            (rec.n_samples, 1)
        )
        model = NRFRegressor(**TOLD, estimation="iv").fit(
            rec.replace(force=rec.force + loud)
        )
        assert model.model_.info["estimation"]["found"] == "iv"
        off.append(model.masses_ / [12.0, 10.0, 8.0] - 1)
    assert np.abs(np.mean(off, axis=0)).max() < 0.01


def test_intervals_of_biased_least_squares_are_withheld_with_the_reason():
    rec = cubic_frame(0.05, 0)
    unknown = rec.replace(
        force=np.where([False, False, True], np.nan, rec.force)
    )  # no free run without F3
    with warnings.catch_warnings(action="ignore"):
        models = [
            NRFRegressor(**TOLD, estimation="ls").fit(rec),
            NRFRegressor(**TOLD, known_masses={3: 8.0}).fit(unknown),
        ]
    for model in models:
        with pytest.warns(BiasWarning, match="withheld: noise in the motion may bias"):
            ci = model.confidence_intervals()
        assert (
            ci[["lower", "upper"]].isna().all(axis=None)
            and ci["estimate"].notna().all()
        )
        assert "withheld" in str(model.diagnose())
    with pytest.warns(BiasWarning, match="a free run needs all forces"):
        model.confidence_intervals()


def test_where_no_noise_is_left_intervals_hold_the_error_of_interpolation():
    ci = (
        NRFRegressor(**TOLD)
        .fit(cubic_frame(0.0, 0))
        .confidence_intervals()
        .set_index("parameter")
    )
    for name, true in {"m1": 12.0, "m2": 10.0, "m3": 8.0, "storey 2: s^3": 3e9}.items():
        assert ci.loc[name, "lower"] < true < ci.loc[name, "upper"]
        assert ci.loc[name, "upper"] - ci.loc[name, "lower"] < 5e-3 * true


def test_tolerances_of_gains_widen_intervals_as_much_as_gains_move_the_estimate():
    """One mass: m = F / a and k = F / x, so two gains of +-1 %, rectangular, make
    sqrt(2/3) % of each.
    """
    truth = ChainModel([5.0], {1: [laws.LinearElastic(2e4), laws.LinearViscous(20.0)]})
    F = excitation.band_limited_random(
        1, 8.0, 500.0, excited=[1], rms=100.0, band=(0.5, 30.0), random_state=0
    )
    model = NRFRegressor(degree=1).fit(
        simulate(truth, F, 2e-3, hold="cubic").replace(velocity=None)
    )
    ci = model.confidence_intervals(0.95, calibration={"gain": 0.01}).set_index(
        "parameter"
    )
    half = (ci["combined_upper"] - ci["combined_lower"]) / 2 / ci["estimate"]
    np.testing.assert_allclose(
        half[["m1", "storey 1: s"]], 1.96 * 0.01 * (2 / 3) ** 0.5, rtol=0.02
    )
    late = model.confidence_intervals(
        calibration={"gain": 0.0, "delay": 1e-3}
    ).set_index("parameter")
    moved = (late["combined_upper"] - late["combined_lower"]) / 2
    assert (
        moved["storey 1: v"] > 1.96 * 1e-3 * 2e4 / 3**0.5
    )  # a force that is 1 ms late looks like k dt of damping
    with pytest.raises(ChannelError, match="not a tolerance"):
        model.confidence_intervals(calibration={"gains": 0.01})
