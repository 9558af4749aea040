"""The final model from the samples away from rest, where noise in the motion turns no force that jumps.

A hysteresis that turns over within a small part of the drift is a force that jumps, too.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..diagnostics.bias import SHARES, acting_there, first_settled, jumping_terms, made_wrong, moving
from ..exceptions import NRFError
from ..mechanics.sites import Site
from .stage import Stage

# Part of the rms drift of its site within which a hysteresis turns over that is friction but for its name.
_STEEP = 0.1


def jumping(stage: Stage) -> list[tuple[Site, int]]:
    """Terms of a model whose force jumps, or all but jumps, where the rate changes its sign."""
    out = {(site, k) for site, k, _ in jumping_terms(stage.layout)}
    for (site, i), at in stage.at.items():
        law = stage.laws[site][i]
        if law.saturation_drift < _STEEP * stage.work.scales(site)[0]:
            first = at - stage.layout.slices[site].start
            out |= {(site, first + k) for k in range(len(law.terms()))}
    return sorted(out, key=lambda one: (stage.layout.sites.index(one[0]), one[1]))


def share_to_leave(stage: Stage) -> float | None:
    """Which samples are next to rest, where least squares on all of them loses a part of a force that jumps."""
    at = [stage.layout.slices[site].start + k for site, k in jumping(stage)]
    if not at or any(filter is not None for filter in stage.work.filters):
        return None
    found, without = _with_chance(stage, at)
    tried: list[tuple[np.ndarray, np.ndarray]] = []
    for share in SHARES:
        try:
            less = leaving_rest(stage, share)
            if not acting_there(_rms(less, at), _rms(stage, at)).all():
                break
            tried.append(_with_chance(less, at))
        except (NRFError, np.linalg.LinAlgError):  # too few samples are left
            break
    if not tried:
        return None
    best = first_settled(*zip(*tried))
    away, rest = tried[best]
    return SHARES[best] if made_wrong(found, away, rest - without).any() else None


def leaving_rest(stage: Stage, share: float) -> Stage:
    """The same model, fitted without the samples of the search at which a site with a force that jumps is next to
    rest.
    """
    work = stage.work
    kept = np.ones(sum(rows.stop - rows.start for rows in work.spans), dtype=bool)
    for site in {site for site, _ in jumping(stage)}:
        rate = np.concatenate([work.motion(site, b.segment).v[b.rows] for b in work.search])
        kept &= moving(rate / (work.scales(site)[1] or 1.0), share)
    return Stage(work.only(kept), stage.chain, stage.laws)


def _rms(stage: Stage, at: Sequence[int]) -> np.ndarray:
    """Of some columns over the samples of the search that take part."""
    kept = stage.work.kept
    samples = max(sum(rows.stop - rows.start for rows in stage.work.spans) if kept is None else int(kept.sum()), 1)
    return np.sqrt(np.diag(stage.grams.sum(axis=0))[list(at)] / samples)


def _with_chance(stage: Stage, at: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Some coefficients from all blocks, and with each block left out."""
    solution = stage.trial().solve(range(len(stage.work.search)))
    every = np.concatenate([solution.coefficients[site] for site in stage.layout.sites if stage.laws.get(site)])
    parts = stage.slot().jackknife()[:, at]
    if not np.isfinite(parts).all():
        raise NRFError("A block holds too few samples away from rest", "Give longer records.")
    return every[list(at)], parts


__all__ = ["jumping", "leaving_rest", "share_to_leave"]
