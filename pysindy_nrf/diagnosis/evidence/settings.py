"""Numbers of the diagnosis; it informs the page and decides nothing in the loop."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ResidualSettings:
    """Numbers that distinguish a missing force from noise."""

    # Samples looked at: enough to see any effect, and little beside a search.
    n_samples: int = 10_000
    # A residual within this factor of the noise floor is at the floor: from one draw of
    # noise the floor is known no better (battery, nothing hidden: 0.8 to 1.31).
    at_floor: float = 1.5
    # Share of the reference, in rms, that no measurement distinguishes from zero: 16
    # bits resolve 3e-5 of a range, ten times the rms.
    resolution: float = 1e-3
    # Shares of squares that differ by less are alike, and what explains less matters to
    # nobody: two standard errors of a share over 25 blocks (1 to 3 points on forces of
    # known kind with 5 % noise).
    alike: float = 0.04
    # Standard errors beyond which a share is sure (95 %).
    sure_errors: float = 2.0
    # Share of a force that a kind of dependence must explain to be named; also by which
    # a jump or a kink must improve on a smooth function, and the odd or even part of a
    # force that is next to nothing.
    least_share: float = 0.1
    # Odd share of a force from which on it hardens or softens.
    mostly_odd: float = 0.5


RESIDUAL = ResidualSettings()
