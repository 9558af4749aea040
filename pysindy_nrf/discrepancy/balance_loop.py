"""The loop on records in which every floor has a sensor: its equations are balances."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from scipy.fft import next_fast_len

from ..chain.sites import Site
from ..exceptions import ChannelError, ExcitationError
from ..identification.problem import Problem
from ..laws.base import ForceLaw
from ..records.dataset import Dataset
from ..records.zero_phase_filter import filters_of
from .balance_judgement import BalanceFound, BalanceJudge, BalanceJudgement
from .balance_report import balance_report
from .band_search import find_bands
from .candidate_search import CandidateSearch
from .catalogue import Experiment, candidates, flexible, with_all_storeys
from .channel_errors import ChannelErrorTest
from .effects import Candidate, SearchState
from .excerpts import excerpts
from .fitted_model import FittedModel, fit_model
from .folds import split, window_length
from .prepare import PreparedRecords, prepare
from .report import LoopReport
from .request import LoopRequest, progress_bar
from .search_data import SearchData
from .spectra import BalanceSpectra
from .stepwise import SearchResult, StepwiseSearch
from .windows import Windows


@dataclass(frozen=True, eq=False)
class SplitRecords:
    """Fused records with their folds and held-out pieces."""

    records: PreparedRecords
    data: SearchData


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


class BalanceLoop:
    """The loop on records in which every floor has a sensor.

    Parameters
    ----------
    request : LoopRequest
    """

    def __init__(self, request: LoopRequest) -> None:
        self.request = request

    # -- prepare, split, find bands --------------------------------------------

    def prepare(self) -> PreparedRecords:
        """Fuse the channels of every record to one motion."""
        return prepare(self.request.records, self.request.heldout)

    def split(self, records: PreparedRecords) -> SplitRecords:
        """Cut the records into folds, and put held-out pieces aside."""
        request = self.request
        # a band that cannot be is refused here
        filters_of(request.band, records.data)
        segments = records.data.segments
        n_searched = len(records.searched)
        length = window_length(segments[:n_searched])
        folds = split(segments, length, records.heldout)
        data = SearchData(records.data, *folds, request.problem.known_masses)
        if not data.forced and not data.known_masses:
            raise ExcitationError(
                "No force is measured and no mass is known, so nothing scales the"
                " chain",
                "Give the baseline known_masses={dof: kg}.",
                argument="known_masses",
            )
        return SplitRecords(records, data)

    def find_bands(self, folds: SplitRecords) -> BalanceStart:
        """Find the informative bands; of long records on excerpts."""
        records, data = excerpts(folds.records, folds.data)
        return self._start(folds, records, data)

    def _start(
        self, folds: SplitRecords, records: PreparedRecords, data: SearchData
    ) -> BalanceStart:
        """Find the informative bands, and fit the declared model in them."""
        problem, band = self.request.problem, self.request.band
        laws = declared_laws(problem, data)
        rich = flexible(replace(problem, laws=laws), data)
        windows = Windows(data.data, data.search, self._window(folds, data))
        if band is not None:
            windows = windows.within(*band)

        bands = find_bands(BalanceSpectra(data, windows), problem.chain, [laws, rich])
        windows = windows.up_to(bands.n_bands - 1)
        data = data.seen_through(bands.limits(windows.edges, data.fastest))
        spectra = BalanceSpectra(data, windows, bands)
        model = fit_model(spectra, problem.chain, laws)
        require_covariates(model, folds.records)
        folds = replace(folds, data=data.full)
        return BalanceStart(folds, SearchState(model, records=records))

    def _window(self, folds: SplitRecords, data: SearchData) -> float:
        """Length of a window, s; of excerpts one that is fast to transform."""
        n_searched = len(folds.records.searched)
        if data is folds.data:
            return window_length(data.data.segments[:n_searched])
        segments = data.data.segments
        step = segments[0].step
        half = round(0.5 * window_length(segments) / step)
        return float(2.0 * step * next_fast_len(half))

    # -- search ----------------------------------------------------------------

    def search(self, start: BalanceStart) -> BalanceFound:
        """Search by excerpts, then fit to all samples of long records.

        Search all samples if a fault is found: it changes them.
        """
        search, result = self._search(start)
        if not start.reads_excerpts:
            return self._found(start, search, result, None)

        if any(effect.is_fault for effect in result.effects):
            folds = start.folds
            start = self._start(folds, folds.records, folds.data)
            search, result = self._search(start)
            return self._found(start, search, result, None)

        searched = start.first.model.spectra
        result = search.on_all_samples(result)
        return self._found(start, search, result, searched)

    def _search(self, start: BalanceStart) -> tuple[StepwiseSearch, SearchResult]:
        """One search, on all samples or on excerpts."""
        request = self.request
        tried = self._candidates(start)
        total = request.max_steps * len(tried)
        with progress_bar(request.progress, total) as tick:
            search = StepwiseSearch(
                CandidateSearch(tried, tick),
                request.faults,
                ChannelErrorTest(request.calibration),
                request.rng,
            )
            return search, search.run(start.first, request.max_steps)

    def _candidates(self, start: BalanceStart) -> list[Candidate]:
        """Every law of the catalogue at every site where it makes sense."""
        data, problem = start.folds.data, self.request.problem
        experiment = Experiment(
            self.request.catalogue,
            problem.chain,
            problem.known_masses,
            data.forced,
            self.request.channels,
            len(data.searched),
        )
        return with_all_storeys(candidates(experiment), problem.chain.sites)

    def _found(
        self,
        start: BalanceStart,
        search: StepwiseSearch,
        result: SearchResult,
        searched: BalanceSpectra | None,
    ) -> BalanceFound:
        """What was found, with the records of all samples."""
        measured = start.folds.records
        records = measured
        if searched is None and result.state.records is not None:
            records = result.state.records
        return BalanceFound(measured, records, result, search, searched)

    # -- judge, report ---------------------------------------------------------

    def judge(self, found: BalanceFound) -> BalanceJudgement:
        """Confirm effects on held-out data, and find how sure they are."""
        return BalanceJudge(self.request, found).judge()

    def report(self, judgement: BalanceJudgement) -> LoopReport:
        """Gather what the user reads."""
        return balance_report(self.request, judgement)


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


def require_covariates(model: FittedModel, records: PreparedRecords) -> None:
    """Refuse records, held-out ones too, that lack what the declared laws need."""
    needed = {}
    for site, laws in model.laws.items():
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
