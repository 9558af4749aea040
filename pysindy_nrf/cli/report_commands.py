"""Commands around a test: ``plan`` it before, ``report`` on it afterwards."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict, Unpack

import click
import pandas as pd

from . import options as opt
from .parameters import FLOORS, PATH, Band
from .printing import table_text
from .session import Session

if TYPE_CHECKING:
    from ..chain.model import ChainModel

# Tests that are listed.
LISTED_TESTS = 10
# Bytes of the file of a result: far more than any has.
MAX_BYTES = 200_000_000


class PlanOptions(TypedDict):
    """Options of ``plan``."""

    links: tuple[str, ...]
    can_hit: list[int] | None
    sensors: list[int] | None
    unknown: list[int] | None
    masses: dict[int, float]
    max_hits: int
    model: Path | None


class ReportOptions(opt.RecordOptions):
    """Options of ``report``."""

    band: Band | None
    title: str | None
    output: Path


@click.command(short_help="Say which floor to hit, which sensor to add.")
@click.argument("floors", type=click.IntRange(1))
@opt.link_option
@click.option(
    "--can-hit",
    type=FLOORS,
    help="Floors that a hammer or shaker reaches: 1,3. All if left out.",
)
@click.option(
    "--sensors",
    type=FLOORS,
    help="Floors whose motion is measured: 1,2,4. All if left out.",
)
@click.option(
    "--unknown",
    type=FLOORS,
    help="Floors on which a force acts that is not measured.",
)
@opt.mass_option
@click.option(
    "--most", "max_hits", type=click.IntRange(1), default=2, help="Floors hit at most."
)
@click.option(
    "--model",
    type=PATH,
    help="A first guess (model.json): ranks floors by how modes respond.",
)
@opt.json_option
def plan(floors: int, as_json: bool, **options: Unpack[PlanOptions]) -> None:
    """Say which floor to hit, or which sensor to add, before a test of a structure with
    FLOORS floors.

    \b
    Examples
      pysindy-nrf plan 4
      pysindy-nrf plan 4 --can-hit 1,2 --sensors 1,2,4 --unknown 3
      pysindy-nrf plan 3 --model nrf_output/model.json
    """
    from ..chain.model import ChainModel
    from ..chain.structure import Chain

    session = Session(as_json)
    model = None
    if options["model"] is not None:
        model = ChainModel.from_json(options["model"])
        if model.n_dof != floors:
            raise click.UsageError(f"The model has {model.n_dof} floors, not {floors}.")
    test_plan = Chain(floors, options["links"]).plan(
        can_hit=options["can_hit"],
        sensors=options["sensors"],
        unknown=options["unknown"] or (),
        known_masses=options["masses"],
        model=model,
        max_floors=min(options["max_hits"], floors),
    )

    if test_plan.advice:
        session.say(*test_plan.advice)
    if len(test_plan.table):
        shown = _table_of_tests(test_plan.table, with_response=model is not None)
        session.headed("Tests, the best first", shown)
    tests = test_plan.table.to_dict("records")
    session.emit({"advice": test_plan.advice, "tests": tests})


def _table_of_tests(table: pd.DataFrame, with_response: bool) -> str:
    """The best tests in words."""
    best = table.head(LISTED_TESTS)
    shown = best.assign(
        hit=[" and ".join(map(str, floors)) for floors in best["hit"]],
        identifies=[f"{100 * share:.0f} %" for share in best["identifies"]],
        left=best["left"].replace("", "nothing"),
    )
    if not with_response:
        shown = shown.drop(columns="response")
    return table_text(shown.reset_index(drop=True))


@click.command(short_help="Write one page (HTML) of a result or of records.")
@opt.files_options
@opt.band_option
@click.option("--title", help="Title of the page.")
@opt.output("report.html", "File of the page.", single=True)
@opt.json_option
def report(
    files: tuple[Path, ...], as_json: bool, **options: Unpack[ReportOptions]
) -> None:
    """Write one page (HTML, works offline) of a result, over records.

    FILE is a result (model.json of identify, closed_loop.json of close-loop, what they
    print with --json) and files of records to draw with it. The band is that of the
    result if --band is left out.

    \b
    Examples
      pysindy-nrf report nrf_output/model.json shaker.csv --unit a=g -o frame.html
    """
    from ..common.files import atomic_write
    from ..report import as_html

    session = Session(as_json)
    result = _result_among(files)
    others = [path for path in files if path != result]
    readings = opt.readings_of(others, options, needed=False)
    records = [reading.record for reading in readings]
    title, output = options["title"], options["output"]
    with session.listening():
        model = _model_of(result)
        html = as_html(model, records or None, title=title, band=options["band"])

    with session.writing() as folder, atomic_write(folder / output.name) as file:
        file.write(html)
    names = [record.name for record in records]
    session.emit({"title": title, "records": names}, [output])
    session.say(f"Written: {output}   (open it in a browser)")


def _result_among(files: Sequence[Path]) -> Path:
    """The one result among files."""
    results = [path for path in files if path.suffix.lower() == ".json"]
    if len(results) != 1:
        raise click.UsageError(
            "report takes one result (.json); records are identified by run or identify"
            " first."
        )
    return results[0]


def _model_of(path: Path) -> ChainModel:
    """The model of a result file, which is one or holds one."""
    from ..chain.model import ChainModel
    from ..common.files import plain_json
    from ..records.files.table import check_file

    check_file(path, MAX_BYTES)
    inner = None
    # it holds no model; from_json says what is wrong
    with suppress(ValueError, RecursionError, AttributeError):
        inner = plain_json(path.read_text(encoding="utf-8")).get("model")
    return ChainModel.from_json(path if inner is None else json.dumps(inner))
