r"""Constraints from prior knowledge: equal masses, a total mass, a known stiffness,
equal storeys, k >= 0; priors.

The estimate is replaced by the nearest one that satisfies the constraint, in the metric
of its covariance P (minimum distance): :math:`\min_\theta (\theta - \hat\theta)^T
P^{-1} (\theta - \hat\theta)` where :math:`A \theta = b` and :math:`\theta_i \ge 0`. No
balance is solved jointly with another. A warning is raised if the data contradict it.
Where floors have no sensor the equations are residuals of the fit, weighted by their
spread.
"""

import warnings
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy import linalg, optimize, stats

from ..chain.layout import with_coefficients
from ..chain.model import ChainModel
from ..chain.sites import Site, dofs_of
from ..chain.structure import Chain
from ..common import positive
from ..exceptions import BiasWarning, ChainError
from .intervals import parameters_of

__all__ = [
    "EqualMasses",
    "EqualStoreys",
    "KnownStiffness",
    "NonNegative",
    "Prior",
    "TotalMass",
]

_UNLIKELY = 1e-3
_HEAVY = (
    1e7  # root of round-off: weights beyond lose the metric, lighter ones the equations
)
Equation = tuple[
    dict[str, float], float, float
]  # factor by name, right-hand side, and its standard deviation


class Constraint:
    """Linear equations, or bounds, of masses and coefficients by names such as ``"m1"``
    and ``"storey 2: s"``.
    """

    def _equations(
        self, names: Sequence[str], chain: Chain, known: dict[int, float]
    ) -> list[Equation]:
        """What must hold."""
        return []

    def _bounded(self, names: Sequence[str], chain: Chain) -> list[str]:
        """Names of parameters that must not be negative."""
        return []

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(f'{k}={v!r}' for k, v in vars(self).items())})"


class EqualMasses(Constraint):
    """Some masses are equal.

    Parameters
    ----------
    dofs : int or iterable of int, optional
        All if None.

    Examples
    --------
    >>> from pysindy_nrf import (
    ...     ChainModel,
    ...     NRFRegressor,
    ...     excitation,
    ...     laws,
    ...     simulate,
    ... )
    >>> from pysindy_nrf.identification.constraints import EqualMasses
    >>> frame = ChainModel(
    ...     [10.0, 10.0], {i: laws.PowerSeries(1, [100.0, 1e5]) for i in (1, 2)}
    ... )
    >>> F = excitation.band_limited_random(
    ...     2, 4.0, 500.0, excited=2, rms=50.0, band=(1, 60), random_state=0
    ... )
    >>> X, F = simulate(frame, F, 0.002).to_features(smooth=False)
    >>> NRFRegressor(degree=1, constraints=EqualMasses(), dt=0.002).fit(
    ...     X, F
    ... ).masses_.round(3)
    array([10., 10.])
    """

    def __init__(self, dofs: int | Iterable[int] | None = None) -> None:
        self.dofs = tuple(dofs) if isinstance(dofs, Iterable) else dofs

    def _equations(self, names: Any, chain: Any, known: Any) -> Any:
        every = range(1, chain.n_dof + 1)
        first, *others = dofs_of(
            "A constraint", every if self.dofs is None else self.dofs, chain.n_dof
        )
        unknown = [j for j in others if not (j in known and first in known)]
        return [_mass_equation({first: 1.0, j: -1.0}, 0.0, known) for j in unknown]


class TotalMass(Constraint):
    """The masses add up to a weighed total.

    Parameters
    ----------
    mass : float
        kg.
    dofs : int or iterable of int, optional
        All if None.

    Examples
    --------
    >>> from pysindy_nrf import NRFRegressor, datasets
    >>> from pysindy_nrf.identification.constraints import TotalMass
    >>> masses = (
    ...     NRFRegressor(degree=3, constraints=TotalMass(30.0))
    ...     .fit(datasets.load_demo())
    ...     .masses_
    ... )
    >>> round(float(masses.sum()), 6)
    30.0
    """

    def __init__(self, mass: float, dofs: int | Iterable[int] | None = None) -> None:
        self.mass = mass
        self.dofs = tuple(dofs) if isinstance(dofs, Iterable) else dofs

    def _equations(self, names: Any, chain: Any, known: Any) -> Any:
        dofs = dofs_of(
            "A constraint",
            range(1, chain.n_dof + 1) if self.dofs is None else self.dofs,
            chain.n_dof,
        )
        total = positive("mass", self.mass, "Give kg.", ChainError)
        return [_mass_equation(dict.fromkeys(dofs, 1.0), total, known)]


