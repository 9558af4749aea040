"""What PySINDy's own tests ask of a library and of an optimizer, asked of ours."""

import warnings
from dataclasses import dataclass, replace

import chains
import numpy as np
import pysindy as ps
import pytest
from pysindy import AxesArray
from sklearn.base import clone

from pysindy_nrf import (
    Chain,
    ChainOptimizer,
    ForceLawLibrary,
    InterstoryPolynomialLibrary,
    NRFRegressor,
    StateSpaceChainOptimizer,
    laws,
)
from pysindy_nrf.exceptions import BiasWarning, ChannelError, LawError

N = 3
X = np.random.default_rng(0).normal(size=(40, 3 * N))
STOREY = [laws.LinearViscous(), laws.Duffing()]
FRICTION = laws.CoulombFriction()
BRACED = Chain(N, ["link 3-1"])
LIBRARIES = {
    "polynomial": InterstoryPolynomialLibrary(2),
    "polynomial box, brace": InterstoryPolynomialLibrary(
        (1, 3), chain=BRACED, orders={"link 3-1": 1}
    ),
    "polynomial, state": InterstoryPolynomialLibrary(2, inputs="state"),
    "laws": ForceLawLibrary(STOREY),
    "laws by site": ForceLawLibrary({1: STOREY, 3: FRICTION}),
    "laws, state": ForceLawLibrary(STOREY, inputs="state"),
    "laws with memory": ForceLawLibrary({1: STOREY, 2: laws.Dahl(sigma=1.0)}, dt=0.01),
    "sum": InterstoryPolynomialLibrary(2) + ForceLawLibrary({2: FRICTION}),
}


@pytest.fixture(params=LIBRARIES)
def library(request):
    return clone(LIBRARIES[request.param])


# -- libraries -----------------------------------------------------------------


def test_fit_counts_what_transform_gives(library):
    assert library.fit(X) is library
    assert library.n_features_in_ == X.shape[1]
    out = library.transform(X)
    assert out.shape == (len(X), library.n_output_features_)
    assert np.isfinite(out).all()
    assert library.size == library.n_output_features_
    assert len(library.get_feature_names()) == library.n_output_features_


def test_features_are_an_axes_array(library):
    out = library.fit_transform(X)
    assert isinstance(out, AxesArray)
    assert (out.ax_time, out.ax_coord) == (0, 1)


def test_names_of_features_are_distinct_and_placeholders_are_no_names(library):
    names = library.fit(X).get_feature_names()
    assert len(set(names)) == len(names)
    placeholders = [f"x{i}" for i in range(3 * N)]
    assert library.get_feature_names(placeholders) == names


def test_the_users_names_replace_those_of_the_columns(library):
    names = library.fit(X).get_feature_names()
    users_names = [f"channel {i}" for i in range(3 * N)]
    renamed = library.get_feature_names(input_features=users_names)
    if library.inputs == "state":
        assert renamed == names[:-N] + users_names[2 * N :]
        return
    default_names = [f"{kind}{j}" for kind in "avs" for j in range(1, N + 1)]
    assert renamed[:N] == users_names[:N]
    for plain, name in zip(names, renamed, strict=True):
        if plain in default_names:
            assert name == users_names[default_names.index(plain)]


def test_a_library_for_each_storey_names_each_storey():
    parts = [InterstoryPolynomialLibrary(2), InterstoryPolynomialLibrary(1)]
    columns = [[0, 2, 4], [1, 3, 5]]
    library = ps.GeneralizedLibrary(parts, inputs_per_library=columns)
    library.fit(np.ones((5, 6)))
    channels = ["a1", "a2", "v1", "v2", "s1", "s2"]
    named = library.get_feature_names(channels)
    assert named == "a1,v1,s1,v1^2,v1 s1,s1^2,a2,v2,s2".split(",")
    assert library.get_feature_names()[-3:] == ["x1", "x3", "x5"]


def test_a_wrong_number_of_names_is_refused(library):
    with pytest.raises(ChannelError, match="2 names for 9 columns"):
        library.fit(X).get_feature_names(["a", "b"])


