"""The views of a result: one self-contained page, Markdown, and small HTML for
notebooks, which escapes every name.
"""

import json
import re
import zlib
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from html import escape
from importlib.resources import files
from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from ..chain.latex import as_text, law_equation, mathml, pretty, shape_values
from ..common.files import atomic_write
from ..common.lazy import require
from ..exceptions import NRFError
from .figures.figure import Table, table

_PURPOSE = "The HTML report"


def available() -> bool:
    """Whether the packages of the extra ``report`` are installed."""
    return all(find_spec(name) is not None for name in ("jinja2", "plotly"))


def write_html(
    path: Any,
    subject: Any,
    record: Any = None,
    *,
    title: str | None = None,
    notes: Sequence[str] = (),
    band: tuple[float | None, float | None] | None = None,
) -> None:
    """Write one self-contained page: equations, surfaces that turn, loops, tables that
    sort, every setting.
    """
    html = page(subject, record, title=title, notes=notes, band=band)
    with atomic_write(path) as file:
        file.write(html)


class Cell(NamedTuple):
    """One cell of a table: what is shown, and what it is sorted and copied by."""

    text: str
    value: str
    number: bool = False
    faint: bool = False


def cell(value: Any) -> Cell:
    """Cell of a number or of text; four digits are shown, all are kept for sorting and
    copying.
    """
    if isinstance(value, (int, np.integer)):
        return Cell(str(value), str(value), True)
    if isinstance(value, (float, np.floating)):
        given = repr(float(value)) if np.isfinite(value) else ""
        return Cell(as_text(value), given, True, getattr(value, "faint", False))
    return Cell(str(value), str(value))


def cells(table: Any) -> tuple[list[list[Cell]], list[bool]]:
    """Cells of a table, and whether each column holds numbers."""
    rows = [[cell(value) for value in row] for row in table.rows]
    return rows, [any(row[k].number for row in rows) for k in range(len(table.head))]


def page(
    subject: Any,
    record: Any = None,
    *,
    title: str | None = None,
    notes: Sequence[str] = (),
    band: Any = None,
) -> str:
    """The page as text; see :func:`write_html`."""
    jinja2 = require("jinja2", "report", _PURPOSE)
    offline = require("plotly.offline", "report", _PURPOSE)
    from .content import of_loop, of_model
    from .figures.plotly_renderer import as_plotly

    if hasattr(subject, "steps") and hasattr(subject, "stopped_because"):
        content = of_loop(subject, title)
    elif hasattr(subject, "model_") or hasattr(subject, "restoring_forces"):
        content = of_model(subject, record, title, notes, band)
    else:
        cure = "Give a LoopReport, a fitted NRFRegressor or a ChainModel."
        raise NRFError(f"{type(subject).__name__} cannot be reported", cure)
    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(_template),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["cells"] = cells
    drawn: dict[str, dict[str, Any]] = {}

    def register(figure: Any, numbers: str) -> tuple[str, int]:
        name = f"figure-{len(drawn) + 1}"
        drawn[name] = as_plotly(figure) | {"numbers": str(numbers)}
        return name, drawn[name]["layout"]["height"]

    markup = jinja2.utils.markupsafe.Markup
    style, code = markup(_template("style.css")), markup(_template("page.js"))
    words = {
        "content": content,
        "register": register,
        "math": lambda pieces: markup(mathml(pieces)),
        "style": style,
    }
    body = environment.get_template("page.html").render(words)  # registers the figures
    figures = json.dumps(drawn, separators=(",", ":"), allow_nan=False)
    packed = {
        "plotly": _packed(_without_maps(offline.get_plotlyjs())),
        "figures": _packed(figures),
    }
    return f"{body}{environment.get_template('scripts.html').render(packed=packed, code=code)}</body>\n</html>\n"


def _without_maps(library: str) -> str:
    """The plotting library without the program of its street maps: a literal of a tenth
    of its size, used nowhere.
    """
    literal = re.compile(r"(?<=\.exports=)'(?:[^'\\]|\\.){100000,}'", re.DOTALL)
    return literal.sub(
        lambda found: "''" if "maplibre" in found[0] else found[0], library
    )


_SIGNS = bytes(code for code in range(0x21, 0x7F) if chr(code) not in "'<\\")


@lru_cache(2)
def _packed(text: str) -> tuple[int, str]:
    """Bytes of a text when deflated, and these as pairs of 91 signs, 13 bits a pair: no
    sign is "<" or a quote.
    """
    small = np.frombuffer(zlib.compress(text.encode(), 9), np.uint8)
    bits = np.pad(np.unpackbits(small), (0, -8 * len(small) % 13)).reshape(-1, 13)
    pairs = np.stack(np.divmod(bits @ (1 << np.arange(12, -1, -1)), 91), axis=1)
    return len(small), np.frombuffer(_SIGNS, np.uint8)[pairs].tobytes().decode()


def _template(name: str) -> str:
    return files(__package__).joinpath("templates", name).read_text(encoding="utf-8")


