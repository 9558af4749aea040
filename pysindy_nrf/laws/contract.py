"""Checks of the contract of a force law.

:func:`check_law` runs them on any law, with random parameters and a random motion. A
check that fails raises ``AssertionError`` with a sentence.
"""

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from ..common import generator
from .base import ForceLaw, from_dict
from .friction import jump_at_reversal
from .shape import Motion

_PERIOD = 2.0  # s
_DRIFT = 0.01  # m


class _Whole(Motion):
    """A motion with accelerations and times."""

    a: np.ndarray
    t: np.ndarray


def covariate_units(law: ForceLaw) -> tuple[str, ...]:
    """Units of the covariates of a law, "[u]" by default."""
    return law.covariate_units or ("[u]",) * len(law.covariates)


def random_motion(
    law: ForceLaw, rng: np.random.Generator, n_periods: int = 2, n_samples: int = 500
) -> _Whole:
    """A smooth periodic motion with all channels that a law may read, large enough to
    close every gap.
    """
    t = np.arange(n_periods * n_samples + 1) * (_PERIOD / n_samples)
    order = np.arange(1, 4)[:, None]
    omega = 2 * np.pi * order / _PERIOD
    phase = omega * t + rng.uniform(0, 2 * np.pi, order.shape)
    size = 10 * _DRIFT * rng.uniform(0.5, 1.0, order.shape) / order**2
    covariates = {}
    for name, unit in zip(law.covariates, covariate_units(law), strict=True):
        wave = np.sin(3 * t + rng.uniform(0, 2 * np.pi))
        covariates[name] = 1.5 + wave if unit == "[u]" else 20 * _DRIFT * wave
    return _Whole(
        (size * np.sin(phase)).sum(axis=0),
        (size * omega * np.cos(phase)).sum(axis=0),
        (-size * omega**2 * np.sin(phase)).sum(axis=0),
        t,
        covariates,
    )


def random_values(law: ForceLaw, rng: np.random.Generator) -> ForceLaw:
    """A copy of a law with positive coefficients and with shape parameters from its
    search bounds.
    """
    shape = {}
    for parameter in law.shapes:
        low, high = parameter.bounds(
            drift=_DRIFT, rate=5 * _DRIFT, duration=2 * _PERIOD
        )
        shape[parameter.name] = (
            np.exp(rng.uniform(*np.log([low, high])))
            if parameter.log
            else rng.uniform(low, high)
        )
    return law.with_values(rng.uniform(1.0, 10.0, len(law.terms())), shape)


def check_features(law: ForceLaw, rng: np.random.Generator) -> None:
    """Features are finite float64 columns, one for each term, and the motion is
    unchanged.
    """
    motion = random_motion(law, rng)
    before = [
        np.copy(x)
        for x in (motion.s, motion.v, motion.a, motion.t, *motion.covariates.values())
    ]
    columns = law.features(motion)
    assert columns.shape == (
        motion.n_samples,
        len(law.terms()),
    ), f"{law}: features have shape {columns.shape}"
    assert columns.dtype == np.float64, f"{law}: features are {columns.dtype}"
    assert np.isfinite(columns).all(), f"{law}: features are not finite"
    for x, y in zip(
        before,
        (motion.s, motion.v, motion.a, motion.t, *motion.covariates.values()),
        strict=True,
    ):
        assert np.array_equal(x, y), f"{law}: the kernel changes the motion"


def check_large_arguments(law: ForceLaw, rng: np.random.Generator) -> None:
    """Motions of 1e-30 to 1e30 give finite features without a floating-point
    warning.
    """
    n = 200

    def wild() -> np.ndarray:
        return rng.choice([-1.0, 0.0, 1.0], n) * 10.0 ** rng.uniform(-30, 30, n)

    motion = Motion(
        wild(), wild(), wild(), np.arange(n) * 0.01, {c: wild() for c in law.covariates}
    )
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
    theta = law.theta
    u = np.array([motion.covariates[c] for c in law.covariates]).reshape(
        -1, motion.n_samples
    )
    z = (
        state_path(law, motion, u, theta)
        if law.n_states
        else np.zeros((0, motion.n_samples))
    )
    for how in ("on floats", "compiled"):
        kernel = compiled_kernel(law) if how == "compiled" else type(law).kernel
        for i in range(0, motion.n_samples, 29):
            sample = np.full(columns.shape[1], np.nan)
            s, v, a, t = (float(x[i]) for x in (motion.s, motion.v, motion.a, motion.t))
            kernel(
                s,
                v,
                a,
                t,
                np.ascontiguousarray(u[:, i]),
                np.ascontiguousarray(z[:, i]),
                theta,
                sample,
            )
            _close(
                sample,
                columns[i],
                f"{law}: the kernel {how} differs from the kernel on arrays",
                scale=columns,
            )


