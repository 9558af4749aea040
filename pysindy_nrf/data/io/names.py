"""Which column of a file is which channel."""

from __future__ import annotations

import re

_NUMBERED = re.compile(r"([avxf])_?0*([1-9]\d*)", re.IGNORECASE)
_UNIT = re.compile(r"(?P<name>.*?)\s*(?:\[(?P<square>[^\]]*)\]|\((?P<round>[^)]*)\))\s*\Z")
_BASE = {"ag": "ag", "vg": "vg", "xg": "xg", "a0": "ag", "v0": "vg", "x0": "xg", "a_g": "ag", "v_g": "vg", "x_g": "xg"}


def split_unit(column: str) -> tuple[str, str | None]:
    """A column name and the unit written behind it, ``"a1 [mm]"`` or ``"a1 (g)"``."""
    match = _UNIT.match(column.strip())
    if match is None or not match["name"]:
        return column.strip(), None
    return match["name"], (match["square"] or match["round"] or "").strip() or None


def channel_of(name: str) -> str | None:
    """The channel a plain name means."""
    text = name.strip()
    if text.lower() in ("t", "time"):
        return "t"
    if text.lower() in _BASE:
        return _BASE[text.lower()]
    match = _NUMBERED.fullmatch(text)
    if match is None:
        return None
    prefix = match[1].lower()
    return ("F" if prefix == "f" else prefix) + match[2]
