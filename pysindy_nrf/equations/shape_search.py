"""Shape parameters of laws by variable projection: coefficients eliminated on Gram
matrices.
"""

import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.optimize import minimize, minimize_scalar
from scipy.signal import find_peaks

from ..chain.layout import LawLayout, Layout
from ..chain.sites import Site
from ..exceptions import IdentifiabilityError, LawError, RankWarning
from ..laws.shape import Scales, Shape, ShapeScale
from ..records.dataset import Dataset, Segment, half_the_rate
from .balances import blocks_of_segment
from .chain_solve import Solution

_SCAN = 13
# Part of the spacing 1/T of the frequencies that a record of T seconds tells apart
# within which a line is looked for, and with which the refinement begins.
_WITHIN, _STEP = 0.6, 0.1

Free = list[tuple[Site, int, Shape]]
Solve = Callable[[LawLayout], tuple[Any, Any]]


def estimate_shapes(
    layout: LawLayout,
    scales: Mapping[Site, Scales],
    solve: Solve,
    data: Dataset,
    filters: Sequence[Any],
) -> LawLayout:
    """Values for every shape parameter that has none."""
    search = ShapeSearch(layout, scales, solve, half_the_rate(data.segments))
    unheard = [place for place in search.free if search.heard(place)]
    for k in sorted(
        range(len(search.free)), key=lambda k: search.heard(search.free[k])
    ):
        place = search.free[k]
        if search.heard(place):
            lines = _lines(
                search.trial(search.u), unheard, place[0], solve, data, filters
            )
            unheard = [other for other in unheard if other is not place]
            if search.tune(k, lines, scales[place[0]][2]):
                continue
        search.scan(k, np.linspace(search.low[k], search.high[k], _SCAN))
    return search.refined()


class ShapeSearch:
    """The shape parameters without a value, and where their search stands."""

    def __init__(
        self,
        layout: LawLayout,
        scales: Mapping[Site, Scales],
        solve: Any = None,
        fastest: float = np.inf,
    ) -> None:
        self.layout, self.solve, self._fastest = layout, solve, fastest
        self.free: Free = [
            (site, i, p)
            for site, held in layout.laws.items()
            for i, law in enumerate(held)
            for p in law.shapes
            if law.shape[p.name] is None
        ]
        self.scale = ShapeScale(
            [p for *_, p in self.free],
            [scales[site] for site, *_ in self.free],
            fastest,
        )
        self.low, self.high = self.scale.low, self.scale.high
        self.u = 0.5 * (self.low + self.high)
        self.step = (self.high - self.low) / (_SCAN - 1)

    def heard(self, place: tuple[Site, int, Shape]) -> bool:
        """Whether a parameter is a frequency that is looked for in the records."""
        return bool(np.isfinite(self._fastest)) and place[2].is_frequency

    def trial(self, u: np.ndarray) -> LawLayout:
        """The laws with shape parameters at a point of the search."""
        laws = {site: list(held) for site, held in self.layout.laws.items()}
        for (site, i, p), value in zip(
            self.free, self.scale.values(np.clip(u, self.low, self.high))
        ):
            laws[site][i] = laws[site][i].with_values(shape={p.name: float(value)})
        return LawLayout(self.layout.chain, laws)

    def cost(self, u: np.ndarray) -> float:
        """Sum of the squared shares that the steps leave unexplained."""
        try:
            with warnings.catch_warnings(action="ignore", category=RankWarning):
                solution, _ = self.solve(self.trial(u))
        except (
            IdentifiabilityError,
            LawError,
        ):  # no answer for these values, e.g. a loop like a spring
            return np.inf
        return float(sum(fit.share**2 for fit in solution.fits))

    def at(self, k: int, value: float) -> np.ndarray:
        """Where the search stands, but for one parameter."""
        u = self.u.copy()
        u[k] = value
        return u

    def scan(self, k: int, points: np.ndarray) -> None:
        """Go to the best of some values of one parameter."""
        self.u[k] = points[
            int(np.argmin([self.cost(self.at(k, point)) for point in points]))
        ]

    def tune(self, k: int, lines: Sequence[float], duration: float) -> bool:
        """Go to the best of some frequencies, Hz, and to the bottom of its valley;
        False if none is within bounds.
        """
        points = self.scale.point(np.array(lines, dtype=float), k)
        points = points[(points >= self.low[k]) & (points <= self.high[k])]
        if not len(points):
            return False
        self.scan(k, points)
        apart = (
            1.0
            / duration
            / (self.scale.values(self.u)[k] if self.scale.log[k] else 1.0)
        )
        ends = self.u[k] + _WITHIN * apart * np.array([-1.0, 1.0])
        best = minimize_scalar(
            lambda value: min(self.cost(self.at(k, value)), 1e6),
            bounds=ends,
            method="bounded",
            options={"xatol": 1e-3 * apart, "maxiter": 20},
        )
        if best.fun < self.cost(self.u):
            self.u[k] = best.x
        self.step[k] = _STEP * apart
        return True

    def refined(self) -> LawLayout:
        """All parameters refined together, from where the search stands."""
        away = np.where(self.u + 0.5 * self.step > self.high, -self.step, self.step)
        best = minimize(
            self.cost,
            self.u,
            method="Nelder-Mead",
            bounds=list(zip(self.low, self.high)),
            options={
                "initial_simplex": np.vstack([self.u, self.u + np.diag(0.5 * away)]),
                "xatol": 1e-10,
                "fatol": 1e-18,
                "maxfev": 120 * len(self.free),
            },
        )
        return self.trial(best.x)


