"""Options that several commands share, and the records and regressors they describe."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NotRequired, Protocol, TypedDict, TypeVar

import click

from . import parameters
from .own_laws import take_laws
from .parameters import PATH, Band, Degree
from .session import FORCE, NAMED_FILES, Session, working

if TYPE_CHECKING:
    from ..identification.regressor import NRFRegressor
    from ..laws.base import ForceLaw
    from ..records.files.mapping import MappingFile
    from ..records.files.preparation import Preparation
    from ..records.files.reading import Reading
    from ..records.files.tables import AnyPath
    from ..records.record import Record

Command = TypeVar("Command", bound=Callable[..., object] | click.Command)


class Decorator(Protocol):
    """What adds options to a command."""

    def __call__(self, command: Command, /) -> Command:
        """The command with the options."""


class ReadingOptions(TypedDict):
    """Channels, units and clock, as the readers of files take them."""

    mapping: dict[str, str]
    units: dict[str, str]
    fs: float | None


class ExcitationOptions(ReadingOptions):
    """How forces are read: from the file of a test, or by a mapping file."""

    mapping_file: Path | None
    hold: str | None


PreparationOptions = TypedDict(
    "PreparationOptions",
    {
        "from": float | None,
        "to": float | None,
        "resample": float | None,
        "drop_blank": bool,
        "relative_acceleration": bool,
    },
)


class RecordOptions(ExcitationOptions, PreparationOptions):
    """How records are read."""

    coordinates: str | None


class ModelOptions(TypedDict):
    """The chain to be fitted, and how."""

    degree: Degree
    laws: list[tuple[str, list[str]]]
    masses: dict[int, float]
    band: Band | None
    orders: NotRequired[dict[str, Degree]]
    strategy: NotRequired[str]
    estimation: NotRequired[str]


class FitOptions(RecordOptions, ModelOptions):
    """Records and the chain that is fitted to them."""


# -- kinds of options ----------------------------------------------------------


def together(*options: Decorator) -> Decorator:
    """Several options as one decorator, in the order in which help lists them."""

    def decorated(command: Command) -> Command:
        for option in reversed(options):
            command = option(command)
        return command

    return decorated


def keyed(flag: str, name: str, kind: click.ParamType, words: str) -> Decorator:
    """An option that may be given several times, whose pairs become a mapping."""
    return click.option(
        flag, name, multiple=True, type=kind, callback=parameters.once, help=words
    )


def repeated(flag: str, name: str, kind: click.ParamType, words: str) -> Decorator:
    """An option that may be given several times."""
    return click.option(flag, name, multiple=True, type=kind, help=words)


def choice(
    flag: str, values: Sequence[str], words: str, default: str | None = None
) -> Decorator:
    """An option with one of some values."""
    return click.option(flag, type=click.Choice(values), default=default, help=words)


def degree_option(default: int, words: str) -> Decorator:
    """The degree of the power series."""
    return click.option("--degree", type=parameters.DEGREE, default=default, help=words)


def output(name: str | None, words: str, single: bool = False) -> Decorator:
    """The place of results, and whether they may replace files that no run made.

    Parameters
    ----------
    name : str or None
        Where they go by default.
    words : str
    single : bool
        Whether they are one file; else a folder.
    """
    kind = click.Path(path_type=Path, file_okay=single, dir_okay=not single)
    default = None if name is None else Path(name)
    return together(
        click.option("--output", "-o", type=kind, default=default, help=words),
        click.option(
            "--force",
            is_flag=True,
            expose_value=False,
            callback=_keep_force,
            is_eager=True,
            help="Write over files that no earlier run made, inputs included.",
        ),
    )


def _keep_force(context: click.Context, _: click.Parameter, on: bool) -> None:
    context.meta[FORCE] = on


def was_given(option: str) -> bool:
    """Whether an option of the running command was given, not left at its default."""
    source = click.get_current_context().get_parameter_source(option)
    return source is not click.core.ParameterSource.DEFAULT


# -- options -------------------------------------------------------------------

json_option = click.option(
    "--json", "as_json", is_flag=True, help="Print JSON instead of words."
)
excel_option = click.option(
    "--excel/--no-excel",
    default=False,
    help="Write an Excel workbook: masses, coefficients, forces, quality.",
)
figures_option = click.option(
    "--figures/--no-figures", default=True, help="Draw figures (needs matplotlib)."
)
_FOLDER = "Folder for the model, tables and figures"
output_option = output("nrf_output", f"{_FOLDER}.")
demo_output_option = output("nrf_demo", f"{_FOLDER}.")
run_output_option = output(
    None, f"{_FOLDER}; nrf_runs/FILE, or the next that is free, if left out."
)
written_options = together(output_option, figures_option, json_option)

# of every command that reads records: channels, units, clock, coordinates
map_option = keyed(
    "--map",
    "mapping",
    parameters.pair("CHANNEL=COLUMN"),
    'Which column is which channel: "name", "-name[:, 2] * 9.81", "name @ mm", "none",'
    ' or "unknown" for a force that acts and was not measured.',
)
unit_option = keyed(
    "--unit",
    "units",
    parameters.pair("CHANNEL=UNIT"),
    "Unit of a channel (x3=in) or kind (a=g, F=kN).",
)
rate_option = click.option(
    "--fs", type=float, help="Sampling rate in Hz, where the file has no time."
)
coordinates_option = choice(
    "--coordinates",
    ["relative", "absolute"],
    "Whether velocities and displacements are relative to the base (the default).",
)
hold_option = choice(
    "--hold",
    ["cubic", "linear", "zero"],
    "Course of the forces between the samples: band-limited (cubic), straight, or"
    " constant as a D/A converter holds its command (zero).",
)
mapping_option = click.option(
    "--mapping",
    "mapping_file",
    type=PATH,
    help=(
        "A TOML file that says all of this, and names the files: see docs/files.md."
        " Options go before it."
    ),
)
laws_option = click.option(
    "--laws",
    "laws_files",
    multiple=True,
    type=PATH,
    is_eager=True,
    expose_value=False,
    callback=take_laws,
    help=(
        "A Python file with force laws of your own, which is run: for --law, the"
        " search and saved models."
    ),
)
preparation_options = together(
    click.option("--from", "from", type=float, help="First second that is used."),
    click.option("--to", "to", type=float, help="Second up to which is used."),
    click.option(
        "--resample",
        type=float,
        help="Lower sampling rate in Hz to which records are brought, band-limited.",
    ),
    click.option(
        "--drop-blank",
        is_flag=True,
        help="Leave out rows in which a channel that is used is empty.",
    ),
    click.option(
        "--relative-acceleration",
        is_flag=True,
        help="Accelerations were measured relative to the base: ag is added.",
    ),
)
record_options = together(
    map_option,
    unit_option,
    rate_option,
    coordinates_option,
    hold_option,
    preparation_options,
    mapping_option,
    laws_option,
)
files_options = together(
    click.argument("files", nargs=-1, metavar="FILE...", type=PATH), record_options
)

law_option = repeated(
    "--law",
    "laws",
    parameters.pair("SITE=NAME+NAME", parameters.law_names),
    'Laws at a site in place of the power series: "storey'
    ' 1=linear_elastic+linear_viscous+dahl".',
)
link_option = repeated(
    "--link",
    "links",
    parameters.SITE,
    'A further link between floors: "link 3-1", "ground 2".',
)
mass_option = keyed(
    "--known-mass",
    "masses",
    parameters.MASS,
    "A mass that is known: 2=12.4. Needed where no force is measured.",
)
band_option = click.option(
    "--band",
    type=parameters.BAND,
    help="Frequency band in Hz in which everything is fitted and judged: 0.5,30.",
)
order_option = keyed(
    "--order",
    "orders",
    parameters.pair("SITE=DEGREE", parameters.degree),
    'Another degree at a site: "storey 2=5".',
)
model_options = together(law_option, mass_option, band_option)

# Options that stand for arguments of the library, which its errors name.
OPTIONS_OF_ARGUMENTS = {
    "known_masses": "--known-mass DOF=KG",
    "laws": "--laws FILE.py",
}


# -- what the options describe -------------------------------------------------


def mapping_of(options: ExcitationOptions) -> tuple[MappingFile, ReadingOptions]:
    """The mapping file, and channels, units and clock by it and by the options.

    Options go before the file.
    """
    from ..records.files.mapping import MappingFile, read_mapping

    mapping = MappingFile(Path())
    if options["mapping_file"] is not None:
        mapping = read_mapping(options["mapping_file"])
    click.get_current_context().meta.setdefault(NAMED_FILES, []).extend(mapping.files)
    how: ReadingOptions = {
        "mapping": mapping.channels | options["mapping"],
        "units": mapping.units | options["units"],
        "fs": mapping.fs if options["fs"] is None else options["fs"],
    }
    return mapping, how


def settings_of_preparation(
    options: RecordOptions, mapping: MappingFile
) -> dict[str, float | bool]:
    """Settings of the preparation: those of the options go before the file's."""
    numbers = {
        "from": options["from"],
        "to": options["to"],
        "resample": options["resample"],
    }
    switches = {
        "drop_blank": options["drop_blank"],
        "relative_acceleration": options["relative_acceleration"],
    }
    settings = dict(mapping.prepare)
    for key, number in numbers.items():
        if number is not None:
            settings[key] = number
    for key, is_on in switches.items():
        if is_on:
            settings[key] = True
    return settings


