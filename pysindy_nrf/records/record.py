"""Record: the measured channels of one test on one clock."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from ..common import MAX_DOFS
from ..common.unit_system import UnitSystem, unit_system
from ..exceptions import ChannelError
from .channels import as_matrix, channel_of, finite_span
from .clock import clock_of, time_in_index
from .clock import plain_times as plain_times
from .clock import row_times as row_times
from .clock import seconds_of as seconds_of
from .hold import require_hold
from .quality import QualityNote, are_rotations, rotation_note

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..drawing.matplotlib_renderer import Drawing

LARGEST_VALUE = 1e100  # SI units; its square is still a double
# Attributes with one column for each DOF, and the letter of their channels.
MATRICES = {
    "force": "F",
    "acceleration": "a",
    "velocity": "v",
    "displacement": "x",
}
BASES = {"base_acceleration": "ag", "base_velocity": "vg", "base_displacement": "xg"}
ARRAYS = (*MATRICES, *BASES)
OF_LETTER = {letter: key for key, letter in MATRICES.items()}
# A record with so many times more DOFs than samples is an array that lies on its side.
ON_ITS_SIDE = 20
COORDINATES = ("relative", "absolute")


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
    hold : {"cubic", "linear", "zero"}, optional
        Course of forces, base acceleration and covariates between the samples:
        band-limited, as what passes an anti-aliasing filter; straight; or constant, as
        from a D/A converter. If None it is not known: free runs take the channels as
        band-limited, unless the motion follows another course clearly better.

    Attributes
    ----------
    n_dof, n_samples : int
    fs, dt : float
        Sampling rate, Hz, and step, s.
    time : ndarray of shape (n_samples,)
        Seconds, as they were given; from 0 if only a rate was. A window of a record
        keeps its times.
    quality : tuple of QualityNote
        What reading the record has changed: channels that were moved to one clock.

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
        force: ArrayLike | None = None,
        acceleration: ArrayLike | None = None,
        velocity: ArrayLike | None = None,
        displacement: ArrayLike | None = None,
        fs: float | None = None,
        base_acceleration: ArrayLike | None = None,
        base_displacement: ArrayLike | None = None,
        covariates: Mapping[str, ArrayLike] | None = None,
        name: str = "record",
        *,
        base_velocity: ArrayLike | None = None,
        coordinates: str = "relative",
        time: ArrayLike | None = None,
        hold: str | None = None,
    ) -> None:
        require_coordinates(coordinates)
        if hold is not None:
            require_hold(hold)
        self.hold = hold
        self.coordinates = coordinates
        # the name of a file may be no text
        self.name = str(name).encode("utf-8", "backslashreplace").decode()

        matrices = _matrices(
            {
                "acceleration": acceleration,
                "velocity": velocity,
                "displacement": displacement,
                "force": force,
            }
        )
        self.n_dof = _number_of_dofs(matrices, self.name)

        bases = _lines(
            {
                "base acceleration ag": base_acceleration,
                "base velocity vg": base_velocity,
                "base displacement xg": base_displacement,
            }
        )
        others = _covariate_lines(covariates, self.name)
        titled = {f"covariate {key}": line for key, line in others.items()}
        self.n_samples = _number_of_samples(matrices | bases | titled, self.name)
        _require_measured_motion(matrices, self.name)

        quasi_static = matrices.keys() == {"force", "displacement"}
        if quasi_static and fs is None and time is None and not bases | others:
            self.fs, self.t0 = np.nan, 0.0
        else:
            self.fs, self.t0 = clock_of(fs, time, self.n_samples, self.name)

        unforced = np.zeros((self.n_samples, self.n_dof))
        self.force: np.ndarray = matrices.get("force", unforced)
        self.acceleration = matrices.get("acceleration")
        self.velocity = matrices.get("velocity")
        self.displacement = matrices.get("displacement")
        self.base_acceleration = bases.get("base acceleration ag")
        self.base_velocity = bases.get("base velocity vg")
        self.base_displacement = bases.get("base displacement xg")
        self.covariates = others
        self.quality: tuple[QualityNote, ...] = ()
        _require_usable_values(self.channels(), self.name)

    def channels(self) -> dict[str, np.ndarray]:
        """Measured channels by name.

        Returns
        -------
        dict of str to ndarray of shape (n_samples,)
            ``F1..`` (N), ``a1..`` (m/s^2), ``v1..`` (m/s), ``x1..`` (m), ``ag``,
            ``vg``, ``xg`` and covariates; a column of NaN is left out.
        """
        measured = {
            channel: column
            for channel, column in self.dof_channels().items()
            if not (np.isnan(column[0]) and np.isnan(column).all())
        }
        return measured | self.base_channels() | self.covariates

    def dof_channels(self) -> dict[str, np.ndarray]:
        """Forces and motions of the DOFs by name, also those that are NaN throughout.

        Returns
        -------
        dict of str to ndarray of shape (n_samples,)
            ``F1..``, ``a1..``, ``v1..``, ``x1..``
        """
        channels: dict[str, np.ndarray] = {}
        for key, letter in MATRICES.items():
            matrix = getattr(self, key)
            if matrix is not None:
                channels |= {f"{letter}{j}": line for j, line in enumerate(matrix.T, 1)}
        return channels

    def base_channels(self) -> dict[str, np.ndarray]:
        """Motions of the base by name, those that were given.

        Returns
        -------
        dict of str to ndarray of shape (n_samples,)
            ``ag`` (m/s^2), ``vg`` (m/s), ``xg`` (m)
        """
        lines = {channel: getattr(self, key) for key, channel in BASES.items()}
        return {channel: line for channel, line in lines.items() if line is not None}

    @property
    def measured(self) -> tuple[str, ...]:
        """Names of the measured channels."""
        return tuple(self.channels())

    @property
    def has_clock(self) -> bool:
        """False for forces and displacements without a rate."""
        return bool(np.isfinite(self.fs))

    def by_sample(self) -> Record:
        """The record itself, or with 1 Hz if it has no clock.

        Its times are then the numbers of the samples.
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
        acts = np.nan_to_num(self.force).any(axis=0)
        return tuple((np.flatnonzero(acts) + 1).tolist())

    @property
    def unknown(self) -> tuple[int, ...]:
        """DOFs whose force is unknown."""
        unknown = np.isnan(self.force).all(axis=0)
        return tuple((np.flatnonzero(unknown) + 1).tolist())

    @property
    def base_moves(self) -> bool:
        """True if a motion of the base was given."""
        return any(np.nan_to_num(line).any() for line in self.base_channels().values())

    @classmethod
    def from_frame(
        cls,
        df: pd.DataFrame,
        fs: float | None = None,
        *,
        name: str = "record",
        coordinates: str = "relative",
        hold: str | None = None,
    ) -> Record:
        """Record from a table with columns a1.., v1.., x1.., F1.., ag and a time.

        Parameters
        ----------
        df : DataFrame
            Motions of the base are ``ag``, ``vg``, ``xg``. The time is column ``t`` or
            ``time`` (s), or the index if that is a time index or a float index named
            so. Other columns become covariates.
        fs : float, optional
            Sampling rate, Hz, if the table has no time.
        name, coordinates, hold
            As for :class:`Record`.

        Raises
        ------
        ChannelError
            If no column is a motion or a DOF is missing in the numbering.
        """
        columns = _columns_by_name(df)
        clock = next((label for label in ("t", "time") if label in columns), None)
        time = None
        if clock is not None:
            time = columns.pop(clock).to_numpy()
        elif fs is None:
            time = time_in_index(df.index)

        channels = _channels_among(columns)
        covariates = {label: column.to_numpy() for label, column in columns.items()}
        return cls.from_channels(
            channels,
            fs=fs,
            time=time,
            covariates=covariates,
            name=name,
            coordinates=coordinates,
            hold=hold,
        )

    @classmethod
    def from_channels(
        cls,
        channels: Mapping[str, np.ndarray],
        *,
        fs: float | None = None,
        time: ArrayLike | None = None,
        covariates: Mapping[str, ArrayLike] | None = None,
        name: str = "record",
        coordinates: str = "relative",
        hold: str | None = None,
    ) -> Record:
        """Record from channels by name.

        Parameters
        ----------
        channels : mapping of str to array-like of shape (n_samples,)
            ``F1..`` (N), ``a1..`` (m/s^2), ``v1..`` (m/s), ``x1..`` (m), ``ag``,
            ``vg``, ``xg``. A motion that is not among them was not measured, a force
            does not act.
        fs, time, covariates, name, coordinates, hold
            As for :class:`Record`.

        Examples
        --------
        >>> import numpy as np
        >>> from pysindy_nrf import Record
        >>> t = np.arange(1000) / 1000
        >>> Record.from_channels({"x2": np.sin(9 * t)}, fs=1000.0, name="roof")
        Record('roof': 2 DOF, 1000 samples at 1000 Hz (1 s), channels F1, F2, x2)
        """
        arrays = _matrices_of_channels(channels)
        for key, channel in BASES.items():
            if channel in channels:
                arrays[key] = channels[channel]
        return cls(
            **arrays,
            fs=fs,
            time=time,
            covariates=covariates,
            name=name,
            coordinates=coordinates,
            hold=hold,
        )

    def to_frame(self) -> pd.DataFrame:
        """Table of the measured channels, indexed by time ``t`` in s.

        Returns
        -------
        DataFrame
        """
        return pd.DataFrame(self.channels(), index=pd.Index(self.time, name="t"))

    def to_features(self, smooth: bool = True) -> tuple[pd.DataFrame, pd.DataFrame]:
        """Regressor input: accelerations, inter-storey velocities and drifts.

        They are plain tables. A regressor that gets the record itself knows its noise
        and band, too.

        Parameters
        ----------
        smooth : bool
            True: channels are fused and completed by
            :class:`pysindy_nrf.KinematicSmoother`. False: they are taken as they are,
            and each DOF needs all three.

        Returns
        -------
        X : DataFrame of shape (n_samples, 3 n_dof)
            ``a1.., v1.., s1..`` (paper eq. 8); a absolute, v and s relative to the DOF
            below; SI units, index t.
        F : DataFrame of shape (n_samples, n_dof)
            ``F1..``, N.

        Raises
        ------
        ChannelError
            With ``smooth=False``, if a channel is missing.
        """
        from .fusion.kinematics import to_features

        return to_features(self, smooth)

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
        time = self.time + 0.5 * self.dt  # a sample counts from half a step before it
        rows = np.flatnonzero((time >= start) & (time < stop))
        if len(rows) < 2:
            raise ChannelError(
                f"Record {self.name!r} has no samples from {start} to {stop} s",
                f"It lasts from {self.time[0]:g} to {self.time[-1]:g} s.",
            )
        return self.rows(slice(rows[0], rows[-1] + 1))

    def rows(self, rows: slice) -> Record:
        """Part of the record in a slice of rows; see :meth:`window` for times.

        Parameters
        ----------
        rows : slice
            Two or more consecutive rows.

        Raises
        ------
        ChannelError
            If it is another slice.
        """
        numbers = range(self.n_samples)[rows]
        if len(numbers) < 2 or numbers.step != 1:
            raise ChannelError(
                f"Record {self.name!r}: {rows} is not a part of its {self.n_samples}"
                " samples",
                "Take two or more consecutive rows.",
            )

        arrays: dict[str, np.ndarray] = {}
        for key in ARRAYS:
            array = getattr(self, key)
            if array is not None:
                arrays[key] = array[rows]
        covariates = {name: line[rows] for name, line in self.covariates.items()}
        first_time = self.t0 + numbers[0] / self.fs if self.has_clock else self.t0
        return self._with_attributes(
            **arrays, covariates=covariates, n_samples=len(numbers), t0=first_time
        )

    def starting_at(self, t0: float) -> Record:
        """The same channels with another time of the first sample.

        Parameters
        ----------
        t0 : float
            Seconds.
        """
        return self._with_attributes(t0=t0)

    @property
    def rotates(self) -> bool:
        """True if its channels are angles and torques: N m, rad, rad/s, rad/s^2."""
        return are_rotations(self.quality)

    @property
    def units(self) -> UnitSystem:
        """Units of its channels."""
        return unit_system(self.rotates)

    def of_rotations(self) -> Record:
        """The same numbers as angles (rad), their rates, and torques (N m)."""
        if self.rotates:
            return self
        return self.with_quality((*self.quality, rotation_note(self.name)))

    def with_quality(self, notes: Sequence[QualityNote]) -> Record:
        """The same channels with notes on their quality.

        Parameters
        ----------
        notes : sequence of QualityNote
        """
        return self._with_attributes(quality=tuple(notes))

    def _with_attributes(self, **attributes: object) -> Record:
        """A copy with other attributes; its channels are not checked again."""
        out = copy.copy(self)
        vars(out).update(attributes)
        return out

    def replace(self, **changes: Any) -> Record:
        """A copy with some channels replaced.

        Parameters
        ----------
        **changes
            Arguments of :class:`Record`.
        """
        if not changes:
            return copy.copy(self)

        arguments = {key: getattr(self, key) for key in ARRAYS}
        arguments |= {
            "covariates": self.covariates,
            "name": self.name,
            "coordinates": self.coordinates,
            "hold": self.hold,
        }
        if self.has_clock:
            arguments["fs"] = self.fs
        changed = Record(**arguments | changes).with_quality(self.quality)
        if changes.get("time") is None:
            return changed.starting_at(self.t0)
        return changed

    def plot(self, ax: Axes | Sequence[Axes] | np.ndarray | None = None) -> Drawing:
        """Draw every channel over time (matplotlib).

        Channels in doubt are red: those that :func:`~pysindy_nrf.records.channel_notes`
        calls faulty.

        Parameters
        ----------
        ax : sequence of Axes, optional
            One for each channel that moves or acts; new ones if None.

        Returns
        -------
        Drawing
            With ``ax_`` and ``figure_``.

        Raises
        ------
        MissingExtraError
            Without matplotlib, which the extra ``plot`` brings.

        Examples
        --------
        >>> from pysindy_nrf import datasets
        >>> drawn = datasets.load_demo().plot()
        >>> [axes.get_ylabel() for axes in drawn.ax_][:2]
        ['F2 (N)', 'a1 (m/s²)']
        """
        from ..drawing.matplotlib_renderer import Column
        from .checks.channel_checks import doubts_by_channel
        from .figures import time_figures

        return Column(time_figures(self, doubts_by_channel(self))).plot(ax)

    def _repr_html_(self) -> str:
        from .files.summary import record_html

        return record_html(self)

    def __array__(self, *args: object, **kwargs: object) -> np.ndarray:
        """Refused: scikit-learn's searches ask for it where they are given a record."""
        cure = (
            "Pass X, F = record.to_features(), or a list of records: [record, ...], or"
            " the parts of one, [record.window(0, 10), record.window(10, 20)]."
        )
        raise ChannelError("A Record is no array of samples", cure)

    def __repr__(self) -> str:
        if self.has_clock:
            clock = f" at {self.fs:g} Hz ({self.n_samples / self.fs:.4g} s)"
        else:
            clock = " without a clock"
        channels = ", ".join(self.measured)
        return (
            f"Record({self.name!r}: {self.n_dof} DOF, {self.n_samples} samples{clock},"
            f" channels {channels})"
        )


