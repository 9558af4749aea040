"""Regressions without a formula: columns of hat functions and sliders, judged on blocks left out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
from sklearn.preprocessing import SplineTransformer

from ..common.jackknife import variance
from ..exceptions import ChannelError
from ..laws import Jenkins
from ..laws.shape import Motion
from ..mechanics.sites import Site
from . import words
from .residual import ROUND_OFF, NoiseFloor, Residual, period_of
from .words import Dependence, Feature

# Yield drifts of the sliders, in multiples of the rms drift: small ones are friction, large ones springs.
_YIELD = (0.02, 0.06, 0.15, 0.3, 0.6, 1.0, 1.6, 2.5)
# Gaps that are tried, in multiples of the rms drift.
GAPS = tuple(np.linspace(0.0, 2.6, 14))
_RIDGE = (1e-9, 1e-5, 1e-3, 3e-2)


def hats(x: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """Piecewise linear functions that are 1 at one knot and 0 at the others, constant beyond the ends."""
    at = knots[:, None]
    return SplineTransformer(degree=1, knots=at, extrapolation="constant").fit(at).transform(x[:, None])


def knots_of(x: np.ndarray, count: int) -> np.ndarray:
    """Knots at quantiles and at even distances, so that rare large values have some too; 0 is one."""
    even = np.linspace(x.min(), x.max(), count)
    knots = np.unique(np.concatenate([even, np.quantile(x, np.linspace(0, 1, count)), [0.0]]))
    least = 0.02 * np.ptp(x)
    if least == 0:
        return np.array([x[0] - 1.0, x[0] + 1.0])
    knots = knots[np.abs(knots) > least]
    knots = knots[np.concatenate([[True], np.diff(knots) > least])]
    return np.sort(np.append(knots, 0.0)) if x.min() <= 0 <= x.max() else knots


@dataclass
class Basis:
    """Columns of a motion, with knots and scales fixed by the motions they were made for."""

    motions: list[Motion]

    def __post_init__(self) -> None:
        self.s = self._scale([m.s for m in self.motions])
        self.v = self._scale([m.v for m in self.motions])
        self._knots: dict[str, np.ndarray] = {}

    @staticmethod
    def _scale(parts: Sequence[np.ndarray]) -> float:
        """Rms of all parts; 1 where nothing moves."""
        return float(np.sqrt(np.mean(np.concatenate(parts) ** 2))) or 1.0

    def knots(self, name: str, parts: Sequence[np.ndarray], count: int) -> np.ndarray:
        """Knots of one variable, found once."""
        key = f"{name} {count}"
        if key not in self._knots:
            self._knots[key] = knots_of(np.concatenate(list(parts)), count)
        return self._knots[key]

    def _of(self, name: str, x: np.ndarray, count: int) -> np.ndarray:
        """Hat functions of one variable at the knots of all motions."""
        if name in ("s", "v", "t"):
            chosen = [getattr(m, name) for m in self.motions]
        elif name == "amplitude":
            chosen = [envelope(m.s) for m in self.motions]
        else:
            chosen = [m.covariates[name] for m in self.motions]
        return hats(x, self.knots(name, chosen, count))

    def linear(self, m: Motion) -> np.ndarray:
        """s, v and, if known, a."""
        return np.column_stack([m.s, m.v] if m.a is None else [m.s, m.v, m.a])

    def drift(self, m: Motion) -> np.ndarray:
        """Any function of s."""
        return np.column_stack([self.smooth(m, "s"), self._of("s", m.s, 12)])

    def rate(self, m: Motion) -> np.ndarray:
        """Any function of v, with a jump at v = 0."""
        return np.column_stack(
            [np.sign(m.v), m.v * np.abs(m.v) / self.v**2, self.smooth(m, "v"), self._of("v", m.v, 12)]
        )

    def surface(self, m: Motion) -> np.ndarray:
        """Any function of s and v."""
        s, v = self._of("s", m.s, 5), self._of("v", m.v, 5)
        return np.column_stack([self.rate(m), self.drift(m), _products(s, v), np.sign(m.v) * m.s / self.s])

    def path(self, m: Motion) -> np.ndarray:
        """The same and sliders of several yield drifts (Prandtl-Ishlinskii)."""
        still = Motion(m.s, m.v, m.a)
        sliders = [Jenkins(uy=share * self.s, Fy=1.0).features(still) for share in _YIELD]
        return np.column_stack([self.surface(m), *sliders])

    def smooth(self, m: Motion, name: str) -> np.ndarray:
        """Powers of s or v."""
        x = m.s / self.s if name == "s" else m.v / self.v
        return np.column_stack([x**2, x**3, x**4, x**5])

    def hinges(self, m: Motion, gap: float) -> np.ndarray:
        """Two lines that start at a gap (multiples of the rms drift) on either side."""
        return np.column_stack([np.maximum(m.s - gap * self.s, 0.0), np.maximum(-m.s - gap * self.s, 0.0)])

    def time(self, m: Motion) -> np.ndarray:
        """Linear forces and friction with coefficients that change in time."""
        assert m.t is not None  # asked for only where the time is known
        return _products(self._of("t", m.t, 7), self._carriers(m))

    def amplitude(self, m: Motion) -> np.ndarray:
        """Linear forces whose coefficients depend on the amplitude."""
        return _products(self._of("amplitude", envelope(m.s), 5), np.column_stack([m.s / self.s, m.v / self.v]))

    def covariate(self, m: Motion, name: str) -> np.ndarray:
        """Linear forces and friction whose coefficients depend on a covariate."""
        return _products(self._of(name, np.asarray(m.covariates[name], dtype=float), 5), self._carriers(m))

    def _carriers(self, m: Motion) -> np.ndarray:
        """A constant, s, v and the sign of v."""
        return np.column_stack([np.ones(m.n_samples), m.s / self.s, m.v / self.v, np.sign(m.v)])


def _products(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Products of every column of a with every column of b."""
    return (a[:, :, None] * b[:, None, :]).reshape(len(a), -1)


