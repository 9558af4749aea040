"""Force of a device in a storey, identified by subtraction, over time, drift or rate."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...exceptions import ChannelError
from ._axes import BLUE, ORANGE, axes, number, thin

_ABSCISSA = {
    "time": ("time (s)", 1.0),
    "drift": ("drift $s_{{{i}}}$ (mm)", 1e3),
    "rate": ("rate $v_{{{i}}}$ (m/s)", 1.0),
}


class DamperForceDisplay:
    """Device force of one storey, identified and true or measured (paper Figs. 4, 5, 7, 8, 12, 15).

    Parameters
    ----------
    abscissa : ndarray of shape (n_samples,)
        Time (s), drift (m) or rate (m/s).
    identified : ndarray of shape (n_samples,)
        N.
    measured : ndarray of shape (n_samples,), optional
        N.
    site : str
    over : {"time", "drift", "rate"}

    Attributes
    ----------
    ax_, figure_ : matplotlib Axes and Figure

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf.output.displays import DamperForceDisplay
    >>> t = np.linspace(0, 6.3, 500)
    >>> found, true = 20.0 * np.tanh(9 * np.cos(t)), 20.0 * np.sign(np.cos(t))
    >>> display = DamperForceDisplay(t, found, true, over="time").plot()
    >>> display.ax_.get_xlabel(), display.ax_.get_ylabel()
    ('time (s)', 'damper force (N)')
    """

    def __init__(
        self, abscissa: Any, identified: Any, measured: Any = None, site: str = "storey 1", over: str = "drift"
    ) -> None:
        self.abscissa = np.asarray(abscissa, dtype=float)
        self.identified = np.asarray(identified, dtype=float)
        self.measured = None if measured is None else np.asarray(measured, dtype=float)
        self.site = site
        self.over = over

    @classmethod
    def from_estimator(
        cls, estimator: Any, linear: Any, X: Any, site: Any, measured: Any = None, over: str = "drift", **options: Any
    ) -> DamperForceDisplay:
        """Device force by subtraction (paper eq. 21).

        Parameters
        ----------
        estimator, linear : fitted NRFRegressor or ChainModel
            Of the structure with and without its devices.
        X, **options
            The motion.
        site : str or int
            A storey.
        measured : ndarray of shape (n_samples,), optional
            N.
        over : {"time", "drift", "rate"}

        Returns
        -------
        DamperForceDisplay

        Raises
        ------
        ChannelError
            If ``over`` is none of these.
        """
        from ...estimation import damper as damper_force
        from ...regression.chain_model import as_model, as_segments

        if over not in _ABSCISSA:
            raise ChannelError(f"over={over!r} is unknown", f"Choose one of {', '.join(_ABSCISSA)}.")
        place = as_model(estimator).chain.site(site)
        force = damper_force(estimator, linear, X, **options)
        data = as_segments(estimator, X, **options)
        if over == "time":
            abscissa = force.index.to_numpy()
        else:
            key = "s" if over == "drift" else "v"
            abscissa = data.scatter([getattr(seg, key)[seg.valid] for seg in data.segments])[:, place.p - 1]
        return cls(abscissa, force[str(place)].to_numpy(), measured, str(place), over)

    def plot(self, ax: Any = None) -> DamperForceDisplay:
        """Draw.

        Parameters
        ----------
        ax : Axes, optional

        Returns
        -------
        self
        """
        ax, self.figure_ = axes(ax)
        text, factor = _ABSCISSA[self.over]
        x, found = thin(factor * self.abscissa, self.identified)
        if self.measured is not None:
            ax.plot(x, thin(self.measured)[0], color=ORANGE, linewidth=1.4, label="true")
        ax.plot(x, found, color=BLUE, linewidth=0.6, label="identified")
        ax.set(xlabel=text.format(i=number(self.site)), ylabel="damper force (N)", title=self.site)
        ax.margins(y=0.16)
        ax.legend(frameon=False, fontsize="small", loc="upper left", ncols=2, borderaxespad=0.1)
        self.ax_ = ax
        return self
