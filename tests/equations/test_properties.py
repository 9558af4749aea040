"""What holds for every chain and excitation: units, order, symmetry, Newton, energy."""

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from pysindy_nrf import Chain, ChainModel, NRFRegressor, laws
from pysindy_nrf.simulation import free_run

pytestmark = pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.NRFWarning")

DT = 1e-3
N = 500
# rate (m/s) and drift (m) at which the size of a term is judged
RATE = 0.4
DRIFT = 2e-3


@dataclass(frozen=True)
class Measured:
    """A test: motions are sums of sines, accelerations follow from the equations."""

    a: np.ndarray
    v: np.ndarray
    s: np.ndarray
    F: np.ndarray
    degree: int
    law: laws.ForceLaw | None = None  # beside the power series of storey 1
    known_masses: dict | None = None
    dt: float | None = DT

    @property
    def n(self):
        return self.a.shape[1]

    @property
    def X(self):
        return np.hstack([self.a, self.v, self.s])

    def laws_of(self, storey):
        series = laws.PowerSeries(self.degree)
        if storey == 1 and self.law is not None:
            return [series, self.law]
        return [series]

    def regressor(self, **settings):
        return NRFRegressor(
            degree=self.degree,
            laws=None if self.law is None else {1: self.laws_of(1)},
            known_masses=self.known_masses,
            dt=self.dt,
            **settings,
        )

    def fit(self, **metadata):
        return self.regressor().fit(self.X, self.F, **metadata)

    def rows(self, rows):
        """The samples of some rows, without a clock."""
        channels = {name: getattr(self, name)[rows] for name in "avsF"}
        return replace(self, dt=None, **channels)


def motion(n, rng):
    """Rates of drifts of some millimetres, and the drifts."""
    t = np.arange(N)[:, None, None] * DT
    omega = 2 * np.pi * rng.uniform(2.0, 60.0, (n, 12))
    size = rng.uniform(0.2, 1.0, (n, 12)) * 1e-3
    phase = rng.uniform(0, 2 * np.pi, (n, 12))
    v = (size * omega * np.cos(omega * t + phase)).sum(axis=2)
    s = (size * np.sin(omega * t + phase)).sum(axis=2)
    return v, s


def exponents(label):
    """Powers of v and s in a label; those of other factors are left out."""
    powers = {"v": 0, "s": 0}
    for factor in label.split():
        base, _, power = factor.partition("^")
        base = base.strip("|")
        if base in powers:
            powers[base] += int(power or 1)
    return powers["v"], powers["s"]


def size_of(label, rate=RATE, drift=DRIFT):
    """Size of a term at a rate and a drift."""
    h, j = exponents(label)
    return rate**h * drift**j


FORCED = ("all", "one", "base")
EXTRA = {
    "none": None,
    "coulomb": laws.CoulombFriction(),
    "dahl": laws.Dahl(sigma=2e3),
    "quadratic damping": laws.QuadraticDamping(),
}
MEMORYLESS = ("none", "coulomb", "quadratic damping")


@st.composite
def measured_tests(draw, extras=tuple(EXTRA), noise=(0.0, 0.02)):
    """A test with 1 to 5 DOFs, a degree and a further law on storey 1."""
    n = draw(st.integers(1, 5))
    rng = np.random.default_rng(draw(st.integers(0, 2**31)))
    forced = draw(st.sampled_from(FORCED))
    law = EXTRA[draw(st.sampled_from(extras))]
    degree = draw(st.integers(1, 3))
    v, s = motion(n, rng)
    m, k = rng.uniform(5, 50, n), rng.uniform(2e4, 2e5, n)
    F = np.zeros((N, n))
    if forced == "all":
        F = rng.standard_normal((N, n)) * 300.0
    if forced == "one":
        F[:, rng.integers(n)] = rng.standard_normal(N) * 300.0
    known = None
    if forced == "base":
        known = dict(enumerate(m.tolist(), 1))
    test = Measured(0 * v, v, s, F, degree, law, known)

    by_storey = {}
    for i in range(1, n + 1):
        by_storey[i] = []
        for declared in test.laws_of(i):
            sizes = np.array([size_of(term.label) for term in declared.terms()])
            values = rng.uniform(0.2, 1.0, len(sizes)) * k[i - 1] * DRIFT / sizes
            by_storey[i].append(declared.with_values(coefficients=values))
    R = ChainModel(m, by_storey).restoring_force(test.X, dt=DT)
    a = (F - R + np.hstack([R[:, 1:], np.zeros((N, 1))])) / m
    level = draw(st.sampled_from(noise))
    a += level * a.std(axis=0) * rng.standard_normal(a.shape)
    return replace(test, a=a)


def numbers(model):
    """Masses, then all coefficients."""
    values = [model.masses_]
    for force in model.restoring_forces_.values():
        values.append(force.coefficients.to_numpy())
    return np.concatenate(values)


