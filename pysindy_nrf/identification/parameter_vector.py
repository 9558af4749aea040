"""Free parameters of a model: masses, coefficients and shape parameters as a vector."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..chain.layout import with_coefficients
from ..chain.model import ChainModel
from ..chain.sites import Site
from ..laws.base import ForceLaw
from ..laws.shape import Shape

# Largest logarithm of a parameter; exp of more is no double.
MAX_LOGARITHM = 700.0


@dataclass(frozen=True)
class FreeMass:
    """A mass, kg."""

    dof: int


@dataclass(frozen=True)
class FreeCoefficient:
    """A coefficient, by the number of its term at a site."""

    site: Site
    term: int


@dataclass(frozen=True)
class FreeShape:
    """A shape parameter, by the number of its law at a site."""

    site: Site
    law: int
    shape: Shape


FreeParameter = FreeMass | FreeCoefficient | FreeShape


@dataclass(frozen=True)
class Rebuild:
    """Builds a ChainModel from a vector of free parameters.

    Attributes
    ----------
    model : ChainModel
        What is not free is taken from it.
    places : tuple of FreeMass, FreeCoefficient and FreeShape
    scale : ndarray of shape (n_parameters,)
        Entries of a vector are values over these; where it is 0, logarithms of values.
    start : ndarray of shape (n_parameters,)
        The vector of the model.
    """

    model: ChainModel
    places: tuple[FreeParameter, ...]
    scale: np.ndarray
    start: np.ndarray

    @property
    def logarithmic(self) -> np.ndarray:
        """Mask of the entries that are logarithms."""
        return self.scale == 0

    @property
    def names(self) -> list[str]:
        """Parameters by name: ``m1``, ``storey 1: s``, ``storey 1: gap``, ..."""
        labels = {}
        for site, laws in self.model.laws.items():
            labels[site] = [term.label for law in laws for term in law.terms()]

        names = []
        for place in self.places:
            if isinstance(place, FreeMass):
                names.append(f"m{place.dof}")
            elif isinstance(place, FreeCoefficient):
                names.append(f"{place.site}: {labels[place.site][place.term]}")
            else:
                names.append(f"{place.site}: {place.shape.name}")
        return names

    def values(self, u: np.ndarray) -> np.ndarray:
        """The parameters of a vector, in their units."""
        logarithms = np.where(self.logarithmic, np.minimum(u, MAX_LOGARITHM), 0.0)
        return np.where(self.logarithmic, np.exp(logarithms), u * self.scale)

    def slopes(self, u: np.ndarray) -> np.ndarray:
        """Derivative of every parameter by its entry of a vector."""
        return np.where(self.logarithmic, self.values(u), self.scale)

    def __call__(self, u: np.ndarray) -> ChainModel:
        """Model of a vector."""
        masses = self.model.masses.copy()
        coefficients = self.model.coefficients
        laws = {site: list(group) for site, group in self.model.laws.items()}

        for place, value in zip(self.places, self.values(u).tolist()):
            if isinstance(place, FreeMass):
                masses[place.dof - 1] = value
            elif isinstance(place, FreeCoefficient):
                coefficients[place.site][place.term] = value
            else:
                law = laws[place.site][place.law]
                shaped = law.with_values(shape={place.shape.name: value})
                laws[place.site][place.law] = shaped

        return ChainModel(
            masses,
            with_coefficients(laws, coefficients),
            self.model.chain,
            self.model.visited,
            self.model.info,
        )


def free_shapes_of(
    laws: Mapping[Site, Sequence[ForceLaw]],
) -> list[tuple[Site, int, Shape]]:
    """Shape parameters without a value, by site and number of the law there."""
    free = []
    for site, group in laws.items():
        for number, law in enumerate(group):
            for shape in law.shapes:
                if law.shape[shape.name] is None:
                    free.append((site, number, shape))
    return free


def free_parameters(
    model: ChainModel,
    known: Mapping[int, float],
    sizes: Mapping[tuple[Site, int], float] | None = None,
    shapes: Sequence[tuple[Site, int, Shape]] = (),
) -> Rebuild:
    """Free parameters of a model.

    Parameters
    ----------
    model : ChainModel
    known : mapping of int to float
        Masses that are not free, by DOF.
    sizes : mapping of (Site, int) to float, optional
        Least scale of each coefficient, by site and term. A coefficient of zero stays
        zero unless it has one.
    shapes : sequence of (Site, int, Shape)
        Shape parameters that are free, by site and number of the law there.
    """
    entries = [
        *_free_masses(model, known),
        *_free_coefficients(model, sizes or {}),
        *_free_shapes(model, shapes),
    ]
    return Rebuild(
        model,
        tuple(entry.place for entry in entries),
        np.array([entry.scale for entry in entries]),
        np.array([entry.start for entry in entries]),
    )


@dataclass(frozen=True)
class _Entry:
    """A free parameter, its value, and the scale of its entry (0: a logarithm)."""

    place: FreeParameter
    value: float
    scale: float

    @property
    def start(self) -> float:
        """First entry of the vector."""
        if self.scale:
            return self.value / self.scale
        return float(np.log(self.value))


def _free_masses(model: ChainModel, known: Mapping[int, float]) -> Iterator[_Entry]:
    for dof, mass in enumerate(model.masses.tolist(), 1):
        if dof not in known:
            yield _Entry(FreeMass(dof), mass, 0.0)


def _free_coefficients(
    model: ChainModel, sizes: Mapping[tuple[Site, int], float]
) -> Iterator[_Entry]:
    for site, values in model.coefficients.items():
        for term, value in enumerate(values.tolist()):
            scale = max(abs(value), sizes.get((site, term), 0.0))
            if scale:
                yield _Entry(FreeCoefficient(site, term), value, scale)


def _free_shapes(
    model: ChainModel, shapes: Sequence[tuple[Site, int, Shape]]
) -> Iterator[_Entry]:
    for site, number, shape in shapes:
        value = model.laws[site][number].shape[shape.name]
        assert value is not None  # the laws of a model have all their values
        scale = 0.0 if shape.log else abs(value) or 1.0
        yield _Entry(FreeShape(site, number, shape), value, scale)
