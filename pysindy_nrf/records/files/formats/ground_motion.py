"""Ground motions of archives: PEER (AT2, VT2, DT2), K-NET and KiK-net, USGS SMC.

References: PEER NGA ground motion database, https://ngawest2.berkeley.edu; NIED,
"Strong-motion seismograph networks: data format", https://www.kyoshin.bosai.go.jp; U.S.
Geological Survey, "SMC format", https://escweb.wr.usgs.gov/nsmp-data/smcfmt.html.
"""

import re
from pathlib import Path

import numpy as np

from ....exceptions import FileFormatError
from ...clock import rate_of
from ..table import MAX_BYTES, Clock, Table

_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[EeDd][+-]?\d+)?")


def _lines(path: Path) -> list[str]:
    return re.split(r"\r\n|\n|\r", path.read_text(encoding="latin-1").rstrip())


def _one_series(
    path: Path, kind: str, name: str, values: np.ndarray, unit: str, clock: Clock
) -> Table:
    """The table of one series with its clock."""
    clocks = {name: clock}
    return Table(path, kind, {name: values}, {name: unit}, fs=clock.fs, clocks=clocks)


def _require_count(path: Path, values: np.ndarray, announced: int) -> None:
    """Refuse a series of another length than its header says."""
    if len(values) != announced:
        raise FileFormatError(
            f"{path}: its header announces {announced} points, {len(values)} are there",
            "Get the file again.",
        )


# -- PEER ----------------------------------------------------------------------

_PEER_KIND = re.compile(
    r"(?P<kind>ACCELERATION|VELOCITY|DISPLACEMENT).*UNITS?\s+(?:OF|:|=)?\s*"
    r"(?P<unit>[A-Z/0-9^]+)",
    re.IGNORECASE,
)
_PEER_CLOCK = (
    re.compile(r"NPTS\s*=\s*(?P<n>\d+)\s*,?\s*DT\s*=\s*(?P<step>[\d.eE+-]+)", re.I),
    re.compile(r"(?P<n>\d+)\s+(?P<step>[\d.]+)\s*,?\s*NPTS\s*,\s*DT", re.I),
)
PEER_HEAD = 8  # lines in which the header lies


def read_peer(path: Path, max_bytes: int = MAX_BYTES) -> Table:
    """Read a ground motion of PEER: four lines of text, and numbers in columns."""
    lines = _lines(path)
    kinds = [_PEER_KIND.search(line) for line in lines[:PEER_HEAD]]
    kind = next(filter(None, kinds), None)
    for row, line in enumerate(lines[:PEER_HEAD]):
        clocks = [pattern.search(line) for pattern in _PEER_CLOCK]
        clock = next(filter(None, clocks), None)
        if clock is not None and kind is not None:
            numbers = _NUMBER.findall(" ".join(lines[row + 1 :]))
            values = np.array([n.replace("D", "E") for n in numbers], dtype=float)
            _require_count(path, values, int(clock["n"]))
            rate = rate_of(float(clock["step"]))
            name = kind["kind"].lower()
            unit = kind["unit"].lower()
            return _one_series(path, "PEER", name, values, unit, Clock(rate))
    raise FileFormatError(
        f"{path} has no header of PEER ('... TIME SERIES IN UNITS OF G', 'NPTS= .., DT="
        " ..')",
        "Export it as a table with a time.",
    )


# -- K-NET and KiK-net ---------------------------------------------------------

_KNET_RATE = re.compile(r"Sampling Freq.*?(?P<fs>[\d.]+)\s*Hz", re.IGNORECASE)
_KNET_SCALE = re.compile(
    r"Scale Factor\s+(?P<full>[\d.]+)\s*\((?P<unit>\w+)\)\s*/\s*(?P<counts>[\d.]+)",
    re.IGNORECASE,
)
_KNET_STARTED = re.compile(
    r"Record Time\s+(?P<date>\d{4}/\d\d/\d\d)\s+(?P<time>[\d:.]+)", re.IGNORECASE
)
_KNET_DIRECTION = re.compile(r"Dir\.\s+(?P<direction>\S+)", re.IGNORECASE)
_KNET_PEAK = re.compile(r"Max\. Acc\.\s*\(\w+\)\s+(?P<peak>[\d.]+)", re.IGNORECASE)
# The recorder writes its time this late, s (NIED).
KNET_DELAY = np.timedelta64(15, "s")
PEAK_TOLERANCE = 0.01  # of the peak, which is stated with three decimals


