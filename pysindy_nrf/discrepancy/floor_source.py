"""Where the loop takes its noise floor from: its own surrogates, repeated records, or the user."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from ..exceptions import ChannelError
from ..regression.chain_model import ChainModel
from ..regression.errors import balance_sizes, pooled_percent
from ..regression.segments import SegmentSet
from .gate import MIN_GAIN
from .noise_floor import NoiseFloor
from .residual import Residual, residual_of
from .stage import Trial
from .surrogate import Null
from .workspace import Workspace

_FEWEST = 64


class FloorSource:
    """What noise alone would leave of the forces, model by model.

    Parameters
    ----------
    given : {"channels", "repeats"}, float, mapping of int to float or NoiseFloor
        As for :func:`~pysindy_nrf.close_loop`.
    n_dof : int

    Attributes
    ----------
    words : str
        Where the floor comes from.

    Raises
    ------
    ChannelError
        If it is something else, or does not fit the chain.
    """

    def __init__(self, given: Any, n_dof: int) -> None:
        self.repeats = isinstance(given, str) and given == "repeats"
        self.known: NoiseFloor | None = None
        self.words = "surrogates with the noise of the channels"
        if self.repeats:
            self.words = "repeated records"
        elif isinstance(given, NoiseFloor):
            self.known = given
        elif isinstance(given, (Mapping, float, int, list, tuple, np.ndarray)) and not isinstance(given, bool):
            self.known = NoiseFloor.given(given, n_dof)
        elif not (isinstance(given, str) and given == "channels"):
            raise ChannelError(
                f"noise_floor={given!r} is unknown",
                "Choose 'channels' or 'repeats', or give the rms of the noise in each balance, N: {dof: rms}.",
            )
        if self.known is not None:
            self.words = self.known.source
            if len(self.known.balance) != n_dof:
                raise ChannelError(
                    f"The noise floor has {len(self.known.balance)} balances, the chain {n_dof}",
                    "Make it of records of the same chain.",
                )

    @property
    def measured(self) -> bool:
        """Whether the floor does not rest on the model itself, so that the gate may rely on it."""
        return self.repeats or self.known is not None

    def of(self, trial: Trial) -> NoiseFloor | None:
        """The floor of one model; None where the surrogates have to tell it."""
        return NoiseFloor.from_repeats(repeated(trial.work, trial.model())) if self.repeats else self.known

    def percent(self, trial: Trial, null: Null) -> float:
        """Pooled balance error that noise alone leaves of one model, percent NRMSE; NaN if unknown."""
        floor = self.of(trial)
        if floor is None:
            return null.floor
        blocks = range(len(trial.work.search))
        solution, grams, balances = trial.solve(blocks), trial.total(blocks), []
        for j in range(1, trial.work.n_dof + 1):
            sizes = balance_sizes(j, solution.masses, solution.coefficients, grams)
            if sizes is not None:
                from_top = tuple(range(j, trial.work.n_dof + 1)) in grams.groups
                level = float((floor.storey if from_top else floor.balance)[j - 1])
                balances.append(sizes._replace(residual=level))
        return pooled_percent(balances)

    def closes(self, trial: Trial, error: float, null: Null) -> bool:
        """Whether no law could pass the gate, by a floor that was measured or given: even one that left only noise."""
        return self.measured and error * (1.0 - MIN_GAIN) <= self.percent(trial, null)


def repeated(work: Workspace, model: ChainModel) -> Residual:
    """Residual of repeated records along the rows that the search may see in all of them."""
    used = list(work.searched)
    segments = [work.data.segments[i] for i in used]
    least = min(seg.n_samples for seg in segments)
    seen = np.all([work.seen_rows(i)[:least] for i in used], axis=0)
    edges = np.flatnonzero(np.diff(np.r_[False, seen, False].astype(int)))
    runs = edges.reshape(-1, 2)
    first, last = max(runs, key=lambda r: r[1] - r[0]) if len(runs) else (0, 0)
    if len(used) < 2 or last - first < _FEWEST:
        raise ChannelError(
            f"{len(used)} record{'s' * (len(used) != 1)} with {last - first} rows in common tell no noise",
            "Give repetitions of one test, aligned sample by sample, or noise_floor='channels'.",
        )
    data = SegmentSet(segments, work.data.n_samples)
    whole = residual_of(model, data, [work.filters[i] for i in used])
    pieces = [replace(seg, valid=slice(int(first), int(last))) for seg in segments]
    cut = [e[first - seg.valid.start : last - seg.valid.start] for e, seg in zip(whole.balance, segments)]
    return replace(whole, data=SegmentSet(pieces, work.data.n_samples)).with_balance(cut)
