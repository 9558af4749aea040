"""Changes of a structure: between two tests, and within a record by moving windows."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy import special
from sklearn.base import clone

from ..chain.model import ChainModel, as_segments, storey_names
from ..chain.restoring_force import grid
from ..chain.sites import Site
from ..equations.accumulation import pieces_of
from ..equations.chain_solve import groups_of, model_of, visited_regions
from ..equations.normal_equations import NormalEquations, variance
from ..exceptions import ChainError, ChannelError
from ..identification.intervals import Resolver
from ..identification.problem import Estimate, Problem, law_list
from ..records.dataset import Dataset
from ..records.input_arrays import from_arrays
from .force_change import Comparison, cut_of, in_words


@dataclass
class ChangeReport:
    """Changes between two tests: of the storeys' forces over the motion that both went
    through, and of masses.
    """

    changed: (
        pd.DataFrame
    )  # what changed: place, term, change and its error (%), amount (N or kg rms), p
    # parameters of the declared laws, fitted apart: before, after, change (%), its
    # error, p
    table: pd.DataFrame
    level: float  # of significance
    # percent of the force of the storey's spring, or of the mass; smaller changes are
    # not reported
    least: float
    before: ChainModel
    after: ChainModel
    comparison: Comparison

    @property
    def damaged(self) -> list[str]:
        """Storeys whose force changed otherwise than by a gain of stiffness or damping,
        the largest change first.
        """
        rows = self.changed[self.changed["place"].str.startswith("storey")]
        return rows.loc[
            ~(rows["term"].isin(["k", "c"]) & (rows["change"] > 0)), "place"
        ].tolist()

    @property
    def explained(self) -> pd.DataFrame:
        """Rows of the table that differ significantly though one force holds where both
        tests moved.

        Another amplitude, or course of the motion, shows the declared laws the same
        force in another light.
        """
        rows = self.table[
            (self.table["p"] < self.level) & (self.table["change"].abs() >= self.least)
        ]
        same = [
            self.comparison.same(r.storey, r.term, self.level)
            for r in rows.itertuples()
        ]
        return rows[
            np.array(same, dtype=bool) & ~rows["storey"].isin(self.changed["place"])
        ]

    def map(self, storey: Any, size: int = 41) -> pd.DataFrame:
        """Change of a storey's force over the motion of both tests, N, with its error
        and significance.

        Nothing is significant in a storey that is not in ``changed``. Friction is shown
        as it slides; what a declared law with memory changed is no map.
        """
        site = self.before.chain.site(storey)
        cut = self.comparison.cut(site.p)
        v, s = (x.ravel() for x in grid(cut.low.tolist(), cut.high.tolist(), size))
        change, error, n_terms = self.comparison.map(site.p, v, s)
        # all points of a map together: it has as many directions as terms (Bonferroni)
        critical = -special.stdtrit(self.comparison.freedom, self.level / n_terms / 2)
        visited = np.all(
            [m.visited[site].contains(v, s) for m in (self.before, self.after)], axis=0
        )
        significant = (
            visited
            & (np.abs(change) > critical * error)
            & (str(site) in set(self.changed["place"]))
        )
        columns = {
            "v": v,
            "s": s,
            "change": change,
            "error": error,
            "significant": significant,
            "visited": visited,
        }
        return pd.DataFrame(columns)

    def __str__(self) -> str:
        said = []
        for r in self.changed.itertuples():
            size, of = (
                f"{r.amount:.3g} {r.unit}",
                ("" if r.term == "m" else " of its spring force"),
            )
            said.append(
                f"{in_words(r.term)} of {r.place} changed by {r.change:+.2f} +-"
                f" {1.96 * r.error:.2f} %{of} ({size}, p = {r.p:.1g})."
            )
        if not said:
            said = [
                f"Nothing changed by more than {self.least:g} % at the"
                f" {100 * self.level:g} % level."
            ]
        for storey, rows in self.explained.groupby("storey"):
            apart = ", ".join(
                f"{r.term} by {r.change:+.2f} %" for r in rows.itertuples()
            )
            said.append(
                f"{storey.capitalize()}: fitted apart, the tests differ in {apart}. The"
                " amplitude alone explains it (rms drift"
                f" {self.comparison.cut(Site(storey).p).ratio:.2f} times): one force"
                " holds where both moved."
            )
        return "\n".join(said)


def compare_tests(
    estimator: Any,
    before: Any,
    after: Any,
    *,
    level: float = 0.01,
    least: float = 1.0,
    n_blocks: int = 20,
    options: Any = None,
) -> ChangeReport:
    """Compare two tests of one structure, e.g. before and after an earthquake.

    Each storey's force follows from the forces and the inertia of the floors above it.
    Where both tests moved, one law with kinks, loops and powers explains it in both,
    and a term of a storey, or a mass, counts as changed if its difference is
    significant and large: then no amplitude, and no law that the regressor lacks,
    explains it. A declared law with a state or a shape is compared on its own
    parameters. Standard errors come from leaving out one of ``n_blocks`` consecutive
    pieces of a test at a time (jackknife). Masses are equal in both tests unless one
    changed. Give Records where channels are noisy: their DOFs are fused one by one, and
    errors are then not alike.

    Parameters
    ----------
    estimator : NRFRegressor
        Not necessarily fitted; it is cloned.
    before, after : (X, F) or Record or list of Record
    level : float
        Significance level, for all terms of all places together (Bonferroni; Holm's
        correction in ``table``).
    least : float
        Smallest change of interest, percent of the force of the storey's spring, or of
        the mass.
    n_blocks : int
        Pieces of each test.
    options : mapping, optional
        Passed to ``fit`` (``dt`` is a parameter of the regressor).

    Raises
    ------
    ChainError
        If fewer than 5 blocks are asked for, the tests differ in their DOFs, or no
        storey's force is known in both.

    Examples
    --------
    >>> from pysindy_nrf import (
    ...     ChainModel,
    ...     NRFRegressor,
    ...     excitation,
    ...     laws,
    ...     monitoring,
    ...     simulate,
    ... )
    >>> def test(k2, seed):
    ...     model = ChainModel(
    ...         [10.0, 10.0],
    ...         {
    ...             1: laws.PowerSeries(1, [30.0, 4e4]),
    ...             2: laws.PowerSeries(1, [30.0, k2]),
    ...         },
    ...     )
    ...     F = excitation.band_limited_random(
    ...         2,
    ...         8.0,
    ...         500.0,
    ...         excited=[1, 2],
    ...         rms=50.0,
    ...         band=(1, 60),
    ...         random_state=seed,
    ...     )
    ...     return simulate(model, F, 0.002).to_features(smooth=False)
    >>> report = monitoring.compare_tests(
    ...     NRFRegressor(degree=1, dt=0.002), test(4e4, 0), test(3.6e4, 1)
    ... )
    >>> report.damaged, report.changed["change"].round(1).tolist()
    (['storey 2'], [-10.0])
    """
    if n_blocks < 5:
        raise ChainError(
            f"{n_blocks} blocks give no standard error", "Use at least 5, 20 is usual."
        )
    estimates, tests = zip(
        *[_fit(estimator, test, dict(options or {})) for test in (before, after)]
    )
    if len(numbers := dict.fromkeys(est.model.n_dof for est in estimates)) > 1:
        what = f"The tests have {' and '.join(map(str, numbers))} DOFs"
        raise ChainError(
            what, "Compare two tests of one structure, measured on the same floors."
        )
    problems, models = (
        [est.problem for est in estimates],
        [est.model for est in estimates],
    )
    masses = np.mean([model.masses for model in models], axis=0)
    free = [j for j in range(1, len(masses) + 1) if j not in problems[0].known_masses]
    pairs = list(zip(problems, tests))
    filters = [problem.filters(data) for problem, data in pairs]
    edges = [
        [edges for edges, _ in _cuts(problem, data, n_blocks)]
        for problem, data in pairs
    ]
    cuts = [
        cut
        for site in models[0].chain.sites
        if site.is_storey
        if (cut := cut_of(site.p, tests, models, masses, filters, edges)) is not None
    ]
    if not cuts:
        raise ChainError(
            "No storey's force is known in both tests",
            "Measure the force on every floor above a storey.",
        )
    comparison = Comparison(cuts, masses, free)
    comparison.search(level, least)
    replicates = []
    for i, ((problem, data), own) in enumerate(
        zip(pairs, comparison.masses_of_tests())
    ):
        known = dict(enumerate(own.tolist(), 1)) | dict(problem.known_masses)
        resolver, _ = resolver_in_time(
            problem.with_known_masses(known), data, n_blocks=n_blocks
        )
        without = resolver.pieces.leave_one_out()
        replicates.append(
            [plain_model(resolver, without[k]) for k in range(len(without))]
        )
        visited, models[i] = (
            models[i].visited,
            plain_model(resolver, resolver.pieces.sum()),
        )
        models[i].visited = visited
    table = _table(models, replicates, comparison)
    return ChangeReport(
        comparison.table(), table, level, least, models[0], models[1], comparison
    )


def resolver_in_time(
    problem: Problem,
    data: Dataset,
    *,
    n_blocks: int | None = None,
    length: float | None = None,
) -> tuple[Resolver, np.ndarray]:
    """Least squares on consecutive pieces, ``n_blocks`` over all records or ``length``
    s long.
    """
    layout, known = problem.layout, dict(problem.known_masses)
    solve_order = problem.solve_order(data.forced, data.unknown)
    edges, spans = zip(*_cuts(problem, data, n_blocks, length))
    pieces = pieces_of(
        data,
        layout,
        groups_of(layout, solve_order),
        problem.filters(data),
        known,
        edges=edges,
    )
    return Resolver(pieces, solve_order, known), np.concatenate(spans)


def _cuts(
    problem: Problem,
    data: Dataset,
    n_blocks: int | None = None,
    length: float | None = None,
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Edges of the consecutive pieces of each record, and first and last time of
    each.
    """
    whole = sum(seg.n_valid for seg in data.segments)
    for seg in data.segments:
        n = seg.n_valid
        if length is None:
            size = int(np.ceil(whole / (n_blocks or 1)))
        elif seg.dt is None:
            raise ChannelError(
                "A window in seconds needs the sampling step",
                "Pass dt= (s), or X with a time index.",
            )
        else:
            size = int(round(length / seg.dt))
        if size < problem.layout.n_dof + 2:
            raise ChannelError(
                f"Pieces of {size} samples are too short",
                "Use longer windows or fewer blocks.",
            )
        # a rest shorter than half a piece joins the last one
        cuts = np.array([*range(0, max(n - size // 2, 1), size), n])
        t = seg.t[seg.valid] if seg.t is not None else np.arange(n, dtype=float)
        yield cuts, np.column_stack([t[cuts[:-1]], t[cuts[1:] - 1]])


def plain_model(resolver: Resolver, total: NormalEquations) -> ChainModel:
    """Model of a sum of pieces; a rank that is too low is warned of."""
    return model_of(resolver.pieces.layout, resolver.solve(total))


def _fit(
    estimator: Any, test: Any, options: dict[str, Any]
) -> tuple[Estimate, Dataset]:
    """Least-squares estimate of a test, and its motions, DOFs fused one by one."""
    X, F = test if isinstance(test, tuple) else (test, None)
    est = clone(estimator)
    memory = any(law.has_memory for law in law_list(est.laws))
    given = {
        "coordinates": est.coordinates,
        "dt": est.dt,
        "has_memory": memory,
        "joint": False,
    } | options
    data = from_arrays(
        X, F, n_dof=None if est.chain is None else est.chain.n_dof, **given
    )
    found = est.problem(data.n_dof).solve(data)
    found.model.visited = visited_regions(data, found.problem.layout)
    return found, data


def _linear(model: ChainModel) -> np.ndarray:
    """Stiffness and damping of every storey; NaN where the chain has none, as below a
    free one.
    """
    forces = model.restoring_forces
    return np.array(
        [
            [
                forces[name].linear_part()[term] if name in forces else np.nan
                for term in ("k", "c")
            ]
            for name in storey_names(model)
        ]
    )


def _parameters(model: ChainModel) -> pd.Series:
    """Stiffness and damping of every storey, and what its laws with a state or a shape
    have of their own.
    """
    linear, names = _linear(model), storey_names(model)
    values = {
        (name, term): linear[i, j]
        for j, term in enumerate(("k", "c"))
        for i, name in enumerate(names)
    }
    for name in names:
        for law in model.laws.get(Site(name), ()):
            if law.shapes or law.has_memory:
                values |= {
                    (name, key): x for key, x in law.parameters.items() if x is not None
                }
    return pd.Series(values, dtype=float)


def _table(
    models: list[ChainModel], replicates: list[list[ChainModel]], comparison: Comparison
) -> pd.DataFrame:
    before, after = (_parameters(m) for m in models)
    errors = [
        np.sqrt(variance([_parameters(m) for m in left_out])) for left_out in replicates
    ]
    change = 100.0 * (after / before - 1.0)
    error = (
        100.0
        * np.abs(after / before)
        * np.sqrt((errors[0] / before) ** 2 + (errors[1] / after) ** 2)
    )
    for (
        storey,
        name,
    ) in (
        change.index
    ):  # pieces estimate no shapes; their difference is a term of the comparison
        if name in {
            s.name for law in models[0].laws.get(Site(storey), ()) for s in law.shapes
        }:
            error[storey, name] = comparison.error_of_shape(Site(storey).p) * abs(
                change[storey, name]
            )
    with np.errstate(invalid="ignore", divide="ignore"):
        p = 2.0 * special.stdtr(min(map(len, replicates)) - 1, -np.abs(change) / error)
    columns = {
        "before": before,
        "after": after,
        "change": change,
        "error": error,
        "p": _holm(p.to_numpy()),
    }
    return pd.DataFrame(columns).rename_axis(["storey", "term"]).reset_index()


def _holm(p: np.ndarray) -> np.ndarray:
    """Holm's adjusted probabilities; NaN, where nothing was tested, stays so and does
    not count.
    """
    order = np.argsort(p)[: np.isfinite(p).sum()]
    adjusted = np.maximum.accumulate((len(order) - np.arange(len(order))) * p[order])
    out = np.full_like(p, np.nan)
    out[order] = np.minimum(adjusted, 1.0)
    return out


def track(
    estimator: Any,
    X: Any,
    F: Any = None,
    *,
    window: float = 2.0,
    step: float = 0.25,
    masses: Any = "fitted",
    **options: Any,
) -> pd.DataFrame:
    """Stiffness and damping of every storey over time.

    The samples are read once into Gram matrices of pieces of ``step`` seconds; every
    window is a sum of them.

    Parameters
    ----------
    estimator : fitted NRFRegressor
        Usually linear (``degree=1``); fitted to this record or to an earlier test.
    X, F, **options
        One or more records, as for ``fit``.
    window, step : float
        Length of a window and how far it moves, s.
    masses : "fitted", None or mapping of int to float
        Masses held in every window, kg: those of the estimator, none (they are
        identified in each window anew), or given ones.

    Returns
    -------
    DataFrame
        One row for each window: ``record``, ``t`` (its middle, s), ``k1``.. (N/m),
        ``c1``.. (N s/m).

    Raises
    ------
    ChainError
        If no window fits into a record.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf import (
    ...     ChainModel,
    ...     NRFRegressor,
    ...     excitation,
    ...     laws,
    ...     monitoring,
    ...     simulate,
    ... )
    >>> damaged = laws.StiffnessStep(
    ...     t0=4.0, dk=-8e3
    ... )  # 20 % of the stiffness is lost after 4 s
    >>> truth = ChainModel(
    ...     [10.0], {1: [laws.PowerSeries(1, [30.0, 4e4]), damaged]}
    ... )
    >>> F = excitation.band_limited_random(
    ...     1, 8.0, 500.0, excited=1, rms=50.0, band=(1, 60), random_state=0
    ... )
    >>> X, F = simulate(truth, F, 0.002).to_features(smooth=False)
    >>> table = monitoring.track(
    ...     NRFRegressor(degree=1, dt=0.002).fit(X, F), X, F, masses={1: 10.0}
    ... )
    >>> [
    ...     int(table.loc[side, "k1"].median().round(-2))
    ...     for side in (table["t"] < 2.9, table["t"] > 5.1)
    ... ]
    [40000, 32000]
    """
    data = as_segments(estimator, X, F, **options)
    if isinstance(masses, str):
        if masses != "fitted":
            raise ChainError(
                f"masses={masses!r} is unknown", "Give 'fitted', None, or kg by DOF."
            )
        masses = {j + 1: float(m) for j, m in enumerate(estimator.masses_)}
    problem: Problem = estimator.problem_
    problem = problem if masses is None else problem.with_known_masses(masses)
    resolver, spans = resolver_in_time(problem, data, length=step)
    pieces, record = resolver.pieces, resolver.record
    width = max(1, int(round(window / step)))
    rows = []
    for start in range(len(pieces) - width + 1):
        if record[start] != record[start + width - 1]:
            continue
        linear = _linear(plain_model(resolver, pieces[start : start + width].sum()))
        middle = 0.5 * (spans[start, 0] + spans[start + width - 1, 1])
        rows.append([record[start], middle, *linear.T.ravel()])
    if not rows:
        raise ChainError(
            f"No window of {window:g} s fits into the records", "Use a shorter one."
        )
    names = [
        f"{term}{j}" for term in "kc" for j in range(1, estimator.model_.n_dof + 1)
    ]
    return pd.DataFrame(rows, columns=["record", "t", *names])
