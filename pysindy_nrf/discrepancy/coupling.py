"""Is a storey's residual a function of its own motion? If not, no law of a chain explains it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..laws import Jenkins
from ..laws.shape import Motion
from ..mechanics.sites import Site
from . import words
from .dependence import Judge, filtered
from .noise_floor import NoiseFloor
from .residual import ROUND_OFF, Residual

# A storey is looked at where its residual is so many times the noise floor.
_LOUD = 2.0
# Share of it that laws of the storey's own motion may explain, without and with a sign of coupling; and that the
# others' motion must explain then, by so many standard errors.
_OWN, _ALL, _OTHERS, _SURELY = 0.5, 0.95, 0.05, 2.0
_BLOCKS, _FOLDS = 60, 10
# Yield drifts of the sliders that stand for the path, in multiples of the rms drift.
_YIELD = (0.15, 0.6, 1.6, 4.0)


@dataclass(frozen=True)
class Coupling:
    """What is left of a storey's force although no law of a chain can explain it.

    Attributes
    ----------
    storey : int
    percent : float
        Size of the residual, percent of the force across the storey's cut.
    own : float
        Share of its variance that laws of the storey's own drift, rate and path explain, on data left out.
    others : float
        Share of the rest that is linear in the drifts and rates of the other storeys, on data left out.
    error : float
        Standard error of that.
    """

    storey: int
    percent: float
    own: float
    others: float
    error: float

    @property
    def coupled(self) -> bool:
        """Whether the other storeys surely take part."""
        return self.others >= _OTHERS and self.others > _SURELY * self.error

    def __str__(self) -> str:
        return words.coupling(self)


def couplings(residual: Residual, floor: NoiseFloor | None = None) -> list[Coupling]:
    r"""Storeys whose residual is no function of their own motion, the loudest first."""
    n, data = residual.n_dof, residual.data
    found = []
    for i in range(1, n + 1):
        name = f"storey {i}"
        force, size = residual.at(name), residual.sizes.loc[name]
        use = [k for k, e in enumerate(force) if np.isfinite(e).all() and e.any()]
        if not use or size["rms"] <= ROUND_OFF * size["reference"]:
            continue
        if floor is not None and not size["rms"] > _LOUD * floor.at(name):
            continue
        segments, filters = [data.segments[k] for k in use], [residual.filters[k] for k in use]
        motions = [seg.motion(Site(i), seg.valid) for seg in segments]
        scale = float(np.sqrt(np.mean(np.concatenate([m.s for m in motions]) ** 2))) or 1.0
        rest = [j for j in range(n) if j != i - 1]
        moves = [np.hstack([seg.s[seg.valid][:, rest], seg.v[seg.valid][:, rest]]).astype(float) for seg in segments]
        groups = {
            "linear": [filtered(np.column_stack([m.s, m.v]), f) for m, f in zip(motions, filters)],
            "law": [filtered(_own(m, scale), f) for m, f in zip(motions, filters)],
            "others": [filtered(x, f) for x, f in zip(moves, filters)],
        }
        if not rest:
            del groups["others"]
        judge = Judge([force[k] for k in use], groups, _BLOCKS, _FOLDS)
        # columns that explain nothing on data left out only add to what is left
        tried = {names: judge.share(names)[0] for names in (("linear",), ("linear", "law"))}
        own = max(tried, key=lambda names: tried[names])
        beside = own if tried[own] > 0 else ()
        others, error = judge.share(["others"], beside=list(beside)) if rest else (0.0, 0.0)
        one = Coupling(i, float(size["percent"]), tried[own], others, error)
        if one.own < _OWN or (one.coupled and one.own < _ALL):
            found.append(one)
    return sorted(found, key=lambda c: -c.percent)


def _own(m: Motion, scale: float) -> np.ndarray:
    """Columns for laws of a storey's own motion: friction, damping, springs, yielding."""
    still = Motion(m.s, m.v, m.a)
    sliders = [Jenkins(uy=share * scale, Fy=1.0).features(still) for share in _YIELD]
    return np.column_stack([np.sign(m.v), m.v * np.abs(m.v), m.s**2, m.s**3, *sliders])
