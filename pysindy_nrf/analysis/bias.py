"""Does the model hold what the data show? Judged from the data alone.

What a balance leaves unexplained is noise only if nothing can predict it. Each step of the
identification is therefore offered columns that its laws do not have (friction, quadratic,
kinked and fifth-power terms of the same storeys), on one half of the data, and the other half says whether they
help. Where they do, a law is missing (or noise in the motion stands in for one), and masses and
coefficients that least squares found without it are biased. A constant and a straight line in time are offered too, by
themselves: they are no law, but what a sensor leaves that reads a wrong zero or drifts.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy import linalg

from ..exceptions import BiasWarning
from ..layout import LawLayout, Layout
from ..moments import Block, Moments
from ..segments import SegmentSet
from ._inputs import as_segments
from .windows import FOLDS, LASTING, OFFERED, Window, show

GAIN = 5.0  # percent of the held-out residual that the extra columns must remove
MISSING = 2.0  # percent of the balance's right-hand side that they must explain
STILL = 90.0  # percent of the held-out residual that a constant and a ramp must remove for zeros to be doubted
_ROUND_OFF = 1e-6  # share of the balance below which a residual says nothing
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
        unknown mass), ``lasting`` (percent of the held-out residual that a constant and a ramp in time remove: a
        sensor with a wrong zero or a drift), ``biased`` (bool: gain above 5 % and missing above 2 %).

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
    judge = MissingTerms(model, walk)
    show(judge.layout, data, band, [judge])
    return judge.table()


class MissingTerms:
    """Collects what :func:`missing_terms` needs to know of some windows.

    Parameters
    ----------
    model : ChainModel
    walk : Walk
    """

    def __init__(self, model: Any, walk: Any) -> None:
        self.walk, self.layout = walk, LawLayout(model.chain, model.laws)
        self.coefficients = model.coefficients
        # the columns of each site: its own, then those offered
        wide = Layout(self.layout.chain, {s: self.layout.counts[s] + OFFERED for s in self.layout.acting})
        groups = [wide.group(dofs) for dofs in dict.fromkeys(step.dofs for step in walk.steps)]
        self.masses = dict(enumerate(model.masses.tolist(), 1))
        first = Moments(wide, groups, known_masses=self.masses)
        self.folds = [first, *(first.empty() for _ in range(1, FOLDS))]
        self.counts = dict.fromkeys((g.dofs for g in groups), 0)
        self.n_rows = 0

    def see(self, number: int, window: Window) -> None:
        """Take a window in."""
        self.n_rows += window.a.shape[1]
        slices = self.layout.slices
        columns = [x for s in self.layout.acting for x in (window.terms[slices[s]], window.offered[s])]
        self.folds[number % FOLDS].add(Block(np.vstack(columns) if columns else window.terms, window.a, window.force))
        for dofs in self.counts:
            self.counts[dofs] += not np.isnan(window.force[[j - 1 for j in dofs], 0]).any()

    def table(self) -> pd.DataFrame:
        """As :func:`missing_terms` returns it."""
        rows = {}
        for step in self.walk.steps:
            if self.counts[step.dofs]:
                combine = _combination(step, self.layout, self.coefficients, self.masses, self.folds[0])
                grams = [combine.T @ fold.parts[step.dofs].matrix @ combine for fold in self.folds]
                n_own = len(step.masses) + sum(self.layout.counts[s] for s in step.sites)
                rows[step.name] = _judge(grams, n_own, bool(step.masses), self.n_rows, self.counts[step.dofs])
        table = pd.DataFrame.from_dict(rows, orient="index", columns=["residual", "gain", "shift", "lasting"])
        table.insert(2, "missing", table["residual"] * np.sqrt(table["gain"] / 100))
        return table.assign(biased=(table["gain"] > GAIN) & (table["missing"] > MISSING))


def wrong_zeros(table: pd.DataFrame) -> list[str]:
    """A question on the zeros of sensors, where a constant or a ramp explains nearly all that a balance leaves.

    Parameters
    ----------
    table : DataFrame
        Of :func:`missing_terms`.

    Returns
    -------
    list of str
        One sentence, or none.

    Examples
    --------
    >>> import pandas as pd
    >>> from pysindy_nrf.analysis.bias import wrong_zeros
    >>> columns = {"residual": 40.0, "gain": 30.0, "missing": 22.0, "shift": 9.0, "lasting": 99.0, "biased": True}
    >>> wrong_zeros(pd.DataFrame(columns, index=["balance of DOF 2"]))[0].split(". ")[1].split("?")[0]
    'Does a displacement there (of DOF 2 or a neighbour) or its force read a wrong zero, or drift'
    """
    if "lasting" not in table:
        return []
    size = table["residual"] * np.sqrt(table["lasting"] / 100)
    hit = size[(table["lasting"] > STILL) & (size > MISSING)]
    if not len(hit):
        return []
    worst = str(hit.idxmax())
    row = table.loc[worst]
    others = f" (and {len(hit) - 1} more)" if len(hit) > 1 else ""
    where = worst.removeprefix("balance of ").removesuffix(" together")
    return [
        f"{worst[0].upper()}{worst[1:]}{others}: {row['residual']:.3g} % of it is unexplained, and a constant or a "
        f"straight line in time explains {row['lasting']:.0f} % of that on held-out data. Does a displacement there "
        f"(of {where} or a neighbour) or its force read a wrong zero, or drift? By least squares masses and "
        "stiffnesses come out wrong then: take out the mean of every displacement and force, or give band=(lo, hi) "
        "above a drift. Or has a storey yielded, or does a constant force act there? Add its law (laws=)."
    ]


def warn_of_bias(table: pd.DataFrame, masses: Sequence[str] = (), stacklevel: int = 2) -> None:
    """Raise one BiasWarning if masses or zeros are doubtful, or a step of :func:`missing_terms` is biased.

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
    zeros = wrong_zeros(table)
    said = [*zeros, *masses]
    hit = table[table["biased"]]
    if len(hit) and not zeros:  # further terms follow a constant too, once the fit is ruined by it
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


