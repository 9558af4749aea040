"""The units of a chain of translations and of a chain of rotations."""

from __future__ import annotations

import re
from dataclasses import dataclass

# A unit of force, mass or length inside another unit, with its prefix, and what shows
# that a product of units there needs brackets: a stroke before, an exponent behind.
_BASE_UNIT = re.compile(
    r"(?P<stroke>/)?(?<![A-Za-zµ])(?:(?P<mass>kg)|(?P<prefix>[kMmµ]?)(?P<base>[Nm]))"
    r"(?![A-Za-z])(?P<exponent>[\^²³])?"
)


@dataclass(frozen=True)
class UnitSystem:
    """SI units of one kind of motion.

    The package counts in N, m, kg and s. For rotations the same numbers are N m, rad,
    kg m^2 and s.

    Parameters
    ----------
    force, length, mass : str
        Units of what a translation measures in N, m and kg.
    """

    force: str
    length: str
    mass: str

    def of(self, unit: str) -> str:
        """The unit that stands for one of translations.

        Parameters
        ----------
        unit : str
            In terms of N, m, kg and s.

        Examples
        --------
        >>> from pysindy_nrf.common.unit_system import ROTATION, TRANSLATION
        >>> [ROTATION.of(unit) for unit in ("kN/m", "N s^2/m^2", "m/s²/N", "kg")]
        ['kN m/rad', 'N m s^2/rad^2', 'rad/s²/(N m)', 'kg m^2']
        >>> TRANSLATION.of("N s/m")
        'N s/m'
        """
        return _BASE_UNIT.sub(self._converted, unit)

    def _converted(self, match: re.Match[str]) -> str:
        """The unit for a match of one of N, m and kg."""
        exponent, stroke = match["exponent"] or "", match["stroke"] or ""
        if match["mass"]:
            text = self.mass
        else:
            base = {"N": self.force, "m": self.length}[match["base"]]
            text = f"{match['prefix']}{base}"
        if " " in text and (exponent or stroke):
            text = f"({text})"
        return f"{stroke}{text}{exponent}"


TRANSLATION = UnitSystem("N", "m", "kg")
ROTATION = UnitSystem("N m", "rad", "kg m^2")


def unit_system(rotates: bool) -> UnitSystem:
    """The units of rotations, or those of translations."""
    return ROTATION if rotates else TRANSLATION
