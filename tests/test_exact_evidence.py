"""Exact numbers of detection, and the sentences of the evidence."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from hand_made_rooms import noise, residual, workspace
from scipy.signal import welch

from pysindy_nrf import ChainModel, Site, laws
from pysindy_nrf.discrepancy import (
    detection,
    evidence,
)
from pysindy_nrf.discrepancy.correlation import Cross, peak_limit, probability_of_peak
from pysindy_nrf.discrepancy.coupling import Coupling
from pysindy_nrf.discrepancy.detection import LINEAR, NOISE, NONLINEAR, UNMEASURED, Detection, detect
from pysindy_nrf.discrepancy.evidence import Evidence
from pysindy_nrf.discrepancy.noise_floor import AT_FLOOR, BELOW_FLOOR, LOUD, NoiseFloor
from pysindy_nrf.discrepancy.residual import ROUND_OFF
from pysindy_nrf.exceptions import NRFError

# -- detection --------------------------------------------------------------------------------------


def place(level=0.05, min_share=0.02, **more):
    """A place of tests without data."""
    one = detection._Place.__new__(detection._Place)
    one.where, one.level, one.min_share, one.rows, one.curves, one.steps = "dof 1", level, min_share, [], {}, [0.5]
    for name, value in more.items():
        setattr(one, name, value)
    return one


@pytest.mark.parametrize(
    "rms, tests_say, verdict",
    [
        (LOUD, NOISE, NOISE), (BELOW_FLOOR, NONLINEAR, NONLINEAR), (AT_FLOOR, UNMEASURED, UNMEASURED),
        (ROUND_OFF, NONLINEAR, NOISE), (LOUD * 1.01, NOISE, LINEAR),
    ],
)  # fmt: skip
def test_verdicts_exactly_at_the_thresholds(monkeypatch, rms, tests_say, verdict):
    found = residual(300, n_dof=1)
    found.sizes["rms"], found.sizes["reference"] = [np.nan, rms], 1.0  # a balance that is not known does not end it
    asked = []
    fake = SimpleNamespace(loudest=1.0, rows=[], curves={}, judge=lambda: {"verdict": tests_say})
    fake.likeliest = lambda verdict: LINEAR
    monkeypatch.setattr(detection, "_Place", lambda *a: asked.append(a) or fake)
    floor = NoiseFloor.given(1.0 if rms > 0.1 else 0.0, 1)
    told = detect(found, floor)
    assert told.verdicts["verdict"].to_dict() == {"storey 1": verdict} and told.level == 0.05
    # a false alarm in twenty, lags of its own, a fiftieth of the variance; as many views as draws and one
    assert [(a[0], len(a[1]), *a[2:]) for a in asked] == ([("storey 1", 1, 0.05, None, 0.02)] if rms > 0.1 else [])
    if rms > 0.1:
        detect(found, replace(floor, draws=[(found, found.data)] * 2), level=0.1, lags=7, min_share=0.3)
        assert [(a[0], len(a[1]), *a[2:]) for a in asked[1:]] == [("storey 1", 3, 0.1, 7, 0.3)]
    with pytest.raises(NRFError, match="not a residual"):
        detect(found.data)


@pytest.mark.parametrize("worth, taps", [(30.0, 1), (1e5, 4), (3.0, 0)])
def test_a_record_without_forces_has_a_basis_of_its_motion(worth, taps):
    found = residual(900, forced=False)
    columns, pad = detection._View(found, found.data).basis([0], 7, worth, 1)
    assert pad == 7 * taps and columns.shape == (900 - 2 * pad, 5)


def test_the_shortest_record_bounds_the_shifts_and_every_record_is_thinned():
    found = residual(lengths=[900, 200])
    view = detection._View(found, found.data)
    columns, pad = view.basis([0, 1], 7, 1e6, 3)
    assert pad == 7 * 2 and len(columns) == len(range(0, 900 - 28, 3)) + len(range(0, 200 - 28, 3))
    assert view.basis([0, 1], 7, 1.0, 1)[0] is columns  # made once
    assert view.basis([0], 7, 1e6, 3)[1] == 7 * 4 and view.basis([1], 7, 1e6, 3)[1] == 7 * 2


def test_a_channel_must_be_there_in_every_record():
    base = noise(300, 3)
    one = residual(300, 1, covariates={"T": noise(300), "U": noise(300)}, base_acceleration=base).data.segments[0]
    two = residual(200, 1, covariates={"T": noise(200, 1)}).data.segments[0]

    def names(*segments):
        return [name for name, _ in detection._inputs(list(segments))]

    assert names(one) == ["F1", "ag", "T", "U"] and names(one, two) == names(two, one) == ["F1", "T"]
    assert names(one, one) == names(one)
    two.F[:] = 0.0
    assert names(two, one)[0] == "F1" and names(two) == ["T"]
    parts = dict(detection._inputs([one, two]))["T"]
    assert [len(p) for p in parts] == [300, 200] and parts[1] == pytest.approx(noise(200, 1))


def cross(*total, spread=1.0, energy=10.0):
    return [Cross(np.arange(-1, 2), np.array(total, dtype=float), spread, energy, 1.0)]


def test_a_family_of_one_test_keeps_its_probability_and_an_empty_one_is_noise():
    one = place(draws=0, _crosses=lambda kind, name: cross(0.5, -4.5, 1.0))
    p, strong = one._family([("phi_xe", "xe", "F1")])
    assert p == one.rows[0]["p"] == pytest.approx(probability_of_peak(4.5, 3, 1.0))
    assert one.rows[0]["band"] == pytest.approx(peak_limit(0.05 / 3, 3, 1.0) / 10) and strong == pytest.approx(0.2025)
    assert one._family([]) == (1.0, 0.0)
    low = place(draws=0, _crosses=lambda kind, name: cross(0.1, 0.3, 0.2))
    assert low._family([("phi_xe", "xe", name) for name in "abc"]) == (1.0, 0.0)


def test_without_a_time_step_lags_are_samples_and_a_correlation_is_one_at_most():
    one = place(draws=0, steps=[None], _crosses=lambda kind, name: cross(0.5, 1.0, -12.0))
    assert one._family([("phi_xe", "xe", "F1")])[1] == 1.0
    assert one.rows[0]["lag"] == 1.0 and one.rows[0]["peak"] == -1.0
    assert one.curves["dof 1", "phi_xe", "F1"][0].tolist() == [-1, 0, 1]
    other = place(draws=0, _crosses=lambda kind, name: cross(0.5, 1.0, 12.0))
    assert other._family([("phi_xe", "xe", "F1")])[1] == 1.0


@pytest.mark.parametrize("phi, share", [(0.9, 1.0), (-0.9, 1.0), (0.0, 0.0)])
def test_whiteness_is_clipped_to_what_a_correlation_can_be(monkeypatch, phi, share):
    monkeypatch.setattr(detection, "_reference", lambda side, noise: None)
    monkeypatch.setattr(detection, "_fit", lambda density, parts: None)
    monkeypatch.setattr(
        detection, "whitened_autocorrelation", lambda whole, density, lags: (np.full(lags, whole[0]), 400)
    )
    sides = [SimpleNamespace(whole=[phi]), SimpleNamespace(whole=[-phi])]
    one = place(sides=sides, draws=1)
    p, found = one._whiteness()
    assert found == share and one.curves["dof 1", "phi_ee", "e"][1] == pytest.approx(np.full(20, np.sign(phi)))
    assert p == pytest.approx(0.0 if phi else 1.0, abs=1e-9) and one.rows[0]["outside"] == (phi != 0)
    alone = place(sides=sides[:1], draws=0)._whiteness()
    assert alone == (pytest.approx(0.0 if phi else 1.0, abs=1e-9), share)


def test_excess_of_nothing_is_measured_in_newtons():
    sides = [SimpleNamespace(linear_share=s, size=z) for s, z in ((0.0, 0.0), (0.5, 4.0))]
    assert place(sides=sides)._excess() == -2.0


@pytest.mark.parametrize("family", range(3))
def test_a_family_exactly_at_its_third_of_the_level_is_noise(family):
    ps, side = [1.0] * 3, SimpleNamespace(raw={"F1": 0, "s": 0}, linear_share=0.3)
    for p, found in ((0.25, NOISE), (0.2499, (UNMEASURED, LINEAR, NONLINEAR)[family])):
        ps[family] = p
        one = place(0.75, 0.1, sides=[side], _whiteness=lambda: (ps[0], 0.5), _excess=lambda: 0.5)
        one._family = lambda tests: (ps[1], 0.5) if len(tests) == 2 else (ps[2], 0.5)
        assert one.judge()["verdict"] == found


@pytest.mark.parametrize("size", [0.8, 0.3])
def test_a_tone_is_worth_two_samples_for_every_column(size):
    """Two tones have four degrees of freedom; so many columns as half of what it is worth explain half of anything."""
    n = 4000
    found = residual(n, 1, seed=3)
    tones = [np.sqrt(2) * np.cos(2 * np.pi * k / n * np.arange(n)) for k in (190, 310)]
    found.data.segments[0].s[:, 0] = tones[0]
    e = np.sqrt(size) * tones[0] + np.sqrt(1 - size) * tones[1]
    found = found.with_balance([e[:, None]])
    one = detection._Side(detection._View(found, found.data), "dof 1", 5, 1)
    assert one._basis.shape == (n, 4) and n * one.bandwidth < 8  # a constant, drift, rate and force
    explained = 1 - one.rest[0] @ one.rest[0] / one.size
    assert explained == pytest.approx(size, abs=0.01)
    assert one.linear_share == pytest.approx(max((explained - 0.5) / 0.5, 0.0))


def test_a_residual_of_nothing_and_a_signal_that_rests_are_not_divided_by():
    found = residual(300, 1).with_balance([np.zeros((300, 1))])
    with np.errstate(all="raise"):
        one = detection._Side(detection._View(found, found.data), "dof 1", 5, 1)
        assert one.linear_share == 0.0 and one.size == 0.0
        one.raw["still"] = [np.zeros(300)]
        got = one.cross("x2e", "still", 5)
    assert got.spread == 0.0 and not got.moves and not got.total.any()


def test_the_reference_spectrum_is_welchs_of_pieces_of_512():
    whole = noise(2048)
    density = detection._reference(SimpleNamespace(whole=[np.zeros(512)]), [SimpleNamespace(whole=[whole])])
    assert density[0] == pytest.approx(welch(whole, nperseg=512)[1]) and len(density[0]) == 257
    assert detection._response(SimpleNamespace(sos=None), 7).tolist() == [1.0] * 4
    assert detection._as_normal(1e300, 9.0) == 37.0


def test_the_sentence_names_a_test_of_the_kind_of_the_verdict():
    names = ["where", "test", "signal", "peak", "lag", "band", "p", "outside"]
    every = [
        ("phi_ee", "e", 0.4, 0, 0.1, 1e-3, True), ("phi_xe", "F1", 0.25, 0, 0.1, 1e-6, True),
        ("phi_x2e", "s", 0.75, 0, 0.1, 1e-9, True),
    ]  # fmt: skip
    tests = pd.DataFrame([(f"dof {j}", *row) for j in (1, 2, 3) for row in every], columns=names)
    table = pd.DataFrame({"verdict": [UNMEASURED, LINEAR, NONLINEAR], "floor ratio": np.nan}, index=tests["where"][::3])
    assert Detection(table, tests, 0.05).sentence == (
        f"dof 1: {UNMEASURED} (phi_ee, e: 0.40, band 0.10); dof 2: {LINEAR} (phi_xe, F1: 0.25, band 0.10); "
        f"dof 3: {NONLINEAR} (phi_x2e, s: 0.75, band 0.10)."
    )


# -- evidence ---------------------------------------------------------------------------------------


def test_what_is_not_noise_is_listed_by_kind_and_place():
    kinds = [UNMEASURED, NONLINEAR, NOISE, LINEAR, NONLINEAR, NONLINEAR]
    where = ["dof 1", "dof 2", "dof 3", "storey 1", "storey 2", "dof 4"]
    table = pd.DataFrame({"verdict": kinds, "floor ratio": [1.0, 2.345, np.nan, 0.5, 1.5, 1.0]}, index=where)
    tests = pd.DataFrame(columns=["where", "test", "signal", "peak", "band", "outside"])
    seen = Evidence("x", detection=SimpleNamespace(verdicts=table, tests=tests, is_noise=False))
    assert seen.strongest is None and seen.detection_sentence == (
        f"The residual is not noise: {UNMEASURED} in the balance of DOF 1; {NONLINEAR} in the balance of DOF 2, 4 and "
        f"storey 2; {LINEAR} in storey 1 (at most 2.3 times the noise floor)."
    )
    seen.detection.is_noise = True
    assert seen.detection_sentence.endswith("in any balance (at most 2.3 times the noise floor).")
    assert evidence._name("storey 2") == "storey 2" and Evidence("x").strongest is None


@pytest.mark.parametrize("strongest", ["phi_e(ex)", "phi_xe", "phi_|x||e|", "phi_x2e"])
def test_any_test_of_a_signal_may_be_the_strongest(strongest):
    rows = [(name, 0.6 if name == strongest else -0.5, 0.1, True) for name in ("phi_e(ex)", "phi_x2e", "phi_|x||e|")]
    rows += [("phi_ee", 0.9, 0.1, True), ("phi_xe", -0.6 if strongest == "phi_xe" else 0.5, 0.1, True)]
    tests = pd.DataFrame(rows, columns=["test", "peak", "band", "outside"])
    assert Evidence("x", detection=SimpleNamespace(tests=tests)).strongest["test"] == strongest


def located(shares, verdict="explains much", **more):
    names = ["storey 2", "storey 3", "dof 1", "ground 2"][: len(shares)]
    table = pd.DataFrame({"share": shares, "high": shares, "low": shares, "verdict": verdict}, index=names)
    table["balances"] = ["a", "b", "c", "d"][: len(shares)]
    options = {"site": "storey 2", "chosen": "storey 3"} | more
    return Evidence("x", localisation=table, **options)


def test_where_it_acts_in_words():
    one = located([90.0, 50.0], chosen="")
    assert one.localisation_sentence == "The signs across the balances point to storey 2: explains much."
    assert one.agreement == located([np.nan, np.nan]).agreement == Evidence("x", chosen="dof 1").agreement == ""
    floor = located([90.0, 50.0], "all leave what the noise floor leaves", chosen="")
    assert floor.localisation_sentence == "All leave what the noise floor leaves."
    same = located([90.0, 90.0, np.nan], "one balance: the signs say nothing")
    chosen = "The loop chose storey 3 by the error after refitting."
    assert same.localisation_sentence == f"One balance: the signs say nothing. {chosen}"
    assert located([90.0, 50.0], chosen="storey 2").agreement == "The loop chose the same site, storey 2."
    judge_not = "The loop chose {}, which localisation cannot judge."
    assert located([90.0, 50.0], chosen="dof 3").agreement == judge_not.format("dof 3")
    assert located([90.0, np.nan, 50.0]).agreement == judge_not.format("storey 3")
    alike = located([90.0, 89.0, 50.0])
    alike.localisation["balances"] = "a"
    assert alike.agreement == "The loop chose storey 3, which has the same pattern of signs."
    assert "number 3." in located([90.0, 80.0, 70.0, 60.0], chosen="dof 1").agreement
    assert "number 2." in located([90.0, 90.0, 70.0, 60.0], chosen="dof 1").agreement  # two sites of one pattern
    assert "(85 %) first, and storey 2 in" in located([90.0, 85.4], later=("dof 1", "storey 2")).agreement


@pytest.mark.parametrize("share, high, near", [(85.0, 0.0, False), (85.1, 0.0, True), (50.0, 90.0, False)])
def test_what_is_five_points_less_or_only_touches_the_band_is_told(share, high, near):
    one = located([90.0, share])
    one.localisation.loc["storey 3", "high"] = high
    assert ("hardly tells" in one.agreement) == near and ("disagrees" in one.agreement) != near


def test_what_it_is_like_and_what_no_chain_explains_in_words():
    one = Evidence("x", site="storey 2", characterisation=SimpleNamespace(sentence="Depends on v. So."))
    assert one.characterisation_sentence == "The force missing at storey 2 depends on v. So."
    assert one.coupling_sentence == ""
    one.couplings = [Coupling(1, 5.0, 0.1, 0.0, 0.0), Coupling(2, 5.0, 0.1, 0.0, 0.0)]
    assert one.coupling_sentence == f"Not explained by a chain law: {one.couplings[0]}; {one.couplings[1]}"
    silent = "is not possible because nothing was tried."
    assert str(Evidence("x")).split("\n") == [
        f"{room} {silent}" for room in ("Detection", "Localisation", "Characterisation")
    ]
    why = Evidence("x", not_possible={"localisation": "it is dark."}).localisation_sentence
    assert why == "Localisation is not possible because it is dark."


class Rooms:
    """The rooms as they would be entered, each with an answer or an error of its own."""

    def __init__(self, patch, **answers):
        table = pd.DataFrame({"share": [9.0], "verdict": ["much"]}, index=["storey 2"])
        self.given = {
            "searched_residual": SimpleNamespace(sizes="sizes"), "_floor": NoiseFloor(np.ones(2), np.ones(2), "s", [1]),
            "detect": SimpleNamespace(is_noise=False), "localise": table, "_characterised": "like", "couplings": ["c"],
        } | answers  # fmt: skip
        self.entered = []
        for name in self.given:
            patch.setattr(evidence, name, lambda *a, name=name, **k: self.enter(name, a, k))

    def enter(self, name, arguments, options):
        self.entered.append((name, arguments, options))
        answer = self.given[name]
        if isinstance(answer, Exception):
            raise answer
        return answer


def looked(patch, noise=(), chosen="", floor=None, **answers):
    rooms = Rooms(patch, **answers)
    return evidence.look(SimpleNamespace(known_masses={1: 2.0}), "model", "m", noise, chosen, floor), rooms


def test_the_rooms_are_entered_one_by_one(monkeypatch):
    found, rooms = looked(monkeypatch, ["surrogate"])
    assert [name for name, *_ in rooms.entered] == [
        "searched_residual", "_floor", "detect", "localise", "_characterised", "couplings"
    ]  # fmt: skip
    assert (found.model, found.sizes, found.site, found.characterisation) == ("m", "sizes", "storey 2", "like")
    assert found.couplings == ["c"] and found.floor.draws == [] and found.not_possible == {}
    given = NoiseFloor(np.ones(2), np.ones(2), "given", [2])
    found, rooms = looked(monkeypatch, ["surrogate"], floor=given)
    assert "_floor" not in [name for name, *_ in rooms.entered] and found.floor.source == "given" and given.draws == [2]
    assert rooms.entered[1][1][1] is given and rooms.entered[2][2] == {"floor": given, "known_masses": {1: 2.0}}
    found, rooms = looked(monkeypatch, ["surrogate"], chosen="storey 1")
    assert found.couplings == [] and found.floor is not None and found.chosen == "storey 1"
    found, rooms = looked(monkeypatch)
    assert found.floor is None and [name for name, *_ in rooms.entered][1:] == ["detect", "localise", "_characterised"]


def test_a_closed_room_says_why(monkeypatch):
    found, rooms = looked(monkeypatch, searched_residual=NRFError("it is dark", "make light"))
    assert set(found.not_possible) == {"residual", "detection", "localisation", "characterisation"}
    assert set(found.not_possible.values()) == {"it is dark"} and len(rooms.entered) == 1
    found, _ = looked(monkeypatch, localise=ValueError("no"))
    assert found.not_possible["characterisation"] == "the site is not known: ValueError: no" and found.site == ""
    found, _ = looked(monkeypatch, detect=SimpleNamespace(is_noise=True))
    assert found.not_possible["characterisation"] == "nothing but noise is left" and found.characterisation is None
    found, _ = looked(monkeypatch, detect=KeyError("k"))
    assert found.characterisation == "like" and found.not_possible == {"detection": "KeyError: 'k'"}
    table = pd.DataFrame({"share": [9.0], "verdict": ["at the noise floor"]}, index=["dof 1"])
    found, _ = looked(monkeypatch, localise=table)
    assert found.not_possible["characterisation"] == "the residual is at the noise floor" and found.site == "dof 1"
    found, _ = looked(monkeypatch, ["surrogate"], couplings=ZeroDivisionError("0"))
    assert found.couplings == [] and found.not_possible["coupling"] == "ZeroDivisionError: 0"
    found, _ = looked(monkeypatch, ["surrogate"], _floor=NRFError("no floor", ""))
    assert found.floor is None and found.not_possible == {"noise floor": "no floor"}
    with pytest.raises(TypeError):  # a fault of the program is not hidden
        looked(monkeypatch, detect=TypeError("t"))


def test_a_part_of_exactly_a_quarter_of_the_longest_is_looked_at():
    for stop, kept in ((237, 3), (236, 2)):
        work = workspace(blocks=[(0, 0, 100), (0, 100, 148), (0, 200, stop), (1, 5, 80)])
        data, filters = evidence.searched(work)
        assert len(data.segments) == len(filters) == kept and data.segments[0].valid == slice(0, 148)
    few, _ = evidence.searched(workspace(), 55)  # a fifth of 275
    assert [s.valid for s in few.segments] == [slice(0, 30), slice(200, 210), slice(5, 20)]


def test_a_law_that_remembers_follows_the_record_from_its_start():
    work = workspace(first=4)
    slider = laws.Jenkins(uy=0.8, Fy=2.0)
    held = {2: [laws.LinearElastic(1.0)]}
    found = evidence.searched_residual(work, ChainModel([1.0, 1.0], {1: [slider], **held}))
    assert [s.valid for s in found.data.segments] == [slice(4, 154), slice(204, 254), slice(9, 84)]
    plain = evidence.searched_residual(work, ChainModel([1.0, 1.0], held))
    for part, other, seg, k in zip(found.balance, plain.balance, found.data.segments, (0, 0, 1)):
        record = work.data.segments[k]
        force = slider.force(record.motion(Site(1), record.valid))[seg.valid.start - 4 : seg.valid.stop - 4]
        assert other[:, 0] - part[:, 0] == pytest.approx(force) and part[:, 1] == pytest.approx(other[:, 1])


def test_the_floor_of_surrogates_is_made_of_their_residuals(monkeypatch):
    monkeypatch.setattr(evidence, "searched_residual", lambda work, model: residual(50, seed=work + model))
    stages = [SimpleNamespace(work=k, trial=lambda: SimpleNamespace(model=lambda: 10)) for k in (1, 2)]
    floor = evidence._floor(stages)
    assert len(floor.draws) == 2 and floor.draws[1][0].data is floor.draws[1][1]
    every = np.concatenate([residual(50, seed=10 + k).balance[0] for k in (1, 2)])
    assert floor.balance == pytest.approx(np.sqrt((every**2).mean(axis=0)))


@pytest.mark.parametrize(
    "site, seen, late",
    [
        ("storey 2", "storey 2", ["F1", "F2"]), ("storey 1", "storey 1", ["F1"]), ("dof 2", "dof 2", ["F2"]),
        ("link 3-1", "link 3-1", ["F1"]), ("sensor a2", "dof 2", ["F2"]), ("dof 3", "dof 3", []),
    ],
)  # fmt: skip
def test_the_forces_beside_a_site_may_be_late(monkeypatch, site, seen, late):
    """Of three floors, the third with a force that is nowhere known."""
    found = residual(300, 3)
    seg = found.data.segments[0]
    seg.F[:, 2] = np.nan
    asked = {}

    def missing(residual, place, **options):
        asked.update(options, place=str(place))
        return ["force"], [np.zeros((300, asked["width"]))]

    monkeypatch.setattr(evidence, "missing_force", missing)
    monkeypatch.setattr(evidence, "characterise", lambda force, motions, **more: (force, motions, more))
    floor = NoiseFloor(np.array([1.0, 2.0, 3.0]), np.array([4.0, np.nan, 6.0]), "given")
    for width in (0, 2):
        asked["width"] = width
        force, motions, more = evidence._characterised(found, site, {"floor": floor, "known_masses": {1: 2.0}})
        assert force == ["force"] and asked["place"] == site and asked["known_masses"] == {1: 2.0}
        assert motions[0].s == pytest.approx(seg.motion(Site(seen), seg.valid).s)
        assert (more["beside"] is None) == (width == 0) and more["filters"] == found.filters
        assert sorted(more["channels"]) == late
        for name, (line,) in more["channels"].items():
            assert line == pytest.approx(seg.F[:, int(name[1]) - 1])
    levels = {"storey 2": None, "storey 1": 4.0, "dof 2": 2.0, "link 3-1": 3.0, "sensor a2": 2.0, "dof 3": 3.0}
    assert more["noise"] == levels[site]
    assert evidence._characterised(found, site, {"floor": None})[2]["noise"] is None
