"""How the stiffness of a storey changed: within a record, or between two tests."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class StiffnessChange:
    """A change of the stiffness of one storey.

    Within a record it is that from its beginning to its end, between two tests that
    from the first to the second.

    Attributes
    ----------
    storey : str
    change : float
        Percent of the stiffness before.
    lower, upper : float
        Ends of its 95 % interval.
    since : float or None
        Instant of the largest sudden change within a record, s; None if it is
        gradual, or lies between two tests.

    Examples
    --------
    >>> from pysindy_nrf.diagnosis.stiffness_change import StiffnessChange
    >>> print(StiffnessChange("storey 2", -20.0, -20.6, -19.4, since=9.0))
    storey 2: stiffness -20 % (-20.6 to -19.4), since 9 s
    """

    storey: str
    change: float
    lower: float
    upper: float
    since: float | None = None

    def __str__(self) -> str:
        interval = f"({self.lower:+.3g} to {self.upper:+.3g})"
        text = f"{self.storey}: stiffness {self.change:+.3g} % {interval}"
        return text if self.since is None else f"{text}, since {self.since:.4g} s"
