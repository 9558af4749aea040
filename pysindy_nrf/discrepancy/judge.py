"""The judge: is an effect there, does it matter, which names cannot be told apart."""

from collections.abc import Sequence

import numpy as np

from ..chain.sites import Site
from ..equations.normal_equations import variance
from ..laws.base import ForceLaw
from .constants import FAR, LARGE_GAIN, LEAST_GAIN, LEAST_SHARE, TENTH
from .ruler import Gain, Trial
from .state import Effect, Finding, State


def share_of(trial: Trial, without: Trial, site: Site) -> float:
    """Rms of what an effect changes of the force at its site over that of the storey,
    in the informative bands.
    """
    p = site.p
    informative = trial.ruler.informative[min(p, len(trial.ruler.informative)) - 1]
    grams = (trial.grams * informative[None, :, None, None]).sum(axis=(0, 1))
    after, storey, before = np.zeros((3, len(grams)))
    at = trial.layout.slices[site]
    after[at] = storey[at] = trial.theta[0, at]
    below = trial.layout.slices.get(Site(p), at)
    storey[below] = trial.theta[0, below]
    start, old, left = (
        at.start,
        without.layout.slices.get(site, at).start,
        list(without.laws.get(site, ())),
    )
    for law in trial.laws[site]:
        width = len(law.terms())
        if law in left:
            left.remove(law)
            before[start : start + width] = without.theta[0, old : old + width]
            old += width
        start += width
    change, whole = (max(float(c @ grams @ c), 0.0) for c in (after - before, storey))
    return float(np.sqrt(change / whole)) if whole > 0 else 1.0


def is_there(gain: Gain, law: ForceLaw | None = None, size: float = LEAST_GAIN) -> bool:
    """Whether a gain of some size stands whichever fold is left out; that of a force in
    one band, where it acts.
    """
    narrow = law is not None and law.narrow_band and gain.value > 0
    value, least = (
        (gain.there, gain.there_least) if narrow else (gain.value, gain.least)
    )
    return value >= size and least >= 0.5 * LEAST_GAIN


def differs_from_zero(trial: Trial, effect: Effect) -> bool:
    """Whether a coefficient of the last law at a site is known to two standard errors
    (95 %), from fold to fold.
    """
    stop = trial.layout.slices[effect.site].stop
    parts = trial.theta[:, stop - len(effect.law.terms()) : stop]
    return bool((np.abs(parts[0]) > FAR * np.sqrt(variance(parts[1:]))).any())


def accepts(finding: Finding, state: State) -> bool:
    """Whether an effect is there and matters."""
    gain, after = over(finding, state), finding.after
    if after is None or gain is None or not is_there(gain, finding.proposal.law):
        return False
    if finding.is_fault:
        return True
    if not all(
        differs_from_zero(after.trial, e)
        for e in after.effects
        if e not in state.effects
    ):
        return False
    positive = (after.trial.masses[0] > 0) | (state.trial.masses[0] <= 0)
    shares = _shares(finding, state)
    cancels = any(
        share > 1 and not finding.state.trial.laws.get(site)
        for site, share in shares.items()
    )
    wide = not finding.proposal.law.narrow_band
    large = (
        gain.value >= LARGE_GAIN or max(shares.values()) >= LEAST_SHARE
        if wide
        else gain.there >= LARGE_GAIN
    )
    return large and not cancels and bool(positive.all())


def _shares(finding: Finding, state: State) -> dict[Site, float]:
    """Share of the force that an effect changes at each of its sites; of a new tie,
    beside the storey below it.
    """
    after = finding.after
    assert after is not None
    new = [e for e in after.effects if e not in state.effects]
    return {e.site: share_of(after.trial, finding.state.trial, e.site) for e in new}


def is_clear(finding: Finding, state: State) -> bool:
    """Whether an effect need not be compared with chance: large by gain and share, or a
    fault that channels witness.
    """
    if finding.is_fault:
        return finding.witnessed
    gain = over(finding, state)
    return (
        gain is not None
        and gain.lower >= LARGE_GAIN
        and max(_shares(finding, state).values()) >= LEAST_SHARE
    )


def over(finding: Finding, state: State) -> Gain | None:
    """Gain of a finding over a state, whatever effects it replaces."""
    return None if finding.after is None else finding.after.trial.gain_over(state.trial)


def ranked(found: Sequence[Finding], state: State) -> list[tuple[Finding, Gain]]:
    """Findings with their gain over a state, the best first."""
    pairs = [(f, over(f, state)) for f in found]
    return sorted(
        ((f, g) for f, g in pairs if g is not None), key=lambda pair: -pair[1].value
    )


def _near(
    pairs: Sequence[tuple[Finding, Gain]], number: int, most: float = np.inf
) -> list[int]:
    """Numbers of the findings whose gain is within a standard error (and so many dB) of
    that of one of them.
    """
    taken = pairs[number][1]
    errors = [float(np.sqrt(variance(taken.parts - gain.parts))) for _, gain in pairs]
    reach = [min(max(error, LEAST_GAIN), most) for error in errors]
    return [
        k for k, (_, gain) in enumerate(pairs) if taken.value - gain.value <= reach[k]
    ]


def chosen(pairs: Sequence[tuple[Finding, Gain]]) -> int:
    """The simplest finding within a standard error of the best (a tenth of its gain at
    most), linear first.
    """
    near = _near(pairs, 0, TENTH * pairs[0][1].value)
    return min(near, key=lambda k: (pairs[k][0].size, -pairs[k][1].value))


def rivals(pairs: Sequence[tuple[Finding, Gain]], number: int) -> list[Finding]:
    """Findings that the data cannot tell from the one that is taken: within a standard
    error of it.
    """
    return [pairs[k][0] for k in _near(pairs, number) if k != number]


def admissible(law: ForceLaw, forces: np.ndarray) -> np.ndarray:
    """Where forces of the terms of an undeclared effect, (n_points, n_terms), can be
    real: none is clearly negative.
    """
    held = forces[:, [term.symbol in law.nonnegative for term in law.terms()]]
    return (held >= -TENTH * np.abs(forces).max(axis=1, keepdims=True)).all(axis=1)
