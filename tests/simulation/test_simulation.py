"""Free runs against independent integrators, exact solutions and conservation laws."""

from functools import partial

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from pysindy_nrf import Chain, ChainModel, Site, laws
from pysindy_nrf.exceptions import ChainError, ChannelError, SimulationError
from pysindy_nrf.simulation import free_run, simulate
from pysindy_nrf.simulation.api import classical_run

DT = 1e-3
LINEAR = laws.PowerSeries(1, [100.0, 1e5])
DUFFING = laws.PowerSeries(3, [100.0, 1e5, 0, 0, 0, 0, 0, 0, 1e9])
DAHL = laws.ModifiedDahl(K0=50.0, C0=399.0, Fd=34.85, f0=0.0, sigma=5e4)


def model(chain, masses, **by_site):
    return ChainModel(
        masses,
        {text.replace("_", " "): group for text, group in by_site.items()},
        chain=chain,
    )


def two_storeys(kind):
    first = {"linear": LINEAR, "duffing": DUFFING, "dahl": (LINEAR, DAHL)}[kind]
    return model(
        Chain(2),
        [10.0, 10.0],
        storey_1=first,
        storey_2=LINEAR if kind == "dahl" else first,
    )


def by_scipy(rate, F, dt, y0):
    """Integrate sample interval by sample interval under straight lines between the
    forces.
    """
    path = [np.asarray(y0, dtype=float)]
    for f0, f1 in zip(F[:-1], F[1:]):

        def field(t, y, f0=f0, f1=f1):
            return rate(y, f0 + (f1 - f0) * t / dt)

        path.append(
            solve_ivp(
                field, (0, dt), path[-1], method="DOP853", rtol=1e-12, atol=1e-15
            ).y[:, -1]
        )
    return np.array(path)


def two_storey_rate(kind):
    k3 = 1e9 if kind == "duffing" else 0.0

    def rate(y, F):
        s, r = np.array([y[0], y[1] - y[0]]), np.array([y[2], y[3] - y[2]])
        R = 1e5 * s + 100.0 * r + k3 * s**3
        rest = []
        if kind == "dahl":
            R[0] += 50.0 * s[0] + 399.0 * r[0] + 34.85 * y[4]
            rest = [5e4 * (r[0] - y[4] * abs(r[0]))]
        return np.array(
            [y[2], y[3], (F[0] - R[0] + R[1]) / 10, (F[1] - R[1]) / 10, *rest]
        )

    return rate


def top_force(rms, n=300, seed=0, n_dof=2):
    F = np.zeros((n, n_dof))
    F[:, -1] = rms * np.random.default_rng(seed).standard_normal(n)
    return F


@pytest.mark.parametrize(
    "kind, rms",
    [("linear", 200.0), ("duffing", 800.0), ("dahl", 50.0), ("dahl", 800.0)],
)
def test_default_method_agrees_with_scipy(kind, rms):
    F = top_force(rms)
    truth = by_scipy(two_storey_rate(kind), F, DT, np.zeros(5 if kind == "dahl" else 4))
    run = free_run(two_storeys(kind), F, DT)
    np.testing.assert_allclose(
        run.record.displacement,
        truth[:, :2],
        atol=1e-8 * np.abs(truth[:, :2]).max(),
        rtol=0,
    )
    np.testing.assert_allclose(
        run.record.velocity,
        truth[:, 2:4],
        atol=1e-8 * np.abs(truth[:, 2:4]).max(),
        rtol=0,
    )
    if kind == "dahl":
        ((_, states),) = run.states.items()
        np.testing.assert_allclose(states[:, 0], truth[:, 4], atol=1e-7)


@pytest.mark.parametrize("kind", ["linear", "duffing", "dahl"])
def test_energy_and_sampled_balance_close(kind):
    F = top_force(200.0, 2000)
    run = free_run(two_storeys(kind), F, DT)
    assert run.energy_gap < 1e-6
    assert run.energy["input"].iloc[-1] > 0
    a, x, v = run.record.acceleration, run.record.displacement, run.record.velocity
    R2 = (
        1e5 * (x[:, 1] - x[:, 0])
        + 100 * (v[:, 1] - v[:, 0])
        + (1e9 if kind == "duffing" else 0) * (x[:, 1] - x[:, 0]) ** 3
    )
    assert np.abs(10 * a[:, 1] + R2 - F[:, 1]).max() < 1e-12 * np.abs(F).max()


def linear_system(M, K, C, x0, v0, t):
    n = len(M)
    A = np.block(
        [
            [np.zeros((n, n)), np.eye(n)],
            [-np.linalg.solve(M, K), -np.linalg.solve(M, C)],
        ]
    )
    return np.array([expm(A * s) @ np.r_[x0, v0] for s in t])


