"""The seam to PySINDy: one layout, honest optimizers, settings, warnings and scores."""

import warnings

import chains
import numpy as np
import pandas as pd
import pysindy as ps
import pytest
from chains import worst
from sklearn.base import BaseEstimator, clone
from sklearn.exceptions import ConvergenceWarning
from sklearn.model_selection import GridSearchCV, KFold
from sklearn.pipeline import make_pipeline

from pysindy_nrf import (
    Chain,
    ChainOptimizer,
    ForceLawLibrary,
    InterstoryPolynomialLibrary,
    NRFRegressor,
    Problem,
    StateSpaceChainOptimizer,
    excitation,
    laws,
)
from pysindy_nrf.exceptions import ChainError, ChannelError, NRFError

pytestmark = pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.BiasWarning")


@pytest.fixture(scope="module")
def case():
    return chains.duffing(3, [2], seed=6, n_samples=2000)


def fitted_sindy(case, library, optimizer):
    sindy = ps.SINDy(feature_library=library, optimizer=optimizer)
    return sindy.fit(case.X, t=case.dt, x_dot=case.F)


OPTIMIZERS = {"balance": ChainOptimizer, "state": StateSpaceChainOptimizer}


def sindy_data(case, inputs):
    """x, and x_dot and u, as ``ps.SINDy.fit`` takes them."""
    if inputs == "balance":
        return case.X, {"x_dot": case.F}
    x, xdot = case.s.cumsum(axis=1), case.v.cumsum(axis=1)
    rates = np.hstack([xdot, case.a])
    return np.hstack([x, xdot]), {"x_dot": rates, "u": case.F}


def passed_to_sindy(case, library):
    """A ``ps.SINDy`` whose optimizer knows nothing of the library."""
    optimizer = OPTIMIZERS[library.inputs]()
    x, data = sindy_data(case, library.inputs)
    sindy = ps.SINDy(feature_library=library, optimizer=optimizer)
    return sindy.fit(x, t=case.dt, **data)


# -- one layout for library and optimizer --------------------------------------

VISCOUS = laws.LinearViscous()
SPRING = laws.LinearElastic()
CUBIC = laws.Duffing()
STOREY = [VISCOUS, SPRING, laws.CubicStiffness()]
UNEVEN = {
    "laws": ForceLawLibrary(
        {1: STOREY, 2: [*STOREY, laws.CoulombFriction()], 3: [VISCOUS, CUBIC]}
    ),
    "sum": (
        ForceLawLibrary({1: STOREY, 2: STOREY, 3: [VISCOUS, SPRING]})
        + ForceLawLibrary({3: [laws.CubicStiffness()]})
    ),
    "orders": InterstoryPolynomialLibrary((1, 3), orders={2: 3, 3: (2, 3)}),
}
LIBRARIES = pytest.mark.parametrize("library", UNEVEN.values(), ids=UNEVEN)


@LIBRARIES
def test_an_optimizer_that_knows_the_library_finds_the_chain(case, library):
    sindy = fitted_sindy(case, library, ChainOptimizer(terms=library))
    row = dict(zip(sindy.get_feature_names(), sindy.coefficients()[1]))
    assert worst(sindy.optimizer.masses_, case.m) < 1e-8
    assert row["v2"] == pytest.approx(case.c[1], rel=1e-6)


@LIBRARIES
def test_features_bring_their_layout_in_a_pipeline(case, library):
    behind = make_pipeline(library, ChainOptimizer()).fit(case.X, case.F)[-1]
    inside = fitted_sindy(case, library, ChainOptimizer(terms=library))
    assert np.array_equal(behind.coef_, inside.coefficients())


@pytest.mark.parametrize("name", ["laws", "sum"])
def test_an_optimizer_that_cannot_know_the_layout_asks_for_it(case, name):
    library = UNEVEN[name]
    with pytest.raises(ChannelError, match="not known which .* terms=library"):
        fitted_sindy(case, library, ChainOptimizer())


