"""The course of the loop, and the steps that do not depend on its equations."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Generic, TypeVar

from ..laws.base import ForceLaw
from ..records.dataset import Segment
from .catalogue import Experiment, candidates
from .effects import Candidate
from .folds import Split, split, window_length
from .report import LoopReport
from .request import LoopRequest, progress_bar

Records = TypeVar("Records")
Folds = TypeVar("Folds")
Start = TypeVar("Start")
Outcome = TypeVar("Outcome")
Concluded = TypeVar("Concluded")


@dataclass(frozen=True)
class WindowedFolds:
    """Folds and held-out pieces of all records, and the length of a window, s."""

    split: Split
    window: float


class Course(ABC, Generic[Records, Folds, Start, Outcome, Concluded]):
    """The six steps of the loop: each takes what the one before it returned.

    Where every floor has a sensor, the equations are balances of measured forces
    (:class:`~.balance_loop.BalanceLoop`); elsewhere they compare the measured channels
    with the free run of a model (:class:`~.channel_loop.ChannelLoop`).

    Parameters
    ----------
    request : LoopRequest
    """

    def __init__(self, request: LoopRequest) -> None:
        self.request = request

    def follow(self) -> LoopReport:
        """All steps, one after the other."""
        records = self.prepare()
        folds = self.split(records)
        start = self.find_bands(folds)
        outcome = self.search(start)
        judgement = self.judge(outcome)
        return self.report(judgement)

    @abstractmethod
    def prepare(self) -> Records:
        """Bring the records into the form that the equations read."""

    @abstractmethod
    def split(self, records: Records) -> Folds:
        """Cut the records into folds, and put held-out pieces aside."""

    @abstractmethod
    def find_bands(self, folds: Folds) -> Start:
        """Find the informative bands, and fit the declared model in them."""

    @abstractmethod
    def search(self, start: Start) -> Outcome:
        """Find effects that the declared model lacks."""

    @abstractmethod
    def judge(self, outcome: Outcome) -> Concluded:
        """Confirm effects on held-out data, and find how sure they are."""

    @abstractmethod
    def report(self, judgement: Concluded) -> LoopReport:
        """Gather what the user reads."""

    # -- steps that do not depend on the equations -----------------------------

    def folds_of(self, segments: Sequence[Segment]) -> WindowedFolds:
        """Cut all records into folds; those held out completely stand last."""
        n_searched = len(self.request.records)
        window = window_length(segments[:n_searched])
        heldout = None
        if self.request.heldout:
            heldout = range(n_searched, len(segments))
        return WindowedFolds(split(segments, window, heldout), window)

    def candidates(
        self,
        catalogue: Sequence[ForceLaw],
        forced: Collection[int],
        channels: Sequence[str],
    ) -> list[Candidate]:
        """Every law of a catalogue at every site where it makes sense.

        Parameters
        ----------
        catalogue : sequence of ForceLaw
        forced : collection of int
            DOFs on which a measured force acts.
        channels : sequence of str
            Covariates, and the motion of the base, that all records hold.
        """
        problem = self.request.problem
        experiment = Experiment(
            catalogue,
            problem.chain,
            problem.known_masses,
            forced,
            channels,
            len(self.request.records),
        )
        return list(candidates(experiment))

    @contextmanager
    def progress(self, n_tried: int) -> Iterator[Callable[[], object]]:
        """A function to be called once for each of so many candidates of a round."""
        total = self.request.max_steps * n_tried
        with progress_bar(self.request.progress, total) as tick:
            yield tick
