"""Close the loop: prepare, search, judge, conclude, report."""

import sys
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.fft import next_fast_len
from threadpoolctl import threadpool_limits

from ..chain.sites import Site
from ..common import generator
from ..diagnosis.verdict import DOUBTFUL, free_runs, suspect_channels
from ..exceptions import BiasWarning, ChannelError, ExcitationError, NRFError
from ..identification.fewer_sensors import lacks_motion
from ..identification.fitted import wiring_of
from ..identification.intervals import tolerances_of
from ..identification.problem import LEAST_SQUARES, Problem
from ..identification.regressor import NRFRegressor
from ..laws.base import ForceLaw
from ..laws.elastic import LinearElastic
from ..laws.power_series import whole
from ..laws.sensor import SensorFault
from ..records.dataset import Dataset
from ..records.quality import QualityNote
from ..records.zero_phase_filter import filters_of
from .catalogue import as_laws, candidates, flexible
from .conclude import RUN, by_channels, concluded
from .constants import TOLERANCES
from .prepare import MOST, Prepared, Workspace, as_records, excerpts, prepare
from .report import LoopReport
from .ruler import Ruler, Trial
from .search import Forward, Search, proposals_of
from .state import State
from .windows import Windows, split, window_length


def close_loop(
    records: Any,
    baseline: NRFRegressor | None = None,
    catalogue: Iterable[Any] | None = None,
    heldout: Any = None,
    band: tuple[float | None, float | None] | None = None,
    random_state: Any = 0,
    *,
    max_steps: int | None = None,
    calibration: Mapping[str, float] | None = None,
    progress: Any = False,
) -> LoopReport:
    """Find the effects a model lacks, add them, and report the error before and after.

    The records are fused (:class:`KinematicSmoother`) and cut into folds; a quarter of
    each is put aside until the last line, or the records in ``heldout``. Columns and
    forces are cut into half-overlapping windows and transformed; the frequency bands in
    which the chain explains the balances are found once, before the search. Every law
    of the catalogue is then tried at every site where it makes sense, and laws of the
    storeys at all of them at once. The gain of a candidate is the fall of the
    cross-validated residual in dB, meaned over informative bands. An effect is accepted
    if its gain stands whichever fold is left out, if it changes the force at its site
    enough to matter, and if errors of the channels within their tolerances do not
    explain it as well. After each effect all shape parameters are refined and effects
    that became needless are taken out. Held-out data have the last word: an effect that
    does not lower their error, or takes a tenth neither of it nor of what the search
    leaves, is not confirmed, and the model does not hold it.

    Parameters
    ----------
    records : Record or sequence of Record
    baseline : NRFRegressor, optional
        The declared model; linear storeys if None (a spring without mass for records
        without a clock). Its data are not used.
    catalogue : iterable of ForceLaw, optional
        Laws to try; all of :mod:`pysindy_nrf.laws` that can be an effect if None.
    heldout : Record or sequence of Record, optional
        Records that only the last line sees.
    band : (float, float), optional
        Frequency band, Hz, outside of which no band is informative; the baseline's if
        None.
    random_state : int, Generator or None
        For the parametric bootstrap.
    max_steps : int, optional
        Effects at most; if None, one more than there are storeys, at least four, so
        that the search can end by itself.
    calibration : mapping, optional
        Errors that every channel may have: ``gain`` and ``cross_axis`` (part of another
        DOF's motion that it reads) as shares, 0.02 where nothing is known, and
        ``delay`` in s, 0.4 of a sampling step. What is none beyond them is not claimed.
    progress : bool or callable
        Show a progress bar (tqdm) where the error stream is a terminal; or call this
        once for each candidate.

    Returns
    -------
    LoopReport
        ``.steps``, ``.table``, ``.stopped_because``, ``.model``, ``.to_html``,
        ``.to_markdown``.

    Raises
    ------
    NRFError
        If the records or the baseline cannot be used, naming the channel and the cure.

    Examples
    --------
    >>> from pysindy_nrf import (
    ...     ChainModel,
    ...     close_loop,
    ...     excitation,
    ...     laws,
    ...     simulate,
    ... )
    >>> linear = [laws.LinearElastic(1e5), laws.LinearViscous(100.0)]
    >>> truth = ChainModel(
    ...     [10.0, 10.0],
    ...     {
    ...         "storey 1": [*linear, laws.CoulombFriction(30.0)],
    ...         "storey 2": linear,
    ...     },
    ... )
    >>> F = excitation.band_limited_random(
    ...     2, 8.0, 1000.0, excited=2, rms=100.0, band=(1, 60), random_state=0
    ... )
    >>> report = close_loop(simulate(truth, F, 1e-3))
    >>> report.steps[0].family, report.steps[0].site, report.steps[0].confirmed
    ('friction', 'storey 1', True)
    """
    mine, kept = as_records(records, "records"), as_records(heldout, "heldout")
    clock = all(rec.has_clock for rec in (*mine, *kept))
    if baseline is None:
        baseline = (
            NRFRegressor(degree=1)
            if clock
            else NRFRegressor(laws={1: [LinearElastic()]}, massless=True)
        )
    if not isinstance(baseline, NRFRegressor):
        raise NRFError(
            f"baseline={baseline!r} is not a model to begin with",
            "Give e.g. NRFRegressor(degree=1).",
        )
    max_steps = (
        max(4, mine[0].n_dof + 1)
        if max_steps is None
        else whole("max_steps", max_steps)
    )
    rng = generator(random_state)
    band = band if band is not None else baseline.band
    with threadpool_limits(
        1
    ):  # the matrices are small: threads only get in each other's way
        problem = baseline.problem(mine[0].n_dof)
        if not problem.needs_clock:
            mine, kept = ([rec.by_sample() for rec in held] for held in (mine, kept))
        settings = {
            "band": band,
            "random_state": random_state,
            "max_steps": max_steps,
            "baseline": baseline,
        }
        if lacks_motion([*mine, *kept]):
            _say_what_is_not_used(baseline)
            return by_channels(
                mine, kept, replace(problem, band=band), catalogue, settings
            )
        ready = prepare(mine, kept)
        _say_what_is_not_used(baseline)
        segments = ready.data.segments
        step = max(seg.dt or 1.0 for seg in segments)
        tolerances = tolerances_of(
            calibration, {**TOLERANCES, "delay": TOLERANCES["delay"] * step}
        )
        names = tuple(
            c
            for c in segments[0].covariates
            if all(c in s.covariates for s in segments)
        )
        tried = [
            law for law in as_laws(catalogue, names) if clock or not law.rate_dependent
        ]
        faults = [law for law in tried if isinstance(law, SensorFault)]
        for most in (MOST, np.inf):
            seen, ruler = _ruler(ready, problem, band, most)
            work = ruler.work.whole
            first = State(
                Trial(ruler, problem.chain, _baseline_laws(problem, ruler.work))
            )
            _require_covariates(first.trial.laws, ready)
            every = candidates(
                tried,
                problem.chain,
                problem.known_masses,
                names,
                work.forced,
                len(work.searched),
            )
            proposals = proposals_of(every, problem.chain.sites)
            with _bar(progress, max_steps * len(proposals)) as tick:
                search = Search(proposals, progress=tick)
                forward = Forward(search, first, seen, faults, rng, tolerances)
                forward.run(max_steps)
            if seen is ready or not any(
                effect.is_fault for effect in forward.state.effects
            ):
                break  # else again: a fault changes all samples
        first = first if seen is ready else forward.on_all(first, ready)
        report = concluded(
            forward,
            first,
            settings | {"catalogue": tried, "calibration": tolerances},
            rng,
        )
        begun = [
            replace(
                s, valid=slice(s.valid.start, min(s.valid.stop, s.valid.start + RUN))
            )
            for s in segments
        ]
        report.free_runs = free_runs(report.model, Dataset(begun, ready.data.n_samples))
        report.faults = suspect_channels((*mine, *kept))
        report.quality = tuple(QualityNote("other", text) for text in ready.data.doubts)
        if (
            report.faults
            or (report.beyond_noise > DOUBTFUL).any()
            or report.verdict.state == "red"
        ):
            report.wiring = wiring_of(baseline, problem, report.model, mine)
        return report


