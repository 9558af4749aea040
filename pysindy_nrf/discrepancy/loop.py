"""Close the loop: prepare, split, find bands, search, judge, report."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from threadpoolctl import threadpool_limits

from ..identification.regressor import NRFRegressor
from .balance_loop import BalanceLoop
from .catalogue import LawOrClass
from .channel_loop import ChannelLoop
from .prepare import Band
from .report import LoopReport
from .request import Progress, RandomState, Records, SearchLimits, read_request


def close_loop(
    records: Records,
    baseline: NRFRegressor | None = None,
    catalogue: Iterable[LawOrClass] | None = None,
    heldout: Records | None = None,
    band: Band | None = None,
    random_state: RandomState = 0,
    *,
    max_steps: int | None = None,
    calibration: Mapping[str, float] | None = None,
    progress: Progress = False,
) -> LoopReport:
    """Find the effects a model lacks, add them, and report the error before and after.

    The records are fused (:class:`KinematicSmoother`) and cut into folds. A quarter of
    each record, or the records in ``heldout``, are put aside. Columns and forces are
    cut into half-overlapping windows and transformed. The frequency bands in which the
    chain explains the equations of motion are found once, before the search.

    At every site the general law of each class, or its names, are fitted. The names of
    the best places are tried. The error reduction of a candidate is the fall of the
    cross-validated residual in dB, averaged over informative bands. An effect must
    stand whichever fold is left out, and change the force at its site enough to matter.
    Errors of the channels within their tolerances must not explain it. It must hold at
    another condition: on another record, at another amplitude, or at another time.

    Held-out records judge one effect after another, so that their errors are not those
    of untouched data. Keep a third record for them.

    Where a floor has no sensor, candidates are ranked by the effect of their force on
    the measured channels along the free run of the model.

    Parameters
    ----------
    records : Record or sequence of Record
    baseline : NRFRegressor, optional
        The declared model; linear storeys if None (a spring without mass for records
        without a clock). Its data are not used. The search is least squares of each
        equation of motion; the final estimate uses ``estimation`` (``"auto"`` by
        instruments), ``strategy``, ``constraints`` and ``optimizer``. The free run is
        fitted with ``estimation="simulation"`` only, which takes many times longer.
    catalogue : iterable of ForceLaw, optional
        Laws to try; all of :mod:`pysindy_nrf.laws` that can be an effect if None.
    heldout : Record or sequence of Record, optional
        Records that judge the effects; a quarter of each record if None. They are
        searched, too, if the others leave the declared model open.
    band : (float, float), optional
        Frequency band, Hz, outside of which no band is informative; the baseline's if
        None.
    random_state : int, Generator or None
        Of the noise that is drawn to show what noise leaves of the equations.
    max_steps : int, optional
        Effects at most; if None, one more than there are storeys, at least four, so
        that the search can end by itself.
    calibration : mapping, optional
        Errors that every channel may have: ``gain`` and ``cross_axis`` (part of another
        DOF's motion that it reads) as shares, 0.02 where nothing is known, and
        ``delay`` in s, 0.4 of a sampling step. No effect is
        claimed that such errors explain.
    progress : bool or callable
        Show a progress bar (tqdm) where the error stream is a terminal; or call this
        once for each candidate.

    Returns
    -------
    LoopReport
        ``.steps``, ``.table``, ``.stopped_because``, ``.model``, ``.to_html``,
        ``.to_markdown``.

    Warns
    -----
    RankWarning
        If records held out were searched, since the others do not determine the
        declared model.

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
    limits = SearchLimits(max_steps, calibration, random_state, progress)
    request = read_request(records, heldout, baseline, catalogue, band, limits)

    # the matrices are small: threads only get in each other's way
    with threadpool_limits(1):
        if request.lacks_motion:
            return ChannelLoop(request).follow()
        return BalanceLoop(request).follow()


__all__ = ["close_loop"]
