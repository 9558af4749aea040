"""Effects that stand in for each other, unusual sites, few sensors, faults beside
effects: what the loop makes of them.
"""

import warnings

import numpy as np
import pytest
from chains import integrate
from scipy.signal import chirp

from pysindy_nrf import (
    Chain,
    ChainModel,
    NRFRegressor,
    Record,
    Site,
    close_loop,
    excitation,
    laws,
    simulate,
)
from pysindy_nrf.simulation.noise import add_noise

pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.NRFWarning"),
]

FS, M, K, C = (
    250.0,
    np.array([6.0, 5.0, 4.0]),
    np.array([5e4, 4e4, 3e4]),
    np.array([40.0, 30.0, 24.0]),
)
CATALOGUE = [
    laws.CoulombFriction(),
    laws.QuadraticDamping(),
    laws.CubicStiffness(),
    laws.OneSidedGap(),
    laws.TwoSidedGap(),
    laws.HarmonicForce(),
    laws.LinkSpringDashpot(),
    laws.BendingCoupling(),
    laws.GainError(),
    laws.ConstantForce(),
]


def shaken(force=None, time_force=None, forced=(1, 2, 3), seed=0, duration=10.0):
    """Three floors under sums of sines, with forces x, v -> (3,) and t -> (n, 3) that
    no channel tells of.
    """
    rng, finer = np.random.default_rng(seed), 4
    w, phase = (
        2 * np.pi * rng.uniform(1, 35, (3, 40)),
        rng.uniform(0, 2 * np.pi, (3, 40)),
    )
    t = np.arange(int(duration * FS) * finer) / (FS * finer)
    F = (
        np.isin([1, 2, 3], forced)
        * 8.0
        * np.cos(np.multiply.outer(t, w) + phase).sum(axis=-1)
    )
    load, extra = (
        F if time_force is None else F + time_force(t),
        (None if force is None else lambda x, v: -force(x, v)),
    )
    a, v, s = integrate(M, C, K, 0.0 * K, load, 1 / (FS * finer), extra=extra)[
        :, ::finer
    ]
    return Record(
        force=F[::finer],
        acceleration=a,
        velocity=v.cumsum(axis=1),
        displacement=s.cumsum(axis=1),
        fs=FS,
    )


def beside(p, q, law):
    """A force between DOFs p and q (0: the ground) as a function of their relative
    motion.
    """

    def force(x, v):
        s, r = (y[p - 1] - (y[q - 1] if q else 0.0) for y in (x, v))
        out = np.zeros(3)
        out[p - 1] += law(s, r)
        if q:
            out[q - 1] -= law(s, r)
        return out

    return force


def loop(record, catalogue=CATALOGUE, noise=0.005, max_steps=4, **options):
    with warnings.catch_warnings(action="ignore"):
        noisy = add_noise(record, noise, random_state=1)
        return close_loop(
            noisy, NRFRegressor(degree=1, **options), catalogue, max_steps=max_steps
        )


def steps(report):
    return {(step.law, step.site): step for step in report.steps if step.confirmed}


@pytest.mark.parametrize(
    ("p", "q", "law", "name", "parameters"),
    [
        (3, 0, lambda s, v: 100.0 * v * abs(v), "quadratic_damping", {"c2": 100.0}),
        (
            3,
            1,
            lambda s, v: 2e4 * max(s - 1.0e-3, 0.0),
            "one_sided_gap",
            {"k": 2e4, "gap": 1.0e-3},
        ),
        (3, 0, lambda s, v: 9e3 * s + 6.0 * v, "link_spring_dashpot", {"k": 9e3}),
        (
            3,
            1,
            lambda s, v: -2e3 * s,
            "bending_coupling",
            {"kb": 2e3},
        ),  # the frame bends
    ],
)
def test_a_law_at_a_tie_or_a_brace_that_nobody_declared_is_found_there(
    p, q, law, name, parameters
):
    (step,) = loop(shaken(beside(p, q, law)), max_steps=1).steps
    assert (step.law, step.site) == (
        name,
        f"link {p}-{q}" if q else f"ground {p}",
    ) and step.confirmed
    for key, value in parameters.items():
        assert step.parameters[key] == pytest.approx(value, rel=0.05)


