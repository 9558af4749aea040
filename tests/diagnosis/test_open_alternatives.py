"""Intervals beside alternatives that the data do not exclude, and what is assumed."""

import numpy as np
import pandas as pd
import pytest

from pysindy_nrf.diagnosis import Facts, FreeRunFacts, GrowingMode, verdict_from
from pysindy_nrf.diagnosis.assumptions import scale_of
from pysindy_nrf.diagnosis.facts import Alternative, AmbiguousInterval, Move
from pysindy_nrf.diagnosis.open_alternatives import (
    OpenAlternatives,
    ambiguous_intervals,
    with_ambiguity,
)
from pysindy_nrf.records.files import read_record

VALUES = {"m1": 10.0, "storey 1: s": 4e4}
BOUNDS = {"m1": (9.9, 10.1), "storey 1: s": (3.98e4, 4.02e4)}


def brace(change, half_width, share=0.99):
    """A brace that moves the mass, as a share of it."""
    moves = {"m1": Move(10.0 * change, 10.0 * half_width)}
    return Alternative(
        "a brace", "ground 2", "m1", change, half_width, half_width, share, 1.0, moves
    )


def intervals_beside(alternative, unexplained=3.0):
    among = OpenAlternatives.among([alternative], {1: unexplained})
    ambiguous = ambiguous_intervals(VALUES, BOUNDS, among.moves, among.rejecting)
    return with_ambiguity(BOUNDS, ambiguous)


def test_an_alternative_that_changes_little_leaves_intervals_as_they_are():
    assert intervals_beside(brace(0.004, 0.02)) == BOUNDS


def test_an_interval_that_would_be_too_wide_is_withheld():
    """10 kg alone, 7 to 9 kg with the brace."""
    beside = intervals_beside(brace(-0.2, 0.1))
    assert np.isnan(beside["m1"]).all()
    assert beside["storey 1: s"] == BOUNDS["storey 1: s"]


def test_an_interval_that_another_value_matters_for_is_widened():
    """The brace moves a stiffness by 20 %, and the mass by 3 % only."""
    moves = {"m1": Move(0.3, 0.1), "storey 1: s": Move(-8e3, 1e3)}
    alternative = Alternative(
        "a brace", "ground 2", "storey 1: s", -0.2, 0.02, 0.02, 0.99, 1.0, moves
    )
    beside = intervals_beside(alternative)
    assert beside["m1"] == pytest.approx((9.9, 10.4))
    assert np.isnan(beside["storey 1: s"]).all()


def test_intervals_of_a_model_that_the_data_reject_are_withheld():
    """The brace leaves 0.3 of the residual and moves the mass by 4 %."""
    assert np.isnan(intervals_beside(brace(0.04, 0.001, share=0.3))["m1"]).all()
    assert intervals_beside(brace(0.012, 0.001, share=0.3))["m1"][1] > BOUNDS["m1"][1]
    # the model leaves nothing that a sensor could show
    explained = intervals_beside(brace(0.04, 0.001, share=0.3), unexplained=0.2)
    assert explained == BOUNDS


def test_an_interval_that_holds_zero_stays_as_it_is():
    bounds = {"m1": (-1.0, 21.0)}
    moves = {"a brace": {"m1": Move(-8.0, 9.0)}}
    assert ambiguous_intervals({"m1": 10.0}, bounds, moves) == ()


def test_the_reason_names_the_intervals_that_are_withheld():
    withheld = AmbiguousInterval("m1", 7.0, 10.1, ("a brace",), withheld=True)
    facts = Facts(
        unexplained={1: 3.0},
        alternatives=(brace(-0.2, 0.1),),
        ambiguous_intervals=(withheld,),
    )
    verdict = verdict_from(facts)
    assert verdict.state == "amber"
    assert "m1 are withheld" in verdict.reasons[0]


# -- what is assumed -----------------------------------------------------------


def test_the_gain_of_the_only_force_is_assumed_and_no_reason_against_the_model():
    (assumption,) = scale_of([2], {})
    assert (assumption.kind, assumption.names) == ("gain", ("F2",))
    verdict = verdict_from(Facts(unexplained={1: 1.0}, assumptions=(assumption,)))
    assert verdict.state == "green"
    assert verdict.assumptions == (assumption.sentence,)
    assert assumption.sentence in str(verdict)


def test_a_mass_that_was_given_is_assumed_where_no_force_checks_it():
    (assumption,) = scale_of([], {3: 520.0, 1: 0.0})
    assert (assumption.kind, assumption.names) == ("mass", ("m3",))
    assert scale_of([1], {3: 520.0}) == ()


# -- the integrator ------------------------------------------------------------


@pytest.mark.parametrize(
    ("mode", "state"), [(None, "amber"), (GrowingMode(2, -3e-4), "red")]
)
def test_a_run_that_only_newmark_ends_is_a_reason(mode, state):
    run = FreeRunFacts(0.4, by_newmark=True, diverges_by_default=True)
    verdict = verdict_from(Facts({1: 1.0}, free_run=run, growing_mode=mode))
    assert verdict.state == state
    assert "free run" in {ground.kind for ground in verdict.grounds}


def test_a_law_too_stiff_for_the_default_method_is_no_reason():
    run = FreeRunFacts(0.4, by_newmark=True)
    verdict = verdict_from(Facts(unexplained={1: 1.0}, free_run=run))
    assert verdict.state == "green"
    assert "Newmark" in verdict.sentence


def test_units_that_a_file_does_not_state_are_assumed(tmp_path):
    rows = np.arange(64)
    motion = np.sin(0.3 * rows)
    columns = {"F1 [N]": motion, "a1": motion, "x1 [mm]": motion}
    path = tmp_path / "bare.csv"
    pd.DataFrame(columns).to_csv(path, index=False)
    notes = read_record(path, fs=100.0).quality
    texts = [note.message for note in notes if note.kind == "assumed"]
    assert any("a1" in text and "x1" not in text for text in texts)
    assert any("100 Hz" in text for text in texts)
    assert not any(note.is_fault for note in notes)

    verdict = verdict_from(Facts(unexplained={1: 1.0}, quality=notes))
    assert verdict.state == "green"
    assert list(verdict.assumptions) == texts


def test_units_at_the_ends_of_names_are_assumed(tmp_path):
    rows = np.arange(64)
    motion = np.sin(0.3 * rows)
    columns = {"t [s]": rows / 50, "a1_g": motion, "x1 [mm]": motion, "F1 lbf": motion}
    path = tmp_path / "ends.csv"
    pd.DataFrame(columns).to_csv(path, index=False)
    (note,) = [note for note in read_record(path).quality if note.kind == "assumed"]
    assert "a1 in g" in note.message
    assert "F1 in lbf" in note.message
    assert "x1" not in note.message

    declared = read_record(path, units={"a": "g", "F": "lbf"}).quality
    assert not any(note.kind == "assumed" for note in declared)
