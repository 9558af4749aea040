r"""What the noise is: of the motion by frequency, of the force as a level; and the force as the motion knows it.

The free run of a model under the measured force u misses the measured motion by

.. math:: R(f) = E_x(f) - G(f) E_u(f) ,

noise of the motion, and noise of the force that rings in the structure (G: the model, linearised along its
run). With the covariance S = Sigma_x + G Sigma_u G^* of R the best estimate of the force is

.. math:: \hat u = u + \Sigma_u G^* S^{-1} R ,

and its error is uncorrelated with R (errors-in-variables maximum likelihood; Soederstrom, Errors-in-variables
methods in system identification, 2007). What is simulated from it can therefore serve as an instrument at every
frequency, whatever the weights. Spectra are densities, unit^2/Hz.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..regression.blocks_of_samples import whole_block
from ..regression.chain_model import ChainModel
from ..regression.gram_pass import rows_of
from ..regression.layout import Group, LawLayout
from ..regression.segments import Segment, SegmentSet
from ..signals.spline_fusion import white_level
from ..signals.zero_phase_filter import Band
from .runs import likeness_of, run_of, steady

BINS = 28
HELD = 5e-4  # share of the drifts' power below the lowest line used, and of the accelerations' above the highest
FEWEST = 12  # lines in a bin
LEAST = 0.1  # of what is missed in a bin that is noise of the motion at least
LINES = 4096  # treated at a time, so that memory stays flat
_LN2 = float(np.log(2.0))  # median over mean of an exponential variable


@dataclass
class Smooth:
    """Spectra that vary slowly with frequency.

    Attributes
    ----------
    f : ndarray of shape (n_bins,)
        Hz.
    values : ndarray of shape (n_bins, p)
    """

    f: np.ndarray
    values: np.ndarray

    def __call__(self, f: np.ndarray) -> np.ndarray:
        """Values at frequencies, shape (len(f), p); constant beyond the ends."""
        at = np.log(np.maximum(f, 1e-300))
        tiny = 1e-300
        logs = np.log(np.maximum(self.values, tiny))
        return np.exp(np.column_stack([np.interp(at, np.log(self.f), y) for y in logs.T]))


@dataclass
class NoiseModel:
    """Noise of motions and forces, and the structure between them.

    Attributes
    ----------
    matrices : tuple of ndarray of shape (n_dof, n_dof)
        Mass, damping and stiffness of the model, linearised along its run.
    motion : Smooth
        Density of the noise of the relative velocity of every DOF.
    force : ndarray of shape (n_dof + 1,)
        Density of the white noise of every force, and of the base acceleration.
    share : Smooth
        Share of the simulated motion's density, by DOF, that the force's noise did not make.
    lively : (float, float)
        Hz; the run moves in between, and what the motions were put through lets it pass: only there the model is asked.
    """

    matrices: tuple[np.ndarray, np.ndarray, np.ndarray]
    motion: Smooth
    force: np.ndarray
    share: Smooth
    lively: tuple[float, float]

    def transfer(self, f: np.ndarray) -> np.ndarray:
        """Relative velocities from forces and base acceleration, shape (len(f), n_dof, n_dof + 1)."""
        return transfer(self.matrices, f)

    def blocks(self, f: np.ndarray) -> Iterator[tuple[slice, np.ndarray, np.ndarray]]:
        """Rows of f, the transfer G there and the covariance S of what the free run misses."""
        for start in range(0, len(f), LINES):
            rows = slice(start, start + LINES)
            G = self.transfer(f[rows])
            S = (G * self.force) @ G.conj().transpose(0, 2, 1)
            diagonal = np.arange(S.shape[1])
            S[:, diagonal, diagonal] += self.motion(f[rows])
            yield rows, G, S


def common_band(data: Sequence[Segment], band: Band = None) -> tuple[float, float]:
    """Frequencies that all records still hold, Hz."""
    bands = [b for b in (band, *(seg.band for seg in data)) if b is not None]
    low = max((lo for lo, _ in bands if lo is not None), default=0.0)
    high = min((hi for _, hi in bands if hi is not None), default=np.inf)
    return float(low), float(high)


def linearised(
    model: ChainModel, layout: LawLayout, runs: Sequence[Segment]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mass, damping and stiffness matrices that come nearest to the forces along free runs."""
    n = model.n_dof
    C, K = np.zeros((n, n)), np.zeros((n, n))
    theta = model.coefficients
    for site in layout.acting:
        if site.kind == "dof":
            continue
        gram, right = np.zeros((2, 2)), np.zeros(2)
        for run in runs:
            motion = run.motion(site, run.valid)
            both = np.stack([motion.v, motion.s])
            gram += both @ both.T
            right += both @ (layout.columns(site, motion) @ theta[site])
        size = np.sqrt(np.diag(gram))
        size[size == 0] = 1.0
        c, k = np.linalg.lstsq(gram / size[:, None] / size, right / size, rcond=1e-12)[0] / size
        ends = np.array([site.incidence(j) for j in range(1, n + 1)], dtype=float)
        C, K = C + c * np.outer(ends, ends), K + k * np.outer(ends, ends)
    return np.diag(model.masses), C, K


