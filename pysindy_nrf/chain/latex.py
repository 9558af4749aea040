"""Equations in LaTeX, made from the laws' own labels, and as MathML, which needs
neither a network nor a script.
"""

import re
from collections.abc import Mapping
from html import escape
from typing import Any

import numpy as np

from .model import ChainModel
from .restoring_force import RestoringForce
from .sites import index_of

_GREEK = "alpha|beta|gamma|delta|kappa|omega|pi|rho|sigma|tau|zeta"
_MOTION = ("s", "v", "a", "x", "Z")
_TOKEN = re.compile(r"\^-?\w+|[^\W\d]\w*|\d+(?:\.\d+)?(?:e[+-]?\d+)?|\S")
_WORDS = ("sgn", "max", "min", "exp", "cos", "sin", "lag", "gap")
_RAISED = str.maketrans("0123456789n-", "⁰¹²³⁴⁵⁶⁷⁸⁹ⁿ⁻")
_SIGNS = {"*": r"\cdot", "\\": r"\backslash", "~": r"\sim", "^": r"\wedge"} | {
    c: f"\\{c}" for c in "{}%&#$_"
}


def number(value: float, form: str = ".4g") -> str:
    """A number, with a power of ten where it is needed."""
    mantissa, _, exponent = f"{value:{form}}".partition("e")
    return mantissa.rstrip(".") + (
        rf"\times 10^{{{int(exponent)}}}" if exponent else ""
    )


def symbol(name: str) -> str:
    """A name: ``k3`` with a subscript, ``sigma`` in Greek, a word as a word."""
    head, rest = re.fullmatch(rf"((?:{_GREEK})(?=\d*$)|.)(\w*)", name).groups()  # type: ignore[union-attr]
    rest = rest.strip("_").replace("_", "")
    if name in _WORDS:
        return rf"\operatorname{{{name}}}"
    if rest and len(name) > 3 and not rest.isdigit():
        return rf"\text{{{name}}}".replace("_", " ")
    return (f"\\{head}" if len(head) > 1 else head if head != "_" else r"\_") + (
        f"_{{{rest}}}" if rest else ""
    )


def feature(label: str, index: str = "") -> str:
    """The label of a term, its motions with the index of the site."""
    return " ".join(_item(token, index) for token in _TOKEN.findall(label)).replace(
        " ^", "^"
    )


class Estimate(float):
    """A number with its 95 % interval, which sets its digits, zeros among them; faint
    if the interval holds zero.
    """

    form, faint = ".4g", False

    def __new__(
        cls, value: float, low: float = np.nan, high: float = np.nan
    ) -> "Estimate":
        """A number; without an interval it has four digits."""
        self = super().__new__(cls, value)
        half, top = 0.5 * (high - low), max(abs(low), abs(high), 1e-300)
        if half > 0:
            self.form = f"#.{int(np.clip(np.floor(np.log10(top)) - np.floor(np.log10(half)) + 2, 2, 7))}g"
            self.faint = low < 0 < high
        return self


def law_equation(
    force: RestoringForce, bounds: Mapping[str, tuple[float, float]] | None = None
) -> list[str]:
    """The equation of a site as pieces that may stand on several lines; terms whose
    interval holds zero are grey.
    """
    index = index_of(force.site)
    pieces = [f"{_indexed('R', index)}({feature('s', index)}, {feature('v', index)}) ="]
    for law in force.laws:
        for term, c in zip(law.terms(), np.asarray(law.coefficients, dtype=float)):
            if not c and len(law.terms()) > 2:  # taken out by a sparse fit
                continue
            shown = Estimate(c, *(bounds or {}).get(f"{force.site}: {term.label}", ()))
            sign = "-" if c < 0 else "+" if len(pieces) > 1 else ""
            inside = "" if term.label == "1" else rf"\, {feature(term.label, index)}"
            piece = f"{sign} {number(abs(c), shown.form)}{inside}".strip()
            pieces.append(rf"\color{{gray}}{{{piece}}}" if shown.faint else piece)
    return pieces if len(pieces) > 1 else [*pieces, "0"]


