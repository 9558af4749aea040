"""For how long laws with memory show how they began.

A law begins fresh in the first row. That is right where a record begins at rest; where
it begins in motion, as in a steady state, the force is wrong until the law has
forgotten.
"""

import numpy as np

from ..chain.model import ChainModel
from ..laws.base import ForceLaw
from ..laws.shape import Motion
from ..records.dataset import Segment

# Difference of the forces from two beginnings, over the rms force, that counts no more.
FORGOTTEN = 1e-3
# Drift and rate in the first row, over their rms, of a site at rest. A sine has one of
# them above 0.7.
AT_REST = 0.2
# Share of a record, above which leaving it out costs more than the wrong beginning.
LARGEST_SHARE = 0.25


def run_in_of(model: ChainModel, segment: Segment) -> int:
    """Valid rows until the laws of a model have forgotten how they began.

    Zero where a record begins at rest, and where a law never forgets.

    Parameters
    ----------
    model : ChainModel
    segment : Segment
    """
    longest = 0
    for site, group in model.laws.items():
        for law in group:
            if law.has_memory:
                motion = segment.motion(site, segment.valid)
                longest = max(longest, _rows_to_forget(law, motion))
    if longest > LARGEST_SHARE * segment.n_valid:
        return 0
    return longest


def _rows_to_forget(law: ForceLaw, motion: Motion) -> int:
    """Rows in which the force depends on the state in the first one."""
    if _begins_at_rest(motion):
        return 0

    state = np.zeros(law.n_states)
    fresh = law.features(motion, state)
    worn = law.features(motion, state)
    difference = np.abs(worn - fresh).max(axis=1)
    limit = FORGOTTEN * np.sqrt(np.mean(fresh**2))
    remembered = np.flatnonzero(difference > limit)
    return int(remembered[-1]) + 1 if len(remembered) else 0


def _begins_at_rest(motion: Motion) -> bool:
    """Whether drift and rate are small in the first row."""
    for channel in (motion.s, motion.v):
        if abs(channel[0]) > AT_REST * np.sqrt(np.mean(channel**2)):
            return False
    return True
