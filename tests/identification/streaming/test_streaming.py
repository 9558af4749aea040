"""Fits in pieces give the answer of a fit in memory, for all sources and sizes."""

import pickle
import warnings

import chains
import numpy as np
import pandas as pd
import pytest
from chains import same, table

from pysindy_nrf import ChainModel, NRFRegressor, Parameter, laws, simulate
from pysindy_nrf.exceptions import ChainError, ChannelError, NRFError
from pysindy_nrf.identification.streaming import Chunk
from pysindy_nrf.records import Input, feature_names

pytestmark = [
    pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.NRFWarning"),
    pytest.mark.usefixtures("small_chunks"),
]


def in_pieces(rows, size=613):
    """Consecutive rows of a table or an array."""
    for start in range(0, len(rows), size):
        rows_of_piece = slice(start, start + size)
        yield rows.iloc[rows_of_piece] if hasattr(rows, "iloc") else rows[rows_of_piece]


# -- every way in --------------------------------------------------------------------


def as_npy(folder, X, F, dtype=np.float64):
    np.save(folder / "X.npy", X.astype(dtype))
    np.save(folder / "F.npy", F.astype(dtype))
    return folder / "X.npy", str(folder / "F.npy")


def as_single_precision(folder, X, F):
    return as_npy(folder, X, F, np.float32)


def as_parquet(folder, X, F):
    pytest.importorskip("pyarrow")
    path = folder / "test.parquet"
    table(X, F, note=1.0).to_parquet(path, row_group_size=450)
    return path, None


def as_matrices_in_hdf5(folder, X, F):
    h5py = pytest.importorskip("h5py")
    with h5py.File(folder / "test.h5", "w") as file:
        file["X"] = X
        file["F"] = F
    return folder / "test.h5", None


def as_columns_in_hdf5(folder, X, F):
    h5py = pytest.importorskip("h5py")
    with h5py.File(folder / "test.h5", "w") as file:
        for name, column in table(X, F).items():
            file[name] = column.to_numpy()
    return folder / "test.h5", None


def as_tables(folder, X, F):
    return in_pieces(table(X, F)), None


def as_pairs(folder, X, F):
    return zip(in_pieces(X), in_pieces(F)), None


def as_several_files(folder, X, F):
    paths = {"X": [], "F": []}
    for i, rows in enumerate(np.split(np.arange(len(X)), 3)):
        for name, values in (("X", X), ("F", F)):
            path = folder / f"{name}{i}.npy"
            np.save(path, values[rows])
            paths[name].append(path)
    return paths["X"], paths["F"]


WAYS = [
    as_npy,
    as_single_precision,
    as_parquet,
    as_matrices_in_hdf5,
    as_columns_in_hdf5,
    as_tables,
    as_pairs,
    as_several_files,
]


@pytest.fixture(scope="module")
def intervals(in_memory):
    return in_memory.confidence_intervals()


@pytest.mark.parametrize("way", WAYS)
def test_every_way_in_gives_the_answer_of_the_arrays(
    way, data, in_memory, intervals, tmp_path
):
    reference = in_memory
    if way is as_single_precision:
        rounded = [x.astype(np.float32).astype(float) for x in data]
        reference = NRFRegressor().fit(*rounded)

    model = NRFRegressor().fit(*way(tmp_path, *data))

    same(model, reference, 1e-11)
    assert model.predict(data[0][:50]).shape == (50, 3)
    assert not list(tmp_path.glob(".*")), "a fit that is done leaves no state behind"

    table_of_intervals = model.confidence_intervals()
    width = (table_of_intervals["upper"] - table_of_intervals["lower"])[:3]
    expected = (intervals["upper"] - intervals["lower"])[:3]
    assert np.allclose(width, expected, rtol=0.5)

    assert list(model.missing_terms_.index) == list(reference.missing_terms_.index)
    region = model.model_.visited["storey 2"]
    truth = reference.model_.visited["storey 2"]
    assert region.low == pytest.approx(truth.low)
    assert region.high == pytest.approx(truth.high)


def test_digits_that_squaring_would_lose_come_back(tmp_path):
    """Noise-free data at ratios that Gram matrices cannot hold: a second pass by QR."""
    case = chains.duffing(3, [1, 2, 3], seed=4, n_samples=6000)
    files = as_npy(tmp_path, case.X, case.F)
    assert chains.worst(NRFRegressor(degree=5).fit(*files).masses_, case.m) < 1e-9

    once = zip(in_pieces(case.X, 700), in_pieces(case.F, 700))
    assert chains.worst(NRFRegressor(degree=5).fit(once).masses_, case.m) < 1e-9