def preparation_of(mapping: MappingFile) -> Preparation:
    """What a mapping file says is done to channels."""
    from ..records.files.preparation import Preparation

    settings = mapping.prepare
    return Preparation(
        start=settings.get("from"),
        stop=settings.get("to"),
        fs=settings.get("resample"),
        drop_blank=bool(settings.get("drop_blank")),
        relative_acceleration=bool(settings.get("relative_acceleration")),
    )


def readings_of(
    files: Sequence[Path], options: RecordOptions, needed: bool = True
) -> list[Reading]:
    """What files hold, by the record options and the mapping file.

    Parameters
    ----------
    files : sequence of Path
        Those of the mapping file if there are none.
    options : RecordOptions
    needed : bool
        Whether no file at all is a usage error.
    """
    mapping, how = mapping_of(options)
    coordinates = options["coordinates"] or mapping.coordinates
    files = list(files or mapping.files)
    if not files and needed:
        raise click.UsageError(
            "Missing argument 'FILE...': give a file with the channels of a test."
        )

    asked = replace(
        mapping,
        files=tuple(files),
        coordinates=coordinates,
        hold=options["hold"] or mapping.hold,
        prepare=settings_of_preparation(options, mapping),
    )
    with working("reading"):
        return read_tests(asked, how)


def read_tests(
    mapping: MappingFile, how: ReadingOptions | None = None
) -> list[Reading]:
    """The tests of a mapping file, each as a record.

    Parameters
    ----------
    mapping : MappingFile
    how : ReadingOptions, optional
        Channels, units and clock; those of the mapping file if None.
    """
    from ..records.files import inspect_record

    if how is None:
        how = {"mapping": mapping.channels, "units": mapping.units, "fs": mapping.fs}
    tests: list[AnyPath | list[AnyPath]] = [*mapping.files]
    if mapping.together and mapping.files:
        tests = [[*mapping.files]]
    name = mapping.name if len(tests) == 1 else None
    readings = []
    for test in tests:
        reading = inspect_record(
            test,
            name=name,
            coordinates=mapping.coordinates,
            hold=mapping.hold,
            preparation=preparation_of(mapping),
            **how,
        )
        readings.append(reading)
    return readings


