"""Commands on records and runs: ``inspect``, ``simulate``, ``plan`` a test, ``report``
as a page.
"""

import json
from contextlib import suppress
from pathlib import Path
from typing import Any

import click
import numpy as np

from ..exceptions import MissingExtraError, NRFError
from . import options as opt
from .options import Session


@click.command(short_help="Say what a file holds and how it was understood.")
@opt.files_options
@click.option(
    "--write-mapping",
    type=opt.PATH,
    help="Propose a channel for every column, in a new TOML file.",
)
@opt.json_option
def inspect(
    files: tuple[Path, ...], as_json: bool, write_mapping: Path | None, **options: Any
) -> None:
    """Say what a file holds and how it was understood. Nothing is solved, nothing is
    written.

    For each FILE: clock, channels with their size in SI units and where each came from,
    columns that were not used, and what looks wrong (units, signs and delays that
    contradict each other; dead, clipped, spiky channels).

    \b
    Examples
      pysindy-nrf inspect shaker.csv
      pysindy-nrf inspect shaker.csv --map F2='Shaker @ kN' --unit a=g --unit x=mm
      pysindy-nrf inspect tower.csv --write-mapping tower.toml
      pysindy-nrf inspect --mapping campaign.toml
    """
    from ..records.checks.channel_checks import data_warnings
    from ..records.files import describe, read_table
    from ..records.files.summary import contents, summary

    session = Session(as_json)
    out = []
    if write_mapping is not None:
        _propose(session, files, write_mapping)
        files, options["mapping_file"] = (), write_mapping
    try:
        readings = opt.readings_of(files, options)
    except NRFError:
        with suppress(
            NRFError, MissingExtraError
        ):  # the columns of the file, so that they can be mapped
            for path in files[:1]:
                session.say(contents(read_table(path)) + "\n")
        raise
    for reading in readings:
        with session.listening():
            findings = data_warnings(reading.record)
        session.say(describe(reading))
        session.say(
            *([f"  take care: {one}" for one in findings] or ["  nothing looks wrong"]),
            "",
        )
        read = {
            "file": reading.table.path,
            "kind": reading.table.kind,
            "notes": reading.table.notes,
        }
        sources = {
            name: {"from": source.text, "unit": source.unit}
            for name, source in reading.sources.items()
        }
        used = {
            "clock": reading.clock,
            "sources": sources,
            "not_used": list(reading.unused),
            "doubts": findings,
        }
        out.append(summary(reading.record) | read | used)
    session.emit({"records": out})


def _propose(session: Session, files: tuple[Path, ...], path: Path) -> None:
    """Write a mapping file with a channel for every column that says what it is."""
    from ..common.files import atomic_write
    from ..records.files import read_table
    from ..records.files.mapping import mapping_text, propose

    if not files:
        raise click.UsageError(
            "--write-mapping takes the FILE whose columns are to be mapped."
        )
    if path.exists():
        raise NRFError(f"{path} exists, and would be lost", "Give another name.")
    if any(one.resolve().parent != path.resolve().parent for one in files):
        raise NRFError(
            f"{path} is not in the folder of its files", "Write it beside them."
        )
    found = propose(read_table(files[0]))
    text = mapping_text(files, found)
    with atomic_write(path) as file:
        file.write(text)
    doubtful = sum(bool(one.doubts) for one in found)
    session.say(f"Proposed, in {path}:", "", text)
    ask = (
        f"Look at the {doubtful} with a question mark"
        if doubtful
        else "Every channel is named or has a unit"
    )
    session.say(f"{ask}; then: pysindy-nrf run --mapping {path}", "")


@click.command("laws", short_help="List the force laws that storeys may have.")
@click.argument("words", nargs=-1)
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

    session, rows = Session(as_json), []
    for name, law in sorted(
        registry().items(), key=lambda item: (item[1].family, item[0])
    ):
        about = (law.__doc__ or "").strip().splitlines()[0].replace("``", "")
        try:
            formula = law().equation()
        except (NRFError, TypeError):
            formula = ""
        row = {
            "name": name,
            "family": law.family,
            "formula": formula,
            "describes": about,
        }
        if all(word.lower() in " ".join(row.values()).lower() for word in words):
            rows.append(row)
            session.say(f"{name}  ({law.family})", f"    {about}", f"    {formula}")
    session.say(
        "\nThe page 'Catalogue of force laws' of the documentation draws each of them."
    )
    session.emit({"laws": rows})


