"""States of the laws against the differential equations of the literature, energies,
free runs.
"""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, nnls

from pysindy_nrf import ChainModel, laws, simulate
from pysindy_nrf.laws import Motion

# -- states against the differential equations of the literature ---------------

FS = 2000.0


def _drift(t):
    return 1e-3 * (np.sin(9.0 * t) + 0.6 * np.sin(23.0 * t + 1.0))


def _rate(t):
    return 1e-3 * (9.0 * np.cos(9.0 * t) + 13.8 * np.cos(23.0 * t + 1.0))


def _acceleration(t):
    return -1e-3 * (81.0 * np.sin(9.0 * t) + 317.4 * np.sin(23.0 * t + 1.0))


T = np.arange(int(FS) + 1) / FS
PATH = Motion(_drift(T) - _drift(0.0), _rate(T), _acceleration(T), T)


def _reference(rate_of_state, n=1):
    """DOP853 from a fresh state, restarted where the motion turns."""
    fine = np.linspace(0.0, T[-1], 2001)
    sign = np.sign(_rate(fine))
    turns = [
        brentq(_rate, fine[i], fine[i + 1], xtol=1e-15)
        for i in np.flatnonzero(np.diff(sign))
    ]
    edges = [0.0, *turns, T[-1]]
    z, path = np.zeros(n), np.zeros((n, T.size))
    for start, end in zip(edges[:-1], edges[1:], strict=True):
        rows = np.flatnonzero((start <= T) & (end > T))
        run = solve_ivp(
            rate_of_state,
            (start, end),
            z,
            "DOP853",
            np.append(T[rows], end),
            rtol=1e-11,
            atol=1e-13,
            max_step=0.001,
        )
        path[:, rows], z = run.y[:, :-1], run.y[:, -1]
    path[:, -1] = z
    return path


def _assert_same(found, expected, tolerance):
    gap = np.abs(found - expected).max() / np.abs(expected).max()
    assert gap < tolerance, f"largest difference {gap:.2e} of the peak"


@pytest.mark.parametrize("sigma", [30.0, 3e3, 5e4])
def test_dahl_follows_equation_7(sigma):
    expected = _reference(lambda t, z: sigma * _rate(t) * (1.0 - z * np.sign(_rate(t))))
    _assert_same(laws.Dahl(sigma=sigma).features(PATH)[:, 0], expected[0], 1e-7)


@pytest.mark.parametrize(
    ("gamma", "delta", "nu", "tolerance"),
    [
        (0.8, -1.1, 1.0, 1e-10),  # the published benchmark
        (0.5, 0.5, 1.0, 1e-10),
        (0.5, -0.5, 1.0, 1e-10),
        (0.3, 0.9, 1.0, 1e-10),
        (0.6, 0.4, 2.0, 1e-7),
        (0.7, -0.2, 1.5, 1e-7),
        (0.8, -0.7, 3.0, 1e-7),
        (0.4, 0.7, 4.0, 1e-7),
    ],
)
def test_bouc_wen_follows_the_published_equation(gamma, delta, nu, tolerance):
    alpha, beta = (
        5e4,
        (1e3 if nu == 1.0 else (1.0 / 40.0) ** nu * 5e4),
    )  # bends at about 40 N

    def published(t, z):
        v = _rate(t)
        return alpha * v - beta * (
            gamma * abs(v) * abs(z) ** (nu - 1.0) * z + delta * v * abs(z) ** nu
        )

    law = laws.BoucWen(
        beta=(beta * gamma * alpha ** (nu - 1.0)) ** (1.0 / nu),
        rho=delta / gamma,
        n=nu,
        alpha=alpha,
    )
    _assert_same(law.force(PATH), _reference(published)[0], tolerance)


@pytest.mark.parametrize(
    ("rho", "n", "strength", "stiffness"),
    [(0.0, 1.0, 300.0, 0.1), (0.0, 1.0, 100.0, 300.0), (-0.4, 1.7, 200.0, 80.0)],
)
def test_degrading_bouc_wen_follows_baber_and_wen(rho, n, strength, stiffness):
    beta = 2e3

    def published(t, y):
        w, e, v = *y, _rate(t)
        size = (beta * abs(w)) ** n
        rate = v - (1.0 + strength * e) * (abs(v) * np.sign(w) * size + rho * v * size)
        return [rate / (1.0 + stiffness * e), beta * w * v]

    found = laws.DegradingBoucWen(
        beta, strength, stiffness, alpha=5e4, rho=rho, n=n
    ).force(PATH)
    _assert_same(found, 5e4 * _reference(published, 2)[0], 1e-5)


@pytest.mark.parametrize(
    ("slip", "width", "q", "rho", "n"),
    [(0.9, 0.15, 0.0, 0.0, 1.0), (0.6, 0.8, 0.2, 0.0, 1.0), (0.8, 0.3, -0.1, 0.5, 2.0)],
)
def test_pinched_bouc_wen_follows_baber_and_noori(slip, width, q, rho, n):
    beta = 2e3

    def published(t, w):
        v = _rate(t)
        size = (beta * abs(w)) ** n
        h = 1.0 - slip * np.exp(-(((beta * w * np.sign(v) - q) / width) ** 2))
        return h * (v - abs(v) * np.sign(w) * size - rho * v * size)

    found = laws.PinchedBoucWen(beta, slip, width, 5e4, q, rho, n).force(PATH)
    _assert_same(found, 5e4 * _reference(published)[0], 1e-5)


