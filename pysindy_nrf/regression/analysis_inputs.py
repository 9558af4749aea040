"""What the functions of this folder accept: fitted regressors or models, data as for ``predict``."""

from __future__ import annotations

import numpy as np
import pandas as pd

from .chain_model import ChainModel, as_model, as_segments
from .segments import SegmentSet

__all__ = ["as_model", "as_segments", "frame", "storey_names"]


def storey_names(model: ChainModel) -> list[str]:
    """``storey 1`` .. ``storey n``."""
    return [f"storey {i}" for i in range(1, model.n_dof + 1)]


def frame(data: SegmentSet, parts: list[np.ndarray], columns: list[str]) -> pd.DataFrame:
    """A table of the rows the user passed, indexed by time where it is known."""
    times = [np.full(seg.n_samples, np.nan) if seg.t is None else seg.t for seg in data.segments]
    known = all(seg.t is not None for seg in data.segments)
    index = pd.Index(np.concatenate(times), name="t") if known else pd.RangeIndex(data.n_samples, name="sample")
    return pd.DataFrame(data.scatter(parts), index=index, columns=columns)
