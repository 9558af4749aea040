"""``pysindy-nrf report``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from ...exceptions import FileFormatError
from .options import Degree, band_option, files_argument, json_option, mass_option, readings_of, record_options
from .session import Session


@click.command(short_help="Write one page (HTML) of a result or of records.")
@files_argument
@record_options
@click.option("--degree", type=Degree(), default=3, help="Without a result: total degree of the power series, or k,q.")
@mass_option
@band_option
@click.option("--title", help="Title of the page.")
@click.option(
    "--output",
    "-o",
    type=click.Path(path_type=Path, dir_okay=False),
    default=Path("report.html"),
    help="File of the page.",
)
@json_option
def report(files: tuple[Path, ...], as_json: bool, **options: Any) -> None:
    """Write one page (HTML, works offline) of a result, of records, or of both.

    FILE is a result - the model.json of identify or close-loop, or what they print with --json -, and files of
    records to draw beside it. Records alone are identified first, as by identify, with --degree and --known-mass.
    The band is that of the result if --band is left out.

    \b
    Examples
      pysindy-nrf report nrf_output/model.json shaker.csv --unit a=g -o frame.html
      pysindy-nrf report shaker.csv --band 0.5,40
    """
    from ..report import write_html

    session = Session(as_json)
    results = [path for path in files if path.suffix.lower() == ".json"]
    if len(results) > 1:
        raise click.UsageError("report takes one result (.json).")
    measured = [path for path in files if path not in results]
    readings = readings_of(measured, options, session, needed=not results)
    records = [reading.record for reading in readings]
    with session.listening():
        subject = _result(results[0]) if results else _identified(records, options, session)
        for _ in session.progress([None], "page"):
            write_html(
                options["output"],
                subject,
                records or None,
                title=options["title"],
                notes=tuple(session.warnings),
                band=options["band"],
            )
    session.take_care()
    session.emit({"title": options["title"], "records": [rec.name for rec in records]}, [options["output"]])
    session.say(f"Written: {options['output']}   (open it in a browser)")


def _result(path: Path) -> Any:
    """The model of a result file."""
    import json

    from ...common.files import plain_json
    from ...data.io.table import check_file
    from ...regression.chain_model import ChainModel

    check_file(path, 200_000_000)
    try:
        data = plain_json(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise FileFormatError(f"{path} is not JSON: {error}", "Give a model.json, or what --json printed.") from error
    inner = data.get("model", data) if isinstance(data, dict) else data
    if not isinstance(inner, dict):
        raise FileFormatError(f"{path} holds no model", "Give a model.json, or what identify --json printed.")
    return ChainModel.from_json(json.dumps(inner))


def _identified(records: list[Any], options: dict[str, Any], session: Session) -> Any:
    from ...estimation.regressor import NRFRegressor

    estimator = NRFRegressor(
        degree=options["degree"],
        known_masses=options["masses"] or None,
        band=options["band"],
    )
    with session.listening():
        for _ in session.progress([None], "identifying"):
            estimator.fit(records)
    return estimator
