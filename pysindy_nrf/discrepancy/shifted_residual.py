"""What a place gains by chance: on the residual of a model, shifted in time.

The shifted residual has the spectrum and the size of the real one, and no tie to the
motion.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..exceptions import NRFError
from ..records.dataset import Dataset
from .fitted_model import FittedModel


@dataclass(frozen=True)
class ShiftSettings:
    """Numbers of the comparison with a shifted residual."""

    # Draws, and how many of them an effect must exceed. One in four may be near the
    # residual as it is, where a test repeats itself.
    draws: int = 4
    exceeded: int = 3
    # Least shift, as a share of the record.
    least_shift: float = 0.1


SHIFT = ShiftSettings()


def shifted_models(
    model: FittedModel, rng: np.random.Generator
) -> Iterator[FittedModel]:
    """The model on records whose residual was shifted by a random time."""
    data = model.spectra.data
    chain_model = model.chain_model()
    try:
        along = chain_model.balance_forces(data.data)
    except NRFError:
        return
    for _ in range(SHIFT.draws):
        share = rng.uniform(SHIFT.least_shift, 1.0 - SHIFT.least_shift)
        segments = []
        for segment, force in zip(data.data.segments, along):
            F = np.array(segment.F, dtype=float)
            residual = F[segment.valid] - force
            shift = int(share * len(residual))
            F[segment.valid] = force + np.roll(residual, shift, axis=0)
            segments.append(replace(segment, F=F))
        shifted = Dataset(segments, data.data.n_samples)
        try:
            yield model.on_motions(shifted)
        except NRFError:
            continue
