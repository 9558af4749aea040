"""Fewer sensors than floors: masses and laws from the free run of the channels."""

import numpy as np
import pytest
from chains import driven, worst
from few_channels import (
    FS,
    MASSES,
    frame,
    parameters,
    pushed,
    shaken,
    true_parameters,
    with_sensors,
)

from pysindy_nrf import (
    Chain,
    ChainModel,
    NRFRegressor,
    Record,
    excitation,
    laws,
    simulate,
)
from pysindy_nrf.equations import nrmse
from pysindy_nrf.exceptions import (
    BiasWarning,
    ChannelError,
    ExcitationError,
    IdentifiabilityError,
)
from pysindy_nrf.identification import FreeRunFit, free_parameters, shot_of
from pysindy_nrf.simulation import add_noise

TRUTH = frame()


@pytest.fixture(scope="module")
def clean():
    """The frame, pushed on its top floor."""
    return pushed(TRUTH)


@pytest.fixture(scope="module")
def noisy_fit(clean):
    """A fit to two of four floors with 2 % of noise."""
    noisy = add_noise(clean, 0.02, random_state=3)
    return NRFRegressor(degree=1).fit(with_sensors(noisy, [2, 4]))


@pytest.mark.parametrize(
    "floors", [[4], [2, 3]], ids=["at the force alone", "away from the force"]
)
def test_without_noise_masses_and_stiffnesses_are_exact(clean, floors):
    model = NRFRegressor(degree=1).fit(with_sensors(clean, floors))

    assert worst(parameters(model.model_), parameters(TRUTH)) < 1e-6


def test_noise_of_two_percent_leaves_two_percent(noisy_fit):
    assert worst(parameters(noisy_fit.model_), parameters(TRUTH)) < 0.02


@pytest.mark.parametrize("name", ["a1", "x3", "R storey 3"])
def test_absent_motions_and_storey_forces_come_with_intervals(clean, noisy_fit, name):
    """What absent sensors would have read, to a percent, and how sure it is."""
    forces = TRUTH.restoring_force(clean.to_features(smooth=False)[0])
    true = {
        "a1": clean.acceleration[:, 0],
        "x3": clean.displacement[:, 2],
        "R storey 3": forces[:, 2],
    }[name]
    table = noisy_fit.motions_[0]
    half = (table[f"{name}_upper"] - table[f"{name}_lower"]) / 2

    assert nrmse(true, table[name]) < 2.0
    error = np.sqrt(np.mean((table[name] - true) ** 2))
    share = error / np.sqrt(np.mean(half**2))
    assert 0.2 < share < 0.8  # a standard error is 0.51 of a 95 % interval


def test_intervals_hold_the_truth(noisy_fit):
    intervals = noisy_fit.confidence_intervals().set_index("parameter")
    true = true_parameters()
    n_inside = 0
    for name, value in true.items():
        n_inside += intervals.lower[name] <= value <= intervals.upper[name]

    assert n_inside >= 6


def test_the_error_of_the_free_run_is_the_noise(noisy_fit):
    errors = noisy_fit.errors_.loc[["dof 2", "dof 4"], "error"]

    assert errors.between(1.5, 3.0).all()
    assert 1.5 < noisy_fit.free_runs().error < 3.0
    assert "free run predicts the motion to 2" in str(noisy_fit.verdict())


@pytest.mark.slow
def test_channels_correct_the_hidden_motion_of_a_frame_with_a_brace():
    """A brace that the model lacks: the channels show most of what its run misses."""
    brace = {"ground 3": laws.LinkSpringDashpot(1e4, 0.0)}
    true = pushed(ChainModel(MASSES, {**TRUTH.laws, **brace}))
    record = with_sensors(add_noise(true, 0.005, random_state=3), [2, 3, 4])
    known = dict(enumerate(MASSES, 1))

    with pytest.warns(BiasWarning, match="beyond its noise"):
        model = NRFRegressor(degree=1, known_masses=known).fit(record)

    alone = simulate(model.model_, true.force, 1 / FS).acceleration[:, 0]
    table = model.motions_[0]
    motion = true.acceleration[:, 0]
    assert nrmse(motion, table["a1"]) < 0.5 * nrmse(motion, alone)
    inside = (table["a1_lower"] <= motion) & (motion <= table["a1_upper"])
    assert inside.mean() > 0.8


