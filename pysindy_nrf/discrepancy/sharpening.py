"""Gains and delays of sensors, estimated once more beside all effects that are known."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..laws.sensor import SensorFault
from ..mechanics.sites import Site
from .reestimate import reestimated
from .report import Step
from .sensors import sharpened_again
from .stage import Stage

if TYPE_CHECKING:
    from .rounds import Rounds


def sharpen(rounds: Rounds) -> None:
    """Correct the records once more where that lowers the error, and put the interval of each fault into its step."""
    if all(step.is_fault for step in rounds.steps):
        return
    faults = {law.name: law for law in rounds.sensors if law.acts_on_derivatives}  # a wrong zero has its own place
    stage = rounds.stage
    for step in rounds.steps:
        if step.law in faults:
            stage = _sharper(rounds, stage, step, faults[step.law])
    if stage is not rounds.stage:
        rounds.sharpened(stage)


def _sharper(rounds: Rounds, stage: Stage, step: Step, fault: SensorFault) -> Stage:
    """The stage on records whose fault was estimated again beside all laws."""
    fault = fault.with_values([float(v or 0.0) for v in step.parameters.values()])
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
