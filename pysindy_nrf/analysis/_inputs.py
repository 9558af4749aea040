"""What the functions of this folder accept: fitted regressors or models, data as for ``predict``."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from ..exceptions import ChainError
from ..model import ChainModel
from ..segments import SegmentSet


def as_model(thing: Any) -> ChainModel:
    """The model of a fitted regressor, or the model itself."""
    model = getattr(thing, "model_", thing)
    if not isinstance(model, ChainModel):
        raise ChainError(f"{type(thing).__name__} is not a chain model", "Give a fitted NRFRegressor or a ChainModel.")
    return model


def as_segments(thing: Any, X: Any, F: Any = None, **options: Any) -> SegmentSet:
    """Data cut into records, in the coordinates of the regressor."""
    model = as_model(thing)
    if hasattr(thing, "model_"):
        options = {"coordinates": thing.coordinates, "dt": thing.dt} | options
    return model.segments(X, F, **options)


def storey_names(model: ChainModel) -> list[str]:
    """``storey 1`` .. ``storey n``."""
    return [f"storey {i}" for i in range(1, model.n_dof + 1)]


def frame(data: SegmentSet, parts: list[np.ndarray], columns: list[str]) -> pd.DataFrame:
    """A table of the rows the user passed, indexed by time where it is known."""
    times = [np.full(seg.n_samples, np.nan) if seg.t is None else seg.t for seg in data.segments]
    known = all(seg.t is not None for seg in data.segments)
    index = pd.Index(np.concatenate(times), name="t") if known else pd.RangeIndex(data.n_samples, name="sample")
    return pd.DataFrame(data.scatter(parts), index=index, columns=columns)
