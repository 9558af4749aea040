"""The chain: masses, the links that join them, and which equations a link enters."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, NotRequired, TypedDict, Unpack

import numpy as np

from ..common import MAX_DOFS, is_whole, number_of
from ..common.unit_system import UnitSystem, unit_system
from ..exceptions import ChainError
from .identifiability import Dofs, SolveOrder, plan_solve_order
from .planning import Plan, PlanOptions, plan
from .sensing import Sensing, plan_sensing
from .sites import Site, SiteName, as_mapping, dofs_of

if TYPE_CHECKING:
    from .model import ChainModel


class ChainData(TypedDict):
    """A chain as plain data."""

    n_dof: int
    links: NotRequired[list[str]]
    ground: NotRequired[str]
    rotates: NotRequired[bool]


_GROUNDS = ("base", "both", "free")


class Chain:
    r"""A chain of masses joined by force laws.

    DOFs are j = 1..n, DOF 0 is the base (ground). Storey i joins DOF i and DOF i-1. The
    equation of motion of DOF j is (paper eq. 3)

    .. math:: m_j a_j + R_j(v_j, s_j) - R_{j+1}(v_{j+1}, s_{j+1}) = F_j .

    Parameters
    ----------
    n_dof : int
        Number of masses, at least 1.
    links : iterable of str
        Links in addition to the storeys: ``"link 4-2"`` (a brace that skips a floor),
        ``"ground 3"``.
    ground : {"base", "both", "free"}
        ``"base"``: storey 1 stands on the ground. ``"both"``: DOF n is tied to the
        ground too, by storey n+1 (= ``"ground n"``). ``"free"``: no storey 1; the chain
        floats.
    rotates : bool
        Whether its DOFs turn: forces are then torques (N m), displacements angles
        (rad), masses inertias (kg m^2). A fit takes it from records of rotations.

    Raises
    ------
    ChainError
        If a link does not fit the chain or coincides with a storey.

    Examples
    --------
    >>> from pysindy_nrf import Chain
    >>> chain = Chain(3, links=["link 3-1"])
    >>> chain.sites
    ('storey 1', 'storey 2', 'storey 3', 'link 3-1')
    >>> chain.incidence().astype(int)
    array([[ 1, -1,  0, -1],
           [ 0,  1, -1,  0],
           [ 0,  0,  1,  1]])
    >>> print(chain.identifiability(excited=3))
    Balance of DOF 3 (forced): m3, storey 3, link 3-1.
    Balance of DOF 2: m2, storey 2.
    Balance of DOF 1: m1, storey 1.
    """

    def __init__(
        self,
        n_dof: int,
        links: Iterable[str] = (),
        ground: str = "base",
        rotates: bool = False,
    ) -> None:
        if ground not in _GROUNDS:
            cure = "Choose 'base', 'both' or 'free'."
            raise ChainError(f"ground={ground!r} is unknown", cure)

        self.n_dof = _number_of_masses(n_dof)
        self.ground = ground
        self.rotates = bool(rotates)
        storeys = _storeys(self.n_dof, ground)
        self.links = _further_links(links, storeys, self.n_dof)
        self.sites: tuple[Site, ...] = storeys + self.links

    @property
    def units(self) -> UnitSystem:
        """Units of its motion: of translations, or of rotations."""
        return unit_system(self.rotates)

    def site(self, text: SiteName) -> Site:
        """The site of this chain for a text or storey number.

        Parameters
        ----------
        text : str or int
            A site in the one grammar; on a chain grounded at both ends, storey n+1 is
            ``"ground n"``.

        Raises
        ------
        ChainError
            If the site does not exist on this chain.
        """
        site = Site(text)
        if site.kind == "sensor":
            return site

        above_top = site.is_storey and site.p == self.n_dof + 1
        if above_top and self.ground == "both":
            return Site(f"ground {self.n_dof}")
        if site.p > self.n_dof:
            what = f"{str(site)!r} does not exist on a chain with {self.n_dof} DOFs"
            raise ChainError(what, f"Its sites are {', '.join(self.sites)}.")
        return site

    def incidence(self, sites: Iterable[SiteName] | None = None) -> np.ndarray:
        """Signs of site forces in the equations of motion (paper eq. 4).

        Parameters
        ----------
        sites : iterable of str, optional
            Sites in column order; the chain's own by default.

        Returns
        -------
        ndarray of shape (n_dof, n_sites)
            +1, -1 and 0.
        """
        chosen = self.sites if sites is None else tuple(map(self.site, sites))
        signs = np.zeros((self.n_dof, len(chosen)))
        for column, site in enumerate(chosen):
            for row in range(self.n_dof):
                signs[row, column] = site.incidence(row + 1)
        return signs

    def with_links(self, links: Iterable[SiteName]) -> Chain:
        """The same chain with further links.

        Parameters
        ----------
        links : iterable of str
            Sites; the links among them that the chain does not have are added.
        """
        new = []
        for site in dict.fromkeys(map(self.site, links)):
            if site.kind == "link" and site not in self.sites:
                new.append(site)
        if not new:
            return self
        return Chain(self.n_dof, [*self.links, *new], self.ground, self.rotates)

    def of_rotations(self) -> Chain:
        """The same chain with DOFs that turn."""
        return Chain(self.n_dof, self.links, self.ground, rotates=True)

    def identifiability(
        self,
        excited: Dofs = (),
        *,
        unknown: Dofs = (),
        known_masses: Dofs = (),
        strategy: str = "auto",
    ) -> SolveOrder:
        """Masses and laws that an excitation can identify, from the topology alone.

        Parameters
        ----------
        excited : int or iterable of int
            DOFs on which a force acts and is measured.
        unknown : int or iterable of int
            DOFs whose force is unknown; their equations of motion are not used.
        known_masses : int or iterable of int
            DOFs whose mass is known.
        strategy : {"auto", "complete", "sequential", "joint"}
            See :class:`pysindy_nrf.NRFRegressor`.

        Returns
        -------
        SolveOrder
            The steps of the solve and what cannot be identified; ``str()`` describes
            it.
        """
        return plan_solve_order(self, excited, unknown, known_masses, strategy)

    def sensing(
        self,
        sensors: Dofs,
        excited: Dofs = (),
        *,
        known_masses: Dofs = (),
        model: ChainModel | None = None,
    ) -> Sensing:
        """What sensors on some floors determine of masses and stiffnesses.

        It is asked of the linearised problem.

        Parameters
        ----------
        sensors : int or iterable of int
            DOFs whose motion is measured.
        excited : int or iterable of int
            DOFs on which a measured force acts; none: the base moves.
        known_masses : int or iterable of int
            DOFs whose mass is known.
        model : ChainModel, optional
            A first guess of the chain; nearly equal masses and stiffnesses with 1 %
            damping if None.

        Returns
        -------
        Sensing
            ``rank``, ``condition``, ``errors`` and ``gains`` of one more sensor;
            ``str()`` says it in words.

        Raises
        ------
        ChainError
            If no floor has a sensor, or a DOF is not in the chain.

        Examples
        --------
        The response at a forced end determines everything; of a shaken chain no mass
        is known.

        >>> from pysindy_nrf import Chain
        >>> Chain(3).sensing(sensors=3, excited=3).complete
        True
        >>> Chain(3).sensing(sensors=3).complete
        False
        """
        return plan_sensing(self, sensors, excited, known_masses, model)

    def plan(self, **options: Unpack[PlanOptions]) -> Plan:
        """Recommend floors to excite or sensors to add.

        Parameters
        ----------
        **options
            See :func:`pysindy_nrf.chain.planning.plan`.

        Returns
        -------
        Plan
            ``str()`` describes it.
        """
        return plan(self, **options)

    def to_dict(self) -> ChainData:
        """Plain data for JSON."""
        data: ChainData = {
            "n_dof": self.n_dof,
            "links": [str(s) for s in self.links],
            "ground": self.ground,
        }
        if self.rotates:
            data["rotates"] = True
        return data

    @classmethod
    def from_dict(cls, data: ChainData) -> Chain:
        """A chain from what :meth:`to_dict` gave.

        Parameters
        ----------
        data : dict
            ``n_dof`` and, if there are any, ``links``, ``ground`` and ``rotates``.

        Returns
        -------
        Chain

        Examples
        --------
        >>> from pysindy_nrf import Chain
        >>> Chain.from_dict({"n_dof": 3, "links": ["link 3-1"]})
        Chain(3, links=['link 3-1'])
        """
        return cls(
            data["n_dof"],
            data.get("links", ()),
            data.get("ground", "base"),
            data.get("rotates", False),
        )

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Chain) and self.to_dict() == other.to_dict()

    def __hash__(self) -> int:
        return hash((self.n_dof, self.links, self.ground, self.rotates))

    def __repr__(self) -> str:
        arguments = [str(self.n_dof)]
        if self.links:
            arguments.append(f"links={list(map(str, self.links))}")
        if self.ground != "base":
            arguments.append(f"ground={self.ground!r}")
        if self.rotates:
            arguments.append("rotates=True")
        return f"Chain({', '.join(arguments)})"


def _number_of_masses(n_dof: object) -> int:
    """The number of DOFs, or an error."""
    if not is_whole(n_dof) or int(n_dof) < 1:
        what = f"n_dof={n_dof!r} is not a number of masses"
        raise ChainError(what, "Give a whole number of at least 1.")
    if int(n_dof) > MAX_DOFS:
        what = f"n_dof={n_dof} is more than the {MAX_DOFS} masses a chain may have"
        raise ChainError(what, "Condense it.")
    return int(n_dof)


def _storeys(n_dof: int, ground: str) -> tuple[Site, ...]:
    """The storeys of a chain, and the tie of its last DOF to the ground."""
    first = 2 if ground == "free" else 1
    sites = [Site(i) for i in range(first, n_dof + 1)]
    if ground == "both" and n_dof == 1:
        what = "A single mass grounded at both ends has two springs side by side"
        raise ChainError(what, "They act as one; use ground='base'.")
    if ground == "both":
        sites.append(Site(f"ground {n_dof}"))
    return tuple(sites)


def _further_links(
    texts: str | Iterable[str], storeys: tuple[Site, ...], n_dof: int
) -> tuple[Site, ...]:
    """Links beside the storeys, each one given once."""
    links: list[Site] = []
    for text in [texts] if isinstance(texts, str) else texts:
        site = Site(text)
        if site.kind != "link" or site.p > n_dof:
            what = f"{str(site)!r} is not a link of a chain with {n_dof} DOFs"
            raise ChainError(what, f"Links are 'link p-q' with 0 <= q < p <= {n_dof}.")
        if site in storeys or site in links:
            what = f"{str(site)!r} is in the chain already"
            raise ChainError(what, "Give each link once.")
        links.append(site)
    return tuple(links)


def chain_of(chain: Chain | None, n_dof: int) -> Chain:
    """The chain that a parameter gives; a plain one for None."""
    if chain is None:
        return Chain(n_dof)
    if not isinstance(chain, Chain):
        cure = "Give e.g. Chain(3, links=['link 3-1'])."
        raise ChainError(f"chain={chain!r} is not a Chain", cure)
    return chain


def masses_of(
    known_masses: Mapping[int, float] | None, chain: Chain
) -> dict[int, float]:
    """Known masses, kg, by DOF."""
    masses = {}
    for dof, mass in as_mapping("known_masses", known_masses, "{2: 12.4}").items():
        (j,) = dofs_of("known_masses", [dof], chain.n_dof)
        value = number_of(mass)
        if not np.isfinite(value) or value < 0:
            raise ChainError(f"known_masses[{dof}]={mass!r} is not a mass", "Give kg.")
        masses[j] = value
    return masses
