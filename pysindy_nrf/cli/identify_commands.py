"""Commands that identify a chain: ``demo`` and ``identify``."""

from __future__ import annotations

import textwrap
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict, Unpack

import click

from ..chain.structure import Chain
from ..exceptions import ChannelError
from . import options as opt
from .session import Session

if TYPE_CHECKING:
    from ..identification.regressor import NRFRegressor
    from ..records.record import Record


class DemoOptions(TypedDict):
    """Options of ``demo``."""

    output: Path


class IdentifyOptions(opt.FitOptions):
    """Options of ``identify``."""

    links: tuple[str, ...]
    raw: bool
    excited: int
    kind: str
    output: Path
    figures: bool
    excel: bool


@click.command(short_help="Identify a bundled record of a shaken frame.")
@opt.demo_output_option
@opt.json_option
def demo(as_json: bool, **_: Unpack[DemoOptions]) -> int:
    """Identify a bundled record: a shaken three-storey frame whose ground storey
    hardens.

    Only floor 2 is forced and every channel carries 2 % noise. The record was
    simulated, so the truth is printed next to what was found. No network, a few
    seconds.
    """
    from ..datasets import demo_truth, read_demo
    from ..identification.regressor import NRFRegressor
    from ..records.files import describe
    from .outcome import identify_records
    from .outcome_files import finish

    session = Session(as_json)
    reading = read_demo()
    record = reading.record
    session.measured(describe(reading))
    estimator = NRFRegressor(degree=3)
    say_what_is_identifiable(
        session, estimator, Chain(3), record.forced, record.unknown
    )

    outcome = identify_records([record], estimator, raw=False)
    code = finish(session, outcome, True, [record], demo_truth())
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
    "ls: least squares. iv: instrumental variables, which noise in the motion does not"
    " bias. simulation: iv, then the free run fitted to the motion. auto: ls where a"
    " test does not distinguish it from iv, else iv. See docs/noise.md.",
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
        "FILE holds frequency responses: columns f (Hz), H1, H2, .. complex, as"
        " 0.1-0.2j or in two columns (H1_re, H1_im); --map H1='complex(Re 1, Im 1)' or"
        " 'polar(Mag 1, Phase 1)'; UFF 58."
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
@opt.excel_option
@opt.written_options
def identify(
    files: tuple[Path, ...],
    frf: bool,
    as_json: bool,
    **options: Unpack[IdentifyOptions],
) -> int:
    """Find masses and restoring forces from the records of one chain.

    FILE is CSV or other delimited text, Parquet, MATLAB, HDF5, NumPy, UFF 58 or strong
    motion (V2); several files are several tests of the same chain (another floor hit in
    each, say). Channels are

    \b
        t            time, s (or --fs)
        F1, F2, ..   forces on the floors, N; a floor without one is unforced
        a1, a2, ..   absolute accelerations, m/s^2
        v1.., x1..   velocities and displacements relative to the base, m/s and m
        ag, vg, xg   motion of the base

    Any subset of a, v, x on each floor will do; it is fused into one motion. Columns
    with other names are mapped (--map), other units are declared (--unit, or in the
    header: "x1 [mm]"); pysindy-nrf inspect FILE shows what was understood.

    \b
    Examples
      pysindy-nrf identify own.csv --map F2=Shaker --map a1=Acc1 --unit F=kN --unit a=g
      pysindy-nrf identify shaker.csv --unit a=g --unit x=mm --band 0.5,40
      pysindy-nrf identify DATA_EMPS.mat --map x1=qm --map F1='vir*35.1507' --degree 1
      pysindy-nrf identify hammer1.csv hammer2.csv hammer3.csv
      pysindy-nrf identify quake.csv --map ag='table @ g' --known-mass 3=5200
      pysindy-nrf identify shaker.csv --frf --excited 1 --band 4,32
    """
    session = Session(as_json)
    if frf:
        return _identify_responses(session, files, options)
    for name in ("excited", "kind"):
        if opt.was_given(name):
            raise click.UsageError(f"--{name} goes with --frf only.")
    from .outcome import identify_records
    from .outcome_files import finish
    from .what_run_finds import what_run_finds

    records = opt.records_of(session, options, files)
    _require_one_chain(records)
    estimator = opt.regressor_of(options)
    forced, unknown = _forced_and_unknown(records)
    chain = Chain(records[0].n_dof, options["links"])
    say_what_is_identifiable(session, estimator, chain, forced, unknown)

    outcome = identify_records(records, estimator, options["raw"])
    code = finish(session, outcome, options["figures"], records, excel=options["excel"])
    if code or outcome.estimator.missing_terms_["biased"].any():
        session.headed("What run finds", what_run_finds(records, options))
    return code


