"""What the commands share: words before the work, results as words or JSON, warnings at
the end, errors in words.
"""

import functools
import itertools
import json
import math
import os
import re
import shlex
import textwrap
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import click
import numpy as np
import pandas as pd

from ..chain.sites import Site
from ..exceptions import NRFWarning
from .results import Results


class Session:
    """Where words go: to the terminal, or nowhere when a machine reads."""

    def __init__(self, as_json: bool) -> None:
        self.as_json = as_json
        self.warnings: list[str] = []
        run = click.get_current_context()
        place: Any = next(
            (p.type for p in run.command.params if p.name == "output"), None
        )
        inputs = run.meta.setdefault(
            _NAMED, []
        )  # what a mapping file names, and all paths among the options
        for value in (value for name, value in run.params.items() if name != "output"):
            inputs += [
                one
                for one in (value if isinstance(value, tuple) else (value,))
                if isinstance(one, Path)
            ]
        force = run.meta.get(_FORCE, False)
        # where the running command writes, if it has the option --output
        self.results: Any = place and Results(
            run.params["output"], place.file_okay, inputs, force
        )

    def say(self, *words: str) -> None:
        """Print words for people, each on lines of its own."""
        if not self.as_json:
            click.echo(printable("\n".join(words)))

    def headed(self, title: str, *words: str) -> None:
        """Print words below a heading with a blank line above."""
        self.say(heading(title), *words)

    def measured(self, *descriptions: str) -> None:
        """Print what was understood of the records, the first thing a command says."""
        self.say("What was measured\n-----------------", *descriptions)
        say_if_compiling()

    def emit(self, data: dict[str, Any], files: Iterable[Path] = ()) -> None:
        """Print plain data for machines: strict JSON, a number that does not exist as
        null.
        """
        if self.as_json:
            data = data | {
                "warnings": data.get("warnings", self.warnings),
                "files": [str(p) for p in files],
            }
            click.echo(json.dumps(plain(data), indent=2, allow_nan=False))

    @contextmanager
    def listening(self, label: str = "working") -> Iterator[Callable[[], None]]:
        """Keep the warnings of the work for :meth:`take_care`, and show that it goes
        on; see :func:`working`.
        """
        with warned() as messages, working(label) as tick:
            try:
                yield tick
            finally:
                self.warnings += [one for one in messages() if one not in self.warnings]

    def take_care(self) -> None:
        """Print the warnings."""
        if self.warnings:
            self.headed("Take care", paragraphs(self.warnings))

    def provenance(self) -> dict[str, Any]:
        """What a model and its page say of the run: the command, and the files it read
        with their SHA-256.
        """
        words = click.get_current_context().obj or []
        return {
            "command": shlex.join(["pysindy-nrf", *words]),
            "inputs": self.results.sources,
        }

    @contextmanager
    def aside(self) -> Iterator[Path]:
        """A folder for the results of the running command, moved into place when all
        are written; says the warnings.
        """
        self.take_care()
        run = click.get_current_context()
        about = {
            "command": run.info_name,
            "arguments": run.obj,
            "settings": plain(run.params),
        }
        with working("writing"), self.results.aside(about) as folder:
            yield folder

    def finish(self, data: dict[str, Any], files: Sequence[Path]) -> None:
        """Print the data for machines, or for people what was written and the page to
        open.
        """
        files = [self.results.home / path.name for path in files]
        self.emit(data, files)
        self.say(
            f"\nWritten to {self.results.home}: {', '.join(p.name for p in files)}"
        )
        for path in files:
            if path.suffix == ".html":
                self.say(f"Open {path} in a browser.")


@contextmanager
def working(label: str) -> Iterator[Callable[[], None]]:
    """A line on the error stream of a terminal: what goes on, and for how long; what it
    gives counts laws tried.
    """
    from tqdm import tqdm

    bar = tqdm(bar_format="{desc}, {elapsed}", desc=label, disable=None, leave=False)
    done, tried = threading.Event(), itertools.count(1)

    def tick() -> None:
        bar.desc = f"laws tried: {next(tried)}"

    def watch() -> None:
        while not done.wait(1.0):
            bar.refresh()

    watching = threading.Thread(target=watch, daemon=True)
    watching.start()
    try:
        yield tick
    finally:
        done.set()
        watching.join()
        bar.close()


def say_if_compiling() -> None:
    """Announce the first run, for which the numerical functions are compiled; numba is
    not loaded to find out.
    """
    kept = os.environ.get("NUMBA_CACHE_DIR")
    places = (
        [Path(kept)]
        if kept
        else [Path(__file__).parents[2], Path.home() / ".cache" / "numba"]
    )
    name = (
        "chain"
        if click.get_current_context().info_name in ("run", "close-loop")
        else "gram_pass"
    )
    if not any(any(place.rglob(f"{name}-*.nbi")) for place in places):
        click.echo("compiling, once, about 10 s", err=True)


