"""Where a missing force acts: by the signs with which it enters the balances.

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

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd
from scipy.sparse.csgraph import connected_components

from ...chain.layout import LawLayout
from ...chain.sites import Site
from ...chain.structure import Chain
from ...equations.balances import blocks_of_segment
from ...equations.normal_equations import Regression, in_blocks, share_of
from ...exceptions import ChannelError
from ..residual import Residual, filtered
from .kinds import Location
from .motion_columns import own_columns, thinning
from .noise_floor import NoiseFloor
from .settings import RESIDUAL

# Weight of the correlations between the balances' noise, which a few draws give poorly.
CORRELATION = 0.9


@dataclass(frozen=True, eq=False)
class Localisation:
    """Sites, best first, by the share of the residual that a force there explains.

    ``table`` has a row for each site, with these columns:

    - ``share``, ``low``, ``high``: percent, and the ends of about 95 %.
    - ``own``: what the motion of the site explains of it, percent.
    - ``balances``: the signs.
    - ``pattern``: its number; sites of one pattern cannot be distinguished.
    - ``near``: whether it is nearly as good as the first.

    ``over_floor`` is what all balances leave over what noise leaves.
    """

    table: pd.DataFrame
    verdict: Location
    over_floor: float

    @property
    def site(self) -> str:
        """The best site; empty where there is nothing to locate."""
        return "" if self.verdict == Location.NOTHING else str(self.table.index[0])


@dataclass(frozen=True, eq=False)
class MissingForce:
    """The force that is missing if it acts at one site, N, along every record.

    ``beside`` are columns of which the force may hold any multiple.
    """

    force: list[np.ndarray]
    beside: list[np.ndarray]


def localise(
    residual: Residual,
    floor: NoiseFloor | None = None,
    known_masses: Iterable[int] = (),
) -> Localisation:
    """Judge all sites by the share of a residual that a force there explains.

    Parameters
    ----------
    residual : Residual
    floor : NoiseFloor, optional
        What noise alone would leave, if it is known.
    known_masses : iterable of int
        DOFs whose mass is not corrected.

    Returns
    -------
    Localisation

    Raises
    ------
    ChannelError
        If no balance is known in every record.

    Examples
    --------
    A storey that hardens, of which a linear model knows nothing:

    >>> from pysindy_nrf import NRFRegressor, datasets
    >>> from pysindy_nrf.diagnosis import residual_of
    >>> from pysindy_nrf.diagnosis import localise
    >>> record = datasets.load_demo()
    >>> model = NRFRegressor(degree=1).fit(record).model_
    >>> residual = residual_of(model, record)
    >>> localise(residual).site
    'storey 1'
    """
    return Localiser(residual, floor, known_masses).localise()


class Localiser:
    """Products of all columns, block by block, and the weights of the balances."""

    def __init__(
        self,
        residual: Residual,
        floor: NoiseFloor | None = None,
        known_masses: Iterable[int] = (),
    ) -> None:
        self.residual = residual
        self.model = residual.model
        self.chain: Chain = residual.model.chain
        self.n_dof = residual.n_dof
        self.known = np.flatnonzero(residual.known.all(axis=0))
        if not len(self.known):
            raise ChannelError(
                "No balance is known in every record",
                "Judge records with different unknown forces one by one.",
            )

        self.forced = np.array([j + 1 in residual.data.forced for j in self.known])
        # without any force, masses that were given scale the chain
        fixed = set(known_masses)
        if not self.forced.any():
            fixed = set(range(1, self.n_dof + 1))
        self.fixed_mass = np.array([j + 1 in fixed for j in range(self.n_dof)])

        layout = LawLayout(self.chain, self.model.laws)
        self.owners = self._owners(layout)
        coefficients = [self.model.coefficients[site] for site in layout.acting]
        self.values = np.concatenate([*coefficients, self.model.masses])
        self.noise, self.weight = self._noise_and_weight(floor)
        self.columns = self._columns(layout)
        self.n_columns = self.columns[0].shape[1]

        pieces = []
        for columns, balance in zip(self.columns, residual.balance):
            pieces.append(np.hstack([columns, np.nan_to_num(balance)]))
        blocks = in_blocks(pieces)
        self.products = np.array([block.T @ block for block in blocks])
        self.block_sizes = np.array([len(block) for block in blocks], dtype=float)

    def _owners(self, layout: LawLayout) -> np.ndarray:
        """How each column enters the known balances: laws, masses, residuals."""
        signs = self.chain.incidence(layout.sites)
        terms = []
        for k, site in enumerate(layout.sites):
            terms += [signs[:, k]] * layout.counts[site]
        dofs = np.eye(self.n_dof)
        return np.column_stack([*terms, dofs, dofs])[self.known]

    def _noise_and_weight(
        self, floor: NoiseFloor | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Covariance of the noise in the known balances, and their weights.

        The scale of the storeys' forces stands for noise that is not known.
        """
        if floor is not None:
            covariance = floor.covariance()[np.ix_(self.known, self.known)]
            variances = np.diag(covariance)
            if np.isfinite(covariance).all() and (variances > 0).all():
                alone = (1.0 - CORRELATION) * np.diag(variances)
                noise = CORRELATION * covariance + alone
                return noise, np.linalg.inv(noise)

        n_known = len(self.known)
        weight = np.diag(1.0 / self.residual.scale[self.known] ** 2)
        return np.zeros((n_known, n_known)), weight

    def _columns(self, layout: LawLayout) -> list[np.ndarray]:
        """Columns of the laws and accelerations along every record."""
        columns = []
        residual = self.residual
        for segment, filter_ in zip(residual.data.segments, residual.filters):
            rows = []
            for block in blocks_of_segment(segment, layout, filter=filter_):
                rows.append(np.vstack([block.terms, block.acceleration]))
            columns.append(np.hstack(rows).T)
        return columns

    # -- all sites -------------------------------------------------------------

    def localise(self) -> Localisation:
        """All sites of the chain, best first."""
        at_floor = self.at_floor
        patterns = {site: self.pattern(site) for site in all_sites(self.residual)}
        table = self._shares(patterns)

        near: list[Site] = []
        if not at_floor:
            least = table["share"].max() - 100 * RESIDUAL.alike
            near = [Site(site) for site in table.index[table["share"] >= least]]
        own_shares = self._own_shares(near, patterns)
        table["own"] = [own_shares.get(site, np.nan) for site in patterns]
        # equal patterns have equal shares; the force's own motion puts them in order
        table = table.sort_values(
            ["share", "own"], ascending=False, kind="stable", na_position="last"
        )
        table = self._described(table, patterns)

        verdict = Location.EXPLAINS
        if len({_key(b) for b in patterns.values() if b is not None}) == 1:
            verdict = Location.ONE_BALANCE
        if at_floor:
            verdict = Location.NOTHING
        return Localisation(table, verdict, self.over_floor)

    def _shares(self, patterns: dict[Site, np.ndarray | None]) -> pd.DataFrame:
        """Share of the residual that a force at each site explains, percent."""
        before = self.remaining(None)
        shares: dict[bytes, np.ndarray] = {}
        for pattern in patterns.values():
            key = _key(pattern)
            if pattern is not None and key not in shares:
                shares[key] = 100 * np.array(share_of(before, self.remaining(pattern)))

        unknown = np.full(2, np.nan)
        rows = [shares.get(_key(pattern), unknown) for pattern in patterns.values()]
        return pd.DataFrame(rows, index=list(patterns), columns=["share", "error"])

    def _own_shares(
        self, near: list[Site], patterns: dict[Site, np.ndarray | None]
    ) -> dict[Site, float]:
        """What the own motion of the best sites explains of their force, percent.

        A force at a DOF from outside is what follows none of the motions and channels
        with its pattern.
        """
        shares = {}
        for site in near:
            if site.kind != "dof":
                shares[site] = self.own_share(site, patterns[site])
        for site in near:
            if site.kind == "dof":
                alike = [0.0]
                for other in near:
                    same = _key(patterns[other]) == _key(patterns[site])
                    if same and other.kind != "dof":
                        alike.append(shares[other])
                shares[site] = 100.0 - float(np.nanmax(alike))
        return shares

    def _described(
        self, table: pd.DataFrame, patterns: dict[Site, np.ndarray | None]
    ) -> pd.DataFrame:
        """The table with intervals, signs, patterns, and what comes near the best."""
        table = table.copy()
        table["low"] = table["share"] - 2 * table["error"]
        table["high"] = table["share"] + 2 * table["error"]
        percents = ["share", "low", "high"]
        table[percents] = table[percents].clip(0.0, 100.0)

        sites = [Site(site) for site in table.index]
        table["balances"] = [_signs(self.chain, site) for site in sites]
        keys = [_key(patterns[site]) for site in sites]
        table["pattern"] = [keys.index(key) for key in keys]

        first = table.iloc[0]
        alike = first["share"] - table["share"] < 100 * RESIDUAL.alike
        table["near"] = alike | (table["high"] > first["low"])
        return table

    def pattern(self, site: Site) -> np.ndarray | None:
        """Signs in the known balances, or None if the site touches none."""
        b = _incidence(self.chain, site)[self.known]
        return b if b.any() else None

    @cached_property
    def over_floor(self) -> float:
        """Residual of all balances over what noise leaves of them.

        NaN where the noise is not known.
        """
        of_noise = float(np.trace(self.weight @ self.noise))
        expected = float(self.block_sizes.sum()) * of_noise
        if not expected > 0:
            return np.nan
        beyond = float(self.remaining(None).sum()) / expected
        return float(np.sqrt(max(beyond + 1.0, 0.0)))

    @property
    def at_floor(self) -> bool:
        """Whether noise explains the residual, or it is as good as zero."""
        if np.isfinite(self.over_floor):
            return self.over_floor < RESIDUAL.at_floor
        percent = self.residual.sizes["percent"].iloc[: self.n_dof].dropna()
        return bool((percent < 100 * RESIDUAL.resolution).all())

    # -- corrections of the baseline -------------------------------------------

    def _form(self, b: np.ndarray | None) -> np.ndarray:
        """Weights of what a free force with a pattern leaves."""
        if b is None:
            return self.weight
        weighted = self.weight @ b
        return self.weight - np.outer(weighted, weighted) / (b @ weighted)

    def fit(self, b: np.ndarray | None) -> Regression:
        """The regression of the residual on the columns of the baseline.

        Next to a free force with a pattern.
        """
        k, n = self.n_columns, self.n_dof
        masses = k - n + np.flatnonzero(self._free_masses(b))
        free = np.concatenate([np.arange(k - n), masses])
        form = self.owners.T @ self._form(b) @ self.owners
        # columns that enter the balances as the force does are its own
        free = free[np.diag(form)[free] > 1e-12 * np.trace(self.weight)]

        # the residuals of all balances together
        products = form * self.products
        products[:, k] = products[:, k:].sum(axis=1)
        products[:, :, k] = products[:, :, k:].sum(axis=2)
        columns = {"baseline": free, "e": np.array([k])}
        return Regression(products[:, : k + 1, : k + 1], columns)

    def remaining(self, b: np.ndarray | None) -> np.ndarray:
        """Squares left in every block with a free force, without those of noise."""
        of_noise = float(np.trace(self._form(b) @ self.noise))
        return self.fit(b).unexplained("e", ["baseline"]) - self.block_sizes * of_noise

    def _pieces(self, b: np.ndarray | None) -> _Pieces:
        """The pieces into which a free force cuts the chain."""
        ties = self.owners[:, : -2 * self.n_dof]
        uncut = np.ones(len(self.known), dtype=bool)
        if b is not None and np.count_nonzero(b) == 1:
            uncut = np.equal(b, 0)
        elif b is not None:
            ties = np.column_stack([ties, b])

        ties = np.abs(ties) * uncut[:, None]
        _, labels = connected_components(ties @ ties.T)
        number = np.where(uncut, labels, -1)
        scaled = np.isin(number, number[self.forced & uncut])
        return _Pieces(number, scaled)

    def _free_masses(self, b: np.ndarray | None) -> np.ndarray:
        """DOFs whose mass is corrected.

        All but one, the largest, of a piece that nothing scales.
        """
        pieces = self._pieces(b)
        masses = self.model.masses
        free = np.zeros(self.n_dof, dtype=bool)
        free[self.known] = pieces.number >= 0
        for balances in pieces.unscaled():
            dofs = self.known[balances]
            free[dofs[np.abs(masses[dofs]).argmax()]] = False
        return free & ~self.fixed_mass

    # -- the force itself, and whose motion it follows -------------------------

    def missing_force(self, site: Site) -> MissingForce:
        """The force that is missing if it acts at one site.

        Freed of what the baseline does wrong to make up for it.
        """
        b = self.pattern(site)
        assert b is not None
        k = self.n_columns
        fit = self.fit(b)
        correction = np.zeros(k)
        baseline = fit.coefficients("e", ["baseline"])["baseline"]
        correction[fit.columns["baseline"]] = baseline

        weights = self.weight @ b / (b @ self.weight @ b)
        owners = self.owners[:, :k]
        entering = weights @ owners
        loose = []
        for balances in self._pieces(b).unscaled():
            if not self.fixed_mass[self.known[balances]].any():
                inside = (owners[balances] != 0).any(axis=0)
                loose.append(entering * (self.values + correction) * inside)

        force, beside = [], []
        alone = self._columns_like(b)
        for columns, balance in zip(self.columns, self.residual.balance):
            corrected = columns @ (entering * correction)
            force.append(balance[:, self.known] @ weights - corrected)
            scales = [columns @ c for c in loose]
            beside.append(np.column_stack([columns[:, alone], *scales]))
        return MissingForce(force, beside)

    def _columns_like(self, b: np.ndarray) -> np.ndarray:
        """Columns that enter the balances like a force with a pattern.

        Nothing else gives their coefficients.
        """
        k, n = self.n_columns, self.n_dof
        alone = np.zeros(k, dtype=bool)
        for column, owner in enumerate(self.owners[:, :k].T):
            along = (owner @ b) / (b @ b) * b
            alone[column] = np.abs(owner).sum() > 0 and np.allclose(owner, along)
        alone[k - n :] &= ~self.fixed_mass
        return alone

    def own_share(self, site: Site, b: np.ndarray | None) -> float:
        """Share of the free force that its own motion explains, percent.

        Or a delay of its channel.
        """
        if site.kind == "dof" or b is None:
            return np.nan
        missing = self.missing_force(site)
        if not any(f.any() for f in missing.force):
            return np.nan

        columns, every = self._own_motion(site)
        groups = {
            "own": columns,
            "base": [x[::every] for x in missing.beside],
            "force": [x[::every] for x in missing.force],
        }
        share, _ = Regression.of(groups).share("force", ["own"], ["base"])
        return 100 * max(share, 0.0)

    def _own_motion(self, site: Site) -> tuple[list[np.ndarray], int]:
        """Columns of the own motion of a site, every so many samples of them."""
        segments, filters = self.residual.data.segments, self.residual.filters
        if site.kind != "link":
            return self._slopes(site), 1

        motions = [seg.motion(site, seg.valid) for seg in segments]
        every = thinning([motion.s for motion in motions])
        of_laws = own_columns(motions, filters, every)
        columns = []
        for motion, filter_, nonlinear in zip(motions, filters, of_laws):
            linear = np.column_stack([motion.s, motion.v])
            linear = filtered(linear, filter_)[::every]
            columns.append(np.hstack([linear, nonlinear]))
        return columns, every

    def _slopes(self, site: Site) -> list[np.ndarray]:
        """Slopes of the channel of a sensor: what a delay adds to it."""
        kind, j = site.channel[0], site.p - 1
        slopes = []
        for seg, filter_ in zip(self.residual.data.segments, self.residual.filters):
            channel = seg.a if kind == "a" else seg.F
            line = channel[seg.valid, j].astype(float)
            slopes.append(filtered(np.gradient(line)[:, None], filter_))
        return slopes


