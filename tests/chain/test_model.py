"""ChainModel: what follows from masses and laws."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import linalg

from pysindy_nrf import Chain, ChainModel, NRFRegressor, laws, simulate
from pysindy_nrf.exceptions import ChainError, ChannelError, LawError

pytestmark = pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.BiasWarning")


def linear_chain(m, c, k, **options):
    storeys = {}
    for i in range(len(m)):
        storeys[i + 1] = laws.PowerSeries(1, [c[i], k[i]])
    return ChainModel(m, storeys, **options)


def assembled(k):
    """Stiffness matrix of a chain of storeys."""
    stiffness_matrix = np.diag(k) + np.diag(np.append(k[1:], 0.0))
    return stiffness_matrix - np.diag(k[1:], 1) - np.diag(k[1:], -1)


# -- linear part ---------------------------------------------------------------


@pytest.mark.parametrize("n", [1, 2, 5, 20])
def test_modes_of_proportional_damping_are_the_symmetric_eigenproblem(n):
    rng = np.random.default_rng(n)
    m, k = rng.uniform(2, 60, n), rng.uniform(3e4, 6e5, n)
    beta = 3e-4  # C = beta K
    modes = linear_chain(m, beta * k, k).modes()

    squares, shapes = linalg.eigh(assembled(k), np.diag(m))
    omega = np.sqrt(squares)
    assert modes["frequency"].to_numpy() == pytest.approx(omega / (2 * np.pi), rel=1e-8)
    assert modes["damping"].to_numpy() == pytest.approx(0.5 * beta * omega, rel=1e-6)
    largest = np.abs(shapes).argmax(axis=0)
    expected = shapes / shapes[largest, np.arange(n)]
    vectors = modes.iloc[:, 2:].to_numpy(dtype=float).T
    assert vectors == pytest.approx(expected, abs=1e-6)


def test_an_overdamped_mass_is_a_mode_too():
    mode = linear_chain([1.0], [50.0], [100.0]).modes().loc[1]
    assert mode["frequency"] == pytest.approx(10 / (2 * np.pi))
    assert mode["damping"] == pytest.approx(2.5)


def test_two_of_three_overdamped_modes_are_paired_by_their_shapes():
    """C = 0.3 K: damping 0.15 omega."""
    m, k = [1.0, 2.0, 1.0], np.array([100.0, 300.0, 200.0])
    modes = linear_chain(m, 0.3 * k, k).modes()
    omega = np.sqrt(linalg.eigvalsh(assembled(k), np.diag(m)))
    assert (0.15 * omega > 1).sum() == 2
    assert modes["frequency"].to_numpy() == pytest.approx(omega / (2 * np.pi), rel=1e-6)
    assert modes["damping"].to_numpy() == pytest.approx(0.15 * omega, rel=1e-6)


def test_a_free_chain_has_a_mode_without_frequency():
    spring = {2: laws.LinearElastic(k=600.0)}
    free = ChainModel([3.0, 3.0], spring, Chain(2, ground="free")).modes()
    expected = [0.0, 20 / (2 * np.pi)]
    assert free["frequency"].to_numpy() == pytest.approx(expected, abs=1e-6)
    rigid = free.iloc[0, 2:].to_numpy(dtype=float)
    assert rigid == pytest.approx([1.0, 1.0], abs=1e-6)


def test_matrices_include_braces_ground_links_and_added_masses():
    model = ChainModel(
        [1.0, 2.0, 3.0],
        {
            1: laws.LinearElastic(k=10.0),
            2: laws.LinearElastic(k=20.0),
            3: laws.Duffing(k=30.0, k3=1e9),
            "link 3-1": laws.LinearElastic(k=5.0),
            "ground 2": laws.LinearViscous(c=7.0),
            "dof 3": laws.AddedMass(dm=0.5),
        },
    )
    M, C, K = model.matrices()
    assert M.tolist() == [[1, 0, 0], [0, 2, 0], [0, 0, 3.5]]
    assert C.tolist() == [[0, 0, 0], [0, 7, 0], [0, 0, 0]]
    assert K.tolist() == [[35, -20, -5], [-20, 50, -30], [-5, -30, 35]]


def test_modes_need_positive_masses():
    with pytest.raises(ChainError, match="m2 is not positive"):
        linear_chain([1.0, -2.0], [0, 0], [1, 1]).modes()


# -- forces --------------------------------------------------------------------


def test_forces_along_data_are_the_equations_of_motion(chain4):
    storeys = {}
    for i, (c, k, k3) in enumerate(zip(chain4.c, chain4.k, chain4.k3), 1):
        storeys[i] = [laws.LinearViscous(c), laws.Duffing(k, k3)]
    model = ChainModel(chain4.m, storeys)
    forces = model.restoring_force(chain4.X)
    assert np.allclose(forces, chain4.storey_forces, rtol=1e-12)
    assert np.allclose(model.predict(chain4.X), chain4.F, atol=1e-8)


def test_the_first_storey_of_a_floating_chain_has_no_force():
    spring = {2: laws.LinearElastic(k=600.0)}
    model = ChainModel([3.0, 3.0], spring, Chain(2, ground="free"))
    forces = model.restoring_force(np.ones((4, 6)))
    assert forces.tolist() == [[0.0, 600.0]] * 4


@given(
    st.lists(st.floats(-1e3, 1e3), min_size=9, max_size=9),
    st.floats(-2, 2),
    st.floats(-2, 2),
)
def test_a_restoring_force_is_its_power_series(c, v, s):
    R = ChainModel([1.0], {1: laws.PowerSeries(3, c)}).restoring_forces[1]
    terms = [v, s, v * v, v * s, s * s, v**3, v * v * s, v * s * s, s**3]
    assert float(R(v, s)) == pytest.approx(np.dot(c, terms), rel=1e-9, abs=1e-6)


def test_rates_and_drifts_are_broadcast():
    R = ChainModel([1.0], {1: laws.LinearElastic(k=2.0)}).restoring_forces[1]
    assert R(np.zeros((2, 1)), np.ones(3)).tolist() == [[2.0] * 3] * 2


@pytest.fixture(scope="module")
def braced():
    springs = {i: laws.LinearElastic(k=i) for i in range(1, 5)}
    springs["link 4-2"] = laws.LinearElastic(k=9.0)
    return ChainModel([1.0] * 4, springs).restoring_forces


@pytest.mark.parametrize("spelling", [2, "storey 2", "link 2-1"])
def test_forces_by_every_spelling_of_a_storey(braced, spelling):
    assert braced[spelling].linear_part()["k"] == 2


def test_forces_stand_in_the_order_of_the_sites(braced):
    storeys = [f"storey {i}" for i in range(1, 5)]
    assert list(braced) == [*storeys, "link 4-2"]
    assert braced["link 2-4"].coefficients["s"] == 9.0


@pytest.mark.parametrize("wrong", [5, "storey 7", "link 3-1", "nonsense", 0])
def test_forces_of_a_site_that_is_not_there(braced, wrong):
    with pytest.raises(KeyError, match="storey 1"):
        braced[wrong]


def test_a_force_with_memory_needs_a_path():
    R = ChainModel([1.0], {1: laws.Dahl(sigma=100.0, Fd=3.0)}).restoring_forces[1]
    s = np.linspace(0, 0.1, 50)
    assert R(np.ones(50), s) == pytest.approx(3 * (1 - np.exp(-100 * s)))
    with pytest.raises(LawError, match="depends on the path"):
        R(1.0, 0.1)


@pytest.mark.parametrize("v", [1j, "fast", [1.0, 2.0, 3.0]])
def test_rates_that_are_no_numbers_of_the_same_shape(v):
    R = ChainModel([1.0], {1: laws.LinearElastic(k=1.0)}).restoring_forces[1]
    with pytest.raises(ChannelError, match="v and s of storey 1"):
        R(v, [0.1, 0.2])


# -- text ----------------------------------------------------------------------


def test_equations_read_like_the_papers():
    first = laws.PowerSeries((1, 2), [476.07, 101120.0, -1.5, 3e4, 2e6])
    second = laws.PowerSeries(1, [100, 1e5])
    model = ChainModel([9.85, 10.0], {1: first, 2: second})
    assert str(model).splitlines() == [
        "m1 = 9.85 kg, m2 = 10 kg  (R in N, s in m, v in m/s)",
        "R1 = 476.1 v1 + 1.011e+05 s1 - 1.5 v1 s1 + 3e+04 s1^2 + 2e+06 v1 s1^2",
        "R2 = 100 v2 + 1e+05 s2",
    ]


def test_the_equation_of_a_sensor_is_its_reading_and_no_force():
    gain = [laws.GainError(-0.1)]
    model = ChainModel([1.0, 2.0], {"sensor a2": gain, "sensors 1": gain})
    lines = str(model).splitlines()
    assert {"sensor a2 = y - 0.1 y", "sensors 1 = y - 0.1 y"} <= set(lines)


def test_the_equation_of_a_brace_has_both_ends():
    brace = ChainModel([1.0] * 4, {"link 4-2": laws.LinearElastic(k=-3.0)})
    assert brace.equations() == ["R_42 = -3 s_42"]


def test_the_printed_equation_is_the_force():
    """Whoever types the printed equation into a calculator gets the force."""
    rng = np.random.default_rng(0)
    series = laws.PowerSeries(3, rng.normal(size=9) * 100)
    R = ChainModel([1.0], {1: series}).restoring_forces[1]
    text = R.equation(digits=17).split("=")[1].replace("^", "**")
    text = text.replace(" v1", "*v1").replace(" s1", "*s1")
    for v, s in rng.normal(size=(5, 2)):
        typed = eval(text, {"v1": v, "s1": s})
        assert typed == pytest.approx(float(R(v, s)), rel=1e-12)


def test_two_laws_of_one_family_keep_their_own_coefficients():
    twins = [
        laws.PowerSeries(1, [30.0, 4e4]),
        laws.Dahl(sigma=3e4, Fd=4.0),
        laws.Dahl(sigma=2e3, Fd=12.0),
    ]
    force = ChainModel([10.0], {1: twins}).restoring_forces[1]
    expected = {"v": 30.0, "s": 4e4, "Z (dahl 1)": 4.0, "Z (dahl 2)": 12.0}
    assert force.coefficients.to_dict() == expected


def test_a_floor_that_nothing_holds_has_no_law_in_the_notebook_view():
    storeys = {1: [laws.PowerSeries(1, [3.0, 3e4])], 2: []}
    shown = ChainModel([5.0, 4.0], storeys)._repr_html_()
    assert "m2 = 4 kg" in shown
    assert 'alttext="R_{1}(' in shown
    assert 'alttext="R_{2}(' not in shown


def test_a_floor_that_nothing_holds_runs_away():
    """x = F t^2 / (2 m)."""
    model = ChainModel([5.0, 4.0], {1: [laws.PowerSeries(1, [3.0, 3e4])], 2: []})
    forces = np.column_stack([np.zeros(400), 8.0 * np.ones(400)])
    x = simulate(model, forces, 1e-3).displacement
    assert x[-1, 1] == pytest.approx(0.5 * 2.0 * 0.399**2, rel=1e-6)
    assert not x[:, 0].any()


# -- surface -------------------------------------------------------------------


@pytest.fixture(scope="module")
def fitted(chain4):
    return NRFRegressor(degree=3).fit(chain4.X, chain4.F).model_


def test_a_surface_is_the_force_over_the_rectangle_that_was_visited(fitted, chain4):
    table = fitted.surface("storey 2", size=31)
    v, s = chain4.v[:, 1], chain4.s[:, 1]
    assert len(table) == 31**2
    assert (table.v.min(), table.v.max()) == pytest.approx((v.min(), v.max()))
    assert (table.s.min(), table.s.max()) == pytest.approx((s.min(), s.max()))
    c = chain4.c[1]
    k = chain4.k[1]
    k3 = chain4.k3[1]
    expected = c * table.v + k * table.s + k3 * table.s**3
    assert np.allclose(table.R, expected, rtol=1e-9, atol=1e-6)


def test_the_corners_of_a_surface_were_not_visited(fitted, chain4):
    table = fitted.surface("storey 2", size=31)
    fast = table.v.abs() > 0.95 * np.abs(chain4.v[:, 1]).max()
    far = table.s.abs() > 0.95 * np.abs(chain4.s[:, 1]).max()
    assert not table[fast & far].visited.any()
    assert 0.2 < table.visited.mean() < 0.95


def test_samples_lie_in_the_region_that_they_visited(fitted, chain4):
    v, s = chain4.v[:, 1], chain4.s[:, 1]
    region = fitted.visited["storey 2"]
    assert region.contains(v, s).all()
    assert not region.contains(10 * v.max(), 0.0)


def test_a_margin_widens_the_surface(fitted):
    plain, wide = fitted.surface(2, size=3), fitted.surface(2, size=3, margin=0.5)
    assert np.ptp(wide.v) == pytest.approx(1.5 * np.ptp(plain.v))


def test_a_force_that_depends_on_the_path_is_no_surface():
    with pytest.raises(LawError, match="it has no surface"):
        ChainModel([1.0], {1: laws.Dahl(sigma=5e4, Fd=3.0)}).surface(1)


def test_a_surface_needs_a_visited_region():
    with pytest.raises(ChannelError, match="is not known"):
        linear_chain([1.0], [1], [1]).surface(1)


# -- what cannot be a model ----------------------------------------------------

SPRING = laws.LinearElastic(k=1.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([1.0, np.nan], {}), "finite"),
        (([1.0], {1: laws.LinearElastic()}), "no values"),
        (([1.0], {1: laws.Dahl(Fd=1.0)}), "no values"),
        (([1.0], {1: "spring"}), "not a force law"),
        (([1.0], {2: SPRING}), "storey 2"),
        (([1.0, 1.0], {}, Chain(3)), "2 masses for a chain with 3"),
        (([1.0] * 3, {"link 3-1": SPRING}, Chain(3)), "not in the chain"),
    ],
)
def test_what_cannot_be_a_model(arguments, message):
    with pytest.raises((ChainError, LawError), match=message):
        ChainModel(*arguments)
