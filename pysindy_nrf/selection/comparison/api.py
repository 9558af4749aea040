"""Plain SINDy and this package side by side, on the same data in the same call."""

from __future__ import annotations

import time
import tracemalloc
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from ...exceptions import ChannelError, NRFError, SimulationError
from ...laws import PowerSeries
from ...laws.shape import Motion
from ...regression.chain_model import ChainModel
from ...regression.errors import nrmse
from ...regression.input_arrays import from_arrays
from ..sparsity import default_paths
from .contenders import HandSteeredSINDy, Ours, Part, PlainSINDy, Ruler


@dataclass(frozen=True)
class Comparison:
    """Plain SINDy and this package on the same data."""

    table: pd.DataFrame  # see :func:`compare_with_sindy`
    # see :func:`~pysindy_nrf.selection.comparison.term_shares`; drawn by
    # :class:`pysindy_nrf.output.displays.CoefficientsDisplay`
    coefficients: pd.DataFrame


def compare(
    X: Any,
    F: Any = None,
    dt: float | None = None,
    *,
    truth: ChainModel | None = None,
    degree: int = 3,
    optimizers: Mapping[str, Any] | str | None = None,
    heldout: float = 0.3,
    free_run: int = 500,
    time_limit: float = 10.0,
    coordinates: str = "relative",
) -> Comparison:
    """Fit plain SINDy and this package to the same data: the table, and what each makes of every storey.

    Parameters
    ----------
    X, F, dt, truth, degree, optimizers, heldout, free_run, time_limit, coordinates
        See :func:`compare_with_sindy`.

    Returns
    -------
    Comparison

    Raises
    ------
    ChannelError
        If the record has several parts or no sampling step.

    Examples
    --------
    >>> from pysindy_nrf import ChainModel, excitation, laws, simulate
    >>> from pysindy_nrf.selection.comparison import compare
    >>> storey = laws.PowerSeries(1, [100.0, 1e5])
    >>> truth = ChainModel([10.0, 10.0], {1: storey, 2: storey})
    >>> F = excitation.band_limited_random(2, 2.0, 1000.0, dofs=[1, 2], rms=50.0, band=(1, 60), random_state=0)
    >>> found = compare(simulate(truth, F, 1e-3), truth=truth, free_run=20, optimizers={})
    >>> stiffness = found.coefficients.loc[("storey 1", "s")]
    >>> bool(abs(stiffness["truth"] - stiffness["pysindy_nrf, least squares"]) < 0.01)
    True
    """
    data = from_arrays(X, F, coordinates=coordinates, dt=dt)
    if len(data.segments) != 1 or data.segments[0].ag is not None:
        raise ChannelError("The comparison takes one contiguous record on a base at rest", "Choose one record.")
    segment = data.segments[0]
    step = segment.dt
    if step is None:
        raise ChannelError("The comparison needs the sampling step", "Pass dt= in s.")
    if not 0 < heldout < 1:
        raise ChannelError(f"heldout={heldout!r} is not a share", "Give a number between 0 and 1.")
    rows = segment.valid
    a, v, s, force = (getattr(segment, k)[rows].astype(float) for k in ("a", "v", "s", "F"))
    whole = Part(a, v, s, force, step)
    if np.isnan(whole.F).any():
        raise ChannelError("A force is unknown", "SINDy needs every force: give zeros where none acts.")
    cut = round(len(whole.a) * (1 - heldout))
    search, rest = whole.part(slice(0, cut)), whole.part(slice(cut, None))
    given = _optimizers(optimizers)
    entries: dict[str, Any] = {
        "SINDy, defaults": PlainSINDy(degree, normalise=False),
        "SINDy, normalised": PlainSINDy(degree, normalise=True),
        "SINDy, hand-steered": HandSteeredSINDy(degree),
        "pysindy_nrf, least squares": Ours(degree, None),
        **{f"pysindy_nrf, {name}": Ours(degree, optimizer) for name, optimizer in given.items()},
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        reference = Ours(degree, None)
        reference.fit(search)
        ruler = Ruler.of(truth if truth is not None else reference.model.model_, truth is not None, whole, cut)
        found = {name: row_of(entry, search, rest, ruler, free_run, time_limit) for name, entry in entries.items()}
    lines = {name: line for name, (line, _) in found.items()}
    forces = {name: R for name, (_, R) in found.items() if R is not None}
    if ruler.known:
        forces = {"truth": ruler.R, **forces}
    table = pd.DataFrame.from_dict(lines, orient="index", columns=COLUMNS).rename_axis("model")
    return Comparison(table, term_shares(forces, rest, degree, ruler.size))


def compare_with_sindy(
    X: Any,
    F: Any = None,
    dt: float | None = None,
    *,
    truth: ChainModel | None = None,
    degree: int = 3,
    optimizers: Mapping[str, Any] | str | None = None,
    heldout: float = 0.3,
    free_run: int = 500,
    time_limit: float = 10.0,
    coordinates: str = "relative",
) -> pd.DataFrame:
    """Fit plain SINDy and this package to the first part of a record and judge them on the rest.

    Parameters
    ----------
    X : array-like of shape (n_samples, 3 n_dof), DataFrame or Record
        As for :meth:`NRFRegressor.fit`: one contiguous record, base at rest.
    F : array-like of shape (n_samples, n_dof)
        Applied forces, N.
    dt : float
        Sampling step, s; not needed with a Record or a time index.
    truth : ChainModel, optional
        The structure, if it is known (a simulation): gives ``precision``, ``recall``, ``mass_error``
        and ``restoring_force_error``.
    degree : int
        Of the power series everywhere.
    optimizers : mapping of str to PySINDy optimizer or sequence of them, or "select", optional
        Rows of this package beside least squares. Of a sequence the held-out rule of
        :func:`~pysindy_nrf.selection.select_sparsity` chooses one, within the first part of the
        record, and ``note`` says which; ``"select"`` takes its default paths (STLSQ, ensemble, SR3, SSR,
        FROLS). STLSQ at PySINDy's default threshold (a tenth of each balance's force) and at a hundredth
        if None.
    heldout : float
        Share of the record at its end on which all errors are measured.
    free_run : int
        Most samples of the free run; PySINDy takes 2 to 30 ms for each.
    time_limit : float
        Seconds after which a free run through PySINDy is given up.
    coordinates : {"relative", "absolute"}
        See :class:`NRFRegressor`.

    Returns
    -------
    DataFrame
        One row for each model:

        * ``SINDy, defaults``: state [x, xdot], u = F, ``PolynomialLibrary(degree)``, default STLSQ;
        * ``SINDy, normalised``: the same with ``normalize_columns=True``;
        * ``SINDy, hand-steered``: inter-storey state, no products between storeys, only the forces that
          act, normalised columns, threshold one percent of the smallest target;
        * ``pysindy_nrf, ...``: least squares and the optimizers given.

        Columns: ``terms`` (coefficients that are not zero), ``precision`` and ``recall`` (shares) of
        the true terms in each model's own library; ``mass_error`` (largest, percent);
        ``restoring_force_error`` and ``balance_error`` (pooled percent NRMSE, one step);
        ``free_run_error`` (percent NRMSE of the displacements, inf if it diverges);
        ``third_law_gap`` (largest disagreement of the two estimates of a storey, percent) and
        ``storeys_found`` (``"once"`` or ``"twice"``); ``seconds`` of the fit, choosing
        included, and ``megabytes`` of the fit without it; ``note``. NaN = cannot be known.

    Raises
    ------
    ChannelError
        If the record has several parts or no sampling step.
    NRFError
        If ``optimizers`` is another word.

    Notes
    -----
    SINDy finds accelerations, not forces. To give it a restoring force, and balance errors in N, it
    is handed the masses: the true ones, or those of this package's least squares. All rows see the
    same measured accelerations.

    Examples
    --------
    >>> from pysindy_nrf import ChainModel, excitation, laws, simulate
    >>> from pysindy_nrf.selection.comparison import compare_with_sindy
    >>> storey = laws.PowerSeries(1, [100.0, 1e5])
    >>> truth = ChainModel([10.0, 10.0], {1: storey, 2: storey})
    >>> F = excitation.band_limited_random(2, 2.0, 1000.0, dofs=[1, 2], rms=50.0, band=(1, 60), random_state=0)
    >>> table = compare_with_sindy(simulate(truth, F, 1e-3), truth=truth, free_run=20)
    >>> bool(table.loc["pysindy_nrf, STLSQ", "terms"] < table.loc["SINDy, normalised", "terms"])
    True
    """
    return compare(
        X, F, dt, truth=truth, degree=degree, optimizers=optimizers, heldout=heldout, free_run=free_run,
        time_limit=time_limit, coordinates=coordinates,
    ).table  # fmt: skip


def _optimizers(given: Mapping[str, Any] | str | None) -> Mapping[str, Any]:
    if given is None:
        from pysindy import STLSQ

        return {"STLSQ": STLSQ(), "STLSQ, threshold 0.01": STLSQ(threshold=0.01)}
    if given == "select":
        return {f"{name} selected": path for name, path in default_paths().items()}
    if isinstance(given, str):
        raise NRFError(f"optimizers={given!r} is unknown", "Give 'select', or optimizers by name.")
    return given


COLUMNS = [
    "terms", "precision", "recall", "mass_error", "restoring_force_error", "balance_error", "free_run_error",
    "third_law_gap", "storeys_found", "seconds", "megabytes", "note",
]  # fmt: skip
_MOST_WORK = 2e11  # multiplications of a fit, some ten seconds


def row_of(
    entry: Any, search: Part, rest: Part, ruler: Ruler, free_run: int, time_limit: float
) -> tuple[list[Any], np.ndarray | None]:
    """The row of one model (see ``COLUMNS``), and the storey forces (N) it finds on the held-out part."""
    if entry.work(search) > _MOST_WORK:
        size = entry.n_features(search)
        gigabytes = 32e-9 * size * (len(search.a) + size)
        note = f"not run: {size} columns of {len(search.a)} samples take minutes and {gigabytes:.1f} GB"
        return [np.nan] * 8 + ["", np.nan, np.nan, note], None
    start = time.perf_counter()
    entry.fit(search)
    seconds = time.perf_counter() - start
    megabytes = _peak(lambda: entry.fit(search))
    masses = entry.masses(search)
    handed = masses if entry.finds_masses else ruler.model.masses
    a_hat = entry.accelerations(rest)
    R = np.cumsum((rest.F - handed * a_hat)[:, ::-1], axis=1)[:, ::-1]
    precision, recall = (
        entry.hits(search, ruler.model) if ruler.known and not ruler.model.has_memory else (np.nan, np.nan)
    )
    run, note = _free_run(entry, rest.part(slice(0, max(2, free_run))), time_limit)
    gap, found = entry.third_law(ruler.model.masses)
    return [
        entry.terms,
        precision,
        recall,
        float(np.max(np.abs(100 * (masses / ruler.model.masses - 1)))) if ruler.known else np.nan,
        ruler.force_error(R) if ruler.known else np.nan,
        ruler.balance_error(handed, a_hat, rest),
        run,
        gap,
        found,
        seconds,
        megabytes,
        "; ".join(filter(None, (entry.note, note))),
    ], R


def _peak(work: Callable[[], Any]) -> float:
    """Peak memory of a piece of work, MB."""
    running = tracemalloc.is_tracing()
    if not running:
        tracemalloc.start()
    tracemalloc.reset_peak()
    before = tracemalloc.get_traced_memory()[0]
    work()
    peak = tracemalloc.get_traced_memory()[1] - before
    if not running:
        tracemalloc.stop()
    return peak / 1e6


def _free_run(entry: Any, rest: Part, time_limit: float) -> tuple[float, str]:
    try:
        x = entry.run(rest, time.perf_counter() + time_limit)
    except TimeoutError:
        return np.nan, f"free run given up after {time_limit:g} s"
    except (SimulationError, OverflowError, FloatingPointError):
        return np.inf, "free run diverges"
    if not np.isfinite(x).all():
        return np.inf, "free run diverges"
    share = [nrmse(rest.x[:, j], x[:, j]) for j in range(rest.n_dof)]
    return float(np.sqrt(np.mean(np.square(share)))), ""


ELSEWHERE = "other"


def term_shares(forces: Mapping[str, np.ndarray], part: Part, degree: int, size: np.ndarray) -> pd.DataFrame:
    """Storey forces of each model, taken apart into the terms of their own storey."""
    law, rows = PowerSeries(degree), {}
    labels = [term.label for term in law.terms()]
    for i in range(part.n_dof):
        columns = law.features(Motion(part.s[:, i], part.v[:, i]))
        scale = np.sqrt(np.mean(columns**2, axis=0))
        scale[scale == 0] = 1.0
        wanted = np.column_stack([R[:, i] for R in forces.values()])
        found = np.linalg.lstsq(columns / scale, wanted, rcond=None)[0]
        left = np.sqrt(np.mean((wanted - columns / scale @ found) ** 2, axis=0))
        for label, row in zip([*labels, ELSEWHERE], np.vstack([found, left]) / size[i]):
            rows[f"storey {i + 1}", label] = row
    index = pd.MultiIndex.from_tuples(rows, names=["site", "term"])
    return pd.DataFrame(np.array(list(rows.values())), index=index, columns=list(forces))
