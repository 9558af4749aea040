"""Results of the loop in sentences; nothing reads them back."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from .claims import GeneralReduction
from .contradictions import Contradiction
from .effects import RankedFinding
from .error_reduction import ErrorReduction

if TYPE_CHECKING:
    from .report import Step
    from .stepwise import Examination

MEANS_LEFT_IN = (
    "The table leaves means in, so a row may lie above the one before it; steps were"
    " confirmed without"
)
NOTHING_IS_CLAIMED = "Nothing is claimed"
# Contradictions that are named.
MAX_CONTRADICTIONS = 3


def paragraph(sentences: Iterable[str]) -> str:
    """Sentences one after the other; the last without a full stop."""
    return ". ".join(sentence.rstrip(".") for sentence in sentences)


def band(limits: tuple[float | None, float | None]) -> str:
    """A frequency band."""
    low, high = limits
    if low is None and high is None:
        return "full"
    return f"{low or 0:.3g}-{np.inf if high is None else high:.3g} Hz"


def acceptance(reduction: ErrorReduction, share: float) -> str:
    """Why an effect was accepted."""
    text = (
        f"lowers the residual on folds left out of the fit by {reduction.value:.2g} dB"
        f" {_errors_of(reduction)}"
    )
    if np.isfinite(share):
        text += f"; it changes {100 * share:.0f} % of the force at its site"
    return text


def _errors_of(reduction: ErrorReduction) -> str:
    """How far an error reduction is sure."""
    return (
        f"(standard error {reduction.standard_error:.2g}, {reduction.least:.2g} without"
        " the fold that contributes most)"
    )


def confirmation(step: Step) -> str:
    """Whether held-out data confirm an effect."""
    text = f"held-out balance error {step.error_before:.3g} to {step.error_after:.3g} %"
    if step.confirmed:
        return text
    if step.error_after < step.error_before:
        text += ", but the error reduction is too small"
    return f"{text}: NOT CONFIRMED, and the model does not hold it"


def step_sentence(step: Step) -> str:
    """A step of the report in one paragraph."""
    values = []
    for symbol, value in step.parameters.items():
        if value is not None:
            unit = step.units.get(symbol, "")
            values.append(f"{symbol} = {value:.4g} {unit}".rstrip())

    name = f"{step.law} at {step.site}"
    if not step.sure:
        remainder = f"{100 * step.remainder:.0f} %"
        name = f"closest law {name}, unexplained remainder {remainder}"
    sentences = [f"{name} ({', '.join(values)}): {step.evidence}; {confirmation(step)}"]

    if step.alternatives:
        others = ", ".join(step.alternatives)
        sentences.append(f"The data cannot distinguish it from: {others}")
    if step.company:
        sentences.append(
            f"With {' and '.join(step.company)} there it may stand for one law that is"
            " not in the catalogue"
        )
    if step.sensors:
        sentences.append(
            f"The same fault, reversed, at {' or '.join(step.sensors)} explains as much"
        )
    return f"{'. '.join(sentences)}."


# -- why the search stopped ----------------------------------------------------


def best_refused(
    findings: Sequence[RankedFinding], examination: Examination | None = None
) -> str:
    """Why no further effect was added.

    Parameters
    ----------
    findings : sequence of RankedFinding
        Of the last round, the best first.
    examination : Examination, optional
        Of the best.
    """
    if not findings:
        return "no law of the catalogue lowers the error at any site"

    best = findings[0]
    text = (
        "no further effect is there and matters: the best candidate,"
        f" {best.finding.candidate.name}, lowers the error by"
        f" {best.reduction.value:.2g} dB {_errors_of(best.reduction)}"
    )
    if examination is None:
        return text
    if examination.chance is not None:
        return f"{text}; {_by_chance(examination.chance)}"
    beyond = examination.beyond_errors
    if beyond is None or beyond.value > 0.5 * best.reduction.value:
        return text
    return (
        f"{text}; errors of the channels within their tolerances leave"
        f" {max(beyond.value, 0.0):.2g} dB of it"
    )


def _by_chance(chance: float) -> str:
    """By how much a search lowers the error by chance."""
    if not np.isfinite(chance):
        return "the model has no free run, which would show what chance does"
    return f"where nothing is missing, a search lowers the error by {chance:.2g} dB"


def enough_effects(max_steps: int) -> str:
    """Why the search stopped when it had found as many effects as were asked for."""
    if not max_steps:
        return "no effect was asked for"
    return f"{max_steps} effects were added, as many as max_steps allows"


def not_in_catalogue(reductions: Iterable[GeneralReduction]) -> str:
    """What general laws would still explain of what the model leaves."""
    parts = []
    for general in reductions:
        reduction = f"{general.reduction.value:.2g} dB"
        parts.append(
            f"{general.words} at {general.site} lowers the error by {reduction}"
        )
    return f"What is left is not noise alone: {', '.join(parts)}"


def channels_disagree(contradictions: Sequence[Contradiction]) -> str:
    """Channels of one DOF that do not show one motion."""
    witnesses = [channels.witness for channels in contradictions[:MAX_CONTRADICTIONS]]
    listed = "; ".join(dict.fromkeys(witnesses))
    return f"Channels contradict each other, and were fused all the same: {listed}"


def no_claim(reason: str) -> list[str]:
    """Sentences of a search from which nothing follows."""
    return [reason, NOTHING_IS_CLAIMED]
