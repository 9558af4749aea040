"""The time of evenly sampled records, without a number for each sample."""

from __future__ import annotations

from typing import Any

import numpy as np


class EvenClock:
    """Times 0, dt, 2 dt, ... as an array would give them; numbers are made for the rows that are asked for.

    A slice is an array; whatever else an array can do, it does after all times have been made.

    Parameters
    ----------
    size : int
    dt : float
        Sampling step, s.

    Examples
    --------
    >>> clock = EvenClock(5, 0.5)
    >>> len(clock), float(clock[-1]), clock[1:3], clock + 1.0
    (5, 2.0, array([0.5, 1. ]), array([1. , 1.5, 2. , 2.5, 3. ]))
    """

    def __init__(self, size: int, dt: float) -> None:
        self._size, self._dt = size, dt

    def __len__(self) -> int:
        return self._size

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):
            return np.arange(*index.indices(self._size)) * self._dt
        if isinstance(index, (int, np.integer)):
            return np.float64(range(self._size)[index] * self._dt)
        return np.asarray(self)[index]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.asarray(self[:], dtype=dtype)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self[:], name)

    def __add__(self, other: Any) -> np.ndarray:
        return self[:] + other

    def __sub__(self, other: Any) -> np.ndarray:
        return self[:] - other

    def __mul__(self, other: Any) -> np.ndarray:
        return self[:] * other

    def __rsub__(self, other: Any) -> np.ndarray:
        return other - self[:]

    def __truediv__(self, other: Any) -> np.ndarray:
        return self[:] / other

    __radd__, __rmul__ = __add__, __mul__
