"""What stands in several files about the package is the same everywhere."""

import re
import tomllib
import warnings
from pathlib import Path

import pytest

import pysindy_nrf

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]


def needs(lines):
    """Requirements as both kinds of files can be compared."""
    of_conda = {"matplotlib-base": "matplotlib"}
    shown = set()
    for line in lines:
        name, version = re.fullmatch(r"([\w-]+) ?(.*)", line).groups()
        shown.add((of_conda.get(name, name).lower(), version))
    return shown


@pytest.fixture(scope="module")
def recipe():
    yaml = pytest.importorskip("yaml")
    return yaml.safe_load((ROOT / "conda" / "recipe.yaml").read_text("utf-8"))


def test_the_conda_recipe_requires_what_the_wheel_requires(recipe):
    wheel = [*PROJECT["dependencies"], f"python {PROJECT['requires-python']}"]
    assert needs(recipe["requirements"]["run"]) == needs(wheel)

    extras = PROJECT["optional-dependencies"]
    optional = [*extras["plot"], *extras["files"], *extras["report"]]
    assert needs(recipe["requirements"]["run_constraints"]) == needs(optional)

    system = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["build-system"]
    of_build = needs(recipe["requirements"]["host"])
    assert needs(system["requires"]) <= of_build


def test_the_conda_recipe_has_name_version_and_commands_of_the_wheel(recipe):
    assert recipe["package"]["name"] == PROJECT["name"]
    assert recipe["context"]["version"] == pysindy_nrf.__version__
    commands = dict(
        re.split(" = ", c) for c in recipe["build"]["python"]["entry_points"]
    )
    assert commands == PROJECT["scripts"]


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


@pytest.mark.slow
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
