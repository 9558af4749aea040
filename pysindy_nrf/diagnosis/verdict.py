"""The verdict on a model: may it be used, what does it hold, and why not.

A verdict is a pure function of :class:`~pysindy_nrf.diagnosis.facts.Facts`, by the
rules of :mod:`pysindy_nrf.diagnosis.rules`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .effects import capitalised
from .facts import Facts, Loop, facts_of_loop
from .free_run import FreeRuns as FreeRuns
from .free_run import free_runs as free_runs
from .rules import RULES, Kind, Reason, judged_error, open_balance
from .wiring import LARGE
from .wiring import suspect_channels as suspect_channels

__all__ = ["Verdict", "verdict_from"]

# Percent of a balance unexplained, above which other mappings of channels are tried.
DOUBTFUL = 25.0
# What explains all other reasons, the strongest first.
_CAUSES: tuple[Kind, ...] = ("drift", "wiring", "alternative", "channel")
# Share of the residual below which an alternative explains what errors of wiring would.
_EXPLAINS = 0.2
# What speaks against the channels and the search, not against the model itself.
_NOT_OF_THE_MODEL: tuple[Kind, ...] = ("no claim", "wiring", "channel")
# What is no news beside a model that is not to be used.
_OF_A_USABLE_MODEL: tuple[Kind, ...] = (
    "unexplained",
    "damping",
    "free run",
    "sensitivity",
)
# What leaves open whether anything else is missing in a linear model.
_OF_THE_MOTION: tuple[Kind, ...] = ("damping", "free run", "sensitivity")


@dataclass(frozen=True)
class Verdict:
    """Whether a model may be used, in one sentence, and why.

    Parameters
    ----------
    state : {"green", "amber", "red"}
        Green: the balances close and the free run follows the motion. Amber: usable
        with the care that the reasons name. Red: not to be used.
    sentence : str
    reasons : tuple of str
        What makes it amber or red, the gravest first.
    grounds : tuple of Reason
        All that speaks against the model, with kind, place and size.
    assumptions : tuple of str
        What the model takes for granted, because nothing in the data checks it.

    Examples
    --------
    >>> from pysindy_nrf.diagnosis.verdict import Verdict
    >>> withheld = "The intervals are withheld."
    >>> print(Verdict("amber", "Linear storeys.", (withheld,)))
    AMBER: Linear storeys.
      - The intervals are withheld.
    """

    state: str
    sentence: str
    reasons: tuple[str, ...] = ()
    grounds: tuple[Reason, ...] = ()
    assumptions: tuple[str, ...] = ()

    def __str__(self) -> str:
        lines = [f"{self.state.upper()}: {self.sentence}"]
        lines += [f"  - {reason}" for reason in self.reasons]
        lines += [f"  Assumed: {assumption}" for assumption in self.assumptions]
        return "\n".join(lines)


def verdict_from(facts: Facts) -> Verdict:
    """The verdict that follows from facts, and from nothing else.

    Parameters
    ----------
    facts : Facts

    Returns
    -------
    Verdict

    Examples
    --------
    >>> from pysindy_nrf.diagnosis.facts import Facts
    >>> from pysindy_nrf.diagnosis.verdict import verdict_from
    >>> verdict = verdict_from(Facts(unexplained={1: 2.0, 2: 61.0}))
    >>> verdict.state, verdict.grounds[0].kind, verdict.grounds[0].place
    ('red', 'unexplained', 'dof 2')
    """
    verdict = _verdict_by(_reasons_of(facts), facts)
    assumed = [assumption.sentence for assumption in facts.assumptions]
    assumed += [note.message for note in facts.quality if note.kind == "assumed"]
    return replace(verdict, assumptions=tuple(dict.fromkeys(assumed)))


def _verdict_by(reasons: Sequence[Reason], facts: Facts) -> Verdict:
    if any(reason.severity == "red" for reason in reasons):
        return _not_to_be_used(reasons, facts)

    state = "amber" if reasons else "green"
    messages = dict.fromkeys(reason.message for reason in reasons)
    sentence = _what_it_holds(facts, reasons)
    return Verdict(state, sentence, tuple(messages), tuple(reasons))


def _reasons_of(facts: Facts) -> list[Reason]:
    reasons: list[Reason] = []
    for rule in RULES:
        reasons += rule(facts)
    return reasons


def _what_it_holds(facts: Facts, reasons: Sequence[Reason]) -> str:
    """What a usable model holds, and how well it runs alone."""
    holds = "Linear storeys"
    if facts.holds:
        holds = "; ".join([*facts.holds, "linear otherwise"])
    elif all(reason.kind in _OF_THE_MOTION for reason in reasons):
        holds = "Linear storeys, nothing else was found"

    run = facts.free_run
    error = judged_error(run)
    if np.isfinite(error):
        over = " over ten periods" if error < run.error else ""
        by = " by Newmark's method" if run.by_newmark else ""
        holds += f"; the free run predicts the motion to {error:.2g} %{over}{by}"
    return f"{capitalised(holds)}."


def _not_to_be_used(reasons: Sequence[Reason], facts: Facts) -> Verdict:
    """A red verdict: the reason that explains most is named in its sentence."""
    red = _decisive(reasons)
    cause = min(red, key=_rank_of_cause)

    messages = [reason.message for reason in red]
    if [reason.kind for reason in red] == ["wiring"]:
        messages += _large_residuals(facts)
    messages += [reason.message for reason in _further_reasons(cause, reasons)]
    others = dict.fromkeys(messages)
    del others[cause.message]
    sentence = f"Do not use this model. {cause.message}"
    return Verdict("red", sentence, tuple(others), tuple(reasons))


def _decisive(reasons: Sequence[Reason]) -> list[Reason]:
    """The red reasons.

    A model that is wrong itself says why nothing is claimed.
    """
    red = [reason for reason in reasons if reason.severity == "red"]
    if all(reason.kind in _NOT_OF_THE_MODEL for reason in red):
        return red
    return [reason for reason in red if reason.kind != "no claim"]


def _rank_of_cause(reason: Reason) -> int:
    """The lower, the more a reason explains."""
    return _CAUSES.index(reason.kind) if reason.kind in _CAUSES else len(_CAUSES)


def _large_residuals(facts: Facts) -> list[str]:
    """Balances that an error of wiring leaves open."""
    large = {j: share for j, share in facts.unexplained.items() if share > LARGE}
    return [open_balance(j, share) for j, share in large.items()]


def _further_reasons(cause: Reason, reasons: Sequence[Reason]) -> list[Reason]:
    """What else is to be known of a model that is not to be used."""
    channels = [reason for reason in reasons if reason.kind == "channel"]
    if cause.kind == "wiring":  # it explains the doubts
        return channels
    return channels + [reason for reason in reasons if _is_doubt(reason)]


def _is_doubt(reason: Reason) -> bool:
    """Whether a reason is news beside those that forbid the use of a model."""
    return reason.severity == "amber" and reason.kind not in _OF_A_USABLE_MODEL


def suspects_wiring(facts: Facts) -> bool:
    """Whether other mappings of the channels are worth a try."""
    explained = any(a.residual_share < _EXPLAINS for a in facts.alternatives)
    if explained or facts.unseen_drifts:
        return False
    largest = max(facts.unexplained.values(), default=0.0)
    red = any(reason.severity == "red" for reason in _reasons_of(facts))
    return red or bool(facts.channel_faults) or largest > DOUBTFUL


def verdict_after_search(
    facts: Facts, search_wiring: Callable[[], str] | None
) -> Verdict:
    """The verdict, after a search for errors of wiring where the facts suggest one.

    Parameters
    ----------
    facts : Facts
    search_wiring : callable, optional
        Gives the error of wiring without which the balances close, or an empty text.
        It takes as long as many fits.
    """
    if search_wiring is not None and suspects_wiring(facts):
        facts = replace(facts, wiring=search_wiring())
    return verdict_from(facts)


def loop_verdict(report: Loop) -> Verdict:
    """The verdict on the model of a closed loop."""
    return verdict_after_search(facts_of_loop(report), lambda: report.wiring)
