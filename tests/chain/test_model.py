"""ChainModel: what follows from masses and laws."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import linalg

from pysindy_nrf import Chain, ChainModel, NRFRegressor, laws, simulate
from pysindy_nrf.chain.layout import LawLayout
from pysindy_nrf.exceptions import ChainError, ChannelError, LawError
from pysindy_nrf.identification.intervals import parameters_of

pytestmark = pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.BiasWarning")


def linear_chain(m, c, k, **options):
    return ChainModel(
        m, {i + 1: laws.PowerSeries(1, [c[i], k[i]]) for i in range(len(m))}, **options
    )


def _assembled(k):
    K = np.diag(k) + np.diag(np.append(k[1:], 0.0))
    return K - np.diag(k[1:], 1) - np.diag(k[1:], -1)


# -- linear part ---------------------------------------------------------------


@pytest.mark.parametrize("n", [1, 2, 5, 20])
def test_modes_of_a_proportionally_damped_chain_are_the_symmetric_eigenproblem(n):
    rng = np.random.default_rng(n)
    m, k = rng.uniform(2, 60, n), rng.uniform(3e4, 6e5, n)
    beta = 3e-4  # C = beta K
    modes = linear_chain(m, beta * k, k).modes()
    squares, shapes = linalg.eigh(_assembled(k), np.diag(m))
    omega = np.sqrt(squares)
    assert modes["frequency"].to_numpy() == pytest.approx(omega / (2 * np.pi), rel=1e-8)
    assert modes["damping"].to_numpy() == pytest.approx(0.5 * beta * omega, rel=1e-6)
    for i in range(n):
        shape = shapes[:, i] / shapes[np.argmax(np.abs(shapes[:, i])), i]
        assert modes.iloc[i, 2:].to_numpy(dtype=float) == pytest.approx(shape, abs=1e-6)


def test_overdamped_masses_are_modes_too():
    mode = linear_chain([1.0], [50.0], [100.0]).modes().loc[1]
    assert mode["frequency"] == pytest.approx(10 / (2 * np.pi)) and mode[
        "damping"
    ] == pytest.approx(2.5)
    k = np.array([100.0, 300.0, 200.0])
    modes = linear_chain(
        [1.0, 2.0, 1.0], 0.3 * k, k
    ).modes()  # C = 0.3 K: damping 0.15 omega, two of three overdamped
    omega = np.sqrt(linalg.eigvalsh(_assembled(k), np.diag([1.0, 2.0, 1.0])))
    assert modes["frequency"].to_numpy() == pytest.approx(omega / (2 * np.pi), rel=1e-6)
    assert (
        modes["damping"].to_numpy() == pytest.approx(0.15 * omega, rel=1e-6)
        and (0.15 * omega > 1).sum() == 2
    )


def test_a_free_chain_has_a_mode_without_frequency():
    free = ChainModel(
        [3.0, 3.0], {2: laws.LinearElastic(k=600.0)}, Chain(2, ground="free")
    ).modes()
    assert free["frequency"].to_numpy() == pytest.approx(
        [0.0, 20 / (2 * np.pi)], abs=1e-6
    )
    assert free.iloc[0, 2:].to_numpy(dtype=float) == pytest.approx([1.0, 1.0], abs=1e-6)


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
    assert M.tolist() == [[1, 0, 0], [0, 2, 0], [0, 0, 3.5]] and C.tolist() == [
        [0, 0, 0],
        [0, 7, 0],
        [0, 0, 0],
    ]
    assert K.tolist() == [[35, -20, -5], [-20, 50, -30], [-5, -30, 35]]


def test_modes_need_positive_masses():
    with pytest.raises(ChainError, match="m2 is not positive"):
        linear_chain([1.0, -2.0], [0, 0], [1, 1]).modes()


# -- forces --------------------------------------------------------------------


def test_forces_along_data_are_the_balances(chain4):
    law = {
        i: [laws.LinearViscous(c), laws.Duffing(k, k3)]
        for i, (c, k, k3) in enumerate(zip(chain4.c, chain4.k, chain4.k3), 1)
    }
    model = ChainModel(chain4.m, law)
    assert np.allclose(
        model.restoring_force(chain4.X), chain4.storey_forces, rtol=1e-12
    )
    assert np.allclose(model.predict(chain4.X), chain4.F, atol=1e-8)


@given(
    st.lists(st.floats(-1e3, 1e3), min_size=9, max_size=9),
    st.floats(-2, 2),
    st.floats(-2, 2),
)
def test_a_restoring_force_is_its_power_series(c, v, s):
    R = ChainModel([1.0], {1: laws.PowerSeries(3, c)}).restoring_forces[1]
    terms = [v, s, v * v, v * s, s * s, v**3, v * v * s, v * s * s, s**3]
    assert float(R(v, s)) == pytest.approx(np.dot(c, terms), rel=1e-9, abs=1e-6)
    assert R(np.zeros((2, 1)), np.zeros(3)).shape == (2, 3)


def test_forces_by_every_spelling_of_the_site():
    model = ChainModel(
        [1.0] * 4,
        {i: laws.LinearElastic(k=i) for i in range(1, 5)}
        | {"link 4-2": laws.LinearElastic(k=9.0)},
    )
    R = model.restoring_forces
    assert (
        R[2].linear_part()["k"]
        == R["storey 2"].linear_part()["k"]
        == R["link 2-1"].linear_part()["k"]
        == 2
    )
    assert R["link 2-4"].coefficients["s"] == 9.0 and list(R) == [
        "storey 1",
        "storey 2",
        "storey 3",
        "storey 4",
        "link 4-2",
    ]
    for wrong in (5, "storey 7", "link 3-1", "nonsense", 0):
        with pytest.raises(KeyError, match="storey 1"):
            R[wrong]


def test_a_force_with_memory_needs_a_path():
    R = ChainModel([1.0], {1: laws.Dahl(sigma=100.0, Fd=3.0)}).restoring_forces[1]
    s = np.linspace(0, 0.1, 50)
    assert R(np.ones(50), s) == pytest.approx(3 * (1 - np.exp(-100 * s)))
    with pytest.raises(LawError, match="depends on the path"):
        R(1.0, 0.1)


# -- text ----------------------------------------------------------------------


def test_equations_read_like_the_papers():
    model = ChainModel(
        [9.85, 10.0],
        {
            1: laws.PowerSeries((1, 2), [476.07, 101120.0, -1.5, 3e4, 2e6]),
            2: laws.PowerSeries(1, [100, 1e5]),
        },
    )
    assert str(model).splitlines() == [
        "m1 = 9.85 kg, m2 = 10 kg  (R in N, s in m, v in m/s)",
        "R1 = 476.1 v1 + 1.011e+05 s1 - 1.5 v1 s1 + 3e+04 s1^2 + 2e+06 v1 s1^2",
        "R2 = 100 v2 + 1e+05 s2",
    ]
    brace = ChainModel([1.0] * 4, {"link 4-2": laws.LinearElastic(k=-3.0)})
    assert brace.equations() == ["R_42 = -3 s_42"]


def test_the_printed_equation_is_the_force():
    """Whoever types the printed equation into a calculator gets the force."""
    rng = np.random.default_rng(0)
    R = ChainModel(
        [1.0], {1: laws.PowerSeries(3, rng.normal(size=9) * 100)}
    ).restoring_forces[1]
    text = R.equation(digits=17).split("=")[1].replace("^", "**")
    for factor in ("v1", "s1"):
        text = text.replace(f" {factor}", f"*{factor}")
    for v, s in rng.normal(size=(5, 2)):
        assert eval(text, {"v1": v, "s1": s}) == pytest.approx(
            float(R(v, s)), rel=1e-12
        )


# -- surface -------------------------------------------------------------------


def test_the_surface_covers_what_was_visited(chain4):
    model = NRFRegressor(degree=3).fit(chain4.X, chain4.F).model_
    table = model.surface("storey 2", size=31)
    v, s = chain4.v[:, 1], chain4.s[:, 1]
    assert len(table) == 31**2
    assert (
        table.v.min(),
        table.v.max(),
        table.s.min(),
        table.s.max(),
    ) == pytest.approx((v.min(), v.max(), s.min(), s.max()))
    expected = chain4.c[1] * table.v + chain4.k[1] * table.s + chain4.k3[1] * table.s**3
    assert np.allclose(table.R, expected, rtol=1e-9, atol=1e-6)
    assert model.visited["storey 2"].contains(v, s).all()
    corners = table[
        (table.v.abs() > 0.95 * abs(v).max()) & (table.s.abs() > 0.95 * abs(s).max())
    ]
    assert not corners.visited.any() and 0.2 < table.visited.mean() < 0.95
    assert not model.visited["storey 2"].contains(10 * v.max(), 0.0)


def test_a_force_that_depends_on_the_path_is_no_surface(dahl):
    case, *_ = dahl
    model = (
        NRFRegressor(
            degree=1, laws={1: [laws.PowerSeries(1), laws.Dahl(sigma=5e4)]}, dt=case.dt
        )
        .fit(case.X, case.F)
        .model_
    )
    with pytest.raises(LawError, match="it is no surface"):
        model.surface(1)
    with pytest.raises(ChannelError, match="is not known"):
        linear_chain([1.0], [1], [1]).surface(1)


# -- what cannot be a model ----------------------------------------------------


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ChainModel([1.0, np.nan], {}), "finite"),
        (lambda: ChainModel([1.0], {1: laws.LinearElastic()}), "no values"),
        (lambda: ChainModel([1.0], {1: laws.Dahl(Fd=1.0)}), "no values"),
        (lambda: ChainModel([1.0], {2: laws.LinearElastic(k=1.0)}), "storey 2"),
        (lambda: ChainModel([1.0, 1.0], {}, Chain(3)), "2 masses for a chain with 3"),
        (
            lambda: ChainModel(
                [1.0] * 3, {"link 3-1": laws.LinearElastic(k=1.0)}, Chain(3)
            ),
            "not in the chain",
        ),
    ],
)
def test_what_cannot_be_a_model(make, message):
    with pytest.raises((ChainError, LawError), match=message):
        make()


def test_a_model_with_a_floor_that_nothing_holds():
    """A free mass above a spring: its site has no law, and neither words nor notebook
    view fail on it.
    """
    model = ChainModel(
        [5.0, 4.0], {"storey 1": [laws.PowerSeries(1, [3.0, 3e4])], "storey 2": []}
    )
    shown = model._repr_html_()
    assert (
        "m2 = 4 kg" in shown
        and 'alttext="R_{1}(' in shown
        and 'alttext="R_{2}(' not in shown
    )
    run = simulate(model, np.column_stack([np.zeros(400), 8.0 * np.ones(400)]), 1e-3)
    np.testing.assert_allclose(
        run.displacement[-1, 1], 0.5 * 2.0 * 0.399**2, rtol=1e-6
    )  # x = F t^2 / (2 m)
    assert not run.displacement[:, 0].any()


TWINS = [
    laws.PowerSeries(1, [30.0, 4e4]),
    laws.Dahl(sigma=3e4, Fd=4.0),
    laws.Dahl(sigma=2e3, Fd=12.0),
]


def test_two_laws_of_one_family_keep_their_own_coefficients():
    model = ChainModel([10.0], {1: TWINS})
    own = model.restoring_forces[1].coefficients
    assert own.to_dict() == {"v": 30.0, "s": 4e4, "Z (dahl 1)": 4.0, "Z (dahl 2)": 12.0}
    assert LawLayout(model.chain, model.laws).labels("storey 1") == own.index.tolist()
    named = parameters_of(model)
    assert named.tolist() == [10.0, 30.0, 4e4, 4.0, 12.0]
