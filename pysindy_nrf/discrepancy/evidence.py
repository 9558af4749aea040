"""What the data say of the residual before any law is tried: is it noise, where does it
act, what is it like.

The loop gathers this for the baseline and after every accepted effect, on the search
data alone. It informs the page and decides nothing. One residual, one regression: what
the motion explains of it tells noise from what is missing; what a free force with the
signs of a site explains tells where it acts.

A force f at a site with incidence b leaves ``e = b f`` in the balances (Newton's third
law), and what the baseline's masses and coefficients do wrong to make up for it leaves
columns of the baseline. So a site is judged by

    E_site = min over d and f(t) of  sum_t | e(t) - A(t) d - b f(t) |_W^2

with corrections d of all masses and coefficients (A: the balances' columns, one law for
both ends of a link) and a force f that is free at every instant. It does not matter in
which order the baseline was solved: an error carried along a solve order is a
correction d. ``share = 1 - E_site / E_none``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
from scipy.sparse.csgraph import connected_components

from ..chain.layout import LawLayout
from ..chain.model import ChainModel
from ..chain.sites import Site
from ..chain.structure import Chain
from ..diagnosis.residual import Residual
from ..equations.balances import blocks_of_segment
from ..equations.normal_equations import Regression, in_blocks, share_of
from ..exceptions import ChannelError, NRFError
from . import words
from .characterisation import (
    Characterisation,
    characterise,
    filtered,
    own_columns,
    thinning,
)
from .constants import AT_FLOOR, FAR, FLOOR, NEARLY
from .prepare import Workspace
from .residual import NoiseFloor, searched_residual
from .words import Location, Obstacle, ResidualKind

# -- is it noise ---------------------------------------------------------------


@dataclass
class Detection:
    """What the residual of every balance and storey holds.

    ``verdicts`` has rows ``"dof j"`` and ``"storey i"``; columns ``verdict`` (a
    ``ResidualKind``), ``percent`` (of the reference), ``floor ratio`` (rms over that of
    the noise floor), ``linear share`` (of the squares that drifts, rates and inputs
    explain on data left out) and ``nonlinear share`` (of the rest, by laws of the
    site's own motion).
    """

    verdicts: pd.DataFrame

    @property
    def is_noise(self) -> bool:
        """Whether nothing but noise is left in any balance."""
        return bool((self.verdicts["verdict"] == ResidualKind.NOISE).all())


def detect(residual: Residual, floor: NoiseFloor | None = None) -> Detection:
    """Ask of every balance and storey what the motion explains beyond what it explains
    of noise alone.
    """
    if not isinstance(residual, Residual):
        raise NRFError(
            f"{type(residual).__name__} is not a residual",
            "Make one with residual_of(model, data).",
        )
    segments = residual.data.segments
    every = min(
        thinning([seg.s[seg.valid, i] for seg in segments])
        for i in range(residual.n_dof)
    )
    chain, noise = (
        residual.model.chain,
        (NoiseFloor(np.empty(0), np.empty(0)) if floor is None else floor),
    )
    draws = [
        _Motion(r, chain, every) for r in noise.draws
    ]  # their model may be one of fewer sites
    sides = [
        _Motion(residual, chain, every),
        *noise.motions.setdefault((chain.sites, every), draws),
    ]
    rows: dict[str, dict[str, Any]] = {}
    for where, size in residual.sizes[np.isfinite(residual.sizes["rms"])].iterrows():
        ratio = (
            size["rms"] / floor.at(where)
            if floor is not None and floor.at(where) > 0
            else np.nan
        )
        row = {
            "verdict": ResidualKind.NOISE,
            "percent": size["percent"],
            "floor ratio": ratio,
        }
        if size["rms"] > FLOOR * size["reference"]:
            row |= _verdict(sides, where, ratio)
        rows[where] = row
    columns = ["verdict", "percent", "floor ratio", "linear share", "nonlinear share"]
    return Detection(
        pd.DataFrame.from_dict(rows, orient="index").reindex(columns=columns)
    )


def _verdict(sides: list[_Motion], where: str, ratio: float) -> dict[str, Any]:
    """What one balance or storey holds; squares that the motion explains of noise alone
    are taken off.
    """
    base, laws = ["motion", "inputs"], sides[0].laws(where)
    fit, *noise = [side.fit(where) for side in sides]
    shares, told = [], []
    for names, beside in ((base, []), (laws, base)):
        share, error = fit.share(where, names, beside)
        drawn = [
            float((r.left(where, beside) - r.left(where, [*beside, *names])).sum())
            for r in noise
        ]
        by_noise = (
            max(np.mean(drawn), 0.0) / max(fit.left(where, beside).sum(), 1e-300)
            if drawn
            else 0.0
        )
        shares.append(max(share, 0.0))
        told.append(share - by_noise > max(NEARLY, FAR * error))
    linear, nonlinear = told
    if nonlinear and not ratio < 1 / AT_FLOOR:
        verdict = ResidualKind.NONLINEAR
    elif linear and not ratio < AT_FLOOR:  # below, it is the bias of the fit
        verdict = ResidualKind.LINEAR
    else:  # its size alone speaks for it, and residual and floor may both be off
        verdict = ResidualKind.NOISE if ratio < AT_FLOOR**2 else ResidualKind.UNMEASURED
    return {"verdict": verdict, "linear share": shares[0], "nonlinear share": shares[1]}


class _Motion:
    """Drifts, rates, inputs and laws of the own motion that go with a residual, and the
    regression on them.
    """

    def __init__(self, residual: Residual, chain: Chain, every: int) -> None:
        self.residual, self.chain, self.every = residual, chain, every
        self._columns = residual.columns.setdefault((chain.sites, every), {})
        self._fits: dict[tuple[int, ...], Regression] = {}

    def laws(self, where: str) -> list[str]:
        """Columns of the laws that enter one balance or storey."""
        site = Site(where)
        entering = (
            [s for s in self.chain.sites if s.incidence(site.p)]
            if site.kind == "dof"
            else [site]
        )
        return [f"law {s}" for s in entering]

    def fit(self, where: str) -> Regression:
        """The regression on all records in which a residual is known."""
        use = tuple(
            i for i, e in enumerate(self.residual.at(where)) if np.isfinite(e).all()
        )
        if use not in self._fits:
            if use not in self._columns:
                self._columns[use] = self._made(use)
            left = {
                name: [self.residual.at(name)[i][:: self.every] for i in use]
                for name in self.residual.sizes.index
            }
            known = {
                name: parts
                for name, parts in left.items()
                if all(np.isfinite(part).all() for part in parts)
            }
            self._fits[use] = Regression.of(self._columns[use] | known)
        return self._fits[use]

    def _made(self, use: tuple[int, ...]) -> dict[str, list[np.ndarray]]:
        """Columns of the motion, by group, along some records."""
        residual, n, every = self.residual, self.residual.n_dof, self.every
        segments, filters = (
            [residual.data.segments[i] for i in use],
            [residual.filters[i] for i in use],
        )

        def seen(parts: Iterable[np.ndarray]) -> list[np.ndarray]:
            return [
                filtered(np.asarray(x, dtype=float), f)[::every]
                for x, f in zip(parts, filters)
            ]

        # no balance closes by these columns: a force that is measured stands for
        # nothing but a delay
        forced = [j - 1 for j in residual.data.forced]
        names = [c for c in segments[0].covariates if c not in ("ag", "vg")]
        names = [c for c in names if all(c in seg.covariates for seg in segments)]
        based = all(seg.ag is not None for seg in segments)
        inputs = []
        for seg in segments:
            lines: list[Any] = [
                seg.a[:, forced],
                *(seg.covariates[c] for c in names),
                *([seg.ag] if based else []),
            ]
            moving = np.column_stack([*lines, np.nan_to_num(seg.F[:, forced])])[
                seg.valid
            ].astype(float)
            slopes = np.gradient(moving[:, len(forced) :], axis=0)
            inputs.append(
                np.hstack([moving[:, : moving.shape[1] - len(forced)], slopes])
            )
        groups = {
            "motion": seen(
                np.hstack([seg.s[seg.valid], seg.v[seg.valid]]) for seg in segments
            )
        }
        groups["inputs"] = seen(inputs)
        for site in dict.fromkeys([*self.chain.sites, *map(Site, range(1, n + 1))]):
            motions = [seg.motion(site, seg.valid) for seg in segments]
            groups[f"law {site}"] = own_columns(motions, filters, every)
        return groups


@dataclass
class Localisation:
    """Sites, best first, by the share of the residual that a force there explains.

    ``table`` has a row for each site: ``share`` (percent), ``low``, ``high`` (about 95
    %), ``own`` (what the force's own motion explains of it, percent), ``balances`` (the
    signs), ``pattern`` (its number; equal ones cannot be told apart), ``near`` (hardly
    told from the first). ``over_floor`` is what all balances leave over what noise
    leaves.
    """

    table: pd.DataFrame
    verdict: Location
    over_floor: float

    @property
    def site(self) -> str:
        """The best site; empty where there is nothing to locate."""
        return "" if self.verdict == Location.NOTHING else str(self.table.index[0])


class Localiser:
    """Gram matrices of all columns, block by block, and the weights of the balances."""

    def __init__(
        self,
        residual: Residual,
        floor: NoiseFloor | None = None,
        known_masses: Iterable[int] = (),
    ) -> None:
        model, chain, n = residual.model, residual.model.chain, residual.n_dof
        self.residual, self.chain = residual, chain
        self.known = np.flatnonzero(residual.known.all(axis=0))
        if not len(self.known):
            cure = "Judge records with different unknown forces one by one."
            raise ChannelError("No balance is known in every record", cure)
        layout = LawLayout(chain, model.laws)
        signs = chain.incidence(layout.sites)
        terms = [
            signs[:, k]
            for k, site in enumerate(layout.sites)
            for _ in range(layout.counts[site])
        ]
        # how each column enters the balances: laws, masses, residuals
        self.owners = np.column_stack([*terms, np.eye(n), np.eye(n)])[self.known]
        self.noise = np.zeros((len(self.known), len(self.known)))
        self.weight: np.ndarray = np.diag(1.0 / residual.scale[self.known] ** 2)
        if floor is not None:
            sigma = floor.covariance()[np.ix_(self.known, self.known)]
            if np.isfinite(sigma).all() and (np.diag(sigma) > 0).all():
                self.noise = 0.9 * sigma + 0.1 * np.diag(np.diag(sigma))
                self.weight = np.linalg.inv(self.noise)
        self.forced = np.array([j + 1 in residual.data.forced for j in self.known])
        # without any force, masses that were given scale the chain
        self.held = np.array(
            [j in set(known_masses) or not self.forced.any() for j in range(1, n + 1)]
        )
        self.values = np.concatenate(
            [*(model.coefficients[site] for site in layout.acting), model.masses]
        )
        self.columns = []
        for seg, filter in zip(residual.data.segments, residual.filters):
            blocks = list(blocks_of_segment(seg, layout, filter=filter))
            self.columns.append(
                np.hstack(
                    [np.vstack([block.terms, block.acceleration]) for block in blocks]
                ).T
            )
        pieces = in_blocks(
            [
                np.hstack([c, np.nan_to_num(e)])
                for c, e in zip(self.columns, residual.balance)
            ]
        )
        self.grams = np.array([piece.T @ piece for piece in pieces])
        self.sizes = np.array([len(piece) for piece in pieces], dtype=float)

    def found(self) -> Localisation:
        """All sites of the chain, best first."""
        nothing = self.at_floor
        patterns = {site: self.pattern(site) for site in all_sites(self.residual)}
        keys = {site: _key(b) for site, b in patterns.items()}
        told = {keys[site]: b for site, b in patterns.items() if b is not None}
        before = self.left(None)
        shares = {
            key: 100 * np.array(share_of(before, self.left(b)))
            for key, b in told.items()
        }
        rows = {site: shares.get(keys[site], (np.nan, np.nan)) for site in patterns}
        table = pd.DataFrame.from_dict(rows, orient="index", columns=["share", "error"])
        best = table["share"].max()
        near = (
            []
            if nothing
            else [Site(s) for s in table.index[table["share"] >= best - 100 * NEARLY]]
        )
        own = {site: self.own(site, patterns[site]) for site in near}
        for site in (site for site in near if site.kind == "dof"):
            # a force at a DOF from outside is what follows none of the motions and
            # channels with its pattern
            alike = [own[s] for s in near if s.kind != "dof" and keys[s] == keys[site]]
            own[site] = 100.0 - np.nanmax([0.0, *alike])
        table["own"] = [own.get(site, np.nan) for site in patterns]
        # equal patterns have equal shares; the force's own motion puts them in order
        table = table.sort_values(
            ["share", "own"], ascending=False, kind="stable", na_position="last"
        )
        table["low"], table["high"] = (
            table["share"] - 2 * table["error"],
            table["share"] + 2 * table["error"],
        )
        table[["share", "low", "high"]] = table[["share", "low", "high"]].clip(
            0.0, 100.0
        )
        signs = (_incidence(self.chain, Site(site)) for site in table.index)
        table["balances"] = [
            ", ".join(f"{'+' if x > 0 else '-'}{j}" for j, x in enumerate(b, 1) if x)
            for b in signs
        ]
        order = [keys[Site(site)] for site in table.index]
        table["pattern"] = [order.index(key) for key in order]
        first = table.iloc[0]
        table["near"] = (first["share"] - table["share"] < 100 * NEARLY) | (
            table["high"] > first["low"]
        )
        verdict = Location.ONE_BALANCE if len(told) == 1 else Location.EXPLAINS
        return Localisation(
            table, Location.NOTHING if nothing else verdict, self.over_floor
        )

    def pattern(self, site: Site) -> np.ndarray | None:
        """Signs in the known balances, or None if the site touches none."""
        b = _incidence(self.chain, site)[self.known]
        return b if b.any() else None

    @cached_property
    def over_floor(self) -> float:
        """Residual of all balances over what noise leaves of them; NaN where the noise
        is not known.
        """
        expected = float(self.sizes.sum() * np.trace(self.weight @ self.noise))
        return (
            float(np.sqrt(max(self.left(None).sum() / expected + 1.0, 0.0)))
            if expected > 0
            else np.nan
        )

    @property
    def at_floor(self) -> bool:
        """Whether noise explains the residual, or no measurement could tell it from
        zero.
        """
        if np.isfinite(self.over_floor):
            return self.over_floor < AT_FLOOR
        return bool(
            (
                self.residual.sizes["percent"].iloc[: self.residual.n_dof].dropna()
                < 100 * FLOOR
            ).all()
        )

    # -- corrections of the baseline -------------------------------------------

    def _form(self, b: np.ndarray | None) -> np.ndarray:
        """Weights of what a free force with a pattern leaves."""
        if b is None:
            return self.weight
        Wb = self.weight @ b
        return self.weight - np.outer(Wb, Wb) / (b @ Wb)

    def fit(self, b: np.ndarray | None) -> Regression:
        """The regression of the residual on the columns of the baseline, beside a free
        force with a pattern.
        """
        k, n = self.columns[0].shape[1], self.residual.n_dof
        free = np.concatenate(
            [np.arange(k - n), k - n + np.flatnonzero(self._free_masses(b))]
        )
        form = self.owners.T @ self._form(b) @ self.owners
        # columns that enter the balances as the force does are its own
        free = free[np.diag(form)[free] > 1e-12 * np.trace(self.weight)]
        grams = form * self.grams
        grams[:, k] = grams[:, k:].sum(axis=1)  # the residuals of all balances together
        grams[:, :, k] = grams[:, :, k:].sum(axis=2)
        return Regression(
            grams[:, : k + 1, : k + 1], {"baseline": free, "e": np.array([k])}
        )

    def left(self, b: np.ndarray | None) -> np.ndarray:
        """Squares left in every block beside a free force with a pattern, without those
        of noise.
        """
        return self.fit(b).left("e", ["baseline"]) - self.sizes * float(
            np.trace(self._form(b) @ self.noise)
        )

    def _pieces(self, b: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Pieces into which a free force cuts the chain: the number of each balance's,
        and where a force scales it.
        """
        ties, seen = (
            self.owners[:, : -2 * self.residual.n_dof],
            np.ones(len(self.known), dtype=bool),
        )
        if b is not None and np.count_nonzero(b) == 1:
            seen = np.equal(b, 0)
        elif b is not None:
            ties = np.column_stack([ties, b])
        ties = np.abs(ties) * seen[:, None]
        piece = np.where(seen, connected_components(ties @ ties.T)[1], -1)
        return piece, np.isin(piece, piece[self.forced & seen])

    def _free_masses(self, b: np.ndarray | None) -> np.ndarray:
        """DOFs whose mass is corrected: all but one, the largest, of a piece that
        nothing scales.
        """
        piece, scaled = self._pieces(b)
        masses = self.residual.model.masses
        out = np.zeros(self.residual.n_dof, dtype=bool)
        out[self.known] = piece >= 0
        for p in np.unique(piece[(piece >= 0) & ~scaled]):
            dofs = self.known[piece == p]
            out[dofs[np.abs(masses[dofs]).argmax()]] = False
        return out & ~self.held

    # -- the force itself, and whose motion it follows -------------------------

    def force(self, site: Site) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """The force that is missing if it acts at one site, freed of what the baseline
        does wrong to make up for it.

        Along every record, N, with columns that it may hold any multiple of.
        """
        b = self.pattern(site)
        assert b is not None
        k, n = self.columns[0].shape[1], self.residual.n_dof
        fit = self.fit(b)
        delta = np.zeros(k)
        delta[fit.at["baseline"]] = fit.coefficients("e", ["baseline"])["baseline"]
        weights = self.weight @ b / (b @ self.weight @ b)
        owners = self.owners[:, :k]
        piece, scaled = self._pieces(b)
        loose = [
            (weights @ owners)
            * (self.values + delta)
            * (owners[piece == p] != 0).any(axis=0)
            for p in np.unique(piece[(piece >= 0) & ~scaled])
            if not self.held[self.known[piece == p]].any()
        ]
        # columns that enter the balances like the force itself: nothing else can tell
        # their coefficients
        alone = np.array(
            [
                np.abs(o).sum() > 0 and np.allclose(o, (o @ b) / (b @ b) * b)
                for o in owners.T
            ]
        )
        alone[k - n :] &= ~self.held
        force, base = [], []
        for columns, e in zip(self.columns, self.residual.balance):
            force.append(
                e[:, self.known] @ weights - columns @ ((weights @ owners) * delta)
            )
            base.append(
                np.column_stack([columns[:, alone], *(columns @ c for c in loose)])
            )
        return force, base

    def own(self, site: Site, b: np.ndarray | None) -> float:
        """Share of the free force that its own motion, or a delay of its channel,
        explains; percent.
        """
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
            linear = [
                filtered(np.column_stack([m.s, m.v]), f)[::every]
                for m, f in zip(motions, filters)
            ]
            own = [
                np.hstack(pair)
                for pair in zip(linear, own_columns(motions, filters, every))
            ]
        else:
            kind, j = site.channel[0], int(site.channel[1:]) - 1
            lines = [
                (seg.a if kind == "a" else seg.F)[seg.valid, j].astype(float)
                for seg in segments
            ]
            own = [filtered(np.gradient(x)[:, None], f) for x, f in zip(lines, filters)]
        thin = {
            name: [x[::every] for x in parts]
            for name, parts in (("base", base), ("force", force))
        }
        return 100 * max(
            Regression.of({"own": own, **thin}).share("force", ["own"], ["base"])[0],
            0.0,
        )


def all_sites(residual: Residual) -> list[Site]:
    """Sites of the chain, all storeys, links, ground links and DOFs, and the sensors
    felt in one balance.
    """
    each = range(1, residual.n_dof + 1)
    names: list[Any] = [*residual.model.chain.sites, *each]
    names += [f"link {p}-{q}" for p in each for q in range(1, p - 1)]
    names += [f"{place}{j}" for place in ("ground ", "dof ", "sensor a") for j in each]
    return list(
        dict.fromkeys(
            map(Site, [*names, *(f"sensor F{j}" for j in residual.data.forced)])
        )
    )


def _incidence(chain: Chain, site: Site) -> np.ndarray:
    """Signs of a site in the balances; an acceleration or force sensor is felt in the
    balance of its DOF.
    """
    if site.kind != "sensor":
        return chain.incidence([site])[:, 0]
    return (np.arange(1, chain.n_dof + 1) == int(site.channel[1:])).astype(float)


def _key(b: np.ndarray | None) -> bytes:
    return (
        b"" if b is None else (b if b[np.flatnonzero(b)[0]] > 0 else 0.0 - b).tobytes()
    )


@dataclass
class Evidence:
    """What is left of the measured forces after one model of the loop.

    ``model`` is ``"baseline"`` or the effect that was added last, ``chosen`` the site
    at which the loop then added an effect (empty if none), ``sizes`` the residual of
    each balance and storey, ``floor`` what noise alone would leave; ``not_possible``
    says why a question has no answer.
    """

    model: str
    sizes: pd.DataFrame = field(default_factory=pd.DataFrame)
    detection: Detection | None = None
    floor: NoiseFloor | None = None
    localisation: Localisation | None = None
    characterisation: Characterisation | None = None
    chosen: str = ""
    not_possible: dict[str, Obstacle] = field(default_factory=dict)

    @property
    def site(self) -> str:
        """The site whose force is characterised; empty if there is nothing to
        locate.
        """
        return "" if self.localisation is None else self.localisation.site

    @property
    def sentences(self) -> dict[str, str]:
        """The answer to each question, in words."""
        told = {
            question: getattr(self, question) is not None
            for question in words.QUESTIONS
        }
        return {
            q: getattr(words, q)(self) if known else words.not_possible(q, self)
            for q, known in told.items()
        }

    def __str__(self) -> str:
        return "\n".join(self.sentences.values())


def look(
    work: Workspace,
    model: ChainModel,
    name: str = "model",
    chosen: str = "",
    floor: NoiseFloor | None = None,
) -> Evidence:
    """Detection, localisation and characterisation of what one model leaves of the
    search data.
    """
    out = Evidence(name, chosen=chosen)
    residual = _tried(out, "residual", lambda: searched_residual(work, model))
    if residual is None:
        out.not_possible |= dict.fromkeys(words.QUESTIONS, out.not_possible["residual"])
        return out
    out.sizes = residual.sizes
    out.floor = None if floor is None else replace(floor, draws=[], motions={})
    out.detection = _tried(out, "detection", lambda: detect(residual, floor))
    where = _tried(
        out, "localisation", lambda: Localiser(residual, floor, work.known_masses)
    )
    out.localisation = (
        None if where is None else _tried(out, "localisation", where.found)
    )
    if out.localisation is None:
        why = Obstacle(
            f"the site is not known: {out.not_possible['localisation'].reason}"
        )
    elif out.detection is not None and out.detection.is_noise:
        why = Obstacle("nothing but noise is left", expected=True)
    elif not out.site:
        why = Obstacle("the residual is at the noise floor", expected=True)
    else:
        out.characterisation = _tried(
            out,
            "characterisation",
            lambda: _characterised(where, Site(out.site), floor),
        )
        return out
    out.not_possible["characterisation"] = why
    return out


def _characterised(
    where: Localiser, site: Site, floor: NoiseFloor | None
) -> Characterisation:
    residual = where.residual
    force, beside = where.force(site)
    of_motion = site if site.kind != "sensor" else Site(f"dof {site.channel[1:]}")
    segments = residual.data.segments
    noise = (
        np.nan
        if floor is None
        else floor.at(str(site) if site.is_storey else f"dof {of_motion.p}")
    )
    return characterise(
        force,
        [seg.motion(of_motion, seg.valid) for seg in segments],
        filters=residual.filters,
        beside=beside if beside[0].shape[1] else None,
        noise=float(noise) if np.isfinite(noise) else None,
    )


def _tried(out: Evidence, question: str, answer: Callable[[], Any]) -> Any:
    try:
        return answer()
    except (
        NRFError,
        ValueError,
        ArithmeticError,
        LookupError,
    ) as error:  # numerics on data nobody has seen, too
        what = (
            error.what
            if isinstance(error, NRFError)
            else f"{type(error).__name__}: {error}"
        )
        out.not_possible[question] = Obstacle(what.rstrip("."))
    return None
