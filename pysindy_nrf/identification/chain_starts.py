"""Starting values of a linear chain from the data of a few channels, by its modes.

Where the force acts on an end of a plain chain and the same end is measured, poles and
residues give all masses and stiffnesses (inverse problem of Jacobi matrices: Hochstadt,
1974; Gladwell, Inverse problems in vibration, 2004). Otherwise, and against noise,
chains drawn at random are fitted to poles and residues.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter

import numpy as np
from scipy.optimize import nnls

from ..chain.sites import Site
from ..chain.structure import Chain
from ..exceptions import IdentifiabilityError
from .shots import Shot
from .vector_fitting import Modes, Residue, modes_of

# Starting values whose logarithms differ by less are one.
SAME_LOGARITHM = 0.3
MAX_STARTS = 16
# Chains drawn at random for a set of modes, and the spread of their logarithms.
N_DRAWS = 40
SPREAD_OF_DRAWS = 0.7
# Relative errors of a frequency and of a residue that count as one at least.
FREQUENCY_ERROR = 5e-3
RESIDUE_ERROR = 0.05
# Damping of a link at least, as a share of that of the typical mode.
LEAST_DAMPING = 0.2
# Iterations from each drawn chain, their first damping, and its limits.
MAX_STEPS = 80
FIRST_DAMPING = 1e-3
DAMPING_UP = 3.0
DAMPING_DOWN = 10.0
DAMPING_LIMITS = (1e-12, 1e3)
# Step of the differences, largest step, and largest way of a logarithm.
DIFFERENCE = 1e-6
MAX_STEP = 2.0
MAX_WAY = 12.0


@dataclass(frozen=True)
class LinearChain:
    """A chain of masses with a spring and a dashpot in each link.

    Attributes
    ----------
    masses : ndarray of shape (n_dof,)
        kg.
    stiffness, damping : ndarray of shape (n_links,)
        N/m and N s/m.
    misfit : float
        Half the sum of squared errors of its modes, over their standard errors.
    """

    masses: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    misfit: float

    @property
    def logarithms(self) -> np.ndarray:
        """Logarithms of masses and stiffnesses."""
        return np.log(np.concatenate([self.masses, self.stiffness]))


def chain_starts(
    shots: Sequence[Shot],
    chain: Chain,
    links: Sequence[Site],
    known: Mapping[int, float],
    band: tuple[float, float] = (0.0, np.inf),
) -> list[LinearChain]:
    """Starting values of masses and of the springs and dashpots in some links.

    Parameters
    ----------
    shots : sequence of Shot
    chain : Chain
    links : sequence of Site
    known : mapping of int to float
        Masses that are known, kg, by DOF.
    band : tuple of float
        Hz; lines outside are not used.

    Returns
    -------
    list of LinearChain
        The best first.

    Raises
    ------
    IdentifiabilityError
        If no chain has the modes of the channels.
    """
    rng = np.random.default_rng(0)
    nearest = []
    matches = []
    for modes in modes_of(shots, chain.n_dof, band):
        matched = list(_matched_chains(modes, chain, links, known, rng))
        matches += matched
        if matched:
            nearest.append(min(matched, key=attrgetter("misfit")))

    # behind the nearest chain of each set of modes come all: those that fit to the
    # noise, which the modes do not tell apart, the most even first
    matches.sort(key=_misfit_beyond_noise_and_unevenness)
    starts: list[LinearChain] = []
    for candidate in nearest + matches:
        if len(starts) < MAX_STARTS and _differs_from_all(candidate, starts):
            starts.append(candidate)

    if not starts:
        raise IdentifiabilityError(
            "No chain has the modes of the channels",
            "Check units and DOFs, or add a sensor.",
        )
    return starts


def _misfit_beyond_noise_and_unevenness(chain: LinearChain) -> tuple[float, float]:
    return max(chain.misfit, 1.0), float(np.ptp(np.log(chain.masses)))


def _differs_from_all(chain: LinearChain, others: Sequence[LinearChain]) -> bool:
    for other in others:
        distance = np.abs(chain.logarithms - other.logarithms).max()
        if not distance > SAME_LOGARITHM:
            return False
    return True


def _matched_chains(
    modes: Modes,
    chain: Chain,
    links: Sequence[Site],
    known: Mapping[int, float],
    rng: np.random.Generator,
) -> Iterator[LinearChain]:
    """Chains with the frequencies and residues of some modes."""
    match = _ModeMatch(modes, chain, links, known)
    starts = [match.drawn(rng) for _ in range(N_DRAWS)]
    inverse = _chain_from_forced_end(modes, chain, links)
    if inverse is not None:
        starts.insert(0, match.free_of(inverse))

    # where modes contradict each other, the chain of the lowest frequency
    x = np.vstack([_nearest(match, np.array(starts)), match.even()])
    misfit = (match.errors(x) ** 2).sum(axis=1) / 2
    chains = match.chains(x)

    ratio = -2 * modes.poles.real / np.abs(modes.poles) ** 2
    for row in np.flatnonzero(np.isfinite(misfit)):
        drifts = (match.incidence.T @ chains.shapes[row]).T
        damping = nnls(drifts**2, 2 * np.abs(modes.poles.real))[0]
        least = LEAST_DAMPING * np.median(ratio) * chains.stiffness[row]
        yield LinearChain(
            masses=chains.masses[row],
            stiffness=chains.stiffness[row],
            damping=np.maximum(damping, least),
            misfit=float(misfit[row]),
        )


@dataclass(frozen=True)
class _Chains:
    """Several undamped chains, one a row."""

    masses: np.ndarray  # (n_chains, n_dof)
    stiffness: np.ndarray  # (n_chains, n_links)
    frequencies: np.ndarray  # (n_chains, n_dof), 1/s
    shapes: np.ndarray  # (n_chains, n_dof, n_modes), of unit modal masses


class _ModeMatch:
    """How far the modes of chains are from those found.

    Chains are rows of logarithms: of the masses that are not known, then of the
    stiffnesses.
    """

    def __init__(
        self,
        modes: Modes,
        chain: Chain,
        links: Sequence[Site],
        known: Mapping[int, float],
    ) -> None:
        n = chain.n_dof
        self.n_dof = n
        self.incidence = chain.incidence(links)
        self.free = [j for j in range(n) if j + 1 not in known]
        self.known = np.array([known.get(j + 1, 1.0) for j in range(n)], dtype=float)

        self.frequencies = np.abs(modes.poles)
        # an error of amplitude is one of phase
        of_noise = modes.errors * -modes.poles.real / self.frequencies
        self.frequency_errors = np.maximum(FREQUENCY_ERROR, of_noise)

        # products of mode shapes, as of an undamped chain
        self.places = [(r.channel, r.input) for r in modes.residues]
        self.products = []
        self.product_errors = []
        for residue in modes.residues:
            values = (residue.values * 2j * modes.poles.imag).real
            error = np.maximum(RESIDUE_ERROR, modes.errors) * np.abs(values)
            self.products.append(values)
            self.product_errors.append(error)

        self.typical_mass = self._typical_mass(known)

    def _typical_mass(self, known: Mapping[int, float]) -> float:
        """Size of a mass, kg: that of what is known, or of force over acceleration."""
        if known:
            return float(np.median(list(known.values())))
        masses = []
        for (_, drive), values in zip(self.places, self.products):
            if drive < self.n_dof:
                masses.append(1.0 / max(np.abs(values).sum(), 1e-300))
        return float(np.median(masses or [1.0]))

    def drawn(self, rng: np.random.Generator) -> np.ndarray:
        """A chain drawn at random."""
        stiffness = self.typical_mass * np.median(self.frequencies) ** 2
        n_links = self.incidence.shape[1]
        k = stiffness * rng.lognormal(0, SPREAD_OF_DRAWS, n_links)
        m = self.typical_mass * rng.lognormal(0, SPREAD_OF_DRAWS, len(self.free))
        return np.log(np.concatenate([m, k]))

    def even(self) -> np.ndarray:
        """Equal masses and springs with the lowest frequency of the modes."""
        n_links = self.incidence.shape[1]
        even = np.full(len(self.free) + n_links, np.log(self.typical_mass))
        lowest = self.chains(even[None]).frequencies.min()
        even[len(self.free) :] += 2 * np.log(self.frequencies.min() / lowest)
        return even

    def free_of(self, chain: LinearChain) -> np.ndarray:
        """The row of a chain."""
        masses = np.log(chain.masses)[self.free]
        return np.concatenate([masses, np.log(chain.stiffness)])

    def chains(self, x: np.ndarray) -> _Chains:
        """Chains of the rows of x, and their modes."""
        masses = np.tile(self.known, (len(x), 1))
        masses[:, self.free] = np.exp(x[:, : len(self.free)])
        stiffness = np.exp(x[:, len(self.free) :])

        root = np.sqrt(masses)[:, :, None]
        K = (self.incidence * stiffness[:, None]) @ self.incidence.T
        squares, vectors = np.linalg.eigh(K / root / root.transpose(0, 2, 1))
        positive = np.maximum(squares, 1e-12 * squares[:, -1:])
        return _Chains(masses, stiffness, np.sqrt(positive), vectors / root)

    def errors(self, x: np.ndarray) -> np.ndarray:
        """Errors of frequencies and residues of the rows of x, over standard errors."""
        chains = self.chains(x)
        of_base = -chains.masses[:, None] @ chains.shapes
        driven = np.concatenate([chains.shapes, of_base], axis=1)

        parts = [np.log(chains.frequencies / self.frequencies) / self.frequency_errors]
        for (channel, drive), products, errors in zip(
            self.places, self.products, self.product_errors
        ):
            product = chains.shapes[:, channel] * driven[:, drive]
            parts.append((product - products) / errors)
        return np.hstack(parts)


def _nearest(match: _ModeMatch, x: np.ndarray) -> np.ndarray:
    """Least squares from each row of x (Levenberg), all rows in step.

    scipy.optimize.least_squares takes one start at a time; the modes of all chains are
    found at once here.
    """
    n_rows, p = x.shape
    low = x - MAX_WAY
    high = x + MAX_WAY
    damping = np.full(n_rows, FIRST_DAMPING)

    errors = match.errors(x)
    for _ in range(MAX_STEPS):
        beside = (x[:, None] + DIFFERENCE * np.eye(p)).reshape(-1, p)
        moved = match.errors(beside).reshape(n_rows, p, -1)
        J = (moved - errors[:, None]) / DIFFERENCE
        normal = J @ J.transpose(0, 2, 1)
        # modes may determine nothing
        ridge = np.maximum(damping * np.trace(normal, axis1=1, axis2=2), 1e-300)
        damped = normal + ridge[:, None, None] * np.eye(p)
        step = np.linalg.solve(damped, J @ errors[:, :, None])[:, :, 0]

        trial = np.clip(x - np.clip(step, -MAX_STEP, MAX_STEP), low, high)
        trial_errors = match.errors(trial)
        better = (trial_errors**2).sum(axis=1) < (errors**2).sum(axis=1)
        x = np.where(better[:, None], trial, x)
        errors = np.where(better[:, None], trial_errors, errors)
        damping = np.where(better, damping / DAMPING_DOWN, damping * DAMPING_UP)
        damping = np.clip(damping, *DAMPING_LIMITS)
    return x


def _chain_from_forced_end(
    modes: Modes, chain: Chain, links: Sequence[Site]
) -> LinearChain | None:
    """The plain chain with the modes of the response at its forced end.

    Squared mode shapes there are the first components of the eigenvectors of a Jacobi
    matrix, which Lanczos' method builds from them. None if no end is forced and
    measured, or no chain has these modes.
    """
    n = chain.n_dof
    if list(links) != [Site(j) for j in range(1, n + 1)]:
        return None
    response = _response_at_end(modes, n)
    if response is None:
        return None

    # squared mode shapes, for unit modal masses
    squares = (response.values * 2j * modes.poles.imag).real
    if (squares <= 0).any():
        return None
    J = _jacobi_matrix(np.abs(modes.poles) ** 2, np.sqrt(squares / squares.sum()))
    if response.channel == n - 1:
        J = J[::-1, ::-1]
    return _chain_of_jacobi_matrix(J, response.channel, 1.0 / squares.sum())


def _response_at_end(modes: Modes, n: int) -> Residue | None:
    """Residues of a channel at an end of the chain, from the force there."""
    for residue in modes.residues:
        if residue.channel == residue.input and residue.channel in (0, n - 1):
            return residue
    return None


def _chain_of_jacobi_matrix(
    J: np.ndarray, end: int, mass_of_end: float
) -> LinearChain | None:
    """The chain whose stiffness over the roots of its masses is a Jacobi matrix."""
    n = len(J)
    # roots of the masses, up to a factor: the free end bears no force
    roots = np.linalg.solve(J, np.eye(n)[0])
    if (roots <= 0).any() and (roots >= 0).any():
        return None
    roots = np.abs(roots / roots[end]) * np.sqrt(mass_of_end)

    above = -np.diag(J, 1) * roots[1:] * roots[:-1]
    lowest = J[0, 0] * roots[0] ** 2 - above[:1].sum()
    springs = np.append(lowest, above)
    if not (springs > 0).all():
        return None
    return LinearChain(roots**2, springs, np.zeros(n), 0.0)


def _jacobi_matrix(eigenvalues: np.ndarray, first: np.ndarray) -> np.ndarray:
    """The Jacobi matrix with given eigenvalues and first components of eigenvectors."""
    n = len(eigenvalues)
    J = np.zeros((n, n))
    basis = [first]
    for k in range(n):
        image = eigenvalues * basis[k]
        J[k, k] = basis[k] @ image
        # twice, as rounding spoils the first
        for _ in range(2):
            image = image - np.array(basis).T @ (np.array(basis) @ image)
        if k + 1 < n:
            length = np.linalg.norm(image)
            J[k, k + 1] = -length
            J[k + 1, k] = -length
            basis.append(image / length)
    return J
