"""Changes of a structure: between two tests, and within a record by moving windows."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Unpack

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy import special
from sklearn.base import clone

from ..chain.model import ChainModel, DataOptions, as_segments, storey_names
from ..chain.restoring_force import grid
from ..chain.sites import Site
from ..chain.visited_region import VisitedRegion
from ..diagnosis.modes import modal_assurance
from ..diagnosis.stiffness_change import StiffnessChange
from ..equations.accumulation import pieces_of
from ..equations.chain_solve import groups_of, model_of, visited_regions
from ..equations.normal_equations import NormalEquations, variance
from ..exceptions import ChainError, ChannelError
from ..identification.intervals import Resolver
from ..identification.problem import Problem, law_list
from ..identification.regressor import NRFRegressor
from ..records.dataset import Dataset, Segment
from ..records.input_arrays import from_arrays
from ..records.record import Record
from .comparison import OF_95_PERCENT, Comparison, in_words
from .differences import Differences
from .explanations import ExplanationSearch
from .force_change import Cut, MeasuredTest, cut_of

# (X, F), or records.
TestData = tuple[object, object] | Record | Sequence[Record]
# Blocks of a test, of which fewer give no standard error.
LEAST_BLOCKS = 5


# -- two tests -----------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class ChangeReport:
    """Changes between two tests: of the storeys' forces, and of masses.

    Attributes
    ----------
    changed : DataFrame
        What changed: ``place``, ``term``, ``change`` and its ``error`` (%), ``amount``
        (in ``unit``: N or kg rms) and ``p``.
    table : DataFrame
        Parameters of the declared laws, fitted apart: ``before``, ``after``, ``change``
        (%), its ``error`` and ``p`` by ``storey`` and ``term``.
    level : float
        Of significance.
    least : float
        Smaller changes are not reported; percent of the force of the storey's spring,
        or of the mass.
    before, after : ChainModel
    comparison : Comparison
    rivals : tuple of DataFrame
        Other explanations that leave as little, each as ``changed``.
    """

    changed: pd.DataFrame
    table: pd.DataFrame
    level: float
    least: float
    before: ChainModel
    after: ChainModel
    comparison: Comparison
    rivals: tuple[pd.DataFrame, ...] = ()

    @property
    def storeys(self) -> list[str]:
        """Storeys whose forces were compared."""
        return [cut.place for cut in self.comparison.differences.cuts]

    @property
    def damaged(self) -> list[str]:
        """Storeys whose force changed, the largest change first.

        A gain of stiffness or damping is no damage.
        """
        of_storeys = self.changed["place"].str.startswith("storey")
        gained = self.changed["term"].isin(["k", "c"]) & (self.changed["change"] > 0)
        return self.changed.loc[of_storeys & ~gained, "place"].tolist()

    @property
    def stiffness_changes(self) -> list[StiffnessChange]:
        """Storeys whose stiffness changed, by how much and how sure.

        In the form in which ``NRFRegressor(varying=...)`` has the changes within a
        record (``time_variation_.stiffness_changes``).
        """
        return self.comparison.stiffness_changes()

    @property
    def explained(self) -> pd.DataFrame:
        """Rows of the table that differ though one force holds where both tests moved.

        Another amplitude, or course of the motion, shows the declared laws the same
        force in another light.
        """
        significant = self.table["p"] < self.level
        large = self.table["change"].abs() >= self.least
        rows = self.table[significant & large]
        same_force = []
        for row in rows.itertuples():
            same_force.append(self.comparison.same(row.storey, row.term, self.level))
        elsewhere = ~rows["storey"].isin(self.changed["place"])
        return rows[np.array(same_force, dtype=bool) & elsewhere]

    @property
    def modes(self) -> pd.DataFrame:
        """Modes of the linear part in both tests, and how alike their shapes are.

        Returns
        -------
        DataFrame
            By mode: ``frequency before`` and ``after`` (Hz), ``damping before`` and
            ``after`` (share of critical), ``mac`` (1 for equal shapes). Empty where a
            mass is not positive.
        """
        if (self.before.masses <= 0).any() or (self.after.masses <= 0).any():
            return pd.DataFrame()
        before, after = self.before.modes(), self.after.modes()
        columns = {}
        for name in ("frequency", "damping"):
            columns[f"{name} before"] = before[name]
            columns[f"{name} after"] = after[name]
        columns["mac"] = np.diag(modal_assurance(before, after))
        return pd.DataFrame(columns)

    def map(self, storey: str | int, size: int = 41) -> pd.DataFrame:
        """Change of a storey's force over the motion of both tests.

        Nothing is significant in a storey that is not in ``changed``. Friction is shown
        as it slides; what a declared law with memory changed is no map.

        Parameters
        ----------
        storey : str or int
        size : int
            Points along each side of the grid.

        Returns
        -------
        DataFrame
            ``v`` (m/s), ``s`` (m), ``change`` and ``error`` (N), ``significant``,
            ``visited``.
        """
        site = self.before.chain.site(storey)
        domain = self.comparison.differences.cut(str(site)).domain
        rates, drifts = grid(domain.low.tolist(), domain.high.tolist(), size)
        v, s = rates.ravel(), drifts.ravel()

        change, error, n_terms = self.comparison.map(str(site), v, s)
        # all points of a map together: it has as many directions as terms (Bonferroni)
        freedom = self.comparison.differences.freedom
        critical = -special.stdtrit(freedom, self.level / n_terms / 2)
        is_changed = str(site) in set(self.changed["place"])
        visited = self.before.visited[site].contains(v, s)
        visited &= self.after.visited[site].contains(v, s)
        significant = visited & (np.abs(change) > critical * error) & is_changed
        return pd.DataFrame(
            {
                "v": v,
                "s": s,
                "change": change,
                "error": error,
                "significant": significant,
                "visited": visited,
            }
        )

    @property
    def assumption(self) -> str:
        """What no comparison of two tests can show."""
        if (self.changed["term"] == "gain").any():
            return (
                "Assumed: masses, stiffnesses and damping did not all change by one"
                " factor, which would look like another gain of all forces."
            )
        return (
            "Assumed: sensors have the same gains in both tests. Another gain of all"
            " forces would look like masses, stiffnesses and damping that all changed"
            " by one factor."
        )

    def __str__(self) -> str:
        lines = [_sentence(row) for row in self.changed.itertuples()]
        if not lines:
            lines.append(
                f"Nothing changed by more than {self.least:g} % at the"
                f" {100 * self.level:g} % level."
            )
        for rival in self.rivals:
            changes = [
                f"{in_words(row.term).lower()} of {row.place} by {row.change:+.2f} %"
                for row in rival.itertuples()
            ]
            lines.append(f"As well explained by {', '.join(changes)}.")
        lines += self._explained_in_words()
        lines.append(self.assumption)
        return "\n".join(lines)

    def _explained_in_words(self) -> list[str]:
        """Parameters that differ by the amplitude alone, a sentence for each storey."""
        lines = []
        for storey, rows in self.explained.groupby("storey"):
            terms = [f"{row.term} by {row.change:+.2f} %" for row in rows.itertuples()]
            ratio = self.comparison.differences.cut(storey).domain.ratio
            lines.append(
                f"{storey.capitalize()}: fitted apart, the tests differ in"
                f" {', '.join(terms)}. The amplitude alone explains it (rms drift"
                f" {ratio:.2f} times): one force holds where both moved."
            )
        return lines


def _sentence(row: Any) -> str:
    """What changed at one place."""
    of = " of its spring force" if row.place.startswith("storey") else ""
    return (
        f"{in_words(row.term)} of {row.place} changed by {row.change:+.2f} ±"
        f" {OF_95_PERCENT * row.error:.2f} %{of} ({row.amount:.3g} {row.unit}, p ="
        f" {row.p:.1g})."
    )


def compare_tests(
    estimator: NRFRegressor,
    before: TestData,
    after: TestData,
    *,
    level: float = 0.01,
    least: float = 1.0,
    n_blocks: int = 20,
    options: DataOptions | None = None,
) -> ChangeReport:
    """Compare two tests of one structure, e.g. before and after an earthquake.

    Each storey's force follows from the forces and the inertia of the floors above it.
    Over the drifts and rates of both tests, one law with kinks, loops and powers
    explains this force in both. A term of a storey, or a mass, counts as changed if its
    difference is significant and large. Neither the amplitude nor a law that the
    regressor lacks then explains it. A declared law with a state or a shape is compared
    on its own parameters.

    Rival explanations are compared: stiffness, damping, or masses alone, one factor of
    all stiffnesses, the gain of all forces. The one with the fewest changes that leaves
    nothing significant to another is reported. Others that leave as little are
    ``rivals``. Masses are equal in both tests unless one changed.

    Standard errors come from leaving out one of ``n_blocks`` consecutive pieces of a
    test at a time (jackknife). Give Records where channels are noisy: their DOFs are
    fused one by one, so that their errors are not related.

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

    Returns
    -------
    ChangeReport

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
    ...     lower = laws.PowerSeries(1, [30.0, 4e4])
    ...     upper = laws.PowerSeries(1, [30.0, k2])
    ...     model = ChainModel([10.0, 10.0], {1: lower, 2: upper})
    ...     F = excitation.band_limited_random(
    ...         2,
    ...         8.0,
    ...         500.0,
    ...         excited=2,
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
    if n_blocks < LEAST_BLOCKS:
        raise ChainError(
            f"{n_blocks} blocks give no standard error",
            f"Use at least {LEAST_BLOCKS}, 20 is usual.",
        )
    options = options or DataOptions()
    fits = [_Fit.of_test(estimator, test, options) for test in (before, after)]
    _require_same_dofs(fits)
    masses = np.array([fit.model.masses for fit in fits])
    cuts = _cuts(fits, masses.mean(axis=0), n_blocks)
    differences = Differences(cuts, masses, _free_masses(fits[0].problem))
    explanations = ExplanationSearch(differences, level, least).sufficient()
    units = fits[0].model.units
    comparisons = [Comparison(differences, e, units) for e in explanations or [()]]
    comparison = comparisons[0]

    gain = comparison.gain_of_forces
    fits[1] = replace(fits[1], data=_with_forces_over(fits[1].data, gain))
    apart = []
    for fit, masses_of_test in zip(fits, comparison.masses_of_tests()):
        known = {j: float(mass) for j, mass in enumerate(masses_of_test, 1)}
        known |= fit.problem.known_masses
        apart.append(_fitted_with_masses(fit, known, n_blocks))
    return ChangeReport(
        comparison.table(),
        _table(apart, comparison),
        level,
        least,
        apart[0].model,
        apart[1].model,
        comparison,
        tuple(rival.table() for rival in comparisons[1:]),
    )


@dataclass(frozen=True, eq=False)
class _Fit:
    """A test with its least-squares model."""

    problem: Problem
    model: ChainModel
    data: Dataset

    @classmethod
    def of_test(
        cls, estimator: NRFRegressor, test: TestData, options: DataOptions
    ) -> _Fit:
        """Fit the motions of a test, whose DOFs are fused one by one."""
        X, F = test, None
        if isinstance(test, tuple):
            X, F = test
        unfitted = clone(estimator)
        has_memory = any(law.has_memory for law in law_list(unfitted.laws))
        settings = {
            "coordinates": unfitted.coordinates,
            "dt": unfitted.dt,
            "has_memory": has_memory,
            "n_dof": None if unfitted.chain is None else unfitted.chain.n_dof,
            "joint": False,
        }
        data = from_arrays(X, F, **{**settings, **options})

        estimate = unfitted.problem(data.n_dof).solve(data)
        visited = visited_regions(data, estimate.problem.layout)
        return cls(estimate.problem, _with_visited(estimate.model, visited), data)


@dataclass(frozen=True, eq=False)
class _Apart:
    """A model of a test, and those without one piece of it each."""

    model: ChainModel
    without_a_piece: list[ChainModel]

    @property
    def errors(self) -> pd.Series:
        """Standard errors of the parameters (jackknife)."""
        parameters = [_parameters(model) for model in self.without_a_piece]
        return np.sqrt(variance(parameters))


def _require_same_dofs(fits: list[_Fit]) -> None:
    """Both tests have the same floors."""
    numbers = dict.fromkeys(str(fit.model.n_dof) for fit in fits)
    if len(numbers) > 1:
        raise ChainError(
            f"The tests have {' and '.join(numbers)} DOFs",
            "Compare two tests of one structure, measured on the same floors.",
        )


def _free_masses(problem: Problem) -> list[int]:
    """DOFs whose mass is not known."""
    known = problem.known_masses
    return [j for j in range(1, problem.chain.n_dof + 1) if j not in known]


def _cuts(fits: list[_Fit], masses: np.ndarray, n_blocks: int) -> list[Cut]:
    """The cuts below the floors of all storeys whose force is known in both tests."""
    tests = []
    for fit in fits:
        pieces = _pieces(fit.problem, fit.data, n_blocks=n_blocks)
        edges = [piece.edges for piece in pieces]
        filters = fit.problem.filters(fit.data)
        tests.append(MeasuredTest(fit.data, fit.model, filters, edges))

    cuts = []
    for site in fits[0].model.chain.sites:
        cut = cut_of(site.p, tests, masses) if site.is_storey else None
        if cut is not None:
            cuts.append(cut)
    if not cuts:
        raise ChainError(
            "No storey's force is known in both tests",
            "Measure the force on every floor above a storey.",
        )
    return cuts


def _with_forces_over(data: Dataset, gain: float) -> Dataset:
    """The data with forces divided by a gain."""
    if gain == 1.0:
        return data
    segments = [replace(segment, F=segment.F / gain) for segment in data.segments]
    return replace(data, segments=segments)


def _fitted_with_masses(fit: _Fit, known: dict[int, float], n_blocks: int) -> _Apart:
    """The model of a test with masses that are known, whole and piece by piece."""
    problem = fit.problem.with_known_masses(known)
    resolver, _ = resolver_in_time(problem, fit.data, n_blocks=n_blocks)
    pieces = resolver.pieces.leave_one_out()
    without_a_piece = [plain_model(resolver, pieces[k]) for k in range(len(pieces))]
    model = plain_model(resolver, resolver.pieces.sum())
    return _Apart(_with_visited(model, fit.model.visited), without_a_piece)


def _with_visited(
    model: ChainModel, visited: Mapping[Site, VisitedRegion]
) -> ChainModel:
    return ChainModel(model.masses, model.laws, model.chain, visited, model.info)


def _table(apart: list[_Apart], comparison: Comparison) -> pd.DataFrame:
    """Parameters of the declared laws, fitted apart."""
    before, after = _parameters(apart[0].model), _parameters(apart[1].model)
    change = 100.0 * (after / before - 1.0)
    relative = np.hypot(apart[0].errors / before, apart[1].errors / after)
    error = 100.0 * np.abs(after / before) * relative
    # pieces estimate no shapes; their difference is a term of the comparison
    for storey, name in change.index:
        laws = apart[0].model.laws.get(Site(storey), ())
        shapes = [shape.name for law in laws for shape in law.shapes]
        if name in shapes:
            share = comparison.error_of_shape(storey)
            error[storey, name] = share * abs(change[storey, name])

    freedom = min(len(test.without_a_piece) for test in apart) - 1
    with np.errstate(invalid="ignore", divide="ignore"):
        p = 2.0 * special.stdtr(freedom, -np.abs(change) / error)
    table = pd.DataFrame(
        {
            "before": before,
            "after": after,
            "change": change,
            "error": error,
            "p": _holm(p.to_numpy()),
        }
    )
    return table.rename_axis(["storey", "term"]).reset_index()


def _holm(p: np.ndarray) -> np.ndarray:
    """Holm's adjusted probabilities; NaN, where nothing was tested, stays so."""
    n_tested = int(np.isfinite(p).sum())
    order = np.argsort(p)[:n_tested]
    factors = n_tested - np.arange(n_tested)
    adjusted = np.full_like(p, np.nan)
    adjusted[order] = np.minimum(np.maximum.accumulate(factors * p[order]), 1.0)
    return adjusted


def _linear(model: ChainModel) -> pd.DataFrame:
    """Stiffness and damping (``k``, ``c``) of every storey.

    NaN where the chain has none, as below a free one.
    """
    forces = model.restoring_forces
    parts = {}
    for storey in storey_names(model):
        linear = forces[storey].linear_part() if storey in forces else {}
        parts[storey] = [linear.get("k", np.nan), linear.get("c", np.nan)]
    return pd.DataFrame.from_dict(parts, orient="index", columns=["k", "c"])


def _parameters(model: ChainModel) -> pd.Series:
    """Stiffness and damping of every storey, and the parameters of its other laws.

    Those are laws with a state or a shape.
    """
    linear = _linear(model)
    values: dict[tuple[str, str], float] = {}
    for term in ("k", "c"):
        for storey, value in linear[term].items():
            values[str(storey), term] = float(value)
    for storey in storey_names(model):
        for law in model.laws.get(Site(storey), ()):
            if not (law.shapes or law.has_memory):
                continue
            for name, value in law.parameters.items():
                if value is not None:
                    values[storey, name] = value
    return pd.Series(values, dtype=float)


# -- pieces in time ------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Pieces:
    """Consecutive pieces of one record.

    Parameters
    ----------
    edges : ndarray of shape (n_pieces + 1,)
        In valid samples.
    spans : ndarray of shape (n_pieces, 2)
        First and last time of each, s; samples where the time is not known.
    """

    edges: np.ndarray
    spans: np.ndarray


def _pieces(
    problem: Problem,
    data: Dataset,
    *,
    n_blocks: int | None = None,
    length: float | None = None,
) -> Iterator[_Pieces]:
    """Pieces of each record, ``n_blocks`` over all records or ``length`` s long."""
    n_samples = sum(segment.n_valid for segment in data.segments)
    for segment in data.segments:
        if length is None:
            size = int(np.ceil(n_samples / (n_blocks or 1)))
        else:
            size = _samples_of(length, segment)
        if size < problem.layout.n_dof + 2:
            raise ChannelError(
                f"Pieces of {size} samples are too short",
                "Use longer windows or fewer blocks.",
            )

        n = segment.n_valid
        # a rest shorter than half a piece joins the last one
        starts = np.arange(0, max(n - size // 2, 1), size)
        edges = np.append(starts, n)
        time = np.arange(n, dtype=float)
        if segment.t is not None:
            time = segment.t[segment.valid]
        yield _Pieces(edges, np.column_stack([time[edges[:-1]], time[edges[1:] - 1]]))


def _samples_of(length: float, segment: Segment) -> int:
    """Samples of a record in some seconds."""
    if segment.dt is None:
        raise ChannelError(
            "A window in seconds needs the sampling step",
            "Pass dt= (s), or X with a time index.",
        )
    return int(round(length / segment.dt))


def resolver_in_time(
    problem: Problem,
    data: Dataset,
    *,
    n_blocks: int | None = None,
    length: float | None = None,
) -> tuple[Resolver, np.ndarray]:
    """Least squares on consecutive pieces.

    Parameters
    ----------
    problem : Problem
    data : Dataset
    n_blocks : int, optional
        Pieces over all records.
    length : float, optional
        Of a piece, s.

    Returns
    -------
    resolver : Resolver
    spans : ndarray of shape (n_pieces, 2)
        First and last time of each piece, s.
    """
    layout, known = problem.layout, dict(problem.known_masses)
    order = problem.solve_order(data.forced, data.unknown)
    records = list(_pieces(problem, data, n_blocks=n_blocks, length=length))
    sums = pieces_of(
        data,
        layout,
        groups_of(layout, order),
        problem.filters(data),
        known,
        edges=[record.edges for record in records],
    )
    spans = np.concatenate([record.spans for record in records])
    return Resolver(sums, order, known), spans


def plain_model(resolver: Resolver, total: NormalEquations) -> ChainModel:
    """Model of a sum of pieces; a rank that is too low is warned of."""
    return model_of(resolver.pieces.layout, resolver.solve(total))


# -- within a record -----------------------------------------------------------


def moving_windows(
    estimator: NRFRegressor,
    X: object,
    F: ArrayLike | None = None,
    *,
    window: float = 2.0,
    step: float = 0.25,
    masses: str | Mapping[int, float] | None = "fitted",
    **options: Unpack[DataOptions],
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
        Masses in every window, kg: those of the estimator, none (they are
        identified in each window separately), or given ones.

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
    >>> from pysindy_nrf import (
    ...     ChainModel,
    ...     NRFRegressor,
    ...     excitation,
    ...     laws,
    ...     monitoring,
    ...     simulate,
    ... )
    >>> # 20 % of the stiffness is lost after 4 s
    >>> lost = laws.StiffnessStep(t0=4.0, dk=-8e3)
    >>> storey = laws.PowerSeries(1, [30.0, 4e4])
    >>> truth = ChainModel([10.0], {1: [storey, lost]})
    >>> F = excitation.band_limited_random(
    ...     1, 8.0, 500.0, excited=1, rms=50.0, band=(1, 60), random_state=0
    ... )
    >>> X, F = simulate(truth, F, 0.002).to_features(smooth=False)
    >>> fitted = NRFRegressor(degree=1, dt=0.002).fit(X, F)
    >>> table = monitoring.moving_windows(fitted, X, F, masses={1: 10.0})
    >>> early, late = table[table["t"] < 2.9], table[table["t"] > 5.1]
    >>> [int(part["k1"].median().round(-2)) for part in (early, late)]
    [40000, 32000]
    """
    data = as_segments(estimator, X, F, **options)
    problem = _problem_with_masses(estimator, masses)
    resolver, spans = resolver_in_time(problem, data, length=step)
    width = max(1, int(round(window / step)))

    rows = []
    for first in range(len(resolver.pieces) - width + 1):
        last = first + width - 1
        if resolver.record[first] != resolver.record[last]:
            continue
        total = resolver.pieces[first : last + 1].sum()
        linear = _linear(plain_model(resolver, total))
        middle = 0.5 * (spans[first, 0] + spans[last, 1])
        values = linear["k"].tolist() + linear["c"].tolist()
        rows.append([resolver.record[first], middle] + values)
    if not rows:
        raise ChainError(
            f"No window of {window:g} s fits into the records", "Use a shorter one."
        )
    storeys = np.arange(1, estimator.model_.n_dof + 1).astype(str)
    names = ["record", "t"]
    for letter in ("k", "c"):
        names += np.char.add(letter, storeys).tolist()
    return pd.DataFrame(rows, columns=names)


def _problem_with_masses(
    estimator: NRFRegressor, masses: str | Mapping[int, float] | None
) -> Problem:
    """The problem of an estimator with the masses that every window has."""
    problem: Problem = estimator.problem_
    if masses is None:
        return problem
    if isinstance(masses, str):
        if masses != "fitted":
            raise ChainError(
                f"masses={masses!r} is unknown", "Give 'fitted', None, or kg by DOF."
            )
        masses = {j: float(mass) for j, mass in enumerate(estimator.masses_, 1)}
    return problem.with_known_masses(masses)
