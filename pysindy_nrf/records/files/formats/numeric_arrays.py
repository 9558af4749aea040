"""Numeric arrays by name, out of nested structures.

Run as a script, this module writes those of a MATLAB file (up to v7) as NPZ to standard
output. It imports NumPy and SciPy alone, so that the process starts fast.
"""

import json
import sys
from collections.abc import Mapping

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

        array = np.asarray(value)
        if array.dtype.names:
            fields = {field: array[field] for field in array.dtype.names}
            arrays |= numeric_arrays(fields, f"{prefix}{name}.")
        elif array.dtype.kind in NUMERIC_KINDS:
            arrays[f"{prefix}{name}"] = _without_single_axis(array)
    return arrays


def _without_single_axis(array: np.ndarray) -> np.ndarray:
    """A matrix of one row or column as a line, one of a single value as a number."""
    if array.ndim != 2 or 1 not in array.shape:
        return array
    return array.ravel() if array.size > 1 else array.reshape(())


def write_matlab_arrays(path: str) -> None:
    """Write the numeric arrays of a MATLAB file to standard output.

    The first array of the NPZ is a JSON text: the names of the others, and the objects
    of MATLAB (timetables, durations), which are numbers to MATLAB alone.
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
    index = json.dumps({"names": list(arrays), "objects": objects})
    np.savez(sys.stdout.buffer, np.array(index), *arrays.values())


if __name__ == "__main__":
    try:
        write_matlab_arrays(sys.argv[1])
    except Exception as error:
        sys.exit(f"{error or type(error).__name__}"[:500])
