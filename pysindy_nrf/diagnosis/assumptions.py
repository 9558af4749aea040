"""What a model takes for granted, because nothing in the data checks it."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Literal

Kind = Literal[
    "gain",  # of all forces together over that of all motions
    "mass",  # one that was given, without a force that checks it
]


@dataclass(frozen=True)
class Assumption:
    """What sets the scale of a model, though nothing in the data checks it.

    Parameters
    ----------
    kind : {"gain", "mass"}
        The gain of all forces over that of all motions, or masses that were given.
    names : tuple of str
        Channels or masses, such as ``"F1"`` or ``"m2"``.
    """

    kind: Kind
    names: tuple[str, ...]

    @property
    def sentence(self) -> str:
        """The same in words."""
        names = " and ".join(self.names)
        if self.kind == "mass":
            scale = f"{names}, which {'were' if len(self.names) > 1 else 'was'} given"
        elif len(self.names) > 1:
            scale = f"the common gain of {', '.join(self.names)}"
        else:
            scale = f"the gain of {names}"
        return (
            f"Masses, stiffnesses and dampings scale with {scale}; nothing in the data"
            " checks it."
        )


def scale_of(
    forced: Collection[int], known_masses: Mapping[int, float]
) -> tuple[Assumption, ...]:
    """What alone sets the scale of a model; nothing where forces and masses do.

    One gain of all forces, or of all motions, leaves every equation of motion closed.

    Parameters
    ----------
    forced : collection of int
        DOFs with a measured force.
    known_masses : mapping of int to float
        Masses that were given, kg, by DOF.
    """
    weighed = [f"m{j}" for j, mass in sorted(known_masses.items()) if mass > 0]
    if forced and weighed:
        return ()
    if forced:
        return (Assumption("gain", tuple(f"F{j}" for j in sorted(forced))),)
    return (Assumption("mass", tuple(weighed)),) if weighed else ()
