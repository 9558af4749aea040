r"""Floors without a sensor: the chain of the others, and what its storeys mean.

Below the first resonance of the part left out the missing floors follow their
neighbours q < p statically (Guyan, 1965): one storey in series, :math:`1 / k =
\sum_{i=q+1}^{p} 1 / k_i`, and each mass shared in the ratio x to 1 - x of its static
displacement. A part x (1 - x) m_j couples the two accelerations, which a chain does not
have: masses are right to that part only, stiffnesses to the square of frequency over
the resonance.
"""

import warnings
from dataclasses import dataclass, field

import numpy as np

from pysindy_nrf import Record
from pysindy_nrf.exceptions import ChannelError, DataQualityWarning

CHANNELS = ("force", "acceleration", "velocity", "displacement")


@dataclass(frozen=True)
class Condensed:
    """A record of the instrumented floors only.

    ``floors`` are those of the structure behind each DOF of the record, ``meaning`` is
    that of each mass and storey of the condensed chain.
    """

    record: Record
    floors: tuple[int, ...]
    meaning: dict[str, str] = field(default_factory=dict)

    def __str__(self) -> str:
        return "\n".join(f"{name}: {text}." for name, text in self.meaning.items())


def condense(record: Record) -> Condensed:
    """Leave out the floors that have no motion channel.

    Parameters
    ----------
    record : Record

    Returns
    -------
    Condensed
        ``print`` it for what the storeys mean; fit ``.record``.

    Warns
    -----
    DataQualityWarning
        Saying what the condensed storeys mean and where they stop being right.

    Raises
    ------
    ChannelError
        If no floor has a channel, or a force acts on a floor without one.

    Examples
    --------
    >>> import numpy as np, warnings
    >>> from pysindy_nrf import Record
    >>> from static_condensation import condense
    >>> x = np.column_stack(
    ...     [
    ...         np.sin(np.arange(500) / 9),
    ...         np.full(500, np.nan),
    ...         np.cos(np.arange(500) / 9),
    ...     ]
    ... )
    >>> with warnings.catch_warnings(action="ignore"):
    ...     print(condense(Record(displacement=x, fs=100.0)))
    m1: floor 1 and a part of floor 2. storey 1: storey 1. m2: floor 3 and a part of
    floor 2. storey 2: storeys 2 to 3 in series, right only well below the resonance of
    floor 2 between floors 1 and 3 held fixed.
    """
    n = record.n_dof
    sensed = [j for j in range(1, n + 1) if has_sensor(record, j)]
    missing = [j for j in range(1, n + 1) if j not in sensed]
    refuse_forces(record, missing)
    meaning = meanings(sensed, n)
    if not missing:
        return Condensed(record, tuple(sensed), meaning)

    columns = [j - 1 for j in sensed]
    changes = {}
    for kind in CHANNELS:
        values = getattr(record, kind)
        if values is not None:
            changes[kind] = np.ascontiguousarray(values[:, columns])
    condensed = Condensed(record.replace(**changes), tuple(sensed), meaning)
    warn_of_meaning(condensed, record.name, missing)
    return condensed


def has_sensor(record: Record, floor: int) -> bool:
    """Whether a floor has a motion channel."""
    names = {f"a{floor}", f"v{floor}", f"x{floor}"}
    return not names.isdisjoint(record.measured)


def refuse_forces(record: Record, missing: list[int]) -> None:
    """Refuse forces on floors without a sensor; an unknown one (NaN) is a force."""
    for floor in missing:
        if record.force[:, floor - 1].any():
            raise ChannelError(
                f"A force acts on floor {floor} of record {record.name!r}, which has"
                " no motion channel",
                f"Put a sensor on floor {floor}, or hit another floor.",
            )


def warn_of_meaning(condensed: Condensed, name: str, missing: list[int]) -> None:
    """Warn of the masses and storeys that are not those of the structure."""
    changed = []
    for symbol, text in condensed.meaning.items():
        is_a_storey = text.startswith("storey ")
        if not is_a_storey:
            changed.append(f"{symbol} = {text}")
    floors = ", ".join(map(str, missing))
    warnings.warn(
        f"Record {name!r}: floor {floors} has no sensor and is left out. In the"
        f" condensed chain {'; '.join(changed)}. Fit below that resonance (band=).",
        DataQualityWarning,
        stacklevel=3,
    )


# -- what masses and storeys mean ----------------------------------------------


def meanings(sensed: list[int], n_dof: int) -> dict[str, str]:
    """Meaning of each mass and storey of the condensed chain."""
    texts = {}
    neighbours = [0, *sensed, n_dof + 1]
    for number, floor in enumerate(sensed, 1):
        below, above = neighbours[number - 1], neighbours[number + 1]
        last = number == len(sensed)
        texts[f"m{number}"] = meaning_of_mass(floor, below, above, last)
        texts[f"storey {number}"] = meaning_of_storey(floor, below)
    return texts


def meaning_of_mass(floor: int, below: int, above: int, last: bool) -> str:
    """Floors that a mass stands for; the last one carries all floors above it."""
    shared = list(range(below + 1, floor))
    carried = list(range(floor + 1, above))
    if not last:
        shared += carried
    text = f"floor {floor}"
    if shared:
        text += f" and a part of {in_words(shared)}"
    if last and carried:
        text += (
            f" and all of {in_words(carried)} above it (right only well below their"
            f" resonance on floor {floor} held fixed)"
        )
    return text


def meaning_of_storey(floor: int, below: int) -> str:
    """Storeys that one stands for."""
    between = list(range(below + 1, floor))
    if not between:
        return f"storey {floor}"
    fixed = f"floors {below} and {floor}" if below else f"the base and floor {floor}"
    return (
        f"storeys {below + 1} to {floor} in series, right only well below the"
        f" resonance of {in_words(between)} between {fixed} held fixed"
    )


def in_words(floors: list[int]) -> str:
    if len(floors) == 1:
        return f"floor {floors[0]}"
    return f"floors {floors[0]} to {floors[-1]}"
