"""Gains and delays of sensors that were found before all effects were known, estimated once more beside them."""

from __future__ import annotations

from collections.abc import Sequence

from ..laws.sensor import ChannelDelay, GainError, SensorFault
from ..sites import Site
from .reestimate import reestimated
from .report import Step
from .rounds import Rounds
from .sensors import sharpened_again
from .stage import Stage

# A wrong zero has its own place.
_FAULTS: dict[str, SensorFault] = {law.name: law for law in (GainError(), ChannelDelay())}


def sharpen(rounds: Rounds) -> None:
    """Correct the records once more where that lowers the error, and put the interval of each fault into its step.

    Parameters
    ----------
    rounds : Rounds
        Changed in place.
    """
    stage = rounds.stage
    for step in _found_too_early(rounds.steps):
        stage = _sharper(rounds, stage, step)
    if stage is not rounds.stage:
        rounds.sharpened(stage)


def _found_too_early(steps: Sequence[Step]) -> list[Step]:
    last = max((k for k, step in enumerate(steps) if step.family != "sensor"), default=-1)
    return [step for step in steps[: last + 1] if step.law in _FAULTS]


def _sharper(rounds: Rounds, stage: Stage, step: Step) -> Stage:
    """The stage on records whose fault was estimated again beside all laws."""
    fault = _FAULTS[step.law].with_values([float(v or 0.0) for v in step.parameters.values()])
    found = sharpened_again(rounds.ready, rounds.work, stage, fault, Site(step.site))
    if found is None:
        return stage
    more, half = found
    assert isinstance(more.law, SensorFault) and more.ready is not None
    if more.screen < stage.trial().search_error():
        whole = fault.followed_by(more.law)
        step.parameters = whole.parameters
        step.evidence += f"; beside all laws of the model {whole.terms()[0].symbol} = {whole.values[0]:.4g}"
        stage = more.on(stage)
        rounds.ready, rounds.work = more.ready, stage.work
        stage = reestimated(stage, rounds.accepted)
    symbol, value = next((k, float(v or 0.0)) for k, v in step.parameters.items())
    step.intervals = {symbol: (value - half, value + half)}
    return stage


__all__ = ["sharpen"]
