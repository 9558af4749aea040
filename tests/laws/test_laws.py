"""States of the laws against the differential equations of the literature."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, nnls

from pysindy_nrf import ChainModel, laws, simulate
from pysindy_nrf.laws import Motion

FS = 2000.0


def drift(t):
    return 1e-3 * (np.sin(9.0 * t) + 0.6 * np.sin(23.0 * t + 1.0))


def rate(t):
    return 1e-3 * (9.0 * np.cos(9.0 * t) + 13.8 * np.cos(23.0 * t + 1.0))


def acceleration(t):
    return -1e-3 * (81.0 * np.sin(9.0 * t) + 317.4 * np.sin(23.0 * t + 1.0))


def motion_at(t, **covariates):
    """The motion of this page, from no drift on."""
    return Motion(drift(t) - drift(0.0), rate(t), acceleration(t), t, covariates)


T = np.arange(int(FS) + 1) / FS
MOTION = motion_at(T)


def reference(rate_of_state, n_states=1):
    """State by DOP853 from a fresh one, restarted where the motion turns."""
    fine = np.linspace(0.0, T[-1], 2001)
    before_turns = np.flatnonzero(np.diff(np.sign(rate(fine))))
    turns = [brentq(rate, fine[i], fine[i + 1], xtol=1e-15) for i in before_turns]
    edges = [0.0, *turns, T[-1]]

    z = np.zeros(n_states)
    path = np.zeros((n_states, T.size))
    for start, end in zip(edges[:-1], edges[1:], strict=True):
        rows = np.flatnonzero((start <= T) & (end > T))
        run = solve_ivp(
            rate_of_state,
            (start, end),
            z,
            method="DOP853",
            t_eval=np.append(T[rows], end),
            rtol=1e-11,
            atol=1e-13,
            max_step=0.001,
        )
        path[:, rows] = run.y[:, :-1]
        z = run.y[:, -1]
    path[:, -1] = z
    return path


def assert_same(values, expected, tolerance):
    """Equal up to a share of the peak."""
    gap = np.abs(values - expected).max() / np.abs(expected).max()
    assert gap < tolerance, f"largest difference {gap:.2e} of the peak"


# -- hysteresis ----------------------------------------------------------------


@pytest.mark.parametrize("sigma", [30.0, 3e3, 5e4])
def test_dahl_follows_equation_7(sigma):
    def equation_7(t, z):
        return sigma * rate(t) * (1.0 - z * np.sign(rate(t)))

    force = laws.Dahl(sigma=sigma).features(MOTION)[:, 0]
    assert_same(force, reference(equation_7)[0], 1e-7)


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
    alpha = 5e4
    beta = 1e3 if nu == 1.0 else (1.0 / 40.0) ** nu * 5e4  # bends at about 40 N

    def published(t, z):
        v = rate(t)
        unloading = gamma * abs(v) * abs(z) ** (nu - 1.0) * z
        return alpha * v - beta * (unloading + delta * v * abs(z) ** nu)

    law = laws.BoucWen(
        beta=(beta * gamma * alpha ** (nu - 1.0)) ** (1.0 / nu),
        rho=delta / gamma,
        n=nu,
        alpha=alpha,
    )
    assert_same(law.force(MOTION), reference(published)[0], tolerance)


@pytest.mark.parametrize(
    ("rho", "n", "strength", "stiffness"),
    [(0.0, 1.0, 300.0, 0.1), (0.0, 1.0, 100.0, 300.0), (-0.4, 1.7, 200.0, 80.0)],
)
def test_degrading_bouc_wen_follows_baber_and_wen(rho, n, strength, stiffness):
    beta = 2e3

    def published(t, state):
        w, work = state
        v = rate(t)
        size = (beta * abs(w)) ** n
        loss = abs(v) * np.sign(w) * size + rho * v * size
        w_rate = (v - (1.0 + strength * work) * loss) / (1.0 + stiffness * work)
        return [w_rate, beta * w * v]

    law = laws.DegradingBoucWen(beta, strength, stiffness, alpha=5e4, rho=rho, n=n)
    assert_same(law.force(MOTION), 5e4 * reference(published, n_states=2)[0], 1e-5)


@pytest.mark.parametrize(
    ("slip", "width", "q", "rho", "n"),
    [(0.9, 0.15, 0.0, 0.0, 1.0), (0.6, 0.8, 0.2, 0.0, 1.0), (0.8, 0.3, -0.1, 0.5, 2.0)],
)
def test_pinched_bouc_wen_follows_baber_and_noori(slip, width, q, rho, n):
    beta = 2e3

    def published(t, w):
        v = rate(t)
        size = (beta * abs(w)) ** n
        h = 1.0 - slip * np.exp(-(((beta * w * np.sign(v) - q) / width) ** 2))
        return h * (v - abs(v) * np.sign(w) * size - rho * v * size)

    law = laws.PinchedBoucWen(beta, slip, width, alpha=5e4, q=q, rho=rho, n=n)
    assert_same(law.force(MOTION), 5e4 * reference(published)[0], 1e-5)


@pytest.mark.parametrize(
    ("sigma0", "sigma1", "vs", "ratio"),
    [(1e5, 300.0, 5e-3, 1.5), (2e4, 0.0, 2e-2, 2.5)],
)
def test_lugre_follows_its_authors(sigma0, sigma1, vs, ratio):
    Fc = 20.0

    def bristle_rate(t, z):
        v = rate(t)
        level = Fc + Fc * (ratio - 1.0) * np.exp(-((v / vs) ** 2))
        return v - sigma0 * abs(v) / level * z

    z = reference(bristle_rate)[0]
    expected = sigma0 * z + sigma1 * bristle_rate(T, z)
    law = laws.LuGre(sigma=sigma0 / Fc, vs=vs, ratio=ratio, Fc=Fc, sigma1=sigma1)
    assert_same(law.force(MOTION), expected, 2e-4)
    fine = motion_at(np.arange(0.0, T[-1] + 5e-6, 1e-5))
    assert_same(law.force(fine)[::50], expected, 1e-5)


@pytest.mark.parametrize("uy", [1e-4, 7e-4, 2e-3])
def test_jenkins_is_the_stop_operator(uy):
    stop = stop_operator(uy)
    jenkins = laws.Jenkins(uy=uy).features(MOTION)[:, 0]
    assert_same(jenkins, stop, 1e-5)
    for play in (0.3, 0.9):  # share that is backlash
        law = laws.BacklashFriction(gap=play * uy, uy=(1.0 - play) * uy)
        beyond = np.clip((np.abs(stop) - play) / (1.0 - play), 0.0, 1.0)
        assert_same(law.features(MOTION)[:, 0], np.sign(stop) * beyond, 1e-4)


def stop_operator(uy):
    """Drift less Prandtl's play, sample by sample, over the yield drift."""
    t = np.linspace(0.0, T[-1], 20 * (T.size - 1) + 1)
    s = drift(t) - drift(0.0)
    play = np.empty(t.size)
    centre = 0.0
    for i in range(t.size):
        centre = min(max(centre, s[i] - uy), s[i] + uy)
        play[i] = centre
    return (s - play)[::20] / uy