def test_a_motor_and_a_bumper_are_both_found():
    def motor(t):
        return np.multiply.outer(30.0 * np.sin(2 * np.pi * 11.0 * t), [0.0, 1.0, 0.0])

    report = loop(shaken(beside(3, 2, lambda s, v: 6e4 * max(s - 1e-3, 0.0)), motor))
    found = steps(report)
    assert set(found) == {("harmonic_force", "dof 2"), ("one_sided_gap", "storey 3")}
    at_2, stop = (
        found["harmonic_force", "dof 2"].parameters,
        found["one_sided_gap", "storey 3"].parameters,
    )
    assert at_2["frequency"] == pytest.approx(11.0, rel=1e-3)
    assert np.hypot(at_2["A"], at_2["B"]) == pytest.approx(30.0, rel=0.05)
    assert stop["gap"] == pytest.approx(1e-3, rel=0.05) and stop["k"] == pytest.approx(
        6e4, rel=0.05
    )
    assert report.model.masses == pytest.approx(M, rel=0.02)


def test_a_wrong_gain_beside_a_cubic_spring_is_a_wrong_gain():
    record = shaken(beside(2, 1, lambda s, v: 4e9 * s**3))
    record = record.replace(
        velocity=None, acceleration=record.acceleration * [1.0, 1.0, 1.15]
    )
    found = steps(loop(record))
    assert {("gain_error", "sensor a3"), ("cubic_stiffness", "storey 2")} == set(found)
    assert found["gain_error", "sensor a3"].parameters["e"] == pytest.approx(
        0.15, abs=0.02
    )


def plain(n):
    """Linear storeys."""
    return {
        i: [laws.LinearElastic(k), laws.LinearViscous(c)]
        for i, (k, c) in enumerate(zip(K[:n], C[:n]), 1)
    }


def scattered(effects=()):
    """Three floors, the top one forced; gains of the motion channels scatter by 1 %, as
    calibrations do.
    """
    storeys = plain(3)
    storeys[2] += effects
    F = excitation.band_limited_random(
        3, 12.0, FS, excited=[3], rms=40.0, band=(1, 35), random_state=0
    )
    record = simulate(ChainModel(M, storeys), F, 1 / FS)
    rng = np.random.default_rng(3)
    motions = ("acceleration", "velocity", "displacement")
    return record.replace(
        **{
            key: getattr(record, key) * (1 + 0.01 * rng.standard_normal(3))
            for key in motions
        }
    )


def test_calibrations_that_scatter_are_no_effect_of_the_structure():
    record, forces = scattered(), [law for law in CATALOGUE if law.name != "gain_error"]
    report = loop(record, forces, 0.002)
    assert report.steps == [] and "errors of the channels" in report.stopped_because
    noisy = add_noise(record, 0.002, random_state=1)
    assert close_loop(
        noisy,
        catalogue=forces,
        calibration={"gain": 0.0, "cross_axis": 0.0, "delay": 0.0},
    ).steps


def test_an_effect_is_found_though_calibrations_scatter():
    found = steps(loop(scattered([laws.CubicStiffness(4e9)]), noise=0.002))
    assert ("cubic_stiffness", "storey 2") in found
    assert {site for _, site in found} <= {
        "storey 2",
        *(f"sensor {c}{j}" for c in "axF" for j in (1, 2, 3)),
    }


@pytest.mark.parametrize(
    ("forced", "rms", "held"),
    [
        ([1, 2, 3, 4, 5], 36.0, [laws.CoulombFriction(3.0)] * 5),  # none stands out
        (
            [6],
            60.0,
            [
                *[laws.CubicStiffness(4e9)] * 4,
                laws.CoulombFriction(15.0),
                laws.CubicStiffness(4e9),
            ],
        ),
    ],
)
def test_laws_in_every_storey_are_found_and_confirmed(forced, rms, held):
    """With one floor forced, a law hands its error on to the balance below until the
    law of that storey is there.
    """
    n = len(held)
    springs = enumerate(zip(np.linspace(1e5, 5e4, n), held), 1)
    storeys = {
        i: [laws.LinearElastic(k), laws.LinearViscous(8e-4 * k), law]
        for i, (k, law) in springs
    }
    F = excitation.band_limited_random(
        n, 12.0, FS, excited=forced, rms=rms, band=(1, 35), random_state=0
    )
    record = simulate(ChainModel(np.linspace(6.0, 4.0, n), storeys), F, 1 / FS)
    report = loop(
        record,
        [laws.CoulombFriction(), laws.CubicStiffness(), laws.QuadraticDamping()],
        0.01,
        max_steps=None,
    )
    assert set(steps(report)) == {
        (law.name, f"storey {i}") for i, law in enumerate(held, 1)
    }
    assert all(step.error_after < step.error_before for step in report.steps)


