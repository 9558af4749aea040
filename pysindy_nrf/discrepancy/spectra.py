"""Spectra of the balances of a search: what models are fitted to and judged by."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import DTypeLike

from ..chain.identifiability import SolveOrder, plan_solve_order
from ..chain.layout import LawLayout, Layout
from ..chain.sites import Site
from ..equations.many_solves import CompiledChainSolve
from ..equations.protocol import ManySolver
from ..exceptions import NRFError
from ..laws.base import ForceLaw
from .bands import InformativeBands
from .error_reduction import Powers
from .search_data import LONG_RECORD, SearchData
from .windows import Windows

# Memory for the spectra of laws that the next model may need, bytes.
CACHE_BYTES = 64_000_000


# Products of the columns of a scan with each row by its number, and with each other by
# None.
ScanProducts = dict[int | None, np.ndarray]
# A term of a law at a site, or the number of a row that no law changes.
RowName = tuple[Site, ForceLaw, int] | int


@dataclass(frozen=True)
class Scan:
    """The laws that a scan tries, and the products of their columns."""

    points: Sequence[tuple[ForceLaw, ...]]
    products: ScanProducts = field(default_factory=dict)


class SpectraCache:
    """Spectra and products that later models of the same rows read again.

    Attributes
    ----------
    fixed : ndarray of shape (n_fixed, size)
        Spectra of the rows that no law changes.
    scans : dict
        By law and sites.
    orders : dict
        Solve orders by the sites with a law.
    """

    def __init__(self, fixed: np.ndarray) -> None:
        self.fixed = fixed
        self.scans: dict[tuple[ForceLaw, tuple[Site, ...]], Scan] = {}
        self.orders: dict[tuple[Site, ...], SolveOrder] = {}
        self._laws: dict[tuple[Site, ForceLaw], np.ndarray] = {}
        self._row_numbers: dict[RowName, int] = {}
        self._numbers: list[int] = []
        self._products = np.empty(0)

    def columns(
        self, site: Site, law: ForceLaw, compute: Callable[[], np.ndarray]
    ) -> np.ndarray:
        """Spectra of the columns of a law, the latest of them in memory."""
        spectra = self._laws.pop((site, law), None)
        if spectra is None:
            spectra = compute()
        self._laws[site, law] = spectra

        size = sum(rows.nbytes for rows in self._laws.values())
        while len(self._laws) > 1 and size > CACHE_BYTES:
            oldest = next(iter(self._laws))
            size -= self._laws.pop(oldest).nbytes
        return spectra

    def forget_columns(self) -> None:
        """Free the memory of the spectra of laws."""
        self._laws.clear()

    def row_numbers(self, names: Iterable[RowName]) -> list[int]:
        """Numbers of rows by their names; hashes of laws take long."""
        known = self._row_numbers
        return [known.setdefault(name, len(known)) for name in names]

    def products(
        self, numbers: list[int], compute: Callable[[], np.ndarray]
    ) -> np.ndarray:
        """Products of some rows, from those of the last larger set if there is one."""
        if not set(numbers) <= set(self._numbers):
            self._numbers, self._products = numbers, compute()

        if numbers == self._numbers:
            return self._products
        places = [self._numbers.index(number) for number in numbers]
        return self._products[:, :, places][..., places]


class BalanceSpectra:
    """Spectra of columns and forces of the balances, by fold and band.

    Parameters
    ----------
    data : SearchData
    windows : Windows
        Of the folds of the search, or of other rows.
    bands : InformativeBands, optional
        All of them if None.
    cache : SpectraCache, optional
        Of the same data and windows.
    """

    def __init__(
        self,
        data: SearchData,
        windows: Windows,
        bands: InformativeBands | None = None,
        cache: SpectraCache | None = None,
    ) -> None:
        self.data = data
        self.windows = windows
        # what single precision loses of the spectra of long records is far below the
        # share that counts as zero
        self.precision: DTypeLike = float if windows.size < LONG_RECORD else np.float32
        # (n_folds, n_dof)
        self.known = data.forces.balances[[b.segment for b in windows.blocks]]
        if bands is None:
            bands = InformativeBands.all(data.n_dof, len(windows.edges) - 1)
        self.bands = bands
        if cache is None:
            cache = SpectraCache(windows.spectra(data.fixed, self.precision))
        self.cache = cache

    # -- the same in another way -----------------------------------------------

    def with_bands(self, bands: InformativeBands) -> BalanceSpectra:
        """The same spectra, models judged in other bands."""
        return type(self)(self.data, self.windows, bands, self.cache)

    def with_windows(self, data: SearchData, windows: Windows) -> BalanceSpectra:
        """Spectra of other records, or of other rows, with the same bands."""
        return BalanceSpectra(data, windows, self.bands)

    def of_records(self, data: SearchData) -> BalanceSpectra:
        """Spectra of the folds of other records with the same bands."""
        windows = self.windows.over(data.search, data=data.data)
        if len(windows.blocks) != len(self.windows.blocks):
            raise NRFError(
                "The corrected channels are too short for a fold",
                "Give longer records.",
            )
        return self.with_windows(data, windows)

    def of_all_samples(self) -> BalanceSpectra:
        """The same windows and bands on all samples of records searched by excerpts."""
        full = self.data.full
        # those of the excerpts are hardly asked for again
        self.cache.forget_columns()
        windows = self.windows.over(full.search, data=full.data)
        return self.with_windows(full, windows)

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

    def model_rows(self, layout: LawLayout) -> list[np.ndarray]:
        """Spectra of all rows of a model: its laws one by one, then the fixed ones."""
        rows = []
        for site, law in _placed(layout):
            compute = partial(self.columns, site, [law], self.precision)
            rows.append(self.cache.columns(site, law, compute))
        return [*rows, self.cache.fixed]

    def row_numbers(self, layout: LawLayout) -> list[int]:
        """Numbers of the rows of a model, equal for equal rows of any model."""
        numbers = []
        for site, law in _placed(layout):
            numbers += self.numbers_of(site, law)
        return numbers + self.cache.row_numbers(range(len(self.cache.fixed)))

    def numbers_of(self, site: Site, law: ForceLaw) -> list[int]:
        """Numbers of the rows of a law at a site."""
        names: list[RowName] = [(site, law, k) for k in range(len(law.terms()))]
        return self.cache.row_numbers(names)

    def products(self, layout: LawLayout) -> np.ndarray:
        """Products of the rows of a model by fold and band."""
        return self.cache.products(
            self.row_numbers(layout),
            lambda: self.windows.products(*self.model_rows(layout)),
        )

    # -- solves ----------------------------------------------------------------

    def solver(
        self, layout: Layout, where: Mapping[Site, Sequence[int]], first_fixed: int
    ) -> ManySolver:
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
        Balances one by one locate a missing law. Each is fitted together with the laws
        that the balances before it found, as it is judged: laws that are found twice
        would be judged where the other one was not fitted.
        """
        data, orders = self.data, self.cache.orders
        if layout.acting not in orders:
            order = plan_solve_order(
                layout.chain,
                data.forced,
                data.forces.unknown,
                dict(data.known_masses),
                "sequential",
                layout.acting,
            )
            orders[layout.acting] = order.require_complete()
        return CompiledChainSolve(
            layout,
            orders[layout.acting],
            data.known_masses,
            where,
            first_fixed,
            data.forced,
        )

    def used_folds(self, solver: ManySolver) -> np.ndarray:
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
