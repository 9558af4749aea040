"""Named scorers of identified chains.

They serve scikit-learn's searches and :func:`select_order`:

- ``scorers.balance``: minus the pooled balance error (one step), percent NRMSE;
- ``scorers.acceleration``: R^2 of the accelerations the model predicts, as
  ``NRFRegressor.score``;
- ``scorers.free_run``: minus the error of the displacements that the model reaches
  alone under the measured forces, from the measured first state, percent NRMSE.

:func:`select_order` knows them by name; scikit-learn's searches take the objects,
``scoring=scorers.balance``. Greater is better in all three; the band is the
regressor's. scikit-learn's own ``scoring="r2"`` compares forces, which are zero on
unforced DOFs: it means little under incomplete excitation.

With ``sklearn.set_config(enable_metadata_routing=True)`` record ids, time, base
acceleration and covariates that are passed to ``cross_validate`` or to the ``fit`` of a
search reach these scorers without further request; a pipeline's own steps must have
requested what they need.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike
from sklearn.pipeline import Pipeline
from sklearn.utils.metadata_routing import MetadataRequest

from ..equations.free_runs import free_run_error
from ..exceptions import ChannelError, NRFError
from ..records.dataset import BlockRows
from ..records.zero_phase_filter import filters_of

if TYPE_CHECKING:
    from ..identification.regressor import NRFRegressor

__all__ = ["acceleration", "balance", "free_run"]


class Metadata(TypedDict, total=False):
    """What comes with the data, as in ``NRFRegressor.fit``."""

    record: ArrayLike
    time: ArrayLike
    base_acceleration: ArrayLike
    covariates: Mapping[str, ArrayLike]


class ChainScorer:
    """A scorer that scikit-learn accepts; greater is better.

    It passes records, time and covariates on.
    """

    def __init__(self, name: str, judge: Callable[..., float]) -> None:
        self.name = name
        self.judge = judge

    def __call__(
        self, estimator: object, X: object, y: object = None, **metadata: object
    ) -> float:
        """Score a fitted regressor, or a pipeline that ends in one."""
        passed = {name: value for name, value in metadata.items() if value is not None}
        while isinstance(estimator, Pipeline):
            X = _transformed(estimator[:-1], X, passed)
            estimator = estimator[-1]
        if not hasattr(estimator, "balance_errors"):
            what = f"{type(estimator).__name__} is not a chain regressor"
            cure = "These scorers judge NRFRegressor, alone or last in a Pipeline."
            raise NRFError(what, cure)
        return self.judge(estimator, X, y, **passed)

    def get_metadata_routing(self) -> MetadataRequest:
        """What scikit-learn passes."""
        request = MetadataRequest(owner=self)
        for name in Metadata.__annotations__:
            request.score.add_request(param=name, alias=True)
        return request

    def __repr__(self) -> str:
        return f"scorers.{self.name}"


def _transformed(steps: Pipeline, X: object, metadata: Mapping[str, object]) -> object:
    """Data behind the first steps of a pipeline."""
    if not len(steps):
        return X
    consumed = {}
    if metadata:
        routing = steps.get_metadata_routing()
        for name in routing.consumes("transform", metadata):
            consumed[name] = metadata[name]
    return steps.transform(X, **consumed)


def _balance(
    regressor: NRFRegressor, X: object, F: object = None, **metadata: Unpack[Metadata]
) -> float:
    return -float(regressor.balance_errors(X, F, **metadata).loc["pooled", "error"])


def _acceleration(
    regressor: NRFRegressor, X: object, F: object = None, **metadata: Unpack[Metadata]
) -> float:
    return float(regressor.score(X, F, **metadata))


def _free_run(
    regressor: NRFRegressor, X: object, F: object = None, **metadata: Unpack[Metadata]
) -> float:
    data = regressor.dataset(X, F, **metadata)
    if any(segment.dt is None for segment in data.segments):
        what = "The free run needs the time of the samples"
        raise ChannelError(what, "Pass dt= (s), time=, or X with a time index.")

    blocks = []
    for i, segment in enumerate(data.segments):
        blocks.append(BlockRows(i, slice(0, segment.n_valid)))
    filters = filters_of(regressor.band, data)
    error = free_run_error(regressor.model_, data, filters, blocks)
    return -error if np.isfinite(error) else float("nan")


balance = ChainScorer("balance", _balance)
acceleration = ChainScorer("acceleration", _acceleration)
free_run = ChainScorer("free_run", _free_run)
