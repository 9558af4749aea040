"""``pysindy-nrf demo``."""

from __future__ import annotations

from pathlib import Path

import click

from .options import json_option, output_option


@click.command(short_help="Identify a bundled record of a shaken frame.")
@output_option
@json_option
def demo(output: Path, as_json: bool) -> None:
    """Identify a bundled record: a shaken three-storey frame whose ground storey hardens.

    Only floor 2 is forced and every channel carries 2 % noise. The record was simulated, so the
    truth is printed beside what was found. No network, a few seconds.
    """
    from ...data.io import describe, summary
    from ...datasets.demo import demo_truth, read_demo
    from ...estimation.regressor import NRFRegressor
    from .identify import say_plan
    from .session import Session
    from .work import identify_records

    session = Session(as_json)
    reading = read_demo()
    session.say("What was measured\n-----------------")
    session.say(describe(reading))
    estimator = NRFRegressor(degree=3)
    say_plan(session, 3, reading.record.forced, reading.record.unknown, {}, estimator)
    outcome = identify_records([reading.record], estimator, raw=False, progress=session.progress)
    session.finish(outcome, None, output, True, [summary(reading.record)], demo_truth(), page_of=[reading.record])
    session.say("\nNext: pysindy-nrf inspect YOUR_TEST.csv, then identify, then close-loop   (pysindy-nrf --help)")
