"""The seam to PySINDy: one layout for library and optimizer, honest optimizers,
settings and scores.
"""

import re
import warnings
from pathlib import Path

import chains
import numpy as np
import pandas as pd
import pysindy as ps
import pytest
from chains import worst
from sklearn import linear_model
from sklearn.exceptions import ConvergenceWarning
from sklearn.model_selection import GridSearchCV, KFold
from sklearn.pipeline import make_pipeline

from pysindy_nrf import (
    Chain,
    ChainOptimizer,
    NRFRegressor,
    Problem,
    StateSpaceChainOptimizer,
    excitation,
    laws,
)
from pysindy_nrf.exceptions import ChainError, ChannelError, NRFError
from pysindy_nrf.sindy.feature_library import (
    ForceLawLibrary,
    InterstoryPolynomialLibrary,
)

pytestmark = pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.BiasWarning")
DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture(scope="module")
def case():
    return chains.duffing(3, [2], seed=6, n_samples=2000)


def uneven():
    storey = [laws.LinearViscous(), laws.LinearElastic(), laws.CubicStiffness()]
    yield ForceLawLibrary(
        {
            1: storey,
            2: [*storey, laws.CoulombFriction()],
            3: [laws.LinearViscous(), laws.Duffing()],
        }
    )
    yield ForceLawLibrary({1: storey, 2: storey, 3: storey[:2]}) + ForceLawLibrary(
        {3: [laws.CubicStiffness()]}
    )
    yield InterstoryPolynomialLibrary((1, 3), orders={2: 3, 3: (2, 3)})


@pytest.mark.parametrize("library", [*uneven()], ids=["laws", "sum", "orders"])
def test_library_and_optimizer_share_one_layout(case, library):
    inside = ps.SINDy(
        feature_library=library, optimizer=ChainOptimizer(terms=library)
    ).fit(case.X, t=case.dt, x_dot=case.F)
    behind = make_pipeline(library, ChainOptimizer()).fit(case.X, case.F)[-1]
    v2 = dict(zip(inside.get_feature_names(), inside.coefficients()[1]))["v2"]
    assert worst(inside.optimizer.masses_, case.m) < 1e-8 and v2 == pytest.approx(
        case.c[1], rel=1e-6
    )
    assert np.array_equal(behind.coef_, inside.coefficients())
    with pytest.raises(ChannelError, match="not known which .* terms=library"):
        ps.SINDy(feature_library=library, optimizer=ChainOptimizer()).fit(
            case.X, t=case.dt, x_dot=case.F
        )


@pytest.mark.parametrize("given", ["the library", "a copy"])
def test_a_forgotten_excited_is_named(given):
    """Four DOFs with one column of u are nine columns, which three DOFs would have,
    too.
    """
    case = chains.duffing(4, [2], seed=6, n_samples=500)
    x, v = case.s.cumsum(axis=1), case.v.cumsum(axis=1)
    library = InterstoryPolynomialLibrary(1, inputs="state")
    terms = (
        library
        if given == "the library"
        else InterstoryPolynomialLibrary(1, inputs="state")
    )
    sindy = ps.SINDy(
        feature_library=library, optimizer=StateSpaceChainOptimizer(terms=terms)
    )
    with pytest.raises(ChannelError, match="excited=|library that made these"):
        sindy.fit(
            np.hstack([x, v]), t=case.dt, x_dot=np.hstack([v, case.a]), u=case.F[:, 1:2]
        )


TABLE = re.findall(
    r"^\| `(.*)` \| ((?:yes|no).*) \|$",
    (DOCS / "coming_from_pysindy.md").read_text("utf-8"),
    re.MULTILINE,
)


@pytest.mark.parametrize(("code", "verdict"), TABLE)
def test_optimizers_that_need_rows_are_refused_as_the_page_says(case, code, verdict):
    np.random.seed(0)  # EnsembleOptimizer draws from NumPy's global state
    names = {
        "ps": ps,
        **{name: getattr(linear_model, name) for name in linear_model.__all__},
    }
    try:
        with warnings.catch_warnings(action="ignore"):
            model = NRFRegressor(optimizer=eval(code, names)).fit(case.X, case.F)
    except NRFError as error:
        assert verdict == f"no. {error.cure}"
    else:
        assert verdict == "yes" and list(model.inner_) == [
            "balance of DOF 2",
            "balance of DOF 1",
        ]  # that of 3 has m3 alone


def test_an_optimizer_that_fails_is_named(case):
    class Trapping(linear_model.Ridge):
        def fit(self, X, y):
            raise IndexError("needs a quadratic library")

    with pytest.raises(
        NRFError,
        match=(
            r"Trapping cannot fit one balance of 18 terms \(needs a quadratic.*Use"
            r" STLSQ"
        ),
    ):
        NRFRegressor(optimizer=Trapping()).fit(case.X, case.F)


@pytest.mark.parametrize(
    ("inner", "message"),
    [
        (
            ChainOptimizer(known_masses={1: 5.0}, strategy="joint"),
            "known_masses={1: 5.0}, strategy='joint', which the estimator",
        ),
        (ChainOptimizer(chain=Chain(3)), "has chain=Chain"),
        (
            StateSpaceChainOptimizer(),
            "StateSpaceChainOptimizer solves for the rates of a state",
        ),
    ],
)
def test_settings_of_an_inner_chain_optimizer_are_not_dropped(case, inner, message):
    for outer in (
        NRFRegressor(optimizer=inner),
        make_pipeline(InterstoryPolynomialLibrary(), ChainOptimizer(inner)),
    ):
        with pytest.raises(ChainError, match=message):
            outer.fit(case.X, case.F)


