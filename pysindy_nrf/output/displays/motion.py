"""Figures of motion: channels of a record, free runs, modes, frequency responses."""

from typing import Any, Self

import numpy as np
import pandas as pd
from scipy.signal import welch

from ...exceptions import ChannelError
from ...regression.errors import nrmse
from ...signals.kinematics import base_acceleration_if_any, base_motion
from ._figure import CYCLE, DASHES, Axis, Figure, Line, Mark, Rule
from ._matplotlib import Display

_KINDS = {"force": ("F", "N"), "acceleration": ("a", "m/s²"), "velocity": ("v", "m/s"), "displacement": ("x", "m")}


def _below(dof: int, label: str, unit: str) -> Axis:
    """The abscissa of a column of figures: labelled below the lowest, DOF 1."""
    return Axis(label, unit) if dof == 1 else Axis()


class RecordDisplay(Display):
    """Measured channels of one kind over time, one line of axes for each DOF (paper Figs. 2, 10).

    Parameters
    ----------
    record : Record
    kind : {"force", "acceleration", "velocity", "displacement"}

    Examples
    --------
    >>> from pysindy_nrf import datasets, displays
    >>> display = displays.RecordDisplay(datasets.load_demo(), "displacement").plot()
    >>> display.ax_[-1].get_xlabel(), [axis.get_ylabel() for axis in display.ax_]
    ('time (s)', ['$x_{3}$ (mm)', '$x_{2}$ (mm)', '$x_{1}$ (mm)'])
    """

    _columns = 1

    def __init__(self, record: Any, kind: str = "acceleration") -> None:
        self.record, self.kind = record, kind

    def figures(self) -> list[Figure]:
        values, (symbol, unit) = getattr(self.record, self.kind), _KINDS[self.kind]
        out = []
        for j in range(self.record.n_dof, 0, -1):
            known = values is not None and not np.isnan(values[:, j - 1]).all()
            color = "red" if symbol == "F" else "blue"
            marks: list[Mark] = [Line(self.record.time, values[:, j - 1], color=color, width=0.7)] if known else []
            y = Axis(f"{symbol}_{{{j}}}" if known else f"{symbol}_{{{j}}}, not measured", unit)
            out.append(Figure(f"{self.kind} of DOF {j}", marks, _below(j, "time", "s"), y, size=(6.5, 1.2)))
        return out


class FreeRunDisplay(Display):
    """Displacements a model predicts from the forces alone, over the measured ones.

    Parameters
    ----------
    time : ndarray of shape (n_samples,)
        s.
    measured, predicted : ndarray of shape (n_samples, n_dof)
        Displacement of the DOFs relative to the base, m.
    begin : float, optional
        Where the drawing begins, s; the error is that of the whole record.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf.output.displays import FreeRunDisplay
    >>> t = np.linspace(0, 10, 500)
    >>> x = 1e-3 * np.column_stack([np.sin(9 * t), 2 * np.sin(9 * t)])
    >>> FreeRunDisplay(t, x, 0.98 * x).plot().error.round(1)  # percent NRMSE of both DOFs
    array([2., 2.])
    """

    _columns = 1

    def __init__(self, time: Any, measured: Any, predicted: Any, begin: float | None = None) -> None:
        self.time, self.begin = np.asarray(time, dtype=float), begin
        self.measured, self.predicted = np.asarray(measured, dtype=float), np.asarray(predicted, dtype=float)

    @classmethod
    def from_estimator(cls, estimator: Any, record: Any, **options: Any) -> Self:
        """Simulate the model under the forces of a record.

        Parameters
        ----------
        estimator : fitted NRFRegressor or ChainModel
        record : Record
            With forces, displacements and the covariates of the laws; its first sample is the initial condition.
        **options
            Passed to :func:`pysindy_nrf.simulate`.

        Raises
        ------
        ChannelError
            If the record has no displacement to compare with.
        """
        if record.displacement is None:
            cure = "Fuse its channels with KinematicSmoother first."
            raise ChannelError(f"Record {record.name!r} has no displacement to compare with", cure)
        measured, rate = record.displacement, record.velocity
        if record.coordinates == "absolute" and record.base_moves:  # all relative to the base
            vg, xg = base_motion(record, record, not {"vg", "xg"} <= set(record.measured))
            measured, rate = measured - xg[:, None], None if rate is None else rate - vg[:, None]
        given = {"x0": measured[0], "v0": None if rate is None else rate[0], "covariates": record.covariates}
        given |= {"base_acceleration": base_acceleration_if_any(record)} | options
        run = getattr(estimator, "model_", estimator).simulate(record.force, record.dt, **given)
        return cls(record.time, measured, run.displacement)

    @property
    def error(self) -> np.ndarray:
        """Free-run error of every DOF, percent NRMSE."""
        return np.array([nrmse(x, own) for x, own in zip(self.measured.T, self.predicted.T)])

    def figures(self) -> list[Figure]:
        out = []
        for j, error in reversed(list(enumerate(self.error, 1))):
            marks: list[Mark] = [
                Line(self.time, self.measured[:, j - 1], "measured", "orange", 1.6),
                Line(self.time, self.predicted[:, j - 1], f"free run ({error:.2g} % NRMSE)", "blue", 0.8, "dash"),
            ]
            x, y = _below(j, "time", "s"), Axis(f"x_{{{j}}}", "m")
            x.limits = None if self.begin is None else (self.begin, self.time[-1])
            out.append(Figure(f"Free run of DOF {j}", marks, x, y, legend="above", size=(6.5, 1.4)))
        return out


