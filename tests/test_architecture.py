"""The map of the house and the house agree: every room is on it, and each uses only rooms above its own."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pysindy_nrf

HOUSE = Path(pysindy_nrf.__file__).parent
PAGE = (Path(__file__).parents[1] / "docs" / "architecture.md").read_text("utf-8")
# The rows of the map from above: the rooms of each, and what is said of them.
ROWS = [line.split("|")[2:4] for line in PAGE.splitlines() if line.startswith("|")][2:]
PLACE = {room.rstrip("/"): k for k, (rooms, _) in enumerate(ROWS) for room in re.findall(r"`([\w./]+)`", rooms)}
# What the map's own words say is loaded further down when it is asked for: the file that offers it, and the room.
OFFERED = {
    ("alignment.py", "force_delay.py"),
    ("chain.py", "guidance.py"),
    ("chain.py", "identifiability.py"),
    ("discrepancy/report.py", "report"),
    ("fitted.py", "guidance.py"),
    ("io/write.py", "input_arrays.py"),
    ("model.py", "report"),
    ("model.py", "simulation"),
    ("model.py", "state_space.py"),
    ("model_selection/selection.py", "displays"),
    ("record.py", "kinematics.py"),
    ("record.py", "report"),
}


def imports(path: Path) -> Iterator[tuple[str, bool]]:
    """Rooms that a file imports, and whether it does so as soon as it is imported itself; names for types left out."""
    package = path.relative_to(HOUSE).parent.parts

    def below(node: ast.AST, at_once: bool) -> Iterator[tuple[str, bool]]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
                continue
            if isinstance(child, ast.ImportFrom) and child.level:
                base = package[: len(package) - child.level + 1]
                modules = [child.module] if child.module else [alias.name for alias in child.names]
                for module in modules:
                    first = (*base, *module.split("."))[0]
                    room = first if (HOUSE / first).is_dir() else f"{first}.py"
                    if (HOUSE / room).exists():  # not a name of the package itself
                        yield room, at_once
            yield from below(child, at_once and not isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef))

    return below(ast.parse(path.read_text("utf-8")), True)


def test_every_room_stands_on_the_map_and_every_place_on_the_map_is_there():
    rooms = {p.name for p in HOUSE.iterdir() if not p.name.startswith("__") and (p.is_dir() or p.suffix == ".py")}
    assert set(PLACE) == rooms
    for named, said in ROWS:
        folders = [HOUSE / room for room in re.findall(r"`(\w+)/`", named)]
        for name in re.findall(r"`([\w/]+(?:\.py|/))`", said):
            assert any((folder / name).exists() for folder in folders), f"{named.strip()}: {name}"


def test_each_room_uses_only_rooms_above_it_but_for_what_is_asked_of_it():
    down = set()
    for path in sorted(HOUSE.rglob("*.py")):
        name = path.relative_to(HOUSE)
        if name.name == "__main__.py" or name.as_posix() == "__init__.py":
            continue
        for room, at_once in imports(path):
            if PLACE[room] > PLACE[name.parts[0]]:
                assert not at_once, f"{name} imports {room}, which stands below it"
                down.add((name.as_posix(), room))
    assert down == OFFERED
