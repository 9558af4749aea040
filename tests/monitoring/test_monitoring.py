"""Change between tests and tracking: what the pieces allow to say, and chains without a first storey."""

import numpy as np
import pytest

from pysindy_nrf import Chain, ChainModel, NRFRegressor, excitation, laws, simulate
from pysindy_nrf.estimation import model_agreement
from pysindy_nrf.exceptions import ChainError, ChannelError
from pysindy_nrf.monitoring import compare_tests, track


def test_pieces_too_short_and_seconds_without_a_step(chain2):
    X, F = chain2.X, chain2.F
    model = NRFRegressor().fit(X, F)
    with pytest.raises(ChannelError, match="A window in seconds needs the sampling step"):
        track(model, X, F, window=0.5, step=0.1)
    timed = NRFRegressor(dt=1e-3).fit(X, F)
    with pytest.raises(ChannelError, match="Pieces of 2 samples are too short"):
        track(timed, X, F, window=0.5, step=0.002)
    with pytest.raises(ChainError, match="No window of 60 s fits into the records"):
        track(timed, X, F, window=60.0, step=0.5)
    with pytest.raises(ChainError, match="masses='all' is unknown"):
        track(timed, X, F, window=0.5, step=0.1, masses="all")


def test_a_window_never_joins_two_records(chain2):
    """Two records of 1.2 and 0.8 s: windows of 0.4 s in steps of 0.2 s lie inside one of them."""
    ids = np.repeat(["a", "b"], [1200, 800])
    model = NRFRegressor(dt=1e-3, degree=1).fit(chain2.X, chain2.F, record=ids)
    found = track(model, chain2.X, chain2.F, window=0.4, step=0.2, record=ids)
    assert found["record"].value_counts().to_dict() == {0: 5, 1: 3}


def test_nothing_changed_between_two_halves(chain2):
    """The same chain in both tests: no term changes by more than what the pieces tell, and the words say so."""
    X, F = chain2.X, chain2.F
    rng = np.random.default_rng(1)
    noisy = X + 0.01 * X.std(axis=0) * rng.standard_normal(X.shape)
    found = compare_tests(NRFRegressor(degree=1), (noisy[:1000], F[:1000]), (noisy[1000:], F[1000:]), n_blocks=10, least=50.0)
    assert str(found).startswith("Nothing changed by more than 50 %")


LINEAR = laws.PowerSeries(1, [60.0, 4e4])


def forced(model, seconds=4.0, fs=500.0, seed=0, **options):
    n = model.n_dof
    F = excitation.band_limited_random(
        n, seconds, fs, dofs=range(1, n + 1), rms=50.0, band=(1, 60), random_state=seed, **options
    )
    return simulate(model, F, 1 / fs)


def test_a_free_chain_is_compared_where_it_has_storeys():
    chain = Chain(2, ground="free")
    truth = ChainModel([10.0, 12.0], {"storey 2": LINEAR}, chain)
    damaged = ChainModel([10.0, 12.0], {"storey 2": laws.PowerSeries(1, [60.0, 3.6e4])}, chain)
    before, after = (forced(m, seed=i).to_features(smooth=False) for i, m in enumerate((truth, damaged)))
    report = compare_tests(NRFRegressor(degree=1, chain=chain, dt=2e-3), before, after)
    assert report.damaged == ["storey 2"]
    table = report.table.set_index(["storey", "term"])
    assert table.loc[("storey 2", "k"), "change"] == pytest.approx(-10.0, abs=0.01)
    assert table.loc["storey 1", ["before", "after", "change", "p"]].isna().all(axis=None)
    agreement = model_agreement(truth, damaged, before[0])
    assert agreement.loc["storey 2", "k"] == pytest.approx(-10.0)
    assert agreement.loc["storey 1", ["k", "c"]].isna().all()


def test_a_change_is_dated_in_a_chain_that_stands_on_nothing():
    """A free chain has no storey 1; storey 2 loses a fifth of its stiffness after 6 s."""
    from pysindy_nrf.monitoring import find_onset, track

    free = Chain(3, ground="free")
    damaged = laws.StiffnessStep(t0=6.0, dk=-8e3)
    truth = ChainModel(
        [10.0, 12.0, 8.0], {2: [laws.PowerSeries(1, [30.0, 4e4]), damaged], 3: [laws.PowerSeries(1, [30.0, 4e4])]}, free
    )
    F = excitation.band_limited_random(3, 12.0, 500.0, dofs=[1, 2, 3], rms=50.0, band=(1, 60), random_state=0)
    X, F = simulate(truth, F - F.mean(axis=0), 2e-3).to_features(smooth=False)
    model = NRFRegressor(degree=1, dt=2e-3, chain=free).fit(X, F)
    onset = find_onset(model, X, F)
    assert onset.storey == "storey 2" and onset.time == pytest.approx(6.0, abs=1.0)
    assert onset.change == pytest.approx(-20.0, abs=5.0)
    assert track(model, X, F)["k1"].isna().all() and track(model, X, F)["k2"].notna().all()
