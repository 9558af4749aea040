"""Gram matrices by frequency band, from half-overlapping Hann windows of the columns."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from ..exceptions import ChannelError
from .blocks import Block
from .grams import BlockGrams, Dofs, width_of
from .layout import Group, Layout

BANDS = 24
# Mean over time of the sum of squares of half-overlapping Hann windows.
_OVERLAP = 0.75
_AT_ONCE = 2**20  # numbers in the spectra that are held at a time


def band_edges(length: float, dt: float, n_bands: int = BANDS) -> np.ndarray:
    """Edges of frequency bands: the mean of a window, then bands that are equal on a logarithmic axis.

    Parameters
    ----------
    length : float
        Of a window, s.
    dt : float
        Sampling step, s.
    n_bands : int
        Bands above the first, which holds what a Hann window spreads of a constant (lines 0 and 1).

    Returns
    -------
    ndarray of shape (at most n_bands + 2,)
        Hz, from zero to beyond half the sampling rate, between the lines of the window. Bands without a line are left
        out: at low frequencies there are fewer.

    Examples
    --------
    >>> from pysindy_nrf.regression.band_grams import band_edges
    >>> band_edges(length=1.0, dt=0.01, n_bands=4).tolist()
    [0.0, 1.5, 3.5, 9.5, 22.5, 50.5]
    """
    size = _samples(length, dt)
    lines = size // 2 + 1
    cuts = np.unique(np.rint(np.geomspace(2, max(lines, 2), n_bands + 1)).astype(int))
    return np.concatenate([[0.0], (cuts - 0.5) / (size * dt)])


def _samples(length: float, dt: float) -> int:
    """Samples of a window, an even number."""
    return 2 * max(1, round(0.5 * length / dt))


def band_grams(
    layout: Layout,
    groups: Sequence[Group],
    records: Iterable[tuple[Iterable[Block], float | None]],
    known_masses: Mapping[int, float] | None = None,
    *,
    length: float,
    edges: np.ndarray | None = None,
) -> BlockGrams:
    """Gram matrices of the spectra of the columns, by window and frequency band.

    The balance is algebraic in time, so that windows cost no leakage between its columns: the relation holds line by
    line. The matrices of all bands of a window sum up to its Gram matrix in time (Parseval), and are scaled so that
    those of all windows sum up to that of the samples.

    Parameters
    ----------
    layout : Layout
    groups : sequence of Group
    records : iterable of (iterable of Block, float)
        Consecutive samples of each record, and its sampling step, s. Samples behind the last whole window are left
        out.
    known_masses : mapping of int to float, optional
        Masses used in summed balances, kg.
    length : float
        Of a window, s; the next one begins half a window later.
    edges : ndarray of shape (n_bands + 1,), optional
        Hz; those of :func:`band_edges` for the first record if None. Lines outside of them are left out.

    Returns
    -------
    BlockGrams
        Of leading shape (n_windows, n_bands), with ``record`` and ``edges``. ``sizes`` are the samples of half a
        window, shared out to the bands by their lines.

    Raises
    ------
    ChannelError
        If a record has no sampling step, or no record is as long as a window.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf import Chain
    >>> from pysindy_nrf.mechanics.identifiability import plan_solve_order
    >>> from pysindy_nrf.regression.band_grams import band_grams
    >>> from pysindy_nrf.regression.blocks import blocks_of
    >>> from pysindy_nrf.regression.chain_solve import solve
    >>> from pysindy_nrf.regression.layout import Layout
    >>> rng = np.random.default_rng(0)
    >>> t = 0.01 * np.arange(4000)[:, None]
    >>> v, s, a = rng.standard_normal((3, 4000, 1))
    >>> F = 10 * a + 3 * v + 500 * s + 800 * np.sin(2 * np.pi * 12 * t)  # hum at 12 Hz
    >>> layout = Layout(Chain(1), {"storey 1": 2})
    >>> records = [(blocks_of(np.hstack([v, s]), a, F), 0.01)]
    >>> grams = band_grams(layout, [layout.group((1,))], records, length=2.0)
    >>> quiet = (grams.edges[1:] < 10) | (grams.edges[:-1] > 14)  # a weight for each band
    >>> solve_order = plan_solve_order(layout.chain, (1,), (), {}, "auto", layout.acting)
    >>> everywhere, without = grams.sum(), grams.sum(np.tile(quiet, (len(grams), 1)))
    >>> abs(solve(everywhere, solve_order).masses[1] - 10) > 1, abs(solve(without, solve_order).masses[1] - 10) < 0.01
    (True, True)
    """
    known = dict(known_masses or {})
    parts: list[dict[Dofs, np.ndarray]] = []
    sizes: list[dict[Dofs, np.ndarray]] = []
    counts: list[np.ndarray] = []
    numbers: list[int] = []
    for number, (blocks, dt) in enumerate(records):
        if not dt:
            raise ChannelError("Frequency bands need the sampling step", "Pass dt= (s), or X with a time index.")
        size = _samples(length, dt)
        edges = band_edges(length, dt) if edges is None else np.asarray(edges, dtype=float)
        lines = np.searchsorted(np.fft.rfftfreq(size, dt), edges)
        twice = np.full(size // 2 + 1, 2.0)  # a line stands for its mirror image too
        twice[[0, -1]] = 1.0
        share = np.array([twice[lo:hi].sum() for lo, hi in zip(lines[:-1], lines[1:])]) * 0.5
        window = np.sin(np.pi * np.arange(size) / size) ** 2
        scale = np.sqrt(twice / (size * _OVERLAP))
        for motions, seen in _windows(layout, groups, blocks, known, size):
            spectra = np.ascontiguousarray((np.fft.rfft(motions * window) * scale).swapaxes(0, 1)).view(float)
            parts.append({g.dofs: _by_band(spectra, _rows(layout, groups, g), lines) * seen[g.dofs] for g in groups})
            shape = (spectra.shape[0], 1)
            sizes.append({g.dofs: np.tile(share * seen[g.dofs], shape) for g in groups})
            counts.append(np.tile(share, shape))
            numbers += [number] * spectra.shape[0]
    if not parts:
        raise ChannelError(f"No record is as long as a window of {length:g} s", "Use shorter windows.")
    return BlockGrams(
        layout, {g.dofs: g for g in groups}, {g.dofs: np.concatenate([p[g.dofs] for p in parts]) for g in groups},
        {g.dofs: np.concatenate([n[g.dofs] for n in sizes]) for g in groups}, np.concatenate(counts), known,
        record=np.array(numbers), edges=edges,
    )  # fmt: skip


def _by_band(spectra: np.ndarray, rows: np.ndarray, lines: np.ndarray) -> np.ndarray:
    """Products of rows of spectra (n_windows, n_rows, 2 n_lines) summed over the lines of each band."""
    own = spectra[:, rows]
    out = np.empty((len(own), len(lines) - 1, len(rows), len(rows)))
    for band, (lo, hi) in enumerate(zip(lines[:-1], lines[1:])):  # real and imaginary parts side by side
        part = own[:, :, 2 * lo : 2 * hi]
        np.matmul(part, part.swapaxes(1, 2), out=out[:, band])
    return out


def _rows(layout: Layout, groups: Sequence[Group], group: Group) -> np.ndarray:
    """Rows of a balance among ``[terms | a_1..a_n | F_1..F_n | right-hand sides of the sums]``."""
    own = [i for s in group.sites for i in range(layout.slices[s].start, layout.slices[s].stop)]
    k, n = layout.n_terms, layout.n_dof
    if len(group.dofs) == 1:
        return np.array([*own, k + group.dofs[0] - 1, k + n + group.dofs[0] - 1])
    sums = [g.dofs for g in groups if len(g.dofs) > 1]
    rows = np.array([*own, k + 2 * n + sums.index(group.dofs)])
    assert len(rows) == width_of(layout, group)
    return rows


def _windows(
    layout: Layout, groups: Sequence[Group], blocks: Iterable[Block], known: Mapping[int, float], size: int
) -> Iterator[tuple[np.ndarray, dict[Dofs, bool]]]:
    """Half-overlapping windows of all rows, some at a time, (n_rows, n_windows, size); which forces are known."""
    hop = size // 2
    sums = [g.dofs for g in groups if len(g.dofs) > 1]
    n_rows = layout.n_terms + 2 * layout.n_dof + len(sums)
    most = max(1, _AT_ONCE // (n_rows * size))
    held = np.zeros((n_rows, 0))
    seen: dict[Dofs, bool] = {}
    for block in blocks:
        seen = {g.dofs: all(block.known[j - 1] for j in g.dofs) for g in groups}
        force = np.where(np.array(block.known)[:, None], block.force, 0.0)
        totals = [
            sum(force[j - 1] - known[j] * block.acceleration[j - 1] for j in dofs) for dofs in sums
        ]  # right-hand sides of the sums
        new = np.vstack([block.terms, block.acceleration, force, *totals])
        for start in range(0, new.shape[1], most * hop):
            held = np.concatenate([held, new[:, start : start + most * hop]], axis=1)
            count = (held.shape[1] - size) // hop + 1
            if count > 0:
                yield np.lib.stride_tricks.sliding_window_view(held, size, axis=1)[:, : count * hop : hop], seen
                held = held[:, count * hop :]