def scales(model):
    """Masses, and coefficients with which a term is as large as its storey's spring."""
    values = [model.masses_]
    for force in model.restoring_forces_.values():
        spring = abs(force.coefficients.get("s", 1e5)) * DRIFT
        sizes = np.array([size_of(label) for label in force.coefficients.index])
        values.append(spring / sizes)
    return np.abs(np.concatenate(values))


def assert_same(model, other, factors=1.0, tolerance=1e-9):
    """Equal to a tolerance that grows with the condition of the data."""
    for name, force in other.restoring_forces_.items():
        terms = model.restoring_forces_[name].coefficients.index
        assert list(terms) == list(force.coefficients.index)
    expected = numbers(other) * factors
    weight = np.abs(expected) + 1e-3 * scales(other) * np.abs(factors)
    slack = tolerance * max(1.0, float(other.condition_.max()) / 100)
    assert (np.abs(numbers(model) - expected) / weight).max() <= slack


# -- units ---------------------------------------------------------------------


def in_units(test, L, M, T):
    """The same test in other units of length, mass and time."""
    law = test.law
    if isinstance(law, laws.Dahl):
        law = law.with_values(shape={"sigma": 2e3 / L})
    known = test.known_masses
    if known is not None:
        known = {dof: M * mass for dof, mass in known.items()}
    return Measured(
        test.a * L / T**2,
        test.v * L / T,
        test.s * L,
        test.F * M * L / T**2,
        test.degree,
        law,
        known,
        DT * T,
    )


def factors_of_units(test, L, M, T):
    """Factors of masses and coefficients in other units."""
    factors = [np.full(test.n, M)]
    force = M * L / T**2
    for i in range(1, test.n + 1):
        for law in test.laws_of(i):
            sizes = [size_of(term.label, L / T, L) for term in law.terms()]
            factors.append(force / np.array(sizes))
    return np.concatenate(factors)


POWERS_OF_TWO = st.sampled_from([2.0**k for k in (-6, -3, -1, 1, 3, 6)])


@given(measured_tests(), POWERS_OF_TWO, POWERS_OF_TWO, POWERS_OF_TWO)
def test_powers_of_two_as_units_change_nothing_but_units(test, L, M, T):
    fitted = in_units(test, L, M, T).fit()
    assert_same(fitted, test.fit(), factors_of_units(test, L, M, T), 1e-12)


# -- order and boundaries ------------------------------------------------------


@given(measured_tests(MEMORYLESS), st.integers(0, 2**31))
def test_the_order_of_samples_does_not_matter_without_memory(test, seed):
    order = np.random.default_rng(seed).permutation(N)
    assert_same(test.rows(order).fit(), test.fit())


@given(
    measured_tests(),
    st.lists(st.integers(40, N - 40), min_size=1, max_size=3, unique=True),
    st.randoms(),
)
def test_the_order_of_records_does_not_matter(test, cuts, random):
    edges = [0, *sorted(cuts), N]
    assume(min(np.diff(edges)) > 4)
    records = np.split(np.arange(N), edges[1:-1])
    ids = np.repeat(np.arange(len(records)), np.diff(edges))
    order = np.concatenate(random.sample(records, len(records)))
    shuffled = test.regressor().fit(test.X[order], test.F[order], record=ids[order])
    assert_same(shuffled, test.fit(record=ids))


@given(
    measured_tests(MEMORYLESS),
    st.lists(st.integers(1, N - 1), max_size=6, unique=True),
)
def test_without_memory_records_are_only_samples(test, cuts):
    ids = np.searchsorted(sorted(cuts), np.arange(N), side="right")
    assert_same(test.fit(record=ids), test.fit())


@given(measured_tests(("dahl", "none")), st.integers(150, N - 150))
def test_no_state_runs_over_from_one_record_to_the_next(test, cut):
    ids = np.arange(N) >= cut
    model = test.fit(record=ids)
    both = model.predict(test.X, record=ids)
    apart = np.vstack([model.predict(test.X[~ids]), model.predict(test.X[ids])])
    np.testing.assert_allclose(both, apart, rtol=1e-12, atol=1e-9 * np.abs(both).max())


# -- symmetry ------------------------------------------------------------------


@given(measured_tests())
def test_a_mirrored_test_gives_the_mirrored_laws(test):
    """x -> -x, F -> -F: odd terms stay, even ones change their sign."""
    signs = [np.ones(test.n)]
    for i in range(1, test.n + 1):
        for law in test.laws_of(i):
            degrees = np.array([sum(exponents(t.label)) for t in law.terms()])
            is_series = isinstance(law, laws.PowerSeries)
            signs.append(np.where(is_series & (degrees % 2 == 0), -1.0, 1.0))
    mirrored = replace(test, a=-test.a, v=-test.v, s=-test.s, F=-test.F)
    assert_same(mirrored.fit(), test.fit(), np.concatenate(signs), 1e-12)


