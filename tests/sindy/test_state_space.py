"""A chain as a true ps.SINDy, and back."""

import warnings

import chains
import numpy as np
import pysindy as ps
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from pysindy_nrf import (
    ChainModel,
    InterstoryPolynomialLibrary,
    NRFRegressor,
    StateSpaceChainOptimizer,
    laws,
)
from pysindy_nrf.exceptions import ChainError, ChannelError, LawError
from pysindy_nrf.sindy import ForceLawLibrary, from_sindy, to_sindy

N = 3


@pytest.fixture(scope="module")
def case():
    return chains.duffing(N, [2], seed=4, n_samples=6000)


def state_of(case):
    return case.absolute[:, case.n :][:, np.r_[case.n : 2 * case.n, 0 : case.n]]


def rates_of(case):
    return np.hstack([case.v.cumsum(axis=1), case.a])


def truth_of(case):
    held = {
        i + 1: [laws.LinearViscous(case.c[i]), laws.Duffing(case.k[i], case.k3[i])]
        for i in range(case.n)
    }
    return ChainModel(case.m, held)


def test_its_right_hand_side_is_newtons_second_law(case):
    """Against the balances written out here, at the record's own states and forces."""
    rates = to_sindy(truth_of(case)).predict(state_of(case), u=case.F)
    R = case.storey_forces
    a = (case.F - R + np.hstack([R[:, 1:], np.zeros((len(R), 1))])) / case.m
    assert np.abs(rates[:, :N] - case.v.cumsum(axis=1)).max() == 0.0
    assert np.abs(rates[:, N:] - a).max() < 1e-12 * np.abs(a).max()


@settings(deadline=None, max_examples=25)
@given(st.integers(1, 5), st.integers(0, 10_000))
def test_there_and_back_is_the_same_model(n, seed):
    m, c, k, k3 = chains.parameters(n, np.random.default_rng(seed))
    model = ChainModel(
        m,
        {
            i + 1: [laws.PowerSeries(2, [c[i], k[i], 0.0, 1.0, -k3[i] / 1e3])]
            for i in range(n)
        },
    )
    assert from_sindy(to_sindy(model)) == model


def test_the_regressor_gives_its_model(case):
    model = NRFRegressor(degree=3, dt=case.dt).fit(case.X, case.F)
    assert from_sindy(to_sindy(model)) == model.model_


def test_trajectory_lists_with_one_floor_hit_in_each_give_the_chain():
    records = [chains.duffing(N, [j], seed=7, n_samples=3000) for j in (1, 2, 3)]
    library = InterstoryPolynomialLibrary(3, inputs="state")
    sindy = ps.SINDy(
        feature_library=library, optimizer=StateSpaceChainOptimizer(terms=library)
    )
    rates = [np.hstack([r.v.cumsum(axis=1), r.a]) for r in records]
    sindy.fit(
        [state_of(r) for r in records],
        t=[np.arange(3000) * r.dt for r in records],
        x_dot=rates,
        u=[r.F for r in records],
    )
    found = from_sindy(sindy)
    assert np.abs(found.masses / records[0].m - 1).max() < 1e-8
    for i in range(N):
        law = found.restoring_forces[i + 1].coefficients
        assert law["s"] == pytest.approx(records[0].k[i], rel=1e-6) and law[
            "s^3"
        ] == pytest.approx(records[0].k3[i], rel=1e-5)


def test_the_weak_form_takes_library_and_optimizer_as_they_are(case):
    """x, v and F with 5 % noise: masses that differences ruin come out of integrals
    over windows of 40 ms.
    """
    rng = np.random.default_rng(0)
    state, F = (
        y + 0.05 * y.std(axis=0) * rng.standard_normal(y.shape)
        for y in (state_of(case), case.F)
    )
    np.random.seed(0)  # the windows are placed by NumPy's global state
    library = InterstoryPolynomialLibrary(3, inputs="state")
    grid = np.arange(len(F)) * case.dt
    weak = ps.WeakPDELibrary(
        function_library=library, spatiotemporal_grid=grid, K=400, H_xt=[0.02]
    )
    worst = []
    for features in (weak, library):
        sindy = ps.SINDy(StateSpaceChainOptimizer(terms=library), features).fit(
            state, t=case.dt, u=F
        )
        worst.append(np.abs(sindy.optimizer.masses_ / case.m - 1).max())
    assert worst[0] < 0.05 and worst[1] > 0.4


def test_one_shaker_is_one_column_of_u(case):
    """PySINDy's way with one actuator: the same chain as with zeros written out for the
    floors that rest.
    """
    found = {}
    for forced, u in ((2, case.F[:, 1:2]), (None, case.F)):
        library = InterstoryPolynomialLibrary(3, inputs="state", excited=forced)
        sindy = ps.SINDy(
            feature_library=library, optimizer=StateSpaceChainOptimizer(terms=library)
        )
        sindy.fit(state_of(case), t=case.dt, x_dot=rates_of(case), u=u)
        found[forced] = from_sindy(sindy)
        assert np.abs(found[forced].masses / case.m - 1).max() < 1e-8
        names = [
            "x1",
            "x2",
            "x3",
            "v1",
            "v2",
            "v3",
            *(f"shaker {j}" for j in library.excited_),
        ]
        assert library.get_feature_names(names)[-2] == "shaker 2"
    assert found[2] == found[None]


