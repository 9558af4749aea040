"""Fewer sensors than floors: masses and laws from the free run that fits the channels
that there are.
"""

import numpy as np
import pandas as pd
import pytest
from chains import driven, worst

from pysindy_nrf import (
    Chain,
    ChainModel,
    NRFRegressor,
    Record,
    close_loop,
    excitation,
    laws,
    simulate,
)
from pysindy_nrf.chain.layout import LawLayout
from pysindy_nrf.equations.errors import nrmse
from pysindy_nrf.exceptions import (
    BiasWarning,
    ChannelError,
    ExcitationError,
    IdentifiabilityError,
)
from pysindy_nrf.identification.constraints import EqualStoreys, KnownStiffness, Prior
from pysindy_nrf.identification.fewer_sensors import shot_of
from pysindy_nrf.identification.output_error import FreeRunFit, free_parameters
from pysindy_nrf.simulation.noise import add_noise

FS = 250.0
MASSES, SPRINGS = (
    np.array([14.0, 11.0, 9.0, 12.0]),
    np.array([1.6e5, 1.2e5, 1.8e5, 1.4e5]),
)
TRUTH = ChainModel(
    MASSES, {i: laws.PowerSeries(1, [25.0, SPRINGS[i - 1]]) for i in range(1, 5)}
)


def seen(record, floors, kinds="a") -> Record:
    """The record with sensors on some floors only."""
    motion = {
        {"a": "acceleration", "x": "displacement"}[kind]: np.where(
            np.isin(np.arange(1, record.n_dof + 1), floors), y, np.nan
        )
        for kind, y in (("a", record.acceleration), ("x", record.displacement))
        if kind in kinds
    }
    return Record(
        force=record.force,
        fs=record.fs,
        base_acceleration=record.base_acceleration,
        **motion,
    )


def parameters(model) -> np.ndarray:
    """Masses and stiffnesses."""
    return np.array(
        [
            *model.masses,
            *(force.linear_part()["k"] for force in model.restoring_forces.values()),
        ]
    )


@pytest.fixture(scope="module")
def exact():
    return driven(TRUTH, [4], 8.0, FS, 100.0, (0.5, 50.0), seed=1)


@pytest.mark.parametrize(
    "floors", [[4], [2, 3]], ids=["at the force alone", "away from the force"]
)
def test_without_noise_masses_and_stiffnesses_are_exact(exact, floors):
    model = NRFRegressor(degree=1).fit(seen(exact, floors))
    assert worst(parameters(model.model_), parameters(TRUTH)) < 1e-6


@pytest.fixture(scope="module")
def fitted(exact):
    return NRFRegressor(degree=1).fit(
        seen(add_noise(exact, 0.02, random_state=3), [2, 4])
    )


def test_the_absent_motions_and_storey_forces_come_with_intervals(exact, fitted):
    """Two of four floors, 2 % noise: what the others would have read, to a percent, and
    how sure it is.
    """
    assert worst(parameters(fitted.model_), parameters(TRUTH)) < 0.02
    table = fitted.motions_[0]
    forces = TRUTH.restoring_force(exact.to_features(smooth=False)[0])
    for name, true in (
        ("a1", exact.acceleration[:, 0]),
        ("x3", exact.displacement[:, 2]),
        ("R storey 3", forces[:, 2]),
    ):
        assert nrmse(true, table[name]) < 2.0
        half = (table[f"{name}_upper"] - table[f"{name}_lower"]) / 2
        share = np.sqrt(np.mean((table[name] - true) ** 2) / np.mean(half**2))
        assert 0.2 < share < 0.8  # of 95 % intervals: a standard error is 0.51 of them


def test_of_a_frame_that_is_no_chain_the_measured_channels_still_tell_the_hidden_motion(
    exact,
):
    """A brace that the model lacks: its free run misses much, the channels tell most of
    that, and the user is told.
    """
    braced = ChainModel(
        MASSES, {**TRUTH.laws, "ground 3": laws.LinkSpringDashpot(1e4, 0.0)}
    )
    true = driven(braced, [4], 8.0, FS, 100.0, (0.5, 50.0), seed=1)
    record = seen(add_noise(true, 0.005, random_state=3), [2, 3, 4])
    with pytest.warns(BiasWarning, match="beyond its noise"):
        model = NRFRegressor(degree=1, known_masses=dict(enumerate(MASSES, 1))).fit(
            record
        )
    alone = simulate(model.model_, true.force, 1 / FS).acceleration[:, 0]
    table, y = model.motions_[0], true.acceleration[:, 0]
    assert nrmse(y, table["a1"]) < 0.5 * nrmse(y, alone)
    assert np.mean((table["a1_lower"] <= y) & (y <= table["a1_upper"])) > 0.8


