"""Sites of force laws, written in one grammar.

``"storey 2"``, ``"link 4-2"``, ``"ground 3"``, ``"dof 2"``, ``"sensor a2"``, ``"sensors
2"`` (all of DOF 2). Equivalent spellings are one site: storey 1 = ground 1 = link 1-0.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import TypeVar

from ..common import is_whole
from ..exceptions import ChainError

_GRAMMAR = (
    "'storey 2', 'link 4-2', 'ground 3', 'dof 2', 'sensor a2' or 'sensors 2' (all of"
    " DOF 2)"
)
_PATTERN = re.compile(
    r"\s*(?:(?P<word>storey|story|ground|dof|sensors)\s+(?P<number>\d+)"
    r"|link\s+(?P<p>\d+)\s*-\s*(?P<q>\d+)"
    r"|sensor\s+(?P<channel>\S+))\s*\Z"
)


Key = TypeVar("Key")
Value = TypeVar("Value")
# A site as users write it: its text, or the number of a storey.
SiteName = str | int
# The keys of a mapping by site.
Named = TypeVar("Named", bound=SiteName)


class Site(str):
    """A place where a force law acts; a string in canonical spelling.

    A law on a link (p, q), p > q, depends on the drift ``s = x_p - x_q`` and its rate.
    It enters the equation of motion of DOF p with + and that of DOF q with - (Newton's
    third law, paper eq. 4). A law on ``"dof j"`` enters the equation of DOF j alone,
    with +, and depends on the motion of DOF j relative to the base.

    Parameters
    ----------
    text : str, int or Site
        A site in the grammar ``"storey 2"``, ``"link 4-2"``, ``"ground 3"``, ``"dof
        2"``, ``"sensor a2"``, ``"sensors 2"``; an integer i means storey i.

    Attributes
    ----------
    kind : {"link", "dof", "sensor"}
    p, q : int
        The two degrees of freedom of a link, p > q >= 0 (0 is the base); for a DOF and
        its sensors, p is the DOF.
    channel : str
        The channel of a single sensor.

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

    def __new__(cls, text: SiteName) -> Site:
        if isinstance(text, Site):
            return text

        kind, p, q, channel = _parse(text)
        site = super().__new__(cls, _spelling(kind, p, q, channel))
        site.kind = kind
        site.p = p
        site.q = q
        site.channel = channel
        return site

    @property
    def is_storey(self) -> bool:
        """True if the site joins two neighbouring DOFs (or DOF 1 and the base)."""
        return self.kind == "link" and self.p == self.q + 1

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels of a sensor, or of the motion that all sensors of a DOF read.

        Examples
        --------
        >>> from pysindy_nrf import Site
        >>> Site("sensor F3").channels, Site("sensors 2").channels
        (('F3',), ('a2', 'v2', 'x2'))
        """
        if self.kind != "sensor":
            return ()
        if self.channel:
            return (self.channel,)
        return tuple(f"{kind}{self.p}" for kind in "avx")

    def incidence(self, dof: int) -> int:
        """Sign of the site's force in the equation of motion of a DOF.

        Parameters
        ----------
        dof : int
            Degree of freedom, counted from 1.

        Returns
        -------
        int
            +1, -1 or 0.
        """
        if self.kind == "sensor" or dof == 0:
            return 0
        if dof == self.p:
            return 1
        if self.kind == "link" and dof == self.q:
            return -1
        return 0

    def __repr__(self) -> str:
        return str.__repr__(self)

    def __getnewargs__(self) -> tuple[str]:
        return (str(self),)


def _spelling(kind: str, p: int, q: int, channel: str) -> str:
    """The one text by which a site is known."""
    if kind == "sensor":
        return f"sensor {channel}" if channel else f"sensors {p}"
    if kind == "dof":
        return f"dof {p}"
    if p == q + 1:
        return f"storey {p}"
    if q == 0:
        return f"ground {p}"
    return f"link {p}-{q}"


def _parse(text: object) -> tuple[str, int, int, str]:
    """Kind, the two DOFs and the channel that a text or a storey number names."""
    if isinstance(text, str):
        match = _PATTERN.match(text)
    elif is_whole(text):
        match = _PATTERN.match(f"storey {text.__index__()}")
    else:
        match = None

    if match is None:
        raise ChainError(f"{text!r} is not a site", f"Write it as {_GRAMMAR}.")
    if match["channel"]:
        number = match["channel"][1:]
        return "sensor", int(number) if number.isdecimal() else 0, 0, match["channel"]
    if match["p"]:
        return _parse_link(text, int(match["p"]), int(match["q"]))

    number = int(match["number"])
    if number < 1:
        what = f"{text!r} does not exist"
        raise ChainError(what, "Storeys and DOFs count from 1; DOF 0 is the base.")
    if match["word"] == "dof":
        return "dof", number, 0, ""
    if match["word"] == "sensors":
        return "sensor", number, 0, ""
    if match["word"] == "ground":
        return "link", number, 0, ""
    return "link", number, number - 1, ""


def _parse_link(text: object, dof: int, other: int) -> tuple[str, int, int, str]:
    """A link from its upper to its lower DOF."""
    if dof == other:
        what = f"{text!r} joins DOF {dof} to itself"
        raise ChainError(what, "A link joins two different DOFs.")
    return "link", max(dof, other), min(dof, other), ""


def dofs_of(name: str, values: object, n_dof: int) -> tuple[int, ...]:
    """DOFs that a parameter names, which is one whole number or several."""
    # a NumPy number is iterable by name only: it has no dimension
    named: tuple[object, ...] = (values,)
    if isinstance(values, Iterable) and getattr(values, "ndim", 1) > 0:
        named = tuple(values)

    dofs = []
    for value in named:
        if not is_whole(value) or not 1 <= int(value) <= n_dof:
            cure = f"The chain has DOFs 1 to {n_dof}."
            raise ChainError(f"{name} names DOF {value!r}", cure)
        dofs.append(int(value))
    return tuple(dofs)


def as_mapping(
    name: str, value: Mapping[Key, Value] | None, example: str
) -> Mapping[Key, Value]:
    """A parameter that must be a mapping; an empty one for None."""
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        cure = f"Give e.g. {name}={example}."
        raise ChainError(f"{name}={value!r} is not a mapping", cure)
    return value


def index_of(site: Site | str) -> str:
    """Index of s, v and R at a site: ``2`` at storey 2, ``4,2`` at link 4-2."""
    place = Site(site) if isinstance(site, str) else site
    if place.is_storey:
        return str(place.p)
    if place.kind == "link":
        return f"{place.p},{place.q}"
    if place.kind == "sensor":
        return place.channel or f"sensors {place.p}"
    return f"dof {place.p}"
