r"""Noise spectra of motions, noise levels of forces, the corrected force, and weights
of the balances by frequency.

A model misses the motion by :math:`R(f) = E_x(f) - G(f) E_u(f)` under the measured
force u, G the model linearised along its run, of covariance :math:`S = \Sigma_x + G
\Sigma_u G^*`; its balances leave :math:`e = -G^{-1} R`. The best estimate of the force,
:math:`\hat u = u + \Sigma_u G^* S^{-1} R`, has an error uncorrelated with R
(Soederstrom, Errors-in-variables methods in system identification, 2007), so runs under
it can be instruments. Densities: unit^2/Hz.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import dct, idct

from ..chain.layout import LawLayout
from ..chain.model import ChainModel
from ..records.dataset import Dataset, Segment
from ..records.fusion.noise_levels import white_level
from ..records.zero_phase_filter import Band

BINS = 28
# share of the drifts' power below the lowest line used, and of the accelerations' above
# the highest
EDGE_SHARE = 5e-4
FEWEST = 12  # lines in a bin
LEAST = 0.1  # smallest share of the error in a bin that is noise of the motion
# Least share of what a model misses of a channel that is no force on a floor: a tenth
# of it, squared. (Hidden floors of three_storey_frf and nees_three_storey: 7 to 15 %
# off; 10 to 17 with a hundredth of this, 6 to 18 with ten times it.)
OWN = 0.01
LINES = 4096  # processed at a time; bounds the memory
_LN2 = float(np.log(2.0))  # median over mean of an exponential variable


@dataclass
class Smooth:
    """Spectra that vary slowly with frequency: ``f`` in Hz, ``values`` of shape
    (n_bins, p).
    """

    f: np.ndarray
    values: np.ndarray

    def __call__(self, f: np.ndarray) -> np.ndarray:
        """Values at frequencies, shape (len(f), p); constant beyond the ends."""
        at = np.log(np.maximum(f, 1e-300))
        logs = np.log(np.maximum(self.values, 1e-300))
        return np.exp(
            np.column_stack([np.interp(at, np.log(self.f), y) for y in logs.T])
        )


@dataclass
class NoiseModel:
    """Noise of motions and forces, and the structure between them."""

    # (n_dof, n_dof); mass, damping and stiffness of the model, linearised along its run
    matrices: tuple[np.ndarray, np.ndarray, np.ndarray]
    motion: Smooth  # density of the noise of the relative velocity of every DOF
    # (n_dof + 1,); density of the white noise of every force, and of the base
    # acceleration
    force: np.ndarray
    # share of the simulated motion's density, by DOF, that the force's noise did not
    # make
    share: Smooth
    # hz; frequencies in which the run moves and the filters of the motions pass; only
    # these are used
    signal_band: tuple[float, float]
    channels: tuple[
        str, ...
        # a1, x2, ... whose noise it is; the relative velocities of all DOFs if empty
    ] = ()

    def transfer(self, f: np.ndarray) -> np.ndarray:
        """Channels from forces and base acceleration, shape (len(f), n_channels, n_dof
        + 1).
        """
        return transfer(self.matrices, f, self.channels)

    def of(self, rows: Sequence[int]) -> NoiseModel:
        """The noise of some of the channels."""
        motion = Smooth(self.motion.f, self.motion.values[:, rows])
        return replace(
            self, motion=motion, channels=tuple(self.channels[k] for k in rows)
        )

    def with_model_error(self, segment: Segment, measured: np.ndarray) -> NoiseModel:
        """What a model misses of its channels beyond their white noise, as forces of
        equal power on all floors.
        """
        levels = np.array([white_density(line, segment.step) for line in measured.T])
        (low, high), f, own = self.signal_band, lines_of(segment), self.motion.values
        f = f[(f >= low) & (f <= high)]
        size = (np.abs(self.transfer(f)[:, :, :-1]) ** 2).sum(axis=(0, 2))
        force = self.force.copy()
        force[:-1] += np.mean(
            np.maximum(self.motion(f) - levels, 0.0).sum(axis=0) / size
        )
        return replace(
            self,
            force=force,
            motion=Smooth(self.motion.f, np.clip(levels, OWN * own, own)),
        )

    def blocks(self, f: np.ndarray) -> Iterator[tuple[slice, np.ndarray, np.ndarray]]:
        """Rows of f, the transfer G there and the covariance S of the free run's
        error.
        """
        for start in range(0, len(f), LINES):
            rows = slice(start, start + LINES)
            G = self.transfer(f[rows])
            S = (G * self.force) @ G.conj().transpose(0, 2, 1)
            diagonal = np.arange(S.shape[1])
            S[:, diagonal, diagonal] *= (
                1.0 + 1e-12
            )  # near an undamped resonance rounding makes S singular
            S[:, diagonal, diagonal] += self.motion(f[rows])
            yield rows, G, S


def common_band(data: Sequence[Segment], band: Band = None) -> tuple[float, float]:
    """Frequency band common to all records, Hz."""
    bands = [b for b in (band, *(seg.band for seg in data)) if b is not None]
    low = max((lo for lo, _ in bands if lo is not None), default=0.0)
    return float(low), float(
        min((hi for _, hi in bands if hi is not None), default=np.inf)
    )


def linearised(
    model: ChainModel, layout: LawLayout, runs: Sequence[Segment]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mass, damping and stiffness matrices that fit the forces along free runs best."""
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
        c, k = (
            np.linalg.lstsq(gram / size[:, None] / size, right / size, rcond=1e-12)[0]
            / size
        )
        ends = np.array([site.incidence(j) for j in range(1, n + 1)], dtype=float)
        C, K = C + c * np.outer(ends, ends), K + k * np.outer(ends, ends)
    return np.diag(model.masses), C, K


