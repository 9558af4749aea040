"""What the data allow beside a model: braces, dashpots, gains, corners and delays."""

import numpy as np
import pytest
from scipy.signal import butter, sosfilt

from pysindy_nrf import ChainModel, NRFRegressor, excitation, laws, simulate
from pysindy_nrf.simulation import add_noise

MASSES = np.array([9.0, 11.0, 8.0])  # kg
STIFFNESS = (5.0e4, 4.2e4, 3.6e4)  # N/m; modes at 5.0, 13.1 and 18.6 Hz
FIRST_MODE = 8.0  # Hz, between the first mode and the second
ALL_MODES = 40.0  # Hz


def spring_and_dashpot(k, c):
    return [laws.LinearElastic(k), laws.LinearViscous(c)]


def frame(**more):
    """A linear frame of three storeys; more laws by site, blanks as underscores."""
    storeys = {i: spring_and_dashpot(k, 35.0) for i, k in enumerate(STIFFNESS, 1)}
    others = {site.replace("_", " "): group for site, group in more.items()}
    return ChainModel(MASSES, storeys | others)


def shaken(model, top, dof=3, noise=0.01, seed=4):
    """A record of a shaker on one floor, up to a frequency, Hz."""
    F = excitation.band_limited_random(
        3, 24.0, 256.0, excited=[dof], rms=80.0, band=(0.5, top), random_state=seed
    )
    clean = simulate(model, F, 1 / 256, hold="cubic").replace(velocity=None)
    return add_noise(clean, noise, random_state=seed)


def named(fitted):
    """Places of other structures and channels that the verdict names."""
    kinds = ("ambiguity", "alternative")
    return [g.place for g in fitted.verdict().grounds if g.kind in kinds]


def test_a_frame_that_is_right_and_shaken_in_all_modes_is_green():
    """Gains of the sensors are one, and a gain of one moves no mass."""
    fitted = NRFRegressor(degree=1).fit(shaken(frame(), ALL_MODES, dof=1))
    assert fitted.verdict().state == "green"
    assert fitted.masses_ == pytest.approx(MASSES, rel=0.02)
    alternatives = fitted.result_.alternatives
    gains = [abs(each.change) for each in alternatives if each.place[:3] == "dof"]
    assert len(gains) == 3
    assert max(gains) < 0.01


@pytest.mark.parametrize("top", [FIRST_MODE, ALL_MODES])
@pytest.mark.parametrize("place", ["ground 2", "link 3-1"])
def test_a_brace_that_nobody_declared_is_never_green(place, top):
    braced = frame(**{place.replace(" ", "_"): spring_and_dashpot(9e3, 5.0)})
    fitted = NRFRegressor(degree=1).fit(shaken(braced, top))
    assert fitted.verdict().state != "green"
    assert place in named(fitted)


def test_one_mode_does_not_exclude_a_brace():
    """The masses are right, but the test could not have shown that they are wrong."""
    fitted = NRFRegressor(degree=1).fit(shaken(frame(), FIRST_MODE))
    assert fitted.masses_ == pytest.approx(MASSES, rel=0.03)
    assert fitted.verdict().state == "amber"
    assert "ground 2" in named(fitted)


def test_noise_that_biases_least_squares_hides_no_ambiguity():
    """Least squares is more than a tenth off, the brace is open by far more."""
    braced = frame(**{"link_3-1": spring_and_dashpot(6e3, 4.0)})
    fitted = NRFRegressor(degree=1).fit(shaken(braced, 6.5, noise=0.02))
    assert fitted.result_.method == "iv"
    assert fitted.verdict().state != "green"
    assert named(fitted)


