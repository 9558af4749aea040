"""The residual of a model on the data that a search may see."""

from __future__ import annotations

from dataclasses import replace

from ...chain.model import ChainModel
from ..residual import Residual, residual_of
from .diagnosed_data import DiagnosedData


def residual_in(data: DiagnosedData, model: ChainModel) -> Residual:
    """Residual of a model on diagnosed data.

    Laws that remember the path follow it from the start of the record.
    """
    pieces, filters, numbers = data.cut()
    if not model.has_memory:
        return replace(residual_of(model, pieces, filters), columns=data.columns)

    along = model.site_forces(data.records)
    forces = []
    for number, piece in zip(numbers, pieces.segments):
        start = piece.valid.start - data.records.segments[number].valid.start
        forces.append(along[number][start : start + piece.n_valid])
    residual = residual_of(model, pieces, filters, forces)
    return replace(residual, columns=data.columns)
