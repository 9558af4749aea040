"""What is known of masses, coefficients and shape parameters before a test."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..chain.structure import Chain
from ..common import number_of
from ..exceptions import ChainError

__all__ = ["Parameter"]

_EXAMPLE = 'Give e.g. {"m2": Parameter(12.0), "storey *: v": Parameter(lower=0.0)}.'


@dataclass(frozen=True)
class Parameter:
    """What is known of a mass, a coefficient, a shape parameter, or a sum of them.

    Passed to :class:`~pysindy_nrf.NRFRegressor` as ``constraints={name: Parameter}``.
    Names are those in the table of intervals: ``"m2"``, ``"storey 1: s"``. A ``*``
    stands for any text: ``"storey *: s"`` are the stiffnesses of all storeys. A sum is
    written with plus signs: ``"m1 + m2"``.

    Parameters
    ----------
    value : float, optional
        Its value, SI units; exact unless ``spread`` is given.
    spread : float, optional
        Standard deviation of ``value``, as from drawings. Only for records in which
        some floor has no sensor.
    lower, upper : float
        Bounds. Only for records in which every floor has a sensor.
    equal_to : str, optional
        Name of a parameter that has the same value.

    Raises
    ------
    ChainError
        If these contradict each other.

    Examples
    --------
    A frame whose three floors weigh 30 kg together, without negative dampers:

    >>> from pysindy_nrf import NRFRegressor, Parameter, datasets
    >>> known = {
    ...     "m1 + m2 + m3": Parameter(30.0),
    ...     "storey *: v": Parameter(lower=0.0),
    ... }
    >>> model = NRFRegressor(constraints=known).fit(datasets.load_demo())
    >>> round(float(model.masses_.sum()), 6)
    30.0
    """

    value: float | None = None
    spread: float | None = None
    lower: float = -np.inf
    upper: float = np.inf
    equal_to: str | None = None

    def __post_init__(self) -> None:
        numbers = [self.lower, self.upper]
        if self.value is not None:
            numbers.append(self.value)
        if any(np.isnan(number_of(number)) for number in numbers):
            raise ChainError(f"{self!r} has a value that is no number", "Give numbers.")
        if self.value is not None and self.equal_to is not None:
            raise ChainError(f"{self!r} has a value and a tie", "Give one of them.")
        if self.spread is not None and (
            self.value is None or not 0 < number_of(self.spread) < np.inf
        ):
            raise ChainError(
                f"{self!r} has a spread that is not the standard deviation of a value",
                "Give a positive spread, and the value.",
            )
        if not self.lower <= self.upper:
            raise ChainError(
                f"{self!r} has a lower bound above the upper one", "Exchange them."
            )

    @property
    def bounded(self) -> bool:
        """Whether there is a lower or an upper bound."""
        return self.lower > -np.inf or self.upper < np.inf

    def __str__(self) -> str:
        if self.equal_to is not None:
            return f"= {self.equal_to}"
        if self.spread is not None:
            return f"= {self.value:g} +- {self.spread:g}"
        if self.value is not None:
            return f"= {self.value:g}"
        return f"from {self.lower:g} to {self.upper:g}"


Known = Mapping[str, Parameter]


@dataclass(frozen=True)
class LinearEquations:
    """Linear equations of parameters, ``factors @ parameters = values``.

    Attributes
    ----------
    factors : ndarray of shape (n_equations, n_parameters)
    values : ndarray of shape (n_equations,)
    spreads : ndarray of shape (n_equations,)
        Standard deviations of the values; zero if they are exact.
    """

    factors: np.ndarray
    values: np.ndarray
    spreads: np.ndarray

    def only(self, rows: np.ndarray) -> LinearEquations:
        """Some of the equations."""
        return LinearEquations(
            self.factors[rows], self.values[rows], self.spreads[rows]
        )


def as_parameters(constraints: object) -> dict[str, Parameter]:
    """What was passed as ``constraints=``, by name."""
    if constraints is None:
        return {}
    if not isinstance(constraints, Mapping):
        raise ChainError(
            f"constraints={constraints!r} is not a mapping of names to parameters",
            _EXAMPLE,
        )
    for name, parameter in constraints.items():
        if not isinstance(name, str) or not isinstance(parameter, Parameter):
            raise ChainError(
                f"constraints holds {name!r}: {parameter!r}, which is not a Parameter"
                " of a name",
                _EXAMPLE,
            )
    return dict(constraints)


def in_words(known: Known) -> str:
    """Known parameters as text."""
    return ", ".join(f"{name} {parameter}" for name, parameter in known.items())


def with_values(
    known: Known, names: Sequence[str], chain: Chain
) -> dict[str, Parameter]:
    """What is known of the value of single parameters, by name."""
    out = {}
    for pattern, parameter in known.items():
        if parameter.value is not None:
            for name in _matching(pattern, names, chain):
                out[name] = parameter
    return out


def linear_equations(
    known: Known,
    names: Sequence[str],
    chain: Chain,
    known_masses: Mapping[int, float],
    every: bool = True,
) -> LinearEquations:
    """Equations of values and ties, for parameters in the order of ``names``.

    Parameters
    ----------
    known : mapping of str to Parameter
    names : sequence of str
        Parameters that are estimated.
    chain : Chain
    known_masses : mapping of int to float
        kg; they are no parameters, and go to the right-hand side.
    every : bool
        If False, values of single parameters that the model lacks are left out.

    Raises
    ------
    ChainError
        If a parameter is named that the model does not have.
    """
    masses = {f"m{j}": mass for j, mass in known_masses.items()}
    equations = []
    for equation in _equations_of(known, names, chain):
        missing = equation.terms.keys() - masses.keys() - set(names)
        if missing and not every and len(equation.terms) == 1:
            continue
        for name in missing:
            _refuse_name(name, names, chain)
        equations.append(equation.with_numbers(masses))

    rows = [equation.factors(names) for equation in equations]
    return LinearEquations(
        np.array(rows).reshape(len(rows), len(names)),
        np.array([equation.value for equation in equations]),
        np.array([equation.spread for equation in equations]),
    )


@dataclass(frozen=True)
class _Equation:
    """A sum of parameters, each times a factor, that has a value."""

    terms: dict[str, float]
    value: float
    spread: float = 0.0

    def with_numbers(self, numbers: Mapping[str, float]) -> _Equation:
        """The equation with some parameters replaced by numbers."""
        terms = dict(self.terms)
        value = self.value
        for name in self.terms.keys() & numbers.keys():
            value -= terms.pop(name) * numbers[name]
        return _Equation(terms, value, self.spread)

    def factors(self, names: Sequence[str]) -> list[float]:
        """Factor of every parameter."""
        return [self.terms.get(name, 0.0) for name in names]


def bounds_of(
    known: Known, names: Sequence[str], chain: Chain
) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper bounds of the parameters in the order of ``names``."""
    lower = np.full(len(names), -np.inf)
    upper = np.full(len(names), np.inf)
    for pattern, parameter in known.items():
        if not parameter.bounded:
            continue
        matching = _matching(pattern, names, chain)
        if not matching:
            _refuse_name(pattern, names, chain)
        for name in matching:
            k = names.index(name)
            lower[k] = max(lower[k], parameter.lower)
            upper[k] = min(upper[k], parameter.upper)
    return lower, upper


