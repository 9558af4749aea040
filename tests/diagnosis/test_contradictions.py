"""A wrong force channel: every equation fits by itself, and no two agree."""

import re
import warnings

import numpy as np
import pytest
from chains import driven

from pysindy_nrf import Chain, ChainModel, NRFRegressor, laws, simulate
from pysindy_nrf.exceptions import BiasWarning
from pysindy_nrf.simulation import add_noise
from pysindy_nrf.simulation.excitation import band_limited_random

FS = 500.0
MASSES = [5.0, 4.0, 3.0]
STOREY = laws.PowerSeries(1, [20.0, 4e4])
TRUTH = ChainModel(MASSES, {1: STOREY, 2: STOREY, 3: STOREY})


def pushed(model, dofs, seconds=8.0, seed=0):
    return driven(model, dofs, seconds, FS, 40.0, (1, 40), seed=seed, hold="cubic")


@pytest.fixture(scope="module")
def record():
    """All three floors pushed."""
    return pushed(TRUTH, [1, 2, 3])


def with_gain(record, dof, gain):
    force = record.force.copy()
    force[:, dof - 1] *= gain
    return record.replace(force=force)


def fit(record, **settings):
    """A fit, and what it says of bias."""
    with warnings.catch_warnings(record=True, action="always") as caught:
        model = NRFRegressor(degree=1, **settings).fit(record)
    messages = [str(w.message) for w in caught if issubclass(w.category, BiasWarning)]
    return model, " ".join(messages)


@pytest.mark.parametrize("noise", [0.0, 0.01])
@pytest.mark.parametrize("gain", [1 / 4.448, 1.3, -1.0])
def test_a_force_in_another_unit_is_named(record, gain, noise):
    noisy = add_noise(record, noise, random_state=0) if noise else record

    model, message = fit(with_gain(noisy, 2, gain))

    assert model.masses_ == pytest.approx([5, 4 * gain, 3], rel=0.02)
    assert model.solve_order_.strategy == "complete"
    assert "storey 2 and storey 3 are found twice" in message
    assert "of DOF 2, where all of them meet" in message
    first = model.diagnose().table.iloc[0]
    assert first["limit"] == "doubt"
    assert "contradict" in first["message"]


def test_of_a_storey_at_the_end_either_floor_is_asked(record):
    model, message = fit(with_gain(record, 1, 3.0))

    assert "storey 2 is found twice" in message
    assert "one of DOF 1, 2" in message
    assert model.masses_[0] == pytest.approx(15, rel=0.01)


def test_the_size_of_a_contradiction_is_that_of_the_table(record):
    model, message = fit(with_gain(record, 1, 3.0))

    error = model.errors_.loc["dof 1", "error"]
    assert f"{error:.0f} % off" in message


def test_a_wrong_known_mass_is_one_too(record):
    _, message = fit(record, known_masses={2: 0.4})

    assert "of DOF 2, where all of them meet" in message


@pytest.fixture(scope="module")
def shaken():
    """The frame on a shaken base, 1 % of noise."""
    ground = band_limited_random(
        1, 8.0, FS, excited=[1], rms=2.0, band=(0.5, 40), random_state=0
    )
    still = np.zeros((len(ground), 3))
    run = simulate(TRUTH, still, 1 / FS, base_acceleration=ground[:, 0])
    return add_noise(run, 0.01, random_state=0)


def test_right_masses_of_a_shaken_chain_are_not_doubted(shaken):
    _, message = fit(shaken, known_masses=dict(enumerate(MASSES, 1)))

    assert "left free" not in message


@pytest.mark.parametrize("dof", [1, 2, 3])
def test_one_wrong_mass_of_a_shaken_chain_is_named_with_its_size(shaken, dof):
    """All masses together scale the laws; one against the others shows."""
    known = dict(enumerate(MASSES, 1))
    known[dof] *= 1.2

    _, message = fit(shaken, known_masses=known)

    name, size = re.search(r"left free, m(\d) is ([\d.]+) kg", message).groups()
    assert int(name) == dof
    assert float(size) == pytest.approx(MASSES[dof - 1], rel=0.01)


@pytest.fixture(scope="module")
def braced():
    """A chain with a brace over two storeys, its record and its declared law."""
    chain = Chain(3, links=["link 3-1"])
    brace = {"link 3-1": laws.LinearElastic(2e4)}
    truth = ChainModel(MASSES, {**TRUTH.laws, **brace}, chain)
    settings = {"chain": chain, "laws": {"link 3-1": [laws.LinearElastic()]}}
    return pushed(truth, [1, 2, 3], seed=1), settings


def test_a_brace_that_two_equations_find_alike_is_not_doubted(braced):
    record, settings = braced

    assert fit(record, **settings)[1] == ""


def test_a_brace_that_two_equations_find_differently_is_named(braced):
    record, settings = braced

    assert "link 3-1" in fit(with_gain(record, 1, 2.0), **settings)[1]


@pytest.mark.parametrize("noise", [0.0, 0.02, 0.05])
@pytest.mark.parametrize("seed", [0, 1])
def test_right_forces_are_not_doubted(record, noise, seed):
    noisy = add_noise(record, noise, random_state=seed) if noise else record

    model, message = fit(noisy)

    assert "contradict" not in message
    assert model.data_warnings_["forces"] == []


INSTRUMENTS = ["iv", pytest.param("simulation", marks=pytest.mark.slow)]


@pytest.mark.parametrize("estimation", INSTRUMENTS)
def test_noise_that_instruments_leave_is_no_contradiction(record, estimation):
    """It is in each equation alike; those with instruments leave nothing."""
    noisy = add_noise(record, 0.05, random_state=2)

    model, message = fit(noisy, estimation=estimation)

    assert "contradict" not in message
    assert model.masses_ == pytest.approx(MASSES, rel=0.01)


@pytest.mark.parametrize("estimation", INSTRUMENTS)
def test_instruments_find_a_contradiction(record, estimation):
    noisy = add_noise(record, 0.05, random_state=2)

    assert "contradict" in fit(with_gain(noisy, 2, 2.0), estimation=estimation)[1]


def test_a_joint_solve_finds_a_contradiction(record):
    model, message = fit(with_gain(record, 2, 2.0), strategy="joint")

    assert "contradict" in message
    assert model.solve_order_.strategy == "joint"


def test_one_floor_contradicts_nothing():
    record = pushed(ChainModel([5.0], {1: STOREY}), 1, seconds=4.0)

    assert not any(fit(record)[0].data_warnings_.values())
