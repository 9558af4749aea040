"""What kind of force is missing: what it depends on, told without a formula, by one regression.

Groups of columns (any function of the drift, of the rate, sliders that follow the path, ...) are fitted to some blocks
of the force and judged on the others: the share of its variance that they explain there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from ..common.jackknife import variance
from ..exceptions import ChannelError
from ..laws import Jenkins
from ..laws.shape import Motion
from ..mechanics.sites import Site
from . import words
from .residual import ROUND_OFF, NoiseFloor, Residual, period_of
from .words import Dependence, Feature

# What explains nearly as much with less wins: at most this much worse, in shares of the residual's squares.
NEARLY = 0.04
# Below this share nothing that was tried explains the force.
LEAST = 0.15
_LINE_LEVEL = 0.01
# How many neighbouring lines of a Hann window count as one: 1 + 2 ((2/3)^2 + (1/6)^2).
_HANN_OVERLAP = 35 / 18
# Every k-th sample is enough for the regressions, as long as so many are left in all and in a period.
_ENOUGH, _PER_PERIOD = 8000, 8
# Yield drifts of the sliders, in multiples of the rms drift: small ones are friction, large ones springs.
_YIELD, _FEW = (0.02, 0.06, 0.15, 0.3, 0.6, 1.0, 1.6, 2.5), (0.06, 0.15, 0.6, 1.6, 4.0)
# Gaps that are tried, in multiples of the rms drift.
_GAPS = tuple(np.arange(9) * 0.3)
_RIDGE = (1e-9, 1e-5, 1e-3, 3e-2)
# A storey is looked at for coupling where its residual is so many times the noise floor.
_LOUD = 2.0
# Share of it that laws of the storey's own motion may explain, without and with a sign of coupling; and that the
# others' motion must explain then, by so many standard errors.
_OWN, _ALL, _OTHERS, _SURELY = 0.5, 0.95, 0.05, 2.0


# -- the regression ---------------------------------------------------------------------------------


class Judge:
    """Least squares on some blocks, judged on the others; all on Gram matrices of blocks."""

    def __init__(
        self,
        force: Sequence[np.ndarray],
        groups: Mapping[str, Sequence[np.ndarray]],
        n_blocks: int = 25,
        n_folds: int = 5,
    ) -> None:
        ends = np.cumsum([0, *(parts[0].shape[1] for parts in groups.values())])
        self.at = {name: np.arange(a, b) for name, a, b in zip(groups, ends, ends[1:])}
        rows = [np.column_stack([*(parts[i] for parts in groups.values()), f]) for i, f in enumerate(force)]
        total = sum(map(len, rows))
        counts = [max(1, int(round(n_blocks * len(part) / total))) for part in rows]
        grams = np.array([b.T @ b for part, count in zip(rows, counts) for b in np.array_split(part, count)])
        self.size = np.sqrt(np.einsum("bii->i", grams))
        self.size[self.size == 0] = 1.0
        self.grams = grams / np.outer(self.size, self.size)
        self.folds = np.arange(len(grams)) % min(n_folds, len(grams))
        self._held_out: dict[tuple[str, ...], np.ndarray] = {(): self.grams[:, -1, -1]}

    def held_out(self, names: Sequence[str]) -> np.ndarray:
        """Squares left in every block by columns fitted to the other folds, shares of all; the best ridge counts."""
        key = tuple(names)
        if key not in self._held_out:
            index = np.append(np.concatenate([self.at[name] for name in key]), self.grams.shape[1] - 1)
            grams = self.grams[:, index[:, None], index]
            count = int(self.folds.max()) + 1
            parts = np.array([grams[self.folds == k].sum(axis=0) for k in range(count)])
            train = parts.sum(axis=0) - parts if count > 1 else parts
            tried = []
            for ridge in _RIDGE:
                full = np.column_stack([-_solved(train, ridge), np.ones(count)])[self.folds]
                tried.append(np.einsum("bi,bi->b", full, (grams @ full[:, :, None])[:, :, 0]))
            self._held_out[key] = np.maximum(min(tried, key=np.sum), 0.0)
        return self._held_out[key]

    def share(self, names: Sequence[str], beside: Sequence[str] = ()) -> tuple[float, float]:
        """Held-out share of the squares left by ``beside`` that further columns explain, and its standard error."""
        before, after = self.held_out(beside), self.held_out([*beside, *names])
        if before.sum() <= 0:
            return 0.0, 0.0
        return 1.0 - float(after.sum() / before.sum()), jackknife(before, after)

    def coefficients(self, names: Sequence[str]) -> dict[str, np.ndarray]:
        """Coefficients on all data, by name, in the columns' own units."""
        index = np.append(np.concatenate([self.at[name] for name in names]), self.grams.shape[1] - 1)
        w = _solved(self.grams.sum(axis=0)[None, index[:, None], index], 1e-6)[0]
        w = w * self.size[-1] / self.size[index[:-1]]
        ends = np.cumsum([0, *(len(self.at[name]) for name in names)])
        return {name: w[a:b] for name, a, b in zip(names, ends, ends[1:])}


