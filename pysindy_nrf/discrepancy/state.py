"""What a search handles: proposals, accepted effects, the current state, findings."""

from __future__ import annotations

from dataclasses import dataclass

from ..laws.base import ForceLaw
from ..mechanics.sites import Site
from .prepare import Prepared
from .ruler import Gain, Trial


@dataclass(frozen=True)
class Proposal:
    """A law with free shape parameters at a site, or the same law at several sites."""

    law: ForceLaw
    sites: tuple[Site, ...]

    @property
    def name(self) -> str:
        """Law and sites in words."""
        return f"{self.law.name} at {', '.join(map(str, self.sites))}"


@dataclass(frozen=True)
class Effect:
    """An accepted law at a site; ``template`` has its shape parameters free."""

    law: ForceLaw
    site: Site
    template: ForceLaw

    @property
    def is_fault(self) -> bool:
        """Whether it is the fault of a sensor."""
        return self.site.kind == "sensor"


@dataclass(frozen=True)
class State:
    """The current model: its effects, how it stands on the ruler, and the records, freed of faults."""

    trial: Trial
    effects: tuple[Effect, ...] = ()
    ready: Prepared | None = None


@dataclass
class Finding:
    """A proposal with shape parameters, on top of a state, and its gain over it."""

    proposal: Proposal
    laws: tuple[ForceLaw, ...]
    state: State
    screen: float
    gain: Gain | None = None
    after: State | None = None
    witnessed: bool = False  # a fault of a sensor that another channel of its DOF contradicts

    @property
    def size(self) -> int:
        """Number of coefficients and shape parameters."""
        return len(self.laws) * (len(self.laws[0].terms()) + len(self.laws[0].shapes))

    @property
    def is_fault(self) -> bool:
        """Whether it is the fault of a sensor."""
        return self.proposal.sites[0].kind == "sensor"

    @property
    def family(self) -> str:
        """Family of the law."""
        return self.proposal.law.family
