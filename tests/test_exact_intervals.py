"""Exact numbers of floors, free runs, intervals, and of what a law leaves."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hand_made_rooms import fresh, motion, noise, residual, workspace

from pysindy_nrf import Chain, ChainModel, Site, free_run, laws
from pysindy_nrf.discrepancy import (
    floor_source,
    intervals,
    leftover,
)
from pysindy_nrf.discrepancy.floor_source import FloorSource
from pysindy_nrf.discrepancy.noise_floor import NoiseFloor
from pysindy_nrf.discrepancy.splits import BlockRows
from pysindy_nrf.discrepancy.stage import Stage
from pysindy_nrf.discrepancy.workspace import Workspace
from pysindy_nrf.errors import Sizes
from pysindy_nrf.exceptions import ChannelError, NRFError
from pysindy_nrf.laws import Motion

# -- floors and free runs ---------------------------------------------------------------------------


def test_a_floor_is_known_by_its_name(monkeypatch):
    for name, measured, words in (
        ("channels", False, "surrogates with the noise of the channels"), ("repeats", True, "repeated records"),
    ):  # fmt: skip
        source = FloorSource(fresh(name), 2)
        assert (source.measured, source.words, source.known) == (measured, words, None)
    for wrong in ("abc", "channel", "d", "repeat", "s", "zzz", "", True, None, NoiseFloor.given(1.0, 1)):
        with pytest.raises(ChannelError):
            FloorSource(wrong, 2)
    known = NoiseFloor.given([1.0, 2.0], 2)
    for given in (known, 3, 3.0, [1.0, 2.0], (1.0, 2.0), np.ones(2), {1: 2.0}):
        source = FloorSource(given, 2)
        assert source.measured and source.known is not None and source.words == source.known.source
    trial = SimpleNamespace(work="work", model=lambda: "model")
    monkeypatch.setattr(floor_source, "repeated", lambda work, model: (work, model))
    monkeypatch.setattr(NoiseFloor, "from_repeats", lambda residual: residual)
    assert FloorSource("repeats", 2).of(trial) == ("work", "model") and FloorSource(known, 2).of(trial) is known
    assert FloorSource("channels", 2).of(trial) is None


def test_the_loop_is_closed_where_a_fall_by_the_least_gain_would_just_reach_the_floor(monkeypatch):
    monkeypatch.setattr(FloorSource, "percent", lambda self, trial, null: 10.0 * (1.0 - 0.15))
    assert FloorSource(1.0, 2).closes(None, 10.0, None) and not FloorSource(1.0, 2).closes(None, 10.001, None)


def test_a_balance_of_unknown_force_is_not_pooled(monkeypatch):
    sizes = {1: None, 2: Sizes(9.0, 5.0, 8.0, "F", 300)}
    monkeypatch.setattr(floor_source, "balance_sizes", lambda j, *a: sizes[j])
    asked = []
    trial = SimpleNamespace(
        work=SimpleNamespace(search=[0, 0, 0], n_dof=2),
        solve=lambda b: asked.append(list(b)) or SimpleNamespace(masses=0, coefficients=0),
        moments=lambda b: SimpleNamespace(parts={}),
    )
    assert FloorSource([3.0, 4.0], 2).percent(trial, None) == pytest.approx(100 * 4 / 5) and asked == [[0, 1, 2]]


def test_repeated_records_are_cut_from_their_first_valid_row():
    model = ChainModel([1.0], {1: [laws.LinearElastic(1.0)]})
    found = residual(n_dof=1, lengths=[200, 190])
    for seg in found.data.segments:
        seg.F[:] = found.data.segments[0].F[:190].mean()
        seg.valid = slice(6, len(seg.s))
    search = [BlockRows(0, slice(4, 100)), BlockRows(1, slice(0, 90)), BlockRows(1, slice(120, 180))]
    work = Workspace(found.data, [None] * 2, search, [], {}, "auto")
    cut = floor_source.repeated(work, model)
    assert [s.valid for s in cut.data.segments] == [slice(10, 96)] * 2  # rows 4 to 90 from the sixth on
    for part, seg in zip(cut.balance, found.data.segments):
        wanted = seg.F[10:96] - seg.a[10:96] - seg.s[10:96]
        assert part == pytest.approx(wanted) or part == pytest.approx(-wanted)
    apart = [BlockRows(0, slice(0, 90)), BlockRows(1, slice(95, 180))]
    with pytest.raises(ChannelError, match="2 records with 0 rows in common"):
        floor_source.repeated(Workspace(found.data, [None] * 2, apart, [], {}, "auto"), model)


def free_runs(monkeypatch, masses=(1.0, 2.0), run=None, n=40, first=3, filters=(None,), rows=(5, 20)):
    """Error of free runs that are given as a factor of the measured motion."""
    found = residual(n)
    (seg,) = found.data.segments
    seg.valid = slice(first, n)
    x, asked = np.cumsum(seg.s, axis=1), []

    def alone(model, segment, chosen, dt):
        asked.append((chosen, dt))
        if run is None:
            raise NRFError("x", "y")
        return SimpleNamespace(displacement=run * x[chosen])

    monkeypatch.setattr(free_run, "free_run_of", alone)
    model = SimpleNamespace(masses=np.array(masses), n_dof=2)
    work = SimpleNamespace(data=found.data, filters=list(filters))
    return free_run.free_run_error(model, work, [BlockRows(0, slice(*rows))]), asked, seg


def test_free_runs_are_compared_on_the_rows_of_their_blocks(monkeypatch):
    error, asked, seg = free_runs(monkeypatch, run=np.array([1.3, 0.6]))
    assert error == pytest.approx(100 * np.sqrt((0.3**2 + 0.4**2) / 2))
    assert asked == [(slice(8, 23), pytest.approx(0.01))]

    class First:
        def apply(self, y):
            return y * [5.0, 1.0]

    assert free_runs(monkeypatch, run=1.3, filters=[First()])[0] == pytest.approx(30.0)
    parts = free_run.squares_of(SimpleNamespace(displacement=np.zeros((15, 2))), seg, slice(8, 23), First())
    x = np.cumsum(seg.s[8:23], axis=1)
    assert parts[0] == pytest.approx((x**2).sum(axis=0) * [25, 1]) and parts[1] == pytest.approx(parts[0])


def test_no_free_run_is_told_where_there_is_none(monkeypatch):
    for masses in ((1.0, 0.0), (-1.0, 2.0)):
        assert np.isnan(free_runs(monkeypatch, masses, 1.3)[0])
    assert np.isnan(free_runs(monkeypatch)[0])  # it diverges
    assert np.isfinite(free_runs(monkeypatch, run=1.3, rows=(5, 13))[0])
    error, asked, _ = free_runs(monkeypatch, run=1.3, rows=(5, 12))
    assert np.isnan(error) and asked == []
    found = residual(40)
    work = SimpleNamespace(data=found.data, filters=[None])
    model, rows = SimpleNamespace(masses=np.ones(2), n_dof=2), [BlockRows(0, slice(0, 20))]
    monkeypatch.setattr(free_run, "free_run_of", lambda *a: SimpleNamespace(displacement=np.ones((20, 2))))
    assert np.isfinite(free_run.free_run_error(model, work, rows))
    found.data.segments[0].s[:, 0] = 0.0  # nothing moves: nothing to divide by
    with np.errstate(divide="ignore"):
        assert np.isnan(free_run.free_run_error(model, work, rows))
    found.data.segments[0].F[0, 1] = np.nan
    assert np.isnan(free_run.free_run_error(model, work, rows))
    timeless = residual(40).data
    timeless.segments[0].t = None
    assert np.isnan(free_run.free_run_error(model, SimpleNamespace(data=timeless, filters=[None]), rows))


def test_a_free_run_starts_from_the_state_in_its_first_row():
    asked = {}

    def simulate(model, force, dt, **more):
        asked.update(more, force=force, dt=dt)
        return "run"

    model = SimpleNamespace()
    (seg,) = residual(40, covariates={"T": noise(40, 5)}, base_acceleration=noise(40, 6)).data.segments
    assert free_run.free_run_of(model, seg, slice(7, 30), 0.5, integrator=simulate) == "run"
    assert asked["x0"] == pytest.approx(np.cumsum(seg.s[7])) and asked["v0"] == pytest.approx(np.cumsum(seg.v[7]))
    assert asked["t0"] == pytest.approx(0.07) and asked["dt"] == 0.5
    assert asked["force"] == pytest.approx(seg.F[7:30])
    assert asked["base_acceleration"] == pytest.approx(noise(40, 6)[7:30])
    assert asked["covariates"]["T"] == pytest.approx(noise(40, 5)[7:30])
    (plain,) = residual(40).data.segments
    free_run.free_run_of(model, plain, slice(7, 30), 0.5, integrator=simulate)
    assert asked["base_acceleration"] is None and asked["covariates"] is None


# -- intervals --------------------------------------------------------------------------------------


def shaped(n_blocks=5, law=None, seed=0, step=None):
    """One mass with a spring and a damper of a power of the rate, in blocks of noise."""
    ends = [int(e) for e in np.linspace(0, 400, n_blocks + 1)]
    rng = np.random.default_rng(9)

    def force(seg):
        v = seg.v[:, 0]
        return (3.0 * seg.a[:, 0] + 50.0 * seg.s[:, 0] + 2.0 * np.sign(v) * np.abs(v) ** 0.7)[:, None] + (
            0.1 * rng.standard_normal((400, 1))
        )

    blocks = [(0, a, b) for a, b in zip(ends, ends[1:])]
    work = workspace([400], 1, blocks, seed=seed, F=force)
    site, law = Site("storey 1"), law or laws.PowerLawDamping(n=0.6)
    return Stage(work, Chain(1), {site: (laws.LinearElastic(), law)}), (site, 1), blocks


def test_coefficients_and_shapes_are_estimated_together_with_each_block_left_out():
    """d/dn sgn(v) |v|^n = sgn(v) |v|^n ln|v|, in the coordinate of the search; one balance: plain least squares."""
    stage, place_, blocks = shaped()
    law = laws.PowerLawDamping()
    axes = intervals.Axes(law, stage.work, place_[0])
    centre = axes.point(stage.laws[place_[0]][1])
    best, folds = intervals._linearised(stage, place_, axes, centre, np.array([2.0]))
    (seg,) = stage.work.data.segments
    v = seg.v[:, 0]
    power = np.sign(v) * np.abs(v) ** 0.6
    slope = 2.0 * power * np.log(np.abs(v)) * (0.6 if axes.log[0] else 1.0)
    A = np.column_stack([power, slope, seg.s[:, 0], seg.a[:, 0]])

    def solved(rows):
        return np.linalg.lstsq(A[rows], seg.F[rows, 0], rcond=None)[0][:2]

    assert best == pytest.approx(solved(np.arange(400)), rel=1e-4)
    for (_, a, b), fold in zip(blocks, folds, strict=True):
        assert fold == pytest.approx(solved(np.delete(np.arange(400), np.arange(a, b))), rel=1e-3)
    plain = intervals._linearised(stage, place_, axes, np.zeros(0), np.array([2.0]))
    assert plain[0] == pytest.approx(np.linalg.lstsq(A[:, [0, 2, 3]], seg.F[:, 0], rcond=None)[0][:1], rel=1e-4)


@pytest.mark.parametrize("n_blocks, told", [(2, False), (3, True)])
def test_three_blocks_at_least_tell_a_spread(n_blocks, told):
    stage, place_, _ = shaped(n_blocks)
    axes = intervals.Axes(stage.laws[place_[0]][1], stage.work, place_[0])
    if told:
        assert intervals._linearised(stage, place_, axes, np.zeros(0), np.array([2.0]))[1].shape == (3, 1)
    else:
        with pytest.raises(NRFError, match="cannot be told apart"):
            intervals._linearised(stage, place_, axes, np.zeros(0), np.array([2.0]))


def test_the_one_block_that_shows_a_change_in_time_is_not_left_out():
    stage, place_, _ = shaped(5, laws.StiffnessStep(t0=3.3))
    axes = intervals.Axes(stage.laws[place_[0]][1], stage.work, place_[0])
    _, folds = intervals._linearised(stage, place_, axes, np.zeros(0), np.array([2.0]))
    assert folds.shape == (4, 1) and np.isfinite(folds).all()


def judged_parameters(monkeypatch, law, theta, widths, profile=None, nulls=(), origin=None):
    """Intervals of a law at storey 1 with given drifts and half widths, and a given profile."""
    site, given = Site("storey 1"), iter(widths)
    work = SimpleNamespace(scales=lambda s: (0.02, 0.3, 40.0), fastest=50.0)
    asked = []

    def take(*a):
        asked.append((len(a[3]), a[5].tolist()))
        one = next(given)
        if one is None:
            raise NRFError("x", "y")
        return tuple(np.array(x, dtype=float) for x in one)

    monkeypatch.setattr(intervals, "_widths", take)
    monkeypatch.setattr(intervals, "_profile", lambda *a: dict(profile or {}))
    stage = SimpleNamespace(work=work, laws={site: (laws.LinearElastic(), law)})
    free = type(law)()
    return (*intervals.intervals(stage, (site, 1), free, np.array(theta), nulls, origin), asked)


def test_a_shape_has_an_interval_in_its_own_units_within_its_bounds(monkeypatch):
    law = laws.PowerLawDamping(n=0.6)
    axes = intervals.Axes(
        laws.PowerLawDamping(), SimpleNamespace(scales=lambda s: (1, 1, 1), fastest=1.0), Site("storey 1")
    )
    log = bool(axes.log[0])
    centre = np.log(0.6) if log else 0.6

    def shape(u):
        return np.exp(u) if log else u

    found, shares, asked = judged_parameters(monkeypatch, law, [10.0], [([0.5, -0.05], [1.0, 0.1])])
    assert found["cn"] == pytest.approx((8.5, 11.0)) and shares == {}
    assert found["n"] == pytest.approx((shape(centre - 0.1), shape(centre + 0.15))) and asked == [(1, [10.0, 0.0])]
    wide, _, _ = judged_parameters(monkeypatch, law, [10.0], [([0.0, 0.0], [0.0, 99.0])])
    assert wide["n"] == pytest.approx((0.15, 4.0)) and wide["cn"] == pytest.approx((9.999, 10.001))
    thin, _, _ = judged_parameters(monkeypatch, law, [10.0], [([0.0, 0.0], [0.0, 0.0])])
    assert thin["n"] == pytest.approx((shape(centre - 1e-4), shape(centre + 1e-4)), rel=1e-9)
    low, high = (shape(centre - 0.1), shape(centre + 0.1))
    both = ((0.5, 0.9), (min(0.5, low), 0.9)), ((0.59, 0.61), (low, high)), ((0.3, 0.61), (0.3, high))
    for profile, wanted in both:
        found, _, _ = judged_parameters(monkeypatch, law, [9.0], [([0, 0], [0, 0.1])], {"n": profile, "x": (1.0, 2.0)})
        assert found["n"] == pytest.approx(wanted) and set(found) == {"cn", "n"}


def test_what_noise_takes_from_a_coefficient_is_a_share_of_what_it_was(monkeypatch):
    law, widths = laws.LinkSpringDashpot(), [([0.5, 0.5], [1.0, 1.0])]
    origin = np.array([4.0, 0.0])  # of nothing there is no share
    shares = judged_parameters(monkeypatch, law, [5.0, 1.0], widths, nulls=["surrogate"], origin=origin)[1]
    assert list(shares.values()) == [0.125] and len(shares) == 1


def test_where_shapes_have_no_slope_the_profile_of_the_error_tells(monkeypatch):
    law, profile = laws.PowerLawDamping(n=0.6), {"n": (0.5, 0.7)}
    found, shares, asked = judged_parameters(
        monkeypatch, law, [10.0], [None, ([1.0], [2.0])], profile, ["surrogate"], np.array([20.0])
    )
    assert found == {"n": (0.5, 0.7), "cn": pytest.approx((7.0, 12.0))} and shares == {"cn": 0.05}
    assert asked == [(1, [20.0, 0.0]), (0, [20.0])]
    assert judged_parameters(monkeypatch, law, [10.0], [None, None], profile)[:2] == (profile, {})


def test_a_surrogate_that_cannot_be_solved_is_passed_over(monkeypatch):
    def linearised(stage, *a):
        if stage is None:
            raise NRFError("x", "y")
        return stage, np.arange(8.0).reshape(4, 2)

    monkeypatch.setattr(intervals, "_linearised", linearised)
    true = np.array([1.0, 2.0])
    nulls = [None, true + 1.0, None, true + 4.0]
    assert intervals._widths(true, None, None, None, None, true, nulls, 0.9)[0] == pytest.approx([2.5, 2.5])
    assert intervals._widths(true, None, None, None, None, true, [None], 0.9)[0].tolist() == [0.0, 0.0]


def test_a_profile_without_width_tells_nothing(monkeypatch):
    law, site, v = laws.PowerLawDamping(), Site("storey 1"), np.tile([1.0, 1.0, -1.0, -1.0], 10)
    work = SimpleNamespace(scales=lambda s: (0.02, 0.3, 40.0), fastest=50.0, search=[BlockRows(0, slice(0, 40))] * 3)
    work.motion = lambda s, i: Motion(v, v)
    stage = SimpleNamespace(work=work, chain=None, without=lambda places: asked.append(places) or {})
    axes, asked = intervals.Axes(law, work, site), []
    slot = SimpleNamespace(errors=lambda tried: [0.0])
    monkeypatch.setattr(intervals, "Stage", lambda *a: SimpleNamespace(slot=lambda s, law: slot))
    ends = [(0.0, 0.0)]
    monkeypatch.setattr(intervals, "plateau", lambda error, at, *e, slack: asked.append(slack) or ends[-1])
    assert intervals._profile(stage, (site, 1), law, axes, np.zeros(1), 0.9) == {}
    # nineteen turns in each of three blocks
    quantile = intervals.student.ppf(0.95, 57)
    assert asked == [[(site, 1)], pytest.approx(np.sqrt(1 + quantile**2 / 57) - 1)]
    ends.append((-0.1, 0.1))
    assert intervals._profile(stage, (site, 1), law, axes, np.zeros(1), 0.9) == {
        "n": pytest.approx(tuple(float(axes.values(np.array([u]))[0]) for u in ends[-1]))
    }


# -- what is left -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "site, where",
    [
        ("storey 1", "storey 1"), ("storey 2", "storey 2"), ("storey 3", "storey 3"), ("ground 3", "dof 3"),
        ("dof 1", "dof 1"), ("dof 3", "dof 3"), ("link 3-1", None), ("link 5-2", None), ("link 2-1", "storey 2"),
    ],
)  # fmt: skip
def test_a_site_is_seen_in_its_storey_or_in_the_balance_of_its_floor(site, where):
    assert leftover._where(Site(site)) == where


@pytest.mark.parametrize("error", [NRFError("x", "y"), np.linalg.LinAlgError("singular")])
def test_where_nothing_can_be_solved_nothing_is_left(monkeypatch, error):
    def refuse(*a):
        raise error

    monkeypatch.setattr(leftover, "_share", refuse)
    assert leftover.leftover("stage", ["noise"], [(Site("storey 1"), 0)]) == 0.0


def test_noise_counts_one_and_a_half_times(monkeypatch):
    shares = {"stage": 0.5, "quiet": 0.1, "loud": 0.2, "louder": 0.4}
    asked = []
    monkeypatch.setattr(leftover, "_share", lambda stage, *a: asked.append(a) or shares[stage])
    places = [(Site("ground 2"), 1)]
    assert leftover.leftover("stage", ["loud", "quiet"], places) == pytest.approx(np.sqrt(0.25 - 0.09))
    assert asked == [("dof 2", places)] * 3
    assert leftover.leftover("stage", ["louder"], places) == 0.0 and leftover.leftover("stage", [], places) == 0.5


def left_of(monkeypatch, force, given=None, coefficients=(7.0, 2.0), places=((0, 1),), n=2000):
    """The share of a cubic spring of 2 N/m^3, behind a linear one, that a force at storey 2 is."""
    site, m = Site("storey 2"), motion(n)
    seg = SimpleNamespace(valid="rows", motion=lambda s, valid: m if (s, valid) == (site, "rows") else None)
    residual = SimpleNamespace(
        at=lambda where: [force(m)] if where == "storey 2" else None,
        filters=[None],
        data=SimpleNamespace(segments=[seg]),
    )
    monkeypatch.setattr(leftover, "searched_residual", lambda work, model: residual if model == "model" else None)
    if given is not None:
        monkeypatch.setattr(leftover, "Judge", given)
    trial = SimpleNamespace(model=lambda: "model", layout=SimpleNamespace(slices={site: slice(4, 6)}))
    trial.solve = lambda blocks: (
        SimpleNamespace(coefficients={site: np.array(coefficients)}) if list(blocks) == [0, 1, 2] else None
    )
    stage = SimpleNamespace(trial=lambda: trial, work=SimpleNamespace(search=[0, 0, 0]))
    stage.at = {(site, 0): 4, (site, 1): 5}
    stage.laws = {site: (laws.LinearElastic(), laws.CubicStiffness())}
    return leftover._share(stage, "storey 2", [(site, number) for _, number in places]), m


def test_what_is_left_is_told_as_a_share_of_the_effect_beside_what_is_linear(monkeypatch):
    found, _ = left_of(monkeypatch, lambda m: 0.2 * m.s**3 + 3.0 * m.s - m.v + 5.0)
    assert found == pytest.approx(0.1, rel=0.02)
    found, _ = left_of(monkeypatch, lambda m: 0.2 * m.s**3, places=((0, 0), (0, 1)))  # a linear part is no part of it
    assert found == pytest.approx(0.1, rel=0.02)
    damped, m = left_of(monkeypatch, lambda m: 0.2 * m.v * np.abs(m.v))
    lines = np.column_stack([m.s, m.v])
    sizes = [y - lines @ np.linalg.lstsq(lines, y, rcond=None)[0] for y in (0.2 * m.v * np.abs(m.v), 2 * m.s**3)]
    assert damped == pytest.approx(np.std(sizes[0]) / np.std(sizes[1]), rel=0.05)
    assert left_of(monkeypatch, lambda m: 0.2 * m.s**3, coefficients=(7.0, 0.0))[0] == 0.0  # no effect: no share
    assert left_of(monkeypatch, lambda m: np.where(m.t < 1, np.nan, m.s))[0] == 0.0


@pytest.mark.parametrize(
    "shares, best",
    [
        ({"v": (0.3, 0.2), "s": (0.5, 0.51), "s and v": (0.1, 0.05)}, 0.3), ({"v": (0.4, 0.4)}, 0.0),
        ({"s": (0.41, 0.4)}, 0.41), ({"s and v": (0.2, 0.1), "v": (0.1, 0.01)}, 0.2), ({}, 0.0),
    ],
)  # fmt: skip
def test_a_function_must_explain_more_than_its_standard_error(monkeypatch, shares, best):
    class Given:
        def __init__(self, force, groups):
            self.groups = list(groups)

        def held_out(self, names):
            if self.groups == ["linear"] == list(names):
                return np.array([0.04, 0.05])
            assert tuple(names) == ("constant", "linear")
            return np.array([0.25, 0.24])

        def share(self, names, beside):
            assert tuple(beside) == ("constant", "linear")
            return shares.get(names[0], (0.0, 1.0))

    found, m = left_of(monkeypatch, lambda m: 0.5 * np.sign(m.v), Given)
    assert found == pytest.approx(0.5 * np.sqrt(0.49 * best) / (2 * np.sqrt(np.mean(m.s**6)) * 0.3))
