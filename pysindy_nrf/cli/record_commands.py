"""Commands on records and laws: ``inspect``, ``laws`` and ``simulate``."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Unpack

import click
import numpy as np

from ..exceptions import MissingExtraError, NRFError
from . import options as opt
from .parameters import NUMBERS, PATH
from .session import Session, say_if_compiling

if TYPE_CHECKING:
    from ..chain.model import ChainModel
    from ..laws.base import ForceLaw
    from ..records.files.mapping import MappingFile, Proposal
    from ..records.files.reading import Reading
    from ..records.files.tables import AnyPath
    from ..records.record import Record

# Share by which a drift may exceed what the data of a model reached.
BEYOND_THE_DATA = 1.05


class SimulationOptions(opt.ExcitationOptions):
    """Options of ``simulate``."""

    method: str
    x0: list[float] | None
    v0: list[float] | None
    output: Path


@click.command(short_help="Say what a file holds and how it was understood.")
@opt.files_options
@click.option(
    "--write-mapping",
    type=PATH,
    help="Propose a channel for every column, in a new TOML file.",
)
@click.option(
    "--html",
    type=PATH,
    help="Draw the channels on a page: over time, spectra, coherence.",
)
@click.option(
    "--together",
    is_flag=True,
    help="With --write-mapping: the FILEs are channels of one test, each on its clock.",
)
@opt.json_option
def inspect(
    files: tuple[Path, ...],
    as_json: bool,
    write_mapping: Path | None,
    html: Path | None,
    together: bool,
    **options: Unpack[opt.RecordOptions],
) -> None:
    """Say what a file holds and how it was understood. Nothing is solved; nothing is
    written but the mapping and the page that are asked for.

    For each FILE: clock, channels with their size in SI units and where each came from,
    columns that were not used, and what looks wrong (units, signs and delays that
    contradict each other; dead, clipped, spiky channels).

    \b
    Examples
      pysindy-nrf inspect shaker.csv
      pysindy-nrf inspect shaker.csv --map F2='Shaker @ kN' --unit a=g --unit x=mm
      pysindy-nrf inspect tower.csv --write-mapping tower.toml
      pysindy-nrf inspect --mapping campaign.toml --html campaign.html
    """
    from ..records.checks.channel_checks import data_warnings
    from ..records.files import describe

    session = Session(as_json)
    if together and write_mapping is None:
        raise click.UsageError(
            "--together goes with --write-mapping; a mapping file says together = true."
        )
    if write_mapping is not None:
        if not _propose(session, files, write_mapping, together):
            session.emit({"records": []})
            return
        files, options["mapping_file"] = (), write_mapping

    readings = _readings(session, files, options)
    records = []
    for reading in readings:
        with session.listening():
            doubts = data_warnings(reading.record)
        lines = [f"  take care: {doubt}" for doubt in doubts]
        session.say(describe(reading), *(lines or ["  nothing looks wrong"]), "")
        records.append(_data_of_reading(reading, doubts))
    if html is not None:
        _draw(session, [reading.record for reading in readings], html)
    session.emit({"records": records}, [html] if html else [])


def _draw(session: Session, records: Sequence[Record], path: Path) -> None:
    """Write a page of records; no file is lost."""
    from ..report import write_html

    if path.exists() and not path.read_bytes()[:15].startswith(b"<!doctype html>"):
        raise NRFError(f"{path} is no page, and would be lost", "Give another name.")
    with session.listening("drawing"):
        write_html(path, list(records))
    session.say(f"Drawn: {path}   (open it in a browser)")


def _readings(
    session: Session, files: Sequence[Path], options: opt.RecordOptions
) -> list[Reading]:
    """What files hold; the columns of one that cannot be understood are listed."""
    from ..records.files import read_table
    from ..records.files.summary import contents

    try:
        return opt.readings_of(files, options)
    except NRFError:
        with suppress(NRFError, MissingExtraError):
            for path in files[:1]:
                session.say(f"{contents(read_table(path))}\n")
        raise


def _data_of_reading(reading: Reading, doubts: list[str]) -> dict[str, object]:
    """How a file was understood, as plain data."""
    from ..records.files.summary import summary

    sources = {}
    for name, source in reading.sources.items():
        sources[name] = {"from": source.text, "unit": source.unit}
    return {
        **summary(reading.record),
        "file": reading.table.path,
        "kind": reading.table.kind,
        "notes": reading.table.notes,
        "clock": reading.clock,
        "sources": sources,
        "not_used": list(reading.unused),
        "doubts": doubts,
    }


def _propose(
    session: Session, files: tuple[Path, ...], path: Path, together: bool
) -> bool:
    """Write a mapping file with a channel for every column that says what it is.

    Returns
    -------
    bool
        Whether the files can be read by it: a motion is proposed, and a clock known.
    """
    from ..common.files import atomic_write
    from ..records.files import mapping as maps
    from ..records.files import read_table

    if not files:
        raise click.UsageError(
            "--write-mapping takes the FILE whose columns are to be mapped."
        )
    if path.exists():
        raise NRFError(f"{path} exists, and would be lost", "Give another name.")
    home = path.resolve().parent
    if any(file.resolve().parent != home for file in files):
        raise NRFError(
            f"{path} is not in the folder of its files", "Write it next to them."
        )

    table = read_table([*files] if together else files[0])
    facts = maps.column_facts(table)
    if maps.is_over_frequency(facts):
        raise NRFError(
            f"{files[0]} holds values over frequency, not over time",
            "Frequency responses: pysindy-nrf identify FILE --frf --excited DOF.",
        )
    proposals = maps.propose(table, facts)
    text = maps.mapping_text(files, proposals, table, facts)
    with atomic_write(path) as file:
        file.write(text)

    session.say(f"Proposed, in {path}:", "", text)
    without_clock = maps.lacks_clock(proposals, table)
    session.say(_next_step(proposals, path, without_clock), "")
    return not maps.lacks_motion(proposals) and not without_clock


def _next_step(proposals: Sequence[Proposal], path: Path, without_clock: bool) -> str:
    """What to do with a proposal."""
    from ..records.files.mapping import is_element_alone, lacks_motion

    if not proposals:
        return (
            "The proposal is empty: no column says what it is, by its name or its unit."
            f' Write the channels into {path}, e.g. x1 = "column @ mm", F1 ='
            f' "column @ kN"; then: pysindy-nrf inspect --mapping {path}'
        )
    if lacks_motion(proposals):
        return (
            "No column is known to be a motion, so the proposal is not complete. Write"
            f' one into {path}, e.g. x1 = "column @ mm"; then: pysindy-nrf inspect'
            f" --mapping {path}"
        )

    n_doubtful = sum(bool(proposal.doubts) for proposal in proposals)
    ask = "Every channel is named or has a unit"
    if n_doubtful:
        ask = f"Look at the {n_doubtful} with a question mark"
    if without_clock:
        ask += (
            f"; the file has no time, so write its sampling rate into {path}, fs = .."
        )
    step = f"{ask}; then: pysindy-nrf run --mapping {path}"
    if is_element_alone(proposals):
        step += (
            "\nIf an element was tested alone, without a mass, add: --known-mass 1=0"
        )
    return step


@click.command("laws", short_help="List the force laws that storeys may have.")
@click.argument("words", nargs=-1)
@opt.laws_option
@opt.json_option
def list_laws(words: tuple[str, ...], as_json: bool) -> None:
    """List the force laws: name for --law, family, formula, and what it describes.
    WORDS choose among them.

    \b
    Examples
      pysindy-nrf laws
      pysindy-nrf laws friction
    """
    from ..laws import registry

    session = Session(as_json)
    rows = []
    for law in sorted(registry().values(), key=lambda law: (law.family, law.name)):
        row = _data_of_law(law)
        described = " ".join(row.values()).lower()
        if all(word.lower() in described for word in words):
            rows.append(row)
            session.say(
                f"{row['name']}  ({row['family']})",
                f"    {row['describes']}",
                f"    {row['formula']}",
            )
    session.say(
        "\nThe page 'Catalogue of force laws' of the documentation draws each of them."
    )
    session.emit({"laws": rows})


def _data_of_law(law: type[ForceLaw]) -> dict[str, str]:
    """What a law is, as plain data."""
    from ..report.words import summary_of

    try:
        formula = law().equation()
    except (NRFError, TypeError):  # it takes arguments
        formula = ""
    return {
        "name": law.name,
        "family": law.family,
        "formula": formula,
        "describes": summary_of(law),
    }


@click.command(short_help="Run a model alone under the forces of a file.")
@click.argument("model", type=PATH)
@click.argument("forces", required=False, type=PATH)
@opt.map_option
@opt.unit_option
@opt.rate_option
@opt.hold_option
@opt.mapping_option
@opt.laws_option
@opt.choice(
    "--method",
    ["default", "newmark"],
    "Order 8 with error control, or average-acceleration Newmark, one step a sample.",
    "default",
)
@click.option(
    "--x0",
    type=NUMBERS,
    help="Displacements at the start, m: 0.001,0,0. At rest if left out.",
)
@click.option("--v0", type=NUMBERS, help="Velocities at the start, m/s.")
@opt.output(
    "simulation.csv", "File of the record: .csv, .parquet or .uff.", single=True
)
@opt.json_option
def simulate(
    model: Path,
    forces: Path | None,
    as_json: bool,
    **options: Unpack[SimulationOptions],
) -> None:
    """Run a model alone under the forces of a file and write the motion.

    MODEL is model.json of identify or closed_loop.json of close-loop. FORCES holds F1..
    (N) and ag (m/s^2), those that act, with a time column t or --fs, and channels that
    the laws read (a voltage); motions in it are left out. A mapping file that names one
    test may stand for it.

    \b
    Examples
      pysindy-nrf simulate nrf_output/model.json shaker.csv -o answer.parquet
      pysindy-nrf simulate nrf_output/model.json quake.csv --map ag='table @ g'
      pysindy-nrf simulate nrf_output/model.json tomorrow.csv --mapping campaign.toml
    """
    from .. import simulation
    from ..chain.model import ChainModel
    from ..records.files import describe, write_record
    from ..records.files.reading import read_excitation
    from ..records.files.summary import summary
    from ..records.hold import BAND_LIMITED

    session = Session(as_json)
    structure = ChainModel.from_json(model)
    mapping, how = opt.mapping_of(options)
    say_if_compiling()
    name = None if forces else mapping.name
    test = _one_test(forces, mapping)
    load = read_excitation(test, structure.n_dof, name=name, **how)
    with session.listening():
        run = simulation.simulate(
            structure,
            load.force,
            1.0 / load.fs,
            base_acceleration=load.base_acceleration,
            covariates=load.covariates or None,
            name=load.name,
            method=options["method"],
            x0=options["x0"],
            v0=options["v0"],
            hold=options["hold"] or mapping.hold or BAND_LIMITED,
        )
    run = run.starting_at(load.t0)

    session.conclude(describe(run))
    session.add_warnings(_beyond_the_data(structure, run))
    path = options["output"]
    with session.writing() as folder:
        write_record(run, folder / path.name)
    session.emit({"record": summary(run)}, [path])
    session.say(f"\nWritten: {path}")


def _one_test(forces: Path | None, mapping: MappingFile) -> AnyPath | list[AnyPath]:
    """The file given, or the one test that the mapping file names."""
    if forces is not None:
        return forces
    if mapping.together and mapping.files:
        return [*mapping.files]
    if len(mapping.files) == 1:
        return mapping.files[0]
    why = "no file is named"
    if mapping.files:
        why = f"the mapping file names {len(mapping.files)} tests"
    raise click.UsageError(
        f"Missing argument 'FORCES': {why}; give the file with the forces."
    )


def _beyond_the_data(model: ChainModel, run: Record) -> list[str]:
    """Storeys that move further than the data the model was fitted to."""
    assert run.displacement is not None  # a run has all motions
    drifts = np.abs(np.diff(run.displacement, axis=1, prepend=0.0)).max(axis=0)
    warnings = []
    for site, region in model.visited.items():
        if not site.is_storey:
            continue
        drift = float(drifts[site.p - 1])
        reached = max(abs(region.low[1]), abs(region.high[1]))
        if drift > BEYOND_THE_DATA * reached:
            unit = model.units.of("mm")
            warnings.append(
                f"{site} drifts {1e3 * drift:.3g} {unit}; the data of the model reached"
                f" {1e3 * reached:.3g} {unit}: its force beyond is a guess."
            )
    return warnings
