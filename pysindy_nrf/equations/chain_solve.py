"""The one place where coefficients are found, from Gram matrices: complete (eq. 3),
sequential (eqs. 4-5), joint.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd
from scipy import linalg
from scipy.linalg import lapack

from ..chain.identifiability import SolveOrder, Step
from ..chain.layout import Block, Group, LawLayout, Layout, with_coefficients
from ..chain.model import ChainModel
from ..chain.sites import Site
from ..chain.visited_region import VisitedRegion
from ..exceptions import (
    ChannelError,
    DataQualityWarning,
    IdentifiabilityError,
    NRFError,
    RankWarning,
)
from ..laws.shape import Motion, Scales
from ..records.dataset import Dataset
from .accumulation import total_gram
from .inner_optimizer import fit_inner
from .normal_equations import NormalEquations, root_of, upper_of

# squaring a scaled condition number c loses c^2 of the 1e16 digits of a double
_DIGITS_AT_RISK = 1e-9
_CLEAN = 1e-5
# Smallest singular value, as a share of the largest, that counts: round-off of a Gram
# matrix hides what lies below the root of the machine precision.
_RANK_CUT = {"gram": 3e-8, "root": 1e-9}
# a rank is in doubt where a bound of the condition number comes this near to what
# counts as dependent
_SURE = 10.0
# residual over a mass's own part of its balance from which on the mass is warned of
_DOUBT = 0.5
# Residual of a balance, as a share of its force, below which a joint solve takes it for
# as good as any: forces and motions are not calibrated better than to a thousandth.
_BEST = 1e-3
# Share of a balance that its neighbours' laws leave, and times what its own leave, from
# which on one of them is wrong.
_MUCH, _TIMES = 0.1, 3.0
_SMALLEST = (
    1e-145  # length of columns whose squares a double still holds with all digits
)


@dataclass
class StepFit:
    """Condition, rank, residual and noise of the masses of one step of the solve
    order.
    """

    step: Step
    condition: float  # of the columns scaled to unit length
    rank: int
    n_columns: int
    # rms, N; without unit for a joint solve, whose balances are divided by their rms
    # force
    residual: float
    share: float  # the same over the rms of the right-hand side
    # for each mass: residual over the part of its inertia that no other column
    # imitates; near one, noise decides
    mass_noise: tuple[float, ...] = ()
    inner: Any = None  # fitted optimizer
    said: tuple[tuple[type[Warning], str], ...] = ()  # what it warned of
    # as ``share``, with the laws that the neighbouring balances find in place of its
    # own
    crossed: Any = 0.0

    @property
    def contradicts(self) -> Any:
        """Whether the neighbours find laws that this balance excludes."""
        return self.crossed > np.maximum(_MUCH, _TIMES * self.share)


@dataclass
class Solution:
    """Masses (kg) and coefficients of a chain."""

    masses: dict[int, float] = field(default_factory=dict)
    coefficients: dict[Site, np.ndarray] = field(default_factory=dict)
    # of each balance by itself: the second estimate, from the balance at the other end
    # (paper eq. 10b)
    twins: dict[Site, np.ndarray] = field(default_factory=dict)
    fits: list[StepFit] = field(default_factory=list)
    alone: Solution | None = (
        None  # joint strategy: that of each balance by itself, if every balance has one
    )

    @property
    def inner(self) -> dict[str, Any]:
        """Fitted optimizers by balance."""
        return {fit.step.name: fit.inner for fit in self.fits if fit.inner is not None}

    def followed(self, solve_order: SolveOrder) -> SolveOrder:
        """The order that was followed: each balance by itself where the default found
        contradictions.
        """
        gave_way = solve_order.yields and bool(self.twins)
        return replace(
            solve_order,
            strategy="complete" if gave_way else solve_order.strategy,
            yields=False,
        )

    def pass_on(self, stacklevel: int) -> None:
        """Say once what optimizers warned of, and on which balances."""
        for kind, text in dict.fromkeys(said for fit in self.fits for said in fit.said):
            where = [
                str(fit.step).rstrip(".")
                for fit in self.fits
                if (kind, text) in fit.said
            ]
            warnings.warn(
                f"{text.rstrip('.')} ({'; '.join(where)}).",
                kind,
                stacklevel=stacklevel + 1,
            )

    def of(self, number: int) -> Solution:
        """Masses and coefficients of one of several blocks."""
        masses = {
            j: float(np.ravel(m)[number if np.ndim(m) else 0])
            for j, m in self.masses.items()
        }
        return Solution(
            masses, {s: values[number] for s, values in self.coefficients.items()}
        )

    def digits_at_risk(self) -> bool:
        """Whether the Gram matrix squared away digits that the data hold; a streamed QR
        keeps them.
        """
        eps = np.finfo(float).eps
        return any(
            eps * fit.condition**2 > _DIGITS_AT_RISK
            or (fit.share < _CLEAN and eps * fit.condition**2 > 1e-13)
            for fit in self.fits
        )


class NotTogether(NRFError):
    """Blocks have to be solved one by one."""

    def __init__(self) -> None:
        super().__init__(
            "These blocks cannot be solved all at once", "Solve them one by one."
        )


def groups_of(layout: Layout, solve_order: SolveOrder) -> list[Group]:
    """Groups of columns a solve order needs: every balance, and the sums of balances it
    solves.
    """
    sums = [step.dofs for step in solve_order.steps if len(step.dofs) > 1]
    return [
        layout.group(dofs)
        for dofs in dict.fromkeys([*((j,) for j in range(1, layout.n_dof + 1)), *sums])
    ]


def doubtful_masses(solution: Solution) -> list[str]:
    """Sentences on masses that are not positive, or that noise in the motion or a
    missing law decides.
    """
    said = []
    for fit in solution.fits:
        for dof, noise in zip(fit.step.masses, fit.mass_noise):
            mass = solution.masses[dof]
            if mass > 0 and noise < _DOUBT:
                continue
            why = (
                "is not positive: does the force or the acceleration have the wrong"
                " sign, or a channel stand in the wrong column?"
                if noise < _DOUBT
                else (
                    f"is likely biased: what the {fit.step.name} leaves unexplained is"
                    f" {noise:.2g} times the part of its inertia that no other term can"
                    " imitate. Fuse or filter the channels, excite more frequencies,"
                    " add the missing law, or give the mass."
                )
            )
            said.append(f"m{dof} = {mass:.4g} kg {why}")
    return said


def solve_blocks(
    layout: Layout,
    solve_order: SolveOrder,
    blocks: Callable[[], Iterable[Block]],
    known_masses: Mapping[int, float] | None = None,
    inner: Any = None,
) -> tuple[Solution, NormalEquations]:
    """Sum up the samples and solve; where squaring loses digits, sum them up once more
    by QR.
    """
    groups, known = groups_of(layout, solve_order), dict(known_masses or {})
    grams = total_gram(layout, groups, blocks(), known)
    if (solution := solved_safely(grams, solve_order, known, inner)) is None:
        grams = total_gram(layout, groups, blocks(), known, "root")
        solution = solve(grams, solve_order, known, inner)
    return solution, grams


def solved_safely(
    grams: NormalEquations, order: SolveOrder, known: Mapping[int, float], inner: Any
) -> Solution | None:
    """Solution of Gram matrices, or None where squaring may have lost digits that the
    data hold.
    """
    with (
        suppress(RankWarning, IdentifiabilityError),
        warnings.catch_warnings(action="error", category=RankWarning),
    ):
        solution = solve(grams, order, known, inner)
        return None if solution.digits_at_risk() else solution
    return None


def solve(
    grams: NormalEquations,
    solve_order: SolveOrder,
    known_masses: Mapping[int, float] | None = None,
    inner: Any = None,
) -> Solution:
    """Find masses and coefficients from the Gram matrices of the balances."""
    solution = Solution(
        masses={int(j): float(m) for j, m in dict(known_masses or {}).items()}
    )
    if solve_order.strategy == "joint":
        return _solve_joint(grams, solve_order, solution, inner)
    _one_by_one(grams, solve_order, solution, inner)
    return solution


def _one_by_one(
    grams: NormalEquations,
    solve_order: SolveOrder,
    solution: Solution,
    inner: Any,
    triangles: Sequence[np.ndarray] = (),
) -> None:
    """Solve the steps; of a balance whose laws are found twice, also what it leaves
    with those of its neighbours.
    """
    held = list(triangles)
    for i, step in enumerate(solve_order.steps):
        if not triangles:
            held.append(_triangle(grams, step, solution))
        _take(
            grams, step, held[i], solution, inner, solve_order.strategy != "sequential"
        )
    for step, triangle, fit in zip(solve_order.steps, held, solution.fits):
        if any(
            site in solution.twins for site in step.sites if site.p not in step.dofs
        ):
            laws = [
                site.incidence(step.dofs[0]) * solution.coefficients[site]
                for site in step.sites
            ]
            masses = [
                np.reshape(solution.masses[j], (*grams.shape, 1)) for j in step.masses
            ]
            full = np.concatenate(
                [*masses, *laws, -np.ones((*grams.shape, 1))], axis=-1
            )
            left = np.linalg.norm((triangle @ full[..., None])[..., 0], axis=-1)
            fit.crossed = left / np.linalg.norm(triangle[..., -1], axis=-1)


def _triangle(grams: NormalEquations, step: Step, solution: Solution) -> np.ndarray:
    """Triangular factor of [unknown mass | unknown sites | right-hand side] of a step,
    given what is solved before.
    """
    where, mass_at, target_at = grams.positions(step.dofs)
    signs = dict(zip(grams.groups[step.dofs].sites, grams.groups[step.dofs].signs))
    target = np.zeros((*grams.shape, grams.matrices[step.dofs].shape[-1]))
    target[..., target_at] = 1.0
    for site in step.known_sites:
        target[..., where[site]] -= signs[site] * solution.coefficients[site]
    if mass_at is not None and not step.masses:
        target[..., mass_at] -= solution.masses.get(step.dofs[0], 0.0)
    columns = [mass_at] if step.masses and mass_at is not None else []
    columns += [c for s in step.sites for c in range(where[s].start, where[s].stop)]
    combine = np.zeros((*target.shape, len(columns) + 1))
    combine[..., columns, np.arange(len(columns))] = 1.0
    combine[..., -1] = target
    return grams.triangle(step.dofs, combine)


def _take(
    grams: NormalEquations,
    step: Step,
    triangle: np.ndarray,
    solution: Solution,
    inner: Any,
    twice: bool,
) -> None:
    """Solve one step and add what it finds to a solution."""
    cut, size = _RANK_CUT[grams.kind], grams.sizes[step.dofs]
    if grams.shape:
        values, fit = _least_squares_together(triangle, step, size, inner, cut)
    else:
        values, fit = _least_squares(
            triangle, step, float(size), inner, grams.layout, cut
        )
    solution.fits.append(fit)
    at = 0
    if step.masses:
        solution.masses[step.masses[0]], at = _number(values[..., 0]), 1
    signs = dict(zip(grams.groups[step.dofs].sites, grams.groups[step.dofs].signs))
    for site in step.sites:
        width = grams.layout.counts[site]
        found = signs[site] * values[..., at : at + width]
        at += width
        (
            solution.twins
            if twice and site.p not in step.dofs
            else solution.coefficients
        )[site] = found


def _number(value: np.ndarray) -> Any:
    """A plain number, or one for each block."""
    return value if value.ndim else float(value)


def _labels(step: Step, layout: Layout) -> list[str]:
    """The unknowns of a step in words, for messages."""
    return [f"m{j}" for j in step.masses] + [
        f"{s}: {label}" for s in step.sites for label in layout.labels(s)
    ]


def _least_squares(
    triangle: np.ndarray,
    step: Step,
    n_samples: float,
    inner: Any,
    layout: Layout,
    cut: float,
) -> tuple[np.ndarray, StepFit]:
    """Solve one sub-problem given as the triangular factor (square, upper) of [columns
    | right-hand side].
    """
    p = triangle.shape[1] - 1
    columns, target = triangle[:, :p], triangle[:, p]
    size = np.linalg.norm(columns, axis=0)
    size_y = float(np.linalg.norm(target))
    sizes = np.append(size, size_y)
    if (
        wild := np.flatnonzero(
            ~np.isfinite(sizes) | ((sizes > 0) & (sizes < _SMALLEST))
        )
    ).size:
        name = [*_labels(step, layout), "the force"][wild[0]]
        cure = "Check the units of its channels, or lower the degree."
        raise NRFError(
            f"{step.name}: the squares of {name} leave the range of a double", cure
        )
    if (idle := np.flatnonzero(size == 0)).size:
        name = _labels(step, layout)[idle[0]]
        what = (
            f"{step.name}: the column of {name} is zero throughout, or its squares"
            " leave the range of a double"
        )
        cure = (
            "Nothing moves there, or its channels have wrong units; check them, leave"
            " the term out, or excite it."
        )
        raise IdentifiabilityError(what, cure)
    unit = columns / size if p else columns
    values = np.linalg.svd(unit, compute_uv=False) if p else np.ones(1)
    rank = int((values > cut * values[0]).sum()) if p else 0
    condition = float(values[0] / values[-1]) if values[-1] > 0 else np.inf
    if size_y == 0:
        cure = "No force, known mass or known law scales it."
        if inner is not None and step.known_sites:
            cure = (
                f"The optimizer dropped every term of {step.known_sites[0]}, which"
                " scales it; lower its threshold."
            )
        raise IdentifiabilityError(
            f"{step.name}: the right-hand side is zero throughout", cure
        )
    fitted, said = None, ()
    if rank < p:
        _report_rank(unit, rank, step, _labels(step, layout))
        scaled = linalg.lstsq(unit, target / size_y, cond=cut, check_finite=False)[0]
    elif inner is None:
        scaled = _back(unit[:p], target[:p] / size_y)
    else:
        scaled, fitted, said = _sparse(
            unit, target / size_y, len(step.masses), n_samples, inner
        )
    residual = (
        float(np.linalg.norm(target / size_y - unit @ scaled)) * size_y if p else size_y
    )
    noise = (
        _mass_noise(unit[:p], scaled, residual / size_y, len(step.masses))
        if rank == p
        else ()
    )
    fit = StepFit(
        step,
        condition,
        rank,
        p,
        residual / (n_samples**0.5 or 1.0),
        residual / size_y,
        noise,
        fitted,
        said,
    )
    return scaled * size_y / size if p else scaled, fit


def _least_squares_together(
    triangle: np.ndarray, step: Step, n_samples: Any, inner: Any, cut: float
) -> tuple[np.ndarray, StepFit]:
    """Solve stacked sub-problems whose columns are certainly independent; condition is
    an upper bound.
    """
    p = triangle.shape[-1] - 1
    size = np.linalg.norm(triangle, axis=-2)
    if (
        inner is not None
        or not p
        or not (np.isfinite(size) & (size >= _SMALLEST)).all()
    ):
        raise NotTogether()
    unit = triangle / size[..., None, :]
    inverse, lost = zip(*(lapack.dtrtri(one.T, lower=1) for one in unit[..., :p, :p]))
    condition = p**0.5 * np.array([np.linalg.norm(one) for one in inverse])
    if any(lost) or not (condition * cut * _SURE < 1).all():
        raise NotTogether()
    scaled = np.array([_back(one[:p, :p], one[:p, p]) for one in unit])
    share = np.abs(unit[..., p, p])
    residual = share * size[..., p]
    return scaled * size[..., p:] / size[..., :p], StepFit(
        step, condition, p, p, residual / n_samples**0.5, share
    )


def _back(
    upper: np.ndarray, target: np.ndarray, transposed: bool = False
) -> np.ndarray:
    """Solution of an upper triangular system of full rank, or of its transpose."""
    return (
        lapack.dtrtrs(upper.T, target, lower=1, trans=int(not transposed))[0]
        if len(upper)
        else target
    )


def _mass_noise(
    upper: np.ndarray, scaled: np.ndarray, share: float, n_masses: int
) -> tuple[float, ...]:
    """Residual over each mass's own part of the right-hand side; the masses are the
    first columns of the factor.
    """
    if not n_masses:
        return ()
    rows = _back(upper, np.eye(len(upper), n_masses), transposed=True)  # of the inverse
    own = np.abs(scaled[:n_masses]) / np.linalg.norm(rows, axis=0)
    return tuple(float(share / part) if part else np.inf for part in own)


def _sparse(
    unit: np.ndarray, target: np.ndarray, n_masses: int, n_samples: float, inner: Any
) -> tuple:
    """Run a PySINDy optimizer on the problem with the masses, its first columns,
    eliminated; then solve for these.
    """
    length, fitted, said = n_samples**0.5, None, ()
    own, free = slice(0, n_masses), slice(n_masses, None)
    coefficients = np.zeros(unit.shape[1])
    if unit[free, free].shape[1]:
        coefficients[free], fitted, said = fit_inner(
            inner, unit[free, free] * length, target[free] * length
        )
    if n_masses:
        coefficients[own] = _back(
            unit[own, own], target[own] - unit[own, free] @ coefficients[free]
        )
    return coefficients, fitted, said


def _report_rank(unit: np.ndarray, rank: int, step: Step, labels: list[str]) -> None:
    """Say which columns depend on each other; refuse where a mass is among them."""
    weight = np.sqrt((np.linalg.svd(unit)[2][rank:] ** 2).sum(axis=0))
    involved = [labels[i] for i in np.argsort(-weight) if weight[i] > 1e-3][:6]
    what = (
        f"{step.name}: rank {rank} of {len(labels)}; {', '.join(involved)} are linearly"
        " dependent on this excitation"
    )
    if step.masses and weight[0] > 1e-3:
        raise IdentifiabilityError(
            f"{what}, so {labels[0]} cannot be told from the storey's stiffness",
            "A steady harmonic excitation or too few samples do this; excite several"
            " frequencies, lower the degree, or give the mass in known_masses.",
        )
    warnings.warn(
        f"{what}. Their coefficients are the smallest that fit; excite more frequencies"
        " or amplitudes, or lower the degree.",
        RankWarning,
        stacklevel=6,
    )


def _solve_joint(
    grams: NormalEquations, solve_order: SolveOrder, solution: Solution, inner: Any
) -> Solution:
    """All balances at once with shared laws (Newton's third law built in), each over
    what it leaves by itself.
    """
    layout, steps = grams.layout, solve_order.steps
    if grams.shape and inner is not None:
        raise NotTogether()
    triangles = [_triangle(grams, step, solution) for step in steps]
    alone, shares = Solution(masses=dict(solution.masses)), [np.ones(())] * len(steps)
    # columns independent in every balance are so together, where the condition is at
    # most the worst of the balances; if not, they may have a solution together
    with (
        suppress(RankWarning, IdentifiabilityError),
        warnings.catch_warnings(action="error", category=RankWarning),
    ):
        _one_by_one(grams, solve_order, alone, None, triangles)
        solution.alone, solution.fits = alone, alone.fits
        shares = [np.maximum(fit.share, _BEST) for fit in alone.fits]
    if (
        solve_order.yields
        and solution.alone
        and np.any([fit.contradicts for fit in alone.fits])
    ):
        if grams.shape:
            raise NotTogether()
        return alone
    upper, at = _together(grams, steps, triangles, shares)
    p = upper.shape[-1] - 1
    if solution.alone and inner is None:
        values = np.array(
            [_back(one[:p, :p], one[:p, p]) for one in upper.reshape(-1, p + 1, p + 1)]
        )
        values = values.reshape(*grams.shape, p)
    else:
        free = tuple(j for step in steps for j in step.masses)
        whole = Step(tuple(range(1, layout.n_dof + 1)), free, layout.acting, (), True)
        own = np.concatenate(
            [*(at[j] for j in free), *(at[site] for site in layout.acting)]
        )
        samples = float(sum(grams.sizes[step.dofs] for step in steps))
        found, fit = _least_squares(
            root_of(upper[:, [*own, p]]),
            whole,
            samples,
            inner,
            layout,
            _RANK_CUT[grams.kind],
        )
        solution.fits, values = [fit], np.empty(p)
        values[own] = found
    for key, columns in at.items():
        if isinstance(key, Site):
            solution.coefficients[key] = values[..., columns]
        else:
            solution.masses[key] = _number(values[..., columns[0]])
    return solution


def _together(
    grams: NormalEquations,
    steps: Sequence[Step],
    triangles: Sequence[np.ndarray],
    shares: Sequence[Any],
) -> tuple[np.ndarray, dict[int | Site, np.ndarray]]:
    """Triangular factor of all balances, unknowns eliminated after the last balance
    they are in; and their columns.
    """
    unknowns: list[list[int | Site]] = [[*step.masses, *step.sites] for step in steps]
    last = {key: i for i, keys in enumerate(unknowns) for key in keys}
    at: dict[int | Site, np.ndarray] = {}
    p = 0
    for key in sorted(last, key=last.__getitem__):
        width = grams.layout.counts[key] if isinstance(key, Site) else 1
        at[key], p = np.arange(p, p + width), p + width
    upper = np.zeros((*grams.shape, p + 1, p + 1))
    held, carry, first = np.array([p]), np.zeros((*grams.shape, 0, 1)), 0
    for i, (step, triangle, share) in enumerate(zip(steps, triangles, shares)):
        own = np.concatenate([*(at[key] for key in unknowns[i]), [p]])
        signs = np.ones(len(own))
        for site in step.sites:
            signs[np.isin(own, at[site])] = site.incidence(step.dofs[0])
        scale = np.asarray(
            np.sqrt(grams.sizes[step.dofs])
            / np.linalg.norm(triangle[..., -1], axis=-1)
            / share
        )
        columns = np.union1d(held, own)
        rows = np.zeros(
            (*grams.shape, carry.shape[-2] + triangle.shape[-2], len(columns))
        )
        rows[..., : carry.shape[-2], np.searchsorted(columns, held)] = carry
        rows[..., carry.shape[-2] :, np.searchsorted(columns, own)] = (
            triangle * signs * scale[..., None, None]
        )
        factor = upper_of(rows)
        done = sum(len(at[key]) for key in at if last[key] == i)
        upper[..., first : first + done, columns] = factor[..., :done, :]
        held, carry, first = columns[done:], factor[..., done:, done:], first + done
    upper[..., p, p] = carry[..., 0, 0]
    return upper, at


def model_of(layout: LawLayout, solution: Solution) -> ChainModel:
    """Put the coefficients of a solution into the laws of a layout."""
    laws = with_coefficients(
        {site: layout.laws.get(site, ()) for site in layout.sites},
        solution.coefficients,
    )
    return ChainModel(
        [solution.masses[j] for j in range(1, layout.n_dof + 1)], laws, layout.chain
    )


def third_law_gap(solution: Solution, grams: NormalEquations) -> pd.Series:
    """Rms difference of the two estimates of each storey's force (paper eq. 10b),
    percent of its rms.
    """
    solution, gaps = solution.alone or solution, {}
    for site, twin in solution.twins.items():
        where, *_ = grams.positions((site.p,))
        both = np.zeros((grams.matrices[site.p,].shape[-1], 2))
        both[where[site]] = np.column_stack(
            [solution.coefficients[site] - twin, solution.coefficients[site]]
        )
        gap, whole = grams.norms((site.p,), both)
        gaps[str(site)] = 100.0 * gap / whole if whole else np.inf
    return pd.Series(dict(sorted(gaps.items())), name="third-law gap (%)", dtype=float)


def unknown_forces(model: ChainModel, data: Dataset) -> pd.DataFrame:
    """Forces (N) on the DOFs whose force was not known, from the balances; NaN where it
    was given.
    """
    hidden = [
        j
        for j in range(data.n_dof)
        if any(np.isnan(seg.F[seg.valid.start, j]) for seg in data.segments)
    ]
    given = [seg.F[seg.valid] for seg in data.segments]
    forces = model.balance_forces(data) if hidden else given
    parts = [
        np.where(np.isnan(F[:, hidden]), f[:, hidden], np.nan)
        for F, f in zip(given, forces)
    ]
    return pd.DataFrame(data.scatter(parts), columns=[f"F{j + 1}" for j in hidden])


def visited_regions(data: Dataset, layout: LawLayout) -> dict[Site, VisitedRegion]:
    """Rates and drifts that the data visited, by site."""
    pieces = [(seg.v[seg.valid], seg.s[seg.valid]) for seg in data.segments]
    lows, highs = zip(*(seg.extent.boxes(data.n_dof) for seg in data.segments))
    low, high = np.min(lows, axis=0), np.max(highs, axis=0)
    storeys = VisitedRegion.of_storeys(pieces, low, high)
    out = {}
    for site in layout.sites:
        if site.p - site.q == 1:
            out[site] = storeys[site.p - 1]
        else:
            lines = (
                [x[k][:, site.q : site.p].sum(axis=1, dtype=float) for x in pieces]
                for k in (0, 1)
            )
            out[site] = VisitedRegion.of(*map(np.concatenate, lines))
    return out


def clock_of(motions: Sequence[Motion]) -> tuple[float, tuple[float, float]]:
    """Length of the longest record, and first and last time of all, s; 1 s from 0
    without a clock.
    """
    ends = [(float(m.t[0]), float(m.t[-1])) for m in motions if m.t is not None] or [
        (0.0, 1.0)
    ]
    return max(last - first for first, last in ends), (
        min(first for first, _ in ends),
        max(last for _, last in ends),
    )


def scales_of(data: Dataset, layout: LawLayout) -> dict[Site, Scales]:
    """Sizes of the motion at each site, from which shape parameters are searched."""
    total = {}
    for site in layout.sites:
        motions = [seg.motion(site, seg.valid) for seg in data.segments]
        size = sum(m.n_samples for m in motions)
        rms = [
            float(np.sqrt(sum((getattr(m, key) ** 2).sum() for m in motions) / size))
            for key in "sv"
        ]
        total[site] = (rms[0], rms[1], *clock_of(motions))
    return total


def require_moving(data: Dataset, layout: LawLayout) -> None:
    """Refuse channels that are constant in every record."""
    for at, name in enumerate("avs"):
        for j in range(data.n_dof):
            if name != "a" and not layout.counts.get(Site(j + 1)):
                continue
            channel = at * data.n_dof + j
            if all(
                seg.extent.low[channel] >= seg.extent.high[channel]
                for seg in data.segments
            ):
                cure = (
                    "A dead sensor, a wrong column or a floor that is not excited;"
                    " check it, or leave the DOF out."
                )
                raise ChannelError(
                    f"Channel {name}{j + 1} is constant in every record", cure
                )


def require_samples(data: Dataset, solve_order: SolveOrder, layout: LawLayout) -> None:
    """Refuse fewer samples than a step of the solve order has unknowns."""
    for step in solve_order.steps:
        unknowns = len(step.masses) + sum(layout.counts[s] for s in step.sites)
        own = [j - 1 for j in step.dofs]
        rows = sum(
            seg.n_valid
            for seg in data.segments
            if not np.isnan(seg.F[seg.valid.start, own]).any()
        )
        if rows < unknowns + 1:
            cure = "Use a longer record or a lower degree."
            raise ChannelError(
                f"{rows} samples are too few for the {step.name}, which has {unknowns}"
                " unknowns",
                cure,
            )


def require_clock(data: Dataset, layout: LawLayout) -> None:
    """Warn where laws that remember the path have to guess where the motion turns."""
    if layout.has_memory and any(seg.t is None for seg in data.segments):
        warnings.warn(
            "A law remembers the path and the time of the samples is unknown: where the"
            " motion turns between two samples is guessed, which costs accuracy. Pass"
            " dt= (s) to the estimator or time= to fit.",
            DataQualityWarning,
            stacklevel=5,
        )
