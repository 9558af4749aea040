"""An option that several commands have is one option: the same words, and the same error for the same mistake."""

import re

import pytest

from pysindy_nrf.output.cli.group import cli, run

SHARED = ["--map", "--unit", "--fs", "--coordinates", "--mapping", "--law", "--link", "--known-mass", "--band"]
MISTAKES = [
    ("--map", ["x1"], "'x1' is not of the form CHANNEL=COLUMN"),
    ("--map", ["x1=p", "x1=q"], "x1= is given twice"),
    ("--unit", ["x1=mm", "x1=in"], "x1= is given twice"),
    ("--law", ["storey 1"], "'storey 1' is not of the form SITE=NAME+NAME"),
    ("--law", ["storey 1=dahl+rubber"], "there is no law 'rubber'. Known are"),
    ("--order", ["storey 2"], "'storey 2' is not of the form SITE=DEGREE"),
    ("--order", ["storey 2=high"], "'high' is not a degree (3) or a box k,q (2,3)"),
    ("--order", ["storey 2=2", "storey 2=5"], "storey 2= is given twice"),
    ("--link", ["brace 3-1"], "'brace 3-1' is not a site"),
    ("--link", ["link 2-2"], "'link 2-2' joins DOF 2 to itself"),
    ("--known-mass", ["two=3"], "'two=3' is not a floor and its mass in kg, e.g. 2=12.4"),
    ("--known-mass", ["2=12.4", "2=12.5"], "2= is given twice"),
    ("--band", ["5"], "'5' is not a band, e.g. 0.5,30 (Hz)"),
]


def having(option):
    """Commands with an option, and how each declares it."""
    found = {name: [p for p in one.params if option in p.opts] for name, one in cli.commands.items()}
    return {name: params[0] for name, params in found.items() if params}


@pytest.mark.parametrize("option", SHARED)
def test_an_option_is_declared_once(option):
    said = [p.to_info_dict() | {"kind": type(p.type), "callback": p.callback} for p in having(option).values()]
    assert said and all(one == said[0] for one in said)


@pytest.mark.parametrize(("option", "values", "words"), MISTAKES)
def test_a_mistake_is_named_by_its_option_and_alike_in_every_command(option, values, words, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "500")
    said = set()
    for name in having(option):
        assert run([name, "3", *(part for value in values for part in (option, value))]) == 2
        shown = capsys.readouterr()
        said.add(re.search("^Error: .*", shown.err, re.MULTILINE)[0])
        assert not shown.out
    assert len(said) == 1
    assert said.pop().startswith(f"Error: Invalid value for '{option}': {words}")


def test_links_by_any_spelling_are_the_link(capsys):
    answers = []
    for text in ("link 3-1", "link 1-3", " link  3-1 "):
        assert run(["plan", "3", "--link", text, "--json"]) == 0
        answers.append(capsys.readouterr().out)
    assert len(set(answers)) == 1