def _require_one_chain(records: Sequence[Record]) -> None:
    """All records have the same floors."""
    first = records[0]
    for record in records:
        if record.n_dof != first.n_dof:
            raise ChannelError(
                f"{record.name!r} has {record.n_dof} DOFs, {first.name!r} has"
                f" {first.n_dof}",
                "Files given together are tests of one chain; identify others by"
                " themselves.",
            )


def _forced_and_unknown(records: Sequence[Record]) -> tuple[list[int], list[int]]:
    """DOFs forced in any record, and those whose force is unknown in all of them."""
    forced: set[int] = set()
    unknown = set(records[0].unknown)
    for record in records:
        forced.update(record.forced)
        unknown.intersection_update(record.unknown)
    return sorted(forced), sorted(unknown)


def _identify_responses(
    session: Session, files: tuple[Path, ...], options: IdentifyOptions
) -> int:
    """Find a linear chain from its frequency responses."""
    from ..records.files import read_frf
    from .outcome import identify_frf
    from .outcome_files import finish

    _refuse_what_is_not_of_responses(files, options)
    frf = read_frf(
        files[0],
        excited=options["excited"] if opt.was_given("excited") else None,
        kind=options["kind"] if opt.was_given("kind") else None,
        mapping=options["mapping"] or None,
    )
    session.measured(frf.describe(options["band"]))
    estimator = opt.regressor_of(options).set_params(degree=1)
    chain = Chain(frf.n_dof, options["links"])
    say_what_is_identifiable(session, estimator, chain, [frf.excited], [])
    return finish(session, identify_frf(frf, estimator), options["figures"])


def _refuse_what_is_not_of_responses(
    files: tuple[Path, ...], options: IdentifyOptions
) -> None:
    """Refuse options of records and of nonlinear laws."""
    if len(files) != 1:
        raise click.UsageError("--frf takes one FILE.")
    of_records = {
        "--mapping": options["mapping_file"],
        "--unit": options["units"],
        "--fs": options["fs"],
        "--raw": options["raw"],
    }
    for flag, value in of_records.items():
        if value:
            raise click.UsageError(f"{flag} does not go with --frf.")

    is_curved = opt.was_given("degree") and options["degree"] != 1
    if is_curved or options["orders"] or options["laws"]:
        raise click.UsageError(
            "Frequency responses identify linear laws only: leave out --order and"
            " --law, and --degree or set it to 1."
        )


def say_what_is_identifiable(
    session: Session,
    estimator: NRFRegressor,
    chain: Chain,
    forced: Collection[int],
    unknown: Collection[int],
) -> None:
    """Say what the excitation can identify, before any number is produced.

    A chain with further links becomes the estimator's.
    """
    order = chain.identifiability(
        forced,
        unknown=unknown,
        known_masses=estimator.known_masses or {},
        strategy=estimator.strategy,
    )
    title = f"What this excitation can identify ({order.strategy})"
    session.headed(title, textwrap.indent(str(order), "  "))
    if chain.links:
        estimator.set_params(chain=chain)
