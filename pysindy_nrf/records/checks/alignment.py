r"""Channels that are late, inverted, wrongly scaled, or on clocks of their own.

Acceleration, velocity and displacement of one DOF are one motion; where they do not
fit, the transfer between them says why: its phase is a delay (straight in frequency) or
an inversion (pi), its size a gain,

.. math:: \frac{X_c(f)}{X_r(f)} (2 \pi i f)^{k} = g \, e^{-2 \pi i f \tau} .
"""

from collections.abc import Mapping, Sequence
from fractions import Fraction
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.ndimage import uniform_filter1d
from scipy.signal import resample_poly, zoom_fft

from ...exceptions import ChannelError
from ...laws.sensor import shifted
from ..channels import as_matrix
from ..record import OF_LETTER, Record, seconds_of

__all__ = ["align", "channel_alignment", "resampled", "split_at_gaps"]


def channel_alignment(
    record: Record,
    band: tuple[float, float] | None = None,
    reference: str = "a",
    runs: Sequence[slice] | None = None,
) -> pd.DataFrame:
    """Delay, gain and sign of each motion channel against another channel of the same
    DOF.

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
        By channel: ``reference``, ``delay`` (s, positive = late), ``samples``,
        ``gain``, ``scatter`` (of the gain: how far it differs with frequency, and what
        noise may have made of it, as a share; infinite where too few lines tell),
        ``sign`` (+1 or -1), ``coherence``, ``aligned`` (bool) and ``message``.

    Raises
    ------
    ChannelError
        If no DOF has two kinds of channels.

    Examples
    --------
    >>> from pysindy_nrf import datasets
    >>> from pysindy_nrf.records.checks.alignment import channel_alignment
    >>> rec = datasets.load_demo()
    >>> found = channel_alignment(rec.replace(displacement=-rec.displacement))
    >>> found["sign"].tolist()
    [-1.0, -1.0, -1.0]
    """
    if reference not in ORDER:
        raise ChannelError(
            f"reference={reference!r} is unknown", "Choose 'a', 'v' or 'x'."
        )
    channels = record.channels()
    shaken = record.coordinates == "relative" and record.base_moves
    if shaken and "ag" not in channels:
        what = f"Record {record.name!r} has a moving base without its acceleration"
        raise ChannelError(what, "Give base_acceleration.")
    base = channels["ag"] if shaken else None
    rows = {}
    for j in range(1, record.n_dof + 1):
        own = {k: channels[f"{k}{j}"] for k in "avx" if f"{k}{j}" in channels}
        if len(own) < 2:
            continue
        first = reference if reference in own else next(iter(own))
        for kind, values in own.items():
            if kind != first:
                rows[f"{kind}{j}"] = against(
                    record, base, (first, own[first]), (kind, values), j, band, runs
                )
    if not rows:
        cure = "Delays between DOFs show in the balances only."
        raise ChannelError(
            f"No DOF of record {record.name!r} has two kinds of motion channels", cure
        )
    columns = [
        "reference",
        "delay",
        "samples",
        "gain",
        "scatter",
        "sign",
        "coherence",
        "aligned",
        "message",
    ]
    return pd.DataFrame.from_dict(rows, orient="index", columns=columns).rename_axis(
        "channel"
    )


def align(record: Record, found: pd.DataFrame, gains: bool = False) -> Record:
    """Shift and invert channels as found by :func:`channel_alignment`.

    Parameters
    ----------
    record : Record
    found : DataFrame
        Rows may be dropped or changed before.
    gains : bool
        Correct gains too; a gain shows that one of two channels is wrong, not which.

    Returns
    -------
    Record
        A new one; rows at the ends that a shift leaves empty are NaN in that channel.

    Examples
    --------
    >>> from pysindy_nrf import datasets
    >>> from pysindy_nrf.records.checks.alignment import (
    ...     align,
    ...     channel_alignment,
    ... )
    >>> rec = datasets.load_demo()
    >>> turned = rec.replace(
    ...     displacement=-rec.displacement
    ... )  # the laser counts the other way
    >>> bool(
    ...     (
    ...         align(turned, channel_alignment(turned)).displacement
    ...         == rec.displacement
    ...     ).all()
    ... )
    True
    """
    changes: dict[str, np.ndarray] = {}
    for name, row in found.iterrows():
        if row["aligned"] or not np.isfinite(
            row["sign"]
        ):  # an incoherent channel tells nothing to correct
            continue
        key, j = OF_LETTER[str(name)[0]], int(str(name)[1:]) - 1
        array = changes.setdefault(key, np.array(getattr(record, key), dtype=float))
        factor = row["sign"] / (
            row["gain"] if gains and abs(row["gain"] - 1) > GAIN else 1.0
        )
        late = row["samples"] if abs(row["samples"]) > DELAY else 0.0
        array[:, j] = factor * (shifted(array[:, j], -late) if late else array[:, j])
    return record.replace(**changes)


