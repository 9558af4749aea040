"""Claims about the motions that are fused, differentiated, integrated and filtered."""

import math
from functools import cache

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

from pysindy_nrf import ChainModel, NRFRegressor, Record, datasets, laws, simulate
from pysindy_nrf.exceptions import ChainError, ChannelError, DataQualityWarning
from pysindy_nrf.records.fusion import KinematicSmoother, integrate
from pysindy_nrf.records.fusion.kinematics import to_features
from pysindy_nrf.records.zero_phase_filter import ZeroPhaseFilter

FS, N, MASS = 1000.0, 16000, 12.4
CHAIN = ChainModel(
    [MASS] * 4, {i: laws.PowerSeries(1, [25.0, 1.4e5]) for i in (1, 2, 3, 4)}
)


@cache
def chain_test(kind, seed, over=2):
    """Force, acceleration, velocity, displacement of the four floors; floor 3 is
    forced.
    """
    rng = np.random.default_rng(seed)
    n, dt = N * over, 1 / (FS * over)
    t = np.arange(n) * dt
    force = np.zeros((n, 4))
    if kind == "random":
        f = np.fft.rfftfreq(n + 5000, dt)
        lines = np.where(
            (f > 0.5) & (f < 60),
            rng.normal(size=len(f)) + 1j * rng.normal(size=len(f)),
            0,
        )
        force[:, 2] = np.fft.irfft(lines)[:n]
        force[:, 2] *= 300 / force[:, 2].std()
    else:
        for start in np.arange(0.5, 15.5, 2) + rng.uniform(0, 0.5, 8):
            hit = (t > start) & (t < start + 0.006)
            force[hit, 2] += (
                1000 * rng.uniform(0.7, 1.3) * np.sin(np.pi * (t[hit] - start) / 0.006)
            )
    run = simulate(CHAIN, force, dt)
    return [
        y[::over] for y in (force, run.acceleration, run.velocity, run.displacement)
    ]


def with_noise(channels, share, rng):
    return [y + share * y.std(axis=0) * rng.normal(size=y.shape) for y in channels]


def sequential_masses(X, F):
    """Balance 3 gives m3, R3, R4; then floors 4, 2, 1 with the known neighbour."""
    a, v, s = (X.filter(regex=f"^{k}").to_numpy().T for k in "avs")
    F = F.to_numpy().T

    def fit(columns, target):
        columns = np.column_stack(columns)
        size = columns.std(axis=0)
        return np.linalg.lstsq(columns / size, target, rcond=None)[0] / size

    c = fit([a[2], v[2], s[2], -v[3], -s[3]], F[2])
    r3, r4, m3 = c[1] * v[2] + c[2] * s[2], c[3] * v[3] + c[4] * s[3], c[0]
    m4 = fit([a[3]], F[3] - r4)[0]
    m2, c2, k2 = fit([a[1], v[1], s[1]], F[1] + r3)
    m1 = fit([a[0], v[0], s[0]], F[0] + c2 * v[1] + k2 * s[1])[0]
    return np.array([m1, m2, m3, m4])


def analytic(n=4000, fs=FS, top=FS / 20):
    """Two DOFs moving below ``top`` Hz; not periodic in the record."""
    t = np.arange(n) / fs
    w = 2 * np.pi * top * np.array([0.97, 0.31, 0.053])
    size = np.array([[1.0, 0.3, 2.0], [0.5, -0.6, 1.0]]) * 1e-3
    x = (size[:, :, None] * np.sin(w[:, None] * t + 0.3)).sum(axis=1).T
    v = ((size * w)[:, :, None] * np.cos(w[:, None] * t + 0.3)).sum(axis=1).T
    a = (-(size * w**2)[:, :, None] * np.sin(w[:, None] * t + 0.3)).sum(axis=1).T
    return t, a, v, x


def rms(y):
    return np.sqrt(np.mean(np.square(y), axis=0))


