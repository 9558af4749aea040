"""Free run of a model against the measured motion."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...exceptions import ChannelError
from ...regression.errors import nrmse
from ._axes import BLUE, ORANGE, stacked, thin


class FreeRunDisplay:
    """Displacements a model predicts from the forces alone, over the measured ones.

    Parameters
    ----------
    time : ndarray of shape (n_samples,)
        s.
    measured, predicted : ndarray of shape (n_samples, n_dof)
        Displacement of the DOFs relative to the base, m.

    Attributes
    ----------
    ax_ : ndarray of Axes
        One for each DOF, the uppermost floor on top.
    figure_ : Figure

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf.output.displays import FreeRunDisplay
    >>> t = np.linspace(0, 10, 500)
    >>> x = 1e-3 * np.column_stack([np.sin(9 * t), 2 * np.sin(9 * t)])
    >>> display = FreeRunDisplay(t, x, 0.98 * x).plot()
    >>> display.error.round(1), len(display.ax_)  # percent NRMSE of both DOFs
    (array([2., 2.]), 2)
    """

    def __init__(self, time: Any, measured: Any, predicted: Any) -> None:
        self.time = np.asarray(time, dtype=float)
        self.measured = np.asarray(measured, dtype=float)
        self.predicted = np.asarray(predicted, dtype=float)

    @classmethod
    def from_estimator(cls, estimator: Any, record: Any, **options: Any) -> FreeRunDisplay:
        """Simulate the model under the forces of a record.

        Parameters
        ----------
        estimator : fitted NRFRegressor or ChainModel
        record : Record
            With forces, displacements and the covariates of the laws; its first sample is the initial condition.
        **options
            Passed to :func:`pysindy_nrf.simulate`.

        Returns
        -------
        FreeRunDisplay

        Raises
        ------
        ChannelError
            If the record has no displacement to compare with.
        """
        model = getattr(estimator, "model_", estimator)
        if record.displacement is None:
            raise ChannelError(
                f"Record {record.name!r} has no displacement to compare with",
                "Fuse its channels with KinematicSmoother first.",
            )
        from ...signals.kinematics import base_acceleration_if_any

        measured, rate = _relative(record)
        given = {
            "x0": measured[0],
            "base_acceleration": base_acceleration_if_any(record),
            "covariates": record.covariates,
        }
        if rate is not None:
            given["v0"] = rate[0]
        run = model.simulate(record.force, record.dt, **(given | options))
        return cls(record.time, measured, run.displacement)

    @property
    def error(self) -> np.ndarray:
        """Free-run error of every DOF, percent NRMSE."""
        return np.array([nrmse(self.measured[:, j], self.predicted[:, j]) for j in range(self.measured.shape[1])])

    def plot(self, ax: Any = None) -> FreeRunDisplay:
        """Draw.

        Parameters
        ----------
        ax : Axes or array of Axes, optional

        Returns
        -------
        self
        """
        n = self.measured.shape[1]
        ax, self.figure_ = stacked(ax, n, (6.5, 1.3 * n + 0.6))
        errors = self.error
        for axis, j in zip(ax, range(n - 1, -1, -1)):
            t, x, y = thin(self.time, 1e3 * self.measured[:, j], 1e3 * self.predicted[:, j])
            axis.plot(t, x, color=ORANGE, linewidth=1.6, label="measured")
            axis.plot(t, y, color=BLUE, linewidth=0.8, linestyle="--", label=f"free run ({errors[j]:.2g} % NRMSE)")
            axis.set_ylabel(f"$x_{{{j + 1}}}$ (mm)")
            axis.legend(
                frameon=False, fontsize="x-small", loc="lower right", bbox_to_anchor=(1, 1), borderaxespad=0.2, ncols=2
            )
        ax[-1].set_xlabel("time (s)")
        self.ax_ = ax
        return self


def _relative(record: Any) -> tuple[np.ndarray, np.ndarray | None]:
    """Displacement and, if measured, velocity of the DOFs relative to the base."""
    if record.coordinates == "relative" or not record.base_moves:
        return record.displacement, record.velocity
    from ...signals.kinematics import base_motion

    vg, xg = base_motion(record, record, not {"vg", "xg"} <= set(record.measured))
    return record.displacement - xg[:, None], None if record.velocity is None else record.velocity - vg[:, None]