def test_several_records_are_fitted_together():
    records = []
    for floor in (1, 4):
        record = pushed(TRUTH, seconds=4.0, dof=floor, seed=floor)
        noisy = add_noise(record, 0.01, random_state=floor)
        records.append(with_sensors(noisy, [2, 4]))

    model = NRFRegressor(degree=1).fit(records)

    assert worst(parameters(model.model_), parameters(TRUTH)) < 0.01
    assert len(model.motions_) == 2


def test_a_known_mass_scales_a_shaken_chain(clean):
    ground = 2.0 * clean.force[:, 3] / 100.0
    record = with_sensors(shaken(TRUTH, ground), [2, 3])

    model = NRFRegressor(degree=1, known_masses={4: MASSES[3]}).fit(record)

    assert worst(parameters(model.model_), parameters(TRUTH)) < 1e-5


@pytest.mark.parametrize(
    ("n", "seed"),
    [
        pytest.param(4, 52, id="narrow valley", marks=pytest.mark.slow),
        pytest.param(4, 173, id="set of modes"),
        pytest.param(5, 32, id="lost mode", marks=pytest.mark.slow),
    ],
)
def test_the_right_chain_is_reached(n, seed):
    """Narrow valleys, sets of modes that fit alike, a mode of 0.1 % lost in noise."""
    rng = np.random.default_rng([seed, n])
    lowest = [[8.0], [1e5], [15.0]]
    m, k, c = rng.uniform(lowest, [[16.0], [2e5], [40.0]], (3, n))
    storeys = {i + 1: laws.PowerSeries(1, [c[i], k[i]]) for i in range(n)}
    truth = ChainModel(m, storeys)
    record = add_noise(
        pushed(truth, fs=200.0, seed=seed), 0.005, random_state=[seed, 1]
    )

    model = NRFRegressor(degree=1).fit(with_sensors(record, [n]))

    assert worst(parameters(model.model_), parameters(truth)) < 0.05


@pytest.mark.slow
def test_a_rival_chain_withholds_intervals():
    """A third of a second, half as much noise as motion: other chains fit as well."""
    noisy = add_noise(pushed(frame(2)).window(0, 0.3), 0.5, random_state=5)

    with pytest.warns(BiasWarning, match="Another linear chain fits"):
        model = NRFRegressor(degree=1).fit(with_sensors(noisy, [2]))
    with pytest.warns(BiasWarning, match="Intervals are withheld: Another"):
        intervals = model.confidence_intervals()

    assert intervals["lower"].isna().all()


def test_nothing_scales_a_chain_without_force_and_mass(clean):
    record = Record(acceleration=with_sensors(clean, [4]).acceleration, fs=FS)

    with pytest.raises(ExcitationError, match="nothing scales the chain"):
        NRFRegressor(degree=1).fit(record)


def test_an_unknown_force_is_refused(clean):
    force = clean.force.copy()
    force[:, 2] = np.nan
    record = with_sensors(clean, [4]).replace(force=force)

    with pytest.raises(ChannelError, match="force on DOF 3 .* unknown"):
        NRFRegressor(degree=1).fit(record)


def test_records_of_a_fifth_of_a_second_are_refused(clean):
    with pytest.raises(ChannelError, match="50 samples"):
        NRFRegressor(degree=1).fit(with_sensors(clean.window(0, 0.2), [4]))


def test_as_much_noise_as_motion_is_refused():
    noisy = add_noise(pushed(frame(2)).window(0, 0.3), 1.0, random_state=0)

    with pytest.raises(IdentifiabilityError, match="do not determine|misses"):
        NRFRegressor(degree=1).fit(with_sensors(noisy, [2]))


