"""How records are cut for the search: what every floor's force needs."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pysindy_nrf import NRFRegressor, Record, close_loop, laws, simulate
from pysindy_nrf.discrepancy.splits import HELDOUT_SHARE, pieces, seen, split
from pysindy_nrf.exceptions import ChannelError, DataQualityWarning
from pysindy_nrf.regression.chain_model import ChainModel
from pysindy_nrf.regression.segments import Segment, SegmentSet


def steady(force, dt=0.01):
    """A motion of equal energy throughout under some forces."""
    rng = np.random.default_rng(0)
    a, v, s = rng.standard_normal((3, *force.shape))
    rows = slice(0, len(force))
    return Segment("r", rows, a, v, s, force, np.arange(len(force)) * dt, valid=rows)


def share_of(force, blocks):
    return sum((force[b.rows] ** 2).sum(axis=0) for b in blocks) / (force**2).sum(axis=0)


@settings(deadline=None, max_examples=60)
@given(st.lists(st.integers(165, 3990), min_size=4, max_size=4))
def test_the_search_sees_a_blow_on_every_floor(places):
    """Two equal blows on each of two floors, anywhere: at least one of each floor is for the search."""
    force = np.zeros((4000, 2))
    for k, at in enumerate(places):
        force[at : at + 3, k % 2] += 1.0 + np.arange(3)
    segment = steady(force)
    search, held = split([segment])
    assert share_of(force, search).min() > 0.15
    assert seen(search, held, [segment]) == pytest.approx(share_of(force, search))
    rows = np.concatenate([np.arange(4000)[b.rows] for b in [*search, *held]])
    assert len(np.unique(rows)) == len(rows) == 3840  # each row once, but those in which a record cut out of a run settles


@given(st.integers(2, 14), st.sampled_from([4, 2, 1]), st.integers(0, 13))
def test_what_is_held_out_lies_between_blocks_of_the_search(n_blocks, most, shift):
    ends, held = pieces(n_blocks, HELDOUT_SHARE, most, shift)
    assert not held[0] and not held[-1] and 1 <= sum(held) <= most and held.count(False) == n_blocks
    assert np.diff(ends, prepend=0.0)[held].sum() == pytest.approx(HELDOUT_SHARE) and ends[-1] == pytest.approx(1.0)


def test_steady_forces_leave_the_pieces_where_they_are():
    force = np.random.default_rng(1).standard_normal((4000, 3))
    search, held = split([steady(force)])
    assert len(held) == 4 and np.abs(share_of(force, held) - HELDOUT_SHARE).max() < 0.05


@pytest.mark.slow
def test_a_floor_hit_only_where_data_are_usually_held_out_is_identified():
    """Hammer blows in turn on two floors, those on the second where the usual pieces lie; friction in its storey."""
    n, dt, samples = 2, 0.005, 9_000
    usual = [b.rows for b in split([steady(np.ones((samples, n)))])[1]]
    rng = np.random.default_rng(4)
    force = np.zeros((samples, n))
    for at in range(300, samples - 600, 450):
        force[at : at + 4, 0] = 4e3 * (1 + rng.random()) * np.array([0.4, 1, 1, 0.4])
    for rows in usual[1:4]:
        at = (rows.start + rows.stop) // 2
        force[at : at + 4, 1] = 6e3 * np.array([0.4, 1, 1, 0.4])
    m = np.array([900.0, 1100.0])
    held = {i: [laws.LinearViscous(60.0), laws.LinearElastic(4e5)] for i in (1, 2)}
    truth = ChainModel(m, held | {2: [*held[2], laws.CoulombFriction(40.0)]})
    run = simulate(truth, force, dt)
    noisy = {
        k: np.asarray(v) + 0.01 * np.std(v, axis=0) * rng.standard_normal(np.shape(v))
        for k, v in (("acceleration", run.acceleration), ("displacement", run.displacement))
    }
    record = Record(force=force, fs=1 / dt, **noisy)
    report = close_loop(record, NRFRegressor(degree=1), catalogue=[laws.CoulombFriction(), laws.CubicStiffness()])
    assert (report.steps[0].law, report.steps[0].site) == ("coulomb_friction", "storey 2")
    assert np.abs(report.model.masses / m - 1).max() < 0.03
    segment = SegmentSet([steady(force)], samples).segments[0]
    assert share_of(force, split([segment])[0]).min() >= 0.5


@pytest.mark.parametrize("n", [2, 30, 199])
def test_records_too_short_to_be_split_are_named(n):
    with pytest.raises(ChannelError, match="too short to be split"):
        split([steady(np.ones((n, 2)))])


def test_records_in_which_nothing_moves_are_refused():
    still = Record(force=np.random.default_rng(0).standard_normal((1000, 1)), velocity=np.zeros((1000, 1)), fs=100.0)
    with pytest.warns(DataQualityWarning, match="v1 is constant"), pytest.raises(ChannelError, match="Nothing moves"):
        close_loop(still)