def require_coordinates(coordinates: str) -> None:
    """Refuse a reference of the motion that is neither the base nor a fixed point."""
    if coordinates not in COORDINATES:
        raise ChannelError(
            f"coordinates={coordinates!r} is unknown",
            "Choose 'relative' (to the base) or 'absolute'.",
        )


def _matrices(values: Mapping[str, ArrayLike | None]) -> dict[str, np.ndarray]:
    """What was given of motions and forces, one column for each DOF.

    Columns of tables that are named ``F1``, ``F2``, .. are put in this order.
    """
    present = {key: value for key, value in values.items() if value is not None}
    _require_one_time(present)
    matrices = {}
    for key, value in present.items():
        in_order = _in_order_of_dofs(value, MATRICES[key])
        matrices[key] = as_matrix(in_order, MATRICES[key], what=key)
    return matrices


def _in_order_of_dofs(value: ArrayLike, letter: str) -> ArrayLike:
    """A table with its columns from DOF 1 up, if they are named by DOFs."""
    if not isinstance(value, pd.DataFrame):
        return value
    names = [f"{letter}{j}" for j in range(1, value.shape[1] + 1)]
    return value[names] if set(names) == set(value.columns) else value


def _require_one_time(values: Mapping[str, ArrayLike]) -> None:
    """Refuse tables of equal length whose index holds different times."""
    timed: list[tuple[str, pd.Index]] = []
    for key, value in values.items():
        if isinstance(value, pd.DataFrame):
            if not isinstance(value.index, pd.RangeIndex):
                timed.append((key, value.index))

    for (first, times), (second, others) in pairwise(timed):
        if len(times) == len(others) and not times.equals(others):
            raise ChannelError(
                f"The tables of {first} and {second} have other times in their index",
                "Bring them to one clock (records.checks.alignment.resampled).",
            )


