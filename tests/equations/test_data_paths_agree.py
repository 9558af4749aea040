"""Data in pieces, with gaps or from files give the same answer."""

import warnings

import dask.array as da
import numpy as np
import pandas as pd
import pytest

from pysindy_nrf import ChainModel, NRFRegressor, Record, excitation, io, laws, simulate
from pysindy_nrf.exceptions import ChannelError, DataQualityWarning, LawError
from pysindy_nrf.records import from_arrays

FS = 500.0
MASSES = [10.0, 12.0]


@pytest.fixture(scope="module")
def record():
    """Two seconds of two linear storeys, the upper floor forced."""
    storey = laws.PowerSeries(1, [30.0, 4e4])
    force = excitation.band_limited_random(
        2, 2.0, FS, excited=2, rms=50.0, band=(1, 60), random_state=0
    )
    return simulate(ChainModel(MASSES, {1: storey, 2: storey}), force, 1 / FS)


@pytest.fixture(scope="module")
def X(record):
    return record.to_features(smooth=False)[0]


@pytest.fixture(scope="module")
def F(record):
    return record.to_features(smooth=False)[1]


def linear(**settings):
    return NRFRegressor(degree=1, **settings)


def assert_masses(fitted):
    np.testing.assert_allclose(fitted.masses_, MASSES, rtol=1e-6)


# -- streams -------------------------------------------------------------------


def test_a_record_in_a_stream_is_read_as_one_by_itself(record):
    masses = linear().fit(record).masses_
    listed = linear().fit(iter([record])).masses_
    np.testing.assert_allclose(listed, masses, rtol=1e-6)


def test_partial_fit_uses_the_samples_behind_a_gap_of_the_clock(X, F):
    table = X.to_numpy().copy()
    table[:3] = np.nan
    time = np.arange(1000) / FS + 2.0 * (np.arange(1000) >= 400)
    fitted = linear().partial_fit(table, F.to_numpy(), time=time)
    assert fitted.n_samples_ == 997
    assert_masses(fitted)


def test_a_call_of_partial_fit_that_fails_adds_nothing(record, X, F):
    ones = np.ones((50, 3))
    other = Record(acceleration=ones, velocity=ones, displacement=ones, fs=FS)
    fitted = linear().partial_fit(X, F)
    with pytest.raises(ChannelError):
        fitted.partial_fit([record, other])
    assert fitted.partial_fit(record).n_samples_ == 2 * record.n_samples


def test_dask_partitions_refuse_a_law_of_time(X, F):
    declared = {1: [laws.PowerSeries(1), laws.StiffnessStep(t0=0.3)]}
    model = NRFRegressor(dt=1 / FS, laws=declared)
    chunks = (500, -1)
    parts = [da.from_array(table.to_numpy(), chunks=chunks) for table in (X, F)]
    with pytest.raises(LawError, match="reads the time"):
        model.fit(*parts)


@pytest.mark.parametrize("clock", ["index", "column"])
def test_pairs_of_tables_with_a_clock_stream(X, F, clock):
    timed = X.reset_index() if clock == "column" else X
    pairs = [(timed.iloc[:600], F.iloc[:600]), (timed.iloc[600:], F.iloc[600:])]
    fitted = linear().fit(iter(pairs))
    assert fitted.n_samples_ == 1000
    assert_masses(fitted)


def test_partial_fit_takes_series_of_any_labels_and_tables_of_covariates(X, F):
    time = pd.Series(np.arange(1000) / FS)[400:]
    covariates = pd.DataFrame({"u": np.zeros(600)})
    fitted = linear().partial_fit(
        X.to_numpy()[400:], F.to_numpy()[400:], time=time, covariates=covariates
    )
    assert_masses(fitted)


# -- gaps of the clock ---------------------------------------------------------


def test_a_gap_cuts_a_record_and_the_time_goes_on_behind_it(X, F):
    rows = np.r_[0:300, 600:1000]
    data = from_arrays(X.iloc[rows], F.iloc[rows])
    assert [segment.n_samples for segment in data.segments] == [300, 400]
    starts = [segment.t[0] for segment in data.segments]
    assert starts == pytest.approx([0.0, 600 / FS])
    steps = [segment.dt for segment in data.segments]
    assert steps == pytest.approx([1 / FS] * 2)


SHORT_PIECES = pytest.mark.parametrize(
    ("piece", "rows"), [(slice(320, 321), "row 300"), (slice(320, 340), "rows 300 to")]
)


