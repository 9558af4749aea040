"""The one door for randomness: what ``random_state`` may be."""

from __future__ import annotations

import zlib
from typing import Any

import numpy as np

from ..exceptions import NRFError


def generator(random_state: Any, purpose: str = "") -> np.random.Generator:
    """A generator of random numbers, or an error that says what to give.

    Parameters
    ----------
    random_state : int, Generator or None
        A whole number gives the same numbers at every call, None fresh ones.
    purpose : str
        What the numbers are for: one whole number gives each purpose a stream of its own, independent of the others.
        Whoever passes a sequence of numbers or a Generator has chosen the stream; it is taken as it is.

    Returns
    -------
    numpy.random.Generator

    Raises
    ------
    NRFError
        If it is anything else.

    Examples
    --------
    >>> from pysindy_nrf.common.random_state import generator
    >>> bool(generator(7).normal() == generator(7).normal())
    True
    >>> bool(generator(7).normal() == generator(7, "noise").normal())
    False
    """
    try:
        if purpose and hasattr(random_state, "__index__"):
            key = zlib.crc32(purpose.encode())
            return np.random.default_rng(np.random.SeedSequence(int(random_state), spawn_key=(key,)))
        return np.random.default_rng(random_state)
    except (TypeError, ValueError) as error:
        raise NRFError(
            f"random_state={random_state!r} is no seed", "Give a whole number from 0, a numpy Generator, or None."
        ) from error