@pytest.mark.parametrize("inputs", ["balance", "state"])
def test_power_series_show_their_layout_in_their_columns(case, inputs):
    library = InterstoryPolynomialLibrary((1, 3), orders={2: 3}, inputs=inputs)
    sindy = passed_to_sindy(case, library)
    assert worst(sindy.optimizer.masses_, case.m) < 1e-8


@pytest.mark.parametrize("inputs", ["balance", "state"])
@pytest.mark.parametrize("knows", ["the library", "nothing"])
def test_a_search_over_the_degree_clones_library_and_optimizer_apart(
    case, inputs, knows
):
    library = InterstoryPolynomialLibrary(2, inputs=inputs)
    terms = library if knows == "the library" else None
    lowest = 1 if knows == "the library" else 2
    optimizer = OPTIMIZERS[inputs](ps.STLSQ(threshold=0.003), terms=terms)
    search = GridSearchCV(
        ps.SINDy(feature_library=library, optimizer=optimizer),
        {"feature_library__degree": [lowest, 3]},
        scoring=lambda model, x: -worst(model.optimizer.masses_, case.m),
        cv=KFold(3),
        error_score="raise",
    )
    x, data = sindy_data(case, inputs)
    search.fit(x, t=case.dt, **data)
    assert search.best_params_ == {"feature_library__degree": 3}
    assert worst(search.best_estimator_.optimizer.masses_, case.m) < 1e-8


def test_columns_say_more_than_a_library_of_another_time(case):
    """Two libraries of as many terms, the one behind the other's features."""
    made = InterstoryPolynomialLibrary(1, orders={1: 3})
    other = InterstoryPolynomialLibrary(1, orders={3: 3})
    sindy = fitted_sindy(case, made, ChainOptimizer(terms=other))
    names = sindy.get_feature_names()
    shared = [names[i] for i in np.flatnonzero(sindy.coefficients()[2])]
    assert shared == ["a3", "v3", "s3"]


def test_two_columns_a_storey_show_no_layout():
    """Three terms at one storey and one at the other are no two series."""
    case = chains.duffing(2, [2], seed=6, n_samples=500)
    library = ForceLawLibrary({1: [VISCOUS, CUBIC], 2: [SPRING]})
    sindy = ps.SINDy(feature_library=library, optimizer=ChainOptimizer(terms=library))
    model = clone(sindy).fit(case.X, t=case.dt, x_dot=case.F)
    counts = model.optimizer.coef_[1] != 0
    assert counts.tolist() == [False, True, False, False, False, True]
    with pytest.raises(ChannelError, match="not known which"):
        fitted_sindy(case, library, ChainOptimizer())


def test_laws_that_a_search_changes_are_named(case):
    library = ForceLawLibrary(STOREY)
    sindy = ps.SINDy(feature_library=library, optimizer=ChainOptimizer(terms=library))
    changed = clone(sindy)
    changed.feature_library.set_params(laws=[*STOREY, laws.CoulombFriction()])
    with pytest.raises(ChannelError, match="optimizer__terms"):
        changed.fit(case.X, t=case.dt, x_dot=case.F)


@pytest.mark.parametrize("is_copy", [False, True], ids=["the library", "a copy"])
def test_a_forgotten_excited_is_named(is_copy):
    """Four DOFs with one column of u are nine columns, which three DOFs have, too."""
    case = chains.duffing(4, [2], seed=6, n_samples=500)
    x, xdot = case.s.cumsum(axis=1), case.v.cumsum(axis=1)
    library = InterstoryPolynomialLibrary(1, inputs="state")
    terms = library
    if is_copy:
        terms = InterstoryPolynomialLibrary(1, inputs="state")
    sindy = ps.SINDy(StateSpaceChainOptimizer(terms=terms), library)
    rates = np.hstack([xdot, case.a])
    with pytest.raises(ChannelError, match="excited=|library that made these"):
        sindy.fit(np.hstack([x, xdot]), t=case.dt, x_dot=rates, u=case.F[:, 1:2])


