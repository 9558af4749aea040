"""What kind of force is missing: what it depends on, told without a formula, by one
regression.

Groups of columns (any function of the drift, of the rate, sliders that follow the path,
...) are fitted to some blocks of the force and judged on the others: the share of its
variance that they explain there. Detection and localisation ask the same regression.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy.linalg import block_diag

from ..equations.normal_equations import Regression
from ..exceptions import ChannelError
from ..laws import Jenkins
from ..laws.shape import Motion
from ..records.fusion.noise_levels import RARE
from . import words
from .constants import EXPLAINED, NEARLY, TENTH
from .windows import period_of
from .words import Dependence, Feature

# How many neighbouring lines of a Hann window count as one: 1 + 2 ((2/3)^2 + (1/6)^2).
_HANN_OVERLAP = 35 / 18
# Every k-th sample is enough for the regressions, as long as so many are left in all
# and in a period.
_ENOUGH, _PER_PERIOD = 8000, 8
# Yield drifts of the sliders, in multiples of the rms drift: small ones are friction,
# large ones springs.
_YIELD, _FEW = (0.02, 0.06, 0.15, 0.3, 0.6, 1.0, 1.6, 2.5), (0.06, 0.15, 0.6, 1.6, 4.0)
# Gaps that are tried, in multiples of the rms drift.
_GAPS = np.arange(9) * 0.3


def knots_of(x: np.ndarray, count: int) -> np.ndarray:
    """Knots at quantiles and at even distances, so that rare large values have some
    too; 0 is one.
    """
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
    return np.column_stack(
        [Jenkins(uy=share * scale, Fy=1.0).features(still) for share in shares]
    )


def own_columns(
    motions: Sequence[Motion], filters: Sequence[Any], every: int = 1
) -> list[np.ndarray]:
    """Columns for laws of a site's own motion in few: friction, damping, springs,
    yielding.
    """
    size = _scale([m.s for m in motions])
    out = []
    for m, f in zip(motions, filters):
        few = [
            np.sign(m.v),
            m.v * np.abs(m.v),
            m.s**2,
            m.s**3,
            np.maximum(np.abs(m.s) - size, 0.0) * np.sign(m.s),
        ]
        out.append(
            filtered(np.column_stack([*few, _sliders(m, size, _FEW)]), f)[::every]
        )
    return out


def filtered(columns: np.ndarray, filter: Any) -> np.ndarray:
    """Columns through the filter of their record."""
    return columns if filter is None else filter.apply(columns)


def thinning(parts: Sequence[np.ndarray]) -> int:
    """Every how many samples of a drift are enough for a regression."""
    return int(
        max(1, min(sum(map(len, parts)) // _ENOUGH, period_of(parts) // _PER_PERIOD))
    )


class Basis:
    """Groups of columns of a motion, with knots and scales fixed by the motions they
    were made for.
    """

    def __init__(self, motions: Sequence[Motion]) -> None:
        self.s, self.v = (_scale([getattr(m, name) for m in motions]) for name in "sv")
        shared = [
            c for c in motions[0].covariates if all(c in m.covariates for m in motions)
        ]
        self.changing = (
            {"time": ("t", 7)} if all(m.t is not None for m in motions) else {}
        )
        self.changing |= {
            f"covariate {c}": (c, 5)
            for c in shared
            if any(np.ptp(m.covariates[c]) > 0 for m in motions)
        }
        counts = [("s", 9), ("s", 4), ("v", 9), ("v", 4), *self.changing.values()]
        self._knots = {
            (name, count): knots_of(
                np.concatenate([self._line(m, name) for m in motions]), count
            )
            for name, count in counts
        }

    @staticmethod
    def _line(m: Motion, name: str) -> np.ndarray:
        return np.asarray(
            getattr(m, name) if name in ("s", "v", "t") else m.covariates[name],
            dtype=float,
        )

    def _hats(self, m: Motion, name: str, count: int) -> np.ndarray:
        """Piecewise linear functions that are 1 at one knot and 0 at the others,
        constant beyond the ends.
        """
        x, knots = self._line(m, name), self._knots[name, count]
        return np.column_stack([np.interp(x, knots, one) for one in np.eye(len(knots))])

    def of(self, m: Motion) -> dict[str, np.ndarray]:
        """All groups by name; together with those named in ``ROWS`` they make a row of
        the table of shares.
        """
        x, y, sign, one = m.s / self.s, m.v / self.v, np.sign(m.v), np.ones(m.n_samples)
        carriers = np.column_stack([one, x, y, sign])
        gaps = [np.maximum(np.column_stack([x, -x]) - gap, 0.0) for gap in _GAPS]
        groups = {
            "constant": one[:, None],
            "linear": np.column_stack([m.s, m.v] if m.a is None else [m.s, m.v, m.a]),
            "powers": np.column_stack([x**2, x**3, x**4, x**5]),
            "drift": self._hats(m, "s", 9),
            **{f"gap {k}": gap for k, gap in enumerate(gaps)},
            "jump": sign[:, None],
            "rate powers": np.column_stack([y * np.abs(y), y**2, y**3, y**4, y**5]),
            "rate": self._hats(m, "v", 9),
            "surface": np.column_stack(
                [_products(self._hats(m, "s", 4), self._hats(m, "v", 4)), sign * x]
            ),
            "sliders": _sliders(m, self.s, _YIELD),
        }
        return groups | {
            name: _products(self._hats(m, *axis), carriers)
            for name, axis in self.changing.items()
        }


_DRIFT, _RATE = ["powers", "drift"], ["jump", "rate powers", "rate"]
# Groups of the rows of the table of shares beside constant and linear terms, simplest
# first.
ROWS = {
    Dependence.CONSTANT.value: [],
    Dependence.LINEAR.value: [],
    Dependence.LINE.value: ["line"],
    Dependence.DRIFT.value: _DRIFT,
    Dependence.RATE.value: _RATE,
    Dependence.COVARIATE.value: [],
    Dependence.TIME.value: ["time"],
    Dependence.SURFACE.value: [*_RATE, *_DRIFT, "surface"],
    Dependence.PATH.value: [*_RATE, *_DRIFT, "surface", "sliders"],
}


@dataclass
class Characterisation:
    """What a force depends on."""

    # One row for each dependence, simplest first: "share" (percent of the force's
    # squares explained on blocks left out), "low", "high" (about 95 %), "gain" (points
    # more than linear terms alone), "chosen".
    shares: pd.DataFrame
    dependence: Dependence  # the simplest row that explains nearly as much as the best
    # percentage points that sliders (memory of the path) add to any function of s and v
    memory: float
    # share of the odd part under (s, v) -> (-s, -v), 0 to 1; NaN where the question has
    # no sense
    odd: float
    frequency: float  # of the highest spectral line, Hz; NaN if none stands out
    features: list[Feature]  # marks of the shape
    curves: dict[str, pd.DataFrame]  # means of the force in bins of "s" and "v"
    covariate: str = ""  # on which the force depends
    rms: float = float("nan")  # of the force, N
    noise: float | None = None  # rms of the noise in it, N

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
    if not all(np.isfinite(f).all() for f in force):
        cure = "A balance above with an unknown force leaves no storey residual."
        raise ChannelError("The force to characterise is not finite", cure)
    if sum(map(len, force)) < 200:
        raise ChannelError(
            "The force has fewer than 200 samples", "Give a longer record."
        )
    work = _Work(
        force, motions, [None] * len(force) if filters is None else filters, beside
    )
    rows = {
        name: work.regression.share("force", names) for name, names in work.rows.items()
    }
    table = (
        pd.DataFrame.from_dict(rows, orient="index", columns=["share", "error"]) * 100
    )
    table["low"], table["high"] = (
        table["share"] - 2 * table["error"],
        table["share"] + 2 * table["error"],
    )
    table["gain"] = table["share"] - max(table.loc["linear", "share"], 0.0)
    best = table["share"].max()
    near = table.index[table["share"] >= best - 100 * NEARLY]
    row = str(near[0]) if best >= 100 * TENTH else Dependence.NOTHING.value
    table["chosen"] = table.index == row
    covariate = row.partition("covariate ")[2]
    dependence = Dependence.COVARIATE if covariate else Dependence(row)
    odd, whole = work.odd(row), np.concatenate(force)
    curves = {
        k: conditional_mean(np.concatenate([getattr(m, k) for m in motions]), whole)
        for k in "sv"
    }
    return Characterisation(
        table[["share", "low", "high", "gain", "chosen"]],
        dependence,
        memory=float(table.loc["path", "share"] - table.loc["s and v", "share"]),
        odd=odd,
        frequency=work.frequency,
        features=work.features(dependence, odd),
        curves=curves,
        covariate=covariate,
        rms=float(np.sqrt(np.mean(whole**2))),
        noise=noise,
    )


class _Work:
    """The columns and the regression of one characterisation."""

    def __init__(
        self,
        force: Sequence[np.ndarray],
        motions: Sequence[Motion],
        filters: Sequence[Any],
        beside: Sequence[np.ndarray] | None,
    ) -> None:
        self.motions, self.filters = motions, filters
        self.basis = Basis(motions)
        self.whole = [self.basis.of(m) for m in motions]
        widths = np.cumsum([0, *(part.shape[1] for part in self.whole[0].values())])
        columns = [
            filtered(np.hstack(list(one.values())), f)
            for one, f in zip(self.whole, filters)
        ]
        groups = {
            name: [c[:, a:b] for c in columns]
            for name, a, b in zip(self.whole[0], widths, widths[1:])
        }
        self.base = ["constant", "linear"]
        if beside is not None:
            groups["beside"] = list(beside)
            self.base.append("beside")
        self.frequency = float("nan")
        if "time" in groups:
            fit = Regression.of(
                {name: groups[name] for name in self.base} | {"force": force}
            )
            found = fit.coefficients("force", self.base)
            rest = [
                f - sum(groups[k][i] @ found[k] for k in self.base)
                for i, f in enumerate(force)
            ]
            self.frequency = spectral_line(rest, motions)
            if np.isfinite(self.frequency):  # with a phase of its own in every record
                angles = (2 * np.pi * self.frequency * np.asarray(m.t) for m in motions)
                waves = [
                    filtered(np.column_stack([np.cos(x), np.sin(x)]), f)
                    for x, f in zip(angles, filters)
                ]
                groups["line"] = np.split(
                    block_diag(*waves), np.cumsum([len(wave) for wave in waves[:-1]])
                )
        every = thinning([m.s for m in motions])
        groups["force"] = list(force)
        self.regression = Regression.of(
            {name: [x[::every] for x in parts] for name, parts in groups.items()}
        )
        self.rows = {"constant": ["constant"]}
        for row, names in list(ROWS.items())[1:]:
            if row == Dependence.COVARIATE.value:
                self.rows |= {
                    name: [*self.base, name]
                    for name in groups
                    if name.startswith("covariate ")
                }
            elif all(name in groups for name in names):
                self.rows[row] = [*self.base, *names]

    def odd(self, row: str) -> float:
        """Odd share of the fitted function of one row of the table, along the motion
        and its mirror image.
        """
        names = [
            name
            for name in self.rows.get(row, [])
            if name not in ("constant", "beside")
        ]
        if len(names) < 2 or "line" in names:
            return float("nan")
        found = self.regression.coefficients("force", self.rows[row])
        odd = even = 0.0
        for m, one, f in zip(self.motions, self.whole, self.filters):
            mirror = self.basis.of(
                Motion(-m.s, -m.v, None if m.a is None else -m.a, m.t, m.covariates)
            )
            # as the filter shows them: it may hide a constant, whose coefficient is
            # then anything
            plus, minus = (
                filtered(sum(x[k] @ found[k] for k in names), f) for x in (one, mirror)
            )
            odd, even = (
                odd + len(plus) * float(np.var(plus - minus)),
                even + len(plus) * float(np.var(plus + minus)),
            )
        return odd / (odd + even) if odd + even > 0 else float("nan")

    def features(self, dependence: Dependence, odd: float) -> list[Feature]:
        """Marks of the shape of a function of the rate or of the drift."""
        share = self.regression.share
        if dependence == Dependence.RATE:
            return [Feature.JUMP] * (
                share("force", ["jump"], [*self.base, "rate powers"])[0] > TENTH
            )
        if dependence != Dependence.DRIFT:
            return []
        # straight lines with a gap that explain more than a smooth curve does are a
        # kink
        smooth = share("force", ["powers"], self.base)[0]
        if max(
            share("force", [f"gap {k}"], self.base)[0] for k in range(len(_GAPS))
        ) > smooth + TENTH * (1 - smooth):
            return [Feature.KINK]
        if odd < EXPLAINED:
            return []
        x = np.concatenate([m.s for m in self.motions]) / self.basis.s
        c = self.regression.coefficients("force", [*self.base, "powers"])["powers"]
        curve = c[1] * x**3 + c[3] * x**5
        # an odd function less its regression on x bends outwards where it goes with x^3
        bend = (curve - x @ curve / (x @ x) * x) @ (x**3)
        return [Feature.HARDENING if bend > 0 else Feature.SOFTENING]


def conditional_mean(x: np.ndarray, force: np.ndarray, bins: int = 30) -> pd.DataFrame:
    """Mean of a force in bins of equal count of another signal."""
    order = np.argsort(x, kind="stable")
    edges = np.linspace(0, len(x), min(bins, len(x)) + 1).astype(int)
    count = np.diff(edges)
    centre, mean, square = (
        np.add.reduceat(y[order], edges[:-1]) / count for y in (x, force, force**2)
    )
    error = np.sqrt(np.maximum(square - mean**2, 0.0) / count)
    return pd.DataFrame(
        {"centre": centre, "mean": mean, "error": error, "count": count}
    )


def spectral_line(parts: Sequence[np.ndarray], motions: Sequence[Motion]) -> float:
    """Frequency of the highest line of a residual that stands out of its surroundings,
    Hz; NaN if none does.
    """
    e, t = max(
        ((part, m.t) for part, m in zip(parts, motions)), key=lambda pair: len(pair[0])
    )
    n = len(e)
    window = np.hanning(n)
    power = np.abs(np.fft.rfft(e * window)) ** 2
    if t is None or n < 64 or not power.any():
        return float("nan")
    dt = (t[-1] - t[0]) / (n - 1)
    from scipy.ndimage import median_filter
    from scipy.signal import zoom_fft

    size = min(101, len(power) // 2 * 2 - 1)
    around = median_filter(power, size=size, mode="mirror") / np.log(2)
    ratio = power / np.maximum(around, 1e-12 * power.max())
    ratio[:3] = ratio[-3:] = 0.0
    peak = int(ratio.argmax())
    # an exponential over a scale that is itself estimated: F with 2 and 2 k degrees of
    # freedom
    k = size * np.log(2) ** 2 / _HANN_OVERLAP
    if len(power) * (1.0 + ratio[peak] / k) ** -k > RARE:
        return float("nan")
    low, high = (peak - 1) / (n * dt), (peak + 1) / (n * dt)
    fine = np.abs(zoom_fft(e * window, [low, high], 81, fs=1 / dt, endpoint=True))
    return float(np.linspace(low, high, 81)[fine.argmax()])
