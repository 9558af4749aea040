"""Missing terms, contradicting balances and forces that jump, judged from the data
alone.

Each balance is offered probe regressors that its laws lack; where they help on left-out
windows, a law is missing or the motion is noisy. A constant and a ramp are offered
separately: a sensor's wrong zero or drift. Under complete excitation the two balances
of a storey must agree. Leaving out the samples near velocity reversals, where the sign
of the rate is unreliable, must not change the coefficient of a force that jumps there.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy import linalg

from ..chain.layout import Block, LawLayout, Layout, Recipe, copies
from ..chain.sites import Site
from ..equations.accumulation import GramPass
from ..equations.chain_solve import Solution, groups_of, solve
from ..equations.errors import residual_weights
from ..equations.normal_equations import NormalEquations, variance
from ..exceptions import BiasWarning, NRFError, RankWarning
from ..laws.friction import jump_at_reversal
from ..records.dataset import Dataset
from ..records.fusion.noise_levels import white_level
from .sample_windows import FOLDS, LASTING, OFFERED, Window

GAIN = 5.0  # percent of the held-out residual that the extra columns must remove
MISSING = 2.0  # percent of the balance's right-hand side that they must explain
# percent of the held-out residual that a constant and a ramp must remove for zeros to
# be doubted
STILL = 90.0
# of a Gram matrix of columns of unit length; below it columns may depend on each other
_PIVOT = 1e-10
_ROUND_OFF = 1e-6  # share of the balance below which a residual is round-off
ROWS_PER_COLUMN = 20  # fewer samples than this are too few for further columns


class MissingTerms:
    """Gram matrices of own and offered columns, collected window by window."""

    def __init__(
        self, model: Any, solve_order: Any, layout: LawLayout | None = None
    ) -> None:
        self.solve_order, self.layout = (
            solve_order,
            layout or LawLayout(model.chain, model.laws),
        )
        self.coefficients = model.coefficients
        # the columns of each site: its own, then those offered
        self.wide = Layout(
            self.layout.chain,
            {s: self.layout.counts[s] + OFFERED for s in self.layout.acting},
        )
        groups = [
            self.wide.group(dofs)
            for dofs in dict.fromkeys(step.dofs for step in solve_order.steps)
        ]
        self.masses = dict(enumerate(model.masses.tolist(), 1))
        self.folds = GramPass(self.wide, groups, self.masses, n_blocks=FOLDS)
        self.counts = dict.fromkeys((g.dofs for g in groups), 0)
        self.n_rows = 0
        self._recipe: tuple[Recipe | None, Recipe] | None = None

    def add(self, number: int, window: Window) -> None:
        """Take a window in."""
        window = window.enough()
        block = window.block
        self.n_rows += window.n_samples
        if self._recipe is None or self._recipe[0] is not block.recipe:
            self._recipe = block.recipe, _widened(block.recipe, self.layout, self.wide)
        source = np.vstack(
            [
                block.terms if block.source is None else block.source,
                *window.offered.values(),
            ]
        )
        columns = source, self._recipe[1], self.wide.n_terms, block.weights
        self.folds.add(
            Block(None, block.acceleration, block.force, *columns), number % FOLDS
        )
        known = (~np.isnan(block.force[:, 0])).tolist()
        for dofs in self.counts:
            self.counts[dofs] += all(known[j - 1] for j in dofs)

    def table(self) -> pd.DataFrame:
        """What the laws leave unexplained, step by step: ``missing_terms_`` of a
        regressor.
        """
        alike: dict[tuple[int, int], list[tuple[str, bool, bool, np.ndarray]]] = {}
        steps = [step for step in self.solve_order.steps if self.counts[step.dofs]]
        folds = self.folds.grams()
        for step in steps:
            combine = _combination(
                step, self.layout, self.coefficients, self.masses, folds
            )
            n_own = len(step.masses) + sum(self.layout.counts[s] for s in step.sites)
            p = combine.shape[1] - 1
            enough = (
                self.counts[step.dofs] >= 2 * FOLDS
                and self.n_rows >= ROWS_PER_COLUMN * p
            )
            grams = combine.T @ folds.matrices[step.dofs] @ combine
            alike.setdefault((p, n_own), []).append(
                (step.name, bool(step.masses), enough, grams)
            )
        rows: dict[str, np.ndarray] = {}
        for (_, n_own), held in alike.items():
            names, masses, enoughs, grams = zip(*held)
            rows |= dict(
                zip(
                    names,
                    _judged(
                        np.array(grams), n_own, np.array(masses), np.array(enoughs)
                    ),
                )
            )
        residual, gain, shift, lasting = (
            np.array([rows[step.name] for step in steps]).reshape(-1, 4).T
        )
        missing = residual * np.sqrt(gain / 100)
        columns = {
            "residual": residual,
            "gain": gain,
            "missing": missing,
            "shift": shift,
            "lasting": lasting,
        }
        biased = (gain > GAIN) & (missing > MISSING)
        return pd.DataFrame(
            {**columns, "biased": biased}, index=[step.name for step in steps]
        )


def wrong_zeros(table: pd.DataFrame) -> list[str]:
    """A question on the zeros of sensors, where a constant or a ramp explains nearly
    all that a balance leaves.
    """
    lasting = table["lasting"].to_numpy()
    size = table["residual"].to_numpy() * np.sqrt(lasting / 100)
    hit = np.flatnonzero((lasting > STILL) & (size > MISSING))
    if not len(hit):
        return []
    worst = str(table.index[hit[size[hit].argmax()]])
    row = table.loc[worst]
    others = f" (and {len(hit) - 1} more)" if len(hit) > 1 else ""
    where = worst.removeprefix("balance of ").removesuffix(" together")
    return [
        f"{worst[0].upper()}{worst[1:]}{others}: {row['residual']:.3g} % of it is"
        " unexplained, and a constant or a straight line in time explains"
        f" {row['lasting']:.0f} % of that on held-out data. Does a displacement there"
        f" (of {where} or a neighbour) or its force read a wrong zero, or drift? By"
        " least squares masses and stiffnesses come out wrong then: take out the mean"
        " of every displacement and force, or give band=(lo, hi) above a drift. Or has"
        " a storey yielded, or does a constant force act there? Add its law (laws=)."
    ]


def warn_of_bias(
    table: pd.DataFrame, masses: Sequence[str] = (), stacklevel: int = 2
) -> None:
    """Raise one BiasWarning if masses or zeros are doubtful, or a step in a table of
    missing terms is biased.
    """
    zeros = wrong_zeros(table)
    said = [*zeros, *masses]
    biased = table["biased"].to_numpy(dtype=bool)
    if (
        biased.any() and not zeros
    ):  # further terms follow a constant too, once the fit is ruined by it
        hit = table[biased]
        worst = hit["missing"].idxmax()
        row = hit.loc[worst]
        others = f" (and {len(hit) - 1} more)" if len(hit) > 1 else ""
        said.append(
            f"{worst[0].upper()}{worst[1:]}{others}: {row['residual']:.2g} % of it is"
            " unexplained, and that is not noise alone: terms the laws do not have"
            f" explain {row['gain']:.0f} % of it on held-out data. A law is missing"
            " there (hysteresis, friction, a gap) or the motion is noisy; masses and"
            " forces are likely biased. Add the law (laws=), search for it"
            " (close_loop), or fuse noisy channels with KinematicSmoother."
        )
    if said:
        warnings.warn(" ".join(said), BiasWarning, stacklevel=stacklevel)


def _widened(recipe: Recipe | None, layout: LawLayout, wide: Layout) -> Recipe:
    """Recipe of own and offered columns from [source of the own | offered columns of
    each site].
    """
    if recipe is None:  # the columns of the laws are given
        given = np.arange(layout.n_terms)
        recipe = Recipe(copies(given, given), (), (), layout.n_terms)
    sites = layout.acting
    own = [
        row
        for s in sites
        for row in range(wide.slices[s].start, wide.slices[s].stop - OFFERED)
    ]
    offered = [
        row
        for s in sites
        for row in range(wide.slices[s].stop - OFFERED, wide.slices[s].stop)
    ]
    helpers = np.arange(
        max(0, int(recipe.steps[:, 0].max(initial=-1)) + 1 - layout.n_terms)
    )
    at = np.array([*own, *(wide.n_terms + helpers), -1], dtype=np.int64)
    row, x, p = recipe.steps.T
    added = copies(offered, recipe.n_source + np.arange(len(offered)))
    whole = np.vstack([np.column_stack([at[row], x, at[p]]), added])
    return replace(recipe, steps=whole, n_source=recipe.n_source + len(offered))


def _combination(
    step: Any,
    layout: LawLayout,
    coefficients: dict,
    masses: dict,
    grams: NormalEquations,
) -> np.ndarray:
    """From the columns of a group to [own columns | offered columns | right-hand side]
    of one step.
    """
    where, mass_at, target_at = grams.positions(step.dofs)
    signs = dict(zip(grams.groups[step.dofs].sites, grams.groups[step.dofs].signs))
    own = [mass_at] if step.masses else []
    own += [where[s].start + k for s in step.sites for k in range(layout.counts[s])]
    sites = (*step.sites, *step.known_sites)
    offered = [
        where[s].stop - OFFERED + k for s in sites for k in range(OFFERED - LASTING)
    ]
    offered += [
        where[s].stop - LASTING + k for s in sites[:1] for k in range(LASTING)
    ]  # the same at all sites
    out = np.zeros((target_at + 1, len(own) + len(offered) + 1))
    out[[*own, *offered], np.arange(len(own) + len(offered))] = 1.0
    out[target_at, -1] = 1.0
    if mass_at is not None and not step.masses:
        out[mass_at, -1] = -masses[step.dofs[0]]
    for site in step.known_sites:
        out[where[site].start : where[site].stop - OFFERED, -1] = (
            -signs[site] * coefficients[site]
        )
    return out


def _judged(
    grams: np.ndarray, n_own: int, has_mass: np.ndarray, enough: np.ndarray
) -> np.ndarray:
    """Residual, gain, shift and lasting of some steps that have as many columns, shape
    (n_steps, 4).
    """
    total = grams.sum(axis=1)
    scale = np.sqrt(np.einsum("kii->ki", total))
    scale[scale == 0] = 1.0
    total = total / scale[:, :, None] / scale[:, None]
    grams = grams / scale[:, None, :, None] / scale[:, None, None]
    p = total.shape[-1] - 1
    own = np.arange(n_own)
    lasting_from = max(p - LASTING, n_own)  # no site, no further columns
    both = np.arange(lasting_from)
    still = np.r_[own, lasting_from:p]
    alone = solved(total, own)
    force = total[:, p, p]
    share = np.sqrt(left_over(total, own, alone) / np.where(force > 0, force, 1.0))
    out = np.zeros((len(grams), 4))
    out[:, 0] = 100 * share
    out[~has_mass, 2] = np.nan
    some = np.flatnonzero((share >= _ROUND_OFF) & enough)
    if some.size:
        tests = grams[some]
        train = total[some, None] - tests
        with_own, *with_more = (
            left_over(tests, c, solved(train, c)).sum(axis=1)
            for c in (own, both, still)
        )
        out[some, 1], out[some, 3] = (
            100 * np.maximum(0.0, 1 - left / with_own) for left in with_more
        )
        moved = some[has_mass[some]]
        if moved.size:
            mass = alone[moved, 0]
            new = solved(total[moved], both)[:, 0]
            out[moved, 2] = np.where(
                mass, 100 * (new / np.where(mass, mass, 1.0) - 1), 0.0
            )
    return out


def solved(grams: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Coefficients of some columns from the Gram matrices of [columns | right-hand
    side], the last axes.
    """
    matrix, target = grams[..., columns[:, None], columns], grams[..., columns, -1]
    if not columns.size:
        return target
    try:
        pivots = np.linalg.cholesky(matrix).diagonal(axis1=-2, axis2=-1)
    except np.linalg.LinAlgError:
        pivots = np.zeros(1)
    if pivots.min() ** 2 > _PIVOT:
        return np.linalg.solve(matrix, target[..., None])[..., 0]
    out = np.empty_like(target)
    for at in np.ndindex(target.shape[:-1]):
        out[at] = linalg.lstsq(matrix[at], target[at], cond=1e-13, check_finite=False)[
            0
        ]
    return out


