"""What a user asks of the loop."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from ..common import generator
from ..exceptions import NRFError
from ..identification.door import (
    RECORDS_WITH_GAPS,
    choose_method,
    refuse_arguments,
)
from ..identification.intervals import tolerances_of
from ..identification.problem import Problem
from ..identification.regressor import NRFRegressor
from ..laws.base import ForceLaw
from ..laws.elastic import LinearElastic
from ..laws.power_series import whole_number
from ..laws.sensor import SensorFault
from ..records.input_arrays import lacks_motion
from ..records.record import Record
from .catalogue import LawOrClass, as_laws, default_catalogue, short_catalogue
from .channel_errors import default_tolerances
from .prepare import Band, as_records

# Effects that are looked for at least, so that a search can end by itself.
LEAST_EFFECTS = 4
Progress = bool | Callable[[], object]
Records = Record | Sequence[Record]
RandomState = int | np.random.Generator | None


@dataclass(frozen=True, eq=False)
class LoopRequest:
    """The arguments of the loop, checked.

    Attributes
    ----------
    records, heldout : list of Record
    baseline : NRFRegressor
    problem : Problem
        Of the baseline.
    catalogue : list of ForceLaw
        Laws that the records can show.
    covariates : tuple of str
        Measured channels that all records hold.
    band : (float, float) or None
        Hz.
    max_steps : int
    calibration : dict of str to float
        Errors that every channel may have.
    random_state : int, Generator or None
        As given.
    rng : Generator
    progress : bool or callable
    searches_heldout : bool
        Whether records that the user held out are among those to search.
    """

    records: list[Record]
    heldout: list[Record]
    baseline: NRFRegressor
    problem: Problem
    catalogue: list[ForceLaw]
    covariates: tuple[str, ...]
    band: Band | None
    max_steps: int
    calibration: dict[str, float]
    random_state: RandomState
    rng: np.random.Generator
    progress: Progress
    searches_heldout: bool = False

    @property
    def all_records(self) -> list[Record]:
        """Records to search, then those held out."""
        return [*self.records, *self.heldout]

    @property
    def lacks_motion(self) -> bool:
        """Whether some floor has no sensor in a record."""
        return lacks_motion(self.all_records)

    @property
    def channels(self) -> tuple[str, ...]:
        """Covariates, with the motion of the base where it moves in all records."""
        return _with_base(self.all_records, self.covariates)

    def searching_all(self) -> LoopRequest:
        """The same with all records to search."""
        return replace(
            self, records=self.all_records, heldout=[], searches_heldout=True
        )

    @property
    def faults(self) -> list[SensorFault]:
        """Faults of sensors in the catalogue."""
        return [law for law in self.catalogue if isinstance(law, SensorFault)]


@dataclass(frozen=True)
class SearchLimits:
    """How far a search goes, and how it shows its progress."""

    max_steps: int | None
    calibration: Mapping[str, float] | None
    random_state: RandomState
    progress: Progress


def read_request(
    records: Records,
    heldout: Records | None,
    baseline: NRFRegressor | None,
    catalogue: Iterable[LawOrClass] | None,
    band: Band | None,
    limits: SearchLimits,
) -> LoopRequest:
    """Check the arguments of the loop, and fill in what is not given.

    Raises
    ------
    NRFError
        Naming the argument and the cure.
    """
    searched = as_records(records, "records")
    not_searched = as_records(heldout, "heldout")
    has_clock = all(rec.has_clock for rec in (*searched, *not_searched))
    model = _baseline(baseline, has_clock)
    problem = model.problem(searched[0].n_dof).along(searched[0])
    if not problem.needs_clock:
        searched = [rec.by_sample() for rec in searched]
        not_searched = [rec.by_sample() for rec in not_searched]

    every = [*searched, *not_searched]
    if lacks_motion(every):
        _refuse_settings_of_balances(model, limits)
    covariates = _shared_covariates(every)
    laws = _catalogue(catalogue, every, covariates)
    if not has_clock:
        laws = [law for law in laws if not law.rate_dependent]
    tolerances = default_tolerances(_longest_step(every))

    return LoopRequest(
        searched,
        not_searched,
        model,
        problem,
        laws,
        covariates,
        model.band if band is None else band,
        _max_steps(limits.max_steps, searched[0].n_dof),
        tolerances_of(limits.calibration, tolerances),
        limits.random_state,
        generator(limits.random_state),
        limits.progress,
    )


def _shared_covariates(records: Sequence[Record]) -> tuple[str, ...]:
    """Covariates that all records hold."""
    shared = set(records[0].covariates)
    for record in records:
        shared &= set(record.covariates)
    return tuple(name for name in records[0].covariates if name in shared)


def _longest_step(records: Sequence[Record]) -> float:
    """The longest sampling step, s; 1 where there is no clock."""
    return max((rec.dt for rec in records if rec.has_clock), default=1.0)


def _baseline(baseline: NRFRegressor | None, has_clock: bool) -> NRFRegressor:
    """The declared model; linear storeys, or a spring without mass, if None."""
    if baseline is None:
        if has_clock:
            return NRFRegressor(degree=1)
        return NRFRegressor(laws={1: [LinearElastic()]}, massless=True)
    if not isinstance(baseline, NRFRegressor):
        raise NRFError(
            f"baseline={baseline!r} is not a model to begin with",
            "Give e.g. NRFRegressor(degree=1).",
        )
    return baseline


def _refuse_settings_of_balances(baseline: NRFRegressor, limits: SearchLimits) -> None:
    """Refuse what has no part where the equations are channels, not balances."""
    choose_method(baseline.estimation, RECORDS_WITH_GAPS)
    settings = {
        "calibration": limits.calibration,
        "constraints": baseline.constraints,
        "optimizer": baseline.optimizer,
        "strategy": None if baseline.strategy == "auto" else baseline.strategy,
    }
    refuse_arguments(settings, "a search with fewer sensors")


def _max_steps(asked: int | None, n_dof: int) -> int:
    """Effects at most; one more than there are storeys if it is not given."""
    if asked is None:
        return max(LEAST_EFFECTS, n_dof + 1)
    return whole_number("max_steps", asked)


def _catalogue(
    asked: Iterable[LawOrClass] | None,
    records: Sequence[Record],
    covariates: Sequence[str],
) -> list[ForceLaw]:
    """The laws that a user passed, or those that the records can show."""
    if asked is not None:
        return as_laws(asked)
    if lacks_motion(records):
        return short_catalogue()
    return default_catalogue(_with_base(records, covariates))


def _with_base(records: Sequence[Record], covariates: Sequence[str]) -> tuple[str, ...]:
    """Names of channels, with the motion of a base that moves in all records."""
    if not all(rec.base_moves for rec in records):
        return tuple(covariates)
    return tuple(dict.fromkeys([*covariates, "ag", "vg"]))


@contextmanager
def progress_bar(progress: Progress, total: int) -> Iterator[Callable[[], object]]:
    """A context that gives a function to be called once for each candidate."""
    if callable(progress):
        yield progress
        return
    if not progress or not sys.stderr.isatty():
        yield lambda: None
        return

    from tqdm import tqdm

    with tqdm(total=total, desc="candidates", file=sys.stderr, leave=False) as bar:
        yield bar.update
