"""The force of a nonlinear device by subtraction (paper eq. 21)."""

from __future__ import annotations

from typing import Any

import pandas as pd

from ..regression.analysis_inputs import as_model, as_segments, frame, storey_names


def damper_force(model: Any, linear: Any, X: Any, **options: Any) -> pd.DataFrame:
    r"""Identified force of every storey less that of the bare structure (paper eq. 21).

    .. math:: F_{non} = R^{non}(v, s) - R^{lin}(v, s)

    Parameters
    ----------
    model : ChainModel or fitted NRFRegressor
        Of the structure with its devices.
    linear : ChainModel or fitted NRFRegressor
        Of the structure without them: see :func:`linear_twin`.
    X, **options
        The motion, as for :meth:`ChainModel.predict`.

    Returns
    -------
    DataFrame of shape (n_samples, n_dof)
        ``storey 1``.., N, indexed by time where it is known.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf import ChainModel, laws
    >>> from pysindy_nrf.estimation import damper_force
    >>> bare = ChainModel([10.0], {1: laws.PowerSeries(1, [100.0, 1e5])})
    >>> damped = ChainModel([10.0], {1: [laws.PowerSeries(1, [150.0, 1e5]), laws.CubicStiffness(1e9)]})
    >>> X = np.array([[0.0, 0.1, 0.001]])  # a, v, s
    >>> damper_force(damped, bare, X)["storey 1"].round(6).tolist()  # 50 v + 1e9 s^3
    [6.0]
    """
    whole, bare = as_model(model), as_model(linear)
    data = as_segments(model, X, **options)
    forces = whole.restoring_force(data) - bare.restoring_force(data)
    return frame(data, [forces[seg.rows][seg.valid] for seg in data.segments], storey_names(whole))
