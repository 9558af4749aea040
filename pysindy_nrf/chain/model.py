"""ChainModel: masses, laws and coefficients of a chain, and what follows from them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any, Protocol, TypedDict, Unpack

import numpy as np
import numpy.typing as npt
import pandas as pd

from ..common.files import PathLike, atomic_write
from ..common.unit_system import UnitSystem
from ..exceptions import ChainError, ChannelError, LawError
from ..laws.base import ForceLaw, from_dict
from ..laws.forcing import lost_masses, total_masses
from ..records.dataset import Dataset
from ..records.input_arrays import from_arrays
from ..records.record import Record
from . import latex
from .model_file import (
    SCHEMA,
    VERSION,
    ModelData,
    parsed_model,
    readable_model,
    text_of_model,
)
from .restoring_force import RestoringForces, grid
from .sites import Named, Site, SiteName
from .structure import Chain
from .visited_region import VisitedRegion

# Masses and laws that a notebook shows of a model.
SHOWN_IN_NOTEBOOK = 30

LawOrLaws = ForceLaw | Sequence[ForceLaw]
MotionData = npt.ArrayLike | Record | Sequence[Record] | Dataset


class DataOptions(TypedDict, total=False):
    """What is given besides the motion, see :meth:`ChainModel.predict`."""

    record: npt.ArrayLike | None
    time: npt.ArrayLike | None
    base_acceleration: npt.ArrayLike | None
    covariates: Mapping[str, npt.ArrayLike] | None
    coordinates: str
    dt: float | None
    every_row: bool


# Pieces that are too short to run a model along are read, too.
EVERY_ROW = DataOptions(every_row=True)


class FittedRegressor(Protocol):
    """A regressor that has found a model."""

    model_: ChainModel
    coordinates: str
    dt: float | None


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
        masses: npt.ArrayLike,
        laws: Mapping[Named, LawOrLaws],
        chain: Chain | None = None,
        visited: Mapping[Site, VisitedRegion]
        | Mapping[str, VisitedRegion]
        | None = None,
        info: Mapping[str, object] | None = None,
    ) -> None:
        self.masses = _finite_masses(masses)
        n_dof = len(self.masses)
        if chain is None:
            chain = Chain(n_dof).with_links(laws)
        if chain.n_dof != n_dof:
            what = f"{n_dof} masses for a chain with {chain.n_dof} DOFs"
            raise ChainError(what, "Give one mass in kg for each DOF.")

        self.chain = chain
        self.laws = _laws_at_sites(chain, laws)
        self.visited: dict[Site, VisitedRegion] = {}
        for text, region in dict(visited or {}).items():
            self.visited[chain.site(text)] = region
        self.info: dict[str, Any] = dict(info or {})

    @property
    def n_dof(self) -> int:
        """Number of masses."""
        return len(self.masses)

    @property
    def units(self) -> UnitSystem:
        """Units of its forces, displacements and masses."""
        return self.chain.units

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
        """Coefficients of the laws of every site, one after the other, SI units.

        Empty where nothing acts. With their names and units they stand in
        ``restoring_forces[site].coefficients``.

        Raises
        ------
        LawError
            If a law has lost its coefficients.
        """
        out = {}
        for site, group in self.laws.items():
            values = [np.zeros(0)]
            values.extend(law.values for law in group)
            out[site] = np.concatenate(values)
        return out

    @property
    def restoring_forces(self) -> RestoringForces:
        """Restoring forces by site."""
        return RestoringForces(self.chain, self.laws)

    def segments(
        self,
        X: MotionData,
        F: npt.ArrayLike | None = None,
        **options: Unpack[DataOptions],
    ) -> Dataset:
        """The data set behind data that are given as for :meth:`predict`.

        Parameters
        ----------
        X : array-like, DataFrame, Record or Dataset
        F : array-like of shape (n_samples, n_dof), optional
            Forces, N.
        **options
            See :meth:`predict`.

        Returns
        -------
        Dataset
        """
        if isinstance(X, Dataset):
            return X
        memory = self.has_memory
        return from_arrays(X, F, n_dof=self.n_dof, has_memory=memory, **options)

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
        records = []
        for segment in data.segments:
            forces = []
            for site, force in self.restoring_forces.items():
                forces.append(force.along(segment.motion(site, segment.valid)))
            records.append(np.column_stack(forces))
        return records

    def balance_forces(self, data: Dataset) -> list[np.ndarray]:
        """Left-hand sides ``m_j a_j + R_j - R_{j+1}`` along each record, N.

        Parameters
        ----------
        data : Dataset

        Returns
        -------
        list of ndarray of shape (n_valid_samples, n_dof)
        """
        incidence = self.chain.incidence(self.laws)
        records = []
        for segment, forces in zip(data.segments, self.site_forces(data)):
            inertia = segment.a[segment.valid].astype(float) * self.masses
            records.append(inertia + forces @ incidence.T)
        return records

    def predict(self, X: MotionData, **options: Unpack[DataOptions]) -> np.ndarray:
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
        data = self.segments(X, **options | EVERY_ROW)
        return data.scatter(self.balance_forces(data))

    def restoring_force(
        self, X: MotionData, **options: Unpack[DataOptions]
    ) -> np.ndarray:
        """Storey forces along data, which are given as for :meth:`predict`.

        Returns
        -------
        ndarray of shape (n_samples, n_dof)
            Force of storey j in column j-1, N; zero where a free chain has no storey 1.
        """
        data = self.segments(X, **options | EVERY_ROW)
        column = {site: k for k, site in enumerate(self.laws)}
        storeys = [site for site in self.laws if site.is_storey]
        dofs = [site.p - 1 for site in storeys]
        records = []
        for forces in self.site_forces(data):
            by_storey = np.zeros((len(forces), self.n_dof))
            by_storey[:, dofs] = forces[:, [column[site] for site in storeys]]
            records.append(by_storey)
        return data.scatter(records)

    def matrices(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Mass, damping and stiffness matrix of the linear part.

        Returns
        -------
        M, C, K : ndarray of shape (n_dof, n_dof)
            kg, N s/m, N/m, for motion relative to the base.
        """
        incidence = self.chain.incidence(self.laws)
        added = []
        for label in ("a", "v", "s"):
            forces = self.restoring_forces.values()
            of_site = np.array([force.coefficient_sum(label) for force in forces])
            added.append((incidence * of_site) @ incidence.T)
        M, C, K = added
        return np.diag(self.masses) + M, C, K

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
        if (self.masses <= 0).any():
            lightest = int(np.argmin(self.masses)) + 1
            what = f"m{lightest} is not positive"
            raise ChainError(what, "Modes need positive masses.")
        lost = lost_masses(self.masses, self.laws, self.units)
        if lost:
            raise ChainError(lost[0], "Modes need positive masses; weigh that floor.")

        values, vectors = np.linalg.eig(state_matrix(*self.matrices()))
        shapes = vectors[: self.n_dof] / np.linalg.norm(vectors[: self.n_dof], axis=0)
        rows = []
        for i, k in _paired(values, shapes):
            omega = float(np.sqrt(abs(values[i] * values[k])))
            decay = -0.5 * (values[i] + values[k]).real
            damping = decay / omega if omega else 0.0
            shape = shapes[:, i] / shapes[np.argmax(np.abs(shapes[:, i])), i]
            rows.append([omega / (2 * np.pi), damping, *shape.real])

        names = ["frequency", "damping"]
        names.extend(f"dof {j}" for j in range(1, self.n_dof + 1))
        numbers = pd.RangeIndex(1, self.n_dof + 1, name="mode")
        return pd.DataFrame(sorted(rows), columns=names, index=numbers)

    def surface(
        self, site: SiteName, size: int = 41, margin: float = 0.0
    ) -> pd.DataFrame:
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
            what = f"The force of {site} depends on the path, so it has no surface"
            raise LawError(what, "Draw its loops along a record instead.")
        if site not in self.visited:
            what = f"The visited region of {site} is not known"
            raise ChannelError(what, "Fit the model, or set model.visited.")

        region = self.visited[site]
        low, high = np.array(region.low), np.array(region.high)
        middle = (low + high) / 2
        half = (high - low) / 2 * (1 + margin)
        v, s = grid(middle - half, middle + half, size)
        return pd.DataFrame(
            {
                "v": v.ravel(),
                "s": s.ravel(),
                "R": force(v, s).ravel(),
                "visited": region.contains(v, s).ravel(),
            }
        )

    def with_laws(self, laws: Mapping[Named, Sequence[ForceLaw]]) -> ChainModel:
        """A copy with other laws at some sites.

        Parameters
        ----------
        laws : mapping of str to sequence of ForceLaw
        """
        merged: dict[Site, Sequence[ForceLaw]] = dict(self.laws)
        for text, group in laws.items():
            merged[self.chain.site(text)] = group
        return ChainModel(self.masses, merged, self.chain, self.visited, self.info)

    def equations(self, digits: int = 4) -> list[str]:
        """The sites' laws as text, in the manner of the paper's eq. (11a).

        Parameters
        ----------
        digits : int
            Significant digits.
        """
        forces = self.restoring_forces.values()
        return [force.equation(digits) for force in forces if force.laws]

    def to_latex(self) -> str:
        """Equations of motion and restoring forces as one block of LaTeX."""
        return latex.latex(self)

    def __str__(self) -> str:
        units = self.units
        masses = [f"m{j} = {m:.5g} {units.mass}" for j, m in enumerate(self.masses, 1)]
        motion = f"R in {units.force}, s in {units.length}, v in {units.of('m/s')}"
        head = f"{', '.join(masses)}  ({motion})"
        return "\n".join([head, *self.equations()])

    def _repr_html_(self) -> str:
        masses = []
        for j, mass in enumerate(self.masses[:SHOWN_IN_NOTEBOOK], 1):
            unit = latex.pretty(self.units.mass)
            masses.append(f"m{j} = {latex.as_text(mass)} {unit}")
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
        sites = [str(site) for site, group in self.laws.items() if group]
        return f"ChainModel({self.n_dof} DOF, {', '.join(sites)})"

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, ChainModel)
            and np.array_equal(self.masses, other.masses)
            and self.chain == other.chain
            and self.laws == other.laws
        )

    # how Python says that an object that can change has no hash
    __hash__ = None  # type: ignore[assignment]

    def to_dict(self) -> ModelData:
        """Plain data for JSON, SI units, as the shipped schema describes it.

        Returns
        -------
        dict
        """
        laws = {}
        for site, group in self.laws.items():
            if group:
                laws[str(site)] = [law.to_dict() for law in group]
        visited = {str(site): area.to_dict() for site, area in self.visited.items()}
        return {
            "schema": SCHEMA,
            "version": VERSION,
            "chain": self.chain.to_dict(),
            "masses": self.masses.tolist(),
            "laws": laws,
            "visited": visited,
            "info": self.info,
        }

    def to_json(self, path: PathLike | None = None, indent: int = 2) -> str:
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
    def from_json(cls, source: PathLike) -> ChainModel:
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
        where, text = text_of_model(source)
        with readable_model(where):
            data = parsed_model(text, where)
            chain = Chain.from_dict(data["chain"])
            laws: dict[Site, list[ForceLaw]] = {}
            for text_of_site, group in data["laws"].items():
                laws[chain.site(text_of_site)] = [from_dict(law) for law in group]
            visited: dict[Site, VisitedRegion] = {}
            for text_of_site, region in data.get("visited", {}).items():
                visited[chain.site(text_of_site)] = VisitedRegion.from_dict(region)
            info = data.get("info")
            return ChainModel(data["masses"], laws, chain, visited, info)


