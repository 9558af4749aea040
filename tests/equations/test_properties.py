"""What must hold for every chain, excitation and set of laws: units, order, symmetry,
Newton's laws, energy.
"""

import numpy as np
import pandas as pd
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from pysindy_nrf import Chain, ChainModel, NRFRegressor, laws
from pysindy_nrf.laws.contract import random_values
from pysindy_nrf.simulation import free_run

pytestmark = pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.NRFWarning")

DT = 1e-3
N = 500


class Measured:
    """A measured test: motions are sums of sines, accelerations follow from the
    balances, noise on top.
    """

    def __init__(self, a, v, s, F, masses, settings) -> None:
        self.a, self.v, self.s, self.F, self.masses, self.settings = (
            a,
            v,
            s,
            F,
            masses,
            settings,
        )

    def __repr__(self) -> str:
        forced = [j + 1 for j in range(self.n) if self.F[:, j].any()]
        return f"Measured({self.n} DOFs, forced {forced}, {self.settings})"

    @property
    def X(self) -> np.ndarray:
        return np.hstack([self.a, self.v, self.s])

    @property
    def n(self) -> int:
        return self.a.shape[1]

    def fit(self, X=None, F=None, settings=None, **options) -> NRFRegressor:
        model = NRFRegressor(**(self.settings if settings is None else settings))
        return model.fit(
            self.X if X is None else X, self.F if F is None else F, **options
        )


def motion(
    n: int, rng: np.random.Generator, n_samples: int = N
) -> tuple[np.ndarray, np.ndarray]:
    """Drifts of some millimetres and their exact rates."""
    t = np.arange(n_samples)[:, None, None] * DT
    f = rng.uniform(2.0, 60.0, (n, 12))
    size, phase = (
        rng.uniform(0.2, 1.0, (n, 12)) * 1e-3,
        rng.uniform(0, 2 * np.pi, (n, 12)),
    )
    w = 2 * np.pi * f
    return (size * w * np.cos(w * t + phase)).sum(axis=2), (
        size * np.sin(w * t + phase)
    ).sum(axis=2)


EXTRA = {
    "none": lambda: [],
    "coulomb": lambda: [laws.CoulombFriction()],
    "dahl": lambda: [laws.Dahl(sigma=2e3)],
    "quadratic damping": lambda: [laws.QuadraticDamping()],
}


@st.composite
def measured_tests(
    draw,
    excitations=("complete", "incomplete", "base"),
    extras=tuple(EXTRA),
    noise=(0.0, 0.02),
):
    """A test with 1 to 5 DOFs, a degree and a further law on storey 1."""
    n = draw(st.integers(1, 5))
    rng = np.random.default_rng(draw(st.integers(0, 2**31)))
    kind, extra = draw(st.sampled_from(excitations)), draw(st.sampled_from(extras))
    level, degree = draw(st.sampled_from(noise)), draw(st.integers(1, 3))
    v, s = motion(n, rng)
    m, k = rng.uniform(5, 50, n), rng.uniform(2e4, 2e5, n)
    held = {
        i: [laws.PowerSeries(degree), *(EXTRA[extra]() if i == 1 else [])]
        for i in range(1, n + 1)
    }

    def drawn(i, law):
        size = [k[i - 1] * 2e-3 / _size(term.label) for term in law.terms()]
        return law.with_values(coefficients=rng.uniform(0.2, 1.0, len(size)) * size)

    truth = ChainModel(
        m, {i: [drawn(i, law) for law in group] for i, group in held.items()}
    )
    R = truth.restoring_force(np.hstack([0 * v, v, s]), dt=DT)
    total = R - np.hstack([R[:, 1:], np.zeros((N, 1))])
    F = np.zeros((N, n))
    forced = {"complete": range(n), "incomplete": [int(rng.integers(n))], "base": []}[
        kind
    ]
    for j in forced:
        F[:, j] = rng.standard_normal(N) * 300.0
    a = (F - total) / m
    a += level * a.std(axis=0) * rng.standard_normal(a.shape)
    options = {
        "degree": degree,
        "dt": DT,
        "laws": {1: held[1]} if extra != "none" else None,
    }
    if kind == "base":
        options["known_masses"] = {j + 1: float(m[j]) for j in range(n)}
    return Measured(a, v, s, F, m, options)


