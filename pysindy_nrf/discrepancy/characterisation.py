"""What kind of force is missing: what it depends on, told without a formula."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from ..exceptions import ChannelError
from ..laws.shape import Motion
from . import words
from .dependence import GAPS, Basis, Judge, envelope, filtered, period_of
from .verdicts import Dependence, Feature

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
