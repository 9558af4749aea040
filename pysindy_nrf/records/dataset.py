"""Contiguous records: the range of their channels, the region they visit, and the
data set they make.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any, Literal, Protocol

import numpy as np

from ..common.threads import in_threads
from ..exceptions import ChannelError
from ..laws.shape import Motion

_SHARE = 2**20  # numbers that a thread scans at once


@dataclass(frozen=True)
class Extent:
    """Least and largest value of channels, NaN passed over, and which of them are
    finite throughout.
    """

    low: np.ndarray  # +inf for a channel of NaN
    high: np.ndarray  # -inf for a channel of NaN
    finite: np.ndarray

    @classmethod
    def of(cls, matrices: Sequence[np.ndarray]) -> Extent:
        """Extent of the columns of some matrices."""
        low, high, bad = np.zeros((3, sum(matrix.shape[1] for matrix in matrices)))
        low[:], high[:] = np.inf, -np.inf
        for where, (least, most, zero) in in_threads(_scanned, _shares(matrices)):
            low[where], high[where] = (
                np.minimum(low[where], least),
                np.maximum(high[where], most),
            )
            bad[where] += zero
        return cls(low, high, bad == 0.0)

    def merge(self, other: Extent) -> Extent:
        """Extent of both."""
        return Extent(
            np.minimum(self.low, other.low),
            np.maximum(self.high, other.high),
            self.finite & other.finite,
        )

    def moves(self, channel: int) -> bool:
        """Whether a channel holds anything but zeros and NaN."""
        return bool(self.low[channel] < 0.0 or self.high[channel] > 0.0)

    def boxes(self, n_dof: int) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest (v, s) of each storey, shape (n_dof, 2), where the channels
        are a, v, s, F of n DOFs.
        """
        low, high = (
            x[n_dof : 3 * n_dof].reshape(2, n_dof).T.copy()
            for x in (self.low, self.high)
        )
        return low, high

    def is_whole(self, n_needed: int) -> bool:
        """Whether the first channels are finite, and each further one too or nothing
        but NaN.
        """
        empty = (self.low == np.inf) & (self.high == -np.inf)
        return bool(
            self.finite[:n_needed].all() and (self.finite | empty)[n_needed:].all()
        )


