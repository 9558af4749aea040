"""Units of channels, converted to SI by one small table."""

from __future__ import annotations

import re

from ..exceptions import ChannelError

_G = 9.80665
_INCH = 0.0254
_FOOT = 0.3048
_POUND = 4.4482216152605

LENGTHS = {"m": 1.0, "dm": 0.1, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "μm": 1e-6, "nm": 1e-9,
           "in": _INCH, "inch": _INCH, "inches": _INCH, "ft": _FOOT, "mil": 1e-3 * _INCH}  # fmt: skip
FORCES = {"n": 1.0, "kn": 1e3, "mn": 1e6, "lbf": _POUND, "lb": _POUND, "kip": 1e3 * _POUND, "kips": 1e3 * _POUND,
          "kgf": _G, "kp": _G, "tf": 1e3 * _G}  # fmt: skip
TIMES = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "min": 60.0, "h": 3600.0}
GRAVITIES = {"g": _G, "mg": 1e-3 * _G, "gal": 1e-2}

_DIMENSIONS = {"x": "length", "v": "velocity", "a": "acceleration", "F": "force", "t": "time"}
_SI = {"length": "m", "velocity": "m/s", "acceleration": "m/s^2", "force": "N", "time": "s"}


def dimension_of(channel: str) -> str | None:
    """What a channel measures.

    Parameters
    ----------
    channel : str
        ``"a1"``, ``"xg"``, ``"F2"``, ``"t"``, or the name of a covariate.

    Returns
    -------
    {"length", "velocity", "acceleration", "force", "time"} or None
        None for a covariate, which keeps its unit.
    """
    if channel == "t" or re.fullmatch(r"[avxF]\d+|[avx]g", channel):
        return _DIMENSIONS[channel[0]]
    return None


def si_unit(channel: str) -> str:
    """SI unit of a channel, ``""`` for a covariate."""
    return _SI.get(dimension_of(channel) or "", "")


def factor(unit: str, channel: str) -> float:
    """What values in a unit are multiplied by to be SI.

    Parameters
    ----------
    unit : str
        ``"mm"``, ``"g"``, ``"in/s"``, ``"cm/s^2"``, ``"kip"``, ...
    channel : str
        The channel they belong to, ``"a1"``, ``"xg"``, ``"F2"``, ``"t"``.

    Returns
    -------
    float

    Raises
    ------
    ChannelError
        If the unit is unknown or does not measure what the channel is.

    Examples
    --------
    >>> from pysindy_nrf.io.units import factor
    >>> factor("mm", "x1"), factor("g", "a2"), factor("cm/s", "vg")
    (0.001, 9.80665, 0.01)
    """
    kind = dimension_of(channel)
    if kind is None:
        raise ChannelError(
            f"{channel!r} is a covariate and keeps its unit, {unit!r} cannot be converted", "Scale it: name * number."
        )
    known = _table(unit)
    if not known:
        raise ChannelError(
            f"The unit {unit!r} of channel {channel} is unknown",
            f"Write e.g. {', '.join(_EXAMPLES[kind])}, or scale the channel: name * number.",
        )
    if kind not in known:
        raise ChannelError(
            f"Channel {channel} is of the kind {kind}, but its unit {unit!r} measures {' or '.join(known)}",
            f"Write e.g. {', '.join(_EXAMPLES[kind])}.",
        )
    return known[kind]


_EXAMPLES = {
    "length": ("m", "mm", "in"),
    "velocity": ("m/s", "mm/s", "in/s"),
    "acceleration": ("m/s^2", "g", "cm/s^2"),
    "force": ("N", "kN", "kip"),
    "time": ("s", "ms"),
}


def is_unit(text: str) -> bool:
    """Whether a text is a unit of the table."""
    return bool(_table(text))


def _table(unit: str) -> dict[str, float]:
    """Factor by dimension; a text can name two things (``"mn"``)."""
    raw = unit.strip().strip("[]()").strip()
    text = raw.lower()
    found: dict[str, float] = {}
    for kind, table in (("length", LENGTHS), ("force", FORCES), ("time", TIMES), ("acceleration", GRAVITIES)):
        if text in table:
            found[kind] = table[text]
    if raw in ("mN", "mn"):  # millinewton; the table holds MN
        found["force"] = 1e-3
    if found:
        return found
    return _ratio(text)


def _ratio(text: str) -> dict[str, float]:
    """Length over time, ``"cm/s"``, ``"in/s^2"``, ``"ms-2"``."""
    compact = text.replace(" ", "").replace("²", "2").replace("**", "^").replace("sec", "s").replace("·", "")
    match = re.fullmatch(r"([a-zµμ]+?)/(s|ms)(?:\^?(2)|/(s))?", compact)
    if match and match[1] in LENGTHS:
        per = TIMES[match[2]]
        if match[3] or match[4]:
            return {"acceleration": LENGTHS[match[1]] / per**2}
        return {"velocity": LENGTHS[match[1]] / per}
    match = re.fullmatch(r"([a-zµμ]+?)\*?s\^?-([12])", compact)
    if match and match[1] in LENGTHS:
        return {"velocity" if match[2] == "1" else "acceleration": LENGTHS[match[1]]}
    return {}