def _ruler(
    ready: Prepared, problem: Problem, band: Any, most: float
) -> tuple[Prepared, Ruler]:
    """What the search reads: records or excerpts of them, with folds, windows and
    informative bands.
    """
    filters_of(band, ready.data)  # a band that cannot be is refused here
    segments = ready.data.segments
    length = window_length(
        [s for i, s in enumerate(segments) if i not in (ready.heldout or ())]
    )
    whole = Workspace(
        ready.data, *split(segments, length, ready.heldout), problem.known_masses
    )
    if not whole.forced and not whole.known_masses:
        cure = "Give the baseline known_masses={dof: kg}."
        raise ExcitationError(
            "No force is measured and no mass is known, so nothing scales the chain",
            cure,
            argument="known_masses",
        )
    seen, work = excerpts(ready, whole, most)
    laws = _baseline_laws(problem, work)
    rich = flexible(replace(problem, laws=laws), work)
    if seen is not ready:
        dt = work.data.segments[0].step
        length = (
            2.0
            * dt
            * next_fast_len(round(0.5 * window_length(work.data.segments) / dt))
        )
    windows = Windows(work.data, work.search, length)
    windows = windows if band is None else windows.within(*band)
    ruler = Ruler(work, windows).find_bands(
        [(problem.chain, laws), (problem.chain, rich)]
    )
    for one in (whole, work):
        one.filters = filters_of(ruler.band(), one.data)
    return seen, ruler


