"""What a solve found: masses, coefficients, and how well each step determines them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd

from ..chain.identifiability import SolveOrder, Step
from ..chain.layout import LawLayout, with_coefficients
from ..chain.model import ChainModel
from ..chain.sites import Site
from ..common.unit_system import TRANSLATION, UnitSystem
from ..common.warn import warn_user
from .inner_optimizer import Optimizer
from .normal_equations import NormalEquations, PerBlock

# Squaring a scaled condition number c loses c^2 of the 1e16 digits of a double.
MAX_LOSS_OF_DIGITS = 1e-9
# The same where the residual is this small a share of the right-hand side: the data
# have more digits than noise usually leaves.
CLEAN_SHARE = 1e-5
MAX_LOSS_OF_CLEAN_DIGITS = 1e-13
# Residual over a mass's own part of its equation from which on the mass is warned of.
DOUBTFUL_MASS = 0.5
# Share of the right-hand side that the neighbours' laws leave, and times what its own
# laws leave, from which on one of the two is wrong.
CONTRADICTION_SHARE = 0.1
CONTRADICTION_RATIO = 3.0


@dataclass(frozen=True)
class StepFit:
    """Condition, rank, residual and noise of the masses of one step of a solve order.

    Numbers are arrays (n_blocks,) where blocks were solved together.

    Attributes
    ----------
    step : Step
    condition : float
        Of the columns scaled to unit length; an upper bound where blocks were solved
        together.
    rank, n_columns : int
    residual : float
        Rms, N; without unit for a joint solve, whose equations are divided by their rms
        force.
    share : float
        The same over the rms of the right-hand side.
    mass_noise : tuple of float
        For each mass: residual over the part of its inertia that no other column
        imitates; near one, noise decides.
    inner : PySINDy optimizer, optional
        The fitted one.
    warned : tuple of (warning class, str)
        What the optimizer warned of.
    crossed : float
        As ``share``, with the laws that the neighbouring equations find in place of its
        own.
    dependent : str
        Which columns depend on each other, in words; empty at full rank.
    """

    step: Step
    condition: PerBlock
    rank: int
    n_columns: int
    residual: PerBlock
    share: PerBlock
    mass_noise: tuple[float, ...] = ()
    inner: Optimizer | None = None
    warned: tuple[tuple[type[Warning], str], ...] = ()
    crossed: PerBlock = 0.0
    dependent: str = ""

    @property
    def contradicts(self) -> np.ndarray:
        """Whether the neighbours find laws that this equation excludes."""
        limit = np.maximum(CONTRADICTION_SHARE, CONTRADICTION_RATIO * self.share)
        return np.asarray(self.crossed > limit)

    def loses_digits(self) -> bool:
        """Whether squaring the columns lost digits that the data have."""
        loss = np.finfo(float).eps * self.condition**2
        clean = self.share < CLEAN_SHARE and loss > MAX_LOSS_OF_CLEAN_DIGITS
        return bool(loss > MAX_LOSS_OF_DIGITS or clean)


@dataclass(frozen=True)
class Solution:
    """Masses and coefficients of a chain.

    Attributes
    ----------
    masses : dict of int to float
        kg; arrays (n_blocks,) where blocks were solved together.
    coefficients : dict of Site to ndarray
        SI units, (n_terms,); (n_blocks, n_terms) where blocks were solved together.
    twins : dict of Site to ndarray
        Where every equation was solved by itself: the second estimate, from the
        equation at the other end (paper eq. 10b).
    fits : sequence of StepFit
    alone : Solution, optional
        Of a joint solve, or one from the upper end down by default: that of each
        equation by itself, if every equation has one.
    """

    masses: dict[int, PerBlock] = field(default_factory=dict)
    coefficients: dict[Site, np.ndarray] = field(default_factory=dict)
    twins: dict[Site, np.ndarray] = field(default_factory=dict)
    fits: Sequence[StepFit] = ()
    alone: Solution | None = None

    @property
    def inner(self) -> dict[str, Optimizer]:
        """Fitted optimizers by equation."""
        fitted = {}
        for fit in self.fits:
            if fit.inner is not None:
                fitted[fit.step.name] = fit.inner
        return fitted

    @property
    def mass_noise(self) -> dict[int, float]:
        """Residual over the part of each inertia that no other column imitates.

        By DOF, of the masses that were solved for; near one, noise decides.
        """
        noise: dict[int, float] = {}
        for fit in self.fits:
            noise.update(zip(fit.step.masses, fit.mass_noise))
        return noise

    @property
    def dependent(self) -> list[str]:
        """Columns that depend on each other, in words, step by step."""
        return [fit.dependent for fit in self.fits if fit.dependent]

    @property
    def contradicts(self) -> bool:
        """Whether two equations find laws that exclude each other."""
        return any(np.any(fit.contradicts) for fit in self.fits)

    def followed(self, solve_order: SolveOrder) -> SolveOrder:
        """The order that was followed.

        It is every equation by itself where a solve by default found contradictions.
        """
        gave_way = solve_order.yields and bool(self.twins)
        strategy = "complete" if gave_way else solve_order.strategy
        steps = (
            solve_order.apart if gave_way and solve_order.apart else solve_order.steps
        )
        return replace(
            solve_order, strategy=strategy, steps=steps, yields=False, apart=()
        )

    def pass_on(self) -> None:
        """Warn once of what optimizers warned of, and on which equations."""
        places: dict[tuple[type[Warning], str], list[str]] = {}
        for fit in self.fits:
            for warning in fit.warned:
                places.setdefault(warning, []).append(str(fit.step).rstrip("."))
        for (kind, text), steps in places.items():
            where = "; ".join(steps)
            message = f"{text.rstrip('.')} ({where})."
            warn_user(message, kind)

    def of(self, number: int) -> Solution:
        """Masses and coefficients of one of several blocks."""
        masses: dict[int, PerBlock] = {}
        for dof, mass in self.masses.items():
            if isinstance(mass, np.ndarray) and mass.ndim:
                mass = mass[number]
            masses[dof] = float(mass)
        by_site = {site: values[number] for site, values in self.coefficients.items()}
        return Solution(masses, by_site)

    def digits_at_risk(self) -> bool:
        """Whether squaring the columns lost digits that a streamed QR keeps."""
        return any(fit.loses_digits() for fit in self.fits)


def model_of(layout: LawLayout, solution: Solution) -> ChainModel:
    """The laws of a layout with the coefficients of a solution."""
    laws = {site: layout.laws.get(site, ()) for site in layout.sites}
    valued = with_coefficients(laws, solution.coefficients)
    masses = [float(solution.masses[dof]) for dof in range(1, layout.n_dof + 1)]
    return ChainModel(masses, valued, layout.chain)


def doubtful_masses(
    solution: Solution, masses: Sequence[float], units: UnitSystem = TRANSLATION
) -> list[str]:
    """Sentences on masses that are not positive, or that noise decides.

    ``masses`` are those of all DOFs that the user gets.
    """
    sentences = []
    for fit in solution.fits:
        for dof, noise in zip(fit.step.masses, fit.mass_noise):
            mass = masses[dof - 1]
            if mass > 0 and noise < DOUBTFUL_MASS:
                continue
            why = (
                f"is likely biased: what the {fit.step.name} leaves unexplained is"
                f" {noise:.2g} times the part of its inertia that no other term can"
                " imitate. Fuse or filter the channels, excite more frequencies, add"
                " the missing law, or give the mass."
            )
            if noise < DOUBTFUL_MASS:
                why = (
                    "is not positive: does the force or the acceleration have the wrong"
                    " sign, or a channel stand in the wrong column?"
                )
            sentences.append(f"m{dof} = {mass:.4g} {units.mass} {why}")
    return sentences


def third_law_gap(solution: Solution, grams: NormalEquations) -> pd.Series:
    """Rms difference of the two estimates of each storey's force (paper eq. 10b).

    Percent of the rms of the force.
    """
    every = solution.alone or solution
    gaps = {}
    for site, twin in every.twins.items():
        dofs = (site.p,)
        places = grams.positions(dofs)
        both = np.zeros((grams.matrices[dofs].shape[-1], 2))
        both[places.sites[site], 0] = every.coefficients[site] - twin
        both[places.sites[site], 1] = every.coefficients[site]
        gap, force = grams.norms(dofs, both)
        gaps[str(site)] = 100.0 * gap / force if force else np.inf
    return pd.Series(dict(sorted(gaps.items())), name="third-law gap (%)", dtype=float)