# -- inner optimizers ----------------------------------------------------------


def test_the_users_own_draws_do_not_depend_on_a_fit(case):
    """Whether an optimizer draws is found out by two fits with the same draws."""
    np.random.seed(3)
    expected = np.random.rand()
    np.random.seed(3)
    NRFRegressor(optimizer=ps.STLSQ(threshold=0.0123)).fit(case.X, case.F)
    assert np.random.rand() == expected


class Failing(BaseEstimator):
    def fit(self, X, y):
        raise IndexError("needs a quadratic library")


def test_an_optimizer_that_fails_is_named(case):
    with pytest.raises(NRFError, match="Failing cannot fit") as error:
        NRFRegressor(optimizer=Failing()).fit(case.X, case.F)
    assert "needs a quadratic library" in error.value.what
    assert error.value.cure.startswith("Use STLSQ")


INNER_SETTINGS = [
    (ChainOptimizer(known_masses={1: 5.0}), "known_masses={1: 5.0}, which"),
    (ChainOptimizer(strategy="joint"), "strategy='joint', which the estimator"),
    (ChainOptimizer(chain=Chain(3)), "has chain=Chain"),
    (StateSpaceChainOptimizer(), "for the rates of a state"),
]


@pytest.mark.parametrize(("inner", "message"), INNER_SETTINGS)
@pytest.mark.parametrize("entrance", ["regressor", "optimizer"])
def test_settings_of_an_inner_chain_optimizer_are_not_dropped(
    case, inner, message, entrance
):
    outer = NRFRegressor(optimizer=inner)
    if entrance == "optimizer":
        outer = make_pipeline(InterstoryPolynomialLibrary(), ChainOptimizer(inner))
    with pytest.raises(ChainError, match=message):
        outer.fit(case.X, case.F)


@pytest.mark.parametrize("entrance", ["regressor", "optimizer"])
def test_a_warning_of_inner_optimizers_is_given_once_with_the_storeys(case, entrance):
    inner = ps.SR3(1e-3, "l1", 1e-3, max_iter=10, tol=1e-15)
    model = NRFRegressor(optimizer=inner)
    if entrance == "optimizer":
        model = make_pipeline(InterstoryPolynomialLibrary(3), ChainOptimizer(inner))
    with pytest.warns(ConvergenceWarning) as caught:
        model.fit(case.X, case.F)
    texts = [str(w.message) for w in caught if w.category is ConvergenceWarning]
    assert len(texts) == 1
    for text in ("SR3 did not converge", "storey 1", "storey 2", "storey 3"):
        assert text in texts[0]


def test_fitted_optimizers_stand_by_their_equation(case):
    inner = ps.SR3(1e-3, "l1", 1e-3, max_iter=10, tol=1e-15)
    with warnings.catch_warnings(action="ignore"):
        fitted = NRFRegressor(optimizer=inner).fit(case.X, case.F).inner_
    assert set(fitted) == {"balance of DOF 1", "balance of DOF 2"}
    assert {len(optimizer.history_) for optimizer in fitted.values()} == {11}


# -- rows and scores -----------------------------------------------------------


def test_nan_rows_of_a_differentiation_are_left_out_in_every_trajectory(case):
    library = InterstoryPolynomialLibrary(3, inputs="state")
    derivative = ps.FiniteDifference(order=4, drop_endpoints=True)
    optimizer = StateSpaceChainOptimizer(terms=library)
    sindy = ps.SINDy(optimizer, library, derivative)
    state = np.hstack([case.s.cumsum(axis=1), case.v.cumsum(axis=1)])
    states, forces = [state[100:1000], state[1000:]], [case.F[100:1000], case.F[1000:]]
    sindy.fit(states, t=case.dt, u=forces)
    assert worst(sindy.optimizer.masses_, case.m) < 0.01


