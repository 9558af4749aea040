"""The free run of a model, and what further forces would do to the channels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import next_fast_len

from ..chain.layout import LawLayout
from ..chain.model import ChainModel, state_matrix
from .free_runs import with_motion
from .linear_response import Matrices, equivalent_matrices, transfer
from .shots import Shot

# Time constants of the slowest mode after which a thousandth of the motion is left.
TIME_CONSTANTS_OF_DECAY = 7.0
# Length of a padded record over that of the record, at most.
MAX_PADDING = 6


@dataclass(frozen=True)
class _Response:
    """Response of the channels to forces, at the lines of a padded record."""

    n_padded: int
    transfer: np.ndarray  # (n_lines, n_channels, n_dof)


class Linearised:
    """The free run of a model, and what further forces would do, to first order.

    If masses m and laws R are true, the channels miss the run by ``-G (M a + R - F)``,
    with G the response of the model.

    Parameters
    ----------
    model : ChainModel
    shots : sequence of Shot

    Attributes
    ----------
    measured, gaps : dict of int to ndarray of shape (n_channels, n_samples)
        By shot, the channels and what the run misses of them.
    runs : list of Segment
        The free runs.
    """

    def __init__(self, model: ChainModel, shots: Sequence[Shot]) -> None:
        self.measured = {}
        self.gaps = {}
        self.runs = []
        for number, shot in enumerate(shots):
            motion = shot.motion(model)
            self.measured[number] = shot.measured.T
            self.gaps[number] = (shot.measured - shot.channels_of(motion)).T
            self.runs.append(with_motion(shot.segment, motion))

        layout = LawLayout(model.chain, model.laws)
        matrices = equivalent_matrices(model, layout, self.runs)
        poles = np.linalg.eigvals(state_matrix(*matrices))
        decay = TIME_CONSTANTS_OF_DECAY / np.abs(poles.real).min()
        self._responses = [_response(matrices, shot, decay) for shot in shots]

    def through(self, rows: np.ndarray, ends: np.ndarray, number: int) -> np.ndarray:
        """Channels from forces that enter the equations of motion.

        Parameters
        ----------
        rows : ndarray of shape (n_rows, n_samples)
            Forces, N.
        ends : ndarray of shape (n_dof,)
            Sign with which they enter each equation.
        number : int
            Of the shot.

        Returns
        -------
        ndarray of shape (n_rows * n_channels, n_samples)
        """
        response = self._responses[number]
        n_samples = rows.shape[1]
        lines = np.fft.rfft(rows, response.n_padded, axis=1)
        channels = lines[:, None] * (response.transfer @ ends).T
        motion = np.fft.irfft(channels, response.n_padded, axis=2)
        return motion[:, :, :n_samples].reshape(-1, n_samples)


def _response(matrices: Matrices, shot: Shot, decay: float) -> _Response:
    """Response of a shot's channels, padded until its end has died out (decay, s)."""
    n_padded = min(
        shot.n_samples + decay / shot.segment.step, MAX_PADDING * shot.n_samples
    )
    n_fast = next_fast_len(int(n_padded), True)
    f = np.fft.rfftfreq(n_fast, shot.segment.step)
    # of a constant force a free chain moves without bound
    f[0] = 1e-3 * f[1]
    return _Response(n_fast, transfer(matrices, f, shot.channels)[:, :, :-1])
