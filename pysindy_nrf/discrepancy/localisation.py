"""Where the missing force acts: the pattern of its signs across the balances, and whose motion it follows.

A force f at a site with incidence b leaves ``e = b f`` in the balances (Newton's third law), and what the
baseline's masses and coefficients do wrong to make up for it leaves columns of the baseline. So a
site is judged by

    E_site = min over d and f(t) of  sum_t | e(t) - A(t) d - b f(t) |_W^2

with corrections d of all masses and coefficients (A: the balances' columns, one law for both ends of a
link) and a force f that is free at every instant. It does not matter in which order the baseline
was solved: an error carried along a solve order is a correction d. ``share = 1 - E_site / E_none``.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from ..common.jackknife import variance
from ..exceptions import ChannelError
from ..mechanics.chain import Chain
from ..mechanics.sites import Site
from ..regression.layout import LawLayout
from .characterisation import Basis, Judge, filtered
from .residual import AT_FLOOR, NoiseFloor, Residual
from .words import Location

_PIECE = 1024
# Sites whose own motion is looked at, and sites that come this near to the first.
_FOLLOWED = 8
_NEAR = 0.05


def localise(
    residual: Residual,
    sites: Iterable[Any] | None = None,
    *,
    floor: NoiseFloor | None = None,
    besides: Iterable[Any] = (),
    known_masses: Iterable[int] = (),
    n_blocks: int = 10,
) -> pd.DataFrame:
    """Rank sites by how much of the residual a force there could explain."""
    work = _Work.of(residual, floor, besides, known_masses, n_blocks)
    chosen = (
        _all_sites(residual) if sites is None else list(dict.fromkeys(_site(residual.model.chain, s) for s in sites))
    )
    patterns = {site: work.pattern(site) for site in chosen}
    judged: dict[bytes, _Share] = {}
    rows = {}
    for site, b in patterns.items():
        if b is None:
            rows[site] = [np.nan] * 3
            continue
        key = _key(b)
        if key not in judged:
            judged[key] = work.share(b)
        rows[site] = list(judged[key])
    table = pd.DataFrame.from_dict(rows, orient="index", columns=["share", "low", "high"]) * 100
    table["own"], table["rms"] = np.nan, np.nan
    table = table.sort_values("share", ascending=False, kind="stable")
    followed = [] if work.at_floor else [Site(s) for s in table.index[: 2 * _FOLLOWED]]
    for site in followed:
        if (
            np.isfinite(table.loc[site, "share"])
            and table.loc[site, "share"] >= table["share"].iloc[0] - 100 * _NEAR * 6
        ):
            table.loc[site, ["own", "rms"]] = work.own(site, patterns[site])
    _settle(table, patterns)
    # equal patterns have equal shares; the force's own motion puts them in order
    table["tie"] = table["share"].round(6)
    table = table.sort_values(["tie", "own"], ascending=False, kind="stable", na_position="last").drop(columns="tie")
    table[["share", "low", "high"]] = table[["share", "low", "high"]].clip(0.0, 100.0)
    table["balances"] = [_signs(residual.model.chain, Site(s)) for s in table.index]
    _verdicts(table, patterns, work)
    return table


_Share = tuple[float, float, float]


def _site(chain: Chain, text: Any) -> Site:
    site = Site(text)
    return site if site.kind == "sensor" else chain.site(site)


def _all_sites(residual: Residual) -> list[Site]:
    chain = residual.model.chain
    n = chain.n_dof
    names: list[Any] = [*chain.sites, *range(1, n + 1)]
    names += [f"link {p}-{q}" for p in range(3, n + 1) for q in range(1, p - 1)]
    names += [f"ground {j}" for j in range(2, n + 1)]
    names += [f"dof {j}" for j in range(1, n + 1)]
    names += [f"sensor a{j}" for j in range(1, n + 1)] + [f"sensor F{j}" for j in residual.data.forced]
    return list(dict.fromkeys(Site(s) for s in names))


def _incidence(chain: Chain, site: Site) -> np.ndarray:
    """Signs of a site in the balances; an acceleration or force sensor is felt in the balance of its DOF."""
    if site.kind != "sensor":
        return chain.incidence([site])[:, 0]
    kind, number = site.channel[:1], site.channel[1:]
    if kind not in ("a", "F") or not number.isdigit() or not 1 <= int(number) <= chain.n_dof:
        raise ChannelError(
            f"{str(site)!r} is not felt in one balance", f"Sensors 'a1'.. and 'F1'.. up to {chain.n_dof} can be judged."
        )
    return (np.arange(1, chain.n_dof + 1) == int(number)).astype(float)


@dataclass
class _Work:
    """Gram matrices of all columns, block by block, and the weights of the balances."""

    residual: Residual
    known: np.ndarray
    owners: np.ndarray
    grams: np.ndarray
    sizes: np.ndarray
    weight: np.ndarray
    noise: np.ndarray | None
    besides: np.ndarray
    forced: np.ndarray
    held: np.ndarray
    values: np.ndarray
    _cut: dict[bytes, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        residual: Residual,
        floor: NoiseFloor | None,
        besides: Iterable[Any],
        known_masses: Iterable[int],
        n_blocks: int,
    ) -> _Work:
        model, chain = residual.model, residual.model.chain
        known = np.flatnonzero(residual.known.all(axis=0))
        if not len(known):
            raise ChannelError(
                "No balance is known in every record", "Judge records with different unknown forces one by one."
            )
        n = model.n_dof
        layout = LawLayout(chain, model.laws)
        signs = chain.incidence(layout.sites)
        terms = [signs[:, k] for k, site in enumerate(layout.sites) for _ in range(layout.counts[site])]
        # owners: how each column enters the balances - laws, masses, residuals
        owners = np.column_stack([*terms, np.eye(n), np.eye(n)])[known]
        grams, sizes = _grams(residual, layout, n_blocks)
        noise = None
        weight: np.ndarray = np.diag(1.0 / residual.scale[known] ** 2)
        if floor is not None:
            sigma = floor.covariance()[np.ix_(known, known)]
            if np.isfinite(sigma).all() and (np.diag(sigma) > 0).all():
                noise = 0.9 * sigma + 0.1 * np.diag(np.diag(sigma))
                weight = np.linalg.inv(noise)
        blamed = [_incidence(chain, _site(chain, s))[known] for s in besides]
        forced = np.array([j + 1 in residual.data.forced for j in known])
        # without any force, masses that were given scale the chain
        held = np.array([j in set(known_masses) or not forced.any() for j in range(1, n + 1)])
        coefficients = model.coefficients
        values = np.concatenate([*(coefficients[site] for site in layout.acting), model.masses])
        return cls(
            residual,
            known,
            owners,
            grams,
            sizes,
            weight,
            noise,
            np.array(blamed).reshape(len(blamed), len(known)).T,
            forced,
            held,
            values,
        )

    def pattern(self, site: Site) -> np.ndarray | None:
        """Signs in the known balances, or None if the site touches none."""
        b = _incidence(self.residual.model.chain, site)[self.known]
        return b if b.any() else None

    def _patterns(self, b: np.ndarray | None) -> np.ndarray:
        return self.besides if b is None else np.column_stack([self.besides, b])

    def _form(self, b: np.ndarray | None) -> np.ndarray:
        """Weights of what a free force with a pattern (and the sites blamed before) leaves."""
        B, W = self._patterns(b), self.weight
        if not B.shape[1]:
            return W
        WB = W @ B
        return W - WB @ np.linalg.pinv(B.T @ WB, hermitian=True) @ WB.T

    def _correct(self, b: np.ndarray | None, gram: np.ndarray) -> tuple[np.ndarray, float]:
        """Corrections of all terms and masses, and the squares left."""
        n, Q = self.residual.n_dof, self._form(b)
        form = (self.owners.T @ Q @ self.owners) * gram
        k = form.shape[0] - n
        target = np.zeros(form.shape[0])
        target[k:] = 1.0
        free = np.ones(k, dtype=bool)
        free[k - n :] = self._free_masses(b)
        whole = float(target @ form @ target)
        A, h = form[:k, :k][np.ix_(free, free)], (form @ target)[:k][free]
        size = np.sqrt(np.maximum(np.diag(A), 0.0))
        size[size <= 1e-12 * np.sqrt(np.diag(gram)[:k][free] * np.trace(self.weight))] = np.inf
        values, vectors = np.linalg.eigh(A / np.outer(size, size))
        keep = values > 1e-11 * max(values[-1], 1e-300)
        d = vectors[:, keep] @ ((vectors[:, keep].T @ (h / size)) / values[keep]) / size
        delta = np.zeros(k)
        delta[free] = d
        return delta, max(whole - float(h @ d), 0.0)

    def _pieces(self, b: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Pieces into which free forces cut the chain."""
        from scipy.sparse.csgraph import connected_components

        if _key(b) in self._cut:
            return self._cut[_key(b)]
        B = self._patterns(b)
        single = np.count_nonzero(B, axis=0) == 1
        seen = np.logical_not(B[:, single].any(axis=1))
        ties = np.abs(np.column_stack([self.owners[:, : -2 * self.residual.n_dof], B[:, ~single]])) * seen[:, None]
        piece = np.where(seen, connected_components(ties @ ties.T)[1], -1)
        self._cut[_key(b)] = piece, np.isin(piece, piece[self.forced & seen])
        return self._cut[_key(b)]

    def _free_masses(self, b: np.ndarray | None) -> np.ndarray:
        """DOFs whose mass is corrected: all but one, the largest, of a piece that nothing scales."""
        piece, scaled = self._pieces(b)
        masses = self.residual.model.masses
        out = np.zeros(self.residual.n_dof, dtype=bool)
        out[self.known] = piece >= 0
        for p in np.unique(piece[(piece >= 0) & ~scaled]):
            dofs = self.known[piece == p]
            out[dofs[np.abs(masses[dofs]).argmax()]] = False
        return out & ~self.held

    def _left(self, b: np.ndarray | None, gram: np.ndarray, size: float) -> float:
        left = self._correct(b, gram)[1] / size
        return left if self.noise is None else left - float(np.trace(self._form(b) @ self.noise))

    @cached_property
    def over_floor(self) -> float:
        """Residual of all balances over what noise leaves of them; NaN where the noise is not known."""
        if self.noise is None:
            return np.nan
        expected = float(np.trace(self._form(None) @ self.noise))
        left = self._left(None, self.grams.sum(axis=0), self.sizes.sum())
        return float(np.sqrt(max(left / expected + 1.0, 0.0))) if expected > 0 else np.inf

    @property
    def at_floor(self) -> bool:
        """Whether noise or rounding explains the residual."""
        return self.residual.is_round_off if self.noise is None else self.over_floor < AT_FLOOR

    def share(self, b: np.ndarray) -> _Share:
        """Share of the squares that a pattern explains, with a band."""
        gram, size = self.grams.sum(axis=0), float(self.sizes.sum())

        def one(g: np.ndarray, m: float) -> float:
            whole = self._left(None, g, m)
            return 1.0 - self._left(b, g, m) / whole if whole > 0 else np.nan

        value = one(gram, size)
        error = float("nan")
        if len(self.sizes) > 2:
            rest = np.array([one(gram - g, size - m) for g, m in zip(self.grams, self.sizes)])
            error = float(np.sqrt(variance(rest)))
        return value, value - 2 * error, value + 2 * error

    # -- the force itself, and whose motion it follows --------------------------------------------

    def force(self, b: np.ndarray) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """The free force with a pattern along every record (N), and columns it may hold any multiple of."""
        residual = self.residual
        delta, _ = self._correct(b, self.grams.sum(axis=0))
        k = len(delta)
        weights = self.weight @ b / (b @ self.weight @ b)
        correction = (weights @ self.owners[:, :k]) * delta
        theta = self.values + delta
        piece, scaled = self._pieces(b)
        loose = [
            (weights @ self.owners[:, :k]) * theta * (self.owners[piece == p, :k] != 0).any(axis=0)
            for p in np.unique(piece[(piece >= 0) & ~scaled])
            if not self.held[self.known[piece == p]].any()
        ]
        # columns that enter the balances like the force itself: nothing else can tell their coefficients
        alone = np.array([np.abs(o).sum() > 0 and np.allclose(o, (o @ b) / (b @ b) * b) for o in self.owners[:, :k].T])
        alone[k - residual.n_dof :] &= ~self.held
        layout = LawLayout(residual.model.chain, residual.model.laws)
        force, base = [], []
        for i, (seg, filter) in enumerate(zip(residual.data.segments, residual.filters)):
            blocks = list(seg.blocks(layout, filter=filter))
            every = np.vstack([np.hstack([block.terms.T, block.acceleration.T]) for block in blocks])
            force.append(residual.balance[i][:, self.known] @ weights - every @ correction)
            base.append(np.column_stack([every[:, alone], *(every @ c for c in loose)]))
        return force, base

    def own(self, site: Site, b: np.ndarray | None) -> tuple[float, float]:
        """Share of the free force that its own motion explains, percent, and its rms, N."""
        assert b is not None
        force, base = self.force(b)
        rms = float(np.sqrt(np.mean(np.concatenate(force) ** 2)))
        if site.kind == "dof" or rms == 0:
            return np.nan, rms
        columns = _Own(site, self.residual)
        own = [filtered(columns.of(i), filter) for i, filter in enumerate(self.residual.filters)]
        share, _ = Judge(force, {"base": base, "own": own}).share(["own"], ["base"])
        return 100 * max(share, 0.0), rms


