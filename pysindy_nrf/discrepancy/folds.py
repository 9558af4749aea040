"""Folds of the search and held-out pieces of the records.

A record is counted in cells of half a window. Pieces hold equal shares of energy and
time and last several windows. Held-out pieces last a period of the motion at least
where six or more were measured, so that they contain all phases of a sine, and are
placed so that they hold their share of the energy of every channel.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ..diagnosis.period import mean_period
from ..exceptions import ChannelError
from ..records.dataset import BlockRows, Segment


@dataclass(frozen=True)
class FoldSettings:
    """Numbers that cut records into folds and held-out pieces."""

    # Windows that the records of a search hold side by side. Fewer leave no three
    # windows for each of ten folds, more widen the lowest band; between 40 and 120 the
    # records on which the loop was measured give the same effects.
    n_windows: int = 60
    # Share of the energy between whose first and last part a record moves, and the
    # windows that this time holds at least: half of the folds, by energy. The energy is
    # that of the significant duration of an earthquake (Trifunac and Brady 1975).
    significant_energy: float = 0.9
    n_windows_of_motion: int = 10
    # Folds: the usual bias and variance of cross-validation (Kohavi 1995).
    n_folds: int = 10
    # Share of a record that is held out.
    heldout_share: float = 0.25
    # Least length of a piece, half windows: longer than the memory of filters and
    # windows.
    shortest_piece: int = 4
    # Numbers of held-out pieces that are tried. The cut that holds its share of the
    # energy of every channel is taken; fewer pieces must come nearer to it, by 2 % for
    # each.
    handicap_by_pieces: Mapping[int, float] = field(
        default_factory=lambda: {4: 0.0, 3: 0.02, 2: 0.04}
    )
    # Share of a channel's energy that must lie inside the folds, of what even spreading
    # would give: windows see next to nothing of the first and last half window.
    inside_share: float = 0.5


FOLDS = FoldSettings()


class Split(NamedTuple):
    """Blocks of rows, counted from the first valid row of each record."""

    search: list[BlockRows]
    heldout: list[BlockRows]


def window_length(segments: Sequence[Segment]) -> float:
    """Length of a window, s (samples where there is no clock)."""
    lengths = [seg.n_valid * (seg.dt or 1.0) for seg in segments]
    in_all = sum(lengths) / FOLDS.n_windows
    in_shortest = min(lengths) / (2 * FOLDS.shortest_piece)
    in_motion = sum(map(significant_duration, segments)) / FOLDS.n_windows_of_motion
    return min(in_all, in_shortest, in_motion)


def significant_duration(segment: Segment) -> float:
    """Time in which a record moves, s (samples where there is no clock)."""
    quiet = 0.5 * (1.0 - FOLDS.significant_energy)
    shares = []
    for channel in _channels(segment):
        reached = np.cumsum((channel - channel.mean()) ** 2)
        limits = np.array([quiet, 1.0 - quiet]) * reached[-1]
        if reached[-1] > 0:
            low, high = np.searchsorted(reached, limits)
            shares.append((high - low) / len(reached))
    share = float(np.mean(shares)) if shares else 1.0
    return share * segment.n_valid * (segment.dt or 1.0)


def _channels(segment: Segment) -> Iterator[np.ndarray]:
    """Rates and forces along the valid rows of a record."""
    for channels in (segment.v, segment.F):
        for channel in channels[segment.valid].T:
            yield np.nan_to_num(channel.astype(float, copy=False))


def split(
    segments: Sequence[Segment], length: float, heldout: Sequence[int] | None = None
) -> Split:
    """Folds of the search, and blocks held out.

    Parameters
    ----------
    segments : sequence of Segment
    length : float
        Of a window, s.
    heldout : sequence of int, optional
        Numbers of the records that are held out completely; a quarter of each if None.
    """
    heldout_records = list(heldout or ())
    numbers = [i for i in range(len(segments)) if i not in heldout_records]
    cells = _Cells(segments, numbers, length)

    if heldout is None:
        return _most_even_cut(cells)

    search = cells.cut(0.0, 1, 0).search
    if not cells.suffice(search):
        raise _too_short()
    blocks = [BlockRows(i, slice(0, segments[i].n_valid)) for i in heldout_records]
    return Split(search, blocks)


def _most_even_cut(cells: _Cells) -> Split:
    """The cut whose pieces hold most nearly their share of the energy."""
    best, least = None, np.inf

    for pieces, handicap in FOLDS.handicap_by_pieces.items():
        for shift in range(FOLDS.n_folds):
            cut = cells.cut(FOLDS.heldout_share, pieces, shift)
            if not cut.heldout or not cells.suffice(cut.search):
                continue
            unevenness = cells.unevenness(cut) + handicap
            if unevenness < least - 1e-9:
                best, least = cut, unevenness

    if best is None:
        raise _too_short()
    return best


def _too_short() -> ChannelError:
    return ChannelError(
        "The records are too short to be split into search and held-out parts",
        "Give longer records.",
    )


class _Cells:
    """Records counted in cells of half a window.

    ``energy`` holds the share of each channel's energy in each cell of a record,
    (n_cells, n_channels). The first cell of a record belongs to no piece.
    """

    def __init__(
        self, segments: Sequence[Segment], numbers: Sequence[int], length: float
    ) -> None:
        self.samples = [max(4, round(0.5 * length / (s.dt or 1.0))) for s in segments]
        if all(segments[i].n_valid < 3 * self.samples[i] for i in numbers):
            raise _too_short()

        self.energy = _energy_shares(segments, numbers, self.samples)
        self.n_cells = sum(len(energy) for energy in self.energy.values())
        self.period = {}
        for i in numbers:
            self.period[i] = _cells_of_a_period(segments[i], self.samples[i])

    def cut(self, share: float, pieces: int, shift: int) -> Split:
        """Cut every record into folds with held-out pieces between them."""
        out = Split([], [])

        for record, energy in self.energy.items():
            period = self.period[record]
            worth = 0.5 * energy.mean(axis=1) + 0.5 / self.n_cells
            count = max(1, round(FOLDS.n_folds * worth.sum()))

            # pieces of a period that leave two thirds to the search
            room = len(worth) // (3 * period)
            fewest = min(FOLDS.handicap_by_pieces)
            slow = period > FOLDS.shortest_piece and room >= fewest
            n_pieces = min(pieces, room) if slow else pieces

            widths, is_heldout = _pattern(count, share, n_pieces, shift)
            least = np.where(is_heldout & slow, period, FOLDS.shortest_piece)
            edges = _spaced(_edges(worth, widths), least)
            rows = (edges + 1) * self.samples[record]
            for start, stop, aside in zip(rows[:-1], rows[1:], is_heldout):
                block = BlockRows(record, slice(int(start), int(stop)))
                out[int(aside)].append(block)

        return out

    def suffice(self, search: Sequence[BlockRows]) -> bool:
        """Whether at least three folds hold a window."""
        longer = 0
        for block in search:
            n_rows = block.rows.stop - block.rows.start
            longer += n_rows >= 2 * self.samples[block.segment]
        return longer >= 3

    def unevenness(self, cut: Split) -> float:
        """Distance of the energy held out, and of that searched, from its share."""
        n_channels = next(iter(self.energy.values())).shape[1]
        heldout = np.zeros(n_channels)
        for block in cut.heldout:
            heldout += self._inside(block, 0).sum(axis=0)

        searched, n_searched = np.zeros(n_channels), 0
        for block in cut.search:
            inside = self._inside(block, 1)
            searched += inside.sum(axis=0)
            n_searched += len(inside)
        searched /= max(n_searched / self.n_cells, 1e-9)

        off = np.log(np.maximum(heldout, 1e-9) / FOLDS.heldout_share)
        lost = np.log(np.maximum(searched, 1e-9) / FOLDS.inside_share)
        return float(np.abs(off).max() + max(0.0, -lost.min()))

    def _inside(self, block: BlockRows, margin: int) -> np.ndarray:
        """Energy in the cells of a block, less a margin at both ends."""
        size = self.samples[block.segment]
        first = block.rows.start // size - 1 + margin
        last = block.rows.stop // size - 1 - margin
        return self.energy[block.segment][first:last]


def _energy_shares(
    segments: Sequence[Segment], numbers: Sequence[int], samples: Sequence[int]
) -> dict[int, np.ndarray]:
    """Share of the energy of each channel that moves in the cells of each record."""
    energy = {i: _energy(segments[i], samples[i]) for i in numbers}
    total = np.sum([cells.sum(axis=0) for cells in energy.values()], axis=0)
    n_rates = segments[numbers[0]].n_dof
    if not total[:n_rates].any():
        raise ChannelError(
            "Nothing moves in the records that are searched: drifts and velocities are"
            " zero",
            "Dead sensors or wrong columns; check them.",
        )
    moves = total > 0
    return {i: cells[:, moves] / total[moves] for i, cells in energy.items()}


def _energy(segment: Segment, hop: int) -> np.ndarray:
    """Energy of rates and forces in each cell, (n_cells, n_channels)."""
    channels = [channel[hop:] for channel in _channels(segment)]
    n_rows = len(channels[0])
    if n_rows < 2 * hop:
        return np.zeros((1, len(channels)))

    starts = hop * np.arange(max(1, n_rows // hop - 1))
    columns = []
    for line in channels:
        columns.append(np.add.reduceat((line - line.mean()) ** 2, starts))
    return np.column_stack(columns)


def _cells_of_a_period(segment: Segment, hop: int) -> int:
    """Cells that a period of the motion takes."""
    drifts = np.nan_to_num(segment.s[segment.valid]).T
    return int(np.ceil(mean_period(drifts) / hop))


def _pattern(
    count: int, share: float, pieces: int, shift: int
) -> tuple[np.ndarray, np.ndarray]:
    """Widths of folds and held-out pieces in turn, and which are held out."""
    pieces = min(pieces, count) if share else 0
    before_piece = set()
    for k in range(pieces):
        before_piece.add(int((k + 1) * count / (pieces + 1) + shift) % count)

    widths, is_heldout = [], []
    for k in range(count):
        widths.append((1.0 - share * bool(before_piece)) / count)
        is_heldout.append(False)
        if k in before_piece:
            widths.append(share / len(before_piece))
            is_heldout.append(True)
    return np.array(widths), np.array(is_heldout)


def _edges(worth: np.ndarray, widths: np.ndarray) -> np.ndarray:
    """Cells at which pieces of some shares of the worth end."""
    reached = np.cumsum(worth) / worth.sum()
    marks = np.searchsorted(reached, np.cumsum(widths)[:-1]) + 1
    return np.concatenate([[0], marks, [len(worth)]])


def _spaced(edges: np.ndarray, least: np.ndarray) -> np.ndarray:
    """Edges at least so many cells apart, as far as there is room."""
    if least.sum() > edges[-1]:
        room = int(edges[-1]) // len(least)
        least = np.full(len(least), min(FOLDS.shortest_piece, room))
    if least[0] < 1:
        return np.arange(edges[-1] + 1)

    steps = np.concatenate([[0], np.cumsum(least)])
    out = np.maximum.accumulate(edges - steps) + steps
    return np.minimum(out, edges[-1] - steps[-1] + steps)