# -- fusion --------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["random", "hammer"])
@pytest.mark.parametrize("seed", [0, 1])
def test_masses_by_least_squares_on_fused_channels_are_within_two_percent(kind, seed):
    clean = chain_test(kind, seed)
    F, a, v, x = with_noise(clean, 0.05, np.random.default_rng(100 + seed))
    F[:, [0, 1, 3]] = 0.0
    smoother = KinematicSmoother()
    X, F = to_features(Record(F, a, v, x, fs=FS), smoother)
    assert np.abs(sequential_masses(X, F) / MASS - 1).max() < 0.02
    # noise levels are found from the data
    true = 0.05 * np.concatenate([y.std(axis=0) for y in clean[1:]])
    np.testing.assert_allclose(smoother.noise_, true, rtol=0.1)
    # no damage at the ends of a record that is not periodic
    absolute = np.cumsum(X.to_numpy().reshape(N, 3, 4)[:, 1:], axis=2)
    errors = [
        X.to_numpy()[:, :4] - clean[1],
        absolute[:, 0] - clean[2],
        absolute[:, 1] - clean[3],
    ]
    for error in errors:
        edge = N // 20
        assert (rms(error[:edge]) <= 2 * rms(error[edge:-edge])).all()
        assert (rms(error[-edge:]) <= 2 * rms(error[edge:-edge])).all()


@pytest.mark.parametrize("share", [0.01, 0.1])
@pytest.mark.parametrize("kinds", ["avx", "ax", "x", "a"])
def test_noise_levels_from_one_two_or_three_channels(kinds, share):
    truth = dict(zip("avx", chain_test("random", 4)[1:], strict=True))
    rng = np.random.default_rng(4)
    measured = {k: with_noise([truth[k]], share, rng)[0] for k in kinds}
    table = pd.DataFrame(
        {f"{k}{j + 1}": y[:, j] for k, y in measured.items() for j in range(4)}
    )
    smoother = KinematicSmoother(fs=FS, band=(2.0, 100.0)).fit(table)
    true = {
        f"{k}{j + 1}": share * truth[k][:, j].std() for k in kinds for j in range(4)
    }
    np.testing.assert_allclose(
        smoother.noise_[list(true)], list(true.values()), rtol=0.2
    )


@pytest.mark.parametrize("kinds", ["avx", "ax", "vx", "x"])
def test_noise_free_motion_comes_back_unchanged(kinds):
    t, a, v, x = analytic()
    measured = [
        y if kind in kinds else None for kind, y in (("a", a), ("v", v), ("x", x))
    ]
    fused = KinematicSmoother().transform_record(Record(None, *measured, fs=FS))
    inside = (
        slice(None) if "a" in kinds else slice(40, -40)
    )  # at the very ends a derivative is extrapolation
    for truth, found in (
        (a, fused.acceleration),
        (v, fused.velocity),
        (x, fused.displacement),
    ):
        assert np.abs(found - truth)[inside].max() < 1e-6 * rms(truth).min()


def test_noise_free_hammer_keeps_its_kinks_and_the_masses_are_exact():
    F, a, v, x = chain_test("hammer", 0, over=1)
    X, F = to_features(Record(F, a, v, x, fs=FS))
    np.testing.assert_allclose(sequential_masses(X, F), MASS, rtol=1e-8)


