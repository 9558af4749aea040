"""Units of channels, converted to SI by pint."""

import re
from collections.abc import Iterator
from functools import cache, lru_cache
from typing import Any

from ...common.lazy import require
from ...exceptions import ChannelError

_DIMENSIONS = {
    "x": "length",
    "v": "velocity",
    "a": "acceleration",
    "F": "force",
    "t": "time",
}
_SI = {
    "length": "m",
    "velocity": "m/s",
    "acceleration": "m/s^2",
    "force": "N",
    "time": "s",
}
_ARTICLE = {
    "length": "a displacement",
    "velocity": "a velocity",
    "acceleration": "an acceleration",
    "force": "a force",
    "time": "the time",
}
_EXAMPLES = {
    "length": "m, mm, in",
    "velocity": "m/s, mm/s, in/s",
    "acceleration": "m/s^2, g, cm/s^2",
    "force": "N, kN, kip",
    "time": "s, ms",
}
# Usage of engineers where pint reads the same letters as something else (g = gram, mil
# = angle, lb = mass).
_JARGON = {
    "length": {"mil": "thou", "mils": "thou"},
    "acceleration": {
        "g": "standard_gravity",
        "mg": "millistandard_gravity",
        "gal": "galileo",
        "gals": "galileo",
    },
    "force": {"lb": "lbf", "lbs": "lbf", "kp": "kgf", "n": "N", "kn": "kN", "mn": "mN"},
}
# exponents (mass, length, time) of what channels measure
_EXPONENTS = {
    "length": (0, 1, 0),
    "velocity": (0, 1, -1),
    "acceleration": (0, 1, -2),
    "force": (1, 1, -2),
    "time": (0, 0, 1),
    "mass": (1, 0, 0),
    "a frequency": (0, 0, -1),
    "energy": (1, 2, -2),
    "a pressure": (1, -1, -2),
    "a stiffness": (1, 0, -2),
    "a number or an angle": (0, 0, 0),
}
_TOKEN = re.compile(r"([A-Za-zµμ_]+?)(?:(?:\^|\*\*)?(-?[1-4]))?")
_MOST = 24  # characters of a unit


def dimension_of(channel: str) -> str | None:
    """Quantity that a channel measures, None for a covariate."""
    return (
        _DIMENSIONS[channel[0]]
        if re.fullmatch(r"t|[avxF]\d+|[avx]g", channel)
        else None
    )


def si_unit(channel: str) -> str:
    """SI unit of a channel, ``""`` for a covariate."""
    return _SI.get(dimension_of(channel) or "", "")


def factor(unit: str, channel: str) -> float:
    """Factor from a unit to the SI unit of a channel."""
    kind = dimension_of(channel)
    if kind is None:
        cure = "Scale it: name * number."
        raise ChannelError(
            f"{channel!r} is a covariate and keeps its unit, {unit!r} cannot be"
            " converted",
            cure,
        )
    text = _clean(unit)
    if text == _SI[kind]:
        return 1.0
    measured = []
    for candidate in _readings(text, kind):
        found = _parsed(candidate)
        if found is not None:
            size, dimension = found
            if dimension == _EXPONENTS[kind]:
                return float(f"{size:.15g}")  # pint's own round-off
            measured.append(dimension)
    if measured:
        other = next((k for k, words in _JARGON.items() if text in words), None)
        other = other or next(
            (name for name, known in _EXPONENTS.items() if known == measured[0]),
            "something else",
        )
        cure = f"Write e.g. {_EXAMPLES[kind]}."
        raise ChannelError(
            f"Channel {channel} is {_ARTICLE[kind]}, but its unit {unit!r} measures"
            f" {other}",
            cure,
        )
    cure = f"Write e.g. {_EXAMPLES[kind]}, or scale the channel: name * number."
    raise ChannelError(f"The unit {unit!r} of channel {channel} is unknown", cure)


_SUFFIXES = {
    u.lower(): u
    for u in (
        "g",
        "mg",
        "gal",
        "m",
        "mm",
        "cm",
        "in",
        "ft",
        "N",
        "kN",
        "lbf",
        "kip",
        "s",
        "ms",
    )
}
_SUFFIXES |= {
    "um": "µm",
    "us": "µs",
    "mps": "m/s",
    "mms": "mm/s",
    "ms2": "m/s^2",
    "mps2": "m/s^2",
    "mss": "m/s^2",
}


