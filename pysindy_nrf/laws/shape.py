"""Motion at a site, shape parameters of laws and the scale on which they are
searched.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np


@dataclass
class Motion:
    """Motion at the site of a law in one contiguous record, or in several, one after
    the other.

    Attributes
    ----------
    s, v : ndarray of shape (n_samples,)
        Drift (m) and its rate (m/s).
    a : ndarray of shape (n_samples,), optional
        Relative acceleration of the two ends (m/s^2); of the DOF for a DOF site.
    t : ndarray of shape (n_samples,), optional
        Time on the clock of the record (s).
    covariates : mapping of str to ndarray of shape (n_samples,)
        Further measured channels, e.g. a damper's voltage.
    starts : tuple of int
        First samples of further records: there a law with memory starts fresh.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf import laws
    >>> s = np.array([-0.001, 0.0, 0.002])  # m
    >>> laws.LinearElastic(4e4).force(laws.Motion(s, v=0 * s)).tolist()  # N
    [-40.0, 0.0, 80.0]
    """

    s: np.ndarray
    v: np.ndarray
    a: np.ndarray | None = None
    t: np.ndarray | None = None
    covariates: Mapping[str, np.ndarray] = field(default_factory=dict)
    starts: tuple[int, ...] = ()

    @property
    def n_samples(self) -> int:
        """Number of samples."""
        return len(self.s)

    @classmethod
    def joined(cls, parts: Sequence[Motion]) -> Motion:
        """Motions of several records, one after the other, with what all of them hold.

        Parameters
        ----------
        parts : sequence of Motion

        Returns
        -------
        Motion
            With the ``starts`` of all but the first; a single one as it is.
        """
        if len(parts) == 1:
            return parts[0]

        def line(name: str) -> Any:
            held = [getattr(part, name) for part in parts]
            return None if any(y is None for y in held) else np.concatenate(held)

        shared = [
            c
            for c in parts[0].covariates
            if all(c in part.covariates for part in parts)
        ]
        covariates = {
            c: np.concatenate([part.covariates[c] for part in parts]) for c in shared
        }
        ends = np.cumsum([part.n_samples for part in parts])
        return cls(
            line("s"),
            line("v"),
            line("a"),
            line("t"),
            covariates,
            tuple(ends[:-1].tolist()),
        )


Given = float | None  # the value of a parameter; None: to be estimated
# Scales of a site, bounds are multiples of them: rms drift (m) and rate (m/s), longest
# record, first and last time (s).
Scales = tuple[float, float, float, tuple[float, float]]


class Shape(NamedTuple):
    """A shape parameter: a parameter in which the law is not linear.

    Attributes
    ----------
    name : str
    unit : str
        SI unit.
    low, high : float
        Bounds of its search, in multiples of ``scale``.
    scale : str
        Unit of the bounds, a product such as ``"1"``, ``"s"``, ``"1/v"`` or ``"s/v"``
        of the rms drift s, the rms rate v, the record length t and the path p = v t of
        the site.
    log : bool
        Whether it is positive and searched on a logarithmic scale.
    instant : bool
        Whether it is a time on the clock of the records; its bounds are then shares of
        the way from the first time to the last.
    friction_below : float, optional
        Value below which the law is practically dry friction, e.g. a power of the rate
        near zero.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> laws.Dahl.shapes[0].bounds(drift=0.001, rate=0.05, duration=20.0)
    (30.0, 3000000.0)
    """

    name: str
    unit: str
    low: float
    high: float
    scale: str = "1"
    log: bool = True
    instant: bool = False
    friction_below: float | None = None

    def bounds(
        self,
        drift: float,
        rate: float,
        duration: float,
        clock: tuple[float, float] | None = None,
    ) -> tuple[float, float]:
        """Bounds of the search in SI units.

        Parameters
        ----------
        drift, rate : float
            Rms drift (m) and rate (m/s) of the site.
        duration : float
            Length of the longest record, s.
        clock : (float, float), optional
            First and last time of all records, s; 0 and ``duration`` if None.
        """
        if self.instant:
            first, last = clock or (0.0, duration)
            return first + self.low * (last - first), first + self.high * (last - first)
        sizes = {"1": 1.0, "s": drift, "v": rate, "t": duration, "p": rate * duration}
        above, _, below = self.scale.partition("/")
        unit = sizes[above] / sizes[below or "1"]
        return self.low * unit, self.high * unit

    @property
    def is_frequency(self) -> bool:
        """True if it is a frequency in Hz, by its name; candidates are lines in the
        residual.
        """
        return self.name == "frequency"


class ShapeScale:
    """Shape parameters in the coordinates of a search: logarithms where :class:`Shape`
    says so.

    The scales are rms drift (m), rms rate (m/s), longest record (s), first and last
    time (s) at the site of each. A frequency is searched up to half the sampling rate,
    ``fastest``: an excitation may be faster than the motion.
    """

    def __init__(
        self, shapes: Sequence[Shape], scales: Sequence[Scales], fastest: float = np.inf
    ) -> None:
        bounds = np.array(
            [p.bounds(*own) for p, own in zip(shapes, scales)], dtype=float
        ).reshape(-1, 2)
        if np.isfinite(fastest):
            bounds[[p.is_frequency for p in shapes], 1] = fastest
        self.log = np.array([p.log for p in shapes], dtype=bool)
        self.low, self.high = (self.point(ends) for ends in bounds.T)

    def point(self, values: np.ndarray, k: int | slice = slice(None)) -> np.ndarray:
        """Coordinates of the search at values of all shape parameters."""
        log = self.log[k]
        return np.where(log, np.log(np.where(log, values, 1.0)), values)

    def values(self, point: np.ndarray, k: int | slice = slice(None)) -> np.ndarray:
        """Shape parameters at a point of the search."""
        log = self.log[k]
        return np.where(log, np.exp(np.where(log, point, 0.0)), point)
