r"""Change of the storey forces between two tests, over the motion that both went
through.

Newton's law of all floors above a storey gives its force without any law, :math:`R_i =
\sum_{j \ge i} (F_j - m_j a_j)`, up to the masses. Where both tests went, one law that
is far richer than a declared one explains it in both, and differences of the second
test explain the rest: of a term at a storey, or of a mass. They compete by the residual
they remove. A law that another amplitude shows in another light needs no difference.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

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

# Clearances and sliding distances of the common law, in rms drifts of the weaker test.
# They span what bends a force within its drift: a loop that slides earlier is dry
# friction, one that slides later a spring.
_GAPS, _SLIDES = (0.5, 1.0, 1.5, 2.0), (0.03, 0.1, 0.3, 1.0)
# of columns of unit length; they may depend on each other, only their span counts
_RIDGE = 1e-9
_EXACT = 1e-6  # of the force: a residual below is round-off
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
    text = " and ".join(
        dict.fromkeys(
            _WORDS.get(x.split()[0]) or x.removeprefix("own ")
            for x in terms.split(" + ")
        )
    )
    return text[0].upper() + text[1:]


@dataclass
class Cut:
    """What the floors of a storey and above tell of its force in two tests: Gram
    matrices of blocks of samples.
    """

    storey: int
    grams: list[
        np.ndarray
    ]  # by test: (n_blocks, p, p) of [common columns | a_1..a_n | force]
    terms: list[str]  # what may have changed; the first columns
    unit: np.ndarray  # rms of rate (m/s) and drift (m) of the weaker test
    low: np.ndarray  # corners (v, s) of the common domain
    high: np.ndarray
    ratio: float  # of the rms drifts, second to first test
    count: list[int]  # samples of each test in it
    stiffness: float  # of the first test in it, N/m
    spring: float  # that times the rms drift of the second test in it, N
    products: np.ndarray  # mean products of the terms' columns in the second test


def surfaces(v: np.ndarray, s: np.ndarray) -> dict[str, np.ndarray]:
    """Terms in which a force may have changed, of rates and drifts in units of the
    weaker test; friction slides.
    """
    gaps = {f"gap {g:g}": s - np.clip(s, -g, g) for g in _GAPS}
    plain = {
        "k": s,
        "c": v,
        "k3": s**3,
        "Fc": np.sign(v),
        "c2": v * np.abs(v),
        "k2": s * s,
    }
    return plain | gaps | {f"Fc {d:g}": np.sign(v) for d in _SLIDES}


def _columns(
    motion: Motion, unit: np.ndarray, held: Sequence[Sequence[ForceLaw]]
) -> tuple[list[str], np.ndarray]:
    """Names of what may have changed, and the columns of the common law, those
    first.
    """
    v, s = motion.v / unit[0], motion.s / unit[1]
    terms = surfaces(v, s) | {
        f"Fc {d:g}": Dahl(sigma=1 / (d * unit[1])).features(motion)[:, 0]
        for d in _SLIDES
    }
    declared = [[law for law in laws if law.shapes or law.has_memory] for laws in held]
    both = [
        np.column_stack([law.features(motion) for law in laws]) if laws else None
        for laws in declared
    ]
    further = [s * v, s * s * v, s * v * v, v**3]
    if (
        both[0] is not None and both[1] is not None
    ):  # a law with a state or a shape is compared on its own parameters
        further += [
            *both[1].T,
            *(
                terms.pop(name)
                for name in list(terms)
                if name.split()[0] in ("Fc", "gap")
            ),
        ]
        symbols = [term.symbol for law in declared[0] for term in law.terms()]
        terms |= {f"own {symbol}": column for symbol, column in zip(symbols, both[0].T)}
        terms["shape"] = (both[1] - both[0]) @ np.concatenate(
            [law.values for law in declared[0]]
        )
    return list(terms), np.column_stack([*terms.values(), *further])


def _force_above(
    storey: int, seg: Segment, model: ChainModel, masses: np.ndarray
) -> np.ndarray:
    """Force of a storey from all that acts on the floors above it; NaN where a force is
    not known.
    """
    rows = seg.valid
    total = (
        seg.F[rows, storey - 1 :] - masses[storey - 1 :] * seg.a[rows, storey - 1 :]
    ).sum(axis=1)
    for site, force in model.restoring_forces.items():
        sign = sum(site.incidence(j) for j in range(storey, seg.n_dof + 1))
        if sign and force.laws and site != Site(storey):
            total -= sign * force.along(seg.motion(site, rows))
    return total


def cut_of(
    storey: int,
    tests: Sequence[Dataset],
    models: Sequence[ChainModel],
    masses: np.ndarray,
    filters: Sequence[Sequence[Any]],
    edges: Sequence[Sequence[np.ndarray]],
) -> Cut | None:
    """The cut below a storey's floor; None if in a test no record holds all forces
    above it.
    """
    site = Site(storey)
    held = [[seg.motion(site, seg.valid) for seg in test.segments] for test in tests]
    whole = [np.concatenate([[m.v, m.s] for m in motions], axis=1) for motions in held]
    low = np.max([x.min(axis=1) for x in whole], axis=0)
    high = np.min([x.max(axis=1) for x in whole], axis=0)
    rms = np.sqrt([np.mean(x**2, axis=1) for x in whole])
    unit, ratio = rms.min(axis=0), float(rms[1, 1] / rms[0, 1])
    grams, terms, count = [], list[str](), [0, 0]
    above = np.arange(1, tests[0].n_dof + 1) >= storey
    for test, motions in enumerate(held):
        blocks = []
        for seg, motion, filter, cut in zip(
            tests[test].segments, motions, filters[test], edges[test]
        ):
            force = _force_above(storey, seg, models[test], masses)
            terms, columns = _columns(
                motion, unit, [m.laws.get(site, ()) for m in models]
            )
            rows = np.column_stack([columns, seg.a[seg.valid] * above, force])
            rows = rows if filter is None else filter.apply(rows)
            v, s = motion.v, motion.s
            known = not np.isnan(
                force
            ).any()  # a record of unknown forces counts as blocks without samples
            inside = (
                known & (v >= low[0]) & (v <= high[0]) & (s >= low[1]) & (s <= high[1])
            )
            count[test] += int(inside.sum())
            blocks += [
                (part := rows[a:b][inside[a:b]]).T @ part
                for a, b in zip(cut[:-1], cut[1:])
            ]
        if not count[test]:
            return None
        grams.append(np.array(blocks))
    first, second = (g.sum(axis=0) for g in grams)
    products = second[: len(terms), : len(terms)] / count[1]
    k = np.linalg.lstsq(first[:2, :2], first[:2, -1], rcond=None)[0][0]
    spring = abs(k) * np.sqrt(products[0, 0])
    return Cut(
        storey,
        grams,
        terms,
        unit,
        low,
        high,
        ratio,
        count,
        k / unit[1],
        spring,
        products,
    )


class Comparison:
    """Differences between two tests that the data ask for, found one by one; all cuts
    share the masses.
    """

    def __init__(
        self, cuts: Sequence[Cut], masses: np.ndarray, free: Sequence[int]
    ) -> None:
        self.cuts, self.masses, self.free = list(cuts), masses, list(free)
        n = len(masses)
        # unknowns: departures of the masses from those given, their changes, the
        # changes of each cut's terms
        self.names = [("", f"m{j + 1}") for j in range(n)] + [
            (f"dof {j + 1}", "m") for j in range(n)
        ]
        self.names += [
            (f"storey {cut.storey}", term) for cut in self.cuts for term in cut.terms
        ]
        self.base = [j - 1 for j in free]  # those that nobody asks about
        self.found: list[int] = []
        self.p: dict[int, float] = {}
        departures = np.zeros(n)
        for _ in range(
            3
            # cuts and tests are weighted by what they leave, which depends on the
            # masses
        ):
            self.total = self._total(departures)
            departures[[j - 1 for j in self.free]] = self._solved()[0, : len(self.free)]

    def cut(self, storey: int) -> Cut:
        """The cut below a storey's floor; a ChainError if not all forces above it are
        known.
        """
        if held := [cut for cut in self.cuts if cut.storey == storey]:
            return held[0]
        raise ChainError(
            f"The force of storey {storey} is not known in both tests",
            "Measure all forces above it.",
        )

    @property
    def freedom(self) -> int:
        """Degrees of freedom of the standard errors."""
        return min(len(g) for cut in self.cuts for g in cut.grams) - 1

    def masses_of_tests(self) -> tuple[np.ndarray, np.ndarray]:
        """Masses of both tests, kg."""
        use, n = [*self.base, *self.found], len(self.masses)
        values = dict(zip(use, self._solved()[0]))
        before = self.masses + [values.get(j, 0.0) for j in range(n)]
        return before, before + [values.get(n + j, 0.0) for j in range(n)]

    def same(self, place: str, term: str, level: float) -> bool:
        """Whether no difference of a storey's term, however small, is significant
        beside those found.
        """
        at = [
            i
            for i, name in enumerate(self.names)
            if name in ((place, term), (place, f"own {term}"))
        ]
        return bool(at) and self._best(at, level, 0.0) is None

    def error_of_shape(self, storey: int) -> float:
        """Standard error of the difference of a storey's shape parameters, as a share
        of it.
        """
        name = f"storey {storey}", "shape"
        if name not in self.names:
            return np.nan
        use = list(dict.fromkeys([*self.base, *self.found, self.names.index(name)]))
        return float(
            np.sqrt(
                self._variance(self._solved(use)[:, use.index(self.names.index(name))])
            )
        )

    def _total(self, departures: np.ndarray) -> np.ndarray:
        """Gram matrices of all unknowns and the forces: of all blocks, and without each
        of them.
        """
        n, n_blocks = len(self.masses), [len(g) for g in self.cuts[0].grams]
        at, q = 2 * n, len(self.names)
        out = np.zeros((1 + sum(n_blocks), q + 1, q + 1))
        for cut in self.cuts:
            k, p = len(cut.terms), cut.grams[0].shape[1]
            common = p - n - 1
            index = np.r_[
                np.arange(p - 1), np.arange(common, p - 1), np.arange(k), p - 1
            ]
            both = np.zeros((len(out), len(index), len(index)))
            for test, (g, first) in enumerate(zip(cut.grams, (1, 1 + n_blocks[0]))):
                whole, kept = g.sum(axis=0), np.ones(len(index))
                direction = np.r_[-departures, 1.0]
                residual = direction @ _left(whole, common) @ direction
                sums = np.repeat(whole[None], len(out), axis=0)
                sums[first : first + len(g)] -= g
                kept[p - 1 : -1] = test  # differences are those of the second
                weight = cut.count[test] / max(
                    residual, _EXACT**2 * whole[-1, -1], np.finfo(float).tiny
                )
                both += weight * sums[:, index[:, None], index] * kept[:, None] * kept
            place = np.r_[np.arange(2 * n), np.arange(at, at + k), q]
            out[:, place[:, None], place] += _left(both, common)
            at += k
        return out

    def _solved(self, more: Sequence[int] = ()) -> np.ndarray:
        """Values of the unknowns in use, and of some more: from all blocks, and without
        each of them.
        """
        use = list(dict.fromkeys([*self.base, *self.found, *more]))
        return _solve(
            self.total[:, np.array(use, int)[:, None], use], self.total[:, use, -1:]
        )[..., 0]

    def search(self, level: float, least: float) -> None:
        """Take in one difference after the other: that which removes most, if it is
        sure and large.
        """
        n = len(self.masses)
        asked = [
            i
            for i in range(n, len(self.names))
            if i not in self.base and (i >= 2 * n or i - n + 1 in self.free)
        ]
        while (best := self._best(asked, level, least)) is not None:
            place = self.names[best[0]][0]
            mine = [i for i in asked if self.names[i][0] == place]
            while best is not None:  # which terms of this place
                self.found.append(best[0])
                self.p[best[0]] = best[1]
                best = self._best(mine, level, least)

    def _best(
        self, asked: Sequence[int], level: float, least: float
    ) -> tuple[int, float] | None:
        """The unknown that removes most, and its probability; other places found may
        change in any way.
        """
        here = {self.names[i][0] for i in asked}
        changed = {self.names[i][0] for i in self.found} - (
            here if len(here) == 1 else set()
        )
        free = [
            i
            for i in range(len(self.masses), len(self.names))
            if self.names[i][0] in changed
        ]
        use = list(dict.fromkeys([*self.base, *self.found, *free]))
        rest = [i for i in asked if i not in use]
        if not rest:
            return None
        order = np.array([*use, *rest, len(self.names)])
        left = _left(self.total[:, order[:, None], order], len(use))
        own = np.diagonal(left, axis1=1, axis2=2)[:, :-1]
        usable = own[0] > _RIDGE * np.diagonal(self.total[0])[rest]
        values = left[:, :-1, -1] / np.where(usable, own, 1.0)
        error = np.maximum(np.sqrt(self._variance(values)), np.finfo(float).tiny)
        p = np.minimum(
            2
            * special.stdtr(self.freedom, -np.abs(values[0]) / error)
            * len(self.names),
            1.0,
        )  # Bonferroni
        large = (
            np.array(
                [self._size(i, values[0, j : j + 1], [i]) for j, i in enumerate(rest)]
            )
            >= least
        )
        gain = np.where(usable & large & (p < level), values[0] ** 2 * own[0], 0.0)
        return (
            (rest[best := int(np.argmax(gain))], float(p[best])) if gain.any() else None
        )

    def _variance(self, values: np.ndarray) -> np.ndarray:
        """Variance of values that were found from all blocks, and without each block of
        the first and second test.
        """
        n = len(self.cuts[0].grams[0])
        return variance(values[1 : 1 + n]) + variance(values[1 + n :])

    def _size(self, unknown: int, values: np.ndarray, of: Sequence[int]) -> np.ndarray:
        """Changes of one place, percent of its spring's force, or of the mass;
        ``values`` (.., unknowns ``of``).
        """
        place, n = self.names[unknown][0], len(self.masses)
        if place.startswith("dof"):
            return 100 * np.abs(values[..., 0]) / self.masses[unknown - n]
        cut = self.cut(Site(place).p)
        at = [cut.terms.index(self.names[i][1]) for i in of]
        return (
            100
            * np.sqrt(
                np.einsum("...i,ij,...j", values, cut.products[np.ix_(at, at)], values)
            )
            / cut.spring
        )

    def table(self) -> pd.DataFrame:
        """What changed, place by place, the largest first."""
        values, rows = self._solved()[:, len(self.base) :], []
        for place in dict.fromkeys(self.names[i][0] for i in self.found):
            at = [j for j, i in enumerate(self.found) if self.names[i][0] == place]
            of = [self.found[j] for j in at]
            size = self._size(of[0], values[:, at], of)
            row: dict[str, Any] = {
                "place": place,
                "term": " + ".join(self.names[i][1] for i in of),
            }
            if place.startswith("dof"):
                j = of[0] - len(self.masses)
                sign, scale, unit = (
                    np.sign(values[0, at[0]]),
                    self.masses[j] / 100,
                    "kg",
                )
            else:
                cut = self.cut(Site(place).p)
                sign = np.sign(
                    values[0, at[0]]
                    * (cut.stiffness if self.names[of[0]][1] == "k" else 1.0)
                )
                scale, unit = cut.spring / 100, "N rms"
            error = float(np.sqrt(self._variance(size)))
            row |= {
                "change": sign * size[0],
                "error": error,
                "amount": size[0] * scale,
                "unit": unit,
            }
            rows.append(row | {"p": min(self.p[i] for i in of)})
        columns = ["place", "term", "change", "error", "amount", "unit", "p"]
        return pd.DataFrame(rows, columns=columns).sort_values(
            "change", key=np.abs, ascending=False, ignore_index=True
        )

    def map(
        self, storey: int, v: np.ndarray, s: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, int]:
        """Change of a storey's force at points (v, s), its standard error, and how many
        terms it has.
        """
        place, unit = f"storey {storey}", self.cut(storey).unit
        linear = [
            i
            for i, name in enumerate(self.names)
            if name in ((place, "k"), (place, "c"))
        ]
        use = list(dict.fromkeys([*self.base, *self.found, *linear]))
        held, values = surfaces(v / unit[0], s / unit[1]), self._solved(linear)
        mine = [
            (j, self.names[i][1])
            for j, i in enumerate(use)
            if self.names[i][0] == place
        ]
        shown = [(j, term) for j, term in mine if term in held]
        forces = values[:, [j for j, _ in shown]] @ np.array(
            [held[term] for _, term in shown]
        )
        return forces[0], np.sqrt(self._variance(forces)), len(shown)


def _left(grams: np.ndarray, n: int) -> np.ndarray:
    """Gram matrices (.., p, p) of the columns behind the first n, less what those
    explain.
    """
    cross = grams[..., :n, n:]
    return grams[..., n:, n:] - cross.swapaxes(-1, -2) @ _solve(
        grams[..., :n, :n], cross
    )


def _solve(grams: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solutions of normal equations whose columns span orders of magnitude and may
    depend on each other.
    """
    scale = np.sqrt(np.diagonal(grams, axis1=-2, axis2=-1))
    scale = np.where(scale > 0, scale, 1.0)[..., None]
    unit = grams / scale / scale.swapaxes(-1, -2) + _RIDGE * np.eye(grams.shape[-1])
    return np.linalg.solve(unit, right / scale) / scale