class KnownStiffness(Constraint):
    """The stiffness of a site is known.

    Parameters
    ----------
    site : str or int
    stiffness : float
        N/m.
    term : str
        Another term's coefficient, in its own unit, e.g. ``"v"``.

    Examples
    --------
    >>> from pysindy_nrf import NRFRegressor, datasets
    >>> from pysindy_nrf.identification.constraints import KnownStiffness
    >>> model = NRFRegressor(
    ...     degree=3, constraints=KnownStiffness("storey 3", 30e3)
    ... ).fit(datasets.load_demo())
    >>> round(float(model.restoring_forces_["storey 3"].coefficients["s"]), 3)
    30000.0
    """

    def __init__(self, site: Any, stiffness: float, term: str = "s") -> None:
        self.site, self.stiffness, self.term = site, stiffness, term

    def _equations(self, names: Any, chain: Any, known: Any) -> Any:
        return [
            (
                {_existing(f"{chain.site(self.site)}: {self.term}", names): 1.0},
                float(self.stiffness),
                0.0,
            )
        ]


class EqualStoreys(Constraint):
    """Storeys with the same law: the coefficients of equal terms are tied.

    Parameters
    ----------
    storeys : iterable of int or str, optional
        All storeys of the chain if None.
    terms : iterable of str, optional
        Only these terms; all if None.

    Examples
    --------
    >>> from pysindy_nrf import (
    ...     ChainModel,
    ...     NRFRegressor,
    ...     excitation,
    ...     laws,
    ...     simulate,
    ... )
    >>> from pysindy_nrf.identification.constraints import EqualStoreys
    >>> frame = ChainModel(
    ...     [10.0, 10.0], {i: laws.PowerSeries(1, [100.0, 1e5]) for i in (1, 2)}
    ... )
    >>> F = excitation.band_limited_random(
    ...     2, 4.0, 500.0, excited=2, rms=50.0, band=(1, 60), random_state=0
    ... )
    >>> model = NRFRegressor(
    ...     degree=1, constraints=EqualStoreys(terms=["s"])
    ... ).fit(simulate(frame, F, 0.002))
    >>> k = [
    ...     float(model.restoring_forces_[i].coefficients["s"]) for i in (1, 2)
    ... ]  # N/m
    >>> abs(k[0] / k[1] - 1) < 1e-9
    True
    """

    def __init__(
        self, storeys: Iterable[Any] | None = None, terms: Iterable[str] | None = None
    ) -> None:
        self.storeys = None if storeys is None else tuple(storeys)
        self.terms = None if terms is None else tuple(terms)

    def _equations(self, names: Any, chain: Any, known: Any) -> Any:
        every = [s for s in chain.sites if s.is_storey]
        sites, out = (
            (every if self.storeys is None else [chain.site(s) for s in self.storeys]),
            [],
        )
        for site in sites[1:]:
            for name in names:
                where, _, term = name.partition(": ")
                if where == sites[0] and (self.terms is None or term in self.terms):
                    out.append(
                        (
                            {name: 1.0, _existing(f"{site}: {term}", names): -1.0},
                            0.0,
                            0.0,
                        )
                    )
        return out


class Prior(Constraint):
    """A mass, coefficient or shape parameter is known with a spread, from drawings,
    say; where floors have no sensor.

    Parameters
    ----------
    parameter : str
        ``"m2"``, ``"storey 1: s"``, ``"storey 2: gap"``: as in the table of intervals.
    value, spread : float
        What is expected and its standard deviation, in its unit. Priors on all masses
        and stiffnesses (``"s"``) are first values of the fit, too.

    Examples
    --------
    >>> from pysindy_nrf.identification.constraints import Prior
    >>> Prior("m2", 9000.0, 500.0)
    Prior(parameter='m2', value=9000.0, spread=500.0)
    """

    def __init__(self, parameter: str, value: float, spread: float) -> None:
        self.parameter, self.value, self.spread = parameter, value, spread

    def _equations(self, names: Any, chain: Any, known: Any) -> Any:
        spread = positive(
            f"{self!r}: spread",
            self.spread,
            "Give it in the unit of the parameter.",
            ChainError,
        )
        return [({_existing(self.parameter, names): 1.0}, float(self.value), spread)]


