"""Damage: bytes flipped, cut, doubled, moved; huge numbers; odd words; one seed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

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
HEADER = 256  # bytes, in which a file says its sizes


def damaged(target: Target, seeds: list[bytes], rng: np.random.Generator) -> bytes:
    """One damaged file, made of the good files of a target."""
    seed = seeds[int(rng.integers(len(seeds)))]
    if rng.random() < 0.02:
        return rng.bytes(int(rng.integers(1, 600)))
    if target.name == "model JSON" and rng.random() < 0.7:
        return json_damage(seed, rng)
    data = bytearray(seed)
    for _ in range(int(rng.geometric(0.35))):
        data = damaged_once(data, target, seeds, rng)
    return bytes(data)


@dataclass(frozen=True)
class Damage:
    """Bytes from a place on, to be damaged."""

    data: bytearray
    start: int
    length: int
    seeds: list[bytes]
    rng: np.random.Generator

    @property
    def rows(self) -> slice:
        return slice(self.start, self.start + self.length)

    def flip_a_bit(self) -> bytearray:
        self.data[self.start] ^= 1 << int(self.rng.integers(8))
        return self.data

    def randomise(self) -> bytearray:
        self.data[self.rows] = self.rng.bytes(self.length)
        return self.data

    def delete(self) -> bytearray:
        del self.data[self.rows]
        return self.data

    def repeat(self) -> bytearray:
        piece = self.data[self.rows]
        self.data[self.start : self.start] = piece * int(self.rng.integers(1, 6))
        return self.data

    def cut_off(self) -> bytearray:
        return self.data[: self.start]

    def put_a_word(self) -> bytearray:
        word = WORDS[int(self.rng.integers(len(WORDS)))]
        n_replaced = int(self.rng.integers(0, 2)) * len(word)
        self.data[self.start : self.start + n_replaced] = word
        return self.data

    def put_a_number(self) -> bytearray:
        size = int(self.rng.choice([1, 2, 4, 8]))
        number = NUMBERS[int(self.rng.integers(len(NUMBERS)))] % 256**size
        order = "little" if self.rng.random() < 0.7 else "big"
        written = number.to_bytes(size, order)
        self.data[self.start : self.start + size] = written
        return self.data

    def end_with_another(self) -> bytearray:
        other = self.seeds[int(self.rng.integers(len(self.seeds)))]
        self.data[self.start :] = other[int(self.rng.integers(len(other))) :]
        return self.data

    def zero(self) -> bytearray:
        self.data[self.rows] = bytes(self.length)
        return self.data


OF_BYTES: tuple[Callable[[Damage], bytearray], ...] = (
    Damage.flip_a_bit,
    Damage.randomise,
    Damage.delete,
    Damage.repeat,
    Damage.cut_off,
    Damage.put_a_word,
    Damage.put_a_number,
    Damage.end_with_another,
    Damage.zero,
)
# what would need bytes is a word instead
OF_TEXT = (*OF_BYTES[:5], *[Damage.put_a_word] * 4)


def damaged_once(
    data: bytearray, target: Target, seeds: list[bytes], rng: np.random.Generator
) -> bytearray:
    if not data:
        return bytearray(rng.bytes(8))
    start = int(rng.integers(len(data)))
    if rng.random() < 0.3:
        start = int(rng.integers(min(len(data), HEADER)))
    length = int(min(rng.geometric(0.08), len(data) - start))
    ways = OF_TEXT if target.text else OF_BYTES
    way = ways[int(rng.integers(len(ways)))]
    return way(Damage(data, start, length, seeds, rng))
