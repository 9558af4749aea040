"""The contract that PySINDy's own tests ask of a feature library and of an optimizer,
asked of ours.
"""

import warnings

import chains
import numpy as np
import pysindy as ps
import pytest
from pysindy import AxesArray
from sklearn.base import clone

from pysindy_nrf import (
    Chain,
    ChainOptimizer,
    NRFRegressor,
    StateSpaceChainOptimizer,
    laws,
)
from pysindy_nrf.exceptions import BiasWarning, ChannelError, LawError
from pysindy_nrf.sindy.feature_library import (
    ForceLawLibrary,
    InterstoryPolynomialLibrary,
)

N = 3
X = np.random.default_rng(0).normal(size=(40, 3 * N))


def libraries():
    storey = [laws.LinearViscous(), laws.Duffing()]
    return {
        "polynomial": InterstoryPolynomialLibrary(2),
        "polynomial box, brace": InterstoryPolynomialLibrary(
            (1, 3), chain=Chain(N, ["link 3-1"]), orders={"link 3-1": 1}
        ),
        "polynomial, state": InterstoryPolynomialLibrary(2, inputs="state"),
        "laws": ForceLawLibrary(storey),
        "laws by site": ForceLawLibrary({1: storey, 3: laws.CoulombFriction()}),
        "laws, state": ForceLawLibrary(storey, inputs="state"),
        "laws with memory": ForceLawLibrary(
            {1: storey, 2: laws.Dahl(sigma=1.0)}, dt=1e-2
        ),
        "sum": (
            InterstoryPolynomialLibrary(2)
            + ForceLawLibrary({2: laws.CoulombFriction()})
        ),
    }


@pytest.fixture(params=libraries())
def library(request):
    return libraries()[request.param]


def test_fit_counts_what_transform_gives_as_an_axes_array(library):
    assert library.fit(X) is library and library.n_features_in_ == X.shape[1]
    out = library.transform(X)
    assert out.shape == (len(X), library.n_output_features_) and np.isfinite(out).all()
    assert (
        library.size == library.n_output_features_ == len(library.get_feature_names())
    )
    assert isinstance(out, AxesArray) and (out.ax_time, out.ax_coord) == (0, 1)


def test_feature_names_with_and_without_input_features(library):
    library.fit(X)
    names = library.get_feature_names()
    assert all(isinstance(name, str) for name in names) and len(set(names)) == len(
        names
    )
    assert (
        library.get_feature_names(input_features=[f"x{i}" for i in range(3 * N)])
        == names
    )  # PySINDy's placeholders
    given = [f"channel {i}" for i in range(3 * N)]
    renamed = library.get_feature_names(input_features=given)
    leading, trailing = (
        (given[:N], [])
        if library.inputs == "balance"
        else (given[N : 2 * N], given[2 * N :])
    )
    assert renamed[:N] == leading and renamed[len(names) - len(trailing) :] == trailing
    assert (
        renamed[N : len(names) - len(trailing)] == names[N : len(names) - len(trailing)]
    )  # terms belong to storeys
    with pytest.raises(ChannelError, match="2 names for 9 columns"):
        library.get_feature_names(["a", "b"])


def test_columns_are_what_their_names_say():
    """Each name, read as an expression of the inter-storey motion, gives its column."""
    for inputs in ("balance", "state"):
        library = InterstoryPolynomialLibrary(3, inputs=inputs).fit(X)
        a, v, s = np.hsplit(X, 3)
        if inputs == "state":
            v, s = np.diff(X[:, N : 2 * N], prepend=0.0), np.diff(X[:, :N], prepend=0.0)
        values = {
            f"{q}{i + 1}": y[:, i]
            for q, y in (("a", a), ("v", v), ("s", s))
            for i in range(N)
        }
        values |= {f"xdot{i + 1}": X[:, N + i] for i in range(N)} | {
            f"F{i + 1}": X[:, 2 * N + i] for i in range(N)
        }
        for name, column in zip(
            library.get_feature_names(), np.asarray(library.transform(X)).T, strict=True
        ):
            factors = [part.partition("^") for part in name.split(" ")]
            expected = np.prod(
                [values[base] ** int(power or 1) for base, _, power in factors], axis=0
            )
            assert np.allclose(column, expected, rtol=1e-12, atol=1e-14), (inputs, name)


def test_lists_of_trajectories(library):
    records = [X, X[:7], X[:1]]
    out = clone(library).fit(records).transform(records)
    assert isinstance(out, list) and [o.shape for o in out] == [
        (k, library.fit(X).n_output_features_) for k in (40, 7, 1)
    ]
    for one, record in zip(out, records):  # laws that remember start anew
        assert isinstance(one, AxesArray) and np.array_equal(
            one, library.transform(record)
        )


