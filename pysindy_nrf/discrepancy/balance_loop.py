"""The loop on records in which every floor has a sensor: its equations are balances."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from scipy.fft import next_fast_len

from ..chain.sites import Site
from ..common.warn import warn_user
from ..exceptions import ChannelError, ExcitationError, RankWarning
from ..identification.problem import Problem
from ..laws.base import ForceLaw
from ..records.dataset import Dataset, Segment
from ..records.zero_phase_filter import filters_of
from . import wording
from .balance_judgement import BalanceJudge, BalanceJudgement, BalanceOutcome
from .balance_report import balance_report
from .band_search import find_bands
from .catalogue import flexible, with_all_storeys
from .channel_errors import ChannelErrorTest
from .class_search import ClassSearch, SearchTools
from .course import Course
from .effect_judge import EffectJudge
from .effects import SearchState
from .estimate_judge import EstimateJudge, leaves_open
from .excerpts import excerpts
from .final_estimate import FinalEstimates
from .fitted_model import fit_model
from .folds import window_length
from .places import places_of
from .prepare import PreparedRecords, prepare, with_corrected_channels
from .report import LoopReport
from .search_data import SearchData
from .sensor_faults import FaultSearch
from .spectra import BalanceSpectra
from .windows import Windows


@dataclass(frozen=True, eq=False)
class SplitRecords:
    """Fused records with their folds and held-out pieces.

    Attributes
    ----------
    records : PreparedRecords
    data : SearchData
    window : float
        Length of a window, s.
    """

    records: PreparedRecords
    data: SearchData
    window: float


@dataclass(frozen=True, eq=False)
class BalanceStart:
    """What a search begins with.

    Attributes
    ----------
    folds : SplitRecords
        All samples.
    first : SearchState
        The declared model, fitted in the informative bands, and the records that the
        search reads: all samples, or excerpts of long records.
    """

    folds: SplitRecords
    first: SearchState

    @property
    def reads_excerpts(self) -> bool:
        """Whether the search reads excerpts of long records."""
        return self.first.records is not self.folds.records


class BalanceLoop(
    Course[
        PreparedRecords, SplitRecords, BalanceStart, BalanceOutcome, BalanceJudgement
    ]
):
    """The loop on records in which every floor has a sensor.

    Parameters
    ----------
    request : LoopRequest
    """

    def follow(self) -> LoopReport:
        """All steps, one after the other.

        Again with all records to search, where those to search do not determine the
        declared model.
        """
        start = self.find_bands(self.split(self.prepare()))
        effect_judge = EffectJudge(bool(self.request.heldout))
        if leaves_open(start.first.model, effect_judge):
            cure = (
                "Search records that excite more frequencies, or judge the model on"
                " records that the loop has not seen."
            )
            warn_user(RankWarning(wording.HELDOUT_IS_SEARCHED, cure))
            return BalanceLoop(self.request.searching_all()).follow()

        outcome = self.search(start)
        judgement = self.judge(outcome)
        return self.report(judgement)

    # -- prepare, split, find bands --------------------------------------------

    def prepare(self) -> PreparedRecords:
        """Fuse the channels of every record to one motion."""
        prepared = prepare(self.request.records, self.request.heldout)
        require_covariates(self.request.problem, prepared)
        return with_corrected_channels(prepared, self.request.problem)

    def split(self, records: PreparedRecords) -> SplitRecords:
        """Cut the records into folds, and put held-out pieces aside."""
        # a band that cannot be is refused here
        filters_of(self.request.band, records.data)
        folds = self.folds_of(records.data.segments)
        data = SearchData(records.data, folds.split, self.request.problem.known_masses)
        if not data.forced and not data.known_masses:
            raise ExcitationError(
                "No force is measured and no mass is known, so nothing scales the"
                " chain",
                "Give the baseline known_masses={dof: kg}.",
                argument="known_masses",
            )
        return SplitRecords(records, data, folds.window)

    def find_bands(self, folds: SplitRecords) -> BalanceStart:
        """Find the informative bands; of long records on excerpts."""
        records, data = excerpts(folds.records, folds.data)
        window = folds.window
        if data is not folds.data:
            window = _fast_window(data.data.segments)
        return self._start(folds, SplitRecords(records, data, window))

    def _start(self, folds: SplitRecords, searched: SplitRecords) -> BalanceStart:
        """Find the informative bands, and fit the declared model in them.

        Parameters
        ----------
        folds, searched : SplitRecords
            All samples, and those that the search reads.
        """
        problem, band = self.request.problem, self.request.band
        data = searched.data
        laws = declared_laws(problem, data)
        rich = flexible(replace(problem, laws=laws), data)
        windows = Windows(data.data, data.search, searched.window)
        if band is not None:
            windows = windows.within(*band)

        bands = find_bands(BalanceSpectra(data, windows), problem.chain, [laws, rich])
        windows = windows.up_to(bands.n_bands - 1)
        data = data.diagnosed_in(bands.limits(windows.edges, data.fastest))
        spectra = BalanceSpectra(data, windows, bands)
        model = fit_model(spectra, problem.chain, laws)
        folds = replace(folds, data=data.full)
        return BalanceStart(folds, SearchState(model, records=searched.records))

    # -- search ----------------------------------------------------------------

    def search(self, start: BalanceStart) -> BalanceOutcome:
        """Search by excerpts, then fit to all samples of long records.

        Search all samples if a fault is found: it changes them.
        """
        outcome = self._search(start)
        if not start.reads_excerpts:
            return outcome
        if any(effect.is_fault for effect in outcome.result.effects):
            return self._search(self._start(start.folds, start.folds))

        result = outcome.search.on_all_samples(outcome.result)
        searched = start.first.model.spectra
        return replace(
            outcome, records=outcome.measured, result=result, excerpts=searched
        )

    def _search(self, start: BalanceStart) -> BalanceOutcome:
        """One search, on all samples or on excerpts."""
        request = self.request
        chain = request.problem.chain
        data = start.folds.data
        alone = self.candidates(request.catalogue, data.forced, request.channels)
        constants = [c for c in alone if c.law.variable == "1"]
        others = [c for c in alone if c.law.variable != "1"]
        places = places_of(with_all_storeys(others, chain.sites), chain, chain.sites)
        estimates = FinalEstimates(request)
        with self.progress(len(places)) as tick:
            tools = SearchTools(
                # few frequencies do not separate a fault from a stiffness or a mass
                FaultSearch(request.faults, only_witnessed=request.searches_heldout),
                ChannelErrorTest(request.calibration),
                EffectJudge(bool(request.heldout)),
                EstimateJudge(estimates, request.searches_heldout),
                tick,
            )
            search = ClassSearch(places, tools, constants)
            result = search.add_effects(start.first, request.max_steps)

        measured = start.folds.records
        return BalanceOutcome(
            measured, result.state.records or measured, result, search, estimates
        )

    # -- judge, report ---------------------------------------------------------

    def judge(self, outcome: BalanceOutcome) -> BalanceJudgement:
        """Confirm effects on held-out data, and find how sure they are."""
        return BalanceJudge(self.request, outcome).judge()

    def report(self, judgement: BalanceJudgement) -> LoopReport:
        """Gather what the user reads."""
        return balance_report(self.request, judgement)


def _fast_window(segments: Sequence[Segment]) -> float:
    """Length of a window of excerpts that is fast to transform, s."""
    step = segments[0].step
    half = round(0.5 * window_length(segments) / step)
    return float(2.0 * step * next_fast_len(half))


def declared_laws(
    problem: Problem, data: SearchData
) -> Mapping[Site, tuple[ForceLaw, ...]]:
    """The laws of the baseline, shape parameters without a value estimated.

    On the folds of the search.
    """
    for laws in problem.laws.values():
        if any(law.free_shape for law in laws):
            pieces = [piece for _, piece in data.pieces()]
            return problem.solve(Dataset(pieces, data.data.n_samples)).model.laws
    return dict(problem.laws)


def require_covariates(problem: Problem, records: PreparedRecords) -> None:
    """Refuse records, held-out ones too, that lack what the declared laws need."""
    needed = {}
    for site, laws in problem.laws.items():
        for law in laws:
            needed.update(dict.fromkeys(law.covariates, f"{law.name} at {site}"))

    for segment in records.data.segments:
        for name, law_and_site in needed.items():
            if name not in segment.covariates:
                raise ChannelError(
                    f"Record {segment.name!r} has no covariate {name!r}, which"
                    f" {law_and_site} needs",
                    "Give it in covariates=, or leave the record out.",
                )
