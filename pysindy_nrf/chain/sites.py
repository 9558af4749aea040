"""Sites of force laws, written in one grammar.

``"storey 2"``, ``"link 4-2"``, ``"ground 3"``, ``"dof 2"``, ``"sensor a2"``. Equivalent
spellings are one site: storey 1 = ground 1 = link 1-0.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any

from ..exceptions import ChainError

_GRAMMAR = "'storey 2', 'link 4-2', 'ground 3', 'dof 2' or 'sensor a2'"
_PATTERN = re.compile(
    r"\s*(?:(?P<word>storey|story|ground|dof)\s+(?P<number>\d+)"
    r"|link\s+(?P<p>\d+)\s*-\s*(?P<q>\d+)"
    r"|sensor\s+(?P<channel>\S+))\s*\Z"
)


class Site(str):
    """A place where a force law acts; a string in canonical spelling.

    A law on a link (p, q), p > q, depends on the drift ``s = x_p - x_q`` and its rate.
    It enters the balance of DOF p with + and that of DOF q with - (Newton's third law,
    paper eq. 4). A law on ``"dof j"`` enters balance j alone, with +, and depends on
    the motion of DOF j relative to the base.

    Parameters
    ----------
    text : str, int or Site
        A site in the grammar ``"storey 2"``, ``"link 4-2"``, ``"ground 3"``, ``"dof
        2"``, ``"sensor a2"``; an integer i means storey i.

    Attributes
    ----------
    kind : {"link", "dof", "sensor"}
    p, q : int
        The two degrees of freedom of a link, p > q >= 0 (0 is the base); for a DOF, p
        is the DOF.
    channel : str
        The channel of a sensor site.

    Raises
    ------
    ChainError
        If the text is not a site.

    Examples
    --------
    >>> from pysindy_nrf import Site
    >>> Site("link 2-4"), Site("ground 1"), Site(3)
    ('link 4-2', 'storey 1', 'storey 3')
    >>> Site("link 4-3") == "storey 4"
    True
    """

    __slots__ = ("kind", "p", "q", "channel")
    kind: str
    p: int
    q: int
    channel: str

    def __new__(cls, text: Any) -> Site:
        if isinstance(text, Site):
            return text
        kind, p, q, channel = _parse(text)
        link = (
            f"storey {p}"
            if p == q + 1
            else f"ground {p}"
            if q == 0
            else f"link {p}-{q}"
        )
        canonical = {"sensor": f"sensor {channel}", "dof": f"dof {p}", "link": link}
        self = super().__new__(cls, canonical[kind])
        self.kind, self.p, self.q, self.channel = kind, p, q, channel
        return self

    @property
    def is_storey(self) -> bool:
        """True if the site joins two neighbouring DOFs (or DOF 1 and the base)."""
        return self.kind == "link" and self.p == self.q + 1

    def incidence(self, dof: int) -> int:
        """Sign with which the force of a law at this site enters the balance of a DOF.

        Parameters
        ----------
        dof : int
            Degree of freedom, counted from 1.
        """
        if self.kind == "sensor" or dof == 0:
            return 0
        return int(dof == self.p) - int(self.kind == "link" and dof == self.q)

    def __repr__(self) -> str:
        return str.__repr__(self)

    def __getnewargs__(self) -> tuple[str]:
        return (str(self),)


def _parse(text: Any) -> tuple[str, int, int, str]:
    if isinstance(text, bool) or not (
        isinstance(text, str) or hasattr(text, "__index__")
    ):
        raise ChainError(f"{text!r} is not a site", f"Write it as {_GRAMMAR}.")
    if not isinstance(text, str):
        text = f"storey {int(text)}"
    match = _PATTERN.match(text)
    if match is None:
        raise ChainError(f"{text!r} is not a site", f"Write it as {_GRAMMAR}.")
    if match["channel"]:
        return "sensor", 0, 0, match["channel"]
    if match["p"]:
        p, q = sorted((int(match["p"]), int(match["q"])), reverse=True)
        if p == q:
            raise ChainError(
                f"{text!r} joins DOF {p} to itself", "A link joins two different DOFs."
            )
        return "link", p, q, ""
    number = int(match["number"])
    if number < 1:
        raise ChainError(
            f"{text!r} does not exist",
            "Storeys and DOFs count from 1; DOF 0 is the base.",
        )
    if match["word"] == "dof":
        return "dof", number, 0, ""
    return "link", number, (0 if match["word"] == "ground" else number - 1), ""


def dofs_of(name: str, values: Any, n_dof: int) -> tuple[int, ...]:
    """DOFs that a parameter names: one whole number or several."""
    several = isinstance(values, Iterable) and getattr(
        values, "ndim", True
    )  # 0 of NumPy's single numbers
    chosen = tuple(values) if several else (values,)
    for j in chosen:
        if (
            isinstance(j, bool)
            or not hasattr(j, "__index__")
            or not 1 <= int(j) <= n_dof
        ):
            raise ChainError(
                f"{name} names DOF {j!r}", f"The chain has DOFs 1 to {n_dof}."
            )
    return tuple(int(j) for j in chosen)


def as_mapping(name: str, value: Any, example: str) -> Mapping[Any, Any]:
    """A parameter that must be a mapping; empty for None."""
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        raise ChainError(
            f"{name}={value!r} is not a mapping", f"Give e.g. {name}={example}."
        )
    return value


def index_of(site: Any) -> str:
    """Index of s, v and R at a site: ``2`` at storey 2, ``4,2`` at link 4-2."""
    site = Site(site) if isinstance(site, str) else site
    return (
        str(site.p)
        if site.is_storey
        else f"{site.p},{site.q}"
        if site.kind == "link"
        else f"dof {site.p}"
    )
