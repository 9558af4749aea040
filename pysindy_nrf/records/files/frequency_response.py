"""Measured frequency responses as rows of the force balances."""

import itertools
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ...exceptions import ChannelError, FileFormatError
from .reading import read_table
from .table import MAX_BYTES, check_file, unreadable

# Power of i w that converts a response to acceleration over force.
KINDS = {"accelerance": 0, "mobility": 1, "receptance": 2}


@dataclass(frozen=True)
class FrequencyResponse:
    """Responses of all DOFs to a force on one of them."""

    f: np.ndarray  # Hz, rising, positive
    H: np.ndarray  # accelerance, m/s^2/N, (n_lines, n_dof)
    excited: int = 1  # DOF on which the force acts
    name: str = "frequency response"

    @property
    def n_dof(self) -> int:
        """Number of degrees of freedom."""
        return self.H.shape[1]

    def describe(self, band: tuple[float | None, float | None] | None = None) -> str:
        """Summary in words."""
        size = ", ".join(
            f"H{j + 1} {a:.4g}" for j, a in enumerate(np.abs(self.H).max(axis=0))
        )
        used = self.f[in_band(self.f, band)]
        part = (
            f"; {len(used)} of them in {used[0]:g} to {used[-1]:g} Hz are used"
            if len(used)
            else ""
        )
        idle = ", ".join(str(j) for j in range(1, self.n_dof + 1) if j != self.excited)
        return (
            f"{self.name}: frequency response of {self.n_dof}"
            f" DOF{'s' if self.n_dof > 1 else ''}, {len(self.f)} lines from"
            f" {self.f[0]:g} to {self.f[-1]:g} Hz{part}\n  accelerance in m/s^2/N, peak"
            f" {size}\n  forced: DOF {self.excited}"
            + (f"; known to be unforced: DOF {idle}" if idle else "")
        )


def read_frf(
    path: Any,
    *,
    excited: int = 1,
    kind: str = "accelerance",
    max_bytes: int = MAX_BYTES,
) -> FrequencyResponse:
    """Read measured frequency responses.

    Parameters
    ----------
    path : path-like
        Delimited text (``;``, tab or ``,``) with columns f (Hz), H1, H2, .. of complex
        numbers (``0.1-0.2j``), header or not; or MATLAB, HDF5 or NumPy with ``f`` and
        ``H`` (lines x DOFs) or ``H1``, ``H2``, ...
    excited : int
        The DOF on which the force acts.
    kind : {"accelerance", "mobility", "receptance"}
        Acceleration, velocity or displacement over force, SI units.
    max_bytes : int

    Raises
    ------
    FileFormatError
        If the file holds no frequencies and complex responses.
    ChannelError
        If ``excited`` or ``kind`` is wrong, or a number is not finite.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from pysindy_nrf.records.files import read_frf
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder, "shaker.csv")
    ...     _ = path.write_text(
    ...         "f;H1;H2\\n1.0;0.1+0.01j;0.2+0.02j\\n2.0;0.3-0.1j;0.1+0j\\n"
    ...     )
    ...     read_frf(path, excited=1).H.shape
    (2, 2)
    """
    path = Path(path)
    check_file(path, max_bytes)
    text = path.suffix.lower() in (".csv", ".txt", ".tsv", ".dat", ".asc")
    f, H = _from_text(path) if text else _from_variables(path, max_bytes)
    return frequency_response(f, H, excited, kind, path.stem)


def frequency_response(
    f: Any,
    H: Any,
    excited: int = 1,
    kind: str = "accelerance",
    name: str = "frequency response",
) -> FrequencyResponse:
    """Check frequencies and responses and convert them to accelerance."""
    f, H = np.asarray(f), np.asarray(H)
    if np.iscomplexobj(f):
        if np.abs(f.imag).max(initial=0) > 0:
            raise ChannelError(
                f"{name}: the frequencies are complex",
                "The first column holds frequencies in Hz.",
            )
        f = f.real
    f, H = f.astype(float), np.atleast_2d(H.T).T.astype(complex)
    if H.ndim != 2 or f.ndim != 1 or len(f) != len(H):
        cure = "Give one row of H for each frequency, one column for each DOF."
        raise ChannelError(
            f"{name}: {f.shape} frequencies for responses of shape {H.shape}", cure
        )
    if kind not in KINDS:
        raise ChannelError(
            f"kind={kind!r} is unknown", f"Choose one of {', '.join(KINDS)}."
        )
    if (
        isinstance(excited, bool)
        or not hasattr(excited, "__index__")
        or not 1 <= int(excited) <= H.shape[1]
    ):
        cure = "Name the DOF the force acts on."
        raise ChannelError(
            f"excited={excited!r} is not one of the {H.shape[1]} DOFs of {name}", cure
        )
    for row, j in np.argwhere(~np.isfinite(H))[:1]:
        raise ChannelError(
            f"{name}: H{j + 1} is not finite in row {row}", "Cut this line."
        )
    bad = np.flatnonzero(~np.isfinite(f) | (f < 0))
    if bad.size:
        raise ChannelError(
            f"{name}: the frequency in row {bad[0]} is {f[bad[0]]}",
            "Give positive frequencies in Hz.",
        )
    if (np.diff(f) <= 0).any():
        cure = "Sort the lines."
        raise ChannelError(
            f"{name}: the frequency does not rise after row"
            f" {int(np.argmax(np.diff(f) <= 0))}",
            cure,
        )
    moving = f > 0
    f, H = f[moving], H[moving]
    return FrequencyResponse(
        f, H * (2j * np.pi * f[:, None]) ** KINDS[kind], int(excited), name
    )


