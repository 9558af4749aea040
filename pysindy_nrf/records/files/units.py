"""Units of channels, converted to SI by pint."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache, lru_cache
from typing import TYPE_CHECKING

from ...common.lazy import require
from ...exceptions import ChannelError

if TYPE_CHECKING:
    import pint
    from pint.facets.plain import PlainQuantity

MAX_UNIT_LENGTH = 24  # characters


@dataclass(frozen=True)
class Quantity:
    """What a kind of channel measures."""

    name: str  # also pint's name of the dimension, in brackets
    noun: str
    si: str
    examples: str
    # usage of engineers where pint reads the same letters as something else: g is a
    # gram, mil an angle, lb a mass
    jargon: dict[str, str] = field(default_factory=dict)


# Angles, by which a unit measures a rotation, and torques as engineers write them.
_ANGLES = {
    *("rad", "mrad", "radian", "radians", "deg", "degree", "degrees", "°"),
    *("rev", "revs", "revolution", "turn", "rpm"),
}
_TORQUES = {"Nm": "N*m", "kNm": "kN*m", "mNm": "mN*m", "Nmm": "N*mm", "Ncm": "N*cm"}
SI_OF_ROTATION = {"x": "rad", "v": "rad/s", "a": "rad/s^2", "F": "N m"}
_DIMENSION_OF_ROTATION = {
    "x": "[]",
    "v": "1 / [time]",
    "a": "1 / [time] ** 2",
    "F": "[force] * [length]",
}

QUANTITIES = {
    "x": Quantity(
        "length",
        "a displacement",
        "m",
        "m, mm, in",
        {"mil": "thou", "mils": "thou", "zoll": "inch", "Zoll": "inch"},
    ),
    "v": Quantity("velocity", "a velocity", "m/s", "m/s, mm/s, in/s"),
    "a": Quantity(
        "acceleration",
        "an acceleration",
        "m/s^2",
        "m/s^2, g, cm/s^2",
        {
            "g": "standard_gravity",
            "gs": "standard_gravity",
            "g's": "standard_gravity",
            "G's": "standard_gravity",
            "gn": "standard_gravity",
            "mg": "millistandard_gravity",
            "µg": "microstandard_gravity",
            "gal": "galileo",
            "gals": "galileo",
        },
    ),
    "F": Quantity(
        "force",
        "a force",
        "N",
        "N, kN, kip",
        {
            "lb": "lbf",
            "lbs": "lbf",
            "pounds": "lbf",
            "klb": "kip",
            "kp": "kgf",
            "n": "N",
            "kn": "kN",
            "mn": "mN",
        },
    ),
    "t": Quantity("time", "the time", "s", "s, ms"),
}
# Dimensions that messages name, beside those of channels.
_OTHER_DIMENSIONS = {
    "mass": "[mass]",
    "a frequency": "[frequency]",
    "energy or a torque": "[energy]",
    "a pressure": "[pressure]",
    "a stiffness": "[force] / [length]",
    "a number or an angle": "[]",
}


def _quantity_of(channel: str) -> Quantity | None:
    """What a channel measures, None for a covariate."""
    is_channel = re.fullmatch(r"t|[avxF]\d+|[avx]g", channel)
    return QUANTITIES[channel[0]] if is_channel else None


def dimension_of(channel: str) -> str | None:
    """Name of the quantity that a channel measures, None for a covariate."""
    quantity = _quantity_of(channel)
    return None if quantity is None else quantity.name


def si_unit(channel: str) -> str:
    """SI unit of a channel, ``""`` for a covariate."""
    quantity = _quantity_of(channel)
    return "" if quantity is None else quantity.si


def si_factor(unit: str, channel: str) -> float:
    """Factor from a unit to the SI unit of a channel.

    Raises
    ------
    ChannelError
        If the unit is unknown, or measures something else than the channel.
    """
    quantity = _quantity_of(channel)
    if quantity is None:
        raise ChannelError(
            f"{channel!r} is a covariate and keeps its unit, {unit!r} cannot be"
            " converted",
            "Scale it: name * number.",
        )

    text = _one_spelling(unit)
    if text == quantity.si:
        return 1.0

    of_rotation = rotation_factor(unit, channel)
    if of_rotation is not None:
        return of_rotation

    known = [m for m in map(_measured, _readings(text, quantity)) if m is not None]
    for measured in known:
        if measured.check(f"[{quantity.name}]"):
            return float(f"{measured.magnitude:.15g}")  # without pint's own round-off

    if known:
        raise ChannelError(
            f"Channel {channel} is {quantity.noun}, but its unit {unit!r} measures"
            f" {_dimension_in_words(text, known[0])}",
            f"Write e.g. {quantity.examples}.",
        )
    raise ChannelError(
        f"The unit {unit!r} of channel {channel} is unknown",
        f"Write e.g. {quantity.examples}, or scale the channel: name * number.",
    )


def rotation_factor(unit: str, channel: str) -> float | None:
    """Factor to rad, rad/s, rad/s^2 or N m; None for a unit that is of no rotation."""
    letter = channel[:1]
    text = _one_spelling(unit)
    text = _TORQUES.get(text, text).replace("°", "deg").replace("-", "*")
    factors = _factors(text)
    if factors is None or letter not in SI_OF_ROTATION:
        return None

    names = {name for name, _ in factors}
    is_of_angle = letter != "F" and factors[0][0] in _ANGLES
    is_product = letter == "F" and len(names) == 2 and "/" not in text
    measured = _measured(text) if is_of_angle or is_product else None
    if measured is None or not measured.check(_DIMENSION_OF_ROTATION[letter]):
        return None
    return float(f"{measured.magnitude:.15g}")


def _dimension_in_words(text: str, measured: PlainQuantity[float]) -> str:
    """What a unit measures; engineers' usage goes before pint's reading."""
    for quantity in QUANTITIES.values():
        if text in quantity.jargon:
            return quantity.name
    for quantity in QUANTITIES.values():
        if measured.check(f"[{quantity.name}]"):
            return quantity.name
    for words, dimension in _OTHER_DIMENSIONS.items():
        if measured.check(dimension):
            return words
    return "something else"


def kind_of_unit(unit: str | None) -> str | None:
    """Letter of the channels that a unit measures: ``a``, ``v``, ``x``, ``F``, ``t``.

    None if it is a unit of none of them.
    """
    text = _one_spelling(unit or "")
    if not text:
        return None
    # sorted: "mn" is a millinewton before it is anything else
    for letter, quantity in sorted(QUANTITIES.items()):
        if text == quantity.si or _measures(text, quantity):
            return letter
    for letter in SI_OF_ROTATION:
        if rotation_factor(text, letter) is not None:
            return letter
    return None


def response_unit(unit: str) -> tuple[str, float] | None:
    """Letter of the motion that a unit of a response is per force, and factor to SI.

    Examples
    --------
    >>> from pysindy_nrf.records.files.units import response_unit
    >>> response_unit("mm/kN"), response_unit("(m/s^2)/N"), response_unit("deg")
    (('x', 1e-06), ('a', 1.0), None)
    """
    motion, _, force = unit.rpartition("/")
    letter = kind_of_unit(motion)
    if letter not in ("a", "v", "x") or kind_of_unit(force) != "F":
        return None
    return letter, si_factor(motion, f"{letter}1") / si_factor(force, "F1")


def _measures(text: str, quantity: Quantity) -> bool:
    """Whether a unit measures a quantity, in one of its readings."""
    dimension = f"[{quantity.name}]"
    readings = map(_measured, _readings(text, quantity))
    return any(unit is not None and unit.check(dimension) for unit in readings)


def is_unit(text: str) -> bool:
    """True if a text of a header is a unit that a channel may have."""
    unit = _one_spelling(text)
    if unit in {quantity.si for quantity in QUANTITIES.values()}:
        return True
    # "acc (A)" is sensor A, but "acc (g)" is a unit
    numbers_a_sensor = len(unit) == 1 and unit not in "msgNGh"
    return not numbers_a_sensor and kind_of_unit(text) is not None


# Units that a column's name may end with, behind an underscore, a slash or a blank.
_PLAIN_SUFFIXES = "g mg gal m mm cm in ft N kN lbf kip s ms".split()
_SUFFIXES = {unit.lower(): unit for unit in _PLAIN_SUFFIXES} | {
    "um": "µm",
    "us": "µs",
    "mps": "m/s",
    "mms": "mm/s",
    "ms2": "m/s^2",
    "mps2": "m/s^2",
    "mss": "m/s^2",
}
_BRACKETS = {"]": "[", ")": "(", "）": "（", "］": "［", "】": "【"}


def split_suffix(name: str) -> tuple[str, str | None]:
    """Name of a column and the unit behind its last underscore, slash or blank.

    ``acc_2_g``, ``time_ms``, ``Weg 1/mm``, ``Acc 1 g``.
    """
    text = name.strip()
    bare, _, suffix = re.sub(r"[/ ]", "_", text).rpartition("_")
    unit = _SUFFIXES.get(suffix.lower())
    if not bare or unit is None:
        return text, None
    return text[: len(bare)], unit


def split_unit(column: str) -> tuple[str, str | None]:
    """Name of a column and the unit in brackets, or behind a comma, at its end.

    ``a1 [mm]``, ``a1 (g)``, brackets of full width, ``Force 2, N``.
    """
    text = column.strip()
    bracket = _BRACKETS.get(text[-1:])
    if bracket is None:
        name, comma, unit = text.rpartition(", ")
        return (name.strip(), unit.strip()) if comma and is_unit(unit) else (text, None)

    opening = max(text.rfind(bracket), 0)
    name = text[:opening].strip()
    if not name:
        return text, None
    return name, text[opening + 1 : -1].strip() or None


_SPELLINGS = {"·": "*", "⋅": "*", "×": "*", "**": "^", "μ": "µ", "’": "'"}
_RAISED = str.maketrans("⁻⁺¹²³⁴", "-+1234")
# Units of Russian files: millimetre, metre, second, newton.
_CYRILLIC = str.maketrans("мсНкг", "msNkg")
_PER_SECOND = re.compile(r"(mm|cm|m|in|i|ft|f)ps(?:\^?(2))?")


def _one_spelling(unit: str) -> str:
    """One spelling of powers, products and brackets; SI as ``m/s^2``."""
    text = _without_brackets(unit.strip())
    if len(text) > 2 * MAX_UNIT_LENGTH:
        return text

    text = re.sub(
        r"\^?([⁻⁺¹²³⁴]+)", lambda match: "^" + match[1].translate(_RAISED), text
    )
    for old, new in _SPELLINGS.items():
        text = text.replace(old, new)
    if re.search("[мсН]", text):
        text = text.translate(_CYRILLIC)
    text = re.sub(r"\s*([*/^])\s*", r"\1", text)
    text = _without_points(text)
    text = re.sub(r"/\((\w+\^?\d?)\)", r"/\1", text)

    if re.fullmatch(r"m\*?\s*s\^?-2|m/s2|m/s/s", text):
        return "m/s^2"
    if re.fullmatch(r"m\*?\s*s\^?-1", text):
        return "m/s"
    return _PER_SECOND.sub(_quotient, text) if _PER_SECOND.fullmatch(text) else text


def _without_brackets(text: str) -> str:
    """A unit without the brackets around it."""
    while text[:1] in ("[", "(") and text[-1:] in ("]", ")"):
        text = text[1:-1].strip()
    return text


def _without_points(text: str) -> str:
    """A unit whose points are products, ``m.s-2``, or end an abbreviation, ``mm.``."""
    text = re.sub(r"(?<=[A-Za-zµ\d])\.(?=[A-Za-zµ])", "*", text)
    return re.sub(r"(?<=[A-Za-z])\.(?=$|/)|(?<=[A-Za-z]\d)\.$", "", text)


def _quotient(match: re.Match) -> str:
    """``mps2`` as ``m/s^2``, ``ips`` as ``in/s``."""
    length = {"i": "in", "f": "ft"}.get(match[1], match[1])
    return f"{length}/s^2" if match[2] else f"{length}/s"


def _readings(text: str, quantity: Quantity) -> Iterator[str]:
    """Readings of a unit: engineers' usage or as written, capitals as small letters."""
    yield quantity.jargon.get(text, text)
    if text.isupper() or (len(text) > 2 and text.istitle()):
        small = text.lower()
        yield quantity.jargon.get(small, small)


