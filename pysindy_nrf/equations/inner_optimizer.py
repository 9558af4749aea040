"""PySINDy optimizers on the sub-problems of a chain, each given as the triangular
factor of all its samples.
"""

import warnings
from contextlib import suppress
from typing import Any

import numpy as np
from sklearn.base import clone

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
_USE = (
    "Use STLSQ, SR3, SSR or FROLS of PySINDy, or scikit-learn's"
    " Ridge(fit_intercept=False)."
)
# coefficients from 200 rows and from their factor agree to some 1e-12, or differ by
# more than 1e-3
_SAME = 1e-6
_verdicts: dict[tuple[type, str, int], bool | None] = {}


def balance_optimizer(optimizer: Any) -> Any:
    """The PySINDy optimizer that runs on every balance: that inside a chain optimizer,
    or the given one itself.
    """
    inside = getattr(optimizer, "balance_optimizer", None)
    return optimizer if inside is None else inside()


def fit_inner(
    optimizer: Any, columns: np.ndarray, target: np.ndarray
) -> tuple[np.ndarray, Any, tuple]:
    """Coefficients of a sub-problem, the clone of the optimizer that found them, and
    what it warned of.
    """
    name, p = type(optimizer).__name__, columns.shape[1]
    if not hasattr(optimizer, "fit") or isinstance(optimizer, type):
        cure = "Give an instance, e.g. pysindy.STLSQ(threshold=0.01)."
        raise NRFError(f"optimizer={optimizer!r} is not an optimizer", cure)
    try:
        require_quadratic(optimizer, p)
        with warnings.catch_warnings(record=True, action="always") as caught:
            fitted, coefficients = _fit(optimizer, columns, target)
    except NRFError:
        raise
    except Exception as error:
        inside = getattr(getattr(optimizer, "optimizer", None), "estimator", None)
        cure = (
            _USE if inside is None else f"Give what is inside it: optimizer={inside!r}."
        )
        raise NRFError(
            f"{name} cannot fit one balance of {p} terms ({error})", cure
        ) from error
    if coefficients.size != p or not np.isfinite(coefficients).all():
        good = np.isfinite(coefficients).sum()
        raise NRFError(
            f"{name} returned {good} finite coefficients of {coefficients.size} for {p}"
            " terms",
            _USE,
        )
    said = ((w.category, f"{name}: {w.message}") for w in caught)
    none = NRFWarning, f"{name}: no term reached the threshold; the law is zero"
    return (
        coefficients,
        fitted,
        tuple(
            none if "eliminated all" in text else (kind, text) for kind, text in said
        ),
    )


def _fit(
    optimizer: Any, columns: np.ndarray, target: np.ndarray
) -> tuple[Any, np.ndarray]:
    fitted = clone(optimizer)
    fitted.fit(columns, target.reshape(-1, 1))
    return fitted, np.asarray(fitted.coef_, dtype=float).ravel()


def require_quadratic(optimizer: Any, p: int) -> None:
    """Refuse an optimizer that answers otherwise on the triangular factor of its data
    than on the data.
    """
    if _is_quadratic(optimizer, p):
        return
    given = optimizer.get_params(deep=False)
    cures = (
        cure
        for switch, off, cure in _SWITCHES
        if given.get(switch)
        and (off is None or _is_quadratic(type(optimizer)(**{**given, switch: off}), p))
    )
    raise NRFError(
        f"{optimizer!r} finds other coefficients from the triangular factor of the"
        " samples, which a sub-problem is, than from the samples: it shifts, drops,"
        " draws or counts rows",
        next(cures, _USE),
    )


def _is_quadratic(optimizer: Any, p: int) -> bool:
    """Whether random rows and their triangular factor give the same coefficients; True
    where the rows fail.
    """
    verdict = _verdict(optimizer, 4)
    return (
        _verdict(optimizer, p) if verdict is None else verdict
    ) is not False  # None: settings for p columns


def _verdict(optimizer: Any, p: int) -> bool | None:
    key = type(optimizer), str(optimizer.get_params()), p
    if key not in _verdicts:
        rng = np.random.default_rng(p)
        found: list[np.ndarray] = []
        rows = rng.standard_normal((200 + p, p + 1))
        rows[:, p] += rows[:, :p] @ (
            np.geomspace(1e3, 1e-2, p) * rng.choice([-1.0, 1.0], p)
        )
        # noqa: NPY002 - of the generator from which PySINDy draws; left as it was
        state = np.random.get_state()
        with warnings.catch_warnings(action="ignore"):
            for data in (rows, np.asarray(np.linalg.qr(rows, mode="r"))):
                with suppress(Exception):
                    found.append(_fit(optimizer, data[:, :p], data[:, p])[1])
                np.random.set_state(state)  # noqa: NPY002
                if not found:
                    break
        _verdicts[key] = False if found else None
        if len(found) == 2 and found[0].shape == found[1].shape:
            size = np.abs(found[0]).max(initial=0.0)
            _verdicts[key] = bool(
                np.allclose(found[0], found[1], rtol=_SAME, atol=1e-9 * size)
            )
    return _verdicts[key]
