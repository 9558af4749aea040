"""SEP005 dictionaries, the signal format of the SDyPy packages."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...common import number_of
from ...exceptions import ChannelError
from ..record import Record
from .reading import understand
from .table import Attributes, Table, columns_of
from .units import si_unit

_QUANTITIES = {"x": "d", "v": "v", "a": "a", "F": "f"}
_KEY = "pysindy_nrf"


def to_sep005(record: Record) -> list[dict[str, Any]]:
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
    attributes = Attributes.of(record)
    text = attributes.to_json()
    out = []
    for name, line in columns_of(record).items():
        channel = {
            "data": line.copy(),
            "name": name,
            "unit_str": "",
            "fs": record.fs,
            "group": record.name,
            _KEY: text,
        }
        if name not in attributes.covariates:
            channel |= {"unit_str": si_unit(name), "quantity": _QUANTITIES[name[0]]}
        out.append(channel)
    return out


def from_sep005(channels: Sequence[Mapping[str, Any]], **options: Any) -> Record:
    """Convert SEP005 dictionaries to a record.

    Parameters
    ----------
    channels : sequence of dict
        ``data`` (n_samples,), ``name``, ``unit_str``, ``fs`` (Hz) or ``time`` (s),
        perhaps ``start_timestamp``.
    **options
        ``mapping``, ``units``, ``fs``, ``name``, ``coordinates`` as for
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
    if isinstance(channels, Mapping):
        channels = [channels]
    channels = list(channels)
    if not channels or not all(isinstance(one, Mapping) for one in channels):
        raise ChannelError(
            "No SEP005 channel was given",
            "Give a list of dictionaries with data, name, unit_str, fs.",
        )
    variables: dict[str, np.ndarray] = {}
    units = {}
    for i, one in enumerate(channels):
        label = one.get("name", f"number {i + 1}")
        missing = [key for key in ("data", "name", "unit_str") if key not in one]
        missing += [] if "fs" in one or "time" in one else ["fs or time"]
        if missing:
            raise ChannelError(
                f"SEP005 channel {label!r} lacks {', '.join(missing)}", "Add it."
            )
        data = np.asarray(one["data"])
        if data.ndim != 1:
            raise ChannelError(
                f"SEP005 channel {label!r} has data of the shape {data.shape}",
                "Give one line.",
            )
        if str(label) in variables:
            raise ChannelError(
                f"Two SEP005 channels are named {label!r}", "Rename one."
            )
        variables[str(label)] = data
        if one["unit_str"]:
            units[str(label)] = str(one["unit_str"])
    _same(channels, "fs", "Resample them to one clock.")
    _same(channels, "start_timestamp", "Cut them to one start.")
    fs = next((_rate(one) for one in channels if one.get("fs") is not None), None)
    times = [np.asarray(one["time"]) for one in channels if one.get("time") is not None]
    if times:
        if any(not np.array_equal(times[0], time) for time in times):
            raise ChannelError(
                "The times of the SEP005 channels differ", "Resample them to one clock."
            )
        if "t" not in variables and (fs is None or len(times) == len(channels)):
            variables = {"t": times[0]} | variables
    texts = {str(one[_KEY]) for one in channels if _KEY in one}
    own = (
        Attributes.from_json(texts.pop(), "the SEP005 channels")
        if len(texts) == 1
        else None
    )
    complete = own is not None and set(own.columns) == set(
        variables
    )  # no channel was taken out or added
    start = channels[0].get("start_timestamp")
    notes = [f"starts {start}"] if start else []
    table = Table(
        Path("SEP005"), "SEP005", variables, units, notes, own if complete else None, fs
    )
    return understand(table, **options).record


def _rate(channel: Mapping[str, Any]) -> float:
    rate = number_of(channel["fs"])
    if not 0 < rate < float("inf"):
        raise ChannelError(
            f"SEP005 channel {channel['name']!r} has fs = {str(channel['fs'])[:40]}",
            "Give Hz above 0.",
        )
    return rate


def _same(channels: Sequence[Mapping[str, Any]], key: str, cure: str) -> None:
    values = {
        str(one[key]): one["name"] for one in channels if one.get(key) is not None
    }
    if len(values) > 1:
        shown = ", ".join(
            f"{name!r} {value}" for value, name in list(values.items())[:3]
        )
        raise ChannelError(f"The SEP005 channels differ in {key}: {shown}", cure)