def transfer(
    matrices: Sequence[np.ndarray], f: np.ndarray, channels: Sequence[str] = ()
) -> np.ndarray:
    """Relative velocities (or channels) from forces and base acceleration, shape
    (len(f), n_dof, n_dof + 1).
    """
    M, C, K = matrices
    w = 2 * np.pi * np.asarray(f)[:, None, None]
    H = np.linalg.inv(K + 1j * w * C - w**2 * M)
    G = 1j * w * np.concatenate([H, -H @ M.sum(axis=1)[None, :, None]], axis=2)
    if not channels:
        return G
    out = np.empty((len(G), len(channels), G.shape[2]), dtype=complex)
    for k, channel in enumerate(channels):
        out[:, k] = (
            G[:, int(channel[1:]) - 1]
            * (1j * w[:, 0]) ** {"x": -1, "v": 0, "a": 1}[channel[0]]
        )
        out[:, k, -1] += channel[0] == "a"  # accelerations are absolute
    return out


def lines_of(segment: Segment) -> np.ndarray:
    """Frequencies of a record's Fourier lines without the first, Hz."""
    return np.fft.rfftfreq(segment.n_valid, segment.step)[1:]


def spectrum(values: np.ndarray, dt: float, taper: bool = False) -> np.ndarray:
    """Fourier lines of columns without the first, scaled so that |.|^2 is a two-sided
    density.
    """
    n = len(values)
    if taper:
        values = (
            values
            * (np.sqrt(2 / 3) * (1 - np.cos(2 * np.pi * (np.arange(n) + 0.5) / n)))[
                :, None
            ]
        )
    return np.fft.rfft(values, axis=0)[1:] * np.sqrt(dt / n)


def velocities(segment: Segment) -> np.ndarray:
    """Velocities of the DOFs relative to the base, shape (n_valid_rows, n_dof)."""
    return np.cumsum(segment.v[segment.valid], axis=1, dtype=float)


def smoothed(
    f: Sequence[np.ndarray], density: Sequence[np.ndarray], typical: bool = False
) -> Smooth:
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
        return Smooth(
            middle,
            np.array([np.median(values[lo:hi], axis=0) for lo, hi in pairs]) / _LN2,
        )
    return Smooth(middle, np.array([values[lo:hi].mean(axis=0) for lo, hi in pairs]))


def unbalanced(
    model: ChainModel, matrices: Sequence[np.ndarray], segment: Segment
) -> np.ndarray:
    """Relative velocities by which a run would miss the motion for what the balances
    leave, (n_valid_rows, n_dof).

    Of a linear model these are the gaps of its free run. That of a nonlinear one may
    lose the motion without any noise.
    """
    left = (
        segment.F[segment.valid]
        - model.balance_forces(Dataset([segment], segment.n_samples))[0]
    )
    f, lines = lines_of(segment), np.fft.rfft(left, axis=0)
    lines[0] = 0.0
    for start in range(0, len(f), LINES):
        rows = slice(start, start + LINES)
        G = transfer(matrices, f[rows])[:, :, : segment.n_dof]
        lines[1:][rows] = -(G @ lines[1:][rows][:, :, None])[:, :, 0]
    return np.fft.irfft(lines, len(left), axis=0)