def _finite_masses(masses: npt.ArrayLike) -> np.ndarray:
    """Masses as an array of finite numbers, or an error."""
    try:
        values = np.array(masses, dtype=float, ndmin=1)
    except (TypeError, ValueError):
        values = np.array([np.nan])
    if values.ndim != 1 or not np.isfinite(values).all():
        what = "The masses are not a list of finite numbers"
        raise ChainError(what, "Give one mass in kg for each DOF.")
    return values


def _laws_at_sites(
    chain: Chain, laws: Mapping[Named, LawOrLaws]
) -> dict[Site, tuple[ForceLaw, ...]]:
    """The laws of every site of a chain, each with values."""
    by_site: dict[Site, tuple[ForceLaw, ...]] = dict.fromkeys(chain.sites, ())
    for text, value in laws.items():
        site = chain.site(text)
        if site.kind == "link" and site not in chain.sites:
            what = f"{str(site)!r} is not in the chain {chain!r}"
            raise ChainError(what, "Give it in the chain's links.")
        by_site[site] = (value,) if isinstance(value, ForceLaw) else tuple(value)
        for law in by_site[site]:
            _require_values(law, site)
    return by_site


def _require_values(law: object, site: Site) -> None:
    """Refuse a law without values, and what is no law."""
    if not isinstance(law, ForceLaw):
        what = f"{site}: {law!r} is not a force law"
        raise LawError(what, "Use those of pysindy_nrf.laws.")
    if law.coefficients is None or law.free_shape:
        what = f"{site}: {law!r} has no values"
        raise LawError(what, "Give its coefficients and shape parameters.")


