"""The final estimate: what a fit of the laws that were found would say.

A search reads balances one by one, by least squares, which noise in the motion biases.
What a report says of masses, coefficients and their intervals is the estimate of
:class:`~pysindy_nrf.NRFRegressor` with the same laws, in the band of the search, by the
method that it chooses for these records.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from sklearn.base import clone

from ..chain.model import ChainModel
from ..chain.sites import Site
from ..chain.visited_region import VisitedRegion
from ..diagnosis.motions import covariates_with_base
from ..exceptions import NRFError, NRFWarning
from ..identification.problem import DEFAULT_DEGREE
from ..identification.result import IdentificationResult
from ..laws.atoms import SumOfAtoms
from ..laws.base import ForceLaw
from ..laws.shape import Motion
from ..records.record import Record
from .prepare import Band
from .report import LoopReport, Step
from .request import LoopRequest

# Cycles along which the size of a general law is read, the first to forget its start,
# and samples of each.
CYCLES = 2
SAMPLES = 500


def final_estimate(
    request: LoopRequest,
    records: Sequence[Record],
    laws: Mapping[Site, Sequence[ForceLaw]],
    band: Band,
) -> IdentificationResult | None:
    """The estimate of some laws from all samples; None if they cannot be fitted so.

    Parameters
    ----------
    request : LoopRequest
    records : sequence of Record
        Those that were searched, freed of the faults that were found.
    laws : mapping of Site to sequence of ForceLaw
    band : (float, float)
        Hz, of the search.
    """
    has_clock = all(record.has_clock for record in records)
    estimator = clone(request.baseline).set_params(
        degree=DEFAULT_DEGREE,
        orders=None,
        laws={str(site): list(at_site) for site, at_site in laws.items()},
        band=band if has_clock and any(band) else None,
        coordinates="relative",
        dt=None,
    )
    try:
        # the search has warned of the channels
        with warnings.catch_warnings(action="ignore", category=NRFWarning):
            fitted = estimator.fit([_with_base(record) for record in records])
    except NRFError:
        return None
    return fitted.result_


def _with_base(record: Record) -> Record:
    """A record that holds the motion of its base among the covariates."""
    if not record.has_clock:
        return record
    return record.replace(covariates=covariates_with_base(record))


def with_final_estimate(
    report: LoopReport, identified: IdentificationResult | None
) -> LoopReport:
    """The report with the masses, coefficients and intervals of the final estimate."""
    if identified is None:
        return report
    estimate, searched = identified.model, report.model
    model = ChainModel(
        estimate.masses,
        estimate.laws,
        estimate.chain,
        searched.visited,
        {**estimate.info, **searched.info},
    )
    models = [model if each is searched else each for each in report.models]
    bounds, _ = identified.bounds
    steps = [_with_values(step, model, bounds) for step in report.steps]
    return replace(
        report,
        model=model,
        models=models,
        bounds=bounds,
        steps=steps,
        identified=identified,
    )


def _with_values(
    step: Step, model: ChainModel, bounds: Mapping[str, tuple[float, float]]
) -> Step:
    """A confirmed step with its coefficients in the final estimate."""
    if not step.confirmed or step.is_fault:
        return step
    site = Site(step.site)
    law = _law_of(step, model.laws[site])
    if isinstance(law, SumOfAtoms):
        sizes = _size_of(law, model.visited.get(site))
        units = dict.fromkeys(sizes, model.units.force)
        return replace(step, parameters=sizes, units=units, intervals={})
    intervals = {}
    for shape in law.shapes:
        if shape.name in step.intervals:
            intervals[shape.name] = step.intervals[shape.name]
    for term in law.terms():
        name = f"{step.site}: {term.label}"
        if name in bounds:
            intervals[term.symbol] = bounds[name]
    return replace(step, parameters=dict(law.parameters), intervals=intervals)


def _law_of(step: Step, laws: Sequence[ForceLaw]) -> ForceLaw:
    """The law of a step among those at its site, of which some may have one name."""
    named = [law for law in laws if law.name == step.law]
    alike = [law for law in named if dict(law.shape) == step.shape]
    return (alike or named)[-1]


def _size_of(law: SumOfAtoms, region: VisitedRegion | None) -> dict[str, float | None]:
    """What a general law holds at most in each direction, N.

    Over cycles of the largest drift and rate that were visited.
    """
    if region is None:
        return {}
    rate, drift = np.maximum(np.abs(region.low), np.abs(region.high)).tolist()
    phase = np.linspace(0.0, 2.0 * np.pi * CYCLES, SAMPLES * CYCLES)
    period = 2.0 * np.pi * drift / rate if rate > 0 else 1.0
    motion = Motion(
        drift * np.sin(phase),
        rate * np.cos(phase),
        t=phase * period / (2.0 * np.pi),
    )
    force = law.force(motion)[SAMPLES:]
    return {"forward": float(force.max()), "backward": float(-force.min())}