def test_accelerations_alone_of_a_linear_chain_give_its_masses_and_no_effect():
    report = loop(shaken(seed=1).replace(velocity=None, displacement=None), noise=0.01)
    assert report.steps == [] and report.model.masses == pytest.approx(M, rel=0.02)


def test_accelerations_alone_tell_a_gap_through_which_the_first_modes_are_swept():
    storeys = plain(3)
    storeys[2].append(laws.TwoSidedGap(1e-3, 4e4))
    F = np.zeros((5000, 3))
    F[:, 2] = 30.0 * chirp(np.arange(5000) / FS, 4.0, 20.0, 30.0, "logarithmic")
    record = simulate(ChainModel(M, storeys), F, 1 / FS).replace(
        velocity=None, displacement=None
    )
    found = steps(
        loop(
            record, [laws.TwoSidedGap(), laws.CubicStiffness(), laws.GainError()], 0.01
        )
    )
    assert set(found) == {("two_sided_gap", "storey 2")}
    assert found["two_sided_gap", "storey 2"].parameters == pytest.approx(
        {"gap": 1e-3, "k": 4e4}, rel=0.03
    )


def test_a_gain_that_differs_with_frequency_is_no_wrong_gain():
    """Under blows of three samples, straight between them, velocities are less than
    samples of accelerations tell.
    """
    F = excitation.impact_hammer(
        3, 16.0, FS, excited=[2], level=100.0, n_hits=8, width=0.012, random_state=1
    )
    record = simulate(ChainModel(M, plain(3)), F, 1 / FS, hold="linear")
    assert loop(record, [laws.GainError(), laws.CubicStiffness()], 0.003).steps == []


def test_a_force_that_is_straight_between_samples_hides_no_oscillator():
    """Fused motions then lose some of their highest frequencies, as behind a filter
    that lags by part of a sample.
    """
    F = excitation.band_limited_random(
        2, 50.0, 80.0, excited=[2], rms=40.0, band=(1.5, 25), random_state=3
    )
    record = simulate(ChainModel(M[:2], plain(2)), F, 1 / 80, hold="linear")
    assert (
        loop(
            record,
            [laws.HiddenOscillator(), laws.CubicStiffness(), laws.Inerter()],
            0.003,
        ).steps
        == []
    )


def test_a_wrong_known_mass_of_a_floor_that_no_force_acts_on_is_named():
    dof = 2
    declared = dict(enumerate(M, 1)) | {dof: 1.25 * M[dof - 1]}
    tried = [
        laws.CoulombFriction(),
        laws.CubicStiffness(),
        laws.AddedMass(),
        laws.LinkSpringDashpot(),
    ]
    (step,) = loop(shaken(forced=(3,)), tried, max_steps=1, known_masses=declared).steps
    assert (step.law, step.site) == ("added_mass", f"dof {dof}")
    assert step.parameters["dm"] == pytest.approx(-0.25 * M[dof - 1], rel=0.05)


def test_a_free_chain_may_turn_out_to_be_tied_to_the_ground():
    report = loop(
        shaken(), [laws.LinkSpringDashpot()], 0.0, chain=Chain(3, ground="free")
    )
    assert [str(Site(s.site)) for s in report.steps] == ["storey 1"]
    assert report.table["held-out"].iloc[-1] < 0.1


# -- several laws of one family ------------------------------------------------

SOFT = [laws.LinearElastic(2e4), laws.LinearViscous(20.0)]


def soft(effects, n=1, rms=30.0):
    """A soft chain with effects in its top storey or on its top floor, 20 s at 200 Hz,
    all floors forced.
    """
    at = {f"storey {n}": [], f"dof {n}": []}
    for law in effects:
        at[f"dof {n}" if law.acts_at == ("dof",) else f"storey {n}"].append(law)
    storeys = {
        f"storey {i}": [*SOFT, *at.pop(f"storey {i}", [])] for i in range(1, n + 1)
    }
    truth = ChainModel([12.0] * n, {**storeys, **at})
    every = list(range(1, n + 1))
    F = excitation.band_limited_random(
        n, 20.0, 200.0, excited=every, rms=rms, band=(0.5, 15.0), random_state=0
    )
    return simulate(truth, F, 1 / 200)


