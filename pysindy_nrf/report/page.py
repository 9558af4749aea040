"""One self-contained page (HTML) that works offline, with every name escaped."""

from __future__ import annotations

import json
import re
import zlib
from collections.abc import Sequence
from functools import lru_cache
from importlib.resources import files
from importlib.util import find_spec
from os import PathLike
from typing import TypeGuard

import numpy as np

from ..chain.latex import mathml, pretty
from ..chain.model import ChainModel
from ..common.files import atomic_write
from ..common.lazy import require
from ..drawing.figure import Figure
from ..exceptions import NRFError
from ..records.record import Record
from .content import Content
from .data_content import data_content
from .figures.plotly_renderer import as_plotly
from .loop_content import loop_content
from .model_content import Fitted, Identification, identification_of, model_content
from .results import Loop
from .results_page import ResultsPage, results_content
from .tables import cells
from .words import Band

# What a page is about.
Subject = (
    Loop
    | Fitted
    | ChainModel
    | Identification
    | ResultsPage
    | Record
    | Sequence[Record]
)

_PURPOSE = "The HTML report"
# A literal of a script that is at least this long is the program of the street maps.
_LONG_LITERAL = re.compile(r"(?<=\.exports=)'(?:[^'\\]|\\.){100000,}'", re.DOTALL)
# What a script needs for its reader only: indents, and lines that hold a comment.
_INDENT_OR_COMMENT = re.compile(r"^\s+|^ *//.*\n", re.MULTILINE)
# Signs in which bytes are written: none is "<" or a quote, so no script ends early.
_SIGNS = bytes(code for code in range(0x21, 0x7F) if chr(code) not in "'<\\")
# A pair of these 91 signs holds 13 bits: 91^2 = 8281 > 2^13.
_BITS_OF_A_PAIR = 13


def available() -> bool:
    """Whether the packages of the extra ``report`` are installed."""
    return all(find_spec(name) is not None for name in ("jinja2", "plotly"))


def write_html(
    path: str | PathLike[str],
    subject: Subject,
    record: Record | Sequence[Record] | None = None,
    *,
    title: str | None = None,
    notes: Sequence[str] = (),
    band: Band = None,
) -> None:
    """Write one page: equations, surfaces that turn, loops, tables, every setting.

    Parameters
    ----------
    path : path-like
        An older file is replaced completely.
    subject : LoopReport, fitted NRFRegressor, ChainModel, Identification or Record
        A record, or several, are drawn as they were measured.
    record : Record or sequence of Record, optional
        Over which a model is drawn.
    title : str, optional
    notes : sequence of str
        What is to be taken care of.
    band : (float or None, float or None), optional
        Hz; that of the model if None.

    Raises
    ------
    MissingExtraError
        Without jinja2 or plotly, which the extra ``report`` brings.
    NRFError
        If the subject is none of these.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from pysindy_nrf import datasets
    >>> from pysindy_nrf.report import write_html
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     page = Path(folder) / "model.html"
    ...     write_html(page, datasets.demo_truth(), title="The bundled frame")
    ...     "The bundled frame" in page.read_text("utf-8")
    True
    """
    content = content_of(subject, record, title=title, notes=notes, band=band)
    write_content(path, content)


def write_content(path: str | PathLike[str], content: Content) -> None:
    """Write what a page shows; see :func:`write_html`."""
    for package in ("jinja2", "plotly.offline"):
        require(package, "report", _PURPOSE)
    with atomic_write(path) as file:
        file.write(_rendered(content))


def as_html(
    subject: Subject,
    record: Record | Sequence[Record] | None = None,
    *,
    title: str | None = None,
    notes: Sequence[str] = (),
    band: Band = None,
) -> str:
    """The page as text; parameters and errors as for :func:`write_html`."""
    for package in ("jinja2", "plotly.offline"):
        require(package, "report", _PURPOSE)
    return _rendered(content_of(subject, record, title=title, notes=notes, band=band))


