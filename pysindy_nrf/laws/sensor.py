"""Sensor faults: the reading minus the true channel, as a law of the true channel.

At a site such as ``"sensor a2"`` s is the channel, v and a are its first and second
derivative. A fault changes the reading, not the motion, and therefore enters no
balance. A simulation returns the readings; :meth:`SensorFault.corrected` recovers the
true channel.
"""

from __future__ import annotations

from typing import ClassVar, Self

import numpy as np
import numpy.typing as npt

from .base import ForceLaw, Term
from .shape import Motion


class SensorFault(ForceLaw):
    """Base of the laws of faulty sensors; their output has the unit of the channel.

    A fault has one coefficient. Its unit sets the scale of the search: a time ("s") in
    radians of the mean frequency of the channel, a share ("1") as it is, anything else
    in rms values of the channel.

    Attributes
    ----------
    scan : (float, float)
        First step of the search for the coefficient, and the range that it covers at
        least, on that scale.
    acts_on_derivatives : bool
        Whether the derivatives of the channel have the same fault; false for an offset.
    changes_scale : bool
        Whether the fault of the only force, or of the only DOF, is indistinguishable
        from a scaling of the chain.
    """

    family = "sensor"
    stands_for = "sensor error"
    acts_at = ("sensor",)
    output = "m"  # the unit of s, which is the channel here
    scan: ClassVar[tuple[float, float]] = (0.05, 1.5)
    acts_on_derivatives: ClassVar[bool] = True
    changes_scale: ClassVar[bool] = False

    def reading(self, channel: npt.ArrayLike, dt: float) -> np.ndarray:
        """The reading of the sensor."""
        raise NotImplementedError

    def corrected(self, reading: npt.ArrayLike, dt: float) -> np.ndarray:
        """The true channel from the reading; the inverse of :meth:`reading`."""
        raise NotImplementedError

    def added_to(self, channel: npt.ArrayLike, dt: float) -> np.ndarray:
        """What the fault adds to a channel, to first order in its size.

        Parameters
        ----------
        channel : array-like of shape (n_samples,)
        dt : float
            Sampling step, s.

        Returns
        -------
        ndarray of shape (n_samples,)

        Examples
        --------
        >>> import numpy as np
        >>> from pysindy_nrf import laws
        >>> laws.GainError(0.02).added_to([1.0, 2.0, 3.0], dt=0.01)
        array([0.02, 0.04, 0.06])
        """
        channel = np.asarray(channel, dtype=float)
        rate = np.gradient(channel, dt)
        return self.force(Motion(channel, rate, np.gradient(rate, dt)))

    @property
    def order(self) -> int | None:
        """Order of the derivative that the fault adds to its channel.

        0 for a gain, 1 for a delay, None where it adds none alone.

        Examples
        --------
        >>> from pysindy_nrf import laws
        >>> faults = laws.GainError(), laws.ChannelDelay(), laws.SensorOffset()
        >>> [fault.order for fault in faults]
        [0, 1, None]
        """
        added = self._added()
        orders = np.flatnonzero(added[1:])
        return None if added[0] or len(orders) != 1 else int(orders[0])

    @property
    def share(self) -> float:
        """What the fault adds, as a share of that derivative."""
        return float(self.values[0] * self._added()[1 + (self.order or 0)])

    def with_share(self, share: float) -> Self:
        """The fault that adds a share of its derivative to the channel.

        Parameters
        ----------
        share : float

        Examples
        --------
        >>> from pysindy_nrf import laws
        >>> laws.ChannelDelay().with_share(-0.002)  # s
        ChannelDelay(tau=0.002)
        """
        return self.with_values([share / float(self._added()[1 + (self.order or 0)])])

    def _added(self) -> np.ndarray:
        """What a unit of the fault adds at rest, and beyond it to a channel of one and
        to first and second derivatives of one.
        """
        if self.free_shape:
            return np.zeros(4)
        column = self.features(Motion(*np.eye(4)[1:]))[:, 0]
        return np.append(column[0], column[1:] - column[0])

    def followed_by(self, other: SensorFault) -> Self:
        """One fault equal to correcting this one and then another of its kind."""
        return self.with_values(self.values + other.values)

    def before(self, earlier: SensorFault) -> tuple[Self, SensorFault]:
        """The same two corrections in the other order: this fault first."""
        return self, earlier