@SHORT_PIECES
def test_a_few_samples_between_two_gaps_are_left_out(X, F, piece, rows):
    used = np.r_[0:300, piece, 400:1000]
    with pytest.warns(DataQualityWarning, match=f"{rows}.* alone between gaps"):
        data = from_arrays(X.iloc[used], F.iloc[used])
    assert [segment.n_samples for segment in data.segments] == [300, 600]


@SHORT_PIECES
def test_a_hiccup_of_the_logger_changes_no_fit_of_the_two_runs(X, F, piece, rows):
    used, runs = np.r_[0:300, piece, 400:1000], np.r_[0:300, 400:1000]
    with pytest.warns(DataQualityWarning, match="fewer than 30 samples"):
        hiccup = linear(band=(1, 60)).fit(X.iloc[used], F.iloc[used])
    two = linear(band=(1, 60), dt=1 / FS)
    two.fit(X.to_numpy()[runs], F.to_numpy()[runs], record=runs > 320)
    np.testing.assert_allclose(hiccup.masses_, two.masses_, rtol=1e-12)


@pytest.fixture(scope="module")
def rows_with_gaps():
    return np.r_[0:300, 320:321, 330:340, 400:1000]


@pytest.mark.parametrize("method", ["predict", "restoring_force"])
def test_forces_are_predicted_at_the_few_samples_too(X, F, rows_with_gaps, method):
    predicted = getattr(linear().fit(X, F), method)
    with warnings.catch_warnings(action="error"):
        forces = predicted(X.iloc[rows_with_gaps])
    np.testing.assert_allclose(forces, predicted(X)[rows_with_gaps], atol=1e-9)


def test_a_stream_takes_the_few_samples(X, F, rows_with_gaps):
    rows = rows_with_gaps
    with warnings.catch_warnings(action="error"):
        streamed = linear().partial_fit(X.iloc[rows], F.iloc[rows])
    assert streamed.n_samples_ == len(rows)


def test_a_short_record_does_not_join_the_pieces_of_another(X, F):
    """Ten samples are a record of their own; the record beside them is cut."""
    ids = np.repeat(["a", "b"], [10, 990])
    time = np.arange(1000) / FS + 2.0 * (np.arange(1000) >= 500)
    data = from_arrays(X.to_numpy(), F.to_numpy(), record=ids, time=time)
    assert [segment.n_samples for segment in data.segments] == [10, 490, 500]


# -- clocks, bases, files ------------------------------------------------------


def test_a_base_of_known_displacement_alone_has_an_acceleration():
    t = np.arange(2000) / FS
    floor = np.sin(9 * t)[:, None]
    shaken = Record(
        acceleration=floor,
        velocity=floor,
        displacement=floor,
        base_displacement=1e-2 * np.sin(19 * t),
        fs=FS,
    )
    ag = from_arrays(shaken, smooth=False).segments[0].ag
    expected = -1e-2 * 19**2 * np.sin(19 * t)
    inside = slice(200, -200)
    limit = 0.03 * np.abs(expected).max()
    np.testing.assert_allclose(ag[inside], expected[inside], atol=limit)


def test_a_replaced_time_starts_where_it_says(record):
    later = record.replace(time=record.time + 5.0)
    assert later.time[0] == pytest.approx(5.0)
    piece = record.rows(slice(100, 200)).replace(name="part")
    assert piece.time[0] == pytest.approx(100 / FS)


@pytest.mark.parametrize("remark", [b"# log\x0c next page\n", b"remark: see log\x85\n"])
def test_marks_that_end_no_line_lose_no_sample(tmp_path, remark):
    path = tmp_path / "log.csv"
    lines = [b"%.2f,%d\n" % (k / 100, k) for k in range(50)]
    path.write_bytes(remark + b"t,x1\n" + b"".join(lines))
    x = io.read_record(path).displacement[:, 0]
    assert x.tolist() == list(range(50))


@pytest.fixture(scope="module")
def berlin(record):
    clock = pd.date_range(
        "2024-05-01", periods=record.n_samples, freq="2ms", tz="Europe/Berlin"
    )
    return pd.Series(clock)


def test_times_with_a_time_zone_are_read(record, berlin):
    timed = Record(displacement=record.displacement, time=berlin)
    assert timed.fs == pytest.approx(FS)


def test_times_with_a_time_zone_stream(X, F, berlin):
    assert_masses(linear().partial_fit(X.to_numpy(), F.to_numpy(), time=berlin))


def test_an_infinite_end_of_a_band_is_an_open_one(X, F):
    model = linear(band=(1.0, np.inf)).fit(X, F).model_
    assert model.info["band"] == [1.0, None]
    assert '"band"' in model.to_json()
