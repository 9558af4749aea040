"""A null reference: the same search on data that hold no effect but the same noise."""

from __future__ import annotations

import warnings
from functools import cached_property
from typing import Any

import numpy as np

from ..exceptions import NRFError
from ..model import ChainModel
from ..record import Record
from ..segments import Segment
from .gate import FLOOR, gain_of
from .prepare import Prepared, prepare
from .search import Finding, refine, screen, validate
from .sensors import SensorFinding, null_gain
from .splits import BlockRows
from .stage import Stage
from .workspace import Workspace

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


class Null:
    """What the search would see if a model were the whole truth: its own free run with fresh noise.

    Parameters
    ----------
    ready : Prepared
        The measured records.
    stage : Stage
        The model.
    rng : numpy Generator
    count : int
        Surrogates.
    """

    def __init__(self, ready: Prepared, stage: Stage, rng: np.random.Generator, count: int) -> None:
        self.ready, self.stage, self.rng, self.count = ready, stage, rng, count

    @cached_property
    def stages(self) -> list[Stage]:
        """The same laws on surrogate records; empty where no free run is possible."""
        try:
            model = self.stage.trial().model()
            return [self._one(model) for _ in range(self.count)] if (model.masses > 0).all() else []
        except (NRFError, np.linalg.LinAlgError):
            return []

    def _one(self, model: ChainModel) -> Stage:
        ready, work = self.ready, self.stage.work
        fakes = [
            surrogate(ready.records[i], work.data.segments[i], model, ready.noise[i], self.rng) for i in work.searched
        ]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what is to be said of the channels was said of the measured ones
            data = prepare(fakes, noise=[ready.noise[i] for i in work.searched]).data
        blocks = []
        for number, i in enumerate(work.searched):
            seg = data.segments[number]
            for b in (b for b in work.search if b.segment == i):
                stop = min(b.rows.stop, seg.valid.stop - seg.valid.start)
                blocks.append(BlockRows(number, slice(min(b.rows.start, stop), stop)))
        filters = [work.filters[i] for i in work.searched]
        fake = Workspace(data, filters, blocks, [], work.known_masses, work.strategy)
        return Stage(fake, self.stage.chain, self.stage.laws)

    @property
    def floor(self) -> float:
        """Median validation error that noise alone leaves, percent; NaN if unknown."""
        values = [float(np.median(stage.trial().fold_errors())) for stage in self.stages]
        return float(np.median(values)) if values else float("nan")

    def gain(self, finding: Finding) -> float:
        """Largest gain of a candidate where it does not act; zero if unknown."""
        gains = [0.0]
        for stage in self.stages:
            try:
                if isinstance(finding, SensorFinding):
                    gains.append(null_gain(stage, finding))
                    continue
                before = stage.trial().fold_errors()
                best = screen(stage, [finding.candidate])
                tried = validate(stage, refine(stage, best[0], 20)) if best else None
                gains.append(gain_of(before, tried.folds) if tried is not None and np.median(before) > FLOOR else 0.0)
            except NRFError:
                continue
        return max(gains)
