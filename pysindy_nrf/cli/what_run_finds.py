"""What ``run`` finds where power series do not close the equations of motion."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from . import options as opt
from .printing import paragraphs
from .session import warned, working

if TYPE_CHECKING:
    from ..records.record import Record

# Samples times floors up to which the search is tried at once: a quarter of a minute.
TRIED_AT_ONCE = 60_000
_ADVICE = (
    "pysindy-nrf run, with the same files and channels, looks for the law that is"
    " missing, and writes its page."
)


def what_run_finds(records: Sequence[Record], options: opt.ModelOptions) -> str:
    """The verdict of a search for one effect, or where to find it for long records.

    Parameters
    ----------
    records : sequence of Record
    options : ModelOptions
        Of the running command: known masses and band.
    """
    from ..discrepancy import close_loop
    from ..exceptions import NRFError
    from ..identification.regressor import NRFRegressor

    size = sum(record.n_samples * record.n_dof for record in records)
    if size > TRIED_AT_ONCE:
        return paragraphs([_ADVICE], "")
    baseline = NRFRegressor(degree=1, known_masses=options["masses"] or None)
    try:
        with warned(), working("what run finds") as tick:
            report = close_loop(
                list(records),
                baseline,
                band=options["band"],
                max_steps=1,
                random_state=0,
                progress=tick,
            )
    except NRFError as error:
        return paragraphs([f"The search cannot be done: {error}"], "")
    verdict = report.verdict
    sentence = f"{verdict.state.upper()}: {verdict.sentence}"
    return paragraphs([sentence, _ADVICE], "")