def _size(label: str, v: float = 0.4, s: float = 2e-3) -> float:
    """Size of a term at a rate and a drift."""
    size = 1.0
    for factor in label.split():
        base, _, power = factor.partition("^")
        size *= {"v": v, "|v|": v, "s": s}.get(base, 1.0) ** float(power or 1)
    return size


def numbers(model: NRFRegressor) -> np.ndarray:
    """Masses, and each coefficient as the rms of its term: what a difference in it
    would matter.
    """
    return np.concatenate(
        [
            model.masses_,
            *(f.coefficients.to_numpy() for f in model.restoring_forces_.values()),
        ]
    )


def same(
    one: NRFRegressor, other: NRFRegressor, factors=1.0, tolerance: float = 1e-9
) -> None:
    """Equal to a tolerance that grows with the condition of the data."""
    found, expected = numbers(one), numbers(other) * factors
    slack = tolerance * max(1.0, float(other.condition_.max()) / 100)
    for name, force in other.restoring_forces_.items():
        assert list(one.restoring_forces_[name].coefficients.index) == list(
            force.coefficients.index
        )
    weight = np.abs(expected) + 1e-3 * np.abs(_scale(other)) * np.abs(factors)
    assert np.all(np.abs(found - expected) <= slack * weight), np.max(
        np.abs(found - expected) / weight
    )


def _scale(model: NRFRegressor) -> np.ndarray:
    """The coefficient with which a term alone would be the size of its storey's
    stiffness force.
    """
    out = [model.masses_]
    for force in model.restoring_forces_.values():
        k = abs(force.coefficients.get("s", 1e5)) * 2e-3
        out.append(np.array([k / _size(label) for label in force.coefficients.index]))
    return np.concatenate(out)


# -- units ---------------------------------------------------------------------


def rescaled(
    test: Measured, L: float, M: float, T: float
) -> tuple[Measured, np.ndarray]:
    """The same test in other units of length, mass and time, and the factors of its
    results.
    """
    options = dict(test.settings)
    force = M * L / T**2
    if options["laws"]:
        options["laws"] = {
            1: [
                law.with_values(shape={"sigma": 2e3 / L}) if law.name == "dahl" else law
                for law in options["laws"][1]
            ]
        }
    if "known_masses" in options:
        options["known_masses"] = {j: M * m for j, m in options["known_masses"].items()}
    options["dt"] = DT * T
    other = Measured(
        test.a * L / T**2,
        test.v * L / T,
        test.s * L,
        test.F * force,
        test.masses * M,
        options,
    )
    factors = [np.full(test.n, M)]
    for i in range(1, test.n + 1):
        held = (options["laws"] or {}).get(i, [laws.PowerSeries(options["degree"])])
        for law in held:
            factors.append(
                np.array([force / _size(term.label, L / T, L) for term in law.terms()])
            )
    return other, np.concatenate(factors)


@given(measured_tests(), *(st.sampled_from([-6, -3, -1, 1, 3, 6]) for _ in range(3)))
def test_powers_of_two_as_units_change_nothing_but_units(test, l2, m2, t2):
    other, factors = rescaled(test, 2.0**l2, 2.0**m2, 2.0**t2)
    same(other.fit(), test.fit(), factors, 1e-12)


# -- order and boundaries ------------------------------------------------------


@given(
    measured_tests(extras=("none", "coulomb", "quadratic damping")),
    st.integers(0, 2**31),
)
def test_the_order_of_samples_does_not_matter_without_memory(test, seed):
    order = np.random.default_rng(seed).permutation(N)
    same(
        test.fit(test.X[order], test.F[order], {**test.settings, "dt": None}),
        test.fit(),
    )


