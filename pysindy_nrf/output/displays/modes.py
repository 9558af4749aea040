"""Mode shapes, and the spectrum they stand beside."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from ...common.extras import require
from ._axes import CYCLE, STYLES


class ModesDisplay:
    """Shapes of the linear part's modes, and the measured spectrum with their frequencies.

    Parameters
    ----------
    modes : DataFrame
        As of :meth:`ChainModel.modes`.
    frequency, spectrum : ndarray, optional
        Hz, and the acceleration spectrum by DOF, shape (n_frequencies, n_dof), (m/s^2)/sqrt(Hz).

    Attributes
    ----------
    ax_ : ndarray of Axes
        The shapes; the spectrum, if there is one.
    figure_ : Figure

    Examples
    --------
    >>> from pysindy_nrf import datasets
    >>> from pysindy_nrf.output.displays import ModesDisplay
    >>> len(ModesDisplay.from_estimator(datasets.demo_truth()).modes)
    3
    """

    def __init__(self, modes: pd.DataFrame, frequency: Any = None, spectrum: Any = None) -> None:
        self.modes = modes
        self.frequency = frequency
        self.spectrum = spectrum

    @classmethod
    def from_estimator(cls, estimator: Any, record: Any = None) -> ModesDisplay:
        """Modes of a fitted regressor or model.

        Parameters
        ----------
        estimator : fitted NRFRegressor or ChainModel
        record : Record, optional
            With accelerations, for the spectrum.

        Returns
        -------
        ModesDisplay
        """
        modes = getattr(estimator, "model_", estimator).modes()
        if record is None or record.acceleration is None:
            return cls(modes)
        from scipy.signal import welch

        f, power = welch(record.acceleration, record.fs, nperseg=min(record.n_samples, int(8 * record.fs)), axis=0)
        return cls(modes, f, np.sqrt(power))

    def plot(self, ax: Any = None) -> ModesDisplay:
        """Draw.

        Parameters
        ----------
        ax : array of one or two Axes, optional

        Returns
        -------
        self
        """
        columns = 1 if self.spectrum is None else 2
        if ax is None:
            plt = require("matplotlib.pyplot", "plot", "Drawing")
            figure, ax = plt.subplots(1, columns, squeeze=False, figsize=(4.2 * columns, 3.4), layout="constrained")
        ax = np.atleast_1d(np.asarray(ax, dtype=object)).ravel()
        self.figure_ = ax[0].figure
        shapes = self.modes[[c for c in self.modes if str(c).startswith("dof")]].to_numpy()
        floors = np.arange(shapes.shape[1] + 1)
        for k, shape in enumerate(shapes):
            row = self.modes.iloc[k]
            label = f"{row['frequency']:.2f} Hz, {100 * row['damping']:.2g} %"
            ax[0].plot(
                [0, *shape],
                floors,
                marker="o",
                markersize=4,
                color=CYCLE[k % len(CYCLE)],
                linestyle=STYLES[k % len(STYLES)],
                label=label,
            )
        ax[0].axvline(0, color="0.8", linewidth=0.8, zorder=0)
        ax[0].set(xlabel="mode shape (largest entry 1)", ylabel="floor", yticks=floors)
        ax[0].legend(
            frameon=False,
            fontsize="x-small",
            title="frequency, damping",
            title_fontsize="x-small",
            loc="upper left",
            bbox_to_anchor=(0, 1),
        )
        ax[0].set_ylim(-0.1, floors[-1] * 1.35)
        if self.spectrum is not None:
            for j in range(self.spectrum.shape[1]):
                ax[1].semilogy(
                    self.frequency,
                    self.spectrum[:, j],
                    color=CYCLE[j % len(CYCLE)],
                    linewidth=0.9,
                    label=f"$a_{{{j + 1}}}$",
                )
            for f in self.modes["frequency"]:
                ax[1].axvline(f, color="0.5", linestyle=":", linewidth=0.9)
            top = 2.5 * self.modes["frequency"].max()
            shown = (self.frequency > 0) & (self.frequency < top)
            low, high = self.spectrum[shown].min(), self.spectrum[shown].max()
            ax[1].set(
                xlabel="frequency (Hz)",
                ylabel="acceleration ((m/s$^2$)/$\\sqrt{\\mathrm{Hz}}$)",
                xlim=(0, top),
                ylim=(0.5 * low, 2 * high),
            )
            ax[1].legend(frameon=False, fontsize="x-small", ncols=2)
        self.ax_ = ax
        return self
