"""Balances that contradict each other: a force in other units, of the wrong sign or in the wrong column, a wrong mass.

Under complete excitation each storey is found twice, once from the balance of either end. Each balance may fit its own
copy to the last digit while the two copies differ: with the force of DOF j k-fold, the balance of DOF j holds with
masses and laws that are all k-fold.
"""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from ..chain_solve import StepFit
from ..sites import Site

# Percent of a balance that the law found by the other end leaves, and how many times what its own law leaves.
_MUCH, _TIMES = 10.0, 3.0


def contradictions_of(errors: pd.DataFrame, gap: pd.Series, fits: Sequence[StepFit]) -> list[str]:
    """Sentences on storeys and links that two balances find unlike each other.

    Parameters
    ----------
    errors : DataFrame
        Of :func:`pysindy_nrf.errors.balance_errors`.
    gap : Series
        Difference of the two estimates of each site, percent, by its name.
    fits : sequence of StepFit
        Of the solve; what each balance leaves with its own estimates.

    Returns
    -------
    list of str
        One sentence, or none.

    Examples
    --------
    >>> import warnings
    >>> from pysindy_nrf import ChainModel, NRFRegressor, excitation, laws, simulate
    >>> truth = ChainModel([5.0, 4.0, 3.0], dict.fromkeys((1, 2, 3), laws.PowerSeries(1, [20.0, 4e4])))
    >>> F = excitation.band_limited_random(3, 8.0, 500.0, dofs=[1, 2, 3], rms=40.0, band=(1, 40), random_state=0)
    >>> record = simulate(truth, F, 0.002, hold="cubic")
    >>> pounds = record.force / [1.0, 4.448, 1.0]
    >>> with warnings.catch_warnings():
    ...     warnings.simplefilter("ignore")
    ...     model = NRFRegressor(degree=1).fit(record.replace(force=pounds))
    >>> model.doubts_["forces"][0].split(":")[1].split(",")[0]
    ' storey 2 and storey 3 are found twice'
    """
    own = {fit.step.dofs[0]: fit.residual for fit in fits if len(fit.step.dofs) == 1}
    hit = []
    for name in gap.index:
        site = Site(name)
        row = f"dof {site.q}"
        if row not in errors.index or site.q not in own:
            continue
        error, residual = errors.loc[row, "error"], errors.loc[row, "residual"]
        if error > _MUCH and residual > _TIMES * own[site.q]:
            hit.append((site, float(error), float(error * own[site.q] / residual)))
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
