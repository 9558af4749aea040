"""The battery's simulations: independent of the package, right by another integrator,
of the size they claim.
"""

import ast
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from battery import generators
from battery.formulas import KINDS
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

pytestmark = pytest.mark.slow

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


def modules_imported_by(path):
    """Names of the modules that a file imports."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom):
            yield node.module or ""
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)


@pytest.mark.parametrize("name", ["formulas.py", "generators.py"])
def test_generators_do_not_name_the_package(name):
    for module in modules_imported_by(BENCHMARKS / "battery" / name):
        assert not module.startswith("pysindy_nrf")


def test_generators_do_not_load_the_package():
    code = "import sys, battery.generators; sys.exit('pysindy_nrf' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=BENCHMARKS).returncode == 0


# -- another integrator --------------------------------------------------------
# a two-storey chain, an effect in storey 2; the formulas once more, by hand

M = np.array([10.0, 12.0])
K = np.array([1e5, 8e4])
C = np.array([60.0, 50.0])
FS, N_SAMPLES = 400.0, 600
T = np.arange(N_SAMPLES) / FS


def cubic(s, v, t, p):
    return p[0] * s**3


def quadratic_damping(s, v, t, p):
    return p[0] * v * abs(v)


def two_sided_gap(s, v, t, p):
    return p[0] * (max(s - p[1], 0.0) + min(s + p[1], 0.0))


def stiffness_drift(s, v, t, p):
    return p[0] * s * t / p[1]


def coulomb(s, v, t, p):
    return p[0] * np.tanh(v / p[1])


def maxwell(z, s, v, p):
    return v - z / p[1]


def dahl(z, s, v, p):
    return p[1] * v * (1 - z * np.sign(v))


def bouc_wen(z, s, v, p):
    return v / p[1] * (1 - (p[2] * np.sign(v * z) + 1 - p[2]) * abs(z) ** p[3])


@pytest.fixture(scope="module")
def load():
    """Random sines on the second floor, N."""
    rng, force = np.random.default_rng(3), np.zeros((N_SAMPLES, 2))
    for frequency in (4.0, 7.0, 17.0, 25.0):
        wave = np.sin(2 * np.pi * frequency * T + rng.uniform(0, 6))
        force[:, 1] += 60 * wave
    return force


def run_of(kind, parameters, load):
    """The battery's simulation."""
    par, still = np.zeros(6), np.zeros(N_SAMPLES)
    par[: len(parameters)] = parameters
    structure = generators.Structure(M, K, C, np.zeros(2))
    effect = generators.Effect(kind, 2, 1, par)
    return generators.simulate(structure, [effect], load, still, still, still, FS)


def exact_motion(force, rate, load):
    """Displacements and velocities by DOP853, (4, n_samples).

    From the force of the effect, force(s, v, z, t), and the rate of its state.
    """
    loads = CubicSpline(T, load)

    def derivative(t, y):
        x1, x2, v1, v2, z = y
        s, v = x2 - x1, v2 - v1
        below = K[0] * x1 + C[0] * v1
        above = K[1] * s + C[1] * v + force(s, v, z, t)
        f1, f2 = loads(t)
        return [v1, v2, (f1 - below + above) / M[0], (f2 - above) / M[1], rate(z, s, v)]

    steps = {"rtol": 1e-9, "atol": 1e-12, "max_step": 2e-3}
    return solve_ivp(derivative, (0, T[-1]), np.zeros(5), "DOP853", T, **steps).y[:4]


def assert_same_motion(run, exact):
    x, v = exact[:2], exact[2:]
    assert np.abs(run.x.T - x).max() < 2e-5 * np.abs(x).max()
    assert np.abs(run.v.T - v).max() < 1e-4 * np.abs(v).max()


@pytest.mark.parametrize(
    ("law", "parameters"),
    [
        (cubic, [4e8]),
        (quadratic_damping, [800.0, 0.0]),
        (two_sided_gap, [2e5, 5e-4, 0.0]),
        (stiffness_drift, [4e4, 4.0]),
        (coulomb, [5.0, 5e-4]),
    ],
)
def test_a_law_of_the_motion_agrees_with_dop853(law, parameters, load):
    def force(s, v, z, t):
        return law(s, v, t, parameters)

    exact = exact_motion(force, lambda z, s, v: 0.0, load)
    assert_same_motion(run_of(law.__name__, parameters, load), exact)


