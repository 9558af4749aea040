"""From the least-squares estimate to the one that was asked for."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from ..exceptions import BiasWarning, IdentifiabilityError, NRFError
from ..mechanics.identifiability import Walk
from ..regression.blocks_of_samples import pieces_of
from ..regression.chain_model import ChainModel
from ..regression.chain_solve import groups_of
from ..regression.segments import SegmentSet
from .free_run_fit import free_parameters, output_error
from .intervals import InfluenceResolver, Resolver
from .iv import IVResult, instrumental_variables
from .problem import Estimate, Problem

METHODS = ("ls", "iv", "simulation")
# Standard errors by which a mass may still move in the last round.
_BESIDE = 0.2


def refine(
    method: str, start: Estimate, data: SegmentSet
) -> tuple[Estimate, Resolver | None, dict[str, Any], SegmentSet]:
    """Instrumental variables, and output error after them."""
    facts: dict[str, Any] = {"asked": method, "found": "ls"}
    problem, walk = start.problem, start.order
    known, inner = dict(problem.known_masses), problem.optimizer
    iv = instrumental_variables(start.model, data, problem, walk)
    if iv is None:
        return start, None, facts, data
    facts |= {"found": "iv", "rounds": iv.rounds, "likeness": iv.likeness, "notes": list(iv.notes)}
    resolver = Resolver(iv.pieces, walk, known, inner)
    if said := _restless(iv, resolver):
        facts["notes"] = [*facts["notes"], said]
        warnings.warn(said, BiasWarning, stacklevel=4)
    model = iv.model
    if method == "simulation":
        result = output_error(model, data, problem.layout, known, problem.band, _halves(resolver))
        facts |= {
            "free_run_error_before": _finite(result.error_before),
            "free_run_error_after": _finite(result.error_after),
        }
        if result.kept:
            assert result.influences is not None
            model, facts["found"] = result.model, "simulation"
            theta, rebuild, _ = free_parameters(model, known)
            assert result.record is not None
            resolver = InfluenceResolver(
                iv.pieces, walk, known, inner, theta=theta, rebuild=rebuild, moves=result.influences, of=result.record
            )
        else:
            facts["notes"] = [*facts["notes"], f"instrumental variables kept: {result.why}"]
    return start._replace(model=model, solution=iv.solution), resolver, facts, iv.judged(data)


def least_squares_resolver(problem: Problem, walk: Walk, data: SegmentSet) -> Resolver:
    """What re-solving a least-squares estimate needs; one pass over the data."""
    layout, known = problem.layout, dict(problem.known_masses)
    pieces = pieces_of(data, layout, groups_of(layout, walk), problem.filters(data), known)
    return Resolver(pieces, walk, known, problem.optimizer)


def separate_resolver(problem: Problem, walk: Walk, separate: SegmentSet, resolver: Resolver) -> Resolver:
    """What the uncertainty of a least-squares estimate needs where the motions were fused together."""
    return replace(least_squares_resolver(problem, walk, separate), constrain=resolver.constrain)


def _restless(iv: IVResult, resolver: Resolver) -> str:
    """What is to be said of rounds that were not at rest when they ended; nothing where noise does far more."""
    if iv.moved is None:
        return ""
    spread, beside = np.zeros(len(iv.moved)), ""
    try:
        variance = np.diag(resolver.covariance(lambda model: pd.Series(model.masses)))
        spread = np.sqrt(variance) / np.abs(iv.model.masses)
    except NRFError:  # too few pieces to tell
        pass
    j = int(np.argmax(iv.moved - _BESIDE * spread))
    if iv.moved[j] <= _BESIDE * spread[j]:
        return ""
    beside = f" (standard error {100 * spread[j]:.2g} %)" if spread[j] else ""
    return (
        f"estimation='iv' was not at rest after {iv.rounds} rounds: the last one still moved m{j + 1} by "
        f"{100 * iv.moved[j]:.2g} %{beside}. Give longer or cleaner records, or a simpler law."
    )


def _halves(resolver: Resolver) -> list[ChainModel] | None:
    """Models of the first and second half of every record, or None where one of them cannot be solved."""
    record = resolver.record
    place = np.arange(len(record)) - np.searchsorted(record, record)
    first = place < np.bincount(record)[record] // 2
    try:
        return [resolver.at(half.astype(float)) for half in (first, ~first)]
    except IdentifiabilityError:
        return None


def _finite(value: float) -> float | None:
    return float(value) if abs(value) < float("inf") else None
