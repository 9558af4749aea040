"""After each accepted effect: all shape parameters once more, and effects that a later one makes needless."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..exceptions import NRFError
from ..laws.base import ForceLaw
from ..mechanics.sites import Site
from .catalogue import balances_of
from .gate import MEMBER_GAIN, MIN_WINS, gain_of
from .search import Finding, refine
from .stage import Stage

_ROUNDS = 2
_EVALUATIONS = 40
# Part of the spacing of the scan over which a shape parameter is looked for again.
_REACH = 0.2
_ENOUGH = 1e-3


def place_of(stage: Stage, finding: Finding, accepted: Sequence[Finding] = ()) -> tuple[Site, int] | None:
    """Where an accepted law stands in a stage, or None if another took its place."""
    name, site = finding.law.name, finding.site
    same = [f is finding for f in accepted if (f.law.name, f.site) == (name, site)]
    later = len(same) - 1 - same.index(True) if True in same else 0
    held = [i for i, law in enumerate(stage.laws.get(site, ())) if law.name == name]
    return (site, held[-1 - later]) if later < len(held) else None


def reestimated(stage: Stage, accepted: Sequence[Finding], rounds: int = _ROUNDS) -> Stage:
    """The same laws with the shape parameters of all accepted ones refined in turn."""
    shaped = [f for f in accepted if f.candidate.law.free_shape and place_of(stage, f, accepted) is not None]
    now = stage.slot().search_error()
    for _ in range(rounds if shaped else 0):
        begin = now
        for f in shaped:
            where = place_of(stage, f, accepted)
            if where is None:
                continue
            law = stage.laws[where[0]][where[1]]
            try:
                base = Stage(stage.work, stage.chain, stage.without([where]))
                better = refine(base, Finding(f.candidate, law, now), _EVALUATIONS, _REACH)
                if better.screen < now:
                    stage, now = stage.with_values(where, better.law), better.screen
            except NRFError:  # it cannot be told from the others for a moment
                continue
        if now > begin * (1 - _ENOUGH):
            break
    return stage


def among(stage: Stage, finding: Finding, accepted: Sequence[Finding]) -> Finding:
    """A candidate with the shape parameters of the accepted effects estimated again beside it."""
    placed = [(f, place) for f in accepted if (place := place_of(stage, f, accepted)) is not None]
    stay = [(f, place) for f, place in placed if place not in finding.drop]
    if type(finding) is not Finding or not any(f.candidate.law.free_shape for f, _ in stay):
        return finding
    together = [*(f for f, _ in stay), finding]
    try:
        again = reestimated(finding.on(stage), together, 1)
    except NRFError:
        return finding
    around = {site: list(held) for site, held in stage.laws.items()}
    for f, (site, number) in stay:
        around[site][number] = _held(again, f, together)
    law, error = _held(again, finding, together), again.slot().search_error()
    return replace(finding, law=law, screen=error, around={site: tuple(held) for site, held in around.items()})


def _held(stage: Stage, finding: Finding, accepted: Sequence[Finding]) -> ForceLaw:
    """An accepted law as a stage holds it."""
    place = place_of(stage, finding, accepted)
    assert place is not None
    return stage.laws[place[0]][place[1]]


def needless(stage: Stage, accepted: Sequence[Finding]) -> Finding | None:
    """The accepted effect that the folds could best do without, if there is one that they can."""
    after = stage.slot().folds()
    weakest: tuple[float, Finding] | None = None
    for f in accepted[:-1]:
        where = place_of(stage, f, accepted)
        others = [g for g in accepted if g is not f]
        if where is None or any(_imitates(stage, g, f) for g in others):
            continue
        try:
            base = reestimated(Stage(stage.work, stage.chain, stage.without([where])), others, 1)
            before = base.slot().folds()
        except NRFError:
            continue
        gain = gain_of(before, after)
        kept = gain >= MEMBER_GAIN and np.mean(after < before) >= MIN_WINS
        if not kept and (weakest is None or gain < weakest[0]):
            weakest = gain, f
    return None if weakest is None else weakest[1]


def _imitates(stage: Stage, general: Finding, special: Finding) -> bool:
    """Whether one accepted law imitates another in the same balances whatever the truth."""
    same = balances_of(general.site) == balances_of(special.site)
    if not same or not general.law.contains(special.law):
        return False
    if special.law.variable != "1":
        return True
    work = stage.work
    s = np.concatenate([work.motion(special.site, b.segment).s[b.rows] for b in work.search])
    return bool(s.mean() ** 2 > s.var())