def read_knet(path: Path, max_bytes: int = MAX_BYTES) -> Table:
    """Read one component of K-NET or KiK-net; its mean is taken off, as NIED does."""
    lines = _lines(path)
    head = "\n".join(lines[:20])
    rate = _KNET_RATE.search(head)
    scale = _KNET_SCALE.search(head)
    memo = [row for row, line in enumerate(lines[:20]) if line.startswith("Memo")]
    if rate is None or scale is None or not memo:
        raise FileFormatError(
            f"{path} has no header of K-NET ('Sampling Freq(Hz)', 'Scale Factor',"
            " 'Memo.')",
            "Get the ASCII file of the component.",
        )

    counts = np.array(" ".join(lines[memo[0] + 1 :]).split(), dtype=float)
    values = counts * (float(scale["full"]) / float(scale["counts"]))
    values -= values.mean()
    direction = _KNET_DIRECTION.search(head)
    name = "acceleration"
    if direction is not None:
        name = f"acceleration {direction['direction'].replace('-', '')}"

    started = _KNET_STARTED.search(head)
    origin = None
    if started is not None:
        stamp = f"{started['date'].replace('/', '-')}T{started['time']}"
        origin = np.datetime64(stamp, "ns") - KNET_DELAY
    clock = Clock(float(rate["fs"]), 0.0, origin)
    table = _one_series(path, "K-NET", name, values, scale["unit"], clock)
    return _with_note_on_peak(table, name, values, _KNET_PEAK.search(head))


def _with_note_on_peak(
    table: Table, name: str, values: np.ndarray, stated: re.Match | None
) -> Table:
    """The table, with a note if the points do not reach the peak of the header."""
    if stated is None:
        return table
    peak = float(stated["peak"])
    reached = float(np.abs(values).max())
    if abs(reached - peak) <= PEAK_TOLERANCE * peak + 1e-3:
        return table
    note = f"take care: the header states a peak of {peak:g}, {name} has {reached:.4g}"
    return Table(
        table.path,
        table.kind,
        table.variables,
        table.units,
        (note,),
        fs=table.fs,
        clocks=table.clocks,
    )


# -- USGS SMC ------------------------------------------------------------------

_SMC_TYPES = {
    "1": ("acceleration", "cm/s^2"),
    "2": ("acceleration", "cm/s^2"),
    "3": ("velocity", "cm/s"),
    "4": ("displacement", "cm"),
}
# Lines of texts, integers and reals.
_SMC_TEXTS = 11
_SMC_INTEGERS = 6
_SMC_REALS = 10
# Places in the headers.
_SMC_COMMENTS = 15
_SMC_POINTS = 16
_SMC_RATE = 1
SMC_WIDTH = 10  # characters of a number


def is_smc(text: str) -> bool:
    """True if the head of a file is that of an SMC file."""
    first = text.split("\n", 1)[0].strip().upper()
    return bool(
        re.match(r"[0-6] (UN)?CORRECTED ACCELEROGRAM|[34] (VELOCITY|DISPL)", first)
    )


def read_smc(path: Path, max_bytes: int = MAX_BYTES) -> Table:
    """Read a series of the SMC format."""
    lines = _lines(path)
    kind = lines[0].strip()[:1]
    if kind not in _SMC_TYPES:
        raise FileFormatError(
            f"{path} holds {lines[0].strip()!r}, not a motion",
            "Get the accelerogram, the velocity or the displacement.",
        )

    reals_from = _SMC_TEXTS + _SMC_INTEGERS
    body_from = reals_from + _SMC_REALS
    integers = _fixed(lines[_SMC_TEXTS:reals_from], 10, path)
    reals = _fixed(lines[reals_from:body_from], 15, path)
    n_points = int(integers[_SMC_POINTS])
    body = lines[body_from + int(integers[_SMC_COMMENTS]) :]
    values = _fixed(body, SMC_WIDTH, path)[:n_points]
    _require_count(path, values, n_points)

    name, unit = _SMC_TYPES[kind]
    table = _one_series(path, "SMC", name, values, unit, Clock(float(reals[_SMC_RATE])))
    return table


def _fixed(lines: list[str], width: int, path: Path) -> np.ndarray:
    """Numbers of a fixed width, which may touch each other."""
    cells: list[str] = []
    for line in lines:
        text = line.rstrip()
        cells += [text[i : i + width] for i in range(0, len(text), width)]
    try:
        return np.array(cells, dtype=float)
    except ValueError as error:
        raise FileFormatError(
            f"{path} is not made of numbers {width} characters wide ({error})",
            "Get the file again.",
        ) from error