@click.command(short_help="Run a model alone under the forces of a file.")
@click.argument("model", type=opt.PATH)
@click.argument("forces", required=False, type=opt.PATH)
@opt.map_option
@opt.unit_option
@opt.rate_option
@opt.mapping_option
@opt.choice(
    "--method",
    ["default", "newmark"],
    "Order 8 with error control, or average-acceleration Newmark, one step a sample.",
    "default",
)
@click.option(
    "--x0",
    type=opt.NUMBERS,
    help="Displacements at the start, m: 0.001,0,0. At rest if left out.",
)
@click.option("--v0", type=opt.NUMBERS, help="Velocities at the start, m/s.")
@opt.output(
    "simulation.csv", "File of the record: .csv, .parquet or .uff.", single=True
)
@opt.json_option
def simulate(model: Path, forces: Path | None, as_json: bool, **options: Any) -> None:
    """Run a model alone under the forces of a file and write the motion.

    MODEL is model.json of identify or closed_loop.json of close-loop. FORCES holds F1..
    (N) and ag (m/s^2), those that act, with a time column t or --fs, and channels that
    the laws read (a voltage); motions in it are left out. A mapping file that names one
    test may stand for it.

    \b
    Examples
      pysindy-nrf simulate nrf_output/model.json shaker.csv -o answer.parquet
      pysindy-nrf simulate nrf_output/model.json quake.csv --map ag='table @ g' -o
      answer.csv pysindy-nrf simulate nrf_output/model.json tomorrow.csv --mapping
      campaign.toml
    """
    from .. import simulation
    from ..chain.model import ChainModel
    from ..records.files import describe, write_record
    from ..records.files.reading import read_excitation
    from ..records.files.summary import summary

    session = Session(as_json)
    structure = ChainModel.from_json(model)
    said, how = opt.said_of(options)
    opt.say_if_compiling()
    load = read_excitation(
        _one_test(forces, said),
        structure.n_dof,
        name=None if forces else said.name,
        **how,
    )
    with session.listening():
        run = simulation.simulate(
            structure,
            load.force,
            1.0 / load.fs,
            base_acceleration=load.base_acceleration,
            covariates=load.covariates or None,
            name=load.name,
            **{key: options[key] for key in ("method", "x0", "v0")},
        )
    run.t0 = load.t0
    session.say(describe(run))
    session.warnings += _beyond(structure, run)
    path = options["output"]
    with session.aside() as folder:
        write_record(run, folder / path.name)
    session.emit({"record": summary(run)}, [path])
    session.say(f"\nWritten: {path}")


def _one_test(forces: Path | None, said: Any) -> Any:
    """The file given, or the one test that the mapping file names."""
    if forces is not None:
        return forces
    if said.together and said.files:
        return list(said.files)
    if len(said.files) != 1:
        many = (
            f"the mapping file names {len(said.files)} tests"
            if said.files
            else "no file is named"
        )
        raise click.UsageError(
            f"Missing argument 'FORCES': {many}; give the file with the forces."
        )
    return said.files[0]


def _beyond(model: Any, run: Any) -> list[str]:
    """Storeys that move further than the data the model was fitted to."""
    out = []
    drifts = np.diff(run.displacement, axis=1, prepend=0.0)
    for site, region in (
        (site, box) for site, box in model.visited.items() if site.is_storey
    ):
        most, known = (
            np.abs(drifts[:, site.p - 1]).max(),
            max(abs(region.low[1]), abs(region.high[1])),
        )
        if most > 1.05 * known:
            out.append(
                f"{site} drifts {1e3 * most:.3g} mm; the data of the model reached"
                f" {1e3 * known:.3g} mm: its force beyond is a guess."
            )
    return out


