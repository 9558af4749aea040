"""Channels of one contiguous record by name, as the fusion needs them."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from ...exceptions import ChannelError
from ..channels import as_matrix, finite_span
from ..checks.transfer_function import ORDERS
from ..clock import times_of_table
from ..record import Record
from ..zero_phase_filter import check_rate
from .block_fusion import ChannelSet, fuse_motions
from .dof_fusion import DofKnowledge

TIME_NAMES = ("t", "time")
MOTION_NAME = re.compile(r"([avx])_?(\d+)")
# Range over largest magnitude below which a channel is constant.
CONSTANT_RANGE = 1e-12
# The rate of a table and that of the smoother may differ by this share.
RATE_TOLERANCE = 0.01


@dataclass(frozen=True)
class ChannelTable:
    """Channels of one contiguous record.

    Attributes
    ----------
    names : list of str
        Of all columns, the time included, in the order given.
    columns : dict of str to ndarray of shape (n_samples,)
        All channels.
    fs : float
        Sampling rate, Hz.
    absolute : bool
        Whether velocities and displacements are absolute.
    measured : dict of str to ndarray
        Channels that are not NaN throughout, inside the NaN edges.
    span : slice
        Rows inside the NaN edges.
    """

    names: list[str]
    columns: dict[str, np.ndarray]
    fs: float
    absolute: bool
    measured: dict[str, np.ndarray]
    span: slice

    @classmethod
    def from_record(cls, record: Record, fs: float | None = None) -> ChannelTable:
        """Channels of a record; ``fs`` is a rate that it must have."""
        rate = _checked_rate(record.fs, fs)
        absolute = record.coordinates == "absolute"
        where = f"record {record.name!r}"
        return cls._checked(record.channels(), rate, absolute, where)

    @classmethod
    def from_frame(cls, table: pd.DataFrame, fs: float | None = None) -> ChannelTable:
        """Columns of a table, with the rate of its clock or ``fs``."""
        if len(table) == 0:
            raise ChannelError("X has no samples (0 rows)", "Give a record.")
        columns = {str(name): table.iloc[:, i] for i, name in enumerate(table.columns)}
        rate = _checked_rate(_rate_of_clock(table), fs)
        return cls._checked(columns, rate, absolute=False, where="")

    @classmethod
    def _checked(
        cls, channels: Mapping[str, ArrayLike], fs: float, absolute: bool, where: str
    ) -> ChannelTable:
        columns = {
            name: np.asarray(as_matrix(values, [name], 1)[:, 0], float)
            for name, values in channels.items()
            if name not in TIME_NAMES
        }
        known = {
            name: values
            for name, values in columns.items()
            if not (np.isnan(values[0]) and np.isnan(values).all())
        }
        span = finite_span(list(known.values()), list(known), where)
        measured = {name: values[span] for name, values in known.items()}
        return cls(list(channels), columns, fs, absolute, measured, span)

    @property
    def n_samples(self) -> int:
        """Samples inside the NaN edges."""
        return self.span.stop - self.span.start

    @cached_property
    def motions(self) -> dict[int, dict[str, str]]:
        """By DOF, in rising order, the names of its measured channels by kind."""
        by_dof: dict[int, dict[str, str]] = {}
        for name in self.measured:
            match = MOTION_NAME.fullmatch(name)
            if match:
                by_dof.setdefault(int(match[2]), {})[match[1]] = name
        return dict(sorted(by_dof.items()))

    @cached_property
    def base(self) -> np.ndarray:
        """Acceleration of the base against which velocities and displacements are
        measured, m/s^2: measured, or derived from its velocity or displacement.
        """
        still = np.zeros(self.n_samples)
        if self.absolute:
            return still
        if "ag" in self.measured:
            return self.measured["ag"]
        if "vg" not in self.measured and "xg" not in self.measured:
            return still
        vg = self.measured.get("vg")
        rate = None if vg is None else vg / self.fs
        ground = ChannelSet([[self.measured.get("xg"), rate, None]])
        fused = fuse_motions(ground, [DofKnowledge(np.full(3, np.nan))])
        return fused.motions[0].evaluate()[2] * self.fs**2

    def channels_of(self, dof: int) -> list[np.ndarray | None]:
        """Displacement, velocity and acceleration of a DOF against the base."""
        names = self.motions[dof]
        channels = [
            self.measured[names[kind]] if kind in names else None for kind in ORDERS
        ]
        if channels[2] is not None and self.base.any():
            channels[2] = channels[2] - self.base
        return channels

    def require_moving(self) -> None:
        """Raise an error for constant channels, which would pass for perfect ones; a
        DOF of zeros is at rest.
        """
        for dof, names in self.motions.items():
            channels = {name: self.measured[name] for name in names.values()}
            if not any(values.any() for values in channels.values()):
                continue
            for name, values in channels.items():
                low, high = values.min(), values.max()
                if high - low <= CONSTANT_RANGE * max(-low, high):
                    raise ChannelError(
                        f"Channel {name} of DOF {dof} is constant",
                        "A dead sensor, or a record without motion; leave the channel"
                        " out (a column of NaN), or excite the structure.",
                    )

    @property
    def other_channels(self) -> dict[str, np.ndarray]:
        """Measured channels that are not motions of a DOF, inside the NaN edges."""
        motions = {name for names in self.motions.values() for name in names.values()}
        return {k: values for k, values in self.measured.items() if k not in motions}

    @property
    def unmeasured(self) -> dict[str, np.ndarray]:
        """Channels that are NaN throughout and will not be made up from others."""
        made = {f"{kind}{j}" for kind in ORDERS for j in self.motions}
        return {
            name: values
            for name, values in self.columns.items()
            if name not in self.measured and name not in made
        }

    def in_all_rows(self, values: np.ndarray) -> np.ndarray:
        """Values inside the NaN edges in rows of the entire record."""
        n_rows = len(next(iter(self.columns.values())))
        if self.span == slice(0, n_rows):
            return values
        out = np.full((n_rows, *values.shape[1:]), np.nan)
        out[self.span] = values
        return out


def _rate_of_clock(table: pd.DataFrame) -> float | None:
    """Sampling rate of a time column or index, Hz; None if there is none."""
    name = next((name for name in TIME_NAMES if name in table), None)
    column = None if name is None else table[name].to_numpy()
    seconds = times_of_table(table, column)
    if seconds is None:
        return None
    return Record(displacement=np.zeros(len(table)), time=seconds).fs


def _checked_rate(rate: float | None, fs: float | None) -> float:
    """The rate of the data, or the one given for data without a clock."""
    if rate is None:
        rate = fs
    if rate is None:
        raise ChannelError(
            "The sampling rate is unknown",
            "Give KinematicSmoother(fs=...) in Hz, or a table with a time column t.",
        )
    if fs is not None and abs(float(fs) - rate) > RATE_TOLERANCE * rate:
        raise ChannelError(
            f"fs={fs} Hz contradicts the clock of the data, {rate:g} Hz",
            "Leave fs out.",
        )
    return check_rate(rate)
