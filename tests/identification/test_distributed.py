"""Fits on Dask collections, on a cluster of two processes: the answer of the arrays,
also when a worker dies.
"""

import os
import signal
import sys
import time
from pathlib import Path

import chains
import numpy as np
import pandas as pd
import pytest
from chains import same, table

from pysindy_nrf import NRFRegressor, laws
from pysindy_nrf.exceptions import ChannelError, LawError, MissingExtraError
from pysindy_nrf.records import feature_names

dask = pytest.importorskip("dask")
distributed = pytest.importorskip("distributed")
da = pytest.importorskip("dask.array")
dd = pytest.importorskip("dask.dataframe")

pytestmark = pytest.mark.filterwarnings("ignore")


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    settings = {
        "distributed.worker.daemon": True,
        "distributed.comm.timeouts.connect": "60s",
    }
    with dask.config.set(settings):
        cluster = distributed.LocalCluster(
            n_workers=2,
            threads_per_worker=1,
            processes=True,
            dashboard_address=None,
            local_directory=str(tmp_path_factory.mktemp("workers")),
            silence_logs=50,
        )
        with cluster, distributed.Client(cluster) as client:
            yield client


@pytest.fixture
def in_this_thread():
    with dask.config.set(scheduler="synchronous"):
        yield


# -- on a cluster --------------------------------------------------------------------


@pytest.mark.slow
def test_arrays_in_uneven_partitions(client, data, in_memory):
    X, F = data
    rows = (700, 1300, 1, 2999, 1000)
    x = da.from_array(X, chunks=(rows, (4, 5)))
    f = da.from_array(F, chunks=(2000, 3))
    model = NRFRegressor().fit(x, f)
    same(model, in_memory)
    assert model.predict(X[:10]).shape == (10, 3)
    ci = model.confidence_intervals()
    assert (ci["upper"] > ci["lower"]).all()


@pytest.mark.slow
def test_delayed_records_of_a_roving_hammer(client):
    """Record j forces DOF j alone, and only its worker ever has it."""
    first = chains.duffing(3, [1], seed=1)
    parameters = (first.m, first.c, first.k, first.k3)
    records = []
    for j in (1, 2, 3):
        case = chains.duffing(
            3, [j], seed=j, parameters_of_chain=parameters, n_samples=2000
        )
        records.append(case.record(name=f"hit {j}"))

    model = NRFRegressor().fit([dask.delayed(record) for record in records])

    assert model.solve_order_.strategy == "joint"
    same(model, NRFRegressor().fit(records), 1e-8)
    assert chains.worst(model.masses_, first.m) < 0.01


@pytest.mark.slow
def test_a_worker_that_is_killed_loses_nothing(client, data, in_memory, tmp_path):
    X, F = data
    mark = tmp_path / "killed"

    def piece(start, deadly):
        time.sleep(0.05)
        if deadly and not os.path.exists(mark):
            Path(mark).write_text(str(os.getpid()))
            os.kill(os.getpid(), signal.SIGKILL)
        return table(X[start : start + 500], F[start : start + 500])

    workers = set(client.run(os.getpid).values())
    pieces = [
        dask.delayed(piece)(start, start == 3000) for start in range(0, 6000, 500)
    ]
    frame = dd.from_delayed(pieces, meta=table(X[:0], F[:0]))
    same(NRFRegressor().fit(frame), in_memory)
    assert int(mark.read_text()) in workers, "it was one of the workers that died"


# -- partitions ----------------------------------------------------------------------


@pytest.mark.usefixtures("in_this_thread")
def test_record_ids_beside_arrays(data):
    """A partition has the end of one record and the start of the other, whose force on
    DOF 2 is unknown.
    """
    X, F = (x.copy() for x in data)
    F[2500:, 1] = np.nan
    ids = np.repeat([0, 1], [2500, 3500])
    x = da.from_array(X, chunks=(1000, 9))
    f = da.from_array(F, chunks=(1000, 3))
    model = NRFRegressor().fit(x, f, record=ids)
    same(model, NRFRegressor().fit(X, F, record=ids))
    assert model.n_samples_ == 6000
    assert list(model.unknown_forces_.columns) == ["F2"]


@pytest.mark.usefixtures("in_this_thread")
def test_one_record_cannot_know_a_force_in_parts(data):
    X, F = (x.copy() for x in data)
    F[2500:, 1] = np.nan
    x = da.from_array(X, chunks=(1250, 9))
    f = da.from_array(F, chunks=(1250, 3))
    with pytest.raises(ChannelError, match="F2 of record"):
        NRFRegressor().fit(x, f)


@pytest.fixture(scope="module")
def tables(chain2):
    X = pd.DataFrame(chain2.X, columns=feature_names(2))
    return X, pd.DataFrame(chain2.F, columns=["F1", "F2"])


@pytest.mark.usefixtures("in_this_thread")
def test_tables_side_by_side(chain2, tables):
    x, f = (dd.from_pandas(frame, npartitions=3) for frame in tables)
    masses = NRFRegressor().fit(x, f).masses_
    np.testing.assert_allclose(masses, chain2.m, rtol=1e-8)


@pytest.mark.usefixtures("in_this_thread")
def test_a_partition_may_be_empty(chain2):
    x = da.from_array(chain2.X, chunks=(500, 6))
    f = da.from_array(chain2.F, chunks=(500, 2))
    x = da.concatenate([x, x[:0]])
    f = da.concatenate([f, f[:0]])
    np.testing.assert_allclose(NRFRegressor().fit(x, f).masses_, chain2.m, rtol=1e-8)


# -- what is refused -----------------------------------------------------------------


def test_other_partitions_are_refused(chain2, tables):
    x, f = (dd.from_pandas(frame, npartitions=n) for frame, n in zip(tables, (3, 2)))
    with pytest.raises(ChannelError, match="X has 3 partitions, F 2"):
        NRFRegressor().fit(x, f)
    with pytest.raises(ChannelError, match="F was given in addition to a table"):
        NRFRegressor().fit(x, chain2.F)

    of_unknown_length = da.from_array(chain2.X, chunks=(500, 6))
    of_unknown_length = of_unknown_length[of_unknown_length[:, 0] < np.inf]
    forces = da.from_array(chain2.F, chunks=(1000, 2))
    with pytest.raises(ChannelError, match="compute_chunk_sizes"):
        NRFRegressor().fit(of_unknown_length, forces)


def test_other_shapes_are_refused(data):
    X, F = data
    x = da.from_array(X, chunks=(1000, 9))
    with pytest.raises(ChannelError, match="F has 5999 samples, X has 6000"):
        NRFRegressor().fit(x, F[:-1])
    with pytest.raises(ChannelError, match="X has 3 dimensions"):
        NRFRegressor().fit(da.zeros((10, 6, 2), chunks=5))


def test_a_law_that_remembers_the_path_needs_whole_records(data):
    X, F = data
    model = NRFRegressor(laws={"storey 1": laws.Dahl(sigma=10.0)}, dt=1e-3)
    with pytest.raises(LawError, match="remembers the path"):
        model.fit(da.from_array(X, chunks=(1000, 9)), F)


def test_dask_that_is_not_installed_is_named(data, monkeypatch):
    X, F = data
    x = da.from_array(X, chunks=(1000, 9))
    monkeypatch.setitem(sys.modules, "dask", None)
    with pytest.raises(MissingExtraError, match=r"pysindy_nrf\[dask\]"):
        NRFRegressor().fit(x, F)
