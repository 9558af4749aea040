"""The contract of a force law.

A law is linear in its coefficients and may have shape parameters and an internal state
that depends on the path: ``R(t) = sum_k c_k phi_k(s, v, t; theta, z)``. Two plain
functions define it. They serve arrays (features, identification) and, compiled, single
samples (simulation, states).
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping
from typing import (
    TYPE_CHECKING,
    ClassVar,
    Literal,
    NamedTuple,
    NotRequired,
    Self,
    TypedDict,
)

import numpy as np
import numpy.typing as npt

from ..common import number_of
from ..exceptions import LawError
from .shape import Motion, Shape

Symmetry = Literal["odd", "even", "none"]
Variable = Literal["s", "v", "a", "1"]
Place = Literal["link", "ground", "new link", "two storeys", "dof", "sensor"]
# What kind of thing an effect is, whatever its name.
EffectClass = Literal[
    "memoryless",  # a function of drift and rate
    "hysteresis",
    "change in time",
    "inertial",
    "tie",  # where the chain has no link
    "outside force",
    "sensor error",
]

# Coefficients by symbol, or in the order of the terms; None: to be estimated.
Coefficients = npt.ArrayLike | Mapping[str, float | None] | None

# A law whose force no longer grows beyond this share of the rms drift is nearly dry
# friction: it saturates early in each half cycle.
DRY_BELOW_SHARE_OF_DRIFT = 0.3


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


class LawData(TypedDict):
    """A law as plain data."""

    law: str
    options: NotRequired[dict[str, object]]
    shape: NotRequired[dict[str, float | None]]
    coefficients: NotRequired[list[float] | None]


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
    covariates : tuple of str
        Names of the covariates the kernel reads, in the order of ``u``.
    covariate_units : tuple of str
        Their SI units; ``"[u]"`` if the law takes a covariate of any unit.
    uses_time, uses_acceleration : bool
        Whether the kernel reads t or a.
    output : str
        SI unit of coefficient times term: a force, except for sensors
        (:mod:`pysindy_nrf.laws.sensor`).
    symmetry : {"odd", "even", "none"}
        Behaviour under (s, v) -> (-s, -v).
    at_rest : float or None
        Force at s = v = 0 from a fresh state for unit coefficients; None if it may not
        vanish.
    passive : bool
        Whether the law can only take energy out, or store it, for positive
        coefficients.
    variable : {"s", "v", "a", "1", None}
        The quantity that the force follows: the drift alone (springs, contacts), the
        rate, which it opposes (damping, friction), the relative acceleration, nothing
        (a constant); None for anything else.
    nonnegative : tuple of str
        Coefficients, by symbol, that cannot be negative: otherwise the effect could
        only drive the structure, or is another than the law is named after.
    saturates_at : str
        Shape parameter that sets the drift beyond which the force no longer grows: the
        drift itself, m, or one over it, 1/m.
    special_cases : mapping of law class to callable
        Laws that this one contains. The callable takes such a law, with values, and
        returns the law of this class with the same force, or a limit of it. If the
        special case explains most of what this law does, a search reports the special
        case. Its class must be constructible without arguments.
    acts_at : tuple of {"link", "ground", "new link", "two storeys", "dof", "sensor"}
        Sites at which a search tries the law: the links of the chain, a DOF, or a
        sensor. Also links that the chain lacks: from a DOF to the ground, between any
        two DOFs, or over two storeys.
    superposes : bool
        Whether it is added to others of its family at one site, as external forces are,
        instead of replacing them.
    mimics_inertia : bool
        Whether the force can be mistaken for one proportional to the acceleration. Such
        a law is not tried if no force is measured, because it then reduces every
        balance to zero.
    permanent_change : bool
        Whether it is a permanent change at some time after the start of a record. It is
        tried in a single record only.
    stands_for : {"memoryless", "hysteresis", "change in time", "inertial", "tie", \
"outside force", "sensor error"}, optional
        Class of the effects that the law names; see :attr:`effect_class`.

    Notes
    -----
    The attributes from ``name`` to ``output`` define the law. Those from ``symmetry``
    to ``special_cases`` are promises about its force, which
    :func:`~pysindy_nrf.laws.check_law` tests. The last four say where a search tries
    it.

    ``kernel(s, v, a, t, u, z, theta, out)`` writes ``out[k]`` for each term k. It is
    written with NumPy ufuncs so that s, v, a, t may be arrays of shape (n_samples,)
    with u, z, out of shape (.., n_samples), or floats with u, z, out one-dimensional;
    numba compiles the second form.

    ``advance(z, s0, v0, s1, v1, dt, u, theta)`` moves the state from (s0, v0) to (s1,
    v1) along a path on which v keeps its sign, exactly where theory allows; it writes
    into z (floats only).

    Both may call plain functions of their module.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> law = laws.CoulombFriction(20.0)
    >>> law.name, law.family, law.coefficients.tolist()
    ('coulomb_friction', 'friction', [20.0])
    >>> laws.Dahl().free_shape  # to be estimated
    ('sigma',)
    """

    # what defines the law
    name: ClassVar[str] = ""
    family: ClassVar[str] = ""
    columns: ClassVar[tuple[Term, ...]] = ()
    shapes: ClassVar[tuple[Shape, ...]] = ()
    n_states: int = 0
    covariates: tuple[str, ...] = ()
    covariate_units: tuple[str, ...] = ()
    uses_time: ClassVar[bool] = False
    uses_acceleration: ClassVar[bool] = False
    output: ClassVar[str] = "N"

    # what it promises
    symmetry: Symmetry = "odd"
    at_rest: float | None = 0.0
    passive: bool = False
    variable: ClassVar[Variable | None] = None
    nonnegative: tuple[str, ...] = ()
    saturates_at: ClassVar[str] = ""
    special_cases: ClassVar[Mapping[type[ForceLaw], Callable[..., ForceLaw]]] = {}

    # where a search tries it
    acts_at: ClassVar[tuple[Place, ...]] = ("link",)
    superposes: ClassVar[bool] = False
    mimics_inertia: ClassVar[bool] = False
    permanent_change: ClassVar[bool] = False
    stands_for: ClassVar[EffectClass | None] = None

    # values of one law
    shape: dict[str, float | None]
    coefficients: np.ndarray | None

    def __init_subclass__(cls, **kwargs: object) -> None:
        super().__init_subclass__(**kwargs)
        stated = vars(cls)
        if "columns" in stated and "__init__" not in stated:
            cls.__init__ = _constructor(cls)  # type: ignore[method-assign]
        if stated.get("name"):
            _register(cls)

    if TYPE_CHECKING:  # the arguments depend on the subclass

        def __init__(self, *values: object, **named: object) -> None: ...

    else:

        def __init__(self, shape=None, coefficients=None):
            self.shape = {parameter.name: None for parameter in self.shapes}
            for name, value in dict(shape or {}).items():
                self.shape[name] = self._shape_value(name, value)
            self.coefficients = self._coefficients(coefficients)

    # -- what a subclass writes ----------------------------------------------------

    def terms(self) -> tuple[Term, ...]:
        """The terms of the law, one for each coefficient."""
        return self.columns

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        """Write the value of every term into ``out``.

        See the notes of :class:`ForceLaw`.

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

    def options(self) -> dict[str, object]:
        """Arguments of the constructor that are no parameters, for JSON and copies."""
        return {}

    # -- facts that follow ---------------------------------------------------------

    @property
    def has_memory(self) -> bool:
        """True if the force depends on the path."""
        return self.n_states > 0

    @property
    def effect_class(self) -> EffectClass:
        """Class of the effects that the law names.

        A search finds the class of an effect first, and then its closest name there.
        Where ``stands_for`` does not say it, a law with memory is a hysteresis, any
        other is memoryless.

        Examples
        --------
        >>> from pysindy_nrf import laws
        >>> laws.Dahl().effect_class, laws.CubicStiffness().effect_class
        ('hysteresis', 'memoryless')
        >>> laws.Inerter().effect_class
        'inertial'
        """
        if self.stands_for is not None:
            return self.stands_for
        return "hysteresis" if self.has_memory else "memoryless"

    @property
    def narrow_band(self) -> bool:
        """True if the force has one frequency whatever the motion.

        So have a constant and a harmonic force.

        Examples
        --------
        >>> from pysindy_nrf import laws
        >>> laws.ConstantForce().narrow_band, laws.HarmonicForce().narrow_band
        (True, True)
        >>> laws.CoulombFriction().narrow_band
        False
        """
        if self.variable == "1":
            return True
        return self.uses_time and any(p.is_frequency for p in self.shapes)

    @property
    def rate_dependent(self) -> bool:
        """True if a slower test along the same path gives another force.

        Then the unit of a parameter contains the time.

        Examples
        --------
        >>> from pysindy_nrf import laws
        >>> laws.CoulombFriction().rate_dependent, laws.Dahl().rate_dependent
        (False, False)
        >>> laws.LinearViscous().rate_dependent
        True
        """
        if self.covariates:
            return True
        return any(re.search(r"\bs\b|\bkg\b|Hz", unit) for unit in self.units.values())

    @property
    def units(self) -> dict[str, str]:
        """Unit of every coefficient and shape parameter; empty for a plain number."""
        units = {term.symbol: term.unit for term in self.terms()}
        units |= {parameter.name: parameter.unit for parameter in self.shapes}
        return {name: "" if unit == "1" else unit for name, unit in units.items()}

    @property
    def saturation_drift(self) -> float:
        """Drift beyond which the force no longer grows, m.

        Infinite if the force has no bound, or its shape parameter no value yet.

        Examples
        --------
        >>> from pysindy_nrf import laws
        >>> laws.Dahl(1e4).saturation_drift, laws.Jenkins(2e-4).saturation_drift
        (0.0001, 0.0002)
        >>> laws.Jenkins().saturation_drift
        inf
        """
        value = self.shape.get(self.saturates_at)
        if value is None:
            return np.inf
        return 1.0 / value if self.units[self.saturates_at] == "1/m" else value

    def limit(self, drift: float, band: tuple[float, float]) -> str:
        """Family of simpler laws of which the law is a limit in some data.

        What saturates within a small part of the drift is dry friction in all but name.

        Parameters
        ----------
        drift : float
            Rms drift of the site, m.
        band : (float, float)
            Frequencies that the data contain, Hz.

        Returns
        -------
        str
            The law's own family if it is no such limit.

        Examples
        --------
        >>> from pysindy_nrf import laws
        >>> [laws.Jenkins(uy=uy).limit(1e-3, (0.5, 20.0)) for uy in (1e-4, 1e-3)]
        ['friction', 'hysteresis']
        """
        if self.saturation_drift < DRY_BELOW_SHARE_OF_DRIFT * drift:
            return "friction"
        for parameter in self.shapes:
            value = self.shape[parameter.name]
            bound = parameter.friction_below
            if value is not None and bound is not None and value < bound:
                return "friction"
        return self.family

    def contains(self, other: ForceLaw) -> bool:
        """True if another law is a special case of this one.

        Special cases of its special cases count. If the drift keeps its sign, a
        function of the drift alone differs little from a constant, which therefore
        counts, too.

        Parameters
        ----------
        other : ForceLaw

        Examples
        --------
        >>> from pysindy_nrf import laws
        >>> friction = laws.CoulombFriction()
        >>> laws.StribeckFriction().contains(friction)
        True
        >>> friction.contains(laws.StribeckFriction())
        False
        >>> laws.CubicStiffness().contains(laws.ConstantForce())
        True
        """
        if self.variable == "s" and other.variable == "1":
            return True
        for case in self.special_cases:
            if isinstance(other, case) or case().contains(other):
                return True
        return False

    # -- values --------------------------------------------------------------------

    @property
    def free_shape(self) -> tuple[str, ...]:
        """Shape parameters without a value, to be estimated."""
        return tuple(name for name, value in self.shape.items() if value is None)

    @property
    def theta(self) -> np.ndarray:
        """Parameters as the kernel reads them, shape (n_theta,)."""
        if self.free_shape:
            raise LawError(
                f"{type(self).__name__}: {', '.join(self.free_shape)} has no value",
                "Set it, or let NRFRegressor estimate it.",
            )
        return np.array(list(self.shape.values()), dtype=float)

    @property
    def values(self) -> np.ndarray:
        """Coefficients in the order of the terms, shape (n_terms,), SI units.

        Raises
        ------
        LawError
            If there are none.
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
        parameters = dict(self.shape)
        if self.coefficients is not None:
            symbols = [term.symbol for term in self.terms()]
            parameters |= dict(zip(symbols, self.coefficients.tolist(), strict=True))
        return parameters

    def with_values(
        self,
        coefficients: Coefficients = None,
        shape: Mapping[str, float | None] | None = None,
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
        new_shape = dict(self.shape)
        for name, value in dict(shape or {}).items():
            new_shape[name] = self._shape_value(name, value)
        new_coefficients = self.coefficients
        if coefficients is not None:
            new_coefficients = self._coefficients(coefficients)

        values = {"shape": new_shape, "coefficients": new_coefficients}
        new = object.__new__(type(self))
        vars(new).update(vars(self) | values)
        return new

    def _number(self, name: str, value: object) -> float | None:
        """A finite number, or None."""
        if value is None:
            return None
        number = number_of(value)
        if not np.isfinite(number):
            raise LawError(
                f"{type(self).__name__}: {name}={value!r} is not a finite number",
                "Give it in SI units.",
            )
        return number

    def _shape_value(self, name: str, value: object) -> float | None:
        parameters = {parameter.name: parameter for parameter in self.shapes}
        if name not in parameters:
            raise LawError(
                f"{type(self).__name__} has no shape parameter {name!r}",
                f"It has {', '.join(parameters) or 'none'}.",
            )
        number = self._number(name, value)
        parameter = parameters[name]
        if number is not None and parameter.log and number <= 0.0:
            raise LawError(
                f"{type(self).__name__}: {name}={number:g} is not positive",
                f"Its unit is {parameter.unit}.",
            )
        return number

    def _coefficients(self, values: object) -> np.ndarray | None:
        """Coefficients in the order of the terms; None if all are to be estimated."""
        if values is None:
            return None
        symbols = [term.symbol for term in self.terms()]
        if isinstance(values, Mapping):
            if all(value is None for value in values.values()):
                return None
            values = self._in_order(values, symbols)

        flat = np.ravel(np.asarray(values, dtype=object))
        numbers = [self._number("coefficient", value) for value in flat]
        if len(numbers) != len(symbols):
            raise LawError(
                f"{type(self).__name__} has {len(symbols)} coefficients, {len(numbers)}"
                " were given",
                f"Their order is {', '.join(symbols)}.",
            )
        return np.array(numbers, dtype=float)

    def _in_order(
        self, values: Mapping[str, object], symbols: list[str]
    ) -> list[object]:
        """Coefficients given by symbol; those that are missing are zero."""
        for symbol in values:
            if symbol not in symbols:
                raise LawError(
                    f"{type(self).__name__} has no coefficient {symbol!r}",
                    f"It has {', '.join(symbols)}.",
                )
        return [values.get(symbol) or 0.0 for symbol in symbols]

    # -- features and forces -------------------------------------------------------

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
        u = self.covariate_rows(motion)
        self._require_channels(motion)
        theta = self.theta

        n_samples = motion.n_samples
        z = np.zeros((0, n_samples))
        if self.n_states:
            from .memory import state_path  # loads numba

            z = state_path(self, motion, u, theta, state)

        a = np.zeros(n_samples) if motion.a is None else motion.a
        t = np.zeros(n_samples) if motion.t is None else motion.t
        out = np.empty((len(self.terms()), n_samples))
        self.kernel(motion.s, motion.v, a, t, u, z, theta, out)
        return out.T

    def covariate_rows(self, motion: Motion) -> np.ndarray:
        """Covariates along a motion, as the kernel reads them.

        Parameters
        ----------
        motion : Motion

        Returns
        -------
        ndarray of shape (n_covariates, n_samples)

        Raises
        ------
        LawError
            If one is missing.
        """
        u = np.empty((len(self.covariates), motion.n_samples))
        for row, name in enumerate(self.covariates):
            if name not in motion.covariates:
                raise LawError(
                    f"{type(self).__name__} needs the covariate {name!r}",
                    "Pass it in covariates=.",
                )
            u[row] = motion.covariates[name]
        return u

    def _require_channels(self, motion: Motion) -> None:
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

    def force(self, motion: Motion) -> np.ndarray:
        """Force of the law along a motion, (n_samples,), N; see :meth:`features`."""
        return self.features(motion) @ self.values

    # -- text and plain data -------------------------------------------------------

    def equation(
        self,
        index: int | str = "",
        digits: int = 4,
        unit_of: Callable[[str], str] = str,
    ) -> str:
        """The law as text, in the manner of the paper's eq. (11a).

        Parameters
        ----------
        index : int or str
            Storey number appended to s and v.
        digits : int
            Significant digits.
        unit_of : callable
            Gives the unit that is printed for one of N, m and kg.
        """
        sum_of_terms = " + ".join(self._term_texts(index, digits)) or "0"
        text = sum_of_terms.replace("+ -", "- ")
        shape = self._shape_texts(digits, unit_of)
        return f"{text}  ({', '.join(shape)})" if shape else text

    def _term_texts(self, index: int | str, digits: int) -> list[str]:
        terms = self.terms()
        if self.coefficients is None:
            return [_product(x.symbol, subscript(x.label, index)) for x in terms]

        # a sparse fit of many terms sets most of them to zero
        omits_zeros = len(terms) > 2 and np.any(self.coefficients)
        return [
            _product(f"{value:.{digits}g}", subscript(term.label, index))
            for term, value in zip(terms, self.coefficients, strict=True)
            if value != 0 or not omits_zeros
        ]

    def _shape_texts(self, digits: int, unit_of: Callable[[str], str]) -> list[str]:
        return [
            f"{name} = {value:.{digits}g} {unit_of(self.units[name])}".rstrip()
            for name, value in self.shape.items()
            if value is not None
        ]

    def to_dict(self) -> LawData:
        """Plain data for JSON."""
        values = None if self.coefficients is None else self.coefficients.tolist()
        return {
            "law": self.name,
            "options": self.options(),
            "shape": dict(self.shape),
            "coefficients": values,
        }

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and other.to_dict() == self.to_dict()

    def __hash__(self) -> int:
        values = () if self.coefficients is None else tuple(self.coefficients)
        return hash((type(self), tuple(self.shape.values()), values))

    def __repr__(self) -> str:
        arguments = [f"{name}={value!r}" for name, value in self.options().items()]
        arguments += [f"{k}={x:g}" for k, x in self.shape.items() if x is not None]
        if self.coefficients is not None:
            for term, value in zip(self.terms(), self.coefficients, strict=True):
                arguments.append(f"{term.symbol}={value:.4g}")
        return f"{type(self).__name__}({', '.join(arguments)})"


class CovariateLaw(ForceLaw):
    """Base of the laws of one covariate, whose name is an option."""

    def __init__(
        self,
        covariate: str,
        shape: Mapping[str, float | None],
        coefficients: Mapping[str, float | None],
    ) -> None:
        if not isinstance(covariate, str) or not covariate.strip():
            raise LawError(
                f"covariate={covariate!r} is not the name of a channel",
                "Give e.g. covariate='voltage'.",
            )
        self.covariates = (covariate,)
        super().__init__(shape, coefficients)

    def options(self) -> dict[str, object]:
        """The name of the covariate."""
        return {"covariate": self.covariates[0]}


def _constructor(cls: type[ForceLaw]) -> Callable[..., None]:
    """Constructor that takes shape parameters and then coefficients, in this order."""
    shape_names = [parameter.name for parameter in cls.shapes]
    symbols = [term.symbol for term in cls.columns]

    kind = inspect.Parameter.POSITIONAL_OR_KEYWORD
    arguments = [inspect.Parameter("self", kind)]
    for name in [*shape_names, *symbols]:
        arguments.append(
            inspect.Parameter(name, kind, default=None, annotation=float | None)
        )
    signature = inspect.Signature(arguments)

    def __init__(*values: object, **named: object) -> None:
        bound = signature.bind(*values, **named).arguments
        ForceLaw.__init__(
            bound["self"],
            {name: bound.get(name) for name in shape_names},
            {symbol: bound.get(symbol) for symbol in symbols},
        )

    __init__.__signature__ = signature  # type: ignore[attr-defined]
    return __init__


def subscript(label: str, index: int | str) -> str:
    """The label of a term with the storey number appended to every s, v, a, x and Z."""
    if index == "":
        return label
    return re.sub(r"\b([svaxZ])\b", rf"\g<1>{index}", label)


def _product(factor: str, label: str) -> str:
    return factor if label == "1" else f"{factor} {label}"


# -- the registry --------------------------------------------------------------


def _register(cls: type[ForceLaw]) -> None:
    """Make a law known by its name; a class that is defined anew replaces itself."""
    known = _REGISTRY.get(cls.name, cls)
    if (known.__module__, known.__qualname__) != (cls.__module__, cls.__qualname__):
        raise LawError(
            f"The name {cls.name!r} is taken by the law {known.__qualname__}",
            "Choose another name.",
        )
    _REGISTRY[cls.name] = cls


def registry() -> dict[str, type[ForceLaw]]:
    """All known laws by name, including those of the user.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> laws.registry()["coulomb_friction"]
    <class 'pysindy_nrf.laws.friction.CoulombFriction'>
    """
    return dict(_REGISTRY)


def from_dict(data: LawData) -> ForceLaw:
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
        name = data["law"]
        options = dict(data.get("options") or {})
        shape = dict(data.get("shape") or {})
        coefficients = data.get("coefficients")
    except (KeyError, TypeError, ValueError) as error:
        raise LawError(
            f"{data!r} does not describe a law",
            "It needs 'law', 'options', 'shape', 'coefficients'.",
        ) from error

    cls = _law_class(name)
    try:
        law = cls(**options)
    except TypeError as error:
        raise LawError(
            f"Law {name!r} cannot be built from {options!r}", str(error)
        ) from error
    return law.with_values(coefficients=coefficients, shape=shape)


def _law_class(name: object) -> type[ForceLaw]:
    """The class of a law by its name, or the asymmetric one of a known law."""
    from .asymmetric import PREFIX, asymmetric  # imports this module

    if isinstance(name, str):
        if name in _REGISTRY:
            return _REGISTRY[name]
        if name.removeprefix(PREFIX) in _REGISTRY:
            return asymmetric(_REGISTRY[name.removeprefix(PREFIX)])
    known = ", ".join(sorted(_REGISTRY))
    raise LawError(f"There is no law {name!r}", f"Known laws: {known}.", "laws")