@pytest.mark.parametrize("ground", ["base", "both", "free"])
def test_linear_decay_with_extra_links_is_the_matrix_exponential(ground):
    chain = Chain(3, links=["link 3-1"], ground=ground)
    masses, groups = [8.0, 10.0, 12.0], {}
    M, K, C = np.diag(masses), np.zeros((3, 3)), np.zeros((3, 3))
    for i, site in enumerate([*chain.sites, Site("dof 2")]):
        k, c = 4e4 * (i + 1), 30.0 * (i + 1)
        groups[site.replace(" ", "_")] = laws.PowerSeries(1, [c, k])
        b = np.array([site.incidence(j) for j in (1, 2, 3)], dtype=float)
        K += k * np.outer(b, b)
        C += c * np.outer(b, b)
    x0, v0 = [1e-3, -2e-3, 5e-4], [0.1, 0.0, -0.2]
    rec = simulate(
        model(chain, masses, **groups), np.zeros((101, 3)), 2e-3, x0=x0, v0=v0
    )
    truth = linear_system(M, K, C, x0, v0, rec.time)
    np.testing.assert_allclose(rec.displacement, truth[:, :3], atol=1e-11)
    np.testing.assert_allclose(rec.velocity, truth[:, 3:], atol=1e-8)


def test_floating_chain_keeps_its_momentum():
    m = np.array([5.0, 7.0])
    F = top_force(100.0, 500)
    rec = simulate(
        model(
            Chain(2, ground="free"), m, storey_2=(LINEAR, laws.Dahl(sigma=1e4, Fd=20.0))
        ),
        F,
        DT,
    )
    impulse = np.concatenate([[0.0], np.cumsum(0.5 * DT * (F[1:, 1] + F[:-1, 1]))])
    np.testing.assert_allclose(
        rec.velocity @ m, impulse, atol=1e-12 * np.abs(impulse).max() + 1e-12
    )


@pytest.mark.parametrize("method", ["default", "newmark"])
def test_base_motion_is_an_inertia_force_on_the_relative_motion(method):
    ag = top_force(3.0, 400)[:, 1]
    case = two_storeys("dahl")
    moved = simulate(case, np.zeros((400, 2)), DT, base_acceleration=ag, method=method)
    pushed = simulate(case, -np.outer(ag, case.masses), DT, method=method)
    np.testing.assert_allclose(moved.displacement, pushed.displacement, atol=1e-14)
    np.testing.assert_allclose(
        moved.acceleration, pushed.acceleration + ag[:, None], atol=1e-9
    )
    assert moved.base_acceleration is not None and not np.shares_memory(
        moved.base_acceleration, ag
    )


@pytest.mark.parametrize("method", ["default", "newmark"])
def test_added_mass_and_inerter_are_masses(method):
    ag, F = top_force(3.0, 300)[:, 1], top_force(100.0, 300, seed=1)
    heavy = model(Chain(2), [14.0, 10.0], storey_1=LINEAR, storey_2=LINEAR)
    loaded = model(
        Chain(2),
        [10.0, 10.0],
        storey_1=LINEAR,
        storey_2=LINEAR,
        dof_1=laws.AddedMass(dm=4.0),
    )
    inert = model(
        Chain(2), [10.0, 10.0], storey_1=(LINEAR, laws.Inerter(b=4.0)), storey_2=LINEAR
    )
    truth = simulate(heavy, F, DT, base_acceleration=ag, method=method).displacement
    atol = 1e-10 * np.abs(truth).max()
    np.testing.assert_allclose(
        simulate(loaded, F, DT, base_acceleration=ag, method=method).displacement,
        truth,
        atol=atol,
    )
    truth = simulate(heavy, F, DT, method=method).displacement
    np.testing.assert_allclose(
        simulate(inert, F, DT, method=method).displacement, truth, atol=atol
    )


@pytest.mark.parametrize("method", ["default", "newmark"])
def test_a_dof_that_laws_leave_no_mass_is_named(method):
    """12 kg less 13 kg: a spring would push such a floor away; with 11 kg less it is a
    floor of 1 kg.
    """

    def load(dm):
        return ChainModel(
            [10.0, 12.0], {1: LINEAR, 2: LINEAR, "dof 2": laws.AddedMass(dm=dm)}
        )

    with pytest.raises(
        SimulationError, match="DOF 2 has 12 kg and -13 kg added to it, -1 kg in all"
    ):
        load(-13.0).simulate(np.ones((20, 2)), DT, method=method)
    with pytest.raises(
        ChainError, match="DOF 2 has 12 kg and -13 kg added to it, -1 kg in all"
    ):
        load(-13.0).modes()
    light = ChainModel([10.0, 1.0], {1: LINEAR, 2: LINEAR})
    np.testing.assert_allclose(load(-11.0).modes(), light.modes(), rtol=1e-9)
    runs = [
        m.simulate(np.ones((20, 2)), DT, method=method).displacement
        for m in (load(-11.0), light)
    ]
    np.testing.assert_allclose(*runs, rtol=1e-9, atol=1e-14)


