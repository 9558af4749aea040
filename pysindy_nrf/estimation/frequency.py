r"""Instrumental variables for measured frequency responses.

The rows of the balances are spectral lines here (see :func:`pysindy_nrf.data.io.frf_to_features`). Noise in
a response sits in the regressors; a lightly damped structure's own simulated response is no good instrument,
because its peaks must be right to a fraction of a line. The neighbouring lines are: the response is smooth
over a few lines, the noise of lines further apart than the window's main lobe is independent,

.. math:: Z(f_k) = \tfrac12 (H(f_{k-2}) + H(f_{k+2})) .
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from sklearn.base import clone

from ..exceptions import BiasWarning, ChainError, ChannelError
from ..regression.blocks_of_samples import pieces_of
from ..regression.chain_solve import groups_of, solve
from ..regression.input_arrays import from_arrays
from ..regression.solution import model_of
from .intervals import Resolver

APART = 2  # lines; the noise of a Hann-windowed response reaches its next neighbour


def fit_frequency_response(
    estimator: Any, frf: Any, band: tuple[float | None, float | None] | None = None, weight: Any = None
) -> Any:
    """Fit a regressor to a measured frequency response."""
    from ..data.io import FrequencyResponse, frf_to_features

    if estimator.estimation not in ("ls", "iv"):
        raise ChainError(
            f"estimation={estimator.estimation!r} does not work on frequency responses", "Use 'ls' or 'iv'."
        )
    X, F = frf_to_features(frf, band=band, weight=weight)
    model = clone(estimator).set_params(estimation="ls")
    with warnings.catch_warnings():
        if estimator.estimation == "iv":  # what biases least squares is about to be removed
            warnings.simplefilter("ignore", BiasWarning)
        model.fit(X, F)
    if estimator.estimation == "ls":
        return model
    H = frf.H
    if len(H) <= 2 * APART:
        raise ChannelError(f"{frf.name} has {len(H)} lines", "Give more lines.")
    ends = np.pad(H, ((APART, APART), (0, 0)), mode="edge")
    neighbours = FrequencyResponse(frf.f, 0.5 * (ends[: -2 * APART] + ends[2 * APART :]), frf.driven, frf.name)
    Z, _ = frf_to_features(neighbours, band=band, weight=weight)
    data, others = (from_arrays(x, F, n_dof=frf.n_dof) for x in (X, Z))
    problem = model.problem_
    layout, known, optimizer = problem.layout, dict(problem.known_masses), problem.optimizer
    pieces = pieces_of(data, layout, groups_of(layout, model.walk_), [None], known, others.segments)
    solution = solve(pieces.sum().projected(), model.walk_, known, optimizer)
    return model._adopt(
        model_of(layout, solution),
        Resolver(pieces, model.walk_, known, optimizer),
        {"asked": "iv", "found": "iv", "notes": ["neighbouring lines"]},
    )
