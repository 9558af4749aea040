"""The closed loop on chains whose missing effect only the assertion knows.

The motions come from scipy's DOP853 with formulas written here, not from the package's own laws.
"""

from functools import cache

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from pysindy_nrf import Chain, ChainModel, NRFRegressor, Record, Site, close_loop, excitation, laws, simulate
from pysindy_nrf.discrepancy.catalogue import Candidate
from pysindy_nrf.discrepancy.prepare import prepare
from pysindy_nrf.discrepancy.reestimate import needless, reestimated
from pysindy_nrf.discrepancy.search import Finding, refine, screen
from pysindy_nrf.discrepancy.splits import split
from pysindy_nrf.discrepancy.stage import Stage
from pysindy_nrf.discrepancy.workspace import Workspace
from pysindy_nrf.exceptions import ChannelError, LawError
from pysindy_nrf.output.cli.group import cli
from pysindy_nrf.simulation.noise import add_noise

M = np.array([12.0, 10.0, 8.0])
K = np.array([4.0e4, 3.5e4, 3.0e4])
C = np.array([40.0, 30.0, 25.0])
DT = 1e-3


def force(n_samples, dofs, seed, rms=60.0):
    """Band-limited random forces, N."""
    rng = np.random.default_rng(seed)
    f = np.fft.rfftfreq(n_samples, DT)
    F = np.zeros((n_samples, 3))
    for j in dofs:
        y = np.fft.irfft((rng.standard_normal(len(f)) + 1j * rng.standard_normal(len(f))) * ((f > 0.5) & (f < 25)), n_samples)
        F[:, j - 1] = rms * y / y.std()
    return F


@cache
def record(effect=None, dofs=(3,), seed=0, n_samples=3500, states=0, noise=0.0, name="test"):
    """A three-storey chain with an effect: effect(t, x, v, z) -> (forces on the DOFs, dz/dt)."""
    F = force(n_samples, dofs, seed)
    t = np.arange(n_samples) * DT
    load = CubicSpline(t, F).c
    stiff = np.diag(K + np.append(K[1:], 0.0)) - np.diag(K[1:], 1) - np.diag(K[1:], -1)
    damp = np.diag(C + np.append(C[1:], 0.0)) - np.diag(C[1:], 1) - np.diag(C[1:], -1)

    def motion(time, x, v, z):
        i = min(int(time / DT), n_samples - 2)
        h = time - i * DT
        f = ((load[0, i] * h + load[1, i]) * h + load[2, i]) * h + load[3, i]
        extra, dz = effect(time, x, v, z) if effect else (0.0, z)
        return (f - stiff @ x - damp @ v + extra) / M, dz

    def rhs(time, y):
        x, v, z = y[:3], y[3:6], y[6:]
        a, dz = motion(time, x, v, z)
        return np.concatenate([v, a, dz])

    sol = solve_ivp(rhs, (0, t[-1]), np.zeros(6 + states), "DOP853", t_eval=t, rtol=1e-7, atol=1e-11)
    y = sol.y.T
    a = np.array([motion(ti, yi[:3], yi[3:6], yi[6:])[0] for ti, yi in zip(t, y)])
    rec = Record(force=F, acceleration=a, velocity=y[:, 3:6], displacement=y[:, :3], fs=1 / DT, name=name)
    return add_noise(rec, noise, random_state=seed + 1) if noise else rec


def on_storey_2(R):
    return np.array([R, -R, 0.0])


def friction(t, x, v, z):
    return on_storey_2(9.0 * np.tanh((v[1] - v[0]) / 2e-4)), z


def cubic(t, x, v, z):
    return on_storey_2(1.2e9 * (x[1] - x[0]) ** 3), z


def brace(t, x, v, z):
    R = 9e3 * (x[2] - x[0]) + 8.0 * (v[2] - v[0])
    return np.array([R, 0.0, -R]), z


def hysteresis(t, x, v, z):
    w = v[1] - v[0]
    dz = 900.0 * w - 900.0 * (0.6 * abs(w) * z + 0.4 * w * abs(z))
    return on_storey_2(14.0 * z[0]), np.atleast_1d(dz[0])


