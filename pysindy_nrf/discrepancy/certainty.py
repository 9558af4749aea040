"""How much of an effect stays unexplained beyond noise."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from ..exceptions import NRFError
from .bootstrap import SimulatedRecords
from .catalogue import same_balance
from .fitted_model import FittedModel
from .steps import StepDraft


@dataclass(frozen=True)
class CertaintySettings:
    """What noise leaves."""

    # Times what noise leaves of a balance from which on it is more than noise: right
    # names of the battery leave 0.7 to 1.1 times it.
    times_noise: float = 1.2
    # Draws of noise; one of them shows what noise leaves of a balance to a fifth.
    draws: int = 2


CERTAINTY = CertaintySettings()


@dataclass(frozen=True)
class Certainty:
    """What stands next to an effect, and what it leaves.

    Attributes
    ----------
    laws_beside : list of str
        Other confirmed laws in the same balance with the same motion: together they may
        stand for a single law.
    remainder : float
        Share of the effect that stays unexplained beyond noise.
    """

    laws_beside: list[str]
    remainder: float


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
    """How much of each effect its worst balance keeps beyond noise.

    Parameters
    ----------
    drafts : sequence of StepDraft
    final : FittedModel
        With all confirmed effects.
    draws : iterable of SimulatedRecords
        What the final model would have produced with fresh noise.
    """
    errors = final.balance_errors
    floor = _NoiseFloor(errors)
    for drawn in draws:
        floor.add(final, drawn)

    beyond = floor.beyond()
    effects = []
    for draft in drafts:
        remainder = float(np.nanmax(beyond)) / _size_of_effect(draft, errors)
        effects.append(Certainty(_laws_beside(draft, drafts), remainder))
    return CertaintyReport(effects, beyond)


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

    def beyond(self) -> np.ndarray:
        """What is left beyond noise, percent."""
        floor = np.zeros_like(self.errors)
        if self.squares:
            floor = np.mean(self.squares, axis=0)
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


def _laws_beside(draft: StepDraft, drafts: Iterable[StepDraft]) -> list[str]:
    """Other confirmed laws in the same balance with the same motion."""
    site = same_balance(draft.effect.site)
    laws_beside = []
    for other in drafts:
        there = other is not draft and same_balance(other.effect.site) == site
        if there and other.confirmed:
            laws_beside.append(other.effect.law.name)
    return laws_beside
