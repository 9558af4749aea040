"""Mapping files: small TOML files next to the data."""

import difflib
import sys
import tomllib
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path

from ....exceptions import FileFormatError
from ...hold import HOLDS
from ...record import COORDINATES
from ..table import check_file, unreadable

MAX_MAPPING_BYTES = 1_000_000


@dataclass(frozen=True)
class MappingFile:
    """Content of a mapping file.

    Parameters
    ----------
    path : Path
    files : tuple of Path
        The data, in the folder of the mapping file or below it.
    together : bool
        The files hold channels of one test; otherwise each of them is a test.
    channels : dict of str to str
        As ``mapping`` of :func:`read_record`.
    units : dict of str to str
    fs : float, optional
        Sampling rate, Hz.
    coordinates : {"relative", "absolute"}, optional
    hold : {"cubic", "linear", "zero"}, optional
        Course of the forces between the samples.
    name : str, optional
        Name of the test.
    prepare : dict
        ``from``, ``to`` (s), ``resample`` (Hz), ``drop_blank`` and
        ``relative_acceleration`` (true or false): see :class:`Preparation`.
    """

    path: Path
    files: tuple[Path, ...] = ()
    together: bool = False
    channels: dict[str, str] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    fs: float | None = None
    coordinates: str | None = None
    hold: str | None = None
    name: str | None = None
    prepare: dict[str, float | bool] = field(default_factory=dict)


def read_mapping(path: str | PathLike[str]) -> MappingFile:
    """Read a mapping file.

    Raises
    ------
    FileFormatError
        If it is not TOML, a key is unknown or has a wrong value, or a file lies outside
        its folder.
    """
    location = Path(path)
    check_file(location, MAX_MAPPING_BYTES)
    try:
        with open(location, "rb") as file:
            data = tomllib.load(file)
    # not TOML, not UTF-8, or a number of thousands of digits
    except (ValueError, RecursionError) as error:
        raise unreadable(location, "a mapping file (TOML)", error) from error

    for key, value in data.items():
        _check_entry(location, key, value)
    if "fs" in data:
        data["fs"] = float(data["fs"])
    files = tuple(_file_inside(location, name) for name in data.pop("files", ()))
    return MappingFile(location, files, **data)


# What stands under each key, in words.
_KEYS = {
    "files": "a list of file names",
    "together": "true or false",
    "name": "a text",
    "fs": "a positive number (Hz)",
    "coordinates": "'relative' or 'absolute'",
    "hold": "'cubic', 'linear' or 'zero'",
    "channels": "a table CHANNEL = 'column'",
    "units": "a table CHANNEL = 'unit'",
    "prepare": "a table of from, to, resample, drop_blank, relative_acceleration",
}
_PREPARATIONS = {
    "from": float,
    "to": float,
    "resample": float,
    "drop_blank": bool,
    "relative_acceleration": bool,
}
_TYPES = {
    "together": bool,
    "name": str,
    "channels": dict,
    "units": dict,
    "prepare": dict,
}
_EXAMPLES = {"channels": "F2 = 'Shaker @ kN'", "units": "a = 'g'"}


def _check_entry(path: Path, key: str, value: object) -> None:
    """Refuse an unknown key, and a wrong value."""
    if key not in _KEYS:
        nearest = difflib.get_close_matches(key, _KEYS, 1)
        hint = f"; did you mean {nearest[0]!r}?" if nearest else ""
        raise FileFormatError(
            f"{path}: the key {key!r} is unknown{hint}",
            f"Keys are {', '.join(_KEYS)}.",
        )

    if not _fits(key, value):
        raise FileFormatError(
            f"{path}: {key} = {_shown(value)} is not {_KEYS[key]}", "Correct it."
        )
    if not isinstance(value, dict):
        return
    if key == "prepare":
        _check_preparation(path, value)
        return
    for name, text in value.items():
        if not _is_text(text):
            raise FileFormatError(
                f"{path}: {key}.{name} = {_shown(text)} is not a text",
                f"Write e.g. {_EXAMPLES[key]}.",
            )


def _check_preparation(path: Path, entries: dict[str, object]) -> None:
    """Refuse an unknown preparation, and a wrong value."""
    for name, value in entries.items():
        kind = _PREPARATIONS.get(name)
        is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if kind is None or (kind is float and not is_number):
            raise FileFormatError(
                f"{path}: prepare.{name} = {_shown(value)} is not understood",
                f"Write numbers or true and false for {', '.join(_PREPARATIONS)}.",
            )
        if kind is bool and not isinstance(value, bool):
            raise FileFormatError(
                f"{path}: prepare.{name} = {_shown(value)} is not true or false",
                "Correct it.",
            )


def _fits(key: str, value: object) -> bool:
    """Whether a value may stand under a key."""
    if key == "files":
        return isinstance(value, list) and bool(value) and all(map(_is_text, value))
    if key == "fs":
        if not isinstance(value, (int, float)) or isinstance(value, bool):
            return False
        return 0 < value <= sys.float_info.max
    if key == "coordinates":
        return value in COORDINATES
    if key == "hold":
        return value in HOLDS
    return isinstance(value, _TYPES[key])


def _is_text(value: object) -> bool:
    return isinstance(value, str) and bool(value.strip())


def _shown(value: object) -> str:
    """A value, cut where a message would drown in it."""
    try:
        return repr(value)[:60]
    except ValueError:  # Python prints no integer of thousands of digits
        return "a number too long to print"


def _file_inside(path: Path, name: str) -> Path:
    """A file in the folder of the mapping file or below it, where links lead to too."""
    folder = path.resolve().parent
    try:
        target = (folder / name).resolve()
        is_inside = target.is_relative_to(folder) and target != folder
    except (OSError, ValueError, RuntimeError):  # a zero byte, a loop of links
        is_inside = False

    if not is_inside:
        raise FileFormatError(
            f"{path}: the file {name!r} is not in the folder of the mapping file",
            "Put both into one folder.",
        )
    return path.parent / name
