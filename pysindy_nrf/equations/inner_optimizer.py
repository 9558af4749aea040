"""PySINDy optimizers on the sub-problems of a chain.

Each sub-problem is given as the triangular factor of all its samples.
"""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, Protocol

import numpy as np
from sklearn.base import clone
from sklearn.utils import check_random_state

from ..exceptions import NRFError, NRFWarning

# Switches that make coefficients depend on more than sums of squares, their harmless
# value if any, and the cure.
_SWITCHES = (
    ("bagging", None, "Use library_ensemble=True, or bootstrap over records."),
    (
        "fit_intercept",
        False,
        "Set fit_intercept=False: a balance of forces has no intercept.",
    ),
    (
        "trimming_fraction",
        0.0,
        "Set trimming_fraction=0, and cut outliers out of the records.",
    ),
)
_USE_ANOTHER = (
    "Use STLSQ, SR3, SSR or FROLS of PySINDy, or scikit-learn's"
    " Ridge(fit_intercept=False)."
)
# Coefficients from 200 rows and from their factor agree to some 1e-12, or differ by
# more than 1e-3.
SAME_COEFFICIENTS = 1e-6
N_TEST_ROWS = 200
N_TEST_COLUMNS = 4

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
    """Coefficients of a sub-problem, the fitted clone, and what it warned of."""
    name = type(optimizer).__name__
    p = columns.shape[1]
    if not hasattr(optimizer, "fit") or isinstance(optimizer, type):
        what = f"optimizer={optimizer!r} is not an optimizer"
        raise NRFError(what, "Give an instance, e.g. pysindy.STLSQ(threshold=0.01).")

    try:
        require_quadratic(optimizer, p)
        with warnings.catch_warnings(record=True, action="always") as caught:
            fitted, coefficients = _fit(optimizer, columns, target)
    except NRFError:
        raise
    except Exception as error:
        cure = _USE_ANOTHER
        inside = getattr(getattr(optimizer, "optimizer", None), "estimator", None)
        if inside is not None:
            cure = f"Give what is inside it: optimizer={inside!r}."
        what = f"{name} cannot fit one balance of {p} terms ({error})"
        raise NRFError(what, cure) from error

    n_finite = int(np.isfinite(coefficients).sum())
    if coefficients.size != p or n_finite != p:
        what = (
            f"{name} returned {n_finite} finite coefficients of {coefficients.size} for"
            f" {p} terms"
        )
        raise NRFError(what, _USE_ANOTHER)
    return coefficients, fitted, tuple(_in_our_words(caught, name))


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
    """A fitted clone, and its coefficients."""
    fitted = clone(optimizer)
    fitted.fit(columns, target.reshape(-1, 1))
    return fitted, np.asarray(fitted.coef_, dtype=float).ravel()


def require_quadratic(optimizer: Optimizer, p: int) -> None:
    """Refuse an optimizer that reads more of its data than their products."""
    if _is_quadratic(optimizer, p):
        return

    cure = _USE_ANOTHER
    settings = optimizer.get_params(deep=False)
    for switch, harmless, own_cure in _SWITCHES:
        if not settings.get(switch):
            continue
        other = {**settings, switch: harmless}
        if harmless is None or _is_quadratic(type(optimizer)(**other), p):
            cure = own_cure
            break
    what = (
        f"{optimizer!r} finds other coefficients from the triangular factor of the"
        " samples, which a sub-problem is, than from the samples: it shifts, drops,"
        " draws or counts rows"
    )
    raise NRFError(what, cure)


def _is_quadratic(optimizer: Optimizer, p: int) -> bool:
    """Whether rows and their triangular factor give the same coefficients.

    True where the rows cannot be fitted. Settings may be for p columns.
    """
    verdict = _verdict(optimizer, N_TEST_COLUMNS)
    if verdict is None:
        verdict = _verdict(optimizer, p)
    return verdict is not False


def _verdict(optimizer: Optimizer, p: int) -> bool | None:
    """Whether random rows and their factor give the same; None if the rows fail."""
    key = type(optimizer), str(optimizer.get_params()), p
    if key not in _verdicts:
        _verdicts[key] = _compared(optimizer, p)
    return _verdicts[key]


def _compared(optimizer: Optimizer, p: int) -> bool | None:
    rng = np.random.default_rng(p)
    rows = rng.standard_normal((N_TEST_ROWS + p, p + 1))
    rows[:, p] += rows[:, :p] @ (
        np.geomspace(1e3, 1e-2, p) * rng.choice([-1.0, 1.0], p)
    )
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
