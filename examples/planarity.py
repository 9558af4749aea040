"""Where is the damper? How far every storey's surface R(s, v) is from a plane, beside
what noise alone would bend it.

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
from pysindy_nrf.common import generator
from pysindy_nrf.exceptions import ChainError
from pysindy_nrf.laws import Dahl, PowerSeries
from pysindy_nrf.records.dataset import Dataset
from pysindy_nrf.report.figures.figure import Axis, Bars, Figure, Line, Mark
from pysindy_nrf.report.figures.matplotlib_renderer import Drawing

LEAST = 1.0  # percent of the force; a surface below this is planar at any noise
_BLOCKS = 40


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
    forces = [model.restoring_force(data)[seg.rows][seg.valid] for seg in data.segments]
    index, scale = _off_plane(data, forces)
    reference = np.full(model.n_dof, np.nan)
    if draws and hasattr(estimator, "solve_order_"):
        reference = _reference(estimator, data, scale, draws, random_state)
    planar = index < np.fmax(reference, LEAST)
    return pd.DataFrame(
        {"index": index, "reference": reference, "planar": planar},
        index=storey_names(model),
    )


@dataclass
class Location:
    """Location of the nonlinearity."""

    storeys: list[
        str
    ]  # storeys that are not planar, in the order in which they were found
    first: pd.DataFrame  # ``planarity`` of the regressor as given
    last: (
        pd.DataFrame
    )  # the same with a hysteretic law in these storeys: the others are planar
    estimator: Any  # fitted, with these laws

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
    """Find the storeys whose restoring force is not planar; parameters as of
    ``planarity``.

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
        cure = "Give a fitted NRFRegressor."
        raise ChainError(
            "locate_nonlinearity needs the regressor that was fitted to the data", cure
        )
    first = last = planarity(
        estimator, X, F, draws=draws, random_state=random_state, **options
    )
    found: list[str] = []
    laws = dict(estimator.laws or {})
    model = estimator.model_
    while not last.drop(index=found)["planar"].all():
        open_ = last.drop(index=found)
        worst = str(open_.loc[~open_["planar"], "index"].idxmax())
        found.append(worst)
        own = model.laws[model.chain.site(worst)] or (PowerSeries(1),)
        laws[worst] = (
            *(law for law in own if not (law.has_memory or law.family == "friction")),
            Dahl(),
        )
        named = {model.chain.site(s) for s in laws}
        orders = {
            s: o
            for s, o in dict(estimator.orders or {}).items()
            if model.chain.site(s) not in named
        }
        estimator = (
            clone(estimator)
            .set_params(laws=laws, orders=orders or None)
            .fit(X, F, **options)
        )
        last = planarity(
            estimator, X, F, draws=draws, random_state=random_state, **options
        )
    return Location(found, first, last, estimator)


def _off_plane(
    data: Dataset, forces: list[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Share of forces that the best plane does not explain (percent), and their rms."""
    R = np.concatenate(forces)
    off, size = np.empty(R.shape[1]), np.empty(R.shape[1])
    for i in range(R.shape[1]):
        sides = (
            [getattr(seg, key)[seg.valid, i] for seg in data.segments] for key in "vs"
        )
        plane = np.column_stack([np.concatenate(side) for side in sides])
        plane = plane / (np.sqrt((plane**2).mean(axis=0)) + np.finfo(float).tiny)
        rest = R[:, i] - plane @ np.linalg.lstsq(plane, R[:, i], rcond=None)[0]
        off[i], size[i] = np.sqrt(np.mean(rest**2)), np.sqrt(np.mean(R[:, i] ** 2))
    return 100.0 * off / np.where(size > 0, size, 1.0), size


def _reference(
    estimator: Any, data: Dataset, scale: np.ndarray, draws: int, random_state: Any
) -> np.ndarray:
    rng = generator(random_state)
    model = estimator.model_
    implied = model.balance_forces(data)
    found = [model.restoring_force(data)[seg.rows][seg.valid] for seg in data.segments]
    # what is left over flips its sign on unforced floors, too; they stay unforced
    problem = replace(estimator.problem_, excited=data.forced)
    values = []
    for _ in range(draws):
        segments = []
        for seg, left in zip(data.segments, implied):
            n = len(left)
            signs = rng.choice([-1.0, 1.0], size=_BLOCKS)[
                np.minimum(np.arange(n) * _BLOCKS // n, _BLOCKS - 1)
            ]
            force = seg.F.copy()
            force[seg.valid] = left + signs[:, None] * (seg.F[seg.valid] - left)
            segments.append(replace(seg, F=force))
        again = Dataset(segments, data.n_samples)
        other = problem.solve(again).model
        change = [
            other.restoring_force(data)[seg.rows][seg.valid] - R
            for seg, R in zip(data.segments, found)
        ]
        share, size = _off_plane(data, change)
        values.append(share * size / scale)
    return np.quantile(values, 0.95, axis=0)


class PlanarityDisplay(Drawing):
    """How far every storey's surface is from a plane, and how far noise alone would
    bend it.

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
        index, reference = (
            self.table["index"],
            np.fmax(self.table["reference"].to_numpy(), LEAST),
        )
        planar = self.table["planar"].to_numpy()
        texts = ["planar" if p else "not planar" for p in planar]
        marks: list[Mark] = [
            Bars(index, color=["sky" if p else "blue" for p in planar], texts=texts),
            Line(
                reference,
                np.arange(len(index)),
                "reference (noise, at least 1 %)",
                "ink",
                dash="",
                marker="|",
            ),
        ]
        x = Axis(
            "off the plane",
            "% of the storey's force",
            (0, 1.35 * max(index.max(), reference.max())),
        )
        y = Axis(ticks=[str(n) for n in self.table.index])
        return [Figure("Planarity", marks, x, y, lying=True, legend="above")]
