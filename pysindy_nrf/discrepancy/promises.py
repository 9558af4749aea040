"""What the places of a chain add to a state: a grown law, or scanned names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from ..exceptions import NRFError
from ..laws.atoms import SumOfAtoms
from .candidate_search import scan
from .dictionary import dictionary
from .effects import Candidate, Effect, Finding, SearchState
from .growth import grown_law
from .places import Place, class_at


@dataclass(frozen=True, eq=False)
class Promise:
    """What a place adds to a state: a grown law, or the scan of its names."""

    place: Place
    value: float
    general: Finding | None = None


def effects_at(place: Place, state: SearchState) -> list[Effect]:
    """Effects of a class at a site that allow no second one."""
    chain = state.model.base
    effects = []
    for effect in state.effects:
        if effect.is_fault or effect.site not in place.sites:
            continue
        same = class_at(effect.template, effect.site, chain) == place.effect_class
        if same and not effect.template.superposes:
            effects.append(effect)
    return effects


def enrichment_of(
    place: Place, state: SearchState, effects: Sequence[Effect]
) -> Promise | None:
    """What atoms add to an effect that is there, which makes no new claim.

    A general law is grown again; a name gets a general law at its site, once.
    """
    if not place.grows or len(effects) > 1:
        return None
    grown_before = [e for e in effects if isinstance(e.law, SumOfAtoms)]
    general = _grown(place, state.without(grown_before), enriches=not grown_before)
    if general is None or general.after is None:
        return None

    reduction = general.after.model.reduction_from(state.model)
    general = replace(general, reduction=reduction)
    nameless = replace(place, names=())
    return Promise(nameless, reduction.value, general)


def promise_of(place: Place, state: SearchState) -> Promise | None:
    """What a place adds to a state; None if nothing can stand there."""
    if place.grows:
        general = _grown(place, state)
        if general is None:
            return None
        return Promise(place, general.value, general)
    best = 0.0
    for candidate in place.quick_names:
        finding = scan(state, candidate, state)
        if finding is not None:
            best = max(best, finding.screened)
    return Promise(place, best) if best > 0 else None


def _grown(place: Place, state: SearchState, enriches: bool = False) -> Finding | None:
    """The general law of a place, added to a state."""
    (site,) = place.sites
    atoms = dictionary(place.effect_class, site, state.model.spectra.data)
    if atoms is None:
        return None
    try:
        law = grown_law(state.model, site, atoms)
        if law is None:
            return None
        after = state.model.with_laws([(site, law)])
    except NRFError:
        return None
    reduction = after.reduction_from(state.model)
    effects = (*state.effects, Effect(law, site, law, enriches=enriches))
    return Finding(
        Candidate(law, (site,)),
        (law,),
        state,
        reduction.value,
        reduction,
        SearchState(after, effects, state.records),
    )
