"""What sensors on some floors can determine, from the linearised problem."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..exceptions import ChainError
from .sites import dofs_of

if TYPE_CHECKING:
    from .identifiability import Dofs
    from .model import ChainModel
    from .structure import Chain

# Damping of every mode of the nominal chain, share of critical.
NOMINAL_DAMPING = 0.01
# Spread of the nominal masses and stiffnesses; equal ones would share modes by chance.
NOMINAL_SPREAD = 0.15
# Singular value over the largest one below which a combination of parameters does not
# show in the channels.
RANK_CUT = 1e-7
# Lines across the half-power width of each mode.
LINES_PER_MODE = 9


@dataclass(frozen=True)
class Sensing:
    """What some sensors determine of a linear chain.

    Attributes
    ----------
    excited : tuple of int
        DOFs with a measured force; empty if the base moves.
    sensors : tuple of int
    rank, unknowns : int
        Combinations of free masses and stiffnesses that show in the channels, and the
        number of masses and stiffnesses.
    condition : float
        Of the changes of the responses with the logarithms of these; damping is free.
    errors : dict of str to float
        Standard error of each over that with sensors on every floor; infinite if it is
        not determined.
    gains : dict of int to float
        By floor without a sensor: the largest error over that with one more sensor.
    """

    excited: tuple[int, ...]
    sensors: tuple[int, ...]
    rank: int
    unknowns: int
    condition: float
    errors: dict[str, float]
    gains: dict[int, float]

    @property
    def complete(self) -> bool:
        """True if all masses and stiffnesses are determined."""
        return self.rank == self.unknowns

    def __str__(self) -> str:
        where = "Base motion"
        if self.excited:
            where = _floors("Force on floor", self.excited)
        place = f"{where}, {_floors('sensor on floor', self.sensors)}"

        text = f"{place}: {self._rank_in_words()}"
        more = self._best_further_sensor()
        return f"{text} {more}" if more else text

    def _rank_in_words(self) -> str:
        if self.complete:
            worst = max(self.errors, key=self.errors.__getitem__)
            return (
                f"all {self.unknowns} masses and stiffnesses are determined near a"
                f" given chain (condition {self.condition:.1e}). Least sure is"
                f" {worst}, with {self.errors[worst]:.1f} times the error that sensors"
                " on every floor leave."
            )

        lost = [name for name, error in self.errors.items() if np.isinf(error)]
        text = (
            f"{self.rank} of {self.unknowns} combinations of masses and stiffnesses are"
            f" determined; {', '.join(lost)} cannot be distinguished."
        )
        if not self.excited:
            text += " Measure a force on a floor, or give a mass."
        return text

    def _best_further_sensor(self) -> str:
        if not self.gains:
            return ""

        floor = max(self.gains, key=self.gains.__getitem__)
        gain = self.gains[floor]
        if gain <= 1:
            return ""

        text = f"One more sensor helps most on floor {floor}"
        if np.isinf(gain):
            return f"{text}."
        return f"{text}: the largest error falls by a factor of {gain:.1f}."


def _floors(text: str, floors: tuple[int, ...]) -> str:
    plural = "s" if len(floors) > 1 else ""
    return f"{text}{plural} {', '.join(map(str, floors))}"


def plan_sensing(
    chain: Chain,
    sensors: Dofs,
    excited: Dofs = (),
    known_masses: Dofs = (),
    model: ChainModel | None = None,
) -> Sensing:
    """Rank, condition and errors of the linearised problem.

    It is linearised about the linear part of a model, or about a nominal chain.
    """
    n_dof = chain.n_dof
    floors = tuple(sorted(dofs_of("sensors", sensors, n_dof)))
    inputs = tuple(sorted(dofs_of("excited", excited, n_dof)))
    known = dofs_of("known_masses", known_masses, n_dof)
    if not floors:
        raise ChainError("No floor has a sensor", "Name at least one: sensors=[4].")

    structure = (
        _LinearChain.nominal(chain) if model is None else _LinearChain.from_model(model)
    )
    free = [dof - 1 for dof in range(1, n_dof + 1) if dof not in known]
    sensitivity = _Sensitivity.about(structure, free, inputs)

    singular, errors = sensitivity.errors_with(floors)
    _, least_errors = sensitivity.errors_with(range(1, n_dof + 1))
    rank = int((singular > RANK_CUT * singular[0]).sum())
    unknowns = len(sensitivity.names)
    condition = float(singular[0] / singular[-1]) if rank == unknowns else np.inf

    gains = {}
    for floor in sorted(set(range(1, n_dof + 1)) - set(floors)):
        largest = sensitivity.errors_with([*floors, floor])[1].max()
        gains[floor] = 1.0 if np.isinf(largest) else float(errors.max() / largest)

    reference = np.where(np.isinf(least_errors), 1.0, least_errors)
    relative = np.where(np.isinf(errors), np.inf, errors / reference)
    by_name = dict(zip(sensitivity.names, relative.tolist()))
    return Sensing(inputs, floors, rank, unknowns, condition, by_name, gains)


@dataclass(frozen=True)
class _LinearChain:
    """Masses and springs of a chain, dashpots in proportion to the springs."""

    links: list[str]
    incidence: np.ndarray  # (n_dof, n_links)
    masses: np.ndarray  # (n_dof,)
    stiffness: np.ndarray  # (n_links,)

    @classmethod
    def nominal(cls, chain: Chain) -> _LinearChain:
        """Nearly equal masses and springs, always the same ones."""
        links = [site for site in chain.sites if site.kind == "link"]
        rng = np.random.default_rng(0)
        masses = 1 + NOMINAL_SPREAD * rng.uniform(-1, 1, chain.n_dof)
        stiffness = 1 + NOMINAL_SPREAD * rng.uniform(-1, 1, len(links))
        names = [str(site) for site in links]
        return cls(names, chain.incidence(links), masses, stiffness)

    @classmethod
    def from_model(cls, model: ChainModel) -> _LinearChain:
        """The linear part of a model."""
        links = []
        stiffness = []
        for site in model.chain.sites:
            if site.kind == "link":
                links.append(str(site))
                force = model.restoring_forces[site]
                stiffness.append(abs(force.linear_part()["k"]))
        masses = np.asarray(model.masses, dtype=float)
        return cls(links, model.chain.incidence(links), masses, np.array(stiffness))

    def modes(self) -> np.ndarray:
        """Natural frequencies without damping, rad/s."""
        spring = (self.incidence * self.stiffness) @ self.incidence.T
        root = np.sqrt(self.masses)
        squares = np.linalg.eigvalsh(spring / root[:, None] / root)
        return np.sqrt(np.maximum(squares, 1e-9 * squares[-1]))


@dataclass(frozen=True)
class _Sensitivity:
    """Changes of the responses with the logarithms of masses, springs and dashpots."""

    names: list[str]  # of the masses and springs
    jacobian: np.ndarray  # (n_lines, n_dof, n_inputs, n_parameters)

    @classmethod
    def about(
        cls, structure: _LinearChain, free: list[int], inputs: tuple[int, ...]
    ) -> _Sensitivity:
        """Central differences at lines around every mode."""
        modes = structure.modes()
        around = 1 + NOMINAL_DAMPING * np.linspace(-4, 4, LINES_PER_MODE)
        omega = np.outer(modes, around).ravel()
        middle = float(np.exp(np.log(modes).mean()))
        dashpots = structure.stiffness * 2 * NOMINAL_DAMPING / middle
        columns = np.eye(len(structure.masses))[:, [dof - 1 for dof in inputs]]

        def responses(change: np.ndarray) -> np.ndarray:
            """Accelerations of all floors by line and input."""
            n_free, n_links = len(free), len(structure.links)
            masses = structure.masses.copy()
            masses[free] *= np.exp(change[:n_free])
            springs = structure.stiffness * np.exp(change[n_free : n_free + n_links])
            viscous = dashpots * np.exp(change[n_free + n_links :])

            link = springs + 1j * omega[:, None, None] * viscous
            inertia = omega[:, None, None] ** 2 * np.diag(masses)
            dynamic = (structure.incidence * link) @ structure.incidence.T - inertia
            forces = columns if inputs else -masses[:, None]
            relative = -(omega[:, None, None] ** 2) * (np.linalg.inv(dynamic) @ forces)
            return relative if inputs else relative + 1.0

        n_parameters = len(free) + 2 * len(structure.links)
        slopes = []
        for step in 1e-5 * np.eye(n_parameters):
            slopes.append((responses(step) - responses(-step)) / 2e-5)
        size = np.abs(responses(np.zeros(n_parameters)))
        rms = np.sqrt(np.mean(size**2, axis=0))
        jacobian = np.stack(slopes, axis=-1) / rms[None, :, :, None]

        names = [f"m{j + 1}" for j in free]
        names.extend(f"{link}: s" for link in structure.links)
        return cls(names, jacobian)

    def errors_with(self, floors: Iterable[int]) -> tuple[np.ndarray, np.ndarray]:
        """Singular values of masses and springs, and their errors, with some sensors.

        Dashpots are eliminated. A parameter that stands in a combination of no
        influence has an infinite error.
        """
        n_parameters = self.jacobian.shape[-1]
        channels = self.jacobian[:, [floor - 1 for floor in floors]]
        rows = channels.reshape(-1, n_parameters)
        rows = np.concatenate([rows.real, rows.imag])

        wanted, damping = np.split(rows, [len(self.names)], axis=1)
        shared = np.linalg.lstsq(damping, wanted, rcond=None)[0]
        _, singular, turned = np.linalg.svd(
            wanted - damping @ shared, full_matrices=False
        )

        clear = singular > RANK_CUT * singular[0]
        weighted = turned[clear] ** 2 / singular[clear, None] ** 2
        lost = (turned[~clear] ** 2).sum(axis=0) > 1e-6
        return singular, np.where(lost, np.inf, np.sqrt(weighted.sum(axis=0)))
