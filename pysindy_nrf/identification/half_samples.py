"""Models of halves of the data, which errors of the parameters make differ."""

from __future__ import annotations

import warnings

import numpy as np

from ..chain.model import ChainModel
from ..exceptions import NRFError, NRFWarning
from .free_runs import linear_matrices
from .intervals import MIN_PIECES, Resolver

# Pieces that are taken twice, 1, and left out, -1, in turn. The rows are orthogonal, so
# that the two models differ from the estimate by independent errors.
HALF_SAMPLES = ((1.0, -1.0), (1.0, 1.0, -1.0, -1.0))


def half_sample_models(resolver: Resolver) -> tuple[ChainModel, ...]:
    """Models of half of the pieces of the data, each from other pieces.

    An estimate of half of the data has twice the variance, and shares half of it with
    that of all: each parameter differs from its estimate by about one standard error
    (half-sample replication; McCarthy, Pseudo-replication, 1969).

    Parameters
    ----------
    resolver : Resolver

    Returns
    -------
    tuple of ChainModel
        Empty where half of the data does not determine the model.
    """
    n_pieces = len(resolver.record)
    if n_pieces < MIN_PIECES:
        return ()

    models = []
    for signs in HALF_SAMPLES:
        weights = 1.0 + np.resize(signs, n_pieces)
        try:
            with warnings.catch_warnings(action="ignore", category=NRFWarning):
                model = resolver.weighted_model(weights)
        except NRFError:
            return ()
        if (model.masses <= 0).any():
            return ()
        models.append(model)
    return tuple(models)


def may_be_sensitive(model: ChainModel) -> bool:
    """Whether errors of parameters may grow in a free run.

    That of springs and dashpots moves in proportion to them, which their intervals say.
    """
    return linear_matrices(model) is None
