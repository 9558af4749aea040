"""Universal files (UFF): time histories, data set 58, read by pyuff."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ....common.files import atomic_write
from ....common.lazy import require
from ....exceptions import FileFormatError
from ...clock import rate_of
from ..attributes import Attributes
from ..table import MAX_BYTES, Clock, Table, check_size, reading_as, unreadable
from ..units import si_unit

if TYPE_CHECKING:
    import pyuff

# Types of data sets. That of the attributes of a record is our own; other programs pass
# over it.
_TIME_HISTORY = 58
_UNITS = 164
_ATTRIBUTES = 9058
_TIME_RESPONSE = (0, 1)  # function types; the others are spectra and responses

# Specific data types: displacement, velocity, acceleration, excitation, reaction.
_LETTERS = {8: "x", 11: "v", 12: "a", 13: "F", 9: "F"}
_DATA_TYPES = {"x": 8, "v": 11, "a": 12, "F": 13}
REACTION_FORCE = 9
_TIME = 17

_DIRECTIONS = {0: "", 1: "+X", -1: "-X", 2: "+Y", -2: "-Y", 3: "+Z", -3: "-Z"}
# Units code of data set 164: length and force.
_UNIT_SYSTEMS = {
    1: ("m", "N"),
    2: ("ft", "lbf"),
    3: ("m", "kgf"),
    5: ("mm", "mN"),
    7: ("in", "lbf"),
    8: ("mm", "kgf"),
}
RATE_TOLERANCE = 1e-5  # the step is written with six digits

DataSet = Mapping[str, Any]  # as pyuff reads it


def read_uff(path: Path, max_bytes: int = MAX_BYTES) -> Table:
    """Read the time histories (data sets 58) of a universal file, ASCII or binary."""
    pyuff = require("pyuff", "files", "Reading UFF files")
    _require_end(path)

    with reading_as(path, "UFF"):
        file = pyuff.UFF(str(path))
        histories = _read_histories(file, path, max_bytes)
        if not histories and read_uff_responses(path, max_bytes):
            raise FileFormatError(
                f"{path} holds frequency responses and no time history",
                "Read them with read_frf (--frf).",
            )
        types = [int(kind) for kind in file.get_set_types()]
        systems = [file.read_sets(i) for i, kind in enumerate(types) if kind == _UNITS]

    histories = _real_histories(path, histories)
    if types[0] == _ATTRIBUTES:
        return _own_record(path, histories)
    return _measured_channels(path, histories, systems, len(types) - len(histories))


@dataclass(frozen=True)
class UffResponse:
    """A frequency response of a universal file.

    Parameters
    ----------
    f : ndarray of shape (n_lines,)
        Hz.
    values : ndarray of complex, shape (n_lines,)
    node, reference : int
        Nodes of the response and of the force.
    letter : {"a", "v", "x"}
        What responds; accelerance, mobility or receptance.
    units : tuple of str
        Of the response and of the force; empty where they are not stated.
    """

    f: np.ndarray
    values: np.ndarray
    node: int
    reference: int
    letter: str
    units: tuple[str, str]


_FREQUENCY_RESPONSE = 4  # function type


def read_uff_responses(path: Path, max_bytes: int = MAX_BYTES) -> list[UffResponse]:
    """Frequency responses (data sets 58, function type 4) of a universal file."""
    pyuff = require("pyuff", "files", "Reading UFF files")
    _require_end(path)
    with reading_as(path, "UFF"):
        file = pyuff.UFF(str(path))
        check_size(path, path.stat().st_size, max_bytes)
        kinds = [int(kind) for kind in file.get_set_types()]
        sets = [
            file.read_sets(i) for i, kind in enumerate(kinds) if kind == _TIME_HISTORY
        ]

    responses = []
    for data_set in sets:
        letter = _LETTERS.get(int(data_set["ordinate_spec_data_type"]), "")
        is_response = int(data_set["func_type"]) == _FREQUENCY_RESPONSE
        if is_response and letter in ("a", "v", "x"):
            units = ("ordinate_axis_units_lab", "orddenom_axis_units_lab")
            stated, of_force = (_text(data_set.get(key, "")) for key in units)
            response = UffResponse(
                np.asarray(data_set["x"], dtype=float),
                np.asarray(data_set["data"], dtype=complex),
                int(data_set["rsp_node"]),
                int(data_set["ref_node"]),
                letter,
                (stated, of_force),
            )
            responses.append(response)
    return responses


def _require_end(path: Path) -> None:
    """Refuse a file that is cut off; pyuff would drop its last data set silently."""
    with open(path, "rb") as file:
        file.seek(max(0, path.stat().st_size - 200))
        tail = file.read().rstrip()
    if not tail.endswith(b"-1"):
        raise unreadable(path, "UFF", "its last data set does not end")


def _read_histories(file: pyuff.UFF, path: Path, max_bytes: int) -> list[DataSet]:
    """Data sets of time histories, after a look at what their heads announce."""
    numbers, points = [], []
    for i, kind in enumerate(file.get_set_types()):
        if int(kind) != _TIME_HISTORY:
            continue
        head = file.read_sets(i, header_only=True)
        points.append(int(head["num_pts"]))
        if int(head["func_type"]) in _TIME_RESPONSE:
            numbers.append(i)

    if points and not 0 <= min(points) <= max(points) <= path.stat().st_size:
        raise ValueError("a data set announces more points than the file holds")
    check_size(path, 8 * sum(points), max_bytes)
    # pyuff warns of values that it drops; they are counted afterwards
    with warnings.catch_warnings(action="ignore"):
        return [file.read_sets(i) for i in numbers]


def _real_histories(path: Path, histories: list[DataSet]) -> list[DataSet]:
    """The histories that are real, which must be complete."""
    if any("data" not in history for history in histories):
        raise unreadable(path, "UFF", "a data set 58 holds no data")

    real = [h for h in histories if not np.iscomplexobj(h["data"])]
    if not real:
        raise unreadable(
            path, "UFF", "it holds no time history (data set 58, function type 1)"
        )
    for history in real:
        announced = int(history["num_pts"])
        if len(history["data"]) != announced:
            raise FileFormatError(
                f"{path}: {history['id1'].strip()!r} announces {announced} points,"
                f" {len(history['data'])} are there",
                "The file is cut off or damaged; export it again.",
            )
    return real


def _own_record(path: Path, histories: Sequence[DataSet]) -> Table:
    """A record written by :func:`write_uff`, with its attributes."""
    with open(path, "rb") as file:
        file.readline()
        file.readline()
        attributes = Attributes.from_json(file.readline(), path)

    names = attributes.columns
    if len(histories) != len(names):
        reason = f"{len(histories)} columns are there, {len(names)} were written"
        raise unreadable(path, "UFF", reason)
    columns = {name: _samples(h) for name, h in zip(names, histories)}
    return Table(path, "UFF 58", columns, attributes=attributes, fs=attributes.fs)


def _samples(history: DataSet) -> np.ndarray:
    return np.asarray(history["data"], dtype=float)


@dataclass(frozen=True)
class _Channel:
    """A time history of another program."""

    name: str
    history: DataSet
    is_reversed: bool  # measured along a negative axis, which the name does not say

    @property
    def direction(self) -> int:
        return int(self.history["rsp_dir"])

    def named_with_direction(self) -> _Channel:
        """The same with its direction in the name, ``a3+X``."""
        suffix = _DIRECTIONS.get(self.direction, f"({self.direction})")
        return replace(self, name=self.name + suffix, is_reversed=False)

    def notes(self) -> list[str]:
        """Title of the channel, and its direction if that is turned."""
        notes = []
        title = _text(self.history["id1"])
        if title:
            notes.append(f"{self.name} is {title!r}")
        if self.is_reversed:
            along = _DIRECTIONS.get(self.direction, "a negative axis")
            notes.append(f"{self.name} was measured along {along}: its sign is turned")
        return notes


def _text(value: object) -> str:
    """A text of a head, empty if it is NONE."""
    text = str(value).strip()
    return "" if text.upper() == "NONE" else text


def _channels(histories: Sequence[DataSet]) -> list[_Channel]:
    """Channels by quantity and node, and by direction where these do not suffice."""
    channels = []
    for history in histories:
        letter = _LETTERS.get(int(history["ordinate_spec_data_type"]), "c")
        name = f"{letter}{int(history['rsp_node'])}"
        channels.append(_Channel(name, history, int(history["rsp_dir"]) < 0))

    axes = {abs(channel.direction) for channel in channels}
    if len(axes) > 1 or max(_counts(channels).values()) > 1:
        channels = [channel.named_with_direction() for channel in channels]

    counts = _counts(channels)
    for i, channel in enumerate(channels):
        if counts[channel.name] > 1:
            channels[i] = replace(channel, name=f"{channel.name} set {i + 1}")
    return channels


def _counts(channels: Sequence[_Channel]) -> Counter[str]:
    return Counter(channel.name for channel in channels)


def _measured_channels(
    path: Path,
    histories: Sequence[DataSet],
    systems: Sequence[DataSet],
    n_skipped: int,
) -> Table:
    """The table of a file of another program."""
    times = _times_of_uneven(path, histories)
    variables = {} if times is None else {"t": times}
    implied, notes_on_units = _units_of_file(systems)
    units: dict[str, str] = {}
    clocks: dict[str, Clock] = {}
    notes: list[str] = []
    for channel in _channels(histories):
        if times is None:
            clocks[channel.name] = _clock_of(path, channel.history)
        samples = _samples(channel.history)
        variables[channel.name] = -samples if channel.is_reversed else samples
        stated = _text(channel.history.get("ordinate_axis_units_lab", ""))
        unit = stated or implied.get(channel.name[0])
        if unit:
            units[channel.name] = unit
        notes += channel.notes()

    if n_skipped:
        notes.append(f"{n_skipped} other data sets are left out")
    notes += notes_on_units
    rates = {clock.fs for clock in clocks.values()}
    fs = rates.pop() if len(rates) == 1 else None
    return Table(path, "UFF 58", variables, units, tuple(notes), fs=fs, clocks=clocks)


def _units_of_file(systems: Sequence[DataSet]) -> tuple[dict[str, str], list[str]]:
    """Units by letter that data set 164 implies (SI without one), and notes."""
    length, force = "m", "N"
    if systems:
        code = int(systems[0]["units_code"])
        if code not in _UNIT_SYSTEMS:
            return {}, [f"take care: its units code {code} is not known; give units"]
        length, force = _UNIT_SYSTEMS[code]
    return {"x": length, "v": f"{length}/s", "a": f"{length}/s^2", "F": force}, []


def _clock_of(path: Path, history: DataSet) -> Clock:
    """The clock of an even history."""
    step = float(history.get("abscissa_inc", 0.0))
    if step <= 0:
        raise FileFormatError(
            f"{path}: {history['id1'].strip()!r} has no sampling interval",
            "Export it again.",
        )
    start = float(history.get("abscissa_min", 0.0))
    return Clock(rate_of(step, RATE_TOLERANCE), start)


def _times_of_uneven(path: Path, histories: Sequence[DataSet]) -> np.ndarray | None:
    """Times that uneven histories share; None if all are even."""
    if all(int(history["abscissa_spacing"]) for history in histories):
        return None

    times = np.asarray(histories[0]["x"], dtype=float)
    for history in histories[1:]:
        if not np.array_equal(times, np.asarray(history["x"], dtype=float)):
            raise FileFormatError(
                f"{path}: the times of its time histories differ",
                "Export histories with one clock.",
            )
    return times


@dataclass(frozen=True)
class TimeHistory:
    """One channel as a binary data set 58.

    Parameters
    ----------
    samples : ndarray of shape (n_samples,)
    fs, t0 : float
        Sampling rate, Hz, and time of the first sample, s.
    titles : tuple of str
        At most five lines of text.
    data_type : int
        Specific data type of UFF; 0 for a covariate.
    node, reference : int
        Node of the response and of the reference; 0 for none.
    unit : str
    """

    samples: np.ndarray
    fs: float
    t0: float
    titles: tuple[str, ...]
    data_type: int = 0
    node: int = 0
    reference: int = 0
    unit: str = ""

    def encoded(self) -> bytes:
        """The data set in IEEE double precision."""
        data = np.asarray(self.samples, dtype="<f8").tobytes()
        n = len(self.samples)
        direction = 1 if self.data_type else 0
        reference_direction = 1 if self.reference else 0

        lines = [
            f"{-1:6d}",
            # binary, little endian, IEEE 754, 11 lines of head
            f"{58:6d}b{1:6d}{2:6d}{11:12d}{len(data):12d}{0:6d}{0:6d}{0:12d}{0:12d}",
            *self._title_lines(),
            f"{1:5d}{0:10d}{0:5d}{0:10d} {'NONE':>10}{self.node:10d}{direction:4d} "
            f"{'NONE':>10}{self.reference:10d}{reference_direction:4d}",
            # double precision, evenly spaced
            f"{4:10d}{n:10d}{1:10d}{self.t0:13.5e}{1 / self.fs:13.5e}{0:13.5e}",
            _axis(_TIME, "time", "s"),
            _axis(self.data_type, "NONE", self.unit or "NONE"),
            _axis(0, "NONE", "NONE"),
            _axis(0, "NONE", "NONE"),
        ]
        head = "\n".join(lines) + "\n"
        return head.encode("ascii") + data + f"{-1:6d}\n".encode()

    def _title_lines(self) -> list[str]:
        """Five lines of at most 80 ASCII characters."""
        titles = list(self.titles) + ["NONE"] * (5 - len(self.titles))
        return [f"{ascii(title)[1:-1][:80]:<80}" for title in titles]


def _axis(data_type: int, label: str, unit: str) -> str:
    return f"{data_type:10d}    0    0    0 {label:<20} {unit:<20}"


def write_uff(
    path: Path, columns: Mapping[str, np.ndarray], attributes: Attributes
) -> None:
    """Write the columns of a record, and its attributes as a data set of our own."""
    text = f"{-1:6d}\n{_ATTRIBUTES:6d}\n{attributes.to_json()}\n{-1:6d}\n"
    data_sets = [text.encode()]
    for name, line in columns.items():
        data_sets.append(_history_of_column(name, line, attributes).encoded())
    write_data_sets(path, data_sets)


def _history_of_column(
    name: str, line: np.ndarray, attributes: Attributes
) -> TimeHistory:
    titles = (name, attributes.name)
    if name in attributes.covariates:
        return TimeHistory(line, attributes.fs, attributes.t0, titles)
    return TimeHistory(
        line,
        attributes.fs,
        attributes.t0,
        titles,
        data_type=_DATA_TYPES[name[0]],
        node=int(name[1:]) if name[1:].isdigit() else 0,
        unit=si_unit(name),
    )


def write_data_sets(path: Path, data_sets: Iterable[bytes]) -> None:
    """Write data sets to a universal file, completely or not at all."""
    with atomic_write(path, "wb") as file:
        file.writelines(data_sets)
