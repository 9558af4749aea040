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
    NRFRegressor,
    StateSpaceChainOptimizer,
    laws,
)
from pysindy_nrf.chain.identifiability import plan_solve_order
from pysindy_nrf.chain.layout import Layout, blocks_of
from pysindy_nrf.equations.chain_solve import solve_blocks
from pysindy_nrf.exceptions import (
    ChannelError,
    ExcitationError,
    IdentifiabilityError,
    NRFError,
)
from pysindy_nrf.sindy.feature_library import (
    ForceLawLibrary,
    InterstoryPolynomialLibrary,
)

pytestmark = pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.BiasWarning")


def sindy(X, F, dt, optimizer=None, degree=3, **options):
    library = InterstoryPolynomialLibrary(degree)
    model = ps.SINDy(
        feature_library=library,
        optimizer=ChainOptimizer(optimizer, terms=library, **options),
    )
    return model.fit(X, t=dt, x_dot=F)


# -- three entrances -----------------------------------------------------------

INNER = {
    "least squares": None,
    "STLSQ": ps.STLSQ(threshold=0.01),
    "SR3": ps.SR3(reg_weight_lam=1e-3),
    "SSR": ps.SSR(),
    "FROLS": ps.FROLS(max_iter=6),
}


@pytest.mark.parametrize(
    ("inner", "forced"),
    [
        *((name, [3]) for name in INNER),
        ("least squares", [1, 2, 3, 4]),
        ("STLSQ", [1, 2, 3, 4]),
    ],
)
def test_the_three_entrances_agree(inner, forced):
    case, inner = chains.duffing(4, forced, seed=1), INNER[inner]
    X = case.noisy()
    regressor = NRFRegressor(degree=3, optimizer=inner).fit(X, case.F)
    optimizer = sindy(X, case.F, case.dt, inner).optimizer

    chain = Chain(4)
    terms = np.asarray(InterstoryPolynomialLibrary(3).fit_transform(X))[:, 4:]
    layout, order = (
        Layout(chain, dict.fromkeys(chain.sites, 9)),
        plan_solve_order(chain, forced, alone=inner is not None),
    )
    direct, _ = solve_blocks(
        layout, order, lambda: blocks_of(terms, X[:, :4], case.F), inner=inner
    )

    assert worst(optimizer.masses_, regressor.masses_) < 1e-10
    assert worst([direct.masses[j] for j in range(1, 5)], regressor.masses_) < 1e-10
    for i in range(1, 5):
        rms = np.sqrt(np.mean(terms[:, 9 * (i - 1) : 9 * i] ** 2, axis=0))
        found = [
            regressor.restoring_forces_[i].coefficients.to_numpy(),
            optimizer.coef_[i - 1, 4 + 9 * (i - 1) : 4 + 9 * i],
            direct.coefficients[chain.site(i)],
        ]
        scale = np.linalg.norm(found[0] * rms)
        assert np.abs((found[1] - found[0]) * rms).max() < 1e-10 * scale
        assert np.abs((found[2] - found[0]) * rms).max() < 1e-10 * scale
        if len(forced) < 4 and i > 1:  # Newton's third law in the other balance
            assert np.array_equal(
                optimizer.coef_[i - 2, 4 + 9 * (i - 1) : 4 + 9 * i], -found[1]
            )


# -- sparse optimizers on SI units ---------------------------------------------


def _kept(model):
    return [
        tuple(R.coefficients.index[R.coefficients != 0])
        for R in model.restoring_forces_.values()
    ]


@pytest.mark.parametrize(
    "inner",
    [
        ps.STLSQ(threshold=0.03),
        ps.SR3(reg_weight_lam=1e-3),
        ps.SSR(kappa=1e-3),
        ps.FROLS(max_iter=5),
    ],
    ids=lambda o: type(o).__name__,
)
def test_a_threshold_means_the_same_in_any_units_and_that_of_stlsq_at_any_number_of_samples(
    inner,
):
    case = chains.duffing(2, [2], seed=5)
    X = case.noisy()
    model = NRFRegressor(degree=3, optimizer=inner).fit(X, case.F)
    times = (3, 1) if isinstance(inner, ps.STLSQ) else (1, 1)
    other = NRFRegressor(degree=3, optimizer=inner).fit(
        np.tile(1e3 * X, times), np.tile(case.F / 1e3, times)
    )  # mm, kN
    assert (
        _kept(other) == _kept(model)
        and worst(other.masses_ * 1e6, model.masses_) < 1e-8
    )


