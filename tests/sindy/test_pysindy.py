"""One solve behind three entrances, and PySINDy's own tools on chains."""

import chains
import numpy as np
import pysindy as ps
import pytest
from chains import worst
from sklearn.base import clone

from pysindy_nrf import (
    Chain,
    ChainOptimizer,
    ForceLawLibrary,
    InterstoryPolynomialLibrary,
    NRFRegressor,
    StateSpaceChainOptimizer,
    laws,
)
from pysindy_nrf.chain import Layout, blocks_of, plan_solve_order
from pysindy_nrf.equations import groups_of, solve, total_products
from pysindy_nrf.exceptions import (
    ChannelError,
    ExcitationError,
    IdentifiabilityError,
    NRFError,
)

pytestmark = pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.BiasWarning")
N_TERMS = 9  # of a power series of degree 3


# -- three entrances -----------------------------------------------------------

INNER = {
    "least squares": None,
    "STLSQ": ps.STLSQ(threshold=0.01),
    "SR3": ps.SR3(reg_weight_lam=1e-3),
    "SSR": ps.SSR(),
    "FROLS": ps.FROLS(max_iter=6),
}
ENTRANCES = [
    *((name, [3]) for name in INNER),
    ("least squares", [1, 2, 3, 4]),
    ("STLSQ", [1, 2, 3, 4]),
]


@pytest.fixture(params=ENTRANCES, ids=str)
def entrance(request):
    name, forced = request.param
    return INNER[name], forced


@pytest.fixture
def test_data(entrance):
    return chains.duffing(4, entrance[1], seed=1)


def terms_of(X):
    """Terms of the storeys, (n_samples, 4 * N_TERMS)."""
    return np.asarray(InterstoryPolynomialLibrary(3).fit_transform(X))[:, 4:]


def assert_same_force(coefficients, expected, terms):
    """Coefficients of a storey that differ by no part of its force."""
    rms = np.sqrt(np.mean(terms**2, axis=0))
    scale = np.linalg.norm(expected * rms)
    assert np.abs((coefficients - expected) * rms).max() < 1e-10 * scale


def test_the_optimizer_in_sindy_finds_what_the_regressor_finds(entrance, test_data):
    inner, forced = entrance
    X, F = test_data.noisy(), test_data.F
    regressor = NRFRegressor(degree=3, optimizer=inner).fit(X, F)
    library = InterstoryPolynomialLibrary(3)
    optimizer = ChainOptimizer(inner, terms=library)
    ps.SINDy(optimizer, library).fit(X, t=test_data.dt, x_dot=F)
    assert worst(optimizer.masses_, regressor.masses_) < 1e-10
    terms = np.split(terms_of(X), 4, axis=1)
    rows = np.split(optimizer.coef_[:, 4:], 4, axis=1)
    for i in range(4):
        expected = regressor.restoring_forces_[i + 1].coefficients.to_numpy()
        assert_same_force(rows[i][i], expected, terms[i])
        if len(forced) == 1 and i > 0:
            # Newton's third law in the equation below
            assert np.array_equal(rows[i][i - 1], -rows[i][i])


def test_the_solve_itself_finds_what_the_regressor_finds(entrance, test_data):
    inner, forced = entrance
    X, F = test_data.noisy(), test_data.F
    regressor = NRFRegressor(degree=3, optimizer=inner).fit(X, F)
    chain, terms = Chain(4), terms_of(X)
    layout = Layout(chain, dict.fromkeys(chain.sites, N_TERMS))
    order = plan_solve_order(chain, forced, alone=inner is not None)
    blocks = blocks_of(terms, X[:, :4], F)
    sums = total_products(layout, groups_of(layout, order), blocks)
    solution = solve(sums, order, inner=inner)
    masses = [solution.masses[dof] for dof in range(1, 5)]
    assert worst(masses, regressor.masses_) < 1e-10
    for i, columns in enumerate(np.split(terms, 4, axis=1), 1):
        expected = regressor.restoring_forces_[i].coefficients.to_numpy()
        assert_same_force(solution.coefficients[chain.site(i)], expected, columns)


