"""Is the residual noise, or is something missing - and is it linear?

Tests of model validity by correlation (S. A. Billings and W. S. F. Voon, Int. J. Control 44, 1986): the
residual must be white and uncorrelated with every function of inputs and states. Each test knows the
colour of its signals, so a filtered residual does not look like structure.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from ..exceptions import NRFError
from ..mechanics.sites import Site
from ..regression.segments import Segment, SegmentSet
from . import words
from .characterisation import filtered
from .residual import AT_FLOOR, BELOW_FLOOR, LOUD, ROUND_OFF, NoiseFloor, Residual, period_of
from .words import ResidualKind

HIGHER = ("phi_x2e", "phi_x3e", "phi_|x||e|", "phi_e(ex)")
_KINDS = {"nonlinear": ResidualKind.NONLINEAR, "linear": ResidualKind.LINEAR, "white": ResidualKind.UNMEASURED}
_TESTS = {
    ResidualKind.LINEAR: ["phi_xe"], ResidualKind.UNMEASURED: ["phi_ee"], ResidualKind.NONLINEAR: list(HIGHER),
}  # fmt: skip
_WHITE_LAGS = 20
_TAPS = 4
# Every k-th sample is enough for the correlations, as long as so many are left in all and in a period.
_ENOUGH = 4096
_PER_PERIOD = 8


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
    level : float
    """

    verdicts: pd.DataFrame
    tests: pd.DataFrame
    level: float
    curves: dict[tuple[str, str, str], tuple[np.ndarray, np.ndarray, float]] = field(default_factory=dict)

    @property
    def is_noise(self) -> bool:
        """Whether nothing but noise is left in any balance."""
        return bool((self.verdicts["verdict"] == ResidualKind.NOISE).all())

    @property
    def sentence(self) -> str:
        """The verdicts in words."""
        return words.of_detection(self, _TESTS)

    def __str__(self) -> str:
        return self.sentence.replace("; ", "\n")


def detect(
    residual: Residual,
    floor: NoiseFloor | None = None,
    *,
    level: float = 0.05,
    lags: int | None = None,
    min_share: float = 0.02,
) -> Detection:
    r"""Test every balance and storey for structure."""
    if not isinstance(residual, Residual):
        raise NRFError(f"{type(residual).__name__} is not a residual", "Make one with residual_of(model, data).")
    verdicts: dict[str, dict[str, Any]] = {}
    rows: list[dict[str, Any]] = []
    curves: dict[tuple[str, str, str], Any] = {}
    views = [_View(residual, residual.data), *(_View(r, d) for r, d in (floor.draws if floor is not None else []))]
    for where in residual.sizes.index:
        if not np.isfinite(residual.sizes.loc[where, "rms"]):
            continue
        ratio = np.nan
        if floor is not None and floor.at(where) > 0:
            ratio = residual.sizes.loc[where, "rms"] / floor.at(where)
        verdict = {"verdict": ResidualKind.NOISE, "percent": residual.sizes.loc[where, "percent"], "floor ratio": ratio}
        if residual.sizes.loc[where, "rms"] > ROUND_OFF * residual.sizes.loc[where, "reference"]:
            place = _Place(where, views, level, lags, min_share)
            verdict |= place.judge()
            if verdict["verdict"] == ResidualKind.NOISE and ratio > LOUD * place.loudest:
                verdict["verdict"] = place.likeliest(verdict)
            if ratio < BELOW_FLOOR or (
                verdict["verdict"] == ResidualKind.UNMEASURED and ratio < max(AT_FLOOR, place.loudest)
            ):
                verdict["verdict"] = ResidualKind.NOISE
            rows += place.rows
            curves |= place.curves
        verdicts[where] = verdict
    columns = ["verdict", "percent", "floor ratio", "linear share", "p white", "p linear", "p nonlinear"]
    names = ["where", "test", "signal", "peak", "lag", "band", "p", "outside"]
    return Detection(
        pd.DataFrame.from_dict(verdicts, orient="index").reindex(columns=columns),
        pd.DataFrame(rows, columns=names).astype({"outside": bool}),
        level,
        curves,
    )