def test_a_term_is_kept_if_and_only_if_its_share_of_the_force_reaches_the_threshold():
    """One DOF, linear law, the damping force is a known share of the force."""
    a, v, s = np.random.default_rng(0).standard_normal((3, 5000, 1))
    F = 4 * a + 0.05 * v + 3 * s  # rms 5: damping is one percent of it
    X = np.hstack([a, v, s])
    for threshold, kept in [(0.009, True), (0.011, False)]:
        model = NRFRegressor(degree=1, optimizer=ps.STLSQ(threshold=threshold)).fit(
            X, F
        )
        assert (model.restoring_forces_[1].coefficients["v"] != 0) == kept
        assert model.masses_[0] == pytest.approx(4.0, rel=1e-3)


def test_the_mass_is_never_thresholded_away():
    """Inertia of one percent of the force is still the mass. (SSR and FROLS never
    return both other terms.)
    """
    a, v, s = np.random.default_rng(0).standard_normal((3, 5000, 1))
    F = 0.01 * a + v + 3 * s
    for inner in (ps.STLSQ(threshold=0.2), ps.SR3(reg_weight_lam=1e-3)):
        model = NRFRegressor(degree=1, optimizer=inner).fit(np.hstack([a, v, s]), F)
        assert model.masses_[0] == pytest.approx(0.01, rel=0.2)


def test_the_triangular_factor_gives_what_all_samples_give():
    """Compress first: PySINDy's STLSQ on 20 rows equals PySINDy's STLSQ on all scaled
    samples.
    """
    case = chains.duffing(1, [1], seed=8)
    X = case.noisy(0.05)
    known = {1: case.m[0]}
    inner = ps.STLSQ(threshold=0.03)
    model = NRFRegressor(degree=5, optimizer=inner, known_masses=known).fit(X, case.F)
    columns = np.asarray(InterstoryPolynomialLibrary(5).fit(X).transform(X))[:, 1:]
    target = case.F[:, 0] - case.m[0] * X[:, 0]
    size, size_y = np.sqrt(np.mean(columns**2, axis=0)), np.sqrt(np.mean(target**2))
    plain = (
        clone(inner).fit(columns / size, (target / size_y)[:, None]).coef_[0]
        * size_y
        / size
    )
    assert model.restoring_forces_[1].coefficients.to_numpy() == pytest.approx(
        plain, rel=1e-8, abs=1e-12
    )
    assert 0 < np.count_nonzero(plain) < plain.size


@pytest.mark.parametrize("degree", [9, 12])
def test_unbiasing_keeps_all_digits_at_high_degree(degree):
    """PySINDy unbiases with scikit-learn's LinearRegression, which cuts directions
    below 1e-6: scaled columns stay above.
    """
    case = chains.duffing(1, [1], seed=8, n_samples=3000)
    plain = NRFRegressor(degree=degree).fit(case.X, case.F)
    kept = NRFRegressor(
        degree=degree, optimizer=ps.STLSQ(threshold=0.0, alpha=0.0)
    ).fit(case.X, case.F)
    assert worst(kept.masses_, plain.masses_) < 1e-8
    assert np.allclose(
        kept.predict(case.X), plain.predict(case.X), atol=1e-7 * np.abs(case.F).max()
    )


def test_a_threshold_above_everything_is_named(chain4):
    with pytest.raises(
        IdentifiabilityError,
        match="dropped every term of storey 4.*lower its threshold",
    ):
        NRFRegressor(optimizer=ps.STLSQ(threshold=10)).fit(chain4.X, chain4.F)


# -- ps.SINDy ------------------------------------------------------------------


def test_bagging_around_the_chain_optimizer(chain4):
    np.random.seed(0)  # EnsembleOptimizer draws from NumPy's global state
    library = InterstoryPolynomialLibrary(3)
    optimizer = ps.EnsembleOptimizer(
        ChainOptimizer(terms=library), bagging=True, n_models=3, n_subset=1500
    )
    model = ps.SINDy(feature_library=library, optimizer=optimizer).fit(
        chain4.noisy(0.002), t=chain4.dt, x_dot=chain4.F
    )
    assert (
        worst(np.diag(model.coefficients()[:, :4]), chain4.m) < 0.05
        and len(model.optimizer.coef_list) == 3
    )


def test_names_of_braces_and_laws():
    held = {
        1: laws.LinearElastic(),
        2: [laws.LinearViscous(), laws.CoulombFriction()],
        "link 3-1": laws.CubicStiffness(),
    }
    names = (
        ForceLawLibrary(held, Chain(3, ["link 3-1"]))
        .fit(np.zeros((5, 9)))
        .get_feature_names()
    )
    assert names == ["a1", "a2", "a3", "s1", "v2", "sgn(v2)", "s_link31^3"]


# -- state space ---------------------------------------------------------------


