"""From a file to a record, or to what acts on a structure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...exceptions import ChannelError, FileFormatError
from ..record import Record
from .table import MAX_BYTES
from .tables import read_table
from .understanding import Reading, lines_of, record_of, understand
from .units import dimension_of


@dataclass
class Load:
    """What acts on a structure.

    Attributes
    ----------
    name : str
    fs, t0 : float
        Sampling rate, Hz, and time of the first sample, s.
    force : ndarray of shape (n_samples, n_dof)
        N.
    base_acceleration : ndarray of shape (n_samples,) or None
        m/s^2.
    covariates : dict of str to ndarray of shape (n_samples,)
    """

    name: str
    fs: float
    t0: float
    force: np.ndarray
    base_acceleration: np.ndarray | None
    covariates: dict[str, np.ndarray]


def read_record(path: Any, *, mapping: Mapping[str, str] | None = None, fs: float | None = None,
                units: Mapping[str, str] | None = None, name: str | None = None,
                coordinates: str | None = None, max_bytes: int = MAX_BYTES) -> Record:  # fmt: skip
    """Read the measured channels of one test from a file.

    Parameters
    ----------
    path : path-like or sequence of path-like
        See :func:`read_table` for the types and for several files of one test.
    mapping : mapping of str to str, optional
        Channels by ``[-] name [:, k] * factor @ unit``: ``{"x1": "qm", "F1": "vir*35.1507",
        "a2": "-acc[:, 2] @ g"}``. The factor may name a number held by the file. ``"none"`` drops a
        channel, ``"unknown"`` says that a force acts but was not measured. Channels are ``a1..,
        v1.., x1.., F1.., ag, vg, xg, t``; any other name becomes a covariate. Columns that carry
        a channel's name need no mapping; all others are left out.
    fs : float, optional
        Sampling rate, Hz, where the file has no time.
    units : mapping of str to str, optional
        Units by channel or by kind, ``{"a": "g", "x": "mm", "x3": "in"}``; ``@ unit`` in the mapping
        goes first, a unit written in the file's header last. SI where nothing is said.
    name : str, optional
        Name of the test; that in the file, or the file's own, if None.
    coordinates : {"relative", "absolute"}, optional
        Whether velocities and displacements are relative to the base; relative if neither you nor the
        file say.
    max_bytes : int

    Returns
    -------
    Record
        SI units. A file written by :func:`write_record` gives its record back bit for bit.

    Raises
    ------
    FileFormatError
        If the file cannot be read or has no such variable.
    ChannelError
        If a mapping or unit is not understood, or a channel does not hold finite numbers.
    MissingExtraError
        If the type of file or a unit needs an optional package.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from pysindy_nrf.data.io import read_record
    >>> folder = tempfile.TemporaryDirectory()
    >>> path = pathlib.Path(folder.name, "test 7.csv")
    >>> _ = path.write_text("t,laser [m],drive\\n0.00,0.1,0.1\\n0.01,0.5,0.2\\n0.02,0.1,0.1\\n")
    >>> rec = read_record(path, mapping={"x1": "laser", "F1": "drive*35.15"})
    >>> rec
    Record('test 7': 1 DOF, 3 samples at 100 Hz (0.03 s), channels F1, x1)
    >>> rec.displacement.ravel(), rec.force.ravel()
    (array([0.1, 0.5, 0.1]), array([3.515, 7.03 , 3.515]))
    >>> folder.cleanup()
    """
    return inspect_record(
        path, mapping=mapping, fs=fs, units=units, name=name, coordinates=coordinates, max_bytes=max_bytes
    ).record


def inspect_record(path: Any, *, mapping: Mapping[str, str] | None = None, fs: float | None = None,
                   units: Mapping[str, str] | None = None, name: str | None = None,
                   coordinates: str | None = None, max_bytes: int = MAX_BYTES) -> Reading:  # fmt: skip
    r"""Read a record and keep how the file was understood, for :func:`describe`.

    Parameters
    ----------
    path, mapping, fs, units, name, coordinates, max_bytes
        As for :func:`read_record`.

    Returns
    -------
    Reading

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from pysindy_nrf import io
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder, "own.csv")
    ...     _ = path.write_text("t,Deck\n" + "".join(f"{k / 100},{k % 7}\n" for k in range(50)))
    ...     reading = io.inspect_record(path, mapping={"x1": "Deck @ mm"})
    >>> print(io.describe(reading).splitlines()[3])
      x1  displacement relative to base     rms 0.003569 m, peak 0.006 m   <- Deck in mm
    """
    table = read_table(path, max_bytes=max_bytes)
    return understand(table, mapping=mapping, fs=fs, units=units, name=name, coordinates=coordinates)


def read_excitation(path: Any, n_dof: int, *, mapping: Mapping[str, str] | None = None, fs: float | None = None,
                    units: Mapping[str, str] | None = None, name: str | None = None,
                    max_bytes: int = MAX_BYTES) -> Load:  # fmt: skip
    r"""Read what acts on a structure, to simulate its answer.

    Parameters
    ----------
    path, mapping, fs, units, name, max_bytes
        As for :func:`read_record`.
    n_dof : int
        Degrees of freedom of the structure.

    Returns
    -------
    Load
        Motions are left out, in the file as in ``mapping`` and ``units``.

    Raises
    ------
    ChannelError
        If nothing acts, or a force acts on a DOF that the structure does not have.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from pysindy_nrf import io
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder, "hit.csv")
    ...     _ = path.write_text("t,F2\n" + "".join(f"{k / 100},{100.0 * (k == 5)}\n" for k in range(50)))
    ...     load = io.read_excitation(path, n_dof=3)
    >>> load.force.shape, float(load.force[5, 1])  # N, on floor 2
    ((50, 3), 100.0)
    """
    table = read_table(path, max_bytes=max_bytes)
    # what a mapping file says of the motions of the whole test need not be in this file
    mapping = {c: text for c, text in (mapping or {}).items() if not _is_motion(c)}
    base = "ag" in mapping or "ag" in table.variables
    units = {c: unit for c, unit in (units or {}).items() if not _is_motion(c) and c not in ("v", "x", "a"[base:])}
    lines, sources = lines_of(table, mapping, units)
    lines = {c: line for c, line in lines.items() if not _is_motion(c)}
    if not any(dimension_of(c) == "force" or c == "ag" for c in lines):
        raise FileFormatError(
            f"{table.path}: no column is known to be a force or the base acceleration; it holds {table.names}",
            "Name columns F1.., ag, t, or map them: mapping={'F1': 'name'}, --map F1=name.",
        )
    beyond = [c for c in lines if c[:1] == "F" and c[1:].isdigit() and int(c[1:]) > n_dof]
    if beyond:
        raise ChannelError(f"{beyond[0]} acts on a DOF that the model does not have", f"It has DOFs 1 to {n_dof}.")
    n = len(next(iter(lines.values())))
    lines |= {f"x{j}": np.zeros(n) for j in range(1, n_dof + 1)}  # a record wants motions
    record = record_of(table, lines, sources, fs, name or table.path.stem, "relative")[0]
    if record.unknown:
        raise ChannelError(f"F{record.unknown[0]} is unknown", "A simulation needs the force itself.")
    return Load(record.name, record.fs, record.t0, record.force, record.base_acceleration, record.covariates)


def _is_motion(channel: str) -> bool:
    """Whether a channel is an answer: a motion of a floor, or of the base but for its acceleration."""
    return channel != "ag" and dimension_of(channel) in ("length", "velocity", "acceleration")
