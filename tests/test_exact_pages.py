"""Exact words and numbers of the report, and the thresholds that the benchmarks were run with."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from hand_made_walk import finding, refuse

from pysindy_nrf import NRFRegressor, Site, laws
from pysindy_nrf.discrepancy import (
    begin_elsewhere,
    localisation,
    markdown,
    noise_floor,
    noise_level,
    prepare,
    ranking,
    reestimate,
    report,
    residual,
    rounds,
    search,
    second_opinion,
    sensors,
    splits,
    stage,
    standing,
    steps,
    surrogate,
    together,
    workspace,
)
from pysindy_nrf.discrepancy.report import Step
from pysindy_nrf.discrepancy.splits import BlockRows

# -- pages ------------------------------------------------------------------------------------------


def told_report(**more):
    step = Step(
        "dahl", "hysteresis", "storey 2", parameters={"Fd": 2.0}, evidence="a|b", tied=[("iwan", "storey 2", 1.0)]
    )
    step.runners_up = [("iwan", "storey 2", 1.0), ("jenkins", "storey 1", 2.0)]
    step.detection, step.characterisation = "It is no noise.", "It is a loop."
    table = pd.DataFrame({"held-out": [31.0, 2.0]}, index=["baseline", "dahl at storey 2"])
    return SimpleNamespace(
        **{
            "steps": [step],
            "stopped_because": "of <it>",
            "table": table,
            "evidence": [],
            "measured": [],
            "model": "m ``` n",
            "settings": {},
            **more,
        }
    )


def test_a_report_in_markdown_line_by_line():
    one = told_report()
    head = [
        "# Closing the loop",
        "",
        f"1. {one.steps[0].sentence}".replace("|", "\\|"),
        "",
        "Stopped: of &lt;it>.",
        "",
        "Errors in percent NRMSE; balance errors (one step) except the free run.",
        "",
        "|  | held-out |",
        "|---|---|",
        "| baseline | 31 |",
        "| dahl at storey 2 | 2 |",
        "",
        "## Step 1: dahl at storey 2",
        "",
        "- It is no noise.",
        "- It is a loop.",
        "- Accepted because a\\|b.",
        "",
        "| parameter | estimate | lower | upper |",
        "|---|---|---|---|",
        "| Fd | 2 |  |  |",
        "",
        "Alternatives:",
        "",
        "| law | site | validation error (%) |  |",
        "|---|---|---|---|",
        "| iwan | storey 2 | 1 | tied |",
        "| jenkins | storey 1 | 2 |  |",
        "",
    ]
    tail = ["## Model", "", "```", "m ''' n", "```", ""]
    assert markdown.markdown(one).split("\n") == [*head, *tail]
    seen = [
        SimpleNamespace(detection_sentence=f"d{k}", localisation_sentence=f"l{k}", characterisation_sentence=f"c{k}")
        for k in (1, 2)
    ]
    more = told_report(evidence=seen, measured=[SimpleNamespace(sentence="x1"), SimpleNamespace(sentence="a1")],
                       settings={"loop": {"seed": 0, "band": "full"}, "gate": {"a": 1}})  # fmt: skip
    rest = ["## What is left", "", "- d2", "- l2", "- c2", "", "## What was measured", "", "- x1", "- a1", ""]
    settings = ["## Settings", "", "- loop: seed = 0, band = full", "- gate: a = 1", ""]
    assert markdown.markdown(more).split("\n") == [*head, *rest, *tail, *settings]
    assert markdown.markdown(told_report(steps=[])).split("\n")[2] == "No effect was added."
    plain = Step("dahl", "hysteresis", "storey 2", evidence="why")
    assert (
        "Alternatives:" not in markdown._step(3, plain) and markdown._step(3, plain)[0] == "## Step 3: dahl at storey 2"
    )


def test_settings_name_what_was_held_out():
    ready = SimpleNamespace(heldout=[1, 2], records=[SimpleNamespace(name=n) for n in "abc"])
    tried = [laws.Dahl(), laws.Dahl(1.0), laws.Iwan()]
    told = report.audit(NRFRegressor(degree=1), tried, (1.0, 2.0), 5, 3, 2, ready, "words")["loop"]
    assert told == {
        "band": "(1.0, 2.0) Hz",
        "random_state": "5",
        "max_steps": "3",
        "n_surrogates": "2",
        "noise floor": "words",
        "held out": "b; c",
        "catalogue": "dahl, iwan",
    }
    ready.heldout = None
    told = report.audit(NRFRegressor(degree=1), tried, None, 5, 3, 2, ready)["loop"]
    assert told["band"] == "full" and told["held out"] == "a quarter of every record" and told["noise floor"] == ""


def assembled(monkeypatch, errors, steps, band=None, names=None, coupling=""):
    """The report of models whose held-out errors are given, by balance and pooled."""
    monkeypatch.setattr(report, "model_of", lambda layout, solution: layout)
    monkeypatch.setattr(report, "balance_errors", lambda model, moments: pd.DataFrame({"error": model.errors}))
    monkeypatch.setattr(
        report, "free_run_error", lambda model, work, blocks: 2 * model.errors["pooled"] if blocks == "held" else None
    )
    monkeypatch.setattr(report, "gather", lambda scenes, models, steps: [SimpleNamespace(coupling_sentence=coupling)])
    monkeypatch.setattr(report, "loops_of", lambda model, *a: (model, *a))
    monkeypatch.setattr(report, "searched", lambda work: ("data", "filters"))
    monkeypatch.setattr(report, "measured_of", lambda ready: ("measured", ready))
    work = SimpleNamespace(search=[BlockRows(0, slice(0, 9))] * 3, blocks=[0] * 5, held="held", motion=refuse)
    scenes = []
    for k, (found, held) in enumerate(errors):
        model = SimpleNamespace(errors=found, laws=held, visited={}, info=None)
        trial = SimpleNamespace(layout=model, work=work, solve=list, moments=lambda blocks: list(blocks))
        trial.error = lambda solution, blocks, k=k: 10.0 * k + len(solution) + len(blocks)
        scenes.append(report.Scene((names or ["baseline", "one", "two"])[k], trial, np.array([1.0, 5.0, 9.0]) + k))
    one = [finding(laws.Dahl(1.0), 3.0, "storey 2")]
    return report.LoopReport.assemble(work, scenes, steps, "done", one, band, "ready")


def test_the_table_and_the_steps_tell_each_models_errors(monkeypatch):
    site = Site("storey 1")
    told = [Step("dahl", "hysteresis", "storey 1"), Step("iwan", "hysteresis", "storey 1", parameters={"F1": 7.0})]
    old, new = laws.Dahl(1.0).with_values([3.0]), laws.Dahl(1.0).with_values([4.0])
    errors = [
        ({"dof 1": 30.0, "dof 2": 20.0, "pooled": 25.0}, {}),
        ({"dof 1": 3.0, "dof 2": 2.0, "pooled": 2.5}, {site: (old, new)}),
        ({"dof 1": 0.3, "dof 2": 0.2, "pooled": 0.25}, {site: (laws.Iwan(0.1, 0.5),)}),
    ]
    found = assembled(monkeypatch, errors, told, names=["baseline", "same", "same"])
    assert list(found.table.index) == ["baseline", "same", "same (2)"]
    assert list(found.table.columns) == [
        "search",
        "validation",
        "held-out",
        "free run",
        "held-out dof 1",
        "held-out dof 2",
        "band",
    ]
    assert found.table.iloc[1].tolist() == [16.0, 6.0, 2.5, 5.0, 3.0, 2.0, "full"]
    assert [(s.error_before, s.error_after, s.free_run_before, s.free_run_after) for s in told] == [
        (25, 2.5, 50, 5),
        (2.5, 0.25, 5, 0.5),
    ]
    assert told[0].parameters == old.parameters and told[1].parameters == {"F1": 7.0}  # as it stood last
    assert (
        found.model.errors["pooled"] == 0.25
        and len(found.models) == 3
        and found.loops == (found.model, "data", "filters")
    )
    assert found.model.info == {
        "band": None,
        "steps": ["dahl at storey 1", "iwan at storey 1"],
        "stopped_because": "done",
    }
    assert found.candidates.to_dict("records") == [
        {"law": "dahl", "family": "hysteresis", "site": "storey 2", "validation error (%)": 3.0}
    ]
    assert (
        str(found).split("\n")[-1] == "Stopped: done."
        and str(found).startswith("1. dahl at storey 1 ")
        and "\n2. iwan" in str(found)
    )


@pytest.mark.parametrize(
    "band, words",
    [((2.0, 40.0), "2-40 Hz"), ((None, 40.0), "0-40 Hz"), ((2.5, None), "2.5-inf Hz"), ((0.5, 1.5), "0.5-1.5 Hz")],
)
def test_the_table_names_its_band_and_storeys_that_follow_others_are_said_at_the_end(monkeypatch, band, words):
    found = assembled(monkeypatch, [({"pooled": 25.0}, {Site("storey 1"): ()})], [], band, coupling="They are coupled")
    assert found.table["band"].tolist() == [words] and found.stopped_because == "done. They are coupled"
    assert found.model.info == {"band": list(band), "steps": [], "stopped_because": "done. They are coupled"}
    assert str(found) == "No effect was added.\nStopped: done. They are coupled." and found.model.visited == {}


def test_a_scene_has_the_noise_of_its_surrogates():
    assert report.Scene("x", None, None).noise == []
    assert report.Scene("x", None, None, SimpleNamespace(stages=("a", "b"))).noise == ["a", "b"]


# -- numbers ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "module, numbers",
    [
        (localisation, {"_PIECE": 1024, "_FOLLOWED": 8, "_NEAR": 0.05}),
        (begin_elsewhere, {"_MORE": 2}),
        (noise_floor, {"AT_FLOOR": 1.3, "LOUD": 2.0, "BELOW_FLOOR": 0.8}),
        (noise_level, {"QUIET": 0.2, "_FEWEST": 256, "_LEAST": 0.1, "_WINDOW": 64, "_NOISE": 0.99}),
        (prepare, {"CLEAN": 0.004}),
        (reestimate, {"_ROUNDS": 2, "_EVALUATIONS": 40, "_REACH": 0.2, "_ENOUGH": 1e-3}),
        (residual, {"ROUND_OFF": 1e-9}),
        (ranking, {"_SHORTLIST": 14, "_VALIDATED": 10, "_HOPELESS": 0.05}),
        (rounds, {"_DECISIONS": 3, "_WORSE_ALONE": 1.3, "_BEYOND_DOUBT": 0.5, "_FIRSTS": 2}),
        (search, {"_GRID": {1: 9, 2: 5, 3: 4}, "_EVALUATIONS": {1: 24, 2: 60, 3: 110}, "_SIMPLE": 2, "_NEAR": 1.3}),
        (second_opinion, {"_LEFT": 0.25, "_BEYOND": 2.5, "_WEAK": 1.3, "_STRONG": 0.05, "_GAIN": 0.5, "_OPEN": 50.0}),
        (
            sensors,
            {
                "_WITNESSED": 0.05,
                "_AGAIN": 0.5,
                "_ROUGH": 0.2,
                "_TRIALS": 7,
                "_PROMISE": 0.05,
                "_WORTH": 0.1,
                "_REBUILT": 2,
                "_WILD": 20.0,
                "_STEPS": {"channel_delay": (0.05, 1.5), "gain_error": (0.02, 0.6), "sensor_offset": (0.05, 5.0)},
            },
        ),
        (
            splits,
            {
                "HELDOUT_SHARE": 0.25,
                "N_BLOCKS": 10,
                "SETTLING": 0.04,
                "AT_REST": 0.25,
                "RESTING": 0.1,
                "FEWEST_BLOCKS": 4,
                "SEEN": 0.5,
                "LEAST_ROWS": 200,
            },
        ),
        (stage, {"_AT_ONCE": 32}),
        (steps, {"_ONE_CLASS": 0.3, "_NEARLY_FRICTION": 0.25, "SURE": 0.1, "_USUALLY": 0.25, "_OPEN": 50.0}),
        (standing, {"_BIASED": 0.02, "_WRONG": 0.1}),
        (surrogate, {"UNBIASED": 0.005, "_OF_A_SENSOR": 0.5, "_TOO_LOUD": 1.2}),
        (together, {"_MOST": 4}),
        (workspace, {"CACHE": 200_000_000}),
    ],
)
def test_thresholds_have_the_values_that_were_chosen(module, numbers):
    """The tests take them by name; their values are part of what the benchmarks were run with."""
    assert {name: getattr(module, name) for name in numbers} == numbers
    assert sensors._COARSE.tolist() == [-0.6, -0.25, 0.25, 0.6]
