"""The machine code is the code that is read: every compiled function, run as plain Python, gives the same numbers.

A line counter sees nothing of machine code, and a reader sees nothing else than the source. Within
:func:`plain_python` the compiled functions of the package are the Python functions they are written in, law kernels
and state updates included.
"""

from __future__ import annotations

from contextlib import contextmanager
from types import SimpleNamespace

import numba
import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher
from scipy.integrate import solve_ivp
from test_gram import MASSES, columns_of, whole_numbers
from test_projection import CASES
from user_laws import Parametric

from pysindy_nrf import Chain, Site, laws, simulate
from pysindy_nrf.diagnostics import windows
from pysindy_nrf.discrepancy import projection
from pysindy_nrf.discrepancy.prepare import prepare
from pysindy_nrf.discrepancy.splits import split
from pysindy_nrf.discrepancy.stage import Stage
from pysindy_nrf.discrepancy.workspace import Workspace
from pysindy_nrf.exceptions import LawError, SimulationError
from pysindy_nrf.laws import compiled, memory
from pysindy_nrf.laws.base import ForceLaw, Motion, Term
from pysindy_nrf.regression import domains as extent
from pysindy_nrf.regression import domains as visited
from pysindy_nrf.regression import gram
from pysindy_nrf.regression.blocks import blocks_of
from pysindy_nrf.regression.gram_pass import total_gram
from pysindy_nrf.regression.input_arrays import from_arrays
from pysindy_nrf.regression.layout import LawLayout, Layout
from pysindy_nrf.simulation import balance, free_run, integrators, system

MODULES = (compiled, memory, balance, integrators, system)
BUILT_ON_CALL = (
    (memory, "_paths"),
    (gram, "kernels"),
    (projection, "_compiled"),
    (extent, "_scan"),
    (visited, "_marker"),
    (windows, "_compiled"),
)


def as_written(function, **options):
    return getattr(function, "py_func", function)


def jit_as_written(function):
    function = as_written(function)
    function.compile = function.disable_compile = lambda *signature: None
    return function


@contextmanager
def plain_python():
    """The compiled functions of the package as written; callbacks are found by a number instead of an address."""
    callbacks = []

    def pointer(function, signature):
        callbacks.append(function)
        return SimpleNamespace(address=len(callbacks) - 1)

    def call_kernel(at, s, v, a, t, u, n_u, z, z0, n_z, theta, theta0, n_theta, out, n_out):
        callbacks[at](s, v, a, t, u, n_u, z[z0:], n_z, theta[theta0:], n_theta, out, n_out)

    def call_advance(at, z, z0, n_z, s0, v0, s1, v1, dt, u, n_u, theta, theta0, n_theta):
        callbacks[at](z[z0:], n_z, s0, v0, s1, v1, dt, u, n_u, theta[theta0:], n_theta)

    changed = {
        id(compiled.inline): as_written,
        id(compiled.part): as_written,
        id(compiled.jit): jit_as_written,
        id(compiled.borrow): lambda array: array,
        id(compiled.on_stack): np.zeros,
        id(compiled.carray): lambda array, size: array[:size],
        id(compiled._pointer): pointer,
        id(compiled.kernel_pointer): compiled.kernel_pointer.__wrapped__,
        id(compiled.advance_pointer): compiled.advance_pointer.__wrapped__,
        id(balance._call_kernel): call_kernel,
        id(balance._call_advance): call_advance,
    }
    with pytest.MonkeyPatch.context() as patch, np.errstate(all="ignore"):
        for module in MODULES:
            for name, value in list(vars(module).items()):
                if id(value) in changed or isinstance(value, Dispatcher):
                    patch.setattr(module, name, changed.get(id(value)) or value.py_func)
        for module, name in BUILT_ON_CALL:
            patch.setattr(module, name, getattr(module, name).__wrapped__)
        # closures over the functions of the polynomial
        patch.setattr(memory, "_turning_point", memory._root_of(memory._slope, memory._curvature))
        patch.setattr(memory, "_slowest_point", memory._root_of(memory._curvature, memory._third))
        yield


