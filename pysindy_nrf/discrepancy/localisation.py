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
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
from scipy.sparse.csgraph import connected_components

from ..common.jackknife import variance
from ..exceptions import ChannelError
from ..mechanics.chain import Chain
from ..mechanics.sites import Site
from ..regression.layout import LawLayout
from .characterisation import Judge, filtered, own_columns, thinning
from .residual import AT_FLOOR, NoiseFloor, Residual
from .words import Location

_PIECE, _BLOCKS = 1024, 10
# Sites that come this near to the first: it is hardly told from them, and their own motion is looked at.
NEAR = 5.0


def localise(
    residual: Residual,
    sites: Iterable[Any] | None = None,
    *,
    floor: NoiseFloor | None = None,
    known_masses: Iterable[int] = (),
) -> pd.DataFrame:
    """Rank sites by how much of the residual a force there could explain."""
    return Localiser(residual, floor, known_masses).table(sites)


class Localiser:
    """Gram matrices of all columns, block by block, and the weights of the balances."""

    def __init__(self, residual: Residual, floor: NoiseFloor | None = None, known_masses: Iterable[int] = ()) -> None:
        model, chain, n = residual.model, residual.model.chain, residual.n_dof
        self.residual, self.chain = residual, chain
        self._cut: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}
        self.known = np.flatnonzero(residual.known.all(axis=0))
        if not len(self.known):
            raise ChannelError(
                "No balance is known in every record", "Judge records with different unknown forces one by one."
            )
        layout = LawLayout(chain, model.laws)
        signs = chain.incidence(layout.sites)
        terms = [signs[:, k] for k, site in enumerate(layout.sites) for _ in range(layout.counts[site])]
        # how each column enters the balances - laws, masses, residuals
        self.owners = np.column_stack([*terms, np.eye(n), np.eye(n)])[self.known]
        self.noise: np.ndarray | None = None
        self.weight: np.ndarray = np.diag(1.0 / residual.scale[self.known] ** 2)
        if floor is not None:
            sigma = floor.covariance()[np.ix_(self.known, self.known)]
            if np.isfinite(sigma).all() and (np.diag(sigma) > 0).all():
                self.noise = 0.9 * sigma + 0.1 * np.diag(np.diag(sigma))
                self.weight = np.linalg.inv(self.noise)
        self.forced = np.array([j + 1 in residual.data.forced for j in self.known])
        # without any force, masses that were given scale the chain
        self.held = np.array([j in set(known_masses) or not self.forced.any() for j in range(1, n + 1)])
        coefficients = model.coefficients
        self.values = np.concatenate([*(coefficients[site] for site in layout.acting), model.masses])
        self.columns = []
        for seg, filter in zip(residual.data.segments, residual.filters):
            blocks = list(seg.blocks(layout, filter=filter))
            self.columns.append(np.hstack([np.vstack([block.terms, block.acceleration]) for block in blocks]))
        pieces = []
        for columns, e in zip(self.columns, residual.balance):
            rows = np.vstack([columns, np.nan_to_num(e).T])
            pieces += np.array_split(rows, max(1, rows.shape[1] // _PIECE), axis=1)
        groups = np.array_split(np.arange(len(pieces)), min(_BLOCKS, len(pieces)))
        self.grams = np.array([sum(pieces[k] @ pieces[k].T for k in g) for g in groups])
        self.sizes = np.array([sum(pieces[k].shape[1] for k in g) for g in groups], dtype=float)

    # -- the table ------------------------------------------------------------------------------

    def table(self, sites: Iterable[Any] | None = None) -> pd.DataFrame:
        """Sites, best first, with their shares (percent, about 95 %), their own motion's share, and verdicts."""
        sites = all_sites(self.residual) if sites is None else sites
        chosen = list(dict.fromkeys(_site(self.chain, s) for s in sites))
        patterns = {site: self.pattern(site) for site in chosen}
        keys = {site: _key(b) for site, b in patterns.items()}
        told = {keys[site]: b for site, b in patterns.items() if b is not None}
        shares = {key: self.share(b) for key, b in told.items()}
        rows = [shares.get(keys[site], (np.nan,) * 3) for site in chosen]
        table = pd.DataFrame(rows, chosen, columns=["share", "low", "high"]) * 100
        table["own"] = np.nan
        if not self.at_floor:
            near = [Site(s) for s in table.index[table["share"] >= table["share"].max() - NEAR]]
            for site in near:
                table.loc[site, "own"] = self.own(site, patterns[site])
            for site in (site for site in near if site.kind == "dof"):
                # a force at a DOF from outside is what follows none of the motions and channels with its pattern
                alike = [s for s in near if s.kind != "dof" and keys[s] == keys[site]]
                followed = table.loc[alike, "own"].max() if alike else 0.0
                table.loc[site, "own"] = 100.0 - np.clip(np.nan_to_num(followed), 0.0, 100.0)
        # equal patterns have equal shares; the force's own motion puts them in order
        table["tie"] = table["share"].round(6)
        table = table.sort_values(["tie", "own"], ascending=False, kind="stable", na_position="last")
        table = table.drop(columns="tie")
        table[["share", "low", "high"]] = table[["share", "low", "high"]].clip(0.0, 100.0)
        table["balances"] = [_signs(self.chain, Site(site)) for site in table.index]
        order = [keys[Site(site)] for site in table.index]
        table["pattern"] = [order.index(key) for key in order]
        best = table.iloc[0]
        table["near"] = ~self.at_floor & ((best["share"] - table["share"] < NEAR) | (table["high"] > best["low"]))
        table["over floor"] = self.over_floor
        located = Location.ONE_BALANCE if len(self.known) == 1 else Location.EXPLAINS
        table["verdict"] = [
            Location.NOTHING if self.at_floor
            else located if np.isfinite(share)
            else Location.UNSEEN if patterns[Site(site)] is None else Location.UNKNOWN
            for site, share in table["share"].items()
        ]  # fmt: skip
        return table

    def pattern(self, site: Site) -> np.ndarray | None:
        """Signs in the known balances, or None if the site touches none."""
        b = _incidence(self.chain, site)[self.known]
        return b if b.any() else None

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

    # -- corrections of the baseline ------------------------------------------------------------

    def _form(self, b: np.ndarray | None) -> np.ndarray:
        """Weights of what a free force with a pattern leaves."""
        if b is None:
            return self.weight
        Wb = self.weight @ b
        return self.weight - np.outer(Wb, Wb) / (b @ Wb)

    def _correct(self, b: np.ndarray | None, gram: np.ndarray) -> tuple[np.ndarray, float]:
        """Corrections of all terms and masses, and the squares left."""
        n = self.residual.n_dof
        form = (self.owners.T @ self._form(b) @ self.owners) * gram
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
        """Pieces into which a free force cuts the chain: the number of each balance's, and where a force scales it."""
        if _key(b) in self._cut:
            return self._cut[_key(b)]
        ties, seen = self.owners[:, : -2 * self.residual.n_dof], np.ones(len(self.known), dtype=bool)
        if b is not None and np.count_nonzero(b) == 1:
            seen = np.equal(b, 0)
        elif b is not None:
            ties = np.column_stack([ties, b])
        ties = np.abs(ties) * seen[:, None]
        piece = np.where(seen, connected_components(ties @ ties.T)[1], -1)
        return self._cut.setdefault(_key(b), (piece, np.isin(piece, piece[self.forced & seen])))

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
    def _parts(self) -> list[tuple[np.ndarray, float, float]]:
        """All blocks, then all but one: Gram matrix, samples, and what is left there without any force."""
        gram, size = self.grams.sum(axis=0), float(self.sizes.sum())
        parts = [(gram, size), *((gram - g, size - m) for g, m in zip(self.grams, self.sizes) if len(self.sizes) > 2)]
        return [(g, m, self._left(None, g, m)) for g, m in parts]

    def share(self, b: np.ndarray) -> tuple[float, float, float]:
        """Share of the squares that a pattern explains, with a band of two standard errors (jackknife)."""
        value, *rest = (1.0 - self._left(b, g, m) / left if left > 0 else np.nan for g, m, left in self._parts)
        error = 2 * float(np.sqrt(variance(rest))) if rest else np.nan
        return value, value - error, value + error

    # -- the force itself, and whose motion it follows ------------------------------------------

    def force(self, site: Any) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """The force that is missing if it acts at one site, freed of what the baseline does wrong to make up for it.

        Along every record, N, with columns that it may hold any multiple of.
        """
        place = _site(self.chain, site)
        b = self.pattern(place)
        if b is None:
            raise ChannelError(f"{place} is not seen in the known balances", "Give the force on its DOFs.")
        delta, _ = self._correct(b, self.grams.sum(axis=0))
        k = len(delta)
        weights = self.weight @ b / (b @ self.weight @ b)
        theta, owners = self.values + delta, self.owners[:, :k]
        piece, scaled = self._pieces(b)
        loose = [
            (weights @ owners) * theta * (owners[piece == p] != 0).any(axis=0)
            for p in np.unique(piece[(piece >= 0) & ~scaled])
            if not self.held[self.known[piece == p]].any()
        ]
        # columns that enter the balances like the force itself: nothing else can tell their coefficients
        alone = np.array([np.abs(o).sum() > 0 and np.allclose(o, (o @ b) / (b @ b) * b) for o in owners.T])
        alone[k - self.residual.n_dof :] &= ~self.held
        force, base = [], []
        for columns, e in zip(self.columns, self.residual.balance):
            force.append(e[:, self.known] @ weights - ((weights @ owners) * delta) @ columns)
            base.append(np.column_stack([columns[alone].T, *(c @ columns for c in loose)]))
        return force, base

    def own(self, site: Site, b: np.ndarray | None) -> float:
        """Share of the free force that its own motion, or a delay of its channel, explains; percent."""
        if site.kind == "dof" or b is None:
            return np.nan
        force, base = self.force(site)
        if not any(f.any() for f in force):
            return np.nan
        segments, filters = self.residual.data.segments, self.residual.filters
        every = 1
        if site.kind == "link":
            motions = [seg.motion(site, seg.valid) for seg in segments]
            every = thinning([m.s for m in motions])
            linear = [filtered(np.column_stack([m.s, m.v]), f)[::every] for m, f in zip(motions, filters)]
            own = [np.hstack(pair) for pair in zip(linear, own_columns(motions, filters, every))]
        else:
            kind, j = site.channel[0], int(site.channel[1:]) - 1
            lines = [(seg.a if kind == "a" else seg.F)[seg.valid, j].astype(float) for seg in segments]
            own = [filtered(np.gradient(x)[:, None], f) for x, f in zip(lines, filters)]
        judge = Judge([f[::every] for f in force], {"base": [x[::every] for x in base], "own": own})
        return 100 * max(judge.share(["own"], ["base"])[0], 0.0)


def all_sites(residual: Residual) -> list[Site]:
    """Sites of the chain, all storeys, links, ground links and DOFs, and the sensors felt in one balance."""
    chain = residual.model.chain
    n = chain.n_dof
    names: list[Any] = [*chain.sites, *range(1, n + 1)]
    names += [f"link {p}-{q}" for p in range(3, n + 1) for q in range(1, p - 1)]
    names += [f"ground {j}" for j in range(2, n + 1)]
    names += [f"dof {j}" for j in range(1, n + 1)]
    names += [f"sensor a{j}" for j in range(1, n + 1)] + [f"sensor F{j}" for j in residual.data.forced]
    return list(dict.fromkeys(Site(s) for s in names))


def _site(chain: Chain, text: Any) -> Site:
    site = Site(text)
    return site if site.kind == "sensor" else chain.site(site)


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


def _key(b: np.ndarray | None) -> bytes:
    return b"" if b is None else (b if b[np.flatnonzero(b)[0]] > 0 else 0.0 - b).tobytes()


def _signs(chain: Chain, site: Site) -> str:
    b = _incidence(chain, site)
    return ", ".join(f"{'+' if x > 0 else '-'}{j + 1}" for j, x in enumerate(b) if x)
