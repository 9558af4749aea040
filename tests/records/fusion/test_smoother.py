"""What a KinematicSmoother takes, finds and refuses."""

import numpy as np
import pandas as pd
import pytest
from smooth_motions import FS, chain_test, rms, two_floors

from pysindy_nrf import KinematicSmoother, datasets
from pysindy_nrf.exceptions import ChannelError, DataQualityWarning
from pysindy_nrf.records import ZeroPhaseFilter


@pytest.fixture(scope="module")
def motion():
    return two_floors()


@pytest.fixture(scope="module")
def accelerations():
    return two_floors(8000, top=20.0).record("a")


@pytest.fixture(scope="module")
def demo():
    return datasets.load_demo().to_frame().iloc[:2000]


def test_given_noise_levels_are_used_by_kind_and_by_channel(motion):
    levels = {"a": 0.3, "a2": 0.7, "x": 2e-6}
    smoother = KinematicSmoother(noise=levels).fit(motion.record("ax"))
    estimated = {"a1": 0.3, "a2": 0.7, "x1": 2e-6, "x2": 2e-6}
    assert smoother.noise_.to_dict() == estimated


@pytest.mark.parametrize("noise", [{"q": 1.0}, {"a": -1.0}, "guess", 3.0])
def test_impossible_noise_levels_are_refused(motion, noise):
    with pytest.raises(ChannelError, match="noise"):
        KinematicSmoother(noise=noise).fit(motion.record("ax"))


def test_knots_of_a_like_record_are_taken_over():
    first = chain_test("random", 4).noisy(0.02, 0).record("ax")
    second = chain_test("random", 5).noisy(0.02, 1).record("ax")
    smoother = KinematicSmoother().fit(first)
    coarser = 2.0 * smoother.spacing_
    like = KinematicSmoother(noise=smoother.noise_.to_dict(), spacing=coarser)
    np.testing.assert_allclose(like.fit(second).spacing_, coarser, rtol=1e-3)


def test_accelerations_alone_warn_of_what_is_lost(accelerations):
    with pytest.warns(DataQualityWarning, match="no displacement is measured"):
        smoother = KinematicSmoother().fit(accelerations)
    assert (smoother.high_pass_ > 0).all()


def test_in_a_band_accelerations_alone_give_the_displacement(accelerations):
    truth = ZeroPhaseFilter((0.8, None), FS).apply(two_floors(8000, top=20.0).x)
    limited = KinematicSmoother(band=(0.8, None)).fit_transform(accelerations)
    known = np.isfinite(limited.displacement[:, 0])
    assert known.sum() < limited.n_samples
    error = np.abs(limited.displacement - truth)[known]
    assert error.max() < 0.01 * rms(truth).min()


def test_more_noise_may_remain_where_less_would_cost_the_first_mode():
    """1 Hz in noise: displacements are trusted from a lower frequency on."""
    t = np.arange(20_000) / 500
    rng = np.random.default_rng(0)
    a = np.sin(2 * np.pi * t) + 0.2 * rng.standard_normal(t.size)
    table = pd.DataFrame({"a1": a})
    edges = []
    for share in (0.02, 0.1):
        smoother = KinematicSmoother(fs=500.0, band="auto", noise_share=share)
        with pytest.warns(DataQualityWarning, match="only the acceleration"):
            smoother.fit(table)
        edges.append(smoother.band_[0])
    assert edges[1] < edges[0] < 1.0


def test_masked_edges_stay_masked_and_inputs_are_untouched(motion):
    table = pd.DataFrame({"a1": motion.a[:, 0], "x1": motion.x[:, 0]})
    table["F1"] = table["a1"]
    table.loc[:9, "a1"] = np.nan
    table.loc[3990:, "x1"] = np.nan
    before = table.copy()
    out = KinematicSmoother(fs=FS).fit_transform(table)
    pd.testing.assert_frame_equal(table, before)
    inside = out.loc[10:3989, ["a1", "v1", "x1"]]
    assert inside.notna().all(axis=None)
    assert out.loc[:9, "v1"].isna().all()
    assert out.loc[3990:, "a1"].isna().all()


def test_pieces_of_a_table_are_fused_one_by_one(demo):
    """Two records one after the other; each has its own ends."""
    first, second = demo.iloc[:900], demo.iloc[900:]
    smoother = KinematicSmoother(joint=False)
    stacked = smoother.fit_transform(demo, record=np.repeat([1, 2], [900, 1100]))
    for record in (first, second):
        alone = KinematicSmoother(joint=False, noise=smoother.noise_.to_dict())
        fused = alone.fit_transform(record)
        pd.testing.assert_frame_equal(stacked.loc[record.index], fused, rtol=1e-6)


def test_an_array_with_named_channels_is_fused_like_a_table(demo):
    names = ["x1", "x2", "x3"]
    table = KinematicSmoother(joint=False).fit_transform(demo[names])
    fs = datasets.load_demo().fs
    smoother = KinematicSmoother(fs, channels="x", joint=False)
    array = smoother.fit_transform(demo[names].to_numpy())
    np.testing.assert_allclose(array, table, rtol=1e-6, atol=1e-12)
    assert list(smoother.get_feature_names_out()) == list(table.columns)
    with pytest.raises(ChannelError, match="X has 2 columns"):
        KinematicSmoother(fs=500.0, channels=names).fit(np.zeros((99, 2)))


@pytest.mark.parametrize(
    ("smoother", "table", "words"),
    [
        (KinematicSmoother(fs=FS), {"F1": np.arange(99.0)}, "is a motion"),
        (KinematicSmoother(), {"a1": np.arange(99.0)}, "sampling rate"),
        (KinematicSmoother(fs=FS), {"a1": [], "x1": []}, "X has no samples"),
        (KinematicSmoother(fs=FS), {"a1": np.ones(99)}, "a1 of DOF 1 is constant"),
        (KinematicSmoother(fs=FS), {"a1": np.arange(5.0)}, "5 samples are too few"),
        (
            KinematicSmoother(fs=FS, band="automatic"),
            {"a1": np.sin(np.arange(99))},
            "band='automatic' is unknown",
        ),
    ],
)
def test_a_table_that_cannot_be_fused_is_refused(smoother, table, words):
    with pytest.raises(ChannelError, match=words):
        smoother.fit(pd.DataFrame(table))


def test_an_array_without_names_and_a_hole_are_refused(motion):
    with pytest.raises(ChannelError, match="has no names"):
        KinematicSmoother(fs=FS).fit(motion.a)
    hole = motion.a[:, 0].copy()
    hole[17] = np.nan
    with pytest.raises(ChannelError, match="a1 .* row 17"):
        KinematicSmoother(fs=FS).fit(pd.DataFrame({"a1": hole}))


def test_other_columns_clocks_and_lengths_than_those_of_fit_are_refused(demo):
    fitted = KinematicSmoother().fit(demo)
    with pytest.raises(ChannelError, match="are not those of fit"):
        fitted.transform(demo[list(demo.columns[::-1])])
    with pytest.raises(ChannelError, match="fs=77.0 Hz contradicts"):
        KinematicSmoother(fs=77.0).fit(demo)
    with pytest.raises(ChannelError, match="spoils .* at each end"):
        KinematicSmoother(band=(0.05, None)).fit_transform(demo.iloc[:400])
