"""The loop says of every residual whether it is noise, where it acts and what it is
like, before it names a law.
"""

import dataclasses

import numpy as np
import pytest
from pysindy_nrf.discrepancy.characterisation import characterise
from pysindy_nrf.discrepancy.evidence import Evidence, detect, look
from pysindy_nrf.discrepancy.words import Dependence, Feature, ResidualKind
from report_cases import cubic, friction, loop_report, record

from pysindy_nrf import ChainModel, excitation, laws, simulate
from pysindy_nrf.discrepancy import sensors
from pysindy_nrf.discrepancy.prepare import Workspace, prepare
from pysindy_nrf.discrepancy.residual import NoiseFloor, residual_of, searched
from pysindy_nrf.discrepancy.windows import split, window_length
from pysindy_nrf.records.fusion.noise_levels import levels_of

pytestmark = pytest.mark.slow


def workspace(rec, heldout=None):
    ready = prepare(rec, heldout)
    segments = ready.data.segments
    return Workspace(
        ready.data, *split(segments, window_length(segments), ready.heldout), {}
    )


@pytest.mark.parametrize(
    "effect, dependence, mark",
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
    assert (
        first.characterisation.dependence == dependence
        and mark in first.characterisation.features
    )
    assert (
        "not noise" in first.sentences["detection"]
        and "The loop chose storey 2" in first.sentences["localisation"]
    )
    assert dependence.value in first.sentences["characterisation"]


def test_only_rows_of_the_search_are_looked_at():
    work = workspace(record(cubic, seed=1))
    data, filters = searched(work)
    rows = np.concatenate(
        [np.arange(seg.valid.start, seg.valid.stop) for seg in data.segments]
    )
    start = work.data.segments[0].valid.start
    held = np.concatenate(
        [start + np.arange(b.rows.start, b.rows.stop) for b in work.held]
    )
    assert len(filters) == len(data.segments) and not np.isin(rows, held).any()
    few = searched(work, most=1000)[0]
    assert sum(seg.valid.stop - seg.valid.start for seg in few.segments) <= 1000 + len(
        few.segments
    )


def test_channels_are_compared_and_noise_is_sized_on_rows_of_the_search():
    """What is held out inside a record may be as wrong as it likes: a channel with the
    other sign, a loud force.
    """
    rec = record(friction, seed=3, noise=0.02)
    work = workspace(rec)
    seen = work.seen_rows(0)
    assert 0.6 < seen.mean() < 0.9
    velocity, force = rec.velocity.copy(), rec.force.copy()
    velocity[~seen] *= -1.0
    force[~seen] += (
        1e3
        * np.random.default_rng(0).standard_normal(force[~seen].shape)
        * (force.any(axis=0))
    )
    wrong = rec.replace(velocity=velocity, force=force)
    ready = dataclasses.replace(prepare(rec), records=[wrong])
    assert sensors.contradictions(ready, work) == []
    assert levels_of(wrong, {}, seen) == levels_of(rec, {}, seen)


def test_a_law_with_memory_follows_its_path_through_what_is_held_out():
    spring = [laws.LinearElastic(3e4), laws.LinearViscous(30.0)]
    truth = ChainModel(
        [10.0, 8.0], {1: [*spring, laws.Dahl(sigma=1e4, Fd=20.0)], 2: spring}
    )
    F = excitation.band_limited_random(
        2, 6.0, 500.0, excited=2, rms=60.0, band=(0.5, 25), random_state=0
    )
    found = look(workspace(simulate(truth, F, 2e-3)), truth)
    assert (
        found.sizes["percent"].max() < 1.0
    )  # a fresh start of every stretch would leave about 20 %


def test_the_chosen_site_is_said_beside_what_the_signs_say():
    first = loop_report(cubic).evidence[0]
    assert first.sentences["localisation"].endswith(
        "The loop chose storey 2, whose signs explain 100 %."
    )
    assert (
        dataclasses.replace(first, chosen="sensor x1")
        .sentences["localisation"]
        .endswith("The loop chose sensor x1.")
    )
    assert (
        Evidence("baseline")
        .sentences["detection"]
        .startswith("Detection is not possible because")
    )


def test_a_force_linear_in_the_motion_is_no_spectral_line():
    t = np.arange(4000) / 500
    s = np.sin(9 * t) + 0.7 * np.sin(23.1 * t)
    v = 9 * np.cos(9 * t) + 0.7 * 23.1 * np.cos(23.1 * t)
    found = characterise([3.0 * s + 0.5 * v], [laws.Motion(s, v, t=t)])
    assert (
        found.dependence == Dependence.LINEAR
        and "wrong stiffness, damping or mass" in found.sentence
    )


def test_a_residual_with_a_new_tie_is_compared_with_the_noise_of_a_model_without():
    rec, noise = record(friction, seed=2, noise=0.02), record(None, seed=3, noise=0.02)
    plain = loop_report(friction).models[0]
    tied = ChainModel(
        plain.masses, {**plain.laws, "link 3-1": [laws.CubicStiffness(1e3)]}
    )
    floor = NoiseFloor.from_draws([residual_of(plain, noise)])
    assert not detect(residual_of(tied, rec), floor).is_noise