def records_of(
    session: Session, options: RecordOptions, *groups: Iterable[Path]
) -> list[Record]:
    """The records of some groups of files, each read as by :func:`readings_of`.

    What they hold is printed.
    """
    from ..records.files import describe

    readings: list[Reading] = []
    for files in groups:
        readings += readings_of(list(files), options)
    session.measured(*map(describe, readings))
    return [reading.record for reading in readings]


def laws_of(
    pairs: Iterable[tuple[str, list[str]]], degree: Degree
) -> dict[str, list[ForceLaw]] | None:
    """Laws by site, from sites and names of laws; None if there are none."""
    from .. import laws

    known = laws.registry()
    by_site: dict[str, list[ForceLaw]] = {}
    for site, names in pairs:
        for name in names:
            is_series = name == "power_series"
            law = laws.PowerSeries(degree) if is_series else known[name]()
            by_site.setdefault(site, []).append(law)
    return by_site or None


def regressor_of(options: ModelOptions) -> NRFRegressor:
    """The regressor that the options describe."""
    from ..identification.regressor import NRFRegressor

    return NRFRegressor(
        degree=options["degree"],
        orders=options.get("orders") or None,
        strategy=options.get("strategy", "auto"),
        estimation=options.get("estimation", "auto"),
        laws=laws_of(options["laws"], options["degree"]),
        known_masses=options["masses"] or None,
        band=options["band"],
    )
