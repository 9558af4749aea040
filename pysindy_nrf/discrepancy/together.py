"""Effects at several places none of which stands out alone: looked for together.

Where the same kind of effect sits in every storey, each is a part of the pooled error that may stay
below what the gate asks of one. Then the best candidates of different sites are added one on top
of the other, and the gate judges them as one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from ..exceptions import NRFError
from .catalogue import Candidate, balances_of
from .gate import FLOOR, MEMBER_GAIN, MIN_WINS, TIE, Verdict, choose, gain_of, judge
from .search import Finding, excludes, refine, screen, validate
from .second_opinion import confirmed
from .spectral_lines import lines_for
from .stage import Stage
from .surrogate import Null

_MOST = 4


def look_ahead(
    stage: Stage, ranking: Sequence[Finding], before: np.ndarray, null: Null, most: int = _MOST
) -> tuple[list[tuple[Finding, list[Finding]]], Verdict] | None:
    """Candidates of several sites that pass the gate together."""
    found = _chain(stage, ranking, before, min(most, _MOST))
    if len(found) < 2:
        return None
    members = [f for f, _, _ in found]
    n_parameters = sum(f.n_parameters for f in members) - 2 * (len(members) - 1)
    verdict = _passed(stage, members, found[-1][2], before, null, n_parameters)
    return None if verdict is None else ([(f, tied) for f, tied, _ in found], verdict)


def pair_instead(
    stage: Stage, chosen: Finding, candidates: Sequence[Candidate], before: np.ndarray, null: Null
) -> tuple[list[tuple[Finding, list[Finding]]], Verdict] | None:
    """Two laws without shape parameters that explain clearly more than one that has some."""
    if not chosen.candidate.law.free_shape or type(chosen) is not Finding:
        return None
    plain = [c for c in candidates if c.site == chosen.site and not c.law.shapes]
    found: list[tuple[Finding, Finding, Stage]] = []
    for one, two in combinations(plain, 2):
        if one.law.family != two.law.family or excludes(one.law, two.law):
            continue
        try:
            first = validate(stage, Finding(one, one.law, np.inf, chosen.drop))
            beside = first.on(stage)
            second = validate(beside, Finding(two, two.law, np.inf))
            if first.n_parameters + second.n_parameters <= chosen.n_parameters:
                found.append((first, second, second.on(beside)))
        except NRFError:
            continue
    if not found:
        return None
    first, second, whole = min(found, key=lambda pair: pair[1].error)
    if second.error > (1 - TIE) * chosen.error or np.mean(second.folds < chosen.folds) < MIN_WINS:
        return None
    verdict = _passed(stage, [first, second], whole, before, null, first.n_parameters + second.n_parameters)
    return None if verdict is None else ([(first, []), (second, [])], verdict)


def both_missed(
    stage: Stage, first: Finding, second: Finding, tied: list[Finding], before: np.ndarray, null: Null
) -> tuple[list[tuple[Finding, list[Finding]]], Verdict] | None:
    """Two effects that pass the gate together."""
    under = second.under(first.on(stage))
    first = replace(first, law=under.laws[first.site][-1])
    n_parameters = first.n_parameters + second.n_parameters - 2
    verdict = _passed(stage, [first, second], second.on(first.on(stage)), before, null, n_parameters)
    return None if verdict is None else ([(first, []), (second, tied)], verdict)


def _passed(
    stage: Stage, members: Sequence[Finding], whole: Stage, before: np.ndarray, null: Null, n_parameters: int
) -> Verdict | None:
    """The verdict on several effects as one; None if one of them is not missed, or they do not pass."""
    after = whole.slot().folds()
    for f in members:
        where = [max((f.site, i) for i, law in enumerate(whole.laws[f.site]) if law == f.law)]
        try:
            without = Stage(whole.work, whole.chain, whole.without(where)).slot().folds()
        except NRFError:
            continue
        if gain_of(without, after) < MEMBER_GAIN or np.mean(after < without) < MIN_WINS:
            return None
    if not judge(before, after, n_parameters).accepted:
        return None
    null_gain = max((_null_gain(s, members) for s in null.stages), default=0.0)
    verdict = judge(before, after, n_parameters, null_gain, at_floor=null.reached)
    if verdict.accepted:
        verdict = confirmed(verdict, stage, whole, null)
    return verdict if verdict.accepted else None


def _chain(
    stage: Stage, ranking: Sequence[Finding], before: np.ndarray, most: int
) -> list[tuple[Finding, list[Finding], Stage]]:
    """The best candidate of each site, added where it still helps after those before it."""
    by_site: dict[str, list[Finding]] = {}
    for f in ranking:
        if not f.drop and type(f) is Finding:
            by_site.setdefault(str(balances_of(f.site)), []).append(f)
    out: list[tuple[Finding, list[Finding], Stage]] = []
    now = before
    for group in sorted(by_site.values(), key=lambda g: min(f.error for f in g)):
        if len(out) >= most:
            break
        chosen, tied = choose(group, float(np.median(before)))
        try:
            again = validate(stage, refine(stage, Finding(chosen.candidate, chosen.law, np.inf), 40))
            if gain_of(now, again.folds) < MEMBER_GAIN or np.mean(again.folds < now) < MIN_WINS:
                continue
            stage = again.on(stage)
        except NRFError:
            continue
        now = again.folds
        out.append((again, tied, stage))
    return out


def _null_gain(stage: Stage, members: Sequence[Finding]) -> float:
    """What the same candidates gain together where they do not act."""
    try:
        first = now = stage.slot().folds()
        if np.median(first) < FLOOR:
            return 0.0
        for f in members:
            best = screen(stage, [f.candidate], (), lines_for(stage, f.candidate))
            if best:
                tried = validate(stage, refine(stage, best[0], 20))
                if np.isfinite(tried.error) and tried.error < np.median(now):
                    stage, now = tried.on(stage), tried.folds
        return gain_of(first, now)
    except NRFError:
        return 0.0
