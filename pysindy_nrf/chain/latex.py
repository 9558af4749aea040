"""Equations in LaTeX, made from the laws' own labels, and as MathML.

MathML needs neither a network nor a script.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from .restoring_force import RestoringForce
from .sites import index_of

if TYPE_CHECKING:
    from .model import ChainModel

_GREEK = "alpha|beta|gamma|delta|kappa|omega|pi|rho|sigma|tau|zeta"
_NAME = re.compile(rf"((?:{_GREEK})(?=\d*$)|.)(\w*)")
_TOKEN = re.compile(r"\^-?\w+|[^\W\d]\w*|\d+(?:\.\d+)?(?:e[+-]?\d+)?|\S")
# Letters that get the index of the site.
_MOTION = ("s", "v", "a", "x", "Z")
_FUNCTIONS = ("sgn", "max", "min", "exp", "cos", "sin", "lag", "gap")
_RAISED = str.maketrans("0123456789n-", "⁰¹²³⁴⁵⁶⁷⁸⁹ⁿ⁻")
_SIGNS = {"*": r"\cdot", "\\": r"\backslash", "~": r"\sim", "^": r"\wedge"}
_SIGNS |= {sign: f"\\{sign}" for sign in "{}%&#$_"}


def number(value: float, form: str = ".4g") -> str:
    """A number, with a power of ten where it is needed."""
    mantissa, _, exponent = f"{value:{form}}".partition("e")
    mantissa = mantissa.rstrip(".")
    if not exponent:
        return mantissa
    return rf"{mantissa}\times 10^{{{int(exponent)}}}"


def symbol(name: str) -> str:
    """A name: ``k3`` with a subscript, ``sigma`` in Greek, a word as a word."""
    if name in _FUNCTIONS:
        return rf"\operatorname{{{name}}}"

    match = _NAME.fullmatch(name)
    assert match is not None  # any name of at least one letter matches
    head, rest = match.groups()
    rest = rest.replace("_", "")
    if rest and len(name) > 3 and not rest.isdigit():
        return rf"\text{{{name}}}".replace("_", " ")

    if len(head) > 1:
        head = f"\\{head}"
    elif head == "_":
        head = r"\_"
    return f"{head}_{{{rest}}}" if rest else head


def feature(label: str, index: str = "") -> str:
    """The label of a term, its motions with the index of the site."""
    items = [_item(token, index) for token in _TOKEN.findall(label)]
    return " ".join(items).replace(" ^", "^")


class Estimate(float):
    """A number with its 95 % interval, which sets its digits, zeros among them.

    Attributes
    ----------
    form : str
        Format of the number.
    faint : bool
        Whether the interval holds zero.
    """

    form, faint = ".4g", False

    def __new__(
        cls, value: float, low: float = np.nan, high: float = np.nan
    ) -> Estimate:
        """A number; without an interval it has four digits."""
        self = super().__new__(cls, value)
        half = 0.5 * (high - low)
        if half > 0:
            # down to the second digit of the half-width
            size = max(abs(value), half)
            digits = np.floor(np.log10(size)) - np.floor(np.log10(half)) + 2
            self.form = f"#.{int(np.clip(digits, 2, 7))}g"
            self.faint = low < 0 < high
        return self


def law_equation(
    force: RestoringForce, bounds: Mapping[str, tuple[float, float]] | None = None
) -> list[str]:
    """The equation of a site as pieces that may stand on several lines.

    ``bounds`` are intervals by ``"storey 1: s"``; terms whose interval holds zero are
    grey.
    """
    intervals = bounds or {}
    index = index_of(force.site)
    drift = feature("s", index)
    rate = feature("v", index)
    pieces = [f"{_indexed('R', index)}({drift}, {rate}) ="]

    for law in force.laws:
        terms = law.terms()
        for term, value in zip(terms, np.asarray(law.coefficients, dtype=float)):
            if not value and len(terms) > 2:  # taken out by a sparse fit
                continue
            ends = intervals.get(f"{force.site}: {term.label}", ())
            text = _term(Estimate(value, *ends), term.label, index, len(pieces) == 1)
            pieces.append(text)
    return pieces if len(pieces) > 1 else [*pieces, "0"]


def _term(value: Estimate, label: str, index: str, first: bool) -> str:
    """A coefficient times its term, with its sign."""
    sign = "" if first else "+"
    if value < 0:
        sign = "-"
    text = f"{sign} {number(abs(value), value.form)}"
    if label != "1":
        text += rf"\, {feature(label, index)}"
    text = text.strip()
    return rf"\color{{gray}}{{{text}}}" if value.faint else text


def shape_values(force: RestoringForce) -> list[str]:
    """Shape parameters of a site's laws with their units, e.g. sigma = 2e4 1/m."""
    texts = []
    for law in force.laws:
        units = force.shape_units(law)
        for name, value in law.shape.items():
            if value is None:
                continue
            text = f"{symbol(name)} = {number(value)}"
            if units[name]:
                text += rf"\,\text{{{pretty(units[name])}}}"
            texts.append(text)
    return texts


