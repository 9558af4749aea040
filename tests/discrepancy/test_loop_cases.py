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
from pysindy_nrf.simulation import add_noise

pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.NRFWarning"),
]

FS = 250.0
M = np.array([6.0, 5.0, 4.0])
K = np.array([5e4, 4e4, 3e4])
C = np.array([40.0, 30.0, 24.0])
FORCES = [
    laws.CoulombFriction(),
    laws.QuadraticDamping(),
    laws.CubicStiffness(),
    laws.OneSidedGap(),
    laws.TwoSidedGap(),
    laws.HarmonicForce(),
    laws.LinkSpringDashpot(),
    laws.BendingCoupling(),
    laws.ConstantForce(),
]
CATALOGUE = [*FORCES, laws.GainError()]


def shaken(force=None, hidden_load=None, forced=(1, 2, 3), seed=0):
    """Ten seconds of three floors under sums of sines.

    With forces x, v -> (3,) and t -> (n, 3) that no channel shows.
    """
    rng, finer = np.random.default_rng(seed), 4
    omega = 2 * np.pi * rng.uniform(1, 35, (3, 40))
    phase = rng.uniform(0, 2 * np.pi, (3, 40))
    t = np.arange(int(10 * FS) * finer) / (FS * finer)
    waves = np.cos(np.multiply.outer(t, omega) + phase).sum(axis=-1)
    F = np.isin([1, 2, 3], forced) * 8.0 * waves
    load = F if hidden_load is None else F + hidden_load(t)
    extra = None if force is None else lambda x, v: -force(x, v)
    motion = integrate(M, C, K, 0.0 * K, load, 1 / (FS * finer), extra=extra)
    a, v, s = motion[:, ::finer]
    return Record(
        force=F[::finer],
        acceleration=a,
        velocity=v.cumsum(axis=1),
        displacement=s.cumsum(axis=1),
        fs=FS,
    )


def between(p, q, law):
    """A force between DOFs p and q (0: the ground) as a function of their motion."""

    def force(x, v):
        s = x[p - 1] - (x[q - 1] if q else 0.0)
        rate = v[p - 1] - (v[q - 1] if q else 0.0)
        out = np.zeros(3)
        out[p - 1] += law(s, rate)
        if q:
            out[q - 1] -= law(s, rate)
        return out

    return force


def loop(record, catalogue=CATALOGUE, noise=0.005, max_steps=4, **baseline):
    """The loop on a record with noise on every channel."""
    with warnings.catch_warnings(action="ignore"):
        noisy = add_noise(record, noise, random_state=1)
        declared = NRFRegressor(degree=1, **baseline)
        return close_loop(noisy, declared, catalogue, max_steps=max_steps)


def confirmed(report):
    """Confirmed steps by law and site."""
    return {(step.law, step.site): step for step in report.steps if step.confirmed}


def random_forces(n, seconds, forced, rms, band=(1, 35), fs=FS, seed=0):
    return excitation.band_limited_random(
        n, seconds, fs, excited=forced, rms=rms, band=band, random_state=seed
    )


# -- sites ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("ends", "law", "name", "parameters"),
    [
        ((3, 0), lambda s, v: 100.0 * v * abs(v), "quadratic_damping", {"c2": 100.0}),
        (
            (3, 1),
            lambda s, v: 2e4 * max(s - 1.0e-3, 0.0),
            "one_sided_gap",
            {"k": 2e4, "gap": 1.0e-3},
        ),
        # the frame bends
        ((3, 1), lambda s, v: -2e3 * s, "bending_coupling", {"kb": 2e3}),
    ],
)
def test_a_law_at_a_tie_or_a_brace_that_nobody_declared_is_found_there(
    ends, law, name, parameters
):
    p, q = ends
    (step,) = loop(shaken(between(p, q, law)), max_steps=1).steps
    assert (step.law, step.confirmed) == (name, True)
    assert step.site == (f"link {p}-{q}" if q else f"ground {p}")
    for key, value in parameters.items():
        assert step.parameters[key] == pytest.approx(value, rel=0.05)


def test_a_free_chain_may_turn_out_to_be_tied_to_the_ground():
    tried = [laws.LinkSpringDashpot()]
    report = loop(shaken(), tried, 0.0, chain=Chain(3, ground="free"))
    (step,) = report.steps
    assert str(Site(step.site)) == "storey 1"
    assert report.table["held-out"].iloc[-1] < 0.1


# -- several effects -----------------------------------------------------------


