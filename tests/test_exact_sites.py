"""Exact numbers of sites and sensors: where a force acts, which channel is faulty, the words of a step."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from hand_made_walk import fault, finding, four, noise, refuse

from pysindy_nrf import Chain, ChainModel, Site, laws
from pysindy_nrf.discrepancy import (
    localisation,
    markdown,
    noise_floor,
    prepare,
    residual,
    sensors,
    steps,
)
from pysindy_nrf.discrepancy.gate import Verdict
from pysindy_nrf.discrepancy.report import Step
from pysindy_nrf.exceptions import ChannelError, NRFError
from pysindy_nrf.input_arrays import from_arrays
from pysindy_nrf.laws.sensor import ChannelDelay, GainError, SensorOffset

# -- where a force acts -----------------------------------------------------------------------------


def ranked(monkeypatch, shares, own=None, n=2, sites=None, at_floor=False, known=None):
    """Sites put in order by given shares of patterns, and by what their own motions are said to explain."""
    known = list(range(n)) if known is None else known
    chain, asked = Chain(n), []

    def pattern(site):
        b = localisation._incidence(chain, site)[known]
        return b if b.any() else None

    def share(b):
        asked.append(tuple(b))
        value = shares[tuple(b)] if isinstance(shares, dict) else shares
        return value, value - 0.01, value + 0.01

    def explained(site, b):
        asked.append(str(site))
        return (own or {}).get(str(site), np.nan), 2.0

    fake = SimpleNamespace(known=known, noise=None, at_floor=at_floor, pattern=pattern, share=share, own=explained)
    monkeypatch.setattr(localisation._Work, "of", lambda *a: fake)
    residual = SimpleNamespace(model=SimpleNamespace(chain=chain), data=SimpleNamespace(forced=(2,)))
    return localisation.localise(residual, sites), asked


@pytest.mark.parametrize("second, followed", [(0.7499, False), (0.7501, True)])
def test_equal_patterns_are_judged_once_and_put_in_order_by_their_own_motion(monkeypatch, second, followed):
    """Sites within six times five percent of the best are followed."""
    shares = {(-1, 1): 1.05, (1, 0): 0.9, (0, 1): second}
    own = {"storey 1": 40.0, "storey 2": 80.0, "ground 2": 10.0, "sensor a2": 20.0}
    names = ["storey 1", "dof 1", "storey 2", "ground 2", "sensor a2", "storey 1"]
    table, asked = ranked(monkeypatch, shares, own, sites=names)
    assert asked[:3] == [(1, 0), (-1, 1), (0, 1)] and not isinstance(asked[3], tuple)
    end = ["sensor a2", "ground 2"] if followed else ["ground 2", "sensor a2"]
    assert list(table.index) == ["storey 2", "dof 1", "storey 1", *end]  # from outside: 60 % follow no motion
    assert table["own"].tolist()[:3] == [80.0, 60.0, 40.0] and np.isfinite(table["own"].iloc[3]) == followed
    assert table["share"].tolist() == pytest.approx([100.0, 90.0, 90.0, 100 * second, 100 * second])
    assert table["high"].iloc[0] == 100.0 and table["low"].iloc[1] == pytest.approx(89.0)
    assert table["rms"].iloc[0] == 2.0 and table["balances"].tolist() == ["-1, +2", "+1", "+1", "+2", "+2"]
    assert table["verdict"].iloc[0] == (
        "explains 100 % (balances -1, +2); its own motion explains 80 % of the force; next dof 1 (90 %)"
    )
    assert table["verdict"].iloc[1] == "explains 90 % (balances +1); 60 % follows no motion there"


def test_some_of_the_best_are_followed_and_none_at_the_floor(monkeypatch):
    table, asked = ranked(monkeypatch, 0.5, n=5)
    names = [a for a in asked if isinstance(a, str)]
    assert (
        names
        == [
            str(s)
            for s in localisation._all_sites(
                SimpleNamespace(model=SimpleNamespace(chain=Chain(5)), data=SimpleNamespace(forced=(2,)))
            )
        ][: 2 * localisation._FOLLOWED]
    )
    table, asked = ranked(monkeypatch, 0.5, at_floor=True)
    assert not [a for a in asked if isinstance(a, str)] and table["own"].isna().all()
    assert table["verdict"].iloc[0] == "all balances together leave round-off: nothing to locate"
    table, asked = ranked(monkeypatch, 0.5, sites=["storey 2", "storey 1"], known=[1])
    assert list(table.index) == ["storey 2", "storey 1"] and np.isnan(table["share"].iloc[1])
    assert table["verdict"].tolist() == ["one balance: the signs say nothing", "not seen in the known balances"]


def test_sites_are_storeys_links_grounds_dofs_and_sensors_of_what_is_forced():
    residual = SimpleNamespace(model=SimpleNamespace(chain=Chain(4)), data=SimpleNamespace(forced=(2, 4)))
    assert [str(s) for s in localisation._all_sites(residual)] == (
        ["storey 1", "storey 2", "storey 3", "storey 4", "link 3-1", "link 4-1", "link 4-2"]
        + ["ground 2", "ground 3", "ground 4", "dof 1", "dof 2", "dof 3", "dof 4"]
        + ["sensor a1", "sensor a2", "sensor a3", "sensor a4", "sensor F2", "sensor F4"]
    )
    chain = Chain(3)
    assert localisation._incidence(chain, Site("sensor a3")).tolist() == [0, 0, 1]
    assert localisation._incidence(chain, Site("sensor F1")).tolist() == [1, 0, 0]
    assert localisation._incidence(chain, Site("link 3-1")).tolist() == [-1, 0, 1]
    assert localisation._signs(chain, Site("link 3-1")) == "-1, +3"
    for wrong in ("sensor a4", "sensor x1", "sensor v2", "sensor ag"):
        with pytest.raises(ChannelError, match="not felt in one balance"):
            localisation._incidence(chain, Site(wrong))


def test_a_pattern_is_kept_with_its_first_sign_positive():
    for b in ([-1.0, 1.0], [1.0, -1.0]):
        assert np.frombuffer(localisation._key(np.array(b))).tolist() == [1.0, -1.0]
    assert np.frombuffer(localisation._key(np.array([0.0, 1.0, -1.0]))).tolist() == [0.0, 1.0, -1.0]
    assert localisation._key(np.array([0.0, -1.0])) == localisation._key(np.array([0.0, 1.0]))  # no zero of another sign
    assert localisation._key(None) == b""


@pytest.mark.parametrize("known, told", [(2, True), (1, False)])
def test_sites_of_one_pattern_are_named_where_there_is_more_than_one_balance(known, told):
    names = ["ground 2", "sensor a2", "dof 2", "storey 1"]
    table = pd.DataFrame({"share": [90.0, 90.0, 90.0, 10.0], "own": np.nan, "balances": "+2"}, index=names)
    table["low"] = table["high"] = table["share"]
    work = SimpleNamespace(known=list(range(known)), at_floor=False, noise=None)
    patterns = {Site(s): np.array([0.0, 1.0] if s != "storey 1" else [1.0, 0.0]) for s in names}
    said = localisation._verdicts(table, patterns, work)
    if told:
        assert said[0] == "explains 90 % (balances +2); next storey 1 (10 %); the same pattern as sensor a2, dof 2"
    else:
        assert said[0] == "one balance: the signs say nothing"
    assert "pattern" not in "".join(said[1:]) and "next" not in "".join(said[1:])
    alone = localisation._verdicts(table.iloc[[0, 3]], patterns, SimpleNamespace(**vars(work) | {"known": [0, 1]}))
    assert alone[0] == "explains 90 % (balances +2); next storey 1 (10 %)"


@pytest.mark.parametrize(
    "site, forced, known, free",
    [
        (None, (1,), (), "1234"),
        ("dof 2", (1,), (), "13"),
        ("ground 2", (1, 4), (), "134"),
        ("storey 3", (1,), (), "1234"),
        (None, (1,), (3,), "124"),
        ("dof 2", (1,), (3,), "1"),
        ("dof 2", (2,), (), "3"),
        ("dof 2", (3,), (), "34"),
        (None, (), (), ""),
        ("dof 4", (1,), (), "123"),
    ],
)
def test_of_a_piece_that_no_force_scales_the_largest_mass_is_held(site, forced, known, free):
    one, _ = four(forced)
    work = localisation._Work.of(one, None, (), known, 10)
    b = None if site is None else work.pattern(Site(site))
    assert "".join(str(j + 1) for j in np.flatnonzero(work._free_masses(b))) == free
    if site == "dof 2":  # the same beside it
        beside = localisation._Work.of(one, None, ["dof 2"], known, 10)
        assert beside._free_masses(None).tolist() == work._free_masses(b).tolist()


@pytest.mark.parametrize("known, columns", [((), "al"), ((2,), "l"), ((3,), "a"), ((4,), "a")])
def test_a_force_may_hold_what_enters_like_it_and_the_forces_of_a_piece_cut_off(known, columns):
    f = noise(60, 3)
    one, X = four(f=f)
    force, base = localisation.missing_force(one, "dof 2", known_masses=known)
    assert force[0] == pytest.approx(f)
    wanted = {"a": X[:, 1], "l": -(4.0 * X[:, 10] + 0.3 * X[:, 6])}
    assert base[0] == pytest.approx(np.column_stack([wanted[c] for c in columns]), abs=1e-6)


def test_a_model_that_is_corrected_is_loose_with_its_corrections():
    f, d = noise(60, 3), 0.7
    one, X = four(f=f)
    s3 = X[:, 10]
    force, base = localisation.missing_force(
        one.with_balance([np.outer(f, [0, 1, 0, 0]) + d * np.outer(s3, [0, -1, 1, 0])]), "dof 2"
    )
    assert force[0] == pytest.approx(f) and base[0][:, 1] == pytest.approx(-((4.0 + d) * s3 + 0.3 * X[:, 6]))


@pytest.mark.parametrize("gap, tied", [(4e-9, True), (4e-8, False)])
def test_shares_that_differ_in_the_seventh_digit_are_equal(monkeypatch, gap, tied):
    own = {"storey 2": 10.0, "storey 1": 90.0}
    table, _ = ranked(monkeypatch, {(-1, 1): 0.9 + gap, (1, 0): 0.9}, own, sites=["storey 2", "storey 1"])
    assert list(table.index) == (["storey 1", "storey 2"] if tied else ["storey 2", "storey 1"])


def test_a_residual_below_the_floor_is_a_part_of_it():
    one, X = four()
    one = one.with_balance([noise(240, 5).reshape(60, 4)])
    quiet, loud = (localisation._Work.of(one, localisation.NoiseFloor.given(x, 4), (), (), 10) for x in (1e-3, 1e3))
    assert loud.over_floor == pytest.approx(1e-6 * quiet.over_floor) and loud.at_floor and not quiet.at_floor


def test_the_noise_of_the_weights_is_nine_tenths_the_covariance_and_one_its_diagonal():
    one, _ = four()
    S = np.array([[4.0, 1, 0, 0], [1, 9, 0, 0], [0, 0, 1, 0.5], [0, 0, 0.5, 1]])
    work = localisation._Work.of(one, SimpleNamespace(covariance=lambda: S), (), (), 10)
    wanted = S * np.where(np.eye(4) > 0, 1.0, 0.9)
    assert work.noise == pytest.approx(wanted) and work.weight == pytest.approx(np.linalg.inv(wanted))
    for bad in (np.nan, 0.0):
        S[0, 0] = bad
        assert localisation._Work.of(one, SimpleNamespace(covariance=lambda: S), (), (), 10).noise is None
    assert work.forced.tolist() == [True, False, False, False] and not work.held.any()
    assert localisation._Work.of(four(())[0], None, (), (), 10).held.all()  # masses that were given scale the chain


@pytest.mark.parametrize("n, sizes", [(100, [100]), (2047, [2047]), (2048, [1024, 1024]), (4096, [2048, 1024, 1024])])
def test_blocks_of_the_band_hold_a_thousand_samples_or_so(n, sizes):
    one, X = four(n=n)
    work = localisation._Work.of(one, None, (), (), 3)
    assert work.sizes.tolist() == sizes and work.grams.shape == (len(sizes), 16, 16)
    a = X[:, :4]
    assert work.grams.sum(axis=0)[8:12, 8:12] == pytest.approx(a.T @ a)
    assert np.isfinite(work.share(work.pattern(Site("dof 2")))[1]) == (len(sizes) == 3)


def test_the_share_of_a_force_that_its_own_motion_explains_is_asked_of_sensors_and_links():
    one, X = four(n=600)
    work = localisation._Work.of(one, None, (), (), 10)
    line = np.gradient(X[:, 1])
    work.force = lambda b: ([line], [np.ones((600, 1))])
    own, rms = work.own(Site("sensor a2"), 0)
    assert own == pytest.approx(100.0, abs=1e-3) and rms == pytest.approx(np.sqrt(np.mean(line**2)))
    assert np.isnan(work.own(Site("dof 2"), 0)[0])
    work.force = lambda b: ([noise(600, 9)], [np.ones((600, 1))])
    assert work.own(Site("sensor a2"), 0)[0] == pytest.approx(0.0, abs=2.0) and work.own(Site("sensor a2"), 0)[0] >= 0.0
    work.force = lambda b: ([np.zeros(600)], [np.ones((600, 1))])
    assert np.isnan(work.own(Site("sensor a2"), 0)[0]) and work.own(Site("sensor a2"), 0)[1] == 0.0
    m = one.data.segments[0].motion(Site("storey 2"), slice(0, 600))
    columns = localisation._Own(Site("storey 2"), one).of(0)
    assert columns[:, 0].tolist() == m.s.tolist() and columns[:, 1].tolist() == m.v.tolist() and columns.shape[1] > 2


# -- faults of sensors ------------------------------------------------------------------------------


def test_a_fault_whose_channels_cannot_be_fused_is_none(monkeypatch):
    one = sensors.Suspect(GainError(0.1), Site("sensor a1"))
    for error, known in ((NRFError("x", "y"), True), (np.linalg.LinAlgError("x"), True), (TypeError("x"), False)):

        def fail(*a, error=error):
            raise error

        monkeypatch.setattr(sensors, "as_true", fail)
        if known:
            assert sensors._rebuilt(prepare.Prepared(["r"], None), None, None, one) is None
        else:
            with pytest.raises(TypeError):
                sensors._rebuilt(prepare.Prepared(["r"], None), None, None, one)


def test_everything_is_built_again_from_the_corrected_records(monkeypatch):
    prepared, moved = [], []

    def built(*a, bands):
        assert bands is None  # of records that were not fused here
        prepared.append(a)
        return SimpleNamespace(data=SimpleNamespace(segments="fused"))

    trial = SimpleNamespace(search_error=lambda: 3.0, fold_errors=lambda: np.arange(3.0))
    monkeypatch.setattr(sensors, "as_true", lambda r, site, law: f"{r} true")
    monkeypatch.setattr(sensors, "prepare", built)
    monkeypatch.setattr(sensors, "_with_segments", lambda work, segments: moved.append(segments) or "moved")
    monkeypatch.setattr(sensors, "_shifted", lambda seg, kind, j, law: (seg, kind, j, law.values[0]))
    monkeypatch.setattr(
        sensors, "Stage", lambda work, chain, laws: SimpleNamespace(key=(work, chain, laws), trial=lambda: trial)
    )
    monkeypatch.setattr(sensors, "SegmentSet", lambda segments, n: SimpleNamespace(segments=segments, n_samples=n))
    base = SimpleNamespace(chain="chain", laws="laws")
    work = SimpleNamespace(data=SimpleNamespace(segments=[7], n_samples=50))
    ready = prepare.Prepared(["r0", "r1", "r2"], None, heldout=[1], clean=True)
    for held in ([1], None):
        ready.heldout = held
        found = sensors._rebuilt(
            ready, work, base, sensors.Suspect(GainError(0.1), Site("sensor a12"), "they disagree")
        )
        assert (found.screen, found.folds.tolist(), found.remark) == (3.0, [0.0, 1.0, 2.0], "they disagree")
        assert found.stage.key == ("moved", "chain", "laws") and moved[-1] == "fused"
    assert prepared == [(["r0 true", "r2 true"], ["r1 true"]), (["r0 true", "r1 true", "r2 true"], None)]
    force = sensors._rebuilt(ready, work, base, sensors.Suspect(GainError(0.1), Site("sensor F2")))
    assert len(prepared) == 2 and moved[-1] == [(7, "F", 2, 0.1)] and force.ready.clean
    assert force.ready.records == ["r0 true", "r1 true", "r2 true"] and force.ready.data.n_samples == 50


GAIN = GainError()


def findings_of(monkeypatch, seen=(), scanned=(), error=5.0, screens=None, names=(GAIN,), corrected=()):
    """Faults that channels tell (with their size) and that balances promise (with their error)."""
    calls = []
    built = {}

    def rebuilt(ready, work, stage, s):
        calls.append(("rebuilt", str(s.site)))
        one = fault(s.law, (screens or {}).get(str(s.site), 2.0), str(s.site), (screens or {}).get(str(s.site), 2.0))
        one.remark = s.remark
        return built.setdefault(str(s.site), one)

    promised = {f"sensor {c}": e for c, e in scanned}
    monkeypatch.setattr(sensors, "contradictory", lambda ready, work: [
        (size, sensors.Suspect(law, Site(f"sensor {c}"), "they disagree")) for size, law, c in seen])  # fmt: skip
    monkeypatch.setattr(sensors, "_alone", lambda *a: [sensors.Suspect(GainError(), Site(s)) for s in promised])
    monkeypatch.setattr(
        sensors,
        "_scan",
        lambda work, stage, s, now: None if promised[str(s.site)] is None else (promised[str(s.site)], s),
    )
    monkeypatch.setattr(sensors, "_rebuilt", rebuilt)
    monkeypatch.setattr(sensors, "_sharpened", lambda ready, work, stage, f: calls.append(("sharp", str(f.site))) or f)
    stage_ = SimpleNamespace(trial=lambda: SimpleNamespace(search_error=lambda: error))
    work = SimpleNamespace(forced=(1, 2), known_masses={})
    told = sensors.sensor_findings(SimpleNamespace(refused={}), work, stage_, list(names), corrected)
    return [str(f.site) for f in told], calls


def test_the_best_promises_and_the_first_contradictions_are_built_again(monkeypatch):
    scanned = [("a1", 3.0), ("a2", 1.0), ("a3", None), ("a4", 2.0)]
    told, calls = findings_of(monkeypatch, scanned=scanned)
    assert [c for _, c in calls] == ["sensor a2", "sensor a4"] and told == ["sensor a2", "sensor a4"]
    from pysindy_nrf.discrepancy.contradictions import CONTRADICTION, MOST

    seen = [(CONTRADICTION, GainError(0.1), f"a{k}") for k in range(1, MOST + 3)]
    assert len([c for kind, c in findings_of(monkeypatch, seen)[1] if kind == "rebuilt"]) == MOST
    seen = [(0.999 * CONTRADICTION, GainError(0.1), "a1"), (CONTRADICTION, ChannelDelay(0.1), "a2")]
    assert findings_of(monkeypatch, seen)[0] == []  # too small, and of a kind that is not tried
    assert findings_of(monkeypatch, seen, names=[ChannelDelay()])[0] == ["sensor a2"]


@pytest.mark.parametrize("screen, sharp", [(0.999, True), (1.001, False)])
def test_a_fault_that_channels_tell_is_sharpened_if_the_error_falls_by_what_the_gate_asks(monkeypatch, screen, sharp):
    screen *= 5.0 * (1 - sensors._WITNESSED)
    seen = [(9.0, GainError(0.1), "a1")]
    assert (("sharp", "sensor a1") in findings_of(monkeypatch, seen, screens={"sensor a1": screen})[1]) == sharp
    assert findings_of(monkeypatch, scanned=[("a1", 1.0)])[1] == [("rebuilt", "sensor a1")]  # no channel bears witness
    for screen, told in ((4.999, ["sensor a1"]), (5.0, [])):
        assert findings_of(monkeypatch, seen, screens={"sensor a1": screen})[0] == told


def test_the_value_of_an_offset_is_looked_for_near_the_mean_of_its_displacement(monkeypatch):
    monkeypatch.setattr(sensors, "longest", lambda work: (1, slice(2, 6)))
    s = np.arange(30.0).reshape(10, 3)
    work = SimpleNamespace(data=SimpleNamespace(segments=[None, SimpleNamespace(s=s)]))
    means = sensors._means(work, sensors.Suspect(SensorOffset(), Site("sensor x2")))
    assert means == [pytest.approx((s[2:6, 0] + s[2:6, 1]).mean())]
    assert sensors._means(work, sensors.Suspect(GainError(), Site("sensor x2"))) == []


def wild(monkeypatch, error, means=(), law=None):
    """A scan of a fault of the unit 1/2 whose error is a given function, with coarse trials where the model is wild."""
    tried = []
    monkeypatch.setattr(sensors, "_shifted", lambda seg, kind, j, law: law.values[0])
    monkeypatch.setattr(sensors, "_with_segments", lambda work, moved: moved[0])
    monkeypatch.setattr(sensors, "_means", lambda work, suspect: list(means))

    def model(value, chain, laws):
        tried.append(value)
        return SimpleNamespace(trial=lambda: SimpleNamespace(search_error=lambda: error(value)))

    monkeypatch.setattr(sensors, "Stage", model)
    work = SimpleNamespace(data=SimpleNamespace(segments=[0]), scales=lambda site: (0.5, 0, 0))
    base = SimpleNamespace(chain=None, laws=None)
    return sensors._scan(work, base, sensors.Suspect(law or SensorOffset(), Site("sensor x2")), error(0.0)), tried


def test_coarse_trials_are_shares_of_the_reach_and_the_mean_within_it(monkeypatch):
    reach = 0.5 * sensors._STEPS["sensor_offset"][1]
    assert wild(monkeypatch, lambda x: 30.0, [1.3, 1.01 * reach])[1][2:] == pytest.approx(
        [*(reach * sensors._COARSE), 1.3]
    )

    def well(x):
        return 30.0 if abs(x - 1.3) > 0.6 else 5.0 + 20 * abs(x - 1.25)

    found, tried = wild(monkeypatch, well, [1.3])
    assert found[1].law.values[0] == pytest.approx(1.25, abs=0.01) and found[0] == pytest.approx(5.0, abs=0.2)
    assert 0.5 * 1.3 <= min(tried[7:]) and max(tried[7:]) <= 1.7 * 1.3
    for share, looked in ((1.001, False), (0.999, True)):  # of what the coarse trials must promise
        level = 30.0 * (1 - sensors._PROMISE) * share
        tried = wild(monkeypatch, lambda x, level=level: 30.0 if abs(x) < 1 else level)[1]
        assert (len(tried) > 6) == looked


def test_a_fault_that_cannot_be_tried_costs_the_most(monkeypatch):
    def error(x):
        return refuse() if x > 0 else 10.0 + 20 * (x + 0.2) ** 2

    found, _ = wild(monkeypatch, error)
    assert found is None or found[1].law.values[0] < 0
    assert wild(monkeypatch, lambda x: refuse() if x else 10.0)[0] is None


def test_a_record_without_a_step_is_shifted_by_samples_and_a_silent_force_stays():
    n = 60
    X, F = np.random.default_rng(0).standard_normal((n, 6)), np.zeros((n, 2))
    F[:, 0] = np.sin(np.arange(n) / 3.0)
    seg = from_arrays(X, F, dt=0.01).segments[0]
    assert sensors._shifted(seg, "F", 2, SensorOffset(0.5)).F.tolist() == seg.F.tolist()
    assert sensors._shifted(seg, "F", 1, SensorOffset(0.5)).F[:, 0] == pytest.approx(F[:, 0] - 0.5)
    seg.F[:, 1] = np.nan
    unknown = sensors._shifted(seg, "F", 2, SensorOffset(0.5))
    assert np.isnan(unknown.F[:, 1]).all() and unknown.valid == seg.valid
    still = from_arrays(X, F).segments[0]
    assert still.dt is None
    late = sensors._shifted(still, "F", 1, ChannelDelay(2.0))  # two samples
    rows = slice(5, n - 5)
    assert late.F[rows, 0] == pytest.approx(F[7 : n - 3, 0], abs=0.05)


# -- words of a step --------------------------------------------------------------------------------


def test_a_step_of_a_fault_tells_its_values_equals_and_what_the_channels_say():
    one = fault(GainError(0.1), 2.0, "sensor a2")
    one.equals, one.remark = ["sensor x2"], "a2 and x2 disagree"
    verdict = Verdict(True, 0.5, 1.0, 0.0, "it falls")
    told = steps.step_of(one, [], verdict, np.ones(3), np.ones(3), 0.5, [], 0.0)
    assert told.parameters == {"e": 0.1} and told.sensors == ["sensor x2"] and told.site == "sensor a2"
    assert told.evidence == "it falls (a2 and x2 disagree)"
    one.remark = ""
    assert steps.step_of(one, [], verdict, np.ones(3), np.ones(3), 0.5, [], 0.0).evidence == "it falls"


def test_the_worst_balance_is_that_with_the_largest_share(monkeypatch):
    table = pd.DataFrame({"error": [3.0, 9.0, 99.0]}, index=["storey 1", "dof 2", "pooled"])
    monkeypatch.setattr(steps, "model_of", lambda layout, solution: ("model", layout, solution))
    monkeypatch.setattr(steps, "balance_errors", lambda model, moments: table if (model, moments) == (
        ("model", "layout", [0, 1]), [0, 1]) else None)  # fmt: skip
    trial = SimpleNamespace(work=SimpleNamespace(search=["a", "b"]), layout="layout", solve=list, moments=list)
    assert steps.worst(trial) == "balance of DOF 2"
    table["error"] = [9.5, 9.0, 99.0]
    assert steps.worst(trial) == "balance of storey 1"


def test_at_most_two_other_families_are_named():
    tied = [finding(law) for law in (laws.QuadraticStiffness(), laws.QuadraticDamping(), laws.TwoSidedGap(0.1))]
    assert steps._alternatives(finding(laws.CubicStiffness()), tied, 1.0) == ["stiffness", "damping"]
    assert steps._alternatives(finding(laws.Jenkins(0.1)), tied, 1.0) == ["friction", "stiffness"]
    for law in (laws.Jenkins(), laws.PowerLawDamping()):  # a shape that is not known is not small
        assert steps._alternatives(finding(law), [], 1.0) == []
    one = Step(
        "power_law_damping", "damping", "storey 1", intervals={"n": (0.1, 0.5)}, alternatives=["a", "b", "friction"]
    )
    steps.doubt_names([one])
    assert one.alternatives == ["friction", "a"]
    plain = Step("power_law_damping", "damping", "storey 1")
    steps.doubt_names([plain])
    assert plain.alternatives == []
    every = [
        Step("constant_force", "forcing", "dof 1", alternatives=["a"]),
        Step("dahl", "hysteresis", "storey 1", alternatives=["b", "forcing"]),
    ]
    steps.doubt_names(every)
    assert every[0].alternatives == ["a", "hysteresis"] and every[1].sure and every[0].sure
    alone = Step("constant_force", "forcing", "dof 1", alternatives=["a", "b", "c"])
    steps.doubt_names([alone])
    assert alone.alternatives == ["a", "b", "c"]


# -- more of sensors and residuals ------------------------------------------------------------------


@pytest.mark.parametrize("true", [0.13, -0.2])
@pytest.mark.parametrize("now", [1.5, 6.0])
def test_a_scan_begins_within_twice_the_bottom_of_the_parabola(monkeypatch, true, now):
    """The first of the trials is the golden section of that."""
    golden = (3 - np.sqrt(5)) / 2
    found, tried = wild(monkeypatch, lambda x: now * np.sqrt(1 + 15 * ((x - true) ** 2 - true**2)), law=GainError())
    first = 2 * true * golden if true > 0 else 2 * true * (1 - golden)
    assert found[1].law.values[0] == pytest.approx(true, abs=0.002) and tried[2] == pytest.approx(first)


@pytest.mark.parametrize("promise, looked", [(0.049, False), (0.051, True)])
@pytest.mark.parametrize("now", [0.5, 3.0])
def test_what_a_parabola_must_promise_is_a_share_of_the_error(monkeypatch, promise, looked, now):
    curve = (1 - (1 - promise) ** 2) / 0.1**2
    found, tried = wild(monkeypatch, lambda x: now * np.sqrt(1.0 + curve * ((x - 0.1) ** 2 - 0.01)), law=GainError())
    assert found is None and (len(tried) > 2) == looked


def test_a_coarse_scan_goes_on_between_half_and_nearly_twice_the_best(monkeypatch):
    near = 0.5 * sensors._STEPS["sensor_offset"][1] * sensors._COARSE[2]
    tried = wild(monkeypatch, lambda x: 30.0 if abs(x - near) > 0.3 else 10.0 + abs(x - near))[1]
    golden = (3 - np.sqrt(5)) / 2
    assert tried[6] == pytest.approx(near * (0.5 + 1.2 * golden))


def test_a_record_without_a_free_run_leaves_nothing_to_compare():
    seg = from_arrays(np.ones((20, 3)), np.full((20, 1), np.nan), dt=0.01)
    model = ChainModel([1.0], {1: [laws.LinearElastic(1.0)]})
    found = residual.free_run_residual(model, seg)
    assert (
        np.isnan(found.displacement[0]).all()
        and np.isnan(found.acceleration[0]).all()
        and found.displacement[0].shape == (20, 1)
    )
    assert found.sizes.isna().all(axis=None) and list(found.sizes.index) == ["dof 1"] and "unknown" in found.reasons[0]
    with pytest.raises(ChannelError, match="no balance has a residual"):
        residual.residual_of(model, seg)


def test_a_force_is_not_looked_for_where_no_balance_is_known():
    one, _ = four()
    one.balance[0][:, 1] = np.nan
    with pytest.raises(ChannelError, match="dof 2 is not seen"):
        localisation.missing_force(one, "dof 2")
    assert localisation._Work.of(one, None, (), (), 10).known.tolist() == [0, 2, 3]
    one.balance[0][:] = np.nan
    with pytest.raises(ChannelError, match="No balance is known"):
        localisation.missing_force(one, "dof 1")
    everywhere, _ = four()
    work = localisation._Work.of(
        everywhere, localisation.NoiseFloor.given(1.0, 4), [f"dof {j}" for j in (1, 2, 3, 4)], (), 10
    )
    assert not work._free_masses(None).any()


@pytest.mark.parametrize("share, alike", [(0.19, True), (0.21, False)])
def test_repetitions_differ_by_less_than_a_fifth_of_their_common_force(share, alike):
    force, other = 3.0 * np.tile([1.0, -1.0], 50), 3.0 * share * np.tile([1.0, 1.0, -1.0, -1.0], 25)
    sets = [from_arrays(np.zeros((100, 3)), f[:, None], dt=0.01) for f in (force + other, force - other)]
    model = ChainModel([1.0], {1: [laws.LinearElastic(1.0)]})
    one = residual.residual_of(model, noise_floor._together(sets))
    if alike:  # 3 N of share apart, each from their mean, times sqrt(2)
        floor = noise_floor.NoiseFloor.from_repeats(one)
        assert floor.balance[0] == pytest.approx(np.sqrt(2) * 3 * share) and floor.source == "2 repeated records"
    else:
        with pytest.raises(ChannelError, match="not excited alike"):
            noise_floor.NoiseFloor.from_repeats(one)


@pytest.mark.parametrize(
    "law, family, sure",
    [("quadratic_damping", "damping", False), ("two_sided_gap", "contact", False), ("dahl", "hysteresis", True)],
)
def test_a_constant_may_be_the_lack_of_symmetry_of_a_curve(law, family, sure):
    both = [Step(law, family, "storey 1"), Step("constant_force", "forcing", "dof 1")]
    steps.doubt_names(both)
    assert [s.sure for s in both] == [sure] * 2
    assert both[0].company == ([] if sure else ["constant_force"]) and both[1].company == ([] if sure else [law])


def test_a_stribeck_force_is_improper_from_zero_down():
    for low, high, wrong in ((-2.0, 0.5, False), (-2.0, -0.5, True)):
        assert steps.improper("stribeck_friction", {"dF": (low, high)}) == wrong


def test_a_value_that_is_not_known_is_none_where_corrections_are_joined():
    first = Step("gain_error", "sensor", "sensor a1", parameters={"e": 0.2})
    offset = Step("sensor_offset", "sensor", "sensor a1", parameters={"b": None})
    other = Step("sensor_offset", "sensor", "sensor a2", parameters={"b": 1.0})
    joined = steps._joined(GainError(0.5), first, [offset, other])
    assert (
        joined.values[0] == pytest.approx(1.2 * 1.5 - 1)
        and offset.parameters == {"b": 0.0}
        and other.parameters == {"b": 1.0}
    )
    begin = Step("sensor_offset", "sensor", "sensor a1", parameters={"b": 0.2})
    gain = Step("gain_error", "sensor", "sensor a1", parameters={"e": None})
    assert steps._joined(SensorOffset(0.5), begin, [gain]).values[0] == pytest.approx(0.7)
    gain.parameters = {"e": 0.1}
    assert steps._joined(SensorOffset(0.5), begin, [gain]).values[0] == pytest.approx(0.2 + 0.5 * 1.1)


def test_alternatives_are_listed_if_there_are_tied_ones_or_others():
    for tied, others in (([("iwan", "storey 2", 1.0)], []), ([], [("iwan", "storey 2", 1.0)])):
        step = Step("dahl", "hysteresis", "storey 2", evidence="why", tied=tied, runners_up=others)
        assert markdown._step(1, step)[-2] == f"| iwan | storey 2 | 1 | {'tied' if tied else ''} |"


def test_a_storey_without_a_law_is_scaled_by_its_balance_and_one_at_rest_by_one():
    X, F = np.random.default_rng(0).standard_normal((50, 6)), np.random.default_rng(1).standard_normal((50, 2))
    model = ChainModel([1.0, 2.0], {1: [laws.LinearElastic(3.0)], 2: [laws.LinearElastic(0.0)]})
    found = residual.residual_of(model, from_arrays(X, F, dt=0.01))
    s = X[:, 4]
    assert found.scale == pytest.approx([3 * np.sqrt(np.mean(s**2)), np.sqrt(np.mean(F[:, 1] ** 2))])
    small = residual.residual_of(model, from_arrays(1e-3 * X, 1e-3 * F, dt=0.01))
    assert small.scale == pytest.approx(1e-3 * found.scale)
    assert small.sizes["percent"].to_numpy() == pytest.approx(found.sizes["percent"].to_numpy())
    F[:, 1] = 0.0
    quiet = residual.residual_of(model, from_arrays(X, F, dt=0.01))
    inertia = 2 * np.sqrt(np.mean(X[:, 1] ** 2))
    assert quiet.scale[1] == pytest.approx(inertia) == quiet.sizes.loc["dof 2", "reference"]
    assert quiet.sizes["of"].tolist() == ["F", "m a", "storey force", "storey force"]
    still = residual.residual_of(model, from_arrays(np.zeros((50, 6)), np.zeros((50, 2)), dt=0.01))
    assert still.scale.tolist() == [1.0, 1.0] and still.sizes["percent"].isna().all()