def _combination(step: Any, layout: LawLayout, coefficients: dict, masses: dict, moments: Moments) -> np.ndarray:
    """From the columns of a group to [own columns | offered columns | right-hand side] of one step."""
    where, mass_at, target_at = moments.positions(step.dofs)
    signs = dict(zip(moments.groups[step.dofs].sites, moments.groups[step.dofs].signs))
    own = [mass_at] if step.masses else []
    own += [where[s].start + k for s in step.sites for k in range(layout.counts[s])]
    sites = (*step.sites, *step.known_sites)
    offered = [where[s].stop - OFFERED + k for s in sites for k in range(OFFERED - LASTING)]
    offered += [where[s].stop - LASTING + k for s in sites[:1] for k in range(LASTING)]  # the same at all sites
    out = np.zeros((target_at + 1, len(own) + len(offered) + 1))
    out[[*own, *offered], np.arange(len(own) + len(offered))] = 1.0
    out[target_at, -1] = 1.0
    if mass_at is not None and not step.masses:
        out[mass_at, -1] = -masses[step.dofs[0]]
    for site in step.known_sites:
        out[where[site].start : where[site].stop - OFFERED, -1] = -signs[site] * coefficients[site]
    return out


# -- judgement --------------------------------------------------------------------------------


def _judge(
    folds: list[np.ndarray], n_own: int, has_mass: bool, n_rows: int, n_windows: int
) -> tuple[float, float, float, float]:
    total = np.sum(folds, axis=0)
    scale = np.sqrt(np.diag(total))
    scale[scale == 0] = 1.0
    grams = [g / scale[:, None] / scale for g in folds]
    total = total / scale[:, None] / scale
    p = len(total) - 1
    own = np.arange(n_own)
    lasting_from = max(p - LASTING, n_own)  # no site, no further columns
    both = np.arange(lasting_from)
    still = np.r_[own, lasting_from:p]
    c = _solve(total, own)
    residual = _left(total, own, c)
    share = np.sqrt(residual / total[p, p]) if total[p, p] else 0.0
    if share < _ROUND_OFF or n_windows < 2 * FOLDS or n_rows < _ROWS_PER_COLUMN * p:
        return 100 * share, 0.0, 0.0 if has_mass else np.nan, 0.0
    with_own = with_both = with_still = 0.0
    for fold in range(FOLDS):
        test = grams[fold]
        train = total - test
        with_own += _left(test, own, _solve(train, own))
        with_both += _left(test, both, _solve(train, both))
        with_still += _left(test, still, _solve(train, still))
    gain, lasting = (100 * max(0.0, 1 - left / with_own) for left in (with_both, with_still))
    return 100 * share, gain, _move(total, own, both) if has_mass else np.nan, lasting


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