def check_standstill(law: ForceLaw, rng: np.random.Generator) -> None:
    """The force at zero drift and velocity is the stated one."""
    motion = random_motion(law, rng)
    zero = np.zeros(motion.n_samples)
    columns = law.features(replace(motion, s=zero, v=zero, a=zero))
    if law.at_rest is None:
        assert columns.any(), (
            f"{law}: at_rest is None, but the force vanishes at standstill"
        )
    else:
        expected = np.full(motion.n_samples, law.at_rest)
        _close(
            columns.sum(axis=1),
            expected,
            f"{law}: the force at standstill is not {law.at_rest}",
        )


def check_symmetry(law: ForceLaw, rng: np.random.Generator) -> None:
    """The mirrored motion gives the mirrored force, as the law states."""
    motion = random_motion(law, rng)
    columns = law.features(motion)
    mirrored = law.features(replace(motion, s=-motion.s, v=-motion.v, a=-motion.a))
    odd, even = (
        np.allclose(mirrored, sign * columns, rtol=1e-9, atol=0) for sign in (-1, 1)
    )
    found = "odd" if odd else "even" if even else "none"
    assert found == law.symmetry, (
        f"{law}: symmetry is {law.symmetry!r}, found {found!r}"
    )


def check_records(law: ForceLaw, rng: np.random.Generator) -> None:
    """Each record starts from a fresh state, also beside another; blocks that pass it
    on are as the whole record.
    """
    motion = random_motion(law, rng)
    columns = law.features(motion)
    k = motion.n_samples // 2 + 3
    state = np.zeros(law.n_states)
    first, last = _part(motion, slice(0, k + 1)), _part(motion, slice(k, None))
    _close(
        law.features(first, state),
        columns[: k + 1],
        f"{law}: the first block differs from the record",
    )
    _close(
        law.features(last, state),
        columns[k:],
        f"{law}: the last block differs from the record",
    )
    fresh = law.features(last)
    out = np.empty((len(law.terms()), 1))
    u = np.array([[x[0]] for x in last.covariates.values()]).reshape(-1, 1)
    law.kernel(
        last.s[:1],
        last.v[:1],
        last.a[:1],
        last.t[:1],
        u,
        np.zeros((law.n_states, 1)),
        law.theta,
        out,
    )
    _close(fresh[0], out[:, 0], f"{law}: a record does not start from a fresh state")
    _close(law.features(motion), columns, f"{law}: the law remembers an earlier record")
    both = law.features(Motion.joined([motion, last]))
    _close(
        both,
        np.vstack([columns, fresh]),
        f"{law}: two records side by side differ from each of them",
    )


def check_energy(law: ForceLaw, rng: np.random.Generator) -> None:
    """Over closed cycles a passive law gives no energy; a spring or an inertia also
    takes none.
    """
    motion = random_motion(law, rng, n_periods=4, n_samples=4000)
    force, v = law.features(motion)[:-1], motion.v[:-1, None]
    work, size = (force * v).mean(axis=0), np.abs(force).max(axis=0) * np.abs(v).mean()
    if law.passive:
        assert (work >= -1e-6 * size).all(), f"{law}: passive, but gives energy"
    if law.variable in ("s", "a"):
        assert (np.abs(work) <= 1e-6 * size).all(), (
            f"{law}: takes or gives energy over closed cycles"
        )


