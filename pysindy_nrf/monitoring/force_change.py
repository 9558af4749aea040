r"""Change of storey forces between two tests, over the motion of both.

Newton's law of all floors above a storey gives its force without any law, :math:`R_i =
\sum_{j \ge i} (F_j - m_j a_j)`, up to the masses. Where both tests went, one law that
is far richer than a declared one explains it in both, and differences of the second
test explain the rest: of a term at a storey, or of a mass. They compete by the residual
they remove. A law that another amplitude shows in another light needs no difference.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import special

from ..chain.model import ChainModel
from ..chain.sites import Site
from ..equations.normal_equations import variance
from ..exceptions import ChainError
from ..laws import Dahl, ForceLaw
from ..laws.shape import Motion
from ..records.dataset import Dataset, Segment
from ..records.zero_phase_filter import ZeroPhaseFilter

# Clearances and sliding distances of the common law, in rms drifts of the weaker test.
# They span what bends a force within its drift: a loop that slides earlier is dry
# friction, one that slides later a spring.
GAPS = (0.5, 1.0, 1.5, 2.0)
SLIDING_DISTANCES = (0.03, 0.1, 0.3, 1.0)
# Added to the squares of columns of unit length. Columns may depend on each other; only
# their span counts.
RIDGE = 1e-9
# Share of the force; a residual below is round-off.
EXACT = 1e-6
# Times that masses are solved again: cuts and tests are weighted by what they leave,
# which depends on the masses.
MASS_ROUNDS = 3
_LEAST = np.finfo(float).tiny
_WORDS = {
    "k": "stiffness",
    "c": "damping",
    "k3": "cubic spring",
    "Fc": "friction",
    "c2": "quadratic damping",
    "k2": "asymmetry of the spring",
    "gap": "gap",
    "m": "mass",
    "shape": "shape of the declared law",
}


def in_words(terms: str) -> str:
    """What changed, as a sentence begins with it."""
    words = []
    for term in terms.split(" + "):
        word = _WORDS.get(term.split()[0])
        words.append(word or term.removeprefix("own "))
    text = " and ".join(dict.fromkeys(words))
    return text[0].upper() + text[1:]


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
        return np.column_stack([*self.terms.values(), *self.others])


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
    others = [*common.others, *of_after.T]
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
    """What the floors of a storey and above tell of its force in two tests.

    Parameters
    ----------
    storey : int
    grams : list of ndarray of shape (n_blocks, p, p)
        By test: Gram matrices of blocks of samples, of the columns [common law | a_1 ..
        a_n | force].
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
    """

    storey: int
    grams: list[np.ndarray]
    terms: list[str]
    domain: Domain
    count: list[int]
    stiffness: float
    spring: float
    products: np.ndarray

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
    """Columns of the common law, accelerations above the cut, and the force."""
    segment = test.data.segments[number]
    band_pass = test.filters[number]
    above = np.arange(1, segment.n_dof + 1) >= storey
    rows = np.column_stack([columns, segment.a[segment.valid] * above, force])
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


# -- differences between the tests ---------------------------------------------


@dataclass(frozen=True)
class Difference:
    """What may have changed: a term of a storey, or a mass."""

    place: str
    term: str


@dataclass(frozen=True)
class Change:
    """An unknown by its number, and its probability if nothing had changed."""

    unknown: int
    probability: float


class Comparison:
    """Differences between two tests that the data ask for, found one by one.

    The unknowns are departures of the masses from those given, their changes, and the
    changes of each cut's terms; all cuts share the masses.

    Parameters
    ----------
    cuts : sequence of Cut
    masses : ndarray of shape (n_dof,)
        kg.
    free : sequence of int
        DOFs whose mass is not known.
    """

    def __init__(
        self, cuts: Sequence[Cut], masses: np.ndarray, free: Sequence[int]
    ) -> None:
        self.cuts = list(cuts)
        self.masses = masses
        self.free = list(free)
        self.n_masses = len(masses)

        self.unknowns: list[Difference] = []
        for j in range(1, self.n_masses + 1):
            self.unknowns.append(Difference("", f"m{j}"))
        for j in range(1, self.n_masses + 1):
            self.unknowns.append(Difference(f"dof {j}", "m"))
        for cut in self.cuts:
            self.unknowns += [Difference(cut.place, term) for term in cut.terms]

        # departures of masses, which nobody asks about
        self.always = [j - 1 for j in self.free]
        self.changes: list[Change] = []
        departures = np.zeros(self.n_masses)
        for _ in range(MASS_ROUNDS):
            self.total = self._sums(departures)
            departures[self.always] = self._solved()[0, : len(self.always)]

    def cut(self, place: str) -> Cut:
        """The cut below a storey's floor.

        Raises
        ------
        ChainError
            If not all forces above it are known.
        """
        for cut in self.cuts:
            if cut.place == place:
                return cut
        raise ChainError(
            f"The force of {place} is not known in both tests",
            "Measure all forces above it.",
        )

    @property
    def freedom(self) -> int:
        """Degrees of freedom of the standard errors."""
        return min(len(blocks) for cut in self.cuts for blocks in cut.grams) - 1

    @property
    def used(self) -> list[int]:
        """Unknowns in use: departures of masses, and the differences found."""
        return [*self.always, *(change.unknown for change in self.changes)]

    def masses_of_tests(self) -> tuple[np.ndarray, np.ndarray]:
        """Masses of both tests, kg."""
        values = np.zeros(len(self.unknowns))
        values[self.used] = self._solved()[0]
        before = self.masses + values[: self.n_masses]
        return before, before + values[self.n_masses : 2 * self.n_masses]

    def same(self, place: str, term: str, level: float) -> bool:
        """Whether no difference of a storey's term is significant, however small."""
        names = (Difference(place, term), Difference(place, f"own {term}"))
        asked = [i for i, name in enumerate(self.unknowns) if name in names]
        return bool(asked) and self._best(asked, level, 0.0) is None

    def error_of_shape(self, place: str) -> float:
        """Standard error of the difference of shape parameters, as a share of it."""
        name = Difference(place, "shape")
        if name not in self.unknowns:
            return np.nan
        unknown = self.unknowns.index(name)
        used = _without_repetition([*self.used, unknown])
        values = self._solved(used)[:, used.index(unknown)]
        return float(np.sqrt(self._variance(values)))

    def map(
        self, place: str, v: np.ndarray, s: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, int]:
        """Change of a storey's force at points.

        Parameters
        ----------
        place : str
        v, s : ndarray of shape (n_points,)
            m/s and m.

        Returns
        -------
        change, error : ndarray of shape (n_points,)
            N; the standard error.
        n_terms : int
            Terms that the change has.
        """
        unit = self.cut(place).domain.unit
        linear = (Difference(place, "k"), Difference(place, "c"))
        used = list(self.used)
        used += [i for i, name in enumerate(self.unknowns) if name in linear]
        used = _without_repetition(used)
        values = self._solved(used)
        at_points = surfaces(v / unit[0], s / unit[1])

        columns = []
        shown = []
        for column, unknown in enumerate(used):
            name = self.unknowns[unknown]
            if name.place == place and name.term in at_points:
                columns.append(column)
                shown.append(at_points[name.term])
        forces = values[:, columns] @ np.array(shown)
        return forces[0], np.sqrt(self._variance(forces)), len(shown)

    def table(self) -> pd.DataFrame:
        """What changed, place by place, the largest first.

        Columns ``place``, ``term``, ``change`` and ``error`` (%), ``amount``, ``unit``
        (N rms or kg) and ``p``.
        """
        values = self._solved()[:, len(self.always) :]
        places = [self.unknowns[change.unknown].place for change in self.changes]
        rows = []
        for place in dict.fromkeys(places):
            here = [k for k, other in enumerate(places) if other == place]
            rows.append(self._row(place, here, values[:, here]))
        columns = ["place", "term", "change", "error", "amount", "unit", "p"]
        table = pd.DataFrame(rows, columns=columns)
        return table.sort_values(
            "change", key=np.abs, ascending=False, ignore_index=True
        )

    def _row(
        self, place: str, here: Sequence[int], values: np.ndarray
    ) -> dict[str, object]:
        """One row of the table: the differences found at one place."""
        terms = [self.unknowns[self.changes[k].unknown].term for k in here]
        size = self._size(place, terms, values)
        first = values[0, 0]
        if place.startswith("dof"):
            of_one_percent = self.masses[int(place[4:]) - 1] / 100
            unit = "kg"
        else:
            cut = self.cut(place)
            of_one_percent = cut.spring / 100
            unit = "N rms"
            if terms[0] == "k":  # against a stiffness that may be negative
                first *= cut.stiffness
        return {
            "place": place,
            "term": " + ".join(terms),
            "change": np.sign(first) * size[0],
            "error": float(np.sqrt(self._variance(size))),
            "amount": size[0] * of_one_percent,
            "unit": unit,
            "p": min(self.changes[k].probability for k in here),
        }

    # -- search ----------------------------------------------------------------

    def search(self, level: float, least: float) -> None:
        """Take in one difference after the other: that which removes most.

        Parameters
        ----------
        level : float
            Significance level of all unknowns together.
        least : float
            Smallest change, percent.
        """
        asked = self._asked()
        best = self._best(asked, level, least)
        while best is not None:
            place = self.unknowns[best.unknown].place
            here = [i for i in asked if self.unknowns[i].place == place]
            while best is not None:  # which terms of this place
                self.changes.append(best)
                best = self._best(here, level, least)
            best = self._best(asked, level, least)

    def _asked(self) -> list[int]:
        """Unknowns that are differences: of free masses, and of terms."""
        masses = [self.n_masses + j - 1 for j in self.free]
        return [*masses, *range(2 * self.n_masses, len(self.unknowns))]

    def _best(self, asked: Sequence[int], level: float, least: float) -> Change | None:
        """The unknown that removes most, if it is significant and large.

        Other places that changed may change in any way.
        """
        used = _without_repetition(self.used + self._other_changes(asked))
        rest = [i for i in asked if i not in used]
        if not rest:
            return None

        force = len(self.unknowns)
        order = np.array(used + rest + [force])
        remaining = _unexplained(self.total[:, order[:, None], order], len(used))
        power = np.diagonal(remaining, axis1=1, axis2=2)[:, :-1]
        usable = power[0] > RIDGE * np.diagonal(self.total[0])[rest]
        values = remaining[:, :-1, -1] / np.where(usable, power, 1.0)

        probability = self._probability(values)
        large = []
        for k, i in enumerate(rest):
            name = self.unknowns[i]
            large.append(self._size(name.place, [name.term], values[0, k : k + 1]))
        wanted = usable & (np.array(large) >= least) & (probability < level)
        gain = np.where(wanted, values[0] ** 2 * power[0], 0.0)
        if not gain.any():
            return None
        best = int(np.argmax(gain))
        return Change(rest[best], float(probability[best]))

    def _other_changes(self, asked: Sequence[int]) -> list[int]:
        """All unknowns of places that changed; but of the one that is asked about."""
        changed = {self.unknowns[change.unknown].place for change in self.changes}
        places = {self.unknowns[i].place for i in asked}
        if len(places) == 1:
            changed -= places
        numbers = range(self.n_masses, len(self.unknowns))
        return [i for i in numbers if self.unknowns[i].place in changed]

    def _probability(self, values: np.ndarray) -> np.ndarray:
        """Probability of each value if it were zero, of all unknowns together."""
        error = np.maximum(np.sqrt(self._variance(values)), _LEAST)
        alone = 2 * special.stdtr(self.freedom, -np.abs(values[0]) / error)
        return np.minimum(alone * len(self.unknowns), 1.0)  # Bonferroni

    def _size(self, place: str, terms: Sequence[str], values: np.ndarray) -> np.ndarray:
        """Changes at one place, percent of its spring's force, or of the mass."""
        if place.startswith("dof"):
            return 100 * np.abs(values[..., 0]) / self.masses[int(place[4:]) - 1]
        return self.cut(place).size(terms, values)

    # -- sums ------------------------------------------------------------------

    def _sums(self, departures: np.ndarray) -> np.ndarray:
        """Gram matrices of all unknowns and the forces.

        Of all blocks, and without each block of the first and of the second test. Cuts
        and tests are weighted by what they leave with these departures of the masses.
        """
        n_blocks = [len(blocks) for blocks in self.cuts[0].grams]
        size = len(self.unknowns) + 1
        total = np.zeros((1 + sum(n_blocks), size, size))
        first_term = 2 * self.n_masses
        for cut in self.cuts:
            n_terms = len(cut.terms)
            of_masses = np.arange(2 * self.n_masses)
            of_terms = np.arange(first_term, first_term + n_terms)
            place = np.concatenate([of_masses, of_terms, [size - 1]])
            total[:, place[:, None], place] += self._sums_of_cut(cut, departures)
            first_term += n_terms
        return total

    def _sums_of_cut(self, cut: Cut, departures: np.ndarray) -> np.ndarray:
        """Gram matrices of the unknowns of one cut, less what the common law explains.

        Unknowns are in the order of [departures of masses | their changes | changes of
        terms | force].
        """
        width = cut.grams[0].shape[1]
        force = width - 1
        n_common = force - self.n_masses
        accelerations = np.arange(n_common, force)
        terms = np.arange(len(cut.terms))
        columns = np.concatenate(
            [np.arange(n_common), accelerations, accelerations, terms, [force]]
        )
        # changes are those of the second test
        is_change = np.zeros(len(columns), dtype=bool)
        is_change[n_common + self.n_masses : -1] = True

        n_samples = [len(blocks) for blocks in cut.grams]
        first_of_test = [1, 1 + n_samples[0]]
        total = np.zeros((1 + sum(n_samples), len(columns), len(columns)))
        for test, blocks in enumerate(cut.grams):
            of_test = blocks.sum(axis=0)
            sums = np.repeat(of_test[None], len(total), axis=0)
            start = first_of_test[test]
            sums[start : start + len(blocks)] -= blocks

            weight = cut.count[test] / _residual(of_test, n_common, departures)
            acts = np.where(is_change, test, 1)
            acts = np.outer(acts, acts)
            total += weight * sums[:, columns[:, None], columns] * acts
        return _unexplained(total, n_common)

    def _solved(self, used: Sequence[int] | None = None) -> np.ndarray:
        """Values of unknowns: from all blocks, and without each of them.

        Those in use if none are named.
        """
        used = self.used if used is None else list(used)
        numbers = np.array(used, int)
        grams = self.total[:, numbers[:, None], numbers]
        return _solve(grams, self.total[:, numbers, -1:])[..., 0]

    def _variance(self, values: np.ndarray) -> np.ndarray:
        """Variance of values found from all blocks, and without each of them."""
        n_first = len(self.cuts[0].grams[0])
        before = values[1 : 1 + n_first]
        after = values[1 + n_first :]
        return variance(before) + variance(after)


