"""``pysindy-nrf identify``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from .options import (
    Degree,
    SiteDegree,
    band_option,
    files_argument,
    json_option,
    law_option,
    laws_of,
    link_option,
    mass_option,
    once,
    output_option,
    readings_of,
    record_options,
)
from .session import Session


@click.command(short_help="Find masses and restoring forces from records.")
@files_argument
@record_options
@click.option("--degree", type=Degree(), default=3, help="Total degree of the power series, or box k,q.")
@click.option(
    "--order",
    "orders",
    multiple=True,
    type=SiteDegree(),
    callback=once,
    help='Another degree at a site: "storey 2=5".',
)
@law_option
@link_option
@click.option(
    "--strategy",
    type=click.Choice(["auto", "complete", "sequential", "joint"]),
    default="auto",
    help="Each balance alone, along the chain from a forced floor, or all at once.",
)
@mass_option
@band_option
@click.option(
    "--estimation",
    type=click.Choice(["ls", "iv", "simulation"]),
    default="ls",
    help="Least squares; instrumental variables, which noise in the motion does not bias; or these and then the free "
    "run fitted to the motion: see docs/noise.md.",
)
@click.option(
    "--raw", is_flag=True, help="Take all channels as they are, no fusion: every floor then needs a, v and x."
)
@click.option(
    "--frf", is_flag=True, help="FILE holds frequency responses: columns f (Hz), H1, H2, .. complex, e.g. 0.1-0.2j."
)
@click.option("--driven", type=int, default=1, help="With --frf: the floor that is driven.")
@click.option(
    "--kind",
    type=click.Choice(["accelerance", "mobility", "receptance"]),
    default="accelerance",
    help="With --frf: acceleration, velocity or displacement over force.",
)
@output_option
@click.option("--figures/--no-figures", default=True, help="Draw figures (needs matplotlib).")
@click.option("--tables", type=click.Choice(["csv", "parquet"]), default="csv", help="Type of the tables.")
@click.option(
    "--forces",
    type=click.Choice(["csv", "parquet", "uff"]),
    help="Write the restoring force of each site along each record too.",
)
@click.option("--dry-run", is_flag=True, help="Say what was understood and what can be identified, then stop.")
@json_option
def identify(files: tuple[Path, ...], frf: bool, as_json: bool, **options: Any) -> None:
    """Find masses and restoring forces from the records of one chain.

    FILE is CSV or other delimited text, Parquet, MATLAB, HDF5, NumPy, UFF 58 or strong motion (V2); several
    files are several tests of the same chain (another floor hit in each, say). Channels are

    \b
        t            time, s (or --fs)
        F1, F2, ..   forces on the floors, N; a floor without one is taken to be unforced
        a1, a2, ..   absolute accelerations, m/s^2
        v1.., x1..   velocities and displacements relative to the base, m/s and m
        ag, vg, xg   motion of the base
    Any subset of a, v, x on each floor will do; it is fused into one motion. Columns with other names are
    mapped (--map), other units are declared (--unit, or in the header: "x1 [mm]"); pysindy-nrf inspect FILE
    shows what was understood.

    \b
    Examples
      pysindy-nrf identify own.csv --map F2=Shaker --map a1=Acc1 --map x1=Laser1 --unit F=kN --unit a=g --unit x=mm
      pysindy-nrf identify shaker.csv --unit a=g --unit x=mm --band 0.5,40
      pysindy-nrf identify DATA_EMPS.mat --map x1=qm --map F1='vir*35.1507' --band 0,20 --degree 1
      pysindy-nrf identify hammer1.csv hammer2.csv hammer3.csv
      pysindy-nrf identify quake.csv --map ag='table @ g' --known-mass 3=5200 --band 0.2,10
      pysindy-nrf identify shaker.csv --frf --driven 1 --band 4,32
    """
    from ...estimation.regressor import NRFRegressor

    session = Session(as_json)
    degree, band, masses = options["degree"], options["band"], options["masses"]
    settings: dict[str, Any] = {
        "degree": degree,
        "orders": options["orders"] or None,
        "strategy": options["strategy"],
        "estimation": options["estimation"],
        "laws": laws_of(options["laws"], degree),
        "known_masses": masses or None,
    }
    if frf:
        _identify_frf(session, files, settings, options)
        return
    _refuse_frf_options()
    from ...data.io import describe, summary
    from .work import identify_records

    readings = readings_of(files, options, session)
    records = [reading.record for reading in readings]
    session.say("What was measured\n-----------------")
    for reading in readings:
        session.say(describe(reading))
    n = records[0].n_dof
    _same_chain(records)
    settings["chain"] = _chain(n, options["links"])
    estimator = NRFRegressor(**settings, band=band)
    forced = sorted({j for rec in records for j in rec.forced})
    unknown = sorted(set.intersection(*(set(rec.unknown) for rec in records)))
    plan = say_plan(session, n, forced, unknown, masses, estimator)
    if options["dry_run"]:
        _dry(session, plan, [summary(rec) for rec in records])
        return
    outcome = identify_records(records, estimator, options["raw"], session.progress)
    session.finish(
        outcome,
        band,
        options["output"],
        options["figures"],
        [summary(rec) for rec in records],
        tables=options["tables"],
        forces=options["forces"],
        page_of=records,
    )
    if estimator.missing_terms_["biased"].any():
        session.say("\nNext: pysindy-nrf close-loop, with the same files and channels, looks for the missing law.")


def _identify_frf(session: Session, files: tuple[Path, ...], settings: dict[str, Any], options: dict[str, Any]) -> None:
    from ...data.io import read_frf
    from ...estimation.regressor import NRFRegressor
    from .work import identify_frf

    if len(files) != 1:
        raise click.UsageError("--frf takes one FILE.")
    for name, given in (
        ("--mapping", options["mapping_file"]),
        ("--forces", options["forces"]),
        ("--map", options["mapping"]),
        ("--unit", options["units"]),
        ("--fs", options["fs"]),
        ("--raw", options["raw"]),
    ):
        if given:
            raise click.UsageError(f"{name} does not go with --frf.")
    degree = click.get_current_context().get_parameter_source("degree")
    if degree is not None and degree.name == "DEFAULT":
        settings["degree"] = 1
    if settings["degree"] != 1 or settings["orders"] or settings["laws"]:
        raise click.UsageError(
            "Frequency responses identify linear laws only: leave out --order and --law, and --degree or set it to 1."
        )
    frf = read_frf(files[0], driven=options["driven"], kind=options["kind"])
    band = options["band"]
    session.say("What was measured\n-----------------")
    session.say(frf.describe(band))
    settings["chain"] = _chain(frf.n_dof, options["links"])
    estimator = NRFRegressor(**settings)
    masses = settings["known_masses"] or {}
    plan = say_plan(session, frf.n_dof, [frf.driven], [], masses, estimator)
    understood = [{"name": frf.name, "n_dof": frf.n_dof, "n_lines": len(frf.f), "driven": frf.driven}]
    if options["dry_run"]:
        _dry(session, plan, understood)
        return
    outcome = identify_frf(frf, estimator, band)
    session.finish(outcome, band, options["output"], options["figures"], understood)


def say_plan(session: Session, n: int, forced: Any, unknown: Any, masses: Any, estimator: Any) -> Any:
    """Say in words what the excitation can identify, before any number is produced."""
    from ...mechanics.chain import Chain
    from .text import heading

    chain = estimator.chain if estimator.chain is not None else Chain(n)
    plan = chain.identifiability(forced, unknown=unknown, known_masses=masses, strategy=estimator.strategy)
    session.say(heading(f"What this excitation can identify ({plan.strategy})"))
    session.say("\n".join(f"  {line}" for line in str(plan).splitlines()))
    return plan


def _dry(session: Session, plan: Any, records: list[dict]) -> None:
    session.emit({"records": records, "walk": str(plan).splitlines(), "complete": plan.complete})
    session.say("\nDry run: nothing was solved or written.")


def _chain(n: int, links: tuple[str, ...]) -> Any:
    from ...mechanics.chain import Chain

    return Chain(n, links) if links else None


def _same_chain(records: list[Any]) -> None:
    from ...exceptions import ChannelError

    for rec in records[1:]:
        if rec.n_dof != records[0].n_dof:
            raise ChannelError(
                f"{rec.name!r} has {rec.n_dof} DOFs, {records[0].name!r} has {records[0].n_dof}",
                "Files given together are tests of one chain; identify others by themselves.",
            )


def _refuse_frf_options() -> None:
    context = click.get_current_context()
    for name in ("driven", "kind"):
        source = context.get_parameter_source(name)
        if source is not None and source.name == "COMMANDLINE":
            raise click.UsageError(f"--{name} goes with --frf only.")
