"""Equations as MathML, made from the laws' own labels; no network and no script is needed to show them."""

import re
from collections.abc import Iterator
from html import escape
from typing import Any

import numpy as np

from ...regression.chain_model import ChainModel
from ...regression.restoring_force import RestoringForce
from ..displays._figure import index_of

_GREEK = {
    "alpha": "α", "beta": "β", "gamma": "γ", "delta": "δ", "kappa": "κ", "omega": "ω", "pi": "π", "rho": "ρ",
    "sigma": "σ", "tau": "τ", "zeta": "ζ",
}  # fmt: skip
_MOTION = ("s", "v", "a", "x", "Z")
_SPACE = "<mspace width='0.2em'></mspace>"
_TOKEN = re.compile(r"\s*([A-Za-zΑ-ω]\w*|\d+(?:\.\d+)?(?:e[+-]?\d+)?|.)", re.DOTALL)
_CLOSING = {"(": ")", "[": "]", "|": "|"}
_WORDS = ("sgn", "max", "min", "exp", "cos", "sin", "lag", "gap")
_RAISED = str.maketrans("0123456789n-", "⁰¹²³⁴⁵⁶⁷⁸⁹ⁿ⁻")
_SIGNS = {"-": "−", "*": "⋅", "<": "&lt;", ">": "&gt;", "&": "&amp;"}


def number(value: float, digits: int = 4) -> str:
    """A number as MathML, with a power of ten where it is needed."""
    sign = "<mo>−</mo>" if value < 0 else ""
    mantissa, _, exponent = f"{abs(value):.{digits}g}".partition("e")
    out = f"<mn>{mantissa}</mn>"
    if exponent:
        power = int(exponent)
        inside = f"<mn>{power}</mn>" if power > 0 else f"<mrow><mo>−</mo><mn>{-power}</mn></mrow>"
        out += f"<mo>×</mo><msup><mn>10</mn>{inside}</msup>"
    return f"<mrow>{sign}{out}</mrow>"


def symbol(name: str) -> str:
    """A name as MathML: ``k3`` with a subscript, ``sigma`` in Greek, a word as a word."""
    if name in _GREEK:
        return f"<mi>{_GREEK[name]}</mi>"
    head = next((g for g in _GREEK if name.startswith(g) and name[len(g) :].isdigit()), name[:1])
    rest = name[len(head) :].strip("_").replace("_", "")
    if rest and name not in _WORDS and (len(name) <= 3 or rest.isdigit()):
        return f"<msub><mi>{_GREEK.get(head, escape(head))}</mi>{_atom(rest)}</msub>"
    return f"<mi>{escape(name)}</mi>"


def feature(label: str, index: str = "") -> str:
    """The label of a term as MathML."""
    return _row(iter([t for t in _TOKEN.findall(label) if t.strip()]), index, "")[0]


def law_equation(force: RestoringForce) -> list[str]:
    """The equation of a site as pieces that may stand on several lines."""
    index = index_of(force.site)
    arguments = f"<mo>(</mo>{feature('s', index)}<mo>,</mo>{feature('v', index)}<mo>)</mo>"
    pieces = [_math(f"{_indexed('R', index)}{arguments}<mo form='infix'>=</mo>", f"R {index} =")]
    for law in force.laws:
        for term, c in zip(law.terms(), np.asarray(law.coefficients, dtype=float)):
            sign = "−" if c < 0 else "+"
            lead = f"<mo form='infix'>{sign}</mo>" if len(pieces) > 1 or c < 0 else ""
            inside = "" if term.label == "1" else f"{_SPACE}{feature(term.label, index)}"
            pieces.append(_math(f"{lead}{number(abs(c))}{inside}", f"{sign} {abs(c):.4g} {term.label}"))
    if len(pieces) == 1:
        pieces.append(_math("<mn>0</mn>", "0"))
    return pieces


def shape_values(force: RestoringForce) -> list[str]:
    """Shape parameters of a site's laws, e.g. sigma = 2e4, as ``<math>`` elements with their units as text."""
    out = []
    for law in force.laws:
        units = {p.name: p.unit for p in law.shapes}
        for name, value in law.shape.items():
            if value is not None:
                said = _math(f"{symbol(name)}<mo>=</mo>{number(value)}", f"{name} = {value:.4g}")
                unit = units.get(name, "")
                out.append(said + (f" {escape(pretty(unit))}" if unit not in ("", "1") else ""))
    return out


def balance_equations(model: ChainModel) -> list[list[str]]:
    """Force balances of all DOFs as pieces, with the masses in them."""
    sites = [site for site, held in model.laws.items() if held]
    signs = model.chain.incidence(sites) if sites else np.zeros((model.n_dof, 0))
    out = []
    for j, mass in enumerate(model.masses, 1):
        pieces = [_math(f"{number(mass)}{_SPACE}{feature('a', str(j))}", f"{mass:.4g} a{j}")]
        for site, sign in zip(sites, signs[j - 1]):
            if sign:
                mark, index = ("+" if sign > 0 else "−"), index_of(site)
                pieces.append(_math(f"<mo form='infix'>{mark}</mo>{_indexed('R', index)}", f"{mark} R {index}"))
        pieces.append(_math(f"<mo form='infix'>=</mo>{_indexed('F', str(j))}", f"= F{j}"))
        out.append(pieces)
    return out


def pretty(text: str) -> str:
    """A unit or the label of a term with raised exponents."""
    return re.sub(r"\^(-?\d+|n)", lambda m: m[1].translate(_RAISED), text)


def _math(inside: str, text: str) -> str:
    return f'<math alttext="{escape(text, quote=True)}"><mrow>{inside}</mrow></math>'


def _indexed(letter: str, index: str) -> str:
    return f"<msub><mi>{letter}</mi>{_atom(index)}</msub>"


def _atom(text: str) -> str:
    return f"<mn>{text}</mn>" if text.isdigit() else f"<mtext>{escape(text)}</mtext>"


def _row(tokens: Iterator[str], index: str, closing: str) -> tuple[str, bool]:
    """Items up to a closing bracket in one row."""
    items: list[str] = []
    raised = False
    for token in tokens:
        if token == closing:
            return f"<mrow>{''.join(items)}</mrow>", True
        if token == "^":
            raised = True
            continue
        item = _item(token, tokens, index)
        if raised and items:
            items[-1] = f"<msup>{items[-1]}{item}</msup>"
        else:
            items.append(item)
        raised = False
    return f"<mrow>{''.join(items)}</mrow>", False


def _item(token: str, tokens: Iterator[str], index: str) -> str:
    if token in _CLOSING:
        inside, closed = _row(tokens, index, _CLOSING[token])
        end = f"<mo>{_CLOSING[token]}</mo>" if closed else ""
        return f"<mrow><mo>{token}</mo>{inside}{end}</mrow>"
    if token in _MOTION and index:
        return _indexed(token, index)
    if token[0].isdigit():
        return number(float(token)) if "e" in token else f"<mn>{token}</mn>"
    if token[0].isalpha():
        return symbol(token)
    return f"<mo>{_SIGNS.get(token, escape(token))}</mo>"


def as_text(value: Any) -> str:
    """A number in a table: plain, or with a raised power of ten; empty if it is not finite."""
    try:
        x = float(value)
    except (TypeError, ValueError):
        return str(value)
    if not np.isfinite(x):
        return ""
    mantissa, _, exponent = f"{x:.4g}".partition("e")
    mantissa = mantissa.replace("-", "−")
    if not exponent:
        return mantissa
    return f"{mantissa}×10" + str(int(exponent)).translate(_RAISED)
