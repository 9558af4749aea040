"""PySINDy optimizers on the sub-problems of a chain.

An optimizer gets the triangular factor of all samples of a sub-problem where it finds
the same coefficients from it, and the samples otherwise.
"""

from __future__ import annotations

import copy
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any, Protocol, Self

import numpy as np
from sklearn.base import BaseEstimator, clone
from sklearn.exceptions import DataConversionWarning
from sklearn.utils import check_random_state

from ..exceptions import NRFError, NRFWarning

_USE_ANOTHER = (
    "Use STLSQ, SR3, SSR or FROLS of PySINDy, or scikit-learn's"
    " Ridge(fit_intercept=False)."
)
INTERCEPT_CURE = (
    "Set fit_intercept=False; add laws.ConstantForce where a constant force acts."
)
# Coefficients from 200 rows and from their factor agree to some 1e-12, or differ by
# more than 1e-3.
SAME_COEFFICIENTS = 1e-6
N_TEST_ROWS = 200
N_TEST_COLUMNS = 8
# Smallest part of the target that a column of the test makes, and its noise: a
# threshold or penalty of ordinary size drops some of the columns.
LEAST_PART = 1e-4
# Rows of the test from one outlier to the next.
ROWS_PER_OUTLIER = 20

# By class, settings and number of columns; a shape search solves thousands of
# sub-problems with one optimizer, and a verdict takes two fits.
_verdicts: dict[tuple[type, str, int], bool | None] = {}


class Optimizer(Protocol):
    """A sparse regression of PySINDy or a linear model of scikit-learn."""

    coef_: np.ndarray

    def fit(self, columns: np.ndarray, target: np.ndarray, /) -> object:
        """Fit the target (n_samples, 1) by the columns (n_samples, p)."""

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Its settings by name."""


def balance_optimizer(optimizer: Optimizer | None) -> Optimizer | None:
    """The PySINDy optimizer that runs on every equation.

    It is that inside a chain optimizer, or the given one itself.
    """
    inside = getattr(optimizer, "balance_optimizer", None)
    return optimizer if inside is None else inside()


def fit_inner(
    optimizer: Optimizer, columns: np.ndarray, target: np.ndarray
) -> tuple[np.ndarray, Optimizer, tuple[tuple[type[Warning], str], ...]]:
    """Coefficients of a sub-problem, the fitted copy, and what it warned of."""
    name = type(optimizer).__name__
    p = columns.shape[1]

    try:
        with warnings.catch_warnings(record=True, action="always") as caught:
            fitted, coefficients = _fit(optimizer, columns, target)
    except Exception as error:
        what = f"{name} cannot fit one balance of {p} terms ({error})"
        raise NRFError(what, _USE_ANOTHER) from error

    n_finite = int(np.isfinite(coefficients).sum())
    if coefficients.size != p or n_finite != p:
        what = (
            f"{name} returned {n_finite} finite coefficients of {coefficients.size} for"
            f" {p} terms"
        )
        raise NRFError(what, _USE_ANOTHER)
    return coefficients, fitted, tuple(_in_our_words(caught, name))


def require_optimizer(optimizer: Optimizer) -> None:
    """Refuse what is no optimizer, and optimizers that fit an intercept."""
    if not hasattr(optimizer, "fit") or isinstance(optimizer, type):
        what = f"optimizer={optimizer!r} is not an optimizer"
        raise NRFError(what, "Give an instance, e.g. pysindy.STLSQ(threshold=0.01).")

    for name, value in _settings(optimizer).items():
        if name.split("__")[-1] == "fit_intercept" and value:
            what = (
                f"{type(optimizer).__name__} fits an intercept, which no force law has"
            )
            raise NRFError(what, INTERCEPT_CURE)


def _settings(optimizer: Optimizer) -> dict[str, Any]:
    """Settings by name, also of estimators inside.

    PySINDy's WrappedOptimizer cannot name its own: they are its attributes.
    """
    try:
        return optimizer.get_params()
    except RuntimeError:
        settings = dict(vars(optimizer))

    for name, value in vars(optimizer).items():
        if hasattr(value, "get_params"):
            inside = value.get_params()
            settings |= {f"{name}__{key}": setting for key, setting in inside.items()}
    return settings


class KeptTerms:
    """Least squares on the terms that an optimizer kept in each equation.

    It takes the place of an optimizer that needs the samples, where an estimate is
    solved again from sums of products: the choice of terms is taken as known.

    Parameters
    ----------
    chosen : mapping of str to ndarray of bool
        By the name of the equation.
    """

    coef_: np.ndarray

    def __init__(self, chosen: Mapping[str, np.ndarray]) -> None:
        self.chosen = dict(chosen)

    @classmethod
    def of(cls, fitted: Mapping[str, Optimizer]) -> KeptTerms:
        """The terms that fitted optimizers kept, by equation."""
        chosen = {}
        for name, optimizer in fitted.items():
            chosen[name] = np.ravel(optimizer.coef_) != 0
        return cls(chosen)

    def of_step(self, name: str) -> Optimizer:
        """The least squares of one equation."""
        if name not in self.chosen:
            what = f"Terms of the {name} were not chosen"
            raise NRFError(what, "Fit the model with strategy='complete'.")
        return LeastSquaresOfKept(self.chosen[name])

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Its settings by name."""
        return {"chosen": self.chosen}

    def fit(self, columns: np.ndarray, target: np.ndarray, /) -> object:
        """Refused: the terms are those of an equation, see :meth:`of_step`."""
        raise NRFError("The terms are kept by equation", "Ask for one equation.")


