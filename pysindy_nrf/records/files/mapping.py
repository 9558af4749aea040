"""Mapping of columns to channels: plain names, the mapping grammar, and mapping files.
Nothing is evaluated as code.

The grammar of one mapping is ``[-] name [ "[:, k]" | "[k, :]" ] [* factor] [@ unit]``.
"""

import difflib
import json
import re
import sys
import tomllib
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ...exceptions import ChannelError, FileFormatError
from ..channels import FILLED, channel_of, fillers
from .table import Table, check_file, unreadable
from .units import kind_of_unit, si_unit, split_suffix

GRAMMAR = (
    '[-] name [:, k] * factor @ unit, e.g. "vir*35.1507", "-acc[:, 2] @ g", "laser'
    ' @ mm"'
)

_PATTERN = re.compile(
    r"""\s*(?P<sign>-)?\s*
    (?:"(?P<quoted>[^"]+)"|(?P<name>[^"\[\]*@]+?))\s*
    (?:\[\s*(?:(?::\s*,\s*(?P<column>-?\d+))|(?:(?P<row>-?\d+)\s*,\s*:))\s*\])?\s*
    (?:\*\s*(?P<factor>[^*@\s]+))?\s*
    (?:@\s*(?P<unit>\S.*?))?\s*\Z""",
    re.VERBOSE,
)
_GROUPED = re.compile(
    r"[+-]?\d{1,3}([.,' \u00a0\u2009\u202f]\d{3})+([.,]\d*)?|[+-]?\d+\.\d*"
)


@dataclass(frozen=True)
class Expression:
    """A parsed mapping: variable, column or row of a matrix, factor (a number or a
    variable), sign and unit.
    """

    name: str
    column: int | None = None
    row: int | None = None
    factor: str | None = None
    sign: int = 1
    unit: str | None = None

    @property
    def text(self) -> str:
        """The mapping without its unit."""
        text = ("-" if self.sign < 0 else "") + self.name
        if self.column is not None:
            text += f"[:, {self.column}]"
        if self.row is not None:
            text += f"[{self.row}, :]"
        return text + (f" * {self.factor}" if self.factor else "")


def parse(text: str, table: Table, channel: str) -> Expression:
    """Parse the mapping of a channel."""
    if not isinstance(text, str):
        raise ChannelError(
            f"The mapping of {channel} is {text!r}, not a text", f"Write {GRAMMAR}."
        )
    if text.strip() in table.variables:
        return Expression(text.strip())
    match = _PATTERN.match(text)
    if match is None:
        raise ChannelError(
            f"The mapping {channel} = {text!r} is not understood", f"Write {GRAMMAR}."
        )
    column, row = (
        None if match[key] is None else int(match[key]) for key in ("column", "row")
    )
    name = match["quoted"] or match["name"].strip()
    return Expression(
        name, column, row, match["factor"], -1 if match["sign"] else 1, match["unit"]
    )


def line_of(expression: Expression, table: Table, channel: str) -> np.ndarray:
    """Samples of a mapping, shape (n_samples,), before units are converted."""
    if expression.name not in table.variables:
        plain = {name.lower(): name for name in table.variables}
        near = [
            plain[one]
            for one in difflib.get_close_matches(expression.name.lower(), plain, 1, 0.5)
        ]
        what = f"{table.path} has no variable {expression.name!r} for channel {channel}"
        what += f"; did you mean {near[0]!r}?" if near else ""
        raise FileFormatError(what, f"It holds {table.names}.")
    values = table.variables[expression.name]
    wanted = f"Channel {channel} = {expression.name!r} of {table.path}"
    index = expression.column if expression.row is None else expression.row
    if index is not None:
        axis = 1 if expression.row is None else 0
        if values.ndim != 2 or not -values.shape[axis] <= index < values.shape[axis]:
            kind = "column" if axis else "row"
            what = f"{wanted} has the shape {values.shape}, there is no {kind} {index}"
            raise FileFormatError(what, f"{kind.capitalize()}s count from 0.")
        values = values.take(index, axis)
    if values.ndim != 1:
        pick = (
            f"Pick one column, {expression.name}[:, 0], or one row,"
            f" {expression.name}[0, :]."
        )
        cure = pick if values.ndim == 2 else "Give one value per sample."
        raise FileFormatError(
            f"{wanted} has the shape {values.shape}, not one line of samples", cure
        )
    if channel == "t" and (
        values.dtype.kind in "mM"
        or expression.factor is None
        and values.dtype == object
    ):
        return values
    line = _numbers(values, wanted, table.decimal)
    if channel != "t" and (filled := fillers(line)[1]):
        raise FileFormatError(f"{wanted} holds {filled}", FILLED)
    scale = expression.sign * _factor(expression, table, channel)
    return line if scale == 1 else line * scale


