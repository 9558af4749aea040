"""The data of an identification: records fused to one motion each."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import InitVar, dataclass, field, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from ..common.unit_system import UnitSystem, unit_system
from ..exceptions import ChannelError
from ..laws.shape import Motion
from .extent import Extent
from .hold import BAND_LIMITED, band_limited
from .quality import QualityNote, are_rotations
from .record import Record

# Stands for the variance of a channel that does not move.
_NO_VARIANCE = 1e-300
# Arrays of a segment that have one row per sample.
ROW_ARRAYS = ("a", "v", "s", "F", "t", "ag")


class Ends(Protocol):
    """The two DOFs that a law joins; a site of a chain has them."""

    p: int
    q: int
    kind: str


@dataclass(frozen=True, eq=False)
class Segment:
    """One contiguous record with one motion of each DOF; it does not change.

    Arrays have one row per sample, matrices one column per DOF or storey; SI units.

    Parameters
    ----------
    name : str
        Name of the record.
    rows : slice
        Its rows in the arrays that the user passed.
    a : ndarray of shape (n_samples, n_dof)
        Absolute accelerations, m/s^2.
    v, s : ndarray of shape (n_samples, n_dof)
        Inter-storey velocities, m/s, and drifts, m.
    F : ndarray of shape (n_samples, n_dof)
        Forces, N; a column of NaN is unknown.
    t : ndarray of shape (n_samples,), optional
        Time on the clock of the record, s.
    ag : ndarray of shape (n_samples,), optional
        Acceleration of the base, m/s^2.
    covariates : dict of str to ndarray of shape (n_samples,)
        Further measured channels.
    valid : slice
        Rows inside the NaN edges.
    resolved : float, optional
        Frequency up to which the fusion resolves the motion, Hz; None as measured.
    band : (float or None, float or None), optional
        Band of motion and forces, Hz, where a filter was applied.
    weights : ndarray of shape (n_samples,), optional
        Weights of the samples in least squares.
    offsets : ndarray of shape (n_dof,), optional
        Force, N, by which wrong zeros of sensors offset each equation of motion. The
        means of its columns are then left out of all fits.
    noise : dict of str to float
        Noise of the measured motion channels, SI rms, where it is known.
    quality : tuple of QualityNote
        What is known of the channels, the clock and the units.
    simulation_method : str
        The method of :func:`~pysindy_nrf.simulate` that follows the record: Newmark's
        if it was computed by it.
    hold : {"cubic", "linear", "zero"}, optional
        Course of the forces between the samples; None if it is not known.
    before : int
        Rows before the valid ones in which the motion was measured, too: laws with
        memory pass through them.
    known_extent : Extent, optional
        Range of the channels inside the NaN edges, where it was computed before.
    """

    name: str
    rows: slice
    a: np.ndarray
    v: np.ndarray
    s: np.ndarray
    F: np.ndarray
    t: np.ndarray | None = None
    ag: np.ndarray | None = None
    covariates: dict[str, np.ndarray] = field(default_factory=dict)
    valid: slice = field(default_factory=lambda: slice(0, 0))
    resolved: float | None = None
    band: tuple[float | None, float | None] | None = None
    weights: np.ndarray | None = None
    offsets: np.ndarray | None = None
    noise: dict[str, float] = field(default_factory=dict)
    quality: tuple[QualityNote, ...] = ()
    simulation_method: str = "default"
    hold: str | None = None
    before: int = 0
    known_extent: InitVar[Extent | None] = None

    def __post_init__(self, known_extent: Extent | None) -> None:
        if known_extent is not None:
            # fills the cached property; a copy with other arrays computes its own
            vars(self)["extent"] = known_extent

    @property
    def units(self) -> UnitSystem:
        """Units of its channels."""
        return unit_system(are_rotations(self.quality))

    @property
    def n_samples(self) -> int:
        """Number of rows, the NaN edges included."""
        return len(self.s)

    @property
    def n_valid(self) -> int:
        """Number of rows inside the NaN edges."""
        return self.valid.stop - self.valid.start

    @property
    def first_row(self) -> int:
        """First row in which the motion was measured."""
        return self.valid.start - self.before

    @property
    def n_dof(self) -> int:
        """Degrees of freedom."""
        return self.s.shape[1]

    @property
    def dt(self) -> float | None:
        """Sampling step, s; None where the time is not known."""
        if self.t is None or len(self.t) < 2:
            return None
        return float((self.t[-1] - self.t[0]) / (len(self.t) - 1))

    @property
    def step(self) -> float:
        """Sampling step, s; a ChannelError where the time is not known."""
        if self.dt is None:
            raise ChannelError(
                f"The sampling step of {self.name!r} is not known",
                "Pass dt= (s) to the estimator, time= to fit, or X with a time index.",
            )
        return self.dt

    @cached_property
    def extent(self) -> Extent:
        """Range of a_1.., v_1.., s_1.., F_1.. inside the NaN edges."""
        rows = self.valid
        return Extent.of_columns(
            [self.a[rows], self.v[rows], self.s[rows], self.F[rows]]
        )

    @property
    def forced(self) -> tuple[int, ...]:
        """DOFs with a force that is not zero."""
        n = self.n_dof
        dofs = range(1, n + 1)
        return tuple(j for j in dofs if self.extent.moves(3 * n + j - 1))

    @property
    def driving_force(self) -> np.ndarray:
        """Forces, N, that drive the motion about the zeros at which its sensors read.

        They are F less the offsets.
        """
        return self.F if self.offsets is None else self.F - self.offsets

    @property
    def course(self) -> str:
        """Course of the forces between the samples, band-limited if not known."""
        return self.hold or BAND_LIMITED

    @property
    def base_moves(self) -> bool:
        """Whether an acceleration of the base that is not zero was given."""
        return self.ag is not None and bool(self.ag.any())

    @property
    def unknown(self) -> tuple[int, ...]:
        """DOFs whose force is unknown."""
        first = self.F[self.valid.start]
        return tuple((np.flatnonzero(np.isnan(first)) + 1).tolist())

    def motion(self, site: Ends, rows: slice) -> Motion:
        """Motion that a law at a site sees."""
        low, high = site.q, site.p

        a = self.a[rows, high - 1].astype(np.float64)
        if low > 0:
            a -= self.a[rows, low - 1]
        elif self.ag is not None and site.kind != "dof":
            a -= self.ag[rows]

        return Motion(
            s=_over_storeys(self.s[rows, low:high]),
            v=_over_storeys(self.v[rows, low:high]),
            a=a,
            t=None if self.t is None else self.t[rows],
            covariates=_rows_of_each(self.covariates, rows),
        )

    def cut(self, rows: slice, first_row: int) -> Segment:
        """Valid rows as a segment, which begins at a row of all records."""
        n_rows = rows.stop - rows.start
        return replace(
            self,
            a=self.a[rows],
            v=self.v[rows],
            s=self.s[rows],
            F=self.F[rows],
            t=None if self.t is None else self.t[rows],
            ag=None if self.ag is None else self.ag[rows],
            covariates=_rows_of_each(self.covariates, rows),
            rows=slice(first_row, first_row + n_rows),
            valid=slice(0, n_rows),
            before=0,
        )

    def beginning_later(self, n_rows: int) -> Segment:
        """The record without so many of its first valid rows."""
        valid = slice(self.valid.start + n_rows, self.valid.stop)
        return replace(self, valid=valid, before=self.before + n_rows)

    def every(self, step: int) -> Segment:
        """One valid row in so many."""
        if step == 1:
            return self
        rows = slice(self.valid.start, self.valid.stop, step)
        n_rows = len(range(rows.start, rows.stop, step))
        thinned = self.cut(rows, 0)
        valid = slice(0, n_rows)
        return replace(thinned, rows=valid, valid=valid)

    def strongest(self, rows: slice, size: int) -> int:
        """First row of the stretch of ``size`` rows with most energy, among valid rows.

        Every rate and every force counts by its variance.
        """
        power = np.zeros(rows.stop - rows.start)
        with np.errstate(over="ignore", invalid="ignore"):
            for channels in (self.v[self.valid][rows], self.F[self.valid][rows]):
                # forces that are unknown have no power
                known = channels[:, ~np.isnan(channels[0])]
                squares = np.square(known)
                mean = np.einsum("ij->j", known) / len(known)
                variance = np.einsum("ij->j", squares) / len(known) - mean**2
                power += squares @ (1.0 / np.maximum(variance, _NO_VARIANCE))
            energy = np.append(0.0, np.cumsum(power))
        of_stretches = energy[size:] - energy[: len(energy) - size]
        return rows.start + int(np.argmax(of_stretches))

    def with_band_limited_forces(self, hold: str) -> Segment:
        """The record with the band-limited forces that act like those of a course."""
        force = np.array(self.F, dtype=float)
        force[self.valid] = band_limited(force[self.valid], hold)
        return replace(self, F=force, hold=BAND_LIMITED)

    def moved(self, dof: int, **changes: np.ndarray) -> Segment:
        """The record with changes of ``x``, ``v``, ``a`` or ``F`` of one DOF.

        Every change has one value per sample; those of ``x`` and ``v`` are absolute, so
        the storey above changes by the opposite.
        """
        arrays = {"a": self.a, "v": self.v, "s": self.s, "F": self.F}
        for key, change in changes.items():
            name = "s" if key == "x" else key
            values = np.array(arrays[name], dtype=float)
            values[:, dof - 1] += change
            if key in "xv" and dof < self.n_dof:
                values[:, dof] -= change
            arrays[name] = values
        return replace(self, a=arrays["a"], v=arrays["v"], s=arrays["s"], F=arrays["F"])


def _rows_of_each(lines: dict[str, np.ndarray], rows: slice) -> dict[str, np.ndarray]:
    return {name: line[rows] for name, line in lines.items()}


def _over_storeys(columns: np.ndarray) -> np.ndarray:
    """Sum of drifts, or of rates, between the two ends of a site."""
    if columns.shape[1] == 1:
        total = columns[:, 0]
    else:
        total = columns.sum(axis=1, dtype=np.float64)
    return np.ascontiguousarray(total, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Dataset:
    """Records of one structure, fused to one motion each; it does not change.

    Made by :func:`pysindy_nrf.records.input_arrays.as_dataset` from anything that a
    user may pass to ``fit``.

    Parameters
    ----------
    segments : sequence of Segment
    n_samples : int
        Rows that the user passed.
    records : tuple of Record
        What was measured; empty where motions were passed as arrays.
    fuse_apart : callable, optional
        Fuses the records again, each DOF by itself.
    """

    segments: Sequence[Segment]
    n_samples: int
    records: tuple[Record, ...] = ()
    fuse_apart: Callable[[], Dataset] | None = field(
        default=None, repr=False, compare=False
    )

    @property
    def n_dof(self) -> int:
        """Degrees of freedom."""
        return self.segments[0].n_dof

    @property
    def dt(self) -> float | None:
        """Sampling step of the first record, s."""
        return self.segments[0].dt

    @property
    def quality(self) -> tuple[QualityNote, ...]:
        """What is known of the channels, the clocks and the units of all records."""
        return tuple(note for segment in self.segments for note in segment.quality)

    @property
    def rotates(self) -> bool:
        """Whether its channels are angles and torques."""
        # records in which a floor has no sensor are not fused
        of_records = any(record.rotates for record in self.records)
        return of_records or are_rotations(self.quality)

    @property
    def forced(self) -> tuple[int, ...]:
        """DOFs with a force that is not zero, in at least one record."""
        forced: set[int] = set()
        for segment in self.segments:
            forced.update(segment.forced)
        return tuple(sorted(forced))

    @property
    def unknown(self) -> tuple[int, ...]:
        """DOFs whose force is unknown in every record."""
        in_every_record = set(self.segments[0].unknown)
        for segment in self.segments:
            in_every_record &= set(segment.unknown)
        return tuple(sorted(in_every_record))

    @property
    def base_moves(self) -> bool:
        """Whether an acceleration of the base that is not zero was given."""
        return any(segment.base_moves for segment in self.segments)

    @cached_property
    def apart(self) -> Dataset:
        """The same records with each DOF fused by itself.

        The remaining noise is then independent of the motion. Motions that were passed
        as arrays stay as they are.
        """
        return self if self.fuse_apart is None else self.fuse_apart()

    def scatter(self, parts: Sequence[np.ndarray]) -> np.ndarray:
        """Put arrays of the segments' valid rows into the rows that the user passed."""
        out = np.full((self.n_samples, parts[0].shape[1]), np.nan)
        for segment, values in zip(self.segments, parts):
            out[segment.rows][segment.valid] = values
        return out


@dataclass(frozen=True)
class BlockRows:
    """Consecutive valid rows of one record, counted from its first valid one."""

    segment: int
    rows: slice


def half_the_rate(segments: Iterable[Segment]) -> float:
    """Nyquist frequency of the slowest record, Hz; infinite without a clock."""
    step = max((segment.dt or 0.0 for segment in segments), default=0.0)
    return 0.5 / step if step else np.inf


def feature_names(n_dof: int, coordinates: str = "relative") -> list[str]:
    """Columns of X: a1.., v1.., s1.. (paper eq. 8), or a1.., xdot1.., x1.. absolute."""
    rate, drift = ("v", "s") if coordinates == "relative" else ("xdot", "x")
    return numbered("a", n_dof) + numbered(rate, n_dof) + numbered(drift, n_dof)


def numbered(kind: str, n_dof: int) -> list[str]:
    """Names of one kind of channel at every DOF, such as F1, F2, .."""
    return [f"{kind}{j}" for j in range(1, n_dof + 1)]