def test_equations_without_a_force_do_not_lower_a_score(case):
    search = GridSearchCV(
        make_pipeline(InterstoryPolynomialLibrary(), ChainOptimizer()),
        {"interstorypolynomiallibrary__degree": [1, 2, 3]},
        cv=KFold(4),
    )
    search.fit(case.noisy(0.005), case.F)
    assert search.best_params_ == {"interstorypolynomiallibrary__degree": 3}
    assert search.best_score_ > 0.9


def test_a_score_is_that_of_the_regressor_and_takes_unknown_forces(case):
    library = InterstoryPolynomialLibrary(3)
    sindy = fitted_sindy(case, library, ChainOptimizer(terms=library))
    features, F = library.transform(case.X), case.F.copy()
    regressor = NRFRegressor().fit(case.X, case.F)
    score = sindy.optimizer.score(features, F)
    assert score == pytest.approx(regressor.score(case.X, F), abs=1e-12)
    F[:, 0] = np.nan
    assert sindy.optimizer.score(features, F) == pytest.approx(1, abs=1e-9)


def test_pysindys_own_score_is_of_the_forces(case):
    library = InterstoryPolynomialLibrary(3)
    sindy = fitted_sindy(case, library, ChainOptimizer(terms=library))
    options = {"t": case.dt, "x_dot": case.F, "multioutput": "variance_weighted"}
    assert sindy.score(case.X, **options) == pytest.approx(1, abs=1e-9)


# -- settings ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("estimator", "message"),
    [
        (InterstoryPolynomialLibrary(chain=3), "chain=3 is not a Chain"),
        (ForceLawLibrary(), "The library has no laws"),
        (ForceLawLibrary({1: laws.Dahl(sigma=1.0)}, inputs="state"), "the path"),
        (ForceLawLibrary({1: laws.Inerter()}, inputs="state"), "of the acceleration"),
        (ForceLawLibrary(laws.Duffing(), inputs="both"), "inputs='both' is unknown"),
        (InterstoryPolynomialLibrary(orders=[3, 3]), "orders=.* is not a mapping"),
        (NRFRegressor(orders={"link 2-0": 2}), "'ground 2', which is not in"),
        (ChainOptimizer(chain=3), "chain=3 is not a Chain"),
        (ChainOptimizer(terms=9), "terms=9 does not fit"),
        (ChainOptimizer(terms=[2] * 3, known_masses=[1.0]), "is not a mapping"),
        (ChainOptimizer(terms=[2] * 3, excited="2"), "excited names DOF '2'"),
    ],
)
def test_wrong_settings_are_named(case, estimator, message):
    with pytest.raises(NRFError, match=message):
        estimator.fit(case.X, case.F)


def test_a_problem_needs_a_chain():
    with pytest.raises(ChainError, match="chain=3 is not a Chain"):
        Problem(3, {})


def test_weights_are_for_least_squares(case):
    with pytest.raises(NRFError, match="sample_weight"):
        NRFRegressor(estimation="iv", dt=1.0).fit(case.X, case.F, np.ones(2000))


def test_a_dof_is_a_whole_number_of_the_chain():
    with pytest.raises(ChainError, match="excited names DOF True"):
        Chain(3).identifiability(True)
    with pytest.raises(ChainError, match="excited names DOF 4"):
        excitation.band_limited_random(3, 1.0, 100.0, excited=4, rms=1.0, band=(1, 9))


def test_one_dof_is_a_number_or_a_list_of_one(case):
    optimizer = ChainOptimizer(excited=2, terms=[2] * 3).fit(case.X, case.F)
    other = ChainOptimizer(excited=[2], terms=[2] * 3).fit(case.X, case.F)
    assert np.array_equal(optimizer.masses_, other.masses_)
    assert Chain(3).identifiability(2) == Chain(3).identifiability([2])


def test_forces_that_a_table_does_not_have_are_zero(case):
    table = pd.DataFrame(case.F, columns=["F1", "F2", "F3"])
    turned = NRFRegressor().fit(case.X, table[["F3", "F2", "F1"]])
    alone = NRFRegressor().fit(case.X, table[["F2"]])
    assert np.array_equal(turned.masses_, alone.masses_)
