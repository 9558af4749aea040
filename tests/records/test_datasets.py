"""The bundled record gives its truth back; the measured sets come in SI units."""

import sys
from pathlib import Path

import measured
import measured_sets
import numpy as np
import pytest

from pysindy_nrf import NRFRegressor, datasets
from pysindy_nrf.exceptions import NRFError


def test_the_demo_record_gives_its_truth_back():
    model = NRFRegressor(degree=3).fit(datasets.load_demo())
    np.testing.assert_allclose(model.masses_, [12, 10, 8], rtol=0.01)
    found = [model.restoring_forces_[i].coefficients for i in (1, 2, 3)]
    np.testing.assert_allclose([c["s"] for c in found], [40e3, 35e3, 30e3], rtol=0.02)
    assert found[0]["s^3"] == pytest.approx(1.5e9, rel=0.01)


def test_the_demo_record_is_what_its_script_makes(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "benchmarks"))
    import make_demo_record

    sys.modules.pop("make_demo_record")
    made = make_demo_record.measure().to_frame()
    kept = datasets.load_demo().to_frame()[made.columns]
    assert np.allclose(made, kept, rtol=6e-4, atol=0)  # four digits are written


def test_no_folder_says_what_to_set(monkeypatch, tmp_path):
    monkeypatch.delenv("PYSINDY_NRF_DATA", raising=False)
    with pytest.raises(NRFError, match="PYSINDY_NRF_DATA"):
        measured_sets.load_emps()
    monkeypatch.setenv("PYSINDY_NRF_DATA", str(tmp_path / "nowhere"))
    with pytest.raises(NRFError, match="nowhere.*does not exist"):
        measured_sets.load_emps()
    with pytest.raises(NRFError, match="does not hold emps/DATA_EMPS.mat"):
        measured_sets.load_emps(tmp_path)


@pytest.mark.parametrize("test", ["fbgm162s1", "fbgm162s3", "fbgm162s5"])
def test_nees_units_agree_between_its_channels(test):
    """Inches twice differentiated are the g of the table."""
    from pysindy_nrf import ZeroPhaseFilter

    rec = measured_sets.load_nees_three_storey(
        test, measured.folder("nees_three_storey")
    )
    assert (
        rec.n_dof == 3
        and rec.coordinates == "absolute"
        and not rec.forced
        and rec.fs == pytest.approx(256, abs=0.01)
    )
    band = ZeroPhaseFilter((0.5, 6.0), rec.fs)
    ag = band.apply(rec.base_acceleration)
    twice = np.gradient(np.gradient(rec.base_displacement, rec.dt), rec.dt)
    again = band.apply(twice)
    assert again @ ag / (again @ again) == pytest.approx(1.0, abs=0.1)


def test_hotel_units_agree_between_its_channels():
    rec = measured_sets.load_six_storey_hotel(3, measured.folder("six_storey_hotel"))
    a = np.gradient(rec.velocity, rec.dt, axis=0)
    assert (a * rec.acceleration).sum() / (a**2).sum() == pytest.approx(1.0, abs=0.1)
    assert np.abs(rec.acceleration).max() < 10  # m/s^2


def test_dampers_dissipate():
    root = measured.folder("mr_damper_cyclic")
    runs = measured_sets.mr_damper_cyclic_runs(root)
    assert len(runs) == 82
    records = [measured_sets.load_mr_damper_cyclic(run, root) for run in runs[:5]]
    records.append(
        measured_sets.load_mr_damper_white_noise(
            measured.folder("mr_damper_white_noise")
        )
    )
    for rec in records:
        force = rec.force[:, 0] - rec.force[:, 0].mean()
        assert np.diff(rec.displacement[:, 0]) @ (force[1:] + force[:-1]) > 0, rec.name
        assert 1e-4 < np.abs(rec.displacement).max() < 0.1  # m
    assert "voltage" in records[-1].covariates


def test_a_damper_alone_is_a_chain_without_inertia():
    rec = measured_sets.load_mr_damper_cyclic(
        folder=measured.folder("mr_damper_cyclic")
    )
    model = NRFRegressor(degree=1, known_masses={1: 0.0})
    with pytest.warns(UserWarning):  # the offset and the hysteresis are missing
        model.fit(rec)
    X, F = rec.to_features()
    columns = X[["v1", "s1"]].to_numpy()
    np.testing.assert_allclose(
        model.restoring_forces_[1].coefficients,
        np.linalg.lstsq(columns, F["F1"].to_numpy(), rcond=None)[0],
        rtol=1e-9,
    )


def test_dry_friction_storey_is_shaken_at_two_hertz():
    rec = measured_sets.load_dry_friction_storey(measured.folder("dry_friction_storey"))
    spectrum = np.abs(np.fft.rfft(rec.base_displacement - rec.base_displacement.mean()))
    assert spectrum.argmax() * rec.fs / rec.n_samples == pytest.approx(1.99, abs=0.02)
    assert np.ptp(rec.displacement) < 0.05


def test_bouc_wen_benchmark():
    rec = measured_sets.load_bouc_wen_benchmark(
        "multisine", measured.folder("bouc_wen_benchmark")
    )
    assert (
        rec.n_samples == 8192
        and rec.fs == 750
        and np.sqrt(np.mean(rec.force**2)) == pytest.approx(50, rel=1e-3)
    )
