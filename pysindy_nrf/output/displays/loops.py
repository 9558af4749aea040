"""Force-drift loops of a storey, identified over measured."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...exceptions import ChannelError
from ._axes import BLUE, ORANGE, axes, number, thin


class HysteresisLoopDisplay:
    """Loops of the restoring force over the drift, identified over measured.

    Parameters
    ----------
    drift : ndarray of shape (n_samples,)
        m.
    identified : ndarray of shape (n_samples,)
        N.
    measured : ndarray of shape (n_samples,), optional
        N; the force that balances the inertia above the storey.
    site : str

    Attributes
    ----------
    ax_, figure_ : matplotlib Axes and Figure

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf.output.displays import HysteresisLoopDisplay
    >>> t = np.linspace(0, 6.3, 500)
    >>> force = 30.0 * np.sin(t) + 10.0 * np.sign(np.cos(t))  # spring and friction
    >>> display = HysteresisLoopDisplay(0.001 * np.sin(t), force, site="storey 2").plot()
    >>> display.ax_.get_xlabel(), display.ax_.get_ylabel()
    ('drift $s_{2}$ (mm)', 'force $R_{2}$ (N)')
    """

    def __init__(self, drift: Any, identified: Any, measured: Any = None, site: str = "storey 1") -> None:
        self.drift = np.asarray(drift, dtype=float)
        self.identified = np.asarray(identified, dtype=float)
        self.measured = None if measured is None else np.asarray(measured, dtype=float)
        self.site = site

    @classmethod
    def from_estimator(cls, estimator: Any, X: Any, F: Any, site: Any, **options: Any) -> HysteresisLoopDisplay:
        """Loops of a storey; "measured" is the force that balances the inertia above it with the identified masses.

        Parameters
        ----------
        estimator : fitted NRFRegressor or ChainModel
        X, F, **options
            Data, as for ``fit``.
        site : str or int
            A storey.

        Returns
        -------
        HysteresisLoopDisplay

        Raises
        ------
        ChannelError
            If the site is no storey, or the chain has further links, whose share of the balance is not known.
        """
        from ...regression.chain_model import as_model, as_segments

        model = as_model(estimator)
        place = model.chain.site(site)
        if not place.is_storey or any(model.laws[s] for s in model.laws if not s.is_storey):
            raise ChannelError(
                f"The force of {place} cannot be read off the balances above it", "Pass drift and forces yourself."
            )
        i = place.p
        data = as_segments(estimator, X, F, **options)
        drift = data.scatter([seg.s[seg.valid] for seg in data.segments])[:, i - 1]
        above = data.scatter(
            [
                (seg.F[seg.valid] - model.masses * seg.a[seg.valid])[:, i - 1 :].sum(axis=1, keepdims=True)
                for seg in data.segments
            ]
        )
        return cls(drift, model.restoring_force(data)[:, i - 1], above[:, 0], str(place))

    def plot(self, ax: Any = None) -> HysteresisLoopDisplay:
        """Draw.

        Parameters
        ----------
        ax : Axes, optional

        Returns
        -------
        self
        """
        ax, self.figure_ = axes(ax)
        s, found = thin(self.drift, self.identified)
        if self.measured is not None:
            ax.plot(1e3 * s, thin(self.measured)[0], color=ORANGE, linewidth=1.6, label="from the balances above")
        ax.plot(1e3 * s, found, color=BLUE, linewidth=0.7, label="identified")
        i = number(self.site)
        ax.set(xlabel=f"drift $s_{{{i}}}$ (mm)", ylabel=f"force $R_{{{i}}}$ (N)", title=self.site)
        ax.legend(frameon=False, fontsize="small")
        self.ax_ = ax
        return self
