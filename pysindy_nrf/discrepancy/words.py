"""What the evidence concludes, as types; :mod:`pysindy_nrf.discrepancy.words` makes the sentences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
import pandas as pd

from ..mechanics.sites import Site


class ResidualKind(Enum):
    """What the residual of one balance or storey holds."""

    NOISE = "noise"
    LINEAR = "linear"
    NONLINEAR = "nonlinear"
    UNMEASURED = "unmeasured"  # an unmeasured force or coloured noise


class Location(Enum):
    """What the signs of the balances say of one site."""

    NOTHING = "nothing to locate"  # noise or rounding explains all balances
    EXPLAINS = "explains"
    ONE_BALANCE = "one balance"  # every site explains the same
    UNSEEN = "unseen"  # the site touches no known balance
    UNKNOWN = "unknown"  # nothing is left to be explained


class Agreement(Enum):
    """How localisation and the site that the loop chose agree."""

    NONE = "none"  # nothing was chosen or located
    SIGNLESS = "signless"  # all sites have one pattern of signs
    SAME = "same"
    UNJUDGED = "unjudged"
    SAME_SIGNS = "same signs"
    LATER = "later"  # the located site follows in a later step
    NEAR = "near"
    DISAGREES = "disagrees"


class Dependence(Enum):
    """What a missing force depends on; the values name the rows of the table of shares."""

    CONSTANT = "constant"
    LINEAR = "linear"
    LINE = "line"
    DELAY = "delay"
    DRIFT = "s alone"
    RATE = "v alone"
    COVARIATE = "covariate"
    TIME = "time"
    AMPLITUDE = "amplitude"
    SURFACE = "s and v"
    PATH = "path"
    NOTHING = "nothing tried"


class Feature(Enum):
    """Marks of the shape of a missing force."""

    JUMP = "jump at v = 0"
    KINK = "kink"
    HARDENING = "hardening"
    SOFTENING = "softening"


class Parity(Enum):
    """Symmetry of a force under (s, v) -> (-s, -v)."""

    ODD = "odd"
    EVEN = "even"
    NEITHER = "neither"

    @classmethod
    def of(cls, odd: float) -> Parity:
        """Parity from the share of the odd part, 0 to 1."""
        return cls.ODD if odd > 0.9 else cls.EVEN if odd < 0.1 else cls.NEITHER


class Why(Enum):
    """Why one question to the residual has no answer."""

    UNTRIED = "untried"
    ERROR = "error"
    NO_SITE = "no site"
    ONLY_NOISE = "only noise"
    NOTHING_LOCATED = "nothing located"


@dataclass(frozen=True)
class Obstacle:
    """Why one question to the residual has no answer; ``error`` is the text of an exception."""

    why: Why
    error: str = ""

    @property
    def expected(self) -> bool:
        """Whether there is no answer because nothing is missing."""
        return self.why in (Why.ONLY_NOISE, Why.NOTHING_LOCATED)


@dataclass(frozen=True)
class Contradiction:
    """Two channels of one DOF that do not show one motion; ``message`` is that of the alignment."""

    channel: str
    reference: str
    message: str


# What the tests of detection correlate, x being a signal and e the residual.
TESTS = {
    "phi_ee": "the residual with its own past",
    "phi_xe": "the residual with {x}",
    "phi_x2e": "the residual with the square of {x}",
    "phi_x3e": "the residual with the cube of {x}",
    "phi_|x||e|": "the size of the residual with the size of {x}",
    "phi_e(ex)": "the residual with its own product with {x}",
}
_KINDS = {
    ResidualKind.NOISE: "noise",
    ResidualKind.LINEAR: "linear effect missing",
    ResidualKind.NONLINEAR: "nonlinear effect missing",
    ResidualKind.UNMEASURED: "unmeasured force or coloured noise",
}
_PARITY = {Parity.ODD: "odd", Parity.EVEN: "even", Parity.NEITHER: "neither odd nor even"}
_DEPENDENCE = {
    Dependence.CONSTANT: "Is constant: an offset or a dead load",
    Dependence.LINEAR: "Is linear in s, v and a: a wrong stiffness, damping or mass",
    Dependence.TIME: "Changes in time: a drift or step of stiffness, damping or friction",
    Dependence.AMPLITUDE: "Depends on the amplitude of vibration",
    Dependence.DELAY: "Follows the derivative of a channel: a delay between channels",
}
_SMOOTH = {
    Dependence.DRIFT: "a nonlinear spring",
    Dependence.RATE: "nonlinear damping",
    Dependence.SURFACE: "a force on the surface R(s, v)",
}
_WHY = {
    Why.UNTRIED: "nothing was tried",
    Why.ONLY_NOISE: "nothing but noise is left",
    Why.NOTHING_LOCATED: "the residual is at the noise floor",
}


def obstacle(one: Obstacle) -> str:
    """A reason, as the end of a sentence."""
    if one.why == Why.NO_SITE:
        return f"the site is not known: {one.error}"
    return _WHY.get(one.why, one.error).rstrip(".") or _WHY[Why.UNTRIED]


def not_possible(question: str, evidence: Any) -> str:
    """The sentence for a question without an answer."""
    why = evidence.not_possible.get(question, Obstacle(Why.UNTRIED))
    return f"{question.capitalize()} is not possible because {obstacle(why)}."


# -- is it noise ------------------------------------------------------------------------------------


def of_detection(found: Any, kinds: dict[ResidualKind, list[str]]) -> str:
    """Every verdict of a :class:`Detection` with the test behind it; ``kinds`` holds the tests of each."""
    said = []
    for where, row in found.verdicts.iterrows():
        kind = row["verdict"]
        text = f"{where}: {_KINDS[kind]}"
        outside = found.tests[(found.tests["where"] == where) & found.tests["outside"]].sort_values(["p", "peak"])
        if kind == ResidualKind.NOISE:
            text += " (traces of structure too small to model)" if len(outside) else ""
        elif len(outside := outside[outside["test"].isin(kinds[kind])]):
            best = outside.iloc[0]
            text += f" ({best['test']}, {best['signal']}: {best['peak']:.2f}, band {best['band']:.2f})"
        if np.isfinite(row["floor ratio"]):
            text += f", {row['floor ratio']:.2g} times the noise floor"
        said.append(text)
    return "; ".join(said) + "."


def detection(evidence: Any) -> str:
    """Whether the residual is noise."""
    if evidence.detection is None:
        return not_possible("detection", evidence)
    table = evidence.detection.verdicts
    ratio = table["floor ratio"].max()
    times = f"at most {ratio:.2g} times the noise floor" if np.isfinite(ratio) else "noise taken to be white"
    if evidence.detection.is_noise:
        return f"Nothing but noise is left in any balance ({times})."
    kinds = table[table["verdict"] != ResidualKind.NOISE]["verdict"]
    said = [f"{_KINDS[kind]} in {_listed(kinds.index[kinds == kind])}" for kind in dict.fromkeys(kinds)]
    best = evidence.strongest
    strongest = (
        ""
        if best is None or not best["outside"]
        else f" The strongest correlation is {TESTS[best['test']].format(x=best['signal'])} in "
        f"{_listed([best['where']])}: {best['peak']:.2f}, where noise stays within {best['band']:.2f}."
    )
    return f"The residual is not noise: {'; '.join(said)} ({times}).{strongest}"


def _listed(places: Sequence[str]) -> str:
    """Balances and storeys in one phrase."""
    numbers: dict[str, list[str]] = {"dof": [], "storey": []}
    for place in places:
        kind, number = place.split()
        numbers[kind].append(number)
    phrases = {"dof": "the balance of DOF", "storey": "storey"}
    return " and ".join(f"{phrases[kind]} {', '.join(found)}" for kind, found in numbers.items() if found)


# -- where ------------------------------------------------------------------------------------------


def localisation(evidence: Any) -> str:
    """Where the missing force acts, and whether the chosen site agrees."""
    table = evidence.localisation
    if table is None:
        return not_possible("localisation", evidence)
    first = table.iloc[0]
    if first["verdict"] == Location.NOTHING:
        ratio = first["over floor"]
        much = f"{ratio:.2g} times what noise leaves" if np.isfinite(ratio) else "round-off"
        return f"All balances together leave {much}: nothing to locate."
    said = _located(table)
    if table["share"].dropna().round(6).nunique() <= 1:
        text = f"{said[:1].upper()}{said[1:]}."
    else:
        text = f"The signs across the balances point to {evidence.site}: {said}."
    return f"{text} {_agreement(evidence)}".strip()


def _located(table: pd.DataFrame) -> str:
    """The verdict on the best site, and which others come near it."""
    first, rest = table.iloc[0], table.iloc[1:]
    if first["verdict"] in (Location.UNSEEN, Location.UNKNOWN):
        return "no known balance can tell"
    text = f"explains {first['share']:.0f} % (balances {first['balances']})"
    if first["verdict"] == Location.ONE_BALANCE:
        text = "one balance: the signs say nothing"
    if np.isfinite(own := first["own"]):
        text += {
            "link": f"; its own motion explains {own:.0f} % of the force",
            "sensor": f"; a delay explains {own:.0f} %",
            "dof": f"; {own:.0f} % follows no motion there",
        }[Site(table.index[0]).kind]
    if first["verdict"] == Location.EXPLAINS:
        alike = rest["pattern"] == first["pattern"]
        if len(others := rest[~alike & rest["share"].notna()]):
            other = others.iloc[0]
            told = "hardly told from" if other["near"] else "next"
            text += f"; {told} {other.name} ({other['share']:.0f} %)"
        if alike.any():
            text += f"; the same pattern as {', '.join(map(str, rest.index[alike]))}"
    return text


def _agreement(evidence: Any) -> str:
    """Whether localisation agrees with the site of the effect that was added."""
    chosen, site, table, verdict = evidence.chosen, evidence.site, evidence.localisation, evidence.agreement
    if verdict == Agreement.NONE:
        return ""
    if verdict == Agreement.SIGNLESS:
        return f"The loop chose {chosen} by the error after refitting."
    if verdict == Agreement.SAME:
        return f"The loop chose the same site, {chosen}."
    if verdict == Agreement.UNJUDGED:
        return f"The loop chose {chosen}, which localisation cannot judge."
    if verdict == Agreement.SAME_SIGNS:
        return f"The loop chose {chosen}, which has the same pattern of signs."
    share = table.loc[chosen, "share"]
    if verdict == Agreement.LATER:
        return f"The loop chose {chosen} ({share:.0f} %) first, and {site} in a later step."
    if verdict == Agreement.NEAR:
        return f"The loop chose {chosen} ({share:.0f} %), which localisation hardly tells from {site}."
    rank = table.loc[:chosen, "share"].dropna().round(6).nunique()
    return (
        f"Localisation disagrees with the loop, which chose {chosen}: it explains {share:.0f} % and is number "
        f"{rank}. The choice of the loop rests on refitting the whole chain with a law there, which the signs "
        "alone cannot do; another effect may dominate the residual."
    )


# -- what kind --------------------------------------------------------------------------------------


def characterisation(evidence: Any) -> str:
    """What the missing force depends on."""
    if evidence.characterisation is None:
        return not_possible("characterisation", evidence)
    said = characterised(evidence.characterisation)
    return f"The force missing at {evidence.site} {said[0].lower()}{said[1:]}"


def characterised(found: Any) -> str:
    """What a force depends on, from its :class:`Characterisation`."""
    quiet = ""
    if found.noise is not None and found.rms > 0:
        quiet = f", noise is {min(100.0, 100 * (found.noise / found.rms) ** 2):.0f} %"
    if found.dependence == Dependence.NOTHING:
        best = max(float(found.shares["share"].max()), 0.0)
        text = f"Depends on nothing that was tried (at most {best:.0f} % explained{quiet})"
        return f"{text}: noise, or a force from outside."
    share = float(found.shares.loc[found.shares["chosen"], "share"].iloc[0])
    return f"{_kind(found)}; {share:.0f} % explained on data left out{quiet}."


def _kind(found: Any) -> str:
    """What a force depends on and what it is like, without numbers of the fit."""
    d, parity = found.dependence, Parity.of(found.odd)
    if d == Dependence.LINE:
        return f"Is a spectral line at {found.frequency:.4g} Hz: an unmeasured harmonic force"
    if d == Dependence.COVARIATE:
        return f"Is modulated by {found.covariate}{', odd in the motion' if parity == Parity.ODD else ''}"
    if d in _DEPENDENCE:
        return _DEPENDENCE[d]
    if d == Dependence.PATH:
        text = f"Depends on the path (memory adds {found.memory:.0f} points to any function of s and v)"
        return f"{text}, {_PARITY[parity]}: hysteresis-like"
    text = f"Depends on {d.value}, {_PARITY[parity]}"
    if Feature.JUMP in found.features:
        return f"{text}, with a jump at v = 0: friction-like"
    if Feature.KINK in found.features:
        contact = "contact on one side" if parity == Parity.NEITHER else "gap- or contact-like"
        return f"{text}, with a kink: {contact}"
    more = f" ({', '.join(mark.value for mark in found.features)})" if found.features else ""
    return f"{text}, smooth{more}: {_SMOOTH[d]}"


# -- what no chain law explains, and channels -------------------------------------------------------


def coupling(one: Any) -> str:
    """What is left of one storey's force."""
    text = (
        f"storey {one.storey}, {one.percent:.3g} % of its force: its own drift, rate and path explain "
        f"{100 * max(one.own, 0.0):.0f} % of that on data left out"
    )
    if one.coupled:
        text += f", coupling to the drifts and rates of the other storeys {100 * one.others:.0f} % of the rest"
    return text


