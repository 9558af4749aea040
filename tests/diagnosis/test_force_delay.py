"""A force that comes late against the motion is found to a fraction of a sample."""

import pickle
from dataclasses import dataclass
from functools import cache

import integrated
import numpy as np
import pytest
from chains import driven
from scipy.interpolate import CubicSpline

from pysindy_nrf import ChainModel, NRFRegressor, Record, excitation, laws, simulate
from pysindy_nrf.diagnosis import force_delay
from pysindy_nrf.exceptions import ChannelError
from pysindy_nrf.simulation import add_noise

pytestmark = pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.NRFWarning")

FS = 1000.0
MASSES = [10.0, 12.0]
DAMPING = 60.0
STIFFNESS = 1e5
STOREY = laws.PowerSeries(1, [DAMPING, STIFFNESS])
TRUTH = ChainModel(MASSES, {1: STOREY, 2: STOREY})


def pushed(dofs=(1, 2), noise=0.0):
    """Two floors under random forces."""
    record = driven(TRUTH, dofs, 8.0, FS, 100.0, (0.5, 60.0), hold="cubic")
    return add_noise(record, noise, random_state=1) if noise else record


def hammered():
    """Six blows on both floors, without noise."""
    F = excitation.impact_hammer(
        2, 8.0, FS, excited=(1, 2), level=500.0, n_hits=6, random_state=0
    )
    return simulate(TRUTH, F, 1 / FS, hold="cubic")


def shifted(signal, n_samples):
    """A signal later by a number of samples that need not be whole; zero outside."""
    samples = np.arange(len(signal))
    line = CubicSpline(samples, signal, extrapolate=False)
    return np.nan_to_num(line(samples - n_samples))


def late(record, n_samples):
    """The record with all forces late by whole samples."""
    return record.replace(force=np.roll(record.force, n_samples, axis=0))


def fit(*data):
    return NRFRegressor(degree=1).fit(*data)


@pytest.mark.parametrize("delay", [0.0, 2.4, -3.0])
@pytest.mark.parametrize("kind", ["random", "hammer"])
def test_the_delay_comes_back(kind, delay):
    record = pushed(noise=0.1) if kind == "random" else hammered()
    force = record.force.copy()
    force[:, 1] = shifted(force[:, 1], delay)

    table = force_delay(fit(record.replace(force=force)))

    row = table.loc["F2"]
    tolerance = max(0.05, 4 * row["error"])
    assert row["samples"] == pytest.approx(delay, abs=tolerance)
    assert row["delay"] == pytest.approx(delay * 1e-3, abs=2e-4)
    assert row["aligned"] == (delay == 0)
    assert table.loc["F1", "aligned"]


def test_the_diagnosis_names_a_late_channel():
    table = fit(late(pushed([2]), 4)).diagnose().table.set_index("limit")

    message = table.loc["delay", "message"]
    milliseconds = float(message.split(" ms")[0].removeprefix("F2 is "))
    assert milliseconds == pytest.approx(4.0, abs=0.02)


def test_the_diagnosis_names_no_force_in_time():
    assert "delay" not in set(fit(pushed([2])).diagnose().table["limit"])


def test_what_the_band_of_the_fit_takes_out_gives_no_delay():
    """A constant in x2 ruins the equations, but not within a band without it."""
    record = pushed(noise=0.02).replace(velocity=None)
    x = record.displacement
    offset = [0.0, 2.0 * x[:, 1].std()]
    regressor = NRFRegressor(degree=1, band=(1, 60))
    model = regressor.fit(record.replace(displacement=x + offset))

    table = force_delay(model)

    assert model.masses_ == pytest.approx(MASSES, rel=0.05)
    assert table["aligned"].all()
    assert (table["samples"].abs() < 0.05).all()
    assert "delay" not in set(model.diagnose().table["limit"])


def test_without_a_force_there_is_no_delay():
    ground = excitation.band_limited_random(
        1, 4.0, FS, excited=[1], rms=2.0, band=(1, 30), random_state=0
    )
    record = simulate(TRUTH, None, 1 / FS, base_acceleration=ground[:, 0])
    known = dict(enumerate(MASSES, 1))
    model = NRFRegressor(degree=1, known_masses=known).fit(record)

    with pytest.raises(ChannelError, match="No force"):
        force_delay(model)


