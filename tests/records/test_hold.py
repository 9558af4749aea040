"""The course of forces between their samples: said, kept, and found where it is not."""

import numpy as np
import pytest
from chains import driven

from pysindy_nrf import ChainModel, NRFRegressor, Record, laws
from pysindy_nrf.exceptions import ChannelError
from pysindy_nrf.records.hold import band_limited
from pysindy_nrf.records.input_arrays import from_arrays

MASSES = np.array([12.0, 10.0, 8.0])
STOREY = laws.PowerSeries(1, [30.0, 4e4])
TRUTH = ChainModel(MASSES, {1: STOREY, 2: STOREY, 3: STOREY})
FS = 200.0


def displacements(hold):
    """Displacements alone, under a force up to a tenth of the sampling rate."""
    record = driven(TRUTH, [2], 20.0, FS, 100.0, (0.5, 20.0), hold=hold)
    return record.replace(acceleration=None, velocity=None)


def test_a_record_keeps_what_it_says_of_its_forces():
    record = displacements("zero")
    assert record.hold == "zero"
    assert record.window(1.0, 2.0).hold == "zero"
    assert Record.from_frame(record.to_frame(), hold="linear").hold == "linear"
    with pytest.raises(ChannelError, match="hold='quintic' is unknown"):
        record.replace(hold="quintic")


@pytest.mark.parametrize("hold", ["cubic", "linear", "zero"])
@pytest.mark.parametrize("is_said", [True, False])
def test_masses_and_free_run_of_forces_of_every_course(hold, is_said):
    """Taken as band-limited, held forces give masses 4 % off and runs 14 %."""
    record = displacements(hold).replace(hold=hold if is_said else None)
    model = NRFRegressor(degree=1).fit(record)
    np.testing.assert_allclose(model.masses_, MASSES, rtol=0.01)
    assert model.free_runs().error < 3.0

    notes = [note for note in model.result_.data.quality if note.kind == "hold"]
    assert len(notes) == (not is_said and hold != "cubic")
    assert not any(note.is_fault for note in notes)


def test_a_force_that_comes_a_sample_late_is_not_held():
    record = displacements("cubic")
    late = np.vstack([record.force[:1], record.force[:-1]])
    data = NRFRegressor(degree=1).fit(record.replace(force=late, hold=None)).result_
    assert "hold" not in [note.kind for note in data.data.quality]


@pytest.mark.parametrize("hold", ["linear", "zero"])
def test_the_band_limited_force_has_the_response_of_the_hold(hold):
    """Of a harmonic in steady state: sinc squared, or sinc and half a sample."""
    w = 0.4  # radians a sample
    k = np.arange(200)
    force = np.cos(w * k)[:, None]
    sinc = np.sinc(w / (2 * np.pi))
    response = sinc**2 if hold == "linear" else sinc * np.exp(-0.5j * w)
    expected = (response * np.exp(1j * w * k)).real
    samples = band_limited(force, hold)[3:-3, 0]
    np.testing.assert_allclose(samples, expected[3:-3], atol=w**4 / 50)


def test_motions_that_are_given_are_run_with_band_limited_forces():
    X, F = displacements("cubic").to_features()
    assert from_arrays(X, F).segments[0].course == "cubic"
