"""Figures of a record as it was measured: over time, by frequency, coherence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..drawing.figure import CYCLE, DASHES, Axis, Figure, Line, Mark, Table
from ..drawing.thinning import DRAWN_POINTS, thinned
from .channels import finite_span
from .files.summary import unit_of
from .record import Record
from .spectra import density, spectra_of

# Kinds of channels in the order in which they are drawn, by the letter of their names.
_KINDS = {
    "F": "Forces",
    "a": "Accelerations",
    "v": "Velocities",
    "x": "Displacements",
    "": "Further channels",
}
# Height of the axes of one channel: on the page, pixels, and on the sheet, inches.
PANEL_HEIGHT, PANEL_INCHES = 96, 1.3
# Points of all channels of a record: a page of thirty channels stays below 2 MB.
POINTS_OF_RECORD = 5_000
# Smallest part of the largest density that is drawn, as an amplitude.
FLOOR_OF_SPECTRA = 1e-5

Band = tuple[float | None, float | None] | None


def channels_by_kind(record: Record) -> dict[str, dict[str, np.ndarray]]:
    """Channels of each kind that move or act, by letter and by name."""
    by_kind: dict[str, dict[str, np.ndarray]] = {letter: {} for letter in _KINDS}
    for name, line in record.channels().items():
        is_covariate = name in record.covariates
        letter = "" if is_covariate or name[0] not in _KINDS else name[0]
        if letter != "F" or np.nan_to_num(line).any():
            by_kind[letter][name] = line
    return {letter: lines for letter, lines in by_kind.items() if lines}


def time_figures(
    record: Record, doubts: Mapping[str, Sequence[str]] | None = None
) -> list[Figure]:
    """Channels over time, one figure a kind, one pair of axes a channel.

    Parameters
    ----------
    record : Record
    doubts : mapping of str to sequence of str, optional
        What is doubtful, by channel; such channels are drawn in red.
    """
    shown = record.by_sample()
    clock = Axis("time", "s") if record.has_clock else Axis("sample")
    by_kind = channels_by_kind(record)
    n_channels = sum(map(len, by_kind.values()))
    n_points = min(DRAWN_POINTS, POINTS_OF_RECORD // max(1, n_channels))
    figures = []
    for letter, lines in by_kind.items():
        panels = []
        for name, line in lines.items():
            is_doubtful = name in (doubts or {})
            panels.append(_panel(shown, name, line, is_doubtful, n_points))
        panels[-1] = _with_clock(panels[-1], clock)
        title = f"{_KINDS[letter]} of {record.name}"
        doubtful = [name for name in lines if name in (doubts or {})]
        figures.append(_stacked(title, panels, doubtful, _sizes(lines)))
    return figures


def _panel(
    record: Record, name: str, line: np.ndarray, is_doubtful: bool, n_points: int
) -> Figure:
    """One channel over time."""
    color = "red" if is_doubtful else "blue"
    unit = "" if name in record.covariates else _unit_of(record, name)
    label = f"{name}, in doubt" if is_doubtful else name
    mark = Line(*thinned(record.time, line, n_points), color=color, width=0.8)
    return Figure(
        name,
        [mark],
        Axis(),
        Axis(label, unit),
        size=(6.5, PANEL_INCHES),
        height=PANEL_HEIGHT,
    )


def _unit_of(record: Record, channel: str) -> str:
    """SI unit of a channel as it is printed."""
    return unit_of(record, channel).replace("^2", "²")


def _with_clock(panel: Figure, clock: Axis) -> Figure:
    """The lowest axes, which carry the label of the time."""
    return Figure(
        panel.title,
        panel.marks,
        clock,
        panel.y,
        size=panel.size,
        height=panel.height + 40,
    )


def _sizes(lines: Mapping[str, np.ndarray]) -> Table:
    """Range of each channel, SI units."""
    rows = []
    for name, line in lines.items():
        values = line.astype(float)
        numbers = [np.nanmin(values), np.nanmax(values), np.nanmean(values)]
        rows.append([name, *map(float, numbers), float(np.nanstd(values))])
    head = ["channel", "smallest", "largest", "mean", "standard deviation"]
    return Table("Range of the channels, SI units", head, rows)


def _stacked(
    title: str, panels: Sequence[Figure], doubtful: Sequence[str], numbers: Table
) -> Figure:
    """Axes below each other as one figure."""
    first, *others = panels
    caption = "As measured, in SI units; the extremes of every stretch are drawn."
    if doubtful:
        caption += f" Red, in doubt: {', '.join(doubtful)}."
    names = ", ".join(panel.title for panel in panels)
    return Figure(
        title,
        first.marks,
        first.x,
        first.y,
        alt=f"{title} over time: {names}.",
        caption=caption,
        size=first.size,
        height=first.height,
        wide=len(panels) > 2,
        table=numbers,
        below=tuple(others),
    )


def spectrum_figures(record: Record, band: Band = None) -> list[Figure]:
    """Amplitude densities of the channels, one figure a kind.

    Parameters
    ----------
    record : Record
    band : (float or None, float or None), optional
        Band that was used, Hz; its ends are marked.
    """
    if not record.has_clock:
        return []
    figures = []
    for letter, lines in channels_by_kind(record).items():
        if letter:
            figures.append(_spectrum_figure(record, letter, lines, band))
    return figures


def _spectrum_figure(
    record: Record, letter: str, lines: Mapping[str, np.ndarray], band: Band
) -> Figure:
    """Densities of channels of one kind."""
    marks: list[Mark] = []
    largest, smallest = 0.0, np.inf
    strongest = []
    for k, (name, line) in enumerate(lines.items()):
        f, amplitude = _amplitudes(line, record.fs)
        marks.append(_line_of(k, name, f, amplitude))
        largest = max(largest, float(amplitude.max()))
        k_max = int(np.argmax(amplitude))
        strongest.append([name, float(f[k_max]), float(amplitude[k_max])])
        smallest = min(smallest, float(amplitude.min()))
    low = max(smallest, FLOOR_OF_SPECTRA * largest)
    limits = (0.5 * low, 2.0 * largest) if largest > 0 else None
    if limits is not None:
        marks += _ends_of_band(band, limits)

    kind = _KINDS[letter]
    unit = f"{_unit_of(record, next(iter(lines)))}/√Hz"
    return Figure(
        f"Spectra: {kind.lower()} of {record.name}",
        marks,
        Axis("frequency", "Hz", (0, float(f[-1]))),
        Axis("amplitude density", unit, limits, log=limits is not None),
        alt=f"Amplitude density of {', '.join(lines)} over frequency.",
        caption=f"Welch's averages.{_words_of_band(band)}",
        legend="above",
        size=(6.5, 3.0),
        table=Table(
            "Strongest frequency of each channel",
            ["channel", "frequency (Hz)", f"amplitude density ({unit})"],
            strongest,
        ),
    )


def _amplitudes(line: np.ndarray, fs: float) -> tuple[np.ndarray, np.ndarray]:
    """Amplitude density of a channel above zero frequency, inside its NaN edges."""
    inside = line[finite_span([line], ["channel"])].astype(float)
    f, power = density(inside - inside.mean(), fs)
    return f[1:], np.sqrt(power[1:])


def _line_of(number: int, name: str, f: np.ndarray, values: np.ndarray) -> Line:
    """A line by frequency, with colour and dash by its number."""
    color = CYCLE[number % len(CYCLE)]
    dash = DASHES[number // len(CYCLE) % len(DASHES)]
    return Line(f, values, name, color, 1.0, dash)


def _ends_of_band(band: Band, limits: tuple[float, float]) -> list[Mark]:
    """Upright lines at the ends of a band."""
    marks: list[Mark] = []
    for end in band or ():
        if end:
            marks.append(Line([end, end], limits, "", "muted", 1.2, "dot"))
    return marks


def _words_of_band(band: Band) -> str:
    if band is None or band == (None, None):
        return ""
    return " Dotted: the ends of the band in which everything is fitted and judged."


def coherence_figure(record: Record) -> Figure | None:
    """Share of each motion that follows the forces and the base, by frequency.

    None without a clock, without anything that drives, or without accelerations,
    velocities or displacements.
    """
    if not record.has_clock:
        return None
    inputs, outputs = driving_and_answering(record)
    if not inputs or not outputs:
        return None
    columns = {**inputs, **outputs}
    rows = finite_span(list(columns.values()), list(columns), record.name)
    spectra = spectra_of(_matrix(inputs, rows), _matrix(outputs, rows), record.fs)

    marks: list[Mark] = []
    shares = spectra.coherence[1:]
    medians = []
    for k, name in enumerate(outputs):
        medians.append([name, float(np.median(shares[:, k]))])
        marks.append(_line_of(k, name, spectra.f[1:], shares[:, k]))
    driven = " and ".join(inputs)
    return Figure(
        f"Coherence of the motion with {driven}, {record.name}",
        marks,
        Axis("frequency", "Hz", (0, float(spectra.f[-1]))),
        Axis("coherence", limits=(0, 1.02)),
        alt=f"Coherence of {', '.join(outputs)} with {driven} over frequency.",
        caption=(
            "Share of each channel that follows linearly what drives. Noise, a force"
            " that was not measured, nonlinear forces and modes narrower than a line"
            " lower it."
        ),
        legend="above",
        size=(6.5, 3.0),
        table=Table("Coherence", ["channel", "median over frequency"], medians),
    )


def driving_and_answering(
    record: Record,
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Channels that drive, and for each floor the motion that was measured.

    Of a floor with several motions the acceleration counts, then the displacement.
    """
    channels = record.channels()
    inputs = {}
    for name in (*(f"F{j}" for j in record.forced), "ag"):
        if name in channels:
            inputs[name] = channels[name]
    outputs = {}
    for j in range(1, record.n_dof + 1):
        measured = [f"{kind}{j}" for kind in "axv" if f"{kind}{j}" in channels]
        if measured:
            outputs[measured[0]] = channels[measured[0]]
    return inputs, outputs


def _matrix(lines: Mapping[str, np.ndarray], rows: slice) -> np.ndarray:
    """Channels as columns without their means."""
    columns = np.column_stack([line[rows].astype(float) for line in lines.values()])
    return columns - columns.mean(axis=0)
