"""The page on writing a law runs as it is printed."""

import re
from pathlib import Path

import pytest

from pysindy_nrf.laws import base

PAGE = Path(__file__).parents[2] / "docs" / "add_your_own_law.md"


@pytest.mark.examples
def test_the_page_runs_as_printed(monkeypatch, capsys):
    monkeypatch.setattr(base, "_REGISTRY", dict(base._REGISTRY))
    blocks = re.findall(
        r"^```python\n(.*?)^```",
        PAGE.read_text(encoding="utf-8"),
        re.DOTALL | re.MULTILINE,
    )
    assert len(blocks) >= 5
    namespace = {"__name__": "own_laws"}
    for block in blocks:
        exec(compile(block, f"<{PAGE.name}>", "exec"), namespace)
    promised = re.findall(r"^print\(.*?\)\s+# (.*)$", "\n".join(blocks), re.MULTILINE)
    assert capsys.readouterr().out.splitlines() == promised
