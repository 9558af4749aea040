r"""Strong-motion records: CSMIP "volume 2" and COSMOS v1.20 text (V1 and V2).

CSMIP V2: 25 lines of text, 100 integers in 16I5, 100 reals in 8F10.3, three series of
fixed width. Each series stands under a line such as ``1138 POINTS OF ACCEL DATA EQUALLY
SPACED AT .020 SEC.  (UNITS: CM/SEC/SEC)`` (1979 to about 1990, always 8F10.3) or ``7808
points of accel data equally spaced at .010 sec, in cm/sec2. (8f10.6)``, and ``/&`` at
the end of each channel. COSMOS, one series for each block: text, integers, reals and
comments, each under a line that states how many follow, then the series. The 62nd real
is the sampling interval of the series, ms; the 34th that of the raw record, s. V0
(counts), V1 of CSMIP (not corrected) and V3 (spectra) are refused by name.

References: A. F. Shakal, M. J. Huang, "Standard tape format for CSMIP strong-motion
data tapes", California Division of Mines and Geology, OSMS 85-03, 1985; COSMOS,
"Strong-motion data format", version 1.20, 2001.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ....exceptions import FileFormatError
from ...clock import rate_of
from ..table import MAX_BYTES, Clock, Table, unreadable

_CSMIP_SERIES = re.compile(
    r"\s*(?P<n>\d+)\s+POINTS OF\s+(?P<kind>ACCEL|VELOC|DISPL)\w*\s+DATA"
    r"\s+EQUALLY[ -]SPACED AT\s+(?P<step>[\d.]+)\s*SEC(?P<rest>.*)",
    re.IGNORECASE,
)
_CSMIP_UNIT = re.compile(
    r"\(UNITS:?\s*(?P<old>[^)\s]+)\s*\)|\bIN\s+(?P<new>[^\s(,]+)", re.IGNORECASE
)
_CSMIP_FORMAT = re.compile(
    r"\(\s*\d*(?:P,?)?\d*[EFG](?P<width>\d+)\.\d+", re.IGNORECASE
)
_COSMOS_SERIES = re.compile(
    r"\s*(?P<n>\d+)\s+.*?(?P<kind>accel|veloc|displ)\S*\s*pts?,?"
    r"\s*approx\s+(?P<duration>[\d.]+)\s*secs?,\s*units\s*=\s*(?P<unit>[^\s(,]+).*?"
    r"format\s*=?\s*\((?:\d*P,?)?(\d+)[EFGI](?P<width>\d+)(?:\.\d+)?(?:E\d+)?\)",
    re.IGNORECASE,
)
_COSMOS_REALS = re.compile(
    r"\s*(?P<n>\d+)\s+Real-header values follow"
    r" on\s+(\d+)\s+lines.*?\(\s*\d+[EFG](?P<width>\d+)\.\d+\)",
    re.IGNORECASE,
)
_CHANNEL = re.compile(
    r"CHAN\s*(?P<channel>\d+)\s*:\s*(?P<about>.*?)\s*(?:\(STA CHN|LOCATION:|FROM\b|$)",
    re.IGNORECASE,
)
_PEAK = re.compile(
    r"PEAK\s+(?P<kind>ACCEL|VELOC|DISPL)\w*\s*=\s*(?P<peak>-?[\d.]+)\s*\S+\s+AT"
    r"\s+[\d.]+",
    re.IGNORECASE,
)
_END_OF_SERIES = re.compile(r"\s*(/&|[A-Za-z])")
_TITLES = re.compile(
    r"\s*((un)?correct(ed|\.)\s+accel|response\s+and\s+fourier)", re.IGNORECASE
)
_OTHER_VOLUMES = {
    "UNCORRECTED ACC": "CSMIP V1, an accelerogram that is not corrected",
    "RESPONSE AND FOU": "CSMIP V3, response spectra and no motion",
    "RESPONSE SPECTR": "V3, response spectra and no motion",
}
# "Velocity data", "Raw acceleration counts", ... of COSMOS
_COSMOS_TITLE = re.compile(r"\(Format v\d+\.\d+ with\s+\d+ text lines\)", re.IGNORECASE)

_KINDS = {"ACCEL": "acceleration", "VELOC": "velocity", "DISPL": "displacement"}
CSMIP_WIDTH = 10  # characters of a number, where no format is stated
# Places among COSMOS's reals: interval of the series (ms), of the raw record (s).
_INTERVAL_MS = 61
_RAW_INTERVAL_S = 33

# A stated peak is written with three decimals, of values that were rounded too.
PEAK_TOLERANCE = 0.01  # of the peak
PEAK_ROUNDING = 0.0011
# COSMOS states the duration in whole seconds.
DURATION_TOLERANCE = 0.02
DURATION_ROUNDING = 1.0  # s


@dataclass(frozen=True)
class Series:
    """A motion of one channel."""

    channel: str
    kind: str
    values: np.ndarray
    step: float  # s
    unit: str

    @property
    def title(self) -> str:
        """The motion and its channel, for messages."""
        return f"{self.kind} of channel {self.channel}"


def is_strong_motion(text: str) -> bool:
    """True if the head of a file is that of a processed strong-motion record."""
    first = _lines_of(text.lstrip()[:200] or "\n")[0]
    if _TITLES.match(first) or "COSMOS" in text[:200].upper():
        return True
    return bool(_COSMOS_TITLE.search(first))


def read_strong_motion(path: Path, max_bytes: int = MAX_BYTES) -> Table:
    """Read the corrected series of a CSMIP V2 or COSMOS file."""
    reader = _BlockReader(path)
    reader.read()
    series = reader.series
    if not series:
        raise _no_series(path, reader.lines)

    has_one_channel = len({motion.channel for motion in series}) == 1
    variables = {}
    units = {}
    clocks = {}
    for motion in series:
        name = motion.kind
        if not has_one_channel:
            name = f"ch{motion.channel}.{motion.kind}"
        if name in variables:
            raise FileFormatError(f"{path} holds the {motion.title} twice", "Split it.")
        variables[name] = motion.values
        units[name] = motion.unit
        clocks[name] = Clock(rate_of(motion.step))

    notes = tuple(dict.fromkeys(reader.notes))
    rates = {clock.fs for clock in clocks.values()}
    return Table(
        path,
        "strong motion",
        variables,
        units,
        notes,
        fs=rates.pop() if len(rates) == 1 else None,
        clocks=clocks,
    )


def _no_series(path: Path, lines: Sequence[str]) -> FileFormatError:
    """Error for a file without a series of a kind that is known."""
    title = " ".join(next((line for line in lines if line.strip()), "").split())
    for start, volume in _OTHER_VOLUMES.items():
        if title.upper().startswith(start):
            return FileFormatError(
                f"{path} is of {volume}",
                "Get the corrected record (V2) of the same channel.",
            )
    return FileFormatError(
        f"{path}: no line announces a series in a way that is known ('... points of"
        " accel data equally spaced at ...', '... pts, ... units=...'); it starts with"
        f" {title[:60]!r}",
        "Export the series as a table with a time column.",
    )


def _lines_of(text: str) -> list[str]:
    """Lines of a text.

    ``splitlines`` would also split at characters within words (0x85, 0x1c, ...).
    """
    lines = re.split(r"\r\n|\n|\r", text)
    return lines if lines[-1] else lines[:-1]


def _named_channel(line: str) -> re.Match | None:
    """The channel that a line names in its first 80 characters."""
    return _CHANNEL.search(line, 0, 80)


_Recogniser = Callable[[str], re.Match | None]
_Reader = Callable[[re.Match], None]


class _BlockReader:
    """Reads a file line by line; a line that announces numbers takes those below it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.lines = _lines_of(path.read_text(encoding="latin-1"))
        self.row = 0  # of the next line
        self.series: list[Series] = []
        self.notes: list[str] = []
        # what the lines so far say of the next series
        self.channel = "1"
        self.peaks: dict[str, float] = {}
        self.cosmos_step: float | None = None  # s

    def read(self) -> None:
        """Read all lines; what each is shows in its words."""
        kinds_of_lines: list[tuple[_Recogniser, _Reader]] = [
            (_CSMIP_SERIES.match, self._read_csmip_series),
            (_COSMOS_SERIES.match, self._read_cosmos_series),
            (_COSMOS_REALS.match, self._read_cosmos_reals),
            (_PEAK.match, self._note_peak),
            (_named_channel, self._begin_channel),
        ]
        while self.row < len(self.lines):
            line = self.lines[self.row]
            self.row += 1
            for recognise, read in kinds_of_lines:
                match = recognise(line)
                if match:
                    read(match)
                    break
            else:
                if line.strip().upper().startswith("CORRECTED ACC"):
                    self.peaks = {}

    def _read_csmip_series(self, announced: re.Match) -> None:
        kind = announced["kind"].upper()
        title = f"{_KINDS[kind]} of channel {self.channel}"
        unit = _CSMIP_UNIT.search(announced["rest"])
        if unit is None:
            raise FileFormatError(
                f"{self.path}: the line {announced[0].strip()!r} states no unit",
                "Export the series as a table with units.",
            )
        form = _CSMIP_FORMAT.search(announced["rest"])
        width = int(form["width"]) if form else CSMIP_WIDTH
        values = self._numbers(int(announced["n"]), width, title)
        step = self._interval(self._number(announced["step"]))
        stated = (unit["old"] or unit["new"]).rstrip(".")
        series = Series(self.channel, _KINDS[kind], values, step, stated)
        self.series.append(series)
        if kind in self.peaks:
            self._compare_peak(series, self.peaks[kind])

    def _read_cosmos_series(self, announced: re.Match) -> None:
        if announced["unit"].lower().startswith("count"):
            raise FileFormatError(
                f"{self.path} holds raw counts of channel {self.channel} (COSMOS V0),"
                " not a motion in physical units",
                "Get the uncorrected or corrected record (V1, V2), in cm/s^2.",
            )
        step = self.cosmos_step
        if step is None:
            raise unreadable(
                self.path,
                "COSMOS",
                "no real header with the sampling interval stands above the series",
            )

        n = int(announced["n"])
        kind = _KINDS[announced["kind"].upper()]
        title = f"{kind} of channel {self.channel}"
        values = self._numbers(n, int(announced["width"]), title)
        stated = self._number(announced["duration"])
        tolerance = max(DURATION_ROUNDING, DURATION_TOLERANCE * stated)
        if stated and abs(n * step - stated) > tolerance:
            raise FileFormatError(
                f"{self.path}: {n} points every {step:g} s are {n * step:g} s, the"
                f" header says {announced['duration']} s",
                "The file is damaged; export it again.",
            )
        series = Series(self.channel, kind, values, step, announced["unit"])
        self.series.append(series)

    def _read_cosmos_reals(self, announced: re.Match) -> None:
        reals = self._numbers(
            int(announced["n"]), int(announced["width"]), "real header"
        )
        step = -1.0  # the header does not say
        if len(reals) > _RAW_INTERVAL_S:
            step = float(reals[_RAW_INTERVAL_S])
        if len(reals) > _INTERVAL_MS and reals[_INTERVAL_MS] > 0:
            step = float(reals[_INTERVAL_MS]) / 1000.0
        self.cosmos_step = self._interval(step)

    def _note_peak(self, stated: re.Match) -> None:
        self.peaks[stated["kind"].upper()] = self._number(stated["peak"])

    def _begin_channel(self, named: re.Match) -> None:
        if named["channel"] != self.channel:
            self.peaks = {}
        self.channel = named["channel"]

        line = self.lines[self.row - 1].upper()
        if "LOCATION" in line:
            location = line.partition("LOCATION:")[2].strip().lower()
            self.notes.append(f"channel {self.channel}: {named['about']}, {location}")

    def _compare_peak(self, series: Series, stated: float) -> None:
        """Note a peak of the header that the points do not reach."""
        if not len(series.values):
            return
        largest = int(np.abs(series.values).argmax())
        reached = series.values[largest]
        tolerance = PEAK_TOLERANCE * abs(stated) + PEAK_ROUNDING
        if abs(abs(reached) - abs(stated)) > tolerance:
            self.notes.append(
                f"take care: the header of channel {series.channel} states a peak"
                f" {series.kind} of {stated:g}, the points reach {reached:g} at"
                f" {largest * series.step:g} s"
            )

    def _numbers(self, n: int, width: int, title: str) -> np.ndarray:
        """The next numbers of a fixed width, which may touch each other."""
        cells: list[str] = []
        count = 0
        while count < n and self.row < len(self.lines):
            line = self.lines[self.row].rstrip()
            if _END_OF_SERIES.match(line):
                break
            cells.append(line + " " * (-len(line) % width))
            count += len(cells[-1]) // width
            self.row += 1

        text = "".join(cells)
        fixed = np.empty(0, "S1")
        if text:
            fixed = np.array([text.encode("ascii", "replace")]).view(f"S{width}")
        try:
            values = fixed.astype(float)
        except ValueError as error:
            raise unreadable(
                self.path,
                "strong motion",
                f"the {title} is not made of numbers {width} characters wide ({error})",
            ) from error
        if len(values) != n:
            raise FileFormatError(
                f"{self.path}: the header announces {n} points of the {title},"
                f" {len(values)} are there",
                "The file is cut off or damaged; export it again.",
            )
        return values

    def _number(self, text: str) -> float:
        """A number of a header."""
        try:
            return float(text)
        except ValueError:
            raise FileFormatError(
                f"{self.path}: {text!r} in a header is not a number",
                "The file is damaged; export it again.",
            ) from None

    def _interval(self, step: float) -> float:
        """A sampling interval, which is positive."""
        if not np.isfinite(step) or step <= 0:
            raise FileFormatError(
                f"{self.path}: its header has no sampling interval", "Export it again."
            )
        return step