def _factor(expression: Expression, table: Table, channel: str) -> float:
    if expression.factor is None:
        return 1.0
    try:
        value = float(expression.factor)
    except ValueError:
        scalar = table.variables.get(expression.factor)
        if scalar is None or scalar.size != 1 or scalar.dtype.kind not in "iuf":
            what = (
                f"The factor {expression.factor!r} of channel {channel} is neither a"
                " number nor the name of one in "
            )
            raise ChannelError(f"{what}{table.path}", f"Write {GRAMMAR}.") from None
        value = float(scalar.reshape(())[()])
    if not np.isfinite(value) or value == 0:
        cure = "Give a finite factor, not zero."
        raise ChannelError(
            f"The factor {expression.factor!r} of channel {channel} is not a usable"
            " number",
            cure,
        )
    return value


def _numbers(values: np.ndarray, wanted: str, decimal: str) -> np.ndarray:
    if values.dtype.kind == "c":
        raise FileFormatError(
            f"{wanted} is complex",
            "A frequency response is read with read_frf (--frf).",
        )
    if values.dtype == np.float32 or values.dtype.kind in "biuf":
        return values if values.dtype == np.float32 else values.astype(float)
    numbers = pd.to_numeric(pd.Series(values, dtype=object), errors="coerce").to_numpy(
        dtype=float
    )
    text = np.isnan(numbers) & ~pd.isna(values)
    if (
        decimal == ","
    ):  # the point of '1.500' marks thousands, or the file mixes two decimal marks
        text |= (
            pd.Series(values)
            .astype(str)
            .str.contains(".", regex=False)
            .to_numpy(dtype=bool)
        )
    if text.any():
        row = int(np.argmax(text))
        mark = ", in a file with a decimal comma" if decimal == "," else ""
        cure = "Remove it, or leave the cell empty where nothing was measured."
        if _GROUPED.fullmatch(str(values[row]).strip()):
            cure = (
                "Export numbers without marks of thousands, all with the same decimal"
                " mark."
            )
        raise FileFormatError(
            f"{wanted} holds the text {values[row]!r} in data row {row + 1}{mark}", cure
        )
    return numbers


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
    """Content of a mapping file, a small TOML file beside the data."""

    path: Path
    files: tuple[Path, ...] = ()
    together: bool = False  # the files hold channels of one test; else each is a test
    channels: dict[str, str] = field(
        default_factory=dict
    )  # as ``mapping`` of read_record
    units: dict[str, str] = field(default_factory=dict)
    fs: float | None = None
    coordinates: str | None = None
    name: str | None = None


def read_mapping(path: Any) -> MappingFile:
    """Read a mapping file: TOML, its files inside its own folder."""
    path = Path(path)
    check_file(path, _MAX_BYTES)
    try:
        with open(path, "rb") as file:
            data = tomllib.load(file)
    except (
        ValueError,
        RecursionError,
    ) as error:  # not TOML, not UTF-8, a number of thousands of digits
        raise unreadable(path, "a mapping file (TOML)", error) from error
    for key, value in data.items():
        if key not in _KEYS:
            near = difflib.get_close_matches(key, _KEYS, 1)
            what = f"{path}: the key {key!r} is unknown" + (
                f"; did you mean {near[0]!r}?" if near else ""
            )
            raise FileFormatError(what, f"Keys are {', '.join(_KEYS)}.")
        if not _good(key, value):
            raise FileFormatError(
                f"{path}: {key} = {_shown(value)} is not {_KEYS[key]}", "Correct it."
            )
        for name, text in value.items() if isinstance(value, dict) else ():
            if not isinstance(text, str) or not text.strip():
                cure = (
                    "Write e.g. F2 = 'Shaker @ kN'."
                    if key == "channels"
                    else "Write e.g. a = 'g'."
                )
                raise FileFormatError(
                    f"{path}: {key}.{name} = {_shown(text)} is not a text", cure
                )
    files = tuple(_inside(path, name) for name in data.pop("files", ()))
    return MappingFile(
        path, files, **(data | ({"fs": float(data["fs"])} if "fs" in data else {}))
    )