def noise_model(
    model: ChainModel,
    layout: LawLayout,
    data: Sequence[Segment],
    runs: Sequence[Segment],
    gaps: Sequence[np.ndarray],
    channels: tuple[str, ...] = (),
) -> NoiseModel | None:
    """Noise of motions (or channels) and forces from what a model misses under measured
    forces; None without gaps.
    """
    n = model.n_dof
    matrices = linearised(model, layout, runs)
    every = [lines_of(seg) for seg in data]
    R = [spectrum(gap, seg.step, taper=True) for seg, gap in zip(data, gaps)]
    V = [spectrum(velocities(run), run.step, taper=True) for run in runs]
    missed, whole = (
        np.sqrt(sum((np.abs(y) ** 2).sum(axis=0) for y in part)) for part in (R, V)
    )
    whole = np.full(len(missed), 0.0) if channels else whole
    if not np.all(missed > 1e-6 * whole):
        return None
    force = np.array([_force_density(data, j) for j in range(n + 1)])
    low, high = common_band(data)
    signal_band = _signal_band(
        every, V, [_response_to_force_noise(matrices, lines, force) for lines in every]
    )
    signal_band = max(signal_band[0], low), min(signal_band[1], high)
    inside = [(f >= signal_band[0]) & (f <= signal_band[1]) for f in every]
    f, R, V = ([y[use] for y, use in zip(part, inside)] for part in (every, R, V))
    if sum(map(len, f)) < 2 * FEWEST:
        return None
    floor = 1e-12 * (whole**2 / sum(map(len, f)))
    motion = smoothed(f, [np.abs(r) ** 2 for r in R], typical=True)
    floor = np.maximum(floor, LEAST * motion.values)
    motion.values = np.maximum(motion.values, floor)
    for _ in range(2):
        force = np.minimum(
            force, _force_noise_bound(matrices, f, R, motion, force > 0, channels)
        )
        response = [
            _response_to_force_noise(matrices, lines, force, channels) for lines in f
        ]
        motion = smoothed(
            f, [np.abs(r) ** 2 - _LN2 * q for r, q in zip(R, response)], typical=True
        )
        motion.values = np.maximum(motion.values, floor)
    response = [_response_to_force_noise(matrices, lines, force) for lines in f]
    own, made = smoothed(f, [np.abs(v) ** 2 for v in V]), smoothed(f, response)
    share = Smooth(
        own.f, np.clip(1 - made.values / np.maximum(own.values, 1e-300), 1e-6, 1.0)
    )
    return NoiseModel(matrices, motion, force, share, signal_band, channels)


def _signal_band(
    f: Sequence[np.ndarray], V: Sequence[np.ndarray], response: Sequence[np.ndarray]
) -> tuple[float, float]:
    """Band that holds nearly all of the run's drift (lower edge) and acceleration
    (upper edge), Hz.
    """
    at = np.sort(np.concatenate(f), kind="stable")
    own, made = (
        smoothed(f, part)(at) for part in ([np.abs(v) ** 2 for v in V], response)
    )
    ends = []
    for weight, share in ((at**-2.0, EDGE_SHARE), (at**2, 1 - EDGE_SHARE)):
        whole = own * weight[:, None]
        signal = np.maximum(own - made, 0) * weight[:, None]
        # a white force cannot be told from noise: its motion then counts without
        # correction
        good = signal.sum(axis=0) > 0.5 * whole.sum(axis=0)
        power = np.where(good, signal, whole)
        total = np.cumsum((power / np.maximum(power.sum(axis=0), 1e-300)).sum(axis=1))
        ends.append(
            float(at[min(np.searchsorted(total, share * total[-1]), len(at) - 1)])
        )
    return ends[0], ends[1]


def _force_density(data: Sequence[Segment], j: int) -> float:
    """Density of the white noise of a force; 0 without a force."""
    channels = ((seg, seg.ag if j == seg.n_dof else seg.F[:, j]) for seg in data)
    lines = [
        (line[seg.valid], seg.step)
        for seg, line in channels
        if line is not None and np.any(line[seg.valid])
    ]
    found = [white_density(line, step) for line, step in lines]
    return float(np.mean(found)) if found else 0.0