def test_noise_free_friction_is_not_smoothed_and_every_parameter_is_exact():
    """Friction that creeps through some 20 reversals a second leaves kinks in most
    samples; truth by LSODA.
    """
    t, k, c, tones = (
        np.arange(3000) / 250,
        (9e4, 6e4),
        (60.0, 40.0),
        (5.1, 8.3, 13.7, 21.9),
    )

    def force(now):
        return 60.0 * np.sin(2 * np.pi * np.outer(now, tones) + tones).sum(axis=1)

    def acceleration(now, x, v):
        drift, rate = (np.diff(y, axis=0, prepend=0.0) for y in (x, v))
        storeys = np.array(k)[:, None] * drift + np.array(c)[:, None] * rate
        storeys[1] += 20.0 * np.tanh(rate[1] / 1e-4)
        applied = np.stack([np.zeros(len(now)), force(now)])
        return (
            applied - storeys + np.append(storeys[1:], np.zeros((1, len(now))), axis=0)
        ) / 10.0

    def rates(now, y):
        """The same for one moment, in numbers: the integrator asks a hundred thousand
        times.
        """
        x1, x2, v1, v2 = y.tolist()
        top = k[1] * (x2 - x1) + c[1] * (v2 - v1) + 20.0 * math.tanh((v2 - v1) / 1e-4)
        applied = 60.0 * sum(math.sin(2 * math.pi * now * f + f) for f in tones)
        return v1, v2, (top - k[0] * x1 - c[0] * v1) / 10.0, (applied - top) / 10.0

    y = solve_ivp(
        rates,
        (0, t[-1]),
        np.zeros(4),
        "LSODA",
        t,
        rtol=1e-10,
        atol=1e-13,
        max_step=2e-3,
    ).y
    F = np.column_stack([np.zeros_like(t), force(t)])
    record = Record(F, acceleration(t, y[:2], y[2:]).T, y[2:].T, y[:2].T, fs=250.0)
    linear = [laws.LinearElastic(), laws.LinearViscous()]
    model = NRFRegressor(
        laws={1: linear, 2: [*linear, laws.RegularizedFriction()]}
    ).fit(record)
    np.testing.assert_allclose(model.masses_, 10.0, rtol=1e-6)
    assert model.model_.laws[model.chain_.site(2)][2].parameters == pytest.approx(
        {"v0": 1e-4, "Fc": 20.0}, rel=1e-4
    )


def test_fused_channels_are_derivatives_of_each_other():
    _, a, v, x = chain_test("random", 5)
    noisy = with_noise((a, v, x), 0.05, np.random.default_rng(5))
    fused = KinematicSmoother().transform_record(Record(None, *noisy, fs=FS))
    # integrated over the whole record, the acceleration gives the velocity, and that
    # the displacement
    for rate, motion in (
        (fused.acceleration, fused.velocity),
        (fused.velocity, fused.displacement),
    ):
        assert (
            np.abs(integrate(rate, 1 / FS) - (motion - motion[0])).max()
            < 1e-4 * rms(motion).min()
        )


def test_given_noise_levels_are_used_by_kind_and_by_channel():
    t, a, v, x = analytic()
    record = Record(acceleration=a, displacement=x, fs=FS)
    smoother = KinematicSmoother(noise={"a": 0.3, "a2": 0.7, "x": 2e-6}).fit(record)
    assert smoother.noise_.to_dict() == {"a1": 0.3, "a2": 0.7, "x1": 2e-6, "x2": 2e-6}
    for bad in ({"q": 1.0}, {"a": -1.0}, "guess", 3.0):
        with pytest.raises(ChannelError):
            KinematicSmoother(noise=bad).fit(record)


def test_accelerations_alone_warn_and_name_what_is_lost():
    t, a, v, x = analytic(8000, top=20.0)
    record = Record(acceleration=a, fs=FS)
    with pytest.warns(DataQualityWarning, match="no displacement is measured"):
        smoother = KinematicSmoother().fit(record)
    assert (smoother.high_pass_ > 0).all()
    limited = KinematicSmoother(band=(0.8, None)).fit_transform(record)
    good = np.isfinite(limited.displacement[:, 0])
    truth = ZeroPhaseFilter((0.8, None), FS).apply(x)
    assert good.sum() < record.n_samples
    assert np.abs(limited.displacement - truth)[good].max() < 0.01 * rms(truth).min()


