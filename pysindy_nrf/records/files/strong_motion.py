r"""Strong-motion records: CSMIP "volume 2" and COSMOS v1.20 text (V1 and V2).

CSMIP V2: 25 lines of text, 100 integers in 16I5, 100 reals in 8F10.3, three series in
8F10.3, each under a line such as ``1138 POINTS OF ACCEL DATA EQUALLY SPACED AT  .020
SEC.  (UNITS: CM/SEC/SEC)``, and ``/&`` at the end. COSMOS, one series for each block:
text, integers, reals (the 62nd is the sampling interval of the series, ms; the 34th
that of the raw record, s) and comments, each under a line that states how many follow,
then the series. V0 (counts) is refused.

References: A. F. Shakal, M. J. Huang, "Standard tape format for CSMIP strong-motion
data tapes", California Division of Mines and Geology, OSMS 85-03, 1985; COSMOS,
"Strong-motion data format", version 1.20, 2001.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...exceptions import FileFormatError
from ..channels import rate_of
from .table import MAX_BYTES, Table, unreadable

_SERIES = re.compile(
    r"\s*(\d+)\s+POINTS OF\s+(ACCEL|VELOC|DISPL)\w*\s+DATA\s+EQUALLY SPACED"
    r" AT\s+([\d.]+)\s*SEC\.?"
    r".*?\(UNITS:?\s*([^)\s]+)\s*\)",
    re.IGNORECASE,
)
_COSMOS_SERIES = re.compile(
    r"\s*(\d+)\s+.*?(accel|veloc|displ)\S*\s*pts?,?\s*approx\s+([\d.]+)\s*secs?,\s*units\s*=\s*([^\s(,]+).*?"
    r"format\s*=?\s*\((?:\d*P,?)?(\d+)[EFGI](\d+)(?:\.\d+)?(?:E\d+)?\)",
    re.IGNORECASE,
)
_REALS = re.compile(
    r"\s*(\d+)\s+Real-header values follow"
    r" on\s+(\d+)\s+lines.*?\(\s*\d+[EFG](\d+)\.\d+\)",
    re.I,
)
_CHANNEL = re.compile(
    r"CHAN\s*(\d+)\s*:\s*(.*?)\s*(?:\(STA CHN|LOCATION:|FROM\b|$)", re.IGNORECASE
)
_PEAK = re.compile(
    r"PEAK\s+(ACCEL|VELOC|DISPL)\w*\s*=\s*(-?[\d.]+)\s*\S+\s+AT\s+[\d.]+", re.IGNORECASE
)
_END = re.compile(r"\s*(/&|[A-Za-z])")  # of a series
_KINDS = {"ACCEL": "acceleration", "VELOC": "velocity", "DISPL": "displacement"}
# Indices among COSMOS's reals: sampling interval of the series (ms), of the raw record
# (s).
_INTERVAL, _RAW_INTERVAL = 61, 33


@dataclass
class _Series:
    channel: str
    kind: str
    values: np.ndarray
    step: float
    unit: str


def is_strong_motion(text: str) -> bool:
    """True if the head of a file is that of a processed strong-motion record."""
    first = _lines(text.lstrip()[:200] or "\n")[0]
    if (
        re.match(r"(un)?correct(ed|\.)\s+accel", first, re.IGNORECASE)
        or "COSMOS" in text[:200].upper()
    ):
        return True
    # "Velocity data", "Raw acceleration counts", ... of COSMOS
    return bool(
        re.search(r"\(Format v\d+\.\d+ with\s+\d+ text lines\)", first, re.IGNORECASE)
    )


def read_strong_motion(path: Path, max_bytes: int = MAX_BYTES) -> Table:
    """Read the corrected series of a CSMIP V2 or COSMOS file."""
    series, notes = _read(path, _lines(path.read_text(encoding="latin-1")))
    if not series:
        reason = (
            "no line announces a series ('... POINTS OF ACCEL DATA ...', '... pts,"
            " units=...')"
        )
        raise unreadable(path, "strong motion", reason)
    steps = sorted({s.step for s in series})
    if len(steps) > 1:
        cure = "Split it by channel."
        raise FileFormatError(
            f"{path}: its series are sampled every"
            f" {', '.join(f'{s:g}' for s in steps)} s",
            cure,
        )
    channels = list(dict.fromkeys(s.channel for s in series))
    variables, units = {}, {}
    for one in series:
        name = one.kind if len(channels) == 1 else f"ch{one.channel}.{one.kind}"
        if name in variables:
            raise FileFormatError(
                f"{path} holds the {one.kind} of channel {one.channel} twice",
                "Split it.",
            )
        variables[name], units[name] = one.values, one.unit
    return Table(path, "strong motion", variables, units, notes, fs=rate_of(steps[0]))


def _lines(text: str) -> list[str]:
    """Lines of a text; ``splitlines`` would also split at characters within words
    (0x85, 0x1c, ...).
    """
    lines = re.split(r"\r\n|\n|\r", text)
    return lines if lines[-1] else lines[:-1]


def _read(path: Path, lines: Sequence[str]) -> tuple[list[_Series], list[str]]:
    out: list[_Series] = []
    notes: list[str] = []
    peaks: dict[str, float] = {}
    channel, step = "1", None
    row = 0
    while row < len(lines):
        line = lines[row]
        row += 1
        if match := _SERIES.match(line):
            n, kind = int(match[1]), match[2].upper()
            values, row = _fixed(
                path, lines, row, n, 10, f"{_KINDS[kind]} of channel {channel}"
            )
            out.append(
                _Series(
                    channel,
                    _KINDS[kind],
                    values,
                    _positive(path, _number(path, match[3])),
                    match[4],
                )
            )
            notes += _peak_note(channel, out[-1], peaks[kind]) if kind in peaks else []
        elif match := _COSMOS_SERIES.match(line):
            n, kind = int(match[1]), match[2].upper()
            if match[4].lower().startswith("count"):
                what = (
                    f"{path} holds raw counts of channel {channel} (COSMOS V0), not a"
                    " motion in physical units"
                )
                raise FileFormatError(
                    what, "Get the uncorrected or corrected record (V1, V2), in cm/s^2."
                )
            if step is None:
                raise unreadable(
                    path,
                    "COSMOS",
                    "no real header with the sampling interval stands above the series",
                )
            values, row = _fixed(
                path,
                lines,
                row,
                n,
                int(match[6]),
                f"{_KINDS[kind]} of channel {channel}",
            )
            seconds = _number(path, match[3])
            if seconds and abs(n * step - seconds) > max(1.0, 0.02 * seconds):
                what = (
                    f"{path}: {n} points every {step:g} s are {n * step:g} s, the"
                    f" header says {match[3]} s"
                )
                raise FileFormatError(what, "The file is damaged; export it again.")
            out.append(_Series(channel, _KINDS[kind], values, step, match[4]))
        elif match := _REALS.match(line):
            reals, row = _fixed(
                path, lines, row, int(match[1]), int(match[3]), "real header"
            )
            step = _positive(path, _interval(reals))
        elif match := _PEAK.match(line):
            peaks[match[1].upper()] = _number(path, match[2])
        elif match := _CHANNEL.search(line[:80]):
            if match[1] != channel:
                peaks = {}
            channel = match[1]
            if "LOCATION" in line.upper():
                notes.append(
                    f"channel {channel}: {match[2]},"
                    f" {line.upper().partition('LOCATION:')[2].strip().lower()}"
                )
        elif line.strip().upper().startswith("CORRECTED ACC"):
            peaks = {}
    return out, list(dict.fromkeys(notes))


def _fixed(
    path: Path, lines: Sequence[str], row: int, n: int, width: int, what: str
) -> tuple[np.ndarray, int]:
    """Numbers of a fixed width, which may touch each other, and the row after them."""
    taken: list[str] = []
    count = 0
    while count < n and row < len(lines) and not _END.match(lines[row]):
        line = lines[row].rstrip()
        taken.append(line + " " * (-len(line) % width))
        count += len(taken[-1]) // width
        row += 1
    text = "".join(taken)
    cells = (
        np.array([text.encode("ascii", "replace")]).view(f"S{width}")
        if text
        else np.empty(0, "S1")
    )
    try:
        values = cells.astype(float)
    except ValueError as error:
        reason = f"the {what} is not made of numbers {width} characters wide ({error})"
        raise unreadable(path, "strong motion", reason) from error
    if len(values) != n:
        cure = "The file is cut off or damaged; export it again."
        raise FileFormatError(
            f"{path}: the header announces {n} points of the {what}, {len(values)} are"
            " there",
            cure,
        )
    return values, row


def _interval(reals: np.ndarray) -> float:
    """Sampling interval of the series, s; not positive if the header does not say."""
    if len(reals) > _INTERVAL and reals[_INTERVAL] > 0:
        return float(reals[_INTERVAL]) / 1000.0
    return float(reals[_RAW_INTERVAL]) if len(reals) > _RAW_INTERVAL else -1.0


def _number(path: Path, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        cure = "The file is damaged; export it again."
        raise FileFormatError(
            f"{path}: {text!r} in a header is not a number", cure
        ) from None


def _positive(path: Path, step: float) -> float:
    if not np.isfinite(step) or step <= 0:
        raise FileFormatError(
            f"{path}: its header has no sampling interval", "Export it again."
        )
    return step


def _peak_note(channel: str, series: _Series, peak: float) -> list[str]:
    at = int(np.abs(series.values).argmax()) if len(series.values) else 0
    reached = series.values[at] if len(series.values) else peak
    if abs(abs(reached) - abs(peak)) <= 0.01 * abs(peak) + 0.0011:
        return []
    return [
        f"take care: the header of channel {channel} states a peak {series.kind} of"
        f" {peak:g}, the points reach {reached:g} at {at * series.step:g} s"
    ]
