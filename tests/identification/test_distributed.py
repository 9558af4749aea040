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
from pysindy_nrf.records.dataset import feature_names

dask = pytest.importorskip("dask")
distributed = pytest.importorskip("distributed")
da = pytest.importorskip("dask.array")

pytestmark = pytest.mark.filterwarnings("ignore")


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    with dask.config.set(
        {"distributed.worker.daemon": True, "distributed.comm.timeouts.connect": "60s"}
    ):
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


@pytest.mark.slow
def test_arrays_in_uneven_partitions(client, data, in_memory):
    X, F = data
    parts = (
        da.from_array(X, chunks=((700, 1300, 1, 2999, 1000), (4, 5))),
        da.from_array(F, chunks=(2000, 3)),
    )
    model = NRFRegressor().fit(*parts)
    same(model, in_memory)
    assert model.predict(X[:10]).shape == (10, 3)
    assert (
        model.confidence_intervals()["upper"] > model.confidence_intervals()["lower"]
    ).all()


def test_record_ids_beside_arrays(data):
    """The second record's force on DOF 2 is unknown; a partition holds the end of one
    record and the start of the other.
    """
    X, F = (np.array(x) for x in data)
    F[2500:, 1] = np.nan
    ids = np.repeat([0, 1], [2500, 3500])
    with dask.config.set(scheduler="synchronous"):
        model = NRFRegressor().fit(
            da.from_array(X, chunks=(1000, 9)),
            da.from_array(F, chunks=(1000, 3)),
            record=ids,
        )
        with pytest.raises(
            ChannelError, match="F2 of record"
        ):  # one record cannot know it in parts
            NRFRegressor().fit(
                da.from_array(X, chunks=(1250, 9)), da.from_array(F, chunks=(1250, 3))
            )
    same(model, NRFRegressor().fit(X, F, record=ids))
    assert model.n_samples_ == 6000 and list(model.unknown_forces_.columns) == ["F2"]


@pytest.mark.slow
def test_delayed_records_of_a_roving_hammer(client):
    """Record j forces DOF j alone, and only its worker ever holds it; the answer is
    that of one list of records.
    """
    first = chains.duffing(3, [1], seed=1)
    given = first.m, first.c, first.k, first.k3

    cases = (
        chains.duffing(3, [j], seed=j, given=given, n_samples=2000) for j in (1, 2, 3)
    )
    records = [case.record(name=f"hit {j}") for j, case in enumerate(cases, 1)]
    model = NRFRegressor().fit([dask.delayed(record) for record in records])
    reference = NRFRegressor().fit(records)
    assert model.solve_order_.strategy == "joint"
    same(model, reference, 1e-8)
    assert chains.worst(model.masses_, first.m) < 0.01


@pytest.mark.slow
def test_a_worker_that_is_killed_loses_nothing(client, data, in_memory, tmp_path):
    X, F = data
    mark = tmp_path / "killed"

    def piece(low, die):
        time.sleep(0.05)
        if die and not os.path.exists(mark):
            Path(mark).write_text(str(os.getpid()))
            os.kill(os.getpid(), signal.SIGKILL)
        return table(X[low : low + 500], F[low : low + 500])

    before = set(client.run(os.getpid).values())
    from_delayed = pytest.importorskip("dask.dataframe").from_delayed
    frame = from_delayed(
        [dask.delayed(piece)(low, low == 3000) for low in range(0, 6000, 500)],
        meta=table(X[:0], F[:0]),
    )
    same(NRFRegressor().fit(frame), in_memory)
    assert int(mark.read_text()) in before, "it was one of the workers that died"


def test_what_does_not_fit_together_says_so(data, monkeypatch):
    X, F = data
    x = da.from_array(X, chunks=(1000, 9))
    with pytest.raises(ChannelError, match="F has 5999 samples, X has 6000"):
        NRFRegressor().fit(x, F[:-1])
    with pytest.raises(LawError, match="remembers the path"):
        NRFRegressor(laws={"storey 1": laws.Dahl(sigma=10.0)}, dt=1e-3).fit(x, F)
    monkeypatch.setitem(sys.modules, "dask", None)  # as where it is not installed
    with pytest.raises(MissingExtraError, match=r"pysindy_nrf\[dask\]"):
        NRFRegressor().fit(x, F)


def test_dask_tables_side_by_side_and_those_that_are_refused(chain2):
    da, dd, dask = (
        pytest.importorskip(name) for name in ("dask.array", "dask.dataframe", "dask")
    )
    X = pd.DataFrame(chain2.X, columns=feature_names(2))
    F = pd.DataFrame(chain2.F, columns=["F1", "F2"])
    x, f = (
        da.from_array(chain2.X, chunks=(500, 6)),
        da.from_array(chain2.F, chunks=(500, 2)),
    )
    three = dd.from_pandas(X, npartitions=3)
    with dask.config.set(scheduler="synchronous"):
        for both in (
            (three, dd.from_pandas(F, npartitions=3)),
            [da.concatenate([part, part[:0]]) for part in (x, f)],
        ):
            np.testing.assert_allclose(
                NRFRegressor().fit(*both).masses_, chain2.m, rtol=1e-8
            )
        for both, words in (
            ((three, dd.from_pandas(F, npartitions=2)), "X has 3 partitions, F 2"),
            ((three, chain2.F), "F was given beside a table"),
            ((da.zeros((10, 6, 2), chunks=5), None), "X has 3 dimensions"),
            (
                (x[x[:, 0] < np.inf], da.from_array(chain2.F, chunks=(1000, 2))),
                "different partitions. .*compute_chunk_sizes",
            ),
        ):
            with pytest.raises(ChannelError, match=words):
                NRFRegressor().fit(*both)
