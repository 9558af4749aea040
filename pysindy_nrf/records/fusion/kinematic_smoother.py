"""KinematicSmoother: the measured channels of each degree of freedom fused into one
motion.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils.validation import check_is_fitted

from ...exceptions import ChannelError, DataQualityWarning
from ..channels import as_matrix, checked, contiguous, finite_span
from ..record import BASES, MATRICES, Record
from ..zero_phase_filter import (
    SHARE,
    Band,
    ZeroPhaseFilter,
    check_band,
    clock_of,
    lowest_frequency,
)
from .spline_fusion import fuse_all

_FEWEST = 8
_ORDERS = {"x": 0, "v": 1, "a": 2}
_MOTION = re.compile(r"([avx])_?(\d+)")


class _Piece(NamedTuple):
    """One contiguous record as columns: all of them, and those that were measured,
    inside the NaN edges.
    """

    record: Record | None
    table: Any
    size: int
    fs: float
    names: list[str]
    columns: dict[str, np.ndarray]
    live: dict[str, np.ndarray]
    span: slice

    @property
    def absolute(self) -> bool:
        """True for a record whose motions are absolute."""
        return self.record is not None and self.record.coordinates == "absolute"


class KinematicSmoother(TransformerMixin, BaseEstimator):
    """Fuse the measured acceleration, velocity and displacement of each DOF into one
    motion.

    The motion is the spline x(t) that minimises

        sum_t (x - x_m)^2 / s_x^2 + (x' - v_m)^2 / s_v^2 + (x'' - a_m)^2 / s_a^2

    over the measured channels; its velocity and acceleration are exact derivatives, and
    fill in what was not measured. Nothing is taken to be periodic. Where noise remains,
    the motions then become their expectation given all channels of all DOFs, with
    spectra learned from the record itself: least squares on such motions does not find
    masses and stiffnesses too low, as it does on merely filtered ones.

    Parameters
    ----------
    fs : float, optional
        Sampling rate, Hz. A Record brings its own; a table with a time index or column
        ``t`` too.
    noise : "estimate" or mapping
        Noise levels, SI rms: by kind (``{"a": 0.02, "x": 1e-5}``) or by channel
        (``{"a1": ...}``, which goes first). What is not given is estimated from the
        data.
    band : (float, float), optional
        Frequency band, Hz: every channel goes through the same
        :class:`~pysindy_nrf.ZeroPhaseFilter`, and the rows it spoils at the ends become NaN
        (they are masked later). None: forces are left as they are. ``"auto"``: None if
        every DOF has a displacement sensor; else from the lowest frequency at which the
        accelerations still tell the displacement, with a warning that names it. Several
        records fitted together get one band, the part that all of theirs share: from
        the highest of their lower edges up.
    joint : bool
        False leaves the second step out: the noise left is then independent of the
        motion, which instrumental variables need (``NRFRegressor(estimation="iv")``
        does this by itself where it is given records).
    channels : str or sequence of str, optional
        Names of the columns of an array without names: a kind (``"x"``: displacements
        x1, x2, ...), or all names.

    Attributes
    ----------
    noise_ : Series
        Noise level of each measured motion channel, SI rms.
    spacing_ : Series
        Distance of the spline's knots by DOF, samples: the time resolution the data
        support; of several records, the coarsest.
    high_pass_ : Series
        Frequency, Hz, by DOF, at which half of the motion is lost because displacement
        was not measured (``1 / (1 + (f_c/f)^4)``, zero phase); 0 where displacement was
        measured. Of several records, the highest.
    band_ : tuple or None
        The band applied, Hz.
    edge_ : int
        Rows made NaN at each end (0 without ``band``).
    n_features_in_, feature_names_in_ : int, ndarray of str

    Notes
    -----
    Accelerations are absolute, velocities and displacements relative to the base, whose
    acceleration (``ag``, or derived from ``xg``, ``vg``) is subtracted before the
    fusion and added again. For absolute displacements transform a Record with
    ``coordinates="absolute"``. Without a displacement sensor, content below
    ``high_pass_`` is lost from a, v and x of that DOF; with ``band=(lo, hi)`` the
    corner is ``lo / 8`` and force and response lose the same.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from pysindy_nrf import KinematicSmoother
    >>> rng = np.random.default_rng(0)
    >>> t = np.arange(4000) / 500
    >>> x, a = np.sin(20 * t), -400 * np.sin(20 * t)
    >>> measured = pd.DataFrame(
    ...     {
    ...         "a1": a + 5 * rng.normal(size=4000),
    ...         "x1": x + 0.02 * rng.normal(size=4000),
    ...     }
    ... )
    >>> fused = KinematicSmoother(fs=500.0).fit_transform(measured)
    >>> (
    ...     list(fused.columns),
    ...     bool(np.std(fused["v1"] - 20 * np.cos(20 * t)) < 0.1),
    ... )
    (['a1', 'v1', 'x1'], True)
    """

    noise_: pd.Series
    spacing_: pd.Series
    high_pass_: pd.Series
    feature_names_in_: np.ndarray
    _names_in: list[str]
    _names_out: list[str]
    _kept: list[Any] | None = (
        None  # motions of the DOFs of one record, fused one by one
    )
    _like: dict[int, float | None] | None = (
        None  # distances of the knots of a like record, samples
    )
    _knots: dict[
        int, float | None
    ]  # those found; None at every sample: channels may be clean
    # of the displacement that noise may be where accelerations alone are measured
    _share: float = SHARE

    def __init__(
        self,
        fs: float | None = None,
        noise: Any = "estimate",
        band: Band | str = None,
        joint: bool = True,
        channels: Any = None,
    ) -> None:
        self.fs, self.noise, self.band, self.joint, self.channels = (
            fs,
            noise,
            band,
            joint,
            channels,
        )

    def fit(
        self, X: Any, y: Any = None, *, record: Any = None, time: Any = None
    ) -> KinematicSmoother:
        """Find the noise levels of the channels.

        Parameters
        ----------
        X : Record, DataFrame or array-like of shape (n_samples, n_channels)
            Columns ``a1.., v1.., x1..`` and, if any, ``ag, vg, xg``, ``F1..``, ``t``
            and others; an array needs ``channels``.
        y : ignored
        record : array-like of shape (n_samples,), optional
            Record ids; each record is fused by itself, all in one band, with the median
            of their noise levels.
        time : array-like of shape (n_samples,), optional
            s. Where it jumps, a new piece begins.

        Raises
        ------
        ChannelError
            If no column is a motion, a channel holds NaN within the record or
            infinities, the sampling rate is unknown, or a noise level is not positive.
        """
        self._run_pieces(X, True, record, time)
        self._levels_of_fit = True
        return self

    def transform(self, X: Any, *, record: Any = None, time: Any = None) -> Any:
        """Fuse with the noise levels found in :meth:`fit`.

        Returns
        -------
        Record, DataFrame or ndarray
            As given. A table gets ``a, v, x`` of every DOF that has a motion channel,
            then the other columns; leading and trailing NaN rows of a record stay NaN.
        """
        check_is_fitted(self, "noise_")
        return self._run_pieces(X, False, record, time)

    def fit_transform(
        self, X: Any, y: Any = None, *, record: Any = None, time: Any = None
    ) -> Any:
        """Find the noise levels as :meth:`fit` does, and fuse.

        Returns
        -------
        DataFrame or Record
            As of :meth:`transform`.
        """
        out = self._run_pieces(X, True, record, time)
        self._levels_of_fit = True
        return out if out is not None else self.transform(X, record=record, time=time)

    def transform_record(self, record: Record) -> Record:
        """Fuse one record with its own noise levels, or those of ``fit`` if it was
        called.

        Parameters
        ----------
        record : Record
        """
        return self._run(record, learn=not getattr(self, "_levels_of_fit", False))

    def get_feature_names_out(self, input_features: Any = None) -> np.ndarray:
        """Names of the columns that ``transform`` gives.

        Parameters
        ----------
        input_features : ignored

        Returns
        -------
        ndarray of str
        """
        check_is_fitted(self, "noise_")
        return np.array(self._names_out, dtype=object)

    def _run_pieces(self, X: Any, learn: bool, record: Any, time: Any) -> Any:
        """Each contiguous piece by itself; None after learning from several."""
        if isinstance(X, Record):
            return self._run(X, learn)
        if not isinstance(X, pd.DataFrame):
            out = self._run_pieces(self._named(X, learn), learn, record, time)
            if learn and hasattr(self, "feature_names_in_"):
                del self.feature_names_in_
            return None if out is None else out.to_numpy()
        seconds = clock_of(X, time, len(X), record)
        pieces = contiguous(len(X), record, seconds)
        table = X if time is None else X.set_axis(pd.Index(seconds, name="t"))
        if len(pieces) == 1:
            out = self._run(table, learn)
            return out if time is None else out.set_axis(X.index)
        if learn:
            self._learn_together(
                [self._piece(table.iloc[rows], True) for _, rows in pieces]
            )
            return None
        return pd.concat(
            [self._run(table.iloc[rows], False) for _, rows in pieces]
        ).set_axis(X.index)

    def _learn_together(self, pieces: list[_Piece]) -> None:
        """One band for all pieces, and what they know of noise, resolution and
        high-pass between them.
        """
        self.band_ = self._chosen_band(pieces)
        found = []
        for piece in pieces:
            self._fused(piece, True)
            found.append((self.noise_, self.spacing_, self.high_pass_))
        noise, spacing, high_pass = (
            pd.concat(lines, axis=1) for lines in zip(*found, strict=True)
        )
        self.noise_ = noise.median(axis=1).rename("noise")
        self.spacing_ = spacing.max(axis=1).rename("spacing")
        self.high_pass_ = high_pass.max(axis=1).rename("high_pass")

    def _named(self, X: Any, learn: bool) -> pd.DataFrame:
        if self.channels is None:
            cure = (
                "Give a Record, a DataFrame with columns a1.., v1.., x1.., or channels="
                " beside an array."
            )
            raise ChannelError(
                f"KinematicSmoother needs to know the channels, {type(X).__name__} has"
                " no names",
                cure,
            )
        matrix = checked(self, X, reset=learn)
        width = matrix.shape[1]
        whole = isinstance(self.channels, str)  # a kind
        names = (
            [f"{self.channels}{j + 1}" for j in range(width)]
            if whole
            else [str(c) for c in self.channels]
        )
        if len(names) != width:
            raise ChannelError(
                f"{len(names)} channels are named, X has {width} columns",
                "Name each column once.",
            )
        return pd.DataFrame(matrix, columns=names)

    def _run(self, X: Any, learn: bool) -> Any:
        piece = self._piece(X, learn)
        if learn:
            self.band_ = self._chosen_band([piece])
        return self._fused(piece, learn)

    def _piece(self, X: Any, learn: bool) -> _Piece:
        """One contiguous record as columns."""
        record = X if isinstance(X, Record) else None
        held = (
            X.channels()
            if isinstance(X, Record)
            else {str(c): X.iloc[:, i] for i, c in enumerate(X.columns)}
        )
        size = len(X) if record is None else record.n_samples
        if size == 0:
            raise ChannelError("X has no samples (0 rows)", "Give a record.")
        fs = self._rate(record, X)
        names = list(held)
        if not learn and names != self._names_in:
            what = (
                f"The channels {', '.join(names[:9])} are not those of fit,"
                f" {', '.join(self._names_in[:9])}"
            )
            raise ChannelError(
                what, "Fit again, or give the same columns in the same order."
            )
        columns = {
            n: np.asarray(as_matrix(y, [n], 1)[:, 0], float)
            for n, y in held.items()
            if n not in ("t", "time")
        }
        live = {
            n: y
            for n, y in columns.items()
            if not (np.isnan(y[0]) and np.isnan(y).all())
        }
        span = finite_span(
            list(live.values()),
            list(live),
            f"record {record.name!r}" if record is not None else "",
        )
        return _Piece(
            record,
            X,
            size,
            fs,
            names,
            columns,
            {n: y[span] for n, y in live.items()},
            span,
        )

    def _fused(self, piece: _Piece, learn: bool) -> Any:
        record, table, size, fs, names, columns, live, span = piece
        out = self._fuse(piece, learn)
        if self.band_ is not None:
            out = self._limit(out, fs, learn)
        for n, y in list(out.items()) if span != slice(0, size) else ():
            out[n] = np.full(size, np.nan)
            out[n][span] = y
        out |= {n: y for n, y in columns.items() if n not in live and n not in out}
        if learn:
            self.n_features_in_, self.feature_names_in_ = (
                len(names),
                np.array(names, dtype=object),
            )
            self._names_in = names
            self._names_out = [n for n in ("t", "time") if n in names] + list(out)
        if record is not None:
            nothing, dofs = (
                np.full(record.n_samples, np.nan),
                range(1, record.n_dof + 1),
            )
            parts: dict[str, Any] = {
                key: np.array([out.pop(f"{letter}{j}", nothing) for j in dofs]).T
                for key, letter in MATRICES.items()
            }
            parts |= {key: out.get(short) for key, short in BASES.items()}
            return record.replace(
                **parts, covariates={k: out[k] for k in record.covariates}
            )
        clock = {n: table[n].to_numpy() for n in ("t", "time") if n in names}
        return pd.DataFrame(clock | out, index=table.index)

    def _fuse(self, piece: _Piece, learn: bool) -> dict[str, np.ndarray]:
        """Fused motion columns, and the other columns."""
        live, fs = piece.live, piece.fs
        motion = {(m[1], int(m[2])): n for n in live if (m := _MOTION.fullmatch(n))}
        if not motion:
            cure = "Name accelerations a1.., velocities v1.., displacements x1..."
            raise ChannelError(
                f"No channel of {', '.join(list(live)[:9]) or 'the table'} is a motion",
                cure,
            )
        dofs = sorted({j for _, j in motion})
        n = len(next(iter(live.values())))
        if n < _FEWEST:
            raise ChannelError(
                f"{n} samples are too few to fuse",
                "Give a longer record, or use smooth=False.",
            )
        lo, _ = check_band(self.band_, fs)
        corner = None if lo is None else lo / 8 / fs
        base = np.zeros(n) if piece.absolute else derived_base(live, fs)
        still, units = not base.any(), {"x": 1.0, "v": 1.0 / fs, "a": 1.0 / fs**2}
        every, levels = [], np.full((len(dofs), 3), np.nan)
        for row, j in enumerate(dofs):
            views: list[np.ndarray | None] = [None, None, None]
            for kind, order in _ORDERS.items():
                if (name := motion.get((kind, j))) is not None:
                    views[order] = (
                        live[name] if kind != "a" or still else live[name] - base
                    )
                    level = (
                        self._level(kind, name)
                        if learn
                        else self.noise_.get(name, np.nan)
                    )
                    levels[row, order] = level * units[kind]
            _require_moving(j, {n: live[n] for (_, i), n in motion.items() if i == j})
            every.append(views)
        noise, spacing, high_pass, a, v, x = {}, {}, {}, {}, {}, {}
        knots = self._like and [self._like[j] for j in dofs]
        found = fuse_all(
            every, levels, corner, self.joint, self._kept, knots, list(units.values())
        )
        for j in dofs:
            best = found.pop(0)  # long motions are not held twice
            x[f"x{j}"], v[f"v{j}"], a[f"a{j}"] = (
                best.motion[0],
                best.motion[1] * fs,
                best.motion[2] * fs**2 + base,
            )
            spacing[j], high_pass[j] = best.spacing, best.high_pass * fs
            for kind, order in _ORDERS.items():
                if (kind, j) in motion:
                    noise[motion[kind, j]] = best.noise[order] / units[kind]
        if learn:
            self._knots = {j: h if h > 1.0 else None for j, h in spacing.items()}
            self.noise_ = pd.Series(
                {n: noise[n] for n in live if n in noise}, name="noise"
            )
            self.spacing_ = pd.Series(spacing, name="spacing")
            self.high_pass_ = pd.Series(high_pass, name="high_pass")
        lost = [j for j in dofs if high_pass[j] > 0]
        if lost and self.band_ is None:
            warnings.warn(
                f"DOF {', '.join(map(str, lost))}: no displacement is measured, so"
                f" motion below about {2 * max(high_pass[j] for j in lost):.3g} Hz is"
                " lost while the force keeps it. Give band=(lo, hi) above that, so"
                " that force and response are treated alike.",
                DataQualityWarning,
                stacklevel=6,
            )
        return a | v | x | {n: y for n, y in live.items() if n not in motion.values()}

    def _chosen_band(self, pieces: list[_Piece]) -> Band:
        """The band that was given, or the one that all pieces support."""
        if not isinstance(self.band, str):
            return self.band
        if self.band != "auto":
            raise ChannelError(
                f"band={self.band!r} is unknown", "Give (lo, hi) in Hz, None or 'auto'."
            )
        blind: set[int] = set()
        edges: list[float] = []
        for piece in pieces:
            motion = {
                (m[1], int(m[2])) for n in piece.live if (m := _MOTION.fullmatch(n))
            }
            dofs = {j for _, j in motion} - {j for kind, j in motion if kind in "xv"}
            if not dofs:
                continue
            base = 0.0 if piece.absolute else derived_base(piece.live, piece.fs)
            alone = np.column_stack([piece.live[f"a{j}"] - base for j in sorted(dofs)])
            lo = lowest_frequency(alone, piece.fs, self._share)
            if lo is not None:
                blind, edges = blind | dofs, [*edges, lo]
        if not edges:
            return None
        lo = max(edges)
        warnings.warn(
            f"DOF {', '.join(map(str, sorted(blind)))}: only the acceleration is"
            f" measured, which tells the displacement above about {lo:.3g} Hz. Force"
            " and response are taken from there up; give band=(lo, hi) to choose"
            " yourself.",
            DataQualityWarning,
            stacklevel=5,
        )
        return (lo, None)

    def _level(self, kind: str, name: str) -> float:
        if isinstance(self.noise, str) and self.noise == "estimate":
            return np.nan
        if not isinstance(self.noise, Mapping):
            cure = "Give 'estimate' or levels like {'a': 0.02, 'x': 1e-5}."
            raise ChannelError(f"noise={self.noise!r} is unknown", cure)
        unknown = [
            k for k in self.noise if k not in _ORDERS and not _MOTION.fullmatch(str(k))
        ]
        if unknown:
            cure = "Use 'a', 'v', 'x' or channel names like 'a1'."
            raise ChannelError(f"noise has an unknown key {unknown[0]!r}", cure)
        value = self.noise.get(name, self.noise.get(kind))
        if value is None:
            return np.nan
        if not np.isfinite(value) or value <= 0:
            cure = "Give its rms in SI units."
            raise ChannelError(
                f"The noise level {value!r} of channel {name} is not positive", cure
            )
        return float(value)

    def _rate(self, record: Record | None, table: Any) -> float:
        rate = self.fs if record is None else record.fs
        if record is None:
            column = next(
                (table[n].to_numpy() for n in ("t", "time") if n in table), None
            )
            seconds = clock_of(table, column, len(table))
            if seconds is not None:
                rate = Record(displacement=np.zeros(len(table)), time=seconds).fs
        if rate is None:
            cure = (
                "Give KinematicSmoother(fs=...) in Hz, or a table with a time column t."
            )
            raise ChannelError("The sampling rate is unknown", cure)
        if self.fs is not None and abs(float(self.fs) - rate) > 0.01 * rate:
            raise ChannelError(
                f"fs={self.fs} Hz contradicts the clock of the data, {rate:g} Hz",
                "Leave fs out.",
            )
        check_band(None, rate)
        return float(rate)

    def _limit(
        self, columns: dict[str, np.ndarray], fs: float, learn: bool
    ) -> dict[str, np.ndarray]:
        operator = ZeroPhaseFilter(self.band_, fs)
        if learn:
            self.edge_ = operator.edge
        n = len(next(iter(columns.values())))
        if n <= 2 * operator.edge:
            what = (
                f"The record has {n} samples, the filter {self.band_} Hz spoils"
                f" {operator.edge} at each end"
            )
            cure = (
                "Raise the lower band edge, give a longer record, or filter with"
                " ZeroPhaseFilter and keep the ends."
            )
            raise ChannelError(what, cure)
        limited = operator.apply(np.column_stack(list(columns.values())))
        limited[: operator.edge] = np.nan
        limited[n - operator.edge :] = np.nan
        return dict(zip(columns, limited.T))


def _require_moving(dof: int, channels: Mapping[str, np.ndarray]) -> None:
    """Raise an error for constant channels, which would pass for perfect ones; a DOF of
    zeros is at standstill.
    """
    if not any(y.any() for y in channels.values()):
        return
    ends = {name: (y.min(), y.max()) for name, y in channels.items()}
    dead = [name for name, (lo, hi) in ends.items() if hi - lo <= 1e-12 * max(-lo, hi)]
    if dead:
        cure = (
            "A dead sensor, or a record without motion; leave the channel out (a column"
            " of NaN), or excite the "
        )
        raise ChannelError(
            f"Channel {dead[0]} of DOF {dof} is constant", f"{cure}structure."
        )


def derived_base(live: Mapping[str, np.ndarray], fs: float) -> np.ndarray:
    """Acceleration of the base: measured, or derived from its velocity or displacement;
    else zero.
    """
    if "ag" in live:
        return live["ag"]
    if "vg" not in live and "xg" not in live:
        return np.zeros(len(next(iter(live.values()))))
    views = [live.get("xg"), live["vg"] / fs if "vg" in live else None, None]
    return fuse_all([views], np.full((1, 3), np.nan))[0].motion[2] * fs**2
