"""Models judged on held-out data."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from ..exceptions import NRFError
from ..records.dataset import BlockRows
from .error_reduction import Powers
from .fitted_model import FittedModel
from .free_run import free_run_error
from .search_data import SearchData
from .spectra import BalanceSpectra


@dataclass(frozen=True)
class HeldoutSettings:
    """Numbers of the errors on held-out data."""

    # A balance whose held-out reference is less than a tenth of the search's is not
    # driven there: its error means nothing.
    undriven: float = 0.1


HELDOUT = HeldoutSettings()


@dataclass(frozen=True, eq=False)
class JudgedModel:
    """A model judged on the search and on held-out data.

    Attributes
    ----------
    name : str
    model : FittedModel
    heldout : Powers
        On held-out data.
    errors : dict of str to float
        The row of the table of errors, percent.
    """

    name: str
    model: FittedModel
    heldout: Powers
    errors: dict[str, float]

    @property
    def error(self) -> float:
        """Held-out error of all balances together, percent."""
        return self.errors["held-out"]

    @property
    def free_run_error(self) -> float:
        """Free-run error on held-out data, percent."""
        return self.errors["free run"]


class HeldoutJudge:
    """Judges models on held-out data.

    Parameters
    ----------
    instants : iterable of float
        Times, s, at which something changes. Pieces there are not judged, nor those so
        near that the search could not date the change: the ends of a fold show next to
        nothing.
    """

    def __init__(self, instants: Iterable[float] = ()) -> None:
        self.instants = list(instants)
        self._heldout: dict[BalanceSpectra, BalanceSpectra] = {}
        self._with_means: dict[BalanceSpectra, BalanceSpectra] = {}

    def judged(self, name: str, model: FittedModel) -> JudgedModel:
        """A model with its errors on the search and on held-out data."""
        heldout = self.heldout(model.spectra)
        powers = model.powers_on(heldout)
        reference = model.spectra.bands.clear_power(model.powers.reference)
        there = heldout.bands.clear_power(powers.reference) / heldout.windows.size
        usual = reference / model.spectra.windows.size
        undriven = there < HELDOUT.undriven * usual

        errors = search_errors(model)
        errors["held-out"] = heldout.error(powers, reference)
        if undriven.all():
            # The pieces rest or ring down: the force of the search is the reference.
            errors["held-out"] *= float(np.sqrt(there.sum() / usual.sum()))
        records = model.data_with_offsets.data
        blocks = self._blocks(model.spectra)
        errors["free run"] = free_run_error(model.chain_model(), records, blocks)

        of_balances = np.where(undriven, np.nan, heldout.errors(powers))
        for j, error in enumerate(of_balances, 1):
            errors[f"held-out dof {j}"] = float(error)
        return JudgedModel(name, model, powers, errors)

    def heldout(self, spectra: BalanceSpectra) -> BalanceSpectra:
        """The same windows and bands on the held-out samples."""
        if spectra not in self._heldout:
            windows = spectra.windows.over(self._blocks(spectra))
            self._heldout[spectra] = spectra.with_windows(spectra.data, windows)
        return self._heldout[spectra]

    def with_means(self, model: FittedModel) -> FittedModel:
        """The same model with the means left in, if it can be fitted to them."""
        if not model.spectra.windows.centred:
            return model
        with suppress(NRFError):
            return model.refitted(self.spectra_with_means(model.spectra))
        return model

    def spectra_with_means(self, spectra: BalanceSpectra) -> BalanceSpectra:
        """The same spectra with the means left in, made once."""
        if spectra not in self._with_means:
            self._with_means[spectra] = spectra.with_means()
        return self._with_means[spectra]

    def _blocks(self, spectra: BalanceSpectra) -> list[BlockRows]:
        return steady_blocks(spectra.data, self.instants, spectra.windows.length / 2)


def search_errors(model: FittedModel) -> dict[str, float]:
    """Errors on the search data, percent: of the fit, and of folds left out of it."""
    within = model.spectra.error(model.powers_within)
    return {"search": within, "validation": model.error}


def steady_blocks(
    data: SearchData, instants: Iterable[float], margin: float
) -> list[BlockRows]:
    """Held-out pieces in which nothing changes, nor within a margin (s) of them.

    All of them if none would be left.
    """
    instants = list(instants)
    steady = []
    for block in data.heldout:
        if not _is_near(block, data, instants, margin):
            steady.append(block)
    return steady or data.heldout


def _is_near(
    block: BlockRows, data: SearchData, instants: list[float], margin: float
) -> bool:
    """Whether an instant lies in a piece of a searched record, or near it."""
    if not instants or block.segment not in data.searched:
        return False
    segment = data.data.segments[block.segment]
    times = np.asarray(segment.t, dtype=float)[segment.valid][block.rows]
    first, last = times[0] - margin, times[-1] + margin
    return any(first <= instant <= last for instant in instants)