def named_channels(inputs):
    """Channels of the test data by the name that a feature gives them."""
    first, second, third = np.hsplit(X, 3)
    channels = {"a": first, "v": second, "s": third}
    if inputs == "state":
        v, s = np.diff(second, prepend=0.0), np.diff(first, prepend=0.0)
        channels = {"v": v, "s": s, "F": third}
    named = {}
    for kind, matrix in channels.items():
        for j in range(N):
            named[f"{kind}{j + 1}"] = matrix[:, j]
    return named


@pytest.mark.parametrize("inputs", ["balance", "state"])
def test_columns_are_what_their_names_say(inputs):
    """Each name, read as a product of powers of channels, gives its column."""
    library = InterstoryPolynomialLibrary(3, inputs=inputs).fit(X)
    channels = named_channels(inputs)
    columns = np.asarray(library.transform(X)).T
    for name, column in zip(library.get_feature_names(), columns, strict=True):
        expected = np.ones(len(X))
        for factor in name.split(" "):
            base, _, power = factor.partition("^")
            expected = expected * channels[base] ** int(power or 1)
        assert np.allclose(column, expected, rtol=1e-12, atol=1e-14), name


def test_laws_start_anew_in_every_trajectory(library):
    records = [X, X[:7], X[:1]]
    out = library.fit(records).transform(records)
    for features, record in zip(out, records, strict=True):
        assert isinstance(features, AxesArray)
        assert np.array_equal(features, library.transform(record))


def test_a_sum_with_another_library_is_pysindys(library):
    other = ps.PolynomialLibrary(1, include_bias=False)
    features = np.asarray(clone(library).fit_transform(X))
    extra = np.asarray(clone(other).fit_transform(X))
    ours_first, theirs_first = library + other, clone(other) + clone(library)
    assert isinstance(ours_first, ps.ConcatLibrary)
    assert isinstance(theirs_first, ps.ConcatLibrary)
    assert np.array_equal(ours_first.fit(X).transform(X), np.hstack([features, extra]))
    assert np.array_equal(
        theirs_first.fit(X).transform(X), np.hstack([extra, features])
    )
    n_features = features.shape[1] + extra.shape[1]
    assert ours_first.n_output_features_ == n_features
    assert len(ours_first.get_feature_names()) == n_features


def test_a_product_with_another_library_is_pysindys(library):
    other = ps.PolynomialLibrary(1, include_bias=False)
    features = np.asarray(clone(library).fit_transform(X))
    extra = np.asarray(clone(other).fit_transform(X))
    product = library * other
    assert isinstance(product, ps.TensoredLibrary)
    expected = (features[:, :, None] * extra[:, None, :]).reshape(len(X), -1)
    assert np.allclose(product.fit(X).transform(X), expected)
    assert len(product.get_feature_names()) == expected.shape[1]


def test_the_sum_of_two_chain_libraries_is_one_of_the_chain():
    both = InterstoryPolynomialLibrary(1) + ForceLawLibrary({2: FRICTION})
    all_three = both + ForceLawLibrary({1: laws.CubicStiffness()})
    names = "a1 a2 a3 v1 s1 s1^3 v2 s2 sgn(v2) v3 s3"
    assert all_three.fit(X).get_feature_names() == names.split()


LINEAR = InterstoryPolynomialLibrary(1)
SENSELESS_SUMS = [
    (LINEAR + InterstoryPolynomialLibrary(3), "both hold the term 'v'"),
    (LINEAR + InterstoryPolynomialLibrary(2, inputs="state"), "inputs='balance' and"),
    (
        InterstoryPolynomialLibrary(1, Chain(3)) + ForceLawLibrary({}, Chain(2)),
        "chain=.* and another",
    ),
]


@pytest.mark.parametrize(("library_sum", "message"), SENSELESS_SUMS)
def test_sums_that_make_no_sense_are_refused(library_sum, message):
    with pytest.raises(LawError, match=message):
        library_sum.fit(X)


# -- optimizers ----------------------------------------------------------------

