"""The code on the pages of the documentation runs as printed."""

import re
import warnings
from pathlib import Path

import pytest

from pysindy_nrf import laws

DOCS = Path(__file__).parents[1] / "docs"
LONG = ("closing_the_loop.md", "coming_from_pysindy.md")
# Run by a test of their own.
ELSEWHERE = ("add_your_own_law.md", "fleet.md")
PAGES = [
    pytest.param(p, id=p.stem, marks=pytest.mark.examples if p.name in LONG else ())
    for p in sorted(DOCS.glob("*.md"))
    if p.name not in ELSEWHERE and "```python" in p.read_text("utf-8")
]


@pytest.mark.parametrize("page", PAGES)
def test_the_code_of_the_page_runs(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(
        r"^```python\n(.*?)^```", page.read_text("utf-8"), re.DOTALL | re.MULTILINE
    )
    namespace = {"__name__": page.stem}
    with warnings.catch_warnings(action="ignore"):
        for block in blocks:
            exec(compile(block, f"<{page.name}>", "exec"), namespace)


def test_every_page_stands_in_the_table_of_contents():
    index = (DOCS / "index.md").read_text("utf-8")
    listed = set(re.findall(r"^([\w/]+)$", index, re.MULTILINE))
    assert {p.stem for p in DOCS.glob("*.md")} - {"index"} <= listed


def test_links_between_pages_lead_somewhere():
    for page in [*DOCS.glob("*.md"), DOCS.parent / "README.md"]:
        for target in re.findall(
            r"\]\(([\w./-]+\.(?:md|py))\)", page.read_text("utf-8")
        ):
            if page.stem != "index":
                assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_the_catalogue_shows_every_law_and_draws_every_force(tmp_path, monkeypatch):
    pytest.importorskip("matplotlib")
    monkeypatch.syspath_prepend(str(DOCS))
    page = __import__("law_catalogue")
    text = page.write(tmp_path).read_text("utf-8")
    assert {laws.CoulombFriction, laws.BoucWen} < set(page.of_the_package().values())
    for name, law in page.of_the_package().items():
        assert f"**{name}**" in text
        assert (tmp_path / "laws" / f"{name}.svg").exists() == (law.output == "N"), name
