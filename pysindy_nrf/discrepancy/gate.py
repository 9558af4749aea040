"""The acceptance gate, and which families the data cannot tell apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .catalogue import balances_of
from .search import Finding

MIN_GAIN = 0.15
MIN_WINS = 0.8
# What an effect must gain on top of all others: beside those it is accepted with, and those that came later.
MEMBER_GAIN = 0.05
# Further gain asked for each parameter beyond the second: a flexible law fits what is no effect.
PARAMETER_GAIN = 0.05
# At the floor of noise an effect must gain so many times what it gains on surrogates: nothing need be missing there,
# and how noise makes the model wrong is known to some tenths only.
AT_THE_FLOOR = 2.0
TIE = 0.10
# A further parameter must lower the error by this share to be preferred: within one family at one
# site, and between families.
PER_PARAMETER = 0.10
SIMPLER = 0.02
# Share of the fall of the error that a special case must reach to go before the law that holds it.
MOST_OF_THE_WORK = 0.65
# The same for a constant: of an even law along a drift about zero it cannot do half, so the zero is elsewhere.
HALF_OF_THE_WORK = 0.5
# It must not leave more than so many times what that leaves, unless a measured covariate makes the difference.
MOST_LEFT = 2.0
MOST_FAMILIES = 3
# Pooled balance error, percent, below which there is nothing an engineer would look for.
FLOOR = 0.02


@dataclass(frozen=True)
class Verdict:
    """Why a candidate was accepted or not.

    Attributes
    ----------
    accepted : bool
    gain : float
        Median over the blocks of 1 - error after / error before.
    wins : float
        Share of the blocks in which the error falls.
    null_gain : float
        Largest gain of the same law at the same site on surrogates without any effect.
    sentence : str
    """

    accepted: bool
    gain: float
    wins: float
    null_gain: float
    sentence: str


def gain_of(before: np.ndarray, after: np.ndarray) -> float:
    """Fall of the median error over the blocks, as a share."""
    low, high = float(np.median(after)), float(np.median(before))
    return 1.0 - low / high if high > 0 else 0.0


def judge(
    before: np.ndarray,
    after: np.ndarray,
    n_parameters: int = 1,
    null_gain: float = 0.0,
    least: float = MIN_GAIN,
    at_floor: bool = False,
) -> Verdict:
    """Accept an effect, or not."""
    gain, wins = gain_of(before, after), float(np.mean(after < before))
    priced = least + PARAMETER_GAIN * max(0, n_parameters - 2)
    beyond_noise = (AT_THE_FLOOR if at_floor else 1.0) * null_gain + 0.05
    needed = max(priced, beyond_noise if null_gain > 0.05 else 0.0)
    facts = (
        f"the median error over {len(before)} blocks falls by {100 * gain:.0f} % "
        f"({np.median(before):.3g} to {np.median(after):.3g} %), in {100 * wins:.0f} % of the blocks"
    )
    if np.median(before) < FLOOR:
        return Verdict(
            False,
            gain,
            wins,
            null_gain,
            f"the balance closes within {np.median(before):.2g} %, nothing is left to explain",
        )
    if gain < needed:
        why = f"at least {100 * needed:.0f} % are asked" + (
            f" ({100 * null_gain:.0f} % come from noise alone)" if needed > priced else ""
        )
        return Verdict(False, gain, wins, null_gain, f"{facts}; {why}")
    if wins < MIN_WINS:
        return Verdict(
            False, gain, wins, null_gain, f"{facts}; at least {100 * MIN_WINS:.0f} % of the blocks are asked"
        )
    return Verdict(True, gain, wins, null_gain, facts)


def choose(findings: Sequence[Finding], before: float) -> tuple[Finding, list[Finding]]:
    """The candidate to report, and the families that the data cannot tell from it."""
    groups: dict[tuple[str, str], list[Finding]] = {}
    for f in findings:
        groups.setdefault((f.law.family, str(f.site)), []).append(f)

    def price(f: Finding, share: float) -> float:
        return (f.error + FLOOR) * (1 + share) ** f.n_added

    heads = [min(group, key=lambda f: price(f, PER_PARAMETER)) for group in groups.values()]
    best = min(f.error for f in heads)
    chosen = special_case(min(heads, key=lambda f: price(f, SIMPLER)), findings, before)
    tied: dict[str, Finding] = {}
    for f in sorted(findings, key=lambda f: f.error):
        if (
            balances_of(f.site) == balances_of(chosen.site)
            and f.law.family != chosen.law.family
            and f.error <= max(chosen.error, best) * (1 + TIE)
        ):
            tied.setdefault(f.law.family, f)
    return chosen, list(tied.values())[: MOST_FAMILIES - 1]


def special_case(chosen: Finding, findings: Sequence[Finding], before: float) -> Finding:
    """The simplest law that the chosen one holds as a special case and that does most of its work; itself if none."""

    def enough(f: Finding) -> float:
        share = HALF_OF_THE_WORK if f.law.variable == "1" else MOST_OF_THE_WORK
        return chosen.error + (1.0 - share) * max(before - chosen.error, 0.0)

    simpler = [
        f
        for f in findings
        if balances_of(f.site) == balances_of(chosen.site)
        and chosen.law.contains(f.law)
        and f.n_parameters <= chosen.n_parameters
        and f.error <= enough(f)
        and (f.law.covariates or chosen.law.covariates or f.error + FLOOR <= MOST_LEFT * (chosen.error + FLOOR))
    ]
    return min(simpler, key=lambda f: (f.n_parameters, f.error)) if simpler else chosen
