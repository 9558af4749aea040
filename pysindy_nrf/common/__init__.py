"""Tools of all layers: numbers, random states, imports, files, threads, settings."""

import zlib
from typing import SupportsIndex, TypeGuard

import numpy as np

from ..exceptions import NRFError

# What a user may give as the source of randomness.
RandomState = int | np.random.Generator | None

# A larger number of DOFs is a mistake, or a file that would exhaust the memory.
MAX_DOFS = 10_000


def number_of(value: object) -> float:
    """A value as a float; NaN if it is none."""
    try:
        return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        return float("nan")


def is_whole(value: object) -> TypeGuard[SupportsIndex]:
    """Whether a value is a whole number; a truth value is none."""
    return isinstance(value, SupportsIndex) and not isinstance(value, bool)


def positive(name: str, value: object, cure: str, error: type[Exception]) -> float:
    """A positive number, or an error of the given kind."""
    number = number_of(value)
    if not 0 < number < float("inf"):
        raise error(f"{name}={value!r} is not a positive number", cure)
    return number


def generator(random_state: RandomState, purpose: str = "") -> np.random.Generator:
    """A generator of random numbers for a seed, a generator or None.

    A purpose gives a seed its own stream: noise and excitation of one seed are
    independent.
    """
    seed: RandomState | np.random.SeedSequence = random_state
    try:
        if purpose and isinstance(random_state, SupportsIndex):
            stream = zlib.crc32(purpose.encode())
            seed = np.random.SeedSequence(int(random_state), spawn_key=(stream,))
        return np.random.default_rng(seed)
    except (TypeError, ValueError) as error:
        raise NRFError(
            f"random_state={random_state!r} is no seed",
            "Give a whole number from 0, a numpy Generator, or None.",
        ) from error