@pytest.fixture(scope="module")
def motor_and_bumper():
    """A motor on the second floor and a bumper in the third storey."""

    def motor(t):
        return np.multiply.outer(30.0 * np.sin(2 * np.pi * 11.0 * t), [0.0, 1.0, 0.0])

    def bumper(s, v):
        return 6e4 * max(s - 1e-3, 0.0)

    return loop(shaken(between(3, 2, bumper), motor))


def test_a_motor_and_a_bumper_are_both_found(motor_and_bumper):
    places = {("harmonic_force", "dof 2"), ("one_sided_gap", "storey 3")}
    assert set(confirmed(motor_and_bumper)) == places
    assert motor_and_bumper.model.masses == pytest.approx(M, rel=0.02)


def test_the_sizes_of_a_motor_and_a_bumper_are_found(motor_and_bumper):
    effects = confirmed(motor_and_bumper)
    motor = effects["harmonic_force", "dof 2"].parameters
    bumper = effects["one_sided_gap", "storey 3"].parameters
    assert motor["frequency"] == pytest.approx(11.0, rel=1e-3)
    assert np.hypot(motor["A"], motor["B"]) == pytest.approx(30.0, rel=0.05)
    assert bumper["gap"] == pytest.approx(1e-3, rel=0.05)
    assert bumper["k"] == pytest.approx(6e4, rel=0.05)


def test_a_wrong_gain_beside_a_cubic_spring_is_a_wrong_gain():
    record = shaken(between(2, 1, lambda s, v: 4e9 * s**3))
    acceleration = record.acceleration * [1.0, 1.0, 1.15]
    effects = confirmed(loop(record.replace(velocity=None, acceleration=acceleration)))
    assert set(effects) == {
        ("gain_error", "sensor a3"),
        ("cubic_stiffness", "storey 2"),
    }
    gain = effects["gain_error", "sensor a3"].parameters
    assert gain["e"] == pytest.approx(0.15, abs=0.02)


@pytest.mark.parametrize(
    ("forced", "rms", "added_laws"),
    [
        # none stands out
        ([1, 2, 3], 36.0, [laws.CoulombFriction(9.0)] * 3),
        (
            [3],
            60.0,
            [
                laws.CubicStiffness(4e9),
                laws.CoulombFriction(15.0),
                laws.CubicStiffness(4e9),
            ],
        ),
    ],
)
def test_laws_in_every_storey_are_found_and_confirmed(forced, rms, added_laws):
    """With one floor forced, a law hands its error on to the balance below until the
    law of that storey is there.
    """
    n = len(added_laws)
    storeys, wanted = {}, set()
    for i, (k, law) in enumerate(zip(np.linspace(1e5, 5e4, n), added_laws), 1):
        storeys[i] = [laws.LinearElastic(k), laws.LinearViscous(8e-4 * k), law]
        wanted.add((law.name, f"storey {i}"))
    truth = ChainModel(np.linspace(6.0, 4.0, n), storeys)
    record = simulate(truth, random_forces(n, 12.0, forced, rms), 1 / FS)
    tried = [laws.CoulombFriction(), laws.CubicStiffness(), laws.QuadraticDamping()]
    report = loop(record, tried, 0.01, max_steps=None)
    assert {(step.closest or step.law, step.site) for step in report.steps} == wanted
    assert all(step.confirmed for step in report.steps)
    heldout = report.table["held-out"]
    assert heldout.iloc[-1] < 0.5 * heldout.iloc[0]


# -- imperfect sensors ---------------------------------------------------------


def linear_storeys(n):
    """Springs and dashpots."""
    storeys = {}
    for i in range(n):
        storeys[i + 1] = [laws.LinearElastic(K[i]), laws.LinearViscous(C[i])]
    return storeys


def scattered(*effects):
    """Three floors, the top one forced; gains of the motion channels scatter by 1 %, as
    calibrations do.
    """
    storeys = linear_storeys(3)
    storeys[2] += effects
    record = simulate(ChainModel(M, storeys), random_forces(3, 12.0, [3], 40.0), 1 / FS)
    rng, changes = np.random.default_rng(3), {}
    for key in ("acceleration", "velocity", "displacement"):
        gains = 1 + 0.01 * rng.standard_normal(3)
        changes[key] = getattr(record, key) * gains
    return record.replace(**changes)


def test_calibrations_that_scatter_are_no_effect_of_the_structure():
    report = loop(scattered(), FORCES, 0.002)
    assert report.steps == []
    assert "errors of the channels" in report.stopped_because


def test_what_no_error_explains_is_an_effect():
    """The same, if channels are said to have no errors."""
    noisy = add_noise(scattered(), 0.002, random_state=1)
    none = {"gain": 0.0, "cross_axis": 0.0, "delay": 0.0}
    assert close_loop(noisy, catalogue=FORCES, calibration=none).steps