def split_suffix(name: str) -> tuple[str, str | None]:
    """Name of a column and the unit behind its last underscore or slash: ``acc_2_g``,
    ``time_ms``, ``Weg 1/mm``.
    """
    bare, _, suffix = name.strip().replace("/", "_").rpartition("_")
    known = bool(bare) and suffix.lower() in _SUFFIXES
    return (
        (name.strip()[: len(bare)], _SUFFIXES[suffix.lower()])
        if known
        else (name.strip(), None)
    )


def kind_of_unit(unit: str | None) -> str | None:
    """Letter of the channels that a unit measures (``a``, ``v``, ``x``, ``F``, ``t``),
    if it is one of theirs.
    """
    text = _clean(unit or "")
    for letter, kind in sorted(_DIMENSIONS.items()) if text else ():
        if text == _SI[kind] or any(
            found is not None and found[1] == _EXPONENTS[kind]
            for found in map(_parsed, _readings(text, kind))
        ):
            return letter
    return None


def is_unit(text: str) -> bool:
    """True if a text of a header is a unit of length, velocity, acceleration, force or
    time.
    """
    cleaned = _clean(text)
    if cleaned in _SI.values():
        return True
    numbers_a_sensor = len(cleaned) == 1 and cleaned not in "msgNGh"  # "acc (A)"
    return not numbers_a_sensor and kind_of_unit(text) is not None


def _clean(unit: str) -> str:
    """One spelling of powers, products and brackets; SI as ``m/s^2``."""
    text = unit.strip().strip("[]()").strip()
    if len(text) > 2 * _MOST:
        return text
    for old, new in (
        ("⁻¹", "^-1"),
        ("⁻²", "^-2"),
        ("²", "^2"),
        ("·", "*"),
        ("**", "^"),
        ("μ", "µ"),
    ):
        text = text.replace(old, new)
    text = re.sub(r"\s*([*/^])\s*", r"\1", text)
    if re.fullmatch(r"m\*?\s*s\^?-2|m/s2|m/s/s|m/s\^2|m/\(s\^2\)", text):
        return "m/s^2"
    return "m/s" if re.fullmatch(r"m\*?\s*s\^?-1|m/s", text) else text


def _readings(text: str, kind: str) -> Iterator[str]:
    """Readings of a unit for a quantity: engineers' usage, as written, and capitals as
    small letters.
    """
    jargon = _JARGON.get(kind, {})
    yield jargon.get(text, text)
    if text.isupper() or (len(text) > 2 and text.istitle()):
        yield jargon.get(text.lower(), text.lower())


def _tokens(text: str) -> list[tuple[str, int]] | None:
    """Unit names and their powers, None for any other text; nothing else is passed to
    pint.
    """
    if not text or len(text) > _MOST:
        return None
    out: list[tuple[str, int]] = []
    for sign, part in zip(
        [1, *(1 if s in "* " else -1 for s in re.findall(r"[*/ ]", text))],
        re.split(r"[*/ ]", text),
    ):
        match = _TOKEN.fullmatch(part)
        if match is None:
            return None
        name, power = match[1], sign * int(match[2] or 1)
        out += (
            [("m", 1), ("s", power)]
            if name == "ms" and power < -1 and len(part) == len(text)
            else [(name, power)]
        )
    return out


@lru_cache(maxsize=256)
def _parsed(text: str) -> tuple[float, tuple[int, int, int]] | None:
    """Size in SI and exponents of mass, length and time; None if the text is not a
    unit.
    """
    tokens = _tokens(text)
    if tokens is None:
        return None
    pint = require("pint", "files", f"Converting the unit {text!r}")
    registry = _registry()
    try:
        quantity = registry.Quantity(1.0)
        for name, power in tokens:
            quantity = (
                quantity * registry.Quantity(1.0, registry.parse_units(name)) ** power
            )
        dimensions = dict(quantity.dimensionality)
        size = float(quantity.to_base_units().magnitude)
    except (
        pint.PintError,
        ValueError,
        TypeError,
        AttributeError,
        OverflowError,
        ZeroDivisionError,
    ):
        return None
    mass, length, time = (
        int(dimensions.pop(key, 0)) for key in ("[mass]", "[length]", "[time]")
    )
    return None if dimensions else (size, (mass, length, time))


@cache
def _registry() -> Any:
    import pint

    return pint.UnitRegistry()
