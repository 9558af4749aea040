"""ChainModel: masses, laws and coefficients of a chain, and what follows from them."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ..common.files import atomic_write, check, plain_json, schema
from ..common.lazy import Hook
from ..exceptions import (
    ChainError,
    ChannelError,
    FileFormatError,
    FileVersionError,
    LawError,
)
from ..laws.base import ForceLaw, from_dict
from ..laws.forcing import lost_masses, total_masses
from ..records.dataset import Dataset
from ..records.files.table import check_file, unreadable
from ..records.input_arrays import from_arrays
from .restoring_force import RestoringForces, grid
from .sites import Site
from .structure import Chain
from .visited_region import VisitedRegion

SCHEMA = "pysindy_nrf.ChainModel"
VERSION = 1
# Masses and laws that a notebook shows of a model.
SHOWN_IN_NOTEBOOK = 30
_MOST_BYTES = 200_000_000  # a model of a thousand floors is far below this size


class ChainModel:
    r"""A chain with its masses and force laws.

    .. math:: m_j a_j + R_j(v_j, s_j) - R_{j+1}(v_{j+1}, s_{j+1}) = F_j

    Parameters
    ----------
    masses : array-like of shape (n_dof,)
        kg.
    laws : mapping of str to ForceLaw or sequence of ForceLaw
        With coefficients, by site (``"storey 2"``, ``"link 4-2"``, ``"dof 1"``).
    chain : Chain, optional
        Its links follow from the sites if None.
    visited : mapping of str to VisitedRegion, optional
        Regions of the (v, s) plane that the data reached.
    info : mapping, optional
        Where the model comes from (band, errors, settings); plain data.

    Raises
    ------
    ChainError, LawError
        If masses and sites do not fit, or a law has no coefficients.

    Examples
    --------
    >>> from pysindy_nrf import ChainModel, laws
    >>> storey = laws.PowerSeries(1, [100.0, 1e5])
    >>> model = ChainModel(
    ...     [10.0, 10.0],
    ...     {
    ...         "storey 1": [storey, laws.Dahl(sigma=5e4, Fd=34.85)],
    ...         "storey 2": storey,
    ...     },
    ... )
    >>> print(model)
    m1 = 10 kg, m2 = 10 kg  (R in N, s in m, v in m/s)
    R1 = 100 v1 + 1e+05 s1 + 34.85 Z1  (sigma = 5e+04 1/m)
    R2 = 100 v2 + 1e+05 s2
    >>> ChainModel.from_json(model.to_json()) == model
    True
    """

    def __init__(
        self,
        masses: Any,
        laws: Mapping[Any, ForceLaw | Sequence[ForceLaw]],
        chain: Chain | None = None,
        visited: Mapping[Any, VisitedRegion] | None = None,
        info: Mapping[str, Any] | None = None,
    ) -> None:
        try:
            self.masses = np.array(masses, dtype=float, ndmin=1)
        except (TypeError, ValueError):
            self.masses = np.array([np.nan])
        if self.masses.ndim != 1 or not np.isfinite(self.masses).all():
            raise ChainError(
                "The masses are not a list of finite numbers",
                "Give one mass in kg for each DOF.",
            )
        n = len(self.masses)
        if chain is None:
            chain = Chain(n).with_links(laws)
        if chain.n_dof != n:
            raise ChainError(
                f"{n} masses for a chain with {chain.n_dof} DOFs",
                "Give one mass in kg for each DOF.",
            )
        self.chain = chain
        held: dict[Site, tuple[ForceLaw, ...]] = {site: () for site in chain.sites}
        for text, value in laws.items():
            site = chain.site(text)
            if site.kind == "link" and site not in chain.sites:
                raise ChainError(
                    f"{str(site)!r} is not in the chain {chain!r}",
                    "Give it in the chain's links.",
                )
            held[site] = (value,) if isinstance(value, ForceLaw) else tuple(value)
        for site, group in held.items():
            for law in group:
                if not isinstance(law, ForceLaw):
                    raise LawError(
                        f"{site}: {law!r} is not a force law",
                        "Use those of pysindy_nrf.laws.",
                    )
                if law.coefficients is None or law.free_shape:
                    raise LawError(
                        f"{site}: {law!r} has no values",
                        "Give its coefficients and shape parameters.",
                    )
        self.laws = held
        self.visited = {
            chain.site(s): region for s, region in dict(visited or {}).items()
        }
        self.info = dict(info or {})

    @property
    def n_dof(self) -> int:
        """Number of masses."""
        return len(self.masses)

    @property
    def total_masses(self) -> np.ndarray:
        """Masses with what laws at the DOFs add to them (``AddedMass``), kg."""
        return total_masses(self.masses, self.laws)

    @property
    def has_memory(self) -> bool:
        """Whether a law remembers the path."""
        return any(law.has_memory for group in self.laws.values() for law in group)

    @property
    def coefficients(self) -> dict[Site, np.ndarray]:
        """Coefficients of the laws of every site, one after the other, SI units; empty
        where nothing acts.

        A LawError if a law has lost its own. With the name of each and its unit they
        stand in ``restoring_forces[site].coefficients``.
        """
        return {
            site: np.concatenate([np.zeros(0), *(law.values for law in held)])
            for site, held in self.laws.items()
        }

    @property
    def restoring_forces(self) -> RestoringForces:
        """Restoring forces by site."""
        return RestoringForces(self.chain, self.laws)

    def segments(self, X: Any, F: Any = None, **options: Any) -> Dataset:
        """The contiguous records in data given as for :meth:`predict`, with forces F in
        N.

        Parameters
        ----------
        F : array-like of shape (n_samples, n_dof), optional
        """
        if isinstance(X, Dataset):
            return X
        return from_arrays(
            X, F, n_dof=self.n_dof, has_memory=self.has_memory, **options
        )

    def site_forces(self, data: Dataset) -> list[np.ndarray]:
        """Forces of all sites along each record.

        Parameters
        ----------
        data : Dataset

        Returns
        -------
        list of ndarray of shape (n_valid_samples, n_sites)
            Columns in the order of ``model.laws``; N.
        """
        forces = self.restoring_forces.items()
        return [
            np.column_stack(
                [force.along(seg.motion(site, seg.valid)) for site, force in forces]
            )
            for seg in data.segments
        ]

    def balance_forces(self, data: Dataset) -> list[np.ndarray]:
        """Left-hand sides ``m_j a_j + R_j - R_{j+1}`` along each record; see
        :meth:`site_forces`.

        Returns
        -------
        list of ndarray of shape (n_valid_samples, n_dof)
        """
        incidence = self.chain.incidence(self.laws)
        return [
            seg.a[seg.valid].astype(float) * self.masses + forces @ incidence.T
            for seg, forces in zip(data.segments, self.site_forces(data))
        ]

    def predict(self, X: Any, **options: Any) -> np.ndarray:
        """Forces on the DOFs that the measured motion implies.

        Parameters
        ----------
        X : array-like of shape (n_samples, 3 n_dof), DataFrame or Record
            a_1.., v_1.., s_1.. (paper eq. 8); SI units.
        **options
            ``record``, ``time``, ``base_acceleration``, ``covariates``,
            ``coordinates``, ``dt``.

        Returns
        -------
        ndarray of shape (n_samples, n_dof)
            N; NaN at masked edges.
        """
        data = self.segments(X, **options, every_row=True)
        return data.scatter(self.balance_forces(data))

    def restoring_force(self, X: Any, **options: Any) -> np.ndarray:
        """Storey forces along data, which are given as for :meth:`predict`.

        Returns
        -------
        ndarray of shape (n_samples, n_dof)
            Force of storey j in column j-1, N; zero where a free chain has no storey 1.
        """
        data = self.segments(X, **options, every_row=True)
        order = list(self.laws)
        pick = [
            order.index(Site(j)) if Site(j) in order else -1
            for j in range(1, self.n_dof + 1)
        ]
        return data.scatter(
            [np.pad(f, ((0, 0), (0, 1)))[:, pick] for f in self.site_forces(data)]
        )

    def matrices(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Mass, damping and stiffness matrix of the linear part.

        Returns
        -------
        M, C, K : ndarray of shape (n_dof, n_dof)
            kg, N s/m, N/m, for motion relative to the base.
        """
        sites = list(self.laws)
        to_link = self.chain.incidence(sites).T  # relative motion of the DOFs -> drifts
        linear = [force.linear_part() for force in self.restoring_forces.values()]
        M = np.diag(self.masses)
        for site, b in zip(sites, to_link):
            for law in self.laws[site]:
                for term, c in zip(law.terms(), law.values):
                    if term.label == "a":
                        M = M + c * np.outer(b, b)
        C, K = (
            to_link.T @ (np.array([p[key] for p in linear])[:, None] * to_link)
            for key in "ck"
        )
        return M, C, K

    def modes(self) -> pd.DataFrame:
        """Natural frequencies, damping ratios and shapes of the linear part.

        Returns
        -------
        DataFrame
            One row for each mode by rising frequency: ``frequency`` (Hz, undamped),
            ``damping`` (share of critical), ``dof 1``.. (real shape, largest entry 1).
            From the state-space eigenvalues, so damping need not be proportional; two
            real ones of the same shape are one overdamped mode.

        Raises
        ------
        ChainError
            If a mass, alone or with what laws add to it, is not positive.
        """
        M, C, K = self.matrices()
        n = self.n_dof
        if (self.masses <= 0).any():
            raise ChainError(
                f"m{int(np.argmin(self.masses)) + 1} is not positive",
                "Modes need positive masses.",
            )
        if lost := lost_masses(self.masses, self.laws):
            raise ChainError(lost[0], "Modes need positive masses; weigh that floor.")
        values, vectors = np.linalg.eig(state_matrix(M, C, K))
        shapes = vectors[:n] / np.linalg.norm(vectors[:n], axis=0)
        pairs = [(i, i) for i in np.flatnonzero(values.imag > 0)]
        real = sorted(np.flatnonzero(values.imag == 0), key=lambda i: abs(values[i]))
        while real:
            i = real.pop(0)
            pairs.append((i, max(real, key=lambda k: abs(shapes[:, i] @ shapes[:, k]))))
            real.remove(pairs[-1][1])
        rows = []
        for i, k in pairs:
            size, shape = float(np.sqrt(abs(values[i] * values[k]))), shapes[:, i]
            decay = -0.5 * (values[i] + values[k]).real
            shape = shape / shape[np.argmax(np.abs(shape))]
            rows.append(
                [size / (2 * np.pi), decay / size if size else 0.0, *shape.real]
            )
        names = ["frequency", "damping", *(f"dof {j}" for j in range(1, n + 1))]
        return pd.DataFrame(
            sorted(rows), columns=names, index=pd.RangeIndex(1, n + 1, name="mode")
        )

    def surface(self, site: Any, size: int = 41, margin: float = 0.0) -> pd.DataFrame:
        """Restoring-force surface of a site over the region it visited.

        Parameters
        ----------
        site : str or int
        size, margin : int, float
            Points along each side of the grid, and share by which the rectangle is
            widened.

        Returns
        -------
        DataFrame
            Columns ``v`` (m/s), ``s`` (m), ``R`` (N), ``visited`` (bool); size^2 rows,
            v slowest.

        Raises
        ------
        LawError
            If the force depends on the path: it is no surface.
        """
        site = self.chain.site(site)
        force = self.restoring_forces[site]
        if force.has_memory:
            cure = "Draw its loops along a record instead."
            raise LawError(
                f"The force of {site} depends on the path, it is no surface", cure
            )
        if site not in self.visited:
            raise ChannelError(
                f"The visited region of {site} is not known",
                "Fit the model, or set model.visited.",
            )
        region = self.visited[site]
        middle = [(a + b) / 2 for a, b in zip(region.low, region.high)]
        half = [(b - a) / 2 * (1 + margin) for a, b in zip(region.low, region.high)]
        v, s = grid(
            [m - h for m, h in zip(middle, half)],
            [m + h for m, h in zip(middle, half)],
            size,
        )
        table = {"v": v, "s": s, "R": force(v, s), "visited": region.contains(v, s)}
        return pd.DataFrame({name: values.ravel() for name, values in table.items()})

    def simulate(self, F: Any, dt: float, **options: Any) -> Any:
        """Free run under sampled forces; parameters as of :func:`pysindy_nrf.simulate`.

        Parameters
        ----------
        **options
            ``method``, ``x0``, ``v0``, ``base_acceleration``, ...
        """
        return Hook.SIMULATE(self, F, dt, **options)

    def to_sindy(self, dt: float = 1.0) -> Any:
        """The model as a fitted ``ps.SINDy`` of the state [x_1..x_n, xdot_1..xdot_n]
        under u = F_1..F_n.

        Parameters
        ----------
        dt : float
            Sampling step, s, that SINDy notes.

        Returns
        -------
        pysindy.SINDy
        """
        return Hook.TO_SINDY(self, dt)

    @classmethod
    def from_sindy(cls, sindy: Any) -> ChainModel:
        """The chain behind a ``ps.SINDy`` that was fitted with a library and an
        optimizer of this package.

        Parameters
        ----------
        sindy : pysindy.SINDy
        """
        model: ChainModel = Hook.FROM_SINDY(sindy)
        return model

    def with_laws(self, laws: Mapping[Any, Sequence[ForceLaw]]) -> ChainModel:
        """A copy with other laws at some sites.

        Parameters
        ----------
        laws : mapping of str to sequence of ForceLaw
        """
        merged = {**self.laws, **{self.chain.site(s): v for s, v in laws.items()}}
        return ChainModel(self.masses, merged, self.chain, self.visited, self.info)

    def equations(self, digits: int = 4) -> list[str]:
        """The balances' laws as text, in the manner of the paper's eq. (11a).

        Parameters
        ----------
        digits : int
            Significant digits.
        """
        return [
            force.equation(digits)
            for force in self.restoring_forces.values()
            if force.laws
        ]

    def to_latex(self) -> str:
        """Force balances and restoring forces as one ``aligned`` block of LaTeX."""
        return str(Hook.LATEX(self))

    def __str__(self) -> str:
        masses = ", ".join(f"m{j + 1} = {m:.5g} kg" for j, m in enumerate(self.masses))
        return "\n".join([f"{masses}  (R in N, s in m, v in m/s)", *self.equations()])

    def _repr_html_(self) -> str:
        from . import latex

        masses = []
        for j, mass in enumerate(self.masses[:SHOWN_IN_NOTEBOOK], 1):
            masses.append(f"m{j} = {latex.as_text(mass)} kg")
        lines = [escape(", ".join(masses))]

        for force in list(self.restoring_forces.values())[:SHOWN_IN_NOTEBOOK]:
            if force.laws:
                shapes = [latex.mathml([text]) for text in latex.shape_values(force)]
                line = latex.mathml(latex.law_equation(force))
                lines.append(f"{line} with {', '.join(shapes)}" if shapes else line)

        title = f"<b>Chain of {self.n_dof} DOF{'s' if self.n_dof > 1 else ''}</b>"
        body = "".join(
            f"<p style='margin:.2em 0'>{line}</p>" for line in [title, *lines]
        )
        return f"<div class='pysindy-nrf'>{body}</div>"

    def __repr__(self) -> str:
        return (
            f"ChainModel({self.n_dof} DOF,"
            f" {', '.join(str(s) for s, held in self.laws.items() if held)})"
        )

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, ChainModel)
            and np.array_equal(self.masses, other.masses)
            and self.chain == other.chain
            and self.laws == other.laws
        )

    # how Python says that an object that can change has no hash
    __hash__ = None  # type: ignore[assignment]

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON, SI units, as :func:`pysindy_nrf.common.files.schema`
        describes it.

        Returns
        -------
        dict
        """
        return {
            "schema": SCHEMA,
            "version": VERSION,
            "chain": self.chain.to_dict(),
            "masses": [float(m) for m in self.masses],
            "laws": {
                str(s): [law.to_dict() for law in held]
                for s, held in self.laws.items()
                if held
            },
            "visited": {str(s): region.to_dict() for s, region in self.visited.items()},
            "info": self.info,
        }

    def to_json(self, path: Any = None, indent: int = 2) -> str:
        """The model as JSON; every number survives to the last bit.

        Parameters
        ----------
        path : path-like, optional
            Written there too (to a temporary file first, then moved into place).
        indent : int
        """
        text = json.dumps(self.to_dict(), indent=indent, allow_nan=False)
        if path is not None:
            with atomic_write(path) as file:
                file.write(text + "\n")
        return text

    @classmethod
    def from_json(cls, source: Any) -> ChainModel:
        """A model from JSON text or a file.

        Parameters
        ----------
        source : str or path-like
            JSON text (starting with a brace) or the path of a file.

        Raises
        ------
        FileVersionError, FileFormatError
            If a later version of this package wrote it, or it is not a model of this
            package.
        """
        text, where = source, "The JSON text"
        try:
            if not (isinstance(source, str) and source.lstrip()[:1] == "{"):
                text, where = _text_of(source), str(source)
            data = plain_json(text)
            if not isinstance(data, dict) or data.get("schema") != SCHEMA:
                raise FileFormatError(
                    f"{where} does not hold a chain model",
                    f'It needs "schema": "{SCHEMA}".',
                )
            if isinstance(data.get("version"), int) and data["version"] > VERSION:
                what = (
                    f"{where} has version {data['version']}, this package reads up to"
                    f" {VERSION}"
                )
                raise FileVersionError(what, "Update pysindy_nrf.")
            check(data, schema("chain_model"), where)
            if data["chain"]["n_dof"] != len(data["masses"]):
                what = (
                    f"{where} has {len(data['masses'])} masses for"
                    f" {data['chain']['n_dof']!r} DOFs"
                )
                raise FileFormatError(what, "Write it with ChainModel.to_json.")
            chain = Chain(
                data["chain"]["n_dof"],
                data["chain"].get("links", ()),
                data["chain"].get("ground", "base"),
            )
            return cls(
                data["masses"],
                {
                    site: [from_dict(law) for law in held]
                    for site, held in data["laws"].items()
                },
                chain,
                {
                    site: VisitedRegion.from_dict(region)
                    for site, region in data.get("visited", {}).items()
                },
                data.get("info"),
            )
        except FileFormatError:
            raise
        except (
            ValueError,
            KeyError,
            TypeError,
            AttributeError,
            ArithmeticError,
            RecursionError,
        ) as error:
            cure = "Write it with ChainModel.to_json."
            raise FileFormatError(
                f"{where} is not a readable chain model: {error}", cure
            ) from error


def state_matrix(M: np.ndarray, C: np.ndarray, K: np.ndarray) -> np.ndarray:
    """Rates of displacements and velocities of a linear structure in free vibration
    from these, 1/s.
    """
    n = len(M)
    return np.block(
        [
            [np.zeros((n, n)), np.eye(n)],
            [-np.linalg.solve(M, K), -np.linalg.solve(M, C)],
        ]
    )


def as_model(thing: Any) -> ChainModel:
    """The model of a fitted regressor, or the model itself."""
    model = getattr(thing, "model_", thing)
    if not isinstance(model, ChainModel):
        raise ChainError(
            f"{type(thing).__name__} is not a chain model",
            "Give a fitted NRFRegressor or a ChainModel.",
        )
    return model


def as_segments(thing: Any, X: Any, F: Any = None, **options: Any) -> Dataset:
    """Data cut into records, in the coordinates of the regressor."""
    model = as_model(thing)
    if hasattr(thing, "model_"):
        options = {"coordinates": thing.coordinates, "dt": thing.dt} | options
    return model.segments(X, F, **options)


def _text_of(path: Any) -> str:
    """The text of a model's file, or an error that names it."""
    if not isinstance(path, (str, os.PathLike)):
        raise FileFormatError(
            f"{path!r} is neither JSON text nor a path",
            "Give what ChainModel.to_json wrote.",
        )
    try:
        check_file(Path(path), _MOST_BYTES)
        return Path(path).read_text(encoding="utf-8")
    except (UnicodeError, OSError) as error:
        raise unreadable(Path(path), "JSON", error) from error


def storey_names(model: ChainModel) -> list[str]:
    """``storey 1`` .. ``storey n``."""
    return [f"storey {i}" for i in range(1, model.n_dof + 1)]


def frame(data: Dataset, parts: list[np.ndarray], columns: list[str]) -> pd.DataFrame:
    """A table of the rows the user passed, indexed by time where it is known."""
    times = [
        np.full(seg.n_samples, np.nan) if seg.t is None else seg.t
        for seg in data.segments
    ]
    known = all(seg.t is not None for seg in data.segments)
    index = (
        pd.Index(np.concatenate(times), name="t")
        if known
        else pd.RangeIndex(data.n_samples, name="sample")
    )
    return pd.DataFrame(data.scatter(parts), index=index, columns=columns)
