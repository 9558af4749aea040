"""A summary of an identification on one sheet: text, HTML, LaTeX, a table."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape

import numpy as np
import pandas as pd

from ..chain.latex import Estimate, as_text, pretty
from ..chain.model import ChainModel, parameters_of
from ..diagnosis.effects import Bounds, plain_name
from ..diagnosis.verdict import Verdict

# Columns of a line of text.
WIDTH = 92
_COLUMNS = [
    "site",
    "term",
    "estimate",
    "std_error",
    "lower",
    "upper",
    "unit",
    "share",
]
_HEAD = ("", "estimate", "std err", "[0.025", "0.975]", "unit", "share %")
_WIDTHS = (24, 14, 11, 13, 13, 9, 8)
# The column of the unit: a longer unit takes its room from the name of the term.
_UNIT = 5
_NO_LATEX = str.maketrans(
    {
        "\\": r"\textbackslash{}",
        "&": r"\&",
        "%": r"\%",
        "$": r"\$",
        "#": r"\#",
        "_": r"\_",
        "{": r"\{",
        "}": r"\}",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
    }
)
_RAISED = re.compile("[⁰¹²³⁴⁵⁶⁷⁸⁹⁻]+")
_LOWERED = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")
_STYLE = (
    "body{font:10.5pt/1.4 system-ui,sans-serif;max-width:186mm;margin:1rem auto;"
    "padding:0 1rem}table{border-collapse:collapse;width:100%;font-size:9.5pt}"
    "td,th{padding:.1rem .5rem;text-align:right;border-bottom:1px solid #ddd}"
    "td:first-child,th:first-child{text-align:left}.head td:nth-child(odd)"
    "{text-align:left;color:#555}.site th{padding-top:.6rem}"
    "@page{margin:12mm}@media print{body{margin:0;padding:0;max-width:none}}"
)


@dataclass(frozen=True, eq=False)
class Summary:
    """Estimates with their errors, and what they are made from.

    Printed as statsmodels prints its results; notebooks show it as a table.

    Parameters
    ----------
    title : str
    head : sequence of (str, str)
        Method, data, errors: name and value.
    table : DataFrame
        One row a parameter; see :meth:`to_frame`.
    verdict : Verdict, optional
    notes : sequence of str
        Below the table.

    Examples
    --------
    >>> from pysindy_nrf import NRFRegressor, datasets
    >>> summary = NRFRegressor(degree=1).fit(datasets.load_demo()).summary()
    >>> summary.to_frame().loc["m2", "unit"]
    'kg'
    """

    title: str
    head: Sequence[tuple[str, str]]
    table: pd.DataFrame
    verdict: Verdict | None = None
    notes: Sequence[str] = field(default_factory=tuple)

    def to_frame(self) -> pd.DataFrame:
        """The estimates as a table.

        Returns
        -------
        DataFrame
            By ``parameter``: ``site`` and ``term`` (empty for masses), ``estimate``,
            ``std_error`` (of noise alone), ``lower`` and ``upper`` (95 %; NaN where no
            interval can be given), ``unit`` and ``share`` of the force of the site,
            percent rms.
        """
        return self.table.copy()

    def __str__(self) -> str:
        lines = [self.title.center(WIDTH).rstrip(), "=" * WIDTH, *self._head_lines()]
        blocks = _by_site(self.table)
        widths = _widths(blocks)
        lines += ["=" * WIDTH, _line(_HEAD, widths), "-" * WIDTH]
        for site, rows in blocks:
            lines.append(site)
            lines += [_line([f"  {row[0]}", *row[1:]], widths) for row in rows]
        lines.append("=" * WIDTH)
        if self.verdict is not None:
            words = f"{self.verdict.state.upper()}: {self.verdict.sentence}"
            lines += textwrap.wrap(words, WIDTH)
            for reason in self.verdict.reasons:
                lines += _item(reason)
            for assumption in self.verdict.assumptions:
                lines += _item(f"Assumed: {assumption}")
        for note in self.notes:
            lines += _item(note)
        return "\n".join(lines)

    def _head_lines(self) -> list[str]:
        """Names and values, two beside each other where they fit."""
        half = WIDTH // 2
        lines: list[str] = []
        first_entry = ""
        for name, value in self.head:
            entry = f"{name + ':':17s} {value}"
            if first_entry and len(entry) < half:
                lines.append(f"{first_entry:{half}s}{entry}")
                first_entry = ""
                continue
            if first_entry:
                lines.append(first_entry)
            first_entry = entry
            if len(entry) >= half:
                lines.append(first_entry)
                first_entry = ""
        return [*lines, first_entry] if first_entry else lines

    def as_html(self) -> str:
        """One page to print, every name escaped; no file next to it is needed.

        Returns
        -------
        str
        """
        title = escape(self.title)
        return (
            "<!doctype html>\n<html lang='en'><head><meta charset='utf-8'>"
            "<meta name='viewport' content='width=device-width'>"
            f"<title>{title}</title><style>{_STYLE}</style></head><body>"
            f"<h1>{title}</h1>{self._repr_html_()}</body></html>\n"
        )

    def _repr_html_(self) -> str:
        parts = []
        if self.verdict is not None:
            words = f"{self.verdict.state.upper()}: {self.verdict.sentence}"
            parts.append(f"<p><b>{escape(words)}</b></p>")
            texts = list(self.verdict.reasons)
            texts += [f"Assumed: {text}" for text in self.verdict.assumptions]
            reasons = "".join(f"<li>{escape(text)}</li>" for text in texts)
            if reasons:
                parts.append(f"<ul>{reasons}</ul>")

        head = ""
        for first in range(0, len(self.head), 2):
            cells = ""
            for name, value in self.head[first : first + 2]:
                cells += f"<td>{escape(name)}</td><td>{escape(value)}</td>"
            head += f"<tr>{cells}</tr>"
        parts.append(f"<table class='head'>{head}</table>")

        body = _html_row(_HEAD, "th")
        for site, rows in _by_site(self.table):
            body += (
                f"<tr class='site'><th colspan='{len(_HEAD)}'>{escape(site)}</th></tr>"
            )
            body += "".join(_html_row(row, "td") for row in rows)
        parts.append(f"<table>{body}</table>")
        parts += [f"<p>{escape(note)}</p>" for note in self.notes]
        return "".join(parts)

    def as_latex(self) -> str:
        """A table for a paper (package booktabs).

        Returns
        -------
        str
        """
        lines = [r"\begin{tabular}{lrrrrlr}", r"\toprule", _latex_row(_HEAD)]
        for site, rows in _by_site(self.table):
            name = site.translate(_NO_LATEX)
            lines += [r"\midrule", rf"\multicolumn{{{len(_HEAD)}}}{{l}}{{{name}}} \\"]
            lines += [_latex_row(row) for row in rows]
        return "\n".join([*lines, r"\bottomrule", r"\end{tabular}"]) + "\n"


def summary_of(
    model: ChainModel,
    bounds: Bounds,
    errors: Mapping[str, float],
    shares: Mapping[str, pd.Series],
    known_masses: Mapping[int, float],
) -> pd.DataFrame:
    """The table of a summary.

    Parameters
    ----------
    model : ChainModel
    bounds : mapping of str to (float, float)
        95 % intervals by parameter.
    errors : mapping of str to float
        Standard errors by parameter.
    shares : mapping of str to Series
        Share of each term of the force of its site, percent.
    known_masses : mapping of int to float
        Those that were given, kg.
    """
    rows = []
    for j in range(1, model.n_dof + 1):
        term = f"m{j} (given)" if j in known_masses else f"m{j}"
        rows.append((f"m{j}", "", term, model.units.mass, np.nan))
    for site, force in model.restoring_forces.items():
        share = shares.get(str(site), pd.Series(dtype=float))
        for term, unit in zip(force.coefficients.index, force.units):
            name = f"{site}: {term}"
            rows.append((name, str(site), str(term), unit, share.get(term, np.nan)))
    labels = pd.DataFrame(rows, columns=["parameter", "site", "term", "unit", "share"])

    estimates = parameters_of(model)
    table = labels.set_index("parameter").loc[estimates.index]
    table["estimate"] = estimates
    table["std_error"] = [errors.get(name, np.nan) for name in table.index]
    ends = [bounds.get(name, (np.nan, np.nan)) for name in table.index]
    table["lower"], table["upper"] = np.array(ends, dtype=float).T
    table = table.rename_axis("parameter")[_COLUMNS]
    return pd.concat([table, _shapes(model)])


def _shapes(model: ChainModel) -> pd.DataFrame:
    """Shape parameters with their units; their intervals stand with their steps."""
    rows = {}
    for site, force in model.restoring_forces.items():
        for law in force.laws:
            units = force.shape_units(law)
            for name, value in law.shape.items():
                if value is None:
                    continue
                label = f"{name} ({plain_name(law.name)})"
                rows[f"{site}: {label}"] = {
                    "site": str(site),
                    "term": label,
                    "estimate": float(value),
                    "unit": units[name],
                }
    return pd.DataFrame.from_dict(rows, orient="index")


def _by_site(table: pd.DataFrame) -> list[tuple[str, list[list[str]]]]:
    """Rows in words, below the name of their site."""
    blocks = []
    for site, rows in table.groupby("site", sort=False):
        shown = [_in_words(row) for _, row in rows.iterrows()]
        blocks.append((str(site) or "masses", shown))
    return blocks


def _in_words(row: pd.Series) -> list[str]:
    """A row as text, with the digits that its interval leaves."""
    low, high = float(row["lower"]), float(row["upper"])
    numbers = []
    for value in (row["estimate"], low, high):
        numbers.append(as_text(Estimate(float(value), low, high)))
    error = as_text(Estimate(float(f"{row['std_error']:.2g}"), np.nan, np.nan))
    share = row["share"]
    carried = f"{share:.1f}" if np.isfinite(share) else ""
    estimate, lower, upper = numbers
    unit = pretty(str(row["unit"]))
    return [pretty(str(row["term"])), estimate, error, lower, upper, unit, carried]


def _widths(blocks: Sequence[tuple[str, list[list[str]]]]) -> list[int]:
    """Widths of the columns of a text."""
    widths = list(_WIDTHS)
    longest = max((len(row[_UNIT]) for _, rows in blocks for row in rows), default=0)
    further = max(0, longest + 1 - widths[_UNIT])
    widths[_UNIT] += further
    widths[0] -= further
    return widths


def _line(cells: Sequence[str], widths: Sequence[int]) -> str:
    """One line of text."""
    first = f"{cells[0]:{widths[0]}s}"
    others = []
    for k, (cell, width) in enumerate(zip(cells[1:], widths[1:]), 1):
        others.append(f" {cell:{width - 1}s}" if k == _UNIT else f"{cell:>{width}s}")
    return (first + "".join(others)).rstrip()


def _item(text: str) -> list[str]:
    return textwrap.wrap(text, WIDTH, initial_indent="- ", subsequent_indent="  ")


def _html_row(cells: Sequence[str], tag: str) -> str:
    return f"<tr>{''.join(f'<{tag}>{escape(cell)}</{tag}>' for cell in cells)}</tr>"


def _latex_row(cells: Sequence[str]) -> str:
    safe = []
    for cell in cells:
        text = cell.replace("−", "-").translate(_NO_LATEX)
        text = text.replace("×", r"$\times$")
        safe.append(_RAISED.sub(_raised_in_latex, text))
    return " & ".join(safe) + r" \\"


def _raised_in_latex(match: re.Match[str]) -> str:
    """Raised digits as an exponent."""
    return f"$^{{{match[0].translate(_LOWERED)}}}$"
