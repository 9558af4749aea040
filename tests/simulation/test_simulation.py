"""Free runs against independent integrators, exact solutions and conservation laws."""

from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.linalg import expm

from pysindy_nrf import Chain, ChainModel, Site, laws
from pysindy_nrf.exceptions import ChainError, ChannelError, SimulationError
from pysindy_nrf.simulation import classical_run, free_run, simulate

DT = 1e-3  # s
LINEAR = laws.PowerSeries(1, [100.0, 1e5])
DUFFING = laws.PowerSeries(3, [100.0, 1e5, 0, 0, 0, 0, 0, 0, 1e9])
DAHL = laws.ModifiedDahl(K0=50.0, C0=399.0, Fd=34.85, f0=0.0, sigma=5e4)
FIRST_STOREY = {"linear": (LINEAR,), "duffing": (DUFFING,), "dahl": (LINEAR, DAHL)}
SECOND_STOREY = {"linear": LINEAR, "duffing": DUFFING, "dahl": LINEAR}
METHODS = pytest.mark.parametrize("method", ["default", "newmark"])


def two_storeys(kind, masses=(10.0, 10.0)):
    return ChainModel(masses, {1: FIRST_STOREY[kind], 2: SECOND_STOREY[kind]})


def one_floor(*storey, mass=10.0):
    return ChainModel([mass], {1: storey})


def top_force(rms, n_samples=300, seed=0, n_dof=2):
    """White noise on the top floor."""
    F = np.zeros((n_samples, n_dof))
    F[:, -1] = rms * np.random.default_rng(seed).standard_normal(n_samples)
    return F


def assert_close(values, expected, share):
    """Equal up to a share of the largest value."""
    tolerance = share * np.abs(expected).max()
    np.testing.assert_allclose(values, expected, atol=tolerance, rtol=0)


# -- against SciPy -------------------------------------------------------------


def by_scipy(rate, F, y0):
    """States at the samples, with SciPy's spline through the forces."""
    times = DT * np.arange(len(F))
    course = CubicSpline(times, F)
    path = [np.asarray(y0, dtype=float)]
    for interval in pairwise(times):
        run = solve_ivp(
            lambda t, y: rate(y, course(t)),
            interval,
            path[-1],
            method="DOP853",
            rtol=1e-12,
            atol=1e-15,
        )
        path.append(run.y[:, -1])
    return np.array(path)


def rate_of_two_storeys(kind):
    """Rates of x1, x2, v1, v2 and of the state of the Dahl law."""
    k3 = 1e9 if kind == "duffing" else 0.0

    def rate(y, F):
        x1, x2, v1, v2 = y[:4]
        s2, r2 = x2 - x1, v2 - v1
        R1 = 1e5 * x1 + 100.0 * v1 + k3 * x1**3
        R2 = 1e5 * s2 + 100.0 * r2 + k3 * s2**3
        z_rate = []
        if kind == "dahl":
            z = y[4]
            R1 += 50.0 * x1 + 399.0 * v1 + 34.85 * z
            z_rate = [5e4 * (v1 - z * abs(v1))]
        return np.array([v1, v2, (F[0] - R1 + R2) / 10, (F[1] - R2) / 10, *z_rate])

    return rate


@pytest.mark.parametrize(
    ("kind", "rms", "n_states"),
    [
        ("linear", 200.0, 4),
        ("duffing", 800.0, 4),
        ("dahl", 50.0, 5),
        ("dahl", 800.0, 5),
    ],
)
def test_default_method_agrees_with_scipy(kind, rms, n_states):
    F = top_force(rms)
    truth = by_scipy(rate_of_two_storeys(kind), F, np.zeros(n_states))
    run = free_run(two_storeys(kind), F, DT)
    assert_close(run.record.displacement, truth[:, :2], 1e-8)
    assert_close(run.record.velocity, truth[:, 2:4], 1e-8)
    for states in run.states.values():
        np.testing.assert_allclose(states[:, 0], truth[:, 4], atol=1e-7)


def test_memory_that_knows_the_time_agrees_with_scipy():
    def rate(y, f):
        x, v, z = y
        return np.array([v, (f[0] - 100 * v - 1e5 * x - 5e4 * z) / 10, v - z / 0.02])

    F = top_force(100.0, 200, n_dof=1)
    model = one_floor(LINEAR, laws.MaxwellBranch(tau=0.02, k=5e4))
    record = simulate(model, F, DT)
    truth = by_scipy(rate, F, np.zeros(3))
    assert_close(record.displacement[:, 0], truth[:, 0], 1e-6)