# -- sparse optimizers on SI units ---------------------------------------------


def kept_terms(model):
    selected = []
    for force in model.restoring_forces_.values():
        selected.append(force.coefficients.index[force.coefficients != 0].tolist())
    return selected


SPARSE = [
    ps.STLSQ(threshold=0.03),
    ps.SR3(reg_weight_lam=1e-3),
    ps.SSR(kappa=1e-3),
    ps.FROLS(max_iter=5),
]


@pytest.mark.parametrize("inner", SPARSE, ids=lambda inner: type(inner).__name__)
def test_a_threshold_means_the_same_in_any_units(inner):
    """Metres and newtons, or millimetres and kilonewtons."""
    case = chains.duffing(2, [2], seed=5)
    X, F = case.noisy(), case.F
    model = NRFRegressor(degree=3, optimizer=inner).fit(X, F)
    other = NRFRegressor(degree=3, optimizer=inner).fit(1e3 * X, F / 1e3)
    assert kept_terms(other) == kept_terms(model)
    assert worst(other.masses_ * 1e6, model.masses_) < 1e-8


def test_the_threshold_of_stlsq_means_the_same_at_any_number_of_samples():
    case = chains.duffing(2, [2], seed=5)
    X, F = case.noisy(), case.F
    inner = ps.STLSQ(threshold=0.03)
    model = NRFRegressor(degree=3, optimizer=inner).fit(X, F)
    other = NRFRegressor(degree=3, optimizer=inner)
    other.fit(np.tile(X, (3, 1)), np.tile(F, (3, 1)))
    assert kept_terms(other) == kept_terms(model)
    assert worst(other.masses_, model.masses_) < 1e-8


def linear_storey(m, c, k):
    """Random motions of one DOF and the force that they take."""
    X = np.random.default_rng(0).standard_normal((5000, 3))
    return X, X @ [m, c, k]


@pytest.mark.parametrize(("threshold", "is_kept"), [(0.009, True), (0.011, False)])
def test_a_term_is_kept_if_its_share_of_the_force_reaches_the_threshold(
    threshold, is_kept
):
    X, F = linear_storey(4.0, 0.05, 3.0)  # rms 5: damping is one percent of it
    model = NRFRegressor(degree=1, optimizer=ps.STLSQ(threshold=threshold)).fit(X, F)
    assert (model.restoring_forces_[1].coefficients["v"] != 0) == is_kept
    assert model.masses_[0] == pytest.approx(4.0, rel=1e-3)


@pytest.mark.parametrize(
    "inner",
    [ps.STLSQ(threshold=0.2), ps.SR3(reg_weight_lam=1e-3)],
    ids=["STLSQ", "SR3"],
)
def test_the_mass_is_never_thresholded_away(inner):
    """Inertia of one percent of the force is still the mass."""
    X, F = linear_storey(0.01, 1.0, 3.0)
    model = NRFRegressor(degree=1, optimizer=inner).fit(X, F)
    assert model.masses_[0] == pytest.approx(0.01, rel=0.2)


def test_the_triangular_factor_gives_what_all_samples_give():
    """PySINDy's STLSQ on 20 rows equals PySINDy's STLSQ on all scaled samples."""
    case = chains.duffing(1, [1], seed=8)
    X, inner = case.noisy(0.05), ps.STLSQ(threshold=0.03)
    known = {1: case.m[0]}
    model = NRFRegressor(degree=5, optimizer=inner, known_masses=known).fit(X, case.F)

    columns = np.asarray(InterstoryPolynomialLibrary(5).fit_transform(X))[:, 1:]
    target = case.F[:, 0] - case.m[0] * X[:, 0]
    size, size_y = np.sqrt(np.mean(columns**2, axis=0)), np.sqrt(np.mean(target**2))
    scaled = clone(inner).fit(columns / size, (target / size_y)[:, None]).coef_[0]
    expected = scaled * size_y / size
    coefficients = model.restoring_forces_[1].coefficients.to_numpy()
    assert coefficients == pytest.approx(expected, rel=1e-8, abs=1e-12)
    assert 0 < np.count_nonzero(expected) < expected.size


