"""Data that are short, empty, half measured or named oddly: the right numbers still, or the reason in words."""

import warnings

import chains
import numpy as np
import pandas as pd
import pytest
from paper_cases import two_dof

from pysindy_nrf import ChainModel, ForceLawLibrary, NRFRegressor, Record, Site, excitation, laws, simulate
from pysindy_nrf.common.audit import settings_of
from pysindy_nrf.data.io import read_record, read_table
from pysindy_nrf.estimation.streaming import open_source, sources
from pysindy_nrf.exceptions import ChainError, ChannelError, LawError
from pysindy_nrf.output.displays._plotly import ticks, unit_of
from pysindy_nrf.output.report.content import of_model
from pysindy_nrf.regression.input_arrays import feature_names
from pysindy_nrf.regression.state_space import IdentifiedChain
from pysindy_nrf.selection.comparison.api import _peak
from pysindy_nrf.signals.kinematics import to_features
from pysindy_nrf.signals.paper import paper_processing
from pysindy_nrf.signals.zero_phase_filter import FairFilter
from pysindy_nrf.simulation.readings import as_read

pytestmark = pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.NRFWarning")

FS = 500.0
TRUTH = ChainModel([8.0, 6.0], {f"storey {i}": [laws.PowerSeries(1, [30.0, 4e4])] for i in (1, 2)})


def record(seconds=4.0, ag=None):
    F = excitation.band_limited_random(2, seconds, FS, dofs=[1, 2], rms=60.0, band=(1, 40), random_state=0)
    return simulate(TRUTH, F * (ag is None), 1 / FS, base_acceleration=ag)


# -- arrays -----------------------------------------------------------------------------------


def test_forces_may_be_numbered_and_few_rows_have_no_order(chain2):
    """Columns 0, 1 of a table of forces are F1, F2; seven rows are too few to call shuffled."""
    whole = NRFRegressor().fit(chain2.X, chain2.F)
    numbered = NRFRegressor().fit(chain2.X, pd.DataFrame(chain2.F))
    np.testing.assert_array_equal(numbered.masses_, whole.masses_)
    single = chains.duffing(1, [1], seed=1, n_samples=400, cubic=False)
    few = NRFRegressor(degree=1).fit(single.X[200:207], single.F[200:207])
    assert few.masses_ == pytest.approx(single.m, rel=1e-6)
    with pytest.raises(ChannelError, match="0 rows|no samples|0 sample"):
        whole.predict(np.zeros((0, 6)))


def test_half_a_base_is_none(chain2):
    names = feature_names(2, "absolute")
    frame = pd.DataFrame(np.hstack([chain2.X, 0 * chain2.X[:, :1]]), columns=[*names, "x0"])
    with pytest.raises(ChannelError, match="only one of the columns xdot0 and x0"):
        NRFRegressor(coordinates="absolute").fit(frame, chain2.F)


def test_a_band_leaves_an_unknown_force_unknown():
    """Floor 2 has an unknown force: the balance of floor 1 alone, in the band, gives m1 and both stiffnesses."""
    rec = record(8.0)
    force = rec.force * [1.0, np.nan]
    X, _ = rec.to_features(smooth=False)
    model = NRFRegressor(degree=1, dt=1 / FS, band=(3, 60), known_masses={2: 6.0}).fit(X.to_numpy(), force)
    assert model.masses_[0] == pytest.approx(8.0, rel=1e-3)
    assert np.isnan(FairFilter((3, 60), FS).apply(np.full((4000, 2), np.nan))).all()


def test_a_clock_in_the_index_of_a_table():
    rec = record(1.0)
    stamps = pd.to_datetime("2024-05-01") + pd.to_timedelta(rec.time, unit="s")
    again = Record.from_frame(rec.to_frame().set_axis(stamps))
    assert again.fs == pytest.approx(FS)
    np.testing.assert_array_equal(again.acceleration, rec.acceleration)


def test_a_file_of_numpys_third_format(tmp_path):
    """Names of fields beyond latin-1 make NumPy write version 3; it is read like the others."""
    fields = np.zeros(50, dtype=[("t", float), ("Δx", float)])
    fields["Δx"] = np.arange(50.0)
    with pytest.warns(UserWarning, match="format 3.0"), open(tmp_path / "log.npy", "wb") as file:
        np.save(file, fields)
    np.testing.assert_array_equal(read_table(tmp_path / "log.npy").variables["log.Δx"], np.arange(50.0))