def test_what_inner_optimizers_warn_of_is_said_once_with_the_storeys(case):
    inner = ps.SR3(1e-3, "l1", 1e-3, max_iter=10, tol=1e-15)
    for model in (
        NRFRegressor(optimizer=inner),
        make_pipeline(InterstoryPolynomialLibrary(3), ChainOptimizer(inner)),
    ):
        with pytest.warns(ConvergenceWarning) as said:
            model.fit(case.X, case.F)
        (text,) = (str(w.message) for w in said if w.category is ConvergenceWarning)
        assert "SR3 did not converge after 10" in text and all(
            f"storey {i}" in text for i in (1, 2, 3)
        )
        fitted = model.inner_ if isinstance(model, NRFRegressor) else model[-1].inner_
        assert [len(one.history_) for one in fitted.values()] == [
            11,
            11,
        ] and "balance of DOF 2" in fitted


def test_nan_rows_of_a_differentiation_are_left_out_in_every_trajectory(case):
    library = InterstoryPolynomialLibrary(3, inputs="state")
    derivative = ps.FiniteDifference(order=4, drop_endpoints=True)
    sindy = ps.SINDy(
        library and StateSpaceChainOptimizer(terms=library), library, derivative
    )
    state = np.hstack([case.s.cumsum(axis=1), case.v.cumsum(axis=1)])
    parts = [slice(100, 1000), slice(1000, 2000)]
    sindy.fit(
        [state[rows] for rows in parts], t=case.dt, u=[case.F[rows] for rows in parts]
    )
    assert worst(sindy.optimizer.masses_, case.m) < 0.01


def test_balances_without_a_force_do_not_lower_a_score(case):
    search = GridSearchCV(
        make_pipeline(InterstoryPolynomialLibrary(), ChainOptimizer()),
        {"interstorypolynomiallibrary__degree": [1, 2, 3]},
        cv=KFold(4),
    ).fit(case.noisy(0.005), case.F)
    assert (
        search.best_params_ == {"interstorypolynomiallibrary__degree": 3}
        and search.best_score_ > 0.9
    )
    library = InterstoryPolynomialLibrary(3)
    sindy = ps.SINDy(
        feature_library=library, optimizer=ChainOptimizer(terms=library)
    ).fit(case.X, t=case.dt, x_dot=case.F)
    features, force = library.transform(case.X), case.F.copy()
    assert sindy.score(
        case.X, t=case.dt, x_dot=case.F, multioutput="variance_weighted"
    ) == pytest.approx(1, abs=1e-9)
    force[:, 0] = np.nan
    assert sindy.optimizer.score(features, force) == pytest.approx(1, abs=1e-9)
    assert sindy.optimizer.score(features, case.F) == pytest.approx(
        NRFRegressor().fit(case.X, case.F).score(case.X, case.F), abs=1e-12
    )


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda X, F: InterstoryPolynomialLibrary(chain=3).fit(X),
            "chain=3 is not a Chain.*Chain\\(3",
        ),
        (lambda X, F: ChainOptimizer(chain=3).fit(X, F), "chain=3 is not a Chain"),
        (lambda X, F: Problem(3, {}), "chain=3 is not a Chain"),
        (lambda X, F: ForceLawLibrary().fit(X), "The library has no laws"),
        (
            lambda X, F: ForceLawLibrary({1: laws.Dahl(sigma=1.0)}, inputs="state").fit(
                X
            ),
            "law that remembers the path",
        ),
        (
            lambda X, F: ForceLawLibrary({1: laws.Inerter()}, inputs="state").fit(X),
            "law of the acceleration",
        ),
        (
            lambda X, F: ForceLawLibrary(laws.Duffing(), inputs="both").fit(X),
            "inputs='both' is unknown",
        ),
        (
            lambda X, F: NRFRegressor(orders={"link 2-0": 2}).fit(X, F),
            "'ground 2', which is not in the chain",
        ),
        (
            lambda X, F: InterstoryPolynomialLibrary(orders=[3, 3, 1]).fit(X),
            "orders=\\[3, 3, 1\\] is not a mapping.*orders={",
        ),
        (
            lambda X, F: ChainOptimizer(terms=9).fit(X, F),
            "terms=9 does not fit . columns at 3 sites.*terms=library",
        ),
        (
            lambda X, F: ChainOptimizer(terms=[2] * 3, known_masses=[1.0]).fit(X, F),
            "known_masses=\\[1.0\\] is not a mapping",
        ),
        (
            lambda X, F: ChainOptimizer(terms=[2] * 3, excited="2").fit(X, F),
            "excited names DOF '2'",
        ),
        (
            lambda X, F: NRFRegressor(estimation="iv", dt=1.0).fit(
                X, F, np.ones(len(X))
            ),
            "sample_weight is for least squares",
        ),
        (lambda X, F: Chain(3).identifiability(True), "excited names DOF True"),
        (
            lambda X, F: excitation.band_limited_random(
                3, 1.0, 100.0, excited=4, rms=1.0, band=(1, 9)
            ),
            "excited names DOF 4",
        ),
    ],
)
def test_wrong_settings_are_named_with_their_cure(case, call, message):
    with pytest.raises(NRFError, match=message):
        call(case.X, case.F)


def test_one_dof_is_a_number_and_absent_forces_are_zero(case):
    pair = [
        ChainOptimizer(excited=j, terms=[2] * 3).fit(case.X, case.F).masses_
        for j in (2, [2])
    ]
    assert np.array_equal(*pair) and Chain(3).identifiability(2) == Chain(
        3
    ).identifiability([2])
    table = pd.DataFrame(case.F, columns=["F1", "F2", "F3"])
    whole, alone = (
        NRFRegressor().fit(case.X, table[names]).masses_
        for names in (["F3", "F2", "F1"], ["F2"])
    )
    assert np.array_equal(whole, alone)
