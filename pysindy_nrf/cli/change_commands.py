"""Commands on what a structure does and how it changed: ``forces`` and ``damage``."""

from pathlib import Path
from typing import Any

import click
import numpy as np
import pandas as pd

from . import options as opt
from .options import Session


@click.command(short_help="Storey forces, the force of a damper, dissipated energy.")
@click.argument("file", type=opt.PATH)
@opt.record_options
@click.option(
    "--bare",
    type=opt.PATH,
    help="A test of the structure without its damper: the damper's force (eq. 21).",
)
@opt.degree_option(3, "Total degree of the power series, or box k,q.")
@opt.model_options
@opt.written_options
def forces(file: Path, bare: Path | None, as_json: bool, **options: Any) -> None:
    """Storey forces along a record, the energy that each storey dissipates, and the
    force of a damper.

    FILE is read as by identify. With --bare, a test of the same structure without its
    damper, the linear force found there is subtracted: what is left is the damper's,
    storey by storey.

    \b
    Examples
      pysindy-nrf forces shaker.csv pysindy-nrf forces with_damper.csv --bare
      without.csv --law 'storey 4=power_series+dahl'
    """
    from ..chain.model import as_segments, storey_names
    from ..identification import damper_force, dissipated_energy
    from ..records.files import write_table

    session = Session(as_json)
    records = opt.records_of(session, options, [file], *([[bare]] if bare else []))
    with session.listening():
        estimator = opt.regressor_of(options).fit(records[0])
        linear = (
            None
            if bare is None
            else opt.regressor_of(options)
            .set_params(degree=1, laws=None)
            .fit(records[1])
        )
        data = as_segments(estimator, records[0])
        energy = dissipated_energy(estimator, data, linear)
        names = storey_names(estimator.model_)
        found = pd.DataFrame(
            estimator.model_.restoring_force(data), columns=names, index=energy.index
        )
        device = (
            None
            if linear is None
            else damper_force(estimator, linear, data).add_prefix("damper, ")
        )
    table = pd.DataFrame(
        {"rms (N)": np.sqrt((found**2).mean()), "peak (N)": found.abs().max()}
    )
    if device is not None:
        table["damper, rms (N)"] = np.sqrt((device**2).mean()).to_numpy()
    table["dissipated (J)" if device is None else "dissipated by the damper (J)"] = (
        last
    ) = energy.iloc[-1]
    table["share (%)"] = 100 * last / last.sum()
    session.headed("Forces of the storeys", opt.table(table))
    with session.aside() as folder:
        written = [
            write_table(
                (found if device is None else found.join(device)).rename_axis("t"),
                folder / "forces.csv",
            ),
            write_table(energy.rename_axis("t"), folder / "energy.csv"),
            write_table(table.rename_axis("storey"), folder / "storeys.csv"),
        ]
        if options["figures"]:
            from ..discrepancy.residual import loops_of
            from ..report.figures.forces import energy_figure, loop_figures
            from ..report.figures.matplotlib_renderer import save

            loops = loops_of(estimator.model_, data, estimator.problem_.filters(data))
            written += save(
                folder / "loops.png", loop_figures(estimator.model_, loops), columns=2
            )
            written += save(folder / "energy.png", [energy_figure(energy)])
    session.finish({"storeys": table, "masses_kg": estimator.masses_}, written)


@click.command(
    short_help="What changed between two tests: where, how much, which term."
)
@click.argument("before", type=opt.PATH)
@click.argument("after", type=opt.PATH)
@opt.record_options
@opt.degree_option(1, "Total degree of the declared storeys, or box k,q.")
@opt.model_options
@click.option(
    "--least",
    type=float,
    default=1.0,
    help="Smallest change of interest, % of the spring or mass.",
)
@click.option(
    "--level",
    type=float,
    default=0.01,
    help="Level of significance, of all places and terms together.",
)
@click.option(
    "--blocks",
    type=click.IntRange(5),
    default=20,
    help="Pieces of each test, left out in turn.",
)
@opt.written_options
def damage(before: Path, after: Path, as_json: bool, **options: Any) -> None:
    """Say which storey's force, or which mass, changed between two tests of one
    structure.

    BEFORE and AFTER are read as by identify. Forces are compared where both tests
    moved, so that another amplitude is no change; a declared law with a state or a
    shape (--law) is compared on its own parameters.

    \b
    Examples
      pysindy-nrf damage may.csv october.csv pysindy-nrf damage may.csv october.csv
      --law 'storey 4=power_series+dahl' --band 0.5,40 --least 2
    """
    from ..monitoring import compare_tests
    from ..records.files import write_table

    session = Session(as_json)
    records = opt.records_of(session, options, [before], [after])
    with session.listening():
        limits = {key: options[key] for key in ("level", "least")}
        report = compare_tests(
            opt.regressor_of(options), *records, n_blocks=options["blocks"], **limits
        )
    session.headed("What changed", str(report))
    if len(report.changed):
        session.say("", opt.table(report.changed))
    session.headed("The tests fitted apart", opt.table(report.table))
    with session.aside() as folder:
        tables = {"changed": report.changed, "fitted_apart": report.table}
        written = [
            write_table(frame, folder / f"{name}.csv") for name, frame in tables.items()
        ]
        if options["figures"]:
            from ..report.figures.matplotlib_renderer import save
            from ..report.figures.motion import change_figure

            sites = [f"storey {cut.storey}" for cut in report.comparison.cuts]
            largest = max(report.map(site)["change"].abs().max() for site in sites)
            maps = [change_figure(report.map(site), site, largest) for site in sites]
            written += save(folder / "change.png", maps, columns=min(3, len(maps)))
    words = {"said": str(report).splitlines(), "damaged": report.damaged}
    listed = {
        "changed": report.changed,
        "explained": report.explained,
        "fitted_apart": report.table,
    }
    masses = [
        {"before": a, "after": b}
        for a, b in zip(report.before.masses, report.after.masses)
    ]
    session.finish(
        words
        | {k: t.to_dict("records") for k, t in listed.items()}
        | {"masses_kg": masses},
        written,
    )
