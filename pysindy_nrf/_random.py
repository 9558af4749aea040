"""The one door for randomness: what ``random_state`` may be."""

from __future__ import annotations

from typing import Any

import numpy as np

from .exceptions import NRFError


def generator(random_state: Any) -> np.random.Generator:
    """A generator of random numbers, or an error that says what to give.

    Parameters
    ----------
    random_state : int, Generator or None
        A whole number gives the same numbers at every call, None fresh ones.

    Returns
    -------
    numpy.random.Generator

    Raises
    ------
    NRFError
        If it is anything else.

    Examples
    --------
    >>> from pysindy_nrf._random import generator
    >>> bool(generator(7).normal() == generator(7).normal())
    True
    """
    try:
        return np.random.default_rng(random_state)
    except (TypeError, ValueError) as error:
        raise NRFError(
            f"random_state={random_state!r} is no seed", "Give a whole number from 0, a numpy Generator, or None."
        ) from error