def transfer(matrices: Sequence[np.ndarray], f: np.ndarray) -> np.ndarray:
    """Relative velocities from forces and base acceleration, shape (len(f), n_dof, n_dof + 1)."""
    M, C, K = matrices
    w = 2 * np.pi * np.asarray(f)[:, None, None]
    H = np.linalg.inv(K + 1j * w * C - w**2 * M)
    return 1j * w * np.concatenate([H, -H @ M.sum(axis=1)[None, :, None]], axis=2)


def lines_of(segment: Segment) -> np.ndarray:
    """Frequencies of a record's Fourier lines but the first, Hz."""
    return np.fft.rfftfreq(segment.n_valid, segment.step)[1:]


def spectrum(values: np.ndarray, dt: float, taper: bool = False) -> np.ndarray:
    """Fourier lines of columns but the first, scaled so that |.|^2 is a density (both sides)."""
    n = len(values)
    if taper:
        values = values * (np.sqrt(2 / 3) * (1 - np.cos(2 * np.pi * (np.arange(n) + 0.5) / n)))[:, None]
    return np.fft.rfft(values, axis=0)[1:] * np.sqrt(dt / n)


def velocities(segment: Segment) -> np.ndarray:
    """Velocities of the DOFs relative to the base, shape (n_valid_rows, n_dof)."""
    return np.cumsum(segment.v[segment.valid], axis=1, dtype=float)


def smoothed(f: Sequence[np.ndarray], density: Sequence[np.ndarray], typical: bool = False) -> Smooth:
    """Densities of several records averaged over bins of equal width in log f."""
    at, values = np.concatenate(f), np.concatenate(density)
    order = np.argsort(at, kind="stable")
    at, values = at[order], values[order]
    wanted = np.searchsorted(at, np.geomspace(at[0], at[-1], BINS + 1)[1:-1])
    edges = [0]
    for edge in wanted:
        if edge - edges[-1] >= FEWEST and len(at) - edge >= FEWEST:
            edges.append(int(edge))
    edges.append(len(at))
    pairs = list(zip(edges[:-1], edges[1:]))
    middle = np.array([np.exp(np.log(at[lo:hi]).mean()) for lo, hi in pairs])
    if typical:
        return Smooth(middle, np.array([np.median(values[lo:hi], axis=0) for lo, hi in pairs]) / _LN2)
    return Smooth(middle, np.array([values[lo:hi].mean(axis=0) for lo, hi in pairs]))


def noise_model(
    model: ChainModel, layout: LawLayout, data: Sequence[Segment], runs: Sequence[Segment]
) -> NoiseModel | None:
    """Noise of motions and forces, from what free runs under the measured forces miss."""
    n = model.n_dof
    matrices = linearised(model, layout, runs)
    every = [lines_of(seg) for seg in data]
    R = [spectrum(velocities(seg) - velocities(run), seg.step, taper=True) for seg, run in zip(data, runs)]
    V = [spectrum(velocities(run), run.step, taper=True) for run in runs]
    missed, whole = (np.sqrt(sum((np.abs(y) ** 2).sum(axis=0) for y in part)) for part in (R, V))
    if not np.all(missed > 1e-6 * whole):
        return None
    force = np.array([_force_density(data, j) for j in range(n + 1)])
    low, high = common_band(data)
    lively = _lively(every, V, [_ringing(matrices, lines, force) for lines in every])
    lively = max(lively[0], low), min(lively[1], high)
    inside = [(f >= lively[0]) & (f <= lively[1]) for f in every]
    f, R, V = ([y[use] for y, use in zip(part, inside)] for part in (every, R, V))
    if sum(map(len, f)) < 2 * FEWEST:
        return None
    floor = 1e-12 * (whole**2 / sum(map(len, f)))
    motion = smoothed(f, [np.abs(r) ** 2 for r in R], typical=True)
    floor = np.maximum(floor, LEAST * motion.values)
    motion.values = np.maximum(motion.values, floor)
    for _ in range(2):
        force = np.minimum(force, _heard(matrices, f, R, motion, force > 0))
        ringing = [_ringing(matrices, lines, force) for lines in f]
        motion = smoothed(f, [np.abs(r) ** 2 - _LN2 * q for r, q in zip(R, ringing)], typical=True)
        motion.values = np.maximum(motion.values, floor)
    own, made = smoothed(f, [np.abs(v) ** 2 for v in V]), smoothed(f, ringing)
    share = Smooth(own.f, np.clip(1 - made.values / np.maximum(own.values, 1e-300), 1e-6, 1.0))
    return NoiseModel(matrices, motion, force, share, lively)


