"""Blocks, gate, search, sensors, surrogates and places against formulas written out and both sides of each threshold."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from pysindy_nrf import ChainModel, Site, laws
from pysindy_nrf.discrepancy import (
    evidence,
    gate,
    intervals,
    likeliest,
    localisation,
    projection,
    second_opinion,
    sensors,
    splits,
    steps,
    surrogate,
)
from pysindy_nrf.discrepancy.admissible import _SLACK, admissible
from pysindy_nrf.discrepancy.catalogue import Candidate
from pysindy_nrf.discrepancy.evidence import Evidence
from pysindy_nrf.discrepancy.floor_source import FloorSource
from pysindy_nrf.discrepancy.gate import FLOOR, MIN_GAIN, MIN_WINS, PARAMETER_GAIN, Verdict, choose, gain_of, judge
from pysindy_nrf.discrepancy.localisation import localise
from pysindy_nrf.discrepancy.noise_floor import AT_FLOOR, NoiseFloor
from pysindy_nrf.discrepancy.report import Step
from pysindy_nrf.discrepancy.residual import residual_of
from pysindy_nrf.discrepancy.search import _GRID, Axes, Finding, plateau
from pysindy_nrf.discrepancy.splits import AT_REST, FEWEST_BLOCKS, RESTING, BlockRows, pieces
from pysindy_nrf.discrepancy.workspace import Workspace, leave_one_out
from pysindy_nrf.exceptions import ChannelError, NRFError
from pysindy_nrf.input_arrays import from_arrays
from pysindy_nrf.laws import base as base_laws
from pysindy_nrf.laws.sensor import ChannelDelay, GainError, SensorOffset


def noise(n, seed=0):
    return np.random.default_rng(seed).standard_normal(n)


def segments(*lengths, n_dof=2, F=None, dt=0.01, seed=0):
    """Records of noise that start from rest."""
    rng, out = np.random.default_rng(seed), []
    for n in lengths:
        X = rng.standard_normal((n, 3 * n_dof))
        X[:8] *= 1e-3
        force = rng.standard_normal((n, n_dof)) if F is None else F
        out += from_arrays(X, force, dt=dt).segments
    return out


# -- blocks -----------------------------------------------------------------------------------------


def after(n, share=0.25, **options):
    """After which blocks of the search a piece is held out."""
    ends, held = pieces(n, share, **options)
    widths = np.diff(np.r_[0.0, ends])
    k = sum(held)
    assert widths[~np.array(held)] == pytest.approx(np.full(n, (1 - share) / n))
    assert widths[np.array(held)] == pytest.approx(np.full(k, share / k)) if k else not share
    return [i - sum(held[:i]) for i, h in enumerate(held) if h]


@pytest.mark.parametrize(
    "n, options, places",
    [
        (10, {}, [3, 5, 7, 9]), (10, {"shift": 1}, [2, 4, 6, 8]), (10, {"shift": 3}, [3, 5, 7, 9]),
        (8, {}, [4, 5, 6, 7]), (7, {}, [4, 6]), (5, {}, [3, 4]), (4, {}, [2, 3]), (4, {"shift": 1}, [1, 2]),
        (10, {"most": 2}, [6, 9]), (10, {"most": 1}, [5]), (10, {"most": 1, "shift": 2}, [3]),
        (3, {}, [2]), (3, {"shift": 1}, [1]), (2, {}, [1]), (1, {}, [1]), (10, {"share": 0.0}, []),
    ],
)  # fmt: skip
def test_pieces_are_held_out_evenly_between_the_blocks_from_the_last_but_one_back(n, options, places):
    assert after(n, **options) == places


def test_energy_is_the_running_sum_of_squares_in_units_of_the_rms():
    (seg,) = segments(50)
    scale = np.array([1.0, 2.0, 3.0, 4.0])
    wanted = (seg.a / [1, 2]) ** 2 + (seg.v / [3, 4]) ** 2
    assert splits.energy(seg, scale) == pytest.approx(wanted.sum(axis=1).cumsum())


@pytest.mark.parametrize("n, few", [(1000, 4), (7000, 7)])
@pytest.mark.parametrize("part", ["s", "v"])
@pytest.mark.parametrize("share, moving", [(0.99, False), (1.01, True)])
def test_a_record_that_starts_in_motion_is_given_time_to_settle(n, few, part, share, moving):
    (seg,) = segments(n)
    for y in (seg.s, seg.v):
        y[:] = 1.0
        y[:few] = 0.0
    y = getattr(seg, part)
    y[:few, 1] = share * AT_REST  # of an rms that it lowers itself a little
    y[:few, 1] *= np.sqrt((n - few) / n / (1 - few / n * (share * AT_REST) ** 2))
    assert splits.settled(seg) == (int(splits.SETTLING * n) if moving else 0)


def test_blocks_of_the_search_have_equal_energy_and_a_quarter_is_held_out():
    one = segments(3000, 1000)
    search, held = splits.split(one, n_blocks=12)
    scale = np.sqrt(np.mean([np.r_[(s.a**2).mean(axis=0), (s.v**2).mean(axis=0)] for s in one], axis=0))
    total = {i: splits.energy(one[i], scale) for i in (0, 1)}
    assert [sum(b.segment == i for b in search) for i in (0, 1)] == [9, 6]  # by energy, but half of twelve at least

    def share(b):
        line = np.r_[0.0, total[b.segment]]
        return (line[b.rows.stop] - line[b.rows.start]) / line[-1]

    for i, (blocks, out) in enumerate(((9, 4), (6, 2))):
        assert [share(b) for b in search if b.segment == i] == pytest.approx([0.75 / blocks] * blocks, abs=0.01)
        assert [share(b) for b in held if b.segment == i] == pytest.approx([0.25 / out] * out, abs=0.01)
        rows = sorted((b.rows.start, b.rows.stop) for b in [*search, *held] if b.segment == i)
        assert rows[0][0] == 0 and rows[-1][1] == len(total[i]) and all(a[1] == b[0] for a, b in zip(rows, rows[1:]))
    search, held = splits.split(one, heldout=[1])
    assert held == [BlockRows(1, slice(0, 1000))] and {b.segment for b in search} == {0} and len(search) == 10


@pytest.mark.parametrize("rows, refused", [(splits.LEAST_ROWS - 1, True), (splits.LEAST_ROWS, False)])
def test_a_search_needs_some_rows(rows, refused):
    one = segments(rows, 500)
    if refused:
        with pytest.raises(ChannelError, match="too short"):
            splits.split(one, heldout=[1])
    else:
        assert sum(b.rows.stop - b.rows.start for b in splits.split(one, heldout=[1])[0]) == rows
    with pytest.raises(ChannelError, match="too short"):
        splits.split(segments(900, 500), heldout=[1], n_blocks=2)
    splits.split(segments(900, 500), heldout=[1], n_blocks=3)


def test_seen_is_the_share_of_each_force_inside_the_search():
    F = np.zeros((100, 3))
    F[10, 0], F[60, 0], F[70, 2] = 3.0, 4.0, 5.0
    F[:, 1] = np.nan
    one = segments(100, n_dof=3, F=F)
    search, held = [BlockRows(0, slice(0, 50))], [BlockRows(0, slice(50, 100))]
    assert splits.force_energy([*search, *held], one).tolist() == [[9, 0, 0], [16, 0, 25]]
    assert splits.seen(search, held, one).tolist() == [9 / 25, 0.0]
    assert splits.seen(search, held, segments(100, n_dof=1, F=np.zeros((100, 1)))).tolist() == [1.0]
    assert splits._balanced(np.array([0.75, 0.5])) == (True, pytest.approx(min(0.5 / 0.75, 0.25 / 0.25)))
    assert splits._balanced(np.array([0.95, splits.SEEN * 0.99])) == (False, pytest.approx(0.2))


@pytest.mark.parametrize("share, joined", [(0.99, True), (1.01, False)])
def test_a_block_whose_forces_rest_goes_with_the_one_before(share, joined):
    n = 6
    F = np.zeros((60, 2))
    rest = share * RESTING / n
    F[::10, 0] = F[::10, 1] = np.sqrt((1 - rest) / (n - 1))
    F[20] = np.sqrt(rest)
    one = segments(60, F=F)
    blocks = [BlockRows(0, slice(10 * k, 10 * k + 10)) for k in range(n)]
    found = splits.awake(blocks, one)
    if joined:
        assert found == [blocks[0], BlockRows(0, slice(10, 30)), *blocks[3:]]
        F[20] = 0.0
        one = segments(60, F=F)
        gap = [b for k, b in enumerate(blocks) if k != 1]  # what lies apart is not joined, but waits for what follows
        assert splits.awake(gap, one) == [blocks[0], BlockRows(0, slice(20, 40)), *blocks[4:]]
    else:
        assert found == blocks


@pytest.mark.parametrize("strong, left", [(FEWEST_BLOCKS, FEWEST_BLOCKS), (FEWEST_BLOCKS - 1, 8)])
def test_blocks_are_not_joined_to_fewer_than_some(strong, left):
    F = np.zeros((80, 1))
    F[: 10 * strong : 10] = 1.0
    blocks = [BlockRows(0, slice(10 * k, 10 * k + 10)) for k in range(8)]
    assert len(splits.awake(blocks, segments(80, n_dof=1, F=F))) == left
    assert splits.awake(blocks, segments(80, n_dof=1, F=np.zeros((80, 1)))) == blocks


def test_leave_one_out_is_the_sum_of_the_others_that_serve():
    grams = np.random.default_rng(0).standard_normal((5, 2, 2))
    members = np.array([[True] * 5, [True, False, True, True, False]])
    out = leave_one_out(grams, members)
    for k in range(5):
        for u in range(2):
            wanted = sum(grams[j] for j in range(5) if j != k and members[u, j])
            assert out[k, u] == pytest.approx(wanted)
    assert leave_one_out(np.arange(3.0), members[:1, :3])[:, 0].tolist() == [3.0, 2.0, 1.0]


def workspace(lengths=(300, 200), **options):
    data = from_arrays(np.zeros((9, 6)), dt=0.01)
    data = type(data)(segments(*lengths, **options), sum(lengths))
    search = [
        BlockRows(0, slice(0, 100)),
        BlockRows(0, slice(100, 150)),
        BlockRows(0, slice(200, 300)),
        BlockRows(1, slice(5, 80)),
    ]
    return Workspace(data, [None] * len(lengths), search, [BlockRows(0, slice(150, 200))], {}, "auto")


def test_a_workspace_knows_its_runs_rows_scales_and_sizes():
    work = workspace()
    one, two = work.data.segments
    assert work.runs(0) == [slice(0, 150), slice(200, 300)] and work.sizes.tolist() == [100, 50, 100, 75]
    assert np.flatnonzero(~work.seen_rows(0)).tolist() == list(range(150, 200))
    assert work.seen_rows(1).sum() == 75 and work.seen_rows(1)[5] and not work.seen_rows(1)[80]
    assert [(i, p.valid) for i, p in work.pieces()] == [(0, slice(0, 150)), (0, slice(200, 300)), (1, slice(5, 80))]
    s, v, length, clock = work.scales(Site("ground 2"))
    rows = np.r_[0:150, 200:300]
    for got, a, b in ((s, one.s, two.s), (v, one.v, two.v)):
        whole = np.concatenate([a[rows].sum(axis=1), b[5:80].sum(axis=1)])
        assert got == pytest.approx(np.sqrt(np.mean(whole**2)))
    assert length == pytest.approx(2.99) and clock == pytest.approx((0.0, 2.99)) and work.fastest == pytest.approx(50.0)
    assert [(s.start, s.stop) for s in work.spans] == [(0, 100), (100, 150), (150, 250), (250, 325)]
    work.known[1, 0] = False
    uses, members = work.uses([(1,), (2,), (1, 2)])
    assert uses == {(1,): 0, (2,): 1, (1, 2): 0} and members.tolist() == [[True] * 3 + [False], [True] * 4]
    assert work.search_fixed.shape == (4, 325) and work.fixed(1)[2:] == pytest.approx(two.F.T)


# -- search -----------------------------------------------------------------------------------------


def axes_of(law, drift=0.02, rate=0.3, length=40.0, fastest=50.0):
    return Axes(law, SimpleNamespace(scales=lambda site: (drift, rate, length), fastest=fastest), Site("storey 1"))


@pytest.mark.parametrize(
    "law", [laws.PowerLawDamping(), laws.BoucWen(), laws.Jenkins(), laws.StiffnessStep(), laws.StribeckFriction()]
)
def test_axes_of_the_search_are_logarithms_where_the_scale_is_one(law):
    axes = axes_of(law)
    low, high = np.array([p.bounds(0.02, 0.3, 40.0) for p in law.shapes]).T
    log = [p.log for p in law.shapes]
    assert axes.values(axes.low) == pytest.approx(low) and axes.values(axes.high) == pytest.approx(high)
    middle = axes.values((axes.low + axes.high) / 2)
    assert middle == pytest.approx(np.where(log, np.sqrt(np.abs(low * high)), (low + high) / 2))
    assert axes.ends == (axes.low[0], axes.high[0])
    at = axes.at(axes.high + 5.0)
    assert [at.shape[p.name] for p in law.shapes] == pytest.approx(high) and axes.point(at) == pytest.approx(axes.high)
    n = len(law.shapes)
    count = _GRID[n] if n in _GRID else 4
    points = np.array(list(axes.grid()))
    assert len(points) == count ** min(n, 2) and axes.step(False) == pytest.approx((axes.high - axes.low) / count)
    shares = (points - axes.low) / (axes.high - axes.low)
    assert sorted(set(shares[:, 0].round(9))) == pytest.approx([(k + 0.5) / count for k in range(count)])
    assert not shares[:, 2:].any()


def test_a_frequency_is_scanned_at_the_lines_within_half_the_sampling_rate():
    axes = axes_of(laws.HarmonicForce())
    assert axes.values(axes.high)[0] == pytest.approx(50.0)
    low = float(axes.values(axes.low)[0])
    found = [axes.values(u)[0] for u in axes.grid([0.99 * low, 1.01 * low, 7.0, 49.9, 50.1])]
    assert found == pytest.approx([1.01 * low, 7.0, 49.9]) and axes.step(True).shape == (1,)
    assert [u.tolist() for u in axes_of(laws.CoulombFriction()).grid()] == [[]]


def test_a_plateau_reaches_as_far_as_the_error_does_not_change():
    def flat(u):
        return 1.0 + max(0.0, u - 0.7) + max(0.0, 0.2 - u)

    low, high = plateau(flat, 0.5, 0.0, 1.0)
    assert (low, high) == pytest.approx((0.2, 0.7), abs=2e-3)
    assert plateau(lambda u: 1.0 + (u - 0.5) ** 2, 0.5, 0.0, 1.0) == (0.5, 0.5)
    assert plateau(lambda u: 1.0, 0.5, 0.0, 1.0) == (0.0, 1.0)
    # 1 + (u - 1/2)^2 within a hundredth: a tenth on either side
    low, high = plateau(lambda u: 1.0 + (u - 0.5) ** 2, 0.5, 0.0, 1.0, 0.01)
    assert (low, high) == pytest.approx((0.4, 0.6), abs=1e-3)
    assert plateau(lambda u: 1.0 + u, 0.0, 0.0, 1.0)[0] == 0.0


@pytest.mark.parametrize("seed", range(3))
def test_least_squares_on_a_gram_matrix_is_that_on_the_columns(seed):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((40, 6)) * 10.0 ** rng.integers(-4, 5, 6)
    columns, target = np.array([4, 0, 2]), np.array([0, 1.5, 0, -2.0, 0, 1.0])
    values, work = np.zeros(6), np.zeros((6, 7))
    assert projection._least_squares(A.T @ A, columns, target, values, work)
    assert values[:3] == pytest.approx(np.linalg.lstsq(A[:, columns] / 1.0, A @ target, rcond=None)[0], rel=1e-6)
    assert projection._square(A.T @ A, target) == pytest.approx(((A @ target) ** 2).sum())
    assert projection._square(-np.eye(2), np.ones(2)) == 0.0


def test_dependent_or_empty_columns_are_refused_and_nearly_dependent_ones_are_not():
    rng = np.random.default_rng(0)
    A = rng.standard_normal((40, 4))
    target, values, work = np.array([0, 0, 0, 1.0]), np.zeros(4), np.zeros((4, 5))
    for bad in (A[:, 0], 0 * A[:, 0], np.full(40, np.inf), np.full(40, np.nan)):
        with np.errstate(invalid="ignore"):
            B = np.column_stack([A[:, 0], bad, A[:, 2:]])
            assert not projection._least_squares(B.T @ B, np.array([0, 1]), target, values, work)
    # exactly orthogonal unit columns, one tilted by d: what is left of it is d^2, and 27e-16 is asked of two... columns
    for d2, good in ((1e-13, True), (1.5e-15, False)):
        G = np.array([[1.0, np.sqrt(1 - d2), 0.5], [np.sqrt(1 - d2), 1.0, 0.2], [0.5, 0.2, 1.0]])
        G[1, 1] = G[0, 1] ** 2 + d2
        assert (
            projection._least_squares(G, np.array([0, 1]), np.array([0, 0, 1.0]), np.zeros(3), np.zeros((3, 4))) == good
        )


@pytest.mark.parametrize(
    "law", [laws.CoulombFriction(), laws.TwoSidedGap(), laws.LinkSpringDashpot(), laws.QuadraticDamping()]
)
def test_what_can_only_resist_must_not_drive_by_more_than_a_tenth(law):
    n = len(law.terms())
    sizes = np.arange(1.0, n + 1) * 3
    assert admissible(law, np.ones(n), sizes)
    assert n > 1 or not admissible(law, -np.ones(n), sizes)
    if n > 1:
        for factor, can_be in ((0.99, True), (1.01, False)):
            weak = np.ones(n) / sizes
            weak[-1] *= -factor * _SLACK
            assert admissible(law, weak, sizes) == can_be


def test_laws_of_either_sign_and_those_a_covariate_drives_are_admitted():
    assert admissible(laws.CubicStiffness(), np.array([-1.0]), np.ones(1))
    assert admissible(laws.CovariateFriction(covariate="T"), np.array([-1.0, -1.0]), np.ones(2))
    assert not admissible(laws.GroundFriction(covariate="vg"), np.array([-1.0]), np.ones(1))
    assert admissible(laws.StribeckFriction(), np.array([1.0, -9.0]), np.ones(2))
    assert not admissible(laws.StribeckFriction(), np.array([-1e-9, 9.0]), np.ones(2))


# -- gate -------------------------------------------------------------------------------------------


def blocks(gain, n=10, wins=None, level=5.0):
    """Errors before and after, with a median that falls by a share, in some of the blocks."""
    before = np.full(n, level)
    after = before * (1 - gain)
    after[: n - (n if wins is None else wins)] = level * 1.5
    return before, after


def test_gain_is_the_fall_of_the_median():
    assert gain_of(np.array([1.0, 4.0, 9.0]), np.array([3.0, 1.0, 100.0])) == pytest.approx(0.25)
    assert gain_of(np.zeros(3), np.ones(3)) == 0.0


@pytest.mark.parametrize(
    "n_parameters, null, at_floor, needed",
    [
        (1, 0.0, False, MIN_GAIN), (2, 0.0, False, MIN_GAIN), (3, 0.0, False, MIN_GAIN + PARAMETER_GAIN),
        (5, 0.0, False, MIN_GAIN + 3 * PARAMETER_GAIN), (1, 0.3, False, 0.35), (1, 0.3, True, 2 * 0.3 + 0.05),
        (1, 0.05, True, MIN_GAIN), (1, 0.06, True, 0.17), (4, 0.1, False, MIN_GAIN + 2 * PARAMETER_GAIN),
    ],
)  # fmt: skip
def test_a_gain_is_asked_that_grows_with_the_parameters_and_what_noise_gains(n_parameters, null, at_floor, needed):
    for gain, accepted in ((needed - 1e-3, False), (needed + 1e-3, True)):
        verdict = judge(*blocks(gain), n_parameters, null, at_floor=at_floor)
        assert verdict.accepted == accepted and verdict.gain == pytest.approx(gain) and verdict.null_gain == null
        assert accepted or f"at least {100 * needed:.0f} % are asked" in verdict.sentence
        assert ("come from noise alone" in verdict.sentence) == (not accepted and null > 0.05 and n_parameters < 4)
    assert judge(*blocks(0.08), least=0.05).accepted and not judge(*blocks(0.08), least=0.1).accepted


def test_an_effect_must_win_in_most_blocks_and_something_must_be_left_to_explain():
    least = round(10 * MIN_WINS)
    assert judge(*blocks(0.5, wins=least)).accepted and judge(*blocks(0.5, wins=least)).wins == MIN_WINS
    lost = judge(*blocks(0.5, wins=least - 1))
    assert not lost.accepted and f"at least {100 * MIN_WINS:.0f} % of the blocks" in lost.sentence
    assert judge(*blocks(0.5, level=1.01 * FLOOR)).accepted and not judge(*blocks(0.5, level=0.99 * FLOOR)).accepted
    assert "over 10 blocks falls by 50 % (5 to 2.5 %), in 100 % of the blocks" in judge(*blocks(0.5)).sentence


def finding(law, error, site="storey 1", drop=()):
    return Finding(Candidate(law, Site(site)), law, error, drop, np.array([error, error, 9 * error]))


def test_a_law_pays_for_the_parameters_that_it_adds_not_for_those_of_the_law_whose_place_it_takes():
    beside = finding(laws.Jenkins(0.1), 1.0)
    instead = finding(laws.BoucWen(1.0, 0.0, 1.5), 0.85, drop=((Site("storey 1"), 1),))
    assert instead.n_parameters == instead.n_added == 4
    assert choose([beside, instead], 1.1)[0] is beside  # 0.87 * 1.1^4 beside 1.02 * 1.1^2, with the floor of 0.02
    instead.n_freed = 2
    assert instead.n_added == 2 and choose([beside, instead], 1.1)[0] is instead


def test_parameters_have_a_price_within_a_family_and_a_smaller_one_between_families():
    plain, shaped = laws.QuadraticDamping(), laws.PowerLawDamping(1.3)
    assert finding(shaped, 1.0).n_parameters == 2 and finding(shaped, 1.25).error == 1.25
    for factor, name in ((1.09, "quadratic_damping"), (1.11, "power_law_damping")):
        found = choose([finding(plain, factor * (1 + FLOOR) - FLOOR), finding(shaped, 1.0)], 1.2)[0]
        assert found.law.name == name
    bilinear = laws.DisplacementDependentDamping(), laws.Jenkins(0.1)
    one, two = (len(law.terms()) + len(law.shapes) for law in bilinear)
    for factor, first in ((0.999, 0), (1.001, 1)):
        price = factor * (1 + gate.SIMPLER) ** (two - one) * (1 + FLOOR) - FLOOR
        found = choose([finding(bilinear[0], price), finding(bilinear[1], 1.0)], 9.0)[0]
        assert found.law.name == bilinear[first].name


def test_other_families_at_the_site_are_tied_within_a_tenth():
    best = finding(laws.CoulombFriction(), 1.0)
    others = [
        finding(laws.QuadraticDamping(), 1.099),
        finding(laws.CubicStiffness(), 1.101),
        finding(laws.Dahl(1.0), 1.05, "storey 2"),
    ]
    chosen, tied = choose([best, *others], 9.0)
    assert chosen is best and tied == [others[0]]
    many = [
        finding(laws.QuadraticDamping(), 1.03),
        finding(laws.CubicStiffness(), 1.02),
        finding(laws.ConstantForce(), 1.01, "dof 1"),
    ]
    chosen, tied = choose([best, *many], 9.0)
    assert [f.law.name for f in tied] == ["constant_force", "cubic_stiffness"]


@pytest.mark.parametrize(
    "simple, share", [(laws.CoulombFriction(), gate.MOST_OF_THE_WORK), (laws.ConstantForce(), gate.HALF_OF_THE_WORK)]
)
def test_a_special_case_that_does_most_of_the_work_goes_first(simple, share):
    general = laws.StribeckFriction(0.1) if simple.name == "coulomb_friction" else laws.QuadraticStiffness()
    before, best = 10.0, 6.0
    for slack, name in ((-0.01, simple.name), (0.01, general.name)):
        error = before - share * (before - best) + slack
        assert choose([finding(general, best), finding(simple, error)], before)[0].law.name == name
    for factor, name in ((0.99, simple.name), (1.01, general.name)):  # nor may it leave twice as much
        error = factor * gate.MOST_LEFT * (1 + FLOOR) - FLOOR
        assert choose([finding(general, 1.0), finding(simple, error)], 90.0)[0].law.name == name


# -- steps ------------------------------------------------------------------------------------------


def test_remainder_is_the_share_of_what_noise_does_not_explain():
    assert steps.remainder(5.0, 4.0, 3.0) == pytest.approx(np.sqrt(7 / 16)) and steps.remainder(5.0, 2.0, 3.0) == 0.0
    assert steps.remainder(5.0, 4.0, np.nan) == pytest.approx(0.8)


def test_what_is_surely_left_is_the_lower_end_of_students_interval_of_the_logarithms():
    folds, others = np.array([2.0, 3.0, 5.0, 9.0]), [np.array([1.0, 2, 2, 3]), np.array([2.0, 1, 3, 4])]
    beyond = np.log(folds) - 0.5 * (np.log(others[0]) + np.log(others[1]))
    low = stats.t.interval(0.90, 3, beyond.mean(), stats.sem(beyond))[0] - beyond.mean()
    assert steps.surely_left(folds, others) == pytest.approx(4.0 * np.exp(low))
    for bad in ([], [np.ones(3)], [np.array([1.0, 0, 1, 1])]):
        assert steps.surely_left(folds, bad) == 4.0
    assert steps.surely_left(folds[:2], [np.ones(2)]) == 2.5 and steps.surely_left(folds[:3], [np.ones(3)]) < 3.0
    assert steps.surely_left(np.array([0.0, 1, 2]), [np.ones(3)]) == 1.0


def test_a_stribeck_force_that_falls_towards_rest_is_improper():
    assert steps.improper("stribeck_friction", {"dF": (-2.0, -0.1)}) and not steps.improper(
        "dahl", {"dF": (-2.0, -0.1)}
    )
    assert not steps.improper("stribeck_friction", {"dF": (-2.0, 0.0)}) and not steps.improper("stribeck_friction", {})


@pytest.mark.parametrize(
    "law, told",
    [
        (laws.Jenkins(0.99 * steps._ONE_CLASS), True), (laws.Jenkins(1.01 * steps._ONE_CLASS), False),
        (laws.Dahl(1.01 / steps._ONE_CLASS), True), (laws.Dahl(0.99 / steps._ONE_CLASS), False),
        (laws.PowerLawDamping(0.99 * steps._NEARLY_FRICTION), True), (laws.PowerLawDamping(1.01 * steps._NEARLY_FRICTION), False),
        (laws.CubicStiffness(), False),
    ],
)  # fmt: skip
def test_what_turns_over_within_a_small_drift_may_be_friction(law, told):
    found = steps._alternatives(finding(law, 1.0), [finding(laws.QuadraticStiffness(), 1.0)] * 2, 1.0)
    assert found == (["friction"] if told else []) + ["stiffness"]


def step(law, family, site="storey 1", **more):
    return Step(law, family, site, validation_before=5.0, validation_after=4.0, noise_floor=3.0, **more)


def test_two_laws_of_one_variable_at_a_site_take_the_certainty_from_each_other():
    both = [
        step("coulomb_friction", "friction"),
        step("quadratic_damping", "damping", remainder=0.9),
        step("cubic_stiffness", "stiffness"),
    ]
    steps.doubt_names(both)
    assert [s.sure for s in both] == [False, False, True] and both[0].company == ["quadratic_damping"]
    assert [s.remainder for s in both] == pytest.approx([np.sqrt(7 / 16), 0.9, 0.0])
    apart = [step("coulomb_friction", "friction"), step("quadratic_damping", "damping", "storey 2")]
    steps.doubt_names(apart)
    assert all(s.sure and not s.company for s in apart)
    offset = [
        step("coulomb_friction", "friction"),
        step("constant_force", "forcing", "dof 1", alternatives=["contact"]),
    ]
    steps.doubt_names(offset)
    assert offset[0].sure and offset[1].alternatives == ["contact", "friction"]
    curved = [step("cubic_stiffness", "stiffness"), step("constant_force", "forcing", "dof 1")]
    steps.doubt_names(curved)
    assert not curved[0].sure and not curved[1].sure


@pytest.mark.parametrize("low, told", [(0.99, True), (1.01, False)])
def test_a_power_whose_interval_reaches_down_to_friction_may_be_that(low, told):
    one = [
        step(
            "power_law_damping",
            "damping",
            intervals={"n": (low * steps._NEARLY_FRICTION, 0.9)},
            alternatives=["stiffness", "x"],
        )
    ]
    steps.doubt_names(one)
    assert one[0].alternatives == (["friction", "stiffness"] if told else ["stiffness", "x"])


def test_a_step_tells_medians_and_the_next_five():
    ranking = [finding(laws.CubicStiffness(), 1.0 + k) for k in range(8)]
    verdict = Verdict(True, 0.4, 0.9, 0.1, "why")
    one = steps.step_of(
        ranking[1], [ranking[3]], verdict, np.array([1.0, 5, 9]), np.array([1.0, 2, 9]), 0.5, ranking, 0.1
    )
    assert (one.validation_before, one.validation_after, one.noise_floor, one.gain) == (5.0, 2.0, 0.5, 0.4)
    assert [r[2] for r in one.runners_up] == [1.0, 3.0, 4.0, 5.0, 6.0] and one.tied == [
        ("cubic_stiffness", "storey 1", 4.0)
    ]
    assert one.evidence == "why" and one.parameters == {} and (one.wins, one.null_gain) == (0.9, 0.1)


# -- likeliest, intervals, second opinion -----------------------------------------------------------


def test_patterns_are_squares_less_their_mean():
    assert likeliest._pattern([1.0, 2.0, 3.0]) == pytest.approx([1 - 14 / 3, 4 - 14 / 3, 9 - 14 / 3])


@pytest.mark.parametrize(
    "errors, distances, winner",
    [
        ((1.0, 0.95), (3.0, 1.0), 1),
        ((1.0, 0.95), (1.0, 3.0), 0),
        ((1.0, 0.95), (1.01 / likeliest._CLEARLY, 1.0), 1),
        ((1.0, 0.95), (0.99 / likeliest._CLEARLY, 1.0), 0),  # as well: the first goes first
        ((1.0, 1.001 * (1 + likeliest._RIVAL)), (9.0, 1.0), 0),  # no rival
        ((1.0, 0.999 * (1 + likeliest._RIVAL)), (9.0, 1.0), 1),
        ((1.0, 0.95), (np.inf, np.inf), 0),
    ],
)
def test_the_law_whose_surrogates_show_the_measured_pattern_is_the_likeliest(monkeypatch, errors, distances, winner):
    found = [finding(law, e) for law, e in zip((laws.CoulombFriction(), laws.CubicStiffness()), errors)]
    monkeypatch.setattr(likeliest, "_error", lambda stage, f: f.error)
    monkeypatch.setattr(likeliest, "_distance", lambda stage, f, rivals, seen, null_of: distances[found.index(f)])
    tied = [finding(laws.QuadraticDamping(), 1.0), finding(laws.ConstantForce(), 1.0)]
    chosen, families = likeliest.likeliest(None, found[0], tied, found[::-1], np.full(3, 50.0), None)
    assert chosen is found[winner]
    assert [f.law.family for f in families] == (["friction", "damping"] if winner else ["damping", "forcing"])


def test_a_distance_is_that_of_the_mean_pattern_of_the_surrogates(monkeypatch):
    errors = {"seen": [1.0, 2.0], "one": [1.0, 3.0], "two": [2.0, 2.0]}
    monkeypatch.setattr(likeliest, "Stage", lambda work, *a: work)
    monkeypatch.setattr(likeliest, "_error", lambda work, f: errors[work][f])
    stage, true = SimpleNamespace(chain=0, laws=0), SimpleNamespace(on=lambda stage: stage)

    def distance(*fakes):
        null = SimpleNamespace(stages=[SimpleNamespace(work=name) for name in fakes])
        return likeliest._distance(stage, true, [0, 1], likeliest._pattern(errors["seen"]), lambda stage: null)

    # squares less their mean: seen -1.5, 1.5; one -4, 4; two 0, 0
    assert distance("seen") == 0.0 and distance("one") == pytest.approx(2.5 * np.sqrt(2))
    assert distance("one", "two") == pytest.approx(0.5 * np.sqrt(2)) and distance() == np.inf


@pytest.mark.parametrize("level", [0.95, 0.8])
def test_half_an_interval_is_students_quantile_of_the_jackknifes_error(monkeypatch, level):
    rng = np.random.default_rng(0)
    x, true = rng.standard_normal((7, 3)), np.array([1.0, 2.0, 3.0])
    means = np.array([np.delete(x, k, axis=0).mean(axis=0) for k in range(7)])
    monkeypatch.setattr(intervals, "_linearised", lambda null, *a: (null, means))
    drift, half = intervals._widths(true + 0.5, None, None, None, None, true, [true + 1.0, true + 2.0], level)
    # the jackknife of a mean is its standard error
    low, high = stats.t.interval(level, 6, x.mean(axis=0), stats.sem(x))
    assert half == pytest.approx((high - low) / 2) and drift == pytest.approx(np.full(3, 1.5))
    assert intervals._widths(true, None, None, None, None, true, [], level)[0].tolist() == [0.0] * 3


def opinion(
    monkeypatch, plain=(2.0, 1.0), clean=None, floor=1.0, bias=0.1, gain=0.5, null_gain=0.0, stages=(1,), rough=False
):
    def stage(k):
        one = SimpleNamespace(number=k)
        one.slot = lambda: SimpleNamespace(folds=lambda: np.full(5, plain[k]))
        return one

    monkeypatch.setattr(
        second_opinion, "unbiased_errors", lambda s, ready: None if clean is None else np.full(5, clean[s.number])
    )
    monkeypatch.setattr(second_opinion, "_rough", lambda s: rough)
    monkeypatch.setattr(second_opinion, "wrong_by", lambda s, null, corrected: null.bias)
    null = SimpleNamespace(hasty=False, ready=SimpleNamespace(clean=False), stages=list(stages), bias=bias, floor=floor)
    return second_opinion.confirmed(Verdict(True, gain, 1.0, null_gain, "by least squares"), stage(0), stage(1), null)


@pytest.mark.parametrize(
    "options, taken",
    [
        ({"clean": (2.0, 1.0)}, True), ({"clean": (2.0, 2.0)}, False),
        ({"clean": (2.0, 2.0 * (1 - 0.26 * 0.5))}, True), ({"clean": (2.0, 2.0 * (1 - 0.24 * 0.5))}, False),
        ({"clean": (2.0, 2.0), "floor": 2.01 / second_opinion._BEYOND}, False),
        ({"clean": (2.0, 2.0), "floor": 1.99 / second_opinion._BEYOND}, True),
        ({"clean": (2.0, 2.0), "floor": np.nan}, False), ({"clean": (2.0, 2.0), "rough": True}, True),
        ({"clean": (2.0, 2.0), "bias": 0.99 * surrogate.UNBIASED}, True),
        # instruments too weak for both models: the bias decides, then the gain
        ({"clean": (2.62, 2.0), "gain": 0.3}, False), ({"clean": (2.62, 2.0), "bias": 0.049, "gain": 0.3}, True),
        ({"clean": (2.58, 2.58), "bias": 0.049}, False), ({"clean": (9.0, 1.29), "gain": 0.9, "bias": 0.049}, True),
        ({"gain": 0.49}, False), ({"gain": 0.51}, True), ({"gain": 0.6, "null_gain": 0.28}, False),
        ({"gain": 0.6, "null_gain": 0.27}, True), ({"gain": 0.9, "plain": (90.0, 50.1), "floor": 90.0}, False),
        ({"gain": 0.9, "plain": (90.0, 49.9), "floor": 90.0}, True), ({"gain": 0.1, "stages": ()}, True),
    ],
)  # fmt: skip
def test_the_second_opinion(monkeypatch, options, taken):
    assert opinion(monkeypatch, **options).accepted == taken


# -- sensors ----------------------------------------------------------------------------------------


def scanned(monkeypatch, error, now=None, law=None, channel="a1"):
    """Scan a fault whose error is a given function of its value; the motion has the pace 10 / s."""
    law, tried = law or GainError(), []
    monkeypatch.setattr(sensors, "_shifted", lambda seg, kind, j, law: law.values[0])
    monkeypatch.setattr(sensors, "_with_segments", lambda work, moved: moved[0])
    monkeypatch.setattr(sensors, "pace", lambda work, j: 10.0)

    def stage(value, chain, laws):
        tried.append(value)
        return SimpleNamespace(trial=lambda: SimpleNamespace(search_error=lambda: error(value)))

    monkeypatch.setattr(sensors, "Stage", stage)
    work = SimpleNamespace(data=SimpleNamespace(segments=[0]), scales=lambda site: (0.5, 0, 0))
    monkeypatch.setattr(sensors, "_means", lambda work, suspect: [])
    base = SimpleNamespace(chain=None, laws=None)
    suspect = sensors.Suspect(law, Site(f"sensor {channel}"))
    return sensors._scan(work, base, suspect, error(0.0) if now is None else now), tried


@pytest.mark.parametrize("law, unit", [(GainError(), 1.0), (ChannelDelay(), 0.1), (SensorOffset(), 0.5)])
@pytest.mark.parametrize("true", [0.13, -0.2])
def test_the_bottom_of_a_parabola_is_found_in_the_units_of_the_fault(monkeypatch, law, unit, true):
    found, tried = scanned(monkeypatch, lambda x: np.sqrt(1.0 + 90 * (x / unit - true) ** 2), law=law)
    error, suspect = found
    step, reach = sensors._STEPS[law.name]
    assert suspect.law.values[0] == pytest.approx(true * unit, abs=0.01 * unit) and error == pytest.approx(
        1.0, abs=0.01
    )
    assert sorted(tried[:2]) == pytest.approx([-step * unit, step * unit])
    assert max(map(abs, tried)) <= max(2 * abs(true) * 1.01, step) * unit


@pytest.mark.parametrize("fall, found", [(0.09, False), (0.11, True)])
def test_a_fault_must_lower_the_error_by_a_tenth(monkeypatch, fall, found):
    curve = (1 - (1 - fall) ** 2) / 0.1**2
    got, tried = scanned(monkeypatch, lambda x: np.sqrt(max(1.0 + curve * ((x - 0.1) ** 2 - 0.01), 0.0)))
    assert (got is not None) == found and len(tried) > 2


@pytest.mark.parametrize("promise, looked", [(0.049, False), (0.051, True)])
def test_a_parabola_that_promises_too_little_is_not_followed(monkeypatch, promise, looked):
    curve = (1 - (1 - promise) ** 2) / 0.1**2
    got, tried = scanned(monkeypatch, lambda x: np.sqrt(1.0 + curve * ((x - 0.1) ** 2 - 0.01)))
    assert got is None and (len(tried) > 2) == looked


@pytest.mark.parametrize("now, found", [(sensors._WILD * 0.99, False), (sensors._WILD * 1.01, True)])
def test_a_large_fault_is_looked_for_coarsely_where_the_model_is_wild(monkeypatch, now, found):
    def error(x):
        return now * (1.0 if abs(x) < 0.05 else 0.2 + min(0.9, abs(x - 0.35) * 8))

    got, _ = scanned(monkeypatch, error)
    assert (got is not None) == found and (got is None or got[1].law.values[0] == pytest.approx(0.35, abs=0.02))
    assert scanned(monkeypatch, lambda x: 30.0 if abs(x) < 0.05 else 29.0)[0] is None


def test_an_error_that_falls_to_the_end_of_the_reach_is_followed_to_it(monkeypatch):
    reach = sensors._STEPS["gain_error"][1]
    got, tried = scanned(monkeypatch, lambda x: 2.0 - x)  # squares without a bottom
    assert got[1].law.values[0] == pytest.approx(reach, rel=0.01) and max(tried) <= reach
    got, _ = scanned(monkeypatch, lambda x: 2.0 + x)
    assert got[1].law.values[0] == pytest.approx(-reach, rel=0.01)


def test_a_channel_freed_of_a_fault_moves_the_drifts_above_and_below():
    (seg,) = segments(400, n_dof=3)
    x, rate = seg.s[:, :2].sum(axis=1), seg.v[:, :2].sum(axis=1)
    gain = GainError(0.25)
    new = sensors._shifted(seg, "a", 2, gain)
    for y, z, whole in ((seg.s, new.s, x), (seg.v, new.v, rate)):
        change = whole / 1.25 - whole
        assert z == pytest.approx(y + np.outer(change, [0, 1, -1]))
    assert new.a == pytest.approx(seg.a / [1, 1.25, 1]) and np.array_equal(new.F, seg.F)
    top = sensors._shifted(seg, "x", 3, gain)
    assert top.s[:, :2] == pytest.approx(seg.s[:, :2]) and top.s.sum(axis=1) == pytest.approx(seg.s.sum(axis=1) / 1.25)
    offset = sensors._shifted(seg, "x", 2, SensorOffset(0.3))
    assert offset.s - seg.s == pytest.approx(np.tile([0, -0.3, 0.3], (400, 1))) and np.array_equal(offset.a, seg.a)
    assert np.array_equal(offset.v, seg.v)
    force = sensors._shifted(seg, "F", 3, gain)
    assert force.F == pytest.approx(seg.F / [1, 1, 1.25]) and np.array_equal(force.s, seg.s)
    late = sensors._shifted(seg, "F", 1, ChannelDelay(0.02))  # two samples
    rows = late.valid
    inner = slice(rows.start + 5, rows.stop - 5)
    assert late.F[inner, 0] == pytest.approx(seg.F[inner.start + 2 : inner.stop + 2, 0], abs=0.3)
    assert rows.start >= 0 and rows.stop <= 400 and np.isfinite(late.F[rows]).all()


def test_blocks_keep_their_rows_when_the_ends_of_a_record_are_lost():
    work = workspace((300, 200))
    moved = [segments(300, 200)[k] for k in (0, 1)]
    moved[0].valid = slice(10, 280)
    found = sensors._with_segments(work, moved)
    assert [(b.rows.start, b.rows.stop) for b in found.search] == [(0, 90), (90, 140), (190, 270), (5, 80)]
    assert [(b.rows.start, b.rows.stop) for b in found.held] == [(140, 190)]


def test_channels_that_nothing_contradicts_are_suspected_of_what_balances_can_show(monkeypatch):
    monkeypatch.setattr(sensors, "longest", lambda work: (0, slice(0, 9)))
    every = {"channel_delay", "gain_error", "sensor_offset"}

    def named(measured, n, forced, known, names=every):
        ready = SimpleNamespace(records=[SimpleNamespace(measured=measured, n_dof=n)])
        work = SimpleNamespace(forced=forced, known_masses=known, n_dof=n)
        return [(s.law.name.split("_")[0], s.site.channel) for s in sensors._alone(ready, work, names)]

    assert named(["a1", "x2", "v2", "a3"], 3, (3,), {}) == [
        ("channel", "a1"), ("channel", "a3"), ("channel", "F3"), ("gain", "a1"), ("gain", "a3"), ("sensor", "x2")
    ]  # fmt: skip
    assert ("gain", "F3") in named(["a1"], 3, (3,), {1: 2.0}) and ("gain", "F3") in named(["a1"], 3, (1, 3), {})
    assert named(["x1"], 1, (1,), {}) == [("channel", "x1"), ("channel", "F1")]
    assert named(["a1", "a2"], 2, (), {1: 1.0}, {"gain_error"}) == []


def test_a_witnessed_fault_needs_less_gain_and_gains_nothing_by_chance(monkeypatch):
    one = sensors.SensorFinding(Candidate(GainError(0.1), Site("sensor a1")), GainError(0.1), 1.0)
    assert one.least == MIN_GAIN
    one.remark = "x1 and a1 disagree"
    assert one.least < MIN_GAIN and sensors.null_gain(None, one) == 0.0
    one.remark = ""
    stage = SimpleNamespace(trial=lambda: SimpleNamespace(search_error=lambda: 4.0), work=None)
    monkeypatch.setattr(sensors, "_scan", lambda *a: (3.0, None))
    assert sensors.null_gain(stage, one) == pytest.approx(0.25)
    monkeypatch.setattr(sensors, "_scan", lambda *a: None)
    assert sensors.null_gain(stage, one) == 0.0


def test_a_refused_fault_is_tried_again_once_the_error_has_halved(monkeypatch):
    one = sensors.Suspect(GainError(0.1), Site("sensor a1"))
    ready, screen = SimpleNamespace(refused={}), {"now": 9.0}
    monkeypatch.setattr(sensors, "_rebuilt", lambda *a: SimpleNamespace(screen=screen["now"]))
    assert sensors._tried(ready, None, None, one, 8.0).screen == 9.0 and list(ready.refused.values()) == [8.0]
    assert sensors._tried(ready, None, None, one, 8.01 * sensors._AGAIN) is None
    screen["now"] = 3.0
    assert sensors._tried(ready, None, None, one, 7.99 * sensors._AGAIN).screen == 3.0
    assert list(ready.refused.values()) == [8.0]


# -- surrogates -------------------------------------------------------------------------------------


def test_noise_of_a_force_is_the_white_part_of_the_residual_within_the_band():
    n, fs = 40000, 200.0
    rng = np.random.default_rng(0)
    left = np.column_stack([0.5 * rng.standard_normal(n), 2.0 * rng.standard_normal(n), rng.standard_normal(n)])
    left[:, 1] += 30 * np.sin(2 * np.pi * 17.3 * np.arange(n) / fs)
    force = np.ones((n, 3)) * [1, 1, 0]
    assert surrogate.force_noise(left, force, fs) == pytest.approx([0.5, 2.0, 0.0], rel=0.05)
    assert surrogate.force_noise(left, force, fs, (20.0, None)) == pytest.approx([0.5, 2.0, 0.0], rel=0.08)
    f = np.fft.rfftfreq(n, 1 / fs)[:, None]
    part = np.fft.irfft(np.fft.rfft(left, axis=0) * ((f > 30) & (f < 60)), n, axis=0)
    found = surrogate.force_noise(part, force, fs, (32.0, 58.0))
    assert found == pytest.approx(np.minimum([0.5, 2.0, 0.0], part.std(axis=0) * [1, 1, 0]), rel=0.08)
    assert surrogate.force_noise(left, force, fs, (0.01, 0.02)).tolist() == [0.0] * 3
    unknown = np.where(np.arange(3) == 0, np.nan, force)
    assert surrogate.force_noise(left, unknown, fs)[0] == 0.0
    assert surrogate.force_noise(left[:100], force[:100], fs)[0] == pytest.approx(0.5, rel=0.5)


def null_of(floors, own):
    def stage(x):
        return SimpleNamespace(trial=lambda: SimpleNamespace(fold_errors=lambda: np.array([x, x, 9 * x])))

    one = surrogate.Null(None, stage(own), None, 2)
    one.__dict__["_made"] = surrogate._Made([stage(x) for x in floors], 0.01)
    return one


def test_the_floor_of_surrogates_is_their_median_and_it_is_reached_near_the_loudest():
    assert null_of([1.0, 2.0, 6.0], 1.4).floor == 2.0 and np.isnan(null_of([], 1.0).floor)
    assert np.isnan(null_of([1.0, 2.0, 6.0], 1.3).floor)  # the records leave much less: surrogates are not like them
    assert null_of([1.0, 2.0], 0.99 * AT_FLOOR * 2).reached and not null_of([1.0, 2.0], 1.01 * AT_FLOOR * 2).reached
    assert not null_of([], 0.0).reached and null_of([1.0], 1.0).bias == 0.01


def test_a_shift_is_the_largest_share_of_a_mass_or_of_a_sites_force():
    site = Site("storey 1")
    stage = SimpleNamespace(grams=np.array([np.diag([1.0, 4.0, 9.0]), np.diag([3.0, 12.0, 0.0])]))
    one = surrogate.Null(None, stage, None, 2)
    trial = SimpleNamespace(layout=SimpleNamespace(slices={site: slice(0, 2)}))

    def solution(m, c):
        return SimpleNamespace(masses={1: m}, coefficients={site: np.array(c)})

    found = solution(10.0, [3.0, 2.0])  # sizes 2 and 4: forces 6 and 8, together 10
    assert one._shift(trial, found, solution(10.5, [3.0, 2.0])) == pytest.approx(0.05)
    assert one._shift(trial, found, solution(10.5, [3.6, 2.4])) == pytest.approx(np.hypot(1.2, 1.6) / 10)
    assert one._shift(trial, solution(10.0, [0.0, 0.0]), solution(10.0, [1.0, 1.0])) == 0.0
    one.of = ()  # a site that is not asked about
    assert one._shift(trial, found, solution(10.5, [3.6, 2.4])) == pytest.approx(0.05)
    one.of = None
    # two columns that are one: what the second takes from the first moves terms, and no force
    stage.grams = np.array([np.ones((2, 2))])
    assert one._shift(trial, found, solution(10.0, [4.0, 1.0])) == pytest.approx(np.sqrt(2 / 13))
    assert one._shift(trial, found, solution(10.0, [4.0, 1.0]), whole=True) == 0.0
    assert one._shift(trial, found, solution(10.0, [4.0, 2.0]), whole=True) == pytest.approx(1 / 5)


@pytest.mark.parametrize(
    "own, straight, smooth, course",
    [(1.0, 1.19, 0.5, "linear"), (1.0, 1.21, 0.5, "cubic"), (1.0, 1.21, 1.3, "linear"), (1e-5, 0.023, 0.01, "linear")],
)
def test_surrogates_that_are_louder_than_the_records_are_tried_with_smooth_forces(own, straight, smooth, course):
    def stage(x):
        return SimpleNamespace(trial=lambda: SimpleNamespace(fold_errors=lambda: np.array([x])))

    one = surrogate.Null(None, stage(own), None, 2)
    tried = {"linear": straight, "cubic": smooth}
    one._surrogates = lambda hold: surrogate._Made([stage(tried[hold])], 0.1, 0.2, hold)
    assert one.floor == tried[course] and one.truth == course
    assert (one.bias, one.error) == (0.1, 0.2)


# -- where ------------------------------------------------------------------------------------------


def located(n=1500, seed=0, floor=None, balance=None, known_masses=()):
    """Three balances with a force in link 3-1, noise, and corrections of the model."""
    rng = np.random.default_rng(seed)
    X, F = rng.standard_normal((n, 9)), 3 * rng.standard_normal((n, 3))
    model = ChainModel([1.0, 2.0, 3.0], {i: [laws.LinearElastic(1.0 + i), laws.LinearViscous(0.1)] for i in (1, 2, 3)})
    residual = residual_of(model, from_arrays(X, F, dt=0.01))
    f = rng.standard_normal(n)
    e = np.outer(f, [-1, 0, 1]) + 0.4 * rng.standard_normal((n, 3)) + X[:, :3] * [0.2, 0.1, -0.1]
    return residual.with_balance([e if balance is None else balance]), X, e


def squares(X, e, b, W):
    """min over corrections d and a free force f(t) of |e - A d - b f|^2_W, by stacked least squares."""
    n = len(e)
    a, v, s = X[:, :3], X[:, 3:6], X[:, 6:]
    columns = [a[:, [j]] * np.eye(3)[j] for j in range(3)]
    for i in range(3):
        sign = np.eye(3)[i] - (np.eye(3)[i - 1] if i else 0)
        columns += [s[:, [i]] * sign, v[:, [i]] * sign]
    root = np.linalg.cholesky(W).T
    P = np.eye(3)
    if b is not None:
        u = root @ b / np.linalg.norm(root @ b)
        P = P - np.outer(u, u)
    A = np.column_stack([(c @ root.T @ P).ravel() for c in columns])
    y = (e @ root.T @ P).ravel()
    left = y - A @ np.linalg.lstsq(A, y, rcond=None)[0]
    return left @ left / n


PATTERNS = {"storey 1": [1, 0, 0], "storey 2": [-1, 1, 0], "storey 3": [0, -1, 1], "link 3-1": [-1, 0, 1]}


def test_shares_are_those_of_stacked_least_squares_with_a_free_force():
    residual, X, e = located(4096)
    table = localise(residual, list(PATTERNS), n_blocks=10)
    W = np.diag(1 / residual.scale**2)
    whole = squares(X, e, None, W)
    shares = {name: 1 - squares(X, e, np.array(b, float), W) / whole for name, b in PATTERNS.items()}
    assert table.index[0] == "link 3-1" and table["share"].to_dict() == pytest.approx(
        {k: 100 * v for k, v in shares.items()}, abs=1e-4
    )
    assert table["balances"].to_dict() == {
        "storey 1": "+1",
        "storey 2": "-1, +2",
        "storey 3": "-2, +3",
        "link 3-1": "-1, +3",
    }
    row = table.loc["link 3-1"]
    assert row["high"] - row["share"] == pytest.approx(row["share"] - row["low"]) and 0 < row["high"] - row["low"] < 10
    # the force itself: what W tells of b, less the corrections
    force, _ = localisation.missing_force(residual, "link 3-1")
    clean = e - X[:, :3] * [0.2, 0.1, -0.1]
    b = np.array([-1.0, 0, 1])
    assert np.corrcoef(force[0], clean @ W @ b / (b @ W @ b))[0, 1] > 0.995


def test_a_known_floor_weighs_the_balances_and_takes_its_part_off():
    residual, X, e = located()
    floor = NoiseFloor.given([0.2, 0.4, 0.3], 3)
    table = localise(residual, list(PATTERNS), floor=floor)
    N = np.diag(np.array([0.2, 0.4, 0.3]) ** 2)  # no covariance: nine tenths of it and one tenth of its diagonal
    W = np.linalg.inv(N)

    def left(b):
        Q = W if b is None else W - W @ np.outer(b, b) @ W / (b @ W @ b)
        return squares(X, e, b, W) - np.trace(Q @ N)

    shares = {name: 1 - left(np.array(b, float)) / left(None) for name, b in PATTERNS.items()}
    clipped = {k: float(np.clip(100 * v, 0, 100)) for k, v in shares.items()}
    assert table["share"].to_dict() == pytest.approx(clipped, abs=1e-3)
    work = localisation._Work.of(residual, floor, (), (), 10)
    assert work.over_floor == pytest.approx(np.sqrt(squares(X, e, None, W) / 3)) and not work.at_floor
    factor = work.over_floor / AT_FLOOR
    for scale, at_floor in ((1.01, True), (0.99, False)):
        big = NoiseFloor.given(np.array([0.2, 0.4, 0.3]) * factor * scale, 3)
        assert localisation._Work.of(residual, big, (), (), 10).at_floor == at_floor


def test_the_band_of_a_share_is_a_jackknife_over_blocks():
    residual, _, _ = located(4096)
    work = localisation._Work.of(residual, None, (), (), 4)
    assert work.sizes.tolist() == [1024] * 4
    b = work.pattern(Site("link 3-1"))
    value, low, high = work.share(b)
    rest = []
    for k in range(4):
        one = localisation._Work.of(residual, None, (), (), 4)
        keep = [j for j in range(4) if j != k]
        one.grams, one.sizes = work.grams[keep], work.sizes[keep]
        rest.append(one.share(b)[0])
    assert high - value == pytest.approx(2 * np.sqrt(3 * np.var(rest))) and value - low == pytest.approx(high - value)
    two = localisation._Work.of(residual, None, (), (), 2)
    assert np.isnan(two.share(b)[1])


def test_a_force_from_outside_is_what_no_motion_with_its_pattern_explains():
    table = pd.DataFrame(
        {"own": [30.0, 45.0, 0.0, 0.0], "rms": [1.0, 1.0, 1.0, np.nan]},
        index=["ground 2", "sensor a2", "dof 2", "dof 1"],
    )
    patterns = {Site(s): np.eye(2)[int(s[-1]) - 1] for s in table.index}
    localisation._settle(table, patterns)
    assert table["own"].tolist() == [30.0, 45.0, 55.0, 0.0]
    assert (
        localisation._key(np.array([-1.0, 1.0]))
        == localisation._key(np.array([1.0, -1.0]))
        != localisation._key(np.eye(2)[0])
    )


def verdicts(shares, highs=None, lows=None, at_floor=False, known=3, noise=1, own=None):
    names = ["storey 2", "dof 1", "ground 3", "sensor a3"][: len(shares)]
    table = pd.DataFrame({"share": shares, "high": highs or shares, "low": lows or shares}, index=names, dtype=float)
    table["own"], table["balances"] = own or np.nan, "+1"
    work = SimpleNamespace(known=list(range(known)), at_floor=at_floor, over_floor=1.234, noise=noise)
    patterns = dict(zip(map(Site, names), (np.array(b, float) for b in ([-1, 1, 0], [1, 0, 0], [0, 0, 1], [0, 0, 1]))))
    return localisation._verdicts(table, patterns, work)


def test_verdicts_in_words():
    near = 100 * localisation._NEAR
    assert "; next dof 1 (50 %)" in verdicts([50 + near + 0.1, 50.0, 50.0])[0]
    assert "hardly told from dof 1 (50 %)" in verdicts([50 + near - 0.1, 50.0, 50.0])[0]
    assert "hardly told from" in verdicts([90, 50.0], highs=[95, 86], lows=[85, 40])[0]
    assert "next dof 1" in verdicts([90, 50.0], highs=[95, 84], lows=[85, 40])[0]
    assert verdicts([90.0, 50.0], known=1)[0] == "one balance: the signs say nothing"
    words = verdicts([90.0, 50.0, 20.0, 10.0], own=[88.2, 30.0, np.nan, 12.0])
    assert "; its own motion explains 88 % of the force" in words[0] and "; 30 % follows no motion there" in words[1]
    assert "; a delay explains 12 %" in words[3] and words[2] == "explains 20 % (balances +1)"
    assert verdicts([90.0, 50.0], at_floor=True) == [
        "all balances together leave 1.2 times what noise leaves: nothing to locate",
        "",
    ]
    assert "leave round-off" in verdicts([9.0], at_floor=True, noise=None)[0]


# -- evidence, floors -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "share, high, low, words",
    [
        (80.0, 81.0, 82.0, "which localisation hardly tells from storey 2"),
        (70.0, 71.0, 82.0, "Localisation disagrees with the loop, which chose storey 3: it explains 70 % and is number 2"),
        (70.0, 83.0, 82.0, "hardly tells"), (79.99, 81.0, 82.0, "disagrees"),
    ],
)  # fmt: skip
def test_localisation_agrees_within_a_few_points_or_overlapping_bands(share, high, low, words):
    table = pd.DataFrame(
        {
            "share": [84.99, share, 10.0],
            "high": [88.0, high, 12.0],
            "low": [low, 60.0, 8.0],
            "balances": ["a", "b", "c"],
        },
        index=["storey 2", "storey 3", "dof 1"],
    )
    assert words in Evidence("baseline", localisation=table, site="storey 2", chosen="storey 3").agreement
    later = Evidence("baseline", localisation=table, site="storey 2", chosen="storey 3", later=("storey 2",)).agreement
    assert "and storey 2 in a later step" in later


@pytest.mark.parametrize("most, lengths", [(10**6, [150, 100, 75]), (65, [30, 20, 15])])
def test_evidence_looks_at_the_first_samples_of_every_part(most, lengths):
    work = workspace()
    data, filters = evidence.searched(work, most)
    assert [s.valid.stop - s.valid.start for s in data.segments] == lengths and len(filters) == 3
    assert [s.valid.start for s in data.segments] == [0, 200, 5]
    for stop, kept in ((38, 3), (37, 2)):  # a quarter of the longest part of 150
        work.search[2] = BlockRows(0, slice(200, 200 + stop))
        assert len(evidence.searched(work, 10**6)[0].segments) == kept


def test_the_strongest_correlation_stands_highest_above_its_band():
    tests = pd.DataFrame(
        [
            ("phi_ee", 0.9, 0.1, True),
            ("phi_xe", -0.5, 0.1, True),
            ("phi_x2e", 0.6, 0.2, True),
            ("phi_x3e", 0.9, 0.1, False),
        ],
        columns=["test", "peak", "band", "outside"],
    )
    seen = Evidence("x", detection=SimpleNamespace(tests=tests))
    assert seen.strongest["test"] == "phi_xe"
    seen.detection.tests = tests[~tests["outside"] | (tests["test"] == "phi_ee")]
    assert seen.strongest["test"] == "phi_ee"


def test_a_floor_that_was_given_stops_the_loop_where_no_gain_could_pass(monkeypatch):
    source = FloorSource(3.0, 2)
    assert source.measured and not FloorSource("channels", 2).measured and FloorSource("repeats", 2).measured
    monkeypatch.setattr(FloorSource, "percent", lambda self, trial, null: 8.5)
    for error, closed in ((8.5 / (1 - MIN_GAIN) * 0.999, True), (8.5 / (1 - MIN_GAIN) * 1.001, False)):
        assert source.closes(None, error, None) == closed and not FloorSource("channels", 2).closes(None, error, None)
    for wrong in ("loud", True, [1.0, 2.0, 3.0], NoiseFloor.given(1.0, 3), None):
        with pytest.raises((ChannelError, NRFError)):
            FloorSource(wrong, 2)


def test_shapes_of_laws_are_known_to_the_axes():
    assert isinstance(axes_of(laws.Jenkins()).shapes[0], base_laws.Shape)