def _lines(values: Mapping[str, ArrayLike | None]) -> dict[str, np.ndarray]:
    """What was given of single channels, of shape (n_samples,)."""
    return {
        title: as_matrix(value, [title], 1, title)[:, 0]
        for title, value in values.items()
        if value is not None
    }


def _covariate_lines(
    covariates: Mapping[str, ArrayLike] | None, name: str
) -> dict[str, np.ndarray]:
    """The covariates, of shape (n_samples,) each."""
    if covariates is None:
        return {}
    if not isinstance(covariates, Mapping):
        raise ChannelError(
            f"Record {name!r}: the covariates are not a mapping",
            "Give channels by name: covariates={'voltage': u}.",
        )

    lines = {}
    for key, value in covariates.items():
        title = f"covariate {key}"
        lines[key] = as_matrix(value, [title], 1, title)[:, 0]
    return lines


def _motions(matrices: Mapping[str, np.ndarray]) -> list[np.ndarray]:
    return [matrix for key, matrix in matrices.items() if key != "force"]


def _number_of_dofs(matrices: Mapping[str, np.ndarray], name: str) -> int:
    """The number of columns, which all matrices of a record share."""
    if not _motions(matrices):
        raise ChannelError(
            f"Record {name!r} has no motion",
            "Give acceleration, velocity or displacement.",
        )

    widths = {key: matrix.shape[1] for key, matrix in matrices.items()}
    if len(set(widths.values())) > 1:
        shown = ", ".join(f"{key} has {width} columns" for key, width in widths.items())
        raise ChannelError(
            f"Record {name!r}: {shown}",
            "Give one column for each DOF everywhere; NaN for a channel that is not"
            " measured.",
        )

    n_dof = next(iter(widths.values()))
    if not 1 <= n_dof <= MAX_DOFS:
        raise ChannelError(
            f"Record {name!r} has {n_dof} DOFs",
            "Give one row per sample and one column per DOF; transpose the arrays?",
        )
    return n_dof