@pytest.mark.parametrize(
    ("sigma0", "sigma1", "vs", "level"),
    [(1e5, 300.0, 5e-3, 1.5), (2e4, 0.0, 2e-2, 2.5)],
)
def test_lugre_follows_its_authors(sigma0, sigma1, vs, level):
    Fc = 20.0

    def bristle(t, z):
        v = _rate(t)
        return (
            v
            - sigma0 * abs(v) / (Fc + Fc * (level - 1.0) * np.exp(-((v / vs) ** 2))) * z
        )

    z = _reference(bristle)[0]
    expected = sigma0 * z + sigma1 * np.array(
        [bristle(t, x) for t, x in zip(T, z, strict=True)]
    )
    law = laws.LuGre(sigma=sigma0 / Fc, vs=vs, ratio=level, Fc=Fc, sigma1=sigma1)
    _assert_same(law.force(PATH), expected, 2e-4)
    t = np.arange(0.0, T[-1] + 5e-6, 1e-5)
    fine = Motion(_drift(t) - _drift(0.0), _rate(t), _acceleration(t), t)
    _assert_same(law.force(fine)[::50], expected, 1e-5)


@pytest.mark.parametrize("tau", [1e-4, 0.005, 0.03, 5.0])
def test_maxwell_branch_relaxes(tau):
    expected = _reference(lambda t, z: _rate(t) - z / tau)
    _assert_same(
        laws.MaxwellBranch(tau=tau).features(PATH)[:, 0],
        expected[0],
        2e-5 if tau < 1e-3 else 1e-7,
    )


@pytest.mark.parametrize("zeta", [0.02, 0.5, 1.0, 1.4])
@pytest.mark.parametrize("covariate", [None, "ag"])
def test_hidden_oscillator_moves_by_newton(zeta, covariate):
    omega, m = 15.0, 2.0

    def pull(t, w):
        return 2.0 * zeta * omega * (_rate(t) - w[1]) + omega**2 * (_drift(t) - w[0])

    def ground(t):
        return 0.3 * np.sin(31.0 * t) if covariate else 0.0

    run = solve_ivp(
        lambda t, w: [w[1], pull(t, w) - ground(t)],
        (0.0, T[-1]),
        [_drift(0.0), _rate(0.0)],
        "DOP853",
        T,
        rtol=1e-11,
        atol=1e-14,
    )
    motion = Motion(PATH.s, PATH.v, PATH.a, T, {"ag": 0.3 * np.sin(31.0 * T)})
    found = laws.HiddenOscillator(omega, zeta, m, covariate).force(motion)
    _assert_same(found, m * pull(T, run.y), 1e-4 if covariate else 1e-7)


@pytest.mark.parametrize(
    ("ratio", "family"), [(0.1, "link"), (1.0, "oscillator"), (10.0, "inertia")]
)
def test_an_oscillator_that_does_not_resonate_in_the_band_is_a_tie_or_a_mass(
    ratio, family
):
    drive, t = 20.0, np.linspace(0.0, 40.0, 40001)
    motion = Motion(
        np.sin(drive * t), drive * np.cos(drive * t), -(drive**2) * np.sin(drive * t), t
    )
    law = laws.HiddenOscillator(ratio * drive, 0.1, 3.0)
    omega, last = ratio * drive, slice(-10000, None)
    steady = law.force(motion)[last]
    tie = 3.0 * (omega**2 * motion.s[last] + 0.2 * omega * motion.v[last])
    limits = {"link": tie, "inertia": 3.0 * motion.a[last]}
    near = {
        name: np.sqrt(np.mean((steady - f) ** 2) / np.mean(f**2))
        for name, f in limits.items()
    }
    assert law.limit(1.0, (15.0 / (2 * np.pi), 25.0 / (2 * np.pi))) == family
    assert {name for name, error in near.items() if error < 0.1} == {family} - {
        "oscillator"
    }


@pytest.mark.parametrize("uy", [1e-4, 7e-4, 2e-3])
def test_jenkins_is_the_stop_operator(uy):
    t = np.linspace(0.0, T[-1], 20 * (T.size - 1) + 1)
    play = 0.0
    plays = np.empty(t.size)
    for i, s in enumerate(_drift(t) - _drift(0.0)):  # Prandtl's play, sample by sample
        play = min(max(play, s - uy), s + uy)
        plays[i] = play
    stop = (_drift(t) - _drift(0.0) - plays)[::20] / uy
    _assert_same(laws.Jenkins(uy=uy).features(PATH)[:, 0], stop, 1e-5)
    iwan = laws.Iwan(uy=uy, ratio=2.5).features(PATH)
    assert np.array_equal(iwan[:, 0], laws.Jenkins(uy=uy).features(PATH)[:, 0])
    assert np.allclose(
        iwan[:, 1], laws.Jenkins(uy=2.5 * uy).features(PATH)[:, 0], rtol=0, atol=1e-12
    )
    for share in (0.3, 0.9):  # of the play that is backlash
        loose = laws.BacklashFriction(gap=share * uy, uy=(1.0 - share) * uy).features(
            PATH
        )[:, 0]
        beyond = np.clip((np.abs(stop) - share) / (1.0 - share), 0.0, 1.0)
        _assert_same(loose, np.sign(stop) * beyond, 1e-4)