@dataclass(frozen=True)
class Blow:
    """A single blow on the upper of two floors, and the motion, by DOP853."""

    force: np.ndarray
    acceleration: np.ndarray
    displacement: np.ndarray

    def record(self, kinds, noise=0.0, delay=0):
        """Noisy channels of some kinds (a, x) beside a force that comes late."""
        rng = np.random.default_rng(0)
        channels = {}
        for kind, name in (("a", "acceleration"), ("x", "displacement")):
            motion = getattr(self, name)
            error = noise * motion.std(axis=0) * rng.standard_normal(motion.shape)
            if kind in kinds:
                channels[name] = motion + error
        force = np.zeros((len(self.force), 2))
        force[:, 1] = np.roll(self.force, delay)
        return Record(**channels, force=force, fs=FS)


@cache
def blow(shape, begin=0.5):
    """Half a sine of 3 ms of a hammer, or a constant force of 2.5 ms."""
    width = 3e-3 if shape == "hammer" else 2.5e-3
    end = begin + width

    def force(t):
        if not begin < t < end:
            return 0.0
        sine = np.sin(np.pi * (t - begin) / width)
        return 500.0 * (sine if shape == "hammer" else 1.0)

    a, _, x, t = integrated.run(
        MASSES,
        [DAMPING] * 2,
        [STIFFNESS] * 2,
        FS,
        2.0,
        lambda t: np.array([0.0, force(t)]),
        break_at=(begin, end),
    )
    return Blow(np.array([force(time) for time in t]), a, x)


@pytest.mark.parametrize("shape", ["hammer", "impulse"])
@pytest.mark.parametrize(
    ("kinds", "noise"), [("ax", 0.0), ("ax", 0.01), ("a", 0.01), ("x", 0.0)]
)
@pytest.mark.parametrize("delay", [0, 3, -2])
def test_a_single_blow_shows_whole_samples_and_no_half_one(shape, kinds, noise, delay):
    model = fit(blow(shape).record(kinds, noise, delay))
    row = force_delay(model).loc["F2"]

    if np.isnan(row["samples"]):
        # the equation does not hold
        assert row["aligned"]
        assert kinds == "x" or shape == "impulse"
        return

    error = abs(row["samples"] - delay)
    assert error < min(1.0, 3 * row["error"])
    hidden_by_noise = kinds != "ax" and noise and row["aligned"]
    assert row["aligned"] == (delay == 0) or hidden_by_noise


@pytest.mark.parametrize("delay", [0, 3])
def test_the_diagnosis_names_a_late_blow(delay):
    model = fit(blow("hammer").record("ax", delay=delay))

    assert ("delay" in set(model.diagnose().table["limit"])) == (delay != 0)


def test_a_blow_in_rows_that_a_filter_masked_shows_no_delay():
    """What is left of it is a smooth tail of the filter, which any shift explains."""
    record = blow("hammer", begin=0.05).record("a")
    X, F = record.to_features()
    inside = F["F2"][X.notna().all(axis=1)]
    assert np.nanmax(np.abs(inside)) < 0.01 * record.force.max()

    row = force_delay(fit(X, F)).loc["F2"]

    assert row["aligned"]
    assert np.isnan(row["samples"])


def test_a_delay_beyond_reach_cannot_be_estimated():
    table = force_delay(fit(late(pushed(), 120)))

    assert table["samples"].isna().all()
    assert table["message"].str.contains("no delay can be estimated").all()


def test_a_short_record_determines_no_delay():
    X, F = pushed().window(0, 0.15).to_features(smooth=False)

    with pytest.raises(ChannelError, match="No balance determines"):
        force_delay(fit(X, F))


def test_other_data_than_those_of_the_fit_can_be_judged():
    X, F = late(pushed(), 3).to_features(smooth=False)

    delays = force_delay(fit(pushed()), X, F)["samples"]

    assert delays.to_numpy() == pytest.approx([3.0, 3.0], abs=0.05)


def test_a_loaded_model_has_no_data_to_judge():
    loaded = pickle.loads(pickle.dumps(fit(pushed())))

    with pytest.raises(ChannelError, match="loaded without the data"):
        force_delay(loaded)


@pytest.mark.parametrize("rates", [(500.0, 1000.0), (1000.0, 500.0)])
def test_one_delay_is_found_from_records_of_different_rates(rates):
    model = ChainModel([10.0], {1: STOREY})
    records = []
    for fs in rates:
        record = late(driven(model, 1, 8.0, fs, 50.0, (1, 60)), round(0.004 * fs))
        records.append(add_noise(record, 0.01, 0))

    row = force_delay(fit(records)).loc["F1"]

    assert row["delay"] == pytest.approx(0.004, abs=5e-5)
    assert row["samples"] == pytest.approx(0.004 * rates[0], abs=0.05)