class NonNegative(Constraint):
    """Coefficients that cannot be negative.

    Parameters
    ----------
    term : str
        ``"s"`` (stiffness), ``"v"`` (damping), ``"s^3"``, or ``"m"`` for masses.
    sites : iterable of str or int, optional
        All sites that have the term if None.

    Examples
    --------
    >>> from pysindy_nrf import NRFRegressor, datasets
    >>> from pysindy_nrf.identification.constraints import NonNegative
    >>> model = NRFRegressor(constraints=NonNegative("v")).fit(
    ...     datasets.load_demo()
    ... )
    >>> [
    ...     bool(model.restoring_forces_[i].coefficients["v"] >= 0)
    ...     for i in (1, 2, 3)
    ... ]
    [True, True, True]
    """

    def __init__(self, term: str = "s", sites: Iterable[Any] | None = None) -> None:
        self.term = term
        self.sites = None if sites is None else tuple(sites)

    def _bounded(self, names: Any, chain: Any) -> Any:
        if self.term == "m":
            return [n for n in names if n[:1] == "m" and n[1:].isdigit()]
        if self.sites is None:
            found = [n for n in names if n.partition(": ")[2] == self.term]
            return found or [_existing(f"storey 1: {self.term}", names)]
        return [_existing(f"{chain.site(s)}: {self.term}", names) for s in self.sites]


def as_constraints(constraints: Any) -> tuple[Constraint, ...]:
    """What was given as ``constraints=``, as a tuple."""
    given = (
        (constraints,)
        if isinstance(constraints, Constraint)
        else tuple(constraints or ())
    )
    if wrong := [c for c in given if not isinstance(c, Constraint)]:
        raise ChainError(
            f"constraints holds {wrong[0]!r}, which is not a constraint",
            "Use estimation.constraints.",
        )
    return given