def _lively(f: Sequence[np.ndarray], V: Sequence[np.ndarray], ringing: Sequence[np.ndarray]) -> tuple[float, float]:
    """Frequencies between which nearly all of the run's drift (below) and acceleration (above) lies."""
    at = np.sort(np.concatenate(f), kind="stable")
    own, made = (smoothed(f, part)(at) for part in ([np.abs(v) ** 2 for v in V], ringing))
    ends = []
    for weight, share in ((at**-2.0, HELD), (at**2, 1 - HELD)):
        whole = own * weight[:, None]
        signal = np.maximum(own - made, 0) * weight[:, None]
        # a force that is white itself looks like noise throughout: then its motion counts as it is
        good = signal.sum(axis=0) > 0.5 * whole.sum(axis=0)
        power = np.where(good, signal, whole)
        total = np.cumsum((power / np.maximum(power.sum(axis=0), 1e-300)).sum(axis=1))
        ends.append(float(at[min(np.searchsorted(total, share * total[-1]), len(at) - 1)]))
    return ends[0], ends[1]


def _force_density(data: Sequence[Segment], j: int) -> float:
    """Density of the white noise that the differences of a force allow; 0 where it is none."""
    found = []
    for seg in data:
        line = seg.ag if j == seg.n_dof else seg.F[:, j]
        if line is not None and np.any(line[seg.valid]):
            found.append(white_level(line[seg.valid].astype(float)) ** 2 * seg.step)
    return float(np.mean(found)) if found else 0.0


def _ringing(matrices: Sequence[np.ndarray], f: np.ndarray, force: np.ndarray) -> np.ndarray:
    out = np.empty((len(f), len(matrices[0])))
    for start in range(0, len(f), LINES):
        rows = slice(start, start + LINES)
        out[rows] = (np.abs(transfer(matrices, f[rows])) ** 2) @ force
    return out


def _heard(
    matrices: Sequence[np.ndarray],
    f: Sequence[np.ndarray],
    R: Sequence[np.ndarray],
    motion: Smooth,
    noisy: np.ndarray,
) -> np.ndarray:
    """Upper bound of every force's noise density from what the motion heard of it."""
    bound = np.full(len(noisy), np.inf)
    if not noisy.any():
        return bound
    sizes, blurs = [], []
    for lines, r in zip(f, R):
        for start in range(0, len(lines), LINES):
            rows = slice(start, start + LINES)
            G = transfer(matrices, lines[rows])[:, :, noisy]
            W = G.conj().transpose(0, 2, 1) / motion(lines[rows])[:, None, :]
            inverse = np.linalg.pinv(W @ G, hermitian=True)
            sizes.append(np.abs((inverse @ (W @ r[rows][:, :, None]))[:, :, 0]) ** 2)
            blurs.append(np.einsum("ijj->ij", inverse).real)
    size, blur = np.concatenate(sizes), np.concatenate(blurs)
    for i, j in enumerate(np.flatnonzero(noisy)):
        clear = blur[:, i] <= np.quantile(blur[:, i], min(1.0, max(0.1, 2 * FEWEST / len(blur))))
        bound[j] = np.median(size[clear, i]) / _LN2
    return bound


def corrected(segment: Segment, run: Segment, noise: NoiseModel) -> Segment:
    """The record with the force (and base acceleration) as the motion knows it."""
    from dataclasses import replace

    rows, n = segment.valid, segment.n_dof
    f = lines_of(segment)
    first, last = np.searchsorted(f, noise.lively, side="left")
    R = spectrum(velocities(segment) - velocities(run), segment.step)[first:last]
    more = np.zeros((len(f) + 1, n + 1), dtype=complex)
    for part, G, S in noise.blocks(f[first:last]):
        found = G.conj().transpose(0, 2, 1) @ np.linalg.solve(S, R[part][:, :, None])
        more[1 + first : 1 + last][part] = noise.force * found[:, :, 0]
    length = rows.stop - rows.start
    # the free run missed E_x - G E_u: the force's own noise is minus what it heard
    more = np.fft.irfft(more, length, axis=0) / np.sqrt(segment.step / length)
    F = np.array(segment.F, dtype=float)
    F[rows] += more[:, :n]
    ag = segment.ag
    if ag is not None:
        ag = np.array(ag, dtype=float)
        ag[rows] += more[:, n]
    return replace(segment, F=F, ag=ag)


