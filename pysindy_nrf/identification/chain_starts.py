"""Starting values of a linear chain from the data of a few channels, by way of its
modes.

The spectra of the measured channels are fitted with rational functions of common poles
(vector fitting: Gustavsen and Semlyen, IEEE Trans. Power Delivery 14, 1999), the effect
of initial and final state among them. Where the force acts on an end of a plain chain
and the same end is measured, poles and residues give all masses and stiffnesses
(inverse problem of Jacobi matrices: Hochstadt, 1974; Gladwell, Inverse problems in
vibration, 2004). Otherwise, and against noise, chains drawn at random are fitted to
poles and residues.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.optimize import nnls

from ..chain.sites import Site
from ..chain.structure import Chain
from ..exceptions import IdentifiabilityError
from .output_error import DIFFERENCE, LONGEST, Shot, lengths

ROUNDS = 8  # of the poles, with those of noise and without
EXTRA = (0, 2)  # poles for noise
DRAWS, STEPS = 40, 80  # chains drawn at random for a set of modes; iterations of each
ALIKE, MOST = (
    0.3,
    16,
)  # starting values whose logarithms differ by less are one; their number at most
WIDTH, FLOOR = (
    9,
    0.05,
)  # lines of a local mean of the response; part of its rms below which weights are even
POWER = 1e-3  # of the spectrum's largest line, smoothed, above which lines are used
NEAR, SHARE = (
    5e-3,
    0.05,
)  # relative errors of a frequency and of a residue that count as one at least
# times the logarithm of their number: the power of the largest of some rows of noise
# (2), twice
NOISE = 4.0


@dataclass
class Modes:
    """Poles (1/s) of a chain, and its displacement residues: channel (DOF from 0),
    input (DOF; n_dof: base), value.
    """

    poles: np.ndarray
    residues: list[tuple[int, int, np.ndarray]]
    # relative standard errors of the residues; inf: noise alone may look like this mode
    errors: np.ndarray


@dataclass
class Linear:
    """Masses (kg), stiffnesses (N/m) and damping (N s/m) of the links of a chain."""

    masses: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    misfit: float


def chain_starts(
    shots: Sequence[Shot],
    chain: Chain,
    links: Sequence[Site],
    known: Mapping[int, float],
    band: tuple[float, float] = (0.0, np.inf),
    random_state: int = 0,
) -> list[Linear]:
    """Starting values of the masses and of the springs and dampers in some links, the
    best first.
    """
    rng = np.random.default_rng(random_state)
    sets = [
        list(_matched(found, chain, links, known, rng))
        for found in modes_of(shots, chain.n_dof, band)
    ]
    # of each set of modes the chain nearest to it; then all: below one modes tell none
    # apart, the most even come first
    first = [min(own, key=lambda one: one.misfit) for own in sets if own]
    every = sorted(
        sum(sets, []),
        key=lambda one: (max(one.misfit, 1.0), np.ptp(np.log(one.masses))),
    )
    kept: list[Linear] = []
    for one in first + every:
        new = np.log(np.concatenate([one.masses, one.stiffness]))
        if all(
            np.abs(new - np.log(np.concatenate([k.masses, k.stiffness]))).max() > ALIKE
            for k in kept[:MOST]
        ):
            kept.append(one)
    if not kept:
        raise IdentifiabilityError(
            "No chain has the modes of the channels",
            "Check units and DOFs, or add a sensor.",
        )
    return kept[:MOST]


def _spectra(
    shots: Sequence[Shot], band: tuple[float, float]
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Imaginary frequencies (1/s), channels as accelerations, and inputs of every shot,
    line by line.
    """
    for shot in shots:
        seg, rows = shot.segment, shot.segment.valid
        ag = np.zeros(seg.n_valid) if seg.ag is None else seg.ag[rows]
        Y, U = (
            np.fft.rfft(part, axis=0)[1:]
            for part in (shot.measured, np.column_stack([seg.F[rows], ag]))
        )
        f = np.fft.rfftfreq(seg.n_valid, seg.step)[1:]
        width = max(3, len(f) // 200)
        power = (np.abs(Y) ** 2 / (np.abs(Y) ** 2).max(axis=0)).sum(axis=1)
        driven = (
            np.abs(U) ** 2 / np.maximum((np.abs(U) ** 2).max(axis=0), 1e-300)
        ).sum(axis=1)
        smooth = [
            np.convolve(part, np.ones(width) / width, "same")
            for part in (power, driven)
        ]
        use = (smooth[0] > POWER * smooth[0].max()) & (
            smooth[1] > POWER * smooth[1].max()
        )
        use &= (f >= band[0]) & (f <= band[1])
        inside = slice(int(np.argmax(use)), len(use) - int(np.argmax(use[::-1])))
        s = 2j * np.pi * f[inside]
        orders = [{"x": 2, "v": 1, "a": 0}[channel[0]] for channel in shot.channels]
        yield s, Y[inside] * s[:, None] ** orders, U[inside]


def _basis(s: np.ndarray, poles: np.ndarray) -> np.ndarray:
    """Partial fractions with real coefficients, two for each pole, shape (len(s), 2
    n_poles).
    """
    a, b = 1 / (s[:, None] - poles), 1 / (s[:, None] - poles.conj())
    return np.stack([a + b, 1j * (a - b)], axis=2).reshape(len(s), -1)


def modes_of(
    shots: Sequence[Shot], n: int, band: tuple[float, float] = (0.0, np.inf)
) -> list[Modes]:
    """Poles and residues of n modes by vector fitting, from several first poles."""
    data, channels = list(_spectra(shots, band)), shots[0].channels
    inputs = [u for u in range(n + 1) if any(np.any(U[:, u]) for *_, U in data)]
    ends = np.array([[abs(s[0]), abs(s[-1])] for s, *_ in data])
    low, high = ends[:, 0].min(), ends[:, 1].max()
    every = np.abs(np.concatenate([Y for _, Y, _ in data]))
    # a noisy force errs in proportion to the response
    weights = 1 / (
        uniform_filter1d(every, WIDTH, axis=0)
        + FLOOR * np.sqrt(np.mean(every**2, axis=0))
    )
    weights /= np.sqrt(((weights * every) ** 2).sum(axis=0))
    force = [
        np.sqrt(sum((np.abs(U[:, u]) ** 2).sum() for *_, U in data)) for u in inputs
    ]

    def columns(poles: np.ndarray, c: int) -> tuple[np.ndarray, np.ndarray]:
        """Columns of residues, direct terms and transients of one channel, and the
        channel.
        """
        wide = []
        for r, (s, _, U) in enumerate(data):
            fractions = np.column_stack([_basis(s, poles), np.ones(len(s))])
            parts = [
                fractions * (U[:, u] / force[i])[:, None] for i, u in enumerate(inputs)
            ]
            ends_too = np.column_stack([fractions, s / abs(s[-1])]) / np.sqrt(len(s))
            parts += [ends_too * (k == r) for k in range(len(data))]
            wide.append(np.hstack(parts))
        both = np.column_stack(
            [np.vstack(wide), np.concatenate([Y[:, c] for _, Y, _ in data])]
        )
        both = _real(both * weights[:, c, None])
        return both[:, :-1], both[:, -1]

    def relocated(poles: np.ndarray) -> np.ndarray:
        """Zeros of the common denominator."""
        gram, right = [], []
        for c in range(len(channels)):
            own, y = columns(poles, c)
            shared = (
                np.vstack([_basis(s, poles) * Y[:, c, None] for s, Y, _ in data])
                * weights[:, c, None]
            )
            wide = np.column_stack([own / lengths(own), -_real(shared), y])
            R = np.asarray(np.linalg.qr(wide, mode="r"))[own.shape[1] :, own.shape[1] :]
            gram.append(R[:, :-1])
            right.append(R[:, -1])
        sigma = np.linalg.lstsq(np.vstack(gram), np.concatenate(right), rcond=None)[0]
        m = len(poles)
        A, b = np.zeros((2 * m, 2 * m)), np.tile([2.0, 0.0], m)
        for k, pole in enumerate(poles):
            A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [
                [pole.real, pole.imag],
                [-pole.imag, pole.real],
            ]
        found = np.linalg.eigvals(A - np.outer(b, sigma))
        found = found[np.argsort(-found.imag)][:m]  # two real ones become a pair
        return -np.abs(found.real) + 1j * np.clip(
            np.abs(found.imag), 0.5 * low, 1.5 * high
        )

    def fitted(poles: np.ndarray) -> tuple[float, list[np.ndarray], np.ndarray]:
        """What is left, the values of every channel, and the energy of every mode in
        all channels.
        """
        left, values, energy = 0.0, [], np.zeros(len(poles))
        for c in range(len(channels)):
            own, y = columns(poles, c)
            x, *_ = np.linalg.lstsq(own, y, rcond=None)
            left += float(((y - own @ x) ** 2).sum())
            values.append(x)
            for i in range(len(inputs)):
                part = slice(
                    i * (2 * len(poles) + 1), i * (2 * len(poles) + 1) + 2 * len(poles)
                )
                energy += (
                    (own[:, part] * x[part]).reshape(len(y), -1, 2).sum(axis=2) ** 2
                ).sum(axis=0)
        return left, values, energy

    out: list[Modes] = []
    for spread, extra in product((np.linspace, np.geomspace), EXTRA):
        poles, tried = (
            spread(max(low, high / 300), high, n + extra + 2)[1:-1] * (-0.01 + 1j),
            [],
        )
        for number in range(2 * ROUNDS):
            poles = relocated(poles)
            if number == ROUNDS:  # poles of noise hold little energy
                poles = poles[np.argsort(-fitted(poles)[2])[:n]]
            if number >= ROUNDS:
                tried.append((*fitted(poles)[:2], poles))
        left, values, poles = min(tried, key=lambda one: one[0])
        rows, order = 2 * every.shape[0], np.argsort(np.abs(poles))
        shown = fitted(poles)[2] / (
            left / rows / len(channels)
        )  # over the variance of one row
        errors = np.where(shown < NOISE * np.log(rows), np.inf, 1 / np.sqrt(shown))[
            order
        ]
        if any(np.allclose(poles[order], other.poles, rtol=1e-3) for other in out):
            continue
        residues = []
        for channel, x in zip(channels, values):
            for i, u in enumerate(inputs):
                part = (
                    x[i * (2 * n + 1) :][: 2 * n].reshape(n, 2)
                    @ [1, 1j]
                    / force[i]
                    / poles**2
                )
                residues.append((int(channel[1:]) - 1, u, part[order]))
        out.append(Modes(poles[order], residues, errors))
    return out


def _real(values: np.ndarray) -> np.ndarray:
    return np.concatenate([values.real, values.imag])


def _from_end(found: Modes, n: int) -> np.ndarray | None:
    """Logarithms of masses and stiffnesses of a plain chain from the response at a
    forced end; None if none has it.
    """
    for j, u, residues in found.residues:
        if j != u or j not in (0, n - 1):
            continue
        weights = (
            residues * 2j * found.poles.imag
        ).real  # squared mode shapes, for unit modal masses
        if (weights <= 0).any():
            return None
        mass, first = 1.0 / weights.sum(), np.sqrt(weights / weights.sum())
        J, Q = np.zeros((n, n)), [first]  # Lanczos from the forced end
        for k in range(n):
            along = np.abs(found.poles) ** 2 * Q[k]
            J[k, k] = Q[k] @ along
            along = along - np.array(Q).T @ (np.array(Q) @ along)
            along = along - np.array(Q).T @ (np.array(Q) @ along)
            if k + 1 < n:
                J[k, k + 1] = J[k + 1, k] = -np.linalg.norm(along)
                Q.append(along / np.linalg.norm(along))
        if j == n - 1:
            J = J[::-1, ::-1]
        roots = np.linalg.solve(
            J, np.eye(n)[0]
        )  # roots of the masses, up to a factor: the free end bears no force
        if (roots <= 0).any() and (roots >= 0).any():
            return None
        roots = np.abs(roots / roots[j]) * np.sqrt(mass)
        above = -np.diag(J, 1) * roots[1:] * roots[:-1]
        springs = np.append(J[0, 0] * roots[0] ** 2 - above[:1].sum(), above)
        return (
            np.log(np.concatenate([roots**2, springs])) if (springs > 0).all() else None
        )
    return None


def _matched(
    found: Modes,
    chain: Chain,
    links: Sequence[Site],
    known: Mapping[int, float],
    rng: np.random.Generator,
) -> Iterator[Linear]:
    """Chains whose frequencies and residues are those found, from the Jacobi matrix and
    from chains drawn at random.
    """
    n, signs, w = chain.n_dof, chain.incidence(links), np.abs(found.poles)
    free = [j for j in range(n) if j + 1 not in known]
    fixed = np.array([known.get(j + 1, 1.0) for j in range(n)], dtype=float)
    aim = [(j, u, (r * 2j * found.poles.imag).real) for j, u, r in found.residues]
    near = np.maximum(
        NEAR, found.errors * -found.poles.real / w
    )  # an error of amplitude is one of phase
    sizes = [np.maximum(SHARE, found.errors) * np.abs(values) for *_, values in aim]

    def built(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Masses, stiffnesses, natural frequencies (1/s) and mode shapes of a unit
        modal mass, of each row of x.
        """
        masses, k = np.tile(fixed, (len(x), 1)), np.exp(x[:, len(free) :])
        masses[:, free] = np.exp(x[:, : len(free)])
        root = np.sqrt(masses)[:, :, None]
        values, vectors = np.linalg.eigh(
            (signs * k[:, None]) @ signs.T / root / root.transpose(0, 2, 1)
        )
        return (
            masses,
            k,
            np.sqrt(np.maximum(values, 1e-12 * values[:, -1:])),
            vectors / root,
        )

    def gaps(x: np.ndarray) -> np.ndarray:
        masses, _, own, phi = built(x)
        driven = np.concatenate([phi, -masses[:, None] @ phi], axis=1)
        wrong = [
            (phi[:, j] * driven[:, u] - values) / size
            for (j, u, values), size in zip(aim, sizes)
        ]
        return np.hstack([np.log(own / w) / near, *wrong])

    first = (
        _from_end(found, n)
        if list(links) == [Site(j) for j in range(1, n + 1)]
        else None
    )
    draws = [] if first is None else [np.concatenate([first[:n][free], first[n:]])]
    # the size of a mass: that of the force or of what is known
    forced = [1.0 / max(np.abs(values).sum(), 1e-300) for _, u, values in aim if u < n]
    size = float(np.median(list(known.values()) if known else forced or [1.0]))
    for _ in range(DRAWS):
        k = size * np.median(w) ** 2 * rng.lognormal(0, 0.7, signs.shape[1])
        draws.append(
            np.log(np.concatenate([size * rng.lognormal(0, 0.7, len(free)), k]))
        )
    even = np.full(
        len(draws[-1]), np.log(size)
    )  # where modes contradict each other, the chain of the lowest frequency
    even[len(free) :] += 2 * np.log(w.min() / built(even[None])[2].min())
    x = np.vstack([_nearest(gaps, np.array(draws)), even])
    cost, (masses, k, _, phi) = (gaps(x) ** 2).sum(axis=1) / 2, built(x)
    for row in np.flatnonzero(np.isfinite(cost)):
        damping = nnls((signs.T @ phi[row]).T ** 2, 2 * np.abs(found.poles.real))[0]
        floor = 0.2 * np.median(-2 * found.poles.real / w**2) * k[row]
        yield Linear(masses[row], k[row], np.maximum(damping, floor), float(cost[row]))


def _nearest(gaps: Callable[[np.ndarray], np.ndarray], x: np.ndarray) -> np.ndarray:
    """Least squares from each row of x, all rows in step (Levenberg)."""
    low, high, damping, p, left = (
        x - 12.0,
        x + 12.0,
        np.full(len(x), 1e-3),
        x.shape[1],
        gaps(x),
    )
    for _ in range(STEPS):
        beside = gaps((x[:, None] + DIFFERENCE * np.eye(p)).reshape(-1, p)).reshape(
            len(x), p, -1
        )
        J = (beside - left[:, None]) / DIFFERENCE
        normal = J @ J.transpose(0, 2, 1)
        ridge = np.maximum(
            damping * np.trace(normal, axis1=1, axis2=2), 1e-300
        )  # modes may tell nothing
        step = np.linalg.solve(
            normal + ridge[:, None, None] * np.eye(p), J @ left[:, :, None]
        )[:, :, 0]
        new = np.clip(x - np.clip(step, -LONGEST, LONGEST), low, high)
        now = gaps(new)
        better = (now**2).sum(axis=1) < (left**2).sum(axis=1)
        x, left = (
            np.where(better[:, None], new, x),
            np.where(better[:, None], now, left),
        )
        damping = np.clip(np.where(better, damping / 10, damping * 3), 1e-12, 1e3)
    return x
