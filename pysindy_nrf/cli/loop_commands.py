"""Commands that close the loop: ``run`` and ``close-loop``."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Unpack

import click

from . import options as opt
from .exit_codes import code_of_verdict
from .parameters import PATH
from .printing import table_text, verdict_data, verdict_text
from .session import Session

if TYPE_CHECKING:
    from ..discrepancy import LoopReport
    from ..records.files.reading import Reading


class LoopOptions(opt.FitOptions):
    """Options of ``run`` and ``close-loop``."""

    heldout: tuple[Path, ...]
    steps: int | None
    seed: int
    output: Path
    figures: bool
    excel: bool


_loop_options = opt.together(
    opt.files_options,
    click.option(
        "--heldout",
        multiple=True,
        type=PATH,
        help="A test that is read once, to confirm the effects.",
    ),
    opt.degree_option(1, "Total degree of the declared storeys, or box k,q."),
    opt.model_options,
    click.option(
        "--steps",
        type=click.IntRange(0),
        show_default="storeys + 1, at least 4",
        help="Effects at most.",
    ),
    click.option(
        "--seed", type=int, default=0, help="Random state of the noise that is drawn."
    ),
    opt.excel_option,
    opt.figures_option,
)


@click.command(
    "run", short_help="Inspect, close the loop, report: the verdict on a test."
)
@_loop_options
@opt.run_output_option
@opt.json_option
def run_test(
    files: tuple[Path, ...], as_json: bool, **options: Unpack[LoopOptions]
) -> int:
    """Inspect the files of a test, find masses, restoring forces and what linear
    storeys lack, and say a verdict.

    Everything goes into its own folder, nrf_runs/FILE (nrf_runs/FILE-2 the next
    time): the page, the model, tables, figures, and a manifest with the command, the
    versions and the SHA-256 of the files. The options are those of close-loop. The exit
    code is 4 if the verdict is red.

    \b
    Examples
      pysindy-nrf run shaker.csv
      pysindy-nrf run --mapping tower.toml
    """
    parameters = click.get_current_context().params
    if parameters["output"] is None:
        named = [*files, *opt.mapping_of(options)[0].files]
        parameters["output"] = _free_folder(named[0].stem if named else "run")
    return _close(Session(as_json), files, options, inspected=True)


def _free_folder(name: str) -> Path:
    """The first of nrf_runs/NAME, nrf_runs/NAME-2, .. that does not exist."""
    home = Path("nrf_runs")
    if not (home / name).exists():
        return home / name
    for number in itertools.count(2):
        folder = home / f"{name}-{number}"
        if not folder.exists():
            break
    return folder


@click.command("close-loop", short_help="Find the effects that a model lacks.")
@_loop_options
@opt.output_option
@opt.json_option
def close_loop(
    files: tuple[Path, ...], as_json: bool, **options: Unpack[LoopOptions]
) -> int:
    """Find the effects a model lacks, add them, and report the error before and after.

    FILE is read as by ``identify``. A quarter of each record (or the files given with
    --heldout) is put aside until the last line: an effect that does not lower the error
    there is not confirmed. The band in which everything is judged is found from the
    data unless --band limits it.

    \b
    Examples
      pysindy-nrf close-loop shaker.csv
      pysindy-nrf close-loop DATA_EMPS.mat --map x1=qm --map F1='vir*35.1507' --map t=t
      pysindy-nrf close-loop quake.csv --map ag='table @ g' --known-mass 1=1
    """
    return _close(Session(as_json), files, options, inspected=False)


def _close(
    session: Session, files: Sequence[Path], options: LoopOptions, inspected: bool
) -> int:
    """Close the loop, write what was found, and print it."""
    from ..records.files import describe

    readings = opt.readings_of(files, options)
    heldout: list[Reading] = []
    if options["heldout"]:
        heldout = opt.readings_of(options["heldout"], options)
    tests = readings + heldout
    session.measured(*map(describe, tests))
    if inspected:
        session.add_warnings(_doubts_of(tests))
    report = _closed_loop(session, readings, heldout, options)

    verdict = report.verdict
    session.drop_warnings(verdict.reasons)
    _conclude(session, report)
    report.model.info.update(session.provenance())
    with session.writing() as folder:
        written = _write(report, folder, options["figures"])
        if options["excel"]:
            written.append(_workbook(report, folder / "closed_loop.xlsx"))
    session.finish(_data(report), written)
    return code_of_verdict(verdict)


def _doubts_of(readings: Sequence[Reading]) -> list[str]:
    """What looks wrong with records, named as the verdict names it."""
    from ..records.checks.channel_checks import data_warnings

    doubts = []
    for reading in readings:
        record = reading.record
        prefix = f"Record {record.name!r}: " if len(readings) > 1 else ""
        doubts += [f"{prefix}{doubt}" for doubt in data_warnings(record)]
    return doubts


def _closed_loop(
    session: Session,
    readings: Sequence[Reading],
    heldout: Sequence[Reading],
    options: LoopOptions,
) -> LoopReport:
    """The loop closed on records."""
    from ..discrepancy import close_loop as closed_loop

    # the loop itself takes the band
    baseline = opt.regressor_of(options).set_params(band=None)
    with session.listening("fusing channels, finding bands") as tick:
        return closed_loop(
            [reading.record for reading in readings],
            baseline,
            heldout=[reading.record for reading in heldout] or None,
            band=options["band"],
            random_state=options["seed"],
            max_steps=options["steps"],
            progress=tick,
        )


def _conclude(session: Session, report: LoopReport) -> None:
    """What was found, in words."""
    from ..report.loop_content import band_and_source, lead
    from ..report.words import standing

    verdict = report.verdict
    session.conclude_headed("Verdict", verdict_text(verdict))
    session.conclude_headed("What was found", f"{lead(report)}\n\n{report}")

    errors = report.table.drop(columns="band")
    if report.steps:
        errors["held-out data"] = ["", *map(standing, report.steps)]
    where = band_and_source(report)
    session.conclude_headed(
        f"Errors, percent NRMSE, {where} (balance errors, but for the free run)",
        table_text(errors),
    )
    not_to_be_used = " (not to be used)" if verdict.state == "red" else ""
    session.conclude_headed(f"Model{not_to_be_used}", str(report.model))


def _data(report: LoopReport) -> dict[str, object]:
    """What was found, as plain data."""
    steps = [asdict(step) | {"sentence": step.sentence} for step in report.steps]
    return {
        "verdict": verdict_data(report.verdict),
        "steps": steps,
        "table": report.table,
        "stopped_because": report.stopped_because,
        "band_hz": report.band,
        "model": report.model.to_dict(),
    }


def _workbook(report: LoopReport, path: Path) -> Path:
    """Write the workbook of the model found."""
    from ..report import write_workbook

    return write_workbook(
        path, report.summary(), report.model, report.loops, report.quality
    )


def _write(report: LoopReport, folder: Path, figures: bool) -> list[Path]:
    """Write the model, its story, tables, figures and the page."""
    from .. import report as pages
    from ..common.files import atomic_write
    from ..drawing.matplotlib_renderer import save
    from ..records.files import write_table
    from ..report.loop_content import pictures

    model, story = folder / "closed_loop.json", folder / "closed_loop.md"
    report.model.to_json(model)
    with atomic_write(story) as file:
        file.write(report.to_markdown())
    table = write_table(report.table.rename_axis("model"), folder / "closed_loop.csv")
    written = [model, story, table]
    if figures:
        written += save(folder / "closed_loop.png", pictures(report), columns=2)
    if pages.available():
        page = folder / "closed_loop.html"
        report.to_html(page)
        written.append(page)
    return written