def markdown(report: Any) -> str:
    """The report of the loop as Markdown, with the words and tables of its page; names
    from files are escaped.
    """
    from .content import band_source, band_text, chapters, effects, errors, lead

    reached = report.verdict
    out = [
        "# Closing the loop",
        "",
        f"**{reached.state.upper()}: {_safe(reached.sentence)}**",
        "",
    ]
    out += [
        *(f"- {_safe(text)}" for text in reached.reasons),
        "",
        _safe(lead(report)),
        "",
    ]
    out += [
        f"{i}. {_safe(step.sentence)}" for i, step in enumerate(report.steps, 1)
    ] or ["No effect was added."]
    out += ["", f"Stopped: {_safe(report.stopped_because)}.", ""]
    band = ", ".join(filter(None, [band_text(report.band), band_source(report)]))
    gains = effects(report)
    out += (
        [f"{gains.caption}:", "", *_markdown_table(gains), ""]
        if gains is not None
        else []
    )
    out += [
        (
            f"Errors in percent NRMSE ({band}); balance errors (one step) except the"
            " free run."
        ),
        "",
    ]
    out += [*_markdown_table(errors(report)), ""]
    for chapter in chapters(report):
        facts = [
            f"- {_safe(name)}{'' if name.endswith('?') else ':'} {_safe(text)}"
            for name, text in chapter.facts
        ]
        out += [f"## {_safe(chapter.title)}", "", *facts, ""]
        for numbers in chapter.tables:
            out += [f"{_safe(numbers.caption)}:", "", *_markdown_table(numbers), ""]
    if report.measured:
        out += [
            "## What was measured",
            "",
            *(f"- {_safe(m.sentence)}" for m in report.measured),
            "",
        ]
    out += ["## Model", "", "```", str(report.model).replace("```", "'''"), "```", ""]
    if report.settings:
        out += ["## Settings", ""]
        for group, values in report.settings.items():
            out.append(
                f"- {_safe(group)}: "
                + ", ".join(f"{_safe(k)} = {_safe(v)}" for k, v in values.items())
            )
        out.append("")
    return "\n".join(out)


def _markdown_table(t: Table) -> list[str]:
    """Lines of a table."""
    rows = [t.head, *([cell(x).text for x in row] for row in t.rows)]
    lines = ["| " + " | ".join(map(_safe, row)) + " |" for row in rows]
    return [lines[0], "|" + "---|" * len(t.head), *lines[1:]]


def _safe(text: Any) -> str:
    """Text that no Markdown renderer takes for markup or for the end of a cell."""
    return (
        str(text)
        .replace("&", "&amp;")
        .replace("<", "&lt;")
        .replace("|", "\\|")
        .replace("\n", " ")
    )


_MOST = 30


def record_html(record: Any) -> str:
    """A record: clock, forces, channels."""
    from ..records.checks.channel_checks import measured

    m = measured(record)
    shown = m.channels.drop(columns="noise").assign(
        unit=[pretty(str(u)) for u in m.channels["unit"]]
    )
    return _box(f"Record: {m.name}", f"{m.facts}.", _html_table(table("", shown)))


def model_html(model: Any) -> str:
    """A chain model: masses, equations."""
    masses = ", ".join(
        f"m{j} = {as_text(m)} kg" for j, m in enumerate(model.masses[:_MOST], 1)
    )
    lines = []
    for force in list(model.restoring_forces.values())[:_MOST]:
        if force.laws:
            shapes = ", ".join(mathml([value]) for value in shape_values(force))
            lines.append(
                mathml(law_equation(force)) + (f" with {shapes}" if shapes else "")
            )
    body = "".join(f"<p style='margin:.2em 0'>{line}</p>" for line in lines)
    return _box(
        f"Chain of {model.n_dof} DOF{'s' if model.n_dof > 1 else ''}", masses, body
    )


def loop_html(report: Any) -> str:
    """A report of the loop: steps, errors, reason to stop."""
    from .content import errors

    steps = "".join(f"<li>{escape(step.sentence)}</li>" for step in report.steps)
    story = f"<ol>{steps}</ol>" if steps else "<p>No effect was added.</p>"
    columns = [
        c for c in ("search", "validation", "held-out", "free run") if c in report.table
    ]
    shown = _html_table(errors(replace(report, table=report.table[columns])))
    said = f"{report.verdict.state.upper()}: {report.verdict.sentence}"
    return _box(
        "Closed loop",
        said,
        f"{story}{shown}<p>Stopped: {escape(report.stopped_because)}.</p>",
    )


def _box(title: str, words: str, body: str) -> str:
    said = f"<p style='margin:.2em 0'>{escape(words)}</p>" if words else ""
    return (
        "<div class='pysindy-nrf'><p style='margin:.2em"
        f" 0'><b>{escape(title)}</b></p>{said}{body}</div>"
    )


def _html_table(t: Table) -> str:
    shown = pd.DataFrame(
        [[cell(x).text for x in row] for row in t.rows[:_MOST]], columns=t.head
    )
    more = f"<p>and {len(t.rows) - _MOST} more rows</p>" if len(t.rows) > _MOST else ""
    return shown.to_html(index=False, border=0) + more
