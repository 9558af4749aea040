"""A force that comes late against the motion is found to a fraction of a sample."""

import functools
import pickle

import integrated
import numpy as np
import pytest
from chains import driven

from pysindy_nrf import ChainModel, NRFRegressor, Record, excitation, laws, simulate
from pysindy_nrf.diagnosis.force_delays import force_delay
from pysindy_nrf.exceptions import ChannelError
from pysindy_nrf.records.checks.alignment import shifted
from pysindy_nrf.simulation.noise import add_noise

pytestmark = pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.NRFWarning")
STOREY = laws.PowerSeries(1, [60.0, 1e5])
TRUTH = ChainModel([10.0, 12.0], {"storey 1": STOREY, "storey 2": STOREY})


def record(kind="random", noise=0.0, dofs=(1, 2)):
    if kind == "hammer":
        F = excitation.impact_hammer(
            2, 8.0, 1000.0, excited=dofs, level=500.0, n_hits=6, random_state=0
        )
    else:
        F = excitation.band_limited_random(
            2, 8.0, 1000.0, excited=dofs, rms=100.0, band=(0.5, 60.0), random_state=0
        )
    rec = simulate(TRUTH, F, 1e-3, hold="cubic")
    return add_noise(rec, noise, random_state=1) if noise else rec


@pytest.mark.parametrize(("kind", "noise"), [("random", 0.1), ("hammer", 0.0)])
@pytest.mark.parametrize("late", [0.0, 2.4, -3.0])
def test_the_delay_comes_back(kind, noise, late):
    rec = record(kind, noise)
    force = rec.force.copy()
    force[:, 1] = np.nan_to_num(shifted(force[:, 1], late))
    table = force_delay(NRFRegressor(degree=1).fit(rec.replace(force=force)))
    assert table.loc["F2", "samples"] == pytest.approx(
        late, abs=max(0.05, 4 * table.loc["F2", "error"])
    )
    assert table.loc["F2", "delay"] == pytest.approx(late * 1e-3, abs=2e-4)
    assert table.loc["F1", "aligned"] and table.loc["F2", "aligned"] == (late == 0)


def test_the_diagnosis_says_it_with_its_channel():
    rec = record(dofs=(2,))
    late = rec.replace(force=np.roll(rec.force, 4, axis=0))
    said = NRFRegressor(degree=1).fit(late).diagnose()
    assert "delay" in set(said.table["limit"]) and "F2 is 4 ms (4.0" in str(
        said
    ).replace("3.99", "4.0").replace("4 samples", "4.0")
    assert "delay" not in set(NRFRegressor(degree=1).fit(rec).diagnose().table["limit"])


def test_what_the_band_of_the_fit_takes_out_gives_no_delay():
    """A constant in x2 ruins the balances, but not within a band that does not hold it:
    no delay is seen there either.
    """
    rec = record(noise=0.02).replace(velocity=None)
    wrong = rec.replace(
        displacement=rec.displacement + [0.0, 2.0 * rec.displacement[:, 1].std()]
    )
    model = NRFRegressor(degree=1, band=(1, 60)).fit(wrong)
    assert model.masses_ == pytest.approx(TRUTH.masses, rel=0.05)
    assert (
        force_delay(model)["aligned"].all()
        and (force_delay(model)["samples"].abs() < 0.05).all()
    )
    assert "delay" not in set(model.diagnose().table["limit"])


def test_without_a_force_there_is_nothing_to_tell():
    ag = excitation.band_limited_random(
        1, 4.0, 1000.0, excited=[1], rms=2.0, band=(1, 30), random_state=0
    )[:, 0]
    rec = simulate(TRUTH, None, 1e-3, base_acceleration=ag)
    model = NRFRegressor(degree=1, known_masses={1: 10.0, 2: 12.0}).fit(rec)
    with pytest.raises(ChannelError, match="No force"):
        force_delay(model)


@functools.cache
def one_blow(width, shape, begin=0.5):
    """A single blow on the upper of two floors, integrated by DOP853: its force, and
    what the sensors see.
    """
    fs, end = 1000.0, begin + width * 1e-3

    def force(t):
        inside = begin < t < end
        return (
            500.0
            * (
                np.sin(np.pi * (t - begin) / (end - begin))
                if shape == "hammer"
                else 1.0
            )
            * inside
        )

    a, v, x, t = integrated.run(
        [10.0, 12.0],
        [60.0, 60.0],
        [1e5, 1e5],
        fs,
        2.0,
        lambda t: np.array([0.0, force(t)]),
        break_at=(begin, end),
    )
    return np.array([force(s) for s in t]), a, x, fs


