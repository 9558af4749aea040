"""Commands that find models: ``demo``, ``identify``, ``close-loop``, ``select-order``
and ``compare``.
"""

import itertools
import textwrap
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from ..chain.structure import Chain
from ..exceptions import ChannelError
from . import options as opt
from .options import Session


@click.command(short_help="Identify a bundled record of a shaken frame.")
@opt.demo_option
@opt.json_option
def demo(as_json: bool, **options: Any) -> int:
    """Identify a bundled record: a shaken three-storey frame whose ground storey
    hardens.

    Only floor 2 is forced and every channel carries 2 % noise. The record was
    simulated, so the truth is printed beside what was found. No network, a few seconds.
    """
    from ..datasets import demo_truth, read_demo
    from ..identification.regressor import NRFRegressor
    from ..records.files import describe
    from .outcome import finish, identify_records

    session = Session(as_json)
    reading = read_demo()
    session.measured(describe(reading))
    records = [reading.record]
    estimator = _planned(
        session, NRFRegressor(degree=3), 3, records[0].forced, records[0].unknown
    )
    code = finish(
        session,
        identify_records(records, estimator, raw=False),
        True,
        records,
        demo_truth(),
    )
    session.say(
        "\nNext: pysindy-nrf inspect YOUR_TEST.csv, then run YOUR_TEST.csv  "
        " (pysindy-nrf --help)"
    )
    return code


@click.command(short_help="Find masses and restoring forces from records.")
@opt.files_options
@opt.degree_option(3, "Total degree of the power series, or box k,q.")
@opt.order_option
@opt.law_option
@opt.link_option
@opt.choice(
    "--strategy",
    ["auto", "complete", "sequential", "joint"],
    "Each balance alone, along the chain from a forced floor, or all at once.",
    "auto",
)
@opt.mass_option
@opt.band_option
@opt.choice(
    "--estimation",
    ["auto", "ls", "iv", "simulation"],
    "Least squares; instrumental variables, which noise in the motion does not bias; or"
    " these and then the free run fitted to the motion; auto takes the first where the"
    " measured noise is negligible, else the second: see docs/noise.md.",
    "auto",
)
@click.option(
    "--raw",
    is_flag=True,
    help="Take all channels as they are, no fusion: every floor then needs a, v and x.",
)
@click.option(
    "--frf",
    is_flag=True,
    help=(
        "FILE holds frequency responses: columns f (Hz), H1, H2, .. complex, e.g."
        " 0.1-0.2j."
    ),
)
@click.option(
    "--excited", type=int, default=1, help="With --frf: the floor that is excited."
)
@opt.choice(
    "--kind",
    ["accelerance", "mobility", "receptance"],
    "With --frf: acceleration, velocity or displacement over force.",
    "accelerance",
)
@opt.written_options
def identify(files: tuple[Path, ...], frf: bool, as_json: bool, **options: Any) -> int:
    """Find masses and restoring forces from the records of one chain.

    FILE is CSV or other delimited text, Parquet, MATLAB, HDF5, NumPy, UFF 58 or strong
    motion (V2); several files are several tests of the same chain (another floor hit in
    each, say). Channels are

    \b
        t            time, s (or --fs)
        F1, F2, ..   forces on the floors, N; a floor without one is taken to be unforced
        a1, a2, ..   absolute accelerations, m/s^2
        v1.., x1..   velocities and displacements relative to the base, m/s and m
        ag, vg, xg   motion of the base
    Any subset of a, v, x on each floor will do; it is fused into one motion. Columns
    with other names are mapped (--map), other units are declared (--unit, or in the
    header: "x1 [mm]"); pysindy-nrf inspect FILE shows what was understood.

    \b
    Examples
      pysindy-nrf identify own.csv --map F2=Shaker --map a1=Acc1 --map x1=Laser1 --unit
      F=kN --unit a=g --unit x=mm pysindy-nrf identify shaker.csv --unit a=g --unit x=mm
      --band 0.5,40 pysindy-nrf identify DATA_EMPS.mat --map x1=qm --map
      F1='vir*35.1507' --band 0,20 --degree 1 pysindy-nrf identify hammer1.csv
      hammer2.csv hammer3.csv pysindy-nrf identify quake.csv --map ag='table @ g'
      --known-mass 3=5200 --band 0.2,10 pysindy-nrf identify shaker.csv --frf --excited
      1 --band 4,32
    """
    session = Session(as_json)
    if frf:
        return _identify_frf(session, files, options)
    for name in ("excited", "kind"):
        if _given(name):
            raise click.UsageError(f"--{name} goes with --frf only.")
    from .outcome import finish, identify_records

    records = opt.records_of(session, options, files)
    n = records[0].n_dof
    for rec in records:
        if rec.n_dof != n:
            cure = (
                "Files given together are tests of one chain; identify others by"
                " themselves."
            )
            raise ChannelError(
                f"{rec.name!r} has {rec.n_dof} DOFs, {records[0].name!r} has {n}", cure
            )
    forced = sorted({j for rec in records for j in rec.forced})
    unknown = sorted(set.intersection(*(set(rec.unknown) for rec in records)))
    estimator = _planned(
        session, opt.regressor_of(options), n, forced, unknown, options["links"]
    )
    code = finish(
        session,
        identify_records(records, estimator, options["raw"]),
        options["figures"],
        records,
    )
    if not code and estimator.missing_terms_["biased"].any():
        session.say(
            "\nNext: pysindy-nrf close-loop, with the same files and channels, looks"
            " for the missing law."
        )
    return code


