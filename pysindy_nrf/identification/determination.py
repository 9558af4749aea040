"""What measured channels determine of a chain, by the sensitivities of a fit."""

import numpy as np

from ..exceptions import IdentifiabilityError
from .fewer_sensors_settings import SETTINGS
from .free_run_fit import Solution
from .parameter_vector import Rebuild
from .whitened_runs import column_lengths

# Component of the least determined direction from which on a parameter is named.
NAMED_COMPONENT = 0.3
CURE = (
    "Add a sensor (Chain.sensing says where), give known_masses=, or declare fewer"
    " laws."
)


def relative_errors(solution: Solution, rebuild: Rebuild) -> np.ndarray:
    """Standard errors of parameters, as shares of them."""
    is_logarithm = rebuild.logarithmic | (solution.u == 0)
    return solution.standard_errors() / np.where(is_logarithm, 1.0, np.abs(solution.u))


def poorly_determined(solution: Solution, rebuild: Rebuild) -> list[str]:
    """A sentence on masses and stiffnesses that the channels determine poorly.

    Parameters
    ----------
    solution : Solution
    rebuild : Rebuild

    Raises
    ------
    IdentifiabilityError
        If the channels do not determine one of them.
    """
    names = rebuild.names
    _require_distinct(solution, names)

    errors = relative_errors(solution, rebuild)
    poor = []
    for k, name in enumerate(names):
        is_mass_or_stiffness = ":" not in name or name.endswith(": s")
        if is_mass_or_stiffness and errors[k] > SETTINGS.reported_error:
            poor.append(k)
    if not poor:
        return []

    poor.sort(key=lambda k: -errors[k])
    worst = poor[0]
    if errors[worst] > SETTINGS.refused_error:
        size = "more than itself"
        if errors[worst] < 1:
            size = f"{100 * errors[worst]:.0f} %"
        raise IdentifiabilityError(
            f"The channels do not determine {names[worst]}: its standard error is"
            f" {size}",
            CURE,
        )
    listed = ", ".join(f"{names[k]} to {100 * errors[k]:.0f} %" for k in poor)
    return [
        f"The measured channels determine {listed} only (standard error). {CURE}",
    ]


def _require_distinct(solution: Solution, names: list[str]) -> None:
    """Raise an error if some parameters move the channels alike."""
    unit = solution.jacobian / column_lengths(solution.jacobian)
    _, sizes, directions = np.linalg.svd(unit)
    if sizes[-1] * SETTINGS.max_condition >= sizes[0]:
        return

    components = np.abs(directions[-1])
    alike = [names[k] for k in np.flatnonzero(components > NAMED_COMPONENT)]
    raise IdentifiabilityError(
        f"The measured channels do not distinguish {', '.join(alike)}", CURE
    )


def negative_dampers(solution: Solution, rebuild: Rebuild) -> list[str]:
    """A sentence if the channels ask for a negative damper."""
    errors = relative_errors(solution, rebuild)
    for name, value, error in zip(rebuild.names, solution.u, errors):
        is_sure = value < 0 and error < SETTINGS.sure_sign
        if name.endswith(": v") and is_sure:
            return [
                f"The channels ask for a negative {name}, which no passive storey has:"
                " the chain is another, or lacks a law."
            ]
    return []