STLSQ = ps.STLSQ(threshold=0.003)
INNER = {
    "least squares": None,
    "STLSQ": STLSQ,
    "STLSQ, biased": ps.STLSQ(threshold=0.003, alpha=1e-6, unbias=False),
    "SR3": ps.SR3(reg_weight_lam=1e-5),
    "SSR": ps.SSR(kappa=1e-4),
    "FROLS": ps.FROLS(max_iter=8, kappa=1e-6),
    "library ensemble": ps.EnsembleOptimizer(STLSQ, library_ensemble=True, n_models=6),
}
INNERS = pytest.mark.parametrize("inner", INNER.values(), ids=INNER)


@dataclass
class Task:
    """What ``ps.SINDy.fit`` gets of a chain of three Duffing storeys, DOF 2 forced."""

    kind: type
    library: ForceLawLibrary
    x: np.ndarray
    y: np.ndarray
    u: np.ndarray | None
    m: np.ndarray
    dt: float

    @classmethod
    def of(cls, kind):
        case = chains.duffing(N, [2], seed=6, n_samples=900)
        if kind is ChainOptimizer:
            library = InterstoryPolynomialLibrary(3)
            return cls(kind, library, case.X, case.F, None, case.m, case.dt)
        x, xdot = case.s.cumsum(axis=1), case.v.cumsum(axis=1)
        library = InterstoryPolynomialLibrary(3, inputs="state")
        state, rates = np.hstack([x, xdot]), np.hstack([xdot, case.a])
        return cls(kind, library, state, rates, case.F, case.m, case.dt)

    def rows(self, rows):
        u = None if self.u is None else self.u[rows]
        return replace(self, x=self.x[rows], y=self.y[rows], u=u)

    def features(self):
        columns = self.x if self.u is None else np.hstack([self.x, self.u])
        return self.library.fit_transform(columns)

    def optimizer(self, inner=None):
        return self.kind(inner, terms=self.library)

    def sindy(self, inner=None, **options):
        model = ps.SINDy(self.optimizer(inner), self.library)
        return model.fit(self.x, t=self.dt, x_dot=self.y, u=self.u, **options)


KINDS = [ChainOptimizer, StateSpaceChainOptimizer]


@pytest.fixture(params=KINDS, ids=lambda kind: kind.__name__)
def task(request):
    np.random.seed(0)  # EnsembleOptimizer draws from NumPy's global state
    with warnings.catch_warnings(action="ignore", category=BiasWarning):
        yield Task.of(request.param)


@INNERS
def test_fit_gives_what_pysindy_reads(task, inner):
    features = task.features()
    optimizer = task.kind(inner)
    assert optimizer.fit(features, task.y) is optimizer
    coef = optimizer.coef_
    assert coef.shape == (task.y.shape[1], features.shape[1])
    assert np.array_equal(optimizer.ind_, coef != 0)
    assert optimizer.complexity == np.count_nonzero(coef)
    assert optimizer.intercept_ == 0
    assert optimizer.n_features_in_ == features.shape[1]
    assert np.array_equal(optimizer.predict(features), np.asarray(features) @ coef.T)


@INNERS
def test_fit_finds_the_masses(task, inner):
    features = task.features()
    optimizer = task.kind(inner).fit(features, task.y)
    assert np.abs(optimizer.masses_ / task.m - 1).max() < 0.02
    # of ChainOptimizer, too, two of whose targets are zero throughout
    assert optimizer.score(features, task.y) > 0.99


def test_one_target_is_a_line_or_a_column():
    case = chains.duffing(1, [1], n_samples=500)
    features = np.asarray(InterstoryPolynomialLibrary(3).fit_transform(case.X))
    line = ChainOptimizer().fit(features, case.F[:, 0])
    column = ChainOptimizer().fit(features, case.F)
    assert np.array_equal(line.coef_, column.coef_)
    assert line.coef_.shape == (1, features.shape[1])
    assert line.predict(features).shape == (500,)
    assert column.predict(features).shape == (500, 1)


@INNERS
def test_inside_sindy(task, inner):
    model = task.sindy(inner)
    n_features = len(model.get_feature_names())
    assert model.coefficients().shape == (task.y.shape[1], n_features)
    assert model.complexity == model.optimizer.complexity
    assert len(model.equations(precision=3)) == task.y.shape[1]
    largest = np.abs(task.y).max()
    assert np.allclose(model.predict(task.x, u=task.u), task.y, atol=0.05 * largest)


