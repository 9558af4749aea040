"""Guidance names the true limit, and plans agree with what can be identified."""

import functools
import warnings

import integrated
import numpy as np
import pytest
from chains import driven

from pysindy_nrf import (
    Chain,
    ChainModel,
    NRFRegressor,
    Record,
    excitation,
    laws,
    simulate,
)
from pysindy_nrf.exceptions import ChainError
from pysindy_nrf.simulation.noise import add_noise

STOREY = laws.PowerSeries(1, [25.0, 1.4e5])


def record(truth, dofs=(3,), noise=0.0):
    F = excitation.band_limited_random(
        truth.n_dof,
        8.0,
        1000.0,
        excited=list(dofs),
        rms=100.0,
        band=(0.5, 60.0),
        random_state=0,
    )
    return add_noise(simulate(truth, F, 1e-3, hold="cubic"), noise, random_state=1)


def diagnosis(rec, **options):
    with warnings.catch_warnings(action="ignore"):
        return (
            NRFRegressor(**{"degree": 1, "dt": 1e-3, **options})
            .fit(*rec.to_features(smooth=False))
            .diagnose()
        )


def test_noise_is_named_with_its_channel_and_the_bias_it_brings():
    truth = ChainModel([12.4] * 4, {f"storey {i}": STOREY for i in range(1, 5)})
    rec = record(truth, noise=0.05)
    table = diagnosis(rec).table
    assert (
        table["limit"][0] == "noise"
        and "low" in table["message"][0]
        and "iv" in table["message"][0]
    )
    with warnings.catch_warnings(action="ignore"):
        raw = NRFRegressor(degree=1).fit(*rec.to_features(smooth=False))
    true_bias = 1 - raw.masses_[2] / 12.4
    expected = table.loc[
        (table["limit"] == "noise") & (table["where"] == "m3"), "size"
    ].item()
    assert (
        0.3 * true_bias < expected < 1.2 * true_bias
        and diagnosis(record(truth)).table.empty
    )


@pytest.mark.parametrize("top", [0.5, 0.6])
def test_motion_near_half_the_rate_is_not_taken_for_noise(top):
    """Exact sines up to 0.3 of the sampling rate on an exact chain: nothing is biased,
    and nothing is announced.
    """
    rng, fs, n = np.random.default_rng(0), 200.0, 4000
    t = np.arange(n) / fs
    w = 2 * np.pi * np.linspace(0.5, top * fs / 2, 80)
    M, C, K = ChainModel(
        [10.0, 8.0],
        {1: laws.PowerSeries(1, [40.0, 4e4]), 2: laws.PowerSeries(1, [40.0, 3e4])},
    ).matrices()
    H = np.linalg.inv(K + 1j * w[:, None, None] * C - w[:, None, None] ** 2 * M)
    phase = np.exp(1j * (np.outer(t, w) + rng.uniform(0, 2 * np.pi, len(w))))
    x, v, a = ((phase * (1j * w) ** k @ H[:, :, 1]).real for k in range(3))
    X = np.hstack([a, *(np.diff(y, axis=1, prepend=0.0) for y in (v, x))])
    model = NRFRegressor(degree=1, dt=1 / fs).fit(
        X, np.column_stack([np.zeros(n), phase.sum(axis=1).real])
    )
    assert model.masses_ == pytest.approx([10.0, 8.0], rel=1e-8)
    assert "noise" not in model.diagnose().table["limit"].tolist()


def test_noise_of_the_force_is_not_called_noise_of_a_quick_motion():
    """A mass at 130 Hz, sampled at 1 kHz: its motion is exact, and noise in the force
    alone biases nothing.
    """
    truth = ChainModel(
        [2.0], {"storey 1": laws.PowerSeries(1, [20.0, 2.0 * (2 * np.pi * 130) ** 2])}
    )
    rec = driven(truth, [1], 8.0, 1000.0, 50.0, (5, 180), hold="cubic")
    rec = rec.replace(
        force=rec.force
        + 5.0 * np.random.default_rng(1).standard_normal(rec.force.shape)
    )
    assert "noise" not in diagnosis(rec).table["limit"].tolist()


def test_a_model_that_creates_energy_is_told_so():
    """A damper of the wrong sign: negative damping beyond its error is a verdict, the
    right one none.
    """
    for c, bad in ((-2.0, True), (2.0, False)):
        truth = ChainModel(
            [12.0, 9.0], {i: laws.PowerSeries(1, [c, 3e4]) for i in (1, 2)}
        )
        table = diagnosis(record(truth, (1, 2), noise=0.0002)).table
        assert ("energy" in table["limit"].tolist()) == bad


