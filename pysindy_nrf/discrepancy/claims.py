"""When nothing may be claimed."""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass

import numpy as np

from ..chain.model import ChainModel
from .heldout import JudgedModel


@dataclass(frozen=True)
class ClaimSettings:
    """When nothing is claimed."""

    # Percent of the force of a balance (64 % of its power) that a model may leave.
    hopeless: float = 80.0
    # An effect cancels a declared mass if a tenth of it is left.
    cancelled: float = 0.1
    # Percent of the motion by which a free run of the same size and of any phase misses
    # it: the square root of 2.
    unrelated: float = 141.4


CLAIMS = ClaimSettings()


def why_no_claim(judged: JudgedModel, reported: ChainModel) -> str:
    """Why nothing may be claimed of a model; empty if something may.

    Parameters
    ----------
    judged : JudgedModel
        As the search fitted it.
    reported : ChainModel
        As the final estimate gives it.
    """
    errors = judged.model.errors_within
    if np.nanmax(errors) >= CLAIMS.hopeless:
        worst = int(np.nanargmax(errors))
        return (
            f"the best model leaves {errors[worst]:.0f} % of the balance of DOF"
            f" {worst + 1}"
        )

    known = judged.model.spectra.data.known_masses
    wrong = wrong_masses(reported, known)
    if wrong:
        unit = reported.units.mass
        masses = ", ".join(f"m{j} = {mass:.3g} {unit}" for j, mass in wrong.items())
        return f"masses came out not positive ({masses})"

    total = reported.total_masses
    cancelled = []
    for j, mass in known.items():
        if mass > 0 and total[j - 1] <= CLAIMS.cancelled * mass:
            cancelled.append(str(j))
    if cancelled:
        return f"an effect cancels the declared mass of DOF {', '.join(cancelled)}"
    if np.isinf(judged.free_run_error):
        return "the free run of the best model diverges"
    if judged.free_run_error > CLAIMS.unrelated:
        missed = f"{judged.free_run_error:.0f} %"
        return f"the free run of the best model misses the motion by {missed}"
    return ""


def wrong_masses(model: ChainModel, known: Container[int]) -> dict[int, float]:
    """Masses that no structure has, of those that are not known, kg by DOF."""
    masses = enumerate(model.masses.tolist(), 1)
    return {j: mass for j, mass in masses if mass <= 0 and j not in known}
