"""Shape parameters that are declared without a value: a frequency is found in the
spectrum of the residual.
"""

import numpy as np
import pytest

from pysindy_nrf import ChainModel, NRFRegressor, Site, excitation, laws, simulate
from pysindy_nrf.simulation.noise import add_noise

FS = 200.0
STOREY = [
    laws.LinearElastic(2e4),
    laws.LinearViscous(20.0),
]  # modes of two floors at 4.0 and 10.5 Hz


def shaken(n, hidden, dofs=None, seconds=(20.0,), beside=()):
    """Records of a chain of floors of 12 kg, with 2 % of noise, and forces that nobody
    measured.
    """
    storeys = {
        f"storey {i}": [*STOREY, *(beside if i == 1 else ())] for i in range(1, n + 1)
    }
    truth = ChainModel([12.0] * n, {**storeys, **hidden})
    records = []
    for k, duration in enumerate(seconds):
        F = excitation.band_limited_random(
            n,
            duration,
            FS,
            excited=dofs or list(range(1, n + 1)),
            rms=40.0,
            band=(0.5, 40.0),
            random_state=k,
        )
        records.append(add_noise(simulate(truth, F, 1 / FS), 0.02, random_state=9 + k))
    return records


@pytest.mark.parametrize(
    ("n", "dof", "frequency", "dofs", "seconds"),
    [
        (1, 1, 21.0, None, (20.0,)),
        (2, 2, 1.02 * 4.016, None, (20.0, 12.0)),  # beside the first resonance
        (3, 1, 33.3, [3], (12.0, 15.0, 10.0)),  # on a floor without a measured force
        (2, 2, 61.0, None, (20.0,)),  # faster than all that was excited
    ],
)
def test_a_declared_harmonic_force_is_found_at_any_frequency(
    n, dof, frequency, dofs, seconds
):
    site = Site(f"dof {dof}")
    records = shaken(
        n, {site: [laws.HarmonicForce(frequency, 8.0, 6.0)]}, dofs, seconds
    )
    found = (
        NRFRegressor(degree=1, laws={site: [laws.HarmonicForce()]})
        .fit(records)
        .model_.laws[site][0]
    )
    assert found.shape["frequency"] == pytest.approx(frequency, abs=0.02 / max(seconds))
    assert np.hypot(*found.values) == pytest.approx(10.0, rel=0.15)  # N


def test_several_frequencies_are_found_one_after_the_other():
    """Two on one floor and one on another; beside them a gap, whose width is scanned as
    ever.
    """
    top, bottom, storey = Site("dof 2"), Site("dof 1"), Site("storey 1")
    hidden = {
        top: [laws.HarmonicForce(21.0, 8.0, 6.0), laws.HarmonicForce(7.5, 3.0, 3.0)],
        bottom: [laws.HarmonicForce(13.3, 3.0, 3.0)],
    }
    declared = {
        storey: [laws.PowerSeries(1), laws.TwoSidedGap()],
        top: [laws.HarmonicForce(), laws.HarmonicForce()],
        bottom: [laws.HarmonicForce()],
    }
    records = shaken(2, hidden, beside=[laws.TwoSidedGap(0.003, 1e4)])
    found = NRFRegressor(degree=1, laws=declared).fit(records).model_.laws
    found_at = {
        site: sorted(law.shape["frequency"] for law in found[site])
        for site in (top, bottom)
    }
    assert found_at[top] == pytest.approx([7.5, 21.0], abs=2e-3)
    assert found_at[bottom] == pytest.approx([13.3], abs=2e-3)
    assert found[storey][1].shape["gap"] == pytest.approx(0.003, rel=0.05)


def test_it_is_found_in_a_band_too():
    records = shaken(
        2, {"dof 2": [laws.HarmonicForce(21.0, 8.0, 6.0)]}, seconds=(20.0, 12.0)
    )
    model = NRFRegressor(
        degree=1, band=(0.5, 45.0), laws={"dof 2": [laws.HarmonicForce()]}
    ).fit(records)
    found = model.model_.laws[Site("dof 2")][0].parameters
    assert found["frequency"] == pytest.approx(21.0, abs=2e-3)
    assert found["A"] == pytest.approx(8.0, rel=0.05) and found["B"] == pytest.approx(
        6.0, rel=0.05
    )