def resampled(
    channels: Mapping[str, Any],
    rates: Mapping[str, float],
    fs: float | None = None,
    **options: Any,
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
        Resampled with :func:`scipy.signal.resample_poly` (its anti-aliasing filter has
        no delay), cut to the shortest channel.

    Raises
    ------
    ChannelError
        If the rate of a channel is not given, or a rate and the one wanted have no
        simple ratio.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf.records.checks.alignment import resampled
    >>> slow, fast = np.arange(1000) / 250, np.arange(4000) / 1000
    >>> rec = resampled(
    ...     {"x1": np.sin(9 * slow), "a1": -81 * np.sin(9 * fast)},
    ...     {"x1": 250.0, "a1": 1000.0},
    ... )
    >>> (
    ...     rec.fs,
    ...     bool(
    ...         np.abs(rec.acceleration + 81 * rec.displacement)[50:-50].max()
    ...         < 0.2
    ...     ),
    ... )
    (250.0, True)
    """
    own = {
        n: float(rates.get(n, rates.get(n.rstrip("0123456789"), np.nan)))
        for n in channels
    }
    lost = [n for n, r in own.items() if not np.isfinite(r) or r <= 0]
    if lost:
        raise ChannelError(
            f"The sampling rate of channel {lost[0]} is unknown",
            "Give it in rates={...}, in Hz.",
        )
    wanted = float(fs or min(own.values()))
    out = {}
    for name, values in channels.items():
        line = as_matrix(values, [name], 1)[:, 0].astype(float)
        ratio = Fraction(wanted / own[name]).limit_denominator(1000)
        if abs(float(ratio) * own[name] / wanted - 1) > 1e-6:
            cure = "Give another fs."
            raise ChannelError(
                f"{own[name]:g} Hz of channel {name} and {wanted:g} Hz have no simple"
                " ratio",
                cure,
            )
        out[name] = (
            line
            if ratio == 1
            else resample_poly(line, ratio.numerator, ratio.denominator, padtype="line")
        )
    n = min(map(len, out.values()))
    return Record.from_frame(
        pd.DataFrame({k: y[:n] for k, y in out.items()}), fs=wanted, **options
    )


def split_at_gaps(
    table: pd.DataFrame, fs: float | None = None, shortest: int = 100, **options: Any
) -> list[Record]:
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

    Raises
    ------
    ChannelError
        If no piece without a gap has ``shortest`` samples, the clock is not finite, or
        :meth:`Record.from_frame` cannot take the channels.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from pysindy_nrf.records.checks.alignment import split_at_gaps
    >>> t = np.delete(
    ...     np.arange(1000) / 100, slice(400, 500)
    ... )  # the logger paused for a second
    >>> table = pd.DataFrame({"t": t, "x1": np.sin(9 * t)})
    >>> [(rec.n_samples, round(rec.fs, 6)) for rec in split_at_gaps(table)]
    [(400, 100.0), (500, 100.0)]
    """
    key = next((k for k in ("t", "time") if k in table), None)
    steps = np.diff(seconds_of(table[key].to_numpy() if key else table.index))
    usual = 1.0 / fs if fs else float(np.median(steps))
    body = table.drop(columns=[key]) if key else table
    good = body.dropna(axis=1, how="all").notna().all(axis=1).to_numpy()
    breaks = (
        np.flatnonzero((steps > 1.5 * usual) | (steps <= 0) | (good[1:] != good[:-1]))
        + 1
    )
    name = options.pop("name", "record")
    out: list[Record] = []
    for rows in np.split(np.arange(len(table)), breaks):
        if good[rows[0]] and len(rows) >= shortest:
            part = body.iloc[rows].reset_index(drop=True)
            out.append(
                Record.from_frame(
                    part, fs=1.0 / usual, name=f"{name}, part {len(out) + 1}", **options
                )
            )
    if not out:
        raise ChannelError(
            f"No piece without a gap has {shortest} samples",
            "Repair the channels, or lower shortest=.",
        )
    return out


ORDER = {"x": 0, "v": 1, "a": 2}
STRONG = 1e-3  # share of a spectrum's peak
LONGEST = 65536  # samples of a channel that are used
FINE, MOST = (
    4,
    20,
)  # steps of a sample in which a delay is searched, and samples up to which
CYCLES = 8  # of a line, at least, within the lasting part of a record
CYCLES_OF_A_RUN, DENSE = (
    3,
    4,
)  # the same for runs that are differentiated first; lines of a run for each of its own
NEIGHBOURS = 9  # lines that are averaged
# share of a channel that gain, sign and delay leave, from which on it is of another
# place
MISFIT = 0.5
BLOCKS = 8  # of lines, over which the scatter of the gain is taken
DELAY, GAIN = (
    0.05,
    0.02,
)  # samples, and share of one, from which on a channel is called misaligned


def against(
    record: Record,
    base: np.ndarray | None,
    one: tuple[str, np.ndarray],
    other: tuple[str, np.ndarray],
    j: int,
    band: Any,
    runs: Sequence[slice] | None,
) -> list[Any]:
    """One row of the table: the second channel against the first, in the frame of
    reference the record claims.
    """
    order = ORDER[other[0]] - ORDER[one[0]]
    names = f"{one[0]}{j}", f"{other[0]}{j}"
    if message := _wrong_frame(record, one, other, names):
        return [names[0], *[np.nan] * 6, False, message]
    first, second = (
        y - base if k == "a" and base is not None else y for k, y in (one, other)
    )
    return _compare(first, second, order, record.fs, band, *names, runs)


def _wrong_frame(
    record: Record,
    one: tuple[str, np.ndarray],
    other: tuple[str, np.ndarray],
    names: tuple[str, str],
) -> str:
    """Message if displacement or velocity is measured in another frame than the record
    states; else empty.
    """
    ag = record.base_acceleration
    pair = {k: y for k, y in (one, other)}
    if ag is None or "a" not in pair or len(pair) < 2:
        return ""
    kind = next(k for k in pair if k != "a")
    good = np.isfinite(pair["a"]) & np.isfinite(pair[kind]) & np.isfinite(ag)
    n = min(int(good.sum()), LONGEST)
    if n < 64 or not np.any(ag[good]):
        return ""
    y, a, g = (
        np.fft.rfft(hann(n) * (line[good][:n] - line[good][:n].mean()))
        for line in (pair[kind], pair["a"], ag)
    )
    y = y * (2j * np.pi * np.fft.rfftfreq(n, 1 / record.fs)) ** (
        ORDER["a"] - ORDER[kind]
    )
    use = np.arange(len(y)) > 4
    use &= (np.abs(a) ** 2 > STRONG * (np.abs(a[use]) ** 2).max()) & (
        np.arange(len(y)) < 0.8 * len(y)
    )
    if use.sum() < 8:
        return ""
    columns = np.column_stack([a[use], g[use]]) / np.abs(y[use])[:, None]
    alpha, beta = np.linalg.lstsq(columns, y[use] / np.abs(y[use]), rcond=None)[0].real
    relative = record.coordinates == "relative"
    if abs(alpha - 1) > 0.3 or abs(beta - (0.0 if relative else -1.0)) > 0.3:
        return ""
    x = names[0] if names[0][0] == kind else names[1]
    if relative:
        return (
            f"{x} agrees with a{x[1:]} itself, not with a{x[1:]} less the base"
            f" acceleration: {x} is absolute (coordinates='absolute'), or a{x[1:]} is"
            " relative to the base (add ag to it)"
        )
    return (
        f"{x} agrees with a{x[1:]} less the base acceleration: it is relative to the"
        " base (coordinates='relative')"
    )


def _duration(line: np.ndarray) -> float:
    """Samples over which the power of a signal is spread: its square sum squared over
    the sum of its fourth powers.
    """
    power = line**2
    return float(power.sum() ** 2 / max((power**2).sum(), np.finfo(float).tiny))


class _Lines(NamedTuple):
    """Spectra of two channels brought to one kind, averaged over neighbouring lines."""

    f: np.ndarray
    cross: np.ndarray
    own: np.ndarray
    theirs: np.ndarray
    size: np.ndarray
    slowest: float
    length: int


def _whole(first: np.ndarray, second: np.ndarray, order: int, fs: float) -> _Lines:
    """Lines of the whole record."""
    good = np.isfinite(first) & np.isfinite(second)
    y, z = (_detrended(line[good][:LONGEST]) for line in (first, second))
    length = len(y)
    bell = hann(length)
    f = np.fft.rfftfreq(length, 1 / fs)
    Y, Z = np.fft.rfft(bell * y), np.fft.rfft(bell * z)
    # derived line by line before lines are averaged: however steep the spectra, nothing
    # leaks then
    U = (
        Y * (2j * np.pi * np.maximum(f, f[1])) ** order
    )  # a running mean loses what is far below its largest line
    # the window is differentiated too: lines with few cycles within it, or within its
    # decay, are unreliable
    lasting = min(_duration(bell * y), _duration(bell * z)) / fs
    sums = (
        _mean(np.conj(U) * Z),
        _mean(np.abs(U) ** 2),
        _mean(np.abs(Z) ** 2),
        _mean(np.abs(Y) ** 2),
    )
    return _Lines(f, *sums, CYCLES / lasting if lasting else np.inf, length)


def _in_runs(
    first: np.ndarray, second: np.ndarray, order: int, fs: float, runs: Sequence[slice]
) -> _Lines:
    """Lines of several runs together."""
    longest = min(max(run.stop - run.start for run in runs), LONGEST)
    dense = longest * (DENSE if len(runs) > 1 else 1)
    f = np.fft.rfftfreq(dense, 1 / fs)
    angle = np.minimum(2 * np.pi * f[1:] / fs, 0.9 * np.pi)
    true = np.ones(len(f))  # central differences over derivatives
    true[1:] = (
        np.sin(angle) / angle if abs(order) == 1 else 2 * (1 - np.cos(angle)) / angle**2
    )
    total = [np.zeros(len(f), dtype=complex), np.zeros(len(f)), np.zeros(len(f))]
    for run in runs:
        pair = first[run][:longest], second[run][:longest]
        good = np.isfinite(pair[0]) & np.isfinite(pair[1])
        y, z = (
            _derived(line[good], max(k, 0), fs)
            for line, k in zip(pair, (order, -order))
        )
        if len(y) < 2 * NEIGHBOURS:
            continue
        U, Z = (
            np.fft.rfft(hann(len(line)) * _detrended(line), dense) for line in (y, z)
        )
        if order:
            U, Z = (U / true, Z) if order > 0 else (U, Z / true)
        for part, more in zip(total, (np.conj(U) * Z, np.abs(U) ** 2, np.abs(Z) ** 2)):
            part += np.where(
                f < 0.45 * fs, more, 0.0
            )  # above, a difference is unreliable
    cross, own, theirs = (_mean(part) for part in total)
    return _Lines(f, cross, own, theirs, own, CYCLES_OF_A_RUN * fs / longest, dense)


def _derived(y: np.ndarray, order: int, fs: float) -> np.ndarray:
    """Central differences of first or second order, a sample shorter at either end."""
    if order == 0:
        return y[1:-1]
    return (
        (y[2:] - y[:-2]) * (0.5 * fs)
        if order == 1
        else (y[2:] - 2 * y[1:-1] + y[:-2]) * fs**2
    )


@lru_cache(maxsize=4)
def hann(length: int) -> np.ndarray:
    """Hann window, sampled at the middles of its intervals, of height two."""
    return np.asarray(1 - np.cos(2 * np.pi * (np.arange(length) + 0.5) / length))


def _detrended(y: np.ndarray) -> np.ndarray:
    """The signal less its least-squares line; in closed form, ten times as fast as
    SciPy's general solve.
    """
    t = np.arange(len(y)) - 0.5 * (len(y) - 1)
    return (
        y - y.mean() - (t * y).mean() / np.square(t).mean() * t
    )  # without BLAS, whose threads wait for each other


def _mean(product: np.ndarray) -> np.ndarray:
    """Mean over neighbouring lines."""
    return np.asarray(uniform_filter1d(product, NEIGHBOURS))


def _compare(
    first: np.ndarray,
    second: np.ndarray,
    order: int,
    fs: float,
    band: Any,
    one: str,
    other: str,
    runs: Sequence[slice] | None,
) -> list[Any]:
    """Fit gain, sign and delay of the second channel against derivatives of the
    first.
    """
    lines = (
        _whole(first, second, order, fs)
        if runs is None
        else _in_runs(first, second, order, fs, runs)
    )
    f, cross, own, theirs, size, slowest, length = lines
    use = (np.arange(len(f)) > NEIGHBOURS) & (f > slowest) & (f < 0.4 * fs)
    use &= (size > STRONG * size.max()) & (theirs > STRONG * theirs.max())
    if band is not None:
        use &= (f >= band[0]) & (f <= band[1])
    if use.sum() < NEIGHBOURS:  # the motion is too slow for the length of the record
        return [one, *[np.nan] * 6, True, ""]
    coherence = np.zeros(len(f))
    coherence[use] = np.abs(cross[use]) ** 2 / own[use] / theirs[use]
    if (coherence[use] > 0.5).sum() <= 0.2 * use.sum():
        message = (
            f"{other} and {one} are not coherent: columns swapped, another floor, or"
            " dead"
        )
        return [one, *[np.nan] * 5, float(coherence.max()), False, message]
    use &= coherence > min(0.9, 0.9 * coherence.max())
    if (
        use.sum() < NEIGHBOURS // 2
    ):  # a line or two of noise that are coherent by chance
        return [one, *[np.nan] * 5, float(coherence.max()), True, ""]
    w = 2 * np.pi * f[use]
    # between the gains that noise in the one and in the other channel makes too small
    # and too large
    H = cross[use] / np.abs(cross[use]) * np.sqrt(theirs[use] / own[use])
    weight = np.minimum(coherence[use] / np.maximum(1 - coherence[use], 1e-6), 1e3)
    # delay: the one that lines all phases up, searched on a grid (a chirp transform)
    # and refined
    lined = np.zeros(int(np.flatnonzero(use)[-1]) + 1, dtype=complex)
    lined[use[: len(lined)]] = H / np.abs(H) * weight
    fine = max(FINE, -(-FINE * 256 // length))
    total = zoom_fft(
        lined.conj(),
        [-MOST / length, MOST / length],
        2 * MOST * fine + 1,
        fs=1.0,
        endpoint=True,
    ).real
    best = int(np.argmax(np.abs(total)))
    sign = 1.0 if total[best] > 0 else -1.0
    delay = (best - MOST * fine) / fine / fs
    for _ in range(3):
        phase = np.angle(sign * H * np.exp(1j * w * delay))
        delay -= float((weight * w * phase).sum() / (weight * w**2).sum())
    gain = float(np.exp(np.average(np.log(np.abs(H)), weights=weight)))
    scatter = _scatter(np.log(np.abs(H)), w, weight, coherence[use])
    fitted = sign * gain * np.exp(-1j * w * delay)
    power = theirs[use] * coherence[use]
    misfit = float(np.sqrt((np.abs(H / fitted - 1) ** 2 * power).sum() / power.sum()))
    faults = []
    if sign < 0:
        faults.append("has the opposite sign")
    if abs(delay * fs) > DELAY:
        side = "late" if delay > 0 else "early"
        faults.append(
            f"is {abs(delay) * 1e3:.3g} ms ({abs(delay * fs):.2f} samples) {side}"
        )
    if abs(gain - 1) > GAIN:
        faults.append(f"is {gain:.3g} times as large")
    message = f"{other} {', '.join(faults)} against {one}" if faults else ""
    if misfit > MISFIT:
        message = (
            f"{other} does not follow {one} as {OF_LETTER[other[0]]} follows"
            f" {OF_LETTER[one[0]]}: columns swapped, or a channel of another floor"
        )
    return [
        one,
        delay,
        delay * fs,
        gain,
        scatter,
        sign,
        float(np.average(coherence[use])),
        not message,
        message,
    ]


def _scatter(
    logs: np.ndarray, w: np.ndarray, weight: np.ndarray, coherence: np.ndarray
) -> float:
    """Scatter of the log gain over frequency: between blocks of lines, towards low
    frequencies, and from noise.
    """
    count = min(BLOCKS, len(logs) // NEIGHBOURS)
    if count < 3:
        return float("inf")
    parts = np.array_split(np.arange(len(logs)), count)
    means = np.array([np.average(logs[p], weights=weight[p]) for p in parts])
    shares = np.array([weight[p].sum() for p in parts])
    mean = float(np.average(means, weights=shares))
    apart = np.sqrt(np.average((means - mean) ** 2, weights=shares))
    columns = (
        np.column_stack([np.ones(len(w)), (w / w.max()) ** 2])
        * np.sqrt(weight)[:, None]
    )
    line = np.linalg.lstsq(columns, logs * np.sqrt(weight), rcond=None)[0]
    left = columns @ line - logs * np.sqrt(weight)
    error = np.sqrt(
        NEIGHBOURS
        * np.linalg.pinv(columns.T @ columns)[0, 0]
        * (left @ left)
        / len(left)
    )
    bent = max(abs(line[0] - mean) - 2 * error, 0.0)
    noise = np.average(-0.5 * np.log(np.minimum(coherence, 1.0)), weights=weight)
    return float(apart + bent + noise)