def test_noise_opens_no_alternative_beside_a_shaken_base():
    """Drifts of displacements bias least squares, by more with a brace beside it."""
    masses = np.array([11.0, 6.5, 11.4])
    storeys = {}
    for i, k in enumerate((1.76e4, 3.26e4, 3.14e4), 1):
        storeys[i] = spring_and_dashpot(k, 1.5e-3 * k)
    base = excitation.band_limited_random(
        1, 16.0, 256.0, excited=[1], rms=1.0, band=(1.35, 27.5), random_state=4
    )
    clean = simulate(
        ChainModel(masses, storeys),
        np.zeros((len(base), 3)),
        1 / 256,
        hold="cubic",
        base_acceleration=base[:, 0],
    )
    measured = clean.replace(velocity=None, displacement=None)
    record = add_noise(measured, 0.005, random_state=4)
    fitted = NRFRegressor(degree=1, known_masses={1: 11.0}).fit(record)
    assert fitted.result_.method == "iv"
    assert fitted.masses_ == pytest.approx(masses, rel=0.01)
    assert named(fitted) == []


def hit_once_a_floor(model, noise=0.01):
    """A record of one blow on each floor, and of the decay after it."""
    fs = 500.0
    F = np.zeros((int(18 * fs), 3))
    blow = 900.0 * np.sin(np.pi * np.arange(10) / 9) ** 2
    for floor in range(3):
        start = int((0.5 + 6 * floor) * fs)
        F[start : start + len(blow), floor] = blow
    clean = simulate(model, F, 1 / fs, hold="cubic").replace(velocity=None)
    return add_noise(clean, noise, random_state=2)


def test_one_blow_a_floor_is_no_ambiguity():
    """Without the piece that holds the blow of a floor nothing is known of its mass."""
    fitted = NRFRegressor(degree=1).fit(hit_once_a_floor(frame()))
    assert fitted.masses_ == pytest.approx(MASSES, rel=0.03)
    assert named(fitted) == []


def test_a_brace_that_is_declared_is_no_alternative():
    brace = spring_and_dashpot(9e3, 5.0)
    storeys = {f"storey {i}": spring_and_dashpot(None, None) for i in (1, 2, 3)}
    declared = storeys | {"ground 2": spring_and_dashpot(None, None)}
    record = shaken(frame(ground_2=brace), ALL_MODES)
    fitted = NRFRegressor(laws=declared).fit(record)
    assert fitted.verdict().state == "green"
    assert fitted.masses_ == pytest.approx(MASSES, rel=0.02)


def test_rayleigh_damping_is_named():
    """A dashpot of 0.9 /s times its mass holds every floor."""
    dashpots = {
        f"ground_{j}": [laws.LinearViscous(0.9 * MASSES[j - 1])] for j in (2, 3)
    }
    fitted = NRFRegressor(degree=1).fit(shaken(frame(**dashpots), ALL_MODES))
    assert fitted.verdict().state != "green"
    assert "ground 2, ground 3" in named(fitted)


@pytest.mark.parametrize("corner", [0.6, 1.5])
def test_the_corner_of_a_force_cell_is_found(corner):
    record = shaken(frame(), ALL_MODES, noise=0.005)
    high_pass = butter(1, corner, "high", fs=256.0, output="sos")
    filtered = record.replace(force=sosfilt(high_pass, record.force, axis=0))
    fitted = NRFRegressor(degree=1).fit(filtered)

    best = fitted.result_.alternatives[0]
    assert best.place == "sensor F3"
    frequency = float(best.description.split(" Hz")[0].split()[-1])
    assert frequency == pytest.approx(corner, rel=0.1)
    assert fitted.verdict().state != "green"


@pytest.mark.parametrize("samples", [1, 3, 8])
def test_a_late_force_is_named_and_not_the_floors(samples):
    record = shaken(frame(), ALL_MODES, noise=0.005)
    late = np.zeros_like(record.force)
    late[samples:] = record.force[:-samples]
    verdict = NRFRegressor(degree=1).fit(record.replace(force=late)).verdict()
    assert verdict.state != "green"
    first = next(g for g in verdict.grounds if g.kind == "alternative")
    assert first.place == "sensor F3"
    assert not any(ground.kind == "wiring" for ground in verdict.grounds)