def white_density(line: np.ndarray, dt: float) -> float:
    """Density of the white noise of a channel, from its differences: high ones hold
    little of the motion.
    """
    return min(white_level(line.astype(float), order) for order in (4, 10)) ** 2 * dt


def _response_to_force_noise(
    matrices: Sequence[np.ndarray],
    f: np.ndarray,
    force: np.ndarray,
    channels: Sequence[str] = (),
) -> np.ndarray:
    out = np.empty((len(f), len(channels) or len(matrices[0])))
    for start in range(0, len(f), LINES):
        rows = slice(start, start + LINES)
        out[rows] = (np.abs(transfer(matrices, f[rows], channels)) ** 2) @ force
    return out


def _force_noise_bound(
    matrices: Sequence[np.ndarray],
    f: Sequence[np.ndarray],
    R: Sequence[np.ndarray],
    motion: Smooth,
    noisy: np.ndarray,
    channels: Sequence[str] = (),
) -> np.ndarray:
    """Upper bound of every force's noise density, from its share in the motion's
    error.
    """
    bound = np.full(len(noisy), np.inf)
    if not noisy.any():
        return bound
    sizes, blurs = [], []
    for lines, r in zip(f, R):
        for start in range(0, len(lines), LINES):
            rows = slice(start, start + LINES)
            G = transfer(matrices, lines[rows], channels)[:, :, noisy]
            W = G.conj().transpose(0, 2, 1) / motion(lines[rows])[:, None, :]
            inverse = np.linalg.pinv(W @ G, hermitian=True)
            sizes.append(np.abs((inverse @ (W @ r[rows][:, :, None]))[:, :, 0]) ** 2)
            blurs.append(np.einsum("ijj->ij", inverse).real)
    size, blur = np.concatenate(sizes), np.concatenate(blurs)
    for i, j in enumerate(np.flatnonzero(noisy)):
        clear = blur[:, i] <= np.quantile(
            blur[:, i], min(1.0, max(0.1, 2 * FEWEST / len(blur)))
        )
        bound[j] = np.median(size[clear, i]) / _LN2
    return bound


def expected(
    noise: NoiseModel, names: tuple[str, ...], gap: np.ndarray, dt: float
) -> np.ndarray:
    """What a run misses of all channels, given what it misses of the measured ones,
    (n_samples, n_names).
    """
    f, R = np.fft.rfftfreq(len(gap), dt), np.fft.rfft(gap, axis=0)
    f[0] = 1e-3 * f[1]
    out = np.empty((len(f), len(names)), dtype=complex)
    for rows, forces in _forces(noise, f, R):
        out[rows] = (transfer(noise.matrices, f[rows], names) @ forces)[:, :, 0]
    return np.fft.irfft(out, len(gap), axis=0)


def _forces(
    noise: NoiseModel, f: np.ndarray, R: np.ndarray
) -> Iterator[tuple[slice, np.ndarray]]:
    """Rows of f, and the forces beside the measured ones that the lines R of what a run
    misses tell there.
    """
    for rows, G, S in noise.blocks(f):
        yield (
            rows,
            noise.force[:, None]
            * (G.conj().transpose(0, 2, 1) @ np.linalg.solve(S, R[rows][:, :, None])),
        )


def corrected(segment: Segment, gap: np.ndarray, noise: NoiseModel) -> Segment:
    """The record with the force (and base acceleration) corrected by what a model
    misses of the measured motion.
    """
    rows, n = segment.valid, segment.n_dof
    f = lines_of(segment)
    first, last = np.searchsorted(f, noise.signal_band, side="left")
    R = spectrum(gap, segment.step)[first:last]
    more = np.zeros((len(f) + 1, n + 1), dtype=complex)
    for part, forces in _forces(noise, f[first:last], R):
        more[1 + first : 1 + last][part] = forces[:, :, 0]
    length = rows.stop - rows.start
    # the free run misses E_x - G E_u, so the estimated noise of the force enters with a
    # minus sign
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
    """A zero-phase filter of given squared amplitude in a band (Hz), the same for every
    row of a balance.
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
        n = rows.shape[1]
        return idct(
            dct(rows, axis=1) * self.amplitude(np.arange(n) / (2 * n * dt)), axis=1
        )