def _equations_of(
    known: Known, names: Sequence[str], chain: Chain
) -> Iterator[_Equation]:
    """Equations of all values and ties."""
    for pattern, parameter in known.items():
        if parameter.value is not None:
            for summands in _summands_of(pattern, names, chain):
                terms = dict.fromkeys(summands, 1.0)
                spread = parameter.spread or 0.0
                yield _Equation(terms, float(parameter.value), spread)
        elif parameter.equal_to is not None:
            other = _canonical(parameter.equal_to, chain)
            for name in _named_by(pattern, names, chain):
                if name != other:
                    yield _Equation({name: 1.0, other: -1.0}, 0.0)


def _summands_of(pattern: str, names: Sequence[str], chain: Chain) -> list[list[str]]:
    """Names that are summed up: those of a sum, or each one that a pattern means."""
    if "+" in pattern:
        return [[_canonical(summand, chain) for summand in pattern.split("+")]]
    return [[name] for name in _named_by(pattern, names, chain)]


def _named_by(pattern: str, names: Sequence[str], chain: Chain) -> list[str]:
    """Names that a pattern means; one without ``*`` means itself, even if unknown."""
    if "*" in pattern:
        return _matching(pattern, names, chain)
    return [_canonical(pattern, chain)]


def _matching(pattern: str, names: Sequence[str], chain: Chain) -> list[str]:
    """The names that fit a pattern."""
    if "*" not in pattern:
        name = _canonical(pattern, chain)
        return [name] if name in names else []
    texts = [re.escape(text) for text in pattern.strip().split("*")]
    expression = re.compile(".*".join(texts))
    return [name for name in names if expression.fullmatch(name)]


def _canonical(name: str, chain: Chain) -> str:
    """A name with its site in the spelling of the chain."""
    where, colon, term = name.strip().partition(":")
    return f"{chain.site(where)}: {term.strip()}" if colon else where


def _refuse_name(name: str, names: Sequence[str], chain: Chain) -> None:
    """Say that a parameter is missing, and which ones its site has."""
    where, colon, _ = name.partition(":")
    if colon and "*" not in name:
        terms = [n.partition(": ")[2] for n in names if n.startswith(f"{where}: ")]
        cure = f"{where} has {', '.join(terms) or 'no law'}."
    elif re.fullmatch(r"m\d+", name):
        cure = f"The masses are m1 to m{chain.n_dof}."
    else:
        cure = f"There are {', '.join(names[:9])}."
    raise ChainError(f"constraints name {name!r}, which the model does not have", cure)
