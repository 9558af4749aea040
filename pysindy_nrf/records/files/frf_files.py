"""Frequency responses from files: text, arrays, UFF; complex or in two columns."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np

from ...exceptions import ChannelError, FileFormatError
from .formats import DELIMITED_TEXT, UFF, format_called
from .formats.uff import UffResponse, read_uff_responses
from .frequency_response import FrequencyResponse
from .mapping.expression import as_name, parse
from .table import MAX_BYTES, Table, check_file, unreadable
from .tables import read_table
from .units import response_unit, si_factor, split_unit

_KIND_OF_LETTER = {"a": "accelerance", "v": "mobility", "x": "receptance"}


@dataclass(frozen=True)
class _Responses:
    """What a file holds."""

    f: np.ndarray
    H: np.ndarray
    excited: int | None = None
    kind: str | None = None


def read_frf(
    path: str | PathLike[str],
    *,
    excited: int | None = None,
    kind: str | None = None,
    mapping: Mapping[str, str] | None = None,
    max_bytes: int = MAX_BYTES,
) -> FrequencyResponse:
    """Read measured frequency responses.

    Parameters
    ----------
    path : path-like
        One of these files:

        - delimited text (``;``, tab or ``,``) with columns f (Hz), H1, H2, .. of
          complex numbers (``0.1-0.2j``), with or without a header;
        - the same with two columns for each response: real and imaginary parts, or
          magnitude and phase, as their names say;
        - MATLAB, HDF5 or NumPy with ``f`` and ``H`` (lines x DOFs) or ``H1``, ``H2``;
        - UFF 58 with frequency responses, whose nodes become DOFs in their order.
    excited : int, optional
        The DOF on which the force acts; if None as the file says, else 1.
    kind : {"accelerance", "mobility", "receptance"}, optional
        Acceleration, velocity or displacement over force, SI units; if None as the file
        says, else accelerance.
    mapping : mapping of str to str, optional
        ``{"f": "Freq", "H1": "complex(Re 1, Im 1)", "H2": "polar(Mag 2, Phase 2)"}``;
        phases in degrees. A name alone stands for a complex variable.
    max_bytes : int

    Raises
    ------
    FileFormatError
        If the file holds no frequencies and complex responses.
    ChannelError
        If ``excited``, ``kind`` or a mapping is wrong, or a number is not finite.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from pysindy_nrf.records.files import read_frf
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder, "shaker.csv")
    ...     _ = path.write_text(
    ...         "f;H1;H2\\n1.0;0.1+0.01j;0.2+0.02j\\n2.0;0.3-0.1j;0.1+0j\\n"
    ...     )
    ...     read_frf(path, excited=1).H.shape
    (2, 2)
    """
    file = Path(path)
    check_file(file, max_bytes)
    form = format_called(file)
    if mapping:
        responses = _from_mapping(read_table(file, max_bytes=max_bytes), mapping)
    elif form is DELIMITED_TEXT:
        responses = _from_text(file)
    elif form is UFF:
        responses = _from_uff(file, excited, max_bytes)
    else:
        responses = _from_variables(file, max_bytes)
    if form is DELIMITED_TEXT and kind and responses.kind not in (None, kind):
        raise ChannelError(
            f"kind={kind!r} was given, but the units in {file.name} are those of a"
            f" {responses.kind}",
            "Leave kind out, or correct the header.",
        )
    return FrequencyResponse.from_arrays(
        responses.f,
        responses.H,
        excited or responses.excited or 1,
        kind or responses.kind or "accelerance",
        file.stem,
    )


# -- text ----------------------------------------------------------------------

_COMMENT = re.compile(r"\s*([#%]|$)")
_CURE = "Give rows of frequency and complex responses: f;H1;H2."


def _from_text(path: Path) -> _Responses:
    """Frequencies and responses from the columns of a text."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (UnicodeError, OSError) as error:
        raise unreadable(path, "a frequency response in text", error) from error
    lines = [line for line in text.splitlines() if not _COMMENT.match(line)]
    if not lines:
        raise FileFormatError(f"{path} holds no rows", _CURE)

    separators = [mark for mark in (";", "\t", ",") if mark in lines[-1]]
    if not separators:
        raise FileFormatError(f"{path} has one column only", _CURE)
    names, values = _complex_rows(path, lines, separators[0])
    names, kind = _in_si(names, values, str(path))
    if np.abs(values[:, 1:].imag).max() > 0:
        return _Responses(values[:, 0], values[:, 1:], kind=kind)

    columns = dict(zip(names, values.real.T)) if len(set(names)) == len(names) else {}
    responses = (
        _of_two_columns(list(names)[1:], columns, str(path)) if columns else None
    )
    if responses is None:
        raise FileFormatError(
            f"{path} holds no complex responses",
            "Magnitudes alone do not identify a model; export real and imaginary parts,"
            " as 0.1-0.2j or in columns H1_re, H1_im, or magnitude and phase, and name"
            " the columns so.",
        )
    return _Responses(values[:, 0].real, responses, kind=kind)


