"""Options of the commands: small texts turned into what the library takes, or a usage error."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import Any

import click

output_option = click.option(
    "--output",
    "-o",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("nrf_output"),
    help="Folder for the model, tables and figures.",
)
files_argument = click.argument("files", nargs=-1, metavar="FILE...", type=click.Path(path_type=Path))
json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON instead of words.")
mapping_option = click.option(
    "--mapping",
    "mapping_file",
    type=click.Path(path_type=Path),
    help="A TOML file that says all of this, and names the files: see docs/files.md. Options go before it.",
)


def record_options(command: Any) -> Any:
    """Options of every command that reads records: channels, units, clock, coordinates."""
    for option in reversed((map_option, unit_option, rate_option, coordinates_option, mapping_option)):
        command = option(command)
    return command


def readings_of(files: Any, options: dict[str, Any], session: Any = None, needed: bool = True) -> list[Any]:
    """What the files hold, by the record options and the mapping file."""
    from ...data.io import inspect_record

    said, how = said_of(options)
    how["coordinates"] = options["coordinates"] or said.coordinates
    files = list(files or said.files)
    if not files and needed:
        raise click.UsageError("Missing argument 'FILE...': give a file with the channels of a test.")
    tests = [files] if said.together and files else files
    names = [said.name if len(tests) == 1 else None] * len(tests)
    rows = list(zip(tests, names))
    progress = rows if session is None else session.progress(rows, "reading")
    return [inspect_record(test, name=name, **how) for test, name in progress]


def said_of(options: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
    """The mapping file, and channels, units and clock by it and by the options, which go before it."""
    from ...data.io import MappingFile, read_mapping

    said = MappingFile(Path()) if options["mapping_file"] is None else read_mapping(options["mapping_file"])
    how: dict[str, Any] = {
        "mapping": said.channels | options["mapping"],
        "units": said.units | options["units"],
        "fs": said.fs if options["fs"] is None else options["fs"],
    }
    return said, how


def once(ctx: Any, param: Any, pairs: Any) -> dict:
    """Pairs as a mapping; a key given twice is a usage error."""
    out: dict = {}
    for key, value in pairs:
        if key in out:
            raise click.BadParameter(f"{key}= is given twice.", ctx, param)
        out[key] = value
    return out


class Pair(click.ParamType):
    """``KEY=VALUE``.

    Parameters
    ----------
    name : str
        Shown in the help.
    """

    def __init__(self, name: str) -> None:
        self.name = name

    def convert(self, value: Any, param: Any, ctx: Any) -> tuple[str, str]:
        """Split at the first ``=``."""
        if isinstance(value, tuple):
            return value
        with contextlib.suppress(UnicodeError):  # bytes of a terminal that is said to know only ASCII
            value = os.fsencode(value).decode("utf-8")
        key, sign, text = value.partition("=")
        if not sign or not key.strip() or not text.strip():
            self.fail(f"{value!r} is not of the form {self.name}", param, ctx)
        return key.strip(), text.strip()


class LawNames(click.ParamType):
    """``SITE=NAME+NAME``."""

    name = "SITE=NAME+NAME"

    def convert(self, value: Any, param: Any, ctx: Any) -> tuple[str, list[str]]:
        """Split into a site and the names of laws."""
        if isinstance(value, tuple):
            return value
        from ... import laws

        known = laws.registry()
        site, text = Pair(self.name).convert(value, param, ctx)
        names = [name.strip() for name in text.split("+")]
        for name in names:
            if name not in known:
                self.fail(f"there is no law {name!r}. Known are {', '.join(sorted(known))}.", param, ctx)
        return site, names


class Link(click.ParamType):
    """A link between floors, in the one grammar of sites."""

    name = "SITE"

    def convert(self, value: Any, param: Any, ctx: Any) -> str:
        """The text, if it is a site."""
        from ...exceptions import ChainError
        from ...mechanics.sites import Site

        try:
            return str(Site(value))
        except ChainError as error:
            self.fail(str(error), param, ctx)


class Mass(click.ParamType):
    """``DOF=KG``."""

    name = "DOF=KG"

    def convert(self, value: Any, param: Any, ctx: Any) -> tuple[int, float]:
        """Split into a DOF and a mass."""
        if isinstance(value, tuple):
            return value
        key, _, text = value.partition("=")
        try:
            return int(key), float(text)
        except ValueError:
            self.fail(f"{value!r} is not a floor and its mass in kg, e.g. 2=12.4", param, ctx)


class Band(click.ParamType):
    """``LO,HI`` in Hz; ``none`` for an open end."""

    name = "LO,HI"

    def convert(self, value: Any, param: Any, ctx: Any) -> tuple[float | None, float | None]:
        """Split into two frequencies."""
        if isinstance(value, tuple):
            return value
        parts = [p.strip().lower() for p in value.split(",")]
        try:
            low, high = (None if p in ("none", "", "inf") else float(p) for p in parts)
        except ValueError:
            self.fail(f"{value!r} is not a band, e.g. 0.5,30 (Hz)", param, ctx)
        return low, high


class Degree(click.ParamType):
    """A total degree, ``3``, or a box ``K,Q``."""

    name = "N|K,Q"

    def convert(self, value: Any, param: Any, ctx: Any) -> int | tuple[int, int]:
        """A whole number, or two."""
        if not isinstance(value, str):
            return value
        try:
            numbers = tuple(int(p) for p in value.split(","))
        except ValueError:
            numbers = ()
        if len(numbers) not in (1, 2) or any(n < 0 for n in numbers):
            self.fail(f"{value!r} is not a degree (3) or a box k,q (2,3)", param, ctx)
        return numbers[0] if len(numbers) == 1 else (numbers[0], numbers[1])


class SiteDegree(click.ParamType):
    """``SITE=DEGREE``."""

    name = "SITE=DEGREE"

    def convert(self, value: Any, param: Any, ctx: Any) -> tuple[str, int | tuple[int, int]]:
        """Split into a site and its degree or box."""
        if isinstance(value, tuple):
            return value
        site, text = Pair(self.name).convert(value, param, ctx)
        return site, Degree().convert(text, param, ctx)


class Numbers(click.ParamType):
    """Numbers with commas between them."""

    name = "A,B,..."

    def convert(self, value: Any, param: Any, ctx: Any) -> list[float]:
        """Split at commas."""
        if isinstance(value, list):
            return value
        try:
            return [float(p) for p in value.split(",")]
        except ValueError:
            self.fail(f"{value!r} is not numbers with commas between them, e.g. 0.001,0,0", param, ctx)


class Range(click.ParamType):
    """Whole numbers: ``1-7``, or ``1,3,5``."""

    name = "A-B|A,B,..."

    def convert(self, value: Any, param: Any, ctx: Any) -> list[int]:
        """Spell out."""
        if isinstance(value, list):
            return value
        low, dash, high = value.partition("-")
        try:
            numbers = list(range(int(low), int(high) + 1)) if dash else [int(p) for p in value.split(",")]
        except ValueError:
            numbers = []
        if not numbers or min(numbers) < 0 or max(numbers) > 50:
            self.fail(f"{value!r} is not whole numbers up to 50, e.g. 1-7 or 1,3,5", param, ctx)
        return numbers


class Floors(Range):
    """Floors: ``1,3`` or ``1-4``."""

    name = "I,J,..."

    def convert(self, value: Any, param: Any, ctx: Any) -> list[int]:
        """Spell out."""
        if isinstance(value, str) and value.strip().lower() == "none":
            return []
        return super().convert(value, param, ctx)


def laws_of(pairs: Any, degree: Any) -> dict[str, list] | None:
    """Sites and names of laws, as :data:`law_option` gives them, as laws by site."""
    if not pairs:
        return None
    from ... import laws

    known = laws.registry()
    out: dict[str, list] = {}
    for site, names in pairs:
        made = [laws.PowerSeries(degree) if name == "power_series" else known[name]() for name in names]
        out.setdefault(site, []).extend(made)
    return out


# -- options that several commands have ---------------------------------------------------------------

map_option = click.option(
    "--map",
    "mapping",
    multiple=True,
    type=Pair("CHANNEL=COLUMN"),
    callback=once,
    help='Which column is which channel: "name", "-name[:, 2] * 9.81", "name @ mm", "none", or "unknown" '
    "for a force that acts and was not measured.",
)
unit_option = click.option(
    "--unit",
    "units",
    multiple=True,
    type=Pair("CHANNEL=UNIT"),
    callback=once,
    help="Unit of a channel (x3=in) or kind (a=g, F=kN).",
)
rate_option = click.option("--fs", type=float, help="Sampling rate in Hz, where the file has no time.")
coordinates_option = click.option(
    "--coordinates",
    type=click.Choice(["relative", "absolute"]),
    help="Whether velocities and displacements are relative to the base (what you get if nothing is said).",
)
law_option = click.option(
    "--law",
    "laws",
    multiple=True,
    type=LawNames(),
    help='Laws at a site in place of the power series: "storey 1=linear_elastic+linear_viscous+dahl".',
)
link_option = click.option(
    "--link", "links", multiple=True, type=Link(), help='A further link between floors: "link 3-1", "ground 2".'
)
mass_option = click.option(
    "--known-mass",
    "masses",
    multiple=True,
    type=Mass(),
    callback=once,
    help="A mass that is known: 2=12.4. Needed where no force is measured.",
)
band_option = click.option(
    "--band", type=Band(), help="Frequency band in Hz in which everything is fitted and judged: 0.5,30."
)
