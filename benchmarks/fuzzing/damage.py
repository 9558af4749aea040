"""Damage: bytes flipped, cut, doubled, moved; numbers made huge; words put in; all from
one seed.
"""

# ruff: noqa: E501

from __future__ import annotations

import numpy as np

from .targets import Target, json_damage

WORDS = [
    b"nan",
    b"inf",
    b"-1",
    b"0",
    b"1e999",
    b"99999999999999999999",
    b"NULL",
    b"",
    b"\x00",
    b"\xff\xfe",
    b"\n",
    b";",
    b",",
    b"\t",
    b'"',
    b"[",
    b"]",
    b"{",
    b"}",
    b"<script>",
    b"../../x",
    b"%s%n",
    b"1j",
    b"\xc3",
    "Ω".encode(),
    b"-" * 40,
    b"9" * 400,
    b"(" * 200,
    b"#",
    b"58b",
    b"    -1",
    b"=",
    b"@ mm",
    b"* 2",
]
NUMBERS = [
    0,
    1,
    0x7F,
    0x80,
    0xFF,
    0x7FFF,
    0xFFFF,
    0x7FFFFFFF,
    0x80000000,
    0xFFFFFFFF,
    2**62,
    2**63,
    2**64 - 1,
]


def damaged(target: Target, seeds: list[bytes], rng: np.random.Generator) -> bytes:
    """One damaged file.

    Parameters
    ----------
    target : Target
    seeds : list of bytes
    rng : numpy.random.Generator

    Returns
    -------
    bytes
    """
    seed = seeds[int(rng.integers(len(seeds)))]
    if rng.random() < 0.02:
        return rng.bytes(int(rng.integers(1, 600)))
    if target.name == "model JSON" and rng.random() < 0.7:
        return json_damage(seed, rng)
    data = bytearray(seed)
    for _ in range(int(rng.geometric(0.35))):
        data = _once(data, target, seeds, rng)
    return bytes(data)


def _once(
    data: bytearray, target: Target, seeds: list[bytes], rng: np.random.Generator
) -> bytearray:
    if not data:
        return bytearray(rng.bytes(8))
    at = int(rng.integers(len(data)))
    if rng.random() < 0.3:  # headers hold the sizes
        at = int(rng.integers(min(len(data), 256)))
    length = int(min(rng.geometric(0.08), len(data) - at))
    what = int(rng.integers(9))
    if what == 0:
        data[at] ^= 1 << int(rng.integers(8))
    elif what == 1:
        data[at : at + length] = rng.bytes(length)
    elif what == 2:
        del data[at : at + length]
    elif what == 3:
        data[at:at] = data[at : at + length] * int(rng.integers(1, 6))
    elif what == 4:
        return data[:at]
    elif what == 5 or target.text:
        word = WORDS[int(rng.integers(len(WORDS)))]
        data[at : at + int(rng.integers(0, 2)) * len(word)] = word
    elif what == 6:
        size = int(rng.choice([1, 2, 4, 8]))
        number = NUMBERS[int(rng.integers(len(NUMBERS)))] % 256**size
        data[at : at + size] = number.to_bytes(
            size, "little" if rng.random() < 0.7 else "big"
        )
    elif what == 7:
        other = seeds[int(rng.integers(len(seeds)))]
        cut = int(rng.integers(len(other)))
        data[at:] = other[cut:]
    else:
        data[at : at + length] = bytes(length)
    return data