def _in_si(
    names: Sequence[str], values: np.ndarray, path: str
) -> tuple[list[str], str | None]:
    """Names without the units of responses, and the kind that these say.

    The values become those in SI units.
    """
    bare_names = []
    kinds: dict[str, str] = {}
    for k, name in enumerate(names):
        bare, unit = split_unit(name)
        measured = response_unit(unit) if unit else None
        if measured is None:
            bare_names.append(name)
            continue
        letter, factor = measured
        values[:, k] *= factor
        bare_names.append(bare)
        kinds.setdefault(_KIND_OF_LETTER[letter], name)

    if len(kinds) > 1:
        first, second = list(kinds.values())[:2]
        raise FileFormatError(
            f"{path}: {first!r} and {second!r} are responses of two kinds",
            "Give accelerations, velocities or displacements over the force alone.",
        )
    return bare_names, next(iter(kinds), None)


def _complex_rows(
    path: Path, lines: list[str], separator: str
) -> tuple[list[str], np.ndarray]:
    """Names of columns, and complex numbers of the lines below them."""
    width = len(lines[-1].split(separator))
    first = [cell.strip() for cell in lines[0].split(separator)]
    has_header = _complex_numbers(first) is None
    rows = []
    for number, line in enumerate(lines, 1):
        if number == 1 and has_header:
            continue
        row = _complex_numbers(line.split(separator))
        if row is None or len(row) != width:
            raise FileFormatError(
                f"{path}, row {number}: {line[:60]!r} is not {width} numbers separated"
                f" by {separator!r}",
                "Write complex numbers as 0.1-0.2j.",
            )
        rows.append(row)
    if not rows:
        raise FileFormatError(f"{path} holds no rows of numbers", _CURE)
    names = first if has_header and len(first) == width else []
    return names, np.array(rows)


def _complex_numbers(cells: list[str]) -> list[complex] | None:
    """Numbers of cells, with i or j; None if one is a text."""
    plain = [re.sub("[ijIJ]", "j", cell.replace(" ", "")) for cell in cells]
    try:
        return [complex(cell) for cell in plain]
    except ValueError:
        return None


# -- two columns for each response ---------------------------------------------

# What a column holds of a response, by the words of its name; the first that fits.
_PARTS = {
    "imaginary": re.compile(r"(?<![a-z])(imag\w*|im)(?![a-z])", re.IGNORECASE),
    "real": re.compile(r"(?<![a-z])(real\w*|re)(?![a-z])", re.IGNORECASE),
    "phase": re.compile(r"(?<![a-z])(phase|angle|arg|phi|ph)(?![a-z])", re.IGNORECASE),
    "magnitude": re.compile(
        r"(?<![a-z])(mag\w*|abs|ampl\w*|modulus|db)(?![a-z])", re.IGNORECASE
    ),
}
_NO_LETTERS = re.compile(r"[\W_]+|(?<![a-z])(deg|rad|db)(?![a-z])", re.IGNORECASE)
FULL_TURN = 2 * np.pi


