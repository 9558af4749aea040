"""Which terms are kept: supports, their refits, and how often a bootstrap keeps each term."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..exceptions import NRFError
from ..laws import ForceLaw
from ..mechanics.sites import Site
from ..regression.layout import LawLayout
from ..regression.moments import Moments
from .fold_moments import FoldMoments, Order
from .monomials import Monomials

Support = Mapping[Site, np.ndarray]

# Rise of the held-out error, as a share, that the absence of a term may cost at most.
MARGIN = 0.02


def support_of(coefficients: Mapping[Site, np.ndarray]) -> dict[Site, np.ndarray]:
    """Terms whose coefficient is not zero, by site."""
    return {site: np.asarray(values) != 0 for site, values in coefficients.items()}


def restricted(held: FoldMoments, order: Order, support: Support) -> Order:
    """A candidate with the terms of a support alone; a given law is kept whole if any of its terms is."""
    laws: dict[Site, list[ForceLaw]] = {site: [] for site in order.layout.sites}
    columns: dict[Site, np.ndarray] = {}
    for site in order.layout.sites:
        if site not in held.union:
            blocks, at = [], 0
            for law in order.layout.laws.get(site, ()):
                block = np.arange(at, at := at + len(law.terms()))
                if site not in support or support[site][block].any():
                    laws[site].append(law)
                    blocks.append(block)
            if blocks:
                columns[site] = order.columns[site][np.concatenate(blocks)]
            continue
        kept = order.columns[site][support[site]]
        if len(kept):
            few = Monomials(held.union[site].exponents[i] for i in kept)
            laws[site].append(few)
            place = {pair: i for i, pair in enumerate(held.union[site].exponents)}
            columns[site] = np.array([place[pair] for pair in few.exponents], dtype=int)
    return Order(LawLayout(order.layout.chain, laws), columns)


def resampled(held: FoldMoments, fold: int | None, rng: np.random.Generator) -> Moments:
    """Moments of as many pieces of the training side as there are, drawn with replacement (block bootstrap)."""
    chosen = [i for i, code in enumerate(held.piece_class) if fold is None or held.membership[code, fold] == 1]
    drawn = rng.choice(chosen, size=len(chosen))
    return held.sum_of(drawn)


def inclusion(
    held: FoldMoments, order: Order, optimizer: Any, n_models: int, rng: np.random.Generator, fold: int | None = None
) -> dict[Site, np.ndarray]:
    """Share of block bootstraps in which an optimizer keeps each term."""
    counts: dict[Site, np.ndarray] = {}
    solved = 0
    for _ in range(n_models):
        try:
            solution, *_ = held.fit(order, fold, optimizer, resampled(held, fold, rng))
        except NRFError:
            continue
        solved += 1
        for site, kept in support_of(solution.coefficients).items():
            counts[site] = counts.get(site, np.zeros(len(kept))) + kept
    if not solved:
        raise NRFError("No bootstrap could be solved", "Give longer records, or lower the optimizer's threshold.")
    return {site: count / solved for site, count in counts.items()}


def labels_of(order: Order, values: Mapping[Site, Sequence[float]]) -> dict[tuple[str, str], float]:
    """Values of the terms by (site, label)."""
    return {
        (str(site), label): float(value)
        for site in order.layout.acting
        for label, value in zip(order.layout.labels(site), values[site])
    }
