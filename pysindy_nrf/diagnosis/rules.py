"""Rules of the verdict: what speaks against a model.

Each rule looks at one kind of fact and returns the reasons that follow from it, none
where nothing does. A new rule is a function here and a line in ``RULES``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from .effects import (
    Effect,
    as_sentence,
    capitalised,
    law_at_site,
    not_told_apart,
    plain_name,
)
from .facts import Alternative, Facts, FreeRunFacts, LeftOver
from .open_alternatives import (
    FAR_BETTER_FIT,
    MATERIAL,
    OpenAlternatives,
    matters,
)
from .wiring import LARGE, OPEN

# Share of an effect, beyond what noise leaves, up to which its law explains it. Right
# names of benchmarks/discrepancy_battery.py leave less.
MAX_UNEXPLAINED = 0.05
# Percent of the measured motion by which a free run may miss it.
ASTRAY = 20.0
# Percent of the measured motion by which a free run may miss it and still be as close
# as sensors measure. Chosen on clean tests of benchmarks/verdicts.py with seed 0:
# accelerations alone, sampled at 200 Hz, leave right models 3.4 and 4.4 %.
GOOD_RUN = 5.0
# Percent from which on a free run has nothing to do with the measured motion: half of
# its energy is then missed.
DIVERGED = 70.0
# Percent from which on a size says nothing more.
BEYOND_NUMBERS = 1e3
# Percent of a force from which on all of it is unexplained.
ALL = 100.0
# Times what noise leaves from which on a residual is none, and the percent of the force
# from which on it is worth a word. Four draws of noise scatter by a third at most.
ABOVE_NOISE = 3.0
NOTICED = 5.0
# Share of a measured channel that a free run may miss beyond its noise, where some
# floor has no sensor. Zeros of sensors that are off by 1 % of the rms leave up to 1 %
# and move no mass. A gain of 6 %, or 3 % of the motion of another floor, leaves 2 to
# 6 % and moves masses by 1 to 6 %, beyond their intervals (four frames of four floors,
# two or three accelerometers, up to 0.5 % of noise).
MISSED = 0.01
# Relative change of a parameter beyond which its size says nothing more.
BEYOND_MEANING = 10.0
# Alternatives that are named, those that leave least.
MAX_ALTERNATIVES = 3
# Factor from which on one free run is worse than another.
WORSE_FREE_RUN = 1.1

Kind = Literal[
    "unexplained",  # a balance keeps a part of its force
    "residual",  # what is left is far above noise
    "mass",  # no structure has it
    "stiffness",  # negative
    "interval",  # the data do not determine a mass or a stiffness
    "shape",  # a shape parameter ended where its search ends
    "drift",  # noise hides the drift of a storey
    "ambiguity",  # another structure or another channel explains the data as well
    "alternative",  # another structure or another channel explains the data better
    "undefined",  # an error has no value
    "free run",  # the model alone leaves the measured motion
    "sensitivity",  # errors of the parameters lead the free run astray
    "damping",  # a mode grows by itself
    "comparison",  # another model predicts the motion better
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


# -- equations of motion and parameters ----------------------------------------


def unexplained_equations(facts: Facts) -> list[Reason]:
    """Equations of motion of which the model leaves more than noise does.

    Where it is not known what noise leaves, a free run that follows shows that nothing
    else is left.
    """
    reasons = []
    for j, percent in facts.unexplained.items():
        place = f"dof {j}"
        of_noise = percent if _follows(facts.free_run) else 0.0
        beyond = facts.beyond_noise.get(j, percent - of_noise)
        if beyond > OPEN:
            message = open_balance(j, percent)
            reasons.append(Reason("unexplained", "red", message, place, percent))
        elif beyond > LARGE and not _is_missing(facts.left_over.get(j)):
            message = (
                f"{percent:.3g} % of the force in the balance of DOF {j} is"
                " unexplained: a law is missing, or the channels are noisy."
            )
            reasons.append(Reason("unexplained", "amber", message, place, percent))
    return reasons


def _follows(run: FreeRunFacts) -> bool:
    """Whether the model alone follows the motion as closely as sensors measure it.

    What its equations leave is then noise of the measured motion, which a free run does
    not read.
    """
    return run.error < GOOD_RUN


def noisy_equations(facts: Facts) -> list[Reason]:
    """Masses and equations in which a law is missing, if it is not noise."""
    if _follows(facts.free_run) or _leaves_mostly_noise(facts):
        return []
    texts = [text for text in facts.noise_or_law if not _repeats_a_fault(text, facts)]
    return [Reason("other", "amber", text) for text in texts]


def _leaves_mostly_noise(facts: Facts) -> bool:
    """Whether noise explains most of the power that is left in every equation."""
    if not facts.left_over or set(facts.left_over) < set(facts.unexplained):
        return False
    return all(each.rms**2 < 2 * each.noise**2 for each in facts.left_over.values())


def residuals_above_noise(facts: Facts) -> list[Reason]:
    """Residuals that no effect explains, though noise does not either."""
    remedy = "a law is missing there, or a force: search for it by close_loop."
    if facts.searched:
        remedy = "no effect of the catalogue explains them."
    reasons, unit = [], facts.units.force
    for j, left_over in facts.left_over.items():
        if _is_missing(left_over):
            band = _in_band(left_over)
            message = (
                f"{left_over.rms:.3g} {unit} rms are missing at DOF {j}{band}, where"
                f" noise leaves {left_over.noise:.2g} {unit}; {remedy}"
            )
            reasons.append(
                Reason("residual", "amber", message, f"dof {j}", left_over.rms)
            )
    return reasons


def _is_missing(left_over: LeftOver | None) -> bool:
    """Whether far more is left of an equation than noise leaves, and it is felt."""
    if left_over is None:
        return False
    return left_over.rms > ABOVE_NOISE * left_over.noise and left_over.percent > NOTICED


def missed_channels(facts: Facts) -> list[Reason]:
    """A measured channel that the free run misses beyond its noise."""
    if facts.channel_error <= MISSED:
        return []
    message = missed_channel(facts.channel_error, facts.searched)
    size = 100 * facts.channel_error
    severity: Severity = "red" if size > OPEN else "amber"
    return [Reason("residual", severity, message, "measured channels", size)]


def missed_channel(share: float, searched: bool = False) -> str:
    """A sentence on what a free run misses of a channel beyond its noise."""
    remedy = "Search for the missing law (close_loop)."
    if searched:
        remedy = "No effect of the catalogue explains it."
    return (
        f"The model misses {100 * share:.2g} % of a measured channel beyond its noise."
        " Intervals of motions contain this error, intervals of parameters do not."
        f" {remedy}"
    )


def _in_band(left_over: LeftOver) -> str:
    if left_over.band is None:
        return ""
    return f" from {left_over.band[0]:.3g} to {left_over.band[1]:.3g} Hz"


def open_balance(dof: int, percent: float) -> str:
    """A sentence on an equation of motion that does not close."""
    share = f"{percent:.3g} %" if percent < ALL else "all"
    return f"The balance of DOF {dof} leaves {share} of its force unexplained."


def impossible_masses(facts: Facts) -> list[Reason]:
    """Masses that no structure has."""
    if not facts.impossible_masses:
        return []
    masses = []
    for j, mass in facts.impossible_masses.items():
        masses.append(f"m{j} = {mass:.4g} {facts.units.mass}")
    places = [f"m{j}" for j in facts.impossible_masses]
    message = f"{', '.join(masses)}: no structure has a mass that is not positive."
    smallest = min(facts.impossible_masses.values())
    return [Reason("mass", "red", message, ", ".join(places), smallest)]


def negative_stiffness(facts: Facts) -> list[Reason]:
    """Storeys, links and ties that push away from their rest."""
    if not facts.negative_stiffness:
        return []
    places = ", ".join(facts.negative_stiffness)
    message = f"The stiffness of {places} came out negative."
    return [Reason("stiffness", "red", message, places)]


def undetermined_masses(facts: Facts) -> list[Reason]:
    """Masses whose interval holds zero."""
    names = []
    for name, (low, high) in facts.intervals.items():
        if name.startswith("m") and low <= 0 < high:
            names.append(name)
    if not names:
        return []
    masses = ", ".join(names)
    message = f"The data do not determine {masses}: the interval contains zero."
    return [Reason("interval", "red", message, masses)]


def wide_intervals(facts: Facts) -> list[Reason]:
    """Masses and stiffnesses that the data determine only roughly."""
    reasons = []
    for name, (low, high) in facts.intervals.items():
        middle = abs(high + low) / 2
        half_width = (high - low) / 2
        if not _is_mass_or_stiffness(name, facts) or low <= 0 < high:
            continue
        if half_width > MATERIAL * middle:
            message = (
                f"The data determine {name} to {100 * half_width / middle:.2g} % only"
                f" ({low:.3g} to {high:.3g}). Measure longer, or excite more modes."
            )
            reasons.append(Reason("interval", "amber", message, name, half_width))
    return reasons


def _is_mass_or_stiffness(name: str, facts: Facts) -> bool:
    """Whether a parameter is a mass, or the stiffness of a storey without curvature."""
    site, _, term = name.partition(": ")
    if not term:
        return True
    in_series = any(other.startswith(f"{site}: s^") for other in facts.intervals)
    return site.startswith("storey") and term == "s" and not in_series


def shapes_at_ends(facts: Facts) -> list[Reason]:
    """Shape parameters that ended where their search ends."""
    reasons = []
    for end in facts.shapes_at_ends:
        unit = f" {facts.units.of(end.unit)}" if end.unit != "1" else ""
        value = f"{end.value:.3g}{unit}"
        message = (
            f"{end.shape} of {plain_name(end.law)} in {end.site} is {value}, the"
            f" {end.end} end of its range: the data may want a value beyond it, or"
            " another law. Intervals of the coefficients hold for this value only."
        )
        reasons.append(Reason("shape", "amber", message, end.site, end.value))
    return reasons


def unseen_drifts(facts: Facts) -> list[Reason]:
    """Floors that move as one, within the noise of the sensors."""
    severity: Severity = "amber" if _follows(facts.free_run) else "red"
    reasons = []
    for storey, ratio in facts.unseen_drifts.items():
        below = f"DOF {storey - 1}" if storey > 1 else "the base"
        message = (
            f"DOF {storey} and {below} move as one: the noise of their sensors is"
            f" {ratio:.2g} times the drift of storey {storey}. Take them as one floor,"
            " or measure the drift itself."
        )
        reasons.append(Reason("drift", severity, message, f"storey {storey}", ratio))
    return reasons


def open_alternatives(facts: Facts) -> list[Reason]:
    """Other structures and channels that the data do not exclude."""
    among = OpenAlternatives.among(facts.alternatives, facts.remaining)
    reasons = []
    for alternative in among.alternatives:
        is_better = alternative.description in among.better
        message = _of_alternative(alternative, is_better)
        message += _of_intervals(alternative, facts)
        place, size = alternative.place, alternative.change
        kind: Kind = "alternative" if is_better else "ambiguity"
        severity: Severity = "amber"
        if (
            is_better
            and matters(alternative)
            and alternative.residual_share < FAR_BETTER_FIT
        ):
            severity = "red"
        reasons.append(Reason(kind, severity, message, place, size))
    return reasons[:MAX_ALTERNATIVES]


def _of_alternative(alternative: Alternative, is_better: bool) -> str:
    effect = _change_of_parameter(alternative)
    name = capitalised(alternative.description)
    if is_better:
        share = f"{100 * alternative.residual_share:.2g} %"
        return (
            f"{name} leaves {share} of the residual; {effect}. Declare it, or check the"
            " structure and the sensors there."
        )
    return (
        f"{name} would explain these data as well; {effect}. Excite more modes, or rule"
        " it out on the structure."
    )


def _of_intervals(alternative: Alternative, facts: Facts) -> str:
    """What an alternative does to intervals, as a further sentence."""
    withheld: list[str] = []
    widened: list[str] = []
    for interval in facts.ambiguous_intervals:
        if alternative.description in interval.by:
            names = withheld if interval.withheld else widened
            names.append(interval.parameter)
    if withheld:
        return f" Intervals of {', '.join(withheld)} are withheld for it."
    if widened:
        return f" Intervals of {', '.join(widened)} hold it."
    return ""


def _change_of_parameter(alternative: Alternative) -> str:
    """What an alternative does to the parameter that it moves most."""
    change = abs(alternative.change)
    if change < alternative.wider:
        width = f"{100 * alternative.wider:.2g} %"
        return f"{alternative.parameter} is then known to {width} only"
    side = "larger" if alternative.change > 0 else "smaller"
    if change > BEYOND_MEANING:
        return f"{alternative.parameter} is then many times as large"
    return f"{alternative.parameter} is then {100 * change:.2g} % {side}"


def undefined_errors(facts: Facts) -> list[Reason]:
    """No equation of motion whose error has a value."""
    sizes = np.array(list(facts.unexplained.values()), dtype=float)
    if not sizes.size or np.isfinite(sizes).any():
        return []
    message = "What the equations of motion leave unexplained has no value."
    return [Reason("undefined", "red", message)]


# -- the model alone -----------------------------------------------------------


def diverging_free_run(facts: Facts) -> list[Reason]:
    """A model that, alone, has nothing to do with the measured motion."""
    run = facts.free_run
    if facts.impossible_masses:
        return []
    if run.diverges:
        message = run.why_not or "The free run diverges."
        return [Reason("free run", "red", message, size=run.error)]
    if not _leaves_the_motion(facts):
        return []

    message = "The free run diverges."
    if run.error < BEYOND_NUMBERS:
        message = f"The free run diverges: it misses the motion by {run.error:.3g} %."
    return [Reason("free run", "red", message, size=run.error)]


def _leaves_the_motion(facts: Facts) -> bool:
    """Whether a run is lost, though a spring holds the chain, from its start on.

    Where errors of the parameters lead as far away, no model of the structure follows;
    but a mode that grows makes every run sensitive, and no structure has one.
    """
    run = facts.free_run
    may_be_right = is_sensitive(run) and facts.growing_mode is None
    follows_at_first = run.over_periods < ASTRAY
    if may_be_right or run.floats or follows_at_first:
        return False
    return run.error > DIVERGED


def is_sensitive(run: FreeRunFacts) -> bool:
    """Whether errors of the parameters alone move a free run beyond use."""
    return run.spread > ASTRAY


def sensitive_free_run(facts: Facts) -> list[Reason]:
    """A free run that cannot be predicted sample by sample with these parameters."""
    run = facts.free_run
    if not is_sensitive(run):
        return []
    size = f"by {run.spread:.3g} %"
    if run.spread >= BEYOND_NUMBERS:
        size = "beyond numbers"
    message = (
        "The free run is sensitive: one standard error of the parameters moves it"
        f" {size}. Its course cannot be predicted sample by sample, though the"
        " parameters may be right."
    )
    return [Reason("sensitivity", "amber", message, size=run.spread)]


def diverging_by_default(facts: Facts) -> list[Reason]:
    """A free run that the default integrator could not finish for its size.

    Where a mode grows, the model itself does so.
    """
    run = facts.free_run
    if not run.diverges_by_default or run.diverges:
        return []
    severity: Severity = "amber" if facts.growing_mode is None else "red"
    size = "" if run.error >= BEYOND_NUMBERS else f" by {run.error:.3g} %"
    message = (
        "The model alone grows beyond a hundred times the measured motion by the"
        f" default method of simulate. Newmark's method, which misses the motion{size},"
        " does not resolve what grows between samples."
    )
    return [Reason("free run", severity, message, size=run.error)]


def growing_mode(facts: Facts) -> list[Reason]:
    """A mode that grows by itself."""
    mode = facts.growing_mode
    if mode is None:
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
    error = judged_error(facts.free_run)
    if not np.isfinite(error) or error <= ASTRAY or is_sensitive(facts.free_run):
        return []
    message = (
        f"The free run misses the measured motion by {error:.3g} %. A model can be"
        " right and still drift (a stage without a spring, a yielding storey, a record"
        " that starts in motion); see its figure."
    )
    return [Reason("free run", "amber", message, size=error)]


def judged_error(run: FreeRunFacts) -> float:
    """Error of the free run, percent: over some periods where nothing holds it."""
    drifts_later = run.floats and run.error > ASTRAY and run.over_periods < run.error
    return run.over_periods if drifts_later else run.error


def better_models(facts: Facts) -> list[Reason]:
    """Another model whose free run is better, where that of this model is not good.

    Below the errors of sensors a smaller error says nothing.
    """
    reasons = []
    for other in facts.other_models:
        of_this = other.free_run_of_this
        if of_this > GOOD_RUN and of_this > WORSE_FREE_RUN * other.free_run:
            message = (
                f"{other.name} predicts data left out better: its free run misses"
                f" {other.free_run:.3g} % of the motion, that of this model"
                f" {_percent(of_this)}."
            )
            reasons.append(Reason("comparison", "amber", message, size=other.free_run))
    return reasons


def _percent(error: float) -> str:
    return f"{error:.3g} %" if np.isfinite(error) else "all of it"


# -- channels, records and the search ------------------------------------------


def nothing_claimed(facts: Facts) -> list[Reason]:
    """A search that claims nothing, of a model that does not follow the motion.

    Where it follows, the search had too little to judge by, such as one blow a floor.
    """
    if not facts.nothing_claimed or _follows(facts.free_run):
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
        if not note.is_fault or _repeats_a_fault(note.message, facts):
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


# -- effects that a search added ----------------------------------------------


def doubtful_effects(facts: Facts) -> list[Reason]:
    """Effects that are not confirmed, not sure by name, or bought with a free run."""
    reasons = []
    for effect in facts.effects:
        for message in _doubts_of_effect(effect):
            reasons.append(Reason("effect", "amber", message, effect.site))
    return reasons


def _doubts_of_effect(effect: Effect) -> list[str]:
    """What is doubtful about one effect."""
    if not effect.confirmed:
        return [_not_confirmed(effect)]
    return [
        *_only_the_closest(effect),
        *not_told_apart(effect),
        *_worse_free_run(effect),
    ]


def _not_confirmed(effect: Effect) -> str:
    change = f"{effect.error_before:.3g} to {effect.error_after:.3g} %"
    return (
        f"{capitalised(law_at_site(effect))} is NOT CONFIRMED: the held-out error goes"
        f" from {change}. The model does not hold it."
    )


def _only_the_closest(effect: Effect) -> list[str]:
    """A name that leaves a part of the effect, though the data name no other."""
    explains = effect.carries and effect.remainder <= MAX_UNEXPLAINED
    if effect.sure or explains or effect.alternatives or effect.laws_beside:
        return []
    return [
        f"{capitalised(law_at_site(effect))} is only the closest law:"
        f" {100 * effect.remainder:.0f} % of the effect stays unexplained; the error"
        f" falls by {effect.reduction:.2g} dB with a standard error of"
        f" {effect.reduction_error:.2g}."
    ]


def _worse_free_run(effect: Effect) -> list[str]:
    """A free run that the effect makes worse."""
    if not effect.free_run_after > WORSE_FREE_RUN * effect.free_run_before:
        return []
    change = f"{effect.free_run_before:.3g} to {effect.free_run_after:.3g} %"
    return [
        f"With {law_at_site(effect)} the held-out free run is worse than before"
        f" ({change}), though the balances close better."
    ]


# -- evidence ------------------------------------------------------------------


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
        "What noise alone would leave is not known here: an unmeasured force cannot be"
        " distinguished from noise."
    )
    return [Reason("evidence", "amber", message)]


# In the order in which their reasons are listed.
RULES: tuple[Callable[[Facts], list[Reason]], ...] = (
    unexplained_equations,
    residuals_above_noise,
    missed_channels,
    impossible_masses,
    negative_stiffness,
    undetermined_masses,
    wide_intervals,
    shapes_at_ends,
    unseen_drifts,
    open_alternatives,
    undefined_errors,
    diverging_free_run,
    diverging_by_default,
    growing_mode,
    sensitive_free_run,
    straying_free_run,
    better_models,
    nothing_claimed,
    wiring,
    channel_faults,
    quality_notes,
    noisy_equations,
    other_doubts,
    doubtful_effects,
    unanswered_questions,
    unknown_noise,
)