def test_an_effect_is_found_though_calibrations_scatter():
    effects = confirmed(loop(scattered(laws.CubicStiffness(4e9)), noise=0.002))
    assert ("cubic_stiffness", "storey 2") in effects
    for _, site in effects:
        assert site == "storey 2" or site.startswith("sensor")


def test_a_gain_that_differs_with_frequency_is_no_wrong_gain():
    """Under blows of three samples, straight between them, velocities are less than
    samples of accelerations show.
    """
    F = excitation.impact_hammer(
        3, 16.0, FS, excited=[2], level=100.0, n_hits=8, width=0.012, random_state=1
    )
    record = simulate(ChainModel(M, linear_storeys(3)), F, 1 / FS, hold="linear")
    assert loop(record, [laws.GainError(), laws.CubicStiffness()], 0.003).steps == []


def test_a_force_that_is_straight_between_samples_hides_no_oscillator():
    """Fused motions then lose some of their highest frequencies, as behind a filter
    that lags by part of a sample.
    """
    F = random_forces(2, 50.0, [2], 40.0, band=(1.5, 25), fs=80.0, seed=3)
    record = simulate(ChainModel(M[:2], linear_storeys(2)), F, 1 / 80, hold="linear")
    tried = [laws.HiddenOscillator(), laws.CubicStiffness(), laws.Inerter()]
    assert loop(record, tried, 0.003).steps == []


# -- intervals and verdicts ----------------------------------------------------


def test_intervals_of_a_law_hold_what_its_shape_allows():
    """Another power n goes with another coefficient and another dashpot."""
    k, c, n, cn = 9e5, 500.0, 0.5, 900.0
    linear = [laws.LinearElastic(k), laws.LinearViscous(c)]
    damped = [*linear, laws.PowerLawDamping(n=n, cn=cn)]
    F = random_forces(2, 25.0, [2], 700.0, band=(0.8, 22), fs=400.0, seed=1)
    model = ChainModel([420.0, 380.0], {1: linear, 2: damped})
    record = simulate(model, F, 1 / 400, hold="cubic").replace(velocity=None)
    report = loop(record, [laws.PowerLawDamping(), laws.CubicStiffness()], 0.004)

    (step,) = report.steps
    intervals = {**step.intervals, "c": report.bounds["storey 2: v"]}
    for name, truth in {"n": n, "cn": cn, "c": c}.items():
        low, high = intervals[name]
        # a twentieth of them may leave the truth, but none by far
        assert abs(low + high - 2 * truth) < 3 * (high - low)


def test_where_a_search_has_too_little_the_verdict_is_that_of_the_fit():
    """One blow a floor: no part of the record tells what another does."""
    linear = [laws.LinearElastic(5e4), laws.LinearViscous(30.0)]
    F = np.zeros((5000, 2))
    F[300:306, 0], F[2500:2506, 1] = 400.0, -300.0
    record = simulate(ChainModel([14.0, 11.0], {1: linear, 2: linear}), F, 1e-3)
    noisy = add_noise(record.replace(velocity=None), 0.002, random_state=3)
    fit, report = NRFRegressor(degree=1).fit(noisy), close_loop(noisy)
    assert report.verdict.state == fit.verdict().state == "green"
    assert report.model.masses == pytest.approx(fit.masses_, rel=1e-6)


# -- accelerations alone -------------------------------------------------------


def test_accelerations_alone_of_a_linear_chain_give_its_masses_and_no_effect():
    report = loop(shaken(seed=1).replace(velocity=None, displacement=None), noise=0.01)
    assert report.steps == []
    assert report.model.masses == pytest.approx(M, rel=0.02)


def test_accelerations_alone_show_a_gap_through_which_the_modes_are_swept():
    storeys = linear_storeys(3)
    storeys[2].append(laws.TwoSidedGap(1e-3, 4e4))
    F = np.zeros((5000, 3))
    F[:, 2] = 30.0 * chirp(np.arange(5000) / FS, 4.0, 20.0, 30.0, "logarithmic")
    record = simulate(ChainModel(M, storeys), F, 1 / FS)
    record = record.replace(velocity=None, displacement=None)
    tried = [laws.TwoSidedGap(), laws.CubicStiffness(), laws.GainError()]
    effects = confirmed(loop(record, tried, 0.01))
    assert set(effects) == {("two_sided_gap", "storey 2")}
    parameters = effects["two_sided_gap", "storey 2"].parameters
    assert parameters == pytest.approx({"gap": 1e-3, "k": 4e4}, rel=0.15)


# -- masses --------------------------------------------------------------------