def test_general_hysteresis_follows_any_masing_loop():
    sliders = laws.PrandtlIshlinskii(uy=2e-3, F=[1.0, 0.0, 2.0, 0.0, 0.0, 4.0])
    expected = sum(
        F * laws.Jenkins(uy=uy).features(PATH)[:, 0]
        for F, uy in ((1, 2e-3 / 32), (2, 2e-3 / 8), (4, 2e-3))
    )
    _assert_same(sliders.force(PATH), expected, 1e-12)
    joint = laws.Iwan(uy=3e-4, ratio=3.0, F1=2.0, F2=3.0).force(
        PATH
    )  # yields between the sliders
    assert nnls(sliders.features(PATH), joint)[1] < 0.05 * np.linalg.norm(joint)


def test_smooth_surface_holds_friction_and_polynomials():
    def left(law, surface, known):
        columns = np.column_stack([known, surface])
        force = law.features(PATH).sum(axis=1)
        return np.linalg.norm(
            force - columns @ np.linalg.lstsq(columns, force)[0]
        ) / np.linalg.norm(force)

    s, v = PATH.s, PATH.v
    known = np.column_stack([np.ones_like(s), s / s.std(), v / v.std()])
    surface = laws.SmoothSurface(S=3 * s.std(), V=0.1 * v.std())
    T = [np.polynomial.Chebyshev.basis(k) for k in range(6)]
    x, y = s / np.hypot(s, 3 * s.std()), v / np.hypot(v, 0.1 * v.std())
    expected = [T[i](x) * T[j](y) for i in range(6) for j in range(6 - i) if i + j]
    assert np.allclose(surface.features(PATH).T, expected, rtol=0, atol=1e-12)
    for law in (
        laws.CoulombFriction(),
        laws.CubicStiffness(),
        laws.QuadraticDamping(),
        laws.StribeckFriction(vs=0.02),
    ):
        assert left(law, surface.features(PATH), known) < 0.1, law
    power = laws.PowerSeries(5).features(PATH) / np.abs(
        laws.PowerSeries(5).features(PATH)
    ).max(axis=0)
    assert left(laws.CoulombFriction(), power, known) > 0.2


# -- the law in a free run -----------------------------------------------------


@pytest.mark.parametrize(
    "law", [cls() for _, cls in sorted(laws.registry().items())], ids=repr
)
def test_features_match_the_simulation(law):
    """m a + k s + c v + R = F closes on a simulated record, with R from the law's own
    columns.
    """
    t = np.arange(4001) / FS
    F = 60.0 * np.sin(8.0 * t) + 40.0 * np.sin(26.0 * t + 1.0)
    units = law.covariate_units or ("",)
    inputs = {
        c: 1.5 + np.sin(3 * t) if units[0] == "[u]" else 0.05 * np.sin(3 * t)
        for c in law.covariates
    }
    bounds = {
        p.name: p.bounds(drift=0.01, rate=0.09, duration=t[-1]) for p in law.shapes
    }
    law = law.with_values(
        shape={
            p.name: math.sqrt(math.prod(bounds[p.name])) if p.log else 0.45
            for p in law.shapes
        }
    )
    cycle = Motion(
        0.01 * np.sin(9 * t), 0.09 * np.cos(9 * t), -0.81 * np.sin(9 * t), t, inputs
    )
    peak = np.abs(law.features(cycle)).max(axis=0)
    law = law.with_values(5.0 / len(peak) / np.where(peak > 0, peak, 1.0))
    linear = laws.LinkSpringDashpot(k=1e4, c=60.0)
    held = (
        {1: [linear, law]} if "link" in law.acts_at else {1: [linear], "dof 1": [law]}
    )
    run = simulate(
        ChainModel([10.0], held),
        F[:, None],
        1 / FS,
        covariates=inputs or None,
        hold="cubic",
    )
    s, v, a = run.displacement[:, 0], run.velocity[:, 0], run.acceleration[:, 0]
    expected = F - 10.0 * a - 1e4 * s - 60.0 * v
    moving = v != 0.0  # where friction sticks, its force is what equilibrium asks for
    assert moving.sum() > 3900
    found = law.force(Motion(s, v, a, t, inputs))
    tolerance = (
        1e-3 if law.covariates and law.has_memory else 1e-4 if law.has_memory else 1e-11
    )
    gap = np.abs(found - expected)[moving].max() / np.abs(expected).max()
    assert gap < tolerance, f"largest difference {gap:.1e} of the peak"
