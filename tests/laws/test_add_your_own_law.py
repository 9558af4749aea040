"""The page on writing a law runs as it is printed."""

import re
from pathlib import Path

import pytest

from pysindy_nrf.laws import base

PAGE = Path(__file__).parents[2] / "docs" / "add_your_own_law.md"
CODE_BLOCK = re.compile(r"^```python\n(.*?)^```", re.DOTALL | re.MULTILINE)
PRINTED = re.compile(r"^print\(.*?\)\s+# (.*)$", re.MULTILINE)


@pytest.mark.examples
def test_the_page_runs_as_printed(monkeypatch, capsys):
    monkeypatch.setattr(base, "_REGISTRY", dict(base._REGISTRY))
    blocks = CODE_BLOCK.findall(PAGE.read_text(encoding="utf-8"))
    assert len(blocks) >= 5

    namespace = {"__name__": "own_laws"}
    for block in blocks:
        exec(compile(block, f"<{PAGE.name}>", "exec"), namespace)
    expected = PRINTED.findall("\n".join(blocks))
    assert capsys.readouterr().out.splitlines() == expected
