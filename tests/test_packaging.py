"""What stands in several files about the package is the same everywhere."""

import re
import tomllib
import warnings
from pathlib import Path

import pytest

import pysindy_nrf

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]


def without_blanks(text):
    return text.replace(" ", "")


def test_the_conda_recipe_requires_what_the_wheel_requires():
    yaml = pytest.importorskip("yaml")
    recipe = yaml.safe_load((ROOT / "conda" / "recipe.yaml").read_text("utf-8"))
    run = {without_blanks(need) for need in recipe["requirements"]["run"]}
    wheel = {without_blanks(need) for need in PROJECT["dependencies"]}
    assert run == wheel | {f"python{PROJECT['requires-python']}"}
    assert recipe["context"]["version"] == pysindy_nrf.__version__


def test_the_citation_names_this_version():
    citation = (ROOT / "CITATION.cff").read_text("utf-8")
    assert f"\nversion: {pysindy_nrf.__version__}\n" in citation


def test_the_package_is_marked_as_typed():
    assert (Path(pysindy_nrf.__file__).parent / "py.typed").exists()


def test_every_citation_of_the_paper_is_in_its_bibliography():
    text = (ROOT / "paper" / "paper.md").read_text("utf-8")
    bibliography = (ROOT / "paper" / "paper.bib").read_text("utf-8")
    cited = set(re.findall(r"@(\w+\d{4}|pyvib)", text))
    listed = set(re.findall(r"^@\w+\{(\w+),", bibliography, re.MULTILINE))
    assert cited == listed


@pytest.mark.examples
def test_the_paper_prints_the_numbers_that_its_script_computes(monkeypatch):
    pytest.importorskip("matplotlib")
    monkeypatch.syspath_prepend(str(ROOT / "paper"))
    text = (ROOT / "paper" / "paper.md").read_text("utf-8")
    make = __import__("make")
    with warnings.catch_warnings(action="ignore"):
        rows = [*make.bundled_rows(), *make.friction_rows()]
    for row in rows:
        assert f"| {' | '.join(row)} |" in text


def test_the_forms_for_issues_are_complete():
    yaml = pytest.importorskip("yaml")
    folder = ROOT / ".github" / "ISSUE_TEMPLATE"
    forms = [path for path in folder.glob("*.yml") if path.stem != "config"]
    assert forms
    for path in forms:
        form = yaml.safe_load(path.read_text("utf-8"))
        assert {"name", "description", "body"} <= set(form)
