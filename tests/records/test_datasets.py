"""The bundled record gives its truth back; the measured sets come in SI units."""

import make_demo_record
import measured
import measured_sets
import numpy as np
import pytest

from pysindy_nrf import NRFRegressor, ZeroPhaseFilter, datasets
from pysindy_nrf.exceptions import NRFError


def test_the_demo_record_gives_its_truth_back():
    model = NRFRegressor(degree=3).fit(datasets.load_demo())
    np.testing.assert_allclose(model.masses_, [12, 10, 8], rtol=0.01)
    storeys = [model.restoring_forces_[i].coefficients for i in (1, 2, 3)]
    stiffness = [storey["s"] for storey in storeys]
    np.testing.assert_allclose(stiffness, [40e3, 35e3, 30e3], rtol=0.02)
    assert storeys[0]["s^3"] == pytest.approx(1.5e9, rel=0.01)


def test_the_demo_record_is_what_its_script_makes():
    made = make_demo_record.measure().to_frame()
    bundled = datasets.load_demo().to_frame()[made.columns]
    np.testing.assert_allclose(bundled, made, rtol=6e-4)  # four digits are written


def test_a_missing_folder_says_what_to_set(monkeypatch, tmp_path):
    monkeypatch.delenv("PYSINDY_NRF_DATA", raising=False)
    with pytest.raises(NRFError, match="PYSINDY_NRF_DATA"):
        measured_sets.load_emps()
    monkeypatch.setenv("PYSINDY_NRF_DATA", str(tmp_path / "nowhere"))
    with pytest.raises(NRFError, match="nowhere.*does not exist"):
        measured_sets.load_emps()
    with pytest.raises(NRFError, match="does not hold emps/DATA_EMPS.mat"):
        measured_sets.load_emps(tmp_path)


def rms(line):
    return np.sqrt(np.mean(line**2))


@pytest.mark.parametrize("test", ["fbgm162s1", "fbgm162s3", "fbgm162s5"])
def test_nees_units_agree_between_its_channels(test):
    """Inches twice differentiated are the g of the table."""
    folder = measured.folder("nees_three_storey")
    record = measured_sets.load_nees_three_storey(test, folder)
    assert record.n_dof == 3
    assert record.coordinates == "absolute"
    assert not record.forced
    assert record.fs == pytest.approx(256, abs=0.01)

    band = ZeroPhaseFilter((0.5, 6.0), record.fs)
    velocity = np.gradient(record.base_displacement, record.dt)
    derived = band.apply(np.gradient(velocity, record.dt))
    ag = band.apply(record.base_acceleration)
    assert derived @ ag / (derived @ derived) == pytest.approx(1.0, abs=0.1)


def test_hotel_units_agree_between_its_channels():
    folder = measured.folder("six_storey_hotel")
    record = measured_sets.load_six_storey_hotel(3, folder)
    derived = np.gradient(record.velocity, record.dt, axis=0)
    ratio = (derived * record.acceleration).sum() / (derived**2).sum()
    assert ratio == pytest.approx(1.0, abs=0.1)
    assert np.abs(record.acceleration).max() < 10  # m/s^2


def require_dissipation(record):
    force = record.force[:, 0] - record.force[:, 0].mean()
    mean_force = (force[1:] + force[:-1]) / 2
    assert np.diff(record.displacement[:, 0]) @ mean_force > 0
    assert 1e-4 < np.abs(record.displacement).max() < 0.1  # m


def test_cyclic_dampers_dissipate():
    folder = measured.folder("mr_damper_cyclic")
    runs = measured_sets.mr_damper_cyclic_runs(folder)
    assert len(runs) == 82
    for run in runs[:5]:
        require_dissipation(measured_sets.load_mr_damper_cyclic(run, folder))


def test_a_damper_under_white_noise_dissipates():
    folder = measured.folder("mr_damper_white_noise")
    record = measured_sets.load_mr_damper_white_noise(folder)
    require_dissipation(record)
    assert "voltage" in record.covariates


def test_a_damper_alone_is_a_chain_without_inertia():
    folder = measured.folder("mr_damper_cyclic")
    record = measured_sets.load_mr_damper_cyclic(folder=folder)
    model = NRFRegressor(degree=1, known_masses={1: 0.0})
    with pytest.warns(UserWarning):  # the offset and the hysteresis are missing
        model.fit(record)

    X, F = record.to_features()
    columns = X[["v1", "s1"]].to_numpy()
    expected = np.linalg.lstsq(columns, F["F1"].to_numpy(), rcond=None)[0]
    coefficients = model.restoring_forces_[1].coefficients
    np.testing.assert_allclose(coefficients, expected, rtol=1e-9)


def test_dry_friction_storey_is_shaken_at_two_hertz():
    folder = measured.folder("dry_friction_storey")
    record = measured_sets.load_dry_friction_storey(folder)
    base = record.base_displacement - record.base_displacement.mean()
    line = np.abs(np.fft.rfft(base)).argmax()
    assert line * record.fs / record.n_samples == pytest.approx(1.99, abs=0.02)
    assert np.ptp(record.displacement) < 0.05  # m


def test_bouc_wen_benchmark_is_as_published():
    folder = measured.folder("bouc_wen_benchmark")
    record = measured_sets.load_bouc_wen_benchmark("multisine", folder)
    assert record.n_samples == 8192
    assert record.fs == 750
    assert rms(record.force) == pytest.approx(50, rel=1e-3)