@click.command(short_help="Say which floor to hit, which sensor to add.")
@click.argument("floors", type=click.IntRange(1))
@opt.link_option
@click.option(
    "--can-hit",
    type=opt.FLOORS,
    help="Floors that a hammer or shaker reaches: 1,3. All if left out.",
)
@click.option(
    "--sensors",
    type=opt.FLOORS,
    help="Floors whose motion is measured: 1,2,4. All if left out.",
)
@click.option(
    "--unknown",
    type=opt.FLOORS,
    help="Floors on which a force acts that is not measured.",
)
@opt.mass_option
@click.option("--most", type=click.IntRange(1), default=2, help="Floors hit at most.")
@click.option(
    "--model",
    type=opt.PATH,
    help="A first guess (model.json): ranks floors by how modes respond.",
)
@opt.json_option
def plan(floors: int, as_json: bool, **options: Any) -> None:
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
    model = None if options["model"] is None else ChainModel.from_json(options["model"])
    if model is not None and model.n_dof != floors:
        raise click.UsageError(f"The model has {model.n_dof} floors, not {floors}.")
    found = Chain(floors, options["links"]).plan(
        can_hit=options["can_hit"],
        sensors=options["sensors"],
        unknown=options["unknown"] or (),
        known_masses=options["masses"],
        model=model,
        most=min(options["most"], floors),
    )
    advice = [opt.in_options(one) for one in found.advice]
    if advice:
        session.say(*advice)
    shown = found.table.head(10).assign(
        hit=found.table["hit"].map(lambda hit: " and ".join(map(str, hit))),
        identifies=[
            f"{100 * share:.0f} %" for share in found.table["identifies"].head(10)
        ],
        left=found.table["left"].replace("", "nothing"),
    )
    if model is None and "response" in shown:
        shown = shown.drop(columns="response")
    if len(shown):
        session.headed("Tests, the best first", opt.table(shown.reset_index(drop=True)))
    session.emit({"advice": advice, "tests": found.table.to_dict("records")})


@click.command(short_help="Write one page (HTML) of a result or of records.")
@opt.files_options
@opt.band_option
@click.option("--title", help="Title of the page.")
@opt.output("report.html", "File of the page.", single=True)
@opt.json_option
def report(files: tuple[Path, ...], as_json: bool, **options: Any) -> None:
    """Write one page (HTML, works offline) of a result, over records.

    FILE is a result (model.json of identify, closed_loop.json of close-loop, what they
    print with --json) and files of records to draw beside it. The band is that of the
    result if --band is left out.

    \b
    Examples
      pysindy-nrf report nrf_output/model.json shaker.csv --unit a=g -o frame.html
    """
    from ..report import write_html

    session = Session(as_json)
    results = [path for path in files if path.suffix.lower() == ".json"]
    if len(results) != 1:
        raise click.UsageError(
            "report takes one result (.json); records are identified by run or identify"
            " first."
        )
    readings = opt.readings_of(
        [path for path in files if path not in results], options, needed=False
    )
    records = [reading.record for reading in readings]
    with session.listening():
        subject = _result(results[0])
        said = {
            "title": options["title"],
            "notes": tuple(session.warnings),
            "band": options["band"],
        }
        with session.aside() as folder:
            write_html(
                folder / options["output"].name, subject, records or None, **said
            )
    session.take_care()
    session.emit(
        {"title": options["title"], "records": [rec.name for rec in records]},
        [options["output"]],
    )
    session.say(f"Written: {options['output']}   (open it in a browser)")


def _result(path: Path) -> Any:
    """The model of a result file."""
    from ..chain.model import ChainModel
    from ..common.files import plain_json
    from ..records.files.table import check_file

    check_file(path, 200_000_000)
    inner = None
    with suppress(
        ValueError, RecursionError, AttributeError
    ):  # it holds no model; from_json says what is wrong
        inner = plain_json(path.read_text(encoding="utf-8")).get("model")
    return ChainModel.from_json(path if inner is None else json.dumps(inner))
