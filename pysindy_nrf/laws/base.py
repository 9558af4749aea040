"""The one contract of a force law.

A law is linear in its coefficients and may have shape parameters and an internal state
that depends on the path: ``R(t) = sum_k c_k phi_k(s, v, t; theta, z)``. Two plain
functions define it. They serve arrays (features, identification) and, compiled, single
samples (simulation, states).
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self

import numpy as np

from ..common import number_of
from ..exceptions import LawError
from .shape import Given, Motion, Shape


class Term(NamedTuple):
    """One column of a law.

    Attributes
    ----------
    symbol : str
        Name of the coefficient, e.g. ``"Fd"``.
    label : str
        The feature in plain text, e.g. ``"v^2 s"``; equal labels are equal columns.
    unit : str
        SI unit of the coefficient.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> [
    ...     (term.symbol, term.label, term.unit)
    ...     for term in laws.Duffing().terms()
    ... ]
    [('k', 's', 'N/m'), ('k3', 's^3', 'N/m^3')]
    """

    symbol: str
    label: str
    unit: str


_REGISTRY: dict[str, type[ForceLaw]] = {}


class ForceLaw:
    """Base of all force laws.

    A subclass states its name, terms, states and shape parameters as class attributes
    and writes ``kernel`` (and ``advance`` if it has an internal state). Features,
    identification, simulation, text and JSON follow from these. Its constructor takes
    the shape parameters and then the coefficients, all optional, by position or by
    name.

    A subclass may write its own constructor instead and pass the values to this one:

    Parameters
    ----------
    shape : mapping, optional
        Values of the shape parameters; None means "to be estimated".
    coefficients : mapping or sequence, optional
        Values of the coefficients by symbol, or in the order of the terms.

    Attributes
    ----------
    name, family : str
        E.g. ``"modified_dahl"`` of the family ``"hysteresis"``.
    columns : tuple of Term
        The terms of the law. A law whose terms depend on its options overrides
        :meth:`terms` instead.
    shapes : tuple of Shape
    n_states : int
        Number of internal states; they are zero at the start of every record.
    symmetry : {"odd", "even", "none"}
        Behaviour under (s, v) -> (-s, -v).
    at_rest : float or None
        Force at s = v = 0 from a fresh state for unit coefficients; None if it may not
        vanish.
    passive : bool
        Whether the law can only take energy out, or store it, for positive
        coefficients.
    uses_time, uses_acceleration : bool
        Whether the kernel reads t or a.
    acts_at : tuple of {"link", "ground", "new link", "two storeys", "dof", "sensor"}
        Sites at which a search tries the law: the links of the chain, a link between a
        DOF and the ground that the chain lacks, any link that the chain lacks, a DOF, a
        sensor.
    output : str
        SI unit of coefficient times term: a force, but for sensors
        (:mod:`pysindy_nrf.laws.sensor`).
    covariates : tuple of str
        Names of the covariates the kernel reads, in the order of ``u``.
    covariate_units : tuple of str
        Their SI units; ``"[u]"`` if the law takes a covariate of any unit.
    special_cases : mapping of law class to callable
        Laws that this one contains. The callable takes such a law, with values, and
        returns the law of this class with the same force, or a limit of it. If the
        special case explains most of what this law does, a search reports the special
        case. Its class must be constructible without arguments.
    variable : {"s", "v", "a", "1", None}
        The quantity that the force follows: the drift alone (springs, contacts), the
        rate, which it opposes (damping, friction), the relative acceleration, nothing
        (a constant); None for anything else.
    jumps : bool
        Whether the force jumps at a velocity reversal, as dry friction does (covariates
        being zero).
    nonnegative : tuple of str
        Coefficients, by symbol, that cannot be negative: otherwise the effect could
        only drive the structure, or is another than the law is named after.
    mimics_inertia : bool
        Whether the force can be mistaken for one proportional to the acceleration. Such
        a law is not tried if no force is measured, because it then reduces every
        balance to zero.
    permanent_change : bool
        Whether it is a permanent change at some time after the start of a record. It is
        tried in a single record only.
    superposes : bool
        Whether it is added to others of its family at one site, as external forces are,
        instead of replacing them.
    saturates_at : str
        Shape parameter that sets the drift beyond which the force no longer grows: the
        drift itself, m, or one over it, 1/m. A law that saturates within a small part
        of its drift is nearly dry friction.

    Notes
    -----
    ``kernel(s, v, a, t, u, z, theta, out)`` writes ``out[k]`` for each term k. It is
    written with NumPy ufuncs so that s, v, a, t may be arrays of shape (n_samples,)
    with u, z, out of shape (.., n_samples), or floats with u, z, out one-dimensional;
    numba compiles the second form.

    ``advance(z, s0, v0, s1, v1, dt, u, theta)`` moves the state from (s0, v0) to (s1,
    v1) along a path on which v keeps its sign, exactly where theory allows; it writes
    into z (floats only).

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> law = laws.CoulombFriction(20.0)
    >>> law.name, law.family, law.coefficients.tolist()
    ('coulomb_friction', 'friction', [20.0])
    >>> laws.Dahl().free_shape  # to be estimated
    ('sigma',)
    """

    name: ClassVar[str] = ""
    family: ClassVar[str] = ""
    columns: ClassVar[tuple[Term, ...]] = ()
    shapes: ClassVar[tuple[Shape, ...]] = ()
    n_states: ClassVar[int] = 0
    symmetry: ClassVar[str] = "odd"
    at_rest: ClassVar[float | None] = 0.0
    passive: ClassVar[bool] = False
    uses_time: ClassVar[bool] = False
    uses_acceleration: ClassVar[bool] = False
    acts_at: ClassVar[tuple[str, ...]] = ("link",)
    output: ClassVar[str] = "N"
    covariates: tuple[str, ...] = ()
    covariate_units: ClassVar[tuple[str, ...]] = ()
    special_cases: ClassVar[Mapping[type[ForceLaw], Callable[[Any], ForceLaw]]] = {}
    variable: ClassVar[str | None] = None
    jumps: ClassVar[bool] = False
    nonnegative: ClassVar[tuple[str, ...]] = ()
    mimics_inertia: ClassVar[bool] = False
    permanent_change: ClassVar[bool] = False
    superposes: ClassVar[bool] = False
    saturates_at: ClassVar[str] = ""

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        own = vars(cls)
        if "columns" in own and "__init__" not in own:
            cls.__init__ = _constructor(cls)  # type: ignore[method-assign]
        if not own.get("name"):
            return
        known = _REGISTRY.get(cls.name, cls)
        if (known.__module__, known.__qualname__) != (cls.__module__, cls.__qualname__):
            raise LawError(
                f"The name {cls.name!r} is taken by the law {known.__qualname__}",
                "Choose another name.",
            )
        _REGISTRY[cls.name] = cls

    if TYPE_CHECKING:  # the arguments depend on the subclass

        def __init__(self, *values: Any, **named: Any) -> None: ...

    else:

        def __init__(self, shape=None, coefficients=None):
            self.shape: dict[str, float | None] = {p.name: None for p in self.shapes}
            for key, value in dict(shape or {}).items():
                self.shape[key] = self._shape_value(key, value)
            self.coefficients: np.ndarray | None = self._coefficients(coefficients)

    shape: dict[str, float | None]
    coefficients: np.ndarray | None

    def terms(self) -> tuple[Term, ...]:
        """The terms of the law, one for each coefficient."""
        return self.columns

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        """Write the value of every term into ``out``; see the notes of
        :class:`ForceLaw`.

        Parameters
        ----------
        s, v, a, t : float or ndarray of shape (n_samples,)
            Drift (m), its rate (m/s), relative acceleration (m/s^2), time on the clock
            of the record (s).
        u : ndarray of shape (n_covariates, ...)
            Covariates, in the order of ``covariates``.
        z : ndarray of shape (n_states, ...)
            Internal states.
        theta : ndarray of shape (n_shapes,)
            Values of the shape parameters.
        out : ndarray of shape (n_terms, ...)
            Written to; for unit coefficients.
        """
        raise NotImplementedError

    @staticmethod
    def advance(z, s0, v0, s1, v1, dt, u, theta):
        """Move the internal state over one step; see the notes of :class:`ForceLaw`.

        Parameters
        ----------
        z : ndarray of shape (n_states,)
            Read and written.
        s0, v0, s1, v1 : float
            Drift (m) and rate (m/s) at both ends of the step.
        dt : float
            s.
        u : ndarray of shape (n_covariates,)
        theta : ndarray of shape (n_shapes,)
        """

    def options(self) -> dict:
        """Structural constructor arguments (not shape, not coefficients), for JSON and
        copies.
        """
        return {}

    def _number(self, key: str, value: Any) -> float | None:
        if value is None:
            return None
        number = number_of(value)
        if not np.isfinite(number):
            raise LawError(
                f"{type(self).__name__}: {key}={value!r} is not a finite number",
                "Give it in SI units.",
            )
        return number

    def _shape_value(self, key: str, value: Any) -> float | None:
        number = self._number(key, value)
        shape = next(p for p in self.shapes if p.name == key)
        if number is not None and shape.log and number <= 0.0:
            raise LawError(
                f"{type(self).__name__}: {key}={number:g} is not positive",
                f"Its unit is {shape.unit}.",
            )
        return number

    def _coefficients(self, values: Any) -> np.ndarray | None:
        if values is None:
            return None
        symbols = [term.symbol for term in self.terms()]
        if isinstance(values, Mapping):
            if all(v is None for v in values.values()):
                return None
            unknown = [k for k in values if k not in symbols]
            if unknown:
                cure = f"It has {', '.join(symbols)}."
                raise LawError(
                    f"{type(self).__name__} has no coefficient {unknown[0]!r}", cure
                )
            values = [values.get(symbol) or 0.0 for symbol in symbols]
        flat = np.ravel(np.asarray(values, dtype=object))
        numbers = np.array([self._number("coefficient", c) for c in flat], dtype=float)
        if len(numbers) != len(symbols):
            cure = f"Their order is {', '.join(symbols)}."
            raise LawError(
                f"{type(self).__name__} has {len(symbols)} coefficients, {len(numbers)}"
                " were given",
                cure,
            )
        return numbers

    @property
    def has_memory(self) -> bool:
        """True if the force depends on the path."""
        return self.n_states > 0

    @property
    def narrow_band(self) -> bool:
        """True if the force has one frequency whatever the motion: a constant or
        harmonic force.

        Examples
        --------
        >>> from pysindy_nrf import laws
        >>> (
        ...     laws.ConstantForce().narrow_band,
        ...     laws.HarmonicForce().narrow_band,
        ...     laws.CoulombFriction().narrow_band,
        ... )
        (True, True, False)
        """
        return self.variable == "1" or (
            self.uses_time and any(p.is_frequency for p in self.shapes)
        )

    @property
    def units(self) -> dict[str, str]:
        """Unit of every coefficient and shape parameter by its symbol; empty for a
        plain number.
        """
        both = [(term.symbol, term.unit) for term in self.terms()] + [
            (p.name, p.unit) for p in self.shapes
        ]
        return {name: "" if unit == "1" else unit for name, unit in both}

    @property
    def rate_dependent(self) -> bool:
        """True if a slower test along the same path gives another force: if time is in
        the unit of a parameter.

        Examples
        --------
        >>> from pysindy_nrf import laws
        >>> (
        ...     laws.CoulombFriction().rate_dependent,
        ...     laws.Dahl().rate_dependent,
        ...     laws.LinearViscous().rate_dependent,
        ... )
        (False, False, True)
        """
        return bool(self.covariates) or any(
            re.search(r"\bs\b|\bkg\b|Hz", unit) for unit in self.units.values()
        )

    @property
    def saturation_drift(self) -> float:
        """Drift beyond which the force no longer grows, m; infinite if it has no bound
        or the bound has no value yet.

        Examples
        --------
        >>> from pysindy_nrf import laws
        >>> (
        ...     laws.Dahl(1e4).saturation_drift,
        ...     laws.Jenkins(2e-4).saturation_drift,
        ...     laws.Jenkins().saturation_drift,
        ... )
        (0.0001, 0.0002, inf)
        """
        value = self.shape[self.saturates_at] if self.saturates_at else None
        if value is None:
            return np.inf
        inverse = (
            next(p for p in self.shapes if p.name == self.saturates_at).unit == "1/m"
        )
        return 1.0 / value if inverse else value

    def limit(self, drift: float, band: tuple[float, float]) -> str:
        """Family of simpler laws of which the law is a limit in some data; its own
        family if it is none.

        What saturates within a small part of the drift is dry friction in all but name.

        Parameters
        ----------
        drift : float
            Rms drift of the site, m.
        band : (float, float)
            Frequencies that the data tell, Hz.

        Examples
        --------
        >>> from pysindy_nrf import laws
        >>> [laws.Jenkins(uy=uy).limit(1e-3, (0.5, 20.0)) for uy in (1e-4, 1e-3)]
        ['friction', 'hysteresis']
        """
        near = (
            (self.shape[p.name], p.friction_below)
            for p in self.shapes
            if p.friction_below is not None
        )
        dry = self.saturation_drift < 0.3 * drift or any(
            (value or np.inf) < below for value, below in near
        )
        return "friction" if dry else self.family

    def contains(self, other: ForceLaw) -> bool:
        """True if another law is a special case of this one.

        If the drift keeps its sign, a function of the drift alone differs little from a
        constant. A constant therefore counts as its special case.

        Parameters
        ----------
        other : ForceLaw

        Examples
        --------
        >>> from pysindy_nrf import laws
        >>> friction = laws.CoulombFriction()
        >>> (
        ...     laws.StribeckFriction().contains(friction),
        ...     friction.contains(laws.StribeckFriction()),
        ... )
        (True, False)
        >>> laws.CubicStiffness().contains(laws.ConstantForce())
        True
        """
        constant = self.variable == "s" and other.variable == "1"
        return constant or isinstance(other, tuple(self.special_cases))

    @property
    def free_shape(self) -> tuple[str, ...]:
        """Shape parameters without a value, to be estimated."""
        return tuple(k for k, value in self.shape.items() if value is None)

    @property
    def theta(self) -> np.ndarray:
        """Parameters as the kernel reads them, shape (n_theta,)."""
        if self.free_shape:
            cure = "Set it, or let NRFRegressor estimate it."
            raise LawError(
                f"{type(self).__name__}: {', '.join(self.free_shape)} has no value",
                cure,
            )
        return np.array(list(self.shape.values()), dtype=float)

    @property
    def values(self) -> np.ndarray:
        """Coefficients in the order of the terms, shape (n_terms,), SI units; raises
        LawError if there are none.
        """
        if self.coefficients is None:
            raise LawError(
                f"{type(self).__name__} has no coefficients yet",
                "Fit a model, or set them.",
            )
        return self.coefficients

    @property
    def parameters(self) -> dict[str, float | None]:
        """Coefficients by symbol and shape parameters by name, SI units."""
        values = dict(self.shape)
        if self.coefficients is not None:
            values |= {
                t.symbol: float(c)
                for t, c in zip(self.terms(), self.coefficients, strict=True)
            }
        return values

    def with_values(
        self, coefficients: Any = None, shape: Mapping[str, float | None] | None = None
    ) -> Self:
        """A copy with other coefficients or shape parameters.

        Parameters
        ----------
        coefficients : array-like of shape (n_terms,), optional
            Unchanged if None.
        shape : mapping, optional
            Shape parameters to change.

        Raises
        ------
        LawError
            If the law has no such parameter, or cannot have such a value.
        """
        new = object.__new__(type(self))
        new.__dict__.update(self.__dict__)
        new.shape = dict(self.shape)
        for key, value in dict(shape or {}).items():
            if key not in new.shape:
                cure = f"It has {', '.join(new.shape) or 'none'}."
                raise LawError(
                    f"{type(self).__name__} has no shape parameter {key!r}", cure
                )
            new.shape[key] = new._shape_value(key, value)
        if coefficients is not None:
            new.coefficients = new._coefficients(coefficients)
        return new

    def features(self, motion: Motion, state: np.ndarray | None = None) -> np.ndarray:
        """Columns of the law along one contiguous record.

        Parameters
        ----------
        motion : Motion
        state : ndarray of shape (n_states,), optional
            Internal state at the first sample; it is moved to the last sample in place.
            Zero if None: the law starts fresh.

        Returns
        -------
        ndarray of shape (n_samples, n_terms)
            Column-major.

        Raises
        ------
        LawError
            If a shape parameter has no value or a covariate, time or acceleration is
            missing.
        """
        n = motion.n_samples
        u = np.empty((len(self.covariates), n))
        for row, name in enumerate(self.covariates):
            if name not in motion.covariates:
                raise LawError(
                    f"{type(self).__name__} needs the covariate {name!r}",
                    "Pass it in covariates=.",
                )
            u[row] = motion.covariates[name]
        if self.uses_time and motion.t is None:
            raise LawError(
                f"{type(self).__name__} needs the time of the samples",
                "Pass time= or dt=.",
            )
        if self.uses_acceleration and motion.a is None:
            raise LawError(
                f"{type(self).__name__} needs the acceleration at its site",
                "Pass it with the motion.",
            )
        theta = self.theta
        z = np.zeros((0, n))
        if self.n_states:
            from .memory import state_path  # loads numba

            z = state_path(self, motion, u, theta, state)
        a, t = (np.zeros(n) if x is None else x for x in (motion.a, motion.t))
        out = np.empty((len(self.terms()), n))
        self.kernel(motion.s, motion.v, a, t, u, z, theta, out)
        return out.T

    def force(self, motion: Motion) -> np.ndarray:
        """Force of the law along one contiguous record, (n_samples,), N; the motion as
        for :meth:`features`.
        """
        return self.features(motion) @ self.values

    def equation(self, index: int | str = "", digits: int = 4) -> str:
        """The law as text, in the manner of the paper's eq. (11a).

        Parameters
        ----------
        index : int or str
            Storey number appended to s and v.
        digits : int
            Significant digits.
        """
        pieces = []
        numbers = (
            self.coefficients
            if self.coefficients is not None
            else [None] * len(self.terms())
        )
        sparse = (
            len(self.terms()) > 2
            and self.coefficients is not None
            and np.any(self.coefficients)
        )
        for term, c in zip(self.terms(), numbers, strict=True):
            if sparse and c == 0:  # taken out by a sparse fit
                continue
            label = subscript(term.label, index)
            factor = term.symbol if c is None else f"{c:.{digits}g}"
            pieces.append(f"{factor} {label}" if label != "1" else factor)
        text = " + ".join(pieces).replace("+ -", "- ") or "0"
        held = (
            (k, value, self.units[k])
            for k, value in self.shape.items()
            if value is not None
        )
        known = [f"{k} = {value:.{digits}g} {unit}".rstrip() for k, value, unit in held]
        return text + (f"  ({', '.join(known)})" if known else "")

    def to_dict(self) -> dict:
        """Plain data for JSON."""
        return {
            "law": self.name,
            "options": self.options(),
            "shape": dict(self.shape),
            "coefficients": (
                None
                if self.coefficients is None
                else [float(c) for c in self.coefficients]
            ),
        }

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and other.to_dict() == self.to_dict()

    def __hash__(self) -> int:
        return hash(
            (
                type(self),
                *self.shape.values(),
                *(() if self.coefficients is None else self.coefficients),
            )
        )

    def __repr__(self) -> str:
        inside = [f"{k}={v!r}" for k, v in self.options().items()]
        inside += [f"{k}={v:g}" for k, v in self.shape.items() if v is not None]
        if self.coefficients is not None:
            inside += [
                f"{t.symbol}={c:.4g}"
                for t, c in zip(self.terms(), self.coefficients, strict=True)
            ]
        return f"{type(self).__name__}({', '.join(inside)})"


def _constructor(cls: type[ForceLaw]) -> Callable[..., None]:
    """The constructor of a law from its shape parameters and coefficients, in this
    order.
    """
    shapes, symbols = (
        [p.name for p in cls.shapes],
        [term.symbol for term in cls.columns],
    )
    kind = inspect.Parameter.POSITIONAL_OR_KEYWORD
    own = [
        inspect.Parameter(x, kind, default=None, annotation=float | None)
        for x in (*shapes, *symbols)
    ]
    signature = inspect.Signature([inspect.Parameter("self", kind), *own])

    def __init__(*values: Any, **named: Any) -> None:
        given = signature.bind(*values, **named).arguments
        ForceLaw.__init__(
            given.pop("self"),
            {k: given.get(k) for k in shapes},
            {k: given.get(k) for k in symbols},
        )

    __init__.__signature__ = signature  # type: ignore[attr-defined]
    return __init__


class CovariateLaw(ForceLaw):
    """Base of the laws of one covariate, whose name is an option."""

    def __init__(
        self,
        covariate: str,
        shape: Mapping[str, Given],
        coefficients: Mapping[str, Given],
    ) -> None:
        if not isinstance(covariate, str) or not covariate.strip():
            raise LawError(
                f"covariate={covariate!r} is not the name of a channel",
                "Give e.g. covariate='voltage'.",
            )
        self.covariates = (covariate,)
        super().__init__(shape, coefficients)

    def options(self) -> dict[str, Any]:
        """The name of the covariate."""
        return {"covariate": self.covariates[0]}


def subscript(label: str, index: int | str) -> str:
    """The label of a term with the storey number appended to every s, v, a, x and Z."""
    return re.sub(r"\b([svaxZ])\b", rf"\g<1>{index}", label) if index != "" else label


def registry() -> dict[str, type[ForceLaw]]:
    """All known laws by name, including those of the user.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> laws.registry()["coulomb_friction"]
    <class 'pysindy_nrf.laws.friction.CoulombFriction'>
    """
    return dict(_REGISTRY)


def asymmetric(law: type[ForceLaw]) -> type[ForceLaw]:
    """The same law with coefficients of its own in each direction.

    Each term becomes two: its positive part, whose coefficient has a ``p`` behind its
    symbol, and its negative part, with an ``m``. Add the result to the catalogue of a
    search, or declare it.

    Parameters
    ----------
    law : type of ForceLaw
        A class whose terms change their sign with the motion.

    Returns
    -------
    type of ForceLaw
        Named ``asymmetric_`` and the name of the law.

    Raises
    ------
    LawError
        If the law has options, or is not odd.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> friction = laws.asymmetric(laws.CoulombFriction)
    >>> print(friction(Fcp=20.0, Fcm=14.0).equation(1))
    20 max(sgn(v1), 0) + 14 min(sgn(v1), 0)
    """
    if (name := f"asymmetric_{law.name}") in _REGISTRY:
        return _REGISTRY[name]
    if (
        not law.columns
        or "__init__" in vars(law)
        and vars(law)["__init__"].__module__ != __name__
    ):
        raise LawError(
            f"{law.__name__} has options", "Write both directions as a law of your own."
        )
    if law.symmetry != "odd":
        raise LawError(
            f"{law.__name__} is not odd: it tells directions apart already",
            "Use it as it is.",
        )
    from numba.extending import register_jitable

    plain, n = register_jitable(law.kernel), len(law.columns)

    def kernel(s, v, a, t, u, z, theta, out):
        plain(s, v, a, t, u, z, theta, out)
        for k in range(n - 1, -1, -1):
            out[2 * k + 1] = np.minimum(out[k], 0.0)
            out[2 * k] = np.maximum(out[k], 0.0)

    sides = [("p", "max"), ("m", "min")]
    own = {
        key: value for key, value in vars(law).items() if not key.startswith("__")
    } | {
        "__doc__": f"{law.__name__} with coefficients of its own in each direction.",
        "__reduce__": lambda self: (from_dict, (self.to_dict(),)),
        "name": name,
        "columns": tuple(
            Term(x.symbol + end, f"{f}({x.label}, 0)", x.unit)
            for x in law.columns
            for end, f in sides
        ),
        "nonnegative": tuple(
            symbol + end for symbol in law.nonnegative for end, _ in sides
        ),
        "symmetry": "none",
        "special_cases": {
            law: lambda c: new(**c.shape).with_values(np.repeat(c.values, 2))
        },
        "kernel": staticmethod(kernel),
    }
    new: type[ForceLaw] = type(f"Asymmetric{law.__name__}", law.__bases__, own)
    return new


def from_dict(data: Mapping[str, Any]) -> ForceLaw:
    """Build a law from plain data.

    Parameters
    ----------
    data : mapping
        As written by :meth:`ForceLaw.to_dict`.

    Raises
    ------
    LawError
        If the law is unknown or its parameters do not fit.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> data = laws.Dahl(sigma=5e4, Fd=35.0).to_dict()
    >>> laws.from_dict(data)
    Dahl(sigma=50000, Fd=35)
    """
    try:
        name, options = data["law"], dict(data.get("options") or {})
        shape, coefficients = dict(data.get("shape") or {}), data.get("coefficients")
    except (KeyError, TypeError, ValueError) as error:
        cure = "It needs 'law', 'options', 'shape', 'coefficients'."
        raise LawError(f"{data!r} does not describe a law", cure) from error
    cls = _REGISTRY.get(name) if isinstance(name, str) else None
    if (
        cls is None
        and isinstance(name, str)
        and (plain := name.removeprefix("asymmetric_")) in _REGISTRY
    ):
        cls = asymmetric(_REGISTRY[plain])
    if cls is None:
        raise LawError(
            f"There is no law {name!r}", f"Known laws: {', '.join(sorted(_REGISTRY))}."
        )
    try:
        law = cls(**options)
    except TypeError as error:
        raise LawError(
            f"Law {name!r} cannot be built from {options!r}", str(error)
        ) from error
    return law.with_values(coefficients=coefficients, shape=shape)
