"""SEP005 dictionaries, the signal format of the SDyPy packages."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from ...common import number_of
from ...exceptions import ChannelError
from ..record import Record
from .attributes import Attributes, columns_of
from .reading import ReadingOptions, understand
from .table import Table
from .units import si_unit

_QUANTITIES = {"x": "d", "v": "v", "a": "a", "F": "f"}
_KEY = "pysindy_nrf"  # of the attributes of a record
MAX_TEXT_SHOWN = 40  # characters of a value in a message
MAX_CHANNELS_SHOWN = 3

Channel = Mapping[str, Any]  # arrays, texts and numbers by key


def to_sep005(record: Record) -> list[dict[str, object]]:
    """Convert a record to SEP005 dictionaries.

    Parameters
    ----------
    record : Record

    Returns
    -------
    list of dict
        One for each column: ``data`` (a copy), ``name``, ``unit_str``, ``fs``,
        ``quantity`` and ``group`` (the record's name); ``pysindy_nrf`` holds the
        record's attributes, by which :func:`from_sep005` restores it bit for bit.

    Raises
    ------
    ChannelError
        If a covariate has the name of another column.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf import Record, io
    >>> channels = io.to_sep005(
    ...     Record(acceleration=np.ones((3, 1)), fs=100.0, name="test 7")
    ... )
    >>> {
    ...     key: channels[1][key]
    ...     for key in ("name", "unit_str", "fs", "quantity", "group")
    ... }
    {'name': 'a1', 'unit_str': 'm/s^2', 'fs': 100.0, 'quantity': 'a', 'group': 'test 7'}
    >>> io.from_sep005(channels)
    Record('test 7': 1 DOF, 3 samples at 100 Hz (0.03 s), channels F1, a1)
    """
    attributes = Attributes.of_record(record)
    text = attributes.to_json()
    channels = []
    for name, line in columns_of(record).items():
        channel: dict[str, object] = {
            "data": line.copy(),
            "name": name,
            "unit_str": "",
            "fs": record.fs,
            "group": record.name,
            _KEY: text,
        }
        if name not in attributes.covariates:
            channel["unit_str"] = si_unit(name)
            channel["quantity"] = _QUANTITIES[name[0]]
        channels.append(channel)
    return channels


def from_sep005(
    channels: Sequence[Channel] | Channel, **options: Unpack[ReadingOptions]
) -> Record:
    """Convert SEP005 dictionaries to a record.

    Parameters
    ----------
    channels : sequence of dict
        ``data`` (n_samples,), ``name``, ``unit_str``, ``fs`` (Hz) or ``time`` (s),
        perhaps ``start_timestamp``.
    **options
        ``mapping``, ``units``, ``fs``, ``name``, ``coordinates``, ``hold`` as for
        :func:`read_record`. Units are those of ``unit_str`` unless others are given.

    Raises
    ------
    ChannelError
        If a dictionary lacks a key, or channels differ in clock, start or length.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf.records.files import from_sep005
    >>> t = np.arange(1000) / 200
    >>> channel = {
    ...     "data": np.sin(9 * t),
    ...     "name": "x1",
    ...     "unit_str": "mm",
    ...     "fs": 200.0,
    ... }
    >>> record = from_sep005([channel])
    >>> record.fs, round(float(record.displacement.max()), 6)  # m
    (200.0, 0.001)
    """
    channels = _listed(channels)
    variables: dict[str, np.ndarray] = {}
    units: dict[str, str] = {}
    for i, channel in enumerate(channels, 1):
        name = str(channel.get("name", f"number {i}"))
        _check_channel(channel, name)
        if name in variables:
            raise ChannelError(f"Two SEP005 channels are named {name!r}", "Rename one.")
        variables[name] = np.asarray(channel["data"])
        if channel["unit_str"]:
            units[name] = str(channel["unit_str"])

    _require_same(channels, "fs", "Resample them to one clock.")
    _require_same(channels, "start_timestamp", "Cut them to one start.")
    fs = _common_rate(channels)
    times = _common_times(channels, fs)
    if times is not None and "t" not in variables:
        variables = {"t": times} | variables

    start = channels[0].get("start_timestamp")
    table = Table(
        Path("SEP005"),
        "SEP005",
        variables,
        units,
        notes=(f"starts {start}",) if start else (),
        attributes=_own_attributes(channels, set(variables)),
        fs=fs,
    )
    return understand(table, **options).record


def _listed(channels: Sequence[Channel] | Channel) -> list[Channel]:
    """The channels, of which a single one need not be in a list."""
    listed = [channels] if isinstance(channels, Mapping) else list(channels)
    if not listed or not all(isinstance(channel, Mapping) for channel in listed):
        raise ChannelError(
            "No SEP005 channel was given",
            "Give a list of dictionaries with data, name, unit_str, fs.",
        )
    return listed


def _check_channel(channel: Channel, name: str) -> None:
    """Refuse a dictionary that lacks a key, or whose data are no line."""
    missing = [key for key in ("data", "name", "unit_str") if key not in channel]
    if "fs" not in channel and "time" not in channel:
        missing.append("fs or time")
    if missing:
        raise ChannelError(
            f"SEP005 channel {name!r} lacks {', '.join(missing)}", "Add it."
        )

    shape = np.shape(channel["data"])
    if len(shape) != 1:
        raise ChannelError(
            f"SEP005 channel {name!r} has data of the shape {shape}", "Give one line."
        )


def _require_same(channels: Sequence[Channel], key: str, cure: str) -> None:
    """Refuse channels in which a key has several values."""
    names = {str(c[key]): c["name"] for c in channels if c.get(key) is not None}
    if len(names) > 1:
        shown = list(names.items())[:MAX_CHANNELS_SHOWN]
        text = ", ".join(f"{name!r} {value}" for value, name in shown)
        raise ChannelError(f"The SEP005 channels differ in {key}: {text}", cure)


def _common_rate(channels: Sequence[Channel]) -> float | None:
    """The sampling rate, Hz; None if only times are given."""
    for channel in channels:
        if channel.get("fs") is None:
            continue
        rate = number_of(channel["fs"])
        if not 0 < rate < float("inf"):
            raise ChannelError(
                f"SEP005 channel {channel['name']!r} has fs ="
                f" {str(channel['fs'])[:MAX_TEXT_SHOWN]}",
                "Give Hz above 0.",
            )
        return rate
    return None


def _common_times(channels: Sequence[Channel], fs: float | None) -> np.ndarray | None:
    """The times of the samples, s; None if a rate serves channels without times."""
    times = [np.asarray(c["time"]) for c in channels if c.get("time") is not None]
    if not times:
        return None
    if not all(np.array_equal(times[0], other) for other in times):
        raise ChannelError(
            "The times of the SEP005 channels differ", "Resample them to one clock."
        )
    return times[0] if fs is None or len(times) == len(channels) else None


def _own_attributes(channels: Sequence[Channel], names: set[str]) -> Attributes | None:
    """Attributes of a record from here, if no channel was taken out or added."""
    texts = {str(channel[_KEY]) for channel in channels if _KEY in channel}
    if len(texts) != 1:
        return None
    attributes = Attributes.from_json(texts.pop(), "the SEP005 channels")
    return attributes if set(attributes.columns) == names else None
