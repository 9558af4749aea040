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
    """Edges of frequency bands: the mean of a window, then bands that are equal on a logarithmic axis."""
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
    """Gram matrices of the spectra of the columns, by window and frequency band."""
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
