"""Free runs of a model, with forces that leave what the measured motion leaves.

Least squares of a noisy motion is biased, by more the more laws it has. The motion of a
free run has no noise of the motion sensors. With forces ``F = f(run) + e``, where f are
the forces that the model asks for along the run and e its residual along the measured
motion, least squares is a step of instrumental variables:

    theta = theta_model + (Z^T Z)^-1 Z^T e

with Z the columns of the equations along the run. That holds as far as the run follows
the motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ..chain.model import ChainModel
from ..records.dataset import Dataset, Segment
from .free_runs import in_valid_rows, simulated


def residual_along(
    model: ChainModel, measured: Sequence[Segment], runs: Sequence[Segment]
) -> list[Segment]:
    """Free runs with the residuals of a model along the measured motion.

    Parameters
    ----------
    model : ChainModel
    measured, runs : sequence of Segment
        Record by record.
    """
    n_samples = sum(segment.n_samples for segment in measured)
    of_measured = model.balance_forces(Dataset(measured, n_samples))
    of_runs = model.balance_forces(Dataset(runs, n_samples))
    segments = []
    for segment, run, along, free in zip(measured, runs, of_measured, of_runs):
        residual = segment.F[segment.valid] - along
        segments.append(replace(run, F=in_valid_rows(segment, residual + free)))
    return segments


def free_of_noise(model: ChainModel, data: Dataset) -> Dataset:
    """The data with free runs of a model in place of the measured motion.

    Records with an unknown force, which no run can have, are left out. A run passes the
    low-pass filter of the fusion, as the measured motion did.

    Parameters
    ----------
    model : ChainModel
    data : Dataset
        Each DOF fused by itself, so that the noise does not depend on the motion.
    """
    measured = [segment for segment in data.segments if not segment.unknown]
    runs = [simulated(model, segment, limited=True) for segment in measured]
    return replace(data, segments=residual_along(model, measured, runs))