def test_moving_base_relative_and_absolute_give_the_same_features():
    t, a, v, x = analytic()
    w = 2 * np.pi * 3.1
    xg, vg, ag = (
        0.02 * np.sin(w * t),
        0.02 * w * np.cos(w * t),
        -0.02 * w**2 * np.sin(w * t),
    )
    absolute_a = a + ag[:, None]
    want, _ = to_features(
        Record(None, absolute_a, v, x, fs=FS, base_acceleration=ag), smooth=False
    )
    cases = {
        "ag": Record(None, absolute_a, None, x, fs=FS, base_acceleration=ag),
        "xg": Record(None, absolute_a, None, x, fs=FS, base_displacement=xg),
        "absolute xg": Record(
            None,
            absolute_a,
            None,
            x + xg[:, None],
            fs=FS,
            base_displacement=xg,
            coordinates="absolute",
        ),
        "absolute all": Record(
            None,
            absolute_a,
            v + vg[:, None],
            x + xg[:, None],
            fs=FS,
            base_displacement=xg,
            base_acceleration=ag,
            coordinates="absolute",
        ),
    }
    for name, record in cases.items():
        got, _ = to_features(record)
        worst = (np.abs(got - want).iloc[40:-40].max() / want.std()).max()
        assert worst < 1e-5, name
    with pytest.raises(ChannelError, match="base_displacement"):
        to_features(
            Record(
                None,
                absolute_a,
                v,
                x,
                fs=FS,
                base_acceleration=ag,
                coordinates="absolute",
            )
        )


def test_features_are_absolute_accelerations_and_interstorey_motion():
    t, a, v, x = analytic()
    F = np.full_like(a, np.nan)
    F[:, 0] = 7.0
    X, forces = to_features(Record(F, a, v, x, fs=FS), smooth=False)
    assert (
        list(X.columns) == ["a1", "a2", "v1", "v2", "s1", "s2"] and X.index.name == "t"
    )
    np.testing.assert_array_equal(X[["a1", "a2"]], a)
    np.testing.assert_array_equal(X["s2"], x[:, 1] - x[:, 0])
    np.testing.assert_array_equal(X["v1"], v[:, 0])
    assert (forces["F1"] == 7).all() and forces["F2"].isna().all()


def test_missing_channels_are_named():
    t, a, v, x = analytic()
    with pytest.raises(ChannelError, match="lacks v1, v2"):
        to_features(Record(None, a, None, x, fs=FS), smooth=False)
    dead = a.copy()
    dead[:, 1] = np.nan
    with pytest.raises(ChannelError, match="DOF 2 .* no motion channel"):
        to_features(Record(None, dead, fs=FS))
    with pytest.raises(ChannelError, match="has no names"):
        KinematicSmoother(fs=FS).fit(a)
    with pytest.raises(ChannelError, match="is a motion"):
        KinematicSmoother(fs=FS).fit(pd.DataFrame({"F1": t}))
    with pytest.raises(ChannelError, match="sampling rate"):
        KinematicSmoother().fit(pd.DataFrame({"a1": a[:, 0]}))
    with pytest.raises(ChannelError, match="a1 .* NaN in row 17"):
        hole = a[:, 0].copy()
        hole[17] = np.nan
        KinematicSmoother(fs=FS).fit(pd.DataFrame({"a1": hole}))


def test_masked_edges_stay_masked_and_inputs_are_untouched():
    t, a, v, x = analytic()
    table = pd.DataFrame({"a1": a[:, 0], "x1": x[:, 0], "F1": a[:, 0]})
    table.loc[:9, "a1"] = np.nan
    table.loc[3990:, "x1"] = np.nan
    before = table.copy()
    out = KinematicSmoother(fs=FS).fit_transform(table)
    pd.testing.assert_frame_equal(table, before)
    assert out.loc[10:3989, ["a1", "v1", "x1"]].notna().all(axis=None)
    assert out.loc[:9, "v1"].isna().all() and out.loc[3990:, "a1"].isna().all()


def test_forces_are_filtered_only_with_a_band_and_then_like_the_response():
    F, a, v, x = chain_test("random", 6)
    record = Record(F, a, v, x, fs=FS)
    np.testing.assert_array_equal(KinematicSmoother().transform_record(record).force, F)
    X, forces = to_features(record, KinematicSmoother(band=(2.0, 40.0)))
    rows = X.notna().all(axis=1)
    assert (forces.notna().all(axis=1) == rows).all() and 0 < (~rows).sum() < N
    np.testing.assert_allclose(
        sequential_masses(X[rows], forces[rows]), MASS, rtol=1e-3
    )


# -- integrals -----------------------------------------------------------------


