"""Arguments just outside their range: refused by name, with the value and a cure; just inside, the right answer."""

import chains
import numpy as np
import pandas as pd
import pytest

from pysindy_nrf import (
    Chain,
    ChainModel,
    ForceLawLibrary,
    NRFRegressor,
    datasets,
    laws,
    simulate,
)
from pysindy_nrf import excitation as drive
from pysindy_nrf.estimation import locate_nonlinearity, model_agreement, total_mass
from pysindy_nrf.exceptions import ChainError, ChannelError, FileFormatError, LawError
from pysindy_nrf.monitoring import compare_tests, track
from pysindy_nrf.regression.segments import feature_names
from pysindy_nrf.selection.comparison import compare
from pysindy_nrf.signals import BandLimiter, KinematicSmoother, differentiate
from pysindy_nrf.signals.alignment import channel_alignment, resampled, split_at_gaps
from pysindy_nrf.simulation.noise import add_noise

FS = 500.0
RANDOM = dict(dofs=1, rms=1.0, band=(1.0, 50.0))


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: drive.impact_hammer(2, 1.0, FS, dofs=1, level=1.0, spread=1.0), "spread=1.0 is not between 0 and 1"),
        (lambda: drive.impact_hammer(2, 1.0, FS, dofs=1, level=1.0, n_hits=2.5), "n_hits=2.5 is not a whole number"),
        (lambda: drive.impact_hammer(2, 1.0, FS, dofs=1, level=[]), "No level is given"),
        (lambda: drive.impact_hammer(2, 1.0, FS, dofs=1, level="loud"), "level='loud' is not a positive number. .*N"),
        (lambda: drive.impact_hammer(2, 1.0, FS, dofs=[], level=1.0), "No DOF is forced"),
        (lambda: drive.impact_hammer(2, 0.002, FS, dofs=1, level=1.0), "0.002 s at 500.0 Hz are 1 samples"),
        (lambda: drive.impact_hammer(True, 1.0, FS, dofs=1, level=1.0), "n_dof=True is not a whole number"),
        (lambda: drive.band_limited_random(1, 1.0, FS, dofs=1, rms=1.0, band=5.0), "band=5.0 is not a pair"),
        (lambda: drive.sweep(1, 1.0, FS, dofs=1, level=1.0, band=(1, 50), method="cubic"), "method='cubic' is unknown"),
        (lambda: drive.sweep(1, 1.0, FS, dofs=1, level=1.0, band=(0, 50), method="logarithmic"), "cannot pass 0 Hz"),
        (lambda: drive.earthquake(10.0, FS, peak=3.0, rise=0.8, fall=0.2), "rise=0.8, fall=0.2 are not in order"),
        (lambda: add_noise(datasets.load_demo(), "5 %"), "level='5 %' is not a share of the RMS"),
        (lambda: differentiate(np.zeros((3, 3, 3)), 0.01), "The motion has 3 dimensions"),
        (lambda: BandLimiter((1, 50), FS, edges="cut").fit(np.zeros((9, 1))), "edges='cut' is unknown"),
        (lambda: BandLimiter((1, 50), fs="fast").fit(np.zeros((9, 1))), "fs='fast' is not a sampling rate"),
        (lambda: BandLimiter((1, 50), fs=-1.0).fit(np.zeros((9, 1))), "fs=-1.0 is not a sampling rate"),
        (lambda: KinematicSmoother().fit(np.zeros((99, 2))), "ndarray has no names"),
        (lambda: KinematicSmoother(fs=FS).fit(pd.DataFrame({"a1": [], "x1": []})), "X has no samples"),
        (lambda: ForceLawLibrary().fit(np.zeros((5, 6))), "The library has no laws"),
        (lambda: ForceLawLibrary(laws.Duffing(), inputs="both").fit(np.zeros((5, 6))), "inputs='both' is unknown"),
        (lambda: laws.PreloadedContact(side=0), "side=0 is unknown. .*1 or -1"),
        (lambda: laws.Duffing().values, "Duffing has no coefficients yet"),
        (lambda: channel_alignment(datasets.load_demo(), reference="t"), "reference='t' is unknown"),
        (lambda: simulate(datasets.demo_truth(), None, 1e-3), "Nothing drives the free run"),
        (lambda: NRFRegressor(orders={"link 2-0": 2}).fit(np.ones((50, 6)), np.ones((50, 2))), "'ground 2', which is not in the chain"),
    ],
)  # fmt: skip
def test_the_argument_and_its_cure_are_named(call, words):
    with pytest.raises((ChannelError, ChainError, LawError, FileFormatError), match=words):
        call()


