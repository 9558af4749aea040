"""TDMS files of LabVIEW."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ....common.lazy import require
from ..table import MAX_BYTES, Table, check_size, reading_as


def read_tdms(path: Path, max_bytes: int = MAX_BYTES) -> Table:
    """Read the channels of a TDMS file, their units and their sampling rate."""
    nptdms = require("nptdms", "files", "Reading TDMS files")
    check_size(path, path.stat().st_size, max_bytes)

    variables: dict[str, np.ndarray] = {}
    units: dict[str, str] = {}
    steps = set()
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
            steps.add(float(channel.properties.get("wf_increment", 0.0)))

    fs = None
    if len(steps) == 1 and 0.0 not in steps:
        fs = 1.0 / steps.pop()
    return Table(path, "TDMS", variables, units, fs=fs)


def _unit_of(properties: Mapping[str, object]) -> str:
    """Unit of a channel, under either of the names that LabVIEW uses."""
    fallback = properties.get("NI_UnitDescription", "")
    return str(properties.get("unit_string", fallback))
