"""The sign pattern points at the right site, whatever the excitation."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from chains import band_limited, duffing, floor_of_noise, integrate, parameters

from pysindy_nrf import NRFRegressor, Record, Site
from pysindy_nrf.diagnosis import Location, localise, residual_of
from pysindy_nrf.records import from_arrays

pytestmark = pytest.mark.slow

N, DT = 4, 1e-3
EXCITATIONS = {"complete": [1, 2, 3, 4], "top": [4], "middle": [2], "base": []}


def force_at(site, strength):
    """Forces of a law at a site on the floors, written without the package.

    A spring on a link that skips floors, friction elsewhere.
    """
    p, q = Site(site).p, Site(site).q

    def between(y):
        return y[..., p - 1] - (y[..., q - 1] if q else 0.0)

    def extra(x, v):
        force = strength * np.tanh(between(v) / 2e-3)
        if site.startswith("link"):
            force = 2e3 * strength * between(x)
        out = np.zeros_like(x)
        out[..., p - 1] = -force
        if q:
            out[..., q - 1] = force
        return out

    return extra


@dataclass
class ResidualCase:
    """What a linear chain leaves of a test, and what noise would leave."""

    residual: Any
    floor: Any = None


def left_of(site, excitation, seed=0, strength=8.0, noise=0.0):
    """The residual of a linear chain on a test with a force at a site, if any."""
    dofs, rng = EXCITATIONS[excitation], np.random.default_rng(seed)
    linear = parameters(N, rng, cubic=False)
    case = duffing(
        N,
        dofs,
        seed=seed,
        n_samples=4000,
        ag=None if dofs else band_limited(4000, DT, rng, rms=8.0),
        parameters_of_chain=linear,
        extra=force_at(site, strength) if site else None,
        substeps=2,
    )
    known = None if dofs else dict(enumerate(linear[0], 1))
    if noise:
        return noisy_left_of(case, known, noise, rng)
    return ResidualCase(fitted_residual(case.X, case.F, case.ag, known)[1])


def fitted_residual(X, F, ag=None, known=None):
    """A linear chain fitted to features and forces, and what it leaves."""
    regressor = NRFRegressor(degree=1, known_masses=known, dt=DT)
    model = regressor.fit(X, F, base_acceleration=ag).model_
    data = from_arrays(X, F, dt=DT, base_acceleration=ag)
    return model, residual_of(model, data)


def noisy_left_of(case, known, noise, rng):
    """The same with noise on every channel, and its floor."""
    clean = {
        "force": case.F,
        "acceleration": case.a,
        "velocity": case.v.cumsum(axis=1),
        "displacement": case.s.cumsum(axis=1),
    }
    noisy, levels = {}, {}
    for name, lines in clean.items():
        levels[name] = noise * np.sqrt((lines**2).mean(axis=0))
    for name, lines in clean.items():
        noisy[name] = lines + levels[name] * rng.standard_normal(lines.shape)
    rec = Record(**noisy, fs=1 / DT, base_acceleration=case.ag)
    model, residual = fitted_residual(*rec.to_features(), case.ag, known)
    return ResidualCase(residual, floor_of_noise(model, rec, levels))


@pytest.mark.parametrize(
    ("site", "excitation"),
    [
        ("storey 1", "base"),
        ("storey 3", "top"),
        ("storey 3", "complete"),
        ("link 3-1", "middle"),
        ("link 3-1", "base"),
        ("ground 3", "complete"),
        ("ground 3", "top"),
    ],
)
def test_right_site_comes_first_without_noise(site, excitation):
    table = localise(left_of(site, excitation).residual).table
    assert table.index[0] == site
    assert table["share"].iloc[0] > 99.9
    rivals = table[table["balances"] != table["balances"].iloc[0]]
    assert rivals["share"].max() < 99


@pytest.mark.parametrize("excitation", ["complete", "base"])
def test_right_site_comes_first_with_one_percent_noise(excitation):
    case = left_of("storey 2", excitation, seed=1, strength=15.0, noise=0.01)
    table = localise(case.residual, case.floor).table
    assert table.index[0] == "storey 2"
    assert table["share"].iloc[0] > 90


def test_outside_force_is_told_from_a_ground_link_by_its_motion():
    rng = np.random.default_rng(2)
    linear = parameters(N, rng, cubic=False)
    F, hidden = np.zeros((6000, N)), np.zeros((6000, N))
    F[:, 3] = band_limited(6000, DT, rng)
    hidden[:, 1] = band_limited(6000, DT, rng, rms=10.0)
    X = np.hstack(integrate(*linear, F + hidden, DT))
    table = localise(fitted_residual(X, F)[1]).table
    assert table.index[0] == "dof 2"
    best = pytest.approx(table["share"].iloc[0])
    assert table.loc["ground 2", "share"] == best


def test_unknown_balance_hides_what_cannot_be_told():
    """The lower end of storey 2 is not seen."""
    residual = left_of("storey 2", "complete").residual
    (segment,) = residual.data.segments
    F = segment.F.copy()
    F[:, 0] = np.nan
    X = np.hstack([segment.a, segment.v, segment.s])
    masked = residual_of(residual.model, from_arrays(X, F, dt=DT))
    share = localise(masked).table["share"]
    assert share["storey 2"] > 99.9
    assert share["storey 2"] == pytest.approx(share["dof 2"])
    assert np.isnan(share["storey 1"])


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_where_nothing_is_missing_no_site_is_named(noise):
    case = left_of(None, "complete", noise=noise)
    localisation = localise(case.residual, case.floor)
    assert localisation.verdict == Location.NOTHING and localisation.site == ""
