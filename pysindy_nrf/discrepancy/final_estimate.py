"""The final estimate: what a fit of the laws that were found would say.

A search reads balances one by one, by least squares, which noise in the motion biases.
What a report says of masses, coefficients and their intervals is the estimate of
:class:`~pysindy_nrf.NRFRegressor` with the same laws, in the band of the search.
Instruments serve where noise matters; the free run is fitted only where the baseline
asks for that.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from ..chain.model import ChainModel
from ..chain.sites import Site
from ..chain.visited_region import VisitedRegion
from ..diagnosis.effects import Bounds
from ..diagnosis.motions import covariates_with_base
from ..exceptions import NRFError, NRFWarning
from ..identification.door import COMPLETE_RECORDS, choose_method
from ..identification.methods import IdentificationMethod, InstrumentsWithoutFreeRun
from ..identification.problem import Problem
from ..identification.result import IdentificationResult
from ..laws.atoms import SumOfAtoms
from ..laws.base import ForceLaw
from ..laws.shape import Motion, Shape
from ..records.dataset import Dataset
from ..records.input_arrays import Input, InputSettings
from ..records.record import Record
from .prepare import Band
from .report import LoopReport, Step
from .request import LoopRequest

# Cycles along which the size of a general law is read, the first to forget its start,
# and samples of each.
CYCLES = 2
SAMPLES = 500


class FinalEstimates:
    """Final estimates of the laws of a search, each made once.

    Parameters
    ----------
    request : LoopRequest
    """

    def __init__(self, request: LoopRequest) -> None:
        self.request = request
        self.method = _method_of(request.baseline.estimation)
        self._made: dict[tuple[object, ...], IdentificationResult | None] = {}
        self._data: dict[tuple[object, ...], Dataset | None] = {}

    def of(
        self,
        laws: Mapping[Site, Sequence[ForceLaw]],
        records: Sequence[Record],
        band: Band,
    ) -> IdentificationResult | None:
        """The estimate of some laws from all samples; None if they cannot be fitted so.

        Parameters
        ----------
        laws : mapping of Site to sequence of ForceLaw
        records : sequence of Record
            Those that were searched, freed of the faults that were found.
        band : (float, float)
            Hz, of the search.
        """
        problem = _problem_of(self.request, records, laws, band)
        freed = _with_free_shapes(problem.laws, self.request.problem.laws)
        with_shapes = replace(problem, laws=freed, start=problem.laws)
        if not with_shapes.has_free_shapes:
            return self._estimate(problem, records)

        # intervals of coefficients would hold for the shapes of the search only
        estimate = self._estimate(with_shapes, records)
        if estimate is not None and not estimate.intervals_withheld:
            return estimate

        fixed = self._estimate(problem, records)
        if fixed is None or estimate is None:
            return fixed
        return replace(fixed, doubts=(*fixed.doubts, estimate.intervals_withheld))

    def _estimate(
        self, problem: Problem, records: Sequence[Record]
    ) -> IdentificationResult | None:
        """What the method makes of a problem; None if it cannot be solved."""
        key = (
            *records,
            problem.band,
            *problem.laws.items(),
            *(problem.start or {}).items(),
        )
        if key not in self._made:
            self._made[key] = _estimate(
                self.method, problem, self._data_of(problem, records)
            )
        return self._made[key]

    def _data_of(self, problem: Problem, records: Sequence[Record]) -> Dataset | None:
        """The records as the method needs them; None if they cannot be read so."""
        has_memory, needs_clock = problem.layout.has_memory, problem.needs_clock
        key = (*records, has_memory, needs_clock)
        if key not in self._data:
            settings = InputSettings(has_memory=has_memory, needs_clock=needs_clock)
            self._data[key] = _read(self.method, settings, records)
        return self._data[key]


def _read(
    method: IdentificationMethod[Dataset],
    settings: InputSettings,
    records: Sequence[Record],
) -> Dataset | None:
    """Records as a method needs them; None if they cannot be read so."""
    with_base = [_with_base(record) for record in records]
    try:
        # the search has warned of the channels
        with warnings.catch_warnings(action="ignore", category=NRFWarning):
            return method.read(Input(with_base), settings)
    except NRFError:
        return None


def _problem_of(
    request: LoopRequest,
    records: Sequence[Record],
    laws: Mapping[Site, Sequence[ForceLaw]],
    band: Band,
) -> Problem:
    """That of the baseline with other laws, in the band of the search."""
    has_clock = all(record.has_clock for record in records)
    return replace(
        request.problem,
        laws={site: tuple(group) for site, group in laws.items()},
        band=band if has_clock and any(band) else None,
    )


def _method_of(estimation: str) -> IdentificationMethod[Dataset]:
    """How the estimate is made; the free run is fitted only where that is asked for."""
    if estimation == "auto":
        return InstrumentsWithoutFreeRun()
    return choose_method(estimation, COMPLETE_RECORDS)


def _estimate(
    method: IdentificationMethod[Dataset], problem: Problem, data: Dataset | None
) -> IdentificationResult | None:
    """What a method makes of a problem; None without data or a solution."""
    if data is None:
        return None
    try:
        with warnings.catch_warnings(action="ignore", category=NRFWarning):
            return method.identify(problem, data)
    except NRFError:
        return None


def _with_free_shapes(
    laws: Mapping[Site, Sequence[ForceLaw]],
    declared: Mapping[Site, Sequence[ForceLaw]],
) -> dict[Site, tuple[ForceLaw, ...]]:
    """Laws whose shape parameters are to be estimated where the search gave them."""
    freed = {}
    for site, group in laws.items():
        freed[site] = _to_be_estimated(group, declared.get(site, ()))
    return freed


def _to_be_estimated(
    group: Sequence[ForceLaw], declared: Sequence[ForceLaw]
) -> tuple[ForceLaw, ...]:
    """Laws without the values that the search gave to their shape parameters.

    What the user declared stays, and so do times and frequencies.
    """
    laws = []
    for law in group:
        is_given = any(
            type(each) is type(law) and each.shape == law.shape for each in declared
        )
        free: dict[str, None] = {}
        if not is_given and not isinstance(law, SumOfAtoms):
            names = [shape.name for shape in law.shapes if not _is_of_clock(shape)]
            free = dict.fromkeys(names)
        laws.append(law.with_values(shape=free))
    return tuple(laws)


def _is_of_clock(shape: Shape) -> bool:
    """Whether a shape parameter is a time or a frequency."""
    return shape.instant or shape.is_frequency


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
    bounds_of_shapes = _bounds_of_shapes(identified)
    steps = [_with_values(s, model, bounds, bounds_of_shapes) for s in report.steps]
    return replace(
        report,
        model=model,
        models=models,
        bounds=bounds,
        steps=steps,
        identified=identified,
    )


def _bounds_of_shapes(identified: IdentificationResult) -> Bounds:
    """95 % intervals of the shape parameters that were free, where there are any.

    By site and name, such as ``"storey 2: uy"``.
    """
    if identified.declared is None or identified.intervals_withheld:
        return {}
    free = []
    for site, group in identified.declared.laws.items():
        for number, law in enumerate(group):
            free += [(site, number, name) for name in law.free_shape]

    def shapes_of(model: ChainModel) -> pd.Series:
        values = {}
        for site, number, name in free:
            values[f"{site}: {name}"] = model.laws[site][number].shape[name]
        return pd.Series(values, dtype=float)

    try:
        table = identified.intervals.parameters(shapes_of, 0.95, identified.data)
    except NRFError:
        return {}
    return dict(zip(table["parameter"], zip(table["lower"], table["upper"])))


def _with_values(
    step: Step, model: ChainModel, bounds: Bounds, bounds_of_shapes: Bounds
) -> Step:
    """A confirmed step with its parameters in the final estimate."""
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
        name = f"{step.site}: {shape.name}"
        if name in bounds_of_shapes:
            intervals[shape.name] = bounds_of_shapes[name]
        elif shape.name in step.intervals and _is_of_clock(shape):
            intervals[shape.name] = step.intervals[shape.name]
    step = replace(step, parameters=dict(law.parameters), intervals=intervals)
    return with_bounds(step, model, bounds)


def with_bounds(step: Step, model: ChainModel, bounds: Bounds) -> Step:
    """A step with the intervals that are given of coefficients of its law."""
    if not step.confirmed or step.is_fault:
        return step
    law = _law_of(step, model.laws[Site(step.site)])
    if isinstance(law, SumOfAtoms):
        return step
    intervals = dict(step.intervals)
    for term in law.terms():
        name = f"{step.site}: {term.label}"
        if name in bounds:
            intervals[term.symbol] = bounds[name]
    return replace(step, intervals=intervals)


def _law_of(step: Step, laws: Sequence[ForceLaw]) -> ForceLaw:
    """The law of a step among those at its site, of which some may have one name."""
    named = [law for law in reversed(laws) if law.name == step.law]
    return min(named, key=lambda law: _distance(law.shape, step.shape))


def _distance(
    shape: Mapping[str, float | None], other: Mapping[str, float | None]
) -> float:
    """Sum of the relative differences of two sets of shape parameters."""
    distance = 0.0
    for name, value in shape.items():
        before = other.get(name)
        if value is not None and before is not None:
            distance += abs(value - before) / (abs(before) or 1.0)
    return distance


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
