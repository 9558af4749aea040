"""Any optimizer on the equations of a chain; the page's table is made here."""

import os
import re
from pathlib import Path

import chains
import numpy as np
import pysindy as ps
import pytest
from chains import worst
from sklearn import linear_model

from pysindy_nrf import NRFRegressor
from pysindy_nrf.equations import needs_samples
from pysindy_nrf.exceptions import NRFError

pytestmark = [
    pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.BiasWarning"),
    pytest.mark.filterwarnings("ignore::sklearn.exceptions.ConvergenceWarning"),
]
PAGE = Path(__file__).parents[2] / "docs" / "coming_from_pysindy.md"
BEGIN = "<!-- tests/sindy/test_inner_optimizers.py -->"
END = "<!-- end of optimizers -->"
CODES = [
    "ps.STLSQ(threshold=0.01)",
    "ps.SR3(reg_weight_lam=1e-4)",
    "ps.SSR()",
    "ps.FROLS()",
    "ps.EnsembleOptimizer(ps.STLSQ(), library_ensemble=True)",
    "ps.EnsembleOptimizer(ps.STLSQ(), bagging=True)",
    "ps.SR3(reg_weight_lam=1e-4, trimming_fraction=0.1)",
    "ps.WrappedOptimizer(ps.STLSQ(threshold=0.01))",
    "ps.WrappedOptimizer(Lasso(alpha=1e-3, fit_intercept=False))",
    "Ridge(fit_intercept=False)",
    "OrthogonalMatchingPursuit(n_nonzero_coefs=4, fit_intercept=False)",
    "Lasso(alpha=1e-3, fit_intercept=False)",
    "LassoCV(fit_intercept=False)",
    "BayesianRidge(fit_intercept=False)",
    "HuberRegressor(fit_intercept=False)",
    "LinearRegression()",
    "Lasso()",
    "ps.WrappedOptimizer(Lasso())",
    "RANSACRegressor(LinearRegression(fit_intercept=False))",
]


@pytest.fixture(scope="module")
def case():
    return chains.duffing(3, [2], seed=6, n_samples=2000)


def named_optimizer(code):
    """The optimizer that a line of the table makes."""
    names = {"ps": ps}
    for name in linear_model.__all__:
        names[name] = getattr(linear_model, name)
    return eval(code, names)


# -- the table -----------------------------------------------------------------


def line(case, code):
    """Whether an optimizer is taken, what it reads, or why it cannot work."""
    optimizer = named_optimizer(code)
    try:
        fitted = NRFRegressor(optimizer=optimizer).fit(case.X, case.F)
    except NRFError as error:
        return f"| `{code}` | no | {error.what}. {error.cure} |"
    # the equation of DOF 3 has m3 alone
    assert list(fitted.inner_) == ["balance of DOF 2", "balance of DOF 1"]
    reads = "samples" if needs_samples(optimizer) else "sums of products"
    return f"| `{code}` | yes | {reads} |"


@pytest.mark.filterwarnings("ignore")
def test_the_page_says_which_optimizers_work(case):
    """``PYSINDY_NRF_WRITE_TABLES=1`` writes the table into the page."""
    lines = ["| optimizer | accepted | reads |", "| --- | --- | --- |"]
    lines.extend(line(case, code) for code in CODES)
    table = "\n".join(lines)
    text = PAGE.read_text("utf-8")
    section = re.compile(f"{re.escape(BEGIN)}\n(.*?)\n{re.escape(END)}", re.DOTALL)
    if os.environ.get("PYSINDY_NRF_WRITE_TABLES"):
        new = f"{BEGIN}\n{table}\n{END}"
        PAGE.write_text(section.sub(lambda _: new, text), "utf-8")
    else:
        assert section.search(text).group(1) == table


# -- from the samples ----------------------------------------------------------


class LeastSquaresOfRows(linear_model.LinearRegression):
    """Least squares that refuses a triangular factor."""

    def __init__(self, fit_intercept=False):
        super().__init__(fit_intercept=fit_intercept)

    def fit(self, X, y):
        if len(X) < 100:
            raise ValueError("too few rows")
        return super().fit(X, y)


@pytest.mark.parametrize("forced", [[2], [1, 2, 3]])
@pytest.mark.parametrize("strategy", ["auto", "joint"])
def test_samples_and_their_factor_give_the_same_least_squares(forced, strategy):
    if strategy == "joint" and len(forced) == 1:
        pytest.skip("needs a force everywhere")
    case = chains.duffing(3, forced, seed=6, n_samples=2000)
    X = case.noisy(0.02)
    models = []
    for optimizer in (LeastSquaresOfRows(), ps.STLSQ(threshold=0.0, alpha=0.0)):
        model = NRFRegressor(strategy=strategy, optimizer=optimizer)
        models.append(model.fit(X, case.F).model_.coefficients)
    for site, coefficients in models[0].items():
        assert np.allclose(coefficients, models[1][site], rtol=1e-6)


def test_the_lasso_of_one_storey_is_that_of_all_samples():
    """Without the part of the inertia, and of rms one, as the page says."""
    case = chains.duffing(1, [1], seed=2, n_samples=3000)
    lasso = linear_model.Lasso(alpha=0.01, fit_intercept=False, tol=1e-12)
    model = NRFRegressor(degree=3, optimizer=lasso).fit(case.X, case.F)

    a, v, s = case.X.T
    names = model.restoring_forces_[1].coefficients.index
    terms = {"v": v, "s": s, "v^2": v**2, "v s": v * s, "s^2": s**2}
    terms |= {"v^3": v**3, "v^2 s": v**2 * s, "v s^2": v * s**2, "s^3": s**3}
    columns = np.column_stack([terms[name] for name in names])
    rms = np.sqrt(np.mean(columns**2, axis=0))
    force = case.F[:, 0] / np.sqrt(np.mean(case.F**2))
    rest = [y - a * (a @ y) / (a @ a) for y in (*(columns / rms).T, force)]
    lasso.fit(np.column_stack(rest[:-1]), rest[-1])
    expected = lasso.coef_ / rms * np.sqrt(np.mean(case.F**2))
    assert np.allclose(model.restoring_forces_[1].coefficients, expected, rtol=1e-6)


def test_weights_count_where_samples_are_read(case):
    lasso = linear_model.LassoCV(fit_intercept=False, cv=3)
    weights = np.ones(len(case.X))
    weights[1500:] = 0.0
    X = case.noisy(0.02)
    X[1500:] = 0.0
    weighted = NRFRegressor(optimizer=lasso).fit(X, case.F, sample_weight=weights)
    assert worst(weighted.masses_, case.m) < 0.2


def test_intervals_take_the_terms_that_were_kept_as_known(case):
    lasso = linear_model.Lasso(alpha=1e-3, fit_intercept=False)
    model = NRFRegressor(optimizer=lasso).fit(case.noisy(0.01), case.F)
    table = model.confidence_intervals().set_index("parameter")
    width = table["upper"] - table["lower"]
    dropped = table["estimate"] == 0
    assert dropped.any()
    assert (width[dropped] == 0).all()
    assert (width[["m1", "m2", "m3"]] > 0).all()


def test_files_in_chunks_have_no_samples_to_read_again(case, tmp_path):
    np.save(tmp_path / "X.npy", case.X)
    np.save(tmp_path / "F.npy", case.F)
    lasso = linear_model.Lasso(alpha=1e-3, fit_intercept=False)
    model = NRFRegressor(optimizer=lasso)
    with pytest.raises(NRFError, match="Lasso needs the samples"):
        model.fit(tmp_path / "X.npy", tmp_path / "F.npy")