def largest_gap(first, other, **_):
    return np.abs(first - other).max()


def test_a_metric_of_sindy_gets_the_targets(task):
    model = task.sindy()
    score = model.score(task.x, t=task.dt, x_dot=task.y, u=task.u, metric=largest_gap)
    expected = largest_gap(model.predict(task.x, u=task.u), task.y)
    assert score == pytest.approx(expected)


def test_sindy_prints_an_equation_for_each_target(task, capsys):
    task.sindy().print(precision=2)
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == task.y.shape[1]
    assert all("=" in line for line in lines)


def test_the_force_stands_on_the_left_of_a_balance(capsys):
    sindy = Task.of(ChainOptimizer).sindy()
    sindy.print(lhs=sindy.optimizer.targets_)
    assert capsys.readouterr().out.startswith("F1 = ")


def test_the_users_names_reach_the_equations(capsys):
    names = "x_low x_mid x_top v_low v_mid v_top P1 shaker P3".split()
    model = Task.of(StateSpaceChainOptimizer).sindy(feature_names=names)
    assert model.get_feature_names()[-2] == "shaker"
    model.print()
    lines = capsys.readouterr().out.splitlines()
    assert lines[1] == "(x_mid)' =  1.000 v1 +  1.000 v2"
    assert "shaker" in lines[4]


def test_trajectories_of_different_length_inside_sindy(task):
    parts = [task.rows(slice(0, 500)), task.rows(slice(500, 900))]
    u = None if task.u is None else [piece.u for piece in parts]
    x, y = [piece.x for piece in parts], [piece.y for piece in parts]
    model = ps.SINDy(task.optimizer(), task.library)
    model.fit(x, t=[np.arange(len(p)) * task.dt for p in x], x_dot=y, u=u)
    masses = task.sindy().optimizer.masses_
    assert np.allclose(model.optimizer.masses_, masses, rtol=1e-9)
    shapes = [rates.shape for rates in model.predict(x, u=u)]
    assert shapes == [piece.y.shape for piece in parts]


WEIGHTED = pytest.mark.parametrize(
    "inner", [None, ps.STLSQ(threshold=0.02)], ids=["least squares", "STLSQ"]
)


def noisy(task):
    """An inexact fit, so that weights matter; and weights of 0, 1 and 2."""
    rng = np.random.default_rng(0)
    x = task.x + 0.01 * task.x.std(axis=0) * rng.standard_normal(task.x.shape)
    return replace(task, x=x), rng.integers(0, 3, len(x))


@WEIGHTED
def test_a_weight_of_two_is_the_row_twice(task, inner):
    """PySINDy's development version passes weights to ``optimizer.fit``."""
    task, weights = noisy(task)
    twice = task.rows(np.repeat(np.arange(len(weights)), weights))
    weighted = task.kind(inner).fit(task.features(), task.y, sample_weight=weights)
    repeated = task.kind(inner).fit(twice.features(), twice.y)
    plain = task.kind(inner).fit(task.features(), task.y)
    assert np.allclose(weighted.coef_, repeated.coef_, rtol=1e-9)
    assert not np.allclose(weighted.coef_, plain.coef_, rtol=1e-6)


@WEIGHTED
def test_a_weight_of_the_regressor_is_that_of_the_optimizer(inner):
    task, weights = noisy(Task.of(ChainOptimizer))
    rows = np.repeat(np.arange(len(weights)), weights)
    model = NRFRegressor(optimizer=inner)
    weighted = clone(model).fit(task.x, task.y, weights)
    repeated = clone(model).fit(task.x[rows], task.y[rows])
    optimizer = ChainOptimizer(inner).fit(task.features(), task.y, weights)
    assert np.allclose(weighted.masses_, repeated.masses_, rtol=1e-9)
    assert weighted.n_samples_ == len(rows)
    errors = repeated.errors_["error"]
    assert np.allclose(weighted.errors_["error"], errors, rtol=1e-9)
    assert np.allclose(weighted.masses_, optimizer.masses_, rtol=1e-9)