def system_of(
    given: Iterable[Constraint],
    names: Sequence[str],
    chain: Chain,
    known: dict[int, float],
    whole: bool = True,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Matrix, right-hand side and its spreads of the equations; unless ``whole``, of
    parameters that there are.
    """
    rows: list[Equation] = []
    for one in given:
        try:
            rows += one._equations(names, chain, known)
        except ChainError:
            if whole or not isinstance(one, (Prior, KnownStiffness)):
                raise
    A = np.array(
        [[factors.get(n, 0.0) for n in names] for factors, *_ in rows]
    ).reshape(len(rows), len(names))
    return (
        A,
        np.array([value for _, value, _ in rows]),
        np.array([spread for *_, spread in rows]),
    )


def constrained(model: ChainModel, constraints: Any, resolver: Any) -> ChainModel:
    """The estimate nearest to a model that satisfies the constraints; the resolver then
    applies them to all models.
    """
    given, known = as_constraints(constraints), dict(resolver.known_masses)
    if soft := [c for c in given if isinstance(c, Prior)]:
        cure = "Leave it out, or give known_masses= or KnownStiffness."
        raise ChainError(
            f"{soft[0]!r} is for records in which a floor has no sensor", cure
        )
    theta = parameters_of(model, known)
    names = list(theta.index)
    A, b, _ = system_of(given, names, model.chain, known)
    empty = ~A.any(axis=1)  # equations of known masses alone
    if np.abs(b[empty]).max(initial=0.0) > 1e-6 * np.abs(model.masses).sum():
        cure = "Correct known_masses, or leave the constraint out."
        raise ChainError(
            "The known masses differ from a constraint by"
            f" {np.abs(b[empty]).max():.4g} kg",
            cure,
        )
    A, b = A[~empty], b[~empty]
    bounded = np.array(
        [n in {x for c in given for x in c._bounded(names, model.chain)} for n in names]
    )
    resolver.constrain = None
    # the covariance made regular: shrunk towards its diagonal where the pieces are few,
    # with a floor at round-off
    raw = resolver.covariance(lambda m: parameters_of(m, known))
    share = len(theta) / (len(theta) + len(resolver.record))
    spread = np.diag(raw) + (1e-9 * np.abs(theta.to_numpy())) ** 2 + 1e-300
    P = (1 - share) * raw + np.diag(spread - (1 - share) * np.diag(raw))

    def obey(free: ChainModel) -> ChainModel:
        nearest = pd.Series(
            _nearest(parameters_of(free, known).to_numpy(), P, A, b, bounded),
            index=names,
        )
        masses = [nearest.get(f"m{j + 1}", m) for j, m in enumerate(free.masses)]
        values = {
            site: (
                nearest[
                    [f"{site}: {term}" for term in force.coefficients.index]
                ].to_numpy()
            )
            for site, force in free.restoring_forces.items()
            if force.laws
        }
        return ChainModel(
            masses,
            with_coefficients(free.laws, values),
            free.chain,
            free.visited,
            free.info,
        )

    new = obey(model)
    _warn_of_contradiction(theta, A, b, P, given)
    resolver.constrain = obey
    new.visited, new.info = model.visited, model.info
    return new


def _nearest(
    theta: np.ndarray, P: np.ndarray, A: np.ndarray, b: np.ndarray, bounded: np.ndarray
) -> np.ndarray:
    """Nearest point in the metric of P with A theta = b and theta >= 0 where
    bounded.
    """
    scale = np.sqrt(np.diag(P))
    root = linalg.cholesky(P / scale[:, None] / scale, lower=True)
    C, gap = A * scale, b - A @ theta
    size = np.linalg.norm(C, axis=1)
    C, gap = C / size[:, None], gap / size
    # y = (point - theta) / scale; the equations are rows so heavy that nothing else
    # moves them
    wide = np.vstack(
        [linalg.solve_triangular(root, np.eye(len(theta)), lower=True), _HEAVY * C]
    )
    low = np.where(bounded, -theta / scale, -np.inf)
    y = optimize.lsq_linear(
        wide,
        np.append(np.zeros(len(theta)), _HEAVY * gap),
        (low, np.inf),
        method="bvls",
    ).x
    if np.abs(C @ y - gap).max(initial=0.0) > 1e-6 * max(
        np.abs(gap).max(initial=0.0), 1.0
    ):
        raise ChainError("The constraints contradict each other", "Leave one out.")
    point = theta + scale * y
    return np.where(bounded & (point < 1e-9 * scale), 0.0, point)


def _warn_of_contradiction(
    theta: pd.Series, A: np.ndarray, b: np.ndarray, P: np.ndarray, given: tuple
) -> None:
    if not len(b):
        return
    gap = A @ theta.to_numpy() - b
    inner = A @ P @ A.T
    size = np.sqrt(np.diag(inner))
    distance = float(
        gap
        / size
        @ np.linalg.lstsq(inner / size[:, None] / size, gap / size, rcond=1e-10)[0]
    )
    rank = np.linalg.matrix_rank(inner / size[:, None] / size, tol=1e-10)
    large = np.abs(gap).max() > 1e-4 * np.abs(theta.to_numpy() * np.abs(A)).max()
    if stats.chi2.sf(distance, rank) < _UNLIKELY and large:
        worst = int(np.argmax(np.abs(gap) / size))
        involved = ", ".join(
            f"{n} = {theta[n]:.4g}"
            for n, factor in zip(theta.index, A[worst])
            if factor
        )
        warnings.warn(
            f"The data contradict the constraints {', '.join(map(repr, given))}:"
            f" without them {involved}, {abs(gap[worst]) / size[worst]:.0f} standard"
            " errors away. The constrained estimate satisfies the constraints, not the"
            " data.",
            BiasWarning,
            stacklevel=6,
        )


def _mass_equation(
    factors: dict[int, float], value: float, known: dict[int, float]
) -> Equation:
    value -= sum(c * known[j] for j, c in factors.items() if j in known)
    return {f"m{j}": c for j, c in factors.items() if j not in known}, value, 0.0


def _existing(name: str, names: Sequence[str]) -> str:
    if name not in names:
        where = Site(name.partition(": ")[0])
        held = [n.partition(": ")[2] for n in names if n.startswith(f"{where}: ")]
        cure = f"{where} has {', '.join(held) or 'no law'}."
        raise ChainError(
            f"A constraint names {name!r}, which the model does not have", cure
        )
    return name
