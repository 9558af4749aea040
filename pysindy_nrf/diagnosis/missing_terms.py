"""Terms that the laws lack, judged equation by equation from the data alone.

Each equation of motion is offered probe regressors that its laws do not have; where
they help on left-out windows, a law is missing or the motion is noisy. A constant and a
ramp are offered separately: a sensor's wrong zero or drift.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from ..chain.identifiability import SolveOrder, Step
from ..chain.layout import Block, LawLayout, Layout, Recipe, copies
from ..chain.model import ChainModel
from ..equations.accumulation import ProductSums
from ..equations.normal_equations import NormalEquations
from .gram_least_squares import (
    held_out_residual,
    left_over,
    solved,
)
from .sample_windows import FOLDS, LASTING, OFFERED, Window

# Percent of the held-out residual that the probe regressors must remove.
GAIN = 5.0
# Percent of the equation's right-hand side that they must explain.
MISSING = 2.0
# Percent of the held-out residual that a constant and a ramp must remove for zeros to
# be doubted.
GAIN_OF_ZEROS = 90.0
# Share of the right-hand side below which a residual is round-off.
ROUND_OFF = 1e-6
# Fewer samples than this are too few for further columns.
ROWS_PER_COLUMN = 20
# Windows of each fold, fewer of which are too few for a judgement.
WINDOWS_PER_FOLD = 2


class MissingTerms:
    """Gram matrices of the columns of laws and of probe regressors, by fold.

    Parameters
    ----------
    model : ChainModel
    solve_order : SolveOrder
    layout : LawLayout, optional
        Columns of the model's laws.
    """

    def __init__(
        self,
        model: ChainModel,
        solve_order: SolveOrder,
        layout: LawLayout | None = None,
    ) -> None:
        self.solve_order = solve_order
        self.layout = layout or LawLayout(model.chain, model.laws)
        self.coefficients = model.coefficients
        self.masses = dict(enumerate(model.masses.tolist(), 1))

        # the columns of each site: its own, then those offered
        widths = {
            site: self.layout.counts[site] + OFFERED for site in self.layout.acting
        }
        self.wide = Layout(self.layout.chain, widths)
        dofs_of_steps = dict.fromkeys(step.dofs for step in solve_order.steps)
        groups = [self.wide.group(dofs) for dofs in dofs_of_steps]
        self.folds = ProductSums(self.wide, groups, self.masses, n_blocks=FOLDS)
        self.n_windows = dict.fromkeys(dofs_of_steps, 0)
        self.n_rows = 0
        self._recipe: tuple[Recipe | None, Recipe] | None = None

    def add(self, number: int, window: Window) -> None:
        """Take a window in, which goes to a fold by its number."""
        window = window.thinned()
        self.n_rows += window.n_samples
        self.folds.add(self._with_probes(window), number % FOLDS)

        known = window.block.known
        for dofs in self.n_windows:
            if all(known[dof - 1] for dof in dofs):
                self.n_windows[dofs] += 1

    def _with_probes(self, window: Window) -> Block:
        """The block of a window with the probe regressors behind the columns."""
        block = window.block
        source = block.terms if block.source is None else block.source
        return Block(
            None,
            block.acceleration,
            block.force,
            np.vstack([source, *window.offered.values()]),
            self._wide_recipe(block.recipe),
            self.wide.n_terms,
            block.weights,
        )

    def _wide_recipe(self, recipe: Recipe | None) -> Recipe:
        """Recipe of own and offered columns; windows mostly share one."""
        if self._recipe is None or self._recipe[0] is not recipe:
            self._recipe = recipe, _widened(recipe, self.layout, self.wide)
        return self._recipe[1]

    def table(self) -> pd.DataFrame:
        """What the laws leave unexplained, step by step.

        Returns
        -------
        DataFrame
            ``missing_terms_`` of a regressor, by step of the solve.

            - ``residual``: percent of the right-hand side that is unexplained.
            - ``gain``: percent of the held-out residual that probe regressors remove.
            - ``missing``: percent of the right-hand side that they explain.
            - ``shift``: percent by which the mass moves with them.
            - ``lasting``: percent of the held-out residual that a constant and a ramp
              remove.
            - ``biased``: whether a law is missing.
        """
        folds = self.folds.grams()
        judged: dict[str, _Judgement] = {}
        for alike in self._alike_steps(folds).values():
            judged |= _judge(alike)

        names = []
        rows = []
        for step in self.solve_order.steps:
            if self.n_windows[step.dofs]:
                names.append(step.name)
                rows.append(judged[step.name])
        residual, gain, shift, lasting = np.array(rows).reshape(-1, 4).T
        missing = residual * np.sqrt(gain / 100)
        columns = {
            "residual": residual,
            "gain": gain,
            "missing": missing,
            "shift": shift,
            "lasting": lasting,
            "biased": (gain > GAIN) & (missing > MISSING),
        }
        return pd.DataFrame(columns, index=names)

    def _alike_steps(
        self, folds: NormalEquations
    ) -> dict[tuple[int, int], list[_StepGrams]]:
        """Steps by the numbers of their columns; alike ones are judged at once."""
        alike: dict[tuple[int, int], list[_StepGrams]] = {}
        for step in self.solve_order.steps:
            if not self.n_windows[step.dofs]:
                continue
            combine = self._combination(step, folds)
            n_columns = combine.shape[1] - 1
            n_own = len(step.masses)
            for site in step.sites:
                n_own += self.layout.counts[site]
            enough_windows = self.n_windows[step.dofs] >= WINDOWS_PER_FOLD * FOLDS
            enough_rows = self.n_rows >= ROWS_PER_COLUMN * n_columns
            grams = _StepGrams(
                name=step.name,
                has_mass=bool(step.masses),
                enough=enough_windows and enough_rows,
                n_own=n_own,
                grams=combine.T @ folds.matrices[step.dofs] @ combine,
            )
            alike.setdefault((n_columns, n_own), []).append(grams)
        return alike

    def _combination(self, step: Step, folds: NormalEquations) -> np.ndarray:
        """From the columns of an equation to [own | offered | right-hand side]."""
        slices, mass_at, target_at = folds.positions(step.dofs)
        group = folds.groups[step.dofs]
        signs = dict(zip(group.sites, group.signs))

        of_laws = [mass_at] if step.masses and mass_at is not None else []
        for site in step.sites:
            first = slices[site].start
            of_laws += range(first, first + self.layout.counts[site])
        sites = (*step.sites, *step.known_sites)
        offered: list[int] = []
        for site in sites:
            end = slices[site].stop
            offered += range(end - OFFERED, end - LASTING)
        for site in sites[:1]:  # a constant and a ramp are the same at all sites
            end = slices[site].stop
            offered += range(end - LASTING, end)

        columns = [*of_laws, *offered]
        combine = np.zeros((target_at + 1, len(columns) + 1))
        combine[columns, np.arange(len(columns))] = 1.0
        combine[target_at, -1] = 1.0
        if mass_at is not None and not step.masses:
            combine[mass_at, -1] = -self.masses[step.dofs[0]]
        for site in step.known_sites:
            own_columns = slice(slices[site].start, slices[site].stop - OFFERED)
            combine[own_columns, -1] = -signs[site] * self.coefficients[site]
        return combine


def _widened(recipe: Recipe | None, layout: LawLayout, wide: Layout) -> Recipe:
    """Recipe of own and offered columns.

    Its source is that of the own columns, and behind it the offered columns of each
    site. Without a recipe the own columns are the source themselves.
    """
    if recipe is None:
        rows = np.arange(layout.n_terms)
        recipe = Recipe(copies(rows, rows), (), (), layout.n_terms)

    of_laws: list[int] = []
    offered: list[int] = []
    for site in layout.acting:
        columns = wide.slices[site]
        of_laws += range(columns.start, columns.stop - OFFERED)
        offered += range(columns.stop - OFFERED, columns.stop)

    row, source, factor = recipe.steps.T
    n_helpers = max(0, int(row.max(initial=-1)) + 1 - layout.n_terms)
    helpers = np.arange(wide.n_terms, wide.n_terms + n_helpers)
    # where a row of the recipe goes; -1 stands for ones and stays
    place = np.concatenate([of_laws, helpers, [-1]]).astype(np.int64)

    own_steps = np.column_stack([place[row], source, place[factor]])
    offered_sources = recipe.n_source + np.arange(len(offered))
    steps = np.vstack([own_steps, copies(offered, offered_sources)])
    return replace(recipe, steps=steps, n_source=recipe.n_source + len(offered))


@dataclass(frozen=True)
class _StepGrams:
    """Gram matrices of one step by fold, (FOLDS, p + 1, p + 1)."""

    name: str
    has_mass: bool
    enough: bool  # windows and samples for a judgement
    n_own: int
    grams: np.ndarray


# Residual, gain, shift and lasting of a step, percent; see MissingTerms.table.
_Judgement = tuple[float, float, float, float]


def _judge(steps: Sequence[_StepGrams]) -> dict[str, _Judgement]:
    """Judgements by the names of steps that have as many columns."""
    n_own = steps[0].n_own
    has_mass = np.array([step.has_mass for step in steps])
    enough = np.array([step.enough for step in steps])
    folds = np.array([step.grams for step in steps])
    total = folds.sum(axis=1)

    p = total.shape[-1] - 1
    # without a site there are no further columns
    first_lasting = max(p - LASTING, n_own)
    of_laws = np.arange(n_own)
    with_probes = np.arange(first_lasting)
    with_zeros = np.r_[of_laws, first_lasting:p]

    own_values = solved(total, of_laws)
    force = total[:, p, p]
    unexplained = left_over(total, of_laws, own_values)
    residual = np.sqrt(unexplained / np.where(force > 0, force, 1.0))

    gain = np.zeros(len(steps))
    shift = np.where(has_mass, 0.0, np.nan)
    lasting = np.zeros(len(steps))
    judged = np.flatnonzero((residual >= ROUND_OFF) & enough)
    if judged.size:
        by_own = held_out_residual(folds[judged], of_laws)
        by_laws = held_out_residual(folds[judged], with_probes)
        by_zeros = held_out_residual(folds[judged], with_zeros)
        gain[judged] = 100 * np.maximum(0.0, 1 - by_laws / by_own)
        lasting[judged] = 100 * np.maximum(0.0, 1 - by_zeros / by_own)

    moved = judged[has_mass[judged]]
    if moved.size:
        before = own_values[moved, 0]
        after = solved(total[moved], with_probes)[:, 0]
        ratio = after / np.where(before, before, 1.0)
        shift[moved] = np.where(before, 100 * (ratio - 1), 0.0)

    rows = zip(100 * residual, gain, shift, lasting)
    return {step.name: row for step, row in zip(steps, rows)}


def wrong_zeros(table: pd.DataFrame) -> list[str]:
    """A question on the zeros of sensors, where these explain nearly all that is left.

    Parameters
    ----------
    table : DataFrame
        Of :meth:`MissingTerms.table`.
    """
    lasting = table["lasting"].to_numpy()
    size = table["residual"].to_numpy() * np.sqrt(lasting / 100)
    hit = np.flatnonzero((lasting > GAIN_OF_ZEROS) & (size > MISSING))
    if not hit.size:
        return []

    worst = str(table.index[hit[size[hit].argmax()]])
    row = table.loc[worst]
    place = worst.removeprefix("balance of ").removesuffix(" together")
    return [
        f"{_with_others(worst, len(hit))}: {row['residual']:.3g} % of it is"
        " unexplained, and a constant or a straight line in time explains"
        f" {row['lasting']:.0f} % of that on held-out data. Does a displacement there"
        f" (of {place} or a neighbour) or its force read a wrong zero, or drift? By"
        " least squares masses and stiffnesses come out wrong then: take out the mean"
        " of every displacement and force, or give band=(lo, hi) above a drift. Or has"
        " a storey yielded, or does a constant force act there? Add its law (laws=)."
    ]


def missing_laws(table: pd.DataFrame) -> list[str]:
    """A sentence on the equation in which a law is missing most."""
    hit = np.flatnonzero(table["biased"].to_numpy(dtype=bool))
    if not hit.size:
        return []

    worst = str(table["missing"].iloc[hit].idxmax())
    row = table.loc[worst]
    return [
        f"{_with_others(worst, len(hit))}: {row['residual']:.2g} % of it is"
        " unexplained, and that is not noise alone: terms the laws do not have explain"
        f" {row['gain']:.0f} % of it on held-out data. A law is missing there"
        " (hysteresis, friction, a gap) or the motion is noisy; masses and forces are"
        " likely biased. Add the law (laws=), search for it (close_loop), or fuse noisy"
        " channels with KinematicSmoother."
    ]


def _with_others(worst: str, n_hit: int) -> str:
    """The name of an equation with a capital, and how many others are hit."""
    name = worst[0].upper() + worst[1:]
    return f"{name} (and {n_hit - 1} more)" if n_hit > 1 else name