def test_two_harmonic_forces_on_one_floor_are_both_found():
    true = {23.7: 14.0, 31.0: 9.0}  # Hz, N
    report = loop(
        soft([laws.HarmonicForce(f, A, 0.0) for f, A in true.items()], 2),
        [laws.HarmonicForce()],
        0.0,
    )
    found = {
        s.parameters["frequency"]: np.hypot(s.parameters["A"], s.parameters["B"])
        for s in report.steps
    }
    assert sorted(found) == pytest.approx(sorted(true), abs=2e-3)
    assert [found[f] for f in sorted(found)] == pytest.approx([14.0, 9.0], rel=0.02)


@pytest.mark.parametrize(
    "law", [laws.CubicStiffness(3e8), laws.TwoSidedGap(0.003, 2e4)]
)
def test_one_law_gets_no_company_of_its_family(law):
    catalogue = [
        laws.QuadraticStiffness(),
        laws.AbsoluteQuadraticStiffness(),
        laws.CubicStiffness(),
        laws.QuinticStiffness(),
        laws.TwoSidedGap(),
        laws.OneSidedGap(),
        laws.DeadZone(),
    ]
    report = loop(soft([law], 2), catalogue, 0.01)
    (step,) = report.steps
    assert step.site == "storey 2" and law.name in (
        step.law,
        *(name for name, _, _ in step.tied),
    )
    for name, value in law.parameters.items():
        assert step.parameters[name] == pytest.approx(value, rel=0.05)


def test_a_bouc_wen_hysteresis_is_not_mended_by_simpler_ones():
    """Under an earthquake."""
    fs = 200.0
    held = {
        1: [
            laws.LinearElastic(8.5e4),
            laws.LinearViscous(400.0),
            laws.BoucWen(beta=300.0, rho=0.0, n=1.5, alpha=4e4),
        ],
        2: [laws.LinearElastic(7e4), laws.LinearViscous(200.0)],
    }
    t = np.arange(int(30 * fs)) / fs
    shaking = excitation.band_limited_random(
        1, 30.0, fs, excited=[1], rms=1.5, band=(0.3, 12.0), random_state=3
    )[:, 0]
    ag = shaking * (t / 8 * np.exp(1 - t / 8)) ** 2
    record = simulate(
        ChainModel([12.0, 9.0], held),
        np.zeros((len(t), 2)),
        1 / fs,
        base_acceleration=ag,
    )
    catalogue = [laws.Dahl(), laws.Jenkins(), laws.Iwan(), laws.BoucWen()]
    report = loop(record, catalogue, 0.01, known_masses={1: 12.0, 2: 9.0})
    assert {(s.law, s.site) for s in report.steps} == {("bouc_wen", "storey 1")}
    assert report.steps[0].parameters["alpha"] == pytest.approx(4e4, rel=0.1)


@pytest.mark.parametrize("t0", [6.1, 9.7])
def test_a_stiffness_that_steps_in_a_held_out_piece_is_judged_on_the_others_and_dated_to_the_piece(
    t0,
):
    """What the search does not see it cannot date: the interval says so, and pieces
    without the instant confirm it.
    """
    storeys = {
        i: [laws.LinearElastic(k), laws.LinearViscous(40.0)]
        for i, k in ((1, 4e4), (2, 3e4))
    }
    storeys[2].append(laws.StiffnessStep(t0=t0, dk=-3e3))
    F = excitation.band_limited_random(
        2, 16.0, 200.0, excited=2, rms=100.0, band=(1, 30), random_state=4
    )
    record = simulate(ChainModel([10.0, 8.0], storeys), F, 1 / 200)
    step = close_loop(
        record, catalogue=[laws.StiffnessStep(), laws.CubicStiffness()]
    ).steps[0]
    low, high = step.intervals["t0"]
    assert (step.law, step.site, step.confirmed) == ("stiffness_step", "storey 2", True)
    assert (
        step.error_after < 0.5 * step.error_before
        and low < t0 < high
        and high - low > 0.5
    )
    assert step.intervals["dk"][0] < -3e3 < step.intervals["dk"][1]