def frf_to_features(
    f: Any,
    H: Any = None,
    excited: int = 1,
    band: tuple[float | None, float | None] | None = None,
    weight: Any = None,
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
    frf = f if isinstance(f, FrequencyResponse) else frequency_response(f, H, excited)
    used = in_band(frf.f, band)
    if not used.any():
        cure = f"Its lines go from {frf.f[0]:g} to {frf.f[-1]:g} Hz."
        raise ChannelError(f"{frf.name} has no line in the band {band} Hz", cure)
    scale = np.ones(len(frf.f)) if weight is None else np.asarray(weight, dtype=float)
    if scale.shape != frf.f.shape or not np.isfinite(scale).all() or (scale < 0).any():
        what = (
            f"weight has the shape {scale.shape} for {len(frf.f)} lines, or is not"
            " positive and finite"
        )
        raise ChannelError(what, "Give one positive number for each line.")
    iw = 2j * np.pi * frf.f[used, None]
    a, scale = frf.H[used] * scale[used, None], scale[used]
    columns = np.hstack(
        [a, *(np.diff(y, axis=1, prepend=0.0) for y in (a / iw, a / iw**2))]
    )
    n = frf.n_dof
    force = np.zeros((len(scale), n), dtype=complex)
    force[:, frf.excited - 1] = scale

    def rows(values: np.ndarray, kinds: str) -> pd.DataFrame:
        names = [f"{kind}{j}" for kind in kinds for j in range(1, n + 1)]
        return pd.DataFrame(np.vstack([values.real, values.imag]), columns=names)

    return rows(columns, "avs"), rows(force, "F")


def in_band(
    f: np.ndarray, band: tuple[float | None, float | None] | None
) -> np.ndarray:
    """Lines inside a band, whose ends may be open."""
    low, high = band if band is not None else (None, None)
    return (f >= (0.0 if low is None else low)) & (
        f <= (np.inf if high is None else high)
    )


_CURE = "Give rows of frequency and complex responses: f;H1;H2."


def _from_text(path: Path) -> tuple[np.ndarray, np.ndarray]:
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (UnicodeError, OSError) as error:
        raise unreadable(path, "a frequency response in text", error) from error
    lines = [
        line
        for line in text.splitlines()
        if line.strip() and line.lstrip()[:1] not in ("#", "%")
    ]
    if not lines:
        raise FileFormatError(f"{path} holds no rows", _CURE)
    separator = next((s for s in (";", "\t", ",") if s in lines[-1]), None)
    if separator is None:
        raise FileFormatError(f"{path} has one column only", _CURE)
    start = 0 if _row(lines[0].split(separator)) is not None else 1
    width = len(lines[-1].split(separator))
    rows = []
    for number, line in enumerate(lines[start:], start + 1):
        row = _row(line.split(separator))
        if row is None or len(row) != width:
            what = (
                f"{path}, row {number}: {line[:60]!r} is not {width} numbers separated"
                f" by {separator!r}"
            )
            raise FileFormatError(what, "Write complex numbers as 0.1-0.2j.")
        rows.append(row)
    if not rows:
        raise FileFormatError(f"{path} holds no rows of numbers", _CURE)
    values = np.array(rows)
    if np.abs(values[:, 1:].imag).max() == 0:
        cure = (
            "Magnitudes alone do not identify a model; export real and imaginary parts"
            " as 0.1-0.2j."
        )
        raise FileFormatError(f"{path} holds no complex responses", cure)
    return values[:, 0], values[:, 1:]


def _row(cells: list[str]) -> list[complex] | None:
    try:
        return [complex(re.sub("[ijIJ]", "j", cell.replace(" ", ""))) for cell in cells]
    except ValueError:
        return None


def _from_variables(path: Path, max_bytes: int) -> tuple[np.ndarray, np.ndarray]:
    table = read_table(path, max_bytes=max_bytes)
    plain = {name.lower(): values for name, values in table.variables.items()}
    f = next(
        (
            plain[name]
            for name in ("f", "freq", "frequency", "frequencies")
            if name in plain
        ),
        None,
    )
    H = plain.get("h")
    single = [
        plain[f"h{j}"]
        for j in itertools.takewhile(lambda j: f"h{j}" in plain, itertools.count(1))
    ]
    if H is None and len({len(h) for h in single}) == 1:
        H = np.column_stack(single)
    if f is None or H is None or not np.iscomplexobj(H):
        raise FileFormatError(
            f"{path} holds no frequencies 'f' and complex responses 'H'",
            f"It holds {table.names}.",
        )
    return f, H
