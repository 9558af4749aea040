"""Laws at the sites of a chain: as declared, their coefficients and labels."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..exceptions import ChainError
from ..laws.base import ForceLaw
from ..laws.power_series import Order, PowerSeries
from .sites import Site, SiteName, as_mapping
from .structure import Chain


def declared_laws(
    laws: Mapping[Any, ForceLaw | Sequence[ForceLaw]] | None,
) -> dict[SiteName, tuple[ForceLaw, ...]]:
    """The laws that a user declared, by the user's own names of the sites."""
    declared = {}
    for site, value in as_mapping("laws", laws, "{'storey 1': [...]}").items():
        group = tuple(value) if isinstance(value, (list, tuple)) else (value,)
        for law in group:
            if not isinstance(law, ForceLaw):
                what = f"laws[{site!r}] has {law!r}, which is not a force law"
                raise ChainError(what, "Use those of pysindy_nrf.laws.")
        declared[site] = group
    return declared


def power_series_laws(
    chain: Chain, degree: Order, orders: Mapping[Any, Order] | None = None
) -> dict[Site, list[ForceLaw]]:
    """A power series at every site of a chain."""
    order_of_site = dict.fromkeys(chain.sites, degree)
    for text, order in as_mapping("orders", orders, "{'storey 2': 5}").items():
        site = chain.site(text)
        if site not in chain.sites:
            what = f"orders names {str(site)!r}, which is not in the chain"
            raise ChainError(what, f"Its sites are {', '.join(chain.sites)}.")
        order_of_site[site] = order
    return {site: [PowerSeries(order)] for site, order in order_of_site.items()}


def coefficients_by_law(
    laws: Sequence[ForceLaw], coefficients: np.ndarray
) -> list[np.ndarray]:
    """The coefficients of a site cut into those of each law."""
    ends = np.cumsum([len(law.terms()) for law in laws])
    return np.split(coefficients, ends[:-1])


def with_coefficients(
    laws: Mapping[Site, Sequence[ForceLaw]], coefficients: Mapping[Site, np.ndarray]
) -> dict[Site, tuple[ForceLaw, ...]]:
    """Laws with the coefficients of each site, one law after the other."""
    valued = {}
    for site, group in laws.items():
        by_law = coefficients_by_law(group, coefficients.get(site, np.zeros(0)))
        pairs = zip(group, by_law)
        valued[site] = tuple(law.with_values(values) for law, values in pairs)
    return valued


def numbered(words: Sequence[str]) -> list[str]:
    """Words, with a number behind those that occur more than once."""
    count = Counter(words)
    used: Counter[str] = Counter()
    out = []
    for word in words:
        used[word] += 1
        out.append(word if count[word] == 1 else f"{word} {used[word]}")
    return out


def distinct_labels(laws: Sequence[ForceLaw]) -> list[str]:
    """Labels of the terms of some laws, all different.

    A label that occurs twice gets the name of its law behind it, and the number of the
    law where two laws have one name.
    """
    full_names = numbered([law.name for law in laws])
    labels = []
    owners = []
    for law, full_name in zip(laws, full_names):
        for term in law.terms():
            labels.append(term.label)
            owners.append((law.name, full_name))

    by_label = Counter(labels)
    by_name = Counter(zip(labels, [name for name, _ in owners]))
    out = []
    for label, (name, full_name) in zip(labels, owners):
        if by_label[label] == 1:
            out.append(label)
        elif by_name[label, name] == 1:
            out.append(f"{label} ({name})")
        else:
            out.append(f"{label} ({full_name})")
    return out
