"""KinematicSmoother: one motion of each DOF from its measured channels."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TypeAlias, TypeVar

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils.validation import check_is_fitted

from ...exceptions import ChannelError
from ..channels import checked, contiguous
from ..clock import times_of_table
from ..record import Record
from ..zero_phase_filter import MAX_NOISE_SHARE, Band
from .channel_fusion import (
    FusedChannels,
    FusionSettings,
    choose_band,
    fuse_channels,
    known_noise,
    warn_of_lost_motion,
)
from .channel_table import TIME_NAMES, ChannelTable

# Names of channels that an error lists at most.
NAMES_SHOWN = 9

# What may be fused, and what comes out of it.
Measured: TypeAlias = Record | pd.DataFrame | ArrayLike
Fused: TypeAlias = Record | pd.DataFrame | np.ndarray
ChannelOrDof = TypeVar("ChannelOrDof", str, int)


class KinematicSmoother(TransformerMixin, BaseEstimator):
    """Fuse the measured acceleration, velocity and displacement of each DOF into one
    motion.

    The motion is the spline x(t) that minimises

        sum_t (x - x_m)^2 / s_x^2 + (x' - v_m)^2 / s_v^2 + (x'' - a_m)^2 / s_a^2

    over the measured channels; its velocity and acceleration are exact derivatives, and
    fill in what was not measured. Nothing is taken to be periodic. Where noise remains,
    the motions then become their expectation given all channels of all DOFs, with
    spectra learned from the record. Least squares on filtered motions makes masses and
    stiffnesses too low; on such expectations it does not.

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
        :class:`~pysindy_nrf.ZeroPhaseFilter`, and the rows it spoils at the ends become
        NaN (they are masked later). None: forces are left as they are. ``"auto"``: None
        if every DOF has a displacement sensor; else from the lowest frequency at which
        the accelerations still determine the displacement, with a warning that names
        it. Several records fitted together get one band, the part that all of theirs
        share: from the highest of their lower edges up.
    joint : bool
        False leaves the second step out: the noise left is then independent of the
        motion, which instrumental variables need (``NRFRegressor(estimation="iv")``
        does this by itself where it is given records).
    channels : str or sequence of str, optional
        Names of the columns of an array without names: a kind (``"x"``: displacements
        x1, x2, ...), or all names.
    spacing : mapping of int to float, optional
        Distance of the spline's knots by DOF, samples, as ``spacing_`` of a similar
        record; used where all noise levels of a DOF are given. DOFs with knots at every
        sample are searched again. ``joint=False`` halves the distance where
        acceleration is measured.
    noise_share : float
        With ``band="auto"``, noise of an integrated acceleration that may remain, as a
        share of the displacement, where a smaller one would cost the first mode.

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
    band_: Band
    edge_: int
    n_features_in_: int
    feature_names_in_: np.ndarray
    _names_in: list[str]
    _names_out: list[str]

    def __init__(
        self,
        fs: float | None = None,
        noise: str | Mapping[str, float] = "estimate",
        band: Band | str = None,
        joint: bool = True,
        channels: str | Sequence[str] | None = None,
        spacing: Mapping[int, float] | None = None,
        noise_share: float = MAX_NOISE_SHARE,
    ) -> None:
        self.fs = fs
        self.noise = noise
        self.band = band
        self.joint = joint
        self.channels = channels
        self.spacing = spacing
        self.noise_share = noise_share

    def fit(
        self,
        X: Measured,
        y: object = None,
        *,
        record: ArrayLike | None = None,
        time: ArrayLike | None = None,
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
        self._learn_from(X, record, time)
        return self

    def transform(
        self,
        X: Measured,
        *,
        record: ArrayLike | None = None,
        time: ArrayLike | None = None,
    ) -> Fused:
        """Fuse with the noise levels found in :meth:`fit`.

        Returns
        -------
        Record, DataFrame or ndarray
            As given. A table gets ``a, v, x`` of every DOF that has a motion channel,
            then the other columns; leading and trailing NaN rows of a record stay NaN.
        """
        check_is_fitted(self, "noise_")
        if isinstance(X, Record):
            fused = self._fuse_as_fitted(ChannelTable.from_record(X, self.fs))
            return fused.as_record(X)
        if isinstance(X, pd.DataFrame):
            return self._fused_table(X, record, time)
        named = self._named(X, reset=False)
        return self._fused_table(named, record, time).to_numpy()

    def fit_transform(
        self,
        X: Measured,
        y: object = None,
        *,
        record: ArrayLike | None = None,
        time: ArrayLike | None = None,
    ) -> Fused:
        """Find the noise levels as :meth:`fit` does, and fuse.

        Returns
        -------
        Record, DataFrame or ndarray
            As returned by :meth:`transform`.
        """
        fused = self._learn_from(X, record, time)
        if fused is None:
            return self.transform(X, record=record, time=time)
        if isinstance(X, Record):
            return fused.as_record(X)
        if isinstance(X, pd.DataFrame):
            return fused.as_frame(X)
        return fused.as_frame(self._named(X, reset=False)).to_numpy()

    def transform_record(self, record: Record) -> Record:
        """Fuse one record with its own noise levels, or those of ``fit`` if it was
        called.

        Parameters
        ----------
        record : Record
        """
        return self.fuse(record).as_record(record)

    def fuse(self, record: Record) -> FusedChannels:
        """Fuse one record as :meth:`transform_record` does, and say how.

        Parameters
        ----------
        record : Record

        Returns
        -------
        FusedChannels
            The motion with its noise levels, knots and band.
        """
        table = ChannelTable.from_record(record, self.fs)
        if getattr(self, "_levels_of_fit", False):
            return self._fuse_as_fitted(table)
        return self._learn([table])

    def get_feature_names_out(self, input_features: object = None) -> np.ndarray:
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

    @property
    def _settings(self) -> FusionSettings:
        return FusionSettings(
            self.noise, self.band, self.joint, self.spacing, self.noise_share
        )

    def _learn_from(
        self, X: Measured, record: ArrayLike | None, time: ArrayLike | None
    ) -> FusedChannels | None:
        """Fit to a record, a table or an array; the motion if it is one piece."""
        has_names = isinstance(X, (Record, pd.DataFrame))
        if isinstance(X, Record):
            tables = [ChannelTable.from_record(X, self.fs)]
        else:
            table = X if has_names else self._named(X, reset=True)
            pieces = _contiguous_pieces(table, record, time)
            tables = [ChannelTable.from_frame(piece, self.fs) for piece in pieces]

        fused = self._learn(tables)
        if not has_names:
            del self.feature_names_in_
        self._levels_of_fit = True
        return fused if len(tables) == 1 else None

    def _learn(self, tables: Sequence[ChannelTable]) -> FusedChannels:
        """Fuse pieces in one band, each by its own noise levels, and store what they
        have in common; the motion of the last.
        """
        settings = self._settings
        band = choose_band(tables, settings)
        noise: list[dict[str, float]] = []
        spacing: list[dict[int, float]] = []
        high_pass: list[dict[int, float]] = []
        for table in tables:
            known = known_noise(table, settings.noise)
            fused = fuse_channels(table, settings, band, known)
            warn_of_lost_motion(fused)
            noise.append(fused.noise)
            spacing.append(fused.spacing)
            high_pass.append(fused.high_pass)

        self.noise_ = _over_pieces(noise, np.nanmedian, "noise")
        self.spacing_ = _over_pieces(spacing, np.nanmax, "spacing")
        self.high_pass_ = _over_pieces(high_pass, np.nanmax, "high_pass")
        self.band_ = band
        self.edge_ = fused.edge
        self._names_in = table.names
        self._names_out = [name for name in TIME_NAMES if name in table.names]
        self._names_out += list(fused.columns())
        self.n_features_in_ = len(table.names)
        self.feature_names_in_ = np.array(table.names, dtype=object)
        return fused

    def _fused_table(
        self, table: pd.DataFrame, record: ArrayLike | None, time: ArrayLike | None
    ) -> pd.DataFrame:
        """All pieces of a table by the levels and band of fit."""
        fused = []
        for piece in _contiguous_pieces(table, record, time):
            motion = self._fuse_as_fitted(ChannelTable.from_frame(piece, self.fs))
            fused.append(motion.as_frame(piece))
        return pd.concat(fused).set_axis(table.index)

    def _fuse_as_fitted(self, table: ChannelTable) -> FusedChannels:
        if table.names != self._names_in:
            raise ChannelError(
                f"The channels {', '.join(table.names[:NAMES_SHOWN])} are not those of"
                f" fit, {', '.join(self._names_in[:NAMES_SHOWN])}",
                "Fit again, or give the same columns in the same order.",
            )
        levels = {str(name): float(level) for name, level in self.noise_.items()}
        fused = fuse_channels(table, self._settings, self.band_, levels)
        warn_of_lost_motion(fused)
        return fused

    def _named(self, X: ArrayLike, reset: bool) -> pd.DataFrame:
        """An array as a table, its columns named by ``channels``."""
        if self.channels is None:
            raise ChannelError(
                f"KinematicSmoother needs to know the channels, {type(X).__name__} has"
                " no names",
                "Give a Record, a DataFrame with columns a1.., v1.., x1.., or channels="
                " in addition to an array.",
            )
        matrix = checked(self, X, reset=reset)
        width = matrix.shape[1]
        if isinstance(self.channels, str):
            names = [f"{self.channels}{j + 1}" for j in range(width)]
        else:
            names = [str(name) for name in self.channels]
        if len(names) != width:
            raise ChannelError(
                f"{len(names)} channels are named, X has {width} columns",
                "Name each column once.",
            )
        return pd.DataFrame(matrix, columns=names)


def _over_pieces(
    pieces: Sequence[Mapping[ChannelOrDof, float]],
    reduce: Callable[..., np.ndarray],
    name: str,
) -> pd.Series:
    """Values of several pieces by channel or DOF, reduced to one."""
    keys = list(dict.fromkeys(key for values in pieces for key in values))
    table = [[values.get(key, np.nan) for key in keys] for values in pieces]
    return pd.Series(reduce(table, axis=0), index=keys, name=name)


def _contiguous_pieces(
    table: pd.DataFrame, record: ArrayLike | None, time: ArrayLike | None
) -> list[pd.DataFrame]:
    """Parts of a table with one record id each and a clock without gaps."""
    seconds = times_of_table(table, time, record)
    pieces = contiguous(len(table), record, seconds)
    if time is not None:
        table = table.set_axis(pd.Index(seconds, name="t"))
    return [table.iloc[rows] for _, rows in pieces]
