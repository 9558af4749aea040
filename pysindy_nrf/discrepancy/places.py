"""Places: a class of effect at a site, and the names that it may have there."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass

from ..chain.sites import Site
from ..chain.structure import Chain
from ..laws.base import EffectClass, ForceLaw
from .effects import Candidate

# Classes whose general law is a sum of atoms; the others know names alone.
GROWN: tuple[EffectClass, ...] = ("memoryless", "hysteresis")


@dataclass(frozen=True)
class Place:
    """A class of effect at a site, or at several sites at once.

    Attributes
    ----------
    sites : tuple of Site
    effect_class : str
    names : tuple of Candidate
        Laws of the class that are tried there.
    grows : bool
        Whether a general law is grown there.
    """

    sites: tuple[Site, ...]
    effect_class: EffectClass
    names: tuple[Candidate, ...]
    grows: bool

    @property
    def quick_names(self) -> tuple[Candidate, ...]:
        """Names that show what a place without a general law promises.

        A tie that slackens or slips is first of all a spring, a dashpot or friction.
        """
        if self.effect_class != "tie":
            return self.names
        return tuple(c for c in self.names if not c.law.free_shape)

    @property
    def words(self) -> str:
        """Class and site in words."""
        return f"{self.effect_class} at {', '.join(map(str, self.sites))}"


def class_at(law: ForceLaw, site: Site, chain: Chain) -> EffectClass:
    """Class of the effects that a law names at a site.

    Whatever joins DOFs that the chain does not join is a tie.
    """
    if site.kind != "dof" and site not in chain.sites:
        return "tie"
    return law.effect_class


def places_of(
    candidates: Iterable[Candidate], chain: Chain, at_storeys: Collection[Site]
) -> list[Place]:
    """The places of all candidates.

    A class that has a name at a storey has a general law there, too.

    Parameters
    ----------
    candidates : iterable of Candidate
    chain : Chain
    at_storeys : collection of Site
        Links at which the drift and its rate are known to move.
    """
    names: dict[tuple[tuple[Site, ...], EffectClass], list[Candidate]] = {}
    for candidate in candidates:
        effect_class = class_at(candidate.law, candidate.sites[0], chain)
        names.setdefault((candidate.sites, effect_class), []).append(candidate)

    places = []
    for (sites, effect_class), of_place in names.items():
        grows = effect_class in GROWN and len(sites) == 1 and sites[0] in at_storeys
        places.append(Place(sites, effect_class, tuple(of_place), grows))
    return places
