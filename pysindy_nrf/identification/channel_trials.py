"""Trial fits of a chain to few channels, and what else is known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ..chain.model import ChainModel
from ..chain.structure import Chain
from ..exceptions import NRFError
from .fewer_sensors_settings import SETTINGS
from .free_run_fit import FreeRunFit, Solution
from .parameter_vector import Rebuild
from .parameters import Known, linear_equations, with_values
from .whitened_runs import PriorEquations


@dataclass(frozen=True)
class Trial:
    """A fit that ended, or was left after some steps."""

    fit: FreeRunFit
    solution: Solution

    @property
    def cost(self) -> float:
        """Squared residuals by which trials are ranked."""
        return self.solution.cost


@dataclass(frozen=True)
class Knowledge:
    """What is known of a chain apart from its channels.

    Attributes
    ----------
    chain : Chain
    masses : mapping of int to float
        kg, by DOF; they are not estimated.
    constraints : mapping of str to Parameter
        Values of what is estimated, with their spreads, and ties.
    """

    chain: Chain
    masses: Mapping[int, float]
    constraints: Known = field(default_factory=dict)

    @property
    def values(self) -> dict[str, float]:
        """Known masses, and known masses and stiffnesses, by parameter."""
        names = [f"m{dof}" for dof in range(1, self.chain.n_dof + 1)]
        for site in self.chain.sites:
            names.append(f"{site}: s")
        values = {f"m{dof}": mass for dof, mass in self.masses.items()}
        for name, known in with_values(self.constraints, names, self.chain).items():
            values[name] = float(known.value or 0.0)
        return values

    def scaling_masses(self, forced: set[int]) -> dict[int, float]:
        """Masses that scale the chain; expected ones if no force and mass is known."""
        if self.masses or forced:
            return dict(self.masses)
        values = self.values
        return {int(name[1:]): values[name] for name in values if name[0] == "m"}

    def prior(self, rebuild: Rebuild, all_declared: bool = True) -> PriorEquations:
        """Equations of the parameters; unless ``all_declared``, of those there are."""
        known = linear_equations(
            self.constraints, rebuild.names, self.chain, self.masses, all_declared
        )
        A = known.factors
        b = known.values
        terms = np.abs(A) @ np.abs(rebuild.values(rebuild.start)) + np.abs(b)
        exact = SETTINGS.exact_spread * terms
        spread = np.where(known.spreads > 0, known.spreads, exact)
        return PriorEquations(A / spread[:, None], b / spread)


def distance_of_masses(model: ChainModel, other: ChainModel) -> float:
    """Largest difference of the logarithms of masses."""
    return float(np.abs(np.log(model.masses / other.masses)).max())


def solved(fit: FreeRunFit, u: np.ndarray, steps: int) -> Trial | None:
    """Estimate with free initial states; None if the first free run diverges.

    The shots of the trial begin from the states that were estimated.
    """
    try:
        solution = fit.solve(u, steps=steps, move=True, settled=SETTINGS.settled)
    except NRFError:
        return None
    return Trial(fit.begun_from(solution), solution)