@pytest.mark.parametrize("uy", [1e-4, 7e-4, 2e-3])
def test_iwan_is_two_jenkins_elements(uy):
    iwan = laws.Iwan(uy=uy, ratio=2.5).features(MOTION)
    first = laws.Jenkins(uy=uy).features(MOTION)[:, 0]
    second = laws.Jenkins(uy=2.5 * uy).features(MOTION)[:, 0]
    np.testing.assert_array_equal(iwan[:, 0], first)
    np.testing.assert_allclose(iwan[:, 1], second, rtol=0, atol=1e-12)


# -- elements that know the time -----------------------------------------------


@pytest.mark.parametrize(
    ("tau", "tolerance"), [(1e-4, 2e-5), (0.005, 1e-7), (0.03, 1e-7), (5.0, 1e-7)]
)
def test_maxwell_branch_relaxes(tau, tolerance):
    expected = reference(lambda t, z: rate(t) - z / tau)[0]
    force = laws.MaxwellBranch(tau=tau).features(MOTION)[:, 0]
    assert_same(force, expected, tolerance)


@pytest.mark.parametrize("zeta", [0.02, 0.5, 1.0, 1.4])
@pytest.mark.parametrize(
    ("covariate", "tolerance"), [(None, 1e-7), ("ag", 1e-4)], ids=["fixed", "shaken"]
)
def test_hidden_oscillator_moves_by_newton(zeta, covariate, tolerance):
    omega = 15.0
    mass = 2.0
    ground = 0.3 if covariate else 0.0

    def pull(t, w, w_rate):
        return 2.0 * zeta * omega * (rate(t) - w_rate) + omega**2 * (drift(t) - w)

    def newton(t, state):
        w, w_rate = state
        return [w_rate, pull(t, w, w_rate) - ground * np.sin(31.0 * t)]

    start = [drift(0.0), rate(0.0)]
    run = solve_ivp(newton, (0.0, T[-1]), start, "DOP853", T, rtol=1e-11, atol=1e-14)
    law = laws.HiddenOscillator(omega, zeta, mass, covariate)
    force = law.force(motion_at(T, ag=0.3 * np.sin(31.0 * T)))
    assert_same(force, mass * pull(T, *run.y), tolerance)


