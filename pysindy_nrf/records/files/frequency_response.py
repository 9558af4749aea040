"""Measured frequency responses as rows of the force balances."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from ...exceptions import ChannelError

# Power of i w that converts a response to acceleration over force.
KINDS = {"accelerance": 0, "mobility": 1, "receptance": 2}
Band = tuple[float | None, float | None]  # Hz; None leaves an end open


@dataclass(frozen=True)
class FrequencyResponse:
    """Responses of all DOFs to a force on one of them.

    Parameters
    ----------
    f : ndarray of shape (n_lines,)
        Frequencies, Hz, rising and positive.
    H : ndarray of complex, shape (n_lines, n_dof)
        Accelerance, m/s^2/N.
    excited : int
        The DOF on which the force acts.
    name : str
    """

    f: np.ndarray
    H: np.ndarray
    excited: int = 1
    name: str = "frequency response"

    @classmethod
    def from_arrays(
        cls,
        f: ArrayLike,
        H: ArrayLike,
        excited: int = 1,
        kind: str = "accelerance",
        name: str = "frequency response",
    ) -> FrequencyResponse:
        """Check frequencies and responses, and convert them to accelerance.

        A line at 0 Hz, where a force moves no accelerometer, is left out.

        Parameters
        ----------
        f : array-like of shape (n_lines,)
            Frequencies, Hz.
        H : array-like of complex, shape (n_lines, n_dof)
            Responses, SI units.
        excited : int
            The DOF on which the force acts.
        kind : {"accelerance", "mobility", "receptance"}
            Acceleration, velocity or displacement over force.
        name : str

        Raises
        ------
        ChannelError
            If the arrays do not fit each other, are not finite, the frequencies do not
            rise, or ``kind`` or ``excited`` is wrong.
        """
        frequencies = _real_frequencies(np.asarray(f), name)
        responses = np.asarray(H).astype(complex)
        if responses.ndim == 1:
            responses = responses[:, None]
        if responses.ndim != 2 or frequencies.shape != responses.shape[:1]:
            raise ChannelError(
                f"{name}: {frequencies.shape} frequencies for responses of shape"
                f" {responses.shape}",
                "Give one row of H for each frequency, one column for each DOF.",
            )
        if kind not in KINDS:
            raise ChannelError(
                f"kind={kind!r} is unknown", f"Choose one of {', '.join(KINDS)}."
            )
        _require_dof(excited, responses.shape[1], name)
        _require_finite(responses, name)
        _require_rising(frequencies, name)

        moving = frequencies > 0
        frequencies = frequencies[moving]
        iw = 2j * np.pi * frequencies[:, None]
        accelerance = responses[moving] * iw ** KINDS[kind]
        return cls(frequencies, accelerance, int(excited), name)

    @property
    def rotates(self) -> bool:
        """False: of rotations only a ``Chain(n, rotates=True)`` knows."""
        return False

    @property
    def n_dof(self) -> int:
        """Number of degrees of freedom."""
        return self.H.shape[1]

    def describe(self, band: Band | None = None) -> str:
        """Summary in words; lines in the band are those that are used."""
        dofs = "DOFs" if self.n_dof > 1 else "DOF"
        lines = f"{len(self.f)} lines from {self.f[0]:g} to {self.f[-1]:g} Hz"
        used = self.f[in_band(self.f, band)]
        if len(used):
            lines += f"; {len(used)} of them in {used[0]:g} to {used[-1]:g} Hz are used"

        peaks = np.abs(self.H).max(axis=0)
        sizes = ", ".join(f"H{j} {peak:.4g}" for j, peak in enumerate(peaks, 1))
        forces = f"forced: DOF {self.excited}"
        unforced = [str(j) for j in range(1, self.n_dof + 1) if j != self.excited]
        if unforced:
            forces += f"; known to be unforced: DOF {', '.join(unforced)}"
        return (
            f"{self.name}: frequency response of {self.n_dof} {dofs}, {lines}\n"
            f"  accelerance in m/s^2/N, peak {sizes}\n"
            f"  {forces}"
        )


def _real_frequencies(f: np.ndarray, name: str) -> np.ndarray:
    if np.iscomplexobj(f):
        if np.abs(f.imag).max(initial=0) > 0:
            raise ChannelError(
                f"{name}: the frequencies are complex",
                "The first column holds frequencies in Hz.",
            )
        f = f.real
    return f.astype(float)


def _require_dof(excited: int, n_dof: int, name: str) -> None:
    is_integer = hasattr(excited, "__index__") and not isinstance(excited, bool)
    if not is_integer or not 1 <= int(excited) <= n_dof:
        raise ChannelError(
            f"excited={excited!r} is not one of the {n_dof} DOFs of {name}",
            "Name the DOF the force acts on.",
        )


def _require_finite(H: np.ndarray, name: str) -> None:
    bad = np.argwhere(~np.isfinite(H))
    if bad.size:
        row, column = bad[0]
        raise ChannelError(
            f"{name}: H{column + 1} is not finite in row {row}", "Cut this line."
        )


def _require_rising(f: np.ndarray, name: str) -> None:
    """Refuse frequencies that are not positive, or do not rise."""
    bad = np.flatnonzero(~np.isfinite(f) | (f < 0))
    if bad.size:
        raise ChannelError(
            f"{name}: the frequency in row {bad[0]} is {f[bad[0]]}",
            "Give positive frequencies in Hz.",
        )
    falls = np.flatnonzero(np.diff(f) <= 0)
    if falls.size:
        raise ChannelError(
            f"{name}: the frequency does not rise after row {falls[0]}",
            "Sort the lines.",
        )


def frf_to_features(
    f: ArrayLike | FrequencyResponse,
    H: ArrayLike | None = None,
    excited: int = 1,
    band: Band | None = None,
    weight: ArrayLike | None = None,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    r"""Rows of the force balances from a frequency response.

    Under a force of 1 N at the circular frequency w a linear chain moves with ``a =
    H``, ``v = H / (i w)`` and ``x = H / (i w)^2``; the balances hold for the real and
    for the imaginary parts. Exact for laws that are linear in v and s, and for no
    others.

    Parameters
    ----------
    f : array-like of shape (n_lines,) or FrequencyResponse
        Hz.
    H : array-like of complex, shape (n_lines, n_dof)
        Accelerance, m/s^2/N; left out with a FrequencyResponse.
    excited : int
    band : (float, float), optional
        Hz; lines outside are left out.
    weight : array-like of shape (n_lines,), optional
        Factor of the rows of each line of ``f``; 1 if None.

    Returns
    -------
    X : DataFrame of shape (2 n_lines_in_band, 3 n_dof)
        ``a1.., v1.., s1..`` of storey drifts on a base at rest: the real rows, then the
        imaginary ones.
    F : DataFrame of shape (2 n_lines_in_band, n_dof)

    Raises
    ------
    ChannelError
        If no line lies in the band.

    Notes
    -----
    Noise in H is noise in the regressors and biases what least squares finds from these
    rows low; ``NRFRegressor.fit`` of a FrequencyResponse measures the noise and is not
    biased.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf import NRFRegressor, io
    >>> f = np.linspace(1, 10, 50)
    >>> w = 2 * np.pi * f
    >>> H = -(w**2) / (3000.0 + 4j * w - 2.5 * w**2)
    >>> X, F = io.frf_to_features(f, H[:, None], excited=1)
    >>> model = NRFRegressor(degree=1).fit(X, F)
    >>> (
    ...     model.masses_.round(9),
    ...     model.restoring_forces_[1].coefficients.round(6).to_dict(),
    ... )
    (array([2.5]), {'v': 4.0, 's': 3000.0})
    """
    if isinstance(f, FrequencyResponse):
        frf = f
    else:
        frf = FrequencyResponse.from_arrays(f, np.asarray(H), excited)
    used = in_band(frf.f, band)
    if not used.any():
        raise ChannelError(
            f"{frf.name} has no line in the band {band} Hz",
            f"Its lines go from {frf.f[0]:g} to {frf.f[-1]:g} Hz.",
        )

    scale = _line_weights(weight, len(frf.f))[used, None]
    iw = 2j * np.pi * frf.f[used, None]
    acceleration = frf.H[used] * scale
    rate = np.diff(acceleration / iw, axis=1, prepend=0.0)
    drift = np.diff(acceleration / iw**2, axis=1, prepend=0.0)
    force = np.zeros_like(acceleration)
    force[:, frf.excited - 1] = scale[:, 0]

    X = _real_and_imaginary(np.hstack([acceleration, rate, drift]), "avs")
    F = _real_and_imaginary(force, "F")
    return X, F


def _line_weights(weight: ArrayLike | None, n_lines: int) -> np.ndarray:
    """A factor for each line, 1 if None."""
    if weight is None:
        return np.ones(n_lines)
    scale = np.asarray(weight, dtype=float)
    is_usable = np.isfinite(scale).all() and (scale >= 0).all()
    if scale.shape != (n_lines,) or not is_usable:
        raise ChannelError(
            f"weight has the shape {scale.shape} for {n_lines} lines, or is not"
            " positive and finite",
            "Give one positive number for each line.",
        )
    return scale


def _real_and_imaginary(values: np.ndarray, letters: str) -> pd.DataFrame:
    """Real parts over imaginary parts; each letter is numbered by DOF."""
    n_dof = values.shape[1] // len(letters)
    names = [f"{letter}{j}" for letter in letters for j in range(1, n_dof + 1)]
    return pd.DataFrame(np.vstack([values.real, values.imag]), columns=names)


def in_band(f: np.ndarray, band: Band | None) -> np.ndarray:
    """Whether each line is inside a band, whose ends may be open."""
    low, high = band if band is not None else (None, None)
    above = f >= (0.0 if low is None else low)
    below = f <= (np.inf if high is None else high)
    return above & below
