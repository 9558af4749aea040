"""Folds and held-out pieces hold their share of energy and time, and never overlap."""

import numpy as np
import pytest
from loop_parts import folds_of, plain_segment, window_length

from pysindy_nrf.exceptions import ChannelError
from pysindy_nrf.records import BlockRows, Segment

T = np.arange(8000) * 0.01
BLOW = np.exp(-0.5 * ((T - 20) / 4) ** 2) * np.cos(12 * T)
SWELL = np.minimum(1.0, np.minimum(T, 80 - T) / 28)
NOISE = np.random.default_rng(0).standard_normal((2, len(T)))
# drift and force of tests
MOTIONS = {
    "a sine": (np.sin(2 * np.pi * 0.9 * T), np.cos(2 * np.pi * 0.9 * T)),
    "seven cycles that swell and fade": (
        SWELL * np.cos(0.55 * T),
        SWELL * np.sin(0.55 * T),
    ),
    "a transient": (BLOW, np.roll(BLOW, 3)),
    "a slow test of growing cycles": (T * np.cos(0.8 * T), T * np.sin(0.8 * T)),
    "noise": (NOISE[0], NOISE[1]),
}


def rows_of(blocks):
    """Numbers of the rows of some blocks."""
    return np.concatenate([np.arange(b.rows.start, b.rows.stop) for b in blocks])


@pytest.fixture(params=MOTIONS)
def segment(request):
    """A record of one kind of motion."""
    return plain_segment(*MOTIONS[request.param])


def test_folds_and_heldout_pieces_do_not_overlap(segment):
    folds = folds_of(segment)
    rows = np.concatenate([rows_of(folds.search), rows_of(folds.heldout)])
    assert len(np.unique(rows)) == len(rows)
    assert len(folds.search) >= 3


def test_heldout_pieces_last_a_window(segment):
    length = window_length([segment])
    for block in folds_of(segment).heldout:
        samples = 2 * round(0.5 * length / segment.dt)
        assert block.rows.stop - block.rows.start >= 2 * samples


def test_heldout_pieces_hold_their_share_of_the_energy(segment):
    """Also of each half of a sine: they see all of its phases."""
    folds = folds_of(segment)
    searched, heldout = rows_of(folds.search), rows_of(folds.heldout)
    used = np.concatenate([searched, heldout])

    for channel in (segment.v[:, 0], segment.F[:, 0]):
        energy = channel**2
        assert 0.15 < energy[heldout].sum() / energy[used].sum() < 0.4
        for half in (np.maximum(channel, 0.0) ** 2, np.minimum(channel, 0.0) ** 2):
            assert 0.1 < half[heldout].sum() / half.sum() < 0.5


def test_a_channel_of_zeros_has_no_say_in_the_cut():
    drift = MOTIONS["a sine"][0]
    with_force = folds_of(plain_segment(drift, drift))
    without_force = folds_of(plain_segment(drift, 0 * drift))
    assert without_force == with_force


def blows_on_four_floors(rng):
    """A record in which three blows hit each of four floors, and their rows."""
    rates, forces = rng.standard_normal((8000, 4)), np.zeros((8000, 4))
    rows = np.linspace(500, 7500, 12).astype(int) + rng.integers(-200, 200, 12)
    blows = rng.permutation(rows).reshape(4, 3)
    for floor in range(4):
        forces[blows[floor], floor] = rng.uniform(0.7, 1.3, 3)
    every = slice(0, 8000)
    segment = Segment("r", every, rates, rates, rates, forces, T, valid=every)
    return segment, blows


def test_cuts_seldom_lose_all_blows_on_a_floor():
    """One of three lies half a window inside a fold in nine cases of ten."""
    rng, lost = np.random.default_rng(1), 0
    for _ in range(40):
        segment, blows = blows_on_four_floors(rng)
        length = window_length([segment])
        search = folds_of(segment).search
        for on_floor in blows:
            depths = [0]
            for block in search:
                ahead = on_floor - block.rows.start
                behind = block.rows.stop - 1 - on_floor
                depths.append(np.minimum(ahead, behind).max())
            lost += max(depths) < 0.5 * length / segment.dt
    assert lost < 16


def test_records_held_out_whole_leave_the_others_to_the_search():
    segment = plain_segment(*MOTIONS["noise"])
    folds = folds_of(segment, segment, heldout=[1])
    assert {block.segment for block in folds.search} == {0}
    assert folds.heldout == [BlockRows(1, slice(0, len(T)))]


@pytest.mark.parametrize("n_samples", [2, 5, 20])
def test_records_too_short_are_named(n_samples):
    drift, force = MOTIONS["a sine"]
    short = plain_segment(drift[:n_samples], force[:n_samples])
    with pytest.raises(ChannelError, match="too short to be split"):
        folds_of(short)


def test_records_in_which_nothing_moves_are_named():
    with pytest.raises(ChannelError, match="Nothing moves"):
        folds_of(plain_segment(0 * T, 0 * T))
