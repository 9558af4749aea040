"""The page of a closed loop shows what was found, decided and refused."""

import re
from dataclasses import replace

import numpy as np
import pytest
from html_page import Page
from report_cases import empty_report, loop_report

from pysindy_nrf import ChainModel
from pysindy_nrf.report import as_html, content_of

pytest.importorskip("jinja2", reason="the page needs the extra 'report'")
pytest.importorskip("plotly", reason="the page needs the extra 'report'")

UNKNOWN = float("nan")


def on_one_line(text):
    return re.sub(r"\s+", " ", text)


def tiles_of(content):
    """Values and notes of the page's head by name."""
    return {tile.name: (tile.value, tile.note) for tile in content.tiles}


def with_step(report, **changes):
    """A report with its first step alone, changed."""
    return replace(
        report,
        steps=[replace(report.steps[0], **changes)],
        table=report.table.iloc[:2],
    )


# -- the story -----------------------------------------------------------------


@pytest.fixture(scope="module")
def text():
    return Page(as_html(loop_report())).text


def test_evidence_and_the_reason_to_stop_are_shown(text):
    report = loop_report()
    for answer in str(report.evidence[0]).splitlines():
        assert on_one_line(answer) in text
    assert on_one_line(report.stopped_because) in text


def test_errors_before_and_after_are_shown(text):
    step = loop_report().steps[0]
    assert f"{step.error_before:.3g} → {step.error_after:.3g} %" in text


def test_the_name_of_a_record_is_text(text):
    assert "shaker <b>1</b>" in text


@pytest.mark.parametrize("setting", ["random_state", "finalists", "numpy"])
def test_settings_and_versions_are_shown(text, setting):
    assert setting in text


@pytest.mark.parametrize("title", ["Symbols", "What was measured", "Audit trail"])
def test_chapters_beside_the_story_are_there(text, title):
    assert title in text


# -- nothing found -------------------------------------------------------------


def test_a_loop_that_finds_nothing_says_so():
    report = empty_report()
    before = report.table["held-out"].iloc[0]
    assert not report.steps
    assert f"leaves {before:.3g} %" in content_of(report).lead
    assert "added nothing to it" in content_of(report).lead
    assert "No effect was added" in report.to_markdown()


def test_a_loop_that_finds_nothing_shows_the_errors_of_the_baseline():
    content = content_of(empty_report())
    tiles = tiles_of(content)
    assert tiles["Effects confirmed"] == ("0", "")
    assert tiles["Held-out balance error"][1] == "the baseline's"
    assert tiles["Held-out free-run error"][1] == ""
    assert [chapter.title for chapter in content.chapters] == ["What is left"]


def test_where_nothing_is_claimed_the_headline_gives_the_reason():
    why = "the best model leaves 85 % of DOF 2"
    report = replace(empty_report(), stopped_because=why, nothing_claimed=True)
    assert content_of(report).lead.endswith(f"T{why[1:]}.")


# -- doubts --------------------------------------------------------------------


def test_a_free_run_that_gets_worse_is_a_doubt():
    report = loop_report()
    worse = with_step(report, free_run_before=10.0, free_run_after=30.0)
    doubts = [reason for reason in worse.verdict.reasons if "10 to 30 %" in reason]
    assert len(doubts) == 1
    assert report.steps[0].site in doubts[0]
    assert not [text for text in report.verdict.reasons if "free run is worse" in text]


def test_a_negative_mass_is_red_and_named():
    report = loop_report()
    masses = [-1.0, 2.0, 3.0]
    model = ChainModel(masses, report.model.laws, report.model.chain)
    verdict = replace(report, model=model, identified=None).verdict
    assert verdict.state == "red"
    assert "m1 = -1 kg" in verdict.sentence


def test_a_free_run_that_is_not_known_is_no_fact_of_a_chapter():
    report = with_step(loop_report(), free_run_before=UNKNOWN, free_run_after=UNKNOWN)
    facts = dict(content_of(report).chapters[0].facts)
    assert "Held-out data" in facts
    assert "Held-out free-run error" not in facts


def test_what_the_data_cannot_tell_apart_is_said_once():
    report = loop_report()
    friction = replace(
        report.steps[0],
        sure=False,
        laws_beside=["dahl"],
        alternatives=["hysteresis"],
        rivals=[("dahl", "storey 2", 4.2)],
    )
    dahl = replace(report.steps[0], law="dahl", sure=False, laws_beside=[friction.law])
    both = replace(report, steps=[friction, dahl], table=report.table.iloc[[0, 1, 1]])

    together = [text for text in both.verdict.reasons if "together" in text]
    assert len(together) == 1
    assert "coulomb friction and dahl" in together[0]

    chapter = content_of(both).chapters[0]
    assert "friction from hysteresis" in dict(chapter.facts)["What else it may be"]
    ties = [table for table in chapter.tables if "cannot distinguish" in table.caption]
    assert [table.rows for table in ties] == [[["dahl", "storey 2", 4.2]]]


# -- an effect that held-out data do not confirm -------------------------------


@pytest.fixture(scope="module")
def refused():
    report = with_step(
        loop_report(),
        confirmed=False,
        sure=False,
        error_after=9.9,
        reduction_heldout=-0.3,
    )
    return replace(report, model=report.models[0])


def test_a_refused_effect_is_in_the_headline_but_not_counted(refused):
    before = refused.table["held-out"].iloc[0]
    tiles = tiles_of(content_of(refused))
    assert "NOT CONFIRMED" in content_of(refused).lead
    assert "added nothing to it" in content_of(refused).lead
    assert tiles["Effects confirmed"] == ("0", "1 more not confirmed")
    assert tiles["Held-out balance error"][0] == f"{before:.3g} %"


def test_a_refused_effect_is_marked_in_tables_and_chapters(refused):
    content = content_of(refused)
    assert content.chapters[0].state == "NOT CONFIRMED"
    held_out = dict(content.chapters[0].facts)["Held-out data"]
    assert held_out.startswith("NOT CONFIRMED")
    assert content.effects.rows[0][-1] == "NOT CONFIRMED"
    assert content.errors[0].rows[1][-1] == "NOT CONFIRMED"


def test_a_refused_effect_is_hatched(refused):
    baseline, effect = content_of(refused).picture[0].marks
    assert effect.hatched
    assert not baseline.hatched


def test_a_refused_effect_is_a_doubt(refused):
    assert "effect" in [ground.kind for ground in refused.verdict.grounds]
    assert any("NOT CONFIRMED" in text for text in content_of(refused).care)


def test_a_refused_effect_is_marked_in_markdown_and_notebook(refused):
    assert "| NOT CONFIRMED |" in refused.to_markdown()
    assert "NOT CONFIRMED" in refused._repr_html_()


def test_the_band_is_a_tile_and_no_column(refused):
    content = content_of(refused)
    assert tiles_of(content)["Band"][1] == "found from the data"
    assert "band" not in content.errors[0].head


def test_errors_of_the_headline_are_those_of_the_model():
    """One effect is confirmed, and a second one is not."""
    report = loop_report()
    step = report.steps[0]
    both = replace(
        report,
        steps=[step, replace(step, confirmed=False)],
        model=report.models[1],
        table=report.table.iloc[[0, 1, 1]],
    )
    before, after = both.table["held-out"].iloc[:2]
    assert f"from {before:.3g} to {after:.3g} %" in content_of(both).lead
    assert np.isclose(both.final["held-out"], after)
