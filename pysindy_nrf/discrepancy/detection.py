"""Is the residual noise, or is something missing - and is it linear?

Tests of model validity by correlation (S. A. Billings and W. S. F. Voon, Int. J. Control 44, 1986): the
residual must be white and uncorrelated with every function of inputs and states. Each test knows the
colour of its signals, so a filtered residual does not look like structure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
from scipy.fft import dct, irfft, next_fast_len, rfft
from scipy.signal import sosfreqz, welch
from scipy.special import chdtrc, fdtrc, ndtr, ndtri, stdtr, stdtrit

from ..exceptions import NRFError
from ..mechanics.sites import Site
from ..regression.segments import Segment
from .residual import AT_FLOOR, ROUND_OFF, NoiseFloor, Residual, period_of
from .words import ResidualKind

# A residual that is so many times the loudest draw of noise is no noise, however it correlates.
LOUD = 2.0
# One this far below the noise floor holds nothing but noise, whatever it correlates with.
BELOW_FLOOR = 0.8
_WHITE_LAGS = 20
# Shifts of an input to either side, an eighth of a period apart, that are linear.
_TAPS = 4
# Every k-th sample is enough for the correlations, as long as so many are left in all and in a period.
_ENOUGH, _PER_PERIOD = 4096, 8
# Tests by the order of the signal: what its power correlates with.
_POWERS = {1: "phi_xe", 2: "phi_x2e", 3: "phi_x3e"}


@dataclass
class Detection:
    """What the tests say about every balance and storey.

    Attributes
    ----------
    verdicts : DataFrame
        Rows ``"dof j"`` and ``"storey i"``: ``verdict`` (a ``ResidualKind``); ``percent`` (of the reference);
        ``floor ratio`` (rms over that of the noise floor); ``linear share`` (of the residual's variance that drifts,
        rates and inputs explain linearly, noise's own share included); ``p white``, ``p linear``,
        ``p nonlinear`` (probability of such a correlation in noise, corrected for the number of tests).
    tests : DataFrame
        One row for each test: ``where``, ``test``, ``signal``, ``peak`` (of the normalised correlation),
        ``lag`` (s, or samples if the step is unknown), ``band`` (the peak's bound at the level of the tests),
        ``p``, ``outside``.
    curves : dict of (where, test, signal) to (lag, correlation, band)
        For drawing; lags as in ``tests``, but of ``phi_ee`` in samples of the whitened residual.
    """

    verdicts: pd.DataFrame
    tests: pd.DataFrame
    curves: dict[tuple[str, str, str], tuple[np.ndarray, np.ndarray, float]] = field(default_factory=dict)

    @property
    def is_noise(self) -> bool:
        """Whether nothing but noise is left in any balance."""
        return bool((self.verdicts["verdict"] == ResidualKind.NOISE).all())


def detect(
    residual: Residual, floor: NoiseFloor | None = None, *, level: float = 0.05, min_share: float = 0.02
) -> Detection:
    r"""Test every balance and storey for structure."""
    if not isinstance(residual, Residual):
        raise NRFError(f"{type(residual).__name__} is not a residual", "Make one with residual_of(model, data).")
    work = _Tests(residual, [] if floor is None else floor.draws, level, min_share)
    verdicts: dict[str, dict[str, Any]] = {}
    for where, size in residual.sizes.iterrows():
        if not np.isfinite(size["rms"]):
            continue
        ratio = size["rms"] / floor.at(where) if floor is not None and floor.at(where) > 0 else np.nan
        verdict = {"verdict": ResidualKind.NOISE, "percent": size["percent"], "floor ratio": ratio}
        if size["rms"] > ROUND_OFF * size["reference"]:
            verdict |= work.judge(where, ratio)
        verdicts[where] = verdict
    columns = ["verdict", "percent", "floor ratio", "linear share", "p white", "p linear", "p nonlinear"]
    names = ["where", "test", "signal", "peak", "lag", "band", "p", "outside"]
    return Detection(
        pd.DataFrame.from_dict(verdicts, orient="index").reindex(columns=columns),
        pd.DataFrame(work.rows, columns=names).astype({"outside": bool}),
        work.curves,
    )


class _Tests:
    """All tests of one residual, beside those of noise alone."""

    def __init__(self, residual: Residual, draws: Sequence[Residual], level: float, min_share: float) -> None:
        self.every, self.level, self.min_share = [residual, *draws], level / 3, min_share
        self.rows: list[tuple] = []
        self.curves: dict[tuple[str, str, str], Any] = {}
        segments = residual.data.segments
        period = min(period_of([seg.s[seg.valid, i] for seg in segments]) for i in range(residual.n_dof))
        total, shortest = sum(seg.n_valid for seg in segments), min(seg.n_valid for seg in segments)
        self.thin = int(max(1, min(total // _ENOUGH, period // _PER_PERIOD)))
        self.spacing = max(1, int(round(period / 8)))
        self.lags = int(max(8, min(period, shortest // 10) / self.thin))
        self.step = (segments[0].dt or 1.0) * self.thin
        self._views: dict[tuple[int, ...], list[_View]] = {}

    def judge(self, where: str, ratio: float) -> dict[str, Any]:
        """Run the tests of one balance or storey; fill ``rows`` and ``curves``."""
        use = tuple(i for i, e in enumerate(self.every[0].at(where)) if np.isfinite(e).all() and len(e) > 16)
        if use not in self._views:
            self._views[use] = [_View(r, use, self.thin, self.spacing) for r in self.every]
        sides = [_Side(view, where) for view in self._views[use]]
        side, *noise = sides
        p_white, white = self._whiteness(where, sides)
        p_linear, _ = self._family(where, sides, (1,))
        p_nonlinear, strong = self._family(where, sides, (2, 3))
        excess = side.linear_share - float(np.mean([s.linear_share * s.size / side.size for s in noise] or [0.0]))
        powers = np.array([s.size for s in noise])
        loudest = float(np.sqrt(powers.max() / powers.mean())) if powers.any() else 1.0
        kinds = (
            (ResidualKind.NONLINEAR, p_nonlinear, min(strong, 1.0 - side.linear_share)),
            (ResidualKind.LINEAR, p_linear, excess),
            (ResidualKind.UNMEASURED, p_white, white),
        )
        told = [kind for kind, p, share in kinds if p < self.level and share >= self.min_share]
        verdict = told[0] if told else ResidualKind.NOISE
        if not told and ratio > LOUD * loudest:
            verdict = min(kinds, key=lambda kind: kind[1])[0]
        if ratio < BELOW_FLOOR or (verdict == ResidualKind.UNMEASURED and ratio < max(AT_FLOOR, loudest)):
            verdict = ResidualKind.NOISE
        chances = {"p white": p_white, "p linear": p_linear, "p nonlinear": p_nonlinear}
        return {"verdict": verdict, "linear share": side.linear_share, **chances}

    def _whiteness(self, where: str, sides: list[_Side]) -> tuple[float, float]:
        """p of the portmanteau, and the share of the variance that the past predicts."""
        side, *noise = sides
        density = _reference(side, noise)
        phi, n = whitened_autocorrelation(side.whole, density, _WHITE_LAGS)
        more, draws = 1.0, len(noise)
        if noise:
            drawn = np.array([whitened_autocorrelation(s.whole, density, _WHITE_LAGS)[0] for s in noise])
            phi = np.clip(phi - drawn.mean(axis=0), -1.0, 1.0)
            more = (1 + 1 / draws) * float(_scatter(drawn[:, None], np.full(1, 1.0 / n))[0])
            p = float(fdtrc(_WHITE_LAGS, max(1, draws - 1) * _WHITE_LAGS, n * (phi**2).mean() / more))
        else:
            p = float(chdtrc(_WHITE_LAGS, n * (phi**2).sum()))
        band = float(np.sqrt(more / n)) * peak_limit(self.level, _WHITE_LAGS, np.pi)
        peak = int(np.abs(phi).argmax())
        self.rows.append((where, "phi_ee", "e", phi[peak], float(peak + 1), band, p, p < self.level))
        self.curves[where, "phi_ee", "e"] = (np.arange(1, _WHITE_LAGS + 1), phi, band)
        return p, float(np.clip((phi**2).sum() - more * _WHITE_LAGS / n, 0.0, 1.0))

    def _family(self, where: str, sides: list[_Side], powers: tuple[int, ...]) -> tuple[float, float]:
        """Corrected p of a family of tests, and the largest share of the variance a correlation outside stands for."""
        names = sides[0].names
        count = max(1, len(names) * len(powers))
        level, least, strong = self.level / count, 1.0, 0.0
        for power in powers:
            cross, *noise = [side.cross(power, self.lags) for side in sides]
            total, spread, dof = cross.total, cross.spread, np.inf
            if noise:
                drawn, by_chance = np.array([c.total for c in noise]), np.mean([c.spread**2 for c in noise], axis=0)
                total = total - drawn.mean(axis=0)
                # fits scatter from one noise to the next by more than signals that never were fitted
                by_noise = by_chance * _scatter(drawn, by_chance).mean() * (1 + 1 / len(noise))
                beyond = np.maximum(spread**2 - by_chance, 0.0)
                spread = np.sqrt(by_noise + beyond)
                if len(noise) > 1:
                    dof = (len(noise) - 1) * len(names) * (1 + beyond / np.maximum(by_noise, 1e-300)) ** 2
            moves = (spread > 0) & (cross.energy > 0)
            spread, energy = np.where(moves, spread, np.inf), np.where(moves, cross.energy, np.inf)
            height = np.abs(total) / spread[:, None]
            peak = height.argmax(axis=1)
            at = np.arange(len(names)), peak
            p = probability_of_peak(_as_normal(height[at], dof), height.shape[1], cross.omega)
            band = _as_student(peak_limit(level, height.shape[1], cross.omega), dof) * spread / energy
            phi = np.clip(total / energy[:, None], -1.0, 1.0)
            lag = cross.lag * self.step
            for k in np.flatnonzero(moves):
                key = (where, _POWERS[power], names[k])
                self.rows.append((*key, phi[at][k], lag[peak[k]], band[k], p[k], p[k] < level))
                self.curves[key] = (lag, phi[k], float(band[k]))
            outside = moves & (p < level)
            least = min(least, float(p[moves].min(initial=1.0)))
            strong = max(strong, float((phi[at][outside] ** 2).max(initial=0.0)))
        return min(1.0, least * count), strong


class _View:
    """Drifts, rates and inputs that go with a residual, and their powers less what is linear."""

    def __init__(self, residual: Residual, use: tuple[int, ...], thin: int, spacing: int) -> None:
        self.residual, self.use, self.thin = residual, use, thin
        segments = [residual.data.segments[i] for i in use]
        inputs = _inputs(segments)
        sites = list(dict.fromkeys([*residual.model.chain.sites, *map(Site, range(1, residual.n_dof + 1))]))
        self.names = [*(f"{kind} of {site}" for site in sites for kind in "sv"), *inputs]
        taps = min(_TAPS, max(0, (min(seg.n_valid for seg in segments) - 64) // (8 * spacing)))
        self.pad = taps * spacing
        raw = []
        for i, seg in enumerate(segments):
            motions = [seg.motion(site, seg.valid) for site in sites]
            raw.append(np.column_stack([*(x for m in motions for x in (m.s, m.v)), *(x[i] for x in inputs.values())]))
        size = np.max([np.abs(x).max(axis=0) for x in raw], axis=0)
        size[size == 0] = 1.0
        first = 2 * len(sites)
        plain, powers, linear = [], [], []
        for x, i in zip(raw, use):
            filter = residual.filters[i]
            z = x / size
            z = np.hstack([x, z**2, z**3])
            z = z if filter is None else filter.apply(z)
            plain.append(self.inside(z[:, : len(size)]).T)
            powers.append(self.inside(z[:, len(size) :]))
            rows = len(z) - 2 * self.pad
            shifted = [z[k * spacing : k * spacing + rows : thin, first : len(size)] for k in range(2 * taps + 1)]
            linear.append(np.hstack([np.ones((len(powers[-1]), 1)), self.inside(z[:, :first]), *shifted]))
        self.basis = _orthonormal(np.vstack(linear))
        squares, cubes = zip(*(np.split(part.T, 2) for part in self.without(powers)))
        self.signals = {1: Spectra(plain), 2: Spectra(squares), 3: Spectra(cubes)}

    def inside(self, x: np.ndarray) -> np.ndarray:
        """The rows at which all neighbouring times lie within the record, thinned."""
        return x[self.pad : len(x) - self.pad : self.thin]

    def without(self, x: Sequence[np.ndarray]) -> list[np.ndarray]:
        """What drifts, rates and inputs do not explain linearly."""
        whole = np.concatenate(x)
        left = whole - self.basis @ (self.basis.T @ whole)
        return np.split(left, np.cumsum([len(part) for part in x])[:-1])


def _inputs(segments: list[Segment]) -> dict[str, list[np.ndarray]]:
    """Forces, base acceleration and covariates that move, one array for each record."""
    found = {}
    for k in range(segments[0].n_dof):
        found[f"F{k + 1}"] = [np.nan_to_num(seg.F[seg.valid, k].astype(float)) for seg in segments]
    if all(seg.ag is not None for seg in segments):
        found["ag"] = [seg.ag[seg.valid] for seg in segments if seg.ag is not None]
    for name in segments[0].covariates:
        if name not in ("ag", "vg") and all(name in seg.covariates for seg in segments):
            found[name] = [seg.covariates[name][seg.valid].astype(float) for seg in segments]
    return {name: parts for name, parts in found.items() if any(part.any() for part in parts)}


class _Side:
    """The residual of one balance or storey in one view."""

    def __init__(self, view: _View, where: str) -> None:
        kind, _, number = where.partition(" ")
        sites = view.residual.model.chain.sites_of(int(number)) if kind == "dof" else [Site(int(number))]
        near = {f"{k} of {site}" for site in sites for k in "sv"}
        self.view = view
        self.chosen = [k for k, name in enumerate(view.names) if name in near or " of " not in name]
        self.names = [view.names[k] for k in self.chosen]
        self.whole = [view.residual.at(where)[i] for i in view.use]
        e = [view.inside(part) for part in self.whole]
        rest = view.without(e)
        self.size, after = (sum(float(x @ x) for x in parts) for parts in (e, rest))
        columns = view.basis.shape[1]
        overfit = columns / max(sum(map(len, e)) * _bandwidth(e), 2.0 * columns)
        share = (1.0 - after / self.size - overfit) / (1 - overfit) if self.size else 0.0
        self.linear_share = float(np.clip(share, 0.0, 1.0))
        self.plain, self.rest = (Spectra([x[None] for x in parts]) for parts in (e, rest))

    def cross(self, power: int, lags: int) -> Cross:
        """Cross-covariance of powers of the signals with the residual; above 1 what is linear is taken off."""
        return cross_covariance(self.view.signals[power][self.chosen], self.plain if power == 1 else self.rest, lags)


def _scatter(drawn: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """Variance among draws, shape (n_draws, n_signals, n_lags), over that expected; at least 1."""
    if len(drawn) < 2:
        return np.ones(len(expected))
    return np.maximum(drawn.var(axis=0, ddof=1).mean(axis=1) / np.maximum(expected, 1e-300), 1.0)


def _as_normal(height: Any, dof: Any) -> Any:
    """Height in standard deviations that is as rare as one in estimated ones (Student)."""
    if np.all(np.isinf(dof)):
        return height
    return np.minimum(-ndtri(np.maximum(stdtr(dof, -height), 1e-300)), 37.0)


def _as_student(height: Any, dof: Any) -> Any:
    """Height in estimated standard deviations that is as rare as one in known ones."""
    return height if np.all(np.isinf(dof)) else -stdtrit(dof, ndtr(-height))


def _orthonormal(columns: np.ndarray) -> np.ndarray:
    """Orthonormal basis of columns of any scale, dependent ones left out."""
    size = np.sqrt(np.einsum("ij,ij->j", columns, columns))
    columns = columns[:, size > 0] / size[size > 0]
    values, vectors = np.linalg.eigh(columns.T @ columns)
    keep = values > 1e-10 * values[-1]
    return columns @ (vectors[:, keep] / np.sqrt(values[keep]))


def _bandwidth(x: Sequence[np.ndarray]) -> float:
    """Share of the frequency axis that a signal fills, ``(sum I)^2 / (M sum I^2)`` of its periodogram (1 for white)."""
    top = bottom = 0.0
    for part in x:
        power = np.abs(rfft(part - part.mean())) ** 2
        top, bottom = top + float(power.sum() ** 2) / len(power), bottom + float(power @ power)
    return min(1.0, 2 * top / bottom) if bottom > 0 else 1.0


def _reference(side: _Side, noise: list[_Side]) -> list[np.ndarray]:
    """Spectrum that noise alone would have, for each record: of the draws, else of the filter."""
    if noise:
        parts = [e for s in noise for e in s.whole]
        size = min(512, min(map(len, parts)))
        return [np.mean([welch(e, nperseg=size)[1] for e in parts], axis=0)] * len(side.whole)
    filters = [side.view.residual.filters[i] for i in side.view.use]
    grid = np.linspace(0, np.pi, 2049)
    return [np.ones(2) if f is None or f.sos is None else np.abs(sosfreqz(f.sos, worN=grid)[1]) ** 4 for f in filters]


# -- correlations between signals with a spectrum of their own --------------------------------------


class Spectra:
    """Signals over contiguous records, means taken off, as Fourier transforms padded to twice the length."""

    def __init__(self, parts: Sequence[np.ndarray]) -> None:
        centred = [x - x.mean(axis=1, keepdims=True) for x in parts]
        self.counts = [x.shape[1] for x in parts]
        self.values = [rfft(x, next_fast_len(2 * x.shape[1], real=True)) for x in centred]
        self.power = [X.real**2 + X.imag**2 for X in self.values]
        self.energy = sum((x**2).sum(axis=1) for x in centred)

    def __getitem__(self, chosen: Sequence[int]) -> Spectra:
        out = object.__new__(Spectra)
        out.counts, out.energy = self.counts, self.energy[chosen]
        out.values, out.power = [X[chosen] for X in self.values], [p[chosen] for p in self.power]
        return out


@dataclass
class Cross:
    """Cross-covariance of some signals x with y, and what it would be if they were independent."""

    lag: np.ndarray
    total: np.ndarray  # sum_t x(t) y(t + tau), shape (n_signals, n_lags)
    # its standard deviation by Bartlett's formula, N sum_k gamma_x(k) gamma_y(k): no signal needs whitening
    spread: np.ndarray
    energy: np.ndarray  # sqrt(sum x^2 sum y^2)
    omega: np.ndarray  # rms angular frequency, rad per sample, of the total as a function of the lag


def cross_covariance(x: Spectra, y: Spectra, lags: int) -> Cross:
    """Cross-covariances of signals with one other over contiguous records."""
    lag = np.arange(-lags, lags + 1)
    total, variance, slope = np.zeros((len(x.energy), lag.size)), 0.0, 0.0
    for X, Y, p, q, count in zip(x.values, y.values, x.power, y.power, x.counts):
        size = next_fast_len(2 * count, real=True)
        total += irfft(X.conj() * Y, size)[:, lag]
        # the sum over lags of both autocovariances is the sum over frequencies of both periodograms
        both = p * q / (size * count)
        both[:, 1:] *= 2
        variance = variance + both.sum(axis=1)
        slope = slope + both @ np.linspace(0, np.pi, both.shape[1]) ** 2
    omega = np.sqrt(np.divide(slope, variance, out=np.zeros(len(total)), where=variance > 0))
    return Cross(lag, total, np.sqrt(variance), np.sqrt(x.energy * y.energy), omega)


def probability_of_peak(height: Any, n_lags: int, omega: Any) -> Any:
    """Probability that the correlation of independent signals exceeds a height at any lag (S. O. Rice, 1944)."""
    single = 2 * ndtr(-np.asarray(height, dtype=float))
    further = np.minimum(omega / np.pi * np.exp(-(np.asarray(height) ** 2) / 2), single)
    return -np.expm1(np.log1p(-np.minimum(single, 1 - 1e-16)) - (n_lags - 1) * further)


def peak_limit(level: float, n_lags: int, omega: Any) -> Any:
    """Height, in standard deviations, that :func:`probability_of_peak` gives the probability ``level``."""
    low, high = np.zeros(np.shape(omega)), np.full(np.shape(omega), 40.0)
    for _ in range(40):
        middle = (low + high) / 2
        above = probability_of_peak(middle, n_lags, omega) > level
        low, high = np.where(above, middle, low), np.where(above, high, middle)
    return high if high.ndim else float(high)


def whitened_autocorrelation(
    parts: Sequence[np.ndarray], density: Sequence[np.ndarray], lags: int
) -> tuple[np.ndarray, int]:
    r"""Autocorrelation of a signal after division of its spectrum by a reference, in the reference's band alone."""
    top, bottom, n = np.zeros(lags), 0.0, 0
    for e, reference in zip(parts, density):
        power = np.abs(rfft(e - e.mean()))[1:] ** 2
        grid = np.linspace(0, 1, len(power) + 1)[1:]
        S = np.interp(grid, np.linspace(0, 1, len(reference)), reference)
        inside = S > 0.25 * S.max()
        ratio = power[inside] / S[inside]
        # cosines at frequencies (k + 1/2) / K of half the rate
        top += np.pad(dct(ratio)[1 : lags + 1] / 2, (0, max(0, lags + 1 - len(ratio))))
        bottom += ratio.sum()
        n += 2 * len(ratio)
    return (top / bottom if bottom > 0 else top), n
