"""TDMS files of LabVIEW."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ....common.lazy import require
from ...clock import rate_of
from ..table import MAX_BYTES, Clock, Table, check_size, reading_as


def read_tdms(path: Path, max_bytes: int = MAX_BYTES) -> Table:
    """Read the channels of a TDMS file, their units and their sampling rate."""
    nptdms = require("nptdms", "files", "Reading TDMS files")
    check_size(path, path.stat().st_size, max_bytes)

    variables: dict[str, np.ndarray] = {}
    units: dict[str, str] = {}
    clocks: dict[str, Clock] = {}
    with reading_as(path, "TDMS"):
        groups = nptdms.TdmsFile.read(path).groups()
        channels = [channel for group in groups for channel in group.channels()]
        has_one_group = len({channel.group_name for channel in channels}) == 1

        for channel in channels:
            name = str(channel.name)
            if not has_one_group:
                name = f"{channel.group_name}.{name}"
            variables[name] = np.asarray(channel[:])
            unit = _unit_of(channel.properties)
            if unit:
                units[name] = unit
            clock = _clock_of(channel.properties)
            if clock is not None:
                clocks[name] = clock

    rates = {clock.fs for clock in clocks.values()}
    fs = rates.pop() if len(rates) == 1 and len(clocks) == len(variables) else None
    return Table(path, "TDMS", variables, units, fs=fs, clocks=clocks)


def _clock_of(properties: Mapping[str, Any]) -> Clock | None:
    """The clock of a waveform; None for a channel that is none."""
    step = float(properties.get("wf_increment", 0.0))
    if step <= 0:
        return None
    started = properties.get("wf_start_time")
    origin = None if started is None else np.datetime64(started, "ns")
    return Clock(rate_of(step), float(properties.get("wf_start_offset", 0.0)), origin)


def _unit_of(properties: Mapping[str, object]) -> str:
    """Unit of a channel, under either of the names that LabVIEW uses."""
    fallback = properties.get("NI_UnitDescription", "")
    return str(properties.get("unit_string", fallback))
