"""Numeric arrays by name, out of nested structures.

Run as a script, this module writes those of a MATLAB file (up to v7) as NPZ to standard
output. It imports NumPy and SciPy alone, so that the process starts fast.
"""

import json
import sys
from collections.abc import Mapping, Sequence

import numpy as np

NUMERIC_KINDS = "biufcmM"


def numeric_arrays(
    content: Mapping[str, object], prefix: str = ""
) -> dict[str, np.ndarray]:
    """Numeric arrays by name.

    Parameters
    ----------
    content : mapping of str to array, structure or mapping
        Fields of structures are called ``struct.field``; what is not numeric is left
        out.
    prefix : str
        Put before each name.

    Returns
    -------
    dict of str to ndarray
        A matrix of one row or column becomes one-dimensional, one of a single number
        has no dimension.
    """
    arrays: dict[str, np.ndarray] = {}
    for name, value in content.items():
        if isinstance(value, Mapping):
            arrays |= numeric_arrays(value, f"{prefix}{name}.")
            continue
        cells = _cells(value)
        if cells is not None:
            arrays |= numeric_arrays(cells, f"{prefix}{name}.")
            continue

        array = np.asarray(value)
        if array.dtype.names:
            fields = {field: array[field] for field in array.dtype.names}
            arrays |= numeric_arrays(fields, f"{prefix}{name}.")
        elif array.dtype.kind in NUMERIC_KINDS:
            arrays[f"{prefix}{name}"] = _without_single_axis(array)
    return arrays


def _cells(value: object) -> dict[str, object] | None:
    """Cells of a cell array, or structures of an array of them, by their numbers."""
    if isinstance(value, np.ndarray) and value.dtype == object:
        value = value.ravel().tolist()
    if not isinstance(value, list):
        return None
    return {str(number): cell for number, cell in enumerate(value, 1)}


# Names under which structures of measuring programs hold samples, their unit, rate (Hz)
# and step (s).
_SAMPLES = ("values", "data", "signal", "samples", "y", "y_values")
_UNIT = ("unit", "units", "label", "unit_string")
_NAME = ("name", "channel", "channel_name", "channelname", "title")
_RATE = ("fs", "samplerate", "sampling_rate", "sample_rate")
_STEP = ("dt", "increment", "delta_t", "delta_x", "xinc")
_START = ("start_value", "t0", "x0", "start")


def stated_units(content: Mapping[str, object], prefix: str = "") -> dict[str, str]:
    """Units that stand next to samples in structures, by the name of the samples.

    ``Signal_0.y_values.quantity.label`` is the unit of ``Signal_0.y_values.values``,
    and ``acc.unit`` that of ``acc.data``.
    """
    units: dict[str, str] = {}
    for name, value in _structures(content).items():
        units |= stated_units(value, f"{prefix}{name}.")
        unit = _text(value, _UNIT) or _text(_structure_in(value, "quantity"), _UNIT)
        if unit:
            for samples in _SAMPLES:
                if samples in value and not isinstance(value[samples], Mapping):
                    units[f"{prefix}{name}.{samples}"] = unit
    return units


def stated_clocks(
    content: Mapping[str, object], prefix: str = ""
) -> dict[str, tuple[float, float]]:
    """Rates (Hz) and starts (s) that structures state, by the prefix of the fields."""
    clocks: dict[str, tuple[float, float]] = {}
    for name, value in _structures(content).items():
        clocks |= stated_clocks(value, f"{prefix}{name}.")
        axis = _structure_in(value, "x_values") or value
        rate, step = _number(axis, _RATE), _number(axis, _STEP)
        if step and not rate:
            rate = 1.0 / step
        if rate and rate > 0:
            clocks[f"{prefix}{name}."] = (rate, _number(axis, _START) or 0.0)
    return clocks


def stated_names(content: Mapping[str, object], prefix: str = "") -> dict[str, str]:
    """Names that structures give to their samples, by the name of the array."""
    names: dict[str, str] = {}
    for name, value in _structures(content).items():
        names |= stated_names(value, f"{prefix}{name}.")
        title = _text(value, _NAME) or _text(
            _structure_in(value, "function_record"), _NAME
        )
        holder = _structure_in(value, "y_values")
        for samples in _SAMPLES:
            if title and samples in holder:
                names[f"{prefix}{name}.y_values.{samples}"] = title
            elif title and samples in value and samples != "y_values":
                names[f"{prefix}{name}.{samples}"] = title
    return names


def _structures(content: Mapping[str, object]) -> dict[str, Mapping[str, object]]:
    """Structures among some fields, those of cells by their numbers."""
    structures: dict[str, Mapping[str, object]] = {}
    for name, value in content.items():
        fields = _cells(value) or value
        if isinstance(fields, Mapping):
            structures[name] = fields
    return structures


def _structure_in(fields: Mapping[str, object], name: str) -> Mapping[str, object]:
    value = fields.get(name)
    return value if isinstance(value, Mapping) else {}


def _text(fields: Mapping[str, object], names: Sequence[str]) -> str:
    """The first of some fields that is a text."""
    for name, value in fields.items():
        if name.lower() in names and isinstance(value, str):
            return value.strip()
    return ""


def _number(fields: Mapping[str, object], names: Sequence[str]) -> float | None:
    """The first of some fields that is a number."""
    for name, value in fields.items():
        if name.lower() in names:
            number = np.asarray(value)
            if number.size == 1 and number.dtype.kind in "iuf":
                return float(number.item())
    return None


def _without_single_axis(array: np.ndarray) -> np.ndarray:
    """A matrix of one row or column as a line, one of a single value as a number."""
    if array.ndim != 2 or 1 not in array.shape:
        return array
    return array.ravel() if array.size > 1 else array.reshape(())


def write_matlab_arrays(path: str) -> None:
    """Write the numeric arrays of a MATLAB file to standard output.

    The first array of the NPZ is a JSON text: the names of the others, the objects of
    MATLAB (timetables, durations), which are numbers to MATLAB alone, and the units and
    clocks that structures state.
    """
    from scipy.io import loadmat
    from scipy.io.matlab import MatlabOpaque

    variables, objects = {}, []
    for name, value in loadmat(path, simplify_cells=True).items():
        if isinstance(value, MatlabOpaque):
            title, class_name = value[0]["s0"].decode(), value[0]["s2"].decode()
            objects.append(f"{title} ({class_name})")
        elif not name.startswith("__"):
            variables[name] = value

    arrays = numeric_arrays(variables)
    stated = {
        "units": stated_units(variables),
        "clocks": stated_clocks(variables),
        "titles": stated_names(variables),
    }
    index = json.dumps({"names": list(arrays), "objects": objects} | stated)
    np.savez(sys.stdout.buffer, np.array(index), *arrays.values())


if __name__ == "__main__":
    try:
        write_matlab_arrays(sys.argv[1])
    except Exception as error:
        sys.exit(f"{error or type(error).__name__}"[:500])