def _good(key: str, value: Any) -> bool:
    if key == "files":
        return (
            isinstance(value, list)
            and bool(value)
            and all(isinstance(v, str) and v.strip() for v in value)
        )
    if key == "fs":
        return (
            isinstance(value, (int, float))
            and not isinstance(value, bool)
            and 0 < value <= sys.float_info.max
        )
    if key == "coordinates":
        return value in ("relative", "absolute")
    return isinstance(value, {"together": bool, "name": str}.get(key, dict))


def _shown(value: Any) -> str:
    try:
        return repr(value)[:60]
    except ValueError:  # Python prints no integer of thousands of digits
        return "a number too long to print"


def _inside(path: Path, name: str) -> Path:
    """A file in the folder of the mapping file or below it; symbolic links are resolved
    first.
    """
    folder = path.resolve().parent
    try:
        target = (folder / name).resolve()
        good = target.is_relative_to(folder) and target != folder
    except (OSError, ValueError, RuntimeError):  # a zero byte, a loop of links
        good = False
    if not good:
        cure = "Put both into one folder."
        raise FileFormatError(
            f"{path}: the file {name!r} is not in the folder of the mapping file", cure
        )
    return path.parent / name


# Words of the trade by kind: English, German, French, Spanish, Italian, Chinese,
# Japanese, without accents. Whole words up to two letters, beginnings from three on,
# any part in Chinese and Japanese. The first kind counts.
_WORDS = {
    "t": "t time x_value zeit temps tiempo tempo timestamp secs 时间 時間 時刻",
    "": (
        "temp temperatur thermo scan index sample row nr no status trigger spare humid"
        " 温度 湿度"
    ),
    "a": "acc aceler beschl akzel 加速",
    "F": (
        "force kraft fuerza forza effort load last charge carga carico shaker hammer"
        " impact impakt marteau martillo martello exciter erreger excit vibrodin"
        " dynamom 荷重 力 加振"
    ),
    "x": (
        "disp lvdt laser string weg verschieb auslenk deplac desplaz spost dist abstand"
        " potentiom 位移 变位 変位"
    ),
    "v": "vel geschw vitess speed ldv 速度",
}
EASTERN_WORDS = [
    word for words in _WORDS.values() for word in words.split() if not word.isascii()
]
_BASE_WORDS = (
    "ag xg vg base basis ground boden table tisch sol suelo terreno fundament"
    " foundation fondation mesa "
)
_BASE_WORDS += "tavola 台 地"
_TOP = 10**6  # the number of the top floor, before the floors are counted
_TOP_WORDS = "top roof dach oben toit sommet techo cubierta tetto sommita 屋 顶 頂 上"


@dataclass
class Proposal:
    """What a column is taken to be: the channel, the mapping, and what is not sure
    about it.
    """

    channel: str
    text: str
    doubts: list[str] = field(default_factory=list)


def _says(name: str, words: str) -> bool:
    """Whether the name of a column holds one of some words."""
    plain = unicodedata.normalize("NFKD", name.lower())
    plain = "".join(c for c in plain if not unicodedata.combining(c))
    tokens = re.findall(r"[^\W\d_]+", plain)
    return any(
        (
            word in plain
            if not word.isascii() or "_" in word
            else (
                word in tokens
                if len(word) < 3
                else any(token.startswith(word) for token in tokens)
            )
        )
        for word in words.split()
    )