def test_a_wrong_known_mass_of_a_floor_that_no_force_acts_on_is_named():
    declared = dict(enumerate(M, 1)) | {2: 1.25 * M[1]}
    tried = [
        laws.CoulombFriction(),
        laws.CubicStiffness(),
        laws.AddedMass(),
        laws.LinkSpringDashpot(),
    ]
    report = loop(shaken(forced=(3,)), tried, max_steps=1, known_masses=declared)
    (step,) = report.steps
    assert (step.law, step.site) == ("added_mass", "dof 2")
    assert step.parameters["dm"] == pytest.approx(-0.25 * M[1], rel=0.05)


# -- several laws of one family ------------------------------------------------


def soft_frame(in_storey_2=(), on_floor_2=()):
    """Two soft storeys with effects, 20 s at 200 Hz, both floors forced."""
    soft = [laws.LinearElastic(2e4), laws.LinearViscous(20.0)]
    sites = {1: soft, 2: [*soft, *in_storey_2], "dof 2": list(on_floor_2)}
    F = random_forces(2, 20.0, [1, 2], 30.0, band=(0.5, 40.0), fs=200.0)
    return simulate(ChainModel([12.0, 12.0], sites), F, 1 / 200)


def test_the_larger_of_two_harmonic_forces_on_one_floor_is_found():
    """There is one claim for each class and site."""
    # N by Hz
    true = {23.7: 14.0, 31.0: 9.0}
    motors = [laws.HarmonicForce(f, A, 0.0) for f, A in true.items()]
    report = loop(soft_frame(on_floor_2=motors), [laws.HarmonicForce()], 0.0)
    (step,) = report.steps
    values = step.parameters
    assert values["frequency"] == pytest.approx(23.7, abs=2e-3)
    assert np.hypot(values["A"], values["B"]) == pytest.approx(14.0, rel=0.02)
    assert report.verdict.state != "green"


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
    (step,) = loop(soft_frame(in_storey_2=[law]), catalogue, 0.01).steps
    names = {name for name, _, _ in step.rivals} | {step.law}
    assert step.site == "storey 2" and law.name in names
    for name, value in law.parameters.items():
        assert step.parameters[name] == pytest.approx(value, rel=0.05)


def test_a_bouc_wen_hysteresis_is_not_mended_by_simpler_ones():
    """Under an earthquake."""
    hysteresis = laws.BoucWen(beta=300.0, rho=0.0, n=1.5, alpha=4e4)
    below = [laws.LinearElastic(8.5e4), laws.LinearViscous(400.0), hysteresis]
    above = [laws.LinearElastic(7e4), laws.LinearViscous(200.0)]
    t = np.arange(6000) / 200.0
    shaking = random_forces(1, 30.0, [1], 1.5, band=(0.3, 12.0), fs=200.0, seed=3)
    ag = shaking[:, 0] * (t / 8 * np.exp(1 - t / 8)) ** 2
    truth, still = ChainModel([12.0, 9.0], {1: below, 2: above}), np.zeros((len(t), 2))
    record = simulate(truth, still, 1 / 200, base_acceleration=ag)
    tried = [laws.Dahl(), laws.Jenkins(), laws.BoucWen()]
    (step,) = loop(record, tried, 0.01, known_masses={1: 12.0, 2: 9.0}).steps
    assert (step.law, step.site) == ("bouc_wen", "storey 1")
    assert step.parameters["alpha"] == pytest.approx(4e4, rel=0.1)


@pytest.mark.parametrize("t0", [6.1, 9.7])
def test_a_step_in_a_heldout_piece_is_judged_on_the_others(t0):
    """What the search does not see it cannot date: the interval says so, and pieces
    without the instant confirm it.
    """
    storeys = {
        1: [laws.LinearElastic(4e4), laws.LinearViscous(40.0)],
        2: [laws.LinearElastic(3e4), laws.LinearViscous(40.0)],
    }
    storeys[2].append(laws.StiffnessStep(t0=t0, dk=-3e3))
    F = random_forces(2, 16.0, 2, 100.0, band=(1, 30), fs=200.0, seed=4)
    record = simulate(ChainModel([10.0, 8.0], storeys), F, 1 / 200)
    tried = [laws.StiffnessStep(), laws.CubicStiffness()]
    step = close_loop(record, catalogue=tried).steps[0]
    assert (step.law, step.site, step.confirmed) == ("stiffness_step", "storey 2", True)
    assert step.error_after < 0.5 * step.error_before

    first, last = step.intervals["t0"]
    assert first < t0 < last and last - first > 0.5
    low, high = step.intervals["dk"]
    assert low < -3e3 < high
