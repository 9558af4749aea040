"""Where the effects that were found leave much open: the search once more, begun at another place.

The first effect is chosen while all others are still missing. What two effects do together, a third law may imitate
at a place between theirs, or a wrong gain of the force that acts there; the rounds that follow then mend what is no
effect, and end with much unexplained. Rounds that begin elsewhere see the same search data and pass the same gate, one
effect after another; they are kept where they explain clearly more.
"""

from __future__ import annotations

from .conclusion import settle
from .rounds import Rounds
from .stage import Stage

# Further beginnings that are tried.
_MORE = 2


def explored(rounds: Rounds, stage: Stage, max_steps: int) -> Rounds:
    """Rounds to their end, and those of other beginnings where they explain clearly more."""
    rounds.go(stage, max_steps)
    settle(rounds)
    best = last = rounds
    for _ in range(_MORE):
        if not best.doubtful or last.begun is None:
            break
        last = last.elsewhere()
        last.go(stage, max_steps)
        if not (last.steps and last.instead_of(best).accepted):
            continue
        other = last.in_earnest()
        other.go(stage, max_steps)
        if other.steps and other.instead_of(best).accepted:
            settle(other)
            first = f"{best.steps[0].law} at {best.steps[0].site}"
            said = f"all effects that begin with {first} leave {best.left:.3g} %, these {other.left:.3g} %"
            other.steps[0].evidence += f"; {said}"
            best = other
    return best


__all__ = ["explored"]