@METHODS
def test_a_law_begins_from_a_given_state(method):
    def rate(y, f):
        x, v, z = y
        return np.array([v, (f[0] - 100 * v - 1e5 * x - 5e4 * z) / 10, v - z / 0.02])

    F = top_force(100.0, 200, n_dof=1)
    model = one_floor(LINEAR, laws.MaxwellBranch(tau=0.02, k=5e4))
    states = {(Site("storey 1"), 1): [3e-3]}
    record = simulate(model, F, DT, x0=[1e-3], v0=[0.0], states=states, method=method)
    truth = by_scipy(rate, F, [1e-3, 0.0, 3e-3])
    tolerance = 1e-6 if method == "default" else 0.05
    assert_close(record.displacement[:, 0], truth[:, 0], tolerance)


@pytest.mark.parametrize(
    ("place", "values"), [(("storey 1", 0), [0.0]), (("storey 1", 1), [np.nan])]
)
def test_a_state_that_no_law_has_is_refused(place, values):
    model = one_floor(LINEAR, laws.MaxwellBranch(tau=0.02, k=5e4))
    states = {(Site(place[0]), place[1]): values}
    with pytest.raises(ChannelError, match="storey 1"):
        simulate(model, top_force(100.0, 20, n_dof=1), DT, states=states)


# -- conservation --------------------------------------------------------------


@pytest.mark.parametrize("kind", ["linear", "duffing", "dahl"])
def test_energy_and_sampled_balance_close(kind):
    F = top_force(200.0, 2000)
    run = free_run(two_storeys(kind), F, DT)
    assert run.energy_gap < 1e-6
    assert run.energy["input"].iloc[-1] > 0

    k3 = 1e9 if kind == "duffing" else 0.0
    s = np.diff(run.record.displacement)[:, 0]
    v = np.diff(run.record.velocity)[:, 0]
    R2 = 1e5 * s + 100 * v + k3 * s**3
    gap = 10 * run.record.acceleration[:, 1] + R2 - F[:, 1]
    assert np.abs(gap).max() < 1e-12 * np.abs(F).max()


def test_floating_chain_keeps_its_momentum():
    masses = np.array([5.0, 7.0])
    F = top_force(100.0, 500)
    storey = (LINEAR, laws.Dahl(sigma=1e4, Fd=20.0))
    model = ChainModel(masses, {2: storey}, chain=Chain(2, ground="free"))
    record = simulate(model, F, DT, hold="linear")
    impulses = 0.5 * DT * (F[1:, 1] + F[:-1, 1])
    momentum = np.concatenate([[0.0], np.cumsum(impulses)])
    assert_close(record.velocity @ masses, momentum, 1e-11)


# -- exact solutions -----------------------------------------------------------


@pytest.mark.parametrize("ground", ["base", "both", "free"])
def test_linear_decay_with_extra_links_is_the_matrix_exponential(ground):
    chain = Chain(3, links=["link 3-1"], ground=ground)
    M = np.diag([8.0, 10.0, 12.0])
    K = np.zeros((3, 3))
    C = np.zeros((3, 3))
    by_site = {}
    for number, site in enumerate([*chain.sites, Site("dof 2")], 1):
        k, c = 4e4 * number, 30.0 * number
        by_site[site] = laws.PowerSeries(1, [c, k])
        incidence = np.array([site.incidence(j) for j in (1, 2, 3)], dtype=float)
        K += k * np.outer(incidence, incidence)
        C += c * np.outer(incidence, incidence)
    x0 = [1e-3, -2e-3, 5e-4]
    v0 = [0.1, 0.0, -0.2]

    model = ChainModel(M.diagonal(), by_site, chain=chain)
    record = simulate(model, np.zeros((101, 3)), 2e-3, x0=x0, v0=v0)

    lower = -np.linalg.solve(M, np.hstack([K, C]))
    A = np.vstack([np.eye(6)[3:], lower])
    truth = np.array([expm(A * t) @ [*x0, *v0] for t in record.time])
    np.testing.assert_allclose(record.displacement, truth[:, :3], atol=1e-11)
    np.testing.assert_allclose(record.velocity, truth[:, 3:], atol=1e-8)


