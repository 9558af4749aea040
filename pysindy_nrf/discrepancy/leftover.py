"""What an effect leaves at its site that is a function of the motion there: the law's shape is then not the effect's.

The error of all balances together hardly tells a force that grows with the third root of the rate from friction. What
is left of it at its site, drawn over the rate, does.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..exceptions import NRFError
from ..mechanics.sites import Site
from .dependence import Basis, Judge, filtered
from .evidence import searched_residual
from .residual import rms
from .stage import Stage

# Standard errors by which a function must explain something on data left out. One is enough: in a sweep a single block
# shows it, and the surrogates say what noise draws.
_CLEARLY = 1.0
# Share of an effect beyond the terms of the storey, below which it is one of them.
_LINEAR = 1e-6
# How far what noise draws may be from what it drew on the surrogates.
_SCATTER = 1.5
_PLAIN = ("constant", "linear")
_FUNCTIONS = ("v", "s", "s and v")


def leftover(stage: Stage, noise: Sequence[Stage], places: Sequence[tuple[Site, int]]) -> float:
    """What is left as a function of drift and rate where some effects act, as a share of all of them."""
    where = _where(places[0][0]) if places else None
    if where is None:
        return 0.0
    try:
        found = _share(stage, where, places)
        by_noise = max((_share(one, where, places) for one in noise), default=0.0)
    except (NRFError, np.linalg.LinAlgError):
        return 0.0
    return float(np.sqrt(max(found**2 - (_SCATTER * by_noise) ** 2, 0.0)))


def _where(site: Site) -> str | None:
    """Which residual shows what a site lacks: that of its storey, or of the balance of its one floor."""
    if site.kind == "link" and site.q == site.p - 1:
        return str(site)
    return f"dof {site.p}" if site.kind == "dof" or site.q == 0 else None


def _share(stage: Stage, where: str, places: Sequence[tuple[Site, int]]) -> float:
    """The same without a look at noise."""
    trial = stage.trial()
    residual = searched_residual(stage.work, trial.model())
    force = residual.at(where)
    filters = residual.filters
    segments = residual.data.segments
    motions = [seg.motion(places[0][0], seg.valid) for seg in segments]
    coefficients = trial.solve(range(len(stage.work.search))).coefficients
    effect = [np.zeros(m.n_samples) for m in motions]
    for site, number in places:
        law, at = stage.laws[site][number], stage.at[site, number] - trial.layout.slices[site].start
        for out, seg, filter in zip(effect, segments, filters):
            motion = seg.motion(site, seg.valid)
            columns = law.features(motion).reshape(motion.n_samples, -1)
            out += filtered(columns, filter) @ coefficients[site][at : at + columns.shape[1]]
    basis = Basis(motions)
    makers = {
        "constant": lambda m: np.ones((m.n_samples, 1)), "linear": basis.linear, "v": basis.rate, "s": basis.drift,
        "s and v": basis.surface,
    }  # fmt: skip
    groups = {k: [filtered(make(m), f) for m, f in zip(motions, filters)] for k, make in makers.items()}
    whole = Judge(effect, {"linear": groups["linear"]}).held_out(["linear"]).sum()
    if whole < _LINEAR:  # a law that the model's own terms hold: it is as large as it is
        whole = 1.0
    size = float(rms([e[:, None] for e in effect])[0]) * np.sqrt(whole)
    if not np.isfinite(np.concatenate(force)).all() or not size > 0:
        return 0.0
    judge = Judge(force, groups)
    plain = judge.held_out(_PLAIN).sum()
    shares = [share for share, error in (judge.share([k], _PLAIN) for k in _FUNCTIONS) if share > _CLEARLY * error]
    left = float(rms([f[:, None] for f in force])[0]) * np.sqrt(plain * max(shares, default=0.0))
    return float(left / size)


__all__ = ["leftover"]