def _identify_frf(
    session: Session, files: tuple[Path, ...], options: dict[str, Any]
) -> int:
    """Find a linear chain from its frequency responses."""
    from ..records.files import read_frf
    from .outcome import finish, identify_frf

    if len(files) != 1:
        raise click.UsageError("--frf takes one FILE.")
    of_records = {
        "mapping_file": "mapping",
        "mapping": "map",
        "units": "unit",
        "fs": "fs",
    }
    for name, option in (of_records | {"raw": "raw"}).items():
        if options[name]:
            raise click.UsageError(f"--{option} does not go with --frf.")
    if not _given("degree"):
        options["degree"] = 1
    if options["degree"] != 1 or options["orders"] or options["laws"]:
        raise click.UsageError(
            "Frequency responses identify linear laws only: leave out --order and"
            " --law, and --degree or set it to 1."
        )
    frf = read_frf(files[0], excited=options["excited"], kind=options["kind"])
    session.measured(frf.describe(options["band"]))
    estimator = _planned(
        session,
        opt.regressor_of(options),
        frf.n_dof,
        [frf.excited],
        [],
        options["links"],
    )
    return finish(session, identify_frf(frf, estimator), options["figures"])


def _planned(
    session: Session, estimator: Any, n: int, forced: Any, unknown: Any, links: Any = ()
) -> Any:
    """The regressor for n floors; what the excitation can identify with it is said
    before any number is produced.
    """
    chain, masses = Chain(n, links), estimator.known_masses or {}
    plan = chain.identifiability(
        forced, unknown=unknown, known_masses=masses, strategy=estimator.strategy
    )
    session.headed(
        f"What this excitation can identify ({plan.strategy})",
        textwrap.indent(str(plan), "  "),
    )
    return estimator.set_params(chain=chain if links else None)


def _given(option: str) -> bool:
    """Whether an option of the running command was given, not left at its default."""
    return (
        click.get_current_context().get_parameter_source(option)
        is not ParameterSource.DEFAULT
    )


# of the commands that close the loop
_loop_options = opt.together(
    opt.files_options,
    click.option(
        "--heldout",
        multiple=True,
        type=opt.PATH,
        help="A file that only the last line may see.",
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
        "--seed", type=int, default=0, help="Seed of the parametric bootstrap."
    ),
    opt.figures_option,
)


@click.command(
    "run", short_help="Inspect, close the loop, report: the verdict on a test."
)
@_loop_options
@opt.run_option
@opt.json_option
def run_test(files: tuple[Path, ...], as_json: bool, **options: Any) -> int:
    """Inspect the files of a test, find masses, restoring forces and what linear
    storeys lack, and say a verdict.

    Everything goes into a folder of its own, nrf_runs/FILE (nrf_runs/FILE-2 the next
    time): the page, the model, tables, figures, and a manifest with the command, the
    versions and the SHA-256 of the files. The options are those of close-loop. The exit
    code is 4 if the verdict is red.

    \b
    Examples
      pysindy-nrf run shaker.csv
      pysindy-nrf run --mapping tower.toml
    """
    context = click.get_current_context()
    if context.params["output"] is None:
        named = [*files, *opt.said_of(options)[0].files]
        home, name = Path("nrf_runs"), named[0].stem if named else "run"
        folders = (
            home / (name if k == 1 else f"{name}-{k}") for k in itertools.count(1)
        )
        context.params["output"] = next(path for path in folders if not path.exists())
    return _close(Session(as_json), files, options, True)