@given(
    measured_tests(),
    st.lists(st.integers(40, N - 40), min_size=1, max_size=3, unique=True),
    st.randoms(),
)
def test_the_order_of_records_does_not_matter(test, cuts, random):
    edges = [0, *sorted(cuts), N]
    assume(min(np.diff(edges)) > 4)
    parts = [np.arange(a, b) for a, b in zip(edges[:-1], edges[1:])]
    ids = np.repeat([f"run {i}" for i in range(len(parts))], [len(p) for p in parts])
    order = np.concatenate(random.sample(parts, len(parts)))
    same(
        test.fit(test.X[order], test.F[order], record=ids[order]), test.fit(record=ids)
    )


@given(
    measured_tests(extras=("none", "coulomb", "quadratic damping")),
    st.lists(st.integers(1, N - 1), max_size=6, unique=True),
)
def test_without_memory_records_are_only_samples(test, cuts):
    """Chunking: the same samples as one record or as many."""
    ids = np.searchsorted(sorted(cuts), np.arange(N), side="right")
    same(test.fit(record=ids), test.fit())


@given(measured_tests(extras=("dahl", "none")), st.integers(150, N - 150))
def test_records_that_are_pooled_keep_their_boundary(test, cut):
    """Predictions of two pooled records are those of each alone: no state runs over
    from one to the next.
    """
    ids = np.arange(N) >= cut
    model = test.fit(record=ids)
    both = model.predict(test.X, record=ids)
    apart = [model.predict(test.X[rows]) for rows in (~ids, ids)]
    np.testing.assert_allclose(
        both, np.vstack(apart), rtol=1e-12, atol=1e-9 * np.abs(both).max()
    )


# -- symmetry ------------------------------------------------------------------


@given(measured_tests())
def test_a_mirrored_test_gives_the_mirrored_laws(test):
    """x -> -x, F -> -F: odd terms stay, even ones change their sign."""
    signs = [np.ones(test.n)]
    for i in range(1, test.n + 1):
        for law in (test.settings["laws"] or {}).get(
            i, [laws.PowerSeries(test.settings["degree"])]
        ):
            odd = law.name != "power_series"
            signs.append(
                np.array(
                    [1.0 if odd or _degree(t.label) % 2 else -1.0 for t in law.terms()]
                )
            )
    same(test.fit(-test.X, -test.F), test.fit(), np.concatenate(signs), 1e-12)


def _degree(label: str) -> int:
    return sum(int(factor.partition("^")[2] or 1) for factor in label.split())


@given(measured_tests(), st.floats(-3, 3), st.floats(-1, 1), st.integers(0, 2**31))
def test_a_rigid_motion_of_base_and_floors_changes_no_drift(test, speed, offset, seed):
    """Absolute coordinates on a base that moves in any way, its motion given: the
    relative result.
    """
    rng = np.random.default_rng(seed)
    vb, xb = motion(1, rng)
    vb, xb = vb[:, 0] + speed, xb[:, 0] + offset + speed * np.arange(N) * DT
    X = pd.DataFrame(
        np.column_stack(
            [
                test.a,
                test.v.cumsum(axis=1) + vb[:, None],
                test.s.cumsum(axis=1) + xb[:, None],
                vb,
                xb,
            ]
        ),
        columns=[
            *(f"{q}{j}" for q in ("a", "xdot", "x") for j in range(1, test.n + 1)),
            "xdot0",
            "x0",
        ],
    )
    found = test.fit(X, test.F, {**test.settings, "coordinates": "absolute"})
    same(found, test.fit(), tolerance=1e-8 * (1 + abs(speed) + abs(offset)) * 1e2)


# -- Newton and energy ---------------------------------------------------------