def brace_and_cubic(t, x, v, z):
    return brace(t, x, v, z)[0] + cubic(t, x, v, z)[0], z


def searched(rec):
    """The linear chain on the part of a record that the search sees."""
    data = prepare(rec).data
    work = Workspace(data, [None], *split(data.segments), {}, "auto")
    linear = (laws.PowerSeries(1),)
    return Stage(work, Chain(3), {Site(f"storey {i}"): linear for i in (1, 2, 3)})


CASES = {
    "friction": (friction, "friction", "storey 2", 0),
    "cubic": (cubic, "stiffness", "storey 2", 0),
    "brace": (brace, "link", "link 3-1", 0),
    "hysteresis": (hysteresis, "hysteresis", "storey 2", 1),
}


@pytest.mark.parametrize("name", CASES)
def test_one_undeclared_effect_is_found_where_it_acts(name):
    effect, family, site, states = CASES[name]
    report = close_loop(record(effect, dofs=(3,), seed=3, states=states, noise=0.01))
    step = report.steps[0]
    assert step.site == site
    assert family in (step.family, *step.alternatives)
    assert step.error_after < 0.5 * step.error_before
    assert report.model.masses == pytest.approx(M, rel=0.02)
    assert report.table.loc["baseline", "held-out"] == step.error_before
    assert len(step.alternatives) <= 2


def test_the_size_of_what_is_found():
    assert close_loop(record(cubic, seed=5)).steps[0].parameters["k3"] == pytest.approx(1.2e9, rel=1e-3)
    found = close_loop(record(brace, seed=5)).steps[0].parameters
    assert found["k"] == pytest.approx(9e3, rel=1e-3)
    assert found["c"] == pytest.approx(8.0, rel=1e-2)


@pytest.mark.parametrize("noise", [0.0, 0.02, 0.1])
@pytest.mark.parametrize("dofs", [(1, 2, 3), (2,)])
def test_nothing_is_added_where_nothing_is_missing(noise, dofs):
    report = close_loop(record(None, dofs=dofs, seed=7, noise=noise))
    assert report.steps == []
    assert len(report.table) == 1


def test_two_effects_on_different_sites():
    def both(t, x, v, z):
        w = v[0]
        return cubic(t, x, v, z)[0] + np.array([-40.0 * w * abs(w) * 8, 0.0, 0.0]), z

    report = close_loop(record(both, dofs=(1, 2, 3), seed=2, noise=0.01))
    assert {(s.family, s.site) for s in report.steps[:2]} == {("stiffness", "storey 2"), ("damping", "storey 1")}


@pytest.mark.slow
def test_friction_in_every_storey_is_found_though_none_stands_out():
    """The gate asks a single effect for 15 %; of three equal ones each is a third of what is missing."""
    level = 2e-4 * K

    def everywhere(t, x, v, z):
        R = level * np.tanh(np.diff(v, prepend=0.0) / 1e-4)
        return np.append(R[1:], 0.0) - R, z

    alone = [laws.CoulombFriction()]
    report = close_loop(record(everywhere, dofs=(1, 2, 3), seed=3, n_samples=3000, noise=0.03), catalogue=alone)
    assert {s.site for s in report.steps} == {"storey 1", "storey 2", "storey 3"}
    assert "together" in report.steps[-1].evidence
    assert close_loop(record(None, dofs=(1, 2, 3), seed=3, n_samples=3000, noise=0.03), catalogue=alone).steps == []


@pytest.mark.parametrize("when", [0.8, 1.9, 2.6])
def test_a_change_in_time_is_seen_whenever_it_happens(when):
    """Search blocks lie on both sides of everything that is held out."""

    def weaker(t, x, v, z):
        return on_storey_2(-9e3 * (x[1] - x[0]) * (t > when)), z

    report = close_loop(record(weaker, seed=3, noise=0.01, n_samples=3000), catalogue=[laws.StiffnessStep(), laws.StiffnessDrift()])
    step = report.steps[0]
    assert (step.law, step.site) == ("stiffness_step", "storey 2")
    assert step.parameters["dk"] == pytest.approx(-9e3, rel=0.03)
    low, high = step.intervals["t0"]
    assert low - 2 * DT <= when <= high + 2 * DT


