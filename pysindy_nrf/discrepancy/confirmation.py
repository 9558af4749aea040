"""Confirmation on held-out data, which have the last word."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from math import log10

from ..exceptions import NRFError
from . import judge
from .effects import Effect
from .error_reduction import ErrorReduction
from .fitted_model import FittedModel
from .heldout import HeldoutJudge, JudgedModel
from .judge import JUDGE
from .stepwise import SearchResult


@dataclass(frozen=True)
class ConfirmationSettings:
    """What is asked of an effect on held-out data."""

    # Share of an error, in the search or held out, by which an effect must lower it.
    least_fall: float = 0.1

    @property
    def least_reduction(self) -> float:
        """The same fall of the error in the search, dB."""
        return -20 * log10(1 - self.least_fall)


CONFIRMATION = ConfirmationSettings()


@dataclass(frozen=True, eq=False)
class FoundEffect:
    """An effect as the search found it: models without and with it.

    Beside all effects that were found before it.
    """

    effect: Effect
    before: FittedModel
    after: FittedModel


@dataclass(frozen=True, eq=False)
class Decision:
    """An effect judged on held-out data: models without and with it.

    Beside all effects that were confirmed before it.
    """

    effect: Effect
    before: JudgedModel
    after: JudgedModel

    @cached_property
    def confirmed(self) -> bool:
        """Whether the held-out error falls, and what is left by a tenth.

        There, or in the search.
        """
        limit = (1.0 - CONFIRMATION.least_fall) * self.before.error
        least = CONFIRMATION.least_reduction
        if self.after.error <= limit:
            least = JUDGE.least_reduction
        reduction = self.after.model.reduction_from(self.before.model)
        falls = self.after.error < self.before.error
        return falls and judge.is_there(reduction, self.effect.law, least)

    @property
    def heldout_reduction(self) -> ErrorReduction:
        """Error reduction on held-out data."""
        informative = self.before.model.spectra.bands.informative
        return ErrorReduction.between(
            self.before.heldout, self.after.heldout, informative
        )


@dataclass(frozen=True, eq=False)
class Confirmation:
    """Effects of a search judged on held-out data.

    Attributes
    ----------
    baseline, final : JudgedModel
        Without effects, and with all that are confirmed.
    searched : dict of Effect to FoundEffect
    decisions : list of Decision
        In the order in which they were taken.
    """

    baseline: JudgedModel
    final: JudgedModel
    searched: dict[Effect, FoundEffect]
    decisions: list[Decision]

    @property
    def largest(self) -> FittedModel:
        """The model with all effects that were found."""
        if not self.searched:
            return self.baseline.model
        return list(self.searched.values())[-1].after

    @property
    def judged(self) -> list[JudgedModel]:
        """The baseline, and the models with each effect."""
        return [self.baseline, *(decision.after for decision in self.decisions)]


class Confirmer:
    """Confirms the effects of a search on held-out data.

    Parameters
    ----------
    result : SearchResult
    heldout : HeldoutJudge
    """

    def __init__(self, result: SearchResult, heldout: HeldoutJudge) -> None:
        self.result = result
        self.heldout = heldout

    def confirm(self) -> Confirmation:
        """Keep the effects that lower the held-out error.

        Retry the others beside them, and at last beside each other.
        """
        # the products of the largest model serve all smaller ones
        largest = self.result.state.model
        largest.spectra.products(largest.layout)
        largest.powers_on(self.heldout.heldout(largest.spectra))

        baseline = self.heldout.judged("baseline", self.result.first.model)
        searched = self._found_effects()
        final = baseline
        decisions: dict[Effect, Decision] = {}
        pending = list(searched)

        while pending:
            refused = []
            for effect in pending:
                decision = self._decide(final, effect)
                # they stand in the order in which they are taken
                decisions.pop(effect, None)
                decisions[effect] = decision
                if decision.confirmed:
                    final = decision.after
                else:
                    refused.append(effect)

            if len(refused) == len(pending):
                jointly = self._decide_jointly(final, refused)
                if not jointly:
                    break
                for decision in jointly:
                    decisions.pop(decision.effect)
                    decisions[decision.effect] = decision
                final = jointly[-1].after
                together = {decision.effect for decision in jointly}
                refused = [effect for effect in refused if effect not in together]
            pending = refused

        return Confirmation(baseline, final, searched, list(decisions.values()))

    def _found_effects(self) -> dict[Effect, FoundEffect]:
        """Each effect as the search found it, beside all those found before it."""
        searched: dict[Effect, FoundEffect] = {}
        model = self.result.first.model
        for effect in self.result.effects:
            # columns may depend on those of the model
            with suppress(NRFError):
                searched[effect] = self._with_effect(model, effect)
                model = searched[effect].after
        return searched

    def _with_effect(self, model: FittedModel, effect: Effect) -> FoundEffect:
        """A model without and with an effect; a fault only changes the records."""
        if effect.is_fault:
            spectra = self.result.corrected[effect]
            if not model.spectra.windows.centred:
                spectra = self.heldout.spectra_with_means(spectra)
            return FoundEffect(effect, model, model.refitted(spectra))
        if effect.is_constant:
            model = self.heldout.with_means(model)
        return FoundEffect(effect, model, model.with_laws([(effect.site, effect.law)]))

    def _decide(self, confirmed: JudgedModel, effect: Effect) -> Decision:
        """The confirmed model without and with one effect more."""
        try:
            models = self._with_effect(confirmed.model, effect)
        except NRFError:
            return Decision(effect, confirmed, replace(confirmed, name=effect.name))

        before = confirmed
        if models.before is not confirmed.model:
            before = self.heldout.judged(confirmed.name, models.before)
        return Decision(effect, before, self.heldout.judged(effect.name, models.after))

    def _decide_jointly(
        self, confirmed: JudgedModel, effects: Sequence[Effect]
    ) -> list[Decision]:
        """Effects of which none is confirmed alone, each judged beside the others.

        Errors pass to the storey below until the law of that storey is there. None if
        not all that remain are confirmed.
        """
        remaining = [effect for effect in effects if effect.passes_on_its_error]
        decisions: list[Decision] = []
        # columns may depend on each other
        with suppress(NRFError):
            while len(remaining) > 1 and len(decisions) != len(remaining):
                decisions = self._beside_the_others(confirmed, remaining)
                remaining = [d.effect for d in decisions if d.confirmed]
        if not remaining or len(decisions) != len(remaining):
            return []
        return decisions

    def _beside_the_others(
        self, confirmed: JudgedModel, effects: Sequence[Effect]
    ) -> list[Decision]:
        """Each effect judged beside the confirmed model with all others."""
        models = []
        for effect in effects:
            others = [(e.site, e.law) for e in effects if e is not effect]
            model = confirmed.model.with_laws(others)
            models.append(self.heldout.judged(confirmed.name, model))
        return [self._decide(model, effect) for model, effect in zip(models, effects)]
