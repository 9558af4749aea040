"""The one ruler of the loop: the fall of the cross-validated residual, in dB, over
bands that hold information.

The gain of a model over another is the sum over balances of the mean over informative
bands of ``10 log10(P_before / P_after)``, P the power of the residual on folds that the
fit did not see. A band full of noise says 0 dB whatever its size, and a noisy balance
cannot hide what happens in a quiet one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ..chain.identifiability import SolveOrder, plan_solve_order
from ..chain.layout import LawLayout, Layout
from ..chain.model import ChainModel
from ..chain.sites import Site
from ..chain.structure import Chain
from ..equations.chain_solve import Solution, model_of
from ..equations.many_solves import ChainFit, ChannelFit
from ..equations.normal_equations import leave_one_out, variance
from ..exceptions import NRFError
from ..identification.fewer_sensors import Linearised
from ..laws.base import ForceLaw
from ..records.dataset import Dataset
from .constants import ENERGY, EXPLAINED, FAR, FLOOR, TENTH
from .prepare import LONG, Workspace
from .windows import Windows

Laws = Mapping[Site, tuple[ForceLaw, ...]]
Placed = Sequence[tuple[Site, ForceLaw]]
# Spectra of laws of models that are kept for the next model, bytes.
_CACHE = 64_000_000
# Numbers in the spectra of a scan that are held at once.
_AT_ONCE = 500_000
# Iterations of bands and of weights; both settle in three or four.
ROUNDS = 6


@dataclass
class Powers:
    """Power of the residual by fold, judged balance and band, and that of the reference
    by balance and band.
    """

    folds: np.ndarray
    reference: np.ndarray

    @property
    def residual(self) -> np.ndarray:
        """Power of the residual on all folds, each left out of the fit, (n_dof,
        n_bands).
        """
        return self.folds.sum(axis=0)

    @property
    def shares(self) -> np.ndarray:
        """Residual over reference: where no force scales a balance, both may shrink
        together.
        """
        return share(self.residual, self.reference)


def share(residual: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Residual over reference, and what no measurement tells from zero; infinite where
    there is no reference.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(reference > 0, residual / reference, np.inf) + FLOOR**2


def fall(before: np.ndarray, after: np.ndarray, informative: np.ndarray) -> np.ndarray:
    """Sum over balances of the mean fall in dB over informative bands."""
    with np.errstate(divide="ignore", invalid="ignore"):
        bands = np.where(
            informative & np.isfinite(before), 10.0 * np.log10(before / after), 0.0
        )
    return (bands.sum(axis=-1) / np.maximum(informative.sum(axis=-1), 1)).sum(axis=-1)


class Gain:
    """Fall of the residual from one model to another, dB, with the standard error over
    folds.

    Attributes
    ----------
    value, error : float
        Mean over the informative bands: what ranks effects.
    there, there_least : float
        Mean over the bands that change by a tenth, up or down, and that without the
        fold that speaks most for it: what is asked of a force that acts in one band.
    """

    def __init__(self, before: Powers, after: Powers, informative: np.ndarray) -> None:
        self.value = float(fall(before.shares, after.shares, informative))
        one, two = (share(leave_one_out(p.folds), p.reference) for p in (before, after))
        with np.errstate(invalid="ignore"):
            self.parts = fall(one, two, informative)  # each fold left out
            changed = informative & (
                np.abs(np.log(after.shares / before.shares)) >= TENTH
            )
            self.there = float(fall(before.shares, after.shares, changed))
            self.there_least = float(fall(one, two, changed).min())
            self.error = float(np.sqrt(variance(self.parts)))
        if not np.isfinite(self.value) or not np.isfinite(self.error):
            self.value, self.error = -np.inf, np.inf

    @property
    def least(self) -> float:
        """Gain without the fold that speaks most for it."""
        return float(self.parts.min()) if np.isfinite(self.value) else -np.inf

    @property
    def lower(self) -> float:
        """Gain less its standard error; a fold without which it is larger counts as far
        as one without which it is not.

        A sudden change is dated in one fold: without it the gain is larger by far,
        which is nothing against the effect.
        """
        if not np.isfinite(self.value):
            return -np.inf
        away = self.parts - self.value
        away = np.minimum(away, max(-away.min(), 0.0))
        return self.value - float(np.sqrt((len(away) - 1) / len(away) * (away @ away)))

    @property
    def bound(self) -> float:
        """Gain less two of these standard errors (95 %)."""
        return self.value - FAR * (self.value - self.lower)


class Ruler:
    """What every decision reads: spectra of the search, informative bands.

    Attributes
    ----------
    informative : ndarray of bool, shape (n_dof, n_bands)
    """

    def __init__(
        self,
        work: Workspace,
        windows: Windows,
        informative: np.ndarray | None = None,
        clear: np.ndarray | None = None,
        strict: bool = True,
    ) -> None:
        self.work, self.windows = work, windows
        # what single precision loses of the spectra of long records is far below the
        # share that counts as zero
        self.kind: Any = float if windows.size < LONG else np.float32
        self.fixed = windows.spectra(work.fixed, self.kind)
        self.known = work.known[[b.segment for b in windows.blocks]]  # (n_folds, n_dof)
        shape = work.n_dof, len(windows.edges) - 1
        self.informative = (
            np.ones(shape, dtype=bool) if informative is None else informative
        )
        self.clear = self.informative if clear is None else clear
        # By proposal, the laws that a scan tries, and the products of their columns
        # with each row.
        self.scans: dict[
            Any, tuple[Sequence[tuple[ForceLaw, ...]], dict[Any, np.ndarray]]
        ] = {}
        self.keys: dict[Any, int] = {}  # numbers of rows: hashes of laws take long
        self._cache: dict[tuple[Site, ForceLaw], np.ndarray] = {}
        self._known: tuple[list[int], np.ndarray] = (
            [],
            np.empty(0),
        )  # rows of a model, and their products
        self._orders: dict[tuple[Site, ...], SolveOrder] = {}
        self.part: Ruler | None = (
            None  # on excerpts, where this is one on all samples of long records
        )
        # refuse laws whose columns depend on others; in simulated records they may not
        # act
        self.strict = strict

    def columns(
        self, site: Site, laws: Sequence[ForceLaw], kind: Any = float
    ) -> np.ndarray:
        """Spectra of the columns of laws at one site."""
        found = self.windows.spectra(
            lambda group: self.work.columns(site, laws, group), kind
        )
        if not np.isfinite(found).all():
            raise NRFError(
                "The columns of the law overflow", "Leave it out of the catalogue."
            )
        return found

    def rows(self, site: Site, law: ForceLaw) -> np.ndarray:
        """Spectra of the columns of a law of a model, kept for the next model."""
        found = self._cache.pop((site, law), None)
        found = self.columns(site, [law], self.kind) if found is None else found
        self._cache[site, law] = found
        while (
            len(self._cache) > 1
            and sum(rows.nbytes for rows in self._cache.values()) > _CACHE
        ):
            del self._cache[next(iter(self._cache))]
        return found

    def grams(self, trial: Trial) -> np.ndarray:
        """Products of the rows of a model by fold and band, taken from those of a
        larger model that came before.
        """
        if not set(trial.keys) <= set(self._known[0]):
            self._known = trial.keys, self.windows.grams(*trial.columns())
        known, products = self._known
        at = [known.index(key) for key in trial.keys]
        return products if trial.keys == known else products[:, :, at][..., at]

    @cached_property
    def held(self) -> Ruler:
        """The same windows and bands on the held-out samples."""
        w, work = self.windows, self.work
        return Ruler(
            work,
            Windows(work.data, work.held, w.length, w.edges, w.centred),
            self.informative,
            self.clear,
        )

    def fit_of(
        self, layout: Layout, where: Mapping[Site, Sequence[int]], at: int
    ) -> ChainFit:
        """The solve of a set of columns."""
        work = self.work
        # Balances one by one locate a missing law; each is fitted beside the laws that
        # the balances before it found, as it is judged (laws that are found twice would
        # be judged where the other one was not fitted).
        given = (
            work.forced,
            work.unknown,
            dict(work.known_masses),
            "sequential",
            layout.acting,
        )
        if layout.acting not in self._orders:
            self._orders[layout.acting] = plan_solve_order(
                layout.chain, *given
            ).require_complete()
        return ChainFit(
            layout,
            self._orders[layout.acting],
            work.known_masses,
            where,
            at,
            work.forced,
        )

    def find_bands(
        self, models: Sequence[tuple[Chain, Mapping[Site, Sequence[ForceLaw]]]]
    ) -> Ruler:
        """Find the informative bands and cut the spectra above the last of them.

        A band is informative in a balance if the best of the models (the declared one,
        and one with flexible storeys) leaves less than half of its power on folds it
        was not fitted to, and no more than ten times the share that is typical of the
        balance; it is connected by such bands to those that hold 90 % of the energy.
        """
        core: np.ndarray | None = None
        for _ in range(ROUNDS):
            shares, reference = [], np.zeros_like(self.informative, dtype=float)
            for chain, laws in models:
                with suppress(NRFError), np.errstate(divide="ignore", invalid="ignore"):
                    powers = Trial(
                        self, chain, {s: tuple(held) for s, held in laws.items()}
                    ).powers
                    reference = powers.reference
                    part = powers.residual / reference
                    shares.append(np.where(np.isfinite(part), part, np.inf))
            if not shares:
                what = (
                    "The declared model cannot be fitted: columns of its balances"
                    " depend on each other or are zero"
                )
                raise NRFError(what, "Declare fewer terms, or give longer records.")
            left = np.min(shares, axis=0)
            if core is None:
                new = core = np.array([_strongest(own) for own in reference])
            else:
                new = np.array(
                    [
                        _connected(a < EXPLAINED, a, b, c)
                        for a, b, c in zip(left, reference, core)
                    ]
                )
            if np.array_equal(new, self.informative):
                break
            self.informative = new
        typical = np.array([_typical(a, b) / TENTH for a, b in zip(left, reference)])
        clear = [
            _connected(g & (a <= x), a, b, g)
            for g, a, b, x in zip(self.informative, left, reference, typical)
        ]
        last = int(np.flatnonzero(self.informative.any(axis=0))[-1])
        kept = slice(0, last + 1)
        return Ruler(
            self.work,
            self.windows.upto(last),
            self.informative[:, kept],
            np.array(clear)[:, kept],
        )

    def on_all(self) -> Ruler:
        """The same windows and bands on all samples of the records."""
        w, work = self.windows, self.work.whole
        windows = Windows(work.data, work.search, w.length, w.edges, w.centred)
        out = Ruler(work, windows, self.informative, self.clear)
        out.part, self._cache = self, {}
        return out

    def band(self) -> tuple[float | None, float | None]:
        """Lowest and highest frequency of all clear bands, Hz; None where no end was
        found.
        """
        inside = np.flatnonzero(
            self.clear.reshape(-1, len(self.windows.edges) - 1).any(axis=0)
        )
        low, high = self.windows.edges[[inside[0], inside[-1] + 1]]
        return float(low) or None, None if high >= self.work.fastest else float(high)

    def as_measured(self) -> Ruler:
        """The same ruler with the mean of every column left in: what tells a constant
        force.
        """
        w = self.windows
        informative, clear = self.informative.copy(), self.clear.copy()
        informative[:, 0] = clear[:, 0] = True
        out = Ruler(
            self.work,
            Windows(w.data, w.blocks, w.length, w.edges, False),
            informative,
            clear,
        )
        out.part = None if self.part is None else self.part.as_measured()
        return out

    def errors(self, powers: Powers) -> np.ndarray:
        """Error of each balance in its clear bands, percent."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return 100.0 * np.sqrt(
                self.clear_power(powers.residual) / self.clear_power(powers.reference)
            )

    def error(self, powers: Powers, scale: np.ndarray | None = None) -> float:
        """Pooled error, percent: every balance is first divided by its scale, the
        reference if None.
        """
        top, bottom = (
            self.clear_power(powers.residual),
            self.clear_power(powers.reference),
        )
        weight = 1.0 / np.where(
            (s := bottom if scale is None else scale) > 0, s, np.inf
        )
        return float(100.0 * np.sqrt((weight * top).sum() / (weight * bottom).sum()))

    def clear_power(self, power: np.ndarray) -> np.ndarray:
        """Power of each balance in its clear bands."""
        return (power * self.clear).sum(axis=1)