def envelope(x: np.ndarray) -> np.ndarray:
    """Amplitude of a vibration (magnitude of its analytic signal)."""
    from scipy.signal import hilbert

    return np.abs(hilbert(x - x.mean()))


class Judge:
    """Least squares on some blocks, judged on the others; all on Gram matrices of blocks.

    Parameters
    ----------
    force : sequence of ndarray of shape (n_samples,)
        One for each record.
    groups : mapping of str to sequence of ndarray of shape (n_samples, p)
        Columns by name, one array for each record.
    n_blocks, n_folds : int
        Contiguous blocks, dealt in turn to the folds.
    """

    def __init__(
        self,
        force: Sequence[np.ndarray],
        groups: Mapping[str, Sequence[np.ndarray]],
        n_blocks: int = 25,
        n_folds: int = 5,
    ) -> None:
        widths = {name: parts[0].shape[1] for name, parts in groups.items()}
        ends = np.cumsum([0, *widths.values()])
        self.at = {name: np.arange(a, b) for name, a, b in zip(widths, ends, ends[1:])}
        rows = [np.column_stack([*(parts[i] for parts in groups.values()), f]) for i, f in enumerate(force)]
        total = sum(map(len, rows))
        grams = []
        for part in rows:
            count = max(1, int(round(n_blocks * len(part) / total)))
            grams += [piece.T @ piece for piece in np.array_split(part, count)]
        whole = sum(grams)
        self.size = np.sqrt(np.diag(whole))
        self.size[self.size == 0] = 1.0
        self.grams = np.array(grams) / np.outer(self.size, self.size)
        self._held_out: dict[tuple[str, ...], np.ndarray] = {}
        self.folds = np.arange(len(grams)) % min(n_folds, len(grams))

    def _fit(self, gram: np.ndarray, index: np.ndarray, ridge: float) -> np.ndarray:
        """Coefficients of some columns from one Gram matrix."""
        A, h = gram[np.ix_(index, index)], gram[index, -1]
        return np.linalg.solve(A + ridge * np.diag(np.maximum(np.diag(A), 1e-12)) + 1e-12 * np.eye(len(index)), h)

    def held_out(self, names: Sequence[str]) -> np.ndarray:
        """Squares left in every block by columns fitted to the blocks of the other folds, as shares of all."""
        key = tuple(names)
        if key not in self._held_out:
            self._held_out[key] = self._left(key) if key else self.grams[:, -1, -1]
        return self._held_out[key]

    def _left(self, names: Sequence[str]) -> np.ndarray:
        """Squares left in every block, with the ridge that leaves least."""
        index = np.append(np.concatenate([self.at[name] for name in names]), self.grams.shape[1] - 1)
        grams = self.grams[:, index[:, None], index]
        n_folds = int(self.folds.max()) + 1
        parts = np.array([grams[self.folds == k].sum(axis=0) for k in range(n_folds)])
        train = parts.sum(axis=0) - parts if n_folds > 1 else parts
        A, h = train[:, :-1, :-1], train[:, :-1, -1:]
        eye = np.eye(len(index) - 1)
        sizes = np.maximum(np.einsum("kii->ki", A), 1e-12)[:, None, :] * eye
        best: np.ndarray | None = None
        for ridge in _RIDGE:
            w = np.linalg.solve(A + ridge * sizes + 1e-12 * eye, h)[:, :, 0]
            full = np.column_stack([-w, np.ones(n_folds)])[self.folds]
            left = np.einsum("bi,bi->b", full, np.einsum("bij,bj->bi", grams, full))
            if best is None or left.sum() < best.sum():
                best = left
        assert best is not None
        return np.maximum(best, 0.0)

    def share(self, names: Sequence[str], beside: Sequence[str] = ()) -> tuple[float, float]:
        """Held-out share of the squares left by ``beside`` that further columns explain, and its standard error."""
        before, after = self.held_out(beside), self.held_out([*beside, *names])
        if before.sum() <= 0:
            return 0.0, 0.0
        return 1.0 - float(after.sum() / before.sum()), jackknife(before, after)

    def coefficients(self, names: Sequence[str], ridge: float = 1e-6) -> dict[str, np.ndarray]:
        """Coefficients on all data, by name, in the columns' own units."""
        index = np.concatenate([self.at[name] for name in names])
        w = self._fit(self.grams.sum(axis=0), index, ridge) * self.size[-1] / self.size[index]
        ends = np.cumsum([0, *(len(self.at[name]) for name in names)])
        return {name: w[a:b] for name, a, b in zip(names, ends, ends[1:])}


