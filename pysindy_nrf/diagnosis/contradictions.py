"""Storeys that two equations of motion find unlike each other."""

from collections.abc import Sequence

from ..chain.sites import Site
from ..equations.chain_solve import Solution


def contradictions_of(solution: Solution) -> list[str]:
    """A sentence on storeys and links that two equations find unlike each other.

    Under complete excitation the law of a storey follows from the equation of either
    floor.
    """
    solution = solution.alone or solution
    fits = {fit.step.dofs[0]: fit for fit in solution.fits if fit.contradicts}
    sites = [site for site in sorted(solution.twins, key=str) if site.q in fits]
    if not sites:
        return []

    worst = max(sites, key=lambda site: fits[site.q].crossed)
    fit = fits[worst.q]
    names = " and ".join(map(str, sites))
    is_are = "are" if len(sites) > 1 else "is"
    return [
        f"Balances contradict each other: {names} {is_are} found twice, and unlike each"
        f" other. The balance of DOF {worst.q} is {100 * fit.crossed:.0f} % off with"
        f" the law of {worst} that the balance of DOF {worst.p} finds,"
        f" {100 * fit.share:.2g} % with its own. Is the force (its unit, gain, sign,"
        f" channel) or the known mass of {_suspects(sites)} wrong? Otherwise noise or a"
        " missing law biases one of them."
    ]


def _suspects(sites: Sequence[Site]) -> str:
    """The DOF at which all of some links meet; all their ends if there is none."""
    ends = [{site.p, site.q} for site in sites]
    shared = set.intersection(*ends)
    if len(sites) > 1 and len(shared) == 1:
        return f"DOF {shared.pop()}, where all of them meet,"
    dofs = sorted(set.union(*ends))
    return "one of DOF " + ", ".join(map(str, dofs))
