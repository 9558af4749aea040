"""How far a storey's restoring-force surface is from a plane, against what noise alone would show.

The paper reads the location of its dampers off the surfaces: "linear" storeys are planar. Coefficients
alone cannot tell, for a planar storey may carry cubic terms of 1e9 N/m^3 that do nothing
at drifts of a millimetre.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from ..common.random_state import generator
from ..exceptions import ChainError
from ..laws import Dahl, PowerSeries
from ..regression.chain_model import as_model, as_segments, storey_names
from ..regression.segments import SegmentSet

LEAST = 1.0  # percent of its force; a surface flatter than this is called planar whatever the noise
_BLOCKS = 40


def planarity(
    estimator: Any, X: Any, F: Any = None, *, draws: int = 20, random_state: Any = None, **options: Any
) -> pd.DataFrame:
    """Planarity index of every storey, with a noise reference.

    The index is the share of the storey's force along the data, percent of its rms, that the best
    plane ``c v + k s`` does not hold. Its reference is the index that noise of the size and
    course of the balances' residuals gives a planar storey: the residuals are added to the
    identified balances with random signs in consecutive blocks (wild bootstrap), the chain is solved again, and the
    95 % quantile is taken of what the coefficients' scatter does to the surface.

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
        One row for each storey: ``index``, ``reference`` (percent; NaN without draws), ``planar``
        (bool: the index is below the reference or below 1 %).

    Examples
    --------
    >>> from pysindy_nrf import NRFRegressor, datasets
    >>> from pysindy_nrf.estimation import planarity
    >>> X, F = datasets.load_demo().to_features()  # a cubic spring in storey 1, the others linear
    >>> table = planarity(NRFRegressor(degree=3).fit(X, F), X, F, draws=3, random_state=0)
    >>> table["planar"].tolist()
    [False, True, True]
    """
    model = as_model(estimator)
    data = as_segments(estimator, X, F, **options)
    forces = [model.restoring_force(data)[seg.rows][seg.valid] for seg in data.segments]
    index, scale = _off_plane(data, forces)
    reference = np.full(model.n_dof, np.nan)
    if draws and hasattr(estimator, "walk_"):
        reference = _reference(estimator, data, scale, draws, random_state)
    planar = index < np.fmax(reference, LEAST)
    return pd.DataFrame({"index": index, "reference": reference, "planar": planar}, index=storey_names(model))


@dataclass
class Location:
    """Where the nonlinearity is.

    Attributes
    ----------
    storeys : list of str
        Storeys that are not planar, in the order in which they were explained.
    first : DataFrame
        :func:`planarity` of the regressor as given.
    last : DataFrame
        The same after the storeys found were given a hysteretic law: the others are planar now.
    estimator : NRFRegressor
        Fitted, with these laws.

    Examples
    --------
    >>> import pandas as pd
    >>> from pysindy_nrf.estimation import Location
    >>> index = ["storey 1", "storey 2"]
    >>> first = pd.DataFrame({"index": [21.0, 6.0], "reference": [2.1, 2.0], "planar": [False, False]}, index)
    >>> last = pd.DataFrame({"index": [0.8, 0.9], "reference": [2.1, 2.0], "planar": [True, True]}, index)
    >>> found = Location(["storey 1"], first, last, None)  # its hysteresis had bent the neighbour's surface too
    >>> found.storeys, found.last["planar"].all().item()
    (['storey 1'], True)
    """

    storeys: list[str]
    first: pd.DataFrame
    last: pd.DataFrame
    estimator: Any

    def __str__(self) -> str:
        if not self.storeys:
            return "Every storey is planar."
        return f"The nonlinearity is in {' and '.join(self.storeys)}; the other storeys are planar."


def locate_nonlinearity(
    estimator: Any, X: Any, F: Any = None, *, draws: int = 20, random_state: Any = None, **options: Any
) -> Location:
    """The storeys whose restoring force is not planar.

    A hysteretic storey that a power series cannot hold biases its neighbours, whose surfaces then bend too.
    So the least planar storey is given a law that can hold it (its power series and a Dahl law),
    the chain is solved again, and only storeys that are still not planar are looked at further.

    Parameters
    ----------
    estimator : fitted NRFRegressor
        With power series in every storey (``degree=3``).
    X, F, **options
        The data it was fitted to.
    draws : int
    random_state : int or None

    Returns
    -------
    Location

    Raises
    ------
    ChainError
        If the estimator is not a fitted NRFRegressor: further laws are tried with its settings.

    Examples
    --------
    >>> from pysindy_nrf import ChainModel, NRFRegressor, excitation, laws, simulate
    >>> from pysindy_nrf.estimation import locate_nonlinearity
    >>> frame = ChainModel([10.0, 10.0], {f"storey {i}": laws.PowerSeries(1, [100.0, 1e5]) for i in (1, 2)})
    >>> F = excitation.band_limited_random(2, 4.0, 500.0, dofs=2, rms=50.0, band=(1, 60), random_state=0)
    >>> X, F = simulate(frame, F, 0.002).to_features(smooth=False)
    >>> found = locate_nonlinearity(NRFRegressor(degree=3).fit(X, F), X, F, draws=3, random_state=0)
    >>> found.storeys, found.first["planar"].tolist()  # a linear frame
    ([], [True, True])
    """
    from sklearn.base import clone

    if not hasattr(estimator, "walk_"):
        raise ChainError(
            "The location of the nonlinearity needs the data's own regressor", "Give a fitted NRFRegressor."
        )
    first = last = planarity(estimator, X, F, draws=draws, random_state=random_state, **options)
    found: list[str] = []
    laws = dict(estimator.laws or {})
    model = estimator.model_
    while not last.drop(index=found)["planar"].all():
        open_ = last.drop(index=found)
        worst = str(open_.loc[~open_["planar"], "index"].idxmax())
        found.append(worst)
        own = tuple(law for law in model.laws[model.chain.site(worst)])
        laws[worst] = (
            (*(law for law in own if not (law.has_memory or law.jumps)), Dahl()) if own else (PowerSeries(1), Dahl())
        )
        orders = {
            s: o
            for s, o in dict(estimator.orders or {}).items()
            if model.chain.site(s) not in map(model.chain.site, laws)
        }
        estimator = clone(estimator).set_params(laws=laws, orders=orders or None).fit(X, F, **options)
        last = planarity(estimator, X, F, draws=draws, random_state=random_state, **options)
    return Location(found, first, last, estimator)


def _off_plane(data: SegmentSet, forces: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Share of forces that the best plane does not hold (percent), and their rms."""
    R = np.concatenate(forces)
    off, size = np.empty(R.shape[1]), np.empty(R.shape[1])
    for i in range(R.shape[1]):
        plane = np.column_stack(
            [np.concatenate([getattr(seg, key)[seg.valid, i] for seg in data.segments]) for key in "vs"]
        )
        plane = plane / (np.sqrt((plane**2).mean(axis=0)) + np.finfo(float).tiny)
        rest = R[:, i] - plane @ np.linalg.lstsq(plane, R[:, i], rcond=None)[0]
        off[i], size[i] = np.sqrt(np.mean(rest**2)), np.sqrt(np.mean(R[:, i] ** 2))
    return 100.0 * off / np.where(size > 0, size, 1.0), size


def _reference(estimator: Any, data: SegmentSet, scale: np.ndarray, draws: int, random_state: Any) -> np.ndarray:
    rng = generator(random_state)
    model = estimator.model_
    implied = model.balance_forces(data)
    found = [model.restoring_force(data)[seg.rows][seg.valid] for seg in data.segments]
    values = []
    for _ in range(draws):
        segments = []
        for seg, left in zip(data.segments, implied):
            n = len(left)
            signs = rng.choice([-1.0, 1.0], size=_BLOCKS)[np.minimum(np.arange(n) * _BLOCKS // n, _BLOCKS - 1)]
            force = seg.F.copy()
            force[seg.valid] = left + signs[:, None] * (seg.F[seg.valid] - left)
            segments.append(replace(seg, F=force))
        again = SegmentSet(segments, data.n_samples)
        other = estimator.problem_.solve(again).model
        change = [other.restoring_force(data)[seg.rows][seg.valid] - R for seg, R in zip(data.segments, found)]
        share, size = _off_plane(data, change)
        values.append(share * size / scale)
    return np.quantile(values, 0.95, axis=0)
