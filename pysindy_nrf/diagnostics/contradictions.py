"""Balances that contradict each other: a force in other units, of the wrong sign or in the wrong column, a wrong mass.

Under complete excitation each storey is found twice, once from the balance of either end. Each balance may fit its own
copy to the last digit while the two copies differ: with the force of DOF j k-fold, the balance of DOF j holds with
masses and laws that are all k-fold.
"""

from __future__ import annotations

import numpy as np

from ..regression.chain_solve import Solution
from ..regression.errors import balance_sizes
from ..regression.grams import BlockGrams

# Percent of a balance that the law found by the other end leaves, and how many times what its own law leaves.
_MUCH, _TIMES = 10.0, 3.0


def contradictions_of(solution: Solution, grams: BlockGrams) -> list[str]:
    """Sentences on storeys and links that two balances find unlike each other."""
    hit = []
    for site in sorted(solution.twins, key=str):
        own = {s: twin if s.q == site.q else solution.coefficients[s] for s, twin in solution.twins.items()}
        error, alone = (
            _percent(site.q, solution, coefficients, grams)
            for coefficients in (solution.coefficients, solution.coefficients | own)
        )
        if error > max(_MUCH, _TIMES * alone):
            hit.append((site, error, alone))
    if not hit:
        return []
    site, error, alone = max(hit, key=lambda found: found[1])
    shared = set.intersection(*({s.p, s.q} for s, _, _ in hit))
    if len(hit) > 1 and len(shared) == 1:
        whose = f"DOF {shared.pop()}, where all of them meet,"
    else:
        whose = "one of DOF " + ", ".join(map(str, sorted({j for s, _, _ in hit for j in (s.p, s.q)})))
    is_are = "are" if len(hit) > 1 else "is"
    names = " and ".join(str(s) for s, _, _ in hit)
    return [
        f"Balances contradict each other: {names} {is_are} found twice, and unlike each other. "
        f"The balance of DOF {site.q} is {error:.0f} % off with the law of {site} that the balance of DOF {site.p} "
        f"finds, {alone:.2g} % with its own. Is the force (its unit, gain, sign, channel) or the known mass of "
        f"{whose} wrong? Otherwise noise or a missing law biases one of them."
    ]


def _percent(j: int, solution: Solution, coefficients: dict, grams: BlockGrams) -> float:
    """Balance error of a DOF, percent NRMSE; NaN where its force is unknown."""
    sizes = balance_sizes(j, solution.masses, coefficients, grams)
    return 100.0 * sizes.residual / sizes.reference if sizes is not None and sizes.reference else np.nan
