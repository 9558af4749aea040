"""Checks of the contract of a force law.

:func:`check_law` runs them on any law, with random parameters and a random motion. A
check that fails raises ``AssertionError`` with a sentence.
"""

import json
from collections.abc import Callable
from dataclasses import replace
from typing import get_args

import numpy as np

from ..common import generator
from .base import ForceLaw, Place, Variable, from_dict
from .shape import Motion

PERIOD = 2.0  # s
DRIFT = 0.01  # m


class FullMotion(Motion):
    """A motion with accelerations and times."""

    a: np.ndarray
    t: np.ndarray

    def during(self, rows: slice) -> "FullMotion":
        """The motion during some samples."""
        return FullMotion(
            self.s[rows],
            self.v[rows],
            self.a[rows],
            self.t[rows],
            {name: x[rows] for name, x in self.covariates.items()},
        )

    def channels(self) -> list[np.ndarray]:
        """All arrays that a law may read."""
        return [self.s, self.v, self.a, self.t, *self.covariates.values()]


def covariate_units(law: ForceLaw) -> tuple[str, ...]:
    """Units of the covariates of a law, "[u]" by default."""
    return law.covariate_units or ("[u]",) * len(law.covariates)


def random_motion(
    law: ForceLaw, rng: np.random.Generator, n_periods: int = 2, n_samples: int = 500
) -> FullMotion:
    """A smooth periodic motion that closes every gap, with all channels of a law."""
    t = np.arange(n_periods * n_samples + 1) * (PERIOD / n_samples)
    order = np.arange(1, 4)[:, None]
    omega = 2 * np.pi * order / PERIOD
    phase = omega * t + rng.uniform(0, 2 * np.pi, order.shape)
    size = 10 * DRIFT * rng.uniform(0.5, 1.0, order.shape) / order**2

    covariates = {}
    for name, unit in zip(law.covariates, covariate_units(law), strict=True):
        wave = np.sin(3 * t + rng.uniform(0, 2 * np.pi))
        covariates[name] = 1.5 + wave if unit == "[u]" else 20 * DRIFT * wave
    return FullMotion(
        s=(size * np.sin(phase)).sum(axis=0),
        v=(size * omega * np.cos(phase)).sum(axis=0),
        a=(-size * omega**2 * np.sin(phase)).sum(axis=0),
        t=t,
        covariates=covariates,
    )


def random_values(law: ForceLaw, rng: np.random.Generator) -> ForceLaw:
    """A law with positive coefficients and shape parameters from its search bounds."""
    shape = {}
    for parameter in law.shapes:
        low, high = parameter.bounds(drift=DRIFT, rate=5 * DRIFT, duration=2 * PERIOD)
        if parameter.log:
            shape[parameter.name] = np.exp(rng.uniform(np.log(low), np.log(high)))
        else:
            shape[parameter.name] = rng.uniform(low, high)
    return law.with_values(rng.uniform(1.0, 10.0, len(law.terms())), shape)


# -- features ------------------------------------------------------------------


def check_features(law: ForceLaw, rng: np.random.Generator) -> None:
    """Features are finite columns, one for each term; the motion is unchanged."""
    motion = random_motion(law, rng)
    before = [np.copy(channel) for channel in motion.channels()]

    columns = law.features(motion)

    expected_shape = (motion.n_samples, len(law.terms()))
    assert columns.shape == expected_shape, (
        f"{law}: features have shape {columns.shape}"
    )
    assert columns.dtype == np.float64, f"{law}: features are {columns.dtype}"
    assert np.isfinite(columns).all(), f"{law}: features are not finite"
    for old, new in zip(before, motion.channels(), strict=True):
        assert np.array_equal(old, new), f"{law}: the kernel changes the motion"


def check_large_arguments(law: ForceLaw, rng: np.random.Generator) -> None:
    """Motions of 1e-30 to 1e30 give finite features without a warning."""
    n = 200

    def wild() -> np.ndarray:
        return rng.choice([-1.0, 0.0, 1.0], n) * 10.0 ** rng.uniform(-30, 30, n)

    motion = Motion(s=wild(), v=wild(), a=wild(), t=np.arange(n) * 0.01)
    motion = replace(motion, covariates={name: wild() for name in law.covariates})
    with np.errstate(over="raise", invalid="raise", divide="raise"):
        columns = law.features(motion)
    assert np.isfinite(columns).all(), (
        f"{law}: large arguments give features that are not finite"
    )


