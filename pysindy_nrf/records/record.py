"""Record: the measured channels of one test on one clock."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping
from datetime import datetime
from typing import Any

import numpy as np
import pandas as pd

from ..common import MOST_DOFS, number_of
from ..common.lazy import Hook
from ..exceptions import ChannelError
from .channels import GAP, as_matrix, channel_of, finite_span, rate_of

_LARGEST = 1e100  # SI units; its square is still a double
MATRICES = {
    "force": "F",
    "acceleration": "a",
    "velocity": "v",
    "displacement": "x",
}  # one column for each DOF
BASES = {"base_acceleration": "ag", "base_velocity": "vg", "base_displacement": "xg"}
OF_LETTER = {letter: key for key, letter in MATRICES.items()}


class Record:
    """The measured channels of one test on one clock.

    Parameters
    ----------
    force : array-like of shape (n_samples, n_dof), optional
        Applied forces F_j, N. A column of zeros = known to be unforced; a column of NaN
        = unknown. None = all forces are zero (base excitation, free decay).
    acceleration : array-like of shape (n_samples, n_dof), optional
        Absolute accelerations a_j (what accelerometers measure), m/s^2. A column of NaN
        = not measured.
    velocity, displacement : array-like of shape (n_samples, n_dof), optional
        Motion of the DOFs relative to the base, m/s and m (or absolute, see
        ``coordinates``).
    fs : float, optional
        Sampling rate, Hz; found from ``time`` if None. A quasi-static test of an
        element without mass, forces and displacements alone, needs neither: its rate is
        NaN.
    base_acceleration : array-like of shape (n_samples,), optional
        Acceleration of the base, m/s^2. None = the base is at rest.
    base_velocity, base_displacement : array-like of shape (n_samples,), optional
        Motion of the base, m/s and m.
    covariates : mapping of str to array-like of shape (n_samples,), optional
        Further channels, e.g. a damper's voltage.
    name : str
        Name of the test, used in messages and reports.
    coordinates : {"relative", "absolute"}
        Reference of ``velocity`` and ``displacement``: the base, or a fixed point.
    time : array-like of shape (n_samples,), optional
        Time of the samples, s, equally spaced.

    Attributes
    ----------
    n_dof, n_samples : int
    fs, dt : float
        Sampling rate, Hz, and step, s.
    time : ndarray of shape (n_samples,)
        Seconds, as they were given; from 0 if only a rate was. A window of a record
        keeps its times.

    Raises
    ------
    ChannelError
        If lengths differ, a channel does not hold finite numbers, or the clock is not
        even.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf import Record
    >>> t = np.arange(1000) / 1000
    >>> x = np.column_stack([np.sin(9 * t), 2 * np.sin(9 * t)])
    >>> rec = Record(
    ...     displacement=x, acceleration=-81 * x, force=0 * x, fs=1000.0
    ... )
    >>> rec.n_dof, rec.n_samples, rec.measured
    (2, 1000, ('F1', 'F2', 'a1', 'a2', 'x1', 'x2'))
    """

    def __init__(
        self,
        force: Any = None,
        acceleration: Any = None,
        velocity: Any = None,
        displacement: Any = None,
        fs: float | None = None,
        base_acceleration: Any = None,
        base_displacement: Any = None,
        covariates: Mapping[str, Any] | None = None,
        name: str = "record",
        *,
        base_velocity: Any = None,
        coordinates: str = "relative",
        time: Any = None,
    ) -> None:
        if coordinates not in ("relative", "absolute"):
            cure = "Choose 'relative' (to the base) or 'absolute'."
            raise ChannelError(f"coordinates={coordinates!r} is unknown", cure)
        self.name = (
            str(name).encode("utf-8", "backslashreplace").decode()
        )  # a file's name may be no text
        self.coordinates = coordinates
        given = {
            "acceleration": acceleration,
            "velocity": velocity,
            "displacement": displacement,
            "force": force,
        }
        arrays = {
            key: as_matrix(value, MATRICES[key], what=key)
            for key, value in given.items()
            if value is not None
        }
        motions = [array for key, array in arrays.items() if key != "force"]
        if not motions:
            raise ChannelError(
                f"Record {self.name!r} has no motion",
                "Give acceleration, velocity or displacement.",
            )
        n_dof = {a.shape[1] for a in arrays.values()}
        if len(n_dof) > 1:
            what = f"Record {self.name!r}: " + ", ".join(
                f"{k} has {a.shape[1]} columns" for k, a in arrays.items()
            )
            raise ChannelError(
                what,
                "Give one column for each DOF everywhere; NaN for a channel that is not"
                " measured.",
            )
        self.n_dof = n_dof.pop()
        if not 1 <= self.n_dof <= MOST_DOFS:
            cure = (
                "Give one row per sample and one column per DOF; transpose the arrays?"
            )
            raise ChannelError(f"Record {self.name!r} has {self.n_dof} DOFs", cure)
        if not isinstance(covariates, (Mapping, type(None))):
            cure = "Give channels by name: covariates={'voltage': u}."
            raise ChannelError(
                f"Record {self.name!r}: the covariates are not a mapping", cure
            )
        bases = {
            "base acceleration ag": base_acceleration,
            "base velocity vg": base_velocity,
            "base displacement xg": base_displacement,
        }
        bases |= {f"covariate {k}": v for k, v in dict(covariates or {}).items()}
        lines = {
            k: as_matrix(v, [k], 1, k)[:, 0] for k, v in bases.items() if v is not None
        }
        lengths = {k: len(a) for k, a in (arrays | lines).items()}
        if len(set(lengths.values())) > 1:
            found = ", ".join(f"{k} {n}" for k, n in lengths.items())
            cure = "Cut or resample them to one clock."
            raise ChannelError(
                f"Record {self.name!r}: channels differ in length, {found}", cure
            )
        self.n_samples = next(iter(lengths.values()))
        if self.n_samples < 2:
            raise ChannelError(
                f"Record {self.name!r} has {self.n_samples} samples",
                "At least two are needed.",
            )
        if all(np.isnan(motion).all() for motion in motions):
            cure = "Give at least one measured channel."
            raise ChannelError(
                f"Record {self.name!r} has no motion, every channel is NaN", cure
            )
        if (
            fs is None
            and time is None
            and arrays.keys() == {"force", "displacement"}
            and not lines
        ):
            self.fs, self.t0 = np.nan, 0.0
        else:
            self.fs, self.t0 = _clock(fs, time, self.n_samples, self.name)
        self.acceleration: np.ndarray | None = arrays.get("acceleration")
        self.velocity: np.ndarray | None = arrays.get("velocity")
        self.displacement: np.ndarray | None = arrays.get("displacement")
        self.force: np.ndarray = arrays.get(
            "force", np.zeros((self.n_samples, self.n_dof))
        )
        self.base_acceleration: np.ndarray | None = lines.get("base acceleration ag")
        self.base_velocity: np.ndarray | None = lines.get("base velocity vg")
        self.base_displacement: np.ndarray | None = lines.get("base displacement xg")
        self.covariates = {k: lines[f"covariate {k}"] for k in dict(covariates or {})}
        columns = self.channels()
        finite_span(list(columns.values()), list(columns), f"record {self.name!r}")
        for channel, line in columns.items():
            if (
                not float(np.abs(line).max()) <= _LARGEST
                and float(max(-np.nanmin(line), np.nanmax(line))) > _LARGEST
            ):
                what = (
                    f"Channel {channel} of record {self.name!r} reaches"
                    f" {np.nanmax(np.abs(line)):.3g}, whose square "
                )
                raise ChannelError(
                    f"{what}leaves the range of a double", "Check its unit."
                )

    def channels(self) -> dict[str, np.ndarray]:
        """Measured channels by name.

        Returns
        -------
        dict of str to ndarray of shape (n_samples,)
            ``F1..`` (N), ``a1..`` (m/s^2), ``v1..`` (m/s), ``x1..`` (m), ``ag``,
            ``vg``, ``xg`` and covariates; a column of NaN is left out.
        """
        out: dict[str, np.ndarray] = {}
        for key, prefix in MATRICES.items():
            matrix = getattr(self, key)
            if matrix is not None:
                empty = {
                    j
                    for j in np.flatnonzero(np.isnan(matrix[0]))
                    if np.isnan(matrix[:, j]).all()
                }
                out |= {
                    f"{prefix}{j + 1}": line
                    for j, line in enumerate(matrix.T)
                    if j not in empty
                }
        out |= {
            short: line
            for key, short in BASES.items()
            if (line := getattr(self, key)) is not None
        }
        return out | self.covariates

    @property
    def measured(self) -> tuple[str, ...]:
        """Names of the measured channels."""
        return tuple(self.channels())

    @property
    def has_clock(self) -> bool:
        """False for forces and displacements without a rate."""
        return bool(np.isfinite(self.fs))

    def by_sample(self) -> Record:
        """The record itself; one without a clock with the number of the sample for the
        time, 1 Hz.
        """
        return self if self.has_clock else self.replace(fs=1.0)

    @property
    def dt(self) -> float:
        """Sampling step, s."""
        return 1.0 / self.fs

    @property
    def time(self) -> np.ndarray:
        """Time of the samples, s."""
        if not self.has_clock:
            raise ChannelError(
                f"Record {self.name!r} has no clock",
                "Give fs= in Hz, or take by_sample().",
            )
        return self.t0 + np.arange(self.n_samples) / self.fs

    @property
    def forced(self) -> tuple[int, ...]:
        """DOFs on which a known force acts."""
        return tuple(
            (np.flatnonzero(np.nan_to_num(self.force).any(axis=0)) + 1).tolist()
        )

    @property
    def unknown(self) -> tuple[int, ...]:
        """DOFs whose force is unknown."""
        return tuple((np.flatnonzero(np.isnan(self.force).all(axis=0)) + 1).tolist())

    @property
    def base_moves(self) -> bool:
        """True if a motion of the base was given."""
        return any(
            (line := getattr(self, key)) is not None and np.nan_to_num(line).any()
            for key in BASES
        )

    @classmethod
    def from_frame(
        cls, df: pd.DataFrame, fs: float | None = None, **options: Any
    ) -> Record:
        """Record from a table with columns a1.., v1.., x1.., F1.., ag, vg, xg and a
        time.

        Parameters
        ----------
        df : DataFrame
            The time is column ``t`` or ``time`` (s), or the index if that is a time
            index or a float index named so. Other columns become covariates.
        fs : float, optional
            Sampling rate, Hz, if the table has no time.
        **options
            Passed to :class:`Record` (``name``, ``coordinates``).

        Raises
        ------
        ChannelError
            If no column is a motion or a DOF is missing in the numbering.
        """
        if not isinstance(df, pd.DataFrame):
            raise ChannelError(
                f"{type(df).__name__} is not a table",
                "Give a DataFrame with columns a1.., x1.., F1..",
            )
        names = [str(c) for c in df.columns]
        twice = sorted({c for c in names if names.count(c) > 1})
        if twice:
            raise ChannelError(
                f"Column {twice[0]!r} is in the table more than once",
                "Rename or drop one.",
            )
        columns = {name: df.iloc[:, i] for i, name in enumerate(names)}
        clock = next((name for name in ("t", "time") if name in columns), None)
        time = None if clock is None else columns.pop(clock).to_numpy()
        stamped = isinstance(df.index, (pd.DatetimeIndex, pd.TimedeltaIndex))
        if (
            time is None
            and fs is None
            and (
                stamped
                or df.index.name in ("t", "time")
                and df.index.dtype.kind in "fiu"
            )
        ):
            time = df.index if stamped else df.index.to_numpy()
        numbered: dict[str, Any] = {}
        for column in list(columns):
            channel = channel_of(column) or ""
            if channel[1:].isdigit():
                if channel in numbered:
                    raise ChannelError(
                        f"{column!r} and another column both mean {channel}",
                        "Rename or drop one.",
                    )
                numbered[channel] = columns.pop(column)
        if all(channel[0] == "F" for channel in numbered):
            cure = (
                "Name accelerations a1.., velocities v1.., displacements x1.., forces"
                " F1.., base acceleration ag."
            )
            raise ChannelError(
                f"No column of {', '.join(names[:10])} is a motion", cure
            )
        n = max(int(channel[1:]) for channel in numbered)
        if n > MOST_DOFS:
            raise ChannelError(
                f"A column names DOF {n}, more than the {MOST_DOFS} a chain may have",
                "Rename it.",
            )

        def matrix(prefix: str, missing: float) -> np.ndarray | None:
            if not any(channel[0] == prefix for channel in numbered):
                return None
            filler = np.full(len(df), missing)
            names = [f"{prefix}{j}" for j in range(1, n + 1)]
            return np.column_stack(
                [
                    as_matrix(numbered.get(name, filler), [name], 1)[:, 0]
                    for name in names
                ]
            )

        parts: dict[str, Any] = {
            key: columns.pop(short).to_numpy()
            for key, short in BASES.items()
            if short in columns
        }
        parts |= {
            key: matrix(prefix, 0.0 if key == "force" else np.nan)
            for key, prefix in MATRICES.items()
        }
        return cls(
            fs=fs,
            time=time,
            **parts,
            covariates={k: c.to_numpy() for k, c in columns.items()},
            **options,
        )

    def to_frame(self) -> pd.DataFrame:
        """Table of the measured channels, indexed by time ``t`` in s.

        Returns
        -------
        DataFrame
        """
        return pd.DataFrame(self.channels(), index=pd.Index(self.time, name="t"))

    def to_features(self, smooth: bool = True) -> tuple[pd.DataFrame, pd.DataFrame]:
        """Regressor input: accelerations, inter-storey velocities and drifts (paper eq.
        8).

        Parameters
        ----------
        smooth : bool
            True: channels are fused and completed by
            :class:`pysindy_nrf.KinematicSmoother`. False: they are taken as they are,
            and each DOF needs all three.

        Returns
        -------
        X : DataFrame of shape (n_samples, 3 n_dof)
            ``a1.., v1.., s1..``; a absolute, v and s relative to the DOF below; SI
            units, index t.
        F : DataFrame of shape (n_samples, n_dof)
            ``F1..``, N.

        Raises
        ------
        ChannelError
            With ``smooth=False``, if a channel is missing.
        """
        return Hook.TO_FEATURES(self, smooth)

    def window(self, start: float, stop: float) -> Record:
        """Part of the record between two times.

        Parameters
        ----------
        start, stop : float
            Seconds; ``stop`` is not included.

        Raises
        ------
        ChannelError
            If fewer than two samples lie between them.
        """
        rows = np.flatnonzero(
            (self.time >= start - 0.5 * self.dt) & (self.time < stop - 0.5 * self.dt)
        )
        if len(rows) < 2:
            cure = f"It lasts from {self.time[0]:g} to {self.time[-1]:g} s."
            raise ChannelError(
                f"Record {self.name!r} has no samples from {start} to {stop} s", cure
            )
        return self.rows(slice(rows[0], rows[-1] + 1))

    def rows(self, rows: slice) -> Record:
        """Part of the record in a slice of two or more consecutive rows; see
        :meth:`window` for times.

        Parameters
        ----------
        rows : slice
        """
        start = range(self.n_samples)[rows]
        if len(start) < 2 or start.step != 1:
            cure = "Take two or more consecutive rows."
            raise ChannelError(
                f"Record {self.name!r}: {rows} is not a part of its {self.n_samples}"
                " samples",
                cure,
            )
        new = copy.copy(self)
        new.n_samples, new.t0 = (
            len(start),
            self.t0 + (start[0] / self.fs if self.has_clock else 0.0),
        )
        for key in (*MATRICES, *BASES):
            array = getattr(self, key)
            setattr(new, key, None if array is None else array[rows])
        new.covariates = {k: line[rows] for k, line in self.covariates.items()}
        return new

    def replace(self, **changes: Any) -> Record:
        """A copy with some channels replaced.

        Parameters
        ----------
        **changes
            Arguments of :class:`Record`.
        """
        if not changes:
            return copy.copy(self)
        keys = (*MATRICES, *BASES, "fs", "covariates", "name", "coordinates")
        new = Record(
            **{key: getattr(self, key) for key in keys if key != "fs" or self.has_clock}
            | changes
        )
        if changes.get("time") is None:
            new.t0 = self.t0
        return new

    def _repr_html_(self) -> str:
        return str(Hook.RECORD_HTML(self))

    def __repr__(self) -> str:
        rate = (
            f" at {self.fs:g} Hz ({self.n_samples / self.fs:.4g} s)"
            if self.has_clock
            else " without a clock"
        )
        channels = ", ".join(self.measured)
        return (
            f"Record({self.name!r}: {self.n_dof} DOF, {self.n_samples} samples{rate},"
            f" channels {channels})"
        )


@np.errstate(over="ignore")
def _clock(fs: Any, time: Any, n: int, name: str) -> tuple[float, float]:
    """Sampling rate and first time of a record, checked for an even clock."""
    given = number_of(fs)
    if fs is not None and not 0 < given < np.inf:
        raise ChannelError(
            f"Record {name!r}: fs={fs!r} is not a sampling rate",
            "Give a positive number in Hz.",
        )
    if time is None:
        if fs is None:
            raise ChannelError(
                f"Record {name!r} has no clock",
                "Give fs= in Hz, or the time of the samples.",
            )
        return given, 0.0
    seconds = seconds_of(time, name)
    if len(seconds) != n:
        raise ChannelError(
            f"Record {name!r}: {len(seconds)} times for {n} samples",
            "Give one time for each sample.",
        )
    steps = np.diff(seconds)
    bad = np.flatnonzero(steps <= 0)
    if bad.size:
        kind = "stands still" if (steps[bad] == 0).all() else "runs backwards"
        raise ChannelError(
            f"Record {name!r}: the time {kind} after row {int(bad[0])}",
            "Sort the rows and drop repeated ones; if the time is only rounded, leave"
            " it out (t = 'none') and give fs.",
        )
    step = (seconds[-1] - seconds[0]) / (n - 1)
    if not 0 < 1.0 / step < np.inf:
        raise ChannelError(
            f"Record {name!r}: the time runs from {seconds[0]:g} to {seconds[-1]:g} s"
            f" in {n} samples, which is not a time in seconds",
            "Check its unit, and that the column is the time; or leave it out (t ="
            " 'none') and give fs.",
        )
    grid = np.abs(seconds - seconds[0] - step * np.arange(n)).max()
    if grid > 0.05 * step and np.abs(steps - step).max() > 0.05 * step:
        usual = float(np.median(steps))
        worst = int(np.abs(steps - usual).argmax())
        jumps = steps[steps > GAP * usual]
        if (
            jumps.size and steps.min() > 0.75 * usual
        ):  # jitter shortens as many steps as it lengthens
            lost = float((jumps / usual - 1).sum())
            kind = (
                f"{jumps.size} gap{'s' if jumps.size > 1 else ''}, about {lost:.0f}"
                " samples are missing"
            )
            cure = (
                "Split the record at gaps (alignment.split_at_gaps), or resample it to"
                " an even clock."
            )
        else:
            kind = f"jitter, steps of {steps.min():g} to {steps.max():g} s"
            cure = (
                "If the time is only rounded, leave it out (t = 'none') and give"
                f" fs={1 / step:g}; else resample it "
            )
            cure += "to an even clock."
        place = f"{steps[worst]:g} s after row {worst} where {usual:g} s is usual"
        raise ChannelError(
            f"Record {name!r}: the clock is uneven, {place}; {kind}", cure
        )
    rate = rate_of(step)
    if fs is not None and abs(given - rate) > 0.01 * rate:
        raise ChannelError(
            f"Record {name!r}: fs={fs} Hz contradicts the time, which has {rate:g} Hz",
            "Leave one out.",
        )
    return rate, float(seconds[0])


def seconds_of(time: Any, name: str = "record") -> np.ndarray:
    """Times as float seconds."""
    if isinstance(time, (pd.DatetimeIndex, pd.TimedeltaIndex)):
        seconds = ((time - time[0]) / pd.Timedelta(seconds=1)).to_numpy(dtype=float)
    elif (array := plain_times(time)).dtype.kind in "mM":
        seconds = (array - array[0]) / np.timedelta64(1, "ns") * 1e-9
    else:
        seconds = as_matrix(array, ["time"], 1, "time")[:, 0].astype(float)
    if not np.isfinite(seconds).all():
        what = (
            f"Record {name!r}: the time is not finite in row"
            f" {int(np.flatnonzero(~np.isfinite(seconds))[0])}"
        )
        raise ChannelError(what, "Repair it.")
    return seconds


def row_times(time: Any, size: int, pieces: Iterable[tuple[str, slice]]) -> np.ndarray:
    """Times of rows in s, one for each, rising within every named piece."""
    seconds = seconds_of(time, "time")
    if len(seconds) != size:
        raise ChannelError(
            f"time has {len(seconds)} values, X has {size} samples",
            "Give one time for each sample.",
        )
    for name, rows in pieces:
        bad = np.flatnonzero(np.diff(seconds[rows]) <= 0)
        if bad.size:
            cure = (
                "Pass record= ids where several records are stacked; sort the rows of"
                " each; never shuffle them."
            )
            raise ChannelError(
                f"The time of {name} does not increase after row"
                f" {rows.start + int(bad[0])}",
                cure,
            )
    return seconds


def plain_times(time: Any) -> np.ndarray:
    """Times as an array of numbers, ``datetime64`` or ``timedelta64``; times with a
    time zone become UTC.
    """
    array = np.asarray(time)
    if array.dtype == object and array.size and isinstance(array.flat[0], datetime):
        return (
            pd.DatetimeIndex(pd.to_datetime(array.ravel(), utc=True))
            .tz_localize(None)
            .to_numpy()
        )
    return array