def _lines(
    layout: LawLayout,
    unheard: Free,
    site: Site,
    solve: Solve,
    data: Dataset,
    filters: Sequence[Any],
) -> list[float]:
    """Frequencies, Hz, that the balance at a site lacks without the laws whose
    frequency is not known yet.
    """
    known = [
        i
        for i, seg in enumerate(data.segments)
        if seg.dt and not np.isnan(seg.F[seg.valid.start, site.p - 1])
    ]
    if not known:
        return []
    longest = max(
        known, key=lambda i: data.segments[i].valid.stop - data.segments[i].valid.start
    )
    try:
        with warnings.catch_warnings(action="ignore", category=RankWarning):
            solution, _ = solve(layout)
    except (IdentifiabilityError, LawError):
        return []
    # their coefficients are left out, the others stay what they are
    out, laws, coefficients = {(place, i) for place, i, _ in unheard}, {}, {}
    for place, held in layout.laws.items():
        parts = np.split(
            solution.coefficients[place],
            np.cumsum([len(law.terms()) for law in held])[:-1],
        )
        kept = [
            (law, part)
            for i, (law, part) in enumerate(zip(held, parts))
            if (place, i) not in out
        ]
        laws[place] = tuple(law for law, _ in kept)
        coefficients[place] = np.concatenate([np.zeros(0), *(part for _, part in kept)])
    without, left = (
        LawLayout(layout.chain, laws),
        Solution(solution.masses, coefficients),
    )
    seg, filter = data.segments[longest], filters[longest]
    blocks = blocks_of_segment(
        seg, without, filter=filter, states={} if filter is None else None
    )
    rows = np.hstack(
        [np.vstack([b.terms, b.acceleration, np.nan_to_num(b.force)]) for b in blocks]
    )
    return balance_lines(
        rows,
        without,
        left,
        site.p,
        seg.step,
        site.p in data.forced,
        False,
        driven_at(seg),
    )


# Share of a drive's power in one line that makes a test harmonic; bins of the record a
# line is wide.
_ONE_LINE = 0.6
_BINS = 4.0
# Lines tried of each kind; frequencies at which the columns are looked at for it, in
# halves of a bin of the record.
_MOST, _LOOKED_AT, _PADDED = 3, 2000, 2


def driving_frequency(drive: np.ndarray, dt: float) -> float:
    """Frequency of a test that is driven by one line, Hz; NaN if the drive is anything
    else.
    """
    drive = drive - drive.mean(axis=1, keepdims=True)
    power = (np.abs(np.fft.rfft(drive * np.hanning(drive.shape[1]))) ** 2).sum(axis=0)
    top = int(np.argmax(power))
    if not power[max(top - 3, 0) : top + 4].sum() > _ONE_LINE * power.sum():
        return float("nan")
    return top / (drive.shape[1] * dt)