def shape_values(force: RestoringForce) -> list[str]:
    """Shape parameters of a site's laws with their units, e.g. sigma = 2e4 1/m."""
    held = (
        (name, x, law.units[name])
        for law in force.laws
        for name, x in law.shape.items()
        if x is not None
    )
    return [
        f"{symbol(name)} = {number(x)}"
        + (rf"\,\text{{{pretty(unit)}}}" if unit else "")
        for name, x, unit in held
    ]


def balance_equations(model: ChainModel) -> list[list[str]]:
    """Force balances of all DOFs as pieces, with the masses in them."""
    sites = [site for site, held in model.laws.items() if held]
    signs = model.chain.incidence(sites) if sites else np.zeros((model.n_dof, 0))
    out = []
    for j, mass in enumerate(model.masses, 1):
        pieces = [rf"{number(mass)}\, {feature('a', str(j))}"]
        held = [(site, sign) for site, sign in zip(sites, signs[j - 1]) if sign]
        pieces += [
            f"{'+' if sign > 0 else '-'} {_indexed('R', index_of(site))}"
            for site, sign in held
        ]
        out.append([*pieces, f"= {_indexed('F', str(j))}"])
    return out


def latex(model: ChainModel) -> str:
    """Force balances and restoring forces as one aligned block."""
    rows = balance_equations(model) + [
        law_equation(force) for force in model.restoring_forces.values() if force.laws
    ]
    lines = [" ".join(pieces).replace("=", "&=", 1) for pieces in rows]
    return "\\begin{aligned}\n" + " \\\\\n".join(lines) + "\n\\end{aligned}"


def mathml(pieces: list[str]) -> str:
    """Pieces of an equation as MathML with their LaTeX; LaTeX alone without the extra,
    or if a label is no formula.
    """
    try:
        from latex2mathml.converter import convert

        spaced = [
            piece if piece[0] not in "+-=" else f"{{}} {piece}" for piece in pieces
        ]  # signs between two terms
        own = 'xmlns="http://www.w3.org/1998/Math/MathML"'  # HTML knows it
        shown = [
            convert(piece).replace(own, f'alttext="{escape(piece)}"', 1)
            for piece in spaced
        ]
    except Exception:  # the converter's errors share no other class
        shown = [f"<code>{escape(piece)}</code>" for piece in pieces]
    return " ".join(shown)


def pretty(text: str) -> str:
    """A unit or the label of a term with raised exponents."""
    return re.sub(r"\^(-?\d+|n)", lambda m: m[1].translate(_RAISED), text)


def _indexed(letter: str, index: str) -> str:
    """A letter with an index, e.g. of a site."""
    return (
        f"{letter}_{{{index}}}"
        if index.replace(",", "").isdigit()
        else rf"{letter}_{{\text{{{index}}}}}"
    )


def _item(token: str, index: str) -> str:
    """One token of a label."""
    if token[0] == "^" and len(token) > 1:
        return f"^{{{token[1:]}}}"
    if token in _MOTION and index:
        return _indexed(token, index)
    if token[0].isdigit():
        return number(float(token)) if "e" in token else token
    return (
        symbol(token) if len(token) > 1 or token.isalpha() else _SIGNS.get(token, token)
    )


def as_text(value: Any) -> str:
    """A number in a table: plain, or with a raised power of ten; empty if it is not
    finite.
    """
    if not np.isfinite(value):
        return ""
    mantissa, _, exponent = f"{float(value):{getattr(value, 'form', '.4g')}}".partition(
        "e"
    )
    mantissa = mantissa.rstrip(".").replace("-", "−")
    return (
        f"{mantissa}×10{str(int(exponent)).translate(_RAISED)}"
        if exponent
        else mantissa
    )