def test_columns_of_words_and_gaps_are_numbers_where_they_are(tmp_path):
    pa = pytest.importorskip("pyarrow")
    import pyarrow.parquet as pq

    words = [f"{0.5 * k}" if k != 7 else None for k in range(40)]
    pq.write_table(pa.table({"t": np.arange(40) / 10, "x1": words}), tmp_path / "a.parquet")
    with pytest.raises(ChannelError, match="x1 of record 'a' is NaN in row 7"):
        read_record(tmp_path / "a.parquet")
    pq.write_table(pa.table({"t": np.arange(39) / 10, "x1": [None, *words[8:], *words[:6]]}), tmp_path / "a.parquet")
    found = read_record(tmp_path / "a.parquet").displacement[:, 0]
    np.testing.assert_array_equal(found[1:33], 0.5 * np.arange(8, 40))
    assert np.isnan(found[0])


# -- bases and readings -----------------------------------------------------------------------


def test_a_moving_base_that_was_measured_whole_is_taken_as_it_is():
    """vg and xg are there: no fusion is needed to make drifts of absolute motions."""
    t = np.arange(2000) / FS
    w = 2 * np.pi * 3.0
    xg, vg, ag = 1e-3 * np.sin(w * t), 1e-3 * w * np.cos(w * t), -1e-3 * w * w * np.sin(w * t)
    rec = record(4.0, ag)
    absolute = Record(
        acceleration=rec.acceleration, velocity=rec.velocity + vg[:, None], displacement=rec.displacement + xg[:, None],
        base_acceleration=ag, base_velocity=vg, base_displacement=xg, fs=FS, coordinates="absolute", name="table",
    )  # fmt: skip
    X, _ = to_features(absolute, False)
    np.testing.assert_allclose(X["s1"], rec.displacement[:, 0], atol=1e-12)
    np.testing.assert_allclose(X["v1"], rec.velocity[:, 0], atol=1e-12)


def test_the_papers_processing_of_a_shaken_frame_removes_the_base():
    """Absolute accelerations minus the base's, integrated: the relative velocity of the simulation."""
    t = np.arange(8000) / FS
    ag = np.sin(2 * np.pi * 4.0 * t) + 0.7 * np.sin(2 * np.pi * 7.3 * t)
    found = paper_processing(record(16.0, ag))
    truth = FairFilter((1.0, None), FS).apply(record(16.0, ag).velocity)
    inside = slice(3000, 5000)
    gap = found.velocity[inside] - truth[inside]
    assert np.nanstd(gap) < 0.05 * truth[inside].std()


def test_a_fault_of_a_sensor_leaves_other_laws_and_empty_channels_alone():
    rec = record(1.0)
    site = Site("sensor a1")
    shifted = as_read(rec, {site: [laws.SensorOffset(0.5)]})
    np.testing.assert_allclose(shifted.acceleration[:, 0], rec.acceleration[:, 0] + 0.5, atol=1e-12)
    bare = rec.replace(velocity=None)
    assert as_read(bare, {Site("sensor v1"): [laws.SensorOffset(0.5)]}).velocity is None
    quiet = rec.replace(force=rec.force * [0.0, 1.0])
    assert not as_read(quiet, {Site("sensor F1"): [laws.SensorOffset(0.5)]}).force[:, 0].any()  # known to be zero


# -- pieces -----------------------------------------------------------------------------------


def test_chunks_that_end_inside_a_row_group(chain2, tmp_path, monkeypatch):
    """Groups of 1000 rows, chunks of 300: from chunk 2 on, and an array of forces beside a file of motions."""
    monkeypatch.setattr(sources, "chunk_rows", lambda n_dof: 300)
    names = [*feature_names(2), "F1", "F2"]
    frame = pd.DataFrame(np.hstack([chain2.X, chain2.F]), columns=names)
    frame.to_parquet(tmp_path / "a.parquet", row_group_size=1000)
    late = np.vstack([chunk.X for chunk in open_source(tmp_path / "a.parquet").chunks(2)])
    np.testing.assert_array_equal(late, chain2.X[600:])
    np.save(tmp_path / "X.npy", chain2.X)
    np.testing.assert_allclose(NRFRegressor().fit(tmp_path / "X.npy", chain2.F).masses_, chain2.m, rtol=1e-8)