@st.composite
def models(draw):
    """A chain with further links and a random choice of laws with random values."""
    n = draw(st.integers(2, 5))
    rng = np.random.default_rng(draw(st.integers(0, 2**31)))
    pairs = [(p, q) for p in range(3, n + 1) for q in range(1, p - 1)]
    chosen = (
        draw(st.lists(st.sampled_from(pairs), unique=True, max_size=2)) if pairs else []
    )
    ground = draw(st.sampled_from(["base", "free"]))
    chain = Chain(n, [f"link {p}-{q}" for p, q in chosen], ground)
    pool = [
        laws.PowerSeries(2),
        laws.Dahl(),
        laws.CoulombFriction(),
        laws.BoucWen(),
        laws.Duffing(),
        laws.QuadraticDamping(),
    ]
    held = {}
    for site in chain.sites:
        some = draw(
            st.lists(
                st.sampled_from(range(len(pool))), min_size=1, max_size=2, unique=True
            )
        )
        held[site] = [random_values(pool[i], rng) for i in some]
    return ChainModel(rng.uniform(1, 50, n), held, chain), rng


@given(models())
def test_inner_forces_cancel(given_model):
    """Newton's third law: forces minus inertias add up to what the ground carries,
    whatever the laws and links.
    """
    model, rng = given_model
    v, s = motion(model.n_dof, rng)
    a = rng.standard_normal(v.shape)
    X = np.hstack([a, v, s])
    left = (model.predict(X, dt=DT) - a * model.masses).sum(axis=1)
    forces = model.restoring_force(X, dt=DT)
    ground = forces[:, 0] if "storey 1" in model.chain.sites else np.zeros(N)
    every = sum(np.abs(f).max() for f in model.site_forces(model.segments(X, dt=DT)))
    np.testing.assert_allclose(left, ground, atol=1e-10 * every)


@given(models())
def test_json_keeps_every_bit(given_model):
    model, rng = given_model
    again = ChainModel.from_json(model.to_json())
    v, s = motion(model.n_dof, rng)
    X = np.hstack([rng.standard_normal(v.shape), v, s])
    assert again == model
    np.testing.assert_array_equal(again.predict(X, dt=DT), model.predict(X, dt=DT))


@given(
    st.integers(1, 4),
    st.sampled_from(
        [
            [],
            ["coulomb_friction"],
            ["quadratic_damping"],
            ["dahl"],
            ["jenkins"],
            ["coulomb_friction", "quadratic_damping"],
        ]
    ),
    st.integers(0, 2**31),
)
@settings(max_examples=15)
def test_passive_laws_never_create_energy(n, names, seed):
    """Released with a speed and left alone: kinetic energy never exceeds what was put
    in, and the books balance.
    """
    rng = np.random.default_rng(seed)
    held = {}
    for i in range(1, n + 1):
        group = [
            laws.LinearElastic(rng.uniform(2e4, 2e5)),
            laws.LinearViscous(rng.uniform(0, 200)),
        ]
        for name in names:
            cls = laws.registry()[name]
            assert cls.passive
            law = random_values(cls(), rng)
            group.append(law.with_values(coefficients=np.abs(law.coefficients)))
        held[i] = group
    model = ChainModel(rng.uniform(5, 50, n), held)
    run = free_run(model, np.zeros((300, n)), DT, v0=rng.uniform(-1, 1, n))
    kinetic = run.energy["kinetic"].to_numpy()
    assert kinetic.max() <= kinetic[0] * (1 + 1e-6) and run.energy_gap < 1e-6
    assert (
        run.energy.iloc[-1, 2:] > -1e-6 * kinetic[0]
    ).all()  # no site has given more than it took


# -- records -------------------------------------------------------------------


@given(
    measured_tests(extras=("none",), noise=(0.0,)),
    st.integers(0, 30),
    st.integers(0, 30),
)
def test_rows_lost_at_the_edges_cost_rows_and_nothing_else(test, first, last):
    X = test.X
    X[:first], X[N - last :] = np.nan, np.nan
    inside = slice(first, N - last)
    settings = {**test.settings, "dt": None}
    found = test.fit(X)
    same(found, test.fit(test.X[inside], test.F[inside], settings))
    assert found.n_samples_ == N - first - last