def test_intervals_hold_the_truth(fitted):
    ci = fitted.confidence_intervals().set_index("parameter")
    true = {
        **{f"m{j}": m for j, m in enumerate(MASSES, 1)},
        **{f"storey {i}: s": k for i, k in enumerate(SPRINGS, 1)},
    }
    assert (
        sum(ci.lower[name] <= value <= ci.upper[name] for name, value in true.items())
        >= 6
    )
    assert (
        fitted.errors_.loc[["dof 2", "dof 4"], "error"].between(1.5, 3.0).all()
    )  # what is left is the noise
    assert (
        1.5 < fitted.free_runs().error < 3.0
        and "free run predicts the motion to 2" in str(fitted.verdict())
    )


def test_what_cannot_be_told_is_refused(exact):
    blind = Chain(4).sensing(sensors=2, excited=3)
    assert (blind.rank, blind.unknowns, blind.complete) == (
        7,
        8,
        False,
    ) and "cannot be told apart" in str(blind)
    with pytest.raises(ExcitationError, match="nothing scales the chain"):
        NRFRegressor(degree=1).fit(
            Record(acceleration=seen(exact, [4]).acceleration, fs=FS)
        )
    force = exact.force.copy()
    force[:, 2] = np.nan
    with pytest.raises(ChannelError, match="force on DOF 3 .* unknown"):
        NRFRegressor(degree=1).fit(seen(exact, [4]).replace(force=force))
    with pytest.raises(IdentifiabilityError, match="do not determine (m|storey)"):
        NRFRegressor(degree=1).fit(
            seen(add_noise(exact.window(0, 0.6), 0.5, random_state=1), [4])
        )


@pytest.mark.parametrize("end", [1, 4])
def test_a_forced_end_tells_the_whole_chain_and_one_more_sensor_what_it_brings(end):
    """Hochstadt: the response at a forced end has all masses and stiffnesses; another
    sensor never makes them worse.
    """
    alone = Chain(4).sensing(sensors=end, excited=end)
    assert (
        alone.complete
        and min(alone.errors.values()) > 0.999
        and min(alone.gains.values()) >= 1
    )
    floor = max(alone.gains, key=alone.gains.get)
    assert f"helps most on floor {floor}" in str(alone)
    assert Chain(4).sensing([end, floor], end).errors["m2"] <= alone.errors["m2"]


def test_of_a_shaken_chain_a_sensor_on_top_tells_its_frequencies_alone():
    """The response of the top to the base has poles and no zeros: n numbers, of 2 n
    unknowns.
    """
    assert Chain(4).sensing(sensors=4).rank == 4


def test_several_records_and_a_shaken_base_with_a_known_mass(exact):
    two = [
        add_noise(
            driven(TRUTH, [j], 4.0, FS, 100.0, (0.5, 50.0), seed=j),
            0.01,
            random_state=j,
        )
        for j in (1, 4)
    ]
    model = NRFRegressor(degree=1).fit([seen(rec, [2, 4]) for rec in two])
    assert (
        worst(parameters(model.model_), parameters(TRUTH)) < 0.01
        and len(model.motions_) == 2
    )
    ag = 2.0 * exact.force[:, 3] / 100.0
    shaken = simulate(TRUTH, None, 1 / FS, base_acceleration=ag)
    model = NRFRegressor(degree=1, known_masses={4: MASSES[3]}).fit(
        seen(shaken, [2, 3])
    )
    assert worst(parameters(model.model_), parameters(TRUTH)) < 1e-5