def check_variable(law: ForceLaw, rng: np.random.Generator) -> None:
    """The force follows the variable that the law states."""
    motion = random_motion(law, rng)
    columns = law.features(motion)
    other = random_motion(law, rng)
    changes: dict[str, dict[str, Any]] = {
        "s": {"s": other.s},
        "v": {"v": other.v},
        "a": {"a": other.a},
        "1": {},
    }
    assert law.variable in (None, *changes), f"{law}: variable is {law.variable!r}"
    if law.variable is None:
        return
    followed = law.variable == "1" or not np.allclose(
        law.features(replace(motion, **changes[law.variable])), columns
    )
    assert followed, f"{law}: the force does not follow {law.variable!r}"
    if (
        law.variable != "v"
    ):  # a force that opposes the rate may depend on the drift, too
        rest: dict[str, Any] = {
            "s": other.s,
            "v": other.v,
            "a": other.a,
            "t": motion.t + 0.3,
        }
        rest.pop(law.variable, None)
        what = f"{law}: the force follows more than {law.variable!r}"
        _close(
            law.features(replace(motion, **rest, covariates=other.covariates)),
            columns,
            what,
        )
    if law.variable == "a":
        _close(
            law.features(replace(motion, a=3.0 * motion.a)),
            3.0 * columns,
            f"{law}: is no inertia",
        )
    if law.variable == "1":
        _close(
            columns,
            np.broadcast_to(columns[:1], columns.shape),
            f"{law}: is not constant",
        )


def check_jumps(law: ForceLaw, rng: np.random.Generator) -> None:
    """The force jumps at velocity reversals if and only if the law states it."""
    near, wide = np.abs(jump_at_reversal(law, np.zeros(len(law.covariates)))).T
    found = bool(((near > 0.5 * wide) & (wide > 0)).any())
    assert found == law.jumps, f"{law}: jumps is {law.jumps}, found {found}"


def check_saturation(law: ForceLaw, rng: np.random.Generator) -> None:
    """Under a monotonic drift, a law that saturates does so around the stated drift."""
    if not law.saturates_at:
        return
    assert law.saturates_at in law.shape, (
        f"{law}: saturates_at={law.saturates_at!r} is no shape parameter"
    )
    drift = law.saturation_drift
    s = np.linspace(0.0, 50.0, 5001) * drift
    t = np.linspace(0.0, _PERIOD, len(s))
    covariates = {name: np.ones(len(s)) for name in law.covariates}
    columns = law.features(
        Motion(s, np.full(len(s), s[-1] / _PERIOD), 0.0 * s, t, covariates)
    )
    low, high, last = np.abs(
        columns[[10, 3000, 5000]]
    )  # at a tenth of the drift, at 30 and at 50 times it
    flat = (last > 0) & (low < 0.5 * last) & (np.abs(last - high) < 1e-3 * last)
    assert flat.any(), f"{law}: does not saturate around {drift:.3g} m"


def check_signs(law: ForceLaw, rng: np.random.Generator) -> None:
    """Signs are stated for coefficients that the law has, and for each once."""
    stated = law.nonnegative
    unknown = set(stated) - {term.symbol for term in law.terms()}
    assert not unknown and len(set(stated)) == len(stated), (
        f"{law}: signs are stated of {stated}"
    )
    low = [
        p.name
        for p in law.shapes
        if p.friction_below is not None and not p.low <= p.friction_below <= p.high
    ]
    assert not low, f"{law}: friction_below of {low} lies outside the bounds"


def check_special_cases(law: ForceLaw, rng: np.random.Generator) -> None:
    """The law reproduces the force of each of its special cases within one percent."""
    for special, general in law.special_cases.items():
        simple = random_values(special(), rng)
        same = general(simple)
        assert law.contains(simple), f"{law}: does not contain {simple}"
        motion = random_motion(same, rng, n_samples=4000)
        expected, found = (
            simple.force(motion)[1:],
            same.force(motion)[1:],
        )  # a state is fresh at the first sample
        apart = np.abs(found - expected).mean()
        assert apart <= 1e-2 * np.abs(expected).mean(), f"{same} is not {simple}"


