r"""What noise in the motion does to least squares.

Noise of covariance N in the columns biases an estimate :math:`\theta` by :math:`-(G -
N)^{-1} N \theta`, with G the Gram matrix of the columns.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from ..chain.identifiability import SolveOrder, Step
from ..chain.model import ChainModel
from ..chain.sites import Site
from ..equations.errors import residual_weights
from ..equations.normal_equations import NormalEquations
from ..records.dataset import Dataset, Segment
from ..records.fusion.noise_levels import white_level
from ..records.zero_phase_filter import ZeroPhaseFilter

# Bias over standard error that leaves a 95 % interval 92 %: Phi(1.96 - b) - Phi(-1.96 -
# b) = 0.921 at b = 0.5.
NEGLIGIBLE = 0.5
# White noise below this share of a channel's rms is rounding, as in the fusion.
ROUNDING = 1e-6
# Noise of a smooth nonlinear column over that of the motion: the power of a cubic.
STEEPNESS = 3.0
# Order of the differences that show the white noise of a channel.
DIFFERENCE_ORDER = 10
# Share of the power of a combination of columns that is no noise, at least: what noise
# makes up altogether cannot be restored, and its bias is larger still.
LEAST_SIGNAL = 0.1

# A mass by its DOF, or a coefficient by its site and number there.
Parameter = int | tuple[Site, int]


@dataclass(frozen=True)
class NoiseBias:
    """What noise in the motion does to least squares in one equation of motion.

    Attributes
    ----------
    errors : float
        Largest bias, in standard errors of its parameter.
    dof : int or None
        Whose mass is solved for.
    mass : float
        Share of the mass that is lost.
    channel : str
        The noisiest.
    share : float
        Its noise over its rms.
    """

    errors: float
    dof: int | None
    mass: float
    channel: str
    share: float


def noise_shares(
    data: Dataset, filters: Sequence[ZeroPhaseFilter | None]
) -> dict[str, float]:
    """Noise over rms of each acceleration, rate and drift: ``a1``, ``v1``, ``s1``, ...

    As the fusion measured it; of arrays with a clock the white noise.

    Parameters
    ----------
    data : Dataset
    filters : sequence of ZeroPhaseFilter or None
        By record; white noise shrinks in them.
    """
    noise: dict[str, float] = {}
    power: dict[str, float] = {}
    for segment, band_filter in zip(data.segments, filters):
        passed = 1.0 if band_filter is None else band_filter.noise_gain()
        for kind, dof in product("avs", range(1, segment.n_dof + 1)):
            name = f"{kind}{dof}"
            channel = getattr(segment, kind)[segment.valid, dof - 1].astype(float)
            level = _noise_of_feature(segment, kind, dof, channel)
            noise[name] = noise.get(name, 0.0) + len(channel) * passed * level**2
            power[name] = power.get(name, 0.0) + float(channel @ channel)

    shares = {}
    for name, size in power.items():
        shares[name] = float(np.sqrt(noise[name] / size)) if size else 0.0
    return shares


def _noise_of_feature(
    segment: Segment, kind: str, dof: int, channel: np.ndarray
) -> float:
    """Noise of an acceleration, or of a rate or drift, which has that of both ends."""
    if segment.noise:
        ends = [dof] if kind == "a" or dof == 1 else [dof, dof - 1]
        of_motion = kind.replace("s", "x")
        levels = [_noise_of_channel(segment.noise, of_motion, end) for end in ends]
        return float(np.linalg.norm(levels))
    if segment.dt is None:
        return 0.0
    return white_level(channel, DIFFERENCE_ORDER)


def _noise_of_channel(noise: Mapping[str, float], kind: str, dof: int) -> float:
    """Noise of a channel.

    That of a rate that was not measured is at most the geometric mean of those of
    displacement and acceleration (Landau).
    """
    if kind == "v" and f"v{dof}" not in noise:
        displacement = _noise_of_channel(noise, "x", dof)
        acceleration = _noise_of_channel(noise, "a", dof)
        return float(np.sqrt(displacement * acceleration))
    return noise.get(f"{kind}{dof}", np.inf)


@dataclass(frozen=True)
class _Column:
    """A column of an equation of motion that holds motion."""

    place: int
    parameter: Parameter
    sign: float
    noise: float  # over its rms
    channel: str  # the noisiest


@dataclass(frozen=True)
class _System:
    """Parameters that are solved together, over the power of the residual.

    Attributes
    ----------
    parameters : list of int or (Site, int)
    gram : ndarray of shape (p, p)
    noise : ndarray of shape (p,)
        Power of the noise of each column.
    values : ndarray of shape (p,)
    channels : list of str
        The noisiest of each column.
    """

    parameters: list[Parameter]
    gram: np.ndarray
    noise: np.ndarray
    values: np.ndarray
    channels: list[str]


def noise_bias(
    model: ChainModel,
    solve_order: SolveOrder,
    grams: NormalEquations,
    shares: Mapping[str, float],
) -> list[NoiseBias]:
    """Bias of every equation of motion, as they are solved.

    Parameters
    ----------
    model : ChainModel
    solve_order : SolveOrder
    grams : NormalEquations
        Of all data.
    shares : mapping of str to float
        Of :func:`noise_shares`.
    """
    finite = [share for share in shares.values() if np.isfinite(share)]
    if max(finite, default=np.inf) < ROUNDING:
        return []

    squares = grams.squares()
    systems = []
    for step in solve_order.steps:
        system = _system_of(model, step, squares, shares)
        if system is not None:
            systems.append(system)
    if solve_order.strategy == "joint" and systems:
        systems = [_joined(systems)]

    biases: list[NoiseBias] = []
    for system in systems:
        biases += _biases(system, shares)
    return biases


def _system_of(
    model: ChainModel,
    step: Step,
    grams: NormalEquations,
    shares: Mapping[str, float],
) -> _System | None:
    """The parameters of one step; None if it has none, or leaves nothing."""
    gram = grams.matrices[step.dofs]
    n_samples = float(grams.sizes[step.dofs])
    masses = dict(enumerate(model.masses, 1))
    weights = residual_weights(masses, model.coefficients, grams, step.dofs)
    residual = float(weights @ gram @ weights) / max(n_samples, 1.0)

    columns = []
    for column in _columns_with_motion(step, grams, shares):
        if gram[column.place, column.place] > 0:
            columns.append(column)
    if not columns or residual <= 0:
        return None

    places = np.array([column.place for column in columns])
    signs = np.array([column.sign for column in columns])
    noise = np.square([column.noise for column in columns]) * np.diag(gram)[places]
    noise = _capped(noise, weights[places], residual * n_samples)

    signed = gram[np.ix_(places, places)] * signs * signs[:, None]
    return _System(
        parameters=[column.parameter for column in columns],
        gram=signed / residual,
        noise=noise / residual,
        values=weights[places] * signs,
        channels=[column.channel for column in columns],
    )


def _capped(noise: np.ndarray, values: np.ndarray, residual: float) -> np.ndarray:
    """Noise of columns whose force is no larger than the residual (sums of squares).

    What is quick in a channel may be motion: noise leaves at least its own force of the
    residual.
    """
    force = float(noise @ values**2)
    if not np.isfinite(force) or force <= 0:
        return noise
    return noise * min(1.0, residual / force)


def _columns_with_motion(
    step: Step, grams: NormalEquations, shares: Mapping[str, float]
) -> Iterator[_Column]:
    """Columns of the unknowns of a step, with their noise."""
    slices, mass_at, _ = grams.positions(step.dofs)
    if step.masses and mass_at is not None:
        channel = f"a{step.dofs[0]}"
        yield _Column(mass_at, step.dofs[0], 1.0, shares[channel], channel)

    group = grams.groups[step.dofs]
    for site, sign in zip(group.sites, group.signs):
        if site not in step.sites:
            continue
        storeys = range((site.q or 0) + 1, site.p + 1)
        for number, label in enumerate(grams.layout.labels(site)):
            is_linear = label in ("v", "s")
            kinds = label if is_linear else "vs"
            channels = [f"{kind}{j}" for kind, j in product(kinds, storeys)]
            noisiest = max(channels, key=shares.__getitem__)
            noise = shares[noisiest] * (1.0 if is_linear else STEEPNESS)
            place = slices[site].start + number
            yield _Column(place, (site, number), sign, noise, noisiest)


def _joined(systems: Sequence[_System]) -> _System:
    """Equations that are solved together, as one system."""
    values: dict[Parameter, float] = {}
    channels: dict[Parameter, str] = {}
    for system in systems:
        values |= zip(system.parameters, system.values)
        channels |= zip(system.parameters, system.channels)

    parameters = list(values)
    gram = np.zeros((len(parameters), len(parameters)))
    noise = np.zeros(len(parameters))
    for system in systems:
        places = [parameters.index(parameter) for parameter in system.parameters]
        gram[np.ix_(places, places)] += system.gram
        noise[places] += system.noise
    return _System(
        parameters,
        gram,
        noise,
        np.array(list(values.values())),
        list(channels.values()),
    )


def _biases(system: _System, shares: Mapping[str, float]) -> list[NoiseBias]:
    """Bias of each mass of a system, or of a system without one."""
    masses = [key for key in system.parameters if isinstance(key, int)]
    dofs: Sequence[int | None] = masses or [None]
    if not np.isfinite(system.noise).all():
        noisiest = max(system.channels, key=shares.__getitem__)
        return [NoiseBias(np.inf, dof, 0.0, noisiest, np.inf) for dof in dofs]

    size = np.sqrt(np.diag(system.gram))
    unit = system.gram / size[:, None] / size
    noise = system.noise / size**2
    values = system.values * size
    bias = _restored(unit, noise) @ (noise * values)

    error = np.sqrt(np.diag(np.linalg.pinv(unit, hermitian=True)))
    tiny = np.finfo(float).tiny
    largest = float(np.max(np.abs(bias) / np.maximum(error, tiny)))

    biases = []
    for dof in dofs:
        noisiest = max(_channels_near(system, dof), key=shares.__getitem__)
        lost = 0.0
        if dof is not None:
            k = system.parameters.index(dof)
            true_value = values[k] + bias[k]
            lost = float(np.clip(bias[k] / (true_value or 1.0), 0.0, 1.0))
        biases.append(NoiseBias(largest, dof, lost, noisiest, shares[noisiest]))
    return biases


def _restored(unit: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Inverse of a Gram matrix without its noise, as far as it can be restored."""
    values, vectors = np.linalg.eigh(unit - np.diag(noise))
    least = LEAST_SIGNAL * np.diag(vectors.T @ unit @ vectors)
    return (vectors / np.maximum(values, least)) @ vectors.T


def _channels_near(system: _System, dof: int | None) -> list[str]:
    """Channels of a floor and of the storeys below and above it."""
    if dof is None:
        return system.channels
    return [name for name in system.channels if int(name[1:]) in (dof, dof + 1)]
