"""A fitted model in a file that holds no code."""

import pysindy as ps
import pytest

from pysindy_nrf import NRFRegressor, datasets

sio = pytest.importorskip("skops.io")


@pytest.mark.parametrize("optimizer", [None, ps.STLSQ(threshold=0.01)])
def test_a_fitted_model_is_written_and_read_by_skops(optimizer):
    model = NRFRegressor(optimizer=optimizer).fit(datasets.load_demo())
    written = sio.dumps(model)
    trusted = sio.get_untrusted_types(data=written)
    # nothing but classes of the package, NumPy's and PySINDy's
    assert {name.split(".")[0] for name in trusted} <= {
        "pysindy_nrf",
        "pysindy",
        "numpy",
        "builtins",
        "collections",
        "types",
    }

    read = sio.loads(written, trusted=trusted)
    assert read.model_ == model.model_
    for name in ("errors_", "missing_terms_", "condition_", "third_law_gap_"):
        assert getattr(read, name).equals(getattr(model, name))
    assert read.problem_.known_masses == model.problem_.known_masses