@dataclass
class Whitener:
    """A zero-phase filter of given amplitude, the same for every row of a balance.

    The record is mirrored at its ends (a cosine transform does that), so nothing is taken to be periodic.

    Attributes
    ----------
    weight : Smooth
        Squared amplitude by frequency, one column.
    band : (float or None, float or None)
        Hz; zero outside.
    """

    weight: Smooth
    band: tuple[float | None, float | None] = (None, None)

    def amplitude(self, f: np.ndarray) -> np.ndarray:
        """Amplitude at frequencies in Hz."""
        low, high = self.band
        inside = (f >= (low or 0.0)) & (f <= (np.inf if high is None else high))
        return np.where(inside, np.sqrt(self.weight(f)[:, 0]), 0.0)

    def apply(self, rows: np.ndarray, dt: float) -> np.ndarray:
        """Filter rows of one record."""
        from scipy.fft import dct, idct

        n = rows.shape[1]
        return idct(dct(rows, axis=1) * self.amplitude(np.arange(n) / (2 * n * dt)), axis=1)


@dataclass
class Weighting:
    """What a weighted round of instrumental variables needs.

    Attributes
    ----------
    runs : list of Segment or None
        Free runs under the corrected forces.
    likeness : float
        Their correlation with the measured accelerations.
    whiteners : dict of tuple of int to Whitener
        By the DOFs of the group.
    """

    runs: list[Segment | None]
    likeness: float
    whiteners: dict[tuple[int, ...], Whitener]


def weighting_of(
    model: ChainModel,
    data: SegmentSet,
    usable: Sequence[int],
    layout: LawLayout,
    groups: Sequence[Group],
    filters: Sequence[Any],
    known_masses: Mapping[int, float],
    band: Any = None,
) -> Weighting | None:
    """Instruments and weights from a model."""
    segments = [data.segments[i] for i in usable]
    runner = steady(model)
    plain = [run_of(runner, seg) for seg in segments]
    noise = noise_model(runner, layout, segments, plain)
    resolved = [seg.resolved for seg in segments if seg.resolved is not None]
    if noise is None or min(resolved, default=np.inf) < noise.lively[1]:
        return None
    better = [corrected(seg, run, noise) for seg, run in zip(segments, plain)]
    found = [run_of(runner, seg) for seg in better]
    likeness = likeness_of(segments, found)
    # the forces of the balances stay as measured: only the motion under the corrected ones is taken
    runs: list[Segment | None] = [None] * len(data.segments)
    for i, run in zip(usable, found):
        runs[i] = run
    low, high = common_band(segments, band)
    low, high = max(low, noise.lively[0]), min(high, noise.lively[1])
    whiteners = _whiteners(model, segments, layout, groups, [filters[i] for i in usable], known_masses, noise)
    for whitener in whiteners.values():
        whitener.band = (low, high)
    return Weighting(runs, likeness, whiteners)


def _whiteners(
    model: ChainModel,
    segments: Sequence[Segment],
    layout: LawLayout,
    groups: Sequence[Group],
    filters: Sequence[Any],
    known_masses: Mapping[int, float],
    noise: NoiseModel,
) -> dict[tuple[int, ...], Whitener]:
    """Weights: the share of the instruments that is signal, over the density of what the balance misses."""
    missed: dict[tuple[int, ...], list] = {g.dofs: [] for g in groups}
    theta = model.coefficients
    for seg, filter in zip(segments, filters):
        block = whole_block(seg, layout, filter)
        for group in groups:
            rows = rows_of(layout, group, block, known_masses)
            own = [sign * theta[site] for site, sign in zip(group.sites, group.signs)]
            mass = [model.masses[[group.dofs[0] - 1]]] if len(group.dofs) == 1 else []
            gap = rows[-1] - np.concatenate([*own, *mass]) @ rows[:-1]
            f = lines_of(seg)
            use = (f >= noise.lively[0]) & (f <= noise.lively[1])
            missed[group.dofs].append((f[use], np.abs(spectrum(gap[:, None], seg.step, taper=True)[use]) ** 2))
    out = {}
    for dofs, held in missed.items():
        left = smoothed([f for f, _ in held], [p for _, p in held])
        top = left.values.max()
        if top > 0:
            share = noise.share(left.f).mean(axis=1, keepdims=True)
            out[dofs] = Whitener(Smooth(left.f, share / np.maximum(left.values, 1e-9 * top)))
    return out