@pytest.mark.parametrize("degree", [9, 12])
def test_unbiasing_keeps_all_digits_at_high_degree(degree):
    """It cuts directions below 1e-6: scaled columns stay above."""
    case = chains.duffing(1, [1], seed=8, n_samples=3000)
    plain = NRFRegressor(degree=degree).fit(case.X, case.F)
    every = ps.STLSQ(threshold=0.0, alpha=0.0)
    unbiased = NRFRegressor(degree=degree, optimizer=every).fit(case.X, case.F)
    assert worst(unbiased.masses_, plain.masses_) < 1e-8
    gap = np.abs(unbiased.predict(case.X) - plain.predict(case.X))
    assert gap.max() < 1e-7 * np.abs(case.F).max()


def test_a_threshold_above_everything_is_named(chain4):
    model = NRFRegressor(optimizer=ps.STLSQ(threshold=10))
    with pytest.raises(IdentifiabilityError, match="term of storey 4"):
        model.fit(chain4.X, chain4.F)


# -- ps.SINDy ------------------------------------------------------------------


def test_bagging_around_the_chain_optimizer(chain4):
    np.random.seed(0)  # EnsembleOptimizer draws from NumPy's global state
    library = InterstoryPolynomialLibrary(3)
    optimizer = ps.EnsembleOptimizer(
        ChainOptimizer(terms=library), bagging=True, n_models=3, n_subset=1500
    )
    model = ps.SINDy(optimizer, library)
    model.fit(chain4.noisy(0.002), t=chain4.dt, x_dot=chain4.F)
    masses = np.diag(model.coefficients()[:, :4])
    assert worst(masses, chain4.m) < 0.05
    assert len(model.optimizer.coef_list) == 3


def test_names_of_braces_and_laws():
    by_site = {
        1: laws.LinearElastic(),
        2: [laws.LinearViscous(), laws.CoulombFriction()],
        "link 3-1": laws.CubicStiffness(),
    }
    library = ForceLawLibrary(by_site, Chain(3, ["link 3-1"])).fit(np.zeros((5, 9)))
    names = ["a1", "a2", "a3", "s1", "v2", "sgn(v2)", "s_link31^3"]
    assert library.get_feature_names() == names


# -- state space ---------------------------------------------------------------


@pytest.fixture(scope="module")
def state_case():
    return chains.duffing(3, [2], seed=6, n_samples=3000)


@pytest.fixture(scope="module")
def x(state_case):
    return state_case.s.cumsum(axis=1)


@pytest.fixture(scope="module")
def xdot(state_case):
    return state_case.v.cumsum(axis=1)


def test_state_space_rows_are_the_equations_of_motion(state_case, x, xdot):
    case = state_case
    library = InterstoryPolynomialLibrary(3, inputs="state")
    optimizer = StateSpaceChainOptimizer(ps.STLSQ(threshold=0.005), terms=library)
    model = ps.SINDy(optimizer, library)
    rates = np.hstack([xdot, case.a])
    model.fit(np.hstack([x, xdot]), t=case.dt, x_dot=rates, u=case.F)

    assert worst(optimizer.masses_, case.m) < 1e-8
    lower = np.array([case.c[1], case.k[1], case.k3[1]])
    upper = np.array([case.c[2], case.k[2], case.k3[2]])
    expected = dict(zip(["v2", "s2", "s2^3"], -lower / case.m[1]))
    expected |= dict(zip(["v3", "s3", "s3^3"], upper / case.m[1]))
    expected["F2"] = 1 / case.m[1]
    names, coefficients = model.get_feature_names(), model.coefficients()
    row = dict(zip(names, coefficients[4], strict=True))
    values = {name: value for name, value in row.items() if value}
    assert values == pytest.approx(expected, rel=1e-8)
    # a velocity is the sum of the rates of the storeys below
    for below, row in enumerate(coefficients[:3], 1):
        rates = [names[i] for i in np.flatnonzero(row)]
        assert rates == ["v1", "v2", "v3"][:below]
        assert (row[row != 0] == 1.0).all()


