"""Figures of the residual: its spectrum and the noise, and what it correlates with."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...chain.model import ChainModel
from ...common.unit_system import TRANSLATION, UnitSystem
from ...diagnosis.motions import motions_of
from ...diagnosis.residual import Filters, residual_of
from ...drawing.figure import Axis, Figure, Line, Mark, Table
from ...exceptions import NRFWarning
from ...records.dataset import Dataset, Segment
from ...records.fusion.noise_levels import levels_of, noisy_base, noisy_channels
from ...records.spectra import density

# Lags of a correlation that are drawn, and the bound of 95 % of those of white noise.
DRAWN_LAGS, BOUND_OF_CHANCE = 100, 1.96
# Samples of the longest record that is fused a second time for a picture: a second or
# two.
LONGEST_DRAW = 200_000
# Densities below this part of the largest are not drawn, as amplitudes.
FLOOR_OF_SPECTRA = 1e-4


@dataclass(frozen=True, eq=False)
class EquationResidual:
    """What a model leaves of the equation of motion of one DOF, in one record.

    Parameters
    ----------
    dof : int
    record : str
    step : float
        s; a sample each where the time is not known.
    residual : ndarray of shape (n_valid,)
        N.
    reference : ndarray of shape (n_valid,)
        The force on the DOF, or its inertia where none acts, N.
    reference_name : {"F", "m a"}
    drive : ndarray of shape (n_valid,)
        What drives the record: its largest force, or the acceleration of the base.
    drive_name : str
    noise : ndarray of shape (n_valid,), optional
        What noise of the channels leaves of the equation: one draw, N.
    """

    dof: int
    record: str
    step: float
    residual: np.ndarray
    reference: np.ndarray
    reference_name: str
    drive: np.ndarray
    drive_name: str
    noise: np.ndarray | None = None
    units: UnitSystem = TRANSLATION


def equation_residuals(
    model: ChainModel, data: Dataset, filters: Filters
) -> list[EquationResidual]:
    """Residuals of all equations of motion whose force is known, of the first record.

    Parameters
    ----------
    model : ChainModel
    data : Dataset
    filters : sequence of ZeroPhaseFilter or None
        One for each record.
    """
    residual = residual_of(model, data, filters)
    segment, band = data.segments[0], filters[0]
    rows = segment.valid
    drive, drive_name = _drive_of(segment)
    force, inertia = segment.F[rows], segment.a[rows] * model.masses
    noise = _noise_of_equations(model, data, filters)

    residuals = []
    for j in range(model.n_dof):
        unexplained = residual.balance[0][:, j]
        if not np.isfinite(unexplained).all():
            continue
        is_forced = bool(force[:, j].any())
        reference = force[:, j] if is_forced else inertia[:, j]
        if band is not None:
            reference = band.apply(reference.astype(float))
        residuals.append(
            EquationResidual(
                j + 1,
                segment.name,
                segment.dt or 1.0,
                unexplained,
                reference,
                "F" if is_forced else "m a",
                drive,
                drive_name,
                None if noise is None else noise[:, j],
                model.units,
            )
        )
    return residuals


def _drive_of(segment: Segment) -> tuple[np.ndarray, str]:
    """What drives a record: its largest force, or the acceleration of the base."""
    rows = segment.valid
    sizes = np.nan_to_num(segment.F[rows]).std(axis=0)
    if sizes.any():
        j = int(np.argmax(sizes))
        return segment.F[rows, j].astype(float), f"F{j + 1}"
    if segment.ag is not None and segment.base_moves:
        return segment.ag[rows].astype(float), "ag"
    return np.zeros(segment.n_valid), ""


def _noise_of_equations(
    model: ChainModel, data: Dataset, filters: Filters
) -> np.ndarray | None:
    """What noise of the channels leaves of the equations of the first record, N.

    One draw: noise of the level that each channel has is added once more, the channels
    are fused anew, and the residual changes by this. None for arrays and for records
    that are too long for a second fusion.

    Returns
    -------
    ndarray of shape (n_valid, n_dof) or None
    """
    segment = data.segments[0]
    if not data.records or segment.dt is None or segment.n_valid > LONGEST_DRAW:
        return None
    record = data.records[0]
    levels = levels_of(record, segment.noise)
    # the picture of a record is the same whenever it is drawn
    rng = np.random.default_rng(0)
    noisy = record.replace(
        **noisy_channels(record, levels, rng), **noisy_base(record, levels, rng)
    )
    with warnings.catch_warnings(action="ignore", category=NRFWarning):
        fused = motions_of(model, [noisy])
    if fused.segments[0].valid != segment.valid:
        return None
    residuals = []
    for shown in (data, fused):
        first = Dataset(shown.segments[:1], shown.segments[0].n_samples)
        residuals.append(residual_of(model, first, filters[:1]).balance[0])
    return residuals[1] - residuals[0]


def residual_figures(shown: EquationResidual) -> list[Figure]:
    """Spectrum of a residual and the noise, and its correlations."""
    figures = [residual_spectrum_figure(shown), autocorrelation_figure(shown)]
    if shown.drive.any():
        figures.append(cross_correlation_figure(shown))
    return figures


def residual_spectrum_figure(shown: EquationResidual) -> Figure:
    """What is left by frequency, with the force and the level of the noise."""
    fs = 1.0 / shown.step
    f, density_of_residual = density(shown.residual, fs)
    _, reference = density(shown.reference, fs)
    density_of_residual, reference = (
        np.sqrt(density_of_residual[1:]),
        np.sqrt(reference[1:]),
    )
    f = f[1:]

    name = "applied force" if shown.reference_name == "F" else "inertia m a"
    marks: list[Mark] = [
        Line(f, reference, name, "muted", 1.0),
        Line(f, density_of_residual, "residual", "blue", 1.3),
    ]
    caption = "Amplitude density of what the model leaves of this equation of motion."
    if shown.noise is not None:
        _, noise = density(shown.noise, fs)
        name = "noise of the channels"
        marks.append(Line(f, np.sqrt(noise[1:]), name, "red", 1.0, "dash"))
        caption += " Dashed: what the noise of all channels would leave."

    unit = f"{shown.units.force}/√Hz"
    largest = float(max(reference.max(), density_of_residual.max()))
    limits = (FLOOR_OF_SPECTRA * largest, 2.0 * largest) if largest > 0 else None
    return Figure(
        f"Spectrum of the residual of DOF {shown.dof}",
        marks,
        Axis("frequency", "Hz", (0, float(f[-1]))),
        Axis("amplitude density", unit, limits, log=limits is not None),
        alt=(
            f"Residual of DOF {shown.dof}, {np.std(shown.residual):.3g}"
            f" {shown.units.force} rms, by frequency."
        ),
        caption=caption,
        legend="above",
        size=(6.5, 3.0),
        table=_sizes(shown),
    )


def _sizes(shown: EquationResidual) -> Table:
    """Rms of the residual, of its reference and of what noise leaves."""
    lines = {"residual": shown.residual, shown.reference_name: shown.reference}
    if shown.noise is not None:
        lines["noise of the channels"] = shown.noise
    rows = [[name, float(np.std(line))] for name, line in lines.items()]
    head = ["what", f"rms ({shown.units.force})"]
    return Table(f"Equation of motion of DOF {shown.dof}", head, rows)


def autocorrelation_figure(shown: EquationResidual) -> Figure:
    """How far the residual remembers itself: white noise stays inside the bounds."""
    lags, values = correlation(shown.residual, shown.residual)
    of_future = lags >= 0
    title = f"Residual of DOF {shown.dof}: correlation with itself"
    return _correlation_figure(title, shown, lags[of_future], values[of_future])


def cross_correlation_figure(shown: EquationResidual) -> Figure:
    """How far the residual follows what drives."""
    lags, values = correlation(shown.residual, shown.drive)
    title = f"Residual of DOF {shown.dof}: correlation with {shown.drive_name}"
    return _correlation_figure(title, shown, lags, values)


def correlation(
    first: np.ndarray, second: np.ndarray, n_lags: int = DRAWN_LAGS
) -> tuple[np.ndarray, np.ndarray]:
    """Correlation of two lines by lag in samples; the first is late at positive lags.

    Parameters
    ----------
    first, second : ndarray of shape (n_samples,)
    n_lags : int

    Returns
    -------
    lags, values : ndarray of shape (2 n_lags + 1,)

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf.report.figures.residual import correlation
    >>> x = np.random.default_rng(0).normal(size=5000)
    >>> lags, values = correlation(np.roll(x, 3), x, 10)
    >>> int(lags[np.argmax(values)])
    3
    """
    first, second = first - first.mean(), second - second.mean()
    n = len(first)
    n_lags = min(n_lags, n - 1)
    length = 1 << (2 * n - 1).bit_length()
    product = np.fft.rfft(first, length) * np.fft.rfft(second, length).conj()
    sums = np.fft.irfft(product, length)
    lags = np.arange(-n_lags, n_lags + 1)
    size = np.sqrt((first @ first) * (second @ second))
    return lags, sums[lags] / size if size > 0 else np.zeros(len(lags))


def _correlation_figure(
    title: str, shown: EquationResidual, lags: np.ndarray, values: np.ndarray
) -> Figure:
    """Correlations by lag, with the bounds of chance."""
    bound = BOUND_OF_CHANCE / np.sqrt(len(shown.residual))
    time = lags * shown.step
    ends = [time[0], time[-1]]
    n_outside = int(np.count_nonzero(np.abs(values[lags != 0]) > bound))
    marks: list[Mark] = [Line(time, values, "", "blue", 1.1)]
    for side in (bound, -bound):
        marks.append(Line(ends, [side, side], "", "red", 0.9, "dash"))
    return Figure(
        title,
        marks,
        Axis("lag", "s"),
        Axis("correlation", limits=(-1.05, 1.05), zero=True),
        alt=f"{title}: {n_outside} of {np.count_nonzero(lags)} lags lie outside.",
        caption=(
            f"Dashed: 95 % of the correlations of white noise lie inside. Outside:"
            f" {n_outside} of {np.count_nonzero(lags)} lags."
        ),
        size=(6.5, 2.4),
        height=240,
        table=Table(
            title,
            ["lags", "outside the bounds", "largest"],
            [[len(lags), n_outside, float(np.abs(values[lags != 0]).max())]],
        ),
    )


def largest_residual(residuals: Sequence[EquationResidual]) -> EquationResidual:
    """The residual that is largest compared with its force."""

    def share(shown: EquationResidual) -> float:
        size = float(np.std(shown.reference))
        return float(np.std(shown.residual)) / size if size > 0 else 0.0

    return max(residuals, key=share)