@pytest.mark.parametrize("forced", [(), None])
def test_free_vibration_needs_no_u_and_one_known_mass(case, forced):
    """Two storeys let go: with the mass of the roof known, everything else follows from
    equations (4)-(5).
    """
    m, c, k = np.array([12.0, 9.0]), np.array([40.0, 25.0]), np.array([9e3, 6e3])
    M, C, K = (
        np.diag(m),
        np.array([[65.0, -25.0], [-25.0, 25.0]]),
        np.array([[15e3, -6e3], [-6e3, 6e3]]),
    )
    A = np.block(
        [
            [np.zeros((2, 2)), np.eye(2)],
            [-np.linalg.solve(M, K), -np.linalg.solve(M, C)],
        ]
    )
    t = np.arange(2000) * 0.005
    run = solve_ivp(
        lambda _, y: A @ y,
        (0, t[-1]),
        [0.01, -0.02, 0.1, 0.3],
        t_eval=t,
        rtol=1e-11,
        atol=1e-14,
        method="DOP853",
    ).y.T
    library = InterstoryPolynomialLibrary(1, inputs="state", excited=forced)
    sindy = ps.SINDy(
        feature_library=library,
        optimizer=StateSpaceChainOptimizer(known_masses={2: 9.0}, terms=library),
    )
    with warnings.catch_warnings(record=True, action="always") as said:
        sindy.fit(run, t=0.005, x_dot=run @ A.T)
    assert any(
        "x and xdot of 2 DOFs in free vibration" in str(w.message) for w in said
    ) == (forced is None)
    model = from_sindy(sindy)
    assert model.masses == pytest.approx(m, rel=1e-7)
    for i in (1, 2):
        assert model.restoring_forces[i].coefficients.to_dict() == pytest.approx(
            {"v": c[i - 1], "s": k[i - 1]}, rel=1e-6
        )


@pytest.mark.parametrize(
    ("excited", "inputs", "width", "words"),
    [
        ((2,), "state", 6, "5 are needed"),
        ((3,), "state", 5, "excited names DOF 3"),
        ((1, 1), "state", 6, "names a DOF twice"),
        (1, "balance", 3, "inputs='state'"),
    ],
)
def test_columns_of_u_that_do_not_fit_are_refused(excited, inputs, width, words):
    with pytest.raises((ChainError, ChannelError), match=words):
        InterstoryPolynomialLibrary(1, inputs=inputs, excited=excited).fit(
            np.zeros((5, width))
        )


def test_a_plain_optimizer_on_our_library_is_read_too():
    """Every floor forced, normalised STLSQ of PySINDy itself: masses are the
    reciprocals of its coefficients.
    """
    case = chains.duffing(2, [1, 2], seed=3, n_samples=4000)
    plain = ps.STLSQ(threshold=1e-6, alpha=0.0, normalize_columns=True)
    sindy = ps.SINDy(plain, InterstoryPolynomialLibrary(3, inputs="state"))
    sindy.fit(state_of(case), t=case.dt, x_dot=rates_of(case), u=case.F)
    found = from_sindy(sindy)
    assert np.abs(found.masses / case.m - 1).max() < 1e-6
    assert found.restoring_forces[2].coefficients["s"] == pytest.approx(
        case.k[1], rel=1e-4
    )


def test_what_cannot_be_read_is_refused_in_words(case):
    for sindy, words in (
        (
            ps.SINDy(feature_library=ps.PolynomialLibrary(1)),
            "PolynomialLibrary does not say which column",
        ),
        (
            ps.SINDy(
                ps.STLSQ(threshold=0.5), InterstoryPolynomialLibrary(1, inputs="state")
            ),
            "m1, m2, m3 cannot be read off",
        ),
    ):
        with warnings.catch_warnings(action="ignore"):
            sindy.fit(state_of(case), t=case.dt, x_dot=rates_of(case), u=case.F)
        with pytest.raises(ChainError, match=words):
            from_sindy(sindy)
    with pytest.raises(LawError, match="remembers the path"):
        to_sindy(ChainModel([1.0], {1: laws.Dahl(1e3, 10.0)}))


def test_a_shape_must_have_a_value():
    case = chains.duffing(1, [1], seed=3, n_samples=400, cubic=False)
    library = ForceLawLibrary(
        {"storey 1": [laws.PowerSeries(1), laws.TwoSidedGap()]}, inputs="state"
    )
    sindy = ps.SINDy(
        feature_library=library, optimizer=StateSpaceChainOptimizer(terms=library)
    )
    with pytest.raises(LawError, match="gap|shape"):
        sindy.fit(state_of(case), t=case.dt, x_dot=rates_of(case), u=case.F)