def check_units(law: ForceLaw, rng: np.random.Generator) -> None:
    """In other units of length, time and mass the same coefficients give the same
    force.
    """
    motion = random_motion(law, rng)
    size = {"m": 3.7, "s": 0.6, "kg": 1.9, "[u]": 2.3, "1": 1.0}
    size["N"] = size["kg"] * size["m"] / size["s"] ** 2
    units = zip(motion.covariates.items(), covariate_units(law), strict=True)
    covariates = {c: x * _in(unit, size, law) for (c, x), unit in units}
    other = Motion(
        motion.s * size["m"],
        motion.v * size["m"] / size["s"],
        motion.a * size["m"] / size["s"] ** 2,
        motion.t * size["s"],
        covariates,
    )
    shape = {
        p.name: (law.shape[p.name] or 0.0) * _in(p.unit, size, law) for p in law.shapes
    }
    columns, scaled = law.features(motion), law.with_values(shape=shape).features(other)
    for k, term in enumerate(law.terms()):
        what = (
            f"{law}: {term.symbol} has not the unit {term.unit}, or a shape parameter"
            " not its own"
        )
        _close(
            scaled[:, k] * _in(term.unit, size, law),
            columns[:, k] * _in(law.output, size, law),
            what,
            1e-6,
        )


def check_json(law: ForceLaw, rng: np.random.Generator) -> None:
    """A round trip through JSON gives an equal law with the same force; a changed copy
    leaves the law unchanged.
    """
    motion = random_motion(law, rng)
    copy = from_dict(json.loads(json.dumps(law.to_dict())))
    assert copy == law and hash(copy) == hash(law), (
        f"{law}: is not equal to its copy by JSON"
    )
    assert np.array_equal(copy.force(motion), law.force(motion)), (
        f"{law}: its copy by JSON gives another force"
    )
    before = law.to_dict()
    changed = law.with_values(
        law.values + 1.0, {k: 0.9 * (x or 0.0) for k, x in law.shape.items()}
    )
    assert changed != law and law.to_dict() == before, (
        f"{law}: with_values changes the law itself"
    )
    assert np.array_equal(changed.values, law.values + 1.0), (
        f"{law}: with_values loses coefficients"
    )


def check_text(law: ForceLaw, rng: np.random.Generator) -> None:
    """Name, family, symbols and labels are present and unambiguous."""
    terms = law.terms()
    assert law.name.isidentifier() and law.family, f"{law}: name or family is missing"
    places = {"link", "ground", "new link", "two storeys", "dof", "sensor"}
    assert set(law.acts_at) <= places and law.acts_at, (
        f"{law}: acts_at is {law.acts_at}"
    )
    for field in ("symbol", "label"):
        texts = [getattr(term, field) for term in terms]
        assert len(set(texts)) == len(texts) and all(texts), (
            f"{law}: {field}s {texts} are not distinct"
        )
    assert not {term.symbol for term in terms} & set(law.shape), (
        f"{law}: a coefficient and a shape share a name"
    )
    assert type(law).__doc__, f"{type(law).__name__} has no documentation"


CHECKS: tuple[Callable[[ForceLaw, np.random.Generator], None], ...] = (
    check_features,
    check_large_arguments,
    check_single_samples,
    check_standstill,
    check_symmetry,
    check_records,
    check_energy,
    check_variable,
    check_jumps,
    check_units,
    check_saturation,
    check_signs,
    check_special_cases,
    check_json,
    check_text,
)


def check_law(law: ForceLaw, random_state: int = 0) -> None:
    """Check a law against the whole contract.

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


def _close(
    found: np.ndarray,
    expected: np.ndarray,
    what: str,
    tolerance: float = 1e-10,
    scale: np.ndarray | None = None,
) -> None:
    size = np.abs(expected if scale is None else scale).max(axis=0)
    gap = np.abs(found - expected)
    assert (gap <= tolerance * size).all(), f"{what} (by {np.max(gap):.3g})"


def _part(motion: _Whole, rows: slice) -> _Whole:
    covariates = {c: x[rows] for c, x in motion.covariates.items()}
    return _Whole(
        motion.s[rows], motion.v[rows], motion.a[rows], motion.t[rows], covariates
    )


def _in(unit: str, size: dict[str, float], law: ForceLaw) -> float:
    """Size of a unit such as "N s^2/m^3" or "N/(m s)"; an exponent may be a shape
    parameter.
    """
    value = 1.0
    for k, part in enumerate(unit.split("/")):
        for factor in part.strip("()").split():
            base, _, power = factor.partition("^")
            exponent = float((law.shape[power] if power in law.shape else power) or 1.0)
            value *= size[base] ** (exponent if k == 0 else -exponent)
    return value