FREQUENCY_OF_DRIVE = 20.0  # rad/s


def share_of_rms(gap, force):
    return np.sqrt(np.mean(gap**2) / np.mean(force**2))


def steady_force_of_oscillator(omega):
    """Last quarter of its force under a sine, and those of a tie and of a mass."""
    t = np.linspace(0.0, 40.0, 40001)
    phase = FREQUENCY_OF_DRIVE * t
    s = np.sin(phase)
    v = FREQUENCY_OF_DRIVE * np.cos(phase)
    a = -(FREQUENCY_OF_DRIVE**2) * s
    force = laws.HiddenOscillator(omega, 0.1, 3.0).force(Motion(s, v, a, t))
    tie = 3.0 * (omega**2 * s + 0.2 * omega * v)
    last = slice(-10000, None)
    return force[last], tie[last], 3.0 * a[last]


@pytest.mark.parametrize(
    ("ratio", "family"), [(0.1, "link"), (1.0, "oscillator"), (10.0, "inertia")]
)
def test_an_oscillator_off_resonance_is_a_tie_or_a_mass(ratio, family):
    omega = ratio * FREQUENCY_OF_DRIVE
    force, tie, inertia = steady_force_of_oscillator(omega)
    is_tie = share_of_rms(force - tie, tie) < 0.1
    is_mass = share_of_rms(force - inertia, inertia) < 0.1
    assert is_tie == (family == "link")
    assert is_mass == (family == "inertia")
    band = 15.0 / (2 * np.pi), 25.0 / (2 * np.pi)
    assert laws.HiddenOscillator(omega, 0.1, 3.0).limit(1.0, band) == family


# -- general laws --------------------------------------------------------------


def test_general_hysteresis_contains_sliders():
    general = laws.PrandtlIshlinskii(uy=2e-3, F=[1.0, 0.0, 2.0, 0.0, 0.0, 4.0])
    first = laws.Jenkins(uy=2e-3 / 32, Fy=1.0)
    second = laws.Jenkins(uy=2e-3 / 8, Fy=2.0)
    third = laws.Jenkins(uy=2e-3, Fy=4.0)
    expected = first.force(MOTION) + second.force(MOTION) + third.force(MOTION)
    assert_same(general.force(MOTION), expected, 1e-12)


def test_general_hysteresis_follows_any_masing_loop():
    sliders = laws.PrandtlIshlinskii(uy=2e-3)
    # yields between the sliders
    joint = laws.Iwan(uy=3e-4, ratio=3.0, F1=2.0, F2=3.0).force(MOTION)
    _, residual = nnls(sliders.features(MOTION), joint)
    assert residual < 0.05 * np.linalg.norm(joint)


def test_smooth_surface_is_of_chebyshev_polynomials():
    s, v = MOTION.s, MOTION.v
    law = laws.SmoothSurface(S=3 * s.std(), V=0.1 * v.std())
    polynomials = [np.polynomial.Chebyshev.basis(k) for k in range(6)]
    x = s / np.hypot(s, 3 * s.std())
    y = v / np.hypot(v, 0.1 * v.std())
    expected = []
    for i in range(6):
        for j in range(6 - i):
            if i + j > 0:
                expected.append(polynomials[i](x) * polynomials[j](y))
    np.testing.assert_allclose(law.features(MOTION).T, expected, rtol=0, atol=1e-12)