def response_figures(f: np.ndarray, measured: np.ndarray, found: np.ndarray) -> list[Figure]:
    """Size of measured and modelled frequency responses (accelerance), one figure a DOF, the uppermost first."""
    out = []
    for j in range(measured.shape[1], 0, -1):
        marks: list[Mark] = [Line(f, np.abs(measured[:, j - 1]), "measured", "orange", 1.8)]
        marks.append(Line(f, np.abs(found[:, j - 1]), "model", "blue", 0.9, "dash"))
        x, y = _below(j, "frequency", "Hz"), Axis(f"|H_{{{j}}}|", "m/s²/N", log=True)
        out.append(Figure(f"Accelerance of DOF {j}", marks, x, y, legend="above", size=(8.0, 2.1)))
    return out


def modes_figure(modes: pd.DataFrame) -> Figure:
    """Shapes of the linear part's first six modes, floor over displacement."""
    floors = [c for c in modes.columns if str(c).startswith("dof")]
    shown = modes.head(6)
    at = np.arange(len(floors) + 1)
    marks: list[Mark] = [
        Line([0.0, *row[floors]], at, f"{row['frequency']:.4g} Hz, damping {100 * row['damping']:.2g} %",
             CYCLE[k % 6], 1.5, DASHES[k % 6], "o")
        for k, (_, row) in enumerate(shown.iterrows())
    ]  # fmt: skip
    said = "; ".join(f"mode {i} at {row['frequency']:.4g} Hz" for i, row in shown.iterrows())
    return Figure(
        "Mode shapes of the linear part", marks, Axis("mode shape (largest entry 1)", zero=True),
        Axis(ticks=["base", *(f"DOF {f[4:]}" for f in floors)]), alt=f"Shapes of the modes, largest entry 1: {said}.",
        legend="above", height=120 + 58 * len(floors),
    )  # fmt: skip


class ModesDisplay(Display):
    """Shapes of the linear part's modes, and the measured spectrum with their frequencies.

    Parameters
    ----------
    modes : DataFrame
        As of :meth:`ChainModel.modes`.
    frequency, spectrum : ndarray, optional
        Hz, and the acceleration spectrum by DOF, shape (n_frequencies, n_dof), (m/s^2)/sqrt(Hz).

    Examples
    --------
    >>> from pysindy_nrf import datasets, displays
    >>> len(displays.ModesDisplay.from_estimator(datasets.demo_truth()).modes)
    3
    """

    _columns = 2

    def __init__(self, modes: pd.DataFrame, frequency: Any = None, spectrum: Any = None) -> None:
        self.modes, self.frequency, self.spectrum = modes, frequency, spectrum

    @classmethod
    def from_estimator(cls, estimator: Any, record: Any = None) -> Self:
        """Modes of a fitted regressor or model.

        Parameters
        ----------
        estimator : fitted NRFRegressor or ChainModel
        record : Record, optional
            With accelerations, for the spectrum.
        """
        modes = getattr(estimator, "model_", estimator).modes()
        if record is None or record.acceleration is None:
            return cls(modes)
        f, power = welch(record.acceleration, record.fs, nperseg=min(record.n_samples, int(8 * record.fs)), axis=0)
        return cls(modes, f, np.sqrt(power))

    def figures(self) -> list[Figure]:
        shapes = modes_figure(self.modes)
        if self.spectrum is None:
            return [shapes]
        shown = (self.frequency > 0) & (self.frequency < 2.5 * self.modes["frequency"].max())
        f, spectrum = self.frequency[shown], self.spectrum[shown]
        marks: list[Mark] = [Rule(f) for f in self.modes["frequency"]]
        marks += [Line(f, line, f"a_{{{j}}}", CYCLE[j % 6 - 1], 0.9) for j, line in enumerate(spectrum.T, 1)]
        y = Axis("acceleration", "(m/s²)/√Hz", (0.5 * spectrum.min(), 2 * spectrum.max()), log=True)
        return [shapes, Figure("Spectrum of the accelerations", marks, Axis("frequency", "Hz", (0, f[-1])), y)]
