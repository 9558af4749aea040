"""Constant forces, last and only where a catalogue names them.

The zero of every sensor is unknown, so every other decision leaves the means out.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress

from ..exceptions import NRFError
from . import judge
from .effects import Candidate, Effect, Finding, SearchState
from .fitted_model import FittedModel


def state_with_means(state: SearchState) -> SearchState | None:
    """The state fitted with the means left in; None if they cannot be.

    Without a measured force there is none: the zero of a base motion is no force.
    """
    spectra = state.model.spectra
    means_are_cut = spectra.windows.edges[0] > 0
    if not spectra.data.forced or means_are_cut:
        return None
    try:
        model = state.model.refitted(spectra.with_means())
    except NRFError:
        return None
    return SearchState(model, state.effects, state.records)


def best_constant(
    state: SearchState, candidates: Sequence[Candidate]
) -> Finding | None:
    """The constant force that lowers the residual of a state with means most."""
    findings = []
    for candidate in _free(candidates, state.effects):
        with suppress(NRFError):
            after = state.model.with_laws([(candidate.sites[0], candidate.law)])
            findings.append(_finding(candidate, state, after))
    there = [f for f in findings if f.reduction and judge.is_there(f.reduction)]
    return max(there, key=lambda f: f.value, default=None)


def _free(
    candidates: Iterable[Candidate], effects: Iterable[Effect]
) -> list[Candidate]:
    """Candidates that do not stand there already."""
    taken = {(effect.site, effect.template) for effect in effects}
    return [c for c in candidates if (c.sites[0], c.law) not in taken]


def _finding(candidate: Candidate, state: SearchState, after: FittedModel) -> Finding:
    reduction = after.reduction_from(state.model)
    effect = Effect(candidate.law, candidate.sites[0], candidate.law)
    effects = (*state.effects, effect)
    return Finding(
        candidate,
        (candidate.law,),
        state,
        reduction.value,
        reduction,
        SearchState(after, effects, state.records),
    )
