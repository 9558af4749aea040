r"""Change of storey forces between two tests, over the motion of both.

Newton's law of all floors above a storey gives its force without any law, :math:`R_i =
\sum_{j \ge i} (F_j - m_j a_j)`, up to the masses. Where both tests went, one law that
is far richer than a declared one explains it in both, and differences of the second
test explain the rest. A law that another amplitude shows in another light needs no
difference.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ..chain.model import ChainModel
from ..chain.sites import Site
from ..laws import Dahl, ForceLaw
from ..laws.shape import Motion
from ..records.dataset import Dataset, Segment
from ..records.zero_phase_filter import ZeroPhaseFilter

# Clearances and sliding distances of the common law, in rms drifts of the weaker test.
# They span what bends a force within its drift: a loop that slides earlier is dry
# friction, one that slides later a spring.
GAPS = (0.5, 1.0, 1.5, 2.0)
SLIDING_DISTANCES = (0.03, 0.1, 0.3, 1.0)


# -- the law that is common to both tests --------------------------------------


def surfaces(v: np.ndarray, s: np.ndarray) -> dict[str, np.ndarray]:
    """Terms in which a force may have changed; friction slides.

    Parameters
    ----------
    v, s : ndarray of shape (n_points,)
        Rates and drifts in units of the weaker test.
    """
    terms = {
        "k": s,
        "c": v,
        "k3": s**3,
        "Fc": np.sign(v),
        "c2": v * np.abs(v),
        "k2": s * s,
    }
    for gap in GAPS:
        terms[f"gap {gap:g}"] = s - np.clip(s, -gap, gap)
    for distance in SLIDING_DISTANCES:
        terms[f"Fc {distance:g}"] = np.sign(v)
    return terms


@dataclass(frozen=True, eq=False)
class CommonLaw:
    """Columns of the law that holds in both tests, along a motion.

    Parameters
    ----------
    terms : dict of str to ndarray
        What may have changed between the tests.
    others : list of ndarray
        What is the same in both.
    """

    terms: dict[str, np.ndarray]
    others: list[np.ndarray]

    @property
    def columns(self) -> np.ndarray:
        """All columns, those of the terms first."""
        return np.column_stack(list(self.terms.values()) + self.others)


def common_law(
    motion: Motion, unit: np.ndarray, laws: Sequence[Sequence[ForceLaw]]
) -> CommonLaw:
    """The common law along a motion.

    Parameters
    ----------
    motion : Motion
    unit : ndarray of shape (2,)
        Rms rate (m/s) and drift (m) of the weaker test.
    laws : sequence of sequence of ForceLaw
        Those that each test identified at the site.
    """
    v = motion.v / unit[0]
    s = motion.s / unit[1]
    terms = surfaces(v, s)
    for distance in SLIDING_DISTANCES:
        slider = Dahl(sigma=1 / (distance * unit[1]))
        terms[f"Fc {distance:g}"] = slider.features(motion)[:, 0]
    common = CommonLaw(terms, [s * v, s * s * v, s * v * v, v**3])

    before, after = (_with_state_or_shape(group) for group in laws)
    if before and after:
        return _with_declared_laws(common, motion, before, after)
    return common


def _with_state_or_shape(laws: Iterable[ForceLaw]) -> list[ForceLaw]:
    """The laws that are compared on their own parameters."""
    return [law for law in laws if law.shapes or law.has_memory]


def _with_declared_laws(
    common: CommonLaw,
    motion: Motion,
    before: Sequence[ForceLaw],
    after: Sequence[ForceLaw],
) -> CommonLaw:
    """The common law with declared laws, whose own parameters may have changed.

    They take the place of friction and gaps.
    """
    of_before = _columns(before, motion)
    of_after = _columns(after, motion)
    terms = {}
    others = common.others + list(of_after.T)
    for name, column in common.terms.items():
        if name.split()[0] in ("Fc", "gap"):
            others.append(column)
        else:
            terms[name] = column

    values = []
    columns = iter(of_before.T)
    for law in before:
        values.append(law.values)
        for term, column in zip(law.terms(), columns):
            terms[f"own {term.symbol}"] = column
    terms["shape"] = (of_after - of_before) @ np.concatenate(values)
    return CommonLaw(terms, others)


def _columns(laws: Sequence[ForceLaw], motion: Motion) -> np.ndarray:
    """Columns of laws along a motion."""
    return np.column_stack([law.features(motion) for law in laws])


# -- one cut -------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class MeasuredTest:
    """One of the two tests.

    Parameters
    ----------
    data : Dataset
    model : ChainModel
        Fitted to it.
    filters : sequence of ZeroPhaseFilter or None
        Of each record.
    edges : sequence of ndarray
        Edges of the consecutive pieces of each record, in valid samples.
    """

    data: Dataset
    model: ChainModel
    filters: Sequence[ZeroPhaseFilter | None]
    edges: Sequence[np.ndarray]

    def motions(self, site: Site) -> list[Motion]:
        """Motion of a site in each record."""
        return [seg.motion(site, seg.valid) for seg in self.data.segments]


@dataclass(frozen=True, eq=False)
class Domain:
    """The motion of a storey that both tests went through.

    Parameters
    ----------
    low, high : ndarray of shape (2,)
        Corners (v, s), m/s and m.
    unit : ndarray of shape (2,)
        Rms rate and drift of the weaker test.
    ratio : float
        Rms drift of the second test over that of the first.
    """

    low: np.ndarray
    high: np.ndarray
    unit: np.ndarray
    ratio: float

    def contains(self, motion: Motion) -> np.ndarray:
        """Which samples of a motion lie in it."""
        points = np.array([motion.v, motion.s]).T
        inside = (points >= self.low) & (points <= self.high)
        return inside[:, 0] & inside[:, 1]


def common_domain(site: Site, tests: Sequence[MeasuredTest]) -> Domain:
    """The motion of a storey that both tests went through."""
    low = []
    high = []
    rms = []
    for test in tests:
        motions = test.motions(site)
        points = np.concatenate([[motion.v, motion.s] for motion in motions], axis=1)
        low.append(points.min(axis=1))
        high.append(points.max(axis=1))
        rms.append(np.sqrt(np.mean(points**2, axis=1)))
    unit = np.min(rms, axis=0)
    ratio = float(rms[1][1] / rms[0][1])
    return Domain(np.max(low, axis=0), np.min(high, axis=0), unit, ratio)


@dataclass(frozen=True, eq=False)
class Cut:
    """The force of a storey in two tests, from the floors above it.

    Parameters
    ----------
    storey : int
    grams : list of ndarray of shape (n_blocks, p, p)
        By test: Gram matrices of blocks of samples, of the columns [common law | a_1 ..
        a_n | applied force | force of the storey].
    terms : list of str
        What may have changed; the first columns.
    domain : Domain
    count : list of int
        Samples of each test in the domain.
    stiffness : float
        Of the first test in the domain, N/m.
    spring : float
        That times the rms drift of the second test in the domain, N.
    products : ndarray of shape (n_terms, n_terms)
        Mean products of the terms' columns in the second test.
    applied : float
        Rms of the forces above the cut in the second test, N.
    """

    storey: int
    grams: list[np.ndarray]
    terms: list[str]
    domain: Domain
    count: list[int]
    stiffness: float
    spring: float
    products: np.ndarray
    applied: float

    @property
    def place(self) -> str:
        """The storey by name."""
        return f"storey {self.storey}"

    def size(self, terms: Sequence[str], values: np.ndarray) -> np.ndarray:
        """Rms force of changes of some terms, percent of the spring's.

        Parameters
        ----------
        terms : sequence of str
        values : ndarray of shape (..., n_terms)
        """
        chosen = [self.terms.index(term) for term in terms]
        products = self.products[np.ix_(chosen, chosen)]
        power = np.einsum("...i,ij,...j", values, products, values)
        return 100 * np.sqrt(power) / self.spring


def cut_of(
    storey: int, tests: Sequence[MeasuredTest], masses: np.ndarray
) -> Cut | None:
    """The cut below a storey's floor.

    Parameters
    ----------
    storey : int
    tests : sequence of MeasuredTest
        The first and the second.
    masses : ndarray of shape (n_dof,)
        By which the storey's force follows, kg.

    Returns
    -------
    Cut or None
        None if in a test no record holds all forces above it.
    """
    site = Site(storey)
    domain = common_domain(site, tests)
    laws = [test.model.laws.get(site, ()) for test in tests]

    grams = []
    counts = []
    terms: list[str] = []
    for test in tests:
        blocks = []
        count = 0
        for number, motion in enumerate(test.motions(site)):
            common = common_law(motion, domain.unit, laws)
            force = _force_above(storey, test.data.segments[number], test.model, masses)
            rows = _rows(storey, test, number, common.columns, force)
            # a record of unknown forces counts as blocks without samples
            inside = domain.contains(motion) & ~np.isnan(force).any()
            blocks += _block_sums(rows, inside, test.edges[number])
            count += int(inside.sum())
            terms = list(common.terms)
        if not count:
            return None
        grams.append(np.array(blocks))
        counts.append(count)

    first, second = (blocks.sum(axis=0) for blocks in grams)
    products = second[: len(terms), : len(terms)] / counts[1]
    # k and c are the first two terms
    linear = np.linalg.lstsq(first[:2, :2], first[:2, -1], rcond=None)[0]
    return Cut(
        storey,
        grams,
        terms,
        domain,
        counts,
        stiffness=linear[0] / domain.unit[1],
        spring=abs(linear[0]) * np.sqrt(products[0, 0]),
        products=products,
        applied=float(np.sqrt(second[-2, -2] / counts[1])),
    )


def _force_above(
    storey: int, segment: Segment, model: ChainModel, masses: np.ndarray
) -> np.ndarray:
    """Force of a storey from all that acts on the floors above it.

    NaN where a force is not known.
    """
    rows = segment.valid
    above = slice(storey - 1, None)
    inertia = masses[above] * segment.a[rows, above]
    total = (segment.F[rows, above] - inertia).sum(axis=1)
    for site, force in model.restoring_forces.items():
        signs = [site.incidence(j) for j in range(storey, segment.n_dof + 1)]
        if sum(signs) and force.laws and site != Site(storey):
            total -= sum(signs) * force.along(segment.motion(site, rows))
    return total


def _rows(
    storey: int, test: MeasuredTest, number: int, columns: np.ndarray, force: np.ndarray
) -> np.ndarray:
    """Columns of the common law, what acts above the cut, and the storey's force."""
    segment = test.data.segments[number]
    band_pass = test.filters[number]
    above = np.arange(1, segment.n_dof + 1) >= storey
    accelerations = segment.a[segment.valid] * above
    applied = segment.F[segment.valid, storey - 1 :].sum(axis=1)
    rows = np.column_stack([columns, accelerations, applied, force])
    return rows if band_pass is None else band_pass.apply(rows)


def _block_sums(
    rows: np.ndarray, inside: np.ndarray, edges: np.ndarray
) -> list[np.ndarray]:
    """Gram matrices of the samples inside, block by block."""
    sums = []
    for start, stop in zip(edges[:-1], edges[1:]):
        block = rows[start:stop][inside[start:stop]]
        sums.append(block.T @ block)
    return sums