def balance_equations(model: ChainModel) -> list[list[str]]:
    """Equations of motion of all DOFs as pieces, with the masses in them."""
    sites = [site for site, group in model.laws.items() if group]
    equations = []
    for j, mass in enumerate(model.masses, 1):
        pieces = [rf"{number(mass)}\, {feature('a', str(j))}"]
        for site in sites:
            sign = site.incidence(j)
            if sign:
                mark = "+" if sign > 0 else "-"
                pieces.append(f"{mark} {_indexed('R', index_of(site))}")
        pieces.append(f"= {_indexed('F', str(j))}")
        equations.append(pieces)
    return equations


def latex(model: ChainModel) -> str:
    """Equations of motion and restoring forces as one aligned block."""
    equations = balance_equations(model)
    for force in model.restoring_forces.values():
        if force.laws:
            equations.append(law_equation(force))
    lines = [" ".join(pieces).replace("=", "&=", 1) for pieces in equations]
    body = " \\\\\n".join(lines)
    return f"\\begin{{aligned}}\n{body}\n\\end{{aligned}}"


def mathml(pieces: list[str]) -> str:
    """Pieces of an equation as MathML with their LaTeX.

    LaTeX alone without the extra, or if a label is no formula.
    """
    # HTML knows the namespace; the LaTeX stands in its place
    namespace = 'xmlns="http://www.w3.org/1998/Math/MathML"'
    texts = []
    try:
        from latex2mathml.converter import convert

        for piece in pieces:
            # an empty group before a sign makes it one between two terms
            spaced = f"{{}} {piece}" if piece[0] in "+-=" else piece
            shown = convert(spaced)
            texts.append(shown.replace(namespace, f'alttext="{escape(spaced)}"', 1))
    except Exception:  # the converter's errors share no other class
        texts = [f"<code>{escape(piece)}</code>" for piece in pieces]
    return " ".join(texts)


def pretty(text: str) -> str:
    """A unit or the label of a term with raised exponents."""
    return re.sub(r"\^(-?\d+|n)", _raised_match, text)


def _raised_match(match: re.Match[str]) -> str:
    return match[1].translate(_RAISED)


def _indexed(letter: str, index: str) -> str:
    """A letter with an index, e.g. of a site."""
    if index.replace(",", "").isdigit():
        return f"{letter}_{{{index}}}"
    return rf"{letter}_{{\text{{{index}}}}}"


def _item(token: str, index: str) -> str:
    """One token of a label."""
    if token[0] == "^" and len(token) > 1:
        return f"^{{{token[1:]}}}"
    if token in _MOTION and index:
        return _indexed(token, index)
    if token[0].isdigit():
        return number(float(token)) if "e" in token else token
    if len(token) > 1 or token.isalpha():
        return symbol(token)
    return _SIGNS.get(token, token)


def as_text(value: float | np.floating) -> str:
    """A number in a table: plain, or with a raised power of ten.

    Empty if it is not finite.
    """
    if not np.isfinite(value):
        return ""
    form = getattr(value, "form", ".4g")
    mantissa, _, exponent = f"{float(value):{form}}".partition("e")
    mantissa = mantissa.rstrip(".").replace("-", "−")
    if not exponent:
        return mantissa
    return f"{mantissa}×10{str(int(exponent)).translate(_RAISED)}"