@pytest.mark.parametrize("method", ["spline", "cumulative"])
def test_every_integral_starts_at_zero(method):
    """Of a cos(w t + p), once: (sin(w t + p) - sin p) / w; twice, about rest."""
    t = np.arange(500) / FS
    w, phase = 2 * np.pi * 3 * FS / 500, 0.7
    once = integrate(np.cos(w * t + phase), 1 / FS, method)
    twice = integrate(np.cos(w * t + phase), 1 / FS, method, order=2)
    start = np.sin(phase) / w
    rough = 1e-8 if method != "cumulative" else 1e-3
    np.testing.assert_allclose(
        once, (np.sin(w * t + phase) - np.sin(phase)) / w, atol=rough / w
    )
    np.testing.assert_allclose(
        twice,
        (np.cos(phase) - np.cos(w * t + phase)) / w**2 - start * t,
        atol=5 * rough / w**2,
    )
    assert once[0] == twice[0] == 0.0


def test_the_trapezoid_rule_loses_what_theory_says():
    t = np.arange(4000) / FS
    w = 2 * np.pi * FS / 10
    velocity = integrate(np.cos(w * t) * w, 1 / FS, "cumulative")
    assert velocity.max() == pytest.approx(
        (w / FS / 2) / np.tan(w / FS / 2) * np.sin(w * t).max(), rel=1e-3
    )


def test_detrended_integral_drops_offset_and_initial_velocity():
    t, a, v, x = analytic(8000, top=20.0)
    found = integrate(a + 0.3, 1 / FS, order=2, detrend=True)
    level = np.polynomial.legendre.legvander(np.linspace(-1, 1, len(t)), 2)
    want = x - level @ np.linalg.lstsq(level, x, rcond=None)[0]
    assert np.abs(found - want).max() < 1e-5 * rms(want).min()


# -- band and edges ------------------------------------------------------------


def test_one_hertz_high_pass_spoils_three_seconds():
    edge = ZeroPhaseFilter((1.0, None), FS).edge
    assert 2.5 < edge / FS < 3.5 and ZeroPhaseFilter(
        (1.0, None), 250.0
    ).edge == pytest.approx(edge / 4, rel=0.02)


def test_inside_the_edges_the_filter_does_not_feel_where_the_record_was_cut():
    long = np.random.default_rng(0).normal(size=(30000, 1))
    band = ZeroPhaseFilter((1.0, 60.0), FS)
    whole, part = band.apply(long), band.apply(long[8000:22000])
    gap = np.abs(part - whole[8000:22000])
    assert gap[band.edge : -band.edge].max() < 1e-3 and gap.max() > 1e-2


# -- long records --------------------------------------------------------------


@pytest.mark.parametrize(("n_dof", "n"), [(1, 16), (1, 60), (3, 100), (12, 3000)])
def test_any_number_of_floors_and_short_records(n_dof, n):
    t = np.arange(n)[:, None] / FS
    w = 2 * np.pi * (5 + np.arange(n_dof))
    x = np.sin(w * t + 0.4)
    a, x_noisy = with_noise((-(w**2) * x, x), 0.05, np.random.default_rng(0))
    fused = KinematicSmoother().transform_record(
        Record(acceleration=a, displacement=x_noisy, fs=FS)
    )
    assert (rms(fused.displacement - x) < rms(x_noisy - x)).all()


def test_dead_channel_and_resting_floor_do_no_harm():
    t, a, v, x = analytic()
    a, x = with_noise((a, x), 0.02, np.random.default_rng(0))
    a[:, 1] = x[:, 1] = 0.0
    fused = KinematicSmoother().transform_record(
        Record(acceleration=a, displacement=x, fs=FS)
    )
    assert not fused.velocity[:, 1].any()
    assert (rms(fused.velocity - v)[0] < 0.02 * rms(v))[0]


