"""Where is the damper? How far every storey's surface R(s, v) is from a plane.

The share of a storey's force that no plane explains; the reference is the same share in
simulated tests of the linear twin with the noise of the test. The loop (``close_loop``)
answers the same question by laws.
"""

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
import pandas as pd
from sklearn.base import clone

from pysindy_nrf.chain.model import as_model, as_segments, storey_names
from pysindy_nrf.drawing.figure import Axis, Bars, Figure, Line, Mark
from pysindy_nrf.drawing.matplotlib_renderer import Drawing
from pysindy_nrf.exceptions import ChainError
from pysindy_nrf.laws import Dahl, ForceLaw, PowerSeries
from pysindy_nrf.records.dataset import Dataset

LEAST = 1.0  # percent of the force; a surface below this is planar at any noise
N_BLOCKS = 40  # of consecutive samples, whose residuals get one sign


def planarity(
    estimator: Any,
    X: Any,
    F: Any = None,
    *,
    draws: int = 20,
    random_state: Any = None,
    **options: Any,
) -> pd.DataFrame:
    """Planarity index of every storey, with a noise reference.

    The index is the share of the storey's force along the data, percent of its rms,
    that the best plane ``c v + k s`` does not explain. Its reference is the index that
    noise gives a planar storey: the residuals are added to the identified balances with
    random signs in consecutive blocks (wild bootstrap), the chain is solved again, and
    the 95 % quantile is taken of what the coefficients' scatter does to the surface.

    Parameters
    ----------
    estimator : fitted NRFRegressor, or ChainModel
        A model has no noise reference.
    X, F, **options
        The data it was fitted to.
    draws : int
        Bootstrap draws; 0 leaves the reference out.
    random_state : int or None

    Returns
    -------
    DataFrame
        One row for each storey: ``index``, ``reference`` (percent; NaN without draws),
        ``planar`` (bool: the index is below the reference or below 1 %).
    """
    model = as_model(estimator)
    data = as_segments(estimator, X, F, **options)
    surfaces = off_plane(data, storey_forces(model, data))
    reference = np.full(model.n_dof, np.nan)
    if draws and hasattr(estimator, "solve_order_"):
        reference = noise_reference(estimator, data, surfaces.rms, draws, random_state)
    index = 100.0 * surfaces.share
    planar = index < np.fmax(reference, LEAST)
    columns = {"index": index, "reference": reference, "planar": planar}
    return pd.DataFrame(columns, index=storey_names(model))


# -- planes --------------------------------------------------------------------


@dataclass(frozen=True)
class OffPlane:
    """Rms of what the best plane leaves of each force, and rms of the force, N."""

    rest: np.ndarray
    rms: np.ndarray

    @property
    def share(self) -> np.ndarray:
        return self.rest / np.where(self.rms > 0, self.rms, 1.0)


def storey_forces(model: Any, data: Dataset) -> list[np.ndarray]:
    """Storey forces along the valid rows of each segment."""
    forces = model.restoring_force(data)
    return [forces[segment.rows][segment.valid] for segment in data.segments]


def off_plane(data: Dataset, forces: list[np.ndarray]) -> OffPlane:
    """Distance of forces from the best planes over rate and drift."""
    R = np.concatenate(forces)
    v = np.concatenate([segment.v[segment.valid] for segment in data.segments])
    s = np.concatenate([segment.s[segment.valid] for segment in data.segments])
    rest = np.empty_like(R)
    for i in range(R.shape[1]):
        plane = np.column_stack([v[:, i], s[:, i]])
        plane = plane / (np.sqrt((plane**2).mean(axis=0)) + np.finfo(float).tiny)
        solution = np.linalg.lstsq(plane, R[:, i], rcond=None)[0]
        rest[:, i] = R[:, i] - plane @ solution
    return OffPlane(np.sqrt(np.mean(rest**2, axis=0)), np.sqrt(np.mean(R**2, axis=0)))


def noise_reference(
    estimator: Any, data: Dataset, rms: np.ndarray, draws: int, random_state: Any
) -> np.ndarray:
    """The 95 % quantile of the index that noise makes, percent of the forces."""
    rng = np.random.default_rng(random_state)
    balances = estimator.model_.balance_forces(data)
    forces = storey_forces(estimator.model_, data)
    # residuals with other signs act on floors without a force, too; those stay unforced
    problem = replace(estimator.problem_, excited=data.forced)
    shares = []
    for _ in range(draws):
        again = with_other_signs(data, balances, rng)
        model = problem.solve(again).model
        changes = []
        for drawn, identified in zip(storey_forces(model, data), forces):
            changes.append(drawn - identified)
        shares.append(100.0 * off_plane(data, changes).rest / rms)
    return np.quantile(shares, 0.95, axis=0)


