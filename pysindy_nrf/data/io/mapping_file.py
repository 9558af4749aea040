"""Mapping files: which column is which channel, in which unit, in a small TOML file beside the data.

``name``, ``files``, ``together``, ``fs``, ``coordinates``, ``[channels]``, ``[units]``; see docs/files.md.
"""

from __future__ import annotations

import difflib
import sys
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...exceptions import FileFormatError
from .table import check_file, unreadable

_MAX_BYTES = 1_000_000
_KEYS = {
    "files": "a list of file names",
    "together": "true or false",
    "name": "a text",
    "fs": "a positive number (Hz)",
    "coordinates": "'relative' or 'absolute'",
    "channels": "a table CHANNEL = 'column'",
    "units": "a table CHANNEL = 'unit'",
}


@dataclass(frozen=True)
class MappingFile:
    r"""What a mapping file says.

    Attributes
    ----------
    path : Path
    files : tuple of Path
        Inside the folder of the mapping file.
    together : bool
        Whether the files hold channels of one test; else each is a test.
    channels, units : dict of str to str
        As ``mapping`` and ``units`` of :func:`read_record`.
    fs : float or None
    coordinates, name : str or None

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from pysindy_nrf.data.io import read_mapping
    >>> text = '[channels]\nF1 = "Shaker @ kN"\na1 = "ACC_07 @ g"\n'
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder, "campaign.toml")
    ...     _ = path.write_text(text)
    ...     read_mapping(path).channels
    {'F1': 'Shaker @ kN', 'a1': 'ACC_07 @ g'}
    """

    path: Path
    files: tuple[Path, ...] = ()
    together: bool = False
    channels: dict[str, str] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    fs: float | None = None
    coordinates: str | None = None
    name: str | None = None


def read_mapping(path: Any) -> MappingFile:
    """Read a mapping file.

    Parameters
    ----------
    path : path-like
        TOML.

    Returns
    -------
    MappingFile

    Raises
    ------
    FileFormatError
        If it is no TOML, a key is unknown or has a wrong value, or a file lies outside its folder.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from pysindy_nrf.data.io import read_mapping
    >>> folder = tempfile.TemporaryDirectory()
    >>> path = pathlib.Path(folder.name, "shaker.toml")
    >>> _ = path.write_text('fs = 500.0\\n[channels]\\nF2 = "Shaker"\\n[units]\\nF = "kN"\\n')
    >>> found = read_mapping(path)
    >>> found.fs, found.channels, found.units
    (500.0, {'F2': 'Shaker'}, {'F': 'kN'})
    >>> folder.cleanup()
    """
    path = Path(path)
    check_file(path, _MAX_BYTES)
    try:
        with open(path, "rb") as file:
            data = tomllib.load(file)
    except (ValueError, RecursionError) as error:  # no TOML, no UTF-8, a number of thousands of digits
        raise unreadable(path, "a mapping file (TOML)", error) from error
    for key in data:
        if key not in _KEYS:
            near = difflib.get_close_matches(key, _KEYS, 1)
            raise FileFormatError(
                f"{path}: the key {key!r} is unknown" + (f"; did you mean {near[0]!r}?" if near else ""),
                f"Keys are {', '.join(_KEYS)}.",
            )
    for key, value in data.items():
        if not _good(key, value):
            raise FileFormatError(f"{path}: {key} = {_shown(value)} is not {_KEYS[key]}", "Correct it.")
    files = tuple(_inside(path, name) for name in data.get("files", ()))
    return MappingFile(
        path,
        files,
        data.get("together", False),
        _texts(path, "channels", data.get("channels", {})),
        _texts(path, "units", data.get("units", {})),
        float(data["fs"]) if "fs" in data else None,
        data.get("coordinates"),
        data.get("name"),
    )


def _good(key: str, value: Any) -> bool:
    if key == "files":
        return isinstance(value, list) and bool(value) and all(isinstance(v, str) and v.strip() for v in value)
    if key == "together":
        return isinstance(value, bool)
    if key == "fs":
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        return number and 0 < value <= sys.float_info.max
    if key == "coordinates":
        return value in ("relative", "absolute")
    return isinstance(value, str) if key == "name" else isinstance(value, dict)


def _texts(path: Path, key: str, table: dict[str, Any]) -> dict[str, str]:
    for name, value in table.items():
        if not isinstance(value, str) or not value.strip():
            raise FileFormatError(
                f"{path}: {key}.{name} = {_shown(value)} is not a text",
                "Write e.g. F2 = 'Shaker @ kN'." if key == "channels" else "Write e.g. a = 'g'.",
            )
    return dict(table)


def _shown(value: Any) -> str:
    try:
        return repr(value)[:60]
    except ValueError:  # Python writes no integer of thousands of digits
        return "a number too long to print"


def _inside(path: Path, name: str) -> Path:
    """A file in the folder of the mapping file or below it; links are followed before this is judged."""
    folder = path.resolve().parent
    try:
        target = (folder / name).resolve()
        good = target.is_relative_to(folder) and target != folder
    except (OSError, ValueError, RuntimeError):  # a zero byte, a loop of links
        good = False
    if not good:
        raise FileFormatError(
            f"{path}: the file {name!r} is not in the folder of the mapping file", "Put both into one folder."
        )
    return path.parent / name