_MECHANICAL = {"[mass]", "[length]", "[time]"}
_FACTOR = re.compile(r"([A-Za-zµμ_]+?)(?:(?:\^|\*\*)?(-?[1-4]))?")


def _factors(text: str) -> list[tuple[str, int]] | None:
    """Names of units and their powers, None for any other text.

    Nothing else is passed to pint, which would compute ``9**9**9``.
    """
    if not text or len(text) > MAX_UNIT_LENGTH:
        return None

    operators = ["*", *re.findall(r"[*/ ]", text)]
    factors = []
    for operator, power_of_unit in zip(operators, re.split(r"[*/ ]", text)):
        match = _FACTOR.fullmatch(power_of_unit)
        if match is None:
            return None
        power = int(match[2] or 1)
        factors.append((match[1], -power if operator == "/" else power))

    name, power = factors[0]
    if len(factors) == 1 and name == "ms" and power < -1:  # "ms-2" is m s^-2
        return [("m", 1), ("s", power)]
    return factors


@lru_cache(maxsize=256)
def _measured(text: str) -> PlainQuantity[float] | None:
    """One of a mechanical unit in SI base units; None for any other text."""
    factors = _factors(text)
    if factors is None:
        return None

    require("pint", "files", f"Converting the unit {text!r}")
    registry, errors = _pint()
    try:
        measured = registry.Quantity(1.0)
        for name, power in factors:
            unit = registry.parse_units(name)
            measured = measured * registry.Quantity(1.0, unit) ** power
        is_mechanical = set(measured.dimensionality) <= _MECHANICAL
        return measured.to_base_units() if is_mechanical else None
    except errors:
        return None


@cache
def _pint() -> tuple[pint.UnitRegistry, tuple[type[Exception], ...]]:
    """The registry of units, and what it raises for a text that is none."""
    import pint

    return pint.UnitRegistry(), (
        pint.PintError,
        ValueError,
        TypeError,
        AttributeError,
        OverflowError,
        ZeroDivisionError,
    )
