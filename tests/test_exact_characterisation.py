"""Exact numbers of characterisation: correlations, dependence, couplings, channels that contradict each other."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from hand_made_rooms import motion, noise, residual

from pysindy_nrf.discrepancy import (
    characterisation,
    contradictions,
    coupling,
)
from pysindy_nrf.discrepancy.correlation import probability_of_peak
from pysindy_nrf.discrepancy.coupling import Coupling, couplings
from pysindy_nrf.discrepancy.dependence import Judge, knots_of
from pysindy_nrf.discrepancy.noise_floor import NoiseFloor
from pysindy_nrf.discrepancy.residual import ROUND_OFF
from pysindy_nrf.exceptions import ChannelError, NRFError
from pysindy_nrf.laws import Motion

# -- correlation and columns ------------------------------------------------------------------------


def test_a_height_of_zero_is_exceeded_for_sure_without_a_division_by_zero():
    with np.errstate(all="raise"):
        assert probability_of_peak(0.0, 1, 1.0) == pytest.approx(1.0)
        assert probability_of_peak(0.0, 5, 1.0) == pytest.approx(1.0)


@pytest.mark.parametrize("x, knots", [([10.0, 12.0, 110.0], [10, 60, 110]), ([-50.0, 2.0, 50.0], [-50, 0, 50])])
def test_a_knot_must_lie_farther_off_than_a_fiftieth_of_the_range(x, knots):
    assert knots_of(np.array(x), 3) == pytest.approx(knots)


def test_a_judge_has_a_block_of_every_record_and_five_folds_by_default():
    rng = np.random.default_rng(0)
    force = [rng.standard_normal(1000), rng.standard_normal(5)]
    one = Judge(force, {"a": [np.ones((len(f), 1)) for f in force]})
    assert len(one.grams) == 26 and one.folds.tolist() == [k % 5 for k in range(26)]
    few = Judge([force[0]], {"a": [np.ones((1000, 1))]}, 2)
    assert few.folds.tolist() == [0, 1]
    # of a single block it can be judged on that block alone
    single = Judge([force[1]], {"a": [np.ones((5, 1))]}, 1)
    assert single.share(["a"])[0] == pytest.approx(5 * force[1].mean() ** 2 / (force[1] @ force[1]), rel=1e-6)
    assert np.isnan(single.share(["a"])[1])


# -- coupling ---------------------------------------------------------------------------------------


def test_shares_of_a_coupling_in_percent():
    text = str(Coupling(1, 5.0, 0.9, 0.9, 0.0))
    assert "explain 90 % of that" in text and "storeys 90 % of the rest" in text


class Judges:
    """Stands in for the regressions: shares as given, and a note of what it was asked."""

    def __init__(self, linear=0.1, law=0.2, others=(0.3, 0.01)):
        self.given, self.made, self.beside = {("linear",): linear, ("linear", "law"): law}, [], []
        self.others = others

    def __call__(self, force, groups, n_blocks, n_folds):
        self.made.append((force, groups, n_blocks, n_folds))
        return self

    def share(self, names, beside=None):
        if names == ["others"]:
            self.beside.append(beside)
            return self.others
        return self.given[names], 0.5


def judged(monkeypatch, found, floor=None, **given):
    judges = Judges(**given)
    monkeypatch.setattr(coupling, "Judge", judges)
    return couplings(found, floor), judges


def test_a_storey_is_judged_beside_the_drifts_and_rates_of_all_others(monkeypatch):
    found, judges = judged(monkeypatch, residual(300, 3, lengths=[300, 200]))
    assert sorted(c.storey for c in found) == [1, 2, 3] and [made[2:] for made in judges.made] == [(60, 10)] * 3
    for i, (force, groups, *_) in enumerate(judges.made):
        assert [len(f) for f in force] == [300, 200] and list(groups) == ["linear", "law", "others"]
        rest = [j for j in range(3) if j != i]
        for k, seg in enumerate(residual(300, 3, lengths=[300, 200]).data.segments):
            assert groups["others"][k] == pytest.approx(np.hstack([seg.s[:, rest], seg.v[:, rest]]))
            assert groups["linear"][k] == pytest.approx(np.column_stack([seg.s[:, i], seg.v[:, i]]))


def test_yield_drifts_are_multiples_of_the_rms_drift_or_of_one_where_nothing_moves(monkeypatch):
    scales = []
    monkeypatch.setattr(coupling, "_own", lambda m, scale: scales.append(scale) or np.zeros((m.n_samples, 1)))
    found = residual(300, 2, lengths=[300, 200])
    for seg in found.data.segments:
        seg.s[:, 1] = 0.0
    judged(monkeypatch, found)
    first = np.concatenate([seg.s[:, 0] for seg in found.data.segments])
    assert scales == [pytest.approx(np.sqrt(np.mean(first**2)))] * 2 + [1.0] * 2


def test_records_in_which_a_storey_is_silent_or_unknown_are_left_aside(monkeypatch):
    e = [noise(300)[:, None], np.zeros((200, 1)), np.full((250, 1), np.nan)]
    found, judges = judged(monkeypatch, residual(n_dof=1, lengths=[300, 200, 250], e=e))
    assert [len(f) for f in judges.made[0][0]] == [300] and [c.storey for c in found] == [1]
    assert len(judges.made[0][1]["law"]) == 1 and "others" not in judges.made[0][1]
    nothing = residual(n_dof=1, lengths=[300], e=[np.full((300, 1), np.nan)])
    assert judged(monkeypatch, nothing)[0] == []


def test_a_quiet_storey_does_not_end_the_list_and_one_at_a_threshold_is_quiet(monkeypatch):
    found = residual(300, 3)
    found.sizes.loc["storey 1", "rms"] = ROUND_OFF * found.sizes.loc["storey 1", "reference"]
    assert sorted(c.storey for c in judged(monkeypatch, found)[0]) == [2, 3]
    loud = found.sizes.loc["storey 2", "rms"]
    for storey, listed in (([0.0, loud / 2, 0.0], [3]), ([0.0, np.nan, 0.0], [3]), ([0.0, loud / 2.01, 0.0], [2, 3])):
        floor = NoiseFloor(np.ones(3), np.array(storey), "given")
        assert sorted(c.storey for c in judged(monkeypatch, found, floor)[0]) == listed


@pytest.mark.parametrize(
    "linear, law, own, beside",
    [
        (0.1, 0.3, 0.3, ["linear", "law"]), (0.3, 0.1, 0.3, ["linear"]), (-0.1, 0.0, 0.0, []), (-0.1, -0.2, -0.1, []),
    ],
)  # fmt: skip
def test_columns_that_explain_nothing_are_not_taken_beside_the_others(monkeypatch, linear, law, own, beside):
    found, judges = judged(monkeypatch, residual(300, 2), linear=linear, law=law)
    assert judges.beside == [beside] * 2 and [c.own for c in found] == [own] * 2
    assert [(c.others, c.error) for c in found] == [(0.3, 0.01)] * 2


@pytest.mark.parametrize(
    "own, others, listed",
    [(0.5, 0.0, False), (0.499, 0.0, True), (0.5, 0.3, True), (0.949, 0.3, True), (0.95, 0.3, False)],
)
def test_half_of_a_storey_or_all_but_a_twentieth_must_be_explained(monkeypatch, own, others, listed):
    found, _ = judged(monkeypatch, residual(300, 2), law=own, others=(others, 0.01))
    assert bool(found) == listed


# -- characterisation -------------------------------------------------------------------------------


def work_of(force, m, filters=None, beside=None, channels=None):
    return characterisation._Work.of(force, m, filters, beside, channels)


def test_what_is_asked_begins_with_the_simplest_and_holds_covariates_that_move_in_every_record():
    simple = ["constant", "linear", "s alone", "v alone", "time", "amplitude", "s and v", "path"]
    ramp, still = np.linspace(0, 1, 500), np.full(500, 3.0)
    one = motion(T=ramp, U=ramp, K=still, L=still)
    two = motion(seed=1, T=ramp, K=still, L=ramp)
    both = work_of([noise(500), noise(500, 1)], [one, two])
    held = [k for k in both.names if k.startswith("covariate ")]
    assert held == ["covariate T", "covariate L"] and [k for k in both.names if k not in held] == simple
    assert list(both.names)[4:6] == held
    timeless = work_of(noise(500), Motion(one.s, one.v))
    assert list(timeless.names) == [k for k in simple if k != "time"] and np.isnan(timeless.frequency)
    late = work_of(noise(500), one, channels={"F1": noise(500, 3)})
    assert list(late.names)[2] == "delay" and late.judge.at["delay"].size == 1
    assert work_of(noise(500), motion(a=True)).judge.at["delay"].size == 1
    assert work_of(noise(500), motion(a=True), channels={"F1": noise(500, 3)}).judge.at["delay"].size == 2
    tone = work_of(noise(500) + 9 * np.cos(2 * np.pi * 8.0 * one.t), one)
    assert list(tone.names)[2] == "line" and tone.frequency == pytest.approx(8.0, abs=0.05)


def test_forces_come_as_one_array_a_list_or_rows_and_what_goes_beside_them_with_each():
    one, two = motion(), motion(seed=1)
    rows = work_of(np.array([noise(500), noise(500, 1)]), [one, two])
    assert [f.tolist() for f in rows.force] == [noise(500).tolist(), noise(500, 1).tolist()]
    single = work_of([noise(500)], [one], beside=noise(500, 2)[:, None])
    assert single.base == ["constant", "linear", "beside"] and single.judge.at["beside"].size == 1

    class Half:
        def apply(self, columns):
            return columns / 2

    part = work_of([noise(500), np.full(500, np.nan)], [one, two], Half(), [np.ones((500, 2)), np.ones((500, 2))])
    assert len(part.filters) == len(part.motions) == 1 and part.judge.at["beside"].size == 2
    assert part.judge.size[part.judge.at["constant"][0]] == pytest.approx(np.sqrt(500 / 4))
    with pytest.raises(ChannelError, match="differ in length"):
        work_of([noise(500)], [one, two])
    for force in ([np.full(500, np.nan)], [np.full(500, np.inf)]):
        with pytest.raises(ChannelError, match="not finite"):
            work_of(force, [one])
    with pytest.raises(ChannelError, match="not finite"):
        work_of([np.full(500, np.nan), np.where(np.arange(500) < 3, np.nan, 1.0)], [one, two])


def test_the_force_is_drawn_over_every_variable():
    ramp = np.linspace(0, 1, 500)
    force = noise(500)
    curves = work_of(force, motion(T=ramp)).curves()
    assert sorted(curves) == ["amplitude", "covariate T", "s", "t", "v"]
    bins = np.split(np.arange(500), np.linspace(0, 500, 31).astype(int)[1:-1])
    assert curves["covariate T"]["centre"].tolist() == pytest.approx([ramp[k].mean() for k in bins])
    assert curves["t"]["mean"].tolist() == pytest.approx([force[k].mean() for k in bins])
    m = motion()
    assert sorted(work_of(force, Motion(m.s, m.v)).curves()) == ["amplitude", "s", "v"]


def test_a_kink_is_told_instead_of_a_bend_and_a_jump_of_the_rate_alone(monkeypatch):
    one = work_of(noise(500), motion())
    one.rms = 1.0
    monkeypatch.setattr(one, "_has_kink", lambda: True)
    assert one._marks("s", {}) == ["kink"]
    monkeypatch.setattr(one, "_has_kink", lambda: False)
    for word in ("hardening", ""):
        monkeypatch.setattr(one, "_bend", lambda c, word=word: word if len(c) == 4 else "wrong")
        assert one._marks("s", {}) == [word] * bool(word)
    assert one._marks("v", {"v": np.array([-0.31])}) == ["jump at v = 0"]
    assert one._marks("v", {"v": np.array([0.3 * one.rms])}) == []
    for group in ("surface", "path"):
        assert one._marks(group, {group: np.array([9.0])}) == []
    assert one._marks("amplitude", {}) == one._marks("time", {}) == []


def test_the_odd_share_of_a_surface_is_asked_of_all_its_columns():
    """v s^2 is odd under (s, v) -> (-s, -v), s v is even."""
    m = motion(3000)
    odd, even = m.v * m.s**2, m.s * m.v
    for dependence_, force, share in (("s and v", odd, 1.0), ("s and v", even, 0.0), ("path", odd, 1.0)):
        assert work_of(force, m).shape_of(dependence_)[0] == pytest.approx(share, abs=0.02)
    assert np.isnan(work_of(odd, m).shape_of("delay")[0]) and work_of(odd, m).shape_of("line") == (
        pytest.approx(np.nan, nan_ok=True), []
    )  # fmt: skip


def test_a_mirrored_motion_has_its_acceleration_mirrored_and_what_goes_beside_is_no_part_of_the_function(monkeypatch):
    m = motion(a=True)
    one = work_of(noise(500), m, beside=noise(500, 2)[:, None])
    held = {"constant": np.array([3.0]), "linear": np.array([2.0, -1.0, 0.5])}
    for sign in (1.0, -1.0):
        wanted = 3.0 + sign * (2.0 * m.s - m.v + 0.5 * m.a)
        assert one._value(["constant", "linear"], held, sign) == pytest.approx(wanted)
    asked = []
    monkeypatch.setattr(one, "_value", lambda names, coefficients, sign: asked.append((names, sign)) or np.zeros(5))
    assert np.isnan(one.shape_of("amplitude")[0])  # a function of nothing is neither odd nor even
    names = ["constant", "linear", "amplitude"]
    assert asked == [(names, 1.0), (names, -1.0)]
    values = iter([np.array([3.0, 1.0]), np.array([-1.0, 1.0])])  # differences 4, 0; sums 2, 2
    monkeypatch.setattr(one, "_value", lambda *a: next(values))
    assert one.shape_of("linear")[0] == pytest.approx(16 / 24)


@pytest.mark.parametrize("line, told", [(1, False), (2, True), (398, True), (399, False), (400, False)])
def test_the_three_frequencies_at_either_end_are_no_lines(line, told):
    """A Hann window shows a line at three neighbouring frequencies; the fourth from the end may stand out."""
    n, fs = 800, 100.0
    t = np.arange(n) / fs
    e = np.cos(2 * np.pi * line * fs / n * t + 1.0) + 0.1 * noise(n)
    assert np.isfinite(characterisation.spectral_line([e], [Motion(t, t, t=t)])) == told


def test_a_force_is_drawn_in_thirty_bins():
    assert len(characterisation.conditional_mean(noise(300), noise(300, 1))) == 30


def fitted(monkeypatch, **shares):
    """Characterise with shares as given, simplest first."""
    given = {"constant": 0.0, "linear": 0.0, "s alone": 0.0, "s and v": 0.0, "path": 0.0} | shares

    def share(columns):
        return given["constant" if columns == ["constant"] else columns[-1] if len(columns) > 2 else "linear"], 0.0

    one = SimpleNamespace(judge=SimpleNamespace(share=share), base=["constant", "linear"], frequency=1.0, rms=1.0)
    one.names = {k: [] if k in ("constant", "linear") else [k] for k in given}
    one.shape_of, one.curves = lambda d: (0.5, []), dict
    monkeypatch.setattr(characterisation._Work, "of", lambda *a: one)
    return characterisation.characterise(None, None)


def test_what_is_just_enough_is_enough(monkeypatch):
    assert fitted(monkeypatch, path=0.15).dependence == "path"  # 15 %
    assert fitted(monkeypatch, path=0.9, **{"s alone": 0.86}).dependence == "s alone"  # 4 points less
    assert fitted(monkeypatch, path=0.5, **{"s alone": 0.471}).dependence == "s alone"  # three quarters of 4 points
    assert fitted(monkeypatch, path=0.5, **{"s alone": 0.469}).dependence == "path"


@pytest.mark.parametrize("odd, word", [(0.9, "neither odd nor even"), (0.1, "neither odd nor even"), (0.0, "even")])
def test_parity_is_told_beyond_nine_tenths(odd, word):
    table = pd.DataFrame({"share": [80.0]}, index=["s alone"])
    found = characterisation.Characterisation(table, "s alone", 0.0, odd, np.nan, [])
    assert characterisation._sentence(found, None, 1.0) == (
        f"Depends on s alone, {word}, smooth: a nonlinear spring; 80 % explained on data left out."
    )
    assert "noise is 81 %." in characterisation._sentence(found, 0.9, 1.0)


# -- contradictions ---------------------------------------------------------------------------------


def alignment(**rows):
    base = dict(reference="a1", delay=0.0, gain=1.0, sign=1.0, coherence=1.0, aligned=False, message="m")
    return pd.DataFrame.from_dict({k: base | r for k, r in rows.items()}, orient="index")


def suspects(monkeypatch, *tables):
    """What the channels say if they are compared as a whole and in both halves as given."""
    given = iter(tables)
    monkeypatch.setattr(contradictions, "channel_alignment", lambda record, runs: next(given))
    monkeypatch.setattr(contradictions, "_halves", lambda runs: [runs, runs])
    monkeypatch.setattr(contradictions, "_runs", lambda work: (0, []))
    monkeypatch.setattr(contradictions, "pace", lambda work, dof: 10.0 * dof)
    ready = SimpleNamespace(contradictions=None, records=[None])
    found = contradictions.contradictory(ready, None)
    assert ready.contradictions is found and contradictions.contradictory(ready, None) is found  # looked for once
    return found


def test_channels_that_cannot_be_compared_tell_nothing():
    def refuse(work):
        raise NRFError("x", "y")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(contradictions, "_runs", refuse)
        ready = SimpleNamespace(contradictions=None, records=[])
        assert contradictions.contradictory(ready, None) == [] == ready.contradictions


def test_a_channel_in_order_does_not_end_the_comparison(monkeypatch):
    table = alignment(v1={"gain": 2.0, "aligned": True}, x1={"gain": np.nan}, x2={"gain": 1.5, "delay": 0.01})
    found = suspects(monkeypatch, table, table, table)
    assert [(round(size, 9), s.law.name, str(s.site)) for size, s in found] == [
        (0.5, "gain_error", "sensor x2"), (0.5, "gain_error", "sensor a1"),
        (0.2, "channel_delay", "sensor x2"), (0.2, "channel_delay", "sensor a1"),  # 10 ms at 20 / s
    ]  # fmt: skip


@pytest.mark.parametrize("size, seen", [(0.02, 2), (0.0199, 0)])
def test_a_fiftieth_of_a_channel_is_looked_into(monkeypatch, size, seen):
    monkeypatch.setattr(contradictions, "_beyond_noise", lambda gain, coherence: size)
    table = alignment(x1={"gain": 1.5})
    assert len(suspects(monkeypatch, table, table, table)) == seen


@pytest.mark.parametrize("gains, seen", [((0.8, 1.0), 2), ((1.0, 1.2), 2), ((0.8, 1.2), 0), ((1.0, 1.0), 2)])
def test_a_half_that_shows_nothing_denies_nothing(monkeypatch, gains, seen):
    tables = [alignment(x1={"gain": g}) for g in (1.5, *gains)]
    assert len(suspects(monkeypatch, *tables)) == seen
    tables = [alignment(x1={"delay": g - 1.0}) for g in (1.5, *gains)]
    assert len(suspects(monkeypatch, *tables)) == seen
