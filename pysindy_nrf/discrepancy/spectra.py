"""Spectra of the balances of a search: what models are fitted to and judged by."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from ..chain.identifiability import SolveOrder, plan_solve_order
from ..chain.layout import LawLayout, Layout
from ..chain.sites import Site
from ..equations.many_solves import ChainFit
from ..exceptions import NRFError
from ..laws.base import ForceLaw
from .bands import InformativeBands
from .error_reduction import Powers
from .search_data import LONG_RECORD, SearchData
from .windows import Windows

# Spectra of laws of models that are kept for the next model, bytes.
CACHE_BYTES = 64_000_000


@dataclass
class ScanCache:
    """The laws that a scan tries, and the products of their columns with each row."""

    points: Sequence[tuple[ForceLaw, ...]] = ()
    products: dict[Any, np.ndarray] = field(default_factory=dict)


class BalanceSpectra:
    """Spectra of columns and forces of the balances, by fold and band.

    Parameters
    ----------
    data : SearchData
    windows : Windows
        Of the folds of the search, or of other rows.
    bands : InformativeBands, optional
        All of them if None.
    strict : bool
        Refuse laws whose columns depend on others. In simulated records a law may not
        act, and is left out.
    """

    def __init__(
        self,
        data: SearchData,
        windows: Windows,
        bands: InformativeBands | None = None,
        strict: bool = True,
    ) -> None:
        self.data = data
        self.windows = windows
        self.strict = strict
        # what single precision loses of the spectra of long records is far below the
        # share that counts as zero
        self.precision: DTypeLike = float if windows.size < LONG_RECORD else np.float32
        self.fixed = windows.spectra(data.fixed, self.precision)
        # (n_folds, n_dof)
        self.known = data.known[[b.segment for b in windows.blocks]]
        if bands is None:
            bands = InformativeBands.all(data.n_dof, len(windows.edges) - 1)
        self.bands = bands

        self.scans: dict[Any, ScanCache] = {}
        self._spectra: dict[tuple[Site, ForceLaw], np.ndarray] = {}
        self._row_numbers: dict[Any, int] = {}
        self._products: tuple[list[int], np.ndarray] = ([], np.empty(0))
        self._orders: dict[tuple[Site, ...], SolveOrder] = {}

    # -- the same in another way -----------------------------------------------

    def with_bands(self, bands: InformativeBands) -> BalanceSpectra:
        """The same spectra, models judged in other bands."""
        out = copy(self)
        out.bands = bands
        return out

    def on(self, data: SearchData, windows: Windows) -> BalanceSpectra:
        """Spectra of other records, or of other rows, with the same bands."""
        return BalanceSpectra(data, windows, self.bands)

    def of_records(self, data: SearchData) -> BalanceSpectra:
        """Spectra of the folds of other records with the same bands."""
        windows = self.windows.on(data.search, data=data.data)
        if len(windows.blocks) != len(self.windows.blocks):
            raise NRFError(
                "The corrected channels are too short for a fold",
                "Give longer records.",
            )
        return self.on(data, windows)

    def of_all_samples(self) -> BalanceSpectra:
        """The same windows and bands on all samples of records searched by excerpts."""
        full = self.data.full
        # those of the excerpts are hardly asked for again
        self._spectra = {}
        return self.on(full, self.windows.on(full.search, data=full.data))

    def with_means(self) -> BalanceSpectra:
        """The same with the mean of every column left in: it shows a constant force."""
        return BalanceSpectra(
            self.data, self.windows.with_means(), self.bands.with_lowest()
        )

    # -- rows ------------------------------------------------------------------

    def columns(
        self, site: Site, laws: Sequence[ForceLaw], precision: DTypeLike = float
    ) -> np.ndarray:
        """Spectra of the columns of laws at one site."""
        spectra = self.windows.spectra(
            lambda records: self.data.columns(site, laws, records), precision
        )
        if not np.isfinite(spectra).all():
            raise NRFError(
                "The columns of the law overflow", "Leave it out of the catalogue."
            )
        return spectra

    def rows(self, layout: LawLayout) -> list[np.ndarray]:
        """Spectra of all rows of a model: its laws one by one, then the fixed ones."""
        laws = [self._kept(site, law) for site, law in _placed(layout)]
        return [*laws, self.fixed]

    def row_numbers(self, layout: LawLayout) -> list[int]:
        """Numbers of the rows of a model, equal for equal rows of any model."""
        names: list[Any] = []
        for site, law in _placed(layout):
            names += [(site, law, k) for k in range(len(law.terms()))]
        names += range(len(self.fixed))

        # hashes of laws take long
        known = self._row_numbers
        return [known.setdefault(name, len(known)) for name in names]

    def products(self, layout: LawLayout) -> np.ndarray:
        """Products of the rows of a model by fold and band.

        Taken from those of a larger model that came before, where there is one.
        """
        numbers = self.row_numbers(layout)
        if not set(numbers) <= set(self._products[0]):
            self._products = numbers, self.windows.products(*self.rows(layout))

        known, products = self._products
        if numbers == known:
            return products
        places = [known.index(number) for number in numbers]
        return products[:, :, places][..., places]

    def _kept(self, site: Site, law: ForceLaw) -> np.ndarray:
        """Spectra of the columns of a law of a model, kept for the next model."""
        spectra = self._spectra.pop((site, law), None)
        if spectra is None:
            spectra = self.columns(site, [law], self.precision)
        self._spectra[site, law] = spectra

        size = sum(rows.nbytes for rows in self._spectra.values())
        while len(self._spectra) > 1 and size > CACHE_BYTES:
            oldest = next(iter(self._spectra))
            size -= self._spectra.pop(oldest).nbytes
        return spectra

    # -- solves ----------------------------------------------------------------

    def solver(
        self, layout: Layout, where: Mapping[Site, Sequence[int]], first_fixed: int
    ) -> ChainFit:
        """The solve of a set of columns.

        Parameters
        ----------
        layout : Layout
        where : mapping of Site to sequence of int
            Rows of the products that hold the terms of each site.
        first_fixed : int
            Row of a_1.

        Notes
        -----
        Balances one by one locate a missing law. Each is fitted beside the laws that
        the balances before it found, as it is judged: laws that are found twice would
        be judged where the other one was not fitted.
        """
        data = self.data
        if layout.acting not in self._orders:
            order = plan_solve_order(
                layout.chain,
                data.forced,
                data.unknown,
                dict(data.known_masses),
                "sequential",
                layout.acting,
            )
            self._orders[layout.acting] = order.require_complete()
        return ChainFit(
            layout,
            self._orders[layout.acting],
            data.known_masses,
            where,
            first_fixed,
            data.forced,
        )

    def used_folds(self, solver: ChainFit) -> np.ndarray:
        """Folds that serve each group of balances, (n_folds, n_groups).

        Those in which all forces of the group are known.
        """
        columns = []
        for group in solver.groups:
            dofs = [j - 1 for j in group.dofs]
            columns.append(self.known[:, dofs].all(axis=1))
        return np.array(columns).T

    # -- errors ----------------------------------------------------------------

    def errors(self, powers: Powers) -> np.ndarray:
        """Error of each balance in its clear bands, percent."""
        residual = self.bands.clear_power(powers.residual)
        reference = self.bands.clear_power(powers.reference)
        with np.errstate(divide="ignore", invalid="ignore"):
            return 100.0 * np.sqrt(residual / reference)

    def error(self, powers: Powers, scale: np.ndarray | None = None) -> float:
        """Error of all balances together, percent.

        Every balance is first divided by its scale, the reference if None.
        """
        residual = self.bands.clear_power(powers.residual)
        reference = self.bands.clear_power(powers.reference)
        scale = reference if scale is None else scale
        weight = 1.0 / np.where(scale > 0, scale, np.inf)
        share = (weight * residual).sum() / (weight * reference).sum()
        return float(100.0 * np.sqrt(share))

    @property
    def band(self) -> tuple[float | None, float | None]:
        """Lowest and highest frequency of all clear bands, Hz; None at an open end."""
        return self.bands.limits(self.windows.edges, self.data.fastest)


def _placed(layout: LawLayout) -> Iterator[tuple[Site, ForceLaw]]:
    """Laws of a model with their sites, in the order of their columns."""
    for site in layout.sites:
        for law in layout.laws.get(site, ()):
            yield site, law