def _paired(values: np.ndarray, shapes: np.ndarray) -> list[tuple[int, int]]:
    """Eigenvalues of each mode.

    A conjugate pair counts once; two real ones of one shape are one overdamped mode.
    """
    pairs = [(int(i), int(i)) for i in np.flatnonzero(values.imag > 0)]
    real = np.flatnonzero(values.imag == 0).tolist()
    real.sort(key=lambda i: abs(values[i]))
    while real:
        i = real.pop(0)
        likeness = np.abs(shapes[:, i] @ shapes[:, real])
        pairs.append((i, real.pop(int(np.argmax(likeness)))))
    return pairs


def state_matrix(M: np.ndarray, C: np.ndarray, K: np.ndarray) -> np.ndarray:
    """Matrix A of the state space [x, xdot] of a linear structure, 1/s."""
    n_dof = len(M)
    lower = -np.linalg.solve(M, np.hstack([K, C]))
    upper = np.hstack([np.zeros((n_dof, n_dof)), np.eye(n_dof)])
    return np.vstack([upper, lower])


def as_model(thing: ChainModel | FittedRegressor) -> ChainModel:
    """The model of a fitted regressor, or the model itself."""
    model = getattr(thing, "model_", thing)
    if not isinstance(model, ChainModel):
        what = f"{type(thing).__name__} is not a chain model"
        raise ChainError(what, "Give a fitted NRFRegressor or a ChainModel.")
    return model


