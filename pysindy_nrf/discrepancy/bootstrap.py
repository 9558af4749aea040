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
from ..signals.noise_levels import levels_of, noisy_base, quiet_drive
from .prepare import Prepared, Workspace, prepare
from .ruler import Ruler, Trial
from .windows import Windows

_MOTIONS = ("acceleration", "velocity", "displacement")


def simulated(ready: Prepared, trial: Trial, rng: np.random.Generator) -> Ruler | None:
    """The ruler on records that the model of a trial, freed of the bias of noise, would have produced.

    The bias is found by the bootstrap itself (Efron and Tibshirani 1993, chapter 10): what the fit makes of records
    that the model produced, less the model. None where the model has no free run.
    """
    first = _produced(ready, trial, trial.model(), rng)
    if first is None:
        return None
    try:
        again = Trial(first, trial.base, trial.laws)
    except NRFError:
        return first
    unbiased = trial.model_at(2 * trial.masses[0] - again.masses[0], 2 * trial.theta[0] - again.theta[0])
    return _produced(ready, trial, unbiased, rng) or first


def _produced(ready: Prepared, trial: Trial, model: ChainModel, rng: np.random.Generator) -> Ruler | None:
    """The ruler on a free run of a model with the noise of the channels; None where there is none."""
    work = trial.ruler.work
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
    other = Windows(data, blocks, windows.length, windows.edges, windows.centred)
    return Ruler(fake, other, trial.ruler.informative, trial.ruler.clear)


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