def test_newmark_of_a_linear_oscillator_shortens_frequency_as_theory_says():
    """Average acceleration turns w into (2 / dt) atan(w dt / 2), at any amplitude."""
    w = 100.0
    dt = 2e-3
    model = one_floor(laws.LinearElastic(k=10.0 * w**2))
    record = simulate(model, np.zeros((2001, 1)), dt, method="newmark", x0=[1e-3])
    expected = 1e-3 * np.cos(2 / dt * np.arctan(w * dt / 2) * record.time)
    np.testing.assert_allclose(record.displacement[:, 0], expected, atol=1e-11)


@pytest.mark.parametrize(
    ("rule", "order"), [(partial(simulate, method="newmark"), 2), (classical_run, 4)]
)
def test_order_of_the_rules_of_fixed_step(rule, order):
    """The error of a Duffing oscillator falls with the power of dt of theory."""

    def end(dt, rule):
        t = np.arange(round(0.2 / dt) + 1) * dt
        F = np.column_stack([0 * t, 300 * np.sin(60 * t) ** 2])
        return rule(two_storeys("duffing"), F, dt, hold="cubic").displacement[-1]

    truth = end(5e-4, simulate)
    coarse = np.abs(end(2e-3, rule) - truth).max()
    fine = np.abs(end(1e-3, rule) - truth).max()
    assert abs(np.log2(coarse / fine) - order) < 0.35


@pytest.mark.parametrize(
    ("hold", "velocity"),
    [("zero", [0, 0, 0, 0.1, 0.1, 0.1]), ("linear", [0, 0, 0.05, 0.1, 0.1, 0.1])],
)
def test_a_force_between_its_samples(hold, velocity):
    """One sample of 1 N on a free mass of 1 kg: as a step, and as a hat."""
    model = ChainModel([1.0], {}, chain=Chain(1, ground="free"))
    F = np.zeros((6, 1))
    F[2] = 1.0
    record = simulate(model, F, 0.1, hold=hold)
    np.testing.assert_allclose(record.velocity[:, 0], velocity, atol=1e-15)


# -- coefficients that change --------------------------------------------------


def test_a_stiffness_that_falls_as_its_course_says():
    # x = exp(-t^2 / 2) solves x'' + (1 - t^2) x = 0
    t = np.arange(201) * 0.01
    model = ChainModel([1.0], {1: laws.LinearElastic(1.0)})
    course = {"storey 1: s": 1.0 - t**2}
    run = simulate(model, np.zeros((201, 1)), 0.01, x0=[1.0], courses=course)
    np.testing.assert_allclose(run.displacement[:, 0], np.exp(-(t**2) / 2), atol=1e-8)


# -- base motion and masses ----------------------------------------------------


@METHODS
def test_base_motion_is_an_inertia_force_on_the_relative_motion(method):
    ag = top_force(3.0, 400)[:, 1]
    model = two_storeys("dahl")
    loads = -np.outer(ag, model.masses)
    rest = np.zeros((400, 2))
    shaken = simulate(model, rest, DT, base_acceleration=ag, method=method)
    pushed = simulate(model, loads, DT, method=method)
    np.testing.assert_allclose(shaken.displacement, pushed.displacement, atol=1e-14)
    absolute = pushed.acceleration + ag[:, None]
    np.testing.assert_allclose(shaken.acceleration, absolute, atol=1e-9)
    np.testing.assert_array_equal(shaken.base_acceleration, ag)
    assert not np.shares_memory(shaken.base_acceleration, ag)


@METHODS
def test_an_added_mass_is_a_mass(method):
    heavy = two_storeys("linear", masses=[14.0, 10.0])
    loaded = ChainModel(
        [10.0, 10.0], {1: LINEAR, 2: LINEAR, "dof 1": laws.AddedMass(dm=4.0)}
    )
    ag = top_force(3.0, 300)[:, 1]
    drive = partial(simulate, F=top_force(100.0, 300, seed=1), dt=DT, method=method)
    expected = drive(heavy, base_acceleration=ag).displacement
    assert_close(drive(loaded, base_acceleration=ag).displacement, expected, 1e-10)


@METHODS
def test_an_inerter_to_the_ground_is_a_mass(method):
    heavy = two_storeys("linear", masses=[14.0, 10.0])
    inert = ChainModel([10.0, 10.0], {1: (LINEAR, laws.Inerter(b=4.0)), 2: LINEAR})
    drive = partial(simulate, F=top_force(100.0, 300, seed=1), dt=DT, method=method)
    assert_close(drive(inert).displacement, drive(heavy).displacement, 1e-10)


