"""From a record to the motion and forces of its balances."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from smooth_motions import FS, MASS, chain_masses, chain_test, two_floors

from pysindy_nrf import KinematicSmoother, Record
from pysindy_nrf.exceptions import ChannelError, DataQualityWarning
from pysindy_nrf.records import ZeroPhaseFilter, from_arrays, fuse_record, to_features


@pytest.fixture(scope="module")
def motion():
    return two_floors()


@pytest.fixture(scope="module")
def noisy():
    return chain_test("random", 6).noisy(0.05, 0).record()


@pytest.fixture(scope="module")
def accelerations():
    """Two floors of which accelerations with noise are known, and no displacement."""
    return two_floors(8000, top=20.0).noisy(0.01, 0).record("a")


def test_features_are_absolute_accelerations_and_interstorey_motion(motion):
    force = np.full_like(motion.a, np.nan)
    force[:, 0] = np.sin(motion.t)
    fused = fuse_record(replace(motion, force=force).record(), smooth=False)
    np.testing.assert_array_equal(fused.a, motion.a)
    np.testing.assert_array_equal(fused.v[:, 0], motion.v[:, 0])
    np.testing.assert_array_equal(fused.s[:, 1], motion.x[:, 1] - motion.x[:, 0])
    np.testing.assert_array_equal(fused.force, force)
    assert (fused.ag, fused.band, fused.resolved) == (None, None, None)


def test_tables_hold_what_the_typed_result_does(noisy):
    X, F = to_features(noisy)
    fused = fuse_record(noisy)
    assert list(X.columns[::4]) == ["a1", "v1", "s1"]
    assert X.index.name == "t"
    np.testing.assert_array_equal(X, np.hstack([fused.a, fused.v, fused.s]))
    np.testing.assert_array_equal(F, fused.force)
    assert set(fused.noise) == {f"{kind}{j}" for kind in "avx" for j in (1, 2, 3, 4)}


@pytest.mark.parametrize("channels", ["noisy", "accelerations"])
@pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.DataQualityWarning")
def test_two_ways_of_one_fusion_are_those_of_two(channels, request):
    record = request.getfixturevalue(channels)
    data = from_arrays(record, both_fusions=True)
    for fused, joint in ((data, True), (data.apart, False)):
        smoother = KinematicSmoother(band="auto", joint=joint)
        alone = from_arrays(record, smooth=smoother).segments[0]
        for name in "avs":
            both_ways = getattr(fused.segments[0], name)
            np.testing.assert_allclose(both_ways, getattr(alone, name), rtol=1e-9)
        assert fused.segments[0].band == alone.band


def test_channels_of_two_fusions_are_checked_once(noisy):
    turned = noisy.replace(displacement=-noisy.displacement)
    with pytest.warns(DataQualityWarning, match="opposite sign"):
        together = from_arrays(turned, both_fusions=True)
    with warnings.catch_warnings(action="error"):
        apart = together.apart
    assert [note.kind for note in together.quality] == ["sign"] * 4
    assert apart.quality == ()


def test_knots_limit_the_frequency_of_a_motion_without_accelerometer(noisy):
    positions = noisy.replace(acceleration=None, velocity=None)
    fused = fuse_record(positions)
    coarsest = max(fused.spacing.values())
    assert fused.resolved == pytest.approx(0.7 * FS / (2 * coarsest))
    assert fuse_record(noisy).resolved is None


def test_channels_that_lack_are_named(motion):
    with pytest.raises(ChannelError, match="lacks v1, v2"):
        to_features(motion.record("ax"), smooth=False)
    dead = motion.a.copy()
    dead[:, 1] = np.nan
    with pytest.raises(ChannelError, match="DOF 2 .* no motion channel"):
        to_features(Record(None, dead, fs=FS))
    with pytest.raises(ChannelError, match="smooth='yes' is unknown"):
        to_features(motion.record(), smooth="yes")


def test_forces_are_filtered_only_with_a_band_and_then_like_the_response():
    record = chain_test("random", 6).record()
    untouched = KinematicSmoother().transform_record(record)
    np.testing.assert_array_equal(untouched.force, record.force)

    X, F = to_features(record, KinematicSmoother(band=(2.0, 40.0)))
    rows = X.notna().all(axis=1)
    assert (F.notna().all(axis=1) == rows).all()
    assert 0 < (~rows).sum() < len(X)
    np.testing.assert_allclose(chain_masses(X[rows], F[rows]), MASS, rtol=1e-3)


def test_the_motion_of_the_base_is_in_the_band_of_the_floors(accelerations):
    ag = np.sin(2 * np.pi * 9.0 * accelerations.time)
    record = accelerations.replace(
        acceleration=accelerations.acceleration + ag[:, None], base_acceleration=ag
    )
    fused = fuse_record(record, KinematicSmoother(band=(2.0, None)))
    operator = ZeroPhaseFilter((2.0, None), FS)
    np.testing.assert_allclose(fused.ag, operator.apply(ag), atol=1e-12)
