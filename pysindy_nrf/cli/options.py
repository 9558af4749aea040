"""Options of the commands: small texts turned into what the library takes, or a usage error."""

from __future__ import annotations

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
json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON instead of words.")


def record_options(command: Any) -> Any:
    """Options of every command that reads records: channels, units, clock, coordinates."""
    for option in reversed(
        (
            click.option(
                "--map",
                "mapping",
                multiple=True,
                type=Pair("CHANNEL=COLUMN"),
                help='Which column is which channel: "name", "-name[:, 2] * 9.81", "name @ mm", "none", or "unknown" '
                "for a force that acts and was not measured.",
            ),
            click.option(
                "--unit",
                "units",
                multiple=True,
                type=Pair("CHANNEL=UNIT"),
                help="Unit of a channel (x3=in) or kind (a=g, F=kN).",
            ),
            click.option("--fs", type=float, help="Sampling rate in Hz, where the file has no time."),
            click.option(
                "--coordinates",
                type=click.Choice(["relative", "absolute"]),
                default="relative",
                help="Whether velocities and displacements are relative to the base.",
            ),
        )
    ):
        command = option(command)
    return command


def readings_of(files: Any, options: dict[str, Any]) -> list[Any]:
    """What the files hold, by the record options."""
    from ..io import inspect_record

    return [
        inspect_record(
            path,
            mapping=as_mapping(options["mapping"], "--map"),
            units=as_mapping(options["units"], "--unit"),
            fs=options["fs"],
            coordinates=options["coordinates"],
        )
        for path in files
    ]


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
        key, sign, text = value.partition("=")
        if not sign or not key.strip() or not text.strip():
            self.fail(f"{value!r} is not of the form {self.name}", param, ctx)
        return key.strip(), text.strip()


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
            low, high = (None if p in ("none", "") else float(p) for p in parts)
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


def as_mapping(pairs: Any, option: str) -> dict:
    """Pairs as a mapping; a key given twice is a usage error."""
    out: dict = {}
    for key, value in pairs:
        if key in out:
            raise click.UsageError(f"{option} {key}= is given twice.")
        out[key] = value
    return out


def laws_of(pairs: Any, degree: Any) -> dict[str, list] | None:
    """``SITE=NAME+NAME`` as laws by site."""
    if not pairs:
        return None
    from .. import laws

    known = laws.registry()
    out: dict[str, list] = {}
    for site, text in pairs:
        for name in (n.strip() for n in text.split("+")):
            if name not in known:
                raise click.UsageError(f"--law: there is no law {name!r}. Known are {', '.join(sorted(known))}.")
            try:
                law = laws.PowerSeries(degree) if name == "power_series" else known[name]()
            except TypeError as error:
                raise click.UsageError(f"--law: {name} needs arguments ({error}); use it from Python.") from error
            out.setdefault(site, []).append(law)
    return out
