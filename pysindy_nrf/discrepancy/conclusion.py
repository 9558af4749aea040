"""The end of the search: what is estimated from all effects together, what is sure, and what is to be said."""

from __future__ import annotations

from typing import Any

from ..mechanics.sites import Site
from . import words
from .away_from_rest import share_to_leave
from .catalogue import balances_of
from .contradictions import contradictions
from .report import LoopReport
from .rounds import Rounds
from .standing import doubt_what_is_drawn, estimate, wrong_by_noise
from .steps import doubt_names, improper, worst
from .surrogate import Null


def settle(rounds: Rounds) -> None:
    """Estimate all effects of rounds that have come to their end together, and say which are not sure."""
    stage, null = rounds.stage, rounds.null
    standing = rounds.standing()
    away = share_to_leave(stage) if standing else None
    fitted = null if away is None else Null(rounds.ready, stage, rounds.rng, rounds.n_surrogates, away=away)
    rounds.scenes[-1].found, rounds.fitted = estimate(standing, stage, fitted), fitted
    doubt_what_is_drawn(standing, stage, null, rounds.ready.clean)


def concluded(rounds: Rounds, band: Any) -> LoopReport:
    """The report of settled rounds; the held-out data are read here."""
    steps, stage, stopped = rounds.steps, rounds.stage, rounds.stopped
    for k in reversed(range(len(steps))):  # what later had to be added at its site was not said by its name
        later = [s for s in steps[k + 1 :] if balances_of(Site(s.site)) == balances_of(Site(steps[k].site))]
        doubtful = improper(steps[k].law, steps[k].intervals) or not all(s.sure for s in later)
        steps[k].sure = steps[k].sure and not doubtful
    doubt_names(steps)
    if rounds.unexplained:
        alone = f"(noise alone leaves about {rounds.floor:.2g} %)"
        stopped += f". {rounds.left:.3g} % stay unexplained by any law of the catalogue {alone}, "
        stopped += f"most in the {worst(rounds.trial)}"
    if rounds.null.stages and (much := wrong_by_noise(rounds.standing(), stage, rounds.fitted, rounds.ready)):
        stopped += f". By noise alone least squares is wrong by up to {', '.join(much)}: fit "
        stopped += "NRFRegressor(laws=report.model.laws, estimation='iv', ...) to the records, which noise does "
        stopped += "not bias"
    if rounds.sensors and (found := contradictions(rounds.ready, rounds.work)):
        stopped += f". {words.contradictions(found)}"
    return LoopReport.assemble(rounds.work, rounds.scenes, steps, stopped, rounds.ranking, band, rounds.measured)


__all__ = ["concluded", "settle"]
