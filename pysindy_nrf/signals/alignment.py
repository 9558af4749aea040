r"""Channels that are late, inverted, wrongly scaled, or on clocks of their own.

Acceleration, velocity and displacement of one DOF are one motion; where they do not fit, the transfer
between them says why: its phase is a delay (straight in frequency) or an inversion (pi), its size a gain,

.. math:: \frac{X_c(f)}{X_r(f)} (2 \pi i f)^{k} = g \, e^{-2 \pi i f \tau} .
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from ..data.channels import as_matrix
from ..data.record import Record, seconds_of
from ..exceptions import ChannelError
from ..laws.sensor import shifted
from .channel_transfer import DELAY, GAIN, NAMES, ORDER, against

if TYPE_CHECKING:
    pass

__all__ = [
    "align",
    "channel_alignment",
    "displacement_from_drifts",
    "resampled",
    "shifted",
    "split_at_gaps",
]


def channel_alignment(
    record: Record,
    band: tuple[float, float] | None = None,
    reference: str = "a",
    runs: Sequence[slice] | None = None,
) -> pd.DataFrame:
    """Delay, gain and sign of each motion channel against another channel of the same DOF.

    Parameters
    ----------
    record : Record
    band : (float, float), optional
        Hz; by default wherever the two channels are coherent.
    reference : {"a", "v", "x"}
        Kind taken as right; where a DOF lacks it the first that it has of a, v, x.
    runs : sequence of slice, optional
        Rows that are looked at; all if None.

    Returns
    -------
    DataFrame
        By channel: ``reference``, ``delay`` (s, positive = late), ``samples``, ``gain``, ``scatter`` (of the
        gain: how far it differs with frequency, and what noise may have made of it, as a share; infinite where too
        few lines tell), ``sign`` (+1 or -1), ``coherence``, ``aligned`` (bool) and ``message``.

    Raises
    ------
    ChannelError
        If no DOF has two kinds of channels.

    Examples
    --------
    >>> from pysindy_nrf import ChainModel, excitation, laws, simulate
    >>> from pysindy_nrf.signals.alignment import channel_alignment, shifted
    >>> model = ChainModel([10.0], {"storey 1": laws.PowerSeries(1, [100.0, 1e5])})
    >>> F = excitation.band_limited_random(1, 8.0, 1000.0, dofs=1, rms=100.0, band=(1, 60), random_state=0)
    >>> rec = simulate(model, F, 1e-3)
    >>> late = -shifted(rec.displacement[:, 0], 1.5)
    >>> found = channel_alignment(rec.replace(displacement=late))
    >>> found.loc["x1", ["samples", "sign"]].astype(float).round(1).tolist()
    [1.5, -1.0]
    """
    if reference not in ORDER:
        raise ChannelError(f"reference={reference!r} is unknown", "Choose 'a', 'v' or 'x'.")
    channels = record.channels()
    base = _base(record, channels)
    rows = {}
    for j in range(1, record.n_dof + 1):
        own = {k: channels[f"{k}{j}"] for k in "avx" if f"{k}{j}" in channels}
        if len(own) < 2:
            continue
        first = reference if reference in own else next(iter(own))
        for kind, values in own.items():
            if kind != first:
                rows[f"{kind}{j}"] = against(record, base, (first, own[first]), (kind, values), j, band, runs)
    if not rows:
        raise ChannelError(
            f"No DOF of record {record.name!r} has two kinds of motion channels",
            "Delays between DOFs show in the balances only.",
        )
    columns = ["reference", "delay", "samples", "gain", "scatter", "sign", "coherence", "aligned", "message"]
    return pd.DataFrame.from_dict(rows, orient="index", columns=columns).rename_axis("channel")


def align(record: Record, found: pd.DataFrame, gains: bool = False) -> Record:
    """Shift and turn channels as found by :func:`channel_alignment`.

    Parameters
    ----------
    record : Record
    found : DataFrame
        Rows may be dropped or changed before.
    gains : bool
        Correct gains too; a gain says that one of two channels is wrong, not which.

    Returns
    -------
    Record
        A new one; rows at the ends that a shift leaves empty are NaN in that channel.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf import Record
    >>> from pysindy_nrf.signals.alignment import align, channel_alignment
    >>> t = np.arange(8000) / 500
    >>> x = sum(np.sin(w * t + w**2) / w**2 for w in np.arange(9.0, 120.0, 1.3))
    >>> a = np.gradient(np.gradient(x, t), t)
    >>> rec = Record(acceleration=a, displacement=-x, fs=500.0)  # the laser counts the other way
    >>> mended = align(rec, channel_alignment(rec))
    >>> bool(np.nanmax(abs(mended.displacement[50:-50, 0] - x[50:-50])) < 0.01 * x.max())
    True
    """
    changes: dict[str, np.ndarray] = {}
    for name, row in found.iterrows():
        if row["aligned"] or not np.isfinite(row["sign"]):  # an incoherent channel tells nothing to correct
            continue
        key, j = NAMES[str(name)[0]], int(str(name)[1:]) - 1
        array = changes.setdefault(key, np.array(getattr(record, key), dtype=float))
        factor = row["sign"] / (row["gain"] if gains and abs(row["gain"] - 1) > GAIN else 1.0)
        late = row["samples"] if abs(row["samples"]) > DELAY else 0.0
        array[:, j] = factor * (shifted(array[:, j], -late) if late else array[:, j])
    return record.replace(**changes)


def resampled(
    channels: Mapping[str, Any], rates: Mapping[str, float], fs: float | None = None, **options: Any
) -> Record:
    """One record from channels that were sampled at different rates.

    Parameters
    ----------
    channels : mapping of str to array-like
        By name (``a1``, ``x2``, ``F3``, ``ag``, ...); all start at the same instant.
    rates : mapping of str to float
        Hz, by channel or by kind (``{"a": 1000.0, "x1": 500.0}``).
    fs : float, optional
        Rate wanted, Hz; the lowest of the rates if None.
    **options
        For :meth:`Record.from_frame`.

    Returns
    -------
    Record
        Resampled with :func:`scipy.signal.resample_poly` (its anti-aliasing filter has no delay), cut to
        the shortest channel.

    Raises
    ------
    ChannelError
        If the rate of a channel is not given, or a rate and the one wanted have no simple ratio.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf.signals.alignment import resampled
    >>> slow, fast = np.arange(1000) / 250, np.arange(4000) / 1000
    >>> rec = resampled({"x1": np.sin(9 * slow), "a1": -81 * np.sin(9 * fast)}, {"x1": 250.0, "a1": 1000.0})
    >>> rec.fs, rec.n_samples
    (250.0, 1000)
    >>> bool(np.abs(rec.acceleration + 81 * rec.displacement)[50:-50].max() < 0.2)
    True
    """
    from fractions import Fraction

    from scipy.signal import resample_poly

    own = {n: float(rates.get(n, rates.get(n.rstrip("0123456789"), np.nan))) for n in channels}
    lost = [n for n, r in own.items() if not np.isfinite(r) or r <= 0]
    if lost:
        raise ChannelError(f"The sampling rate of channel {lost[0]} is unknown", "Give it in rates={...}, in Hz.")
    wanted = float(fs or min(own.values()))
    out = {}
    for name, values in channels.items():
        line = as_matrix(values, [name], 1)[:, 0].astype(float)
        ratio = Fraction(wanted / own[name]).limit_denominator(1000)
        if abs(float(ratio) * own[name] / wanted - 1) > 1e-6:
            raise ChannelError(
                f"{own[name]:g} Hz of channel {name} and {wanted:g} Hz have no simple ratio", "Give another fs."
            )
        out[name] = line if ratio == 1 else resample_poly(line, ratio.numerator, ratio.denominator, padtype="line")
    n = min(map(len, out.values()))
    return Record.from_frame(pd.DataFrame({k: y[:n] for k, y in out.items()}), fs=wanted, **options)


def split_at_gaps(table: pd.DataFrame, fs: float | None = None, shortest: int = 100, **options: Any) -> list[Record]:
    """Records from a table whose clock has gaps, or whose channels have NaN inside.

    Parameters
    ----------
    table : DataFrame
        As for :meth:`Record.from_frame`, with a time.
    fs : float, optional
        Hz; from the usual step if None.
    shortest : int
        Pieces with fewer samples are left out.
    **options
        For :meth:`Record.from_frame`.

    Returns
    -------
    list of Record

    Raises
    ------
    ChannelError
        If no piece without a gap has ``shortest`` samples, the clock is not finite, or
        :meth:`Record.from_frame` cannot take the channels.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from pysindy_nrf.signals.alignment import split_at_gaps
    >>> t = np.delete(np.arange(1000) / 100, slice(400, 500))  # the logger paused for a second
    >>> table = pd.DataFrame({"t": t, "x1": np.sin(9 * t)})
    >>> [(rec.n_samples, round(rec.fs, 6)) for rec in split_at_gaps(table)]
    [(400, 100.0), (500, 100.0)]
    """
    key = next((k for k in ("t", "time") if k in table), None)
    time = seconds_of(table[key].to_numpy() if key else table.index)
    steps = np.diff(time)
    usual = 1.0 / fs if fs else float(np.median(steps))
    body = table.drop(columns=[key]) if key else table
    measured = body.loc[:, body.notna().any()]
    good = measured.notna().all(axis=1).to_numpy()
    breaks = np.flatnonzero((steps > 1.5 * usual) | (steps <= 0) | (good[1:] != good[:-1])) + 1
    name = options.pop("name", "record")
    out: list[Record] = []
    for rows in np.split(np.arange(len(table)), breaks):
        if good[rows[0]] and len(rows) >= shortest:
            out.append(
                Record.from_frame(
                    body.iloc[rows].reset_index(drop=True),
                    fs=1.0 / usual,
                    name=f"{name}, part {len(out) + 1}",
                    **options,
                )
            )
    if not out:
        raise ChannelError(f"No piece without a gap has {shortest} samples", "Repair the channels, or lower shortest=.")
    return out


def displacement_from_drifts(drifts: Any) -> np.ndarray:
    """Displacements relative to the base from drifts measured between neighbouring floors.

    Parameters
    ----------
    drifts : array-like of shape (n_samples, n_dof)
        x_1 - x_0, x_2 - x_1, ..., m. Velocities likewise.

    Returns
    -------
    ndarray of shape (n_samples, n_dof)

    Examples
    --------
    >>> from pysindy_nrf.signals.alignment import displacement_from_drifts
    >>> displacement_from_drifts([[0.002, 0.001, -0.0005]]).round(6)  # three storeys, one instant
    array([[0.002 , 0.003 , 0.0025]])
    """
    return np.cumsum(as_matrix(drifts, "s").astype(float), axis=1)


def _base(record: Record, channels: Mapping[str, np.ndarray]) -> np.ndarray | None:
    if record.coordinates == "absolute" or not record.base_moves:
        return None
    if "ag" not in channels:
        raise ChannelError(
            f"Record {record.name!r} has a moving base without its acceleration", "Give base_acceleration."
        )
    return channels["ag"]