def test_intervals_hold_the_truth():
    rec = record(brace, seed=5, noise=0.02, n_samples=3000)
    report = close_loop(rec, catalogue=[laws.LinkSpringDashpot(), laws.CubicStiffness()])
    found = report.steps[0]
    for name, truth in (("k", 9e3), ("c", 8.0)):
        low, high = found.intervals[name]
        assert low <= truth <= high
        assert high - low < 0.5 * truth

    def gap(t, x, v, z):
        s = x[1] - x[0]
        return on_storey_2(4e4 * (max(s - 2e-3, 0.0) + min(s + 2e-3, 0.0))), z

    found = close_loop(record(gap, seed=5, noise=0.01, n_samples=3000), catalogue=[laws.TwoSidedGap()]).steps[0]
    assert found.intervals["gap"][0] <= 2e-3 <= found.intervals["gap"][1] < 2.2e-3
    assert found.intervals["k"][0] <= 4e4 <= found.intervals["k"][1]


def test_a_later_effect_makes_a_stand_in_needless():
    """|s| s is a fair picture of s^3 until s^3 itself is there."""
    stage = searched(record(cubic, seed=1, noise=0.01, n_samples=3000))
    site = Site("storey 2")
    accepted = []
    for law in (laws.AbsoluteQuadraticStiffness(), laws.CubicStiffness()):
        stage = stage.with_law(site, law)
        accepted.append(Finding(Candidate(law, site), law, 0.0))
    assert needless(stage, accepted) is accepted[0]
    both = searched(record(brace_and_cubic, seed=1, noise=0.01, n_samples=3000))
    for place, law in (("link 3-1", laws.LinkSpringDashpot()), ("storey 2", laws.CubicStiffness())):
        both = both.with_law(Site(place), law)
    pair = [Finding(Candidate(laws.LinkSpringDashpot(), Site("link 3-1")), laws.LinkSpringDashpot(), 0.0), accepted[1]]
    assert needless(both, pair) is None


def test_earlier_shapes_are_estimated_again_beside_a_later_effect():
    def both(t, x, v, z):
        s = x[0]
        return brace(t, x, v, z)[0] - np.array([3e4 * (max(s - 4e-4, 0.0) + min(s + 4e-4, 0.0)), 0.0, 0.0]), z

    stage = searched(record(both, seed=1, n_samples=3000))
    first = Candidate(laws.TwoSidedGap(), Site("storey 1"))
    alone = refine(stage, screen(stage, [first])[0])
    biased = alone.law.shape["gap"]
    stage = alone.on(stage).with_law(Site("link 3-1"), laws.LinkSpringDashpot())
    again = reestimated(stage, [alone]).laws[Site("storey 1")][-1].shape["gap"]
    assert abs(again - 4e-4) < 0.02 * 4e-4 < abs(biased - 4e-4)


def test_an_effect_that_is_not_in_the_catalogue_gets_no_sure_name():
    other = [laws.CoulombFriction(), laws.QuadraticDamping(), laws.Dahl(), laws.StiffnessDrift(), laws.ConstantForce()]
    report = close_loop(record(brace, seed=3, noise=0.01), catalogue=other)
    assert all(not step.sure and "unexplained remainder" in step.sentence for step in report.steps)


def test_records_held_out_are_read_by_the_last_line_only():
    first = record(cubic, seed=1)
    report = close_loop(first, heldout=record(cubic, seed=2, name="other"))
    silent = record(None, seed=2, name="other")
    other = close_loop(first, heldout=silent)
    assert [s.law for s in other.steps] == [s.law for s in report.steps]
    assert other.model == report.model
    assert other.table.loc["baseline", "search"] == report.table.loc["baseline", "search"]
    assert other.steps[0].error_after != report.steps[0].error_after


@pytest.mark.slow
def test_the_same_seed_gives_the_same_report():
    rec, few = record(friction, seed=4, noise=0.02), [laws.CoulombFriction(), laws.PowerLawDamping(), laws.Dahl()]
    first, second = (close_loop(rec, catalogue=few, random_state=5) for _ in range(2))
    assert first.to_markdown() == second.to_markdown()


