"""Forces that jump where the rate changes its sign, as Coulomb friction does."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .base import ForceLaw

# Rates on both sides of rest, m/s: a jump is all there between the nearer two.
_RATES = np.array([1e-14, -1e-14, 1e-9, -1e-9])


def across_rest(law: ForceLaw, largest: Sequence[float] | np.ndarray) -> np.ndarray:
    """Change of each column of a law where the rate changes its sign."""
    zero = np.zeros(4)
    u = np.array([np.full(4, size) for size in largest]).reshape(-1, 4)
    out = np.zeros((len(law.terms()), 4))
    law.kernel(zero, _RATES, zero, zero, u, np.zeros((law.n_states, 4)), law.theta, out)
    return out[:, ::2] - out[:, 1::2]