def _number_of_samples(arrays: Mapping[str, np.ndarray], name: str) -> int:
    """The length that all channels of a record share."""
    lengths = {title: len(array) for title, array in arrays.items()}
    if len(set(lengths.values())) > 1:
        shown = ", ".join(f"{title} {length}" for title, length in lengths.items())
        raise ChannelError(
            f"Record {name!r}: channels differ in length, {shown}",
            "Cut or resample them to one clock.",
        )

    n_samples = next(iter(lengths.values()))
    widest = max(np.shape(array)[-1] for array in arrays.values() if array.ndim == 2)
    if widest > ON_ITS_SIDE * n_samples > 0:
        raise ChannelError(
            f"Record {name!r} has {n_samples} samples of {widest} DOFs: its arrays are"
            " transposed",
            "Give one row per sample and one column per DOF (array.T).",
        )
    if n_samples < 2:
        raise ChannelError(
            f"Record {name!r} has {n_samples} samples", "At least two are needed."
        )
    return n_samples


def _require_measured_motion(matrices: Mapping[str, np.ndarray], name: str) -> None:
    """Refuse motions that are NaN throughout."""
    if all(np.isnan(motion).all() for motion in _motions(matrices)):
        raise ChannelError(
            f"Record {name!r} has no motion, every channel is NaN",
            "Give at least one measured channel.",
        )


