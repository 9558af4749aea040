"""Spectra of measured channels where floors have no sensor.

The columns are what the forces of laws would do to the channels, to first order about
the free run of a model. All channels together stand for one balance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..chain.layout import Layout
from ..chain.sites import Site
from ..equations.many_solves import ChannelSolve
from ..equations.protocol import ManySolver
from ..identification.fewer_sensors import Linearised
from ..laws.base import ForceLaw
from ..records.dataset import Dataset
from .bands import BANDS, InformativeBands, connected_bands, strongest_bands
from .error_reduction import Powers
from .folds import Split
from .prepare import Band
from .search_data import KnownForces, SearchData
from .spectra import BalanceSpectra
from .windows import ChannelWindows, Windows


@dataclass(frozen=True)
class ChannelSettings:
    """Effort of the loop where floors have no sensor."""

    # Linearisations of a model about its own run at most.
    max_linearisations: int = 6
    # Error reduction, dB, below which a further linearisation has stalled.
    stalled: float = 0.1
    # Share of the largest error reduction, dB, from which on a settled candidate is
    # fitted: linearisations stall, and fail where a tie moves masses by half. A right
    # cubic spring that stalled had 0.77 of a gap (tests of four floors, two or three
    # accelerometers).
    share_of_best: float = 0.7
    # Steps of the fit of a confirmed model, of which a gap needs more than six, and of
    # one of several candidates. Two of these show most of what a law gains; a tie that
    # moves masses by half needs more than eight, but its runs are exact and quick.
    fit_steps: int = 25
    trial_steps: int = 4


CHANNELS = ChannelSettings()


class ChannelData(SearchData):
    """The free run of a model, and its columns as the sensors see them.

    Parameters
    ----------
    run : Linearised
    channels : tuple of str
        That are measured.
    folds : Split
    known_masses : mapping of int to float
        kg.
    """

    def __init__(
        self,
        run: Linearised,
        channels: tuple[str, ...],
        folds: Split,
        known_masses: Mapping[int, float],
    ) -> None:
        n_samples = sum(segment.n_samples for segment in run.runs)
        data = Dataset(run.runs, n_samples)
        searched = {block.segment for block in folds.search}
        measured = KnownForces.of_records(data, sorted(searched))
        super().__init__(
            data,
            folds,
            known_masses,
            # no equation asks for a force alone
            forces=replace(measured, balances=np.ones_like(measured.balances)),
        )
        self.run = run
        self.channels = channels
        self._dofs = np.eye(self.n_dof)

    def columns(
        self, site: Site, laws: Sequence[ForceLaw], records: Sequence[int]
    ) -> np.ndarray:
        """What the forces of laws do to the channels.

        Shape (n_terms * n_channels, n_samples).
        """
        ends = np.array([site.incidence(j) for j in range(1, self.n_dof + 1)])
        parts = []
        for i in records:
            forces = super().columns(site, laws, [i])
            parts.append(self.run.through(forces, ends, i))
        return np.hstack(parts)

    def fixed(self, records: Sequence[int]) -> list[np.ndarray]:
        """What inertias do to the channels, what the forces do, and the channels.

        Less what the run misses of the channels.
        """
        parts = []
        for i in records:
            rows = super().fixed([i])
            through = []
            for row, end in zip(rows, [*self._dofs, *self._dofs]):
                through.append(self.run.through(row[None], end, i))
            inertias, forces = through[: self.n_dof], through[self.n_dof :]
            force = np.sum(forces, axis=0) - self.run.gaps[i]
            parts.append(np.vstack([*inertias, force, self.run.measured[i]]))
        return list(np.hstack(parts))

    def channel_errors(self, records: Sequence[int]) -> np.ndarray:
        """A gain of each channel of the run, then a delay of each, as columns.

        Shape (2 * n_channels * n_channels, n_samples); zero in other channels.
        """
        n_channels = len(self.channels)
        own = np.eye(n_channels)[:, :, None]
        parts = []
        for i in records:
            simulated = self.run.measured[i] - self.run.gaps[i]
            rates = np.gradient(simulated, self.data.segments[i].step, axis=1)
            columns = np.concatenate([own * simulated, own * rates])
            parts.append(columns.reshape(2 * n_channels**2, -1))
        return np.hstack(parts)


class ChannelSpectra(BalanceSpectra):
    """Spectra of the channels; all of them together stand for one balance."""

    data: ChannelData
    windows: ChannelWindows

    def solver(
        self, layout: Layout, where: Mapping[Site, Sequence[int]], first_fixed: int
    ) -> ManySolver:
        """The solve of a set of columns."""
        return ChannelSolve(layout, self.data.known_masses, where, first_fixed)

    def missed(self, windows: Windows) -> Powers:
        """Powers of what the free run misses of the channels in some windows.

        And of the channels.
        """
        run = self.data.run

        def gaps(records: tuple[int, ...]) -> np.ndarray:
            return np.hstack([run.gaps[i] for i in records])

        def measured(records: tuple[int, ...]) -> np.ndarray:
            return np.hstack([run.measured[i] for i in records])

        missed, reference = (
            np.einsum("fkii->fik", windows.products(windows.spectra(rows)))
            for rows in (gaps, measured)
        )
        return Powers(missed, reference.sum(axis=0))

    def channel_errors(self) -> np.ndarray:
        """Spectra of a gain of each channel, then of a delay of each."""
        return self.windows.spectra(self.data.channel_errors)

    def by_channel(self, power: np.ndarray) -> np.ndarray:
        """Power in the clear bands of each channel, (n_channels,)."""
        clear = power * self.bands.clear
        return clear.reshape(self.windows.n_channels, -1).sum(axis=1)

    def heldout_windows(self) -> ChannelWindows:
        """The same windows and bands on the held-out samples."""
        windows = self.windows
        return ChannelWindows(
            windows.n_channels,
            self.data.data,
            self.data.heldout,
            windows.length,
            windows.edges,
        )

    def find_bands(self, band: Band | None) -> InformativeBands:
        """The bands in which the run explains more than half of a channel.

        Inside a frequency band, Hz, and connected to the core of the channel.
        """
        low, high = band or (None, None)
        edges = self.windows.edges
        above = edges[:-1] >= (low or 0.0)
        inside = above & (edges[1:] <= (high or np.inf))
        powers = self.missed(self.windows)
        shares = powers.shares.reshape(-1, len(inside))
        references = powers.reference.reshape(-1, len(inside))

        informative = []
        for share, power in zip(shares, references):
            good = share < BANDS.unexplained
            core = strongest_bands(power * inside)
            informative.append(connected_bands(good, share, power, core) & inside)
        mask = np.array(informative).reshape(1, -1)
        return InformativeBands(mask, mask)