def jackknife(before: np.ndarray, after: np.ndarray) -> float:
    """Standard error of ``1 - sum(after) / sum(before)`` over blocks."""
    n = len(before)
    if n < 3:
        return float("nan")
    top, bottom = after.sum() - after, before.sum() - before
    ratio = np.divide(top, bottom, out=np.ones(n), where=bottom > 0)
    return float(np.sqrt(variance(ratio)))


def filtered(columns: np.ndarray, filter: Any) -> np.ndarray:
    """Columns through the filter of their record."""
    return columns if filter is None else filter.apply(columns)


# What explains nearly as much with less wins: at most this much worse, in shares of the residual's squares.
NEARLY = 0.04
# Below this share nothing that was tried explains the force.
LEAST = 0.15
_LINE_LEVEL = 0.01
# How many neighbouring lines of a Hann window count as one: 1 + 2 ((2/3)^2 + (1/6)^2).
_HANN_OVERLAP = 35 / 18
# Every k-th sample is enough for the regressions, as long as so many are left in all and in a period.
_ENOUGH = 8000
_PER_PERIOD = 8


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

    def __str__(self) -> str:
        return self.sentence


def characterise(
    force: Any,
    motion: Motion | Sequence[Motion],
    *,
    filters: Any = None,
    beside: Any = None,
    channels: Mapping[str, Any] | None = None,
    noise: float | None = None,
) -> Characterisation:
    """Tell what a missing force depends on, by regressions judged on blocks left out."""
    work = _Work.of(force, motion, filters, beside, channels)
    judge, names = work.judge, work.names
    rows = {}
    for name, columns in names.items():
        rows[name] = judge.share(["constant"] if name == "constant" else [*work.base, *columns])
    table = pd.DataFrame.from_dict(rows, orient="index", columns=["share", "error"]) * 100
    table["low"], table["high"] = table["share"] - 2 * table["error"], table["share"] + 2 * table["error"]
    table["gain"] = table["share"] - max(table.loc["linear", "share"], 0.0)
    best = table["share"].max()
    near = table.index[table["share"] >= best - 100 * NEARLY * min(1.0, best / 100 + 0.25)]
    row = str(near[0]) if best >= 100 * LEAST else ""
    table["chosen"] = table.index == row
    memory = float(table.loc["path", "share"] - table.loc["s and v", "share"])
    dependence = Dependence.COVARIATE if row in work.covariates else Dependence(row) if row else Dependence.NOTHING
    odd, features = work.shape_of(row)
    shares = table[["share", "low", "high", "gain", "chosen"]]
    covariate = work.covariates.get(row, "")
    return Characterisation(
        shares, dependence, memory, odd, work.frequency, features, work.curves(), covariate, work.rms, noise
    )


