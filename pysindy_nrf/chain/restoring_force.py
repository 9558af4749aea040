"""The restoring force of one site: a callable, its coefficients, its equation."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from ..exceptions import ChainError, ChannelError, LawError, UnknownSiteError
from ..laws.base import ForceLaw
from ..laws.shape import Motion
from .laws_by_site import distinct_labels
from .sites import Site
from .structure import Chain


class RestoringForce:
    """The force a site exerts, as a sum of laws with coefficients."""

    def __init__(self, site: Site, laws: Sequence[ForceLaw]) -> None:
        self.site, self.laws = site, tuple(laws)

    @property
    def has_memory(self) -> bool:
        """Whether a law remembers the path."""
        return any(law.has_memory for law in self.laws)

    @property
    def coefficients(self) -> pd.Series:
        """Coefficients by term (``"v"``, ``"s"``, ``"v^2 s"``, ...), SI units."""
        values, terms = (
            [float(c) for law in self.laws for c in law.values],
            distinct_labels(self.laws),
        )
        return pd.Series(
            values, index=pd.Index(terms, name="term"), name=str(self.site), dtype=float
        )

    @property
    def units(self) -> pd.Series:
        """Units of the coefficients by term."""
        return pd.Series(
            [t.unit for law in self.laws for t in law.terms()],
            self.coefficients.index,
            dtype=object,
        )

    def __call__(
        self,
        v: Any,
        s: Any,
        *,
        t: Any = None,
        covariates: Mapping[str, Any] | None = None,
    ) -> np.ndarray:
        """Force for rates and drifts."""
        if np.iscomplexobj(v) or np.iscomplexobj(s):
            raise ChannelError(
                f"v and s of {self.site} are complex",
                "Give real rates (m/s) and drifts (m).",
            )
        try:
            rate, drift = np.broadcast_arrays(
                np.asarray(v, dtype=float), np.asarray(s, dtype=float)
            )
        except (TypeError, ValueError) as error:
            cure = "Give rates in m/s and drifts in m."
            raise ChannelError(
                f"v and s of {self.site} are not numbers of one shape: {error}", cure
            ) from error
        if self.has_memory and drift.ndim != 1:
            cure = "Give v and s as one-dimensional paths in order of time."
            raise LawError(f"The force of {self.site} depends on the path", cure)
        shape = drift.shape

        def flat(line: Any) -> np.ndarray:
            return np.ascontiguousarray(
                np.broadcast_to(np.asarray(line, dtype=float), shape)
            ).ravel()

        motion = Motion(
            drift.ravel().copy(),
            rate.ravel().copy(),
            None,
            None if t is None else flat(t),
            {k: flat(c) for k, c in dict(covariates or {}).items()},
        )
        return self.along(motion).reshape(shape)

    def along(self, motion: Motion) -> np.ndarray:
        """Force along one contiguous record, N."""
        return sum(
            (law.force(motion) for law in self.laws), start=np.zeros(motion.n_samples)
        )

    def linear_part(self) -> pd.Series:
        """Damping and stiffness of the terms v and s."""
        total = {"v": 0.0, "s": 0.0}
        for law in self.laws:
            for term, c in zip(law.terms(), law.values):
                if term.label in total:
                    total[term.label] += float(c)
        return pd.Series({"c": total["v"], "k": total["s"]}, name=str(self.site))

    def equation(self, digits: int = 4) -> str:
        """The equation in the manner of the paper's eq. (11a)."""
        p, q = self.site.p, self.site.q
        index = (
            p
            if self.site.is_storey
            else f"_{p}{q}"
            if self.site.kind == "link"
            else f"_dof{p}"
        )
        pieces = [law.equation(index, digits) for law in self.laws] or ["0"]
        return f"R{index} = " + " + ".join(pieces).replace("+ -", "- ")

    def __str__(self) -> str:
        return self.equation()

    def __repr__(self) -> str:
        return f"RestoringForce({str(self.site)!r}, {list(self.laws)!r})"


class RestoringForces(Mapping):
    """Restoring forces by site: ``["storey 2"]``, ``[2]`` (storeys count from 1),
    ``["link 4-2"]``.
    """

    def __init__(self, chain: Chain, laws: Mapping[Site, Sequence[ForceLaw]]) -> None:
        self._chain = chain
        self._forces = {site: RestoringForce(site, held) for site, held in laws.items()}

    def __getitem__(self, site: Any) -> RestoringForce:
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
        return "\n".join(str(force) for force in self._forces.values())

    def __repr__(self) -> str:
        return f"RestoringForces({', '.join(map(str, self._forces))})"


def grid(
    low: Sequence[float], high: Sequence[float], size: int
) -> tuple[np.ndarray, np.ndarray]:
    """Grid over rates and drifts."""
    if size < 2:
        raise ChannelError(
            f"A surface on {size} points a side is no surface", "Take at least 2."
        )
    v, s = np.meshgrid(
        *(np.linspace(a, b, size) for a, b in zip(low, high)), indexing="ij"
    )
    return v, s
