"""A shaken base and nothing but accelerometers: what the floors go through, the base
goes through as well.
"""

import integrated
import numpy as np
import pytest

from pysindy_nrf import NRFRegressor, Record

pytestmark = [
    pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.NRFWarning"),
    pytest.mark.slow,
]
FS = 200.0
MASSES = np.array([12.0, 10.0, 8.0])
DAMPINGS = [60.0, 40.0, 30.0]
STIFFNESSES = [4e4, 3e4, 2e4]


@pytest.fixture(scope="module")
def shaken():
    """Half the motion of the base is slower than what accelerations show of floors."""
    rng = np.random.default_rng(0)
    slow = integrated.multisine(rng, FS, 40.0, (0.05, 1.0), 1.5)
    quick = integrated.multisine(rng, FS, 40.0, (1.0, 15.0), 1.5)

    def base(t):
        return slow(t) + quick(t)

    a, _, _, t = integrated.run(MASSES, DAMPINGS, STIFFNESSES, FS, 40.0, base=base)
    ag = base(t)
    noise = 0.01 * rng.standard_normal((len(t), 4))
    return Record(
        acceleration=a + a.std(axis=0) * noise[:, :3],
        base_acceleration=ag + ag.std() * noise[:, 3],
        fs=FS,
    )


@pytest.mark.parametrize("estimation", ["ls", "iv", "simulation"])
def test_relative_masses_and_stiffness(shaken, estimation):
    known = {3: MASSES[2]}
    model = NRFRegressor(degree=1, known_masses=known, estimation=estimation)
    model.fit(shaken)

    assert model.masses_ == pytest.approx(MASSES, rel=0.01)
    for i, stiffness in enumerate(STIFFNESSES, start=1):
        fitted_stiffness = model.restoring_forces_[i].coefficients["s"]
        assert fitted_stiffness == pytest.approx(stiffness, rel=0.01)
    if estimation != "ls":
        assert model.model_.info["estimation"]["correlation"] > 0.9995
