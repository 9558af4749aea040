"""Do data that come another way - in pieces, with gaps, from several files, turned
sensors - give the same answer?
"""

import warnings

import dask.array as da
import numpy as np
import pandas as pd
import pytest

from pysindy_nrf import ChainModel, NRFRegressor, Record, excitation, io, laws, simulate
from pysindy_nrf.exceptions import ChannelError, DataQualityWarning, LawError
from pysindy_nrf.records.input_arrays import from_arrays

FS = 500.0
MASSES = [10.0, 12.0]


@pytest.fixture(scope="module")
def record():
    storey = laws.PowerSeries(1, [30.0, 4e4])
    force = excitation.band_limited_random(
        2, 2.0, FS, excited=2, rms=50.0, band=(1, 60), random_state=0
    )
    return simulate(ChainModel(MASSES, {1: storey, 2: storey}), force, 1 / FS)


@pytest.fixture(scope="module")
def tables(record):
    return record.to_features(smooth=False)


def linear(**settings):
    return NRFRegressor(degree=1, **settings)


def test_absolute_coordinates_of_the_estimator_do_not_touch_records_in_a_stream(record):
    absolute = linear(coordinates="absolute").fit(iter([record]))
    np.testing.assert_allclose(
        absolute.masses_, linear().fit(record).masses_, rtol=1e-6
    )


def test_partial_fit_uses_the_samples_behind_a_gap_of_the_clock(tables):
    X, F = (table.to_numpy().copy() for table in tables)
    X[:3] = np.nan
    time = np.arange(len(X)) / FS + 2.0 * (np.arange(len(X)) >= 400)
    fitted = linear().partial_fit(X, F, time=time)
    assert fitted.n_samples_ == len(X) - 3
    np.testing.assert_allclose(fitted.masses_, MASSES, rtol=1e-6)


def test_dask_partitions_refuse_a_law_of_time(tables):
    X, F = (da.from_array(table.to_numpy(), chunks=(500, -1)) for table in tables)
    model = NRFRegressor(
        dt=1 / FS, laws={1: [laws.PowerSeries(1), laws.StiffnessStep(t0=0.3)]}
    )
    with pytest.raises(LawError, match="reads the time"):
        model.fit(X, F)


def test_a_gap_of_the_clock_cuts_a_record_and_the_time_goes_on_behind_it(tables):
    X, F = tables
    kept = np.r_[0:300, 600:1000]
    data = from_arrays(X.iloc[kept], F.iloc[kept])
    assert [segment.n_samples for segment in data.segments] == [300, 400]
    assert [segment.t[0] for segment in data.segments] == pytest.approx([0.0, 600 / FS])
    assert all(segment.dt == pytest.approx(1 / FS) for segment in data.segments)


@pytest.mark.parametrize(
    "short, rows", [(slice(320, 321), "row 300"), (slice(320, 340), "rows 300 to 319")]
)
def test_a_few_samples_between_two_gaps_are_left_out_and_never_joined_to_their_neighbours(
    tables, short, rows
):
    """Two runs of a logger and a hiccup between them: the fit is that of the two
    runs.
    """
    X, F = tables
    kept = np.r_[0:300, short, 400:1000]
    with pytest.warns(
        DataQualityWarning,
        match=f"Record: {rows} stand alone between gaps of the clock",
    ):
        data = from_arrays(X.iloc[kept], F.iloc[kept])
    assert [segment.n_samples for segment in data.segments] == [300, 600]
    assert all(segment.dt == pytest.approx(1 / FS) for segment in data.segments)
    with pytest.warns(DataQualityWarning, match="fewer than 30 samples are left out"):
        hiccup = linear(band=(1, 60)).fit(X.iloc[kept], F.iloc[kept])
    runs = np.r_[0:300, 400:1000]
    two = linear(band=(1, 60), dt=1 / FS).fit(
        X.to_numpy()[runs], F.to_numpy()[runs], record=runs > 320
    )
    np.testing.assert_allclose(hiccup.masses_, two.masses_, rtol=1e-12)


def test_forces_are_predicted_at_the_few_samples_between_two_gaps_too(tables):
    X, F = tables
    fitted, kept = linear().fit(X, F), np.r_[0:300, 320:321, 330:340, 400:1000]
    with warnings.catch_warnings(action="error"):
        np.testing.assert_array_equal(
            fitted.predict(X.iloc[kept]), fitted.predict(X)[kept]
        )
        np.testing.assert_array_equal(
            fitted.restoring_force(X.iloc[kept]), fitted.restoring_force(X)[kept]
        )
        streamed = linear().partial_fit(X.iloc[kept], F.iloc[kept])
    assert streamed.n_samples_ == len(kept)


