"""What the whole search gains by chance, on records where nothing is missing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..exceptions import NRFError
from ..laws.sensor import SensorFault
from .bootstrap import simulated
from .candidate_search import SEARCH, CandidateSearch
from .effects import SearchState
from .error_reduction import ErrorReduction
from .judge import JUDGE
from .sensor_faults import FaultSearch


@dataclass(frozen=True)
class ChanceSettings:
    """Effort of the comparison with chance."""

    # Draws of chance: its error reduction exceeds four of its own in one case of five,
    # and a draw costs a search.
    draws: int = 4


CHANCE = ChanceSettings()


class ChanceTest:
    """Does a finding exceed what the search gains where the state is the truth?

    Parameters
    ----------
    state : SearchState
    search : CandidateSearch
    faults : sequence of SensorFault
    rng : Generator
    """

    def __init__(
        self,
        state: SearchState,
        search: CandidateSearch,
        faults: Sequence[SensorFault],
        rng: np.random.Generator,
    ) -> None:
        self.state = state
        self.search = search
        self.faults = faults
        self.rng = rng
        self._draws: dict[bool, list[float]] = {True: [], False: []}

    def largest(self, of_faults: bool) -> float | None:
        """The largest error reduction of the draws so far, dB; None without one."""
        return max(self._draws[of_faults], default=None)

    def is_exceeded_by(self, reduction: ErrorReduction, of_faults: bool) -> bool:
        """Whether an error reduction, less its standard error, exceeds chance.

        In one draw if by far, else in all of them.
        """
        draws, lower = self._draws[of_faults], reduction.lower
        while len(draws) < CHANCE.draws and lower >= max(draws, default=0.0):
            draws.append(self._draw(of_faults))
            if lower >= max(draws) + JUDGE.large_reduction:
                break
        return lower >= max([0.0, *draws])

    def _draw(self, of_faults: bool) -> float:
        """Error reduction of the whole search on simulated records, dB.

        Infinite where the model has no free run.
        """
        state = self.state
        assert state.records is not None
        drawn = next(simulated(state.records, state.model, self.rng), None)
        if drawn is None:
            return np.inf

        try:
            model = state.model.refitted(drawn.spectra)
            null = SearchState(model, state.effects, drawn.records)
            if of_faults:
                findings = FaultSearch(self.faults).findings(null)
            else:
                finalists = SEARCH.finalists_of_chance
                findings = self.search.findings(null, finalists=finalists)
        except NRFError:
            return np.inf
        return max((finding.value for finding in findings), default=0.0)
