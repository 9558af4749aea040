"""A chain as a true ps.SINDy, and back."""

import warnings

import chains
import numpy as np
import pysindy as ps
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

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
    return np.hstack([case.s.cumsum(axis=1), case.v.cumsum(axis=1)])


def rates_of(case):
    return np.hstack([case.v.cumsum(axis=1), case.a])


def cubic_library(**options):
    return InterstoryPolynomialLibrary(3, inputs="state", **options)


def chain_sindy(library, **options):
    """ps.SINDy around a library and the solve of a chain."""
    optimizer = StateSpaceChainOptimizer(terms=library, **options)
    return ps.SINDy(optimizer, library)


def truth_of(case):
    storeys = {}
    for i in range(case.n):
        spring = laws.Duffing(case.k[i], case.k3[i])
        storeys[i + 1] = [laws.LinearViscous(case.c[i]), spring]
    return ChainModel(case.m, storeys)


# -- there and back ------------------------------------------------------------


def test_its_right_hand_side_is_newtons_second_law(case):
    """Against the equations written out here, at the record's states and forces."""
    rates = to_sindy(truth_of(case)).predict(state_of(case), u=case.F)
    R = case.storey_forces
    a = (case.F - R + np.hstack([R[:, 1:], np.zeros((len(R), 1))])) / case.m
    assert np.array_equal(rates[:, :N], case.v.cumsum(axis=1))
    assert np.abs(rates[:, N:] - a).max() < 1e-12 * np.abs(a).max()


@settings(max_examples=25)
@given(st.integers(1, 5), st.integers(0, 10_000))
def test_there_and_back_is_the_same_model(n, seed):
    m, c, k, k3 = chains.parameters(n, np.random.default_rng(seed))
    storeys = {}
    for i in range(n):
        values = [c[i], k[i], 0.0, 1.0, -k3[i] / 1e3]
        storeys[i + 1] = laws.PowerSeries(2, values)
    model = ChainModel(m, storeys)
    assert from_sindy(to_sindy(model)) == model


def test_a_fitted_regressor_gives_its_model(case):
    model = NRFRegressor(degree=3, dt=case.dt).fit(case.X, case.F)
    assert from_sindy(to_sindy(model)) == model.model_


def test_a_plain_optimizer_on_our_library_is_read_too():
    """Every floor forced: masses are the reciprocals of STLSQ's coefficients."""
    case = chains.duffing(2, [1, 2], seed=3, n_samples=4000)
    plain = ps.STLSQ(threshold=1e-6, alpha=0.0, normalize_columns=True)
    sindy = ps.SINDy(plain, cubic_library())
    sindy.fit(state_of(case), t=case.dt, x_dot=rates_of(case), u=case.F)
    model = from_sindy(sindy)
    assert np.abs(model.masses / case.m - 1).max() < 1e-6
    stiffness = model.restoring_forces[2].coefficients["s"]
    assert stiffness == pytest.approx(case.k[1], rel=1e-4)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    ("sindy", "words"),
    [
        (ps.SINDy(feature_library=ps.PolynomialLibrary(1)), "does not say which"),
        (ps.SINDy(ps.STLSQ(threshold=0.5), cubic_library()), "m1, m2, m3 cannot be"),
    ],
    ids=["another library", "no masses"],
)
def test_what_cannot_be_read_is_refused(case, sindy, words):
    sindy.fit(state_of(case), t=case.dt, x_dot=rates_of(case), u=case.F)
    with pytest.raises(ChainError, match=words):
        from_sindy(sindy)


def test_a_law_with_memory_is_no_state_space_model():
    with pytest.raises(LawError, match="remembers the path"):
        to_sindy(ChainModel([1.0], {1: laws.Dahl(1e3, 10.0)}))


def test_a_shape_must_have_a_value():
    case = chains.duffing(1, [1], seed=3, n_samples=400, cubic=False)
    gap = {"storey 1": [laws.PowerSeries(1), laws.TwoSidedGap()]}
    sindy = chain_sindy(ForceLawLibrary(gap, inputs="state"))
    with pytest.raises(LawError, match="gap|shape"):
        sindy.fit(state_of(case), t=case.dt, x_dot=rates_of(case), u=case.F)


# -- data as PySINDy takes them ------------------------------------------------


def test_trajectories_with_one_floor_hit_in_each_give_the_chain():
    records = [chains.duffing(N, [j], seed=7, n_samples=3000) for j in (1, 2, 3)]
    sindy = chain_sindy(cubic_library())
    sindy.fit(
        [state_of(record) for record in records],
        t=[np.arange(3000) * record.dt for record in records],
        x_dot=[rates_of(record) for record in records],
        u=[record.F for record in records],
    )
    model, truth = from_sindy(sindy), records[0]
    assert np.abs(model.masses / truth.m - 1).max() < 1e-8
    for i in range(N):
        force = model.restoring_forces[i + 1].coefficients
        assert force["s"] == pytest.approx(truth.k[i], rel=1e-6)
        assert force["s^3"] == pytest.approx(truth.k3[i], rel=1e-5)


@pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.BiasWarning")
def test_the_weak_form_takes_library_and_optimizer_as_they_are(case):
    """With 5 % noise masses come out of integrals over windows, not of differences."""
    rng = np.random.default_rng(0)
    state, F = (
        y + 0.05 * y.std(axis=0) * rng.standard_normal(y.shape)
        for y in (state_of(case), case.F)
    )
    np.random.seed(0)  # the windows are placed by NumPy's global state
    library = cubic_library()
    grid = np.arange(len(F)) * case.dt
    weak = ps.WeakPDELibrary(
        function_library=library, spatiotemporal_grid=grid, K=400, H_xt=[0.02]
    )
    errors = []
    for features in (weak, library):
        sindy = ps.SINDy(StateSpaceChainOptimizer(terms=library), features)
        sindy.fit(state, t=case.dt, u=F)
        errors.append(np.abs(sindy.optimizer.masses_ / case.m - 1).max())
    assert errors[0] < 0.05
    assert errors[1] > 0.4


def test_one_shaker_is_one_column_of_u(case):
    """The same chain as with zeros written out for the floors that rest."""
    alone = chain_sindy(cubic_library(excited=2))
    alone.fit(state_of(case), t=case.dt, x_dot=rates_of(case), u=case.F[:, 1:2])
    zeros = chain_sindy(cubic_library())
    zeros.fit(state_of(case), t=case.dt, x_dot=rates_of(case), u=case.F)
    assert np.abs(from_sindy(alone).masses / case.m - 1).max() < 1e-8
    assert from_sindy(alone) == from_sindy(zeros)


def test_features_are_independent_of_each_other(case):
    """No velocity stands there twice, and no column for a floor without a force."""
    library = cubic_library(excited=2)
    features = library.fit_transform(np.hstack([state_of(case), case.F[:, 1:2]]))
    columns = np.asarray(features)
    unit = columns / np.sqrt((columns**2).mean(axis=0))
    assert np.linalg.matrix_rank(unit) == columns.shape[1]


def test_a_plain_optimizer_with_normal_columns_takes_one_shaker(case):
    library = cubic_library(excited=2)
    plain = ps.STLSQ(threshold=0.0, alpha=0.0, normalize_columns=True)
    sindy = ps.SINDy(feature_library=library, optimizer=plain)
    sindy.fit(state_of(case), t=case.dt, x_dot=rates_of(case), u=case.F[:, 1:2])
    names = sindy.get_feature_names()
    inverse_mass = sindy.coefficients()[4, names.index("F2")]
    assert inverse_mass == pytest.approx(1 / case.m[1], rel=1e-6)


def test_a_storey_without_a_dashpot_keeps_the_velocity_of_its_floor(case):
    spring, storey = laws.Duffing(), [laws.LinearViscous(), laws.Duffing()]
    library = ForceLawLibrary({1: storey, 2: spring, 3: storey}, inputs="state")
    names = library.fit(np.zeros((5, 9))).get_feature_names()
    assert names[:2] == ["xdot2", "v1"]
    sindy = chain_sindy(library)
    sindy.fit(state_of(case), t=case.dt, x_dot=rates_of(case), u=case.F)
    rows = [dict(zip(sindy.get_feature_names(), row)) for row in sindy.coefficients()]
    nonzero = [{name for name, value in row.items() if value} for row in rows]
    assert nonzero[:3] == [{"v1"}, {"xdot2"}, {"xdot2", "v3"}]


def test_the_users_name_of_a_shaker_stands_at_its_column(case):
    library = cubic_library(excited=2)
    library.fit(np.hstack([state_of(case), case.F[:, 1:2]]))
    names = ["x1", "x2", "x3", "v1", "v2", "v3", "shaker"]
    assert library.get_feature_names(names)[-2:] == ["s3^3", "shaker"]


class FreeVibration:
    """Two linear storeys let go, by the exponential of their state matrix."""

    m = np.array([12.0, 9.0])
    c = [40.0, 25.0]
    k = [9e3, 6e3]
    dt = 0.005

    def __init__(self):
        C = np.array([[65.0, -25.0], [-25.0, 25.0]])
        K = np.array([[15e3, -6e3], [-6e3, 6e3]])
        lower = -np.hstack([K, C]) / self.m[:, None]
        A = np.vstack([np.eye(4)[2:], lower])
        step = expm(A * self.dt)
        states = [np.array([0.01, -0.02, 0.1, 0.3])]
        for _ in range(1999):
            states.append(step @ states[-1])
        self.state = np.array(states)
        self.rates = self.state @ A.T


@pytest.mark.parametrize("excited", [(), None], ids=["said", "guessed"])
def test_free_vibration_needs_no_u_and_one_known_mass(excited):
    """With the mass of the roof everything else follows (paper eqs. 4-5)."""
    test = FreeVibration()
    library = InterstoryPolynomialLibrary(1, inputs="state", excited=excited)
    sindy = chain_sindy(library, known_masses={2: 9.0})
    with warnings.catch_warnings(record=True, action="always") as caught:
        sindy.fit(test.state, t=test.dt, x_dot=test.rates)
    texts = " ".join(str(warning.message) for warning in caught)
    assert ("2 DOFs in free vibration" in texts) == (excited is None)

    model = from_sindy(sindy)
    assert model.masses == pytest.approx(test.m, rel=1e-7)
    for i in range(2):
        force = model.restoring_forces[i + 1].coefficients.to_dict()
        assert force == pytest.approx({"v": test.c[i], "s": test.k[i]}, rel=1e-6)


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
    library = InterstoryPolynomialLibrary(1, inputs=inputs, excited=excited)
    with pytest.raises((ChainError, ChannelError), match=words):
        library.fit(np.zeros((5, width)))