def _shares(matrices: Sequence[np.ndarray]) -> Iterator[tuple[slice, np.ndarray]]:
    """Rows of the matrices, and where their columns stand among all."""
    at = 0
    for matrix in matrices:
        where = slice(at, at + matrix.shape[1])
        at = where.stop
        if matrix.size:
            rows = max(_SHARE // matrix.shape[1], 1)
            yield from (
                (where, matrix[start : start + rows])
                for start in range(0, len(matrix), rows)
            )


def _scanned(share: tuple[slice, np.ndarray]) -> tuple[slice, np.ndarray]:
    """Least and largest values and a sum of zeros, or of NaN where something is not
    finite.
    """
    where, matrix = share
    out = np.zeros((3, matrix.shape[1]))
    out[0], out[1] = np.inf, -np.inf
    _scan(matrix.dtype.name, "C" if matrix.flags.c_contiguous else "A")(
        np.asarray(matrix), out
    )
    return where, out


@cache
def _scan(
    kind: str, layout: Literal["C", "A"]
) -> Callable[[np.ndarray, np.ndarray], None]:
    """Compiled pass, row after row; one machine-code version for each type, whoever
    owns the array.
    """
    from numba import from_dtype, types

    from ..common.compiled import jit

    def extent_scan(x, out):
        whole = x.shape[0] - x.shape[0] % 4
        for t in range(0, whole, 4):
            for j in range(x.shape[1]):
                low, high, zero = out[0, j], out[1, j], out[2, j]
                for i in range(4):
                    y = x[t + i, j]
                    low = y if y < low else low
                    high = y if y > high else high
                    zero += y * 0.0
                out[0, j], out[1, j], out[2, j] = low, high, zero
        for t in range(whole, x.shape[0]):
            for j in range(x.shape[1]):
                y = x[t, j]
                out[0, j] = y if y < out[0, j] else out[0, j]
                out[1, j] = y if y > out[1, j] else out[1, j]
                out[2, j] += y * 0.0

    scan = jit(extent_scan)
    given = types.Array(from_dtype(np.dtype(kind)), 2, layout, readonly=True)
    scan.compile((given, types.Array(types.float64, 2, "C")))
    scan.disable_compile()
    return scan


class Ends(Protocol):
    """The two DOFs that a law joins; a site of a chain has them."""

    p: int
    q: int
    kind: str


@dataclass
class Segment:
    """One contiguous record, ready for features; arrays of shape (n_samples, n_dof) or
    (n_samples,).
    """

    name: str
    rows: slice  # in the arrays the user passed
    a: np.ndarray  # absolute acceleration, m/s^2
    v: np.ndarray  # inter-storey velocity, m/s
    s: np.ndarray  # drift, m
    F: np.ndarray  # N
    t: np.ndarray | None = None  # s, as the record counts them
    ag: np.ndarray | None = None  # base acceleration, m/s^2
    covariates: dict[str, np.ndarray] = field(default_factory=dict)
    valid: slice = field(
        default_factory=lambda: slice(0, 0)
    )  # rows inside the NaN edges
    resolved: float | None = (
        None  # Hz, up to which fused motions hold the motion; None as measured
    )
    band: tuple[float | None, float | None] | None = (
        None  # Hz, of motion and forces before they came here
    )
    doubts: tuple[str, ...] = ()  # what looked wrong with the channels, in sentences
    weights: np.ndarray | None = None  # of the samples in the Gram matrices
    noise: dict[str, float] = field(
        default_factory=dict
    )  # of the measured motion channels, SI rms, if known
    _extent: tuple[slice, Extent] | None = field(
        default=None, repr=False, compare=False
    )

    @property
    def n_samples(self) -> int:
        """Rows, the NaN edges included."""
        return len(self.s)

    @property
    def n_valid(self) -> int:
        """Rows inside the NaN edges."""
        return self.valid.stop - self.valid.start

    @property
    def n_dof(self) -> int:
        """Degrees of freedom."""
        return self.s.shape[1]

    @property
    def dt(self) -> float | None:
        """Sampling step, s, if the time is known."""
        return (
            None
            if self.t is None or len(self.t) < 2
            else float((self.t[-1] - self.t[0]) / (len(self.t) - 1))
        )

    @property
    def step(self) -> float:
        """Sampling step, s; a ChannelError where the time is not known."""
        if self.dt is None:
            cure = (
                "Pass dt= (s) to the estimator, time= to fit, or X with a time index."
            )
            raise ChannelError(f"The sampling step of {self.name!r} is not known", cure)
        return self.dt

    def motion(self, site: Ends, rows: slice) -> Motion:
        """Motion that a law at one site sees."""
        low, high = site.q, site.p

        def along(array: np.ndarray) -> np.ndarray:
            part = array[rows, low:high]
            line = (
                part[:, 0] if part.shape[1] == 1 else part.sum(axis=1, dtype=np.float64)
            )
            return np.ascontiguousarray(line, dtype=np.float64)

        a = self.a[rows, high - 1].astype(np.float64)
        if low > 0:
            a -= self.a[rows, low - 1]
        elif self.ag is not None and site.kind != "dof":
            a -= self.ag[rows]
        return Motion(
            along(self.s),
            along(self.v),
            a,
            None if self.t is None else self.t[rows],
            {k: c[rows] for k, c in self.covariates.items()},
        )

    def part(self, rows: slice, at: int) -> Segment:
        """Some valid rows as a segment whose first row is row ``at`` of all."""
        seen = {
            k: y
            for k in ("a", "v", "s", "F", "t", "ag")
            if (y := getattr(self, k)) is not None
        }
        cut: dict[str, Any] = {k: y[rows] for k, y in seen.items()}
        cut["covariates"] = {k: y[rows] for k, y in self.covariates.items()}
        size = rows.stop - rows.start
        return replace(
            self, **cut, rows=slice(at, at + size), valid=slice(0, size), _extent=None
        )

    def strongest(self, rows: slice, size: int) -> int:
        """Where, in some valid rows, the stretch of a length begins that holds most
        energy of rates and forces.
        """
        y = np.nan_to_num(
            np.hstack([part[self.valid][rows] for part in (self.v, self.F)])
        )
        energy = np.cumsum(
            np.append(0.0, (y**2 / np.maximum(y.var(axis=0), 1e-300)).sum(axis=1))
        )
        return rows.start + int(np.argmax(energy[size:] - energy[: len(energy) - size]))

    def moved(self, dof: int, **changes: np.ndarray) -> Segment:
        """The record with changes (n_samples,) of the motion ``x``, ``v``, ``a`` of one
        DOF, or of its force ``F``.
        """
        new: dict[str, Any] = {}
        for key, change in changes.items():
            name = "s" if key == "x" else key
            new[name] = np.array(getattr(self, name), dtype=float)
            new[name][:, dof - 1] += change
            if key in "xv" and dof < self.n_dof:  # the storey above
                new[name][:, dof] -= change
        return replace(self, **new, _extent=None)

    @property
    def extent(self) -> Extent:
        """Least and largest value of a_1.., v_1.., s_1.., F_1.. inside the NaN
        edges.
        """
        if self._extent is None or self._extent[0] != self.valid:
            rows = self.valid
            self._extent = (
                rows,
                Extent.of([self.a[rows], self.v[rows], self.s[rows], self.F[rows]]),
            )
        return self._extent[1]


class Dataset:
    """The records behind one call of ``fit``, ``predict`` or ``score``."""

    def __init__(self, segments: Sequence[Segment], n_samples: int) -> None:
        self.segments = list(segments)
        self.n_samples = n_samples
        self.n_dof = self.segments[0].n_dof

    @property
    def forced(self) -> tuple[int, ...]:
        """DOFs forced in at least one record."""
        return tuple(
            j + 1
            for j in range(self.n_dof)
            if any(seg.extent.moves(3 * self.n_dof + j) for seg in self.segments)
        )

    @property
    def unknown(self) -> tuple[int, ...]:
        """DOFs whose force is unknown in every record."""
        lost = np.all(
            [np.isnan(seg.F[seg.valid.start]) for seg in self.segments], axis=0
        )
        return tuple((np.flatnonzero(lost) + 1).tolist())

    @property
    def base_moves(self) -> bool:
        """Whether the base moves in some record (its acceleration was given)."""
        return any(seg.ag is not None and seg.ag.any() for seg in self.segments)

    @property
    def doubts(self) -> list[str]:
        """What looked wrong with the channels, in sentences; where there are several
        records with the name of each.
        """
        several = len(self.segments) > 1
        said = (
            f"Record {s.name!r}: {text}" if several else text
            for s in self.segments
            for text in s.doubts
        )
        return list(dict.fromkeys(said))

    @property
    def dt(self) -> float | None:
        """Sampling step of the first record, s."""
        return self.segments[0].dt

    def scatter(self, parts: Sequence[np.ndarray]) -> np.ndarray:
        """Put arrays of the segments' valid rows back into the rows the user passed."""
        out = np.full((self.n_samples, parts[0].shape[1]), np.nan)
        for seg, part in zip(self.segments, parts):
            out[seg.rows][seg.valid] = part
        return out


@dataclass(frozen=True)
class BlockRows:
    """Consecutive valid rows of one record."""

    segment: int
    rows: slice  # from the first valid row of the record


def half_the_rate(segments: Iterable[Segment]) -> float:
    """Highest frequency that all of some records can tell, Hz; infinite without a
    clock.
    """
    step = max((seg.dt or 0.0 for seg in segments), default=0.0)
    return 0.5 / step if step else np.inf


def feature_names(n_dof: int, coordinates: str = "relative") -> list[str]:
    """Names of the columns of X: a1.., v1.., s1.. (paper eq. 8), or a1.., xdot1..,
    x1..
    """
    rate, drift = ("v", "s") if coordinates == "relative" else ("xdot", "x")
    return [f"{p}{j}" for p in ("a", rate, drift) for j in range(1, n_dof + 1)]
