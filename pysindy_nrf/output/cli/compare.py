"""``pysindy-nrf compare``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from .options import json_option, output_option, readings_of, record_options
from .session import Session


@click.command(short_help="Plain SINDy and this package on the same record.")
@click.argument("file", required=False, type=click.Path(path_type=Path))
@record_options
@click.option("--degree", type=click.IntRange(1), default=3, help="Total degree of the power series everywhere.")
@click.option("--heldout", type=float, default=0.3, help="Share of the record at its end on which all are judged.")
@click.option(
    "--truth", type=click.Path(path_type=Path), help="The structure, if it is known: a model.json. Judges the terms."
)
@click.option("--time-limit", type=float, default=10.0, help="Seconds after which a free run of SINDy is given up.")
@output_option
@json_option
def compare(file: Path | None, as_json: bool, **options: Any) -> None:
    """Fit plain SINDy and this package to the same record and judge both on its end.

    FILE is one record on a base at rest; every force is known.

    \b
    Examples
      pysindy-nrf compare shaker.csv
      pysindy-nrf compare simulated.parquet --truth model.json
    """
    from ...data.io import describe, summary, write_table
    from ...regression.chain_model import ChainModel
    from ...selection.comparison import compare_with_sindy
    from .text import heading, table

    session = Session(as_json)
    readings = readings_of([file] if file else [], options, session)
    if len(readings) != 1:
        raise click.UsageError("compare takes one record.")
    session.say("What was measured\n-----------------")
    session.say(describe(readings[0]))
    truth = None if options["truth"] is None else ChainModel.from_json(options["truth"])
    with session.listening():
        for _ in session.progress([None], "SINDy and this package"):
            found = compare_with_sindy(
                readings[0].record,
                truth=truth,
                degree=options["degree"],
                heldout=options["heldout"],
                time_limit=options["time_limit"],
            )
    session.say(heading(f"On the last {100 * options['heldout']:g} % of the record (errors: percent NRMSE)"))
    shown = found.drop(columns=[c for c in found if found[c].isna().all()])
    session.say(table(shown.drop(columns="note")))
    for name, note in found["note"].items():
        if note:
            session.say(f"  {name}: {note}")
    session.take_care()
    written = [write_table(found, options["output"] / "comparison.csv")]
    session.emit({"record": summary(readings[0].record), "table": found}, written)
    session.written(options["output"], written)
