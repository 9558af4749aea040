"""What a search handles: candidates, effects, its state, and what it finds."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from ..chain.model import ChainModel
from ..chain.sites import Site
from ..laws.atoms import SumOfAtoms
from ..laws.base import ForceLaw
from ..laws.power_series import PowerSeries
from .error_reduction import ErrorReduction
from .fitted_model import FittedModel
from .prepare import PreparedRecords


@dataclass(frozen=True)
class Candidate:
    """A law with free shape parameters at a site, or the same law at several sites."""

    law: ForceLaw
    sites: tuple[Site, ...]

    @property
    def site_names(self) -> str:
        """The sites in words."""
        return ", ".join(map(str, self.sites))

    @property
    def name(self) -> str:
        """Law and sites in words."""
        return f"{self.law.name} at {self.site_names}"


@dataclass(frozen=True)
class Effect:
    """An accepted law at a site.

    Attributes
    ----------
    law, template : ForceLaw
        With the values of its shape parameters, and with those free that are found.
    site : Site
    witnessed : bool
        Of a fault of a sensor, whether another channel of its DOF contradicts it. One
        that none does has no sure name: a bias of the fit looks alike.
    enriches : bool
        Whether it only adds to an effect of its class at its site, and is no claim of
        its own.
    """

    law: ForceLaw
    site: Site
    template: ForceLaw
    witnessed: bool = True
    enriches: bool = False

    @property
    def name(self) -> str:
        """Law and site in words."""
        return f"{self.law.name} at {self.site}"

    @property
    def is_fault(self) -> bool:
        """Whether it is the fault of a sensor, which is no force."""
        return self.site.kind == "sensor"

    @property
    def is_constant(self) -> bool:
        """Whether it is a constant force, which the means alone show."""
        return self.law.variable == "1"

    def law_in(self, model: ChainModel) -> ForceLaw:
        """Its law with the values of a model, the last of its name at the site."""
        laws = model.laws[self.site]
        return next(law for law in reversed(laws) if law.name == self.law.name)


def instants_of(effects: Iterable[Effect]) -> list[float]:
    """Times at which effects change something, s."""
    instants = []
    for effect in effects:
        for shape in effect.law.shapes:
            if shape.instant:
                instants.append(float(effect.law.shape[shape.name] or 0.0))
    return instants


@dataclass(frozen=True)
class SearchState:
    """The current model, its effects, and the records, freed of faults."""

    model: FittedModel
    effects: tuple[Effect, ...] = ()
    records: PreparedRecords | None = None

    def has_shape_at(self, site: Site) -> bool:
        """Whether a law of a certain shape acts at a site, declared or found.

        Springs, dashpots and power series bend with the data.
        """
        for law in self.model.laws.get(site, ()):
            labels = {term.label for term in law.terms()}
            if not (labels <= {"s", "v"} or isinstance(law, PowerSeries)):
                return True
        return any(effect.site == site for effect in self.effects)

    def without(self, effects: Iterable[Effect]) -> SearchState:
        """The state without some effects."""
        removed = set(effects)
        if not removed:
            return self

        model = self.model
        for effect in removed:
            model = model.without(effect.site, effect.law)
        remaining = tuple(e for e in self.effects if e not in removed)
        return SearchState(model, remaining, self.records)


@dataclass(frozen=True, eq=False)
class Finding:
    """A candidate with shape parameters added to the model of a state.

    Attributes
    ----------
    candidate : Candidate
    laws : tuple of ForceLaw
        One for each site.
    before : SearchState
        To which the candidate is added; of a replaced effect, without it.
    screened : float
        Error reduction on the samples of the fit, dB.
    reduction : ErrorReduction or None
        Cross-validated, over the state before; None if it was only scanned.
    after : SearchState or None
        With the effect.
    witnessed : bool
        Of a fault of a sensor, whether another channel of its DOF contradicts it.
    """

    candidate: Candidate
    laws: tuple[ForceLaw, ...]
    before: SearchState
    screened: float
    reduction: ErrorReduction | None = None
    after: SearchState | None = None
    witnessed: bool = False

    @property
    def value(self) -> float:
        """Cross-validated error reduction, dB."""
        return -float("inf") if self.reduction is None else self.reduction.value

    @property
    def n_parameters(self) -> tuple[int, int]:
        """Number of all parameters, and of those that are no coefficients.

        An atom of a general law has a coefficient, and was chosen out of many.
        """
        law = self.laws[0]
        n_shapes = len(law.shapes)
        if isinstance(law, SumOfAtoms):
            n_shapes = len(law.atoms)
        n_laws = len(self.laws)
        return n_laws * (len(law.terms()) + n_shapes), n_laws * n_shapes

    @property
    def family(self) -> str:
        """Family of the law."""
        return self.candidate.law.family

    @property
    def is_fault(self) -> bool:
        """Whether it is the fault of a sensor."""
        return self.candidate.sites[0].kind == "sensor"

    def new_effects(self, beside: Iterable[Effect]) -> list[Effect]:
        """Effects that it adds to others."""
        if self.after is None:
            return []
        known = set(beside)
        return [effect for effect in self.after.effects if effect not in known]

    def only_enriches(self, effects: Sequence[Effect]) -> bool:
        """Whether it only adds to effects that are there, or grows one again."""
        assert self.after is not None
        is_larger = len(self.after.effects) > len(effects)
        new = self.new_effects(effects)
        return all(effect.enriches for effect in new) or not is_larger


@dataclass(frozen=True, eq=False)
class RankedFinding:
    """A finding with its error reduction over the current state.

    Whatever effects it replaces.
    """

    finding: Finding
    reduction: ErrorReduction
