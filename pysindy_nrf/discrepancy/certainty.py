"""How much of an effect stays unexplained beyond noise, and if its name is sure."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from ..chain.sites import Site
from ..exceptions import NRFError
from .bootstrap import SimulatedRecords
from .catalogue import same_balance
from .fitted_model import FittedModel
from .steps import StepDraft


@dataclass(frozen=True)
class CertaintySettings:
    """When a name is sure."""

    # A name is sure if at most 5 % of the effect stays beyond 1.2 times what noise
    # leaves: right names of the battery leave 0.7 to 1.1 times it, names that stand in
    # for a withheld law 1.4 times.
    remainder: float = 0.05
    times_noise: float = 1.2
    # Draws of noise; one of them shows what noise leaves of a balance to a fifth, 0.8
    # to 1.3 of the mean.
    draws: int = 4
    least_of_draw: float = 0.8


CERTAINTY = CertaintySettings()


@dataclass(frozen=True)
class Certainty:
    """How sure the name of an effect is.

    Attributes
    ----------
    company : list of str
        Other confirmed laws in the same balance with the same motion: together they may
        stand for a single law.
    remainder : float
        Share of the effect that stays unexplained beyond noise.
    sure : bool
    """

    company: list[str]
    remainder: float
    sure: bool


@dataclass(frozen=True)
class CertaintyReport:
    """Certainty of each effect, and what the balances keep beyond noise, percent."""

    effects: list[Certainty]
    beyond_noise: np.ndarray


def certainty_of(
    drafts: Sequence[StepDraft],
    final: FittedModel,
    draws: Iterable[SimulatedRecords],
) -> CertaintyReport:
    """How much of each effect its worst balance keeps, and if its name is sure.

    Parameters
    ----------
    drafts : sequence of StepDraft
    final : FittedModel
        With all confirmed effects.
    draws : iterable of SimulatedRecords
        What the final model would have produced with fresh noise.
    """
    errors = final.balance_errors
    names = [_name(draft, drafts, errors) for draft in drafts]
    largest = max((name.size for name in names if name.may_be_sure), default=0.0)

    floor = _NoiseFloor(errors)
    for drawn in draws:
        floor.add(final, drawn)
        lowest = np.nanmax(floor.beyond(CERTAINTY.least_of_draw))
        # no name can be sure
        if lowest > CERTAINTY.remainder * largest:
            break

    beyond = floor.beyond(1.0)
    effects = []
    for name in names:
        remainder = float(np.nanmax(beyond)) / name.size
        sure = name.may_be_sure and remainder <= CERTAINTY.remainder
        effects.append(Certainty(name.company, remainder, sure))
    return CertaintyReport(effects, beyond)


@dataclass(frozen=True)
class _Name:
    """What decides on the name of an effect before noise is looked at."""

    company: list[str]
    # what was missing without the effect, percent
    size: float
    may_be_sure: bool


def _name(draft: StepDraft, drafts: Sequence[StepDraft], errors: np.ndarray) -> _Name:
    """What decides on the name of an effect beside others."""
    company = _company(draft, drafts)
    has_rivals = bool(draft.alternatives or company)
    may_be_sure = draft.plausible and draft.confirmed and not has_rivals
    return _Name(company, _size_of_effect(draft, errors), may_be_sure)


class _NoiseFloor:
    """What noise alone leaves of each balance, by draws."""

    def __init__(self, errors: np.ndarray) -> None:
        self.errors = errors
        self.squares: list[np.ndarray] = []

    def add(self, final: FittedModel, drawn: SimulatedRecords) -> None:
        """Add a draw, if the model can be fitted to it."""
        with suppress(NRFError):
            of_noise = final.refitted(drawn.spectra).balance_errors
            self.squares.append(np.square(np.nan_to_num(of_noise)))

    def beyond(self, share: float) -> np.ndarray:
        """What is left beyond noise, if the draws so far hold a share of its mean."""
        floor = np.zeros_like(self.errors)
        if self.squares:
            floor = np.mean(self.squares, axis=0) / share**2
        noise = CERTAINTY.times_noise**2 * floor
        return np.sqrt(np.maximum(self.errors**2 - noise, 0.0))


def _size_of_effect(draft: StepDraft, errors: np.ndarray) -> float:
    """What was missing without an effect, percent; what is left now at least."""
    site = draft.effect.site
    balances = list(range(len(errors)))
    if site.kind != "sensor":
        touched = [j for j in balances if site.incidence(j + 1)]
        balances = touched or balances
    now = float(np.sqrt(np.mean(errors[balances] ** 2)))
    return max(draft.validation_before, now, 1e-300)


def _company(draft: StepDraft, drafts: Iterable[StepDraft]) -> list[str]:
    """Other confirmed laws in the same balance with the same motion."""
    site = same_balance(draft.effect.site)
    company = []
    for other in drafts:
        there = other is not draft and same_balance(other.effect.site) == site
        if there and other.confirmed:
            company.append(other.effect.law.name)
    return company


def lacks_a_law(site: Site, lacking: Iterable[Site]) -> bool:
    """Whether a general law explains more in the balance of a site."""
    return same_balance(site) in {same_balance(other) for other in lacking}
