"""The steps of a loop, whatever its equations."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Generic, TypeVar

from .judgement import Judgement
from .report import LoopReport
from .request import LoopRequest

Records = TypeVar("Records")
Folds = TypeVar("Folds")
Start = TypeVar("Start")
Found = TypeVar("Found")
Concluded = TypeVar("Concluded", bound=Judgement)


class Course(ABC, Generic[Records, Folds, Start, Found, Concluded]):
    """The steps of a loop: each takes what the one before it returned.

    Parameters
    ----------
    request : LoopRequest
    """

    def __init__(self, request: LoopRequest) -> None:
        self.request = request

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
    def search(self, start: Start) -> Found:
        """Find effects that the declared model lacks."""

    @abstractmethod
    def judge(self, found: Found) -> Concluded:
        """Confirm effects on held-out data, and say how sure they are."""

    @abstractmethod
    def report(self, judgement: Concluded) -> LoopReport:
        """Gather what the user reads."""

    def run(self) -> LoopReport:
        """All steps, one after the other."""
        records = self.prepare()
        folds = self.split(records)
        start = self.find_bands(folds)
        found = self.search(start)
        judgement = self.judge(found)
        return self.report(judgement)
