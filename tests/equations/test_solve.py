"""Whole chains: exact where theory says exact, whatever scales them."""

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


def coefficients(model, label, storeys):
    return [model.restoring_forces_[i].coefficients[label] for i in storeys]


def assert_exact(model, case):
    storeys = range(1, case.n + 1)
    assert worst(model.masses_, case.m) < EXACT
    assert worst(coefficients(model, "s", storeys), case.k) < EXACT
    assert worst(coefficients(model, "v", storeys), case.c) < EXACT
    true = ["v", "s"]
    if case.k3.any():
        assert worst(coefficients(model, "s^3", storeys), case.k3) < EXACT
        true.append("s^3")
    assert absent_share(model, case, true) < EXACT


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
    """Four storeys on a moving base, no force."""
    ag = chains.band_limited(4000, 1e-3, np.random.default_rng(5), rms=2.0)
    return chains.duffing(4, [], seed=7, n_samples=4000, ag=ag)


def with_masses(case, dofs):
    """An estimator that knows some of the masses."""
    known = {dof: case.m[dof - 1] for dof in dofs}
    return NRFRegressor(degree=3, known_masses=known)


@pytest.mark.parametrize("known", [[1], [2], [3], [4], [3, 4], [1, 2, 3, 4]], ids=str)
def test_base_excitation_with_known_masses(shaken, known):
    model = with_masses(shaken, known).fit(shaken.X, base_acceleration=shaken.ag)
    assert_exact(model, shaken)


def test_with_all_masses_known_each_storey_follows_from_the_inertia_above(shaken):
    model = with_masses(shaken, [1, 2, 3, 4]).fit(shaken.X)
    summed = [step.dofs for step in model.solve_order_.steps]
    assert summed == [(4,), (3, 4), (2, 3, 4), (1, 2, 3, 4)]


def test_a_wrong_known_mass_scales_everything(shaken):
    wrong = {2: 1.1 * shaken.m[1]}
    model = NRFRegressor(degree=3, known_masses=wrong).fit(shaken.X)
    assert worst(model.masses_, 1.1 * shaken.m) < EXACT
    stiffness = coefficients(model, "s", range(1, 5))
    assert worst(stiffness, 1.1 * shaken.k) < EXACT


class Hammer:
    """Three records of one chain, each with another floor hit; lengths differ."""

    def __init__(self):
        parameters = chains.parameters(3, np.random.default_rng(9))
        self.cases = []
        for j in (1, 2, 3):
            size = 1200 + 300 * j
            case = chains.duffing(
                3, [j], seed=20 + j, n_samples=size, parameters_of_chain=parameters
            )
            self.cases.append(case)
        self.truth = self.cases[0]
        self.parameters = parameters

    @property
    def X(self):
        return np.vstack([case.X for case in self.cases])

    @property
    def F(self):
        return np.vstack([case.F for case in self.cases])

    @property
    def ids(self):
        lengths = [len(case.X) for case in self.cases]
        return np.repeat(["first", "second", "third"], lengths)

    def fit(self, F=None, **settings):
        model = NRFRegressor(degree=3, **settings)
        return model.fit(self.X, self.F if F is None else F, record=self.ids)


@pytest.fixture(scope="module")
def hammer():
    return Hammer()


@pytest.mark.parametrize("strategy", ["auto", "joint", "sequential"])
def test_a_roving_hammer_gives_the_whole_chain(hammer, strategy):
    assert_exact(hammer.fit(strategy=strategy), hammer.truth)


def test_a_roving_hammer_equals_one_record_with_all_forces(hammer):
    together = chains.duffing(
        3, [1, 2, 3], seed=30, parameters_of_chain=hammer.parameters
    )
    once = NRFRegressor(degree=3).fit(together.X, together.F)
    roving = hammer.fit()
    assert once.solve_order_.strategy == roving.solve_order_.strategy == "joint"
    assert worst(roving.masses_, once.masses_) < EXACT
    assert roving.third_law_gap_.max() < 1e-6


def test_a_force_that_is_unknown_in_some_records(hammer):
    F = hammer.F
    F[hammer.ids == "second", 1] = np.nan
    assert_exact(hammer.fit(F), hammer.truth)


def test_to_say_that_no_force_acted_is_another_thing(hammer):
    F = hammer.F
    F[hammer.ids == "second", 1] = 0.0
    assert worst(hammer.fit(F).masses_, hammer.truth.m) > 1e-3


