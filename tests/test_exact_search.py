"""Exact numbers of the search: shapes again, several effects together, places for a law, models on Gram matrices."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hand_made_walk import FRICTION, fault, finding, refuse, shaken_space, turned_down

from pysindy_nrf import Chain, Site, laws
from pysindy_nrf.discrepancy import (
    projection,
    reestimate,
    search,
    stage,
    together,
)
from pysindy_nrf.discrepancy.catalogue import Candidate
from pysindy_nrf.discrepancy.gate import FLOOR, MEMBER_GAIN, MIN_WINS, Verdict
from pysindy_nrf.discrepancy.search import Finding
from pysindy_nrf.exceptions import NRFError
from pysindy_nrf.laws.sensor import GainError

# -- shapes again, and what is needless -------------------------------------------------------------


def shaped_stage(*held, site="storey 1"):
    """A model of laws at one site with an error of 2, whose copies keep their laws."""
    one = SimpleNamespace(laws={Site(site): held}, work="work", chain="chain")
    one.slot = lambda: SimpleNamespace(search_error=lambda: 2.0, folds=lambda: np.full(10, 2.0))
    one.without = lambda drop: ("without", drop)
    one.with_values = lambda place, law: shaped_stage(
        *(law if k == place[1] else x for k, x in enumerate(one.laws[Site(site)])), site=site
    )
    return one


@pytest.mark.parametrize("screen, taken", [(1.999, True), (2.0, False), (2.1, False)])
def test_a_shape_is_moved_only_if_the_error_falls(monkeypatch, screen, taken):
    one = Finding(Candidate(laws.Dahl(), Site("storey 1")), laws.Dahl(1.0), 2.0)
    plain = finding(laws.CoulombFriction())
    asked = []

    def refine(base, f, evaluations, reach):
        asked.append((base, f.law.shape["sigma"], f.screen, evaluations, reach))
        return finding(laws.Dahl(3.0), screen)

    monkeypatch.setattr(reestimate, "Stage", lambda *a: a)
    monkeypatch.setattr(reestimate, "refine", refine)
    begin = shaped_stage(laws.CoulombFriction(), laws.Dahl(1.0))
    found = reestimate.reestimated(begin, [plain, one])
    assert (found is begin) != taken and found.laws[Site("storey 1")][1].shape["sigma"] == (3.0 if taken else 1.0)
    base = ("work", "chain", ("without", [(Site("storey 1"), 1)]))
    assert asked == [(base, 1.0, 2.0, reestimate._EVALUATIONS, reestimate._REACH)]  # once: no more is to be gained
    asked.clear()
    assert reestimate.reestimated(begin, [plain]) is begin and reestimate.reestimated(begin, [plain, one], 0) is begin
    assert asked == [] and reestimate.reestimated(begin, [finding(laws.Jenkins(0.1))]) is begin
    monkeypatch.setattr(reestimate, "refine", refuse)
    assert reestimate.reestimated(begin, [one]) is begin


@pytest.mark.parametrize("fall, rounds", [(1.01 * reestimate._ENOUGH, 2), (0.99 * reestimate._ENOUGH, 1)])
def test_shapes_are_gone_through_again_while_the_error_falls_enough(monkeypatch, fall, rounds):
    one = Finding(Candidate(laws.Dahl(), Site("storey 1")), laws.Dahl(1.0), 2.0)
    now = []

    def refine(base, f, *more):
        now.append(f.screen)
        return finding(laws.Dahl(3.0), f.screen * (1 - fall))

    monkeypatch.setattr(reestimate, "Stage", lambda *a: a)
    monkeypatch.setattr(reestimate, "refine", refine)
    reestimate.reestimated(shaped_stage(laws.Dahl(1.0)), [one])
    assert now == pytest.approx([2.0, 2.0 * (1 - fall)][:rounds], rel=1e-12)


def test_of_several_needless_effects_the_weakest_goes_and_special_cases_stay(monkeypatch):
    every = [finding(laws.CoulombFriction()), finding(laws.CubicStiffness()), finding(laws.Jenkins(0.1)), FRICTION]
    stage_ = shaped_stage(*(f.law for f in every))
    before = {0: 2.0 * 1.03, 1: 2.0 * 1.02, 2: 2.0 * 1.02}
    rounds = []

    def without(*a):
        level = before[a[2][1][0][1]]
        return SimpleNamespace(slot=lambda: SimpleNamespace(folds=lambda: np.full(10, level)))

    monkeypatch.setattr(reestimate, "Stage", without)
    monkeypatch.setattr(
        reestimate, "place_of", lambda stage, f, accepted: (f.site, every.index(f)) if f in every else None
    )
    monkeypatch.setattr(reestimate, "reestimated", lambda stage, others, n: rounds.append((others, n)) or stage)
    monkeypatch.setattr(Finding, "__eq__", lambda self, other: self is other)
    assert reestimate.needless(stage_, every) is every[1]  # of equals the first
    assert rounds == [([g for g in every if g is not f], 1) for f in every[:3]]
    before.update({0: 1.0})  # it is better without
    assert reestimate.needless(stage_, every) is every[0]
    monkeypatch.setattr(reestimate, "_imitates", lambda stage, general, special: special is every[0])
    assert reestimate.needless(stage_, every) is every[1]
    monkeypatch.setattr(reestimate, "_imitates", lambda *a: False)
    assert reestimate.needless(stage_, [finding(laws.Dahl(1.0)), *every[1:]]) is every[1]  # one that stands nowhere
    monkeypatch.setattr(reestimate, "reestimated", refuse)
    assert reestimate.needless(stage_, every) is None


# -- several together -------------------------------------------------------------------------------


def test_where_nothing_can_be_tried_nothing_is_gained(monkeypatch):
    assert together._null_gain(SimpleNamespace(slot=refuse), []) == 0.0
    level = SimpleNamespace(slot=lambda: SimpleNamespace(folds=lambda: np.full(3, FLOOR)))
    monkeypatch.setattr(together, "lines_for", lambda stage, c: ("lines", c))
    asked = []
    monkeypatch.setattr(together, "screen", lambda *a: asked.append(a) or [])
    assert together._null_gain(level, [FRICTION]) == 0.0
    assert asked == [(level, [FRICTION.candidate], (), ("lines", FRICTION.candidate))]
    monkeypatch.setattr(together, "screen", lambda *a: ["first", "second"])
    monkeypatch.setattr(together, "refine", lambda stage, f, n: (f, n))
    taken = []

    def validated(error):
        def on(stage):
            return taken.append(error) or stage

        return lambda stage, f: SimpleNamespace(
            error=error, folds=np.full(3, error), on=on, is_first=f == ("first", 20)
        )

    for error, gain in ((FLOOR / 2, 0.5), (FLOOR, 0.0), (np.inf, 0.0)):
        monkeypatch.setattr(together, "validate", validated(error))
        assert together._null_gain(level, [FRICTION]) == pytest.approx(gain)
    assert taken == [FLOOR / 2]


def chained(monkeypatch, ranking, errors, most=4, refused=()):
    """Which candidates are added one after another; the errors of each on the model so far are given by its site."""
    seen = []

    def validated(stage, f):
        seen.append((f.screen, stage))
        if str(f.site) in refused:
            refuse()
        return Finding(f.candidate, f.law, 0.0, (), np.array(errors[str(f.site)], dtype=float))

    monkeypatch.setattr(together, "refine", lambda stage, f, n: f if n == 40 else None)
    monkeypatch.setattr(together, "validate", validated)
    monkeypatch.setattr(Finding, "on", lambda self, stage: stage + 1)
    found = together._chain(0, ranking, np.full(10, 10.0), most)
    assert all(np.isinf(screen) for screen, _ in seen)
    return [(str(f.site), k) for f, _, k in found], [k for _, k in seen]


def test_the_best_of_each_place_is_added_while_it_helps_beside_those_before(monkeypatch):
    law = laws.CoulombFriction()
    ranking = [finding(law, 9.0 + 0.01 * k, f"storey {k}") for k in (3, 1, 2, 4, 5, 6)]
    low = {f"storey {k}": np.full(10, 9.0 - 0.7 * k) for k in range(1, 7)}
    assert chained(monkeypatch, ranking, low)[0] == [(f"storey {k}", k) for k in (1, 2, 3, 4)]
    assert chained(monkeypatch, ranking, low, 2) == ([("storey 1", 1), ("storey 2", 2)], [0, 1])
    errors = low | {
        "storey 1": np.full(10, 10 * (1 - 0.99 * MEMBER_GAIN)),
        "storey 2": np.full(10, 10 * (1 - 1.01 * MEMBER_GAIN)),
    }
    found, stages = chained(monkeypatch, ranking, errors)
    assert found == [(f"storey {k}", k - 1) for k in (2, 3, 4, 5)] and stages == [0, 0, 1, 2, 3]
    for wins, first in ((round(10 * MIN_WINS), "storey 1"), (round(10 * MIN_WINS) - 1, "storey 2")):
        errors = low | {"storey 1": np.where(np.arange(10) < wins, 8.3, 11.0)}
        assert chained(monkeypatch, ranking, errors)[0][0][0] == first
    assert chained(monkeypatch, ranking, low, refused=["storey 1"])[0][0] == ("storey 2", 1)
    # ground 1 is the place of storey 1; what drops another law, and a fault, are no members
    one = [finding(law, 9.0), finding(laws.Dahl(1.0), 9.5, "ground 1"), finding(law, 8.0, "storey 2", ((Site(2), 1),)),
           fault(GainError(0.1), 5.0)]  # fmt: skip
    assert chained(monkeypatch, one, low)[0] == [("storey 1", 1)]


def test_a_pair_is_of_one_family_and_site_without_shapes_and_no_richer_than_the_one(monkeypatch):
    asked = []

    def validated(stage, f):
        asked.append((stage, f.law.name, f.drop, f.screen))
        return Finding(f.candidate, f.law, 0.0, f.drop, np.full(10, 1.0))

    monkeypatch.setattr(together, "validate", validated)
    monkeypatch.setattr(Finding, "on", lambda self, stage: (*stage, self.law.name))
    passed = []
    monkeypatch.setattr(together, "_passed", lambda *a: passed.append(a) or Verdict(True, 0.5, 1.0, 0.0, ""))
    names = (laws.QuadraticStiffness(), laws.CubicStiffness(), laws.QuadraticDamping(), laws.Dahl(), laws.Duffing())
    every = [Candidate(law, Site("storey 1")) for law in names] + [Candidate(laws.QuinticStiffness(), Site("storey 2"))]
    place = ((Site("storey 1"), 1),)
    one = Finding(Candidate(laws.TwoSidedGap(), Site("storey 1")), laws.TwoSidedGap(0.1), 2.0, place, np.full(10, 2.0))
    members, verdict = together.pair_instead((), one, every, "before", "null")
    assert [(f.law.name, tied) for f, tied in members] == [("quadratic_stiffness", []), ("cubic_stiffness", [])]
    assert asked[:2] == [
        ((), "quadratic_stiffness", place, np.inf), (("quadratic_stiffness",), "cubic_stiffness", (), np.inf)
    ]  # fmt: skip
    assert "quadratic_damping" not in [name for _, name, _, _ in asked]
    assert passed[0][2] == ("quadratic_stiffness", "cubic_stiffness") and passed[0][3:] == ("before", "null", 2)
    assert together.pair_instead((), fault(GainError(0.1)), every, None, None) is None
    assert together.pair_instead((), one, every[2:], None, None) is None
    monkeypatch.setattr(together, "_passed", lambda *a: None)
    assert together.pair_instead((), one, every, None, None) is None
    monkeypatch.setattr(together, "validate", refuse)
    assert together.pair_instead((), one, every, None, None) is None


@pytest.mark.parametrize("stages, null_gain, reached, accepted", [
    ((), 9.0, False, True), ((1, 2), 0.46, False, False), ((1, 2), 0.4, False, True), ((1, 2), 0.4, True, False),
])  # fmt: skip
def test_several_are_judged_as_one_beside_surrogates_and_confirmed(monkeypatch, stages, null_gain, reached, accepted):
    site, law = Site("storey 1"), laws.TwoSidedGap(0.1)
    dropped, confirmed = [], []
    whole = SimpleNamespace(laws={site: (law, laws.CubicStiffness(), law)}, work=None, chain=None)
    whole.slot = lambda: SimpleNamespace(folds=lambda: np.full(10, 5.0))
    whole.without = lambda where: dropped.append(where)
    monkeypatch.setattr(together, "Stage", refuse)  # without it the others cannot stand: it is not asked about
    monkeypatch.setattr(together, "_null_gain", lambda s, members: null_gain if s == 2 else 0.0)
    monkeypatch.setattr(together, "confirmed", lambda verdict, *a: confirmed.append(a) or verdict)
    null = SimpleNamespace(stages=list(stages), reached=reached)
    verdict = together._passed("stage", [finding(law)], whole, np.full(10, 10.0), null, 2)
    assert (verdict is not None) == accepted and dropped == [[(site, 2)]]  # the last that was added
    assert confirmed == ([("stage", whole, null)] if accepted else [])
    assert not accepted or verdict.null_gain == (null_gain if stages else 0.0)
    monkeypatch.setattr(together, "confirmed", turned_down)
    assert together._passed("stage", [finding(law)], whole, np.full(10, 10.0), null, 2) is None


# -- candidates beside what is there ----------------------------------------------------------------


def test_an_accepted_law_of_a_candidates_family_or_columns_is_replaced_and_a_declared_one_is_not():
    site = Site("storey 1")
    held = (laws.LinearElastic(), laws.CubicStiffness(), laws.Dahl(1.0), laws.CubicStiffness())
    stage_ = SimpleNamespace(laws={site: held})
    quintic = Candidate(laws.QuinticStiffness(), site)
    accepted = [(site, "dahl"), (site, "cubic_stiffness"), (Site("storey 2"), "cubic_stiffness")]
    assert search.replaced(stage_, quintic, accepted) == ((site, 3),)  # of two the last, which was accepted
    assert search.replaced(stage_, quintic, [*accepted, (site, "cubic_stiffness")]) == ((site, 1), (site, 3))
    assert search.replaced(stage_, Candidate(laws.Jenkins(), site), accepted) == ((site, 2),)
    assert search.replaced(stage_, Candidate(laws.CoulombFriction(), site), accepted) == ()
    assert search.replaced(stage_, Candidate(laws.Jenkins(), Site("storey 3")), accepted) == ()
    dof = Site("dof 1")
    forced = SimpleNamespace(laws={dof: (laws.HarmonicForce(3.0), laws.ConstantForce())})
    both = [(dof, "harmonic_force"), (dof, "constant_force")]
    assert search.replaced(forced, Candidate(laws.ConstantForce(), dof), both) == ((dof, 1),)  # it shares its column


def test_laws_that_hold_each_other_or_share_a_column_stand_not_beside_each_other():
    assert search.excludes(laws.Iwan(), laws.Jenkins()) and search.excludes(laws.Jenkins(), laws.Iwan())
    assert search.excludes(laws.CubicStiffness(), laws.CubicStiffness()) and search.excludes(
        laws.Duffing(), laws.CubicStiffness()
    )
    assert not search.excludes(laws.Dahl(), laws.Dahl(1.0)) and not search.excludes(laws.Dahl(), laws.Jenkins())
    site = Site("storey 1")
    stage_ = SimpleNamespace(laws={site: (laws.Jenkins(0.1), laws.Dahl(1.0), laws.TwoSidedGap(0.1))})
    every = tuple((site, i) for i in range(3))
    assert search.beside(stage_, Candidate(laws.Iwan(), site), every) == ((site, 0),)
    assert search.beside(stage_, Candidate(laws.LuGre(), site), every[:2]) == ((site, 1),)


def test_a_candidate_is_tried_in_the_place_of_its_like_and_beside_it(monkeypatch):
    site = Site("storey 1")
    ticks, kept = [], []

    def slot(site, law, out):
        def errors(points, keep):
            kept.append((out, len(points), keep))
            return np.array([5.0, 3.0, 4.0] + [6.0] * (len(points) - 3))

        return SimpleNamespace(errors=errors)

    work = SimpleNamespace(scales=lambda site: (0.02, 0.3, 40.0), fastest=50.0)
    stage_ = SimpleNamespace(laws={site: (laws.LinearElastic(), laws.TwoSidedGap(0.1))}, work=work, slot=slot)
    one = Candidate(laws.TwoSidedGap(), site)
    accepted = [(site, "two_sided_gap")]
    found = search._scan(stage_, [one], accepted, None, lambda: ticks.append(1), True)
    grid = search.grid_of(stage_, one)
    assert [(f.drop, f.n_freed, f.n_added) for f in found] == [(((site, 1),), 2, 0), ((), 0, 2)] and ticks == [1]
    assert [f.law for f in found] == [grid[1]] * 2 and [f.screen for f in found] == [3.0] * 2
    assert kept == [(((site, 1),), 9, True), ((), 9, True)]
    assert [f.drop for f in search._scan(stage_, [one], accepted, None, None, False)] == [((site, 1),)]
    wave = Candidate(laws.HarmonicForce(), Site("dof 1"))
    kept.clear()
    search._scan(stage_, [wave], (), {Site("dof 1"): [3.0, 4.0, 5.0, 6.0]}, None, False)
    assert kept == [((), 4, True)]
    after = search._scan(stage_, [wave, one], (), {Site("dof 2"): [3.0]}, None, False)  # no line, no candidate
    assert [f.law.name for f in after] == ["two_sided_gap"]


@pytest.mark.parametrize("now, everywhere", [(20.0, True), (20.1, False)])
def test_rich_laws_are_tried_everywhere_unless_a_simple_one_lowers_the_error_by_a_twentieth(
    monkeypatch, now, everywhere
):
    """0.95 of 20 is 19."""
    every = [Candidate(law, Site(i)) for i in (1, 2) for law in (laws.CoulombFriction(), laws.BoucWen())]

    def scan(stage, candidates, *more):
        return [Finding(c, c.law, 19.0 if c.site.p == 1 else 40.0) for c in candidates]

    monkeypatch.setattr(search, "_scan", scan)
    one = SimpleNamespace(trial=lambda: SimpleNamespace(search_error=lambda: now))
    found = [f.site.p for f in search.screen(one, every) if f.law.name == "bouc_wen"]
    assert found == ([1, 2] if everywhere else [1])


def test_a_refinement_begins_inwards_at_the_upper_end_and_keeps_to_its_trials():
    law, site = laws.Iwan(), Site("storey 1")
    work = SimpleNamespace(scales=lambda site: (0.02, 0.3, 40.0), fastest=50.0)
    axes, tried = search.Axes(law, work, site), []

    def errors(points):
        tried.extend(axes.point(p) for p in points)
        return [5.0]

    asked = []
    stage_ = SimpleNamespace(work=work, slot=lambda *a: asked.append(a) or SimpleNamespace(errors=errors))
    step = (axes.high - axes.low) / search._GRID[2]
    for share, sign in ((0.49, -1), (0.51, 1)):
        begin = axes.high - share * step
        start = Finding(Candidate(law, site), axes.at(begin), 5.0, ((site, 1),))
        tried.clear()
        assert search.refine(stage_, start) is start and asked[-1] == (site, law, ((site, 1),))
        assert tried[0] == pytest.approx(begin) and len(tried) <= search._EVALUATIONS[2]
        wanted = [begin + (-1 if sign < 0 else 1) * 0.5 * step * np.eye(2)[k] for k in range(2)]
        for one, goal in zip(tried[1:3], wanted):
            assert one == pytest.approx(goal)
    tried.clear()
    search.refine(stage_, Finding(Candidate(law, site), axes.at((axes.low + axes.high) / 2), 5.0), 7, 0.1)
    assert len(tried) == 7 and tried[1][0] - tried[0][0] == pytest.approx(0.1 * step[0])


def test_one_shape_ends_in_the_middle_of_what_the_error_cannot_tell():
    law, site = laws.StiffnessStep(), Site("storey 1")
    work = SimpleNamespace(scales=lambda site: (0.02, 0.3, 40.0), fastest=50.0)
    axes = search.Axes(law, work, site)
    low, high = axes.ends
    a, b = low + 0.3 * (high - low), low + 0.5 * (high - low)
    stage_ = SimpleNamespace(
        work=work,
        slot=lambda *x: SimpleNamespace(
            errors=lambda points: [1.0 + max(0.0, a - axes.point(p)[0], axes.point(p)[0] - b) for p in points]
        ),
    )
    start = Finding(Candidate(law, site), axes.at(np.array([a + 0.05 * (b - a)])), 1.0, folds=np.ones(3))
    found = search.refine(stage_, start)
    assert axes.point(found.law)[0] == pytest.approx((a + b) / 2, abs=0.02 * (b - a))
    assert found.screen == 1.0 and len(found.folds) == 0
    wave = search.Axes(laws.HarmonicForce(), work, Site("dof 1"))
    assert wave.step(True).tolist() == [0.002]


# -- a place for a law ------------------------------------------------------------------------------


def test_laws_are_built_some_at_once_and_one_that_overflows_costs_only_itself(monkeypatch):
    built = []
    one = object.__new__(stage.Slot)
    one._errors = lambda laws, keep: built.append((list(laws), keep)) or np.array(laws, dtype=float)
    n = 2 * stage._AT_ONCE + 1
    assert one.errors(list(range(n)), True).tolist() == list(range(n))
    assert [(len(part), keep) for part, keep in built] == [(stage._AT_ONCE, True)] * 2 + [(1, True)]
    assert one.errors([]).shape == (0,)

    class Numbers(stage.Slot):
        """Laws are numbers x of one column; the error is x^2 and the samples, the coefficient 1."""

        def __init__(self):
            self._members, self._size, self.width = np.ones((1, 2), dtype=bool), 1, 1
            self.work = SimpleNamespace(sizes=np.array([3.0, 4.0]))
            self._project = lambda total, sizes: (total[:, 0, 1, 1] + sizes[:, 0], np.ones((len(total), 2)), None)

        def _columns(self, laws, keep=False):
            if "bad" in laws:
                refuse()
            return np.array([[x, 1.0] for x in laws])

        def extended(self, columns, spans):
            assert spans == [slice(0, 2)]
            return np.array([np.diag([1.0, x * x])[None] for x in columns[:, 0]])

    assert Numbers()._errors(["bad"], False).tolist() == [np.inf]
    monkeypatch.setattr(stage, "admissible", lambda law, theta, size: law != 5.0 and size.tolist() == [law])
    assert Numbers()._errors([4.0, "bad", 5.0, 9.0], False).tolist() == [23.0, np.inf, np.inf, 88.0]


# -- models on Gram matrices ------------------------------------------------------------------------


def linear(n_dof, **more):
    spring = (laws.LinearElastic(), laws.LinearViscous())
    return {Site(f"storey {k}"): spring for k in range(1, n_dof + 1)} | more


@pytest.fixture
def uncompiled(monkeypatch):
    """The walk on Gram matrices as it is written."""
    from pysindy_nrf.laws import compiled

    with monkeypatch.context() as patched:
        patched.setattr(compiled, "jit", lambda function: function)
        patched.setattr(compiled, "part", lambda function: function)
        walk = projection._compiled.__wrapped__()
    monkeypatch.setattr(projection, "_compiled", lambda: walk)


def test_one_balance_is_plain_least_squares_of_the_force(monkeypatch, uncompiled):
    monkeypatch.setattr(stage, "admissible", lambda *a: True)  # noise drives as often as it resists

    work = shaken_space(1)
    one = stage.Stage(work, Chain(1), linear(1))
    rows = [np.column_stack([s.a, s.s, s.v, s.F]) for s in work.data.segments]
    parts = [rows[b.segment][b.rows] for b in work.blocks]

    def fit(blocks, extra=None):
        A = np.vstack([parts[b] for b in blocks])
        columns = A[:, :3] if extra is None else np.column_stack([A[:, :3], extra(A)])
        return np.linalg.lstsq(columns, A[:, 3], rcond=None)[0]

    def error(theta, blocks, extra=None):
        A = np.vstack([parts[b] for b in blocks])
        columns = A[:, :3] if extra is None else np.column_stack([A[:, :3], extra(A)])
        return 100 * np.sqrt(np.mean((A[:, 3] - columns @ theta) ** 2) / np.mean(A[:, 3] ** 2))

    every, trial = range(6), one.trial()
    folds = [error(fit([k for k in every if k != b]), [b]) for b in every]
    assert trial.search_error() == pytest.approx(error(fit(every), every)) and trial.fold_errors() == pytest.approx(
        folds
    )
    for blocks in (every, [0, 1, 2], [0, 1, 2]):
        found, theta = trial.solve(blocks), fit(blocks)
        assert found.masses[1] == pytest.approx(theta[0]) and found.coefficients[Site("storey 1")] == pytest.approx(
            theta[1:]
        )
        for judged in ([6], [7, 8], [0], every, [5, 6]):
            assert trial.error(found, judged) == pytest.approx(error(theta, judged))
    assert trial.model().masses == pytest.approx(fit(every)[:1]) and trial.sizes.tolist() == [60] * 6 + [60, 30, 10]
    assert trial.moments([0, 1]) is trial.moments([0, 1]) is not trial.moments([0, 2])
    cubic = laws.CubicStiffness()
    slot = one.slot(Site("storey 1"), cubic)
    theta = fit(every, lambda A: A[:, 1] ** 3)
    assert slot.search_error(cubic) == pytest.approx(error(theta, every, lambda A: A[:, 1] ** 3))
    wanted = [fit([k for k in every if k != b], lambda A: A[:, 1] ** 3)[[1, 2, 3]] for b in every]
    found = slot.jackknife(cubic)
    assert found[:, [0, 1, -1]] == pytest.approx(np.array(wanted)) and slot.fold_parts(cubic)[2].shape == (6, 1, 2)
    never = one.slot(Site("storey 1"), laws.TwoSidedGap())  # a gap that nothing reaches has a column of zeros
    found = never.errors([laws.TwoSidedGap(1e9), laws.TwoSidedGap(0.5)])
    assert np.isinf(found[0]) and np.isfinite(found[1])
    with pytest.raises(NRFError):
        stage.Stage(work, Chain(1), {Site("storey 1"): (laws.TwoSidedGap(1e9), laws.LinearElastic())}).trial().model()


@pytest.mark.parametrize("unknown", [False, True])
@pytest.mark.parametrize(
    "site, law, drop",
    [
        ("storey 2", laws.CubicStiffness(), ()),
        ("storey 1", laws.CoulombFriction(), ()),
        ("dof 2", laws.ConstantForce(), ()),
        ("ground 2", laws.LinkSpringDashpot(), ()),
        ("link 3-1", laws.LinkSpringDashpot(), ()),
        ("storey 2", laws.QuinticStiffness(), (("storey 2", 2),)),
        ("storey 3", laws.StribeckFriction(0.3), (("storey 2", 2),)),
    ],
)
def test_a_law_on_top_of_a_model_does_as_the_model_with_it(site, law, drop, unknown, monkeypatch, uncompiled):
    monkeypatch.setattr(stage, "admissible", lambda *a: True)  # noise drives as often as it resists
    known = {1: 1.0} if unknown else {}
    held = linear(3) | {
        Site("storey 2"): (
            laws.LinearElastic(),
            laws.LinearViscous(),
            laws.CubicStiffness() if drop else laws.Dahl(2.0),
        )
    }
    one = stage.Stage(shaken_space(3, unknown, known=known), Chain(3), held)
    site, drop = Site(site), tuple((Site(s), k) for s, k in drop)
    slot, whole = one.slot(site, law, drop), one.with_law(site, law, drop)
    assert len(one.laws[site] if site in one.laws else ()) + 1 - sum(s == site for s, _ in drop) == len(
        whole.laws[site]
    )
    assert whole.laws[site][-1] is law and slot.search_error(law) == pytest.approx(
        whole.slot().search_error(), rel=1e-7
    )
    assert slot.errors([law, law]) == pytest.approx([whole.trial().search_error()] * 2, rel=1e-7)
    assert slot.folds(law) == pytest.approx(whole.slot().folds(), rel=1e-6)
    trial, n = whole.trial(), len(whole.work.search)
    every = trial.solve(range(n))
    assert trial.search_error() == pytest.approx(trial.error(every, range(n)), rel=1e-7)
    for b in (0, n - 1):
        rest = trial.solve([k for k in range(n) if k != b])
        assert trial.fold_errors()[b] == pytest.approx(trial.error(rest, [b]), rel=1e-6)
    columns = np.hstack([whole.rows(b.segment)[:, b.rows] for b in whole.work.search])
    assert whole.columns == pytest.approx(columns) and whole.tail + 6 == len(columns)


@pytest.mark.parametrize("known", [{}, {1: 2.0}, {1: 2.0, 3: 1.0}])
@pytest.mark.parametrize(
    "strategy, silent",
    [
        ("auto", False),
        ("complete", False),
        ("sequential", False),
        ("joint", False),
        ("auto", True),
        ("sequential", True),
    ],
)
def test_the_walk_on_gram_matrices_does_as_the_chain_solve(strategy, known, silent, uncompiled):
    # where no force acts on the second DOF, its balance is measured by its inertia
    work = shaken_space(3, known=known, strategy=strategy, silent=[1] if silent else [])
    held = linear(3) | {Site("storey 3"): (laws.LinearElastic(),), Site("dof 2"): (laws.ConstantForce(),)}
    one = stage.Stage(work, Chain(3), held)
    trial, n = one.trial(), len(work.search)
    every = trial.solve(range(n))
    assert trial.search_error() == pytest.approx(trial.error(every, range(n)), rel=1e-7)
    errors, theta, _ = one.slot().fold_parts()
    for b in range(n):
        rest = trial.solve([k for k in range(n) if k != b])
        assert errors[b] == pytest.approx(trial.error(rest, [b]), rel=1e-6)
        for site, values in rest.coefficients.items():
            assert theta[b, trial.layout.slices[site]] == pytest.approx(values, rel=1e-6)


@pytest.mark.parametrize("strategy", ["auto", "joint"])
def test_a_law_that_cannot_be_told_costs_only_itself(strategy, monkeypatch, uncompiled):
    monkeypatch.setattr(stage, "admissible", lambda *a: True)
    one = stage.Stage(shaken_space(2, strategy=strategy), Chain(2), linear(2))
    slot = one.slot(Site("storey 1"), laws.TwoSidedGap())
    found = slot.errors([laws.TwoSidedGap(1e9), laws.TwoSidedGap(0.5)])
    assert np.isinf(found[0])
    assert found[1] == pytest.approx(
        one.with_law(Site("storey 1"), laws.TwoSidedGap(0.5)).trial().search_error(), rel=1e-7
    )


def test_laws_of_a_stage_are_taken_out_and_changed_by_their_number():
    held = linear(2) | {Site("storey 2"): (laws.LinearElastic(), laws.Dahl(1.0), laws.Dahl(2.0))}
    one = stage.Stage(shaken_space(2), Chain(2), held)
    site = Site("storey 2")
    assert (
        one.at == {(Site("storey 1"), 0): 0, (Site("storey 1"), 1): 1, (site, 0): 2, (site, 1): 3, (site, 2): 4}
        and one.tail == 5
    )
    assert [law.name for law in one.without([(site, 1)])[site]] == ["linear_elastic", "dahl"]
    assert [law.shape.get("sigma") for law in one.without([(site, 1)])[site]] == [None, 2.0]
    changed = one.with_values((site, 1), laws.Dahl(9.0))
    assert [law.shape.get("sigma") for law in changed.laws[site]] == [None, 9.0, 2.0]
    assert [law.shape.get("sigma") for law in one.laws[site]] == [None, 1.0, 2.0]
    added = one.with_law(site, laws.Jenkins(0.1), [(site, 2), (Site("storey 1"), 1)])
    assert [law.name for law in added.laws[site]] == ["linear_elastic", "dahl", "jenkins"]
    assert len(added.laws[Site("storey 1")]) == 1
    link = one.with_law(Site("link 2-0"), laws.LinkSpringDashpot())
    assert link.trial().stage is link and len(link.columns) == 5 + 2 + 4