def test_levels_follow_each_other_on_the_floors():
    """The edge of what is allowed: spread 0 gives blows of exactly the levels, in turn."""
    F = drive.impact_hammer(2, 8.0, 4000.0, dofs=[1, 2], level=[100.0, 200.0], n_hits=4, width=0.01, spread=0.0)
    np.testing.assert_allclose(F.max(axis=0), [100.0, 200.0], rtol=1e-3)


# -- signals ----------------------------------------------------------------------------------


def test_columns_without_names_and_times_beside_them():
    """scikit-learn's names for unnamed columns, a clock in the index, a clock that does not fit."""
    t = np.arange(2000) / FS
    X = np.column_stack([np.sin(20 * t), np.cos(20 * t)])
    limiter = BandLimiter((10, 100), FS).fit(X)
    assert list(limiter.get_feature_names_out()) == ["x0", "x1"]
    assert list(limiter.get_feature_names_out(["a1", "a2"])) == ["a1", "a2"]
    with pytest.raises(ChannelError, match="time has 1999 values, X has 2000 samples"):
        limiter.transform(X, time=t[:-1])
    stamps = pd.to_datetime("2024-05-01") + pd.to_timedelta(t, unit="s")
    framed = BandLimiter((10, 100), FS).fit_transform(pd.DataFrame(X, index=stamps, columns=["a1", "a2"]))
    np.testing.assert_array_equal(framed.to_numpy(), limiter.transform(X))
    shuffled = pd.DataFrame(X, index=stamps[::-1], columns=["a1", "a2"])
    with pytest.raises(ChannelError, match="does not increase"):
        BandLimiter((10, 100), FS).fit_transform(shuffled)


def test_a_record_of_nothing_but_nan_stays_nan():
    """Two records, one of them not measured: the other is filtered as if it were alone."""
    t = np.arange(2000) / FS
    X = np.column_stack([np.sin(20 * t), np.cos(20 * t)])
    both = np.vstack([X, np.full_like(X, np.nan)])
    out = BandLimiter((10, 100), FS).fit(both).transform(both, record=np.repeat([0, 1], 2000))
    assert np.isnan(out[2000:]).all()
    np.testing.assert_array_equal(out[:2000], BandLimiter((10, 100), FS).fit_transform(X))


def test_a_smoother_meets_other_columns_clocks_and_lengths():
    rec = datasets.load_demo()
    frame = rec.to_frame().iloc[:2000]
    fitted = KinematicSmoother().fit(frame)
    with pytest.raises(ChannelError, match="are not those of fit"):
        fitted.transform(frame[list(frame.columns[::-1])])
    with pytest.raises(ChannelError, match=r"fs=77.0 Hz contradicts the clock of the data"):
        KinematicSmoother(fs=77.0).fit(frame)
    with pytest.raises(ChannelError, match="spoils .* at each end"):
        KinematicSmoother(band=(0.05, None)).fit_transform(frame.iloc[:400])


def test_the_spectral_slope_of_an_odd_number_of_samples():
    """A sine of whole periods has an exact slope whether the number of samples is even or odd."""
    for n in (200, 201):
        t = np.arange(n) * 0.01
        w = 2 * np.pi * 7 / (n * 0.01)
        np.testing.assert_allclose(differentiate(np.sin(w * t), 0.01, "spectral"), w * np.cos(w * t), atol=1e-9 * w)


def test_the_noise_of_a_covariate_has_its_share():
    rec = datasets.load_demo()
    t = rec.time
    rec = rec.replace(covariates={"pressure": np.sin(3 * t)})
    noisy = add_noise(rec, 0.1, random_state=0, channels=["pressure"])
    gap = noisy.covariates["pressure"] - rec.covariates["pressure"]
    assert gap.std() == pytest.approx(0.1 * np.sqrt(np.mean(np.sin(3 * t) ** 2)), rel=0.05)
    np.testing.assert_array_equal(noisy.acceleration, rec.acceleration)


def test_rates_and_gaps_that_cannot_be_mended():
    t = np.arange(500) / FS
    with pytest.raises(ChannelError, match="have no simple ratio"):
        resampled({"a1": np.sin(t), "x1": np.sin(t)}, rates={"a1": 500.0, "x1": 500.1})
    broken = pd.DataFrame({"t": t, "a1": np.where(np.arange(500) % 40, np.sin(t), np.nan)})
    with pytest.raises(ChannelError, match="No piece without a gap has 100 samples"):
        split_at_gaps(broken)
    assert [part.n_samples for part in split_at_gaps(broken, shortest=30)][:3] == [39, 39, 39]


# -- libraries and models ---------------------------------------------------------------------