def test_state_space_rows_are_the_equations_of_motion():
    case = chains.duffing(3, [2], seed=6, n_samples=3000)
    x, v = case.s.cumsum(axis=1), case.v.cumsum(axis=1)
    library = InterstoryPolynomialLibrary(3, inputs="state")
    model = ps.SINDy(
        StateSpaceChainOptimizer(ps.STLSQ(threshold=0.005), terms=library), library
    )
    model.fit(np.hstack([x, v]), t=case.dt, x_dot=np.hstack([v, case.a]), u=case.F)
    names, C = model.get_feature_names(), model.coefficients()
    m, c, k, k3 = case.m, case.c, case.k, case.k3
    assert worst(model.optimizer.masses_, m) < 1e-8
    expected = {
        "v2": -c[1] / m[1],
        "s2": -k[1] / m[1],
        "s2^3": -k3[1] / m[1],
        "v3": c[2] / m[1],
        "s3": k[2] / m[1],
        "s3^3": k3[2] / m[1],
        "F2": 1 / m[1],
    }
    row = dict(zip(names, C[4], strict=True))
    assert {name for name, value in row.items() if value} == set(expected)
    assert all(
        row[name] == pytest.approx(value, rel=1e-8) for name, value in expected.items()
    )
    assert np.array_equal(C[:3, :3], np.eye(3)) and not C[:3, 3:].any()


# -- contract of an optimizer and a library ------------------------------------


def test_optimizer_takes_what_a_chain_needs(chain4):
    unknown = np.where([False, False, False, True], np.nan, chain4.F)
    for known, F in ((4, unknown), (1, chain4.F)):
        optimizer = ChainOptimizer(
            known_masses={known: chain4.m[known - 1]}, terms=[9, 9, 9, 9]
        )
        masses = optimizer.fit(
            InterstoryPolynomialLibrary(3).fit_transform(chain4.X), F
        ).masses_
        assert (
            masses[known - 1] == chain4.m[known - 1] and worst(masses, chain4.m) < 1e-8
        )


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda x, F: ChainOptimizer().fit(x, 0 * F), "nothing scales the chain"),
        (
            lambda x, F: ChainOptimizer().fit(x[:, :39], F),
            "which of 35 columns belong to which of 4 sites. .* terms=library",
        ),
        (
            lambda x, F: ChainOptimizer(terms=[9, 9]).fit(x, F),
            "does not fit 36 columns at 4 sites",
        ),
        (
            lambda x, F: ChainOptimizer(chain=Chain(3), terms=[12] * 3).fit(
                np.asarray(x), F
            ),
            "4 balances for a chain with 3",
        ),
        (lambda x, F: ChainOptimizer().fit(x[:, :3], F), "3 features for 4 balances"),
        (
            lambda x, F: ChainOptimizer(terms=[9] * 4).fit(
                np.where(x == x[50, 7], np.inf, x), F
            ),
            "infinite in row 50",
        ),
        (
            lambda x, F: ChainOptimizer(strategy="complete").fit(x, F),
            "none is measured on DOF 1, 2, 4",
        ),
        (lambda x, F: ChainOptimizer(known_masses={9: 1.0}).fit(x, F), "DOF 9"),
        (lambda x, F: ChainOptimizer("STLSQ").fit(x, F), "not an optimizer"),
        (
            lambda x, F: StateSpaceChainOptimizer().fit(x, F[:, :3]),
            "features of inputs='balance'",
        ),
        (
            lambda x, F: StateSpaceChainOptimizer().fit(x[:, :5], F[:, :3]),
            "odd number of targets: accelerations alone",
        ),
        (
            lambda x, F: ChainOptimizer().fit(x[:500], F),
            "500 samples, the targets 4000",
        ),
    ],
)
def test_optimizers_refuse_in_words(chain4, make, message):
    with pytest.raises(
        (ChannelError, ExcitationError, IdentifiabilityError, NRFError), match=message
    ):
        make(InterstoryPolynomialLibrary(3).fit_transform(chain4.X), chain4.F)


def test_accelerations_alone_as_targets_give_the_same_rows():
    case = chains.duffing(3, [2], seed=5, n_samples=2000)
    x, v = np.cumsum(case.s, axis=1), np.cumsum(case.v, axis=1)
    state = np.hstack([x, v, case.F])
    features = (
        InterstoryPolynomialLibrary(3, inputs="state").fit(state).transform(state)
    )
    both = StateSpaceChainOptimizer().fit(features, np.hstack([v, case.a]))
    alone = StateSpaceChainOptimizer().fit(features, case.a)
    assert np.array_equal(alone.coef_, both.coef_[3:]) and np.array_equal(
        both.coef_[:3, :3], np.eye(3)
    )
    assert worst(alone.masses_, case.m) < 1e-8
    assert np.allclose(
        alone.predict(features), case.a, atol=1e-8 * np.abs(case.a).max()
    )