def check_single_samples(law: ForceLaw, rng: np.random.Generator) -> None:
    """The kernel gives the same numbers on arrays, on floats, and compiled."""
    from .callbacks import compiled_kernel
    from .memory import state_path

    motion = random_motion(law, rng, n_periods=1)
    columns = law.features(motion)
    u = law.covariate_rows(motion)
    z = np.zeros((0, motion.n_samples))
    if law.n_states:
        z = state_path(law, motion, u, law.theta)

    def check(kernel: Callable[..., None], how: str) -> None:
        for i in range(0, motion.n_samples, 29):
            numbers = [float(x[i]) for x in (motion.s, motion.v, motion.a, motion.t)]
            now_u = np.ascontiguousarray(u[:, i])
            now_z = np.ascontiguousarray(z[:, i])
            sample = np.full(columns.shape[1], np.nan)
            kernel(*numbers, now_u, now_z, law.theta, sample)
            message = f"{law}: the kernel {how} differs from the kernel on arrays"
            _assert_close(sample, columns[i], message, scale=columns)

    check(type(law).kernel, "on floats")
    check(compiled_kernel(law), "compiled")


def check_records(law: ForceLaw, rng: np.random.Generator) -> None:
    """Each record starts from a fresh state; blocks that pass it on are one record."""
    motion = random_motion(law, rng)
    columns = law.features(motion)

    shared = motion.n_samples // 2 + 3  # sample that both blocks contain
    first = motion.during(slice(0, shared + 1))
    last = motion.during(slice(shared, None))
    state = np.zeros(law.n_states)
    _assert_close(
        law.features(first, state),
        columns[: shared + 1],
        f"{law}: the first block differs from the record",
    )
    _assert_close(
        law.features(last, state),
        columns[shared:],
        f"{law}: the last block differs from the record",
    )

    fresh = law.features(last)
    _assert_close(
        fresh[0],
        _first_row_from_rest(law, last),
        f"{law}: a record does not start from a fresh state",
    )
    _assert_close(
        law.features(motion), columns, f"{law}: the law remembers an earlier record"
    )
    _assert_close(
        law.features(Motion.joined([motion, last])),
        np.vstack([columns, fresh]),
        f"{law}: two records side by side differ from each of them",
    )


def _first_row_from_rest(law: ForceLaw, motion: FullMotion) -> np.ndarray:
    """Features at the first sample, from the kernel at a state of zero."""
    start = motion.during(slice(0, 1))
    u = law.covariate_rows(start)
    out = np.empty((len(law.terms()), 1))
    z = np.zeros((law.n_states, 1))
    law.kernel(start.s, start.v, start.a, start.t, u, z, law.theta, out)
    return out[:, 0]


# -- what a law promises about its force ---------------------------------------


def check_standstill(law: ForceLaw, rng: np.random.Generator) -> None:
    """The force at zero drift and velocity is the stated one."""
    motion = random_motion(law, rng)
    zero = np.zeros(motion.n_samples)
    columns = law.features(replace(motion, s=zero, v=zero, a=zero))
    if law.at_rest is None:
        assert columns.any(), (
            f"{law}: at_rest is None, but the force vanishes at standstill"
        )
        return
    _assert_close(
        columns.sum(axis=1),
        np.full(motion.n_samples, law.at_rest),
        f"{law}: the force at standstill is not {law.at_rest}",
    )


def check_symmetry(law: ForceLaw, rng: np.random.Generator) -> None:
    """The mirrored motion gives the mirrored force, as the law states."""
    motion = random_motion(law, rng)
    columns = law.features(motion)
    mirrored = law.features(replace(motion, s=-motion.s, v=-motion.v, a=-motion.a))

    symmetry = "none"
    if np.allclose(mirrored, columns, rtol=1e-9, atol=0):
        symmetry = "even"
    if np.allclose(mirrored, -columns, rtol=1e-9, atol=0):
        symmetry = "odd"
    assert symmetry == law.symmetry, (
        f"{law}: symmetry is {law.symmetry!r}, found {symmetry!r}"
    )


def check_energy(law: ForceLaw, rng: np.random.Generator) -> None:
    """Over closed cycles a passive law gives no energy; a spring also takes none."""
    motion = random_motion(law, rng, n_periods=4, n_samples=4000)
    force = law.features(motion)[:-1]
    rate = motion.v[:-1, None]
    power = (force * rate).mean(axis=0)
    size = np.abs(force).max(axis=0) * np.abs(rate).mean()
    if law.passive:
        assert (power >= -1e-6 * size).all(), f"{law}: passive, but gives energy"
    if law.variable in ("s", "a"):
        assert (np.abs(power) <= 1e-6 * size).all(), (
            f"{law}: takes or gives energy over closed cycles"
        )