def test_dask_tables_side_by_side_and_what_they_refuse(chain2):
    da, dd, dask = (pytest.importorskip(name) for name in ("dask.array", "dask.dataframe", "dask"))
    X = pd.DataFrame(chain2.X, columns=feature_names(2))
    F = pd.DataFrame(chain2.F, columns=["F1", "F2"])
    with dask.config.set(scheduler="synchronous"):
        both = NRFRegressor().fit(dd.from_pandas(X, npartitions=3), dd.from_pandas(F, npartitions=3))
        np.testing.assert_allclose(both.masses_, chain2.m, rtol=1e-8)
        with pytest.raises(ChannelError, match="X has 3 partitions, F 2"):
            NRFRegressor().fit(dd.from_pandas(X, npartitions=3), dd.from_pandas(F, npartitions=2))
        with pytest.raises(ChannelError, match="F was given beside a table"):
            NRFRegressor().fit(dd.from_pandas(X, npartitions=3), chain2.F)
        with pytest.raises(ChannelError, match="X has 3 dimensions"):
            NRFRegressor().fit(da.zeros((10, 6, 2), chunks=5), None)
        x = da.from_array(chain2.X, chunks=(500, 6))
        unknown = x[x[:, 0] < np.inf]
        with pytest.raises(ChannelError, match="different partitions. .*compute_chunk_sizes"):
            NRFRegressor().fit(unknown, da.from_array(chain2.F, chunks=(1000, 2)))
        empty = da.concatenate([x, x[:0]])
        f = da.from_array(chain2.F, chunks=(500, 2))
        np.testing.assert_allclose(NRFRegressor().fit(empty, da.concatenate([f, f[:0]])).masses_, chain2.m, rtol=1e-8)


# -- small words ------------------------------------------------------------------------------


def test_units_ticks_and_settings_of_odd_values():
    assert unit_of(np.array([2e-9]), "m") == (1.0, "m") and unit_of(np.array([2e-3]), "m") == (1e3, "mm")
    assert ticks(np.full(9, 3.0)) == [] and len(ticks(np.linspace(-1, 1, 9))) >= 3
    said = settings_of(loop={"random_state": np.random.default_rng(0), "of": np.median})["loop"]
    assert said == {"random_state": "a PCG64 generator given by the caller", "of": "median"}


def test_a_page_lists_known_masses_to_four_digits():
    rec = record()
    model = NRFRegressor(degree=1, known_masses={1: 8.000049}).fit(*rec.to_features(smooth=False))
    page = of_model(model)
    rows = page.settings.rows
    assert any("known_masses" in row[1] and "8" in row[2] for row in rows)


def test_a_model_to_hold_must_be_given_and_a_shape_must_have_a_value():
    with pytest.raises(ChainError, match="There is no model to hold"):
        IdentifiedChain().fit(np.ones((9, 4)), np.ones((9, 2)))
    ps = pytest.importorskip("pysindy")
    from pysindy_nrf.regression.optimizers import StateSpaceChainOptimizer
    from pysindy_nrf.regression.state_space import from_sindy

    case = chains.duffing(1, [1], seed=3, n_samples=400, cubic=False)
    library = ForceLawLibrary({"storey 1": [laws.PowerSeries(1), laws.TwoSidedGap()]}, inputs="state")
    sindy = ps.SINDy(feature_library=library, optimizer=StateSpaceChainOptimizer())
    with pytest.raises(LawError, match="gap|shape"):
        sindy.fit(
            np.hstack([case.s, case.v]), t=case.dt, x_dot=np.hstack([case.v, case.a]), u=case.F
        )
        from_sindy(sindy)


def test_an_unknown_excitation_of_the_papers_frame():
    with pytest.raises(ChainError, match="excitation='full' is unknown. Choose 'complete' or 'incomplete'"):
        two_dof(excitation="full")


def test_memory_is_measured_inside_another_measurement():
    import tracemalloc

    tracemalloc.start()
    try:
        assert 7.9 < _peak(lambda: np.ones(1_000_000)) < 9.0
        assert tracemalloc.is_tracing()
    finally:
        tracemalloc.stop()


def test_the_free_run_fitted_to_clean_records_is_exact():
    """A force that is smooth between samples and no noise: masses to 1e-4, whatever of it the refinement did."""
    F = excitation.band_limited_random(2, 6.0, FS, dofs=[1, 2], rms=60.0, band=(1, 40), random_state=0)
    model = NRFRegressor(degree=1, estimation="simulation").fit(simulate(TRUTH, F, 1 / FS, hold="cubic"))
    np.testing.assert_allclose(model.masses_, [8.0, 6.0], rtol=1e-4)
    facts = model.model_.info["estimation"]
    assert facts["free_run_error_after"] <= facts["free_run_error_before"] < 0.1


@pytest.mark.parametrize(
    "time, words",
    [
        ([-1e308, 0.0, 1e308, 1.2e308], "which is no clock"),
        ([0.0, 1e-320, 2e-320, 3e-320], "which is no clock"),
        ([0.0, 1e-320, 2e-320, 1e308], "the clock is uneven"),
        ([0.0, 0.0, 0.0, 0.0], "stands still"),
    ],
)
def test_times_that_are_no_seconds_are_refused(time, words):
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        with pytest.raises(ChannelError, match=words):
            Record(displacement=np.sin(np.arange(4.0))[:, None], time=np.array(time))
