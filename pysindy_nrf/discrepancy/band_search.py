"""Find the informative bands of a search, once, before any law is tried."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress

import numpy as np

from ..chain.sites import Site
from ..chain.structure import Chain
from ..exceptions import NRFError
from ..laws.base import ForceLaw
from .bands import (
    BANDS,
    InformativeBands,
    clear_bands,
    connected_bands,
    strongest_bands,
)
from .error_reduction import residual_share
from .fitted_model import fit_model
from .spectra import BalanceSpectra

LawsBySite = Mapping[Site, Sequence[ForceLaw]]


def find_bands(
    spectra: BalanceSpectra, chain: Chain, models: Sequence[LawsBySite]
) -> InformativeBands:
    """Find the informative bands, none above the last of them.

    A band is informative in a balance if the best of the models (the declared one, and
    one with flexible storeys) leaves less than half of its power on folds left out of
    its fit. Such bands must connect it to those that hold 90 % of the energy.
    Errors are reported where it leaves no more than ten times the share that is typical
    of the balance.
    """
    core = np.empty(0)

    for round_ in range(BANDS.rounds):
        shares, reference = _least_shares(spectra, chain, models)
        if round_ == 0:
            core = np.array([strongest_bands(power) for power in reference])
            informative = core
        else:
            informative = np.empty_like(core)
            for j, (share, power) in enumerate(zip(shares, reference)):
                good = share < BANDS.unexplained
                informative[j] = connected_bands(good, share, power, core[j])

        if np.array_equal(informative, spectra.bands.informative):
            break
        spectra = spectra.with_bands(InformativeBands(informative, informative))

    balances = zip(spectra.bands.informative, shares, reference)
    clear = np.array([clear_bands(*balance) for balance in balances])
    return InformativeBands(spectra.bands.informative, clear).up_to_last()


def _least_shares(
    spectra: BalanceSpectra, chain: Chain, models: Sequence[LawsBySite]
) -> tuple[np.ndarray, np.ndarray]:
    """Least share of each balance and band that a model leaves, and the power."""
    shares, reference = [], np.empty(0)
    for laws in models:
        with suppress(NRFError), np.errstate(divide="ignore", invalid="ignore"):
            powers = fit_model(spectra, chain, laws).powers
            reference = powers.reference
            share = residual_share(powers.residual, reference)
            shares.append(np.where(np.isfinite(share), share, np.inf))

    if not shares:
        raise NRFError(
            "The declared model cannot be fitted: columns of its balances depend on"
            " each other or are zero",
            "Declare fewer terms, or give longer records.",
        )
    return np.min(shares, axis=0), reference