def test_another_gain_of_a_floor_is_named():
    record = shaken(frame(), ALL_MODES, noise=0.005)
    gains = np.array([1.0, 0.88, 1.0])
    read = record.replace(
        acceleration=record.acceleration * gains,
        displacement=record.displacement * gains,
    )
    fitted = NRFRegressor(degree=1).fit(read)
    assert fitted.verdict().state != "green"
    assert "dof 2" in named(fitted)


def test_one_floor_has_no_alternative():
    """A gain of its sensors scales mass and force alike: nothing can show it."""
    model = ChainModel([9.0], {1: spring_and_dashpot(4e4, 35.0)})
    F = excitation.band_limited_random(
        1, 12.0, 256.0, excited=[1], rms=40.0, band=(0.5, 40.0), random_state=0
    )
    record = simulate(model, F, 1 / 256, hold="cubic")
    assert NRFRegressor(degree=1).fit(record).result_.alternatives == ()


def covered(fitted, truth):
    """Whether each interval that is given holds the truth, by parameter."""
    table = fitted.confidence_intervals().set_index("parameter").dropna()
    values = {f"m{j}": mass for j, mass in enumerate(truth.masses, 1)}
    for site, force in truth.restoring_forces.items():
        values |= {f"{site}: {term}": k for term, k in force.coefficients.items()}
    return {
        name: row.lower <= values[name] <= row.upper for name, row in table.iterrows()
    }


@pytest.mark.parametrize("seed", [1, 2])
def test_intervals_of_a_braced_frame_shaken_in_one_mode_are_withheld(seed):
    """The brace makes m1 half as heavy again, and closes the equations as well."""
    braced = frame(ground_2=spring_and_dashpot(9e3, 5.0))
    fitted = NRFRegressor(degree=1).fit(shaken(braced, FIRST_MODE, seed=seed))
    assert abs(fitted.masses_[0] / MASSES[0] - 1) > 0.2
    covers = covered(fitted, braced)
    assert "m1" not in covers
    assert all(covers.values())
    withheld = {x.parameter for x in fitted.result_.ambiguous_intervals if x.withheld}
    assert "m1" in withheld
    assert np.isnan(fitted.result_.summary().to_frame().loc["m1", "lower"])
    limits = fitted.diagnose().table.set_index("limit")["where"]
    assert "ground 2" in set(limits[limits.index.isin(["ambiguity", "alternative"])])


def test_dampings_of_a_frame_with_rayleigh_damping_are_withheld():
    dashpots = {
        f"ground_{j}": [laws.LinearViscous(0.9 * MASSES[j - 1])] for j in (2, 3)
    }
    record = shaken(frame(**dashpots), ALL_MODES)
    fitted = NRFRegressor(degree=1).fit(record)
    covers = covered(fitted, frame(**dashpots))
    assert not any(name.endswith(": v") for name in covers)
    modes = fitted.confidence_intervals(of="modes").set_index("parameter")
    assert np.isnan(modes.loc["damping 1", "lower"])
    assert np.isfinite(modes.loc["frequency 3", "lower"])


def test_forces_of_a_storey_hold_what_a_brace_makes_of_them():
    """The stiffness of storey 2 is ambiguous, and so is its force at any drift."""
    fitted = NRFRegressor(degree=1).fit(shaken(frame(), FIRST_MODE))
    drifts = np.array([-2e-3, 1e-3])
    forces = fitted.force_intervals(2, np.zeros(2), drifts)
    truth = STIFFNESS[1] * drifts
    has_interval = forces["lower"].notna().to_numpy()
    holds = (forces["lower"] <= truth) & (forces["upper"] >= truth)
    assert holds[has_interval].all()
    alone = fitted.result_.intervals.forces(2, np.zeros(2), drifts, 0.95)
    wider = forces["upper"] - forces["lower"] > 2 * (alone["upper"] - alone["lower"])
    assert (wider | ~has_interval).all()