def test_pysindys_algebra_with_another_library(library):
    other = ps.PolynomialLibrary(1, include_bias=False)
    own, extra = (
        clone(library).fit_transform(X),
        np.asarray(clone(other).fit_transform(X)),
    )
    for both, parts in [
        (library + other, [own, extra]),
        (clone(other) + clone(library), [extra, own]),
    ]:
        assert isinstance(both, ps.ConcatLibrary)
        assert np.array_equal(both.fit(X).transform(X), np.hstack(parts))
        assert (
            both.n_output_features_
            == len(both.get_feature_names())
            == own.shape[1] + extra.shape[1]
        )
    product = clone(library) * clone(other)
    out = np.asarray(product.fit(X).transform(X))
    assert (
        isinstance(product, ps.TensoredLibrary)
        and len(product.get_feature_names()) == out.shape[1]
    )
    assert np.allclose(
        out, (np.asarray(own)[:, :, None] * extra[:, None, :]).reshape(len(X), -1)
    )


def test_the_sum_of_two_chain_libraries_is_one_of_the_chain():
    both = (
        InterstoryPolynomialLibrary(1)
        + ForceLawLibrary({2: laws.CoulombFriction()})
        + ForceLawLibrary({1: laws.CubicStiffness()})
    )
    names = both.fit(X).get_feature_names()
    assert names == [
        "a1",
        "a2",
        "a3",
        "v1",
        "s1",
        "s1^3",
        "v2",
        "s2",
        "sgn(v2)",
        "v3",
        "s3",
    ]


@pytest.mark.parametrize(
    ("add", "message"),
    [
        (
            lambda: InterstoryPolynomialLibrary(1) + InterstoryPolynomialLibrary(3),
            "storey 1: .* both hold the term 'v'",
        ),
        (
            lambda: (
                InterstoryPolynomialLibrary(1)
                + InterstoryPolynomialLibrary(2, inputs="state")
            ),
            "inputs='balance' and another",
        ),
        (
            lambda: (
                InterstoryPolynomialLibrary(1, Chain(3))
                + ForceLawLibrary({2: laws.CoulombFriction()}, Chain(2))
            ),
            "chain=.* and another",
        ),
    ],
)
def test_sums_that_make_no_sense_are_refused(add, message):
    with pytest.raises(LawError, match=message):
        add().fit(X)


INNER = {
    "least squares": None,
    "STLSQ": ps.STLSQ(threshold=0.003),
    "STLSQ, biased": ps.STLSQ(threshold=0.003, alpha=1e-6, unbias=False),
    "SR3": ps.SR3(reg_weight_lam=1e-5),
    "SSR": ps.SSR(kappa=1e-4),
    "FROLS": ps.FROLS(max_iter=8, kappa=1e-6),
    "library ensemble": ps.EnsembleOptimizer(
        ps.STLSQ(threshold=0.003), library_ensemble=True, n_models=6
    ),
}


def problem(kind, seed=6):
    """A three-storey Duffing chain: x, u and x_dot of ``ps.SINDy.fit``, and the
    library.
    """
    case = chains.duffing(N, [2], seed=seed, n_samples=900)
    if kind is ChainOptimizer:
        library = InterstoryPolynomialLibrary(3)
        return case, case.X, None, case.F, library
    x, rate = case.s.cumsum(axis=1), case.v.cumsum(axis=1)
    return (
        case,
        np.hstack([x, rate]),
        case.F,
        np.hstack([rate, case.a]),
        InterstoryPolynomialLibrary(3, inputs="state"),
    )


def features(kind):
    case, x, u, y, library = problem(kind)
    return case, library.fit_transform(x if u is None else np.hstack([x, u])), y


@pytest.fixture(
    params=[ChainOptimizer, StateSpaceChainOptimizer], ids=lambda kind: kind.__name__
)
def kind(request):
    np.random.seed(0)  # EnsembleOptimizer draws from NumPy's global state
    with warnings.catch_warnings(action="ignore", category=BiasWarning):
        yield request.param


@pytest.mark.parametrize("inner", INNER.values(), ids=INNER)
def test_fit_gives_what_pysindy_reads(kind, inner):
    case, theta, y = features(kind)
    optimizer = kind(inner)
    assert optimizer.fit(theta, y) is optimizer
    assert optimizer.coef_.shape == optimizer.ind_.shape == (y.shape[1], theta.shape[1])
    assert optimizer.ind_.dtype == bool and np.array_equal(
        optimizer.ind_, optimizer.coef_ != 0
    )
    assert optimizer.complexity == np.count_nonzero(optimizer.coef_)
    assert optimizer.intercept_ == 0 and optimizer.n_features_in_ == theta.shape[1]
    assert np.array_equal(
        optimizer.predict(theta), np.asarray(theta) @ optimizer.coef_.T
    )
    assert np.abs(optimizer.masses_ / case.m - 1).max() < 0.02
    assert (
        optimizer.score(theta, y) > 0.99
    )  # of ChainOptimizer, too, two of whose targets are zero throughout