@dataclass(frozen=True, eq=False)
class _Pieces:
    """Pieces of a chain: that of each known balance, -1 for one that is cut out.

    And where a force scales it.
    """

    number: np.ndarray
    scaled: np.ndarray

    def unscaled(self) -> Iterator[np.ndarray]:
        """Mask of the balances of each piece that no force scales."""
        for piece in np.unique(self.number[(self.number >= 0) & ~self.scaled]):
            yield self.number == piece


def all_sites(residual: Residual) -> list[Site]:
    """Sites at which a force may be missing.

    Those of the chain, all storeys, links, ground links and DOFs, and the sensors that
    are seen in one balance.
    """
    dofs = range(1, residual.n_dof + 1)
    names: list[Site | int | str] = [*residual.model.chain.sites, *dofs]
    for p in dofs:
        names += [f"link {p}-{q}" for q in range(1, p - 1)]
    for place in ("ground ", "dof ", "sensor a"):
        names += [f"{place}{j}" for j in dofs]
    names += [f"sensor F{j}" for j in residual.data.forced]
    return list(dict.fromkeys(map(Site, names)))


def _incidence(chain: Chain, site: Site) -> np.ndarray:
    """Signs of a site in the balances.

    An acceleration or force sensor is seen in the balance of its DOF.
    """
    if site.kind != "sensor":
        return chain.incidence([site])[:, 0]
    dofs = np.arange(1, chain.n_dof + 1)
    return (dofs == site.p).astype(float)


def _signs(chain: Chain, site: Site) -> str:
    """Signs of a site in the balances, in words."""
    signs = []
    for j, sign in enumerate(_incidence(chain, site), 1):
        if sign:
            signs.append(f"{'+' if sign > 0 else '-'}{j}")
    return ", ".join(signs)


def _key(b: np.ndarray | None) -> bytes:
    """A pattern of signs up to its own sign."""
    if b is None:
        return b""
    first = b[np.flatnonzero(b)[0]]
    return (b if first > 0 else 0.0 - b).tobytes()
