"""The schemas of files that this package writes, and the check that a file obeys one.

The words of JSON Schema that the shipped schemas use are checked here: reading a model needs no further package.
"""

from __future__ import annotations

import json
import math
import re
from functools import cache
from importlib.resources import files
from typing import Any

from .exceptions import FileFormatError

_TYPES: dict[str, Any] = {
    "object": lambda x: isinstance(x, dict),
    "array": lambda x: isinstance(x, list),
    "string": lambda x: isinstance(x, str),
    "boolean": lambda x: isinstance(x, bool),
    "null": lambda x: x is None,
    "integer": lambda x: not isinstance(x, bool) and (isinstance(x, int) or isinstance(x, float) and x.is_integer()),
    "number": lambda x: not isinstance(x, bool) and isinstance(x, (int, float)) and _finite(x),
}
_WORDS = {"object": "a group of keys", "array": "a list", "string": "a text", "number": "a finite number",
          "integer": "a whole number"}  # fmt: skip


@cache
def schema(name: str = "chain_model") -> dict[str, Any]:
    """A shipped schema (JSON Schema, draft 2020-12).

    Parameters
    ----------
    name : {"chain_model"}

    Returns
    -------
    dict

    Examples
    --------
    >>> from pysindy_nrf.schema import schema
    >>> schema()["required"]
    ['schema', 'version', 'chain', 'masses', 'laws']
    """
    return json.loads((files(__package__) / "schemas" / f"{name}.schema.json").read_text(encoding="utf-8"))


def plain_json(text: str) -> Any:
    """JSON without its loopholes: no NaN, no infinity (not as 1e999 either), no key twice.

    Parameters
    ----------
    text : str

    Returns
    -------
    object

    Raises
    ------
    ValueError
    """

    def constant(word: str) -> Any:
        raise ValueError(f"{word} is no number in JSON")

    def number(word: str) -> float:
        if not math.isfinite(float(word)):
            raise ValueError(f"{word} is beyond the range of a double")
        return float(word)

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        out = dict(pairs)
        if len(out) < len(pairs):
            raise ValueError("a key stands twice in one object")
        return out

    return json.loads(text, parse_constant=constant, parse_float=number, object_pairs_hook=once)


def check(data: Any, rules: dict[str, Any], where: str) -> None:
    """Check data against a schema.

    Parameters
    ----------
    data : object
        Parsed JSON.
    rules : dict
        See :func:`schema`.
    where : str
        Name of the file, for messages.

    Raises
    ------
    FileFormatError
        Naming the place in the file and what it needs.
    """
    fault = _fault(data, rules, rules.get("$defs", {}), "")
    if fault:
        title = rules["title"].partition(",")[0].lower()
        raise FileFormatError(f"{where} is not a readable {title}: {fault}", "Write it anew, or correct it there.")


def _fault(data: Any, rules: dict[str, Any], defs: dict[str, Any], place: str) -> str:
    at = place or "the whole"
    if "$ref" in rules:
        return _fault(data, defs[rules["$ref"].rsplit("/", 1)[1]], defs, place)
    if "anyOf" in rules:
        faults = [_fault(data, rule, defs, place) for rule in rules["anyOf"]]
        return "" if "" in faults else f"{at} is {_shown(data)}"
    if "const" in rules and (data != rules["const"] or isinstance(data, bool)):
        return f"{at} is {_shown(data)}, not {rules['const']!r}"
    if "enum" in rules and data not in rules["enum"]:
        return f"{at} is {_shown(data)}, not one of {', '.join(map(repr, rules['enum']))}"
    kind = rules.get("type")
    if kind and not _TYPES[kind](data):
        return f"{at} is {_shown(data)}, not {_WORDS.get(kind, kind)}"
    if kind in ("number", "integer"):
        low, high = rules.get("minimum", -math.inf), rules.get("maximum", math.inf)
        return "" if low <= data <= high else f"{at} is {_shown(data)}, not between {low} and {high}"
    if kind == "string" and "pattern" in rules and not re.search(rules["pattern"], data):
        return f"{at} is {_shown(data)}, which does not match {rules['pattern']}"
    if kind == "array":
        if not rules.get("minItems", 0) <= len(data) <= rules.get("maxItems", math.inf):
            return f"{at} has {len(data)} entries"
        entries = (_fault(x, rules.get("items", {}), defs, f"{place}[{i}]") for i, x in enumerate(data))
        return next(filter(None, entries), "")
    return _object_fault(data, rules, defs, place, at) if kind == "object" else ""


def _object_fault(data: dict[str, Any], rules: dict[str, Any], defs: dict[str, Any], place: str, at: str) -> str:
    missing = [key for key in rules.get("required", ()) if key not in data]
    if missing:
        return f"{at} lacks {missing[0]!r}"
    known, others = rules.get("properties", {}), rules.get("additionalProperties", {})
    for key, value in data.items():
        if key not in known and others is False:
            return f"{at} has the unknown key {key[:40]!r}"
        fault = _fault(value, known.get(key, others), defs, f"{place}.{key}" if place else key)
        if fault:
            return fault
    return ""


def _finite(x: int | float) -> bool:
    try:
        return math.isfinite(float(x))
    except OverflowError:
        return False


def _shown(data: Any) -> str:
    return repr(data)[:60] if isinstance(data, (str, int, float, bool, type(None))) else f"a {type(data).__name__}"
