"""The sign pattern points at the right site, whatever the excitation and the strategy
of the baseline.
"""

import numpy as np
import pytest
from chains import band_limited, duffing, floor_of_noise, parameters
from pysindy_nrf.discrepancy.evidence import Localiser
from pysindy_nrf.discrepancy.words import Location

from pysindy_nrf import NRFRegressor, Record
from pysindy_nrf.discrepancy.residual import residual_of
from pysindy_nrf.records.input_arrays import from_arrays

pytestmark = pytest.mark.slow

N = 4
CHANNELS = ("force", "acceleration", "velocity", "displacement")
EXCITATIONS = {"complete": [1, 2, 3, 4], "top": [4], "middle": [2], "base": []}


def force_of(site, strength):
    """Extra forces on the DOFs of a law at a site, written without the package."""
    kind, _, where = site.partition(" ")
    p, q = {
        "storey": lambda: (int(where), int(where) - 1),
        "ground": lambda: (int(where), 0),
        "link": lambda: map(int, where.split("-")),
    }[kind]()

    def extra(x, v):
        s = x[..., p - 1] - (x[..., q - 1] if q else 0.0)
        w = v[..., p - 1] - (v[..., q - 1] if q else 0.0)
        f = strength * np.tanh(w / 2e-3) if kind != "link" else 2e3 * strength * s
        out = np.zeros_like(x)
        out[..., p - 1] = -f
        if q:
            out[..., q - 1] = f
        return out

    return extra


def residual(
    site, excitation, seed=0, strength=8.0, n_samples=4000, degree=1, noise=0.0
):
    dofs = EXCITATIONS[excitation]
    rng = np.random.default_rng(seed)
    m, c, k, k3 = parameters(N, rng, cubic=False)
    ag = None if dofs else band_limited(n_samples, 1e-3, rng, rms=8.0)
    case = duffing(
        N,
        dofs,
        seed=seed,
        n_samples=n_samples,
        ag=ag,
        given=(m, c, k, k3),
        extra=force_of(site, strength) if site else None,
        substeps=2,
    )
    known = None if dofs else dict(enumerate(m, 1))
    X, F, rec = case.X, case.F, None
    if noise:
        clean = dict(
            zip(
                CHANNELS, (case.F, case.a, case.v.cumsum(axis=1), case.s.cumsum(axis=1))
            )
        )
        levels = {k: noise * np.sqrt((p**2).mean(axis=0)) for k, p in clean.items()}
        noisy = {
            k: p + levels[k] * rng.standard_normal(p.shape) for k, p in clean.items()
        }
        rec = Record(**noisy, fs=1e3, base_acceleration=ag)
        X, F = rec.to_features()
    fit = NRFRegressor(degree=degree, known_masses=known, dt=1e-3).fit(
        X, F, base_acceleration=ag
    )
    data = from_arrays(X, F, dt=1e-3, base_acceleration=ag)
    return residual_of(fit.model_, data), rec and floor_of_noise(
        fit.model_, rec, levels
    )


def located(found, floor=None):
    return Localiser(found, floor).found()


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
    table = located(residual(site, excitation)[0]).table
    assert table.index[0] == site and table["share"].iloc[0] > 99.9
    rivals = table[table["balances"] != table["balances"].iloc[0]]
    assert rivals["share"].max() < 99


@pytest.mark.parametrize("excitation", ["complete", "base"])
def test_right_site_comes_first_with_one_percent_noise(excitation):
    found, floor = residual("storey 2", excitation, seed=1, strength=15.0, noise=0.01)
    table = located(found, floor).table
    assert table.index[0] == "storey 2" and table["share"].iloc[0] > 90


def test_outside_force_is_told_from_a_ground_link_by_its_motion():
    rng = np.random.default_rng(2)
    given = parameters(N, rng, cubic=False)
    from chains import integrate

    F = np.zeros((6000, N))
    F[:, 3] = band_limited(6000, 1e-3, rng)
    hidden = np.zeros_like(F)
    hidden[:, 1] = band_limited(6000, 1e-3, rng, rms=10.0)
    a, v, s = integrate(*given, F + hidden, 1e-3)
    X = np.hstack([a, v, s])
    fit = NRFRegressor(degree=1, dt=1e-3).fit(X, F)
    table = located(residual_of(fit.model_, from_arrays(X, F, dt=1e-3))).table
    assert table.index[0] == "dof 2" and table.loc[
        "ground 2", "share"
    ] == pytest.approx(table["share"].iloc[0])


def test_unknown_balance_hides_what_cannot_be_told():
    found, _ = residual("storey 2", "complete")
    F = np.array([seg.F for seg in found.data.segments])[0].copy()
    F[:, 0] = np.nan
    seg = found.data.segments[0]
    masked = residual_of(
        found.model, from_arrays(np.hstack([seg.a, seg.v, seg.s]), F, dt=1e-3)
    )
    table = located(masked).table
    assert table.loc["storey 2", "share"] > 99.9
    assert table.loc["storey 2", "share"] == pytest.approx(
        table.loc["dof 2", "share"]
    )  # the lower end is not seen
    assert np.isnan(table.loc["storey 1", "share"])


def test_nothing_to_locate():
    found, floor = residual(None, "complete", noise=0.02)
    for one in (located(found, floor), located(residual(None, "complete")[0])):
        assert one.verdict == Location.NOTHING and one.site == ""


def test_bars_show_the_best_site_on_top():
    from pysindy_nrf.report.figures.evidence import localisation_figure

    figure = localisation_figure(located(residual("storey 3", "complete")[0]).table)
    assert figure.y.ticks[0].startswith("storey 3") and figure.y.ticks[0].endswith(
        "(-2, +3)"
    )
    assert figure.marks[0].values.iloc[0] == pytest.approx(100, abs=0.1)