def test_the_loop_leaves_the_record_and_the_baseline_as_they_were():
    rec, baseline = record(cubic, seed=1), NRFRegressor(degree=1)
    before = {k: c.copy() for k, c in rec.channels().items()}
    close_loop(rec, baseline)
    assert all(np.array_equal(before[k], c) for k, c in rec.channels().items())
    assert not hasattr(baseline, "model_")


def test_a_declared_cubic_chain_is_left_alone():
    assert close_loop(record(cubic, seed=6, noise=0.01), NRFRegressor(degree=3)).steps == []


def test_report_on_paper(tmp_path):
    report = close_loop(record(cubic, seed=1))
    page = tmp_path / "report.html"
    report.to_html(page)
    text = page.read_text()
    assert "cubic_stiffness at storey 2" in text and "<script src" not in text
    assert "| baseline |" in report.to_markdown()
    assert report.stopped_because in report.to_markdown()


def test_channels_with_markup_in_their_names_are_escaped(tmp_path):
    rec = record(cubic, seed=1).replace(covariates={"<script>alert(1)</script>": np.sin(np.arange(3500) / 50)})
    report = close_loop(rec, catalogue=[laws.CubicStiffness(), laws.CoulombFriction()], max_steps=1)
    report.to_html(tmp_path / "r.html")
    assert "<script>alert" not in (tmp_path / "r.html").read_text()


def test_the_command_prints_and_writes_the_report(tmp_path):
    table = record(cubic, seed=1).to_frame()
    table.to_csv(tmp_path / "test.csv")
    result = CliRunner().invoke(cli, ["close-loop", str(tmp_path / "test.csv"), "-o", str(tmp_path / "out")], catch_exceptions=False)
    assert result.exit_code == 0
    assert "cubic_stiffness at storey 2" in result.output
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"model.json", "closed_loop.md", "closed_loop.html", "closed_loop.csv"}


def test_bad_input_is_named():
    with pytest.raises(ChannelError, match="not a Record"):
        close_loop(np.zeros((100, 3)))
    with pytest.raises(LawError, match="not a force law"):
        close_loop(record(n_samples=600), catalogue=["friction"])
    with pytest.raises(ValueError, match="nothing scales the chain"):
        close_loop(record(n_samples=600).replace(force=np.zeros((600, 3))))


@pytest.mark.slow
def test_a_harmonic_force_beside_a_resonance_is_found_although_least_squares_bends_to_it():
    """2 % above the first natural frequency; the free run of the held-out end needs its phase there."""
    m, k = np.array([20.0, 30.0, 25.0]), [3e4, 5e4, 4e4]
    storeys = {f"storey {i + 1}": [laws.LinearElastic(k[i]), laws.LinearViscous(22.0)] for i in range(3)}
    K = np.diag([k[0] + k[1], k[1] + k[2], k[2]]) - np.diag([k[1], k[2]], 1) - np.diag([k[1], k[2]], -1)
    first = np.sqrt(np.linalg.eigvalsh(K / np.sqrt(np.outer(m, m)))[0]) / (2 * np.pi)
    F = excitation.band_limited_random(3, 30.0, 400.0, dofs=3, rms=10.0, band=(0.3, 40), random_state=4)
    whole, t = F.copy(), np.arange(len(F)) / 400.0
    whole[:, 1] += 15.0 * np.cos(2 * np.pi * 1.02 * first * t + 0.4)
    rec = add_noise(simulate(ChainModel(m, storeys), whole, 1 / 400).replace(force=F), 0.01, random_state=5)
    report = close_loop(rec)
    assert [(s.law, s.site) for s in report.steps] == [("harmonic_force", "dof 2")]
    found = report.steps[0].parameters
    assert found["frequency"] == pytest.approx(1.02 * first, rel=1e-3)
    assert np.hypot(found["A"], found["B"]) == pytest.approx(15.0, rel=0.05)
    assert report.table["free run"].iloc[-1] < 2.0 < report.table["free run"].iloc[0]