def spectral_lines(
    residual: np.ndarray, dt: float, most: int = _MOST, driven: float = float("nan")
) -> list[float]:
    """Frequencies at which a residual has its highest peaks, Hz, by the periodogram of
    a Hann window.
    """
    n, size = len(residual), 4 * len(residual)
    power = np.abs(np.fft.rfft(residual * np.hanning(n), size)) ** 2
    peaks, _ = find_peaks(power, distance=8)
    peaks = peaks[_away(peaks / (size * dt), driven) * n * dt > _BINS]
    return [
        float(k / (size * dt)) for k in peaks[np.argsort(-power[peaks])][:most] if k > 0
    ]


def hidden_lines(
    columns: Sequence[np.ndarray], target: np.ndarray, dt: float, driven: float
) -> list[float]:
    """Frequencies without which a refitted balance closes best, Hz."""
    rows = np.vstack([*columns, target])
    n = rows.shape[1]
    seen = int(np.count_nonzero(rows.any(axis=0)))
    size = np.sqrt(np.mean(rows**2, axis=1, keepdims=True))
    rows /= np.where(size > 0, size, 1.0)
    gram = rows @ rows.T
    lines = np.empty((len(rows), _PADDED * n // 2 + 1), dtype=np.complex64)
    for row, line in zip(
        rows, lines
    ):  # one at a time: padded, the rows of long records are large
        line[:] = np.fft.rfft(row, _PADDED * n)
    values, vectors = np.linalg.eigh(gram)
    use = values > 1e-12 * values[-1]
    leverage: Any = sum(
        np.abs(y @ lines) ** 2
        for y in (vectors[:, use] / np.sqrt(values[use])).T.astype(np.float32)
    )
    bins = np.arange(1, len(leverage))
    bins = bins[_away(bins / (_PADDED * n * dt), driven) * n * dt > _BINS]
    bins = bins[np.argsort(-leverage[bins])][:_LOOKED_AT]
    # a sine and a cosine of each frequency, taken out of all columns
    near = lines[:, bins].T.astype(complex)
    left = gram - (2.0 / max(seen, 1)) * (near[:, :, None] * near[:, None].conj()).real
    x, xy = left[:, :-1, :-1], left[:, :-1, -1:]
    rest = left[:, -1, -1] - (
        xy * (np.linalg.pinv(x, rcond=1e-12, hermitian=True) @ xy)
    ).sum(axis=(1, 2))
    found: list[int] = []
    for k in bins[np.argsort(rest)].tolist():
        if len(found) < _MOST and all(abs(k - other) > _PADDED for other in found):
            found.append(k)
    return [k / (_PADDED * n * dt) for k in found]


def balance_lines(
    rows: np.ndarray,
    layout: Layout,
    solution: Solution,
    dof: int,
    dt: float,
    scaled: bool,
    weighed: bool,
    driven: float = float("nan"),
) -> list[float]:
    """Frequencies at which a force may be missing from one balance, Hz: lines of its
    residual, and hidden ones.
    """
    a, force = (
        rows[layout.n_terms + dof - 1],
        rows[layout.n_terms + layout.n_dof + dof - 1],
    )
    left = solution.masses[dof] * a - force
    own: list[np.ndarray] = []
    others: list[np.ndarray] = []
    for site in layout.group((dof,)).sites:
        columns = rows[layout.slices[site]]
        left = left + site.incidence(dof) * (solution.coefficients[site] @ columns)
        (own if str(site) == f"storey {dof}" else others).append(columns)
    free = [*own, *others, *([] if weighed else [a[None]])] if scaled else own
    found = spectral_lines(left, dt, driven=driven)
    return found + hidden_lines(free, left, dt, driven) if free else found


def driven_at(segment: Segment, rows: slice = slice(None)) -> float:
    """Frequency of a harmonic test, Hz; NaN for any other."""
    drive = np.nan_to_num(segment.F[segment.valid][rows].T.astype(float))
    drive = drive[drive.any(axis=1)]
    if not len(drive) and segment.ag is not None:
        drive = segment.ag[segment.valid].astype(float)[None, rows]
    return driving_frequency(drive, segment.dt) if len(drive) and segment.dt else np.nan


def _away(f: np.ndarray, driven: float) -> np.ndarray:
    """Distance from the multiples of a frequency, Hz."""
    if not 0.0 < driven < np.inf:
        return np.full(len(f), np.inf)
    return np.abs(f / driven - np.round(f / driven)) * driven
