"""What a proposal must bring to be judged, and which of several comes next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..exceptions import NRFError
from . import judge
from .effect_judge import JudgedEffect
from .effects import SearchState
from .judge import JUDGE
from .naming import Proposal


@dataclass(frozen=True)
class AcceptanceSettings:
    """What is asked of an effect."""

    # Least error reduction of an outside force, or an inertia, dB: a fifth of what is
    # left. One line or one resonance is soon found.
    least_of_narrow: float = 2.0
    # The same of any other later effect, dB: less is what an inexact law leaves.
    least_of_later: float = 1.0
    # Share of the force at its site that an effect changes at least: less is within
    # the calibration of any sensor.
    least_share: float = 0.01


ACCEPTANCE = AcceptanceSettings()


@dataclass(frozen=True, eq=False)
class JudgedProposal:
    """A proposal, and what another condition says of it."""

    proposal: Proposal
    judged: JudgedEffect

    @property
    def value(self) -> float:
        """Error reduction, dB: of both records, if another record has judged it.

        In one record of few frequencies classes and sites are much alike.
        """
        if self.judged.condition != "another record":
            return self.proposal.value
        return 0.5 * (self.proposal.value + self.judged.heldout.value)


def is_there(proposal: Proposal, state: SearchState) -> bool:
    """Whether an effect stands whichever fold is left out, and changes a force."""
    finding, reduction = proposal.finding, proposal.reduction
    law = finding.candidate.law
    if not judge.is_there(reduction, law, _least_reduction(proposal, state)):
        return False
    if finding.is_fault:
        return True

    shares = judge.shares_of_force(finding, state)
    # a dashpot matters beside other dampers, whatever the springs hold, and one line
    # beside what else is at its frequency
    acts_apart = law.variable == "v" or law.narrow_band
    matters = acts_apart or max(shares.values()) >= ACCEPTANCE.least_share
    return matters and not judge.takes_over(finding, shares)


def _least_reduction(proposal: Proposal, state: SearchState) -> float:
    """Error reduction that an effect must bring, dB."""
    if proposal.naming.effect_class in ("inertial", "outside force"):
        return ACCEPTANCE.least_of_narrow

    if state.effects and not proposal.finding.is_fault:
        return ACCEPTANCE.least_of_later
    return JUDGE.least_reduction


def next_proposal(
    proposals: Sequence[JudgedProposal], state: SearchState
) -> JudgedProposal:
    """The proposal that comes next.

    The best, one of several sites by what each of them brings; or a simpler one that
    explains the same: what it loses is less than a further effect must bring.
    """
    best = max(proposals, key=_value_of_each_site)
    explaining = [best]
    for other in proposals:
        nearly = best.value - other.value < ACCEPTANCE.least_of_later
        if nearly and _is_simpler(other.proposal, best.proposal):
            if leaves_nothing_of(best.proposal, other.proposal, state):
                explaining.append(other)
    return min(explaining, key=_size)


def _value_of_each_site(judged: JudgedProposal) -> float:
    return judged.value / len(judged.proposal.finding.candidate.sites)


def _size(judged: JudgedProposal) -> tuple[tuple[int, int], float]:
    """Number of parameters; the better of two as large comes first."""
    return judged.proposal.finding.n_parameters, -judged.value


def _is_simpler(proposal: Proposal, best: Proposal) -> bool:
    """Whether a proposal has fewer parameters than the best one.

    A fault that no other channel witnesses is not simpler than a force: with a gain of
    its own a floor imitates most ties.
    """
    finding = proposal.finding
    has_no_witness = finding.is_fault and not finding.witnessed
    has_fewer = finding.n_parameters < best.finding.n_parameters
    return has_fewer and not has_no_witness


def leaves_nothing_of(force: Proposal, other: Proposal, state: SearchState) -> bool:
    """Whether nothing remains of a force once another proposal is in the model."""
    beside = other.finding.after
    if beside is None or other.value <= 0 or force.finding.is_fault:
        return False
    new = force.finding.new_effects(state.effects)
    try:
        both = beside.model.with_laws([(effect.site, effect.law) for effect in new])
    except NRFError:
        # their columns are the same
        return True
    reduction = both.reduction_from(beside.model)
    return not judge.is_there(reduction, force.finding.candidate.law)