def content_of(
    subject: Subject,
    record: Record | Sequence[Record] | None = None,
    *,
    title: str | None = None,
    notes: Sequence[str] = (),
    band: Band = None,
) -> Content:
    """What the page shows, apart from how.

    Parameters and errors as for :func:`write_html`.

    Returns
    -------
    Content

    Examples
    --------
    >>> from pysindy_nrf import datasets
    >>> from pysindy_nrf.report import content_of
    >>> content = content_of(datasets.demo_truth())
    >>> [table.caption for table in content.model.tables]
    ['Masses', 'Coefficients', 'Modes of the linear part']
    """
    if _is_loop(subject):
        return loop_content(subject, title)
    if isinstance(subject, ChainModel) or _is_fitted(subject):
        subject = identification_of(subject, record, band)
    if isinstance(subject, Record):
        subject = [subject]
    if isinstance(subject, ResultsPage):
        return results_content(subject, title)
    if _are_records(subject):
        return data_content(subject, title, notes)
    if isinstance(subject, Identification):
        return model_content(subject, title, notes)
    raise NRFError(
        f"{type(subject).__name__} cannot be reported",
        "Give a LoopReport, a fitted NRFRegressor, a ChainModel or Records.",
    )


def _is_loop(subject: object) -> TypeGuard[Loop]:
    return hasattr(subject, "steps") and hasattr(subject, "stopped_because")


def _are_records(subject: object) -> TypeGuard[Sequence[Record]]:
    if not isinstance(subject, (list, tuple)) or not subject:
        return False
    return all(isinstance(record, Record) for record in subject)


def _is_fitted(subject: object) -> TypeGuard[Fitted]:
    return hasattr(subject, "model_")


def _rendered(content: Content) -> str:
    """The page of a content."""
    jinja2 = require("jinja2", "report", _PURPOSE)
    offline = require("plotly.offline", "report", _PURPOSE)
    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(_template),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["cells"] = cells
    environment.filters["unit"] = lambda unit: pretty(content.units.of(unit))
    markup = jinja2.utils.markupsafe.Markup
    drawn: dict[str, dict[str, object]] = {}

    def register(figure: Figure, numbers: str) -> tuple[str, object]:
        """Draw a figure for the script, with its table; its name and height."""
        name = f"figure-{len(drawn) + 1}"
        plot = as_plotly(figure)
        drawn[name] = {**plot, "numbers": str(numbers)}
        return name, plot["layout"]["height"]

    def math(pieces: list[str]) -> str:
        return markup(mathml(pieces))

    style = markup(_template("style.css"))
    body = environment.get_template("page.html").render(
        content=content, register=register, math=math, style=style
    )

    # the template has registered the figures
    figures = json.dumps(drawn, separators=(",", ":"), allow_nan=False)
    packed = {
        "plotly": _packed(_without_maps(offline.get_plotlyjs())),
        "figures": _packed(figures),
    }
    scripts = environment.get_template("scripts.html").render(
        packed=packed, code=markup(_INDENT_OR_COMMENT.sub("", _template("page.js")))
    )
    return f"{body}{scripts}</body>\n</html>\n"


def _template(name: str) -> str:
    return files(__package__).joinpath("templates", name).read_text(encoding="utf-8")


def _without_maps(library: str) -> str:
    """The plotting library without its street maps, a tenth of its size."""

    def emptied(literal: re.Match[str]) -> str:
        return "''" if "maplibre" in literal[0] else literal[0]

    return _LONG_LITERAL.sub(emptied, library)


@lru_cache(2)
def _packed(text: str) -> tuple[int, str]:
    """A text deflated: the number of bytes, and these as pairs of signs."""
    deflated = np.frombuffer(zlib.compress(text.encode(), 9), np.uint8)
    bits = np.unpackbits(deflated)
    bits = np.pad(bits, (0, -len(bits) % _BITS_OF_A_PAIR))

    powers = 1 << np.arange(_BITS_OF_A_PAIR - 1, -1, -1)
    numbers = bits.reshape(-1, _BITS_OF_A_PAIR) @ powers
    pairs = np.stack(np.divmod(numbers, len(_SIGNS)), axis=1)
    signs = np.frombuffer(_SIGNS, np.uint8)[pairs]
    return len(deflated), signs.tobytes().decode()
