"""What a force law sees."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np


@dataclass
class Motion:
    """What a law at a site sees in one contiguous record.

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

    @property
    def n_samples(self) -> int:
        """Number of samples."""
        return len(self.s)
