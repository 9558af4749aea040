"""Motions along which the laws of a model can be followed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..chain.model import ChainModel
from ..records.dataset import Dataset
from ..records.fusion import integrate
from ..records.fusion.kinematics import base_acceleration_if_any, base_motion
from ..records.record import Record


def motions_of(model: ChainModel, records: Sequence[Record]) -> Dataset:
    """Records fused to motions, with the motion of the base that laws of a model read.

    Parameters
    ----------
    model : ChainModel
    records : sequence of Record
    """
    needed: set[str] = set()
    for laws in model.laws.values():
        for law in laws:
            needed.update(law.covariates)
    return model.segments([_with_base(record, needed) for record in records])


def _with_base(record: Record, needed: set[str]) -> Record:
    """A record with what laws need of its base's motion among the covariates."""
    if not record.base_moves or not needed & {"ag", "vg"}:
        return record
    acceleration = base_acceleration_if_any(record)
    assert acceleration is not None  # the base moves
    if record.base_velocity is not None:
        velocity: np.ndarray = record.base_velocity
    elif record.base_displacement is not None:
        velocity = base_motion(record, record)[0]
    else:
        velocity = integrate(acceleration, record.dt)
    base = {"ag": acceleration, "vg": velocity}
    return record.replace(covariates=base | dict(record.covariates))
