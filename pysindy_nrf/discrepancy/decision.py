"""Effects with the models without and with them, judged."""

from __future__ import annotations

from dataclasses import dataclass
from math import log10

from ..laws.base import ForceLaw
from . import judge
from .effects import Effect
from .error_reduction import ErrorReduction
from .heldout import JudgedModel
from .judge import JUDGE


@dataclass(frozen=True)
class ConfirmationSettings:
    """What held-out data ask of an effect where floors have no sensor."""

    # Share of an error, in the search or held out, by which an effect must lower it.
    least_fall: float = 0.1

    @property
    def least_reduction(self) -> float:
        """The same fall of the error in the search, dB."""
        return -20 * log10(1 - self.least_fall)


CONFIRMATION = ConfirmationSettings()


@dataclass(frozen=True, eq=False)
class Decision:
    """An effect with the judged models without and with it.

    Attributes
    ----------
    effect : Effect
    before, after : JudgedModel
    confirmed : bool
    """

    effect: Effect
    before: JudgedModel
    after: JudgedModel
    confirmed: bool

    @property
    def heldout_reduction(self) -> ErrorReduction:
        """Error reduction on held-out data."""
        informative = self.before.model.spectra.bands.informative
        return ErrorReduction.between(
            self.before.heldout, self.after.heldout, informative
        )


def falls_on_heldout(law: ForceLaw, before: JudgedModel, after: JudgedModel) -> bool:
    """Whether the held-out error falls, and what is left by a tenth.

    There, or in the search.
    """
    limit = (1.0 - CONFIRMATION.least_fall) * before.error
    least = CONFIRMATION.least_reduction
    if after.error <= limit:
        least = JUDGE.least_reduction
    reduction = after.model.reduction_from(before.model)
    falls = after.error < before.error
    return falls and judge.is_there(reduction, law, least)