@click.command("close-loop", short_help="Find the effects that a model lacks.")
@_loop_options
@opt.output_option
@opt.json_option
def close_loop(files: tuple[Path, ...], as_json: bool, **options: Any) -> int:
    """Find the effects a model lacks, add them, and report the error before and after.

    FILE is read as by ``identify``. A quarter of each record (or the files given with
    --heldout) is put aside until the last line: an effect that does not lower the error
    there is not confirmed. The band in which everything is judged is found from the
    data unless --band limits it.

    \b
    Examples
      pysindy-nrf close-loop shaker.csv pysindy-nrf close-loop DATA_EMPS.mat --map x1=qm
      --map F1='vir*35.1507' --map t=t pysindy-nrf close-loop quake.csv --map ag='table
      @ g' --known-mass 1=1 --known-mass 2=1 --known-mass 3=1
    """
    return _close(Session(as_json), files, options, False)


def _close(
    session: Session, files: tuple[Path, ...], options: dict[str, Any], inspected: bool
) -> int:
    """Close the loop, say what was found, and write it."""
    from ..discrepancy import close_loop as run
    from ..records.checks.channel_checks import data_warnings
    from ..records.files import describe
    from ..report.content import band_source, band_text, lead, standing
    from .outcome import exit_code

    baseline = opt.regressor_of(options).set_params(
        band=None
    )  # the loop itself takes the band
    readings = opt.readings_of(files, options)
    kept = opt.readings_of(options["heldout"], options) if options["heldout"] else []
    session.measured(*map(describe, (*readings, *kept)))
    with session.listening("fusing channels, finding bands") as tick:
        doubts = (
            [text for r in (*readings, *kept) for text in data_warnings(r.record)]
            if inspected
            else []
        )
        report = run(
            [r.record for r in readings],
            baseline,
            heldout=[r.record for r in kept] or None,
            band=options["band"],
            random_state=options["seed"],
            max_steps=options["steps"],
            progress=tick,
        )
        verdict = report.verdict
    session.warnings = [
        one
        for one in dict.fromkeys([*doubts, *session.warnings])
        if one not in verdict.reasons
    ]
    session.headed("Verdict", opt.verdict_words(verdict))
    session.headed("What was found", f"{lead(report)}\n\n{report}")
    band = ", ".join(filter(None, [band_text(report.band), band_source(report)]))
    shown = report.table.drop(columns="band")
    if report.steps:
        shown["held-out data"] = ["", *map(standing, report.steps)]
    session.headed(
        f"Errors, percent NRMSE, {band} (balance errors, but for the free run)",
        opt.table(shown),
    )
    session.headed(
        "Model" + " (not to be used)" * (verdict.state == "red"), str(report.model)
    )
    steps = [asdict(step) | {"sentence": step.sentence} for step in report.steps]
    data = {
        "steps": steps,
        "table": report.table,
        "stopped_because": report.stopped_because,
        "band_hz": report.band,
    }
    report.model.info.update(session.provenance())
    with session.aside() as folder:
        written = _write(report, folder, options["figures"])
    session.finish(
        {"verdict": asdict(verdict)} | data | {"model": report.model.to_dict()}, written
    )
    return exit_code(verdict)


def _write(report: Any, folder: Path, figures: bool) -> list[Path]:
    from ..common.files import atomic_write
    from ..records.files import write_table
    from ..report.content import pictures
    from ..report.figures.matplotlib_renderer import save
    from .outcome import page

    model, words = folder / "closed_loop.json", folder / "closed_loop.md"
    report.model.to_json(model)
    with atomic_write(words) as file:
        file.write(report.to_markdown())
    written = [
        model,
        words,
        write_table(report.table.rename_axis("model"), folder / "closed_loop.csv"),
    ]
    written += save(
        folder / "closed_loop.png", pictures(report) if figures else [], columns=2
    )
    return written + page(
        lambda path: report.to_html(path), folder / "closed_loop.html"
    )


