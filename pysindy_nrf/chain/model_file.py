"""Files of chain models: JSON text, checked against the shipped schema."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NotRequired, TypedDict

from ..common.files import check, plain_json, schema
from ..exceptions import FileFormatError, FileVersionError
from ..laws.base import LawData
from ..records.files.table import check_file, unreadable
from .structure import ChainData
from .visited_region import RegionData

SCHEMA = "pysindy_nrf.ChainModel"
VERSION = 1
# a model of a thousand floors is far below this size
MAX_BYTES = 200_000_000
# what values of wrong types or sizes raise where a model is built from them
MALFORMED = (
    ValueError,
    KeyError,
    TypeError,
    AttributeError,
    ArithmeticError,
    RecursionError,
)


class ModelData(TypedDict):
    """A chain model as plain data, as the shipped schema describes it."""

    schema: str
    version: int
    chain: ChainData
    masses: list[float]
    laws: dict[str, list[LawData]]
    visited: NotRequired[dict[str, RegionData]]
    info: NotRequired[dict[str, object]]


def text_of_model(source: str | os.PathLike[str]) -> tuple[str, str]:
    """Where a model comes from, in words, and its JSON text."""
    if isinstance(source, str) and source.lstrip()[:1] == "{":
        return "The JSON text", source
    if not isinstance(source, (str, os.PathLike)):
        what = f"{source!r} is neither JSON text nor a path"
        raise FileFormatError(what, "Give what ChainModel.to_json wrote.")

    path = Path(source)
    try:
        check_file(path, MAX_BYTES)
        return str(path), path.read_text(encoding="utf-8")
    except (UnicodeError, OSError) as error:
        raise unreadable(path, "JSON", error) from error


@contextmanager
def readable_model(where: str) -> Iterator[None]:
    """Report values of wrong types or sizes as a fault of the file."""
    try:
        yield
    except FileFormatError:
        raise
    except MALFORMED as error:
        what = f"{where} is not a readable chain model: {error}"
        raise FileFormatError(what, "Write it with ChainModel.to_json.") from error


def parsed_model(text: str, where: str) -> ModelData:
    """The plain data of a model, as the schema says."""
    data = plain_json(text)
    _require_version(data, where)
    check(data, schema("chain_model"), where)
    n_dof = data["chain"]["n_dof"]
    if n_dof != len(data["masses"]):
        what = f"{where} has {len(data['masses'])} masses for {n_dof!r} DOFs"
        raise FileFormatError(what, "Write it with ChainModel.to_json.")
    return data


def _require_version(data: object, where: str) -> None:
    """Refuse data that are no model, and models that a later version wrote."""
    if not isinstance(data, dict) or data.get("schema") != SCHEMA:
        what = f"{where} is not a saved chain model"
        raise FileFormatError(what, f'It needs "schema": "{SCHEMA}".')

    version = data.get("version")
    if isinstance(version, int) and version > VERSION:
        what = f"{where} has version {version}, this package reads up to {VERSION}"
        raise FileVersionError(what, "Update pysindy_nrf.")
