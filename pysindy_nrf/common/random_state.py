"""Random numbers from the argument ``random_state``."""

import zlib
from typing import Any

import numpy as np

from ..exceptions import NRFError


def generator(random_state: Any, purpose: str = "") -> np.random.Generator:
    """A generator of random numbers for a seed, a generator or None; raises NRFError for anything else."""
    try:
        if purpose and hasattr(random_state, "__index__"):
            key = zlib.crc32(purpose.encode())
            return np.random.default_rng(np.random.SeedSequence(int(random_state), spawn_key=(key,)))
        return np.random.default_rng(random_state)
    except (TypeError, ValueError) as error:
        cure = "Give a whole number from 0, a numpy Generator, or None."
        raise NRFError(f"random_state={random_state!r} is no seed", cure) from error
