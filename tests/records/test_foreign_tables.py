"""Tables of other libraries, empty cells of nullable ones, rows drawn at random."""

from importlib import import_module

import numpy as np
import pandas as pd
import pytest
from sklearn.model_selection import ShuffleSplit, cross_val_score

from pysindy_nrf import NRFRegressor, datasets, laws
from pysindy_nrf.exceptions import ChannelError, LawError

X, F = datasets.load_demo().to_features()
X_ROWS, F_ROWS = X.reset_index(drop=True), F.reset_index(drop=True)
MASSES = NRFRegressor(degree=1).fit(X_ROWS, F_ROWS).masses_


def nullable():
    return X_ROWS.astype("Float64"), F_ROWS


def arrow():
    pyarrow = pytest.importorskip("pyarrow")
    return pyarrow.Table.from_pandas(X_ROWS), pyarrow.Table.from_pandas(F_ROWS)


def arrow_columns():
    pytest.importorskip("pyarrow")
    return X_ROWS.astype("double[pyarrow]"), F_ROWS


def polars():
    library = pytest.importorskip("polars")
    return library.from_pandas(X_ROWS), library.from_pandas(F_ROWS)


def xarray():
    library = pytest.importorskip("xarray")
    return library.DataArray(X.to_numpy()), F.to_numpy()


def xarray_with_names():
    library = pytest.importorskip("xarray")
    names = {"channel": [*X.columns[::-1]]}
    values = X.to_numpy()[:, ::-1]
    return library.DataArray(values, coords=names, dims=("t", "channel")), F.to_numpy()


TABLES = [nullable, arrow, arrow_columns, polars, xarray, xarray_with_names]


@pytest.mark.parametrize("table", TABLES)
def test_every_kind_of_table_gives_the_same_model(table):
    model = NRFRegressor(degree=1).fit(*table())
    np.testing.assert_allclose(model.masses_, MASSES, rtol=1e-12)


def test_empty_cells_of_a_nullable_table_are_not_measured():
    holed = X_ROWS.astype("Float64")
    holed.iloc[:20, 0] = pd.NA
    plain = X_ROWS.copy()
    plain.iloc[:20, 0] = np.nan
    first = NRFRegressor(degree=1).fit(holed, F_ROWS)
    second = NRFRegressor(degree=1).fit(plain, F_ROWS)
    np.testing.assert_allclose(first.masses_, second.masses_, rtol=1e-12)


def test_rows_drawn_at_random_from_a_table_with_a_time():
    splits = ShuffleSplit(2, random_state=0)
    scores = cross_val_score(
        NRFRegressor(degree=3), X, F, cv=splits, error_score="raise"
    )
    assert (scores > 0.99).all()


def test_a_halving_search_over_a_table_with_a_time():
    import_module("sklearn.experimental.enable_halving_search_cv")
    search = (
        import_module("sklearn.model_selection")
        .HalvingGridSearchCV(
            NRFRegressor(),
            {"degree": [1, 3]},
            cv=3,
            random_state=0,
            error_score="raise",
            min_resources=2000,
        )
        .fit(X, F)
    )
    assert search.best_params_ == {"degree": 3}


def test_a_law_that_remembers_the_path_takes_no_rows_at_random():
    rows = np.random.default_rng(0).permutation(len(X))
    model = NRFRegressor(degree=1, laws={"storey 1": [laws.Dahl()]})
    with pytest.raises((LawError, ChannelError)):
        model.fit(X.iloc[rows], F.iloc[rows])


def test_two_records_below_each_other_are_not_rows_at_random():
    twice = pd.concat([X, X]), pd.concat([F, F])
    with pytest.raises(ChannelError, match="does not increase"):
        NRFRegressor(degree=1).fit(*twice)


def test_ids_that_alternate_are_called_so():
    ids = np.tile(["x", "y"], len(X_ROWS) // 2)
    with pytest.raises(ChannelError, match="their rows alternate"):
        NRFRegressor(degree=1).fit(X.to_numpy(), F.to_numpy(), record=ids)
