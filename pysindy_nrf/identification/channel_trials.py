"""Trial fits of a chain to few channels, and what is known beside them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..chain.model import ChainModel
from ..exceptions import NRFError
from .constraints import Constraint, Prior, system_of
from .fewer_sensors_settings import SETTINGS
from .free_parameters import Rebuild
from .free_run_fit import FreeRunFit, Solution
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
    """What is known of a chain beside its channels.

    Attributes
    ----------
    masses : mapping of int to float
        kg, by DOF; they are not estimated.
    constraints : tuple of Constraint
        Equations of what is estimated, with their spreads.
    """

    masses: Mapping[int, float]
    constraints: tuple[Constraint, ...] = ()

    @property
    def values(self) -> dict[str, float]:
        """Known masses and expected values, by parameter."""
        values = {f"m{dof}": mass for dof, mass in self.masses.items()}
        for constraint in self.constraints:
            if isinstance(constraint, Prior):
                values[constraint.parameter] = constraint.value
        return values

    def scaling_masses(self, forced: set[int]) -> dict[int, float]:
        """Masses that scale the chain; expected ones if no force and mass is known."""
        if self.masses or forced:
            return dict(self.masses)
        values = self.values
        return {int(name[1:]): values[name] for name in values if name[0] == "m"}

    def prior(self, rebuild: Rebuild, all_declared: bool = True) -> PriorEquations:
        """Equations of the parameters; unless ``all_declared``, of those there are."""
        A, b, spread = system_of(
            self.constraints,
            rebuild.names,
            rebuild.model.chain,
            dict(self.masses),
            all_declared,
        )
        terms = np.abs(A) @ np.abs(rebuild.values(rebuild.start)) + np.abs(b)
        spread = np.where(spread > 0, spread, SETTINGS.exact_spread * terms)
        return PriorEquations(A / spread[:, None], b / spread)


def distance_of_masses(model: ChainModel, other: ChainModel) -> float:
    """Largest difference of the logarithms of masses."""
    return float(np.abs(np.log(model.masses / other.masses)).max())


def solved(fit: FreeRunFit, u: np.ndarray, steps: int) -> Trial | None:
    """Estimate with free initial states; None if the first free run diverges."""
    try:
        solution = fit.solve(u, steps=steps, move=True, settled=SETTINGS.settled)
    except NRFError:
        return None
    return Trial(fit, solution)
