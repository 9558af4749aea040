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

from collections.abc import Callable
from typing import Any

import numpy as np
from sklearn.utils.metadata_routing import MetadataRequest

from ..equations.free_runs import free_run_error
from ..exceptions import ChannelError, NRFError
from ..records.dataset import BlockRows
from ..records.zero_phase_filter import filters_of

__all__ = ["acceleration", "balance", "free_run"]


class ChainScorer:
    """A scorer that scikit-learn accepts; greater is better.

    It passes records, time and covariates on.
    """

    def __init__(self, name: str, judge: Callable[..., float]) -> None:
        self.name, self.judge = name, judge

    def __call__(self, estimator: Any, X: Any, y: Any = None, **metadata: Any) -> float:
        """Score a fitted regressor, or a pipeline that ends in one."""
        given = {name: value for name, value in metadata.items() if value is not None}
        while hasattr(estimator, "steps"):
            X = _transformed(estimator[:-1], X, given)
            estimator = estimator[-1]
        if not hasattr(estimator, "balance_errors"):
            what = f"{type(estimator).__name__} is not a chain regressor"
            cure = "These scorers judge NRFRegressor, alone or last in a Pipeline."
            raise NRFError(what, cure)
        return self.judge(estimator, X, y, **given)

    def get_metadata_routing(self) -> MetadataRequest:
        """What scikit-learn passes."""
        request = MetadataRequest(owner=self)
        for name in ("record", "time", "base_acceleration", "covariates"):
            request.score.add_request(param=name, alias=True)
        return request

    def __repr__(self) -> str:
        return f"scorers.{self.name}"


def _transformed(steps: Any, X: Any, metadata: dict[str, Any]) -> Any:
    """Data behind the first steps of a pipeline."""
    if not len(steps):
        return X
    consumed: dict[str, Any] = {}
    if metadata:
        routing = steps.get_metadata_routing()
        for name in routing.consumes("transform", metadata):
            consumed[name] = metadata[name]
    return steps.transform(X, **consumed)


def _balance(regressor: Any, X: Any, F: Any = None, **metadata: Any) -> float:
    return -float(regressor.balance_errors(X, F, **metadata).loc["pooled", "error"])


def _acceleration(regressor: Any, X: Any, F: Any = None, **metadata: Any) -> float:
    return float(regressor.score(X, F, **metadata))


def _free_run(regressor: Any, X: Any, F: Any = None, **metadata: Any) -> float:
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