class _View:
    """A residual with the data that go with it: the measured one, or one of noise alone."""

    def __init__(self, residual: Residual, data: SegmentSet) -> None:
        self.residual, self.data = residual, data
        self._bases: dict[tuple[int, ...], tuple[np.ndarray, int]] = {}

    def basis(self, use: list[int], spacing: int, worth: float, every: int) -> tuple[np.ndarray, int]:
        """Orthonormal columns of what is linear, in the band, and the rows lost at each end before thinning."""
        key = tuple(use)
        if key not in self._bases:
            segments = [self.data.segments[i] for i in use]
            inputs = [x for _, x in _inputs(segments)]
            shortest = min(seg.n_valid for seg in segments)
            taps = int(np.clip((worth / 8 / max(1, len(inputs)) - 1) / 2, 0, _TAPS))
            taps = min(taps, max(0, (shortest - 64) // (8 * spacing)))
            rows = []
            for i, (seg, k) in enumerate(zip(segments, use)):
                filter = self.residual.filters[k]
                motion = np.column_stack([seg.s[seg.valid], seg.v[seg.valid]]).astype(float)
                columns = [filtered(x[i], filter) for x in inputs]
                rows.append(_linear(filtered(motion, filter), columns, spacing, taps)[::every])
            self._bases[key] = _orthonormal(np.vstack(rows)), taps * spacing
        return self._bases[key]

    def target(self, where: str) -> tuple[list[int], list[np.ndarray]]:
        """Records in which a balance is known, and its residual there."""
        parts = self.residual.at(where)
        use = [i for i, e in enumerate(parts) if np.isfinite(e).all() and len(e) > 16]
        return use, [parts[i] for i in use]

    def signals(self, where: str, use: list[int]) -> tuple[dict[str, list[np.ndarray]], dict[str, list[np.ndarray]]]:
        """Drifts beside a balance and inputs, as they are; rates follow from them in the tests."""
        kind, _, number = where.partition(" ")
        j, chain = int(number), self.residual.model.chain
        sites = [Site(j)] if kind == "storey" else list(chain.sites_of(j))
        segments = [self.data.segments[i] for i in use]
        states, inputs = {}, {}
        for site in sites:
            motions = [seg.motion(site, seg.valid) for seg in segments]
            states[f"s of {site}"] = [m.s for m in motions]
            states[f"v of {site}"] = [m.v for m in motions]
        for name, column in _inputs(segments):
            inputs[name] = column
        return states, inputs


def _inputs(segments: list[Segment]) -> Iterator[tuple[str, list[np.ndarray]]]:
    for k in range(segments[0].n_dof):
        parts = [np.nan_to_num(seg.F[seg.valid, k].astype(float)) for seg in segments]
        if any(p.any() for p in parts):
            yield f"F{k + 1}", parts
    base = [seg.ag[seg.valid] for seg in segments if seg.ag is not None]
    if len(base) == len(segments) and any(ag.any() for ag in base):
        yield "ag", base
    for name in segments[0].covariates:
        if name not in ("ag", "vg") and all(name in seg.covariates for seg in segments):
            yield name, [seg.covariates[name][seg.valid].astype(float) for seg in segments]


class _Place:
    """All tests of one balance or storey."""

    def __init__(self, where: str, views: list[_View], level: float, lags: int | None, min_share: float) -> None:
        self.where, self.level, self.min_share = where, level, min_share
        self.rows: list[dict[str, Any]] = []
        self.curves: dict[tuple[str, str, str], Any] = {}
        first = views[0]
        use, e = first.target(where)
        states, _ = first.signals(where, use)
        shortest = min(map(len, e))
        period = period_of(next(iter(states.values())))
        self.lags = (
            int(np.clip(period if lags is None else lags, 8, max(8, shortest // 10))) if lags is None else int(lags)
        )
        self.spacing = max(1, int(round(period / 8)))
        every = int(max(1, min(sum(map(len, e)) // _ENOUGH, period // _PER_PERIOD)))
        self.lags = max(8, self.lags // every)
        self.steps = [None if dt is None else dt * every for dt in (first.data.segments[i].dt for i in use)]
        self.sides = [_Side(view, where, self.spacing, every) for view in views]
        self.draws = len(views) - 1

    @property
    def loudest(self) -> float:
        """Largest rms of a draw of noise over that of all."""
        squares = [float(np.mean(np.concatenate(s.whole) ** 2)) for s in self.sides[1:]]
        return float(np.sqrt(max(squares) / np.mean(squares))) if squares and max(squares) > 0 else 1.0

    @staticmethod
    def likeliest(verdict: dict[str, Any]) -> ResidualKind:
        """What a residual far above the noise is, by the family of tests that stands out most."""
        return min(((verdict[f"p {word}"], kind) for word, kind in _KINDS.items()), key=lambda pair: pair[0])[1]

    def judge(self) -> dict[str, Any]:
        """Run the tests; fill ``rows`` and ``curves``."""
        side = self.sides[0]
        p_white, white = self._whiteness()
        p_linear, _ = self._family([("phi_xe", "xe", name) for name in side.raw])
        higher = [(test, test[4:], name) for test in HIGHER for name in side.raw]
        p_nonlinear, strong = self._family(higher)
        share = side.linear_share
        left = 1.0 - share
        excess = self._excess()
        verdict = ResidualKind.NOISE
        if p_white < self.level / 3 and white >= self.min_share:
            verdict = ResidualKind.UNMEASURED
        if p_linear < self.level / 3 and excess >= self.min_share:
            verdict = ResidualKind.LINEAR
        if p_nonlinear < self.level / 3 and min(strong, left) >= self.min_share:
            verdict = ResidualKind.NONLINEAR
        return {
            "verdict": verdict,
            "linear share": share,
            "p white": p_white,
            "p linear": p_linear,
            "p nonlinear": p_nonlinear,
        }

    def _whiteness(self) -> tuple[float, float]:
        """p of the portmanteau, and the share of the variance that the past predicts."""
        from scipy.stats import chi2, f

        side = self.sides[0]
        density = _reference(side, self.sides[1:])
        phi, n = whitened_autocorrelation(side.whole, density, _WHITE_LAGS)
        more = 1.0
        if self.draws:
            noise = [whitened_autocorrelation(s.whole, _fit(density, s.whole), _WHITE_LAGS)[0] for s in self.sides[1:]]
            phi, more = np.clip(phi - np.mean(noise, axis=0), -1.0, 1.0), 1 + 1 / self.draws
            more *= _scatter([(d, np.sqrt(1.0 / n)) for d in noise])
        p = float(f.sf(n * (phi**2).mean() / more, _WHITE_LAGS, max(1, self.draws - 1) * _WHITE_LAGS))
        if not self.draws:
            p = float(chi2.sf(n * (phi**2).sum(), _WHITE_LAGS))
        band = float(np.sqrt(more / n)) * peak_limit(self.level / 3, _WHITE_LAGS, np.pi)
        peak = int(np.abs(phi).argmax())
        self._note("phi_ee", "e", phi[peak], float(peak + 1), band, p, p < self.level / 3)
        self.curves[self.where, "phi_ee", "e"] = (np.arange(1, _WHITE_LAGS + 1), phi, band)
        return p, float(min(1.0, max((phi**2).sum() - more * _WHITE_LAGS / n, 0.0)))

    def _family(self, tests: list[tuple[str, str, str]]) -> tuple[float, float]:
        """Corrected p of a family of tests, and the largest share of the variance a correlation outside stands for."""
        level = self.level / 3 / max(1, len(tests))
        least, strong = 1.0, 0.0
        found = [(test, kind, name, self._crosses(kind, name)) for test, kind, name in tests]
        found = [one for one in found if one[3][0].moves]
        # fits scatter from one noise to the next by more than signals that never were fitted
        drawn: dict[str, list[float]] = {}
        for test, _, _, crosses in found:
            drawn.setdefault(test, []).append(_scatter([(c.total, c.spread) for c in crosses[1:]]))
        for test, kind, name, (cross, *others) in found:
            dof = float((self.draws - 1) * len(drawn[test])) if self.draws > 1 else np.inf
            total, spread = cross.total, cross.spread
            if others:
                total = total - np.mean([c.total for c in others], axis=0)
                noise = float(np.mean([c.spread**2 for c in others]))
                by_noise = noise * float(np.mean(drawn[test])) * (1 + 1 / len(others))
                beyond = max(spread**2 - noise, 0.0)
                spread = float(np.sqrt(by_noise + beyond))
                dof *= (1 + beyond / by_noise) ** 2 if by_noise > 0 else np.inf
            height = np.abs(total) / spread
            peak = int(height.argmax())
            p = probability_of_peak(_as_normal(float(height[peak]), dof), len(height), cross.omega)
            limit = _as_student(peak_limit(level, len(height), cross.omega), dof)
            band = limit * spread / cross.energy
            phi = np.clip(total / cross.energy, -1.0, 1.0)
            self._note(test, name, phi[peak], float(cross.lag[peak]), band, p, p < level)
            step = self.steps[0] if self.steps[0] is not None else 1.0
            self.curves[self.where, test, name] = (cross.lag * step, phi, band)
            least = min(least, p)
            if p < level:
                strong = max(strong, abs(phi[peak]) if kind == "|x||e|" else phi[peak] ** 2)
        return min(1.0, least * max(1, len(tests))), float(strong)

    def _crosses(self, kind: str, name: str) -> list[Cross]:
        """One test in the measured view and in those of noise alone."""
        return [side.cross(kind, name, self.lags) for side in self.sides]

    def _excess(self) -> float:
        """Share of the residual's variance that is linear beyond what is linear in noise alone."""
        first, *others = self.sides
        size = first.size or 1.0
        return first.linear_share - float(np.mean([s.linear_share * s.size / size for s in others] or [0.0]))

    def _note(self, test: str, signal: str, peak: float, lag: float, band: float, p: float, outside: bool) -> None:
        step = self.steps[0] if self.steps[0] is not None else 1.0
        values = (self.where, test, signal, float(peak), lag * step, float(band), p, bool(outside))
        self.rows.append(dict(zip(("where", "test", "signal", "peak", "lag", "band", "p", "outside"), values)))


class _Side:
    """Residual, signals and their powers of one view; what is linear in drifts, rates and inputs is taken off."""

    def __init__(self, view: _View, where: str, spacing: int, every: int) -> None:
        use, self.whole = view.target(where)
        self.filters = [view.residual.filters[i] for i in use]
        self.every = every
        self.e = [part[::every] for part in self.whole]
        states, inputs = view.signals(where, use)
        self.raw = states | inputs
        self.plain = {name: _filtered(x, self.filters) for name, x in self.raw.items()}
        self.bandwidth = _bandwidth(self.e)
        self._basis, self._pad = view.basis(use, spacing, sum(map(len, self.e)) * self.bandwidth, every)
        inside = self._inside(self.whole)
        self.rest = self._without(inside)
        before, after = (sum(float(x @ x) for x in parts) for parts in (inside, self.rest))
        self.size = before
        worth = max(sum(map(len, inside)) * self.bandwidth, 2.0 * self._basis.shape[1])
        overfit = self._basis.shape[1] / worth
        self.linear_share = (
            float(np.clip(((before - after) / before - overfit) / (1 - overfit), 0.0, 1.0)) if before else 0.0
        )
        self._residuals = {"xe": Signal(self.e), "": Signal(self.rest)}
        self._residuals["|x||e|"] = Signal([np.abs(r) for r in self.rest])

    def _inside(self, x: Parts) -> list[np.ndarray]:
        """The rows at which all neighbouring times lie within the record, thinned."""
        return [part[self._pad : len(part) - self._pad : self.every] for part in x]

    def _without(self, x: Parts) -> list[np.ndarray]:
        """What drifts, rates and inputs do not explain linearly."""
        whole = np.concatenate(x)
        return np.split(whole - self._basis @ (self._basis.T @ whole), np.cumsum([len(part) for part in x])[:-1])

    def _power(self, name: str, degree: int) -> list[np.ndarray]:
        raw = self.raw[name]
        size = max(float(np.abs(x).max()) for x in raw) or 1.0
        scaled = [x / size for x in raw]
        columns = _filtered([x * x if degree == 2 else x * x * x for x in scaled], self.filters)
        return self._without(self._inside([c - c.mean() for c in columns]))

    def cross(self, kind: str, name: str, lags: int) -> Cross:
        """Cross-covariance of one test; see :func:`detect`."""
        if kind == "xe":
            return cross_covariance([x[:: self.every] for x in self.plain[name]], self._residuals[kind], lags)
        if kind in ("x2e", "x3e"):
            return cross_covariance(self._power(name, int(kind[1])), self._residuals[""], lags)
        plain = self._inside(self.plain[name])
        if kind == "|x||e|":
            return cross_covariance([np.abs(x) for x in plain], self._residuals[kind], lags)
        products = [x * r for x, r in zip(plain, self.rest)]
        # nearer lags hold the residual's own colour besides
        first = int(np.ceil(1.5 / self.bandwidth))
        return cross_covariance(products, self._residuals[""], first + lags, first)


def _scatter(drawn: list[tuple[np.ndarray, float]]) -> float:
    """Variance among draws (curves with their spread under independence) over that expected; at least 1."""
    count = len(drawn)
    if count < 2:
        return 1.0
    curves = np.array([curve for curve, _ in drawn])
    return max(1.0, float((curves.var(axis=0, ddof=1)).mean() / np.mean([spread**2 for _, spread in drawn])))


def _as_normal(height: float, dof: float) -> float:
    """Height in standard deviations that is as rare as one in estimated ones (Student)."""
    from scipy.stats import norm, t

    return height if not np.isfinite(dof) else float(min(norm.isf(t.sf(height, dof)), 37.0))


def _as_student(height: float, dof: float) -> float:
    from scipy.stats import norm, t

    return height if not np.isfinite(dof) else float(t.isf(norm.sf(height), dof))


def _filtered(x: Parts, filters: list[Any]) -> list[np.ndarray]:
    return [filtered(part, f) for part, f in zip(x, filters)]


def _linear(motion: np.ndarray, inputs: list[np.ndarray], spacing: int, count: int) -> np.ndarray:
    """A constant, the motion, and inputs shifted by multiples of the spacing; the rows where all exist."""
    pad = count * spacing
    rows = len(motion) - 2 * pad
    shifted = [x[k * spacing : k * spacing + rows] for x in inputs for k in range(2 * count + 1)]
    return np.column_stack([np.ones(rows), motion[pad : pad + rows], *shifted])


def _orthonormal(columns: np.ndarray) -> np.ndarray:
    """Orthonormal basis of columns of any scale, dependent ones left out."""
    size = np.sqrt(np.einsum("ij,ij->j", columns, columns))
    columns = columns[:, size > 0] / size[size > 0]
    values, vectors = np.linalg.eigh(columns.T @ columns)
    keep = values > 1e-10 * values[-1]
    return columns @ (vectors[:, keep] / np.sqrt(values[keep]))


def _bandwidth(x: Parts) -> float:
    """Share of the frequency axis that a signal fills, ``(sum I)^2 / (M sum I^2)`` of its periodogram (1 for white)."""
    top = bottom = 0.0
    for part in x:
        power = np.abs(np.fft.rfft(part - part.mean())) ** 2
        top, bottom = top + float(power.sum() ** 2) / len(power), bottom + float(power @ power)
    return min(1.0, 2 * top / bottom) if bottom > 0 else 1.0


def _reference(side: _Side, noise: list[_Side]) -> list[np.ndarray]:
    """Spectrum that noise alone would have, for each record: of the draws, else of the filter."""
    if noise:
        from scipy.signal import welch

        parts = [e for s in noise for e in s.whole]
        size = min(512, min(map(len, parts)))
        density = np.mean([welch(e, nperseg=size)[1] for e in parts], axis=0)
        grid = np.linspace(0, 1, len(density))
        return [np.interp(np.linspace(0, 1, len(e) // 2 + 1), grid, density) for e in side.whole]
    return [_response(f, len(e)) for f, e in zip(side.filters, side.whole)]


def _fit(density: list[np.ndarray], parts: Parts) -> list[np.ndarray]:
    """Reference spectra on the frequencies of records that may be some samples shorter."""
    return [np.interp(np.linspace(0, 1, len(e) // 2 + 1), np.linspace(0, 1, len(d)), d) for d, e in zip(density, parts)]


def _response(filter: Any, n: int) -> np.ndarray:
    if filter is None or filter.sos is None:
        return np.ones(n // 2 + 1)
    from scipy.signal import sosfreqz

    _, h = sosfreqz(filter.sos, worN=np.linspace(0, np.pi, n // 2 + 1))
    return np.abs(h) ** 4


Parts = Sequence[np.ndarray]


@dataclass
class Cross:
    r"""Cross-covariance of two signals and what it would be if they were independent.

    Attributes
    ----------
    lag : ndarray of int
        tau, samples; positive where x leads y.
    total : ndarray
        ``sum_t x(t) y(t + tau)``.
    spread : float
        Standard deviation of ``total`` under independence by Bartlett's formula,
        ``Var = N sum_k gamma_x(k) gamma_y(k)``. It holds for signals of any colour: a filtered
        signal needs no whitening.
    energy : float
        ``sqrt(sum x^2 sum y^2)``.
    omega : float
        Rms angular frequency (rad per sample) of ``total`` under independence, as a function of the lag.
    """

    lag: np.ndarray
    total: np.ndarray
    spread: float
    energy: float
    omega: float

    @property
    def moves(self) -> bool:
        """Whether both signals move."""
        return self.spread > 0 and self.energy > 0


class Signal:
    """Contiguous records of one signal, means taken off, with their Fourier transforms.

    Parameters
    ----------
    parts : sequence of ndarray
        One for each record.

    Attributes
    ----------
    sizes : list of (int, int)
        Samples and length of the zero-padded transform of each record.
    spectra : list of ndarray of complex
    power : list of ndarray
        Their squared magnitudes.
    energy : float
        Sum of the squares.
    """

    def __init__(self, parts: Parts) -> None:
        from scipy.fft import next_fast_len, rfft

        centred = [x - x.mean() for x in parts]
        self.sizes = [(len(x), next_fast_len(2 * len(x), real=True)) for x in centred]
        self.spectra = [rfft(x, size) for x, (_, size) in zip(centred, self.sizes)]
        self.power = [X.real**2 + X.imag**2 for X in self.spectra]
        self.energy = float(sum(x @ x for x in centred))


def cross_covariance(x: Parts | Signal, y: Parts | Signal, lags: int, first: int | None = None) -> Cross:
    """Cross-covariance of two signals over contiguous records, means taken off."""
    from scipy.fft import irfft

    x, y = (s if isinstance(s, Signal) else Signal(s) for s in (x, y))
    lag = np.arange(-lags if first is None else first, lags + 1)
    total, variance, slope = np.zeros(lag.size), 0.0, 0.0
    for X, Y, p, q, (count, size) in zip(x.spectra, y.spectra, x.power, y.power, x.sizes):
        total += irfft(X.conj() * Y, size)[lag]
        # the sum over lags of both autocovariances is the sum over frequencies of both periodograms
        both = p * q / (size * count)
        both[1:] *= 2
        variance += both.sum()
        slope += np.linspace(0, np.pi, both.size) ** 2 @ both
    omega = np.sqrt(slope / variance) if variance > 0 else 0.0
    return Cross(lag, total, float(np.sqrt(variance)), float(np.sqrt(x.energy * y.energy)), float(omega))


def probability_of_peak(height: float, n_lags: int, omega: float) -> float:
    """Probability that the correlation of independent signals exceeds a height at any lag."""
    from scipy.special import ndtr

    single = 2 * float(ndtr(-height))
    further = min(omega / np.pi * np.exp(-(height**2) / 2), single)
    return float(-np.expm1(np.log1p(-min(single, 1 - 1e-16)) - (n_lags - 1) * further))


def peak_limit(level: float, n_lags: int, omega: float) -> float:
    """Height, in standard deviations, that :func:`probability_of_peak` gives the probability ``level``."""
    from scipy.optimize import brentq

    return float(brentq(lambda h: probability_of_peak(h, n_lags, omega) - level, 1e-3, 40.0))


def whitened_autocorrelation(parts: Parts, density: Sequence[np.ndarray], lags: int) -> tuple[np.ndarray, int]:
    r"""Autocorrelation of a signal after division of its spectrum by a reference, in the reference's band alone."""
    lag = np.arange(1, lags + 1)
    top, bottom, n = np.zeros(lags), 0.0, 0
    for e, S in zip(parts, density):
        ratio = np.abs(np.fft.rfft(e - e.mean()))[1:] ** 2
        S = S[1:]
        inside = np.flatnonzero(S > 0.25 * S.max())
        ratio = ratio[inside] / S[inside]
        k = (np.arange(len(ratio)) + 0.5) / len(ratio)
        top += np.cos(np.pi * np.outer(lag, k)) @ ratio
        bottom += ratio.sum()
        n += 2 * len(ratio)
    return (top / bottom if bottom > 0 else top), n
