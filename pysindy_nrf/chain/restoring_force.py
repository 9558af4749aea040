"""The restoring force of one site: a callable, its coefficients, its equation."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import numpy.typing as npt
import pandas as pd

from ..common.unit_system import TRANSLATION, UnitSystem
from ..exceptions import ChainError, ChannelError, LawError, UnknownSiteError
from ..laws.base import ForceLaw
from ..laws.shape import Motion
from .laws_by_site import distinct_labels
from .sites import Site, SiteName
from .structure import Chain


class RestoringForce:
    """The force at a site, as a sum of laws with coefficients."""

    def __init__(
        self,
        site: Site,
        laws: Sequence[ForceLaw],
        unit_system: UnitSystem = TRANSLATION,
    ) -> None:
        self.site = site
        self.laws = tuple(laws)
        self.unit_system = unit_system

    @property
    def has_memory(self) -> bool:
        """Whether a law remembers the path."""
        return any(law.has_memory for law in self.laws)

    @property
    def coefficients_by_term(self) -> dict[str, float]:
        """Coefficients by term (``"v"``, ``"s"``, ``"v^2 s"``, ...), SI units."""
        values: list[float] = []
        for law in self.laws:
            values.extend(map(float, law.values))
        return dict(zip(distinct_labels(self.laws), values))

    @property
    def coefficients(self) -> pd.Series:
        """The same as a Series, whose index is named ``term``."""
        by_term = self.coefficients_by_term
        terms = pd.Index(list(by_term), name="term")
        values = list(by_term.values())
        return pd.Series(values, index=terms, name=str(self.site), dtype=float)

    @property
    def units(self) -> pd.Series:
        """Units of the coefficients by term."""
        units: list[str] = []
        for law in self.laws:
            units.extend(self.unit_system.of(term.unit) for term in law.terms())
        return pd.Series(units, self.coefficients.index, dtype=object)

    def shape_units(self, law: ForceLaw) -> dict[str, str]:
        """Units of the coefficients and shape parameters of a law at this site.

        Parameters
        ----------
        law : ForceLaw
        """
        units = law.units
        return {name: self.unit_system.of(unit) for name, unit in units.items()}

    def __call__(
        self,
        v: npt.ArrayLike,
        s: npt.ArrayLike,
        *,
        t: npt.ArrayLike | None = None,
        covariates: Mapping[str, npt.ArrayLike] | None = None,
    ) -> np.ndarray:
        """Force for rates and drifts.

        Parameters
        ----------
        v, s : array-like
            Rates (m/s) and drifts (m), of shapes that broadcast; paths in order of
            time if a law remembers the path.
        t : array-like, optional
            Time, s.
        covariates : mapping of str to array-like, optional
            Channels that the laws read.

        Returns
        -------
        ndarray
            N.

        Raises
        ------
        ChannelError
            If v and s are not real numbers of one shape.
        LawError
            If a law remembers the path and v and s are no paths.
        """
        rate, drift = self._as_numbers(v, s)
        if self.has_memory and drift.ndim != 1:
            what = f"The force of {self.site} depends on the path"
            cure = "Give v and s as one-dimensional paths in order of time."
            raise LawError(what, cure)

        lines = {}
        for name, channel in dict(covariates or {}).items():
            lines[name] = _flat(channel, drift.shape)
        clock = None if t is None else _flat(t, drift.shape)
        motion = Motion(
            drift.ravel().copy(), rate.ravel().copy(), None, clock, covariates=lines
        )
        return self.along(motion).reshape(drift.shape)

    def _as_numbers(
        self, v: npt.ArrayLike, s: npt.ArrayLike
    ) -> tuple[np.ndarray, np.ndarray]:
        """Rates and drifts as arrays of one shape."""
        if np.iscomplexobj(v) or np.iscomplexobj(s):
            what = f"v and s of {self.site} are complex"
            raise ChannelError(what, "Give real rates (m/s) and drifts (m).")
        try:
            rate, drift = np.broadcast_arrays(
                np.asarray(v, dtype=float), np.asarray(s, dtype=float)
            )
        except (TypeError, ValueError) as error:
            what = f"v and s of {self.site} are not numbers of one shape: {error}"
            raise ChannelError(what, "Give rates in m/s and drifts in m.") from error
        return rate, drift

    def along(self, motion: Motion) -> np.ndarray:
        """Force along one contiguous record, N."""
        total = np.zeros(motion.n_samples)
        for law in self.laws:
            total = total + law.force(motion)
        return total

    def coefficient_sum(self, label: str) -> float:
        """Sum of the coefficients of the terms of one label, zero if there is none."""
        total = 0.0
        for law in self.laws:
            for term, value in zip(law.terms(), law.values):
                if term.label == label:
                    total += float(value)
        return total

    def linear_part(self) -> pd.Series:
        """Damping c (N s/m) and stiffness k (N/m): of the terms v and s."""
        c = self.coefficient_sum("v")
        k = self.coefficient_sum("s")
        return pd.Series({"c": c, "k": k}, name=str(self.site))

    def equation(self, digits: int = 4) -> str:
        """The equation in the manner of the paper's eq. (11a).

        That of a sensor gives its reading of the true channel y.
        """
        index: int | str = self.site.p
        if self.site.kind == "dof":
            index = f"_dof{self.site.p}"
        elif not self.site.is_storey:
            index = f"_{self.site.p}{self.site.q}"

        of = self.unit_system.of
        pieces = [law.equation(index, digits, of) for law in self.laws] or ["0"]
        left = f"R{index}"
        if self.site.kind == "sensor":
            left = str(self.site)
            pieces.insert(0, "y")
        return f"{left} = " + " + ".join(pieces).replace("+ -", "- ")

    def __str__(self) -> str:
        return self.equation()

    def __repr__(self) -> str:
        return f"RestoringForce({str(self.site)!r}, {list(self.laws)!r})"


def _flat(channel: npt.ArrayLike, shape: tuple[int, ...]) -> np.ndarray:
    """A channel as one contiguous line of numbers."""
    line = np.broadcast_to(np.asarray(channel, dtype=float), shape)
    return np.ascontiguousarray(line).ravel()


class RestoringForces(Mapping[Site, RestoringForce]):
    """Restoring forces by site: ``["storey 2"]``, ``[2]``, ``["link 4-2"]``.

    Storeys count from 1.
    """

    def __init__(self, chain: Chain, laws: Mapping[Site, Sequence[ForceLaw]]) -> None:
        self._chain = chain
        self._forces: dict[Site, RestoringForce] = {}
        for site, group in laws.items():
            self._forces[site] = RestoringForce(site, group, chain.units)

    def __getitem__(self, site: SiteName) -> RestoringForce:
        try:
            return self._forces[self._chain.site(site)]
        except (ChainError, KeyError):
            cure = f"It has {', '.join(map(str, self._forces))}."
            raise UnknownSiteError(f"The model has no site {site!r}", cure) from None

    def __iter__(self) -> Iterator[Site]:
        return iter(self._forces)

    def __len__(self) -> int:
        return len(self._forces)

    def __str__(self) -> str:
        return "\n".join(map(str, self._forces.values()))

    def __repr__(self) -> str:
        return f"RestoringForces({', '.join(map(str, self._forces))})"


def grid(
    low: npt.ArrayLike, high: npt.ArrayLike, size: int
) -> tuple[np.ndarray, np.ndarray]:
    """Grid over rates and drifts between two corners (v, s)."""
    if size < 2:
        what = f"A surface on {size} points a side is no surface"
        raise ChannelError(what, "Take at least 2.")
    corners = np.linspace(np.asarray(low), np.asarray(high), size)
    v, s = np.meshgrid(corners[:, 0], corners[:, 1], indexing="ij")
    return v, s