class _Work:
    """The force, the columns and the regressions of one characterisation."""

    def __init__(
        self,
        force: list[np.ndarray],
        motions: list[Motion],
        filters: list[Any],
        beside: list[np.ndarray],
        channels: Any,
    ) -> None:
        self.force, self.motions, self.filters = force, motions, filters
        self.rms = float(np.sqrt(np.mean(np.concatenate(force) ** 2)))
        self.basis = Basis(motions)
        basis = self.basis
        self.makers: dict[str, Any] = {"constant": lambda m: np.ones((m.n_samples, 1)), "linear": basis.linear}
        self.makers |= {"s": basis.drift, "v": basis.rate, "surface": basis.surface, "path": basis.path}
        self.makers |= {"amplitude": basis.amplitude, "smooth s": lambda m: basis.smooth(m, "s")}
        self.makers |= {f"gap {g:.1f}": lambda m, g=g: self.basis.hinges(m, g) for g in GAPS}
        timed = all(m.t is not None for m in motions)
        if timed:
            self.makers["time"] = self.basis.time
        shared = set.intersection(*(set(m.covariates) for m in motions))
        moving = [c for c in motions[0].covariates if c in shared and self._moves(c)]
        self.covariates = {f"covariate {c}": c for c in moving}
        for name, c in self.covariates.items():
            self.makers[name] = lambda m, c=c: self.basis.covariate(m, c)
        groups = {k: [filtered(make(m), f) for m, f in zip(motions, filters)] for k, make in self.makers.items()}
        if beside:
            groups["beside"] = beside
        self.base = ["constant", "linear", *(["beside"] if beside else [])]
        late = self._late(channels) if timed else []
        if late:
            groups["delay"] = [np.column_stack(parts) for parts in late]
        self.frequency = np.nan
        if timed:
            left = self._left(groups)
            self.frequency = spectral_line(left, motions)
            if np.isfinite(self.frequency):
                groups["line"] = self._line(groups["constant"])
        every = int(max(1, min(sum(map(len, force)) // _ENOUGH, period_of([m.s for m in motions]) // _PER_PERIOD)))
        thinned = {name: [part[::every] for part in parts] for name, parts in groups.items()}
        self.judge = Judge([f[::every] for f in force], thinned)
        names = {"constant": [], "linear": [], "line": ["line"], "delay": ["delay"], "s alone": ["s"], "v alone": ["v"]}
        names |= {name: [name] for name in self.covariates}
        names |= {"time": ["time"], "amplitude": ["amplitude"], "s and v": ["surface"], "path": ["path"]}
        self.names = {k: v for k, v in names.items() if all(g in groups for g in v)}

    @classmethod
    def of(cls, force: Any, motion: Any, filters: Any, beside: Any, channels: Any) -> _Work:
        motions = [motion] if isinstance(motion, Motion) else list(motion)
        forces = [
            np.asarray(f, dtype=float)
            for f in ([force] if isinstance(force, np.ndarray) and force.ndim == 1 else force)
        ]
        if len(forces) != len(motions) or any(len(f) != m.n_samples for f, m in zip(forces, motions)):
            raise ChannelError(
                "Force and motion differ in length", "Give one force and one motion for each record, on one clock."
            )
        keep = [i for i, f in enumerate(forces) if not np.isnan(f).all()]
        if not keep or any(not np.isfinite(forces[i]).all() for i in keep):
            raise ChannelError(
                "The force to characterise is not finite",
                "A balance above with an unknown force leaves no storey residual.",
            )
        if sum(len(forces[i]) for i in keep) < 200:
            raise ChannelError("The force has fewer than 200 samples", "Give a longer record.")

        def of_each(values: Any) -> list[Any]:
            values = list(values) if isinstance(values, (list, tuple)) else [values] * len(motions)
            return [values[i] for i in keep]

        late = {k: of_each(c if isinstance(c, (list, tuple)) else [c]) for k, c in dict(channels or {}).items()}
        columns = [] if beside is None else of_each([beside] if isinstance(beside, np.ndarray) else beside)
        return cls([forces[i] for i in keep], [motions[i] for i in keep], of_each(filters), columns, late)

    def _moves(self, name: str) -> bool:
        return any(np.ptp(m.covariates[name]) > 0 for m in self.motions)

    def _late(self, channels: Mapping[str, Any]) -> list[list[np.ndarray]]:
        """Derivatives of the channels that may be late, for each record."""
        out = []
        for i, (m, f) in enumerate(zip(self.motions, self.filters)):
            lines = ([] if m.a is None else [m.a]) + [parts[i] for parts in channels.values()]
            assert m.t is not None
            out.append([filtered(np.gradient(np.asarray(x, dtype=float), m.t), f) for x in lines])
        return out if out[0] else []

    def _left(self, groups: Mapping[str, list[np.ndarray]]) -> list[np.ndarray]:
        """The force less its linear part."""
        columns = np.vstack([np.column_stack([groups[k][i] for k in self.base]) for i in range(len(self.force))])
        size = np.sqrt((columns**2).mean(axis=0))
        columns = columns / np.where(size > 0, size, 1.0)
        whole = np.concatenate(self.force)
        left = whole - columns @ np.linalg.lstsq(columns, whole, rcond=1e-10)[0]
        return np.split(left, np.cumsum([len(f) for f in self.force])[:-1])

    def _line(self, like: list[np.ndarray]) -> list[np.ndarray]:
        """Cosine and sine of the line, with a phase of their own in every record."""
        out = []
        for i, (m, f) in enumerate(zip(self.motions, self.filters)):
            assert m.t is not None
            columns = np.zeros((len(like[i]), 2 * len(self.motions)))
            angle = 2 * np.pi * self.frequency * m.t
            columns[:, 2 * i : 2 * i + 2] = filtered(np.column_stack([np.cos(angle), np.sin(angle)]), f)
            out.append(columns)
        return out

    # -- shape ----------------------------------------------------------------------------------

    def _value(self, names: Sequence[str], coefficients: Mapping[str, np.ndarray], sign: float) -> np.ndarray:
        """The fitted function along the motion, or along its mirror image."""
        out = []
        for m in self.motions:
            mirror = m if sign > 0 else Motion(-m.s, -m.v, None if m.a is None else -m.a, m.t, m.covariates)
            out.append(sum(self.makers[k](mirror) @ coefficients[k] for k in names))
        return np.concatenate(out)

    def shape_of(self, row: str) -> tuple[float, list[Feature]]:
        """Odd share and marks of the fitted function of one row of the table."""
        group = {"s alone": "s", "v alone": "v", "s and v": "surface"}.get(row, row)
        if group not in self.makers or group == "constant":
            return float("nan"), []
        every = self.judge.coefficients(list(dict.fromkeys([*self.base, group])))
        names = [k for k in every if k != "beside"]
        plus, minus = (self._value(names, every, sign) for sign in (1.0, -1.0))
        odd, even = float(((plus - minus) ** 2).sum()), float(((plus + minus) ** 2).sum())
        share = odd / (odd + even) if odd + even > 0 else float("nan")
        return share, self._marks(group, every)

    def _marks(self, group: str, coefficients: Mapping[str, np.ndarray]) -> list[Feature]:
        """Marks of the fitted function."""
        marks: list[Feature | None] = []
        if group in ("v", "surface", "path"):
            # the first column of all three is sgn(v)
            jump = abs(float(coefficients[group][0]))
            if group == "v" and jump > 0.3 * self.rms:
                marks.append(Feature.JUMP)
        if group == "s":
            if self._has_kink():
                marks.append(Feature.KINK)
            else:
                cubic = self.judge.coefficients([*self.base, "smooth s"])["smooth s"]
                marks.append(self._bend(cubic))
        return [mark for mark in marks if mark]

    def _has_kink(self) -> bool:
        """Whether straight lines with a gap explain the force better than a smooth curve does."""
        smooth, _ = self.judge.share(["smooth s"], self.base)
        gaps = [self.judge.share([f"gap {g:.1f}"], self.base)[0] for g in GAPS]
        return max(gaps) > smooth + 0.1 * max(1 - smooth, 0.0)

    def _bend(self, c: np.ndarray) -> Feature | None:
        """Whether the slope of a function of s grows outwards."""
        x = np.concatenate([m.s for m in self.motions]) / self.basis.s
        odd, even = c[1] * x**3 + c[3] * x**5, c[0] * x**2 + c[2] * x**4
        if (odd**2).mean() < 0.2 * (even**2).mean():
            return None
        # an odd function less its regression on x bends outwards where it goes with x^3
        slope = x @ odd / (x @ x)
        bend = (odd - slope * x) @ (x**3 - (x @ x**3) / (x @ x) * x)
        return Feature.HARDENING if bend > 0 else Feature.SOFTENING

    def curves(self) -> dict[str, pd.DataFrame]:
        """Conditional means of the force, in bins of equal count."""
        force = np.concatenate(self.force)
        lines = {
            "s": np.concatenate([m.s for m in self.motions]), "v": np.concatenate([m.v for m in self.motions]),
            "amplitude": np.concatenate([envelope(m.s) for m in self.motions]),
        }  # fmt: skip
        if all(m.t is not None for m in self.motions):
            lines["t"] = np.concatenate([m.t for m in self.motions])
        for name, c in self.covariates.items():
            lines[name] = np.concatenate([m.covariates[c] for m in self.motions])
        return {name: conditional_mean(x, force) for name, x in lines.items()}


def conditional_mean(x: np.ndarray, force: np.ndarray, bins: int = 30) -> pd.DataFrame:
    """Mean of a force in bins of equal count of another signal."""
    order = np.argsort(x, kind="stable")
    edges = np.linspace(0, len(x), min(bins, len(x)) + 1).astype(int)
    count = np.diff(edges)
    first = edges[:-1]
    sums = [np.add.reduceat(y[order], first) for y in (x, force, force**2)]
    centre, mean, square = (total / count for total in sums)
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

    size = min(101, len(power) // 2 * 2 - 1)
    around = median_filter(power, size=size, mode="mirror") / np.log(2)
    ratio = power / np.maximum(around, 1e-12 * power.max())
    ratio[:3] = ratio[-3:] = 0.0
    peak = int(ratio.argmax())
    # an exponential over a scale that is itself estimated: F with 2 and 2 k degrees of freedom
    k = size * np.log(2) ** 2 / _HANN_OVERLAP
    if len(power) * (1.0 + ratio[peak] / k) ** -k > _LINE_LEVEL:
        return float("nan")
    fine = np.fft.rfftfreq(n, dt)[peak] + np.linspace(-1, 1, 81) / (n * dt)
    waves = np.exp(-2j * np.pi * np.outer(fine, np.arange(n) * dt))
    return float(fine[np.abs(waves @ (e * window)).argmax()])


# A storey is looked at where its residual is so many times the noise floor.
_LOUD = 2.0
# Share of it that laws of the storey's own motion may explain, without and with a sign of coupling; and that the
# others' motion must explain then, by so many standard errors.
_OWN, _ALL, _OTHERS, _SURELY = 0.5, 0.95, 0.05, 2.0
_BLOCKS, _FOLDS = 60, 10
# Yield drifts of the sliders that stand for the path, in multiples of the rms drift.
_YIELDS = (0.15, 0.6, 1.6, 4.0)


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
            "law": [filtered(_own_columns(m, scale), f) for m, f in zip(motions, filters)],
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


def _own_columns(m: Motion, scale: float) -> np.ndarray:
    """Columns for laws of a storey's own motion: friction, damping, springs, yielding."""
    still = Motion(m.s, m.v, m.a)
    sliders = [Jenkins(uy=share * scale, Fy=1.0).features(still) for share in _YIELDS]
    return np.column_stack([np.sign(m.v), m.v * np.abs(m.v), m.s**2, m.s**3, *sliders])