_FORCE, _NAMED = (
    "force",
    "named by the mapping file",
)  # what a run knows beside its options


@contextmanager
def warned() -> Iterator[Callable[[], list[str]]]:
    """Catch all warnings; the function returned gives those of the package so far, each
    once.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", NRFWarning)
        yield lambda: list(
            dict.fromkeys(
                in_options(w.message)
                for w in caught
                if issubclass(w.category, NRFWarning)
            )
        )


# what messages call the arguments of the library, and the options that stand for them
_OPTIONS = {
    "known_masses={dof: kg}": "--known-mass DOF=KG",
    "known_masses=": "--known-mass",
    "in known_masses": "by --known-mass",
    "(laws=)": "(--law)",
    "(close_loop)": "(close-loop)",
    "band=(lo, hi)": "--band LO,HI",
    "(band=)": "(--band)",
    "strategy=": "--strategy ",
    "estimation=": "--estimation ",
    "ive fs= in": "ive --fs in",
    "ive fs=": "ive --fs ",
    "fs= (--fs, Hz)": "--fs (Hz)",
    "read_frf (--frf)": "--frf",
}


def in_options(message: Any) -> str:
    """A message of the library in the words of the command line."""
    words = re.sub(r"\b(strategy|estimation)='(\w+)'", r"--\1 \2", str(message))
    words = re.sub(r"\b(?:mapping|units)=\{[^}]*\}, --", "--", words)
    for argument, option in _OPTIONS.items():
        words = words.replace(argument, option)
    return words


def heading(text: str) -> str:
    """A heading with a blank line above."""
    return f"\n{text}\n{'-' * len(text)}"


def table(frame: pd.DataFrame, digits: int = 4) -> str:
    """A table of numbers."""
    return frame.to_string(
        float_format=lambda x: "-" if np.isnan(x) else f"{x:.{digits}g}"
    )


def paragraphs(notes: Sequence[str], first: str = "  - ") -> str:
    """Warnings, one a paragraph, in lines that a terminal shows whole."""
    how: dict[str, Any] = {
        "subsequent_indent": "    ",
        "break_long_words": False,
        "break_on_hyphens": False,
    }
    return "\n".join(
        textwrap.fill(note, 110, initial_indent=first, **how) for note in notes
    )


def verdict_words(verdict: Any) -> str:
    """A verdict with its reasons, in the words of the command line and in lines that a
    terminal shows whole.
    """
    said = paragraphs([in_options(verdict.sentence)], f"{verdict.state.upper()}: ")
    return "\n".join(
        [
            said,
            *(
                [paragraphs([*map(in_options, verdict.reasons)])]
                if verdict.reasons
                else []
            ),
        ]
    )


def printable(words: str) -> str:
    """Words whose control characters (of a channel's or file's name) are shown, not
    obeyed by the terminal.
    """
    return "".join(c if c == "\n" or c.isprintable() else repr(c)[1:-1] for c in words)


def plain(data: Any) -> Any:
    """Data as JSON holds them: no NumPy, no NaN."""
    if isinstance(data, dict):
        return {str(key): plain(value) for key, value in data.items()}
    if isinstance(data, (list, tuple, set, np.ndarray)):
        return [plain(value) for value in data]
    if isinstance(data, pd.DataFrame):
        return plain(data.to_dict("index"))
    if isinstance(data, pd.Series):
        return plain(data.to_dict())
    if isinstance(data, np.generic):
        data = data.item()
    if isinstance(data, float):
        return data if math.isfinite(data) else None
    return data if data is None or isinstance(data, int) else str(data)


class Text(click.ParamType):
    """A text that ``read`` turns into a value; its ValueError becomes a usage error, in
    words of what is ``wanted``.
    """

    def __init__(self, name: str, read: Callable[[str], Any], wanted: str = "") -> None:
        self.name, self.read, self.wanted = name, read, wanted

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        """The value; one that was converted before is left alone."""
        if not isinstance(value, str):
            return value
        try:
            return self.read(value)
        except ValueError as error:
            self.fail(
                f"{value!r} is not {self.wanted}" if self.wanted else str(error),
                param,
                ctx,
            )


def _pair(form: str, read: Callable[[str], Any] = str) -> Text:
    """A text ``KEY=VALUE``, split at the first ``=``, whose value ``read`` turns into
    what is wanted.
    """

    def parts(text: str) -> tuple[str, Any]:
        with suppress(
            UnicodeError
        ):  # bytes of a terminal that is said to know only ASCII
            text = os.fsencode(text).decode("utf-8")
        key, sign, value = text.partition("=")
        if not sign or not key.strip() or not value.strip():
            raise ValueError(f"{text!r} is not of the form {form}")
        return key.strip(), read(value.strip())

    return Text(form, parts)


def _law_names(listed: str) -> list[str]:
    """Names of the laws of a site."""
    from .. import laws

    known, names = laws.registry(), [name.strip() for name in listed.split("+")]
    for name in names:
        if name not in known:
            raise ValueError(
                f"there is no law {name!r}. Known are {', '.join(sorted(known))}."
            )
    return names


def _mass(text: str) -> tuple[int, float]:
    """A DOF and its mass, kg."""
    key, _, value = text.partition("=")
    return int(key), float(value)


def _band(text: str) -> tuple[float | None, float | None]:
    """Two frequencies, Hz; ``none`` is an open end."""
    low, high = (
        None if p.strip().lower() in ("none", "", "inf") else float(p)
        for p in text.split(",")
    )
    return low, high


def _degree(text: str) -> int | tuple[int, int]:
    """A total degree, ``3``, or a box ``k,q``."""
    numbers = _whole(text)
    if len(numbers) not in (1, 2) or any(n < 0 for n in numbers):
        raise ValueError(f"{text!r} is not a degree (3) or a box k,q (2,3)")
    return numbers[0] if len(numbers) == 1 else (numbers[0], numbers[1])


def _range(text: str) -> list[int]:
    """Whole numbers: ``1-7``, or ``1,3,5``."""
    low, dash, high = text.partition("-")
    ends = _whole(f"{low},{high}") if dash else []
    numbers = (
        list(range(ends[0], ends[1] + 1)) if ends else [] if dash else _whole(text)
    )
    if not numbers or min(numbers) < 0 or max(numbers) > 50:
        raise ValueError(f"{text!r} is not whole numbers up to 50, e.g. 1-7 or 1,3,5")
    return numbers


def _whole(text: str) -> list[int]:
    """Whole numbers with commas between them; empty if they are not."""
    try:
        return [int(p) for p in text.split(",")]
    except ValueError:
        return []


def once(ctx: Any, param: Any, pairs: Any) -> dict:
    """Pairs as a mapping; a key given twice is a usage error."""
    out: dict = {}
    for key, value in pairs:
        if key in out:
            raise click.BadParameter(f"{key}= is given twice.", ctx, param)
        out[key] = value
    return out


FLOORS = Text(
    "I,J,...", lambda text: [] if text.strip().lower() == "none" else _range(text)
)  # 1,3 or 1-4 or none
NUMBERS = Text(
    "A,B,...",
    lambda text: [float(p) for p in text.split(",")],
    "numbers with commas between them, e.g. 0.001,0,0",
)
RANGE = Text("A-B|A,B,...", _range)
SITE = Text("SITE", lambda text: str(Site(text)))
PATH = click.Path(path_type=Path)

json_option = click.option(
    "--json", "as_json", is_flag=True, help="Print JSON instead of words."
)


def together(*options: Any) -> Callable[[Any], Any]:
    """Several options as one decorator, in the order in which help lists them."""
    return lambda command: functools.reduce(
        lambda held, option: option(held), reversed(options), command
    )


def output(name: str | None, words: str, single: bool = False) -> Callable[[Any], Any]:
    """The folder, or ``single`` file, of results, and whether they may replace files
    that no earlier run made.
    """
    kind = click.Path(path_type=Path, file_okay=single, dir_okay=not single)
    return together(
        click.option(
            "--output", "-o", type=kind, default=name and Path(name), help=words
        ),
        click.option(
            "--force",
            is_flag=True,
            expose_value=False,
            callback=lambda run, _, on: run.meta.update({_FORCE: on}),
            is_eager=True,
            help="Write over files that no earlier run made, inputs included.",
        ),
    )


_FOLDER = "Folder for the model, tables and figures"
output_option, demo_option = (
    output("nrf_output", f"{_FOLDER}."),
    output("nrf_demo", f"{_FOLDER}."),
)
run_option = output(
    None, f"{_FOLDER}; nrf_runs/FILE, or the next that is free, if left out."
)


def repeated(
    flag: str, name: str, kind: click.ParamType, words: str, keyed: bool = True
) -> Any:
    """An option that may be given several times; pairs become a mapping."""
    return click.option(
        flag,
        name,
        multiple=True,
        type=kind,
        callback=once if keyed else None,
        help=words,
    )


def choice(
    flag: str, values: Sequence[str], words: str, default: str | None = None
) -> Any:
    """An option with one of some values."""
    return click.option(flag, type=click.Choice(values), default=default, help=words)


mapping_option = click.option(
    "--mapping",
    "mapping_file",
    type=PATH,
    help=(
        "A TOML file that says all of this, and names the files: see docs/files.md."
        " Options go before it."
    ),
)
map_option = repeated(
    "--map",
    "mapping",
    _pair("CHANNEL=COLUMN"),
    'Which column is which channel: "name", "-name[:, 2] * 9.81", "name @ mm", "none",'
    ' or "unknown" for a force that acts and was not measured.',
)
unit_option = repeated(
    "--unit",
    "units",
    _pair("CHANNEL=UNIT"),
    "Unit of a channel (x3=in) or kind (a=g, F=kN).",
)
rate_option = click.option(
    "--fs", type=float, help="Sampling rate in Hz, where the file has no time."
)
coordinates_option = choice(
    "--coordinates",
    ["relative", "absolute"],
    "Whether velocities and displacements are relative to the base (what you get if"
    " nothing is said).",
)
law_option = repeated(
    "--law",
    "laws",
    _pair("SITE=NAME+NAME", _law_names),
    'Laws at a site in place of the power series: "storey'
    ' 1=linear_elastic+linear_viscous+dahl".',
    keyed=False,
)
link_option = repeated(
    "--link",
    "links",
    SITE,
    'A further link between floors: "link 3-1", "ground 2".',
    keyed=False,
)
mass_option = repeated(
    "--known-mass",
    "masses",
    Text("DOF=KG", _mass, "a floor and its mass in kg, e.g. 2=12.4"),
    "A mass that is known: 2=12.4. Needed where no force is measured.",
)
band_option = click.option(
    "--band",
    type=Text("LO,HI", _band, "a band, e.g. 0.5,30 (Hz)"),
    help="Frequency band in Hz in which everything is fitted and judged: 0.5,30.",
)
figures_option = click.option(
    "--figures/--no-figures", default=True, help="Draw figures (needs matplotlib)."
)
order_option = repeated(
    "--order",
    "orders",
    _pair("SITE=DEGREE", _degree),
    'Another degree at a site: "storey 2=5".',
)


# of every command that reads records: channels, units, clock, coordinates
record_options = together(
    map_option, unit_option, rate_option, coordinates_option, mapping_option
)
files_options = together(
    click.argument("files", nargs=-1, metavar="FILE...", type=PATH), record_options
)
model_options = together(law_option, mass_option, band_option)
written_options = together(output_option, figures_option, json_option)


def degree_option(default: int, words: str) -> Any:
    """The degree of the power series."""
    return click.option(
        "--degree", type=Text("N|K,Q", _degree), default=default, help=words
    )


def readings_of(files: Any, options: dict[str, Any], needed: bool = True) -> list[Any]:
    """What the files hold, by the record options and the mapping file."""
    from ..records.files import inspect_record

    said, how = said_of(options)
    how["coordinates"] = options["coordinates"] or said.coordinates
    files = list(files or said.files)
    if not files and needed:
        raise click.UsageError(
            "Missing argument 'FILE...': give a file with the channels of a test."
        )
    tests = [files] if said.together and files else files
    names = [said.name if len(tests) == 1 else None] * len(tests)
    with working("reading"):
        return [
            inspect_record(test, name=name, **how) for test, name in zip(tests, names)
        ]


def records_of(session: Session, options: dict[str, Any], *groups: Any) -> list[Any]:
    """The records of some groups of files, each read as by :func:`readings_of`; what
    they hold is said.
    """
    from ..records.files import describe

    readings = [reading for files in groups for reading in readings_of(files, options)]
    session.measured(*map(describe, readings))
    return [reading.record for reading in readings]


def said_of(options: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
    """The mapping file, and channels, units and clock by it and by the options, which
    go before it.
    """
    from ..records.files.mapping import MappingFile, read_mapping

    said = (
        MappingFile(Path())
        if options["mapping_file"] is None
        else read_mapping(options["mapping_file"])
    )
    click.get_current_context().meta.setdefault(_NAMED, []).extend(said.files)
    how: dict[str, Any] = {
        "mapping": said.channels | options["mapping"],
        "units": said.units | options["units"],
        "fs": said.fs if options["fs"] is None else options["fs"],
    }
    return said, how


def laws_of(pairs: Any, degree: Any) -> dict[str, list] | None:
    """Sites and names of laws, as :data:`law_option` gives them, as laws by site."""
    from .. import laws

    known = laws.registry()
    out: dict[str, list] = {}
    for site, names in pairs:
        made = [
            laws.PowerSeries(degree) if name == "power_series" else known[name]()
            for name in names
        ]
        out.setdefault(site, []).extend(made)
    return out or None


def regressor_of(options: dict[str, Any]) -> Any:
    """The regressor that the options describe."""
    from ..identification.regressor import NRFRegressor

    laws = laws_of(options["laws"], options["degree"])
    settings = {
        name: options[name]
        for name in ("degree", "band", "strategy", "estimation")
        if name in options
    }
    masses, orders = options["masses"] or None, options.get("orders") or None
    return NRFRegressor(laws=laws, known_masses=masses, orders=orders, **settings)