def check_variable(law: ForceLaw, rng: np.random.Generator) -> None:
    """The force follows the variable that the law states."""
    assert law.variable in (None, *get_args(Variable)), (
        f"{law}: variable is {law.variable!r}"
    )
    if law.variable is None:
        return
    motion = random_motion(law, rng)
    other = random_motion(law, rng)
    columns = law.features(motion)
    changes = {"s": other.s, "v": other.v, "a": other.a}

    if law.variable in changes:
        changed = _with_channels(motion, {law.variable: changes.pop(law.variable)})
        assert not np.allclose(law.features(changed), columns), (
            f"{law}: the force does not follow {law.variable!r}"
        )
    if law.variable != "v":  # a force that opposes the rate may depend on the drift
        later = replace(motion, t=motion.t + 0.3, covariates=other.covariates)
        rest = _with_channels(later, changes)
        message = f"{law}: the force follows more than {law.variable!r}"
        _assert_close(law.features(rest), columns, message)
    if law.variable == "a":
        triple = law.features(replace(motion, a=3.0 * motion.a))
        _assert_close(triple, 3.0 * columns, f"{law}: is no inertia")
    if law.variable == "1":
        first = np.broadcast_to(columns[:1], columns.shape)
        _assert_close(columns, first, f"{law}: is not constant")


def check_saturation(law: ForceLaw, rng: np.random.Generator) -> None:
    """Under a monotonic drift, a law that saturates does so around its drift."""
    if not law.saturates_at:
        return
    assert law.saturates_at in law.shape, (
        f"{law}: saturates_at={law.saturates_at!r} is no shape parameter"
    )
    drift = law.saturation_drift
    multiples = np.linspace(0.0, 50.0, 5001)
    s = multiples * drift
    motion = Motion(
        s,
        v=np.full(len(s), s[-1] / PERIOD),
        a=0.0 * s,
        t=np.linspace(0.0, PERIOD, len(s)),
        covariates={name: np.ones(len(s)) for name in law.covariates},
    )
    columns = np.abs(law.features(motion))
    early = columns[np.searchsorted(multiples, 0.1)]
    late = columns[np.searchsorted(multiples, 30.0)]
    last = columns[-1]
    saturates = (early < 0.5 * last) & (np.abs(last - late) < 1e-3 * last)
    assert saturates.any(), f"{law}: does not saturate around {drift:.3g} m"


def check_signs(law: ForceLaw, rng: np.random.Generator) -> None:
    """Signs are stated for coefficients that the law has, and for each once."""
    symbols = {term.symbol for term in law.terms()}
    stated = law.nonnegative
    assert set(stated) <= symbols, f"{law}: signs are stated of {stated}"
    assert len(set(stated)) == len(stated), f"{law}: signs are stated of {stated}"
    for parameter in law.shapes:
        bound = parameter.friction_below
        assert bound is None or parameter.low <= bound <= parameter.high, (
            f"{law}: friction_below of {parameter.name} lies outside its bounds"
        )


def check_special_cases(law: ForceLaw, rng: np.random.Generator) -> None:
    """The law reproduces the force of each of its special cases within one percent."""
    for special, general in law.special_cases.items():
        simple = random_values(special(), rng)
        same = general(simple)
        assert law.contains(simple), f"{law}: does not contain {simple}"

        motion = random_motion(same, rng, n_samples=4000)
        # a state is fresh at the first sample
        expected = simple.force(motion)[1:]
        force = same.force(motion)[1:]
        gap = np.abs(force - expected).mean()
        assert gap <= 1e-2 * np.abs(expected).mean(), f"{same} is not {simple}"


# -- units, JSON, text ---------------------------------------------------------


def check_units(law: ForceLaw, rng: np.random.Generator) -> None:
    """In other units of length, time and mass the coefficients give the same force."""
    sizes = {"m": 3.7, "s": 0.6, "kg": 1.9, "[u]": 2.3, "1": 1.0}
    sizes["N"] = sizes["kg"] * sizes["m"] / sizes["s"] ** 2
    sizes["Hz"] = 1.0 / sizes["s"]

    motion = random_motion(law, rng)
    units = dict(zip(motion.covariates, covariate_units(law), strict=True))
    motion_in_other_units = Motion(
        motion.s * sizes["m"],
        motion.v * sizes["m"] / sizes["s"],
        motion.a * sizes["m"] / sizes["s"] ** 2,
        motion.t * sizes["s"],
        {c: x * _size(units[c], sizes, law) for c, x in motion.covariates.items()},
    )
    shape = {
        p.name: (law.shape[p.name] or 0.0) * _size(p.unit, sizes, law)
        for p in law.shapes
    }
    law_in_other_units = law.with_values(shape=shape)

    columns = law.features(motion) * _size(law.output, sizes, law)
    scaled = law_in_other_units.features(motion_in_other_units)
    for k, term in enumerate(law.terms()):
        message = (
            f"{law}: {term.symbol} has not the unit {term.unit}, or a shape parameter"
            " not its own"
        )
        column = scaled[:, k] * _size(term.unit, sizes, law)
        _assert_close(column, columns[:, k], message, tolerance=1e-6)