def _of_two_columns(
    names: Sequence[str], columns: Mapping[str, np.ndarray], path: str
) -> np.ndarray | None:
    """Responses of pairs of columns; None if their names do not say what they hold."""
    parts: dict[str, dict[str, str]] = {}  # names by part, by response
    for name in names:
        component = next((p for p, words in _PARTS.items() if words.search(name)), None)
        if component is None:
            return None
        response = _NO_LETTERS.sub("", _PARTS[component].sub("", name)).lower()
        parts.setdefault(response, {})[component] = name

    responses = []
    for pair in parts.values():
        if pair.keys() == {"real", "imaginary"}:
            real, imaginary = columns[pair["real"]], columns[pair["imaginary"]]
            responses.append(real + 1j * imaginary)
        elif pair.keys() == {"magnitude", "phase"}:
            responses.append(_of_magnitude_and_phase(pair, columns, path))
        else:
            return None
    return np.column_stack(responses) if responses else None


def _of_magnitude_and_phase(
    pair: Mapping[str, str], columns: Mapping[str, np.ndarray], path: str
) -> np.ndarray:
    """A response of its magnitude, which may be in dB, and its phase."""
    magnitude, phase = columns[pair["magnitude"]], columns[pair["phase"]]
    if re.search(r"(?<![a-z])db(?![a-z])", pair["magnitude"], re.IGNORECASE):
        magnitude = 10 ** (magnitude / 20)

    angle = np.deg2rad(phase) if _is_in_degrees(pair["phase"], phase, path) else phase
    return magnitude * np.exp(1j * angle)


def _is_in_degrees(name: str, phase: np.ndarray, path: str) -> bool:
    """Whether a phase is in degrees: by its name, else by a size above a full turn."""
    if re.search("deg|°", name, re.IGNORECASE):
        return True
    if re.search("rad", name, re.IGNORECASE):
        return False
    if np.abs(phase).max() > FULL_TURN:
        return True
    raise FileFormatError(
        f"{path}: the unit of the column {name!r} is not clear",
        "Name it, e.g. 'phase (deg)' or 'phase (rad)'.",
    )


# -- variables -----------------------------------------------------------------

_PAIR = re.compile(
    r"(?P<how>complex|polar)\((?P<first>[^,]+),(?P<second>[^,]+)\)\s*"
    r"(?:\*\s*(?P<factor>[^*@\s]+))?\s*\Z"
)


def _from_mapping(table: Table, mapping: Mapping[str, str]) -> _Responses:
    """Frequencies and responses as a mapping says."""
    numbers = {}
    for channel, text in mapping.items():
        match = re.fullmatch(r"H([1-9]\d*)", channel)
        if match is None and channel != "f":
            raise ChannelError(
                f"{channel!r} is no channel of a frequency response",
                "Map f, H1, H2, ...",
            )
        numbers[int(match[1]) if match else 0] = _mapped(table, channel, str(text))
    if sorted(numbers) != list(range(len(numbers))) or len(numbers) < 2:
        raise ChannelError(
            f"The mapping names {', '.join(mapping)}",
            "Map f and one response for each DOF: H1, H2, ...",
        )
    f, *responses = (numbers[k] for k in sorted(numbers))
    return _Responses(f, np.column_stack(responses))


def _mapped(table: Table, channel: str, text: str) -> np.ndarray:
    """One channel: a variable, or two of which a response is made."""
    pair = _PAIR.match(text.strip())
    if pair is None:
        return _variable(table, channel, text)
    first = _variable(table, channel, pair["first"])
    second = _variable(table, channel, pair["second"])
    factor = float(pair["factor"] or 1.0)
    if pair["how"] == "complex":
        return factor * (first + 1j * second)
    return factor * first * np.exp(1j * np.deg2rad(second))