def test_one_target_or_many():
    case = chains.duffing(1, [1], n_samples=500)
    theta = np.asarray(InterstoryPolynomialLibrary(3).fit_transform(case.X))
    flat, column = (
        ChainOptimizer().fit(theta, case.F[:, 0]),
        ChainOptimizer().fit(theta, case.F),
    )
    assert np.array_equal(flat.coef_, column.coef_) and flat.coef_.shape == (
        1,
        theta.shape[1],
    )
    assert flat.predict(theta).shape == (500,) and column.predict(theta).shape == (
        500,
        1,
    )


@pytest.mark.parametrize("inner", INNER.values(), ids=INNER)
def test_inside_sindy(kind, inner, capsys):
    case, x, u, y, library = problem(kind)
    model = ps.SINDy(optimizer=kind(inner, terms=library), feature_library=library).fit(
        x, t=case.dt, x_dot=y, u=u
    )
    assert model.coefficients().shape == (y.shape[1], len(model.get_feature_names()))
    assert model.complexity == model.optimizer.complexity
    assert len(model.equations(precision=3)) == y.shape[1]
    assert np.allclose(model.predict(x, u=u), y, atol=0.05 * np.abs(y).max())
    model.print(precision=2)
    said = capsys.readouterr().out.splitlines()
    assert len(said) == y.shape[1] and all("=" in line for line in said)
    largest = model.score(
        x, t=case.dt, x_dot=y, u=u, metric=lambda one, two, **_: np.abs(one - two).max()
    )
    assert largest == pytest.approx(np.abs(model.predict(x, u=u) - y).max())


def test_the_users_names_reach_the_equations(capsys):
    case, x, u, y, library = problem(StateSpaceChainOptimizer)
    names = ["x_low", "x_mid", "x_top", "v_low", "v_mid", "v_top", "P1", "shaker", "P3"]
    model = ps.SINDy(
        optimizer=StateSpaceChainOptimizer(terms=library), feature_library=library
    )
    model.fit(x, t=case.dt, x_dot=y, u=u, feature_names=names)
    assert (
        model.get_feature_names()[:3] == ["v_low", "v_mid", "v_top"]
        and model.get_feature_names()[-2] == "shaker"
    )
    model.print()
    said = capsys.readouterr().out.splitlines()
    assert said[1] == "(x_mid)' =  1.000 v_mid" and "shaker" in said[4]


def test_trajectories_of_different_length_inside_sindy(kind):
    case, x, u, y, library = problem(kind)
    cut = [slice(0, 500), slice(500, 900)]
    pieces = lambda z: None if z is None else [z[rows] for rows in cut]  # noqa: E731
    model = ps.SINDy(optimizer=kind(terms=library), feature_library=library)
    model.fit(
        pieces(x), t=pieces(np.arange(900) * case.dt), x_dot=pieces(y), u=pieces(u)
    )
    whole = ps.SINDy(optimizer=kind(terms=library), feature_library=clone(library)).fit(
        x, t=case.dt, x_dot=y, u=u
    )
    assert np.allclose(model.optimizer.masses_, whole.optimizer.masses_, rtol=1e-9)
    assert [p.shape for p in model.predict(pieces(x), u=pieces(u))] == [
        y[rows].shape for rows in cut
    ]


class NextSINDy(ps.SINDy):
    """What PySINDy's development version does at the seam: weights of the samples reach
    every ``optimizer.fit``.
    """

    def fit(self, x, t, x_dot, u=None, sample_weight=None):
        features = self.feature_library.fit_transform(
            x if u is None else np.hstack([x, u])
        )
        self.optimizer.fit(features, x_dot, sample_weight=sample_weight)
        return self


@pytest.mark.parametrize(
    "inner", [None, ps.STLSQ(threshold=0.02)], ids=["least squares", "STLSQ"]
)
def test_a_weight_of_two_is_the_row_twice(kind, inner):
    case, x, u, y, library = problem(kind)
    rng = np.random.default_rng(0)
    x = x + 0.01 * x.std(axis=0) * rng.standard_normal(
        x.shape
    )  # an inexact fit, so that weights tell
    weights = rng.integers(0, 3, len(x))
    twice = np.repeat(np.arange(len(x)), weights)
    weighted, repeated, plain = (
        NextSINDy(kind(inner), library)
        .fit(x[rows], case.dt, y[rows], None if u is None else u[rows], w)
        .optimizer.coef_
        for rows, w in ((slice(None), weights), (twice, None), (slice(None), None))
    )
    assert np.allclose(weighted, repeated, rtol=1e-9) and not np.allclose(
        weighted, plain, rtol=1e-6
    )
    if kind is ChainOptimizer:
        ours, again = (
            NRFRegressor(optimizer=inner).fit(x[i], y[i], w)
            for i, w in ((slice(None), weights), (twice, None))
        )
        assert np.allclose(
            ours.masses_, again.masses_, rtol=1e-9
        ) and ours.n_samples_ == len(twice)
        assert np.allclose(ours.errors_["error"], again.errors_["error"], rtol=1e-9)
        assert np.allclose(ours.masses_, np.diag(weighted), rtol=1e-9)
