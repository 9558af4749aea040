"""The one solve: exact where theory says exact, and that of NumPy where the model is
wrong.
"""

import warnings

import chains
import numpy as np
import pytest
from chains import absent_share, worst
from hypothesis import given, settings
from hypothesis import strategies as st

from pysindy_nrf import Chain, NRFRegressor, laws
from pysindy_nrf.exceptions import BiasWarning, IdentifiabilityError, RankWarning

pytestmark = pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.BiasWarning")

# relative, of every mass and true coefficient; absent terms, of the storey's force
EXACT = 1e-8


def assert_exact(model, case, tolerance=EXACT):
    found = [model.restoring_forces_[i].coefficients for i in range(1, case.n + 1)]
    assert worst(model.masses_, case.m) < tolerance
    assert worst([f["s"] for f in found], case.k) < tolerance
    assert worst([f["v"] for f in found], case.c) < tolerance
    if case.k3.any():
        assert worst([f["s^3"] for f in found], case.k3) < tolerance
    assert (
        absent_share(model, case, ("v", "s", "s^3") if case.k3.any() else ("v", "s"))
        < tolerance
    )


# -- noise-free chains ---------------------------------------------------------


@pytest.mark.parametrize("cubic", [False, True], ids=["linear", "Duffing"])
@pytest.mark.parametrize("n", [1, 2, 3, 5, 10])
def test_each_single_forced_dof_gives_the_whole_chain(n, cubic):
    for case in chains.each_single(n, seed=n, n_samples=800, cubic=cubic):
        assert_exact(NRFRegressor(degree=3).fit(case.X, case.F), case)


@pytest.mark.parametrize("forced", [[50], list(range(1, 51))], ids=["last", "all"])
def test_fifty_storeys(forced):
    case = chains.duffing(50, forced, seed=3, n_samples=2500)
    assert_exact(NRFRegressor(degree=3).fit(case.X, case.F), case)


@pytest.mark.parametrize("strategy", ["complete", "sequential", "joint"])
@pytest.mark.parametrize("n", [1, 2, 4, 10])
def test_every_strategy_where_all_is_forced(n, strategy):
    case = chains.duffing(n, range(1, n + 1), seed=n, n_samples=1200)
    assert_exact(NRFRegressor(degree=3, strategy=strategy).fit(case.X, case.F), case)


@given(st.integers(1, 5), st.integers(0, 2**31), st.data())
@settings(max_examples=8)
def test_any_parameters_any_excitation(n, seed, data):
    forced = data.draw(st.sets(st.integers(1, n), min_size=1))
    case = chains.duffing(n, forced, seed=seed, n_samples=700)
    assert_exact(NRFRegressor(degree=3).fit(case.X, case.F), case)


@pytest.mark.parametrize("degree", [5, 9, 12])
def test_high_degrees_fall_back_on_qr_and_stay_exact(degree, chain4):
    model = NRFRegressor(degree=degree).fit(chain4.X, chain4.F)
    assert model.condition_.max() > 20
    assert_exact(model, chain4)


# -- what scales the chain besides a force -------------------------------------


@pytest.fixture(scope="module")
def shaken():
    """A chain of four storeys on a moving base, no force."""
    ag = chains.band_limited(4000, 1e-3, np.random.default_rng(5), rms=2.0)
    return chains.duffing(4, [], seed=7, n_samples=4000, ag=ag)


@pytest.mark.parametrize("known", [[1], [2], [3], [4], [3, 4], [1, 2, 3, 4]], ids=str)
def test_base_excitation_with_known_masses(shaken, known):
    given_masses = {j: shaken.m[j - 1] for j in known}
    model = NRFRegressor(degree=3, known_masses=given_masses).fit(
        shaken.X, base_acceleration=shaken.ag
    )
    assert_exact(model, shaken)
    if len(known) == 4:  # top down: each storey from the inertia above it
        assert [step.dofs for step in model.solve_order_.steps] == [
            (4,),
            (3, 4),
            (2, 3, 4),
            (1, 2, 3, 4),
        ]


def test_a_wrong_known_mass_scales_everything(shaken):
    model = NRFRegressor(degree=3, known_masses={2: 1.1 * shaken.m[1]}).fit(shaken.X)
    assert worst(model.masses_, 1.1 * shaken.m) < EXACT
    assert (
        worst(
            [model.restoring_forces_[i].coefficients["s"] for i in range(1, 5)],
            1.1 * shaken.k,
        )
        < EXACT
    )


@pytest.fixture(scope="module")
def hammer():
    """Three records of one chain, each with another floor hit; lengths differ."""
    same = chains.parameters(3, np.random.default_rng(9))
    return [
        chains.duffing(3, [j], seed=20 + j, n_samples=1200 + 300 * j, given=same)
        for j in (1, 2, 3)
    ]


def _pool(cases):
    ids = np.repeat(["first", "second", "third"], [len(c.X) for c in cases])
    return np.vstack([c.X for c in cases]), np.vstack([c.F for c in cases]), ids