def test_a_base_that_moves_is_solved_from_the_top_down():
    rng = np.random.default_rng(1)
    ag = chains.band_limited(5000, 1e-3, rng, 2.0)
    case = chains.duffing(3, [], seed=5, n_samples=5000, ag=ag)
    chunks = (Chunk(Input(X)) for X in in_pieces(case.X, 900))

    model = NRFRegressor(known_masses=dict(enumerate(case.m, 1))).fit(chunks)

    for i in (1, 2, 3):
        stiffness = model.restoring_forces_[i].coefficients["s"]
        assert stiffness == pytest.approx(case.k[i - 1], rel=1e-7)


def test_a_moving_base_in_absolute_coordinates_has_its_own_columns(exact):
    """Drift of storey 1 is x1 - x0, as in memory."""
    t = np.arange(2000) * 1e-3
    x0 = 1e-3 * np.sin(9 * t)
    xdot0 = 9e-3 * np.cos(9 * t)
    x = np.cumsum(exact.s, axis=1) + x0[:, None]
    v = np.cumsum(exact.v, axis=1) + xdot0[:, None]
    columns = np.hstack([exact.a, v, x, exact.F])
    names = [*feature_names(2, "absolute"), "F1", "F2"]
    frame = pd.DataFrame(columns, columns=names).assign(xdot0=xdot0, x0=x0)

    model = NRFRegressor(coordinates="absolute").fit(iter([frame[:700], frame[700:]]))

    assert chains.worst(model.masses_, exact.m) < 1e-8


def test_constraints_hold_in_a_fit_by_pieces(exact, tmp_path):
    """The constrained optimum of the arrays, with a total that is 10 % too large."""
    total = 1.1 * exact.m.sum()
    estimator = NRFRegressor(constraints={"m1 + m2": Parameter(total)})
    pieces = estimator.fit(*as_npy(tmp_path, exact.X, exact.F)).masses_
    assert pieces.sum() == pytest.approx(total, rel=1e-9)
    masses = estimator.fit(exact.X, exact.F).masses_
    np.testing.assert_allclose(pieces, masses, rtol=1e-5)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"band": (1, 50), "dt": 1e-3}, "band="),
        ({"estimation": "iv"}, "estimation='iv'"),
        ({"laws": {"storey 1": laws.Dahl()}, "dt": 1e-3}, "no value for sigma"),
    ],
)
def test_settings_that_need_whole_records_are_refused(exact, settings, words):
    with pytest.raises(ChainError, match=words):
        NRFRegressor(**settings).fit(iter([table(exact.X, exact.F)]))


# -- records that come one by one ----------------------------------------------------


@pytest.fixture(scope="module")
def roving_hammer():
    """Three records, each of which forces one DOF of the same chain."""
    first = chains.each_single(3, seed=3)[0]
    parameters = (first.m, first.c, first.k, first.k3)
    return [
        chains.duffing(3, [j], seed=j, parameters_of_chain=parameters)
        for j in (1, 2, 3)
    ]


def test_records_that_are_added_reach_every_mass(roving_hammer):
    """Only all records together are complete; a pickle between two calls is no loss."""
    first, second, third = roving_hammer
    model = NRFRegressor().partial_fit(third.X, third.F)
    assert model.solve_order_.strategy == "sequential"
    for case in (first, second):
        model = pickle.loads(pickle.dumps(model)).partial_fit(case.X, case.F)
    assert model.solve_order_.strategy == "joint"
    assert chains.worst(model.masses_, first.m) < 1e-9

    order = (third, first, second)
    X = np.vstack([case.X for case in order])
    F = np.vstack([case.F for case in order])
    pooled = NRFRegressor().fit(X, F, record=np.repeat([3, 1, 2], 3000))
    assert chains.worst(model.masses_, pooled.masses_) < 1e-9
    assert model.n_samples_ == 9000


def test_other_settings_between_two_calls_are_refused(roving_hammer):
    case = roving_hammer[2]
    model = NRFRegressor().partial_fit(case.X, case.F)
    with pytest.raises(NRFError, match="settings"):
        model.set_params(degree=2).partial_fit(case.X, case.F)
    assert model.fit(case.X, case.F).n_samples_ == 3000, "fit begins anew"


def test_partial_fit_takes_records_and_refuses_another_chain(chain2, chain4):
    record = chain2.record()
    records = [
        record.rows(slice(0, 1000)).replace(name="one"),
        record.rows(slice(1000, 2000)).replace(name="two"),
    ]
    model = NRFRegressor().partial_fit(records[0]).partial_fit([records[1]])
    same(model, NRFRegressor().fit(records), 1e-8)
    with pytest.raises(ChannelError, match="12 columns.*6 are needed"):
        model.partial_fit(chain4.X, chain4.F)