def test_coulomb_friction_decays_by_four_friction_drifts_a_cycle_and_then_sticks():
    m, k, Fc, x0 = 10.0, 1e4, 20.0, 0.0152
    case = model(
        Chain(1), [m], storey_1=(laws.LinearElastic(k=k), laws.CoulombFriction(Fc=Fc))
    )
    half = np.pi * np.sqrt(m / k)
    run = free_run(case, np.zeros((1201, 1)), half / 200, x0=[x0])
    turns = run.record.displacement[:1001:200, 0]
    expected = [(-1) ** i * (x0 - 2 * i * Fc / k) for i in range(4)]
    np.testing.assert_allclose(turns[:4], expected, atol=1e-9)
    assert (
        np.abs(run.record.displacement[-1, 0]) < Fc / k
        and (run.record.velocity[-200:] == 0).all()
    )
    assert run.quality.forced == 0 and run.energy_gap < 1e-9


def test_dry_friction_holds_below_its_level_and_slips_above():
    case = model(
        Chain(1),
        [10.0],
        storey_1=(laws.LinearElastic(k=1e4), laws.CoulombFriction(Fc=20.0)),
    )
    t = np.arange(1000) * DT
    rec = simulate(case, (40.0 * t)[:, None], DT)
    x = rec.displacement[:, 0]
    assert (x[t < 0.499] == 0).all() and x[-1] > 1e-3
    slip = t >= 0.501
    w, b = np.sqrt(1e3), 40.0
    tau = (
        t[slip] - 0.5
        # 10 x'' + 1e4 x = 40 tau from rest: x = b/k (tau - sin(w tau)/w), never
        # backwards
    )
    np.testing.assert_allclose(
        x[slip], b / 1e4 * (tau - np.sin(w * tau) / w), atol=1e-8
    )


def test_rate_dependent_memory_agrees_with_scipy():
    F = top_force(100.0, 200, n_dof=1)
    rec = simulate(
        model(Chain(1), [10.0], storey_1=(LINEAR, laws.MaxwellBranch(tau=0.02, k=5e4))),
        F,
        DT,
    )

    def rate(y, f):
        return np.array(
            [
                y[1],
                (f[0] - 100 * y[1] - 1e5 * y[0] - 5e4 * y[2]) / 10,
                y[1] - y[2] / 0.02,
            ]
        )

    truth = by_scipy(rate, F, DT, np.zeros(3))
    np.testing.assert_allclose(
        rec.displacement[:, 0], truth[:, 0], atol=1e-6 * np.abs(truth[:, 0]).max()
    )


@pytest.mark.parametrize(
    "rule, order", [(partial(simulate, method="newmark"), 2), (classical_run, 4)]
)
def test_order_of_the_fixed_step_rules(rule, order):
    """The error of a Duffing oscillator falls with the power of dt that theory
    gives.
    """
    case = model(Chain(2), [10.0, 10.0], storey_1=DUFFING, storey_2=DUFFING)

    def end(dt, rule):
        n = round(0.2 / dt) + 1
        F = np.column_stack([np.zeros(n), 300 * np.sin(60 * np.arange(n) * dt) ** 2])
        return rule(case, F, dt, hold="cubic").displacement[-1]

    truth = end(5e-4, simulate)
    errors = [np.abs(end(dt, rule) - truth).max() for dt in (2e-3, 1e-3)]
    assert abs(np.log2(errors[0] / errors[1]) - order) < 0.35


def test_newmark_of_a_linear_oscillator_shortens_frequency_as_theory_says():
    """Average acceleration turns w into (2 / dt) atan(w dt / 2) and keeps the
    amplitude.
    """
    w, dt = 100.0, 2e-3
    case = model(Chain(1), [10.0], storey_1=laws.LinearElastic(k=10.0 * w**2))
    rec = simulate(case, np.zeros((2001, 1)), dt, method="newmark", x0=[1e-3])
    expected = 1e-3 * np.cos(2 / dt * np.arctan(w * dt / 2) * rec.time)
    np.testing.assert_allclose(rec.displacement[:, 0], expected, atol=1e-11)