@pytest.mark.parametrize("strategy", ["auto", "joint", "sequential"])
def test_roving_hammer_equals_one_record_with_all_forces(hammer, strategy):
    X, F, ids = _pool(hammer)
    roving = NRFRegressor(degree=3, strategy=strategy).fit(X, F, record=ids)
    together = chains.duffing(
        3,
        [1, 2, 3],
        seed=30,
        given=(hammer[0].m, hammer[0].c, hammer[0].k, hammer[0].k3),
    )
    once = NRFRegressor(degree=3).fit(together.X, together.F)
    assert_exact(roving, hammer[0])
    assert (
        once.solve_order_.strategy == "joint"
        and worst(roving.masses_, once.masses_) < EXACT
    )
    if strategy == "auto":
        assert (
            roving.solve_order_.strategy == "joint"
            and roving.third_law_gap_.max() < 1e-6
        )


def test_force_unknown_in_some_records(hammer):
    X, F, ids = _pool(hammer)
    spoiled = F.copy()
    spoiled[ids == "second", 1] = np.nan  # the force that acts there was lost
    model = NRFRegressor(degree=3).fit(X, spoiled, record=ids)
    assert_exact(model, hammer[0])
    wrong = F.copy()
    wrong[ids == "second", 1] = 0.0  # claiming that none acted is another thing
    assert (
        worst(NRFRegressor(degree=3).fit(X, wrong, record=ids).masses_, hammer[0].m)
        > 1e-3
    )


def test_force_unknown_in_every_record():
    case = chains.duffing(5, [1, 3, 5], seed=3)
    F = case.F.copy()
    F[:, 2] = np.nan
    with pytest.raises(
        IdentifiabilityError, match="m3 cannot be found: the force on DOF 3 is unknown"
    ):
        NRFRegressor(degree=3).fit(case.X, F)
    assert_exact(
        NRFRegressor(degree=3, known_masses={3: case.m[2]}).fit(case.X, F), case
    )


# -- other topologies ----------------------------------------------------------


def _brace_and_ground(x, v):
    total = np.zeros_like(x)
    brace = 3e4 * (x[..., 3] - x[..., 1]) + 20.0 * (v[..., 3] - v[..., 1])
    total[..., 3] -= brace
    total[..., 1] += brace
    total[..., 2] -= 2e4 * x[..., 2]
    return total


@pytest.mark.parametrize("forced", [[1], [2], [3], [4], [1, 2, 3, 4]], ids=str)
def test_a_brace_that_skips_a_floor_and_a_link_to_the_ground(forced):
    case = chains.duffing(4, forced, seed=11, n_samples=1500, extra=_brace_and_ground)
    chain = Chain(4, links=["link 4-2", "ground 3"])
    model = NRFRegressor(
        degree=3, chain=chain, orders={"link 4-2": 1, "ground 3": (0, 1)}
    ).fit(case.X, case.F)
    assert_exact(model, case)
    assert model.restoring_forces_["link 4-2"].coefficients.to_dict() == pytest.approx(
        {"v": 20.0, "s": 3e4}, rel=EXACT
    )
    assert model.restoring_forces_["link 3-0"].coefficients["s"] == pytest.approx(
        2e4, rel=EXACT
    )


def test_a_missing_brace_biases_the_masses():
    case = chains.duffing(4, [4], seed=11, extra=_brace_and_ground)
    with pytest.warns(BiasWarning):
        model = NRFRegressor(degree=3).fit(case.X, case.F)
    assert (
        worst(model.masses_, case.m) > 0.02 and model.errors_.loc["pooled", "error"] > 1
    )


def test_a_free_chain_floats():
    m, c, k, k3 = chains.parameters(3, np.random.default_rng(1))
    c[0] = k[0] = k3[0] = 0.0
    case = chains.duffing(3, [2], seed=1, given=(m, c, k, k3))
    model = NRFRegressor(degree=3, chain=Chain(3, ground="free")).fit(case.X, case.F)
    assert worst(model.masses_, m) < EXACT
    assert (
        worst([model.restoring_forces_[i].coefficients["s"] for i in (2, 3)], k[1:])
        < EXACT
    )
    assert model.modes()["frequency"].iloc[0] == pytest.approx(
        0.0, abs=1e-4
    )  # the rigid body
    assert not model.restoring_force(case.X)[:, 0].any()


@pytest.mark.parametrize("forced", [[1], [2], [3]], ids=str)
def test_a_chain_held_at_both_ends(forced):
    def wall(x, v):
        total = np.zeros_like(x)
        total[..., -1] -= 5e4 * x[..., -1] + 60.0 * v[..., -1]
        return total

    case = chains.duffing(3, forced, seed=1, extra=wall)
    model = NRFRegressor(degree=3, chain=Chain(3, ground="both")).fit(case.X, case.F)
    assert_exact(model, case)
    assert model.restoring_forces_[4].coefficients[
        ["v", "s"]
    ].tolist() == pytest.approx([60.0, 5e4], rel=EXACT)