@pytest.fixture(scope="module")
def never_measured():
    """Five floors, three of them forced, the force on DOF 3 lost in every record."""
    case = chains.duffing(5, [1, 3, 5], seed=3)
    case.F[:, 2] = np.nan
    return case


def test_a_force_that_is_unknown_in_every_record(never_measured):
    case = never_measured
    with pytest.raises(IdentifiabilityError, match="m3 cannot be found: the force"):
        NRFRegressor(degree=3).fit(case.X, case.F)


def test_a_weighed_floor_needs_no_force(never_measured):
    case = never_measured
    assert_exact(with_masses(case, [3]).fit(case.X, case.F), case)


# -- other topologies ----------------------------------------------------------


def brace_and_ground(x, v):
    """Forces of a link from floor 4 to 2 and of a spring from floor 3 to the ground."""
    total = np.zeros_like(x)
    brace = 3e4 * (x[..., 3] - x[..., 1]) + 20.0 * (v[..., 3] - v[..., 1])
    total[..., 3] -= brace
    total[..., 1] += brace
    total[..., 2] -= 2e4 * x[..., 2]
    return total


@pytest.mark.parametrize("forced", [[1], [2], [3], [4], [1, 2, 3, 4]], ids=str)
def test_a_brace_that_skips_a_floor_and_a_link_to_the_ground(forced):
    case = chains.duffing(4, forced, seed=11, n_samples=1500, extra=brace_and_ground)
    chain = Chain(4, links=["link 4-2", "ground 3"])
    orders = {"link 4-2": 1, "ground 3": (0, 1)}
    model = NRFRegressor(degree=3, chain=chain, orders=orders).fit(case.X, case.F)
    assert_exact(model, case)
    brace = model.restoring_forces_["link 4-2"].coefficients
    assert brace.to_dict() == pytest.approx({"v": 20.0, "s": 3e4}, rel=EXACT)
    spring = model.restoring_forces_["link 3-0"].coefficients
    assert spring["s"] == pytest.approx(2e4, rel=EXACT)


def test_a_missing_brace_biases_the_masses():
    case = chains.duffing(4, [4], seed=11, extra=brace_and_ground)
    with pytest.warns(BiasWarning):
        model = NRFRegressor(degree=3).fit(case.X, case.F)
    assert worst(model.masses_, case.m) > 0.02
    assert model.errors_.loc["pooled", "error"] > 1


def test_a_free_chain_floats():
    m, c, k, k3 = chains.parameters(3, np.random.default_rng(1))
    for law in (c, k, k3):
        law[0] = 0.0
    case = chains.duffing(3, [2], seed=1, parameters_of_chain=(m, c, k, k3))
    model = NRFRegressor(degree=3, chain=Chain(3, ground="free")).fit(case.X, case.F)
    assert worst(model.masses_, m) < EXACT
    assert worst(coefficients(model, "s", [2, 3]), k[1:]) < EXACT
    rigid = model.modes()["frequency"].iloc[0]
    assert rigid == pytest.approx(0.0, abs=1e-4)
    assert not model.restoring_force(case.X)[:, 0].any()


def wall(x, v):
    """A spring and dashpot between the last floor and the ground."""
    total = np.zeros_like(x)
    total[..., -1] -= 5e4 * x[..., -1] + 60.0 * v[..., -1]
    return total


@pytest.mark.parametrize("forced", [[1], [2], [3]], ids=str)
def test_a_chain_held_at_both_ends(forced):
    case = chains.duffing(3, forced, seed=1, extra=wall)
    model = NRFRegressor(degree=3, chain=Chain(3, ground="both")).fit(case.X, case.F)
    assert_exact(model, case)
    tie = model.restoring_forces_[4].coefficients[["v", "s"]].tolist()
    assert tie == pytest.approx([60.0, 5e4], rel=EXACT)


# -- the paper's damper --------------------------------------------------------


@pytest.mark.parametrize(("strategy", "error"), [("complete", 1e-6), ("auto", 1e-4)])
def test_hysteresis_in_storey_1_leaves_storey_2_exact(dahl, strategy, error):
    case, *_ = dahl
    with pytest.warns(BiasWarning):
        model = NRFRegressor(degree=3, strategy=strategy).fit(case.X, case.F)
    R2 = case.storey_forces[:, 1]
    gap = np.abs(model.restoring_force(case.X)[:, 1] - R2)
    assert gap.max() < error * np.sqrt(np.mean(R2**2))
    assert model.masses_[0] < 9.95
    assert model.third_law_gap_["storey 2"] > 0.1