def left_over(grams: np.ndarray, columns: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Residual sums of squares of given coefficients."""
    matrix, target = grams[..., columns[:, None], columns], grams[..., columns, -1]
    image = (matrix @ c[..., None])[..., 0] - 2 * target
    return np.maximum(grams[..., -1, -1] + (c * image).sum(axis=-1), 0.0)


def contradictions_of(solution: Solution) -> list[str]:
    """Sentences on storeys and links that two balances find unlike each other."""
    solution = solution.alone or solution
    fits = {fit.step.dofs[0]: fit for fit in solution.fits if fit.contradicts}
    hit = [site for site in sorted(solution.twins, key=str) if site.q in fits]
    if not hit:
        return []
    site = max(hit, key=lambda site: fits[site.q].crossed)
    shared = set.intersection(*({s.p, s.q} for s in hit))
    if len(hit) > 1 and len(shared) == 1:
        whose = f"DOF {shared.pop()}, where all of them meet,"
    else:
        whose = "one of DOF " + ", ".join(
            map(str, sorted({j for s in hit for j in (s.p, s.q)}))
        )
    is_are = "are" if len(hit) > 1 else "is"
    names = " and ".join(map(str, hit))
    return [
        f"Balances contradict each other: {names} {is_are} found twice, and unlike each"
        f" other. The balance of DOF {site.q} is {100 * fits[site.q].crossed:.0f} % off"
        f" with the law of {site} that the balance of DOF {site.p} finds,"
        f" {100 * fits[site.q].share:.2g} % with its own. Is the force (its unit, gain,"
        f" sign, channel) or the known mass of {whose} wrong? Otherwise noise or a"
        " missing law biases one of them."
    ]


_GROUPS = 8  # of windows, whose scatter gives the standard errors
_NOTHING = 1e-3  # share of the force of its balance that is negligible
# Bias over standard error that leaves a 95 % interval 92 %: Phi(1.96 - b) - Phi(-1.96 -
# b) = 0.921 at b = 0.5.
NEGLIGIBLE = 0.5
# white noise below this share of a channel's rms is rounding, as in the fusion
_ROUNDING = 1e-6
# noise of a smooth nonlinear column over that of the motion: the power of a cubic
_STEEPNESS = 3.0


def noise_shares(data: Dataset, filters: Sequence[Any]) -> dict[str, float]:
    """Noise over rms of each acceleration, rate and drift: as fusion measured it; of
    arrays with a clock if white.
    """
    squares: dict[str, np.ndarray] = {}
    for seg, filter in zip(data.segments, filters):
        passed = 1.0 if filter is None else filter.noise_gain()
        for kind, j in product("avs", range(seg.n_dof)):
            y = getattr(seg, kind)[seg.valid, j].astype(float)
            level = 0.0 if seg.dt is None else white_level(y, 10)
            if seg.noise:
                ends = [j + 1] if kind == "a" or j == 0 else [j + 1, j]
                level = float(
                    np.linalg.norm(
                        [_level(seg.noise, kind.replace("s", "x"), i) for i in ends]
                    )
                )
            held = squares.setdefault(f"{kind}{j + 1}", np.zeros(2))
            held += len(y) * passed * level**2, y @ y
    return {
        name: float(np.sqrt(noise / size)) if size else 0.0
        for name, (noise, size) in squares.items()
    }


def _level(noise: Mapping[str, float], kind: str, j: int) -> float:
    """Noise of a channel; of a rate that was not measured at most the geometric mean of
    its neighbours' (Landau).
    """
    if kind == "v" and f"v{j}" not in noise:
        return float(np.sqrt(_level(noise, "x", j) * _level(noise, "a", j)))
    return noise.get(f"{kind}{j}", np.inf)


class NoiseBias(NamedTuple):
    """What noise in the motion does to least squares in one balance."""

    errors: float  # largest bias, in standard errors of its parameter
    dof: int | None  # whose mass is solved for
    mass: float  # share of it that is lost
    channel: str  # the noisiest, and its noise over its rms
    share: float


def noise_bias(
    model: Any, solve_order: Any, grams: NormalEquations, shares: Mapping[str, float]
) -> list[NoiseBias]:
    r"""Bias :math:`-(G - N)^{-1} N \theta` as the balances are solved, G their Gram
    matrix, N that of its noise.
    """
    if (
        max((share for share in shares.values() if np.isfinite(share)), default=np.inf)
        < _ROUNDING
    ):
        return []
    grams = grams.squares()
    systems: list[Any] = []
    for step in solve_order.steps:
        gram, (where, mass_at, _) = (
            grams.matrices[step.dofs],
            grams.positions(step.dofs),
        )
        weights = residual_weights(
            dict(enumerate(model.masses, 1)), model.coefficients, grams, step.dofs
        )
        # by column: its parameter, sign, noise over rms, channel
        held: dict[Any, Any] = (
            {
                mass_at: (
                    step.dofs[0],
                    1.0,
                    shares[f"a{step.dofs[0]}"],
                    f"a{step.dofs[0]}",
                )
            }
            if step.masses
            else {}
        )
        for site, sign in zip(where, grams.groups[step.dofs].signs):
            ends = range((site.q or 0) + 1, site.p + 1)
            for k, label in enumerate(
                grams.layout.labels(site) if site in step.sites else (),
                where[site].start,
            ):
                linear = label in ("v", "s")
                kinds = label if linear else "vs"
                noisy = max(
                    (f"{one}{j}" for one, j in product(kinds, ends)),
                    key=shares.__getitem__,
                )
                held[k] = (
                    (site, k - where[site].start),
                    sign,
                    shares[noisy] * (1.0 if linear else _STEEPNESS),
                    noisy,
                )
        held = {k: one for k, one in held.items() if gram[k, k] > 0}
        left = float(weights @ gram @ weights) / max(float(grams.sizes[step.dofs]), 1.0)
        if held and left > 0:
            own = np.array([*held])
            keys, signs, noise, names = zip(*held.values())
            lost, ways = np.square(noise) * np.diag(gram)[own], np.array(signs)
            # what is quick in a channel may be motion: noise leaves at least its own
            # force of the balance
            force = float(lost @ weights[own] ** 2)
            if np.isfinite(force) and force > 0:
                lost = lost * min(1.0, left * float(grams.sizes[step.dofs]) / force)
            signed = gram[np.ix_(own, own)] * ways * ways[:, None]
            systems.append(
                (
                    list(keys),
                    signed / left,
                    lost / left,
                    weights[own] * ways,
                    list(names),
                )
            )
    if solve_order.strategy == "joint" and systems:
        systems = [_together(systems)]
    return [one for system in systems for one in _biases(shares, *system)]


def _together(systems: list[Any]) -> Any:
    """Balances that are solved together, each over the power of its residual, as one
    system.
    """
    found = {
        key: (value, name)
        for keys, _, _, theta, names in systems
        for key, value, name in zip(keys, theta, names)
    }
    gram, lost = np.zeros((len(found), len(found))), np.zeros(len(found))
    for keys, own, noise, *_ in systems:
        at = [[*found].index(key) for key in keys]
        gram[np.ix_(at, at)] += own
        lost[at] += noise
    return (
        [*found],
        gram,
        lost,
        np.array([value for value, _ in found.values()]),
        [name for _, name in found.values()],
    )


def _biases(
    shares: Mapping[str, float],
    keys: list[Any],
    gram: Any,
    lost: Any,
    theta: Any,
    names: list[str],
) -> list[Any]:
    """Of each mass of a system, or of a system without one."""
    dofs: list[Any] = [key for key in keys if isinstance(key, int)] or [None]
    if not np.isfinite(lost).all():
        return [
            NoiseBias(np.inf, dof, 0.0, max(names, key=shares.__getitem__), np.inf)
            for dof in dofs
        ]
    size = np.sqrt(np.diag(gram))
    unit, noise, theta = gram / size[:, None] / size, lost / size**2, theta * size
    values, vectors = np.linalg.eigh(unit - np.diag(noise))
    # directions that noise makes up altogether cannot be restored; the bias is then
    # larger still
    values = np.maximum(values, 0.1 * np.diag(vectors.T @ unit @ vectors))
    bias = vectors @ (vectors.T @ (noise * theta) / values)
    error = np.sqrt(np.diag(np.linalg.pinv(unit, hermitian=True)))
    errors = float(np.max(np.abs(bias) / np.maximum(error, np.finfo(float).tiny)))
    out = []
    for dof in dofs:
        k = 0 if dof is None else keys.index(dof)
        part = (
            0.0
            if dof is None
            else float(np.clip(bias[k] / (theta[k] + bias[k] or 1.0), 0.0, 1.0))
        )
        near = [
            name for name in names if dof is None or int(name[1:]) in (dof, dof + 1)
        ]
        worst = max(near, key=shares.__getitem__)
        out.append(NoiseBias(errors, dof, part, worst, shares[worst]))
    return out


_NO_JUMPS = pd.DataFrame(
    columns=["found", "away", "lost", "wrong", "unit"]
)  # made once: it takes as long as a solve


class JumpBias:
    """Gram matrices with and without the samples near velocity reversals."""

    def __init__(
        self,
        model: Any,
        solve_order: Any,
        known_masses: Any = None,
        inner: Any = None,
        silent: bool = False,
        layout: LawLayout | None = None,
    ) -> None:
        self.model, self.solve_order, self.known, self.inner = (
            model,
            solve_order,
            dict(known_masses or {}),
            inner,
        )
        self.layout = layout or LawLayout(model.chain, model.laws)
        self.places = [] if silent else jumping_terms(self.layout)
        if self.places:
            groups = groups_of(self.layout, solve_order)
            self.whole, *self.kept = (
                GramPass(self.layout, groups, self.known, n_blocks=_GROUPS)
                for _ in (None, *SHARES)
            )

    @property
    def active(self) -> list[JumpBias]:
        """This diagnostic if any law jumps, else none."""
        return [self] if self.places else []

    def add(self, number: int, window: Window) -> None:
        """Take a window in."""
        self.whole.add(window.block, number % _GROUPS)
        for share, kept in zip(SHARES, self.kept):
            away = np.ones(window.n_samples, dtype=bool)
            for site in {site for site, _, _ in self.places}:
                away &= moving(window.rate(site), share)
            if away.any():
                kept.add(window.block.take(away), number % _GROUPS)

    def _solved(self, total: NormalEquations) -> np.ndarray:
        coefficients = solve(
            total, self.solve_order, self.known, self.inner
        ).coefficients
        return np.array([coefficients[site][at] for site, at, _ in self.places])

    def _with_chance(self, grams: NormalEquations) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients from all groups of windows, and with each group left out."""
        left_out = grams.leave_one_out()
        return self._solved(grams.sum()), np.array(
            [self._solved(left_out[g]) for g in range(_GROUPS)]
        )

    def table(self) -> pd.DataFrame:
        """``jump_bias_`` of a regressor; empty where nothing jumps or too few samples
        are left.
        """
        if not self.places:
            return _NO_JUMPS.copy()
        all_windows, fewer = self.whole.grams(), [kept.grams() for kept in self.kept]
        total = all_windows.sum()
        try:
            with warnings.catch_warnings(
                action="ignore", category=RankWarning
            ):  # the fit has warned
                found, without = self._with_chance(all_windows)
                kept = []
                with suppress(
                    NRFError, np.linalg.LinAlgError
                ):  # as long as fewer samples tell all terms apart
                    for grams in fewer:
                        kept.append(self._with_chance(grams))
        except (NRFError, np.linalg.LinAlgError):
            return _NO_JUMPS.copy()
        whole = _rms(total, self.places)
        # forces that hardly act in the samples kept cannot be estimated away from
        # standstill
        determined = np.all(
            [
                _rms(grams.sum(), self.places) >= _KEPT * whole
                for grams, _ in zip(fewer, kept)
            ],
            axis=0,
        )
        if not kept or not determined.any():
            return _NO_JUMPS.copy()
        away, left_out = kept[
            first_settled(
                [a[determined] for a, _ in kept], [r[:, determined] for _, r in kept]
            )
        ]
        lost = np.where(away, (away - found) / np.where(away, away, 1.0), 0.0)
        size = np.abs(away - found) * _weights(total, self.places, self.model.masses)
        wrong = made_wrong(found, away, left_out - without) & (size > _NOTHING)
        values = self.model.coefficients
        rows = [
            (values[s][k], away[i], lost[i], wrong[i], unit)
            for i, (s, k, unit) in enumerate(self.places)
        ]
        labels = [
            f"{site}: {self.layout.labels(site)[at]}" for site, at, _ in self.places
        ]
        return pd.DataFrame(rows, index=labels, columns=_NO_JUMPS.columns)[determined]


def _rms(total: NormalEquations, places: list[tuple[Site, int, str]]) -> np.ndarray:
    """Of the columns of some terms, in the balances that they act on first."""
    columns = [
        (site.p, total.positions((site.p,))[0][site].start + at)
        for site, at, _ in places
    ]
    return np.array(
        [
            np.sqrt(total.matrices[j,][k, k] / max(total.sizes[j,], 1))
            for j, k in columns
        ]
    )


def _weights(
    total: NormalEquations, places: list[tuple[Site, int, str]], masses: np.ndarray
) -> np.ndarray:
    """Force of each term with a coefficient of one, as a share of the applied or
    inertia force of its balance.
    """
    out = []
    for site, at, _ in places:
        where, mass_at, target_at = total.positions((site.p,))
        length = np.sqrt(np.diag(total.matrices[site.p,]))
        balance = max(
            length[target_at],
            0.0 if mass_at is None else masses[site.p - 1] * length[mass_at],
        )
        out.append(length[where[site].start + at] / balance if balance else np.inf)
    return np.array(out)


def sentences_of(table: pd.DataFrame) -> list[str]:
    """Messages on the wrong coefficients in a table of :class:`JumpBias`."""
    return [
        f"{name} is {row['found']:.4g} {row['unit']}, but {row['away']:.4g} without the"
        " samples near velocity reversals: noise, or a sampling rate too low for the"
        " jump, makes its sign wrong there, and least squares attributes the"
        " difference to other terms. Use estimation='iv'."
        for name, row in table.iterrows()
        if row["wrong"]
    ]


def jumping_terms(layout: LawLayout) -> list[tuple[Site, int, str]]:
    """Terms whose column jumps where the rate changes its sign: site, number there,
    unit of the coefficient.
    """
    out = []
    for site in layout.acting:
        at = 0
        for law in layout.laws[site]:
            terms = law.terms()
            if not law.has_memory:
                near, wide = np.abs(
                    jump_at_reversal(law, np.ones(len(law.covariates)))
                ).T
                out += [
                    (site, at + k, term.unit)
                    for k, term in enumerate(terms)
                    if near[k] > 0.5 * wide[k] > 0
                ]
            at += len(terms)
    return out


# Shares of the rms rate below which a sample counts as near standstill, in the order in
# which they are tried.
SHARES = (0.0, 0.03, 0.1, 0.2, 0.4)
_BESIDE = 2  # samples on each side of a velocity reversal that are left out too
# part of its rms that the column of a force must keep where samples are left out
_KEPT = 0.1
# Standard errors of a difference that are no longer chance, and the error of a
# coefficient that is acceptable.
_BEYOND, _WRONG = 3.0, 0.1


def moving(rate: np.ndarray, share: float) -> np.ndarray:
    """Mask of samples away from velocity reversals and faster than a share of the rms
    rate.
    """
    out = np.abs(rate) >= share
    reversals = np.flatnonzero(np.diff(np.sign(rate)))
    near = (reversals[:, None] + np.arange(1 - _BESIDE, 1 + _BESIDE)).ravel()
    out[np.clip(near, 0, len(out) - 1)] = False
    return out


def first_settled(found: Sequence[np.ndarray], without: Sequence[np.ndarray]) -> int:
    """Index of the first estimate, each from fewer samples, from which all later ones
    differ by chance only.
    """
    later = list(zip(found, without))
    for i, (one, parts) in enumerate(zip(found, without), 1):
        if not np.any([_beyond_chance(x - one, rest - parts) for x, rest in later[i:]]):
            break
    return i - 1


def made_wrong(
    found: np.ndarray, away: np.ndarray, difference: np.ndarray
) -> np.ndarray:
    """Mask of coefficients that differ from those away from standstill by more than a
    tenth and more than chance.
    """
    return (np.abs(away - found) > _WRONG * np.abs(away)) & _beyond_chance(
        away - found, difference
    )


def _beyond_chance(gap: np.ndarray, parts: np.ndarray) -> np.ndarray:
    return np.abs(gap) > _BEYOND * np.sqrt(variance(parts))
