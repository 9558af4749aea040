"""Parametric bootstrap: records as a model would have produced them, with the noise of the measured channels."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import numpy as np

from ..data.record import Record
from ..exceptions import NRFError
from ..regression.chain_model import ChainModel
from ..regression.errors import free_run_of
from ..regression.segments import BlockRows, Segment
from ..signals.kinematics import base_acceleration_if_any
from .noise_level import levels_of, noisy_base, quiet_drive
from .prepare import Prepared, prepare
from .ruler import Ruler, Trial
from .spectra import Windows
from .workspace import Workspace

_MOTIONS = ("acceleration", "velocity", "displacement")


def simulated(ready: Prepared, trial: Trial, rng: np.random.Generator) -> Ruler | None:
    """The ruler on records that the model of a trial would have produced; None where it has no free run."""
    work = trial.ruler.work
    model = trial.model()
    if (model.masses <= 0).any():
        return None
    fakes = []
    try:
        for i in work.searched:
            levels = levels_of(ready.records[i], ready.noise[i], work.seen_rows(i))
            fakes.append(_record(ready.records[i], work.data.segments[i], model, levels, rng))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what is to be said of the channels was said of the measured ones
            known, bands = ([one[i] for i in work.searched] for one in (ready.noise, ready.bands))
            data = prepare(fakes, noise=known, bands=bands).data
    except NRFError:
        return None
    blocks = []
    for number, i in enumerate(work.searched):
        valid = data.segments[number].valid
        later = work.data.segments[i].valid.start - valid.start  # blocks count from the first valid row
        for b in (b for b in work.search if b.segment == i):
            ends = (min(max(row + later, 0), valid.stop - valid.start) for row in (b.rows.start, b.rows.stop))
            blocks.append(BlockRows(number, slice(*ends)))
    fake = Workspace(data, blocks, [], work.known_masses, work.strategy)
    windows = trial.ruler.windows
    return replace_ruler(trial.ruler, fake, Windows(data, blocks, windows.length, windows.edges, windows.centred))


def replace_ruler(ruler: Ruler, work: Workspace, windows: Windows) -> Ruler:
    """The bands of a ruler on other data."""
    return Ruler(work, windows, ruler.informative, ruler.clear)


def _record(
    record: Record, segment: Segment, model: ChainModel, noise: dict[str, float], rng: np.random.Generator
) -> Record:
    """The record the model would have produced, with fresh noise on the channels that were measured."""
    rows = _measured_rows(record)
    rest = np.zeros(record.n_dof)
    start = None if rows == segment.valid else (rest, rest)  # fusion left out the ends
    quiet = quiet_drive(record, noise)
    driven = replace(segment, F=np.nan_to_num(quiet.force), ag=base_acceleration_if_any(quiet))
    run = free_run_of(model, driven, rows, record.dt, start)
    changes: dict[str, Any] = {}
    for key, prefix in zip(_MOTIONS, "avx"):
        measured = getattr(record, key)
        if measured is None:
            continue
        own = np.array(getattr(run, key), dtype=float)
        for j in range(record.n_dof):
            own[:, j] += noise.get(f"{prefix}{j + 1}", 0.0) * rng.standard_normal(len(own))
            if np.isnan(measured[:, j]).all():
                own[:, j] = np.nan
        changes[key] = np.full(measured.shape, np.nan)
        changes[key][rows] = own
    changes |= noisy_base(quiet, noise, rng)
    changes["force"] = quiet.force + rng.standard_normal(record.force.shape) * [
        noise.get(f"F{j + 1}", 0.0) for j in range(record.n_dof)
    ]
    return quiet.replace(coordinates="relative", **changes)


def _measured_rows(record: Record) -> slice:
    """From the first to the last row in which all channels of the motion have a value."""
    known = np.ones(record.n_samples, dtype=bool)
    for key in _MOTIONS:
        measured = getattr(record, key)
        if measured is not None:
            used = ~np.isnan(measured).all(axis=0)
            known &= np.isfinite(measured[:, used]).all(axis=1)
    inside = np.flatnonzero(known)
    return slice(int(inside[0]), int(inside[-1]) + 1)
