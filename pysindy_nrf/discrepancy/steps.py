"""The step of the report that an effect makes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from . import judge, wording
from .decision import Decision
from .effects import Effect, Finding
from .fitted_model import FittedModel
from .intervals import Interval, effect_intervals
from .report import Step

# Other families that are named.
MAX_ALTERNATIVES = 2


@dataclass(frozen=True)
class StepDraft:
    """A step without the certainty of its name.

    Attributes
    ----------
    effect : Effect
    plausible : bool
        Whether it is sure to be there, its coefficients may be real, and its shape
        parameters are its own.
    step : Step
    """

    effect: Effect
    plausible: bool
    step: Step

    def refused(self) -> StepDraft:
        """The same of a model of which nothing may be claimed."""
        return replace(self, step=replace(self.step, confirmed=False))


def draft_step(decision: Decision, rivals: Sequence[Finding]) -> StepDraft:
    """The step of an effect without the certainty of its name.

    Parameters
    ----------
    decision : Decision
        After all effects that were confirmed before it.
    rivals : sequence of Finding
        Candidates that explained the data as well.
    """
    effect = decision.effect
    before, model = decision.before.model, decision.after.model
    reduction = model.reduction_from(before)
    fitted, share = effect.law, float("nan")
    units = model.chain.units
    intervals: dict[str, Interval] = {}
    if not effect.is_fault:
        fitted = effect.law_in(model.chain_model())
        intervals = effect_intervals(model, effect)
        without = model.without(effect.site, effect.law)
        share = judge.share_of_force(model, without, effect.site)

    step = Step(
        effect.law.name,
        effect.law.family,
        str(effect.site),
        shape=dict(effect.law.shape),
        parameters=dict(fitted.parameters),
        units={name: units.of(unit) for name, unit in fitted.units.items()},
        intervals=intervals,
        alternatives=_other_families(effect, model, rivals),
        error_before=decision.before.error,
        error_after=decision.after.error,
        free_run_before=decision.before.free_run_error,
        free_run_after=decision.after.free_run_error,
        validation_before=before.error,
        reduction=reduction.value,
        reduction_error=reduction.standard_error,
        reduction_least=reduction.least,
        reduction_heldout=decision.heldout_reduction.value,
        share=share,
        confirmed=decision.confirmed,
        evidence=wording.acceptance(reduction, share),
        rivals=[_rival(finding) for finding in rivals],
        sensors=_reversed_sensors(effect, rivals),
    )
    if effect.is_fault:
        real = effect.witnessed
    else:
        real = all((fitted.parameters[c] or 0.0) >= 0 for c in fitted.nonnegative)
    return StepDraft(effect, real and reduction.bound > 0, step)


def _other_families(
    effect: Effect, model: FittedModel, rivals: Sequence[Finding]
) -> list[str]:
    """Other families that explain the data as well as an effect."""
    families = [finding.family for finding in rivals]
    if effect.is_constant:
        # the wrong zero of a displacement is the same
        families = ["sensor"]
    elif not effect.is_fault:
        low, high = model.spectra.band
        drift = model.spectra.data.scales(effect.site)[0]
        limit = effect.law.limit(drift, (low or 0.0, high or np.inf))
        families.insert(0, limit)

    others = [f for f in dict.fromkeys(families) if f != effect.law.family]
    return others[:MAX_ALTERNATIVES]


def _rival(finding: Finding) -> tuple[str, str, float]:
    """Law, sites and error reduction (dB) of a finding."""
    value = finding.reduction.value if finding.reduction else np.nan
    return finding.candidate.law.name, finding.candidate.site_names, value


def _reversed_sensors(effect: Effect, rivals: Sequence[Finding]) -> list[str]:
    """Sensors that the data could accuse as well of the same fault, reversed."""
    if not effect.is_fault:
        return []
    sensors = []
    for finding in rivals:
        if finding.is_fault and finding.candidate.law.name == effect.law.name:
            sensors.append(str(finding.candidate.sites[0]))
    return sensors