# -- laws that remember the path -----------------------------------------------------

REMEMBERING = {
    "storey 1": [laws.LinearElastic(), laws.LinearViscous(), laws.Dahl(sigma=900.0)],
    "storey 2": [laws.LinearElastic(), laws.MaxwellBranch(tau=0.3)],
}


@pytest.fixture(scope="module")
def path_dependent():
    """Motions and forces of a Dahl element and a relaxing one."""
    truth = ChainModel(
        [10.0, 12.0],
        {
            "storey 1": (
                laws.LinearElastic(9e4),
                laws.LinearViscous(80.0),
                laws.Dahl(sigma=900.0, Fd=60.0),
            ),
            "storey 2": (laws.LinearElastic(7e4), laws.MaxwellBranch(tau=0.3, k=2e4)),
        },
    )
    rng = np.random.default_rng(3)
    force = [chains.band_limited(6000, 1e-3, rng, 200.0) for _ in range(2)]
    X, F = simulate(truth, np.column_stack(force), 1e-3).to_features(smooth=False)
    return X.to_numpy(), F.to_numpy()


@pytest.fixture(scope="module")
def remembering(path_dependent):
    with warnings.catch_warnings(action="ignore"):
        return NRFRegressor(laws=REMEMBERING, dt=1e-3).fit(*path_dependent)


@pytest.mark.parametrize("clock", ["dt", "column", "dates"])
def test_a_law_that_remembers_goes_on_from_chunk_to_chunk(
    clock, path_dependent, remembering
):
    """A state that starts anew in each of nine chunks would miss the coefficients."""
    t = 5.0 + np.arange(6000) / 1000
    frame = table(*path_dependent)
    step = None
    tolerance = 1e-9
    if clock == "dt":
        step = 1e-3
    elif clock == "column":
        frame["t"] = t
    else:
        tolerance = 1e-6
        nanoseconds = np.round(t * 1e9)
        dates = pd.Timestamp("2024-05-01") + pd.to_timedelta(nanoseconds, unit="ns")
        frame.index = dates

    model = NRFRegressor(laws=REMEMBERING, dt=step).fit(in_pieces(frame, 700))

    same(model, remembering, tolerance)
    friction = model.restoring_forces_[1].coefficients["Z"]
    assert friction == pytest.approx(60.0, rel=1e-3)
    branch = model.restoring_forces_[2].coefficients.iloc[-1]
    assert branch == pytest.approx(2e4, rel=1e-3)


def test_time_must_go_on_from_piece_to_piece(exact):
    t = np.arange(2000) * 1e-3
    pieces = [
        table(exact.X[:1000], exact.F[:1000], t=t[:1000]),
        table(exact.X[1000:], exact.F[1000:], t=t[900:1900]),
    ]
    law_of_time = [laws.PowerSeries(3), laws.HarmonicForce(frequency=1.5)]
    with pytest.raises(ChannelError, match="does not increase"):
        NRFRegressor(laws={"storey 1": law_of_time}).fit(iter(pieces))


# -- NaN -----------------------------------------------------------------------------


def test_nan_edges_of_a_record_are_masked(data):
    X, F = (x.copy() for x in data)
    X[:1200, 2] = np.nan  # more than two whole chunks
    F[-70:] = np.nan
    model = NRFRegressor().fit(in_pieces(table(X, F), 500))
    assert model.n_samples_ == 6000 - 1270
    same(model, NRFRegressor().fit(X, F), 1e-11)


def test_a_hole_in_a_record_is_refused(data):
    X, F = (x.copy() for x in data)
    X[3000:3500] = np.nan
    with pytest.raises(ChannelError, match="NaN about row 3.00, between finite rows"):
        NRFRegressor().fit(in_pieces(table(X, F), 500))

    ids = np.where(np.arange(6000) < 3200, "before", "after")
    model = NRFRegressor().fit(in_pieces(table(X, F, record=ids), 500))
    assert model.n_samples_ == 6000 - 500


def test_a_force_may_be_unknown_in_some_records_alone(data):
    X, F = (x.copy() for x in data)
    F[3000:, 1] = np.nan
    ids = np.repeat(["a", "b"], 3000)
    frame = table(X, F, record=ids)
    model = NRFRegressor().fit(in_pieces(frame, 500))
    same(model, NRFRegressor().fit(X, F, record=ids), 1e-11)
    assert list(model.unknown_forces_.columns) == ["F2"]

    one_record = frame.drop(columns="record")
    with pytest.raises(ChannelError, match="F2 of record"):
        NRFRegressor().fit(in_pieces(one_record, 500))
