"""When nothing may be claimed, and what general laws would still explain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from ..chain.sites import Site
from ..exceptions import NRFError
from ..laws.base import ForceLaw
from . import judge
from .catalogue import general_laws
from .channel_errors import ChannelErrorTest
from .effects import SearchState
from .error_reduction import ErrorReduction
from .fitted_model import FittedModel


@dataclass(frozen=True)
class ClaimSettings:
    """When nothing is claimed."""

    # Percent of the force of a balance (64 % of its power) that a model may leave.
    hopeless: float = 80.0
    # An effect cancels a declared mass if a tenth of it is left.
    cancelled: float = 0.1


CLAIMS = ClaimSettings()


def why_no_claim(model: FittedModel) -> str:
    """Why nothing may be claimed of a model; empty if something may."""
    errors = model.errors_within
    if np.nanmax(errors) >= CLAIMS.hopeless:
        worst = int(np.nanargmax(errors))
        return (
            f"the best model leaves {errors[worst]:.0f} % of the balance of DOF"
            f" {worst + 1}"
        )

    known = model.spectra.data.known_masses
    chain_model = model.chain_model()
    masses = enumerate(chain_model.masses, 1)
    if any(mass <= 0 and j not in known for j, mass in masses):
        return f"masses came out not positive ({_in_words(chain_model.masses)})"

    total = chain_model.total_masses
    cancelled = []
    for j, mass in known.items():
        if mass > 0 and total[j - 1] <= CLAIMS.cancelled * mass:
            cancelled.append(str(j))
    if cancelled:
        return f"an effect cancels the declared mass of DOF {', '.join(cancelled)}"
    return ""


def _in_words(masses: np.ndarray) -> str:
    """Masses that no structure has."""
    wrong = [f"m{j} = {m:.3g} kg" for j, m in enumerate(masses, 1) if m <= 0]
    return ", ".join(wrong)


@dataclass(frozen=True, eq=False)
class GeneralGain:
    """What a general law would still gain at a site beside a model."""

    site: Site
    law: ForceLaw
    reduction: ErrorReduction
    # Whether it is sure, and errors of the channels do not explain it.
    is_there: bool

    @property
    def words(self) -> str:
        """The law in words."""
        if self.law.has_memory:
            return "a hysteresis of sliders"
        return "a function of drift and rate"


def general_gains(
    model: FittedModel, state: SearchState, errors: ChannelErrorTest, asked: bool
) -> list[GeneralGain]:
    """What the general laws still gain at each storey and tie beside a model.

    Where ``asked``, whether errors of the channels explain it.
    """
    gains = []
    for site in model.chain.sites:
        for law in general_laws(model.spectra.data, site):
            try:
                after = model.with_laws([(site, law)])
            except NRFError:
                # its columns depend on those of the model
                continue
            reduction = after.reduction_from(model)
            there = asked and judge.is_there(reduction) and reduction.bound > 0
            if there:
                assert state.records is not None
                beyond = errors.beyond(after, model, law, state.records, state.effects)
                there = beyond.is_there
            gains.append(GeneralGain(site, law, reduction, there))
    return gains


def lack_of_fit(gains: Sequence[GeneralGain]) -> pd.DataFrame:
    """The table of what general laws would still gain."""
    rows = []
    for gain in gains:
        value, error = gain.reduction.value, gain.reduction.standard_error
        rows.append((str(gain.site), gain.words, value, error))
    columns = ["site", "general law", "gain (dB)", "standard error"]
    return pd.DataFrame(rows, columns=columns).set_index(columns[:2])
