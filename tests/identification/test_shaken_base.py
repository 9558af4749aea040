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
FS, M, C, K = 200.0, np.array([12.0, 10.0, 8.0]), [60.0, 40.0, 30.0], [4e4, 3e4, 2e4]


@pytest.fixture(scope="module")
def shaken():
    """Half the base's motion is slower than what accelerations alone tell of the
    floors.
    """
    rng = np.random.default_rng(0)
    slow, quick = (
        integrated.multisine(rng, FS, 40.0, band, 1.5)
        for band in ((0.05, 1.0), (1.0, 15.0))
    )

    def base(t):
        return slow(t) + quick(t)

    a, v, x, t = integrated.run(M, C, K, FS, 40.0, base=base)
    ag = base(t)
    noise = rng.standard_normal((len(t), 4))
    return Record(
        acceleration=a + 0.01 * a.std(axis=0) * noise[:, :3],
        base_acceleration=ag + 0.01 * ag.std() * noise[:, 3],
        fs=FS,
    )


@pytest.mark.parametrize("estimation", ["ls", "iv", "simulation"])
def test_relative_masses_and_stiffness(shaken, estimation):
    model = NRFRegressor(degree=1, known_masses={3: M[2]}, estimation=estimation)
    model.fit(shaken)

    stiffness = [model.restoring_forces_[i].coefficients["s"] for i in (1, 2, 3)]
    assert model.masses_ == pytest.approx(M, rel=0.01)
    assert stiffness == pytest.approx(K, rel=0.01)
    if estimation != "ls":
        assert model.model_.info["estimation"]["correlation"] > 0.9995