def with_added_mass(dm):
    return ChainModel(
        [10.0, 12.0], {1: LINEAR, 2: LINEAR, "dof 2": laws.AddedMass(dm=dm)}
    )


@METHODS
def test_a_floor_that_laws_leave_no_mass_is_refused(method):
    """12 kg less 13 kg: a spring would push such a floor away."""
    with pytest.raises(SimulationError, match="DOF 2 has 12 kg"):
        simulate(with_added_mass(-13.0), np.ones((20, 2)), DT, method=method)
    with pytest.raises(ChainError, match="DOF 2 has 12 kg"):
        with_added_mass(-13.0).modes()


@METHODS
def test_a_floor_that_laws_leave_little_mass_is_light(method):
    light = two_storeys("linear", masses=[10.0, 1.0])
    lightened = with_added_mass(-11.0)
    np.testing.assert_allclose(lightened.modes(), light.modes(), rtol=1e-9)
    drive = partial(simulate, F=np.ones((20, 2)), dt=DT, method=method)
    assert_close(drive(lightened).displacement, drive(light).displacement, 1e-9)


# -- dry friction --------------------------------------------------------------

RUBBING = (laws.LinearElastic(k=1e4), laws.CoulombFriction(Fc=20.0))


def test_friction_takes_four_friction_drifts_a_cycle_until_it_sticks():
    x0 = 0.0152  # m
    friction_drift = 20.0 / 1e4
    half_period = np.pi * np.sqrt(10.0 / 1e4)
    run = free_run(one_floor(*RUBBING), np.zeros((1201, 1)), half_period / 200, x0=[x0])
    turns = run.record.displacement[:800:200, 0]
    amplitudes = x0 - 2 * friction_drift * np.arange(4)
    np.testing.assert_allclose(turns, amplitudes * [1, -1, 1, -1], atol=1e-9)
    assert np.abs(run.record.displacement[-1, 0]) < friction_drift
    assert not run.record.velocity[-200:].any()
    assert run.quality.forced == 0
    assert run.energy_gap < 1e-9


def test_friction_holds_below_its_level_and_slips_above():
    """10 x'' + 1e4 x = 40 tau from rest: x = b / k (tau - sin(w tau) / w)."""
    t = np.arange(1000) * DT
    record = simulate(one_floor(*RUBBING), 40.0 * t[:, None], DT)
    x = record.displacement[:, 0]
    assert not x[t < 0.499].any()
    assert x[-1] > 1e-3

    slips = t >= 0.501
    tau = t[slips] - 0.5
    w = np.sqrt(1e3)
    expected = 40.0 / 1e4 * (tau - np.sin(w * tau) / w)
    np.testing.assert_allclose(x[slips], expected, atol=1e-8)


# -- runs that end early, and wrong input --------------------------------------


def test_divergence_names_time_and_dof():
    model = one_floor(laws.Duffing(k=100.0, k3=-1e6), mass=1.0)
    with pytest.raises(SimulationError, match=r"diverges at [\d.]+ s, at DOF"):
        simulate(model, np.full((1000, 1), 50.0), DT)


def test_a_run_ends_where_it_exceeds_its_limit():
    """x = x0 exp(2 t) of a negative spring is ten times x0 after 1.151 s."""
    model = one_floor(laws.LinearElastic(-4.0), mass=1.0)
    drive = partial(simulate, model, np.zeros((300, 1)), 0.01, x0=[1e-3], v0=[2e-3])
    assert drive().displacement.max() > 0.1
    with pytest.raises(SimulationError, match=r"diverges at 1\.15 s"):
        drive(limit=1e-2)
    with pytest.raises(SimulationError, match="limit=-1"):
        drive(limit=-1)


@pytest.mark.parametrize(
    ("argument", "message"),
    [
        ({"F": np.zeros((50, 3))}, "columns"),
        ({"F": np.full((50, 2), np.nan)}, "F1"),
        ({"F": None}, "Nothing drives"),
        ({"F": np.zeros((1, 2))}, "has 1 samples"),
        ({"x0": [0.0]}, "x0"),
        ({"v0": [0.0, np.inf]}, "v2"),
        ({"base_acceleration": np.zeros(49)}, "ag"),
        ({"dt": 0.0}, "dt"),
        ({"method": "rk4"}, "method='rk4' is unknown"),
        ({"hold": "quintic"}, "hold"),
        ({"t0": "noon"}, "t0='noon'"),
        ({"courses": {"storey 9: s": np.ones(50)}}, "no coefficient 'storey 9: s'"),
        ({"courses": {"storey 1: s": np.ones(49)}}, "49 samples"),
    ],
)
def test_wrong_input_is_named(argument, message):
    arguments = {"F": np.zeros((50, 2)), "dt": DT} | argument
    with pytest.raises((ChannelError, SimulationError), match=message):
        simulate(two_storeys("linear"), **arguments)