class ChannelDelay(SensorFault):
    r"""Channel delayed by tau, ``y(t - tau)``: another clock, an anti-aliasing filter.

    To first order the reading lacks :math:`\tau \dot y`, which is the column of the
    law; readings and corrections are exact (spline of degree 7).
    """

    name = "channel_delay"
    columns = (Term("tau", "-dy/dt", "s"),)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = -v

    def reading(self, channel: npt.ArrayLike, dt: float) -> np.ndarray:
        """The channel delayed by tau."""
        return shifted(np.asarray(channel, dtype=float), float(self.values[0]) / dt)

    def corrected(self, reading: npt.ArrayLike, dt: float) -> np.ndarray:
        """The reading advanced by tau."""
        return shifted(np.asarray(reading, dtype=float), -float(self.values[0]) / dt)


class GainError(SensorFault):
    """Channel with the relative error e, ``(1 + e) y``: a wrong calibration.

    A wrong sign is e = -2.
    """

    name = "gain_error"
    columns = (Term("e", "y", "1"),)
    scan = (0.02, 0.6)
    changes_scale = True

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = s

    def reading(self, channel: npt.ArrayLike, dt: float) -> np.ndarray:
        """The channel times 1 + e."""
        return (1.0 + float(self.values[0])) * np.asarray(channel, dtype=float)

    def corrected(self, reading: npt.ArrayLike, dt: float) -> np.ndarray:
        """The reading divided by 1 + e."""
        return np.asarray(reading, dtype=float) / (1.0 + float(self.values[0]))

    def followed_by(self, other: SensorFault) -> Self:
        """Gains multiply."""
        return self.with_values((1.0 + self.values) * (1.0 + other.values) - 1.0)

    def before(self, earlier: SensorFault) -> tuple[Self, SensorFault]:
        """An offset that is corrected after the gain is divided by the gain."""
        if earlier.acts_on_derivatives:
            return self, earlier
        return self, earlier.with_values(earlier.values / (1.0 + self.values))


class SensorOffset(SensorFault):
    """Channel with a constant offset, ``y + b``."""

    name = "sensor_offset"
    columns = (Term("b", "1", "m"),)
    symmetry = "even"
    at_rest = None
    scan = (0.05, 5.0)
    acts_on_derivatives = False

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = 0.0 * s + 1.0

    def reading(self, channel: npt.ArrayLike, dt: float) -> np.ndarray:
        """The channel plus b."""
        return np.asarray(channel, dtype=float) + float(self.values[0])

    def corrected(self, reading: npt.ArrayLike, dt: float) -> np.ndarray:
        """The reading minus b."""
        return np.asarray(reading, dtype=float) - float(self.values[0])

    def before(self, earlier: SensorFault) -> tuple[Self, SensorFault]:
        """An offset that is corrected before a gain is multiplied by the gain."""
        if not earlier.changes_scale:
            return self, earlier
        return self.with_values(self.values * (1.0 + earlier.values)), earlier


def shifted(values: np.ndarray, samples: float) -> np.ndarray:
    """A channel delayed by a number of samples, by a spline of degree 7.

    Parameters
    ----------
    values : ndarray of shape (n_samples,)
    samples : float
        May be a fraction, and negative.

    Returns
    -------
    ndarray of shape (n_samples,)
        NaN outside the record.
    """
    from scipy.interpolate import make_interp_spline

    known = np.flatnonzero(np.isfinite(values))
    wanted = np.arange(len(values)) - samples
    inside = (wanted >= known[0]) & (wanted <= known[-1])
    spline = make_interp_spline(known, values[known], k=min(7, len(known) - 1))

    out = np.full(len(values), np.nan)
    out[inside] = spline(wanted[inside])
    return out
