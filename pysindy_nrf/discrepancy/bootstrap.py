"""Parametric bootstrap: records that a model would have produced, with fresh noise."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..chain.model import ChainModel
from ..equations.errors import free_run_of
from ..exceptions import NRFError
from ..records.dataset import BlockRows, Dataset, Segment
from ..records.fusion.kinematics import base_acceleration_if_any
from ..records.fusion.noise_levels import levels_of, noisy_base, quiet_drive
from ..records.record import Record
from .fitted_model import FittedModel
from .folds import Split
from .prepare import PreparedRecords, prepare
from .search_data import SearchData
from .spectra import BalanceSpectra

_MOTIONS = {"a": "acceleration", "v": "velocity", "x": "displacement"}


@dataclass(frozen=True)
class SimulatedRecords:
    """Records that a model produced, fused as the measured ones, and their spectra."""

    records: PreparedRecords
    spectra: BalanceSpectra


def simulated(
    records: PreparedRecords,
    model: FittedModel,
    rng: np.random.Generator,
    draws: int = 1,
) -> Iterator[SimulatedRecords]:
    """Records that the model, freed of the bias of noise, would have produced.

    There is no draw where the model has no free run.

    Notes
    -----
    The bootstrap itself finds the bias (Efron and Tibshirani 1993, chapter 10): what
    the fit makes of records that the model produced, less the model.
    """
    source = _Source(records, model, rng)
    first = source.draw(model.chain_model())
    if first is None:
        return
    try:
        again = model.refitted(first.spectra)
    except NRFError:
        yield first
        return

    unbiased = model.chain_model(
        2 * model.masses[0] - again.masses[0],
        2 * model.coefficients[0] - again.coefficients[0],
    )
    yield source.draw(unbiased) or first
    for _ in range(draws - 1):
        drawn = source.draw(unbiased)
        if drawn is not None:
            yield drawn


@dataclass(frozen=True)
class _Template:
    """What a simulated record takes from a measured one."""

    record: Record
    # Its forces and base motion freed of noise.
    quiet: Record
    segment: Segment
    # Of each channel, SI rms.
    noise: dict[str, float]


class _Source:
    """Draws records like those of a search."""

    def __init__(
        self, records: PreparedRecords, model: FittedModel, rng: np.random.Generator
    ) -> None:
        self.fitted = model
        self.data = model.spectra.data
        self.rng = rng
        self.fusion = [records.fusion[i] for i in self.data.searched]
        self.templates = []
        segments = model.data_with_offsets.data.segments
        for i in self.data.searched:
            record = records.records[i]
            searched = self.data.searched_rows(i)
            noise = levels_of(record, records.fusion[i].noise, searched)
            quiet = quiet_drive(record, noise)
            if segments[i].offsets is not None:
                # the drawn records have no wrong zeros
                quiet = quiet.replace(force=quiet.force - segments[i].offsets)
            segment = replace(segments[i], offsets=None)
            self.templates.append(_Template(record, quiet, segment, noise))

    def draw(self, model: ChainModel) -> SimulatedRecords | None:
        """Records of a model; None if it has no free run.

        Of an element without mass the measured motion and its force.
        """
        if model.masses.any() and (model.masses <= 0).any():
            return None
        try:
            made = [_record(template, model, self.rng) for template in self.templates]
            # warnings on channels were given for the measured ones
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                prepared = prepare(made, like=self.fusion)
        except NRFError:
            return None

        data = SearchData(
            prepared.data,
            Split(self._folds(prepared.data), []),
            self.data.known_masses,
            filters=[self.data.filters[i] for i in self.data.searched],
        )
        measured = self.fitted.spectra
        windows = measured.windows.over(data.search, data=data.data)
        spectra = BalanceSpectra(data, windows, measured.bands, strict=False)
        return SimulatedRecords(prepared, spectra)

    def _folds(self, simulated: Dataset) -> list[BlockRows]:
        """The folds of the search, counted from the first valid rows of the draws."""
        blocks = []
        for number, i in enumerate(self.data.searched):
            valid = simulated.segments[number].valid
            later = self.data.data.segments[i].valid.start - valid.start
            length = valid.stop - valid.start
            for block in self.data.search:
                if block.segment == i:
                    ends = np.array([block.rows.start, block.rows.stop]) + later
                    start, stop = np.clip(ends, 0, length).tolist()
                    blocks.append(BlockRows(number, slice(start, stop)))
        return blocks


def _record(template: _Template, model: ChainModel, rng: np.random.Generator) -> Record:
    """The record a model would have produced, with fresh noise."""
    record, noise = template.record, template.noise
    levels = [noise.get(f"F{j}", 0.0) for j in range(1, record.n_dof + 1)]
    scatter = rng.standard_normal(record.force.shape) * levels
    if not model.masses.any():
        force = np.array(record.force, dtype=float)
        segment = template.segment
        along = model.balance_forces(Dataset([segment], segment.n_samples))
        force[segment.valid] = along[0]
        return record.replace(force=force + scatter)

    changes = _noisy_motion(template, model, rng)
    changes |= noisy_base(template.quiet, noise, rng)
    changes["force"] = template.quiet.force + scatter
    return template.quiet.replace(coordinates="relative", **changes)


def _noisy_motion(
    template: _Template, model: ChainModel, rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """The free run of a model, as the channels of a record would read it."""
    record, quiet = template.record, template.quiet
    rows = _measured_rows(record)
    # fusion left out the ends
    at_rest = rows != template.segment.valid
    rest = np.zeros(record.n_dof)
    driven = replace(
        template.segment,
        F=np.nan_to_num(quiet.force),
        ag=base_acceleration_if_any(quiet),
    )
    start = (rest, rest) if at_rest else None
    run = free_run_of(model, driven, rows, record.dt, start)

    changes: dict[str, np.ndarray] = {}
    for kind, key in _MOTIONS.items():
        measured = getattr(record, key)
        if measured is None:
            continue
        motion = np.array(getattr(run, key), dtype=float)
        for j in range(record.n_dof):
            level = template.noise.get(f"{kind}{j + 1}", 0.0)
            motion[:, j] += level * rng.standard_normal(len(motion))
        motion[:, np.isnan(measured).all(axis=0)] = np.nan
        changes[key] = np.full(measured.shape, np.nan)
        changes[key][rows] = motion
    return changes


def _measured_rows(record: Record) -> slice:
    """From the first to the last row in which all motion channels have a value."""
    known = np.ones(record.n_samples, dtype=bool)
    for key in _MOTIONS.values():
        measured = getattr(record, key)
        if measured is not None:
            used = ~np.isnan(measured).all(axis=0)
            known &= np.isfinite(measured[:, used]).all(axis=1)
    inside = np.flatnonzero(known)
    return slice(int(inside[0]), int(inside[-1]) + 1)
