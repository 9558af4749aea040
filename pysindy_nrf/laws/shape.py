"""Motion at a site; shape parameters of laws and the scale of their search."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np


@dataclass
class Motion:
    """Motion at the site of a law in one record, or in several, one after the other.

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
    def joined(cls, motions: Sequence[Motion]) -> Motion:
        """Motions of several records, one after the other.

        Parameters
        ----------
        motions : sequence of Motion

        Returns
        -------
        Motion
            With the channels that all of them have, and the ``starts`` of all but the
            first; a single one as it is.
        """
        if len(motions) == 1:
            return motions[0]

        ends = np.cumsum([motion.n_samples for motion in motions])
        covariates = {}
        for name in motions[0].covariates:
            channel = _joined([motion.covariates.get(name) for motion in motions])
            if channel is not None:
                covariates[name] = channel
        return cls(
            s=np.concatenate([motion.s for motion in motions]),
            v=np.concatenate([motion.v for motion in motions]),
            a=_joined([motion.a for motion in motions]),
            t=_joined([motion.t for motion in motions]),
            covariates=covariates,
            starts=tuple(ends[:-1].tolist()),
        )


def _joined(pieces: Sequence[np.ndarray | None]) -> np.ndarray | None:
    """A channel of several records; None where one lacks it."""
    present = [piece for piece in pieces if piece is not None]
    return np.concatenate(present) if len(present) == len(pieces) else None


# Of a site: rms drift (m) and rate (m/s), longest record (s), first and last time (s).
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
            span = last - first
            return first + self.low * span, first + self.high * span

        sizes = {"1": 1.0, "s": drift, "v": rate, "t": duration, "p": rate * duration}
        numerator, _, denominator = self.scale.partition("/")
        unit = sizes[numerator] / sizes[denominator or "1"]
        return self.low * unit, self.high * unit

    @property
    def is_frequency(self) -> bool:
        """True if it is a frequency in Hz, by its name.

        Its candidates are lines in the residual's spectrum.
        """
        return self.name == "frequency"


class ShapeScale:
    """Shape parameters in the coordinates of a search.

    These are logarithms where :class:`Shape` says so.

    Parameters
    ----------
    shapes : sequence of Shape
    scales : sequence of Scales
        At the site of each.
    fastest : float
        Half the sampling rate, Hz, up to which a frequency is searched: an excitation
        may be faster than the motion.
    """

    def __init__(
        self, shapes: Sequence[Shape], scales: Sequence[Scales], fastest: float = np.inf
    ) -> None:
        pairs = [shape.bounds(*sizes) for shape, sizes in zip(shapes, scales)]
        bounds = np.array(pairs, dtype=float).reshape(-1, 2)
        if np.isfinite(fastest):
            bounds[[shape.is_frequency for shape in shapes], 1] = fastest
        self.log = np.array([shape.log for shape in shapes], dtype=bool)
        self.low = self.point(bounds[:, 0])
        self.high = self.point(bounds[:, 1])

    def point(self, values: np.ndarray, k: int | slice = slice(None)) -> np.ndarray:
        """Coordinates of the search at values of all shape parameters."""
        log = self.log[k]
        return np.where(log, np.log(np.where(log, values, 1.0)), values)

    def values(self, point: np.ndarray, k: int | slice = slice(None)) -> np.ndarray:
        """Shape parameters at a point of the search."""
        log = self.log[k]
        return np.where(log, np.exp(np.where(log, point, 0.0)), point)
