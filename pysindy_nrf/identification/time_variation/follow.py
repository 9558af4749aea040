"""Coefficients in time from a fit: what changes, how, and how sure that is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from scipy import stats

from ...common.warn import warn_user
from ...exceptions import BiasWarning, ChainError
from ...records.dataset import Dataset
from ..problem import Problem
from .amplitude import with_amplitude_dependence
from .courses import STRONG, CourseFitter, ShapedFit
from .evidence import FALSE_ALARM_RATE, Search, search_for_changes
from .penalised import PenalisedFit
from .piece_sums import (
    BEST_SHARE,
    EquationSums,
    Unknowns,
    deviance_of,
    equation_sums,
    weighted_products,
    weights_of,
)
from .pieces import Pieces, pieces_of_record
from .request import AUTO, Place, VaryingSetting, places_to_follow
from .variation import (
    AMPLITUDE,
    BOTH,
    CHANGING,
    CONSTANT,
    EITHER,
    GRADUAL,
    SUDDEN,
    UNCERTAIN,
    TimeVariation,
)

if TYPE_CHECKING:
    from ..result import IdentificationResult

LEVEL = 0.95
# Share of what changes and laws of the amplitude explain together, that changes must
# explain beside these laws. From the upper one on nothing more is asked; between both
# a change must last: the mean of its course over the last fifth of the information
# differs from that over the first by at least this share of its range. What nine
# sliders leave of a smooth hysteresis follows the amplitude and returns: 0.02 at most
# of ten structures that do not change, 0.05 at least of eight whose hysteresis
# degrades (seed 7000 of ``benchmarks/time_varying.py``, which is not reported).
LEAST_SHARE = 0.15
MOST = 0.5
LEAST_LASTING = 0.05
FIFTH = 0.2


def with_time_variation(
    result: IdentificationResult, varying: VaryingSetting
) -> IdentificationResult:
    """A result with the courses of coefficients along its record.

    Parameters
    ----------
    result : IdentificationResult
        Of least squares, with its data.
    varying : "auto" or mapping of str to sequence of str

    Raises
    ------
    ChainError
        If there are several records, a site or a term is not in the model, or an
        optimizer or constraints stand beside.
    ChannelError
        If the record has no clock or is too short.
    """
    problem = result.problem
    _refuse_beside(problem)
    data = result.require_data("Fit again.")
    if len(data.segments) != 1:
        raise ChainError(
            f"varying follows one record, and {len(data.segments)} were given",
            "Give one record; monitoring.track follows several tests.",
        )
    places = places_to_follow(problem, varying)
    pieces = pieces_of_record(data.segments[0], result.model)
    followed = _Followed(problem, data, pieces, tuple(places))
    variation = _Judgement(followed, varying == AUTO).variation()
    _warn_of_changes(variation)
    return replace(result, time_variation=variation)


def _refuse_beside(problem: Problem) -> None:
    """Refuse settings that have no part in courses."""
    for name in ("optimizer", "constraints"):
        if getattr(problem, name):
            raise ChainError(
                f"{name} has no part in varying=", f"Leave {name} out, or varying."
            )


def _warn_of_changes(variation: TimeVariation) -> None:
    """Masses and coefficients of a constant fit average over what changes."""
    if variation.changing:
        warn_user(
            f"{' and '.join(variation.changing)} changes in time: masses_ and"
            " restoring_forces_ are those of the constant structure that fits best;"
            " time_variation_ has the courses, and the masses beside them.",
            BiasWarning,
        )


@dataclass(frozen=True, eq=False)
class _Followed:
    """A problem on the pieces of a record, and the coefficients that are followed."""

    problem: Problem
    data: Dataset
    pieces: Pieces
    places: tuple[Place, ...]

    @cached_property
    def _sums(self) -> tuple[Unknowns, list[EquationSums]]:
        return equation_sums(self.problem, self.data, self.pieces.edges)

    @property
    def unknowns(self) -> Unknowns:
        return self._sums[0]

    @property
    def equations(self) -> list[EquationSums]:
        return self._sums[1]

    @cached_property
    def tested(self) -> list[int]:
        """Numbers of the coefficients that are followed."""
        numbers = []
        for site, label in self.places:
            labels = self.problem.layout.labels(site)
            numbers.append(int(self.unknowns.of_site(site)[labels.index(label)]))
        return numbers

    @cached_property
    def fitter(self) -> CourseFitter:
        count = self.unknowns.count

        def weighting(coefficients: np.ndarray) -> np.ndarray:
            weights = weights_of(self.equations, coefficients)
            return weighted_products(self.equations, weights, count)

        deviance = partial(deviance_of, self.equations)
        return CourseFitter(self.pieces.middles, count, weighting, deviance)

    @cached_property
    def constant(self) -> ShapedFit:
        """All coefficients constant."""
        return self.fitter.constants(self.tested)

    @cached_property
    def sizes(self) -> np.ndarray:
        """Rms of each followed column over the rms force of its site, per unit."""
        segment = self.data.segments[0]
        coefficients = self.constant.fit.over_time.mean(axis=0)
        sizes = np.zeros(self.unknowns.count)
        for number, (site, label) in zip(self.tested, self.places):
            columns = self.problem.layout.columns(
                site, segment.motion(site, segment.valid)
            )
            here = columns[:, self.problem.layout.labels(site).index(label)]
            force = columns @ coefficients[self.unknowns.of_site(site)]
            sizes[number] = np.sqrt(np.mean(here**2) / np.mean(force**2))
        return sizes

    def search(self, suspects: Sequence[int] | None = None) -> Search:
        """Coefficients that change, of all that are followed or of suspects."""
        tested = self.tested if suspects is None else suspects
        return search_for_changes(
            self.fitter, self.constant, tested, self.sizes, len(self.tested)
        )


@dataclass(frozen=True, eq=False)
class _Judgement:
    """What changes, and what may only depend on the amplitude."""

    declared: _Followed
    automatic: bool

    @cached_property
    def search(self) -> Search:
        """What changes if the declared laws hold."""
        return self.declared.search()

    @cached_property
    def amplitude(self) -> _Followed:
        """The same beside laws of the amplitude, at the sites that seem to change."""
        followed = self.declared
        sites = {
            place[0]
            for number, place in zip(followed.tested, followed.places)
            if number in self.search.shaped.shapes
        }
        problem = with_amplitude_dependence(followed.problem, followed.data, sites)
        return replace(followed, problem=problem)

    @cached_property
    def beside_amplitude(self) -> Search:
        """What of it is still seen beside laws of the amplitude."""
        renamed = dict(zip(self.declared.tested, self.amplitude.tested))
        suspects = [renamed[number] for number in self.search.changing]
        return self.amplitude.search(suspects)

    @cached_property
    def kinds(self) -> dict[int, str]:
        """What each followed coefficient does."""
        kinds = dict.fromkeys(self.declared.tested, CONSTANT)
        suspects = self.search.changing
        if not suspects:
            return kinds
        for number in suspects:
            kinds[number] = self._without_change
        for number in self._certain:
            shape = self.shaped.shapes[number]
            kinds[number] = GRADUAL
            if shape.steps:
                kinds[number] = BOTH if shape.gradual else SUDDEN
            if self._courses[number].may_be_constant:
                kinds[number] = UNCERTAIN
        return kinds

    @cached_property
    def _courses(self) -> dict[int, _Values]:
        """Courses of all coefficients that are followed."""
        return {number: self._course(number) for number in self.declared.tested}

    @property
    def _certain(self) -> list[int]:
        """What changes beside laws of the amplitude, if it explains enough."""
        constant = self.declared.constant.deviance
        amplitude = self.amplitude.constant.deviance
        beside = self.beside_amplitude.shaped
        share = (amplitude - beside.deviance) / (constant - beside.deviance)
        renamed = dict(zip(self.amplitude.tested, self.declared.tested))
        certain = []
        for number in beside.shapes:
            enough = share >= MOST or _lasting(beside, number) >= LEAST_LASTING
            if share >= LEAST_SHARE and enough:
                certain.append(renamed[number])
        return certain

    @cached_property
    def _without_change(self) -> str:
        """What is said where laws of the amplitude serve as well as a change."""
        in_time = self.search.shaped
        by_amplitude = self.amplitude.constant
        dispersion = min(in_time.dispersion, by_amplitude.dispersion)
        further = self.amplitude.unknowns.count - self.declared.unknowns.count
        n_pieces = len(self.declared.pieces)
        criterion = by_amplitude.criterion(dispersion) + np.log(n_pieces) * further
        is_better = criterion + STRONG < in_time.criterion(dispersion)
        return AMPLITUDE if is_better else EITHER

    @cached_property
    def shaped(self) -> ShapedFit:
        """Courses of what changes, and of what was named."""
        followed = self.declared
        shaped = self.search.shaped
        asked = list(shaped.shapes)
        if not self.automatic:
            asked = list(dict.fromkeys([*asked, *followed.tested]))
        if len(asked) > 1 or not shaped.shapes:
            # each once more beside the courses of the others
            for number in asked:
                shaped = followed.fitter.shaped(shaped, number)
        return shaped

    def variation(self) -> TimeVariation:
        """Everything as tables."""
        kinds = self.kinds
        tables = []
        rows = []
        instants: list[dict[str, object]] = []
        for number, place in zip(self.declared.tested, self.declared.places):
            course = self._courses[number]
            tables.append(self._table(place, course))
            rows.append(self._row(place, number, kinds[number], course))
            if kinds[number] in CHANGING:
                instants.extend(self._instants(place, number, course))
        columns = ["site", "term", "t", "t_lower", "t_upper", "change"]
        return TimeVariation(
            pd.concat(tables, ignore_index=True),
            pd.DataFrame(rows),
            pd.DataFrame(instants, columns=columns),
            self._masses(),
            self._errors(),
            FALSE_ALARM_RATE,
            self.declared.pieces.period,
        )

    @cached_property
    def otherwise_fused(self) -> PenalisedFit:
        """The same courses along the motion of each floor fused by itself.

        The difference is what noise in the motion may bias.
        """
        followed = self.declared
        if followed.data.apart is followed.data:
            return self.shaped.fit
        apart = replace(followed, data=followed.data.apart)
        return apart.fitter.fit(self.shaped.shapes, apart.constant).fit

    def _course(self, number: int) -> _Values:
        fit = self.shaped.fit
        values = fit.values(number)
        variance = fit.variance(number) + (BEST_SHARE * values) ** 2
        variance += (self.otherwise_fused.values(number) - values) ** 2
        shape = self.shaped.shapes.get(number)
        instants = []
        if shape is not None and shape.steps:
            heights = fit.coefficients[fit.places[number]][-len(shape.steps) :]
            for piece, height in zip(shape.steps, heights):
                likely = self.declared.fitter.likelihood_of_instants(
                    self.shaped, number, piece
                )
                behind = np.cumsum(likely)
                variance += height**2 * behind * (1 - behind)
                instants.append((piece, float(height), behind))
        return _Values(values, np.sqrt(variance), instants)

    def _table(self, place: Place, course: _Values) -> pd.DataFrame:
        site, label = place
        return pd.DataFrame(
            {
                "site": str(site),
                "term": label,
                "unit": self._unit(place),
                "t": self.declared.pieces.middles,
                "value": course.values,
                "lower": course.lower,
                "upper": course.upper,
            }
        )

    def _unit(self, place: Place) -> str:
        site, label = place
        laws = self.declared.problem.laws[site]
        units = [term.unit for law in laws for term in law.terms()]
        return units[self.declared.problem.layout.labels(site).index(label)]

    def _row(
        self, place: Place, number: int, kind: str, course: _Values
    ) -> dict[str, object]:
        first, last = float(course.values[0]), float(course.values[-1])
        change = 100 * (last - first) / abs(first)
        reach = 100 * self._error_of_change(number) / abs(first)
        reach *= stats.norm.ppf((1 + LEVEL) / 2)
        tests = len(self.declared.tested)
        p = min(1.0, tests * float(np.exp(self.search.evidence[number])))
        return {
            "site": str(place[0]),
            "term": place[1],
            "kind": kind,
            "first": first,
            "last": last,
            "lowest": float(course.values.min()),
            "change": change,
            "lower": change - reach,
            "upper": change + reach,
            "p": p,
        }

    def _error_of_change(self, number: int) -> float:
        """Standard error of the last value less the first."""
        fit = self.shaped.fit
        columns = fit.courses[number].columns
        here = fit.places[number]
        difference = columns[-1] - columns[0]
        return float(np.sqrt(difference @ fit.covariance[here, here] @ difference))

    def _instants(
        self, place: Place, number: int, course: _Values
    ) -> list[dict[str, object]]:
        times = self.declared.pieces.times
        rows = []
        for piece, height, behind in course.instants:
            before = float(course.values[piece - 1])
            low, high = np.searchsorted(behind, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
            last = len(times) - 1
            rows.append(
                {
                    "site": str(place[0]),
                    "term": place[1],
                    "t": float(times[piece]),
                    "t_lower": float(times[min(low, last)]),
                    "t_upper": float(times[min(high + 1, last)]),
                    "change": 100 * height / abs(before),
                }
            )
        return rows

    def _masses(self) -> np.ndarray:
        unknowns = self.declared.unknowns
        masses = []
        for dof in range(1, unknowns.layout.n_dof + 1):
            if dof in unknowns.known_masses:
                masses.append(float(unknowns.known_masses[dof]))
            else:
                masses.append(float(self.shaped.fit.values(unknowns.of_mass(dof))[0]))
        return np.array(masses)

    def _errors(self) -> pd.Series:
        return pd.Series(
            {
                "constant": _error_of(self.declared, self.declared.constant),
                "varying": _error_of(self.declared, self.shaped),
            }
        )


@dataclass(frozen=True, eq=False)
class _Values:
    """A course: values, standard errors, and steps as (piece, height, P(before))."""

    values: np.ndarray
    error: np.ndarray
    instants: Sequence[tuple[int, float, np.ndarray]]

    @property
    def lower(self) -> np.ndarray:
        """Lower end of the band."""
        return self.values - stats.norm.ppf((1 + LEVEL) / 2) * self.error

    @property
    def upper(self) -> np.ndarray:
        """Upper end of the band."""
        return self.values + stats.norm.ppf((1 + LEVEL) / 2) * self.error

    @property
    def may_be_constant(self) -> bool:
        """Whether a constant lies within the band all along."""
        return bool(self.lower.max() <= self.upper.min())


def _lasting(shaped: ShapedFit, number: int) -> float:
    """How far a course has moved in the end, as a share of its range."""
    values = shaped.fit.values(number)
    information = shaped.fit.products[:, number, number]
    passed = np.cumsum(information) / information.sum()
    first = np.average(values, weights=information * (passed <= FIFTH))
    last = np.average(values, weights=information * (passed >= 1 - FIFTH))
    return float(abs(last - first) / np.ptp(values))


def _error_of(followed: _Followed, shaped: ShapedFit) -> float:
    """What a fit leaves of all equations, percent of their right-hand sides."""
    left = 0.0
    right = 0.0
    for equation in followed.equations:
        left += equation.residual(shaped.fit.over_time)
        right += equation.size
    return 100 * float(np.sqrt(left / right)) if right else np.nan