def test_accelerations_alone_as_targets_give_the_same_rows(state_case, x, xdot):
    case = state_case
    library = InterstoryPolynomialLibrary(3, inputs="state")
    features = library.fit_transform(np.hstack([x, xdot, case.F]))
    both = StateSpaceChainOptimizer().fit(features, np.hstack([xdot, case.a]))
    alone = StateSpaceChainOptimizer().fit(features, case.a)
    assert np.array_equal(alone.coef_, both.coef_[3:])
    assert worst(alone.masses_, case.m) < 1e-8
    gap = np.abs(alone.predict(features) - case.a)
    assert gap.max() < 1e-8 * np.abs(case.a).max()


# -- contract of an optimizer --------------------------------------------------


@pytest.fixture(scope="module")
def features(chain4):
    return InterstoryPolynomialLibrary(3).fit_transform(chain4.X)


@pytest.mark.parametrize("known", [1, 4])
def test_an_optimizer_takes_known_masses(chain4, features, known):
    masses = {known: chain4.m[known - 1]}
    F = chain4.F.copy()
    if known == 4:
        F[:, 3] = np.nan
    optimizer = ChainOptimizer(known_masses=masses, terms=[N_TERMS] * 4)
    fitted_masses = optimizer.fit(features, F).masses_
    assert fitted_masses[known - 1] == chain4.m[known - 1]
    assert worst(fitted_masses, chain4.m) < 1e-8


@pytest.mark.parametrize(
    ("optimizer", "message"),
    [
        (ChainOptimizer(terms=[9, 9]), "does not fit 36 columns at 4"),
        (ChainOptimizer(strategy="complete"), "measured on DOF 1, 2, 4"),
        (ChainOptimizer(known_masses={9: 1.0}), "DOF 9"),
        (ChainOptimizer("STLSQ"), "not an optimizer"),
    ],
    ids=str,
)
def test_settings_that_do_not_fit_are_refused(chain4, features, optimizer, message):
    with pytest.raises(NRFError, match=message):
        optimizer.fit(features, chain4.F)


def test_a_chain_of_other_size_is_refused(chain4, features):
    optimizer = ChainOptimizer(chain=Chain(3), terms=[12] * 3)
    with pytest.raises(ChannelError, match="4 balances for a chain"):
        optimizer.fit(np.asarray(features), chain4.F)


def test_features_without_their_library_need_it(chain4, features):
    with pytest.raises(ChannelError, match="which of 35 columns.* terms=library"):
        ChainOptimizer().fit(features[:, :39], chain4.F)
    with pytest.raises(ChannelError, match="3 features for 4 balances"):
        ChainOptimizer().fit(features[:, :3], chain4.F)


def test_targets_of_other_length_are_refused(chain4, features):
    with pytest.raises(ChannelError, match="500 samples, the targets 4000"):
        ChainOptimizer().fit(features[:500], chain4.F)


def test_an_infinite_feature_is_named(chain4, features):
    spoilt = np.asarray(features).copy()
    spoilt[50, 7] = np.inf
    with pytest.raises(ChannelError, match="infinite in row 50"):
        ChainOptimizer(terms=[N_TERMS] * 4).fit(spoilt, chain4.F)


def test_nothing_scales_a_chain_without_forces(chain4, features):
    with pytest.raises(ExcitationError, match="nothing scales the chain"):
        ChainOptimizer().fit(features, 0 * chain4.F)


def test_features_of_the_other_kind_are_refused(chain4, features):
    with pytest.raises(ChannelError, match="features of inputs='balance'"):
        StateSpaceChainOptimizer().fit(features, chain4.F[:, :3])
    with pytest.raises(ChannelError, match="accelerations alone"):
        StateSpaceChainOptimizer().fit(features[:, :5], chain4.F[:, :3])
