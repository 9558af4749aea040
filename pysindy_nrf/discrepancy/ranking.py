"""The candidates of one round: all are screened, the best refined and judged on blocks they were not fitted to."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .catalogue import Candidate, balances_of
from .gate import MEMBER_GAIN, MIN_WINS, gain_of
from .reestimate import among
from .search import Finding, refine, screen, validate
from .spectral_lines import lines_of
from .stage import Stage

_SHORTLIST = 14
_VALIDATED = 10
# A candidate that does not even do this on the data it is fitted to cannot pass the gate.
_HOPELESS = 0.05


def ranked(
    stage: Stage, every: Sequence[Candidate], held: Sequence[Finding], number: int = 1, progress: bool = False
) -> list[Finding]:
    """Candidates that are worth a look at the gate, each beside the refitted shapes of the effects that are there."""
    trial = stage.trial()
    now = trial.search_error()
    accepted = [(f.site, f.law.name) for f in held]
    lines = lines_of(trial)
    bar, tick = None, None
    if progress:
        from tqdm.auto import tqdm

        bar = tqdm(total=len(every), desc=f"search {number}", unit="candidate", leave=False, disable=None)
        tick = bar.update
    found = screen(stage, every, accepted, lines, tick, both=True)
    if bar is not None:
        bar.close()
    hopeful = [f for f in found if f.screen < now * (1 - _HOPELESS)][:_SHORTLIST]
    # a law that takes the place of a simpler one starts from where that stands
    hopeful += [f for f in found if f.drop and len(f.candidate.law.free_shape) > 1 and not _holds(hopeful, f)]
    refined = sorted((refine(stage, f) for f in hopeful), key=lambda f: f.screen)[:_VALIDATED]

    def special(one: Finding) -> bool:
        return any(f.law.contains(one.law) and balances_of(f.site) == balances_of(one.site) for f in refined[:3])

    simple = [f for f in found if special(f) and not _holds(refined, f)]
    refined += [refine(stage, f) for f in simple]
    return _missed([validate(stage, among(stage, f, held)) for f in refined])


def _holds(findings: Sequence[Finding], one: Finding) -> bool:
    return any((f.site, f.drop) == (one.site, one.drop) and f.candidate.law == one.candidate.law for f in findings)


def _missed(judged: Sequence[Finding]) -> list[Finding]:
    """Without those beside an earlier law that is hardly missed where they take its place."""
    out = []
    for f in judged:
        instead = [
            g for g in judged
            if g.candidate == f.candidate and len(g.drop) > len(f.drop) and np.isfinite(g.error) and g is not f
        ]  # fmt: skip
        if all(gain_of(g.folds, f.folds) >= MEMBER_GAIN and np.mean(f.folds < g.folds) >= MIN_WINS for g in instead):
            out.append(f)
    return out


__all__ = ["ranked"]
