"""Nested content of binary files as flat variables."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np


def flattened(content: Mapping[str, Any], prefix: str = "") -> dict[str, np.ndarray]:
    """Numeric arrays by name; fields of structures as ``struct.field``; single columns one-dimensional."""
    out: dict[str, np.ndarray] = {}
    for name, value in content.items():
        if isinstance(value, Mapping):
            out |= flattened(value, f"{prefix}{name}.")
            continue
        array = np.asarray(value)
        if array.dtype.names:
            out |= flattened({field: array[field] for field in array.dtype.names}, f"{prefix}{name}.")
            continue
        if array.dtype.kind not in "biufcmM":
            continue
        if array.ndim == 2 and 1 in array.shape:
            array = array.ravel() if array.size > 1 else array.reshape(())
        out[f"{prefix}{name}"] = array
    return out
