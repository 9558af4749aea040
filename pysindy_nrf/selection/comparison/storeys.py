"""What each model makes of every storey, in the same terms."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from ...laws import PowerSeries
from ...laws.motion import Motion
from .data import Part

ELSEWHERE = "other"


def term_shares(forces: Mapping[str, np.ndarray], part: Part, degree: int, size: np.ndarray) -> pd.DataFrame:
    """Storey forces of each model, taken apart into the terms of their own storey.

    A model that finds accelerations has no storey laws; its storey forces follow from the balances. They
    are projected on the terms v^h s^j of their storey by least squares; what these cannot hold comes from
    other storeys, from products between storeys, or from the excitation.

    Parameters
    ----------
    forces : mapping of str to ndarray of shape (n_samples, n_dof)
        N, by model.
    part : Part
        The data on which the forces were found.
    degree : int
        Total degree of the terms.
    size : ndarray of shape (n_dof,)
        Rms of each storey's force, N.

    Returns
    -------
    DataFrame
        One row for each (storey, term) and one for the rest of each storey, one column for each model:
        coefficient times the rms of its term, as a share of ``size``.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf.selection.comparison import term_shares
    >>> from pysindy_nrf.selection.comparison.data import Part
    >>> t = np.arange(2000)[:, None] / 200
    >>> s, v = 0.001 * np.sin(9 * t), 0.009 * np.cos(9 * t)
    >>> R = 30.0 * v + 4e4 * s
    >>> shares = term_shares({"truth": R}, Part(-81 * s, v, s, R, 0.005), 1, np.sqrt(np.mean(R**2, axis=0)))
    >>> shares["truth"].round(3).to_dict()
    {('storey 1', 'v'): 0.007, ('storey 1', 's'): 1.0, ('storey 1', 'other'): 0.0}
    """
    law, rows = PowerSeries(degree), {}
    labels = [term.label for term in law.terms()]
    for i in range(part.n_dof):
        columns = law.features(Motion(part.s[:, i], part.v[:, i]))
        scale = np.sqrt(np.mean(columns**2, axis=0))
        scale[scale == 0] = 1.0
        wanted = np.column_stack([R[:, i] for R in forces.values()])
        found = np.linalg.lstsq(columns / scale, wanted, rcond=None)[0]
        left = np.sqrt(np.mean((wanted - columns / scale @ found) ** 2, axis=0))
        for label, row in zip([*labels, ELSEWHERE], np.vstack([found, left]) / size[i]):
            rows[f"storey {i + 1}", label] = row
    index = pd.MultiIndex.from_tuples(rows, names=["site", "term"])
    return pd.DataFrame(np.array(list(rows.values())), index=index, columns=list(forces))