def as_segments(
    thing: ChainModel | FittedRegressor,
    X: Any,
    F: npt.ArrayLike | None = None,
    **options: Unpack[DataOptions],
) -> Dataset:
    """The data set behind some data, in the coordinates of a fitted regressor."""
    model = as_model(thing)
    if not isinstance(thing, ChainModel):
        settings = DataOptions(coordinates=thing.coordinates, dt=thing.dt)
        options = settings | options
    return model.segments(X, F, **options)


def parameters_of(
    model: ChainModel, known_masses: Mapping[int, float] | None = None
) -> pd.Series:
    """Masses and coefficients by name: ``m1``, ``storey 1: v``, ..."""
    known = known_masses or {}
    values = {
        f"m{j}": mass for j, mass in enumerate(model.masses, start=1) if j not in known
    }
    for site, force in model.restoring_forces.items():
        for term, coefficient in force.coefficients_by_term.items():
            values[f"{site}: {term}"] = coefficient
    return pd.Series(values, dtype=float)


def storey_names(model: ChainModel) -> list[str]:
    """``storey 1`` .. ``storey n``."""
    return [f"storey {i}" for i in range(1, model.n_dof + 1)]


def frame(data: Dataset, parts: list[np.ndarray], columns: list[str]) -> pd.DataFrame:
    """A table of the rows the user passed, indexed by time where it is known."""
    times = [segment.t for segment in data.segments if segment.t is not None]
    if len(times) == len(data.segments):
        index = pd.Index(np.concatenate(times), name="t")
    else:
        index = pd.RangeIndex(data.n_samples, name="sample")
    return pd.DataFrame(data.scatter(parts), index=index, columns=columns)