def test_two_frequencies_are_not_taken_for_three_numbers():
    """Base to top of two floors: poles alone, whatever the noise; a fit ends on chains
    20 % off, with narrow intervals.
    """
    frame = ChainModel(
        [12.4, 12.4], {i: laws.PowerSeries(1, [30.0, 1.4e5]) for i in (1, 2)}
    )
    ag = excitation.band_limited_random(
        1, 8.0, FS, excited=1, rms=2.0, band=(0.5, 50.0), random_state=2
    )[:, 0]
    shaken = add_noise(
        simulate(frame, None, 1 / FS, base_acceleration=ag), 0.002, random_state=0
    )
    with pytest.raises(IdentifiabilityError, match="2 of 3 combinations"):
        NRFRegressor(degree=1, known_masses={2: 12.4}).fit(seen(shaken, [2]))


@pytest.mark.parametrize(
    ("n", "seed"),
    [(4, 52), (4, 173), (5, 32)],
    ids=["narrow valley", "set of modes", "lost mode"],
)
def test_the_right_chain_is_begun_from_and_reached(n, seed):
    """Ways that are short for damped steps, sets of modes that fit nearly as well, a
    mode of 0.1 % lost in the noise.
    """
    m, k, c = np.random.default_rng([seed, n]).uniform(
        [[8.0], [1e5], [15.0]], [[16.0], [2e5], [40.0]], (3, n)
    )
    truth = ChainModel(m, {i + 1: laws.PowerSeries(1, [c[i], k[i]]) for i in range(n)})
    full = add_noise(
        driven(truth, [n], 8.0, 200.0, 100.0, (0.5, 50.0), seed=seed),
        0.005,
        random_state=[seed, 1],
    )
    assert (
        worst(
            parameters(NRFRegressor(degree=1).fit(seen(full, [n])).model_),
            parameters(truth),
        )
        < 0.05
    )


def test_a_rival_chain_withholds_intervals(exact):
    """A third of a second with half as much noise as motion: other chains lie within
    the confidence region.
    """
    with pytest.warns(
        BiasWarning, match="Another linear chain fits the channels as well"
    ):
        model = NRFRegressor(degree=1).fit(
            seen(add_noise(exact.window(0, 0.3), 0.5, random_state=0), [4])
        )
    with pytest.warns(BiasWarning, match="Intervals are withheld: Another"):
        assert model.confidence_intervals()["lower"].isna().all()


def test_drawings_tell_what_the_channels_do_not(exact):
    """A shaken base, two of four floors, 0.5 % noise: refused, or priors within 5 % and
    a few percent from both.
    """
    ag = 2.0 * exact.force[:, 3] / 100.0
    shaken = add_noise(
        simulate(TRUTH, None, 1 / FS, base_acceleration=ag), 0.005, random_state=2
    )
    record = seen(shaken.window(0, 4), [2, 4])
    with pytest.raises(
        IdentifiabilityError, match="6 of 7 combinations .* cannot be told apart"
    ):
        NRFRegressor(degree=1, known_masses={4: MASSES[3]}).fit(record)
    true = {
        **{f"m{j}": m for j, m in enumerate(MASSES, 1)},
        **{f"storey {i}: s": k for i, k in enumerate(SPRINGS, 1)},
    }
    off = dict(zip(true, 1 + 0.05 * np.array([1, -1, 1, -1, -1, 1, 1, -1])))
    priors = [
        Prior(name, off[name] * value, 0.05 * value) for name, value in true.items()
    ]
    model = NRFRegressor(degree=1, constraints=priors).fit(record)
    table = model.confidence_intervals().set_index("parameter").loc[list(true)]
    half, values = (table.upper - table.lower) / 2, pd.Series(true)
    assert (half < 0.09 * values).all() and half.min() < 0.05 * values[
        half.idxmin()
    ]  # two spreads of the drawings: 10 %
    assert (np.abs(table.estimate - values) < 1.5 * half).all()
    tied = NRFRegressor(
        degree=1,
        constraints=[
            *priors[1:],
            EqualStoreys(terms=["v"]),
            KnownStiffness(2, 1.2e5),
            priors[0],
        ],
    )
    found = tied.fit(record).restoring_forces_
    assert np.ptp([force.coefficients["v"] for force in found.values()]) < 1e-4 * 25.0
    assert abs(found["storey 2"].coefficients["s"] / 1.2e5 - 1) < 1e-5
    wrong = [*priors[:-1], Prior("storey 4: s", 3e5, 3e3)]
    with pytest.warns(BiasWarning, match="contradict Prior.*storey 4"):
        NRFRegressor(degree=1, constraints=wrong).fit(seen(exact, [4]))