class LeastSquaresOfKept(BaseEstimator):
    """Least squares on some of the columns; the others have no coefficient.

    Parameters
    ----------
    chosen : ndarray of bool, shape (n_columns,)
    """

    def __init__(self, chosen: np.ndarray) -> None:
        self.chosen = chosen

    def fit(self, columns: np.ndarray, target: np.ndarray, /) -> Self:
        """Fit the target (n_samples, 1) by the kept columns."""
        solution = np.linalg.lstsq(columns[:, self.chosen], target.ravel())[0]
        self.coef_ = np.zeros(columns.shape[1])
        self.coef_[self.chosen] = solution
        return self


def _in_our_words(
    caught: list[warnings.WarningMessage], name: str
) -> Iterator[tuple[type[Warning], str]]:
    """Kinds and texts of warnings, with the name of the optimizer."""
    for warning in caught:
        text = f"{name}: {warning.message}"
        if "eliminated all" in text:
            yield NRFWarning, f"{name}: no term reached the threshold; the law is zero"
        else:
            yield warning.category, text


def _fit(
    optimizer: Optimizer, columns: np.ndarray, target: np.ndarray
) -> tuple[Optimizer, np.ndarray]:
    """A fitted copy, and its coefficients."""
    fitted = _unfitted(optimizer)
    # scikit-learn takes a column for a mistake; PySINDy's optimizers ask for one
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataConversionWarning)
        fitted.fit(columns, target.reshape(-1, 1))
    return fitted, np.asarray(fitted.coef_, dtype=float).ravel()


def _unfitted(optimizer: Optimizer) -> Optimizer:
    """A copy with the same settings.

    ``clone`` refuses PySINDy's WrappedOptimizer, which cannot name its settings.
    """
    try:
        return clone(optimizer)
    except RuntimeError:
        return copy.deepcopy(optimizer)


def survives_compression(optimizer: Optimizer, p: int) -> bool:
    """Whether p columns and their triangular factor give the same coefficients.

    An optimizer that draws, drops or counts rows does not. True where random rows
    cannot be fitted; the settings may be for p columns.
    """
    verdict = _verdict(optimizer, N_TEST_COLUMNS)
    if verdict is None:
        verdict = _verdict(optimizer, p)
    return verdict is not False


def needs_samples(optimizer: Optimizer | None) -> bool:
    """Whether an optimizer cannot be served by sums of products."""
    if optimizer is None or isinstance(optimizer, KeptTerms):
        return False
    require_optimizer(optimizer)
    return not survives_compression(optimizer, N_TEST_COLUMNS)


def _verdict(optimizer: Optimizer, p: int) -> bool | None:
    """Whether random rows and their factor give the same; None if the rows fail."""
    key = type(optimizer), str(_settings(optimizer)), p
    if key not in _verdicts:
        # trimming shows beside outliers, a penalty on small parts without them
        verdict = _compared(optimizer, p, outlier=0.0)
        if verdict:
            verdict = _compared(optimizer, p, outlier=1.0)
        _verdicts[key] = verdict
    return _verdicts[key]


def _compared(optimizer: Optimizer, p: int, outlier: float) -> bool | None:
    """The same, where some rows of the target are off by an outlier."""
    rng = np.random.default_rng(p)
    rows = rng.standard_normal((N_TEST_ROWS + p, p + 1))
    rows[:, p] *= LEAST_PART
    parts = np.geomspace(1.0, LEAST_PART, p) * rng.choice([-1.0, 1.0], p)
    rows[:, p] += rows[:, :p] @ parts
    rows[::ROWS_PER_OUTLIER, p] += outlier
    rows /= np.sqrt(np.mean(rows**2, axis=0))
    factor = np.asarray(np.linalg.qr(rows, mode="r"))

    of_rows = _coefficients(optimizer, rows)
    if of_rows is None:
        return None
    of_factor = _coefficients(optimizer, factor)
    if of_factor is None or of_factor.shape != of_rows.shape:
        return False
    size = np.abs(of_rows).max(initial=0.0)
    return bool(
        np.allclose(of_rows, of_factor, rtol=SAME_COEFFICIENTS, atol=1e-9 * size)
    )


def _coefficients(optimizer: Optimizer, rows: np.ndarray) -> np.ndarray | None:
    """Coefficients of the last column on the others; None if the fit fails."""
    with (
        same_draws(),
        warnings.catch_warnings(action="ignore"),
        suppress(Exception),
    ):
        return _fit(optimizer, rows[:, :-1], rows[:, -1])[1]
    return None


@contextmanager
def same_draws() -> Iterator[None]:
    """Leave NumPy's global generator as it was, whatever is drawn from it.

    PySINDy draws from it. So two fits draw the same, and the user's own draws do not
    depend on our tests.
    """
    generator = check_random_state(None)  # the global one
    state = generator.get_state()
    try:
        yield
    finally:
        generator.set_state(state)
