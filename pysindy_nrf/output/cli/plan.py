"""``pysindy-nrf plan``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from .options import Floors, json_option, link_option, mass_option
from .session import Session


@click.command(short_help="Say which floor to hit, which sensor to add.")
@click.argument("floors", type=click.IntRange(1))
@link_option
@click.option("--can-hit", type=Floors(), help="Floors that a hammer or shaker reaches: 1,3. All if left out.")
@click.option("--sensors", type=Floors(), help="Floors whose motion is measured: 1,2,4. All if left out.")
@click.option("--unknown", type=Floors(), help="Floors on which a force acts that is not measured.")
@mass_option
@click.option("--most", type=click.IntRange(1), default=2, help="Floors hit at most.")
@click.option(
    "--model", type=click.Path(path_type=Path), help="A first guess (model.json): ranks floors by how modes respond."
)
@json_option
def plan(floors: int, as_json: bool, **options: Any) -> None:
    """Say which floor to hit, or which sensor to add, before a test of a structure with FLOORS floors.

    \b
    Examples
      pysindy-nrf plan 4
      pysindy-nrf plan 4 --can-hit 1,2 --sensors 1,2,4 --unknown 3
      pysindy-nrf plan 3 --model nrf_output/model.json
    """
    from ...mechanics.chain import Chain
    from ...regression.chain_model import ChainModel
    from .text import heading, table

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
    for line in found.advice:
        session.say(line)
    shown = found.table.head(10).assign(
        hit=found.table["hit"].map(lambda hit: " and ".join(map(str, hit))),
        identifies=[f"{100 * share:.0f} %" for share in found.table["identifies"].head(10)],
        left=found.table["left"].replace("", "nothing"),
    )
    if model is None and "response" in shown:
        shown = shown.drop(columns="response")
    if len(shown):
        session.say(heading("Tests, the best first"))
        session.say(table(shown.reset_index(drop=True)))
    session.emit({"advice": found.advice, "tests": found.table.to_dict("records")})