def unexplained(law, columns):
    """Share of a force that columns beside a linear storey and a constant leave."""
    s, v = MOTION.s, MOTION.v
    linear = np.column_stack([np.ones_like(s), s / s.std(), v / v.std()])
    regressors = np.column_stack([linear, columns])
    force = law.features(MOTION).sum(axis=1)
    coefficients = np.linalg.lstsq(regressors, force)[0]
    return np.linalg.norm(force - regressors @ coefficients) / np.linalg.norm(force)


def test_smooth_surface_follows_friction_as_well_as_polynomials():
    s, v = MOTION.s, MOTION.v
    surface = laws.SmoothSurface(S=3 * s.std(), V=0.1 * v.std()).features(MOTION)
    power_series = laws.PowerSeries(5).features(MOTION)
    power_series /= np.abs(power_series).max(axis=0)
    assert unexplained(laws.CoulombFriction(), surface) < 0.1
    assert unexplained(laws.CubicStiffness(), surface) < 0.1
    assert unexplained(laws.QuadraticDamping(), surface) < 0.1
    assert unexplained(laws.StribeckFriction(vs=0.02), surface) < 0.1
    assert unexplained(laws.CoulombFriction(), power_series) > 0.2


# -- the law in a free run -----------------------------------------------------

T_RUN = np.arange(4001) / FS
MASS = 10.0
STOREY = laws.LinkSpringDashpot(k=1e4, c=60.0)
REGISTERED = [laws.registry()[name]() for name in sorted(laws.registry())]


def covariates_of(law):
    """A command about 1.5 for a law of any unit, else a motion of the base."""
    wave = np.sin(3 * T_RUN)
    values = 1.5 + wave if law.covariate_units == ("[u]",) else 0.05 * wave
    return dict.fromkeys(law.covariates, values)


def with_forces_of_five_newtons(law, covariates):
    """The law with shapes in the middle of their bounds and a peak of 5 N."""
    shape = {}
    for parameter in law.shapes:
        bounds = parameter.bounds(drift=0.01, rate=0.09, duration=T_RUN[-1])
        shape[parameter.name] = math.sqrt(math.prod(bounds)) if parameter.log else 0.45
    law = law.with_values(shape=shape)
    sine = np.sin(9 * T_RUN)
    cosine = np.cos(9 * T_RUN)
    cycle = Motion(0.01 * sine, 0.09 * cosine, -0.81 * sine, T_RUN, covariates)
    peaks = np.abs(law.features(cycle)).max(axis=0)
    return law.with_values(5.0 / len(peaks) / np.where(peaks > 0, peaks, 1.0))


@pytest.mark.parametrize("law", REGISTERED, ids=repr)
def test_features_match_the_simulation(law):
    """m a + k s + c v + R = F closes on a simulated record; the columns give R."""
    covariates = covariates_of(law)
    law = with_forces_of_five_newtons(law, covariates)
    by_site = {1: [STOREY, law]}
    if "link" not in law.acts_at:
        by_site = {1: [STOREY], "dof 1": [law]}
    F = 60.0 * np.sin(8.0 * T_RUN) + 40.0 * np.sin(26.0 * T_RUN + 1.0)
    model = ChainModel([MASS], by_site)
    run = simulate(model, F[:, None], 1 / FS, covariates=covariates, hold="cubic")

    s = run.displacement[:, 0]
    v = run.velocity[:, 0]
    a = run.acceleration[:, 0]
    expected = F - MASS * a - 1e4 * s - 60.0 * v
    force = law.force(Motion(s, v, a, T_RUN, covariates))
    moving = v != 0.0  # where friction sticks, its force is what equilibrium asks for
    assert moving.sum() > 3900
    gap = np.abs(force - expected)[moving].max() / np.abs(expected).max()
    assert gap < tolerance_of(law), f"largest difference {gap:.1e} of the peak"


def tolerance_of(law):
    """The state moves between samples of the features, and a covariate with it."""
    if not law.has_memory:
        return 1e-11
    return 1e-3 if law.covariates else 1e-4
