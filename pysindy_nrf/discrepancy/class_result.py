"""What a search for classes found: effects accepted and refused, and its last state."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from .effect_judge import JudgedEffect
from .effects import Effect, Finding, RankedFinding, SearchState
from .naming import Naming, Proposal
from .spectra import BalanceSpectra


@dataclass(frozen=True, eq=False)
class TriedEffect:
    """An effect that was judged, with its naming.

    Attributes
    ----------
    effect : Effect
    naming : Naming
    judged : JudgedEffect
    position : int
        Number of the claims that were accepted before it.
    corrected : BalanceSpectra or None
        Of a fault, the spectra of the records freed of it.
    """

    effect: Effect
    naming: Naming
    judged: JudgedEffect
    position: int
    corrected: BalanceSpectra | None = None


@dataclass(frozen=True)
class ClassResult:
    """What a search found.

    Attributes
    ----------
    first, state : SearchState
        Before the search and at its end, with the means left in if it found a constant.
    accepted : tuple of TriedEffect
        In the order of the effects of the state.
    refused : tuple of TriedEffect
        What the judge refused.
    last : sequence of RankedFinding
        Candidates of the last round, the best first.
    general : tuple of Finding
        General laws of the last round: what they would still gain.
    why_refused : str
        What speaks against the best candidate of the last round.
    """

    first: SearchState
    state: SearchState
    accepted: tuple[TriedEffect, ...] = ()
    refused: tuple[TriedEffect, ...] = ()
    last: Sequence[RankedFinding] = ()
    general: tuple[Finding, ...] = ()
    why_refused: str = ""

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The effects in the order in which they were accepted."""
        return self.state.effects

    @property
    def n_claims(self) -> int:
        """Number of effects that do not only add to another."""
        return sum(not effect.enriches for effect in self.effects)

    def with_accepted(self, proposal: Proposal, judged: JudgedEffect) -> ClassResult:
        """The result with the effects of a proposal."""
        after = proposal.finding.after
        assert after is not None
        known = {tried.effect: tried for tried in self.accepted}
        accepted = []
        for effect in after.effects:
            tried = known.get(effect)
            if tried is None:
                tried = self._tried(effect, proposal, judged)
            accepted.append(tried)

        refused = _without(self.refused, accepted[-1])
        return replace(self, state=after, accepted=tuple(accepted), refused=refused)

    def with_refused(self, proposal: Proposal, judged: JudgedEffect) -> ClassResult:
        """The result with an effect that the judge refused, the best of its round."""
        after = proposal.finding.after
        assert after is not None

        (effect, *_) = proposal.finding.new_effects(self.effects)
        position = self.n_claims
        is_claim = not proposal.finding.only_enriches(self.effects)
        if not is_claim or any(tried.position == position for tried in self.refused):
            return self

        tried = self._tried(effect, proposal, judged)
        return replace(self, refused=(*_without(self.refused, tried), tried))

    def with_state(self, state: SearchState) -> ClassResult:
        """The result with effects whose shape parameters were refined."""
        accepted = []
        for tried, effect in zip(self.accepted, state.effects):
            accepted.append(replace(tried, effect=effect))
        return replace(self, state=state, accepted=tuple(accepted))

    def _tried(
        self, effect: Effect, proposal: Proposal, judged: JudgedEffect
    ) -> TriedEffect:
        """An effect of a proposal that was judged."""
        corrected = None
        if effect.is_fault and proposal.finding.after is not None:
            corrected = proposal.finding.after.model.spectra
        return TriedEffect(effect, proposal.naming, judged, self.n_claims, corrected)


def _without(
    refused: Iterable[TriedEffect], other: TriedEffect
) -> tuple[TriedEffect, ...]:
    """Refused effects but those of the class and site of another."""
    place = other.naming.effect_class, other.effect.site
    return tuple(
        tried
        for tried in refused
        if (tried.naming.effect_class, tried.effect.site) != place
    )
