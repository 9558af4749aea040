"""What the evidence concludes, as types, and the sentences that are made of them and of
the loop's results.

All verdicts become words here, and nothing reads them back.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
import pandas as pd

from ..chain.sites import Site
from .constants import TENTH


class ResidualKind(Enum):
    """What the residual of one balance or storey holds; the values are the words."""

    NOISE = "noise"
    LINEAR = "linear effect missing"
    NONLINEAR = "nonlinear effect missing"
    UNMEASURED = "unmeasured force or unknown noise"


class Location(Enum):
    """What the signs of the balances say."""

    NOTHING = "nothing to locate"  # noise or rounding explains all balances
    EXPLAINS = "explains"
    ONE_BALANCE = "one balance"  # all sites have one pattern of signs


class Dependence(Enum):
    """What a missing force depends on; the values name the rows of the table of
    shares.
    """

    CONSTANT = "constant"
    LINEAR = "linear"
    LINE = "line"
    DRIFT = "s alone"
    RATE = "v alone"
    COVARIATE = "covariate"
    TIME = "time"
    SURFACE = "s and v"
    PATH = "path"
    NOTHING = "nothing tried"


class Feature(Enum):
    """Marks of the shape of a missing force."""

    JUMP = "jump at v = 0"
    KINK = "kink"
    HARDENING = "hardening"
    SOFTENING = "softening"


@dataclass(frozen=True)
class Obstacle:
    """Why one question to the residual has no answer; ``expected`` if nothing is
    missing.
    """

    reason: str
    expected: bool = False


QUESTIONS = ("detection", "localisation", "characterisation")
_DEPENDENCE = {
    Dependence.CONSTANT: "Is constant: an offset or a dead load",
    Dependence.LINEAR: "Is linear in s, v and a: a wrong stiffness, damping or mass",
    Dependence.LINE: (
        "Is a spectral line at {found.frequency:.4g} Hz: an unmeasured harmonic force"
    ),
    Dependence.COVARIATE: "Is modulated by {found.covariate}",
    Dependence.TIME: (
        "Changes in time: a drift or step of stiffness, damping or friction"
    ),
    Dependence.PATH: (
        "Depends on the path (memory adds {found.memory:.0f} points to any function of"
        " s and v), {parity}: hysteresis-like"
    ),
    Dependence.DRIFT: "Depends on s alone, {parity}, smooth{marks}: a nonlinear spring",
    Dependence.RATE: "Depends on v alone, {parity}, smooth: nonlinear damping",
    Dependence.SURFACE: (
        "Depends on s and v, {parity}, smooth: a force on the surface R(s, v)"
    ),
}


def not_possible(question: str, evidence: Any) -> str:
    """The sentence for a question without an answer."""
    why = evidence.not_possible.get(question, Obstacle("nothing was tried"))
    return f"{question.capitalize()} is not possible because {why.reason}."


def detection(evidence: Any) -> str:
    """Whether the residual is noise."""
    table = evidence.detection.verdicts
    ratio = table["floor ratio"].max()
    times = (
        f"at most {ratio:.2g} times the noise floor"
        if np.isfinite(ratio)
        else "the noise is not known"
    )
    if evidence.detection.is_noise:
        but = (
            "; the gain, which looks at each band, sees more" if evidence.chosen else ""
        )
        return f"Nothing but noise is left in any balance ({times}){but}."
    kinds = table[table["verdict"] != ResidualKind.NOISE]["verdict"]
    said = [
        f"{kind.value} in {_listed(kinds.index[kinds == kind])}"
        for kind in dict.fromkeys(kinds)
    ]
    text = f"The residual is not noise: {'; '.join(said)} ({times})."
    told = table[table["verdict"].isin([ResidualKind.LINEAR, ResidualKind.NONLINEAR])]
    if not len(told):
        return text
    most = told.loc[told["nonlinear share"].idxmax()]
    return (
        f"{text} In {_listed([most.name])} drifts, rates and inputs explain"
        f" {100 * most['linear share']:.0f} % of it linearly, and nonlinear laws of its"
        f" own motion {100 * most['nonlinear share']:.0f} % of the rest."
    )


def _listed(places: Sequence[str]) -> str:
    """Balances and storeys in one phrase."""
    phrases = {"the balance of DOF": "dof ", "storey": "storey "}
    numbers = {
        phrase: [p.removeprefix(kind) for p in places if p.startswith(kind)]
        for phrase, kind in phrases.items()
    }
    return " and ".join(
        f"{phrase} {', '.join(found)}" for phrase, found in numbers.items() if found
    )


def localisation(evidence: Any) -> str:
    """Where the missing force acts, and what the loop chose."""
    found = evidence.localisation
    if found.verdict == Location.NOTHING:
        ratio = found.over_floor
        much = (
            f"{ratio:.2g} times what noise leaves"
            if np.isfinite(ratio)
            else "no more than any measurement does"
        )
        return f"All balances together leave {much}: nothing to locate."
    said = _located(found.table)
    alone = found.verdict == Location.ONE_BALANCE
    said[0] = (
        "One balance: the signs say nothing"
        if alone
        else f"The signs across the balances point to {said[0]}"
    )
    text = "; ".join(said)
    share = found.table["share"].get(evidence.chosen, np.nan)
    signs = f", whose signs explain {share:.0f} %" if np.isfinite(share) else ""
    return (
        f"{text}. The loop chose {evidence.chosen}{signs}."
        if evidence.chosen
        else f"{text}."
    )


def _located(table: pd.DataFrame) -> list[str]:
    """What the best site explains, and which others come near it."""
    first, rest = table.iloc[0], table.iloc[1:]
    within = (
        f"{first['low']:.0f} to {first['high']:.0f}, "
        if np.isfinite(first["low"])
        else ""
    )
    said = [
        f"{first.name}: explains {first['share']:.0f} % ({within}balances"
        f" {first['balances']})"
    ]
    if np.isfinite(own := first["own"]):
        of_kind = {
            "link": f"its own motion explains {own:.0f} % of the force",
            "sensor": f"a delay explains {own:.0f} %",
            "dof": f"{own:.0f} % follows no motion there",
        }
        said.append(of_kind[Site(first.name).kind])
    alike = rest["pattern"] == first["pattern"]
    if len(others := rest[~alike & rest["share"].notna()]):
        other = others.iloc[0]
        said.append(
            f"{'hardly told from' if other['near'] else 'next'} {other.name}"
            f" ({other['share']:.0f} %)"
        )
    if alike.any():
        said.append(f"the same pattern as {', '.join(map(str, rest.index[alike]))}")
    return said


def characterisation(evidence: Any) -> str:
    """What the missing force depends on."""
    said = characterised(evidence.characterisation)
    return f"The force missing at {evidence.site} {said[0].lower()}{said[1:]}"


def characterised(found: Any) -> str:
    """What a force depends on, from its :class:`Characterisation`."""
    quiet = ""
    if found.noise is not None and found.rms > 0:
        quiet = f", noise is {min(100.0, 100 * (found.noise / found.rms) ** 2):.0f} %"
    if found.dependence == Dependence.NOTHING:
        most = (
            f"at most {max(float(found.shares['share'].max()), 0.0):.0f} %"
            f" explained{quiet}"
        )
        return (
            f"Depends on nothing that was tried ({most}): noise, or a force from"
            " outside."
        )
    share = float(found.shares.loc[found.shares["chosen"], "share"].iloc[0])
    return f"{_kind(found)}; {share:.0f} % explained on data left out{quiet}."


def _kind(found: Any) -> str:
    """What a force depends on and what it is like, without numbers of the fit."""
    parity = (
        "odd"
        if found.odd > 1 - TENTH
        else "even"
        if found.odd < TENTH
        else "neither odd nor even"
    )
    if Feature.JUMP in found.features:
        return f"Depends on v alone, {parity}, with a jump at v = 0: friction-like"
    if Feature.KINK in found.features:
        contact = (
            "gap- or contact-like"
            if parity in ("odd", "even")
            else "contact on one side"
        )
        return f"Depends on s alone, {parity}, with a kink: {contact}"
    marks = (
        f" ({', '.join(mark.value for mark in found.features)})"
        if found.features
        else ""
    )
    return _DEPENDENCE[found.dependence].format(found=found, parity=parity, marks=marks)


def contradictions(messages: Sequence[str]) -> str:
    """Channels of one DOF that do not show one motion."""
    said = "; ".join(dict.fromkeys(messages))
    return f"Channels contradict each other, and the fusion made the best of it: {said}"


def band(found: tuple[float | None, float | None]) -> str:
    """A frequency band."""
    low, high = found
    return (
        "full"
        if low is None and high is None
        else f"{low or 0:.3g}-{np.inf if high is None else high:.3g} Hz"
    )


def acceptance(step: Any) -> str:
    """Why an effect was accepted, and whether held-out data confirm it."""
    changes = (
        f"; it changes {100 * step.share:.0f} % of the force at its site"
        if np.isfinite(step.share)
        else ""
    )
    return (
        f"lowers the residual on folds left out of the fit by {step.gain:.2g} dB"
        f" (standard error {step.gain_error:.2g}, {step.gain_least:.2g} without the"
        f" fold that speaks most for it){changes}"
    )


def confirmation(step: Any) -> str:
    """What the held-out data say of an effect."""
    change = (
        f"held-out balance error {step.error_before:.3g} to {step.error_after:.3g} %"
    )
    small = (
        ", but the gain is too small" if step.error_after < step.error_before else ""
    )
    return (
        change
        if step.confirmed
        else f"{change}{small}: NOT CONFIRMED, and the model does not hold it"
    )


def best_refused(last: Any) -> str:
    """Why no further effect was added."""
    if last is None:
        return "no law of the catalogue lowers the error at any site"
    finding, gain = last
    said = (
        "no further effect is there and matters: the best candidate,"
        f" {finding.proposal.name}, gains {gain.value:.2g} dB (standard error"
        f" {gain.error:.2g}, {gain.least:.2g} without the fold that speaks most for it)"
    )
    if finding.chance is not None and np.isfinite(finding.chance):
        return (
            f"{said}; where nothing is missing the search gains {finding.chance:.2g} dB"
            " by chance"
        )
    if finding.chance is not None:
        return f"{said}; the model has no free run, which would tell what chance gains"
    beyond = finding.beyond_errors
    if beyond is None or beyond.value > 0.5 * gain.value:
        return said
    return (
        f"{said}; errors of the channels within their tolerances leave"
        f" {max(beyond.value, 0.0):.2g} dB of it"
    )


def not_in_catalogue(found: pd.DataFrame) -> str:
    """What general laws would still explain of what the model leaves."""
    said = [
        f"{law} at {site} would gain {gain:.2g} dB more"
        for (site, law), gain in found["gain (dB)"].items()
    ]
    return f"What is left is not noise alone: {', '.join(said)} than the model"


MEANS_LEFT_IN = (
    "The table leaves means in, so a row may lie above the one before it; steps were"
    " confirmed without"
)


def hopeless(left: np.ndarray) -> str:
    """A balance of which the model explains next to nothing: a claim is no better than
    its worst balance.
    """
    worst = int(np.nanargmax(left)) + 1
    return (
        f"the best model leaves {left[worst - 1]:.0f} % of the balance of DOF {worst}"
    )


def negative_masses(masses: np.ndarray) -> str:
    """Masses that no structure has."""
    bad = ", ".join(f"m{j} = {m:.3g} kg" for j, m in enumerate(masses, 1) if m <= 0)
    return f"masses came out not positive ({bad})"


def cancelled_masses(dofs: Sequence[int]) -> str:
    """Effects that take away a declared mass."""
    return f"an effect cancels the declared mass of DOF {', '.join(map(str, dofs))}"
