"""Signs that an undeclared effect may have, and those of the laws next to it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ..chain.sites import Site
from ..laws.base import ForceLaw
from .fitted_model import FittedModel
from .model_extension import Extensions


@dataclass(frozen=True)
class SignSettings:
    """When a sign is wrong."""

    # A wrong sign counts from a tenth of the largest force of the law: what is an order
    # of magnitude less than its counterpart is next to nothing.
    wrong_share: float = 0.1


SIGNS = SignSettings()


def wrong_sign_limit(forces: np.ndarray) -> np.ndarray:
    """Negative force from which on a sign is wrong, (n_points, 1)."""
    return -SIGNS.wrong_share * np.abs(forces).max(axis=1, keepdims=True)


def has_admissible_signs(law: ForceLaw, forces: np.ndarray) -> np.ndarray:
    """Where forces of the terms of a law, (n_points, n_terms), can be real.

    None that cannot be negative is clearly negative.
    """
    nonnegative = [term.symbol in law.nonnegative for term in law.terms()]
    right = forces[:, nonnegative] >= wrong_sign_limit(forces)
    return np.all(right, axis=1)


def admissible_reductions(
    extensions: Extensions, laws: Sequence[ForceLaw]
) -> np.ndarray:
    """Error reductions of laws, minus infinity where their signs cannot be real.

    ``laws`` are those of any point.
    """
    forces = extensions.forces
    limit = wrong_sign_limit(forces)
    possible = (extensions.passive_forces >= limit).all(axis=1)

    column = 0
    for law in laws:
        width = len(law.terms())
        possible &= has_admissible_signs(law, forces[:, column : column + width])
        column += width
    return np.where(possible, extensions.reductions, -np.inf)


def turns_a_passive_term(
    after: FittedModel, before: FittedModel, sites: Iterable[Site], has_memory: bool
) -> bool:
    """Whether laws that were added turn a spring or dashpot next to them negative.

    By more than a tenth of their force.
    """
    squares = np.einsum("kii->i", after.summed)[: after.first_fixed]
    forces = after.coefficients[0, : after.first_fixed] * np.sqrt(squares)

    for site in sites:
        start = after.layout.slices[site].start
        at_site = slice(start, after.layout.slices[site].stop)
        place = before.layout.slices.get(site, slice(0, 0))
        columns, least = before.passive_terms([site], has_memory)
        # the columns of a site begin with those that it had before
        columns = columns - place.start + start
        excess = forces[columns] - least * np.sqrt(squares[columns])
        added = forces[at_site][place.stop - place.start :]
        if (excess < -SIGNS.wrong_share * np.abs(added).max()).any():
            return True
    return False
