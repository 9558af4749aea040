"""Does the model hold what the data show? Judged from the data alone.

What a balance leaves unexplained is noise only if nothing can predict it. Each step of the
identification is therefore offered columns that its laws do not have (friction, quadratic,
kinked and fifth-power terms of the same storeys), on one half of the data, and the other half says whether they
help. Where they do, a law is missing (or noise in the motion stands in for one), and masses and
coefficients that least squares found without it are biased.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from scipy import linalg

from ..exceptions import BiasWarning
from ..laws.base import Motion
from ..layout import LawLayout, Layout
from ..moments import Block, Moments
from ..segments import Segment, SegmentSet
from ._inputs import as_segments

GAIN = 5.0  # percent of the held-out residual that the extra columns must remove
MISSING = 2.0  # percent of the balance's right-hand side that they must explain
_ROUND_OFF = 1e-6  # share of the balance below which a residual says nothing
_WINDOW = 1024
_WINDOWS = 32
_OFFERED = 7  # columns of _offered
_SCALE_ROWS = 10_000  # are enough for the rms of a channel
_FOLDS = 4
_ROWS_PER_COLUMN = 20  # fewer samples than this say nothing about further columns


def missing_terms(estimator: Any, X: Any, F: Any = None, **options: Any) -> pd.DataFrame:
    """What the laws of a fitted regressor leave to be explained, step by step.

    Parameters
    ----------
    estimator : fitted NRFRegressor
    X, F, **options
        The data of its ``fit``.

    Returns
    -------
    DataFrame
        One row for each step of the solve: ``residual`` (percent of its right-hand side), ``gain`` (percent of
        the held-out residual that columns the laws do not have remove), ``missing`` (what they explain, percent
        of the right-hand side), ``shift`` (percent by which the mass moves with them; NaN where the step has no
        unknown mass), ``biased`` (bool: gain above 5 % and missing above 2 %).

    Examples
    --------
    >>> import warnings
    >>> from pysindy_nrf import NRFRegressor, datasets
    >>> from pysindy_nrf.analysis import missing_terms
    >>> X, F = datasets.load_demo().to_features()
    >>> with warnings.catch_warnings():
    ...     warnings.simplefilter("ignore")
    ...     linear = NRFRegressor(degree=1).fit(X, F)  # storey 1 is cubic
    >>> missing_terms(linear, X, F)["biased"].to_dict()
    {'balance of DOF 2': False, 'balance of DOF 3': False, 'balance of DOF 1': True}
    """
    data = as_segments(estimator, X, F, **options)
    return missing_terms_of(estimator.model_, estimator.walk_, data, estimator.band)


def missing_terms_of(model: Any, walk: Any, data: SegmentSet, band: Any = None) -> pd.DataFrame:
    """:func:`missing_terms` for a model and the walk that found it."""
    layout = LawLayout(model.chain, model.laws)
    coefficients = model.coefficients
    # the columns of each site: its own, then those offered
    wide = Layout(layout.chain, {s: layout.counts[s] + _OFFERED for s in layout.acting})
    groups = [wide.group(dofs) for dofs in dict.fromkeys(step.dofs for step in walk.steps)]
    masses = dict(enumerate(model.masses.tolist(), 1))
    first = Moments(wide, groups, known_masses=masses)
    folds = [first, *(first.empty() for _ in range(1, _FOLDS))]
    counts = dict.fromkeys((g.dofs for g in groups), 0)
    n_rows = 0
    for i, (terms, extra, a, force) in enumerate(windows(layout, data, band)):
        n_rows += a.shape[1]
        columns = [x for s in layout.acting for x in (terms[layout.slices[s]], extra[s])]
        folds[i % _FOLDS].add(Block(np.vstack(columns) if columns else terms, a, force))
        for dofs in counts:
            counts[dofs] += not np.isnan(force[[j - 1 for j in dofs], 0]).any()
    rows = {}
    for step in walk.steps:
        if counts[step.dofs]:
            combine = _combination(step, layout, coefficients, masses, folds[0])
            grams = [combine.T @ fold.parts[step.dofs].matrix @ combine for fold in folds]
            n_own = len(step.masses) + sum(layout.counts[s] for s in step.sites)
            rows[step.name] = _judge(grams, n_own, bool(step.masses), n_rows, counts[step.dofs])
    table = pd.DataFrame.from_dict(rows, orient="index", columns=["residual", "gain", "shift"])
    table.insert(2, "missing", table["residual"] * np.sqrt(table["gain"] / 100))
    return table.assign(biased=(table["gain"] > GAIN) & (table["missing"] > MISSING))


def warn_of_bias(table: pd.DataFrame, masses: Sequence[str] = (), stacklevel: int = 2) -> None:
    """Raise one BiasWarning if masses are doubtful, or a step of :func:`missing_terms` is biased.

    Parameters
    ----------
    table : DataFrame
    masses : sequence of str
        Sentences of :func:`pysindy_nrf.chain_solve.doubtful_masses`.
    stacklevel : int

    Examples
    --------
    >>> import warnings
    >>> import pandas as pd
    >>> from pysindy_nrf.analysis import warn_of_bias
    >>> columns = {"residual": 40.0, "gain": 90.0, "missing": 38.0, "shift": 21.0, "biased": True}
    >>> table = pd.DataFrame(columns, index=["balance of DOF 1"])
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always")
    ...     warn_of_bias(table)
    >>> caught[0].category.__name__, str(caught[0].message).split(":")[0]
    ('BiasWarning', 'Balance of DOF 1')
    """
    said = list(masses)
    hit = table[table["biased"]]
    if len(hit):
        worst = hit["missing"].idxmax()
        row = hit.loc[worst]
        others = f" (and {len(hit) - 1} more)" if len(hit) > 1 else ""
        said.append(
            f"{worst[0].upper()}{worst[1:]}{others}: {row['residual']:.2g} % of it is unexplained, and that is not "
            f"noise alone: terms the laws do not have explain {row['gain']:.0f} % of it on held-out data. A law is "
            "missing there (hysteresis, friction, a gap) or the motion is noisy; masses and forces are likely biased. "
            "Add the law (laws=), search for it (close_loop), or fuse noisy channels with KinematicSmoother."
        )
    if said:
        warnings.warn(" ".join(said), BiasWarning, stacklevel=stacklevel)


# -- columns ----------------------------------------------------------------------------------


def windows(layout: LawLayout, data: SegmentSet, band: Any) -> Iterator[tuple]:
    """Some thousand rows in contiguous windows: own terms, extra terms by site, a and F."""
    from ..fair_filter import filters_of

    total = sum(seg.valid.stop - seg.valid.start for seg in data.segments)
    size = min(_WINDOW, max(total // (2 * _FOLDS), 1))
    first = data.segments[0].valid
    some = slice(first.start, first.stop, max(1, (first.stop - first.start) // _SCALE_ROWS))
    motions = [seg.motion(s, some) for seg in data.segments[:1] for s in layout.acting]
    scales = {s: (m.v.std() or 1.0, m.s.std() or 1.0) for s, m in zip(layout.acting, motions)}
    whole = band is not None
    every = max(1, -(-total // (size * _WINDOWS)))
    count = 0
    for seg, filter in zip(data.segments, filters_of(band, data)):
        if whole:
            block = next(iter(seg.blocks(layout, filter=filter)))
            extra = _offered({s: seg.motion(s, seg.valid) for s in layout.acting}, scales)
            if filter is not None:
                extra = {s: filter.apply(e.T).T for s, e in extra.items()}
        n = seg.valid.stop - seg.valid.start
        running = seg.blocks(layout, size, states={}) if layout.has_memory and not whole else None
        for start in range(0, max(n - size // 2, 1), size):
            count += 1
            rows = slice(start, min(start + size, n))
            window = None if running is None else next(running)  # a state needs all that lies before
            if (count - 1) % every:
                continue
            if whole:
                offered = {s: e[:, rows] for s, e in extra.items()}
                yield block.terms[:, rows], offered, block.acceleration[:, rows], block.force[:, rows]
            else:
                piece = _part(seg, rows)
                window = window or next(iter(piece.blocks(layout, size=rows.stop - rows.start)))
                offered = _offered(_motions(piece, window, layout), scales)
                yield window.terms, offered, window.acceleration, window.force


def _motions(piece: Segment, window: Block, layout: LawLayout) -> dict[Any, Any]:
    """What a law at each site sees; taken from the block where its columns were built from it."""
    assert window.recipe is not None and window.source is not None  # no filter went over it
    sites, source = window.recipe.motions, window.source
    held = {s: Motion(source[len(sites) + i], source[i]) for i, s in enumerate(sites)}
    return {s: held[s] if s in held else piece.motion(s, piece.valid) for s in layout.acting}


def _part(seg: Segment, rows: slice) -> Segment:
    first = seg.valid.start
    return replace(seg, valid=slice(first + rows.start, first + rows.stop))


def _offered(motions: dict[Any, Any], scales: dict[Any, tuple[float, float]]) -> dict[Any, np.ndarray]:
    """Columns that stand for what a law may lack, one row each: friction, hysteresis, kinks."""
    if not motions:
        return {}
    v = np.array([m.v / scales[site][0] for site, m in motions.items()])
    s = np.array([m.s / scales[site][1] for site, m in motions.items()])
    forward = np.sign(v)
    # drift since the last reversal: on it a saturated hysteresis depends (Masing's rule)
    turn = np.where(np.diff(forward, axis=1, prepend=forward[:, :1]) != 0, np.arange(v.shape[1]), 0)
    way = np.abs(s - np.take_along_axis(s, np.maximum.accumulate(turn, axis=1), axis=1))
    loops = [forward * (1.0 - 2.0 * np.exp(-sharp * way)) for sharp in (1.0, 5.0, 25.0)]
    size = np.abs(s)
    rows = np.array([forward, v * np.abs(v), s * size, np.maximum(size - 1.0, 0.0) * np.sign(s), *loops])
    return {site: rows[:, i] for i, site in enumerate(motions)}


def _combination(step: Any, layout: LawLayout, coefficients: dict, masses: dict, moments: Moments) -> np.ndarray:
    """From the columns of a group to [own columns | offered columns | right-hand side] of one step."""
    where, mass_at, target_at = moments.positions(step.dofs)
    signs = dict(zip(moments.groups[step.dofs].sites, moments.groups[step.dofs].signs))
    own = [mass_at] if step.masses else []
    own += [where[s].start + k for s in step.sites for k in range(layout.counts[s])]
    offered = [where[s].stop - _OFFERED + k for s in (*step.sites, *step.known_sites) for k in range(_OFFERED)]
    out = np.zeros((target_at + 1, len(own) + len(offered) + 1))
    out[[*own, *offered], np.arange(len(own) + len(offered))] = 1.0
    out[target_at, -1] = 1.0
    if mass_at is not None and not step.masses:
        out[mass_at, -1] = -masses[step.dofs[0]]
    for site in step.known_sites:
        out[where[site].start : where[site].stop - _OFFERED, -1] = -signs[site] * coefficients[site]
    return out


# -- judgement --------------------------------------------------------------------------------


def _judge(
    folds: list[np.ndarray], n_own: int, has_mass: bool, n_rows: int, n_windows: int
) -> tuple[float, float, float]:
    total = np.sum(folds, axis=0)
    scale = np.sqrt(np.diag(total))
    scale[scale == 0] = 1.0
    grams = [g / scale[:, None] / scale for g in folds]
    total = total / scale[:, None] / scale
    p = len(total) - 1
    own = np.arange(n_own)
    both = np.arange(p)
    c = _solve(total, own)
    residual = _left(total, own, c)
    share = np.sqrt(residual / total[p, p]) if total[p, p] else 0.0
    if share < _ROUND_OFF or n_windows < 2 * _FOLDS or n_rows < _ROWS_PER_COLUMN * p:
        return 100 * share, 0.0, 0.0 if has_mass else np.nan
    with_own = with_both = 0.0
    for fold in range(_FOLDS):
        test = grams[fold]
        train = total - test
        with_own += _left(test, own, _solve(train, own))
        with_both += _left(test, both, _solve(train, both))
    gain = 100 * max(0.0, 1 - with_both / with_own)
    return 100 * share, gain, _move(total, own, both) if has_mass else np.nan


def _move(gram: np.ndarray, own: np.ndarray, both: np.ndarray) -> float:
    """Percent by which the mass, the first column, moves with the offered columns."""
    mass = _solve(gram, own)[0]
    return 100 * (_solve(gram, both)[0] / mass - 1) if mass else 0.0


def _solve(gram: np.ndarray, columns: np.ndarray) -> np.ndarray:
    return linalg.lstsq(gram[np.ix_(columns, columns)], gram[columns, -1], cond=1e-13, check_finite=False)[0]


def _left(gram: np.ndarray, columns: np.ndarray, c: np.ndarray) -> float:
    """Residual sum of squares of given coefficients."""
    inner = gram[np.ix_(columns, columns)]
    return float(max(gram[-1, -1] - 2 * c @ gram[columns, -1] + c @ inner @ c, 0.0))