def test_two_frequencies_are_not_taken_for_three_numbers():
    """From base to top of two floors there are poles alone, whatever the noise.

    A fit ends on chains 20 % off, with narrow intervals.
    """
    storeys = {i: laws.PowerSeries(1, [30.0, 1.4e5]) for i in (1, 2)}
    truth = ChainModel([12.4, 12.4], storeys)
    ground = excitation.band_limited_random(
        1, 8.0, FS, excited=1, rms=2.0, band=(0.5, 50.0), random_state=2
    )
    record = with_sensors(shaken(truth, ground[:, 0], noise=0.002), [2])

    with pytest.raises(IdentifiabilityError, match="2 of 3 combinations"):
        NRFRegressor(degree=1, known_masses={2: 12.4}).fit(record)


def test_sensors_that_cannot_determine_a_chain_say_so():
    sensing = Chain(4).sensing(sensors=2, excited=3)

    assert (sensing.rank, sensing.unknowns) == (7, 8)
    assert not sensing.complete
    assert "cannot be distinguished" in str(sensing)


@pytest.mark.parametrize("end", [1, 4])
def test_the_response_at_a_forced_end_has_the_whole_chain(end):
    """Hochstadt: all masses and stiffnesses follow from its poles and zeros."""
    alone = Chain(4).sensing(sensors=end, excited=end)

    assert alone.complete
    assert min(alone.errors.values()) > 0.999


@pytest.mark.parametrize("end", [1, 4])
def test_another_sensor_never_makes_estimates_worse(end):
    alone = Chain(4).sensing(sensors=end, excited=end)
    floor = max(alone.gains, key=alone.gains.get)
    both = Chain(4).sensing([end, floor], end)

    assert min(alone.gains.values()) >= 1
    assert f"helps most on floor {floor}" in str(alone)
    assert both.errors["m2"] <= alone.errors["m2"]


def test_of_a_shaken_chain_the_top_has_the_frequencies_alone():
    """The response of the top to the base has poles and no zeros: n of 2 n numbers."""
    assert Chain(4).sensing(sensors=4).rank == 4


def test_a_fit_does_not_read_samples_of_weight_zero():
    storey = laws.PowerSeries(1, [30.0, 1e5])
    truth = ChainModel([10.0, 8.0], {1: storey, 2: storey})
    record = driven(truth, [2], 6.0, 150.0, 100.0, (0.5, 40.0), seed=3)
    record = with_sensors(add_noise(record, 0.005, random_state=4), [2])
    acceleration = record.acceleration.copy()
    acceleration[200:400] *= 5.0

    masses = []
    start = ChainModel([11.0, 7.0], truth.laws)
    for changed in (record, record.replace(acceleration=acceleration)):
        shot = shot_of(changed, 0, 2)
        shot.weights[200:400] = 0.0
        fit = FreeRunFit(free_parameters(start, {}), [shot])
        masses.append(fit.solve(fit.rebuild.start, move=True).model.masses)

    assert (masses[0] == masses[1]).all()
    assert worst(masses[0], [10.0, 8.0]) < 0.01


@pytest.mark.slow
def test_a_declared_law_in_a_storey_whose_floor_has_no_sensor():
    """A cubic spring in storey 1 of two floors, a sensor on the top, 0.5 % noise."""
    bent = [laws.Duffing(1e5, 5e8), laws.LinearViscous(25.0)]
    truth = ChainModel([12.0, 9.0], {1: bent, 2: laws.PowerSeries(1, [20.0, 1.2e5])})
    record = driven(truth, [2], 4.0, 150.0, 100.0, (0.5, 40.0), seed=2)
    record = with_sensors(add_noise(record, 0.005, random_state=1), [2])
    declared = {"storey 1": [laws.Duffing(), laws.LinearViscous()]}

    model = NRFRegressor(degree=1, laws=declared).fit(record)

    assert worst(model.masses_, [12.0, 9.0]) < 0.02
    assert worst(model.model_.coefficients["storey 1"][:2], [1e5, 5e8]) < 0.05