def _residual(gram: np.ndarray, n_common: int, departures: np.ndarray) -> float:
    """Squares that the common law leaves of the force with departures of the masses."""
    direction = np.concatenate([-departures, [1.0]])
    residual = direction @ _unexplained(gram, n_common) @ direction
    return max(residual, EXACT**2 * gram[-1, -1], _LEAST)


def _without_repetition(numbers: Iterable[int]) -> list[int]:
    """Numbers in their order, each once."""
    return list(dict.fromkeys(numbers))


def _unexplained(grams: np.ndarray, n: int) -> np.ndarray:
    """Gram matrices of the columns behind the first n, less what those explain."""
    cross = grams[..., :n, n:]
    explained = cross.swapaxes(-1, -2) @ _solve(grams[..., :n, :n], cross)
    return grams[..., n:, n:] - explained


def _solve(grams: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solutions of normal equations.

    Their columns span orders of magnitude and may depend on each other.
    """
    scale = np.sqrt(np.diagonal(grams, axis1=-2, axis2=-1))
    scale = np.where(scale > 0, scale, 1.0)[..., None]
    unit = grams / scale / scale.swapaxes(-1, -2)
    unit += RIDGE * np.eye(grams.shape[-1])
    return np.linalg.solve(unit, right / scale) / scale