def propose(table: Table) -> list[Proposal]:
    """Channels of the columns of a file, from their units, numbers and words; what is
    not sure is said.
    """
    found: list[tuple[str, str, str, list[str]]] = []  # kind, name, mapping, doubts
    most = max((len(v) for v in table.variables.values() if v.ndim), default=0)
    for name, values in table.variables.items():
        if not values.ndim or len(values) != most or values.ndim > 2:
            continue
        bare, suffix = split_suffix(name)
        unit, doubts = table.units.get(name) or suffix, []
        spoken = next((k for k, words in _WORDS.items() if _says(bare, words)), None)
        own, by_unit = channel_of(bare), kind_of_unit(unit)
        kind = by_unit or (own[0] if own else spoken)
        if not kind or spoken == "" and not own:
            continue
        if by_unit and spoken and by_unit != spoken and not own:
            doubts.append(f"its unit {unit} is not that of its name")
        if not unit and not own:
            doubts.append(
                f"no unit: {si_unit(kind if kind == 't' else kind + '1')} taken"
            )
        quoted = f'"{name}"' if re.search(r"[\[\]*@]|^-", name) else name
        if values.ndim == 1:
            found.append((kind, bare, quoted, doubts))
        else:
            found += [
                (kind, f"{bare} {k + 1}", f"{quoted}[:, {k}]", doubts)
                for k in range(values.shape[1])
            ]
    out = [
        Proposal("t", text, doubts) for kind, _, text, doubts in found if kind == "t"
    ][:1]
    found = _without_counters([row for row in found if row[0] != "t"])
    numbered = {k: _numbered([row for row in found if row[0] == k]) for k in "axvF"}
    floors = max((j for k in "axv" for j, *_ in numbered[k]), default=1)
    for kind, rows in numbered.items():
        for j, text, doubts in rows:
            if kind == "F" and not 0 < j <= floors:
                doubts = (
                    doubts
                    if j == _TOP
                    else [
                        *doubts,
                        f"on which floor? the top is taken of F1 to F{floors}",
                    ]
                )
                j = floors
            channel = f"{kind}{j}" if j else f"{kind}g"
            if channel not in (one.channel for one in out):
                out.append(Proposal(channel, text, doubts))
    return out


def _without_counters(
    found: list[tuple[str, str, str, list[str]]],
) -> list[tuple[str, str, str, list[str]]]:
    """Names without the numbers that count a logger's inputs through channels of all
    kinds: ``AI 1/Shaker top``.
    """
    held = [
        (name[: n.start()], kind, n[0])
        for kind, name, *_ in found
        for n in re.finditer(r"\d+", name)
    ]
    for before in sorted({place for place, *_ in held}, key=len, reverse=True):
        kinds, numbers = zip(*(rest for place, *rest in held if place == before))
        if len(set(kinds)) > 1 and len(set(numbers)) == len(numbers):
            strip = re.compile(rf"^{re.escape(before)}\d+")
            found = [
                (kind, strip.sub(before, name), text, doubts)
                for kind, name, text, doubts in found
            ]
    return found


def _numbered(
    rows: list[tuple[str, str, str, list[str]]],
) -> list[tuple[int, str, list[str]]]:
    """Floors of the columns of one kind: 0 for the base, -1 where nothing says it."""
    on_base = [_says(name, _BASE_WORDS) for _, name, _, _ in rows]
    above = [row for row, base in zip(rows, on_base) if not base]
    numbers = [[int(n) for n in re.findall(r"\d+", name)] for _, name, _, _ in above]
    out = [
        (0, text, doubts) for (_, _, text, doubts), base in zip(rows, on_base) if base
    ]
    if rows and rows[0][0] == "F":
        rest = (
            (n[-1] if n else _TOP if _says(row[1], _TOP_WORDS) else -1, row)
            for n, row in zip(numbers, above)
        )
        return [(j, row[2], row[3]) for j, row in rest]
    for pick in (-1, 0):
        chosen = [n[pick] for n in numbers if n]
        if (
            chosen
            and len(set(chosen)) == len(chosen) == len(above)
            and max(chosen) <= 2 * len(chosen)
        ):
            return out + [
                (n, text, doubts) for n, (_, _, text, doubts) in zip(chosen, above)
            ]
    order = sorted(range(len(above)), key=lambda i: _says(above[i][1], _TOP_WORDS))
    doubt = "which floor? counted in the order of the columns"
    return out + [
        (k, above[i][2], [*above[i][3], doubt]) for k, i in enumerate(order, 1)
    ]


def mapping_text(files: Sequence[Path], proposals: Sequence[Proposal]) -> str:
    """A mapping file (TOML) of proposals; what is not sure stands behind a question
    mark.
    """
    lines = [
        (
            "files ="
            f" [{', '.join(json.dumps(path.name, ensure_ascii=False) for path in files)}]"
        ),
        "",
        "[channels]",
    ]
    for one in proposals:
        doubt = f"   # ? {'; '.join(one.doubts)}" if one.doubts else ""
        lines.append(
            f"{one.channel} = {json.dumps(one.text, ensure_ascii=False)}{doubt}"
        )
    return "\n".join(lines) + "\n"
