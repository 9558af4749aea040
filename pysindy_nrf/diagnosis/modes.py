"""Modes at the measured amplitude, and how alike the modes of two models are."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from ..chain.model import ChainModel
from ..laws.elastic import LinearElastic, LinearViscous
from .site_loops import SiteLoop


def equivalent_modes(model: ChainModel, loops: Sequence[SiteLoop]) -> pd.DataFrame:
    """Modes of the linear chain that is nearest to a model along its strongest motion.

    Each site gets the spring and the dashpot whose force differs least, in the mean
    square and up to a constant, from that of its laws along some cycles about the
    largest drift (Caughey 1963, equivalent linearization). A hysteresis adds damping to
    that of the linear part, and a hardening spring raises the frequency.

    Parameters
    ----------
    model : ChainModel
    loops : sequence of SiteLoop
        Forces of all sites with a law along the data.

    Returns
    -------
    DataFrame
        As returned by :meth:`ChainModel.modes`.

    Raises
    ------
    ChainError
        If a mass is not positive.

    Examples
    --------
    >>> from pysindy_nrf import NRFRegressor, datasets
    >>> from pysindy_nrf.diagnosis import equivalent_modes, loops_of
    >>> fitted = NRFRegressor(degree=3).fit(datasets.load_demo())
    >>> loops = loops_of(fitted.model_, fitted.fit_data("Fit again."))
    >>> stiffer = equivalent_modes(fitted.model_, loops)["frequency"]
    >>> bool((stiffer > fitted.modes()["frequency"]).all())
    True
    """
    laws = {}
    for loop in loops:
        columns = np.column_stack([loop.s, loop.v, np.ones(len(loop.s))])
        spring, dashpot, _ = np.linalg.lstsq(columns, loop.identified)[0]
        laws[loop.site] = [LinearElastic(spring), LinearViscous(dashpot)]
    return ChainModel(model.masses, laws, chain=model.chain).modes()


def modal_assurance(first: pd.DataFrame, second: pd.DataFrame) -> pd.DataFrame:
    """MAC of the shapes of two sets of modes: 1 for equal, 0 for orthogonal shapes.

    The modal assurance criterion of Allemang and Brown (1982).

    Parameters
    ----------
    first, second : DataFrame
        As returned by :meth:`ChainModel.modes`.

    Returns
    -------
    DataFrame
        One row for each mode of the first, one column for each of the second.

    Examples
    --------
    >>> from pysindy_nrf import NRFRegressor, datasets
    >>> from pysindy_nrf.diagnosis import modal_assurance
    >>> modes = NRFRegressor(degree=1).fit(datasets.load_demo()).modes()
    >>> modal_assurance(modes, modes).to_numpy().diagonal().round(6).tolist()
    [1.0, 1.0, 1.0]
    """
    shapes = []
    for modes in (first, second):
        dofs = [name for name in modes if str(name).startswith("dof")]
        shape = modes[dofs].to_numpy()
        shapes.append(shape / np.linalg.norm(shape, axis=1, keepdims=True))
    alike = (shapes[0] @ shapes[1].T) ** 2
    return pd.DataFrame(alike, first.index, second.index)