def both(compute, rtol=1e-10):
    """What a function gives compiled, after a comparison with what it gives in plain Python.

    Arrays by name; ``rtol`` is a share of the largest number of each array.
    """
    fast = compute()
    with plain_python():
        slow = compute()
    assert fast.keys() == slow.keys()
    for name, expected in fast.items():
        found, expected = np.asarray(slow[name], dtype=float), np.asarray(expected, dtype=float)
        size = np.abs(expected[np.isfinite(expected)]).max(initial=0.0)
        np.testing.assert_allclose(found, expected, rtol=0, atol=rtol * size, err_msg=name)
    return fast


def model(chain, masses, held):
    """A chain with laws, or a tuple of laws, by site."""
    groups = {Site(site): group if isinstance(group, tuple) else (group,) for site, group in held.items()}
    return SimpleNamespace(chain=chain, masses=np.asarray(masses, dtype=float), laws=groups)


def run_of(case, F, dt=1e-3, **options):
    run = free_run(case, F, dt, **options)
    record = run.record
    return {
        "x": record.displacement,
        "v": record.velocity,
        "a": record.acceleration,
        "energy": run.energy,
        "quality": list(run.quality.values()),
        **{f"z{i}": z for i, z in enumerate(run.states.values())},
    }


def pushed(n, rms, dofs=1, seed=0):
    F = np.zeros((n, dofs))
    F[:, -1] = rms * np.convolve(np.random.default_rng(seed).standard_normal(n + 8), np.hanning(9) / 2, "valid")
    return F


LINEAR = laws.PowerSeries(1, [100.0, 1e5])
SPRING = laws.LinearElastic(1e4)
COULOMB = laws.CoulombFriction(20.0)


# -- free runs ------------------------------------------------------------------------------------

MEMORY = {
    "dahl": laws.Dahl(sigma=5e4, Fd=35.0),
    "modified dahl": laws.ModifiedDahl(K0=50.0, C0=399.0, Fd=34.85, f0=1.0, sigma=5e4),
    "jenkins": laws.Jenkins(uy=1e-4, Fy=30.0),
    "iwan": laws.Iwan(uy=1e-4, ratio=3.0, F1=20.0, F2=20.0),
    "bouc-wen, n = 1": laws.BoucWen(beta=8e3, rho=-1.4, n=1.0, alpha=1e5),
    "bouc-wen, n = 2": laws.BoucWen(beta=8e3, rho=0.4, n=2.0, alpha=1e5),
    "lugre": laws.LuGre(sigma=1e4, vs=0.1, ratio=1.5, Fc=20.0, sigma1=50.0),
    "maxwell": laws.MaxwellBranch(tau=0.02, k=5e4),
    "covariate dahl": laws.CovariateDahl("u", sigma=3e4, tau=0.01, Fc=10.0, Fu=20.0, Cu=5.0),
    "lagged covariate": laws.LaggedCovariateFriction("u", tau=0.01, Fc=10.0, Fu=20.0, Cu=5.0),
}


@pytest.mark.parametrize("method", ["default", "newmark"])
@pytest.mark.parametrize("name", MEMORY)
def test_free_runs_of_laws_that_remember(name, method):
    F = pushed(25, 300.0, 2, seed=1)
    case = model(Chain(2), [10.0, 8.0], {1: (LINEAR, MEMORY[name]), 2: LINEAR})
    u = {"u": 1.0 + np.sin(0.2 * np.arange(25))}
    found = both(lambda: run_of(case, F, method=method, covariates=u))
    assert np.ptp(found["z0"], axis=0).max() > 0


@pytest.mark.parametrize("hold", ["linear", "zero", "cubic"])
@pytest.mark.parametrize("method", ["default", "newmark"])
def test_free_runs_on_a_moving_base_with_links_and_ground_sites(method, hold):
    held = {
        1: laws.Duffing(k=4e4, k3=1e9), 2: LINEAR, 3: LINEAR, "ground 3": LINEAR, "ground 2": SPRING,
        "link 3-1": (laws.LinearViscous(40.0), laws.StiffnessStep(t0=0.51, dk=4e3)),
        "dof 2": laws.HarmonicForce(frequency=20.0, A=4.0, B=-7.0),
    }  # fmt: skip
    case = model(Chain(3, links=["link 3-1", "ground 2"], ground="both"), [8.0, 10.0, 12.0], held)
    F, ag = pushed(30, 50.0, 3), pushed(30, 3.0, seed=2)[:, 0]
    options = {"base_acceleration": ag, "t0": 0.5, "x0": [1e-4, 0, -1e-4], "v0": [0, 0.01, 0]}
    both(lambda: run_of(case, F, method=method, hold=hold, **options))