def missing_force(
    residual: Residual,
    site: Any,
    *,
    floor: NoiseFloor | None = None,
    besides: Iterable[Any] = (),
    known_masses: Iterable[int] = (),
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """The force that is missing if it acts at one site, freed of what the baseline does wrong to make up for it."""
    work = _Work.of(residual, floor, besides, known_masses, 10)
    place = _site(residual.model.chain, site)
    b = work.pattern(place)
    if b is None:
        raise ChannelError(f"{place} is not seen in the known balances", "Give the force on its DOFs.")
    return work.force(b)


class _Own:
    """Columns that a force at a site would follow: its own motion, or the derivative of its channel."""

    def __init__(self, site: Site, residual: Residual) -> None:
        self.site, self.segments = site, residual.data.segments
        if site.kind == "link":
            self.motions = [seg.motion(site, seg.valid) for seg in self.segments]
            self.basis = Basis(self.motions)

    def of(self, record: int) -> np.ndarray:
        """Columns along one record."""
        seg = self.segments[record]
        if self.site.kind == "dof":
            return np.zeros((seg.n_valid, 0))
        if self.site.kind == "link":
            m = self.motions[record]
            return np.column_stack([m.s, m.v, self.basis.path(m)])
        line = seg.a if self.site.channel[0] == "a" else seg.F
        return np.gradient(line[seg.valid, int(self.site.channel[1:]) - 1].astype(float))[:, None]


def _grams(residual: Residual, layout: LawLayout, n_blocks: int) -> tuple[np.ndarray, np.ndarray]:
    """Gram matrices of ``[terms | a | e]`` over contiguous blocks, and their samples."""
    pieces, sizes = [], []
    for seg, filter, e in zip(residual.data.segments, residual.filters, residual.balance):
        at = 0
        e = np.nan_to_num(e).T
        for block in seg.blocks(layout, filter=filter):
            width = block.acceleration.shape[1]
            rows = np.vstack([block.terms, block.acceleration, e[:, at : at + width]])
            at += width
            for piece in np.array_split(rows, max(1, width // _PIECE), axis=1):
                pieces.append(piece @ piece.T)
                sizes.append(piece.shape[1])
    groups = np.array_split(np.arange(len(pieces)), min(n_blocks, len(pieces)))
    return np.array([sum(pieces[k] for k in g) for g in groups]), np.array(
        [sum(sizes[k] for k in g) for g in groups], dtype=float
    )


def _key(b: np.ndarray | None) -> bytes:
    return b"" if b is None else (b if b[np.flatnonzero(b)[0]] > 0 else 0.0 - b).tobytes()


def _settle(table: pd.DataFrame, patterns: dict[Site, np.ndarray | None]) -> None:
    """A force at a DOF from outside is what follows none of the motions and channels with the same pattern."""
    every = [Site(s) for s in table.index]
    for site in every:
        if site.kind == "dof" and np.isfinite(table.loc[site, "rms"]):
            same = [s for s in every if s.kind != "dof" and _key(patterns[s]) == _key(patterns[site])]
            followed = table.loc[same, "own"].max() if same else 0.0
            table.loc[site, "own"] = 100.0 - min(max(np.nan_to_num(followed), 0.0), 100.0)


def _signs(chain: Chain, site: Site) -> str:
    b = _incidence(chain, site)
    return ", ".join(f"{'+' if x > 0 else '-'}{j + 1}" for j, x in enumerate(b) if x)


def _verdicts(table: pd.DataFrame, patterns: dict[Site, np.ndarray | None], work: _Work) -> None:
    """Columns ``verdict``, ``pattern``, ``near`` and ``over floor`` of the table of sites, best first."""
    every = [Site(s) for s in table.index]
    keys = [_key(patterns[site]) for site in every]
    table["pattern"] = [keys.index(key) for key in keys]
    table["near"], table["over floor"] = False, work.over_floor
    if work.at_floor:
        table["verdict"] = Location.NOTHING
        return
    located = Location.ONE_BALANCE if len(work.known) == 1 else Location.EXPLAINS
    table["verdict"] = [
        located if np.isfinite(share) else Location.UNSEEN if patterns[site] is None else Location.UNKNOWN
        for site, share in zip(every, table["share"])
    ]
    best = table.iloc[0]
    table["near"] = (best["share"] - table["share"] < 100 * _NEAR) | (table["high"] > best["low"])
