"""The judge: is an effect there, does it matter, which names are as good."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ..chain.sites import Site
from ..equations.normal_equations import variance
from ..laws.base import ForceLaw
from .effects import Effect, Finding, RankedFinding, SearchState
from .error_reduction import REDUCTION, ErrorReduction
from .fitted_model import FittedModel


@dataclass(frozen=True)
class JudgeSettings:
    """What is asked of an effect."""

    # Least error reduction, dB. Where nothing is missing the best of all candidates
    # comes to 0.1 dB at most; effects of the battery to 1.1 dB and more at 5 % noise.
    least_reduction: float = 0.5
    # The same without the fold that contributes most, dB.
    least_without_fold: float = 0.25
    # Error reduction that channels of few floors must show, dB: a fifth of what is
    # left.
    large_reduction: float = 2.0
    # Findings are tied within a standard error, and the simplest is taken if it loses
    # at most a tenth of the best.
    loss_of_simplest: float = 0.1


JUDGE = JudgeSettings()


# -- is it there, does it matter -----------------------------------------------


def is_there(
    reduction: ErrorReduction,
    law: ForceLaw | None = None,
    least: float = JUDGE.least_reduction,
) -> bool:
    """Whether an error reduction of some size stands whichever fold is left out.

    That of a force in one band is asked for where it acts.
    """
    value, without_fold = reduction.value, reduction.least
    if law is not None and law.narrow_band and value > 0:
        value, without_fold = reduction.where_it_acts, reduction.least_where_it_acts
    return value >= least and without_fold >= JUDGE.least_without_fold


def differs_from_zero(model: FittedModel, effect: Effect) -> bool:
    """Whether a coefficient of the last law at a site is known to two standard errors.

    From fold to fold.
    """
    stop = model.layout.slices[effect.site].stop
    start = stop - len(effect.law.terms())
    values = model.coefficients[:, start:stop]
    errors = np.sqrt(variance(values[1:]))
    return bool((np.abs(values[0]) > REDUCTION.sure_errors * errors).any())


def takes_over(finding: Finding, shares: dict[Site, float]) -> bool:
    """Whether a law at a site without laws takes more force than the storey there."""
    laws = finding.before.model.laws
    return any(share > 1 and not laws.get(site) for site, share in shares.items())


def reduction_over(finding: Finding, state: SearchState) -> ErrorReduction | None:
    """Error reduction of a finding over a state, whatever effects it replaces."""
    if finding.after is None:
        return None
    return finding.after.model.reduction_from(state.model)


# -- shares of the force -------------------------------------------------------


def share_of_force(model: FittedModel, without: FittedModel, site: Site) -> float:
    """Rms of what an effect changes of the force at its site, over that of the storey.

    In the informative bands.
    """
    rows = model.layout.slices[site]
    storey_rows = model.layout.slices.get(Site(site.p), rows)
    products = _products_of_balance(model, site)

    after = np.zeros(len(products))
    after[rows] = model.coefficients[0, rows]
    storey = after.copy()
    storey[storey_rows] = model.coefficients[0, storey_rows]
    change = after - _coefficients_without(model, without, site)

    changed = max(float(change @ products @ change), 0.0)
    total = max(float(storey @ products @ storey), 0.0)
    return float(np.sqrt(changed / total)) if total > 0 else 1.0


def _products_of_balance(model: FittedModel, site: Site) -> np.ndarray:
    """Products over the informative bands of the balance of a site."""
    informative = model.spectra.bands.informative
    bands = informative[min(site.p, len(informative)) - 1]
    return (model.products * bands[None, :, None, None]).sum(axis=(0, 1))


def _coefficients_without(
    model: FittedModel, without: FittedModel, site: Site
) -> np.ndarray:
    """Coefficients of the laws at a site that another model shares; zero elsewhere."""
    out = np.zeros(model.products.shape[-1])
    column = model.layout.slices[site].start
    other = without.layout.slices.get(site, slice(column, column)).start
    remaining = list(without.laws.get(site, ()))

    for law in model.laws[site]:
        width = len(law.terms())
        if law in remaining:
            remaining.remove(law)
            values = without.coefficients[0, other : other + width]
            out[column : column + width] = values
            other += width
        column += width
    return out


def shares_of_force(finding: Finding, state: SearchState) -> dict[Site, float]:
    """Share of the force that an effect changes at each of its sites.

    That of a new tie is taken of the storey below it.
    """
    assert finding.after is not None
    model, before = finding.after.model, finding.before.model
    shares = {}
    for effect in finding.new_effects(state.effects):
        shares[effect.site] = share_of_force(model, before, effect.site)
    return shares


# -- which names are as good ---------------------------------------------------


def ranked(findings: Iterable[Finding], state: SearchState) -> list[RankedFinding]:
    """Findings with their error reduction over a state, the best first."""
    out = []
    for finding in findings:
        reduction = reduction_over(finding, state)
        if reduction is not None:
            out.append(RankedFinding(finding, reduction))
    return sorted(out, key=lambda finding: -finding.reduction.value)


def _tied(
    findings: Sequence[RankedFinding], number: int, limit: float = np.inf
) -> list[int]:
    """Numbers of the findings within a standard error of one of them.

    And within a limit, dB.
    """
    reference = findings[number].reduction
    as_good = []
    for k, other in enumerate(findings):
        difference = reference.without_fold - other.reduction.without_fold
        error = float(np.sqrt(variance(difference)))
        reach = min(max(error, JUDGE.least_reduction), limit)
        if reference.value - other.reduction.value <= reach:
            as_good.append(k)
    return as_good


def is_better(name: Finding, other: Finding, least: float, errors: float) -> bool:
    """Whether a finding is better than another that is added to the same state.

    By so many dB, and by more than so many standard errors of the difference, on
    left-out folds.
    """
    if name.reduction is None or other.reduction is None:
        return False
    lead = name.value - other.value
    lead_without_fold = name.reduction.without_fold - other.reduction.without_fold
    error = float(np.sqrt(variance(lead_without_fold)))
    return lead >= least and lead > errors * error


def simplest(findings: Sequence[RankedFinding]) -> int:
    """Number of the simplest finding within a standard error of the best.

    It loses a tenth of the best at most; linear ones come first.
    """
    limit = JUDGE.loss_of_simplest * findings[0].reduction.value

    def size(k: int) -> tuple[tuple[int, int], float]:
        return findings[k].finding.n_parameters, -findings[k].reduction.value

    return min(_tied(findings, 0, limit), key=size)


def rivals(findings: Sequence[RankedFinding], number: int) -> list[Finding]:
    """Findings that explain the data as well as one of them."""
    return [findings[k].finding for k in _tied(findings, number) if k != number]
