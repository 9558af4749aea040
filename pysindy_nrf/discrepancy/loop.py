"""Close the loop: find the residual, trace it to an effect, add the effect, judge it, repeat."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from threadpoolctl import threadpool_limits

from ..common.random_state import generator
from ..estimation.problem import Problem
from ..estimation.regressor import NRFRegressor
from ..exceptions import BiasWarning, ChannelError, ExcitationError, NRFError
from ..laws.base import ForceLaw
from ..laws.power_series import whole
from ..laws.sensor import SensorFault
from ..mechanics.sites import Site
from ..regression.segments import SegmentSet
from ..signals.zero_phase_filter import filters_of
from .begin_elsewhere import explored
from .catalogue import as_laws, candidates
from .conclusion import concluded
from .floor_source import FloorSource
from .prepare import Prepared, prepare
from .report import LoopReport, audit
from .rounds import Rounds
from .splits import split
from .stage import Stage
from .workspace import Workspace


def close_loop(
    records: Any,
    baseline: NRFRegressor | None = None,
    catalogue: Iterable[Any] | None = None,
    heldout: Any = None,
    band: tuple[float | None, float | None] | None = None,
    random_state: Any = 0,
    *,
    max_steps: int = 4,
    n_surrogates: int = 2,
    noise_floor: Any = "channels",
    progress: bool = False,
) -> LoopReport:
    """Find the effects a model lacks, add them, and report the error before and after.

    The records are fused (:class:`KinematicSmoother`), cut into contiguous blocks of equal energy,
    and a quarter of each, between blocks of the search (or the records in ``heldout``), is put aside
    until the last line.
    Every law of the catalogue is tried at every site where it makes sense: its columns are built
    from the raw motion, filtered like the rest, and the whole chain is solved again with it (variable
    projection). The best is accepted if the median error over blocks it was not fitted to falls by
    at least 15 %, in at least 80 % of the blocks, by more than the same law gains on surrogates that
    hold the same noise and no effect, and if the model's free run does not get worse. Where none passes
    alone, the best of several sites are put to the gate together. After each, the shape parameters of
    all are estimated again and what a later effect made needless is taken out. Then the next is looked
    for. A law of the family of an earlier one at its site takes its place, or stands beside it where both are missed;
    a fault of a sensor that is corrected again remains one step. Where the effects do not explain what there is, the
    search begins again with another place first, and what explains clearly more is kept.

    Parameters
    ----------
    records : Record or sequence of Record
    baseline : NRFRegressor, optional
        The declared model; linear storeys if None. Its data are not used.
    catalogue : iterable of ForceLaw, optional
        Laws to try; all of :mod:`pysindy_nrf.laws` that can be an effect if None.
    heldout : Record or sequence of Record, optional
        Records that only the last line sees.
    band : (float, float), optional
        Frequency band, Hz, in which everything is fitted and judged; the baseline's if None. Where displacements were
        not measured, motions and forces begin where the accelerations tell the motion; the report says where. It does
        not change during the search.
    random_state : int, Generator or None
        For the surrogates.
    max_steps : int
        Effects at most.
    n_surrogates : int
        Surrogates for the null reference; 0 leaves it out.
    noise_floor : {"channels", "repeats"}, float, mapping of int to float or NoiseFloor
        What noise alone leaves of the forces, against which residuals, remainders and the certainty of
        names are measured. ``"channels"``: of the surrogates, whose noise is that by which the channels of a DOF
        contradict each other. ``"repeats"``: the records are repetitions of one test, sample by sample, and
        differ by noise. Or the rms of the noise in each balance, N: one number, or by DOF. A floor that is
        measured or given, and so does not rest on the model, also stops the loop where it is reached.
    progress : bool
        Show a progress bar (tqdm) where the error stream is a terminal.

    Returns
    -------
    LoopReport
        ``.steps``, ``.table``, ``.stopped_because``, ``.model``, ``.to_html``, ``.to_markdown``.

    Raises
    ------
    NRFError
        If the records or the baseline cannot be used, naming the channel and the cure.

    Examples
    --------
    >>> from pysindy_nrf import ChainModel, close_loop, excitation, laws, simulate
    >>> linear = [laws.LinearElastic(1e5), laws.LinearViscous(100.0)]
    >>> truth = ChainModel([10.0, 10.0], {"storey 1": [*linear, laws.CoulombFriction(30.0)], "storey 2": linear})
    >>> F = excitation.band_limited_random(2, 8.0, 1000.0, dofs=2, rms=100.0, band=(1, 60), random_state=0)
    >>> report = close_loop(simulate(truth, F, 1e-3))
    >>> report.steps[0].family, report.steps[0].site
    ('friction', 'storey 1')

    Where the balances are known to be no better than 10 N, that friction of 30 N is still heard, and nothing else:

    >>> report = close_loop(simulate(truth, F, 1e-3), noise_floor={1: 10.0, 2: 10.0})
    >>> [step.law for step in report.steps], "noise" in report.stopped_because
    (['coulomb_friction'], True)
    """
    baseline = baseline if baseline is not None else NRFRegressor(degree=1)
    if not isinstance(baseline, NRFRegressor):
        raise NRFError(f"baseline={baseline!r} is not a model to begin with", "Give e.g. NRFRegressor(degree=1).")
    max_steps, n_surrogates = whole("max_steps", max_steps), whole("n_surrogates", n_surrogates)
    rng = generator(random_state)
    band = band if band is not None else baseline.band
    ready = prepare(records, heldout)
    floors = FloorSource(noise_floor, ready.data.n_dof)
    search, held = split(ready.data.segments, ready.heldout)
    problem = baseline.problem(ready.data.n_dof)
    chain, known = problem.chain, problem.known_masses
    filters = filters_of(band, ready.data)
    work = Workspace(ready.data, filters, search, held, known, baseline.strategy)
    if not work.forced and not known:
        raise ExcitationError(
            "No force is measured and no mass is known, so nothing scales the chain",
            "Give the baseline known_masses={dof: kg}.",
        )
    first = _baseline_laws(problem, work)
    _require_covariates(first, ready)
    _say_what_is_not_used(baseline)
    names = tuple(c for c in ready.data.segments[0].covariates if all(c in s.covariates for s in ready.data.segments))
    tried = as_laws(catalogue, names)
    every = list(candidates(tried, chain, known, names, work.forced, len(work.searched)))
    sensors = [law for law in tried if isinstance(law, SensorFault)]
    rounds = Rounds(ready, work, every, sensors, floors, rng, n_surrogates, progress)
    with threadpool_limits(1):  # the matrices are small: threads only get in each other's way
        rounds = explored(rounds, Stage(work, chain, first), max_steps)
        report = concluded(rounds, band if band is not None else ready.band)
    words = floors.words if n_surrogates or floors.measured else "not known: no surrogates were run"
    report.settings = audit(baseline, tried, band, random_state, max_steps, n_surrogates, ready, words)
    return report


def _baseline_laws(problem: Problem, work: Workspace) -> Mapping[Site, tuple[ForceLaw, ...]]:
    """The laws of the baseline; shape parameters without a value are estimated on the search blocks."""
    if any(law.free_shape for held in problem.laws.values() for law in held):
        return problem.solve(SegmentSet([piece for _, piece in work.pieces()], work.data.n_samples)).model.laws
    return dict(problem.laws)


def _require_covariates(laws: Mapping[Site, Sequence[ForceLaw]], ready: Prepared) -> None:
    """Every record, held-out ones too, has what the declared laws need."""
    for site, held in laws.items():
        needed = {name: law.name for law in held for name in law.covariates}
        for seg in ready.data.segments:
            for name in needed.keys() - seg.covariates.keys():
                raise ChannelError(
                    f"Record {seg.name!r} has no covariate {name!r}, which {needed[name]} at {site} needs",
                    "Give it in covariates=, or leave the record out.",
                )


def _say_what_is_not_used(baseline: NRFRegressor) -> None:
    """The search is least squares: what else the baseline asks for has no part in it."""
    asked = [f"estimation={baseline.estimation!r}"] if baseline.estimation != "ls" else []
    asked += [f"{name}=" for name in ("constraints", "optimizer") if getattr(baseline, name) is not None]
    if asked:
        warnings.warn(
            f"close_loop fits by plain least squares and does not use {', '.join(asked)} of the baseline. Fit "
            "NRFRegressor(laws=report.model.laws, ...) with it to the records afterwards.",
            BiasWarning,
            stacklevel=3,
        )


__all__ = ["close_loop"]