TRIED = [laws.CoulombFriction(), laws.CubicStiffness(), laws.QuadraticDamping()]
PLAIN = laws.PowerSeries(1, [30.0, 1e5])


def of_two(*effects) -> Record:
    """Two floors, a sensor on the top alone, 0.5 % noise; effects in storey 1, whose
    floor has no sensor.
    """
    truth = ChainModel([10.0, 8.0], {1: [PLAIN, *effects], 2: PLAIN})
    return seen(
        add_noise(
            driven(truth, [2], 6.0, 150.0, 100.0, (0.5, 40.0), seed=3),
            0.005,
            random_state=4,
        ),
        [2],
    )


def test_a_free_run_is_not_fitted_to_samples_of_weight_zero():
    start, record = ChainModel([11.0, 7.0], {1: PLAIN, 2: PLAIN}), of_two()
    wrong = record.replace(
        acceleration=record.acceleration
        * np.where(np.arange(record.n_samples) // 200 == 1, 5, 1)[:, None]
    )
    found = []
    for rec in (record, wrong):
        shot = shot_of(rec, 0, 2)
        shot.weights[200:400] = 0.0
        fit = FreeRunFit(
            free_parameters(start, {}), [shot], LawLayout(start.chain, start.laws)
        )
        found.append(fit.solve(fit.rebuild.start, move=True).model.masses)
    assert (found[0] == found[1]).all() and worst(found[0], [10.0, 8.0]) < 0.01


def test_the_loop_finds_a_cubic_spring_under_base_motion_from_two_of_three_floors(
    tmp_path,
):
    ground = excitation.band_limited_random(
        1, 6.0, 150.0, excited=[1], rms=3.0, band=(0.5, 35), random_state=2
    )[:, 0]
    held = {i: [laws.PowerSeries(1, [30.0, 1.5e5])] for i in (1, 2, 3)}
    held[2].append(laws.CubicStiffness(3e9))
    masses = [12.0, 11.0, 10.0]
    truth = ChainModel(masses, held)
    full = add_noise(
        simulate(truth, np.zeros((len(ground), 3)), 1 / 150, base_acceleration=ground),
        0.005,
        random_state=1,
    )
    report = close_loop(
        seen(full, [1, 3]),
        NRFRegressor(degree=1, known_masses=dict(enumerate(masses, 1))),
        catalogue=TRIED,
    )
    (step,) = report.steps
    assert (step.law, step.site, step.confirmed) == (
        "cubic_stiffness",
        "storey 2",
        True,
    )
    assert step.parameters["k3"] == pytest.approx(3e9, rel=0.05)
    assert (
        report.table["held-out"].iloc[-1]
        < 1.0
        < 20.0
        < report.table["held-out"].iloc[0]
    )  # to the noise
    report.to_html(tmp_path / "page.html")
    assert "cubic" in report.to_markdown()


def test_the_loop_adds_nothing_where_the_chain_is_linear():
    report = close_loop(of_two(), catalogue=TRIED)
    assert not report.steps and report.table["held-out"].iloc[0] < 1.5
    assert report.stopped_because.startswith("no ")


@pytest.mark.slow
def test_a_declared_law_in_a_storey_whose_floor_has_no_sensor():
    """A cubic spring in storey 1 of two floors, a sensor on the top alone, 0.5 % noise:
    masses to 2 %, the law to 5 %.
    """
    bent = [laws.Duffing(1e5, 5e8), laws.LinearViscous(25.0)]
    truth = ChainModel([12.0, 9.0], {1: bent, 2: laws.PowerSeries(1, [20.0, 1.2e5])})
    record = add_noise(
        driven(truth, [2], 4.0, 150.0, 100.0, (0.5, 40.0), seed=2),
        0.005,
        random_state=1,
    )
    told = {"storey 1": [laws.Duffing(), laws.LinearViscous()]}
    model = NRFRegressor(degree=1, laws=told).fit(seen(record, [2]))
    assert worst(model.masses_, [12.0, 9.0]) < 0.02
    assert worst(model.model_.coefficients["storey 1"][:2], [1e5, 5e8]) < 0.05
