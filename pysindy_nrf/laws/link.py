"""A link that the model lacks."""

from __future__ import annotations

from .base import ForceLaw, Term


class LinkSpringDashpot(ForceLaw):
    """Linear spring and dashpot side by side, ``R = k s + c v``.

    For links that a chain does not have: a brace that skips a floor (``"link 4-2"``), a tie to the
    ground (``"ground 3"``).

    Parameters
    ----------
    k : float, optional
        Stiffness, N/m.
    c : float, optional
        Damping, N s/m.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> print(laws.LinkSpringDashpot(k=1e5, c=100.0).equation())
    1e+05 s + 100 v
    """

    name = "link_spring_dashpot"
    family = "link"
    passive = True
    acts_at = ("new link",)
    nonnegative = ("k", "c")

    def __init__(self, k: float | None = None, c: float | None = None) -> None:
        super().__init__(coefficients={"k": k, "c": c})

    def terms(self) -> tuple[Term, ...]:
        """Two terms, s and v."""
        return (Term("k", "s", "N/m"), Term("c", "v", "N s/m"))

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = s
        out[1] = v
