"""``pysindy-nrf inspect``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from ...exceptions import MissingExtraError, NRFError
from .options import files_argument, json_option, readings_of, record_options
from .session import Session


@click.command(short_help="Say what a file holds and how it was understood.")
@files_argument
@record_options
@json_option
def inspect(files: tuple[Path, ...], as_json: bool, **options: Any) -> None:
    """Say what a file holds and how it was understood. Nothing is solved, nothing is written.

    For each FILE: clock, channels with their size in SI units and where each came from, columns that were not
    used, and what looks wrong (units, signs and delays that contradict each other; dead, clipped, spiky channels).

    \b
    Examples
      pysindy-nrf inspect shaker.csv
      pysindy-nrf inspect shaker.csv --map F2='Shaker @ kN' --unit a=g --unit x=mm
      pysindy-nrf inspect --mapping campaign.toml
    """
    from ...data.io import describe, summary
    from ...signals.channel_checks import data_warnings

    session = Session(as_json)
    out = []
    try:
        readings = readings_of(files, options, session)
    except NRFError:
        _say_contents(session, files)
        raise
    for reading in readings:
        with session.listening():
            findings = data_warnings(reading.record)
        session.say(describe(reading))
        for one in findings:
            session.say(f"  take care: {one}")
        if not findings:
            session.say("  nothing looks wrong")
        session.say("")
        sources = {name: {"from": source.text, "unit": source.unit} for name, source in reading.sources.items()}
        out.append(
            summary(reading.record)
            | {
                "file": str(reading.table.path),
                "kind": reading.table.kind,
                "notes": reading.table.notes,
                "clock": reading.clock,
                "sources": sources,
                "not_used": list(reading.unused),
                "doubts": findings,
            }
        )
    session.emit({"records": out})


def _say_contents(session: Session, files: tuple[Path, ...]) -> None:
    """The columns of a file that could not be understood as a record, so that they can be mapped."""
    from ...data.io import read_table
    from ...data.io.summary import contents

    for path in files[:1]:
        try:
            session.say(contents(read_table(path)) + "\n")
        except (NRFError, MissingExtraError):
            return