def _strongest(power: np.ndarray) -> np.ndarray:
    """Bands that hold most of the energy."""
    order = np.argsort(-power)
    count = 1 + int(np.searchsorted(np.cumsum(power[order]), ENERGY * power.sum()))
    out = np.zeros(len(power), dtype=bool)
    out[order[:count]] = True
    return out


def _connected(
    good: np.ndarray, left: np.ndarray, power: np.ndarray, core: np.ndarray
) -> np.ndarray:
    """The run of good bands that holds most of what is explained and touches the
    strongest bands.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[0], good.astype(int), [0]])))
    runs = [
        slice(lo, hi) for lo, hi in zip(edges[::2], edges[1::2]) if core[lo:hi].any()
    ]
    if not runs:
        return core
    out = np.zeros(len(good), dtype=bool)
    worth = power * (1.0 - np.minimum(left, 1.0))
    out[max(runs, key=lambda run: worth[run].sum())] = True
    return out


def _typical(left: np.ndarray, power: np.ndarray) -> float:
    """Share of the power that is left where half of the energy is."""
    order = np.argsort(left)
    middle = order[int(np.searchsorted(np.cumsum(power[order]), 0.5 * power.sum()))]
    return max(float(left[middle]), FLOOR**2 * TENTH)


class ChannelWork(Workspace):
    """Records in which floors have no sensor: the free run of a model, and its columns
    as the sensors see them.
    """

    def __init__(self, seen: Linearised, *given: Any) -> None:
        super().__init__(
            Dataset(seen.runs, sum(run.n_samples for run in seen.runs)), *given
        )
        self.seen, self.known, self.ends = (
            seen,
            np.ones_like(self.known),
            np.eye(self.n_dof),
        )

    def columns(
        self, site: Site, laws: Sequence[ForceLaw], records: Sequence[int]
    ) -> np.ndarray:
        """What the forces of laws do to the channels, (n_terms * n_channels,
        n_samples).
        """
        ends, of = (
            self.ends @ [site.incidence(j) for j in range(1, self.n_dof + 1)],
            super().columns,
        )
        return np.hstack(
            [self.seen.through(of(site, laws, [i]), ends, i) for i in records]
        )

    def fixed(self, records: Sequence[int]) -> list[np.ndarray]:
        """What inertias do to the channels; what the forces do, less what the run
        misses of them; the channels.
        """
        parts = []
        for i in records:
            rows = zip(super().fixed([i]), [*self.ends, *self.ends])
            each = [self.seen.through(row[None], end, i) for row, end in rows]
            force = np.sum(each[self.n_dof :], axis=0) - self.seen.gaps[i]
            parts.append(np.vstack([*each[: self.n_dof], force, self.seen.measured[i]]))
        return list(np.hstack(parts))


class ChannelRuler(Ruler):
    """Gains in the measured channels where floors have no sensor; all channels together
    stand for one balance.
    """

    work: ChannelWork

    def fit_of(
        self, layout: Layout, where: Mapping[Site, Sequence[int]], at: int
    ) -> ChainFit:
        """The solve of a set of columns."""
        return ChannelFit(layout, self.work.known_masses, where, at)

    def missed(self, windows: Windows) -> Powers:
        """Powers of what the free run misses of the channels, and of the channels, in
        some windows.
        """
        seen = self.work.seen
        gaps = windows.spectra(lambda some: np.hstack([seen.gaps[i] for i in some]))
        measured = windows.spectra(
            lambda some: np.hstack([seen.measured[i] for i in some])
        )
        gap, whole = (
            np.einsum("fkii->fik", windows.grams(rows)) for rows in (gaps, measured)
        )
        return Powers(gap, whole.sum(axis=0))

    def find_channel_bands(self, band: tuple[float | None, float | None]) -> np.ndarray:
        """Take the bands in which the run explains more than half of a channel, and
        that touch its core.
        """
        powers, edges, (low, high) = self.missed(self.windows), self.windows.edges, band
        inside = (edges[:-1] >= (low or 0.0)) & (edges[1:] <= (high or np.inf))
        pairs = zip(
            *(x.reshape(-1, len(inside)) for x in (powers.shares, powers.reference))
        )
        good = [
            _connected(a < EXPLAINED, a, b, _strongest(b * inside)) & inside
            for a, b in pairs
        ]
        self.informative = self.clear = np.array(good).reshape(1, -1)
        return self.informative


class Trial:
    """A set of laws, every shape parameter with a value, fitted and judged on the
    ruler.

    Attributes
    ----------
    powers : Powers
        On folds that the fit did not see.
    masses, theta : ndarray of shape (n_folds + 1, ...)
        Masses and coefficients from all folds, then with each fold left out.
    weights : ndarray of shape (n_dof, n_bands)
        One over the power of the residual: bands full of noise do not count.
    """

    def __init__(self, ruler: Ruler, chain: Chain, laws: Laws) -> None:
        self.ruler, self.base = ruler, chain
        self.laws = {s: tuple(held) for s, held in laws.items() if held}
        self.chain = chain.with_links(self.laws)
        self.layout = LawLayout(self.chain, self.laws)
        self.grams = ruler.grams(self)
        self.summed = self.grams.sum(axis=0)
        self.at = self.layout.n_terms
        self.slots: dict[
            Any, ChainFit
        ] = {}  # solves with further columns, by their sites and numbers
        where = {
            s: list(range(rows.start, rows.stop))
            for s, rows in self.layout.slices.items()
        }
        self.fit = ruler.fit_of(self.layout, where, self.at)
        weights = ruler.informative.astype(float)
        known = np.tensordot(
            self.used(self.fit).T, self.grams, 1
        )  # what serves each group of balances
        for _ in range(ROUNDS):
            self.weights = weights
            left, whole = self._fitted(known)
            floored = left + FLOOR**2 * whole
            weights = np.where(
                ruler.informative & (floored > 0),
                1.0 / np.maximum(floored, 1e-300),
                0.0,
            )
            if not np.isfinite(left).all() or np.allclose(
                weights, self.weights, rtol=0.05
            ):
                break
        self.powers, self.within = Powers(self._judged(), whole), left
        if not np.isfinite(self.powers.residual).all():
            raise NRFError(
                "The columns of the balances depend on each other", "Leave a law out."
            )
        self.weights = weights
        # A scan reads all folds, also those in which a force is unknown: both sides of
        # a comparison hold them alike.
        rows = (x[0] for x in self.fit.rows(self.masses[:1], self.theta[:1]))
        self.shares = share(
            *(
                np.einsum("ip,kpq,iq->ik", x, self.summed, x, optimize=True)
                for x in rows
            )
        )

    @cached_property
    def spectra(self) -> np.ndarray:
        """Spectra of the columns of the laws, then of accelerations and forces."""
        return np.vstack(self.columns())

    @cached_property
    def keys(self) -> list[Any]:
        """What the rows of the spectra are, whatever the model."""
        laws = [
            (s, law, k)
            for s in self.layout.sites
            for law in self.laws.get(s, ())
            for k in range(len(law.terms()))
        ]
        kept = self.ruler.keys
        return [
            kept.setdefault(one, len(kept))
            for one in [*laws, *range(len(self.ruler.fixed))]
        ]

    @cached_property
    def heavy(self) -> np.ndarray:
        """Weighted sums of the products over all folds and bands, by balance, (n_dof,
        p, p).
        """
        return np.tensordot(self.weights, self.summed, 1)

    def columns(self) -> list[np.ndarray]:
        """The same, law by law."""
        held = [
            self.ruler.rows(s, law)
            for s in self.layout.sites
            for law in self.laws.get(s, ())
        ]
        return [*held, self.ruler.fixed]

    def on_part(self) -> Trial:
        """The same laws on the excerpts of long records."""
        return (
            self
            if self.ruler.part is None
            else Trial(self.ruler.part, self.base, self.laws)
        )

    def _fitted(self, grams: np.ndarray) -> np.ndarray:
        """Power of the residual and of the reference where all folds are fitted, (2,
        n_dof, n_bands).
        """
        sums = np.einsum(
            "uk,ukpq->upq", self.weights_of(self.fit), grams, optimize=True
        )
        rows = np.concatenate(
            self.fit.rows(*self.fit.solve(sums[None], self.ruler.strict))
        )[:, :, None, None]
        power = ((rows @ grams[self.fit.judged]) * rows).sum(axis=(-2, -1))
        return np.where(np.isfinite(power), np.maximum(power, 0.0), np.inf)

    def _judged(self) -> np.ndarray:
        """Power of the residual on each fold, which the fit did not see, (n_folds,
        n_dof, n_bands).
        """
        fit, grams, used = self.fit, self.grams, self.used(self.fit)
        sums = (
            np.einsum("uk,fkpq->fupq", self.weights_of(fit), grams, optimize=True)
            * used[:, :, None, None]
        )
        self.masses, self.theta = _by_folds(fit, sums, self.ruler.strict)
        rows = fit.rows(self.masses[1:], self.theta[1:])[0][:, None]
        part = ((rows @ grams) * rows).sum(axis=-1).swapaxes(1, 2)
        return np.where(
            used[:, fit.judged, None],
            np.where(np.isfinite(part), np.maximum(part, 0.0), np.inf),
            0.0,
        )

    def used(self, fit: ChainFit) -> np.ndarray:
        """Which folds serve which group of balances: those in which all its forces are
        known, (n_folds, n_groups).
        """
        known = self.ruler.known
        return np.array(
            [known[:, [j - 1 for j in g.dofs]].all(axis=1) for g in fit.groups]
        ).T

    def weights_of(self, fit: ChainFit) -> np.ndarray:
        """Weights of the bands for each group of balances; a sum has those of its
        lowest DOF.
        """
        return self.weights[[g.dofs[0] - 1 for g in fit.groups]]

    def with_laws(self, placed: Placed) -> Trial:
        """The trial with further laws."""
        laws = dict(self.laws)
        for site, law in placed:
            laws[site] = (*laws.get(site, ()), law)
        return Trial(self.ruler, self.base, laws)

    def without(self, site: Site, law: ForceLaw) -> Trial:
        """The trial without one law."""
        held = list(self.laws[site])
        held.remove(law)
        return Trial(self.ruler, self.base, {**self.laws, site: tuple(held)})

    def solution(self, *found: np.ndarray) -> Solution:
        """Masses and coefficients from all folds, or those that are given."""
        masses, theta = found or (self.masses[0], self.theta[0])
        coefficients = {s: theta[rows] for s, rows in self.layout.slices.items()}
        return Solution(dict(enumerate(masses.tolist(), 1)), coefficients)

    def model(self, *found: np.ndarray) -> ChainModel:
        """The fitted chain model, or that with given masses and coefficients."""
        return model_of(self.layout, self.solution(*found))

    @property
    def left(self) -> np.ndarray:
        """Error of each balance on the samples of the fit, percent."""
        return self.ruler.errors(Powers(self.within[None], self.powers.reference))

    def gain_over(self, other: Trial) -> Gain:
        """Gain of this model over another on the same ruler."""
        return Gain(other.powers, self.powers, self.ruler.informative)

    def powers_on(self, ruler: Ruler) -> Powers:
        """Powers of the fitted model on other samples."""
        other = Trial.__new__(Trial)
        other.ruler, other.base, other.laws = ruler, self.base, self.laws
        other.layout = self.layout
        grams = ruler.grams(other)
        residual, reference = (
            rows[0] for rows in self.fit.rows(self.masses[:1], self.theta[:1])
        )
        known = other.used(self.fit)[:, self.fit.judged, None]
        part, whole = (
            np.einsum("ip,fkpq,iq->fik", x, grams, x, optimize=True)
            for x in (residual, reference)
        )
        return Powers(
            np.where(known, np.maximum(part, 0.0), 0.0),
            np.where(known, whole, 0.0).sum(axis=0),
        )


def _by_folds(
    fit: ChainFit, sums: np.ndarray, strict: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """Masses and coefficients from all folds, then as if each had been left out.

    A fold left out keeps a tenth of its weight, and the change is taken for nine tenths
    of all: where one fold alone tells parameters apart (the transient before a steady
    state), the others would extrapolate at random.
    """
    masses, theta = fit.solve(
        np.concatenate([sums.sum(axis=0)[None], leave_one_out(sums) + TENTH * sums]),
        strict,
    )
    for found in (masses, theta):
        found[1:] += TENTH / (1.0 - TENTH) * (found[1:] - found[0])
    return masses, theta


class Slot:
    """A place for further laws on top of a trial, whatever the values of their shape
    parameters.
    """

    def __init__(self, trial: Trial, placed: Placed, extra: int = 0) -> None:
        self.trial = trial
        self.sites = [site for site, _ in placed]
        self.widths = [len(law.terms()) + extra for _, law in placed]
        laws = dict(trial.laws)
        for site, law in placed:
            laws[site] = (*laws.get(site, ()), law)
        chain = trial.chain.with_links(self.sites)
        LawLayout(
            chain, {site: laws[site] for site in self.sites}
        )  # an error where terms stand twice
        kind = tuple(zip(self.sites, self.widths))
        if kind not in trial.slots:
            where = {
                s: list(range(rows.start, rows.stop))
                for s, rows in trial.layout.slices.items()
            }
            at = trial.summed.shape[-1]
            for site, width in kind:
                where[site] = [*where.get(site, ()), *range(at, at + width)]
                at += width
            layout = Layout(chain, {s: len(where.get(s, ())) for s in laws})
            trial.slots[kind] = trial.ruler.fit_of(
                layout, {s: where.get(s, []) for s in layout.sites}, trial.at
            )
        self.fit, size = trial.slots[kind], trial.summed.shape[-1]
        self.beside = [
            row
            for row in self.fit.beside(range(size, size + sum(self.widths)))
            if row < size
        ]

    @cached_property
    def _rows(self) -> np.ndarray:
        """Spectra of the rows beside which the columns stand."""
        return self.trial.spectra[self.beside]

    def left_out(self, columns: np.ndarray) -> np.ndarray:
        """Coefficients of the columns of one law (n_columns, size) with each fold left
        out of the fit.
        """
        trial = self.trial
        grams = trial.ruler.windows.grams(*trial.columns(), columns)
        weights = trial.weights_of(self.fit)
        sums = (
            np.einsum("uk,fkpq->fupq", weights, grams, optimize=True)
            * trial.used(self.fit)[:, :, None, None]
        )
        return _by_folds(self.fit, sums)[1][1:, trial.summed.shape[-1] :]

    def springs(self, theta: np.ndarray) -> np.ndarray:
        """Forces of the springs beside the laws, (n_points, n_springs); negative where
        a law replaces one.
        """
        trial = self.trial
        every = [
            (s, t.label)
            for s in trial.layout.sites
            for law in trial.laws.get(s, ())
            for t in law.terms()
        ]
        there = np.array(
            [s in self.sites and label == "s" for s, label in every], dtype=bool
        )
        held = np.flatnonzero(there & (trial.theta[0, : trial.at] > 0))
        return theta[:, held] * np.sqrt(trial.summed[:, held, held].sum(axis=0))

    def _products(
        self, points: Sequence[tuple[ForceLaw, ...]], rows: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Products of columns with some rows, (n_rows, n_bands, n_points, n_columns),
        and with each other, by band.
        """
        ruler, windows = self.trial.ruler, self.trial.ruler.windows
        each = (
            ruler.columns(s, [laws[k] for laws in points])
            for k, s in enumerate(self.sites)
        )
        parts = [
            found.reshape(len(points), width, -1)
            for found, width in zip(each, self.widths)
        ]
        columns = parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)
        wide = columns.reshape(-1, columns.shape[-1])
        cross = np.array(
            [rows[:, band] @ wide[:, band].T for band in windows.bands]
        ).swapaxes(0, 1)
        return cross.reshape(
            len(rows), len(windows.bands), *columns.shape[:2]
        ), windows.products(columns)

    def _with_model(
        self, points: Any, kept: dict[Any, np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Products of columns with all rows of the model, and with each other, by band;
        ``kept`` ones not anew.
        """
        trial, windows = self.trial, self.trial.ruler.windows
        missing = [row for row in self.beside if trial.keys[row] not in kept]
        width, count = sum(self.widths), len(points)
        if missing or None not in kept:
            rows = self._rows if missing == self.beside else trial.spectra[missing]
            few = max(1, _AT_ONCE // (width * windows.size))
            parts = [
                self._products(points[at : at + few], rows)
                for at in range(0, count, few)
            ]
            kept[None] = np.concatenate([inside for _, inside in parts])
            kept |= zip(
                [trial.keys[row] for row in missing],
                np.concatenate([new for new, _ in parts], axis=2),
            )
        cross = np.zeros((len(windows.bands), len(trial.keys), count, width))
        for row in self.beside:
            cross[:, row] = kept[trial.keys[row]]
        return cross, kept[None]

    def gains(
        self,
        points: Sequence[tuple[ForceLaw, ...]],
        kept: dict[Any, np.ndarray] | None = None,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Gains of laws on the samples of the fit, dB, all coefficients and the sizes
        of their columns.
        """
        trial = self.trial
        cross, inside = self._with_model(points, {} if kept is None else kept)
        bands, size, count, width = cross.shape
        weights = trial.weights_of(self.fit)
        total = np.empty((count, len(weights), size + width, size + width))
        total[..., :size, :size] = trial.heavy[[g.dofs[0] - 1 for g in self.fit.groups]]
        total[..., :size, size:] = np.tensordot(weights, cross, 1).transpose(2, 0, 1, 3)
        total[..., size:, :size] = total[..., :size, size:].swapaxes(-1, -2)
        total[..., size:, size:] = (weights @ inside.reshape(count, bands, -1)).reshape(
            count, -1, width, width
        )
        masses, theta = self.fit.solve(total, trial.ruler.strict)
        rows = np.concatenate(self.fit.rows(masses, theta), axis=1)[:, None]
        held, new = rows[..., :size], rows[..., size:]
        flat = held.reshape(-1, size)
        power = (
            ((flat @ trial.summed) * flat)
            .sum(axis=-1)
            .reshape(bands, count, -1)
            .transpose(1, 2, 0)
        )
        power = power + (
            (2.0 * held @ cross.transpose(2, 0, 1, 3) + new @ inside) * new
        ).sum(axis=-1).swapaxes(1, 2)
        power, whole = np.split(power, 2, axis=1)
        shares = share(
            np.where(np.isfinite(power), np.maximum(power, 0.0), np.inf), whole
        )
        sizes = np.sqrt(inside.diagonal(0, 2, 3).sum(axis=1))
        return fall(trial.shares, shares, trial.ruler.informative), theta, sizes
