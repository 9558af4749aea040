"""Results of the loop in sentences; nothing reads them back."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from .contradictions import Contradiction
from .effects import RankedFinding
from .error_reduction import ErrorReduction

if TYPE_CHECKING:
    from .report import Step

NOTHING_IS_CLAIMED = "Nothing is claimed"
HELDOUT_IS_SEARCHED = (
    "The records to search do not determine the declared model, and those held out were"
    " searched too: a quarter of each record judges the effects"
)
GAINS_EXPLAIN = "gains and delays of the channels explain as much"
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


def judgement(step: Step) -> str:
    """What judged an effect, and what it said."""
    text = f"held-out balance error {step.error_before:.3g} to {step.error_after:.3g} %"
    if step.judged_by:
        size = f"{step.judged_reduction:.2g} dB, standard error {step.judged_error:.2g}"
        text = f"judged by {step.judged_by} ({size}); {text}"
    if step.confirmed:
        return text
    return f"{text}: NOT CONFIRMED, and the model does not hold it"


def name_of(step: Step) -> str:
    """Class and site of a step, and how far its name is known."""
    if step.is_fault or not step.effect_class:
        return f"{step.law} at {step.site}"
    name = f"{step.effect_class} at {step.site}"
    if step.carries:
        kind = "named" if step.sure else "closest name"
        return f"{name}, {kind} {step.law}"
    if not step.closest:
        return f"{name}, no name of the catalogue"
    share = f"{100 * step.closest_share:.0f} %"
    return f"{name}, closest name {step.closest} ({share} of the reduction)"


def step_sentence(step: Step) -> str:
    """A step of the report in one paragraph."""
    values = []
    for symbol, value in step.parameters.items():
        if value is not None and step.carries:
            unit = step.units.get(symbol, "")
            values.append(f"{symbol} = {value:.4g} {unit}".rstrip())

    name = name_of(step)
    if values:
        name = f"{name} ({', '.join(values)})"
    sentences = [f"{name}: {step.evidence}; {judgement(step)}"]

    if step.alternatives:
        others = ", ".join(step.alternatives)
        sentences.append(f"The data cannot distinguish it from: {others}")
    if step.laws_beside:
        beside = " and ".join(step.laws_beside)
        sentences.append(
            f"With {beside} there it may stand for one law that is not in the catalogue"
        )
    if step.sensors:
        sentences.append(
            f"The same fault, reversed, at {' or '.join(step.sensors)} explains as much"
        )
    return f"{'. '.join(sentences)}."


# -- why the search stopped ----------------------------------------------------


def best_refused(findings: Sequence[RankedFinding], why: str = "") -> str:
    """Why no further effect was added.

    Parameters
    ----------
    findings : sequence of RankedFinding
        Of the last round, the best first.
    why : str
        What speaks against the best of those that are there.
    """
    if not findings:
        return "no law of the catalogue lowers the error at any site"

    best = findings[0]
    text = (
        "no further effect is there and matters: the best candidate,"
        f" {best.finding.candidate.name}, lowers the error by"
        f" {best.reduction.value:.2g} dB {_errors_of(best.reduction)}"
    )
    return f"{text}; {why}" if why else text


def enough_effects(max_steps: int) -> str:
    """Why the search stopped when it had found as many effects as were asked for."""
    if not max_steps:
        return "no effect was asked for"
    return f"{max_steps} effects were added, as many as max_steps allows"


def channels_disagree(contradictions: Sequence[Contradiction]) -> str:
    """Channels of one DOF that do not show one motion."""
    witnesses = [channels.witness for channels in contradictions[:MAX_CONTRADICTIONS]]
    listed = "; ".join(dict.fromkeys(witnesses))
    return f"Channels contradict each other, and were fused all the same: {listed}"


def no_claim(reason: str) -> list[str]:
    """Sentences of a search from which nothing follows."""
    return [reason, NOTHING_IS_CLAIMED]
