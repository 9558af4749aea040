"""Laws with their own strength in each direction."""

from collections.abc import Callable

import numpy as np

from ..exceptions import LawError
from .base import ForceLaw, Term, from_dict, registry

PREFIX = "asymmetric_"
# Suffixes of the symbols, and the functions that keep one sign of a term.
_DIRECTIONS = (("p", "max"), ("m", "min"))


def asymmetric(law: type[ForceLaw]) -> type[ForceLaw]:
    """The same law with its own coefficients in each direction.

    Each term becomes two: its positive part, whose coefficient has a ``p`` behind its
    symbol, and its negative part, with an ``m``. Add the result to the catalogue of a
    search, or declare it.

    Parameters
    ----------
    law : type of ForceLaw
        A class whose terms change their sign with the motion.

    Returns
    -------
    type of ForceLaw
        Named ``asymmetric_`` and the name of the law.

    Raises
    ------
    LawError
        If the law has options, or is not odd.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> friction = laws.asymmetric(laws.CoulombFriction)
    >>> print(friction(Fcp=20.0, Fcm=14.0).equation(1))
    20 max(sgn(v1), 0) + 14 min(sgn(v1), 0)
    """
    name = f"{PREFIX}{law.name}"
    if name in registry():
        return registry()[name]
    _require_odd_without_options(law)

    terms = []
    for term in law.columns:
        for suffix, function in _DIRECTIONS:
            label = f"{function}({term.label}, 0)"
            terms.append(Term(term.symbol + suffix, label, term.unit))
    symbols = [
        symbol + suffix for symbol in law.nonnegative for suffix, _ in _DIRECTIONS
    ]

    def of_symmetric(special: ForceLaw) -> ForceLaw:
        return new(**special.shape).with_values(np.repeat(special.values, 2))

    def __reduce__(self: ForceLaw) -> tuple[object, ...]:
        """The class has no name in a module by which pickle could find it."""
        return from_dict, (self.to_dict(),)

    inherited = {k: x for k, x in vars(law).items() if not k.startswith("__")}
    changed = {
        "__doc__": f"{law.__name__} with coefficients of its own in each direction.",
        "__reduce__": __reduce__,
        "name": name,
        "columns": tuple(terms),
        "nonnegative": tuple(symbols),
        "symmetry": "none",
        "special_cases": {law: of_symmetric},
        "kernel": staticmethod(_signed_parts(law.kernel, len(law.columns))),
    }
    new: type[ForceLaw] = type(
        f"Asymmetric{law.__name__}", law.__bases__, inherited | changed
    )
    return new


def _require_odd_without_options(law: type[ForceLaw]) -> None:
    if not law.columns or law.options is not ForceLaw.options:
        raise LawError(
            f"{law.__name__} has options", "Write both directions as a law of your own."
        )
    if law.symmetry != "odd":
        raise LawError(
            f"{law.__name__} is not odd: its directions differ already",
            "Use it as it is.",
        )


def _signed_parts(kernel: Callable[..., None], n_terms: int) -> Callable[..., None]:
    """Kernel of the positive and the negative part of every term of a kernel."""

    def signed_parts(s, v, a, t, u, z, theta, out):
        kernel(s, v, a, t, u, z, theta, out)
        # from the last term on, so that none is overwritten before it is read
        for k in range(n_terms - 1, -1, -1):
            out[2 * k + 1] = np.minimum(out[k], 0.0)
            out[2 * k] = np.maximum(out[k], 0.0)

    return signed_parts
