"""Conclusions of the diagnosis in sentences; nothing reads them back."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from ...chain.sites import Site
from .kinds import Dependence, Feature, Location, Obstacle, ResidualKind
from .settings import RESIDUAL

if TYPE_CHECKING:
    from .characterisation import Characterisation
    from .detection import Detection
    from .localisation import Localisation


def not_possible(question: str, obstacle: Obstacle) -> str:
    """The sentence for a question without an answer."""
    return f"{question.capitalize()} is not possible because {obstacle.reason}."


# -- detection -----------------------------------------------------------------


def detection(detection: Detection, effect_follows: bool) -> str:
    """Whether the residual is noise."""
    table = detection.verdicts
    ratio = table["floor ratio"].max()
    times = "the noise is not known"
    if np.isfinite(ratio):
        times = f"at most {ratio:.2g} times the noise floor"
    if detection.is_noise:
        text = f"Nothing but noise is left in any balance ({times})"
        if effect_follows:
            text += "; the gain, which looks at each band, sees more"
        return f"{text}."

    kinds = table[table["verdict"] != ResidualKind.NOISE]["verdict"]
    parts = []
    for kind in dict.fromkeys(kinds):
        places = kinds.index[kinds == kind]
        parts.append(f"{kind.value} in {_listed(places)}")
    text = f"The residual is not noise: {'; '.join(parts)} ({times})."

    by_motion = [ResidualKind.LINEAR, ResidualKind.NONLINEAR]
    explained = table[table["verdict"].isin(by_motion)]
    if not len(explained):
        return text
    largest = explained.loc[explained["nonlinear share"].idxmax()]
    return (
        f"{text} In {_listed([largest.name])} drifts, rates and inputs explain"
        f" {100 * largest['linear share']:.0f} % of it linearly, and nonlinear laws of"
        f" its own motion {100 * largest['nonlinear share']:.0f} % of the rest."
    )


def _listed(places: Sequence[str]) -> str:
    """Balances and storeys in one phrase."""
    phrases = []
    for phrase, kind in (("the balance of DOF", "dof "), ("storey", "storey ")):
        numbers = [p.removeprefix(kind) for p in places if p.startswith(kind)]
        if numbers:
            phrases.append(f"{phrase} {', '.join(numbers)}")
    return " and ".join(phrases)


# -- localisation --------------------------------------------------------------


def localisation(localisation: Localisation, chosen: str) -> str:
    """Where the missing force acts, and what the loop chose."""
    if localisation.verdict == Location.NOTHING:
        ratio, much = localisation.over_floor, "no more than any measurement does"
        if np.isfinite(ratio):
            much = f"{ratio:.2g} times what noise leaves"
        return f"All balances together leave {much}: nothing to locate."

    first, *others = _located(localisation.table)
    if localisation.verdict == Location.ONE_BALANCE:
        first = "With one equation of motion the signs say nothing"
    else:
        first = f"By its signs in the equations of motion the force acts at {first}"
    text = f"{'; '.join([first, *others])}."
    if not chosen:
        return text

    share, signs = localisation.table["share"].get(chosen, np.nan), ""
    if np.isfinite(share):
        signs = f", whose signs explain {share:.0f} %"
    return f"{text} The loop chose {chosen}{signs}."


def _located(table: pd.DataFrame) -> list[str]:
    """What the best site explains, and which others come near it."""
    first, rest = table.iloc[0], table.iloc[1:]
    interval = ""
    low, high = first["low"], first["high"]
    if np.isfinite(low) and round(low) != round(high):
        interval = f" ({low:.0f} to {high:.0f} %)"
    parts = [
        f"{first.name}, where it explains {first['share']:.0f} %{interval} of what is"
        " left"
    ]
    if np.isfinite(first["own"]):
        parts.append(_own_motion(Site(first.name), first["own"]))

    alike = rest["pattern"] == first["pattern"]
    others = rest[~alike & rest["share"].notna()]
    if len(others):
        other = others.iloc[0]
        how = "hardly distinguishable from" if other["near"] else "next comes"
        parts.append(f"{how} {other.name} with {other['share']:.0f} %")
    if alike.any():
        names = ", ".join(map(str, rest.index[alike]))
        parts.append(f"a force at {names} would look the same")
    return parts


def _own_motion(site: Site, share: float) -> str:
    """What the own motion of a site explains of the force there."""
    if site.kind == "link":
        return f"its own motion explains {share:.0f} % of the force"
    if site.kind == "sensor":
        return f"a delay explains {share:.0f} %"
    return f"{share:.0f} % follows no motion there"


# -- characterisation ----------------------------------------------------------


def characterisation(kind: Characterisation, site: str) -> str:
    """What the force missing at a site depends on."""
    sentence = characterised(kind)
    return f"The force missing at {site} {sentence[0].lower()}{sentence[1:]}"


def characterised(kind: Characterisation) -> str:
    """What a force depends on."""
    noise = ""
    if kind.noise is not None and kind.rms > 0:
        share = min(100.0, 100 * (kind.noise / kind.rms) ** 2)
        noise = f", noise is {share:.0f} %"

    if kind.dependence == Dependence.NOTHING:
        largest = max(float(kind.shares["share"].max()), 0.0)
        explained = f"(at most {largest:.0f} % explained{noise})"
        return (
            f"Depends on nothing that was tried {explained}: noise, or a force from"
            " outside."
        )
    chosen = kind.shares.loc[kind.shares["chosen"], "share"]
    explained = f"{float(chosen.iloc[0]):.0f} % explained on data left out"
    return f"{_description(kind)}; {explained}{noise}."


def _description(kind: Characterisation) -> str:
    """What a force depends on and what it is like, without numbers of the fit."""
    dependence = kind.dependence
    if dependence == Dependence.CONSTANT:
        return "Is constant: an offset or a dead load"
    if dependence == Dependence.LINEAR:
        return "Is linear in s, v and a: a wrong stiffness, damping or mass"
    if dependence == Dependence.LINE:
        frequency = f"{kind.frequency:.4g} Hz"
        return f"Is a spectral line at {frequency}: an unmeasured harmonic force"
    if dependence == Dependence.COVARIATE:
        return f"Is modulated by {kind.covariate}"
    if dependence == Dependence.TIME:
        return "Changes in time: a drift or step of stiffness, damping or friction"
    return _function_of_motion(kind)


def _function_of_motion(kind: Characterisation) -> str:
    """A force that depends on the drift, the rate, both, or the path."""
    parity = _parity(kind.odd)
    if kind.dependence == Dependence.RATE:
        start = f"Depends on v alone, {parity}"
        if Feature.JUMP in kind.features:
            return f"{start}, with a jump at v = 0: friction-like"
        return f"{start}, smooth: nonlinear damping"

    if kind.dependence == Dependence.DRIFT:
        start = f"Depends on s alone, {parity}"
        if Feature.KINK in kind.features:
            sided = "contact on one side"
            if parity in ("odd", "even"):
                sided = "gap- or contact-like"
            return f"{start}, with a kink: {sided}"
        marks = ", ".join(mark.value for mark in kind.features)
        return f"{start}, smooth{f' ({marks})' if marks else ''}: a nonlinear spring"

    if kind.dependence == Dependence.PATH:
        return (
            f"Depends on the path (memory adds {kind.memory:.0f} points to any"
            f" function of s and v), {parity}: hysteresis-like"
        )
    return f"Depends on s and v, {parity}, smooth: a force on the surface R(s, v)"


def _parity(odd: float) -> str:
    """Whether a function is odd or even."""
    if odd > 1 - RESIDUAL.least_share:
        return "odd"
    if odd < RESIDUAL.least_share:
        return "even"
    return "neither odd nor even"
