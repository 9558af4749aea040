"""The battery's simulations: independent of the package, right by another integrator,
of the size they claim.
"""

import ast
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

pytestmark = pytest.mark.slow

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
if not BENCHMARKS.is_dir():
    pytest.skip(
        "the benchmarks are not part of an installed package", allow_module_level=True
    )
sys.path.insert(0, str(BENCHMARKS))

from battery.formulas import KINDS  # noqa: E402
from battery.generators import (
    Effect,
    Structure,
    frequencies,
    make_case,
    shares,
    simulate,
)  # noqa: E402


def test_generators_do_not_know_the_package():
    for name in ("formulas.py", "generators.py"):
        tree = ast.parse((BENCHMARKS / "battery" / name).read_text())
        roots = {
            getattr(node, "module", None) or ""
            for node in ast.walk(tree)
            if isinstance(node, ast.ImportFrom)
        }
        roots |= {
            alias.name
            for node in ast.walk(tree)
            if isinstance(node, ast.Import)
            for alias in node.names
        }
        assert not any(r.startswith("pysindy_nrf") for r in roots)
    code = "import sys, battery.generators; sys.exit('pysindy_nrf' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=BENCHMARKS).returncode == 0


# Two-storey chain, effect in storey 2; the formulas once more, by hand, for scipy.
def bouc_wen(z, s, v, p):
    return v / p[1] * (1 - (p[2] * np.sign(v * z) + 1 - p[2]) * abs(z) ** p[3])


DRIFT_ONLY = {
    "cubic": ([4e8], lambda s, v, z, t, p: p[0] * s**3),
    "quadratic_damping": ([800.0, 0.0], lambda s, v, z, t, p: p[0] * v * abs(v)),
    "two_sided_gap": (
        [2e5, 5e-4, 0.0],
        lambda s, v, z, t, p: p[0] * (max(s - p[1], 0.0) + min(s + p[1], 0.0)),
    ),
    "stiffness_drift": ([4e4, 4.0], lambda s, v, z, t, p: p[0] * s * t / p[1]),
    "coulomb": ([5.0, 5e-4], lambda s, v, z, t, p: p[0] * np.tanh(v / p[1])),
}
WITH_STATE = {
    "maxwell": ([5e4, 0.02], lambda z, s, v, p: v - z / p[1]),
    "dahl": ([12.0, 2e3], lambda z, s, v, p: p[1] * v * (1 - z * np.sign(v))),
    "bouc_wen": ([15.0, 4e-4, 0.6, 2.0], bouc_wen),
}


@pytest.mark.parametrize("kind", [*DRIFT_ONLY, *WITH_STATE])
def test_simulation_agrees_with_dop853(kind):
    par = np.zeros(6)
    values, formula = (DRIFT_ONLY | WITH_STATE)[kind]
    par[: len(values)] = values
    rng = np.random.default_rng(3)
    fs, n = 400.0, 600
    t = np.arange(n) / fs
    m, k, c = np.array([10.0, 12.0]), np.array([1e5, 8e4]), np.array([60.0, 50.0])
    F = np.zeros((n, 2))
    F[:, 1] = 60 * sum(
        np.sin(2 * np.pi * f * t + rng.uniform(0, 6)) for f in (4.0, 7.0, 17.0, 25.0)
    )
    zero = np.zeros(n)
    run = simulate(
        Structure(m, k, c, np.zeros(2)),
        [Effect(kind, 2, 1, par)],
        F,
        zero,
        zero,
        zero,
        fs,
    )
    load = CubicSpline(t, F)

    def rhs(time, y):
        x1, x2, v1, v2, z = y
        s, v = x2 - x1, v2 - v1
        r1 = k[0] * x1 + c[0] * v1
        r2 = (
            k[1] * s
            + c[1] * v
            + (par[0] * z if kind in WITH_STATE else formula(s, v, z, time, par))
        )
        f = load(time)
        rate = formula(z, s, v, par) if kind in WITH_STATE else 0.0
        return [v1, v2, (f[0] - r1 + r2) / m[0], (f[1] - r2) / m[1], rate]

    exact = solve_ivp(
        rhs, (0, t[-1]), np.zeros(5), "DOP853", t, rtol=1e-9, atol=1e-12, max_step=2e-3
    ).y
    scale = np.abs(exact[:2]).max()
    assert np.abs(run.x.T - exact[:2]).max() < 2e-5 * scale
    assert np.abs(run.v.T - exact[2:4]).max() < 1e-4 * np.abs(exact[2:4]).max()


@pytest.mark.parametrize("kind", KINDS)
def test_a_case_is_what_it_claims(kind):
    case = make_case("x", "blind", 5, 0.05, (kind,), n_samples=4096)
    structure, effect, run = case.structure, case.effects[0], case.runs[0]
    f = frequencies(structure.m, structure.k)
    assert (
        1 - 1e-9 <= f[0]
        and f[-1] <= 30 + 1e-9
        and (structure.m >= 5).all()
        and (structure.m <= 5e4).all()
    )
    assert 0.03 <= effect.share <= 0.30
    assert shares(structure, case.effects, run)[0] == pytest.approx(effect.share)

    # the balances close on the clean channels, with the effect's force where the site
    # says
    s, v = (np.diff(y, axis=1, prepend=0.0) for y in (run.x, run.v))
    R = structure.k * s + structure.c * v
    left = structure.m * run.a + R - np.c_[R[:, 1:], np.zeros(len(s))] - run.F
    left[:, effect.p - 1] += run.effects[:, 0]
    if effect.q:
        left[:, effect.q - 1] -= run.effects[:, 0]
    assert np.abs(left).max() < 1e-9 * np.abs(R).max()
    # and the force follows from the sampled motion alone
    along = effect.force(run.t, *run.ends(effect), run.vg, 64)
    assert np.sqrt(np.mean((along - run.effects[:, 0]) ** 2)) < 0.01 * np.sqrt(
        np.mean(run.effects**2)
    )

    # white noise of 5 % of the rms on every channel, nothing on forces that are zero
    seen = case.seen[0]
    for name, clean in (
        ("acceleration", run.a),
        ("velocity", run.v),
        ("displacement", run.x),
        ("force", run.F),
    ):
        size = np.sqrt(np.mean(clean**2, axis=0))
        noise = np.sqrt(np.mean((seen[name] - clean) ** 2, axis=0))
        assert noise == pytest.approx(0.05 * size, rel=0.1)


@pytest.mark.slow
def test_quick_battery(tmp_path):
    """What can be heard is found where it is, and nothing where there is nothing."""
    from discrepancy_battery import main

    groups = ["--cases", "1", "--seed", "2", "--group", "blind", "nothing"]
    table = main(
        ["--quick", *groups, "--noise", "0.01", "--out", str(tmp_path / "rows.csv")]
    )
    assert len(table) == 2 and "crash" not in table
    assert table[table.group == "blind"].eligible.all() and table.right.all()


def test_the_search_finds_what_refitting_the_full_design_matrix_finds():
    """Hundreds of trials with the columns built for both: the same winner."""
    from search_speed import main

    told = main(["--quick"])
    assert told["trials"] > 300
    assert told["winner"] == ("friction", told["site"])
