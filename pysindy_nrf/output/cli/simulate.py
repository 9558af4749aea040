"""``pysindy-nrf simulate``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import numpy as np

from .options import Numbers, json_option, map_option, mapping_option, rate_option, said_of, unit_option
from .session import Session


@click.command(short_help="Run a model alone under the forces of a file.")
@click.argument("model", type=click.Path(path_type=Path))
@click.argument("forces", required=False, type=click.Path(path_type=Path))
@map_option
@unit_option
@rate_option
@mapping_option
@click.option(
    "--method",
    type=click.Choice(["default", "newmark"]),
    default="default",
    help="Order 8 with error control, or average-acceleration Newmark, one step a sample.",
)
@click.option("--x0", type=Numbers(), help="Displacements at the start, m: 0.001,0,0. At rest if left out.")
@click.option("--v0", type=Numbers(), help="Velocities at the start, m/s.")
@click.option(
    "--output",
    "-o",
    type=click.Path(path_type=Path, dir_okay=False),
    default=Path("simulation.csv"),
    help="File of the record: .csv, .parquet or .uff.",
)
@json_option
def simulate(model: Path, forces: Path | None, as_json: bool, **options: Any) -> None:
    """Run a model alone under the forces of a file and write the motion.

    MODEL is a model.json as identify and close-loop write it. FORCES holds F1.. (N) and ag (m/s^2), those that
    act, with a time column t or --fs, and channels that the laws read (a voltage); motions in it are left out. A
    mapping file that names one test may stand for it.

    \b
    Examples
      pysindy-nrf simulate nrf_output/model.json shaker.csv -o answer.parquet
      pysindy-nrf simulate nrf_output/model.json quake.csv --map ag='table @ g' -o answer.csv
      pysindy-nrf simulate nrf_output/model.json tomorrow.csv --mapping campaign.toml
    """
    from ...data.io import describe, read_excitation, summary, write_record
    from ...regression.chain_model import ChainModel

    session = Session(as_json)
    structure = ChainModel.from_json(model)
    said, how = said_of(options)
    load = read_excitation(_one_test(forces, said), structure.n_dof, name=None if forces else said.name, **how)
    with session.listening():
        for _ in session.progress([None], "simulating"):
            run = structure.simulate(
                load.force,
                1.0 / load.fs,
                method=options["method"],
                x0=options["x0"],
                v0=options["v0"],
                base_acceleration=load.base_acceleration,
                covariates=load.covariates or None,
                name=load.name,
            )
    run.t0 = load.t0
    beyond = _beyond(structure, run)
    session.say(describe(run))
    session.warnings += beyond
    session.take_care()
    path = write_record(run, options["output"])
    session.emit({"record": summary(run)}, [path])
    session.say(f"\nWritten: {path}")


def _one_test(forces: Path | None, said: Any) -> Any:
    """The file given, or the one test that the mapping file names."""
    if forces is not None:
        return forces
    if said.together and said.files:
        return list(said.files)
    if len(said.files) != 1:
        many = f"the mapping file names {len(said.files)} tests" if said.files else "no file is named"
        raise click.UsageError(f"Missing argument 'FORCES': {many}; give the file with the forces.")
    return said.files[0]


def _beyond(model: Any, run: Any) -> list[str]:
    """Storeys that move further than the data the model was fitted to."""
    out = []
    drifts = np.diff(run.displacement, axis=1, prepend=0.0)
    for site, region in model.visited.items():
        if not site.is_storey:
            continue
        most, known = np.abs(drifts[:, site.p - 1]).max(), max(abs(region.low[1]), abs(region.high[1]))
        if most > 1.05 * known:
            out.append(
                f"{site} drifts {1e3 * most:.3g} mm; the data of the model reached {1e3 * known:.3g} mm: "
                "its force beyond is a guess."
            )
    return out