def test_slow_motion_sampled_very_fast_is_fused_all_the_same():
    """0.3-3 Hz at 4 kHz: the normal equations lose their last digits; the motion is
    known here in closed form.
    """
    t = np.arange(0, 20, 1 / 4000)
    lines = [(0.3, 1.0), (1.0, 2.0), (3.0, 0.5)]
    x, v, a = (
        sum(
            np.real((2j * np.pi * f) ** k * 1e-2 * np.exp(1j * (2 * np.pi * f * t + p)))
            for f, p in lines
        )
        for k in (0, 1, 2)
    )
    rough = np.gradient(x, 1 / 4000)
    rec = Record(
        force=0 * x[:, None],
        acceleration=np.gradient(rough, 1 / 4000)[:, None],
        velocity=rough[:, None],
        displacement=x[:, None],
        fs=4000.0,
    )
    X, _ = rec.to_features()
    inner = slice(400, -400)
    for name, exact in (("a1", a), ("v1", v), ("s1", x)):
        assert (
            np.abs(X[name].to_numpy() - exact)[inner].max() < 2e-4 * np.abs(exact).max()
        )


@pytest.mark.parametrize("exact", ["v", "a"])
@pytest.mark.parametrize("duration", [8.0, 40.0])
def test_an_exact_derivative_beside_a_noisy_displacement_leaves_the_position_where_it_is(
    exact, duration
):
    """The mean of the displacement is known to sigma / sqrt(n) from x alone, and no
    better from v or a.
    """
    fs, rng = 500.0, np.random.default_rng(3)
    t = np.arange(int(duration * fs)) / fs
    w = 2 * np.pi * np.array([[1.7], [5.3]])
    x = (np.array([[2e-3], [1e-3]]) * np.sin(w * t)).sum(axis=0) + 4e-3
    v = (np.array([[2e-3], [1e-3]]) * w * np.cos(w * t)).sum(axis=0)
    a = -(np.array([[2e-3], [1e-3]]) * w**2 * np.sin(w * t)).sum(axis=0)
    sigma = 0.05 * x.std()
    table = pd.DataFrame(
        {
            "x1": x + sigma * rng.standard_normal(len(t)),
            **({"v1": v} if exact == "v" else {"a1": a}),
        }
    )
    out = KinematicSmoother(fs=fs).fit_transform(table)
    left = out["x1"] - x
    assert abs(left.mean()) < 5 * sigma / np.sqrt(len(t)) and left.std() < 0.1 * sigma
    assert (
        np.abs(out[f"{exact}1"] - {"v": v, "a": a}[exact]).max()
        < 1e-3 * np.abs({"v": v, "a": a}[exact]).max()
    )


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: integrate(np.zeros((3, 3, 3)), 0.01), "The motion has 3 dimensions"),
        (lambda: integrate(np.zeros(10), 0.1, "magic"), "Choose"),
        (lambda: integrate(np.zeros(10), 0.1, order=3), "order"),
        (
            lambda: integrate(np.array([0, 1, 2, np.nan, 4, 5, 6, 7.0]), 0.1),
            "not finite in row 3",
        ),
        (lambda: ZeroPhaseFilter((1, 50), fs=-1.0), "fs=-1.0 is not a positive number"),
        (
            lambda: KinematicSmoother(fs=500.0, band="automatic").fit(
                pd.DataFrame({"a1": np.sin(np.arange(99))})
            ),
            "band='automatic' is unknown",
        ),
        (lambda: KinematicSmoother().fit(np.zeros((99, 2))), "ndarray has no names"),
        (
            lambda: KinematicSmoother(fs=500.0).fit(pd.DataFrame({"a1": [], "x1": []})),
            "X has no samples",
        ),
    ],
)
def test_an_argument_of_a_filter_is_named_with_its_cure(call, words):
    with pytest.raises((ChannelError, ChainError), match=words):
        call()


def test_a_smoother_meets_other_columns_clocks_and_lengths():
    rec = datasets.load_demo()
    frame = rec.to_frame().iloc[:2000]
    fitted = KinematicSmoother().fit(frame)
    with pytest.raises(ChannelError, match="are not those of fit"):
        fitted.transform(frame[list(frame.columns[::-1])])
    with pytest.raises(
        ChannelError, match=r"fs=77.0 Hz contradicts the clock of the data"
    ):
        KinematicSmoother(fs=77.0).fit(frame)
    with pytest.raises(ChannelError, match="spoils .* at each end"):
        KinematicSmoother(band=(0.05, None)).fit_transform(frame.iloc[:400])