@pytest.mark.parametrize("width, shape", [(3.0, "hammer"), (2.5, "impulse")])
@pytest.mark.parametrize(
    ("channels", "noise"), [("ax", 0.0), ("ax", 0.01), ("a", 0.01), ("x", 0.0)]
)
def test_a_single_blow_tells_whole_samples_and_no_half_one(
    width, shape, channels, noise
):
    clean, a, x, fs = one_blow(width, shape)
    rng = np.random.default_rng(0)
    a, x = (y + noise * y.std(axis=0) * rng.standard_normal(y.shape) for y in (a, x))
    given = {
        k: y
        for k, y in (("acceleration", a), ("displacement", x))
        if k[0] in channels.replace("x", "d")
    }
    for late in (0, 3, -2):
        force = np.column_stack([0.0 * clean, np.roll(clean, late)])
        model = NRFRegressor(degree=1).fit(Record(**given, force=force, fs=fs))
        row = force_delay(model).loc["F2"]
        if not np.isfinite(
            row["samples"]
        ):  # the balance does not hold: nothing is said
            assert row["aligned"] and (channels == "x" or shape == "impulse")
            continue
        assert row["aligned"] == (late == 0) or (
            channels != "ax" and noise and row["aligned"]
        )
        assert (
            abs(row["samples"] - late) < 1.0
            and abs(row["samples"] - late) < 3 * row["error"]
        )
        assert ("delay" in set(model.diagnose().table["limit"])) == (not row["aligned"])


def test_a_blow_in_the_rows_that_a_filter_masked_tells_no_delay():
    """What is left of it is a smooth tail of the filter, which any shift explains."""
    clean, a, _, fs = one_blow(3.0, "hammer", 0.05)
    X, F = Record(
        acceleration=a, force=np.column_stack([0.0 * clean, clean]), fs=fs
    ).to_features()
    assert np.nanmax(np.abs(F["F2"][X.notna().all(axis=1)])) < 0.01 * clean.max()
    row = force_delay(NRFRegressor(degree=1).fit(X, F)).loc["F2"]
    assert row["aligned"] and np.isnan(row["samples"])


def test_delays_beyond_reach_or_without_data_are_not_told():
    rec = record()
    far = rec.replace(force=np.roll(rec.force, 120, axis=0))
    table = force_delay(NRFRegressor(degree=1).fit(far))
    assert (
        table["samples"].isna().all()
        and table["message"].str.contains("F.: no delay can be estimated").all()
    )
    short = rec.replace(
        **{
            k: getattr(rec, k)[:150]
            for k in ("force", "acceleration", "velocity", "displacement")
        }
    )
    with pytest.raises(
        ChannelError, match="No balance determines the delay of its force"
    ):
        force_delay(NRFRegressor(degree=1).fit(*short.to_features(smooth=False)))
    model = NRFRegressor(degree=1).fit(rec)
    X, F = rec.replace(force=np.roll(rec.force, 3, axis=0)).to_features(smooth=False)
    assert force_delay(model, X, F)["samples"].to_numpy() == pytest.approx(
        [3.0, 3.0], abs=0.05
    )
    with pytest.raises(ChannelError, match="loaded without the data"):
        force_delay(pickle.loads(pickle.dumps(model)))


@pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.NRFWarning")
def test_one_delay_is_told_from_records_of_different_rates():
    model = ChainModel([10.0], {1: laws.PowerSeries(1, [60.0, 1e5])})
    late = []
    for fs in (500.0, 1000.0):
        record = driven(model, 1, 8.0, fs, 50.0, (1, 60))
        late.append(
            add_noise(
                record.replace(force=np.roll(record.force, round(0.004 * fs), axis=0)),
                0.01,
                0,
            )
        )
    for given in (late, late[::-1]):
        row = force_delay(NRFRegressor(degree=1).fit(given)).loc["F1"]
        assert row["delay"] == pytest.approx(0.004, abs=5e-5)
        assert row["samples"] == pytest.approx(0.004 * given[0].fs, abs=0.05)