@given(measured_tests(), st.floats(-3, 3), st.floats(-1, 1), st.integers(0, 2**31))
def test_a_rigid_motion_of_base_and_floors_changes_no_drift(test, speed, offset, seed):
    """Absolute coordinates on a base that moves in any way, its motion given."""
    v0, x0 = motion(1, np.random.default_rng(seed))
    v0 = v0 + speed
    x0 = x0 + offset + speed * np.arange(N)[:, None] * DT
    xdot, x = test.v.cumsum(axis=1) + v0, test.s.cumsum(axis=1) + x0
    names = []
    for kind in ("a", "xdot", "x"):
        names.extend(f"{kind}{j}" for j in range(1, test.n + 1))
    table = np.hstack([test.a, xdot, x, v0, x0])
    X = pd.DataFrame(table, columns=[*names, "xdot0", "x0"])
    fitted = test.regressor(coordinates="absolute").fit(X, test.F)
    tolerance = 1e-6 * (1 + abs(speed) + abs(offset))
    assert_same(fitted, test.fit(), tolerance=tolerance)


# -- Newton and energy ---------------------------------------------------------

POOL = [
    laws.PowerSeries(2),
    laws.Dahl(),
    laws.CoulombFriction(),
    laws.BoucWen(),
    laws.Duffing(),
    laws.QuadraticDamping(),
]


@st.composite
def models(draw):
    """A chain with further links and a choice of laws with random values."""
    n = draw(st.integers(2, 5))
    rng = np.random.default_rng(draw(st.integers(0, 2**31)))
    pairs = [f"link {p}-{q}" for p in range(3, n + 1) for q in range(1, p - 1)]
    links = []
    if pairs:
        links = draw(st.lists(st.sampled_from(pairs), unique=True, max_size=2))
    chain = Chain(n, links, draw(st.sampled_from(["base", "free"])))
    by_site = {}
    for site in chain.sites:
        chosen = rng.choice(len(POOL), rng.integers(1, 3), replace=False)
        by_site[site] = [laws.random_values(POOL[k], rng) for k in chosen]
    return ChainModel(rng.uniform(1, 50, n), by_site, chain)


SEEDS = st.integers(0, 2**31)


def random_features(model, seed):
    rng = np.random.default_rng(seed)
    v, s = motion(model.n_dof, rng)
    return np.hstack([rng.standard_normal(v.shape), v, s])


@given(models(), SEEDS)
def test_inner_forces_cancel(model, seed):
    """Forces minus inertias add up to what the ground carries."""
    X = random_features(model, seed)
    inertia = X[:, : model.n_dof] * model.masses
    total = (model.predict(X, dt=DT) - inertia).sum(axis=1)
    ground = model.restoring_force(X, dt=DT)[:, 0]
    forces = model.site_forces(model.segments(X, dt=DT))[0]
    np.testing.assert_allclose(total, ground, atol=1e-10 * np.abs(forces).sum())


@given(models(), SEEDS)
def test_json_keeps_every_bit(model, seed):
    again = ChainModel.from_json(model.to_json())
    X = random_features(model, seed)
    assert again == model
    np.testing.assert_array_equal(again.predict(X, dt=DT), model.predict(X, dt=DT))


PASSIVE = [
    [],
    [laws.CoulombFriction],
    [laws.QuadraticDamping],
    [laws.Dahl],
    [laws.Jenkins],
    [laws.CoulombFriction, laws.QuadraticDamping],
]


@given(st.integers(1, 4), st.sampled_from(PASSIVE), SEEDS)
@settings(max_examples=15)
def test_passive_laws_never_create_energy(n, kinds, seed):
    """Released with a speed, kinetic energy never exceeds what was put in."""
    rng = np.random.default_rng(seed)
    by_storey = {}
    for i in range(1, n + 1):
        k, c = rng.uniform(2e4, 2e5), rng.uniform(0, 200)
        by_storey[i] = [laws.LinearElastic(k), laws.LinearViscous(c)]
        for kind in kinds:
            assert kind.passive
            law = laws.random_values(kind(), rng)
            positive = law.with_values(coefficients=np.abs(law.coefficients))
            by_storey[i].append(positive)
    model = ChainModel(rng.uniform(5, 50, n), by_storey)
    run = free_run(model, np.zeros((300, n)), DT, v0=rng.uniform(-1, 1, n))

    kinetic = run.energy["kinetic"].to_numpy()
    assert kinetic.max() <= kinetic[0] * (1 + 1e-6)
    assert run.energy_gap < 1e-6
    taken = run.energy.iloc[-1, 2:]
    assert (taken > -1e-6 * kinetic[0]).all()


# -- records -------------------------------------------------------------------


@given(measured_tests(("none",), noise=(0.0,)), st.integers(0, 30), st.integers(0, 30))
def test_rows_lost_at_the_edges_cost_rows_and_nothing_else(test, first, last):
    X = test.X
    X[:first] = np.nan
    X[N - last :] = np.nan
    fitted = replace(test, dt=None).regressor().fit(X, test.F)
    assert_same(fitted, test.rows(slice(first, N - last)).fit())
    assert fitted.n_samples_ == N - first - last