@click.command(
    "select-order",
    short_help="Find the order of the power series that the records support.",
)
@opt.files_options
@click.option(
    "--degrees",
    type=opt.RANGE,
    default="1-7",
    help="Total degrees to try: 1-7, or 1,3,5.",
)
@click.option(
    "--box",
    "boxes",
    multiple=True,
    type=opt.RANGE,
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
def select_order(files: tuple[Path, ...], as_json: bool, **options: Any) -> None:
    """Find the order of the power series that the records support.

    All orders on all folds come from one pass over the samples. Scores are of held-out
    blocks.

    \b
    Examples
      pysindy-nrf select-order shaker.csv pysindy-nrf select-order shaker.csv --degrees
      1-5 --box 1,3 --box 2,3 --band 0.5,40
    """
    from ..laws.power_series import exponents_of
    from ..records.files import write_table
    from ..records.files.summary import summary
    from ..selection import select_order as run

    session = Session(as_json)
    records = opt.records_of(session, options, files)
    boxes = [tuple(box) for box in options["boxes"]]
    for box in boxes:
        if len(box) != 2:
            raise click.UsageError(
                f"--box takes two numbers k,q, not {_as_option(box)}."
            )
    with session.listening():
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
    session.headed(
        "Orders (errors: percent NRMSE on held-out blocks)", opt.table(listed)
    )
    kind, order = (
        ("box k,q" if isinstance(found.best_order, tuple) else "total degree"),
        _as_option(found.best_order),
    )
    rule = options["rule"].replace("_", " ")
    session.say(
        f"\nBest: {kind} {order} ({rule}); next: pysindy-nrf identify ... --degree"
        f" {order}"
    )
    for site, value in found.orders_.items():
        if len(exponents_of(value)) < len(exponents_of(found.best_order)):
            shown = _as_option(value)
            session.say(
                f"  {site} needs no more than {shown}: --order '{site}={shown}'"
            )
    with session.aside() as folder:
        written = [write_table(listed, folder / "orders.csv")]
        if options["figures"]:
            from ..report.figures.matplotlib_renderer import save
            from ..report.figures.motion import order_drawing

            written += save(folder / "orders.png", order_drawing(found).figures())
    data = {
        "records": [summary(rec) for rec in records],
        "best_order": found.best_order,
    }
    session.finish(data | {"orders_by_storey": found.orders_, "table": listed}, written)


def _as_option(order: Any) -> str:
    """An order as --degree takes it."""
    return ",".join(map(str, order)) if isinstance(order, tuple) else str(order)


@click.command(short_help="Plain SINDy and this package on the same record.")
@click.argument("file", required=False, type=opt.PATH)
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
    type=opt.PATH,
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
def compare(file: Path | None, as_json: bool, **options: Any) -> None:
    """Fit plain SINDy and this package to the same record and judge both on its end.

    FILE is one record on a base at rest; every force is known.

    \b
    Examples
      pysindy-nrf compare shaker.csv
      pysindy-nrf compare simulated.parquet --truth model.json
    """
    from ..chain.model import ChainModel
    from ..records.files import describe, write_table
    from ..records.files.summary import summary
    from ..sindy.comparison import compare_with_sindy

    session = Session(as_json)
    readings = opt.readings_of([file] if file else [], options)
    if len(readings) != 1:
        raise click.UsageError("compare takes one record.")
    session.measured(describe(readings[0]))
    given = {key: options[key] for key in ("degree", "heldout", "time_limit")}
    given["truth"] = (
        None if options["truth"] is None else ChainModel.from_json(options["truth"])
    )
    with session.listening():
        found = compare_with_sindy(readings[0].record, **given)
    session.headed(
        f"On the last {100 * options['heldout']:g} % of the record (errors: percent"
        " NRMSE)"
    )
    session.say(
        opt.table(
            found.drop(columns=["note", *(c for c in found if found[c].isna().all())])
        )
    )
    for name, note in found["note"].items():
        if note:
            session.say(f"  {name}: {note}")
    with session.aside() as folder:
        written = [write_table(found, folder / "comparison.csv")]
    session.finish({"record": summary(readings[0].record), "table": found}, written)
