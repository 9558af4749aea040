"""A chain model from a solution."""

from __future__ import annotations

import numpy as np

from ..chain_solve import Solution
from ..layout import LawLayout
from ..model import ChainModel


def model_of(layout: LawLayout, solution: Solution) -> ChainModel:
    """Put the coefficients of a solution into the laws of a layout.

    Parameters
    ----------
    layout : LawLayout
    solution : Solution

    Returns
    -------
    ChainModel
    """
    held = {}
    for site in layout.sites:
        values = solution.coefficients.get(site, np.zeros(0))
        ends = np.cumsum([len(law.terms()) for law in layout.laws.get(site, ())])[:-1]
        held[site] = tuple(
            law.with_values(coefficients=part) for law, part in zip(layout.laws.get(site, ()), np.split(values, ends))
        )
    masses = [solution.masses[j] for j in range(1, layout.n_dof + 1)]
    return ChainModel(masses, held, layout.chain)