def with_other_signs(
    data: Dataset, balances: list[np.ndarray], rng: np.random.Generator
) -> Dataset:
    """The data with forces whose residuals got random signs in blocks."""
    segments = []
    for segment, identified in zip(data.segments, balances):
        n = len(identified)
        block = np.minimum(np.arange(n) * N_BLOCKS // n, N_BLOCKS - 1)
        signs = rng.choice([-1.0, 1.0], size=N_BLOCKS)[block]
        force = segment.F.copy()
        residual = force[segment.valid] - identified
        force[segment.valid] = identified + signs[:, None] * residual
        segments.append(replace(segment, F=force))
    return Dataset(segments, data.n_samples)


# -- location ------------------------------------------------------------------


@dataclass(frozen=True)
class Location:
    """Location of the nonlinearity.

    Attributes
    ----------
    storeys : list of str
        Those that are not planar, in the order in which they were found.
    first : DataFrame
        ``planarity`` of the regressor as given.
    last : DataFrame
        The same with a hysteretic law in these storeys: the others are planar.
    estimator : NRFRegressor
        Fitted, with these laws.
    """

    storeys: list[str]
    first: pd.DataFrame
    last: pd.DataFrame
    estimator: Any

    def __str__(self) -> str:
        if not self.storeys:
            return "Every storey is planar."
        return (
            f"The nonlinearity is in {' and '.join(self.storeys)}; the other storeys"
            " are planar."
        )


def locate_nonlinearity(
    estimator: Any,
    X: Any,
    F: Any = None,
    *,
    draws: int = 20,
    random_state: Any = None,
    **options: Any,
) -> Location:
    """Find the storeys whose restoring force is not planar; parameters as there.

    A hysteretic storey biases its neighbours, whose surfaces bend too. The least planar
    storey gets a Dahl law beside its power series and the chain is solved again, while
    further storeys are not planar.

    Returns
    -------
    Location
        ``storeys`` in the order in which they were found, ``planarity`` of the
        ``first`` fit and of the ``last``, and the fitted ``estimator`` with these laws.

    Raises
    ------
    ChainError
        If the estimator is not a fitted NRFRegressor.
    """
    if not hasattr(estimator, "solve_order_"):
        raise ChainError(
            "locate_nonlinearity needs the regressor that was fitted to the data",
            "Give a fitted NRFRegressor.",
        )
    options_of_index = {"draws": draws, "random_state": random_state} | options
    first = planarity(estimator, X, F, **options_of_index)
    last = first
    model = estimator.model_
    lines: list[str] = []
    while not last.drop(index=lines)["planar"].all():
        others = last.drop(index=lines)
        worst = str(others.loc[~others["planar"], "index"].idxmax())
        lines.append(worst)
        estimator = with_dahl_law(estimator, model, worst).fit(X, F, **options)
        last = planarity(estimator, X, F, **options_of_index)
    return Location(lines, first, last, estimator)


def with_dahl_law(estimator: Any, model: Any, storey: str) -> Any:
    """The estimator with a Dahl law beside the laws of a storey that have no memory."""
    laws = dict(estimator.laws or {})
    present = model.laws[model.chain.site(storey)] or (PowerSeries(1),)
    laws[storey] = (*filter(is_smooth, present), Dahl())

    declared = {model.chain.site(site) for site in laws}
    orders = dict(estimator.orders or {})
    for site in list(orders):
        if model.chain.site(site) in declared:
            del orders[site]
    return clone(estimator).set_params(laws=laws, orders=orders or None)


def is_smooth(law: ForceLaw) -> bool:
    """Whether a law depends on the present motion alone, without jumps."""
    return not (law.has_memory or law.family == "friction")


class PlanarityDisplay(Drawing):
    """How far every storey's surface is from a plane, and how far noise would bend it.

    Parameters
    ----------
    table : DataFrame
        As of ``planarity``.
    """

    _columns = 0

    def __init__(self, table: pd.DataFrame) -> None:
        self.table = table

    @classmethod
    def from_estimator(
        cls, estimator: Any, X: Any, F: Any = None, **options: Any
    ) -> Self:
        """Planarity of a fitted regressor; parameters as of ``planarity``."""
        return cls(planarity(estimator, X, F, **options))

    def figures(self) -> list[Figure]:
        index = self.table["index"]
        planar = self.table["planar"].to_numpy()
        reference = np.fmax(self.table["reference"].to_numpy(), LEAST)
        texts = np.where(planar, "planar", "not planar").tolist()
        colors = np.where(planar, "sky", "blue").tolist()
        label = "reference (noise, at least 1 %)"
        rows = np.arange(len(index))
        marks: list[Mark] = [
            Bars(index, color=colors, texts=texts),
            Line(reference, rows, label, "ink", dash="", marker="|"),
        ]
        end = 1.35 * max(index.max(), reference.max())
        x = Axis("off the plane", "% of the storey's force", (0, end))
        y = Axis(ticks=[str(name) for name in self.table.index])
        return [Figure("Planarity", marks, x, y, lying=True, legend="above")]
