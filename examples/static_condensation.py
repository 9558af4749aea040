r"""Floors without a sensor: the chain of those that have one, and what its storeys
mean.

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


@dataclass
class Condensed:
    """A record of the instrumented floors only."""

    record: Record
    floors: tuple[int, ...]  # of the structure, behind each DOF of the record
    meaning: dict[str, str] = field(
        default_factory=dict
    )  # of each mass and storey of the condensed chain

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
    have = set(record.measured)
    every = range(1, record.n_dof + 1)
    kept = [j for j in every if have & {f"a{j}", f"v{j}", f"x{j}"}]
    gone = [j for j in every if j not in kept]
    forced = [
        j for j in gone if record.force[:, j - 1].any()
    ]  # NaN counts: an unknown force is one
    if forced:
        what = (
            f"A force acts on floor {forced[0]} of record {record.name!r}, which has no"
            " motion channel"
        )
        raise ChannelError(
            what, f"Put a sensor on floor {forced[0]}, or hit another floor."
        )
    if not gone:
        return Condensed(record, tuple(kept), _meaning(kept, record.n_dof)[0])
    columns = [j - 1 for j in kept]
    changes = {
        key: getattr(record, key)
        for key in ("force", "acceleration", "velocity", "displacement")
    }
    chosen = {
        key: None if y is None else np.ascontiguousarray(y[:, columns])
        for key, y in changes.items()
    }
    meaning, single = _meaning(kept, record.n_dof)
    unlike = "; ".join(
        f"{name} = {text}" for name, text in meaning.items() if name not in single
    )
    warnings.warn(
        f"Record {record.name!r}: floor {', '.join(map(str, gone))} has no sensor and"
        f" is left out. In the condensed chain {unlike}. Fit below that resonance"
        " (band=).",
        DataQualityWarning,
        stacklevel=2,
    )
    return Condensed(record.replace(**chosen), tuple(kept), meaning)


def _meaning(kept: list[int], n_dof: int) -> tuple[dict[str, str], set[str]]:
    """Meaning of each mass and storey of the condensed chain, and the storeys that are
    one storey of the structure.
    """
    said, single = {}, set()
    below = [0, *kept[:-1]]
    above = [*kept[1:], None]
    for i, (j, low, high) in enumerate(zip(kept, below, above), 1):
        near = list(range(low + 1, j)) + (list(range(j + 1, high)) if high else [])
        parts = [f"floor {j}"]
        if near:
            parts.append(f"a part of {_floors(near)}")
        if high is None and j < n_dof:
            top = list(range(j + 1, n_dof + 1))
            parts.append(
                f"all of {_floors(top)} above it (right only well below their resonance"
                f" on floor {j} held fixed)"
            )
        said[f"m{i}"] = " and ".join(parts)
        between = list(range(low + 1, j))
        if not between:
            single.add(f"storey {i}")
        said[f"storey {i}"] = (
            f"storey {j}"
            if not between
            else (
                f"storeys {low + 1} to {j} in series, right only well below the"
                f" resonance of {_floors(between)} between"
                f" {'the base' if low == 0 else f'floors {low}'} and"
                f" {'floor ' if low == 0 else ''}{j} held fixed"
            )
        )
    return said, single


def _floors(floors: list[int]) -> str:
    return (
        f"floor {floors[0]}"
        if len(floors) == 1
        else f"floors {floors[0]} to {floors[-1]}"
    )