def couplings(found: Sequence[Any]) -> str:
    """Where something is left that no law of a chain explains; empty if nowhere."""
    return f"Not explained by a chain law: {'; '.join(map(coupling, found))}" if found else ""


def contradictions(found: Sequence[Any]) -> str:
    """Channels of one DOF that do not show one motion; empty if there are none."""
    said = "; ".join(dict.fromkeys(one.message for one in found))
    return f"Channels contradict each other, and the fusion made the best of it: {said}" if found else ""


# -- the loop ---------------------------------------------------------------------------------------


def band(found: tuple[float | None, float | None]) -> str:
    """A frequency band."""
    low, high = found
    return "full" if low is None and high is None else f"{low or 0:.3g}-{np.inf if high is None else high:.3g} Hz"


def acceptance(step: Any) -> str:
    """Why an effect was accepted, and whether held-out data confirm it."""
    text = (
        f"lowers the residual on folds left out of the fit by {step.gain:.2g} dB (standard error "
        f"{step.gain_error:.2g}, {step.gain_least:.2g} without the fold that speaks most for it)"
    )
    if np.isfinite(step.share):
        text += f"; it changes {100 * step.share:.0f} % of the force at its site"
    return text


def confirmation(step: Any) -> str:
    """What the held-out data say of an effect."""
    change = f"held-out balance error {step.error_before:.3g} to {step.error_after:.3g} %"
    return change if step.confirmed else f"{change}: NOT CONFIRMED, and the model does not hold it"


def best_refused(last: Any) -> str:
    """Why no further effect was added."""
    if last is None:
        return "no law of the catalogue lowers the error at any site"
    finding, gain = last
    where = f"{finding.proposal.law.name} at {', '.join(map(str, finding.proposal.sites))}"
    return (
        f"no further effect is there and matters: the best candidate, {where}, gains {gain.value:.2g} dB (standard "
        f"error {gain.error:.2g}, {gain.least:.2g} without the fold that speaks most for it)"
    )


def hopeless(left: np.ndarray) -> str:
    """A balance of which the model explains next to nothing: a claim is no better than its worst balance."""
    worst = int(np.nanargmax(left)) + 1
    return f"the best model leaves {left[worst - 1]:.0f} % of the balance of DOF {worst}"


def negative_masses(masses: np.ndarray) -> str:
    """Masses that no structure has."""
    bad = ", ".join(f"m{j} = {m:.3g} kg" for j, m in enumerate(masses, 1) if m <= 0)
    return f"masses came out not positive ({bad})"


def cancelled_masses(dofs: Sequence[int]) -> str:
    """Effects that take away a declared mass."""
    return f"an effect cancels the declared mass of DOF {', '.join(map(str, dofs))}"
