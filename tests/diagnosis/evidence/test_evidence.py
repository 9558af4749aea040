"""Before the loop names a law it says where and of what kind the missing force is."""

from dataclasses import replace

import numpy as np
import pytest
from loop_parts import contradictions_in, evidence_in, noise_levels, search_data
from report_cases import cubic, friction, loop_report, record

from pysindy_nrf import ChainModel, excitation, laws, simulate
from pysindy_nrf.diagnosis import (
    Dependence,
    Feature,
    NoiseFloor,
    ResidualKind,
    detect,
    residual_of,
)

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("effect", "dependence", "mark"),
    [
        (friction, Dependence.RATE, Feature.JUMP),
        (cubic, Dependence.DRIFT, Feature.HARDENING),
    ],
)
def test_evidence_names_place_and_kind_before_the_law_does(effect, dependence, mark):
    report = loop_report(effect)
    first = report.evidence[0]
    assert first.detection.verdicts.loc["storey 2", "verdict"] != ResidualKind.NOISE
    assert first.site == "storey 2" == report.steps[0].site
    assert first.characterisation.dependence == dependence
    assert mark in first.characterisation.features

    sentences = first.sentences
    assert "not noise" in sentences["detection"]
    assert "The loop chose storey 2" in sentences["localisation"]
    assert dependence.value in sentences["characterisation"]


@pytest.fixture(scope="module")
def data():
    """A record with its folds."""
    return search_data(record(cubic, seed=1))


def test_only_rows_of_the_search_are_looked_at(data):
    pieces, filters, _ = data.diagnosed().cut()
    first, heldout = data.data.segments[0].valid.start, set()
    for block in data.heldout:
        heldout |= set(range(first + block.rows.start, first + block.rows.stop))
    for piece in pieces.segments:
        assert heldout.isdisjoint(range(piece.valid.start, piece.valid.stop))
    assert len(filters) == len(pieces.segments)


def test_long_records_are_looked_at_in_part(data):
    pieces = data.diagnosed().cut(1000)[0].segments
    n_samples = sum(piece.n_valid for piece in pieces)
    assert n_samples <= 1000 + len(pieces)


@pytest.fixture(scope="module")
def spoilt():
    """A record, its search data, and the same record with nonsense held out.

    A velocity of the other sign, a loud force.
    """
    rec = record(friction, seed=3, noise=0.02)
    data = search_data(rec)
    heldout = ~data.searched_rows(0)
    velocity, force = rec.velocity.copy(), rec.force.copy()
    velocity[heldout] *= -1.0
    noise = np.random.default_rng(0).standard_normal(force[heldout].shape)
    force[heldout] += 1e3 * noise * force.any(axis=0)
    return rec, data, rec.replace(velocity=velocity, force=force)


def test_channels_are_compared_on_rows_of_the_search(spoilt):
    rec, data, wrong = spoilt
    assert 0.6 < data.searched_rows(0).mean() < 0.9
    assert contradictions_in(wrong, fused_as=rec, data=data) == []


def test_noise_is_sized_on_rows_of_the_search(spoilt):
    rec, data, wrong = spoilt
    rows = data.searched_rows(0)
    assert noise_levels(wrong, rows) == noise_levels(rec, rows)


def test_a_law_with_memory_follows_its_path_through_what_is_held_out():
    """A fresh start of every stretch would leave about 20 %."""
    linear = [laws.LinearElastic(3e4), laws.LinearViscous(30.0)]
    dahl = laws.Dahl(sigma=1e4, Fd=20.0)
    truth = ChainModel([10.0, 8.0], {1: [*linear, dahl], 2: linear})
    F = excitation.band_limited_random(
        2, 6.0, 500.0, excited=2, rms=60.0, band=(0.5, 25), random_state=0
    )
    evidence = evidence_in(search_data(simulate(truth, F, 2e-3)), truth)
    assert evidence.sizes["percent"].max() < 1.0


def test_the_chosen_site_is_said_beside_what_the_signs_say():
    first = loop_report(cubic).evidence[0]
    where = first.sentences["localisation"]
    assert where.endswith("The loop chose storey 2, whose signs explain 100 %.")


def test_a_sensor_that_the_signs_do_not_show_can_be_chosen():
    first = replace(loop_report(cubic).evidence[0], chosen="sensor x1")
    assert first.sentences["localisation"].endswith("The loop chose sensor x1.")


def test_a_question_without_an_answer_says_why():
    first = replace(loop_report(cubic).evidence[0], detection=None)
    sentence = first.sentences["detection"]
    assert sentence.startswith("Detection is not possible because")


def test_a_model_with_a_new_tie_is_compared_with_the_noise_of_one_without():
    rec, noise = record(friction, seed=2, noise=0.02), record(None, seed=3, noise=0.02)
    plain = loop_report(friction).models[0]
    tie = {"link 3-1": [laws.CubicStiffness(1e3)]}
    braced = ChainModel(plain.masses, {**plain.laws, **tie})
    floor = NoiseFloor.from_draws([residual_of(plain, noise)])
    assert not detect(residual_of(braced, rec), floor).is_noise