def test_holds_are_what_they_say():
    """One force sample of 1 N: the impulse is dt as a step and as a hat."""
    case = model(Chain(1, ground="free"), [1.0])
    F = np.zeros((6, 1))
    F[2] = 1.0
    step = simulate(case, F, 0.1, hold="zero")
    hat = simulate(case, F, 0.1, hold="linear")
    np.testing.assert_allclose(
        step.velocity[:, 0], [0, 0, 0, 0.1, 0.1, 0.1], atol=1e-15
    )
    np.testing.assert_allclose(
        hat.velocity[:, 0], [0, 0, 0.05, 0.1, 0.1, 0.1], atol=1e-15
    )


def test_divergence_names_time_and_dof():
    case = model(Chain(1), [1.0], storey_1=laws.Duffing(k=100.0, k3=-1e6))
    with pytest.raises(SimulationError, match=r"diverges at [\d.]+ s, at DOF 1"):
        simulate(case, np.full((1000, 1), 50.0), DT)


def test_a_run_ends_where_it_exceeds_its_limit():
    """x = x0 exp(2 t) of a negative spring is ten times as large after ln(10) / 2 =
    1.151 s.
    """
    model, rest = ChainModel([1.0], {1: laws.LinearElastic(-4.0)}), np.zeros((300, 1))
    with pytest.raises(SimulationError, match=r"diverges at 1\.15 s, at DOF 1"):
        simulate(model, rest, 0.01, x0=[1e-3], v0=[2e-3], limit=1e-2)
    assert simulate(model, rest, 0.01, x0=[1e-3], v0=[2e-3]).displacement.max() > 0.1
    with pytest.raises(SimulationError, match="limit=-1 is not a positive number"):
        simulate(model, rest, 0.01, limit=-1)


@pytest.mark.parametrize(
    "change, word",
    [
        ({"F": np.zeros((50, 3))}, "columns"),
        ({"F": np.full((50, 2), np.nan)}, "F1"),
        ({"x0": [0.0]}, "x0"),
        ({"v0": [0.0, np.inf]}, "v2"),
        ({"base_acceleration": np.zeros(49)}, "ag"),
        ({"dt": 0.0}, "dt"),
        ({"method": "rk4"}, "method='rk4' is unknown.*Choose 'default' or 'newmark'"),
        ({"hold": "quintic"}, "hold"),
    ],
)
def test_bad_input_is_named(change, word):
    call = {"F": np.zeros((50, 2)), "dt": DT} | change
    with pytest.raises((ChannelError, SimulationError), match=word):
        simulate(two_storeys("linear"), **call)


def test_input_is_left_alone():
    F, x0 = top_force(10.0, 50), np.array([1e-3, 0.0])
    kept = F.copy(), x0.copy()
    rec = simulate(two_storeys("dahl"), F, DT, x0=x0)
    assert np.array_equal(F, kept[0]) and np.array_equal(x0, kept[1])
    rec.force[:] = 1.0
    assert np.array_equal(F, kept[0])


@pytest.mark.parametrize("method", ["default", "newmark"])
def test_a_run_that_begins_later_finds_the_clock_of_its_laws(method):
    """Cut in two and started again from the state in the middle, the run is the same:
    forces that know the time go on.
    """
    held = {
        Site(1): (
            laws.LinearElastic(2e4),
            laws.LinearViscous(15.0),
            laws.StiffnessDrift(kt=-900.0),
        ),
        Site(2): (
            laws.LinearElastic(1e4),
            laws.LinearViscous(9.0),
            laws.StiffnessStep(t0=3.1, dk=4e3),
        ),
        Site("dof 2"): (laws.HarmonicForce(frequency=3.3, A=4.0, B=-7.0),),
    }
    model = ChainModel([8.0, 5.0], held)
    F = np.cumsum(np.random.default_rng(2).standard_normal((1001, 2)), axis=0)
    whole = simulate(model, F, 0.005, method=method)
    late = simulate(
        model,
        F[500:],
        0.005,
        method=method,
        t0=2.5,
        x0=whole.displacement[500],
        v0=whole.velocity[500],
        name="late",
    )
    assert late.time[0] == 2.5
    scale = np.abs(whole.displacement).max()
    assert np.abs(late.displacement - whole.displacement[500:]).max() < 1e-9 * scale
    lost = simulate(
        model,
        F[500:],
        0.005,
        method=method,
        x0=whole.displacement[500],
        v0=whole.velocity[500],
    )
    assert np.abs(lost.displacement - whole.displacement[500:]).max() > 1e-2 * scale
    energy = free_run(model, F[500:], 0.005, t0=2.5).energy
    assert energy.index[0] == 2.5
    with pytest.raises(SimulationError, match="t0='noon'"):
        simulate(model, F, 0.005, t0="noon")
