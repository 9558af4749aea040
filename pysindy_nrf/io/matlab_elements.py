"""The elements of a MATLAB v5 file, checked before SciPy reads them.

SciPy's compiled reader trusts the type of every data element; one damaged byte there ends the process.
Format: "MAT-File Format", The MathWorks, chapter "Level 5 MAT-file format".
"""

from __future__ import annotations

import math
import struct
import zlib
from pathlib import Path

_HEADER = 128
_MATRIX, _COMPRESSED = 14, 15
# int8 .. uint32, single, double, int64, uint64, matrix, UTF-8, UTF-16, UTF-32
_TYPES = frozenset([1, 2, 3, 4, 5, 6, 7, 9, 12, 13, _MATRIX, 16, 17, 18])
_NUMERIC = frozenset([1, 2, 3, 4, 5, 6, 7, 9, 12, 13])
_TEXT = frozenset([1, 2, 16, 17, 18])
# Classes of variables: double, single, int8 .. uint64 are 6 .. 15.
_CELL, _STRUCT, _CLASS, _CHAR, _SPARSE, _NUMBERS, _FUNCTION, _OBJECT = 1, 2, 3, 4, 5, range(6, 16), 16, 17
_DEEPEST = 60


def check_elements(path: Path) -> None:
    """Walk through all data elements of a v5 file.

    Parameters
    ----------
    path : Path

    Raises
    ------
    ValueError, zlib.error, struct.error
        If an element has a type that does not exist or reaches beyond what holds it.
    """
    raw = memoryview(path.read_bytes())
    mark = bytes(raw[126:128])
    if mark not in (b"IM", b"MI"):
        return  # v4, which has no such elements
    order = "<" if mark == b"IM" else ">"
    at = _HEADER
    while at + 8 <= len(raw):
        kind, size = struct.unpack_from(order + "II", raw, at)
        body = raw[at + 8 : at + 8 + size]
        if len(body) < size:
            raise ValueError(f"a variable of {size} bytes begins {len(raw) - at} bytes before the end")
        if kind == _COMPRESSED:
            _walk(memoryview(zlib.decompress(body)), order, 0)
        elif kind == _MATRIX:
            _matrix(body, order, 0)
        else:
            raise ValueError(f"a variable of the type {kind}, which does not exist")
        at += 8 + size


def _walk(body: memoryview, order: str, depth: int) -> list[tuple[int, memoryview]]:
    """The elements side by side in some bytes, each checked with all it holds."""
    if depth > _DEEPEST:
        raise ValueError("variables nested too deeply")
    at, found = 0, []
    while at + 8 <= len(body):
        first, size = struct.unpack_from(order + "II", body, at)
        if first >> 16:  # a small element: type and size in one word, data in the other
            kind, size, start, step = first & 0xFFFF, first >> 16, at + 4, 8
            if size > 4:
                raise ValueError(f"a small element of {size} bytes")
        else:
            kind, start = first, at + 8
            step = 8 + size + (-size % 8 if kind != _COMPRESSED else 0)
        if kind not in _TYPES:
            raise ValueError(f"an element of the type {kind}, which does not exist")
        if start + size > len(body):
            raise ValueError(f"an element of {size} bytes where {len(body) - start} are left")
        inner = body[start : start + size]
        if kind == _MATRIX and size:
            _matrix(inner, order, depth + 1)
        found.append((kind, inner))
        at += step
    return found


def _matrix(body: memoryview, order: str, depth: int) -> None:
    """A variable: flags, dimensions, name, then as many elements as its class and dimensions announce."""
    parts = _walk(body, order, depth)
    if not parts or parts[0][0] != 6 or len(parts[0][1]) != 8:
        raise ValueError("a variable without flags")
    flags = struct.unpack_from(order + "I", parts[0][1])[0]
    kind, is_complex = flags & 0xFF, bool(flags & 0x800)
    if kind == _OBJECT:  # tables, strings: no dimensions
        if len(parts) < 5 or any(k not in _TEXT for k, _ in parts[1:4]) or parts[4][0] != _MATRIX:
            raise ValueError("an object without name, class and content")
        return
    if len(parts) < 3 or parts[1][0] not in (5, 6) or len(parts[1][1]) % 4 or parts[2][0] not in _TEXT:
        raise ValueError("a variable without dimensions and name")
    shape = struct.unpack_from(f"{order}{len(parts[1][1]) // 4}i", parts[1][1])
    if len(shape) < 2 or min(shape) < 0:
        raise ValueError(f"a variable of the shape {shape}")
    _require_content(kind, is_complex, math.prod(shape), parts[3:], order)


def _require_content(kind: int, is_complex: bool, size: int, rest: list[tuple[int, memoryview]], order: str) -> None:
    """Whether what follows the name is what the class announces."""
    kinds = [k for k, _ in rest]
    if kind in _NUMBERS:
        fits = len(rest) == 1 + is_complex and _NUMERIC.issuperset(kinds)
    elif kind == _CHAR:
        fits = len(rest) == 1 and (_NUMERIC | _TEXT).issuperset(kinds)
    elif kind == _SPARSE:
        fits = len(rest) == 3 + is_complex and _NUMERIC.issuperset(kinds)
    elif kind == _CELL:
        fits = len(rest) == size and {_MATRIX}.issuperset(kinds)
    elif kind in (_STRUCT, _CLASS):
        head = rest[kind == _CLASS :][:2]
        fits = len(head) == 2 and head[0][0] in (5, 6) and len(head[0][1]) == 4 and head[1][0] in _TEXT
        width = struct.unpack_from(order + "i", head[0][1])[0] if fits else 0
        fits = fits and width > 0 and len(head[1][1]) % width == 0
        inner = kinds[2 + (kind == _CLASS) :]
        fits = fits and len(inner) == size * (len(head[1][1]) // width) and {_MATRIX}.issuperset(inner)
    else:
        fits = kind == _FUNCTION and kinds == [_MATRIX]
    if not fits:
        raise ValueError(f"a variable of the class {kind} with {len(rest)} elements that do not fit its shape")