def test_a_free_run_in_plain_python_is_that_of_scipy():
    F, u, dt = pushed(25, 300.0)[:, 0], np.linspace(1.0, 2.0, 25), 1e-3
    case = model(Chain(1), [5.0], {1: Parametric(coefficients=[2e4, 300.0])})
    found = both(lambda: run_of(case, F[:, None], covariates={"u": u}))
    y, x = np.zeros(2), [0.0]
    for i in range(24):  # both inputs are straight lines within one interval

        def rate(t, y, i=i):
            f, k = (q[i] + (q[i + 1] - q[i]) * (t / dt - i) for q in (F, u))
            return [y[1], (f - 2e4 * k * y[0] - 300.0 * t * y[1]) / 5.0]

        y = solve_ivp(rate, (i * dt, (i + 1) * dt), y, "DOP853", rtol=1e-12, atol=1e-15).y[:, -1]
        x.append(y[0])
    np.testing.assert_allclose(found["x"][:, 0], x, atol=1e-9 * np.abs(x).max())


@pytest.mark.parametrize("method", ["default", "newmark"])
def test_free_runs_with_inertia_in_links(method):
    """A mass matrix that is not diagonal: storeys, a link to the ground and an added mass."""
    held = {
        1: (LINEAR, laws.Inerter(b=4.0)), 2: (LINEAR, laws.Inerter(b=9.0)), 3: LINEAR,
        "ground 3": laws.Inerter(b=2.0), "dof 1": laws.AddedMass(dm=1.5),
    }  # fmt: skip
    case = model(Chain(3, links=["ground 3"]), [5.0, 0.5, 4.0], held)
    F, ag = pushed(30, 100.0, 3), pushed(30, 3.0, seed=2)[:, 0]
    both(lambda: run_of(case, F, method=method, base_acceleration=ag))


