"""Commands that compare models: ``select-order`` and ``compare``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Unpack

import click

from . import options as opt
from .exit_codes import code_of_verdict
from .parameters import PATH, RANGE, Band, Degree
from .printing import table_text, verdict_data, verdict_text
from .session import Session

if TYPE_CHECKING:
    import pandas as pd

    from ..diagnosis.verdict import Verdict
    from ..records.record import Record
    from ..report.results_page import ResultsPage
    from ..selection.selection import OrderSelection


class OrderOptions(opt.RecordOptions):
    """Options of ``select-order``."""

    degrees: list[int]
    boxes: tuple[list[int], ...]
    folds: int
    rule: str
    scoring: str
    masses: dict[int, float]
    band: Band | None
    output: Path
    figures: bool


class ComparisonOptions(opt.RecordOptions):
    """Options of ``compare``."""

    degree: int
    heldout: float
    truth: Path | None
    time_limit: float
    output: Path


@click.command(
    "select-order",
    short_help="Find the order of the power series that the records support.",
)
@opt.files_options
@click.option(
    "--degrees", type=RANGE, default="1-7", help="Total degrees to try: 1-7, or 1,3,5."
)
@click.option(
    "--box",
    "boxes",
    multiple=True,
    type=RANGE,
    help="A box k,q to try as well: 1,3.",
)
@click.option(
    "--folds",
    type=click.IntRange(2),
    default=5,
    help="Blocks in time, each judged by a fit to the others.",
)
@opt.choice(
    "--rule",
    ["one_standard_error", "best"],
    "The lowest order within one standard error of the best, or the best.",
    "one_standard_error",
)
@opt.choice(
    "--scoring",
    ["balance", "acceleration", "free_run"],
    "What is judged on held-out blocks.",
    "balance",
)
@opt.mass_option
@opt.band_option
@opt.output_option
@click.option(
    "--figures/--no-figures",
    default=True,
    help="Draw the error over the order (needs matplotlib).",
)
@opt.json_option
def select_order(
    files: tuple[Path, ...], as_json: bool, **options: Unpack[OrderOptions]
) -> None:
    """Find the order of the power series that the records support.

    All orders on all folds come from one pass over the samples. Scores are of held-out
    blocks.

    \b
    Examples
      pysindy-nrf select-order shaker.csv
      pysindy-nrf select-order shaker.csv --degrees 1-5 --box 1,3 --box 2,3
    """
    from ..drawing.matplotlib_renderer import save
    from ..records.files import write_table
    from ..records.files.summary import summary
    from ..selection import select_order as selected_order

    session = Session(as_json)
    records = opt.records_of(session, options, files)
    boxes = [tuple(box) for box in options["boxes"]]
    for box in boxes:
        if len(box) != 2:
            shown = _as_option(box)
            raise click.UsageError(f"--box takes two numbers k,q, not {shown}.")

    with session.listening():
        selection = selected_order(
            records,
            degrees=options["degrees"],
            boxes=boxes or None,
            cv=options["folds"],
            rule=options["rule"],
            scoring=options["scoring"],
            known_masses=options["masses"] or None,
            band=options["band"],
        )
        table = selection.table
        biased = selection.regressor().fit(records).missing_terms_["biased"]

    _conclude(session, selection)
    if biased.any():
        places = " and ".join(map(str, biased.index[biased.astype(bool)]))
        session.conclude(
            f"\nNo order closes the {places}: a law is missing there that is no power"
            " series (friction, hysteresis, a gap), or the motion is noisy. pysindy-nrf"
            " run, with the same files and channels, looks for it."
        )
    with session.writing() as folder:
        written = [write_table(table, folder / "orders.csv")]
        if options["figures"]:
            written += save(folder / "orders.png", [selection.figure()])
    data = {
        "records": [summary(record) for record in records],
        "best_order": selection.best_order,
        "orders_by_storey": selection.orders_,
        "table": table,
    }
    session.finish(data, written)


def _conclude(session: Session, selection: OrderSelection) -> None:
    """The orders, the best one, and the storeys that need less."""
    from ..laws.power_series import exponents_of

    title = "Orders (errors: percent NRMSE on held-out blocks)"
    session.conclude_headed(title, table_text(selection.table))
    kind = "box k,q" if isinstance(selection.best_order, tuple) else "total degree"
    order = _as_option(selection.best_order)
    rule = selection.rule.replace("_", " ")
    session.conclude(
        f"\nBest: {kind} {order} ({rule}); next: pysindy-nrf identify ... --degree"
        f" {order}"
    )
    n_terms = len(exponents_of(selection.best_order))
    for site, value in selection.orders_.items():
        if len(exponents_of(value)) < n_terms:
            lower = _as_option(value)
            option = f"--order '{site}={lower}'"
            session.conclude(f"  {site} needs no more than {lower}: {option}")


def _as_option(order: Degree | tuple[int, ...]) -> str:
    """An order as --degree takes it."""
    return ",".join(map(str, order)) if isinstance(order, tuple) else str(order)


@click.command(short_help="Plain SINDy and this package on the same record.")
@click.argument("file", required=False, type=PATH)
@opt.record_options
@click.option(
    "--degree",
    type=click.IntRange(1),
    default=3,
    help="Total degree of the power series everywhere.",
)
@click.option(
    "--heldout",
    type=float,
    default=0.3,
    help="Share of the record at its end on which all are judged.",
)
@click.option(
    "--truth",
    type=PATH,
    help="The structure, if it is known: a model.json. Judges the terms.",
)
@click.option(
    "--time-limit",
    type=float,
    default=10.0,
    help="Seconds after which a free run of SINDy is given up.",
)
@opt.output_option
@opt.json_option
def compare(
    file: Path | None, as_json: bool, **options: Unpack[ComparisonOptions]
) -> int:
    """Fit plain SINDy and this package to the same record and judge both on its end.

    FILE is one record on a base at rest; every force is known. The verdict is that of
    the model of this package (the row "instrumental variables"). It names models of
    SINDy that predict the end of the record better.

    \b
    Examples
      pysindy-nrf compare shaker.csv
      pysindy-nrf compare simulated.parquet --truth model.json
    """
    from .. import report as pages
    from ..chain.model import ChainModel
    from ..records.files import describe, write_table
    from ..records.files.summary import summary
    from ..sindy.comparison import compare_with_sindy

    session = Session(as_json)
    readings = opt.readings_of([file] if file else [], options)
    if len(readings) != 1:
        raise click.UsageError("compare takes one record.")
    session.measured(describe(readings[0]))
    record = readings[0].record
    truth = None
    if options["truth"] is not None:
        truth = ChainModel.from_json(options["truth"])
    with session.listening():
        table = compare_with_sindy(
            record,
            degree=options["degree"],
            heldout=options["heldout"],
            time_limit=options["time_limit"],
            truth=truth,
        )
        verdict = _verdict_of_comparison(options, record, table)

    share = 100 * options["heldout"]
    session.conclude_headed("Verdict", verdict_text(verdict))
    session.drop_warnings(verdict.reasons)
    unknown = [name for name in table if table[name].isna().all()]
    session.conclude_headed(
        f"On the last {share:g} % of the record (errors: percent NRMSE)",
        table_text(table.drop(columns=["note", *unknown])),
    )
    for name, note in table["note"].items():
        if note:
            session.conclude(f"  {name}: {note}")
    with session.writing() as folder:
        written = [write_table(table, folder / "comparison.csv")]
        if pages.available():
            page = folder / "comparison.html"
            content = _page_of_comparison(session, share, table, verdict)
            pages.write_html(page, content)
            written.append(page)
    data = {"record": summary(record), "table": table}
    session.finish({"verdict": verdict_data(verdict), **data}, written)
    return code_of_verdict(verdict)


def _verdict_of_comparison(
    options: ComparisonOptions, record: Record, table: pd.DataFrame
) -> Verdict:
    """The verdict on the model of this package, beside those of SINDy."""
    from ..identification.regressor import NRFRegressor
    from ..sindy.comparison import JUDGED, other_models

    n_search = round(record.n_samples * (1 - options["heldout"]))
    estimator = NRFRegressor(options["degree"], estimation="iv")
    fitted = estimator.fit(record.rows(slice(0, n_search)))
    return fitted.result_.verdict_beside(other_models(table, JUDGED))


def _page_of_comparison(
    session: Session, share: float, table: pd.DataFrame, verdict: Verdict
) -> ResultsPage:
    """The page of plain SINDy beside this package."""
    from ..drawing.tables import table as as_table
    from ..report.results_page import ResultsPage

    caption = f"On the last {share:g} % of the record (errors: percent NRMSE)"
    known = table.drop(columns="note").dropna(axis=1, how="all")
    head = {name: str(name).replace("_", " ") for name in known}
    shown = as_table(caption, known, head, index="model")
    lead = "All were fitted to what comes before, and judged on the end of the record."
    care = [f"{name}: {note}" for name, note in table["note"].items() if note]
    care += session.warnings
    title = "Plain SINDy and this package on one record"
    verdicts = {"This package": verdict}
    return ResultsPage(title, lead, [shown], verdicts, care, session.provenance())
