"""Regressions without a formula: columns of hat functions and sliders, judged on blocks left out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from sklearn.preprocessing import SplineTransformer

from ..common.jackknife import variance
from ..laws import Jenkins
from ..laws.shape import Motion

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


def period_of(parts: Sequence[np.ndarray]) -> float:
    """Samples of a period at the rms frequency of a signal; 16 if it does not move."""
    pace = sum(float(np.sum(np.diff(p) ** 2)) for p in parts)
    size = sum(float(np.sum((p - p.mean()) ** 2)) for p in parts)
    return 2 * np.pi / max(np.sqrt(pace / size), 1e-6) if size > 0 else 16.0


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
