"""A null reference: the same search on data that hold no effect but the same noise."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..model import ChainModel
from ..record import Record
from ..segments import Segment

_MOTIONS = ("acceleration", "velocity", "displacement")


def surrogate(
    record: Record, segment: Segment, model: ChainModel, noise: dict[str, float], rng: np.random.Generator
) -> Record:
    """The record the model would have produced, with fresh noise on the channels that were measured.

    Parameters
    ----------
    record : Record
        Its forces and base motion are used.
    segment : Segment
        The fused record; its first state is where the free run starts.
    model : ChainModel
    noise : dict of str to float
        Rms of the noise of each channel (``"a1"``, ``"x2"``, ...), SI units.
    rng : numpy Generator

    Returns
    -------
    Record

    Raises
    ------
    NRFError
        If the free run diverges.
    """
    row = segment.valid.start
    run = model.simulate(
        np.nan_to_num(record.force),
        record.dt,
        x0=np.cumsum(segment.s[row]),
        v0=np.cumsum(segment.v[row]),
        base_acceleration=segment.ag,
        covariates=segment.covariates or None,
    )
    changes: dict[str, Any] = {}
    for key, prefix in zip(_MOTIONS, "avx"):
        measured = getattr(record, key)
        if measured is None:
            continue
        values = np.array(getattr(run, key), dtype=float)
        for j in range(record.n_dof):
            level = noise.get(f"{prefix}{j + 1}", 0.0)
            values[:, j] += level * rng.standard_normal(len(values))
            if np.isnan(measured[:, j]).all():
                values[:, j] = np.nan
        changes[key] = values
    return record.replace(coordinates="relative", **changes)