@pytest.mark.parametrize(
    ("law", "parameters"),
    [
        (maxwell, [5e4, 0.02]),
        (dahl, [12.0, 2e3]),
        (bouc_wen, [15.0, 4e-4, 0.6, 2.0]),
    ],
)
def test_a_law_with_a_state_agrees_with_dop853(law, parameters, load):
    def force(s, v, z, t):
        return parameters[0] * z

    exact = exact_motion(force, lambda z, s, v: law(z, s, v, parameters), load)
    assert_same_motion(run_of(law.__name__, parameters, load), exact)


# -- cases ---------------------------------------------------------------------


@pytest.fixture(scope="module", params=KINDS)
def case(request):
    """A case with one effect and 5 % noise."""
    kind = (request.param,)
    return generators.make_case("x", "blind", 5, 0.05, kind, n_samples=4096)


def test_a_chain_has_the_frequencies_and_masses_it_claims(case):
    structure = case.structure
    frequencies = generators.frequencies(structure.m, structure.k)
    assert 1 - 1e-9 <= frequencies[0]
    assert frequencies[-1] <= 30 + 1e-9
    assert structure.m.min() >= 5
    assert structure.m.max() <= 5e4


def test_an_effect_has_the_share_it_claims(case):
    (effect,) = case.effects
    assert 0.03 <= effect.share <= 0.30
    shares = generators.shares(case.structure, case.effects, case.runs[0])
    assert shares[0] == pytest.approx(effect.share)


def test_the_balances_close_on_clean_channels(case):
    """With the effect's force where its site says."""
    structure, run = case.structure, case.runs[0]
    (effect,) = case.effects
    drift = np.diff(run.x, axis=1, prepend=0.0)
    rate = np.diff(run.v, axis=1, prepend=0.0)
    storeys = structure.k * drift + structure.c * rate
    above = np.c_[storeys[:, 1:], np.zeros(len(drift))]
    residual = structure.m * run.a + storeys - above - run.F
    residual[:, effect.p - 1] += run.effects[:, 0]
    if effect.q:
        residual[:, effect.q - 1] -= run.effects[:, 0]
    assert np.abs(residual).max() < 1e-9 * np.abs(storeys).max()


def test_a_force_follows_from_the_sampled_motion_alone(case):
    run, (effect,) = case.runs[0], case.effects
    along = effect.force(run.t, *run.ends(effect), run.vg, 64)
    missed = np.sqrt(np.mean((along - run.effects[:, 0]) ** 2))
    assert missed < 0.01 * np.sqrt(np.mean(run.effects**2))


@pytest.mark.parametrize(
    ("name", "clean"),
    [("acceleration", "a"), ("velocity", "v"), ("displacement", "x"), ("force", "F")],
)
def test_every_channel_has_the_noise_it_claims(case, name, clean):
    """White, 5 % of its rms; nothing on forces that are zero."""
    true = getattr(case.runs[0], clean)
    size = np.sqrt(np.mean(true**2, axis=0))
    noise = np.sqrt(np.mean((case.searched[0][name] - true) ** 2, axis=0))
    assert noise == pytest.approx(0.05 * size, rel=0.1)


# -- the benchmarks themselves -------------------------------------------------


def test_quick_battery(tmp_path):
    """What can be heard is found where it is, and nothing where there is nothing."""
    from discrepancy_battery import main

    groups = ["--cases", "1", "--seed", "2", "--group", "blind", "nothing"]
    out = ["--noise", "0.01", "--out", str(tmp_path / "rows.csv")]
    table = main(["--quick", *groups, *out])
    assert len(table) == 2 and "crash" not in table
    assert table[table.group == "blind"].eligible.all()
    assert table.right.all()


def test_the_search_finds_what_refitting_the_full_design_matrix_finds():
    """Hundreds of trials with the columns built for both: the same winner."""
    from search_speed import main

    code = main(["--quick"])
    assert code["trials"] > 300
    assert code["winner"] == ("friction", code["site"])
