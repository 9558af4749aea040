"""Dissipated energy over time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ._axes import CYCLE, STYLES, axes, thin


class EnergyDisplay:
    """Dissipated energy over time (paper Figs. 13, 16).

    Parameters
    ----------
    time : ndarray of shape (n_samples,)
        s.
    energy : mapping of str to ndarray of shape (n_samples,)
        J, by the name that stands in the legend.

    Attributes
    ----------
    ax_, figure_ : matplotlib Axes and Figure

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf.output.displays import EnergyDisplay
    >>> t = np.linspace(0, 10, 500)
    >>> display = EnergyDisplay(t, {"identified": 2.0 * t, "true": 2.1 * t}).plot()
    >>> display.ax_.get_ylabel(), len(display.ax_.lines)
    ('dissipated energy (J)', 2)
    """

    def __init__(self, time: Any, energy: Mapping[str, Any]) -> None:
        self.time = np.asarray(time, dtype=float)
        self.energy = {name: np.asarray(line, dtype=float) for name, line in energy.items()}

    @classmethod
    def from_estimator(cls, estimator: Any, X: Any, without: Any = None, **options: Any) -> EnergyDisplay:
        """Energy dissipated in every storey; see :func:`pysindy_nrf.estimation.dissipated_energy`.

        Parameters
        ----------
        estimator : fitted NRFRegressor or ChainModel
        X, **options
            The motion.
        without : fitted NRFRegressor or ChainModel, optional
            Model of the bare structure, subtracted.

        Returns
        -------
        EnergyDisplay
        """
        from ...estimation import dissipated_energy

        table = dissipated_energy(estimator, X, without, **options)
        return cls(table.index.to_numpy(dtype=float), {name: table[name].to_numpy() for name in table})

    def plot(self, ax: Any = None) -> EnergyDisplay:
        """Draw.

        Parameters
        ----------
        ax : Axes, optional

        Returns
        -------
        self
        """
        ax, self.figure_ = axes(ax)
        for k, (name, line) in enumerate(self.energy.items()):
            t, e = thin(self.time, line)
            ax.plot(t, e, color=CYCLE[k % len(CYCLE)], linestyle=STYLES[k % len(STYLES)], label=name)
        ax.set(xlabel="time (s)", ylabel="dissipated energy (J)")
        ax.legend(frameon=False, fontsize="small")
        self.ax_ = ax
        return self
