"""Tests of the nonlinear terms that an identification found."""

from __future__ import annotations

import numpy as np
import pandas as pd

from ..chain.model import ChainModel
from ..chain.sites import Site
from ..diagnosis.significance import LINEAR, SeriesEstimate
from ..equations.normal_equations import NormalEquations
from .intervals import Resolver


def kinds_of_nonlinearity(
    model: ChainModel, sums: NormalEquations, resolver: Resolver
) -> dict[str, str]:
    """Kinds of the nonlinear forces of power series that the data show, by site.

    Parameters
    ----------
    model : ChainModel
    sums : NormalEquations
        Of the data.
    resolver : Resolver
        Of the intervals.

    Returns
    -------
    dict of str to str
        Empty texts where no nonlinear term is more than chance.

    Raises
    ------
    ChannelError, IdentifiabilityError
        If the data have too few pieces for standard errors.
    """
    sites = [site for site in model.laws if _has_terms_to_test(model, sums, site)]
    if not sites:
        return {}

    def coefficients(other: ChainModel) -> pd.Series:
        return pd.Series(np.concatenate([other.coefficients[site] for site in sites]))

    influences = resolver.influences(coefficients)
    squares = sums.squares()
    kinds = {}
    start = 0
    for site in sites:
        laws = model.laws[site]
        labels = [term.label for law in laws for term in law.terms()]
        columns = squares.positions((site.p,)).sites[site]
        estimate = SeriesEstimate(
            labels,
            model.coefficients[site],
            influences[:, start : start + len(labels)],
            squares.matrices[(site.p,)][columns, columns],
        )
        start += len(labels)
        kinds[str(site)] = estimate.kind
    return kinds


def _has_terms_to_test(model: ChainModel, sums: NormalEquations, site: Site) -> bool:
    """Whether a power series with nonlinear terms is all that acts at a site."""
    laws = model.laws[site]
    if len(laws) != 1 or laws[0].name != "power_series":
        return False
    nonlinear = [term for term in laws[0].terms() if term.label not in LINEAR]
    equation = sums.groups.get((site.p,))
    return bool(nonlinear) and equation is not None and site in equation.sites