def test_input_is_left_alone():
    F = top_force(10.0, 50)
    x0 = np.array([1e-3, 0.0])
    F_before, x0_before = F.copy(), x0.copy()
    record = simulate(two_storeys("dahl"), F, DT, x0=x0)
    record.force[:] = 1.0
    np.testing.assert_array_equal(F, F_before)
    np.testing.assert_array_equal(x0, x0_before)


# -- the clock of the laws -----------------------------------------------------


@pytest.fixture
def changing():
    """Two storeys whose forces know the time, and forces of 5 s at 200 Hz."""
    first = [laws.LinearElastic(2e4), laws.LinearViscous(15.0)]
    second = [laws.LinearElastic(1e4), laws.LinearViscous(9.0)]
    by_site = {
        1: [*first, laws.StiffnessDrift(kt=-900.0)],
        2: [*second, laws.StiffnessStep(t0=3.1, dk=4e3)],
        "dof 2": [laws.HarmonicForce(frequency=3.3, A=4.0, B=-7.0)],
    }
    steps = np.random.default_rng(2).standard_normal((1001, 2))
    return ChainModel([8.0, 5.0], by_site), np.cumsum(steps, axis=0)


@METHODS
def test_a_run_that_is_continued_finds_the_clock_of_its_laws(changing, method):
    model, F = changing
    record = simulate(model, F, 0.005, method=method, hold="linear")
    go_on = partial(
        simulate,
        model,
        F[500:],
        0.005,
        method=method,
        hold="linear",
        x0=record.displacement[500],
        v0=record.velocity[500],
    )
    in_time = go_on(t0=2.5)
    too_early = go_on()
    assert in_time.time[0] == 2.5
    assert_close(in_time.displacement, record.displacement[500:], 1e-9)
    gap = np.abs(too_early.displacement - record.displacement[500:]).max()
    assert gap > 1e-2 * np.abs(record.displacement).max()


def test_energies_are_on_the_clock_of_the_run(changing):
    model, F = changing
    energy = free_run(model, F, 0.005, t0=2.5).energy
    assert energy.index[0] == 2.5


# -- between the samples -------------------------------------------------------


FREQUENCY = 60.0  # Hz, of a force that is sampled at 400 Hz


def motion_of_a_cosine_force():
    """One floor under 100 N cos(wt), from the motion in steady state; and its run."""
    t = np.arange(800) / 400
    w = 2 * np.pi * FREQUENCY
    answer = 100.0 / (1e5 - 10.0 * w**2 + 1j * w * 100.0)
    x = (answer * np.exp(1j * w * t)).real
    v = (1j * w * answer * np.exp(1j * w * t)).real
    F = 100.0 * np.cos(w * t)[:, None]
    return F, x, v


def test_a_measured_force_is_band_limited_from_the_first_sample_to_the_last():
    """A spline loses 0.13 % of a cosine of 6.7 samples, straight lines 7 %: the fourth
    powers of sinc over the sum of their images, and its square. A spline that were
    straight at its ends would start as badly.
    """
    F, x, v = motion_of_a_cosine_force()
    run = simulate(one_floor(LINEAR), F, 1 / 400, x0=x[:1], v0=v[:1])
    np.testing.assert_allclose(run.displacement[:, 0], x, atol=0.03 * x.max())
    np.testing.assert_allclose(
        run.displacement[-100:, 0], x[-100:], atol=2e-3 * x.max()
    )
    first, last = slice(0, 5), slice(-5, None)
    for ends in (first, last):
        np.testing.assert_allclose(
            run.velocity[ends, 0], v[ends], atol=0.01 * np.abs(v).max()
        )


def test_a_force_that_is_said_to_be_held_is_run_so():
    F = top_force(100.0, 400, n_dof=1)
    model = one_floor(LINEAR)
    for hold in ("cubic", "linear", "zero"):
        assert simulate(model, F, DT, hold=hold).hold == hold
    assert simulate(model, F, DT, method="newmark").hold is None
