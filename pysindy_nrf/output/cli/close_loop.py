"""``pysindy-nrf close-loop``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from .options import (
    Degree,
    band_option,
    files_argument,
    json_option,
    law_option,
    laws_of,
    mass_option,
    output_option,
    readings_of,
    record_options,
)
from .output import page
from .session import Session


@click.command("close-loop", short_help="Find the effects that a model lacks.")
@files_argument
@record_options
@click.option(
    "--heldout", multiple=True, type=click.Path(path_type=Path), help="A file that only the last line may see."
)
@click.option("--degree", type=Degree(), default=1, help="Total degree of the declared storeys, or box k,q.")
@law_option
@mass_option
@band_option
@click.option("--steps", type=click.IntRange(0), default=4, help="Effects at most.")
@click.option("--seed", type=int, default=0, help="Seed of the surrogates.")
@output_option
@json_option
def close_loop(files: tuple[Path, ...], as_json: bool, **options: Any) -> None:
    """Find the effects a model lacks, add them, and report the error before and after.

    FILE is read as by ``identify``. The last quarter of each record (or the files given with
    --heldout) is put aside until the last line.

    \b
    Examples
      pysindy-nrf close-loop shaker.csv --band 0.5,40
      pysindy-nrf close-loop DATA_EMPS.mat --map x1=qm --map F1='vir*35.1507' --map t=t --band 0,20
      pysindy-nrf close-loop quake.csv --map ag='table @ g' --known-mass 1=1 --known-mass 2=1 --known-mass 3=1
    """
    from ...data.io import describe
    from ...discrepancy import close_loop as run
    from ...estimation.regressor import NRFRegressor
    from .text import heading, table

    session = Session(as_json)
    baseline = NRFRegressor(
        degree=options["degree"],
        laws=laws_of(options["laws"], options["degree"]),
        known_masses=options["masses"] or None,
    )
    readings = readings_of(files, options, session)
    kept = readings_of(options["heldout"], options, session) if options["heldout"] else []
    session.say("What was measured\n-----------------")
    for reading in (*readings, *kept):
        session.say(describe(reading))
    with session.listening():
        report = run(
            [r.record for r in readings],
            baseline,
            heldout=[r.record for r in kept] or None,
            band=options["band"],
            random_state=options["seed"],
            max_steps=options["steps"],
            progress=not as_json,
        )
    session.say(heading("What was found"))
    session.say(str(report))
    session.say(heading("Errors, percent NRMSE (balance errors, but for the free run)"))
    session.say(table(report.table))
    session.say(heading("Model"))
    session.say(str(report.model))
    session.take_care()
    written = _write(report, options["output"])
    session.emit(_data(report), written)
    session.written(options["output"], written)
    for path in written:
        if path.suffix == ".html":
            session.say(f"Open {path} in a browser.")


def _write(report: Any, folder: Path) -> list[Path]:
    from ...common.files import atomic_write
    from ...data.io import write_table

    model, words = folder / "model.json", folder / "closed_loop.md"
    report.model.to_json(model)
    with atomic_write(words) as file:
        file.write(report.to_markdown())
    written = [model, words, write_table(report.table.rename_axis("model"), folder / "closed_loop.csv")]
    return written + page(lambda path: report.to_html(path), folder / "closed_loop.html")


def _data(report: Any) -> dict[str, Any]:
    return {
        "steps": [
            {
                "law": s.law,
                "family": s.family,
                "site": s.site,
                "parameters": s.parameters,
                "alternatives": s.alternatives,
                "error_before": s.error_before,
                "error_after": s.error_after,
                "remainder": s.remainder,
                "sentence": s.sentence,
            }
            for s in report.steps
        ],
        "table": report.table,
        "stopped_because": report.stopped_because,
        "model": report.model.to_dict(),
    }
