"""The schemas of the files that this package writes, and the check of a file against one."""

from __future__ import annotations

import json
import math
from functools import cache
from importlib.resources import files
from typing import Any

from ..exceptions import FileFormatError


@cache
def schema(name: str = "chain_model") -> dict[str, Any]:
    """A shipped schema (JSON Schema, draft 2020-12)."""
    return json.loads((files(__package__) / "schemas" / f"{name}.schema.json").read_text(encoding="utf-8"))


def plain_json(text: str) -> Any:
    """JSON without its loopholes: ValueError for NaN, infinity (1e999 too) and a key that stands twice."""

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
    """Raise FileFormatError if parsed JSON of the file ``where`` does not obey a schema; it names the place."""
    from jsonschema import Draft202012Validator
    from jsonschema.exceptions import best_match

    fault = best_match(Draft202012Validator(rules).iter_errors(data))
    if fault is not None:
        title = rules["title"].partition(",")[0].lower()
        said = fault.message if len(fault.message) <= 120 else f"{fault.message[:60]} ... {fault.message[-55:]}"
        raise FileFormatError(
            f"{where} is not a readable {title}: {fault.json_path[2:] or 'the whole'}: {said}",
            "Write it anew, or correct it there.",
        )
