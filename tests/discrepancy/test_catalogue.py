"""What the search tries and where, and effects that are no force of the chain: faulty
sensors, unknown starts.
"""

import numpy as np
import pytest

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
from pysindy_nrf.discrepancy.catalogue import candidates, default_catalogue
from pysindy_nrf.equations.shape_search import driving_frequency, spectral_lines
from pysindy_nrf.exceptions import ChannelError
from pysindy_nrf.simulation.noise import add_noise

FS = 500.0
ISSUE = {
    "coulomb_friction",
    "stribeck_friction",
    "quadratic_damping",
    "power_law_damping",
    "quadratic_stiffness",
    "cubic_stiffness",
    "quintic_stiffness",
    "one_sided_gap",
    "two_sided_gap",
    "bilinear",
    "dead_zone",
    "jenkins",
    "iwan",
    "dahl",
    "lugre",
    "bouc_wen",
    "maxwell_branch",
    "stiffness_step",
    "stiffness_drift",
    "damping_drift",
    "harmonic_force",
    "constant_force",
    "link_spring_dashpot",
    "added_mass",
    "channel_delay",
    "gain_error",
    "sensor_offset",
    "backlash_friction",
    "degrading_bouc_wen",
    "pinched_bouc_wen",
    "hidden_oscillator",
    "position_dependent_friction",
    "break_away_friction",
}


def _chain(n, seed):
    rng = np.random.default_rng(seed)
    storeys = {
        i: [
            laws.LinearElastic(rng.uniform(1e5, 2e5)),
            laws.LinearViscous(rng.uniform(40, 90)),
        ]
        for i in range(1, n + 1)
    }
    return ChainModel(rng.uniform(8, 14, n), storeys)


def _record(n, forced, noise, seed=3, sensors=None, seconds=8.0):
    model = _chain(n, seed)
    if sensors:
        model = ChainModel(model.masses, {**model.laws, **sensors})
    F = excitation.band_limited_random(
        n,
        seconds,
        FS,
        excited=forced,
        rms=100.0,
        band=(1, 50),
        random_state=np.random.default_rng(seed),
    )
    record = simulate(model, F, 1 / FS)
    return (
        add_noise(record, noise, random_state=np.random.default_rng(seed + 1))
        if noise
        else record
    )


# -- what is tried, and where --------------------------------------------------


def test_the_field_is_in_the_catalogue():
    assert {law.name for law in default_catalogue()} >= ISSUE


def test_laws_that_read_a_channel_are_tried_where_there_is_one():
    names = {law.name for law in default_catalogue(["voltage", "ag", "vg"])}
    assert names >= {
        "covariate_friction",
        "lagged_covariate_friction",
        "base_motion",
        "ground_friction",
    }
    assert not {"covariate_friction", "base_motion", "ground_friction"} & {
        law.name for law in default_catalogue()
    }


def _places(name, n=3, known=(), forced=(1,), n_records=1):
    every = candidates(default_catalogue(), Chain(n), known, (), forced, n_records)
    return {str(site) for law, site in every if law.name == name}


def test_each_law_is_tried_where_it_can_be_told():
    assert _places("constant_force") == {
        "dof 1",
        "dof 2",
        "dof 3",
        "storey 2",
        "storey 3",
    }
    everywhere = {
        "storey 1",
        "storey 2",
        "storey 3",
        "ground 2",
        "ground 3",
        "link 3-1",
    }
    assert (
        _places("coulomb_friction")
        == _places("cubic_stiffness")
        == _places("dahl")
        == everywhere
    )
    assert _places("maxwell_branch") == {"storey 1", "storey 2", "storey 3"}
    assert _places("link_spring_dashpot") == {"link 3-1", "ground 2", "ground 3"}
    assert _places("added_mass") == set()
    assert _places("hidden_oscillator") == {"dof 1", "dof 2", "dof 3"} and not _places(
        "hidden_oscillator", forced=()
    )
    assert _places("added_mass", known=(1, 2)) == {
        "dof 1"
    }  # DOF 1 is forced: above it the balances are homogeneous
    assert _places("channel_delay") == set()