ONE, TWO = (Chain(1), [10.0]), (Chain(2), [10.0, 5.0])
JUMPS = {
    "sticks and slips": (model(*ONE, {1: (SPRING, COULOMB)}), pushed(120, 60.0)),
    "decays and sticks": (model(*ONE, {1: (SPRING, COULOMB)}), np.zeros((200, 1))),
    "two storeys": (model(*TWO, {1: (SPRING, COULOMB), 2: (SPRING, COULOMB)}), pushed(100, 80.0, 2)),
    "a loop of links that stick": (
        model(Chain(2, links=["ground 2"]), [10.0, 5.0], {1: (SPRING, COULOMB), 2: COULOMB, "ground 2": COULOMB}),
        pushed(40, 60.0, 2),
    ),
    "a floating chain": (model(Chain(2, ground="free"), [10.0, 5.0], {2: (SPRING, COULOMB)}), pushed(80, 60.0, 2)),
    "an inerter": (model(*TWO, {1: (SPRING, COULOMB, laws.Inerter(b=3.0)), 2: LINEAR}), pushed(60, 60.0, 2)),
    "asymmetric": (model(*ONE, {1: (SPRING, laws.AsymmetricFriction(10.0, 20.0))}), pushed(80, 60.0)),
    "a static level": (model(*ONE, {1: (SPRING, laws.StribeckFriction(vs=0.02, Fc=10.0, dF=8.0))}), pushed(80, 60.0)),
    "a jump not at rest": (model(*ONE, {1: (SPRING, laws.ShiftedFriction(kappa=100.0, Fc=20.0))}), pushed(25, 60.0)),
    "contact": (
        model(
            *TWO,
            {
                1: (LINEAR, laws.OneSidedGap(gap=1e-4, k=1e5)),
                2: (LINEAR, laws.TwoSidedGap(gap=1e-4, k=3e5)),
                "dof 1": laws.PreloadedContact(u=1e-4, k=2e4),
            },
        ),
        pushed(60, 200.0, 2),
    ),
    "friction and memory": (
        model(*TWO, {1: (SPRING, COULOMB), 2: (SPRING, laws.Dahl(sigma=5e3, Fd=10.0))}), pushed(60, 60.0, 2)
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", JUMPS)
def test_free_runs_of_forces_with_jumps_and_corners(name):
    case, F = JUMPS[name]
    start = np.full(len(case.masses), 0.0 if F.any() else 0.005)
    both(lambda: run_of(case, F, x0=start), rtol=1e-8)


@pytest.mark.parametrize("name", ["sticks and slips", "two storeys"])
def test_free_runs_of_friction_under_forces_that_bend(name):
    case, F = JUMPS[name]
    both(lambda: run_of(case, F, hold="cubic"), rtol=1e-8)


def test_a_site_that_slides_from_the_start():
    case = model(*TWO, {1: (SPRING, COULOMB), 2: (SPRING, COULOMB)})
    found = both(lambda: run_of(case, np.zeros((40, 2)), v0=[0.03, -0.03]), rtol=1e-8)
    assert (found["v"][-1] == 0).all()


@pytest.mark.parametrize("method", ["default", "newmark"])
def test_a_chain_at_rest_stays_at_rest(method):
    case = model(*TWO, {1: (SPRING, COULOMB), 2: (SPRING, MEMORY["dahl"])})
    found = both(lambda: run_of(case, np.zeros((5, 2)), method=method))
    assert not any(found[key].any() for key in "xva")


def test_linear_equations_whose_rows_must_change_places():
    """Newton's equations of a storey whose stiffness is negative; the solver itself against LAPACK."""
    held = {1: laws.LinearElastic(-9e5), 2: laws.LinearElastic(1e6)}
    both(lambda: run_of(model(Chain(2), [1.0, 1.0], held), pushed(4, 1.0, 2), dt=1e-2, method="newmark"))
    A, b = np.random.default_rng(0).normal(size=(2, 5, 5))
    A[0, 0] = A[1, 0] = 0.0
    x = b[0].copy()
    with plain_python():
        balance.solve(A.copy(), x, 5)
    np.testing.assert_allclose(x, np.linalg.solve(A, b[0]), rtol=1e-10)


def test_friction_against_what_stands_still_beside_a_moving_base():
    ag = pushed(60, 30.0, seed=2)[:, 0]
    vg = np.cumsum(ag) * 1e-3
    case = model(*ONE, {1: SPRING, "dof 1": laws.GroundFriction(20.0)})
    both(lambda: run_of(case, None, base_acceleration=ag, covariates={"vg": vg}), rtol=1e-8)


@pytest.mark.parametrize("method", ["default", "newmark"])
def test_a_run_that_diverges_ends_at_the_same_time(method):
    case = model(Chain(1), [1.0], {1: laws.Duffing(k=100.0, k3=-1e6)})
    said = []

    def end():
        with pytest.raises(SimulationError, match="diverges") as error:
            simulate(case, np.full((400, 1), 50.0), 1e-3, method=method)
        said.append(str(error.value))
        return {}

    both(end)
    assert said[0] == said[1]


def test_newmark_steps_that_do_not_converge_are_counted():
    """Friction that jumps inside a step has no solution of the implicit equations."""
    case = model(*ONE, {1: (SPRING, COULOMB)})
    found = both(lambda: run_of(case, pushed(12, 60.0), method="newmark"), rtol=1e-8)
    assert found["quality"][2] > 0


# -- states along sampled motions -----------------------------------------------------------------

SHAPES = {
    "dahl": [[5e3], [4e4]],
    "jenkins": [[1e-4], [2e-3]],
    "iwan": [[1e-4, 2.0], [4e-4, 5.0]],
    "bouc-wen, n = 1": [[900.0, r, 1.0] for r in (-3.0, -1.0, -0.5, 0.0, 1.0, 2.0)],
    "bouc-wen, n = 2": [[900.0, r, n] for r in (-1.4, -1.0, 0.5) for n in (1.3, 3.5)],
    "lugre": [[1e4, 0.01, 1.5], [3e3, 1.0, 2.0]],
    "maxwell": [[0.02], [0.003], [10.0]],
    "covariate dahl": [[3e4, 0.01]],
}


def motions(n=60):
    """Smooth, rough and at rest, with and without accelerations; the rate turns within intervals, once or twice."""
    t = np.arange(n) / 1000
    s = 1e-3 * np.sin(60 * t) + 4e-4 * np.sin(571 * t + 1)
    v = 0.06 * np.cos(60 * t) + 0.2284 * np.cos(571 * t + 1)
    a = -3.6 * np.sin(60 * t) - 130.4164 * np.sin(571 * t + 1)
    rng = np.random.default_rng(0)
    rough = 1e-3 * rng.normal(size=n), rng.normal(size=n), 1e3 * rng.normal(size=n)
    u = {"u": 1.0 + np.sin(0.1 * np.arange(n))}
    yield Motion(s, v, a, t, u)
    yield Motion(s, v, None, t, u)
    yield Motion(*rough, t, u)
    yield Motion(*rough[:2], None, t, u)
    yield Motion(np.where(np.arange(n) % 7 > 2, s, 0.0), np.zeros(n), None, np.floor(t * 500) / 500, u)
    yield Motion(s[:1], v[:1], a[:1], t[:1], {"u": u["u"][:1]})
    yield Motion(s[:0], v[:0], a[:0], t[:0], {"u": u["u"][:0]})


@pytest.mark.parametrize("name", SHAPES)
def test_states_along_sampled_motions(name):
    def paths():
        return dict(enumerate(memory.state_paths(MEMORY[name], list(motions()), np.array(SHAPES[name]))))

    found = both(paths)
    assert all(np.ptp(z, axis=2).max() > 0 for z in list(found.values())[:4])


@pytest.mark.parametrize("timed", [False, True])
def test_states_of_a_long_record(timed):
    """More samples than are searched for turns at once."""
    s = 1e-3 * np.cumsum(np.random.default_rng(0).normal(size=2200))
    motion = Motion(s, s, t=np.arange(2200) / 1000 if timed else None)
    both(lambda: {"z": memory.state_path(MEMORY["jenkins"], motion, np.empty((0, 2200)), np.array([0.02]))})


@pytest.mark.parametrize("n", [1.0, 1.3, 2.0, 3.5])
def test_steps_of_bouc_wen_from_any_state(n):
    """Loading and unloading, softening and hardening, across zero, up to the bound of a state without a limit."""
    law, none = laws.BoucWen(), np.empty((0, 2))
    s = [np.array([0.0, d]) for d in (-3.0, -0.1, 0.0, 0.04, 1.0, 30.0)]

    def ends():
        return {
            (rho, start): [
                memory.state_path(law, Motion(x, x), none, np.array([1.0, rho, n]), np.array([start]))[0, 1] for x in s
            ]
            for rho in (-3.0, -1.0, 0.3, 1.0, 2.5)
            for start in (-5.0, -0.6, -1e-4, 0.0, 0.5, 2.0)
        }

    found = both(ends, rtol=1e-9)
    # by the slope at its start it would cross zero, by the integral it does not
    near = Motion(np.array([0.0, 4.991e-4]), np.ones(2))
    both(lambda: {"w": memory.state_path(law, near, none, np.array([1.0, -50.0, n]), np.array([-5e-4]))})
    for rho, start in [(-1.0, 0.5), (0.3, 0.0), (0.3, -0.6), (1.0, -0.6), (-3.0, 0.5)]:

        def rate(s, w, rho=rho):
            return 1.0 - (np.sign(w) + rho) * np.abs(w) ** n

        truth = solve_ivp(rate, (0.0, 1.0), [start], rtol=1e-10, atol=1e-12, max_step=1e-2).y[0, -1]
        if abs(truth) < 10:
            assert found[rho, start][4] == pytest.approx(truth, rel=1e-5, abs=1e-6)


def test_turns_that_rounding_hides_are_left_out():
    """The rate ends so close to zero that the polynomial of the interval ends on the other side."""
    ends = [(2.2949656e-4, 1.0, 8.83e-17, -54735.2, 2670.2), (-1.1107858e-4, 1.0, 3.475e-18, -8940.8, 5672.66)]
    ends += [(-1.4220480329e-4, 1.0, 2.209e-20, -46608.33, 54472.093), (1e-4, 1.0, 0.3, -9e3, 9e3)]
    rng = np.random.default_rng(0)
    ends += [(1e-3 * d, 1.0, 1e-18, -1e4 * a, 1e4 * b) for d, a, b in rng.uniform(0.1, 0.5, (20, 3))]

    law, none, sigma = laws.Dahl(), np.empty((0, 2)), np.array([5e3])

    def states():
        found = {}
        for rise, v0, v1, a0, a1 in ends:
            lines = ([0.0, rise], [v0, v1], [a0, a1], [0.0, 1e-3])
            found[rise, v0, v1] = memory.state_path(law, Motion(*map(np.array, lines)), none, sigma)
        return found

    both(states)


def test_a_state_that_overflows_is_named():
    """A relaxation time below zero."""
    t = np.arange(400) / 100
    law, motion, theta = laws.MaxwellBranch(), Motion(t, np.ones(400), t=t), np.array([-2e-3])

    def said():
        with pytest.raises(LawError, match="MaxwellBranch grows beyond all bounds"):
            memory.state_path(law, motion, np.empty((0, 400)), theta)
        with pytest.raises(LawError, match="MaxwellBranch grows beyond all bounds"):
            memory.state_paths(law, [motion], theta[None])
        return {}

    both(said)


# -- sums of products -----------------------------------------------------------------------------


@pytest.mark.parametrize("counts", [(3, 6, 4), (7, 4, 5), (5, 8, 6), (5, 4, 3), (6, 5, 0), (0, 1, 2)], ids=str)
def test_products_of_columns_in_plain_python_are_exact(counts):
    layout = Layout(Chain(3), {f"storey {i + 1}": n for i, n in enumerate(counts)})
    data = whole_numbers(257 if counts[0] == 7 else 9, layout.n_terms, 3)
    groups = [layout.group(dofs) for dofs in ((1,), (2,), (3,), (2, 3), (1, 2, 3), (1, 2))]

    def products():
        return total_gram(layout, groups, blocks_of(*data), MASSES).matrices

    found = both(products, rtol=0)
    for group in groups:
        A = columns_of(layout, group, data)
        assert np.array_equal(found[group.dofs], A.T @ A)


def test_powers_that_are_built_in_the_pass():
    layout = LawLayout(Chain(2), {1: [laws.PowerSeries(4)], 2: [laws.CubicStiffness(), laws.LinearViscous()]})
    v, s, a, F = np.random.default_rng(0).normal(size=(4, 20, 2))
    segment = from_arrays(np.hstack([a, v, s]), F, dt=1e-3).segments[0]

    def products():
        groups = [layout.group((1,)), layout.group((2,))]
        return total_gram(layout, groups, segment.blocks(layout, states={})).matrices

    both(products, rtol=1e-13)


@pytest.mark.parametrize("p", [1, 4, 5, 7, 9])
def test_rows_made_orthogonal_by_a_guess(p):
    rng = np.random.default_rng(p)
    rows, guess = rng.normal(size=(p, 9 if p < 9 else 300)), np.triu(rng.uniform(0.5, 2.0, (p, p)))

    def products():
        store = np.zeros((p, p))
        gram.orthogonal_gram(rows, guess, store)
        return {"store": store}

    near = np.linalg.solve(guess.T, rows)
    expected = np.tril(near @ near.T)
    np.testing.assert_allclose(np.tril(both(products)["store"]), expected, atol=1e-9 * np.abs(expected).max())


# -- the chain solve on many Gram matrices --------------------------------------------------------


def stage_of(name):
    records, known, strategy = CASES[name]
    data = prepare(records()).data
    work = Workspace(data, [None] * len(data.segments), *split(data.segments), known, strategy)
    return Stage(work, Chain(3), {Site(f"storey {i}"): (laws.PowerSeries(1),) for i in (1, 2, 3)})


@pytest.mark.parametrize(
    "name", ["complete", "middle floor forced", "base excitation", "a force unknown in one record"]
)
def test_errors_of_candidates_and_folds(name):
    stage, site = stage_of(name), Site("link 3-1")
    tried = [laws.StribeckFriction(vs=x * stage.work.scales(site)[1]) for x in (0.2, 0.5)]

    def errors():
        slot = stage.slot(site, tried[0])
        return {"folds": slot.folds(tried[0]), "errors": slot.errors(tried)}

    found = both(errors, rtol=1e-8)
    assert np.isfinite(found["folds"]).all()


@pytest.mark.parametrize("name", ["complete", "joint"])
def test_columns_that_are_zero_or_depend_on_each_other_have_no_error(name):
    stage, site = stage_of(name), Site("storey 1")

    def errors():
        zero, twice = laws.TwoSidedGap(gap=1.0), laws.TwoSidedGap(gap=1e-300)  # never touched; a linear spring
        return {law.shape["gap"]: stage.slot(site, law).errors([law]) for law in (zero, twice)}

    assert all(np.isinf(error).all() for error in both(errors).values())


def test_errors_on_blocks_in_which_nothing_moves_or_nothing_is_measured():
    stage, law = stage_of("complete"), laws.CoulombFriction()
    project = stage.slot(Site("storey 1"), law)._project
    p = len(stage.columns) + 1
    X = np.random.default_rng(0).normal(size=(2, 1, 60, p))
    fit = np.swapaxes(X, 2, 3) @ X
    judge = np.zeros_like(fit)
    tail = slice(stage.tail, stage.tail + 6)  # accelerations and forces
    judge[1, :, tail, tail] = fit[1, :, tail, tail]

    def errors():
        return dict(enumerate(project(fit, judge))) | {"no samples": project(fit, judge, np.zeros((2, 1)))[0]}

    found = both(errors)
    assert found[0][0] == 0.0 and found[0][1] > 0.0 and not found["no samples"].any()


# -- ranges and cells -----------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("order", ["C", "F"])
def test_ranges_of_channels_and_cells_of_storeys(kind, order):
    x = np.asarray(np.random.default_rng(0).normal(size=(50, 3)), dtype=kind, order=order)
    x[4, 1], x[7, 2] = np.nan, np.inf
    y = np.asarray(x[10:], order=order)
    low, high = np.full((3, 2), -2.0), np.full((3, 2), 1.0)

    def found():
        of = extent.Extent.of([x, x[:0]])
        cells = visited.VisitedRegion.of_storeys([(y, y[:, ::-1])], low, high)
        return {"low": of.low, "high": of.high, "finite": of.finite} | {k: c.cells for k, c in enumerate(cells)}

    of = both(found, rtol=0)
    assert of["low"][:3] == pytest.approx(np.nanmin(x, axis=0), rel=1e-7)
    assert of["finite"].tolist() == [True, False, False, True, True, True]


# -- what the compiler is told --------------------------------------------------------------------


def test_laws_are_called_by_address_on_their_parts_of_the_arrays():
    law = laws.CovariateDahl("u", sigma=30.0, tau=0.01, Fc=1.0, Fu=2.0, Cu=3.0)
    kernel, advance = compiled.pointers(law)
    assert compiled.inline(compiled.inline(law.kernel)) is not law.kernel

    @numba.njit
    def call(kernel, advance, u, z, theta, out):
        balance._call_advance(advance, z, 2, 3, 0.1, 0.2, 0.15, 0.3, 0.004, u, 1, theta, 1, 2)
        balance._call_kernel(kernel, 0.1, 0.2, 0.3, 0.4, u, 1, z, 2, 3, theta, 1, 2, out, 3)

    z, out, theta, u = np.arange(6.0), np.zeros(3), np.array([9.0, 30.0, 0.01]), np.array([1.5])
    call(kernel.address, advance.address, u, z, theta, out)
    expected, values = np.arange(6.0), np.zeros(3)
    law.advance(expected[2:5], 0.1, 0.2, 0.15, 0.3, 0.004, u, theta[1:])
    law.kernel(0.1, 0.2, 0.3, 0.4, u, expected[2:5], theta[1:], values)
    np.testing.assert_allclose(z, expected, rtol=1e-14)
    np.testing.assert_allclose(out, values, rtol=1e-14)


def test_lines_on_the_stack_and_arrays_without_owners():
    @numba.njit
    def total(x):
        line, none, same = compiled.on_stack(3), compiled.on_stack(0), compiled.borrow(x)
        for k in range(3):
            line[k] = same[k]
        same[0] = 7.0
        return line.sum() + none.size

    x = np.array([1.0, 2.0, 4.0])
    assert total(x) == 7.0 and x[0] == 7.0

    @numba.njit
    def unknown(n):
        return compiled.on_stack(n).size

    with pytest.raises(numba.TypingError):
        unknown(3)


class Parsed(ForceLaw):
    """A law that numba does not accept."""

    name = "test_not_compiled"

    def terms(self):
        return (Term("c", "s", "N"),)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = eval("s")


def test_a_law_that_cannot_be_compiled_is_named(monkeypatch):
    with pytest.raises(LawError, match="Parsed cannot be compiled"):
        compiled.pointers(Parsed(coefficients=[1.0]))

    def refused(advance, n_states):
        raise numba.core.errors.TypingError("Untyped global name 'eval'")

    monkeypatch.setattr(memory, "_paths", refused)
    with pytest.raises(LawError, match="Dahl cannot be compiled .*eval"):
        memory.state_path(laws.Dahl(), Motion(np.arange(3.0), np.ones(3)), np.empty((0, 3)), np.ones(1))


def test_code_on_the_disk_that_cannot_be_read_here_is_compiled_anew(monkeypatch):
    def lost(self, sig, target_context):
        raise ImportError("No module named 'notebook_of_another_day'")

    def double(x):
        return 2.0 * x

    monkeypatch.setattr(compiled.FunctionCache, "load_overload", lost)
    assert compiled.jit(double)(3.0) == 6.0


def test_fingerprint_sees_an_array_that_a_law_holds():
    def law(values):
        def advance(z):
            z[0] = values[0]

        return advance

    one, two, same = (compiled.fingerprint(law(np.array([x]))) for x in (1.0, 2.0, 1.0))
    assert one == same != two


# -- columns that a law may lack ------------------------------------------------------------------


def test_columns_that_a_law_may_lack_are_what_their_names_say():
    """Friction, drag, a stiffening spring, a gap of one rms; loops that depend on the drift since the last reversal."""
    t = np.linspace(0, 3, 400)
    s = np.array([np.sin(2 * np.pi * t), 0.01 * np.cos(3 * t)])
    v = np.array([2 * np.pi * np.cos(2 * np.pi * t), -0.03 * np.sin(3 * t)])
    scales = np.column_stack([v.std(axis=1), s.std(axis=1)])
    found = both(lambda: {"columns": windows.probe_regressors(v, s, scales, t / 1.5 - 1)}, rtol=1e-13)["columns"]
    x, y = v / scales[:, :1], s / scales[:, 1:]
    for i in range(2):
        turns = np.flatnonzero(np.diff(np.sign(v[i]))) + 1
        last = np.array([max([0, *turns[turns <= k]]) for k in range(len(t))])
        way = np.abs(y[i] - y[i][last])
        loops = [np.sign(v[i]) * (1 - 2 * np.exp(-sharp * way)) for sharp in (1, 5, 25)]
        gap = np.where(np.abs(y[i]) > 1, y[i] - np.sign(y[i]), 0.0)
        expected = [np.sign(v[i]), x[i] * np.abs(x[i]), y[i] * np.abs(y[i]), gap, *loops, np.ones(400), t / 1.5 - 1]
        np.testing.assert_allclose(found[i], expected, atol=1e-12)


@pytest.mark.parametrize("size", [1, 3, 4, 9])
def test_extents_of_the_largest_numbers(size):
    """Least and largest whatever the number of samples; the sum of finite numbers may not be."""
    x = 1e308 * np.random.default_rng(size).uniform(-1, 1, (size, 3))
    x[:, 1] = 1.7e308
    x[-1, 2] = np.nan
    found = both(lambda: vars(extent.Extent.of([x])))
    assert found["low"][:2].tolist() == x[:, :2].min(axis=0).tolist() and found["high"][1] == 1.7e308
    assert found["finite"].tolist() == [True, True, False]
