"""The page on fleets runs as it is printed, and what it promises comes out."""

import re
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "docs" / "fleet.md"


def test_the_page_runs_as_printed(monkeypatch, capsys):
    pytest.importorskip("dask")
    pytest.importorskip("pyarrow")
    blocks = re.findall(
        r"^```python\n(.*?)^```",
        PAGE.read_text(encoding="utf-8"),
        re.DOTALL | re.MULTILINE,
    )
    assert len(blocks) >= 6
    namespace = {"__name__": "fleet"}
    for block in blocks:
        exec(compile(block, f"<{PAGE.name}>", "exec"), namespace)
    code = "\n".join(blocks)
    promised = re.findall(r"^(?:#|print\(.*\)  #) (.*)$", code, re.MULTILINE)
    assert len(promised) >= 10
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert rows == [line.split() for line in promised]
