"""The code on the pages of the documentation runs as printed."""

import re
import warnings
from pathlib import Path

import pytest

from pysindy_nrf import laws

DOCS = Path(__file__).parents[1] / "docs"
CODE_BLOCK = re.compile(r"^```python\n(.*?)^```", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"\]\(([\w./-]+\.(?:md|py))\)")
LONG = {
    "classroom.md",
    "closing_the_loop.md",
    "fewer_sensors.md",
    "shaker_test.md",
}
WITH_A_TEST_OF_THEIR_OWN = {"add_your_own_law.md", "fleet.md"}


def pages_with_code():
    for page in sorted(DOCS.glob("*.md")):
        has_code = CODE_BLOCK.search(page.read_text("utf-8"))
        if has_code and page.name not in WITH_A_TEST_OF_THEIR_OWN:
            marks = [pytest.mark.slow] if page.name in LONG else []
            yield pytest.param(page, id=page.stem, marks=marks)


@pytest.mark.parametrize("page", list(pages_with_code()))
def test_the_code_of_the_page_runs(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    namespace = {"__name__": page.stem}
    with warnings.catch_warnings(action="ignore"):
        for block in CODE_BLOCK.findall(page.read_text("utf-8")):
            exec(compile(block, f"<{page.name}>", "exec"), namespace)


def test_every_page_stands_in_the_table_of_contents():
    index = (DOCS / "index.md").read_text("utf-8")
    listed = set(re.findall(r"^([\w/]+)$", index, re.MULTILINE))
    pages = {page.stem for page in DOCS.glob("*.md")}
    assert pages - {"index"} <= listed


def test_links_between_pages_lead_somewhere():
    for page in [*DOCS.glob("*.md"), DOCS.parent / "README.md"]:
        if page.stem != "index":
            for target in LINK.findall(page.read_text("utf-8")):
                if target.startswith("generated/"):  # written when the pages are built
                    continue
                assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_the_catalogue_shows_every_law_and_draws_every_force(tmp_path, monkeypatch):
    pytest.importorskip("matplotlib")
    monkeypatch.syspath_prepend(str(DOCS))
    catalogue = __import__("law_catalogue")
    text = catalogue.write(tmp_path).read_text("utf-8")
    of_the_package = catalogue.of_the_package()
    assert {laws.CoulombFriction, laws.BoucWen} < set(of_the_package.values())
    for name, law in of_the_package.items():
        picture = tmp_path / "laws" / f"{name}.svg"
        assert f"**{name}**" in text
        assert picture.exists() == (law.output == "N"), name


@pytest.mark.parametrize("name", ["method", "performance"])
def test_a_picture_is_drawn(name, monkeypatch):
    pytest.importorskip("matplotlib")
    monkeypatch.syspath_prepend(str(DOCS))
    draw, _ = __import__("pictures").PICTURES[name]
    assert draw().axes


def test_pages_show_the_pictures_that_the_script_draws(monkeypatch):
    pytest.importorskip("matplotlib")
    monkeypatch.syspath_prepend(str(DOCS))
    pages = "".join(page.read_text("utf-8") for page in DOCS.glob("*.md"))
    for name, (_, kind) in __import__("pictures").PICTURES.items():
        assert f"](images/{name}.{kind})" in pages, name
