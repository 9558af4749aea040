"""Which of several laws that explain nearly as much is the true one: each is simulated, and all are fitted.

Noise in the motion rounds off a jump and bends a curve, so on noisy records a wrong law may fit better
than the true one. What the errors of all rivals would be if one of them were true is seen on its own
surrogates (indirect inference; Gourieroux, Monfort and Renault 1993): the likeliest is the one whose
surrogates show the pattern that was measured.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ..exceptions import NRFError
from .catalogue import balances_of
from .gate import MOST_FAMILIES, judge, special_case
from .search import Finding, refine
from .stage import Stage
from .surrogate import Null

# Rivals have errors within this share of the best one's.
_RIVAL = 0.35
_MOST = 3
# Patterns whose distances differ by less than this fit as well: then fewer parameters go first.
_CLEARLY = 0.7


def likeliest(
    stage: Stage,
    chosen: Finding,
    tied: list[Finding],
    ranking: Sequence[Finding],
    before: np.ndarray,
    null_of: Callable[[Stage], Null],
) -> tuple[Finding, list[Finding]]:
    """The law to report out of those that pass the gate at one site."""
    best = min(chosen.error, *(f.error for f in ranking if balances_of(f.site) == balances_of(chosen.site)))
    rivals = [chosen]
    for f in sorted(ranking, key=lambda f: f.error):
        same = any((f.law.name, f.site) == (r.law.name, r.site) for r in rivals)
        if same or type(f) is not Finding or balances_of(f.site) != balances_of(chosen.site):
            continue
        if f.law.contains(chosen.law):  # the simpler one goes first
            continue
        close = f.error <= best * (1 + _RIVAL) and f.n_parameters <= chosen.n_parameters
        if close and len(rivals) < _MOST and judge(before, f.folds, f.n_added).accepted:
            rivals.append(f)
    if len(rivals) < 2:
        return chosen, tied
    seen = _pattern([_error(stage, f) for f in rivals])
    distances = [_distance(stage, f, rivals, seen, null_of) for f in rivals]
    if not np.isfinite(min(distances)):
        return chosen, tied
    near = [i for i, d in enumerate(distances) if _CLEARLY * d <= min(distances)]
    first = min(near, key=lambda i: (rivals[i].n_parameters, i > 0, distances[i]))
    if first == 0:
        return chosen, tied
    winner = special_case(rivals[first], ranking, float(np.median(before)))
    families = {f.law.family: f for f in (chosen, *tied) if f.law.family != winner.law.family}
    return winner, list(families.values())[: MOST_FAMILIES - 1]


def _pattern(errors: Sequence[float]) -> np.ndarray:
    """Squared errors, less what all have in common: noise, and effects elsewhere that are still missing."""
    squares = np.square(errors)
    return squares - squares.mean()


def _distance(
    stage: Stage, true: Finding, rivals: Sequence[Finding], seen: np.ndarray, null_of: Callable[[Stage], Null]
) -> float:
    """How far the pattern of errors would be from what was seen if one of the rivals were true."""
    try:
        fakes = null_of(true.on(stage)).stages
        found = []
        for fake in fakes:
            plain = Stage(fake.work, stage.chain, stage.laws)
            found.append(_pattern([_error(plain, f) for f in rivals]))
        return float(np.linalg.norm(np.mean(found, axis=0) - seen)) if found else np.inf
    except NRFError:
        return np.inf


def _error(stage: Stage, finding: Finding) -> float:
    start = Finding(finding.candidate, finding.law, np.inf, finding.drop)
    return refine(stage, start, 30, 0.2).screen if finding.candidate.law.free_shape else _plain(stage, finding)


def _plain(stage: Stage, finding: Finding) -> float:
    return float(stage.slot(finding.site, finding.candidate.law, finding.drop).errors([finding.law])[0])
