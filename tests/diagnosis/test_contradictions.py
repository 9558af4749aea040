"""A wrong force channel under complete excitation: every balance fits by itself, and no
two agree.
"""

import re
import warnings

import numpy as np
import pytest
from chains import driven

from pysindy_nrf import Chain, ChainModel, NRFRegressor, laws, simulate
from pysindy_nrf.exceptions import BiasWarning
from pysindy_nrf.simulation.excitation import band_limited_random
from pysindy_nrf.simulation.noise import add_noise

FS = 500.0
LINEAR = laws.PowerSeries(1, [20.0, 4e4])


def fitted(record, **options):
    with warnings.catch_warnings(record=True, action="always") as said:
        model = NRFRegressor(degree=1, **options).fit(record)
    return model, " ".join(
        str(w.message) for w in said if issubclass(w.category, BiasWarning)
    )


@pytest.fixture(scope="module")
def record():
    truth = ChainModel([5.0, 4.0, 3.0], dict.fromkeys((1, 2, 3), LINEAR))
    return driven(truth, [1, 2, 3], 8.0, FS, 40.0, (1, 40), hold="cubic")


def with_gain(record, dof, gain):
    force = record.force.copy()
    force[:, dof - 1] *= gain
    return record.replace(force=force)


@pytest.mark.parametrize("noise", [0.0, 0.01])
@pytest.mark.parametrize("gain", [1 / 4.448, 1.3, -1.0])
def test_a_force_in_another_unit_is_said_and_whose(record, gain, noise):
    noisy = add_noise(record, noise, random_state=0) if noise else record
    model, said = fitted(with_gain(noisy, 2, gain))
    assert (
        model.masses_ == pytest.approx([5, 4 * gain, 3], rel=0.02)
        and model.solve_order_.strategy == "complete"
    )
    assert (
        "storey 2 and storey 3 are found twice" in said
        and "of DOF 2, where all of them meet" in said
    )
    top = model.diagnose().table.iloc[0]
    assert top["limit"] == "doubt" and "contradict" in top["message"]


def test_of_a_storey_at_the_end_either_floor_is_asked(record):
    model, said = fitted(with_gain(record, 1, 3.0))
    assert "storey 2 is found twice" in said and "one of DOF 1, 2" in said
    # the sentence's number is that of the table, and the mass of that floor is the one
    # that is wrong
    assert f"{model.errors_.loc['dof 1', 'error']:.0f} % off" in said and model.masses_[
        0
    ] == pytest.approx(15, rel=0.01)


def test_a_wrong_known_mass_is_one_too(record):
    _, said = fitted(record, known_masses={2: 0.4})
    assert "of DOF 2, where all of them meet" in said


@pytest.mark.parametrize("dof", [1, 2, 3])
def test_one_wrong_mass_of_a_shaken_chain_is_named_with_its_size(dof):
    """All masses together scale the laws, which no motion tells; one against the others
    shows in the balances.
    """
    known = {1: 5.0, 2: 4.0, 3: 3.0}
    base = band_limited_random(
        1, 8.0, FS, excited=[1], rms=2.0, band=(0.5, 40), random_state=0
    )[:, 0]
    truth = ChainModel([5.0, 4.0, 3.0], dict.fromkeys((1, 2, 3), LINEAR))
    run = add_noise(
        simulate(truth, np.zeros((4000, 3)), 1 / FS, base_acceleration=base),
        0.01,
        random_state=0,
    )
    assert "left free" not in fitted(run, known_masses=known)[1]
    found = re.search(
        r"left free, m(\d) is ([\d.]+) kg",
        fitted(run, known_masses=known | {dof: 1.2 * known[dof]})[1],
    )
    assert (
        found
        and int(found[1]) == dof
        and float(found[2]) == pytest.approx(known[dof], rel=0.01)
    )


def test_a_brace_that_two_balances_find_differently():
    chain = Chain(3, links=["link 3-1"])
    truth = ChainModel(
        [5.0, 4.0, 3.0],
        {**dict.fromkeys((1, 2, 3), LINEAR), "link 3-1": laws.LinearElastic(2e4)},
        chain,
    )
    rec = driven(truth, [1, 2, 3], 8.0, FS, 40.0, (1, 40), seed=1, hold="cubic")
    given = {"chain": chain, "laws": {"link 3-1": [laws.LinearElastic()]}}
    assert fitted(rec, **given)[1] == ""
    assert "link 3-1" in fitted(with_gain(rec, 1, 2.0), **given)[1]


@pytest.mark.parametrize("noise", [0.0, 0.02, 0.05])
@pytest.mark.parametrize("seed", [0, 1])
def test_right_forces_are_not_doubted(record, noise, seed):
    model, said = fitted(
        add_noise(record, noise, random_state=seed) if noise else record
    )
    assert "contradict" not in said and model.data_warnings_["forces"] == []


@pytest.mark.parametrize(
    "estimation", ["iv", pytest.param("simulation", marks=pytest.mark.slow)]
)
def test_instruments_are_not_doubted_either(record, estimation):
    """What they leave is noise of the motion, in each balance alike; the equations of
    instruments leave nothing.
    """
    noisy = add_noise(record, 0.05, random_state=2)
    model, said = fitted(noisy, estimation=estimation)
    assert "contradict" not in said and model.masses_ == pytest.approx(
        [5, 4, 3], rel=0.01
    )
    assert "contradict" in fitted(with_gain(noisy, 2, 2.0), estimation=estimation)[1]


def test_a_joint_solve_says_so_too_and_one_floor_never(record):
    model, said = fitted(with_gain(record, 2, 2.0), strategy="joint")
    assert "contradict" in said and model.solve_order_.strategy == "joint"
    one = ChainModel([5.0], {1: LINEAR})
    assert not any(
        fitted(driven(one, 1, 4.0, FS, 40.0, (1, 40), hold="cubic"))[
            0
        ].data_warnings_.values()
    )
