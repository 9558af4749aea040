"""The result of one identification: what a method found, and how far to trust it."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.stats import norm

from ..chain.identifiability import SolveOrder
from ..chain.model import ChainModel
from ..common.plain_tables import PlainState
from ..diagnosis.assumptions import Assumption, scale_of
from ..diagnosis.bias import NEGLIGIBLE, NoiseBias, noise_bias, noise_shares
from ..diagnosis.effects import nonlinear_parts, shares_of
from ..diagnosis.facts import (
    Alternative,
    AmbiguousInterval,
    Facts,
    OtherModel,
    ShapeAtEnd,
    facts_of_model,
)
from ..diagnosis.free_run import FreeRuns, free_runs, spread_of
from ..diagnosis.open_alternatives import OpenAlternatives
from ..diagnosis.residual import Residual
from ..diagnosis.rules import GOOD_RUN, missed_channel
from ..diagnosis.unseen_drifts import unseen_drifts
from ..diagnosis.verdict import Verdict, verdict_after_search
from ..diagnosis.wiring import suspect_channels
from ..equations.normal_equations import NormalEquations
from ..exceptions import (
    ChannelError,
    DataQualityWarning,
    NRFError,
    NRFWarning,
)
from ..records.dataset import Dataset
from ..records.record import Record
from ..report.summary import Summary, summary_of
from ..report.words import band_text
from .alternatives import alternatives_of
from .ambiguity import ambiguous_in, table_with_ambiguity
from .examination import Examination
from .half_samples import half_sample_models, may_be_sensitive
from .intervals import (
    AskedFor,
    IntervalMaker,
    Resolver,
    calibration_spread,
    least_squares_resolver,
    names_of_points,
    statistic_of,
)
from .joint_intervals import (
    JointResolver,
    joint_resolver,
    shapes_at_ends,
)
from .noise_floor import BesideNoise, beside_noise, residual_of_noise
from .nonlinear_terms import kinds_of_nonlinearity
from .problem import Problem
from .shape_derivatives import shapes_of_motion
from .smaller_order import SmallerOrder, smaller_order
from .time_variation.variation import TimeVariation
from .wiring import records_of, wiring_error

# Percent of the balances, pooled, that 16 bits of a range ten times the rms leave.
# Below it, the rest is arithmetic, which no further sample averages out.
_EXACT = 0.01
_CURE_OF_NOISE = "Give the Records themselves, with estimation='auto' or 'iv'."
_NO_DATA = "Fit again, or ask for intervals before saving."


# Names of the methods as a summary prints them.
METHODS_IN_WORDS = {
    "ls": "least squares",
    "iv": "instrumental variables",
    "simulation": "free run fitted to the motion",
}


@dataclass(frozen=True, eq=False)
class IdentificationResult(PlainState):
    """What an identification found.

    Intervals, free runs and the verdict are computed when they are asked for. A result
    that was saved has lost its data, and with them what was not asked for before.

    Parameters
    ----------
    model : ChainModel
    problem : Problem
        The problem that was solved, with the shape parameters that were found.
    order : SolveOrder
        The order in which the balances were solved.
    method : str
        Name of the method whose estimate was kept.
    errors : DataFrame
        Errors on the data of the fit, percent NRMSE: of the balances, or of the
        measured channels where some floor has no sensor.
    sums : NormalEquations
        Sums of the balances over the data.
    condition : Series
        Scaled condition number of each step of the solve.
    third_law_gap : Series
        Difference of the two estimates of each storey's force, percent of its rms.
    unknown_forces : DataFrame
        Forces, N, on the DOFs whose force was not known.
    examination : Examination
        Missing terms, and what is doubtful.
    inner : dict of str to PySINDy optimizer
        The fitted optimizer of each balance.
    data : Dataset, optional
        The motions that the errors are of; None after a fit in pieces, or a load.
    motions : list of DataFrame
        Of records in which some floor has no sensor: motions of all DOFs and forces of
        all sites, with their intervals.
    resolver : Resolver, optional
        Solves again on pieces of the data; least squares of the data if None.
    constrain : callable, optional
        Turns a model into one that obeys what is known of the parameters.
    biased_by_noise : bool
        Whether noise in the motion biases the method.
    notes : tuple of str
        Why another method could not be used, and what else the method found.
    doubts : tuple of str
        Why no interval of a parameter can be given.
    channel_runs : FreeRuns, optional
        Free runs that the fit compared with the measured channels.
    channel_error : float
        Largest share of a measured channel that the free run misses beyond its noise,
        where some floor has no sensor.
    declared : Problem, optional
        The problem as declared, where it has free shape parameters.
    time_variation : TimeVariation, optional
        Courses of coefficients in time, where they were asked for.
    """

    model: ChainModel
    problem: Problem
    order: SolveOrder
    method: str
    errors: pd.DataFrame
    sums: NormalEquations
    condition: pd.Series
    third_law_gap: pd.Series
    unknown_forces: pd.DataFrame
    examination: Examination = field(default_factory=Examination)
    inner: Mapping[str, object] = field(default_factory=dict)
    data: Dataset | None = None
    motions: list[pd.DataFrame] = field(default_factory=list)
    resolver: Resolver | None = None
    constrain: Callable[[ChainModel], ChainModel] | None = None
    biased_by_noise: bool = False
    notes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    channel_runs: FreeRuns | None = None
    channel_error: float = 0.0
    declared: Problem | None = None
    time_variation: TimeVariation | None = None

    def __getstate__(self) -> dict[str, object]:
        # the data, and the free runs, which hold them, are no part of a saved result
        state = super().__getstate__() | {"data": None}
        state.pop("free_runs", None)
        return state

    @property
    def n_samples(self) -> int:
        """Samples used, NaN edges left out; the sum of their weights."""
        return int(self.sums.n_samples)

    @property
    def data_warnings(self) -> dict[str, list[str]]:
        """Sentences on channels, forces, records and masses that are doubtful."""
        examination = self.examination
        masses = [*examination.masses]
        if self.channel_error > 0:
            masses.append(missed_channel(self.channel_error))
        return {
            "channels": examination.channels,
            "forces": examination.forces,
            "records": examination.records,
            "masses": masses,
        }

    def require_data(self, cure: str) -> Dataset:
        """Data of the fit.

        Raises
        ------
        ChannelError
            If the model was fitted in pieces, or loaded without the data.
        """
        if self.data is None:
            raise ChannelError(
                "The model was loaded without the data it was fitted to", cure
            )
        return self.data

    @cached_property
    def smaller_order(self) -> SmallerOrder | None:
        """The smallest degree of the power series that leaves as little as that fitted.

        None if there is none below it.
        """
        error = float(self.errors.loc["pooled", "error"])
        return smaller_order(self.problem, self.order, self.sums, error)

    # -- intervals -------------------------------------------------------------------

    @cached_property
    def noise_biases(self) -> list[NoiseBias]:
        """What noise in the motion does to the estimate, by balance.

        Empty for methods that noise does not bias, and without data.
        """
        if not self.biased_by_noise or self.data is None:
            return []
        shares = noise_shares(self.data, self.problem.filters(self.data))
        return noise_bias(self.model, self.order, self.sums, shares)

    @cached_property
    def intervals_withheld(self) -> str:
        """Why these data give no valid interval; empty if they do."""
        errors = [bias.errors for bias in self.noise_biases]
        worst = max(errors, default=0.0)
        shapes = shapes_of_motion(self.declared)
        if errors and shapes:
            # 1e-3 of noise moves a Bouc-Wen's alpha by four standard errors, of which
            # the bias of the columns says 0.4
            return (
                f"noise in the motion biases {', '.join(shapes)} by least squares, and"
                " the coefficients with them, by an unknown amount."
                f" {' '.join(self.notes) or _CURE_OF_NOISE}"
            )
        if worst <= NEGLIGIBLE:
            return " ".join([*self.doubts, *self._unsettled_shapes()])
        amount = f"{worst:.2g} standard errors"
        if not np.isfinite(worst):
            amount = "an unknown amount"
        return (
            f"noise in the motion may bias least squares by {amount};"
            f" up to {NEGLIGIBLE:g} standard errors leave 95 % intervals valid."
            f" {' '.join(self.notes) or _CURE_OF_NOISE}"
        )

    def _unsettled_shapes(self) -> list[str]:
        """Sentences on shape parameters that keep the bias of least squares.

        Instruments may fail to move them to the estimate that noise does not bias.
        """
        if not isinstance(self.resolver, JointResolver) or self._no_noise_is_left:
            return []
        try:
            steps = self.resolver.unsettled
        except NRFError:
            # then there are no intervals either, for that reason
            return []
        return [
            f"noise in the motion may bias {place} by {size:.2g} standard errors: the"
            " instruments did not settle on a value. Give it, or longer records."
            for place, size in steps
            if size > NEGLIGIBLE
        ]

    @property
    def _no_noise_is_left(self) -> bool:
        return bool(self.errors.loc["pooled", "error"] < _EXACT)

    @cached_property
    def intervals(self) -> IntervalMaker:
        """Makes intervals of anything that follows from the model."""
        return IntervalMaker(
            self._interval_resolver(),
            self.model,
            self.intervals_withheld,
            repeats=self.n_samples if self._no_noise_is_left else 1.0,
        )

    def _interval_resolver(self) -> Resolver:
        """Resolver on motions whose errors are independent from piece to piece.

        What a joint fusion leaves of noise is alike in the whole record.
        """
        if self.resolver is not None:
            return self.resolver
        data = self.require_data(_NO_DATA)
        if not self.intervals_withheld:
            data = _fused_apart(data)
        resolver = self._joint_resolver(data)
        if resolver is None:
            resolver = least_squares_resolver(self.problem, self.order, data)
        return replace(resolver, constrain=self.constrain)

    def _joint_resolver(self, data: Dataset) -> Resolver | None:
        """Resolver that frees the shape parameters again, where some were free."""
        if self.declared is None:
            return None
        coefficients = self.model.coefficients
        return joint_resolver(
            self.declared, self.problem, self.order, data, coefficients
        )

    def confidence_intervals(
        self,
        level: float = 0.95,
        *,
        of: AskedFor = "parameters",
        calibration: Mapping[str, float] | None = None,
    ) -> pd.DataFrame:
        """Intervals; see :meth:`NRFRegressor.confidence_intervals`."""
        intervals = self.intervals
        table = intervals.parameters(of, level, self.data)
        ambiguous = self.ambiguous_in(table, of, level)
        table = table_with_ambiguity(table, ambiguous)
        if calibration is None:
            return table
        if isinstance(of, Mapping):
            raise ChannelError(
                "calibration does not go with a mapping of sites",
                "Give of= a function of the model.",
            )
        data = self.require_data(_NO_DATA)
        known_masses = intervals.resolver.known_masses
        layout = self.problem.layout
        statistic = statistic_of(of, known_masses, layout, data)
        spread = calibration_spread(
            self.problem, self.order, data, statistic, calibration
        )
        quantile = norm.ppf((1 + level) / 2)
        for end, sign in (("lower", -1.0), ("upper", 1.0)):
            half = np.hypot(table[end] - table["estimate"], quantile * spread)
            table[f"combined_{end}"] = table["estimate"] + sign * half
        return table

    def force_intervals(
        self, site: str | int, v: ArrayLike, s: ArrayLike, level: float = 0.95
    ) -> pd.DataFrame:
        """Intervals of forces; see :meth:`NRFRegressor.force_intervals`."""
        forces = self.intervals.forces(site, v, s, level)
        rates, drifts = forces["v"].to_numpy(), forces["s"].to_numpy()
        place = self.model.chain.site(site)
        table = forces.rename(columns={"force": "estimate"})
        names = names_of_points(place, rates, drifts, self.model.units)
        table.insert(0, "parameter", names)
        ambiguous = self.ambiguous_in(table, {str(place): (rates, drifts)}, level)
        widened = table_with_ambiguity(table, ambiguous)
        return forces.assign(lower=widened["lower"], upper=widened["upper"])

    def ambiguous_in(
        self, table: pd.DataFrame, of: AskedFor, level: float
    ) -> tuple[AmbiguousInterval, ...]:
        """Intervals of a table that alternatives widen, or that they forbid."""
        remaining = self.beside_noise.remaining(self.unexplained)
        among = OpenAlternatives.among(self.alternatives, remaining)
        if not among.alternatives or table["lower"].isna().all():
            return ()
        known_masses = self.intervals.resolver.known_masses
        statistic = statistic_of(of, known_masses, self.problem.layout, self.data)
        return ambiguous_in(table, among, statistic, level)

    @cached_property
    def ambiguous_intervals(self) -> tuple[AmbiguousInterval, ...]:
        """95 % intervals of parameters that alternatives widen, or that they forbid."""
        if self.intervals_withheld:
            return ()
        try:
            table = self.intervals.parameters("parameters", 0.95, self.data)
        except NRFError:
            return ()
        return self.ambiguous_in(table, "parameters", 0.95)

    @cached_property
    def bounds(self) -> tuple[dict[str, tuple[float, float]], list[str]]:
        """95 % intervals by parameter, and why there are none."""
        if self.intervals_withheld:
            return {}, [f"Intervals are withheld: {self.intervals_withheld}"]
        try:
            with warnings.catch_warnings(action="ignore", category=NRFWarning):
                table = self.confidence_intervals()
        except NRFError as error:
            return {}, [f"No intervals: {error}"]
        return {
            str(row.parameter): (float(row.lower), float(row.upper))
            for row in table.itertuples()
        }, []

    def standard_errors(self) -> dict[str, float]:
        """Standard errors of masses and coefficients by noise, where they are known."""
        if self.intervals_withheld:
            return {}
        try:
            with warnings.catch_warnings(action="ignore", category=NRFWarning):
                return self.intervals.standard_errors()
        except NRFError:
            return {}

    def summary(self) -> Summary:
        """Estimates with errors, intervals, units and shares, and how they were found.

        Returns
        -------
        Summary
            ``str`` prints it; ``to_frame``, ``as_html``, ``as_latex``.
        """
        model = self.model
        shares = {} if self.data is None else shares_of(model, self.data)
        known = self.problem.known_masses
        table = summary_of(model, self.bounds[0], self.standard_errors(), shares, known)
        n_forces = sum(bool(laws) for laws in model.laws.values())
        return Summary(
            f"Identification of {model.n_dof} masses and {n_forces} restoring forces",
            self._head_of_summary(),
            table,
            self.verdict,
            self._notes_of_summary(),
        )

    def _notes_of_summary(self) -> list[str]:
        """Why there are no intervals, and the lower degree that does as well."""
        notes = list(self.bounds[1])
        if self.smaller_order is not None:
            notes.append(str(self.smaller_order))
        return notes

    def _head_of_summary(self) -> list[tuple[str, str]]:
        """Method, data, band and errors, by name."""
        head = [
            ("method", METHODS_IN_WORDS.get(self.method, self.method)),
            ("strategy", self.order.strategy),
            ("samples", str(self.n_samples)),
        ]
        if self.data is not None:
            rate = 1.0 / self.data.dt if self.data.dt else float("nan")
            head.append(("records", str(len(self.data.segments))))
            head.append(("sampling rate", f"{rate:.5g} Hz"))
        head.append(("band", band_text(self.problem.band)))
        if len(self.condition):
            head.append(("condition number", f"{self.condition.max():.3g}"))
        pooled = self.errors.loc["pooled", "error"]
        head.append(("balance error", f"{pooled:.3g} % NRMSE"))
        if self.data is not None and np.isfinite(self.free_runs.error):
            head.append(("free-run error", f"{self.free_runs.error:.3g} % NRMSE"))
        return head

    # -- free runs and the verdict ---------------------------------------------------

    @cached_property
    def free_runs(self) -> FreeRuns:
        """Free runs over the data of the fit, in the band of the fit."""
        if self.channel_runs is not None:
            return self.channel_runs
        data = self.require_data("Fit again to run the model over its data.")
        filters = self.problem.filters(data)
        return free_runs(self.model, data, filters, beside=self._sensitive_models)

    @cached_property
    def half_sample_models(self) -> tuple[ChainModel, ...]:
        """Models that differ from the estimate by about one standard error.

        Empty where there are none.
        """
        try:
            return half_sample_models(self.intervals.resolver)
        except NRFError:
            # the data are gone
            return ()

    @property
    def _sensitive_models(self) -> tuple[ChainModel, ...]:
        """Half-sample models whose free runs may differ much."""
        return self.half_sample_models if may_be_sensitive(self.model) else ()

    def spread_of_run(
        self, run: Record, run_beside: Callable[[ChainModel], Record]
    ) -> float:
        """Percent of a free run by which errors of the parameters move it.

        Parameters
        ----------
        run : Record
            Of the model.
        run_beside : callable
            Makes the run of another model under the same forces.

        Returns
        -------
        float
            By one standard error of the parameters; NaN where that is not known.
        """
        return spread_of(run, self._sensitive_models, run_beside)

    @property
    def unexplained(self) -> dict[int, float]:
        """Share of each equation of motion that the model leaves, percent NRMSE."""
        errors = self.errors["error"].drop("pooled")
        return {int(str(name)[4:]): float(error) for name, error in errors.items()}

    @cached_property
    def channel_faults(self) -> dict[str, bool]:
        """Channels of a floor that contradict each other, and whether that is sure."""
        return {} if self.data is None else suspect_channels(self.data.records)

    @cached_property
    def unseen_drifts(self) -> dict[int, float]:
        """Noise over rms of the drift of each storey that noise hides."""
        if self.data is None:
            return {}
        return unseen_drifts(self.data, self.channel_faults)

    @cached_property
    def alternatives(self) -> tuple[Alternative, ...]:
        """What the data allow besides the model, where every floor has a sensor."""
        if self.data is None or self.motions or self.unseen_drifts:
            return ()
        data, identified = self.data, None
        if not self.biased_by_noise and self.free_runs.error < GOOD_RUN:
            data, identified = _fused_apart(data), self.model
        try:
            return alternatives_of(self.problem, data, identified)
        except NRFError:
            # excerpts of these data cannot be solved
            return ()

    @cached_property
    def beside_noise(self) -> BesideNoise:
        """What the model leaves of each equation, and what noise would leave."""
        if self.data is None or self.motions:
            return BesideNoise()
        try:
            half_samples = self.half_sample_models
            return beside_noise(self.problem, self.model, self.data, half_samples)
        except NRFError:
            # a stretch of these records is no record by itself
            return BesideNoise()

    def residual_of_noise(
        self, rng: np.random.Generator | None = None
    ) -> Residual | None:
        """What noise like that of the channels leaves of the equations of motion.

        Parameters
        ----------
        rng : Generator, optional
            The same noise each time if None.

        Returns
        -------
        Residual or None
            None where the noise is not known.
        """
        if self.data is None or self.motions:
            return None
        try:
            return residual_of_noise(self.problem, self.model, self.data, rng)
        except NRFError:
            # a stretch of these records is no record by itself
            return None

    @cached_property
    def kinds_of_nonlinearity(self) -> dict[str, str]:
        """Kinds of the nonlinear forces of power series that the data show, by site.

        Empty texts where they are no more than chance; sites that cannot be tested are
        left out.
        """
        try:
            resolver = self.intervals.resolver
            return kinds_of_nonlinearity(self.model, self.sums, resolver)
        except NRFError:
            # the data are gone, or too few pieces for a test
            return {}

    @cached_property
    def assumptions(self) -> tuple[Assumption, ...]:
        """What sets the scale of the model, though nothing in the data checks it."""
        if self.data is None:
            return ()
        return scale_of(self.data.forced, self.problem.known_masses)

    @cached_property
    def facts(self) -> Facts:
        """What is known of the model and of its data."""
        bounds, no_bounds = self.bounds
        examined = self.examination
        noise_or_law = [*examined.masses]
        missing = examined.missing_terms
        for name in missing.index[missing["biased"].astype(bool)]:
            sentence = f"{name[0].upper()}{name[1:]}"
            noise_or_law.append(
                f"{sentence}: a law is missing, or the motion is noisy."
            )

        runs = None
        shares: Mapping[str, float] = {}
        ends: tuple[ShapeAtEnd, ...] = ()
        if self.data is not None:
            runs = self.free_runs
            shares = shares_of(self.model, self.data)
            if self.declared is not None:
                resolver = self.intervals.resolver
                ends = shapes_at_ends(self.declared, self.problem, self.data, resolver)

        kinds = self.kinds_of_nonlinearity
        holds = nonlinear_parts(self.model, shares, bounds, kinds)
        known = self.problem.known_masses
        return replace(
            facts_of_model(self.model, bounds, runs, known),
            unexplained=self.unexplained,
            beyond_noise=self.beside_noise.beyond(self.unexplained),
            left_over=self.beside_noise.left_over,
            channel_error=self.channel_error,
            holds=tuple(holds.values()),
            channel_faults=self.channel_faults,
            quality=examined.quality,
            n_records=examined.n_records,
            unseen_drifts=self.unseen_drifts,
            shapes_at_ends=ends,
            alternatives=self.alternatives,
            ambiguous_intervals=self.ambiguous_intervals,
            assumptions=self.assumptions,
            noise_or_law=tuple(noise_or_law),
            doubts=(*examined.forces, *examined.records, *no_bounds),
        )

    @cached_property
    def verdict(self) -> Verdict:
        """Whether the model may be used, what it holds, and why not."""
        return self.verdict_beside(())

    def verdict_beside(self, others: Sequence[OtherModel]) -> Verdict:
        """The verdict on the model where it was compared with others."""
        facts = replace(self.facts, other_models=tuple(others))
        if self.data is None:
            return verdict_after_search(facts, None)
        records = records_of(self.data)
        search = partial(wiring_error, self.problem, self.model, records)
        return verdict_after_search(facts, search)


def _fused_apart(data: Dataset) -> Dataset:
    """Each DOF fused by itself; the first fusion has warned."""
    with warnings.catch_warnings(action="ignore", category=DataQualityWarning):
        return data.apart
