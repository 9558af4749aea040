"""The acceptance gate, and which families the data cannot tell apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .search import Finding

MIN_GAIN = 0.15
MIN_WINS = 0.8
TIE = 0.10
# A further parameter must lower the error by this share to be preferred: within one family at one
# site, and between families.
PER_PARAMETER = 0.10
SIMPLER = 0.02
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


def judge(before: np.ndarray, after: np.ndarray, null_gain: float = 0.0) -> Verdict:
    """Accept an effect, or not.

    Parameters
    ----------
    before, after : ndarray of shape (n_blocks,)
        Pooled balance error on each search block after fitting to the others, percent.
    null_gain : float
        Largest gain on surrogates without any effect.

    Returns
    -------
    Verdict
    """
    gain, wins = gain_of(before, after), float(np.mean(after < before))
    needed = max(MIN_GAIN, null_gain + 0.05 if null_gain > 0.05 else 0.0)
    facts = (
        f"the median error over {len(before)} blocks falls by {100 * gain:.0f} % "
        f"({np.median(before):.3g} to {np.median(after):.3g} %), in {100 * wins:.0f} % of the blocks"
    )
    if np.median(before) < FLOOR:
        return Verdict(False, gain, wins, null_gain, f"the balance closes within {np.median(before):.2g} %, nothing is left to explain")
    if gain < needed:
        why = f"at least {100 * needed:.0f} % are asked" + (f" ({100 * null_gain:.0f} % come from noise alone)" if needed > MIN_GAIN else "")
        return Verdict(False, gain, wins, null_gain, f"{facts}; {why}")
    if wins < MIN_WINS:
        return Verdict(False, gain, wins, null_gain, f"{facts}; at least {100 * MIN_WINS:.0f} % of the blocks are asked")
    return Verdict(True, gain, wins, null_gain, facts)


def choose(findings: Sequence[Finding]) -> tuple[Finding, list[Finding]]:
    """The candidate to report, and the families that the data cannot tell from it.

    Parameters
    ----------
    findings : sequence of Finding
        Validated.

    Returns
    -------
    chosen : Finding
        The best after a small price on each parameter: within one family at one site a law with one
        more parameter must be 10 % better, between families 2 %.
    tied : list of Finding
        The best of each other (family, site) within 10 % of the chosen one, at most two.
    """
    groups: dict[tuple[str, str], list[Finding]] = {}
    for f in findings:
        groups.setdefault((f.law.family, str(f.site)), []).append(f)
    def price(f: Finding, share: float) -> float:
        return (f.error + FLOOR) * (1 + share) ** f.n_parameters

    heads = [min(group, key=lambda f: price(f, PER_PARAMETER)) for group in groups.values()]
    best = min(f.error for f in heads)
    chosen = min(heads, key=lambda f: price(f, SIMPLER))
    tied: dict[str, Finding] = {}
    for f in sorted(findings, key=lambda f: f.error):
        if f.site == chosen.site and f.law.family != chosen.law.family and f.error <= max(chosen.error, best) * (1 + TIE):
            tied.setdefault(f.law.family, f)
    return chosen, list(tied.values())[: MOST_FAMILIES - 1]
