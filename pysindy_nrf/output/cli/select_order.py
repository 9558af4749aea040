"""``pysindy-nrf select-order``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from .options import (
    Range,
    band_option,
    files_argument,
    json_option,
    mass_option,
    output_option,
    readings_of,
    record_options,
)
from .session import Session


@click.command("select-order", short_help="Find the order of the power series that the records support.")
@files_argument
@record_options
@click.option("--degrees", type=Range(), default="1-7", help="Total degrees to try: 1-7, or 1,3,5.")
@click.option("--box", "boxes", multiple=True, type=Range(), help="A box k,q to try as well: 1,3.")
@click.option("--folds", type=click.IntRange(2), default=5, help="Blocks in time, each judged by a fit to the others.")
@click.option(
    "--rule",
    type=click.Choice(["one_standard_error", "best"]),
    default="one_standard_error",
    help="The lowest order within one standard error of the best, or the best.",
)
@click.option(
    "--scoring",
    type=click.Choice(["balance", "acceleration", "free_run"]),
    default="balance",
    help="What is judged on held-out blocks.",
)
@mass_option
@band_option
@output_option
@click.option("--figures/--no-figures", default=True, help="Draw the error over the order (needs matplotlib).")
@json_option
def select_order(files: tuple[Path, ...], as_json: bool, **options: Any) -> None:
    """Find the order of the power series that the records support.

    All orders on all folds come from one pass over the samples. Scores are of held-out blocks.

    \b
    Examples
      pysindy-nrf select-order shaker.csv
      pysindy-nrf select-order shaker.csv --degrees 1-5 --box 1,3 --box 2,3 --band 0.5,40
    """
    from ...data.io import describe, summary, write_table
    from ...selection import select_order as run
    from .text import heading, table

    session = Session(as_json)
    readings = readings_of(files, options, session)
    session.say("What was measured\n-----------------")
    for reading in readings:
        session.say(describe(reading))
    records = [reading.record for reading in readings]
    boxes = [tuple(box) for box in options["boxes"]]
    bad = [box for box in boxes if len(box) != 2]
    if bad:
        raise click.UsageError(f"--box takes two numbers k,q, not {','.join(map(str, bad[0]))}.")
    with session.listening():
        for _ in session.progress([None], "orders"):
            found = run(
                records,
                degrees=options["degrees"],
                boxes=boxes or None,
                cv=options["folds"],
                rule=options["rule"],
                scoring=options["scoring"],
                known_masses=options["masses"] or None,
                band=options["band"],
            )
            listed = found.table
    session.say(heading("Orders (errors: percent NRMSE on held-out blocks)"))
    session.say(table(listed))
    kind = "box k,q" if isinstance(found.best_order, tuple) else "total degree"
    order = ",".join(map(str, found.best_order)) if isinstance(found.best_order, tuple) else found.best_order
    session.say(f"\nBest: {kind} {order} ({options['rule'].replace('_', ' ')}); "
                f"next: pysindy-nrf identify ... --degree {order}")  # fmt: skip
    most = _terms(found.best_order)
    by_storey = {site: value for site, value in found.orders_.items() if _terms(value) < most}
    for site, value in by_storey.items():
        shown = ",".join(map(str, value)) if isinstance(value, tuple) else value
        session.say(f"  {site} needs no more than {shown}: --order '{site}={shown}'")
    session.take_care()
    written = [write_table(listed, options["output"] / "orders.csv")]
    if options["figures"]:
        from ..displays import OrderSelectionDisplay
        from ..displays._matplotlib import save

        written += save(options["output"] / "orders.png", OrderSelectionDisplay.from_selection(found).figures())
    session.emit(
        {
            "records": [summary(rec) for rec in records],
            "best_order": found.best_order,
            "orders_by_storey": found.orders_,
            "table": listed,
        },
        written,
    )
    session.written(options["output"], written)


def _terms(order: Any) -> int:
    """Terms of a storey's power series."""
    if isinstance(order, tuple):
        return (order[0] + 1) * (order[1] + 1) - 1
    return (order + 1) * (order + 2) // 2 - 1