def test_a_missing_law_and_a_sleeping_storey_are_named():
    hysteresis = ChainModel(
        [12.4] * 2,
        {"storey 1": [STOREY, laws.Dahl(sigma=5e4, Fd=60.0)], "storey 2": STOREY},
    )
    table = diagnosis(record(hysteresis, dofs=(1, 2))).table
    assert table["limit"][0] == "missing law" and "DOF 1" in table["where"][0]
    stiff = ChainModel(
        [12.4] * 3,
        {
            "storey 1": STOREY,
            "storey 2": STOREY,
            "storey 3": laws.PowerSeries(1, [25.0, 2e7]),
        },
    )
    table = diagnosis(record(stiff, dofs=(2,))).table
    assert "storey 3" in table.loc[table["limit"] == "excitation", "where"].tolist()


def test_plans_agree_with_identifiability():
    chain = Chain(4, links=["link 4-2"])
    for options in ({}, {"unknown": [2]}, {"can_hit": [1, 2], "unknown": [4]}):
        table = chain.plan(**options).table
        for row in table.itertuples():
            solve_order = chain.identifiability(
                row.hit, unknown=options.get("unknown", ()), strategy="sequential"
            )
            assert solve_order.complete == (row.identifies == 1.0) == (row.left == "")
        assert set().union(*table["hit"]) <= set(
            options.get("can_hit", range(1, 5))
        ) - set(options.get("unknown", ()))
        assert table["identifies"][0] == table["identifies"].max()


def test_a_floor_at_a_node_is_not_recommended():
    """Three equal floors on a spring to the ground at both ends: the middle one is a
    node of mode 2.
    """
    chain = Chain(3, ground="both")
    model = ChainModel([10.0] * 3, {s: STOREY for s in chain.sites}, chain)
    plan = chain.plan(model=model, most=1)
    assert plan.table["response"][
        [h == (2,) for h in plan.table["hit"]]
    ].item() == pytest.approx(0.0, abs=1e-9)
    assert plan.table["hit"][0] != (2,)


def test_a_missing_sensor_is_said_and_a_wrong_floor_refused():
    text = str(Chain(4).plan(sensors=[1, 2, 4]))
    assert "Floor 3 has no sensor" in text and "helps most on floor 3" in text
    with pytest.raises(ChainError, match="DOF 9"):
        Chain(4).plan(can_hit=[9])


@functools.cache
def two_floors():
    push = integrated.multisine(
        np.random.default_rng(0), 250.0, 10.0, (0.5, 25.0), 100.0
    )
    return push, integrated.run(
        [10.0, 8.0],
        [60.0, 60.0],
        [2e4, 1e4],
        250.0,
        10.0,
        lambda t: np.array([0.0, push(t)]),
    )


def faulty(fault):
    """Two floors with displacement sensors and accelerometers, one of them at fault."""
    push, (a, _, x, t) = two_floors()
    a, x = a.copy(), x.copy()
    if fault == "late":
        x[3:, 0] = x[:-3, 0].copy()
    if fault == "gain":
        x[:, 0] *= 1.3
    if fault == "clipped":
        a[:, 0] = np.clip(a[:, 0], *(0.7 * np.array([a[:, 0].min(), a[:, 0].max()])))
    return Record(
        acceleration=a,
        displacement=x,
        force=np.column_stack([0 * t, push(t)]),
        fs=250.0,
    )


@pytest.mark.parametrize(
    "fault, words, records",
    [
        ("late", "samples) late", 1),
        ("late", "samples) late", 2),
        ("gain", "1.3", 1),
        ("clipped", "is cut off", 1),
        ("", "", 1),
    ],
)
def test_what_fit_said_of_channels_is_in_the_diagnosis(fault, words, records):
    rec = faulty(fault)
    with warnings.catch_warnings(record=True, action="always") as caught:
        model = NRFRegressor(degree=1).fit([rec] * records if records > 1 else rec)
    table = model.diagnose().table
    told = table.loc[table["limit"] == "channel", "message"]
    assert bool(fault) == any(words in text for text in told) == bool(len(told))
    if fault:
        assert table["limit"][0] == "channel" and any(
            ("a1 is" if fault == "clipped" else "x1 is") in s for s in told
        )
        said = " ".join(str(w.message) for w in caught)
        assert told.iloc[0].removeprefix("Record 'record': ").rstrip(".") in said


@pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.NRFWarning")
@pytest.mark.parametrize("band", [None, (1.0, 30.0)])
def test_the_bias_that_is_said_is_the_bias_that_is_there(band):
    masses = np.array([10.0, 12.0, 8.0])
    truth = ChainModel(masses, {i: laws.PowerSeries(1, [60.0, 4e4]) for i in (1, 2, 3)})
    F = excitation.band_limited_random(
        3, 8.0, 500.0, excited=[1, 2, 3], rms=50.0, band=(1, 60), random_state=3
    )
    X, F = simulate(truth, F, 2e-3).to_features(smooth=False)
    X = X + 0.1 * X.std().to_numpy() * np.random.default_rng(0).standard_normal(X.shape)
    model = NRFRegressor(degree=1, dt=2e-3, band=band).fit(X, F)
    found = model.diagnose().table.query("limit == 'noise'").set_index("where")["size"]
    low = 1 - model.masses_ / masses
    np.testing.assert_allclose(found.reindex(["m1", "m2", "m3"]), low, atol=0.015)