def test_a_structure_does_not_heal_between_two_tests():
    assert _places("stiffness_step") == {"storey 1", "storey 2", "storey 3"}
    assert (
        _places("stiffness_step", n_records=2)
        == _places("stiffness_drift", n_records=2)
        == set()
    )


# -- sensors -------------------------------------------------------------------


def test_a_simulated_sensor_reads_late_and_leaves_the_motion_alone():
    plain, faulty = (
        _record(2, [2], 0.0, sensors=s)
        for s in (None, {"sensor a2": laws.ChannelDelay(2 / FS)})
    )
    assert np.allclose(
        faulty.acceleration[2:, 1], plain.acceleration[:-2, 1], rtol=1e-9
    )
    assert np.isnan(faulty.acceleration[:2, 1]).all()
    for key in ("force", "displacement", "velocity"):
        assert np.array_equal(getattr(faulty, key), getattr(plain, key))


def test_a_sensor_that_is_not_there_is_named():
    with pytest.raises(ChannelError, match="sensor a7"):
        _record(2, [2], 0.0, sensors={"sensor a7": laws.GainError(0.2)})


RIVALS = [
    laws.CoulombFriction(),
    laws.MaxwellBranch(),
    laws.ConstantForce(),
    laws.DampingDrift(),
    laws.QuadraticStiffness(),
    laws.LinkSpringDashpot(),
    laws.ChannelDelay(),
    laws.GainError(),
    laws.SensorOffset(),
]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("forced", "left_out", "channel", "fault", "noise"),
    [
        ([2], "velocity", "a2", laws.ChannelDelay(0.004), 0.01),
        ([1, 2, 3], None, "F2", laws.GainError(0.2), 0.01),
        ([1, 2, 3], "velocity", "x3", laws.GainError(0.2), 0.01),
        ([1, 3], None, "F3", laws.ChannelDelay(-0.003), 0.0),
    ],
)
def test_the_faulty_sensor_is_found_and_measured(
    forced, left_out, channel, fault, noise
):
    record = _record(3, forced, noise, sensors={f"sensor {channel}": fault})
    if left_out:
        record = record.replace(**{left_out: None})
    report = close_loop(record, catalogue=RIVALS, max_steps=2)
    step = report.steps[0]
    assert (step.law, step.family, step.site) == (
        fault.name,
        "sensor",
        f"sensor {channel}",
    )
    found, true = next(iter(step.parameters.values())), float(fault.coefficients[0])
    assert (
        found == pytest.approx(true, rel=0.05)
        and step.error_after < 0.6 * step.error_before
    )
    assert np.allclose(report.model.masses, _chain(3, 3).masses, rtol=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_a_small_gain_of_a_force_is_found_where_it_stands_out_of_the_noise(noise):
    record = _record(3, [1, 2, 3], noise, sensors={"sensor F2": laws.GainError(0.04)})
    step = close_loop(record, catalogue=RIVALS, max_steps=1).steps[0]
    assert (step.law, step.site) == ("gain_error", "sensor F2")
    assert step.parameters["e"] == pytest.approx(0.04, rel=0.2)


def test_of_two_forces_either_may_be_wrong():
    record = _record(2, [1, 2], 0.01, sensors={"sensor F2": laws.GainError(0.2)})
    step = close_loop(record, catalogue=RIVALS, max_steps=1).steps[0]
    assert {step.site, *step.sensors} == {"sensor F1", "sensor F2"}
    assert "sensor F" in step.sentence.split("The same fault")[1]


@pytest.mark.parametrize(
    ("forced", "noise"), [([2], 0.05), ([1, 2, 3], 0.02), ([1], 0.0)]
)
def test_good_sensors_are_left_alone(forced, noise):
    report = close_loop(_record(3, forced, noise, seed=8), catalogue=RIVALS)
    assert report.steps == []
    assert "contradict" not in report.stopped_because


@pytest.mark.slow
def test_channels_that_contradict_each_other_are_said():
    # three channels of one DOF, one 4 samples late: fusion outvotes it, and the reader
    # is told
    record = _record(
        3, [1, 2, 3], 0.03, sensors={"sensor v2": laws.ChannelDelay(0.006)}
    )
    report = close_loop(record, catalogue=RIVALS)
    found = [s.site for s in report.steps]
    assert found == ["sensor v2"] or (not found and "v2 is" in report.stopped_because)


# -- effects with a simpler name, records with an unknown start ----------------


def test_along_a_drift_of_one_sign_an_offset_goes_before_a_curved_spring():
    rng = np.random.default_rng(2)
    t = np.arange(20 * int(FS)) / FS
    x = 0.12 * (1 - 0.6 * np.cos(1.7 * t) - 0.4 * np.cos(4.1 * t))
    v = 0.12 * (0.6 * 1.7 * np.sin(1.7 * t) + 0.4 * 4.1 * np.sin(4.1 * t))
    a = 0.12 * (0.6 * 1.7**2 * np.cos(1.7 * t) + 0.4 * 4.1**2 * np.cos(4.1 * t))
    F = 90 * a + 200 * v - 6.0 + 20 * np.sign(v)
    F += 0.02 * F.std() * rng.standard_normal(len(F))
    record = Record(force=F, displacement=x, fs=FS)
    springs = [
        laws.QuadraticStiffness(),
        laws.AbsoluteQuadraticStiffness(),
        laws.OneSidedGap(),
        laws.CubicStiffness(),
    ]
    report = close_loop(
        record,
        NRFRegressor(degree=1),
        [laws.CoulombFriction(), laws.ConstantForce(), *springs],
        band=(None, 20.0),
    )
    values = {step.law: step.parameters for step in report.steps}
    assert list(values)[:2] == ["coulomb_friction", "constant_force"]
    assert values["coulomb_friction"]["Fc"] == pytest.approx(20, rel=0.05)


@pytest.mark.slow
def test_a_record_cut_out_of_a_running_test_keeps_its_memory():
    law = laws.BoucWen(beta=800.0, rho=-0.4, n=1.5, alpha=5e4)
    truth = ChainModel(
        [2.0], {1: [laws.LinearElastic(5e4), laws.LinearViscous(10.0), law]}
    )
    F = excitation.band_limited_random(
        1, 9.0, 2000.0, excited=1, rms=100.0, band=(5, 60), random_state=1
    )
    whole = simulate(truth, F, 1 / 2000)
    report = close_loop(
        whole.window(2.0, 9.0), catalogue=[laws.BoucWen(), laws.Dahl()], max_steps=1
    )
    found = report.steps[0].parameters
    assert report.steps[0].law == "bouc_wen"
    for name, true in (("beta", 800.0), ("rho", -0.4), ("n", 1.5), ("alpha", 5e4)):
        assert found[name] == pytest.approx(true, rel=0.02), name


def test_a_harmonic_test_hides_no_harmonic_force():
    t = np.arange(12000) / 1000
    drive = np.sin(2 * np.pi * 1.5 * t)
    assert driving_frequency(drive[None], 1e-3) == pytest.approx(1.5, abs=0.05)
    residual = np.sign(np.cos(2 * np.pi * 1.5 * t)) + 0.3 * np.sin(2 * np.pi * 7.9 * t)
    lines = spectral_lines(residual, 1e-3, 3, 1.5)
    assert lines[0] == pytest.approx(7.9, abs=0.05)
    assert min(abs(f / 1.5 - round(f / 1.5)) for f in lines[:1]) > 0.05
    noise = np.random.default_rng(0).standard_normal((1, 12000))
    assert np.isnan(driving_frequency(noise, 1e-3))