def _variable(table: Table, channel: str, text: str) -> np.ndarray:
    expression = parse(text.strip(), table, channel)
    values = table.variables.get(expression.name)
    if values is None:
        raise FileFormatError(
            f"{table.path} has no variable {expression.name!r} for {channel}",
            f"It holds {table.names}.",
        )
    if expression.column is not None:
        values = values[:, expression.column]
    if values.ndim != 1:
        raise FileFormatError(
            f"{as_name(expression.name)} is a matrix", "Pick a column, name[:, 0]."
        )
    return expression.sign * values


def _from_variables(path: Path, max_bytes: int) -> _Responses:
    """Frequencies and responses from the variables f and H, or H1, H2, ..."""
    table = read_table(path, max_bytes=max_bytes)
    variables = {name.lower(): values for name, values in table.variables.items()}
    names = ("f", "freq", "frequency", "frequencies")
    f = next((variables[name] for name in names if name in variables), None)

    H = variables.get("h")
    if H is None:
        H = _side_by_side(variables)
    if H is None and f is not None:
        others = [name for name in variables if name not in names]
        H = _of_two_columns(others, variables, str(path))
    if f is None or H is None or not np.iscomplexobj(H):
        raise FileFormatError(
            f"{path} holds no frequencies 'f' and complex responses 'H'",
            f"It holds {table.names}.",
        )
    return _Responses(f, H)


def _side_by_side(variables: dict[str, np.ndarray]) -> np.ndarray | None:
    """The responses h1, h2, ... as columns; None if there are none of one length."""
    columns: list[np.ndarray] = []
    while f"h{len(columns) + 1}" in variables:
        columns.append(variables[f"h{len(columns) + 1}"])
    if len({len(column) for column in columns}) != 1:
        return None
    return np.column_stack(columns)


# -- UFF -----------------------------------------------------------------------


def _from_uff(path: Path, excited: int | None, max_bytes: int) -> _Responses:
    """Responses to the force on one node; nodes become DOFs in their order."""
    responses = read_uff_responses(path, max_bytes)
    if not responses:
        raise FileFormatError(
            f"{path} holds no frequency response (data set 58, function type 4)",
            "Spectra without a phase (PSDs) do not identify a model.",
        )

    nodes = sorted({response.node for response in responses})
    reference = _reference(path, responses, nodes, excited)
    chosen = {r.node: r for r in responses if r.reference == reference}
    first = chosen[min(chosen)]
    if sorted(chosen) != nodes or {r.letter for r in chosen.values()} != {first.letter}:
        raise FileFormatError(
            f"{path}: the force on node {reference} has no response of one kind at"
            f" every node of {', '.join(map(str, nodes))}",
            "Export the responses of all nodes to this force.",
        )
    lengths = {len(response.f) for response in chosen.values()}
    if len(lengths) > 1:
        raise FileFormatError(
            f"{path}: its responses have {', '.join(map(str, sorted(lengths)))} lines",
            "Export them with one resolution.",
        )
    H = np.column_stack([chosen[node].values * _scale(chosen[node]) for node in nodes])
    dof = nodes.index(reference) + 1 if reference in nodes else None
    return _Responses(first.f, H, dof, _KIND_OF_LETTER[first.letter])


def _reference(
    path: Path, responses: Sequence[UffResponse], nodes: list[int], excited: int | None
) -> int:
    """The node of the force."""
    references = sorted({response.reference for response in responses})
    if len(references) == 1:
        return references[0]
    if excited is not None and 1 <= excited <= len(nodes):
        if nodes[excited - 1] in references:
            return nodes[excited - 1]
    dofs = [str(nodes.index(node) + 1) for node in references if node in nodes]
    raise FileFormatError(
        f"{path} holds responses to forces on several nodes",
        f"Choose one: excited= (--excited) {', '.join(dofs)}.",
    )


def _scale(response: UffResponse) -> float:
    """Factor to SI units of a response over its force."""
    unit, unit_of_force = response.units
    scale = si_factor(unit, f"{response.letter}1") if unit else 1.0
    return scale / (si_factor(unit_of_force, "F1") if unit_of_force else 1.0)