# -- the paper's damper --------------------------------------------------------


@pytest.mark.parametrize(("strategy", "error"), [("complete", 1e-6), ("auto", 1e-4)])
def test_hysteresis_in_storey_1_leaves_storey_2_exact(dahl, strategy, error):
    case, *_ = dahl
    with pytest.warns(BiasWarning):
        model = NRFRegressor(degree=3, strategy=strategy).fit(case.X, case.F)
    R2 = case.storey_forces[:, 1]
    assert np.abs(model.restoring_force(case.X)[:, 1] - R2).max() < error * np.sqrt(
        np.mean(R2**2)
    )
    assert model.masses_[0] < 9.95 and model.third_law_gap_["storey 2"] > 0.1


def test_the_true_law_in_storey_1_gives_the_masses(dahl):
    case, z, R1 = dahl
    held = {"storey 1": [laws.PowerSeries(1), laws.Dahl(sigma=5e4)]}
    model = NRFRegressor(degree=1, laws=held, dt=case.dt).fit(case.X, case.F)
    assert worst(model.masses_, case.m) < 1e-6
    found = model.restoring_forces_[1].coefficients
    assert found.to_dict() == pytest.approx(
        {"v": 499.0, "s": 100050.0, "Z": 34.85}, rel=1e-5
    )
    assert (
        np.abs(model.restoring_force(case.X)[:, 0] - R1).max() < 1e-4 * np.abs(R1).max()
    )


def test_the_modified_dahl_law_with_its_constant_force():
    case, *_ = chains.paper_case(duration=2.0, f0=5.0)
    held = {"storey 1": [laws.ModifiedDahl(sigma=5e4)]}
    model = NRFRegressor(degree=1, laws=held, dt=case.dt).fit(case.X, case.F)
    assert worst(model.masses_, case.m) < 1e-5
    assert model.restoring_forces_[1].coefficients["1"] == pytest.approx(5.0, rel=1e-3)


@pytest.mark.parametrize(
    "others", [laws.PowerSeries(1), laws.PowerSeries(3)], ids=["linear", "cubic"]
)
def test_the_shape_of_the_loop_is_estimated(dahl, others):
    case, *_ = dahl
    with warnings.catch_warnings(action="error"):
        model = NRFRegressor(
            degree=1, laws={"storey 1": [others, laws.Dahl()]}, dt=case.dt
        ).fit(case.X, case.F)
    law = model.model_.laws["storey 1"][1]
    assert law.shape["sigma"] == pytest.approx(5e4, rel=1e-3) and law.coefficients[
        0
    ] == pytest.approx(34.85, rel=1e-4)
    assert worst(model.masses_, case.m) < 1e-4


# -- rank ----------------------------------------------------------------------


def _harmonic(noise, seed=0):
    t = np.arange(4000) * 1e-3
    w = 2 * np.pi * 5
    s, v = 1e-3 * np.sin(w * t), 1e-3 * w * np.cos(w * t)
    X = np.column_stack([-w * w * s, v, s])
    F = X @ [10.0, 50.0, 1e5]
    return (
        X
        + noise * X.std(axis=0) * np.random.default_rng(seed).standard_normal(X.shape),
        F,
    )


@pytest.mark.parametrize("degree", [1, 3])
def test_a_steady_harmonic_force_cannot_tell_mass_from_stiffness(degree):
    X, F = _harmonic(0.0)
    with pytest.raises(
        IdentifiabilityError, match="m1 cannot be told from the storey's stiffness"
    ):
        NRFRegressor(degree=degree).fit(X, F)


@pytest.mark.parametrize("noise", [1e-6, 1e-3, 0.02, 0.1])
@pytest.mark.parametrize("degree", [1, 3])
def test_noise_that_hides_the_rank_loss_is_warned_of(degree, noise):
    """Noise makes the columns independent and the mass meaningless: -45 kg instead of
    10 in this case.
    """
    X, F = _harmonic(noise)
    with pytest.warns(BiasWarning, match="m1 = .* kg is likely biased"):
        model = NRFRegressor(degree=degree).fit(X, F)
    assert abs(model.masses_[0] / 10 - 1) > 0.5


def test_with_the_mass_known_the_terms_that_cannot_be_told_apart_are_named():
    X, F = _harmonic(0.0)
    with pytest.warns(RankWarning, match="v\\^3.*linearly dependent"):
        model = NRFRegressor(degree=3, known_masses={1: 10.0}).fit(X, F)
    assert np.allclose(
        np.ravel(model.predict(X)), F, atol=1e-6 * np.abs(F).max()
    )  # the force is right all the same


def test_broad_excitation_raises_no_alarm(chain4):
    with warnings.catch_warnings(action="error"):
        NRFRegressor(degree=3).fit(chain4.noisy(0.005), chain4.F)