def test_a_library_takes_one_law_for_every_storey_and_leading_axes():
    X = np.random.default_rng(0).standard_normal((4, 6))
    library = ForceLawLibrary(laws.Duffing()).fit(X)
    assert library.get_feature_names() == ["a1", "a2", "s1", "s1^3", "s2", "s2^3"]
    stacked = library.transform(np.stack([X, 2 * X]))
    np.testing.assert_allclose(np.asarray(stacked)[1, :, 3], (2 * X[:, 4]) ** 3)


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


def test_models_of_other_structures_are_not_compared(chain2, chain4):
    one, two = (NRFRegressor().fit(c.X, c.F) for c in (chain2, chain4))
    with pytest.raises(ChainError, match="have 2 and 4 DOFs"):
        model_agreement(one, two, chain2.X)
    with pytest.raises(ChainError, match="str is not a chain model"):
        total_mass({"first": "a model"})
    assert "gap" not in total_mass({"first": one})
    with pytest.raises(ChainError, match="data's own regressor"):
        locate_nonlinearity(one.model_, chain2.X, chain2.F)
    rec = datasets.load_demo()
    with pytest.raises(ChannelError, match="takes one contiguous record on a base at rest"):
        compare([rec, rec])


def test_nothing_changed_between_two_halves(chain2):
    """The same chain in both tests: no term changes by more than what the pieces tell, and the words say so."""
    X, F = chain2.X, chain2.F
    rng = np.random.default_rng(1)
    noisy = X + 0.01 * X.std(axis=0) * rng.standard_normal(X.shape)
    found = compare_tests(NRFRegressor(degree=1), (noisy[:1000], F[:1000]), (noisy[1000:], F[1000:]), n_blocks=10, least=50.0)
    assert str(found).startswith("Nothing changed by more than 50 %")


def test_a_model_with_a_floor_that_nothing_holds():
    """A free mass above a spring: its site has no law, and neither words nor notebook view fail on it."""
    model = ChainModel([5.0, 4.0], {"storey 1": [laws.PowerSeries(1, [3.0, 3e4])], "storey 2": []})
    shown = model._repr_html_()
    assert "m2 = 4 kg" in shown and 'alttext="R 1 ="' in shown and 'alttext="R 2 ="' not in shown
    run = simulate(model, np.column_stack([np.zeros(400), 8.0 * np.ones(400)]), 1e-3)
    np.testing.assert_allclose(run.displacement[-1, 1], 0.5 * 2.0 * 0.399**2, rtol=1e-6)  # x = F t^2 / (2 m)
    assert not run.displacement[:, 0].any()


def test_pieces_of_a_chain_are_refused_below_their_size(chain4):
    model = NRFRegressor(dt=1e-3).fit(chain4.X, chain4.F)
    from pysindy_nrf.monitoring.change import resolver_in_time
    from pysindy_nrf.regression.chain_model import as_segments

    data = as_segments(model, chain4.X, chain4.F)
    assert len(resolver_in_time(model.problem_, data, n_blocks=4)[0].pieces) == 4
    with pytest.raises(ChannelError, match="too short"):
        resolver_in_time(model.problem_, data, n_blocks=2000)


def test_a_shape_without_a_value_cannot_become_a_model():
    ps = pytest.importorskip("pysindy")
    from pysindy_nrf.regression.optimizers import StateSpaceChainOptimizer
    from pysindy_nrf.regression.state_space import from_sindy

    case = chains.duffing(1, [1], seed=3, n_samples=400, cubic=False)
    x = np.column_stack([case.s[:, 0], case.v[:, 0]])
    xdot = np.column_stack([case.v[:, 0], case.a[:, 0]])
    library = ForceLawLibrary({"storey 1": [laws.LinearViscous(), laws.LinearElastic()]}, inputs="state")
    sindy = ps.SINDy(feature_library=library, optimizer=StateSpaceChainOptimizer())
    sindy.fit(x, t=case.dt, x_dot=xdot, u=case.F)
    np.testing.assert_allclose(from_sindy(sindy).masses, case.m, rtol=1e-6)


def test_orders_of_a_link_that_is_not_there():
    from pysindy_nrf.regression.feature_library import power_series_laws

    with pytest.raises(ChainError, match="'link 3-1', which is not in the chain"):
        power_series_laws(Chain(3), 2, {"link 3-1": 3})


def test_half_a_base_is_refused(chain2):
    names = feature_names(2, "absolute")
    frame = pd.DataFrame(np.hstack([chain2.X, 0 * chain2.X[:, :1]]), columns=[*names, "x0"])
    with pytest.raises(ChannelError, match="only one of the columns xdot0 and x0"):
        NRFRegressor(coordinates="absolute").fit(frame, chain2.F)
