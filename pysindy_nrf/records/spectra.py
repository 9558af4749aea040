"""Spectral densities, coherences and frequency responses of measured channels.

Welch's averages over halves that overlap, with a Hann window (Bendat and Piersol,
Random Data, 4th ed., ch. 7 and 11).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import signal

# Stretches that a record is cut into, two of which overlap by half: 15 averages.
N_STRETCHES = 8
# Longest stretch, samples: finer lines are not told apart in a picture.
LONGEST_STRETCH = 8192
# Part of the trace of the densities of the inputs below which one follows the others.
DEPENDENT = 1e-10


@dataclass(frozen=True, eq=False)
class Spectra:
    """Densities of inputs and outputs by frequency.

    Parameters
    ----------
    f : ndarray of shape (n_lines,)
        Hz.
    inputs : ndarray of shape (n_lines, n_inputs, n_inputs)
        Densities between the inputs.
    crossed : ndarray of shape (n_lines, n_outputs, n_inputs)
        Densities from inputs to outputs.
    outputs : ndarray of shape (n_lines, n_outputs)
        Density of each output.
    """

    f: np.ndarray
    inputs: np.ndarray
    crossed: np.ndarray
    outputs: np.ndarray

    @property
    def responses(self) -> np.ndarray:
        """Outputs over inputs (H1), shape (n_lines, n_outputs, n_inputs)."""
        return self.crossed @ np.linalg.pinv(self.inputs, rcond=DEPENDENT)

    @property
    def coherence(self) -> np.ndarray:
        """Share of each output that follows all inputs, shape (n_lines, n_outputs)."""
        explained = np.einsum("foi,foi->fo", self.responses, self.crossed.conj()).real
        share = np.zeros_like(self.outputs)
        np.divide(explained, self.outputs, out=share, where=self.outputs > 0)
        return np.clip(share, 0.0, 1.0)


def stretch_of(n_samples: int) -> int:
    """Samples of the stretches of a record."""
    return int(min(LONGEST_STRETCH, max(8, n_samples // N_STRETCHES)))


def density(line: np.ndarray, fs: float) -> tuple[np.ndarray, np.ndarray]:
    """One-sided density of a channel, its unit squared by Hz.

    Parameters
    ----------
    line : ndarray of shape (n_samples,)
    fs : float
        Hz.

    Returns
    -------
    f, density : ndarray of shape (n_lines,)

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf.records.spectra import density
    >>> white = np.random.default_rng(0).normal(size=50_000)
    >>> f, power = density(white, 100.0)
    >>> round(float(power.mean()), 2)  # variance 1 over 50 Hz
    0.02
    """
    f, power = signal.welch(line, fs, nperseg=stretch_of(len(line)))
    return f, power


def spectra_of(inputs: np.ndarray, outputs: np.ndarray, fs: float) -> Spectra:
    """Densities of channels that drive and of channels that answer.

    Parameters
    ----------
    inputs : ndarray of shape (n_samples, n_inputs)
    outputs : ndarray of shape (n_samples, n_outputs)
    fs : float
        Hz.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf.records.spectra import spectra_of
    >>> force = np.random.default_rng(0).normal(size=(20_000, 1))
    >>> spectra = spectra_of(force, 3.0 * force, 100.0)
    >>> (
    ...     abs(spectra.responses[50, 0, 0]).round(6),
    ...     spectra.coherence[50].round(6),
    ... )
    (np.float64(3.0), array([1.]))
    """
    size = stretch_of(len(inputs))
    rows_of_inputs, rows_of_outputs = inputs.T, outputs.T
    f, between = signal.csd(
        rows_of_inputs[None], rows_of_inputs[:, None], fs, nperseg=size
    )
    _, crossed = signal.csd(
        rows_of_inputs[None], rows_of_outputs[:, None], fs, nperseg=size
    )
    _, of_outputs = signal.welch(rows_of_outputs, fs, nperseg=size)
    return Spectra(
        f,
        np.moveaxis(between, -1, 0),
        np.moveaxis(crossed, -1, 0),
        of_outputs.T,
    )