def _require_usable_values(channels: Mapping[str, np.ndarray], name: str) -> None:
    """Refuse infinities, NaN inside a channel, and values whose squares overflow."""
    finite_span(list(channels.values()), list(channels), f"record {name!r}")
    for channel, line in channels.items():
        largest = float(np.abs(line).max())
        if np.isnan(largest):  # at the edges
            largest = float(np.nanmax(np.abs(line)))
        if largest > LARGEST_VALUE:
            raise ChannelError(
                f"Channel {channel} of record {name!r} reaches {largest:.3g}, whose"
                " square leaves the range of a double",
                "Check its unit.",
            )


def _columns_by_name(df: pd.DataFrame) -> dict[str, pd.Series]:
    """Columns of a table by their names as text, which must differ."""
    if not isinstance(df, pd.DataFrame):
        raise ChannelError(
            f"{type(df).__name__} is not a table",
            "Give a DataFrame with columns a1.., x1.., F1..",
        )

    names = df.columns.map(str)
    repeated = sorted(names[names.duplicated()])
    if repeated:
        raise ChannelError(
            f"Column {repeated[0]!r} is in the table more than once",
            "Rename or drop one.",
        )
    return {name: df.iloc[:, i] for i, name in enumerate(names)}


def _channels_among(columns: dict[str, pd.Series]) -> dict[str, np.ndarray]:
    """The columns that are channels; they are taken out of the others."""
    names = list(columns)
    channels: dict[str, np.ndarray] = {}
    for name in names:
        channel = name if name in BASES.values() else channel_of(name)
        if channel is None or not (channel == name or channel[1:].isdigit()):
            continue
        if channel in channels:
            raise ChannelError(
                f"{name!r} and another column both mean {channel}",
                "Rename or drop one.",
            )
        channels[channel] = columns.pop(name).to_numpy()

    if not any(channel[0] in "avx" and channel[1:].isdigit() for channel in channels):
        raise ChannelError(
            f"No column of {', '.join(names[:10])} is a motion",
            "Name accelerations a1.., velocities v1.., displacements x1.., forces F1..,"
            " base acceleration ag.",
        )
    return channels


def _matrices_of_channels(channels: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Forces and motions with one column for each DOF, the missing ones filled."""
    dofs = [int(channel[1:]) for channel in channels if channel[1:].isdigit()]
    n_dof = max(dofs, default=0)
    if n_dof > MAX_DOFS:
        raise ChannelError(
            f"A column names DOF {n_dof}, more than the {MAX_DOFS} a chain may have",
            "Rename it.",
        )

    matrices = {}
    for key, letter in MATRICES.items():
        names = [f"{letter}{j}" for j in range(1, n_dof + 1)]
        if not channels.keys().isdisjoint(names):
            fill = 0.0 if key == "force" else np.nan
            matrices[key] = _side_by_side(channels, names, fill)
    return matrices


def _side_by_side(
    channels: Mapping[str, np.ndarray], names: Sequence[str], fill: float
) -> np.ndarray:
    """Channels as columns; one that is missing holds the same value throughout."""
    n_samples = len(next(iter(channels.values())))
    missing = np.broadcast_to(fill, n_samples)
    columns = []
    for name in names:
        line = channels.get(name, missing)
        columns.append(as_matrix(line, [name], 1)[:, 0])
    return np.column_stack(columns)