def test_a_short_record_does_not_join_the_pieces_of_another(tables):
    """Ten samples are a record of their own, not a piece between gaps; the record
    beside them is cut.
    """
    X, F = (table.to_numpy() for table in tables)
    ids = np.repeat(["a", "b"], [10, 990])
    time = np.arange(1000) / FS + 2.0 * (np.arange(1000) >= 500)
    data = from_arrays(X, F, record=ids, time=time)
    assert [segment.n_samples for segment in data.segments] == [10, 490, 500]


def test_a_call_of_partial_fit_that_fails_adds_nothing(record, tables):
    other = Record(
        acceleration=np.ones((50, 3)),
        velocity=np.ones((50, 3)),
        displacement=np.ones((50, 3)),
        fs=FS,
    )
    fitted = linear().partial_fit(*tables)
    with pytest.raises(ChannelError):
        fitted.partial_fit([record, other])
    assert fitted.partial_fit(record).n_samples_ == 2 * record.n_samples


def test_a_base_of_which_only_the_displacement_is_known_has_an_acceleration():
    t = np.arange(2000) / FS
    shaken = Record(
        acceleration=np.sin(9 * t)[:, None],
        velocity=np.sin(9 * t)[:, None],
        displacement=np.sin(9 * t)[:, None],
        base_displacement=1e-2 * np.sin(19 * t),
        fs=FS,
    )
    ag = from_arrays(shaken, smooth=False).segments[0].ag
    np.testing.assert_allclose(
        ag[200:-200], -1e-2 * 19**2 * np.sin(19 * t)[200:-200], atol=0.03 * 1e-2 * 19**2
    )


def test_a_replaced_time_starts_where_it_says(record):
    assert record.replace(time=record.time + 5.0).time[0] == pytest.approx(5.0)
    assert record.rows(slice(100, 200)).replace(name="part").time[0] == pytest.approx(
        100 / FS
    )


@pytest.mark.parametrize(
    "preamble", [b"# log\x0c next page\n", b"remark: see log\x85\n"]
)
def test_marks_that_end_no_line_lose_no_sample(tmp_path, preamble):
    (tmp_path / "log.csv").write_bytes(
        preamble + b"t,x1\n" + b"".join(b"%.2f,%d\n" % (k / 100, k) for k in range(50))
    )
    assert io.read_record(tmp_path / "log.csv").displacement[:, 0].tolist() == list(
        range(50)
    )


def test_pairs_of_tables_with_a_time_index_stream(tables):
    X, F = tables
    pairs = [(X.iloc[rows], F.iloc[rows]) for rows in (slice(0, 600), slice(600, None))]
    timed = [(x.reset_index(), f) for x, f in pairs]
    for items in (pairs, timed):
        fitted = linear().fit(iter(items))
        assert fitted.n_samples_ == len(X)
        np.testing.assert_allclose(fitted.masses_, MASSES, rtol=1e-6)


def test_times_with_a_time_zone_are_read(record, tables):
    clock = pd.date_range(
        "2024-05-01", periods=record.n_samples, freq="2ms", tz="Europe/Berlin"
    )
    assert Record(
        displacement=record.displacement, time=pd.Series(clock)
    ).fs == pytest.approx(FS)
    fitted = linear().partial_fit(
        *(table.to_numpy() for table in tables), time=pd.Series(clock)
    )
    np.testing.assert_allclose(fitted.masses_, MASSES, rtol=1e-6)


def test_an_infinite_end_of_a_band_is_an_open_one(tables):
    fitted = linear(band=(1.0, np.inf)).fit(*tables)
    assert fitted.model_.info["band"] == [1.0, None]
    assert '"band"' in fitted.model_.to_json()


def test_partial_fit_takes_series_of_any_labels_and_tables_of_covariates(tables):
    X, F = (table.to_numpy()[400:] for table in tables)
    time = pd.Series(np.arange(len(X) + 400) / FS)[400:]
    covariates = pd.DataFrame({"u": np.zeros(len(X))})
    fitted = linear().partial_fit(X, F, time=time, covariates=covariates)
    np.testing.assert_allclose(fitted.masses_, MASSES, rtol=1e-6)