def _baseline_laws(
    problem: Problem, work: Workspace
) -> Mapping[Site, tuple[ForceLaw, ...]]:
    """The laws of the baseline; shape parameters without a value are estimated on the
    search blocks.
    """
    if any(law.free_shape for held in problem.laws.values() for law in held):
        return problem.solve(
            Dataset([piece for _, piece in work.pieces()], work.data.n_samples)
        ).model.laws
    return dict(problem.laws)


@contextmanager
def _bar(progress: Any, total: int) -> Iterator[Any]:
    """A context that gives a function to be called once for each candidate."""
    if callable(progress) or not (progress and sys.stderr.isatty()):
        yield progress if callable(progress) else lambda: None
        return
    from tqdm import tqdm

    with tqdm(total=total, desc="candidates", file=sys.stderr, leave=False) as bar:
        yield bar.update


def _require_covariates(
    laws: Mapping[Site, Sequence[ForceLaw]], ready: Prepared
) -> None:
    """Every record, held-out ones too, has what the declared laws need."""
    for site, held in laws.items():
        needed = {name: law.name for law in held for name in law.covariates}
        for seg in ready.data.segments:
            for name in needed.keys() - seg.covariates.keys():
                what = (
                    f"Record {seg.name!r} has no covariate {name!r}, which"
                    f" {needed[name]} at {site} needs"
                )
                raise ChannelError(
                    what, "Give it in covariates=, or leave the record out."
                )


def _say_what_is_not_used(baseline: NRFRegressor) -> None:
    """The search is least squares, one balance after the other: what else the baseline
    asks for has no part in it.
    """
    asked = (
        [f"estimation={baseline.estimation!r}"]
        if baseline.estimation not in LEAST_SQUARES
        else []
    )
    asked += (
        [f"strategy={baseline.strategy!r}"]
        if baseline.strategy in ("complete", "joint")
        else []
    )
    asked += [
        f"{name}="
        for name in ("constraints", "optimizer")
        if getattr(baseline, name) is not None
    ]
    if asked:
        warnings.warn(
            "close_loop fits each balance by plain least squares and does not use"
            f" {', '.join(asked)} of the baseline. Fit"
            " NRFRegressor(laws=report.model.laws, ...) with it to the records"
            " afterwards.",
            BiasWarning,
            stacklevel=3,
        )


__all__ = ["close_loop"]
