"""The chain: masses, the links that join them, and how a link's force enters the
balances.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from ..common import MOST_DOFS, number_of
from ..exceptions import ChainError
from .identifiability import Sensing, SolveOrder, plan_sensing, plan_solve_order
from .planning import Plan, plan
from .sites import Site, as_mapping, dofs_of

_GROUNDS = ("base", "both", "free")


class Chain:
    r"""A chain of masses joined by force laws.

    DOFs are j = 1..n, DOF 0 is the base (ground). Storey i joins DOF i and DOF i-1. The
    balance of DOF j is (paper eq. 3)

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
        self, n_dof: int, links: Iterable[str] = (), ground: str = "base"
    ) -> None:
        if isinstance(n_dof, bool) or not hasattr(n_dof, "__index__") or int(n_dof) < 1:
            raise ChainError(
                f"n_dof={n_dof!r} is not a number of masses",
                "Give a whole number of at least 1.",
            )
        if int(n_dof) > MOST_DOFS:
            raise ChainError(
                f"n_dof={n_dof} is more than the {MOST_DOFS} masses a chain may have",
                "Condense it.",
            )
        if ground not in _GROUNDS:
            raise ChainError(
                f"ground={ground!r} is unknown", "Choose 'base', 'both' or 'free'."
            )
        self.n_dof = int(n_dof)
        self.ground = ground
        if isinstance(links, str):
            links = [links]
        sites = [Site(i) for i in range(1 if ground != "free" else 2, self.n_dof + 1)]
        if ground == "both":
            if self.n_dof == 1:
                cure = "They act as one; use ground='base'."
                raise ChainError(
                    "A single mass grounded at both ends has two springs side by side",
                    cure,
                )
            sites.append(Site(f"ground {self.n_dof}"))
        extra = []
        for text in links:
            site = Site(text)
            if site.kind != "link" or site.p > self.n_dof:
                cure = f"Links are 'link p-q' with 0 <= q < p <= {self.n_dof}."
                raise ChainError(
                    f"{str(site)!r} is not a link of a chain with {self.n_dof} DOFs",
                    cure,
                )
            if site in sites or site in extra:
                raise ChainError(
                    f"{str(site)!r} is in the chain already", "Give each link once."
                )
            extra.append(site)
        self.links = tuple(extra)
        self.sites: tuple[Site, ...] = tuple(sites + extra)

    def site(self, text: Any) -> Site:
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
        if site.is_storey and site.p == self.n_dof + 1 and self.ground == "both":
            site = Site(f"ground {self.n_dof}")
        if site.kind == "sensor":
            return site
        if site.p > self.n_dof or (site.kind == "link" and site.q < 0):
            cure = f"Its sites are {', '.join(self.sites)}."
            raise ChainError(
                f"{str(site)!r} does not exist on a chain with {self.n_dof} DOFs", cure
            )
        return site

    def incidence(self, sites: Iterable[str] | None = None) -> np.ndarray:
        """Signs with which site forces enter the balances (Newton's third law, paper
        eq. 4).

        Parameters
        ----------
        sites : iterable of str, optional
            Sites in column order; the chain's own by default.

        Returns
        -------
        ndarray of shape (n_dof, n_sites)
            +1, -1 and 0.
        """
        chosen = self.sites if sites is None else [self.site(s) for s in sites]
        return np.array(
            [[site.incidence(j) for site in chosen] for j in range(1, self.n_dof + 1)],
            dtype=float,
        ).reshape(self.n_dof, len(chosen))

    def with_links(self, links: Iterable[str]) -> Chain:
        """The same chain with further links.

        Parameters
        ----------
        links : iterable of str
            Sites; the links among them that the chain does not have are added.
        """
        new = [
            s
            for s in dict.fromkeys(map(self.site, links))
            if s.kind == "link" and s not in self.sites
        ]
        return Chain(self.n_dof, (*self.links, *new), self.ground) if new else self

    def identifiability(
        self,
        excited: int | Iterable[int] = (),
        *,
        unknown: int | Iterable[int] = (),
        known_masses: int | Iterable[int] = (),
        strategy: str = "auto",
    ) -> SolveOrder:
        """Masses and laws that an excitation can identify, from the topology alone.

        Parameters
        ----------
        excited, unknown, known_masses : int or iterable of int
            DOFs on which a force acts and is measured, whose force is unknown (their
            balances are not used), and whose mass is known.
        strategy : {"auto", "complete", "sequential", "joint"}
            See :class:`pysindy_nrf.NRFRegressor`.

        Returns
        -------
        SolveOrder
            The order of the solve and what cannot be identified; ``str()`` describes
            it.
        """
        return plan_solve_order(self, excited, unknown, known_masses, strategy)

    def sensing(
        self,
        sensors: int | Iterable[int],
        excited: int | Iterable[int] = (),
        *,
        known_masses: int | Iterable[int] = (),
        model: Any = None,
    ) -> Sensing:
        """What sensors on some floors only can tell of masses and stiffnesses, by the
        linearised problem.

        Parameters
        ----------
        sensors, excited, known_masses : int or iterable of int
            DOFs whose motion is measured, on which a measured force acts (none: the
            base moves), whose mass is known.
        model : ChainModel, optional
            A first guess of the chain; else nearly equal masses and stiffnesses with 1
            % damping.

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
        >>> from pysindy_nrf import Chain
        >>> Chain(3).sensing(
        ...     sensors=3, excited=3
        ... ).complete  # the response at a forced end tells all
        True
        >>> Chain(3).sensing(
        ...     sensors=3
        ... ).complete  # of a shaken chain no mass is known
        False
        """
        return plan_sensing(self, sensors, excited, known_masses, model)

    def plan(self, **options: Any) -> Plan:
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

    def to_dict(self) -> dict:
        """Plain data for JSON."""
        return {
            "n_dof": self.n_dof,
            "links": [str(s) for s in self.links],
            "ground": self.ground,
        }

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Chain) and self.to_dict() == other.to_dict()

    def __hash__(self) -> int:
        return hash((self.n_dof, self.links, self.ground))

    def __repr__(self) -> str:
        more = f", links={[str(s) for s in self.links]}" if self.links else ""
        more += f", ground={self.ground!r}" if self.ground != "base" else ""
        return f"Chain({self.n_dof}{more})"


def chain_of(chain: Any, n_dof: int) -> Chain:
    """The chain that a parameter gives; a plain one if None."""
    if chain is not None and not isinstance(chain, Chain):
        raise ChainError(
            f"chain={chain!r} is not a Chain", "Give e.g. Chain(3, links=['link 3-1'])."
        )
    return Chain(n_dof) if chain is None else chain


def masses_of(given: Any, chain: Chain) -> dict[int, float]:
    """Known masses, kg, by DOF."""
    known = {}
    for dof, mass in as_mapping("known_masses", given, "{2: 12.4}").items():
        (j,) = dofs_of("known_masses", [dof], chain.n_dof)
        value = number_of(mass)
        if not np.isfinite(value) or value < 0:
            raise ChainError(f"known_masses[{dof}]={mass!r} is not a mass", "Give kg.")
        known[j] = value
    return known
