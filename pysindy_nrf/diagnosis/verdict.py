"""The verdict on a model: may it be used, what does it hold, and why not.

A verdict is a pure function of :class:`~pysindy_nrf.diagnosis.facts.Facts`. Each rule
looks at one kind of fact and returns the reasons that follow from it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ..chain.model import ChainModel
from .effects import Bounds as Bounds
from .effects import Effect, law_at_site, plain_name
from .effects import nonlinear_parts as nonlinear_parts
from .effects import shares_of as shares_of
from .facts import Facts, FreeRunFacts, Loop, facts_of_loop, facts_of_model
from .free_run import FreeRuns as FreeRuns
from .free_run import free_runs as free_runs
from .wiring import LARGE, OPEN
from .wiring import mapping_that_closes as mapping_that_closes
from .wiring import suspect_channels as suspect_channels

__all__ = ["Verdict", "verdict_from"]

# Percent of a balance unexplained, above which other mappings of channels are tried.
DOUBTFUL = 25.0
# Percent of the measured motion by which a free run may miss it.
ASTRAY = 20.0
# Percent from which on a free run has nothing to do with the measured motion, and from
# which on its size says nothing more.
DIVERGED, BEYOND_NUMBERS = 100.0, 1e3
# Factor by which a free run may get worse with an effect.
WORSE_FREE_RUN = 1.1

Kind = Literal[
    "unexplained",  # a balance keeps a part of its force
    "mass",  # no structure has it
    "stiffness",  # negative
    "interval",  # the data do not determine a mass
    "free run",  # the model alone leaves the measured motion
    "damping",  # a mode grows by itself
    "no claim",  # the search claims nothing
    "channel",  # reversed, in another unit or in the wrong column
    "wiring",  # with another mapping of the channels the balances close
    "quality",  # what is known of a channel, a clock or a unit
    "effect",  # an effect is not confirmed, or its name is not sure
    "evidence",  # a question to the residual has no answer
    "other",
]
Severity = Literal["amber", "red"]


@dataclass(frozen=True)
class Reason:
    """Why a model is not simply to be used.

    Parameters
    ----------
    kind : str
    severity : {"amber", "red"}
        Usable with care, or not to be used.
    message : str
        In a sentence.
    place : str
        DOF, site, channel or parameter; empty for the model as a whole.
    size : float
        How much, as the kind says: percent, kg, or a damping ratio.
    """

    kind: Kind
    severity: Severity
    message: str
    place: str = ""
    size: float = float("nan")


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

    def __str__(self) -> str:
        lines = [f"{self.state.upper()}: {self.sentence}"]
        lines += [f"  - {reason}" for reason in self.reasons]
        return "\n".join(lines)


# -- rules ---------------------------------------------------------------------


def unexplained_equations(facts: Facts) -> list[Reason]:
    """Equations of motion of which the model leaves a large part."""
    reasons = []
    for j, percent in facts.unexplained.items():
        if percent > OPEN:
            message = _leaves(j, percent)
            reasons.append(Reason("unexplained", "red", message, f"dof {j}", percent))
        elif percent > LARGE:
            message = (
                f"{percent:.3g} % of the force in the balance of DOF {j} is"
                " unexplained: a law is missing, or the channels are noisy."
            )
            reasons.append(Reason("unexplained", "amber", message, f"dof {j}", percent))
    return reasons


def _leaves(dof: int, percent: float) -> str:
    return f"The balance of DOF {dof} leaves {percent:.3g} % of its force unexplained."


def impossible_masses(facts: Facts) -> list[Reason]:
    """Masses that no structure has."""
    if not facts.impossible_masses:
        return []
    masses = [f"m{j} = {mass:.4g} kg" for j, mass in facts.impossible_masses.items()]
    places = [f"m{j}" for j in facts.impossible_masses]
    message = f"{', '.join(masses)}: no structure has a mass that is not positive."
    smallest = min(facts.impossible_masses.values())
    return [Reason("mass", "red", message, ", ".join(places), smallest)]


def negative_stiffness(facts: Facts) -> list[Reason]:
    """Storeys that push away from their rest."""
    if not facts.negative_stiffness:
        return []
    storeys = ", ".join(facts.negative_stiffness)
    message = f"The stiffness of {storeys} came out negative."
    return [Reason("stiffness", "red", message, storeys)]


def undetermined_masses(facts: Facts) -> list[Reason]:
    """Masses whose interval holds zero."""
    names = []
    for name, (low, high) in facts.intervals.items():
        if name.startswith("m") and low <= 0 < high:
            names.append(name)
    if not names:
        return []
    masses = ", ".join(names)
    message = f"The data do not determine {masses}: the interval holds zero."
    return [Reason("interval", "red", message, masses)]


def diverging_free_run(facts: Facts) -> list[Reason]:
    """A model that, alone, has nothing to do with the measured motion."""
    run = facts.free_run
    if facts.impossible_masses:
        return []
    if run.diverges:
        message = run.why_not or "The free run diverges."
        return [Reason("free run", "red", message, size=run.error)]

    follows_at_first = run.over_periods < ASTRAY
    if run.error > DIVERGED and not run.floats and not follows_at_first:
        message = "The free run diverges."
        if run.error < BEYOND_NUMBERS:
            missed = f"it misses the motion by {run.error:.3g} %."
            message = f"The free run diverges: {missed}"
        return [Reason("free run", "red", message, size=run.error)]
    return []


def growing_mode(facts: Facts) -> list[Reason]:
    """A mode that grows by itself, unless the free run follows all the same."""
    mode = facts.growing_mode
    if mode is None or _judged_error(facts.free_run) < ASTRAY:
        return []
    message = creates_energy(mode.number, mode.damping)
    place = f"mode {mode.number}"
    return [Reason("damping", "amber", message, place, mode.damping)]


def creates_energy(mode: object, damping: float) -> str:
    """The verdict on a mode that grows by itself."""
    return (
        f"This model creates energy: mode {mode} has a damping of {100 * damping:.2g} %"
        " of critical. No structure does so by itself: a sign, a unit, a delay or a"
        " mass is wrong, a law is missing, or noise outweighs the damping."
    )


def straying_free_run(facts: Facts) -> list[Reason]:
    """A free run that misses the measured motion."""
    error = _judged_error(facts.free_run)
    if not np.isfinite(error) or error <= ASTRAY:
        return []
    message = (
        f"The free run misses the measured motion by {error:.3g} %. A model can be"
        " right and still drift (a stage without a spring, a yielding storey, a record"
        " that starts in motion); see its figure."
    )
    return [Reason("free run", "amber", message, size=error)]


def _judged_error(run: FreeRunFacts) -> float:
    """Error of the free run, percent: over some periods where it drifts later."""
    drifts_later = run.error > ASTRAY and run.over_periods < run.error
    return run.over_periods if drifts_later else run.error


def nothing_claimed(facts: Facts) -> list[Reason]:
    """A search that claims nothing."""
    if not facts.nothing_claimed:
        return []
    return [Reason("no claim", "red", as_sentence(facts.nothing_claimed))]


def wiring(facts: Facts) -> list[Reason]:
    """An error of wiring without which the balances close."""
    if not facts.wiring:
        return []
    return [Reason("wiring", "red", facts.wiring)]


def channel_faults(facts: Facts) -> list[Reason]:
    """Channels that seem reversed, in another unit or in the wrong column."""
    reasons = []
    for message, sure in facts.channel_faults.items():
        reasons.append(Reason("channel", "red" if sure else "amber", message))
    return reasons


def quality_notes(facts: Facts) -> list[Reason]:
    """What is known of channels, clocks and units."""
    named = {note.record for note in facts.quality}
    several_records = facts.n_records > 1 or len(named) > 1
    reasons = []
    for note in facts.quality:
        if _repeats_a_fault(note.message, facts):
            continue
        message = note.message
        if several_records:
            message = f"Record {note.record!r}: {message}"
        reason = Reason("quality", "amber", message, note.channel, note.size)
        reasons.append(reason)
    return reasons


def other_doubts(facts: Facts) -> list[Reason]:
    """What else is doubtful."""
    doubts = [text for text in facts.doubts if not _repeats_a_fault(text, facts)]
    return [Reason("other", "amber", doubt) for doubt in doubts]


def _repeats_a_fault(message: str, facts: Facts) -> bool:
    """Whether the fault of a channel says the same and more."""
    return any(message.rstrip(".") in fault for fault in facts.channel_faults)


def doubtful_effects(facts: Facts) -> list[Reason]:
    """Effects that are not confirmed, not sure by name, or bought with a free run."""
    reasons = []
    for effect in facts.effects:
        for message in _doubts_of_effect(effect):
            reasons.append(Reason("effect", "amber", message, effect.site))
    return reasons


def _doubts_of_effect(effect: Effect) -> list[str]:
    """What is doubtful about one effect."""
    name = law_at_site(effect)
    begin = name[:1].upper() + name[1:]
    if not effect.confirmed:
        change = f"{effect.error_before:.3g} to {effect.error_after:.3g} %"
        return [
            f"{begin} is NOT CONFIRMED: the held-out error goes from {change}. The"
            " model does not hold it."
        ]

    doubts = []
    named_otherwise = effect.alternatives or effect.company
    if not effect.sure and not named_otherwise:
        doubts.append(
            f"{begin} is only the closest law: {100 * effect.remainder:.0f} % of the"
            f" effect stays unexplained, and the gain is {effect.gain:.2g} dB with a"
            f" standard error of {effect.gain_error:.2g}."
        )
    doubts += not_told_apart(effect)
    if effect.free_run_after > WORSE_FREE_RUN * effect.free_run_before:
        change = f"{effect.free_run_before:.3g} to {effect.free_run_after:.3g} %"
        doubts.append(
            f"With {name} the held-out free run is worse than before ({change}), though"
            " the balances close better."
        )
    return doubts


def not_told_apart(effect: Effect) -> list[str]:
    """What else the data allow instead of an effect."""
    texts = []
    if effect.alternatives:
        others = ", ".join(map(plain_name, effect.alternatives))
        family = plain_name(effect.family)
        texts.append(f"At {effect.site} the data cannot tell {family} from {others}.")
    if effect.company:
        laws = sorted(map(plain_name, (effect.law, *effect.company)))
        together = f"{', '.join(laws[:-1])} and {laws[-1]}"
        texts.append(
            f"At {effect.site} {together} may together stand for one law that is not in"
            " the catalogue."
        )
    if effect.sensors:
        sensors = " or ".join(effect.sensors)
        texts.append(
            f"The same fault, reversed, at {sensors} explains as much as"
            f" {law_at_site(effect)}."
        )
    return texts


def unanswered_questions(facts: Facts) -> list[Reason]:
    """Questions to the residual that have no answer."""
    reasons = []
    for question, why in facts.unanswered.items():
        message = as_sentence(f"{question} was not possible because {why}")
        reasons.append(Reason("evidence", "amber", message, question))
    return reasons


def unknown_noise(facts: Facts) -> list[Reason]:
    """It is not known what noise alone would leave."""
    if facts.noise_is_known:
        return []
    message = (
        "What noise alone would leave is not known here: an unmeasured force is not"
        " told from noise."
    )
    return [Reason("evidence", "amber", message)]


# In the order in which their reasons are listed.
RULES: tuple[Callable[[Facts], list[Reason]], ...] = (
    unexplained_equations,
    impossible_masses,
    negative_stiffness,
    undetermined_masses,
    diverging_free_run,
    growing_mode,
    straying_free_run,
    nothing_claimed,
    wiring,
    channel_faults,
    quality_notes,
    other_doubts,
    doubtful_effects,
    unanswered_questions,
    unknown_noise,
)
# What speaks against the channels and the search, not against the model itself.
_NOT_OF_THE_MODEL = ("no claim", "wiring", "channel")
# What is no news beside a model that is not to be used.
_OF_A_USABLE_MODEL = ("unexplained", "damping", "free run")
# What leaves open whether anything else is missing in a linear model.
_OF_THE_MOTION = ("damping", "free run")


# -- verdict -------------------------------------------------------------------


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
    reasons = _reasons_of(facts)
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
    error = _judged_error(run)
    if np.isfinite(error):
        over = " over ten periods" if error < run.error else ""
        holds += f"; the free run predicts the motion to {error:.2g} %{over}"
    return f"{holds[:1].upper()}{holds[1:]}."


def _not_to_be_used(reasons: Sequence[Reason], facts: Facts) -> Verdict:
    """A red verdict: the reason that explains most is named in its sentence."""
    red = [reason for reason in reasons if reason.severity == "red"]
    if any(reason.kind not in _NOT_OF_THE_MODEL for reason in red):
        # the model itself says why nothing is claimed
        red = [reason for reason in red if reason.kind != "no claim"]
    # an error of wiring, else a faulty channel, explains the rest
    named = min(red, key=_rank_of_cause)

    messages = [reason.message for reason in red]
    if red == [named] and named.kind == "wiring":
        messages += _large_residuals(facts)
    messages += [reason.message for reason in reasons if reason.kind == "channel"]
    if named.kind != "wiring":
        messages += [reason.message for reason in reasons if _is_doubt(reason)]
    others = dict.fromkeys(messages)
    del others[named.message]
    sentence = f"Do not use this model. {named.message}"
    return Verdict("red", sentence, tuple(others), tuple(reasons))


def _rank_of_cause(reason: Reason) -> int:
    """The lower, the more a reason explains."""
    return {"wiring": 0, "channel": 1}.get(reason.kind, 2)


def _is_doubt(reason: Reason) -> bool:
    """Whether a reason tells more of a model that is not to be used."""
    return reason.severity == "amber" and reason.kind not in _OF_A_USABLE_MODEL


def _large_residuals(facts: Facts) -> list[str]:
    """Balances that an error of wiring leaves open."""
    large = {j: share for j, share in facts.unexplained.items() if share > LARGE}
    return [_leaves(j, share) for j, share in large.items()]


def suspects_wiring(facts: Facts) -> bool:
    """Whether other mappings of the channels are worth a try."""
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


def verdict_on(
    model: ChainModel,
    balances: Mapping[int, float],
    found: Sequence[str],
    free: FreeRuns | None = None,
    bounds: Bounds | None = None,
    *,
    known_masses: Iterable[int] = (),
    doubts: Sequence[str] = (),
    faults: Mapping[str, bool] | None = None,
    wiring: Callable[[], str] | None = None,
) -> Verdict:
    """The verdict on a fitted model.

    Parameters
    ----------
    model : ChainModel
    balances : mapping of int to float
        Percent NRMSE of the balance of each DOF.
    found : sequence of str
        What the model holds beside linear storeys, in words.
    free : FreeRuns, optional
    bounds : mapping of str to (float, float), optional
        95 % intervals by parameter (``"m1"``, ``"storey 2: s"``).
    known_masses : iterable of int
        DOFs whose mass was given.
    doubts : sequence of str
        What else is doubtful.
    faults : mapping of str to bool, optional
        As of :func:`suspect_channels`.
    wiring : callable, optional
        See :func:`verdict_after_search`.
    """
    facts = replace(
        facts_of_model(model, dict(bounds or {}), free, set(known_masses)),
        unexplained=balances,
        holds=tuple(found),
        channel_faults=faults or {},
        doubts=tuple(doubts),
    )
    return verdict_after_search(facts, wiring)


def as_sentence(text: str) -> str:
    """Words with a capital and a full stop."""
    text = text.strip().rstrip(".")
    return f"{text[:1].upper()}{text[1:]}." if text else ""
