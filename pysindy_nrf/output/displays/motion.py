"""Figures of motion: channels of a record, free runs, modes, frequency responses."""

from typing import Any, Self

import numpy as np
import pandas as pd

from ...exceptions import ChannelError
from ...regression.errors import nrmse
from ...signals.kinematics import base_acceleration_if_any, base_motion
from ._figure import CYCLE, DASHES, Axis, Figure, Line, Mark, Table
from ._matplotlib import Display


def below(dof: int, label: str, unit: str) -> Axis:
    """The abscissa of a column of figures: labelled below the lowest, DOF 1."""
    return Axis(label, unit) if dof == 1 else Axis()


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
            x, y = below(j, "time", "s"), Axis(f"x_{{{j}}}", "m")
            x.limits = None if self.begin is None else (self.begin, self.time[-1])
            out.append(Figure(f"Free run of DOF {j}", marks, x, y, legend="above", size=(6.5, 1.4)))
        return out


def free_run_figure(free: Any, points: int = 3000) -> list[Figure]:
    """The free run over the measurement, at the DOF that moves most, about its largest motion; thinned to be drawn."""
    if free is None or not free.runs:
        return []
    (seg, run), errors = free.runs[0], free.table.iloc[0]
    x = np.cumsum(seg.s[seg.valid], axis=1)
    j = int(np.argmax(np.abs(x).max(axis=0)))
    width = min(len(x), points)
    start = int(np.clip(np.abs(x[:, j]).argmax() - width // 3, 0, len(x) - width))
    rows = slice(start, start + width, max(1, width // 1500))
    own = np.clip(run.displacement[rows, j], *(2.5 * np.abs(x[:, j]).max() * np.array([-1, 1])))
    marks: list[Mark] = [
        Line(run.time[rows], x[rows, j], "measured", "orange", 2.2),
        Line(run.time[rows], own, f"the model alone ({errors.iloc[j]:.3g} % NRMSE over the record)", "blue", 1.1),
    ]
    said = ", ".join(f"{name} {e:.3g} %" for name, e in errors.items())
    numbers = Table("Free-run error, percent NRMSE", ["DOF", "error (%)"], [*map(list, errors.items())])
    return [
        Figure(
            f"Free run: the model alone under the measured force, DOF {j + 1}", marks, Axis("time", "s"),
            Axis(f"x_{{{j + 1}}}", "m"), alt=f"Free-run error over the record, percent NRMSE: {said}.", wide=True,
            caption=f"Error over the whole record: {said}. Drawn about the largest motion.", size=(8.0, 3.0),
            height=320, table=numbers,
        )
    ]  # fmt: skip


def response_figures(f: np.ndarray, measured: np.ndarray, found: np.ndarray) -> list[Figure]:
    """Size of measured and modelled frequency responses (accelerance), one figure a DOF, the uppermost first."""
    out = []
    for j in range(measured.shape[1], 0, -1):
        marks: list[Mark] = [Line(f, np.abs(measured[:, j - 1]), "measured", "orange", 1.8)]
        marks.append(Line(f, np.abs(found[:, j - 1]), "model", "blue", 0.9, "dash"))
        x, y = below(j, "frequency", "Hz"), Axis(f"|H_{{{j}}}|", "m/s²/N", log=True)
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