def check_json(law: ForceLaw, rng: np.random.Generator) -> None:
    """A round trip through JSON gives an equal law; a changed copy changes no other."""
    motion = random_motion(law, rng)
    copy = from_dict(json.loads(json.dumps(law.to_dict())))
    assert copy == law, f"{law}: is not equal to its copy by JSON"
    assert hash(copy) == hash(law), f"{law}: is not equal to its copy by JSON"
    assert np.array_equal(copy.force(motion), law.force(motion)), (
        f"{law}: its copy by JSON gives another force"
    )

    before = law.to_dict()
    shape = {name: 0.9 * (value or 0.0) for name, value in law.shape.items()}
    changed = law.with_values(law.values + 1.0, shape)
    assert changed != law, f"{law}: with_values changes nothing"
    assert law.to_dict() == before, f"{law}: with_values changes the law itself"
    assert np.array_equal(changed.values, law.values + 1.0), (
        f"{law}: with_values loses coefficients"
    )


def check_text(law: ForceLaw, rng: np.random.Generator) -> None:
    """Name, family, symbols and labels are present and unambiguous."""
    terms = law.terms()
    assert law.name.isidentifier() and law.family, f"{law}: name or family is missing"
    assert law.acts_at and set(law.acts_at) <= set(get_args(Place)), (
        f"{law}: acts_at is {law.acts_at}"
    )
    symbols = [term.symbol for term in terms]
    labels = [term.label for term in terms]
    assert _are_distinct(symbols), f"{law}: symbols {symbols} are not distinct"
    assert _are_distinct(labels), f"{law}: labels {labels} are not distinct"
    assert set(law.shape).isdisjoint(symbols), (
        f"{law}: a coefficient and a shape share a name"
    )
    assert type(law).__doc__, f"{type(law).__name__} has no documentation"


CHECKS: tuple[Callable[[ForceLaw, np.random.Generator], None], ...] = (
    check_features,
    check_large_arguments,
    check_single_samples,
    check_records,
    check_standstill,
    check_symmetry,
    check_energy,
    check_variable,
    check_saturation,
    check_signs,
    check_special_cases,
    check_units,
    check_json,
    check_text,
)


def check_law(law: ForceLaw, random_state: int = 0) -> None:
    """Check a law against the entire contract.

    Parameters
    ----------
    law : ForceLaw
        Its values do not matter; they are drawn from the search bounds.
    random_state : int
        Seed of the parameters and of the motion.

    Raises
    ------
    AssertionError
        If the law breaks the contract; the message states how.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> laws.check_law(laws.CoulombFriction())
    """
    for check in CHECKS:
        rng = generator(random_state)
        check(random_values(law, rng), rng)


# -- helpers -------------------------------------------------------------------


def _with_channels(motion: FullMotion, channels: dict[str, np.ndarray]) -> FullMotion:
    """A motion with other drifts, rates or accelerations."""
    return FullMotion(
        channels.get("s", motion.s),
        channels.get("v", motion.v),
        channels.get("a", motion.a),
        motion.t,
        motion.covariates,
    )


def _are_distinct(texts: list[str]) -> bool:
    return all(texts) and len(set(texts)) == len(texts)


def _assert_close(
    columns: np.ndarray,
    expected: np.ndarray,
    message: str,
    tolerance: float = 1e-10,
    scale: np.ndarray | None = None,
) -> None:
    """Assert that columns differ by a small share of their largest value at most."""
    size = np.abs(expected if scale is None else scale).max(axis=0)
    gap = np.abs(columns - expected)
    assert (gap <= tolerance * size).all(), f"{message} (by {np.max(gap):.3g})"


def _size(unit: str, sizes: dict[str, float], law: ForceLaw) -> float:
    """Size of a unit such as "N s^2/m^3" or "N/(m s)".

    An exponent may be a shape parameter.
    """
    numerator, *denominators = unit.split("/")
    value = _product_of_powers(numerator, sizes, law)
    for denominator in denominators:
        value /= _product_of_powers(denominator.strip("()"), sizes, law)
    return value


def _product_of_powers(text: str, sizes: dict[str, float], law: ForceLaw) -> float:
    value = 1.0
    for factor in text.split():
        base, _, power = factor.partition("^")
        exponent = law.shape.get(power) or float(power or 1.0)
        value *= sizes[base] ** exponent
    return value