def _solved(grams: np.ndarray, ridge: float) -> np.ndarray:
    """Ridge regression of the last column on the others, one for each Gram matrix."""
    A, h = grams[:, :-1, :-1], grams[:, :-1, -1:]
    eye = np.eye(A.shape[1])
    sizes = np.maximum(np.einsum("kii->ki", A), 1e-12)[:, None, :] * eye
    return np.linalg.solve(A + ridge * sizes + 1e-12 * eye, h)[:, :, 0]


def jackknife(before: np.ndarray, after: np.ndarray) -> float:
    """Standard error of ``1 - sum(after) / sum(before)`` over blocks."""
    if len(before) < 3:
        return float("nan")
    top, bottom = after.sum() - after, before.sum() - before
    ratio = np.divide(top, bottom, out=np.ones(len(before)), where=bottom > 0)
    return float(np.sqrt(variance(ratio)))


# -- its columns ------------------------------------------------------------------------------------


def hats(x: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """Piecewise linear functions that are 1 at one knot and 0 at the others, constant beyond the ends."""
    x = np.clip(x, knots[0], knots[-1])
    k = np.clip(np.searchsorted(knots, x, side="right") - 1, 0, len(knots) - 2)
    share, rows = (x - knots[k]) / (knots[k + 1] - knots[k]), np.arange(len(x))
    out = np.zeros((len(x), len(knots)))
    out[rows, k], out[rows, k + 1] = 1.0 - share, share
    return out


def knots_of(x: np.ndarray, count: int) -> np.ndarray:
    """Knots at quantiles and at even distances, so that rare large values have some too; 0 is one."""
    least = 0.02 * np.ptp(x)
    if least == 0:
        return np.array([x[0] - 1.0, x[0] + 1.0])
    even = np.linspace(x.min(), x.max(), count)
    knots = np.unique(np.concatenate([even, np.quantile(x, np.linspace(0, 1, count))]))
    knots = knots[np.abs(knots) > least]
    knots = knots[np.concatenate([[True], np.diff(knots) > least])]
    return np.sort(np.append(knots, 0.0)) if x.min() <= 0 <= x.max() else knots


def _products(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Products of every column of a with every column of b."""
    return (a[:, :, None] * b[:, None, :]).reshape(len(a), -1)


def _scale(parts: Sequence[np.ndarray]) -> float:
    """Rms of all parts; 1 where nothing moves."""
    return float(np.sqrt(np.mean(np.concatenate(parts) ** 2))) or 1.0


def _sliders(m: Motion, scale: float, shares: Sequence[float]) -> np.ndarray:
    """Elastic-plastic sliders of several yield drifts (Prandtl-Ishlinskii)."""
    still = Motion(m.s, m.v, m.a)
    return np.column_stack([Jenkins(uy=share * scale, Fy=1.0).features(still) for share in shares])


def own_columns(motions: Sequence[Motion], filters: Sequence[Any], every: int = 1) -> list[np.ndarray]:
    """Columns for laws of a site's own motion in few: friction, damping, springs, yielding."""
    size = _scale([m.s for m in motions])
    out = []
    for m, f in zip(motions, filters):
        few = [np.sign(m.v), m.v * np.abs(m.v), m.s**2, m.s**3, np.maximum(np.abs(m.s) - size, 0.0) * np.sign(m.s)]
        out.append(filtered(np.column_stack([*few, _sliders(m, size, _FEW)]), f)[::every])
    return out


def filtered(columns: np.ndarray, filter: Any) -> np.ndarray:
    """Columns through the filter of their record."""
    return columns if filter is None else filter.apply(columns)


def thinning(parts: Sequence[np.ndarray]) -> int:
    """Every how many samples of a drift are enough for a regression."""
    return int(max(1, min(sum(map(len, parts)) // _ENOUGH, period_of(parts) // _PER_PERIOD)))


class Basis:
    """Groups of columns of a motion, with knots and scales fixed by the motions they were made for."""

    def __init__(self, motions: Sequence[Motion]) -> None:
        self.s, self.v = (_scale([getattr(m, name) for m in motions]) for name in "sv")
        self.timed = all(m.t is not None for m in motions)
        shared = set.intersection(*(set(m.covariates) for m in motions))
        self.covariates = [c for c in motions[0].covariates if c in shared]
        self.covariates = [c for c in self.covariates if any(np.ptp(m.covariates[c]) > 0 for m in motions)]
        self._knots = {
            (name, count): knots_of(np.concatenate([self._line(m, name) for m in motions]), count)
            for name, count in [("s", 9), ("s", 4), ("v", 9), ("v", 4), *[("t", 7)] * self.timed]
            + [(c, 5) for c in self.covariates]
        }

    @staticmethod
    def _line(m: Motion, name: str) -> np.ndarray:
        return np.asarray(getattr(m, name) if name in ("s", "v", "t") else m.covariates[name], dtype=float)

    def _hats(self, m: Motion, name: str, count: int) -> np.ndarray:
        return hats(self._line(m, name), self._knots[name, count])

    def of(self, m: Motion) -> dict[str, np.ndarray]:
        """All groups by name; together with those named in ``ROWS`` they make a row of the table of shares."""
        x, y, sign, one = m.s / self.s, m.v / self.v, np.sign(m.v), np.ones(m.n_samples)
        carriers = np.column_stack([one, x, y, sign])
        groups = {
            "constant": one[:, None],
            "linear": np.column_stack([m.s, m.v] if m.a is None else [m.s, m.v, m.a]),
            "powers": np.column_stack([x**2, x**3, x**4, x**5]),
            "drift": self._hats(m, "s", 9),
            "rate": np.column_stack([sign, y * np.abs(y), y**2, y**3, y**4, y**5, self._hats(m, "v", 9)]),
            "surface": np.column_stack([_products(self._hats(m, "s", 4), self._hats(m, "v", 4)), sign * x]),
            "sliders": _sliders(m, self.s, _YIELD),
        }
        if self.timed:
            groups["time"] = _products(self._hats(m, "t", 7), carriers)
        for c in self.covariates:
            groups[f"covariate {c}"] = _products(self._hats(m, c, 5), carriers)
        return groups


# Groups of the rows of the table of shares, simplest first; covariates come before the time.
ROWS = {
    Dependence.CONSTANT.value: [],
    Dependence.LINEAR.value: [],
    Dependence.LINE.value: ["line"],
    Dependence.DRIFT.value: ["powers", "drift"],
    Dependence.RATE.value: ["rate"],
    Dependence.TIME.value: ["time"],
    Dependence.SURFACE.value: ["rate", "powers", "drift", "surface"],
    Dependence.PATH.value: ["rate", "powers", "drift", "surface", "sliders"],
}


# -- what a force depends on ------------------------------------------------------------------------


@dataclass
class Characterisation:
    """What a force depends on.

    Attributes
    ----------
    shares : DataFrame
        One row for each dependence, simplest first: ``share`` (percent of the force's squares explained on
        blocks left out), ``low``, ``high`` (about 95 %), ``gain`` (percentage points more than linear terms
        alone), ``chosen``. Every row but ``constant`` holds the linear terms s, v, a as well.
    dependence : Dependence
        The simplest row that explains nearly as much as the best; ``NOTHING`` if none explains much.
    memory : float
        Percentage points that sliders (memory of the path) add to any function of s and v.
    odd : float
        Share of the odd part under (s, v) -> (-s, -v), 0 to 1; NaN where the question has no sense.
    frequency : float
        Frequency of the highest spectral line, Hz; NaN if none stands out.
    features : list of Feature
        Marks of the shape: a jump at v = 0, a kink, hardening, softening.
    curves : dict of str to DataFrame
        Conditional means of the force (``centre``, ``mean``, ``error`` of the mean, ``count``) by variable.
    covariate : str
        Where the force depends on one: its name.
    rms : float
        Of the force, N.
    noise : float or None
        Rms of the noise in it, N.
    """

    shares: pd.DataFrame
    dependence: Dependence
    memory: float
    odd: float
    frequency: float
    features: list[Feature]
    curves: dict[str, pd.DataFrame] = field(default_factory=dict)
    covariate: str = ""
    rms: float = float("nan")
    noise: float | None = None

    @property
    def sentence(self) -> str:
        """The same in words."""
        return words.characterised(self)


def characterise(
    force: Sequence[np.ndarray],
    motions: Sequence[Motion],
    *,
    filters: Sequence[Any] | None = None,
    beside: Sequence[np.ndarray] | None = None,
    noise: float | None = None,
) -> Characterisation:
    """Tell what a missing force depends on: one force and motion for each record.

    ``beside`` are columns of which the force may hold any multiple.
    """
    if len(force) != len(motions) or any(len(f) != m.n_samples for f, m in zip(force, motions)):
        raise ChannelError(
            "Force and motion differ in length", "Give one force and one motion for each record, on one clock."
        )
    if not all(np.isfinite(f).all() for f in force):
        raise ChannelError(
            "The force to characterise is not finite",
            "A balance above with an unknown force leaves no storey residual.",
        )
    if sum(map(len, force)) < 200:
        raise ChannelError("The force has fewer than 200 samples", "Give a longer record.")
    filters = [None] * len(force) if filters is None else filters
    work = _Work(force, motions, filters, beside)
    rows = {
        name: work.judge.share(["constant"] if name == Dependence.CONSTANT.value else [*work.base, *groups])
        for name, groups in work.rows.items()
    }
    table = pd.DataFrame.from_dict(rows, orient="index", columns=["share", "error"]) * 100
    table["low"], table["high"] = table["share"] - 2 * table["error"], table["share"] + 2 * table["error"]
    table["gain"] = table["share"] - max(table.loc["linear", "share"], 0.0)
    best = table["share"].max()
    near = table.index[table["share"] >= best - 100 * NEARLY * min(1.0, best / 100 + 0.25)]
    row = str(near[0]) if best >= 100 * LEAST else ""
    table["chosen"] = table.index == row
    covariate = row.removeprefix("covariate ") if row.startswith("covariate ") else ""
    dependence = Dependence.COVARIATE if covariate else Dependence(row) if row else Dependence.NOTHING
    memory = float(table.loc["path", "share"] - table.loc["s and v", "share"])
    shares = table[["share", "low", "high", "gain", "chosen"]]
    odd, features = work.odd(row), work.features(dependence)
    return Characterisation(
        shares, dependence, memory, odd, work.frequency, features, work.curves(), covariate, work.rms, noise
    )


class _Work:
    """The force, the columns and the regression of one characterisation."""

    def __init__(
        self,
        force: Sequence[np.ndarray],
        motions: Sequence[Motion],
        filters: Sequence[Any],
        beside: Sequence[np.ndarray] | None,
    ) -> None:
        self.force, self.motions, self.filters = force, motions, filters
        self.rms = float(np.sqrt(np.mean(np.concatenate(force) ** 2)))
        self.every = every = thinning([m.s for m in motions])
        self.basis = Basis(motions)
        self.whole = whole = [self.basis.of(m) for m in motions]
        names = list(whole[0])
        widths = np.cumsum([0, *(part.shape[1] for part in whole[0].values())])
        columns = [filtered(np.hstack(list(one.values())), f) for one, f in zip(whole, filters)]
        groups = {name: [c[::every, a:b] for c in columns] for name, a, b in zip(names, widths, widths[1:])}
        self.base = ["constant", "linear"]
        if beside is not None:
            groups["beside"] = [part[::every] for part in beside]
            self.base.append("beside")
        self.frequency = np.nan
        if self.basis.timed:
            more = [x[:, :0] for x in columns] if beside is None else beside
            base = [np.hstack([c[:, : widths[2]], x]) for c, x in zip(columns, more)]
            self.frequency = spectral_line(_without(force, base), motions)
            if np.isfinite(self.frequency):
                groups["line"] = [x[::every] for x in self._line()]
        self.groups, self.judge = groups, Judge([f[::every] for f in force], groups)
        covariates = {name: [name] for name in names if name.startswith("covariate ")}
        at = list(ROWS).index(Dependence.TIME.value)
        rows = dict([*list(ROWS.items())[:at], *covariates.items(), *list(ROWS.items())[at:]])
        self.rows = {row: used for row, used in rows.items() if all(name in groups for name in used)}

    def _line(self) -> list[np.ndarray]:
        """Cosine and sine of the line, with a phase of their own in every record."""
        out = []
        for i, (m, f) in enumerate(zip(self.motions, self.filters)):
            columns = np.zeros((m.n_samples, 2 * len(self.motions)))
            angle = 2 * np.pi * self.frequency * np.asarray(m.t)
            columns[:, 2 * i : 2 * i + 2] = filtered(np.column_stack([np.cos(angle), np.sin(angle)]), f)
            out.append(columns)
        return out

    def odd(self, row: str) -> float:
        """Odd share of the fitted function of one row of the table, along the motion and its mirror image."""
        names = self.rows.get(row, [])
        if not names or "line" in names:
            return float("nan")
        found = self.judge.coefficients([*self.base, *names])
        odd = even = 0.0
        for m, one, f in zip(self.motions, self.whole, self.filters):
            mirror = self.basis.of(Motion(-m.s, -m.v, None if m.a is None else -m.a, m.t, m.covariates))
            # as the filter shows them: it may hide a constant, whose coefficient is then anything
            plus, minus = (filtered(sum(x[k] @ found[k] for k in ["linear", *names]), f) for x in (one, mirror))
            odd, even = odd + len(plus) * float(np.var(plus - minus)), even + len(plus) * float(np.var(plus + minus))
        return odd / (odd + even) if odd + even > 0 else float("nan")

    def features(self, dependence: Dependence) -> list[Feature]:
        """Marks of the shape of a function of the rate or of the drift."""
        if dependence == Dependence.RATE:
            jump = abs(float(self.judge.coefficients([*self.base, "rate"])["rate"][0]))
            return [Feature.JUMP] * (jump > 0.3 * self.rms)
        if dependence != Dependence.DRIFT:
            return []
        # straight lines with a gap that explain more than a smooth curve does are a kink
        gaps: dict[str, list[np.ndarray]] = {f"gap {g:.1f}": [] for g in _GAPS}
        for m, f in zip(self.motions, self.filters):
            x = np.column_stack([m.s, -m.s]) / self.basis.s
            both = filtered(np.hstack([np.maximum(x - g, 0.0) for g in _GAPS]), f)[:: self.every]
            for parts, columns in zip(gaps.values(), np.split(both, len(gaps), axis=1)):
                parts.append(columns)
        groups = {k: self.groups[k] for k in [*self.base, "powers"]} | gaps
        judge = Judge([f[:: self.every] for f in self.force], groups)
        smooth, best = judge.share(["powers"], self.base)[0], max(judge.share([g], self.base)[0] for g in gaps)
        if best > smooth + 0.1 * max(1 - smooth, 0.0):
            return [Feature.KINK]
        x = np.concatenate([m.s for m in self.motions]) / self.basis.s
        c = self.judge.coefficients([*self.base, "powers"])
        even, odd = (c["powers"][k] * x ** (k + 2) + c["powers"][k + 2] * x ** (k + 4) for k in (0, 1))
        if (odd**2).mean() < 0.2 * (even**2).mean():
            return []
        # an odd function less its regression on x bends outwards where it goes with x^3
        slope = x @ odd / (x @ x)
        bend = (odd - slope * x) @ (x**3 - (x @ x**3) / (x @ x) * x)
        return [Feature.HARDENING if bend > 0 else Feature.SOFTENING]

    def curves(self) -> dict[str, pd.DataFrame]:
        """Conditional means of the force, in bins of equal count."""
        force = np.concatenate(self.force)
        names = ["s", "v", *["t"] * self.basis.timed, *self.basis.covariates]
        lines = {name: np.concatenate([self.basis._line(m, name) for m in self.motions]) for name in names}
        return {name: conditional_mean(x, force) for name, x in lines.items()}


def _without(force: Sequence[np.ndarray], columns: Sequence[np.ndarray]) -> list[np.ndarray]:
    """What is left of a force by columns fitted to all of it."""
    A, whole = np.vstack(columns), np.concatenate(force)
    size = np.sqrt((A**2).mean(axis=0))
    A = A / np.where(size > 0, size, 1.0)
    left = whole - A @ np.linalg.lstsq(A.T @ A, A.T @ whole, rcond=1e-10)[0]
    return np.split(left, np.cumsum([len(f) for f in force])[:-1])


def conditional_mean(x: np.ndarray, force: np.ndarray, bins: int = 30) -> pd.DataFrame:
    """Mean of a force in bins of equal count of another signal."""
    order = np.argsort(x, kind="stable")
    edges = np.linspace(0, len(x), min(bins, len(x)) + 1).astype(int)
    count = np.diff(edges)
    centre, mean, square = (np.add.reduceat(y[order], edges[:-1]) / count for y in (x, force, force**2))
    error = np.sqrt(np.maximum(square - mean**2, 0.0) / count)
    return pd.DataFrame({"centre": centre, "mean": mean, "error": error, "count": count})


def spectral_line(parts: Sequence[np.ndarray], motions: Sequence[Motion]) -> float:
    """Frequency of the highest line of a residual that stands out of its surroundings, Hz; NaN if none does."""
    longest = int(np.argmax([len(p) for p in parts]))
    e, t = parts[longest], motions[longest].t
    n = len(e)
    if t is None or n < 64:
        return float("nan")
    dt = (t[-1] - t[0]) / (n - 1)
    window = np.hanning(n)
    power = np.abs(np.fft.rfft(e * window)) ** 2
    if not power.any():
        return float("nan")
    from scipy.ndimage import median_filter
    from scipy.signal import zoom_fft

    size = min(101, len(power) // 2 * 2 - 1)
    around = median_filter(power, size=size, mode="mirror") / np.log(2)
    ratio = power / np.maximum(around, 1e-12 * power.max())
    ratio[:3] = ratio[-3:] = 0.0
    peak = int(ratio.argmax())
    # an exponential over a scale that is itself estimated: F with 2 and 2 k degrees of freedom
    k = size * np.log(2) ** 2 / _HANN_OVERLAP
    if len(power) * (1.0 + ratio[peak] / k) ** -k > _LINE_LEVEL:
        return float("nan")
    low, high = (peak - 1) / (n * dt), (peak + 1) / (n * dt)
    fine = np.abs(zoom_fft(e * window, [low, high], 81, fs=1 / dt, endpoint=True))
    return float(np.linspace(low, high, 81)[fine.argmax()])


# -- coupling: is a storey's residual a function of its own motion? If not, no law of a chain explains it -


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


def couplings(residual: Residual, floor: NoiseFloor | None = None) -> list[Coupling]:
    r"""Storeys whose residual is no function of their own motion, the loudest first."""
    found = []
    for i in range(1, residual.n_dof + 1):
        name = f"storey {i}"
        force, size = residual.at(name), residual.sizes.loc[name]
        use = [k for k, e in enumerate(force) if np.isfinite(e).all() and e.any()]
        if not use or size["rms"] <= ROUND_OFF * size["reference"]:
            continue
        if floor is not None and not size["rms"] > _LOUD * floor.at(name):
            continue
        segments, filters = [residual.data.segments[k] for k in use], [residual.filters[k] for k in use]
        motions = [seg.motion(Site(i), seg.valid) for seg in segments]
        every = thinning([m.s for m in motions])
        moves = [np.hstack([seg.s[seg.valid], seg.v[seg.valid]]).astype(float) for seg in segments]
        moves = [filtered(x, f)[::every] for x, f in zip(moves, filters)]
        mine = [i - 1, residual.n_dof + i - 1]
        groups = {
            "linear": [x[:, mine] for x in moves],
            "law": own_columns(motions, filters, every),
            "others": [np.delete(x, mine, axis=1) for x in moves],
        }
        judge = Judge([force[k][::every] for k in use], groups, 60, 10)
        # columns that explain nothing on data left out only add to what is left
        tried = {names: judge.share(names)[0] for names in (("linear",), ("linear", "law"))}
        own = max(tried, key=lambda names: tried[names])
        beside = own if tried[own] > 0 else ()
        others, error = judge.share(["others"], beside) if residual.n_dof > 1 else (0.0, 0.0)
        one = Coupling(i, float(size["percent"]), tried[own], others, error)
        if one.own < _OWN or (one.coupled and one.own < _ALL):
            found.append(one)
    return sorted(found, key=lambda c: -c.percent)
