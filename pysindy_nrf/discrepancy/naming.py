"""The name of a place: does a law of the catalogue carry what stands best there?

A name has fewer parameters than the general law of its class. It carries the model if
it explains nearly as much.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..diagnosis.facts import Alternative
from ..equations.normal_equations import variance
from . import judge
from .candidate_search import SEARCH, best_findings, refined_finding, scan
from .effects import Candidate, Finding, SearchState
from .error_reduction import ErrorReduction
from .estimate_judge import EstimateJudge
from .judge import JUDGE
from .places import Place, class_at
from .promises import Promise, effects_at


@dataclass(frozen=True)
class NamingSettings:
    """When a name carries."""

    # Names of a place that are refined.
    finalists: int = 4
    # Names of the best place that are tried at all storeys at once, and the best of
    # all that are proposed there.
    together: int = 2
    # A name carries the model if it loses at most so much against the general law, dB,
    # or a standard error or a tenth up to a limit: it has fewer parameters, but another
    # class takes what an inexact law leaves.
    loss_of_name: float = 0.25
    most_lost: float = 0.75
    # Part of the gain that a name has at least where the final estimate with it follows
    # the motion as well as that with the general law.
    share_of_name: float = 0.8
    # By which a law that contains a name is better than it on another record, dB: where
    # nothing is missing the best of all candidates comes to 0.1 dB.
    gain_of_general: float = 0.1


NAMING = NamingSettings()


@dataclass(frozen=True)
class Naming:
    """A class, its general law, and the closest name.

    Attributes
    ----------
    effect_class : str
    closest : str
        Name of the law of the class that leaves least.
    share : float
        Part of the error reduction of the effect that the closest name has, in dB.
    carries : bool
        Whether the name carries the model, and not the general law.
    rivals : sequence of Finding
        Other names that explain the data as well.
    names : sequence of Finding
        All names of the place that were refined.
    one_shape : bool
        Whether several sites share the shape parameters of the name. Where they differ
        a wrong law with more of them is better than the right one.
    general : Finding or None
        The general law, where a name carries.
    instead : sequence of Alternative
        Faults of sensors with which the effect is not there.
    """

    effect_class: str
    closest: str = ""
    share: float = 1.0
    carries: bool = True
    rivals: Sequence[Finding] = ()
    names: Sequence[Finding] = ()
    one_shape: bool = False
    general: Finding | None = None
    instead: Sequence[Alternative] = ()


@dataclass(frozen=True, eq=False)
class Proposal:
    """What stands best at a place, added to a state."""

    finding: Finding
    reduction: ErrorReduction
    naming: Naming

    @property
    def value(self) -> float:
        """Cross-validated error reduction over the state, dB."""
        return self.reduction.value


def proposal_of(
    promise: Promise, state: SearchState, estimates: EstimateJudge
) -> Proposal | None:
    """The best of the general law of a place and its names."""
    place = promise.place
    names = best_findings(state, place.names, NAMING.finalists)
    general = promise.general
    carrying = _carrying(names, general, estimates)
    if carrying:
        name, rivals = _simplest_name(carrying, state)
        assert name.reduction is not None
        closest = name.candidate.law.name
        naming = Naming(
            place.effect_class, closest, rivals=rivals, names=names, general=general
        )
        return Proposal(name, name.reduction, naming)
    if general is None:
        return None
    return general_proposal(general, place.effect_class, names)


def general_proposal(
    general: Finding, effect_class: str, names: Sequence[Finding]
) -> Proposal | None:
    """The general law of a class, with the closest of some names."""
    if general.reduction is None:
        return None
    closest, share = "", 0.0
    if names:
        closest = names[0].candidate.law.name
        share = max(names[0].value, 0.0) / general.value
    naming = Naming(effect_class, closest, share, carries=False)
    return Proposal(general, general.reduction, naming)


def other_names(name: Finding, naming: Naming, place: Place) -> list[Finding]:
    """All names of a place but one, refined at its sites.

    The scan of a law of many shapes is coarse, and that of a steep one misses its peak:
    the right one may not be among the finalists.
    """
    others = [other for other in naming.names if other.candidate != name.candidate]
    refined = {name.candidate, *(other.candidate for other in others)}
    enough = SEARCH.share_of_best * name.value
    for of_place in place.names:
        candidate = replace(of_place, sites=name.candidate.sites)
        if candidate in refined:
            continue
        scanned = scan(name.before, candidate, name.before)
        other = refined_finding(scanned, enough) if scanned else None
        if other is not None:
            others.append(other)
    return others


def _carrying(
    names: Sequence[Finding], general: Finding | None, estimates: EstimateJudge
) -> list[Finding]:
    """Names that gain nearly as much as the general law.

    Or the best one, where the final estimate with it follows the motion as well: noise
    in the rate rounds a friction for least squares.
    """
    carrying = [name for name in names if _carries(name, general)]
    if carrying or not names or general is None:
        return carrying
    best = names[0]
    has_most = best.value >= NAMING.share_of_name * general.value
    if best.after is None or general.after is None or not has_most:
        return []
    follows = estimates.follows_as_well(best.after, general.after)
    return [best] if follows else []


def _carries(name: Finding, general: Finding | None) -> bool:
    """Whether a name gains nearly as much as the general law."""
    if name.value <= 0 or name.reduction is None:
        return False
    if general is None or general.reduction is None:
        return True
    without_fold = general.reduction.without_fold - name.reduction.without_fold
    error = float(np.sqrt(variance(without_fold)))
    lost = general.value - name.value
    nearly = max(JUDGE.loss_of_simplest * general.value, error)
    return lost <= max(NAMING.loss_of_name, min(nearly, NAMING.most_lost))


def _simplest_name(
    names: Sequence[Finding], state: SearchState
) -> tuple[Finding, list[Finding]]:
    """The simplest name within a standard error of the best, and those as good."""
    ranked = judge.ranked(names, state)
    place = judge.simplest(ranked)
    return ranked[place].finding, judge.rivals(ranked, place)


def at_all_storeys(
    best: Proposal, places: Sequence[Place], state: SearchState, room: int
) -> list[Proposal]:
    """Laws at all storeys at once that are needed at each of them.

    The name of the best place is tried, and laws of the ground.
    """
    candidates = _candidates_at_all_storeys(best, places, state, room)
    proposals = []
    for finding in best_findings(state, candidates, NAMING.together):
        if finding.reduction is not None and _is_needed_everywhere(finding, state):
            law, site = finding.candidate.law, finding.candidate.sites[0]
            effect_class = class_at(law, site, state.model.base)
            naming = Naming(effect_class, law.name, one_shape=bool(law.shapes))
            proposals.append(Proposal(finding, finding.reduction, naming))
    return proposals


def _candidates_at_all_storeys(
    best: Proposal, places: Sequence[Place], state: SearchState, room: int
) -> list[Candidate]:
    """The name of the best place, its rivals, and laws of the ground, everywhere.

    Dashpots to the ground are damping in proportion to mass, which every floor has:
    that of one floor alone gains little. They are tried at the floors that have none.
    """
    laws = [best.finding.candidate.law]
    laws += [rival.candidate.law for rival in best.naming.rivals]
    laws = laws[: NAMING.together]

    candidates = []
    for place in places:
        taken = {effect.site for effect in effects_at(place, state)}
        free = tuple(site for site in place.sites if site not in taken)
        if not 1 < len(free) <= room:
            continue
        is_of_best = place.effect_class == best.naming.effect_class and not taken
        for candidate in place.names:
            law = candidate.law
            if law.acts_at == ("ground",) or (is_of_best and law in laws):
                candidates.append(replace(candidate, sites=free))
    return candidates


def _is_needed_everywhere(finding: Finding, state: SearchState) -> bool:
    """Whether an effect of several sites is there at each, beside the others."""
    if finding.after is None or len(finding.candidate.sites) < 2:
        return False
    for effect in finding.new_effects(state.effects):
        without = finding.after.without([effect])
        alone = finding.after.model.reduction_from(without.model)
        if not judge.is_there(alone):
            return False
    return True
