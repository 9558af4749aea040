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
    if not needed & {"ag", "vg"}:
        return model.segments(list(records))

    with_base = []
    for record in records:
        with_base.append(record.replace(covariates=covariates_with_base(record)))
    return model.segments(with_base)


def covariates_with_base(record: Record) -> dict[str, np.ndarray]:
    """Measured covariates, and the motion of a base that moves as ``ag`` and ``vg``.

    Parameters
    ----------
    record : Record

    Returns
    -------
    dict of str to ndarray of shape (n_samples,)
        The velocity of the base is as measured, or from its displacement or
        acceleration. Covariates of the same names come first.
    """
    covariates = dict(record.covariates)
    acceleration = base_acceleration_if_any(record)
    if not record.base_moves or acceleration is None:
        return covariates

    if record.base_velocity is not None:
        velocity = record.base_velocity
    elif record.base_displacement is not None:
        velocity = base_motion(record, record)[0]
    else:
        velocity = integrate(acceleration, record.dt)
    covariates.setdefault("ag", acceleration)
    covariates.setdefault("vg", velocity)
    return covariates