def test_the_true_law_in_storey_1_gives_the_masses(dahl):
    case, _, R1 = dahl
    declared = {"storey 1": [laws.PowerSeries(1), laws.Dahl(sigma=5e4)]}
    model = NRFRegressor(degree=1, laws=declared, dt=case.dt).fit(case.X, case.F)
    assert worst(model.masses_, case.m) < 1e-6
    coefficients = model.restoring_forces_[1].coefficients.to_dict()
    assert coefficients == pytest.approx(
        {"v": 499.0, "s": 100050.0, "Z": 34.85}, rel=1e-5
    )
    gap = np.abs(model.restoring_force(case.X)[:, 0] - R1)
    assert gap.max() < 1e-4 * np.abs(R1).max()


def test_the_modified_dahl_law_with_its_constant_force():
    case, *_ = chains.paper_case(duration=2.0, f0=5.0)
    declared = {"storey 1": [laws.ModifiedDahl(sigma=5e4)]}
    model = NRFRegressor(degree=1, laws=declared, dt=case.dt).fit(case.X, case.F)
    assert worst(model.masses_, case.m) < 1e-5
    constant = model.restoring_forces_[1].coefficients["1"]
    assert constant == pytest.approx(5.0, rel=1e-3)


@pytest.mark.parametrize("degree", [1, 3], ids=["linear", "cubic"])
def test_the_shape_of_the_loop_is_estimated(dahl, degree):
    case, *_ = dahl
    declared = {"storey 1": [laws.PowerSeries(degree), laws.Dahl()]}
    model = NRFRegressor(degree=1, laws=declared, dt=case.dt)
    with warnings.catch_warnings(action="error"):
        model.fit(case.X, case.F)
    law = model.model_.laws["storey 1"][1]
    assert law.shape["sigma"] == pytest.approx(5e4, rel=1e-3)
    assert law.coefficients[0] == pytest.approx(34.85, rel=1e-4)
    assert worst(model.masses_, case.m) < 1e-4


# -- rank ----------------------------------------------------------------------


def harmonic(noise=0.0):
    """One storey of 10 kg in steady harmonic motion, noise on motions."""
    t = np.arange(4000) * 1e-3
    w = 2 * np.pi * 5
    s, v = 1e-3 * np.sin(w * t), 1e-3 * w * np.cos(w * t)
    X = np.column_stack([-w * w * s, v, s])
    F = X @ [10.0, 50.0, 1e5]
    rng = np.random.default_rng(0)
    return X + noise * X.std(axis=0) * rng.standard_normal(X.shape), F


@pytest.mark.parametrize("degree", [1, 3])
def test_a_steady_harmonic_force_cannot_separate_mass_from_stiffness(degree):
    with pytest.raises(IdentifiabilityError, match="m1 cannot be separated from"):
        NRFRegressor(degree=degree).fit(*harmonic())


@pytest.mark.parametrize("noise", [1e-6, 1e-3, 0.02, 0.1])
@pytest.mark.parametrize("degree", [1, 3])
def test_noise_that_hides_the_rank_loss_is_warned_of(degree, noise):
    """Noise makes the columns independent and the mass meaningless."""
    with pytest.warns(BiasWarning, match="m1 = .* kg is likely biased"):
        model = NRFRegressor(degree=degree).fit(*harmonic(noise))
    assert abs(model.masses_[0] / 10 - 1) > 0.5


def test_with_the_mass_known_dependent_terms_are_named_and_the_force_is_right():
    X, F = harmonic()
    with pytest.warns(RankWarning, match="v\\^3.*linearly dependent"):
        model = NRFRegressor(degree=3, known_masses={1: 10.0}).fit(X, F)
    forces = np.ravel(model.predict(X))
    assert np.allclose(forces, F, atol=1e-6 * np.abs(F).max())


def test_broad_excitation_raises_no_alarm(chain4):
    with warnings.catch_warnings(action="error"):
        NRFRegressor(degree=3).fit(chain4.noisy(0.005), chain4.F)
